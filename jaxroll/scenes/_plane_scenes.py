"""Scenes of the plane: Parts 1 and 2 of the chapter, a ring of fingers, a roller between plates.

Each scene builds shapes, bodies and contacts, makes a rough guess of the state and lets `close` find the
nearest one at which all contacts are closed. `pinch` and `ring` then start their controller from there, since
(17) refers to the fingers' orientations at the start.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._closing import close
from .._mechanics import Finger, FreeObject, Grasp, Jaw, PivotedObject, State
from .._results import as_count, as_floats, as_length, as_positive, check_instance
from .._types import Given
from .._xla import at_once
from ..contact import Contact
from ..control import Opposition, orientations, Press
from ..geometry import AbstractContour, Catenary, Circle, Ellipse, Line, Moved
from ._facing_place import facing_place
from ._scene_arguments import as_pair

# `sense` of the contacts of a pinch, on the left face and on the right one.
_SENSES = (1, -1)
# Tables 1 and 2, in SI units.
LENGTHS = (0.065, 0.065)
MASSES = (0.045, 0.040)
INERTIA = 6.6178e-6
FORCE, RADIUS, DAMPING = 0.500, 0.010, 0.006
# (80)-(83): vertex of the object's contour at s = 3.363 mm, of the fingertip's at s = 0.
OBJECT_SHIFT = 3.363e-3
# Part 1 has no numbers of its own: sizes of Table 1, the third link as light as its shape asks.
LINKS = ((0.065, 0.039, 0.026), (0.065, 0.065))
LINK_MASSES = ((0.045, 0.025, 0.015), (0.045, 0.040))
BASES = ((0.0, 0.0), (0.055, 0.0))
# So many fingers of a ring XLA compiles within minutes.
_MOST_FINGERS = 60
# Guess of a pinch: pose of the object [m, m, rad], joints of the left finger and of the right [rad].
_POSE = (0.0275, 0.115, 0.0, 2.2, -0.9, 0.3, 0.95, 0.85)


def pivoted(
    *,
    s: Given = 0.003,
    base: Given = (0.0, 0.0),
    pivot: Given = (0.03, 0.105),
    gravity: Given | None = None,
) -> tuple[Grasp, State]:
    r"""Part 2: a two-joint finger rolls on an object pivoted at a fixed point (Figs. 4-18).

    Masses, lengths, inertia and gains are those of Tables 1 and 2; the contours are (80)-(83) with their
    misprints repaired, which makes both catenaries. Links are uniform slender rods. Angles are
    counter-clockwise; the chapter's Part 2 counts them clockwise, and a mirror $y \to -y$ maps one to the
    other with the same numbers. The pad of the fingertip faces to the right of the last link: (58)-(59) fix
    how the fingertip's frame turns with $q_1 + q_2$, but not the direction from which that angle counts;
    here, as usual, the link lies along the x axis where it is zero. The chapter states neither base, pivot
    nor starting contact; the defaults are chosen here.

    Args:
        s: Chapter's arclength at the starting contact [m]. By default the object turns by
            0.77 rad on its way to equilibrium, near s = -4.79 mm.
        base: Shape (2,), position of the first joint [m].
        pivot: Shape (2,), position of the object's pivot $O_m$ [m].
        gravity: Shape (2,) [m/s^2]; the chapter's plane is horizontal, so there is none by default.

    Returns:
        The grasp, and a state at rest with the contact closed.

    Raises:
        ValueError: If an argument does not fit, or the finger cannot reach that contact.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> state.q.shape
        (3,)
    """
    # (80)-(83): catenaries of parameter 1/(2 * 20) m and 1/(2 * 50) m with vertices at X_0 = 0.035 - 1/40 =
    # 0.01 m and X = -0.03 + 1/100 = -0.02 m. The fingertip faces +x, the object -x in its own axes.
    reach = (-0.03, 0.03)
    tip = Catenary(1.0 / 40.0, reach).moved((0.01, 0.0))
    face = Catenary(1.0 / 100.0, reach).moved((-0.02, 0.0), np.pi, origin=OBJECT_SHIFT)
    s = as_floats("s", s, ())
    grasp = Grasp(
        PivotedObject(face, INERTIA, pivot=pivot),
        Finger(LENGTHS, MASSES, Moved(tip, (0.0, 0.0), -np.pi / 2), base=base),
        Contact(s_tip=-s, s_object=s),
        controller=Press(FORCE, RADIUS, DAMPING, target=pivot),
        gravity=gravity,
    )
    guess = State(np.array([-0.5, 1.9, -0.7]), np.zeros(3), np.zeros(1))
    return close(grasp, guess)


def rectangle(width: Given = 0.03, height: Given = 0.05, mass: Given = 0.02) -> FreeObject:
    """A uniform rectangular object with its left and its right face as contours 0 and 1 (Fig. 3).

    Args:
        width: Distance of the faces, $l_w$ [m].
        height: Length of the faces [m].
        mass: In kilograms.

    Returns:
        The object.

    Raises:
        ValueError: If a number is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> len(jxr.scenes.rectangle().contours)
        2
    """
    width, height, mass = as_length("width", width), as_length("height", height), as_positive("mass", mass)
    along, across, inertia = _rectangle(width, height, mass)
    face = Line(along)
    return FreeObject((face.moved(across[0], np.pi), face.moved(across[1])), mass, inertia)


@at_once
def _starts(xp: Any, s: Array, middles: tuple[Any, Any]) -> list[tuple[Array, Array]]:
    """Arclengths of the starting contacts of a pinch on fingertip and object, from the chapter's $s_i$."""
    del xp
    along = [sense * s[i] for i, sense in enumerate(_SENSES)]
    return [(-a, middle + a) for a, middle in zip(along, middles, strict=True)]


@at_once
def _rectangle(xp: Any, width: Array, height: Array, mass: Array) -> tuple[Array, tuple[Array, Array], Array]:
    """Ends of a rectangle's faces along them, the middles of both faces, and its moment of inertia."""
    sides = xp.array([-0.5, 0.5], width.dtype)
    middles = xp.stack([sides * width, xp.zeros_like(sides)], axis=-1)
    return sides * height, (middles[0], middles[1]), mass * (width**2 + height**2) / 12.0


def pinch(
    *,
    s: Given = (0.004, -0.003),
    tips: AbstractContour | tuple[AbstractContour, AbstractContour] | None = None,
    object: FreeObject | None = None,
    beta: Given = 20.0,
    alpha: Given = 1e-3,
    damping: Given = 0.006,
    friction: Given | None = None,
    gravity: Given | None = None,
) -> tuple[Grasp, State]:
    r"""Part 1: a three-joint and a two-joint finger pinch a free object (Figs. 1 and 3).

    The control is (16)-(17), "blind": it knows the fingers' joints alone. The chapter gives no numbers
    for this scene; sizes are those of Table 1.

    Args:
        s: Shape (2,), the chapter's $s_i$ at the starting contacts [m]: distance from the middle of
            either face, both in the direction of $b_{01}$ (down); the fingertips touch at the same $s_i$.
        tips: Contour of both fingertips or one for each, about $O_i$, facing +x at its s = 0; the scene
            turns them to face each other. Default: the chapter's (82)-(83), which satisfies (41).
        object: With two contours: its left and its right face, each with s = 0 in the middle. With one
            closed contour: it is held where it faces left and right, and `s` counts from there, not from the
            contour's own zero as `stability.pinch_statics` does. Default: `rectangle()`.
        beta: $\beta$ of (16) [N/m].
        alpha: $\alpha_i$ of (16) [N m/rad], one or two. With 0 the grasp ends with $O_1, P_1, P_2, O_2$
            collinear.
        damping: $c_i$ of (16) [N m s], one or two.
        friction: Coefficient of friction of both contacts; then a run that needs more of it ends.
        gravity: Shape (2,) [m/s^2]; the plane is horizontal by default.

    Returns:
        The grasp, and a state at rest with both contacts closed.

    Raises:
        ValueError: If an argument does not fit, or the fingers cannot reach those contacts.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pinch()
        >>> grasp.sizes  # object, three-joint finger, two-joint finger
        (3, 3, 2)
    """
    body = rectangle() if object is None else _free(object)
    shapes = Catenary(1.0 / 40.0, (-0.03, 0.03)).moved((0.01, 0.0)) if tips is None else tips
    pair = as_pair("tips", shapes, AbstractContour, "a contour or a pair of them")
    # Each tip faces the other finger, at right angles to its last link: a quarter turn to either side.
    fingers = [
        Finger(lengths, masses, Moved(tip, (0.0, 0.0), side * np.pi / 2), base=base)
        for lengths, masses, tip, base, side in zip(LINKS, LINK_MASSES, pair, BASES, (-1, 1), strict=True)
    ]
    # The chapter's s_i runs along the object's contour on the left face and against it on the right one
    # (`sense`); on the fingertips, whose contours run the other way at the contact, it has the opposite sign.
    contacts = []
    for i, (on_tip, on_body) in enumerate(_starts(as_floats("s", s, (2,)), _middles(body))):
        face = i if len(body.contours) > 1 else 0
        sense = _SENSES[i]
        contacts.append(Contact(on_tip, on_body, finger=i, contour=face, sense=sense, friction=friction))
    guess = State(np.array(_POSE), np.zeros(8), np.zeros(2))
    control: dict[str, Any] = {"damping": damping, "alpha": alpha}
    return _opposed(body, fingers, contacts, guess, beta, control, gravity)


def ball_plate(
    radius: Given = 0.01,
    *,
    s: Given = (0.004, -0.003),
    object: FreeObject | None = None,
    beta: Given = 20.0,
    alpha: Given = 1e-3,
    damping: Given = 0.006,
    friction: Given | None = None,
    gravity: Given | None = None,
) -> tuple[Grasp, State]:
    r"""Part 1's simple case: hemispherical fingertips centred at O_i pinch a plate; neutral in (41).

    Args:
        radius: Of both fingertips [m].
        s: Shape (2,), the chapter's $s_i$ at the starting contacts [m], as for `pinch`.
        object: With two contours or with one, as for `pinch`. Default: `rectangle()`.
        beta: $\beta$ of (16) [N/m].
        alpha: $\alpha_i$ of (16) [N m/rad], one or two.
        damping: $c_i$ of (16) [N m s], one or two.
        friction: Coefficient of friction of both contacts; then a run that needs more of it ends.
        gravity: Shape (2,) [m/s^2]; the plane is horizontal by default.

    Returns:
        The grasp, and a state at rest with both contacts closed.

    Raises:
        ValueError: If an argument does not fit, or the fingers cannot reach the contacts.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.ball_plate()
        >>> float(grasp.fingers[0].tip.curvature(0.0))
        100.0
    """
    return pinch(
        s=s,
        tips=Circle(radius),
        object=object,
        beta=beta,
        alpha=alpha,
        damping=damping,
        friction=friction,
        gravity=gravity,
    )


def pinch_ellipse(
    a: Given = 0.015,
    b: Given = 0.025,
    mass: Given = 0.02,
    *,
    s: Given = (0.004, -0.003),
    tips: AbstractContour | tuple[AbstractContour, AbstractContour] | None = None,
    beta: Given = 20.0,
    alpha: Given = 1e-3,
    damping: Given = 0.006,
    friction: Given | None = None,
    gravity: Given | None = None,
) -> tuple[Grasp, State]:
    r"""Part 1 with an elliptic object, uniform, of half axes `a` (across) and `b` [m].

    Args:
        a: Half axis between the fingers [m].
        b: The other half axis [m].
        mass: In kilograms.
        s: Shape (2,), distance of the starting contacts along the contour [m] from where the ellipse faces
            left and from where it faces right, both downwards. `stability.pinch_statics` counts from the
            contour's own zero, which lies where it faces right: its $s_i$ are
            `contact_geometry(grasp, state).s`, on the left half a circumference more.
        tips: Contour of both fingertips or one for each, as for `pinch`. Default: the chapter's (82)-(83).
        beta: $\beta$ of (16) [N/m].
        alpha: $\alpha_i$ of (16) [N m/rad], one or two.
        damping: $c_i$ of (16) [N m s], one or two.
        friction: Coefficient of friction of both contacts; then a run that needs more of it ends.
        gravity: Shape (2,) [m/s^2]; the plane is horizontal by default.

    Returns:
        The grasp, and a state at rest with both contacts closed.

    Raises:
        ValueError: If an argument does not fit, or the fingers cannot reach the contacts.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pinch_ellipse(0.015, 0.02)
        >>> state.s.shape
        (2,)
    """
    a, b, mass = as_length("a", a), as_length("b", b), as_positive("mass", mass)
    body = FreeObject(Ellipse(a, b), mass, 0.25 * mass * (a**2 + b**2))
    return pinch(
        s=s,
        tips=tips,
        object=body,
        beta=beta,
        alpha=alpha,
        damping=damping,
        friction=friction,
        gravity=gravity,
    )


def ring(
    count: int = 3,
    *,
    object: FreeObject | None = None,
    tip: AbstractContour | None = None,
    beta: Given = 10.0,
    alpha: Given = 4e-3,
    damping: Given = 0.004,
    gravity: Given | None = None,
) -> tuple[Grasp, State]:
    r"""Two-joint fingers evenly round one free object, under control (16)-(17) for every pair.

    Args:
        count: How many fingers, 2 to 60. Scene and first run of 5 take twice as long to compile as those of
            2, of 20 seven times, and of 60 two minutes; derivatives and batches take several times as long.
        object: With one closed contour about its origin. Default: a disc of 20 mm radius, 50 g.
        tip: Closed contour of every fingertip about $O_i$. Default: a circle of 10 mm radius.
        beta: $\beta$ of (16) [N/m].
        alpha: $\alpha_i$ of (16) [N m/rad], one or one for each.
        damping: $c_i$ of (16) [N m s], one or one for each.
        gravity: Shape (2,) [m/s^2].

    Returns:
        The grasp, and a state at rest with every contact closed.

    Raises:
        ValueError: If `count` is out of range, or the fingers cannot reach the object.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.ring(3)
        >>> grasp.coordinates, state.s.shape[0]
        (9, 3)
    """
    count = as_count("count", count, least=2)
    if count > _MOST_FINGERS:
        raise ValueError(
            f"argument count must be at most {_MOST_FINGERS}, since more fingers take minutes to compile, "
            f"but was {count}"
        )
    body = FreeObject(Circle(0.02), mass=0.05, inertia=1e-5) if object is None else _free(object)
    shape = Circle(0.01) if tip is None else check_instance("tip", tip, AbstractContour, "a contour")
    fingers, contacts, guess = [], [], [np.zeros(3)]
    for i in range(count):
        angle = 2.0 * np.pi * i / count
        out = np.array([np.cos(angle), np.sin(angle)])
        # The finger stands outside the object; the base is moved aside, so that the arm is bent.
        rim = facing_place("object", body.contours[0], angle)
        inward = facing_place("tip", shape, np.pi)
        base = 0.1 * out + 0.02 * np.array([-out[1], out[0]])
        # The last link points at the object, so the side of the tip that its x axis meets touches.
        fingers.append(Finger((0.05, 0.05), (0.05, 0.04), shape.moved(angle=np.pi), base=base))
        contacts.append(Contact(inward, rim, finger=i))
        guess.append(np.array([angle + 2.4, 1.1]))
    start = State(jnp.asarray(np.concatenate(guess)), np.zeros(3 + 2 * count), jnp.zeros(count))
    control = {"damping": damping, "alpha": alpha}
    return _opposed(body, fingers, contacts, start, beta, control, gravity, hold_contacts=False)


def _opposed(
    body: FreeObject,
    fingers: list[Finger],
    contacts: list[Contact],
    guess: State,
    beta: Given,
    control: dict[str, Any],
    gravity: Given | None,
    *,
    hold_contacts: bool = True,
) -> tuple[Grasp, State]:
    """The grasp under the control (16)-(17), started from the nearest state with closed contacts.

    Two grasps are built: the controller needs the orientations of the closed state, and closing needs a
    grasp.
    """
    # Its numbers are looked at before the contacts are closed, which takes longer.
    opposition = Opposition(beta, **control, start=np.zeros(len(fingers)))
    grasp, state = close(Grasp(body, fingers, contacts, gravity=gravity), guess, hold_contacts=hold_contacts)
    opposition = eqx.tree_at(lambda law: law.start, opposition, orientations(grasp, state))
    return Grasp(body, fingers, contacts, controller=opposition, gravity=gravity), state


def _middles(body: FreeObject) -> tuple[Any, Any]:
    """Arclengths [m] of the middle of the left and of the right face.

    Two contours have s = 0 there; one closed contour is held where it reaches farthest to either side.
    """
    if len(body.contours) != 1:
        return 0.0, 0.0
    return facing_place("object", body.contours[0], np.pi), facing_place("object", body.contours[0], 0.0)


def _free(body: FreeObject) -> FreeObject:
    return check_instance("object", body, FreeObject, "a FreeObject")


class Conveyor(eqx.Module):
    r"""Forces on the upper plate of `roller`: press, and move by $u = \frac{h}{2}(1 - \cos 2\pi t/T)$."""

    force: Float[Array, ""]
    travel: Float[Array, ""]
    period: Float[Array, ""]
    inertia: Float[Array, ""]

    def __call__(self, t: Any, angles: Any, rates: Any, tips: Any) -> tuple[Array, Array]:
        """Force along and across the plate; the lower plate has no joint."""
        rate = 2.0 * np.pi / self.period
        push = self.inertia * 0.5 * self.travel * rate**2 * jnp.cos(rate * t)
        return jnp.stack([push, -self.force]), jnp.zeros(0)


def roller(
    contour: AbstractContour | None = None,
    *,
    force: Given = 5.0,
    travel: Given = 0.03,
    period: Given = 3.0,
    mass: Given = 0.02,
) -> tuple[Grasp, State]:
    r"""A roller between two plates; the upper one moves to and fro, and the roller by half as much.

    The test on which other engines creep: without slip a circular roller's centre travels exactly $u/2$.

    Args:
        contour: The roller's closed contour, round its body's origin. Default: a circle of 10 mm.
        force: Of the upper plate on the roller [N].
        travel: $h$, of the upper plate [m].
        period: $T$ [s]: there and back again.
        mass: Of the roller [kg], a uniform disc; the plate has ten times as much.

    Returns:
        The grasp, and a state at rest with both contacts closed. Coordinates: x, y and angle of the
        roller, then u and height of the plate.

    Raises:
        ValueError: If an argument does not fit, or the contour is not closed.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.roller()
        >>> grasp.sizes
        (3, 2, 0)
    """
    shape = (
        Circle(0.01) if contour is None else check_instance("contour", contour, AbstractContour, "a contour")
    )
    force, travel = as_floats("force", force, ()), as_floats("travel", travel, ())
    period, mass = as_positive("period", period), as_positive("mass", mass)
    top, bottom = facing_place("contour", shape, 0.5 * np.pi), facing_place("contour", shape, -0.5 * np.pi)
    height = shape.point(top)[1] - shape.point(bottom)[1]
    radius = 0.5 * height
    inertia = 0.5 * mass * radius**2
    above = jnp.stack([0.0 * height, height])
    plates = (
        Jaw(Line(), 10.0 * mass, (0.0, 0.5 * np.pi), base=above, angle=-0.5 * np.pi),
        Jaw(Line(), angle=0.5 * np.pi),
    )
    # The mass that the plate's drive accelerates: the plate, and the roller, which moves by u/2 and turns by
    # u/2r: twice their kinetic energy over the square of the plate's speed.
    moved = 10.0 * mass + 0.25 * mass + 0.25 * inertia / radius**2
    grasp = Grasp(
        FreeObject(shape, mass, inertia),
        plates,
        (Contact(0.0, top, finger=0), Contact(0.0, bottom, finger=1)),
        controller=Conveyor(force, travel, period, moved),
    )
    start = jnp.stack([0.0 * radius, -shape.point(bottom)[1], 0.0 * radius, 0.0 * radius, 0.0 * radius])
    # Parallel plates: with contacts held, both tangencies would ask the same of the one angle.
    return close(grasp, State(start, np.zeros(5), jnp.zeros(2)), hold_contacts=False)
