r"""A law that is asked at samples only, as a computer asks it: between two samples the torques are held.

Its memory is what makes the held torques part of the state: the memory of the law inside, the torques, and
the time of the next sample. Between samples none of it changes, so that a run integrates a smooth right-hand
side; its steps end at samples, where `_motion/_sampling` puts in what the law says there.
"""

from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._fields import real, taken, through
from .._linalg import scalars
from .._mechanics import AbstractController, Torques
from .._results import check_positive, concrete, shown
from .._types import Given, resolution, Scalar, Scalars
from ._sensing import Sensed
from ._user import as_controller, as_law


def _as_spread(name: str, value: Array) -> Array:
    """The number, if it is not negative."""
    seen = concrete(value)
    if seen is not None and not seen >= 0:
        raise ValueError(f"argument {name} must be zero or more, but was {shown(value)}")
    return value


def _as_key(name: str, value: Any) -> Any:
    """A key of `jax.random` as the numbers in it, which any program may carry; None without noise."""
    if value is None:
        return None
    # `Sampled.noise` draws from the numbers as from a key of the kind that JAX is set to.
    kind = jax.config.jax_default_prng_impl  # pyright: ignore[reportAttributeAccessIssue]
    key, own = value, kind
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        key, own = jax.random.key_data(value), str(jax.random.key_impl(value))
    if not eqx.is_array(key) or key.dtype != jnp.uint32 or key.ndim != 1:
        raise ValueError(f"argument {name} must be one key of jax.random, but was {shown(value)}")
    if own != kind or key.shape != jax.eval_shape(lambda: jax.random.key_data(jax.random.key(0))).shape:
        raise ValueError(
            f"argument {name} must be one key of jax.random of the kind that jax_default_prng_impl names, "
            f"{kind}, but was {shown(value)}"
        )
    return jnp.asarray(key)


class Sampled(AbstractController):
    r"""A law under zero-order hold: asked at $t_k = t_0 + k T$, its torques are held until $t_{k+1}$.

    A run ends a step at every sample: the hold is exact, the method keeps its order, and a derivative with
    respect to the period, the first sample or anything in the law is right. What is held is a part of the
    state (`states.memory`: the memory of the law inside, the torques, the time of the next sample [s]), so
    that a run that goes on from a saved state goes on with what was held there. Before the first sample
    torques are zero; a state without memory begins with a sample, unless the first one is yet to come. At
    a declared jump, such as a blow, samples are taken after it, also where a run begins there.

    Between samples a law inside with a memory is at rest: that of `Integral` moves at samples by the period
    times its rate (Euler's step), and a function of your own returns as its second result the memory of the
    next sample itself.

    Args:
        law: The controller that is asked, any that a grasp takes.
        period: $T$ [s], positive.
        first: $t_0$ [s].
        angle_noise: Standard deviation of what is added to every joint angle at a sample [rad; of a jaw m].
            The law gets tips that fit these angles. Default: none, and then it costs nothing.
        rate_noise: The same for joint rates [rad/s; m/s].
        key: Key of `jax.random`, needed for noise. Sample k draws from the key folded with k: the noise does
            not depend on the steps between samples, and each lane with a key of its own has its own noise.

    Every sample ends a step: `max_steps` must be above the number of samples in a run.

    Raises:
        ValueError: If an argument is not what it must be, or the law is sampled itself. A grasp refuses noise
            without a key.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> slow = grasp.with_(controller=jxr.control.Sampled(grasp.controller, 0.001))
        >>> run = jxr.simulate(slow, state, 0.5)
        >>> run.states.memory.shape  # two torques, and when the next sample is
        (301, 3)
    """

    sampled: ClassVar[bool] = True

    law: Any = through(as_law)
    period: Float[Array, ""] = real(check=check_positive)
    first: Float[Array, ""] = real()
    angle_noise: Float[Array, ""] | None = real(check=_as_spread, optional=True)
    rate_noise: Float[Array, ""] | None = real(check=_as_spread, optional=True)
    key: Any = through(_as_key)

    def __init__(
        self,
        law: Any,
        period: Given,
        *,
        first: Given = 0.0,
        angle_noise: Given | None = None,
        rate_noise: Given | None = None,
        key: Any = None,
    ) -> None:
        self.law = taken(self, "law", law)
        self.period = taken(self, "period", period)
        self.first = taken(self, "first", first)
        self.angle_noise = taken(self, "angle_noise", angle_noise)
        self.rate_noise = taken(self, "rate_noise", rate_noise)
        self.key = taken(self, "key", key)

    def check(self, fingers: int, axes: int) -> None:
        as_controller(self.law).check(fingers, axes)
        if self.key is None and self.noisy:
            raise ValueError("argument key must be a key of jax.random where there is noise, but was None")

    def check_freedoms(self, free: int) -> None:
        as_controller(self.law).check_freedoms(free)

    def initial_memory(self, joints: tuple[int, ...]) -> Float[Array, " k"]:
        inner = as_controller(self.law).initial_memory(joints)
        own = jnp.concatenate([jnp.zeros(sum(joints)), self.first[None]])
        return own if inner is None else jnp.concatenate([inner, own.astype(inner.dtype)])

    def torques(self, t: Scalar, fingers: Sequence[Sensed]) -> Torques:
        return as_controller(self.law).torques(t, fingers)

    def driven(self, t: Scalar, fingers: Sequence[Sensed], memory: Scalars) -> tuple[Torques, Scalars]:
        if not memory:
            return self.torques(t, fingers), ()
        torques = self.held(memory, tuple(len(f.angles) for f in fingers))
        return torques, (jnp.zeros_like(memory[-1]),) * len(memory)

    def held(self, memory: Scalars, joints: tuple[int, ...]) -> Torques:
        """The torques in a memory, finger by finger."""
        flat, found = list(memory[len(memory) - 1 - sum(joints) : -1]), []
        for count in joints:
            found.append(tuple(flat[:count]))
            flat = flat[count:]
        return tuple(found)

    @property
    def noisy(self) -> bool:
        """Whether noise is added to what is measured."""
        return self.angle_noise is not None or self.rate_noise is not None

    def due(self, t: Scalar, memory: Scalars) -> Scalar:
        """Whether the next sample is at this time, or overdue."""
        return jax.lax.stop_gradient(memory[-1]) <= t + resolution(t)

    def number(self, t: Scalar) -> Scalar:
        """The number of the sample that is due, counted from zero; the last one's if several are overdue."""
        t, first, period = jax.lax.stop_gradient((t, self.first, self.period))
        return jnp.floor((t + resolution(t) - first) / period)

    def noise(self, number: Scalar, count: int) -> tuple[Scalars, Scalars]:
        """What is added to `count` joint angles and as many rates at the sample of this number."""
        key = jax.random.fold_in(jax.random.wrap_key_data(self.key), number.astype(jnp.uint32))
        drawn = scalars(jax.random.normal(key, (2 * count,), number.dtype))
        sizes = (0.0 if size is None else size for size in (self.angle_noise, self.rate_noise))
        angles, rates = (
            tuple(size * x for x in part)
            for size, part in zip(sizes, (drawn[:count], drawn[count:]), strict=True)
        )
        return angles, rates

    def sample(self, t: Scalar, fingers: Sequence[Sensed], memory: Scalars, number: Scalar) -> Scalars:
        """The memory after a sample."""
        inner = memory[: len(memory) - 1 - sum(len(f.angles) for f in fingers)]
        torques, inner = as_controller(self.law).stepped(t, fingers, inner, self.period)
        following = self.first + (number + 1.0) * self.period
        return (*inner, *(u for us in torques for u in us), following)

    def potential(self, tips: Sequence[Any], angles: Sequence[Scalars]) -> Scalar:
        # Torques that are held derive from no potential: all of their power counts as work.
        return jnp.zeros_like(tips[0].x)
