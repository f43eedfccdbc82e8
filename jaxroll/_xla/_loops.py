"""Loops from which XLA moves nothing.

XLA's simplification goes over a program until nothing changes any more. Out of every loop it moves what does
not change in it, turn constants included, then folds and sinks the constants again, loop by loop and one
level a pass: a run of a spatial pinch took eleven passes over the whole program, a fifth of its compilation,
for machine code that is no faster. So a loop here hands on what it is given (`held`) through a barrier in
every turn, so that XLA takes it for changing, and counts up to a number that stands in its condition.

Where the condition depends on one number of the state alone, XLA takes that for a counter, and several of its
passes copy all of a turn that leads to its next value, to find out how many turns there will be: a tenth of
the compilation of that run. So the condition looks at a second one too (`allowed`), which is always true.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp


def repeated(going: Callable[[Any], Any], turn: Callable[[Any, Any], Any], start: Any, held: Any) -> Any:
    """`jax.lax.while_loop` from `start`: `turn(carry, held)` as long as `going(carry)`.

    Args:
        going: Whether there is another turn.
        turn: The next carry.
        start: The first carry.
        held: A pytree that every turn reads, and none changes. XLA would move what `turn` closes over
            instead.
    """
    arrays, still = eqx.partition(held, eqx.is_array)

    def step(state: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
        carry, arrays, allowed = state
        arrays, allowed = jax.lax.optimization_barrier((arrays, allowed))
        return turn(carry, eqx.combine(arrays, still)), arrays, allowed

    more = lambda state: going(state[0]) & state[2]  # noqa: E731
    return jax.lax.while_loop(more, step, (start, arrays, jnp.asarray(True)))[0]


def counted(count: int, turn: Callable[[Any, Any, Any], Any], start: Any, held: Any) -> Any:
    """`repeated`, a fixed number of turns: `turn(i, carry, held)` with i = 0, 1, ..., `count` - 1."""
    after = lambda state, held: (state[0] + 1, turn(state[0], state[1], held))  # noqa: E731
    return repeated(lambda state: state[0] < count, after, (jnp.asarray(0), start), held)[1]
