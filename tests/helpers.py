"""Pytest's machinery: parameters that are marked slow, what is printed, and an oracle that may broadcast."""

import contextlib
import functools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest


def broadcasting(function):
    """Let an oracle broadcast as NumPy does; the package itself is tested without."""

    @functools.wraps(function)
    def allowed(*args):
        with jax.numpy_rank_promotion("allow"):
            return function(*args)

    return allowed


def slow_among(names, *slow, optimised=()):
    """Names as parameters of a test, some of them marked slow, and some of those marked optimised."""
    assert set(optimised) <= set(slow) <= set(names)
    marks = {name: [pytest.mark.slow] * (name in slow) for name in names}
    for name in optimised:
        marks[name].append(pytest.mark.optimised)
    return [pytest.param(name, marks=marks[name]) for name in names]


def in_single(function, *args):
    """What a function returns where JAX knows single precision only, its arguments rounded to that."""

    def rounded(x):
        return jnp.asarray(x, jnp.float32) if getattr(x, "dtype", None) == np.float64 else x

    with jax.enable_x64(False):
        return function(*jax.tree.map(rounded, args))


def numbers_blurred(text):
    """Figures that depend on the machine's rounding, reduced to their size."""
    text = re.sub(r"\d(\.\d)?e-(1[1-9]|2\d)", "tiny", text)
    text = re.sub(r"steps \d+;", "steps;", text)
    return re.sub(r"\d+ accepted, \d+ rejected", "steps", text)


def refused(words, when=True):
    """A refusal with these words, or none at all."""
    return pytest.raises(ValueError, match=words) if when else contextlib.nullcontext()
