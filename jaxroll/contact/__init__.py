"""Two shapes touching: gap, tangency, Pfaffian rows and their bias, and rolling kinematics.

`_contact` is what a contact has to answer, `_contact2` answers it in the plane and `_contact3` in space,
both by the gap of `_gap`. `locating` finds where two shapes are nearest, wherever they are.
"""

from ._contact import AbstractContact as AbstractContact
from ._contact2 import Contact as Contact, rolling_rate as rolling_rate, tangency as tangency, Touch as Touch
from ._contact3 import Contact3 as Contact3, tangency3 as tangency3, Touch3 as Touch3
from ._gap import (
    gap as gap,
    gap_bias as gap_bias,
    gap_rate as gap_rate,
    Motion as Motion,
    pfaffian as pfaffian,
    Rows as Rows,
)
from .locating import (
    clearance as clearance,
    LocalMinima as LocalMinima,
    locate as locate,
    locate_surfaces as locate_surfaces,
    Location as Location,
    SurfaceLocation as SurfaceLocation,
    SurfaceMinima as SurfaceMinima,
    TOLERANCE as TOLERANCE,
)
