"""A disc on a plate that swings, damped, about where it began, while the disc turns on the spot."""

import equinox as eqx
import jax

import jaxroll as jxr
from tests.subjects import rolling_disc

STIFFNESS, DAMPING, SPEED = 5.0, 0.8, 0.1


class Spring(eqx.Module):
    """What holds the plate; `Grasp.with_` knows its numbers by their names."""

    stiffness: float | jax.Array = STIFFNESS
    damping: float | jax.Array = DAMPING

    def __call__(self, t, joints, rates, tips):
        return [-self.stiffness * joints[0] - self.damping * rates[0]]


def swinging(damping=DAMPING, stiffness=STIFFNESS):
    """Grasp and start; the numbers of its spring may be traced."""
    grasp, state = rolling_disc.on_driven_plate(Spring(stiffness, damping))
    return grasp, jxr.State(state.q, [0.0, 0.0, SPEED / rolling_disc.RADIUS, SPEED], state.s)
