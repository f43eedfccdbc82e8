r"""What the equations of motion take for granted of a contour or surface, checked for a caller's own classes.

Of a contour: speed $|c'| = 1$, a frame (8)-(10) that is the curve's, and ends that meet where it claims to be
closed. Of a surface: a unit normal, its derivative as shape operator, and coordinates that move as `rate`
says. `_contract_errors` measures how far a shape is off.

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

from .._linalg import Vec2
from .._results import as_order, computed_at_once, is_foreign, NO_VALUES, shown, traced
from .._types import Given
from .._xla import quickly, remembered
from ._contract_errors import contour_a_turn_later, contour_along, NEAREST, ON_SURFACE, RANGE, surface_off
from ._tabled import tabled
from .contours import AbstractContour, AbstractTabulated
from .fitting import crossings
from .surfaces import AbstractSurface, Chart

_PLACES = 1024  # along a contour
# Places to a cell at which a closed contour is looked at for crossings. Where the coarse polygon crosses
# itself, the fine one decides, whose chords are 64 times as near to the curve.
_PARTS = (1, 8)


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
    found = jax.tree.map(np.asarray, contour_along(contour, jnp.asarray(places)))
    parts = [np.isfinite(x).reshape(len(places), -1).all(axis=1) for x in found[:-1]]
    finite = np.where(np.all(parts, axis=0), 0.0, np.inf)

    def worst(errors: np.ndarray) -> tuple[int, str]:
        i = 0 if there and not errors[0] <= 1.0 else int(np.argmax(errors))
        return i, "there" if there and i == 0 else f"at s = {places[i]:.4g} m"

    if finite.any():
        return f"with finite points and derivatives, but those of {{kind}} {worst(finite)[1]} were not"
    off = found.off
    if off["speed"].max() > 1.0 and off["point"].max() <= 1.0:
        i, where = worst(off["speed"])
        speed = np.hypot(*found.rate[i])
        return f"given by arclength (unit speed), but the speed of {{kind}} {where} was {speed:.7g}"
    pairs = {
        "point": (found.point, found.place),
        "tangent": (found.tangent, found.rate),
        "curvature": (found.curvature, found.bend),
    }
    for name, (own, curve) in pairs.items():
        if off[name].max() > 1.0:
            i, where = worst(off[name])
            own, curve = (f"{x[i]:.6g} 1/m" if x.ndim == 1 else shown(x[i]) for x in (own, curve))
            return (
                f"whose frame is that of its curve, but the {name} of {{kind}} {where} was "
                f"{own} where the curve's is {curve}"
            )
    return None


def _open(contour: AbstractContour, ends: np.ndarray) -> str | None:
    """How a contour that claims to be closed fails to come back to itself, or None."""
    low, length = jnp.asarray(ends[0]), jnp.asarray(ends[1] - ends[0])
    found = jax.tree.map(np.asarray, contour_a_turn_later(contour, low, length))
    wrong = ~(found.off <= 1.0)
    if not wrong.any():
        return None
    i = int(np.argmax(wrong))
    return (
        f"that comes back to itself where it claims to be closed, but the point of {{kind}} at "
        f"s = {found.places[i]:.4g} m was {shown(found.here[i])}, and {shown(found.later[i])} a length of "
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
        found = [np.asarray(contour_along(_ready(ready), jnp.asarray(row)).point, float) for row in places]
        return np.stack(found, axis=1).reshape(-1, 2)


@remembered
def _ready(contour: AbstractContour) -> AbstractContour:
    return _prepared(contour)


@quickly
def _prepared(contour: AbstractContour) -> AbstractContour:
    return contour.prepared()


@remembered
def _surface_fault(surface: AbstractSurface) -> str | None:
    """What is wrong with a surface at places all over it, as the end of a message, or None."""
    with computed_at_once():
        found = {name: np.asarray(value) for name, value in surface_off(surface).items()}
    seam, unseen = found.pop("seam"), found.pop("unseen")
    allowed = ON_SURFACE.of(seam)
    if not seam <= 1.0:
        return (
            "that comes back to itself where it claims to be periodic, but the ends of {kind}'s period are "
            f"{10.0 * allowed * seam:.3g} of its size apart"
        )
    if unseen:
        return "with finite points, normals and derivatives, but {kind} had none"
    # The name of an error is the middle of its message.
    for what, off in found.items():
        if off > 1.0:
            return f"whose {what}, but that of {{kind}} was {off * allowed:.3g} off, relative to its size"
    return None
