"""A disc on a plate that control (75) drives: a run under commands is two thirds of one of Part 2's."""

import numpy as np

import jaxroll as jxr

# The plate moves along this direction, and gravity pulls against it: the disc falls with a plate that falls
# freely, and loses its contact where the controller's force is zero.
_WAY = np.array([np.cos(1.3), np.sin(1.3)])


def driven_plate(load=None):
    """The grasp, and its start at rest, where the disc begins to roll and the plate to rise."""
    law = jxr.control.Press(0.5, 0.01, 8.0, target=0.01 * _WAY)
    plate = jxr.Jaw(jxr.Line(), 0.1, [1.3], angle=0.5 * np.pi)
    disc = jxr.FreeObject(jxr.Circle(0.05), 0.02, 2.5e-5)
    grasp = jxr.Grasp(disc, plate, jxr.Contact(), controller=law, gravity=-2.0 * _WAY, load=load)
    # The point of the disc at which its arclength is zero lies below its centre.
    return grasp, jxr.State([0.0, 0.05, -0.5 * np.pi, 0.0], np.zeros(4), np.zeros(1))
