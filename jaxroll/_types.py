"""Array aliases and the axis alphabet shared by every signature in the package.

| letter | axis |
|---|---|
| `n` | generalised coordinates (object first, then the fingers in order) |
| `c` | contacts |
| `m` | constraint rows |
| `k` | joints of one finger |
| `t` | saved times |
"""

from collections.abc import Sequence
from typing import Any

from jaxtyping import Array, ArrayLike, Float

# One leaf of the scalar algebra: a 0-d array, a tracer, or a Python number.
Scalar = Any
Scalars = tuple[Any, ...]

# What a caller may give where an array is meant.
Given = ArrayLike | Sequence[Any]

Points = Float[Array, "... 2"]
Times = Float[Array, " t"]
