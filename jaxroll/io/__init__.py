"""Files and images in, files out: points for fits, outlines of contours to draw or to manufacture.

`_tables` reads and writes CSV and NPY, `_svg` and `_dxf` drawings (`_drawing` has what these share), `_mesh`
solids; `_section` cuts a mesh by a plane, `_image` finds silhouettes, `_outline` makes polygons of contours;
`_files` chooses by the file's ending, and `_paths` refuses files that cannot be read or written. The unit of
every number in a file is stated by the caller, and all points here are in metres. Reading SVG, DXF, meshes
and images, and writing DXF and STL, wants `pip install "jaxroll[cad]"`.

`_hand` makes fingers of a robot's description, URDF or MJCF, which `_robot_file` reads: `_urdf` makes a URDF
complete for MuJoCo, `_motors` has what motors and tendons do. That wants `pip install "jaxroll[hands]"`.
"""

from ._files import read_cloud as read_cloud, read_points as read_points, write_outline as write_outline
from ._hand import Hand as Hand, load_hand as load_hand
from ._image import read_silhouette as read_silhouette
from ._mesh import read_mesh as read_mesh, write_stl as write_stl
from ._section import section as section
