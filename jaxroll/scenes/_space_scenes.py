"""Part 3 of the chapter: a pinch in space (Figs. 19 and 20).

Fingertips are balls and the object a cuboid, unless others are given. As in the plane, the joints of a guess
are given by hand, and `close` moves everything from there until the contacts are closed.
"""

from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._closing import close
from .._mechanics import Finger3, FreeObject3, Grasp, State
from .._results import as_length, check_instance
from .._types import Given
from ..contact import Contact3
from ..control import Opposition
from ..geometry import AbstractSurface, Plane, Sphere
from ._scene_arguments import as_pair, as_positive

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


@jax.jit  # one small program, not twelve
def _cuboid(lengths: list[Array], mass: Array) -> tuple[Array, Array, Array]:
    """Edges of a cuboid, its principal moments, and the centres of its faces along x."""
    edges = jnp.stack(lengths)
    squares = edges**2
    face = jnp.zeros((2, 3), edges.dtype).at[:, 0].set(edges[0] * jnp.array([-0.5, 0.5], edges.dtype))
    return edges, mass * (squares.sum() - squares) / 12.0, face


def pinch3d(
    *,
    tips: AbstractSurface | tuple[AbstractSurface, AbstractSurface] | None = None,
    object: FreeObject3 | None = None,
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

    Args:
        tips: Surface of both fingertips or one for each, about $O_i$. Default: spheres of 10 mm.
        object: With two surfaces, its left and its right face, or with one all round it. Default:
            `cuboid()`.
        beta: $\beta$ [N/m].
        damping: $c$ [N m s], one or two.
        spin: Whether the contacts let the bodies turn against each other about the normal.
        friction: Coefficient of friction of both contacts; then a run that needs more of it ends.
        gravity: Shape (3,) [m/s^2]. Default: none.

    Returns:
        The grasp, and a state at rest with both contacts closed.

    Raises:
        ValueError: If the fingers cannot close both contacts.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pinch3d()
        >>> grasp.sizes  # object, two fingers
        (6, 3, 3)
    """
    body = cuboid() if object is None else check_instance("object", object, FreeObject3, "a FreeObject3")
    shapes = Sphere(0.01) if tips is None else tips
    pair = as_pair("tips", shapes, AbstractSurface, "a surface or a pair of them")
    fingers = [
        Finger3(AXES3, LINKS3, MASSES3, tip, base=(side * SPAN3, 0.0, 0.0))
        for tip, side in zip(pair, (-1.0, 1.0), strict=True)
    ]
    # Two surfaces: a finger on each; a single one that goes all round is touched by both.
    faces = range(2) if len(body.surfaces) > 1 else (0, 0)
    contacts = [Contact3(i, face, spin=spin, friction=friction) for i, face in enumerate(faces)]
    # Guesses of the places: points in the bodies' own axes, roughly where tip and object face each other.
    places = []
    for tip, face, side in zip(pair, faces, (-1.0, 1.0), strict=True):
        start = np.array([0.025 * side, -0.002, -0.004 * side])
        places += [tip.near(np.array([-0.02 * side, 0.0, 0.0])), body.surfaces[face].near(start)]
    joints = np.array(_JOINTS)
    q = np.concatenate([_CENTRE, (1.0, 0.0, 0.0, 0.0), joints, -joints])
    guess = State(jnp.asarray(q), jnp.zeros(12), jnp.concatenate(places))
    grasp, state = close(Grasp(body, fingers, contacts, gravity=gravity), guess, hold_contacts=False)
    # Without alpha the values of `start` have no effect; its length says how many fingers there are.
    control = Opposition(beta, damping, start=jnp.zeros(2))
    return Grasp(body, fingers, contacts, controller=control, gravity=gravity), state
