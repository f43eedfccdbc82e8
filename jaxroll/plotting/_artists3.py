"""Artists for axes in space that matplotlib does not have: arrows, and many triangles at once."""

from typing import Any

import numpy as np
from matplotlib.artist import allow_rasterization, Artist
from matplotlib.patches import FancyArrowPatch
from matplotlib.transforms import IdentityTransform
from mpl_toolkits.mplot3d import proj3d

# No triangles: their corners and their colours.
NO_TRIANGLES = (np.zeros((0, 3, 3)), np.zeros((0, 3)))


class Arrow(FancyArrowPatch):
    """An arrow in space whose head keeps its size on the page."""

    def __init__(self, **style: Any) -> None:
        super().__init__((0.0, 0.0), (0.0, 0.0), arrowstyle="-|>", shrinkA=0, shrinkB=0, **style)
        self.ends = np.zeros((2, 3))

    def do_3d_projection(self, renderer: Any = None) -> float:
        """Called by the axes before it draws."""
        ax: Any = self.axes
        xs, ys, zs = proj3d.proj_transform(*self.ends.T, ax.M)  # pyright: ignore[reportCallIssue]
        self.set_positions((xs[0], ys[0]), (xs[1], ys[1]))
        return float(np.min(zs))


class Triangles(Artist):
    """Triangles in space, each of one colour, painted from the farthest to the nearest.

    matplotlib's `Poly3DCollection` makes a path of each triangle, and an animation of some thousands of them
    takes more than twice as long. Here all go to the renderer in one call, as triangles whose colour is
    interpolated between their corners, which are of the same colour. The renderer lets them overlap by half
    a pixel, so that no background shows through their seams. In a file of lines, such as an SVG or a PDF,
    the triangles are an embedded picture.

    Attributes:
        corners: Shape (k, 3, 3), in the units of the axes.
        colours: Shape (k, 3), or (k, 4) whose last is not looked at.
    """

    def __init__(self, **style: Any) -> None:
        super().__init__()
        self.set_rasterized(True)
        self.set(**style)
        self.corners, self.colours = NO_TRIANGLES

    @allow_rasterization
    def draw(self, renderer: Any) -> None:
        """Called by the axes."""
        if not self.get_visible() or not len(self.corners):
            return
        ax: Any = self.axes
        xs, ys, depths = proj3d.proj_transform(*self.corners.reshape(-1, 3).T, ax.M)  # pyright: ignore
        pixels = ax.transData.transform(np.stack([xs, ys], axis=-1)).reshape(-1, 3, 2)
        farthest_first = np.argsort(-np.reshape(depths, (-1, 3)).mean(axis=1), kind="stable")
        opaque = np.ones((len(self.colours), 4))
        opaque[:, :3] = self.colours[:, :3]
        of_corners = np.repeat(opaque[farthest_first, None], 3, axis=1)
        context = renderer.new_gc()
        if self.get_clip_on():
            context.set_clip_rectangle(self.get_clip_box())
            context.set_clip_path(self.get_clip_path())
        renderer.draw_gouraud_triangles(context, pixels[farthest_first], of_corners, IdentityTransform())
        context.restore()
