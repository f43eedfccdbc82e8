"""The equations of motion of a grasp under its controller, and what can be seen of them at one instant.

`_equations` evaluates them and brings a state back onto the constraints, `_formulation` names the ways to
hold the constraints, `_quantities` has residuals, forces and energies.
"""

from ._equations import (
    Anchor as Anchor,
    anchor_of as anchor_of,
    compatible as compatible,
    evaluate as evaluate,
    generalised_force as generalised_force,
    power as power,
    settle as settle,
    unknown_anchor as unknown_anchor,
)
from ._formulation import (
    as_formulation as as_formulation,
    CSM as CSM,
    Formulation as Formulation,
    Index1 as Index1,
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
    Residuals as Residuals,
    residuals as residuals,
    residuals_at as residuals_at,
    split_forces as split_forces,
    worst as worst,
)
