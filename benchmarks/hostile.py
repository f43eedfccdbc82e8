"""Hostile arguments to every public name: each call ends in a result, a result code or one sentence.

`python -m benchmarks.hostile --examples 10000` draws examples with hypothesis, of every public name alike:
one argument of a valid call (sometimes two) is replaced by a hostile value. It prints how they ended, and
each kind of offence with an example: *silent*, where a value that can mean nothing there was taken; *raw*,
any error but `ValueError` with one sentence that names an argument; *slow*, no answer within a minute. The
same `--seed` draws the same examples; `--only Circle close` tries those names alone. The tests run 200.

`python -m benchmarks.hostile --singly` makes no draws: every hostile value stands once in the place of every
argument, some 60 000 calls, but for values that a slow call may take. Several processes share them:
`--singly 0 2` and `--singly 1 2` make half of the calls each.
"""

import argparse
import collections
import contextlib
import dataclasses
import io
import itertools
import re
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, HealthCheck, Phase, seed, settings, strategies as st

import jaxroll as jxr
from benchmarks.hostile_calls.valid_calls import Call, calls
from benchmarks.hostile_calls.values import made, names_for, sensible

# Longest sentence that is still one.
LONGEST = 300
# What shortens a column of numbers.
_SHORTER = "its last left out"
# Counts of numbers that an argument may have if another one has them, too.
_COUNTS = {"three numbers", "seven numbers"}
_PATIENCE = 60
_SENTENCE = re.compile(r"argument[s]? \S+.*")
_GOOD = ("result", "sentence", "code")


@dataclasses.dataclass(frozen=True)
class Example:
    """One call: a public name, and for each argument that is replaced the name of its value."""

    name: str
    values: tuple[tuple[str, str], ...]

    def __str__(self) -> str:
        return f"{self.name}({', '.join(f'{parameter} = {value}' for parameter, value in self.values)})"


@dataclasses.dataclass(frozen=True)
class Outcome:
    """How a call ended: 'result', 'sentence', 'code', or an offence; where, and what was said."""

    kind: str
    where: str = ""
    words: str = ""

    @property
    def good(self) -> bool:
        return self.kind in _GOOD


def examples(names: Sequence[str] | None = None, *, refused: bool = False) -> st.SearchStrategy[Example]:
    """Calls of public names with one or two arguments replaced.

    Args:
        names: Public names; None: all.
        refused: Whether to leave out values that slow calls may take, so that few programs are compiled.
    """
    known = [call for call in calls().values() if call.arguments and (names is None or call.name in names)]

    def value(call: Call, parameter: str) -> st.SearchStrategy[tuple[str, str]]:
        argument = call.arguments[parameter]
        tried = [
            name
            for name in names_for(argument.kind)
            if not (refused and call.slow and name in argument.taken)
        ]
        return st.sampled_from(tried).map(lambda name: (parameter, name))

    def replaced(call: Call) -> st.SearchStrategy[Example]:
        some = st.lists(st.sampled_from(sorted(call.arguments)), min_size=1, max_size=2, unique=True)
        both = some.flatmap(lambda chosen: st.tuples(*(value(call, parameter) for parameter in chosen)))
        return both.map(lambda values: Example(call.name, values))

    return st.sampled_from(known).flatmap(replaced)


def singles(names: Sequence[str] | None = None) -> Iterator[Example]:
    """Calls of public names with one argument replaced: each by every value that a slow call would refuse."""
    for call in calls().values():
        if names is None or call.name in names:
            for parameter, argument in call.arguments.items():
                for name in names_for(argument.kind):
                    if not (call.slow and name in argument.taken):
                        yield Example(call.name, ((parameter, name),))


def outcome(example: Example) -> Outcome:
    """Make the call and judge how it ends."""
    call, odd = calls()[example.name], []
    replaced = dict(example.values)
    arguments = {name: call.arguments[name].valid() for name in call.needed if name not in replaced}
    for parameter, name in replaced.items():
        argument = call.arguments[parameter]
        # Scenes and runs are not worked out where nothing is made of them.
        valid = argument.valid() if argument.needs_valid(name) else None
        try:
            value = made(argument.kind, name, valid)
        except (TypeError, ValueError, IndexError, StopIteration, OverflowError):
            value, name = argument.valid(), "itself"  # the valid value cannot be spoilt in this way
        arguments[parameter] = value
        if name not in argument.taken and not sensible(argument.kind, name, value, valid):
            odd.append(parameter)
    told = set(replaced.values())
    # Two columns of one table that both lose their last number are those of a shorter table.
    if len(odd) > 1 and told == {_SHORTER}:
        odd = []
    # A count that one argument may have fits the other one with it: a blow in space, gains of seven fingers.
    if len(odd) == 1 and len(replaced) > 1 and len(told) == 1 and told <= _COUNTS:
        odd = []
    with _patience():
        return _judged(call, arguments, odd)


def _judged(call: Call, arguments: dict[str, Any], odd: list[str]) -> Outcome:
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            answer = call.function(**arguments)
            jax.block_until_ready([leaf for leaf in jax.tree.leaves(answer) if isinstance(leaf, jax.Array)])
    except ValueError as error:
        return Outcome("sentence", words=str(error)) if is_one_sentence(str(error)) else _raw(error)
    except TimeoutError:
        return Outcome("slow", call.name, f"no answer within {_PATIENCE} s of processor time")
    except RuntimeError as error:
        by = [frame.name for frame in _frames(error)[-1:]]
        told = str(error) in _codes() or by == ["_checked"] and "\n" not in str(error)
        return Outcome("code") if told else _raw(error)
    except Exception as error:  # whatever else it is, it is raw
        return _raw(error)
    if told_by_code(answer):
        return Outcome("code")
    if isinstance(answer, jxr.Trajectory) and not _true(answer):
        return Outcome("silent", call.name, "a run with values that are not finite is called successful")
    if not odd:
        return Outcome("result")
    return Outcome("silent", f"{call.name} {' and '.join(odd)}", "taken as if it meant something")


def told_by_code(answer: Any) -> bool:
    """Whether an answer says itself that there is none: a run that failed, a verdict or a place not found."""
    last = answer[-1] if isinstance(answer, tuple) and answer else answer
    if isinstance(last, jxr.Trajectory | jxr.design.Design):
        return not bool(np.any(np.asarray(last.result == jxr.RESULTS.successful)))
    if isinstance(last, jxr.stability.Stability):
        return bool(last.verdict == jxr.stability.VERDICTS.not_found)
    return isinstance(last, jxr.stability.Equilibrium) and not bool(np.any(last.found))


def is_one_sentence(text: str) -> bool:
    """Whether an error's text is one line of at most 300 characters that begins with the argument's name."""
    return "\n" not in text and len(text) <= LONGEST and _SENTENCE.fullmatch(text) is not None


def _codes() -> list[str]:
    """The sentences of all result codes."""
    items = vars(jxr.RESULTS)["_name_to_item"].values()
    return [words for words in (jxr.RESULTS[item] for item in items) if words]


def _frames(error: BaseException) -> list[traceback.FrameSummary]:
    """The places of jaxroll on an error's way; of a run that failed `_checked` is the last."""
    return [f for f in traceback.extract_tb(error.__traceback__) if "/jaxroll/" in f.filename]


def _true(run: jxr.Trajectory) -> bool:
    good = np.asarray(run.result == jxr.RESULTS.successful)
    return not good.any() or bool(jnp.all(jnp.isfinite(run.last.q)))


def _raw(error: BaseException) -> Outcome:
    """An error that should not have come through, with the last place of jaxroll on its way."""
    frames = _frames(error)
    where = (
        f"{frames[-1].filename.rpartition('/jaxroll/')[2]}:{frames[-1].lineno}" if frames else "at the door"
    )
    try:
        text = " ".join(str(error).split())[:120]
    except Exception:
        text = "an error that cannot be printed"
    return Outcome("raw", where, f"{type(error).__name__}: {text}")


@contextlib.contextmanager
def _patience() -> Iterator[None]:
    """Raise `TimeoutError` in what takes longer than a minute of processor time, or ten minutes of waiting.

    On a busy machine a call may wait for a minute that takes a second.
    """

    def late(*_: Any) -> None:
        raise TimeoutError

    clocks = {signal.SIGALRM: signal.ITIMER_REAL, signal.SIGPROF: signal.ITIMER_PROF}
    before = {number: signal.signal(number, late) for number in clocks}
    signal.setitimer(signal.ITIMER_REAL, 10 * _PATIENCE)
    signal.setitimer(signal.ITIMER_PROF, _PATIENCE)
    try:
        yield
    finally:
        for number, clock in clocks.items():
            signal.setitimer(clock, 0)
            signal.signal(number, before[number])


class Trial:
    """Examples as they are tried: how each ended, the first offence of every kind printed when it is met.

    After `kept` examples all programs are forgotten, so that memory lasts.
    """

    def __init__(self, kept: int = 500) -> None:
        self._kept = kept
        self.seen: list[tuple[Example, Outcome]] = []
        self._met: set[tuple[str, str]] = set()
        self._start = time.perf_counter()

    def __call__(self, example: Example) -> None:
        ended = outcome(example)
        self.seen.append((example, ended))
        if not ended.good and (ended.kind, ended.where) not in self._met:
            self._met.add((ended.kind, ended.where))
            print(f"{ended.kind}  {ended.where}  {example}: {ended.words}", file=sys.stderr, flush=True)
        if len(self.seen) % 500 == 0:
            spent = time.perf_counter() - self._start
            print(f"{len(self.seen)} examples, {spent:.0f} s", file=sys.stderr, flush=True)
        if len(self.seen) % self._kept == 0:
            jax.clear_caches()


def drawn(count: int, number: int, names: Sequence[str] | None) -> list[tuple[Example, Outcome]]:
    """That many examples, by seed, and how each ended."""
    trial = Trial()

    @seed(number)
    @settings(
        max_examples=count,
        phases=[Phase.generate],
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(examples(names))
    def tried(example: Example) -> None:
        trial(example)

    tried()
    return trial.seen


def one_by_one(part: int, parts: int, names: Sequence[str] | None) -> list[tuple[Example, Outcome]]:
    """Every `parts`-th of all calls with one argument replaced, and how each ended."""
    trial = Trial(kept=5000)  # one value alone seldom makes another program: 600 in 5000 examples
    for example in itertools.islice(singles(names), part, None, parts):
        trial(example)
    return trial.seen


def report(seen: Sequence[tuple[Example, Outcome]]) -> str:
    """Counts, then the offences, place by place, with how often each was met and one example."""
    counts = collections.Counter(outcome.kind for _, outcome in seen)
    kinds = [*_GOOD, "silent", "raw", "slow"]
    lines = [f"{len(seen)} examples: " + ", ".join(f"{kind} {counts[kind]}" for kind in kinds)]
    offences: dict[tuple[str, str], list[tuple[Example, Outcome]]] = {}
    for example, ended in seen:
        if not ended.good:
            offences.setdefault((ended.kind, ended.where), []).append((example, ended))
    for (kind, where), met in sorted(offences.items()):
        example, ended = min(met, key=lambda pair: len(pair[0].values))
        lines.append(f"{kind}  {len(met)}x  {where}  {example}: {ended.words}")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser("python -m benchmarks.hostile", description=__doc__)
    parser.add_argument("--examples", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="public names; default: all")
    parser.add_argument("--singly", nargs="*", type=int, metavar=("PART", "PARTS"), help="every value once")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        if options.singly is None:
            seen = drawn(options.examples, options.seed, options.only)
        else:
            seen = one_by_one(*(options.singly or (0, 1)), options.only)
    print(report(seen))
    sys.exit(any(not ended.good for _, ended in seen))


if __name__ == "__main__":
    main()
