"""Shapes of a caller's own with numbers that JAX traces: what is refused elsewhere is a run's code."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll.geometry import (
    AbstractImplicit,
    Frenet2,
    Gauss3,
    keeps_contract,
    Level,
    level_frame,
    Sym3,
    unchecked,
    Vec2,
    Vec3,
)
from tests.helpers import in_single
from tests.subjects.swinging_plate import SPEED, swinging

PARTS = ("fast", "lean", "bend", "aside")
RADIUS = 0.02


class Bend(jxr.AbstractContour):
    """A circle of 20 mm with numbers that may be wrong by a little: its speed, and parts of its frame."""

    wrong: jax.Array
    length: jax.Array
    closed: bool = eqx.field(static=True, default=True)
    endless: bool = eqx.field(static=True, default=False)

    smoothness = float("inf")

    def curve(self, s):
        angle = (1.0 + self.wrong[0]) * s / RADIUS
        return Vec2(RADIUS * jnp.cos(angle), RADIUS * jnp.sin(angle))

    def frame(self, s):
        angle, point = (1.0 + self.wrong[0]) * s / RADIUS, self.curve(s)
        tangent = Vec2(-jnp.sin(angle), jnp.cos(angle)) * (1.0 + self.wrong[0])
        lean = Vec2(self.wrong[1], 0.0)
        curvature = (1.0 + self.wrong[0]) ** 3 * (1.0 + self.wrong[2]) / RADIUS
        return Frenet2(Vec2(point.x, point.y + self.wrong[3]), tangent + lean, curvature + 0.0 * s)

    def domain(self):
        return None if self.endless else (0.0, self.length)


def bend(length=2.0 * np.pi * RADIUS, closed=True, endless=False, **wrong):
    return Bend(jnp.array([wrong.get(part, 0.0) for part in PARTS]), jnp.asarray(length), closed, endless)


holds = jax.jit(keeps_contract)


@pytest.mark.parametrize(
    ("part", "allowed", "refused"),
    [
        ("fast", 0.9e-9, 1.1e-9),
        ("fast", -0.9e-9, -1.1e-9),
        ("lean", 0.9e-8, 1.1e-8),
        ("bend", 0.9e-5, 1.1e-5),
        ("bend", -0.9e-5, -1.1e-5),
        # A millionth of the larger coordinate there, which is 14 mm at least.
        ("aside", 1.3e-8, 1.5e-8),
        ("bend", 0.0, np.nan),
    ],
)
def test_it_is_as_strict_as_for_numbers_that_are_known(part, allowed, refused):
    """The speed of a closed one is not looked at here: it would not come back to itself either."""
    assert holds([bend(closed=False, **{part: allowed}).moved((0.0, 0.0), 0.3)])
    assert not holds([bend(closed=False, **{part: refused}).moved((0.0, 0.0), 0.3)])


def test_a_closed_one_comes_back_to_itself():
    """Places are allowed 1e-7 of its length, directions 1e-7, which comes first here."""
    turn = 2.0 * np.pi * RADIUS
    assert holds([bend(turn * (1.0 + 0.9e-7 / (2.0 * np.pi)))])
    assert not holds([bend(turn * (1.0 + 1.1e-7 / (2.0 * np.pi)))])


def test_an_endless_one_is_looked_at_about_its_zero():
    assert holds([bend(closed=False, endless=True)])
    assert not holds([bend(closed=False, endless=True, bend=1e-4)])


class Round(AbstractImplicit):
    """A ball of 10 mm whose shape operator may be wrong by a factor."""

    factor: jax.Array

    smoothness = float("inf")

    def derivatives(self, point):
        return Level(point.dot(point) - 1e-4, point * 2.0, Sym3(2.0, 0.0, 0.0, 2.0, 0.0, 2.0))

    def frame(self, at):
        found = level_frame(Vec3(*at), self.derivatives(Vec3(*at)))
        return Gauss3(found.point, found.normal, found.shape * self.factor)


def test_surfaces_are_looked_at_too():
    ball = lambda factor: Round(jnp.asarray(factor)).moved((0.0, 0.0, 0.1))  # noqa: E731
    assert holds([ball(1.0), bend()]) and not holds([ball(1.00001)]) and not holds([bend(), ball(np.nan)])


def test_single_precision_is_allowed_its_rounding():
    asked = lambda fast: in_single(holds, [bend(closed=False, fast=fast)])  # noqa: E731
    assert asked(0.5e-4) and not asked(2e-4)


def test_only_what_is_ones_own_and_traced_is_looked_at():
    known, seen = bend(fast=0.1), []

    def look(x):
        seen.extend(
            unchecked([shape]) for shape in (known, bend(fast=x), bend(fast=x).moved(), jxr.Circle(x))
        )

    jax.eval_shape(look, 0.1)
    assert seen == [False, True, True, False]


def rolling(fast):
    """A disc that may be too fast along its rim, on a plate that swings."""
    grasp, _ = swinging()
    # Its arclength is zero below its centre.
    disc = jxr.FreeObject(bend(fast=fast).moved((0.0, 0.0), -0.5 * np.pi), 0.02, 4e-6)
    grasp = jxr.Grasp(disc, grasp.fingers, grasp.contacts, controller=grasp.controller, gravity=grasp.gravity)
    return grasp, jxr.State([0.0, RADIUS, 0.0, 0.0], [0.0, 0.0, SPEED / RADIUS, SPEED], np.zeros(1))


@pytest.fixture(scope="module")
def lanes():
    """Two grasps and their states, of which the second breaks the contract."""
    return jax.jit(jax.vmap(rolling))(np.array([0.0, 0.01]))


def test_nothing_is_computed_of_one_that_breaks_it(lanes):
    def told(grasp, state):
        return (
            jxr.multipliers(grasp, 0.0, state).f[0],
            jxr.residuals(grasp, state).normal[0],
        )

    force, gap = jax.jit(jax.vmap(told))(*lanes)
    assert abs(gap[0]) < 1e-15 and np.isfinite(force[0]) and np.isnan([gap[1], force[1]]).all()
    # A derivative outside of `jit` knows the numbers.
    with pytest.raises(ValueError, match="argument grasp must be made of contours given by their arclength"):
        jax.grad(lambda fast: jxr.close(*rolling(fast))[1].q[0])(0.01)


def test_a_lane_whose_contour_is_not_given_by_its_arclength_says_so(lanes):
    """It ran `successful` with a loss of energy, and so did derivatives."""
    run = lambda grasp, state: jxr.simulate(grasp, state, 0.01, ts=1, throw=False)  # noqa: E731
    runs = jax.jit(jax.vmap(run))(*lanes)
    assert repr(runs.result) == "[successful, inconsistent_shape]"
    assert "a contour of one's own is not given by its arclength" in str(jax.tree.map(lambda x: x[1], runs))
