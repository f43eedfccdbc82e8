"""The curves that contacts trace on two surfaces, over time."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ._motion3 import LociRecord
from ._style import LOCUS_OBJECT, LOCUS_TIP, MM, Picture, save, tidy

_ROWS = (
    ("Geodesic curvature", r"$\kappa_g$ [1/mm]", "geodesic_curvature"),
    ("Normal curvature", r"$\kappa_n$ [1/mm]", "normal_curvature"),
    ("Geodesic torsion", r"$\tau_g$ [1/mm]", "torsion"),
)
_WIDTH, _HEIGHT = 3.9, 1.75


def loci(found: LociRecord, folder: str | Path | None = None) -> Figure:
    r"""Plot geodesic curvature, normal curvature, torsion and arclength of the loci of all contacts.

    A column for each contact, with the fingertip's locus and the object's. Under rolling without spin about
    the normal both loci have the same geodesic curvature, up to sign; under any rolling the same arclength,
    so that the last row shows the error of a run.

    Args:
        found: The loci, over time.
        folder: Where to write the figure too, as `loci.png`. Default: nowhere.

    Returns:
        The figure.

    Raises:
        ValueError: If an array has not the shape (c, t).

    Example:
        >>> import numpy as np
        >>> from types import SimpleNamespace
        >>> from jaxroll import plotting
        >>> names = ("arclength", "normal_curvature", "geodesic_curvature", "torsion")
        >>> both = {f"{name}_{body}": np.ones((1, 3)) for name in names for body in ("tip", "object")}
        >>> figure = plotting.loci(SimpleNamespace(ts=np.arange(3.0), **both))
        >>> figure.axes[0].get_ylabel()
        '$\\kappa_g$ [1/mm]'
    """
    ts = np.asarray(found.ts, float)
    contacts = len(np.asarray(found.arclength_tip))
    figure = Picture(0.5 + _WIDTH * contacts, 0.4 + _HEIGHT * (1 + len(_ROWS)))
    axes = figure.subplots(1 + len(_ROWS), contacts, sharex=True, squeeze=False)
    for row, (title, label, name) in zip(axes, _ROWS, strict=False):
        pair = [_array(found, f"{name}_{body}", (contacts, len(ts))) / MM for body in ("tip", "object")]
        for c, ax in enumerate(row):
            _draw(ax, ts, [values[c] for values in pair])
            tidy(ax, ylabel="" if c else label, title=_title(title, c, contacts))
    tips, bodies = (_array(found, f"arclength_{body}", (contacts, len(ts))) for body in ("tip", "object"))
    off, unit = _in_powers(tips - bodies)
    for c, ax in enumerate(axes[-1]):
        ax.plot(ts, off[c], color="#555555", lw=1.0)
        ax.axhline(0.0, color="#BBBBBB", lw=0.7, zorder=0)
        ax.margins(x=0.0)
        label = "" if c else rf"$s_\mathrm{{tip}} - s_\mathrm{{obj}}$ [{unit}]"
        length = MM * float(np.nanmax(np.abs(bodies[c])))
        tidy(ax, xlabel="time $t$ [s]", ylabel=label, title=f"Arclengths' difference, of {length:.3g} mm")
    handles = axes[0, 0].get_lines()[:2]
    names = ("locus on the fingertip", "locus on the object")
    figure.legend(handles, names, loc="outside lower center", ncols=2, fontsize=8.5, frameon=False)
    figure.align_ylabels()
    if folder is not None:
        save(figure, folder, "loci.png")
    return figure


def _array(found: LociRecord, name: str, shape: tuple[int, int]) -> np.ndarray:
    values = np.asarray(getattr(found, name), float)
    if values.shape != shape:
        raise ValueError(f"argument found must have {name} of shape {shape}, but had shape {values.shape}")
    return values


def _in_powers(values: np.ndarray) -> tuple[np.ndarray, str]:
    """Lengths in a power of ten of metres, and that unit."""
    peak = float(np.nanmax(np.abs(values), initial=0.0))
    if peak == 0.0:
        return values, "m"
    power = int(np.floor(np.log10(peak)))
    return values / 10.0**power, f"$10^{{{power}}}$ m"


def _title(title: str, c: int, contacts: int) -> str:
    return title if contacts == 1 else f"{title}, contact {c + 1}"


def _draw(ax: Axes, ts: np.ndarray, pair: list[np.ndarray]) -> None:
    # The curves may coincide: both must be seen.
    ax.plot(ts, pair[0], color=LOCUS_TIP, lw=3.6, alpha=0.4)
    ax.plot(ts, pair[1], color=LOCUS_OBJECT, lw=1.5, ls=(0, (5, 2)))
    ax.margins(x=0.0, y=0.1)
    low, high = ax.get_ylim()
    peak = float(np.nanmax(np.abs(pair)))
    if high - low < 1e-4 * peak:
        middle = 0.5 * (low + high)
        low, high = ax.set_ylim(middle - 0.1 * peak, middle + 0.1 * peak)
    if low <= 0.0 <= high:
        ax.axhline(0.0, color="#BBBBBB", lw=0.7, zorder=0)
