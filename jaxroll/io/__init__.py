"""Files and images in, files out: points for `fit_contour`, outlines of contours to draw or to make.

`_tables` holds CSV and NPY, `_vector` SVG and DXF, `_mesh` solids, `_section` plane cuts of a mesh, `_image`
silhouettes, `_outline` contours as polygons; `_files` chooses by the file's ending. Units are always stated.
SVG, DXF, STL and images want `pip install "jaxroll[cad]"`.
"""

from ._files import read_points as read_points, write_outline as write_outline
from ._image import read_silhouette as read_silhouette
from ._mesh import read_mesh as read_mesh, write_stl as write_stl
from ._section import section as section
