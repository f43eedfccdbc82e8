"""`identify`: numbers of a grasp from what was measured of one run, by least squares, and how sure they are.

Gauss and Newton's method with Levenberg and Marquardt's damping. The derivative of the run is that of
`simulate`, forward: one tangent for each number, all in one program.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ._integration import RTOL, simulate
from ._mechanics import as_grasp_and_state, Grasp, State
from ._printing import code_name, number_of
from ._results import (
    as_array,
    as_count,
    as_floats,
    check_callable,
    check_finite,
    check_positive,
    on_host,
    RESULTS,
    shown,
    traceable,
)
from ._sweep import as_now
from ._types import ByPrecision, Given

# Damping of the first step, over the diagonal of the Gauss-Newton matrix; its factor up and down; its limit.
_FIRST, _FACTOR, _MOST = 1e-3, 10.0, 1e12
# The search ends with a step shorter than this many standard deviations, or than this share of each number.
_LAST, _SHARE = ByPrecision(1e-3, 1e-2), ByPrecision(1e-9, 1e-6)
# Where no step goes down, the step that the derivative asks for is rounding up to this share of each number.
_ROUNDING = ByPrecision(1e-6, 1e-3)
# After a step that does not go down, the search has arrived if the derivative asks for less than this share
# of each number. In single precision, of data without noise, rounding would ask for as much for ever.
_NOTHING = ByPrecision(1e-9, 1e-3)
# Singular values of the scaled derivative below the first share of the largest count as zero. The data tell
# nothing of their directions, nor of a number whose part in such a direction exceeds the second figure.
_UNTOLD, _PART = ByPrecision(1e-7, 1e-5), ByPrecision(1e-6, 1e-3)
# A number counts as undetermined if its standard deviation is so many times itself.
_GUESSED = 1e6
# Codes of runs that broke off; what ended otherwise, such as with a lost contact, may have been measured.
_BROKEN = (
    RESULTS.max_steps_reached,
    RESULTS.step_collapsed,
    RESULTS.singular_contact,
    RESULTS.not_finite,
    RESULTS.unreachable,
    RESULTS.solver_failed,
    RESULTS.inconsistent_shape,
    RESULTS.not_rolling,
)


@dataclass(frozen=True)
class Identified:
    """Numbers found by `identify`. Printed, it is a table.

    Attributes:
        values: By name, what was found.
        deviations: By name, standard deviations in the same units; infinite for numbers of which the data
            tell nothing, or which they do not tell from others.
        covariance: Shape (n, n), in the order of `values`; infinite in the rows and columns of such numbers.
        noise: Standard deviation of the measurements: the one given, or the one that the misfit shows.
        misfit: Root mean square of measured minus computed, over the noise: about one where model and noise
            are right, and of a noise that the misfit shows always; zero where they fit exactly.
        steps: How many steps were tried.
        result: `successful`; `max_steps_reached`, of the search; `solver_failed` where it ended at a kink, a
            jump or beside numbers without a run, though no minimum is there; `undetermined` where the data
            tell nothing of any number by itself; or why the run with the numbers found broke off, such as
            `step_collapsed`. A run that an event ended did not break off.
    """

    values: dict[str, float]
    deviations: dict[str, float]
    covariance: np.ndarray
    noise: float | np.ndarray
    misfit: float
    steps: int
    result: RESULTS

    @property
    def correlation(self) -> np.ndarray:
        """Shape (n, n): between -1 and 1; near either, only a combination of two numbers is known.

        NaN for a number of which the data tell nothing.
        """
        spread = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):
            return self.covariance / np.outer(spread, spread)

    def __repr__(self) -> str:
        width = max(map(len, self.values))
        rows = [
            f"  {name:{width}}  {value:.6g} +- {self.deviations[name]:.2g}"
            for name, value in self.values.items()
        ]
        return "\n".join(
            [f"Identified: {code_name(self.result)}", *rows, f"  misfit {self.misfit:.3g} times the noise"]
        )


@on_host
def identify(
    make: Callable[[dict[str, Any]], tuple[Grasp, State]],
    guess: Mapping[str, Given],
    ts: Given,
    measured: Given,
    *,
    observe: Callable[[Grasp, Any], Any] | None = None,
    noise: Given | None = None,
    steps: int = 30,
    rtol: float = RTOL,
) -> Identified:
    r"""Find numbers of a grasp, such as damping or the radius of a tip, from noisy measurements of a run.

    Minimises $\sum_k (y_k - h_k(p))^2 / \sigma_k^2$ over the numbers $p$, with the measured $y$ and the
    computed $h$. With the derivative $J = \partial h / \partial p$ in units of the noise, the covariance of
    what is found is $(J^T J)^{-1}$, from the Gauss-Newton matrix; times the mean square of the misfit, over
    the degrees of freedom, where the noise is not given.

    Args:
        make: From the numbers, a dict by name, to a grasp and its start. `close` may be part of it.
        guess: By name, where to begin; none may be zero, as the search scales each number by its guess.
        ts: Shape (t,), times of the measurements [s], the first not negative; the run starts at 0.
        measured: What was measured, of the shape that `observe` returns; by default joint angles of all
            fingers, shape (t, k) [rad].
        observe: From the grasp and its run, which has a state at every time, to an array. A run that ended
            early stands still from then on (see `Trajectory.filled`); its end is `run.stats.t_end`.
        noise: Standard deviation of the measurements, one number or of their shape. Default: from the misfit.
        steps: How many steps are tried at most.
        rtol: Relative tolerance of the runs.

    Returns:
        `Identified`: values, standard deviations, covariance, misfit.

    Raises:
        ValueError: If an argument does not fit: no names, a guess of zero, shapes that differ, or no more
            measurements than numbers.

    Accuracy: from data without noise, made by another formulation and integrated by another library, damping
    and the pull on the object of Part 2 are found to 1e-6 of themselves. What is found is a minimum near the
    guess, not always the least one.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, 0.16)
        >>> ts, angles = run.ts[20::40], run.states.q[20::40, 1:]
        >>> make = lambda p: (grasp.with_(**p), state)
        >>> found = jxr.identify(make, {"damping": 0.004, "force": 0.7}, ts, angles, noise=1e-4)
        >>> round(found.values["damping"], 6), round(found.values["force"], 6)
        (0.006, 0.5)
    """
    names, start = _checked(make, guess, observe)
    times = _times(ts)
    data = check_finite("measured", as_array("measured", measured))
    steps = as_count("steps", steps)
    if data.size <= len(names):
        raise ValueError(
            f"argument measured must hold more numbers than the {len(names)} of guess, but had {data.size}"
        )
    sigma = _sigma(noise, data)

    # Guess and data are arguments: with others at the same times JAX finds the program in its folder.
    def left_over(x: jax.Array, start: Any, data: jax.Array, sigma: jax.Array) -> tuple[jax.Array, Any]:
        with traceable("make"):
            grasp, state = as_grasp_and_state(make(dict(zip(names, x * start, strict=True))))
        run = simulate(grasp, state, times[-1], ts=times, rtol=rtol, throw=False).filled()
        with traceable("observe"):
            given = _joints(grasp, run) if observe is None else observe(grasp, run)
            seen = as_array("observe, in what it returns,", given)
        if seen.shape != data.shape:
            raise ValueError(
                f"argument measured must have the shape {seen.shape} of what is seen, but had {data.shape}"
            )
        left = ((seen - data) / sigma).ravel()
        return left, (left, run.result)

    slopes_and_left = jax.jit(jax.jacfwd(left_over, has_aux=True))

    def all_of(x: jax.Array) -> tuple[jax.Array, jax.Array, RESULTS]:
        slopes, (left, ended) = slopes_and_left(x, start, data, sigma)
        return left, slopes, ended

    # JAX keeps the trace of the run inside by the functions in the grasp, whatever these hold since.
    with as_now((make, observe)):
        found = _descend(all_of, np.ones(len(names)), steps, known=noise is not None)
    x, count, result, (left, slopes, ended) = found
    spread = 1.0 if noise is not None else np.sqrt(float(left @ left) / (data.size - len(names)))
    covariance = _covariance(slopes, spread * start)
    deviations = np.sqrt(np.diag(covariance))
    values = x * start
    told = np.any(deviations < _GUESSED * np.abs(values))
    return Identified(
        dict(zip(names, values.tolist(), strict=True)),
        dict(zip(names, deviations.tolist(), strict=True)),
        covariance,
        _given(sigma) if noise is not None else spread,
        float(np.sqrt(np.mean(left**2))) / (spread or 1.0),
        count,
        _outcome(result, int(ended), told=bool(told)),
    )


def _outcome(search: RESULTS, ended: int, *, told: bool) -> RESULTS:
    """How an identification ended: from the code of its search, and the number of the found run's code.

    `told` says whether the data tell something of a number at least.
    """
    for code in _BROKEN:
        if ended == int(number_of(code)[1]):
            return code
    over = code_name(search) in ("successful", "solver_failed")
    return RESULTS.undetermined if over and not told else search


def _descend(
    both: Callable[[Any], Any], x: np.ndarray, steps: int, *, known: bool
) -> tuple[np.ndarray, int, RESULTS, tuple[np.ndarray, ...]]:
    """The numbers at a minimum, steps tried, how it ended, and what `both` gives there.

    `both` gives the misfits and their derivative first; what follows these is handed on.
    """
    evaluate = lambda x: tuple(map(np.asarray, both(jax.device_put(x))))  # noqa: E731
    left, slopes, *rest = evaluate(x)
    if not (_has_squares(left) and _has_squares(slopes)):
        return x, 0, RESULTS.not_finite, (left, slopes, *rest)
    damping = _FIRST
    for count in range(1, steps + 1):
        matrix, downhill = slopes.T @ slopes, -slopes.T @ left
        scaled = matrix + damping * np.diag(np.maximum(np.diag(matrix), 1e-300))
        step = np.linalg.lstsq(scaled, downhill, rcond=None)[0]
        new_left, new_slopes, *new_rest = evaluate(x + step)
        if _has_squares(new_left) and _has_squares(new_slopes) and new_left @ new_left <= left @ left:
            last = _LAST.of(slopes) * _deviation(left, len(x), known=known)
            small = np.sqrt(step @ matrix @ step) < last
            x, left, slopes, rest = x + step, new_left, new_slopes, new_rest
            damping /= _FACTOR
            if damping < _FIRST and (small or np.all(np.abs(step) < _SHARE.of(slopes) * np.abs(x))):
                return x, count, RESULTS.successful, (left, slopes, *rest)
        else:
            damping *= _FACTOR
            # No step goes down any more; or rounding alone decides which ones do, and would for ever.
            if damping > _MOST or _arrived(x, left, slopes, known=known):
                return x, count, _at_an_end(x, left, slopes, known=known), (left, slopes, *rest)
    return x, steps, RESULTS.max_steps_reached, (left, slopes, *rest)


def _deviation(left: np.ndarray, numbers: int, *, known: bool) -> float:
    """The standard deviation of the misfits: one, or where the noise is not known an estimate."""
    return 1.0 if known else float(np.sqrt(left @ left / max(len(left) - numbers, 1)))


def _has_squares(values: np.ndarray) -> bool:
    """Whether values are finite, and their squares too."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.sum(np.square(values))))


def _arrived(x: np.ndarray, left: np.ndarray, slopes: np.ndarray, *, known: bool) -> bool:
    """Whether the derivative asks for a step of next to nothing, though no damping shortens it.

    Whether so short a step goes down may be decided by the errors of the runs.
    """
    step, unit = _undamped(left, slopes), _deviation(left, len(x), known=known)
    near = np.linalg.norm(slopes @ step) < _LAST.of(slopes) * unit
    return bool(near or np.all(np.abs(step) < _NOTHING.of(slopes) * np.abs(x)))


def _undamped(left: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """The step of Gauss and Newton, which no damping shortens."""
    return np.linalg.lstsq(slopes, -left, rcond=None)[0]


def _at_an_end(x: np.ndarray, left: np.ndarray, slopes: np.ndarray, *, known: bool) -> RESULTS:
    """`successful` if only rounding keeps steps from going down, `solver_failed` if something else does.

    The latter is so at a kink, at a jump, and beside numbers for which there is no run: the derivative there
    promises more than rounding, but neither leads to a minimum nor says how well numbers are known.
    """
    step, unit = _undamped(left, slopes), _deviation(left, len(x), known=known)
    last, share = _LAST.of(slopes), _ROUNDING.of(slopes)
    promised = np.linalg.norm(slopes @ step) > last * unit and np.any(np.abs(step) > share * np.abs(x))
    return RESULTS.solver_failed if promised else RESULTS.successful


def _inverse(slopes: np.ndarray) -> np.ndarray:
    """The inverse of the Gauss-Newton matrix; infinite for numbers of which the data tell nothing.

    It is made of the singular values of the derivative: those below a thousandth of the largest would be lost
    in rounding if they were squared in single precision.
    """
    count, least, part = slopes.shape[1], _UNTOLD.of(slopes), _PART.of(slopes)
    if not _has_squares(slopes):
        return np.full((count, count), np.inf)
    root = slopes.astype(float)
    size = np.linalg.norm(root, axis=0)
    scale = np.where(size > 0.0, size, 1.0)
    _, values, ways = np.linalg.svd(root / scale, full_matrices=False)
    told = values > least * values[0]
    inverse = ways[told].T / values[told] ** 2 @ ways[told] / np.outer(scale, scale)
    unknown = np.any(np.abs(ways[~told]) > part, axis=0)
    inverse[unknown, :] = inverse[:, unknown] = np.inf
    return inverse


def _covariance(slopes: np.ndarray, units: np.ndarray) -> np.ndarray:
    """The covariance of numbers, from the derivative and `units`: what each is scaled by, times the noise.

    Of what the data tell nothing it stays infinite, even where they fit exactly and `units` are zero.
    """
    inverse = _inverse(slopes)
    told = np.isfinite(inverse)
    return np.multiply(np.outer(units, units), inverse, out=np.full_like(inverse, np.inf), where=told)


def _joints(grasp: Grasp, run: Any) -> jax.Array:
    """Joint angles of all fingers, shape (t, k), without the clock of a moving stage."""
    starts = np.cumsum(grasp.form.positions)[:-1]
    each = zip(starts, grasp.fingers, strict=True)
    columns = [start + joint for start, finger in each for joint in range(finger.joints)]
    return run.states.q[:, np.array(columns, int)]


def _checked(make: Any, guess: Any, observe: Any) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and first values."""
    check_callable("make", make, "a function of a dict of numbers", takes=1)
    if observe is not None:
        check_callable("observe", observe, "a function of a grasp and its run", takes=2)
    if not isinstance(guess, Mapping) or not guess or not all(isinstance(name, str) for name in guess):
        raise ValueError(f"argument guess must be a dict of numbers by their names, but was {shown(guess)}")
    values = [np.asarray(as_floats("guess", value, ())) for value in guess.values()]
    if not all(value != 0.0 for value in values):
        raise ValueError(f"argument guess must have no zero, by which nothing scales, but was {shown(guess)}")
    return tuple(guess), np.array(values, float)


def _times(ts: Any) -> jax.Array:
    times = as_floats("ts", ts, (None,))
    seen = np.asarray(times)
    if not len(seen) or seen[0] < 0.0 or seen[-1] <= 0.0 or np.any(np.diff(seen) <= 0.0):
        raise ValueError(f"argument ts must be rising times from 0 or later, but was {shown(times)}")
    return times


def _sigma(noise: Any, data: jax.Array) -> jax.Array:
    if noise is None:
        return jnp.ones(())
    given = as_array("noise", noise)
    shape = () if given.ndim == 0 else data.shape
    return check_positive("noise", as_floats("noise", given, shape))


def _given(sigma: jax.Array) -> float | np.ndarray:
    return float(sigma) if sigma.ndim == 0 else np.asarray(sigma)
