"""Sweeps on other processes: what is sent there, what comes back, and what becomes of those that are killed.

But for the slow tests nothing is compiled: threads stand for processes, for what they are sent is pickled all
the same, and a chunk's program is replaced by numbers that say which run they are of; it is known by what was
traced, for to write it down as it is compiled takes long.
"""

import contextlib
import errno
import multiprocessing
import os
import pathlib
import pickle
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._sweep import _dispatch, _folder, _identity, _sending
from jaxroll._sweep._program import Job, of_make, Program, program
from jaxroll._sweep._sending import packed
from tests.recorded import runs
from tests.subjects.swinging_plate import swinging

ROWS = np.linspace(0.004, 0.008, 10)
REAL = np.linspace(0.004, 0.008, 60)


def of_first(program, rows):
    """In place of a program: everything is the first number of the first row."""
    first = float(jax.tree.leaves(rows)[0][0])
    return jax.tree.map(lambda form: np.full(form.shape, first).astype(form.dtype), program.results)


@pytest.fixture
def calls(monkeypatch):
    """The first parameters of the chunks that were worked out."""
    found = []

    def call(self, rows):
        found.append(float(jax.tree.leaves(rows)[0][0]))
        return of_first(self, rows)

    monkeypatch.setattr(Program, "__call__", call)
    monkeypatch.setattr(Program, "fingerprint", Program.key)
    monkeypatch.setattr(_sending, "_AT_HAND", type(_sending._AT_HAND)())
    return found


@pytest.fixture
def threads(calls):
    """Ended before `calls` is: a chunk that is still under way would be compiled."""
    with ThreadPoolExecutor(2) as executor:
        yield executor


def swept(client, rows=ROWS, **changes):
    grasp, state = swinging()
    factor = changes.pop("factor", 1.0)
    make = changes.pop("make", lambda c: (grasp.with_(damping=factor * c), state))
    given = {"chunk": 2, "keep": _ends, "rtol": 1e-7} | changes
    return jxr.sweep(make, rows, 0.2, client=client, **given)


def _ends(run):
    return run.last.q, run.result


def assert_same(found, wanted):
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


def test_an_executor_gives_what_this_process_does(threads, calls):
    assert_same(swept(threads), swept(None))
    assert len(calls) == 10
    # Another `make` of the same name is another job.
    assert len(swept(threads, factor=2.0)[0]) == 10 and len(calls) == 15


def test_results_go_to_the_folder_and_a_receipt_comes_back(threads, calls, tmp_path, monkeypatch):
    receipts, taken = [], _sending._Ready.chunk

    def chunk(self, start, rows):
        receipts.append(taken(self, start, rows))
        return receipts[-1]

    monkeypatch.setattr(_sending._Ready, "chunk", chunk)
    whole = swept(threads, resume=tmp_path)
    assert len(receipts) == 5 and max(len(pickle.dumps(receipt)) for receipt in receipts) < 200
    files = sorted(tmp_path.glob("*.npz"))
    assert len(files) == 5 and len(calls) == 5
    files[2].unlink()
    assert_same(swept(None, resume=tmp_path), whole)
    files[3].unlink()
    assert_same(swept(threads, resume=tmp_path), whole)
    assert len(calls) == 7


def test_a_worker_traces_and_compiles_once(threads, calls, monkeypatch):
    traced = []

    def counted(*given):
        traced.append(given)
        return program(*given)

    monkeypatch.setattr(_sending, "program", counted)
    swept(threads, rows=np.linspace(0.004, 0.008, 40))
    assert len(traced) == 1 and len(calls) == 20


def test_what_fails_for_a_while_is_sent_again(threads, calls, monkeypatch):
    taken, failures = _sending._Ready.computed, [OSError(errno.ENOSPC, "full"), OSError("gone")]

    def computed(self, start, rows):
        if start == 4 and failures:
            raise failures.pop()
        return taken(self, start, rows)

    monkeypatch.setattr(_sending._Ready, "computed", computed)
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    assert_same(swept(threads), swept(None))
    failures += [OSError(errno.ENOSPC, "full")] * 6
    with pytest.raises(OSError, match="full"):
        swept(threads)


def test_a_chunk_that_a_worker_cannot_write_is_used_all_the_same(threads, calls, tmp_path, monkeypatch):
    write = _folder.Folder.write

    def full(self, start, leaves):
        if start == 4:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, start, leaves)

    monkeypatch.setattr(_folder.Folder, "write", full)
    with pytest.warns(UserWarning, match="could not be written .No space left on device., but its runs are"):
        found = swept(threads, resume=tmp_path)
    assert_same(found, swept(None))


class Broken(Executor):
    """An executor, one of whose processes has ended."""

    def submit(self, function, *given):
        future = Future()
        future.set_exception(BrokenExecutor("ended"))
        return future


def test_a_broken_executor_says_what_to_do(calls):
    with pytest.raises(RuntimeError, match="the same call with another one goes on .BrokenExecutor."):
        swept(Broken())


class Dask:
    """In the place of the library: a client whose loop is the caller's."""

    class Client:
        asynchronous = True


@pytest.mark.parametrize("client", ["localhost:8786", 2, os, ThreadPoolExecutor, object()])
def test_what_is_no_client_is_refused(client, calls):
    with pytest.raises(ValueError, match="argument client must be a dask.distributed Client or a concurrent"):
        swept(client)


def test_a_client_that_does_not_wait_is_refused(calls, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", Dask)
    with pytest.raises(ValueError, match="argument client must not be asynchronous"):
        swept(Dask.Client())


def test_workers_that_are_not_like_this_process_are_refused(threads, calls, monkeypatch):
    """Other versions before anything is sent; other processors among workers before the first run."""
    machine, here = _identity.machine(), threading.main_thread()

    def other(name):
        def marks():
            changed = {name: _identity.Mark("another", "another")}
            return machine | (changed if threading.current_thread() is not here else {})

        return marks

    monkeypatch.setattr(_sending, "machine", other("version of jax"))
    with pytest.raises(ValueError, match=r"workers like this process, but .* version of jax \(another there"):
        swept(threads)
    turns = iter(range(9))
    late = lambda: other("processor")() if next(turns) else machine  # noqa: E731
    monkeypatch.setattr(_sending, "machine", late)
    with pytest.raises(ValueError, match=r"workers that are alike, but one differs in processor"):
        swept(threads)
    assert not calls


def test_another_program_on_a_worker_is_refused(threads, calls, monkeypatch):
    """A module of the caller's is another one there."""

    def other(job, rows):
        grasp, state = swinging()
        changed = lambda c: (grasp.with_(damping=3.0 * c), state)  # noqa: E731
        return program(Job(changed, job.keep, job.t1, job.options), rows)

    monkeypatch.setattr(_sending, "program", other)
    with pytest.raises(ValueError, match="argument make must be the same wherever it is computed"):
        swept(threads)


def test_a_forked_process_is_refused(threads, calls, monkeypatch):
    monkeypatch.setattr(_sending, "_HOME", -1)
    with pytest.raises(ValueError, match="argument client must start its processes afresh"):
        swept(threads)


def in_single_precision(leaf):
    return leaf.astype(np.float32) if eqx.is_inexact_array(leaf) else leaf


def test_settings_of_jax_go_along(threads, calls):
    """A thread has the settings of its own; afterwards it has them again."""
    threads.submit(lambda: None).result()
    grasp, state = jax.tree.map(in_single_precision, swinging())
    with jax.enable_x64(False), jax.numpy_rank_promotion("allow"):
        found = swept(threads, rtol=1e-4, make=lambda c: (grasp.with_(damping=c), state))
        assert found[0].dtype == np.float32
    assert threads.submit(lambda: jax.config.jax_enable_x64).result()
    assert swept(threads)[0].dtype == np.float64


class Counter(eqx.Module):
    """A law of a caller's own that holds an array."""

    gain: jax.Array

    def __call__(self, t, angles, rates, tips):
        return tuple(-self.gain * rate for rate in rates)


def _pivoted(make):
    """A `make` of the pivoted scene, from its grasp and state."""
    return lambda: make(*runs.scene("pivoted"))


def _with_a_table(grasp, state):
    table = np.linspace(0.0, 1.0, 7)
    return lambda c: (grasp.with_(damping=c * table[3]), state)


def _with_a_law(grasp, state):
    law = Counter(jnp.asarray(0.1))
    return lambda c: (eqx.tree_at(lambda g: g.controller, grasp, law), state)


def _with_a_jitted_function(grasp, state):
    table = np.linspace(0.0, 1.0, 7)
    jitted = jax.jit(lambda c: c * table[2])
    return lambda c: (grasp.with_(damping=jitted(c)), state)


def _with_points(grasp, state):
    tip = jxr.Spline(np.c_[np.cos(angles := np.linspace(0, 6, 12)), np.sin(angles)] * 0.01)
    return lambda c: (grasp.with_tip(0, tip.moved((c, 0.0))), state)


def _with_two_fingers():
    grasp, state = runs.scene("pinch")
    return lambda c: (grasp.with_(damping=c), state)


def _in_space():
    grasp, state = runs.scene("pinch3d")
    return lambda c: (grasp, state)


SENT = {
    "a closure over arrays": _pivoted(_with_a_table),
    "a law of one's own": _pivoted(_with_a_law),
    "a function that is jitted": _pivoted(_with_a_jitted_function),
    "closing": _pivoted(lambda g, at: lambda c: jxr.close(g, jxr.State(at.q + c, at.v, at.s))),
    "a partial": _pivoted(lambda g, at: eqx.Partial(lambda g, c: (g.with_(damping=c), at), g)),
    "two fingers": _with_two_fingers,
    "space": _in_space,
    "a contour from points": _pivoted(_with_points),
}


@pytest.mark.parametrize("name", SENT)
def test_what_is_sent_is_the_same_program_when_it_arrives(name):
    """Fingerprints of `make` before and after; whole programs are compared by `_check_program`."""
    pytest.importorskip("cloudpickle")
    make = SENT[name]()
    options = {"solver": diffrax.Tsit5(), "formulation": jxr.CSM(50.0)}
    arrived = pickle.loads(packed(Job(make, _ends, 0.2, options)))
    row = jnp.asarray(0.001)
    assert of_make(arrived.make, row) == of_make(make, row)
    assert jax.tree.structure(arrived.options) == jax.tree.structure(options)


STUBBORN = {
    "a lock": (threading.Lock(), "make", "variable 'stubborn' cannot be pickled: <unlocked"),
    "one in a dict": ({"a": threading.Lock()}, "make", r"\['a'\] of variable 'stubborn' cannot be pickled"),
    "a generator": ((x for x in "ab"), "make", "variable 'stubborn' cannot be pickled: <generator"),
}


@pytest.mark.parametrize("name", STUBBORN)
def test_what_cannot_be_sent_is_named(name, threads, calls):
    pytest.importorskip("cloudpickle")
    stubborn, argument, said = STUBBORN[name]
    grasp, state = swinging()

    def make(c):
        _ = stubborn
        return grasp.with_(damping=c), state

    with pytest.raises(ValueError, match=f"argument {argument} must be what can be sent .*{said}"):
        swept(threads, make=make)
    with pytest.raises(ValueError, match="argument keep must be what can be sent .* cannot be pickled: "):
        swept(threads, keep=lambda run: (run.last.q, stubborn)[0])
    assert not calls


def test_without_cloudpickle_functions_must_be_named(threads, calls, monkeypatch):
    monkeypatch.setitem(sys.modules, "cloudpickle", None)
    with pytest.raises(
        ImportError, match='this needs the library cloudpickle: pip install "jaxroll.cluster."'
    ):
        swept(threads)
    assert_same(swept(threads, make=named), swept(None, make=named))


def named(c):
    grasp, state = swinging()
    return grasp.with_(damping=c), state


def test_dask_is_not_imported():
    """A sweep on an executor needs none of it, and `import jaxroll` nothing of the extras."""
    heavy = "dask distributed zarr xarray"
    code = f"import sys, jaxroll._sweep; print([m for m in '{heavy}'.split() if m in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


@pytest.mark.slow
def test_processes_give_the_same_bits():
    """Those of the standard library, started afresh; forked ones are refused."""
    whole = swept(None, rows=REAL, chunk=16)
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=spawn) as executor:
        assert_same(swept(executor, rows=REAL, chunk=16), whole)


# What happens to a worker is asked for by files, each of which serves once: 'compiling.0' and so on.
class Killer:
    """A plugin of dask's workers: when a file asks for it, the worker is killed, or its disk full."""

    name = "killer"

    def __init__(self, folder):
        self.folder = folder

    def asked(self, moment):
        for path in pathlib.Path(self.folder).glob(f"{moment}.*"):
            with contextlib.suppress(FileNotFoundError):
                path.unlink()
                return True
        return False

    def setup(self, worker):
        from jaxroll._sweep import _sending, _store

        computed, put = _sending._Ready.computed, _store.Store._put

        def killed(seconds):
            threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGKILL)).start()

        def computing(ready, start, rows):
            if not ready.compiled and self.asked("compiling"):
                jax.config.update("jax_enable_compilation_cache", False)
                killed(0.5)
            elif ready.compiled and self.asked("running"):
                killed(0.001)
                time.sleep(0.02)
            return computed(ready, start, rows)

        def writing(store, name, *given):
            if name == "stored" and self.asked("full"):
                raise OSError(errno.ENOSPC, "No space left on device")
            if name == "stored" and self.asked("writing"):
                os.kill(os.getpid(), signal.SIGKILL)
            put(store, name, *given)

        _sending._Ready.computed, _store.Store._put = computing, writing


CLIENT = """
import sys
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", sys.argv[3])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
from dask.distributed import Client
from tests.test_sweep_client import many
many(Client(sys.argv[1]), sys.argv[2])
"""


def many(client, store):
    rows = np.linspace(0.004, 0.008, 400)
    return swept(
        client, rows=rows, store=store, chunk=8, keep=lambda run: {"q": run.last.q, "code": run.result}
    )


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="it kills by a signal")
def test_killed_workers_and_clients_cost_nothing_that_was_stored(tmp_path, monkeypatch):
    """Workers five times, clients twice, and a full disk; to the last bit what this process computes."""
    distributed = pytest.importorskip("distributed")
    pytest.importorskip("zarr")
    orders, store = tmp_path / "orders", tmp_path / "table.zarr"
    orders.mkdir()
    for i, moment in enumerate(("compiling", "running", "writing", "running", "writing", "full")):
        (orders / f"{moment}.{i}").write_text("")
    cache = str(jax.config.jax_compilation_cache_dir)
    # On a busy machine a worker takes longer to come back than a local cluster waits for it by default.
    import dask

    monkeypatch.setitem(dask.config.config["distributed"]["deploy"], "lost-worker-timeout", "300s")
    local = distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
    root = pathlib.Path(__file__).parents[1]
    kept = []
    with local, distributed.Client(local) as client:
        client.register_plugin(Plugin(str(orders)))
        for turn in range(2):
            command = [sys.executable, "-c", CLIENT, local.scheduler_address, str(store), cache]
            child = subprocess.Popen(command, cwd=root, stderr=subprocess.PIPE)
            _wait_for(lambda turn=turn: len(list(store.glob("sweep/*.sum"))) >= 6 * (turn + 1), child)
            child.kill()
            _, said = child.communicate(timeout=60)
            assert child.returncode == -signal.SIGKILL, said
            kept.append({path: path.stat().st_mtime_ns for path in store.glob("sweep/*.sum")})
        table = many(client, str(store)).load()
    assert not list(orders.iterdir())
    # What was stored when a client was killed was not written again.
    for stored in kept:
        assert len(stored) >= 6
        assert all(path.stat().st_mtime_ns == when for path, when in stored.items())
    whole = many(None, str(tmp_path / "other.zarr")).load()
    assert whole.drop_vars("sweep").identical(table.drop_vars("sweep"))
    assert bool(table.stored.all())


def Plugin(folder):
    """The plugin as dask wants it: a subclass of its own class."""
    from distributed import WorkerPlugin

    return type("Plugin", (Killer, WorkerPlugin), {})(folder)


def _wait_for(condition, child):
    end = time.monotonic() + 300
    while not condition():
        assert child.poll() is None, child.stderr.read()
        assert time.monotonic() < end
        time.sleep(0.01)


class Disk(Executor):
    """Answers at once: that the disk is full."""

    def submit(self, function, /, *args, **kwargs):
        answer = Future()
        answer.set_exception(OSError(errno.ENOSPC, "No space left on device"))
        return answer


def test_pauses_between_tries_double_up_to_two_seconds(monkeypatch):
    pauses = []
    monkeypatch.setattr(_dispatch.time, "sleep", pauses.append)
    parcel = _sending.Parcel(b"", {"jax_compilation_cache_dir": None}, 1)
    with pytest.raises(OSError, match="No space left"):
        _dispatch.dispatched(
            _dispatch.Party(Disk(), lambda: 1), parcel, {0: lambda: None}, lambda start, receipt: True
        )
    assert pauses == [0.2, 0.4, 0.8, 1.6, 2.0]
