"""What `jaxroll sweep` and `jaxroll map` do: parameters from ranges, runs of a scene, a table, a picture.

A name that `--set` gives is looked for in the scene: among the numbers of its controller, then among the
arguments of the function that builds it, and then among the fields of grasp and object. What is an argument
builds the scene anew for every run, its contacts closed again; a number of the controller leaves the start as
it is.
"""

import contextlib
import importlib.util
import inspect
import math
import sys
import time
import types
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .. import plotting, scenes
from .._integration import flag_words, simulate
from .._maps import adaptive_map, measures, MEASURES_KEPT
from .._printing import is_code, shown_value
from .._results import as_length, computed_at_once, missing_library
from .._sweep import Parameters, sweep
from ..geometry import Circle, Sphere
from ._sweep_order import MapOrder, Range, SweepOrder, unit_of
from ._sweep_table import entries_of, flat_values, read_table, SweepTable, write_table
from ._waiting import say

_RUNS = 1024
_TIP = "tip_radius"
# The most runs per program call of an adaptive map: each round fills its last chunk with repeated runs.
_CHUNK = 128
Timed = Callable[[str], AbstractContextManager]


def swept(asked: SweepOrder, folder: Path, timed: Timed) -> list[str]:
    """Sweep into `folder`, which is the store where one is asked for, and return the lines of the report."""
    keep = measures(*asked.keep)
    make, parameters = maker(asked.scene, tuple(asked.ranges)), parameters_of(asked)
    if ":" not in asked.scene:
        _check_ends(make, parameters)
    options = {"ts": asked.times if keep.timed else 1, "rtol": asked.rtol, "record": keep.record}
    # On a line of its own, for the bar of progress takes the next one.
    over = ", ".join(_with_unit(name) for name in parameters.names)
    say(f"Sweeping {asked.scene} over {over} ...")
    start, done = time.perf_counter(), parameters.rows
    if asked.sampling == "adaptive":

        def outcome(p: Parameters) -> Any:
            kept = keep(simulate(*make(p), asked.seconds, throw=False, **options))
            # A whole number is a code to the map, and counts of steps change everywhere.
            return kept | {name: kept[name].astype(float) for name in ("steps",) if name in kept}

        found = adaptive_map(outcome, parameters, chunk=min(asked.chunk, _CHUNK), progress=True)
        flat = lambda x: x.reshape(parameters.rows, *x.shape[len(parameters.shape) :])  # noqa: E731
        values, done = jax.tree.map(flat, found.values) | {"ran": found.ran.ravel()}, found.runs
    else:
        place = {"store": folder} if asked.store else {"resume": folder / "chunks"}
        with _workers(asked.workers) as client:
            runs = {"chunk": asked.chunk, "progress": True, "client": client} | place
            values = sweep(make, parameters, asked.seconds, keep=keep, **runs, **options)
    took = time.perf_counter() - start
    pace = f"  {done} runs of {asked.seconds:g} s in {took:.3g} s, compilation included"
    if asked.store:
        said = [f"Table in {folder}, for xarray and for `jaxroll map {folder}`"]
        values = read_table(folder).values
    else:
        with timed("Writing the table"):
            names = write_table(folder, SweepTable(parameters, values, asked.scene))
        said = [f"Files in {folder}:", "  " + ", ".join(names)]
    return [f"Sweep of {asked.scene} over {over}", f"{parameters}", pace, *_told(values), *said]


def _check_ends(make: Callable[[Parameters], Any], parameters: Parameters) -> None:
    """Raise for a least or a greatest value that the scene refuses, where it is known and not traced.

    What a scene says of several of them together, or of a start that it cannot reach, is a run's to tell.
    """
    for k in sorted({k for name in parameters.names for k in _ends(parameters[name])}):
        try:
            make(parameters[k])
        except ValueError as error:
            if any(str(error).startswith(f"argument {name} must") for name in parameters.names):
                raise


def _ends(values: np.ndarray) -> tuple[int, ...]:
    """The rows of a parameter's least and greatest value; of one of several numbers none."""
    return (int(np.argmin(values)), int(np.argmax(values))) if np.ndim(values) == 1 else ()


def _with_unit(name: str) -> str:
    """A parameter's name with its unit, where it is known."""
    unit = unit_of(name)
    return f"{name} [{unit}]" if unit else name


@contextlib.contextmanager
def _workers(count: int | None) -> Iterator[Any]:
    """A client of so many processes of this machine, one core each; None for none."""
    if count is None:
        yield None
        return
    try:
        from dask.distributed import Client, LocalCluster
    except ImportError:
        raise missing_library("dask.distributed", "cluster") from None
    options: dict[str, Any] = {"dashboard_address": None}
    with LocalCluster(n_workers=count, threads_per_worker=1, **options) as cluster, Client(cluster) as client:
        yield client


def mapped(asked: MapOrder, folder: Path, timed: Timed) -> list[str]:
    """Draw a table over two of its parameters; returns the lines of the report."""
    table = read_table(Path(asked.store))
    columns = dict(flat_values(table.values))
    show = asked.show or ("result" if "result" in columns else next(iter(columns)))
    if show not in columns:
        raise ValueError(f"argument --show must be one of {', '.join(columns)}, but was {show!r}")
    kept = MEASURES_KEPT.get(show)
    look = {"x": asked.x, "y": asked.y, "at": asked.at, "label": kept.label if kept else show}
    names, missing = [f"map_{show}.png"], []
    with timed("Drawing"):
        figure = plotting.parameter_map(table.parameters, columns[show], title=table.scene, **look)
        figure.savefig(folder / names[0], dpi=150)
    try:
        with timed("Writing the page"):
            page = folder / f"map_{show}.html"
            plotting.map_page(table.parameters, columns[show], page, title=table.scene, **look)
            names.append(page.name)
    except ImportError as error:
        missing.append(f"  no page: {error}")
    return [
        f"{table.parameters}",
        *_told({show: columns[show]}),
        f"Files in {folder}:",
        "  " + ", ".join(names),
        *missing,
    ]


def parameters_of(asked: SweepOrder) -> Parameters:
    """The rows of an order: a product of its ranges, or samples with every combination of listed values."""
    listed = {name: each for name, each in asked.ranges.items() if each.values}
    free = {name: each for name, each in asked.ranges.items() if not each.values}
    if asked.sampling in ("sobol", "latin"):
        draw = Parameters.sobol if asked.sampling == "sobol" else Parameters.latin_hypercube
        ends = {name: (r.low, r.high, "log") if r.log else (r.low, r.high) for name, r in free.items()}
        found = draw(asked.number or _RUNS, seed=asked.seed, **ends)
        if listed:
            found = found * Parameters.grid(**{name: np.array(r.values) for name, r in listed.items()})
    else:
        count = _each(asked, free)
        found = Parameters.grid(**{name: _values(r, count) for name, r in asked.ranges.items()})
    return found.with_units(**{name: unit_of(name) for name in found.names})


def _each(asked: SweepOrder, free: dict[str, Range]) -> int:
    """How many values a range without a count has, for about as many runs as are asked for."""
    open_ranges = [r for r in free.values() if r.count is None]
    fixed = math.prod(len(r.values) or r.count or 1 for r in asked.ranges.values())
    if not open_ranges:
        return 0
    return max(2, round(((asked.number or _RUNS) / fixed) ** (1.0 / len(open_ranges))))


def _values(asked: Range, count: int) -> np.ndarray:
    if asked.values:
        return np.array(asked.values)
    even = np.geomspace if asked.log else np.linspace
    return even(asked.low, asked.high, asked.count or count)


def maker(scene: str, names: tuple[str, ...]) -> Callable[[Parameters], tuple[Any, Any]]:
    """From one row of parameters to a grasp and a state, by what the names are in the scene."""
    if ":" in scene:
        function = _from_file(scene)
        _check_taken(function, scene, names)
        return _known_where_it_can_be(function)
    build = getattr(scenes, scene)
    grasp, state = build()
    held = set(_fields(grasp.controller))
    arguments = {name for name in names if name in inspect.signature(build).parameters} - held
    changed = [name for name in names if name not in arguments and name != _TIP]
    _check_names(changed, build, grasp)
    tips = _tips(build, grasp) if _TIP in names else None

    def make(p: Parameters) -> tuple[Any, Any]:
        given = {name: p[name] for name in arguments}
        if tips is not None:
            given |= tips(p[_TIP])
        built, start = build(**given) if given else (grasp, state)
        return (
            built.with_(**{name: _held(built, name, p[name]) for name in changed}) if changed else built
        ), start

    return make


def _known_where_it_can_be(function: Callable) -> Callable[[Parameters], tuple[Any, Any]]:
    """A caller's own scene, in which JAX traces only what the parameters change."""

    def make(p: Parameters) -> tuple[Any, Any]:
        with computed_at_once():
            return function(**p)

    return make


def _check_taken(function: Callable, scene: str, names: tuple[str, ...]) -> None:
    """Refuse names that a caller's own scene does not take, and names without one that it needs."""
    given = inspect.signature(function)
    try:
        given.bind(**dict.fromkeys(names))
    except TypeError as error:
        taken = ", ".join(given.parameters) or "nothing"
        raise ValueError(f"argument --set must name what {scene} takes, {taken}, but {error}") from None


def _check_names(names: list[str], build: Callable, grasp: Any) -> None:
    """Refuse names that a scene does not have, and say which it has."""
    parts = (grasp, grasp.controller, grasp.object)
    fields = [(name, getattr(part, name)) for part in parts for name in _fields(part)]
    unknown = [name for name in names if name not in dict(fields)]
    if not unknown:
        return
    # Of the scene's arguments and of the fields those that are numbers.
    given = inspect.signature(build).parameters
    numbers = [name for name, each in given.items() if isinstance(each.default, (int, float, tuple))]
    numbers += [name for name, value in fields if isinstance(value, jax.Array)]
    tip = [_TIP] if {"tips", "tip"} & set(given) else []
    known = ", ".join(dict.fromkeys([*numbers, *tip]))
    raise ValueError(f"argument --set must name one of {known}, but was {unknown[0]}")


def _fields(part: Any) -> tuple[str, ...]:
    """The names of a part's fields."""
    return tuple(getattr(type(part), "__dataclass_fields__", {}))


def _held(grasp: Any, name: str, value: Any) -> Any:
    """A value for a field of a grasp: one number for all where the field has several."""
    old = getattr(grasp.controller, name, None)
    shape = getattr(old, "shape", ())
    return jnp.broadcast_to(value, shape) if jnp.ndim(value) == 0 and shape else value


def _tips(build: Callable, grasp: Any) -> Callable[[Any], dict[str, Any]]:
    """From a radius to the argument of a scene that makes fingertips round, their foremost points unmoved."""
    taken = inspect.signature(build).parameters
    name = next((each for each in ("tips", "tip") if each in taken), None)
    if name is None:
        able = [each for each in dir(scenes) if {"tips", "tip"} & set(_arguments(each))]
        raise ValueError(
            f"argument --set must give tip_radius to a scene that takes fingertips ({', '.join(able)}), but "
            f"was for {build.__name__}"
        )
    tip = grasp.fingers[0].tip
    if not hasattr(tip, "tangent_angle") and not hasattr(tip, "curve"):  # in space
        return lambda radius: {name: Sphere(as_length(_TIP, radius))}
    # How far the scene's own fingertip reaches in front of O_i, where it faces the object.
    ahead = float(np.dot(np.asarray(tip.point(0.0)), np.asarray(tip.normal(0.0))))

    def round_tip(radius: Any) -> dict[str, Any]:
        radius = as_length(_TIP, radius)
        return {name: Circle(radius).moved(jnp.stack([ahead - radius, jnp.zeros_like(radius)]))}

    return round_tip


def _arguments(name: str) -> tuple[str, ...]:
    thing = getattr(scenes, name)
    return tuple(inspect.signature(thing).parameters) if inspect.isfunction(thing) else ()


def _from_file(scene: str) -> Callable[..., Any]:
    """The function that FILE.py:FUNCTION names."""
    path, _, name = scene.rpartition(":")
    spec = importlib.util.spec_from_file_location(Path(path).stem, path)
    assert spec is not None and spec.loader is not None, path  # a file whose name ends in .py has both
    module = importlib.util.module_from_spec(spec)
    # What lies beside the file is found by its name, now and later, as where Python runs the file.
    sys.path.insert(0, str(Path(path).absolute().parent))
    try:
        with _known_by_name(module):
            spec.loader.exec_module(module)
    except Exception as error:  # whatever a caller's own file raises
        told = f"{type(error).__name__}: {error}"
        raise ValueError(f"argument SCENE must name a file that runs, but {path} raised {told}") from error
    function = getattr(module, name, None)
    if not callable(function):
        raise ValueError(
            f"argument SCENE must name a function in its file, but {path} has none called {name!r}"
        )
    return function


@contextlib.contextmanager
def _known_by_name(module: types.ModuleType) -> Iterator[None]:
    """Context in which a module is found by its name, as dataclasses need whose annotations are text.

    Afterwards it is not found: no other process would find it, and so its functions are sent whole to
        workers.
    """
    before = sys.modules.get(module.__name__)
    sys.modules[module.__name__] = module
    try:
        yield
    finally:
        sys.modules.pop(module.__name__, None)
        if before is not None:
            sys.modules[module.__name__] = before


def _told(values: Any) -> list[str]:
    """A line for each column: how often each code, or from where to where."""
    lines = []
    for name, column in flat_values(values):
        coded = is_code(column) or bool(flag_words(column))
        told = shown_value(np.asarray(column)) if not coded else ""
        if coded:
            told = ", ".join(f"{n} {code}" for code, n in Counter(entries_of(column)).most_common())
        lines.append(f"  {name:<20}{told}")
    return lines
