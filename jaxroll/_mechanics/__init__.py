"""Bodies and grasp: mass matrix, bias force and kinematics of each body, and their combination in a grasp.

`_body` declares what a body is. Users make those of the plane by `_object2`, `_finger` and `_jaw`, whose
formulas are in `_plane_bodies`, and those of space by `_object3`, `_finger3` (evaluated as `_chain3`) and
`_stage`. `_grasp` combines bodies, contacts and controller, `_assembly` has what a run reads of that, and
`_changes` copies it with other values. `_state` holds positions, velocities and places, `_entry` checks what
public functions are given. `_motion` forms the equations of motion from all of this.
"""

from ._body import (
    AbstractBody as AbstractBody,
    AbstractFinger as AbstractFinger,
    Coordinate as Coordinate,
    Inertia as Inertia,
)
from ._controller import (
    AbstractController as AbstractController,
    as_drive as as_drive,
    own_memory as own_memory,
    Torques as Torques,
)
from ._entry import (
    as_grasp_and_state as as_grasp_and_state,
    check_grasp as check_grasp,
    check_planar as check_planar,
    check_spatial as check_spatial,
    check_states as check_states,
    compiled as compiled,
    compiled_for_many as compiled_for_many,
)
from ._finger import Finger as Finger
from ._finger3 import Finger3 as Finger3
from ._grasp import (
    Grasp as Grasp,
    has_unchecked_shapes as has_unchecked_shapes,
    Labels as Labels,
    tabled_and_judged as tabled_and_judged,
    tabled_grasp as tabled_grasp,
)
from ._jaw import Jaw as Jaw
from ._load import AbstractLoad as AbstractLoad, as_loads as as_loads, Moving as Moving, Wrench as Wrench
from ._object2 import FreeObject as FreeObject, PivotedObject as PivotedObject
from ._object3 import FreeObject3 as FreeObject3, QUATERNION as QUATERNION
from ._stage import Stage as Stage, Turning as Turning
from ._state import (
    Blocks as Blocks,
    check_not_cut as check_not_cut,
    Form as Form,
    join as join,
    Leaves as Leaves,
    reached as reached,
    split as split,
    State as State,
    to_leaves as to_leaves,
    to_places as to_places,
)
