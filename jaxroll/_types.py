"""Array aliases, letters for axes, and limits by precision.

In signatures these letters stand for the same axes, unless a docstring says otherwise:

| letter | axis |
|---|---|
| `n` | generalised coordinates (object first, then the fingers in order) |
| `c` | contacts |
| `m` | constraint rows |
| `f` | fingers |
| `k` | joints of one finger |
| `t` | saved times |
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

# One leaf of the scalar algebra: a 0-d array, a tracer, or a Python number.
Scalar = Any
Scalars = tuple[Any, ...]

# What a caller may give where an array is meant.
Given = ArrayLike | Sequence[Any]

Points = Float[Array, "... 2"]
Times = Float[Array, " t"]


def resolution(t: Scalar) -> Scalar:
    """Eight rounding units of t, or of 1 ms if t is less [s]: nearer times count as one, steps are longer."""
    return 8.0 * jnp.finfo(jnp.result_type(t)).eps * jnp.maximum(jnp.abs(t), 1e-3)


class ByPrecision(NamedTuple):
    """A limit that must lie above rounding: a number for double precision, another for single precision.

    Attributes:
        double: The limit where all numbers have 53 binary digits or more.
        single: The limit where some have fewer.
    """

    double: float
    single: float

    def of(self, *values: Any) -> float:
        """The limit for what is computed from these arrays: the least precise of them decides.

        Trees of arrays are taken apart. What is no floating-point array, such as a caller's function among a
        grasp's leaves, does not count.
        """
        kinds = [leaf.dtype for leaf in jax.tree.leaves(values) if hasattr(leaf, "dtype")]
        coarse = any(jnp.issubdtype(kind, jnp.floating) and jnp.finfo(kind).nmant < 52 for kind in kinds)
        return self.single if coarse else self.double
