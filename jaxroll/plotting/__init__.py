"""Figures: the chapter's responses, poses and contours, fits to points, and animations.

The only door to matplotlib; `import jaxroll` does not open it. No module touches pyplot.

In the plane, `_outlines` and `_views` work out what is where, and `_artists` draws one instant of it. In
space, `_views3` works out what moves where (`_motion3.Motion3D`), `_meshes` makes triangles of surfaces
(`_rays` where they have no closed form), `_scene3` puts both together, and `_drawing3` draws one instant of
it. `_forces` and `_forces3` make arrows of forces. `_panels` and `_panels3` are what `responses` plots, and
`_film` and `_gif` write what `animate` draws. `_doors` checks the arguments of all figures, and `_style` has
their colours.

`animate`, `pose`, `poses`, `responses` and `page` (for a browser, the only door to plotly) take either kind
of grasp; `loci` one in space; `contours`, `phase` and `contact_geometry`, one contact with the chapter's
names (`_tags` puts its labels), one in the plane. `fit` draws a contour or surface with the points that it
was made of, `design` a fingertip before and after, `comparison` several runs over each other. `parameter_map`
draws what a sweep kept over two parameters, and `map_page` writes that for a browser.
"""

from ._animate import animate as animate
from ._contact_figure import contact_figure as contact_geometry  # noqa: F401
from ._contours import contours as contours
from ._design_figure import comparison as comparison, design as design
from ._fit_figure import fit as fit
from ._loci_figure import loci_figure as loci  # noqa: F401
from ._map_figure import parameter_map as parameter_map
from ._map_page import map_page as map_page
from ._page import page as page
from ._phase import phase as phase
from ._pose import pose as pose, poses as poses
from ._responses import responses as responses
from ._views3 import View as View
