"""Maps over two parameters: which numbers stand where, what their axes say, and what a page holds of them."""

import itertools
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxroll as jxr
from jaxroll.plotting import _map_figure, parameter_map
from jaxroll.plotting._map_data import _logarithmic, map_data, MapData, Side
from jaxroll.plotting._map_page import _layout, _trace

GRID = jxr.Parameters.grid(
    a=[3.0, 1.0, 2.0], fixed=[7.0], b=[10.0, 20.0], c=[0.1, 0.2, 0.4, 0.5], d=[5.0, 6.0, 8.0]
).with_units(a="mm", c="N")


def height(a, b, c, d):
    """A number that tells all four apart."""
    return a + 100.0 * b + 1e4 * c + 1e6 * d


EVEN = {
    "a factor of three": ([1.0, 3.0, 9.0, 27.0], True),
    "a factor, in any order and more than once": ([9.0, 1.0, 3.0, 3.0], True),
    # Of the logarithm's step, a millionth for each of the steps.
    "but for rounding": ([1.0, 3.0 * (1.0 + 0.8e-6), 9.0], True),
    "a factor that is off": ([1.0, 3.0 * (1.0 + 1.4e-6), 9.0], False),
    "a small factor that is off": ([1.0, 1.01, 1.01**2 * (1.0 + 1e-7)], False),
    "one step": ([1.0, 2.0, 3.0], False),
    "neither": ([1.0, 2.0, 5.0], False),
    "two values": ([1.0, 10.0], False),
    "from zero": ([0.0, 1.0, 10.0], False),
    "of both signs": ([-1.0, 1.0, 10.0], False),
    "hardly apart": (1.0 + 1e-9 * np.arange(4.0), False),
}


@pytest.mark.parametrize("case", EVEN)
def test_an_axis_is_logarithmic_where_its_values_are_apart_by_one_factor(case):
    values, expected = EVEN[case]
    assert _logarithmic(np.array(values), gridded=True) is expected


def test_samples_are_logarithmic_where_their_logarithms_are_even_over_more_than_a_factor_of_two():
    u = np.linspace(0.0, 1.0, 101)
    assert _logarithmic(10.0**u, gridded=False) is True
    assert _logarithmic(2.1**u, gridded=False) is True and _logarithmic(1.9**u, gridded=False) is False
    assert _logarithmic(1.0 + 9.0 * u, gridded=False) is False
    # The median, 4, is nearer to the middle of 1 and 9 than its logarithm to that of theirs, or not.
    assert _logarithmic(np.array([1.0, 4.5, 9.0]), gridded=False) is False
    assert _logarithmic(np.array([1.0, 3.5, 9.0]), gridded=False) is True
    assert _logarithmic(np.array([0.0, 3.5, 9.0]), gridded=False) is False
    assert _logarithmic(1e3 * np.array([2.0, 7.5, 20.0]), gridded=False) is True
    assert _logarithmic(1e3 * np.array([2.0, 9.0, 20.0]), gridded=False) is False
    # Twice the least of them, which is not one.
    assert _logarithmic(1e3 * 1.9**u, gridded=False) is False
    assert _logarithmic(np.array([1.0, 1.45, 2.05]), gridded=False) is True


def test_a_map_shows_the_first_two_that_change_and_holds_the_others_in_the_middle():
    """Values of a side rise, in whatever order the grid has them."""
    data = map_data(GRID, height(GRID.a, GRID.b, GRID.c, GRID.d))
    assert data.x.values.tolist() == [1.0, 2.0, 3.0] and data.y.values.tolist() == [10.0, 20.0]
    assert (data.x.label, data.y.label, data.gridded, data.codes) == ("a [mm]", "b", True, ())
    x, y = np.meshgrid([1.0, 2.0, 3.0], [10.0, 20.0])
    np.testing.assert_allclose(data.z, height(x, y, 0.4, 6.0), rtol=1e-14)
    assert data.held == "c = 0.4 N, d = 6"


def test_sides_of_a_map_lie_along_two_axes_of_a_grid_where_one_axis_has_several_names():
    both = jxr.Parameters(a=[1.0, 2.0, 4.0], d=[9.0, 8.0, 7.0]) * jxr.Parameters(b=[1.0, 3.0])
    data = map_data(both, both.a + both.b)
    assert (data.x.label, data.y.label, data.gridded) == ("a", "b", True)
    assert map_data(both, both.a, y="a").x.label == "b"


@pytest.mark.parametrize("number", [np.float32(0.2), np.int64(0), jnp.asarray(0.2), np.array(0.2), 0.2, 0])
def test_a_parameter_is_held_at_a_number_of_any_library(number):
    data = map_data(GRID, height(GRID.a, GRID.b, GRID.c, GRID.d), at={"c": number})
    assert data.held == f"c = {0.2 if float(number) else 0.1:g} N, d = 6"
    for bad in (np.array([0.2]), np.nan, True, "0.2", np.float32(np.inf), 1j):
        with pytest.raises(ValueError, match="argument at must hold parameters that are no side"):
            map_data(GRID, GRID.a, at={"c": bad})


@pytest.mark.parametrize(
    ("x", "y", "sides"),
    [("b", None, "ba"), (None, "a", "ba"), (None, "d", "ad"), ("d", "c", "dc"), ("c", None, "ca")],
)
def test_a_map_has_the_sides_that_are_asked_for(x, y, sides):
    """Of a grid with values in its own shape; elsewhere it is cut at the nearest value."""
    values = height(GRID.a, GRID.b, GRID.c, GRID.d).reshape(GRID.shape)
    held = {"a": 2.0, "b": 20.0, "c": 0.2, "d": 8.0}
    asked = {"a": 1.8, "b": 1e3, "c": 0.29, "d": 7.1}
    at = {name: asked[name] for name in asked if name not in sides}
    data = map_data(GRID, values, x=x, y=y, at=at)
    along = {name: np.unique(GRID[name]) for name in held}
    right, up = np.meshgrid(along[sides[0]], along[sides[1]])
    np.testing.assert_array_equal(data.x.values, along[sides[0]])
    np.testing.assert_array_equal(data.y.values, along[sides[1]])
    np.testing.assert_allclose(data.z, height(**held | {sides[0]: right, sides[1]: up}), rtol=1e-14)
    units = {"a": " mm", "b": "", "c": " N", "d": ""}
    assert data.held == ", ".join(f"{n} = {held[n]:g}{units[n]}" for n in held if n not in sides)


def test_what_has_several_numbers_to_a_row_is_no_side_of_a_map():
    some = jxr.Parameters.grid(place=[[0.0, 1.0], [2.0, 3.0]], a=[1.0, 2.0], b_c=[4.0, 5.0, 9.0])
    data = map_data(some.with_units(place="m"), np.arange(12))
    assert (data.x.label, data.y.label, data.held) == ("a", "b c", "place = (2, 3) m")  # was not said
    np.testing.assert_array_equal(data.z, [[6.0, 9.0], [7.0, 10.0], [8.0, 11.0]])
    with pytest.raises(ValueError, match="argument at must hold parameters that are no side"):
        map_data(some, np.arange(12), at={"place": 1.0})


def test_truth_values_and_words_of_a_table_are_numbered_from_zero_up():
    some = jxr.Parameters.grid(a=[1.0, 2.0], b=[4.0, 5.0])
    data = map_data(some, np.array([True, False, True, True]))
    assert data.codes == ("false", "true") and data.z.tolist() == [[1, 1], [0, 1]]
    alike = map_data(some, np.array([True] * 4))
    assert alike.codes == ("true",) and alike.z.tolist() == [[0, 0], [0, 0]]
    counts = map_data(some, np.array([7, 3, 3, 5]))
    assert counts.codes == () and counts.z.tolist() == [[7.0, 3.0], [3.0, 5.0]]

    class Told(np.ndarray):
        """An array of a table, which says what its numbers are."""

    told = np.array([4, 9, 4, -1]).view(Told)
    told.attrs = {"flag_values": [-1, 4, 9], "flag_meanings": "NOT_STORED all_well lost"}
    named = map_data(some, told)
    assert named.codes == ("not stored", "all well", "lost") and named.z.tolist() == [[1, 1], [2, 0]]


@pytest.mark.parametrize("values", [[[1], [1, 2]], ["a"] * 4, np.ones((4, 1)), np.ones(4, complex), None])
def test_values_that_are_no_numbers_of_the_rows_are_refused(values):
    some = jxr.Parameters.grid(a=[1.0, 2.0], b=[4.0, 5.0])
    with pytest.raises(ValueError, match="argument values must be one number or code for each of the 4 rows"):
        map_data(some, values)


def test_samples_stand_where_they_are_and_what_else_changes_is_told():
    t = np.arange(5.0)
    some = jxr.Parameters(a=t + 1.0, b=t**2, c=3.0 - 0.1 * t, d=2.0 * t, e=np.ones(5)).with_units(b="s")
    data = map_data(some, 10.0 * t, x="b")
    assert not data.gridded and (data.x.label, data.y.label) == ("b [s]", "a")
    np.testing.assert_array_equal(data.x.values, t**2)
    np.testing.assert_array_equal(data.y.values, t + 1.0)
    np.testing.assert_array_equal(data.z, 10.0 * t)
    assert data.held == "c, d between their bounds"
    assert map_data(jxr.Parameters(a=t, b=-t, c=t**2), t).held == "c between its bounds"
    assert map_data(jxr.Parameters(a=t, b=-t, c=np.ones(5)), t).held == ""
    with pytest.raises(ValueError, match="argument at must be left out where samples are shown"):
        map_data(some, t, at={"c": 1.0})
    with pytest.raises(ValueError, match="argument parameters must have two parameters of one number each"):
        map_data(jxr.Parameters(a=t, b=np.ones(5)), t, x="a")


SIDES = Side(np.array([1.0, 2.0, 4.0]), "a [m]", True), Side(np.array([5.0, 8.0]), "b", False)
Z = np.array([[0, 1, 2], [1, 1, 0]])
CODES = ("successful", "slipping", "lost")


def drawn(data, label="height"):
    """The axes of a map, and the figure with what was added to it."""
    figure = Figure()
    ax = figure.subplots()
    _map_figure._draw(ax, data, label, alone=True)
    return ax, figure


def test_a_dozen_codes_have_colours_of_their_own():
    names = tuple(f"code {k}" for k in range(12))
    assert len({*_map_figure.code_colours(names), _map_figure.WELL, _map_figure.NOTHING}) == 14


def test_a_cell_has_the_colour_of_its_code():
    from matplotlib.colors import to_rgba

    ax, figure = drawn(MapData(*SIDES, Z, CODES, True, ""))
    (mesh,) = ax.collections
    names = [_map_figure.WELL, *_map_figure.CODE_COLOURS[:2]]
    colours = np.array([to_rgba(name) for name in names])
    mesh.update_scalarmappable()
    np.testing.assert_allclose(mesh.get_facecolor().reshape(-1, 4), colours[Z.ravel()], atol=0.005)
    corners = mesh.get_coordinates()
    np.testing.assert_allclose(corners[0, :, 0], [2.0**-0.5, 2.0**0.5, 8.0**0.5, 32.0**0.5])
    np.testing.assert_allclose(corners[:, 0, 1], [3.5, 6.5, 9.5])
    assert (ax.get_xscale(), ax.get_yscale(), len(figure.axes)) == ("log", "linear", 1)
    (key,) = figure.legends
    assert [text.get_text() for text in key.get_texts()] == [
        "successful, 33.3 %",
        "slipping, 50 %",
        "lost, 16.7 %",
    ]
    assert key.get_title().get_text() == "height" and key._ncols == 3
    shown = [patch.get_facecolor() for patch in key.get_patches()]
    np.testing.assert_allclose(shown, colours)


def test_maps_that_share_a_figure_have_a_legend_each():
    """Below the figure one lay over the other."""
    figure = Figure(figsize=(9.0, 4.0))
    axes = figure.subplots(1, 2)
    grid = jxr.Parameters.grid(a=[1.0, 2.0, 3.0], b=[4.0, 5.0])
    for ax, values, label in zip(axes, (grid.a > 1.5, grid.b > 4.5), ("one", "two"), strict=True):
        parameter_map(grid, values, ax=ax, label=label)
    figure.draw_without_rendering()
    assert not figure.legends and [ax.get_legend().get_title().get_text() for ax in axes] == ["one", "two"]
    for ax in axes:
        inner, outer = ax.get_legend().get_window_extent(), ax.get_window_extent()
        assert outer.x0 < inner.x0 and inner.x1 < outer.x1 and outer.y0 < inner.y0 and inner.y1 < outer.y1


def test_values_have_a_bar_and_cells_without_one_are_grey():
    from matplotlib.colors import to_rgba

    data = MapData(*SIDES, np.where(Z == 2, np.nan, Z + 3.0), (), True, "")
    ax, figure = drawn(data)
    assert ax.get_facecolor() == to_rgba(_map_figure.NOTHING)
    (mesh,) = ax.collections
    assert mesh.get_array().mask.tolist() == [[False, False, True], [False, False, False]]
    assert mesh.get_clim() == (3.0, 4.0) and mesh.get_cmap().name == "viridis"
    assert figure.axes[1].get_ylabel() == "height"
    (key,) = figure.legends
    assert [text.get_text() for text in key.get_texts()] == ["no number, 16.7 %"]
    assert key.get_title().get_text() == "" and key._ncols == 1
    assert not drawn(data._replace(z=Z + 3.0))[1].legends


def test_samples_without_a_number_are_grey_dots_below_the_others():
    from matplotlib.colors import to_rgba

    x, y = np.array([3.0, 1.0, 2.0, 5.0]), np.array([9.0, 8.0, 6.0, 7.0])
    data = MapData(Side(x, "a", False), Side(y, "b", True), np.array([1.0, np.nan, 4.0, 2.0]), (), False, "")
    ax, _ = drawn(data)
    assert ax.get_facecolor() == to_rgba("white") and ax.get_yscale() == "log" and ax.get_xscale() == "linear"
    unknown, known = ax.collections
    np.testing.assert_array_equal(unknown.get_offsets(), [[1.0, 8.0]])
    np.testing.assert_allclose(unknown.get_facecolor()[0], to_rgba(_map_figure.NOTHING))
    np.testing.assert_array_equal(known.get_offsets(), [[3.0, 9.0], [2.0, 6.0], [5.0, 7.0]])
    np.testing.assert_array_equal(known.get_array(), [1.0, 4.0, 2.0])
    few, many = (
        drawn(MapData(*2 * [Side(np.arange(n) + 1.0, "", False)], np.arange(n), (), False, ""))[0]
        for n in (2000, 2001)
    )
    sizes = [ax.collections[1].get_sizes()[0] for ax in (few, many)]
    assert sizes[0] == 4.0 * sizes[1] == known.get_sizes()[0] == unknown.get_sizes()[0] > 0.0


def test_a_map_is_headed_by_its_title_and_where_others_are_held():
    some = jxr.Parameters.grid(a=[1.0, 2.0], b=[4.0, 5.0], c=[6.0, 7.0])
    whole = Figure()
    ax = whole.subplots()
    assert parameter_map(some, some.a, title="Pinches", ax=ax) is whole
    assert ax.get_title(loc="left") == "Pinches; c = 7"
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("a", "b")
    flat = jxr.Parameters.grid(a=[1.0, 2.0], b=[4.0, 5.0])
    titles = [parameter_map(flat, flat.a, title=title).axes[0].get_title(loc="left") for title in ("P", "")]
    assert titles == ["P", ""]


def test_a_page_of_a_grid_has_a_step_of_colour_for_each_code():
    trace = _trace(MapData(*SIDES, Z, CODES, True, ""), "end")
    colours = [_map_figure.WELL, *_map_figure.CODE_COLOURS[:2]]
    places = [place for place, _ in trace["colorscale"]]
    np.testing.assert_allclose(places, [0.0, 1 / 3, 1 / 3, 2 / 3, 2 / 3, 1.0])
    assert [colour for _, colour in trace["colorscale"]] == [c for c in colours for _ in (0, 1)]
    assert (trace["zmin"], trace["zmax"], trace["showscale"]) == (-0.5, 2.5, True)
    bar = trace["colorbar"]
    assert (bar["tickvals"], bar["ticktext"], bar["title"]) == ([0, 1, 2], list(CODES), {"text": "end"})
    assert bar["outlinewidth"] == 0.5
    assert trace["text"].tolist() == [
        ["successful", "slipping", "lost"],
        ["slipping", "slipping", "successful"],
    ]
    assert trace["hovertemplate"] == "a [m]: %{x:.5g}<br>b: %{y:.5g}<br>%{text}<extra></extra>"
    np.testing.assert_array_equal(trace["x"], SIDES[0].values)
    np.testing.assert_array_equal(trace["y"], SIDES[1].values)
    np.testing.assert_array_equal(trace["z"], Z)


def test_a_page_says_values_under_the_pointer():
    z = np.array([[1.0, np.inf, 2.0], [3.0, np.nan, 4.0]])
    grid = _trace(MapData(*SIDES, z, (), True, ""), "")
    assert grid["hovertemplate"] == "a [m]: %{x:.5g}<br>b: %{y:.5g}<br>value: %{z:.5g}<extra></extra>"
    assert "height: %{z:.5g}" in _trace(MapData(*SIDES, z, (), True, ""), "height")["hovertemplate"]
    np.testing.assert_array_equal(grid["z"], [[1.0, np.nan, 2.0], [3.0, np.nan, 4.0]])
    assert grid["colorscale"] == "Viridis" and grid["showscale"] and "zmin" not in grid and "text" not in grid
    dots = MapData(SIDES[0], SIDES[0], np.array([2, 0, 1]), CODES, False, "")
    samples = _trace(dots, "end")
    marker = samples["marker"]
    assert samples["mode"] == "markers" and (marker["cmin"], marker["cmax"]) == (-0.5, 2.5)
    assert samples["text"].tolist() == ["lost", "successful", "slipping"]
    np.testing.assert_array_equal(marker["color"], [2, 0, 1])
    assert marker["size"] == 6 and marker["line"] == {"width": 0.3, "color": "#555555"}
    values = _trace(dots._replace(codes=(), z=np.array([0.1, 0.2, np.nan])), "f")
    assert "f: %{marker.color:.5g}<extra>" in values["hovertemplate"] and values["marker"]["showscale"]
    np.testing.assert_array_equal(values["marker"]["color"], [0.1, 0.2, np.nan])


def test_a_page_of_a_map_is_laid_out_as_its_picture():
    layout = _layout(MapData(*SIDES, Z, (), True, "c = 3"), "Pinches")
    assert layout["title"] == {
        "text": "Pinches<br><sup>c = 3</sup>",
        "x": 0.5,
        "xanchor": "center",
        "font": {"size": 18},
    }
    assert (layout["xaxis"]["type"], layout["yaxis"]["type"]) == ("log", "linear")
    assert (layout["xaxis"]["title"], layout["yaxis"]["title"]) == ({"text": "a [m]"}, {"text": "b"})
    assert layout["plot_bgcolor"] == _map_figure.NOTHING and not layout["xaxis"]["showgrid"]
    bare = _layout(MapData(*SIDES[::-1], Z, (), False, ""), "Pinches")
    assert bare["title"]["text"] == "Pinches" and bare["plot_bgcolor"] == "white"
    assert (bare["xaxis"]["type"], bare["yaxis"]["type"]) == ("linear", "log")
    assert bare["margin"] == {"l": 70, "r": 20, "t": 70, "b": 60} and not bare["yaxis"]["zeroline"]


def test_a_page_of_a_map_is_one_file_in_a_new_folder(monkeypatch, tmp_path):
    """Dots for samples, cells for a grid; what plotly is told to write."""
    made = []

    def figure(**given):
        made.append(given)
        written = lambda path, **options: made.append((path, options))  # noqa: E731
        return SimpleNamespace(write_html=written)

    plotly = SimpleNamespace(
        Figure=figure, Heatmap=lambda trace: ("cells", trace), Scattergl=lambda trace: ("dots", trace)
    )
    monkeypatch.setattr("jaxroll.plotting._map_page.plotly_door", lambda: plotly)
    some = jxr.Parameters.grid(a=[1.0, 2.0], b=[4.0, 5.0], c=[6.0, 7.0])
    path = tmp_path / "new" / "one" / "map.HTM"
    assert jxr.plotting.map_page(some, some.a, path, x="c", at={"b": 4.0}, label="l") == path
    given, (written, options) = made
    assert written == path and path.parent.is_dir() and options["include_plotlyjs"] is True
    assert options["config"] == {"displaylogo": False, "responsive": True, "scrollZoom": True}
    ((kind, trace),) = given["data"]
    assert kind == "cells" and trace["z"].tolist() == [[1.0, 1.0], [2.0, 2.0]]
    assert given["layout"]["title"]["text"] == "Outcomes of a sweep<br><sup>b = 4</sup>"
    assert given["layout"]["xaxis"]["title"] == {"text": "c"}
    t = np.arange(4.0)
    jxr.plotting.map_page(jxr.Parameters(a=t, b=t**2), t, path)
    assert made[2]["data"][0][0] == "dots"


@pytest.mark.parametrize(
    ("low", "high", "shown"),
    [
        (0.002, 0.02, "0.002 0.005 0.01 0.02"),
        (3e-6, 0.5, "1e-05 0.0001 0.001 0.01 0.1 1"),
        (0.004, 0.007, "0.004 0.005 0.006 0.007"),
        (1.0, 8.0, "1 2 5"),
    ],
)
def test_numbers_at_logarithmic_axes_are_of_one_size_and_lie_apart(low, high, shown):
    """Those between powers of ten were larger than these, and were written over each other."""
    grid = jxr.Parameters.grid(a=np.geomspace(low, high, 9), b=np.geomspace(low, high, 9))
    figure = parameter_map(grid, grid.a)
    figure.draw_without_rendering()
    ax = figure.axes[0]
    for axis, k in ((ax.xaxis, 0), (ax.yaxis, 1)):
        low, high = axis.get_view_interval()
        ticks = [*axis.get_ticklabels(), *axis.get_ticklabels(minor=True)]
        seen = [tick for tick in ticks if tick.get_text() and low <= tick.get_position()[k] <= high]
        assert " ".join(tick.get_text() for tick in seen) == shown
        assert {tick.get_fontsize() for tick in seen} == {8.0}
        boxes = [tick.get_window_extent() for tick in seen]
        assert min(b.min[k] - a.max[k] for a, b in itertools.pairwise(boxes)) > 2.0
