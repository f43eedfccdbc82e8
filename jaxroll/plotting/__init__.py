"""Figures: the chapter's responses, poses and contours, fits to points, and animations.

The only door to matplotlib; `import jaxroll` does not open it. `_outlines` and `_views` work out
what is where, `_artists` draws one instant of it, the other modules make figures. None touches
pyplot.
"""

from ._animate import animate as animate
from ._contours import contours as contours
from ._fit import fit as fit
from ._phase import phase as phase
from ._pose import pose as pose, poses as poses
from ._responses import responses as responses
