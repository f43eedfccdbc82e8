"""What diffrax lends a run: every public solver, step-size control and meter works or gets one sentence.

The tables are checked against diffrax's own names: what a later version adds fails here until it is judged.
"""

import inspect

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest

import jaxroll as jxr
from jaxroll._integration._methods import check_method, on_tableau, Steady, with_tolerances
from tests.measures import both_slopes, observed_order
from tests.subjects.rolling_disc import on_driven_plate

T1 = 0.02
SPLIT = "must take one ordinary differential equation, neither split into parts nor driven by noise"
MEMORY = "must remember nothing of earlier steps"
NO_ESTIMATE = "must estimate its error"
# What every class is made of; the tests' own are among them.
SOLVERS = {
    **dict.fromkeys(("Bosh3", "Dopri5", "Dopri8", "Heun", "Midpoint", "Ralston", "Tsit5"), "works"),
    **dict.fromkeys(("ImplicitEuler", "Kvaerno3", "Kvaerno4", "Kvaerno5"), "works"),
    "HalfSolver": "works",
    "Euler": NO_ESTIMATE,
    **dict.fromkeys(("LeapfrogMidpoint", "ReversibleHeun"), MEMORY),
    **dict.fromkeys(("KenCarp3", "KenCarp4", "KenCarp5", "Sil3", "SemiImplicitEuler"), SPLIT),
    **dict.fromkeys(("EulerHeun", "ItoMilstein", "StratonovichMilstein"), SPLIT),
    **dict.fromkeys(("GeneralShARK", "SEA", "SPaRK", "SRA1", "ShARK", "SlowRK"), SPLIT),
    **dict.fromkeys(("ALIGN", "QUICSORT", "ShOULD"), SPLIT),
}
CONTROLS = {
    "PIDController": "works",
    "ConstantStepSize": "works",
    "StepTo": "must be diffrax.ConstantStepSize() or an adaptive one, for ts holds times",
    "ClipStepSizeController": "must leave times to ts, where steps end",
}
METERS = {"NoProgressMeter": "works", "TextProgressMeter": "works", "TqdmProgressMeter": "works"}
PID = diffrax.PIDController(rtol=1e-6, atol=1e-6)


def public(kind):
    """Names of all classes of a kind that diffrax lets be made."""
    found = {name: value for name, value in vars(diffrax).items() if inspect.isclass(value)}
    return {n for n, c in found.items() if issubclass(c, kind) and not n.startswith("Abstract")}


@pytest.mark.parametrize(
    ("kind", "table"),
    [
        (diffrax.AbstractSolver, SOLVERS),
        (diffrax.AbstractStepSizeController, CONTROLS),
        (diffrax.AbstractProgressMeter, METERS),
    ],
)
def test_every_public_class_of_diffrax_is_judged(kind, table):
    assert public(kind) == set(table)


def made(name):
    kind = getattr(diffrax, name)
    return kind(diffrax.Euler()) if name == "HalfSolver" else kind()


def judged(solver, *, steady=False):
    """What `simulate` makes of a solver: None, or its sentence."""
    try:
        check_method(with_tolerances(solver, 1e-6, 1e-6), Steady() if steady else PID, jnp.zeros(7))
    except ValueError as error:
        return str(error)
    return None


def one_sentence(text):
    return text.startswith("argument ") and "\n" not in text and len(text) < 260


@pytest.mark.parametrize("name", SOLVERS)
def test_a_solver_is_let_in_or_gets_its_sentence(name):
    said, wanted = judged(made(name)), SOLVERS[name]
    if wanted == "works":
        assert said is None
    else:
        assert said is not None and wanted in said and one_sentence(said) and said.endswith(f"a {name}")
    always = wanted in ("works", NO_ESTIMATE)
    assert (judged(made(name), steady=True) is None) == always


WEIGHTS = jnp.array([1.0, -0.7, 0.4])


class Blind(diffrax.AbstractERK):
    """A caller's Heun, whose table has no estimate of the error."""

    term_structure = diffrax.AbstractTerm
    interpolation_cls = diffrax.LocalLinearInterpolation
    tableau = diffrax.ButcherTableau(
        c=np.array([1.0]), b_sol=np.array([0.5, 0.5]), b_error=np.zeros(2), a_lower=(np.array([1.0]),)
    )

    def order(self, terms):
        return 2


class Halting(diffrax.Euler):
    """A caller's Euler that solves nothing from half way on, and says so."""

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        *made, code = super().step(terms, t0, t1, y0, args, solver_state, made_jump)
        code = diffrax.RESULTS.where(t1 > 0.55 * T1, diffrax.RESULTS.nonlinear_divergence, code)
        return *made, code


class Overriding(diffrax.Tsit5):
    """Explicit Runge-Kutta by class, but with a step of its own."""

    def step(self, *args, **options):
        return diffrax.Tsit5.step(self, *args, **options)


class Broken(diffrax.Euler):
    """A step that cannot be made."""

    def step(self, *args, **options):
        raise TypeError("no\nsuch step")


class Shapeless(diffrax.Euler):
    """A step that ends elsewhere."""

    def step(self, terms, t0, t1, y0, *rest):
        return y0[1:], None, {}, None, diffrax.RESULTS.successful


def test_a_callers_own_solvers_are_judged_by_their_structure():
    assert NO_ESTIMATE in judged(Blind()) and judged(Blind(), steady=True) is None
    assert judged(diffrax.HalfSolver(Blind())) is None
    assert MEMORY in judged(diffrax.HalfSolver(diffrax.LeapfrogMidpoint()))
    assert SPLIT in judged(diffrax.HalfSolver(diffrax.SRA1()))
    assert judged(diffrax.HalfSolver(diffrax.Kvaerno3())) is None
    assert judged(diffrax.HalfSolver(diffrax.HalfSolver(diffrax.Heun()))) is None
    for bad in (Broken(), Shapeless()):
        said = judged(bad, steady=True)
        assert "without a failure" in said and one_sentence(said)
    # A step of its own is not passed over for the table; a wrapper is no instance of what it wraps.
    assert on_tableau(diffrax.Tsit5()) and not on_tableau(Overriding())
    assert not on_tableau(diffrax.HalfSolver(diffrax.Tsit5()))


def test_root_finders_keep_what_they_were_given():
    own = diffrax.Kvaerno3(root_finder=optimistix.Newton(rtol=1e-3, atol=1e-4))
    kept = with_tolerances(own, 1e-7, 1e-8).root_finder
    assert (type(kept), kept.rtol, kept.atol) == (optimistix.Newton, 1e-3, 1e-4)
    free = diffrax.Kvaerno3(root_finder=diffrax.with_stepsize_controller_tols(optimistix.Newton)())
    for solver in (free, diffrax.HalfSolver(free)):
        filled = with_tolerances(solver, 1e-7, 1e-8)
        found = getattr(filled, "solver", filled).root_finder
        assert (type(found), found.rtol, found.atol) == (optimistix.Newton, 1e-7, 1e-8)


@pytest.fixture(scope="module")
def rolling():
    """A disc on a plate that a spring and a damper drive, a short program: grasp and state."""
    return on_driven_plate(lambda t, joints, rates, tips: [1e3 * (1e-4 - joints[0]) - 20.0 * rates[0]])


@pytest.fixture(scope="module")
def known(rolling):
    return jxr.simulate(*rolling, T1, ts=1, rtol=1e-10)


def off(run, known):
    """Largest difference of q [rad] at the end."""
    return float(np.abs(np.asarray(run.states.q[-1] - known.states.q[-1])).max())


# Implicit ones take long to compile; the explicit ones go the way of the default.
SLOW = (
    *("Bosh3", "Dopri5", "Heun", "Midpoint", "Ralston", "Tsit5"),
    *("ImplicitEuler", "Kvaerno3", "Kvaerno4", "Kvaerno5"),
)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW))
        for name, wanted in SOLVERS.items()
        if wanted == "works"
    ],
)
def test_a_solver_that_is_let_in_meets_its_tolerance(rolling, known, name):
    """Explicit, implicit and doubled; the object turns by 4 mrad."""
    run = jxr.simulate(*rolling, T1, ts=1, rtol=1e-4, solver=made(name))
    assert off(run, known) < 1e-4
    assert int(run.stats.accepted) < 100
    np.testing.assert_allclose(run.residuals.normal, 0.0, atol=1e-14)


@pytest.mark.slow
def test_halves_of_a_method_with_stages_that_it_keeps(rolling, known):
    run = jxr.simulate(*rolling, T1, ts=1, rtol=1e-6, solver=diffrax.HalfSolver(diffrax.Tsit5()))
    assert off(run, known) < 1e-6


def constant(rolling, dt0, solver=None, **more):
    control, solver = diffrax.ConstantStepSize(), solver or diffrax.Euler()
    return jxr.simulate(*rolling, T1, ts=5, solver=solver, stepsize_controller=control, dt0=dt0, **more)


def test_constant_steps_are_constant_among_save_times_and_keep_the_order(rolling, known):
    """Saves every 5 ms: 3 ms goes twice into each, the second one cut short."""
    ladder = (1e-3, 5e-4, 2.5e-4)
    runs = [constant(rolling, dt0) for dt0 in (3e-3, *ladder)]
    # The first step has no length.
    assert [int(run.stats.accepted) - 1 for run in runs] == [8, 20, 40, 80]
    errors = [off(run, known) for run in runs]
    assert abs(observed_order(ladder, errors[1:]) - 1.0) < 0.05
    assert errors[0] > errors[1]


def test_constant_steps_that_were_not_solved_end_the_run(rolling):
    run = constant(rolling, 1e-3, Halting(), throw=False)
    assert run.result == jxr.RESULTS.solver_failed
    # The step that failed is not taken.
    assert abs(float(run.stats.t_end) - 0.011) < 1e-12
    assert int(run.stats.rejected) == 1


def test_the_limit_of_steps_holds_for_constant_ones(rolling):
    run = constant(rolling, 1e-6, throw=False)
    assert run.result == jxr.RESULTS.max_steps_reached
    assert int(run.stats.accepted) == 4096 + 1


def test_a_control_of_ones_own_sees_what_the_default_sees(rolling, known):
    """The same tolerance and norm give the same run; its longest step is kept from the first on."""

    def run(longest):
        control = diffrax.PIDController(rtol=1e-8, atol=1e-8, dtmax=jnp.asarray(longest))
        return jxr.simulate(*rolling, T1, ts=1, stepsize_controller=control, dt0=4e-3)

    default = jxr.simulate(*rolling, T1, ts=1, dt0=4e-3)
    np.testing.assert_allclose(run(1.0).states.q, default.states.q, rtol=0, atol=1e-11)
    assert int(run(1e-3).stats.accepted) >= 20
    assert off(run(1e-3), known) < 1e-10


class Halving(diffrax.AbstractAdaptiveStepSizeController):
    """A caller's own: half the step, or twice."""

    rtol: float = 1e-6
    atol: float = 1e-6
    norm: None = None

    def wrap(self, direction):
        return self

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        assert y0.shape == (8,)  # q and v
        return t0 + dt0, None

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state):
        assert y_error.shape == y0.shape == y1_candidate.shape == (8,)
        keep = jnp.max(jnp.abs(y_error) / (self.atol + self.rtol * jnp.abs(y0))) < 1.0
        start = jnp.where(keep, t1, t0)
        step = jnp.where(keep, 2.0, 0.5) * (t1 - t0)
        return keep, start, start + step, False, None, diffrax.RESULTS.successful


def test_a_callers_own_control_works(rolling, known):
    run = jxr.simulate(*rolling, T1, ts=1, stepsize_controller=Halving())
    assert off(run, known) < 1e-6


CLIP = diffrax.ClipStepSizeController(PID, step_ts=[0.005])
BAD_CONTROLS = {
    "times of its own": (diffrax.StepTo([0.0, T1]), CONTROLS["StepTo"]),
    "times besides": (CLIP, CONTROLS["ClipStepSizeController"]),
    "a class": (diffrax.PIDController, CONTROLS["StepTo"]),
    "text": ("adaptive", CONTROLS["StepTo"]),
    "forced steps": (diffrax.PIDController(rtol=1e-6, atol=1e-6, dtmin=1e-3), "must have no dtmin"),
    "rtol": (diffrax.PIDController(rtol=-1, atol=1e-6), "stepsize_controller.rtol must be positive"),
    "endless": (diffrax.PIDController(rtol=np.inf, atol=1e-6), "stepsize_controller.rtol must be finite"),
    "atol": (diffrax.PIDController(rtol=1e-6, atol=np.nan), "stepsize_controller.atol must be finite"),
}


@pytest.mark.parametrize("case", BAD_CONTROLS)
def test_a_control_that_cannot_be_cut_short_gets_its_sentence(rolling, case):
    control, sentence = BAD_CONTROLS[case]
    with pytest.raises(ValueError) as refused:
        jxr.simulate(*rolling, T1, ts=1, stepsize_controller=control)
    assert sentence in str(refused.value) and one_sentence(str(refused.value))


@pytest.mark.parametrize("options", [{"rtol": 1e-5}, {"atol": 1e-5}, {"rtol": 1e-6, "atol": 1e-7}])
def test_tolerances_that_contradict_the_control_are_refused(rolling, options):
    with pytest.raises(ValueError, match="must be left to the stepsize_controller, whose own is 1e-06"):
        jxr.simulate(*rolling, T1, ts=1, stepsize_controller=PID, **options)


def test_a_meter_prints_and_changes_nothing(rolling, known, capfd):
    run = jxr.simulate(*rolling, T1, ts=1, rtol=1e-10, progress_meter=diffrax.TextProgressMeter())
    jax.block_until_ready(run)
    lines = capfd.readouterr().out.split()
    assert lines[0] == "0.00%" and lines[-1] == "100.00%" and len(lines) > 3
    np.testing.assert_allclose(run.states.q, known.states.q, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_a_meter_under_vmap_and_in_derivatives(scene, capfd):
    grasp, state = scene
    here = grasp.controller.damping

    def end(damping, **more):
        return jxr.simulate(grasp.with_(damping=damping), state, T1, ts=1, **more).states.q.sum()

    metered = lambda damping: end(damping, progress_meter=diffrax.TextProgressMeter())  # noqa: E731
    both = jnp.stack([here, 2.0 * here])
    np.testing.assert_allclose(jax.vmap(metered)(both), jax.vmap(end)(both), rtol=1e-10)
    np.testing.assert_allclose(jax.grad(metered)(here), jax.grad(end)(here), rtol=1e-8)
    np.testing.assert_allclose(jax.jvp(metered, (here,), (1.0,))[1], jax.grad(end)(here), rtol=1e-8)
    assert capfd.readouterr().out.split().count("100.00%") >= 3


@pytest.mark.slow
@pytest.mark.parametrize(
    "solver",
    [diffrax.Kvaerno3(), diffrax.HalfSolver(diffrax.ImplicitEuler()), diffrax.HalfSolver(diffrax.Heun())],
    ids=["implicit", "implicit, in halves", "explicit, in halves"],
)
def test_methods_that_are_not_run_on_their_tableau_have_derivatives_in_both_modes(scene, solver):
    grasp, state = scene
    here = grasp.controller.damping

    def end(damping):
        changed = grasp.with_(damping=damping)
        return jxr.simulate(changed, state, 0.02, ts=1, solver=solver).last.q @ WEIGHTS

    both, step = both_slopes(end), 1e-3 * here
    _, forwards, backwards = both(here)
    np.testing.assert_allclose(forwards, backwards, rtol=1e-10)
    wanted = (both(here + step)[0] - both(here - step)[0]) / (2.0 * step)
    np.testing.assert_allclose(forwards, wanted, rtol=1e-4)


@pytest.mark.slow
def test_lanes_under_a_control_of_their_own(scene):
    """Lanes of an ensemble, and lanes of a method that is run one beside the other."""
    grasp, state = scene
    many = grasp.controller.damping * jnp.asarray([1.0, 2.0])
    options = {"stepsize_controller": PID}, {"solver": diffrax.HalfSolver(diffrax.Heun()), "rtol": 1e-4}
    for given in options:
        run = lambda damping: jxr.simulate(  # noqa: E731
            grasp.with_(damping=damping),
            state,
            T1,
            ts=1,
            **given,  # noqa: B023
        )
        lanes = jax.vmap(run)(many)
        for i, damping in enumerate(many):
            np.testing.assert_allclose(lanes.states.q[i], run(damping).states.q, rtol=0, atol=1e-7)


def test_rosenbrocks_method_is_let_in():
    assert judged(jxr.Rosenbrock()) is None
    assert judged(diffrax.HalfSolver(jxr.Rosenbrock())) is None
