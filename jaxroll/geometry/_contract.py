r"""What the equations of motion take for granted of a contour or surface, checked for a caller's own classes.

Of a contour: speed $|c'| = 1$, a frame (8)-(10) that is the curve's, and ends that meet where it claims to be
closed. Of a surface: a unit normal, its derivative as shape operator, and coordinates that move as `rate`
says. What a class gives in closed form is compared with automatic differentiation at places all over the
shape.

Shapes of the package keep this by construction, but for the periods of a `Chart`, which are the caller's. A
shape of a caller's own class, at any depth in wrappers, is checked once before a grasp or a search for
contacts uses it; the verdict is kept by identity (`remembered`). Numbers that JAX traces have no values to
check; programs look at them themselves (`_traced_contract`).

`check_once_round` looks at what no class can promise: that a closed curve, whoever gave its numbers, runs
once round a body and does not cross itself. Without that it has no inside, and no mass.
"""

from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._linalg import tangents, Vec2, Vec3
from .._results import as_order, computed_at_once, is_foreign, NO_VALUES, shown, traced
from .._types import Given, Scalars
from .._xla import quickly, remembered
from ._tabled import tabled
from .contours import AbstractContour, AbstractTabulated, frenet, Frenet2, Table, unevenness
from .fitting import crossings
from .surfaces import AbstractChart, AbstractImplicit, AbstractSurface, Chart, Gauss3, lattice

_PLACES = 1024  # along a contour
TURNS = 9  # places at which a closed one is compared with itself a turn later
# An endless contour is looked at within this of the start [m]: about the length of a finger.
RANGE = 0.1
# Nearest look about a start [m]; it also keeps the sizes by which errors are divided from being zero.
NEAREST = 1e-6
_SPREAD = 48  # places on a surface
# Places to a cell at which a closed contour is looked at for crossings. Where the coarse polygon crosses
# itself, the fine one decides, whose chords are 64 times as near to the curve.
_PARTS = (1, 8)
APART = 1e-6  # how far a frame's point may be from the curve's, relative to its largest coordinate
# Relative errors allowed in double and in single precision: of first derivatives, and of second ones.
ALLOWED = {np.dtype(np.float64): (1e-9, 1e-6), np.dtype(np.float32): (1e-4, 1e-2)}
# The same for surfaces, where every error has this bound.
SURFACE = {np.dtype(np.float64): 1e-6, np.dtype(np.float32): 1e-2}


def check_contour(name: str, contour: AbstractContour, *, start: Given | None = None) -> None:
    """Raise unless a caller's own contour advances by its arclength and has the frame of its curve.

    Args:
        name: Of the argument, for the message.
        contour: One of the package passes unseen, unless there is a caller's in it.
        start: Arclength [m] at which a contact starts; an endless contour is looked at about there.

    Raises:
        ValueError: If speed, frame, ends or closedness are not those of a contour given by arclength.
    """
    kind = next((type(c).__name__ for c in members(contour) if is_foreign(c)), None)
    if kind is None or traced(contour):
        return
    fault = _fault(contour)
    if fault is None and not traced(start) and start is not None:
        fault = _about(contour, start)
    if fault is not None:
        verb = "be" if start is None else "lie on"
        raise ValueError(f"argument {name} must {verb} a contour {fault.format(kind=kind)}")


def check_surface(name: str, surface: AbstractSurface) -> None:
    """Raise unless a caller's own surface has a unit normal, and its derivative as shape operator.

    Args:
        name: Of the argument, for the message.
        surface: One of the package passes unseen, unless there is a caller's surface or contour in it.

    Raises:
        ValueError: If point, rates, normal or shape operator do not belong together.
    """
    for part in members(surface):
        if isinstance(part, AbstractContour):
            check_contour(name, part)
            continue
        given = is_foreign(part) or (isinstance(part, Chart) and any(part.periodic))
        fault = _surface_fault(part) if given and not traced(part) else None
        if fault is not None:
            kind = type(part).__name__
            raise ValueError(f"argument {name} must be a surface {fault.format(kind=kind)}")


def check_shape(name: str, shape: Any) -> None:
    """`check_contour` or `check_surface`, whichever it is."""
    if isinstance(shape, AbstractContour):
        check_contour(name, shape)
    elif isinstance(shape, AbstractSurface):
        check_surface(name, shape)


def check_once_round(name: str, shape: Any) -> None:
    """Raise where a closed contour crosses itself, or runs round its body more than once.

    For what asks of a contour which side of it is inside. Circles and ellipses need no look; numbers that
    JAX traces are let pass.

    Args:
        name: Of the argument, for the message.
        shape: A contour, or whatever holds some; one of a caller's own class has passed `check_contour`.

    Raises:
        ValueError: If there is such a contour, or its cells do not resolve it.
    """
    for part in members(shape):
        given = is_foreign(part) or isinstance(part, AbstractTabulated)
        if given and isinstance(part, AbstractContour) and part.closed and not traced(part):
            fault = _doubled(part)
            if fault is not None:
                raise ValueError(
                    f"argument {name} must be a contour that runs once round its body without crossing "
                    f"itself, but {fault}"
                )


def unchecked(shapes: Any) -> bool:
    """Whether a shape of a caller's own has numbers that JAX traces: `_traced_contract` looks at these."""
    return any(is_foreign(part) and traced(part) for part in members(shapes))


def members(value: Any) -> Iterator[Any]:
    """A contour or surface, and those inside it; not those inside a caller's own, which is checked whole."""
    if isinstance(value, AbstractContour | AbstractSurface):
        yield value
        if is_foreign(value):
            return
    for part in _parts(value):
        yield from members(part)


def _parts(value: Any) -> list[Any]:
    if isinstance(value, tuple | list):
        return list(value)
    if not isinstance(value, AbstractContour | AbstractSurface):
        return []
    return [getattr(value, field, None) for field in getattr(value, "__dataclass_fields__", {})]


def tables(value: Any) -> Iterator[Table]:
    """Tables that a contour reads, at any depth. Their speed is one only up to the table's error."""
    if isinstance(value, AbstractTabulated | Table):
        yield value if isinstance(value, Table) else value.read()
        return
    held = value if isinstance(value, tuple | list) else ()
    for part in vars(value).values() if isinstance(value, eqx.Module) else held:
        yield from tables(part)


@remembered
def _fault(contour: AbstractContour) -> str | None:
    """What is wrong with a contour along its domain, as the end of a message, or None.

    An endless contour is not evaluated here, but about a contact's start (`_about`).
    """
    if (fault := _members_fault(contour)) is not None:
        return fault
    with computed_at_once():
        ready = _ready(tabled(contour))
        domain = ready.domain()
        if domain is None:
            return "with ends, as {kind} claims to be closed" if contour.closed else None
        ends = np.asarray([np.asarray(end, float) for end in domain])
        if not (ends.shape == (2,) and np.all(np.isfinite(ends)) and ends[0] < ends[1]):
            return f"whose domain rises, but that of {{kind}} was {shown(ends)}"
        # Middles of equal parts, so that no end is evaluated.
        share = (np.arange(_PLACES) + 0.5) / _PLACES
        fault = _along(ready, ends[0] + (ends[1] - ends[0]) * share)
        return fault or (_open(ready, ends) if contour.closed else None)


def _members_fault(contour: AbstractContour) -> str | None:
    """Which member of a contour's class gives what it must not, as the end of a message, or None."""
    if not isinstance(contour.closed, bool | np.bool_):
        return f"whose `closed` is True or False, but that of {{kind}} was a {type(contour.closed).__name__}"
    try:
        as_order(contour.smoothness)
    except ValueError:
        kind = type(contour.smoothness).__name__
        return f"whose `smoothness` is a number of derivatives, but that of {{kind}} was a {kind}"
    try:
        found = eqx.filter_eval_shape(contour.curve, jax.ShapeDtypeStruct((), jnp.result_type(float)))
    except NO_VALUES as error:
        return (
            "whose `curve` computes with jax.numpy, but that of {kind} asked for a value while JAX traces it "
            f"({type(error).__name__})"
        )
    if not isinstance(found, Vec2):
        array = isinstance(found, jax.ShapeDtypeStruct)
        was = f"an array of shape {found.shape}" if array else f"a {type(found).__name__}"
        return f"whose `curve` returns a geometry.Vec2, but that of {{kind}} returned {was}"
    if shapes := [jnp.shape(part) for part in (found.x, found.y) if jnp.shape(part)]:
        return f"whose `curve` returns two numbers, but one of {{kind}} had shape {shapes[0]}"
    return None


def _about(contour: AbstractContour, start: Given) -> str | None:
    """What is wrong with a contour at a contact's start, and near it if it has no ends.

    Nothing is, where the start lies beyond an end: there the contour need not be defined.
    """
    with computed_at_once():
        here, ends = float(np.asarray(start)), contour.domain()
        if ends is not None:
            if not (contour.closed or ends[0] <= here <= ends[1]):
                return None
            return _along(_ready(tabled(contour)), np.full(_PLACES, here), there=True)
        # From `NEAREST` to `RANGE` on either side. The start comes first, as `_along` wants it, and twice,
        # which makes the number of places the same as in all other calls.
        steps = np.geomspace(NEAREST, RANGE, _PLACES // 2 - 1)
        places = np.concatenate([[here, here], here + steps, here - steps])
        return _along(_ready(tabled(contour)), places, there=True)


def _along(contour: AbstractContour, places: np.ndarray, *, there: bool = False) -> str | None:
    """The first thing that is wrong at these places, or None; "{kind}" in it stands for the class's name.

    With `there`, the first place is a contact's start: an error at it comes before larger ones elsewhere.
    """
    found = [np.asarray(x) for x in measured_along(contour, jnp.asarray(places))]
    point, tangent, own, place, rate, curvature = found
    # What is read from a table may be off by the table's own error.
    slack = 4.0 * max((unevenness(table) for table in tables(contour)), default=0.0)
    first, second = (allowed + slack for allowed in ALLOWED[point.dtype])

    def at(errors: np.ndarray, allowed: float) -> tuple[int, str]:
        i = 0 if there and not errors[0] <= allowed else int(np.argmax(errors))
        return i, "there" if there and i == 0 else f"at s = {places[i]:.4g} m"

    finite = np.all([np.isfinite(x).reshape(len(places), -1).all(axis=1) for x in found], axis=0)
    if not finite.all():
        return (
            f"with finite points and derivatives, but those of {{kind}} {at(1.0 - finite, 0.5)[1]} were not"
        )
    apart = np.abs(point - place).max(axis=1) / (np.abs(place).max(axis=1) + NEAREST)
    if apart.max() > APART:
        i, where = at(apart, APART)
        return (
            f"whose frame is that of its curve, but the point of {{kind}} {where} was "
            f"{shown(point[i])} where the curve's is {shown(place[i])}"
        )
    speed = np.hypot(*rate.T)
    if (off := np.abs(speed - 1.0)).max() > first:
        i, where = at(off, first)
        return f"given by arclength (unit speed), but the speed of {{kind}} {where} was {speed[i]:.7g}"
    if (off := np.abs(tangent - rate).max(axis=1)).max() > 10.0 * first:
        i, where = at(off, 10.0 * first)
        return (
            f"whose frame is that of its curve, but the tangent of {{kind}} {where} was "
            f"{shown(tangent[i])} where the curve's is {shown(rate[i])}"
        )
    # Errors of curvature are relative to the largest one, or to one over the extent of the places.
    scale = max(np.abs(curvature).max(), np.abs(own).max(), 1.0 / max(np.ptp(places), NEAREST))
    if (off := np.abs(own - curvature) / scale).max() > 10.0 * second:
        i, where = at(off, 10.0 * second)
        return (
            f"whose frame is that of its curve, but the curvature of {{kind}} {where} was {own[i]:.6g} 1/m "
            f"where the curve's is {curvature[i]:.6g} 1/m"
        )
    return None


def _open(contour: AbstractContour, ends: np.ndarray) -> str | None:
    """How a contour that claims to be closed fails to come back to itself, or None.

    Frames at a few places are compared with those one length later and earlier.
    """
    # Multiples of the golden ratio spread the places over the length without favouring its fractions.
    length = float(ends[1] - ends[0])
    places = ends[0] + length * ((np.arange(TURNS) * 0.6180339887498949) % 1.0)
    here, later, before = (
        np.asarray(frames_at(contour, jnp.asarray(places + k * length))) for k in (0.0, 1.0, -1.0)
    )
    first, second = ALLOWED[here.dtype]
    # Rows are x, y [m], the tangent, and the curvature, which has the wider tolerance of second derivatives.
    size = np.abs(here[:2]).max() + length
    allowed = np.array([size, size, 1.0, 1.0, 10.0 * second / first * (np.abs(here[4]).max() + 1.0 / length)])
    off = np.maximum(np.abs(later - here), np.abs(before - here)) > 100.0 * first * allowed[:, None]
    if not off.any():
        return None
    worst = int(np.argmax(off.any(axis=0)))
    return (
        f"that comes back to itself where it claims to be closed, but the point of {{kind}} at "
        f"s = {places[worst]:.4g} m was {shown(here[:2, worst])}, and {shown(later[:2, worst])} a length of "
        f"{length:.6g} m later"
    )


@remembered
def _doubled(contour: AbstractContour) -> str | None:
    """How a closed contour fails to run once round its body, as the end of a message, or None.

    If it does not cross itself, its tangent turns round once (Hopf); the converse does not hold.
    """
    kind, fault = type(contour).__name__, None
    for parts in _PARTS:
        points = _polygon(contour, parts)
        sides = np.roll(points, -1, axis=0) - points
        ways = sides[:, 0] + 1j * sides[:, 1]
        turns = round(float(np.angle(np.roll(ways, -1) * np.conj(ways)).sum()) / (2.0 * np.pi))
        if abs(turns) != 1:
            fault = f"the tangent of this {kind} turned round {turns} times"
        elif len(pairs := crossings(points, closed=True)):
            fault = f"this {kind} did near {shown(points[pairs[0]].mean(axis=0).round(9))} m"
        else:
            return None
    return fault


def _polygon(contour: AbstractContour, parts: int) -> np.ndarray:
    """Points of a closed contour in order, so many to a cell of its table or to one of `_PLACES` parts."""
    share = (np.arange(parts) + 0.5) / parts
    with computed_at_once():
        ready = tabled(contour)
        if isinstance(ready, AbstractTabulated):
            # In NumPy, by the polynomials of the cells: there is nothing to compile.
            rows = np.asarray(ready.read().coefficients, float)
            powers = share ** np.arange(6)[:, None]
            return np.stack([(rows[:, k : k + 6] @ powers).ravel() for k in (0, 6)], axis=-1)
        ends = ready.domain()
        assert ends is not None  # `check_contour` has looked
        low, high = (float(np.asarray(end)) for end in ends)
        places = low + (high - low) / _PLACES * (np.arange(_PLACES) + share[:, None])
        # As many places at a time as `_along` takes, whose program this is.
        found = [np.asarray(measured_along(_ready(ready), jnp.asarray(row))[0], float) for row in places]
        return np.stack(found, axis=1).reshape(-1, 2)


@remembered
def _ready(contour: AbstractContour) -> AbstractContour:
    return _prepared(contour)


@quickly
def _prepared(contour: AbstractContour) -> AbstractContour:
    return contour.prepared()


@quickly
def measured_along(contour: AbstractContour, places: Array) -> tuple[Array, ...]:
    """Points, tangents and curvatures: of the frame, and of the curve, whose tangent is its derivative."""

    def one(s: Array) -> tuple[Array, ...]:
        frame, curve = _frame(contour, s), frenet(contour.curve, s)
        own = frame.point.array(), frame.tangent.array(), jnp.asarray(frame.curvature, s.dtype)
        return *own, curve.point.array(), curve.tangent.array(), curve.curvature

    return jax.vmap(one)(places)


@quickly
def frames_at(contour: AbstractContour, places: Array) -> Array:
    """Points, tangents and curvatures, shape (5, n)."""

    def one(s: Array) -> Array:
        frame = _frame(contour, s)
        parts = (*frame.point, *frame.tangent, frame.curvature)
        return jnp.stack([jnp.asarray(x, s.dtype) for x in parts])

    return jax.vmap(one)(places).T


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


@remembered
def _surface_fault(surface: AbstractSurface) -> str | None:
    """What is wrong with a surface at places all over it, as the end of a message, or None.

    Places that are not on the surface after all, or where an error is not finite (a pole of a chart), are
    left out, unless none remain.
    """
    with computed_at_once():
        off = {name: np.asarray(value) for name, value in inconsistency(surface).items()}
    # Each entry of `off` has its message for a name, and errors at all places for its value.
    allowed = SURFACE[off["there"].dtype]
    seam = float(off.pop("seam"))
    if not seam <= 10.0 * allowed:
        return (
            "that comes back to itself where it claims to be periodic, but the ends of {kind}'s period are "
            f"{seam:.3g} of its size apart"
        )
    finite = np.all([np.isfinite(x) for x in off.values()], axis=0) & (off.pop("there") > 0)
    if not finite.any():
        return "with finite points, normals and derivatives, but {kind} had none"
    for what, values in off.items():
        worst = float(values[finite].max())
        if worst > allowed:
            return f"whose {what}, but that of {{kind}} was {worst:.3g} off, relative to its size"
    return None


@quickly
def inconsistency(surface: AbstractSurface) -> dict[str, Array]:
    """Relative errors of what must belong together, at places all over a surface."""
    ready = surface.prepared()
    at = _all_over(ready)
    found = jax.vmap(lambda *one: _errors(ready, one))(*at)
    seam = _seam(ready, at) if isinstance(ready, AbstractChart) else jnp.zeros(())
    return {**found, "seam": seam}


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
