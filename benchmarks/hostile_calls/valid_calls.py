"""A valid call of every public name of jaxroll.

`calls()` walks over the public names and their signatures; a name, or a parameter, without an example raises.
"""

import dataclasses
import functools
import importlib
import inspect
from collections.abc import Callable
from types import ModuleType
from typing import Any

import jaxroll as jxr
from benchmarks.hostile_calls.arguments import Argument, EXCEPTIONS, PARAMETERS
from benchmarks.hostile_calls.values import planar

MODULES = ("commands", "contact", "control", "design", "geometry", "io", "loads", "plotting", "scenes")
MODULES += ("stability",)
# Of one file: what it imports is not its own.
_OF_ONE_FILE = ("commands", "loads")

# Not called by users at all, or not called with arguments.
ABSTRACT = {
    "AbstractContour",
    "AbstractSurface",
    "AbstractContact",
    "AbstractController",
    "AbstractGoal",
    "AbstractSchedule",
}
ABSTRACT |= {"AbstractShape", "AbstractSupport", "AbstractChart", "AbstractImplicit", "AbstractTabulated"}
ENUMERATIONS = {"RESULTS", "VERDICTS"}
# What functions return: plain records, which hold whatever they are given (JAX puts anything in a pytree).
RECORDS = {"State", "Trajectory", "LocalMinima", "Location", "SurfaceLocation", "SurfaceMinima", "Motion"}
RECORDS |= {
    "Touch",
    "Touch3",
    "Sensed",
    "Tip",
    "Design",
    "ArclengthTable",
    "Frenet2",
    "Fit",
    "FitReport",
    "Gauss3",
}
RECORDS |= {"Principal", "NetworkFit", "CleanPoints", "Jet", "SurfaceFit", "SurfaceReport", "Level", "Table"}
RECORDS |= {"Region", "Strike", "Vec2", "Vec3", "Sym3", "VectorField"}
RECORDS |= {"GraspPoints", "Identified", "MassProperties", "Reach", "Hand"}
# Arguments by any name, for which functions below stand.
RECORDS |= {"Parameters", "measures"}
RECORDS |= {"TableError", "Equilibrium", "PinchStatics", "Stability", "Pose", "Twist"}
# Written on scalars for use inside compiled programs, by other layers and by a caller's own shapes: nothing
# is checked there, for every check would be one more on the way of each run.
INNER = {"gap", "gap_bias", "gap_rate", "pfaffian", "rolling_rate", "tangency", "tangency3", "clearance"}
INNER |= {"clearance3", "law_of", "laws_of"}
INNER |= {"chains_apart", "links_apart", "links_clearance", "links_clearance3"}
INNER |= {"check_unit_speed", "sense", "joint_angles", "UserController", "as_controller", "frenet", "tabled"}
INNER |= {"approach", "principal", "jet", "differentiated", "level_frame", "spread_in_box", "from_frames"}
INNER |= {"tabulated", "check_contour", "check_shape", "check_surface", "UserLoad", "as_load", "total_wrench"}
INNER |= {"impulses", "as_it_is_resolved", "check_once_round", "keeps_contract", "unchecked"}
LEFT_OUT = ABSTRACT | ENUMERATIONS | RECORDS | INNER
# Calls that compile much, or draw.
_SLOW = set(
    [
        "accelerations",
        "adaptive_map",
        "animate",
        "assess",
        "ball_plate",
        "close",
        "contact_geometry",
        "design",
        "energies",
        "equation_terms",
        "equilibrium",
        "fit_contour",
        "fit_surface",
        "grasp_points",
        "locate",
        "locate_surfaces",
        "link_clearance",
        "identify",
        "loci",
        "multipliers",
        "optimise_fingertip",
        "page",
        "map_page",
        "parameter_map",
        "phase",
        "pinch",
        "pinch3d",
        "pinch_balance",
        "pinch_ellipse",
        "pinch_rest",
        "poses",
        "press_balance",
        "rattleback",
        "reach",
        "responses",
        "resume",
        "ring",
        "roll",
        "roller",
        "simulate",
        "strike",
        "sweep",
        "torques",
        "tripod",
        "wrenches",
        "tube",
        "turntable",
        "wheel",
    ]
)


@dataclasses.dataclass(frozen=True)
class Call:
    """A public function, its arguments, and which of them it cannot do without."""

    name: str
    function: Callable[..., Any]
    arguments: dict[str, Argument]
    needed: tuple[str, ...]
    slow: bool = False


def public() -> dict[str, Any]:
    """Every public name, with the module where two of them share one; what is left out is left out here."""
    found: dict[str, Any] = {}
    for place in ("", *MODULES):
        module = importlib.import_module(f"jaxroll.{place}" if place else "jaxroll")
        for name in _listed(module, place):
            thing = getattr(module, name)
            if isinstance(thing, ModuleType) or name in LEFT_OUT or any(thing is x for x in found.values()):
                continue
            found[f"{place}.{name}" if name in found else name] = thing
    return found


def _listed(module: ModuleType, place: str) -> list[str]:
    if not place or place in _OF_ONE_FILE:
        names = getattr(module, "__all__", None) or [
            name for name, x in vars(module).items() if getattr(x, "__module__", "") == module.__name__
        ]
    else:
        names = getattr(module, "__all__", None) or list(vars(module))
    mine = lambda x: getattr(x, "__module__", "").startswith("jaxroll")  # noqa: E731
    return [n for n in names if not n.startswith("_") and (not place or mine(getattr(module, n)))]


def with_tip(finger: Any, tip: Any) -> Any:
    """`Grasp.with_tip` of the pivoted scene."""
    return planar()[0].with_tip(finger, tip)


def with_contacts(contacts: Any) -> Any:
    """`Grasp.with_contacts` of the pivoted scene."""
    return planar()[0].with_contacts(contacts)


def with_(
    inertia: Any = 1e-5,
    pivot: Any = (0.0, 0.1),
    damping: Any = 0.01,
    gravity: Any = (0.0, 0.0),
    load: Any = None,
) -> Any:
    """`Grasp.with_` of the pivoted scene, one field each of its object, its controller and its own."""
    return planar()[0].with_(inertia=inertia, pivot=pivot, damping=damping, gravity=gravity, load=load)


def moved(offset: Any = (0.0, 0.0), angle: Any = 0.0, origin: Any = 0.0) -> Any:
    """`moved` of a contour."""
    return jxr.Circle(0.01).moved(offset, angle, origin=origin)


def on_contour(s: Any) -> Any:
    """What a contour says of a place on it."""
    shape = jxr.Circle(0.01)
    return shape.point(s), shape.tangent(s), shape.normal(s), shape.curvature(s)


def on_surface(at: Any) -> Any:
    """What a surface says of a place on it."""
    shape = jxr.Sphere(0.01)
    return shape.point(at), shape.normal(at), shape.principal_curvatures(at), shape.forms(at)


def near_surface(point: Any, guess: Any = None) -> Any:
    """`near` of a surface."""
    return jxr.Sphere(0.01).near(point, guess)


def with_payload(mass: Any, link: Any = None, at: Any = None, inertia: Any = 0.0) -> Any:
    """`Finger.with_payload` of the pivoted scene's finger."""
    return planar()[0].fingers[0].with_payload(mass, link=link, at=at, inertia=inertia)


def uniform_object(contour: Any, density: Any, thickness: Any = None) -> Any:
    """`FreeObject.uniform`."""
    return jxr.FreeObject.uniform(contour, density, thickness=thickness)


def uniform_solid(surface: Any, density: Any) -> Any:
    """`FreeObject3.uniform`."""
    return jxr.FreeObject3.uniform(surface, density)


def columns(damping: Any, force: Any) -> Any:
    """`Parameters` of two names."""
    return jxr.Parameters(damping=damping, force=force)


def sobol(count: Any, seed: Any = 0, beta: Any = (0.0, 1.0)) -> Any:
    """`Parameters.sobol` of one name."""
    return jxr.Parameters.sobol(count, seed=seed, beta=beta)


def measures(names: Any) -> Any:
    """`measures` of one name."""
    return jxr.measures(names)


# Methods that take a caller's arguments, and functions that take them by any name.
METHODS = (
    uniform_object,
    uniform_solid,
    columns,
    sobol,
    measures,
    with_payload,
    with_tip,
    with_contacts,
    with_,
    moved,
    on_contour,
    on_surface,
    near_surface,
)


@functools.cache
def calls() -> dict[str, Call]:
    """A valid call of every public name, and of the methods that take a caller's arguments.

    Raises:
        LookupError: If a name or a parameter has no example.
    """
    things = {**public(), **{method.__name__: method for method in METHODS}}
    return {name: _call(name, thing) for name, thing in things.items()}


def _call(name: str, thing: Callable[..., Any]) -> Call:
    own, needed = EXCEPTIONS.get(name, {}), []
    arguments: dict[str, Argument] = {}
    for parameter in inspect.signature(thing).parameters.values():
        if parameter.kind is parameter.VAR_KEYWORD:
            continue
        argument = own.get(parameter.name, PARAMETERS.get(parameter.name))
        if argument is None:
            raise LookupError(f"{name}: parameter {parameter.name} has no example in {__file__}")
        if parameter.default is None:
            argument = dataclasses.replace(argument, also=argument.also | {"None"})
        if parameter.default is parameter.empty:
            needed.append(parameter.name)
        arguments[parameter.name] = argument
    return Call(name, thing, arguments, tuple(needed), name.split(".")[-1] in _SLOW)
