"""Bodies, grasp and constrained dynamics: everything from here up is q, v and A(q).

`_finger` and `_object` give one body's kinematics and inertia, `_grasp` puts them together,
`_constraints` linearises the rolling contacts, `_dynamics` solves for accelerations and forces.
"""

from ._arrays import equation_terms as equation_terms, mass_matrix as mass_matrix
from ._body import AbstractBody as AbstractBody, Coordinate as Coordinate, QUATERNION as QUATERNION
from ._constraints import (
    balance as balance,
    bodies as bodies,
    closing as closing,
    combine as combine,
    displaced as displaced,
    Linearisation as Linearisation,
    linearise as linearise,
    negative as negative,
    residual as residual,
    respond as respond,
    spins as spins,
    touches as touches,
    unknown_line as unknown_line,
    world_poses as world_poses,
)
from ._controller import AbstractController as AbstractController, as_drive as as_drive, Torques as Torques
from ._dynamics import (
    accelerate as accelerate,
    Instant as Instant,
    kinetic_energy as kinetic_energy,
    net_force as net_force,
    Stabiliser as Stabiliser,
)
from ._finger import AbstractFinger as AbstractFinger, Finger as Finger
from ._finger3 import Finger3 as Finger3
from ._grasp import (
    check_grasp as check_grasp,
    check_planar as check_planar,
    check_spatial as check_spatial,
    check_states as check_states,
    compiled as compiled,
    Grasp as Grasp,
    Labels as Labels,
)
from ._jaw import Jaw as Jaw
from ._object import FreeObject as FreeObject, PivotedObject as PivotedObject
from ._object3 import FreeObject3 as FreeObject3
from ._stage import Stage as Stage, Turning as Turning
from ._state import (
    Blocks as Blocks,
    Form as Form,
    join as join,
    Leaves as Leaves,
    split as split,
    State as State,
    to_leaves as to_leaves,
    to_places as to_places,
)
