"""A disc that driven jaws press from all sides: the smallest grasps that can lose a contact and go on."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxroll as jxr

RADIUS, TIP = 0.02, 0.01


def disc_between_jaws(load=None):
    """Round jaws that move along x and meet the disc a little off its middle, and the state at rest.

    The contact of the left jaw, finger 0, is the last one: as which it is found again where it was lost.
    """
    jaws, contacts = [], []
    for finger, angle in enumerate((np.pi + 0.2, 0.1)):
        at = (RADIUS + TIP) * np.array([np.cos(angle), np.sin(angle)])
        jaws.append(jxr.Jaw(jxr.Circle(TIP), 0.03, [0.0], base=at))
        contacts.append(jxr.Contact(TIP * (angle - np.pi), RADIUS * angle, finger=finger))
    law = jax.tree_util.Partial(_pressing, jnp.array([1.0, -1.0]))
    disc = jxr.FreeObject(jxr.Circle(RADIUS), 0.05, 1e-5)
    grasp = jxr.Grasp(disc, jaws, contacts[::-1], controller=law, load=load)
    return grasp, jxr.State(np.zeros(5), np.zeros(5), np.zeros(2))


def disc_among_jaws(load=None):
    """Three round jaws, evenly round the disc, which move in the plane and press towards its middle."""
    angles = 2.0 * np.pi * np.arange(3) / 3
    out = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    jaws = [jxr.Jaw(jxr.Circle(TIP), 0.03, [0.0, 0.5 * np.pi], base=(RADIUS + TIP) * way) for way in out]
    contacts = [jxr.Contact(TIP * (a - np.pi), RADIUS * a, finger=i) for i, a in enumerate(angles)]
    law = jax.tree_util.Partial(_pushing, jnp.asarray(-out))
    disc = jxr.FreeObject(jxr.Circle(RADIUS), 0.05, 1e-5)
    grasp = jxr.Grasp(disc, jaws, contacts, controller=law, load=load)
    return grasp, jxr.State(np.zeros(9), np.zeros(9), np.zeros(3))


def _pushing(forces, t, places, rates, tips):
    """A constant force on each jaw along both its axes, less its damping."""
    return tuple(force - rate for force, rate in zip(forces, rates, strict=True))


def _pressing(forces, t, places, rates, tips):
    """A constant force on each jaw, less its damping."""
    return tuple(jnp.stack([force - rate[0]]) for force, rate in zip(forces, rates, strict=True))
