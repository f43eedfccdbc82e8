"""What `_cli` holds, and where; `__init__.py` reads it, and so do type checkers."""

from ._design_command import designed as designed, DesignOrder as DesignOrder, fingertip as fingertip
from ._facts import (
    pinch3d_facts as pinch3d_facts,
    pinch3d_scene as pinch3d_scene,
    pinch_facts as pinch_facts,
    pinch_scene as pinch_scene,
    pivoted_facts as pivoted_facts,
    pivoted_scene as pivoted_scene,
)
from ._fit_command import fitted as fitted
from ._pinch_command import pinched as pinched, PinchOrder as PinchOrder
from ._replay_command import replayed as replayed
from ._replay_order import replay_order as replay_order, replay_parser as replay_parser
from ._settings import configure as configure, tried_folder as tried_folder
from ._shape_file import ShapeOrder as ShapeOrder
from ._shape_parser import FILE_UNITS as FILE_UNITS, shape_parsers as shape_parsers
from ._sweep_command import mapped as mapped, swept as swept
from ._sweep_order import map_order as map_order, sweep_order as sweep_order, sweep_parser as sweep_parser
from ._waiting import say as say, timed as timed
from ._words import in_options as in_options
