r"""`strike`: a blow on the object of a grasp at rest or in motion, without a run.

Runs apply the same blow at its time (`_step.moved`); `_motion._impulse` has the equations.
"""

import re
from collections.abc import Collection
from typing import ClassVar

import diffrax
import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._mechanics import check_states, compiled, Grasp, join, State, to_leaves
from .._motion import Multipliers, split_forces, struck
from .._printing import listed
from .._results import check_instance, RESULTS
from .._xla import sharing
from ..loads import Impulse
from ._arguments import check_choices
from ._events import are_redundant, decode, OF_FORCES, refused_blow


class Strike(eqx.Module):
    r"""What a blow on the object did.

    Attributes:
        state: The state after it, at the same positions and places.
        multipliers: Contact impulses [N s], in the chapter's signs for forces: normal ones are positive where
            contacts press.
        work: Work of the blow, $p \cdot (v_- + v_+)/2$, and of bodies that move as prescribed, through their
            contact impulses [J].
        result: `successful`; `contact_lost` where a contact that can only press would have to pull;
            `slipping` where one with a coefficient of friction would need more. The other fields then say
            what contacts without these limits would do. `singular_contact` where contacts hold some motion
            twice; the other fields then mean nothing.
    """

    UNITS: ClassVar[dict[str, str]] = {"work": "J"}

    def __repr__(self) -> str:
        # What acts for no time is an impulse: its unit is that of a force times a second.
        return re.sub(r" (N|N m)(?=[,)])", r" \1 s", listed(self))

    state: State
    multipliers: Multipliers
    work: Float[Array, ""]
    result: RESULTS


def strike(
    grasp: Grasp, state: State, blow: Impulse, *, events: Collection[str] = ("lift", "friction")
) -> Strike:
    r"""Velocities after a blow on the object: $v_+ = v_- + (1 - M^{-1} A^T (A M^{-1} A^T)^{-1} A) M^{-1} p$.

    Contacts answer with the impulses that keep every gap from changing. These also bring gaps that were
    closing to rest: a blow of size zero makes the velocities of any state consistent, as an inelastic impact
    does.

    Args:
        grasp: The grasp.
        state: Where it is hit.
        blow: Impulse and place; its time does not count.
        events: What contacts cannot do, as in `simulate`: any of 'lift' (pull) and 'friction' (rub more than
            their coefficient allows).

    Returns:
        A `Strike`. Works under `jit`, `vmap` and differentiation.

    Raises:
        ValueError: If an argument does not fit.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pinch()
        >>> hit = jxr.strike(grasp, state, jxr.loads.Impulse((0.0, 1e-4), 0.0))
        >>> bool(hit.work > 0), bool(abs(hit.state.v[1]) > 0)
        (True, True)
    """
    check_states(grasp, state)
    check_instance("blow", blow, Impulse, "a loads.Impulse")
    blow.check("blow", 3 if grasp.spatial else 2)
    watched = check_choices("events", events, OF_FORCES)
    return _strike(grasp, state, blow, watched)


@compiled
def _strike(grasp: Grasp, state: State, blow: Impulse, events: tuple[str, ...]) -> Strike:
    """The blow, compiled as one program."""
    ready = grasp.prepared()
    with sharing():  # in space it compiles in half the time
        done = struck(ready, to_leaves(state, ready.form), [(blow, jnp.ones((), state.q.dtype))])
    no, number = refused_blow(ready, done, events)
    frames = [motion.pose for motion in done.motions]
    after = State(state.q, join(done.leaves.v), state.s, state.memory)
    code = decode(jnp.where(no, number, 0), diffrax.RESULTS.successful)
    code = RESULTS.where(are_redundant(done), RESULTS.singular_contact, code)
    return Strike(after, split_forces(ready, frames, done.touching, done.forces), done.work, code)
