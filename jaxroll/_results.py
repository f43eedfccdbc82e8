"""The two error channels: host-side argument checks, and run-time result codes.

Bad arguments raise `ValueError` at once, with one sentence that says which argument it is, what it
must be and what it was. What goes wrong while a compiled program runs is a code of `RESULTS`: it
survives `vmap`, one code per lane, and never discards what had been computed.
"""

import contextlib
import functools
import inspect
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.core
import jax.extend.core as jec
import jax.numpy as jnp
import numpy as np

from ._printing import is_code, named

_P = ParamSpec("_P")
_R = TypeVar("_R")

# Longest quotation of a bad argument in an error's sentence.
_QUOTED = 80
# Lengths [m] that a shape may have.
SHAPE_LENGTHS = (1e-12, 1e9)
# Arrays with more numbers than this are quoted by their shape.
_FEW = 12


# What JAX raises where a function asks for the value of what is being traced.
NO_VALUES = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
)


@named
class RESULTS(eqx.Enumeration):
    """Result codes: 'successful', or why a run of `simulate` ended early.

    `contact.locate`, `roll`, `reach`, `identify` and `design` have theirs here too: why something was not
    found.

    A code prints as its name; `RESULTS[code]` is the sentence. Codes of a batch can be counted, sorted and
    stored: `np.unique(runs.result.names, return_counts=True)` by name, `np.asarray(runs.result)` as numbers;
    `runs.result[k]` is that of one lane, and `runs.result == RESULTS.slipping` selects lanes.
    """

    successful = ""
    max_steps_reached = "The step limit was reached."
    step_collapsed = (
        "Steps became too short to move time: the motion is singular or not finite there, or too fast for "
        "the precision."
    )
    singular_contact = (
        "The rolling contact became singular: the sum of the two curvatures vanishes beside their size, or "
        "the Schur complement of the constraints is no longer positive."
    )
    contour_end = "A contact point ran past the end of an open contour, or the edge of an open surface."
    contact_lost = "A contact no longer presses: its normal force fell below zero."
    slipping = "A contact needs more friction than there is: its force left the friction cone."
    penetration = "A fingertip and the object overlap away from their contact."
    not_finite = "The equations of motion gave a value that is not finite."
    too_deep = "Two shapes overlap so deeply that their deepest point has no single nearest point."
    unreachable = "The initial state is off the constraints: no pose near the guess closes them."
    infeasible = "No point that keeps every limit was found; the one that passes them least is given."
    solver_failed = "The solver reported a failure of its own."
    # Codes are numbered in this order, and stored results hold the numbers: a new code must come last.
    unresolved = (
        "A contour bends more sharply than the cells of its table resolve: the run is that of a somewhat "
        "other shape."
    )
    joint_limit = "A joint is at the end of its range."
    torque_limit = "The controller asks for more than the largest torque of a joint."
    links_meet = "A finger's links meet the object or another finger's."
    undetermined = "What was measured tells nothing of the numbers that were sought."
    unordered_times = "The run's save times do not rise from its start to its end."
    inconsistent_shape = (
        "A contour of one's own is not given by its arclength, or a frame, normal or shape operator is not "
        "that of its curve or surface."
    )
    not_rolling = (
        "The gap of a contact of one's own changes as its place alone moves, so that the contact was held to "
        "other motions than its gap says."
    )


def missing_library(library: str, extra: str) -> ImportError:
    """The error for a library of one of the package's extras that could not be imported."""
    return ImportError(f'this needs the library {library}: pip install "jaxroll[{extra}]"')


def traced(value: Any) -> bool:
    """Whether JAX is tracing some array in a value; then its numbers cannot be checked."""
    try:
        return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value))
    except (TypeError, ValueError):  # a dict whose keys have no order
        return False


def computed_at_once() -> contextlib.AbstractContextManager[None]:
    """A context in which what is known is computed even where JAX traces a function around it.

    Where it traces none this does nothing. Functions that are called in `jax.ensure_compile_time_eval` are
    others to JAX: it compiles them once more, and each operation on constants in them as a program by itself.
    """
    return contextlib.nullcontext() if traces_nothing(()) else jax.ensure_compile_time_eval()


def traces_nothing(given: Any) -> bool:
    """Whether JAX is tracing neither a function around this call nor anything in what it is given."""
    # The trace that would see an operation on these arguments: without any tracing it is JAX's `EvalTrace`.
    return type(jec.find_top_trace(jax.tree.leaves(given))).__name__ == "EvalTrace"


def on_host(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """The function, which then refuses an argument that JAX is tracing, and names it.

    For set-up, pictures and files, which no compiled program can hold. Inside a function that JAX traces it
    computes at once where all that it is given is known.
    """
    names = tuple(inspect.signature(function).parameters)

    @functools.wraps(function)
    def known(*args: _P.args, **options: _P.kwargs) -> _R:
        for name, value in (dict(zip(names, args, strict=False)) | options).items():
            check_known(name, value)
        with computed_at_once():
            return function(*args, **options)

    return known


def check_known(name: str, value: Any) -> None:
    """Raise where JAX is tracing some number of an argument whose values are needed."""
    if traced(value):
        raise ValueError(
            f"argument {name} must hold known numbers, but JAX is tracing some: this works outside of "
            f"`jax.jit`, derivatives and `jax.vmap` alone"
        )


@contextlib.contextmanager
def traceable(name: str) -> Iterator[None]:
    """Say in one sentence that a caller's function asks for values where JAX has none yet."""
    try:
        yield
    except NO_VALUES as error:
        raise ValueError(
            f"argument {name} must compute with jax.numpy, and choose with jnp.where in the place of `if`: "
            "what it is given has no values while JAX traces it, but its function asked for one "
            f"({type(error).__name__})"
        ) from error


def concrete(value: Any) -> np.ndarray | None:
    """The value as a NumPy array, or None while JAX is tracing."""
    return None if traced(value) else np.asarray(value)


def told(path: Any, error: OSError) -> str:
    """A path, shortened, and what the system says of it: its own message has the path at full length."""
    return f"{shown(str(path))}: {error.strerror or type(error).__name__}"


def shown(value: Any) -> str:
    """A value as an error's sentence quotes it: short, and on one line."""
    try:
        text = _quoted(value)
    except Exception:  # a caller's own `repr` may fail on what is wrong with it
        text = f"a {type(value).__name__}"
    text = " ".join(text.split())
    return text if len(text) <= _QUOTED else f"{text[: _QUOTED - 4]} ..."


def _quoted(value: Any) -> str:
    if isinstance(value, jax.core.Tracer):
        return f"a traced array of shape {value.shape}"
    if type(value) in (tuple, list) and traced(value):
        parts = ", ".join(map(_quoted, value))
        return f"[{parts}]" if isinstance(value, list) else f"({parts})"
    if not is_array_like(value):
        return repr(value)
    seen = np.asarray(value)
    if seen.size <= _FEW:
        return str(seen.tolist())
    return f"an array of shape {seen.shape} that begins with {seen.ravel()[:3].tolist()}"


def is_foreign(value: Any) -> bool:
    """Whether a value's class is a caller's own, and none of this package."""
    return not type(value).__module__.startswith("jaxroll.")


def is_array_like(value: Any) -> bool:
    """Whether a value is one array already, of NumPy or of JAX."""
    return isinstance(value, np.ndarray | np.generic | jax.Array)


def as_array(name: str, value: Any) -> jax.Array:
    """The one door from a caller's argument to a floating array; whatever is not real numbers is refused.

    Numbers, nested sequences of them and arrays of NumPy and JAX pass, traced ones included. Text, None,
    booleans, complex numbers, ragged sequences and other objects raise one sentence.
    """
    wanted = f"argument {name} must be a real number or an array of them, but was {{}}"
    if not is_array_like(value) and not isinstance(value, int | float | list | tuple | range):
        # Other libraries' arrays and numbers (torch, pandas, fractions) say themselves how they convert.
        if not (
            hasattr(value, "__array__") or hasattr(value, "__jax_array__") or hasattr(value, "__float__")
        ):
            raise ValueError(wanted.format(shown(value)))
        if isinstance(value, complex | str | bytes) or is_code(value):
            raise ValueError(wanted.format(shown(value)))
    try:
        # Numbers that are known stay known where something else is being traced: they can be checked there.
        with contextlib.nullcontext() if traced(value) else computed_at_once():
            array = _converted(value)
            if jnp.issubdtype(array.dtype, jnp.integer):
                array = array.astype(jnp.result_type(float))
    except (TypeError, ValueError, OverflowError) as error:
        if isinstance(error, jax.errors.JAXTypeError):  # NumPy met a tracer: the caller's own mistake
            raise
        raise ValueError(wanted.format(shown(value))) from None
    if array.dtype == bool or not jnp.issubdtype(array.dtype, jnp.number):
        raise ValueError(wanted.format(shown(value)))
    if jnp.issubdtype(array.dtype, jnp.complexfloating):
        raise ValueError(wanted.format(shown(value)))
    return array


def _converted(value: Any) -> jax.Array:
    """A JAX array; codes and Python's own booleans are noticed, which NumPy would take for whole numbers."""
    if isinstance(value, bool) or isinstance(value, list | tuple) and _holds_flag(value):
        raise TypeError("a boolean is no number")
    if isinstance(value, list | tuple | range):
        return _converted(np.asarray(value)) if not traced(value) else jnp.asarray(value)
    if type(value) is np.ndarray and value.ndim > 0:
        # `jnp.asarray` would compile a program, of 10 ms, for every new shape; for shapes that were there it
        # is faster by 0.015 ms. This copies, because JAX might otherwise go on reading the caller's memory,
        # which may change.
        return jax.device_put(value.copy())
    if is_array_like(value):
        return jnp.asarray(value)
    if hasattr(value, "__jax_array__"):
        return jnp.asarray(value)
    return jnp.asarray(np.asarray(value) if hasattr(value, "__array__") else float(value))


def _holds_flag(values: Any) -> bool:
    flag = lambda x: isinstance(x, bool) or is_code(x)  # noqa: E731
    return any(flag(x) or (isinstance(x, list | tuple) and _holds_flag(x)) for x in values)


def as_floats(name: str, value: Any, shape: tuple[int | None, ...]) -> jax.Array:
    """Convert an argument to a finite floating array of the given shape; `None` matches any length."""
    array = as_array(name, value)
    matches = array.ndim == len(shape) and all(
        want is None or want == have for want, have in zip(shape, array.shape, strict=True)
    )
    if not matches:
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise ValueError(f"argument {name} must have shape {wanted}, but had shape {array.shape}")
    return check_finite(name, array)


def as_positive(name: str, value: Any) -> jax.Array:
    """Convert an argument to a finite, positive floating number."""
    return check_positive(name, as_floats(name, value, ()))


def as_count(name: str, value: Any, *, least: int = 1, most: int = 10**6) -> int:
    """Convert an argument to a Python integer; booleans and fractions are refused.

    What is counted is mostly made at once, as an array: `most` keeps it within a machine's memory.
    """
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < least:
        raise ValueError(
            f"argument {name} must be a whole number of at least {least}, but was {shown(value)}"
        )
    if value > most:
        raise ValueError(f"argument {name} must be at most {most}, but was {shown(value)}")
    return int(value)


def check_flag(name: str, value: Any) -> bool:
    """Raise unless an argument is True or False."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"argument {name} must be True or False, but was {shown(value)}")
    return bool(value)


def check_choice(name: str, value: Any, known: Sequence[Any]) -> Any:
    """Raise unless an argument is one of the values known."""
    if not any(type(value) is type(item) and value == item for item in known):
        raise ValueError(
            f"argument {name} must be one of {', '.join(map(repr, known))}, but was {shown(value)}"
        )
    return value


def check_instance(name: str, value: Any, kinds: type | tuple[type, ...], what: str) -> Any:
    """Raise unless an argument is of one of these classes; `what` says in words what it must be."""
    if not isinstance(value, kinds):
        raise ValueError(f"argument {name} must be {what}, but was {shown(value)}")
    return value


def as_several(name: str, value: Any, kind: type, what: str) -> tuple[Any, ...]:
    """Convert one instance of a class, or a collection of them, to a tuple of one or more."""
    if isinstance(value, kind):
        return (value,)
    listed = tuple(value) if isinstance(value, list | tuple | Iterator) else ()
    if not listed or not all(isinstance(item, kind) for item in listed):
        raise ValueError(f"argument {name} must be one or more {what}, but was {shown(value)}")
    return listed


def check_callable(name: str, value: Any, what: str = "a function", *, takes: int | None = None) -> Any:
    """Raise unless an argument can be called, by position with as many arguments as `takes` says.

    A class is no function: whoever gives one forgot to make an instance.
    """
    if not callable(value) or isinstance(value, type):
        raise ValueError(f"argument {name} must be {what}, but was {shown(value)}")
    if takes is not None and not _takes(value, takes):
        signature, none = inspect.signature(value), inspect.Parameter.empty
        names = [one.replace(default=none, annotation=none) for one in signature.parameters.values()]
        taken = signature.replace(parameters=names, return_annotation=none)
        raise ValueError(f"argument {name} must be {what}, but was callable as f{str(taken):.80}")
    return value


def as_order(smoothness: Any, *, least: int = 0) -> float:
    """Convert argument `smoothness` to a number of continuous derivatives, infinity among them."""
    real = isinstance(smoothness, int | float | np.integer | np.floating) and not isinstance(smoothness, bool)
    # A Python integer may be larger than any float.
    if not real or not smoothness >= least or sys.float_info.max < smoothness < math.inf:
        few = f" of {least} or more," if least else ""
        raise ValueError(
            f"argument smoothness must be a number of derivatives{few} or infinity, but was "
            f"{shown(smoothness)}"
        )
    return float(smoothness)


def _takes(function: Callable[..., Any], count: int) -> bool:
    """Whether a function can be called with `count` arguments; True where its signature is not known."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return True
    try:
        signature.bind(*(None,) * count)
    except TypeError:
        return False
    return True


def as_faces(faces: Any, count: int) -> np.ndarray:
    """A caller's triangles as numbers of vertices, shape (m, 3)."""
    try:
        seen: Any = np.asarray(faces)
    except (TypeError, ValueError):
        seen = np.zeros((0, 3))
    wanted = f"argument faces must be whole numbers of shape (any, 3) from 0 to {count - 1}, but "
    if not (np.issubdtype(seen.dtype, np.integer) and seen.ndim == 2 and seen.shape[1] == 3 and seen.size):
        raise ValueError(f"{wanted}was {shown(faces)}")
    wrong = seen[(seen < 0) | (seen >= count)]
    if len(wrong):
        raise ValueError(f"{wanted}one was {wrong[0]}")
    return seen.astype(int)


def as_share(name: str, value: Any) -> float:
    """Convert an argument that a program is compiled for to a Python number from 0 to 1."""
    array = as_array(name, value)
    if traced(value):
        raise ValueError(f"argument {name} must be known before tracing, but was {shown(value)}")
    if array.ndim or not 0.0 <= float(value) <= 1.0:
        raise ValueError(f"argument {name} must be a number from 0 to 1, but was {shown(value)}")
    return float(value)


def check_finite(name: str, value: jax.Array) -> jax.Array:
    """Raise if a concrete value holds NaN or infinity."""
    seen = concrete(value)
    if seen is not None and not np.all(np.isfinite(seen)):
        raise ValueError(f"argument {name} must be finite, but was {shown(seen)}")
    return value


def check_positive(name: str, value: jax.Array) -> jax.Array:
    """Raise if a concrete value is not strictly positive."""
    seen = concrete(value)
    if seen is not None and not np.all(seen > 0):
        raise ValueError(f"argument {name} must be positive, but was {shown(seen)}")
    return value


def check_direction(name: str, vectors: jax.Array) -> jax.Array:
    """Raise if a concrete vector, along the last axis, has no direction: its length is zero or overflows.

    A length whose square is lost in the precision counts as zero: callers divide by the length.
    """
    seen = concrete(vectors)
    if seen is None:
        return vectors
    with np.errstate(over="ignore"):
        lengths = np.sqrt(np.sum(seen * seen, axis=-1))
    if not np.all((lengths > 0) & np.isfinite(lengths)):
        worst = seen[~((lengths > 0) & np.isfinite(lengths))].reshape(-1, seen.shape[-1])[0]
        what = "must not be zero" if not worst.any() else "must be of a length whose square is a number"
        raise ValueError(f"argument {name} {what}, but was {shown(worst)}")
    return vectors


def as_length(name: str, value: Any) -> jax.Array:
    """Convert an argument to a length [m] of a shape; out of `SHAPE_LENGTHS` its square would lose digits."""
    length = as_positive(name, value)
    check_between(name, length, *SHAPE_LENGTHS, unit=" m")
    return length


def check_length(name: str, value: Any, most: float) -> None:
    """Raise unless a length is None or lies between 0 and `most` [m]."""
    if value is None:
        return
    try:
        seen = float(as_floats(name, value, ()))
    except ValueError as error:
        if "finite" in str(error):  # infinity and NaN: the sentence below, with the bounds, says more
            seen = float(value)
        else:
            raise ValueError(f"argument {name} must be a length in metres, but was {shown(value)}") from None
    if not 0.0 <= seen <= most:
        limit, was = told_apart(most, seen)
        raise ValueError(f"argument {name} must lie between 0 and {limit} m here, but was {was}")


def up_to(ts: Any, until: float) -> Any:
    """Which times come no later than another one, to a millionth of it: sums such as 3 * 0.01 are rounded."""
    return ts <= until + 1e-6 * abs(until)


def told_apart(*values: Any, least: int = 6) -> list[str]:
    """Numbers as texts for one sentence: in `least` digits, or in as many as show that they differ."""
    # A number of single precision keeps its type: as a `float` it would show digits of the conversion.
    known = [np.asarray(value)[()] for value in values]
    texts: list[str] = []
    for digits in range(least, 18):
        texts = [f"{value:.{digits}g}" for value in known]
        if len(set(texts)) == len({repr(float(value)) for value in known}):
            break
    return texts


def check_between(name: str, value: Any, low: Any, high: Any, *, unit: str = "") -> None:
    """Raise if a concrete value lies outside a closed interval."""
    seen, lows, highs = concrete(value), concrete(low), concrete(high)
    if seen is None or lows is None or highs is None:
        return
    if not np.all((lows <= seen) & (seen <= highs)):
        least, most, was = told_apart(lows, highs, seen)
        raise ValueError(f"argument {name} must lie between {least} and {most}{unit}, but was {was}")


def message(result: RESULTS) -> str:
    """The sentence that belongs to one concrete result code; 'successful' for success."""
    return RESULTS[result] or "successful"
