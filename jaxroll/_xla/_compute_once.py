"""Values worked out once however many use them: in a program, and in Python for what never changes.

XLA's fusion on CPUs copies cheap producers into every consumer, and so turns the equations of motion of 1000
operations into 10 000. It never copies a division. `_share_cotangents` does the same for derivatives.
"""

import contextlib
import contextvars
import functools
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import jax

from .._results import traced
from ._primitives import barrier

Build = TypeVar("Build", bound=Callable[[Any], Any])
_KEPT = 16

_ON: contextvars.ContextVar[bool] = contextvars.ContextVar("on", default=False)


@contextlib.contextmanager
def sharing() -> Iterator[None]:
    """While tracing inside, `once` makes XLA compute its argument once.

    On an accelerator, which copies little and where a division is dear, `once` does nothing.
    """
    token = _ON.set(jax.default_backend() == "cpu")
    try:
        yield
    finally:
        _ON.reset(token)


def once(tree: Any) -> Any:
    """The argument itself; inside `sharing`, computed once however many use it."""
    if not _ON.get():
        return tree
    return jax.tree.map(lambda x: x if isinstance(x, float) else barrier(x), tree)


def as_it_is(function: Callable) -> Callable:
    """The function itself: where `pulled` may stand, and nothing is differentiated backwards."""
    return function


def remembered(build: Build) -> Build:
    """Keep what a function made of its last few arguments; what JAX is tracing is made anew.

    For contours and grasps, which never change: two runs with one of them then share its tables.
    """
    # By identity. The value is kept with what was made of it, so that its number stays its own.
    kept: dict[int, tuple[Any, Any]] = {}

    @functools.wraps(build)
    def door(value: Any) -> Any:
        found = kept.get(id(value))
        if found is not None:
            return found[1]
        made = build(value)
        if not traced(value):
            kept[id(value)] = (value, made)
            for oldest in list(kept)[:-_KEPT]:
                kept.pop(oldest, None)
        return made

    return door  # pyright: ignore
