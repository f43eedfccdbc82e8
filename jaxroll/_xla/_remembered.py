"""What a function made of its last few arguments, kept: tables and checks of contours and grasps.

Two runs with one grasp then share its tables. `_compute_once` is for values within a program.
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
    # By identity. The value is kept with what was made of it, so that its number stays its own.
    kept: dict[int, tuple[Any, Any]] = {}

    @functools.wraps(build)
    def door(value: Any) -> Any:
        found = kept.get(id(value))
        if found is not None:
            # Put last, so that what is still asked for stays, however much else is made beside it.
            kept[id(value)] = kept.pop(id(value))
            return found[1]
        made = build(value)
        if not traced(value):
            kept[id(value)] = (value, made)
            for oldest in list(kept)[:-_KEPT]:
                kept.pop(oldest, None)
        return made

    return door  # pyright: ignore
