"""Part 3 of the chapter: a pinch in space (Figs. 19 and 20).

Fingertips are balls and the object a cuboid, unless others are given. As in the plane, the joints of a guess
are given by hand, and `close` moves everything from there until the contacts are closed.
"""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._closing import close
from .._mechanics import Finger3, FreeObject3, Grasp, State
from .._results import as_length, as_positive, check_instance, concrete
from .._types import Given
from .._xla import at_once
from ..contact import Contact3
from ..control import Opposition
from ..geometry import AbstractSurface, Plane, Sphere
from ._scene_arguments import as_pair

# The chapter gives no numbers: the links of Table 1 on a short first one that swings out of the plane.
AXES3 = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0))  # of the three joints
LINKS3 = ((0.0, 0.010, 0.0), (0.0, 0.065, 0.0), (0.0, 0.065, 0.0))  # from joint to joint [m]
MASSES3 = (0.015, 0.045, 0.040)  # [kg]
SPAN3 = 0.0275  # half the distance of the bases [m]
_CENTRE = (0.0, 0.115, 0.0)  # of the object in the guess [m]
# Joint angles [rad] that bring the left tip to about (-0.025, 0.113, 0.004) m. Their negatives bring the
# right one to (0.025, 0.113, -0.004) m.
_JOINTS = (0.035, 0.63, -1.31)


def cuboid(width: Given = 0.03, height: Given = 0.05, depth: Given = 0.05, mass: Given = 0.02) -> FreeObject3:
    """A uniform cuboid with its left and its right face (towards -x and +x) as surfaces 0 and 1.

    Args:
        width: Distance of the faces, along x [m].
        height: Along y [m].
        depth: Along z [m].
        mass: In kilograms.

    Returns:
        The object.

    Raises:
        ValueError: If a number is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> len(jxr.scenes.cuboid().surfaces)
        2
    """
    given = {"width": width, "height": height, "depth": depth}
    mass = as_positive("mass", mass)
    edges, inertia, half = _cuboid([as_length(*item) for item in given.items()], mass)
    # A plane's normal is its z axis: quarter turns about -y and +y take it to -x and +x.
    turn = np.sqrt(0.5)
    left = Plane().moved(half[0], (turn, 0.0, -turn, 0.0))
    right = Plane().moved(half[1], (turn, 0.0, turn, 0.0))
    return FreeObject3((left, right), mass, inertia, outline=edges)


@at_once
def _cuboid(xp: Any, lengths: list[Array], mass: Array) -> tuple[Array, Array, tuple[Array, Array]]:
    """Edges of a cuboid, its principal moments, and the centres of its faces along x."""
    edges = xp.stack(lengths)
    squares, right = edges**2, edges * xp.array([0.5, 0.0, 0.0], edges.dtype)
    return edges, mass * (squares.sum() - squares) / 12.0, (-right, right)


def pinch3d(
    *,
    tips: AbstractSurface | tuple[AbstractSurface, AbstractSurface] | None = None,
    object: FreeObject3 | None = None,
    size: Given = 1.0,
    beta: Given = 20.0,
    damping: Given = 0.006,
    spin: Literal["free", "prevented"] = "free",
    friction: Given | None = None,
    gravity: Given | None = None,
) -> tuple[Grasp, State]:
    r"""Part 3: two three-joint fingers pinch a free object in space (Fig. 19).

    The fingers stand at $(\mp 27.5, 0, 0)$ mm and point along y; their first joint swings them out of the
    plane, the others bend them. The tips start about 8 mm apart along z, so that the object turns about y.
    The control is that of (16) without its last term, "blind": $u_i = -c \dot q_i - \beta J_i^T (r_i - r_j)$.
    The chapter gives no numbers for Part 3; lengths and masses are those of Table 1.

    A scene of size k has k times these lengths and $k^3$ times the masses, and its gains are
    $k^2 \beta$ and $k^{9/2} c$. In the same gravity it then moves alike: at the time $\sqrt k\,t$ every
    length is k times, and every force $k^3$ times what it is at t with size one (Froude's law).

    Args:
        tips: Surface of both fingertips or one for each, about $O_i$. Default: spheres of 10 mm, times k.
        object: With two surfaces, its left and its right face, or with one all round it. Default:
            `cuboid()`, times k.
        size: k. Tips and an object that are given are taken as they are, and must fit that size.
        beta: $\beta$ [N/m], of size one; a function of time is taken as it is.
        damping: $c$ [N m s], one or two, likewise.
        spin: Whether the contacts let the bodies turn against each other about the normal.
        friction: Coefficient of friction of both contacts; then a run that needs more of it ends.
        gravity: Shape (3,) [m/s^2], or (3, 3): a row each for the object and the fingers, of zeros for
            fingers whose own weight is compensated. Default: none. This control does not hold a weight up;
            `control.Carry` does.

    Returns:
        The grasp, and a state at rest with both contacts closed.

    Raises:
        ValueError: If an argument does not fit, or the fingers cannot close both contacts.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pinch3d()
        >>> grasp.sizes  # object, two fingers
        (6, 3, 3)
    """
    k = as_positive("size", size)
    sizes = _sizes(k)
    own, shapes = object, Sphere(sizes.tip) if tips is None else tips
    if own is None:
        own = cuboid(*sizes.cuboid)
    body = check_instance("object", own, FreeObject3, "a FreeObject3")
    pair = as_pair("tips", shapes, AbstractSurface, "a surface or a pair of them")
    fingers = [
        Finger3(AXES3, sizes.links, sizes.masses, tip, base=base)
        for tip, base in zip(pair, sizes.bases, strict=True)
    ]
    # Two surfaces: a finger on each; a single one that goes all round is touched by both.
    faces = range(2) if len(body.surfaces) > 1 else (0, 0)
    contacts = [Contact3(i, face, spin=spin, friction=friction) for i, face in enumerate(faces)]
    # Without alpha the values of `start` have no effect; its length says how many fingers there are.
    control = Opposition(beta, damping, start=np.zeros(2))
    guess = _guess(pair, [body.surfaces[face] for face in faces], sizes)
    if tips is object is None and concrete(k) != 1.0:
        # The pose of size one itself: another, as near to its own guess, would not be similar to it.
        _, one = pinch3d()
        lengths = jnp.ones(13).at[:3].set(k)
        guess = State(one.q * lengths, one.v, one.s * k)
    grasp, state = close(Grasp(body, fingers, contacts, gravity=gravity), guess, hold_contacts=False)
    gains = lambda c: [c.beta, c.damping]  # noqa: E731
    scaled = [
        gain if callable(gain) else gain * factor
        for gain, factor in zip(gains(control), sizes.gains, strict=True)
    ]
    control = eqx.tree_at(gains, control, scaled)
    return Grasp(body, fingers, contacts, controller=control, gravity=gravity), state


class _Sizes(NamedTuple):
    """What goes with the size k of a pinch: lengths [m] with k, masses [kg] with its third power.

    Attributes:
        tip: Radius of the fingertips.
        cuboid: Edges and mass of the object.
        links: From joint to joint, shape (3, 3).
        masses: Of the links.
        bases: Of both fingers.
        near_tips: Points in the fingertips' own axes, roughly where they face the object.
        near_faces: The same in the object's axes.
        positions: Of the guess: the object's position and quaternion, then both fingers' joints.
        gains: Factors of beta and of damping.
    """

    tip: Array
    cuboid: tuple[Array, Array, Array, Array]
    links: Array
    masses: Array
    bases: list[Array]
    near_tips: list[Array]
    near_faces: list[Array]
    positions: Array
    gains: tuple[Array, Array]


@at_once
def _sizes(xp: Any, k: Array) -> _Sizes:
    sides, joints = (-1.0, 1.0), np.array(_JOINTS)
    return _Sizes(
        tip=0.01 * k,
        cuboid=(0.03 * k, 0.05 * k, 0.05 * k, 0.02 * k**3),
        links=k * np.array(LINKS3),
        masses=k**3 * np.array(MASSES3),
        bases=[k * np.array([side * SPAN3, 0.0, 0.0]) for side in sides],
        near_tips=[k * np.array([-0.02 * side, 0.0, 0.0]) for side in sides],
        near_faces=[k * np.array([0.025 * side, -0.002, -0.004 * side]) for side in sides],
        positions=xp.concatenate([k * np.array(_CENTRE), np.array((1.0, 0.0, 0.0, 0.0)), joints, -joints]),
        gains=(k**2, k**4.5),
    )


def _guess(tips: tuple[AbstractSurface, ...], faces: list[AbstractSurface], sizes: _Sizes) -> State:
    """Tips on both sides of the object, about 8 mm apart along z, times the size."""
    places = []
    for tip, face, on_tip, on_face in zip(tips, faces, sizes.near_tips, sizes.near_faces, strict=True):
        places += [tip.near(on_tip), face.near(on_face)]
    return State(sizes.positions, np.zeros(12), _joined(places))


@at_once
def _joined(xp: Any, vectors: list[Array]) -> Array:
    return xp.concatenate(vectors)
