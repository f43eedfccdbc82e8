"""Lowered derivatives, stored beside JAX's cache of compiled programs for other processes.

What JAX stores spares a second process the compiler, but neither tracing nor lowering: for the gradient of a
spatial pinch these are more than half of its first call, and most of them is the derivative of a run, which
is traced where it is lowered (`_primitives`). That part is what it is by the grasp's structure, not by its
numbers. Where the caller has given JAX a folder (`jax_compilation_cache_dir`), it is exported to a file
there, and found by a digest of all that it depends on: this package's own files, the versions of JAX and its
like, settings, kinds and shapes of all arrays, and what `_fingerprint` reads of the rest.

What a caller wrote is not among it. Of a function there is no digest that would be sure to see all that
changes its derivative, so that a grasp with a law, load, contour or contact of a caller's own is traced in
every process.
"""

import contextlib
import contextvars
import functools
import hashlib
import pathlib
import sys
import tempfile
import types
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.export
import jax.extend.core as jec

from .._fingerprint import LIBRARIES, PACKAGES, Reader, root_of, version_of

_OFF: contextvars.ContextVar[bool] = contextvars.ContextVar("off", default=False)
_PACKAGE = __name__.split(".")[0]
# Parts of this package that no derivative uses; they hold functions of libraries that draw and print.
_ASIDE = ("plotting", "_cli")
# Settings of JAX that change what is traced or lowered.
_SETTINGS = (
    "default_matmul_precision",
    "default_prng_impl",
    "enable_x64",
    "numpy_dtype_promotion",
    "threefry_partitionable",
    "use_direct_linearize",
)


class _OwnError(Exception):
    """A value holds what a caller wrote."""


class _Strict(Reader):
    """A reading that ends at functions and classes other than a library's, as the library has them."""

    def parts(self, value: Any) -> Iterator[bytes | str]:
        # `Reader` does not read the rules for derivatives in a traced program.
        if isinstance(value, jec.Jaxpr | jec.ClosedJaxpr | types.ModuleType):
            raise _OwnError
        return super().parts(value)

    def function(self, value: types.FunctionType) -> Iterator[bytes | str]:
        # Functions within a function share a name, whatever they do.
        if root_of(value) not in LIBRARIES or "<" in value.__qualname__:
            raise _OwnError
        return super().function(value)

    def kind(self, value: type) -> Iterator[bytes | str]:
        held = [x for base in value.__mro__ for x in vars(base).values()]
        # The constructor of a named tuple has a module of its own.
        methods = [x for x in held if isinstance(x, types.FunctionType) and x.__name__ != "__new__"]
        if any(root_of(x) not in LIBRARIES for x in (value, *methods)):
            raise _OwnError
        return super().kind(value)


@contextlib.contextmanager
def unstored() -> Iterator[None]:
    """While inside, nothing is read or stored, and programs are the same with a folder and without."""
    token = _OFF.set(True)
    try:
        yield
    finally:
        _OFF.reset(token)


def stored(function: Callable, about: Any, avals: Sequence[Any]) -> Callable:
    """A function that gives the same as `function` from arrays; read from a file where there is one for it.

    Args:
        function: Of arrays, to a list of arrays.
        about: All that it depends on. If that holds what a caller wrote, `function` itself is returned.
        avals: Shapes and dtypes of the arrays.
    """
    folder = _folder()
    if folder is None or not _as_installed():
        return function
    kinds = [jax.ShapeDtypeStruct(aval.shape, aval.dtype, weak_type=aval.weak_type) for aval in avals]
    try:
        settings = [_setting(name) for name in _SETTINGS]
        digest = _Strict().read((_package(), settings, about, [str(aval) for aval in avals])).hex()
    except _OwnError:
        return function
    path = folder / f"jaxroll-{digest}"
    found = _read(path)
    if found is None:
        try:
            found = jax.export.export(jax.jit(function), platforms=["cpu"])(*kinds)
        except (ValueError, NotImplementedError):  # it calls Python, or a routine of this process
            return function
        # Read back as another process will read it, so that the same program is compiled in both.
        found = jax.export.deserialize(_written(path, found.serialize()))
    return found.call


def _folder() -> pathlib.Path | None:
    """Where JAX keeps compiled programs, if it keeps any, and as many as there are."""
    folder, enabled = _setting("compilation_cache_dir"), _setting("enable_compilation_cache")
    unlimited = _setting("compilation_cache_max_size") == -1
    if _OFF.get() or not (folder and enabled and unlimited) or "://" in folder:
        return None
    return pathlib.Path(folder)


def _as_installed() -> bool:
    """Whether all functions in the modules of this package are a library's, and none is a caller's."""
    package, aside = _PACKAGE + ".", tuple(f"{_PACKAGE}.{part}" for part in _ASIDE)
    names = [name for name in sys.modules if name.startswith(package) and not name.startswith(aside)]
    modules = [sys.modules[name] for name in names]
    held = [x for module in modules for x in vars(module).values() if isinstance(x, types.FunctionType)]
    return all(root_of(x) in LIBRARIES for x in held)


def _setting(name: str) -> Any:
    return getattr(jax.config, f"jax_{name}")


def _read(path: pathlib.Path) -> jax.export.Exported | None:
    """What is stored in a file; None where there is none, or it does not hold all that was written."""
    try:
        check, data = (text := path.read_bytes())[:32], text[32:]
    except OSError:
        return None
    return jax.export.deserialize(bytearray(data)) if hashlib.sha256(data).digest() == check else None


def _written(path: pathlib.Path, data: bytearray) -> bytearray:
    """The same data, after writing it to a file, whole or not at all; a folder may refuse it."""
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        file = tempfile.NamedTemporaryFile(dir=path.parent, prefix=".", delete=False)
        part = pathlib.Path(file.name)
        try:
            with file:
                file.write(hashlib.sha256(data).digest() + data)
            part.replace(path)
        finally:  # a full disk leaves no pieces
            part.unlink(missing_ok=True)
    return data


@functools.cache
def _package() -> str:
    """A digest of this package's own files, and of the versions of the libraries."""
    digest, folder = hashlib.sha256(), pathlib.Path(__file__).parents[1]
    for path in sorted(folder.rglob("*.py")):
        digest.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes() + b"\0")
    digest.update(repr([version_of(name) for name in PACKAGES]).encode())
    return digest.hexdigest()
