r"""Nonlinear least squares for a network inside a field; the only module of `geometry` that imports optax.

The sum of squared residuals $r(N(\varphi_j), q)$ is minimised over the network's weights and a few other
parameters $q$. `_neural_support` and `_neural_curvature` describe theirs as a `NetworkProblem` and call
`descend`. Steps come in chunks of 25, each one compiled loop; between chunks the feet of the points are found
anew (`refresh`), and within one they are constants.

Progress is printed here, not drawn by tqdm as a sweep's is, because it tells how the loss falls.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np

FitProgress = bool | Callable[[int, float], None]
# Steps of one compiled loop.
CHUNK = 25


class NetworkProblem(NamedTuple):
    """Residuals of a field, by way of its network's values: module-level functions, compiled once.

    Attributes:
        angles: `angles(data)`, shape (k,): where the network is needed.
        residuals: `residuals(values, rest, data)`, shape (n,), of the values there and the other parameters.
        refresh: `refresh(network, rest, data)` brings the data's own unknowns (feet) up to date.
    """

    angles: Callable[[Any], Any]
    residuals: Callable[[jax.Array, Any, Any], jax.Array]
    refresh: Callable[[Any, Any, Any], Any]


class Descent(NamedTuple):
    """The best parameters seen with their data, the steps taken, and the loss before each and at the end."""

    network: Any
    rest: Any
    data: Any
    steps: int
    history: np.ndarray


def descend(
    problem: NetworkProblem,
    start: tuple[Any, Any],
    data: Any,
    *,
    steps: int,
    target: float,
    progress: FitProgress = False,
) -> Descent:
    """Minimise the sum of squared residuals: a chunk of Adam, then Levenberg-Marquardt.

    Adam takes part only where it lowers the loss: it carries a poor start into reach. L-BFGS in place of
    Levenberg-Marquardt stalls: on 200 points of an ellipse at 0.2 um after 600 steps, where 100 give 0.02 to
    0.13 um.

    Args:
        problem: What to minimise.
        start: The network and the other parameters, any pytree of floating arrays.
        data: Any pytree of arrays.
        steps: At most so many, rounded up to chunks of 25; ends also where a chunk gains less than a fifth.
        target: Stop once the loss is below this.
        progress: True prints step and loss after every chunk; a function is called with them.
    """
    report = _reporter(progress)
    data = problem.refresh(start[0], start[1], data)
    # The best parameters so far, their loss, the losses of all steps, and the number of steps.
    best, least, history, done = start, float(_loss(problem, start, data)), [], 0
    while done < steps and least > target:
        # A chunk that does not end below the best loss so far, or ends in NaN, is dropped.
        before = least
        data = problem.refresh(best[0], best[1], data)
        chunk = _marquardt if done else _adam
        params, losses = chunk(problem, best, data)
        history.append(np.asarray(losses[:-1]))
        done, last = done + CHUNK, float(losses[-1])
        if last < least:
            best, least = params, last
        report(done, least)
        # Not after the first chunk, which is Adam's and may gain nothing.
        if done > CHUNK and not least < 0.8 * before:
            break
    history.append(np.asarray([least]))
    network, rest = best
    return Descent(network, rest, problem.refresh(network, rest, data), done, np.concatenate(history))


def _reporter(progress: FitProgress) -> Callable[[int, float], None]:
    """What is called with the number of steps and the loss after every chunk."""
    if callable(progress):
        return progress
    return _printed if progress else lambda step, loss: None


def _printed(step: int, loss: float) -> None:
    print(f"step {step}: loss {loss:.3e}")


def _residuals(problem: NetworkProblem, params: tuple[Any, Any], data: Any) -> jax.Array:
    """Residuals by way of the network's values, shape (n,)."""
    network, rest = params
    values = jax.vmap(network)(jnp.asarray(problem.angles(data)))
    return problem.residuals(values, rest, data)


@eqx.filter_jit
def _loss(problem: NetworkProblem, params: tuple[Any, Any], data: Any) -> jax.Array:
    return jnp.sum(_residuals(problem, params, data) ** 2)


@eqx.filter_jit
def _adam(problem: NetworkProblem, params: tuple[Any, Any], data: Any) -> tuple:
    """A chunk of Adam: the parameters, and the loss before every step and at the end."""
    import optax  # here, because it takes 0.2 s to import

    # The rate falls from 1e-3 to a hundredth of that within the chunk.
    method = optax.adam(optax.cosine_decay_schedule(1e-3, CHUNK, alpha=0.01))

    def step(carry: tuple, _: None) -> tuple:
        params, state = carry
        value, slope = jax.value_and_grad(lambda p: _loss(problem, p, data))(params)
        with jax.numpy_dtype_promotion("standard"):  # optax multiplies by how many steps there were
            update, state = method.update(slope, state)
        return (optax.apply_updates(params, update), state), value

    (params, _), losses = jax.lax.scan(step, (params, method.init(params)), None, length=CHUNK)
    return params, jnp.append(losses, _loss(problem, params, data))


def _linearised(problem: NetworkProblem, params: tuple[Any, Any], data: Any) -> tuple[jax.Array, jax.Array]:
    """Residuals and their Jacobian in the flattened parameters, the network's first.

    By the chain rule through the k values of the network, dr/dw = (dr/dN) (dN/dw): a value depends on one
    angle only, so that its gradient is one small backward pass.
    """
    (network, rest), angles = params, jnp.asarray(problem.angles(data))

    def one(angle: jax.Array) -> tuple[jax.Array, jax.Array]:
        value, slope = jax.value_and_grad(lambda n: n(angle))(network)
        return value, jax.flatten_util.ravel_pytree(slope)[0]

    values, inner = jax.vmap(one)(angles)
    right, pull = jax.vjp(lambda v, r: problem.residuals(v, r, data), values, rest)
    outer, others = jax.vmap(pull)(jnp.eye(right.shape[0]))
    others = jax.vmap(lambda tree: jax.flatten_util.ravel_pytree(tree)[0])(others)
    return right, jnp.concatenate([outer @ inner, others], axis=1)


@eqx.filter_jit
def _marquardt(problem: NetworkProblem, params: tuple[Any, Any], data: Any) -> tuple:
    r"""A chunk of Levenberg-Marquardt: the parameters, and the loss before every step and at the end.

    Steps are $-J^\top (J J^\top + \mu I)^{-1} r$, or $-(J^\top J + \mu I)^{-1} J^\top r$: equal, and the
    smaller of both matrices is factorised. $\mu$ is `damping` times the mean of the matrix's diagonal.
    """
    # All parameters as one vector, as the linear algebra wants them.
    start, unravel = jax.flatten_util.ravel_pytree(params)

    def loss(flat: jax.Array) -> jax.Array:
        return _loss(problem, unravel(flat), data)

    def step(carry: tuple, _: None) -> tuple:
        flat, damping = carry
        right, jacobian = _linearised(problem, unravel(flat), data)
        # Shapes are static: which of both systems is smaller is known while tracing.
        wide = jacobian.shape[0] < jacobian.shape[1]
        gram = jacobian @ jacobian.T if wide else jacobian.T @ jacobian
        shift = damping * jnp.trace(gram) / gram.shape[0]
        factor = jax.scipy.linalg.cho_factor(gram + shift * jnp.eye(gram.shape[0]))
        if wide:
            move = jacobian.T @ jax.scipy.linalg.cho_solve(factor, right)
        else:
            move = jax.scipy.linalg.cho_solve(factor, jacobian.T @ right)
        # A step that does not lower the loss is not taken, and the next one is damped more.
        value, tried = jnp.sum(right**2), flat - move
        better = loss(tried) < value  # false where the factorisation failed, since the step is NaN then
        damping = jnp.clip(jnp.where(better, 0.2 * damping, 10.0 * damping), 1e-13, 1e3)
        return (jnp.where(better, tried, flat), damping), value

    (flat, _), losses = jax.lax.scan(step, (start, jnp.asarray(1e-5)), None, length=CHUNK)
    return unravel(flat), jnp.append(losses, loss(flat))
