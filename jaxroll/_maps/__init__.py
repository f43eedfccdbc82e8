"""What a sweep keeps of each run, by name, and maps of outcomes that are fine only where they must be.

`_measures_kept` has `measures`, the named reductions for `keep` of `sweep`: those of `design`, and what a run
says of its end and its energy. `_adaptive` has `adaptive_map`: any outcome over a grid, worked out at few
points, then near changes; `_cells` is its geometry: which cells are split, and what stands between the points
that were run.
"""

from ._adaptive import adaptive_map as adaptive_map, AdaptiveMap as AdaptiveMap
from ._measures_kept import Measures as Measures, measures as measures, MEASURES_KEPT as MEASURES_KEPT
