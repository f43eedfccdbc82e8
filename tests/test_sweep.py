"""Sweeps: chunks, failures, resumption, and lanes that wait for nobody; of a disc on a plate that swings."""

import inspect
import types
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._integration import _batch
from jaxroll._sweep import _program, _sweep
from jaxroll._xla._one_kernel import WIDE
from tests.subjects import rolling_disc
from tests.subjects.swinging_plate import swinging as make

RUNS = 150


@pytest.fixture(scope="module")
def dampings():
    """For runs of between seven steps and seventeen."""
    return np.linspace(0.4, 8.0, RUNS)


@pytest.fixture(scope="module")
def whole(dampings):
    """More runs than slots, each saved at four times."""
    return jxr.sweep(make, dampings, 0.2, ts=4, rtol=1e-7)


def test_a_sweep_is_the_mapped_run(dampings, whole):
    """To the last bit, if compiled for the same vectors."""
    mapped = jax.vmap(lambda c: jxr.simulate(*make(c), 0.2, ts=4, rtol=1e-7))
    same = jax.jit(mapped, compiler_options=WIDE)(dampings)
    np.testing.assert_array_equal(whole.last.q, same.last.q)
    np.testing.assert_array_equal(whole.states.q, same.states.q)
    assert isinstance(whole, jxr.Trajectory) and str(RUNS) in str(whole)


def test_more_runs_than_slots_with_several_save_times(dampings, whole):
    """Every run is served, and every row is its own."""
    ts, q = np.asarray(whole.ts), np.asarray(whole.states.q)
    one = jax.jit(lambda c: jxr.simulate(*make(c), 0.2, ts=4, rtol=1e-7))
    for i in (0, 70, RUNS - 1):
        alone = one(dampings[i])
        np.testing.assert_allclose(q[i], alone.states.q, rtol=0, atol=1e-8)
        np.testing.assert_allclose(ts[i], alone.ts)
    assert (np.asarray(whole.result._value) == 0).all()


def test_chunks_change_nothing_and_compile_once(dampings, whole, capsys):
    traces = []

    def counted(c):
        traces.append(1)
        return make(c)

    told = {"ts": 4, "rtol": 1e-7, "chunk": 64, "keep": lambda run: run.last.q, "progress": True}
    ends = jxr.sweep(counted, dampings, 0.2, **told)
    np.testing.assert_allclose(ends, whole.last.q, rtol=0, atol=1e-12)
    assert len(traces) == 1
    assert f"{RUNS} of {RUNS} runs" in capsys.readouterr().err


def test_a_cut_off_sweep_goes_on_where_it_was(dampings, whole, tmp_path):
    settings = {"ts": 4, "rtol": 1e-7, "chunk": 64, "keep": eqx.Partial(_last), "resume": tmp_path}
    first = jxr.sweep(make, dampings, 0.2, **settings)
    np.testing.assert_allclose(first, whole.last.q, rtol=0, atol=1e-12)
    files = sorted(tmp_path.glob("*.npz"))
    assert len(files) == 3
    files[1].unlink()
    written = [files[i].stat().st_mtime_ns for i in (0, 2)]
    ends = jxr.sweep(make, dampings, 0.2, **settings)
    np.testing.assert_array_equal(ends, first)
    assert written == [files[i].stat().st_mtime_ns for i in (0, 2)] and files[1].exists()
    with pytest.raises(ValueError, match="argument resume must be a folder of the same sweep"):
        jxr.sweep(make, 2.0 * dampings, 0.2, **settings)


def test_what_make_closes_over_is_seen_as_it_is_now(monkeypatch):
    """A notebook's variable changes and the same function is swept again: the numbers are the new ones."""
    factor, table = 1.0, np.array([1.0, 2.0])

    def own(c):
        return make(c * factor * jnp.asarray(table)[1])

    settings = {"keep": eqx.Partial(_last), "rtol": 1e-7, "chunk": 50}
    sweep = lambda: jxr.sweep(own, np.linspace(0.2, 0.4, 50), 0.2, **settings)  # noqa: E731
    programs = lambda: len(_program._KEPT)  # noqa: E731
    monkeypatch.setattr(_program, "_KEPT", type(_program._KEPT)())
    monkeypatch.setattr(_program.Program, "__call__", lambda self, rows: self.call)  # compiles nothing
    monkeypatch.setattr(_sweep, "_pieces", lambda run, *_, **__: [np.array([run.call])])
    first = sweep()[0]
    assert sweep()[0] is first and programs() == 1
    factor = 2.0
    second = sweep()[0]
    assert second is not first and programs() == 2
    table[1] = 3.0
    assert sweep()[0] not in (first, second) and programs() == 3
    factor, table[1] = 1.0, 2.0
    assert sweep()[0] is first and programs() == 3


def _last(run):
    return run.last.q


def test_what_functions_in_the_grasp_hold_is_seen_as_it_is_now():
    """A law's own list, and what its class reads of a module: the program of the run inside is another."""
    own, module, t1 = [1.0], types.ModuleType("settings"), 0.05

    class Law(eqx.Module):
        share: Callable = eqx.field(static=True)

        def __call__(self, t, joints, rates, tips):
            return [jnp.array([self.share() * module.force])]

    grasp, state = rolling_disc.on_driven_plate(Law(lambda: own[0]))
    start = lambda v: (grasp, eqx.tree_at(lambda s: s.v, state, v))  # noqa: E731
    for own[0], module.force in ((1.0, 0.5), (1.4, 0.5), (1.0, 0.7), (1.0, 0.5)):
        moved = jxr.sweep(start, np.zeros((1, 4)), t1, keep=_last, events=())[0, 3]
        wanted = 0.5 * own[0] * module.force / rolling_disc.MOVED * t1**2
        assert float(moved) == pytest.approx(wanted, rel=1e-9)


def test_what_cannot_be_read_to_its_end_is_traced_anew():
    chain = None
    for _ in range(100_000):
        chain = [chain]
    assert _program._held(chain) != _program._held(chain)
    assert _program._held([1, "a"]) == _program._held([1, "a"])


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"make": lambda c: 1 if c > 0.5 else 2}, "argument make must compute with jax.numpy"),
        ({"keep": lambda run: float(run.last.q[0])}, "argument keep must compute with jax.numpy"),
        (
            {"keep": lambda run: {1: run.last.q, "a": run.last.q}},
            "argument keep must return arrays of numbers",
        ),
    ],
)
def test_functions_that_ask_for_values_are_refused_by_name(dampings, changed, words):
    given = {"make": make, "keep": None} | changed
    with pytest.raises(ValueError, match=words):
        jxr.sweep(given["make"], dampings, 0.2, keep=given["keep"])


def test_runs_that_fail_keep_their_codes(dampings):
    one = np.where(np.arange(RUNS) == 70, np.nan, dampings)
    table = jxr.sweep(make, one, 0.2, ts=4, rtol=1e-7)
    failed = np.asarray(table.result._value) != 0
    assert failed[70] and failed.sum() == 1
    assert np.isfinite(np.delete(table.last.q, 70, axis=0)).all()


def test_bad_arguments(dampings):
    with pytest.raises(ValueError, match="argument parameters must hold arrays with one common leading axis"):
        jxr.sweep(lambda p: make(p[0]), (dampings, dampings[:3]), 0.2)
    with pytest.raises(ValueError, match="argument chunk must be a whole number of at least 1, but was 0"):
        jxr.sweep(make, dampings, 0.2, chunk=0)
    with pytest.raises(ValueError, match=r"argument make must be a function of one row .* callable as f\(\)"):
        jxr.sweep(lambda: make(0.4), dampings, 0.2)
    with pytest.raises(
        ValueError, match=r"argument keep must be a .*trajectory, .* callable as f\(grasp, run\)"
    ):
        jxr.sweep(make, dampings, 0.2, keep=lambda grasp, run: run)


def test_slots_waste_little_on_runs_of_unlike_cost(monkeypatch):
    """Steps that slots take, busy or not, over steps that runs need: at most 1.3 at a fivefold spread."""
    turns = []
    inner = _batch.Ensemble._turn

    def counted(self, carry):
        jax.debug.callback(lambda: turns.append(self.slots))
        return inner(self, carry)

    monkeypatch.setattr(_batch.Ensemble, "_turn", counted)
    run = lambda c: jxr.simulate(*make(c), 0.3, ts=1, rtol=1e-5)  # noqa: E731
    steps = np.asarray(jax.jit(jax.vmap(run))(np.geomspace(0.4, 40.0, 1024)).stats.steps)
    jax.effects_barrier()
    assert steps.max() > 5 * steps.min()
    assert sum(turns) / steps.sum() <= 1.3


def test_slots_served_all_at_once_give_the_same(dampings, whole, monkeypatch):
    """The way of accelerators, on this machine."""
    monkeypatch.setattr(_batch.Ensemble, "_one_by_one", _batch.Ensemble._together)
    # A number of steps of its own, so that nothing is taken from what was traced before, nor left for others.
    other = jxr.sweep(lambda c: make(c), dampings, 0.2, ts=4, rtol=1e-7, max_steps=4095)
    # Another program rounds otherwise, and a step more or less is an error of the tolerance's order.
    np.testing.assert_allclose(other.last.q, whole.last.q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(other.stats.steps, whole.stats.steps, atol=2)


def test_every_option_of_a_run_is_one_of_a_sweep_with_the_same_default():
    """But for how much is saved, and for raising: the runs of a sweep carry their codes."""
    one, many = (inspect.signature(f).parameters for f in (jxr.simulate, jxr.sweep))
    own = {"make", "parameters", "keep", "chunk", "progress", "resume", "store", "client"}
    assert set(many) - own == set(one) - {"grasp", "state", "throw"}
    unlike = {name for name in set(one) & set(many) if one[name].default != many[name].default}
    assert unlike == {"ts"} and many["ts"].default == 1
    assert not any(p.kind is p.VAR_KEYWORD for p in (*one.values(), *many.values()))


def test_of_many_compiled_programs_those_used_last_are_kept(monkeypatch):
    monkeypatch.setattr(_program, "_KEPT", type(_program._KEPT)())
    monkeypatch.setattr(_program, "_MOST", 2)
    traced = [jax.make_jaxpr(lambda x, k=k: x + k)(1.0) for k in range(3)]
    first, second = (_program._compiled(closed) for closed in traced[:2])
    assert _program._compiled(traced[0]) is first
    _program._compiled(traced[2])
    assert len(_program._KEPT) == 2
    assert _program._compiled(traced[0]) is first and _program._compiled(traced[1]) is not second
