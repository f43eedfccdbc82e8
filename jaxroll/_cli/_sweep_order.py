"""What `jaxroll sweep` and `jaxroll map` are asked for: options, a file in TOML, sentences where these fail.

A range is written LOW:HIGH, with a number of values for a grid (LOW:HIGH:64), and `:log` at its end where
steps are even in the logarithm; V1,V2,V3 are values one by one, a single number stays as it is. JAX is not
imported here, so that complaints come at once; `_sweep_command` does the work.
"""

import argparse
import math
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

SAMPLINGS = ("grid", "sobol", "latin", "adaptive")
SCENES = (
    "pivoted", "pinch", "ball_plate", "pinch_ellipse", "ring", "roller", "pinch3d", "turntable", "tube",
    "incline", "wheel", "rattleback", "tripod",
)  # fmt: skip
_KEEP = ("result", "t_end", "settling_time")
_SWEEP = (
    "Simulate a scene for many values of its parameters, on a grid or at samples, and write a table of what "
    "is kept of each run. A sweep that was cut off goes on where it was, but for adaptive ones."
)
_MAP = "Draw what a sweep kept over two of its parameters, as a picture and as a page for a browser."
_SET = (
    "a parameter's values: LOW:HIGH, LOW:HIGH:COUNT, either with :log, V1,V2,..., or one number. NAME is an "
    "argument of the scene, a field of its grasp, controller or object, or tip_radius, of round fingertips. "
    "Unlike lengths of other commands, values are in SI units: m, kg, s, N, rad"
)
# What a file may say, and of which kind each entry is.
_FILE: dict[str, type] = {
    "scene": str, "out": str, "sampling": str, "number": int, "times": int, "chunk": int, "seed": int,
    "seconds": float, "rtol": float, "keep": list, "set": dict, "store": str, "workers": int,
}  # fmt: skip
# The least and the largest that a number may be, on the command line and in a file.
_ENDS = {
    "number": (1, 1e9), "times": (3, 1e5), "chunk": (1, 1e6), "seed": (0, 2**31), "seconds": (1e-6, 1e6),
    "rtol": (1e-13, 1e-2), "workers": (1, 1024),
}  # fmt: skip
# Units of parameters that the scenes have.
_KINDS = {
    "damping": "N m s",
    "beta": "N/m",
    "stiffness": "N/m",
    "alpha": "N m/rad",
    "force": "N",
    "mass": "kg",
    "inertia": "kg m^2",
    "gravity": "m/s^2",
    "pivot": "m",
}
_LENGTHS = (
    "tip_radius",
    "radius",
    "a",
    "b",
    "s",
    "base",
    "travel",
    "bore",
    "tube",
    "position",
    "axes",
    "lowered",
)
_KINDS |= dict.fromkeys(_LENGTHS, "m") | dict.fromkeys(("climb", "velocity"), "m/s") | {"period": "s"}
_KINDS |= dict.fromkeys(("slope", "tilt", "skew", "inclination"), "rad")
_KINDS |= dict.fromkeys(("rate", "spin", "precession"), "rad/s")


class Range(NamedTuple):
    """Values of one parameter.

    Attributes:
        low: The least.
        high: The largest.
        count: How many along a grid; None where that is not said.
        log: Whether steps are even in the logarithm.
        values: Values one by one; where there are any, the other attributes have no meaning.
    """

    low: float = 0.0
    high: float = 0.0
    count: int | None = None
    log: bool = False
    values: tuple[Any, ...] = ()


@dataclass(frozen=True)
class SweepOrder:
    """What to sweep.

    Attributes:
        scene: Name of a scene, or FILE.py:FUNCTION.
        ranges: By name of the parameter.
        number: How many runs, where the ranges do not say; None: 1024.
        sampling: One of `SAMPLINGS`.
        keep: Names of measures.
        seconds: Time to simulate [s].
        times: How many states are saved for measures that look at them.
        rtol: Relative tolerance.
        chunk: Runs per program call.
        seed: Of the samples.
        out: Folder to write to.
        store: A store of Zarr to fill, in the place of that folder; None: a table in the folder.
        workers: Processes that compute; None: this one.
    """

    scene: str
    ranges: dict[str, Range]
    number: int | None = None
    sampling: str = "grid"
    keep: tuple[str, ...] = _KEEP
    seconds: float = 1.0
    times: int = 101
    rtol: float = 1e-6
    chunk: int = 512
    seed: int = 0
    out: str = "jaxroll-sweep"
    store: str | None = None
    workers: int | None = None


@dataclass(frozen=True)
class MapOrder:
    """What to draw.

    Attributes:
        store: Folder or store of a sweep.
        show: What is shown, one name or NAME.PART; None: the result, or the first value.
        x: Along the lower side; None: the first that changes.
        y: Along the left side; None: the next one.
        at: Where others are held, by name.
        out: Folder to write to.
    """

    store: str
    show: str | None
    x: str | None
    y: str | None
    at: dict[str, float]
    out: str


def sweep_parser(commands: Any, number: Callable[..., Any]) -> None:
    """Add `jaxroll sweep` and `jaxroll map`; `number(low, high, kind)` makes a converter of text."""
    sweep = commands.add_parser("sweep", help=_SWEEP, description=_SWEEP)
    told = (
        f"{', '.join(SCENES)}, or FILE.py:FUNCTION, a function of the parameters by name that returns a grasp"
    )
    told += " and a state"
    sweep.add_argument("scene", nargs="?", metavar="SCENE", help=told)
    sweep.add_argument("--set", action="append", metavar="NAME=VALUES", default=[], help=_SET)
    about = "the same in TOML: scene, number, ... and a table [set]"
    sweep.add_argument("--file", metavar="FILE", help=about)
    numbers = {
        "number": "runs in all where ranges have no COUNT; on a grid the nearest there is (default: 1024)",
        "seconds": "time to simulate (default: 1)",
        "times": "states saved for measures that look at them (default: 101)",
        "rtol": "relative tolerance of the solver (default: 1e-6)",
        "chunk": "runs per program call (default: 512)",
        "seed": "of samples (default: 0)",
        "workers": "processes that compute, by dask (default: none but this one)",
    }
    for name, about in numbers.items():
        sweep.add_argument(f"--{name}", metavar="N", type=number(*_ENDS[name], _FILE[name]), help=about)
    about = "product of the ranges (default), samples of them, or a grid that is run near changes only"
    sweep.add_argument("--sampling", choices=SAMPLINGS, help=about)
    kept = "measures of each run, see `jaxroll.measures` (default: result t_end settling_time)"
    sweep.add_argument("--keep", nargs="+", metavar="MEASURE", help=kept)
    sweep.add_argument("--out", metavar="FOLDER", help="where to write (default: jaxroll-sweep)")
    about = "a table of Zarr to fill chunk by chunk, which xarray opens; --out is not used then"
    sweep.add_argument("--store", metavar="FOLDER", help=about)
    _map_parser(commands)


def _map_parser(commands: Any) -> None:
    drawn = commands.add_parser("map", help=_MAP, description=_MAP)
    drawn.add_argument("store", metavar="STORE", help="the folder or the store of a sweep")
    drawn.add_argument("--show", metavar="MEASURE", help="which (default: result, or the first)")
    drawn.add_argument("-x", metavar="NAME", help="along the lower side (default: the first that changes)")
    drawn.add_argument("-y", metavar="NAME", help="along the left side (default: the next one)")
    held = "of a grid, where another parameter is held (default: in the middle)"
    drawn.add_argument("--at", action="append", metavar="NAME=VALUE", default=[], help=held)
    drawn.add_argument("--out", metavar="FOLDER", help="where to write (default: STORE; of Zarr, beside it)")


def unit_of(name: str) -> str:
    """The unit of a parameter that the scenes have; empty where none is known."""
    return _KINDS.get(name, "")


def sweep_order(options: argparse.Namespace) -> SweepOrder:
    """The order that the command line and its file give; where both say something the command line counts.

    Raises:
        ValueError: If something in it does not fit.
    """
    given = {} if options.file is None else _read(options.file)
    ranges = {name: _range(name, value) for name, value in given.pop("set", {}).items()}
    ranges |= {name: _range(name, value) for name, value in _pairs("--set", options.set).items()}
    named = {name: value for name, value in vars(options).items() if value is not None}
    given |= {name: value for name, value in named.items() if name in SweepOrder.__dataclass_fields__}
    given |= {"keep": tuple(given["keep"])} if "keep" in given else {}
    if "scene" not in given:
        raise ValueError("argument SCENE must be given, on the command line or as `scene` in the file")
    _check_scene(given["scene"])
    if not ranges:
        raise ValueError("argument --set must be given for one parameter or more, or [set] in the file")
    order = SweepOrder(ranges=ranges, **given)
    _check_sampling(order)
    return order


def map_order(options: argparse.Namespace) -> MapOrder:
    """The order of a map.

    Raises:
        ValueError: If there is no such folder, or a place to hold a parameter at is no number.
    """
    if not Path(options.store).is_dir():
        raise ValueError(
            f"argument STORE must name the folder of a sweep, but there is none called {options.store!r}"
        )
    at = {name: _number("--at", name, text) for name, text in _pairs("--at", options.at).items()}
    # Nothing but its arrays belongs into a store of Zarr.
    store = Path(options.store).absolute()
    beside = store.parent if (store / "zarr.json").is_file() else store
    out = str(beside) if options.out is None else options.out
    return MapOrder(options.store, options.show, options.x, options.y, at, out)


def _pair(option: str, text: str) -> tuple[str, str]:
    name, mark, value = text.partition("=")
    if not (mark and name.isidentifier() and value):
        raise ValueError(f"argument {option} must be NAME=VALUES, but was {text!r}")
    return name, value


def _pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    """Names and values of an option that is given once for each name."""
    found: dict[str, str] = {}
    for name, value in (_pair(option, text) for text in texts):
        if name in found:
            raise ValueError(f"argument {option} must be given once for {name}, but was for {value} too")
        found[name] = value
    return found


def _number(option: str, name: str, value: Any) -> float:
    """A finite number, of text or of TOML."""
    try:
        if isinstance(value, bool):
            raise ValueError
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"argument {option} must give {name} finite numbers, but one was {value!r}")
    return number


def _range(name: str, value: Any) -> Range:
    """Values of a parameter from text, or from a number or a list in TOML."""
    if not name.isidentifier():
        raise ValueError(f"argument --set must name parameters as Python does, but one was {name!r}")
    if isinstance(value, list) and value:
        return Range(values=tuple(_entry(name, each) for each in value))
    if not isinstance(value, str):
        return Range(values=(_number("--set", name, value),))
    if ":" not in value:
        return Range(values=tuple(_number("--set", name, each) for each in value.split(",")))
    *ends, last = value.split(":")
    log = last == "log"
    ends = ends if log else [*ends, last]
    if len(ends) not in (2, 3):
        raise ValueError(f"argument --set must give {name} as LOW:HIGH or LOW:HIGH:COUNT, but was {value!r}")
    low, high = (_number("--set", name, each) for each in ends[:2])
    count = _count(name, ends[2]) if len(ends) == 3 else None
    if not low < high or log and low <= 0.0:
        above = " above zero" if log else ""
        raise ValueError(f"argument --set must give {name} a range that goes up{above}, but was {value!r}")
    return Range(low, high, count, log)


def _entry(name: str, value: Any) -> Any:
    """One value of a list in TOML: a number, or a list of numbers for a parameter of several."""
    if isinstance(value, list) and value:
        return tuple(_number("--set", name, each) for each in value)
    return _number("--set", name, value)


def _count(name: str, text: str) -> int:
    if not (text.isdecimal() and 2 <= int(text) <= 10**6):
        raise ValueError(f"argument --set must give {name} a COUNT from 2 to 1000000, but was {text!r}")
    return int(text)


def _check_scene(scene: Any) -> None:
    """Raise unless a scene is known, or is a function in a file that is there."""
    file, mark, function = str(scene).rpartition(":")
    if scene in SCENES or mark and Path(file).is_file() and file.endswith(".py") and function.isidentifier():
        return
    raise ValueError(
        f"argument SCENE must be one of {', '.join(SCENES)}, or FILE.py:FUNCTION of a file that is there, "
        f"but was {scene!r}"
    )


def _check_sampling(order: SweepOrder) -> None:
    """Raise where ranges and sampling do not fit each other."""
    ranges = {name: each for name, each in order.ranges.items() if not each.values}
    if order.sampling == "adaptive" and (order.store or order.workers):
        name = "store" if order.store else "workers"
        raise ValueError(
            f"argument --{name} must be left out with --sampling adaptive, whose rounds follow from each "
            f"other, but was {getattr(order, name)!r}"
        )
    if order.sampling == "adaptive" and not {"result", "first_event"} & set(order.keep):
        raise ValueError(
            "argument --keep must have result or first_event with --sampling adaptive, which refines where a "
            f"code changes, but was {' '.join(order.keep)}"
        )
    if order.sampling in ("sobol", "latin"):
        counted = [name for name, each in ranges.items() if each.count is not None]
        if counted or not ranges:
            what = f"{counted[0]} has a COUNT" if counted else "there is none"
            raise ValueError(
                f"argument --set must give ranges LOW:HIGH to --sampling {order.sampling}, but {what}"
            )
    elif order.number is not None and all(each.count is not None for each in ranges.values()):
        raise ValueError("argument --number must be left out where every range has a COUNT, but was given")


def _read(path: str) -> dict[str, Any]:
    """What a file says, every entry of the kind that it must be."""
    try:
        with open(path, "rb") as file:
            given = tomllib.load(file)
    except OSError as error:
        raise ValueError(
            f"argument --file must name a file that can be read, but {path!r}: {error.strerror}"
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(
            f"argument --file must be in TOML, but {path!r}: {' '.join(str(error).split())}"
        ) from None
    for name, value in given.items():
        kind = _FILE.get(name)
        if kind is None:
            raise ValueError(f"argument --file must hold {', '.join(_FILE)}, but {path!r} has {name!r}")
        if not _fits(name, kind, value):
            raise ValueError(
                f"argument --file must give a {name} as on the command line, but {path!r} has {value!r}"
            )
    return given


def _fits(name: str, kind: type, value: Any) -> bool:
    """Whether an entry of a file is what its option takes."""
    if isinstance(value, bool) or not isinstance(value, (int, float) if kind is float else kind):
        return False
    if name in _ENDS:
        low, high = _ENDS[name]
        return low <= value <= high
    if name == "keep":
        return bool(value) and all(isinstance(each, str) for each in value)
    return name != "sampling" or value in SAMPLINGS
