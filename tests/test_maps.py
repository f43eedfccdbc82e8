"""Measures kept by name, and maps that are fine only where outcomes change."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.colors import to_rgb

import jaxroll as jxr
from jaxroll import design
from jaxroll._maps import _adaptive, Measures, MEASURES_KEPT
from jaxroll._maps._adaptive import AdaptiveMap
from jaxroll._maps._cells import between, halved_lines, Spread, wanted_points
from jaxroll.plotting import _map_figure
from jaxroll.plotting._map_data import Side
from jaxroll.plotting._map_figure import _edges
from tests.subjects import rolling_disc
from tests.subjects.swinging_plate import swinging

ALL = jxr.measures(*MEASURES_KEPT, turned=lambda run: run.last.q[0])


@pytest.fixture(scope="module")
def swept():
    """Two runs of a disc on a plate that swings, damped, about where it began: whole, and as measures."""
    settings = {"ts": 31, "record": ALL.record, "rtol": 1e-7}
    make, some = lambda p: swinging(p.damping), jxr.Parameters(damping=[0.8, 1.2])
    return jxr.sweep(make, some, 2.0, keep=lambda run: (run, ALL(run)), **settings)


def test_values_without_an_order_are_all_run():
    """Order counts where something is filled in; values that fall have one, and rows of arrays are taken."""
    some = jxr.Parameters.grid(x=[0.0, 1.0, 0.2, 0.7, 0.1], y=[0.0, 1.0])
    found = jxr.adaptive_map(lambda p: p.x > 0.5, some, levels=0)
    np.testing.assert_array_equal(found.values, some.shaped(some.x > 0.5))
    line = np.linspace(1.0, 0.0, 17)
    falling = jxr.Parameters(x=line, y=np.sin(20.0 * line)) * jxr.Parameters.grid(z=[[0.0, 1.0], [1.0, 0.0]])
    found = jxr.adaptive_map(lambda p: p.x > 0.53, falling)
    np.testing.assert_array_equal(found.values, falling.shaped(falling.x > 0.53))


def test_infinite_values_are_filled_in_as_such():
    """As the margin of runs that nothing ends; and without NumPy's warning of infinity less infinity."""
    grid = jxr.Parameters.grid(x=np.linspace(-1.0, 1.0, 33), y=np.linspace(-1.0, 1.0, 17))
    steep = lambda x, y: np.where(x + y > 0.3, np.inf, x)  # noqa: E731
    found = jxr.adaptive_map(lambda p: jnp.where(p.x + p.y > 0.3, jnp.inf, p.x), grid, tolerance=0.2)
    assert found.runs < grid.rows / 2
    np.testing.assert_allclose(found.values, grid.shaped(steep(grid.x, grid.y)), atol=1e-15)


def test_measures_are_those_of_the_trajectory(swept):
    """Worked out here from what the run saved, but for those that `design` has and tests."""
    runs, kept = swept
    assert set(kept) == {*MEASURES_KEPT, "turned"} and ALL.record == ("multipliers", "energy") and ALL.timed
    energy = np.asarray(runs.energy.kinetic + runs.energy.potential)
    forces = np.asarray(runs.multipliers.f)
    np.testing.assert_allclose(kept["energy_lost"], energy[:, 0] - energy[:, -1], rtol=1e-12)
    # Nothing but the controller takes energy away here.
    np.testing.assert_allclose(kept["energy_lost"], -np.asarray(runs.energy.work)[:, -1], rtol=1e-9)
    assert (kept["energy_lost"] > 1e-4).all()
    np.testing.assert_allclose(kept["energy_residual"], np.abs(runs.energy.residual).max(axis=1), rtol=1e-9)
    np.testing.assert_allclose(kept["least_force"], forces.min(axis=(1, 2)), rtol=1e-12)
    np.testing.assert_allclose(kept["peak_force"], forces.max(axis=(1, 2)), rtol=1e-12)
    np.testing.assert_allclose(kept["final_pose"], runs.last.q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(kept["turned"], np.asarray(runs.last.q)[:, 0], rtol=0, atol=1e-12)
    names = ("settling_time", "overshoot", "tracking_error", "friction_demand")
    of_one = jax.jit(lambda run: [getattr(design, name)(run) for name in names])
    alone = [of_one(jax.tree.map(lambda x, i=i: np.asarray(x)[i], runs)) for i in (0, 1)]
    np.testing.assert_allclose([kept[name] for name in names], np.transpose(alone), rtol=1e-9)
    event = kept["first_event"]
    assert (event["result"] == jxr.RESULTS.successful).all() and (event["contact"] == -1).all()
    assert np.isnan(event["time"]).all() and (kept["t_end"] == 2.0).all()


def ended(run, at):
    """A run whose rows hold nothing from one on, as after an early end."""

    def cut(x):
        return np.where(np.arange(x.shape[0]).reshape(-1, *(1,) * (x.ndim - 1)) < at, x, np.nan)

    parts = lambda r: (r.states, r.multipliers, r.energy)  # noqa: E731
    run = eqx.tree_at(parts, run, jax.tree.map(cut, parts(run)))
    stats = lambda r: (r.result, r.stats.t_end, r.stats.contact)  # noqa: E731
    return eqx.tree_at(stats, run, (jxr.RESULTS.slipping, run.ts[at - 1] + 0.001, jnp.asarray(0)))


def test_measures_of_a_run_that_ended_early_are_of_the_part_that_it_reached(run):
    measured = jax.jit(lambda run: ALL(run))
    found = measured(ended(run, 40))
    energy, forces = run.energy.kinetic + run.energy.potential, run.multipliers.f
    assert found["result"] == jxr.RESULTS.slipping and int(found["first_event"]["contact"]) == 0
    assert float(found["first_event"]["time"]) == float(run.ts[39]) + 0.001
    assert float(found["energy_lost"]) == float(energy[0] - energy[39]) > 0.0
    assert float(found["least_force"]) == float(forces[:40].min())
    assert np.isnan(found["settling_time"]) and np.isnan(found["overshoot"])
    nothing = measured(ended(run, 0))
    assert np.isnan(nothing["energy_residual"]) and np.isnan(nothing["least_force"])
    assert np.isnan(nothing["energy_lost"])


def test_what_a_measure_needs_is_named(scene):
    forced, timed = jxr.measures("least_force"), jxr.measures("settling_time", "t_end")
    assert forced.record == ("multipliers",) and not timed.record and timed.timed
    assert not jxr.measures("result", "steps").timed and isinstance(timed, Measures)
    sweep = lambda keep, **more: jxr.sweep(lambda p: scene, np.ones(2), 0.1, keep=keep, **more)  # noqa: E731
    with pytest.raises(
        ValueError, match="argument record must hold 'multipliers' for the measure 'least_force'"
    ):
        sweep(forced, ts=11)
    with pytest.raises(ValueError, match="argument ts must ask for some tens of times .*'settling_time'"):
        sweep(timed)


@pytest.mark.parametrize("names", [(), ("speed",), (3,), (None,)])
def test_measures_that_there_are_not(names):
    with pytest.raises(ValueError, match="argument names must be"):
        jxr.measures(*names)


def test_ones_own_measure_is_a_function():
    with pytest.raises(ValueError, match="argument height must be a function of a trajectory"):
        jxr.measures("result", height=3.0)


def square(n, m=None):
    return jxr.Parameters.grid(x=np.linspace(-1.0, 1.0, n), y=np.linspace(-1.0, 1.0, m or n))


OUTCOMES = {
    "disc": lambda x, y: x**2 + y**2 < 0.5,
    "three codes": lambda x, y: 1 * (x**2 + y**2 < 0.6) + 1 * (y > 0.3 * x),
    "spiral": lambda x, y: ((x * x + y * y) ** 0.5 * 3.0 - 0.4 * y) % 2.0 < 1.0,
    "thorn": lambda x, y: (abs(y) < 0.3 * (x + 1.0) ** 3) & (x < 0.9),
}


@pytest.mark.parametrize("name", OUTCOMES)
@pytest.mark.parametrize("shape", [(129, 129), (100, 171)])
def test_an_adaptive_map_is_the_full_one(name, shape):
    """Boundaries that the coarse points meet are followed to the last point, on grids of any length."""
    grid, outcome = square(*shape), OUTCOMES[name]
    found = jxr.adaptive_map(lambda p: outcome(p.x, p.y), grid, levels=4)
    np.testing.assert_array_equal(found.values, grid.shaped(outcome(grid.x, grid.y)))
    assert found.runs == found.ran.sum() <= found.spent
    assert found.runs < (0.2 if name != "spiral" else 0.6) * grid.rows
    # Every point beside another code was run.
    codes = np.asarray(found.values).astype(int)
    for axis in (0, 1):
        at = np.argwhere(np.diff(codes, axis=axis) != 0)
        assert found.ran[tuple(at.T)].all() and found.ran[tuple((at + np.eye(2, dtype=int)[axis]).T)].all()


def test_what_lies_between_coarse_points_is_missed_and_fewer_levels_see_it():
    """As the docstring says: an island of five steps, off the points of level 4 and on those of level 2."""
    grid = square(129)
    island = lambda p: jnp.hypot(p.x - 0.375 * 0.5, p.y - 0.1875) < 0.04  # noqa: E731
    missed, seen = (jxr.adaptive_map(island, grid, levels=levels) for levels in (5, 2))
    every = jxr.adaptive_map(island, grid, levels=0)
    assert every.runs == grid.rows and every.values.sum() > 10
    assert not missed.values.any() and missed.runs == 25
    np.testing.assert_array_equal(seen.values, every.values)


def test_values_are_refined_where_they_change_and_interpolated_elsewhere():
    grid = square(129)
    bump = lambda x, y: np.exp(-20.0 * (x * x + y * y))  # noqa: E731
    exact = grid.shaped(bump(grid.x, grid.y))
    found = jxr.adaptive_map(lambda p: {"b": jnp.exp(-20.0 * (p.x**2 + p.y**2))}, grid, tolerance={"b": 0.02})
    assert np.abs(found.values["b"] - exact).max() < 0.02 and found.runs < 0.4 * grid.rows
    # Without a tolerance a code alone decides; a value that is linear is then the same everywhere.
    plane = jxr.adaptive_map(lambda p: (p.x > 0.31, 2.0 * p.x - p.y), grid)
    np.testing.assert_allclose(plane.values[1], grid.shaped(2.0 * grid.x - grid.y), rtol=0, atol=1e-14)


def test_where_a_value_ends_to_be_a_number_is_a_boundary():
    grid = jxr.Parameters.grid(x=np.linspace(-1, 1, 33), y=np.linspace(-1, 1, 40), z=np.linspace(0, 1, 17))
    found = jxr.adaptive_map(lambda p: jnp.where(p.x > p.y, jnp.nan, p.z), grid, levels=3, tolerance=5.0)
    exact = grid.shaped(np.where(grid.x > grid.y, np.nan, grid.z))
    np.testing.assert_allclose(found.values, exact, rtol=0, atol=1e-14, equal_nan=True)
    assert found.runs < 0.4 * grid.rows


def test_infinities_of_either_sign_and_nan_are_boundaries_between_each_other():
    """As of margins: minus infinity where a blow ends a run, infinity where nothing does."""
    grid = jxr.Parameters.grid(x=np.linspace(-1.0, 1.0, 65), y=np.linspace(-1.0, 1.0, 33))
    outcomes = ((-jnp.inf, jnp.inf), (jnp.nan, jnp.inf), (-jnp.inf, jnp.nan))
    for low, high in outcomes:
        found = jxr.adaptive_map(lambda p: jnp.where(p.x > p.y, high, low), grid, tolerance=1.0)  # noqa: B023
        exact = grid.shaped(np.where(grid.x > grid.y, high, low))
        np.testing.assert_array_equal(found.values, exact)
        assert found.runs < grid.rows / 2


def test_all_chunks_are_of_one_shape_and_compile_once():
    traced = []

    def outcome(p):
        traced.append(p.x.shape)
        return p.x > p.y

    found = jxr.adaptive_map(outcome, square(65), chunk=50)
    assert traced == [()] and found.spent % 50 == 0 and found.spent - found.runs < 50 * 20


def test_lines_of_a_level_are_those_of_the_one_before_and_halves():
    lines = halved_lines((21, 17), 3)
    assert [a.tolist() for a, _ in lines[:2]] == [[0, 8, 16, 20], [0, 4, 8, 12, 16, 20]]
    for coarse, fine in zip(lines[:-1], lines[1:], strict=True):
        assert all(set(a) <= set(b) for a, b in zip(coarse, fine, strict=True))
    assert [len(x) for x in lines[-1]] == [21, 17]


def test_a_cell_changes_where_any_number_of_a_point_does():
    """Values of two numbers, the second of which changes in one cell; one point is not known."""
    values = np.zeros((3, 3, 2))
    values[0, 0, 1], values[2, 2] = 1.0, 5.0
    known = np.ones((3, 3), bool)
    known[2, 2] = False
    lines = (np.arange(3), np.arange(3))
    np.testing.assert_array_equal(Spread(values, known).exceeds(lines, 0.5), [[True, False], [False, False]])
    values[0, 0, 1] = np.nan
    assert not Spread(values, known).exceeds(lines, 0.5).any()
    whole = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 3]])
    assert Spread(whole, ~known | (whole == 0)).exceeds(lines, 2).tolist() == [[False, False], [False, True]]
    assert not Spread(whole, known).exceeds(lines, 2).any()


def test_a_map_of_runs_has_their_codes():
    """A disc rolls down a slope where its friction is above a third of the tangent, and slips elsewhere."""
    grid = jxr.Parameters.grid(friction=np.linspace(0.05, 0.4, 17), slope=[0.2, 0.5, 0.8])
    run = lambda p: jxr.simulate(  # noqa: E731
        *rolling_disc.on_slope(p.slope, p.friction), 0.3, ts=1, rtol=1e-6, throw=False
    )
    found = jxr.adaptive_map(lambda p: run(p).result, grid, levels=2, chunk=8)
    slips = grid.shaped(3.0 * grid.friction < np.tan(grid.slope))
    codes = [int(code) for code in (jxr.RESULTS.successful, jxr.RESULTS.slipping)]
    np.testing.assert_array_equal(found.values, np.where(slips, codes[1], codes[0]))
    assert found.runs < grid.rows and slips.any() and not slips.all()


BAD = {
    "outcome": ({"outcome": 3}, "argument outcome must be a function"),
    "text": ({"outcome": lambda p: "x"}, "argument outcome must return arrays"),
    "values": ({"outcome": lambda p: float(p["x"])}, "argument outcome must compute with jax.numpy"),
    "names": ({"outcome": lambda p: {"x": p["x"], 1: 1.0}}, "argument outcome must return arrays"),
    "grid": ({"grid": (1, 2)}, "argument grid must be Parameters"),
    "one value": ({"grid": jxr.Parameters.grid(x=[1.0], y=[1.0, 2.0])}, "argument grid must have two values"),
    "no order": ({"grid": jxr.Parameters.grid(x=[0.0, 1.0, 0.2], y=[1.0, 2.0])}, "rise or fall .* but x was"),
    "samples": (
        {"grid": jxr.Parameters.sobol(64, x=(0.0, 1.0), y=(0.0, 1.0))},
        "rise or fall along each axis",
    ),
    "levels": ({"levels": -1}, "argument levels must be a whole number"),
    "chunk": ({"chunk": 0}, "argument chunk must be a whole number"),
    "progress": ({"progress": 1}, "argument progress must be True or False"),
    "no tolerance": ({"outcome": lambda p: p.x}, "argument tolerance must be given"),
    "negative": ({"tolerance": -1.0}, "argument tolerance must not be negative"),
    "for no name": ({"tolerance": {"a": 1.0}}, "argument tolerance must be for names that the outcome has"),
}


@pytest.mark.parametrize("case", BAD)
def test_maps_that_do_not_fit(case):
    changes, words = BAD[case]
    given = {"outcome": lambda p: {"code": p.x > 0.0, "value": p.x}, "grid": square(5)} | changes
    with pytest.raises(ValueError, match=words):
        jxr.adaptive_map(**given)


def test_progress_is_told(capsys):
    jxr.adaptive_map(lambda p: p.x > 0.1, square(9), progress=True)
    assert " runs" in capsys.readouterr().err


def test_cells_of_a_map_end_half_way_between_values_also_at_its_borders():
    np.testing.assert_allclose(
        _edges(Side(np.array([1.0, 2.0, 4.0, 5.0]), "x", False)), [0.5, 1.5, 3.0, 4.5, 5.5]
    )
    rising = Side(np.array([1.0, 4.0, 64.0]), "x", True)
    np.testing.assert_allclose(_edges(rising), [0.5, 2.0, 16.0, 256.0])


def test_a_map_prints_its_size_and_what_was_run():
    grid = jxr.Parameters.grid(x=[0.0, 1.0], y=[0.0, 1.0, 2.0])
    ran = np.array([[True, False, True], [True, True, False]])
    found = AdaptiveMap(grid, {"z": np.arange(6.0).reshape(2, 3)}, ran, spent=8)
    assert repr(found).startswith("AdaptiveMap(2 x 3 points, 4 of them run (66.7%); z: ")


def test_what_went_well_is_pale_and_what_is_not_known_grey():
    codes = ("slipping", "successful", "contact_lost", _map_figure._MISSING, "penetration")
    found = _map_figure.code_colours(codes)
    assert found[1] == _map_figure.WELL and found[3] == _map_figure.NOTHING
    assert [found[i] for i in (0, 2, 4)] == list(_map_figure.CODE_COLOURS[:3])
    verdicts = ("asymptotically stable", "neutral", "unstable", "undamped", "not found")
    well, neutral, unstable, undamped, none = map(to_rgb, _map_figure.code_colours(verdicts))
    assert to_rgb(_map_figure.WELL) == well and len({well, neutral, unstable, undamped, none}) == 5
    assert all(red < blue for red, _, blue in (well, neutral, undamped))
    assert all(red > blue for red, _, blue in (unstable, none))
    many = _map_figure.code_colours(tuple(f"code {i}" for i in range(40)))
    assert len(many) == 40 and _map_figure.WELL not in many


def test_what_stands_between_points_that_were_run():
    """Of five and four lines, every second of which was run and the last: numbers in straight lines."""
    lines = halved_lines((5, 4), 1)
    known = np.zeros((5, 4), bool)
    known[np.ix_([0, 2, 4], [0, 2, 3])] = True
    known[1, 1] = True
    x, y = np.meshgrid([0.0, 1.0, 4.0, 5.0, 9.0], [0.0, 2.0, 3.0, 7.0], indexing="ij")
    values = np.where(known, x * y, -77.0)
    found = between(values, known, lines)
    np.testing.assert_array_equal(found[known], values[known])
    assert found[1, 0] == 0.0 and found[3, 2] == 0.5 * (12.0 + 27.0) and found[4, 1] == 0.5 * 27.0
    assert found[3, 1] == 0.25 * (0.0 + 12.0 + 0.0 + 27.0)
    codes = np.where(known, 10 * np.arange(5)[:, None] + np.arange(4), 99)
    whole = between(codes, known, lines)
    assert whole[3, 2] == 22 and whole[0, 1] == 0 and whole[1, 1] == 11 and whole[1, 3] == 3
    pairs = between(np.stack([values, 2.0 * values], axis=-1), known, lines)
    np.testing.assert_allclose(pairs, np.stack([found, 2.0 * found], axis=-1))
    values[2, 2] = np.nan
    holes = between(values, known, lines)
    assert np.isnan(holes[1, 2]) and holes[0, 1] == 0.0 and holes[4, 2] == 27.0


def test_points_that_are_wanted_are_those_of_cells_that_were_split():
    lines = halved_lines((9, 5), 2)
    nothing = wanted_points(lines, lambda at: np.zeros(tuple(len(a) - 1 for a in at), bool))
    np.testing.assert_array_equal(np.argwhere(nothing), [[i, j] for i in (0, 4, 8) for j in (0, 4)])

    def first(at):
        """Only the first cell changes, whatever its size."""
        cells = np.zeros(tuple(len(a) - 1 for a in at), bool)
        cells[0, 0] = True
        return cells

    found = wanted_points(lines, first)
    wanted = nothing.copy()
    wanted[np.ix_([0, 2, 4], [0, 2, 4])] = True
    wanted[np.ix_([0, 1, 2], [0, 1, 2])] = True
    np.testing.assert_array_equal(found, wanted)


def test_tolerances_are_for_floating_values_by_name_or_for_all():
    of = lambda kind: jax.ShapeDtypeStruct((), kind)  # noqa: E731
    results = {"a": of(float), "b": {"c": of(int), "d": of(float)}, "e": of(float)}
    assert _adaptive._limits(results, 0.5) == [0.5, None, 0.5, 0.5]
    assert _adaptive._limits(results, {"b": 0.25, "e": 0}) == [None, None, 0.25, 0.0]
    assert _adaptive._limits(results, None) == [None] * 4 and _adaptive._limits(of(int), 0.5) == [None]
    for wrong in (of(float), {"a": of(float)}):
        with pytest.raises(ValueError, match="argument tolerance must be given"):
            _adaptive._limits(wrong, None)
    with pytest.raises(ValueError, match="for names that the outcome has, .*no names"):
        _adaptive._limits(of(float), {"a": 1.0})


@pytest.mark.parametrize(("leaf", "real"), [(1, True), (True, True), (2.0, True), (1j, False), ("a", False)])
def test_outcomes_are_real_numbers(leaf, real):
    assert _adaptive._is_real(leaf) == real and _adaptive._is_real(np.asarray([leaf])) == real


@pytest.mark.parametrize(("count", "fine"), [(2, False), (3, True)])
def test_a_measure_over_time_looks_at_three_states_at_least(run, count, fine):
    names = ("ts", "states", "residuals", "multipliers", "energy")
    parts = lambda r: [getattr(r, name) for name in names]  # noqa: E731
    short = eqx.tree_at(parts, run, jax.tree.map(lambda x: np.asarray(x)[:count], parts(run)))
    keep = jxr.measures("energy_lost", "least_force")
    if fine:
        energy = run.energy.kinetic + run.energy.potential
        assert float(keep(short)["energy_lost"]) == float(energy[0] - energy[2])
        return
    with pytest.raises(ValueError, match="argument ts must ask for some tens of times .*run saved 2"):
        keep(short)


def test_kept_measures_are_in_the_order_given_each_once():
    keep = jxr.measures("t_end", "result", "t_end", own=lambda run: run.ts)
    assert keep.names == ("t_end", "result") and list(keep.own) == ["own"]
    assert {name: (each.record, each.timed) for name, each in MEASURES_KEPT.items()} == {
        **dict.fromkeys(("result", "t_end", "steps", "first_event", "margin"), ("", False)),
        **dict.fromkeys(("final_state", "final_pose"), ("", False)),
        **dict.fromkeys(("settling_time", "overshoot", "tracking_error"), ("", True)),
        **dict.fromkeys(("peak_force", "least_force", "friction_demand"), ("multipliers", True)),
        **dict.fromkeys(("energy_lost", "energy_residual"), ("energy", True)),
    }


def test_a_map_sees_what_a_law_holds_now():
    """JAX keeps traces, of runs and of accelerations, by a law's function, whatever it reads holds since."""
    force = [0.0]
    grasp, state = rolling_disc.on_driven_plate(lambda t, joints, rates, tips: [jnp.array([force[0]])])

    def outcome(p):
        start = eqx.tree_at(lambda s: s.v, state, state.v + 0.0 * p["x"])
        return {"plate": jxr.accelerations(grasp, 0.0, start)[3]}

    for force[0] in (0.5, 1.0):
        found = jxr.adaptive_map(outcome, jxr.Parameters.grid(x=[0.0, 1.0]), levels=0, tolerance=1.0)
        np.testing.assert_allclose(found.values["plate"], force[0] / rolling_disc.MOVED, rtol=1e-12)
