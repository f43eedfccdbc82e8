"""Checks of arguments one by one: what passes, and as what; what is refused at either side of each bound."""

import fractions
import math
import re
from types import SimpleNamespace

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll import _results as checks
from jaxroll._integration import _arguments as run_checks
from tests.measures import programs

DOUBLE, SINGLE = np.dtype(np.float64), np.dtype(np.float32)
IN_TIME = {"dt0": 1e-3, "rtol": 1e-6, "atol": None, "control": None, "dtype": DOUBLE}


def said(function, *args, **options):
    """The sentence with which a call is refused."""
    with pytest.raises(ValueError) as refused:
        function(*args, **options)
    return str(refused.value)


def while_traced(function):
    """What a function makes of a number that JAX is tracing."""
    found = []
    jax.jit(lambda x: (found.append(function(x)), x)[1])(1.0)
    return found[0]


class Unprintable:
    def __repr__(self):
        raise RuntimeError


class Lines:
    def __repr__(self):
        return "one\n  and   two"


class Word:
    def __init__(self, text):
        self.text = text

    def __repr__(self):
        return self.text


def test_what_is_quoted_is_short_and_on_one_line():
    assert checks.shown(Lines()) == "one and two"
    assert checks.shown(Unprintable()) == "a Unprintable"
    assert checks.shown(Word(80 * "x")) == 80 * "x"
    assert checks.shown(Word(76 * "x" + "yyyyy")) == 76 * "x" + " ..."
    assert checks.shown(np.arange(12.0)) == str(list(range(12))).replace(",", ".0,").replace("]", ".0]")
    assert checks.shown(np.arange(13)) == "an array of shape (13,) that begins with [0, 1, 2]"
    assert checks.shown(np.ones((2, 7))) == "an array of shape (2, 7) that begins with [1.0, 1.0, 1.0]"
    assert checks.shown(jnp.array([2.5])) == "[2.5]" and checks.shown(np.float64(0.25)) == "0.25"
    assert checks.shown([1, 2]) == "[1, 2]" and checks.shown("word") == "'word'"
    assert while_traced(checks.shown) == "a traced array of shape ()"
    assert while_traced(lambda x: checks.shown([x, 2])) == "[a traced array of shape (), 2]"
    assert while_traced(lambda x: checks.shown((x, [x[None]]))) == (
        "(a traced array of shape (), [a traced array of shape (1,)])"
    )


def test_what_the_system_says_of_a_path_is_quoted_without_the_path():
    assert checks.told("here", OSError(2, "No such file", "here")) == "'here': No such file"
    assert checks.told("here", TimeoutError()) == "'here': TimeoutError"


def test_what_is_traced_has_no_value():
    assert while_traced(checks.traced) and while_traced(lambda x: checks.traced([1.0, {"a": x}]))
    assert not checks.traced(1.0) and not checks.traced({1: 2.0, "a": 3.0})
    assert while_traced(checks.concrete) is None
    np.testing.assert_array_equal(checks.concrete([1, 2]), [1, 2])


def test_a_function_of_known_numbers_refuses_traced_ones_by_name():
    told = "argument {} must hold known numbers, but JAX is tracing some"

    @checks.on_host
    def drawn(first, second=2.0):
        return first, second

    assert drawn(1.0) == (1.0, 2.0) and drawn(1.0, second=3.0) == (1.0, 3.0)
    assert while_traced(lambda x: said(drawn, x)).startswith(told.format("first"))
    assert while_traced(lambda x: said(drawn, 1.0, x)).startswith(told.format("second"))
    assert while_traced(lambda x: said(drawn, 1.0, second=x)).startswith(told.format("second"))
    assert while_traced(lambda x: said(drawn, first=x)).startswith(told.format("first"))


def test_a_function_of_known_numbers_computes_at_once_while_others_are_traced():
    known = checks.on_host(lambda points: float(jnp.sum(jnp.asarray(points) ** 2)))
    assert while_traced(lambda x: known([3.0, 4.0])) == 25.0


class OfTorch:
    """Another library's array, which says how it becomes one of NumPy."""

    def __init__(self, values):
        self.values = values

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self.values, dtype)


class OfJax:
    def __jax_array__(self):
        return jnp.array([1.5, 2.5])


class Text(str):
    """Text that converts, which is no number for all that."""

    def __float__(self):
        return 1.0


CODE = jxr.RESULTS.slipping
NUMBERS = {
    "a number": (2, 2.0),
    "a fraction": (fractions.Fraction(1, 4), 0.25),
    "nested lists": ([[1, 2.5], [3, 4]], [[1.0, 2.5], [3.0, 4.0]]),
    "a range": (range(3), [0.0, 1.0, 2.0]),
    "whole numbers": (np.array([1, 2], np.int8), [1.0, 2.0]),
    "of JAX": (jnp.array([1, 2]), [1.0, 2.0]),
    "another library's": (OfTorch([1, 2]), [1.0, 2.0]),
    "one that JAX asks": (OfJax(), [1.5, 2.5]),
    "a list of arrays": ([np.array([1.0, 2.0]), (3, 4)], [[1.0, 2.0], [3.0, 4.0]]),
}
NO_NUMBERS = {
    "text": "1.0",
    "text that converts": Text("1.0"),
    "bytes": b"1",
    "nothing": None,
    "a flag": True,
    "a flag in a list": [1.0, True],
    "a flag further in": [[1.0, 2.0], (3.0, False)],
    "flags": np.array([True]),
    "a code": CODE,
    "a code in a list": [1.0, CODE],
    "complex": 1j,
    "complex ones": np.array([1j]),
    "complex ones in a list": [1.0, 1j],
    "ragged": [[1.0], [1.0, 2.0]],
    "an object": object(),
    "objects": np.array([object()]),
    "words": np.array(["a"]),
    "keys": {"a": 1.0},
    "a set": {1.0},
    "too large": 10**400,
}


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_become_floating_arrays(name):
    given, wanted = NUMBERS[name]
    found = checks.as_array("x", given)
    assert isinstance(found, jax.Array) and found.dtype == float
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("name", NO_NUMBERS)
def test_what_holds_no_real_numbers_is_refused(name):
    wanted = "argument x must be a real number or an array of them, but was "
    assert said(checks.as_array, "x", NO_NUMBERS[name]) == wanted + checks.shown(NO_NUMBERS[name])


def test_numbers_of_single_precision_stay_so_and_known_ones_stay_known():
    assert checks.as_array("x", np.float32(0.5)).dtype == np.float32
    assert while_traced(lambda x: checks.traced(checks.as_array("x", [1, 2.0]))) is False
    assert while_traced(lambda x: checks.traced(checks.as_array("x", [1.0, x]))) is True
    with pytest.raises(jax.errors.JAXTypeError):  # the caller's own mistake: NumPy cannot hold it
        while_traced(lambda x: checks.as_array("x", OfTorch(x)))


def test_what_is_computed_at_once_is_compiled_once(caplog):
    """To `jax.ensure_compile_time_eval` functions are others: a check would compile what a caller has."""
    twice = jax.jit(lambda x: jnp.concatenate([x, 2.0 * jnp.ones(3)]))

    def asked(x):
        with checks.computed_at_once():
            return np.asarray(twice(x))

    known = np.zeros(5)
    twice(known)
    with jax.log_compiles():
        np.testing.assert_array_equal(asked(known), [0.0] * 5 + [2.0] * 3)
    assert programs(caplog) == []
    assert while_traced(lambda x: isinstance(asked(known), np.ndarray)) is True


def test_tables_of_numpy_are_copied_and_compile_nothing(caplog):
    given = [np.arange(1000.0 + k)[:, None] for k in range(8)]  # some where JAX would share memory
    with jax.log_compiles():
        found = [checks.as_array("x", x) for x in given]
    assert programs(caplog) == []
    for x in given:
        x[:] = -1.0
    assert all(x[1].tolist() == [1.0] for x in found)


def test_shapes_are_compared_axis_by_axis():
    fits = checks.as_floats("x", [[1, 2, 3]], (None, 3))
    np.testing.assert_array_equal(fits, [[1.0, 2.0, 3.0]])
    told = "argument x must have shape {}, but had shape {}"
    assert said(checks.as_floats, "x", [[1, 2, 3]], (None, 2)) == told.format("(any, 2)", "(1, 3)")
    assert said(checks.as_floats, "x", [[1, 2, 3]], (3, None)) == told.format("(3, any)", "(1, 3)")
    assert said(checks.as_floats, "x", [1, 2], (2, None)) == told.format("(2, any)", "(2,)")
    assert said(checks.as_floats, "x", [1, math.nan], (2,)) == "argument x must be finite, but was [1.0, nan]"


def test_counts_are_whole_numbers_within_bounds():
    assert checks.as_count("n", 1) == 1 and checks.as_count("n", 10**6) == 10**6
    assert type(checks.as_count("n", np.int8(3))) is int
    assert checks.as_count("n", 0, least=0) == 0 and checks.as_count("n", 9, most=9) == 9
    for bad in (0, -1, 1.0, True, "1", None):
        assert said(checks.as_count, "n", bad).startswith(
            "argument n must be a whole number of at least 1, but"
        )
    assert (
        said(checks.as_count, "n", 4, least=5) == "argument n must be a whole number of at least 5, but was 4"
    )
    assert said(checks.as_count, "n", 10**6 + 1) == "argument n must be at most 1000000, but was 1000001"
    assert said(checks.as_count, "n", 10, most=9) == "argument n must be at most 9, but was 10"


def test_flags_and_choices_are_of_their_own_kind():
    assert checks.check_flag("on", np.True_) is True and checks.check_flag("on", False) is False
    assert said(checks.check_flag, "on", 1) == "argument on must be True or False, but was 1"
    assert checks.check_choice("kind", 2, (1, 2)) == 2
    for bad in (3, True, 1.0, "1"):
        told = f"argument kind must be one of 1, 2, but was {bad!r}"
        assert said(checks.check_choice, "kind", bad, (1, 2)) == told


def test_several_are_one_or_a_collection_of_one_kind():
    assert checks.as_several("x", 1, int, "whole numbers") == (1,)
    for given in ([1, 2], (1, 2), iter([1, 2])):
        assert checks.as_several("x", given, int, "whole numbers") == (1, 2)
    for bad in ([], [1, 2.0], {1, 2}, 1.0, None):
        assert said(checks.as_several, "x", bad, int, "whole numbers").startswith(
            "argument x must be one or more whole numbers, but was "
        )


def test_a_function_takes_as_many_arguments_as_it_is_given():
    one, any_number = (lambda x: x), (lambda *x: x)
    for good, takes in ((one, None), (one, 1), (any_number, 5), (lambda x, y=1: x, 2), (max, 7)):
        assert checks.check_callable("f", good, takes=takes) is good
    unknown = type("Unknown", (), {"__call__": one, "__signature__": 3})()
    assert checks.check_callable("f", unknown, takes=2) is unknown
    for bad, takes in ((one, 2), (one, 0), (lambda x, *, y: x, 1), (int, None), (3, None)):
        assert said(checks.check_callable, "f", bad, "a law", takes=takes).startswith(
            "argument f must be a law, but was "
        )
    assert said(checks.check_callable, "f", 3) == "argument f must be a function, but was 3"
    two = lambda x: lambda a, /, b=x, *rest, c: a  # noqa: E731
    assert said(checks.check_callable, "f", two("\n" * 99), "a law", takes=1) == (
        "argument f must be a law, but was callable as f(a, /, b, *rest, c)"
    )


def test_orders_of_smoothness_are_numbers_that_floats_hold_or_infinity():
    for good in (0, 2, 1.5, math.inf, np.int64(3), np.float64(2.0), int(1e300)):
        found = checks.as_order(good)
        assert type(found) is float and found == good
    assert checks.as_order(2, least=2) == 2.0
    told = "argument smoothness must be a number of derivatives or infinity, but was "
    for bad in (-1, math.nan, True, "2", None, 10**309):
        assert said(checks.as_order, bad).startswith(told)
    assert said(checks.as_order, 1, least=2) == (
        "argument smoothness must be a number of derivatives of 2 or more, or infinity, but was 1"
    )


def test_shares_are_from_zero_to_one():
    for good in (0, 1, 0.25, np.float32(0.5)):
        found = checks.as_share("part", good)
        assert type(found) is float and found == good
    for bad in (-1e-9, 1.0 + 1e-9, math.nan, [0.5]):
        told = f"argument part must be a number from 0 to 1, but was {bad}"
        assert said(checks.as_share, "part", bad) == told
    traced = while_traced(lambda x: said(checks.as_share, "part", x))
    assert traced.startswith("argument part must be known before tracing")


def test_positive_numbers_directions_lengths_and_intervals():
    assert float(checks.as_positive("x", 1e-300)) == 1e-300
    assert said(checks.as_positive, "x", 0) == "argument x must be positive, but was 0.0"
    assert said(checks.check_positive, "x", np.array([1.0, -2.0])).endswith("but was [1.0, -2.0]")
    for good in ([0.0, 1e-100], [[3.0, 0.0], [0.0, -4.0]]):
        np.testing.assert_array_equal(checks.check_direction("way", np.array(good)), good)
    for bad, told in (
        ([0.0, 0.0], "not be zero, but was [0.0, 0.0]"),
        ([[1.0, 0.0], [0.0, 0.0]], "not be zero, but was [0.0, 0.0]"),
        ([1e200, 1e200], "be of a length whose square is a number, but was [1e+200, 1e+200]"),
    ):
        assert said(checks.check_direction, "way", np.array(bad)) == f"argument way must {told}"
    assert [float(checks.as_length("a", x)) for x in (1e-12, 1e9)] == [1e-12, 1e9]
    for bad in (0.9e-12, 1.1e9):
        told = f"argument a must lie between 1e-12 and 1e+09 m, but was {bad:g}"
        assert said(checks.as_length, "a", bad) == told
    checks.check_between("x", 2.0, 2.0, 3.0)
    checks.check_between("x", 3.0, 2.0, 3.0)
    for bad in (1.9, 3.1):
        assert said(checks.check_between, "x", bad, 2, 3) == (
            f"argument x must lie between 2 and 3, but was {bad}"
        )
    for given in ((2.5, 2.0, 1.0), (0.0, 2.0, 3.0)):  # whatever is traced is not looked at
        for i in range(3):
            while_traced(
                lambda x, i=i, given=given: checks.check_between("x", *given[:i], x, *given[i + 1 :])
            )
    for check in (checks.check_positive, checks.check_direction, checks.check_finite):
        assert while_traced(lambda x, check=check: check("x", x) is x)


def test_the_sentence_of_a_code():
    assert checks.message(jxr.RESULTS.successful) == "successful"
    assert checks.message(jxr.RESULTS.joint_limit) == "A joint is at the end of its range."


def numbers(*times, **changes):
    """Times and tolerances of a run, as it takes them."""
    return run_checks.as_numbers(*times, **(IN_TIME | changes))


def test_the_numbers_of_a_run_are_arrays_of_its_precision():
    found = numbers(1.0, 3.0, 5)
    np.testing.assert_allclose(found.ts, [1.0, 1.5, 2.0, 2.5, 3.0], rtol=1e-15)
    assert [float(x) for x in (found.t0, found.t1, found.dt0, found.rtol, found.atol)] == [
        1.0,
        3.0,
        1e-3,
        1e-6,
        1e-6,
    ]
    assert float(numbers(1.0, 3.0, 5, atol=1e-9).atol) == 1e-9
    assert numbers(1.0, 3.0, 1).ts.tolist() == [3.0]
    assert numbers(1.0, 3.0, np.int64(2)).ts.tolist() == [1.0, 3.0]
    single = numbers(1.0, 3.0, 4, rtol=1e-5, dtype=SINGLE)
    assert {np.asarray(x).dtype for x in single} == {SINGLE}
    assert {np.asarray(x).dtype for x in found} == {DOUBLE}
    listed = numbers(1, 3, [1, 2.5, 3])
    assert listed.ts.tolist() == [1.0, 2.5, 3.0] and isinstance(listed.ts, np.ndarray)
    assert isinstance(numbers(1, 3, (1, 2)).ts, np.ndarray)


def test_numbers_of_python_are_converted_once():
    assert numbers(1.0, 3.0, 5) is numbers(1.0, 3.0, 5)
    assert numbers(1.0, 3.0, 2) is not numbers(1.0, 3.0, np.int64(2))
    assert said(numbers, 1.0, 3.0, 2.0).startswith("argument ts must be a number of times, or times of shape")
    assert numbers(1.0, 3.0, 5, atol=1e-7) is not numbers(1.0, 3.0, 5)
    for number, plain in ((1, True), (1.5, True), (2**53 - 1, True), (-(2**53) + 1, True), (2**53, False)):
        assert run_checks._plain(number) is plain
    assert not any(map(run_checks._plain, (True, np.float64(1.0), "1", None, -(2**53))))


def test_an_array_of_ones_own_kind_is_looked_at():
    kept = run_checks.as_number("x", np.array([1, 2]), DOUBLE)
    assert kept.dtype == DOUBLE and isinstance(kept, np.ndarray)
    for bad in (np.array([True]), np.array([1j]), [1.0, True], "1"):
        assert said(run_checks.as_number, "x", bad, DOUBLE).startswith("argument x must be a real number")
    assert while_traced(lambda x: checks.traced(run_checks.as_number("x", x, SINGLE)))
    assert while_traced(lambda x: run_checks.as_number("x", x, SINGLE).dtype) == SINGLE
    assert isinstance(run_checks.as_number("x", jnp.ones(2), DOUBLE), np.ndarray)


REFUSED_TIMES = {
    "two numbers": (
        (0.0, 1.0, 5),
        {"dt0": [0.1, 0.2]},
        "argument dt0 must be one number, but had shape (2,)",
    ),
    "endless": ((0.0, math.inf, 5), {}, "argument t1 must be finite, but was inf"),
    "no start": ((math.nan, 1.0, 5), {}, "argument t0 must be finite, but was nan"),
    "no time": ((2.0, 2.0, 5), {}, "argument t1 must be above t0 = 2, but was 2"),
    "backwards": ((2.0, 1.0, 5), {}, "argument t1 must be above t0 = 2, but was 1"),
    "no first step": ((0.0, 1.0, 5), {"dt0": 0.0}, "argument dt0 must be positive, but was 0"),
    "a first step back": ((0.0, 1.0, 5), {"dt0": -0.1}, "argument dt0 must be positive, but was -0.1"),
    "a first step of nothing": (
        (1e9, 2e9, 5),
        {"dt0": 1e-8},
        "argument dt0 must be long enough to move time from 1e+09 s, but was 1e-08",
    ),
    "late": ((1.0, 2.0, [1.5, 2.5]), {}, "argument ts must lie within [1, 2], but ran from 1.5 to 2.5"),
    "early": ((1.0, 2.0, [0.5, 1.5]), {}, "argument ts must lie within [1, 2], but ran from 0.5 to 1.5"),
    "equal": ((1.0, 2.0, [1.5, 1.5]), {}, "argument ts must rise strictly, but was [1.5, 1.5]"),
    "no number": ((1.0, 2.0, [1.5, math.nan]), {}, "argument ts must be finite, but was [1.5, nan]"),
    "only infinite": ((1.0, 2.0, [math.inf]), {}, "argument ts must be finite, but was [inf]"),
    "none": (
        (1.0, 2.0, []),
        {},
        "argument ts must be a number of times, or times of shape (t,), but had shape (0,)",
    ),
    "a table": (
        (1.0, 2.0, [[1.5]]),
        {},
        "argument ts must be a number of times, or times of shape (t,), but had shape (1, 1)",
    ),
    "a flag": ((1.0, 2.0, True), {}, "argument ts must be a real number or an array of them, but was True"),
    "too many": ((1.0, 2.0, 10**7 + 1), {}, "argument ts must be at most 10000000, but was 10000001"),
    "rtol of one": ((1.0, 2.0, 3), {"rtol": 1.0}, "argument rtol must be below 1, but was 1"),
    "no atol": ((1.0, 2.0, 3), {"atol": 0.0}, "argument atol must be positive, but was 0"),
}


@pytest.mark.parametrize("name", REFUSED_TIMES)
def test_times_and_tolerances_of_a_run_are_refused(name):
    times, changes, sentence = REFUSED_TIMES[name]
    assert said(numbers, *times, **changes) == sentence


def test_times_of_a_run_may_be_its_bounds():
    assert numbers(1.0, 2.0, [1.0, 2.0]).ts.tolist() == [1.0, 2.0]
    run_checks.check_times(np.array([5.0, 6.0]))  # without bounds
    while_traced(lambda x: run_checks.check_times(jnp.stack([x, x])))
    assert float(numbers(1.0, 2.0, 3, atol=5.0).atol) == 5.0
    assert float(numbers(1.0, 2.0, 3, rtol=0.99).rtol) == 0.99


def test_tolerances_of_a_control_are_those_of_the_run():
    control = diffrax.PIDController(rtol=1e-4, atol=1e-5)
    asked = {"rtol": run_checks.RTOL, "control": control}
    assert [float(x) for x in numbers(1.0, 2.0, 3, **asked)[-2:]] == [1e-4, 1e-5]
    assert [float(x) for x in numbers(1.0, 2.0, 3, **(asked | {"rtol": 1e-4, "atol": 1e-5}))[-2:]] == [
        1e-4,
        1e-5,
    ]
    told = "argument {} must be left to the stepsize_controller, whose own is {:g}, but was {:g}"
    assert said(numbers, 1.0, 2.0, 3, **(asked | {"rtol": 1e-3})) == told.format("rtol", 1e-4, 1e-3)
    assert said(numbers, 1.0, 2.0, 3, **(asked | {"atol": 1e-3})) == told.format("atol", 1e-5, 1e-3)
    steady = numbers(1.0, 2.0, 3, control=diffrax.ConstantStepSize())
    assert [float(x) for x in steady[-2:]] == [1e-6, 1e-6]


def test_tolerances_that_are_traced_are_not_a_number_where_they_are_not_allowed():
    of = jax.jit(
        lambda x: [run_checks.tolerance(n, x, DOUBLE) for n in ("rtol", "atol", "stepsize_controller.atol")]
    )
    assert [[float(y) for y in of(x)] for x in (0.5, 1.0, 3.0)] == [
        [0.5, 0.5, 0.5],
        [pytest.approx(math.nan, nan_ok=True), 1.0, 1.0],
        [pytest.approx(math.nan, nan_ok=True), 3.0, 3.0],
    ]
    assert np.isnan([of(x) for x in (0.0, -1.0)]).all()


def test_a_tolerance_must_be_one_that_the_precision_can_meet():
    least = np.float32(1e-5)
    assert run_checks.tolerance("rtol", float(least), SINGLE) == least
    for known, remedy in (
        (True, "give the grasp and its state numbers of it"),
        (False, "put jax.config.update('jax_enable_x64', True) first"),
    ):
        with jax.enable_x64(known):
            assert said(run_checks.tolerance, "rtol", 0.9e-5, SINGLE) == (
                "argument rtol must be at least 1e-05 in single precision, but was 9e-06; "
                f"for double precision {remedy}"
            )
    assert run_checks.tolerance("rtol", 1e-12, DOUBLE) == 1e-12
    assert run_checks.tolerance("atol", 1e-12, SINGLE) == np.float32(1e-12)


def test_how_often_a_step_returns_to_the_constraints():
    of = lambda rtol, atol: SimpleNamespace(rtol=rtol, atol=atol)  # noqa: E731
    assert run_checks.sweeps(of(1e-8, 1e-8), False) == 1
    assert run_checks.sweeps(of(1e-8, 1.1e-8), False) == 2
    assert run_checks.sweeps(of(1.1e-8, 1e-9), False) == 2
    assert run_checks.sweeps(of(1e-8, 1e-8), True) == 2
    assert while_traced(lambda x: run_checks.sweeps(of(x, 1e-9), False)) == 2


def test_names_are_chosen_among_those_known():
    known = ("one", "two")
    for good in ([], ["two"], ("two", "one"), {"one"}, ["one", "one"]):
        assert run_checks.check_choices("record", good, known) == tuple(good)
    told = "argument record must be among ('one', 'two'), but was "
    for bad in (["three"], [1], 3, None, b"one", {"one": 1}, np.array(["one"]), ["one", "three"]):
        assert said(run_checks.check_choices, "record", bad, known).startswith(told)
    string = "argument record must be a tuple of names, such as ({!r},), but was the string {!r}"
    assert said(run_checks.check_choices, "record", "two", known) == string.format("two", "two")
    assert said(run_checks.check_choices, "record", "three", known) == string.format("one", "three")


def test_methods_controls_meters_and_limits_of_steps():
    assert run_checks.check_control(None) is None and run_checks.check_meter(None) is None
    for good in (diffrax.ConstantStepSize(), diffrax.PIDController(rtol=1e-6, atol=1e-6)):
        assert run_checks.check_control(good) is good
    meter = diffrax.TextProgressMeter()
    assert run_checks.check_meter(meter) is meter
    assert (
        said(run_checks.check_meter, 3)
        == "argument progress_meter must be a diffrax progress meter, but was 3"
    )
    assert isinstance(run_checks.check_solver(None), diffrax.Dopri8)
    method = diffrax.Tsit5()
    assert run_checks.check_solver(method) is method
    assert run_checks.step_limit(2**31 - 2) == 2**31 - 2 and run_checks.step_limit(1) == 1
    assert (
        said(run_checks.step_limit, 2**31 - 1)
        == "argument max_steps must be at most 2147483646, but was 2147483647"
    )
    assert re.match("argument max_steps must be a whole number of at least 1", said(run_checks.step_limit, 0))
