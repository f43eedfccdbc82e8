"""The chapter's scenes, ready to run: Parts 1 and 2 in `_plane`, Part 3 in `_space`; bodies rolling alone."""

from ._plane import (
    ball_plate as ball_plate,
    OBJECT_SHIFT as OBJECT_SHIFT,
    pinch as pinch,
    pinch_ellipse as pinch_ellipse,
    pivoted as pivoted,
    rectangle as rectangle,
    ring as ring,
    roller as roller,
)
from ._rolling import (
    incline as incline,
    rattleback as rattleback,
    tube as tube,
    turntable as turntable,
    wheel as wheel,
)
from ._space import cuboid as cuboid, pinch3d as pinch3d
