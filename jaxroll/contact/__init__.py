"""Two shapes touching: gap, tangency, Pfaffian rows by autodiff, and rolling kinematics."""

from ._clearance import clearance as clearance, TOLERANCE as TOLERANCE
from ._closest import LocalMinima as LocalMinima, Location as Location
from ._location import locate as locate
from ._rolling import (
    Contact as Contact,
    gap as gap,
    gap_bias as gap_bias,
    gap_rate as gap_rate,
    pfaffian as pfaffian,
    rolling_rate as rolling_rate,
    tangency as tangency,
    Touch as Touch,
    touch as touch,
)
