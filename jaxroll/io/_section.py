"""Plane sections of closed triangle meshes.

The plane cuts an edge if its two vertices lie on different sides, and a face in two of its edges or none. So
the cut edges are the nodes of a graph and the cut faces its links; on a closed mesh every edge has two faces,
so that every node has two links and the graph falls into rings: the outlines. A vertex in the plane counts as
above it, which leaves no special cases, but may give points that coincide.

Written here because trimesh takes what lies within 1e-8 of the plane as in it, whatever the unit (a torus cut
one nanometre below its top has no section), and passes over outlines that do not close.
"""

from typing import Any

import numpy as np

from .._results import as_array, as_faces, as_floats, on_host, shown, told_apart
from ..geometry import polygon_area
from ._outline import as_points

# Area below which an outline has none, relative to the square of its extent.
_NO_AREA = 1e-12


@on_host
def section(vertices: Any, faces: Any, *, origin: Any, normal: Any) -> tuple[np.ndarray, ...]:
    r"""Outlines in which a plane cuts a closed mesh.

    Coordinates in the plane count from `origin` along $u$ and $v = n \times u$, where $u$ is the coordinate
    axis least along the normal $n$ (of equals the first), made perpendicular to it: x and y for a cut
    across z, y and z for one across x. Vertices in the plane count as above it.

    Args:
        vertices: Shape (n, 3) [m].
        faces: Shape (m, 3), indices of vertices.
        origin: Shape (3,), a point of the plane [m].
        normal: Shape (3,), not zero.

    Returns:
        Outlines of shape (k, 2) [m], ordered, counter-clockwise seen against the normal, that of the largest
        area first; holes are among them. Consecutive points may coincide, which `fit_contour` mends.

    Raises:
        ValueError: If the plane misses the mesh or only touches it, or the mesh is not closed there.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> tip = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 0.01
        >>> faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
        >>> (outline,) = jxr.io.section(tip, faces, origin=(0, 0, 0.005), normal=(0, 0, 1))
        >>> [f"{x:.3f}" for x in np.ptp(outline, axis=0)]
        ['0.005', '0.005']
    """
    vertices, normal = as_points("vertices", vertices, 3), _unit(normal)
    faces = as_faces(faces, len(vertices))
    arms = vertices - np.asarray(as_floats("origin", origin, (3,)), float)
    heights = arms @ normal
    nodes, links = _cuts(faces, heights >= 0.0)
    if not len(links):
        low, high = told_apart(heights.min(), heights.max(), least=4)
        raise ValueError(
            "argument origin must put the plane through the mesh, but along the normal the mesh lies from "
            f"{low} to {high} m of it"
        )
    # Where the height along an edge is zero, by linear interpolation: its ends have opposite signs.
    low, high = heights[nodes].T
    part = (low / (low - high))[:, None]
    cut = (1.0 - part) * arms[nodes[:, 0]] + part * arms[nodes[:, 1]]
    points = cut @ _axes(normal).T
    outlines = [points[loop] for loop in _loops(links, len(nodes))]
    # A plane that only touches a vertex or an edge cuts nothing off: what it leaves there has no area.
    outlines = [outline for outline in outlines if _has_area(outline)]
    if not outlines:
        raise ValueError(
            "argument origin must put the plane through the mesh, but along the normal it only touches it, "
            f"and the mesh lies from {heights.min():.4g} to {heights.max():.4g} m of it"
        )
    outlines = [outline if polygon_area(outline) >= 0.0 else outline[::-1] for outline in outlines]
    return tuple(sorted(outlines, key=polygon_area, reverse=True))


def _unit(normal: Any) -> np.ndarray:
    """The normal scaled to length one."""
    as_array("normal", normal)
    normal = np.asarray(normal, float)
    if normal.shape != (3,) or not np.all(np.isfinite(normal)) or not normal.any():
        raise ValueError(f"argument normal must be a vector of shape (3,), not zero, but was {shown(normal)}")
    # By its largest entry first, whose square may be infinite or zero.
    normal = normal / np.abs(normal).max()
    return normal / np.linalg.norm(normal)


def _has_area(outline: np.ndarray) -> bool:
    """Whether an outline encloses more than rounding."""
    size = float(np.ptp(outline, axis=0).max())
    return size > 0.0 and abs(polygon_area(outline)) > _NO_AREA * size**2


def _axes(normal: np.ndarray) -> np.ndarray:
    """Two unit vectors u and v = n x u in the plane across a unit normal, as rows."""
    first = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = first - (first @ normal) * normal
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def _cuts(faces: np.ndarray, above: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges that the plane cuts, and which of them share a face.

    Args:
        faces: Shape (m, 3), indices of vertices.
        above: Whether each vertex is above the plane.

    Returns:
        The cut edges as pairs of vertices, the smaller index first, each once: shape (k, 2). For every cut
        face the indices of its two cut edges among these: shape (l, 2).
    """
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1)
    cut = above[edges[..., 0]] != above[edges[..., 1]]
    touched = cut.any(axis=1)
    cut_edges = np.sort(edges[touched][cut[touched]].reshape(-1, 2), axis=1)
    nodes, numbers = np.unique(cut_edges, axis=0, return_inverse=True)
    return nodes, numbers.reshape(-1, 2)


def _loops(links: np.ndarray, count: int) -> list[np.ndarray]:
    """The rings into which links join `count` nodes, as indices in order.

    Raises:
        ValueError: If some node has not exactly two links: the mesh is open there.
    """
    degree = np.bincount(links.ravel(), minlength=count)
    if np.any(degree != 2):
        raise ValueError(
            "argument faces must form a closed surface at the plane, but "
            f"{int(np.sum(degree != 2))} of {count} edges cut there have not two faces"
        )
    both = np.concatenate([links, links[:, ::-1]])
    beside = both[np.argsort(both[:, 0], kind="stable"), 1].reshape(count, 2)
    # `beside`: the two neighbours of every node, found by sorting the links of both directions by node.
    fresh, loops = np.ones(count, bool), []
    for start in range(count):
        loop, here = [], start
        while fresh[here]:
            fresh[here] = False
            loop.append(here)
            here = int(beside[here, 0] if fresh[beside[here, 0]] else beside[here, 1])
        if loop:
            loops.append(np.array(loop))
    return loops
