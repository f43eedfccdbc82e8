"""Time-stepping loops compiled by Numba as a whole, round one hand-written scene: with error control, RK4.

Sizes and tableau are constants to the compiler, which unrolls and vectorises over states. Every loop is
called as `loop(x0, times, setting)` and returns the states at `times` and the number of steps tried.
"""

from collections.abc import Callable

import diffrax
import numpy as np
from numba import njit

SAFETY, SLOWEST, FASTEST = 0.9, 0.2, 10.0
FIRST_STEP = 1e-4


def rk4(fill_rates: Callable, size: int) -> Callable:
    """Classical Runge-Kutta; the setting is the number of equal steps to each saved time."""

    @njit(error_model="numpy")
    def loop(x0, times, steps):
        k, x, y = np.empty((4, size)), x0.copy(), np.empty(size)
        path, t = np.empty((times.size, size)), 0.0
        for save in range(times.size):
            h = (times[save] - t) / steps
            for _ in range(steps):
                fill_rates(0.0, x, k[0])
                for j in range(3):
                    part = h if j == 2 else 0.5 * h
                    for i in range(size):
                        y[i] = x[i] + part * k[j, i]
                    fill_rates(0.0, y, k[j + 1])
                for i in range(size):
                    x[i] += h / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])
            path[save], t = x, times[save]
        return path, steps * times.size

    return loop


def _tableau(solver: diffrax.AbstractERK) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of the stages, whose last row is the solution's, and weights of the error."""
    tableau = solver.tableau
    if not (tableau.fsal and tableau.ssal):
        raise ValueError("the last stage has to be the solution")
    lower = np.zeros((tableau.num_stages, tableau.num_stages))
    for i, row in enumerate(tableau.a_lower):
        lower[i + 1, : i + 1] = row
    return lower, np.asarray(tableau.b_error)


def adaptive(
    fill_rates: Callable, size: int, solver: diffrax.AbstractERK, controlled: int | None = None
) -> Callable:
    """A method of diffrax with its error norm and step control; nothing is projected.

    The setting is the tolerance, relative and absolute, of the first `controlled` unknowns (None: of all).
    """
    lower, weights = _tableau(solver)
    stages, power = weights.size, -0.5 / solver.order(None)
    # Without zeros the compiler need not ask for them.
    full = bool(np.all(lower[np.tril_indices(stages, -1)]))
    judged = size if controlled is None else controlled

    @njit(error_model="numpy", inline="always")
    def error(x, y, k, e, h, tolerance):
        """Mean square of the error over what is allowed."""
        for i in range(size):
            e[i] = 0.0
        for j in range(stages):
            for i in range(size):
                e[i] += weights[j] * k[j, i]
        total = 0.0
        for i in range(judged):
            scaled = h * e[i] / (tolerance * (1.0 + max(abs(x[i]), abs(y[i]))))
            total += scaled * scaled
        return total / judged

    @njit(error_model="numpy", inline="always")
    def attempt(t, x, y, k, h):
        """Stages of one step; the last of them leaves the solution in `y`."""
        for j in range(1, stages):
            for i in range(size):
                y[i] = x[i]
            for m in range(j):
                part = h * lower[j, m]
                if full or part != 0.0:
                    for i in range(size):
                        y[i] += part * k[m, i]
            fill_rates(t, y, k[j])

    @njit(error_model="numpy")
    def loop(x0, times, tolerance):
        k, x, y, e = np.empty((stages, size)), x0.copy(), np.empty(size), np.empty(size)
        path = np.empty((times.size, size))
        t, usual, tried = 0.0, FIRST_STEP, 0
        fill_rates(t, x, k[0])
        for save in range(times.size):
            while t < times[save]:
                last = usual >= times[save] - t
                h = times[save] - t if last else usual
                attempt(t, x, y, k, h)
                total = error(x, y, k, e, h, tolerance)
                tried += 1
                factor = min(max(SAFETY * total**power, SLOWEST), FASTEST) if total > 0.0 else FASTEST
                if total <= 1.0:
                    t = times[save] if last else t + h
                    for i in range(size):
                        x[i], k[0, i] = y[i], k[stages - 1, i]
                    # A step cut short to save does not shorten the next one.
                    usual = max(usual, h * factor) if last else h * factor
                elif total > 1.0:
                    usual = h * factor
                else:
                    raise ValueError("the rates are not finite")
            path[save] = x
        return path, tried

    return loop


def many(loop: Callable) -> Callable:
    """One lane after another, as `run(starts, span, setting)`: states at the end."""

    @njit(error_model="numpy")
    def run(starts, span, setting):
        out, times = np.empty_like(starts), np.array([span])
        for i in range(starts.shape[0]):
            out[i] = loop(starts[i], times, setting)[0][0]
        return out

    return run
