"""What the commands of `jaxroll` do and print; `__main__` reads the command line and calls it.

Names are imported with their first use (`__init__.pyi` lists them), so that JAX is not imported before it is
needed: help and complaints come at once. Modules called `_..._order` and `_..._parser` say what a command
takes, without JAX; modules called `_..._command` do what it is asked for.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
