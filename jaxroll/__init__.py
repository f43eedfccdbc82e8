"""Differentiable simulation of grasping under rolling contact, in JAX.

`scenes` has the chapter's scenes ready-made; `Finger`, `FreeObject` or `PivotedObject` and `Contact`
make a `Grasp`; `close` finds a consistent `State`; `simulate` runs it; `plotting` draws it.
"""

import importlib
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from . import contact, control, design, geometry, io, plotting, scenes, stability
    from ._analysis import contact_geometry, loci, pinch_balance, press_balance, roll
    from ._closing import close
    from ._integration import Rosenbrock, simulate, Trajectory, vector_field
    from ._mechanics import (
        Finger,
        Finger3,
        FreeObject,
        FreeObject3,
        Grasp,
        Jaw,
        PivotedObject,
        Stage,
        State,
        Turning,
    )
    from ._motion import CSM, energies, equation_terms, Index1, multipliers, residuals
    from ._results import RESULTS
    from ._sweep import sweep
    from ._why import why
    from .contact import Contact, Contact3
    from .geometry import (
        AbstractContour,
        AbstractSurface,
        Catenary,
        Circle,
        Ellipse,
        Ellipsoid,
        fit_contour,
        Line,
        NeuralCurvature,
        NeuralSupport,
        Parametric,
        Plane,
        Sphere,
        Spline,
        SupportFunction,
        Torus,
    )

__version__ = "0.1.0"

# Where each public name lives; None for a submodule. Names are imported with their first use, so that
# `import jaxroll` is immediate and the command line answers `--help` without loading JAX.
_HOMES: dict[str, str | None] = {
    "contact": None,
    "control": None,
    "design": None,
    "geometry": None,
    "io": None,
    "plotting": None,
    "scenes": None,
    "stability": None,
    "RESULTS": "_results",
    "sweep": "_sweep",
    "why": "_why",
    "Contact": "contact",
    "Contact3": "contact",
    "AbstractContour": "geometry",
    "Catenary": "geometry",
    "Circle": "geometry",
    "Ellipse": "geometry",
    "Line": "geometry",
    "NeuralCurvature": "geometry",
    "NeuralSupport": "geometry",
    "Parametric": "geometry",
    "Spline": "geometry",
    "SupportFunction": "geometry",
    "AbstractSurface": "geometry",
    "Ellipsoid": "geometry",
    "Plane": "geometry",
    "Sphere": "geometry",
    "Torus": "geometry",
    "fit_contour": "geometry",
    "CSM": "_motion",
    "Index1": "_motion",
    "Rosenbrock": "_integration",
    "Trajectory": "_integration",
    "close": "_closing",
    "energies": "_motion",
    "contact_geometry": "_analysis",
    "loci": "_analysis",
    "multipliers": "_motion",
    "pinch_balance": "_analysis",
    "press_balance": "_analysis",
    "residuals": "_motion",
    "roll": "_analysis",
    "simulate": "_integration",
    "vector_field": "_integration",
    "Finger": "_mechanics",
    "Finger3": "_mechanics",
    "FreeObject": "_mechanics",
    "FreeObject3": "_mechanics",
    "Grasp": "_mechanics",
    "Jaw": "_mechanics",
    "PivotedObject": "_mechanics",
    "Stage": "_mechanics",
    "State": "_mechanics",
    "Turning": "_mechanics",
    "equation_terms": "_motion",
}
__all__ = [  # noqa: PLE0604
    "CSM",
    "RESULTS",
    "AbstractContour",
    "AbstractSurface",
    "Catenary",
    "Circle",
    "Contact",
    "Contact3",
    "Ellipse",
    "Ellipsoid",
    "Finger",
    "Finger3",
    "FreeObject",
    "FreeObject3",
    "Grasp",
    "Index1",
    "Jaw",
    "Line",
    "NeuralCurvature",
    "NeuralSupport",
    "Parametric",
    "PivotedObject",
    "Plane",
    "Rosenbrock",
    "Sphere",
    "Spline",
    "Stage",
    "State",
    "SupportFunction",
    "Torus",
    "Trajectory",
    "Turning",
    "close",
    "contact",
    "contact_geometry",
    "control",
    "design",
    "energies",
    "equation_terms",
    "fit_contour",
    "geometry",
    "io",
    "loci",
    "multipliers",
    "pinch_balance",
    "plotting",
    "press_balance",
    "residuals",
    "roll",
    "scenes",
    "simulate",
    "stability",
    "sweep",
    "vector_field",
    "why",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = _HOMES[name]
    value = importlib.import_module(f".{home or name}", __name__)
    if home is not None:
        value = getattr(value, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
