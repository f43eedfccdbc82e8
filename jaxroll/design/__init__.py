"""Fingertips by gradient: contours that hold a grasp, within limits of size and making.

`_fingertip` has the entry point and `_design` its result. `_shape_transform` makes a contour of a vector:
which numbers of it are free its own class says (`geometry.AbstractContour`). `_limits` is what it must keep
to. What is wanted is a goal of `_goals`: the margin of condition (41); runs of the closed loop
(`_closed_loop_goal`, by the `_measures` of a run); stability at rest (`_firmness`); any of these and a
contour without waves (`_fair`). `_minimise` is the loop over starts and limits, `_descent` the steps in it,
`_gradient` the mode of differentiation.
"""

from ._closed_loop_goal import ClosedLoop as ClosedLoop
from ._design import Design as Design
from ._fair import Fair as Fair
from ._fingertip import optimise_fingertip as optimise_fingertip
from ._firmness import Firmness as Firmness
from ._goals import AbstractGoal as AbstractGoal, Margin as Margin
from ._gradient import value_and_grad as value_and_grad
from ._limits import Limits as Limits
from ._measures import (
    friction_demand as friction_demand,
    overshoot as overshoot,
    peak_force as peak_force,
    settling_time as settling_time,
    tracking_error as tracking_error,
)
from ._shape_transform import ShapeTransform as ShapeTransform
