"""What pages for a browser share: their file, their times, the button and the slider that play them."""

from pathlib import Path
from typing import Any

import numpy as np

from .._results import as_count, shown, told_apart
from ..io._paths import writable
from ._doors import check_frames
from ._gif import nearest_rows
from ._style import GUIDE

# A picture as high as the window, without the browser's margins, needs no scroll bar.
WHOLE_WINDOW = {
    "default_height": "calc(100vh - 6px)",
    "post_script": "document.body.style.margin = '0px';",
}
PAGE_FONT = {"family": "Helvetica, Arial, sans-serif", "color": GUIDE, "size": 13}


def html_path(path: str | Path) -> Path:
    """The path of a page, which must have the ending of one."""
    path = Path(path)
    if path.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"argument path must end in .html, but was {shown(str(path))}")
    return path


def checked_page(path: str | Path, frames: Any) -> tuple[Path, int]:
    """The path of a page and how many instants it may show."""
    path = writable(html_path(path))
    frames = as_count("frames", frames)
    check_frames("frames", frames)
    return path, frames


def page_times(ts: np.ndarray, frames: int) -> np.ndarray:
    """Rows of the saved times nearest to round ones, no more than `frames`, and the first and the last."""
    span = float(ts[-1] - ts[0])
    if frames == 1 or span <= 0.0:
        return np.array([0])
    rough = span / (frames - 1)
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(k * power for k in (1.0, 2.0, 2.5, 5.0, 10.0) if k * power > (1.0 - 1e-9) * rough)
    return np.unique(nearest_rows(ts, step))


def write_html(figure: Any, path: Path) -> Path:
    """Write a figure of plotly as one file that fills its window."""
    path.parent.mkdir(parents=True, exist_ok=True)
    config = {"displaylogo": False, "responsive": True}
    figure.write_html(path, include_plotlyjs=True, auto_play=False, config=config, **WHOLE_WINDOW)
    return path


def controls(ts: np.ndarray) -> dict[str, Any]:
    """A button that plays, one that stops, and a slider over time."""
    at_once = {"mode": "immediate", "fromcurrent": True, "transition": {"duration": 0}}
    play = at_once | {"frame": {"duration": 60, "redraw": True}}
    show = at_once | {"frame": {"duration": 0, "redraw": True}}
    buttons = [
        {"label": "\u25b6 play", "method": "animate", "args": [None, play]},
        {"label": "\u275a\u275a stop", "method": "animate", "args": [[None], show]},
    ]
    labels = enumerate(told_apart(*ts, least=3))
    steps = [{"label": label, "method": "animate", "args": [[str(k)], show]} for k, label in labels]
    menu = {"type": "buttons", "direction": "left", "x": 0.02, "y": 0.0, "xanchor": "left", "yanchor": "top"}
    # The buttons are as wide in any window: beside the slider they would cover its start in a narrow one.
    above, below = {"t": 38, "b": 10}, {"t": 134, "b": 10}
    slider = {
        "steps": steps,
        "active": 0,
        "x": 0.02,
        "len": 0.96,
        "pad": above,
        "currentvalue": {"prefix": "t = ", "suffix": " s", "xanchor": "right"},
    }
    return {"updatemenus": [menu | {"buttons": buttons, "pad": below}], "sliders": [slider]}
