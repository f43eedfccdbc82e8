"""What is done for XLA, and for nothing else: see README.md beside this file."""

from ._cache import remembered as remembered
from ._compute_once import once as once, sharing as sharing
from ._one_kernel import (
    filled as filled,
    in_turn as in_turn,
    one_kernel as one_kernel,
    VECTOR as VECTOR,
    WIDE as WIDE,
)
from ._primitives import linear_map as linear_map
from ._share_cotangents import alone as alone, pulled as pulled, shared as shared
from ._trigonometry import inverse_sinh as inverse_sinh, sine_cosine as sine_cosine
