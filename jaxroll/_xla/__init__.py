"""What is done for XLA, and for nothing else: see README.md beside this file."""

from ._cache import remembered as remembered
from ._compute_once import (
    alone as alone,
    once as once,
    pulled as pulled,
    shared as shared,
    sharing as sharing,
)
from ._one_kernel import (
    filled as filled,
    in_turn as in_turn,
    one_kernel as one_kernel,
    VECTOR as VECTOR,
    WIDE as WIDE,
)
from ._primitives import linear_map as linear_map
from ._trigonometry import inverse_sinh as inverse_sinh, sine_cosine as sine_cosine
