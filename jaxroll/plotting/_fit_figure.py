"""A contour made of points: where it runs, how it bends, how far the points lie from it.

`_surface_fit_figure` draws the same of a surface.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..geometry import Fit, SurfaceFit, tabled
from ._doors import guarded
from ._outlines import comb, OutlineSamples, sample
from ._style import CONTACT, FINGER, MM, OBJECT, Picture, tidy, TIP_FILL
from ._surface_fit_figure import surface_figure

# Arclengths at which the contour is drawn.
_PLACES = 4097


@guarded
def fit(fit: Fit | SurfaceFit) -> Figure:
    """Draw a fitted contour with its points and a comb of its curvature, its curvature, and the residuals.

    The comb's teeth stand on the outside where the contour is convex; their length is the curvature. A
    residual is positive where the point lies outside. A fitted surface is drawn from two sides, with
    histograms of the residuals and of its principal curvatures, and the curvature that was allowed.

    Args:
        fit: From `fit_contour` or `fit_surface`.

    Returns:
        The figure: the contour [mm] on the left, curvature [1/m] and residuals [um] over arclength [mm]; or
        the surface [mm] twice, with both histograms.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> from jaxroll import plotting
        >>> u = 2 * np.pi * np.arange(48) / 48
        >>> disc = jxr.fit_contour(np.stack([20 * np.cos(u), 14 * np.sin(u)], -1), unit="mm", noise=0.0)
        >>> len(plotting.fit(disc).axes)
        3
    """
    if isinstance(fit, SurfaceFit):
        return surface_figure(fit)
    contour, report = tabled(fit.contour), fit.report
    domain = contour.domain()
    assert domain is not None, "a contour through points has ends"
    s = np.linspace(float(domain[0]), float(domain[1]), _PLACES)
    curve, feet = sample(contour, s), sample(contour, np.asarray(fit.feet))
    points = MM * np.asarray(fit.points)
    figure = Picture(10.0, 5.2)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1.0))
    shape = figure.add_subplot(grid[:, 0])
    bend = figure.add_subplot(grid[0, 1])
    miss = figure.add_subplot(grid[1, 1], sharex=bend)
    _shape(shape, curve, points, closed=report.closed)
    _bend(bend, s, curve, np.asarray(fit.feet), feet)
    _miss(miss, np.asarray(fit.feet), points - feet.points, feet)
    kind = f"{'closed' if report.closed else 'open'} {report.field}"
    tidy(shape, xlabel="x [mm]", ylabel="y [mm]", title=f"Contour ({kind}) with comb of curvature")
    figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    return figure


def _shape(ax: Axes, curve: OutlineSamples, points: np.ndarray, *, closed: bool) -> None:
    if closed:
        # The last point is the first again, to rounding: Matplotlib closes the outline by itself.
        ax.fill(*curve.points[:-1].T, fc=TIP_FILL, ec="none", alpha=0.5)
    peak = max(float(np.abs(curve.curvatures).max()), 1e-12)
    length = 0.18 * float(np.ptp(curve.points, axis=0).max()) / peak
    ends, teeth = comb(curve, length)
    ax.plot(*ends.T, color=OBJECT, lw=1.0)
    ax.plot(*teeth.T, color=OBJECT, lw=0.5, label=f"curvature, {peak:.4g} 1/m at most")
    ax.plot(*curve.points.T, color=FINGER, lw=1.6, label="contour")
    size = 3.0 if len(points) < 250 else 1.8
    ax.plot(*points.T, "o", ms=size, color=CONTACT, mew=0.0, label=f"{len(points)} points", zorder=4)
    ax.set_aspect("equal")


def _bend(ax: Axes, s: np.ndarray, curve: OutlineSamples, at: np.ndarray, feet: OutlineSamples) -> None:
    ax.axhline(0.0, color="#BBBBBB", lw=0.7, zorder=0)
    ax.plot(MM * s, curve.curvatures, color=FINGER, lw=1.4)
    ax.plot(MM * at, feet.curvatures, "o", ms=1.8, color=CONTACT, mew=0.0)
    tidy(ax, ylabel="curvature [1/m]", title="Curvature, with the places of the points")


def _miss(ax: Axes, at: np.ndarray, off: np.ndarray, feet: OutlineSamples) -> None:
    residuals = MM * np.sum(off * feet.outward, axis=1)
    ax.axhline(0.0, color="#BBBBBB", lw=0.7, zorder=0)
    ax.vlines(MM * at, 0.0, residuals, color=CONTACT, lw=0.7)
    ax.plot(MM * at, residuals, "o", ms=2.2, color=CONTACT, mew=0.0)
    rms = float(np.sqrt(np.mean(residuals**2)))
    title = f"Distance of the points, outward: {rms:.2g} \N{MICRO SIGN}m rms"
    tidy(ax, xlabel="arclength s [mm]", ylabel="distance [\N{MICRO SIGN}m]", title=title)
