"""Closest points of two surfaces: local minima of their signed distance, located globally.

As `_location` in the plane, but a surface has no order along which a minimum could be bracketed. The steps of
`_locate`, in the frame of `b`:

1. `_starts`: samples of both surfaces that are lowest among their neighbours, with their feet (`_samples3`).
2. `_refine`: Newton's method down the distance, in a trust region (`_pair3` has its equations).
3. `_sorted`: keep the pairs that are true minima, lowest first, each once.
4. `polished`: Newton steps from a root, which give the derivatives.
5. `_report`: the answer, in the order of the caller's arguments.

At least one surface must be bounded; it is `a` inside. Candidates are an axis of every array: what is no
minimum is masked.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._linalg import normalised, Pose3, pose_at, unstack, Vec3
from ..._results import as_count, as_floats, check_instance, concrete, RESULTS
from ..._types import ByPrecision, Given, Scalar
from ..._xla import quickly
from ...geometry import AbstractSurface, check_surface, tabled
from ._answers import SurfaceLocation, SurfaceMinima
from ._candidates import lowest, MOST_SAMPLES
from ._pair3 import constant, linear, Pair3, Places, Plane2, polished, stepped, TangentForm
from ._samples3 import Cover, cover, distance, END, ended, feet3, footed, Starts, starts

_STEPS = 24  # of Newton's method in a trust region
_FOLLOW = 2  # Newton steps of the foot on `b` for each of these
_POLISH = 3  # final Newton steps; the first two already give first and second derivatives
_ORIGIN = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
# What has two limits differs with the precision of places and pose (`ByPrecision.of`).
_SETTLED = ByPrecision(1e-10, 1e-4)  # a pair is stationary if its residual is below this
# A second derivative below this, over the scale, does not single out a point.
_FLAT = ByPrecision(1e-9, 1e-4)
# The others are relative to the surfaces' size.
_MERGED = ByPrecision(1e-6, 1e-3)  # minima are one if no coordinate of their points differs by more
_ALIKE = ByPrecision(1e-9, 1e-6)  # gaps are equal if they differ by less than this
_MISSED = 1e-4  # a minimum was missed if a sample lies below the lowest gap by more than this
_SAME = ByPrecision(1e-13, 1e-6)  # a step may raise the distance by this, which is rounding


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class _Measure:
    """What decides whether a pair is closest.

    Attributes:
        points: Points of `a` and `b`, in the frame of `b` [m].
        normals: Outward normals there.
        gap: Signed distance [m].
        residual: How far the conditions are from zero, without dimension (`SurfaceLocation.residual`).
        low: Smaller eigenvalue of the distance's second derivative, times the scale.
        fair: Whether the distance falls in no direction to second order, no centre of curvature of `b` lies
            between the points, and both are within the ends.
    """

    points: tuple[Vec3, Vec3]
    normals: tuple[Vec3, Vec3]
    gap: Array
    residual: Array
    low: Array
    fair: Array


def locate_surfaces(
    a: AbstractSurface,
    b: AbstractSurface,
    *,
    pose_a: Given = _ORIGIN,
    pose_b: Given = _ORIGIN,
    samples: int = 256,
    candidates: int = 8,
) -> SurfaceLocation:
    r"""Closest points of two surfaces at given poses, and the signed gap between them.

    The gap is the least signed distance of a point of `a` from `b`: their distance where they are apart,
    minus the depth of the deepest point of `a` inside `b` where they overlap. There the normals are opposite,
    $n_a + n_b = 0$, and the arm between the points is along them, $P_a - P_b = g\,n_b$.

    Both surfaces are sampled all over, and every sample brought to its foot on the other. From the lowest
    samples among their neighbours, at most `candidates` of each surface, Newton's method in a trust region
    goes down to the minima; these are checked and merged. An unbounded surface is not sampled.

    Args:
        a: A surface; of `a` and `b` at least one must be bounded (`spread`).
        b: The other one.
        pose_a: Position [m] and quaternion (scalar first, scaled to unit length) of the body of `a`, (7,).
        pose_b: The same for `b`.
        samples: Places on each surface. Static.
        candidates: Local minima that are refined. Static.

    Returns:
        A `SurfaceLocation`. Its code is `contour_end` where a pair at an end of a surface is closer than any
        with a common tangent plane, `too_deep` where the deepest point has no single nearest point on `b`,
        and `solver_failed` where no pair was stationary; the gap is then that of the lowest sample.

    Raises:
        ValueError: If neither surface is bounded, a pose is not of shape (7,) or has no rotation, or a count
            is too small.

    Accuracy: the residual is at rounding, about 1e-15. In single precision it is about 1e-7, gaps and points
    are right to some 1e-6 of the surfaces' size, and gaps count as equal that differ by less. Features finer
    than the spacing of the samples, and overlaps deeper than the radii of curvature, may be missed.

    Batching: `vmap` over anything. Both modes of autodiff give first and second derivatives, by the implicit
    function theorem; coordinates on an implicit surface follow it along its normal as its numbers change.

    Example:
        >>> import jaxroll as jxr
        >>> ball, floor = jxr.Sphere(0.01), jxr.Plane()
        >>> found = jxr.contact.locate_surfaces(ball, floor, pose_a=(0.2, 0.1, 0.03, 1.0, 0.0, 0.0, 0.0))
        >>> f"{found.gap:.3f} m"
        '0.020 m'
    """
    for name, surface in (("a", a), ("b", b)):
        check_surface(name, check_instance(name, surface, AbstractSurface, "a surface"))
    samples = as_count("samples", samples, least=16, most=MOST_SAMPLES)
    candidates = as_count("candidates", candidates, most=samples)
    poses = (_checked("pose_a", pose_a), _checked("pose_b", pose_b))
    return _locate(tabled(a), tabled(b), poses, samples, candidates)


def _checked(name: str, value: Given) -> Array:
    """A pose as seven numbers, whose quaternion is not zero."""
    numbers = as_floats(name, value, (7,))
    seen = concrete(numbers)
    if seen is not None and not seen[3:].any():
        raise ValueError(f"argument {name} must end with a quaternion, but was {seen.tolist()}")
    return numbers


@quickly
def _locate(
    a: AbstractSurface, b: AbstractSurface, poses: tuple[Array, Array], samples: int, candidates: int
) -> SurfaceLocation:
    """The five steps above, compiled as one program."""
    a, b = a.prepared(), b.prepared()
    # The search and its decisions carry no derivatives; these enter in the steps of `polished` alone.
    covers = (constant(cover(constant(a), samples)), constant(cover(constant(b), samples)))
    if covers[0] is None and covers[1] is None:
        kinds = " and ".join(type(surface).__name__ for surface in (a, b))
        raise ValueError(f"argument a or b must be a bounded surface, but they were {kinds}")
    # Only bounded surfaces are sampled: one that is not is taken as `b`; `_report` exchanges them again.
    swapped, kind = covers[0] is None, jnp.result_type(*poses)
    # A quaternion is scaled after it got the precision of both: else it would not turn by unit vectors there.
    worlds = (_pose(jnp.asarray(poses[0], kind)), _pose(jnp.asarray(poses[1], kind)))
    if swapped:
        (a, b), covers, worlds = (b, a), covers[::-1], worlds[::-1]
    sizes = [found.size() for found in covers if found is not None]
    pair = Pair3(a, b, _relative(*worlds), sum(sizes) / len(sizes))
    fixed = constant(pair)
    start = _starts(fixed, covers, candidates)
    at = jax.vmap(lambda at, reach: _refine(fixed, at, reach))(start.at, start.reach)
    at, fair, missed = _sorted(fixed, covers[1], at, start, candidates)
    # Where no pair is the answer, the lowest sample is; it is no root, and its foot alone moves.
    first = jnp.arange(candidates) == 0
    at = jax.tree.map(lambda x, y: jnp.where(missed & first, y, x), at, start.sample)
    root = fair & ~(missed & first)
    at = jax.vmap(lambda at, root: polished(pair, at, root, start.of_b, steps=_POLISH))(at, root)
    return _report(pair, (worlds[1], swapped), (at, fair, missed), start)


def _pose(numbers: Array) -> Pose3:
    """A pose from position and quaternion, scaled to unit length."""
    x, y, z, *q = unstack(numbers)
    return pose_at(Vec3(x, y, z), normalised((q[0], q[1], q[2], q[3])))


def _relative(a: Pose3, b: Pose3) -> Pose3:
    """The pose of `a` in the frame of `b`."""
    return Pose3(b.local(a.origin), b.back(a.x), b.back(a.y), b.back(a.z))


def _starts(pair: Pair3, covers: tuple[Cover | None, Cover | None], count: int) -> Starts:
    """Pairs to start from: `count` of the samples of `a`, and as many of those of `b` if it is bounded.

    One of the surfaces may be small beside the spacing of the other one's samples, which then miss it.
    """
    assert covers[0] is not None  # `_locate` has put the bounded one first
    first = starts(pair, covers[0], covers[1], count)
    if covers[1] is None:
        return first
    second = starts(pair.reversed(), covers[1], covers[0], count)
    at = jax.tree.map(lambda x, y: jnp.concatenate([x, y]), first.at, second.at[::-1])
    there = jnp.concatenate([first.there, second.there])
    reach = jnp.concatenate([first.reach, second.reach])
    below = second.distance < first.distance
    sample = jax.tree.map(lambda x, y: jnp.where(below, y, x), first.sample, second.sample[::-1])
    lowest = jnp.minimum(first.distance, second.distance)
    return Starts(at, there, reach, sample, below, lowest, first.bound)


def _refine(pair: Pair3, at: Places, reach: Scalar) -> Places:
    """Down the distance along `a`, with the foot on `b` following: Newton's method in a trust region.

    A step that lowers the distance is taken and doubles the region, up to `reach` [m]; any other one is not
    taken and reduces the region to a quarter. One pair; `_locate` maps it over all of them.
    """

    def height(at: Places) -> tuple[Places, Scalar]:
        """The pair with its point on `b` brought to the foot, and its signed distance."""
        # A long step leaves a point of an implicit surface off it, by little. Inside of the surface it would
        # be lower than all points of the surface, and no step from there would count as better.
        on_a = pair.a.settled(at[0])
        point = pair.pose.place(pair.a.frame(on_a).point)
        foot = footed(pair.b, pair.b.within(at[1]), point, _FOLLOW)
        return (on_a, foot), distance(pair, point, pair.b.frame(foot), foot)

    def improve(carry: tuple[Places, Scalar, Scalar], _: None) -> tuple[tuple[Places, Scalar, Scalar], None]:
        at, value, trust = carry
        here = pair.frames(at)
        equations = linear(*here)
        slope, aside = equations.conditions(*here)
        x = _cut(_downhill(equations.rise, slope), trust)
        # The foot may move farther than the point, by 1 / (1 + kappa d): up to four times as far is allowed.
        ahead = stepped(pair, at, equations.basis, (x, _cut(equations.follow(aside, x), 4.0 * trust)))
        new, found = height((pair.a.within(ahead[0]), ahead[1]))
        better = found <= value + _SAME.of(at, pair.pose) * pair.scale
        kept = jax.tree.map(lambda x, y: jnp.where(better, x, y), (new, found), (at, value))
        return (*kept, jnp.where(better, jnp.minimum(2.0 * trust, reach), 0.25 * trust)), None

    # The height of the start is not computed but infinite, so that the first step is always taken.
    start = (at, jnp.full_like(reach, jnp.inf), reach)
    return jax.lax.scan(improve, start, None, length=_STEPS)[0][0]


def _downhill(rise: TangentForm, slope: Plane2) -> Plane2:
    """Newton's step -H^-1 s, with a second derivative H that is made positive where it is not."""
    low, high = rise.eigenvalues()
    least = 1e-3 * jnp.maximum(jnp.abs(low), jnp.abs(high))
    # A multiple of the identity turns the step towards the gradient. An eigenvalue `low` below `least`
    # becomes 2 least - low: reflected, so that a strong downward bend gives a short step.
    firm = rise.plus(jnp.maximum(0.0, least - low) * jnp.where(low < least, 2.0, 1.0))
    return firm.solve((-slope[0], -slope[1]))


def _cut(step: Plane2, reach: Scalar) -> Plane2:
    """A step, shortened to `reach` [m] if it is longer."""
    square = step[0] * step[0] + step[1] * step[1]
    factor = reach / jnp.maximum(reach, jnp.sqrt(square))
    return step[0] * factor, step[1] * factor


def _measured(pair: Pair3, at: Places) -> _Measure:
    """Evaluate one pair; `residual`, `low` and `fair` carry no derivatives."""
    a, b = pair.frames(at)
    arm, both = a.point - b.point, a.normal + b.normal
    gap = arm.dot(b.normal)
    beside = arm - b.normal * gap
    size = pair.scale + jnp.abs(gap)
    square = jax.lax.stop_gradient(jnp.maximum(both.dot(both), beside.dot(beside) / (size * size)))
    equations = linear(*constant((a, b)))
    low = equations.rise.eigenvalues()[0] * pair.scale
    past, each = -END.of(at, pair.pose), zip((pair.a, pair.b), at, strict=True)
    ends = [ended(surface, place, past * pair.scale) for surface, place in each]
    fair = (low > -_FLAT.of(at, pair.pose)) & equations.centred & ~ends[0] & ~ends[1]
    height = distance(pair, a.point, b, at[1])
    return _Measure((a.point, b.point), (a.normal, b.normal), height, jnp.sqrt(square), low, fair)


def _sorted(
    pair: Pair3, other: Cover | None, at: Places, start: Starts, count: int
) -> tuple[Places, Array, Array]:
    """The lowest local minima, each once; which entries hold one; and whether the lowest one was missed.

    Args:
        pair: Both surfaces.
        other: Samples of `b`, if it is bounded.
        at: Refined pairs.
        start: What they were refined from.
        count: How many to return.
    """
    found = jax.vmap(lambda at: _measured(pair, at))(at)
    fair = found.fair & start.there & (found.residual <= _SETTLED.of(at, pair.pose))
    # No other place of `b` may be nearer to the point of `a` than its partner: search again from all samples.
    point = found.points[0]
    nearest = jax.vmap(pair.b.frame)(feet3(pair, other, point)).point - point
    fair = fair & (nearest.norm() >= jnp.abs(found.gap) - _MISSED * pair.scale)
    # Sorted by gap, what is no minimum last. Of pairs whose points coincide the first one stays.
    order = lowest(jnp.where(fair, found.gap, jnp.inf), fair.shape[0])
    fair = fair[order]
    close = fair[:, None] & fair[None, :]
    merged = _MERGED.of(at, pair.pose)
    for cloud in found.points:
        for x in cloud:
            close = close & (jnp.abs(x[order][:, None] - x[order][None, :]) < merged * pair.scale)
    number = jnp.arange(fair.shape[0])
    again = jnp.any(close & (number[None, :] < number[:, None]), axis=1)
    fair = fair & ~again & (number < jnp.sum(fair))
    gap = jnp.where(fair, found.gap[order], jnp.inf)
    first, there = lowest(gap, count), jnp.arange(count) < jnp.sum(fair)
    # A sample below the lowest pair shows that the true minimum led to no pair.
    missed = ~there[0] | (start.bound < jnp.min(gap) - _MISSED * pair.scale)
    return jax.tree.map(lambda x: x[order[first]], at), there, missed


def _report(
    pair: Pair3, world: tuple[Pose3, bool], pairs: tuple[Places, Array, Array], start: Starts
) -> SurfaceLocation:
    """The answer. Of the pairs the first is the closest one, or the lowest sample where that was `missed`.

    Args:
        pair: Both surfaces.
        world: Pose of `b` in the world, and whether the caller's `a` and `b` were exchanged.
        pairs: Coordinates, which entries hold a minimum, and whether the lowest one was missed.
        start: Where the search started.
    """
    at, fair, missed = pairs
    found = jax.vmap(lambda at: _measured(pair, at))(at)
    best = jax.tree.map(lambda x: x[0], found)
    # A sample of `b` has its foot on `a`, and its signed distance along the normal there.
    over_a = (best.points[1] - best.points[0]).dot(best.normals[0])
    gap = jnp.where(missed & start.of_b, over_a, best.gap)
    # The other minima are the entries after the first one, moved up by one place.
    there = jnp.append(fair[1:], False)
    gaps = jnp.where(there, jnp.roll(found.gap, -1), jnp.inf)
    alike = jnp.min(gaps) <= gap + _ALIKE.of(at, pair.pose) * pair.scale
    points, normal = [world[0].place(p).array() for p in best.points], best.normals[1]
    places = [jnp.stack(x, axis=-1) for x in at]
    if world[1]:
        points, places, normal = points[::-1], places[::-1], best.normals[0]
    others = [jnp.where(there[:, None], jnp.roll(x, -1, axis=0), 0.0) for x in places]
    return SurfaceLocation(
        gap=gap,
        at_a=places[0][0],
        at_b=places[1][0],
        points=jnp.stack(points),
        normal=world[0].turn(normal).array(),
        residual=best.residual,
        unique=~missed & ~alike & (best.low > _FLAT.of(at, pair.pose)),
        others=SurfaceMinima(gaps, others[0], others[1], there),
        result=RESULTS.where(missed, _reason(pair, start), RESULTS.successful),
    )


def _reason(pair: Pair3, start: Starts) -> RESULTS:
    """Why no pair is the answer: the lowest sample is near an end, or too deep, or nothing was stationary."""
    at, room = start.sample, jnp.max(start.reach)
    at_end = ended(pair.a, at[0], room) | ended(pair.b, at[1], room)
    deep = RESULTS.where(start.distance < 0.0, RESULTS.too_deep, RESULTS.solver_failed)
    return RESULTS.where(at_end, RESULTS.contour_end, deep)
