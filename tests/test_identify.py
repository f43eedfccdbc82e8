"""Numbers of a grasp from measurements: against SciPy's least squares, and data of another formulation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import curve_fit

import jaxroll as jxr
from jaxroll._identify import _descend, _inverse
from tests.oracles.chapter_part2 import Part2

ELBOW = 1
TS = np.linspace(0.02, 0.16, 8)
TRUE = {"damping": 0.006, "force": 0.5}


def angles(damping, force):
    """Joint angles of Part 2 in one coordinate, integrated by SciPy, shape (8, 2)."""
    chapter = Part2()
    chapter.c, chapter.stiffness = damping, force / 0.010
    field = chapter.acceleration(ELBOW)
    slope = lambda t, y: [y[1], float(field(y[0], y[1]))]  # noqa: E731
    answer = solve_ivp(slope, (0.0, TS[-1]), [0.003, 0.0], "DOP853", TS, rtol=1e-11, atol=1e-13)
    return np.asarray(jax.vmap(lambda s: chapter.pose(s, ELBOW))(jnp.asarray(answer.y[0])))[:, 1:]


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


@pytest.mark.parametrize("force", [TRUE["force"], 1.0])
def test_a_search_that_runs_off_is_no_success(scene, force):
    """From a finger driven by its own motion: to where there is no run, or where nothing moves any more."""
    grasp, state = scene
    data = angles(**TRUE | {"force": force})
    found = jxr.identify(lambda p: (grasp.with_(**p), state), {"damping": -0.05}, TS, data, noise=1e-4)
    assert found.result in (jxr.RESULTS.step_collapsed, jxr.RESULTS.undetermined) and found.misfit > 100.0


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
        ({"observe": lambda run: run}, "argument observe must be a function, but was"),
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
