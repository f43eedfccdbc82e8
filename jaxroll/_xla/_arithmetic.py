"""A caller's own function in arithmetic alone, so that a run with it stays one function of the processor.

A matrix product of three numbers by three is a call of a library to XLA, and one such call breaks up the
kernel of a run (`_one_kernel`): 0.9 ms became 31 ms for 0.5 s of `scenes.pinch3d()` under a law with
`jacobian.T @ pull`. So small products and updates at one index are written out. What is left of library calls
is named in a warning.
"""

import functools
import math
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.extend.core as jec
import jax.numpy as jnp
import numpy as np
from jax import Array

from .._results import shown, traceable
from ._one_kernel import inner_programs, misfits

# Products of more terms than this in all are left to a library, which is then faster.
_SMALL = 4096


def in_arithmetic(name: str, function: Callable, *args: Any) -> Any:
    """`function(*args)` with small matrix products and updates at one index written out.

    Warns where operations are left that break up the kernel of a run; `name` is what the caller calls the
    function. A function in which there is nothing to write out is called as it is.
    """
    checked = lambda *args: _numeric(name, function(*args))  # noqa: E731
    with traceable(name):
        if jax.default_backend() != "cpu":
            return checked(*args)
        closed, like, still = eqx.filter_make_jaxpr(checked)(*args)
    if any(_rule(equation) for equation in _equations(closed.jaxpr)):
        flat = [leaf for leaf in jax.tree.leaves(args) if eqx.is_array(leaf)]
        written = functools.partial(_evaluated, closed.jaxpr, closed.consts)
        closed = jax.make_jaxpr(written)(*flat)
        out = eqx.combine(jax.tree.unflatten(jax.tree.structure(like), written(*flat)), still)
    else:
        out = function(*args)
    if left := sorted(misfits(closed.jaxpr)):
        warnings.warn(
            f"argument {name} uses {', '.join(left)}, for which a library is called in every step: runs with "
            "it take many times as long (see `jaxroll/_xla/README.md`)",
            stacklevel=2,
        )
    return out


def _numeric(name: str, given: Any) -> Any:
    """What a function returned, if its arrays hold numbers, all of them, as JAX wants them."""
    for leaf in jax.tree.leaves(given):
        odd = isinstance(leaf, np.ndarray) and leaf.dtype.kind not in "biufc"
        if odd or isinstance(leaf, np.ma.MaskedArray):
            raise ValueError(
                f"argument {name}, in what it returns, must be a real number or an array of them, but was "
                f"{shown(leaf)}"
            )
    return given


def _equations(program: jec.Jaxpr) -> Iterator[Any]:
    """All equations of a program and of those that it calls."""
    for equation in program.eqns:
        yield equation
        for inside in inner_programs(equation.params):
            yield from _equations(inside)


def _evaluated(program: jec.Jaxpr, constants: list[Any], *args: Any) -> list[Any]:
    """What a program gives, with its equations written out where there is a rule."""
    known = dict(zip((*program.constvars, *program.invars), (*constants, *args), strict=True))
    read = lambda atom: atom.val if isinstance(atom, jec.Literal) else known[atom]  # noqa: E731
    for equation in program.eqns:
        values = [read(atom) for atom in equation.invars]
        found = _applied(equation, values)
        known.update(zip(equation.outvars, found, strict=True))
    return [read(atom) for atom in program.outvars]


def _applied(equation: Any, values: list[Any]) -> list[Any]:
    """The results of one equation."""
    if rule := _rule(equation):
        return [rule(*values, **equation.params)]
    params = equation.params
    inside = any(_rule(e) for program in inner_programs(params) for e in _equations(program))
    if inside and equation.primitive.name in ("jit", "pjit"):
        return _evaluated(params["jaxpr"].jaxpr, params["jaxpr"].consts, *values)
    if inside and equation.primitive.name in ("scan", "while", "cond"):
        params = {key: _rewritten(value) for key, value in params.items()}
    out = equation.primitive.bind(*values, **equation.primitive.get_bind_params(params))
    return list(out) if equation.primitive.multiple_results else [out]


def _rewritten(value: Any) -> Any:
    """A program that is a parameter of an equation, written out; anything else as it is."""
    if isinstance(value, tuple):
        return tuple(_rewritten(each) for each in value)
    if not isinstance(value, jec.ClosedJaxpr):
        return value
    shapes = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in value.jaxpr.invars]
    return jax.make_jaxpr(functools.partial(_evaluated, value.jaxpr, value.consts))(*shapes)


def _rule(equation: Any) -> Callable | None:
    """How an equation is written out; None where it stays."""
    name, params = equation.primitive.name, equation.params
    if name == "dot_general":
        left, right = (v.aval.shape for v in equation.invars)
        (summed, _), (batched, _) = params["dimension_numbers"]
        shared = math.prod(left[i] for i in (*summed, *batched))
        return _product if math.prod(left) * math.prod(right) <= _SMALL * max(shared, 1) else None
    if name in ("scatter", "scatter-add"):
        one = equation.invars[1].aval.ndim == 1 and not params["dimension_numbers"].operand_batching_dims
        return functools.partial(_updated, name) if one else None
    return None


def _product(left: Array, right: Array, *, dimension_numbers: Any, **params: Any) -> Array:
    """`jax.lax.dot_general`: axes that are batched first, then those left over of both factors."""
    ((sum_left, sum_right), (batch_left, batch_right)) = dimension_numbers
    free_left = [i for i in range(left.ndim) if i not in (*sum_left, *batch_left)]
    free_right = [i for i in range(right.ndim) if i not in (*sum_right, *batch_right)]
    left = jnp.transpose(left, (*batch_left, *free_left, *sum_left))
    right = jnp.transpose(right, (*batch_right, *free_right, *sum_right))
    kind = params.get("preferred_element_type") or jnp.result_type(left, right)
    count = len(batch_left)
    after = range(count + len(free_left), count + len(free_left) + len(free_right))
    before = range(count, count + len(free_left))
    terms = jnp.expand_dims(left, tuple(after)) * jnp.expand_dims(right, tuple(before))
    axes = tuple(range(terms.ndim - len(sum_left), terms.ndim))
    return jnp.sum(terms.astype(kind), axes) if axes else terms.astype(kind)


def _updated(name: str, operand: Array, indices: Array, updates: Array, **params: Any) -> Array:
    """`x.at[index].set(value)` or `.add(value)`, of one index."""
    numbers = params["dimension_numbers"]
    window = jnp.expand_dims(updates, numbers.inserted_window_dims)
    start, fits = [jnp.zeros((), indices.dtype)] * operand.ndim, jnp.asarray(True)
    for k, axis in enumerate(numbers.scatter_dims_to_operand_dims):
        start[axis] = indices[k]
        fits &= (indices[k] >= 0) & (indices[k] + window.shape[axis] <= operand.shape[axis])
    if name == "scatter-add":
        window = window + jax.lax.dynamic_slice(operand, start, window.shape)
    new = jax.lax.dynamic_update_slice(operand, window.astype(operand.dtype), start)
    clipped = params["mode"] == jax.lax.GatherScatterMode.CLIP
    return new if clipped else jnp.where(fits, new, operand)
