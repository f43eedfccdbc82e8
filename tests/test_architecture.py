"""The design as a test: layers, doors, abstract or final, size budget, public names."""

import ast
import collections
import importlib
import inspect
import itertools
import pathlib
import pkgutil
import re
import statistics
import subprocess
import sys

import equinox as eqx
import pytest

import jaxroll as jxr
from notebooks.extensions import public_names

ROOT = pathlib.Path(jxr.__file__).parent
RANKS = {
    "_fingerprint": 0,
    "_types": 0,
    "_printing": 0,
    "_results": 1,
    "_closures": 2,
    "_xla": 2,
    "_fields": 3,
    "_linalg": 3,
    "commands": 4,
    "geometry": 4,
    "contact": 5,
    "_mechanics": 6,
    "control": 7,
    "loads": 7,
    "_motion": 8,
    "_closing": 9,
    "_integration": 10,
    "_analysis": 11,
    "_reaching": 11,
    "stability": 12,
    "_sweep": 12,
    "_why": 13,
    "_identify": 13,
    "design": 13,
    "scenes": 13,
    "io": 13,
    "_maps": 14,
    "plotting": 15,
    "_saving": 15,
    "__init__": 16,
    "_cli": 17,
    "__main__": 18,
}
# One door each.
DOORS = {
    "diffrax": {"_integration", "_analysis", "_sweep"},
    "optimistix": {"_integration"},
    "optax": {"design", "geometry"},
    "matplotlib": {"plotting"},
    "tqdm": {"_sweep", "_maps"},
    "scipy": set(),
    "numba": set(),
}
# Libraries of the extras `cad`, `viz`, `data` and `cluster`: one file each, imported with the first use; dask
# is nowhere imported, since whoever has a client of it has imported it.
LAZY_DOORS = {
    "svgpathtools": "io/_svg.py",
    "ezdxf": "io/_dxf.py",
    "trimesh": "io/_mesh.py",
    "mapbox_earcut": "io/_mesh.py",
    "skimage": "io/_image.py",
    "plotly": "plotting/_page.py",
    "mujoco": "io/_robot_file.py",
    "xarray": "_integration/_dataset.py",
    "zarr": "_sweep/_store.py",
    "cloudpickle": "_sweep/_sending.py",
    "dask": "_cli/_sweep_command.py",
    "distributed": "",
}
FILES = sorted(ROOT.rglob("*.py"))


def unit(path):
    """The layer a file belongs to."""
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def module_level(tree):
    """Import statements that run when the module is imported."""
    for node in tree.body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node


def targets(node, path):
    """Names of the modules that an import statement brings in."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if node.level == 0:
        return [node.module]
    depth = len(path.relative_to(ROOT).parts) - node.level
    if depth < 0:
        raise AssertionError(f"{path}: import above the package")
    inside = path.relative_to(ROOT).parts[:depth]
    names = [node.module] if node.module else [alias.name for alias in node.names]
    return ["jaxroll." + ".".join((*inside, name)) for name in names]


def violations(path, tree):
    here, found = unit(path), []
    for node in module_level(tree):
        for target in targets(node, path):
            head, *rest = target.split(".")
            if head == "jaxroll" and rest:
                if rest[0] != here and RANKS[rest[0]] >= RANKS[here]:
                    found.append(f"{path.name}: {here} imports {rest[0]}")
            elif head in DOORS and here not in DOORS[head]:
                found.append(f"{path.name}: {here} imports {head}")
    return found


def test_every_import_points_down():
    found = [v for p in FILES for v in violations(p, ast.parse(p.read_text()))]
    assert not found


def lazy_violations(path, tree):
    """Libraries imported outside their own file, or as soon as it is imported."""
    here, early = path.relative_to(ROOT).as_posix(), list(module_level(tree))
    for node in ast.walk(tree):
        if not isinstance(node, ast.Import | ast.ImportFrom):
            continue
        for target in targets(node, path):
            door = LAZY_DOORS.get((target or "").split(".")[0])
            if door is not None and (door != here or node in early):
                yield f"{here} imports {target}"


def test_one_file_of_geometry_imports_optax():
    """Wherever in the file: it is imported late, for it takes 0.2 s."""
    found = {
        path.name
        for path in (ROOT / "geometry").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Import | ast.ImportFrom)
        and any(target.split(".")[0] == "optax" for target in targets(node, path))
    }
    assert found == {"_network_descent.py"}


def test_libraries_of_the_extra_have_one_lazy_door_each():
    trees = {p: ast.parse(p.read_text()) for p in FILES}
    assert not [v for p, tree in trees.items() for v in lazy_violations(p, tree)]
    bad = ast.parse("import ezdxf\ndef f():\n    import trimesh\n")
    assert len(list(lazy_violations(ROOT / "io" / "_svg.py", bad))) == 2


def test_the_import_check_sees_a_bad_import():
    bad = ast.parse("import matplotlib.pyplot\nfrom .._integration import simulate\n")
    assert len(violations(ROOT / "_mechanics" / "_grasp.py", bad)) == 2


TREES = {path: ast.parse(path.read_text()) for path in FILES}


def imported_by(path):
    """What a file imports, wherever in it: (module, name) with paths of modules below the package."""
    for node in ast.walk(TREES[path]):
        if isinstance(node, ast.ImportFrom) and node.level:
            inside = path.relative_to(ROOT).parts[: -node.level]
            place = ROOT.joinpath(*inside, *(node.module or "").split("."))
            yield from ((place, alias.name) for alias in node.names)


def home(place, name):
    """The file that defines a name, through whatever packages it is passed on."""
    if (place / f"{name}.py").exists() or (place / name / "__init__.py").exists():
        place = place / name
    if place.with_suffix(".py").exists():
        return place.with_suffix(".py")
    door = place / "__init__.py"
    onwards = [where for where in imported_by(door) if where[1] == name]
    return home(*onwards[0]) if onwards else door


def import_cycles(graph):
    """Files that import each other in a ring."""
    left = set(graph)
    while free := {path for path in left if not graph[path] & left}:
        left -= free
    return left


def test_no_import_cycles():
    """Those inside of functions included."""
    files = [path for path in FILES if path.name != "__init__.py"]
    graph = {path: {home(*where) for where in imported_by(path)} for path in files}
    assert sum(map(len, graph.values())) > 500
    assert not import_cycles(graph)
    assert import_cycles({"a": {"b"}, "b": {"a"}, "c": {"a"}}) == {"a", "b", "c"}


def test_no_file_name_is_used_twice():
    names = [path.name for path in FILES if path.name != "__init__.py"]
    assert len(names) > 100
    assert not {name for name in names if names.count(name) > 1}


def defined(tree):
    """Public names that a module defines at its top level; imported ones are somebody else's."""
    names = set()
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names.add(node.name)
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            wanted = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {leaf.id for one in wanted for leaf in ast.walk(one) if isinstance(leaf, ast.Name)}
    return {name for name in names if not name.startswith("_")}


def test_no_public_name_has_two_homes():
    """One name, one thing: what two modules define under one name, a reader takes for the other."""
    homes = collections.defaultdict(list)
    for path in FILES:
        for name in defined(ast.parse(path.read_text())):
            homes[name].append(path.name)
    assert len(homes) > 500
    assert not {name: paths for name, paths in homes.items() if len(paths) > 1}


# Interfaces that their libraries do not document, or not as stable.
UNSTABLE = re.compile(
    r"jax\.(core|extend|interpreters|experimental|lib)\.|jaxlib\.|equinox\.internal\.|\w+\._[a-z]"
)


def from_libraries(tree):
    """Every name that a file takes from a library, in full: the module as imported, then attributes."""
    full = {}
    for node in ast.walk(tree):
        for alias in node.names if isinstance(node, ast.Import | ast.ImportFrom) else ():
            if isinstance(node, ast.ImportFrom):
                full[alias.asname or alias.name] = f"{'.' * node.level}{node.module}.{alias.name}"
            else:
                head = alias.name.split(".")[0]
                full[alias.asname or head] = alias.name if alias.asname else head
    chains = [node for node in ast.walk(tree) if isinstance(node, ast.Name | ast.Attribute)]
    inner = {id(node.value) for node in chains if isinstance(node, ast.Attribute)}
    for text in (ast.unparse(node) for node in chains if id(node) not in inner):
        head, *rest = text.split(".")
        if head in full and re.fullmatch(r"[\w.]+", text):
            yield ".".join([full[head], *rest])


def own_members(tree):
    """What a file's classes define: methods, fields, attributes that they set."""
    for node in ast.walk(tree):
        for inner in node.body if isinstance(node, ast.ClassDef) else ():
            yield getattr(inner, "name", None) or getattr(getattr(inner, "target", None), "id", None)
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr


def private_names(tree, own):
    """Names of libraries that are not stable, and private attributes that no class of jaxroll's has."""
    yield from (name for name in from_libraries(tree) if UNSTABLE.match(name))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and re.match("_[a-z]", node.attr) and node.attr not in own:
            yield f".{node.attr}"


def listed_private_names():
    """Pairs of name and file in the table of private names."""
    table = (ROOT / "_xla" / "README.md").read_text().split("## Private names")[1]
    for row in re.findall(r"^\| (`.*?) \| (`.*?) \|", table, flags=re.M):
        names, files = (re.findall("`([^`]+)`", column) for column in row)
        yield from itertools.product(names, files)


def test_private_names_of_libraries_are_listed():
    own = {name for tree in TREES.values() for name in own_members(tree)} | {
        "_replace",
        "_asdict",
    }  # a tuple's, public
    found = {
        (name, path.relative_to(ROOT).with_suffix("").as_posix())
        for path, tree in TREES.items()
        for name in private_names(tree, own)
    }
    listed = set(listed_private_names())
    of = lambda use, entry: use[1] == entry[1] and f"{use[0]}.".startswith(f"{entry[0]}.")  # noqa: E731
    assert not [use for use in found if not any(of(use, entry) for entry in listed)]
    assert not [entry for entry in listed if not any(of(use, entry) for use in found)]
    bad = "import jax.extend as je\nfrom jax._src import core\nx = je.core.Jaxpr(core.a)._hidden\n"
    assert set(private_names(ast.parse(bad), own)) == {"jax.extend.core.Jaxpr", "jax._src.core.a", "._hidden"}


def all_modules():
    found = [m.name for m in pkgutil.walk_packages(jxr.__path__, "jaxroll.") if m.name != "jaxroll.__main__"]
    return [importlib.import_module(name) for name in found]


def is_abstract(cls):
    """Whether a class cannot be instantiated: equinox counts abstract fields apart from abstract methods."""
    return inspect.isabstract(cls) or bool(getattr(cls, "__abstractvars__", ()))


def test_classes_are_abstract_or_final():
    """Nothing concrete is subclassed; abstract names say so."""
    classes = {
        c
        for m in all_modules()
        for c in vars(m).values()
        if inspect.isclass(c) and c.__module__.startswith("jaxroll") and issubclass(c, eqx.Module)
    }
    assert len(classes) > 20
    for cls in classes:
        assert is_abstract(cls) == cls.__name__.startswith("Abstract"), cls
        for base in cls.__mro__[1:]:
            if base.__module__.startswith("jaxroll"):
                assert is_abstract(base), f"{cls} subclasses the concrete {base}"


def code_lines(node):
    """Lines of a function without its docstring."""
    doc = ast.get_docstring(node, clean=False)
    return node.end_lineno - node.lineno + 1 - (len(doc.splitlines()) if doc else 0)


def nesting(node, depth=0):
    deeper = (ast.For, ast.While, ast.If, ast.With, ast.Try)
    inner = [
        nesting(child, depth + isinstance(child, deeper))
        for child in ast.iter_child_nodes(node)
        if not isinstance(child, ast.FunctionDef)
    ]
    return max([depth, *inner])


def functions():
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                yield path.name, node


def test_size_budget():
    lengths = [len(p.read_text().splitlines()) for p in FILES]
    assert statistics.median(lengths) <= 200
    assert max(lengths) <= 500
    for name, node in functions():
        where = f"{name}:{node.name}"
        assert code_lines(node) <= 60, where
        assert nesting(node) <= 3, where


CONTRACTS = ("step", "init", "adapt_step_size")
TOLD = ("simulate", "sweep", "why", "optimise_fingertip")


def test_parameter_budget():
    """At most four by position (self aside) and ten in all; diffrax fixes those of its contracts.

    What a run may be told is one keyword each: `simulate`, `sweep`, which tells it to many, and `why`, which
    tells it to its own; so is what a search for a fingertip may be told.
    """
    for name, node in functions():
        if node.name.startswith("_") or node.name in (*CONTRACTS, *TOLD):
            continue
        given = [a for a in node.args.posonlyargs + node.args.args if a.arg not in ("self", "cls")]
        assert len(given) <= 4, f"{name}:{node.name}"
        assert len(given) + len(node.args.kwonlyargs) <= 10, f"{name}:{node.name}"


PUBLIC = {
    "AbstractSurface", "Contact3", "Ellipsoid", "Finger3", "FreeObject3", "Plane", "Sphere", "Stage", "Torus",
    "Turning", "link_clearance", "loci", "roll", "Rosenbrock", "why", "accelerations", "resume", "strike",
    "torques", "wrenches",
    "AbstractContact", "AbstractContour", "CSM", "Catenary", "Circle", "Contact", "Ellipse", "Finger",
    "FreeObject", "Grasp", "Index1", "Jaw", "Line", "NeuralCurvature", "NeuralSupport", "Parametric",
    "PivotedObject", "RESULTS",
    "Spline", "State", "SupportFunction", "Trajectory", "close", "contact", "contact_geometry",
    "commands", "control", "design", "energies", "equation_terms", "fit_contour", "geometry", "io", "loads",
    "multipliers",
    "pinch_balance", "plotting", "press_balance", "grasp_points", "GraspPoints", "Reach", "reach",
    "Parameters", "adaptive_map", "measures", "identify", "Identified",
    "load", "residuals", "save", "scenes", "simulate", "stability", "sweep", "vector_field",
}  # fmt: skip


def test_public_names():
    assert set(jxr.__all__) == set(dir(jxr)) == PUBLIC
    starred = {}
    exec("from jaxroll import *", starred)
    assert set(starred) - {"__builtins__"} == PUBLIC
    assert all(getattr(jxr, name) is not None for name in PUBLIC)
    assert not hasattr(jxr, "integration") and not hasattr(jxr, "mechanics")
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = jxr.nothing


def test_public_modules_complete_to_their_own_names():
    """What the tab key offers in `jxr.loads.`: no library, no helper that the module imports for itself."""
    modules = [value for name in PUBLIC if inspect.ismodule(value := getattr(jxr, name))]
    assert len(modules) == 10
    for module in modules:
        offered = {name: getattr(module, name) for name in dir(module) if not name.startswith("_")}
        # A package's subpackages are attributes of it, once they are imported.
        parts = {name for name, value in offered.items() if inspect.ismodule(value)}
        assert all(offered[name].__name__ == f"{module.__name__}.{name}" for name in parts)
        assert set(offered) - parts == set(public_names.exported(module)), module
    starred = {}
    exec("from jaxroll.loads import *", starred)
    assert set(starred) - {"__builtins__"} == set(jxr.loads.__all__)


def test_public_things_have_docstrings():
    for name in PUBLIC:
        assert inspect.getdoc(getattr(jxr, name)), name


IMPORT = """
import time, sys, jax
before = set(sys.modules)  # jax itself imports cloudpickle where that is installed
start = time.perf_counter()
import jaxroll
took = time.perf_counter() - start
heavy = ("matplotlib", "scipy", "numba", "ezdxf", "trimesh", "skimage", "plotly", "mujoco")
heavy += ("xarray", "zarr", "dask", "distributed", "cloudpickle")
bad = [m for m in heavy if m in set(sys.modules) - before]
print(took, jax.config.jax_enable_x64, bad)
"""


def test_import_is_quick_quiet_and_without_matplotlib():
    """At most 0.4 s beyond jax itself (best of five: the machine is shared), and no configuration."""
    runs = [
        subprocess.run([sys.executable, "-c", IMPORT], capture_output=True, text=True, check=True)
        for _ in range(5)
    ]
    fields = [r.stdout.split(maxsplit=2) for r in runs]
    assert all(f[1] == "False" and f[2].strip() == "[]" for f in fields)
    assert min(float(f[0]) for f in fields) <= 0.4


COMPILED_BEFORE = """
import jax, jaxroll as jxr
traced = []
plus_one = jax.jit(lambda x: traced.append(1) or x + 1.0)
jxr.State, plus_one(1.0), [getattr(jxr, name) for name in jxr.__all__], plus_one(1.0)
print(len(traced))
"""


def test_no_module_that_is_loaded_late_makes_jax_compile_everything_anew():
    """As it would once a module made another context of JAX: whatever was compiled before counts no more."""
    call = [sys.executable, "-c", COMPILED_BEFORE]
    assert subprocess.run(call, capture_output=True, text=True, check=True).stdout.strip() == "1"
