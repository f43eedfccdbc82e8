"""Two shapes touching: gap, tangency, Pfaffian rows and their bias, and rolling kinematics."""

from ._clearance import clearance as clearance, TOLERANCE as TOLERANCE
from ._closest import (
    LocalMinima as LocalMinima,
    Location as Location,
    SurfaceLocation as SurfaceLocation,
    SurfaceMinima as SurfaceMinima,
)
from ._contact import AbstractContact as AbstractContact, Motion as Motion, Rows as Rows
from ._gap import (
    gap as gap,
    gap_bias as gap_bias,
    gap_rate as gap_rate,
    pfaffian as pfaffian,
)
from ._location import locate as locate
from ._location3 import locate_surfaces as locate_surfaces
from ._rolling import (
    Contact as Contact,
    rolling_rate as rolling_rate,
    tangency as tangency,
    Touch as Touch,
)
from ._rolling3 import Contact3 as Contact3, tangency3 as tangency3, Touch3 as Touch3
