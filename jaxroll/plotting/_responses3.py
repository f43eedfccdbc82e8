"""Responses of a spatial grasp over time."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ._motion3 import rotation_vectors
from ._panels import Panel
from ._style import CYCLE, MM, Picture, save, tidy

_COLUMNS = 2


def responses3(
    ts: np.ndarray,
    *,
    position: np.ndarray,
    orientation: np.ndarray,
    joints: Sequence[np.ndarray] = (),
    forces: np.ndarray | None = None,
    folder: str | Path | None = None,
) -> Figure:
    r"""Plot position and orientation of the object, joint angles and contact forces of a spatial grasp.

    Position, orientation and joint angles are shown as motion since the start. The orientation is the vector
    $\theta a$ of the axis and the angle of the turn, in world axes. Of the contact forces there are the
    normal force $f$, the size of the tangential one $|\lambda|$, and their ratio: the friction that rolling
    needs.

    Args:
        ts: Shape (t,) [s].
        position: Of the object, shape (t, 3) [m].
        orientation: Of the object: quaternions, scalar first, shape (t, 4).
        joints: Joint angles of each finger, shapes (t, k) [rad]; fingers without joints are left out.
        forces: Of each contact the normal force and two tangential ones, shape (c, t, 3) [N].
        folder: Where to write the figure too, as `responses3.png`. Default: nowhere.

    Returns:
        The figure.

    Raises:
        ValueError: If a shape does not agree with that of `ts`.

    Example:
        >>> import numpy as np
        >>> from jaxroll import plotting
        >>> still = np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
        >>> figure = plotting.responses3(np.arange(4.0), position=np.zeros((4, 3)), orientation=still)
        >>> [ax.get_ylabel() for ax in figure.axes]
        ['moved [mm]', '$\\theta\\,a$ [rad]']
    """
    ts = np.asarray(ts, float)
    times = len(ts)
    place, turns = _given("position", position, (times, 3)), _given("orientation", orientation, (times, 4))
    shown = [
        Panel("Position of the object", "moved [mm]", MM * (place - place[0]), ("$x$", "$y$", "$z$")),
        Panel(
            "Orientation of the object",
            r"$\theta\,a$ [rad]",
            rotation_vectors(turns),
            ("about $x$", "about $y$", "about $z$"),
        ),
        *_joint_panels(joints, times),
        *(() if forces is None else _force_panels(forces, times)),
    ]
    rows = -(-len(shown) // _COLUMNS)
    figure = Picture(9.0, 2.15 * rows + 0.2)
    axes = figure.subplots(rows, _COLUMNS, sharex=True, squeeze=False).ravel()
    for i, (ax, panel) in enumerate(zip(axes, shown, strict=False)):
        _draw(ax, ts, panel)
        last = i + _COLUMNS >= len(shown)
        tidy(ax, xlabel="time $t$ [s]" if last else "", ylabel=panel.label, title=panel.title)
        ax.tick_params(labelbottom=last)
    for ax in axes[len(shown) :]:
        ax.remove()
    figure.align_ylabels()
    if folder is not None:
        save(figure, folder, "responses3.png")
    return figure


def _given(name: str, values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(values, float)
    if array.shape != shape:
        raise ValueError(f"argument {name} must have shape {shape}, but had shape {array.shape}")
    return array


def _joint_panels(joints: Sequence[np.ndarray], times: int) -> list[Panel]:
    found = []
    for i, angles in enumerate(joints, 1):
        angles = np.asarray(angles, float)
        if angles.ndim != 2 or len(angles) != times:
            raise ValueError(f"argument joints must have shapes ({times}, k), but had shape {angles.shape}")
        if angles.shape[1]:
            names = tuple(f"$q_{{{i}{j + 1}}}$" for j in range(angles.shape[1]))
            found.append(Panel(f"Joint angles of finger {i}", "$q - q(0)$ [rad]", angles - angles[0], names))
    return found


def _force_panels(forces: np.ndarray, times: int) -> list[Panel]:
    given = np.asarray(forces, float)
    given = _given("forces", given, (len(given), times, 3))
    normal, along = given[..., 0].T, np.linalg.norm(given[..., 1:], axis=-1).T
    names = tuple(f"contact {i + 1}" for i in range(len(given)))
    ratio = np.divide(along, np.abs(normal), out=np.full_like(along, np.nan), where=normal != 0.0)
    return [
        Panel("Normal forces", "$f$ [N]", normal, names),
        Panel("Tangential forces", r"$|\lambda|$ [N]", along, names),
        Panel("Friction that rolling needs", r"$|\lambda| / |f|$", ratio, names),
    ]


def _draw(ax: Axes, ts: np.ndarray, panel: Panel) -> None:
    for k, line in enumerate(panel.values.T):
        ax.plot(ts, line, color=CYCLE[k % len(CYCLE)], lw=panel.width, label=panel.names[k])
    several = len(panel.names) > 1
    ax.margins(x=0.0, y=0.14 if several else 0.08)
    low, high = ax.get_ylim()
    if low <= 0.0 <= high:
        ax.axhline(0.0, color="#BBBBBB", lw=0.7, zorder=0)
    if several:
        ax.legend(
            ncols=min(3, len(panel.names)),
            fontsize=7.5,
            framealpha=0.8,
            edgecolor="none",
            handlelength=1.4,
            columnspacing=1.2,
        )
