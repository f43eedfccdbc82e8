"""The structures of the stress test: at most fifty programs, of which every lane differs in its numbers."""

from typing import Any

import diffrax

import jaxroll as jxr
from benchmarks.stress_test.planar_scenes import Structure
from benchmarks.stress_test.spatial_scenes import Spatial

_TWO, _THREE = ((0, 0), (1, 0)), ((0, 0), (1, 0), (2, 0))
_FLAT: dict[str, Any] = {"control": "none", "gravity": True}
_HELD: dict[str, Any] = {"free": False, "control": "press"}
_SERVO: dict[str, Any] = {"control": "servo"}
_PIVOT: dict[str, Any] = {"free": False, "control": "servo"}

# Scenes with nothing against them but the spread of their numbers.
_RANDOM = (
    Structure("pinch-circle", ("circle",), ("circle", "circle"), (2, 2), touch=_TWO),
    Structure("pinch-ellipse", ("ellipse",), ("ellipse", "circle"), (2, 3), touch=_TWO, twist="limits"),
    Structure("pinch-faces", ("line", "line"), ("catenary", "catenary"), (3, 2), friction=True, gravity=True),
    Structure("pinch-four", ("ellipse",), ("circle", "circle"), (4, 4), touch=_TWO),
    Structure("pinch-one", ("circle",), ("circle", "circle"), (1, 1), touch=_TWO, friction=True),
    Structure("pinch-support", ("support",), ("support", "support"), (2, 2), touch=_TWO, friction=True),
    Structure("pinch-spline", ("spline",), ("circle", "circle"), (2, 2), touch=_TWO, friction=True, chunks=3),
    Structure("pinch-network", ("neural_support",), ("circle", "circle"), (2, 2), touch=_TWO, chunks=3),
    Structure("pinch-curvature", ("neural_curvature",), ("circle", "circle"), (2, 2), touch=_TWO, chunks=3),
    Structure(
        "pinch-servo", ("ellipse",), ("catenary", "circle"), (2, 2), touch=_TWO, gravity=True, **_SERVO
    ),
    Structure("ring-circle", ("circle",), ("circle", "circle", "circle"), (2, 2, 2), touch=_THREE),
    Structure(
        "ring-support", ("support",), ("circle", "ellipse", "circle"), (2, 2, 2), touch=_THREE, friction=True
    ),
    Structure(
        "ring-mixed",
        ("ellipse",),
        ("circle", "line", "catenary"),
        (2, "jaw1", "jaw2"),
        touch=_THREE,
        friction=True,
        gravity=True,
        **_SERVO,
    ),
    Structure("pivot-catenary", ("catenary",), ("catenary",), (2,), chunks=7, **_HELD),
    Structure("pivot-circle", ("circle",), ("circle",), (2,), gravity=True, friction=True, chunks=7, **_HELD),
    Structure("pivot-ellipse", ("ellipse",), ("circle",), (4,), twist="limits", **_PIVOT),
    Structure("pivot-support", ("support",), ("ellipse",), (3,), gravity=True, friction=True, **_PIVOT),
    Structure("pivot-spline", ("spline",), ("spline",), (2,), friction=True, chunks=3, **_HELD),
    Structure(
        "pivot-network", ("neural_support",), ("neural_support",), (2,), friction=True, chunks=3, **_HELD
    ),
    Structure("pivot-curvature", ("neural_curvature",), ("circle",), (3,), chunks=3, **_PIVOT),
    Structure("pivot-two", ("ellipse",), ("circle", "circle"), (2, 2), touch=_TWO, friction=True, **_PIVOT),
    Structure("pivot-three", ("circle",), ("circle", "line", "circle"), (2, 3, 2), touch=_THREE, **_HELD),
    Structure("roll-ellipse", ("ellipse",), ("line",), ("jaw0",), chunks=7, **_FLAT),
    Structure("roll-support", ("support",), ("line",), ("jaw0",), friction=True, **_FLAT),
    Structure("roll-spline", ("spline",), ("circle",), ("jaw0",), friction=True, chunks=3, **_FLAT),
    Structure("roll-bowl", ("circle",), ("bowl",), ("jaw0",), **_FLAT),
    Structure("roll-board", ("line",), ("catenary",), ("jaw0",), friction=True, **_FLAT),
    Structure(
        "jaws-circle", ("circle",), ("line", "line"), ("jaw2", "jaw0"), touch=_TWO, friction=True, **_SERVO
    ),
    Structure(
        "jaws-ellipse", ("ellipse",), ("line", "line"), ("jaw2", "jaw2"), touch=_TWO, gravity=True, **_SERVO
    ),
    Structure("jaw-one", ("ellipse",), ("circle",), ("jaw1",), gravity=True, **_PIVOT),
    Structure("tsit5", ("ellipse",), ("circle",), (2,), options={"solver": diffrax.Tsit5()}, **_HELD),
    Structure(
        "rosenbrock",
        ("circle",),
        ("circle", "circle"),
        (2, 2),
        touch=_TWO,
        chunks=3,
        options={"solver": jxr.Rosenbrock()},
    ),
)

# Scenes made for a purpose.
_HARD = (
    Structure("cancel", ("bowl",), ("circle",), (3,), friction=True, twist="cancel", chunks=7, **_PIVOT),
    Structure("cancel-free", ("bowl",), ("circle",), ("jaw2",), twist="cancel", chunks=7, **_SERVO),
    Structure("straight", ("circle",), ("circle",), (3,), twist="straight", **_HELD),
    Structure("straight-pinch", ("circle",), ("circle", "circle"), (3, 2), touch=_TWO, twist="straight"),
    Structure("ends", ("catenary",), ("circle",), (2,), twist="ends", **_HELD),
    Structure("ends-faces", ("line", "line"), ("circle", "circle"), (2, 2), twist="ends"),
    Structure("graze-lift", ("ellipse",), ("line",), ("jaw0",), twist="graze", chunks=7, **_FLAT),
    Structure(
        "graze-slip", ("circle",), ("line",), ("jaw0",), friction=True, twist="graze", chunks=7, **_FLAT
    ),
    Structure("tolerance", ("catenary",), ("circle",), (2,), twist="tolerance", **_PIVOT),
    Structure("tolerance-pinch", ("ellipse",), ("circle", "circle"), (2, 2), touch=_TWO, twist="tolerance"),
    Structure("single", ("circle",), ("catenary",), (2,), twist="single", **_HELD),
    Structure(
        "long",
        ("catenary",),
        ("circle",),
        (2,),
        twist="long",
        lanes=16,
        chunks=1,
        options={"max_steps": 4_000_000},
        **_HELD,
    ),
)

# Scenes in space: few, since their programs take long to compile.
_SPACE = (
    Spatial("egg-table", ("ellipsoid",), ("plane",), (0,), chunks=4),
    Spatial("ball-turntable", ("sphere",), ("plane",), (-1,), friction=True, chunks=4),
    Spatial("ball-bore", ("sphere",), ("cylinder",), (0,), hollow=True, spin="prevented", chunks=4),
    Spatial("wheel", ("torus",), ("sphere",), (0,), friction=True, chunks=4),
    Spatial("pinch-space", ("ellipsoid",), ("sphere", "ellipsoid"), (3, 2), chunks=2),
    Spatial(
        "pinch-spinless",
        ("ellipsoid",),
        ("sphere", "sphere"),
        (3, 3),
        spin="prevented",
        friction=True,
        chunks=2,
    ),
)

STRUCTURES = {structure.name: structure for structure in (*_RANDOM, *_HARD, *_SPACE)}
