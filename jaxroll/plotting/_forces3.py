"""Contact forces and loads of a grasp in space, as drawn."""

from typing import NamedTuple

import numpy as np

from .._integration import Trajectory
from .._mechanics import Grasp
from .._motion import wrenches
from ._forces import acts, recorded_forces
from ._motion3 import Motion3D
from ._views3 import turned_each


class Pushes(NamedTuple):
    """Forces on the object in world axes.

    Attributes:
        contacts: Those of the contacts, shape (c, t, 3) [N].
        load: The force of all loads, shape (t, 3) [N], or None.
        at: Where it acts, shape (t, 3) [m].
        scale: Millimetres for one newton if forces are arrows and `at` is a place in mm, as `scaled` makes
            them; zero if they are in newtons and metres.
    """

    contacts: np.ndarray
    load: np.ndarray | None = None
    at: np.ndarray | None = None
    scale: float = 0.0

    def rows(self, rows: np.ndarray) -> "Pushes":
        """Some of the times."""
        if self.load is None or self.at is None:
            return Pushes(self.contacts[:, rows])
        return Pushes(self.contacts[:, rows], self.load[rows], self.at[rows])

    @property
    def peak(self) -> float:
        """The largest force [N]."""
        forces = [self.contacts, *([] if self.load is None else [self.load[None]])]
        return max(float(np.nanmax(np.linalg.norm(each, axis=-1), initial=0.0)) for each in forces)


def pushes(grasp: Grasp, trajectory: Trajectory, motion: Motion3D) -> Pushes:
    """Recorded contact forces on the object, and the force of its loads, placed as in `_forces.arrows`.

    Raises:
        ValueError: If the run has no recorded multipliers.
    """
    found = recorded_forces(trajectory)
    # lambda is a vector in world axes here, on the object; f presses against the outward normal.
    out = np.stack([turned_each(motion.body, normals) for normals in motion.out_of_object])
    contacts = np.swapaxes(np.asarray(found.lam), 0, 1) - np.asarray(found.f).T[..., None] * out
    if not acts(grasp):
        return Pushes(contacts)
    force, torque = map(np.asarray, wrenches(grasp, trajectory.ts, trajectory.states))
    square = np.maximum((force**2).sum(axis=-1, keepdims=True), 1e-300)
    return Pushes(contacts, force, motion.body[:, :3] + np.cross(force, torque) / square)
