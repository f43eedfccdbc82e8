"""Fingerprints: a digest of all that a value or a program holds, the same in every process.

Two things with one fingerprint give the same numbers. The converse is not promised: a function that is
written anew in other words has another fingerprint.
"""

import dataclasses
import dis
import enum
import functools
import hashlib
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

# Functions and classes of these are known by name: their versions are compared beside the fingerprints.
_LIBRARIES = sys.stdlib_module_names | {
    "beartype",
    "diffrax",
    "equinox",
    "jax",
    "jaxlib",
    "jaxroll",
    "jaxtyping",
    "lineax",
    "numpy",
    "optax",
    "optimistix",
}
_ADDRESS = re.compile(r"\b0x[0-9a-f]+")
_PLAIN = (type(None), type(...), bool, int, float, complex, str, bytes, np.dtype)
_NOTHING = object()
# What is inside of things that hold others.
_HOLDERS: tuple[tuple[Any, Callable], ...] = (
    (tuple | list | set | frozenset, list),
    (dict, lambda value: list(value.items())),
    (types.MethodType, lambda value: (value.__self__, value.__func__)),
    (functools.partial, lambda value: (value.func, value.args, value.keywords)),
    (jax.tree_util.PyTreeDef, lambda value: (value.node_data(), value.children())),
)
_UNORDERED = (dict, set, frozenset)
# Parameters of operations that say how they would be mapped or differentiated, and what they are called.
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
# Digests of programs that hold nothing that can change.
_PARTS: WeakKeyDictionary[jec.Jaxpr, bytes] = WeakKeyDictionary()
# One function of a lowered program, and the names of others in it.
_FUNCTION = re.compile(r"^  func\.func \w+ @(\"[^\"]*\"|[\w.$-]+)(.*?)^  }$", re.MULTILINE | re.DOTALL)
_NAME = re.compile(r"@(\"[^\"]*\"|[\w.$-]+)")
# What says nothing of the numbers: the name of the program, those of results, the places of callbacks.
_NOISE = re.compile(
    r"^module @\S+|jax\.result_info = \"[^\"]*\"|\{index = \d+ : ui64\}|backend_config = \"\d+\"",
    re.MULTILINE,
)


def fingerprint(value: Any) -> str:
    """The fingerprint of any value.

    Numbers and arrays count by value, objects by class and fields, functions by their code and what they
    close over, traced programs by operations and constants.
    """
    return _Reader().read(value).hex()


def of_lowered(text: str) -> str:
    """The fingerprint of a lowered program, constants included.

    Names of functions do not count, nor how many copies of one there are, which depends on what was traced
    before: each is known by its own fingerprint.
    """
    text = _NOISE.sub("", text)
    bodies = {found[1]: found[2] for found in _FUNCTION.finditer(text)}

    @functools.cache
    def digest(name: str) -> str:
        return _sha(_NAME.sub(lambda m: digest(m[1]) if m[1] in bodies else m[0], bodies[name])).hex()

    rest = _FUNCTION.sub("", text)
    return _sha(rest, digest("main")).hex()


def _sha(*parts: bytes | str) -> bytes:
    """A digest of parts, each with its length, so that no two lists of parts run together."""
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(len(data).to_bytes(8, "little"))
        digest.update(data)
    return digest.digest()


class _Reader:
    """One reading of a value, in which nothing is read twice and cycles end."""

    def __init__(self) -> None:
        # How many things were met whose insides can change without their being another object.
        self.mutable = 0
        # By identity; the values are kept, so that their numbers stay their own.
        self.done: dict[int, tuple[Any, bytes]] = {}
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
        """What a value consists of."""
        if isinstance(value, jax.core.Tracer):
            return iter(("traced", str(value.aval)))
        if isinstance(value, jec.ClosedJaxpr):
            return iter(("closed", self.read(value.jaxpr), *map(self.read, value.consts)))
        if isinstance(value, jec.Jaxpr):
            return iter((self.program(value),))
        if hasattr(value, "__array__") and hasattr(value, "dtype"):
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
        """Containers and objects: their class, and what they hold."""
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
        """Any other object: its attributes, and of JAX's own, which hold the whole world, what they print."""
        inner = getattr(value, "__wrapped__", None)
        if inner is not None:
            yield self.read(inner)
        elif _root(type(value)) in ("jax", "jaxlib") or not hasattr(value, "__dict__"):
            yield _ADDRESS.sub("", getattr(value, "__qualname__", None) or repr(value))
        else:
            yield self.read(vars(value))

    def function(self, value: types.FunctionType) -> Iterator[bytes | str]:
        """A function: its code, the globals that it names, its defaults and what it closes over."""
        self.mutable += 1
        if _root(value) in _LIBRARIES:
            yield _title(value)
        else:
            yield self.read(value.__code__)
            named = {name: value.__globals__.get(name, _NOTHING) for name in _globals_of(value.__code__)}
            yield self.read({name: found for name, found in named.items() if found is not _NOTHING})
        yield self.read(value.__defaults__)
        yield self.read(value.__kwdefaults__)
        for cell in value.__closure__ or ():
            yield self.read(_content(cell))

    def code(self, value: types.CodeType) -> Iterator[bytes | str]:
        yield value.co_code
        parts = (value.co_consts, value.co_names, value.co_varnames, value.co_freevars, value.co_flags)
        yield from map(self.read, parts)

    def kind(self, value: type) -> Iterator[bytes | str]:
        """A class: its name, and the methods and constants of a caller's own."""
        yield _title(value)
        if _root(value) in _LIBRARIES:
            return
        yield from map(self.read, value.__bases__)
        for name, held in sorted(vars(value).items()):
            if name == "__call__" or not name.startswith("__"):
                for attribute in ("__func__", "fget", "method"):  # static, property, equinox's
                    held = getattr(held, attribute, held)
                yield from (name, self.read(held))

    def program(self, value: jec.Jaxpr) -> bytes:
        """A traced program; digests are kept with the parts that JAX keeps."""
        found = _PARTS.get(value)
        if found is None:
            before = self.mutable
            found = _sha(*self.operations(value))
            if self.mutable == before:
                _PARTS[value] = found
        return found

    def operations(self, value: jec.Jaxpr) -> Iterator[bytes | str]:
        """Every operation of a program, with its variables numbered in the order they appear."""
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
    if jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        value = jax.random.key_data(value)
    seen = np.asarray(value)
    yield from ("array", str(seen.dtype), str(seen.shape))
    yield repr(seen.tolist()) if seen.dtype.hasobject else np.ascontiguousarray(seen).tobytes()


def _root(value: Any) -> str:
    """The package that a function or a class is from."""
    return (getattr(value, "__module__", None) or "").split(".")[0]


def _title(value: Any) -> str:
    return f"{value.__module__}.{value.__qualname__}"


def _content(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # not filled yet
        return None


@functools.lru_cache(1024)
def _globals_of(code: types.CodeType) -> tuple[str, ...]:
    """Names of globals that a function reads, those inside it included."""
    names = {i.argval for i in dis.get_instructions(code) if i.opname in ("LOAD_GLOBAL", "LOAD_NAME")}
    for inner in code.co_consts:
        if isinstance(inner, types.CodeType):
            names.update(_globals_of(inner))
    return tuple(sorted(names))
