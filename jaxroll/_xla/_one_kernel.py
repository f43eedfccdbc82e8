"""Loops over little data as one compiled function, where XLA would have its CPU runtime call every kernel."""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.extend.core as jec
import jax.numpy as jnp
from jax.tree_util import Partial

from ._primitives import linear_map, mark, ONCE

# XLA's CPU compiler turns a call with these attributes into one function; without them, and on other
# devices, the program is the same, only slower (measured: 5 against 27 us a step).
_ATTRIBUTES = (("xla_cpu_small_call", "true"), ("inlineable", "false"))
# What that compiler path is known to take: control flow, indexing and arithmetic, but no library calls
# (linear algebra, sorting, callbacks) and no scatters.
_STRUCTURE = """
add_any bitcast_convert_type broadcast_in_dim closed_call concatenate cond convert_element_type copy copy_p
custom_jvp_call custom_vjp_call custom_vmap_call dynamic_slice dynamic_update_slice empty2 gather iota jit
nonbatchable optimization_barrier pad pjit remat2 reshape reshard scan select_if_vmap select_n slice split
squeeze stack stop_gradient transpose unstack unvmap_any unvmap_max while
"""
_ARITHMETIC = """
abs acos acosh add and argmax argmin asin asinh atan atan2 barrier cbrt ceil clamp cos cosh div eq eq_to erf
exp exp2 expm1 floor ge gt integer_pow is_finite le le_to log log1p logistic lt lt_to max min mul ne neg
nextafter not or pow reduce_and reduce_or rem round rsqrt shift_left shift_right_arithmetic
shift_right_logical sign sin sinh sqrt square sub tan tanh xor
"""
# `jax.random`'s generator, and what makes normal numbers of its bits.
_RANDOM = "erf_inv random_bits random_fold_in random_unwrap random_wrap threefry2x32"
_KNOWN = frozenset((_STRUCTURE + _ARITHMETIC + _RANDOM).split())
_REDUCTIONS = frozenset(("reduce_max", "reduce_min", "reduce_sum"))
# For `jax.jit`: XLA uses vectors of 256 bits unless told otherwise; with 512 a batch takes a tenth less time.
WIDE = {"xla_cpu_prefer_vector_width": 512}
# How many numbers of double precision such a vector holds.
VECTOR = 8
# Larger reductions of numbers are handed to a library.
_SMALL = 1024


def one_kernel(function: Callable, *args: Any) -> Any:
    """`function(*args)`, compiled into one function of the processor where that is possible.

    Args:
        function: Of pytrees, to a pytree of arrays; it must not close over traced arrays.
        args: Its arguments.

    Where an operation is not known to fit (see the lists above), the call is an ordinary one. Under
    `vmap` the mapped function is tried in its turn.
    """
    arrays, rest = eqx.partition(args, eqx.is_array)
    whole = lambda arrays: function(*eqx.combine(arrays, rest))  # noqa: E731

    def lanes(size: int, batched: Any, arrays: Any) -> Any:
        return one_kernel(side_by_side(whole, size, batched), arrays)

    return with_lanes(lambda arrays: _marked(whole, arrays), lanes, arrays)


def with_lanes(function: Callable[[Any], Any], lanes: Callable[[int, Any, Any], Any], arrays: Any) -> Any:
    """`function(arrays)`; under `vmap` what `lanes` gives, every result with a leading axis.

    Args:
        function: Of a pytree of arrays, to such a pytree.
        lanes: Of how many lanes there are, of every array whether each lane has its own, and of the arrays.
        arrays: The pytree.

    A single lane, as `jacfwd` in one number asks for, is the function itself without the axis: such a
    derivative of `scenes.pinch3d` then takes 13 s to compile, not 21 s. With no lanes there is nothing to
    compute, and loops over them could not begin: the results are empty arrays.
    """

    @jax.custom_batching.custom_vmap
    def call(arrays: Any) -> Any:
        return function(arrays)

    @call.def_vmap
    def _(size: int, batched: list[Any], arrays: Any) -> tuple[Any, Any]:
        if size == 1:
            alone = jax.tree.map(lambda x, own: jnp.squeeze(x, 0) if own else x, arrays, batched[0])
            out = jax.tree.map(lambda x: jnp.expand_dims(x, 0), call(alone))
        elif size == 0:
            out = _of_none(function, batched[0], arrays)
        else:
            out = lanes(size, batched[0], arrays)
        return out, jax.tree.map(lambda _: True, out)

    return call(arrays)


def _of_none(function: Callable[[Any], Any], batched: Any, arrays: Any) -> Any:
    """What a function gives for an empty batch, from the shapes of what it gives for one lane."""
    alone = lambda x, own: jax.ShapeDtypeStruct(x.shape[1:] if own else x.shape, x.dtype)  # noqa: E731
    like = jax.eval_shape(function, jax.tree.map(alone, arrays, batched))
    return jax.tree.map(lambda x: jnp.zeros((0, *x.shape), x.dtype), like)


def side_by_side(function: Callable[[Any], Any], size: int, batched: Any) -> Callable[[Any], Any]:
    """The function of all lanes by `jax.vmap`; `batched` as `lanes` of `with_lanes` is given it."""
    axes = jax.tree.map(lambda own: 0 if own else None, batched)
    return jax.vmap(function, (axes,), axis_size=size)


def perturbed(values: Any, tangents: Any) -> tuple[Any, Any, Any]:
    """Of the values in a rule of `equinox.filter_custom_jvp`: the arrays that move, all else, the tangents.

    Each has None in the places of what it leaves out. A derivative in few of many numbers is then a program
    of these alone. That matters because a kernel computes all its results, whether they are read or not.
    """
    moves = lambda x, dot: x if dot is not None and eqx.is_inexact_array(x) else None  # noqa: E731
    moving = jax.tree.map(moves, values, tangents)
    still = jax.tree.map(lambda x, moves: x if moves is None else None, values, moving)
    return moving, still, jax.tree.map(lambda _, dot: dot, moving, tangents)


def without_derivative(values: Any, told: str) -> Any:
    """The values as they are; a derivative that is asked in them is refused with `told`, not zero."""
    return eqxi.nondifferentiable(values, msg=told)


def differentiable_once(values: Any, result: str) -> Any:
    """The values, in a rule for a derivative of `result`: another one of that is refused in a sentence."""
    return without_derivative(values, f"{result} {ONCE}")


def in_turn(function: Callable, shared: Any, *rows: Any) -> Any:
    """`function(shared, *row)` for all rows of some arrays, in turn and in one kernel; differentiable, once.

    Side by side the rows of a long function would take many times as long to compile.
    """

    def each(shared: Any, rows: Any) -> Any:
        return jax.lax.map(lambda row: function(shared, *row), rows)

    return in_both_modes(lambda *args: one_kernel(each, *args), (shared, rows), forwards=each, backwards=each)


def in_both_modes(function: Callable, args: Any, *, forwards: Callable, backwards: Callable) -> Any:
    """`function(*args)`, differentiated forwards through `forwards` and backwards through `backwards`.

    All three compute the same; JAX can differentiate `forwards` forwards and `backwards` backwards. There are
    no second derivatives.
    """

    @eqx.filter_custom_jvp
    def call(args: Any) -> Any:
        return function(*args)

    @call.def_jvp
    def _(primals: Any, tangents: Any) -> tuple[Any, Any]:
        moving, still, dots = perturbed(primals[0], tangents[0])
        out = function(*primals[0])
        moved = eqx.filter(out, eqx.is_inexact_array)
        at = Partial(forwards), Partial(backwards), moving, still
        return out, linear_map(_pushed, _pulled, at, dots, like=moved)

    return call(args)


def _pushed(at: Any, dots: Any) -> Any:
    function, _, moving, still = at
    return jax.jvp(lambda moving: _moved(function, moving, still), (moving,), (dots,))[1]


def _pulled(at: Any, bars: Any) -> Any:
    _, function, moving, still = at
    return jax.vjp(lambda moving: _moved(function, moving, still), moving)[1](bars)[0]


def _moved(function: Callable, moving: Any, still: Any) -> Any:
    """The floating-point arrays of the result."""
    return eqx.filter(function(*eqx.combine(moving, still)), eqx.is_inexact_array)


def _marked(function: Callable, arrays: Any) -> Any:
    """The call as one operation, with the attributes if it fits."""
    leaves, form = jax.tree.flatten(arrays)
    kinds = [jnp.result_type(leaf) for leaf in leaves]
    widest = _widest(kinds)
    if jax.default_backend() != "cpu" or widest is None:
        return function(arrays)
    shapes = [jnp.shape(leaf) for leaf in leaves]

    def unpacked(numbers: jax.Array) -> Any:
        parts = zip(_split(numbers, shapes), kinds, strict=True)
        # Two results at least. XLA cuts large operations into parts for its threads, and where the single
        # result is one of them its emitter fails ("Incorrect number of arguments passed to called function"):
        # 2048 starts closed at once did not compile.
        return function(jax.tree.unflatten(form, [_as_kind(*part) for part in parts])), numbers[:1]

    # One operand: XLA's emitter aborts on operands of such a call that are not used.
    numbers = jnp.concatenate([_as_kind(jnp.ravel(leaf), widest) for leaf in leaves])
    compiled = jax.jit(unpacked)
    out, tree = jax.tree.flatten(compiled(numbers)[0])
    if not misfits(compiled.trace(numbers).jaxpr.jaxpr):
        out[0] = mark(out[0], _ATTRIBUTES)
    return jax.tree.unflatten(tree, out)


def _as_kind(numbers: jax.Array, kind: Any) -> jax.Array:
    """The numbers as those of another kind, or back: whole numbers of 64 bits keep their bits.

    Above 2^53 not every whole number is a double.
    """
    kinds = {jnp.dtype(kind), numbers.dtype}
    if len(kinds) == 2 and kinds & {jnp.dtype("int64"), jnp.dtype("uint64")}:
        return jax.lax.bitcast_convert_type(numbers, kind)
    return numbers.astype(kind)


def _widest(kinds: list[Any]) -> Any:
    """The dtype of one vector that can hold numbers of all these, or None.

    Keys of `jax.random` are no numbers to JAX, and nothing else holds them.
    """
    floats = {kind for kind in kinds if jnp.issubdtype(kind, jnp.floating)}
    keys = any(jnp.issubdtype(kind, jax.dtypes.prng_key) for kind in kinds)
    exact = floats == {jnp.dtype("float64")} and not keys or len(floats) == len(set(kinds)) == 1
    return floats.pop() if exact else None


def _split(numbers: jax.Array, shapes: list[tuple[int, ...]]) -> list[jax.Array]:
    parts, start = [], 0
    for shape in shapes:
        size = math.prod(shape)
        parts.append(jax.lax.slice_in_dim(numbers, start, start + size).reshape(shape))
        start += size
    return parts


def misfits(program: jec.Jaxpr) -> set[str]:
    """Names of the operations, in all that is called too, that the single function may not hold."""
    found = set()
    for equation in program.eqns:
        name = equation.primitive.name
        small = all(math.prod(getattr(v.aval, "shape", ())) <= _SMALL for v in equation.invars)
        if name not in _KNOWN and not (name in _REDUCTIONS and small):
            found.add(name)
        for inside in inner_programs(equation.params):
            found |= misfits(inside)
    return found


def inner_programs(params: dict[str, Any]) -> list[jec.Jaxpr]:
    """The programs among the parameters of an operation."""
    kinds = (jec.Jaxpr, jec.ClosedJaxpr)
    found = jax.tree.leaves(list(params.values()), is_leaf=lambda x: isinstance(x, kinds))
    return [x.jaxpr if isinstance(x, jec.ClosedJaxpr) else x for x in found if isinstance(x, kinds)]
