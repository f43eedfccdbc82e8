"""How far a contour or surface is off what the equations of motion take for granted, over what is allowed.

What a class gives in closed form is compared with automatic differentiation at places all over the shape. An
error above one is wrong, and so is one that is not finite. `_contract` makes sentences of the errors of known
numbers, `_traced_contract` an array of those that JAX traces.
"""

import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._linalg import tangents, Vec2, Vec3
from .._results import shown
from .._types import ByPrecision, Scalar, Scalars
from .._xla import quickly
from .contours import AbstractContour, AbstractTabulated, frenet, Frenet2, Table, unevenness
from .surfaces import AbstractChart, AbstractImplicit, AbstractSurface, Gauss3, lattice

_TURNS = 9  # places at which a closed contour is compared with itself a turn later
# An endless contour is looked at within this of the start [m]: about the length of a finger.
RANGE = 0.1
# Nearest look about a start [m]; it also keeps the sizes by which errors are divided from being zero.
NEAREST = 1e-6
_SPREAD = 48  # places on a surface
_APART = 1e-6  # how far a frame's point may be from the curve's, relative to its largest coordinate
# Relative errors allowed of first derivatives along a contour, and of second ones.
_FIRST, _SECOND = ByPrecision(1e-9, 1e-4), ByPrecision(1e-6, 1e-2)
# The same for surfaces, where every error has this bound.
ON_SURFACE = ByPrecision(1e-6, 1e-2)


class Along(NamedTuple):
    """A contour at n places: what its frame says, what its curve does, and how far these are apart.

    Attributes:
        point: Of the frame [m].
        tangent: Of the frame.
        curvature: Of the frame [1/m].
        place: Of the curve [m].
        rate: Derivative of the curve by arclength, which has length one.
        bend: Curvature of the curve [1/m].
        off: Errors of point, speed, tangent and curvature over what is allowed of each, shape (n,).
    """

    point: Float[Array, "n 2"]
    tangent: Float[Array, "n 2"]
    curvature: Float[Array, " n"]
    place: Float[Array, "n 2"]
    rate: Float[Array, "n 2"]
    bend: Float[Array, " n"]
    off: dict[str, Float[Array, " n"]]


@quickly
def contour_along(contour: AbstractContour, places: Float[Array, " n"]) -> Along:
    """A prepared contour's own frame beside its curve, differentiated automatically."""

    def one(s: Scalar) -> tuple[Array, ...]:
        frame, curve = _frame(contour, s), frenet(contour.curve, s)
        own = frame.point.array(), frame.tangent.array(), jnp.asarray(frame.curvature, s.dtype)
        return *own, curve.point.array(), curve.tangent.array(), curve.curvature

    point, tangent, curvature, place, rate, bend = jax.vmap(one)(places)
    # What is read from a table may be off by the table's own error.
    slack = 4.0 * functools.reduce(jnp.maximum, map(unevenness, tables(contour)), 0.0)
    first, second = _FIRST.of(point) + slack, _SECOND.of(point) + slack
    # Errors of curvature are relative to the largest one, or to one over the extent of the places.
    largest = jnp.maximum(jnp.max(jnp.abs(curvature)), jnp.max(jnp.abs(bend)))
    scale = jnp.maximum(largest, 1.0 / jnp.maximum(jnp.ptp(places), NEAREST))
    off = {
        "point": _span(point - place) / (_APART * (_span(place) + NEAREST)),
        "speed": jnp.abs(jnp.hypot(rate[:, 0], rate[:, 1]) - 1.0) / first,
        "tangent": _span(tangent - rate) / (10.0 * first),
        "curvature": jnp.abs(curvature - bend) / (10.0 * second * scale),
    }
    return Along(point, tangent, curvature, place, rate, bend, off)


def _span(vectors: Float[Array, "n 2"]) -> Float[Array, " n"]:
    return jnp.max(jnp.abs(vectors), axis=1)


class Turned(NamedTuple):
    """A closed contour at n places and a turn later.

    Attributes:
        places: Arclengths [m].
        here: Points there [m].
        later: Points a length later [m].
        off: Errors of point, tangent and curvature, a length later or earlier, over what is allowed.
    """

    places: Float[Array, " n"]
    here: Float[Array, "n 2"]
    later: Float[Array, "n 2"]
    off: Float[Array, " n"]


@quickly
def contour_a_turn_later(contour: AbstractContour, low: Scalar, length: Scalar) -> Turned:
    """Whether a prepared contour that claims to be closed comes back to itself after its length [m]."""
    # Multiples of the golden ratio spread the places over the length without favouring its fractions.
    places = low + length * ((np.arange(_TURNS) * 0.6180339887498949) % 1.0)

    def one(s: Scalar) -> Array:
        frame = _frame(contour, s)
        parts = (*frame.point, *frame.tangent, frame.curvature)
        return jnp.stack([jnp.asarray(x, s.dtype) for x in parts])

    rounds = places[None] + length * np.array([[0.0], [1.0], [-1.0]])
    here, later, before = jax.vmap(one)(rounds.ravel()).reshape(3, _TURNS, 5)
    first, second = _FIRST.of(here), _SECOND.of(here)
    # Columns are x, y [m], the tangent, and the curvature, with the wider tolerance of second derivatives.
    size = jnp.max(jnp.abs(here[:, :2])) + length
    bend = 10.0 * second / first * (jnp.max(jnp.abs(here[:, 4])) + 1.0 / length)
    allowed = 100.0 * first * jnp.stack([size, size, jnp.ones_like(size), jnp.ones_like(size), bend])
    off = jnp.maximum(jnp.abs(later - here), jnp.abs(before - here)) / allowed[None]
    return Turned(places, here[:, :2], later[:, :2], jnp.max(off, axis=1))


def tables(value: Any) -> Iterator[Table]:
    """Tables that a contour reads, at any depth. Their speed is one only up to the table's error."""
    if isinstance(value, AbstractTabulated | Table):
        yield value if isinstance(value, Table) else value.read()
        return
    held = value if isinstance(value, tuple | list) else ()
    for part in vars(value).values() if isinstance(value, eqx.Module) else held:
        yield from tables(part)


def _frame(contour: AbstractContour, s: Array) -> Frenet2:
    """The contour's frame at one arclength; raises if a method gives another type than it must."""
    frame = contour.frame(s)
    if not isinstance(frame, Frenet2) or not isinstance(contour.curve(s), Vec2):
        kind = type(contour).__name__
        raise ValueError(
            f"argument contour must give a Vec2 by `curve` and a Frenet2 by `frame`, but {kind} gave "
            f"a {type(contour.curve(s)).__name__} and a {type(frame).__name__}"
        )
    return frame


@quickly
def surface_off(surface: AbstractSurface) -> dict[str, Scalar]:
    """The largest error of each kind at places all over a surface, over what is allowed (`over_allowed`)."""
    ready = surface.prepared()
    at = _all_over(ready)
    found = jax.vmap(lambda *one: _errors(ready, one))(*at)
    seam = _seam(ready, at) if isinstance(ready, AbstractChart) else jnp.zeros(())
    return over_allowed(found, seam)


def over_allowed(errors: dict[str, Array], seam: Scalar) -> dict[str, Scalar]:
    """The largest of relative errors at several places, over what is allowed.

    Places that are not on the surface after all ("there" is zero), or where an error is not finite (a pole
    of a chart), are left out; where none remain, "unseen" is infinite. "seam" is the error of a chart's
    periods.
    """
    there = errors["there"]
    kinds = {name: values for name, values in errors.items() if name != "there"}
    seen = jnp.all(jnp.isfinite(jnp.stack(list(kinds.values()))), axis=0) & (there > 0)
    allowed = ON_SURFACE.of(there)
    found = {name: jnp.max(jnp.where(seen, values, 0.0)) / allowed for name, values in kinds.items()}
    unseen = jnp.where(jnp.any(seen), 0.0, jnp.inf).astype(there.dtype)
    return found | {"seam": (seam / (10.0 * allowed)).astype(there.dtype), "unseen": unseen}


def _all_over(surface: AbstractSurface) -> Scalars:
    """Coordinates of `_SPREAD` places: the surface's own, or points of a cube brought to it."""
    at = surface.spread(_SPREAD)
    if at is None:
        seeds = jnp.asarray((lattice(_SPREAD, 3) - 0.5) * (2.0 * RANGE))
        at = jax.vmap(lambda p: surface.settled(surface.start(Vec3(p[0], p[1], p[2]))))(seeds)
    kind = jnp.result_type(float)
    return tuple(jnp.broadcast_to(jnp.asarray(x, kind), (_SPREAD,)) for x in at)


def _errors(surface: AbstractSurface, at: Scalars) -> dict[str, Array]:
    """Errors at one place, by the end of their message; "there" says whether the place is on the surface."""
    frame = surface.frame(at)
    if not isinstance(frame, Gauss3):
        raise ValueError(
            f"argument surface must give a Gauss3 by `frame`, but {type(surface).__name__} gave "
            f"{shown(frame)}"
        )
    # Errors of curvatures are relative to `size`: the curvatures plus one over the distance from the origin.
    normal, length = frame.normal, frame.normal.norm()
    moved, turned = [], []
    size = jnp.sqrt(frame.shape.squares()) + 1.0 / (frame.point.norm() + NEAREST)
    # For either of two unit tangents t, the coordinates' rates must move the point by t, the normal by L t.
    for way in tangents(normal * (1.0 / length)):
        rates = tuple(jnp.asarray(x, length.dtype) for x in surface.rate(at, way))
        _, change = jax.jvp(lambda at: jax.tree.map(jnp.asarray, surface.frame(at)), (at,), (rates,))
        moved.append((Vec3(*change.point) - way).norm())
        turned.append((Vec3(*change.normal) - frame.shape.apply(way)).norm() / size)
    found = {
        "normal has length one": jnp.abs(length - 1.0),
        "coordinates move as `rate` says": jnp.maximum(*moved),
        "shape operator is the derivative of its normal": jnp.maximum(*turned),
        "shape operator is zero along its normal": frame.shape.apply(normal).norm() / size,
        "there": jnp.ones_like(length),
    }
    return found | (_field_errors(surface, at, normal) if isinstance(surface, AbstractImplicit) else {})


def _field_errors(surface: AbstractImplicit, at: Scalars, normal: Vec3) -> dict[str, Array]:
    """Whether gradient and second derivatives are those of the field, and the normal along the gradient."""
    level = surface.derivatives(Vec3(*at))
    rates, bends = [], []
    for i in range(3):
        way = tuple(jnp.full_like(x, float(i == k)) for k, x in enumerate(at))
        _, change = jax.jvp(lambda *p: jax.tree.map(jnp.asarray, surface.derivatives(Vec3(*p))), at, way)
        rates.append(change.value)
        bends.append(Vec3(*change.gradient) - level.hessian.apply(Vec3(*way)))
    # The field's value differentiated automatically, and whether Newton's method arrived at its zero.
    slope = Vec3(*rates)
    steep = slope.norm()
    size = jnp.sqrt(level.hessian.squares()) + steep / (Vec3(*at).norm() + NEAREST)
    arrived = jnp.abs(level.value) <= 1e-6 * steep * (Vec3(*at).norm() + NEAREST)
    return {
        "gradient is that of its field": (level.gradient - slope).norm() / steep,
        "second derivatives are those of its field": jnp.max(jnp.stack([b.norm() for b in bends])) / size,
        "normal is along its field's gradient": (normal * steep - slope).norm() / steep,
        "there": jnp.where(arrived, 1.0, 0.0).astype(steep.dtype),
    }


def _seam(chart: AbstractChart, at: Scalars) -> Array:
    """Largest distance of points a period apart, relative to the size."""
    points = lambda *one: chart.derivatives(one).point  # noqa: E731
    here, off = jax.vmap(points)(*at), [jnp.zeros(())]
    size = jnp.max(here.norm())
    for k, ((low, high), loop) in enumerate(zip(chart.domain(), chart.periodic, strict=True)):
        if loop:
            later = tuple(x + (high - low) if i == k else x for i, x in enumerate(at))
            off.append(jnp.max((jax.vmap(points)(*later) - here).norm()) / size)
    return jnp.max(jnp.stack(off))
