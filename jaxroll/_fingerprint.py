"""Fingerprints: a digest of all that a value or a program holds, the same in every process.

Two things with one fingerprint give the same numbers. The converse is not promised: two functions that
compute the same with different code have different fingerprints. Python's `hash` does not do, since it
differs from process to process, and neither does `pickle`, which stores a function by its name and so misses
its code.

`Reader` walks through a value and everything that it refers to, and feeds a SHA-256 digest. A traced program
(a jaxpr) is read operation by operation; a lowered one (`of_lowered`) is text, and is digested as text with
the accidental names left out. In `_sweep`, `_program` finds a program that was compiled before by its
fingerprint, and `_identity` decides by fingerprints whether a folder belongs to a sweep. `_xla._stored` finds
derivatives by them, and `design._minimise` tells of which search a checkpoint is.
"""

import dataclasses
import dis
import enum
import functools
import hashlib
import importlib.metadata
import re
import sys
import types
from collections.abc import Callable, Iterator
from typing import Any
from weakref import WeakKeyDictionary

import jax
import jax.core
import jax.extend.core as jec
import jax.numpy as jnp
import numpy as np

# Functions and classes of these packages, and of Python's own modules, are digested by name alone, not by
# their code. What a name stands for changes with a version only: `_identity` compares the versions of these.
PACKAGES = (
    "jaxroll",
    "jax",
    "jaxlib",
    "diffrax",
    "equinox",
    "optimistix",
    "lineax",
    "numpy",
    "optax",
    "beartype",
    "jaxtyping",
)
LIBRARIES = sys.stdlib_module_names | set(PACKAGES)
# Memory addresses in what an object prints, which differ from process to process.
_ADDRESS = re.compile(r"\b0x[0-9a-f]+")
# Types whose `repr` says everything about a value.
_PLAIN = (type(None), type(...), bool, int, float, complex, str, bytes, np.dtype)
_NOTHING = object()
# Types of containers, and the function that lists what one contains.
_HOLDERS: tuple[tuple[Any, Callable], ...] = (
    (tuple | list | set | frozenset, list),
    (dict, lambda value: list(value.items())),
    (types.MethodType, lambda value: (value.__self__, value.__func__)),
    (functools.partial, lambda value: (value.func, value.args, value.keywords)),
    (jax.tree_util.PyTreeDef, lambda value: (value.node_data(), value.children())),
)
# Digests of what these contain are sorted, so that the order of insertion or of hashing does not count.
_UNORDERED = (dict, set, frozenset)
# Parameters of a jaxpr's operations that are left out: rules by which an operation would be mapped or
# differentiated, the trees and the mesh of its caller, and names. None of them changes what is computed.
_LATER = {
    "rule",
    "in_tree",
    "out_tree",
    "jvp_jaxpr_fun",
    "fwd_jaxpr_thunk",
    "bwd",
    "back",
    "ctx_mesh",
    "name",
}
# Digests of jaxprs met before. JAX caches the jaxprs of inner functions, so that the next sweep meets most of
# them again; the keys are weak, so that a digest goes when JAX drops the jaxpr.
_PARTS: WeakKeyDictionary[jec.Jaxpr, bytes] = WeakKeyDictionary()
# One function of a lowered program (groups: its name, the rest of its text), and a name of a function in it.
_FUNCTION = re.compile(r"^  func\.func \w+ @(\"[^\"]*\"|[\w.$-]+)(.*?)^  }$", re.MULTILINE | re.DOTALL)
_NAME = re.compile(r"@(\"[^\"]*\"|[\w.$-]+)")
# Text of a lowered program that does not bear on its numbers: the module's name, the names of its results,
# and the numbers and addresses under which a process registers callbacks.
_NOISE = re.compile(
    r"^module @\S+|jax\.result_info = \"[^\"]*\"|\{index = \d+ : ui64\}|backend_config = \"\d+\"",
    re.MULTILINE,
)


def fingerprint(value: Any) -> str:
    """The fingerprint of any value.

    Numbers and arrays count by value, objects by class and fields, functions by their code and what they
    close over, traced programs by operations and constants.
    """
    return Reader().read(value).hex()


def of_lowered(text: str) -> str:
    """The fingerprint of a lowered program, constants included.

    Names of functions do not count, nor how many copies of one function there are, since both depend on what
    was traced before in the same process. Every name is therefore replaced by the digest of the function's
    body, in which the names have been replaced likewise; recursion ends, because StableHLO has no recursion.
    """
    text = _NOISE.sub("", text)
    bodies = {found[1]: found[2] for found in _FUNCTION.finditer(text)}

    @functools.cache
    def digest(name: str) -> str:
        return _sha(_NAME.sub(lambda m: digest(m[1]) if m[1] in bodies else m[0], bodies[name])).hex()

    rest = _FUNCTION.sub("", text)
    return _sha(rest, digest("main")).hex()


def version_of(package: str) -> str:
    """The version of a package that is installed; "unknown" of one that is not."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def _sha(*parts: bytes | str) -> bytes:
    """A digest of parts, each preceded by its length: ("ab", "c") and ("a", "bc") have different digests."""
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(len(data).to_bytes(8, "little"))
        digest.update(data)
    return digest.digest()


class Reader:
    """One reading of a value, in which no object is read twice and cycles of references end."""

    def __init__(self) -> None:
        # How many objects were met that can be changed in place (NumPy arrays, functions by their globals).
        self.mutable = 0
        # Digests by `id`. The object is held beside its digest: otherwise Python could free a temporary one
        # and give its `id` to another object during the same reading.
        self.done: dict[int, tuple[Any, bytes]] = {}
        # Objects whose reading has begun but not ended, by `id`, with their depth. An object that is met
        # within itself (a function that calls itself) counts as a reference to that depth.
        self.under_way: dict[int, int] = {}

    def read(self, value: Any) -> bytes:
        """The digest of a value."""
        if isinstance(value, _PLAIN):
            return _sha(type(value).__name__, repr(value))
        known = self.done.get(id(value))
        if known is not None:
            return known[1]
        if id(value) in self.under_way:
            return _sha("again", str(self.under_way[id(value)]))
        self.under_way[id(value)] = len(self.under_way)
        try:
            found = _sha(*self.parts(value))
        finally:
            del self.under_way[id(value)]
        self.done[id(value)] = (value, found)
        return found

    def parts(self, value: Any) -> Iterator[bytes | str]:
        """Digests and words whose sequence determines a value."""
        if isinstance(value, jax.core.Tracer):
            return iter(("traced", str(value.aval)))
        if isinstance(value, jec.ClosedJaxpr):
            return iter(("closed", self.read(value.jaxpr), *map(self.read, value.consts)))
        if isinstance(value, jec.Jaxpr):
            return iter((self.program(value),))
        if hasattr(value, "__array__") and hasattr(value, "dtype"):
            # JAX's arrays cannot be written to.
            self.mutable += isinstance(value, np.ndarray) and value.ndim > 0
            return _array(value)
        if isinstance(value, enum.Enum):
            return iter((_title(type(value)), value.name))
        if isinstance(value, types.FunctionType):
            return self.function(value)
        if isinstance(value, types.CodeType):
            return self.code(value)
        if isinstance(value, type):
            return self.kind(value)
        if isinstance(value, types.ModuleType):
            return iter(("module", value.__name__))
        return self.holder(value)

    def holder(self, value: Any) -> Iterator[bytes | str]:
        """Parts of a container, a dataclass or any other object: its class, and what it contains."""
        yield self.read(type(value))
        for kinds, inside in _HOLDERS:
            if isinstance(value, kinds):
                found = [self.read(part) for part in inside(value)]
                yield from sorted(found) if isinstance(value, _UNORDERED) else found
                return
        if dataclasses.is_dataclass(value):
            names = [field.name for field in dataclasses.fields(value)]
            yield from (self.read((name, getattr(value, name, _NOTHING))) for name in names)
        else:
            yield from self.opaque(value)

    def opaque(self, value: Any) -> Iterator[bytes | str]:
        """Parts of an object of no known kind: its attributes.

        Objects of JAX refer to much of the library's own state, so that of these only the name or the printed
        form counts, without addresses. A wrapper (`jax.jit`, `functools.wraps`) counts as what it wraps.
        """
        inner = getattr(value, "__wrapped__", None)
        if inner is not None:
            yield self.read(inner)
        elif root_of(type(value)) in ("jax", "jaxlib") or not hasattr(value, "__dict__"):
            yield _ADDRESS.sub("", getattr(value, "__qualname__", None) or repr(value))
        else:
            yield self.read(vars(value))

    def function(self, value: types.FunctionType) -> Iterator[bytes | str]:
        """Parts of a function: its code, the globals that it reads, its defaults and what it closes over."""
        self.mutable += 1
        if root_of(value) in LIBRARIES:
            yield _title(value)
        else:
            yield self.read(value.__code__)
            named = {name: value.__globals__.get(name, _NOTHING) for name in _globals_of(value.__code__)}
            yield self.read({name: found for name, found in named.items() if found is not _NOTHING})
            held = (*named.values(), *map(_content, value.__closure__ or ()))
            modules = [found for found in held if isinstance(found, types.ModuleType)]
            yield self.read([_read_of(module, value.__code__) for module in modules])
        yield self.read(value.__defaults__)
        yield self.read(value.__kwdefaults__)
        for cell in value.__closure__ or ():
            yield self.read(_content(cell))

    def code(self, value: types.CodeType) -> Iterator[bytes | str]:
        """Parts of compiled code, without its file and line numbers: moving a function changes nothing."""
        yield value.co_code
        parts = (value.co_consts, value.co_names, value.co_varnames, value.co_freevars, value.co_flags)
        yield from map(self.read, parts)

    def kind(self, value: type) -> Iterator[bytes | str]:
        """Parts of a class: its name; of a caller's own also its bases, methods and constants."""
        yield _title(value)
        if root_of(value) in LIBRARIES:
            return
        yield from map(self.read, value.__bases__)
        for name, held in sorted(vars(value).items()):
            if name == "__call__" or not name.startswith("__"):
                # The function behind a static or class method, a property, or equinox's wrapper of a method.
                for attribute in ("__func__", "fget", "method"):
                    held = getattr(held, attribute, held)
                yield from (name, self.read(held))

    def program(self, value: jec.Jaxpr) -> bytes:
        """The digest of a jaxpr, kept for the next reading if nothing was met in it that can be changed."""
        found = _PARTS.get(value)
        if found is None:
            before = self.mutable
            found = _sha(*self.operations(value))
            if self.mutable == before:
                _PARTS[value] = found
        return found

    def operations(self, value: jec.Jaxpr) -> Iterator[bytes | str]:
        """Parts of a jaxpr: every operation, its variables numbered in the order in which they appear."""
        numbers: dict[Any, int] = {}

        def atom(x: Any) -> bytes | str:
            if isinstance(x, jec.Literal):
                return self.read((x.val, str(x.aval)))
            return str(numbers.setdefault(x, len(numbers)))

        for x in (*value.constvars, *value.invars):
            yield from (atom(x), str(x.aval))
        for equation in value.eqns:
            yield equation.primitive.name
            yield from map(atom, equation.invars)
            for name in sorted(equation.params.keys() - _LATER):
                yield from (name, self.read(equation.params[name]))
            for x in equation.outvars:
                yield from (atom(x), str(x.aval))
        yield from map(atom, value.outvars)


def _array(value: Any) -> Iterator[bytes | str]:
    """Parts of an array: dtype, shape and contents."""
    if jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        value = jax.random.key_data(value)
    seen = np.asarray(value)
    yield from ("array", str(seen.dtype), str(seen.shape))
    yield repr(seen.tolist()) if seen.dtype.hasobject else np.ascontiguousarray(seen).tobytes()


def root_of(value: Any) -> str:
    """Name of the top-level package in which a function or a class was defined."""
    return (getattr(value, "__module__", None) or "").split(".")[0]


def _read_of(module: types.ModuleType, code: types.CodeType) -> dict[str, Any]:
    """What some code may read of a module, by name; nothing of those that are digested by name alone."""
    if module.__name__.split(".")[0] in LIBRARIES:
        return {}
    return {name: vars(module)[name] for name in _names_in(code) if name in vars(module)}


def _title(value: Any) -> str:
    """Full name of a function or a class."""
    return f"{value.__module__}.{value.__qualname__}"


def _content(cell: Any) -> Any:
    """The variable that a closure refers to; None where it has no value yet, which raises."""
    try:
        return cell.cell_contents
    except ValueError:
        return None


@functools.lru_cache(1024)
def _globals_of(code: types.CodeType) -> tuple[str, ...]:
    """Names of the globals that some code reads, together with those read by functions defined within it."""
    read = [i for part in _within(code) for i in dis.get_instructions(part)]
    return tuple(sorted({i.argval for i in read if i.opname in ("LOAD_GLOBAL", "LOAD_NAME")}))


@functools.lru_cache(1024)
def _names_in(code: types.CodeType) -> tuple[str, ...]:
    """All names in some code, those of attributes too, together with those of functions defined within it."""
    return tuple(sorted({name for part in _within(code) for name in part.co_names}))


def _within(code: types.CodeType) -> Iterator[types.CodeType]:
    """Some code, and that of all functions defined within it."""
    yield code
    for part in code.co_consts:
        if isinstance(part, types.CodeType):
            yield from _within(part)
