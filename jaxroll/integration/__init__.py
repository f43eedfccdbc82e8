"""From a guess to a trajectory: consistent starts, drift control, and the only door to diffrax.

`_close` finds a consistent state (`_nearest` searches, `_settled` differentiates), `_flow` lays the state
out as one vector, `_closed_loop` evaluates and projects it, `_stepper` makes one step, `_rosenbrock` a
linearly implicit one, `_pace` sets its length, `_loop` and `_ensemble` make many, `_march` differentiates
them, `_simulate` is the entry point, `_trajectory` its result, `_report` what is printed of it and `_observe`
the chapter's quantities along it.
"""

from ._bearing import Bearing as Bearing, bearing as bearing
from ._close import close as close, reach as reach
from ._closed_loop import generalised_force as generalised_force
from ._formulation import CSM as CSM, Index1 as Index1
from ._loci import check_run as check_run, Loci as Loci, loci as loci, Locus as Locus
from ._nearest import constraint_rows as constraint_rows
from ._observe import (
    energies as energies,
    Energy as Energy,
    Multipliers as Multipliers,
    multipliers as multipliers,
    Residuals as Residuals,
    residuals as residuals,
    split_forces as split_forces,
    worst as worst,
)
from ._pinch import check_pinch as check_pinch, pinch_balance as pinch_balance, PinchBalance as PinchBalance
from ._press import press_balance as press_balance, PressBalance as PressBalance
from ._report import (
    amount as amount,
    cause as cause,
    complaint as complaint,
    contact_name as contact_name,
    REMEDIES as REMEDIES,
)
from ._roll import roll as roll, Rolled as Rolled
from ._rosenbrock import Rosenbrock as Rosenbrock
from ._simulate import simulate as simulate
from ._trajectory import Stats as Stats, Trajectory as Trajectory
