"""Differentiable simulation of grasping under rolling contact, in JAX."""

from . import contact as contact, control as control, geometry as geometry, scenes as scenes
from ._results import RESULTS as RESULTS
from .contact import Contact as Contact
from .geometry import (
    AbstractContour as AbstractContour,
    Catenary as Catenary,
    Circle as Circle,
    Ellipse as Ellipse,
    Line as Line,
)
from .integration import (
    CSM as CSM,
    Index1 as Index1,
    Trajectory as Trajectory,
    close as close,
    energies as energies,
    multipliers as multipliers,
    press_balance as press_balance,
    residuals as residuals,
    simulate as simulate,
)
from .mechanics import (
    Finger as Finger,
    FreeObject as FreeObject,
    Grasp as Grasp,
    PivotedObject as PivotedObject,
    State as State,
    equation_terms as equation_terms,
)

__version__ = "0.1.0"


def __getattr__(name: str):
    # matplotlib is imported with the first figure, not with the package.
    if name == "plotting":
        import importlib

        return importlib.import_module(".plotting", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
