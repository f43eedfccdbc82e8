"""Parameters by name: columns, grids, products and samples, and sweeps over them."""

import itertools

import jax
import numpy as np
import pytest
from scipy import stats

import jaxroll as jxr
from jaxroll import Parameters
from jaxroll._sweep import _parameters
from tests.subjects.driven_plate import driven_plate


def test_a_grid_is_the_product_of_its_axes_the_last_one_fastest():
    axes = {"a": [1.0, 2.0], "b": [3, 4, 5], "c": [True, False]}
    grid = Parameters.grid(**axes)
    assert grid.shape == (2, 3, 2) and grid.rows == len(grid) == 12
    assert list(zip(grid.a, grid.b, grid["c"], strict=True)) == list(itertools.product(*axes.values()))
    a, b, c = np.meshgrid(*axes.values(), indexing="ij")
    for name, there in zip("abc", (a, b, c), strict=True):
        np.testing.assert_array_equal(grid.shaped(grid[name]), there)
        np.testing.assert_array_equal(grid.axis(name), axes[name])


def test_a_product_pairs_every_row_with_every_row():
    ours, theirs = Parameters(a=[1.0, 2.0], b=[10.0, 20.0]), Parameters.grid(c=[5.0, 6.0, 7.0])
    both = (ours * theirs).with_units(a="m")
    assert (
        both.shape == (2, 3)
        and both.axes == (("a", "b"), ("c",))
        and both.units == {"a": "m", "b": "", "c": ""}
    )
    assert [(p.a, p.b, p.c) for p in both] == [
        (a, 10.0 * a, c) for a, c in itertools.product((1.0, 2.0), (5.0, 6.0, 7.0))
    ]


def test_rows_are_parameters_too():
    some = Parameters(a=[1.0, 2.0, 3.0], v=np.arange(6.0).reshape(3, 2), fixed=7.0)
    assert some[1].a == 2.0 and dict(**some[2])["fixed"] == 7.0 and "a" in some and "q" not in some
    np.testing.assert_array_equal(some[1:].v, [[2.0, 3.0], [4.0, 5.0]])
    assert some[1:].shape == (2,) and some.names == ("a", "v", "fixed")
    with pytest.raises(AttributeError, match="no column 'q'"):
        _ = some.q
    with pytest.raises(KeyError, match="q"):
        _ = some["q"]
    summed = jax.jit(jax.vmap(lambda p: p.a + p["v"].sum() + p.fixed))(some)
    np.testing.assert_allclose(summed, [9.0, 14.0, 19.0])


def test_rows_are_chosen_by_numbers_slices_and_lists_alone():
    some = Parameters.grid(a=[1.0, 2.0], b=[3.0, 4.0, 5.0])
    for key, rows in ((-1, [5]), ([4, -6], [4, 0]), (np.arange(6) % 2 == 1, [1, 3, 5]), ([], [])):
        np.testing.assert_array_equal(np.atleast_1d(some[key].b), [[3.0, 4.0, 5.0][k % 3] for k in rows])
    for key in ((0, 1), None, True, ..., 0.5, [[0, 1]], [True, False], [0.0], b"a", [[0], [1, 2]]):
        with pytest.raises(ValueError, match="argument key must be a name, a row, a slice or a list of rows"):
            some[key]
    for key in (6, -7, [0, 6]):
        with pytest.raises(IndexError, match="argument key must be one of 6 rows"):
            some[key]
    with pytest.raises(IndexError, match="argument key must be a name, of one row"):
        some[0][0]
    with pytest.raises(TypeError, match="one row of Parameters"):
        len(some[0])


def test_columns_are_copies():
    given = np.array([1.0, 2.0])
    some = Parameters(a=given)
    given[0] = 5.0
    assert some.a[0] == 1.0


@pytest.mark.parametrize("draw", [Parameters.sobol, Parameters.latin_hypercube])
def test_samples_of_logarithms_fill_ranges_whose_ends_lie_far_apart(draw):
    """The quotient of these ends is beyond all floating numbers."""
    some = np.log10(draw(512, a=(1e-200, 1e200, "log")).a)
    assert stats.kstest((some + 200.0) / 400.0, "uniform").pvalue > 0.5


def test_a_sobol_sequence_has_no_more_axes_than_scipy_knows():
    with pytest.raises(ValueError, match="argument ranges must be at most 21201, but were 21202"):
        Parameters.sobol(2, seed=0, **{f"x{k}": (0.0, 1.0) for k in range(21202)})


@pytest.mark.parametrize("draw", [Parameters.sobol, Parameters.latin_hypercube])
def test_samples_fill_their_ranges(draw):
    """Uniform by Kolmogorov and Smirnov's test, of numbers and of logarithms; the same for the same seed."""
    ranges = {"a": (-2.0, 3.0), "b": (1e-3, 10.0, "log")}
    some, again, other = (draw(512, seed=seed, **ranges) for seed in (3, 3, 4))
    assert stats.kstest((some.a + 2.0) / 5.0, "uniform").pvalue > 0.5
    assert stats.kstest(np.log10(some.b * 1e3) / 4.0, "uniform").pvalue > 0.5
    assert abs(np.corrcoef(some.a, np.log(some.b))[0, 1]) < 0.1
    np.testing.assert_array_equal(some.a, again.a)
    assert (some.a != other.a).all() and some.shape == (512,)


def test_a_latin_hypercube_has_one_sample_in_each_part():
    some = Parameters.latin_hypercube(100, a=(0.0, 100.0), b=(1.0, np.exp(10.0), "log"))
    assert sorted(some.a.astype(int)) == list(range(100))
    assert sorted((10.0 * np.log(some.b)).astype(int)) == list(range(100))


def test_sobol_points_go_on_where_fewer_ended_and_are_more_even_than_random_ones():
    few, many = (Parameters.sobol(n, seed=1, a=(0.0, 1.0), b=(0.0, 1.0)) for n in (100, 256))
    np.testing.assert_array_equal(few.a, many.a[:100])
    mean = lambda p: np.mean(np.exp(p.a) * p.b**2)  # noqa: E731
    assert abs(mean(many) - (np.e - 1.0) / 3.0) < 1e-3  # of 256 at random: 0.03


BAD = {
    "nothing": (lambda: Parameters(), "argument columns must be one or more"),
    "text": (lambda: Parameters(a="x"), "argument a must be a number or an array"),
    "NaN": (lambda: Parameters(a=[1.0, np.nan]), "argument a must be finite"),
    "nothing in it": (lambda: Parameters(a=[]), "argument a must hold one number"),
    "masked": (lambda: Parameters(a=np.ma.array([1.0], mask=[True])), "argument a must be a number"),
    "lengths": (lambda: Parameters(a=[1.0], b=[1.0, 2.0]), "argument b must be as long as"),
    "own name": (lambda: Parameters(shape=[1.0]), "argument 'shape' must be called otherwise"),
    "no name": (lambda: Parameters(**{"a b": [1.0]}), "argument 'a b' must be called otherwise"),
    "twice": (lambda: Parameters(a=[1.0]) * Parameters(a=[1.0]), "argument a must be a name in one factor"),
    "no axis": (lambda: Parameters.grid(a=1.0), "argument a must be the values along an axis"),
    "falling": (lambda: Parameters.sobol(4, a=(1.0, 0.0)), "argument a must go up"),
    "log of zero": (lambda: Parameters.sobol(4, a=(0.0, 1.0, "log")), "argument a must begin above zero"),
    "no range": (lambda: Parameters.latin_hypercube(4, a=3.0), r"argument a must be \(low, high\)"),
    "no samples": (lambda: Parameters.sobol(0, a=(0.0, 1.0)), "argument count must be a whole number"),
    "no seed": (lambda: Parameters.sobol(4, seed=-1, a=(0.0, 1.0)), "argument seed must be a whole number"),
    "no unit": (lambda: Parameters(a=[1.0]).with_units(b="m"), "argument b must be a unit"),
    "other length": (lambda: Parameters(a=[1.0]).shaped(np.ones(3)), "argument values must hold arrays"),
    "no such axis": (lambda: Parameters(a=[1.0]).axis("b"), "argument name must be one of a"),
}


@pytest.mark.parametrize("case", BAD)
def test_parameters_that_do_not_fit(case):
    call, words = BAD[case]
    with pytest.raises(ValueError, match=words):
        call()


def test_they_are_saved_and_read_with_their_grid(tmp_path):
    grid = Parameters.grid(a=[1.0, 2.0], b=[1, 2, 3]).with_units(b="m")
    read = jxr.load(jxr.save(tmp_path / "grid", grid))
    assert read.shape == grid.shape and read.units == grid.units and read.axes == grid.axes
    np.testing.assert_array_equal(read.b, grid.b)


def test_a_sweep_takes_them():
    """Rows by attribute and by item; what is kept goes back into the grid."""
    grasp, state = driven_plate()
    grid = Parameters.grid(damping=[6.0, 8.0], force=[0.4, 0.5, 0.6])
    settings = {"rtol": 1e-6, "keep": lambda run: run.last.q}
    ends = jxr.sweep(lambda p: (grasp.with_(**p), state), grid, 0.1, **settings)
    plain = jxr.sweep(
        lambda p: (grasp.with_(damping=p[0], force=p[1]), state), (grid.damping, grid.force), 0.1, **settings
    )
    np.testing.assert_array_equal(ends, plain)
    assert grid.shaped(ends).shape == (2, 3, 4) and (grid.shaped(ends)[1, 2] == plain[5]).all()


def test_samples_are_those_of_scipy_stretched_to_their_ranges():
    """The first of a power of two; on a scale of logarithms the ends are kept."""
    ranges = {"a": (-2.0, 3.0), "b": (1e-3, 10.0, "log")}
    unit = stats.qmc.Sobol(2, rng=3).random(8)[:5]
    some = Parameters.sobol(5, seed=3, **ranges)
    np.testing.assert_allclose(some.a, -2.0 + 5.0 * unit[:, 0], rtol=1e-14)
    np.testing.assert_allclose(some.b, 1e-3 * 1e4 ** unit[:, 1], rtol=1e-12)
    unit = stats.qmc.LatinHypercube(2, rng=3).random(5)
    np.testing.assert_allclose(Parameters.latin_hypercube(5, seed=3, **ranges).a, -2.0 + 5.0 * unit[:, 0])
    assert Parameters.sobol(1, a=(0.0, 1.0)).rows == 1 and Parameters.sobol(8, a=(0.0, 1.0)).rows == 8
    plain = [draw(4, a=(0.0, 1.0)).a for draw in (Parameters.sobol, Parameters.latin_hypercube)]
    again = [draw(4, seed=0, a=(0.0, 1.0)).a for draw in (Parameters.sobol, Parameters.latin_hypercube)]
    np.testing.assert_array_equal(plain, again)
    stretch = _parameters._stretch("b", (0.1, 0.7, "log"))
    assert stretch(np.array([0.0, 1.0])).tolist() == [0.1, 0.7] and stretch(np.array([1.1])).tolist() == [0.7]


@pytest.mark.parametrize(
    "ends",
    [(1.0, 1.0), (2.0, 1.0), (1.0,), (1.0, 2.0, 3.0), (0.0, np.inf), (-1.0, 1.0, "log"), "ab", (None, 1)],
)
def test_a_range_goes_from_a_number_up_to_another(ends):
    with pytest.raises(ValueError, match="argument a must"):
        Parameters.sobol(2, a=ends)


def test_slices_of_a_grid_are_rows_and_single_rows_have_no_length():
    grid = Parameters.grid(a=[1.0, 2.0], b=[3.0, 4.0, 5.0]).with_units(b="m")
    for key, rows in ((slice(1, 5), [0, 1, 1, 1]), (np.array([True, False] * 3), [0, 0, 1])):
        part = grid[key]
        assert part.shape == (len(part.a),) and part.axes == (("a", "b"),) and part.units == grid.units
        assert len(part) == len(rows if isinstance(key, slice) else [0, 2, 4])
    row = grid[4]
    assert (
        (row.a, row.b) == (2.0, 4.0)
        and row.shape == (2, 3)
        and repr(row).startswith("Parameters(one row: a=2")
    )
    assert repr(grid).startswith("Parameters(6 rows as 2 x 3: a=[1, 1, 1, 2, 2, 2], b=[3, 4, 5, 3, 4, 5] m")
    assert repr(Parameters(a=[1.0, 2.0])) == "Parameters(2 rows: a=[1, 2])"
    assert Parameters(a=3.0).rows == 1 and Parameters(a=3.0, b=[1.0, 2.0]).a.tolist() == [3.0, 3.0]


def test_the_values_along_an_axis_of_a_product_of_columns():
    both = Parameters(a=[1.0, 2.0], v=[[1.0, 2.0], [3.0, 4.0]]) * Parameters.grid(c=[5.0, 6.0, 7.0])
    assert both.axis("a").tolist() == [1.0, 2.0] and both.axis("c").tolist() == [5.0, 6.0, 7.0]
    assert both.axis("v").tolist() == [[1.0, 2.0], [3.0, 4.0]]
    with pytest.raises(ValueError, match="argument values must hold arrays of leading axis 6"):
        both.shaped(np.ones((2, 3)))
    assert both.shaped(np.ones((6, 4))).shape == (2, 3, 4)
    assert _parameters._few_enough("a", 10**9) == 10**9
    with pytest.raises(ValueError, match="argument a must leave at most 1000000000 rows"):
        _parameters._few_enough("a", 10**9 + 1)
