"""Files: what is written comes back; units; solids; silhouettes; sections."""

import builtins
import math
import pathlib
import re

import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll.geometry import mass_properties, polygon_area
from jaxroll.io import _drawing, _outline, _svg, _tables
from jaxroll.io._mesh import spread_points
from jaxroll.io._outline import chosen, even, filled_places, filled_polygon

BODY = jxr.Ellipse(0.02, 0.014)
TOLERANCE = 2e-6
DATA = pathlib.Path(__file__).parents[2] / "shared" / "data"


def off_ellipse(points):
    """Distances of points from the ellipse, to first order."""
    x, y = points.T / np.array([[0.02], [0.014]])
    level = np.hypot(x, y) - 1.0
    return np.abs(level) / np.hypot(x / 0.02, y / 0.014) * np.hypot(x, y)


@pytest.mark.parametrize("kind", ["csv", "npy", "svg", "dxf"])
@pytest.mark.parametrize("unit", ["mm", "cm", "in", "um", "m"])
def test_an_outline_comes_back(kind, unit, tmp_path):
    path = jxr.io.write_outline(BODY, tmp_path / "new" / f"body.{kind}", unit=unit, tolerance=TOLERANCE)
    points = jxr.io.read_points(path, unit=unit)
    assert off_ellipse(points).max() < 1e-12
    middles = 0.5 * (points + np.roll(points, -1, axis=0))
    assert 0.3 * TOLERANCE < off_ellipse(middles).max() <= 1.01 * TOLERANCE
    assert polygon_area(points) == pytest.approx(np.pi * 0.02 * 0.014, rel=3e-4)
    np.testing.assert_allclose(points[0], BODY.point(0.0), atol=1e-12)


@pytest.mark.parametrize("kind", ["svg", "dxf", "csv"])
def test_a_contour_comes_back(kind, tmp_path):
    """Contour, file, points, contour: within the tolerance everywhere."""
    path = jxr.io.write_outline(BODY, tmp_path / f"body.{kind}", unit="mm", tolerance=9.4e-6)  # 96 points
    fit = jxr.fit_contour(jxr.io.read_points(path, unit="mm"), noise=0.0)
    s = np.linspace(0.0, fit.report.length, 512)
    assert off_ellipse(np.asarray(jxr.geometry.tabled(fit.contour).point(s))).max() < 1e-6
    assert fit.report.length == pytest.approx(float(BODY.domain()[1]), rel=1e-6)
    assert fit.report.radius == pytest.approx(0.014**2 / 0.02, rel=5e-3)


def test_open_outlines(tmp_path):
    arc = jxr.Catenary(0.01, (-0.01, 0.012))
    for kind in ("csv", "svg", "dxf"):
        path = jxr.io.write_outline(arc, tmp_path / f"arc.{kind}", unit="mm")
        points = jxr.io.read_points(path, unit="mm")
        np.testing.assert_allclose(points[[0, -1]], arc.point(np.array([-0.01, 0.012])), atol=1e-13)
    with pytest.raises(ValueError, match="argument contour must be closed or have ends"):
        jxr.io.write_outline(jxr.Catenary(0.01), tmp_path / "arc.csv", unit="mm")


def test_drawings_that_state_another_unit_are_refused(tmp_path):
    for kind in ("svg", "dxf"):
        path = jxr.io.write_outline(BODY, tmp_path / f"body.{kind}", unit="mm", tolerance=1e-4)
        with pytest.raises(
            ValueError, match="argument unit must agree with body.* one unit is 1 mm, but was 25.4"
        ):
            jxr.io.read_points(path, unit="in")
    with pytest.raises(TypeError, match="unit"):
        jxr.io.read_points(path)


PLAIN = """<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="9" viewBox="0 0 {units} 60">
<rect x="10" y="20" width="40" height="30"/></svg>"""


@pytest.mark.parametrize(
    ("width", "millimetres"),
    [("120mm", 1.0), ("12cm", 1.0), ("60in", 12.7), ("72pt", 25.4 / 120), ("6pc", 25.4 / 120)],
)
def test_lengths_that_an_svg_states(width, millimetres, tmp_path):
    """Its width over its viewBox's: the unit that is asked for must be that, to a thousandth."""
    path = tmp_path / "plain.svg"
    path.write_text(PLAIN.format(width=width, units=120))
    points = jxr.io.read_points(path, unit="px", pixel=1e-3 * millimetres)
    assert sorted(map(tuple, (points / (1e-3 * millimetres)).round(9).tolist())) == [
        (10.0, -50.0),
        (10.0, -20.0),
        (50.0, -50.0),
        (50.0, -20.0),
    ]
    for off in (0.998, 1.002):
        with pytest.raises(ValueError, match=f"one unit is {millimetres:.6g} mm, but was") as error:
            jxr.io.read_points(path, unit="px", pixel=1e-3 * millimetres * off)
        assert str(error.value).startswith("argument unit must agree with plain.svg")
    assert len(jxr.io.read_points(path, unit="px", pixel=1e-3 * millimetres * 1.0005)) == 4


def test_an_svg_has_a_margin_all_round(tmp_path):
    """A twentieth of the longer side, so that the line's own width is inside the picture."""
    path = jxr.io.write_outline(BODY, tmp_path / "body.svg", unit="mm", tolerance=1e-4)
    head = path.read_text().splitlines()[0]
    left, top, width, height = map(float, head.split('viewBox="')[1].split('"')[0].split())
    points = 1e3 * jxr.io.read_points(path, unit="mm") * [1.0, -1.0]
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.05 * (high - low).max()
    np.testing.assert_allclose([left, top], low - margin, atol=1e-9)
    np.testing.assert_allclose([left + width, top + height], high + margin, atol=1e-9)


def test_lengths_that_a_dxf_states(tmp_path):
    """Every code that a drawing may give its unit by; ezdxf's own factors are the oracle, if it has them."""
    import ezdxf

    path = tmp_path / "plain.dxf"
    for code in range(1, 25):
        drawing = ezdxf.new(units=code)
        drawing.modelspace().add_lwpolyline([(0, 0), (3, 0), (0, 4)], close=True)
        drawing.saveas(path)
        # Millionths and thousandths of an inch, light years and parsecs, and lengths of the United States'
        # survey, whose foot is longer by two millionths.
        inches = {8: 25.4e-6, 9: 25.4e-3, 22: 25.4 * 1.000002, 21: 304.8 * 1.000002, 23: 914.4 * 1.000002}
        others = inches | {24: 1609344 * 1.000002, 19: 9.46073e18, 20: 3.08568e19}
        millimetres = others.get(code) or 1e3 * ezdxf.units.conversion_factor(code, ezdxf.units.M)
        if code == 6:
            assert np.abs(jxr.io.read_points(path, unit="m")).max() == 4.0
            continue
        with pytest.raises(ValueError, match=re.escape(f"one unit is {millimetres:.6g} mm, but was 1000")):
            jxr.io.read_points(path, unit="m")


CURVED = """<svg xmlns="http://www.w3.org/2000/svg">
<g transform="translate(3,4) scale(2)">
<path d="M 10,0 A 10,10 0 0 1 -10,0 A 10,10 0 0 1 10,0 Z"/>
<rect x="-2" y="-1" width="4" height="2"/></g></svg>"""


def test_svg_curves_groups_and_pixels(tmp_path):
    path = tmp_path / "curved.svg"
    path.write_text(CURVED)
    points = jxr.io.read_points(path, unit="px", pixel=1e-3, samples=64) - [0.003, -0.004]
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.02, rtol=1e-9)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert len(points) == 64 and np.ptp(steps) < 1e-6
    small = jxr.io.read_points(path, unit="mm", which=1) * 1e3
    assert sorted(map(tuple, small.round(9).tolist())) == [
        (-1.0, -6.0),
        (-1.0, -2.0),
        (7.0, -6.0),
        (7.0, -2.0),
    ]
    with pytest.raises(
        ValueError, match="argument which must be below the number of outlines .* 2, but was 2"
    ):
        jxr.io.read_points(path, unit="mm", which=2)
    with pytest.raises(ValueError, match="argument pixel must be given with unit 'px'"):
        jxr.io.read_points(path, unit="px")


def test_dxf_pieces_are_joined(tmp_path):
    """A slot of two lines and two arcs, each drawn by itself; and a circle."""
    import ezdxf

    drawing = ezdxf.new(units=ezdxf.units.MM)
    space = drawing.modelspace()
    space.add_line((0, -5), (20, -5))
    space.add_arc((0, 0), 5, 90, 270)
    space.add_line((20, 5), (0, 5))
    space.add_arc((20, 0), 5, -90, 90)
    space.add_circle((100, 0), 3)
    drawing.saveas(tmp_path / "slot.dxf")
    points = jxr.io.read_points(tmp_path / "slot.dxf", unit="mm", samples=500)
    assert abs(polygon_area(points)) == pytest.approx(1e-6 * (200 + 25 * np.pi), rel=1e-4)
    x, y = 1e3 * points.T
    off = np.hypot(x - np.clip(x, 0, 20), y) - 5.0
    assert np.abs(off).max() < 1e-5
    hole = 1e3 * jxr.io.read_points(tmp_path / "slot.dxf", unit="mm", which=1)
    np.testing.assert_allclose(np.hypot(hole[:, 0] - 100.0, hole[:, 1]), 3.0, rtol=3e-5)


def test_dxf_pieces_drawn_twice_or_with_a_tail(tmp_path):
    """A square of single lines in any order and sense, each drawn twice, and a line from one corner."""
    import ezdxf

    drawing = ezdxf.new(units=ezdxf.units.MM)
    corners = [(0, 0), (30, 0), (30, 30), (0, 30)]
    # Two sides are drawn twice in the same sense, two once each way.
    for i, way in ((2, 1), (0, -1), (3, 1), (1, 1), (1, 1), (2, -1), (0, -1), (3, -1)):
        drawing.modelspace().add_line(*(corners[i], corners[(i + 1) % 4])[::way])
    drawing.modelspace().add_line((30, 30), (40, 50))
    drawing.saveas(tmp_path / "square.dxf")
    points = 1e3 * jxr.io.read_points(tmp_path / "square.dxf", unit="mm")
    assert sorted(map(tuple, points.round(9).tolist())) == sorted(corners)
    assert abs(polygon_area(points)) == pytest.approx(900)
    tail = 1e3 * jxr.io.read_points(tmp_path / "square.dxf", unit="mm", which=1)
    np.testing.assert_allclose(tail, [(30, 30), (40, 50)])


def test_a_dxf_of_one_circle(tmp_path):
    import ezdxf

    drawing = ezdxf.new(units=ezdxf.units.MM)
    drawing.modelspace().add_circle((1, 2), 3)
    drawing.saveas(tmp_path / "circle.dxf")
    points = 1e3 * jxr.io.read_points(tmp_path / "circle.dxf", unit="mm")
    np.testing.assert_allclose(np.hypot(*(points - (1, 2)).T), 3.0, rtol=3e-5)


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("x,y\n1,2\n3,4\n", {}),
        ("# made by hand\n1 2 # corner\n\n3\t4\n", {}),
        ("1,000; 2,0\n3,0; 4,0", {}),
        ("time,x,y\n0,1,2\n1,3,4", {"columns": (1, 2)}),
        ('"x","y"\n"1","2"\n"3", "4"\n', {}),
        ('"1,0"; "2,0"\n"3,0"; "4"\n', {}),
        ('"left, top",1,2\n"right, top",3,4\n', {"columns": (1, 2)}),
        ("3D scan\nof 2nd May\nx1,y1\n1,2\n3,4\n", {}),
        ("1st,x,y\na,1,2\nb,3,4\n", {"columns": (1, 2)}),
        ("1,2,3\n3,4,\n", {}),
        ("1,2\n3,4,corner\n", {}),
        ("1 2\n3 4 5\n", {}),
    ],
)
def test_tables_of_many_makes(text, options, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(text)
    np.testing.assert_allclose(jxr.io.read_points(path, unit="m", **options), [[1, 2], [3, 4]])


def test_decimal_commas_part_whole_from_fraction(tmp_path):
    """Where semicolons part the fields; elsewhere a comma parts them itself."""
    path = tmp_path / "table.csv"
    path.write_text("x [m]; y [m]\n1,25; -2,5\n-0,0625;4,75e-2\n")
    np.testing.assert_array_equal(jxr.io.read_points(path, unit="m"), [[1.25, -2.5], [-0.0625, 0.0475]])
    path.write_text("1.25; 2.5\n3.125; 4.75\n")
    np.testing.assert_array_equal(jxr.io.read_points(path, unit="m"), [[1.25, 2.5], [3.125, 4.75]])
    path.write_text("1.25, 2.5\n3.125,4.75\n")
    np.testing.assert_array_equal(jxr.io.read_points(path, unit="m"), [[1.25, 2.5], [3.125, 4.75]])


@pytest.mark.parametrize("columns", [3, "01", (0,), (0, 1, 2), (0, -1), (0, 1.0), (True, 0), None])
def test_columns_are_two_whole_numbers(columns, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("1,2,3\n4,5,6\n")
    with pytest.raises(ValueError, match="argument columns must be"):
        jxr.io.read_points(path, unit="m", columns=columns)


def test_bad_files_are_named(tmp_path):
    path = tmp_path / "table.csv"
    for text, words in (("1,2\n3,nan\n", "line 2"), ("1,2\n3\n", "line 2"), ("a,b\n", "there was none")):
        path.write_text(text)
        with pytest.raises(ValueError, match=words):
            jxr.io.read_points(path, unit="m")
    np.save(tmp_path / "table.npy", np.zeros((4, 1)))
    with pytest.raises(ValueError, match=r"has shape \(4, 1\)"):
        jxr.io.read_points(tmp_path / "table.npy", unit="m")
    with pytest.raises(ValueError, match="argument path must end in .csv"):
        jxr.io.read_points("shape.png", unit="m")
    with pytest.raises(ValueError, match="argument unit must be one of"):
        jxr.io.write_outline(BODY, path, unit="furlong")
    with pytest.raises(ValueError, match="argument tolerance must be a positive number, but was 0"):
        jxr.io.write_outline(BODY, path, unit="m", tolerance=0.0)


def test_a_solid_is_watertight_and_has_its_volume(tmp_path):
    import trimesh

    path = jxr.io.write_stl(BODY, tmp_path / "body.stl", height=0.01, tolerance=TOLERANCE)
    solid = trimesh.load_mesh(path)
    assert solid.is_watertight and solid.is_winding_consistent
    assert solid.volume == pytest.approx(np.pi * 20 * 14 * 10, rel=3e-4)
    vertices, faces = jxr.io.read_mesh(path, unit="mm")
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [0.04, 0.028, 0.01], atol=2e-6)
    (outline,) = jxr.io.section(vertices, faces, origin=(0.0, 0.0, 0.004), normal=(0, 0, 1))
    assert off_ellipse(outline).max() < 1.1 * TOLERANCE
    with pytest.raises(ValueError, match="argument contour must be closed"):
        jxr.io.write_stl(jxr.Line((0.0, 1.0)), path, height=0.01)
    with pytest.raises(ValueError, match="argument height must be a positive number, but was -1"):
        jxr.io.write_stl(BODY, path, height=-1)
    for height in (1e-300, 1e300):  # neither is there in single precision
        with pytest.raises(ValueError, match="argument height must lie between 1e-09 and 1000 m, but was"):
            jxr.io.write_stl(BODY, path, height=height)


def test_a_solid_far_from_the_origin_keeps_its_tolerance_or_is_refused(tmp_path):
    """STL holds single precision: of a disc of 1 mm 1 km away corners fell together, and left holes."""
    far = jxr.Circle(0.001).moved((1000.0, 0.0))
    with pytest.raises(ValueError, match="^argument tolerance must be at least 3.16e-05 m, as STL's"):
        jxr.io.write_stl(far, tmp_path / "far.stl", height=0.001)
    path = jxr.io.write_stl(far, tmp_path / "far.stl", height=0.001, tolerance=3.16e-5)
    vertices, faces = jxr.io.read_mesh(path, unit="mm")
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert set(np.unique(edges, axis=0, return_counts=True)[1].tolist()) == {2}
    ends = np.linalg.norm(vertices[:, :2] - (1000.0, 0.0), axis=1)
    np.testing.assert_allclose(ends, 0.001, atol=5e-5)


def test_a_contour_that_crosses_itself_is_no_solid(tmp_path, monkeypatch):
    """Nor is one whose straight pieces cross each other in a neck, where they may leave it so far."""
    path = tmp_path / "body.stl"
    snail = lambda u: 0.01 * (1 + 2 * jnp.cos(u)) * jnp.stack([jnp.cos(u), jnp.sin(u)])  # noqa: E731
    crossed = jxr.Parametric(snail, (0.0, 2.0 * np.pi), closed=True, cells=128)
    with pytest.raises(ValueError, match="^argument contour must be a contour that runs once round its body"):
        jxr.io.write_stl(crossed, path, height=0.01)
    bow = np.array([(0.0, 0.0), (0.01, 0.01), (0.01, 0.0), (0.0, 0.01)])
    monkeypatch.setattr("jaxroll.io._mesh.outline", lambda contour, tolerance: bow)
    with pytest.raises(ValueError, match="^argument tolerance must keep .* each other, but was 0.001 m"):
        jxr.io.write_stl(BODY, path, height=0.01, tolerance=1e-3)
    assert not path.exists()


def torus(n=64, m=48, big=0.03, small=0.01):
    u, v = np.meshgrid(2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(m) / m, indexing="ij")
    reach = big + small * np.cos(v)
    vertices = np.stack([reach * np.cos(u), reach * np.sin(u), small * np.sin(v)], axis=-1).reshape(-1, 3)
    i, j = (index.ravel() for index in np.indices((n, m)))
    a, b = i * m + j, (i + 1) % n * m + j
    c, d = i * m + (j + 1) % m, (i + 1) % n * m + (j + 1) % m
    return vertices, np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])


def test_sections_of_a_torus():
    vertices, faces = torus()
    ring, hole = jxr.io.section(vertices, faces, origin=(0, 0, 1e-4), normal=(0, 0, 1))
    np.testing.assert_allclose(np.linalg.norm(ring, axis=1), 0.04, rtol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(hole, axis=1), 0.02, rtol=4e-3)
    assert polygon_area(ring) > 0 and polygon_area(hole) > 0
    pair = jxr.io.section(vertices, faces, origin=(1e-4, 0, 0), normal=(2, 0, 0))
    assert len(pair) == 2
    for outline in pair:
        middle = np.array([np.sign(outline[0, 0]) * 0.03, 0.0])
        np.testing.assert_allclose(np.linalg.norm(outline - middle, axis=1), 0.01, rtol=1e-2)
        assert polygon_area(outline) == pytest.approx(np.pi * 1e-4, rel=1e-2)
    (through,) = jxr.io.section(vertices, faces, origin=(0.035, 0, 0), normal=(1, 0, 0))
    assert polygon_area(through) > 0


def test_where_a_plane_only_touches_a_mesh_it_cuts_nothing_off():
    """A roof, whose ridge is touched; beside a taller one, which is cut, that is no outline."""
    roof = np.array([(x, y, 0.0) for y in (0, 2) for x in (0, 1)] + [(0.5, 0, 1.0), (0.5, 2, 1.0)])
    faces = np.array([(0, 2, 1), (1, 2, 3), (0, 1, 4), (3, 2, 5), (0, 4, 2), (2, 4, 5), (1, 3, 4), (3, 5, 4)])
    ridge = {"origin": (0, 0, 1.0), "normal": (0, 0, 1)}
    with pytest.raises(ValueError, match="^argument origin must put .* the normal it only touches it"):
        jxr.io.section(roof, faces, **ridge)
    taller = roof * np.array([1.0, 1.0, 1.5]) + np.array([3.0, 0.0, 0.0])
    (cut,) = jxr.io.section(np.concatenate([roof, taller]), np.concatenate([faces, faces + 6]), **ridge)
    np.testing.assert_allclose(polygon_area(cut), 2.0 / 3.0)


@pytest.mark.parametrize("length", [1e-320, 1e-200, 1e200, 1e300])
def test_the_normal_of_a_section_may_have_any_length(length):
    vertices, faces = torus(8, 6)
    wanted = jxr.io.section(vertices, faces, origin=(1e-4, 0, 0), normal=(1, 0, 0))
    found = jxr.io.section(vertices, faces, origin=(1e-4, 0, 0), normal=(length, 0, 0))
    np.testing.assert_allclose(found, wanted)


def test_sections_through_vertices_and_past_the_mesh():
    vertices, faces = torus()
    assert len(jxr.io.section(vertices, faces, origin=(0, 0, 0), normal=(0, 0, 1))) == 2
    with pytest.raises(ValueError, match="argument origin must put the plane through the mesh"):
        jxr.io.section(vertices, faces, origin=(0, 0, 1.0), normal=(0, 0, 1))
    with pytest.raises(ValueError, match="argument faces must form a closed surface"):
        jxr.io.section(vertices, faces[1:], origin=(0, 0, 1e-4), normal=(0, 0, 1))
    with pytest.raises(ValueError, match="argument normal must be a vector"):
        jxr.io.section(vertices, faces, origin=(0, 0, 0), normal=(0, 0, 0))
    with pytest.raises(
        ValueError, match="faces must be whole numbers of shape .* from 0 to 3071, but one was -1"
    ):
        jxr.io.section(vertices, [*faces, (0, 1, -1)], origin=(0, 0, 0), normal=(0, 0, 1))
    with pytest.raises(ValueError, match="argument vertices must be finite"):
        jxr.io.section(vertices * np.nan, faces, origin=(0, 0, 0), normal=(0, 0, 1))


def disc_image(radius=30.3, centre=(40.2, 52.6), shape=(90, 110)):
    """Grey values of a blurred disc, bright on dark."""
    rows, columns = np.indices(shape)
    return np.clip(0.25 * (radius - np.hypot(rows - centre[0], columns - centre[1])) + 0.5, 0.0, 1.0)


@pytest.mark.parametrize("dark", [False, True])
def test_a_silhouette_to_a_fraction_of_a_pixel(dark):
    image = disc_image()
    points = jxr.io.read_silhouette(1.0 - image if dark else image, pixel=1e-4, threshold=0.5)
    centre = 1e-4 * np.array([52.6, 89 - 40.2])
    error = np.linalg.norm(points - centre, axis=1) / 1e-4 - 30.3
    assert np.abs(error).max() < 0.02 and polygon_area(points) > 0
    assert np.any(points[0] != points[-1])


def test_silhouettes_that_are_not_whole_are_refused():
    with pytest.raises(ValueError, match="must show the whole shape, but the border cuts"):
        jxr.io.read_silhouette(disc_image()[:50], pixel=1e-4, threshold=0.5)
    with pytest.raises(ValueError, match="argument which must be below the number of outlines, 1"):
        jxr.io.read_silhouette(disc_image(), pixel=1e-4, which=1)
    words = "^argument image must be the values .* and no path, but was .*photo"
    for path in ("photo.png", pathlib.Path("photo.png")):
        with pytest.raises(ValueError, match=words):
            jxr.io.read_silhouette(path, pixel=1e-4)
    for none in (np.zeros((4, 4, 2)), np.zeros((1, 9)), np.zeros((9, 1)), np.zeros(9)):
        with pytest.raises(ValueError, match=r"must be grey values of shape \(rows, columns\)"):
            jxr.io.read_silhouette(none, pixel=1e-4)
    for narrow in (np.eye(9)[3:5], np.eye(9)[:, 3:5]):
        with pytest.raises(ValueError, match="must show the whole shape, but the border cuts"):
            jxr.io.read_silhouette(narrow, pixel=1e-4, threshold=0.5)


def test_points_at_equal_distances():
    """Of a closed polygon the first one is not repeated; an open one keeps both ends."""
    corners = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [0.0, 1.0]])
    around = [[0, 0], [1, 0], [2, 0], [3, 0], [3, 1], [2, 1], [1, 1], [0, 1]]
    np.testing.assert_allclose(even(corners, 8, closed=True), around, atol=1e-15)
    np.testing.assert_allclose(even(corners, 8, closed=False), around, atol=1e-15)
    np.testing.assert_allclose(even(corners, 2, closed=False), corners[[0, 3]])


def test_a_coin_in_a_photograph():
    from skimage import data

    try:
        image = data.coins()
    except Exception as error:  # whatever a machine without a network raises
        pytest.skip(f"no sample image: {error}")
    coin = jxr.io.read_silhouette(image, pixel=1e-4, threshold=107, which=1)
    radii = np.linalg.norm(coin - coin.mean(axis=0), axis=1)
    assert radii.mean() == pytest.approx(28.9e-4, rel=0.01) and np.std(radii) < 0.03 * radii.mean()


def test_without_the_extra_one_sentence_says_what_to_install(tmp_path, monkeypatch):
    svg = jxr.io.write_outline(BODY, tmp_path / "body.svg", unit="mm", tolerance=1e-4)
    real = builtins.__import__

    def bare(name, *rest, **options):
        if name.split(".")[0] in ("svgpathtools", "ezdxf", "trimesh", "mapbox_earcut", "skimage"):
            raise ImportError(name)
        return real(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", bare)
    for library, call in {
        "svgpathtools": lambda: jxr.io.read_points(svg, unit="mm"),
        "ezdxf": lambda: jxr.io.write_outline(BODY, tmp_path / "body.dxf", unit="mm", tolerance=1e-4),
        "trimesh": lambda: jxr.io.write_stl(BODY, tmp_path / "body.stl", height=0.01),
        "scikit-image": lambda: jxr.io.read_silhouette(disc_image(), pixel=1e-4),
    }.items():
        with pytest.raises(ImportError, match=rf'library {library}: pip install "jaxroll\[cad\]"'):
            call()


def test_a_banana_cut_across():
    path = DATA / "ycb_011_banana.npz"
    if not path.exists():
        pytest.skip("the scan is not here")
    scan = np.load(path)
    cuts = jxr.io.section(scan["vertices"], scan["faces"], origin=(0.02, 0.0, 0.0), normal=(1, 0, 0))
    assert len(cuts) == 1 and len(cuts[0]) > 100
    report = jxr.fit_contour(cuts[0], smoothing=0.01).report
    assert report.closed and not report.self_intersecting
    assert 0.1 < report.length < 0.13 and report.rms < 1e-4
    assert 0.005 < report.radius < 0.02 and report.inflections <= 4


BAD_TABLES = {
    "NaN in the first row": ("nan,2\n3,4\n5,6\n", "line 1 of bad.csv was 'nan,2'"),
    "infinity in the first row": ("1,inf\n3,4\n", "line 1 of bad.csv was '1,inf'"),
    "half a row of numbers first": ("1,\n3,4\n", "line 1 of bad.csv was '1,'"),
    "NaN below a header": ("x,y\nnan,nan\n3,4\n", "line 2 of bad.csv was 'nan,nan'"),
    "an empty field": ("1,2\n,4\n", "line 2 of bad.csv was ',4'"),
    "decimal commas that part fields too": ("1,5\t2\n3,5\t4\n", "line 1 of bad.csv"),
    "thousands in quotes": ('"1,000",2\n"3,000",4\n', "line 1 of bad.csv"),
    "one long word": ("1,2\n3," + 200_000 * "4" + "x\n", "line 2 of bad.csv"),
    "words alone": ("x,y\n", "in bad.csv there was none"),
    "a typographic minus first": ("\u22121,\u22122\n1,2\n3,4\n", "line 1 of bad.csv was '\u22121,\u22122'"),
    "a typographic minus below a header": ("x;y\n\u22121;\u22122\n1;2\n", "line 2 of bad.csv"),
    "decimal commas in quotes": ('"1,5","2,5"\n1,2\n3,4\n', "line 1 of bad.csv"),
    "exponents of Fortran": ("1D0 2D0\n3 4\n5 9\n", "line 1 of bad.csv was '1D0 2D0'"),
    "units in the first row": ("1mm 2mm\n3 4\n5 9\n", "line 1 of bad.csv was '1mm 2mm'"),
    "half a row that begins like a number": (".5mm,none\n3,4\n", "line 1 of bad.csv"),
    "digits parted by a stroke": ("1_0,2\n3,4\n", "line 1 of bad.csv was '1_0,2'"),
    "nothing but units": ("3D scan\n1mm,2mm\n3mm,4mm\n", "line 2 of bad.csv was '1mm,2mm'"),
    "decimal commas in some rows": ("1,2\n1,5,2,5\n3,4\n", "line 1 of bad.csv has 2 between its commas"),
    "a comma too many in a long table": (
        "1,2\n" * 1200 + "1,5,2\n",
        "and line 1201 has 3; if commas are dec",
    ),
    "digits parted by a stroke, later": ("1,2\n3_0,4\n", "line 2 of bad.csv was '3_0,4'"),
}


@pytest.mark.parametrize("case", BAD_TABLES)
def test_tables_that_hold_no_points_name_the_line(case, tmp_path):
    text, words = BAD_TABLES[case]
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=words) as caught:
        jxr.io.read_points(path, unit="m")
    assert str(caught.value).startswith("argument path must name a table of finite numbers, but ")


@pytest.mark.parametrize(
    ("text", "expected"),
    [("1,5; 2,5\n3; 4\n", [[1.5, 2.5], [3, 4]]), ("1,5\t2,5\n3,0\t4,0\n", [[1.5, 2.5], [3, 4]])],
)
def test_decimal_commas(text, expected, tmp_path):
    path = tmp_path / "table.txt"
    path.write_text(text)
    np.testing.assert_array_equal(jxr.io.read_points(path, unit="m"), expected)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
def test_tables_in_other_encodings(encoding, tmp_path):
    path = tmp_path / "table.csv"
    path.write_bytes("Länge,Höhe\n1,2\n3,4\n".encode(encoding))
    np.testing.assert_array_equal(jxr.io.read_points(path, unit="m"), [[1, 2], [3, 4]])


def test_files_that_are_not_what_their_ending_says(tmp_path):
    """Nothing, noise, and the wrong thing, under every ending that is read."""
    noise = bytes(np.random.default_rng(0).integers(0, 256, 400, dtype=np.uint8).tobytes())
    for kind in ("csv", "txt", "dat", "npy", "svg", "dxf", "stl", "obj", "ply", "off"):
        mesh = kind in ("stl", "obj", "ply", "off")
        read = jxr.io.read_mesh if mesh else jxr.io.read_points
        path = tmp_path / f"bad.{kind}"
        for content in (None, b"", noise, b"\0" * 100, b"no such thing\n"):
            if content is not None:
                path.write_bytes(content)
            with pytest.raises(ValueError, match=r"^argument path must name a[^\n]*$"):
                read(path, unit="mm")
        path.unlink()
        path.mkdir()
        with pytest.raises(ValueError, match="argument path must name a file, but .* is a folder"):
            read(path, unit="mm")
    np.save(tmp_path / "words.npy", np.array([["a", "b"]]))
    with pytest.raises(ValueError, match="must name an array of real numbers, but words.npy has <U1"):
        jxr.io.read_points(tmp_path / "words.npy", unit="m")


@pytest.mark.parametrize(
    ("size", "unit", "fits"), [("72pt", "in", True), ("6pc", "in", True), ("72pt", "mm", False)]
)
def test_an_svg_that_states_points_and_picas(size, unit, fits, tmp_path):
    """A drawing of one unit's width, 72 pt or 6 pc: an inch."""
    path = tmp_path / "drawing.svg"
    path.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{size}" height="{size}" viewBox="0 0 1 1">'
        '<path d="M 0,0 L 1,0 L 1,1 Z"/></svg>'
    )
    if fits:
        assert jxr.io.read_points(path, unit=unit).max() == pytest.approx(0.0254)
    else:
        with pytest.raises(ValueError, match="states that one unit is 25.4 mm, but was 1 mm"):
            jxr.io.read_points(path, unit=unit)


def test_a_file_that_cannot_be_written_is_said_before_the_work(tmp_path, monkeypatch):
    """No point of the contour is evaluated."""
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setattr(jxr.Circle, "frame", lambda self, s: pytest.fail("evaluated"))
    for write, options in (
        (jxr.io.write_outline, {"unit": "mm"}),
        (jxr.io.write_stl, {"height": 0.01}),
    ):
        kind = "stl" if "height" in options else "csv"
        for path in (tmp_path / "file" / f"out.{kind}", f"/dev/null/out.{kind}"):
            with pytest.raises(ValueError, match="argument path must name a file that can be written, but '"):
                write(jxr.Circle(0.01), path, **options)


@pytest.mark.parametrize("kind", ["csv", "xyz", "npy"])
def test_a_cloud_comes_back_with_its_normals(kind, tmp_path):
    """Long tables go through another reader than short ones."""
    table = np.random.default_rng(0).normal(size=(3000, 6))
    for count in (10, 3000):
        path = tmp_path / f"cloud.{kind}"
        if kind == "npy":
            np.save(path, table[:count])
        else:
            np.savetxt(path, table[:count], delimiter="," if kind == "csv" else " ", fmt="%.17g")
        points, normals = jxr.io.read_cloud(path, unit="mm", normals=(3, 4, 5))
        np.testing.assert_array_equal(points, 1e-3 * table[:count, :3])
        np.testing.assert_array_equal(normals, table[:count, 3:])
        swapped, nothing = jxr.io.read_cloud(path, unit="m", columns=(2, 0, 5))
        np.testing.assert_array_equal(swapped, table[:count][:, [2, 0, 5]])
        assert nothing is None


def test_long_tables_that_are_not_regular_are_read_line_by_line(tmp_path):
    rows = [f"{i},{i * i},{0.5 * i}" for i in range(2000)]
    path = tmp_path / "cloud.csv"
    for head, foot, count in (("x,y,z", "", 2000), ("# x, y, z", "# end", 2000), ('"1","2","3"', "", 2001)):
        path.write_text("\n".join([head, *rows, foot]))
        assert len(jxr.io.read_cloud(path, unit="m")[0]) == count
    path.write_text("\n".join([*rows, "1,nan,2"]))
    with pytest.raises(ValueError, match="line 2001 of cloud.csv was '1,nan,2'"):
        jxr.io.read_cloud(path, unit="m")
    path.write_text("\n".join([*rows, "1,2"]))
    with pytest.raises(ValueError, match="line 2001 of cloud.csv was '1,2'"):
        jxr.io.read_cloud(path, unit="m")


def test_which_tables_are_read_at_once(monkeypatch):
    monkeypatch.setattr(_tables, "_LONG", 3)
    plain, blanks = ["1,2,3", "4,5,6", "7,8,9"], ["1 2 3", "4 5 6", "7 8 9"]
    for lines in (plain, blanks):
        np.testing.assert_array_equal(_tables._regular(lines, (2, 0)), [[3, 1], [6, 4], [9, 7]])
    others = [
        plain[:2],
        [],
        ["x,y,z", *plain],
        ["1;2;3", *plain],
        ["1,2,3 # here", *plain],
        [*plain, "1,nan,2"],
    ]
    others += [['"1",2,3', *plain], [*plain, "1,2"], ["1,2;3", *plain]]
    assert all(_tables._regular(lines, (0, 1)) is None for lines in others[:5])
    assert all(_tables._regular(lines, (0, 1, 2)) is None for lines in others[5:])


def test_an_outline_that_is_not_finite_is_named():
    points = np.array([[0.0, 1.0], [np.nan, 2.0]])
    assert _drawing.finite(points[:1], pathlib.Path("a.svg")) is not None
    with pytest.raises(ValueError, match="outline of finite points, but that of a.svg is not"):
        _drawing.finite(points, pathlib.Path("a.svg"))


def test_points_of_a_ply(tmp_path):
    path = tmp_path / "scan.ply"
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    head = f"ply\nformat ascii 1.0\nelement vertex 2\n{names}end_header\n"
    path.write_text(head + "0 0 1 0 0 1\n2 0 0 1 0 0\n")
    points, normals = jxr.io.read_cloud(path, unit="mm")
    assert points.tolist() == [[0.0, 0.0, 1e-3], [2e-3, 0.0, 0.0]]
    assert normals.tolist() == [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
    binary = np.array([(0, 0, 1, 0, 0, 1), (2, 0, 0, 1, 0, 0)], dtype=[(n, "<f4") for n in "xyzabc"])
    path.write_bytes(head.replace("ascii", "binary_little_endian").encode() + binary.tobytes())
    for one, other in zip(jxr.io.read_cloud(path, unit="mm"), (points, normals), strict=True):
        np.testing.assert_array_equal(one, other)
    path.write_text("no ply")
    with pytest.raises(ValueError, match="argument path must name a mesh, but scan.ply could not be read"):
        jxr.io.read_cloud(path, unit="mm")


def test_points_spread_over_a_mesh_lie_on_it_evenly():
    pytest.importorskip("trimesh")
    corners = np.array([[0, 0, 0], [3, 0, 0], [0, 1, 0], [0, 0, 2]]) * 0.01
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    points, normals = spread_points(corners, faces, 4000)
    np.testing.assert_array_equal(points, spread_points(corners, faces, 4000)[0])
    assert points.shape == normals.shape == (4000, 3)
    np.testing.assert_allclose(
        np.sum((points - 0.0) * normals, axis=1) * (np.abs(normals).max(axis=1) == 1), 0.0
    )
    floor = normals[:, 2] == -1.0
    areas = [np.linalg.norm(np.cross(*(corners[f[1:]] - corners[f[0]]))) for f in faces]
    assert floor.mean() == pytest.approx(areas[0] / sum(areas), abs=0.03)
    assert np.all(points[floor][:, 2] == 0.0)


@pytest.mark.parametrize("path", [3, None, b"file.csv", "a\0b.csv", ["a.csv"]])
def test_what_is_no_path_is_refused_in_one_sentence(path):
    with pytest.raises(ValueError, match="argument path must be the name of a file, but was"):
        jxr.io.read_points(path, unit="m")


def test_chords_of_an_outline_leave_the_contour_equally_far_and_are_as_many_as_they_need_be():
    """A fiftieth more than the integral of the root of curvature over eight tolerances, rounded up."""
    circle = _outline.outline(jxr.Circle(0.02), TOLERANCE)
    assert len(circle) == math.ceil(1.02 * 2.0 * np.pi * np.sqrt(0.02 / (8.0 * TOLERANCE)))
    u = np.linspace(0.0, 2.0 * np.pi, 20001)
    speed = np.hypot(0.02 * np.sin(u), 0.014 * np.cos(u))
    bend = 0.02 * 0.014 / speed**3
    points = _outline.outline(BODY, TOLERANCE)
    assert len(points) == math.ceil(1.02 * np.trapezoid(np.sqrt(bend / (8.0 * TOLERANCE)) * speed, u))
    off = off_ellipse(0.5 * (points + np.roll(points, -1, axis=0)))
    assert off.min() > 0.97 * off.max()


def test_an_outline_has_a_33rd_of_its_length_from_point_to_point_at_most():
    straight = _outline.outline(jxr.Line((-0.01, 0.03)), 1.0)
    np.testing.assert_allclose(straight[:, 1], np.linspace(-0.01, 0.03, 34), atol=1e-15)
    assert len(_outline.outline(jxr.Circle(0.02), 0.1)) == 33


def test_an_outline_that_is_found_too_far_off_is_cut_finer(monkeypatch):
    """By the root of how much too far it is, and a twentieth more."""
    found = iter([2.25, 1.0])
    monkeypatch.setattr(_outline, "_off_chords", lambda ends, middles: np.array([0.1, next(found)]))
    assert len(_outline.outline(jxr.Line((-0.01, 0.03)), 1.0)) == math.ceil(1.05 * 1.5 * 33) + 1


def test_an_outline_has_200000_points_at_most():
    """As many as there may be, and half a point more."""
    needs = lambda count: 0.02 / 8.0 * (1.02 * 2.0 * np.pi / count) ** 2  # noqa: E731
    assert len(_outline.outline(jxr.Circle(0.02), needs(199_999.5))) == 200_000
    with pytest.raises(ValueError, match="argument tolerance must need at most 200000 points"):
        _outline.outline(jxr.Circle(0.02), needs(200_000.5))


def test_a_contour_is_written_to_a_micrometre_unless_asked_otherwise(tmp_path):
    count = math.ceil(1.02 * 2.0 * np.pi * np.sqrt(0.01 / 8e-6))
    path = jxr.io.write_outline(jxr.Circle(0.01), tmp_path / "disc.csv", unit="in")
    assert len(jxr.io.read_points(path, unit="in")) == count
    assert path.read_text().splitlines()[0] == "# x [in], y [in]"
    path = jxr.io.write_stl(jxr.Circle(0.01), tmp_path / "disc.stl", height=0.003)
    vertices, faces = jxr.io.read_mesh(path, unit="mm")
    assert len(vertices) == 2 * count and set(vertices[:, 2].round(9)) == {0.0, 0.003}


def test_how_far_points_are_from_chords():
    ends = np.array([[1.0, 2.0], [4.0, 6.0], [4.0, 9.0]])
    middles = ends[:-1] + [[3.0, 0.0], [-0.5, 1.0]]
    np.testing.assert_allclose(_outline._off_chords(ends, middles), [12.0 / 5.0, 0.5], rtol=1e-15)


@pytest.mark.parametrize("wrong", [[1.0, 2.0, 3.0], [[1.0, 2.0]], [[[1.0, 2.0, 3.0]]], [[1.0, 2.0, np.inf]]])
def test_points_have_so_many_numbers_each(wrong):
    with pytest.raises(ValueError, match=r"argument points must be finite numbers of shape \(any, 3\)"):
        _outline.as_points("points", wrong, 3)
    np.testing.assert_array_equal(_outline.as_points("points", [[1, 2, 3]], 3), [[1.0, 2.0, 3.0]])


@pytest.mark.parametrize(
    ("corners", "count", "closed", "wanted"),
    [
        ([1.0, 4.0], 10, True, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]),
        ([1.0, 4.0], 5, True, [1, 2.5, 4, 5.75, 7.5, 9.25]),
        ([1.0, 1.5], 5, True, [1, 1.5, 3.4, 5.3, 7.2, 9.1]),
        ([], 4, True, [0, 2.5, 5, 7.5]),
        ([4.0], 5, False, [0, 2, 4, 6, 8, 10]),
        ([4.0, 4.2], 5, False, [0, 2, 4, 4.2, 4.2 + 5.8 / 3, 4.2 + 11.6 / 3, 10]),
        ([], 4, False, [0, 2.5, 5, 7.5, 10]),
    ],
)
def test_places_between_corners_are_evenly_spaced(corners, count, closed, wanted):
    """On an outline ten long: all corners, and as many places on each part as its share of the length."""
    np.testing.assert_allclose(filled_places(10.0, np.array(corners), count, closed=closed), wanted)


def test_a_polygon_is_filled_between_its_corners():
    """One vertex is straight and one turns by 0.1 to the right: a corner if a smaller angle is one."""
    bent = np.array([[0, 0], [1.5, 0], [4, 0], [4, -3], [4 - 3 * np.sin(0.1), -3 - 3 * np.cos(0.1)]])
    wanted = [[0, 0], [1, 0], [2, 0], [3, 0], [4, 0], [4, -1], [4, -2], [4, -3]]
    last = [bent[3] + k * (bent[4] - bent[3]) / 3 for k in (1, 2, 3)]
    found = filled_polygon(bent, 10, closed=False, sharp=0.09)
    np.testing.assert_allclose(found, [*wanted, *last], atol=1e-12)
    # Four points on four lengths, three on the six that follow: two each, on either side of the bend.
    few = filled_polygon(bent, 5, closed=False, sharp=0.11)
    ends = np.array([[0, 0], [2, 0], [4, 0], [4, -2], bent[3] + (bent[4] - bent[3]) / 3, bent[4]])
    np.testing.assert_allclose(few, ends, atol=1e-12)
    triangle = np.array([[1.0, 1.0], [1.0, 4.0], [5.0, 1.0]])
    around = filled_polygon(triangle, 12, closed=True, sharp=1.0)
    np.testing.assert_allclose(around[:4], [[1, 1], [1, 2], [1, 3], [1, 4]], atol=1e-12)
    np.testing.assert_allclose(around[[6, 8, 11]], [[3.4, 2.2], [5, 1], [2, 1]], atol=1e-12)
    # A vertex on a side is none of the corners, which stand at 0, 3 and 8 of 12.
    more = filled_polygon(np.insert(triangle, 1, [1.0, 2.2], axis=0), 5, closed=True, sharp=1.0)
    np.testing.assert_allclose(more, [[1, 1], [1, 4], [3, 2.5], [5, 1], [3, 1]], atol=1e-12)


def test_outlines_are_counted_from_the_one_with_the_longest_diagonal():
    sized = lambda x, y: np.array([[7.0, 3.0], [7.0 + x, 3.0 + y], [7.0, 3.0 + y]])  # noqa: E731
    outlines = [sized(3.0, 3.0), sized(0.1, 5.0), sized(4.0, 1.0)]
    for which, index in enumerate((1, 0, 2)):
        assert chosen(outlines, which, "outlines") is outlines[index]
    for which in (-1, 3):
        with pytest.raises(ValueError, match=f"must be below the number of outlines, 3, but was {which}"):
            chosen(outlines, which, "outlines")


BLOCK = np.array([[x, y, z] for x in (0.01, 0.04) for y in (-0.02, 0.03) for z in (0.005, 0.025)])
BLOCK_FACES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
BLOCK_FACES += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]


def test_an_oblique_section_of_a_block():
    """Where the plane cuts the block's twelve edges, in the axes that the plane is said to have."""
    origin, normal = np.array([0.02, 0.01, 0.017]), np.array([2.0, -1.0, 4.0])
    (outline,) = jxr.io.section(BLOCK, BLOCK_FACES, origin=origin, normal=normal)
    n = normal / np.linalg.norm(normal)
    u = np.array([0.0, 1.0, 0.0]) - n[1] * n
    u = u / np.linalg.norm(u)
    v = np.cross(n, u)
    arms, edges = BLOCK - origin, [(i, j) for i in range(8) for j in range(i) if (i ^ j) in (1, 2, 4)]
    cut = []
    for i, j in edges:
        low, high = arms[i] @ n, arms[j] @ n
        if low * high < 0.0:
            cut.append(arms[i] + low / (low - high) * (arms[j] - arms[i]))
    wanted = np.array([[u @ p, v @ p] for p in cut])
    near = np.linalg.norm(outline[:, None] - wanted[None], axis=2)
    assert near.min(axis=0).max() < 1e-15 and polygon_area(outline) > 0.0
    # The rest are points of the diagonals, on the sides of the same polygon.
    turn = np.argsort(np.arctan2(*(wanted - wanted.mean(axis=0)).T[::-1]))
    assert polygon_area(outline) == pytest.approx(polygon_area(wanted[turn]), rel=1e-12)


@pytest.mark.parametrize(("share", "cut"), [(0.9e-12, False), (1.1e-12, True)])
def test_what_a_plane_cuts_has_an_area_of_a_share_of_its_extents_square(share, cut):
    thin = BLOCK / np.ptp(BLOCK, axis=0) * [share, 1.0, 1.0]
    across = {"origin": (0.0, 0.0, thin[:, 2].mean()), "normal": (0.0, 0.0, 1.0)}
    if not cut:
        with pytest.raises(ValueError, match="^argument origin must "):
            jxr.io.section(thin, BLOCK_FACES, **across)
        return
    (outline,) = jxr.io.section(thin, BLOCK_FACES, **across)
    assert polygon_area(outline) == pytest.approx(share, rel=1e-3)


def test_the_larger_of_two_sections_comes_first():
    small = 0.5 * BLOCK + [0.1, 0.0, 0.0]
    both, faces = np.concatenate([small, BLOCK]), np.array(BLOCK_FACES)
    cuts = jxr.io.section(
        both, np.concatenate([faces, faces + 8]), origin=(0.0, 0.0, 0.01), normal=(0.0, 0.0, -3.0)
    )
    assert [polygon_area(cut) for cut in cuts] == pytest.approx([0.03 * 0.05, 0.015 * 0.025])


def test_vertices_in_the_plane_count_as_above_it():
    """A plane through the upper face cuts that out; one through the lower face cuts nothing."""
    (top,) = jxr.io.section(BLOCK, BLOCK_FACES, origin=(0, 0, 0.025), normal=(0, 0, 1))
    assert polygon_area(top) == pytest.approx(0.03 * 0.05)
    with pytest.raises(ValueError, match="the mesh lies from 0 to 0.02 m of it"):
        jxr.io.section(BLOCK, BLOCK_FACES, origin=(0, 0, 0.005), normal=(0, 0, 1))


@pytest.mark.parametrize(
    "faces",
    [
        [[0.0, 1.0, 2.0]],
        [0, 1, 2],
        [[0, 1, 2, 3]],
        np.zeros((0, 3), int),
        [[0, 1, -1]],
        [[0, 1, 8]],
        [[0, 1, 2], [0, 1]],
    ],
)
def test_faces_are_indices_of_three_vertices(faces):
    with pytest.raises(
        ValueError, match="argument faces must be whole numbers of shape .* from 0 to 7, but "
    ):
        jxr.io.section(BLOCK, faces, origin=(0.02, 0.0, 0.01), normal=(0, 0, 1))


@pytest.mark.parametrize("normal", [(1.0, 0.0), (0.0, 0.0, np.inf), np.eye(3), (0.0, np.nan, 1.0)])
def test_a_normal_is_one_vector_of_three_numbers(normal):
    with pytest.raises(ValueError, match="argument normal must"):
        jxr.io.section(BLOCK, BLOCK_FACES, origin=(0.02, 0.0, 0.01), normal=normal)


def test_solids_of_the_least_and_of_the_largest_height(tmp_path):
    for height in (1e-9, 1e3):
        path = jxr.io.write_stl(jxr.Circle(0.01), tmp_path / "a.stl", height=height, tolerance=1e-4)
        assert np.ptp(jxr.io.read_mesh(path, unit="mm")[0][:, 2]) == pytest.approx(height, rel=1e-6)
    for height in (0.9e-9, 1.1e3):
        with pytest.raises(ValueError, match="argument height must lie between 1e-09 and 1000 m"):
            jxr.io.write_stl(jxr.Circle(0.01), tmp_path / "a.stl", height=height, tolerance=1e-4)


def test_points_of_a_ply_are_finite_and_have_three_numbers_as_normal(tmp_path):
    path = tmp_path / "scan.ply"

    def write(names, *rows):
        lines = "".join(f"property float {name}\n" for name in names.split())
        head = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n{lines}end_header\n"
        path.write_text(head + "".join(f"{row}\n" for row in rows))

    write("x y z nx ny", "0 0 1 0 1", "2 0 0 1 0")
    points, normals = jxr.io.read_cloud(path, unit="in")
    np.testing.assert_allclose(points, [[0.0, 0.0, 0.0254], [0.0508, 0.0, 0.0]])
    assert normals is None
    write("x y z", "0 0 1", "2 nan 0")
    with pytest.raises(ValueError, match="a file of finite vertices, but scan.ply has others"):
        jxr.io.read_cloud(path, unit="in")
    with pytest.raises(ValueError, match="a file with triangles, but scan.ply has none"):
        jxr.io.read_mesh(path, unit="in")


def test_the_width_and_the_first_numbers_of_a_table(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("# made by hand\nx, y, z\n 1.5, 2 ,3 # first\n4,5\n")
    assert _tables.table_width(path) == 3 and _tables.first_numbers(path) == "1.5, 2 ,3"
    path.write_text("x y\n")
    assert _tables.table_width(path) == 0 and _tables.first_numbers(path) == ""
    arrays = tmp_path / "table.NPY"
    for array, width in ((np.zeros((2, 5)), 5), (np.zeros(4), 0), (np.zeros((2, 3, 4)), 0)):
        with arrays.open("wb") as file:
            np.save(file, array)
        assert _tables.table_width(arrays) == width
    arrays.write_text("none")
    assert _tables.table_width(arrays) == 0


def test_arrays_in_files_have_the_columns_that_are_asked_for(tmp_path):
    path = tmp_path / "table.npy"
    np.save(path, np.arange(8).reshape(2, 4))
    np.testing.assert_array_equal(jxr.io.read_points(path, unit="m", columns=(3, 1)), [[3, 1], [7, 5]])
    for array, columns in ((np.ones((2, 2)), (0, 2)), (np.ones((2, 2, 2)), (0, 1)), (np.ones(2), (0, 1))):
        np.save(path, array)
        with pytest.raises(ValueError, match="must name an array with columns"):
            jxr.io.read_points(path, unit="m", columns=columns)
    np.save(path, np.array([[1.0, 2.0], [3.0, 4.0], [np.nan, 5.0]]))
    with pytest.raises(ValueError, match=r"in table.npy row 2 was \[nan, 5.0\]"):
        jxr.io.read_points(path, unit="m")
    np.save(path, np.ones((2, 2), bool))
    with pytest.raises(ValueError, match="array of real numbers, but table.npy has bool"):
        jxr.io.read_points(path, unit="m")
    with path.open("wb") as file:
        np.savez(file, a=np.ones((2, 2)))
    with pytest.raises(ValueError, match="array of real numbers, but table.npy has several arrays"):
        jxr.io.read_points(path, unit="m")


@pytest.mark.parametrize("mark", [b"\xff\xfe", b"\xfe\xff"])
def test_tables_in_two_bytes_a_character_either_way_round(mark, tmp_path):
    path = tmp_path / "table.csv"
    path.write_bytes(mark + "1,2\n3,4\n".encode("utf-16-le" if mark[0] == 255 else "utf-16-be"))
    np.testing.assert_array_equal(jxr.io.read_points(path, unit="m"), [[1, 2], [3, 4]])
    path.write_bytes(b"1,2\0\n")
    with pytest.raises(ValueError, match="a table of numbers, but table.csv is no text"):
        jxr.io.read_points(path, unit="m")


def test_an_svg_without_a_view_box_has_pixels_of_a_96th_of_an_inch(tmp_path):
    path = tmp_path / "plain.svg"
    path.write_text(PLAIN.format(width="120mm", units=120).replace('viewBox="0 0 120 60"', ""))
    assert len(jxr.io.read_points(path, unit="px", pixel=0.0254 / 96)) == 4
    with pytest.raises(ValueError, match="one unit is 0.264583 mm, but was 1 mm"):
        jxr.io.read_points(path, unit="mm")


def test_an_svg_states_its_size_in_millimetres(tmp_path):
    path = jxr.io.write_outline(BODY, tmp_path / "body.svg", unit="in", tolerance=1e-4)
    head = path.read_text().splitlines()[0]
    size = [float(head.split(f'{name}="')[1].split('mm"')[0]) for name in (" width", " height")]
    np.testing.assert_allclose(size, [40.0 + 4.0, 28.0 + 4.0], rtol=5e-3)


def along(text, samples, fill=True):
    """Points of one SVG path, by hand without a file."""
    from svgpathtools import parse_path

    return _svg._along([_svg._Segment(curve, np.eye(3)) for curve in parse_path(text)], samples, fill)


def test_points_along_an_open_path_with_an_arc():
    """A quarter of a circle, smoothly into a straight piece, a corner, another straight piece."""
    path = "M 0,0 A 10,10 0 0 1 10,10 L 10,30 L -5,30"
    first = 5.0 * np.pi + 20.0
    points = along(path, 40)
    counts = round(40 * first / (first + 15)), round(40 * 15 / (first + 15))
    assert len(points) == sum(counts) + 1
    np.testing.assert_allclose(points[[0, counts[0], -1]], [[0, 0], [10, 30], [-5, 30]], atol=1e-9)
    s = np.arange(counts[0]) * first / counts[0]
    angle = np.minimum(s, 5.0 * np.pi) / 10.0
    wanted = [10.0 * np.sin(angle), 10.0 - 10.0 * np.cos(angle) + np.maximum(s - 5.0 * np.pi, 0.0)]
    np.testing.assert_allclose(points[: counts[0]], np.transpose(wanted), atol=2e-3)
    even_ones = along(path, 11, fill=False)
    assert len(even_ones) == 11
    np.testing.assert_allclose(even_ones[[0, 10]], [[0, 0], [-5, 30]], atol=1e-9)
    np.testing.assert_allclose(even_ones[9], [-5.0 + (first + 15) / 10, 30], atol=2e-3)


@pytest.mark.parametrize(("turn", "kind"), [(0.025, "curves"), (0.015, "curves"), (-0.025, "curves")])
def test_how_sharp_a_corner_between_curved_pieces_is(turn, kind):
    """A fiftieth of a radian; such a place is among the points, and others are where they happen to be."""
    points = along(f"M 0,0 Q 5,0 10,0 Q 15,{5 * turn} 20,{10 * turn} Q 21,{11 * turn} 22,{12 * turn}", 9)
    there = np.linalg.norm(points - [10.0, 0.0], axis=1).min() < 1e-9
    assert there == (abs(turn) > 0.02)
    outline = "M 0,0 Q 5,0 10,0 Q 10,5 10,10 Q 5,5 0,0 Z"
    assert polygon_area(along(outline, 30, fill=False)) > 0.0
    closed = along(outline, 7)
    assert all(np.linalg.norm(closed - corner, axis=1).min() < 1e-9 for corner in ((0, 0), (10, 0), (10, 10)))


@pytest.mark.parametrize(("turn", "corner"), [(1.5e-9, True), (0.7e-9, False), (-1.5e-9, True)])
def test_straight_pieces_meet_in_a_corner_however_little_they_turn(turn, corner):
    points = along(f"M 0,0 L 10,0 L 22,{12 * turn:.12g}", 9)
    assert (np.abs(points[:, 0] - 10.0).min() < 1e-12) == corner
    np.testing.assert_array_equal(along("M 0,0 L 10,0 L 22,3", 9, fill=False), [[0, 0], [10, 0], [22, 3]])


def read_shapes(path, shapes, samples=9):
    """Outlines of an SVG with these shapes, in its own unit."""
    path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg">{shapes}</svg>')
    return _svg.read_svg(path, 1e-3, samples, fill=False)


def test_pieces_of_an_svg_whose_ends_meet_are_one_outline(tmp_path):
    """Drawn in any order and either way, and each in coordinates of its own."""
    path = tmp_path / "pieces.svg"
    quarters = """<path d="M 10,0 A 10,10 0 0 1 0,10"/><path d="M -10,0 A 10,10 0 0 1 0,-10"/>
        <path d="M -10,0 A 10,10 0 0 0 0,10"/><path transform="rotate(-90)" d="M 10,0 A 10,10 0 0 1 0,10"/>"""
    (circle,) = read_shapes(path, quarters, samples=400)
    assert len(circle) == 400
    np.testing.assert_allclose(np.linalg.norm(circle, axis=1), 10.0, rtol=1e-6)
    np.testing.assert_allclose(abs(polygon_area(circle)), 100.0 * np.pi, rtol=1e-4)
    sides = """<line x1="0" y1="0" x2="4" y2="0"/><line x1="4" y1="3" x2="4" y2="0"/>
        <g transform="translate(0 3)"><polyline points="0,-3 0,0 4,0.000001"/></g>"""
    (box,) = read_shapes(path, sides)
    assert len(box) == 4 and abs(abs(polygon_area(box)) - 12.0) < 1e-5
    # An open chain, of which the second piece comes first.
    (chain,) = read_shapes(path, '<path d="M 4,0 L 4,3"/><path d="M 0,0 L 4,0"/>')
    assert sorted(map(tuple, chain[[0, -1]].tolist())) == [(0.0, 0.0), (4.0, -3.0)] and len(chain) == 3


def test_ends_of_an_svg_that_do_not_meet_by_twos_are_left_apart(tmp_path):
    path = tmp_path / "apart.svg"
    star = '<path d="M 0,0 L 4,0"/><path d="M 0,0 L 0,4"/><path d="M 0,0 L -4,-4"/>'
    assert len(read_shapes(path, star)) == 3
    assert len(read_shapes(path, '<path d="M 0,0 L 4,0"/><path d="M 4,0.0001 L 0,4"/>')) == 2
    ring = '<circle r="2"/><path d="M 2,0 L 9,0"/><path d="M 0,0 L 0,1 L 1,1 Z"/>'
    assert len(read_shapes(path, ring)) == 3


def test_closed_pieces_of_an_svg_that_begin_at_one_place_stay_apart(tmp_path):
    path = tmp_path / "washer.svg"
    twice = '<circle r="5"/><circle r="5"/>'
    for body, areas in ((twice, [25.0, 25.0]), (f'{twice}<circle cx="5" r="10"/>', [100.0, 25.0, 25.0])):
        path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-20 -20 40 40">{body}</svg>')
        read = [jxr.io.read_points(path, unit="m", which=i, samples=2000) for i in range(len(areas))]
        found = [abs(float(polygon_area(outline))) / np.pi for outline in read]
        np.testing.assert_allclose(found, areas, rtol=1e-5)


@pytest.mark.parametrize("fill", [False, True])
@pytest.mark.parametrize("kind", ["svg", "dxf"])
def test_a_line_from_a_point_to_itself_is_no_outline(kind, fill, tmp_path):
    path = tmp_path / f"dot.{kind}"
    if kind == "svg":
        body = '<path d="M9 9 L9 9"/><path d="M8 9 C8 9 8 9 8 9"/><circle cx="9" r="0"/><circle r="5"/>'
        path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-10 -10 20 20">{body}</svg>')
    else:
        import ezdxf

        drawing = ezdxf.new()
        drawing.modelspace().add_line((9, 9), (9, 9))
        drawing.modelspace().add_lwpolyline([(8, 9), (8, 9)])
        drawing.modelspace().add_circle((0, 0), 5)
        drawing.saveas(path)
    points = jxr.io.read_points(path, unit="m", fill=fill, samples=12)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 5.0, rtol=1e-6)
    with pytest.raises(ValueError, match=r"which must be below the number of outlines in dot\.\w+, 1, but"):
        jxr.io.read_points(path, unit="m", fill=fill, which=1)


@pytest.mark.parametrize("kind", ["svg", "dxf"])
def test_a_corner_that_is_written_twice_is_one(kind, tmp_path):
    path, corners = tmp_path / f"triangle.{kind}", [(0, 0), (10, 0), (10, 0), (10, 10), (0, 0)]
    if kind == "svg":
        text = " ".join(f"{x},{-y}" for x, y in corners)
        body = f'<polygon points="{text}"/>'
        path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 20 20">{body}</svg>')
    else:
        import ezdxf

        drawing = ezdxf.new()
        drawing.modelspace().add_lwpolyline(corners, close=True)
        drawing.saveas(path)
    assert jxr.io.read_points(path, unit="m").tolist() == [[0, 0], [10, 0], [10, 10]]
    filled = jxr.io.read_points(path, unit="m", fill=True, samples=9)
    assert abs(float(polygon_area(filled)) - 50.0) < 1e-12


@pytest.mark.parametrize(("turn", "corner"), [(0.12, True), (0.09, False)])
def test_a_line_meets_an_arc_of_a_dxf_in_a_corner(turn, corner, tmp_path):
    """Of which a polygon along the arc has many, but of less than a tenth of a radian."""
    import ezdxf

    drawing = ezdxf.new(units=ezdxf.units.MM)
    drawing.modelspace().add_arc((0, 0), 10, -90, 0)
    drawing.modelspace().add_line((10, 0), (10 - 12 * np.sin(turn), 12 * np.cos(turn)))
    drawing.saveas(tmp_path / "bent.dxf")
    points = 1e3 * jxr.io.read_points(tmp_path / "bent.dxf", unit="mm", fill=True, samples=9)
    assert (np.linalg.norm(points - [10.0, 0.0], axis=1).min() < 1e-5) == corner
    on_arc = points[points[:, 1] < 0.0]
    np.testing.assert_allclose(np.linalg.norm(on_arc, axis=1), 10.0, atol=1e-7 * np.hypot(10.0, 22.0))


@pytest.mark.parametrize(("gap", "corners"), [(0.7e-6, 4), (1.5e-6, 5)])
def test_ends_of_a_dxf_meet_within_a_millionth_of_the_drawing(gap, corners, tmp_path):
    """Four sides of 30 by 40, the last of which ends short of the first one's start by a share of 50."""
    import ezdxf

    drawing = ezdxf.new(units=ezdxf.units.MM)
    ends = [(0, 0), (30, 0), (30, 40), (0, 40), (0, 50 * gap)]
    for start, end in zip(ends, ends[1:], strict=False):
        drawing.modelspace().add_line(start, end)
    drawing.saveas(tmp_path / "box.dxf")
    assert len(jxr.io.read_points(tmp_path / "box.dxf", unit="mm")) == corners
    drawing.modelspace().delete_all_entities()
    drawing.modelspace().add_lwpolyline(ends)  # one piece, closed already or not
    drawing.saveas(tmp_path / "box.dxf")
    assert len(jxr.io.read_points(tmp_path / "box.dxf", unit="mm")) == corners


# A cube's corners, and the four of each side from outside.
CORNERS = [(i & 1, i >> 1 & 1, i >> 2) for i in range(8)]
SIDES = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]


def _cube(form, between="", corners=CORNERS):
    """A cube as OBJ: how it names a corner's vertex, place in the texture and normal, and a word half way."""
    rows = [*(f"v {x} {y} {z}" for x, y, z in corners), "vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    rows += ["vn 0 0 -1", "vn 0 0 1", "vn 0 -1 0", "vn 0 1 0", "vn -1 0 0", "vn 1 0 0"]
    for k, side in enumerate(SIDES):
        rows += [between] if k == 3 else []
        rows.append("f " + " ".join(form.format(v + 1, t + 1, k + 1) for t, v in enumerate(side)))
    return "\n".join(["usemtl red", *rows]) + "\n"


@pytest.mark.parametrize("between", ["", "usemtl blue", "o other"])
@pytest.mark.parametrize("form", ["{0}", "{0}//{2}", "{0}/{1}", "{0}/{1}/{2}"])
def test_materials_textures_and_normals_leave_a_mesh_closed(form, between, tmp_path):
    pytest.importorskip("trimesh")
    path = tmp_path / "cube.obj"
    path.write_text(_cube(form, between))
    vertices, faces = jxr.io.read_mesh(path, unit="mm")
    assert vertices.shape == (8, 3) and faces.shape == (12, 3)
    (outline,) = jxr.io.section(vertices, faces, origin=(0, 0, 4e-4), normal=(0, 0, 1))
    assert polygon_area(outline) == pytest.approx(1e-6)
    assert float(mass_properties((vertices, faces), 1.0).mass) == pytest.approx(1e-9)


def test_all_solids_of_an_stl_are_read(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    boxes = [trimesh.creation.box((2, 2, 2)), trimesh.creation.box((2, 2, 2)).apply_translation((9, 0, 0))]
    path = tmp_path / "two.stl"
    path.write_text("\n".join(trimesh.exchange.stl.export_stl_ascii(box) for box in boxes))
    vertices, faces = jxr.io.read_mesh(path, unit="m")
    assert vertices.shape == (16, 3) and len(faces) == 24
    assert np.ptp(vertices, axis=0).tolist() == [11.0, 2.0, 2.0]


def test_a_mesh_with_a_vertex_that_is_no_number_is_refused(tmp_path):
    pytest.importorskip("trimesh")
    path = tmp_path / "cube.obj"
    path.write_text(_cube("{0}", corners=[*CORNERS[:7], (1, "nan", 1)]))
    with pytest.raises(ValueError, match="a file of finite vertices, but cube.obj has others"):
        jxr.io.read_mesh(path, unit="mm")


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_vertices_are_alike_within_a_share_of_a_meshs_extent(size, tmp_path):
    """Whatever the unit: fine meshes in metres keep their vertices."""
    pytest.importorskip("trimesh")
    path = tmp_path / "cube.obj"
    path.write_text(_cube("{0}", corners=[(size * x, size * y, size * z) for x, y, z in CORNERS]))
    vertices, _ = jxr.io.read_mesh(path, unit="m")
    np.testing.assert_allclose(np.sort(vertices.ravel()), np.sort(size * np.ravel(CORNERS)), rtol=1e-12)


def test_the_unit_at_the_head_of_a_table_must_agree(tmp_path):
    """As `write_outline` writes it; of other columns, and in remarks without it, nothing is asked."""
    path = jxr.io.write_outline(jxr.Circle(0.01), tmp_path / "disc.csv", unit="um", tolerance=1e-5)
    assert np.abs(jxr.io.read_points(path, unit="um")).max() == pytest.approx(0.01)
    with pytest.raises(
        ValueError, match="argument unit must agree with disc.csv, whose head states 'um', but"
    ):
        jxr.io.read_points(path, unit="mm")
    path.write_text("a scan in [mm]\nt [s];x [cm];y [cm];z [in]\n0;1;2;3\n1;4;5;7\n")
    np.testing.assert_allclose(jxr.io.read_points(path, unit="cm", columns=(1, 2))[1], [0.04, 0.05])
    with pytest.raises(
        ValueError, match="argument unit must agree with disc.csv, whose head states 'in', but"
    ):
        jxr.io.read_cloud(path, unit="cm", columns=(1, 2, 3))
    path.write_text("# all in [mm] but for x\n1,2\n3,4\n# x [m], y [m]\n")
    np.testing.assert_allclose(jxr.io.read_points(path, unit="um")[1], [3e-6, 4e-6])
    np.save(tmp_path / "disc.npy", [[1.0, 2.0]])
    assert jxr.io.read_points(tmp_path / "disc.npy", unit="um").tolist() == [[1e-6, 2e-6]]
