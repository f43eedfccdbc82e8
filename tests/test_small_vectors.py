"""Vectors, poses, quaternions and symmetric forms number by number, against NumPy and SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxroll import _linalg as la
from jaxroll._linalg._plane import opposite
from jaxroll._linalg._space import quaternion_of

RNG = np.random.default_rng(7)
A, B, C, SPIN = RNG.normal(size=(4, 3))
TURN, OTHER = Rotation.from_rotvec([0.4, -1.1, 0.7]), Rotation.from_rotvec([-2.0, 0.3, 0.9])


def vec(values):
    return la.Vec3(*map(float, values))


def flat(values):
    return la.Vec2(*map(float, values))


def numbers(*values):
    return [float(x) for x in values]


def same(found, wanted):
    np.testing.assert_allclose(numbers(*found), wanted, rtol=1e-13, atol=1e-15)


def scalar_first(turn):
    return tuple(np.roll(turn.as_quat(), 1).tolist())


def posed(origin, turn):
    return la.pose_at(vec(origin), scalar_first(turn))


@pytest.mark.parametrize("x", [3.0, np.float64(-2.5)])
def test_nothing_is_computed_with_pythons_own_zero_and_one(x):
    """Products with 1 and sums with 0 are the other number itself; a product with 0 is Python's zero."""
    x = jnp.asarray(x)
    assert la.times(1.0, x) is x and la.times(x, 1.0) is x
    assert la.plus(0.0, x) is x and la.plus(x, 0.0) is x and la.minus(x, 0.0) is x
    assert type(la.times(0.0, x)) is type(la.times(x, 0.0)) is float and la.times(x, 0.0) == 0.0
    assert opposite(0.0) == 0.0 and float(opposite(x)) == -x and float(la.minus(0.0, x)) == -x
    for a in (-1.0, 2.0, 0.5):
        assert float(la.times(a, x)) == float(la.times(x, a)) == a * x
        assert float(la.plus(a, x)) == float(la.plus(x, a)) == a + x
        assert float(la.minus(a, x)) == a - x and float(la.minus(x, a)) == x - a
    assert la.minus(0.0, 0.0) == 0.0 and np.copysign(1.0, opposite(0.0)) == 1.0


def test_sums_and_products_of_several():
    assert la.inner((2.0, 3.0, 0.0), (5.0, -1.0, 7.0)) == 7.0 and la.inner((), ()) == 0.0
    assert la.total([]) == 0.0 and la.total([1.0, 2.0, 5.0]) == 8.0
    same(la.total([vec(A), vec(B), vec(C)]), A + B + C)
    assert float(la.root(jnp.asarray(6.25))) == 2.5 and float(la.root(jnp.asarray(0.0))) == 0.0


def test_vectors_of_the_plane():
    a, b = A[:2], B[:2]
    same(flat(a) + flat(b), a + b)
    same(flat(a) - flat(b), a - b)
    same(-flat(a), -a)
    same(flat(a) * 2.5, 2.5 * a)
    assert flat(a).dot(flat(b)) == pytest.approx(a @ b, rel=1e-14)
    assert flat(a).cross(flat(b)) == pytest.approx(a[0] * b[1] - a[1] * b[0], rel=1e-13)
    same(flat(a).left(), [-a[1], a[0]])
    same(flat(a).right(), [a[1], -a[0]])
    np.testing.assert_array_equal(la.Vec2(jnp.arange(3.0), 2.0).array(), [[0, 2], [1, 2], [2, 2]])


def test_poses_and_twists_of_the_plane():
    angle, spin = 0.7, -1.3
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    pose = la.Pose2(flat(A[:2]), np.cos(angle), np.sin(angle))
    same(pose.turn(flat(B[:2])), turn @ B[:2])
    same(pose.place(flat(B[:2])), A[:2] + turn @ B[:2])
    twist = la.Twist2(flat(C[:2]), spin)
    same(twist.at(flat(B[:2])), C[:2] + spin * np.array([-B[1], B[0]]))
    rate = pose.rate(twist)
    same([*rate.origin, rate.cos, rate.sin], [*C[:2], -spin * np.sin(angle), spin * np.cos(angle)])
    still = pose.turning(spin)
    same([*still.origin, still.cos, still.sin], [0.0, 0.0, -spin * np.sin(angle), spin * np.cos(angle)])
    more = twist + la.Twist2(flat(B[:2]), 0.4) * 2.0
    same([*more.velocity, more.spin], [*(C[:2] + 2.0 * B[:2]), spin + 0.8])
    np.testing.assert_allclose(la.three(pose), [*A[:2], angle])


def test_vectors_of_space():
    same(vec(A) + vec(B), A + B)
    same(vec(A) - vec(B), A - B)
    same(-vec(A), -A)
    same(vec(A) * 2.5, 2.5 * A)
    same(vec(A).cross(vec(B)), np.cross(A, B))
    assert vec(A).dot(vec(B)) == pytest.approx(A @ B, rel=1e-13)
    assert float(vec(A).norm()) == pytest.approx(np.linalg.norm(A))
    np.testing.assert_array_equal(la.Vec3(jnp.arange(2.0), 2.0, 3.0).array(), [[0, 2, 3], [1, 2, 3]])
    assert np.array_equal([list(axis) for axis in la.UNIT_AXES], np.eye(3))


def test_poses_and_twists_of_space():
    pose, turn = posed(A, TURN), TURN.as_matrix()
    same(pose.turn(vec(B)), turn @ B)
    same(pose.back(vec(B)), turn.T @ B)
    same(pose.place(vec(B)), A + turn @ B)
    same(pose.local(vec(B)), turn.T @ (B - A))
    twist = la.Twist3(vec(C), vec(SPIN))
    same(twist.at(vec(B)), C + np.cross(SPIN, B))
    rate, still = pose.rate(twist), pose.turning(vec(SPIN))
    same(rate.origin, C)
    same(still.origin, np.zeros(3))
    for found in (rate, still):
        for axis, column in zip((found.x, found.y, found.z), turn.T, strict=True):
            same(axis, np.cross(SPIN, column))
    other = la.Twist3(vec(A), vec(B))
    for found, wanted in ((twist + other * 2.0, 2.0), (twist - other, -1.0)):
        same([*found.velocity, *found.spin], [*(C + wanted * A), *(SPIN + wanted * B)])


def test_quaternions():
    q, p = scalar_first(TURN), scalar_first(OTHER)
    for axis, column in zip(la.rotation(q), TURN.as_matrix().T, strict=True):
        same(axis, column)
    product = np.array(numbers(*la.quaternion_product(q, p)))
    np.testing.assert_allclose(product * np.sign(product[0]), scalar_of(TURN * OTHER), atol=1e-14)
    same(la.conjugate(q), [q[0], -q[1], -q[2], -q[3]])
    same(la.normalised((2.0, -1.0, 4.0, 2.0)), np.array([2.0, -1.0, 4.0, 2.0]) / 5.0)
    h = 1e-6
    ends = [scalar_of(Rotation.from_rotvec(k * h * SPIN) * TURN) for k in (1, -1)]
    np.testing.assert_allclose(
        numbers(*la.quaternion_rate(q, vec(SPIN))), (ends[0] - ends[1]) / (2 * h), atol=1e-9
    )


def scalar_of(turn):
    """Scalar first and positive."""
    q = np.array(scalar_first(turn))
    return q * np.sign(q[0])


@pytest.mark.parametrize(
    "turn",
    [
        TURN,
        OTHER,
        Rotation.from_rotvec(3.1 * np.array([0.96, 0.28, 0.0])),
        Rotation.from_rotvec(3.1 * np.array([0.28, -0.96, 0.0])),
        Rotation.from_rotvec(-3.1 * np.array([0.0, 0.28, 0.96])),
        Rotation.from_rotvec(3.1 * np.array([-0.6, 0.0, 0.8])),
    ],
)
def test_a_frame_is_told_as_the_quaternion_that_turns_it(turn):
    found = quaternion_of(posed(A, turn))
    np.testing.assert_allclose(numbers(*found), scalar_of(turn), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(la.seven(posed(A, turn)), [*A, *scalar_of(turn)], rtol=1e-12, atol=1e-14)


def test_symmetric_forms():
    full = RNG.normal(size=(2, 3, 3))
    first, second = (x + x.T for x in full)
    form = lambda m: la.Sym3(*map(float, m[np.triu_indices(3)]))  # noqa: E731
    one, other = form(first), form(second)
    same(one + other, (first + second)[np.triu_indices(3)])
    same(one - other, (first - second)[np.triu_indices(3)])
    same(one * 2.5, 2.5 * first[np.triu_indices(3)])
    assert one.trace() == pytest.approx(np.trace(first))
    minors = 0.5 * (np.trace(first) ** 2 - np.trace(first @ first))
    assert one.minors() == pytest.approx(minors, rel=1e-12)
    assert one.squares() == pytest.approx(np.sum(first**2))
    same(one.apply(vec(A)), first @ A)
    assert one.form(vec(A), vec(B)) == pytest.approx(A @ first @ B, rel=1e-12)
    turn = TURN.as_matrix()
    same(one.turned(posed(C, TURN)), (turn @ first @ turn.T)[np.triu_indices(3)])
    np.testing.assert_allclose(one.array(), first)
    same(la.outer(vec(A), vec(B)), (0.5 * (np.outer(A, B) + np.outer(B, A)))[np.triu_indices(3)])
    same(la.square(vec(A)), np.outer(A, A)[np.triu_indices(3)])


@pytest.mark.parametrize("normal", [(0.48, -0.6, 0.64), (0.48, -0.64, -0.6), (0.36, 0.8, -0.48), (0, 0, -1)])
def test_tangents_stand_across_a_normal_and_on_each_other(normal):
    """Right-handed with it."""
    first, second = (
        np.array(numbers(*t)) for t in la.tangents(la.Vec3(*map(jnp.asarray, map(float, normal))))
    )
    np.testing.assert_allclose(np.stack([first, second]) @ np.stack([first, second]).T, np.eye(2), atol=1e-14)
    np.testing.assert_allclose(np.cross(first, second), normal, atol=1e-14)
    # One formula to a third of the way below the equator, its mirror image from there on.
    x, _, z = normal
    assert first[0] == pytest.approx(1.0 - x * x / (1.0 + z if z > -0.5 else 1.0 - z), rel=1e-14)


@pytest.mark.parametrize("size", [1, 2, 3, 4, 5])
def test_small_systems_are_solved_by_their_factors(size):
    matrix = RNG.normal(size=(size, size))
    matrix = matrix @ matrix.T + np.diag(np.arange(1.0, size + 1.0))
    right = RNG.normal(size=size)
    triangle = [[jnp.asarray(matrix[i, j]) for j in range(i + 1)] for i in range(size)]
    factor = la.factorise(triangle)
    found = la.solve(factor, [jnp.asarray(x) for x in right])
    np.testing.assert_allclose(numbers(*found), np.linalg.solve(matrix, right), rtol=1e-11)
    lower = np.linalg.cholesky(matrix)
    pivots = np.diag(lower) ** 2
    np.testing.assert_allclose(numbers(*factor.inverse_pivots), 1.0 / pivots, rtol=1e-11)
    assert float(factor.smallest_pivot) == pytest.approx(pivots.min() / np.diag(matrix).max())
    unit = lower / np.diag(lower)
    for i, row in enumerate(factor.lower):
        np.testing.assert_allclose(numbers(*row), unit[i, :i], rtol=1e-10, atol=1e-14)
    empty = la.unknown_factor(size)
    assert [len(row) for row in empty.lower] == list(range(size)) and len(empty.inverse_pivots) == size
    assert not any(map(float, (*empty.inverse_pivots, empty.smallest_pivot, *sum(empty.lower, ()))))
    assert la.solve(la.factorise([]), []) == () and float(la.factorise([]).smallest_pivot) == 1.0


def test_large_systems_are_solved_by_their_factors_in_a_loop():
    matrix = RNG.normal(size=(7, 7))
    matrix = jnp.asarray(matrix @ matrix.T + np.diag(np.arange(1.0, 8.0)))
    right, ways = jnp.asarray(RNG.normal(size=7)), jnp.asarray(RNG.normal(size=(2, 7, 7)))
    written = jax.jit(lambda a: la.factorise([[a[i, j] for j in range(i + 1)] for i in range(7)]))(matrix)

    @jax.jit
    def solved(t):
        changed = matrix + t * (ways[0] + ways[0].T)
        factor = la.factorise_in_loop(changed)
        return la.solve_in_loop(factor, right), factor.smallest_pivot

    (found, pivot), (slope, _) = jax.jvp(solved, (0.0,), (1.0,))
    np.testing.assert_allclose(found, np.linalg.solve(matrix, right), rtol=1e-11)
    assert float(pivot) == pytest.approx(float(written.smallest_pivot), rel=1e-12)
    # d(A^-1) b = -A^-1 dA A^-1 b, forwards and backwards.
    wanted = -np.linalg.solve(matrix, (ways[0] + ways[0].T) @ np.linalg.solve(matrix, right))
    np.testing.assert_allclose(slope, wanted, rtol=1e-10)
    np.testing.assert_allclose(jax.grad(lambda t: solved(t)[0] @ right)(0.0), wanted @ right, rtol=1e-10)
    many = jax.vmap(lambda t: solved(t)[0])(jnp.array([0.0, 0.01]))
    np.testing.assert_allclose(many[0], found, rtol=1e-13)
    changed = matrix + 0.01 * (ways[0] + ways[0].T)
    np.testing.assert_allclose(many[1], np.linalg.solve(changed, right), rtol=1e-11)
    empty = la.unknown_loop_factor(7)
    assert jax.tree.map(jnp.shape, empty) == jax.tree.map(jnp.shape, la.factorise_in_loop(matrix))
    singular = la.factorise_in_loop(jnp.ones((3, 3)))
    assert not float(singular.smallest_pivot) > 0.0


def test_rows_of_arrays():
    rows, new = jnp.arange(12.0).reshape(4, 3), jnp.array([7.0, 8.0, 9.0])
    np.testing.assert_array_equal(la.row(rows, jnp.asarray(2)), [6.0, 7.0, 8.0])
    wanted = np.arange(12.0).reshape(4, 3)
    wanted[1] = new
    for put in (la.with_row, la.with_row_selected):
        np.testing.assert_array_equal(put(rows, new, jnp.asarray(1)), wanted)
    np.testing.assert_array_equal(
        la.with_row_selected(jnp.arange(3.0), jnp.asarray(5.0), jnp.asarray(2)), [0, 1, 5]
    )
    assert la.stacked([]).shape == (0,) and la.stacked([jnp.ones(()), jnp.zeros(())]).tolist() == [1.0, 0.0]
    weights = [2.0, jnp.asarray([1.0, 10.0, 100.0]), 0.0, -1.0]
    np.testing.assert_allclose(
        la.weighted_sum(weights, rows), 2.0 * wanted[0] + np.array([3.0, 40.0, 500.0]) - wanted[3]
    )
    nested = la.unstack(jnp.arange(6).reshape(2, 3))
    assert [[int(x) for x in row] for row in nested] == [[0, 1, 2], [3, 4, 5]]
    assert la.unstack(nested) is nested and la.unstack(None) is None and la.unstack(3.0) == 3.0
    assert la.scalars(jnp.zeros(0)) == [] and [float(x) for x in la.scalars(jnp.arange(2.0))] == [0.0, 1.0]
    assert float(la.larger(2.0, 3.0)) == float(la.larger(3.0, 2.0)) == 3.0
    assert float(la.smaller(2.0, 3.0)) == float(la.smaller(3.0, 2.0)) == 2.0
    assert all(np.isnan(f(*pair)) for f in (la.larger, la.smaller) for pair in ((np.nan, 1.0), (1.0, np.nan)))
    assert float(la.largest(jnp.array([[1.0, 5.0], [3.0, 2.0]]))) == 5.0
