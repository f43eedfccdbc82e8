"""Contours: plane curves by arclength.

- `_contour`: the contract; `_frenet`: the frame by automatic differentiation of the point.
- `_catenary`, `_closed_forms`: contours in closed form.
- `_arclength`: the arclength of curves that are not given by it, and its inverse.
- `_table`: the table over arclength that a run reads of every other contour. Such contours are `_parametric`
  (any function of a parameter), `_spline` (through points, by the B-splines of `_bspline`), `_support`
  (convex, by the Fourier series of the support function), `_neural_support` and `_neural_curvature` (by a
  small network of `_network`, which `_network_descent` fits to points).
- `_free_numbers`: what a design changes of a contour, and how the changes are scaled.
- `_given_points`: conversion of points that a caller gives.
"""

from ._arclength import ArclengthTable as ArclengthTable
from ._bspline import basis as basis
from ._catenary import Catenary as Catenary
from ._closed_forms import Circle as Circle, Ellipse as Ellipse, Line as Line
from ._contour import AbstractContour as AbstractContour, Moved as Moved
from ._free_numbers import divided as divided
from ._frenet import frenet as frenet, Frenet2 as Frenet2
from ._given_points import (
    check_extent as check_extent,
    check_finite_rows as check_finite_rows,
    numbers as numbers,
    polygon_area as polygon_area,
    polygon_length as polygon_length,
)
from ._network import NetworkFit as NetworkFit, PeriodicNetwork as PeriodicNetwork
from ._neural_curvature import NeuralCurvature as NeuralCurvature
from ._neural_support import NeuralSupport as NeuralSupport
from ._parametric import Parametric as Parametric
from ._spline import (
    check_distinct as check_distinct,
    check_enough as check_enough,
    chords as chords,
    knot_count as knot_count,
    Spline as Spline,
    spline_basis as spline_basis,
)
from ._support import AbstractSupport as AbstractSupport, SupportFunction as SupportFunction
from ._table import (
    AbstractTabulated as AbstractTabulated,
    as_it_is_resolved as as_it_is_resolved,
    from_frames as from_frames,
    Table as Table,
    TableError as TableError,
    tabulated as tabulated,
    unevenness as unevenness,
)
