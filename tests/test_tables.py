"""Runs as tables: names, dimensions, units and labels of arrays, of records made by hand."""

from types import SimpleNamespace
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._integration._dataset import (
    about,
    dataset_of,
    flag_words,
    label_arrays,
    named_arrays,
)
from jaxroll._mechanics import Coordinate, Labels

OBJECT, JOINTS = (Coordinate("x", "m"), Coordinate("theta", "rad")), (Coordinate("q[0]", "rad"),)
BODIES = (("object", OBJECT), ("finger 0", JOINTS))
RATES = (("object", (Coordinate("x", "m/s"),)),)
LABELS = Labels(BODIES, ("left", "right"), (True, True), RATES, (Coordinate("contact 0", "m"),))


class Forces:
    """A record whose fields say what they are."""

    AXES: ClassVar = {"f": ("contact",), "lam": ("contact", "axis"), "spin": ("contact",)}
    UNITS: ClassVar = {"f": "N", "lam": "N"}

    def __init__(self, *lead):
        self.f, self.lam, self.spin = np.zeros((*lead, 2)), np.zeros((*lead, 2, 3)), None


class Whole:
    """What a run is: parts under names of their own, and times."""

    PARTS: ClassVar = {"forces": "", "blows": "impulse_", "code": "result", "none": "none_"}

    def __init__(self):
        self.ts, self.forces, self.blows = np.zeros((4, 5)), Forces(4, 5), Forces(4, 3)
        self.code, self.none = jxr.RESULTS.slipping, None
        codes = np.full(4, jxr.RESULTS.slipping._value)
        self.code = type(self.code)(codes, self.code._enumeration)


class Pair(NamedTuple):
    first: np.ndarray
    second: object


class Kept(eqx.Module):
    """What a caller keeps of a run, with no words of its own."""

    a: object
    b: object


def brief(arrays):
    return [(each.name, each.dims, each.attrs.get("units")) for each in arrays]


def test_every_array_of_a_run_has_its_name_dimensions_and_unit():
    found = named_arrays(Whole(), ("lane",), LABELS, 5)
    assert brief(found) == [
        ("ts", ("lane", "time"), "s"),
        ("f", ("lane", "time", "contact"), "N"),
        ("lam", ("lane", "time", "contact", "axis"), "N"),
        ("impulse_f", ("lane", "blow", "contact"), "N s"),
        ("impulse_lam", ("lane", "blow", "contact", "axis"), "N s"),
        ("result", ("lane",), None),
    ]
    words = {each.name: each.attrs.get("long_name") for each in found}
    assert words["f"] == "normal contact force" and words["impulse_f"] == "normal contact impulse"
    assert words["ts"] == "time" and words["result"] == "how the run ended"


def test_codes_are_numbers_with_their_names_and_one_for_what_is_missing():
    (code,) = named_arrays(jxr.RESULTS.slipping, ())
    assert code.name == "result" and code.dims == () and int(code.values) == jxr.RESULTS.slipping._value
    values, words = code.attrs["flag_values"], code.attrs["flag_meanings"].split()
    assert len(values) == len(words) and values[-1] == -1 and words[-1] == "not_stored"
    named = dict(zip(values, words, strict=True))
    assert named[int(jxr.RESULTS.slipping._value)] == "slipping" and named[0] == "successful"
    assert flag_words(SimpleNamespace(attrs=code.attrs)) == named
    assert flag_words(np.zeros(2)) == {} and flag_words(SimpleNamespace(attrs={})) == {}


def test_what_has_no_names_is_numbered_and_a_name_is_given_once():
    rows = np.zeros((4, 5))
    tree = {"a b/c": rows, "both": (rows, rows), "pair": Pair(rows, None), "f": Forces(4, 5)}
    found = named_arrays(tree, ("lane",), LABELS, 5)
    assert [each.name for each in found] == [
        "a_b_c",
        "both_0",
        "both_1",
        "pair_first",
        "f_f",
        "f_lam",
    ]
    assert len({each.name for each in found}) == len(found)
    assert [each.name for each in named_arrays((rows, rows), ("lane",), base="out")] == ["out_0", "out_1"]
    assert [each.name for each in named_arrays(rows, ("lane",), base="out")] == ["out"]
    assert [each.name for each in named_arrays(rows, ("lane",))] == ["kept"]
    kept = named_arrays(Kept(rows, {"x": rows, "y": [rows]}), ("lane",))
    assert [each.name for each in kept] == ["a", "b_x", "b_y_0"]
    assert [each.name for each in named_arrays({"end": jxr.RESULTS.slipping}, ())] == ["end"]
    taken = named_arrays({"time": rows, "lane": rows, "stored": rows}, ("lane",))
    assert [each.name for each in taken] == ["time_kept", "lane_kept", "stored_kept"]
    twice = named_arrays({"a b": rows, "a/b": rows, "a  b": rows}, ("lane",))
    assert [each.name for each in twice] == ["a_b", "a_b_2", "a_b_3"]


def test_a_dimension_of_another_size_has_a_name_of_its_own():
    class Rows:
        AXES: ClassVar = {"q": ("position",), "cross": ("position",) * 2, "n": ("number",), "m": ("number",)}

        def __init__(self, wide):
            self.q, self.cross = np.zeros((4, wide)), np.zeros((4, wide, wide))
            self.n, self.m = np.zeros((4, 2)), np.zeros((4, 7))

    assert brief(named_arrays(Rows(3), ("lane",), LABELS)) == [
        ("q", ("lane", "position"), None),
        ("cross", ("lane", "position", "cross_1"), None),
        ("n", ("lane", "number"), None),
        ("m", ("lane", "m_0"), None),
    ]
    assert brief(named_arrays(Rows(6), ("lane",), LABELS))[:2] == [
        ("q", ("lane", "q_0"), None),
        ("cross", ("lane", "cross_0", "cross_1"), None),
    ]
    assert brief(named_arrays(Forces(4, 9), ("lane",), LABELS, 5))[0] == (
        "f",
        ("lane", "f_0", "contact"),
        "N",
    )


def test_names_units_contacts_and_times_stand_along_the_dimensions_in_use():
    every = {"time", "axis", "position", "velocity", "place", "contact"}
    found = {each.name: (each.dims, each.values.tolist()) for each in label_arrays(LABELS, every, [0.0, 0.5])}
    assert found == {
        "time": (("time",), [0.0, 0.5]),
        "axis": (("axis",), ["x", "y", "z"]),
        "position": (("position",), ["object x", "object theta", "finger 0 q[0]"]),
        "position_unit": (("position",), ["m", "rad", "rad"]),
        "velocity": (("velocity",), ["object x"]),
        "velocity_unit": (("velocity",), ["m/s"]),
        "place": (("place",), ["contact 0"]),
        "place_unit": (("place",), ["m"]),
        "contact": (("contact",), [0, 1]),
        "contact_name": (("contact",), ["left", "right"]),
    }
    assert label_arrays(LABELS, every, [0.0])[0].attrs == {"units": "s", "long_name": "time"}
    assert [each.name for each in label_arrays(LABELS, {"place"}, [0.0])] == ["place", "place_unit"]
    assert [each.name for each in label_arrays(None, every, [0.0])] == ["time", "axis"]
    assert [each.name for each in label_arrays(LABELS, {"time", "axis"})] == ["axis"]
    bare = LABELS._replace(velocities=())
    assert "velocity" not in [each.name for each in label_arrays(bare, every)]


def test_a_table_says_its_versions_and_precision():
    told = about(np.float64)
    assert told["precision"] == "double" and about(np.float32)["precision"] == "single"
    assert told["source"] == f"jaxroll {jxr.__version__}" and told["jax_version"] == jax.__version__
    assert told["jaxroll_version"] == jxr.__version__


def test_tables_of_one_run_of_lanes_and_of_lanes_of_lanes(run):
    pytest.importorskip("xarray")
    one = run.to_xarray()
    assert one.q.dims == ("time", "position") and "ts" not in one and one.steps.dims == ()
    np.testing.assert_array_equal(one.time, run.ts)
    several = lambda x, n: np.broadcast_to(np.asarray(x), (*n, *np.shape(x)))  # noqa: E731
    lanes = dataset_of(jax.tree.map(lambda x: several(x, (2,)), run))
    assert lanes.q.dims == ("lane", "time", "position") and lanes.ended_by.dims == ("lane",)
    np.testing.assert_array_equal(lanes.time, run.ts)
    grid = jax.tree.map(lambda x: several(x, (2, 3)), run)
    table = dataset_of(grid)
    assert table.q.dims == ("lane_0", "lane_1", "time", "position") and "ts" not in table
    other = dataset_of(jax.tree.map(lambda x: np.stack([x, x + 1] if x is run.ts else [x, x]), run))
    assert other.ts.dims == ("lane", "time") and "time" not in other.coords
    with pytest.raises(ValueError, match="argument run must be known to be a table, but JAX is tracing it"):
        jax.eval_shape(dataset_of, run)
