"""Bad input: one sentence with the argument, what it must be and what it was. Bad runs: a code."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._linalg._plane import Vec2
from jaxroll.geometry import frenet
from tests.subjects import rolling_disc

CIRCLE = jxr.Circle(0.01)


def finger(**changes):
    given = {"lengths": [0.1, 0.1], "masses": [0.1, 0.1], "tip": CIRCLE} | changes
    return jxr.Finger(**given)


class Parabola(jxr.AbstractContour):
    """A user's contour whose parameter is not its arclength."""

    closed = False
    smoothness = float("inf")

    def curve(self, s):
        return Vec2(-50.0 * s * s, s)

    def frame(self, s):
        return frenet(self.curve, s)

    def prepared(self):
        return self

    def domain(self):
        return None


BODY = jxr.PivotedObject(jxr.Catenary(0.01, (-0.01, 0.01)), 1e-5)
BAD = {
    "negative mass": (
        lambda: finger(masses=[0.1, -0.2]),
        r"argument masses must be positive, but was \[0.1, -0.2\]",
    ),
    "NaN length": (lambda: finger(lengths=[0.1, np.nan]), "argument lengths must be finite"),
    "too few masses": (
        lambda: finger(masses=[0.1]),
        r"argument masses must have shape \(2\), but had shape \(1,\)",
    ),
    "lengths not a vector": (lambda: finger(lengths=0.1), "argument lengths must have shape"),
    "tip not a contour": (lambda: finger(tip=0.01), "argument tip must be a contour, but was 0.01"),
    "zero radius": (lambda: jxr.Circle(0.0), "argument radius must be positive, but was 0.0"),
    "negative axis": (lambda: jxr.Ellipse(0.1, -1), "argument b must be positive, but was -1"),
    "reversed domain": (lambda: jxr.Line((1, 0)), "argument domain must be increasing"),
    "no contours": (lambda: jxr.PivotedObject((), 1e-5), "argument contours must be one or more"),
    "negative inertia": (
        lambda: jxr.FreeObject(CIRCLE, 1, -1),
        "argument inertia must be positive",
    ),
    "3-vector base": (lambda: finger(base=(0, 0, 0)), r"argument base must have shape \(2\)"),
    "sense": (lambda: jxr.Contact(sense=0), "argument sense must be 1 or -1, but was 0"),
    "contour out of range": (
        lambda: jxr.Grasp(BODY, finger(), jxr.Contact(0.0, 0.02)),
        r"argument contacts\[0\].s_object must lie between -0.01 and 0.01 m, but was 0.02",
    ),
    "no such finger": (
        lambda: jxr.Grasp(BODY, finger(), jxr.Contact(finger=1)),
        r"argument contacts\[0\].finger must be below 1, but was 1",
    ),
    "no such contour": (
        lambda: jxr.Grasp(BODY, finger(), jxr.Contact(contour=2)),
        r"argument contacts\[0\].contour must be below 1, but was 2",
    ),
    "not by arclength": (
        lambda: jxr.Grasp(BODY, finger(tip=Parabola()), jxr.Contact(0.01, 0.0)),
        r"argument contacts\[0\].s_tip must lie on a contour given by arclength .* Parabola there was 1.41",
    ),
    "gravity": (
        lambda: jxr.Grasp(BODY, finger(), jxr.Contact(), gravity=9.81),
        r"argument gravity must have shape \(2\) or \(2, 2\), but had shape \(\)",
    ),
    "CSM gain": (lambda: jxr.CSM(gamma_f=-1.0), "argument gamma_f must be positive, but was -1"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_parts(case):
    build, sentence = BAD[case]
    with pytest.raises(ValueError, match=sentence):
        build()


def bad_runs(grasp, state):
    """Calls of simulate that must be refused, with the sentence they get."""
    wrong = jxr.State(state.q[:2], state.v, state.s)
    unset = jxr.State(state.q, state.v.at[0].set(jnp.nan), state.s)
    off = jxr.State(state.q + 0.01, state.v, state.s)
    # Both contact points move alike: the gap stays below 1e-12 m, the tangents part by 1e-5 rad.
    tilted = jxr.State(state.q, state.v, state.s + 1e-7)
    single = jax.tree.map(lambda x: x.astype(jnp.float32), (grasp, state))
    sim = jxr.simulate
    return [
        (
            lambda: sim(grasp, wrong, 1.0),
            r"argument state.q must have shape \(3,\), but had \(2,\)",
        ),
        (lambda: sim(grasp, unset, 1.0), "argument state.v must be finite"),
        (
            lambda: sim(grasp, off, 0.01, ts=1),
            "must be on the constraints to 1e-09, but its worst row",
        ),
        (
            lambda: sim(grasp, tilted, 0.01, ts=1),
            r"must be on the constraints to 1e-09, but its worst row is 1\.\d+e-05 m or rad off",
        ),
        (lambda: sim(grasp, state, 0.0), "argument t1 must be above t0 = 0, but was 0"),
        (lambda: sim(grasp, state, 1.0, ts=[0.5, 0.2]), "argument ts must rise strictly"),
        (lambda: sim(grasp, state, 1.0, ts=[0.5, 2.0]), r"argument ts must lie within \[0, 1\]"),
        (lambda: sim(grasp, state, 1.0, ts=[-0.5, 0.5]), r"argument ts must lie within \[0, 1\]"),
        (lambda: sim(grasp, state, 1.0, ts=[[0.5]]), r"argument ts must be a number of times"),
        (lambda: sim(grasp, state, 1.0, ts=[]), r"argument ts must be a number of times"),
        (lambda: sim(grasp, state, 1.0, ts=[0.5, 0.5]), "argument ts must rise strictly"),
        (lambda: sim(grasp, state, 1.0, ts=[np.nan]), "argument ts must be finite, but was .nan."),
        (lambda: sim(grasp, state, 1.0, ts=[1.0 + 1e-13]), "within .0, 1., but ran from 1.0000000000001 to"),
        (lambda: sim(grasp, state, 1.0, ts=0), "argument ts must be a whole number of at least 1, but was 0"),
        (lambda: sim(grasp, state, 1.0, rtol=-1.0), "argument rtol must be positive, but was -1"),
        (lambda: sim(*single, 1.0), "argument rtol must be at least 1e-05 in single precision"),
        (lambda: sim(grasp, state, 1.0, record=("forces",)), "argument record must be among"),
        (
            lambda: sim(grasp, state, 1.0, record="energy"),
            r"argument record must be a tuple of names, such as \('energy',\), but was the string 'energy'",
        ),
        (lambda: sim(grasp, state, 1.0, solver="rk4"), "argument solver must be a diffrax solver"),
    ]


@pytest.mark.parametrize("index", range(17))
def test_bad_runs(scene, index):
    call, sentence = bad_runs(*scene)[index]
    with pytest.raises(ValueError, match=sentence):
        call()


def test_unreachable_start_names_the_worst_row():
    with pytest.raises(ValueError, match=r"but the best found leaves the .* of contact 0 at 0\.\d+"):
        jxr.scenes.pivoted(pivot=(0.3, 0.3))


def test_with_refuses_unknown_and_misshapen_fields(scene):
    grasp, _ = scene
    with pytest.raises(ValueError, match="argument colour must name one field .* but none has it"):
        grasp.with_(colour=1)
    with pytest.raises(ValueError, match=r"argument pivot must have shape \(2\)"):
        grasp.with_(pivot=1.0)


def test_a_controller_with_a_memory_is_a_module(scene):
    class Law:
        memory = np.zeros(1)

        def __call__(self, t, angles, rates, tips, memory):
            return angles, memory

    told = "argument controller must be an equinox.Module where it has a memory, but was .*Law"
    with pytest.raises(ValueError, match=told):
        scene[0].with_(controller=Law())


def test_controller_of_the_wrong_shape(scene):
    grasp, state = scene
    bad = grasp.with_(controller=lambda t, angles, rates, tips: (jnp.zeros(3),))
    with pytest.raises(ValueError, match="argument controller must return one torque array per"):
        jxr.simulate(bad, state, 0.01)


X64_OFF = """
import jaxroll as jxr
grasp, state = jxr.scenes.pivoted()
jxr.simulate(grasp, state, 0.1)
"""


def test_x64_off_gets_a_sentence_with_the_remedy():
    run = subprocess.run([sys.executable, "-c", X64_OFF], capture_output=True, text=True, check=False)
    assert "jax.config.update('jax_enable_x64', True)" in run.stderr.splitlines()[-1]


def test_step_limit_keeps_what_was_computed(scene):
    grasp, state = scene
    soon = 0.03

    def few(t1, **options):
        return jxr.simulate(grasp, state, t1, ts=[soon, t1], max_steps=8, **options)

    cut = few(1.0, throw=False)
    assert cut.result == jxr.RESULTS.max_steps_reached
    early, never = np.asarray(cut.states.q)
    np.testing.assert_allclose(early, jxr.simulate(grasp, state, soon, ts=1).last.q, atol=1e-9)
    assert np.isnan(never).all()
    assert np.isfinite(np.asarray(cut.last.q)).all() and float(cut.stats.t_end) < 1.0
    assert "step limit" in str(cut)
    with pytest.raises(RuntimeError, match="The step limit was reached"):
        few(1.0)
    # With the last of its steps a run may come to its end, and has not run out of them.
    limit = float(cut.stats.t_end)
    assert few(limit, throw=False).result == jxr.RESULTS.successful
    assert few(1.001 * limit, throw=False).result == jxr.RESULTS.max_steps_reached


@pytest.mark.parametrize("derivative", [jax.grad, jax.jacfwd])
def test_runs_that_fail_in_a_derivative_say_why(derivative):
    """Outside of `jit` the code is known there, though what is differentiated is traced."""
    grasp, state = rolling_disc.on_slope(0.1)

    def travelled(mass, **options):
        options |= {"ts": 1, "max_steps": 4, "events": ()}
        return jxr.simulate(grasp.with_(mass=mass), state, 1.0, **options).last.q[0]

    with pytest.raises(RuntimeError, match=r"The step limit was reached at t = 0\.\d+ s, after 4 steps"):
        derivative(travelled)(0.05)
    assert np.isfinite(derivative(lambda mass: travelled(mass, throw=False))(0.05))


def test_end_of_an_open_contour_is_a_code(scene):
    """The same motion on an object contour that ends where the contact will pass."""
    _, state = scene
    free, _ = jxr.scenes.pivoted()
    old = free.object.contours[0]
    short = jxr.Catenary(0.01, (-0.0065, 0.02)).moved(old.offset, old.angle, origin=old.origin)
    grasp = free.with_(contours=(short,))
    run = jxr.simulate(grasp, state, 3.0, ts=31, throw=False)
    assert run.result == jxr.RESULTS.contour_end
    assert 0.0 < float(run.stats.t_end) < 3.0
    low = float(short.domain()[0])
    assert abs(float(run.states.s[0, 0] - run.last.s[0] + 0.003) - low) < 1e-3
    with pytest.raises(RuntimeError, match="ran to the end of an open contour"):
        jxr.simulate(grasp, state, 3.0, ts=31)


def test_vanishing_curvature_sum_is_a_code():
    """A flat fingertip on a flat face cannot roll."""
    grasp, state = jxr.scenes.pivoted()
    flat = grasp.with_tip(0, jxr.Line().moved((0.0, -0.01), -np.pi / 2))
    flat = flat.with_(contours=(jxr.Line().moved((-0.02, 0.0), np.pi),))
    flat = flat.with_contacts(jxr.Contact(0.0, 0.0))
    _, start = jxr.close(flat, state, throw=False)
    run = jxr.simulate(flat, start, 0.1, ts=3, throw=False)
    assert run.result == jxr.RESULTS.singular_contact and float(run.stats.t_end) == 0.0


def test_no_nan_under_a_success_code(scene):
    grasp, state = scene
    run = jxr.simulate(grasp.with_(controller=nan_torque), state, 0.1, ts=3, throw=False)
    assert run.result == jxr.RESULTS.not_finite
    assert float(run.stats.t_end) == pytest.approx(0.05, abs=1e-6)


def nan_torque(t, angles, rates, tips):
    """A controller that breaks half way."""
    return (jnp.where(t > 0.05, jnp.nan, 0.0) * angles[0],)
