"""Code on the site's pages: what is shown is run, and what is shown as printed is what it prints.

A page's Python blocks run one after the other in one namespace, as a reader would run them; a block of text
that follows one is its output. `python -m notebooks.extensions.code_blocks PAGE...` writes outputs into
pages.
"""

import contextlib
import io
import pathlib
import re
import sys
from typing import NamedTuple

HERE = pathlib.Path(__file__).parents[1]
# Pages with commands that are not run, and why.
RECIPES = {"how_to/sweep_on_a_cluster.md": "its job script needs a cluster"}

_BLOCK = re.compile(
    r"^(?P<fence>```+)(?:python|\{code-cell\}[^\n]*)\n(?P<code>.*?)^(?P=fence)$"
    r"(?:\n\n```text\n(?P<printed>.*?)^```$)?",
    re.S | re.M,
)
_FENCE = re.compile(r"^```+(\S+)", re.M)


class Block(NamedTuple):
    """A piece of code, what the page says that it prints (None: it does not say), and where that stands."""

    code: str
    printed: str | None
    span: tuple[int, int]


def written_pages() -> list[str]:
    """Pages that somebody wrote, by their path below `notebooks`."""
    found = [path.relative_to(HERE) for path in HERE.rglob("*.md")]
    return sorted(path.as_posix() for path in found if path.parts[0] not in ("generated", "extensions"))


def blocks(page: str) -> list[Block]:
    """The Python blocks of a page. Options of a notebook's cell (`:tags:`) are no code."""
    text = (HERE / page).read_text()
    return [
        Block(re.sub(r"\A(:[^\n]*\n)+", "", found["code"]), found["printed"], found.span("printed"))
        for found in _BLOCK.finditer(text)
    ]


def languages(page: str) -> set[str]:
    """What the fences of a page say that they hold."""
    return set(_FENCE.findall((HERE / page).read_text()))


def printed(page: str) -> list[str]:
    """What every block of a page prints, run in turn."""
    names: dict[str, object] = {"__name__": "__main__"}
    outputs = []
    for block in blocks(page):
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            exec(compile(block.code, page, "exec"), names)
        outputs.append(out.getvalue())
    return outputs


def _rewritten(page: str) -> str:
    text = (HERE / page).read_text()
    # From the end, so that places before are where they were.
    for block, output in reversed(list(zip(blocks(page), printed(page), strict=True))):
        if block.printed is not None:
            text = text[: block.span[0]] + output + text[block.span[1] :]
    return text


if __name__ == "__main__":
    for page in sys.argv[1:]:
        (HERE / page).write_text(_rewritten(page))
