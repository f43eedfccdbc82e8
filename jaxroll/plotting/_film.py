"""Films: the frames of an animation as a GIF, or as an MP4 where ffmpeg is installed."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import FFMpegWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from .._results import as_positive, shown
from ..io._paths import writable
from . import _gif

# How long the last frame stays [ms].
_HOLD = 1500
# How long a frame of a GIF may stay [s]: it counts hundredths in 16 bits.
_LONGEST = 655.0
_DPI = 100


def write_film(
    path: Path, frames: list[Image.Image], delay: int, kept: tuple[str, ...] = _gif.KEPT_COLOURS
) -> None:
    """Write frames that stay `delay` milliseconds each, the last one longer."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() == ".gif":
        _gif.write(path, frames, [*[delay] * (len(frames) - 1), _HOLD], kept)
    else:
        _mp4(path, frames, delay)


def _mp4(path: Path, frames: list[Image.Image], delay: int) -> None:
    """Write a film in H.264; matplotlib makes its sides even, as that asks for."""
    width, height = frames[0].size
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    FigureCanvasAgg(figure)
    picture = figure.figimage(np.asarray(frames[0]))
    rate: Any = 1000.0 / delay  # a fraction too, whatever matplotlib's annotation says
    writer = FFMpegWriter(fps=rate, codec="h264", bitrate=-1, extra_args=["-crf", "20"])
    held = [frames[-1]] * (_HOLD // delay)
    with writer.saving(figure, str(path), _DPI):
        for frame in [*frames, *held]:
            picture.set_data(np.asarray(frame))
            writer.grab_frame()


def check_delay(name: str, value: float, delay: float) -> float:
    """How long a frame stays [s], unless an argument makes it longer than a GIF can say."""
    if delay > _LONGEST:
        raise ValueError(
            f"argument {name} must show no frame for more than {_LONGEST:g} s, but was {value:g}"
        )
    return delay


def check_stays(name: str, value: float, rows: np.ndarray, delay: float) -> None:
    """Raise if one saved state stays for longer than a GIF can say, which makes one of equal frames in a row.

    Args:
        name: The argument to blame, for the error.
        value: The value of that argument.
        rows: The saved state that each frame shows.
        delay: How long a frame stays [s].
    """
    stays = delay * np.unique(rows, return_counts=True)[1]
    stays[-1] += 1e-3 * _HOLD - delay
    check_delay(name, value, float(stays.max()))


def hundredths(fps: float) -> int:
    """How long a frame stays in hundredths of a second, as a GIF counts: at least two, for browsers."""
    return max(2, round(100.0 * check_delay("fps", fps, 1.0 / fps)))


def clock_texts(ts: np.ndarray) -> list[str]:
    """What the clock of a film shows at its times: hundredths of a second, or finer where it is short."""
    span = float(ts[-1] - ts[0]) or abs(float(ts[-1])) or 1.0
    digits = max(2, 1 - int(np.floor(np.log10(span))))
    return [f"t = {t:.{digits}f} s" for t in ts]


def positive_numbers(**numbers: Any) -> tuple[float, ...]:
    """Arguments as numbers, which must be positive."""
    return tuple(float(as_positive(name, x)) for name, x in numbers.items())


def checked_path(path: str | Path) -> Path:
    """The path of a film that can be written here."""
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in (".gif", ".mp4"):
        raise ValueError(f"argument path must end in .gif or .mp4, but was {shown(str(path))}")
    if kind == ".mp4" and not FFMpegWriter.isAvailable():
        raise ValueError(
            "argument path must end in .gif where there is no program ffmpeg, which writes an MP4, but was "
            f"{shown(str(path))}"
        )
    return writable(path)
