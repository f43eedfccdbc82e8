"""Labels of a drawing, each put near its place where it hides nothing: neither another label nor a line."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

# Directions, and distances [points] of a label's edge from its place, that are tried.
_DIRECTIONS = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
_DISTANCES = np.array([3.0, 5.5, 8.5, 12.0, 17.0, 23.0, 31.0, 40.0])
# From this distance on [points] a thin line leads to the label.
_FAR = 14.0
# Free space round a label, and between the dots that stand for a line [points].
_CLEAR, _SPACING = 1.5, 1.5
# The most dots of one line: a line that would need more is far longer than the axes are wide.
_MOST_POINTS = 20_000
# What a label costs: for each dot of a line that it covers, for each typographic point away from its place,
# and for covering another label or leaving the axes.
_ON_LINE, _AWAY, _FORBIDDEN = 1.0, 0.25, 1e4


@dataclass(frozen=True)
class Tag:
    """A label.

    Attributes:
        text: What it says.
        at: Shape (2,), its place in the axes' coordinates.
        colour: Of the text.
        size: Of the font [points].
    """

    text: str
    at: np.ndarray
    colour: str
    size: float = 10.0


def put_tags(ax: Axes, tags: Sequence[Tag], lines: Sequence[np.ndarray]) -> None:
    """Write labels on an axes whose limits are set, the first ones nearest to their places.

    Args:
        ax: Where to write.
        tags: The labels.
        lines: Polylines of shape (n, 2) that labels must keep clear of, in the axes' coordinates.
    """
    figure: Any = ax.get_figure(root=True)
    figure.draw_without_rendering()  # the layout says where the axes are
    point = figure.dpi / 72.0
    window = np.asarray(ax.get_window_extent()) / point
    taken = np.concatenate([_dotted(ax.transData.transform(line) / point) for line in lines])
    boxes: list[np.ndarray] = []
    for tag in tags:
        half = 0.5 * _size(ax, tag) / point + _CLEAR
        place = ax.transData.transform(tag.at) / point
        shift, distance = _best(place, half, window, taken, boxes)
        boxes.append(np.stack([place + shift - half, place + shift + half]))
        leader = {"arrowstyle": "-", "lw": 0.6, "color": tag.colour, "shrinkA": 0.0, "shrinkB": 1.0}
        ax.annotate(
            tag.text,
            (float(tag.at[0]), float(tag.at[1])),
            xytext=(float(shift[0]), float(shift[1])),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=tag.size,
            color=tag.colour,
            zorder=20,
            arrowprops=leader if distance >= _FAR else None,
        ).set_in_layout(False)


def _size(ax: Axes, tag: Tag) -> np.ndarray:
    """Width and height of a label [pixels]."""
    text = ax.text(0.0, 0.0, tag.text, fontsize=tag.size)
    extent = text.get_window_extent()
    text.remove()
    return np.array([extent.width, extent.height])


def _dotted(line: np.ndarray) -> np.ndarray:
    """Dots along a polyline, evenly spaced."""
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    wanted = np.linspace(0.0, along[-1], int(np.clip(along[-1] / _SPACING, 2, _MOST_POINTS)))
    return np.stack([np.interp(wanted, along, column) for column in line.T], axis=-1)


def _best(
    place: np.ndarray, half: np.ndarray, window: np.ndarray, taken: np.ndarray, boxes: list[np.ndarray]
) -> tuple[np.ndarray, float]:
    """Where the middle of a label goes from its place, and how far its edge is from it; all in points."""
    best, least = (np.zeros(2), 0.0), np.inf
    near = taken[np.abs(taken - place).max(axis=1) < _DISTANCES[-1] + 2.0 * half.max()]
    for distance in _DISTANCES:
        for angle in _DIRECTIONS:
            way = np.array([np.cos(angle), np.sin(angle)])
            shift = way * (distance + half)
            low, high = place + shift - half, place + shift + half
            hidden = np.all((near > low) & (near < high), axis=1).sum()
            covered = any(np.all((low < box[1]) & (high > box[0])) for box in boxes)
            outside = np.any(low < window[0]) or np.any(high > window[1])
            cost = _ON_LINE * hidden + _AWAY * distance + _FORBIDDEN * (covered + outside)
            if cost < least:
                best, least = (shift, float(distance)), cost
    return best
