"""Figures without pyplot state, and the few colours and sizes that all of them share."""

import io
from pathlib import Path
from typing import Any

from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .._results import told

# Okabe and Ito's palette: told apart in every common form of colour blindness.
FINGER, OBJECT, CONTACT, FORCE_COLOUR, GUIDE = "#0072B2", "#E69F00", "#D55E00", "#CC3377", "#333333"
CYCLE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
# Paul Tol's: told apart from these and from each other, where there are more to name.
MANY = (*CYCLE, "#882255", "#999933", "#44AA99", "#332288", "#AA4499", "#117733")
ROLLED = "#009E73"
# Dark enough for thin lines and letters on the fill of the object.
OBJECT_DARK = "#8A5A00"
LINK_FILL, TIP_FILL, OBJECT_FILL = "#DCE3E8", "#BFDDF0", "#FBE3B4"
# Bodies in space, before they are shaded, and the loci of the contacts on them.
LINK_BODY, JOINT_BODY, TIP_BODY, OBJECT_BODY = "#C9D2D9", "#7C8A95", "#9CCBEA", "#F7D28A"
LOAD_COLOUR = "#7A4FB5"
LOCUS_TIP, LOCUS_OBJECT = "#0057A8", "#00805C"
MM = 1e3
DPI = 150


class Picture(Figure):
    """A figure on the Agg canvas that a notebook shows by itself."""

    def __init__(self, width: float, height: float) -> None:
        super().__init__(figsize=(width, height), layout="constrained", facecolor="white")
        self.agg = FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()

    def savefig(self, fname: Any, **options: Any) -> None:
        """As matplotlib's, which lays out and draws a PNG twice: once, for the same picture bit by bit."""
        kind = options.get("format") or (Path(fname).suffix[1:] if isinstance(fname, str | Path) else None)
        if kind != "png" or options.get("bbox_inches") or rcParams["savefig.bbox"]:
            super().savefig(fname, **options)
            return
        layout, dpi, asked = self.get_layout_engine(), self.dpi, options.get("dpi") or rcParams["savefig.dpi"]
        try:
            self.dpi = dpi if asked == "figure" else asked
            if layout is not None:
                layout.execute(self)
            self.set_layout_engine(None)
            super().savefig(fname, **options)
        finally:
            self.dpi = dpi
            self.set_layout_engine(layout)


def tidy(ax: Axes, *, xlabel: str = "", ylabel: str = "", title: str = "") -> None:
    """Labels, and light ticks and frame, set here rather than in matplotlib's global settings."""
    ax.set_xlabel(xlabel, fontsize=9)
    ax.set_ylabel(ylabel, fontsize=9)
    ax.set_title(title, fontsize=9.5, loc="left")
    ax.tick_params(labelsize=8, length=3, width=0.7, color="#777777", direction="out")
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set(linewidth=0.7, color="#777777")


def save_figure(figure: Figure, folder: str | Path, name: str) -> Path:
    """Write a figure as a PNG into a folder, which is made if need be."""
    path = Path(folder) / name
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=DPI)
    except OSError as error:
        raise ValueError(
            f"argument folder must be one that can be written to, but was {told(folder, error)}"
        ) from None
    return path
