"""What the commands of `jaxroll` do and print; `__main__` reads the command line and calls it.

Names are imported with their first use (`__init__.pyi` lists them), so that what needs JAX waits until it is
wanted: help and complaints come at once.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
