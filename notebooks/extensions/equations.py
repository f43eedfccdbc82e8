r"""The chapter's equations and figures: what each says, what computes it, what tests it, what was corrected.

Only the words are written here. The rest is found: a whole number in parentheses of its own in a docstring
of jaxroll, or of a test, is an equation of the chapter, `(5)-(6)` a range of them, `A-1` a condition of
Part 3 and `Figs. 9-18` figures; corrections are the rows of `notebooks/errata.md`. `python -m
notebooks.extensions.equations` prints the table, `tests/test_equations.py` says what is missing from it.
"""

import ast
import collections
import pathlib
import re
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

ROOT = pathlib.Path(__file__).parents[2]

# What each number says, in a few words. Keys are numbers as the chapter prints them.
SAYS = {
    "1": "translation of the object",
    "2": "rotation of the object",
    "3": "joints of finger $i$",
    "4": "tangent and normal of the object's contour in the world",
    "5": "tangential constraint $Q_{bi}$",
    "6": "normal constraint $Q_{ni}$",
    "7": "rate of the arclength $s_i$: rolling",
    "8": "the tangent is the derivative of the point",
    "9": "Frenet: derivative of the tangent",
    "10": "Frenet: derivative of the normal",
    "11": "Lagrangian of the pinch",
    "12": "coordinates $X$ of the pinch",
    "13": "kinetic energy",
    "14": "variational principle",
    "15": "equations of motion in general form",
    "16": "blind control: damping, opposition, orientation",
    "17": "turn $\\hat N_i$ of the last link since the start",
    "18": "power of the control",
    "19": "joints under the control",
    "20": "energy balance",
    "21": "total energy",
    "22": "artificial potential $P$",
    "23": "closed loop in general form",
    "24": "Lagrangian of the closed loop",
    "25": "from one finger centre to the other, by way of the contacts",
    "26": "the same between parallel faces",
    "27": "potential $U(s_1, s_2)$",
    "28": "$d$: the centres' distance along the faces",
    "29": "$l$: the centres' distance across the faces",
    "30": "difference $V$ of the normal constraints",
    "31": "$W = U + \\eta V$",
    "32": "derivatives of $W$",
    "33": "vectors $\\bar\\xi_i$",
    "34": "multiplier $\\eta$",
    "35": "line of centres normal to the faces",
    "36": "$W$ stationary",
    "37": "$s_1 = s_2$ and $b_1 \\cdot \\gamma_1 = b_2 \\cdot \\gamma_2$",
    "38": "$W$ stationary under (37)",
    "39": "Hessian of $U$: diagonal",
    "40": "Hessian of $U$: off the diagonal",
    "41": "condition on a fingertip's shape",
    "42": "$\\Delta f_i$",
    "43": "$\\Delta\\lambda_i$",
    "44": "opposition torque in the contact frames",
    "45": "joints in wrench form",
    "46": "$\\Delta N_i$",
    "47": "translation of the object in wrench form",
    "48": "rotation of the object in wrench form",
    "49": "moment $S_N$",
    "50": "Lagrangian of the wrench form",
    "51": "rate of $U$ by the rolling rates",
    "52": "rate of $U$ by the turns of the bodies",
    "53": "$N_i$",
    "54": "rate of $U$ with $S_N$",
    "55": "differential of $P$",
    "56": "angle $\\theta_1$ of the object's tangent",
    "57": "angle $\\psi_0$ of the fingertip's tangent",
    "58": "tangents $b_1$, $b_0$",
    "59": "normals $n_1$, $n_0$",
    "60": "length $l_{b0}$",
    "61": "length $l_{b1}$",
    "62": "length $l_{n0}$",
    "63": "length $l_{n1}$",
    "64": "tangential constraint $R$",
    "65": "normal constraint $Q$",
    "66": "normal constraint as a distance",
    "67": "tangential constraint as distances",
    "68": "rate of the arclength $s$: rolling",
    "69": "curvature $\\kappa_0$ of the fingertip",
    "70": "curvature $\\kappa_1$ of the object",
    "71": "kinetic energy",
    "72": "Lagrangian of finger and pivoted object",
    "73": "rotation of the pivoted object",
    "74": "joints of the finger",
    "75": "control: damping, pull towards the pivot",
    "76": "rotation of the object under the control",
    "77": "joints under the control",
    "78": "$\\Delta f$, $\\Delta\\lambda$, $N_1$",
    "79": "$Q_1$, $R_1$",
    "80": "object's contour $X(s)$",
    "81": "object's contour $Y(s)$",
    "82": "fingertip's contour $X_0(s)$",
    "83": "fingertip's contour $Y_0(s)$",
    "A-1": "loci of contact meet, with one tangent plane",
    "A-2": "loci of contact have one arclength",
    "Fig. 1": "two fingers and an object in the plane",
    "Fig. 2": "tangents and normals at the contacts",
    "Fig. 3": "where a pinch of parallel faces rests",
    "Fig. 4": "a finger and a pivoted object",
    "Fig. 5": "local coordinates of both",
    "Fig. 6": "the four lengths",
    "Fig. 7": "both contours of Part 2",
    "Fig. 8": "poses at the start and after 3 s",
    "Fig. 9": "$\\Delta f$ in time",
    "Fig. 10": "$\\Delta\\lambda$ in time",
    "Fig. 11": "$(f_d/r) N_1$ in time",
    "Fig. 12": "$s$ in time",
    "Fig. 13": "$\\dot q_1$ in time",
    "Fig. 14": "$\\dot q_2$ in time",
    "Fig. 15": "$\\dot\\theta$ in time",
    "Fig. 16": "$R$ in time",
    "Fig. 17": "$Q$ in time",
    "Fig. 18": "$U$ in time",
    "Fig. 19": "two fingers and an object in space",
    "Fig. 20": "loci of contact on both surfaces",
}

# Numbers that no function computes, and why. Their tests check the step itself.
STEPS = {
    "14": "A principle, not a quantity: the terms of (15) are its Euler-Lagrange terms.",
    "24": "Its equations are (23), and those are computed.",
    "30": "It vanishes wherever both fingertips touch, and so constrains nothing.",
    "31": "$V$ vanishes, so that $W$ is $U$, whatever $\\eta$ is.",
    "33": "An abbreviation in (32).",
    "34": "The multiplier of a constraint that is none: no value is needed.",
    "35": "That $d = 0$; an equilibrium needs the collinearity of four points.",
    "36": "Gradients of $U$ are computed, and $W$ is $U$.",
    "38": "The same; it does not follow from (37).",
    "50": "Its equations are (45), (47) and (48), and those are computed.",
}

_RANGE = r"(?:(?:-|\s+to\s+)\((\d{1,2})\))?"
_NUMBER = re.compile(r"(?<![\w`$}\])])(?<!shape )\((\d{1,2})\)" + _RANGE)
_CONDITION = re.compile(r"\bA-([12])\b")
_FIGURES = re.compile(r"\bFigs?\.\s+(\d+(?:(?:,\s+|\s+and\s+|-|\s+to\s+)\d+)*)")


class Place(NamedTuple):
    """A docstring that cites the chapter: its file, the name in it (empty: the module), what it cites.

    `alone` are those of `cited` that it names by themselves, and not within a range.
    """

    path: str
    name: str
    cited: frozenset[str]
    alone: frozenset[str]


class Row(NamedTuple):
    """What is known of one number."""

    number: str
    says: str
    functions: list[Place]
    tests: list[Place]
    step: str
    corrections: list[str]


def _span(first: str, last: str | None) -> range:
    return range(int(first), int(last or first) + 1)


def cited(text: str) -> tuple[frozenset[str], frozenset[str]]:
    """Numbers, conditions and figures that a text cites, and those of them outside of ranges."""
    found, alone = set(), set()
    for first, last in _NUMBER.findall(text):
        found |= {str(n) for n in _span(first, last)}
        alone |= set() if last else {first}
    conditions = {f"A-{n}" for n in _CONDITION.findall(text)}
    figures = set()
    for listed in _FIGURES.findall(text):
        for first, last in re.findall(r"(\d+)(?:(?:-|\s+to\s+)(\d+))?", listed):
            figures |= {f"Fig. {n}" for n in _span(first, last)}
    return frozenset(found | conditions | figures) & SAYS.keys(), frozenset(alone | conditions | figures)


def _prose(text: str) -> str:
    """A docstring without its examples, whose numbers are code."""
    return "\n".join(line for line in text.splitlines() if not line.strip().startswith((">>>", "...")))


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """A definition and all statements in it; expressions, most of a tree, define nothing."""
    yield node
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt | ast.excepthandler | ast.match_case):
            yield from _statements(child)


def _docstrings(node: ast.AST, names: tuple[str, ...] = ()) -> Iterator[tuple[str, str]]:
    """Name and docstring of a module and of all that it defines.

    What a function defines inside of itself has no name that leads to it: its docstring is a part of the
    function's own.
    """
    whole = isinstance(node, ast.FunctionDef)
    said = [
        ast.get_docstring(part)
        for part in (_statements(node) if whole else [node])
        if isinstance(part, ast.Module | ast.ClassDef | ast.FunctionDef)
    ]
    text = "\n\n".join(_prose(one) for one in said if one)
    if text:
        yield ".".join(names), text
    for child in () if whole else ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef | ast.FunctionDef):
            yield from _docstrings(child, (*names, child.name))


def places(files: Iterable[pathlib.Path], wanted: Callable[[str], bool] = lambda name: True) -> list[Place]:
    """All docstrings of these files that cite the chapter, of names that are `wanted`."""
    found = []
    for path in sorted(files):
        for name, text in _docstrings(ast.parse(path.read_text())):
            numbers, alone = cited(text)
            if numbers and wanted(name):
                found.append(Place(path.relative_to(ROOT).as_posix(), name, numbers, alone))
    return found


def errata(text: str) -> dict[str, list[str]]:
    """What the table of corrections says that is right, by number; its first column has the numbers."""
    found = collections.defaultdict(list)
    for line in text.splitlines():
        # A vertical bar inside of a cell is escaped.
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) == 4 and set(cells[0]) != {"-"}:
            numbers, _ = cited(cells[0])
            for number in numbers:
                found[number].append(cells[2])
    return found


def _by_nearness(number: str, candidates: Iterable[Place]) -> list[Place]:
    """Those that cite a number, the most particular first; modules only where nothing in them does."""
    citing = [place for place in candidates if number in place.cited]
    inner = {place.path for place in citing if place.name}
    kept = [place for place in citing if place.name or place.path not in inner]
    return sorted(kept, key=lambda place: (number not in place.alone, len(place.cited), place.path))


def table() -> list[Row]:
    """All rows, in the order of the chapter."""
    code = places((ROOT / "jaxroll").rglob("*.py"))
    tests = places((ROOT / "tests").glob("test_*.py"), lambda name: name.startswith("test_"))
    right = errata((ROOT / "notebooks" / "errata.md").read_text())
    return [
        Row(
            number,
            says,
            _by_nearness(number, code),
            _by_nearness(number, tests),
            STEPS.get(number, ""),
            right[number],
        )
        for number, says in SAYS.items()
    ]


def missing(rows: Iterable[Row]) -> list[str]:
    """Numbers without a function (or a reason why there is none), and numbers without a test."""
    rows = list(rows)
    without = [f"{row.number}: no function" for row in rows if not row.functions and not row.step]
    return without + [f"{row.number}: no test" for row in rows if not row.tests]


def page(
    rows: Iterable[Row], link: Callable[[Place], str] = lambda place: f"`{place.name or place.path}`"
) -> str:
    """The table in Markdown; `link` says how a function is written."""
    lines = ["| number | says | computed by | tested by | correction |", "|---|---|---|---|---|"]
    for row in rows:
        functions = ", ".join(dict.fromkeys(map(link, row.functions))) or row.step
        tests = ", ".join(f"`{pathlib.Path(place.path).name}::{place.name}`" for place in row.tests)
        number = row.number if row.number[0] in "AF" else f"({row.number})"
        cells = (number, row.says, functions, tests, "; ".join(row.corrections))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(table()))
    print(*missing(table()), sep="\n")
