"""The equations of motion of a grasp under its controller, and what can be seen of them at one instant.

`_linearisation` assembles the constraint Jacobian $A$ from all contacts and factorises $A M^{-1} A^T$,
`_equations` solves for accelerations and contact forces, `_projection` returns a state to the constraints,
`_formulation` holds the two ways of keeping them. `_equation_terms` gives the terms of the equations as
arrays, `_quantities` residuals, contact forces, torques, accelerations and energies of given states;
`_impulse` has velocities that change at once, `_sampling` torques that do. `_own_contacts` and `_task_errors`
are checks before a run. Bodies and contacts come from `_mechanics` and `contact`; `_integration` integrates
the result.
"""

from ._equation_terms import (
    equation_terms as equation_terms,
    generalised_force as generalised_force,
    mass_matrix as mass_matrix,
    memory_rates as memory_rates,
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
    check_formulation as check_formulation,
    CSM as CSM,
    Formulation as Formulation,
    Index1 as Index1,
)
from ._impulse import Struck as Struck, struck as struck
from ._linearisation import combine as combine, Linearisation as Linearisation, linearise as linearise
from ._own_contacts import check_rolling as check_rolling, not_rolling as not_rolling
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
    accelerations as accelerations,
    as_times as as_times,
    closed_within as closed_within,
    energies as energies,
    energies_at as energies_at,
    Energy as Energy,
    Multipliers as Multipliers,
    multipliers as multipliers,
    multipliers_at as multipliers_at,
    of_reached as of_reached,
    over_time as over_time,
    power as power,
    Residuals as Residuals,
    residuals as residuals,
    residuals_at as residuals_at,
    split_forces as split_forces,
    torques as torques,
    worst as worst,
    wrenches as wrenches,
)
from ._sampling import (
    begun as begun,
    check_due as check_due,
    memory_after_sample as memory_after_sample,
    memory_waiting as memory_waiting,
    sample_due as sample_due,
)
from ._task_errors import check_tasks as check_tasks
