"""Two shapes touching: gap, tangency, Pfaffian rows and their bias, and rolling kinematics.

`_contact` declares what the dynamics needs of a contact, `_rolling_contact` has it for contours in the plane,
of which users make a `Contact` (`_contact2`), and `_contact3` for surfaces in space, both with the gap of
`_gap`. `_from_gap` derives the same for any contact from its gap and tangency. `_motion` calls them in every
evaluation of the equations of motion. `locating` finds where two shapes are nearest, whether they touch or
not.
"""

from ._contact import AbstractContact as AbstractContact
from ._contact2 import Contact as Contact
from ._contact3 import Contact3 as Contact3, tangency3 as tangency3, Touch3 as Touch3
from ._gap import (
    gap as gap,
    gap_bias as gap_bias,
    gap_rate as gap_rate,
    Motion as Motion,
    pfaffian as pfaffian,
    Rows as Rows,
)
from ._rolling_contact import rolling_rate as rolling_rate, tangency as tangency, Touch as Touch
from .locating import (
    chains_apart as chains_apart,
    clearance as clearance,
    clearance3 as clearance3,
    links_apart as links_apart,
    links_clearance as links_clearance,
    links_clearance3 as links_clearance3,
    LocalMinima as LocalMinima,
    locate as locate,
    locate_surfaces as locate_surfaces,
    Location as Location,
    SurfaceLocation as SurfaceLocation,
    SurfaceMinima as SurfaceMinima,
    TOLERANCE as TOLERANCE,
)
