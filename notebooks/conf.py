"""Sphinx: how the site is built. `sphinx-build -W -n --keep-going notebooks build/site`."""

import os
import pathlib
import sys

HERE = pathlib.Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from jupyter_cache import get_cache
from sphinx.util.typing import stringify_annotation

import jaxroll
from jaxroll._types import Given
from notebooks.extensions import docstrings, pages

project = "jaxroll"
author = "The jaxroll developers"
version = release = jaxroll.__version__
html_theme = "furo"
html_title = "jaxroll"
html_static_path = []
extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax", "myst_nb"]
exclude_patterns = ["extensions"]
nitpicky = True
language = "en_GB"

myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 3

# Notebooks run once: those that the tests have run already are taken from there.
nb_execution_mode = "cache"
nb_execution_cache_path = os.environ.get("JAXROLL_NOTEBOOK_CACHE", str(HERE.parent / ".jupyter_cache"))
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 90
add_module_names = False
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_custom_sections = [("Daily use", "params_style"), ("Rarely changed", "params_style")]


def _known_notebooks(app, config) -> None:
    """Put notebooks that were run elsewhere into the cache: `JAXROLL_EXECUTED` is their folder."""
    del app
    folder = os.environ.get("JAXROLL_EXECUTED")
    for path in sorted(pathlib.Path(folder).glob("*.ipynb")) if folder else ():
        cache = get_cache(config.nb_execution_cache_path)
        cache.cache_notebook_file(path, uri=str(HERE / path.name), overwrite=True)


def _written_pages(app) -> None:
    pages.write(pathlib.Path(app.srcdir) / "generated")


def _reference(app, env, node, contnode):
    """Types in signatures: those of jaxroll at their public place, and others as text.

    A name that should be jaxroll's own and public, and is not there, stays a warning.
    """
    target = node.get("reftarget", "")
    if node.get("refdomain") != "py":
        return None
    if (found := pages.targets().get(target)) and found != target:
        domain = env.get_domain("py")
        return domain.resolve_xref(env, node["refdoc"], app.builder, "obj", found, node, contnode)
    private = target.startswith("jaxroll._") or "._" in target
    return contnode if private or not target.startswith("jaxroll") else None


def _signature(app, what, name, obj, options, signature, returned):
    """What a caller may give has one name, `Given`, in the place of the union of types that it is."""
    del app, what, name, obj, options
    spelt = stringify_annotation(Given, "smart")
    return tuple(text and text.replace(spelt, "Given") for text in (signature, returned))


def setup(app) -> None:
    """Connect what is made for jaxroll."""
    app.connect("config-inited", _known_notebooks)
    app.connect("builder-inited", _written_pages)
    app.connect("autodoc-process-docstring", docstrings.process, priority=400)
    app.connect("autodoc-process-signature", _signature)
    app.connect("missing-reference", _reference)
