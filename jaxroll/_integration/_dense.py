r"""Dense output: the state of a run at any time, by one more step of its own method.

A polynomial through both ends of a step has a lower order than the method, and leaves the constraints. A step
from $t_k$ to the time asked for, $t_k \le t < t_{k+1}$, has the method's own order, ends on the constraints,
meets the recorded states at both ends, and costs what a step costs. It starts from the flow vector that the
run recorded, which carries the slope there. Declared jumps and samples are ends of steps, and so are never
inside one.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._linalg import row
from .._mechanics import State
from .._types import Scalar
from .._xla import in_turn
from ._bundle import Bundle
from ._derivative import moving_in_time
from ._jumps import grain, pending
from ._state_vector import states_of
from ._step import RollingStep


class Dense(eqx.Module):
    """All accepted steps of a run.

    Attributes:
        grasp: The grasp's numbers.
        stepper: What made the steps.
        ts: When each began, then the end of the last one; infinite beyond.
        ys: Flow vectors there.
        count: Number of steps.
    """

    grasp: Bundle
    stepper: RollingStep
    ts: Float[Array, " steps"]
    ys: Float[Array, "steps flow"]
    count: Int[Array, ""]


@eqx.filter_jit
def states_at(dense: Dense, ts: Float[Array, "..."]) -> State:
    """States at any times; not finite before the start and after the end."""
    lay = dense.stepper.lay
    found = in_turn(_vector_at, dense, jnp.ravel(ts))
    found = moving_in_time(lay.width, found, jnp.ravel(ts))
    return states_of(lay, found.reshape(*ts.shape, found.shape[-1]))


def _vector_at(dense: Dense, t: Scalar) -> Array:
    """The flow vector at one time."""
    last = row(dense.ts, dense.count)
    if dense.grasp.sampled and dense.grasp.jumps:
        # At a jump it is the state after the jump, as saved ones are, and after a sample that is due there.
        waits = pending(dense.grasp(), t) & (t <= last)
        t = jnp.where(waits, jnp.minimum(t + 2.0 * grain(t), last), t)
    # The first step has no length: of two that begin at one time the later one carries a slope.
    k = jnp.clip(jnp.searchsorted(dense.ts, t, side="right").astype(dense.count.dtype) - 1, 0, dense.count)
    begin = row(dense.ts, k)
    inside = (t >= begin) & (t <= last)
    end = dense.stepper.advance(dense.grasp, begin, jnp.where(inside, t, begin), row(dense.ys, k))[0]
    return jnp.where(inside, end, jnp.nan)
