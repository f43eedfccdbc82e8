"""Time against error, log-log: one line for each contender, one colour map for each family."""

from collections.abc import Callable, Sequence
from typing import Any

import matplotlib

from benchmarks._common import by_contender, Contender, Result, TARGET

Styles = dict[str, tuple[str, str]]


def panel(
    axes: Any,
    results: Sequence[Result],
    ladder: str,
    styles: Styles,
    *,
    jitted: Callable[[str, int, int], bool],
    label: Callable[[Contender], str],
) -> dict[str, list[Any]]:
    """Draw all lines; `styles` are colour map and markers of each family, and its lines are returned.

    `jitted(family, i, n)`: whether the i-th of a family's n contenders is drawn under `jax.jit` as well.
    """
    axes.axvline(TARGET, color="0.4", lw=0.9, ls=":", zorder=0)
    note = {"xycoords": ("data", "axes fraction"), "xytext": (4, -9), "textcoords": "offset points"}
    axes.annotate("target", (TARGET, 1.0), color="0.4", fontsize=7.5, **note)
    handles: dict[str, list[Any]] = {family: [] for family in styles}
    for family, (colours, marks) in styles.items():
        groups = list(by_contender([r for r in results if r.contender.family == family]).values())
        for i, group in enumerate(groups):
            shade = matplotlib.colormaps[colours](0.4 + 0.55 * i / max(1, len(groups) - 1))
            dashed = jitted(family, i, len(groups))
            name = label(group[0].contender)
            style = {"color": shade, "marker": marks[i], "lw": 1.1 + 0.5 * dashed}
            handles[family] += _line(axes, group, ladder, False, label=name, **style)
            if dashed:
                style |= {"mfc": "w", "ls": "--", "label": f"{name}, jitted"}
                handles[family] += _line(axes, group, ladder, True, **style)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(True, color="0.9", lw=0.6)
    axes.set_axisbelow(True)
    return {family: lines for family, lines in handles.items() if lines}


def _line(axes: Any, group: Sequence[Result], ladder: str, bare: bool, **style: Any) -> list[Any]:
    timed = [r for r in group if ladder in r.seconds(bare)]
    errors = [r.errors[ladder] for r in timed]
    times = [1e3 * r.seconds(bare)[ladder] for r in timed]
    return axes.plot(errors, times, ms=4.5, **style) if timed else []


def legends(figure: Any, handles: dict[str, list[Any]], left: float) -> None:
    """One legend for each family, below one another."""
    top = 0.885
    for family, lines in handles.items():
        legend = figure.legend(
            handles=lines,
            title=f"{family} with Numba" if family in ("SciPy", "SUNDIALS") else family,
            loc="upper left",
            bbox_to_anchor=(left, top),
            frameon=False,
            fontsize=8,
            title_fontproperties={"weight": "bold", "size": 8.5},
            alignment="left",
            labelspacing=0.25,
        )
        figure.add_artist(legend)
        top -= 0.06 + 0.0335 * len(lines)


def footnote(figure: Any, lines: Sequence[str]) -> None:
    figure.text(0.065, 0.02, "\n".join(lines), fontsize=7, color="0.35", va="bottom")


def headline(figure: Any, text: str) -> None:
    figure.suptitle(text, fontsize=11.5, x=0.065, ha="left", y=0.975)
