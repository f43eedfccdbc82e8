r"""From a vector of unknowns to a contour, and back: the coordinates in which a search descends.

A contour's class says which of its numbers are free and how they are scaled (`free_numbers`,
`preconditioner`, `symmetrised`, `perturbed` of `geometry.AbstractContour`); `ShapeTransform` makes one vector
of them. The functions below it check a caller's contour, and stack several contours for a batch of starts.
`optimise_fingertip` uses all.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._results import as_floats, check_flag, check_instance, computed_at_once, traced
from .._types import Given
from .._xla import quickly
from ..geometry import AbstractContour, ArclengthTable, check_contour, Table, tabled
from ..geometry.contours import divided

# l / size, the unit of the free numbers: the first step of a search is at most one unit long in x.
_UNIT = 0.05


class ShapeTransform(eqx.Module):
    r"""From a vector $x$ to a contour of one class, and back, for an optimiser of your own.

    The free numbers $p$ of the contour (points of a spline, terms of a support function, weights of a
    network, half axes of an ellipse; `free_numbers` of its class says which) depend on the vector by

    $$ p = \ell\,W x, $$

    where $\ell$ is a twentieth of the contour's size (the root mean square distance of its points from $O_i$)
    and $W$ is the `preconditioner` of its class. A wave of order $k$ along a contour, of height $a$, changes
    its curvature by about $k^2 a$ over the square of its size: searched point by point, curvature is stiff.
    So $W$ divides the $k$-th wave by $(1 + k^2)/2$. A step down the gradient in $x$ then moves $p$ by
    $-\ell^2\,W W^T \nabla_p$, down the gradient in the Sobolev norm $\sum_k (1 + k^2)^2 |p_k|^2$. What is no
    length, such as a weight, is measured against its own size.

    Args:
        tip: The contour to begin with, with ends or closed, not prepared. It may be of your own class.
        symmetric: Make each contour its own mirror image about the x axis (`symmetrised` of its class).

    Attributes:
        size: The contour's size [m].
        matrix: $W$, shape (n, n).

    Raises:
        ValueError: If `tip` is endless, prepared, traced or has no free numbers, its class has no mirror
            image where one is asked for, or its class gives free numbers or a preconditioner that do not fit.

    Accuracy: `contour(start)` is `tip`, made symmetric if asked for, to rounding in the solution for $x$.

    Example:
        >>> import jax, jaxroll as jxr, optax
        >>> transform = jxr.design.ShapeTransform(jxr.Ellipse(0.02, 0.014))
        >>> def misfit(x):  # a radius of curvature of 8 mm in front, on a half axis of 18 mm
        ...     tip = transform.contour(x)
        ...     return (0.008 * tip.curvature(0.0) - 1.0) ** 2 + (tip.point(0.0)[0] / 0.018 - 1.0) ** 2
        >>> both, optimiser = jax.jit(jax.value_and_grad(misfit)), optax.adam(0.3)
        >>> x, state = transform.start, optimiser.init(transform.start)
        >>> for _ in range(20):
        ...     _, slope = both(x)
        ...     change, state = optimiser.update(slope, state)
        ...     x = optax.apply_updates(x, change)
        >>> bool(both(x)[0] < 0.1 * both(transform.start)[0])
        True
    """

    tip: AbstractContour
    size: Float[Array, ""]
    matrix: Float[Array, "n n"]
    symmetric: bool = eqx.field(static=True)

    def __init__(self, tip: AbstractContour, *, symmetric: bool = False) -> None:
        self.tip = check_tip(check_instance("tip", tip, AbstractContour, "a contour"))
        self.symmetric = check_flag("symmetric", symmetric)
        if self.symmetric:
            check_image(tip)
        with computed_at_once():  # the tip is known, whatever is traced around this call
            self.size = body_radii(*as_batch([tip]))[0][0]
            self.matrix = _matrix(tip, float(self.size))

    @property
    def start(self) -> Float[Array, " n"]:
        """The vector of the given contour, shape (n,), without dimension."""
        return self.unknowns(self.tip)

    def contour(self, x: Given) -> AbstractContour:
        """The contour of a vector, shape (n,); differentiable, inside `jit` and `vmap` too.

        What is not free is as in `tip`. The contour may fold or cross itself: limits are yours to keep.

        Raises:
            ValueError: If the vector has another shape, or a known one is not finite.
        """
        x = as_floats("x", x, self.matrix.shape[:1])
        free, fixed = divided(self.tip)
        _, unravel = jax.flatten_util.ravel_pytree(free)
        contour = eqx.combine(unravel(self.matrix @ x * (_UNIT * self.size)), fixed)
        return contour.symmetrised() if self.symmetric else contour

    def unknowns(self, contour: AbstractContour) -> Float[Array, " n"]:
        """The vector of a contour of the class of `tip`, with as many free numbers; the inverse of `contour`.

        With `symmetric` it is the inverse for contours that are their own mirror image alone.

        Raises:
            ValueError: If the contour is of another class, or has other free numbers.
        """
        check_instance("contour", contour, type(self.tip), f"of the given one's class, {_kind(self.tip)}")
        flat, _ = jax.flatten_util.ravel_pytree(divided(contour)[0])
        if flat.shape != self.matrix.shape[:1]:
            raise ValueError(
                f"argument contour must have {self.matrix.shape[0]} free numbers, as the given one has, but "
                f"had {flat.size}"
            )
        return jnp.linalg.solve(self.matrix, flat / (_UNIT * self.size))


def _kind(contour: AbstractContour) -> str:
    """The name of a contour's class, for messages."""
    return type(contour).__name__


def check_tip(tip: AbstractContour) -> AbstractContour:
    """Raise unless a contour can be designed: it is known, has a size, no table yet, and free numbers."""
    if traced(tip):
        raise ValueError(f"argument tip must be known before tracing, but was a traced {_kind(tip)}")
    # A prepared contour holds a table of its frame, which would not follow the free numbers.
    table = lambda node: isinstance(node, Table | ArclengthTable)  # noqa: E731
    if any(map(table, jax.tree.leaves(tip, is_leaf=table))):
        raise ValueError(
            f"argument tip must not be prepared, as its table would stay, but was a ready {_kind(tip)}"
        )
    if tip.domain() is None:
        raise ValueError(f"argument tip must have ends or be closed, but was an endless {_kind(tip)}")
    check_contour("tip", tip)
    # Free numbers are found in the contour by identity (`divided`): arrays computed from its own would be
    # lost.
    own = {id(leaf) for leaf in jax.tree.leaves(tip) if eqx.is_inexact_array(leaf)}
    free = tip.free_numbers()
    if not free or not all(id(leaf) in own for leaf in free):
        raise ValueError(
            f"argument tip must have free numbers, floating JAX arrays of its own, but this {_kind(tip)} "
            f"gave {'others' if free else 'none'}"
        )
    return tip


def check_image(tip: AbstractContour) -> None:
    """Raise unless the mirror image that a class gives is a contour of it, with the same arrays."""
    image = tip.symmetrised()
    if jax.tree.structure(image) != jax.tree.structure(tip):
        raise ValueError(
            f"argument symmetric must be False unless a mirror image is of the contour's class, but that of "
            f"this {_kind(tip)} was a {_kind(image)}"
        )


def _matrix(tip: AbstractContour, size: float) -> Array:
    """$W$: the preconditioner that a contour's class gives, checked to be invertible."""
    matrix = np.asarray(tip.preconditioner(size))
    count = sum(leaf.size for leaf in jax.tree.leaves(divided(tip)[0]))
    fits = matrix.shape == (count, count) and bool(np.all(np.isfinite(matrix)))
    if not fits or np.linalg.slogdet(matrix)[0] == 0.0:
        raise ValueError(
            f"argument tip must have an invertible preconditioner of shape ({count}, {count}), but that of "
            f"this {_kind(tip)} had shape {matrix.shape} or was singular"
        )
    return jnp.asarray(matrix)


def as_batch(contours: Sequence[AbstractContour]) -> tuple[Any, Any]:
    """Contours of one kind as a batch: their arrays with a leading axis, and all else, which they share.

    `equinox.combine` makes contours of both again.
    """
    parts = [eqx.partition(contour, eqx.is_inexact_array) for contour in contours]
    first = jax.tree.structure(parts[0])
    if any(jax.tree.structure(part) != first for part in parts):
        kinds = ", ".join(type(contour).__name__ for contour in contours)
        raise ValueError(f"argument tip must be contours of one kind and size, but was {kinds}")
    arrays = [part[0] for part in parts]
    shapes = [[jnp.shape(leaf) for leaf in jax.tree.leaves(part)] for part in arrays]
    if any(shape != shapes[0] for shape in shapes):
        raise ValueError(f"argument tip must be contours of one size, but had arrays of shapes {shapes}")
    return jax.tree.map(lambda *leaves: jax.device_put(np.stack(leaves)), *arrays), parts[0][1]


@quickly
def body_radii(arrays: Any, rest: Any) -> tuple[Array, Array]:
    """Root mean square and largest distance of the points of every contour of a batch from its origin [m].

    `arrays` and `rest` are what `as_batch` returns; the points are 257, evenly spaced by arclength.
    """

    def one(arrays: Any) -> tuple[Array, Array]:
        ready = tabled(eqx.combine(arrays, rest)).prepared()
        ends = ready.domain()
        assert ends is not None  # checked where the contour came in
        places = ends[0] + (ends[1] - ends[0]) * jnp.linspace(0.0, 1.0, 257)
        point = jax.vmap(lambda s: ready.frame(s).point)(places)
        squared = point.dot(point)
        return jnp.sqrt(jnp.mean(squared)), jnp.sqrt(jnp.max(squared))

    return jax.vmap(one)(arrays)


def varied(contours: Sequence[AbstractContour], count: int, seed: int) -> list[AbstractContour]:
    """The contours given, followed by perturbations of them in turn, until there are `count`."""
    rng = np.random.default_rng(seed)
    more = [contours[i % len(contours)].perturbed(rng) for i in range(count - len(contours))]
    return [*contours, *more]
