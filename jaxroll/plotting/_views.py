"""Where everything of a grasp in the plane is at every time, in millimetres; checks of runs to be drawn."""

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._fields import is_command
from .._integration import check_one_run, Trajectory
from .._mechanics import compiled, Grasp, State, to_leaves
from .._motion import multipliers, residuals, touches, world_poses
from .._printing import code_name
from ..control import law_of, Press
from ._outlines import in_blocks, Outline, outlines, rolling_contacts, rolling_coordinates, sample
from ._style import MM

# How many states a program places at once.
STATES = 64


@dataclass(frozen=True)
class Views:
    """All that is drawn, for every time.

    Attributes:
        tips: Outline of each fingertip.
        body: Outline of the object.
        frames: The object's frame, then each tip's: shape (t, 4), rows (x, y, cos, sin).
        joints: Shape (t, k + 1, 2) for each finger; the last point is the tip frame's origin.
        points: Shape (t, c, 2), contact points.
        tangents: Shape (t, c, 2), tangents of the object's contour.
        rolled: For each contact, its path on the fingertip and on the object, each of shape (t, 2).
        guides: Shape (t, 2, 2) for each dashed line, on which a contact lies at rest.
        owners: For each contact, which finger it belongs to.
        radii: Of each finger's links [mm]; None where they have none of their own.
    """

    tips: tuple[Outline, ...]
    body: Outline
    frames: tuple[np.ndarray, ...]
    joints: tuple[np.ndarray, ...]
    points: np.ndarray
    tangents: np.ndarray
    rolled: tuple[tuple[np.ndarray, np.ndarray], ...]
    guides: tuple[np.ndarray, ...]
    owners: tuple[int, ...]
    radii: tuple[float | None, ...]


def place(frame: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Body-frame points in the world; `frame` is one row (x, y, cos, sin)."""
    x, y, cos, sin = frame
    # The transpose of the rotation, because points are rows.
    return points @ np.array([[cos, sin], [-sin, cos]]) + (x, y)


def single(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Times of one run, and which of them were reached.

    Raises:
        ValueError: If the trajectory is a batch, or holds no state at all.
    """
    check_one_run("trajectory", trajectory)
    reached = np.asarray(trajectory.reached)
    if not reached.any():
        raise ValueError(
            f"argument trajectory must hold at least one state that was reached, but its run ended at "
            f"t = {float(trajectory.stats.t_end):.4g} s ({code_name(trajectory.result)}) before the first"
        )
    return np.asarray(trajectory.ts), reached


def visible(grasp: Grasp, trajectory: Trajectory) -> Trajectory:
    """The run; if it ended before a state was saved, a run of the one state that it has: where it ended."""
    reached = np.asarray(trajectory.reached)
    if reached.ndim != 1 or reached.any() or not np.isfinite(trajectory.last.q).all():
        return trajectory
    ts, states = np.asarray(trajectory.stats.t_end)[None], along_time(trajectory.last)
    forces = None if trajectory.multipliers is None else multipliers(grasp, jnp.asarray(ts), states)
    parts = (ts, states, residuals(grasp, states), forces, None)
    where = lambda run: (run.ts, run.states, run.residuals, run.multipliers, run.energy)  # noqa: E731
    return eqx.tree_at(where, trajectory, parts, is_leaf=lambda x: x is None)


def how_it_ended(trajectory: Trajectory, t: float) -> str:
    """What a title says after the time t: the code of a run that had ended early by then, else nothing."""
    early = int(np.asarray(trajectory.result._value)) != 0 and t >= float(trajectory.stats.t_end)
    return f": {code_name(trajectory.result)}" if early else ""


def along_time(states: State) -> State:
    """States with a leading time axis, given one state or several."""
    if states.q.ndim == 1:
        return jax.tree.map(lambda a: a[None], states)
    return states


def views(grasp: Grasp, states: State) -> Views:
    """Everything to draw, for states with a leading time axis."""
    placed = lambda some: _placed(grasp, some)  # noqa: E731
    frames, joints, points, tangents = in_blocks(placed, states, length=STATES)
    sigmas, contacts = rolling_coordinates(grasp, np.asarray(states.s)), rolling_contacts(grasp)
    body, *tips = outlines(grasp, sigmas)
    rolled = []
    for i, contact in enumerate(contacts.values()):
        tip, face = grasp.shapes(contact)
        # The same sigma on both, with opposite sign: their paths are equally long.
        on_tip = sample(tip, float(contact.s_tip) + sigmas[:, i])
        on_body = sample(face, float(contact.s_object) - sigmas[:, i])
        rolled.append((on_tip.points, on_body.points))
    scale = np.array([MM, MM, 1.0, 1.0])
    joints = tuple(MM * j for j in joints)
    return Views(
        tuple(tips),
        body,
        tuple(frame * scale for frame in frames),
        joints,
        MM * points,
        tangents,
        tuple(rolled),
        _guides(grasp, [j[:, -1] for j in joints]),
        tuple(contact.finger for contact in contacts.values()),
        link_radii(grasp),
    )


def link_radii(grasp: Grasp) -> tuple[float | None, ...]:
    """Radius of each finger's links [mm], as runs take it; None where they have none."""
    given = [getattr(finger, "link_radius", None) for finger in grasp.fingers]
    return tuple(None if radius is None else MM * float(radius) for radius in given)


@compiled
def _placed(grasp: Grasp, states: State):
    ready = grasp.prepared()

    def at(state: State):
        leaves = to_leaves(state, ready.form)
        frames, touching = world_poses(ready, leaves.q), touches(ready, leaves.s)
        rows = tuple(jnp.stack([*f.origin, f.cos, f.sin]) for f in frames)
        joints = tuple(
            jnp.stack([p.array() for p in finger.skeleton(q)])
            for finger, q in zip(ready.fingers, leaves.q[1:], strict=True)
        )
        faces = [touching[i].object for i in rolling_contacts(ready)]
        points = [frames[0].place(face.point).array() for face in faces]
        tangents = [frames[0].turn(face.tangent).array() for face in faces]
        return rows, joints, jnp.array(points).reshape(-1, 2), jnp.array(tangents).reshape(-1, 2)

    return jax.vmap(at)(states)


def _guides(grasp: Grasp, centres: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    law = law_of(grasp.controller)
    if isinstance(law, Press) and not is_command(law.target):
        target = MM * np.asarray(law.target)
        return tuple(np.stack([c, np.broadcast_to(target, c.shape)], axis=1) for c in centres)
    # At rest under `control.Opposition` with alpha = 0 both contacts lie on the line of the tip frames.
    if len(centres) == 2 and all(finger.turns for finger in grasp.fingers):
        return (np.stack(centres, axis=1),)
    return ()
