"""Contours for the judge of the stress test, in NumPy alone: points, tangents, curvatures over arclength.

Vectors of the plane are complex numbers. Lanes lie along the first axis, times along the second. Nothing
here imports the engine, and where the engine reads tables this evaluates the definitions: elliptic
integrals, Fourier series in closed form, networks by FFT. Contours that have no definition apart from the
engine's fit (splines, networks of curvature) come as samples at uniform arclengths.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ellipe, ellipeinc

TURN = 2.0 * np.pi
# Samples of a contour that the judge interpolates, and points of each interpolation.
SAMPLES, _STENCIL = 1024, 8
_HARMONICS = 64

Contour = dict[str, Any]


class Place(NamedTuple):
    """Where a contour is at given arclengths: point [m], unit tangent, curvature [1/m]."""

    point: np.ndarray
    tangent: np.ndarray
    curvature: np.ndarray


def along(contour: Contour, s: np.ndarray) -> Place:
    """The contour of every lane at arclengths `s` [m] of shape (lanes, times)."""
    angle, offset = contour["angle"][:, None], contour["offset"]
    own = _KINDS[contour["kind"]](contour, s - contour["origin"][:, None])
    turn, shift = np.exp(1j * angle), (offset[:, 0] + 1j * offset[:, 1])[:, None]
    return Place(shift + turn * own.point, turn * own.tangent, own.curvature)


def ends(contour: Contour) -> tuple[np.ndarray, np.ndarray] | None:
    """First and last arclength of an open contour [m]; None where there is none."""
    if "ends" not in contour:
        return None
    origin = contour["origin"]
    return contour["ends"][:, 0] + origin, contour["ends"][:, 1] + origin


def length(contour: Contour) -> np.ndarray:
    """Circumference of a closed contour [m], shape (lanes,)."""
    kind = contour["kind"]
    if kind == "ellipse":
        long, short = np.maximum(contour["a"], contour["b"]), np.minimum(contour["a"], contour["b"])
        return 4.0 * long * ellipe(1.0 - (short / long) ** 2)
    if kind in ("circle", "support"):
        return TURN * contour["radius"]
    if kind == "neural_support":
        return TURN * _series_of_network(contour)[0]
    return contour["length"]


def _line(contour: Contour, s: np.ndarray) -> Place:
    return Place(1j * s, np.full(s.shape, 1j), np.zeros(s.shape))


def _circle(contour: Contour, s: np.ndarray) -> Place:
    radius = contour["radius"][:, None]
    out = np.exp(1j * s / radius)
    return Place(radius * out, 1j * out, np.broadcast_to(1.0 / radius, s.shape))


def _catenary(contour: Contour, s: np.ndarray) -> Place:
    a = contour["a"][:, None]
    root = np.hypot(a, s)
    return Place(a - root + 1j * a * np.arcsinh(s / a), (1j * a - s) / root, a / root**2)


def _bowl(contour: Contour, s: np.ndarray) -> Place:
    """A catenary seen from its other side: hollow, and most so at its vertex."""
    own = _catenary(contour, s)
    return Place(-np.conj(own.point), -np.conj(own.tangent), -own.curvature)


def _ellipse(contour: Contour, s: np.ndarray) -> Place:
    a, b = (np.broadcast_to(contour[name][:, None], s.shape) for name in ("a", "b"))
    around = length(contour)[:, None]
    turns = np.floor(s / around)

    def arc(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Arclength from the x axis, an elliptic integral of the second kind, and its rate."""
        return b * ellipeinc(u, 1.0 - (a / b) ** 2), np.hypot(a * np.sin(u), b * np.cos(u))

    u = _inverse(arc, s - turns * around, around)
    way = -a * np.sin(u) + 1j * b * np.cos(u)
    speed = np.abs(way)
    return Place(a * np.cos(u) + 1j * b * np.sin(u), way / speed, a * b / speed**3)


def _support(contour: Contour, s: np.ndarray) -> Place:
    return _by_series(contour["radius"], contour["cosines"], contour["sines"], s)


def _neural_support(contour: Contour, s: np.ndarray) -> Place:
    return _by_series(*_series_of_network(contour), s)


def _by_series(radius: np.ndarray, cosines: np.ndarray, sines: np.ndarray, s: np.ndarray) -> Place:
    """Support function as a series; the arclength of a normal angle is a series too."""
    order = np.arange(1, cosines.shape[1] + 1)
    # h as the real part of a complex polynomial in exp(i phi).
    waves = cosines - 1j * sines
    start = np.sum((1.0 - order**2) * (waves / (1j * order)).real, axis=1)[:, None]

    def series(u: np.ndarray, terms: np.ndarray) -> np.ndarray:
        step, total = np.exp(1j * u), np.zeros(u.shape, complex)
        for k in reversed(range(terms.shape[1])):
            total = (total + terms[:, k : k + 1]) * step
        return total

    def arc(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        bent = (1.0 - order**2) * waves
        gone = radius[:, None] * u + series(u, bent / (1j * order)).real - start
        return gone, radius[:, None] + series(u, bent).real

    around = TURN * radius[:, None]
    turns = np.floor(s / around)
    u = _inverse(arc, s - turns * around, around)
    out = np.exp(1j * u)
    height, slope = radius[:, None] + series(u, waves).real, series(u, 1j * order * waves).real
    return Place((height + 1j * slope) * out, 1j * out, 1.0 / arc(u)[1])


def _series_of_network(contour: Contour) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radius, cosines and sines of a support function that is a network, by FFT of its values."""
    count = 8 * _HARMONICS
    angle = TURN * np.arange(count) / count
    waves = np.fft.rfft(network(contour, angle), axis=1)[:, : _HARMONICS + 1]
    waves *= 2.0 * contour["radius"][:, None] / count
    cosines, sines = waves[:, 1:].real.copy(), -waves[:, 1:].imag
    cosines[:, 0] += contour["centre"][:, 0]
    sines[:, 0] += contour["centre"][:, 1]
    return contour["radius"] + 0.5 * waves[:, 0].real, cosines, sines


def network(contour: Contour, angle: np.ndarray) -> np.ndarray:
    """Values of every lane's periodic network at angles of shape (n,): shape (lanes, n)."""
    weights, biases = contour["weights"], contour["biases"]
    order = np.arange(1, weights[0].shape[2] // 2 + 1)
    phases = angle[:, None] * order
    value = np.concatenate([np.cos(phases), np.sin(phases)], axis=1) / np.tile(order, 2)
    value = np.broadcast_to(value, (len(weights[0]), *value.shape))
    for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        value = value @ np.swapaxes(weight, 1, 2) + bias[:, None, :]
        value = np.tanh(value) if i < len(weights) - 1 else value
    return value[..., 0]


def _inverse(
    arc: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], s: np.ndarray, around: np.ndarray
) -> np.ndarray:
    """The angle of [0, 2 pi] at an arclength: Newton's method, kept in a bracket."""
    low, high = np.full(s.shape, 0.0), np.full(s.shape, TURN)
    u = TURN * s / around
    for _ in range(80):
        gone, rate = arc(u)
        over = gone > s
        low, high = np.where(over, low, u), np.where(over, u, high)
        new = u - (gone - s) / rate
        new = np.where((new > low) & (new < high), new, 0.5 * (low + high))
        moved, u = np.nanmax(np.abs(new - u), initial=0.0), new
        if moved < 4e-16 * TURN:
            break
    return u


def _sampled(contour: Contour, s: np.ndarray) -> Place:
    """Polynomials through the nearest samples of a closed contour."""
    samples, around = contour["samples"], contour["length"][:, None]
    count = samples.shape[1]
    step = around / count
    with np.errstate(invalid="ignore"):
        place = np.where(np.isfinite(s), s, 0.0) / step
    cell = np.floor(place).astype(int)
    x = place - cell
    nodes = np.arange(_STENCIL) - (_STENCIL // 2 - 1)
    lanes = np.arange(len(samples))[:, None, None]
    values = samples[lanes, (cell[..., None] + nodes) % count]
    # Powers of x through the nodes, from the values there.
    powers = np.linalg.inv(np.vander(nodes.astype(float), increasing=True))
    terms = values @ powers.T
    point, way, bend = (_polynomial(terms, x, k) for k in range(3))
    way, bend = way / step, bend / step**2
    point = np.where(np.isfinite(s), point, np.nan)
    speed = np.abs(way)
    return Place(point, way / speed, (np.conj(way) * bend).imag / speed**3)


def _polynomial(terms: np.ndarray, x: np.ndarray, derivative: int) -> np.ndarray:
    """A polynomial by rising powers, or a derivative of it."""
    for _ in range(derivative):
        terms = terms[..., 1:] * np.arange(1, terms.shape[-1])
    total = np.zeros(x.shape, complex)
    for k in reversed(range(terms.shape[-1])):
        total = total * x + terms[..., k]
    return total


def speed_error(contour: Contour) -> np.ndarray:
    """Largest relative deviation of a sampled contour's speed from one, per lane."""
    samples = contour["samples"]
    count = samples.shape[1]
    waves = np.fft.fft(samples, axis=1)
    order = np.fft.fftfreq(count, 1.0 / count)
    rate = np.fft.ifft(1j * order * waves * (np.abs(order) < count // 4), axis=1)
    return np.max(np.abs(np.abs(rate) * TURN / contour["length"][:, None] - 1.0), axis=1)


_KINDS = {
    "line": _line,
    "circle": _circle,
    "catenary": _catenary,
    "bowl": _bowl,
    "ellipse": _ellipse,
    "support": _support,
    "neural_support": _neural_support,
    "spline": _sampled,
    "neural_curvature": _sampled,
}
