"""The door to diffrax: `diffeqsolve` with a grasp's terms, start and projection, against `simulate`."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest

import jaxroll as jxr
from tests.oracles import closed_forms_space as closed
from tests.recorded import runs
from tests.subjects import rolling_disc
from tests.subjects.disc_on_a_hill import disc_on_a_hill

TIGHT = diffrax.PIDController(rtol=1e-10, atol=1e-10)
T1 = 0.2
SLOPE = 0.002


@pytest.fixture(scope="module")
def scene():
    return runs.scene("pivoted")


@pytest.fixture(scope="module")
def disc():
    """A disc that begins to roll down a hill, and its run: for what compiles long."""
    grasp, state = disc_on_a_hill(reach=0.06)
    return grasp, state, jxr.simulate(grasp, state, T1, ts=3, rtol=1e-12)


def solved(grasp, state, *, t1=T1, solver=None, dt0=1e-4, **options):
    field = jxr.vector_field(grasp)
    options = {"stepsize_controller": TIGHT, "max_steps": 2048} | options
    found = diffrax.diffeqsolve(
        field.terms, field.projected(solver), 0.0, t1, dt0, field.start(state), **options
    )
    return field, found


def test_saved_and_dense_states_are_those_of_simulate(disc):
    grasp, state, run = disc
    saveat = diffrax.SaveAt(ts=jnp.array([0.0, 0.5 * T1, T1]), dense=True, steps=False)
    tight = diffrax.PIDController(rtol=1e-12, atol=1e-12)
    field, found = solved(grasp, state, saveat=saveat, stepsize_controller=tight)
    states = field.states(found.ys)
    for part in "qvs":
        np.testing.assert_allclose(getattr(states, part), getattr(run.states, part), rtol=0, atol=1e-9)
    between = field.states(found.evaluate(0.5 * T1))
    np.testing.assert_allclose(between.q, run.states.q[1], rtol=0, atol=1e-8)


def rolled_by(squares):
    """Where the disc on a slope is after half the square of a time [s^2]: position and angle."""
    _, start = rolling_disc.on_slope(SLOPE)
    way = 2.0 / 3.0 * rolling_disc.GRAVITY * np.sin(SLOPE) * squares
    return np.asarray(start.q) + np.array([way, 0.0, -way / rolling_disc.RADIUS])


@pytest.mark.parametrize("solver", [diffrax.Tsit5(), diffrax.Kvaerno5()], ids=lambda s: type(s).__name__)
def test_other_methods_and_rows_at_rounding_after_every_step(solver, disc):
    grasp, state, run = disc
    field, found = solved(grasp, state, solver=solver, saveat=diffrax.SaveAt(steps=True, t0=True))
    reached = np.isfinite(np.asarray(found.ts))
    states = field.states(np.asarray(found.ys)[reached])
    np.testing.assert_allclose(states.q[-1], run.last.q, rtol=0, atol=1e-8)
    left = jxr.residuals(grasp, states)
    assert max(np.abs(x).max() for x in jax.tree.leaves(left)) < 1e-14
    assert len(states.q) > 10


def test_an_implicit_method_inside_another_needs_tolerances_of_its_own():
    """diffrax gives it none, and asks for them where it is solved."""
    disc, state = rolling_disc.on_slope(SLOPE)
    field = jxr.vector_field(disc)
    with pytest.raises(ValueError, match="argument solver must have a root finder with tolerances"):
        field.projected(diffrax.HalfSolver(diffrax.ImplicitEuler()))
    tight = diffrax.HalfSolver(diffrax.ImplicitEuler(root_finder=diffrax.VeryChord(1e-8, 1e-8)))
    loose = {"stepsize_controller": diffrax.PIDController(rtol=1e-7, atol=1e-7)}
    field, found = solved(disc, state, solver=tight, **loose)
    np.testing.assert_allclose(field.states(found.ys[0]).q, rolled_by(0.5 * T1**2), rtol=0, atol=1e-4)


def test_an_implicit_method_with_tolerances_takes_constant_steps():
    """Of constant acceleration, n steps of Euler's implicit method add n (n + 1) / 2 times their square."""
    tight = diffrax.ImplicitEuler(root_finder=diffrax.VeryChord(1e-8, 1e-8))
    equal = {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": 1e-3}
    field, found = solved(*rolling_disc.on_slope(SLOPE), solver=tight, **equal)
    wanted = rolled_by(0.5 * T1 * (T1 + 1e-3))
    np.testing.assert_allclose(field.states(found.ys[0]).q, wanted, rtol=0, atol=1e-9)


def test_without_projection_rows_drift(disc):
    grasp, state, _ = disc
    field = jxr.vector_field(grasp)
    found = diffrax.diffeqsolve(field.terms, diffrax.Heun(), 0.0, T1, 5e-3, field.start(state))
    drifted = jxr.residuals(grasp, field.states(found.ys[0]))
    assert np.abs(drifted.normal).max() > 1e-12
    back = field.states(field.project(T1, found.ys[0]))
    assert np.abs(jxr.residuals(grasp, back).normal).max() < 1e-16


def test_both_adjoints_give_the_derivative_of_simulate():
    """Forwards of the default; backwards, which takes JAX long to trace, of Euler's method in equal steps."""

    def rolled(mass, **ways):
        field, found = solved(*disc_on_a_hill(mass=mass), t1=0.05, max_steps=128, **ways)
        return field.states(found.ys[0]).q[0]

    def simulated(mass, **ways):
        options = {"t1": 0.05, "ts": 3, "rtol": 1e-13, "atol": 1e-15} | ways
        return float(jxr.simulate(*disc_on_a_hill(mass=mass), **options).last.q[0])

    def slope(function):
        """By central differences of fourth order."""
        at = lambda k: function(0.05 + 1e-4 * k)  # noqa: E731
        return (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / 12e-4

    ahead = jax.jit(jax.jacfwd(lambda m: rolled(m, adjoint=diffrax.ForwardMode())))
    equal = {"stepsize_controller": diffrax.ConstantStepSize(), "solver": diffrax.Euler()}
    short = equal | {"dt0": 1e-3, "adjoint": diffrax.RecursiveCheckpointAdjoint()}
    back = jax.jit(jax.value_and_grad(lambda m: rolled(m, **short)))
    exact = slope(simulated)
    assert abs(exact) > 0.01
    np.testing.assert_allclose(ahead(0.05), exact, rtol=1e-8)
    value, gradient = back(0.05)
    np.testing.assert_allclose(value, simulated(0.05, **equal, dt0=1e-3), rtol=1e-12)
    np.testing.assert_allclose(gradient, slope(lambda m: back(m)[0]), rtol=1e-8)


@pytest.mark.slow
def test_backwards_with_a_checkpoint_for_every_step(scene):
    """Of the default method at lengths that it chooses. With fewer checkpoints it is off by 2e-4 here."""
    grasp, state = scene

    def turned(damping):
        adjoint = diffrax.RecursiveCheckpointAdjoint(checkpoints=64)
        field, found = solved(grasp.with_(damping=damping), state, max_steps=64, adjoint=adjoint)
        return field.states(found.ys[0]).q[0]

    def simulated(k):
        changed = grasp.with_(damping=0.006 + 1e-5 * k)
        return float(jxr.simulate(changed, state, T1, ts=1, rtol=1e-13, atol=1e-15).last.q[0])

    wanted = (8 * (simulated(1) - simulated(-1)) - (simulated(2) - simulated(-2))) / 12e-5
    np.testing.assert_allclose(jax.jit(jax.grad(turned))(0.006), wanted, rtol=1e-8)


def test_the_adjoint_that_integrates_backwards_is_refused():
    def rolled(mass, faster):
        grasp, start = disc_on_a_hill(mass=mass)
        moved = jxr.State(start.q, start.v * (1.0 + faster), start.s)
        field, found = solved(grasp, moved, t1=0.05, adjoint=diffrax.BacksolveAdjoint(), max_steps=128)
        return field.states(found.ys[0]).q[0]

    with pytest.raises(ValueError, match="argument adjoint must be one that differentiates the steps"):
        jax.eval_shape(jax.grad(rolled, argnums=1), 0.05, 0.0)
    with pytest.raises(RuntimeError, match="cannot be autodifferentiated"):
        jax.eval_shape(jax.grad(rolled), 0.05, 0.0)


def test_steps_end_at_declared_jumps_where_diffrax_is_given_them():
    """A disc at rest that is pushed for 10 ms rolls on with 2/3 of what a sliding one would have.

    Left to itself, diffrax passes over such a push.
    """
    disc, state = rolling_disc.on_slope(0.0)
    pushed = disc.with_(load=jxr.loads.Push((0.2, 0.0), 1.0, 0.01))
    jumps = jxr.vector_field(pushed).jumps
    np.testing.assert_array_equal(jumps, [1.0, 1.01])
    control = diffrax.ClipStepSizeController(TIGHT, jump_ts=jumps)
    field, found = solved(pushed, state, t1=1.5, stepsize_controller=control)
    speed = 2.0 / 3.0 * 0.5 * 0.2 * 0.01 / rolling_disc.MASS
    moved = float(field.states(found.ys[0]).q[0])
    np.testing.assert_allclose(moved, speed * (1.5 - 1.005), rtol=1e-9)
    assert jxr.vector_field(disc).jumps.shape == (0,)


def test_a_derivative_in_the_time_of_a_step_is_refused_not_zero(scene):
    grasp, state = scene

    def slope(time, force):
        steps = jxr.commands.Steps([time], jnp.stack([jnp.asarray(0.5), force]))
        field = jxr.vector_field(grasp.with_(force=steps))
        return field(0.1, field.start(state))[3]

    jax.eval_shape(jax.grad(slope, argnums=1), 0.05, 0.6)
    for way in (jax.grad, jax.jacfwd):
        with pytest.raises(RuntimeError, match="no derivatives in the times of jumps: `simulate` has them"):
            jax.eval_shape(way(slope), 0.05, 0.6)


def test_an_event_ends_where_simulate_does():
    """A disc that rolls off its hill."""
    hill = disc_on_a_hill(reach=0.01)
    wanted = jxr.simulate(*hill, 1.0, ts=1, throw=False, rtol=1e-10)
    assert wanted.result == jxr.RESULTS.contour_end
    event = diffrax.Event(jxr.vector_field(hill[0]).margin, optimistix.Newton(1e-12, 1e-12))
    found = solved(*hill, t1=1.0, event=event)[1]
    np.testing.assert_allclose(found.ts[-1], wanted.stats.t_end, rtol=0, atol=1e-8)


def test_in_space():
    """A ball rolls down an incline as its closed form says."""
    slope, radius = 0.3, 0.05
    field, found = solved(*jxr.scenes.incline(slope=slope, radius=radius))
    way = 0.5 * closed.incline_acceleration(slope, 9.81) * T1**2
    down, up = np.array([[np.cos(slope), 0.0, -np.sin(slope)], [np.sin(slope), 0.0, np.cos(slope)]])
    turn = 0.5 * way / radius
    wanted = [*(radius * up + way * down), np.cos(turn), 0.0, np.sin(turn), 0.0]
    np.testing.assert_allclose(field.states(found.ys[0]).q, wanted, rtol=0, atol=1e-9)


def test_stabilised_equations_need_no_projection(scene):
    way = jxr.CSM()
    field = jxr.vector_field(scene[0], formulation=way)
    x = field.start(scene[1])
    np.testing.assert_array_equal(field.project(0.0, x), x)


@pytest.mark.parametrize(
    "solver",
    [diffrax.SPaRK(), diffrax.SemiImplicitEuler(), diffrax.KenCarp4(), "Dopri8", diffrax.ReversibleHeun()],
    ids=lambda s: type(s).__name__,
)
def test_methods_that_cannot_work_are_refused(solver, scene):
    with pytest.raises(ValueError, match="argument solver must"):
        jxr.vector_field(scene[0]).projected(solver)


def test_noise_is_refused(scene):
    field = jxr.vector_field(scene[0])
    path = diffrax.VirtualBrownianTree(0.0, 1.0, 1e-3, (7,), jax.random.key(0))
    noisy = diffrax.MultiTerm(field.terms, diffrax.ControlTerm(lambda t, y, args: jnp.eye(7), path))
    with pytest.raises(ValueError, match="terms"):
        diffrax.diffeqsolve(noisy, field.projected(diffrax.Heun()), 0.0, 0.1, 1e-3, field.start(scene[1]))


@pytest.mark.parametrize(
    ("asked", "wanted"),
    [
        (lambda grasp, state: jxr.vector_field(state), "argument grasp must be"),
        (
            lambda grasp, state: jxr.vector_field(grasp, events=("penetration",)),
            "argument events must be among",
        ),
        (lambda grasp, state: jxr.vector_field(grasp, formulation="csm"), "argument formulation must be"),
        (lambda grasp, state: jxr.vector_field(grasp).start(grasp), "argument state must be a State"),
        (
            lambda grasp, state: jxr.vector_field(grasp).start(jxr.State(state.q + 1e-3, state.v, state.s)),
            "argument state must be on the constraints",
        ),
        (lambda grasp, state: jxr.vector_field(grasp).states(np.zeros(3)), "argument y must hold 7 numbers"),
        (lambda grasp, state: jxr.vector_field(grasp)(0.0, np.zeros((7, 2))), "argument y must hold 7"),
        (lambda grasp, state: jxr.vector_field(grasp).margin(0.0, 1.0), "argument y must hold 7 numbers"),
        (
            lambda grasp, state: jxr.vector_field(grasp.with_(load=jxr.loads.Impulse((0.0, 1.0), 0.1))),
            "argument grasp must have no blows",
        ),
    ],
)
def test_bad_arguments_get_one_sentence(asked, wanted, scene):
    with pytest.raises(ValueError, match=wanted) as caught:
        asked(*scene)
    assert "\n" not in str(caught.value)


def test_a_start_in_space_is_the_state():
    """What is made ready of spatial fingers is taken where a grasp is checked."""
    grasp, state = runs.scene("pinch3d")
    y = jxr.vector_field(grasp).start(state)
    np.testing.assert_array_equal(y, np.concatenate([state.q, state.v, state.s]))


def test_a_known_start_is_checked_in_a_traced_function_too(scene):
    grasp, state = scene
    field, off = jxr.vector_field(grasp), jxr.State(state.q + 0.01, state.v, state.s)
    assert jax.eval_shape(lambda t: t * field.start(state), 1.0).shape == (7,)
    with pytest.raises(ValueError, match="argument state must be on the constraints to 1e-09"):
        jax.eval_shape(lambda t: t * field.start(off), 1.0)
