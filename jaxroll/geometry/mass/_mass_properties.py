r"""`mass_properties`: mass, size, centre and inertia of the body within a shape, at a density.

Which integrals these are, `_moments` says; here the kind of shape decides who finds them.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._printing import listed
from ..._results import as_array, as_floats, as_length, as_positive, shown, traced
from ..._types import Given
from .._contract import check_once_round, check_shape
from ..contours import AbstractContour
from ..surfaces import AbstractSurface
from ._contour_moments import contour_moments
from ._mesh_moments import mesh_moments
from ._moments import inertia_of, Moments
from ._surface_moments import surface_moments


class MassProperties(eqx.Module):
    """Mass and inertia of a body of constant density.

    Attributes:
        mass: In kilograms.
        size: Area [m^2] within a contour, volume [m^3] within a surface or mesh.
        centre: Centre of mass in the shape's frame, shape (2,) or (3,) [m].
        inertia: About the centre of mass [kg m^2]: of a contour the moment about the axis normal to the
            plane; in space a matrix, shape (3, 3), in the axes of the shape's frame.
        error: Estimated relative error of the integrals; zero for closed forms and meshes, where rounding
            alone is left.
    """

    __repr__ = listed

    mass: Float[Array, ""]
    size: Float[Array, ""]
    centre: Float[Array, " d"]
    inertia: Float[Array, "..."]
    error: float = eqx.field(static=True)


def mass_properties(
    shape: AbstractContour | AbstractSurface | Sequence[Any],
    density: Given,
    *,
    thickness: Given | None = None,
) -> MassProperties:
    r"""Mass, centre and inertia of the body of constant density within a closed shape.

    Args:
        shape: A closed contour, a closed surface with known bounds, or a watertight mesh: its vertices, shape
            (n, 3) [m], and its faces, shape (m, 3), whole numbers, counter-clockwise from outside; a pair, or
            an object with `vertices` and `faces`, such as a mesh of trimesh.
        density: In space [kg/m^3]; of a contour mass per area [kg/m^2], or with `thickness` [kg/m^3].
        thickness: Of the plate that a contour outlines [m].

    Returns:
        A `MassProperties`. Of contours, of spheres, ellipsoids, superellipsoids and tori it is differentiable
        in the shape's numbers, of every shape in `density` and `thickness`.

    Raises:
        ValueError: If a shape has ends or no bounds, a contour crosses itself, a contour or chart runs round
            more than once, a mesh has holes, or parts that overlap more than a little, or the normal points
            inward.

    Accuracy: closed forms and meshes to rounding. A contour is integrated as its table has it: an ellipse as
    a `Parametric` to 1e-14. Charts and patches settle to 1e-12, implicit surfaces of any genus to 1e-9 or
    less (smooth ones of a closed form to 1e-11), by grids of 16, 32, 64 and 96 cells along the longest side;
    fields of splines, by grids at their knots, until they change by 1e-6 or less, which leaves 1e-9 or so;
    parts thinner than a cell may not be seen. `error` is the change at the last refinement, larger than what
    is left.

    Example:
        >>> import jaxroll as jxr
        >>> ball = jxr.geometry.mass_properties(jxr.Sphere(0.02), density=1000.0)
        >>> f"{1e3 * ball.mass:.2f} g, {1e6 * ball.inertia[0, 0]:.3f} kg mm^2"
        '33.51 g, 5.362 kg mm^2'
    """
    per = as_positive("density", density)
    planar = isinstance(shape, AbstractContour)
    if thickness is not None:
        if not planar:
            raise ValueError(f"argument thickness must be None in space, but was {shown(thickness)}")
        per = per * as_length("thickness", thickness)
    found = _moments_of(shape)
    inertia = inertia_of(found.spread, per)
    size = jnp.asarray(found.size)
    return MassProperties(per * size, size, jnp.asarray(found.centre), inertia, found.error)


def _moments_of(shape: Any) -> Moments:
    if isinstance(shape, AbstractContour | AbstractSurface):
        check_shape("shape", shape)
        check_once_round("shape", shape)
        return contour_moments(shape) if isinstance(shape, AbstractContour) else surface_moments(shape)
    pair = shape if isinstance(shape, tuple | list) else _fields(shape)
    shapes = [x for x in pair or () if isinstance(x, AbstractContour | AbstractSurface)]
    if shapes:
        raise ValueError(f"argument shape must be one shape, but was several: {shown(shape)}")
    if pair is None or len(pair) != 2:
        raise ValueError(
            f"argument shape must be a contour, a surface, or vertices and faces, but was {shown(shape)}"
        )
    return mesh_moments(*_mesh(*pair))


def _fields(shape: Any) -> tuple[Any, Any] | None:
    known = hasattr(shape, "vertices") and hasattr(shape, "faces")
    return (shape.vertices, shape.faces) if known else None


def _mesh(vertices: Any, faces: Any) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces as NumPy's arrays, checked."""
    if traced((vertices, faces)):
        raise ValueError("argument shape must be known before tracing where it is a mesh, but was traced")
    given = [x if isinstance(x, np.ndarray | list | tuple) else np.asarray(x) for x in (vertices, faces)]
    corners = np.asarray(as_floats("shape, in its vertices,", given[0], (None, 3)), float)
    whole = np.asarray(as_array("shape, in its faces,", given[1]), float)
    wanted = f"argument shape must have faces of three whole numbers from 0 to {len(corners) - 1}, but "
    if whole.ndim != 2 or whole.shape[1] != 3:
        raise ValueError(f"{wanted}they were {shown(whole)}")
    wrong = whole[~((whole == np.round(whole)) & (whole >= 0) & (whole < len(corners)))]
    if len(wrong):
        raise ValueError(f"{wanted}one was {wrong[0]:g}")
    return corners, whole.astype(int)
