"""The smallest scene whose rows are curved: half the program of a derivative of Part 2."""

import numpy as np

import jaxroll as jxr


def disc_on_a_hill(*, mass=0.05, speed=0.02, gravity=(2.0, -9.6), reach=0.03, friction=None, load=None):
    """A disc of 10 mm that begins to roll down a fixed catenary, and how it starts, at the hill's vertex.

    Its inertia stays as it is, whatever the mass. It arrives at the end of the hill, `reach` [m] away along
    it, where a friction coefficient or a load does not end the run before.
    """
    hill = jxr.Jaw(jxr.Catenary(0.05, reach * np.array([-1.0, 1.0])), angle=0.5 * np.pi)
    disc = jxr.FreeObject(jxr.Circle(0.01), mass, 2.5e-6)
    contact = jxr.Contact(0.0, -0.005 * np.pi, friction=friction)
    start = jxr.State([0.0, 0.01, 0.0], np.array([1.0, 0.0, -100.0]) * speed, [0.0])
    return jxr.Grasp(disc, hill, contact, gravity=gravity, load=load), start
