"""Differentiable simulation of grasping under rolling contact, in JAX.

`scenes` has the chapter's scenes ready-made; `Finger`, `FreeObject` or `PivotedObject` and `Contact`
make a `Grasp`; `close` finds a consistent `State`; `simulate` runs it; `plotting` draws it.
"""

import lazy_loader

__version__ = "0.1.0"

# Names are imported with their first use, so that `import jaxroll` is immediate and the command line answers
# `--help` without loading JAX. Which there are, and where, says `__init__.pyi`.
_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    if name not in __all__:  # the loader's sentence is its own, and Python's is known
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _attribute(name)
