r"""A small network of one angle, periodic by construction, and what its fits have in common.

$N(\varphi)$ is a multilayer perceptron of the features $k^{-p} \cos k\varphi$, $k^{-p} \sin k\varphi$, so
that it is periodic whatever its weights. `_neural_support` takes it for a support function,
`_neural_curvature` for a curvature. Their fits start at the best linear last layer (`with_readout`), go on in
`_network_descent`, and return a `NetworkFit`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._results import as_floats, is_array_like, shown, traced
from ..._types import Scalar

# Most harmonics, units of a layer, and layers: far more than a contour can use.
_MOST = 4096
# Infinitely often differentiable, or the contour would not be.
_ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "tanh": jnp.tanh,
    "softplus": jax.nn.softplus,
    "sine": jnp.sin,
}


def check_key(name: str, key: Any) -> None:
    """Raise unless an argument is one random key of JAX."""
    old = is_array_like(key) and key.dtype == np.uint32 and key.shape[-1:] in ((2,), (4,)) and key.ndim == 1
    new = isinstance(key, jax.Array) and jnp.issubdtype(key.dtype, jax.dtypes.prng_key) and key.ndim == 0
    if not (old or new):
        raise ValueError(
            f"argument {name} must be a random key, as jax.random.key gives, but was {shown(key)}"
        )


class PeriodicNetwork(eqx.Module):
    r"""A small multilayer perceptron of an angle, of period $2\pi$ and infinitely often differentiable.

    Its features are $k^{-p} \cos k\varphi$ and $k^{-p} \sin k\varphi$, k = 1..`harmonics`, p = `decay`.

    Args:
        harmonics: Number of harmonics among the features. Default: 4.
        decay: How fast their weight falls; the larger, the smoother the network. It is static, as are
            `harmonics` and `activation`.
        width: Neurons of each hidden layer.
        depth: Hidden layers.
        activation: "tanh", "softplus" or "sine".
        key: Random key of the first weights.
        amplitude: Factor on the last layer's first weights; 0 makes the network zero.

    Raises:
        ValueError: If a count is below one or above 4096, or the activation is not one of the three.

    Example:
        >>> import jax, jaxroll as jxr
        >>> network = jxr.geometry.PeriodicNetwork(key=jax.random.key(0))
        >>> bool(abs(network(0.5) - network(0.5 + 2 * jax.numpy.pi)) < 1e-6)
        True
    """

    layers: tuple[eqx.nn.Linear, ...]
    harmonics: int = eqx.field(static=True)
    decay: float = eqx.field(static=True)
    activation: str = eqx.field(static=True)

    def __init__(
        self,
        harmonics: int = 4,
        *,
        decay: float = 0.0,
        width: int = 16,
        depth: int = 2,
        activation: str = "tanh",
        key: Array,
        amplitude: float = 1.0,
    ) -> None:
        for name, count in (("harmonics", harmonics), ("width", width), ("depth", depth)):
            if not isinstance(count, int | np.integer) or isinstance(count, bool) or not 1 <= count <= _MOST:
                raise ValueError(f"argument {name} must be from 1 to {_MOST}, but was {shown(count)}")
        if not isinstance(activation, str) or activation not in _ACTIVATIONS:
            raise ValueError(
                f"argument activation must be one of {[*_ACTIVATIONS]}, but was {shown(activation)}"
            )
        as_floats("decay", decay, ())
        if traced(decay):
            raise ValueError(f"argument decay must be known before tracing, but was {shown(decay)}")
        size = as_floats("amplitude", amplitude, ())
        check_key("key", key)
        sizes = [2 * harmonics, *[width] * depth, 1]
        keys = jax.random.split(key, depth + 1)
        layers = [eqx.nn.Linear(a, b, key=k) for a, b, k in zip(sizes[:-1], sizes[1:], keys, strict=True)]
        self.layers = (*layers[:-1], jax.tree.map(lambda leaf: size * leaf, layers[-1]))
        self.harmonics, self.decay, self.activation = harmonics, float(decay), activation

    def __call__(self, angle: Scalar) -> Scalar:
        """The network's value at one angle [rad]."""
        return self.layers[-1](self.hidden(angle))[0]

    def hidden(self, angle: Scalar) -> Array:
        """The last hidden layer at one angle: shape (width,)."""
        order = np.arange(1.0, self.harmonics + 1.0)
        phases = angle * order
        value = jnp.concatenate([jnp.cos(phases), jnp.sin(phases)]) * np.tile(order**-self.decay, 2)
        for layer in self.layers[:-1]:
            value = _ACTIVATIONS[self.activation](layer(value))
        return value

    def values(self, angle: Array | np.ndarray) -> Array:
        """The values at angles of shape (n,)."""
        return jax.vmap(self)(jnp.asarray(angle))


@eqx.filter_jit
def _hidden(network: PeriodicNetwork, angles: Array) -> Array:
    return jax.vmap(network.hidden)(angles)


def with_readout(network: PeriodicNetwork, values: np.ndarray, *, bends: float = 0.0) -> PeriodicNetwork:
    r"""The network whose last layer fits it best to `values` at uniform angles, the others as they are.

    Args:
        network: The network.
        values: Shape (n,), at the angles $2\pi i/n$.
        bends: Weight of the second derivatives' errors.
    """
    count = len(values)
    # Linear least squares for the last layer: its inputs and a column of ones for its bias. Derivatives of
    # all columns, and of `values`, are spectral; they are added as further rows.
    hidden = np.asarray(_hidden(network, jnp.asarray(2.0 * np.pi * np.arange(count) / count)), np.float64)
    matrix = np.column_stack([hidden, np.ones(count), values])
    order = np.fft.rfftfreq(count, 1.0 / count)[:, None]
    bent = np.fft.irfft(-(order**2) * np.fft.rfft(matrix, axis=0), count, axis=0)
    matrix = np.concatenate([matrix, bends * bent])
    # Nearly dependent hidden units give small singular values; these are cut, or the weights would be huge.
    weights = np.linalg.lstsq(matrix[:, :-1], matrix[:, -1], rcond=1e-7)[0]
    last = network.layers[-1]
    new = (jnp.asarray(weights[None, :-1], last.weight.dtype), jnp.asarray(weights[-1:], last.weight.dtype))
    return eqx.tree_at(lambda n: (n.layers[-1].weight, n.layers[-1].bias), network, new)


@dataclass(frozen=True)
class NetworkFit:
    """A field fitted to points, and how well.

    Attributes:
        field: The contour.
        rms: Root mean square of the points' normal distances [m].
        largest: Largest normal distance [m].
        steps: Steps of descent taken.
        loss_history: The loss before every step and at the end.
    """

    field: Any
    rms: float
    largest: float
    steps: int
    loss_history: Float[np.ndarray, " steps"]

    def __str__(self) -> str:
        name = type(self.field).__name__
        return f"{name}: {1e6 * self.rms:.3g} um rms, {1e6 * self.largest:.3g} um at most, {self.steps} steps"


def network_fit(field: Any, distances: Array, found: Any) -> NetworkFit:
    """The record of a fit, from the points' distances [m] and the descent that led to it."""
    gaps = np.asarray(distances)
    rms, largest = float(np.sqrt(np.mean(gaps**2))), float(np.max(np.abs(gaps)))
    return NetworkFit(field, rms, largest, found.steps, found.history)
