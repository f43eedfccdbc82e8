"""Which coordinates a search leaves where they are, by the names that reports give them."""

from collections.abc import Sequence

import numpy as np

from .._mechanics import Grasp
from .._results import shown


def held_velocities(grasp: Grasp, hold: str | Sequence[str]) -> tuple[int, ...]:
    """Indices of the velocities that belong to held bodies and coordinates.

    Args:
        grasp: The grasp.
        hold: Names of bodies ('object', 'finger 0') or of single coordinates with their body's ('object x',
            'finger 0 q[1]'), as `grasp.labels.coordinates` lists them.
    """
    names = [hold] if isinstance(hold, str) else list(hold) if isinstance(hold, list | tuple) else [hold]
    first = np.cumsum([0, *grasp.sizes])
    known: dict[str, range] = {}
    for (body, labels), begin, size in zip(grasp.labels.bodies, first, grasp.sizes, strict=False):
        known[body] = range(begin, begin + size)
        # The numbers of a quaternion are no angles or lengths, and have no velocities of their own.
        for i, label in enumerate(labels[:size]):
            if label.unit in ("m", "rad"):
                known[f"{body} {label.name}"] = range(begin + i, begin + i + 1)
    found: set[int] = set()
    for name in names:
        if not isinstance(name, str) or name not in known:
            raise ValueError(
                f"argument hold must name bodies or coordinates, as {', '.join(map(repr, list(known)[:3]))}, "
                f"but was {shown(name)}"
            )
        found |= set(known[name])
    return tuple(sorted(found))
