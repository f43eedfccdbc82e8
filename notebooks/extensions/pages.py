"""The pages that nobody writes: the table of equations, and the reference of all public names."""

import functools
import inspect
import itertools
import pathlib
import typing
from collections.abc import Iterator

from . import equations, public_names

# Headings of the reference's pages by the part of jaxroll in which a name is defined; a part that is not
# here has its own name.
TITLES = {
    "_analysis": "Contact geometry, balances, loci",
    "_closing": "Closing contacts",
    "_integration": "Runs",
    "_mechanics": "Bodies and grasps",
    "_motion": "Forces, torques, energies",
    "_results": "Result codes",
    "_saving": "Files of records",
    "_sweep": "Many runs",
    "_why": "Why a grasp fails",
    "commands": "Commands: functions of time",
    "contact": "Contacts, and where shapes are nearest",
    "control": "Control",
    "design": "Design of fingertips",
    "geometry": "Contours and surfaces",
    "io": "Files and images",
    "loads": "Loads",
    "plotting": "Figures",
    "scenes": "Scenes",
    "stability": "Equilibria and stability",
}


def part_of(value: object, name: str) -> str:
    """The part of jaxroll that defines a public object; of a constant, the package that exports it."""
    module, qualified = public_names.home(value)
    return (module if qualified and module.startswith("jaxroll.") else name).split(".")[1]


@functools.cache
def records() -> dict[str, type]:
    """Classes that public functions return, or that public classes hold, without being exported."""
    known, found = set(public_names.by_home()), {}
    waiting = list(public_names.public_names().values())
    while waiting:
        for cls in _mentioned(waiting.pop()):
            if public_names.home(cls) not in known and not cls.__name__.startswith("_"):
                known.add(public_names.home(cls))
                found[f"{cls.__module__}.{cls.__qualname__}"] = cls
                waiting.append(cls)
    return dict(sorted(found.items(), key=lambda item: item[1].__name__))


def _mentioned(value: object) -> Iterator[type]:
    """Classes of jaxroll in what a function returns, or in the fields of a class."""
    if inspect.isclass(value):
        hints = list(inspect.get_annotations(value).values())
    elif callable(value):
        hints = [inspect.get_annotations(inspect.unwrap(value)).get("return")]
    else:
        hints = []
    while hints:
        hint = hints.pop()
        hints += typing.get_args(hint)
        if inspect.isclass(hint) and hint.__module__.startswith("jaxroll."):
            yield hint


@functools.cache
def targets() -> dict[str, str]:
    """Where the reference has an object, by the full name of its definition."""
    exported = {".".join(home): name for home, name in public_names.by_home().items()}
    return exported | {name: name for name in records()}


def _directive(name: str, value: object) -> str:
    kind = "class" if inspect.isclass(value) else "function" if callable(value) else "data"
    options = "   :members:\n   :show-inheritance:\n" if inspect.isclass(value) else ""
    if inspect.isclass(value) and (others := _others_of(value)):
        options += f"   :inherited-members: {', '.join(others)}\n"
    return f".. auto{kind}:: {name}\n{options}"


def _others_of(cls: type) -> list[str]:
    """Bases whose members are not told with a class, if it has bases that have no entry and so are."""
    bases = cls.__mro__[1:-1]
    hidden = list(itertools.takewhile(_has_no_entry, bases))
    return [base.__name__ for base in bases[len(hidden) :]] if hidden else []


def _has_no_entry(cls: type) -> bool:
    own = cls.__module__.startswith("jaxroll.")
    return own and ".".join(public_names.home(cls)) not in targets()


def reference() -> dict[str, str]:
    """The pages of the reference, by file name."""
    parts: dict[str, list[tuple[str, object]]] = {}
    for name, value in public_names.public_names().items():
        parts.setdefault(part_of(value, name), []).append((name, value))
    pages = {}
    for part, names in parts.items():
        package = f"jaxroll.{part}"
        intro = f".. automodule:: {package}\n\n" if package in public_names.packages() else ""
        body = "\n".join(_directive(*each) for each in names)
        pages[f"{part.strip('_')}.rst"] = _titled(TITLES.get(part, part.strip("_"))) + intro + body
    told = "What public functions return and public classes hold: made by jaxroll, read by users.\n\n"
    body = "\n".join(_directive(*each) for each in records().items())
    pages["records.rst"] = _titled("Records") + told + body
    ordered = sorted(pages, key=lambda name: _order(name, pages))
    names = "".join(f"   {name.removesuffix('.rst')}\n" for name in ordered)
    told = "Every public name, with the mathematics, units, errors and an example of each.\n\n"
    told += "In signatures ``Given`` is any number or array of numbers: Python's, NumPy's, JAX's.\n\n"
    pages["index.rst"] = _titled("Reference") + told + ".. toctree::\n   :maxdepth: 1\n\n" + names
    return pages


def _order(name: str, pages: dict[str, str]) -> tuple[bool, str]:
    """By title; the records come last."""
    return name == "records.rst", pages[name]


def _titled(title: str) -> str:
    return f"{title}\n{'=' * len(title)}\n\n"


def _link(place: equations.Place) -> str:
    """A public name as a link to the reference, any other as where it is."""
    module = place.path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    found = targets().get(f"{module}.{place.name}") if place.name else None
    if found:
        return f"{{py:obj}}`{found.split('.')[-1]} <{found}>`"
    return f"`{place.path.removeprefix('jaxroll/')}`" + (f": `{place.name}`" if place.name else "")


def table_of_equations() -> str:
    """The page of equations, with what is written about it."""
    head = (pathlib.Path(__file__).parent / "equations_head.md").read_text()
    return head + "\n" + equations.page(equations.table(), _link)


def write(folder: pathlib.Path) -> None:
    """Write all pages, each only if it is not as it was: what is unchanged is not read again."""
    wanted = {f"reference/{name}": text for name, text in reference().items()}
    wanted["equations.md"] = table_of_equations()
    for path in folder.rglob("*.*") if folder.exists() else ():
        if path.relative_to(folder).as_posix() not in wanted:
            path.unlink()
    for name, text in wanted.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
