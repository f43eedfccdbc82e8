"""Values worked out once however many use them in a program.

XLA's fusion on CPUs copies cheap producers into every consumer, and so turns the equations of motion of 1000
operations into 10 000. It never copies a division. `_share_cotangents` does the same for derivatives;
`_remembered` works out once what no run changes.
"""

import contextlib
import contextvars
from collections.abc import Callable, Iterator
from typing import Any

import jax

from ._primitives import barrier

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
    """The function itself, given in the place of `pulled` where nothing is differentiated backwards."""
    return function
