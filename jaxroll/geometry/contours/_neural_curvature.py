r"""A closed contour whose curvature over arclength is a small network: convex or not.

Curvature integrates to the tangent's angle $\theta(s)$, and $(\cos\theta, \sin\theta)$ to the point. For the
point to come back, two numbers $\alpha$ and $\beta$ are added to $\theta$ (see `NeuralCurvature`) and solved
for. All integrals are over a period and spectral: divisions of Fourier coefficients. From the network's
values at uniform arclengths `_laid_out` makes the table (`_table`); the network is of `_network`, and
`_network_descent` fits it to points.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._linalg import Vec2
from ..._results import as_count, as_floats, as_length, check_instance
from ..._types import Given
from ._given_points import check_extent, numbers
from ._network import network_fit, NetworkFit, PeriodicNetwork, with_readout
from ._network_descent import descend, FitProgress, NetworkProblem
from ._table import AbstractTabulated, FEWEST_CELLS, from_frames, Table

_TURN = 2.0 * np.pi
# Cells of the table that a fit works with.
_FIT_CELLS = 256


class NeuralCurvature(AbstractTabulated):
    r"""A closed contour, convex or not, whose curvature over arclength is a small periodic network.

    With $u = s/L$ and the network $N$ of period one turn,
    $$\theta_0(s) = \theta_c + 2\pi u + \int (N(2\pi u) - \bar N)\,du, \qquad
      \theta = \theta_0 + \alpha\cos\theta_0 + \beta\sin\theta_0,$$
    $\kappa = d\theta/ds$, and the point is the integral of $(\cos\theta, \sin\theta)$. It turns once round
    whatever the weights; $\alpha$ and $\beta$, the two numbers that close it, are found by Newton's method
    and differentiated through. It may cross itself: an object's contour is checked for that, a fingertip's
    is not.

    Args:
        network: $N$, without dimension; zero gives a circle.
        length: Circumference $L$ [m], positive.
        angle: $\theta_c$ [rad], the mean of $\theta_0 - 2\pi u$: the tangent's angle at s = 0 for a circle.
        centre: Mean of the contour's points over arclength, shape (2,) [m].
        cells: Cells of the table over arclength that its frame is read from, even. Static.

    Raises:
        ValueError: If a shape is wrong, the length isn't positive, or `cells` is odd.

    Accuracy: the integrals are spectral in the number of cells; for the table's error see `table_error`.

    Example:
        >>> import jax, jaxroll as jxr
        >>> network = jxr.geometry.PeriodicNetwork(key=jax.random.key(0), amplitude=0.0)
        >>> f"{jxr.NeuralCurvature(network, 0.0628).curvature(0.0):.2f} 1/m"  # 2 pi / L
        '100.05 1/m'
    """

    network: PeriodicNetwork
    length: Float[Array, ""]
    angle: Float[Array, ""]
    centre: Float[Array, "2"]
    cells: int = eqx.field(static=True)
    table: Table | None

    def __init__(
        self,
        network: PeriodicNetwork,
        length: Given,
        angle: Given = 0.5 * np.pi,
        centre: Given = (0.0, 0.0),
        *,
        cells: int = 1024,
    ) -> None:
        self.network = check_instance("network", network, PeriodicNetwork, "a PeriodicNetwork")
        self.length = as_length("length", length)
        self.angle = as_floats("angle", angle, ())
        self.centre = as_floats("centre", centre, (2,))
        self.cells = as_count("cells", cells, least=FEWEST_CELLS)
        if self.cells % 2:
            raise ValueError(f"argument cells must be even, but was {self.cells}")
        self.table = None

    @classmethod
    def through(
        cls,
        points: Given,
        *,
        key: Array,
        harmonics: int = 12,
        width: int = 24,
        depth: int = 2,
        steps: int = 100,
        tolerance: float = 1e-8,
        progress: FitProgress = False,
        cells: int = 1024,
    ) -> "NeuralCurvature":
        """The contour nearest to points: the field that `fit` finds, without its figures.

        Args:
            points: Shape (n, 2) [m], n > 8, in order, counter-clockwise; the first not repeated.
            key: Random key of the first weights.
            harmonics: As `width` and `depth`, of `PeriodicNetwork`.
            width: Neurons of each hidden layer.
            depth: Hidden layers.
            steps: Steps of descent at most.
            tolerance: Stop at this root mean square distance [m]: the noise of the points, if known.
            progress: True prints step and loss every 25 steps; a function is called with them.
            cells: As for the class.

        Raises:
            ValueError: If there are too few points, or they run clockwise.
        """
        found = cls.fit(
            points,
            key=key,
            harmonics=harmonics,
            width=width,
            depth=depth,
            steps=steps,
            tolerance=tolerance,
            progress=progress,
            cells=cells,
        )
        return found.field

    @classmethod
    def fit(
        cls,
        points: Given,
        *,
        key: Array,
        harmonics: int = 12,
        width: int = 24,
        depth: int = 2,
        steps: int = 100,
        tolerance: float = 1e-8,
        progress: FitProgress = False,
        cells: int = 1024,
    ) -> NetworkFit:
        """Fit network, length and pose to points, in least squares of their normal distances.

        The network starts at the best last layer for the curvature of a smooth curve through the points.

        Args:
            points: Shape (n, 2) [m], n > 8, in order, counter-clockwise; the first not repeated.
            key: Random key of the first weights.
            harmonics: As `width` and `depth`, of `PeriodicNetwork`.
            width: Neurons of each hidden layer.
            depth: Hidden layers.
            steps: Steps of descent at most.
            tolerance: Stop at this root mean square distance [m]: the noise of the points, if known.
            progress: True prints step and loss every 25 steps; a function is called with them.
            cells: As for the class.

        Raises:
            ValueError: If there are too few points, or they run clockwise.

        Accuracy: 200 exact points of a 20 mm x 14 mm ellipse: 0.02 um rms, curvature within 0.8 1/m of up to
        204 1/m; a bean 39 mm long: 0.4 um. A sharp dent (-360 1/m) takes `harmonics` 16 and `width` 32.
        """
        # The fit works on points about their mean, scaled to size one; results are scaled back to metres.
        data = numbers("points", points, 2)
        if len(data) <= 8:
            raise ValueError(f"argument points must have more than 8 rows, but had {len(data)}")
        check_extent("points", data)
        centre = data.mean(axis=0)
        size = float(np.mean(np.hypot(*(data - centre).T)))
        scaled = (data - centre) / size
        # The network's last layer is fitted to that curve's curvature, then everything to the points.
        slope, pose, places = _start(scaled)
        network = with_readout(PeriodicNetwork(harmonics, width=width, depth=depth, key=key), slope)
        cloud = _Cloud(jnp.asarray(scaled), jnp.asarray(places))
        target = (tolerance / size) ** 2
        found = descend(_PROBLEM, (network, pose), cloud, steps=steps, target=target, progress=progress)
        best = found.rest
        field = cls(found.network, size * best.length, best.angle, centre + size * best.centre, cells=cells)
        gaps = size * np.sqrt(len(data)) * np.asarray(_all_residuals(found.network, best, found.data))
        return network_fit(field, gaps, found)

    @property
    def closed(self) -> bool:
        return True

    @property
    def smoothness(self) -> float:
        return float("inf")

    def closure(self) -> Float[Array, ""]:
        """Distance [m] by which the contour fails to close: rounding, unless Newton's method failed."""
        return _closure(self)

    def tabulate(self, cells: int) -> Table:
        return _laid_out(self.network.values(_uniform(cells)), self._pose()).table

    def _pose(self) -> "_Pose":
        return _Pose(self.length, self.angle, self.centre)


class _Pose(NamedTuple):
    """What a contour has besides its network: circumference, mean angle and mean point, as for the class."""

    length: Array
    angle: Array
    centre: Array


class _Laid(NamedTuple):
    """A contour's table, and by how much it fails to close, in units of its length."""

    table: Table
    gap: Vec2


def _uniform(count: int) -> np.ndarray:
    """Uniform angles 2 pi s / L once round [rad], without the last."""
    return _TURN * np.arange(count) / count


@eqx.filter_jit
def _closure(contour: NeuralCurvature) -> Array:
    """Distance [m] between the contour's beginning and its end: its length times the mean tangent."""
    gap = _laid_out(contour.network.values(_uniform(contour.cells)), contour._pose()).gap
    return contour.length * jnp.sqrt(gap.dot(gap))


def _integral(values: Array) -> Array:
    """The integral over u of samples less their mean, over one period 0 to 1, at the same places.

    Its own mean is zero. Wave k is divided by 2 pi i k. The mean and, for an even count, the highest wave,
    whose integral the samples do not show, are left out.
    """
    count = values.shape[0]
    order = np.arange(count // 2 + 1.0)
    weight = np.where((order > 0) & (2 * order < count), 1.0, 0.0) / np.maximum(order, 1.0)
    return jnp.fft.irfft(jnp.fft.rfft(values) * (weight / (1j * _TURN)), count)


def _laid_out(values: Array, pose: _Pose) -> _Laid:
    """The contour of the network's values at uniform arclengths: its table, and the gap that is left."""
    # d theta_0 / du, then theta_0, for which the mean of theta_0 - 2 pi u is `angle`.
    count = values.shape[0]
    slope = _TURN + values - jnp.mean(values)
    base = pose.angle + _uniform(count) + _integral(values)
    cos, sin = jnp.cos(base), jnp.sin(base)
    alpha, beta = _closing(base, cos, sin)
    theta = base + alpha * cos + beta * sin
    x, y = jnp.cos(theta), jnp.sin(theta)
    # kappa = d theta / ds = (d theta_0 / du) (d theta / d theta_0) / L.
    curvature = slope * (1.0 - alpha * sin + beta * cos) / pose.length
    # dx/du = L cos(theta). `_integral` has no mean, so that the mean point is the centre.
    points = [pose.centre[i] + pose.length * _integral(t) for i, t in enumerate((x, y))]
    table = from_frames(
        _joined(jnp.stack(points, axis=-1)),
        _joined(jnp.stack([x, y], axis=-1)),
        _joined(curvature),
        pose.length,
        closed=True,
    )
    return _Laid(table, Vec2(jnp.mean(x), jnp.mean(y)))


def _joined(leaf: Array) -> Array:
    """Samples over a period with the first one again at the end, as `from_frames` takes them."""
    return jnp.concatenate([leaf, leaf[:1]])


def _closing(base: Array, cos: Array, sin: Array) -> tuple[Array, Array]:
    r"""$\alpha$ and $\beta$ for which the mean of $(\cos\theta, \sin\theta)$ is zero, by Newton's method.

    The system is regular: at the start its determinant is $\overline{c^2}\,\overline{s^2} - \overline{cs}^2$,
    which only a straight line makes zero.
    """

    def newton(base: Array, cos: Array, sin: Array, found: tuple[Array, Array]) -> tuple[Array, Array]:
        # The Jacobian ((a, b), (c, d)) of the mean of (cos theta, sin theta), with d theta / d alpha = cos
        # and d theta / d beta = sin. Steps are clipped: far from the root Newton's may be long.
        theta = base + found[0] * cos + found[1] * sin
        x, y = jnp.cos(theta), jnp.sin(theta)
        gap = jnp.mean(x), jnp.mean(y)
        a, b, c, d = -jnp.mean(y * cos), -jnp.mean(y * sin), jnp.mean(x * cos), jnp.mean(x * sin)
        scale = 1.0 / (a * d - b * c)
        steps = (d * gap[0] - b * gap[1]) * scale, (a * gap[1] - c * gap[0]) * scale
        alpha, beta = (f - jnp.clip(step, -0.5, 0.5) for f, step in zip(found, steps, strict=True))
        return alpha, beta

    fixed = jax.lax.stop_gradient((base, cos, sin))
    zero = jnp.zeros_like(fixed[0][0])
    root = jax.lax.fori_loop(0, 12, lambda _, found: newton(*fixed, found), (zero, zero))
    root = jax.lax.stop_gradient(root)
    # The search is not differentiated. Two more steps are: a Newton step from the root, held constant, has
    # the root's first derivatives, and one from there has the second ones too.
    return newton(base, cos, sin, newton(base, cos, sin, root))


class _Cloud(eqx.Module):
    """Data of a fit: points scaled to size one, and the arclengths of their feet as fractions of the length.

    A point's foot is the contour's point nearest to it.
    """

    points: Float[Array, "n 2"]
    places: Float[Array, " n"]


def _start(points: np.ndarray) -> tuple[np.ndarray, _Pose, np.ndarray]:
    """A curve near the points: kappa L - 2 pi at uniform arclengths, its pose, and the points' places.

    The curve is a complex Fourier series x + i y over the chord length, in least squares. A penalty of 1e-9
    k^4 on the square of wave k, for every point, holds down wiggles between the points.
    """
    chords = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    phase = _TURN * np.concatenate([[0.0], np.cumsum(chords)[:-1]]) / chords.sum()
    order = np.arange(-24, 25)
    matrix, z = np.exp(1j * np.outer(phase, order)), points[:, 0] + 1j * points[:, 1]
    damping = 1e-9 * len(points) * np.diag(order**4.0)
    waves = np.linalg.solve(matrix.conj().T @ matrix + damping, matrix.conj().T @ z)
    # Velocity and acceleration on a fine grid; arclength by the trapezoidal rule.
    grid = _uniform(2048)
    basis = np.exp(1j * np.outer(grid, order))
    rate, bend = basis @ (1j * order * waves), basis @ (-(order**2) * waves)
    speed = np.abs(rate)
    # The area enclosed is half the integral of Im(conj(z) z').
    if np.sum(np.imag(np.conj(basis @ waves) * rate)) <= 0:
        raise ValueError("argument points must run counter-clockwise, but run clockwise")
    arcs = np.concatenate([[0.0], np.cumsum(0.5 * (speed + np.roll(speed, -1)))]) * (_TURN / 2048)
    length = arcs[-1]
    # From here on at uniform arclengths: at the parameters `at`. kappa = Im(conj(z') z'') / |z'|^3.
    at = np.interp(_uniform(_FIT_CELLS) / _TURN * length, arcs, np.append(grid, _TURN))
    turning = np.imag(np.conj(rate) * bend) / speed**3 * length
    # theta'(u) - 2 pi = N - mean(N), as if alpha and beta were zero.
    slope = np.interp(at, grid, turning, period=_TURN) - _TURN
    theta = np.interp(at, grid, np.unwrap(np.angle(rate)))
    middle = np.interp(at, grid, (basis @ waves).real, period=_TURN).mean()
    height = np.interp(at, grid, (basis @ waves).imag, period=_TURN).mean()
    angle = np.mean(theta - _uniform(_FIT_CELLS))
    pose = _Pose(jnp.asarray(length), jnp.asarray(angle), jnp.stack([middle, height]))
    # Where the points themselves are: from their chord length to arclength.
    return slope, pose, np.interp(phase, np.append(grid, _TURN), arcs) / length


def _angles(cloud: _Cloud) -> np.ndarray:
    """Where the network is needed: at uniform arclengths, wherever the points are."""
    return _uniform(_FIT_CELLS)


def _residuals(values: Array, pose: _Pose, cloud: _Cloud) -> Array:
    """Normal distances of the points over the root of their number.

    At a foot the distance does not depend on the place to first order, so the places are constants here.
    """
    frame = _laid_out(values, pose).table.frame(cloud.places * pose.length)
    gap = Vec2(cloud.points[:, 0], cloud.points[:, 1]) - frame.point
    return gap.dot(frame.tangent.right()) / np.sqrt(cloud.points.shape[0])


@eqx.filter_jit
def _all_residuals(network: PeriodicNetwork, pose: _Pose, cloud: _Cloud) -> Array:
    """`_residuals` of a network instead of its values."""
    return _residuals(network.values(_uniform(_FIT_CELLS)), pose, cloud)


@eqx.filter_jit
def _refreshed(network: PeriodicNetwork, pose: _Pose, cloud: _Cloud) -> _Cloud:
    r"""The cloud with the places of its feet on this contour: four steps of Newton's method.

    With $r = p - c(s)$, the foot has $r \cdot b = 0$, and $d(r \cdot b)/ds = -(1 + \kappa\, r \cdot n)$ for
    the outward normal $n$. The slope is kept above 0.3 and the step below 2 % of the length.
    """
    table = _laid_out(network.values(_uniform(_FIT_CELLS)), pose).table
    points = Vec2(cloud.points[:, 0], cloud.points[:, 1])

    def step(_: int, places: Array) -> Array:
        frame = table.frame(places * pose.length)
        gap = points - frame.point
        bend = jnp.maximum(1.0 + frame.curvature * gap.dot(frame.tangent.right()), 0.3)
        return places + jnp.clip(gap.dot(frame.tangent) / (bend * pose.length), -0.02, 0.02)

    return eqx.tree_at(lambda c: c.places, cloud, jax.lax.fori_loop(0, 4, step, cloud.places))


_PROBLEM = NetworkProblem(_angles, _residuals, _refreshed)
