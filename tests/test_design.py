"""Fingertips for condition (41): an analytic optimum, violating starts, limits that exclude it."""

import jax.numpy as jnp
import numpy as np
import optax
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe

import jaxroll as jxr
from jaxroll.design import Limits, optimise_fingertip
from jaxroll.design._minimise import minimise

INTERVAL = (-0.005, 0.005)


def half_disc(x, centre):
    """Squared distance from a centre, on the upper half of the unit disc."""
    return jnp.sum((x - centre) ** 2), jnp.stack([jnp.dot(x, x) - 1.0, -x[1]])


def test_minimiser_on_a_problem_by_hand():
    """Nearest points of a half disc: on its rim, in its corner, inside."""
    centres = jnp.array([[3.0, 4.0], [2.0, -1.0], [0.1, 0.2]])
    found = minimise(half_disc, jnp.full((3, 2), 0.1), centres, optimiser=optax.lbfgs(), steps=200)
    nearest = [[0.6, 0.8], [1.0, 0.0], [0.1, 0.2]]
    np.testing.assert_allclose(found.search.best, nearest, atol=2e-7)
    assert bool(found.search.done.all()) and found.steps <= 200


def test_ellipse_has_the_analytic_optimum():
    """As long as allowed and as sharp at its ends: both limits fix both half axes."""
    length, radius = 0.1, 0.004
    limits = Limits(length=length, radius=radius, flat=None)
    design = optimise_fingertip(jxr.Ellipse(0.02, 0.01), INTERVAL, limits=limits, steps=300)

    def perimeter(b):
        return 4 * b * ellipe(1 - radius / b)  # a^2 = radius b

    b = brentq(lambda b: perimeter(b) - length, 0.01, 0.03)
    np.testing.assert_allclose([design.tip.a, design.tip.b], [np.sqrt(radius * b), b], rtol=1e-6)
    assert design.result == jxr.RESULTS.successful and bool(design.holds[0])


def violating(seed, count=24):
    """A fingertip that violates (41) in front: a circle ahead of O, a flat ellipse, a random one."""
    rng = np.random.default_rng(seed)
    u = 2 * np.pi * np.arange(count) / count
    if seed % 3 == 0:
        radius, ahead = rng.uniform(0.007, 0.012), rng.uniform(0.003, 0.006)
        return np.stack([ahead + radius * np.cos(u), radius * np.sin(u)], -1)
    if seed % 3 == 1:
        return np.stack([rng.uniform(0.013, 0.017) * np.cos(u), rng.uniform(0.008, 0.011) * np.sin(u)], -1)
    waves = sum(rng.normal(scale=0.03 / k) * np.cos(k * u + rng.uniform(0, 6)) for k in (2, 3, 4))
    radius = 0.01 * (1.0 + waves)
    return np.stack([0.004 + radius * np.cos(u), radius * np.sin(u)], -1)


@pytest.mark.slow
def test_every_violating_start_comes_to_hold():
    """20 seeds in one batch: a positive margin on the whole interval within 200 steps."""
    tips = [jxr.Spline(violating(seed), cells=128) for seed in range(20)]
    design = optimise_fingertip(tips, INTERVAL, steps=200, limits=Limits(size=0.02, radius=0.001, flat=0.1))
    print(design)
    assert np.all(np.asarray(design.before) < 0.0)
    assert design.history.shape[1] <= 200
    assert bool(design.holds.all())
    margins = jxr.stability.margin(design.tip, np.linspace(*INTERVAL, 65))
    np.testing.assert_allclose(margins.min(), design.after[design.chosen], rtol=1e-9)


def test_limits_that_exclude_it_end_with_a_code():
    """No contour 40 mm long keeps all its radii above 8 mm."""
    limits = Limits(length=0.04, radius=0.008, flat=None)
    design = optimise_fingertip(jxr.Ellipse(0.01, 0.01), INTERVAL, limits=limits, steps=60)
    assert design.result == jxr.RESULTS.infeasible and not bool(design.holds[0])
    assert 0.1 < float(design.violation[0]) < 1.0 and np.isfinite(design.after[0])
    assert "passed by" in str(design)


@pytest.mark.slow
def test_support_function_and_symmetry():
    start = jxr.SupportFunction(0.01, [0.004, -0.001, 0.0, 0.0], [0.0, 0.0005, 0.0002, 0.0])
    design = optimise_fingertip(
        start, INTERVAL, limits=Limits(size=0.015, radius=0.002), symmetric=True, steps=60
    )
    assert float(design.before[0]) < 0.0 < float(design.after[0])
    assert np.all(np.asarray(design.tip.sines) == 0.0)


def test_goes_on_from_a_checkpoint(tmp_path):
    limits = Limits(length=0.1, radius=0.004, flat=None)
    options = {"limits": limits, "checkpoint": tmp_path / "design.eqx"}
    optimise_fingertip(jxr.Ellipse(0.02, 0.01), INTERVAL, steps=20, **options)
    seen = []
    report = lambda step, value, violation: seen.append(step)  # noqa: E731
    whole = optimise_fingertip(jxr.Ellipse(0.02, 0.01), INTERVAL, steps=40, progress=report, **options)
    assert seen == [30, 40]
    straight = optimise_fingertip(jxr.Ellipse(0.02, 0.01), INTERVAL, steps=40, limits=limits)
    np.testing.assert_array_equal(whole.history, straight.history)


@pytest.mark.parametrize(
    ("tip", "options", "message"),
    [
        (jxr.Catenary(0.025), {}, "tip must have ends"),
        (jxr.Catenary(0.025, (-0.004, 0.004)), {}, "interval must lie on the contour"),
        (jxr.Ellipse(0.01, 0.02), {"symmetric": True}, "symmetric must be False"),
        ([jxr.Ellipse(0.01, 0.02), jxr.Circle(0.01)], {}, "contours of one kind"),
        (jxr.Ellipse(0.01, 0.02).prepared(), {}, "must not be prepared"),
        ("tip", {}, "one contour or several"),
    ],
)
def test_bad_arguments(tip, options, message):
    with pytest.raises(ValueError, match=message):
        optimise_fingertip(tip, INTERVAL, **options)
