"""The equations of motion of a grasp under its controller, and what can be seen of them at one instant.

`_linearisation` has the constraint rows and their Schur complement, `_equations` solves for accelerations and
forces, `_projection` brings a state back onto the constraints, `_formulation` names the ways to hold them,
`_equation_terms` gives the terms as arrays, `_quantities` residuals, forces and energies.
"""

from ._equation_terms import (
    equation_terms as equation_terms,
    generalised_force as generalised_force,
    mass_matrix as mass_matrix,
)
from ._equations import (
    bodies as bodies,
    evaluate as evaluate,
    Instant as Instant,
    touches as touches,
    world_poses as world_poses,
)
from ._formulation import (
    as_formulation as as_formulation,
    CSM as CSM,
    Formulation as Formulation,
    Index1 as Index1,
)
from ._linearisation import linearise as linearise
from ._projection import (
    Anchor as Anchor,
    anchor_of as anchor_of,
    compatible as compatible,
    displaced as displaced,
    residual as residual,
    settle as settle,
    unknown_anchor as unknown_anchor,
)
from ._quantities import (
    as_times as as_times,
    energies as energies,
    energies_at as energies_at,
    Energy as Energy,
    Multipliers as Multipliers,
    multipliers as multipliers,
    multipliers_at as multipliers_at,
    of_reached as of_reached,
    power as power,
    reach as reach,
    Residuals as Residuals,
    residuals as residuals,
    residuals_at as residuals_at,
    split_forces as split_forces,
    worst as worst,
)
