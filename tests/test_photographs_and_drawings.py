"""Outlines from colour photographs, and from drawings with arcs and corners, to contours."""

import io
import math
import re

import numpy as np
import pytest
from PIL import Image
from scipy.interpolate import BSpline
from scipy.spatial import KDTree

import jaxroll as jxr
from jaxroll._cli._shape_file import read, ShapeOrder
from jaxroll.geometry import polygon_area
from jaxroll.io import _image

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


def soft_disc(width, top=1.0):
    """Grey values of a disc of 60 pixels on black; its edge rises from a tenth to nine over 4.4 widths."""
    y, x = np.mgrid[:200, :220]
    return top / (1.0 + np.exp(np.clip((np.hypot(x - 105, y - 98) - 60.0) / width, -300.0, 300.0)))


def radius(points):
    return np.sqrt(polygon_area(points) / np.pi)


@pytest.mark.parametrize(("width", "off"), [(0.05, 0.1), (0.3, 0.1), (1.0, 0.1), (2.0, 0.3), (4.0, 2.0)])
def test_a_disc_on_a_clean_background(width, off):
    """Black or white, as numbers of 8 bits, as these after JPEG, and as fractions."""
    disc = soft_disc(width)
    for grey in (disc, 1.0 - disc):
        eight = Image.fromarray((255 * grey).astype(np.uint8)).convert("RGB")
        file = io.BytesIO()
        eight.save(file, "JPEG", quality=75)
        for image in (np.asarray(eight), np.asarray(Image.open(file)), np.stack([grey] * 3, axis=-1)):
            assert radius(jxr.io.read_silhouette(image, pixel=1.0)) == pytest.approx(60.0, abs=off)


def test_a_shape_with_a_dark_part_on_black():
    """A quarter of it is three tenths as bright as the rest."""
    disc = soft_disc(0.5) * np.where(np.arange(220) < 81, 0.3, 1.0)
    points = jxr.io.read_silhouette(np.stack([disc] * 3, axis=-1), pixel=1.0)
    assert np.ptp(points[:, 0]) == pytest.approx(120.0, abs=1.5)


def test_an_opaque_border_leaves_a_shape_to_its_colours():
    image = np.full((200, 220, 4), 255.0)
    image[..., :3] -= soft_disc(0.3, 200.0)[..., None]
    image[:5, :5, 3], image[100, 100, 3] = 0.0, 254.0
    assert radius(jxr.io.read_silhouette(image, pixel=1.0)) == pytest.approx(60.0, abs=0.1)


def cut_out(mode):
    image = np.full((200, 220, 4), 90, np.uint8)
    image[..., 3] = soft_disc(0.3, 255.0)
    return Image.fromarray(image).convert(mode)


# Photographs as files of many kinds, each of the same disc.
PICTURES = {
    "16 bits.png": lambda: Image.fromarray(soft_disc(1.0, 65535.0).astype(np.uint16)),
    "16 bits and dim.png": lambda: Image.fromarray(soft_disc(1.0, 300.0).astype(np.uint16)),
    "32 bits.tif": lambda: Image.fromarray(soft_disc(1.0, 1e6).astype(np.int32)),
    "fractions.tif": lambda: Image.fromarray(soft_disc(1.0).astype(np.float32)),
    "black and white.png": lambda: Image.fromarray(soft_disc(1.0) > 0.5),
    "a palette.png": lambda: Image.fromarray(soft_disc(1.0, 200.0).astype(np.uint8)).convert("P"),
    "cut out.png": lambda: cut_out("RGBA"),
    "cut out of grey.png": lambda: cut_out("LA"),
}


@pytest.mark.parametrize("name", PICTURES)
def test_photographs_of_every_kind_are_read_as_they_are(name, tmp_path):
    PICTURES[name]().save(tmp_path / name)
    order = ShapeOrder(str(tmp_path / name), "mm", None, pixel=1.0, section=None)
    assert radius(read(order).points) == pytest.approx(60.0, abs=0.15)


@pytest.mark.parametrize("turned", range(1, 9))
@pytest.mark.parametrize("kind", ["png", "jpg", "tif"])
def test_a_photograph_is_read_as_it_is_shown(kind, turned, tmp_path):
    """An L, however the camera was held that took it: its corner is at the lower left."""
    y, x = np.mgrid[0:120, 0:200]
    shown = np.where((x > 30) & (y < 90) & (y > 20) & (x < 170) & ((x < 60) | (y > 60)), 20, 230)
    # How what is shown is stored, for each way in which EXIF has it turned back.
    stored = [shown, shown[:, ::-1], shown[::-1, ::-1], shown[::-1], shown.T]
    stored += [np.rot90(shown), shown[::-1, ::-1].T, np.rot90(shown, -1)]
    exif = Image.Exif()
    exif[0x0112] = turned
    path = tmp_path / f"shape.{kind}"
    Image.fromarray(stored[turned - 1].astype(np.uint8)).convert("RGB").save(path, exif=exif)
    points = read(ShapeOrder(str(path), "mm", None, pixel=1.0, section=None)).points
    assert np.ptp(points, axis=0).tolist() == pytest.approx([139.0, 69.0], abs=0.5)
    assert points.min(axis=0).tolist() == pytest.approx([30.5, 29.5], abs=0.3)
    assert float(polygon_area(points)) == pytest.approx(139 * 29 + 29 * 40, rel=0.02)


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


@pytest.mark.parametrize(
    ("shape", "width"), [((30, 40), 1), ((99, 300), 1), ((300, 100), 2), ((160, 155), 3)]
)
def test_the_border_of_an_image_is_a_fiftieth_of_its_shorter_side(shape, width):
    rim = _image._border((*shape, 3))
    assert rim.shape == shape and rim[:width].all() and rim[:, -width:].all()
    assert rim[-width:].all() and rim[:, :width].all() and not rim[width:-width, width:-width].any()


def test_a_background_is_found_though_a_shape_is_across_its_border():
    """Exactly, where it is of second degree: pixels of a shape that is elsewhere lose their say."""
    y, x = np.meshgrid(np.linspace(-1, 1, 60), np.linspace(-1, 1, 80), indexing="ij")
    back = np.stack([3.0 + x - 2.0 * y, 1.0 + x * y + 0.5 * x * x, 2.0 - 0.7 * y * y], axis=-1)
    seen = back.copy()
    seen[20:40, :25] += [40.0, -30.0, 20.0]
    np.testing.assert_allclose(_image._background(seen), back, atol=1e-9)


def test_colours_are_smoothed_by_seven_tenths_of_a_pixel():
    """One bright pixel on a black image: what is left of it in its place, in all colours together."""
    image = np.zeros((41, 51, 3))
    image[20, 25] = [30.0, 60.0, 60.0]
    found, _ = _image._from_background(image)
    weights = np.exp(-(np.arange(-3, 4) ** 2) / (2.0 * 0.7**2))
    middle = 1.0 / weights.sum()
    assert found.max() == found[20, 25] == pytest.approx(90.0 * middle**2, rel=1e-6)
    assert found[20, 26] == pytest.approx(90.0 * middle**2 * weights[2], rel=1e-6)


@pytest.mark.parametrize("back", [(0, 0, 0), (255, 255, 255)])
def test_a_shape_is_seen_before_a_background_of_one_colour(back):
    """Of a picture that was drawn, not taken, the border does not differ from itself at all."""
    y, x = np.mgrid[0:81, 0:91]
    inside = np.hypot(x - 44, y - 38) < 25.0
    points = jxr.io.read_silhouette(np.where(inside[..., None], (200, 60, 40), back), pixel=1.0)
    error = np.linalg.norm(points - [44.0, 42.0], axis=1) - 25.0
    assert np.abs(error).max() < 0.7 and abs(error.mean()) < 0.3


@pytest.mark.parametrize(("ahead", "level"), [(100, 50.0), (85, 50.0), (75, 25.0), (35, 25.0)])
def test_a_shape_begins_at_half_of_what_four_fifths_of_it_exceed(monkeypatch, ahead, level):
    """Of a shape of which so many of 100 rows are twice as far from the background as the others."""
    image = np.ones((200, 140, 3)) / np.sqrt(3.0)
    image[50:150, 20:120] *= 50.0
    image[50 : 50 + ahead, 20:120] *= 2.0
    monkeypatch.setattr(_image, "_background", np.zeros_like)
    monkeypatch.setattr(_image, "_BLUR", 1e-3)
    assert _image._from_background(image)[1] == pytest.approx(level)


@pytest.mark.parametrize(("apart", "seen"), [(4.2, True), (3.8, False)])
def test_a_shape_is_four_times_as_far_from_the_background_as_the_border(monkeypatch, apart, seen):
    image = np.ones((60, 60, 3)) / np.sqrt(3.0)
    image[15:45, 15:45] *= apart
    monkeypatch.setattr(_image, "_background", np.zeros_like)
    monkeypatch.setattr(_image, "_BLUR", 1e-3)
    if seen:
        assert _image._from_background(image)[1] == pytest.approx(0.5 * apart)
        return
    with pytest.raises(ValueError, match="along the border there is one of 1$"):
        _image._from_background(image)


def test_outlines_of_images_are_counted_by_their_area():
    """Whether bright or dark; the image's last row is at the bottom, and outlines run counter-clockwise."""
    grey = np.zeros((50, 80))
    grey[5:9, 10:70] = 1.0
    grey[20:45, 30:50] = 1.0
    for image in (grey, 1.0 - grey):
        first, second = (jxr.io.read_silhouette(image, pixel=2.0, threshold=0.5, which=k) for k in (0, 1))
        np.testing.assert_allclose([first.min(axis=0), first.max(axis=0)], [[59, 9], [99, 59]])
        np.testing.assert_allclose([second.min(axis=0), second.max(axis=0)], [[19, 81], [139, 89]])
        for points in (first, second):
            assert jxr.geometry.polygon_area(points) > 0.0 and np.any(points[0] != points[-1])


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((5, 5, 5)),
        np.zeros((5, 5, 1)),
        np.zeros((1, 5)),
        np.zeros((5, 5, 3, 2)),
        np.full((5, 5), "a"),
        np.zeros((5, 5), complex),
    ],
)
def test_images_are_grey_or_in_colour(image):
    with pytest.raises(ValueError, match="argument image must be grey values of shape"):
        jxr.io.read_silhouette(image, pixel=1.0)


def drawing(tmp_path, content, attributes=""):
    """An SVG with this content, as a path."""
    path = tmp_path / "drawing.svg"
    names = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    path.write_text(f"<svg {names} {attributes}>{content}</svg>")
    return path


MATRICES = {
    "scale(1,-1)": [[1, 0], [0, -1]],
    "scale(-1,1)": [[-1, 0], [0, 1]],
    "matrix(1 0 0.5463 1 0 0)": [[1, 0.5463], [0, 1]],
    "scale(2,1)": [[2, 0], [0, 1]],
    "scale(3,-1) matrix(1 0.2 0.4 1 0 0)": [[3, 1.2], [-0.2, -1]],
}


@pytest.mark.parametrize("transform", MATRICES)
def test_a_tilted_arc_is_mirrored_stretched_and_sheared_as_its_points_are(transform, tmp_path):
    """Mapped back, the points lie on the ellipse that was drawn, or on the two straight pieces."""
    track = '<path d="M 0 0 A 10 5 30 0 1 15 5 L 3 8 Z" {}/>'
    plain = jxr.io.read_points(drawing(tmp_path, track.format("")), unit="mm", samples=2000)
    path = drawing(tmp_path, f'<g transform="{transform}">{track.format("")}</g>')
    matrix = np.array(MATRICES[transform], float)
    for fill in (False, True):
        points = 1e3 * jxr.io.read_points(path, unit="mm", samples=300, fill=fill) * [1.0, -1.0]
        back = np.linalg.solve(matrix, points.T).T
        away = np.linalg.norm(back[:, None] - 1e3 * plain * [1.0, -1.0], axis=2).min(axis=1)
        assert away.max() < 0.02
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        assert steps.max() < 1.02 * steps.mean()
    sheared = abs(polygon_area(points)) / abs(np.linalg.det(matrix))
    assert sheared == pytest.approx(1e6 * abs(polygon_area(plain)), rel=1e-3)
    assert sheared == pytest.approx(79.172, rel=1e-3)


SMALL = '<rect width="4" height="3"/>'


def big(attributes=""):
    return f'<rect width="100" height="100" {attributes}/>'


# What an SVG shows besides a rectangle of 4 by 3, and the box of the largest outline: left, bottom, right,
# top.
SHOWN = {
    "a use": (
        '<defs><rect id="a" width="10" height="5"/></defs><use xlink:href="#a" x="1" y="2"/>',
        (1, -7, 11, -2),
    ),
    "a use of a group": (
        '<g transform="translate(1,0)"><use href="#g" transform="scale(2)"/></g>'
        '<defs><g id="g"><rect width="10" height="5"/></g></defs>',
        (1, -10, 21, 0),
    ),
    "a symbol with a size": (
        '<symbol id="s" viewBox="0 0 10 10"><rect width="10" height="5"/></symbol>'
        '<use href="#s" x="1" y="2" width="20" height="40"/>',
        (1, -22, 21, -12),
    ),
    "a drawing within": ('<svg x="5" y="1"><rect width="10" height="5"/></svg>', (5, -6, 15, -1)),
    "a stretched drawing within": (
        '<svg x="5" width="20" height="40" viewBox="0 0 10 10" preserveAspectRatio="none">'
        '<rect width="10" height="5"/></svg>',
        (5, -20, 25, 0),
    ),
    "a covering drawing within": (
        '<svg width="20" height="40" viewBox="10 0 10 10" preserveAspectRatio="xMaxYMin slice">'
        '<rect x="10" width="10" height="5"/></svg>',
        (-20, -20, 20, 0),
    ),
    "a link": ('<a><rect width="9" height="9"/></a>', (0, -9, 9, 0)),
    "an attribute that hides": (big('display="none"'), (0, -3, 4, 0)),
    "a style that hides": (f'<g style="fill:red; display: none">{big()}</g>', (0, -3, 4, 0)),
    "a sheet that hides": (
        "<style>/* off */ .a, .b {fill:red;display:none} #c{display:none}</style>"
        + big('class="x b"')
        + big('id="c"'),
        (0, -3, 4, 0),
    ),
    "a part made visible": (
        f'<g visibility="hidden">{big()}<rect visibility="visible" width="9" height="9"/></g>',
        (0, -9, 9, 0),
    ),
    "what is pressed flat": (big('transform="scale(1,0)"'), (0, -3, 4, 0)),
    "a symbol within a group": (
        f'<g id="g" transform="scale(3)"><symbol>{big()}</symbol></g><use href="#g"/>',
        (0, -3, 4, 0),
    ),
    "words in a place of their own": ('<text style="transform: scale(2)">none</text>', (0, -3, 4, 0)),
    "what is only defined": (
        f"<defs>{big()}</defs><symbol>{big()}</symbol>",
        (0, -3, 4, 0),
    ),
    "radii beyond half the sides": ('<rect width="40" height="10" rx="900"/>', (0, -10, 40, 0)),
    "a frame without paint": (big('fill="none"'), (0, -3, 4, 0)),
    "a frame in a group without paint": (f'<g style="fill: none">{big()}</g>', (0, -3, 4, 0)),
    "a frame of a class without paint": ("<style>.a {fill:none}</style>" + big('class="a"'), (0, -3, 4, 0)),
    "a frame that paints at no strength": (
        big('fill-opacity="0"') + big('opacity="0.0"') + big('fill="none" stroke="red" stroke-width="0px"'),
        (0, -3, 4, 0),
    ),
    "frames in colours that are seen through": (
        big('fill="rgba(9, 9, 9, 0)"')
        + big('style="fill: #12f0"')
        + big('fill="rgb(9 9 9 / 0.0%)"')
        # Three numbers, of which none is an opacity.
        + '<rect width="9" height="9" fill="rgb(9,9,0)"/>',
        (0, -9, 9, 0),
    ),
    "words in capitals": (
        big('style="Display: NONE"') + big('fill="None"') + big('visibility="Hidden"'),
        (0, -3, 4, 0),
    ),
    "a line around nothing": (big('fill="none" stroke="red"'), (0, -100, 100, 0)),
    "a line that a group gives": (f'<g stroke="red" fill="none">{big()}</g>', (0, -100, 100, 0)),
    "paint that is taken over": (
        "<g stroke='red'>" + big('fill="none" stroke="inherit"') + "</g>",
        (0, -100, 100, 0),
    ),
    "paint of a rule for others": (
        "<style>g > .a {stroke: red}</style>" + big('fill="none"'),
        (0, -100, 100, 0),
    ),
    "the last of two rules": (
        "<style>.a {display: none} .b {display: inline}</style>" + big('class="b a"'),
        (0, -100, 100, 0),
    ),
    "a switch": (
        f'<switch><g systemLanguage="tlh">{big()}</g><rect width="9" height="9"/>{big()}</switch>',
        (0, -9, 9, 0),
    ),
    "an origin of no transform": (big('style="transform-origin: center"'), (0, -100, 100, 0)),
    "an origin of a displacement": (
        '<rect width="9" height="9" transform="translate(1 0)" transform-origin="3 3"/>',
        (1, -9, 10, 0),
    ),
    "numbers that signs and points keep apart": (
        '<rect width="9" height="8" transform="translate(1-2)scale(2.5.5)"/>',
        (1, -2, 23.5, 2),
    ),
    "a radius of zero": ('<rect width="40" height="10" rx="0" ry="3"/>', (0, -10, 40, 0)),
}


def test_a_drawing_without_any_paint_is_one_of_bare_outlines(tmp_path):
    content = SMALL + "<style>rect {fill: none}</style>"
    assert jxr.io.read_points(drawing(tmp_path, content), unit="mm").shape == (4, 2)


@pytest.mark.parametrize("case", SHOWN)
def test_what_an_svg_shows_is_read_and_what_it_hides_is_not(case, tmp_path):
    content, box = SHOWN[case]
    points = 1e3 * jxr.io.read_points(drawing(tmp_path, SMALL + content), unit="mm")
    np.testing.assert_allclose([*points.min(axis=0), *points.max(axis=0)], box, atol=1e-9)


# Clip paths: two squares side by side, and one stated in shares; a class for the first.
SHEET = """<style>.cut, .other {clip-path: url('#near')} g .a {fill: red} circle {display: none}</style>
<clipPath id="near"><rect width="10" height="10"/><rect width="10" height="10" transform="translate(10 0)"/>
</clipPath><clipPath id="shares" clipPathUnits="objectBoundingBox"><rect width="1" height="1"/></clipPath>
<circle r="50"/>"""


@pytest.mark.parametrize(
    "content",
    [
        '<rect width="20" height="10" class="cut"/>',
        '<rect width="15" height="9.5" class="cut"/>',
        '<rect width="6" height="3" transform="scale(3)" class="cut"/>',
        '<g class="cut" transform="translate(2 5)"><path d="M 1 1 L 15 1 A 4 4 0 0 1 15 9 Z"/></g>',
        '<rect width="90" height="90" class="cut" style="clip-path: none"/>',
        '<circle r="80" style="display: inline"/>',
        '<clipPath id="hole"><path d="M 0 0 H 99 V 99 H 0 Z M 40 40 V 60 H 60 V 40 Z"/></clipPath>'
        '<rect width="39" height="99" clip-path="url(#hole)"/>',
    ],
)
def test_a_clip_path_that_cuts_nothing_off_changes_nothing(content, tmp_path):
    """The outline is the same where its clip is taken away."""
    path = drawing(tmp_path, SHEET + content)
    points = jxr.io.read_points(path, unit="mm")
    alone = re.sub(r'class="cut"|clip-path=".*?"', "", content.split("</clipPath>")[-1])
    np.testing.assert_array_equal(points, jxr.io.read_points(drawing(tmp_path, alone), unit="mm"))


# What an SVG holds that cannot be read, with words of the reason.
UNREAD = {
    '<clipPath id="hole"><path d="M 0 0 H 99 V 99 H 0 Z M 40 40 V 60 H 60 V 40 Z"/></clipPath>'
    '<rect x="45" y="45" width="9" height="9" clip-path="url(#hole)"/>': "cut off by a clip path",
    "<text>none</text>": "argument path must name a drawing with an outline, but drawing.svg has none",
    '<use href="#b"/>': "what a use or a clip refers to, '#b', is not in the file",
    f'<g clip-path="url(#b)">{SMALL}</g>': "what a use or a clip refers to, '#b', is not in the file",
    f'<g clip-path="circle(50%)">{SMALL}</g>': "what a use or a clip refers to, 'circle(50%)', is not",
    f'{SHEET}<g style="clip-path: url(#near)"><rect width="9" height="30"/></g>': "is cut off by a clip path",
    f'{SHEET}<rect class="cut" width="30" height="9"/>': "an outline is cut off by a clip path",
    f'{SHEET}<g class="cut"><rect transform="scale(3)" width="8" height="3"/></g>': "cut off by a clip path",
    f'{SHEET}<rect width="4" height="3" clip-path="url(#shares)"/>': "#shares clips in shares of what",
    '<rect width="4" height="3" mask="url(#b)"/>': "a rect has a mask",
    f"<style>g .a {{display: none}}</style>{SMALL}": "rule for g .a is not for one class, name or kind",
    '<style>rect {transform: scale(2)}</style><rect width="4" height="3"/>': "a rect stands in its style",
    '<g id="a"><use href="#a"/></g>': "a use of #a stands within what it refers to",
    '<rect width="4" height="3" transform="scale(2) turn(3)"/>': "invalid SVG transform",
    '<rect width="4" height="3" transform="scale(2)" transform-origin="5 5"/>': "rect has the origin '5 5'",
    '<rect width="4" height="3" style="transform: scale(2)"/>': "the transform of a rect stands in its style",
    '<rect width="4" height="3" style="rotate: 30deg"/>': "the rotate of a rect stands in its style",
    "<style>.b {scale: 2}</style><g class='b'><rect width='4' height='3'/></g>": "scale of a g stands in its",
    '<circle cx="4" cy="3" r="2" style="r: 5px"/>': "the r of a circle stands in its style",
    "<style>rect {width: 9px}</style><rect width='4' height='3'/>": "the width of a rect stands in its style",
    '<circle cx="4" cy="3" r="-2"/>': "a circle has the r -2",
    '<rect width="-4" height="3"/>': "a rect has the width -4",
    '<circle cx="4" cy="3"/>': "a shape of kind circle has no r",
    '<ellipse rx="4"/>': "a shape of kind ellipse has no ry",
    f'<svg viewBox="0 0 9 9" width="9">{SMALL}</svg>': "a svg with a viewBox has no height",
    f'<svg viewBox="0 0 0 9" width="9" height="9">{SMALL}</svg>': "within it has no positive, finite size",
}


@pytest.mark.parametrize("content", UNREAD)
def test_an_svg_that_cannot_be_understood_is_refused(content, tmp_path):
    with pytest.raises(ValueError, match=r"^argument path must name a drawing") as error:
        jxr.io.read_points(drawing(tmp_path, content), unit="mm")
    assert UNREAD[content] in str(error.value)


# How an SVG states its size, and the millimetres in one unit that follow.
SIZES = {
    'width="30MM" viewBox="0 0 10 10"': "3 mm",
    'width="120Q" viewBox="0 0 10 10"': "3 mm",
    'height="30mm" viewBox="0 0 5 10"': "3 mm",
    'width="100%" height="30mm" viewBox="0 0 5 10"': "3 mm",
    'width="60mm" height="30mm" viewBox="0 0 10 10"': "3 mm",
    'width="30mm" height="5mm" viewBox="0 0 10 10" preserveAspectRatio="xMidYMid slice"': "3 mm",
    'height="30mm"': "0.264583 mm",
}


@pytest.mark.parametrize("attributes", SIZES)
def test_a_unit_is_compared_however_an_svg_states_it(attributes, tmp_path):
    with pytest.raises(ValueError, match=f"states that one unit is {SIZES[attributes]}, but was 25.4 mm"):
        jxr.io.read_points(drawing(tmp_path, SMALL, attributes), unit="in")


@pytest.mark.parametrize(
    "attributes",
    [
        'width="0mm" viewBox="0 0 10 10"',
        'height="0mm"',
        'width="20mm" viewBox="0 0 inf 20"',
        'width="20mm" viewBox="0 0 0 20"',
        'width="nanmm" viewBox="0 0 20 20"',
        'width="-20mm" viewBox="0 0 20 20"',
    ],
)
def test_an_svg_without_a_size_is_refused(attributes, tmp_path):
    words = (
        "^argument path must name a drawing of a positive, finite size, but drawing.svg has (width|height) '"
    )
    with pytest.raises(ValueError, match=words):
        jxr.io.read_points(drawing(tmp_path, SMALL, attributes), unit="mm")


def test_an_svg_that_is_stretched_is_refused(tmp_path):
    path = drawing(tmp_path, SMALL, 'width="9mm" height="18mm" viewBox="0 0 9 9" preserveAspectRatio="none"')
    with pytest.raises(ValueError, match="stretched: one unit is 1 mm along x and 2 mm along y"):
        jxr.io.read_points(path, unit="mm")


def test_blocks_and_layers_of_a_dxf(tmp_path):
    """Of blocks within blocks each part is in its place; what is frozen, off or invisible is not there."""
    import ezdxf
    from ezdxf.xclip import XClip

    drawing = ezdxf.new(units=ezdxf.units.MM)
    for name in ("frozen", "off", "shown"):
        drawing.layers.add(name)
    drawing.layers.get("frozen").freeze()
    drawing.layers.get("off").off()
    inner, outer = drawing.blocks.new("inner"), drawing.blocks.new("outer")
    inner.add_circle((1, 0), 2)
    inner.add_circle((0, 0), 50, dxfattribs={"layer": "off"})
    outer.add_blockref("inner", (10, 0), dxfattribs={"xscale": 2, "yscale": -1, "rotation": 90})
    space = drawing.modelspace()
    space.add_lwpolyline([(0, 0), (1, 0), (1, 1), (0, 1)], close=True)
    space.add_blockref("outer", (100, 30), dxfattribs={"layer": "shown"})
    for layer in ("frozen", "off"):
        space.add_circle((0, 0), 60, dxfattribs={"layer": layer})
        space.add_blockref("outer", (0, 0), dxfattribs={"layer": layer})
    space.add_circle((0, 0), 70, dxfattribs={"invisible": 1})
    grid = space.add_blockref("inner", (0, 200))
    grid.dxf.column_count, grid.dxf.column_spacing = 3, 20
    drawing.saveas(tmp_path / "blocks.dxf")
    boxes = []
    for which in range(5):
        points = 1e3 * jxr.io.read_points(tmp_path / "blocks.dxf", unit="mm", which=which)
        boxes.append([*points.min(axis=0), *points.max(axis=0)])
    # An ellipse of 2 by 4 about (110, 32), three circles in a row, and the square.
    expected = [[108, 28, 112, 36], *([20 * i - 1, 198, 20 * i + 3, 202] for i in range(3)), [0, 0, 1, 1]]
    np.testing.assert_allclose(sorted(boxes), sorted(expected), atol=1e-3)
    XClip(grid).set_block_clipping_path([(0, 0), (1, 1)])
    drawing.saveas(tmp_path / "clipped.dxf")
    with pytest.raises(ValueError, match="clipped.dxf could not be read: \"block 'inner' is clipped\""):
        jxr.io.read_points(tmp_path / "clipped.dxf", unit="mm")
    XClip(grid).disable_clipping()
    drawing.saveas(tmp_path / "clipped.dxf")
    np.testing.assert_array_equal(
        jxr.io.read_points(tmp_path / "clipped.dxf", unit="mm"),
        jxr.io.read_points(tmp_path / "blocks.dxf", unit="mm"),
    )
    with pytest.raises(ValueError, match="below the number of outlines in blocks.dxf, 5, but was 5"):
        jxr.io.read_points(tmp_path / "blocks.dxf", unit="mm", which=5)


# Paths whose largest piece has the same four corners.
PIECES = [
    "M 0 0 h 10 v 10 h -10 z M 0 0 h -30 v -30 h 30 z",
    "M 0 0 h 10 v 10 h -10 z m 0 0 h -30 v -30 h 30 z",
    "M 0 0 h 10 v 10 h -10 z h -30 v -30 h 30 z",
    "M 0 0 h 10 v 10 h -10 v -10 M 0 0 h -30 v -30 h 30 z",
    "m 1 1 m -1 -1 h 10 v 10 h -10 z m 1 1 z m -1 -1 h -30 v -30 h 30 z",
    "M 0 0 H -30 M -30 0 V -30 M -30 -30 H 0 M 0 -30 V 0",
    "M 0 0 H -30 M -30 0 V -30 M -30 -30 L 0 -30",
]


@pytest.mark.parametrize("text", PIECES)
def test_a_closed_piece_of_a_path_ends_where_it_is_closed(text, tmp_path):
    points = 1e3 * jxr.io.read_points(drawing(tmp_path, f'<path d="{text}"/>'), unit="mm")
    assert points.shape == (4, 2)
    np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], [[-30, 0], [0, 30]], atol=1e-12)


@pytest.mark.parametrize(
    "text, words",
    [("M 0 0 L 9 0 L NaN 9 z", "a path holds 'N'"), ("M 0 0 A 5 5 0 0 1 0 0 L 9 0 L 9 9 Z", "ends where it")],
)
def test_a_path_that_cannot_be_understood_is_refused(text, words, tmp_path):
    with pytest.raises(ValueError, match=words):
        jxr.io.read_points(drawing(tmp_path, f'<path d="{text}"/>'), unit="mm")


@pytest.fixture
def modelspace(tmp_path):
    """An empty DXF in millimetres, and what reads the points [mm] of its largest outline."""
    ezdxf = pytest.importorskip("ezdxf")
    dxf = ezdxf.new("R2010", units=4)

    def points(samples=400):
        dxf.saveas(tmp_path / "drawing.dxf")
        return 1e3 * jxr.io.read_points(tmp_path / "drawing.dxf", unit="mm", samples=samples)

    return dxf.modelspace(), points


def _spline(space):
    """A circle of 10 mm as a rational spline of second degree."""
    places = [(10, 0), (10, 10), (0, 10), (-10, 10), (-10, 0), (-10, -10), (0, -10), (10, -10), (10, 0)]
    weights, knots = [1.0, 0.5**0.5] * 4 + [1.0], [0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4]
    space.add_rational_spline(places, weights=weights, degree=2, knots=knots)


CIRCLES = {
    "circle": lambda space: space.add_circle((0, 0), 10),
    "ellipse": lambda space: space.add_ellipse((0, 0), (10, 0), 1.0),
    "bulges": lambda space: space.add_lwpolyline([(-10, 0, 1), (10, 0, 1)], format="xyb", close=True),
    "spline": _spline,
}


@pytest.mark.parametrize("kind", CIRCLES)
def test_curves_of_a_dxf_are_followed_within_a_ten_millionth_of_its_size(kind, modelspace):
    space, points = modelspace
    CIRCLES[kind](space)
    assert np.abs(np.hypot(*points(4000).T) - 10.0).max() < 1e-7 * np.hypot(20.0, 20.0)


@pytest.mark.parametrize("degree", [2, 3, 4])
@pytest.mark.parametrize("weights", [None, (1.0, 2.0, 0.5, 3.0, 1.0)])
def test_a_spline_of_a_dxf_ends_where_its_knots_say(degree, weights, modelspace):
    """A closed one whose knots do not repeat at its ends, as programs write it; by SciPy's splines."""
    space, points = modelspace
    corners = np.array([(10, 0, 0), (10, 10, 0), (0, 10, 0), (-3, 2, 0), (4, -5, 0)], float)
    places, knots = np.concatenate([corners, corners[:degree]]), 0.5 * np.arange(2 * degree + 6) - 7.0
    spline = space.add_spline()
    spline.dxf.degree, spline.control_points, spline.knots = degree, places, knots
    heavy = np.ones(5) if weights is None else np.array(weights)
    if weights is not None:
        spline.weights = [*weights, *weights[:degree]]
    found = points(4000)
    heavy = np.append(heavy, heavy[:degree])
    whole = BSpline(knots, np.column_stack([places[:, :2] * heavy[:, None], heavy]), degree)
    curve = whole(np.linspace(knots[degree], knots[len(places)], 100_001))
    curve = curve[:, :2] / curve[:, 2:]
    assert max(KDTree(curve).query(found)[0].max(), KDTree(found).query(curve)[0].max()) < 0.01
    np.testing.assert_allclose(abs(polygon_area(found)), polygon_area(curve), rtol=1e-5)


def test_a_closed_spline_of_a_dxf_has_control_points_or_ends_where_it_begins(modelspace):
    """Through points alone it would be read as open: how a program closes it is not in the file."""
    space, points = modelspace
    places = [(10, 0), (10, 10), (0, 10), (-3, 2)]
    spline = space.add_spline(places)
    assert len(points()) == 400
    spline.closed = True
    with pytest.raises(ValueError, match="a closed spline has no control points"):
        points()
    spline.fit_points = [(x, y, 0) for x, y in [*places, places[0]]]
    found = points()
    assert np.linalg.norm(found[0] - found[-1]) < 2.0 * np.linalg.norm(found[0] - found[1])


def test_a_spline_of_a_dxf_may_go_through_a_point_twice_in_a_row(modelspace):
    """The second time counts for nothing, and a spline through no other point shows nothing."""
    space, points = modelspace
    places = [(10, 0), (10, 10), (0, 10), (-3, 2)]
    spline = space.add_spline(places)
    once = points()
    spline.fit_points = [place for place in places for _ in range(2)]
    np.testing.assert_array_equal(points(), once)
    for nothing in (places[:1] * 2, []):
        space.add_spline(nothing or places).fit_points = nothing
    np.testing.assert_array_equal(points(), once)


def test_the_frame_of_a_fitted_polyline_is_no_part_of_it(modelspace):
    """A curve through points at 4 mm from (5, 5), and the square from which a program made it."""
    space, points = modelspace
    line = space.add_polyline2d([], dxfattribs={"flags": 1 | 4})
    line.append_vertices([(0, 0), (10, 0), (10, 10), (0, 10)], dxfattribs={"flags": 16})
    turns = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    curve = [(5.0 + 4.0 * np.cos(turn), 5.0 + 4.0 * np.sin(turn)) for turn in turns]
    line.append_vertices(curve, dxfattribs={"flags": 8})
    np.testing.assert_allclose(points(), curve, atol=1e-9)


def test_meshes_in_a_dxf_are_no_outlines(modelspace):
    space, points = modelspace
    space.add_lwpolyline([(0, 0), (5, 0), (5, 5)], close=True)
    space.add_polyface().append_faces([[(0, 0, 0), (9, 0, 0), (9, 9, 0), (0, 9, 9)]])
    space.add_polymesh((3, 3))
    assert points().shape == (3, 2)


@pytest.mark.parametrize("across", [(1, 0, 0), (0.6, 0, 0.8)])
def test_a_dxf_out_of_the_plane_is_refused(across, modelspace):
    space, points = modelspace
    space.add_circle((0, 0, 7), 10)
    space.add_circle((0, 0, 7), 5, dxfattribs={"extrusion": (0, 0, -1)})
    assert len(points()) == 400
    space.add_circle((0, 0), 5, dxfattribs={"extrusion": across})
    words = "a drawing in the plane of x and y, but an outline of drawing.dxf rises by .* along z"
    with pytest.raises(ValueError, match=words):
        points()


def test_a_photograph_that_is_too_large_is_refused_in_a_sentence(tmp_path, monkeypatch):
    Image.new("L", (100, 100)).save(tmp_path / "large.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1000)
    order = ShapeOrder(str(tmp_path / "large.png"), "mm", None, pixel=1.0, section=None)
    with pytest.raises(ValueError, match="a photograph, but large.png could not be read: Image size"):
        read(order)


# Images of two grey values, or of two and noise, where a disc of 60 pixels is and where it is not.
MASKS = {
    "true and false": lambda inside: inside,
    "dark on bright": lambda inside: ~inside,
    "bytes": lambda inside: np.where(inside, 255, 0).astype(np.uint8),
    "two greys": lambda inside: np.where(inside, 20, 230),
    "fractions": lambda inside: np.where(inside, 0.7, -0.1),
    "noise": lambda inside: inside + 0.05 * np.random.default_rng(0).normal(size=inside.shape),
}


@pytest.mark.parametrize("kind", MASKS)
def test_the_outline_of_a_mask_runs_midway_between_pixels(kind):
    y, x = np.mgrid[0:200, 0:220]
    image = MASKS[kind](np.hypot(x - 110.3, y - 99.6) < 60.0)
    points = jxr.io.read_silhouette(image, pixel=1.0)
    assert math.sqrt(polygon_area(points) / math.pi) == pytest.approx(60.0, abs=0.05)


def test_a_shape_is_parted_midway_between_both_means_where_that_parts_it_as_otsu_does():
    cases = {(0, 0, 0, 4): 2.0, (0, 0, 2, 9, 9, 9): 29 / 6, (0, 6, 90): 46.5, (0, 50, 51, 52): 25.5}
    for values, level in cases.items():
        assert _image._parting(np.array([values], float)) == pytest.approx(level)
    assert _image._parting(np.full((2, 2), 3.0)) == 3.0


def test_the_threshold_of_a_photograph_is_otsus_own():
    """Where pixels have values on either side of it; midway in a gap that none is in."""
    ramp = np.add.outer(np.arange(64.0), np.arange(192.0))
    assert _image._parting(ramp) == _image._otsu(ramp)
    assert _image._parting(np.where(ramp > 127.0, 200.0, 20.0)) == pytest.approx(110.0)
