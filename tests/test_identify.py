"""Numbers of a grasp from measurements: against SciPy's least squares, and data of another formulation."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import curve_fit

import jaxroll as jxr
from jaxroll import _identify
from jaxroll._identify import _at_an_end, _descend, _inverse, _joints
from tests.oracles.chapter_part2 import Part2
from tests.subjects import rolling_disc

ELBOW = 1
# As in the example of `identify`, whose program serves here too.
TS = 0.16 * np.linspace(0.0, 1.0, 301)[20::40]
TRUE = {"damping": 0.006, "force": 0.5}


@jax.jit
def field(s, rate, damping, force):
    """Acceleration of Part 2 in one coordinate."""
    chapter = Part2()
    chapter.c, chapter.stiffness = damping, force / 0.010
    return chapter.acceleration(ELBOW)(s, rate)


poses = jax.jit(jax.vmap(lambda s: Part2().pose(s, ELBOW)))


def angles(damping, force):
    """Joint angles of Part 2 in one coordinate, integrated by SciPy, shape (8, 2)."""
    slope = lambda t, y: [y[1], float(field(*y, damping, force))]  # noqa: E731
    answer = solve_ivp(slope, (0.0, TS[-1]), [0.003, 0.0], "DOP853", TS, rtol=1e-11, atol=1e-13)
    return np.asarray(poses(answer.y[0]))[:, 1:]


def test_part_2_from_data_of_another_formulation(scene):
    """Values to 1e-6, and deviations as central differences of that formulation have them."""
    grasp, state = scene
    found = jxr.identify(
        lambda p: (grasp.with_(**p), state),
        {"damping": 0.004, "force": 0.7},
        TS,
        angles(**TRUE),
        noise=1e-4,
    )
    assert found.result == jxr.RESULTS.successful and found.misfit < 1e-3
    for name, value in TRUE.items():
        assert found.values[name] == pytest.approx(value, rel=1e-6)
    columns = []
    for name, value in TRUE.items():
        sides = [angles(**TRUE | {name: value * (1.0 + way * 1e-4)}) for way in (1.0, -1.0)]
        columns.append((sides[0] - sides[1]).ravel() / (2e-4 * value) / 1e-4)
    wanted = np.linalg.inv(np.array(columns) @ np.array(columns).T)
    np.testing.assert_allclose(found.covariance, wanted, rtol=1e-3)
    np.testing.assert_allclose(list(found.deviations.values()), np.sqrt(np.diag(wanted)), rtol=1e-3)
    np.testing.assert_allclose(np.diag(found.correlation), 1.0)
    lines = str(found).splitlines()
    assert lines[0] == "Identified: successful" and lines[1].startswith("  damping  0.006 +- ")


@pytest.mark.parametrize("known", [True, False])
def test_the_search_ends_where_scipys_does(known):
    t, rng = np.linspace(0.0, 3.0, 40), np.random.default_rng(0)
    data = 2.0 * np.exp(-1.3 * t) + 0.05 * rng.normal(size=40)
    model = lambda t, a, b: a * np.exp(-b * t)  # noqa: E731
    sigma = 0.05 if known else 1.0

    def both(x):
        a, b = np.asarray(x)
        slopes = np.stack([np.exp(-b * t), -a * t * np.exp(-b * t)], axis=1)
        return (model(t, a, b) - data) / sigma, slopes / sigma

    x, steps, result, (left, slopes) = _descend(both, np.ones(2), 30, known=known)
    wanted, spread = curve_fit(model, t, data, [1.0, 1.0], np.full(40, sigma), absolute_sigma=known)
    assert result == jxr.RESULTS.successful and steps < 15
    np.testing.assert_allclose(x, wanted, rtol=1e-4)
    scale = 1.0 if known else left @ left / 38
    np.testing.assert_allclose(scale * _inverse(slopes), spread, rtol=1e-3)


def test_a_search_without_a_start_or_an_end_says_so():
    nothing = lambda x: (np.full(3, np.nan), np.zeros((3, 1)))  # noqa: E731
    assert _descend(nothing, np.ones(1), 5, known=True)[2] == jxr.RESULTS.not_finite
    far = lambda x: (100.0 + 1.0 / np.asarray(x)[[0, 0]], -1.0 / np.asarray(x)[[0, 0], None] ** 2)  # noqa: E731
    assert _descend(far, np.ones(1), 2, known=True)[1:3] == (2, jxr.RESULTS.max_steps_reached)
    assert np.isinf(_inverse(np.ones((4, 2)))).all() and np.isinf(_inverse(np.zeros((4, 1)))).all()


def test_what_the_data_tell_nothing_of_leaves_the_others_known():
    """An idle number, and two of which only the sum is seen: the others have their own covariance."""
    own = np.random.default_rng(0).normal(size=(9, 2))
    both = own[:, :1]
    slopes = np.concatenate([own, np.zeros((9, 1)), np.random.default_rng(1).normal(size=(9, 1))], axis=1)
    slopes = np.concatenate([slopes, slopes[:, 3:]], axis=1)
    known, found = np.linalg.inv(own.T @ own), _inverse(slopes)
    # What the last two add up to is told like a number of its own, and takes away from the others.
    three = np.linalg.inv(slopes[:, [0, 1, 3]].T @ slopes[:, [0, 1, 3]])
    np.testing.assert_allclose(found[:2, :2], three[:2, :2], rtol=1e-9)
    assert np.isinf(found[2:]).all() and np.isinf(found[:, 2:]).all()
    np.testing.assert_allclose(_inverse(np.concatenate([own, 0.0 * both], axis=1))[:2, :2], known, rtol=1e-9)


@pytest.mark.parametrize(("damping", "force"), [(-0.05, TRUE["force"]), (-0.1, 1.0)])
def test_a_search_that_runs_off_is_no_success(scene, damping, force):
    """From a finger driven by its own motion: to where there is no run, or where nothing moves any more."""
    grasp, state = scene
    data, guess = angles(**TRUE | {"force": force}), {"damping": damping, "force": 0.7}
    found = jxr.identify(lambda p: (grasp.with_(**p), state), guess, TS, data, noise=1e-4)
    codes = jxr.RESULTS.step_collapsed, jxr.RESULTS.not_finite, jxr.RESULTS.undetermined
    assert found.result in codes and found.misfit > 100.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"guess": {}}, "argument guess must be a dict of numbers by their names"),
        ({"guess": {"damping": 0.0}}, "argument guess must have no zero"),
        ({"measured": np.zeros((1, 1))}, "argument measured must hold more numbers than the 1 of guess"),
        ({"measured": np.zeros((8, 3))}, "argument measured must have the shape"),
        ({"ts": TS[::-1]}, "argument ts must be rising times"),
        ({"noise": -1.0}, "argument noise must be positive"),
        ({"make": lambda p: p}, "argument make must return a Grasp and a State"),
        ({"make": lambda a, b: a}, "argument make must be a function of a dict of numbers, but was"),
        ({"observe": lambda run: run}, "argument observe must be a function of a grasp and its run, but was"),
        (
            {"observe": lambda grasp, run: grasp},
            "argument observe, in what it returns, must be a real number",
        ),
    ],
)
def test_bad_arguments_are_one_sentence(scene, change, words):
    grasp, state = scene
    given = {
        "make": lambda p: (grasp.with_(**p), state),
        "guess": {"damping": 0.004},
        "ts": TS,
        "measured": np.zeros((8, 2)),
    }
    with pytest.raises(ValueError, match=words):
        jxr.identify(**given | change)


def test_what_is_seen_by_default_are_joint_angles_and_not_the_clock_of_a_moving_stage():
    grasp, _ = jxr.scenes.incline(slope=0.0)
    table = jxr.Stage(jxr.Plane(), lambda t: ((0.0, 0.0, -t), (1.0, 0.0, 0.0, 0.0)))
    moved = jxr.Grasp(grasp.object, table, grasp.contacts)
    assert moved.form.positions == (7, 1)
    runs = [SimpleNamespace(states=SimpleNamespace(q=jnp.arange(3.0 * n).reshape(3, n))) for n in (8, 3)]
    assert _joints(moved, runs[0]).shape == (3, 0)
    np.testing.assert_array_equal(_joints(jxr.scenes.pivoted()[0], runs[1]), runs[1].states.q[:, 1:])


def straight(size, end, rest=()):
    """Misfits that are linear in one number, those of the rest being what they are."""
    slopes = np.array([[size], *([0.0] for _ in rest)])
    return lambda x: (np.array([size * (float(x[0]) - end), *rest]), slopes)


def test_the_first_steps_are_damped_by_a_thousandth_and_by_a_tenth_of_that():
    matrix, goal = np.array([[3.0, 1.0], [-1.0, 2.0], [0.5, 4.0]]), np.array([1.0, -2.0, 3.0])
    both = lambda x: (matrix @ np.asarray(x) - goal, matrix)  # noqa: E731
    x, square = np.array([1.0, -2.0]), matrix.T @ matrix
    for steps, damping in ((1, 1e-3), (2, 1e-4)):
        way = np.linalg.solve(square + damping * np.diag(np.diag(square)), matrix.T @ (goal - matrix @ x))
        x = x + way
        found = _descend(both, np.array([1.0, -2.0]), steps, known=True)
        np.testing.assert_allclose(found[0], x, rtol=1e-12)
        np.testing.assert_allclose(found[3][0], matrix @ x - goal, rtol=1e-9)
        assert found[1:3] == (steps, jxr.RESULTS.max_steps_reached)


@pytest.mark.parametrize(
    ("first", "rest", "known", "count"),
    [
        # The k-th misfit is the one before times the damping d/(1 + d), 1e-3 and then a tenth each time: the
        # third step is a ten millionth of the first misfit, in deviations.
        (1.5e4, (), True, 4),
        (0.7e4, (), True, 3),
        # A deviation of ten, from four misfits that stay and from four degrees of freedom.
        (1.5e5, (10.0, -10.0, 10.0, 10.0), False, 4),
        (0.7e5, (10.0, -10.0, 10.0, 10.0), False, 3),
        (0.7e5, (10.0, -10.0, 10.0, 10.0), True, 4),
    ],
)
def test_a_search_ends_with_a_step_below_a_thousandth_of_a_deviation(first, rest, known, count):
    found = _descend(straight(1e6, 1.0 + first / 1e6, rest), np.ones(1), 30, known=known)
    assert found[1:3] == (count, jxr.RESULTS.successful)


@pytest.mark.parametrize(("away", "count"), [(1.5e-2, 4), (0.7e-2, 3), (-1.5e-2, 4), (-0.7e-2, 3)])
def test_a_search_ends_with_a_step_below_a_billionth_of_the_number(away, count):
    """However small a deviation is: here a thousandth of it is far below rounding."""
    for sign in (1.0, -1.0):
        found = _descend(straight(1e18, sign * (1.0 + away)), sign * np.ones(1), 30, known=True)
        assert found[1:3] == (count, jxr.RESULTS.successful)


def test_a_search_ends_where_rounding_alone_is_left():
    """Of data without noise, as a model gives them: which steps go down there is by chance."""
    count = [0]

    def both(x):
        count[0] += 1
        rounding = 0.9e-13 * 0.99 ** count[0] if count[0] % 2 else 1e-13
        return np.array([float(x[0]) - 1.0, rounding, rounding]), np.array([[1.0], [0.0], [0.0]])

    x, steps, result, _ = _descend(both, np.ones(1), 30, known=False)
    assert result == jxr.RESULTS.successful and steps <= 3
    np.testing.assert_allclose(x, 1.0, rtol=1e-12)


@pytest.mark.parametrize(("dtype", "away"), [(float, 0.9e-3), (np.float32, 0.9e-2)])
def test_a_search_ends_where_the_errors_of_runs_decide_which_steps_go_down(dtype, away):
    """Every step costs more than it brings, but for steps that rounding makes none of, which cost nothing."""
    start, slopes = np.array([1.0 + away], dtype), np.array([[1.0], [0.0]], dtype)
    both = lambda x: (np.array([float(x[0]) - 1.0, 3.0 + 1e-3 * (float(x[0]) != start[0])], dtype), slopes)  # noqa: E731
    assert _descend(both, start, 30, known=True)[:3] == (start, 1, jxr.RESULTS.successful)


@pytest.mark.parametrize(("away", "steps"), [(0.9e-3, 1), (1.1e-3, 30)])
def test_in_single_precision_rounding_decides_below_a_thousandth_of_a_number(away, steps):
    """Of data without noise, whose misfits are rounding alone and ask for other steps at every place."""
    seen = []

    def both(x):
        seen.append(np.float32(1e-6) * np.float32(1.0 + 1e-3 * (len(seen) % 2)))
        slopes = np.array([[1e-6 / away], [0.0]], np.float32)
        return np.array([seen[-1], seen[-1]]), slopes

    _, count, result, _ = _descend(both, np.ones(1, np.float32), 30, known=False)
    assert count == steps and (repr(result) == "successful") == (steps == 1)


def test_a_search_ends_where_no_step_goes_down():
    """The damping rises by ten from a thousandth, until it is above 1e12; no slope is there, but an edge."""
    start, damping, count = np.ones(1), 1e-3, 0
    while damping <= 1e12:
        damping, count = damping * 10.0, count + 1
    edge = lambda x: (np.array([1.0 + (float(x[0]) != 1.0)]), np.ones((1, 1)))  # noqa: E731
    assert _descend(edge, start, 30, known=True)[:3] == (start, count, jxr.RESULTS.solver_failed)
    # A step to where there is no number counts as one that goes up.
    hole = lambda x: (np.array([1.0 if float(x[0]) == 1.0 else np.nan]), np.ones((1, 1)))  # noqa: E731
    assert _descend(hole, start, 30, known=True)[:3] == (start, count, jxr.RESULTS.solver_failed)


@pytest.mark.parametrize(
    ("left", "known", "promised"),
    [(1e-2, True, True), (0.9e-3, True, False), (0.9e-6, False, False), (1.1e-6, False, True)],
)
def test_rounding_asks_for_a_millionth_of_a_number_or_a_thousandth_of_its_deviation(left, known, promised):
    """One number, whose slope is one, may take away all that is left but for as much again."""
    found = _at_an_end(np.ones(1), np.array([left, left]), np.array([[1.0], [0.0]]), known=known)
    assert found == (jxr.RESULTS.solver_failed if promised else jxr.RESULTS.successful)


@pytest.mark.parametrize("size", [1e200, 1e-200])
def test_misfits_beyond_all_squares_are_not_finite(size):
    """As those by a noise that no measurement has."""
    both = lambda x: (np.full(3, size) * np.asarray(x), np.full((3, 1), size))  # noqa: E731
    wanted = jxr.RESULTS.not_finite if size > 1.0 else jxr.RESULTS.successful
    assert _descend(both, np.ones(1), 30, known=True)[2] == wanted


@pytest.mark.parametrize(("share", "told"), [(0.7e-14, False), (1.4e-14, True)])
def test_two_numbers_are_told_apart_above_rounding(share, told):
    """Columns of length 3 and 5 at a small angle; the scaled matrix has eigenvalues in this proportion."""
    between = 1.0 - 2.0 * share
    slopes = np.array([[1.0, between], [0.0, np.sqrt(1.0 - between**2)]]) * [3.0, 5.0]
    assert np.isfinite(_inverse(slopes)).all() == told


@pytest.mark.parametrize("dtype", [float, np.float32])
def test_of_numbers_whose_ratios_alone_count_nothing_is_told_in_single_precision_too(dtype):
    """The squares of such a derivative are singular to rounding, of which the root is above a thousandth."""
    t, rng = np.linspace(0.1, 1.0, 40), np.random.default_rng(0)
    one, other, alone = np.exp(-t), t * np.exp(-t), np.cos(9.0 * t)
    for first, second in rng.uniform(0.2, 5.0, (20, 2)):
        ratios = [first * one, second * other, -first * one - second * other]
        slopes = np.stack([*ratios, alone], axis=1).astype(dtype)
        found = _inverse(slopes)
        assert np.isinf(found[:3]).all()
        root = np.linalg.inv(np.linalg.qr(np.stack([one, other, alone], axis=1), "r"))
        np.testing.assert_allclose(found[3, 3], root[2] @ root[2], rtol=1e-5)


@pytest.mark.parametrize(("part", "told"), [(0.85e-6, True), (1.2e-6, False)])
def test_a_number_that_hardly_takes_part_in_what_is_not_told_is_known(part, told):
    first, third = np.eye(4)[0], np.eye(4)[2]
    slopes = np.stack([first, first + np.sqrt(2.0) * part * third, third], axis=1)
    found = _inverse(slopes)
    assert np.isinf(found[:2]).all() and np.isfinite(found[2, 2]) == told


@pytest.fixture
def without_runs(scene, monkeypatch):
    """An identification of a grasp's damping d from 2 d, -3 d and one, which no number changes."""
    grasp, state = scene
    ended = SimpleNamespace(result=jxr.RESULTS.successful)
    asked = []

    def simulated(grasp, state, t1, **options):
        asked.append(options)
        return SimpleNamespace(filled=lambda: ended)

    monkeypatch.setattr(_identify, "simulate", simulated)
    seen = lambda grasp, run: jnp.array([2.0, -3.0, 0.0]) * grasp.controller.damping + jnp.array([0, 0, 1.0])  # noqa: E731

    def identified(measured, **options):
        make = lambda p: (grasp.with_(**p), state)  # noqa: E731
        return jxr.identify(make, {"damping": 0.5}, TS, measured, observe=seen, **options)

    return identified, asked


def test_what_is_found_and_how_sure_it_is_in_closed_form(without_runs):
    """A straight line through the origin; of one noise, of three, and of one that the misfit shows."""
    identified, asked = without_runs
    ways, measured = np.array([2.0, -3.0, 0.0]), np.array([1.0, -1.3, 1.2])
    value = ways @ measured / 13.0
    left = np.append((value * ways - measured)[:2], 1.0 - 1.2)
    one = identified(measured, noise=0.1, rtol=1e-3)
    np.testing.assert_array_equal(asked[0]["ts"], TS)
    assert asked[0]["rtol"] == 1e-3 and asked[0]["throw"] is False
    assert one.values["damping"] == pytest.approx(value, rel=1e-6) and one.noise == 0.1
    assert one.deviations["damping"] == pytest.approx(0.1 / np.sqrt(13.0), rel=1e-9)
    assert one.misfit == pytest.approx(np.sqrt(np.mean(left**2)) / 0.1, rel=1e-6)
    shown = identified(measured)
    spread = np.sqrt(left @ left / 2.0)
    assert shown.noise == pytest.approx(spread, rel=1e-6)
    assert shown.deviations["damping"] == pytest.approx(spread / np.sqrt(13.0), rel=1e-6)
    assert shown.misfit == pytest.approx(np.sqrt(2.0 / 3.0), rel=1e-6)
    noise = np.array([0.1, 0.2, 0.3])
    weights = 1.0 / noise**2
    three = identified(measured, noise=noise)
    best = (weights * ways) @ measured / (weights @ ways**2)
    assert three.values["damping"] == pytest.approx(best, rel=1e-6)
    assert three.covariance[0, 0] == pytest.approx(1.0 / (weights @ ways**2), rel=1e-9)
    np.testing.assert_array_equal(three.noise, noise)
    with pytest.raises(ValueError, match="must hold more numbers than the 1 of guess, but had 1"):
        identified(measured[:1])


def test_other_data_at_the_same_times_are_the_same_program(without_runs, monkeypatch):
    """Data and noise are arguments: as constants they would be compiled anew in every process."""
    identified, _ = without_runs
    texts = set()

    def jitted(function):
        program = jax.jit(function)

        def call(*given):
            texts.add(program.lower(*given).as_text())
            return program(*given)

        return call

    monkeypatch.setattr(_identify, "jax", SimpleNamespace(**vars(jax) | {"jit": jitted}))
    first = identified(np.array([1.0, -1.3, 1.2]), noise=0.1)
    second = identified(np.array([1.1, -1.4, 1.1]), noise=0.2)
    assert first.values != second.values and len(texts) == 1


def test_what_a_law_holds_is_seen_as_it_is_now(monkeypatch):
    """The list from which a law has its force; accelerations, whose trace JAX keeps as it does a run's."""
    force, rate, damping, radius = [0.0], 0.4, 0.6, rolling_disc.RADIUS

    def make(p):
        law = lambda t, joints, rates, tips: [force[0] - p["damping"] * rates[0]]  # noqa: E731
        grasp, state = rolling_disc.on_driven_plate(law)
        return grasp, jxr.State(state.q, [0.0, 0.0, rate / radius, rate], state.s)

    def start(grasp, state, t1, **options):
        return SimpleNamespace(filled=lambda: SimpleNamespace(state=state, result=jxr.RESULTS.successful))

    monkeypatch.setattr(_identify, "simulate", start)
    seen = lambda grasp, run: jxr.accelerations(grasp, 0.0, run.state)  # noqa: E731
    for force[0] in (1.0, 1.2):
        plate = (force[0] - damping * rate) / rolling_disc.MOVED
        measured = plate * np.array([1.0 / 3.0, 0.0, 2.0 / (3.0 * radius), 1.0])
        found = jxr.identify(make, {"damping": 0.5}, TS, measured, observe=seen, noise=1e-4)
        assert found.values["damping"] == pytest.approx(damping, rel=1e-8)


@pytest.mark.parametrize(("times", "result"), [(0.7e6, "successful"), (1.5e6, "undetermined")])
def test_a_number_with_a_deviation_of_a_million_times_itself_is_none(without_runs, times, result):
    found = without_runs[0]([1.0, -1.5, 1.0], noise=times * 0.5 * np.sqrt(13.0))
    assert repr(found.result) == result and found.values["damping"] == pytest.approx(0.5)


@pytest.mark.parametrize("ts", [[], [-0.1, 0.2], [0.0], [0.1, 0.1], [0.2, 0.1]])
def test_times_of_measurements_rise_from_zero_or_later(ts):
    with pytest.raises(ValueError, match="argument ts must"):
        _identify._times(ts)
    np.testing.assert_array_equal(_identify._times([0.0, 0.3]), [0.0, 0.3])


@pytest.mark.filterwarnings("error")
def test_data_that_fit_exactly_leave_a_misfit_of_zero_and_unknown_numbers_infinite(scene, without_runs):
    """The noise that they show is zero, which says nothing of a number that they do not depend on."""
    seen = lambda grasp, run: jnp.array([2.0, -3.0, 1.0]) * grasp.controller.damping  # noqa: E731
    make = lambda p: (scene[0].with_(damping=p["damping"]), scene[1])  # noqa: E731
    guess = {"damping": 0.5, "unused": 2.0}
    found = jxr.identify(make, guess, TS, np.array([1.0, -1.5, 0.5]), observe=seen)
    assert found.deviations == {"damping": 0.0, "unused": np.inf}
    assert found.misfit == 0.0 and found.noise == 0.0 and found.result == jxr.RESULTS.successful
