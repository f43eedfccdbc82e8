"""Bodies, grasp and constrained dynamics: everything from here up is q, v and A(q).

`_finger` and `_object` give one body's kinematics and inertia, `_grasp` puts them together,
`_constraints` linearises the rolling contacts, `_dynamics` solves for accelerations and forces.
"""

from ._arrays import (
    equation_terms as equation_terms,
    EquationTerms as EquationTerms,
    mass_matrix as mass_matrix,
)
from ._body import Inertia as Inertia, Motion as Motion
from ._constraints import (
    apply_jacobian as apply_jacobian,
    balance as balance,
    bodies as bodies,
    combine as combine,
    Linearisation as Linearisation,
    linearise as linearise,
    poses as poses,
    Residual as Residual,
    residual as residual,
    respond as respond,
    spins as spins,
    touches as touches,
    unknown_line as unknown_line,
)
from ._dynamics import (
    accelerate as accelerate,
    Instant as Instant,
    kinetic_energy as kinetic_energy,
    net_force as net_force,
    normal_and_tangential as normal_and_tangential,
    Stabiliser as Stabiliser,
)
from ._finger import AbstractFinger as AbstractFinger, Finger as Finger
from ._grasp import compiled as compiled, Grasp as Grasp
from ._jaw import Jaw as Jaw
from ._object import (
    AbstractObject as AbstractObject,
    FreeObject as FreeObject,
    PivotedObject as PivotedObject,
)
from ._state import (
    Blocks as Blocks,
    join as join,
    Leaves as Leaves,
    split as split,
    State as State,
    to_leaves as to_leaves,
    to_state as to_state,
)
