"""The program of a chunk: traced with every sweep, compiled once for all programs that are the same.

A chunk is `vmap` over its rows of: `make` a grasp and a state of the row, `simulate`, `keep` some of the run.
JAX would look for the compiled program under the identity of the Python function, which is a trap: a function
that closes over a variable keeps its identity when the variable changes, so that the old numbers would be
computed again. Therefore the function is traced anew every time, and the compiled program is looked for under
the fingerprint of the jaxpr, its constants included. Functions in the grasp, such as a law, are the same
trap: JAX keeps the trace of a run by their identity. So a run is traced in a context (`HELD`) that names
what these functions hold now.

`_sweep` and `_sending` call the `Program`. By `of_make` and `of_keep` `_sweep` marks the caller's functions,
so that a folder can say which of them has changed.
"""

from collections import OrderedDict
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.extend.core as jec
import jax.numpy as jnp
import numpy as np

from .._closures import HELD
from .._fingerprint import fingerprint, of_lowered
from .._integration import simulate
from .._mechanics import Grasp, State
from .._results import shown, traceable
from .._xla import unstored, WIDE

# Compiled programs by fingerprint, and by the precision in which they were traced; the one used last comes
# last, and the first goes when there are more than `_MOST`.
_KEPT: OrderedDict[tuple[str, Any], Callable] = OrderedDict()
_MOST = 64
# Operations whose numbers come from Python code, which no fingerprint of a program can tell.
_CALLBACKS = frozenset(("pure_callback", "io_callback"))
_FACTORISATIONS = frozenset(("lu", "cholesky", "triangular_solve", "eigh", "eig", "svd", "geqrf", "schur"))


class Job(eqx.Module):
    """What the caller asked to be computed, as a pytree: its arrays are arguments of the program."""

    make: Callable[[Any], tuple[Any, Any]]
    keep: Callable[[Any], Any] | None
    t1: Any
    options: dict[str, Any]

    def runs(self, rows: Any, seen: list[Any]) -> Any:
        """What is kept of the runs of these parameters.

        While it is traced it appends the shapes and dtypes of one run's trajectory to `seen`: they are wanted
        for tracing `keep` alone, and cannot be returned, since a program returns arrays.
        """

        def one(row: Any) -> Any:
            grasp, state = made(self.make, row)
            still = eqx.filter((grasp, self.keep, self.options), eqx.is_array, inverse=True)
            with as_now(still):
                run = simulate(grasp, state, self.t1, **self.options)
                seen.append(jax.tree.map(_form, run))
                return run if self.keep is None else kept(self.keep, run)

        return jax.vmap(one)(rows)


def as_now(still: Any) -> AbstractContextManager[Any]:
    """A context in which JAX traces what these functions, and all that they refer to, hold now."""
    return HELD(_held(still))


def _held(still: Any) -> Any:
    """A fingerprint of all that functions hold."""
    try:
        return fingerprint(still)
    except RecursionError:  # it nests too deeply: a context like no other, so that JAX traces anew
        return object()


def made(make: Callable, row: Any) -> tuple[Grasp, State]:
    """The grasp and the state that `make` returns for one row of parameters, checked."""
    with traceable("make"):
        out = make(row)
    if not (isinstance(out, tuple | list) and len(out) == 2):
        raise ValueError(f"argument make must return a grasp and a state, but returned {shown(out)}")
    if not (isinstance(out[0], Grasp) and isinstance(out[1], State)):
        kinds = " and ".join(f"a {type(x).__name__}" for x in out)
        raise ValueError(f"argument make must return a grasp and a state, but returned {kinds}")
    return out[0], out[1]


def answer(name: str, function: Callable, given: Any) -> tuple[Any, list[Any]]:
    """What a caller's function returns, and its leaves: none if that is not a pytree."""
    with traceable(name):
        out = function(given)
    try:
        return out, jax.tree.leaves(out)
    except (TypeError, ValueError):  # a dict whose keys have no order
        return out, []


def kept(keep: Callable, run: Any) -> Any:
    """What `keep` returns for a trajectory, checked."""
    out, leaves = answer("keep", keep, run)
    if not leaves or not all(map(_is_numbers, leaves)):
        raise ValueError(f"argument keep must return arrays of numbers, but returned {shown(out)}")
    return out


def _is_numbers(leaf: Any) -> bool:
    if isinstance(leaf, bool | int | float | complex):
        return True
    kind = leaf.dtype if eqx.is_array_like(leaf) and hasattr(leaf, "dtype") else np.dtype(object)
    return jnp.issubdtype(kind, np.number) or kind == np.dtype(bool)


def _form(leaf: Any) -> jax.ShapeDtypeStruct:
    """Shape and dtype of an array; also whether the dtype is weak, since `keep` may promote it."""
    aval = jax.typeof(leaf)
    return jax.ShapeDtypeStruct(aval.shape, aval.dtype, weak_type=aval.weak_type)


class Program(NamedTuple):
    """A chunk's program.

    Attributes:
        call: Takes the leaves of the job and of the rows as one flat list, returns the leaves of the results;
            it is compiled with its first call.
        arrays: The arrays in `make`, `keep` and the options, which `call` takes first.
        results: Shapes and dtypes of the results, in the pytree that is kept.
        trajectory: Shapes and dtypes of one run.
        traced: The traced program, to be lowered for its fingerprint.
    """

    call: Callable
    arrays: list[Any]
    results: Any
    trajectory: Any
    traced: Any

    def __call__(self, rows: Any) -> Any:
        """What is kept of the runs of a chunk, as NumPy arrays, computed where its parameters are."""
        out = self.call(*self.arrays, *jax.tree.leaves(rows))
        return jax.tree.unflatten(jax.tree.structure(self.results), map(np.asarray, out))

    def key(self) -> str:
        """Fingerprint of the program as it was traced."""
        return fingerprint(self.traced.jaxpr)

    def fingerprint(self) -> str:
        """Fingerprint of the program as it is handed to the compiler."""
        return _of_lowered(self.traced)


def program(job: Job, rows: Any) -> Program:
    """The program of a job for chunks with the shapes and dtypes of `rows`.

    It is traced anew every time, which takes milliseconds where JAX has cached the inner functions: a
    variable that `make` or `keep` close over (a notebook's, say) may have changed since. What has been
    compiled is kept for these operations and constants, not for these functions.
    """
    # Arrays among what the caller gave become arguments: as constants they would be part of the fingerprint,
    # and other values would compile another program.
    arrays, still = eqx.partition(job, eqx.is_array)
    seen: list[Any] = []

    def whole(arrays: Any, rows: Any) -> Any:
        return eqx.combine(arrays, still).runs(rows, seen)

    found = _traced(whole, arrays, rows)
    results = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), found.out_info)
    return Program(_compiled(found.jaxpr), jax.tree.leaves(arrays), results, seen[-1], found)


def _traced(function: Callable, *args: Any) -> Any:
    """The traced program of a function, which must have been created for this call.

    For a function that it has traced before, JAX would return that trace. The lowered program takes all
    arguments, unused ones too: else a program that reads one of two parameters would be the same as a program
    that reads the other.
    """
    found = jax.jit(function, keep_unused=True).trace(*args)
    # Inside an outer `jit` or derivative, JAX passes what the function closes over of the outer trace as
    # additional arguments.
    if len(found.jaxpr.jaxpr.invars) != len(jax.tree.leaves(args)):
        raise ValueError(
            "arguments make, keep and options must hold known numbers, but JAX is tracing some of them: a "
            "sweep is no part of a traced program"
        )
    return found


def _compiled(closed: jec.ClosedJaxpr) -> Callable:
    """The compiled function of a traced program: the one kept from an earlier sweep, if there is one."""
    key = fingerprint(closed), jnp.result_type(float)
    found = _KEPT.get(key)
    if found is None:
        # Built from the operations: JAX compiles with the first call, and would then trace the caller's
        # function again, whose variables may have changed by then.
        found = jax.jit(jec.jaxpr_as_fun(closed), compiler_options=WIDE)
    _KEPT[key] = found
    _KEPT.move_to_end(key)
    while len(_KEPT) > _MOST:
        _KEPT.popitem(last=False)
    return found


def of_make(make: Callable, row: Any) -> str:
    """The fingerprint of `make`: its lowered program and constants, and what it returns besides arrays.

    The latter are the static fields of the grasp, such as which finger touches which contour; they are no
    results of the program, and are digested while it is traced.
    """
    static: list[str] = []

    def arrays(given: Any, row: Any) -> Any:
        out = made(eqx.combine(given, still), row)
        static.append(fingerprint(out))
        return eqx.filter(out, eqx.is_array)

    given, still = eqx.partition(make, eqx.is_array)
    found = _traced(arrays, given, row)
    return fingerprint((given, static[-1], _of_lowered(found)))


def of_keep(keep: Callable | None, trajectory: Any) -> str:
    """The fingerprint of `keep`: its lowered program and constants, and the structure of what it returns.

    Args:
        keep: The caller's function, or None.
        trajectory: Shapes and dtypes of one run.
    """
    if keep is None:
        return "everything"
    given, still = eqx.partition(keep, eqx.is_array)
    found = _traced(lambda given, run: kept(eqx.combine(given, still), run), given, trajectory)
    return fingerprint((given, jax.tree.structure(found.out_info), _of_lowered(found)))


def _of_lowered(found: Any) -> str:
    """The fingerprint of a traced program's lowered one, whether JAX has a folder for programs or not."""
    with unstored():
        return of_lowered(found.lower().as_text())


def calls_back(closed: Any) -> bool:
    """Whether a traced program calls Python functions for numbers."""
    return _has(closed, _CALLBACKS)


def factorises(closed: Any) -> bool:
    """Whether a traced program calls routines of LAPACK, as `close` does for what it solves."""
    return _has(closed, _FACTORISATIONS)


def _has(closed: Any, wanted: frozenset[str]) -> bool:
    """Whether one of these operations is in a traced program, or in one within its operations."""
    if isinstance(closed, jec.ClosedJaxpr):
        return _has(closed.jaxpr, wanted)
    if isinstance(closed, jec.Jaxpr):
        return any(e.primitive.name in wanted or _has(e.params, wanted) for e in closed.eqns)
    if isinstance(closed, dict):
        return any(_has(value, wanted) for value in closed.values())
    return isinstance(closed, tuple | list) and any(_has(value, wanted) for value in closed)
