r"""Closest points of two contours: all local minima of their signed distance, located globally.

All is done in the frame of `b`. With the tangents $t_a, t_b$, the points $P_a, P_b$ and the arm
$r = P_a - P_b$ the conditions are $t_a \times t_b = 0$ and $r \cdot t_b = 0$. The steps of `_locate`:

1. `_estimate`: sample `a`, find the feet of the samples on `b`, and estimate the local minima of their signed
   distance (`_candidates`).
2. `_refine`: Newton's method for the arclength on `a`, kept in a bracket; the point on `b` follows its foot.
3. `_newton`: Newton's method on both conditions at once. Its last steps start at a root, and so give the
   derivatives of the implicit function theorem.
4. `_verified`: keep the pairs that are true minima, nearest to each other.
5. `_report`: merge the pairs that are the same, take the lowest, and tell whether it is the answer.

Candidates are an axis of every array: what is no minimum is masked. `_location3` does the same in space.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._linalg import Pose2, sincos, unstack, Vec2
from ..._results import as_count, as_floats, check_instance, RESULTS
from ..._types import ByPrecision, Given, Scalar
from ..._xla import quickly
from ...geometry import AbstractContour, check_contour, Frenet2, tabled
from ._answers import LocalMinima, Location
from ._candidates import feet, into, lowest, Minima, minima, MOST_SAMPLES, nearest_blocked, spread, toward

# Steps of the bracketed Newton method, which `_newton` finishes.
_STEPS = 10
# All lengths are relative to the mean radius (perimeter over 2 pi) of both contours. In single precision gaps
# are rounded to some 1e-6 of it, and residuals are up to 5e-6. The gap differs from that of the stationary
# pair by the square of the residual, which is below rounding at either limit of `_SETTLED`.
_SETTLED = ByPrecision(1e-11, 1e-4)  # a pair is stationary if its residual is below this
_MERGED = ByPrecision(1e-6, 1e-3)  # minima are one if both arclengths differ by less than this
_ALIKE = ByPrecision(1e-9, 1e-6)  # gaps are equal if they differ by less than this
# A second derivative below this, over the radius, does not single out a point.
_FLAT = ByPrecision(1e-9, 1e-4)
_MISSED = 1e-4  # a minimum was missed if a sample lies below the lowest gap by more than this
_BEND = 0.05  # least value of 1 + curvature * distance in a step; it is zero at a centre of curvature


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class _Scene:
    """Both contours, prepared, the pose of `a` in the frame of `b`, and the mean radius."""

    a: AbstractContour
    b: AbstractContour
    pose: Pose2
    scale: Scalar


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class _Pairs:
    """Pairs of points in the frame of `b`, with what decides whether they are closest.

    Attributes:
        a: Frame of the contour `a` at its point.
        b: Frame of the contour `b` at its point.
        arm: From the point of `b` to that of `a` [m].
        along: Arclength on `b` from its point to the foot of the point of `a`, to first order [m].
        bend: One plus curvature of `b` times distance: negative beyond a centre of curvature.
        distance: Signed distance [m].
        slope: Derivative of the distance along `a`, with the foot on `b` following.
        rise: Its second derivative [1/m].
        held: Whether the point of `a`, and that of `b`, is at an end of its contour and would go past it.
    """

    a: Frenet2
    b: Frenet2
    arm: Vec2
    along: Array
    bend: Array
    distance: Array
    slope: Array
    rise: Array
    held: tuple[Array, Array]


def locate(
    a: AbstractContour,
    b: AbstractContour,
    *,
    pose_a: Given = (0.0, 0.0, 0.0),
    pose_b: Given = (0.0, 0.0, 0.0),
    samples: int = 128,
    candidates: int = 8,
) -> Location:
    r"""Closest points of two contours at given poses, and the signed gap between them.

    The gap is the least signed distance of a point of `a` from `b`: their distance where they are
    apart, minus the depth of the deepest point of `a` inside `b` where they overlap. At an interior
    minimum the tangents are parallel, $t_a \times t_b = 0$, and the arm between the points is normal to
    them, $(P_b - P_a) \cdot t_a = 0$; at an end of an open contour one of the two conditions gives way to
    $s$ being that end.

    All local minima of the distance along the sampled contour `a` are estimated, the lowest
    `candidates` of them refined by a bracketed Newton method, checked and merged.

    Args:
        a: A contour with ends or closed.
        b: The other one.
        pose_a: Position [m] and angle [rad] of the body of `a`, shape (3,).
        pose_b: The same for `b`.
        samples: Points on each contour. Static.
        candidates: Local minima that are refined. Static.

    Returns:
        A `Location`. Its code is `too_deep` where the deepest point has no single nearest point on
        `b`, and `solver_failed` where no pair was stationary; the gap is then that of the lowest sample.

    Raises:
        ValueError: If a contour is endless, a pose is not of shape (3,), or a count is too small.

    Accuracy: the residual is at rounding, about 1e-15 of the contours' size. In single precision gaps and
    arclengths are right to some 1e-6 of it, and gaps count as equal that differ by less. Features finer than
    the spacing of the samples, and overlaps deeper than the radii of curvature, may be missed.

    Batching: `vmap` over anything, 128 pairs or so at a time (`jax.lax.map(..., batch_size=128)`), whose
    samples stay in a processor's cache; prepare contours of constant shape once, outside. Both modes of
    autodiff give first and second derivatives, by the implicit function theorem.

    Example:
        >>> import jaxroll as jxr
        >>> found = jxr.contact.locate(jxr.Circle(0.01), jxr.Circle(0.02), pose_a=(0.05, 0.0, 0.0))
        >>> f"{found.gap:.3f} m"
        '0.020 m'
    """
    a, b = (_with_ends(name, contour) for name, contour in (("a", a), ("b", b)))
    samples = as_count("samples", samples, least=8, most=MOST_SAMPLES)
    candidates = as_count("candidates", candidates, most=samples)
    poses = (as_floats("pose_a", pose_a, (3,)), as_floats("pose_b", pose_b, (3,)))
    return _locate(a, b, poses, samples, candidates)


def _with_ends(name: str, contour: AbstractContour) -> AbstractContour:
    """A contour with its table, or the sentence that says why it cannot be located on."""
    contour = tabled(check_instance(name, contour, AbstractContour, "a contour"))
    if contour.domain() is None:
        kind = type(contour).__name__
        raise ValueError(f"argument {name} must have ends or be closed, but was an endless {kind}")
    check_contour(name, contour)
    return contour


@quickly
def _locate(
    a: AbstractContour, b: AbstractContour, poses: tuple[Array, Array], samples: int, candidates: int
) -> Location:
    """The five steps above, compiled as one program."""
    world = _pose(poses[1])
    a, b = a.prepared(), b.prepared()
    scale = (_length(a) + _length(b)) / (4.0 * np.pi)
    scene = _Scene(a, b, _relative(_pose(poses[0]), world), scale)
    # The search and its decisions carry no derivatives; these enter with `scene` in the last steps alone.
    fixed = _constant(scene)
    s_b = spread(fixed.b, samples)
    outline = fixed.b.frame(s_b)
    start, lowest, depth = _estimate(fixed, (s_b, outline), candidates)
    s = _refine(fixed, start)
    held = _pairs(fixed, s).held
    # One step to finish, then two from a root s. As the residual F is zero there, a step s - J^-1 F has the
    # derivative -J^-1 dF of the implicit function theorem, whatever that of J: the first gives first
    # derivatives, the second second ones. The number of steps is fixed, which reverse mode
    # needs.
    s = jax.lax.fori_loop(0, 3, lambda _, s: _newton(scene, s, held), s)
    # The lowest sample becomes the last pair: it is the answer where no other pair is.
    sample = _sampled(scene, samples, lowest)
    s = (jnp.append(s[0], sample[0]), jnp.append(s[1], sample[1]))
    found = _pairs(scene, s, (jnp.append(held[0], False), jnp.append(held[1], False)))
    fair = _verified(fixed, (s_b, outline), (_constant(s), _constant(found)), start)
    return _report(scene, world, (s, found, fair), (start, depth))


def _constant(tree: Any) -> Any:
    """The same numbers without derivatives."""
    return jax.tree.map(lambda x: jax.lax.stop_gradient(x) if eqx.is_inexact_array(x) else x, tree)


def _pose(numbers: Array) -> Pose2:
    """A pose from position [m] and angle [rad]."""
    x, y, angle = unstack(numbers)
    sin, cos = sincos(angle)
    return Pose2(Vec2(x, y), cos, sin)


def _relative(a: Pose2, b: Pose2) -> Pose2:
    """The pose of `a` in the frame of `b`."""
    return Pose2(into(b, a.origin), a.cos * b.cos + a.sin * b.sin, a.sin * b.cos - a.cos * b.sin)


def _ends(contour: AbstractContour) -> tuple[Scalar, Scalar]:
    """First and last arclength of a contour [m]."""
    ends = contour.domain()
    assert ends is not None  # `locate` has checked
    return ends[0], ends[1]


def _length(contour: AbstractContour) -> Scalar:
    """Arclength of a contour from end to end, or once round it [m]."""
    first, last = _ends(contour)
    return last - first


def _estimate(
    scene: _Scene, outline: tuple[Array, Frenet2], candidates: int
) -> tuple[Minima, tuple[Array, Array], Array]:
    """Estimated local minima; the lowest sample's number, and that of `b` nearest; its signed distance [m].

    `outline` holds the samples of `b`: arclengths and frames.
    """
    s_b, frames = outline
    s = spread(scene.a, s_b.shape[0])
    frame = scene.a.frame(s)
    points = scene.pose.place(frame.point)
    near = nearest_blocked(frames.point, points)
    # The frame of a circle has one curvature for all samples.
    at = jax.tree.map(lambda x: jnp.broadcast_to(x, s_b.shape)[near], (s_b, frames))
    found = toward(scene.b, (s_b[0], s_b[-1]), at, points)
    rate = found.slope.dot(scene.pose.turn(frame.tangent))
    turn = _length(scene.b) if scene.b.closed else jnp.inf
    best = minima(s, found, rate, turn=turn, closed=scene.a.closed, count=candidates)
    i = jnp.argmin(found.distance)
    return best, (i, near[i]), found.distance[i]


def _sampled(scene: _Scene, count: int, lowest: tuple[Array, Array]) -> tuple[Array, Array]:
    """Arclengths of the lowest sample and its foot as `_estimate` finds it, here with their derivatives."""
    s_a, s_b = (spread(contour, count)[i] for contour, i in zip((scene.a, scene.b), lowest, strict=True))
    point = scene.pose.place(scene.a.frame(s_a).point)
    return s_a, toward(scene.b, _ends(scene.b), (s_b, scene.b.frame(s_b)), point).s


def _inside(contour: AbstractContour, s: Array) -> Array:
    """Arclengths put between the ends of an open contour."""
    return s if contour.closed else jnp.clip(s, *_ends(contour))


def _pairs(scene: _Scene, s: tuple[Array, Array], held: tuple[Array, Array] | None = None) -> _Pairs:
    """Evaluate pairs of points at arclengths on `a` and `b`; which are held is found unless it is given."""
    local, b = scene.a.frame(s[0]), scene.b.frame(s[1])
    a = Frenet2(scene.pose.place(local.point), scene.pose.turn(local.tangent), local.curvature)
    arm = a.point - b.point
    out, ahead = arm.cross(b.tangent), arm.dot(b.tangent)
    held_b = _pressing(scene.b, s[1], ahead) if held is None else held[1]
    bend = 1.0 + b.curvature * out
    along = ahead / jnp.maximum(bend, _BEND)
    # The gradient of the distance at the point of `a`: from an end it is along the arm, else it is the normal
    # at the foot. The inner `where` keeps the derivative of the root finite where the arm is zero.
    square = arm.dot(arm)
    apart = jnp.sqrt(jnp.where(held_b & (square > 0.0), square, 1.0))
    facing, normal = a.tangent.dot(b.tangent), b.tangent.right() + b.tangent * (b.curvature * along)
    upwards = Vec2(jnp.where(held_b, arm.x / apart, normal.x), jnp.where(held_b, arm.y / apart, normal.y))
    slope = upwards.dot(a.tangent)
    # Second derivative along `a`: the curvature of `a` times the gradient's part along its inward normal,
    # plus the bend of the distance's level lines: (t_a . t_b)^2 kappa_b / (1 + kappa_b d), or about an end
    # (1 - slope^2) / d.
    spread_out = jnp.where(
        held_b, (1.0 - slope**2) / apart, facing**2 * b.curvature / jnp.maximum(bend, _BEND)
    )
    rise = a.curvature * upwards.dot(a.tangent.left()) + spread_out
    held_a = _pressing(scene.a, s[0], -slope) if held is None else held[0]
    distance = jnp.where(held_b, jnp.where(square > 0.0, apart, 0.0), out)
    return _Pairs(a, b, arm, along, bend, distance, slope, rise, (held_a, held_b))


def _pressing(contour: AbstractContour, s: Array, push: Array) -> Array:
    """Whether a point at an end would go past it, pushed in the direction of `push`."""
    if contour.closed:
        return jnp.zeros(s.shape, bool)
    first, last = _ends(contour)
    return ((s <= first) & (push < 0.0)) | ((s >= last) & (push > 0.0))


def _refine(scene: _Scene, start: Minima) -> tuple[Array, Array]:
    """Bracketed Newton's method along `a`, with the foot on `b` following, for all pairs at once.

    Returns arclengths on both contours, between their ends.
    """
    s = (_inside(scene.a, start.s[0]), _inside(scene.b, start.s[1]))
    bracket = tuple(_inside(scene.a, start.s[0] + side * start.reach[0]) for side in (-1.0, 1.0))

    def improve(i: Array, carry: tuple[Array, ...]) -> tuple[Array, ...]:
        s_a, s_b, low, high = carry
        pair = _pairs(scene, (s_a, s_b))
        # First the point of `b` goes towards the foot of the point of `a`, by half its reach at most.
        half = 0.5 * start.reach[1]
        follow = jnp.where(pair.held[1], 0.0, jnp.clip(pair.along, -half, half))
        # The slope tells on which side the minimum lies, but it is right only near the foot: the bracket is
        # moved only where the normal turns by less than 0.2 rad on the way there.
        trusted = jnp.abs(pair.b.curvature * follow) < 0.2
        low = jnp.where(trusted & (pair.slope < 0.0), s_a, low)
        high = jnp.where(trusted & (pair.slope >= 0.0), s_a, high)
        convex = pair.rise > 0.0
        newton = s_a - jnp.where(
            convex, pair.slope / jnp.where(convex, pair.rise, 1.0), jnp.sign(pair.slope) * start.reach[0]
        )
        outside = (newton < low) | (newton > high)
        # A target outside of the bracket becomes its middle, and in every other pass the end that it would
        # pass: a minimum at an end of an open contour, where its bracket ends, is reached exactly.
        middle = jnp.where(i % 2 == 0, 0.5 * (low + high), jnp.clip(newton, low, high))
        target = jnp.where(outside, middle, newton)
        # Then the point of `b` follows the step on `a`, ds_b = ds_a (t_a . t_b) / (1 + kappa_b d).
        hop = (target - s_a) * pair.a.tangent.dot(pair.b.tangent) / jnp.maximum(pair.bend, _BEND)
        hop = jnp.where(pair.held[1], 0.0, jnp.clip(hop, -half, half))
        s_b = jnp.clip(s_b + follow + hop, start.s[1] - start.reach[1], start.s[1] + start.reach[1])
        return target, _inside(scene.b, s_b), low, high

    return jax.lax.fori_loop(0, _STEPS, improve, (*s, *bracket))[:2]


def _newton(scene: _Scene, s: tuple[Array, Array], held: tuple[Array, Array]) -> tuple[Array, Array]:
    """One Newton step on the conditions of stationarity, for both arclengths at once.

    The condition of a point that is held at an end is that its arclength is that of the end. Where the second
    derivative singles out no point, as between parallel lines, the point of `a` stays where it is.
    """
    at = _pairs(scene, s, held)
    ends = [_nearer_end(contour, x) for contour, x in zip((scene.a, scene.b), s, strict=True)]
    facing = at.a.tangent.dot(at.b.tangent)
    one, zero = jnp.ones_like(s[0]), jnp.zeros_like(s[0])
    # Every condition with its derivatives in s_a and s_b: parallel tangents; arm normal to `a`;
    # arm normal to `b`.
    parallel = (at.a.tangent.cross(at.b.tangent), -at.a.curvature * facing, at.b.curvature * facing)
    normal_a = (at.arm.dot(at.a.tangent), 1.0 + at.a.curvature * at.arm.dot(at.a.tangent.left()), -facing)
    normal_b = (at.arm.dot(at.b.tangent), facing, -at.bend)
    # From an end of `b` there is no tangent to be parallel to: the arm must be normal to `a`.
    flat = jax.lax.stop_gradient(~_singled_out(scene, at))
    row_a = _choose(at.held[1], normal_a, parallel)
    row_a = _choose(at.held[0], (s[0] - ends[0], one, zero), _choose(flat, (zero, one, zero), row_a))
    row_b = _choose(at.held[1], (s[1] - ends[1], zero, one), normal_b)
    # The step s - J^-1 F, by Cramer's rule.
    det = row_a[1] * row_b[2] - row_a[2] * row_b[1]
    inverse = 1.0 / jnp.where(det == 0.0, 1.0, det)
    return (
        s[0] - (row_a[0] * row_b[2] - row_a[2] * row_b[0]) * inverse,
        s[1] - (row_a[1] * row_b[0] - row_a[0] * row_b[1]) * inverse,
    )


def _nearer_end(contour: AbstractContour, s: Array) -> Array:
    """The arclength of whichever end of a contour is nearer."""
    first, last = _ends(contour)
    return jnp.where(jnp.abs(s - first) < jnp.abs(s - last), first, last)


def _choose(which: Array, yes: tuple[Array, ...], no: tuple[Array, ...]) -> tuple[Array, ...]:
    """One of two tuples, for every pair."""
    return tuple(jnp.where(which, x, y) for x, y in zip(yes, no, strict=True))


def _singled_out(scene: _Scene, at: _Pairs) -> Array:
    """Whether the conditions determine a pair: the distance is curved along `a`, and the foot is unique."""
    flat = _FLAT.of(at.rise)
    firm = (jnp.abs(at.rise) * scene.scale > flat) | at.held[0]
    return firm & ((jnp.abs(at.bend) > flat) | at.held[1])


def _residual(scene: _Scene, at: _Pairs) -> Array:
    """How far the conditions of stationarity are from zero [m]; a held point has none of its own."""
    foot = jnp.where(at.held[1], 0.0, jnp.abs(at.arm.dot(at.b.tangent)))
    turned = jnp.abs(at.a.tangent.cross(at.b.tangent)) * scene.scale
    along = jnp.where(at.held[1], jnp.abs(at.arm.dot(at.a.tangent)), turned)
    return jnp.maximum(foot, jnp.where(at.held[0], 0.0, along))


def _around(contour: AbstractContour, difference: Array) -> Array:
    """Differences of arclengths, the shorter way round a closed contour."""
    if not contour.closed:
        return difference
    length = _length(contour)
    return difference - length * jnp.round(difference / length)


def _verified(
    scene: _Scene,
    outline: tuple[Array, Frenet2],
    pairs: tuple[tuple[Array, Array], _Pairs],
    start: Minima,
) -> Array:
    """Which pairs are local minima: stationary, not a maximum, and nearest to each other."""
    (s_b, frames), (s, at) = outline, pairs
    step = s_b[1] - s_b[0]
    # No other point of `b` may be nearer: the foot searched from all samples is this pair's, or as far away.
    foot = feet(scene.b, s_b, at.a.point, nearest_blocked(frames.point, at.a.point))
    near = jnp.abs(_around(scene.b, foot.s - s[1])) < 0.25 * step
    near = near | (jnp.abs(foot.distance - at.distance) < 1e-3 * step)
    inside = [
        jnp.abs(x - _inside(contour, x)) <= _ALIKE.of(x) * scene.scale
        for contour, x in zip((scene.a, scene.b), s, strict=True)
    ]
    # A minimum along `a`, flat ones included, and on this side of the centre of curvature of `b`.
    valley = (at.rise * scene.scale > -_FLAT.of(at.rise)) | at.held[0]
    centred = (at.bend > 0.0) | at.held[1]
    settled = _residual(scene, at) <= _SETTLED.of(at.distance) * scene.scale
    # Entries without a minimum have an infinite bound; the lowest sample, which is last, is no minimum.
    known = jnp.isfinite(jnp.append(start.bound, jnp.inf))
    return settled & valley & centred & near & inside[0] & inside[1] & known


def _report(
    scene: _Scene,
    world: Pose2,
    pairs: tuple[tuple[Array, Array], _Pairs, Array],
    known: tuple[Minima, Array],
) -> Location:
    """The answer: the lowest pair that is a minimum, or the lowest sample with the code that says why.

    Args:
        scene: The contours.
        world: Pose of `b` in the world.
        pairs: Arclengths of all pairs, what was evaluated there, and which are minima; the lowest sample
            last.
        known: The estimates that were refined, and the signed distance of the lowest sample [m].
    """
    s, at, fair = pairs
    start, sample = known
    gaps = jnp.where(fair, at.distance, jnp.inf)
    k, count = jnp.argmin(gaps), gaps.shape[0] - 1
    # The lowest pair is not the answer if a sample lies below it, or an estimate without a minimum might.
    lowest_pair = gaps[k] - _MISSED * scene.scale
    missed = (sample < lowest_pair) | jnp.any(~fair[:-1] & (start.bound < lowest_pair))
    others = jnp.where(_twins(scene, s, fair, k), jnp.inf, gaps)
    k = jnp.where(missed, count, k)
    final = jax.tree.map(lambda x: jnp.broadcast_to(x, gaps.shape)[k], at)
    wrapped = jnp.stack([_wrapped(c, x) for c, x in zip((scene.a, scene.b), s, strict=True)], axis=-1)
    order = lowest(others, count)
    there = jnp.arange(count) < jnp.sum(jnp.isfinite(others))
    alike = jnp.min(others) <= final.distance + _ALIKE.of(gaps) * scene.scale
    # Overlapping contours have no such pair where the deepest point has no single nearest point on `b`.
    deep = RESULTS.where(sample < 0.0, RESULTS.too_deep, RESULTS.solver_failed)
    return Location(
        gap=final.distance,
        s=wrapped[k],
        points=jnp.stack([world.place(final.a.point).array(), world.place(final.b.point).array()]),
        normal=world.turn(final.b.tangent.right()).array(),
        residual=_residual(scene, final),
        unique=~missed & ~alike & _singled_out(scene, final),
        others=LocalMinima(
            jnp.where(there, others[order], jnp.inf), jnp.where(there[:, None], wrapped[order], 0.0), there
        ),
        result=RESULTS.where(missed, deep, RESULTS.successful),
    )


def _wrapped(contour: AbstractContour, s: Array) -> Array:
    """Arclengths on a closed contour within its domain."""
    if not contour.closed:
        return s
    first, last = _ends(contour)
    turns = jnp.floor(jax.lax.stop_gradient((s - first) / (last - first)))
    return s - turns * (last - first)


def _twins(scene: _Scene, s: tuple[Array, Array], fair: Array, k: Array) -> Array:
    """Which pairs are the same as pair `k` or as an earlier pair; `k` itself is among them."""
    close = fair[:, None] & fair[None, :]
    for contour, x in zip((scene.a, scene.b), s, strict=True):
        apart = jnp.abs(_around(contour, x[:, None] - x[None, :]))
        close = close & (apart < _MERGED.of(x) * scene.scale)
    number = jnp.arange(fair.shape[0])
    return jnp.any(close & (number[None, :] < number[:, None]), axis=1) | close[k] | (number == k)
