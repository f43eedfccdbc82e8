"""What is worked out of a grasp and its runs.

`_loci` are the curves that contacts trace on both surfaces, `_rolling_kinematics` rolls two surfaces by
given velocities, `_contact_geometry` has the chapter's frames, angles and lengths at a contact, of which
`_pinch_balance` and `_press_balance` make its quantities of Parts 1 and 2, `_bearing` is how a grasp bears at
one state.
"""

from ._bearing import Bearing as Bearing, bearing as bearing
from ._contact_geometry import contact_geometry as contact_geometry, ContactGeometry as ContactGeometry
from ._loci import check_run as check_run, Loci as Loci, loci as loci
from ._pinch_balance import check_pinch as check_pinch, pinch_balance as pinch_balance
from ._press_balance import press_balance as press_balance
from ._rolling_kinematics import roll as roll
