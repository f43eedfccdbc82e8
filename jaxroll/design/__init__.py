"""Fingertips by gradient: contours that hold a grasp, within limits of size and making.

`_shape` says which numbers of a contour are free, `_limits` what it must keep to, `_minimise` is the loop
over optax (the only door to it here), `_fingertip` the problem of condition (41).
"""

from ._fingertip import Design as Design, optimise_fingertip as optimise_fingertip
from ._limits import Limits as Limits
