"""Outlines from colour photographs, and from drawings with arcs and corners, to contours."""

import io

import numpy as np
import pytest
from PIL import Image

import jaxroll as jxr

SIDE = 300
CENTRE, RADIUS = (150.5, 140.5), 110.0


def photograph(colour, back, quality):
    """A disc in a colour that falls to six tenths across it, on a background with a gradient, as JPEG."""
    fine = 3
    y, x = (np.mgrid[0 : SIDE * fine, 0 : SIDE * fine] + 0.5) / fine - 0.5
    inside = np.hypot(x - CENTRE[0], y - CENTRE[1]) < RADIUS
    light = 1.0 - 0.4 * (x + y) / (2.0 * SIDE)
    slope = 40.0 * np.stack([x, y, 0.5 * x], axis=-1) / SIDE
    seen = np.where(inside[..., None], light[..., None] * np.array(colour), np.array(back) + slope)
    seen = seen.reshape(SIDE, fine, SIDE, fine, 3).mean(axis=(1, 3))
    seen = seen + 3.0 * np.random.default_rng(0).normal(size=seen.shape)
    file = io.BytesIO()
    Image.fromarray(np.clip(seen, 0, 255).astype(np.uint8)).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file))


@pytest.mark.parametrize("quality", [95, 80])
@pytest.mark.parametrize("colours", [((200, 60, 40), (60, 120, 70)), ((40, 35, 50), (150, 160, 170))])
def test_a_shaded_disc_in_a_photograph(colours, quality):
    points = jxr.io.read_silhouette(photograph(*colours, quality), pixel=1e-4)
    centre = np.array([CENTRE[0], SIDE - 1.0 - CENTRE[1]])
    error = np.linalg.norm(points / 1e-4 - centre, axis=1) - RADIUS
    assert np.abs(error).max() < 1.0 and abs(error.mean()) < 0.3
    report = jxr.fit_contour(points, smallest_radius=5e-3).report
    assert report.radius >= 5e-3 and report.largest < 1e-4


def test_a_background_of_second_degree_is_no_part_of_a_shape():
    """It changes along rows, columns and both by more than the shape stands out from it."""
    y, x = np.mgrid[0:121, 0:121] / 60.0 - 1.0
    back = np.stack([90.0 + 60.0 * x * y, 100.0 + 50.0 * x - 40.0 * y * y, 120.0 + 45.0 * y], axis=-1)
    inside = np.hypot(60.0 * x - 7.0, 60.0 * y) < 35.0
    points = jxr.io.read_silhouette(back + 30.0 * inside[..., None], pixel=1.0)
    error = np.linalg.norm(points - [67.0, 60.0], axis=1) - 35.0
    assert np.abs(error).max() < 1.0 and abs(error.mean()) < 0.3


def test_images_that_show_nothing_are_refused():
    for image in (np.zeros((50, 50, 3)), np.random.default_rng(0).normal(size=(60, 60, 3))):
        with pytest.raises(ValueError, match="argument image must show a shape whose colour differs"):
            jxr.io.read_silhouette(image, pixel=1e-4)


def test_a_transparent_image_is_cut_by_its_opacity():
    y, x = np.mgrid[0:81, 0:81]
    image = np.full((81, 81, 4), 90.0)
    image[..., 3] = np.clip(10.0 * (25.0 - np.hypot(x - 40, y - 40)) + 127.5, 0.0, 255.0)
    points = jxr.io.read_silhouette(image, pixel=1.0)
    np.testing.assert_allclose(np.linalg.norm(points - 40.0, axis=1), 25.0, atol=0.02)


SVG = """<svg xmlns="http://www.w3.org/2000/svg" width="60mm" height="60mm" viewBox="0 0 60 60">
<path d="M 0,0 L 40,0 A 10,10 0 0 1 40,20 L 0,20 Z"/></svg>"""


@pytest.mark.parametrize("kind", ["svg", "dxf"])
def test_a_drawing_with_arcs_and_corners(kind, tmp_path):
    """A plate with a round end: two corners are rounded, two jumps of the curvature are named."""
    path = tmp_path / f"plate.{kind}"
    if kind == "svg":
        path.write_text(SVG)
    else:
        import ezdxf

        drawing = ezdxf.new(units=ezdxf.units.MM)
        space = drawing.modelspace()
        for line in (((0, 0), (40, 0)), ((40, 20), (0, 20)), ((0, 20), (0, 0))):
            space.add_line(*line)
        space.add_arc((40, 10), 10, 270, 90)
        drawing.saveas(path)
    points = jxr.io.read_points(path, unit="mm", fill=True)
    assert 390 < len(points) < 410
    for corner in ((0.0, 0.0), (0.0, 0.02)):
        assert np.linalg.norm(np.abs(points) - corner, axis=1).min() < 1e-12
    report = jxr.fit_contour(points, smallest_radius=2e-3).report
    assert report.radius >= 2e-3 and report.largest == pytest.approx((2**0.5 - 1) * 2e-3, rel=0.1)
    corners = [jump for jump in report.jumps if jump.angle]
    arcs = [jump for jump in report.jumps if not jump.angle]
    assert len(corners) == 2 and len(arcs) == 2 and len(report.rounded) == 2
    np.testing.assert_allclose([jump.angle for jump in corners], np.pi / 2, atol=1e-6)
    for jump in arcs:
        assert abs(jump.place[0] - 0.04) < 5e-4
        np.testing.assert_allclose(sorted((jump.before, jump.after)), [0.0, 100.0], atol=0.1)
    assert "2 corners, of up to 90 degrees" in " ".join(report.warnings)


def test_points_along_straight_sides(tmp_path):
    import ezdxf

    drawing = ezdxf.new(units=ezdxf.units.MM)
    drawing.modelspace().add_lwpolyline([(0, 0), (30, 0), (30, 10), (0, 10)], close=True)
    drawing.saveas(tmp_path / "box.dxf")
    points = 1e3 * jxr.io.read_points(tmp_path / "box.dxf", unit="mm", fill=True, samples=80)
    assert len(points) == 80
    np.testing.assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), 1.0, atol=1e-9)
    assert len(jxr.io.read_points(tmp_path / "box.dxf", unit="mm")) == 4
    with pytest.raises(ValueError, match="argument fill must be True or False"):
        jxr.io.read_points(tmp_path / "box.dxf", unit="mm", fill=1)
