"""The chapter's scenes, ready to run."""

import jax.numpy as jnp
import numpy as np

from ._types import Given
from .contact import Contact
from .control import Press
from .geometry import Catenary, Moved
from .integration import close
from .mechanics import Finger, Grasp, PivotedObject, State

# Tables 1 and 2.
LENGTHS = (0.065, 0.065)
MASSES = (0.045, 0.040)
INERTIA = 6.6178e-6
FORCE, RADIUS, DAMPING = 0.500, 0.010, 0.006
# (80)-(83): vertex of the object's contour at s = 3.363 mm, of the fingertip's at s = 0.
OBJECT_SHIFT = 3.363e-3


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
    other with the same numbers. The pad of the fingertip faces to the right of the last link, as (58)-(59)
    say. The chapter states neither base, pivot nor starting contact; the defaults are ours.

    Args:
        s: Chapter's arclength at the starting contact [m]. By default the object turns by
            0.77 rad on its way to equilibrium, near s = -4.79 mm.
        base: Shape (2,), position of the first joint [m].
        pivot: Shape (2,), position of the object's pivot $O_m$ [m].
        gravity: Shape (2,) [m/s^2]; the chapter's plane is horizontal, so there is none by default.

    Returns:
        The grasp, and a state at rest with the contact closed.

    Raises:
        ValueError: If the finger cannot reach that contact.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> state.q.shape
        (3,)
    """
    reach = (-0.03, 0.03)
    tip = Catenary(1.0 / 40.0, reach).moved((0.01, 0.0))
    face = Catenary(1.0 / 100.0, reach).moved((-0.02, 0.0), np.pi, origin=OBJECT_SHIFT)
    s = jnp.asarray(s, float)
    grasp = Grasp(
        PivotedObject(face, INERTIA, pivot=pivot),
        Finger(LENGTHS, MASSES, Moved(tip, (0.0, 0.0), -np.pi / 2), base=base),
        Contact(s_tip=-s, s_object=s),
        controller=Press(FORCE, RADIUS, DAMPING, target=pivot),
        gravity=gravity,
    )
    guess = State(jnp.array([-0.5, 1.9, -0.7]), jnp.zeros(3), jnp.zeros(1))
    return close(grasp, guess)
