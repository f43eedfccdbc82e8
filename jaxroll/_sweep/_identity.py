"""What makes a sweep this one and no other, by name."""

import hashlib
import importlib.metadata
import inspect
import os
import pathlib
import platform
import sys
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._integration import simulate
from .._results import shown
from ._fingerprint import fingerprint

_PACKAGES = ("jaxroll", "jax", "jaxlib", "diffrax", "equinox", "optimistix", "lineax", "numpy")
# Sets of instructions that XLA compiles for, by how their names begin; others come and go with the kernel.
_INSTRUCTIONS = ("sse", "ssse", "avx", "amx", "fma", "f16c", "bmi", "asimd", "neon", "sve", "sme", "fp")
# XLA's flags that say where to write and how many devices to pretend, not what to compute.
_SILENT = ("--xla_dump", "--xla_force_host_platform_device_count")
# What other differences bring with them: named only where there is no other cause.
_EFFECTS = ("make", "keep", "program")
# How many differences a sentence names.
_NAMED = 2
_WORDS = {"program": "the program of the runs (a function that make or an option holds)"}


class Mark(NamedTuple):
    """One thing by which sweeps differ: its fingerprint, and how a sentence quotes it."""

    digest: str
    words: str


Identity = dict[str, Mark]


def identity(rows: Any, t1: Any, chunk: int, options: dict[str, Any]) -> Identity:
    """All that is known of a sweep before anything is traced."""
    usual = {name: p.default for name, p in inspect.signature(simulate).parameters.items()}
    marks = {f"version of {name}": _text(_version(name)) for name in _PACKAGES}
    marks["version of python"] = _text(f"{sys.version_info.major}.{sys.version_info.minor}")
    marks["processor"] = _text(_processor())
    marks["XLA_FLAGS"] = _text(_flags())
    marks["precision"] = _text("double" if jnp.result_type(float) == np.float64 else "single")
    marks["parameters"] = Mark(fingerprint(rows), _form(rows))
    marks["chunk"] = _text(f"{chunk} runs")
    marks["t1"] = _value(t1)
    for name, value in options.items():
        # What is given as it is by default is not given; how a run reports changes nothing.
        if name not in ("throw", "progress_meter") and not _same(value, usual.get(name, inspect)):
            marks[f"option {name}"] = _value(value)
    return marks


def differences(there: Identity, here: Identity) -> str:
    """What differs between two sweeps, as part of a sentence; empty where nothing does.

    What only one of them knows yet of the programs is not compared.
    """
    names = [*there, *(name for name in here if name not in there)]
    causes = [n for n in names if n not in _EFFECTS and there.get(n) != here.get(n)]
    effects = [n for n in _EFFECTS if n in there and n in here and there[n].digest != here[n].digest]
    # Other numbers in the parameters leave `make` what it is; other shapes, versions or precision do not.
    if any(n.startswith(("version", "processor", "XLA", "precision")) for n in causes):
        effects = []
    if "parameters" in causes and there["parameters"].words != here["parameters"].words:
        effects = []
    effects = effects[:1] if "make" in effects or not causes else []
    found = [_difference(n, there.get(n), here.get(n)) for n in (*causes, *effects)]
    rest = len(found) - _NAMED
    return ", ".join(found[:_NAMED]) + (f" and {rest} more" if rest > 0 else "")


def combined(marks: Identity) -> str:
    """One fingerprint of all."""
    text = repr(sorted((name, mark.digest) for name, mark in marks.items()))
    return hashlib.sha256(text.encode()).hexdigest()


def _difference(name: str, there: Mark | None, here: Mark | None) -> str:
    name = _WORDS.get(name, name)
    old, new = (mark.words if mark is not None else "not given" for mark in (there, here))
    return name if old == new else f"{name} ({old} there, {new} here)"


def _text(words: str) -> Mark:
    return Mark(words, _short(words))


def _short(words: str) -> str:
    return words if len(words) <= 60 else f"{words[:56]} ..."


def _value(value: Any) -> Mark:
    return Mark(fingerprint(value), _short(shown(value)))


def _same(value: Any, usual: Any) -> bool:
    return type(value) is type(usual) and fingerprint(value) == fingerprint(usual)


def _form(rows: Any) -> str:
    leaves = jax.tree.leaves(rows)
    forms = ", ".join(f"{x.dtype}{list(x.shape)}" for x in leaves)
    return _short(forms)


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def _flags() -> str:
    given = os.environ.get("XLA_FLAGS", "").split()
    return " ".join(sorted(flag for flag in given if not flag.startswith(_SILENT)))


def _processor() -> str:
    """The kind of device; of a processor, what it can do: XLA compiles for that, and rounds accordingly."""
    device = jax.local_devices()[0]
    if device.platform != "cpu":
        return f"{device.platform} {device.device_kind}"
    return f"{platform.machine()} {_instructions()}"


def _instructions() -> str:
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:  # not on Linux
        return platform.processor()
    for line in lines:
        name, _, found = line.partition(":")
        if name.strip() in ("flags", "Features"):
            return " ".join(sorted(f for f in set(found.split()) if f.startswith(_INSTRUCTIONS)))
    return platform.processor()
