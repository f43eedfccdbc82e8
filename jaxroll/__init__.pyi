"""What `jaxroll` exports, and where each name lives; `__init__.py` reads it, and so do type checkers."""

from . import (
    commands as commands,
    contact as contact,
    control as control,
    design as design,
    geometry as geometry,
    io as io,
    loads as loads,
    plotting as plotting,
    scenes as scenes,
    stability as stability,
)
from ._analysis import (
    contact_geometry as contact_geometry,
    link_clearance as link_clearance,
    loci as loci,
    pinch_balance as pinch_balance,
    press_balance as press_balance,
    roll as roll,
)
from ._closing import close as close
from ._identify import Identified as Identified, identify as identify
from ._integration import (
    resume as resume,
    Rosenbrock as Rosenbrock,
    simulate as simulate,
    strike as strike,
    Trajectory as Trajectory,
    vector_field as vector_field,
)
from ._maps import adaptive_map as adaptive_map, measures as measures
from ._mechanics import (
    Finger as Finger,
    Finger3 as Finger3,
    FreeObject as FreeObject,
    FreeObject3 as FreeObject3,
    Grasp as Grasp,
    Jaw as Jaw,
    PivotedObject as PivotedObject,
    Stage as Stage,
    State as State,
    Turning as Turning,
)
from ._motion import (
    accelerations as accelerations,
    CSM as CSM,
    energies as energies,
    equation_terms as equation_terms,
    Index1 as Index1,
    multipliers as multipliers,
    residuals as residuals,
    torques as torques,
    wrenches as wrenches,
)
from ._reaching import (
    grasp_points as grasp_points,
    GraspPoints as GraspPoints,
    Reach as Reach,
    reach as reach,
)
from ._results import RESULTS as RESULTS
from ._saving import load as load, save as save
from ._sweep import Parameters as Parameters, sweep as sweep
from ._why import why as why
from .contact import AbstractContact as AbstractContact, Contact as Contact, Contact3 as Contact3
from .geometry import (
    AbstractContour as AbstractContour,
    AbstractSurface as AbstractSurface,
    Catenary as Catenary,
    Circle as Circle,
    Ellipse as Ellipse,
    Ellipsoid as Ellipsoid,
    fit_contour as fit_contour,
    Line as Line,
    NeuralCurvature as NeuralCurvature,
    NeuralSupport as NeuralSupport,
    Parametric as Parametric,
    Plane as Plane,
    Sphere as Sphere,
    Spline as Spline,
    SupportFunction as SupportFunction,
    Torus as Torus,
)

__version__: str
