"""Stores of sweeps, and runs as tables: names, units, what they are while they fill, grow or are damaged.

Nothing is compiled: a chunk's program is replaced by numbers that say which run they are of, and is known by
what was traced, for to write it down as it is compiled takes long (`tests/test_sweep.py` does).
"""

import collections
import errno
import json
import pathlib
import shutil
import signal
import subprocess
import sys
import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._cli._sweep_table import entries_of, read_table
from jaxroll._integration._dataset import _Walk
from jaxroll._motion import Multipliers
from jaxroll._sweep import _store
from jaxroll._sweep._program import Program
from jaxroll.plotting import parameter_map
from tests.recorded import runs
from tests.subjects.swinging_plate import swinging

xr = pytest.importorskip("xarray")
zarr = pytest.importorskip("zarr")

ROWS = np.linspace(0.004, 0.008, 10)


def of_rows(program, rows):
    """In place of a program: every number of a run is its damping, a thousand times that if it is whole."""
    damping = np.asarray(rows["damping"])

    def filled(form):
        scale = 1.0 if np.issubdtype(form.dtype, np.floating) else 1e3
        column = (scale * damping).reshape(-1, *(1,) * (len(form.shape) - 1))
        return np.broadcast_to(column, form.shape).astype(form.dtype)

    return jax.tree.map(filled, program.results)


@pytest.fixture(scope="module", autouse=True)
def _known_by_its_trace():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Program, "fingerprint", Program.key)
        yield


@pytest.fixture
def calls(monkeypatch):
    """The first parameter of every chunk that was worked out."""
    found = []

    def call(self, rows):
        found.append(float(np.asarray(rows["damping"])[0]))
        return of_rows(self, rows)

    monkeypatch.setattr(Program, "__call__", call)
    return found


def swept(path, rows=ROWS, **changes):
    grasp, state = swinging()
    make = changes.pop("make", lambda p: (grasp.with_(damping=p["damping"]), state))
    given = {"chunk": 4, "store": path, "keep": eqx.Partial(_ends)} | changes
    rows = rows if isinstance(rows, dict | jxr.Parameters) else {"damping": rows}
    return jxr.sweep(make, rows, 0.2, **given)


def test_named_parameters_come_back_with_units_and_as_a_grid(tmp_path, calls):
    some = jxr.Parameters.grid(damping=ROWS[:3], force=[0.4, 0.5]).with_units(damping="N m s")
    table = swept(tmp_path / "grid.zarr", some)
    assert table.damping.attrs == {"long_name": "damping", "units": "N m s"}
    assert table.force.attrs == {"long_name": "force"}
    back = jxr.Parameters.of_table(xr.open_zarr(tmp_path / "grid.zarr", chunks=None))
    assert (back.shape, back.axes, back.units) == (some.shape, some.axes, some.units)
    for name in some.names:
        np.testing.assert_array_equal(back[name], some[name])
    # More rows, laid out otherwise, that begin with those.
    more = some[np.arange(6)]
    assert jxr.Parameters.of_table(swept(tmp_path / "grid.zarr", more)).shape == (6,)
    with pytest.raises(ValueError, match="argument table must be an xarray.Dataset of a stored sweep"):
        jxr.Parameters.of_table(xr.Dataset())


def test_a_map_of_a_store_that_is_still_filling(tmp_path, calls):
    some = jxr.Parameters.grid(damping=ROWS[:4], force=[0.4, 0.5])
    path = tmp_path / "filling.zarr"
    table = swept(path, some, keep=eqx.Partial(_result))
    calls.clear()
    zarr.open_array(path / "result", mode="r+")[4:] = [-1] * 4
    zarr.open_array(path / "result", mode="r+")[:4] = [0] * 4
    table = xr.open_zarr(path, chunks=None)
    figure = parameter_map(jxr.Parameters.of_table(table), table.result)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "not stored, 50 %",
        "successful, 50 %",
    ]
    found = read_table(path)
    assert found.parameters.shape == (4, 2) and list(found.values) == ["result"]
    assert entries_of(found.values["result"]) == ["successful"] * 4 + ["not_stored"] * 4


def _result(run):
    return {"result": run.result}


def _ends(run):
    return {"end": run.last, "result": run.result, "twice": 2.0 * run.last.q}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished store."""
    path = tmp_path_factory.mktemp("finished") / "table.zarr"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Program, "__call__", of_rows)
        swept(path)
    return path


@pytest.fixture
def copied(finished, tmp_path):
    """A copy of it."""
    return pathlib.Path(shutil.copytree(finished, tmp_path / "table.zarr"))


READER = """
import json, sys
sys.modules["jaxroll"] = sys.modules["jax"] = None
import warnings
warnings.simplefilter("error")
import xarray as xr
table = xr.open_zarr(sys.argv[1], chunks=None)
print(json.dumps({
    "sizes": dict(table.sizes),
    "names": table.position.values.tolist(),
    "units": table.position_unit.values.tolist() + table.velocity_unit.values.tolist(),
    "theta": table.end_q.sel(position="object theta").values.tolist(),
    "damping": table.damping.values.tolist(),
    "result": dict(table.result.attrs),
    "long": table.end_v.attrs["long_name"],
    "about": dict(table.attrs) | dict(table.sweep.attrs),
    "codes": table.result.values.tolist(),
    "coordinates": sorted(table.coords),
    "stored": table.stored.values.tolist(),
}))
"""


def test_a_process_without_jaxroll_reads_names_and_units(finished):
    """Only the store and xarray are there."""
    read = subprocess.run(
        [sys.executable, "-c", READER, str(finished)], capture_output=True, text=True, check=False
    )
    assert read.returncode == 0, read.stderr
    told = json.loads(read.stdout)
    assert told["sizes"] == {"run": 10, "position": 4, "velocity": 4, "place": 1, "twice_0": 4}
    assert told["names"] == ["object x", "object y", "object theta", "finger 0 q[0]"]
    assert told["units"] == ["m", "m", "rad", "m", "m/s", "m/s", "rad/s", "m/s"]
    assert told["theta"] == told["damping"] == ROWS.tolist()
    assert told["long"] == "velocity" and all(told["stored"])
    meanings = told["result"]["flag_meanings"].split()
    assert len(meanings) == len(told["result"]["flag_values"])
    flags = dict(zip(meanings, told["result"]["flag_values"], strict=True))
    for name in ("successful", "contact_lost", "unresolved"):
        assert flags[name] == int(jxr.RESULTS._name_to_item[name]._value)
    assert told["codes"] == (1e3 * ROWS).astype(int).tolist()
    about = told["about"]
    assert about["jaxroll_version"] == jxr.__version__ and about["version of jax"] == jax.__version__
    assert about["precision"] == "double" and about["t1"] == "0.2" and about["chunk"] == "4 runs"
    assert {"damping", "position_unit", "place_unit"} <= set(told["coordinates"])


def test_a_finished_store_is_read_and_a_damaged_chunk_worked_out_again(copied, calls):
    whole = swept(copied).load()
    assert not calls
    chunk = copied / "end_q" / "c" / "1" / "0"
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 1
    chunk.write_bytes(bytes(data))
    (copied / "sweep" / "runs_0000000008.sum").unlink()
    with pytest.warns(UserWarning, match="from run 4 on in .* is worked out again"):
        again = swept(copied).load()
    assert sorted(calls) == [ROWS[4], ROWS[8]]
    xr.testing.assert_identical(again, whole)


@pytest.mark.parametrize(
    "name", ["zarr.json", "end_q/zarr.json", "damping/zarr.json", "stored/zarr.json", "damping/c/1"]
)
def test_what_describes_the_arrays_is_written_again_where_it_is_damaged(name, copied, calls):
    """And the parameters too, without which no chunk could be checked."""
    whole = _store.open_table(copied).load()
    (copied / name).write_bytes(b"")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        xr.testing.assert_identical(swept(copied).load(), whole)


def test_more_parameters_are_appended(copied, calls):
    """The chunk that was not full is worked out again, and those before it are left alone."""
    more = np.r_[ROWS, np.linspace(0.01, 0.02, 5)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table = swept(copied, more)
    assert sorted(calls) == [more[8], more[12]]
    np.testing.assert_array_equal(table.damping, more)
    np.testing.assert_array_equal(table.end_q, more[:, None] * np.ones(4))
    assert table.attrs["runs"] == 15 and bool(table.stored.all())
    for other in (ROWS, np.r_[ROWS[:3], more[:12]]):
        with pytest.raises(ValueError, match="argument store must be a folder of the same sweep, or of its"):
            swept(copied, other)


def test_an_append_that_was_cut_off_is_finished(copied, calls, monkeypatch):
    """Readers see the store as it was until the longer one is whole."""
    more = np.r_[ROWS, 0.02, 0.03]

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(zarr, "consolidate_metadata", full)
        with pytest.raises(OSError, match="could not be written .* the same call goes on"):
            swept(copied, more)
    assert xr.open_zarr(copied, chunks=None).sizes["run"] == 10 and not calls
    np.testing.assert_array_equal(swept(copied, more).end_q[:, 0], more)


def test_it_can_be_read_while_it_fills(tmp_path, monkeypatch):
    """Runs that are not there are not a number, have no code and are not `stored`."""
    path, seen = tmp_path / "table.zarr", []

    def call(self, rows):
        seen.append(xr.open_zarr(path, chunks=None).load())
        return of_rows(self, rows)

    monkeypatch.setattr(Program, "__call__", call)
    monkeypatch.setattr("jaxroll._sweep._sweep._workers", lambda devices: 1)
    swept(path)
    assert [int(table.stored.sum()) for table in seen] == [0, 4, 8]
    np.testing.assert_array_equal(seen[1].end_q[:4, 0], ROWS[:4])
    assert np.isnan(seen[1].end_q[4:]).all() and (seen[1].result[4:] == -1).all()
    np.testing.assert_array_equal(seen[0].damping, ROWS)


def test_a_disk_that_is_full_for_a_while(tmp_path, calls, monkeypatch):
    """Writing is tried again; where that does not help, what is there stays, and the same call goes on."""
    path, left = tmp_path / "table.zarr", [2]
    write = _store.Store._write

    def full(self, start, leaves):
        if start == 4 and left[0]:
            left[0] -= 1
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, start, leaves)

    monkeypatch.setattr(_store.Store, "_write", full)
    waited = []
    monkeypatch.setattr(_store, "_PAUSES", (0.25,))
    monkeypatch.setattr(_store.time, "sleep", waited.append)
    with pytest.raises(OSError, match="No space left on device.*what it holds stays"):
        swept(path)
    assert waited == [0.25]
    done = len(calls)
    assert 2 <= done <= 3
    np.testing.assert_array_equal(swept(path).end_q[:, 0], ROWS)
    assert len(calls) <= 4


OTHER = {
    "resume": ({"resume": "folder"}, "argument resume must be left out where store is given"),
    "keep": ({"keep": lambda run: run.last.q * 1.5}, "differs in keep"),
    "chunk": ({"chunk": 5}, r"differs in chunk \(4 runs there, 5 runs here\)"),
    "form": ({"rows": {"damping": ROWS, "other": ROWS}}, "differs in parameters"),
    "dense": ({"keep": None, "record": ("dense",)}, "argument record must not hold 'dense'|differs in"),
}


@pytest.mark.parametrize("name", OTHER)
def test_another_sweep_is_refused(name, finished, calls, tmp_path):
    changes, wanted = OTHER[name]
    with pytest.raises(ValueError, match=wanted):
        swept(finished, **changes)
    assert not calls


def test_what_is_no_store_is_refused(calls, tmp_path):
    xr.Dataset({"a": ("x", [1.0])}).to_zarr(tmp_path / "other.zarr", consolidated=False)
    (tmp_path / "file").write_text("")
    for path, wanted in (
        (tmp_path / "other.zarr", "argument store must be a new folder or of a sweep"),
        (tmp_path / "file", "argument store must be a folder that can be written"),
        (5, "argument store must be the path of a folder"),
    ):
        with pytest.raises(ValueError, match=wanted):
            swept(path)


KILLED = """
import os, pathlib, signal, sys
import jax
jax.config.update("jax_enable_x64", True)
from jaxroll._sweep import _store
from jaxroll._sweep._program import Program
from tests.test_sweep_store import of_rows, swept
put = _store.Store._put

def half(self, name, *given):
    if name == "result" and len(list(pathlib.Path(sys.argv[1], "sweep").glob("*.sum"))) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    put(self, name, *given)

Program.__call__, Program.fingerprint, _store.Store._put = of_rows, Program.key, half
swept(pathlib.Path(sys.argv[1]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="it kills by a signal")
def test_killed_within_a_chunk_it_goes_on(tmp_path, calls):
    """By SIGKILL, with some arrays of the second chunk written and some not."""
    path = tmp_path / "table.zarr"
    root = pathlib.Path(__file__).parents[1]
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, str(path)], cwd=root, capture_output=True, text=True, check=False
    )
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert len(list((path / "sweep").glob("*.sum"))) == 1
    table = swept(path)
    assert len(calls) == 2
    np.testing.assert_array_equal(table.end_q[:, 0], ROWS)
    assert not list((path / "sweep").glob("*.lock")) and not list((path / "sweep").glob("*.part"))


def test_whatever_is_kept_has_a_name(calls, tmp_path):
    """All of a run by default; arrays without a name are numbered; parameters give way to results."""
    table = swept(tmp_path / "all.zarr", keep=None, ts=2, record=("multipliers", "energy"))
    assert table.q.dims == ("run", "time", "position") and table.f.dims == ("run", "time", "contact")
    np.testing.assert_array_equal(table.time, [0.0, 0.2])
    assert table.f.attrs["units"] == "N" and table.energy_work.attrs["units"] == "J"
    table = swept(
        tmp_path / "some.zarr",
        {"damping": ROWS, "kept_0": ROWS},
        keep=lambda run: (run.last.q, run.states, jnp.float32(1.0)),
    )
    assert {"kept_0", "kept_1q", "kept_2", "parameter_kept_0"} <= set(table.variables)
    assert table.kept_2.dtype == np.float32


def test_a_store_as_netcdf(finished, tmp_path):
    pytest.importorskip("h5netcdf")
    table = xr.open_zarr(finished, chunks=None)
    table.to_netcdf(tmp_path / "table.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "table.nc", engine="h5netcdf") as read:
        np.testing.assert_array_equal(read.end_q, table.end_q)
        assert read.position.values.tolist() == table.position.values.tolist()
        assert read.result.attrs["flag_meanings"] == table.result.attrs["flag_meanings"]
        assert read.sweep.attrs["t1"] == "0.2"


def test_one_run_as_a_table(run):
    table = run.to_xarray()
    np.testing.assert_array_equal(table.time, run.ts)
    for i, name in enumerate(("object theta", "finger 0 q[0]", "finger 0 q[1]")):
        np.testing.assert_array_equal(table.q.sel(position=name), run.states.q[:, i])
        np.testing.assert_array_equal(table.v.sel(velocity=name), run.states.v[:, i])
    np.testing.assert_array_equal(table.residual_normal, run.residuals.normal)
    np.testing.assert_array_equal(table.f, run.multipliers.f)
    np.testing.assert_array_equal(table.energy_work, run.energy.work)
    assert int(table.result) == 0 and table.result.attrs["flag_meanings"].startswith("successful ")
    assert table.s.dims == ("time", "place") and table.place_unit.values.tolist() == ["m"]
    assert int(table.steps) == int(run.stats.steps) and int(table.ended_by) == -1
    units = {name: table[name].attrs.get("units") for name in ("f", "t_end", "residual_normal", "time")}
    assert units == {"f": "N", "t_end": "s", "residual_normal": "m", "time": "s"}


def test_a_batch_as_a_table(run):
    """Lanes come first; times that differ from lane to lane are an array of their own."""
    both = jax.tree.map(lambda x: jnp.stack([x, x]), run)
    table = both.to_xarray()
    assert table.q.dims == ("lane", "time", "position") and table.time.dims == ("time",)
    np.testing.assert_array_equal(table.q[1], run.states.q)
    later = eqx.tree_at(lambda r: r.ts, both, both.ts * jnp.array([[1.0], [2.0]])).to_xarray()
    assert later.ts.dims == ("lane", "time") and "time" not in later.coords
    with pytest.raises(ValueError, match="argument run must be known to be a table"):
        jax.jit(lambda r: r.to_xarray() and 0)(run)


def test_a_dimension_stands_once_in_an_array_and_has_one_size():
    walk = _Walk(("lane",), {}, "kept")
    walk.add("square", np.zeros((5, 3, 3, 2)), ("time", "time", "place"), {})
    walk.add("longer", np.zeros((5, 4, 2)), ("time", "place"), {})
    assert [each.dims for each in walk.found] == [
        ("lane", "time", "square_1", "place"),
        ("lane", "longer_0", "place"),
    ]


def test_bodies_in_space_name_their_velocities():
    """A free object has more positions than velocities, and a moving stage has a clock without a velocity."""
    grasp, state = jxr.scenes.turntable()
    labels = grasp.labels
    assert sum(len(part) for _, part in labels.velocities) == state.v.size
    assert sum(len(part) for _, part in labels.bodies) == state.q.size
    assert len(labels.places) == state.s.size
    spins = [each for each in labels.velocities[0][1] if each.name.startswith("spin")]
    assert [each.unit for each in spins] == ["rad/s"] * 3


def test_without_the_extra_there_is_one_sentence(run, calls, tmp_path, monkeypatch):
    """Python takes a module that is None for one that cannot be found."""
    for library, call in (("zarr", lambda: swept(tmp_path / "x")), ("xarray", run.to_xarray)):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, library, None)
            with pytest.raises(ImportError) as said:
                call()
        assert str(said.value) == f'this needs the library {library}: pip install "jaxroll[data]"'
    assert not (tmp_path / "x").exists()


def test_a_run_in_space_as_a_table():
    run = runs.run("pinch3d")
    table = run.to_xarray()
    assert table.axis.values.tolist() == ["x", "y", "z"]
    assert table.lam.dims == ("time", "contact", "axis")
    np.testing.assert_array_equal(table.lam, run.multipliers.lam)
    assert table.q.dims == ("time", "position") and table.v.dims == ("time", "velocity")


def test_what_has_no_names_is_named_by_its_place_and_numbered():
    walk = _Walk((), {}, "kept")
    pair = collections.namedtuple("Pair", "left right")  # noqa: PYI024
    assert walk.parts(pair(1, 2)) == [("left_", 1), ("right_", 2)]
    assert walk.parts({"a": 3}) == [("a_", 3)] and walk.parts((4, 5)) == [(0, 4), (1, 5)]
    node = jax.tree_util.Partial(max, {"inner": 6.0}, key=7.0)
    assert walk.parts(node) == [("0_0_inner_", 6.0), ("1_key_", 7.0)]
    for _ in range(3):
        walk.add("same name", np.zeros(()), (), {})
    assert [each.name for each in walk.found] == ["same_name", "same_name_2", "same_name_3"]


def twice_of_rows(program, rows):
    """Numbers of a run that are not those of its parameters."""
    return jax.tree.map(lambda x: 2.0 * x, of_rows(program, rows))


@pytest.mark.parametrize(
    ("more", "kept"), [((), ("damping", "parameter_damping")), (("parameter_damping",), ("damping",))]
)
def test_parameters_have_names_of_their_own_beside_results_and_others(more, kept, tmp_path, monkeypatch):
    """What is kept may be called as a parameter, and as the name that the parameter would have then."""
    monkeypatch.setattr(Program, "__call__", twice_of_rows)
    grasp, state = swinging()
    some = jxr.Parameters(damping=[0.004, 0.005], **{name: [1.0, 2.0] for name in more})
    keep = lambda run: {name: run.last.q[0] for name in kept}  # noqa: E731
    make = lambda p: (grasp.with_(damping=p.damping), state)  # noqa: E731
    for _ in range(2):  # the second time as what it is, a store of the same sweep
        table = jxr.sweep(make, some, t1=0.02, keep=keep, store=tmp_path / "some.zarr")
    again = jxr.Parameters.of_table(table)
    for name in some.names:
        np.testing.assert_array_equal(again[name], some[name])
    for name in kept:
        np.testing.assert_array_equal(table[name], [0.008, 0.010])


def test_every_name_is_one_folder_of_a_store():
    """A backslash divides paths of Zarr's too: what was kept under such a name was not found again."""
    walk = _Walk((), {}, "kept")
    for name in (r"$\theta$ [rad]", r"\theta", "a/b", "x\0y", ".", "..", "zarr.json", ".5"):
        walk.add(name, np.zeros(()), (), {})
    wanted = ["$_theta$_[rad]", "_theta", "a_b", "x_y", "._kept", ".._kept", "zarr.json_kept", ".5"]
    assert [each.name for each in walk.found] == wanted


def test_forces_of_a_blow_are_impulses():
    walk = _Walk((), {}, "kept")
    walk.record(Multipliers(jnp.ones((3, 2)), jnp.zeros((3, 2))), "", "blow")
    f = walk.found[0]
    assert f.dims[0] == "blow" and f.attrs["units"] == "N s" and "impulse" in f.attrs["long_name"]
