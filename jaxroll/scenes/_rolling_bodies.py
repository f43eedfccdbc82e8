"""Single bodies that roll on a fixed or a moving surface: the textbooks' cases, with their closed forms.

The body is the `object` of a grasp, the surface the tip of its only finger, a `Stage`. Every start is given
in closed form, touching and without slip, so that `close` is not needed. Places: coordinates on the stage's
surface first, then on the body's, each in its own axes. The velocity of a body is that of its centre in the
world, then its angular velocity in the body's axes.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._linalg import pose_at, Vec3
from .._mechanics import FreeObject3, Grasp, Stage, State, Turning
from .._results import as_floats, as_length, as_positive, check_between, check_positive, concrete
from .._types import Given
from ..contact import Contact3
from ..geometry import Cylinder, Ellipsoid, Hollow, Plane, Sphere, Torus
from ._scene_arguments import check_below

_SOLID = 0.4  # k in the inertia k m r^2 of a solid ball


def _down(gravity: Given) -> Float[Array, "3"]:
    """Acceleration of gravity as a vector along -z [m/s^2]."""
    return jnp.stack([jnp.zeros(()), jnp.zeros(()), -as_floats("gravity", gravity, ())])


def _ball(radius: Array, mass: Given) -> FreeObject3:
    """A solid ball of radius [m] and mass [kg]."""
    mass = as_positive("mass", mass)
    return FreeObject3(Sphere(radius), mass, _SOLID * mass * radius**2)


def _start(position: Array, velocity: Array, spin: Array, places: Array, *, clock: bool = False) -> State:
    """The state of a body whose axes are those of the world.

    Args:
        position: Of the centre [m].
        velocity: Of the centre [m/s].
        spin: Angular velocity [rad/s].
        places: Of the contact, on the stage and on the body.
        clock: Whether the stage moves, and so has a clock as its coordinate, which starts at 0.
    """
    upright, ticking = jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.zeros(int(clock))
    q = jnp.concatenate([position, upright, ticking])
    return State(q, jnp.concatenate([velocity, spin]), places)


def turntable(
    *,
    rate: Given = 2.0,
    position: Given = (0.3, 0.1),
    velocity: Given = (0.2, -0.4),
    spin: Given = 0.7,
    radius: Given = 0.05,
    mass: Given = 0.3,
    gravity: Given = 9.81,
) -> tuple[Grasp, State]:
    r"""A solid ball on a turntable: its centre goes round a circle at $\frac27 \Omega$, wherever it starts.

    Args:
        rate: $\Omega$ of the table about z [rad/s].
        position: Shape (2,), start of the centre [m].
        velocity: Shape (2,), its velocity [m/s].
        spin: About the vertical [rad/s]; it stays.
        radius: Of the ball [m].
        mass: In kilograms.
        gravity: Downwards [m/s^2].

    Returns:
        The grasp, and a state that rolls. The last coordinate is the table's clock.

    Raises:
        ValueError: If an argument does not fit.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.turntable()
        >>> state.q.shape
        (8,)
    """
    x, y = as_floats("position", position, (2,))
    vx, vy = as_floats("velocity", velocity, (2,))
    r, zero = as_length("radius", radius), jnp.zeros(())
    omega, spin = as_floats("rate", rate, ()), as_floats("spin", spin, ())
    # No slip at the lowest point: v + w x (-r z) = Omega z x X.
    w = jnp.stack([-(vy - omega * x) / r, (vx + omega * y) / r, spin])
    grasp = Grasp(_ball(r, mass), Stage(Plane(), Turning(omega)), Contact3(), gravity=_down(gravity))
    places = jnp.stack([x, y, zero, zero, zero, -r])
    return grasp, _start(jnp.stack([x, y, r]), jnp.stack([vx, vy, zero]), w, places, clock=True)


def tube(
    *,
    rate: Given = 6.0,
    climb: Given = 0.3,
    spin: Given = 4.0,
    radius: Given = 0.05,
    bore: Given = 0.2,
    mass: Given = 0.3,
    gravity: Given = 9.81,
) -> tuple[Grasp, State]:
    r"""A solid ball in a vertical tube, bobbing: its height is harmonic at $\sqrt{2/7}$ of its rate round.

    Args:
        rate: Of the centre round the axis [rad/s]; it stays.
        climb: Start of the centre's vertical velocity [m/s].
        spin: About the normal, at the start [rad/s].
        radius: Of the ball [m].
        bore: Radius of the tube [m].
        mass: In kilograms.
        gravity: Downwards [m/s^2].

    Returns:
        The grasp, and a state that rolls.

    Raises:
        ValueError: If an argument does not fit.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.tube()
        >>> round(float(state.q[0]), 9)  # the centre's distance from the axis
        0.15
    """
    r, out, n = as_length("radius", radius), as_length("bore", bore), as_floats("rate", rate, ())
    check_below("radius", r, "bore", out)
    # No slip at the wall: v + w x (r, 0, 0) = 0, v = (0, (out - r) n, climb); w_x, about the normal, is free.
    zero, climb = jnp.zeros(()), as_floats("climb", climb, ())
    w = jnp.stack([as_floats("spin", spin, ()), climb / r, -(out - r) * n / r])
    wall = Stage(Hollow(Cylinder(out)))
    grasp = Grasp(_ball(r, mass), wall, Contact3(), gravity=_down(gravity))
    places = jnp.stack([out, zero, zero, r, zero, zero])
    return grasp, _start(jnp.stack([out - r, zero, zero]), jnp.stack([zero, (out - r) * n, climb]), w, places)


def incline(
    *, slope: Given = 0.3, radius: Given = 0.05, mass: Given = 0.3, gravity: Given = 9.81
) -> tuple[Grasp, State]:
    r"""A solid ball that rolls down a slope from rest, at $\frac57 g \sin\alpha$.

    Args:
        slope: $\alpha$, towards +x [rad].
        radius: Of the ball [m].
        mass: In kilograms.
        gravity: Downwards [m/s^2].

    Returns:
        The grasp, and a state that rolls.

    Raises:
        ValueError: If an argument does not fit.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.incline()
        >>> state.s.shape
        (6,)
    """
    r, alpha, zero = as_length("radius", radius), as_floats("slope", slope, ()), jnp.zeros(())
    # The plane is turned about y by alpha; it passes through the origin, where the ball starts touching it.
    normal = jnp.stack([jnp.sin(alpha), zero, jnp.cos(alpha)])
    turn = jnp.stack([jnp.cos(0.5 * alpha), zero, jnp.sin(0.5 * alpha), zero])
    floor = Stage(Plane(), rotation=turn)
    grasp = Grasp(_ball(r, mass), floor, Contact3(), gravity=_down(gravity))
    places = jnp.concatenate([jnp.zeros(3), -r * normal])
    return grasp, _start(r * normal, jnp.zeros(3), jnp.zeros(3), places)


def wheel(
    *,
    inclination: Given = 1.2,
    precession: Given = 3.0,
    radius: Given = 0.1,
    tube: Given = 0.01,
    mass: Given = 0.5,
    gravity: Given = 9.81,
) -> tuple[Grasp, State]:
    r"""A rolling wheel (a disc with a round rim) in steady precession: its inclination stays.

    With $\theta$ between axis and vertical, a and $\rho$ the rim's radii, A and C the inertias across and
    about the axis and $\Omega$ the precession, the spin $w_3$ about the axis solves
    $w_3 \Omega\,(C \sin\theta + m (a + \rho \sin\theta)(a \sin\theta + \rho)) =
    A \Omega^2 \sin\theta \cos\theta - m g a \cos\theta
    + m \Omega^2 \rho \sin\theta \cos\theta\,(a \sin\theta + \rho)$.

    Args:
        inclination: $\theta$ [rad].
        precession: $\Omega$ [rad/s].
        radius: a, of the circle of the rim's centres [m].
        tube: $\rho$, of the rim's cross-section [m].
        mass: In kilograms; the inertias are those of a thin disc of radius a.
        gravity: Downwards [m/s^2].

    Returns:
        The grasp, and a state that rolls.

    Raises:
        ValueError: If an argument does not fit.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.wheel()
        >>> state.v.shape
        (6,)
    """
    theta, turn = as_floats("inclination", inclination, ()), as_floats("precession", precession, ())
    check_between("inclination", theta, 1e-6, np.pi - 1e-6, unit=" rad")
    if (seen := concrete(turn)) is not None and seen == 0.0:
        raise ValueError("argument precession must not be zero, but was 0.0")
    a, rho = as_length("radius", radius), as_length("tube", tube)
    check_below("tube", rho, "radius", a)
    m, g = as_positive("mass", mass), as_floats("gravity", gravity, ())
    sin, cos, zero = jnp.sin(theta), jnp.cos(theta), jnp.zeros(())
    across, about = 0.25 * m * a**2, 0.5 * m * a**2
    lever = a * sin + rho
    moment = across * sin * cos * turn**2 - m * g * a * cos + m * turn**2 * rho * sin * cos * lever
    w3 = moment / (turn * (about * sin + m * (a + rho * sin) * lever))
    # No slip: the centre goes round the z axis at the precession's rate, at this distance (with a sign).
    centre = (w3 * (a + rho * sin) - turn * rho * sin * cos) / turn
    # Body axes: h horizontal, u up along the disc, e the axis. The pose turns them about x, which is h, by
    # theta. The rim touches below the centre: along -u to the circle of its centres, from there along -z.
    spin = jnp.stack([zero, turn * sin, w3])
    touching = -a * jnp.stack([zero, 1.0 + zero, zero]) - rho * jnp.stack([zero, sin, cos])
    body = FreeObject3(Torus(a, rho), m, jnp.stack([across, across, about]))
    grasp = Grasp(body, Stage(Plane()), Contact3(), gravity=_down(gravity))
    half = 0.5 * theta
    q = jnp.stack([zero, centre, a * sin + rho, jnp.cos(half), jnp.sin(half), zero, zero])
    place = jnp.stack([zero, centre - a * cos, zero])
    velocity = jnp.stack([-turn * centre, zero, zero])
    return grasp, State(q, jnp.concatenate([velocity, spin]), jnp.concatenate([place, touching]))


def rattleback(
    *,
    spin: Given = -5.0,
    tilt: Given = 0.0087266462599716,
    skew: Given = 0.034906585039886591,
    axes: Given = (0.20, 0.03, 0.02),
    lowered: Given = 0.01,
    inertia: Given = (2e-4, 1.6e-3, 1.7e-3),
    mass: Given = 1.0,
    gravity: Given = 9.81,
) -> tuple[Grasp, State]:
    """A rattleback: half an ellipsoid that reverses its spin, without any loss.

    Its principal axes of inertia are turned against those of its shape; the numbers are about those of Kane
    and Levinson (1982).

    Args:
        spin: About the body's z axis, which is vertical but for the tilt, at the start [rad/s].
        tilt: Start of the tilt about the long axis [rad].
        skew: By which the principal axes are turned from the shape's [rad].
        axes: Semi-axes [m], shape (3,).
        lowered: Centre of mass below the ellipsoid's centre [m].
        inertia: Principal moments [kg m^2], shape (3,).
        mass: In kilograms.
        gravity: Downwards [m/s^2].

    Returns:
        The grasp, and a state that rolls.

    Raises:
        ValueError: If an argument does not fit.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.rattleback()
        >>> float(state.v[5])
        -5.0
    """
    half, skew = 0.5 * as_floats("tilt", tilt, ()), as_floats("skew", skew, ())
    low, zero = as_floats("lowered", lowered, ()), jnp.zeros(())
    lengths, moments = as_floats("axes", axes, (3,)), as_floats("inertia", inertia, (3,))
    shape = Ellipsoid(*check_positive("axes", lengths)).moved(jnp.stack([zero, zero, low]))
    sin, cos = jnp.sin(skew), jnp.cos(skew)
    turn = jnp.stack([jnp.stack([cos, -sin, zero]), jnp.stack([sin, cos, zero]), jnp.array([0.0, 0.0, 1.0])])
    tensor = turn @ jnp.diag(check_positive("inertia", moments)) @ turn.T
    body = FreeObject3(shape, mass, 0.5 * (tensor + tensor.T))
    grasp = Grasp(body, Stage(Plane()), Contact3(), gravity=_down(gravity))
    # The point of an ellipsoid that is farthest along -up: -A up / sqrt(up . A up) with A = diag(axes^2).
    up = jnp.stack([zero, 2.0 * jnp.sin(half) * jnp.cos(half), jnp.cos(2.0 * half)])
    squares = lengths**2
    lowest = -squares * up / jnp.sqrt(jnp.sum(squares * up**2))
    arm = lowest + jnp.stack([zero, zero, low])
    # `arm`: from the centre of mass to the contact. The centre's height is such that the contact has height
    # zero, its velocity -w x arm such that it is at rest there.
    q = jnp.stack([zero, zero, -arm @ up, jnp.cos(half), jnp.sin(half), zero, zero])
    about = jnp.stack([zero, zero, as_floats("spin", spin, ())])
    tilted = pose_at(Vec3(zero, zero, zero), (q[3], q[4], zero, zero))
    there, across = tilted.turn(Vec3(*arm)), tilted.turn(Vec3(*about).cross(Vec3(*arm)))
    place = jnp.stack([there.x, there.y, zero, *lowest])
    return grasp, State(q, jnp.concatenate([-across.array(), about]), place)
