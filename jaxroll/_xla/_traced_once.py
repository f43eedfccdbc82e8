"""What a value and its derivative have in common, traced once.

Of a function with a rule for its derivative JAX traces the function, and then the rule, which begins by
computing the same. A compiled function that both call is still traced twice: the mesh of devices is part of
the key of JAX's cache of traces, and inside a rule that is an empty mesh, elsewhere none.
"""

import functools
from collections.abc import Callable
from typing import Any, cast, TypeVar

import equinox as eqx
import jax

_Function = TypeVar("_Function", bound=Callable[..., Any])
_NO_MESH = jax.sharding.AbstractMesh((), ())


def traced_once(function: _Function) -> _Function:
    """`equinox.filter_jit`, whose trace a function and the rule for its derivative share."""
    compiled = eqx.filter_jit(function)

    @functools.wraps(function)
    def call(*args: Any, **named: Any) -> Any:
        if not jax.sharding.get_abstract_mesh().empty:
            return compiled(*args, **named)
        with jax.sharding.use_abstract_mesh(_NO_MESH):
            return compiled(*args, **named)

    return cast(_Function, call)
