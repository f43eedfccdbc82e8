"""First calls in fresh processes: import, tracing, compiling, running; with and without cache (five minutes).

`python -m benchmarks.first_calls --write` rewrites its section of README.md; `--quick`: the pivoted scene.
Every function is called in three processes: one without a persistent cache, one that fills a cache in a
temporary folder, and one that finds it filled. Processor time is of all threads; on a machine that has other
work to do it is the steadier figure.
"""

import sys
import tempfile
from typing import Any, NamedTuple

from benchmarks._common import command, device, fresh, table, versions

WAYS = {
    "call": "`simulate`",
    "forward": "`simulate` in `jax.jit`",
    "tip": "value and gradient, one tip parameter",
    "axes": "value and gradient, half axes of a tip",
}
CACHES = ("none", "empty", "full")
# Asked of a first call [s]; of the pinch twice as much.
FORWARD, GRADIENT, SECOND, PINCH = 2.0, 8.0, 2.0, 2.0


class Call(NamedTuple):
    """What was called first, with which cache, and the phases: seconds of wall and processor by name."""

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
    def asked(self) -> float:
        """Upper limit of the total [s]."""
        first = FORWARD if self.way in ("call", "forward") else GRADIENT
        return (SECOND if self.cache == "full" else first) * (PINCH if self.scene == "pinch" else 1.0)


def measure(quick: bool) -> list[Call]:
    found = []
    for scene in ("pivoted",) if quick else ("pivoted", "pinch"):
        for way in WAYS:
            with tempfile.TemporaryDirectory() as folder:
                for cache in CACHES:
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
        parts = [call.spent(*names) for names in (("trace",), ("lower", "compile"), ("call",), ("again",))]
        if call.way == "call":
            parts[2] = [0, 0]  # a public call does all at once
        asked = f"{'**missed** ' * (call.total[1] > call.asked)}{call.asked:g}"
        result = "successful" if call.phases["code"] == 0 else f"code {call.phases['code']}"
        cells = [both(x) for x in (call.total, *parts[:3])] + [f"{1e3 * parts[3][1]:.1f}"]
        rows.append([call.scene, WAYS[call.way], call.cache, *cells, asked, result])
    return rows


def conclusion(found: list[Call]) -> str:
    said = []
    for scene in dict.fromkeys(call.scene for call in found):
        for cache in ("none", "full"):
            own = [call for call in found if (call.scene, call.cache) == (scene, cache)]
            costs = [f"{call.total[1]:.1f} s for {WAYS[call.way]}" for call in own]
            good = sum(call.total[1] <= call.asked for call in own)
            how = "with a filled cache" if cache == "full" else "without a cache"
            said.append(f"{scene}, {how}: {', '.join(costs)}; {good} of {len(own)} within what is asked.")
    imports, scenes = ([call.spent(name) for call in found] for name in ("import", "scene"))
    least = lambda times: f"{min(t[1] for t in times):.1f}"  # noqa: E731
    said.append(f"Import takes {least(imports)} s, a scene with its closing loaded {least(scenes)} s.")
    return f"In processor seconds: {' '.join(said)}"


def report(quick: bool = False) -> str:
    found = measure(quick)
    header = ["scene", "first call of", "cache", "total [s]", "tracing", "lowering, compiling", "first run"]
    header += ["again [ms]", "asked, processor [s]", "result"]
    text = [
        f"**Conclusion.** {conclusion(found)}",
        table(header, lines(found)),
        "Seconds are wall / processor; the second run is processor time.",
    ]
    return "\n\n".join([*text, f"{device()}  \n{versions('jax', 'jaxlib', 'diffrax')}"])


if __name__ == "__main__":
    command("first_calls", report)
