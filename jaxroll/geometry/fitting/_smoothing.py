r"""How much to smooth: the wavelength of a smoothing spline, from the noise level or the data alone.

With the basis' values B at the n points, $N = B^T B/n$ and its roughness $R = \int B''' B'''^T du$, the
spline of wavelength $\ell$ (see `Spline`) is $H p$ with $H = B (N + \lambda R)^{-1} B^T / n$, $\lambda =
(\ell/2\pi)^6 / L$. The generalised eigenvectors of $R x_k = \mu_k N x_k$ make $H$ diagonal for all $\ell$ at
once: its eigenvalues are $1/(1 + \lambda \mu_k)$. So one decomposition serves 600 trial wavelengths, and
residuals and $\mathrm{tr}\,H$ of each are sums.

`_contour_fit` calls `smoothing_for` where the caller gives no wavelength; its matrices come from
`spline_basis`.
"""

import functools

import jax
import numpy as np
from jaxtyping import Array

from ..._results import as_floats, check_choice, check_flag, check_length, on_host, shown
from ..._types import Given
from ..contours import check_distinct, check_enough, check_extent, chords, knot_count, spline_basis

# Wavelengths tried, in geometric progression.
_TRIALS = 600
# See `_spectrum`.
Spectrum = tuple[np.ndarray, np.ndarray, float]


@on_host
def smoothing_for(
    points: Given,
    *,
    closed: bool = True,
    noise: float | None = None,
    knots: int | None = None,
    degree: int = 5,
) -> float:
    r"""Wavelength [m] for `Spline(points, smoothing=...)`.

    With the noise level $\sigma$, the minimum of Mallows' estimate of the error against the truth,
    $\sum_i |r_i|^2 + 4\sigma^2\,\mathrm{tr}\,H$, where $H$ maps data to fit. (Taking the longest wavelength
    whose residuals the noise explains errs two to three times as much.) Without, the minimum of
    generalised cross-validation, $\sum_i |r_i|^2 / (n - \mathrm{tr}\,H)^2$, which takes errors
    that neighbours share for shape.

    Args:
        points: Shape (n, 2) [m], in order. Not differentiable: this is set-up.
        closed: Whether the last point is followed by the first.
        noise: Standard deviation of each coordinate [m], at most a tenth of the largest extent; 0 gives 0,
            an interpolating spline.
        knots: As for the spline.
        degree: As for the spline.

    Raises:
        ValueError: If `noise` is not such a length, the points are fewer than the spline needs, repeat one
            (to rounding, too) or are being traced.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> u = 2 * np.pi * np.arange(200) / 200
        >>> dots = 0.01 * np.stack([np.cos(u), np.sin(u)], -1)
        >>> dots += 1e-6 * np.random.default_rng(0).normal(size=dots.shape)
        >>> disc = jxr.Spline(dots, smoothing=jxr.geometry.smoothing_for(dots, noise=1e-6))
        >>> bool(abs(disc.curvature(0.0) / 100 - 1) < 0.01)
        True
    """
    given = as_floats("points", points, (None, 2))
    data = np.asarray(given)
    closed, degree = check_flag("closed", closed), check_choice("degree", degree, (3, 5, 7, 9))
    check_enough(len(data), degree)
    check_distinct(data, closed)
    check_extent("points", data)
    # More noise than a tenth of the extent leaves nothing of a shape to fit.
    check_length("noise", noise, 0.1 * float(np.ptp(data, axis=0).max()))
    level = None if noise is None else float(noise)
    knots = knot_count(knots, len(data), degree)
    if level == 0.0:
        return 0.0
    matrix, rough, length = (np.asarray(x) for x in _forms(given, knots, degree, closed))
    # About their mean, since splines have constants: the squares of points far from the origin would leave
    # nothing of what is `lost`.
    spectrum, energy, lost = _spectrum(matrix, rough, data - data.mean(axis=0))
    # From half the shortest wavelength that the knots can follow (two knots a wave), which smooths almost
    # nothing, to the length of the contour.
    shortest = 2.0 * length / matrix.shape[1]
    waves = np.geomspace(0.5 * shortest, length, _TRIALS)
    # Rows: wavelengths; columns: eigenvalues of H. Its trace is their sum, and of the data's component along
    # an eigenvector the residual has the share 1 - 1/(1 + lambda mu).
    shrunk = 1.0 / (1.0 + ((waves / (2.0 * np.pi)) ** 6 / length)[:, None] * spectrum[None, :])
    freedom = len(data) - shrunk.sum(axis=1)
    squares = (1.0 - shrunk) ** 2 @ energy + lost
    if level is None:
        return float(waves[np.argmin(squares / freedom**2)])
    # The criterion of the docstring less a constant: -freedom is tr H - n. Both coordinates have noise, so
    # that the factor is 4, not 2.
    return float(waves[np.argmin(squares - 4.0 * level**2 * freedom)])


def check_alone(noise: Given | None, smoothing: Given | None) -> None:
    """Raise where a fit is given both: either of them says how much to smooth."""
    if noise is not None and smoothing is not None:
        raise ValueError(f"argument noise must be None where smoothing is given, but was {shown(noise)}")


@functools.partial(jax.jit, static_argnums=(1, 2, 3))
def _forms(points: Array, knots: int | None, degree: int, closed: bool) -> tuple[Array, Array, Array]:
    """Values B of the basis at the data, its roughness R, and the length L of the polygon [m]."""
    u = chords(points, closed)
    functions = spline_basis(u, knots, degree, closed=closed)
    return functions.matrix(u[: points.shape[0]]), functions.roughness(), u[-1]


def _spectrum(matrix: np.ndarray, rough: np.ndarray, data: np.ndarray) -> Spectrum:
    r"""Eigenvalues of roughness, and how the data divide among the eigenvectors.

    Returns:
        The eigenvalues $\mu_k$; the sum over both coordinates of the squared component of the data along
        each eigenvector [m^2]; and the squares [m^2] of what no spline on these knots can represent.
    """
    from scipy.linalg import eigh  # set-up only: imported with the first use

    normal = matrix.T @ matrix / len(data)
    levels, shapes = eigh(rough, normal)
    # SciPy normalises x^T N x = 1, so that the vectors B x / sqrt(n) are orthonormal.
    share = shapes.T @ (matrix.T @ data) / np.sqrt(len(data))
    energy = (share**2).sum(axis=1)
    return np.maximum(levels, 0.0), energy, max(float((data**2).sum() - energy.sum()), 0.0)
