"""What to say where a library of the extra `cad` is not installed."""


def missing(library: str) -> ImportError:
    """The error for a library that could not be imported."""
    return ImportError(f'this needs the library {library}: pip install "jaxroll[cad]"')
