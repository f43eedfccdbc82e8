"""What makes a sweep this one and no other: fingerprints by name, and the sentence that says what differs.

A chunk may be taken from a folder only if computing it again would give the same numbers to the last bit.
That depends on the versions of the libraries, the processor (XLA compiles for its instructions, and rounds
accordingly), the flags of XLA, the precision, and on the parameters, options and functions that the caller
gives. `identity` gathers all of it that is known before anything is traced; `_sweep` adds the marks of
"make", "keep" and "program". `_folder` stores the marks in the manifest, and compares them by `differences`.
"""

import hashlib
import inspect
import os
import pathlib
import platform
import sys
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._fingerprint import fingerprint, PACKAGES, version_of
from .._integration import simulate
from .._results import shown

# Beginnings of the names of instruction sets that XLA compiles for. The other flags of a processor are left
# out: which of them are listed depends on the version of the operating system's kernel.
_INSTRUCTIONS = ("sse", "ssse", "avx", "amx", "fma", "f16c", "bmi", "asimd", "neon", "sve", "sme", "fp")
# Beginnings of the flags of XLA that change no numbers: where to write dumps, how many devices to emulate.
_SILENT = ("--xla_dump", "--xla_force_host_platform_device_count")
# Marks of lowered programs. They change with almost every other mark, and are then a consequence, not the
# cause that the caller wants to read of.
_EFFECTS = ("make", "keep", "program")
# At most so many differences are named in a sentence; the others are counted.
_NAMED = 2
_WORDS = {"program": "the program of the runs (a function that make or an option holds)"}


class Mark(NamedTuple):
    """One thing by which sweeps differ: its fingerprint, and how a sentence quotes it."""

    digest: str
    words: str


Identity = dict[str, Mark]


def identity(rows: Any, t1: Any, chunk: int, options: dict[str, Any]) -> Identity:
    """All marks of a sweep that are known before anything is traced.

    Args:
        rows: The parameters.
        t1: The final time [s].
        chunk: Runs in one chunk.
        options: Those of `simulate`, by name.
    """
    usual = {name: p.default for name, p in inspect.signature(simulate).parameters.items()}
    marks = machine()
    marks["parameters"] = Mark(fingerprint(rows), _form(rows))
    marks["chunk"] = _text(f"{chunk} runs")
    marks["t1"] = _value(t1)
    for name, value in options.items():
        # An option with the default value of `simulate` gets no mark, so that a sentence about another folder
        # calls it "not given". `throw` and `progress_meter` do not bear on the numbers. The module `inspect`
        # stands for a missing default, to which no option is equal.
        if name not in ("throw", "progress_meter") and not _same(value, usual.get(name, inspect)):
            marks[f"option {name}"] = _value(value)
    return marks


def machine() -> Identity:
    """Marks of where a sweep is computed: versions, processor, flags and precision of this process."""
    marks = {f"version of {name}": _text(version_of(name)) for name in PACKAGES}
    marks["version of python"] = _text(f"{sys.version_info.major}.{sys.version_info.minor}")
    marks["processor"] = _text(_processor())
    marks["XLA_FLAGS"] = _text(_flags())
    marks["precision"] = _text("double" if jnp.result_type(float) == np.float64 else "single")
    return marks


def differences(there: Identity, here: Identity) -> str:
    """What differs between two sweeps, as part of a sentence; empty where nothing does.

    A mark of a program that only one of them has is not compared: the other's is not lowered yet.
    """
    names = [*there, *(name for name in here if name not in there)]
    causes = [n for n in names if n not in _EFFECTS and there.get(n) != here.get(n)]
    effects = [n for n in _EFFECTS if n in there and n in here and there[n].digest != here[n].digest]
    # Another version, machine or precision, and other shapes of the parameters may change every lowered
    # program, so that nothing follows from its mark. Other numbers or options leave that of `make` alone: if
    # it differs as well, it is a difference in its own right. `keep` and the whole program are named only
    # where nothing else differs.
    if any(n.startswith(("version", "processor", "XLA", "precision")) for n in causes):
        effects = []
    if "parameters" in causes and there["parameters"].words != here["parameters"].words:
        effects = []
    effects = effects[:1] if "make" in effects or not causes else []
    found = [_difference(n, there.get(n), here.get(n)) for n in (*causes, *effects)]
    rest = len(found) - _NAMED
    return ", ".join(found[:_NAMED]) + (f" and {rest} more" if rest > 0 else "")


def combined(marks: Identity) -> str:
    """One fingerprint of all marks, by which a chunk says which sweep it is of."""
    text = repr(sorted((name, mark.digest) for name, mark in marks.items()))
    return hashlib.sha256(text.encode()).hexdigest()


def _difference(name: str, there: Mark | None, here: Mark | None) -> str:
    """A mark's name, with what it was there and is here in words if the words differ."""
    name = _WORDS.get(name, name)
    old, new = (mark.words if mark is not None else "not given" for mark in (there, here))
    return name if old == new else f"{name} ({old} there, {new} here)"


def _text(words: str) -> Mark:
    """The mark of a text, which is its own digest."""
    return Mark(words, _short(words))


def _short(words: str) -> str:
    return words if len(words) <= 60 else f"{words[:56]} ..."


def _value(value: Any) -> Mark:
    return Mark(fingerprint(value), _short(shown(value)))


def _same(value: Any, usual: Any) -> bool:
    return type(value) is type(usual) and fingerprint(value) == fingerprint(usual)


def _form(rows: Any) -> str:
    """Dtypes and shapes of the parameters, in words."""
    leaves = jax.tree.leaves(rows)
    forms = ", ".join(f"{x.dtype}{list(x.shape)}" for x in leaves)
    return _short(forms)


def _flags() -> str:
    """The flags of XLA that may change numbers, in alphabetical order."""
    given = os.environ.get("XLA_FLAGS", "").split()
    return " ".join(sorted(flag for flag in given if not flag.startswith(_SILENT)))


def _processor() -> str:
    """The kind of device in words; of a CPU its instruction sets, for which XLA compiles."""
    device = jax.local_devices()[0]
    if device.platform != "cpu":
        return f"{device.platform} {device.device_kind}"
    return f"{platform.machine()} {_instructions()}"


def _instructions() -> str:
    """Instruction sets of the CPU; on systems other than Linux the name that Python knows it by."""
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:  # not on Linux
        return platform.processor()
    for line in lines:
        name, _, found = line.partition(":")
        if name.strip() in ("flags", "Features"):
            return " ".join(sorted(f for f in set(found.split()) if f.startswith(_INSTRUCTIONS)))
    return platform.processor()
