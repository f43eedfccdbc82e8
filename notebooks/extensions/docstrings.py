r"""Docstrings as reStructuredText: jaxroll's have `$mathematics$` and `names` as Markdown writes them.

Sections (`Args:`, `Raises:`) are napoleon's business, which comes after. Here mathematics becomes role and
directive `math`; a name in backticks becomes a link where it is public, and code where it is not; what
reStructuredText would take for markup is escaped. Examples stay as they are.
"""

import re

from . import public_names

_DISPLAY = re.compile(
    r"^(?P<indent> *)(?P<before>[^\n]*?)\$\$(?P<body>.+?)\$\$(?P<after>[,.;]?) *", re.S | re.M
)
_TOKENS = re.compile(
    r"(?P<math>\$[^$]+\$)|(?P<code>`[^`]+`)|(?P<strong>\*\*[^*\s][^*]*\*\*)"
    r"|(?P<weak>(?<!\w)\*[^*\s][^*]*\*(?!\w))|(?P<plain>[|*\\]|(?<=\w)_(?!\w))"
)


def converted(text: str) -> str:
    """A docstring in reStructuredText."""
    links = public_names.aliases()
    return "\n".join(
        part if code else _separated(_inline(_displayed(part), links)) for code, part in _parts(text)
    )


def _parts(text: str) -> list[tuple[bool, str]]:
    """A docstring cut into prose and examples: an example lasts until the next empty line."""
    found: list[tuple[bool, list[str]]] = [(False, [])]
    for line in text.split("\n"):
        inside = bool(line.strip()) and (found[-1][0] or line.lstrip().startswith(">>>"))
        if inside != found[-1][0]:
            found.append((inside, []))
        found[-1][1].append(line)
    return [(code, "\n".join(lines)) for code, lines in found if lines]


def _displayed(text: str) -> str:
    """Formulas between double dollars as directives of their own paragraph."""

    def directive(found: re.Match) -> str:
        indent, body = found["indent"], " ".join(found["body"].split())
        before = f"{indent}{found['before'].rstrip()}\n\n" if found["before"].strip() else ""
        block = f"{before}\n{indent}.. math::\n\n{indent}    {body}{found['after']}\n\n{indent}"
        # Later passes leave it alone: it has no dollars any more, and its backslashes are kept by this mark.
        return block.replace("\\", "\0")

    return _DISPLAY.sub(directive, text)


def _inline(text: str, links: dict[str, str]) -> str:
    def role(found: re.Match) -> str:
        token, kind = found[0], found.lastgroup
        if kind in ("strong", "weak"):
            return token
        if kind == "plain":
            return f"\\{token}"
        inner = " ".join(token[1:-1].split())
        if kind == "math":
            marked = f":math:`{inner}`"
        elif inner.removesuffix("()") in links:
            marked = f":py:obj:`{inner} <{links[inner.removesuffix('()')]}>`"
        else:
            marked = f"``{inner}``"
        # A role ends at a space or at punctuation; an escaped space is neither seen nor missed.
        before, after = text[: found.start()][-1:], text[found.end() :][:1]
        return ("\\ " if before.isalnum() else "") + marked + ("\\ " if after.isalnum() else "")

    kept = [line if line.lstrip().startswith(".. math::") else line for line in text.split("\n")]
    return _TOKENS.sub(role, "\n".join(kept)).replace("\0", "\\")


def _separated(text: str) -> str:
    """Lists stand in paragraphs of their own."""
    lines: list[str] = []
    for line in text.split("\n"):
        bullet = re.match(r" *- ", line)
        before = lines[-1] if lines else ""
        if bullet and before.strip() and not re.match(r" *- ", before):
            inside = len(before) - len(before.lstrip()) > len(line) - len(line.lstrip())
            if not inside:
                lines.append("")
        lines.append(line)
    return "\n".join(lines)


_GROUPED = re.compile(r"^( *)Args \((\w)([^)]*)\):$", re.M)


def process(app, what, name, obj, options, lines) -> None:
    """What autodoc calls for every docstring, before napoleon does."""
    del app, what, name, obj, options
    # Arguments in groups, `Args (daily use):`, are sections with the group's name: see `conf.py`.
    text = _GROUPED.sub(lambda found: f"\n{found[1]}{found[2].upper()}{found[3]}:", "\n".join(lines))
    lines[:] = converted(text).split("\n")
