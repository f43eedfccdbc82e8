"""From a guess to a state that closes every contact, and the derivative of that.

`_search` finds the nearest configuration, `_implicit_derivative` differentiates it by the implicit function
theorem, `_close` is the entry point.
"""

from ._close import close as close
from ._hold import held_velocities as held_velocities
from ._search import constraint_rows as constraint_rows
