r"""Points to a curve with a smallest radius of curvature: what is known of the data sets all the rest.

Of a wiggle with the noise's amplitude $\sigma$ and the wavelength $\ell = 2\pi\sqrt{\sigma R}$ the curvature
is $1/R$: what is shorter cannot be shape where no radius is below R, so that $\ell$ is how much to smooth at
least; `_smoothest` smooths more where the points say so.
The noise itself is estimated from how a point differs from its two neighbours along the curve. A quarter of R
is the scale at which points are put in order (`_band`), a fifth the distance of the curve's nodes.

`_contour_fit` makes a `Spline` of the curve that `Limited.solved` finds (`_bounded_curve`), and
`_departures` says what was rounded.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..._results import told_apart
from ..contours import polygon_area
from ._band import Band, found_band
from ._bounded_curve import Bounded, bounded_curve
from ._clean_points import check_number, check_one_unit, check_spacing, CleanPoints, distinct, size_warnings
from ._departures import strays
from ._even_spline import EvenSpline, low_passed
from ._ordering import order_given_up
from ._rolled_line import along, rolled_line, spread_along

# Numbers of nodes; few of them, because programs are compiled for each.
NODES = (48, 64, 96, 128, 192, 256, 384, 512, 768, 1024)
_PER_RADIUS = 5.0  # nodes to a smallest radius
_SCALE = 0.25  # of the means that order the points, and most noise that is believed, in smallest radii
_BROAD = 6.0  # wavelength of the first curve, in smallest radii
# Where there are fewer than _STEPS points to the wavelength, it is up to _LONGER times as long.
_STEPS = 5.0
_LONGER = 1.5
_MORE = 6  # powers of _LONGER that are tried where the points allow more smoothing
# How many neighbours are looked at together at least; and up to how many of its standard deviations their
# mean distance from the curve is put down to chance.
_FEWEST, _CHANCE = 5, 3.0
# Least noise that is reckoned with, in smallest radii: in smoothing, which leaves a tenth of it, and in how
# far points may lie off.
_SMOOTH = 5e-3
_EXACT = 5e-4
SHARE = 0.97  # of the allowed curvature, in all fits here and in the first of `_contour_fit`
_FEW_STRAYS = 0.1  # largest share of the points that may be strays
_ROUGH = 0.01  # noise of the first rough line, in smallest radii
_DIRECTIONS = 64  # in which the width of the points is measured


@dataclass(frozen=True)
class Wanted:
    """What a fit with a smallest radius was asked for.

    Attributes:
        closed: Whether the contour closes on itself.
        ordered: True to believe the given order, False to find one, None to find out which.
        reverse: Turn an open contour round.
        radius: Smallest radius of curvature [m].
        noise: Standard deviation of each coordinate [m], or None.
        smoothing: Wavelength to halve [m], or None.
        knots: Number of nodes, or None.
    """

    closed: bool
    ordered: bool | None
    reverse: bool
    radius: float
    noise: float | None
    smoothing: float | None
    knots: int | None


@dataclass(frozen=True)
class Limited:
    """Points made ready for a curve of bounded curvature.

    Attributes:
        clean: The points in order, without strays.
        strays: Shape (k, 2), points left out [m].
        line: Shape (m, 2), close places along a polygon of means of the points [m].
        start: A smooth curve roughly among the points.
        noise: Standard deviation of each coordinate [m], given or estimated.
        wanted: What was asked for.
        longer: Factor from the wavelength that the radius asks for to the one that is halved.
    """

    clean: CleanPoints
    strays: np.ndarray
    line: np.ndarray
    start: EvenSpline
    noise: float
    wanted: Wanted
    longer: float = 1.0

    @property
    def wavelength(self) -> float:
        """Wavelength of the wiggles that are halved [m]."""
        if self.wanted.smoothing is not None:
            return self.wanted.smoothing
        noise = max(self.noise, _SMOOTH * self.wanted.radius)
        shortest = 2.0 * np.pi * float(np.sqrt(noise * self.wanted.radius))
        return self.longer * float(np.clip(self.sparse, shortest, _LONGER * shortest))

    @property
    def sparse(self) -> float:
        """Wavelength [m] of `_STEPS` points."""
        return _STEPS * float(self.start.arclengths()[1][-1]) / len(self.clean.points)

    @property
    def _felt(self) -> float:
        """The noise that is reckoned with [m]: a little even where there is none."""
        return max(self.noise, _EXACT * self.wanted.radius)

    def solved(self, share: float) -> Bounded:
        """The curve with curvature up to a share of what is allowed; it begins next to the first point.

        It is fitted to where discs of the smallest radius can roll; its distances are those of the points.
        """
        points, wanted = self.clean.points, self.wanted
        rolled = rolled_line(points, self.line, wanted.radius, self.noise, closed=wanted.closed)
        found = bounded_curve(
            rolled[0],
            self.start,
            line=rolled[1],
            bound=share / wanted.radius,
            noise=self._felt,
            wavelength=self.wavelength,
        )
        feet = found.curve.feet(points)
        frame = found.curve.frames(feet)
        away = np.sum((points - frame.point) * frame.normal, axis=1)
        found = found._replace(feet=feet, distances=away)
        if not wanted.closed:
            return found
        u = np.arange(found.curve.pieces) + float(found.feet[0])
        curve = EvenSpline(found.curve.frames(u).point, closed=True)
        return found._replace(curve=curve, feet=np.mod(found.feet - found.feet[0], curve.pieces))

    def onwards(self, found: Bounded) -> "Limited":
        """The same with a curve found before as the start of the next."""
        return replace(self, start=found.curve)


def limited(points: np.ndarray, wanted: Wanted) -> Limited:
    """Points [m] put in order along a rough curve, strays left out, and their noise.

    Raises:
        ValueError: If the points are too few, in mixed units, too narrow for the radius, in no plausible
            order, or leave a gap where the contour is to close.
    """
    closed, radius = wanted.closed, wanted.radius
    check_one_unit(points, closed=closed)
    kept = points[distinct(points, closed=closed, anywhere=True)]
    check_number(kept)
    _check_width(kept, wanted)
    scale = max(_SCALE * radius, 4.0 * (wanted.noise or 0.0))
    band = found_band(kept, scale, closed=closed, ordered=wanted.ordered)
    band, against, doubts = _turned(band, wanted)
    ordered = kept[band.indices]
    check_number(ordered)
    check_spacing(band.chain, closed=closed)
    line, start = _started(ordered, band.chain, wanted)
    merged = len(points) - len(kept)
    crossed = order_given_up(kept, closed=closed) if band.reordered and wanted.ordered is None else []
    doubts = (*crossed, *doubts, *size_warnings(ordered), *_sparse(ordered, wanted))
    clean = CleanPoints(ordered, merged, band.reordered, bool(closed and against), doubts)
    return _judged(Limited(clean, kept[band.strays], line, start, wanted.noise or 0.0, wanted))


def _judged(ready: Limited) -> Limited:
    """With the noise estimated where it is not given, and without the points that lie off alone.

    The noise is estimated from distances to the rough curve, then to the curve that this gives.
    """
    points, curve, wanted = ready.clean.points, ready.start, ready.wanted
    if wanted.noise is None:
        frame = curve.frames(feet := curve.feet(points))
        away = np.sum((points - frame.point) * frame.normal, axis=1)
        ready = replace(ready, noise=estimated_noise(feet, away))
    # A curve that follows every point would leave nothing to estimate the noise from; and errors that
    # neighbours share, as in silhouettes and meshes, are seen on the scale of the radius alone.
    wide = replace(wanted, smoothing=max(ready.wavelength, ready.sparse, wanted.radius))
    found = replace(ready, wanted=wide).solved(SHARE)
    if wanted.noise is None:
        shared = 1.4826 * float(np.median(np.abs(found.distances)))
        noise = max(estimated_noise(found.feet, found.distances), shared)
        ready = replace(ready, noise=min(noise, _SCALE * wanted.radius))
    bending = wanted.radius * found.curve.frames(found.feet).curvature
    alone = strays(found.feet, found.distances, bending, noise=ready.noise, radius=wanted.radius)
    if len(alone) > _FEW_STRAYS * len(points):
        alone = alone[:0]
    clean = replace(ready.clean, points=np.delete(points, alone, axis=0))
    check_number(clean.points)
    ready = replace(
        ready, clean=clean, strays=np.concatenate([ready.strays, points[alone]]), start=found.curve
    )
    return ready if wanted.smoothing is not None else _smoothest(ready)


def _smoothest(ready: Limited) -> Limited:
    r"""With as long a wavelength as serves the points: of those tried, the one of Mallows' least estimate.

    That is $\sum_i \min(r_i^2, 9\sigma^2) + 2\sigma^2\,\mathrm{tr}\,H$; a filter that passes the share
    $1/(1 + (\ell k/L)^6)$ of the k-th wave has the trace $\frac{2\pi}{3} L/\ell$. A wavelength that leaves
    neighbouring points on one side of the curve, by more than chance would, is not taken, whatever the sum
    says: it would cost a bend.
    """
    length, sigma = float(ready.start.arclengths()[1][-1]), ready.noise
    if not sigma > _SMOOTH * ready.wanted.radius:
        return ready

    def estimate(wavelength: float, distances: np.ndarray) -> float:
        square = np.minimum(distances**2, 9.0 * sigma**2)
        return float(square.sum() + 4.0 * np.pi / 3.0 * sigma**2 * length / wavelength)

    first = ready.solved(SHARE)
    least = estimate(ready.wavelength, first.distances)
    together = max(_FEWEST, round(0.5 * ready.wavelength / length * len(first.distances)))
    most = max(_CHANCE * sigma / np.sqrt(together), _leaning(first, together))
    for longer in _LONGER ** np.arange(1, _MORE):
        trial = replace(ready, longer=float(longer))
        found = trial.solved(SHARE)
        value = estimate(trial.wavelength, found.distances)
        if value >= least or _leaning(found, together) > most or trial.wavelength > 0.5 * length:
            break
        ready, least = replace(trial, start=found.curve), value
    return ready


def _leaning(found: Bounded, together: int) -> float:
    """The largest mean distance of so many neighbouring points from a curve [m]."""
    distances = found.distances[np.argsort(found.feet, kind="stable")]
    return float(np.abs(np.convolve(distances, np.full(together, 1.0 / together), "valid")).max())


def estimated_noise(places: np.ndarray, distances: np.ndarray) -> float:
    r"""Standard deviation [m] of distances from a smooth curve, whatever the curve missed.

    Each distance is compared with the straight line between its two neighbours along the curve; of
    independent errors with standard deviation $\sigma$ the difference has $\sigma \sqrt{1 + a^2 + (1-a)^2}$,
    where a is the share of the way from one neighbour to the other. The median bears with what stands out.
    """
    order = np.argsort(places, kind="stable")
    u, r = places[order], distances[order]
    width = np.maximum(u[2:] - u[:-2], np.finfo(float).tiny)
    share = np.clip((u[1:-1] - u[:-2]) / width, 0.0, 1.0)
    off = r[1:-1] - (1.0 - share) * r[:-2] - share * r[2:]
    return float(1.4826 * np.median(np.abs(off) / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)))


def _check_width(points: np.ndarray, wanted: Wanted) -> None:
    """Refuse a closed contour narrower than the disc that a smallest radius makes room for.

    A closed curve without crossings whose curvature is nowhere above 1/R surrounds a disc of radius R
    (Pestov and Ionin, 1959).
    """
    angles = np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    width = float(np.ptp(points @ np.stack([np.cos(angles), np.sin(angles)]), axis=0).min())
    most = 0.5 * width if wanted.closed else float(np.ptp(points, axis=0).max())
    if wanted.radius > most:
        what = "half the least width of the points" if wanted.closed else "the extent of the points"
        limit, was = told_apart(most, wanted.radius)
        raise ValueError(f"argument smallest_radius must be at most {limit} m here, {what}, but was {was} m")


def _sparse(points: np.ndarray, wanted: Wanted) -> list[str]:
    """Warn of points farther apart than the radius: what lies between them is not known at its scale."""
    apart = float(np.median(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    if apart <= wanted.radius:
        return []
    return [
        f"The points are {1e3 * apart:.3g} mm apart, more than the smallest radius: between them the contour "
        "is a guess."
    ]


def _turned(band: Band, wanted: Wanted) -> tuple[Band, bool, tuple[str, ...]]:
    """The band with the body on its left, whether it was turned round, and what is doubtful about that."""
    chain, doubts = band.chain, ()
    if wanted.closed:
        against = polygon_area(chain) < 0.0
    else:
        bend = np.diff(chain, axis=0)
        turning = bend[:-1, 0] * bend[1:, 1] - bend[:-1, 1] * bend[1:, 0]
        against = band.reordered and float(turning.sum()) < 0.0
        doubts = (
            (
                "The direction of these open points was not given: the body was put on the inside of their "
                "bend; reverse=True puts it on the other side.",
            )
            if band.reordered
            else ()
        )
    turn = against if wanted.closed else against != wanted.reverse
    indices = band.indices[::-1] if turn else band.indices
    if wanted.closed:
        # The first point that is used stays the first.
        indices = np.roll(indices, -int(np.argmin(indices)))
    return band._replace(chain=chain[::-1] if turn else chain, indices=indices), against, doubts


def _started(points: np.ndarray, chain: np.ndarray, wanted: Wanted) -> tuple[np.ndarray, EvenSpline]:
    """Places along the chain, and a smooth curve along it, with nodes as close as the radius asks for."""
    closed = wanted.closed
    line = np.concatenate([chain, chain[:1]]) if closed else _to_the_ends(points, chain)
    length = float(along(line)[-1])
    wish = wanted.knots or _PER_RADIUS * length / wanted.radius
    count = next((n for n in NODES if n >= wish), NODES[-1])
    places = spread_along(line, 8 * count + 1)
    # The curve begins where discs can roll: out of a corner or a thin end it would not find back.
    rolled = rolled_line(places, places, wanted.radius, _ROUGH * wanted.radius, closed=closed)[1]
    nodes = spread_along(rolled, count + 1)[:-1] if closed else spread_along(rolled, count)
    broad = max(_BROAD * wanted.radius, 2.0 * float(np.diff(along(line)).max()))
    smooth = low_passed(nodes, length, min(broad, 0.3 * length), closed=closed)
    return places, EvenSpline(smooth, closed).spread(count)


def _to_the_ends(points: np.ndarray, chain: np.ndarray) -> np.ndarray:
    """An open chain continued straight as far as the points go; its ends are means, which fall short."""
    ends = []
    for end, inner in ((chain[0], chain[1]), (chain[-1], chain[-2])):
        out = (end - inner) / np.linalg.norm(end - inner)
        near = np.linalg.norm(points - end, axis=1) <= 2.0 * np.linalg.norm(end - inner)
        reach = float(np.max((points[near] - end) @ out, initial=0.0))
        ends.append(end + reach * out)
    return np.concatenate([ends[:1], chain, ends[1:]])
