"""A disc on a plate that swings, damped, about where it began, while the disc turns on the spot."""

import jaxroll as jxr
from tests.subjects import rolling_disc

STIFFNESS, SPEED = 5.0, 0.1


def swinging(damping, stiffness=STIFFNESS):
    """Grasp and start; the numbers of its spring and its damper may be traced."""
    law = lambda t, joints, rates, tips: [-stiffness * joints[0] - damping * rates[0]]  # noqa: E731
    grasp, state = rolling_disc.on_driven_plate(law)
    return grasp, jxr.State(state.q, [0.0, 0.0, SPEED / rolling_disc.RADIUS, SPEED], state.s)
