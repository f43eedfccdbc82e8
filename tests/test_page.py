"""The page for a browser: it runs in one, shows the bodies, and moves them."""

import html
import json
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from jaxroll import plotting
from jaxroll.plotting import _page
from jaxroll.plotting._forces3 import Pushes
from jaxroll.plotting._page import write_page
from jaxroll.plotting._page_parts import controls, page_times
from jaxroll.plotting._page_plane import plane_figure
from jaxroll.plotting._scene3 import scene3
from jaxroll.plotting._style import LOCUS_OBJECT, LOCUS_TIP, OBJECT_BODY, TIP_BODY
from tests.recorded import runs
from tests.subjects import stand_in_grasp

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FRAMES = 9
# Notes where one vertex of the object is as the page opens, in the last frame, in the first, and in the last.
PROBE = """
<script>
const errors = [];
window.addEventListener("error", (e) => errors.push(e.message));
window.addEventListener("unhandledrejection", (e) => errors.push(String(e.reason)));
window.addEventListener("load", () => setTimeout(async () => {
  const plot = document.querySelector(".plotly-graph-div");
  const show = {mode: "immediate", frame: {duration: 0, redraw: true}, transition: {duration: 0}};
  const vertex = () => ["x", "y", "z"].map((axis) => plot._fullData[0][axis][7]);
  const found = {frames: plot._transitionData._frames.length, opened: vertex()};
  await Plotly.animate(plot, [String(found.frames - 1)], show);
  found.last = vertex();
  await Plotly.animate(plot, ["0"], show);
  found.first = vertex();
  await Plotly.animate(plot, [String(found.frames - 1)], show);
  found.again = vertex();
  found.canvases = document.querySelectorAll("canvas").length;
  found.errors = errors;
  const note = document.createElement("pre");
  note.id = "probe";
  note.style.display = "none";
  note.textContent = JSON.stringify(found);
  document.body.appendChild(note);
}, 1000));
</script>
"""


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The page of the stand-in."""
    pytest.importorskip("plotly")
    folder = tmp_path_factory.mktemp("page")
    return write_page(
        *stand_in_grasp.stand_in(), folder / "sub" / "grasp.html", title="A test", frames=FRAMES
    )


def browse(path, folder, budget):
    """What a browser makes of a file: its DOM, a screenshot, and what it says."""
    shot = folder / "shot.png"
    flags = (
        "--headless --no-sandbox --disable-dev-shm-usage --use-gl=angle --use-angle=swiftshader "
        "--enable-unsafe-swiftshader --disable-background-networking --disable-component-update "
        "--disable-sync --no-first-run --hide-scrollbars --enable-logging=stderr --dump-dom"
    )
    done = subprocess.run(
        [
            BROWSER,
            *flags.split(),
            f"--user-data-dir={folder / 'profile'}",
            "--window-size=1000,800",
            f"--virtual-time-budget={budget}",
            f"--screenshot={shot}",
            path.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=180,
        check=True,
    )
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    with Image.open(shot) as image:
        return done.stdout, np.asarray(image.convert("RGB")) / 255.0, console


@pytest.fixture(scope="module")
def browsed(written, tmp_path_factory):
    """The page in a browser, asked what it shows."""
    if BROWSER is None:
        pytest.skip("no browser on PATH")
    folder = tmp_path_factory.mktemp("browser")
    probed = folder / "probed.html"
    probed.write_text(written.read_text().replace("</head>", PROBE + "</head>", 1))
    # A browser's clock may run out before a busy machine has drawn all frames; what the page holds is fixed.
    for attempt in range(3):
        dom, shot, console = browse(probed, folder, budget=20000 * 4**attempt)
        note = re.search(r'<pre id="probe"[^>]*>(.*?)</pre>', dom)
        if note:
            break
    assert note, f"the page's scripts did not run to their end: {console}"
    return json.loads(html.unescape(note[1])), shot, console


def test_a_page_is_one_small_file_that_needs_no_network(written):
    text = written.read_text()
    assert 3e6 < written.stat().st_size < 1e7
    assert not re.search(r"<(script|link)[^>]+(src|href)=", text)
    assert "A test" in text


def test_a_page_runs_without_errors(browsed):
    found, _, console = browsed
    assert found["errors"] == [] and found["canvases"] >= 1 and 0.5 * FRAMES < found["frames"] <= FRAMES
    assert not [line for line in console if "Uncaught" in line or "ERROR" in line or "WARN" in line]


def test_the_slider_moves_the_bodies(browsed):
    found, _, _ = browsed
    grasp, motion, _ = stand_in_grasp.stand_in()
    body = scene3(grasp, motion, rows=18, columns=36).solids[0]
    np.testing.assert_allclose(found["last"], body.at(60)[7], atol=1e-3)
    np.testing.assert_allclose(found["first"], body.at(0)[7], atol=1e-3)
    np.testing.assert_allclose(found["again"], found["last"])
    np.testing.assert_allclose(found["opened"], found["first"])


def near(shot, colour, *, tone):
    """How many pixels have a colour, or with `tone` any shade of it."""
    wanted, seen = np.array(to_rgb(colour)), shot
    if tone:
        bright = shot.max(axis=-1, keepdims=True)
        seen, wanted = np.where(bright > 0.3, shot / np.maximum(bright, 0.3), 0.0), wanted / wanted.max()
    return int((np.abs(seen - wanted).max(axis=-1) < 0.05).sum())


def test_a_page_shows_the_bodies_and_the_loci(browsed):
    _, shot, _ = browsed
    assert len(np.unique(np.round(255 * shot).reshape(-1, 3), axis=0)) > 500
    drawing = shot[:, 330:]  # beside the legend
    assert near(drawing, OBJECT_BODY, tone=True) > 2000 and near(drawing, TIP_BODY, tone=True) > 800
    assert near(drawing, LOCUS_OBJECT, tone=False) > 30 and near(drawing, LOCUS_TIP, tone=False) > 15


def test_the_slider_and_stop_act_at_once_and_play_takes_its_time():
    """Durations in milliseconds, as plotly's `Plotly.animate` takes them: none is nothing to wait for."""
    made = controls(np.array([0.0, 0.5, 1.0]))
    (menu,), (slider,) = made["updatemenus"], made["sliders"]
    play, stop = (button["args"] for button in menu["buttons"])
    assert play[0] is None and play[1]["frame"]["duration"] >= 20
    assert [step["args"][0] for step in slider["steps"]] == [["0"], ["1"], ["2"]]
    assert [step["label"] for step in slider["steps"]] == ["0", "0.5", "1"] and slider["active"] == 0
    for name, how in (stop, *(step["args"] for step in slider["steps"])):
        assert len(name) == 1 and how["mode"] == "immediate"
        assert how["frame"]["duration"] == how["transition"]["duration"] == 0


def test_the_slider_stands_at_round_times():
    for end, frames, step in ((10.0, 40, 0.5), (0.6, 40, 0.02), (3.0, 7, 0.5)):
        ts = np.linspace(0.0, end, 1201)
        shown = ts[page_times(ts, frames)]
        np.testing.assert_allclose(shown[:-1], step * np.arange(len(shown) - 1), atol=end / 2400)
        assert shown[-1] == end and 0.4 * frames < len(shown) <= frames
    assert list(page_times(ts, 1)) == [0] and list(page_times(ts[:1], 9)) == [0]


def test_a_page_of_the_plane_moves_what_moves(tmp_path):
    """The frames' outlines are the object's true contour where the run has it."""
    plotly = pytest.importorskip("plotly.graph_objects")
    grasp, run = runs.scene("pinch")[0], runs.run("pinch")
    rows = np.array([0, 3, 12])
    figure = plane_figure(plotly, grasp, run, rows, title="A test")
    assert len(figure.frames) == 3 and {len(frame.data) for frame in figure.frames} == {len(figure.data)}
    # One block, in which a legend of several lines cannot meet the title.
    assert figure.layout.legend.title.text == "A test" and figure.layout.title.text is None
    names = [trace.name for trace in figure.data]
    body, points = names.index("object"), names.index("contact points")
    for row, frame in zip(rows, figure.frames, strict=True):
        x, y, angle = np.asarray(run.states.q)[row, :3]
        outline = np.stack([frame.data[body].x, frame.data[body].y], axis=-1)[:-1]
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        own = (outline / 1e3 - (x, y)) @ turn
        half = 0.5 * np.ptp(own, axis=0)
        np.testing.assert_allclose(own.max(axis=0) - half, own.min(axis=0) + half, atol=1e-6)
        if row == 0:
            first = own
        np.testing.assert_allclose(own, first, atol=1e-6)
        for point in zip(frame.data[points].x, frame.data[points].y, strict=True):
            assert np.min(np.hypot(*(outline - point).T)) < 3.0  # millimetres, between two drawn corners
    assert "1 N as" in names[-1] and figure.data[-1].x[0] == figure.frames[0].data[-1].x[0]
    path = plotting.page(grasp, run, tmp_path / "plane.html")
    assert path.stat().st_size > 3e6


def test_a_page_in_space_shows_the_force_of_loads_where_it_acts():
    grasp, motion, _ = stand_in_grasp.stand_in(5)
    scene = scene3(grasp, motion, rows=6, columns=8)
    contacts, load, at = np.ones((2, 5, 3)), np.full((5, 3), 2.0), np.full((5, 3), 7.0)
    alone = _page._moving(scene, 3, Pushes(contacts))[-1]
    loaded = _page._moving(scene, 3, Pushes(contacts, load, at))[-1]
    for axis in "xyz":  # each arrow has six points: it begins at the first and ends at the second
        assert len(alone[axis]) == 12 and len(loaded[axis]) == 18
        np.testing.assert_array_equal(loaded[axis][12:14], [5.0, 7.0])
    names = [_page._still(scene, Pushes(contacts, *more))[-1]["name"] for more in ((), (load, at))]
    assert names[0].startswith("contact force on") and names[1].startswith("force on")


def test_a_page_without_plotly_says_what_to_install(monkeypatch, tmp_path):
    for name in [name for name in sys.modules if name.split(".")[0] == "plotly"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "plotly", None)
    with pytest.raises(ImportError, match=r"pip install \"jaxroll\[viz\]\""):
        write_page(*stand_in_grasp.stand_in(5), tmp_path / "grasp.html")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"path": "grasp.gif"}, "end in .html"),
        ({"frames": 0}, "argument frames must be a whole number of at least 1, but was 0"),
        ({"ts": np.zeros(3)}, "argument ts must have shape"),
    ],
)
def test_bad_arguments_of_a_page(change, words):
    pytest.importorskip("plotly")
    grasp, motion, ts = stand_in_grasp.stand_in(5)
    with pytest.raises(ValueError, match=words):
        write_page(grasp, motion, **({"ts": ts, "path": "grasp.html"} | change))
