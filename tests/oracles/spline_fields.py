"""Fields of quintic B-splines by SciPy: values, derivatives, and all of the surface where a field is zero."""

from itertools import combinations_with_replacement

import numpy as np
from scipy.interpolate import BSpline, NdBSpline

DEGREE = 5
BLOCK = 20_000


class SplineField:
    """The field of coefficients on equal cells from a corner on; it is zero on the surface."""

    def __init__(self, coefficients, origin, step):
        self.coefficients = np.array(coefficients, float)
        self.origin, self.step = np.array(origin, float), float(step)
        self.knots = [np.arange(n + DEGREE + 1.0) - DEGREE for n in self.coefficients.shape]
        self.spline = NdBSpline(tuple(self.knots), self.coefficients, k=DEGREE)

    def derivative(self, points, orders=(0, 0, 0)):
        """A partial derivative at points [m], shape (n,)."""
        places = (np.asarray(points) - self.origin) / self.step
        parts = [self.spline(places[i : i + BLOCK], nu=orders) for i in range(0, len(places), BLOCK)]
        return np.concatenate(parts) / self.step ** sum(orders)

    def gradient(self, points):
        return np.stack([self.derivative(points, tuple(row)) for row in np.eye(3, dtype=int)], axis=-1)

    def hessian(self, points):
        found = np.empty((len(points), 3, 3))
        for i, j in combinations_with_replacement(range(3), 2):
            orders = np.bincount([i, j], minlength=3)
            found[:, i, j] = found[:, j, i] = self.derivative(points, tuple(orders))
        return found

    def feet(self, points, rounds=4):
        """Points of the surface, by Newton's steps along the gradient, which end near the closest ones."""
        found = np.array(points, float)
        for _ in range(rounds):
            slope = self.gradient(found)
            found -= (self.derivative(found) / np.sum(slope**2, axis=1))[:, None] * slope
        return found

    def lattice(self, per_cell):
        """Nodes of a lattice over all cells, shape (a, b, c, 3) [m], and the field there."""
        values, axes = self.coefficients, []
        for k, knots in enumerate(self.knots):
            cells = values.shape[k] - DEGREE
            at = np.linspace(0.0, cells * (1.0 - 1e-12), cells * per_cell + 1)
            matrix = BSpline.design_matrix(at, knots, DEGREE)
            flat = np.moveaxis(values, k, 0).reshape(values.shape[k], -1)
            rest = [n for i, n in enumerate(values.shape) if i != k]
            values = np.moveaxis((matrix @ flat).reshape(len(at), *rest), 0, k)
            axes.append(self.origin[k] + self.step * at)
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1), values

    def sampled(self, per_cell=3):
        """Points all over the surface: of all edges of a lattice along which the field changes its sign."""
        nodes, values = self.lattice(per_cell)
        found = []
        for k in range(3):
            low, high = (np.moveaxis(values, k, 0)[part] for part in (slice(None, -1), slice(1, None)))
            across = (low < 0.0) != (high < 0.0)
            share = (low[across] / (low[across] - high[across]))[:, None]
            ends = [np.moveaxis(nodes, k, 0)[part][across] for part in (slice(None, -1), slice(1, None))]
            found.append((1.0 - share) * ends[0] + share * ends[1])
        return self.feet(np.concatenate(found))


def principal_curvatures(gradients, hessians):
    """Both principal curvatures of level surfaces, shape (n, 2), positive where they bend as a ball does."""
    length = np.linalg.norm(gradients, axis=1)
    normals = gradients / length[:, None]
    flat = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    shape = flat @ hessians @ flat / length[:, None, None]
    trace = np.trace(shape, axis1=1, axis2=2)
    square = np.sum(shape**2, axis=(1, 2))
    apart = np.sqrt(np.maximum(2.0 * square - trace**2, 0.0))
    return 0.5 * np.stack([trace - apart, trace + apart], axis=1)
