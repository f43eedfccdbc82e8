"""What to say where a library of an extra is not installed."""


def missing(library: str, extra: str = "cad") -> ImportError:
    """The error for a library that could not be imported."""
    return ImportError(f'this needs the library {library}: pip install "jaxroll[{extra}]"')
