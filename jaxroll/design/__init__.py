"""Fingertips by gradient: contours that hold a grasp, within limits of size and manufacture.

`_fingertip` has the entry point and `_design` its result. `_shape_transform` makes a contour of a vector: the
class of the contour says which of its numbers are free (`geometry.AbstractContour`). `_limits` has what it
must keep to, `_goals` what a search is for: the margin of condition (41); or runs of the closed loop
(`_closed_loop_goal`, by the `_measures` of a run); or stability at rest (`_firmness`); or any of these with a
contour without waves (`_fair`). `_minimise` searches from all starts within the limits, by steps of
`_descent`; `_gradient` chooses the mode of differentiation.
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
