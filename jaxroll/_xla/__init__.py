"""What is done for XLA, and for nothing else: see README.md beside this file."""

from ._arithmetic import in_arithmetic as in_arithmetic
from ._collector import uncollected as uncollected
from ._compute_once import as_it_is as as_it_is, once as once, sharing as sharing
from ._loops import counted as counted, repeated as repeated
from ._one_kernel import (
    differentiable_once as differentiable_once,
    in_both_modes as in_both_modes,
    in_turn as in_turn,
    one_kernel as one_kernel,
    perturbed as perturbed,
    side_by_side as side_by_side,
    VECTOR as VECTOR,
    WIDE as WIDE,
    with_lanes as with_lanes,
    without_derivative as without_derivative,
)
from ._primitives import linear_map as linear_map
from ._quick import (
    at_once as at_once,
    briskly as briskly,
    QUICK as QUICK,
    quickly as quickly,
    SOON as SOON,
    soon as soon,
    takes_options as takes_options,
)
from ._remembered import remembered as remembered
from ._share_cotangents import pulled as pulled, pushed as pushed, shared as shared
from ._stored import unstored as unstored
from ._traced_once import traced_once as traced_once
from ._trigonometry import inverse_sinh as inverse_sinh, sine_cosine as sine_cosine
