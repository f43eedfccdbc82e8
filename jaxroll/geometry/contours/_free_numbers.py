r"""The numbers of a contour that a design changes, and how changes of them are scaled.

A contour's own class says which these are (`free_numbers`) and gives the matrix $W$ from unknowns $x$ to
them, $p = \ell\,W x$ with a length $\ell$ (`preconditioner`). Here is what a contour is asked, and what the
classes share. `_contour` is the contract of a contour in a run.

A wave of order $k$ along a contour, of height $a$, changes its curvature by about $k^2 a$ over the square of
its size. For every unknown to change the curvature alike, $W$ divides the wave by $(1 + k^2)/2$. A step down
the gradient in $x$ moves $p$ by $-W W^T \nabla_p$: down the gradient in the Sobolev norm that counts second
derivatives, $\sum_k (1 + k^2)^2 |p_k|^2$, and not in that of the points.
"""

from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np

from .._tabled import AbstractShape

# Size of a perturbation, as a share of the contour's own numbers.
PERTURBED = 0.15

DesignedType = TypeVar("DesignedType", bound="AbstractDesigned")


class AbstractDesigned(AbstractShape):
    """What a design asks of a contour: its free numbers, their scale, a mirror image, another start."""

    def free_numbers(self) -> list[Any]:
        """The arrays of this contour that a design may change: by default all of its floating arrays.

        They are found in the contour by identity: give the arrays themselves, not what is worked out of them.
        """
        return [leaf for leaf in jax.tree.leaves(self) if eqx.is_inexact_array(leaf)]

    def preconditioner(self, size: float) -> np.ndarray:
        r"""Matrix $W$ (n, n) from unknowns to free numbers, $p = \ell\,W x$, with $\ell$ = `size` / 20 [m].

        The free numbers stand in $p$ in the order of the contour's fields, each array row by row. `size` is
        the root mean square distance of the contour's points from its body's origin [m]. Choose $W$ so that
        all unknowns of one size change the curvature alike: points and terms of series are divided by about
        the square of their wave's order. By default it is diagonal: each array is measured against its own
        root mean square, so that numbers which are no lengths need no unit.
        """
        return own_sizes(self, size)

    def symmetrised(self: DesignedType) -> DesignedType:
        """This contour made its own mirror image about its x axis: the mean of both; of the same class.

        It runs inside compiled programs, differentiated in the free numbers. By default a class has none.

        Raises:
            ValueError: If the class, or this contour, has no mirror image of its kind.
        """
        raise ValueError(f"argument symmetric must be False for a {type(self).__name__}, but was True")

    def perturbed(self: DesignedType, rng: np.random.Generator) -> DesignedType:
        """A contour like this one, of the same class: another start for a search.

        By default every free number is changed by some 15 %.
        """
        return each_perturbed(self, rng)


def divided(contour: Any) -> tuple[Any, Any]:
    """The free numbers of a contour, and the rest of it: two trees for `equinox.combine`."""
    free = {id(leaf) for leaf in contour.free_numbers()}
    return eqx.partition(contour, jax.tree.map(lambda leaf: id(leaf) in free, contour))


def own_sizes(contour: Any, size: float) -> np.ndarray:
    """Diagonal matrix by which every array of free numbers is measured against its root mean square."""
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(divided(contour)[0])]
    sizes = [float(np.sqrt(np.mean(leaf**2))) for leaf in leaves]
    each = [
        np.full(leaf.size, own / size if own > 0.0 else 1.0) for leaf, own in zip(leaves, sizes, strict=True)
    ]
    return np.diag(np.concatenate(each))


def each_perturbed(contour: Any, rng: np.random.Generator) -> Any:
    """A contour with every free number changed by some 15 %."""
    free, fixed = divided(contour)
    spread = lambda x: x * (1.0 + PERTURBED * rng.standard_normal(np.shape(x)))  # noqa: E731
    return eqx.combine(jax.tree.map(spread, free), fixed)


def damping(order: np.ndarray) -> np.ndarray:
    """Factors 2 / (1 + k^2) of waves of orders k, by which all bend a contour alike; one for order one."""
    return 2.0 / (1.0 + order**2)


def point_waves(count: int, *, closed: bool) -> np.ndarray:
    """Matrix (2 count, 2 count) that divides the waves along a contour's points by about their order squared.

    The points of a closed contour are one period. Those of an open one are continued by their mirror image,
    there and back, so that waves do not join one end to the other.
    """
    # An open contour's period has `whole` = 2 count - 2 points, since its ends come once. A wave of order k
    # there is of order k / 2 along the contour itself.
    ends = 0 if closed else count - 1
    whole = count + max(ends - 1, 0)
    wave = np.abs(np.fft.fftfreq(whole) * whole) / (2.0 if ends else 1.0)
    # Multiplying wave k by damping(k) is a convolution with the inverse transform of the factors. The mirror
    # image of point j stands at -j.
    kernel = np.real(np.fft.ifft(damping(wave)))
    place = np.arange(count)
    matrix = kernel[(place[:, None] - place[None, :]) % whole]
    if ends:
        matrix = matrix + kernel[(place[:, None] + place[None, :]) % whole]
    return np.kron(matrix, np.eye(2))


def wavy_shift(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Random shifts of points (n, 2) [m] by a translation and the first three waves along the contour."""
    u = 2.0 * np.pi * np.arange(len(points)) / len(points)
    waves = [np.ones_like(u), *(f(k * u) / k for k in (1, 2, 3) for f in (np.cos, np.sin))]
    size = 0.5 * PERTURBED * np.sqrt(np.mean(np.sum(points**2, axis=1)))
    return size * np.stack(waves, axis=1) @ rng.standard_normal((len(waves), 2))
