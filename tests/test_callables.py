"""Callers' own laws, loads and commands: as quick as built-in ones, or told why not."""

import dataclasses
import functools
import math
import types
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._closures import opened
from jaxroll._xla import _arithmetic, in_arithmetic
from jaxroll._xla._one_kernel import misfits
from tests.subjects import rolling_disc
from tests.subjects.driven_plate import driven_plate


def operations(function, *args):
    """Names of the operations of a function that a run's kernel could not hold."""
    return misfits(jax.make_jaxpr(lambda *args: in_arithmetic("law", function, *args))(*args).jaxpr)


A = jnp.arange(12.0).reshape(3, 4) - 5.0
B = jnp.cos(jnp.arange(20.0)).reshape(4, 5)


@pytest.mark.parametrize(
    "function",
    [
        lambda a, b: a @ b,
        lambda a, b: jnp.einsum("ij,kj->ik", a, a),
        lambda a, b: jnp.einsum("ij,jk,ij->k", a, b, a),
        lambda a, b: jnp.outer(a[0], b[0]),
        lambda a, b: jnp.dot(a[0], b[:, 0]),
        lambda a, b: jax.vmap(jnp.dot)(a, 2.0 * a),
        lambda a, b: a.at[1].set(b[0, :4]),
        lambda a, b: a.at[1, 2].add(3.0),
        lambda a, b: a.at[7].set(1.0),  # out of bounds: dropped
        lambda a, b: a.at[7, 0].add(1.0, mode="clip"),
        lambda a, b: a.at[-1].set(b[0, :4]),
        lambda a, b: a.at[-8].set(1.0),
        lambda a, b: jax.jit(lambda x: x @ b)(a),
        lambda a, b: jax.lax.fori_loop(0, 3, lambda i, x: x @ (b @ b.T) * 0.1, a),
        lambda a, b: jax.lax.cond(a[0, 0] > 0, lambda x: x @ b, lambda x: -x @ b, a),
        lambda a, b: jax.lax.scan(lambda x, row: (x, row @ b), 0.0, a)[1],
        lambda a, b: {"sum": (a @ b).sum(), "none": None, "text": 3.0},
    ],
)
def test_products_and_updates_written_out_are_the_same(function):
    """In value and derivative; nothing is left that calls a library."""
    assert not operations(function, A, B)
    total = lambda f: lambda a, b: sum(jnp.sum(x**2) for x in jax.tree.leaves(f(a, b)))  # noqa: E731

    @jax.jit
    def both(a, b):
        written = lambda a, b: in_arithmetic("law", function, a, b)  # noqa: E731
        return [(f(a, b), jax.grad(total(f), argnums=(0, 1))(a, b)) for f in (written, function)]

    (found, slopes), (wanted, true) = both(A, B)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-13, atol=1e-13), found, wanted)
    for x, y in zip(slopes, true, strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-12)


def test_what_calls_a_library_is_named_and_large_products_stay():
    with pytest.warns(UserWarning, match="argument law uses .*lu"):
        in_arithmetic("law", lambda a: jnp.linalg.solve(a[:3, :3] + 9.0 * jnp.eye(3), a[:, 0]), A)
    large = jnp.ones((80, 80))
    with pytest.warns(UserWarning, match="dot_general"):
        in_arithmetic("law", lambda a: a @ a, large)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        in_arithmetic("law", lambda a: jnp.sin(a) @ B, A)


@pytest.mark.parametrize(
    "given",
    [np.array([object(), 1.0]), np.array(["a", "b"]), np.ma.masked_array([1.0, 2.0], [False, True])],
)
def test_arrays_without_numbers_are_refused_by_name(scene, given):
    grasp, state = scene
    with pytest.raises(ValueError, match="^argument controller, in what it returns, must be a real number"):
        jxr.simulate(grasp.with_(controller=lambda t, angles, rates, tips: [given]), state, 0.1)


def test_a_law_of_ones_own_keeps_a_run_in_one_kernel(scene):
    """The built-in law written with arrays: its motion, and no operation that would break up the kernel."""
    grasp, state = scene
    law = grasp.controller

    def own(t, angles, rates, tips):
        pull = law.stiffness * (tips[0].position - law.target)
        return (-law.damping * rates[0] - tips[0].jacobian.T @ pull,)

    acted = grasp.with_(controller=own)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = jxr.simulate(acted, state, 0.2, ts=3)
    np.testing.assert_allclose(run.last.q, jxr.simulate(grasp, state, 0.2, ts=3).last.q, rtol=0, atol=1e-10)
    text = jax.jit(lambda c: jxr.simulate(acted.with_(gravity=c), state, 0.2, ts=3).last.q).lower(np.zeros(2))
    assert "dot_general" not in text.as_text() and "xla_cpu_small_call" in text.as_text()


def pushing(gain):
    """A law of one's own as a closure; of a function that closes over the gain in its turn."""

    def pull(tip):
        return gain * tip.jacobian.T @ (tip.position - jnp.array([0.03, 0.0]))

    def law(t, angles, rates, tips):
        return tuple(-0.005 * w - pull(tip) for w, tip in zip(rates, tips, strict=True))

    return law


def pushed_to(law):
    """Where a disc is on a plate that a law has pushed for a moment."""
    grasp, state = rolling_disc.on_driven_plate(law)
    return jxr.simulate(grasp, state, 0.02, ts=1, rtol=1e-11, throw=False).last.q[0]


@pytest.fixture(scope="module")
def pushed():
    """The same under `pushing`, with its derivative in the gain."""
    return jax.jit(jax.value_and_grad(lambda gain: pushed_to(pushing(gain))))


def test_what_a_law_closes_over_has_a_derivative_and_lanes(pushed):
    """The number is traced, not known: the same as from a pytree of one's own."""
    law = lambda gain, *given: pushing(gain)(*given)  # noqa: E731
    wanted = lambda gain: float(pushed_to(jax.tree_util.Partial(law, jnp.asarray(gain))))  # noqa: E731
    value, slope = map(float, pushed(30.0))
    assert abs(slope) > 1e-6
    np.testing.assert_allclose(value, wanted(30.0), rtol=1e-12)
    # The grasp is an argument of the program that the pytree goes through: it is compiled once.
    np.testing.assert_allclose(slope, (wanted(30.03) - wanted(29.97)) / 0.06, rtol=1e-6)
    lanes = jax.jit(jax.vmap(lambda gain: pushed_to(pushing(gain))))(np.array([30.0, 60.0]))
    np.testing.assert_allclose(lanes, [value, wanted(60.0)], rtol=1e-12)


@dataclasses.dataclass
class Square:
    """A function with a number, as Python writes one: no pytree, and compared by its number."""

    gain: float

    def __call__(self, x):
        return self.gain * x**2

    def of(self, x):
        return self(x)


@pytest.mark.parametrize(
    "hiding",
    [
        lambda gain: lambda x: gain * x**2,
        lambda gain: lambda x, gain=gain: gain * x**2,
        lambda gain: lambda x, *, gain=gain: gain * x**2,
        lambda gain: functools.partial(lambda gain, x: gain * x**2, gain),
        lambda gain: functools.partial(lambda x, gain: gain * x**2, gain=gain),
        lambda gain: (lambda inner: lambda x: inner(x) * x)(lambda x: gain * x),
        lambda gain: (lambda held: lambda x: held["gain"][0] * x**2)({"gain": (gain, "N")}),
        lambda gain: Square(gain),
        lambda gain: Square(gain).of,
        lambda gain: (lambda held: lambda x: held.of(x))(Square(gain)),
        lambda gain: types.SimpleNamespace(held=Square(gain)).held.of,
        lambda gain: (lambda held: lambda x: held.inner.gain * x**2)(
            types.SimpleNamespace(inner=Square(gain))
        ),
        lambda gain: jax.jit(Square(gain).of),
        lambda gain: (lambda inner: lambda x: inner(x))(jax.jit(lambda x: gain * x**2)),
        lambda gain: jax.checkpoint(lambda x: gain * x**2),
    ],
)
def test_traced_numbers_are_found_wherever_a_function_hides_them(hiding):
    def square(gain):
        function = opened(hiding(gain))
        assert [leaf is gain for leaf in jax.tree.leaves(function) if isinstance(leaf, jax.Array)] == [True]
        return function(3.0)

    assert jax.value_and_grad(square)(2.0) == (18.0, 9.0)


def test_an_object_that_refers_to_itself_or_to_much_is_looked_into_and_ends():
    def square(gain):
        held = Square(gain)
        held.again, held.many = held, [types.SimpleNamespace(of=[k]) for k in range(2000)]
        function = opened(held.of)
        assert any(leaf is gain for leaf in jax.tree.leaves(function))
        return function(3.0)

    assert jax.value_and_grad(square)(2.0) == (18.0, 9.0)


@dataclasses.dataclass
class Law:
    """A law as a dataclass of Python's, which has no hash."""

    gain: float

    def __call__(self, *given):
        return pushing(self.gain)(*given)


def test_a_law_may_be_an_object_of_python(pushed):
    """Its runs are those of a function with the same number, known or traced; so is the derivative in it."""
    both = jax.jit(jax.value_and_grad(lambda gain: pushed_to(Law(gain))))
    found, wanted = ([f(gain) for gain in (30.0, 60.0)] for f in (both, pushed))
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
    np.testing.assert_allclose(pushed_to(Law(60.0)), wanted[1][0], rtol=1e-12)
    assert abs(wanted[0][0] - wanted[1][0]) > 1e-6


def test_what_curves_loads_and_commands_close_over_has_a_derivative():
    def ellipse(a):
        return jxr.Parametric(
            lambda u: jnp.stack([a * jnp.cos(u), 0.02 * jnp.sin(u)]), (0.0, 2.0 * np.pi), closed=True
        )

    radius = lambda a: 1.0 / ellipse(a).curvature(0.0)  # noqa: E731, b^2 / a at the vertex
    a = np.array([0.01, 0.012, 0.016])
    radii, slopes = jax.jit(jax.vmap(jax.value_and_grad(radius)))(a)
    np.testing.assert_allclose(radii, 0.02**2 / a, rtol=1e-8)
    np.testing.assert_allclose(slopes, -(0.02**2) / a**2, rtol=1e-6)

    def end(x):
        turn, ramp = x
        grasp, state = driven_plate(load=lambda t, pose, twist: (jnp.zeros(2), 0.01 * turn))
        own = grasp.with_(force=lambda t: 0.5 + ramp * t)
        return jxr.simulate(own, state, 0.05, ts=1, rtol=1e-10, atol=1e-12).last.q[0]

    x, steps, found = jnp.array([0.1, 0.5]), np.diag([1e-3, 1e-2]), jax.jit(jax.value_and_grad(end))
    wanted = [(found(x + step)[0] - found(x - step)[0]) / (2.0 * step.max()) for step in steps]
    assert np.abs(wanted).min() > 1e-6
    np.testing.assert_allclose(found(x)[1], wanted, rtol=1e-6)


def test_functions_that_hide_nothing_stay_as_they_are():
    table, told = jnp.arange(3.0), {1: "a", "b": 2}
    plain = lambda t: table[0] * t if told else t  # noqa: E731
    assert opened(plain) is plain
    again = functools.partial(plain, 2.0)
    assert opened(again) is again
    inside = []

    def looked_at(x):
        law = lambda t: (told, x * t)[1]  # noqa: E731
        inside.append((opened(law), opened(law), law))
        return inside[-1][0](2.0)

    assert jax.jit(looked_at)(3.0) == 6.0
    first, second, law = inside[0]
    assert jax.tree.structure(first) == jax.tree.structure(second) and first is not law


def test_functions_of_one_text_with_other_variables_or_defaults_are_others():
    def structures(x):
        power = lambda t, n=2: x * t**n  # noqa: E731
        same, other, bare = (types.FunctionType(*_parts(power)) for _ in range(3))
        same.__defaults__, other.__defaults__, bare.__defaults__ = (2,), (3,), None
        found.extend(jax.tree.structure(opened(each)) for each in (power, same, other, bare))
        return x

    found = []
    jax.make_jaxpr(structures)(1.0)
    power, same, other, bare = found
    assert power == same and other != power and bare != power


def _parts(function):
    return function.__code__, function.__globals__, function.__name__, None, function.__closure__


@pytest.mark.parametrize(
    "function",
    [
        lambda t, angles, rates, tips: [np.sin(x) for x in angles],
        lambda t, angles, rates, tips: [x if x[0] > 0 else -x for x in angles],
        lambda t, angles, rates, tips: [math.sin(t) * x for x in angles],
    ],
)
def test_a_law_that_asks_for_values_is_answered_in_a_sentence(function):
    grasp, state = jxr.scenes.pivoted()
    with pytest.raises(ValueError, match=r"argument controller must compute with jax\.numpy, and choose"):
        jxr.simulate(grasp.with_(controller=function), state, 0.1, ts=1)
    with pytest.raises(ValueError, match=r"argument force.* must compute with jax\.numpy"):
        grasp.with_(force=lambda t: np.sin(t))


@pytest.mark.parametrize(("rows", "columns", "written"), [(64, 64, True), (64, 65, False), (4096, 1, True)])
def test_products_of_4096_terms_are_written_out_and_larger_ones_are_not(rows, columns, written):
    """As many as rows times columns times the length that they share, here one."""
    left, right = jnp.ones((rows, 1)), jnp.ones((1, columns))
    program = jax.make_jaxpr(lambda a, b: jax.lax.dot(a, b))(left, right)
    assert (_arithmetic._rule(program.eqns[0]) is not None) == written
    shared = jax.make_jaxpr(lambda a: jax.lax.dot(a, a.T))(jnp.ones((8, 64 if written else 65)))
    assert (_arithmetic._rule(shared.eqns[-1]) is not None) == written


def test_products_over_other_axes_are_those_of_jax():
    """Two axes summed, one in common, and the kind of number that is asked for."""
    rng = np.random.default_rng(0)
    left, right = jnp.asarray(rng.normal(size=(2, 3, 4, 5))), jnp.asarray(rng.normal(size=(5, 2, 6, 4)))
    for numbers in ((((2, 3), (3, 0)), ((0,), (1,))), (((3,), (0,)), ((), ())), (((), ()), ((0,), (1,)))):
        wanted = jax.lax.dot_general(left, right, numbers)
        found = _arithmetic._product(left, right, dimension_numbers=numbers)
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-13)
    small = _arithmetic._product(
        left, right, dimension_numbers=(((3,), (0,)), ((), ())), preferred_element_type=jnp.float32
    )
    assert small.dtype == jnp.float32
