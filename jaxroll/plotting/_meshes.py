"""Triangle meshes of surfaces, to be drawn.

Written here because pictures need no extra: trimesh, of the extra `cad`, has spheres and tori, but nothing
for a chart or an implicit surface.
"""

from dataclasses import dataclass, replace
from functools import cached_property, singledispatch

import numpy as np

from .._results import as_positive, shown
from ..geometry import (
    AbstractChart,
    AbstractImplicit,
    AbstractSurface,
    Cylinder,
    Ellipsoid,
    Hollow,
    MovedSurface,
    Plane,
    Sphere,
    SplineSurface,
    Superellipsoid,
    Torus,
)
from ..geometry.surfaces import surface_net
from ._motion3 import matrices
from ._rays import inside, OVERHANG, radii

# Vertices closer than this share of the mesh's size count as one.
# The digits are arbitrary. With a round number the vertices of regular grids would lie right between two
# cells of the rounding in `_welded`, and two vertices that should be one could fall into different cells.
_SAME = 1.2345e-7
# Patches along u and v.
_PATCHES = (8, 4)


@dataclass(frozen=True)
class Mesh:
    """Triangles of a surface, in its body's frame.

    Attributes:
        vertices: Shape (n, 3) [m].
        faces: Shape (k, 3), numbers of vertices, counter-clockwise seen from outside the body.
        checks: Shape (k,), 0 or 1: a pattern of patches that shows how the body turns.
    """

    vertices: np.ndarray
    faces: np.ndarray
    checks: np.ndarray

    @cached_property
    def closed(self) -> bool:
        """Whether every edge belongs to two triangles, which run along it in opposite senses."""
        edges = np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])
        ahead, back = (np.unique(e, axis=0) for e in (edges, edges[:, ::-1]))
        return len(ahead) == len(edges) and np.array_equal(ahead, back)

    @property
    def areas(self) -> np.ndarray:
        """Outward normals of the triangles, as long as twice their areas, shape (k, 3) [m^2]."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)


def mesh(
    surface: AbstractSurface,
    *,
    rows: int = 24,
    columns: int = 48,
    extent: float | None = None,
    about: np.ndarray | None = None,
) -> Mesh:
    """Triangles with their corners on a surface.

    Closed forms and charts are sampled in their own parameters, a field of splines at the nodes of its own
    grid. Any other implicit surface is met along rays from a point inside, which shows all of it if the rays
    from there meet it once.

    Args:
        surface: What to draw.
        rows: How many cells from pole to pole, or along v of a chart; each is two triangles.
        columns: How many cells around, or along u of a chart.
        extent: How far from `about` to draw a plane or a cylinder, which have no end [m].
        about: The middle of what is drawn of these, shape (3,) [m]. Default: the body's origin.

    Raises:
        ValueError: If an implicit surface has no inside or no outside, or `extent` is missing.

    Example:
        >>> import jaxroll as jxr
        >>> from jaxroll.plotting._meshes import mesh
        >>> ball = mesh(jxr.geometry.Sphere(0.01), rows=4, columns=8)
        >>> ball.vertices.shape, ball.faces.shape, ball.closed
        ((26, 3), (48, 3), True)
    """
    middle = np.zeros(3) if about is None else np.asarray(about, float)
    return _mesh(surface, (rows, columns), extent, middle)


def box_mesh(edges: np.ndarray) -> Mesh:
    """The box about the origin with these edge lengths, shape (3,) [m]."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [half for a, b, c, d in quads for half in ((a, b, c), (a, c, d))]
    # Corner 4 x + 2 y + z, each 0 or 1; the quadrangles run counter-clockwise seen from outside.
    return Mesh(0.5 * np.asarray(edges, float) * signs, np.array(faces), np.zeros(len(faces), int))


def endless(surface: AbstractSurface) -> bool:
    """Whether a surface needs an extent to be drawn."""
    if isinstance(surface, MovedSurface | Hollow):
        return endless(surface.surface)
    return isinstance(surface, Plane | Cylinder)


@singledispatch
def _mesh(surface: AbstractSurface, counts: tuple[int, int], extent: float | None, about: np.ndarray) -> Mesh:
    raise ValueError(f"argument surface must be a surface that can be drawn, but was {shown(surface)}")


@_mesh.register
def _(surface: MovedSurface, counts, extent, about):
    turn = np.eye(3)
    if surface.rotation is not None:
        quaternion = np.asarray(surface.rotation, float)
        turn = matrices(quaternion / np.linalg.norm(quaternion))
    offset = np.asarray(surface.offset, float)
    # `about` is in the placed surface's frame: R^T (about - offset) in its own.
    found = _mesh(surface.surface, counts, extent, (about - offset) @ turn)
    return replace(found, vertices=found.vertices @ turn.T + offset)


@_mesh.register
def _(surface: Hollow, counts, extent, about):
    found = _mesh(surface.surface, counts, extent, about)
    # Triangles that run the other way face the other way.
    return replace(found, faces=found.faces[:, ::-1])


@_mesh.register
def _(surface: Sphere, counts, extent, about):
    ball = _ball(counts)
    return replace(ball, vertices=float(surface.radius) * ball.vertices)


@_mesh.register
def _(surface: Ellipsoid, counts, extent, about):
    ball = _ball(counts)
    return replace(ball, vertices=_axes(surface) * ball.vertices)


@_mesh.register
def _(surface: Superellipsoid, counts, extent, about):
    ball, p = _ball(counts), surface.exponent
    # A direction d meets sum |x_i|^p = 1 at d / (sum |d_i|^p)^(1/p); the axes stretch that.
    reach = np.sum(np.abs(ball.vertices) ** p, axis=1, keepdims=True) ** (-1.0 / p)
    return replace(ball, vertices=_axes(surface) * reach * ball.vertices)


@_mesh.register
def _(surface: Torus, counts, extent, about):
    u, v = _grid((0.0, 2.0 * np.pi), (0.0, 2.0 * np.pi), counts)
    radial = float(surface.major) + float(surface.minor) * np.cos(v)
    points = np.stack([radial * np.cos(u), radial * np.sin(u), float(surface.minor) * np.sin(v)], axis=-1)
    return _welded(points, counts)


@_mesh.register
def _(surface: Cylinder, counts, extent, about):
    half, radius = _given(extent), float(surface.radius)
    u, v = _grid((0.0, 2.0 * np.pi), (about[2] - half, about[2] + half), counts)
    return _welded(np.stack([radius * np.cos(u), radius * np.sin(u), v], axis=-1), counts)


@_mesh.register
def _(surface: Plane, counts, extent, about):
    half, few = _given(extent), (8, 8)
    u, v = _grid((about[0] - half, about[0] + half), (about[1] - half, about[1] + half), few)
    return _welded(np.stack([u, v, np.zeros_like(u)], axis=-1), few)


@_mesh.register
def _(surface: AbstractChart, counts, extent, about):
    (u0, u1), (v0, v1) = surface.domain()
    u, v = _grid((float(u0), float(u1)), (float(v0), float(v1)), counts)
    return _welded(np.asarray(surface.point(np.stack([u, v], axis=-1))), counts)


@_mesh.register
def _(surface: SplineSurface, counts, extent, about):
    # At the field's own resolution, two nodes to a cell or more: whatever the shape, it is not star-shaped
    # about any point that one could choose.
    cells = np.array(surface.coefficients.shape) - OVERHANG
    fine = int(np.clip(np.ceil(counts[1] / cells.max()), 2, 6))
    vertices, faces = surface_net(surface, fine)
    if not len(faces):
        raise ValueError("argument surface must have an inside and an outside on its grid to be drawn")
    found = Mesh(vertices, faces, np.zeros(len(faces), int))
    if not found.closed:
        raise ValueError("argument surface must be closed within its grid to be drawn")
    return replace(found, checks=_octants(found))


@_mesh.register
def _(surface: AbstractImplicit, counts, extent, about):
    ball, centre = _ball(counts), inside(surface)
    # The directions of a sphere, each as long as its ray from the point inside.
    reach = radii(surface, centre, ball.vertices)[:, None]
    return replace(ball, vertices=centre + reach * ball.vertices)


def _octants(found: Mesh) -> np.ndarray:
    """A pattern of eight patches: in which octant about the middle each triangle lies."""
    middles = found.vertices[found.faces].mean(axis=1)
    return np.sum(middles > 0.5 * (found.vertices.max(axis=0) + found.vertices.min(axis=0)), axis=1) % 2


def _axes(surface: Ellipsoid | Superellipsoid) -> np.ndarray:
    return np.array([float(surface.a), float(surface.b), float(surface.c)])


def _given(extent: float | None) -> float:
    if extent is None:
        raise ValueError("argument extent must be positive for a surface without end, but was None")
    return float(as_positive("extent", extent))


def _ball(counts: tuple[int, int]) -> Mesh:
    """The unit sphere: directions in rings from pole to pole."""
    u, v = _grid((0.0, 2.0 * np.pi), (-0.5 * np.pi, 0.5 * np.pi), counts)
    ring = np.cos(v)
    found = _welded(np.stack([ring * np.cos(u), ring * np.sin(u), np.sin(v)], axis=-1), counts)
    return replace(found, vertices=found.vertices / np.linalg.norm(found.vertices, axis=1, keepdims=True))


def _grid(
    u: tuple[float, float], v: tuple[float, float], counts: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters in steps of equal size, u along the first axis; both ends included."""
    rows, columns = counts
    along_u, along_v = np.meshgrid(np.linspace(*u, columns + 1), np.linspace(*v, rows + 1), indexing="ij")
    return along_u, along_v


def _welded(points: np.ndarray, counts: tuple[int, int]) -> Mesh:
    """The mesh of a grid of points, closed where its edges meet or shrink to a point."""
    rows, columns = counts
    number = np.arange((columns + 1) * (rows + 1)).reshape(columns + 1, rows + 1)
    a, b, c, d = (part.ravel() for part in _corners(number))
    faces = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
    flat = points.reshape(-1, 3)
    # Equal vertices are numbered once. Triangles that thereby lose an edge, as at a pole, are left out.
    cells = np.round(flat / (_SAME * np.ptp(flat, axis=0).max())).astype(np.int64)
    _, first, kept = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    faces = kept.reshape(-1)[faces]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    i, j = np.indices((columns, rows))
    patches = (_PATCHES[0] * i // columns + _PATCHES[1] * j // rows) % 2
    return Mesh(flat[first], faces[whole], np.tile(patches.ravel(), 2)[whole])


def _corners(number: np.ndarray) -> tuple[np.ndarray, ...]:
    """The corners of all cells of a grid, counter-clockwise."""
    return number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
