r"""Samples of a controller (`control.Sampled`), and what its memory begins with.

Between samples the torques are a part of the state, at rest. At a sample they change by $\delta u$, and with
them, at the same positions and velocities, the accelerations by

$$ \delta \dot v = M^{-1} (\delta u + A^T \delta\mu), \qquad
   A M^{-1} A^T\, \delta\mu = -A M^{-1}\, \delta u, $$

which the factors of the step's last evaluation give: a sample takes no evaluation of the equations of
motion. The step that ends there carries the slope before it, the next one begins with the slope after it.

If the sample comes $\delta$ later, the law sees $x + \delta f_-$ at $t + \delta$. The motion after it has the
slope $f_+$ and, continued back to $t$, begins at $x + \delta (f_- - f_+)$. With these terms derivatives with
respect to period and first sample are right: $\delta$ is a zero that has the derivative of the planned time.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._linalg import factorise, inner, minus, solve, stacked, total
from .._mechanics import Blocks, Grasp, Leaves, State, to_leaves
from .._results import computed_at_once, traced
from .._types import resolution, Scalar, Scalars
from ..control import joint_angles, sense
from ._equations import bodies
from ._linearisation import apply_jacobian, balance, combine, Linearisation, negative, respond


class Sample(NamedTuple):
    """What a sample does.

    Attributes:
        memory: The memory after it.
        gained: What it adds to the accelerations, body by body.
        power: What it adds to the power of the torques [W].
        late: A zero with the derivative of the time that it was planned for [s].
    """

    memory: Scalars
    gained: Blocks
    power: Scalar
    late: Scalar


def check_due(grasp: Grasp, state: State, t0: Scalar) -> None:
    """Raise where the next sample that a state waits for is more than a period away.

    Such a state is one of another time, and its torques would be held that long. A first sample may be
    as far away as one likes.
    """
    law = grasp.controller
    if not grasp.form.sampled or state.memory is None or traced((law, state, t0)):
        return
    with computed_at_once():
        due, latest = float(state.memory[-1]), float(t0 + law.period)
        rounding = float(resolution(t0 + law.period))
    if due > max(latest, float(law.first)) + rounding:
        raise ValueError(
            f"argument t0 must be at most the period of {float(law.period):g} s before the next sample of "
            f"the state, at {due:g} s, but was {float(t0):g} s"
        )


def begun(grasp: Grasp, state: State, t0: Scalar, *, waits: Scalar | None = None) -> State:
    """The state at the start of a run whose controller has a memory: with its own memory, or the initial one.

    If a sample is due there, it is taken. Where it `waits` for a jump at the start, such as a blow, its
    torques are held until then, for contacts to be pressed by, and the sample is taken after it.
    """
    memory, first = state.memory, grasp.memory
    if memory is None:
        assert first is not None
        memory = first.astype(state.q.dtype)
    if grasp.form.sampled:
        leaves = to_leaves(State(state.q, state.v, state.s, memory), grasp.form)
        due = grasp.controller.due(t0, leaves.memory)
        after = stacked(_asked(grasp, t0, leaves))
        if waits is not None:
            pressing = slice(-1 - sum(finger.joints for finger in grasp.fingers), -1)
            held = memory.at[pressing].set(after[pressing]).at[-1].set(jax.lax.stop_gradient(t0))
            after = jnp.where(waits, held, after)
        memory = jnp.where(due, after, memory)
    return State(state.q, state.v, state.s, memory)


def memory_after_sample(grasp: Grasp, t: Scalar, state: State) -> Array:
    """The memory of a state after a sample, without noise."""
    noise = lambda g: (g.controller.angle_noise, g.controller.rate_noise)  # noqa: E731
    quiet = eqx.tree_at(noise, grasp, (None, None), is_leaf=lambda x: x is None)
    return stacked(_asked(quiet, t, to_leaves(state, grasp.form)))


def memory_waiting(grasp: Grasp, t: Scalar, state: State) -> Array:
    """The memory of a state that was followed back to a time [s]: it waits for the next sample there."""
    law, memory = grasp.controller, state.memory
    assert memory is not None
    following = law.first + (jnp.maximum(law.number(t), -1.0) + 1.0) * law.period
    return memory.at[-1].min(following)


def _asked(grasp: Grasp, t: Scalar, leaves: Leaves) -> Scalars:
    """The memory after a sample at a time [s]."""
    law = grasp.controller
    number = law.number(t)
    counts = [finger.joints for finger in grasp.fingers]
    angles, rates = joint_angles(grasp, leaves.q), leaves.v[1:]
    q, v = leaves.q[1:], leaves.v[1:]
    if law.noisy:
        more = law.noise(number, sum(counts))
        angles, rates = _beside(angles, more[0]), _beside(rates, more[1])
        # Tips are computed from the measured angles. Positions of a finger that are no joints have no noise.
        q = tuple((*new, *block[len(new) :]) for new, block in zip(angles, q, strict=True))
        v = rates
    motions = [f.motion(place, rate, None)[0] for f, place, rate in zip(grasp.fingers, q, v, strict=True)]
    fingers = [sense(*each) for each in zip(motions, angles, rates, strict=True)]
    return law.sample(t, fingers, leaves.memory, number)


def _beside(blocks: tuple[Scalars, ...], more: Scalars) -> tuple[Scalars, ...]:
    """Blocks of numbers with others added, one by one."""
    rest = iter(more)
    return tuple(tuple(x + next(rest) for x in block) for block in blocks)


def sample_due(
    grasp: Grasp, t: Scalar, leaves: Leaves, rates: Leaves, *, line: Linearisation, waits: Scalar = False
) -> Sample:
    """The sample that is due at a time, or one that changes nothing.

    `rates` is the slope before it and `line` has the linearised constraints there. With `waits` something
    else comes first, and no sample is taken yet.
    """
    law, joints = grasp.controller, tuple(finger.joints for finger in grasp.fingers)
    due = law.due(t, leaves.memory) & jnp.logical_not(waits)
    planned = leaves.memory[-1]
    late = jnp.where(due, planned - jax.lax.stop_gradient(planned), 0.0)
    ahead = lambda blocks, slopes: combine(blocks, slopes, late)  # noqa: E731
    met = Leaves(ahead(leaves.q, rates.q), ahead(leaves.v, rates.v), leaves.s, leaves.memory)
    each = zip(_asked(grasp, t + late, met), leaves.memory, strict=True)
    memory = tuple(jnp.where(due, new, old) for new, old in each)
    before, after = (law.held(m, joints) for m in (leaves.memory, memory))
    change = [tuple(map(minus, *both)) for both in zip(after, before, strict=True)]
    _, inertias = bodies(grasp, leaves)
    free = ((0.0,) * grasp.sizes[0],)
    free += tuple(solve(factorise(i.mass), du) for i, du in zip(inertias[1:], change, strict=True))
    forces = balance(line, negative(apply_jacobian(grasp, line, free)))
    power = total([inner(du, v) for du, v in zip(change, leaves.v[1:], strict=True)])
    return Sample(memory, combine(free, respond(grasp, line, forces)), power, late)
