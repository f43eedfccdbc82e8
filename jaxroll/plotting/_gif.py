"""GIF files: times to show, one palette for all frames, and Pillow that writes them.

The palette is made here because matplotlib's writer leaves it to Pillow, which takes one per frame (colours
are off by five times as much), and imageio makes files 1.6 times as large in six times the time; neither
holds the last frame.
"""

from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgba_array
from PIL import Image

from ._style import CONTACT, FINGER, FORCE_COLOUR, OBJECT, ROLLED

# Colours of small things, which a palette made by counting pixels would merge with others.
KEPT_COLOURS = ("white", CONTACT, FORCE_COLOUR, FINGER, OBJECT, ROLLED)


def write(path: Path, frames: list[Image.Image], delays: list[int], kept: tuple[str, ...]) -> None:
    """Write a looping GIF, whose frames stay `delays` [ms]; one palette, so that no colour flickers."""
    width, height = frames[0].size
    samples = [frames[k * (len(frames) - 1) // 2] for k in range(3)]
    mosaic = Image.new("RGB", (3 * width, height))
    for k, sample in enumerate(samples):
        mosaic.paste(sample, (k * width, 0))
    palette = mosaic.quantize(256 - len(kept))
    found = np.reshape(palette.getpalette() or [], (-1, 3))[: 256 - len(kept)]
    found[found.min(axis=1) > 246] = 255
    fixed = np.round(255 * to_rgba_array(kept)[:, :3]).astype(int)
    palette.putpalette(np.concatenate([fixed, found]).ravel().tolist())
    first, *rest = (f.quantize(palette=palette, dither=Image.Dither.NONE) for f in frames)
    first.save(path, save_all=True, append_images=rest, duration=delays, loop=0)


def nearest_rows(ts: np.ndarray, step: float) -> np.ndarray:
    """Rows of the saved times nearest to times `step` apart, the last among them."""
    # The last time comes by itself: half a step before it the even ones end.
    wanted = np.append(np.arange(ts[0], ts[-1] - 0.5 * step, step), ts[-1])
    return np.argmin(np.abs(ts[:, None] - wanted), axis=0)
