"""Small changes to source code, each of which breaks a formula or a check: found in the syntax tree.

A mutation replaces the text of one node; all else in the file stays as it is. Left out is what no test of
behaviour can notice: docstrings, annotations, texts of errors and of reports, imports, static declarations.
"""

import ast
import copy
import dataclasses
import hashlib
import itertools
import random
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

_COMPARED = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_COMPUTED = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.Pow: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Add,),
    ast.MatMult: (),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
}
# Functions whose arguments are words for people, or declarations.
_WORDS = {"print", "ValueError", "RuntimeError", "TypeError", "ImportError", "LookupError", "field", "warn"}
_WORDS |= {
    "add_argument",
    "set_xlabel",
    "set_ylabel",
    "set_title",
    "ArgumentParser",
    "TypeVar",
    "cast",
    "text",
}
_REPORTS = {"__repr__", "__str__", "__hash__", "__dir__"}
# Arguments that say what a figure or a report looks like.
_LOOKS = set(
    [
        "fontsize",
        "linewidth",
        "lw",
        "alpha",
        "zorder",
        "color",
        "ncols",
        "frameon",
        "dpi",
        "figsize",
        "pad",
        "linestyle",
        "markersize",
        "rotation",
        "labelpad",
        "edgecolor",
        "facecolor",
        "help",
        "constrained",
    ]
)
# Functions whose order of two arguments does not matter.
_SYMMETRIC = {
    "minimum",
    "maximum",
    "min",
    "max",
    "smaller",
    "larger",
    "isinstance",
    "getattr",
    "hasattr",
    "plus",
    "hypot",
    "dot",
    "times",
    "inner",
}


@dataclasses.dataclass(frozen=True)
class Mutation:
    """One change: from column `start` of line `line` to column `end` of line `last`, counted in bytes."""

    file: str
    line: int
    start: int
    last: int
    end: int
    before: str
    after: str
    place: str

    @property
    def name(self) -> str:
        """The same for the same change, wherever lines above it went."""
        parts = (self.file, self.place, self.before, self.after, self.text_of_line)
        return hashlib.sha256("|".join(parts).encode()).hexdigest()[:12]

    text_of_line: str = ""

    def applied(self, source: str) -> str:
        """The file's text with the change."""
        lines = source.encode().splitlines(keepends=True)
        head = b"".join(lines[: self.line - 1]) + lines[self.line - 1][: self.start]
        tail = lines[self.last - 1][self.end :] + b"".join(lines[self.last :])
        return (head + self.after.encode() + tail).decode()


def mutations(root: Path, file: Path) -> list[Mutation]:
    """Every mutation of one file."""
    source = file.read_text()
    tree, lines = ast.parse(source), source.splitlines()
    found = []
    for node, place in _visited(tree):
        if not hasattr(node, "lineno"):
            continue
        before = _segment(lines, node)
        for new in _changed(node):
            after = new if isinstance(new, str) else _written(new, node)
            if after == before:
                continue
            spot = (node.lineno, node.col_offset, node.end_lineno or node.lineno, node.end_col_offset or 0)
            name = file.relative_to(root).as_posix()
            found.append(Mutation(name, *spot, before, after, place, lines[node.lineno - 1].strip()))
    return found


def _segment(lines: Sequence[str], node: Any) -> str:
    """A node's text: `ast.get_source_segment` parts the whole file into lines each time."""
    first, last = node.lineno - 1, node.end_lineno - 1
    if first == last:
        return lines[first].encode()[node.col_offset : node.end_col_offset].decode()
    head, tail = lines[first].encode()[node.col_offset :], lines[last].encode()[: node.end_col_offset]
    return "\n".join([head.decode(), *lines[first + 1 : last], tail.decode()])


def drawn(root: Path, count: int, seed: int) -> list[Mutation]:
    """That many mutations of a package, by seed: of each folder its share by size, and three at least."""
    draw, folders = random.Random(seed), {}
    for file in sorted((root / "jaxroll").rglob("*.py")):
        inside = file.relative_to(root).parts[1]
        folders.setdefault(inside if not inside.endswith(".py") else "", []).extend(mutations(root, file))
    total = sum(map(len, folders.values()))
    chosen = []
    for folder in sorted(folders):
        share = max(3, round(count * len(folders[folder]) / total))
        mixed = (m for m in draw.sample(folders[folder], len(folders[folder])) if _parses(root, m))
        chosen += itertools.islice(mixed, share)
    draw.shuffle(chosen)
    return chosen[:count]


def _parses(root: Path, mutation: Mutation) -> bool:
    try:
        ast.parse(mutation.applied((root / mutation.file).read_text()))
    except SyntaxError:
        return False
    return True


def _written(new: ast.AST, old: ast.AST) -> str:
    text = ast.unparse(new)
    return text if isinstance(old, ast.stmt) else f"({text})"


def _visited(tree: ast.Module) -> Iterator[tuple[ast.AST, str]]:
    """Nodes that may be changed, each with the name of the function or class it is in."""
    waiting: list[tuple[ast.AST, str]] = [(child, "") for child in tree.body]
    while waiting:
        node, place = waiting.pop()
        if _left_alone(node):
            continue
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            place = f"{place}.{node.name}".strip(".")
            inner: Sequence[ast.AST] = node.body
            if isinstance(node, ast.FunctionDef):
                inner = [
                    *node.body,
                    *node.args.defaults,
                    *(d for d in node.args.kw_defaults if d is not None),
                ]
        else:
            inner = list(_inner(node))
        yield node, place
        waiting += [(child, place) for child in inner]


def _inner(node: ast.AST) -> Iterator[ast.AST]:
    """What is inside a node, without annotations."""
    for name, value in ast.iter_fields(node):
        if name == "keywords":
            value = [word for word in value if word.arg not in _LOOKS]
        if name in ("annotation", "returns", "decorator_list", "type_comment"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield child


def _left_alone(node: ast.AST) -> bool:
    if isinstance(node, ast.Raise | ast.Import | ast.ImportFrom | ast.JoinedStr | ast.Assert | ast.Global):
        return True
    if isinstance(node, ast.FunctionDef) and node.name in _REPORTS:
        return True
    if isinstance(node, ast.FunctionDef) and any(
        "abstractmethod" in ast.unparse(d) for d in node.decorator_list
    ):
        return True
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return True
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        return True
    if isinstance(node, ast.Call) and _called(node) in _WORDS:
        return True
    return isinstance(node, ast.Assign) and any(getattr(t, "id", "") == "__all__" for t in node.targets)


def _called(node: ast.Call) -> str:
    return getattr(node.func, "attr", getattr(node.func, "id", ""))


def _changed(node: ast.AST) -> Iterator[ast.AST | str]:
    """What a node may become: another node, or text."""
    match node:
        case ast.Compare(ops=[op], left=_, comparators=_):
            yield from (_with(node, ops=[other()]) for other in _COMPARED[type(op)])
        case ast.BinOp(left=left, op=op, right=right):
            yield from (_with(node, op=other()) for other in _COMPUTED.get(type(op), ()))
            if isinstance(op, ast.Add | ast.Sub):
                yield left
                yield right if isinstance(op, ast.Add) else ast.UnaryOp(ast.USub(), right)
            if isinstance(op, ast.Mult | ast.Div):
                yield left
        case ast.BoolOp(op=op, values=values):
            yield _with(node, op=ast.And() if isinstance(op, ast.Or) else ast.Or())
            yield from values
        case ast.UnaryOp(op=ast.Not() | ast.USub() | ast.Invert(), operand=operand):
            yield operand
        case ast.If(test=test) | ast.IfExp(test=test) | ast.While(test=test):
            negated = copy.deepcopy(node)
            negated.test = ast.UnaryOp(ast.Not(), test)
            yield negated if isinstance(node, ast.IfExp) else _statement(negated, node)
            if isinstance(node, ast.If) and isinstance(node.body[0], ast.Raise) and not node.orelse:
                yield "pass"
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value)):
            yield from (
                ast.Constant(other) for other in ({0: (1,), 1: (0, 2)}).get(value, (value + 1, -value))
            )
        case ast.Constant(value=float(value)):
            yield from map(ast.Constant, (2.0 * value, -value) if value else (1.0,))
        case ast.AugAssign(op=op) if type(op) in _COMPUTED:
            yield "pass"
            yield from (_statement(_with(node, op=other()), node) for other in _COMPUTED[type(op)])
        case ast.Expr(value=ast.Call()):
            yield "pass"
        case ast.Call(args=[first, second, *rest]) if _called(node) not in _SYMMETRIC:
            if ast.dump(first) != ast.dump(second) and not isinstance(first, ast.Starred | ast.Lambda):
                yield _with(node, args=[second, first, *rest])
        case ast.Return(value=ast.Call(args=[first, *_])) if isinstance(first, ast.Name):
            yield _statement(ast.Return(first), node)
        case ast.Subscript(slice=ast.Slice()):
            yield node.value


def _statement(new: ast.stmt, old: ast.stmt) -> str:
    """A statement's text, its further lines set in as the old one is."""
    return ast.unparse(ast.fix_missing_locations(new)).replace("\n", "\n" + " " * old.col_offset)


def _with(node: ast.AST, **changes: object) -> ast.AST:
    new = copy.deepcopy(node)
    for name, value in changes.items():
        setattr(new, name, value)
    return ast.fix_missing_locations(new)
