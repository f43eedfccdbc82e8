"""A cache of what a function made of its last few arguments: tables and checks of contours and grasps.

`_compute_once` is for values within a program.
"""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

from .._results import traced

Build = TypeVar("Build", bound=Callable[[Any], Any])
_KEPT = 16


def remembered(build: Build) -> Build:
    """Keep what a function made of its last few arguments; what JAX is tracing is made anew.

    For contours and grasps, which never change: two runs with one of them then share its tables.
    """
    # Keyed by `id`. The argument is kept with its result, so that Python gives the id to nothing else.
    kept: dict[int, tuple[Any, Any]] = {}

    @functools.wraps(build)
    def door(value: Any) -> Any:
        found = kept.get(id(value))
        if found is not None:
            # Moved to the end, so that entries in use stay, however many others are added.
            kept[id(value)] = kept.pop(id(value))
            return found[1]
        made = build(value)
        if not traced(value):
            kept[id(value)] = (value, made)
            for oldest in list(kept)[:-_KEPT]:
                kept.pop(oldest, None)
        return made

    return door  # pyright: ignore
