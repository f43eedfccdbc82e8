"""What hostile callers give: values by name, and which kinds of argument may take which of them.

A kind says what an argument means. A value that a kind does not list as sensible must be refused; one that it
lists may be refused or answered. Every value is made anew for each call, so that no call spoils another's.
"""

import dataclasses
import decimal
import fractions
import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxroll as jxr


class Thing:
    """An object of no use to anyone, whose `repr` fails."""

    def __repr__(self) -> str:
        raise RuntimeError("this object has no name")


def _numbers() -> Iterator[int]:
    yield 1
    yield 2


# Numbers of every size and sign; NaN and infinities are for no argument.
SIZES: dict[str, Callable[[], Any]] = {
    "one": lambda: 1,
    "minus three": lambda: -3,
    "half": lambda: 0.5,
    "minus one": lambda: -1.0,
    "zero": lambda: 0.0,
    "minus zero": lambda: -0.0,
    "whole zero": lambda: 0,
    "huge": lambda: 1e300,
    "tiny": lambda: 1e-300,
    "10^15": lambda: 10**15,
    "10^400": lambda: 10**400,
    "float32": lambda: np.float32(0.01),
    "int8": lambda: np.int8(1),
    "fraction": lambda: fractions.Fraction(1, 2),
    "decimal": lambda: decimal.Decimal("0.5"),
    "jax number": lambda: jnp.asarray(0.01),
}
NOT_NUMBERS: dict[str, Callable[[], Any]] = {
    "NaN": lambda: float("nan"),
    "infinity": lambda: float("inf"),
    "minus infinity": lambda: float("-inf"),
    "complex": lambda: 1 + 2j,
    "True": lambda: True,
    "False": lambda: False,
    "NumPy's True": lambda: np.True_,
    "None": lambda: None,
    "text": lambda: "wide",
    "number as text": lambda: "1.0",
    "no text": lambda: "",
    "a page of text": lambda: "one line\n" * 200,
    "bytes": lambda: b"1",
    "path": lambda: Path("nowhere"),
    "thing": Thing,
    "object": object,
    "class": lambda: float,
    "function": lambda: lambda *args, **options: args,
    "exception": lambda: ValueError("two\nlines"),
    "date": lambda: np.datetime64("2020-01-01"),
    "key": lambda: jax.random.key(0),
    "code": lambda: jxr.RESULTS.successful,
    "class of states": lambda: jxr.State,
    "iterator": _numbers,
    "dict": dict,
    "dict of numbers": lambda: {"a": 1.0},
    "set": lambda: {1.0},
    "ellipsis": lambda: ...,
    "slice": lambda: slice(0, 1),
}
ARRAYS: dict[str, Callable[[], Any]] = {
    "empty list": list,
    "empty tuple": tuple,
    "empty rows": lambda: np.zeros((0, 2)),
    "two numbers": lambda: (0.01, 0.02),
    "three numbers": lambda: [0.01, 0.02, 0.03],
    "seven numbers": lambda: np.linspace(0.1, 0.7, 7),
    "square": lambda: np.eye(3),
    "three axes": lambda: np.ones((2, 3, 4)),
    "whole numbers": lambda: np.array([1, 2]),
    "numbers of float32": lambda: np.array([0.01, 0.02], np.float32),
    "object numbers": lambda: np.array([1.0, 2.0], object),
}
NOT_ARRAYS: dict[str, Callable[[], Any]] = {
    "ragged": lambda: [[1.0, 2.0], [3.0]],
    "text among numbers": lambda: ["a", 1.0],
    "None among numbers": lambda: [None, 1.0],
    "flags": lambda: [True, False],
    "flag among numbers": lambda: (True, 0.02),
    "NaN among numbers": lambda: [float("nan"), 0.02],
    "infinity among numbers": lambda: np.array([0.01, np.inf]),
    "complex array": lambda: np.array([1 + 1j, 2.0]),
    "flag array": lambda: np.array([True, False]),
    "text array": lambda: np.array(["a", "b"]),
    "object array": lambda: np.array([None, 1.0], object),
    "masked array": lambda: np.ma.array([0.01, 0.02], mask=[False, True]),
    "dates": lambda: np.array(["2020-01-01", "2020-01-02"], "datetime64[D]"),
    "records": lambda: np.array([(1, 2.0)], [("a", int), ("b", float)]),
    "nested too deep": lambda: functools.reduce(lambda inner, _: [inner], range(80), 1.0),
}


@functools.cache
def planar() -> tuple[jxr.Grasp, jxr.State]:
    """The pivoted scene."""
    return jxr.scenes.pivoted()


@functools.cache
def spatial() -> tuple[jxr.Grasp, jxr.State]:
    """A ball on a slope."""
    return jxr.scenes.incline()


@functools.cache
def planar_run() -> jxr.Trajectory:
    """A short run of the pivoted scene, with all that may be recorded."""
    return jxr.simulate(*planar(), 0.02, ts=4, record=("multipliers", "energy"))


@functools.cache
def spatial_run() -> jxr.Trajectory:
    """A short run of the ball."""
    return jxr.simulate(*spatial(), 0.02, ts=4)


# Things of jaxroll itself, each where another is wanted.
PARTS: dict[str, Callable[[], Any]] = {
    "circle": lambda: jxr.Circle(0.01),
    "endless line": lambda: jxr.Line(),
    "sphere": lambda: jxr.Sphere(0.01),
    "endless plane": lambda: jxr.Plane(),
    "contact": lambda: jxr.Contact(),
    "contact in space": lambda: jxr.Contact3(),
    "finger": lambda: planar()[0].fingers[0],
    "object in the plane": lambda: planar()[0].object,
    "object in space": lambda: spatial()[0].object,
    "grasp in the plane": lambda: planar()[0],
    "grasp in space": lambda: spatial()[0],
    "state in the plane": lambda: planar()[1],
    "state in space": lambda: spatial()[1],
    "scene": planar,
    "run in the plane": planar_run,
    "run in space": spatial_run,
    "method": lambda: jxr.CSM(),
}


def _each_array(change: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda tree: jax.tree.map(lambda x: change(x) if eqx.is_inexact_array(x) else x, tree)


def _one_array(change: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Change the first floating array of a tree alone."""

    def changed(tree: Any) -> Any:
        leaves, form = jax.tree.flatten(tree)
        at = next(i for i, leaf in enumerate(leaves) if eqx.is_inexact_array(leaf))
        leaves[at] = change(leaves[at])
        return jax.tree.unflatten(form, leaves)

    return changed


def _longer(x: Any) -> Any:
    array = np.atleast_1d(np.asarray(x, float))
    return np.concatenate([array, array[..., -1:]], -1)


# The valid value itself, spoilt. Of an array or of numbers:
SPOILT: dict[str, Callable[[Any], Any]] = {
    "itself and NaN": lambda x: _with_first(x, np.nan),
    "itself and infinity": lambda x: _with_first(x, np.inf),
    "itself as text": str,
    "itself, complex": lambda x: np.asarray(x) + 0j,
    "itself, one axis more": lambda x: np.asarray(x, float)[None],
    "its last left out": lambda x: np.atleast_1d(np.asarray(x, float))[..., :-1],
    "its last twice": _longer,
    "itself as bits": lambda x: np.asarray(x, float).view(np.int64),
}
# Still the same, only written otherwise.
WRITTEN: dict[str, Callable[[Any], Any]] = {
    "itself": lambda x: x,
    "itself as a list": lambda x: np.asarray(x, float).tolist(),
    "itself of NumPy": lambda x: np.asarray(x, float),
    "itself of JAX": lambda x: jnp.asarray(x, float),
    "itself in float32": lambda x: np.asarray(x, np.float32),
}
# Of a grasp, a state or a run: trees of arrays.
TREES: dict[str, Callable[[Any], Any]] = {
    "NaN in it": _one_array(lambda x: jnp.full_like(x, jnp.nan)),
    "NaN in all of it": _each_array(lambda x: jnp.full_like(x, jnp.nan)),
    "one axis more": _one_array(lambda x: x[None]),
    "one axis more in all": _each_array(lambda x: x[None]),
    "text in it": _one_array(lambda x: "wide"),
    "None in it": _one_array(lambda x: None),
    "complex": _one_array(lambda x: x + 1j),
    "flags in it": _one_array(lambda x: x > 0),
    "a list in it": _one_array(lambda x: np.atleast_1d(x).tolist()),
    "longer": _one_array(lambda x: jnp.concatenate([jnp.atleast_1d(x)] * 2)),
    "empty": _one_array(lambda x: jnp.zeros((0,))),
}


def _with_first(x: Any, first: float) -> Any:
    array = np.array(x, float)
    array.flat[0] = first
    return array


def _sized(*more: str) -> frozenset[str]:
    return frozenset({*SIZES, "NumPy number", *more})


NEGATIVE = frozenset({"minus three", "minus one"})
ZERO = frozenset({"zero", "minus zero", "whole zero"})
WRITINGS = frozenset({*WRITTEN, "itself as bits"})
# Too large for a float.
_OVERFLOW = frozenset({"10^400"})
_REAL = frozenset(SIZES) - _OVERFLOW
_SHAPED = frozenset({"itself, one axis more", "its last twice", "its last left out"})


@dataclasses.dataclass(frozen=True)
class Kind:
    """What an argument means: which values are sensible there, and how it is spoilt."""

    sensible: frozenset[str]
    spoils: tuple[dict[str, Callable[[Any], Any]], ...] = ()


# Kinds whose values are numbers, which may come in the valid one's shape.
NUMERIC = ("array", "number", "positive", "not negative", "any array")
_COUNTED = frozenset({"one", "int8", "10^15"})
KINDS = {
    "number": Kind(_REAL | WRITINGS, (SPOILT, WRITTEN)),
    "positive": Kind(_REAL - NEGATIVE - ZERO | WRITINGS, (SPOILT, WRITTEN)),
    "not negative": Kind(_REAL - NEGATIVE | WRITINGS, (SPOILT, WRITTEN)),
    "array": Kind(WRITINGS, (SPOILT, WRITTEN)),
    "any array": Kind(
        _REAL
        | WRITINGS
        | frozenset(ARRAYS)
        | {"itself, one axis more", "its last twice", "its last left out"},
        (SPOILT, WRITTEN),
    ),
    "count": Kind(_COUNTED | {"itself"}, ({"itself": lambda x: x, "itself and a half": lambda x: x + 0.5},)),
    "flag": Kind(frozenset({"True", "False", "NumPy's True"})),
    "choice": Kind(frozenset({"itself"}), ({"itself": lambda x: x, "in capitals": lambda x: x.swapcase()},)),
    "text": Kind(frozenset({"text", "number as text", "no text", "a page of text"})),
    "path": Kind(frozenset({"itself"}), ({"itself": lambda x: x},)),
    "folder": Kind(
        frozenset({"itself", "text", "number as text", "path", "no text"}), ({"itself": lambda x: x},)
    ),
    "function": Kind(frozenset({"function", "class", "class of states"})),
    "anything": Kind(frozenset({*SIZES, *NOT_NUMBERS, *ARRAYS, *NOT_ARRAYS, *PARTS})),
    "contour": Kind(frozenset({"circle", "endless line"})),
    "contours": Kind(frozenset({"circle", "endless line"})),
    "surface": Kind(frozenset({"sphere", "endless plane"})),
    "object": Kind(frozenset({"object in the plane"})),
    "finger": Kind(frozenset({"finger"})),
    "contact": Kind(frozenset({"contact"})),
    "grasp": Kind(frozenset({"grasp in the plane"}), (TREES,)),
    "grasp in space": Kind(frozenset({"grasp in space"}), (TREES,)),
    "state": Kind(frozenset({"state in the plane"}), (TREES,)),
    "state in space": Kind(frozenset({"state in space"}), (TREES,)),
    # A run holds NaN where it did not come to a time.
    "run": Kind(frozenset({"run in the plane", "NaN in it", "NaN in all of it"}), (TREES,)),
    "run in space": Kind(frozenset({"run in space", "NaN in it", "NaN in all of it"}), (TREES,)),
    "part": Kind(frozenset()),
}
COMMON = {**SIZES, **NOT_NUMBERS, **ARRAYS, **NOT_ARRAYS, **PARTS}


def names_for(kind: str) -> list[str]:
    """Names of all values that an argument of this kind is tried with."""
    return [*COMMON, *(name for spoils in KINDS[kind].spoils for name in spoils)]


def made(kind: str, name: str, valid: Any) -> Any:
    """The value of this name; `valid` is the argument's own, to be spoilt."""
    for spoils in KINDS[kind].spoils:
        if name in spoils:
            return spoils[name](valid)
    return COMMON[name]()


def sensible(kind: str, name: str, value: Any, valid: Any) -> bool:
    """Whether an argument of this kind may take the value: numbers of the valid one's own shape may, too."""
    if name in KINDS[kind].sensible:
        return True
    if kind not in NUMERIC or name not in _REAL | frozenset(ARRAYS):
        return False
    return np.shape(value) == np.shape(valid) and (kind != "positive" or bool(np.all(np.asarray(value) > 0)))
