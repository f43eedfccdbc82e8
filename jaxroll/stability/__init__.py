"""When a grasp comes to rest, and whether it stays: statics of a pinch, equilibria, verdicts.

`_statics` has the chapter's static quantities (25)-(29), (32), (39)-(41), `_equilibrium` finds where forces
balance, `_verdict` says what happens near there, by `_memory_loop` for a controller with a memory.
"""

from ._equilibrium import Equilibrium as Equilibrium, equilibrium as equilibrium
from ._statics import (
    margin as margin,
    pinch_rest as pinch_rest,
    pinch_statics as pinch_statics,
    PinchStatics as PinchStatics,
    rectangle_hessian as rectangle_hessian,
)
from ._verdict import assess as assess, Stability as Stability, VERDICTS as VERDICTS
