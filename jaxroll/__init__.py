"""Differentiable simulation of grasping under rolling contact, in JAX.

`scenes` has the chapter's scenes ready-made; `Finger`, `FreeObject` or `PivotedObject` and `Contact` make a
`Grasp`; `close` finds a consistent `State`; `simulate` runs it; `plotting` draws it.
"""

import importlib
from typing import Any, TYPE_CHECKING

from . import contact, control, geometry
from ._results import RESULTS
from .contact import Contact
from .geometry import AbstractContour, Catenary, Circle, Ellipse, Line
from .mechanics import equation_terms, Finger, FreeObject, Grasp, PivotedObject, State

if TYPE_CHECKING:
    from . import plotting, scenes
    from .integration import (
        close,
        CSM,
        energies,
        Index1,
        multipliers,
        press_balance,
        residuals,
        simulate,
        Trajectory,
    )

__version__ = "0.1.0"
__all__ = [
    "CSM",
    "RESULTS",
    "AbstractContour",
    "Catenary",
    "Circle",
    "Contact",
    "Ellipse",
    "Finger",
    "FreeObject",
    "Grasp",
    "Index1",
    "Line",
    "PivotedObject",
    "State",
    "Trajectory",
    "close",
    "contact",
    "control",
    "energies",
    "equation_terms",
    "geometry",
    "multipliers",
    "plotting",
    "press_balance",
    "residuals",
    "scenes",
    "simulate",
]


def __getattr__(name: str) -> Any:
    # What needs diffrax or matplotlib is imported with its first use: half a second saved.
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name in ("plotting", "scenes"):
        return importlib.import_module(f".{name}", __name__)
    return getattr(importlib.import_module(".integration", __name__), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
