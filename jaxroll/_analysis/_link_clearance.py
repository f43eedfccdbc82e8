"""How far fingers' links stay clear of the object and of each other along a run.

This looks at saved states, after the run. A run itself watches the same distances where fingers have a
`link_radius`, and ends as `links_meet` (`_integration/_events`).
"""

import itertools
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._integration import link_distances, Trajectory
from .._mechanics import compiled, Grasp, reached, State, to_leaves
from .._printing import listed
from .._results import on_host
from .._types import Times
from ._loci import check_run

# Points on each contour of the object.
_SAMPLES = 128


class LinkClearance(eqx.Module):
    """Distances of links as capsules, over a run; negative in an overlap.

    A finger without a `link_radius` has links without thickness. Distances are NaN at times that a run did
    not reach.

    Attributes:
        ts: Saved times [s].
        object: Shape (t, f), distance from the object of the links of each finger that has links [m].
        links: Shape (t, p), distance between the links of two fingers [m].
        pairs: Which two fingers each column of `links` is about.
        least: The least of all these distances [m]; NaN where no state was saved.
        time: When it occurs [s].
        where: In words, between which two it occurs.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"ts": "s", "object": "m", "links": "m", "least": "m", "time": "s"}

    ts: Times
    object: Float[Array, "t f"]
    links: Float[Array, "t p"]
    pairs: tuple[tuple[int, int], ...] = eqx.field(static=True)
    least: float = eqx.field(static=True)
    time: float = eqx.field(static=True)
    where: str = eqx.field(static=True)


@on_host
def link_clearance(grasp: Grasp, trajectory: Trajectory) -> LinkClearance:
    """How far the fingers' links stay clear of the object and of each other, at the saved times of a run.

    Links are straight, from joint to joint and to the tip frame, with the finger's `link_radius` about them
    where it has one. Those of one finger are not compared with each other, nor with fingertips, of whose
    overlaps the event 'penetration' tells.

    Args:
        grasp: The grasp that was simulated; an object with several faces must be convex.
        trajectory: One run of it.

    Returns:
        `LinkClearance`.

    Raises:
        ValueError: If the trajectory is a batch or not of this grasp, a contour of the object is endless,
            or no finger has links.

    Accuracy: distances between links are exact to rounding. Those from the object are right to a nanometre
    where the lowest place of a link lies beside the lowest of 17 points along the link; beside an object
    thinner than the spacing of these points, a sixteenth of the link, that place may be missed.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, 1.0)
        >>> found = jxr.link_clearance(grasp, run)
        >>> f"{1e3 * found.least:.1f} mm between {found.where}"
        '9.7 mm between finger 0 and the object'
    """
    check_run(grasp, trajectory)
    chains = _with_links(grasp)
    if not chains:
        raise ValueError("argument grasp must have fingers with links, but had none")
    pairs = tuple(itertools.combinations(chains, 2))
    away, apart = _distances(grasp, trajectory.states)
    both = np.concatenate([np.asarray(away), np.asarray(apart)], axis=1)
    names = [f"finger {i} and the object" for i in chains] + [f"fingers {i} and {j}" for i, j in pairs]
    if np.isnan(both).all():
        return LinkClearance(trajectory.ts, away, apart, pairs, np.nan, np.nan, "no state was saved")
    when, which = np.unravel_index(np.nanargmin(both), both.shape)
    least, time = float(both[when, which]), float(np.asarray(trajectory.ts)[when])
    return LinkClearance(trajectory.ts, away, apart, pairs, least, time, names[which])


@compiled
def _distances(grasp: Grasp, states: State) -> tuple[Array, Array]:
    """Distances [m] of every finger with links from the object, and of every two of these, state by state."""
    ready = grasp.prepared()
    found = jax.lax.map(lambda state: _at(ready, state), states)
    # At NaN the distance of a link from an object is one of minus infinity.
    there = reached(states)[:, None]
    away, apart = (jnp.where(there, each, jnp.nan) for each in found)
    return away, apart


def _at(grasp: Grasp, state: State) -> tuple[Array, Array]:
    leaves = to_leaves(state, grasp.form)
    away, apart = link_distances(grasp, leaves, _with_links(grasp), samples=_SAMPLES)
    return jnp.stack(away), jnp.stack(apart) if apart else jnp.zeros(0)


def _with_links(grasp: Grasp) -> list[int]:
    """Numbers of the fingers that have links: whose joints turn, not those of jaws."""
    return [i for i, finger in enumerate(grasp.fingers) if finger.joints and finger.turns]
