"""Folders of sweeps: only this sweep's numbers come out, whatever became of the folder.

But for the slow test nothing is compiled: a chunk's program is replaced by a count of its calls, and is known
by what was traced, for to write it down as it is compiled takes long (`tests/test_sweep.py` does).
"""

import pathlib
import shutil
import signal
import subprocess
import sys
import threading
import warnings

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll import _fingerprint
from jaxroll._sweep import _folder, _identity
from jaxroll._sweep._program import of_keep, of_make, Program
from tests.helpers import slow_among
from tests.recorded import runs
from tests.subjects.swinging_plate import swinging

ROWS = np.linspace(0.004, 0.008, 10)
REAL = np.linspace(0.004, 0.008, 40)
ENDS = np.repeat(ROWS[::2], 2)[:, None] * np.ones(4)
TABLE = np.linspace(1.0, 2.0, 20_000)


def of_first(program, rows):
    """In place of a program: everything is the first number of the first row."""
    first = float(jax.tree.leaves(rows)[0][0])
    return jax.tree.map(lambda form: np.full(form.shape, first).astype(form.dtype), program.results)


@pytest.fixture(scope="module")
def scene():
    """A disc on a plate that swings: there is little to trace."""
    return swinging()


@pytest.fixture
def calls(monkeypatch):
    """The first parameters of the chunks that were worked out; their results are these, everywhere."""
    found = []

    def call(self, rows):
        found.append(float(jax.tree.leaves(rows)[0][0]))
        return of_first(self, rows)

    monkeypatch.setattr(Program, "__call__", call)
    monkeypatch.setattr(Program, "fingerprint", Program.key)
    return found


@pytest.fixture
def sweep(scene, calls, tmp_path):
    """A sweep of five chunks, any part of which may be changed."""
    return lambda **changes: swept(scene, changes, tmp_path / "sweep")


def swept(scene, changes, folder):
    grasp, state = scene
    given = {
        "make": ..., "keep": lambda run: run.last.q * 1.5, "factor": 1.0, "table": TABLE, "law": None,
        "rows": ROWS, "t1": 0.2, "chunk": 2, "rtol": 1e-7, "resume": folder,
    } | changes  # fmt: skip
    make, factor, table, law = (given.pop(name) for name in ("make", "factor", "table", "law"))

    def usual(c):
        held = grasp.with_(damping=c * factor + 0.0 * jnp.asarray(table).sum())
        return held if law is None else eqx.tree_at(lambda g: g.controller, held, law), state

    return jxr.sweep(usual if make is ... else make, given.pop("rows"), given.pop("t1"), **given)


def changed(array):
    """The same numbers but for one, by one unit in the last place."""
    other = array.copy()
    other[-7] = np.nextafter(other[-7], 9.0)
    return other


def law_of(gain):
    return lambda t, angles, rates, tips: tuple(-gain * rate for rate in rates)


CHANGES = {
    "body of make": ({"factor": -1.0}, "make"),
    "closed-over value": ({"factor": np.nextafter(1.0, 2.0)}, "make"),
    "closed-over array": ({"table": changed(TABLE)}, "make"),
    "closed-over kind": ({"table": TABLE.astype(np.float32)}, "make"),
    "keep": ({"keep": lambda run: run.last.q * 1.5000000001}, "keep"),
    "rtol": ({"rtol": 1e-8}, "option rtol (1e-07 there, not given here)"),
    "atol": ({"atol": 1e-8}, "option atol (not given there, 1e-08 here)"),
    "events": ({"events": ("lift",)}, "option events (not given there, ('lift',) here)"),
    "no events": ({"events": ()}, "option events"),
    "record": ({"record": ("energy",)}, "option record"),
    "ts": ({"ts": 2}, "option ts (1 there, 2 here)"),
    "ts by value": ({"ts": np.array([0.2])}, "option ts"),
    "dt0": ({"dt0": 1e-5}, "option dt0"),
    "max_steps": ({"max_steps": 100}, "option max_steps"),
    "t0": ({"t0": -0.1}, "option t0"),
    "solver": ({"solver": diffrax.Tsit5()}, "option solver"),
    "formulation": ({"formulation": jxr.CSM(50.0)}, "option formulation"),
    "controller": ({"stepsize_controller": diffrax.ConstantStepSize()}, "option stepsize_controller"),
    "t1": ({"t1": 0.21}, "t1 (0.2 there, 0.21 here)"),
    "chunk": ({"chunk": 5}, "chunk (2 runs there, 5 runs here)"),
    "parameters": ({"rows": changed(ROWS)}, "parameters"),
    "fewer rows": ({"rows": ROWS[:8]}, "parameters (float64[10] there, float64[8] here)"),
    "kind of rows": ({"rows": ROWS.astype("f4")}, "parameters (float64[10] there, float32[10] here)"),
    "several": ({"factor": 2.0, "t1": 0.21}, "t1 (0.2 there, 0.21 here), make"),
}  # fmt: skip


KEPT_OTHERWISE = {
    "a factor": lambda run: run.last.q * 1.5000000001,
    "another array": lambda run: run.last.v * 1.5,
    "another tree": lambda run: [run.last.q * 1.5],
    "everything": None,
}


@pytest.mark.parametrize("name", KEPT_OTHERWISE)
def test_what_is_kept_counts(name):
    """Without the program of the runs, which would be traced for each."""
    trajectory = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), runs.run("pivoted"))
    usual, same = (of_keep(lambda run: run.last.q * 1.5, trajectory) for _ in range(2))
    assert usual == same != of_keep(KEPT_OTHERWISE[name], trajectory)


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    """The folder of a finished sweep."""
    path = tmp_path_factory.mktemp("finished") / "sweep"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Program, "__call__", of_first)
        patch.setattr(Program, "fingerprint", Program.key)
        swept(scene, {}, path)
    return path


@pytest.fixture
def finished(folder, tmp_path):
    """A copy of it, to be damaged; `sweep` goes on with it."""
    return pathlib.Path(shutil.copytree(folder, tmp_path / "sweep"))


@pytest.mark.parametrize("name", CHANGES)
def test_another_sweep_is_refused_by_name(name, scene, folder, calls):
    changes, wanted = CHANGES[name]
    with pytest.raises(ValueError) as caught:
        swept(scene, changes, folder)
    start = f"argument resume must be a folder of the same sweep, but {folder} is of one that differs in "
    end = ": give another"
    assert str(caught.value).endswith(end)
    said = str(caught.value).removeprefix(start).removesuffix(end)
    assert said == wanted or said.startswith(f"{wanted} (") and said.endswith(" here)")
    assert said.count("option") <= 1 and not calls


PAIRS = {
    "a control law's closure": ({"law": law_of(0.1)}, {"law": law_of(0.2)}, "make"),
    "a solver's field": (
        {"solver": diffrax.Kvaerno5(root_finder=diffrax.VeryChord(rtol=1e-9, atol=1e-9))},
        {"solver": diffrax.Kvaerno5(root_finder=diffrax.VeryChord(rtol=1e-8, atol=1e-9))},
        "option solver",
    ),
    "a gain": ({"formulation": jxr.CSM(50.0)}, {"formulation": jxr.CSM(51.0)}, "option formulation"),
    "a controller's function": (
        {"stepsize_controller": diffrax.PIDController(rtol=1e-7, atol=1e-7, norm=lambda x: 2 * abs(x).max())},
        {"stepsize_controller": diffrax.PIDController(rtol=1e-7, atol=1e-7, norm=lambda x: 3 * abs(x).max())},
        "option stepsize_controller",
    ),
}


@pytest.mark.parametrize("name", PAIRS)
def test_what_is_inside_of_things_counts(name, scene, tmp_path):
    before, after, wanted = PAIRS[name]
    rows = np.asarray(ROWS)
    marks = [_marks(scene, changes, rows) for changes in (before, after, before)]
    assert _identity.differences(marks[0], marks[2]) == ""
    assert _identity.differences(marks[0], marks[1]).split(" (")[0] == wanted


def test_which_of_two_like_parameters_is_read_counts(scene):
    """Without the arguments that it does not use, a program is the same for either."""
    row = {"first": 0.004, "second": 0.005}
    first, second = (of_make(lambda p, n=name: (scene[0].with_(damping=p[n]), scene[1]), row) for name in row)
    assert first != second


def _marks(scene, changes, rows):
    """What is known of a sweep before its runs are traced, which for some of these takes long."""
    grasp, state = scene
    law = changes.get("law")
    make = lambda c: (grasp if law is None else eqx.tree_at(lambda g: g.controller, grasp, law), state)  # noqa: E731
    marks = _identity.identity(rows, 0.2, 2, changes if law is None else {})
    return marks | {"make": _identity.Mark(of_make(make, rows[0]), "make")}


def test_the_same_sweep_in_other_words_goes_on(sweep, calls, finished):
    """Other objects with the same contents, and defaults that are given."""
    again = sweep(
        keep=lambda run: (lambda q: q * 1.5)(run.last.q), table=TABLE.copy(), ts=1, t0=0.0, record=()
    )
    np.testing.assert_array_equal(again, ENDS)
    assert not calls


@pytest.mark.filterwarnings("ignore:Explicitly requested dtype")
def test_other_precision_is_refused_by_name(sweep, finished):
    with (
        jax.enable_x64(False),
        pytest.raises(ValueError, match=r"differs in precision \(double there, single here"),
    ):
        sweep(rtol=1e-4)


@pytest.mark.parametrize("what", ["version_of", "_processor", "_flags"])
def test_another_machine_is_refused_by_name(what, sweep, finished, monkeypatch):
    monkeypatch.setattr(_identity, what, lambda *_: "another")
    names = {"version_of": "version of jaxroll", "_processor": "processor", "_flags": "XLA_FLAGS"}
    with pytest.raises(ValueError, match=rf"differs in {names[what]} \(.* there, another here\)"):
        sweep()


def test_all_that_is_known_by_name_alone_is_compared_by_version(monkeypatch):
    """Another version of any of these packages is another sweep, and named."""
    marks, real = _identity.identity(ROWS, 0.2, 2, {}), _identity.version_of
    for name in sorted(_fingerprint.LIBRARIES - sys.stdlib_module_names):
        with monkeypatch.context() as patch:
            patch.setattr(_identity, "version_of", lambda n, name=name: "another" if n == name else real(n))
            found = _identity.differences(marks, _identity.identity(ROWS, 0.2, 2, {}))
        assert found.startswith(f"version of {name} (") and found.endswith("there, another here)")


def test_another_program_is_refused_though_all_else_is_the_same(sweep, finished, monkeypatch):
    monkeypatch.setattr(Program, "fingerprint", lambda self: "another")
    with pytest.raises(ValueError, match="differs in the program of the runs"):
        sweep()


def _cut(path):
    path.write_bytes(path.read_bytes()[:-200])


def _flipped(path):
    """One bit of what is stored is another; the archive's own checksum is made to fit."""
    with np.load(path) as file:
        held = dict(file)
    held["arr_0"].view(np.uint8).flat[3] ^= 1
    with path.open("wb") as file:
        np.savez(file, **held)


def _foreign(path):
    with np.load(path) as file:
        held = dict(file)
    held["sweep"] = np.asarray("0" * 64)
    with path.open("wb") as file:
        np.savez(file, **held)


def _other(path):
    shutil.copy(path.with_name("runs_0000000009.npz"), path)


def _bare(path):
    np.savez(path, np.full((2, 4), 7.0))


def _longer(path):
    """All that is asked for, and something else."""
    with np.load(path) as file:
        held = dict(file)
    with path.open("wb") as file:
        np.savez(file, **held, other=np.zeros(3))


DAMAGE = {
    "empty": lambda path: path.write_bytes(b""),
    "truncated": _cut,
    "garbage": lambda path: path.write_bytes(b"PK\x03\x04" + bytes(range(256)) * 9),
    "text": lambda path: path.write_text("nothing"),
    "of objects": lambda path: np.save(path.open("wb"), np.array([{}]), allow_pickle=True),
    "another chunk": _other,
    "of another sweep": _foreign,
    "one bit": _flipped,
    "without marks": _bare,
    "of more arrays": _longer,
    "gone": pathlib.Path.unlink,
}


@pytest.mark.parametrize("names", [list(DAMAGE)[: len(ROWS)], list(DAMAGE)[len(ROWS) :]], ids=len)
def test_damaged_chunks_are_worked_out_again(names, scene, calls, tmp_path):
    """Each in another way; the file is named, and afterwards what it was."""
    swept(scene, {"chunk": 1}, tmp_path)
    paths = dict(zip(names, sorted(tmp_path.glob("*.npz")), strict=False))
    assert len(paths) == len(names)
    whole = {path: path.read_bytes() for path in paths.values()}
    for name, path in paths.items():
        DAMAGE[name](path)
    calls.clear()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        ends = swept(scene, {"chunk": 1}, tmp_path)
    np.testing.assert_array_equal(ends, ROWS[:, None] * np.ones(4))
    assert sorted(calls) == list(ROWS[: len(names)])
    for name, path in paths.items():
        assert sum(str(path) in str(w.message) for w in said) == (name != "gone"), name
    assert whole == {path: path.read_bytes() for path in paths.values()}


def test_a_chunk_that_cannot_be_written_is_used_all_the_same(sweep, calls, finished):
    path = finished / "runs_0000000002.npz"
    path.unlink()
    path.mkdir()
    with pytest.warns(UserWarning, match="worked out again") as said:
        np.testing.assert_array_equal(sweep(), ENDS)
    assert calls == [ROWS[2]] and f"{path} of a sweep could not be written" in str(said[1].message)


LOST = [None, "", "{", "[]", '{"identity": {"t1": ["1", "1"]}, "sweep": "", "format": 1}']


@pytest.mark.parametrize("held", LOST)
def test_a_manifest_that_is_lost_is_written_again(held, sweep, calls, finished):
    path = finished / "sweep.json"
    whole = path.read_text()
    path.unlink() if held is None else path.write_text(held)
    with pytest.warns(UserWarning, match=f"the manifest {path} .*(missing|damaged)"):
        np.testing.assert_array_equal(sweep(), ENDS)
    assert not calls and path.read_text() == whole


def test_without_its_manifest_a_folder_still_gives_no_other_sweeps_numbers(sweep, calls, finished):
    (finished / "sweep.json").unlink()
    with pytest.warns(UserWarning) as said:
        sweep(factor=2.0)
    assert len(calls) == 5 and sum("of another sweep" in str(w.message) for w in said) == 5
    with pytest.raises(ValueError, match="differs in make"):
        sweep()


def test_of_two_sweeps_that_begin_at_once_one_is_refused(sweep, monkeypatch):
    """Between the look for a manifest and its writing another process writes its own."""
    original = _folder.Folder._warn_of_loss

    def overtaken(self):
        monkeypatch.setattr(_folder.Folder, "_warn_of_loss", original)
        sweep(factor=2.0)

    monkeypatch.setattr(_folder.Folder, "_warn_of_loss", overtaken)
    with pytest.raises(ValueError, match="differs in make"):
        sweep()


def test_several_at_once_share_the_work(scene, tmp_path, monkeypatch):
    """Threads stand for processes: locks are of open files, and hold between threads likewise."""
    meet, turns, done = threading.Barrier(2, timeout=60), iter(range(100)), []

    def call(self, rows):
        if next(turns) < 2:
            meet.wait()  # both have a chunk of their own under way
        done.append(float(rows[0]))
        return np.zeros((5, 4)) + np.asarray(rows)[:, None]

    monkeypatch.setattr(Program, "__call__", call)
    monkeypatch.setattr(Program, "fingerprint", Program.key)
    found, rows = [], np.linspace(1e-3, 9e-3, 40)
    task = lambda: found.append(swept(scene, {"rows": rows, "chunk": 5}, tmp_path))  # noqa: E731
    threads = [threading.Thread(target=task) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    np.testing.assert_array_equal(*found)
    assert len(done) == 8 == len(set(done))
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".json"] + [".npz"] * 8


CHILD = """
import os, pathlib, signal, sys
moment, folder, cache = sys.argv[1:]
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", cache or None)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)  # each process compiles the same
from jaxroll._sweep import _folder
from jaxroll._sweep._program import Program
from tests.subjects.swinging_plate import swinging
from tests.test_sweep_folder import of_first, REAL, swept

def killed(*_):
    os.kill(os.getpid(), signal.SIGKILL)

flush, store, stored = os.fsync, _folder.Folder.store, []

def half(number):
    name = pathlib.Path(os.readlink(f"/proc/self/fd/{number}")).name
    if name.startswith("runs_") and len(stored) == 1:
        os.ftruncate(number, os.fstat(number).st_size // 2)
        killed()
    flush(number)

def counted(self, *args):
    store(self, *args)
    stored.append(1)
    if moment == "between chunks":
        killed()

if moment == "compilation":
    Program.__call__ = killed
elif not cache:
    Program.__call__ = of_first
if not cache:
    Program.fingerprint = Program.key
os.fsync = half if moment == "write" else flush
_folder.Folder.store = counted
changes = {"rows": REAL} if cache else {}
sys.stdout.buffer.write(swept(swinging(), changes, pathlib.Path(folder)).tobytes())
"""
# What is in the folder afterwards; the lock may have gone or not.
LEFT = {"compilation": [".json"], "write": [".json", ".npz", ".part"], "between chunks": [".json", ".npz"]}


def child(moment, folder, cache=""):
    """Another process that sweeps, and is killed at some moment; with a cache the runs are real ones."""
    root = pathlib.Path(__file__).parents[1]  # whence a process finds `tests`
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "cwd": root}
    return subprocess.Popen([sys.executable, "-c", CHILD, moment, str(folder), cache], **pipes)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="it looks up open files in /proc")
@pytest.mark.parametrize("moment", slow_among([*LEFT], "compilation", "between chunks"))
def test_killed_at_any_moment_a_sweep_goes_on(moment, sweep, calls, tmp_path):
    """By SIGKILL during compilation, with half a chunk written, and between chunks."""
    folder = tmp_path / "sweep"
    killed = child(moment, folder)
    _, said = killed.communicate(timeout=300)
    assert killed.returncode == -signal.SIGKILL, said
    suffixes = sorted(p.suffix for p in folder.iterdir() if p.suffix != ".lock")
    assert sorted(set(suffixes)) == LEFT[moment]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ends = sweep()
    assert len(calls) == 5 - suffixes.count(".npz")
    np.testing.assert_array_equal(ends, ENDS)
    assert sorted(p.suffix for p in folder.iterdir()) == [".json"] + [".npz"] * 5


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="it looks up open files in /proc")
def test_killed_ten_times_and_ended_by_two_at_once_a_sweep_is_the_same(scene, tmp_path):
    """Real runs, to the last bit those of a sweep without a folder."""
    moments = ("compilation", "write", "between chunks")
    cache = str(jax.config.jax_compilation_cache_dir)
    for k in range(10):
        killed = child(moments[k % 3], tmp_path, cache)
        _, said = killed.communicate(timeout=600)
        assert killed.returncode == -signal.SIGKILL, said
    assert 3 <= len(list(tmp_path.glob("*.npz"))) < 20
    both = [child("none", tmp_path, cache) for _ in range(2)]
    outs = [process.communicate(timeout=600) for process in both]
    whole = swept(scene, {"rows": REAL}, None)
    for out, said in outs:
        assert out == whole.tobytes(), said
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".json"] + [".npz"] * 20


def test_a_folder_that_cannot_be_used_is_refused_before_the_work(sweep, tmp_path):
    (tmp_path / "file").write_text("")
    for given in (tmp_path / "file", tmp_path / "file" / "below", "/proc/nothing", "a\0b"):
        with pytest.raises(ValueError, match="argument resume must be a folder that can be written, but "):
            sweep(resume=given, make=lambda c: 1 / 0)
    for given in ("", 5, True, b"", ["x"]):
        with pytest.raises(ValueError, match="argument resume must be the path of a folder, but was "):
            sweep(resume=given, make=lambda c: 1 / 0)


def test_numbers_from_python_are_refused_where_a_folder_could_not_tell_them(scene, sweep):
    grasp, state = scene
    shape = jax.ShapeDtypeStruct((), np.float64)
    take = lambda c: jax.pure_callback(lambda x: 2.0 * x, shape, c, vmap_method="sequential")  # noqa: E731
    with pytest.raises(ValueError, match="argument make must not take numbers from Python"):
        sweep(make=lambda c: (grasp.with_(damping=take(c)), state))


BAD = {
    "make": (["text", None, 3, lambda c: c, lambda c: (c, c), lambda c: None], "argument make must "),
    "keep": (
        ["text", 3, lambda run: None, lambda run: "text", lambda run: [object()]],
        "argument keep must ",
    ),
    "rows": (
        ["text", None, 3.0, np.array([object()]), [], [1.0, 2.0], np.zeros(0), jax.random.key(0), ["a", "b"]],
        "argument parameters must ",
    ),
    "t1": (["text", None, [0.1, 0.2], np.zeros(10), True], "argument t1 must "),
    "chunk": (["text", None, 0, -1, 2.5, True, np.ones(2)], "argument chunk must be a whole number"),
    "progress": (["text", None, 1, lambda n: n], "argument progress must be True or False"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_get_one_sentence(name, sweep, calls):
    values, wanted = BAD[name]
    for value in values:
        for resume in ({"resume": None}, {}):
            with pytest.raises(ValueError, match=wanted) as caught:
                sweep(**{name: value}, **resume)
            assert "\n" not in str(caught.value) and len(str(caught.value)) < 250
    assert not calls


def test_a_sweep_is_no_part_of_a_traced_program(sweep):
    for name in ("rows", "factor"):
        with pytest.raises(ValueError, match="trac"):
            jax.jit(lambda x, name=name: sweep(**{name: x * 2.0}, resume=None))(
                ROWS if name == "rows" else 1.0
            )


def marked(**digests):
    return {name: _identity.Mark(digest, f"{digest}!") for name, digest in digests.items()}


@pytest.mark.parametrize(
    ("there", "here", "told"),
    [
        ({"t1": "1"}, {"t1": "1"}, ""),
        ({"t1": "1"}, {"t1": "2"}, "t1 (1! there, 2! here)"),
        ({"make": "1"}, {}, ""),
        ({"make": "1", "keep": "1"}, {"make": "2", "keep": "2"}, "make (1! there, 2! here)"),
        (
            {"t1": "1", "make": "1", "keep": "1"},
            {"t1": "2", "make": "1", "keep": "2"},
            "t1 (1! there, 2! here)",
        ),
        (
            {"t1": "1", "make": "1"},
            {"t1": "2", "make": "2"},
            "t1 (1! there, 2! here), make (1! there, 2! here)",
        ),
        ({"precision": "1", "make": "1"}, {"precision": "2", "make": "2"}, "precision (1! there, 2! here)"),
        (
            {"parameters": "1", "make": "1"},
            {"parameters": "2", "make": "2"},
            "parameters (1! there, 2! here)",
        ),
        ({"chunk": "1"}, {}, "chunk (1! there, not given here)"),
    ],
)
def test_of_what_differs_the_causes_are_named_and_not_what_follows_from_them(there, here, told):
    assert _identity.differences(marked(**there), marked(**here)) == told


def test_of_many_differences_some_are_named_and_the_rest_counted():
    names = [f"option {k}" for k in range(9)]
    there, here = ({name: _identity.Mark(x, "same") for name in names} for x in "ab")
    found = _identity.differences(there, here)
    assert found == "option 0, option 1 and 7 more"
    fewer = [{name: marks[name] for name in names[:2]} for marks in (there, here)]
    assert _identity.differences(*fewer) == "option 0, option 1"
    assert _identity._short("x" * 60) == "x" * 60 and _identity._short("x" * 61) == "x" * 56 + " ..."
