"""Any arguments to any public name: a result, a result code or one sentence (see benchmarks/hostile.py)."""

import contextlib
import inspect
import io

import equinox as eqx
import jax
import numpy as np
import pytest
from hypothesis import given, HealthCheck, Phase, settings

from benchmarks import hostile
from benchmarks.hostile_calls.valid_calls import calls
from benchmarks.hostile_calls.values import made, names_for, NUMERIC, planar, planar_run, sensible, spatial

# What no argument, or no number of any shape, can be.
OF_NO_USE = ("thing", "NaN", "minus one", "zero", "two numbers", "empty list")
# Of these, something that takes long is made before they are looked at: the drawn examples try them.
DEAR = {("design", "folder"), ("optimise_fingertip", "interval")}
DEAR |= {("loci", "grasp"), ("link_clearance", "grasp"), ("pinch_balance", "grasp")}
# Here another argument is at fault: a function without cases does not take any; values are one more than
# their times.
OTHERS = {("ClosedLoop", "cases"), ("Firmness", "cases"), ("Steps", "times")}
# Numbers that decide what a program is made of: these classes ask for them before anything is traced.
KNOWN = {("ClosedLoop", name) for name in ("t0", "rtol", "atol", "dt0")} | {("PeriodicNetwork", "decay")}
KNOWN |= {(name, "smoothness") for name in ("Chart", "Implicit", "Parametric")}
KNOWN |= {("Superellipsoid", "exponent")}


def test_hostile_arguments_are_answered_or_refused(tmp_path, monkeypatch):
    """200 examples, always the same ones; all offences are told at once."""
    monkeypatch.chdir(tmp_path)
    seen = []

    @settings(
        max_examples=200,
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(hostile.examples(refused=True))
    def tried(example):
        seen.append((example, hostile.outcome(example)))

    tried()
    assert len(seen) == 200
    assert all(ended.good for _, ended in seen), hostile.report(seen)


MET = """
smoothing_for points: empty rows; smoothing_for noise: decimal; crossings points: empty rows
fit_surface smallest_radius: one; grasp_points object: finger; Stage motion: run in the plane
identify measured: ragged; identify noise: ragged; sobol beta: complex array
sweep rtol: itself and infinity; sweep dt0: itself and infinity
save path: a page of text; load path: a page of text; optimise_fingertip checkpoint: a page of text
pose state: NaN in it; pose state: one axis more in all; plotting.contact_geometry state: NaN in it
plotting.contact_geometry state: one axis more in all
parameter_map x: code; parameter_map at: zero; parameter_map values: ragged; parameter_map values: key
"""


def test_offences_once_met_are_answered(tmp_path, monkeypatch):
    """What was silent or raw when every value stood in the place of every argument (`--singly`)."""
    monkeypatch.chdir(tmp_path)
    seen = []
    for line in MET.replace("\n", ";").split(";"):
        if line.strip():
            place, value = line.split(":")
            name, parameter = place.split()
            example = hostile.Example(name, ((parameter, value.strip()),))
            seen.append((example, hostile.outcome(example)))
    assert len(seen) == 22 and all(ended.good for _, ended in seen), hostile.report(seen)


def test_columns_that_are_shortened_alike_make_a_table():
    shorter = "its last left out"
    alone = hostile.outcome(hostile.Example("Ramps", (("times", shorter),)))
    both = hostile.outcome(hostile.Example("Ramps", (("times", shorter), ("values", shorter))))
    assert (alone.kind, both.kind) == ("sentence", "result")


@pytest.mark.slow
def test_a_twelfth_of_all_single_values_is_answered(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    seen = hostile.one_by_one(5, 12, None)
    assert len(seen) > 5000 and all(ended.good for _, ended in seen), hostile.report(seen)


def useless(argument):
    """What cannot be this argument: the object, and for numbers NaN, wrong signs and wrong shapes too."""
    for name in OF_NO_USE if argument.kind in (*NUMERIC, "count") else OF_NO_USE[:1]:
        if name in names_for(argument.kind) and name not in argument.taken:
            valid = argument.valid() if name != "thing" else None
            if not sensible(argument.kind, name, made(argument.kind, name, valid), valid):
                yield name


def test_every_argument_is_named_where_it_is_of_no_use(tmp_path, monkeypatch):
    """One after the other, all others as they should be."""
    monkeypatch.chdir(tmp_path)
    seen, unnamed = [], []
    for call in calls().values():
        for parameter, argument in call.arguments.items():
            if (call.name, parameter) in DEAR:
                continue
            for value in useless(argument):
                example = hostile.Example(call.name, ((parameter, value),))
                ended = hostile.outcome(example)
                seen.append((example, ended))
                if not ended.words.startswith(f"argument {parameter}"):
                    unnamed.append((call.name, parameter))
    assert len(seen) > 2000
    assert all(ended.kind == "sentence" for _, ended in seen), hostile.report(seen)
    assert set(unnamed) == OTHERS


def test_numbers_of_records_may_be_traced():
    """But for some, which say so: a check of a number's value must let pass what has none yet."""
    seen, refused = [], set()
    for call in calls().values():
        if not inspect.isclass(call.function) or call.slow:
            continue
        for parameter, argument in call.arguments.items():
            valid = argument.valid() if argument.kind in NUMERIC else None
            if np.asarray(valid).dtype.kind not in "fi" or (call.name, parameter) in OTHERS:
                continue
            given = {name: call.arguments[name].valid() for name in call.needed} | {parameter: valid}
            with contextlib.suppress(ValueError):
                call.function(**given)
                seen.append((call.name, parameter))
                try:
                    jax.eval_shape(lambda x: call.function(**given | {parameter: x}) and 0, valid)  # noqa: B023
                except ValueError as error:
                    assert hostile.is_one_sentence(str(error)) and "trace" in str(error)
                    refused.add((call.name, parameter))
    assert len(seen) > 120 and refused == KNOWN


@pytest.mark.slow
def test_traced_numbers_are_taken_or_refused_in_a_sentence(tmp_path, monkeypatch):
    """Of every argument of every public name: under `jax.jit` nothing ends in an error of JAX's own."""
    monkeypatch.chdir(tmp_path)
    planar(), spatial(), planar_run()  # kept by the examples, and so not to be made while something is traced
    seen, raw = 0, []
    for call in calls().values():
        for parameter, argument in call.arguments.items():
            given = {name: call.arguments[name].valid() for name in call.needed if name != parameter}
            moving, still = eqx.partition(
                argument.valid(), lambda x: isinstance(x, float) or eqx.is_inexact_array_like(x)
            )
            if not jax.tree.leaves(moving):
                continue

            def answer(x, call=call, given=given, parameter=parameter, still=still):
                out = call.function(**given, **{parameter: eqx.combine(x, still)})
                return [leaf for leaf in jax.tree.leaves(out) if isinstance(leaf, jax.Array)]

            seen += 1
            try:
                with contextlib.redirect_stdout(io.StringIO()):
                    jax.jit(answer).trace(moving)
            except Exception as error:
                if not (isinstance(error, ValueError) and hostile.is_one_sentence(str(error))):
                    raw.append((call.name, parameter, repr(error)[:200]))
    assert seen > 400 and not raw, raw


def test_every_public_name_has_an_example():
    """`calls` raises where a name or one of its parameters has none."""
    assert len(calls()) > 100


def test_the_judge_knows_offences():
    assert hostile.is_one_sentence("argument radius must be positive, but was -1.0")
    for page in ("argument radius\nmust be positive", "argument radius must be " + 300 * "x", "bad radius"):
        assert not hostile.is_one_sentence(page)
