"""The chapter's scenes, ready to run, and bodies that roll alone.

`_plane_scenes` has those of Parts 1 and 2, a ring of fingers and a roller; `_space_scenes` that of Part 3;
`_tripod` a hand in space that carries what it holds; `_rolling_bodies` single bodies on a surface;
`_any_pinch` objects of any shape between two fingers. Every scene is a grasp and a state at which its
contacts are closed, as `simulate` takes them; `rectangle`, `cuboid` and `spheroid` are objects to be held.
"""

from ._any_pinch import pinch_object as pinch_object
from ._plane_scenes import (
    ball_plate as ball_plate,
    OBJECT_SHIFT as OBJECT_SHIFT,
    pinch as pinch,
    pinch_ellipse as pinch_ellipse,
    pivoted as pivoted,
    rectangle as rectangle,
    ring as ring,
    roller as roller,
)
from ._rolling_bodies import (
    incline as incline,
    rattleback as rattleback,
    tube as tube,
    turntable as turntable,
    wheel as wheel,
)
from ._space_scenes import cuboid as cuboid, pinch3d as pinch3d
from ._tripod import spheroid as spheroid, tripod as tripod
