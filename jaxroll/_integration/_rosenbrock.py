r"""A Rosenbrock method for long runs: fast rates that have died out do not limit the step.

diffrax's implicit methods iterate on nonlinear stages and call LAPACK. A Rosenbrock method instead solves one
linear system per stage, all with one matrix $I/(h\gamma) - J$, which is inverted once per step by operations
that stay in the single kernel of a run. `_step` runs `advance` on flow vectors; `Rosenbrock.step` offers the
same to any problem of diffrax.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from .._linalg import row, total, weighted_sum, with_row_selected
from .._types import Scalar
from .._xla import VECTOR

# (t, x) to the derivative of x, and whatever else is wanted of a step's last evaluation.
Field = Callable[[Array, Array], tuple[Array, Array]]
# The field, the inverse of I/(h gamma) - J by columns, and df/dt at a step's start.
Linear = tuple[Array, Array, Array]


class Rosenbrock(diffrax.AbstractAdaptiveSolver[Any]):
    r"""Rodas5P: a linearly implicit, L-stable method of order 5 with 8 stages, for runs of seconds and more.

    Joint damping on light links makes rates of several hundred per second. They die out at once, but limit
    the steps of an explicit method for the whole run. This one solves, with one matrix a step,

    $$\left(\frac{I}{h\gamma} - J\right) u_i = f(t + c_i h, x + \sum_j a_{ij} u_j)
        + \sum_j \frac{c_{ij}}{h} u_j + h d_i \partial_t f, \qquad x_1 = x + \sum_i b_i u_i,$$

    with $J = \partial f / \partial x$ at the start of the step from forward differences: one evaluation for
    every component of x. A step of the pinch so costs as much as two of `diffrax.Dopri8`, but a
    run that settles takes a small part of the steps, at rtol 1e-4 21 instead of 529 of `diffrax.Tsit5` in
    2 s: choose it where the motion is slow but for its first moments, for batches too.
    Steps end at the times of saved states, so save few. Short or undamped runs, and errors below 1e-9, are
    better off with the default.

    The error estimate is $u_8$. The differences leave an error of 1e-7 of its norm in J, which costs no
    accuracy but lets the steps of equal runs differ in the third digit, and below rtol 1e-9 makes more of
    them. Any diffrax problem with a small state may use the method. Between its steps diffrax has a cubic by
    their ends and slopes, whose error is of fourth order in the step. Derivatives of a run with respect to
    its grasp and start go through, in both modes.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pinch()
        >>> run = jxr.simulate(grasp, state, 20.0, ts=1, solver=jxr.Rosenbrock())
        >>> int(run.stats.steps) < 300  # an explicit method takes thousands
        True

    Source: G. Steinebach, "Construction of Rosenbrock-Wanner method Rodas5P and numerical benchmarks within
    the Julia Differential Equations package", BIT Numerical Mathematics 63, 27 (2023).
    """

    term_structure: ClassVar[Any] = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Any] = diffrax.ThirdOrderHermitePolynomialInterpolation

    def order(self, terms: diffrax.AbstractTerm[Any, Any]) -> int:
        """Order of the method."""
        return 5

    def error_order(self, terms: diffrax.AbstractTerm[Any, Any] | None) -> int:
        """Order of the error estimate, as step-size controllers want it."""
        return 5

    def init(self, terms: diffrax.AbstractTerm[Any, Any], t0: Any, t1: Any, y0: Any, args: Any) -> None:
        """Nothing is kept between steps."""
        return None

    def func(self, terms: diffrax.AbstractTerm[Any, Any], t0: Any, y0: Any, args: Any) -> Any:
        """The vector field."""
        return terms.vf(t0, y0, args)

    def step(
        self,
        terms: diffrax.AbstractTerm[Any, Any],
        t0: Any,
        t1: Any,
        y0: Any,
        args: Any,
        solver_state: None,
        made_jump: Any,
    ) -> tuple[Any, Any, dict[str, Any], None, diffrax.RESULTS]:
        """One step, as diffrax wants it."""
        x0, back = ravel_pytree(y0)
        nothing = jnp.zeros(0, x0.dtype)
        field = lambda t, x: (ravel_pytree(terms.vf(t, back(x), args))[0], nothing)  # noqa: E731
        x1, rates, error, _, _ = advance(field, (jnp.asarray(t0), jnp.asarray(t1)), x0, nothing)
        y1 = back(x1)
        k0, k1 = (back((t1 - t0) * slope) for slope in (field(t0, x0)[0], rates))
        between = {"y0": y0, "y1": y1, "k0": k0, "k1": k1}
        return y1, back(error), between, None, diffrax.RESULTS.successful


def advance(
    at: Field,
    times: tuple[Array, Array],
    x0: Array,
    nothing: Array,
    *,
    kept: slice = slice(0),
) -> tuple[Array, Array, Array, Array, Array]:
    """One step: its end, the derivative there, the error estimate, and what else the last evaluation gave.

    As the fifth result the part `kept` of what else each stage's evaluation gave, shape (8, ...). Lanes, if
    any, lie along the last axis of everything.

    Args:
        at: From (t, x) to the derivative of x, and a vector of whatever else is wanted.
        times: Start and end of the step.
        x0: State at the start, shape (n,) or (n, lanes).
        nothing: Of the shape of what `at` gives besides the derivative.
        kept: Which part of what `at` gives besides the derivative is wanted of all stages.
    """
    t0, h = times[0], times[1] - times[0]
    moving = h != 0
    h, moving = jnp.where(moving, h, 1.0)[None], moving[None]
    rows, slopes, lags, moments = (jnp.asarray(x, x0.dtype) for x in (_ROWS, _SLOPES, _LAGS, STAGE_TIMES))

    def next_place(k: Scalar, u: Array, line: Linear) -> tuple[Array, Array, Array]:
        # (I/(h gamma) - J) u_k = f + sum_j c_kj u_j / h + h d_k df/dt. Its f is the last evaluation; then
        # comes the place of the next stage, after the last stage the step's end. Entries of u that are not
        # known yet are zero, and have zero weight.
        rates, inverse, in_time = line
        right = rates + weighted_sum(row(slopes, k), u) / h + h * row(lags, k) * in_time
        u = with_row_selected(u, weighted_sum(right[:, None], inverse), k)
        # A step of no length stays where it is, whatever its stages say.
        x = x0 + jnp.where(moving, weighted_sum(row(rows, k + 1), u), 0.0)
        return u, t0 + (times[1] - t0) * row(moments, k + 1), x

    stages = _with_samples if t0.ndim == 0 and x0.shape[0] > _FEW else _after_samples
    u, rates, end, parts, x1 = stages(at, t0, x0, nothing, h=h, next_place=next_place, kept=kept)
    error = weighted_sum(_ERROR, u)
    # If the matrix is singular, u is not finite. An infinite error makes the step shorter, with another
    # matrix.
    error = jnp.where(jnp.isfinite(error), error, jnp.inf)
    return x1, rates, jnp.where(moving, error, 0.0), end, parts


def _after_samples(
    at: Field, t0: Array, x0: Array, nothing: Array, *, h: Array, next_place: Callable, kept: slice
) -> tuple[Array, ...]:
    """All stages: u, the last evaluation, what else it gave, the part of that of each stage, and the end.

    `h` is the length of the step; `next_place` has the formulas of a stage.
    """
    nudges, size = _nudges(x0, t0)
    rates, *rest = _linearised(_samples(at, t0, x0, nudges), size, h)

    def stage(k: Scalar, carry: tuple[Array, ...]) -> tuple[Array, ...]:
        u, rates, _, parts, _ = carry
        u, t, x = next_place(k, u, (rates, *rest))
        rates, end = at(t, x)
        return u, rates, end, with_row_selected(parts, end[kept], k), x

    u, parts = _no_stages(x0, nothing[kept])
    return jax.lax.fori_loop(0, _STAGES, stage, (u, rates, nothing, parts, x0))


def _with_samples(
    at: Field, t0: Array, x0: Array, nothing: Array, *, h: Array, next_place: Callable, kept: slice
) -> tuple[Array, ...]:
    """The same of one lane, samples and stages in one loop: the equations of motion are compiled once."""
    nudges, size = _nudges(x0, t0)
    n, count = x0.shape[0], nudges.shape[0]

    def turn(i: Scalar, carry: tuple[Any, ...]) -> tuple[Any, ...]:
        samples, line, u, rates, _, parts, _ = carry
        k = jnp.maximum(i - count, 0)
        line = jax.lax.cond(i == count, lambda: _linearised(samples, size, h), lambda: (rates, *line[1:]))
        u, t, x = jax.lax.cond(
            i < count,
            lambda: (u, t0 + row(nudges, i)[n], x0 + row(nudges, i)[:n]),
            lambda: next_place(k, u, line),
        )
        rates, end = at(t, x)
        # The row after the samples takes the evaluations of the stages, which are no samples.
        samples = with_row_selected(samples, rates, jnp.minimum(i, count))
        return samples, line, u, rates, end, with_row_selected(parts, end[kept], k), x

    zero = jnp.zeros_like(x0)
    samples, inverse = (jnp.zeros((rows, *x0.shape), x0.dtype) for rows in (count + 1, n))
    u, parts = _no_stages(x0, nothing[kept])
    start = (samples, (zero, inverse, zero), u, zero, nothing, parts, x0)
    return jax.lax.fori_loop(0, count + _STAGES, turn, start)[2:]


def _no_stages(x0: Array, part: Array) -> tuple[Array, Array]:
    """Before the first stage: the u of all stages, and what is kept of each."""
    return jnp.zeros((_STAGES, *x0.shape), x0.dtype), jnp.zeros((_STAGES, *part.shape), part.dtype)


def _samples(at: Field, t0: Array, x0: Array, nudges: Array) -> Array:
    """The field at all nudged places: of one lane in one evaluation, padded to whole vectors.

    With many lanes, which fill the vectors already, one place after the other.
    """
    n, idle = x0.shape[0], -nudges.shape[0] % VECTOR
    sample = lambda nudge: at(t0 + nudge[n], x0 + nudge[:n])[0]  # noqa: E731
    if t0.ndim:
        return jax.lax.map(sample, nudges)
    padded = jnp.pad(nudges, ((0, idle), (0, 0)))
    return jax.vmap(sample, in_axes=1, out_axes=1)(padded.T)[:, : nudges.shape[0]].T


def _linearised(samples: Array, size: Array, h: Array) -> Linear:
    """The field f at a step's start, the inverse of I/(h gamma) - J by columns, and df/dt.

    From n + 2 samples of the field: at the start, with each component of x moved a little, and with t moved.
    `slopes` then holds the columns of J as rows, and so does the inverse with its own.
    """
    n, samples = samples.shape[1], samples[: size.shape[0] + 1]
    slopes = (samples[1:] - samples[:1]) / size[:, None]
    identity = jnp.eye(n, dtype=samples.dtype).reshape(n, n, *(1,) * (samples.ndim - 2))
    return samples[0], inverted(identity / (h[None] * _GAMMA) - slopes[:n]), slopes[n]


def _nudges(x0: Array, t0: Array) -> tuple[Array, Array]:
    """Where the field is sampled, less (x, t) of a step's start, and the lengths of these differences.

    In each component of x, and in t: sqrt(eps) of its size.
    """
    n = x0.shape[0]
    here = jax.lax.stop_gradient(jnp.concatenate([x0, t0[None].astype(x0.dtype)]))
    size = np.sqrt(np.finfo(x0.dtype).eps) * jnp.maximum(jnp.abs(here), _LEAST)
    unit = jnp.eye(n + 2, n + 1, -1, x0.dtype).reshape(n + 2, n + 1, *(1,) * t0.ndim)
    return unit * size[None], size


@jax.custom_jvp
def inverted(matrix: Array) -> Array:
    """Inverse of small matrices, shape (n, n) or (n, n, lanes), by Gauss-Jordan in place.

    Without pivoting: the accuracy that this loses is small beside the error of the differences, and where a
    pivot vanishes, `advance` asks for a shorter step.
    """
    n = matrix.shape[0]
    index = jnp.arange(n).reshape(n, *(1,) * (matrix.ndim - 1))

    def eliminate(j: Scalar, a: Array) -> Array:
        # Row j is divided by its pivot, and its multiples subtracted from the others to clear their column j,
        # which then holds the j-th column of the inverse. Masks, for JAX may make scatters of updates in
        # place.
        pivots, column = row(a, j), _column(a, j)
        here, across = index == j, index[:, 0] == j
        unit = jnp.where(across, 1.0, pivots) / row(pivots, j)[None]
        rest = jnp.where(here[:, 0][None], 0.0, a) - column[:, None] * unit[None]
        return jnp.where(here, unit[None], rest)

    return jax.lax.fori_loop(0, n, eliminate, matrix)


@inverted.defjvp
def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    # d(W^-1) = -W^-1 dW W^-1.
    inverse = inverted(primals[0])
    return inverse, -_product(inverse, _product(tangents[0], inverse))


def _product(left: Array, right: Array) -> Array:
    """Matrix product as a sum of outer products: a library's would break up the kernel of a run."""
    return total([left[:, k][:, None] * right[k][None] for k in range(left.shape[1])])


def _column(matrix: Array, j: Scalar) -> Array:
    """Column j >= 0."""
    return jax.lax.dynamic_index_in_dim(matrix, j, 1, keepdims=False, allow_negative_indices=False)


# Smallest size that is taken for a component in `_nudges` [m, rad, m/s, rad/s, s].
_LEAST = 0.1
_GAMMA = 0.21193756319429014
# Coefficients of Rodas5P in the form for the u_i, which needs no product with J. _A holds the a_ij, _C the
# c_ij and _LAGS the d_i of the formula in `Rosenbrock`. Row i of _ROWS leads to stage i, the last one to the
# step's end; the last three evaluations share a row of _A, and each adds the u of the stage before.
_A = (
    (3.0,),
    (2.849394379747939, 0.45842242204463923),
    (-6.954028509809101, 2.489845061869568, -10.358996098473584),
    (2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641),
    (-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946),
)
_C = (
    (-14.155112264123755,),
    (-17.97296035885952, -2.859693295451294),
    (147.12150275711716, -1.41221402718213, 71.68940251302358),
    (165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306),
    (24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125, -0.6610691825249471),
    (30.91273214028599, -3.1208243349937974, 77.79954646070892, 34.28646028294783)
    + (-19.097331116725623, -28.087943162872662),
    (37.80277123390563, -3.2571969029072276, 112.26918849496327, 66.9347231244047)
    + (-40.06618937091002, -54.66780262877968, -9.48861652309627),
)
_ENDS = (_A[-1] + (1.0,), _A[-1] + (1.0, 1.0), _A[-1] + (1.0, 1.0, 1.0))
_ROWS = np.array([row + (0.0,) * (8 - len(row)) for row in ((), *_A, *_ENDS)])
_SLOPES = np.array([row + (0.0,) * (8 - len(row)) for row in ((), *_C)])
# When the stages are evaluated, as a share of the step; the first is its start.
STAGE_TIMES = np.array(
    [0.0, 0.6358126895828704, 0.4095798393397535, 0.9769306725060716, 0.4288403609558664, 1.0, 1.0, 1.0, 1.0]
)
_LAGS = np.array(
    [_GAMMA, -0.42387512638858027, -0.3384627126235924, 1.8046452872882734, 2.325825639765069, 0.0, 0.0, 0.0]
)
_ERROR = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
_STAGES = len(_ERROR)
# Up to so many components of x the samples of a single run are taken side by side, in a program of their own.
# Planar runs take half to two thirds of the time that way, and compile in 2 s instead of 1 (pivoted) or 5 s
# instead of 2 (pinch); the spatial pinch, of 37 components, would take two thirds too, but 30 s instead of 7.
# With many lanes one loop for samples and stages would be slower by a third.
_FEW = 24
