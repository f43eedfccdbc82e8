"""Work done once for a value that never changes."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

from ._results import traced

Build = TypeVar("Build", bound=Callable[[Any], Any])
_KEPT = 16


class _Same:
    """A value as a key: equal to itself alone."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __hash__(self) -> int:
        return id(self.value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and other.value is self.value


def remembered(build: Build) -> Build:
    """Keep what a function made of its last few arguments; what JAX is tracing is made anew.

    For contours and grasps, which never change: two runs with one of them then share its tables.
    """
    kept = functools.lru_cache(maxsize=_KEPT)(lambda key: build(key.value))

    @functools.wraps(build)
    def door(value: Any) -> Any:
        return build(value) if traced(value) else kept(_Same(value))

    return door  # pyright: ignore
