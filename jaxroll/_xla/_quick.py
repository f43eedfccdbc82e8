"""Programs that are compiled quickly, because they run seldom and on little data.

XLA's CPU compiler takes two to three times as long for machine code that is two to five times as quick. A run
is worth that; a start, a balance of forces along a run or an outline to be drawn, which are ready within
milliseconds either way, are not.
"""

import functools
from collections.abc import Callable
from typing import Any, cast, Concatenate, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._results import computed_at_once, traced, traces_nothing

_P = ParamSpec("_P")
_R = TypeVar("_R")
_Function = TypeVar("_Function", bound=Callable[..., Any])
# XLA's older way from fusions to LLVM, which writes less for small ones, and machine code in one piece, not
# in 32. Compiling takes a sixteenth less processor time and no more time by the clock, since most of a
# program is one function. A run is as quick as with the default.
SOON = {"xla_cpu_use_fusion_emitters": False, "xla_cpu_parallel_codegen_split_count": 1}
# The same without optimisation by LLVM.
QUICK = SOON | {"xla_backend_optimization_level": 0}
# The same with LLVM's first level: a program as quick as with the default, in half the time to compile.
BRISK = SOON | {"xla_backend_optimization_level": 1}


def quickly(function: _Function) -> _Function:
    """`equinox.filter_jit` with options by which XLA compiles sooner and the program runs slower.

    A program takes options only as a whole: where JAX is tracing, for a caller's own program or a derivative,
    and on other devices, this is `equinox.filter_jit` as it is.
    """
    return _with_options(function, QUICK)


def briskly(function: _Function) -> _Function:
    """`quickly` for a program that seldom runs, but then at thousands of places, each of which takes long.

    A field of splines at 512 places takes 0.2 s longer to compile and a seventh of the time to run.
    """
    return _with_options(function, BRISK)


def soon(function: _Function) -> _Function:
    """`quickly` for programs that are run often enough to be fully optimised.

    `jaxroll design` takes a fifth less processor time with it. Gradients and batches of runs gain nothing.
    """
    return _with_options(function, SOON)


def _with_options(function: _Function, options: dict[str, Any]) -> _Function:
    """A compiled function, with options of the compiler where the program is a whole one of the processor."""
    usual = eqx.filter_jit(function)
    quick = eqx.filter_jit(function, compiler_options=options)  # pyright: ignore

    @functools.wraps(function)
    def call(*args: Any, **named: Any) -> Any:
        return (quick if takes_options((args, named)) else usual)(*args, **named)

    return cast(_Function, call)


def at_once(function: Callable[Concatenate[Any, _P], _R]) -> Callable[_P, _R]:
    """A small function of arrays that NumPy computes where all numbers are known.

    Its first argument is the module that computes, `numpy` or `jax.numpy`. JAX compiles a program of 30 to 50
    ms for each such function, or each operation in it, and `scenes.pinch3d` had ten of them.
    """
    compiled = jax.jit(functools.partial(function, jnp), inline=True)

    @functools.wraps(function)
    def call(*args: _P.args, **named: _P.kwargs) -> _R:
        # Numbers of Python, of a weak type, take the precision of arrays that they meet; NumPy's do not.
        kinds = {leaf.weak_type for leaf in jax.tree.leaves((args, named)) if isinstance(leaf, jax.Array)}
        if len(kinds) > 1 or traced((args, named)):
            return compiled(*args, **named)
        # Python's own numbers stay what they are, and have no precision of their own.
        known, options = jax.tree.map(lambda x: np.asarray(x) if eqx.is_array(x) else x, (args, named))
        with np.errstate(all="ignore"), computed_at_once():
            # `device_put` compiles nothing, and keeps to JAX's precision.
            found = function(np, *known, **options)  # pyright: ignore
            return jax.tree.map(jax.device_put, found)

    return call


def takes_options(given: Any) -> bool:
    """Whether a compiled call may have options of its own: on a processor, where JAX is tracing nothing.

    JAX must be tracing neither a program around the call nor what the call is given.
    """
    return traces_nothing(given) and jax.default_backend() == "cpu"
