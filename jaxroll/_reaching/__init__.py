"""A start for one's own hand: where to touch an object, and joint angles that touch it there.

`_grasp_points` finds pairs of points that need little friction, `reach` postures whose fingertips touch given
points. Both walk over contours and surfaces as `_sheet` has them, in NumPy: their numbers of steps vary, and
nothing of them is differentiated.
"""

from ._grasp_points import grasp_points as grasp_points, GraspPoints as GraspPoints
from ._postures import placed_at as placed_at, poses_at as poses_at, tip_origins as tip_origins
from ._reach import Reach as Reach, reach as reach
from ._sheet import Frames as Frames, sheet_of as sheet_of
