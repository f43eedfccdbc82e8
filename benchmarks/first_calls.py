"""First calls in fresh processes: import, tracing, compiling, running; with and without cache (ten minutes).

`python -m benchmarks.first_calls --write` rewrites its section of README.md; `--quick`: the pivoted scene.
Functions are called in a process without a persistent cache; gradients also in one that fills a cache in a
temporary folder, and in one that finds it filled. The commands of the command line follow, without a cache.
Processor time is of all threads; on a machine that has other work to do it is the steadier figure, but not
the same on all machines: a loop of ten million additions in Python says how fast this one was.
"""

import os
import sys
import tempfile
from typing import Any, NamedTuple

from benchmarks._common import clocked, command, device, fresh, judged, table, uncached, versions, yardstick

WAYS = {
    "call": "`simulate`",
    "stiff": "`simulate` with `Rosenbrock`",
    "forward": "`simulate` in `jax.jit`",
    "damping": "value and gradient, damping",
    "tip": "value and gradient, one tip parameter",
    "axes": "value and gradient, half axes of a tip",
    "six axes": "value and gradient, half axes of both tips",
}
# What is called of every scene, with what is asked of it [processor s], None where nothing is.
CALLS: dict[str, dict[str, float | None]] = {
    "pivoted": {"call": None, "forward": None, "damping": 2.5, "tip": 4.0, "axes": None},
    "pinch": {"call": 1.5, "forward": None, "damping": 5.0, "tip": 8.0, "axes": None},
    "pinch3d": {"call": 4.0, "stiff": 8.0, "forward": None, "damping": 15.0, "six axes": 25.0},
}
# Of the scene itself, its closing included, and of a value with its gradient where the cache is full.
SCENES = {"pinch": 2.0, "pinch3d": 4.0}
SECOND = {"pivoted": 1.5, "pinch": 2.0, "pinch3d": 4.0}
# Scene and run together over those of two fingers.
RINGS = {5: 1.3, 20: 2.0}
COMMANDS = {"demo": 7.0, "demo pinch": 12.0, "demo pinch3d": 20.0, "design": 18.0}


class Call(NamedTuple):
    """What was called first, with which cache, and the phases: seconds of wall and processor by name.

    Among the phases are the code of the result, and of gradients the lines of the lowered program.
    """

    scene: str
    way: str
    cache: str
    phases: dict[str, Any]

    def spent(self, *names: str) -> list[float]:
        """Wall and processor seconds of some phases together."""
        found = [self.phases[name] for name in names if name in self.phases]
        return [sum(phase[i] for phase in found) for i in (0, 1)]

    @property
    def total(self) -> list[float]:
        """From the function to its first result, import and scene left out."""
        return self.spent("trace", "lower", "compile", "call")

    @property
    def asked(self) -> float | None:
        """Upper limit of the total [processor s]."""
        if self.cache == "full":
            return SECOND[self.scene]
        return CALLS[self.scene][self.way] if self.cache == "none" else None


def measure(quick: bool) -> list[Call]:
    found = []
    for scene in ("pivoted",) if quick else CALLS:
        for way in CALLS[scene]:
            caches = ("none",) if way in ("call", "stiff", "forward") else ("none", "empty", "full")
            with tempfile.TemporaryDirectory() as folder:
                for cache in caches:
                    kept = None if cache == "none" else folder
                    phases = fresh("benchmarks._first_call", way, scene, cache=kept)
                    found.append(Call(scene, way, cache, phases))
                    print(scene, way, cache, phases, file=sys.stderr, flush=True)
    return found


def both(seconds: list[float]) -> str:
    return "" if seconds == [0, 0] else f"{seconds[0]:.2f} / {seconds[1]:.2f}"


def lines(found: list[Call]) -> list[list[str]]:
    rows = []
    for call in found:
        parts = [call.spent(name) for name in ("trace", "lower", "compile")]
        result = "successful" if call.phases["code"] == 0 else f"code {call.phases['code']}"
        cells = [both(x) for x in (call.total, *parts)]
        cells += [str(call.phases.get("lines", "")), f"{1e3 * call.spent('again')[1]:.1f}"]
        asked = judged(call.total[1], call.asked)
        rows.append([call.scene, WAYS[call.way], call.cache, *cells, asked, result])
    return rows


def scene_rows(found: list[Call]) -> list[list[str]]:
    """The first call of each scene: what `call`'s process took to make it."""
    rows = []
    for call in found:
        if call.way == "call":
            spent = call.spent("scene")
            asked = SCENES.get(call.scene)
            rows.append([f"`scenes.{call.scene}()`", both(spent), judged(spent[1], asked)])
    return rows


def ring_rows() -> list[list[str]]:
    """Scenes and runs of more fingers, over those of two."""
    spent = {}
    for count in (2, *RINGS):
        call = Call("ring", "call", "none", fresh("benchmarks._first_call", "call", f"ring({count})"))
        spent[count] = call.spent("scene", "call")
    rows = [["`scenes.ring(2)` and `simulate`", both(spent[2]), ""]]
    for count, asked in RINGS.items():
        ratio = spent[count][1] / spent[2][1]
        what = f"`scenes.ring({count})` and `simulate`, over those of two fingers"
        rows.append([what, f"{both(spent[count])}; {ratio:.2f} times", judged(ratio, asked)])
    return rows


def command_rows() -> list[list[str]]:
    """The commands that draw, in empty folders; time in the system, of writing and loading, included."""
    rows = []
    for words, asked in COMMANDS.items():
        with tempfile.TemporaryDirectory() as folder:
            call = [sys.executable, "-m", "jaxroll", *words.split()]
            env = uncached() | {"JAXROLL_CACHE": "off", "PYTHONPATH": os.getcwd()}
            done, spent = clocked(call, env, folder=folder)
        done.check_returncode()
        rows.append([f"`jaxroll {words}`", both(spent), judged(spent[1], asked)])
    return rows


def conclusion(found: list[Call], others: list[list[str]]) -> str:
    rows = [[call.asked, call.total[1]] for call in found if call.asked is not None]
    met = sum(value <= asked for asked, value in rows)
    wanted = [row for row in others if row[2]]
    met += sum("missed" not in row[2] for row in wanted)
    imports = min(call.spent("import")[1] for call in found)
    return f"{met} of {len(rows) + len(wanted)} limits are met. Import takes {imports:.1f} s."


def rates(found: list[Call]) -> str:
    """What a thousand lines of a program take, by phase; the figure that bounds how long one may be."""
    said = []
    for phase, cache, what in (
        ("trace", "none", "to trace"),
        ("lower", "none", "to lower"),
        ("compile", "none", "to compile"),
        ("compile", "full", "to load from a full cache"),
    ):
        each = [
            1e3 * call.spent(phase)[1] / call.phases["lines"]
            for call in found
            if call.cache == cache and "lines" in call.phases
        ]
        said.append(f"{min(each):.3f} to {max(each):.3f} s {what}")
    return f"Of what is under `jax.jit`, a thousand lines of a program take {', '.join(said)}."


def report(quick: bool = False) -> str:
    before = yardstick()
    found = measure(quick)
    others = scene_rows(found) + ([] if quick else [*ring_rows(), *command_rows()])
    after = yardstick()
    header = ["scene", "first call of", "cache", "total [s]", "tracing", "lowering", "compiling or loading"]
    header += ["lines", "again [ms]", "asked, processor [s]", "result"]
    text = [
        f"**Conclusion.** {conclusion(found, others)} {rates(found)}",
        table(header, lines(found)),
        table(["first call of, without a cache", "total [s]", "asked"], others),
        "Seconds are wall / processor; the second run is processor time. The loop of ten million additions "
        f"took {before:.2f} s before and {after:.2f} s after.",
    ]
    return "\n\n".join([*text, f"{device()}  \n{versions('jax', 'jaxlib', 'diffrax')}"])


if __name__ == "__main__":
    command("first_calls", report)
