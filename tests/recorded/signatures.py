"""What every public function and class takes: names, kinds and defaults of all parameters."""

import enum
import inspect
from types import ModuleType
from typing import Any

import jaxroll as jxr

_MODULES = ("commands", "contact", "control", "design", "geometry", "io", "loads", "plotting", "scenes")
_MODULES += ("stability",)


def signatures(module: str) -> dict[str, Any]:
    """Of one public module, or of jaxroll itself: by name the parameters."""
    home = getattr(jxr, module) if module != "jaxroll" else jxr
    found: dict[str, Any] = {}
    for name in sorted(dir(home)):
        each = getattr(home, name)
        if name.startswith("_") or isinstance(each, ModuleType):
            continue
        if isinstance(each, type) and issubclass(each, enum.Enum) or not callable(each):
            found[name] = _told(each) if isinstance(each, int | float | str | tuple) else type(each).__name__
            continue
        if isinstance(each, type):
            found[name] = {"": _parameters(each)} | {
                method: _parameters(function)
                for method, function in sorted(inspect.getmembers(each, inspect.isfunction))
                if not method.startswith("_") and function.__module__.startswith("jaxroll")
            }
        else:
            found[name] = _parameters(each)
    return found


def modules() -> tuple[str, ...]:
    """Where public names are."""
    return ("jaxroll", *_MODULES)


def _parameters(function: Any) -> list[str]:
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return ["unknown"]
    return [_parameter(each) for each in parameters]


def _parameter(each: inspect.Parameter) -> str:
    marks = {each.VAR_POSITIONAL: "*", each.VAR_KEYWORD: "**", each.KEYWORD_ONLY: "by name: "}
    name = marks.get(each.kind, "") + each.name
    return name if each.default is each.empty else f"{name} = {_told(each.default)}"


def _told(value: Any) -> str:
    """Numbers and text as they are; of anything else its kind, for addresses and versions differ."""
    if value is None or isinstance(value, bool | int | float | str) and not isinstance(value, enum.Enum):
        return repr(value)
    if isinstance(value, tuple | list):
        return f"({', '.join(map(_told, value))})"
    return getattr(value, "__qualname__", type(value).__qualname__)
