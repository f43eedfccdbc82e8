"""Maps over two parameters: adaptive against the full grid, for pinches by their codes (about ten minutes).

`python -m benchmarks.maps --write` rewrites its section of README.md; `--quick`: 80 x 80 pinches. Friction of
both contacts runs along one axis, the radius of round fingertips, whose foremost point stays, along the
other; fingers without control of the angle (`alpha` 0) hold a rectangle for 0.5 s, or slip. Outcomes are the
codes of the runs.
"""

import jax
import jax.numpy as jnp
import numpy as np
from scipy import ndimage

import jaxroll as jxr
from benchmarks._common import checked, command

jax.config.update("jax_enable_x64", True)

# Distance of the fingertips' foremost points from O_i [m], as of the scene's own.
AHEAD = 0.01
SECONDS, RTOL, CHUNK = 0.5, 1e-5, 256


def pinch(p):
    """A pinch of the map."""
    tip = jxr.Circle(p.radius).moved(jnp.stack([AHEAD - p.radius, jnp.zeros_like(p.radius)]))
    return jxr.scenes.pinch(tips=tip, alpha=0.0, friction=p.friction)


def outcome(p):
    """The code with which a pinch ends."""
    return jxr.simulate(*pinch(p), SECONDS, ts=1, rtol=RTOL, throw=False).result


def grid(side: int) -> jxr.Parameters:
    """All pinches."""
    radius = np.linspace(0.004, 0.016, side)
    return jxr.Parameters.grid(friction=np.linspace(0.1, 1.0, side), radius=radius).with_units(radius="m")


def boundary(codes: np.ndarray) -> np.ndarray:
    """Points beside which another code stands."""
    across, up = (np.diff(codes, axis=axis) != 0 for axis in (0, 1))
    found = np.zeros(codes.shape, bool)
    found[1:] |= across
    found[:-1] |= across
    found[:, 1:] |= up
    found[:, :-1] |= up
    return found


def shift(ours: np.ndarray, theirs: np.ndarray) -> int:
    """How far a point of either boundary lies from the other one at most, in steps of the grid."""
    far = [
        ndimage.distance_transform_cdt(~boundary(b), metric="chessboard")[boundary(a)].max()
        for a, b in ((ours, theirs), (theirs, ours))
    ]
    return int(max(far))


def mapped(parameters: jxr.Parameters, levels: int) -> tuple[np.ndarray, int]:
    """Codes, and how many runs were done for them."""
    found = jxr.adaptive_map(outcome, parameters, levels=levels, chunk=CHUNK, progress=True)
    return np.asarray(found.values._value), found.spent


def report(quick: bool = False) -> str:
    """The table, as Markdown."""
    parameters = grid(80 if quick else 320)
    some, spent = mapped(parameters, 3 if quick else 4)
    every, runs = mapped(parameters, 0)
    shape = " x ".join(map(str, parameters.shape))
    held = f"{np.mean(every == 0):.1%} hold"
    rows = [
        [
            f"{shape} pinches ({held}): runs, repeated ones included, over the full grid's",
            "<= 0.2",
            f"{spent / runs:.3f}",
        ],
        ["boundary, against the full grid's [cells]", "<= 1", f"{shift(some, every)}"],
        ["points with another code", "", f"{int(np.sum(some != every))} of {every.size}"],
    ]
    return checked(rows, "jax", "diffrax")


if __name__ == "__main__":
    command("maps", report)
