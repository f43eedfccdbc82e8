r"""Grasps, states, runs, fits and designs as files: `save` writes one, `load` reads it back, bit by bit.

A file is an archive of NumPy arrays (`numpy.load` opens it). One of them, `structure`, is a text in JSON: a
tree of nodes, in which each record stands with the public name of its class and with its fields, and each
array with its number in the archive. Nothing in a file is ever executed: classes are looked up by name among
those of jaxroll and of the libraries that it is built on, and the caller's own are given to `load`.

A record is read by its fields, whatever its constructor would do with them. A file of another version is read
as long as the fields that it holds still exist and the others have defaults.
"""

import contextlib
import dataclasses
import functools
import importlib
import json
import os
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import PyTreeDef

from ._printing import code_of, is_code, number_of
from ._results import check_instance, shown, told, traced

# Number of the format; a file with a larger one comes from a later version.
_FORMAT = 1
_TEXT = "structure"
# Where public names live, the shortest first, and the packages that a name in a file may belong to.
_DOORS = ("", ".geometry", ".contact", ".control", ".loads", ".commands", ".design", ".stability", ".scenes")
_KNOWN = ("jaxroll", "diffrax", "equinox", "optimistix", "lineax")
# The first word of every node, which is the name of what reads it.
_KINDS = ("record", "array", "code", "tuple", "list", "dict", "structure", "dtype", "name", "key", "bound")
_PLAIN = (bool, int, float, str, type(None))
# Classes of functions with bound arguments, which a file names by their place here; and the parts of each.
_BOUND, _PARTS = (functools.partial, jax.tree_util.Partial), ("func", "args", "keywords")


def save(path: str | Path, value: Any) -> Path:
    """Write a grasp, a state, a run, a shape, a fit, a design, or a tuple, list or dict of such, to a file.

    Args:
        path: The file; '.npz' is appended to a name that does not end in it. Folders are made if need be.
        value: Made of jaxroll's records, one's own dataclasses and equinox modules, arrays, and Python's
            plain values. Functions must be named in a module: a lambda has no name by which to find it.

    Returns:
        The path, with its ending.

    Raises:
        ValueError: If something in `value` cannot be written (the sentence says what, and where it is), or
            the file cannot be.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> path = jxr.save("pivoted.npz", {"grasp": grasp, "start": state})
        >>> jxr.load(path)["start"].q.tolist() == state.q.tolist()
        True
    """
    path = _named(path)
    writer = _Writer()
    tree = writer.node(value, "value")
    head = {"format": _FORMAT, "jaxroll": _version(), "tree": tree}
    text = np.frombuffer(json.dumps(head).encode(), np.uint8)
    named: dict[str, Any] = {_TEXT: text, **{str(i): a for i, a in enumerate(writer.arrays)}}
    # A file that is there is replaced in one step, so that a call which is cut off leaves the old one whole.
    beside = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with beside.open("wb") as file:
            np.savez(file, **named)
        beside.replace(path)
    except OSError as error:
        raise ValueError(
            f"argument path must name a file that can be written, but {told(path, error)}"
        ) from None
    return path


def load(path: str | Path, *, own: Sequence[Any] = ()) -> Any:
    """Read what `save` wrote: every number as it was, in records of the same classes.

    Args:
        path: The file.
        own: Those of your own classes and functions that the file names. Others may be among them.

    Returns:
        What was saved.

    Raises:
        ValueError: If the file is none that `save` wrote, is damaged, was written by a version whose records
            had other fields, names what `own` does not hold, or is of double precision while JAX is set to
            single.

    Example:
        >>> import jaxroll as jxr
        >>> path = jxr.save("tip", jxr.Circle(0.01))
        >>> float(jxr.load(path).radius)
        0.01
    """
    given, path = path, _named(path)
    named = isinstance(own, tuple | list) and all(isinstance(x, type) or _findable(x) for x in own)
    if not named:
        raise ValueError(
            f"argument own must be a list of classes and functions that a module names, but was {shown(own)}"
        )
    if not os.path.isfile(path):  # of a name that is too long `path.is_file` raises
        if os.path.isfile(given):
            raise ValueError(
                "argument path must name a file that `jaxroll.save` wrote, whose name ends in .npz, but was "
                f"{shown(str(given))}"
            )
        raise ValueError(f"argument path must name a file, but there is none called {shown(str(path))}")
    try:
        with path.open("rb") as file:  # of another file NumPy says how it could be loaded unsafely
            if not zipfile.is_zipfile(file):
                raise zipfile.BadZipFile("it is no archive of NumPy's")
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        head = json.loads(arrays.pop(_TEXT).tobytes())
        written, form = head["jaxroll"], int(head["format"])
    # A damaged archive may also say that it is encrypted, or of a later version of the format.
    except (OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, zipfile.BadZipFile) as error:
        said = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise ValueError(
            f"argument path must name a file that `jaxroll.save` wrote, but {path.name} could not be read as "
            f"one: {shown(said)}"
        ) from None
    if form > _FORMAT:
        raise ValueError(
            f"argument path must name a file of format {_FORMAT} or before, but {path.name}, written by "
            f"jaxroll {shown(written)}, has format {form}"
        )
    try:
        return _Reader(path.name, written, arrays, own).value(head["tree"])
    except (KeyError, TypeError, AttributeError, StopIteration) as error:
        raise ValueError(
            f"argument path must name a whole file, but the structure in {path.name} is damaged: "
            f"{shown(repr(error))}"
        ) from None


def _named(path: Any) -> Path:
    """The path with its ending."""
    check_instance("path", path, (str, Path), "the name of a file")
    path = Path(path)
    if not path.name:
        raise ValueError(f"argument path must name a file, but was {shown(str(path))}")
    return path if path.suffix == ".npz" else path.with_name(path.name + ".npz")


def _version() -> str:
    return importlib.import_module("jaxroll").__version__


class _Writer:
    """Turns values into nodes of JSON, and gathers their arrays.

    Attributes:
        arrays: What the archive will hold, in the order of their numbers.
    """

    def __init__(self) -> None:
        self.arrays: list[np.ndarray] = []
        self._numbers: dict[int, int] = {}
        self._kept: list[Any] = []

    def node(self, value: Any, where: str) -> Any:
        """The node of one value; `where` names it in complaints."""
        if is_code(value):
            codes, number = number_of(value)
            return {"code": _name_of(codes), "is": self.node(number, where)}
        if type(value) in _PLAIN:
            return value
        if isinstance(value, jax.Array | np.ndarray | np.generic):
            return self._array(value, where)
        if isinstance(value, dict):
            pairs = [[self.node(k, where), self.node(v, f"{where}[{k!r}]")] for k, v in value.items()]
            return {"dict": pairs}
        if isinstance(value, PyTreeDef):
            # A structure is its own tree, with numbers as leaves.
            numbered = jax.tree.unflatten(value, range(value.num_leaves))
            return {"structure": self.node(numbered, where)}
        if isinstance(value, tuple | list):
            kind = type(value)
            items = [self.node(item, f"{where}[{i}]") for i, item in enumerate(value)]
            if kind in (tuple, list):
                return {kind.__name__: items}
            return {"record": _name_of(kind), "items": items}
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            held = [f.name for f in dataclasses.fields(value) if hasattr(value, f.name)]
            fields = {name: self.node(getattr(value, name), f"{where}.{name}") for name in held}
            return {"record": _name_of(type(value)), "fields": fields}
        if isinstance(value, np.dtype):
            return {"dtype": value.str}
        if type(value) in _BOUND:  # as fields keep a caller's function
            return self._bound(value, where)
        if isinstance(value, type) or _findable(value):
            return {"name": _name_of(value)}
        raise ValueError(
            f"argument value must be made of records, arrays, plain values and functions that a module "
            f"names, but {where} was {shown(value)}"
        )

    def _bound(self, value: Any, where: str) -> dict[str, Any]:
        """The node of a function with bound arguments."""
        # A `functools.partial` in one of JAX's stands in a shell, which JAX puts round it again.
        inner = getattr(value.func, "fun", None)
        held = (inner if type(inner) in _BOUND else value.func, value.args, value.keywords)
        parts = {name: self.node(x, f"{where}.{name}") for name, x in zip(_PARTS, held, strict=True)}
        return {"bound": parts, "of": _BOUND.index(type(value))}

    def _array(self, value: Any, where: str) -> dict[str, Any]:
        if traced(value):
            raise ValueError(f"argument value must be known when it is written, but {where} is traced by JAX")
        if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
            data = self._array(jax.random.key_data(value), where)
            return {"key": data, "of": str(jax.random.key_impl(value))}
        number = self._numbers.get(id(value))
        if number is None:
            number = self._numbers[id(value)] = len(self.arrays)
            self.arrays.append(_storable(value, where))
            # Keeping the value stops Python from giving its id to another one.
            self._kept.append(value)
        kinds = {"jax": jax.Array, "numpy": np.ndarray, "scalar": np.generic}
        return {"array": number, "kind": next(k for k, kind in kinds.items() if isinstance(value, kind))}


def _storable(value: Any, where: str) -> np.ndarray:
    """An array as NumPy's own format holds it."""
    array = np.asarray(value)
    if array.dtype.kind not in "biufc" or isinstance(value, np.ma.MaskedArray):
        raise ValueError(
            f"argument value must hold arrays of booleans and numbers, none masked, but {where} was "
            f"{type(value).__name__} of dtype {array.dtype}"
        )
    return array


def _name_of(thing: Any) -> str:
    """The name under which `_found` finds a class or a function: its public one where it has one."""
    for door in _DOORS:
        name = f"jaxroll{door}"
        if thing.__module__.startswith("jaxroll.") and _attribute(name, thing.__qualname__) is thing:
            return f"{name}:{thing.__qualname__}"
    return f"{thing.__module__}:{thing.__qualname__}"


def _attribute(module: str, path: str) -> Any:
    """What a module has under a dotted path; None if there is nothing."""
    found: Any = importlib.import_module(module)
    for part in path.split("."):
        found = getattr(found, part, None)
    return found


def _findable(function: Any) -> bool:
    """Whether this is a function that a module names, so that it can be found again."""
    module, path = getattr(function, "__module__", ""), getattr(function, "__qualname__", "")
    if not (callable(function) and isinstance(module, str) and isinstance(path, str)):
        return False
    return bool(module) and "<" not in path and _attribute(module, path) is function


class _Reader:
    """Turns nodes back into values.

    Attributes:
        file: Name of the file, for complaints.
        written: The version of jaxroll that wrote it.
    """

    def __init__(self, file: str, written: str, arrays: dict[str, np.ndarray], own: Sequence[Any]) -> None:
        self.file, self.written = file, written
        self._arrays, self._made = arrays, dict[tuple[int, str], Any]()
        self._own = {_name_of(thing): thing for thing in own}

    def value(self, node: Any) -> Any:
        """The value of one node."""
        if not isinstance(node, dict):
            return node
        kind = next(iter(node))
        if kind not in _KINDS:
            raise KeyError(kind)
        return getattr(self, f"_{kind}")(node)

    def _tuple(self, node: dict[str, Any]) -> tuple[Any, ...]:
        return tuple(self.value(item) for item in node["tuple"])

    def _list(self, node: dict[str, Any]) -> list[Any]:
        return [self.value(item) for item in node["list"]]

    def _dict(self, node: dict[str, Any]) -> dict[Any, Any]:
        return {self.value(key): self.value(item) for key, item in node["dict"]}

    def _structure(self, node: dict[str, Any]) -> Any:
        return jax.tree.structure(self.value(node["structure"]))

    def _dtype(self, node: dict[str, Any]) -> np.dtype:
        return np.dtype(node["dtype"])

    def _name(self, node: dict[str, Any]) -> Any:
        return self._found(node["name"])

    def _key(self, node: dict[str, Any]) -> Any:
        return jax.random.wrap_key_data(self.value(node["key"]), impl=node["of"])

    def _bound(self, node: dict[str, Any]) -> Any:
        function, args, named = (self.value(node["bound"][name]) for name in _PARTS)
        return _BOUND[node["of"]](function, *args, **named)

    def _code(self, node: dict[str, Any]) -> Any:
        return code_of(self._found(node["code"]), self.value(node["is"]))

    def _array(self, node: dict[str, Any]) -> Any:
        """An array as it was: JAX's, NumPy's, or a number of NumPy; the same object wherever it stood."""
        at = node["array"], node["kind"]
        if at not in self._made:
            stored = self._arrays[str(at[0])]
            made = jnp.asarray(stored) if at[1] == "jax" else stored if at[1] == "numpy" else stored[()]
            if made.dtype != stored.dtype:
                raise ValueError(
                    f"argument path must be read with jax_enable_x64 set, since {self.file} holds "
                    f"{stored.dtype}"
                )
            self._made[at] = made
        return self._made[at]

    def _record(self, node: dict[str, Any]) -> Any:
        """A record, by its fields alone."""
        kind = self._found(node["record"])
        if "items" in node:
            return kind(*(self.value(item) for item in node["items"]))
        held = {name: self.value(item) for name, item in node["fields"].items()}
        fields = {f.name: f for f in dataclasses.fields(kind)}
        bare = (name for name, f in fields.items() if name not in held and not _has_default(f))
        strange, missing = sorted(held.keys() - fields.keys()), sorted(bare)
        if strange or missing:
            said = f"holds {strange[0]!r}, which it has not" if strange else f"lacks its {missing[0]!r}"
            raise ValueError(
                f"argument path must hold the fields of {kind.__name__} in jaxroll {_version()}, but "
                f"{self.file}, written by {self.written}, {said}"
            )
        made = object.__new__(kind)
        for name, item in held.items():
            object.__setattr__(made, name, item)
        for name in fields.keys() - held.keys():
            object.__setattr__(made, name, _default(fields[name]))
        return made

    def _found(self, name: str) -> Any:
        """The class or function of a name."""
        module, _, path = name.partition(":")
        if name in self._own:
            return self._own[name]
        found = None
        if module.split(".")[0] in _KNOWN:
            with contextlib.suppress(ImportError):
                found = _attribute(module, path)
        if found is None:
            known = module.split(".")[0] in _KNOWN
            whose = "which this version has not" if known else "which argument own must hold"
            raise ValueError(
                f"argument path must hold what can be found, but {self.file}, written by jaxroll "
                f"{self.written}, names {path} of {module}, {whose}"
            )
        return found


def _has_default(field: Any) -> bool:
    none = dataclasses.MISSING
    return field.default is not none or field.default_factory is not none


def _default(field: Any) -> Any:
    return field.default if field.default is not dataclasses.MISSING else field.default_factory()
