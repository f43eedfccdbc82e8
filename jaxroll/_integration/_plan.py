"""How a run goes, and what it leaves behind."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._results import RESULTS
from .._types import Scalar, Times
from ._events import decode
from ._state_vector import Flow
from ._step import RollingStep
from ._step_size import at_rest, Pace, StopAt


class Plan(eqx.Module):
    """How to run: solver, step sizes, times."""

    stepper: RollingStep
    controller: diffrax.AbstractStepSizeController
    t0: Float[Array, ""]
    t1: Float[Array, ""]
    ts: Times
    dt0: Float[Array, ""]
    progress: diffrax.AbstractProgressMeter
    max_steps: int = eqx.field(static=True)

    def at_rest(self, y0: Flow) -> Pace:
        """The pace before the first step."""
        start = (None, self.t0, self.t1, y0, self.dt0, None, None, self.stepper.error_order)
        _, inner = self.controller.init(*start)  # pyright: ignore
        return at_rest(jax.tree.map(jnp.asarray, inner), self.t0)

    def control(self, pace: Pace, dip: Scalar = jnp.inf) -> StopAt:
        """Step-size control that goes on at a pace; `dip` is where the margin of the last step dips."""
        return StopAt(self.controller, pace, self.dt0, dip, self.max_steps, self.stepper.lay.margin)


class Path(eqx.Module):
    """What a run left behind.

    Attributes:
        saved: Flow vectors at `ts`; not finite where the run did not get there.
        last: Flow vector where the run ended.
        t_last: When it ended.
        steps: Attempted, accepted and rejected steps.
        result: Result code.
    """

    saved: Float[Array, "t flow"]
    last: Flow
    t_last: Float[Array, ""]
    steps: Int[Array, "3"]
    result: RESULTS


def path_of(saved: Array, last: Flow, t_last: Scalar, counts: tuple[Array, Array, Array]) -> Path:
    """What a loop left; `counts` are attempted and accepted steps, and the number of diffrax's code."""
    attempted, accepted, number = (x.astype(int) for x in counts)
    steps = jnp.stack([attempted, accepted, attempted - accepted])
    code = eqx.tree_at(lambda r: r._value, diffrax.RESULTS.successful, number.astype(jnp.int32))
    return Path(saved, last, t_last, steps, decode(last[-2], last[-1], code))
