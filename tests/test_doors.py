"""Arguments of runs and of all that looks at states: one sentence, or a result; never a traceback."""

import inspect
import pathlib

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll import plotting
from tests.recorded import runs

INF, NAN = float("inf"), float("nan")
NO_NUMBERS = ("1", None, True, 1j, [None], np.array(["a"]), [[1.0], [1.0, 2.0]])
WRONG = {
    "rtol": (*NO_NUMBERS, INF, NAN, 0.0, -1e-8, 1.0, 2.0, [1e-8]),
    "atol": (*(x for x in NO_NUMBERS if x is not None), INF, NAN, 0.0, -1e-8, [1e-8]),  # None stands for rtol
    "dt0": (*NO_NUMBERS, INF, NAN, 0.0, -1e-4, [1e-4]),
    "t0": (*NO_NUMBERS, INF, NAN, 1.0, 2.0, [0.0]),
    "t1": (*NO_NUMBERS, INF, NAN, 0.0, -1.0, [1.0]),
    "ts": (*NO_NUMBERS, [], True, 0, -3, 2.5, [[0.5]], [NAN], [0.5, 0.2], [0.5, 0.5], [2.0], [-0.1], {0.5}),
    "formulation": ("csm", jxr.Index1, 3),
    "record": ("energy", None, 5, [1], ("forces",), np.array(["energy"]), [["energy"]]),
    "events": ("lift", None, True, [None], ("falling",)),
    "max_steps": (0, -1, 2.5, True, None, "many", 10**12, NAN, [4096]),
    "throw": ("no", None, 1, 0.0),
    "solver": ("rk4", diffrax.Dopri5, 3, lambda x: x, diffrax.Euler()),
    "stepsize_controller": ("pid", diffrax.PIDController, diffrax.StepTo([0.0, 1.0])),
    "progress_meter": ("text", diffrax.TextProgressMeter, True),
}
NAMED = {"t0": ("t0", "t1")}


def sentence(call):
    """What a refused call says."""
    with pytest.raises(ValueError) as refused:
        call()
    said = str(refused.value)
    assert said.startswith("argument ") and "\n" not in said and len(said) < 300, said
    return said


@pytest.mark.parametrize("name", WRONG)
def test_an_argument_of_a_run_that_does_not_fit_is_named(scene, name):
    for value in WRONG[name]:
        given = {"t1": 1.0} | {name: value}
        said = sentence(lambda: jxr.simulate(*scene, **given))  # noqa: B023
        assert any(said.startswith(f"argument {word} ") for word in NAMED.get(name, (name,))), said


def test_whatever_is_a_number_is_taken_as_one(scene):
    """Python's, NumPy's and JAX's, whole or not; one program for all."""
    few = {"ts": 1, "rtol": 1e-6}
    known = jxr.simulate(*scene, 1.0, **few)
    for given in (
        {"t1": 1},
        {"t1": np.float32(1.0)},
        {"t1": jnp.asarray(1)},
        {"t0": np.int64(0)},
        {"ts": np.int64(1)},
        {"ts": [1]},
        {"ts": range(1, 2)},
        {"ts": np.asarray([1])},
        {"ts": (jnp.asarray(1.0),)},
        {"rtol": np.asarray(1e-6), "atol": jnp.asarray(1e-6)},
        {"max_steps": np.int32(4096)},
        {"record": [], "events": {"lift": 1, "friction": 2}.keys()},
    ):
        run = jxr.simulate(*scene, **({"t1": 1.0} | few | given))
        np.testing.assert_array_equal(run.states.q, known.states.q)


def test_while_jax_traces_nothing_is_checked(scene):
    """Numbers that are being traced pass, even where they will not do."""
    grasp, state = scene

    def run(t0, t1, ts, tolerances):
        rtol, atol, dt0 = tolerances
        options = {"t0": t0, "ts": ts, "rtol": rtol, "atol": atol, "dt0": dt0}
        return jxr.simulate(grasp, state, t1, **options).states.q

    given = (0.0, 1.0, jnp.asarray([0.5, 1.0]), jnp.full(3, 1e-6))
    assert jax.eval_shape(run, *given).shape == (2, 3)
    assert jax.eval_shape(run, 1.0, 0.0, jnp.asarray([2.0, 1.0]), -jnp.ones(3)).shape == (2, 3)
    many = jax.tree.map(lambda x: jnp.stack([jnp.asarray(x)] * 4), given)
    assert jax.eval_shape(jax.vmap(run), *many).shape == (4, 2, 3)
    # Shapes are known all the same.
    sentence(lambda: jax.eval_shape(run, 0.0, jnp.ones(2), given[2], given[3]))


def states_of_no_use(state):
    """Whatever is no state of one precision and of three numbers."""
    half, single = (jax.tree.map(lambda x, d=d: x.astype(d), state) for d in (jnp.float16, jnp.float32))
    blank = jax.tree.map(lambda x: jnp.full_like(x, NAN), state)
    many = jax.tree.map(lambda x: x[None], state)
    return (None, "state", (state.q, state.v, state.s), state.q, half, single, blank, many)


def test_a_state_that_is_none_of_a_grasp_is_named(scene):
    grasp, state = scene
    for bad in states_of_no_use(state):
        said = sentence(lambda: jxr.simulate(grasp, bad, 1.0, rtol=1e-4))  # noqa: B023
        assert said.startswith("argument state")
        if bad is not None and not (isinstance(bad, jxr.State) and bad.q.dtype == jnp.float32):
            assert sentence(lambda: jxr.close(grasp, bad)).startswith("argument guess")  # noqa: B023
    for swapped in (None, state, "grasp", (grasp, state)):
        for call in (lambda g: jxr.simulate(g, state, 1.0), lambda g: jxr.close(g, state)):
            assert sentence(lambda: call(swapped)).startswith("argument grasp")  # noqa: B023


def test_flags_of_close_are_flags(scene):
    for name in ("hold_contacts", "throw", "locate"):
        for value in ("yes", None, 1):
            said = sentence(lambda: jxr.close(*scene, **{name: value}))  # noqa: B023
            assert said.startswith(f"argument {name} must be True or False")


def doors():
    """Every public function of a grasp and its states or its run, found by its signature."""
    homes = (jxr, jxr.stability, jxr.control, plotting)
    for home in homes:
        for name in getattr(home, "__all__", [n for n in vars(home) if not n.startswith("_")]):
            function = getattr(home, name)
            if not inspect.isfunction(function):
                continue
            names = list(inspect.signature(function).parameters)
            takes = [n for n in ("state", "states", "guess", "trajectory") if n in names]
            if names[:1] == ["grasp"] and takes:
                yield pytest.param(function, names, takes[0], id=f"{home.__name__.split('.')[-1]}.{name}")


DOORS = list(doors())


def test_all_doors_are_found():
    found = {door.id for door in DOORS}
    assert {"jaxroll.residuals", "stability.assess", "plotting.loci", "control.orientations"} <= found
    assert len(found) >= 18


@pytest.fixture(scope="module")
def worlds(scene):
    """Grasps with states of unlike sizes, and a made run of the first."""
    run = runs.run("pivoted", times=2, t1=0.01)
    return {"press": scene, "pinch": runs.scene("pinch"), "space": jxr.scenes.incline()}, run


def called(function, names, takes, grasp, given):
    """A call with whatever else the function needs."""
    blow = jxr.loads.Impulse((0.0, 0.0), 0.0)
    more = {"t1": 1.0, "ts": 0.0, "path": pathlib.Path("none.gif"), "blow": blow, "contacts": [(9.0, 9.0)]}
    needed = inspect.signature(function).parameters
    rest = {n: more[n] for n in names if n in more and needed[n].default is inspect.Parameter.empty}
    return function(**{"grasp": grasp, takes: given} | rest)


@pytest.mark.parametrize(("function", "names", "takes"), DOORS)
def test_a_state_of_another_grasp_is_refused(worlds, function, names, takes):
    scenes, run = worlds
    for other in scenes:
        for own in scenes:
            given = scenes[own][1] if takes != "trajectory" else run
            if own == other or takes == "trajectory" and other == "press":
                continue
            grasp = scenes[other][0]
            assert sentence(lambda: called(function, names, takes, grasp, given))  # noqa: B023
    for grasp, given in ((scenes["press"][0], None), (None, scenes["press"][1])):
        assert sentence(lambda: called(function, names, takes, grasp, given))  # noqa: B023


@pytest.mark.parametrize("name", ["residuals", "energies"])
def test_leading_axes_are_those_of_time(scene, name):
    """Two of them would be taken for coordinates."""
    grasp, state = scene
    batch = jax.tree.map(lambda x: jnp.broadcast_to(x, (4, 3, *x.shape)), state)
    assert "(3,) or (t, 3)" in sentence(lambda: getattr(jxr, name)(grasp, batch))


def test_times_go_with_states(worlds):
    scenes, run = worlds
    grasp, state = scenes["press"]
    for function in (jxr.multipliers, jxr.press_balance):
        for ts in ("1", None, jnp.zeros(3), 0.0):
            assert sentence(lambda: function(grasp, ts, run.states)).startswith("argument ts")  # noqa: B023
        assert sentence(lambda: function(grasp, jnp.zeros(2), state)).startswith("argument ts")  # noqa: B023
    assert sentence(lambda: jxr.multipliers(grasp, 0.0, state, "csm")).startswith("argument formulation")


def test_a_state_of_less_precision_than_its_grasp(scene):
    grasp, state = scene
    single = jax.tree.map(lambda x: x.astype(jnp.float32), state)
    said = sentence(lambda: jxr.simulate(grasp, single, 1.0, rtol=1e-4))
    assert said == "argument state must be of its grasp's float64, but was of float32"


BALL, TABLE = jxr.Sphere(0.1), jxr.Plane()
ROLL = {
    "tip": (None, "ball", jxr.Circle(0.1)),
    "object": (None, jxr.Circle(0.1)),
    "velocity": (None, "fast", lambda t: (1.0, 2.0), lambda t: 1.0, lambda t: "x", lambda t: None),
    "spin": ("fast", 3.0, lambda t: (1.0, 2.0), lambda t: None),
    "ts": (*NO_NUMBERS, [], 2.0, [1.0, 0.0], [0.0, 0.0], [0.0, NAN]),
    "rtol": (*NO_NUMBERS, 0.0, -1.0, INF, NAN, 1.0, [1e-9]),
    "rotation": (*NO_NUMBERS, (0.0, 0.0, 0.0, 0.0), (1.0, 0.0), (NAN, 0.0, 0.0, 0.0)),
    "at_tip": (*NO_NUMBERS, (0.0, 0.0), (INF, 0.0, 0.0)),
    "at_object": (*NO_NUMBERS, (0.0, 0.0), (INF, 0.0, 0.0)),
}


@pytest.mark.parametrize("name", ROLL)
def test_an_argument_of_roll_that_does_not_fit_is_named(name):
    for value in ROLL[name]:
        given = {
            "tip": BALL,
            "object": TABLE,
            "velocity": lambda t: (0.1, 0.0, 0.0),
            "ts": [0.0, 1.0],
            "at_tip": (0.0, 0.0, -0.1),
            "at_object": (0.0, 0.0, 0.0),
        } | {name: value}
        assert sentence(lambda: jxr.roll(**given)).startswith(f"argument {name}")  # noqa: B023


@pytest.mark.parametrize("name", ["pivoted", "incline", "roller"])
def test_what_is_single_stays_single_where_jax_knows_doubles(name):
    """Bodies at rest have Python's own zeros as velocities, and shapes are sampled at doubles."""
    single = lambda x: x.astype(jnp.float32)  # noqa: E731
    grasp, state = jax.tree.map(single, runs.scene(name))
    events = ("lift",) if name == "roller" else ("lift", "penetration")  # an endless line is not sampled

    def numbers(grasp, state):
        options = {"ts": 2, "rtol": 1e-5, "throw": False, "record": ("energy",), "events": events}
        run = jxr.simulate(grasp, state, 0.1, **options)
        here = jxr.energies(grasp, state), jxr.equation_terms(grasp, state)
        return run, here, jxr.torques(grasp, 0.0, state)

    def ends(damping):
        return jxr.simulate(grasp.with_(damping=damping), state, 0.1, ts=1, rtol=1e-5).states.q

    if name == "pivoted":  # what a derivative maps to is looked at where it is lowered
        jax.jit(jax.jacfwd(ends)).lower(np.float32(0.006))
    found = jax.tree.leaves(jax.eval_shape(numbers, grasp, state))
    assert {x.dtype for x in found if jnp.issubdtype(x.dtype, jnp.floating)} == {np.dtype(np.float32)}
