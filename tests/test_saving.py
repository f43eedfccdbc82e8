"""Files of grasps, states, runs, fits and designs: what is read is what was written."""

import dataclasses
import functools
import json
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll import _saving


@pytest.fixture(scope="module")
def run():
    """Part 2 of the chapter, with all that a run can keep."""
    grasp, state = jxr.scenes.pivoted()
    record = ("multipliers", "energy", "dense")
    return grasp, state, jxr.simulate(grasp, state, t1=0.1, ts=3, record=record)


@dataclasses.dataclass(frozen=True)
class Note:
    """A record of a caller's own."""

    text: str
    numbers: np.ndarray


class Wave(eqx.Module):
    """A law of a caller's own."""

    gain: jax.Array

    def __call__(self, t, q, v):
        return -self.gain * v


def own_law(t, q, v):
    return -0.01 * v


def assert_same(found, given):
    """The same structure, with arrays of the same class, dtype and bits."""
    assert jax.tree.structure(found) == jax.tree.structure(given)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(given), strict=True):
        assert type(one) is type(other)
        if not isinstance(other, jax.Array | np.ndarray | np.generic):
            assert one == other
        elif jnp.issubdtype(other.dtype, jax.dtypes.prng_key):
            assert_same(jax.random.key_data(one), jax.random.key_data(other))
        else:
            assert one.dtype == other.dtype
            assert np.asarray(one).tobytes() == np.asarray(other).tobytes()


def rewritten(path, change):
    """The same file with its structure changed."""
    with np.load(path) as archive:
        arrays = dict(archive)
    head = json.loads(arrays["structure"].tobytes())
    change(head)
    arrays["structure"] = np.frombuffer(json.dumps(head).encode(), np.uint8)
    np.savez(path, **arrays)
    return path


def test_a_run_is_read_as_it_was(run, tmp_path):
    found = jxr.load(jxr.save(tmp_path / "run", run))
    assert_same(found, run)
    assert str(found[2]) == str(run[2])
    assert found[2].labels == run[2].labels
    # Not a record only: it goes on, and answers between its steps.
    np.testing.assert_array_equal(found[2](0.05).q, run[2](0.05).q)
    again = jxr.simulate(found[0], found[1], t1=0.1, ts=3, record=("multipliers", "energy", "dense"))
    assert_same(again, run[2])


CONTOUR = jxr.Ellipse(0.02, 0.01)


@pytest.mark.parametrize(
    "value",
    [
        jxr.RESULTS.slipping,
        jax.vmap(lambda p: jxr.RESULTS.where(p, jxr.RESULTS.slipping, jxr.RESULTS.successful))(
            jnp.array([True, False])
        ),
        (1, 2.5, -0.0, float("inf"), None, "a", True, [np.float32(3.0), {"k": (1,), "2": []}]),
        {"nan": np.array([np.nan, -0.0]), "none": np.zeros((0, 3)), "int": np.arange(3, dtype=np.int8)},
        jnp.float32(0.1),
        jax.random.key(3),
        jxr.control.Press,
        np.dtype("float32"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_values_are_read_as_they_were(value, tmp_path):
    found = jxr.load(jxr.save(tmp_path / "value.npz", value))
    assert_same(found, value)
    assert str(found) == str(value)


def test_shapes_laws_and_spatial_grasps(tmp_path):
    law = jxr.control.Sampled(
        jxr.control.Press(1.0, 0.01, 0.01, target=[0.1, 0.2]), 0.01, angle_noise=1e-4, key=jax.random.key(1)
    )
    shapes = jxr.Spline(CONTOUR.point(np.linspace(0.0, 0.09, 12)), closed=True)
    value = (
        jxr.scenes.turntable(),
        law,
        shapes,
        jxr.commands.Steps([1.0], [0.0, 1.0]),
        jxr.Torus(0.02, 0.01),
    )
    assert_same(jxr.load(jxr.save(tmp_path / "value", value)), value)


def own_load(t, pose, twist, *, size=0.5):
    return size * pose.position, jnp.zeros(())


def own_motion(rate, t):
    return (0.1 * jnp.sin(rate * t), 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)


def test_a_grasps_own_functions_are_found_again(tmp_path):
    """Loads, motions and commands are kept as a function with its arguments, of which there may be some."""
    shaken = jxr.Stage(jxr.Plane(), jax.tree_util.Partial(own_motion, jnp.array(20.0)))
    loads = [own_load, functools.partial(own_load, size=0.25)]
    value = (jxr.scenes.pivoted()[0].with_(load=loads), shaken, jxr.commands.Declared(jnp.sin, [0.1]))
    path = jxr.save(tmp_path / "functions", value)
    found = jxr.load(path, own=[own_load, own_motion, jnp.sin])
    assert_same(found[1:], value[1:])
    at = jxr.loads.Pose(jnp.array([2.0, 4.0]), jnp.zeros(()))
    assert [load(0.0, at, None)[0].tolist() for load in found[0].load] == [[1.0, 2.0], [0.5, 1.0]]
    np.testing.assert_array_equal(found[1].motion_of(0.3)[0], value[1].motion_of(0.3)[0])
    with pytest.raises(ValueError, match=r"value\.motion_of\.func was <function"):
        jxr.save(path, jxr.Stage(jxr.Plane(), lambda t: own_motion(20.0, t)))


def test_an_array_that_stands_twice_is_written_once(tmp_path):
    array = jnp.arange(1000.0)
    path = jxr.save(tmp_path / "twice", [array, {"again": array}])
    first, second = jxr.load(path)
    assert first is second["again"]
    assert path.stat().st_size < 12_000


def test_what_is_a_callers_own_is_named_when_it_is_read(tmp_path):
    value = (Note("mine", np.arange(3.0)), Wave(jnp.array(0.1)), own_law)
    path = jxr.save(tmp_path / "own", value)
    found = jxr.load(path, own=[Note, Wave, own_law])
    assert found[0].text == "mine"
    np.testing.assert_array_equal(found[0].numbers, value[0].numbers)
    assert isinstance(found[1], Wave)
    assert found[2] is own_law
    with pytest.raises(ValueError, match="names Wave of .*, which argument own must hold"):
        jxr.load(path, own=[Note, own_law])


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ({"law": (1, lambda x: x)}, r"but value\['law'\]\[1\] was <function"),
        ([Note("x", np.array(["text"]))], r"value\[0\].numbers was ndarray of dtype <U4"),
        (object(), "value was <object"),
        (functools.wraps(own_law)(lambda *args: 0.0), "value was <function own_law"),
    ],
)
def test_what_cannot_be_written_is_said(value, says, tmp_path):
    with pytest.raises(ValueError, match=says):
        jxr.save(tmp_path / "bad", value)
    assert not list(tmp_path.iterdir())


def test_traced_values_cannot_be_written(tmp_path):
    with pytest.raises(ValueError, match="must be known when it is written"):
        jax.jit(lambda x: jxr.save(tmp_path / "x", [x]))(1.0)


def test_a_later_format_and_other_fields_are_said(tmp_path):
    def later(head):
        head["format"] = 99

    def more(head):
        head["tree"]["fields"]["twist"] = 1.0

    def fewer(head):
        del head["tree"]["fields"]["a"]

    path = lambda: jxr.save(tmp_path / "c", CONTOUR)  # noqa: E731
    with pytest.raises(
        ValueError, match="of format 1 or before, but c.npz, written by jaxroll .* has format"
    ):
        jxr.load(rewritten(path(), later))
    with pytest.raises(ValueError, match="fields of Ellipse .* holds 'twist', which it has not"):
        jxr.load(rewritten(path(), more))
    with pytest.raises(ValueError, match="lacks its 'a'"):
        jxr.load(rewritten(path(), fewer))


def test_a_field_that_is_new_takes_its_default(run, tmp_path):
    def older(head):
        del head["tree"]["fields"]["impulses"]

    found = jxr.load(rewritten(jxr.save(tmp_path / "run", run[2]), older))
    assert found.impulses is None
    assert_same(found.states, run[2].states)


def test_files_that_are_damaged_are_said(tmp_path, monkeypatch):
    path = jxr.save(tmp_path / "c", CONTOUR)
    whole = path.read_bytes()
    entry = whole.rindex(b"PK\x01\x02")  # in the list of an archive: version, password
    wrong = [whole[:i] + bytes([whole[i] ^ 255]) + whole[i + 1 :] for i in (200, entry + 6, entry + 8)]
    for damaged in (whole[:-100], *wrong, b"", b"PK", b"junk"):
        path.write_bytes(damaged)
        wanted = "argument path must name a file that `jaxroll.save` wrote"
        with pytest.raises(ValueError, match=wanted) as refused:
            jxr.load(path)
        assert "pickle" not in str(refused.value)  # of which NumPy speaks where there is no archive
    np.savez(path, numbers=np.ones(3))
    with pytest.raises(ValueError, match="it has no 'structure'"):
        jxr.load(path)

    def odd(head):
        head["tree"]["fields"]["a"] = {"run": "this"}

    path.write_bytes(whole)
    with pytest.raises(ValueError, match="argument path must name a whole file"):
        jxr.load(rewritten(path, odd))
    with pytest.raises(ValueError, match="there is none called"):
        jxr.load(tmp_path / "absent")
    (tmp_path / "table.csv").write_text("1,2")
    monkeypatch.chdir(tmp_path)  # a long path is quoted without its end
    with pytest.raises(ValueError, match="`jaxroll.save` wrote, whose name ends in .npz, but was '.*csv'"):
        jxr.load("table.csv")


@pytest.mark.parametrize("name", ["os:system", "jaxroll._saving:importlib.import_module", "nothing:here"])
def test_nothing_but_records_is_found_by_a_files_names(name, tmp_path):
    def other(head):
        head["tree"]["record"] = name

    with pytest.raises(ValueError, match="argument path must"):
        jxr.load(rewritten(jxr.save(tmp_path / "c", CONTOUR), other))


def test_double_precision_is_not_cut_in_silence(tmp_path):
    path = jxr.save(tmp_path / "x", jnp.array(0.1))
    code = f"import jaxroll as jxr; jxr.load({str(path)!r})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "must be read with jax_enable_x64 set, since x.npz holds float64" in done.stderr


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path):
    path = jxr.save(tmp_path / "c", CONTOUR)
    with pytest.raises(ValueError, match="argument value"):
        jxr.save(path, lambda: 0)
    assert_same(jxr.load(path), CONTOUR)


@dataclasses.dataclass
class Plain:
    """A record with a field that is given, one by default and one that is made."""

    given: int
    usual: int = 7
    made: list = dataclasses.field(default_factory=list)


def test_fields_that_a_file_does_not_hold_take_their_defaults_whatever_kind(tmp_path):
    def older(head):
        del head["tree"]["fields"]["usual"], head["tree"]["fields"]["made"]

    path = rewritten(jxr.save(tmp_path / "plain", Plain(3, 4, [5])), older)
    found = jxr.load(path, own=[Plain])
    assert found == Plain(3) and found.made is not jxr.load(path, own=[Plain]).made

    def bare(head):
        del head["tree"]["fields"]["given"]

    with pytest.raises(ValueError, match="lacks its 'given'"):
        jxr.load(rewritten(path, bare), own=[Plain])


def test_records_of_jaxroll_have_their_shortest_public_names():
    names = {
        jxr.Circle: "jaxroll:Circle",
        jxr.simulate: "jaxroll:simulate",
        jxr.control.Press: "jaxroll.control:Press",
        jxr.commands.Steps: "jaxroll.commands:Steps",
        jxr.design.Limits: "jaxroll.design:Limits",
        _saving._Writer: "jaxroll._saving:_Writer",
        np.ndarray: "numpy:ndarray",
        Plain: f"{__name__}:Plain",
    }
    assert {thing: _saving._name_of(thing) for thing in names} == names
    assert _saving._attribute("jaxroll", "Circle.moved") is jxr.Circle.moved
    assert _saving._attribute("jaxroll", "Circle.nothing.more") is None


NAMED = [(own_law, True), (jxr.simulate, True), (lambda: 0, False), (3, False)]


@pytest.mark.parametrize(("thing", "found"), [*NAMED, (functools.partial(own_law), False)])
def test_functions_are_found_by_the_module_that_names_them(thing, found):
    assert _saving._findable(thing) == found


@pytest.mark.parametrize("own", ["Plain", [3], [lambda: 0], {Plain}, Plain])
def test_ones_own_classes_and_functions_are_a_list(own, tmp_path):
    path = jxr.save(tmp_path / "plain", Plain(3))
    with pytest.raises(ValueError, match="argument own must be a list of classes and functions"):
        jxr.load(path, own=own)
    assert jxr.load(path, own=(Plain, own_law)) == Plain(3)


def test_a_file_has_its_ending_once_and_a_folder_that_is_made(tmp_path):
    for given, name in (("a", "a.npz"), ("a.npz", "a.npz"), ("a.b", "a.b.npz"), ("a.NPZ", "a.NPZ.npz")):
        path = jxr.save(tmp_path / "new" / "deep" / given, [1])
        assert path == tmp_path / "new" / "deep" / name and jxr.load(path) == [1]
    assert jxr.load(tmp_path / "new" / "deep" / "a") == [1]
    assert not [each for each in path.parent.iterdir() if each.suffix == ".part"]
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(ValueError, match="argument path must name a file that can be written"):
        jxr.save(tmp_path / "file" / "a", [1])


def test_numbers_of_numpy_and_views_of_one_array_come_back_as_what_they_were(tmp_path):
    """An array that JAX and NumPy both hold is written once for each."""
    array = np.arange(3.0)
    value = (np.float32(0.1), np.int8(3), np.bool_(True), array, array, jnp.asarray(array), 2 + 0 * array[0])
    found = jxr.load(jxr.save(tmp_path / "numbers", value))
    assert_same(found, value)
    assert found[3] is found[4] and isinstance(found[6], np.floating)


@pytest.mark.parametrize(
    "array", [np.array(["a"]), np.array([None]), np.ma.array([1.0], mask=[True]), np.array(["2020"], "M8[Y]")]
)
def test_arrays_hold_numbers_none_masked(array, tmp_path):
    with pytest.raises(
        ValueError, match="argument value must hold arrays of booleans and numbers, none masked"
    ):
        jxr.save(tmp_path / "odd", {"k": array})
