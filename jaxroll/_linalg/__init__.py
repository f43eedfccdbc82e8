"""Small vectors, poses and solves, as pytrees of scalars: `_plane` in the plane, `_space` in space.

XLA fuses and batches scalars well, and small arrays badly (see `_plane`). `_plane` also holds what both need:
sums and products of scalars, and the solution of small linear systems. `_arrays` has rows and stacks of them,
`_loop_factor` the solution of systems too large for scalars.
"""

from ._arrays import (
    larger as larger,
    largest as largest,
    row as row,
    smaller as smaller,
    stacked as stacked,
    three as three,
    value_and_jacobian as value_and_jacobian,
    weighted_sum as weighted_sum,
    with_row as with_row,
    with_row_selected as with_row_selected,
)
from ._loop_factor import (
    factorise_in_loop as factorise_in_loop,
    LoopFactor as LoopFactor,
    solve_in_loop as solve_in_loop,
    unknown_loop_factor as unknown_loop_factor,
)
from ._plane import (
    Factor as Factor,
    factorise as factorise,
    inner as inner,
    minus as minus,
    plus as plus,
    Pose2 as Pose2,
    root as root,
    scalars as scalars,
    sincos as sincos,
    solve as solve,
    times as times,
    total as total,
    Triangle as Triangle,
    Twist2 as Twist2,
    unknown_factor as unknown_factor,
    unstack as unstack,
    Vec2 as Vec2,
)
from ._space import (
    conjugate as conjugate,
    normalised as normalised,
    outer as outer,
    Pose3 as Pose3,
    pose_at as pose_at,
    Quaternion as Quaternion,
    quaternion_product as quaternion_product,
    quaternion_rate as quaternion_rate,
    rotation as rotation,
    seven as seven,
    square as square,
    Sym3 as Sym3,
    tangents as tangents,
    Twist3 as Twist3,
    UNIT_AXES as UNIT_AXES,
    Vec3 as Vec3,
)
