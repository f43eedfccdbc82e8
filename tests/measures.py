"""What tests and benchmarks measure of any function: the order of its errors, its slope and its gradients."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np


def programs(caplog):
    """Names of the programs that were compiled where `jax.log_compiles` told it, such as `jit(_run)`."""
    return [line.split()[1] for line in caplog.messages if line.startswith("Compiling ")]


def observed_order(sizes, errors):
    """Slope of log error over log size."""
    return np.polyfit(np.log(sizes), np.log(errors), 1)[0]


def taylor_remainders(function, point, direction, slope, steps):
    """|f(x + h d) - f(x) - h f'(x) d| for each step h."""
    base = function(point)
    move = lambda h: jax.tree.map(lambda a, b: a + h * b, point, direction)  # noqa: E731
    return np.array([float(abs(function(move(h)) - base - h * slope)) for h in steps])


def both_slopes(function):
    """A compiled function of (x, direction): a scalar, its derivative along the direction, and its gradient.

    As `both_ways` has them; and along one direction, since a derivative along each axis costs as much again.
    """
    found = both_ways(function)
    return lambda x, direction=None: found(x, jnp.ones_like(x) if direction is None else direction, 1.0)


def both_ways(function):
    """A compiled function of (x, direction, bar): a value, its derivative along the direction, x's cotangent.

    Forwards and backwards, of one linearisation, `jax.linearize` and its transpose, so that what leads to
    the value is compiled once. `bar` is the cotangent of the value.
    """

    @jax.jit
    def found(x, direction, bar):
        value, push = jax.linearize(function, x)
        (slopes,) = jax.linear_transpose(push, x)(bar)
        return value, push(direction), slopes

    def floating(x):
        # What JAX traces, as under `vmap`, NumPy cannot take; of the rest it makes no program for each shape.
        return jnp.asarray(x, float) if isinstance(x, jax.Array) else np.asarray(x, float)

    return lambda *given: found(*jax.tree.map(floating, given))


def gradients_with_and_without_an_end(observed, grasp, state):
    """Gradients in a finger's lengths of what `observed(grasp, ts, states)` says of two states.

    Of three states in all the last one is there, and then it is NaN, as a run leaves it that ended before.
    """
    ts, rows = np.zeros(3), jax.tree.map(lambda x: np.stack([x, x, x]), state)

    def total(lengths, rows):
        longer = eqx.tree_at(lambda g: g.fingers[0].lengths, grasp, lengths)
        return sum(jnp.sum(x[:2]) for x in jax.tree.leaves(observed(longer, ts, rows)))

    cut = jax.tree.map(lambda x: np.concatenate([x[:2], np.full_like(x[2:], np.nan)]), rows)
    slope = jax.jit(jax.grad(total))
    return [slope(grasp.fingers[0].lengths, each) for each in (rows, cut)]


def runge_kutta_step(slope, y, h):
    """A step of the classic method of Runge and Kutta, of fourth order, for y' = slope(y)."""
    first = np.asarray(slope(y))
    second = np.asarray(slope(y + 0.5 * h * first))
    third = np.asarray(slope(y + 0.5 * h * second))
    fourth = np.asarray(slope(y + h * third))
    return y + h / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
