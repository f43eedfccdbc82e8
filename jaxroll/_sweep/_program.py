"""The program of a chunk: traced with every sweep, compiled once for all that are the same."""

from collections import OrderedDict
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.extend.core as jec
import jax.numpy as jnp
import numpy as np

from .._integration import simulate
from .._mechanics import Grasp, State
from .._results import shown
from .._xla import WIDE
from ._fingerprint import fingerprint, of_lowered

# Programs kept for the next sweep, by fingerprint.
_KEPT: OrderedDict[tuple[str, Any], Callable] = OrderedDict()
_MOST = 64
_CALLBACKS = {"pure_callback", "io_callback"}


class Job(eqx.Module):
    """What is worked out: the runs of one chunk."""

    make: Callable[[Any], tuple[Any, Any]]
    keep: Callable[[Any], Any] | None
    t1: Any
    options: dict[str, Any]

    def runs(self, rows: Any, seen: list[Any]) -> Any:
        """What is kept of the runs of these parameters; the form of one run's trajectory goes to `seen`."""

        def one(row: Any) -> Any:
            grasp, state = made(self.make, row)
            run = simulate(grasp, state, self.t1, **self.options)
            seen.append(jax.tree.map(_form, run))
            return run if self.keep is None else kept(self.keep, run)

        return jax.vmap(one)(rows)


def made(make: Callable, row: Any) -> tuple[Grasp, State]:
    """A grasp and a state of one row of parameters."""
    out = make(row)
    if not (isinstance(out, tuple | list) and len(out) == 2):
        raise ValueError(f"argument make must return a grasp and a state, but returned {shown(out)}")
    if not (isinstance(out[0], Grasp) and isinstance(out[1], State)):
        kinds = " and ".join(f"a {type(x).__name__}" for x in out)
        raise ValueError(f"argument make must return a grasp and a state, but returned {kinds}")
    return out[0], out[1]


def kept(keep: Callable, run: Any) -> Any:
    """What is kept of a trajectory."""
    out = keep(run)
    leaves = jax.tree.leaves(out)
    if not leaves or not all(map(_is_numbers, leaves)):
        raise ValueError(f"argument keep must return arrays of numbers, but returned {shown(out)}")
    return out


def _is_numbers(leaf: Any) -> bool:
    if isinstance(leaf, bool | int | float | complex):
        return True
    kind = leaf.dtype if eqx.is_array_like(leaf) and hasattr(leaf, "dtype") else np.dtype(object)
    return jnp.issubdtype(kind, np.number) or kind == np.dtype(bool)


def _form(leaf: Any) -> jax.ShapeDtypeStruct:
    """Shape and kind of an array."""
    aval = jax.typeof(leaf)
    return jax.ShapeDtypeStruct(aval.shape, aval.dtype, weak_type=aval.weak_type)


class Program(NamedTuple):
    """A chunk's program.

    Attributes:
        call: From arrays in a row to results in a row, compiled with its first call.
        arrays: The first of those that it takes: what is in `make`, `keep` and the options.
        results: Shapes and kinds of what it gives, as the pytree that is kept.
        trajectory: Shapes and kinds of one run.
        traced: The program, for fingerprints.
    """

    call: Callable
    arrays: list[Any]
    results: Any
    trajectory: Any
    traced: Any

    def __call__(self, rows: Any) -> Any:
        """What is kept of the runs of a chunk, on the device where its parameters are."""
        out = self.call(*self.arrays, *jax.tree.leaves(rows))
        return jax.tree.unflatten(jax.tree.structure(self.results), map(np.asarray, out))

    def fingerprint(self) -> str:
        """Of the program as it is handed to the compiler."""
        return of_lowered(self.traced.lower().as_text())


def program(job: Job, rows: Any) -> Program:
    """The program of a job for chunks such as `rows`.

    It is traced anew every time, in milliseconds where JAX remembers the parts: what `make` or `keep` close
    over may have changed since, a notebook's variable, and a program kept for the function would give the
    numbers of then. Kept is the program of these operations and constants.
    """
    arrays, still = eqx.partition(job, eqx.is_array)
    seen: list[Any] = []

    def whole(arrays: Any, rows: Any) -> Any:
        return eqx.combine(arrays, still).runs(rows, seen)

    found = _traced(whole, arrays, rows)
    results = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), found.out_info)
    return Program(_compiled(found.jaxpr), jax.tree.leaves(arrays), results, seen[-1], found)


def _traced(function: Callable, *args: Any) -> Any:
    """A function's traced program; it must be a new one, or JAX takes what it traced before."""
    found = jax.jit(function).trace(*args)
    if len(found.jaxpr.jaxpr.invars) != len(jax.tree.leaves(args)):  # JAX hands it more: what it is tracing
        raise ValueError(
            "arguments make, keep and options must hold known numbers, but JAX is tracing some of them: a "
            "sweep is no part of a traced program"
        )
    return found


def _compiled(closed: jec.ClosedJaxpr) -> Callable:
    """A function compiled of a traced program: the one kept, if it is the same."""
    key = fingerprint(closed), jnp.result_type(float)
    found = _KEPT.get(key)
    if found is None:
        # Of the operations and not of the caller's function, which may mean something else next time.
        found = jax.jit(jec.jaxpr_as_fun(closed), compiler_options=WIDE)
    _KEPT[key] = found
    _KEPT.move_to_end(key)
    while len(_KEPT) > _MOST:
        _KEPT.popitem(last=False)
    return found


def of_make(make: Callable, row: Any) -> str:
    """The fingerprint of `make`: its lowered program and constants, and what it returns besides arrays."""
    static: list[str] = []

    def arrays(given: Any, row: Any) -> Any:
        out = made(eqx.combine(given, still), row)
        static.append(fingerprint(out))
        return eqx.filter(out, eqx.is_array)

    given, still = eqx.partition(make, eqx.is_array)
    found = _traced(arrays, given, row)
    return fingerprint((given, static[-1], of_lowered(found.lower().as_text())))


def of_keep(keep: Callable | None, trajectory: Any) -> str:
    """The fingerprint of `keep`: its lowered program and constants, and the tree that it returns."""
    if keep is None:
        return "everything"
    given, still = eqx.partition(keep, eqx.is_array)
    found = _traced(lambda given, run: kept(eqx.combine(given, still), run), given, trajectory)
    text = found.lower().as_text()
    return fingerprint((given, jax.tree.structure(found.out_info), of_lowered(text)))


def calls_back(closed: Any) -> bool:
    """Whether a traced program takes numbers from Python while it runs."""
    if isinstance(closed, jec.ClosedJaxpr):
        return calls_back(closed.jaxpr)
    if isinstance(closed, jec.Jaxpr):
        names = {equation.primitive.name for equation in closed.eqns}
        return bool(names & _CALLBACKS) or any(calls_back(equation.params) for equation in closed.eqns)
    if isinstance(closed, dict):
        return any(map(calls_back, closed.values()))
    return isinstance(closed, tuple | list) and any(map(calls_back, closed))
