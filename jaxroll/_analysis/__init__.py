"""Quantities that are computed from a grasp and its states or runs, after the fact.

`_contact_geometry` has the chapter's frames, angles and lengths at a contact; `_pinch_balance` and
`_press_balance` combine them with the contact forces to the quantities that Parts 1 and 2 plot. `_loci` has
the curves that contacts trace on both surfaces in space (Part 3). `_rolling_kinematics` rolls one surface
over another by a given velocity, without forces. `_link_clearance` says how far links stay clear of the
object. `_bearing` has the margins and contact forces of one state, for `why`.
"""

from ._bearing import Bearing as Bearing, bearing as bearing
from ._contact_geometry import contact_geometry as contact_geometry, ContactGeometry as ContactGeometry
from ._link_clearance import link_clearance as link_clearance, LinkClearance as LinkClearance
from ._loci import check_run as check_run, Loci as Loci, loci as loci
from ._pinch_balance import check_pinch as check_pinch, pinch_balance as pinch_balance
from ._press_balance import press_balance as press_balance
from ._rolling_kinematics import roll as roll
