"""Bodies, grasp and constrained dynamics: everything from here up is q, v and A(q).

`_finger` and `_object` give one body's kinematics and inertia, `_grasp` puts them together,
`_constraints` linearises the rolling contacts, `_dynamics` solves for accelerations and forces.
"""

from ._arrays import (
    EquationTerms as EquationTerms,
    equation_terms as equation_terms,
    mass_matrix as mass_matrix,
)
from ._body import Inertia as Inertia, Motion as Motion
from ._constraints import (
    Linearisation as Linearisation,
    Residual as Residual,
    apply_jacobian as apply_jacobian,
    balance as balance,
    bodies as bodies,
    combine as combine,
    linearise as linearise,
    poses as poses,
    residual as residual,
    respond as respond,
    touches as touches,
)
from ._dynamics import (
    Instant as Instant,
    Stabiliser as Stabiliser,
    accelerate as accelerate,
    kinetic_energy as kinetic_energy,
)
from ._finger import Finger as Finger
from ._grasp import Grasp as Grasp
from ._object import AbstractObject as AbstractObject, FreeObject as FreeObject
from ._object import PivotedObject as PivotedObject
from ._state import (
    Blocks as Blocks,
    Leaves as Leaves,
    State as State,
    join as join,
    split as split,
    to_leaves as to_leaves,
    to_state as to_state,
)
