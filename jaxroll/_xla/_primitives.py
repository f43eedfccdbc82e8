"""Operations of our own for JAX: a barrier, a mark for the compiler, a linear map with a given transpose.

As primitives they are one entry each of a traced program, and the insides of a map are traced only where
they are compiled: a gradient in reverse mode does not trace the forward map beside it.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.extend.core as jec
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.mlir import ir
from jax.extend.mlir.dialects import stablehlo
from jax.interpreters import ad, batching, mlir

from ._collector import uncollected
from ._stored import stored

_BARRIER, _MARK, _MAP = jec.Primitive("barrier"), jec.Primitive("mark"), jec.Primitive("linear_map")
_MAP.multiple_results = True
# What is said, after its name, of a result of which a second derivative is asked.
ONCE = "has first derivatives only: for second ones take differences of its gradient"


def barrier(x: Any) -> jax.Array:
    """The same number, by a division that XLA keeps and LLVM drops; tangents and cotangents likewise."""
    return _BARRIER.bind(jnp.asarray(x))


def _divided(context: mlir.LoweringRuleContext, x: Any) -> list[Any]:
    """A division by a one that is worked out: NaN where the first number of its block equals NaN.

    XLA cannot tell that nothing does, and so keeps the divisions; LLVM can. All barriers of one block and one
    shape divide by the same: with a one of its own for each, programs have a third to a half more lines. XLA
    copies the comparison into every division: of all ways to make a one that LLVM sees through at every
    place, this is the shortest (a conversion of the comparison would be shorter, but is now and then stored,
    and divides).
    """
    kind: Any = context.avals_in[0]
    # What was lowered once for a module is kept here by JAX, and goes with the module.
    known = context.module_context.cached_primitive_lowerings
    here: Any = ir.InsertionPoint.current
    key = (_BARRIER, here.block, kind.shape, kind.dtype)
    if key not in known:
        nan, one = (mlir.ir_constant(np.full(kind.shape, c, kind.dtype)) for c in (np.nan, 1.0))
        differs = stablehlo.compare(x, nan, stablehlo.ComparisonDirectionAttr.get("NE"))
        known[key] = stablehlo.select(differs, one, nan)
    return [stablehlo.divide(x, known[key])]


# Outside of programs, as where JAX compiles none (`jax.disable_jit`), there is nothing to work out once.
_BARRIER.def_impl(lambda x: x)
_BARRIER.def_abstract_eval(lambda x: x)
# Not cacheable: JAX would share a lowered barrier among blocks, and what it divides by belongs to one.
mlir.register_lowering(_BARRIER, _divided, cacheable=False)
ad.deflinear2(_BARRIER, lambda bar, _: [_BARRIER.bind(bar)])
batching.defvectorized(_BARRIER)


def mark(x: Any, attributes: tuple[tuple[str, str], ...]) -> jax.Array:
    """The same array; what it comes from has these attributes where one device alone runs the program.

    A program that JAX shares out among devices is cut up by XLA, with exchanges between the parts: a call
    that was to become one function of the processor could not hold these, and would not compile. Within
    `jax.shard_map` every device runs its own.
    """
    return _MARK.bind(x, attributes=attributes)


def _attached(context: mlir.LoweringRuleContext, x: Any, *, attributes: tuple) -> list[Any]:
    where: Any = context.module_context.axis_context
    shared_out = getattr(where, "num_devices", 1) != 1
    if hasattr(where, "manual_axes"):
        shared_out = set(where.manual_axes) != set(where.mesh.axis_names)
    if not shared_out and not isinstance(x.owner, ir.Block):
        given = x.owner.attributes
        more: dict[str, Any] = {key: ir.StringAttr.get(value) for key, value in attributes}
        more |= {a.name: a.attr for a in given.get(_ATTRIBUTES, ())}
        given[_ATTRIBUTES] = ir.DictAttr.get(more)
    return [x]


_ATTRIBUTES = "mhlo.frontend_attributes"
_MARK.def_impl(lambda x, **_: x)
_MARK.def_abstract_eval(lambda x, **_: x)
# Not cacheable: JAX would put the mark into a function, where it does not see the operation to be marked.
mlir.register_lowering(_MARK, _attached, cacheable=False)
ad.deflinear2(_MARK, lambda bar, _, **__: [bar])
batching.defvectorized(_MARK)


def linear_map(apply: Callable, transpose: Callable, at: Any, x: Any, *, like: Any) -> Any:
    """`apply(at, x)`, linear in x and differentiable in both modes; its transpose is `transpose(at, bar)`.

    Args:
        apply: Of two pytrees of arrays, to one as `like`; it must not close over traced arrays.
        transpose: From `at` and cotangents of the result, to cotangents of x.
        at: What else the map depends on; its own derivative is refused.
        x: Floating-point arrays.
        like: Arrays with the shapes and dtypes of the result.
    """
    arrays, still = eqx.partition(at, eqx.is_array)
    fixed, at_form = jax.tree.flatten(arrays)
    given, x_form = jax.tree.flatten(x)
    wanted, out_form = jax.tree.flatten(like)
    there = _Way(apply, still, at_form, x_form, out_form)
    back = _Way(transpose, still, at_form, out_form, x_form)
    kinds = tuple(ShapedArray(jnp.shape(leaf), jnp.result_type(leaf)) for leaf in wanted)
    out = _MAP.bind(*fixed, *given, there=there, back=back, kinds=kinds, fixed=len(fixed))
    return jax.tree.unflatten(out_form, out)


@dataclass(frozen=True, eq=False)
class _Way:
    """One way of a linear map, as a function of lists of arrays."""

    function: Callable
    still: Any
    at_form: Any
    x_form: Any
    out_form: Any

    def __call__(self, at: Sequence[Any], x: Sequence[Any]) -> list[Any]:
        whole = eqx.combine(jax.tree.unflatten(self.at_form, at), self.still)
        return self.out_form.flatten_up_to(self.function(whole, jax.tree.unflatten(self.x_form, x)))


@dataclass(frozen=True, eq=False)
class _Ways:
    """A way for many lanes: those of `at` along the axes `dims`, None where they share it."""

    one: Callable
    dims: tuple[int | None, ...]
    size: int

    def __call__(self, at: Sequence[Any], x: Sequence[Any]) -> list[Any]:
        return jax.vmap(self.one, in_axes=(self.dims, 0), axis_size=self.size)(at, x)


def _mapped(*args: Any, there: Callable, back: Callable, kinds: tuple, fixed: int) -> list[Any]:
    return there(args[:fixed], args[fixed:])


def _compiled(context: mlir.LoweringRuleContext, *args: Any, **params: Any) -> Any:
    """The way that is asked for, traced here or read from a file."""
    module, way = context.module_context, functools.partial(_mapped, **params)
    # A stored program is one for a single processor.
    alone = module.platforms == ("cpu",) and getattr(module.axis_context, "num_devices", 0) == 1
    with uncollected():
        program = stored(way, (params["there"], params["fixed"]), context.avals_in) if alone else way
        return mlir.lower_fun(program, multiple_results=True)(context, *args)


def _tangents(primals: Sequence[Any], dots: Sequence[Any], **params: Any) -> tuple[Any, Any]:
    fixed = params["fixed"]
    if not all(type(dot) is ad.Zero for dot in dots[:fixed]):
        raise NotImplementedError(f"this result {ONCE}")
    filled = map(ad.instantiate_zeros, dots[fixed:])
    return _MAP.bind(*primals, **params), _MAP.bind(*primals[:fixed], *filled, **params)


def _cotangents(
    bars: Sequence[Any], *args: Any, there: Callable, back: Callable, fixed: int, **_: Any
) -> list:
    kinds = tuple(x.aval for x in args[fixed:])
    filled = map(ad.instantiate_zeros, bars)
    out = _MAP.bind(*args[:fixed], *filled, there=back, back=there, kinds=kinds, fixed=fixed)
    return [None] * fixed + out


def _lanes(
    args: Sequence[Any], dims: Sequence[Any], *, there: Callable, back: Callable, **params: Any
) -> tuple:
    """Every lane has its own x, whatever else they share."""
    fixed = params["fixed"]
    size = next(x.shape[d] for x, d in zip(args, dims, strict=True) if d is not None)
    own = [
        jnp.moveaxis(x, d, 0) if d is not None else jnp.broadcast_to(x, (size, *jnp.shape(x)))
        for x, d in zip(args[fixed:], dims[fixed:], strict=True)
    ]
    each = [_Ways(f, tuple(dims[:fixed]), size) for f in (there, back)]
    kinds = tuple(ShapedArray((size, *kind.shape), kind.dtype) for kind in params["kinds"])
    out = _MAP.bind(*args[:fixed], *own, there=each[0], back=each[1], kinds=kinds, fixed=fixed)
    return out, [0] * len(out)


_MAP.def_impl(_mapped)
_MAP.def_abstract_eval(lambda *_, kinds, **__: list(kinds))
mlir.register_lowering(_MAP, _compiled)
ad.primitive_jvps[_MAP] = _tangents
ad.primitive_transposes[_MAP] = _cotangents
batching.primitive_batchers[_MAP] = _lanes
