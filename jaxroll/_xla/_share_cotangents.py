"""Derivatives whose numbers are worked out once, where nobody can write `once`.

A transposed program is made by JAX: what its numbers are used for is seen only when it is there. It is gone
through operation by operation, and what several others read gets the barrier that `once` is.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.extend.core as jec
import jax.numpy as jnp
from jax.interpreters.partial_eval import dce_jaxpr

from ._primitives import barrier

# Operations on one number that cost no more than to read it, or that XLA does not copy.
_FREE = frozenset(
    ("neg", "broadcast_in_dim", "convert_element_type", "squeeze", "reshape", "copy", "div", "barrier")
)
# Calls whose insides are gone through.
_CALLS = frozenset(("jit", "custom_jvp_call"))


def shared(function: Callable) -> Callable:
    """A function in which every number that several others use is computed once.

    For derivatives, where there is no place to write `once`.

    Args:
        function: Of pytrees of arrays, to a pytree of arrays. It is not to be differentiated afterwards.
    """

    def wrapped(*args: Any) -> Any:
        if jax.default_backend() != "cpu":
            return function(*args)
        closed, shapes = jax.make_jaxpr(function, return_shape=True)(*args)
        jaxpr, used = dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars))
        wanted = [leaf for leaf, keep in zip(jax.tree.leaves(args), used, strict=True) if keep]
        return jax.tree.unflatten(jax.tree.structure(shapes), _run(jaxpr, closed.consts, wanted))

    return wrapped


def pulled(function: Callable) -> Callable:
    """A function whose cotangents share what they use more than once.

    The function is evaluated again for them: to keep its intermediate values takes longer, above all to
    compile.
    """

    def mapped(*args: Any) -> Any:
        plain, moving, still = _apart(function, args)
        call = jax.custom_vjp(plain)
        back = shared(lambda moving, still, bars: jax.vjp(lambda x: plain(x, still), moving)[1](bars)[0])
        call.defvjp(lambda *both: (call(*both), both), lambda both, bars: (back(*both, bars), None))
        return call(moving, still)

    return mapped


def pushed(function: Callable) -> Callable:
    """A function whose tangents share what they use more than once."""

    def mapped(*args: Any) -> Any:
        plain, moving, still = _apart(function, args)
        call = jax.custom_jvp(plain)
        ahead = shared(lambda moving, still, ways: jax.jvp(lambda x: plain(x, still), (moving,), (ways,)))
        call.defjvp(lambda both, ways: ahead(*both, ways[0]))
        return call(moving, still)

    return mapped


def _apart(function: Callable, args: Any) -> tuple[Callable, Any, Any]:
    """A function of the arguments that have a derivative, and of all other arrays; and both of them.

    Its rule for a derivative may not close over the latter, such as whole numbers in a caller's law, or gains
    of a formulation where `function` is a method: those of a loop are traced no more when the rule is asked.
    """
    moving, still = eqx.partition(args, eqx.is_inexact_array)
    arrays, rest = eqx.partition((function, still), eqx.is_array)

    def plain(moving: Any, arrays: Any) -> Any:
        function, still = eqx.combine(arrays, rest)
        return function(*eqx.combine(moving, still))

    return plain, moving, arrays


def _run(jaxpr: jec.Jaxpr, consts: Sequence[Any], args: Sequence[Any]) -> list[Any]:
    """Evaluate a program, what it calls included, with barriers where a number is used again."""
    uses = Counter(v for e in jaxpr.eqns for v in {*filter(_is_name, e.invars)})
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *args], strict=True))
    read = lambda v: known[v] if _is_name(v) else v.val  # noqa: E731
    for equation in jaxpr.eqns:
        out = _called(equation, [read(v) for v in equation.invars])
        for name, value in zip(equation.outvars, out, strict=True):
            again = uses[name] > 1 and _is_number(name) and _worth(equation)
            known[name] = barrier(value) if again else value
    return [read(v) for v in jaxpr.outvars]


def _called(equation: Any, given: list[Any]) -> list[Any]:
    inner = equation.params.get("jaxpr" if equation.primitive.name == "jit" else "call_jaxpr")
    if equation.primitive.name in _CALLS:
        return _run(inner.jaxpr, inner.consts, given)
    out = equation.primitive.bind(*given, **equation.primitive.get_bind_params(equation.params))
    return list(out) if equation.primitive.multiple_results else [out]


def _is_name(atom: Any) -> bool:
    return not isinstance(atom, jec.Literal)


def _is_number(name: Any) -> bool:
    return name.aval.shape == () and jnp.issubdtype(name.aval.dtype, jnp.floating)


def _worth(equation: Any) -> bool:
    return equation.primitive.name not in _FREE and equation.primitive.name not in _CALLS
