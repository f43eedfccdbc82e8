"""Parts of contours by networks: integrals and closure, starts, feet and residuals of fits, the descent."""

import inspect
import types

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import root

import jaxroll as jxr
from jaxroll.geometry import PeriodicNetwork
from jaxroll.geometry.contours import (
    _network as networks,
    _network_descent as descent,
    _neural_curvature as curvature,
    _neural_support as support,
)

TURN = 2.0 * np.pi
A, B = 0.02, 0.014


def flat():
    """A network that is zero."""
    return PeriodicNetwork(1, width=2, depth=1, key=jax.random.key(0), amplitude=0.0)


@pytest.mark.parametrize("count", [8, 9])
def test_integrals_over_a_period_leave_out_the_mean_and_the_highest_wave(count):
    u = np.arange(count) / count
    values = 3.0 + np.cos(TURN * u) - 2.0 * np.sin(3 * TURN * u) + 0.5 * np.cos(4 * TURN * u)
    wanted = np.sin(TURN * u) / TURN + 2.0 * np.cos(3 * TURN * u) / (3 * TURN)
    if count == 9:
        wanted = wanted + 0.5 * np.sin(4 * TURN * u) / (4 * TURN)
    np.testing.assert_allclose(curvature._integral(jnp.asarray(values)), wanted, atol=1e-15)


def test_a_contour_of_a_networks_values_is_closed_by_two_numbers():
    """Against SciPy's root of the two equations; points as sums of Fourier's integrals in NumPy."""
    count, length, angle, centre = 64, 0.3, 0.7, np.array([0.02, -0.05])
    u = np.arange(count) / count
    values = 5.0 + 4.0 * np.cos(TURN * u) + 3.0 * np.sin(2 * TURN * u) - 2.0 * np.cos(3 * TURN * u)
    pose = curvature._Pose(jnp.asarray(length), jnp.asarray(angle), jnp.asarray(centre))
    laid = jax.jit(curvature._laid_out)(jnp.asarray(values), pose)
    base = angle + TURN * u + (4.0 * np.sin(TURN * u) - 1.5 * np.cos(2 * TURN * u)) / TURN
    base = base - 2.0 * np.sin(3 * TURN * u) / (3 * TURN)

    def theta(x):
        return base + x[0] * np.cos(base) + x[1] * np.sin(base)

    gap = lambda x: [np.cos(theta(x)).mean(), np.sin(theta(x)).mean()]  # noqa: E731
    closing = root(gap, [0.0, 0.0], tol=1e-14).x
    assert np.abs(closing).min() > 0.05
    order = np.arange(1, count // 2)
    waves = np.fft.fft(np.exp(1j * theta(closing)))
    shape = np.exp(1j * TURN * np.outer(u, order)) @ (waves[order] / (1j * TURN * order))
    shape = shape + np.exp(-1j * TURN * np.outer(u, order)) @ (waves[-order] / (-1j * TURN * order))
    points = centre + length * np.stack([shape.real, shape.imag], -1) / count
    frame = jax.jit(lambda table, s: table.frame(s))(laid.table, length * u)
    np.testing.assert_allclose(np.stack([frame.point.x, frame.point.y], axis=-1), points, atol=1e-9)
    tangents = np.stack([np.cos(theta(closing)), np.sin(theta(closing))], -1)
    np.testing.assert_allclose(np.stack([frame.tangent.x, frame.tangent.y], axis=-1), tangents, atol=1e-9)
    slope = TURN + values - values.mean()
    bend = slope * (1.0 - closing[0] * np.sin(base) + closing[1] * np.cos(base)) / length
    np.testing.assert_allclose(frame.curvature, bend, atol=1e-7 * np.abs(bend).max())
    np.testing.assert_allclose([laid.gap.x, laid.gap.y], 0.0, atol=1e-15)
    assert float(laid.table.length) == length and laid.table.closed


def oval(angle):
    """An ellipse turned by 0.4 and shifted: points, and the turning of its tangent."""
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    return np.array([0.1, -0.2]) + np.stack([1.2 * np.cos(angle), 0.9 * np.sin(angle)], -1) @ turn.T


def test_a_fit_of_a_curvature_starts_at_a_curve_through_the_points():
    """An ellipse by its own formulas, its arclength by a fine sum; the first point is at its beginning."""
    angle = 0.5 + TURN * np.arange(90) / 90
    slope, pose, places = curvature._start(oval(angle))
    fine = 0.5 + TURN * np.arange(40001) / 40000
    speed = np.hypot(1.2 * np.sin(fine), 0.9 * np.cos(fine))
    arcs = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) * TURN / 40000])
    length = arcs[-1]
    assert float(pose.length) == pytest.approx(length, rel=1e-5)
    np.testing.assert_allclose(pose.centre, [0.1, -0.2], atol=1e-4)
    at = np.interp(length * np.arange(256) / 256, arcs, fine)
    bend = 1.2 * 0.9 / np.hypot(1.2 * np.sin(at), 0.9 * np.cos(at)) ** 3
    np.testing.assert_allclose(slope, bend * length - TURN, atol=2e-3 * TURN)
    theta = np.unwrap(np.arctan2(0.9 * np.cos(at), -1.2 * np.sin(at))) + 0.4
    assert float(pose.angle) == pytest.approx(np.mean(theta - TURN * np.arange(256) / 256), abs=1e-4)
    np.testing.assert_allclose(places, np.interp(angle, fine, arcs) / length, atol=1e-5)
    with pytest.raises(ValueError, match="argument points must run counter-clockwise, but run clockwise"):
        curvature._start(oval(angle)[::-1])


def test_residuals_of_points_about_a_disc_by_its_curvature_are_their_distances():
    radius, centre = 0.8, np.array([0.3, -0.1])
    angle, height = np.array([0.2, 1.0, 2.5, 4.0, 5.9]), np.array([0.1, -0.2, 0.05, 0.0, 0.3])
    points = centre + (radius + height)[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    # The tangent's angle at s = 0 is 0.6: there the normal's is that less a quarter of a turn.
    pose = curvature._Pose(jnp.asarray(TURN * radius), jnp.asarray(0.6), jnp.asarray(centre))
    feet = (angle - 0.6 + 0.25 * TURN) / TURN
    near = curvature._Cloud(jnp.asarray(points), jnp.asarray(feet + [0.01, -0.01, 0.02, 0.0, 0.015]))
    found = curvature._refreshed(flat(), pose, near)
    np.testing.assert_allclose(found.places, feet, atol=1e-9)
    np.testing.assert_array_equal(found.points, points)
    left = curvature._all_residuals(flat(), pose, found)
    np.testing.assert_allclose(left, height / np.sqrt(5.0), atol=1e-9)
    # From a sixth of a turn the steps are cut to a fiftieth of the length: four come to 0.08.
    far = eqx.tree_at(lambda c: c.places, near, jnp.asarray(feet + 1.0 / 6.0))
    np.testing.assert_allclose(curvature._refreshed(flat(), pose, far).places, feet + 1 / 6 - 0.08, atol=1e-9)
    assert curvature._angles(near).shape == (256,)


@jax.jit
def wave(angles):
    return 0.2 + 0.1 * jnp.cos(2.0 * angles) - 0.05 * jnp.sin(3.0 * angles) + 0.03 * jnp.cos(angles)


def test_a_series_of_a_networks_values_is_theirs_and_the_centres():
    given = types.SimpleNamespace(values=lambda angles: wave(jnp.asarray(angles)))
    series = jax.jit(lambda centre, terms: support._series(given, 0.5, centre, terms), static_argnums=1)
    found = series(jnp.array([0.7, -0.4]), 4)
    assert float(found.radius) == pytest.approx(0.6)
    np.testing.assert_allclose(found.cosines, [0.7 + 0.015, 0.05, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(found.sines, [-0.4, 0.0, -0.025, 0.0], atol=1e-15)
    wide = jax.eval_shape(lambda centre: series(centre, 3), jnp.zeros(2))
    assert wide.cosines.shape == wide.sines.shape == (3,)


def waves_in(samples):
    """The highest wave in samples."""
    sizes = np.abs(np.fft.rfft(samples)) / len(samples)
    return int(np.flatnonzero(sizes > 1e-9).max())


def test_a_fit_of_a_support_function_starts_at_a_series_that_does_not_fold():
    angle = TURN * np.arange(60) / 60
    points = np.stack([1.1 * np.cos(angle), 0.9 * np.sin(angle)], -1)
    samples, feet = support._start(points)
    at = TURN * np.arange(256) / 256
    np.testing.assert_allclose(samples, np.hypot(1.1 * np.cos(at), 0.9 * np.sin(at)), atol=1e-7)
    wanted = np.unwrap(np.arctan2(np.sin(angle) / 0.9, np.cos(angle) / 1.1))
    np.testing.assert_allclose(np.mod(feet - wanted + 1.0, TURN), 1.0, atol=1e-5)
    assert waves_in(support._start(points[::6])[0]) == 2
    assert waves_in(support._start(points[::3])[0]) == 4
    # h = 1 + 0.09 cos 3 phi + 0.012 cos 9 phi: of nine waves and more it folds, of six it does not.
    rate = 1.0 - 8 * 0.09 * np.cos(3 * at)
    assert rate.min() > 0.2 and (rate - 80 * 0.012 * np.cos(9 * at)).min() < 0
    height = 1.0 + 0.09 * np.cos(3 * angle) + 0.012 * np.cos(9 * angle)
    slope = -0.27 * np.sin(3 * angle) - 0.108 * np.sin(9 * angle)
    out, along = np.stack([np.cos(angle), np.sin(angle)]), np.stack([-np.sin(angle), np.cos(angle)])
    assert waves_in(support._start((height * out + slope * along).T)[0]) == 6


def test_residuals_of_points_about_a_disc_by_its_support_function():
    """Distances over the root of their number; what curvature lacks at 64 places, over the root of 64."""
    radius, centre = 0.8, np.array([0.3, -0.1])
    angle, height = np.array([0.2, 1.0, 2.5, 4.0, 5.9]), np.array([0.1, -0.2, 0.05, 0.0, 0.3])
    points = centre + (radius + height)[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    rest = (jnp.asarray(radius), jnp.asarray(centre))
    near = support._Cloud(jnp.asarray(points), jnp.asarray(angle + 0.1), jnp.asarray(1.0))
    found = support._refreshed(flat(), rest, near)
    np.testing.assert_allclose(found.angles, angle, atol=1e-9)
    distances = eqx.filter_jit(support._distances)(flat(), rest, found)
    np.testing.assert_allclose(distances, height, atol=1e-12)
    assert support._angles(near).shape == (5 + 128,)
    np.testing.assert_allclose(support._angles(near)[4:7], [6.0, 0.0, TURN / 128])
    # From 1.2 rad off the first two steps are cut to 0.3.
    far = support._refreshed(flat(), rest, eqx.tree_at(lambda c: c.angles, near, jnp.asarray(angle + 1.2)))
    assert np.all(np.abs(far.angles - angle) < 0.35) and np.all(np.abs(far.angles - angle) > 1e-6)
    uniform = TURN * np.arange(128) / 128
    values = np.concatenate([wave(angle), wave(uniform)])
    left = np.asarray(jax.jit(support._residuals)(values, rest, found))
    gaps = radius + height - radius * (1.0 + np.asarray(wave(angle)))
    np.testing.assert_allclose(left[:5], gaps / np.sqrt(5.0), atol=1e-12)
    bends = radius * (1.2 - 0.3 * np.cos(2.0 * uniform) + 0.4 * np.sin(3.0 * uniform))
    lack = np.maximum(1.0 - bends[::2], 0.0) / 8.0
    assert (lack > 0).any() and (lack == 0).any()
    np.testing.assert_allclose(left[5:], lack, atol=1e-12)


@pytest.mark.parametrize("activation", ["tanh", "softplus", "sine"])
def test_a_network_is_its_layers_of_weighted_waves(activation):
    network = PeriodicNetwork(3, decay=1.5, width=4, depth=2, activation=activation, key=jax.random.key(1))
    order = np.array([1.0, 2.0, 3.0])
    weight = order**-1.5
    value = np.concatenate([weight * np.cos(0.7 * order), weight * np.sin(0.7 * order)])
    bent = {"tanh": np.tanh, "softplus": lambda x: np.log1p(np.exp(x)), "sine": np.sin}[activation]
    for layer in network.layers[:-1]:
        value = bent(np.asarray(layer.weight) @ value + np.asarray(layer.bias))
    last = network.layers[-1]
    wanted = (np.asarray(last.weight) @ value + np.asarray(last.bias))[0]
    assert float(jax.jit(lambda angle: network(angle))(0.7)) == pytest.approx(float(wanted), rel=1e-6)


def test_counts_of_a_network_are_from_one_to_4096_and_its_key_is_a_key():
    key = jax.random.key(0)
    for options in ({"width": 0}, {"depth": 0}, {"harmonics": 4097}, {"width": True}, {"depth": 2.0}):
        with pytest.raises(ValueError, match=f"argument {next(iter(options))} must be from 1 to 4096"):
            PeriodicNetwork(key=key, **options)
    assert PeriodicNetwork(np.int64(1), width=1, depth=1, key=jax.random.PRNGKey(0)).harmonics == 1
    keys = (jax.random.split(key), jnp.zeros(2), jnp.zeros(3, jnp.uint32), 0, jnp.zeros((1, 2), jnp.uint32))
    for bad in keys:
        with pytest.raises(ValueError, match="argument key must be a random key"):
            networks.check_key("key", bad)


@pytest.mark.parametrize("bends", [0.0, 0.1])
def test_the_last_layer_is_the_best_of_least_squares_of_values_and_second_derivatives(bends):
    network = PeriodicNetwork(2, width=3, depth=1, key=jax.random.key(2))
    count = 16
    angle = TURN * np.arange(count) / count
    values = np.cos(angle) - 0.3 * np.sin(3 * angle) + 0.2
    found = networks.with_readout(network, values, bends=bends)
    hidden = np.asarray(jax.vmap(network.hidden)(jnp.asarray(angle)), float)
    matrix = np.column_stack([hidden, np.ones(count)])
    # Second derivatives of all waves, by sums over pairs of samples.
    order = np.fft.fftfreq(count, 1.0 / count)
    twice = (np.exp(1j * np.outer(angle, order)) * -(order**2)) @ np.exp(-1j * np.outer(order, angle)) / count
    rows = np.concatenate([matrix, bends * twice.real @ matrix])
    wanted = np.linalg.lstsq(rows, np.concatenate([values, bends * twice.real @ values]), rcond=None)[0]
    np.testing.assert_allclose(found.layers[-1].weight[0], wanted[:-1], rtol=1e-4)
    np.testing.assert_allclose(found.layers[-1].bias, wanted[-1:], rtol=1e-4)
    assert found.layers[0].weight is network.layers[0].weight


def test_the_record_of_a_fit_tells_root_mean_square_and_largest_distance():
    found = types.SimpleNamespace(steps=7, history=np.array([2.0, 1.0]))
    fit = networks.network_fit("field", np.array([3e-6, -5e-6, 1e-6, 0.0]), found)
    assert fit.rms == pytest.approx(np.sqrt(35.0 / 4.0) * 1e-6) and fit.largest == 5e-6
    assert (fit.field, fit.steps, fit.loss_history.tolist()) == ("field", 7, [2.0, 1.0])


class Line(eqx.Module):
    """A network that is linear in its numbers."""

    slope: jax.Array
    base: jax.Array

    def __call__(self, angle):
        return self.slope @ jnp.stack([jnp.cos(angle), jnp.sin(2.0 * angle)]) + self.base


def misses(values, rest, data):
    return values - data["heights"] - rest["shift"] * data["places"] ** 2


PROBLEM = descent.NetworkProblem(lambda data: data["places"], misses, lambda network, rest, data: data)


def problem(count):
    rng = np.random.default_rng(4)
    data = {"places": jnp.asarray(rng.uniform(0, 3, count)), "heights": jnp.asarray(rng.normal(size=count))}
    return (Line(jnp.array([0.5, -0.2]), jnp.asarray(0.1)), {"shift": jnp.asarray(0.3)}), data


def test_residuals_and_their_derivatives_go_through_the_networks_values():
    start, data = problem(7)
    places = np.asarray(data["places"])
    left, jacobian = jax.jit(lambda start: descent._linearised(PROBLEM, start, data))(start)
    values = 0.5 * np.cos(places) - 0.2 * np.sin(2 * places) + 0.1 - 0.3 * places**2
    np.testing.assert_allclose(left, values - data["heights"], rtol=1e-12)
    columns = [np.cos(places), np.sin(2 * places), np.ones(7), -(places**2)]
    np.testing.assert_allclose(jacobian, np.stack(columns, -1), rtol=1e-12)
    assert float(descent._loss(PROBLEM, start, data)) == pytest.approx(float(np.sum(np.asarray(left) ** 2)))


@pytest.mark.parametrize("count", [3, 7])
def test_a_chunk_of_steps_solves_what_is_linear(count):
    """Of three points and four numbers nothing is left; of seven, as much as least squares leave."""
    start, data = problem(count)
    places = np.asarray(data["places"])
    matrix = np.stack([np.cos(places), np.sin(2 * places), np.ones(count), -(places**2)], -1)
    _, losses = descent._marquardt(PROBLEM, start, data)
    assert losses.shape == (26,)
    assert float(losses[0]) == pytest.approx(float(descent._loss(PROBLEM, start, data)))
    best = np.linalg.lstsq(matrix, np.asarray(data["heights"]), rcond=None)[0]
    least = np.sum((matrix @ best - np.asarray(data["heights"])) ** 2)
    assert float(losses[-1]) == pytest.approx(least, abs=1e-12)
    # The first step is damped by a hundred-thousandth of the mean of the matrix's diagonal.
    gram = matrix @ matrix.T if count == 3 else matrix.T @ matrix
    gram = gram + 1e-5 * np.trace(gram) / len(gram) * np.eye(len(gram))
    left = matrix @ [0.5, -0.2, 0.1, 0.3] - np.asarray(data["heights"])
    solved = lambda right: np.linalg.solve(gram, right)  # noqa: E731
    step = matrix.T @ solved(left) if count == 3 else solved(matrix.T @ left)
    second = np.sum((left - matrix @ step) ** 2)
    assert float(losses[1]) == pytest.approx(second, rel=1e-6)


def test_a_chunk_of_adam_falls_from_a_thousandth_to_a_hundredth_of_that():
    """Against Adam in NumPy, its rate along half a cosine."""
    start, data = problem(7)
    places, heights = np.asarray(data["places"]), np.asarray(data["heights"])
    matrix = np.stack([np.cos(places), np.sin(2 * places), np.ones(7), -(places**2)], -1)
    x, mean, square, wanted = np.array([0.5, -0.2, 0.1, 0.3]), np.zeros(4), np.zeros(4), []
    for k in range(25):
        left = matrix @ x - heights
        wanted.append(left @ left)
        slope = 2.0 * matrix.T @ left
        mean, square = 0.9 * mean + 0.1 * slope, 0.999 * square + 0.001 * slope**2
        rate = 1e-3 * (0.01 + 0.99 * 0.5 * (1.0 + np.cos(np.pi * k / 25)))
        x = x - rate * mean / (1.0 - 0.9 ** (k + 1)) / (np.sqrt(square / (1.0 - 0.999 ** (k + 1))) + 1e-8)
    wanted.append(np.sum((matrix @ x - heights) ** 2))
    (network, rest), losses = descent._adam(PROBLEM, start, data)
    np.testing.assert_allclose(losses, wanted, rtol=1e-7)
    np.testing.assert_allclose([*network.slope, network.base, rest["shift"]], x, rtol=1e-7)


def descended(monkeypatch, ends, *, steps, target, first=100.0, progress=False):
    """How a descent goes whose chunks end at such losses; of the parameters, how many chunks made them."""
    made, waiting = [], iter(ends)

    def chunk(kind):
        def run(problem, params, data):
            made.append((kind, params[0], data))
            end = next(waiting)
            return (params[0] + 1, params[1]), np.append(np.full(25, first), end)

        return run

    monkeypatch.setattr(descent, "_adam", chunk("adam"))
    monkeypatch.setattr(descent, "_marquardt", chunk("marquardt"))

    def refresh(network, rest, data):
        assert isinstance(network, int) and rest == "rest"
        return data + 1

    task = descent.NetworkProblem(None, None, refresh)
    monkeypatch.setattr(descent, "_loss", lambda *given: first if given == (task, (0, "rest"), 1) else None)
    found = descent.descend(task, (0, "rest"), 0, steps=steps, target=target, progress=progress)
    return found, made


def test_a_descent_goes_on_while_it_gains_a_fifth_and_keeps_the_best(monkeypatch):
    seen = []
    found, made = descended(
        monkeypatch, [50.0, 39.0, 35.0], steps=200, target=0.0, progress=lambda *at: seen.append(at)
    )
    assert made == [("adam", 0, 2), ("marquardt", 1, 3), ("marquardt", 2, 4)]
    assert (found.network, found.rest, found.data, found.steps) == (3, "rest", 5, 75)
    np.testing.assert_array_equal(found.history, [100.0] * 75 + [35.0])
    assert seen == [(25, 50.0), (50, 39.0), (75, 35.0)]
    # Adam may gain nothing; what ends above the best, or nowhere, is dropped.
    found, made = descended(monkeypatch, [120.0, 70.0, np.nan], steps=200, target=0.0)
    assert [kind for kind, *_ in made] == ["adam", "marquardt", "marquardt"]
    assert [params for _, params, _ in made] == [0, 0, 1] and found.network == 1
    assert found.history[-1] == 70.0


@pytest.mark.parametrize(
    ("steps", "target", "chunks"), [(1, 0.0, 1), (25, 0.0, 1), (26, 0.0, 2), (90, 30.0, 2)]
)
def test_a_descent_ends_with_its_steps_or_at_its_target(monkeypatch, steps, target, chunks):
    found, made = descended(monkeypatch, [50.0, 25.0, 12.0, 6.0], steps=steps, target=target)
    assert len(made) == chunks and found.steps == 25 * chunks
    assert descended(monkeypatch, [], steps=90, target=100.0)[0].steps == 0


def test_a_descent_says_how_it_goes_where_it_is_asked_to(monkeypatch, capsys):
    descended(monkeypatch, [50.0], steps=25, target=0.0, progress=True)
    assert capsys.readouterr().out == "step 25: loss 5.000e+01\n"
    descended(monkeypatch, [50.0], steps=25, target=0.0)
    assert capsys.readouterr().out == ""


def test_fields_by_networks_have_their_defaults_and_free_numbers(monkeypatch):
    # That a disc does not fold takes a second to see.
    monkeypatch.setattr(support, "check_convex", lambda name, contour: None)
    curved = jxr.NeuralCurvature(flat(), TURN * 0.01)
    np.testing.assert_allclose([curved.angle, *curved.centre], [0.25 * TURN, 0.0, 0.0])
    assert curved.cells == 1024 and curved.closed and curved.smoothness == np.inf
    for cells in (9, 7, 6):
        with pytest.raises(ValueError, match="argument cells must be"):
            jxr.NeuralCurvature(flat(), 0.06, cells=cells)
    assert jxr.NeuralCurvature(flat(), 0.06, cells=8).cells == 8
    tip = jxr.NeuralSupport(flat(), 0.01)
    assert tip.cells == 1024 and np.all(np.asarray(tip.centre) == 0.0)
    assert tip.free_numbers()[0] is tip.radius and tip.free_numbers()[1] is tip.centre
    assert len(tip.free_numbers()) == 2 + 4
    for kind in (jxr.NeuralSupport, jxr.NeuralCurvature):
        with pytest.raises(ValueError, match="argument points must have more than 8 rows, but had 8"):
            kind.fit(oval(TURN * np.arange(8) / 8), key=jax.random.key(0))


KINDS = {
    jxr.NeuralSupport: {"harmonics": 4, "width": 16, "smallest_radius": None},
    jxr.NeuralCurvature: {"harmonics": 12, "width": 24},
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_field_through_points_is_that_of_the_fit_with_its_defaults(monkeypatch, kind):
    usual = {"depth": 2, "steps": 100, "tolerance": 1e-8, "progress": False, "cells": 1024} | KINDS[kind]
    own = inspect.signature(kind.fit).parameters
    assert {name: own[name].default for name in usual} == usual
    fit = classmethod(lambda cls, points, **options: types.SimpleNamespace(field=(points, options)))
    monkeypatch.setattr(kind, "fit", fit)
    assert kind.through("points", key="key") == ("points", {"key": "key"} | usual)
    other = {name: f"another {name}" for name in usual}
    assert kind.through("points", key="key", **other) == ("points", {"key": "key"} | other)


def disc_and_points():
    """A disc of 0.2 m off the origin, and points at known heights above it; by their mean and scale."""
    radius, centre = 0.2, np.array([3.0, -2.0])
    angle = np.array([0.1, 0.8, 1.4, 2.2, 3.0, 3.7, 4.4, 5.0, 5.8])
    height = 0.01 * np.array([1.0, -2.0, 0.5, 0.0, 3.0, -1.0, 2.0, -0.5, 0.3])
    points = centre + (radius + height)[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    middle = points.mean(axis=0)
    size = np.hypot(*(points - middle).T).mean()
    return radius, centre, angle, height, points, middle, size


def given_to(monkeypatch, module, rest, refresh):
    """What a fit gives its descent, which answers with a disc."""
    given = {}

    def answered(problem, start, data, **options):
        given.update(options, problem=problem, start=start, data=data)
        history = np.array([2.0, 1.0])
        return descent.Descent(flat(), rest, refresh(data), 25, history)

    monkeypatch.setattr(module, "descend", answered)
    return given


def test_a_fit_by_curvature_is_worked_out_about_the_points_and_told_in_metres(monkeypatch):
    radius, centre, angle, height, points, middle, size = disc_and_points()
    rest = curvature._Pose(TURN * radius / size, jnp.asarray(0.6), jnp.asarray((centre - middle) / size))
    feet = (angle - 0.6 + 0.25 * TURN) / TURN
    refresh = lambda cloud: eqx.tree_at(lambda c: c.places, cloud, jnp.asarray(feet))  # noqa: E731
    given = given_to(monkeypatch, curvature, rest, refresh)
    options = {"harmonics": 3, "width": 5, "depth": 1, "tolerance": 2e-3, "progress": "told", "steps": 7}
    fit = jxr.NeuralCurvature.fit(points, key=jax.random.key(1), cells=64, **options)
    assert (fit.field.cells, fit.steps, given["steps"], given["progress"]) == (64, 25, 7, "told")
    assert given["target"] == pytest.approx((2e-3 / size) ** 2)
    np.testing.assert_allclose(fit.field.length, TURN * radius)
    np.testing.assert_allclose([fit.field.angle, *fit.field.centre], [0.6, *centre])
    assert fit.rms == pytest.approx(np.sqrt(np.mean(height**2)), rel=1e-6)
    assert fit.largest == pytest.approx(0.03, rel=1e-6)
    network, pose = given["start"]
    assert [layer.weight.shape for layer in network.layers] == [(5, 6), (1, 5)]
    slope, wanted, places = curvature._start((points - middle) / size)
    np.testing.assert_allclose(jax.tree.leaves(pose)[0], jax.tree.leaves(wanted)[0])
    np.testing.assert_allclose(given["data"].points, (points - middle) / size)
    np.testing.assert_allclose(given["data"].places, places)
    best = networks.with_readout(PeriodicNetwork(3, width=5, depth=1, key=jax.random.key(1)), slope)
    np.testing.assert_allclose(network.layers[-1].weight, best.layers[-1].weight, rtol=1e-6)


def test_a_fit_by_support_function_is_worked_out_about_the_points_and_told_in_metres(monkeypatch):
    monkeypatch.setattr(support, "check_convex", lambda name, contour: None)
    radius, centre, angle, height, points, middle, size = disc_and_points()
    rest = (jnp.asarray(radius / size), jnp.asarray((centre - middle) / size))
    refresh = lambda cloud: eqx.tree_at(lambda c: c.angles, cloud, jnp.asarray(angle))  # noqa: E731
    given = given_to(monkeypatch, support, rest, refresh)
    options = {"harmonics": 3, "width": 5, "depth": 1, "tolerance": 2e-3, "progress": "told", "steps": 7}
    fit = jxr.NeuralSupport.fit(points, key=jax.random.key(1), cells=64, **options)
    assert (fit.field.cells, fit.steps, given["steps"], given["progress"]) == (64, 25, 7, "told")
    assert given["target"] == pytest.approx((2e-3 / size) ** 2)
    np.testing.assert_allclose(fit.field.radius, radius)
    np.testing.assert_allclose(fit.field.centre, centre)
    assert fit.rms == pytest.approx(np.sqrt(np.mean(height**2)), rel=1e-6)
    assert fit.largest == pytest.approx(0.03, rel=1e-6)
    network, (first, offset) = given["start"]
    assert [layer.weight.shape for layer in network.layers] == [(5, 6), (1, 5)] and network.decay == 1.0
    assert (float(first), offset.tolist(), float(given["data"].floor)) == (1.0, [0.0, 0.0], 0.01)
    waves, angles = support._start((points - middle) / size)
    np.testing.assert_allclose(given["data"].points, (points - middle) / size)
    np.testing.assert_allclose(given["data"].angles, angles)
    plain = PeriodicNetwork(3, decay=1.0, width=5, depth=1, key=jax.random.key(1))
    best = networks.with_readout(plain, waves - 1.0, bends=0.1)
    np.testing.assert_allclose(network.layers[-1].weight, best.layers[-1].weight, rtol=1e-6)
    jxr.NeuralSupport.fit(points, key=jax.random.key(1), cells=64, smallest_radius=0.05, **options)
    assert float(given["data"].floor) == pytest.approx(0.05 / size)
