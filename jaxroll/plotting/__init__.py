"""Figures: the chapter's responses, poses and contours, fits to points, and animations.

The only door to matplotlib; `import jaxroll` does not open it. `_outlines` and `_views` work out
what is where, `_artists` draws one instant of it, the other modules make figures. None touches
pyplot.

Of grasps in space, `_motion3` says what moves where, `_meshes` makes triangles of surfaces (`_rays` where
they have no closed form), `_scene3` puts both together and `_drawing3` draws one instant; `_page`, the only
door to plotly, writes a page for a browser.
"""

from ._animate import animate as animate
from ._animate3 import animate3 as animate3
from ._contours import contours as contours
from ._fit import fit as fit
from ._loci import loci as loci
from ._meshes import Mesh as Mesh, mesh as mesh
from ._motion3 import LociRecord as LociRecord, Motion3D as Motion3D, SpatialGrasp as SpatialGrasp
from ._page import page as page
from ._phase import phase as phase
from ._pose import pose as pose, poses as poses
from ._responses import responses as responses
from ._responses3 import responses3 as responses3
from ._space import snapshot3 as snapshot3
