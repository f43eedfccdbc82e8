"""The design as a test: layers, doors, abstract or final, size budget, public names."""

import ast
import inspect
import pathlib
import statistics
import subprocess
import sys

import equinox as eqx
import pytest

import jaxroll as jxr
from jaxroll import integration, mechanics

ROOT = pathlib.Path(jxr.__file__).parent
RANKS = {
    "_types": 0,
    "_primitives": 0,
    "_printing": 0,
    "_backend": 1,
    "_sharing": 1,
    "_trigonometry": 1,
    "_results": 1,
    "_once": 2,
    "_fields": 2,
    "_algebra": 2,
    "_spatial": 3,
    "geometry": 4,
    "contact": 5,
    "mechanics": 6,
    "control": 7,
    "integration": 8,
    "stability": 9,
    "_why": 10,
    "design": 10,
    "_sweep": 9,
    "scenes": 10,
    "io": 10,
    "plotting": 11,
    "__init__": 12,
    "_facts": 13,
    "_workshop": 13,
    "__main__": 14,
}
# One door each.
DOORS = {
    "diffrax": {"integration"},
    "optimistix": {"integration"},
    "optax": {"design", "geometry"},
    "matplotlib": {"plotting"},
    "scipy": set(),
    "numba": set(),
}
# Libraries of the extras `cad` and `viz`: one file each, imported with the first use.
LAZY_DOORS = {
    "svgpathtools": "io/_vector.py",
    "ezdxf": "io/_vector.py",
    "trimesh": "io/_mesh.py",
    "mapbox_earcut": "io/_mesh.py",
    "skimage": "io/_image.py",
    "plotly": "plotting/_page.py",
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
            if door and (door != here or node in early):
                yield f"{here} imports {target}"


def test_one_file_of_geometry_imports_optax():
    """Wherever in the file: it is imported late, for it takes 0.2 s."""
    found = {
        path.name
        for path in (ROOT / "geometry").glob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Import | ast.ImportFrom)
        and any(target.split(".")[0] == "optax" for target in targets(node, path))
    }
    assert found == {"_descent.py"}


def test_libraries_of_the_extra_have_one_lazy_door_each():
    trees = {p: ast.parse(p.read_text()) for p in FILES}
    assert not [v for p, tree in trees.items() for v in lazy_violations(p, tree)]
    bad = ast.parse("import ezdxf\ndef f():\n    import trimesh\n")
    assert len(list(lazy_violations(ROOT / "io" / "_vector.py", bad))) == 2


def test_the_import_check_sees_a_bad_import():
    bad = ast.parse("import matplotlib.pyplot\nfrom ..integration import simulate\n")
    assert len(violations(ROOT / "mechanics" / "_grasp.py", bad)) == 2


def cycles_inside(folder):
    """Import cycles among the private modules of one folder."""
    graph = {}
    for path in (ROOT / folder).glob("_*.py"):
        if path.stem == "__init__":
            continue
        nodes = module_level(ast.parse(path.read_text()))
        graph[path.stem] = {
            n.module for n in nodes if isinstance(n, ast.ImportFrom) and n.level == 1 and n.module
        }
    done = set()
    while ready := {m for m in graph.keys() - done if graph[m] <= done}:
        done |= ready
    return graph.keys() - done


@pytest.mark.parametrize(
    "folder",
    ["geometry", "contact", "mechanics", "integration", "stability", "design", "plotting", "io", "_sweep"],
)
def test_no_cycles_inside_a_folder(folder):
    assert not cycles_inside(folder)


def modules_of(package):
    prefix = "jaxroll."
    return [m for name, m in sys.modules.items() if name.startswith(prefix) and m is not package]


def test_classes_are_abstract_or_final():
    """Nothing concrete is subclassed; abstract names say so."""
    classes = {
        c
        for m in modules_of(None)
        for c in vars(m).values()
        if inspect.isclass(c) and c.__module__.startswith("jaxroll") and issubclass(c, eqx.Module)
    }
    assert len(classes) > 20
    for cls in classes:
        assert inspect.isabstract(cls) == cls.__name__.startswith("Abstract"), cls
        for base in cls.__mro__[1:]:
            if base.__module__.startswith("jaxroll"):
                assert inspect.isabstract(base), f"{cls} subclasses the concrete {base}"


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


def test_parameter_budget():
    """At most four by position (self aside) and ten in all; diffrax fixes those of its contracts."""
    for name, node in functions():
        if node.name.startswith("_") or node.name in ("step", "init", "adapt_step_size"):
            continue
        given = [a for a in node.args.posonlyargs + node.args.args if a.arg not in ("self", "cls")]
        assert len(given) <= 4, f"{name}:{node.name}"
        assert len(given) + len(node.args.kwonlyargs) <= 10, f"{name}:{node.name}"


PUBLIC = {
    "AbstractSurface", "Contact3", "Ellipsoid", "Finger3", "FreeObject3", "Plane", "Sphere", "Stage", "Torus",
    "Turning", "loci", "roll", "Rosenbrock", "why",
    "AbstractContour", "CSM", "Catenary", "Circle", "Contact", "Ellipse", "Finger", "FreeObject",
    "Grasp", "Index1", "Jaw", "Line", "NeuralCurvature", "NeuralSupport", "PivotedObject", "RESULTS",
    "Spline", "State", "SupportFunction", "Trajectory", "close", "contact",
    "control", "design", "energies", "equation_terms", "fit_contour", "geometry", "io", "multipliers",
    "pinch_balance", "plotting", "press_balance",
    "residuals", "scenes", "simulate", "stability", "sweep",
}  # fmt: skip


def test_public_names():
    assert set(jxr.__all__) == PUBLIC
    assert all(getattr(jxr, name) is not None for name in PUBLIC)
    assert mechanics and integration
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = jxr.nothing


def test_public_things_have_docstrings():
    for name in PUBLIC:
        assert inspect.getdoc(getattr(jxr, name)), name


IMPORT = """
import time, sys, jax
start = time.perf_counter()
import jaxroll
took = time.perf_counter() - start
heavy = ("matplotlib", "scipy", "numba", "ezdxf", "trimesh", "skimage", "plotly")
bad = [m for m in heavy if m in sys.modules]
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
