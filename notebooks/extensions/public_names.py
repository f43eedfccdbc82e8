"""Which names are public: what `jaxroll` exports, and what its public packages do.

The reference, the links of the table of equations and the names in docstrings all come from here, so that a
new export is documented without another line.
"""

import ast
import functools
import inspect
from types import ModuleType

import jaxroll


def packages() -> dict[str, ModuleType]:
    """The public packages and modules, by name."""
    found = {name: getattr(jaxroll, name) for name in sorted(jaxroll.__all__)}
    return {f"jaxroll.{name}": value for name, value in found.items() if isinstance(value, ModuleType)}


def exported(package: ModuleType) -> dict[str, object]:
    """What one package or module exports: what it says by `__all__`, and else what it defines and imports.

    Of what it imports that is what has the form `x as x`, which is how type checkers are told of an export.
    """
    if hasattr(package, "__all__"):
        return {name: getattr(package, name) for name in sorted(package.__all__)}
    names = set()
    for node in ast.parse(inspect.getsource(package)).body:
        if isinstance(node, ast.ImportFrom):
            names |= {alias.asname for alias in node.names if alias.asname}
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {target.id for target in targets if isinstance(target, ast.Name)}
    found = {name: getattr(package, name) for name in sorted(names) if not name.startswith("_")}
    return {name: value for name, value in found.items() if not isinstance(value, ModuleType)}


@functools.cache
def public_names() -> dict[str, object]:
    """Every public object by its shortest full name; the packages themselves are not among them."""
    own = {name: getattr(jaxroll, name) for name in sorted(jaxroll.__all__)}
    found = {f"jaxroll.{name}": value for name, value in own.items() if not isinstance(value, ModuleType)}
    seen = {id(value) for value in found.values()}
    for path, package in packages().items():
        for name, value in exported(package).items():
            if id(value) not in seen:
                found[f"{path}.{name}"] = value
                seen.add(id(value))
    return found


def home(value: object) -> tuple[str, str]:
    """Where an object is defined: module and name in it."""
    return getattr(value, "__module__", ""), getattr(value, "__qualname__", "")


@functools.cache
def by_home() -> dict[tuple[str, str], str]:
    """Full public name by the place of the definition."""
    return {home(value): name for name, value in public_names().items() if home(value)[1]}


@functools.cache
def aliases() -> dict[str, str]:
    """Every spelling of public names in docstrings: `Circle`, `geometry.Circle`, `jxr.Circle`."""
    full = {id(value): name for name, value in public_names().items()}
    found = {}
    spelt = dict(public_names())
    for path, package in packages().items():
        spelt |= {f"{path}.{name}": value for name, value in exported(package).items()}
    for name, value in spelt.items():
        short = name.removeprefix("jaxroll.")
        for spelling in (name, short, f"jxr.{short}"):
            found[spelling] = full[id(value)]
    return found


def undocumented() -> list[str]:
    """Public functions and classes without a docstring."""
    things = {name: value for name, value in public_names().items() if home(value)[1]}
    return [name for name, value in things.items() if not inspect.getdoc(value)]
