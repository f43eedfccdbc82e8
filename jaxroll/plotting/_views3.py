"""Where everything of a grasp in space is at every time, and from where it is seen."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from .._linalg import seven
from .._mechanics import check_spatial, compiled, Grasp, State, to_leaves
from .._motion import touches, world_poses
from .._results import as_floats, check_flag, shown
from ._motion3 import Motion3D, turned
from ._outlines import in_blocks
from ._views import along_time, STATES


@dataclass(frozen=True)
class View:
    """How a grasp in space is looked at.

    Args:
        elevation: Of the camera above the x-y plane, in degrees. Default: 22.
        azimuth: Of the camera about z, in degrees, as matplotlib counts. Default: it sees the first contact
            from the side.
        turn: The angle through which the camera goes round during an animation, in degrees.
        links: Whether to draw the links of the fingers; without them the bodies in contact, and what has
            rolled, fill the picture.

    Example:
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> view = plotting.View(azimuth=-70.0, links=False)
        >>> plotting.pose(*jxr.scenes.turntable(), view=view).axes[0].azim
        -70.0
    """

    elevation: float | None = None
    azimuth: float | None = None
    turn: float = 0.0
    links: bool = True

    def __post_init__(self) -> None:
        for name in ("elevation", "azimuth", "turn"):
            value = getattr(self, name)
            if value is not None or name == "turn":
                as_floats(name, value, ())
        check_flag("links", self.links)


def scene_motion(grasp: Grasp, states: State) -> Motion3D:
    """Motion of a spatial grasp at states with a leading time axis, or at one state."""
    check_spatial(grasp)
    placed = lambda some: _placed(grasp, some)  # noqa: E731
    body, tips, skeletons, *at_contacts = in_blocks(placed, along_time(states), length=STATES)
    # Time comes first; `Motion3D` wants it second.
    return Motion3D(body, tips.swapaxes(0, 1), skeletons, *(a.swapaxes(0, 1) for a in at_contacts))


@compiled
def _placed(grasp: Grasp, states: State):
    ready = grasp.prepared()

    def at(state: State):
        leaves = to_leaves(state, ready.form)
        body, *tips = (seven(frame) for frame in world_poses(ready, leaves.q))
        skeletons = tuple(
            jnp.stack([p.array() for p in finger.skeleton(q)])
            for finger, q in zip(ready.fingers, leaves.q[1:], strict=True)
        )
        touching = touches(ready, leaves.s)
        pairs = (
            [t.tip.point for t in touching],
            [t.object.point for t in touching],
            [t.tip.normal for t in touching],
            [t.object.normal for t in touching],
        )
        at_contacts = [jnp.stack([vector.array() for vector in vectors]) for vectors in pairs]
        return body, jnp.stack(tips), skeletons, *at_contacts

    # Row by row, which compiles sooner than all at once.
    return jax.lax.map(at, states)


def turned_each(poses: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Body-frame directions in world axes, a pose for each; shapes (t, 7) and (t, 3)."""
    return np.stack([turned(pose, vector) for pose, vector in zip(poses, vectors, strict=True)])


def check_options(grasp: Grasp, **given: object) -> None:
    """Raise where an argument has no meaning for this kind of grasp: all must be None."""
    kind = "in space" if grasp.spatial else "in the plane"
    for name, value in given.items():
        if value is not None:
            raise ValueError(f"argument {name} must be None for a grasp {kind}, but was {shown(value)}")
