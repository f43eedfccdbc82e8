r"""A closed convex contour whose support function is a small network, $h = r\,(1 + N(\varphi)) + c \cdot n$.

Everything but the network is `_support`: the network is sampled at uniform angles and becomes a Fourier
series, so the table, the margin of (41) and the check against folding are those of any support function. The
network is of `_network`; `NeuralSupport.fit` minimises normal distances by `_network_descent`. The residuals
below are module-level functions, so that fits of the same sizes share their compiled programs.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._linalg import sincos
from ..._results import as_count, as_floats, as_length, check_instance
from ..._types import Given
from ._given_points import check_extent, numbers
from ._network import network_fit, NetworkFit, PeriodicNetwork, with_readout
from ._network_descent import descend, FitProgress, NetworkProblem
from ._support import AbstractSupport, check_convex, fit_series, Series
from ._table import FEWEST_CELLS, Table


class NeuralSupport(AbstractSupport):
    r"""A closed convex contour whose support function is a small periodic network.

    $$h(\varphi) = r\,(1 + N(\varphi)) + c \cdot n(\varphi),$$
    closed and smooth whatever the weights. As for `SupportFunction`, the point is $h\,n + h'\,n'$, the radius
    of curvature $\rho = h + h''$, and condition (41) about the body's origin is $h'' > 0$ (`margin`). Weights
    may fold the contour ($\rho \le 0$): concrete ones that do are refused, and fits keep away from it.

    Args:
        network: $N$, without dimension.
        radius: Scale $r$ [m], positive.
        centre: $c$, shape (2,) [m].
        cells: Cells of the table over arclength that its frame is read from. Static.

    Raises:
        ValueError: If the contour folds, or a shape is wrong.

    Accuracy: the table's, see `table_error`; the equations of motion never see the network.

    Example:
        >>> import jax, jaxroll as jxr
        >>> network = jxr.geometry.PeriodicNetwork(key=jax.random.key(0), amplitude=0.0)
        >>> f"{jxr.NeuralSupport(network, 0.01).curvature(0.0):.2f} 1/m"  # N = 0 is a circle
        '100.00 1/m'
    """

    network: PeriodicNetwork
    radius: Float[Array, ""]
    centre: Float[Array, "2"]
    cells: int = eqx.field(static=True)
    table: Table | None

    def __init__(
        self, network: PeriodicNetwork, radius: Given, centre: Given = (0.0, 0.0), *, cells: int = 1024
    ) -> None:
        self.network = check_instance("network", network, PeriodicNetwork, "a PeriodicNetwork")
        self.radius = as_length("radius", radius)
        self.centre = as_floats("centre", centre, (2,))
        self.cells = as_count("cells", cells, least=FEWEST_CELLS)
        self.table = None
        check_convex("network", self)

    @classmethod
    def through(
        cls,
        points: Given,
        *,
        key: Array,
        harmonics: int = 4,
        width: int = 16,
        depth: int = 2,
        steps: int = 100,
        tolerance: float = 1e-8,
        smallest_radius: float | None = None,
        progress: FitProgress = False,
        cells: int = 1024,
    ) -> "NeuralSupport":
        """The contour nearest to points: the field that `fit` finds, without its figures.

        Args:
            points: Shape (n, 2) [m], n > 8, round the body in any order.
            key: Random key of the first weights.
            harmonics: As `width` and `depth`, of `PeriodicNetwork`.
            width: Neurons of each hidden layer.
            depth: Hidden layers.
            steps: Steps of descent at most.
            tolerance: Stop at this root mean square distance [m]: the noise of the points, if known.
            smallest_radius: In metres; None for a hundredth of the points' mean distance from their mean.
            progress: True prints step and loss every 25 steps; a function is called with them.
            cells: As for the class.

        Raises:
            ValueError: If there are too few points, or the fitted contour folds after all.
        """
        found = cls.fit(
            points,
            key=key,
            harmonics=harmonics,
            width=width,
            depth=depth,
            steps=steps,
            tolerance=tolerance,
            smallest_radius=smallest_radius,
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
        harmonics: int = 4,
        width: int = 16,
        depth: int = 2,
        steps: int = 100,
        tolerance: float = 1e-8,
        smallest_radius: float | None = None,
        progress: FitProgress = False,
        cells: int = 1024,
    ) -> NetworkFit:
        r"""Fit the network to convex points, in least squares of their normal distances.

        The network starts at the best last layer for a Fourier series through the points; then all weights
        move. Radii of curvature below `smallest_radius` cost as much as distances do.

        Args:
            points: Shape (n, 2) [m], n > 8, round the body in any order.
            key: Random key of the first weights.
            harmonics: As `width` and `depth`, of `PeriodicNetwork`.
            width: Neurons of each hidden layer.
            depth: Hidden layers.
            steps: Steps of descent at most.
            tolerance: Stop at this root mean square distance [m]: the noise of the points, if known.
            smallest_radius: In metres; None for a hundredth of the points' mean distance from their mean.
            progress: True prints step and loss every 25 steps; a function is called with them.
            cells: As for the class.

        Raises:
            ValueError: If there are too few points, or the fitted contour folds after all.

        Accuracy: 200 exact points of a 20 mm x 14 mm ellipse, by six keys: 0.02 to 0.13 um rms, curvature
        within 0.4 to 1.5 1/m of up to 204 1/m.
        `SupportFunction.through` does better on so smooth a shape, in a hundredth of the time.
        """
        # The fit works on points about their mean, scaled to size one; results are scaled back to metres.
        data = numbers("points", points, 2)
        if len(data) <= 8:
            raise ValueError(f"argument points must have more than 8 rows, but had {len(data)}")
        check_extent("points", data)
        centre = data.mean(axis=0)
        size = float(np.mean(np.hypot(*(data - centre).T)))
        scaled = (data - centre) / size
        waves, angles = _start(scaled)
        network = PeriodicNetwork(harmonics, decay=1.0, width=width, depth=depth, key=key)
        # In units of size one, h = 1 + N about the origin. Derivatives count a little, for the curvature.
        network = with_readout(network, waves - 1.0, bends=0.1)
        floor = 0.01 if smallest_radius is None else smallest_radius / size
        cloud = _Cloud(jnp.asarray(scaled), jnp.asarray(angles), jnp.asarray(floor))
        # Radius and centre move with the weights. The target is that of a mean square.
        rest = (jnp.ones(()), jnp.zeros(2))
        target = (tolerance / size) ** 2
        found = descend(_PROBLEM, (network, rest), cloud, steps=steps, target=target, progress=progress)
        radius, offset = found.rest
        field = cls(found.network, size * radius, centre + size * offset, cells=cells)
        return network_fit(field, size * _distances(found.network, found.rest, found.data), found)

    def free_numbers(self) -> list[Any]:
        leaves = jax.tree.leaves(self.network)
        return [self.radius, self.centre, *(leaf for leaf in leaves if eqx.is_inexact_array(leaf))]

    def series(self, terms: int) -> Series:
        return _series(self.network, self.radius, self.centre, terms)


def _series(network: PeriodicNetwork, radius: Array, centre: Array, terms: int) -> Series:
    """The Fourier series of $h$ from samples; what it leaves of an analytic $h$ falls exponentially."""
    # Twice as many samples as `terms` harmonics need, against aliasing. With X the discrete transform,
    # a_k = 2 Re X_k / count and b_k = -2 Im X_k / count. The centre adds c . n: the first harmonic.
    count = 4 * terms
    waves = jnp.fft.rfft(network.values(_uniform(count)))[: terms + 1]
    waves = waves * jnp.asarray(2.0 * radius / count, waves.dtype)
    first = jnp.zeros(terms).at[0].set(1.0)
    cosines = waves[1:].real + first * centre[0]
    return Series(radius + 0.5 * waves[0].real, cosines, first * centre[1] - waves[1:].imag)


def _uniform(count: int) -> np.ndarray:
    """Uniform angles once round [rad], without the last."""
    return 2.0 * np.pi * np.arange(count) / count


class _Cloud(eqx.Module):
    """Data of a fit: points scaled to size one, normal angles of their feet, smallest radius of curvature.

    A point's foot is the contour's point nearest to it. The radius is in the points' scale.
    """

    points: Float[Array, "n 2"]
    angles: Float[Array, " n"]
    floor: Float[Array, ""]


def _start(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """256 samples of a Fourier series near the points that does not fold, and the points' normal angles.

    The number of terms is halved until rho = r + sum (1 - k^2) (a_k cos + b_k sin) is positive at all
    samples, or one term is left.
    """
    terms = min(12, (len(points) - 1) // 4)
    while True:
        series, angles = fit_series(points, terms)
        phases = np.outer(_uniform(256), np.arange(1, terms + 1))
        waves = np.concatenate([np.cos(phases), np.sin(phases)], axis=1)
        # Factors by which waves of h become those of rho = h + h'', first for cosines, then for sines.
        bends = np.tile(1.0 - np.arange(1, terms + 1) ** 2, 2)
        if terms == 1 or np.min(series[0] + waves @ (bends * series[1:])) > 0:
            return series[0] + waves @ series[1:], angles
        terms = terms // 2


@eqx.filter_jit
def _refreshed(network: PeriodicNetwork, rest: tuple[Array, Array], cloud: _Cloud) -> _Cloud:
    """The cloud with the normal angles of its feet on this contour: three steps of Newton's method.

    As `_support._feet`, but with bounds that keep every step finite and short while the contour changes.
    """
    series, angles = _series(network, *rest, 64), cloud.angles
    for _ in range(3):
        # p . n and p . n' at the angles.
        sin, cos = sincos(angles)
        out = cloud.points[:, 0] * cos + cloud.points[:, 1] * sin
        along = cloud.points[:, 1] * cos - cloud.points[:, 0] * sin
        _, first, second = series.heights(angles)
        angles = angles + jnp.clip((along - first) / jnp.maximum(out + second, 0.05), -0.3, 0.3)
    return eqx.tree_at(lambda c: c.angles, cloud, angles)


def _angles(cloud: _Cloud) -> Array:
    """Where the network is needed: at the feet for distances, and at 128 uniform angles for curvature."""
    return jnp.concatenate([cloud.angles, _uniform(128)])


def _residuals(values: Array, rest: tuple[Array, Array], cloud: _Cloud) -> Array:
    """Normal distances of the points, and by how much the radius of curvature falls short of its floor.

    At a foot the distance does not depend on the angle to first order, so the angles are constants here. Sums
    of squares are means: over the points, and over 64 places.
    """
    (radius, centre), count = rest, cloud.angles.shape[0]
    sin, cos = sincos(cloud.angles)
    reach = (cloud.points[:, 0] - centre[0]) * cos + (cloud.points[:, 1] - centre[1]) * sin
    distance = reach - radius * (1.0 + values[:count])
    # rho = h + h'' multiplies wave k by 1 - k^2; c . n, of k = 1, drops out.
    order, waves = np.fft.rfftfreq(128, 1.0 / 128), jnp.fft.rfft(values[count:])
    bends = radius * (1.0 + jnp.fft.irfft(waves * jnp.asarray(1.0 - order**2, waves.dtype), 128))
    lack = jnp.maximum(cloud.floor - bends[::2], 0.0)
    return jnp.concatenate([distance / np.sqrt(count), lack / np.sqrt(64.0)])


@eqx.filter_jit
def _distances(network: PeriodicNetwork, rest: tuple[Array, Array], cloud: _Cloud) -> Array:
    """Signed normal distances of the points, in their scale of size one."""
    count = cloud.angles.shape[0]
    return np.sqrt(count) * _residuals(network.values(_angles(cloud)), rest, cloud)[:count]


_PROBLEM = NetworkProblem(_angles, _residuals, _refreshed)
