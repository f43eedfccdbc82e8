r"""A hand of several equal fingers that hangs above an object and holds it: three of them are a tripod.

Each finger is that of Part 3's pinch, turned to point down. The control moves the origins of the tips'
frames, and these lie where the tips touch at the start: without slip the object's points there move as the
tips' do, so that to first order the object follows the frame that is commanded. Of the balls' centres that
would not be so: an object of radius R between balls of radius r turns by $(R + r)/R$ of what their centres
turn about it.
"""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._closing import close
from .._mechanics import Finger3, FreeObject3, Grasp, State
from .._results import as_count, as_floats, as_positive, check_instance, shown
from .._types import Given
from ..contact import Contact3
from ..control import Carry
from ..geometry import AbstractSurface, Ellipsoid, Sphere

_AXES = (
    (1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0),
    (0.0, 1.0, 0.0),
)  # of the three joints; x points away from the object
_LINKS = ((0.0, 0.0, -0.010), (0.0, 0.0, -0.065), (0.0, 0.0, -0.065))  # from joint to joint [m]
_MASSES = (0.015, 0.045, 0.040)  # [kg]
_RADIUS = 0.05  # of the circle on which the fingers stand [m]
_REACH, _HEIGHT = 0.030, -0.115  # of the tips in the guess: from the axis, and above the palm [m]


def spheroid(radius: Given = 0.02, height: Given = 0.05, mass: Given = 0.05) -> FreeObject3:
    """A uniform ellipsoid that is round about its z axis.

    Args:
        radius: Of its waist [m].
        height: From end to end, along z [m].
        mass: In kilograms.

    Returns:
        The object.

    Raises:
        ValueError: If a number is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> f"{jxr.scenes.spheroid().mass:.3f} kg"
        '0.050 kg'
    """
    a, c, m = as_positive("radius", radius), 0.5 * as_positive("height", height), as_positive("mass", mass)
    # m/5 (b^2 + c^2), ... of an ellipsoid's half axes.
    across, along = 0.2 * m * (a * a + c * c), 0.4 * m * a * a
    return FreeObject3(Ellipsoid(a, a, c), m, jnp.stack([across, across, along]))


def tripod(
    *,
    fingers: int = 3,
    tips: AbstractSurface | None = None,
    object: FreeObject3 | None = None,
    beta: Given = 16.0,
    damping: Given = 0.03,
    stiffness: Given = 300.0,
    spin: Literal["free", "prevented"] = "free",
    friction: Given | None = None,
    gravity: Given = (0.0, 0.0, -9.81),
) -> tuple[Grasp, State]:
    r"""Three fingers, or more, hold an object that hangs between them, and carry it where commands say.

    The fingers stand on a circle of radius 50 mm in the palm, the plane z = 0, and hang down; their first
    joint swings them along the circle, the others bend them towards its axis. The centres of the tips begin
    30 mm from the axis and 115 mm below the palm. The control is `control.Carry`: tips draw one another
    together, each is held in a frame that commands move, and all carry the object's weight alike. The
    fingers' own weight is compensated: gravity acts on the object alone.

    Commanded by `grasp.with_(position=..., turn=...)`, the object follows the frame but for what rolling adds
    in second order. With a frame that rises by 20 mm and turns by 20 degrees about z within 2.2 s, it rises
    by 19.8 mm and turns by 19.5 degrees; the friction demand is 0.17 at most.

    Args:
        fingers: Two or more. Two leave the object free to turn about the line between them.
        tips: Surface of every fingertip, about the end of the finger's last link. Default: spheres of 10 mm.
        object: With one surface all round it. Default: `spheroid()`, of 50 g.
        beta: $\beta$ [N/m]: each of n tips presses with $n \beta$ times its distance from the axis.
        damping: $c$ [N m s].
        stiffness: $k$ [N/m], of the springs that hold the tips in the frame.
        spin: Whether the contacts let the bodies turn against each other about the normal.
        friction: Coefficient of friction of all contacts; then a run that needs more of it ends.
        gravity: Shape (3,) [m/s^2].

    Returns:
        The grasp, and a state at rest with all contacts closed, in equilibrium. The frame begins at the mean
        of the tips, `grasp.controller.position`, not turned.

    Raises:
        ValueError: If the fingers cannot close all contacts, or are fewer than two.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.tripod(fingers=2)  # each more takes longer to compile
        >>> grasp.sizes  # object, two fingers
        (6, 3, 3)
    """
    count = as_count("fingers", fingers, least=2, most=100)
    body = spheroid() if object is None else check_instance("object", object, FreeObject3, "a FreeObject3")
    if len(body.surfaces) != 1:
        raise ValueError(f"argument object must have one surface, but had {shown(len(body.surfaces))}")
    tip = Sphere(0.01) if tips is None else check_instance("tips", tips, AbstractSurface, "a surface")
    field = as_floats("gravity", gravity, (3,))
    ways = 2.0 * np.pi / count * np.arange(count)
    hand = [_finger(tip, way) for way in ways]
    contacts = [Contact3(i, 0, spin=spin, friction=friction) for i in range(count)]
    # Its numbers are looked at before the contacts are closed, which takes longer.
    control = Carry(beta, damping, stiffness, home=jnp.zeros((count, 3)), force=-body.mass * field)
    grasp, state = close(Grasp(body, hand, contacts), _guess(body, tip, ways), hold_contacts=False)
    each = zip(hand, jnp.split(state.s, 2 * count)[::2], strict=True)
    hand = [_ending_at(finger, finger.tip.point(at)) for finger, at in each]
    placed = jnp.stack(
        [f.pose(tuple(state.q[7 + 3 * i : 10 + 3 * i])).origin.array() for i, f in enumerate(hand)]
    )
    middle = jnp.mean(placed, axis=0)
    control = eqx.tree_at(lambda c: (c.home, c.position), control, (placed - middle[None], middle))
    weights = jnp.zeros((1 + count, 3)).at[0].set(field)
    return Grasp(body, hand, contacts, controller=control, gravity=weights), state


def _finger(tip: AbstractSurface, way: float) -> Finger3:
    """A finger on the circle, in the direction of an angle [rad] about z."""
    base = (_RADIUS * np.cos(way), _RADIUS * np.sin(way), 0.0)
    return Finger3(_AXES, _LINKS, _MASSES, tip, base=base, rotation=(np.cos(way / 2), 0, 0, np.sin(way / 2)))


def _ending_at(finger: Finger3, point: Array) -> Finger3:
    """The same finger with the origin of its tip's frame at a point of that frame."""
    offsets = finger.offsets.at[-1].add(point)
    return eqx.tree_at(lambda f: (f.offsets, f.tip), finger, (offsets, finger.tip.moved(-point)))


def _guess(body: FreeObject3, tip: AbstractSurface, ways: np.ndarray) -> State:
    """Tips round the object's waist, all fingers bent alike, with their middle joints outside."""
    # Two equal links span the line from the second joint to the tip: its angle from -z, and half of that
    # between the links.
    inwards, down = _RADIUS - _REACH, -_HEIGHT + _LINKS[0][2]
    lean = np.arctan2(inwards, down)
    bend = np.arccos(np.hypot(inwards, down) / (2.0 * -_LINKS[1][2]))
    joints = np.array([0.0, lean - bend, 2.0 * bend])
    q = np.concatenate([[0.0, 0.0, _HEIGHT, 1.0, 0.0, 0.0, 0.0], np.tile(joints, len(ways))])
    # The places face each other, in the tip's own axes and in the object's.
    turn = lean + bend
    inside = 0.5 * _REACH * np.array([-np.cos(turn), 0.0, -np.sin(turn)])
    places = []
    for way in ways:
        outside = _REACH * np.array([np.cos(way), np.sin(way), 0.0])
        places += [tip.near(inside), body.surfaces[0].near(outside)]
    v = np.zeros(6 + 3 * len(ways))
    return State(q, v, jnp.concatenate(places))
