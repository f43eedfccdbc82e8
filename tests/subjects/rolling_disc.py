"""A uniform disc that rolls on a flat plate: the shortest programs of all, and motions in closed form."""

import jax.numpy as jnp
import numpy as np

import jaxroll as jxr

RADIUS, MASS, PLATE = 0.01, 0.02, 0.1
GRAVITY = 9.81
# A disc accelerates by a third of its plate's acceleration: this is what a force on the plate has to move.
MOVED = PLATE + MASS / 3.0


def on_slope(slope, friction=None, load=None):
    """On a fixed plate that falls off to the right at an angle; it slips if tan(slope) > 3 friction."""
    down = GRAVITY * jnp.stack([jnp.sin(slope), -jnp.cos(slope)])
    return _rolling(jxr.Jaw(jxr.Line(), angle=0.5 * np.pi), friction=friction, gravity=down, load=load)


def on_driven_plate(controller):
    """On a level plate that a controller drives along itself, by one force."""
    plate = jxr.Jaw(jxr.Line(), PLATE, (0.0,), angle=0.5 * np.pi)
    return _rolling(plate, controller=controller, gravity=(0.0, -GRAVITY))


def _rolling(plate, friction=None, **options):
    disc = jxr.FreeObject(jxr.Circle(RADIUS), MASS, 0.5 * MASS * RADIUS**2)
    grasp = jxr.Grasp(disc, plate, jxr.Contact(0.0, 0.0, friction=friction), **options)
    # The point of the disc at which its arclength is zero lies below its centre.
    q = np.array([0.0, RADIUS, -0.5 * np.pi, *np.zeros(plate.joints)])
    return grasp, jxr.State(q, np.zeros(len(q)), np.zeros(1))
