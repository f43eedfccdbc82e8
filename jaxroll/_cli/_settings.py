"""How the command line sets JAX: double precision, where compiled programs are kept, and on what they run."""

import os
import tempfile
from pathlib import Path


def configure() -> None:
    """Set JAX before anything is compiled; a ValueError where the environment asks for what is not there."""
    # SciPy's OpenBLAS, to which XLA hands factorisations, may wait for itself for ever when several threads
    # call it, as those of a sweep do. It reads this when it is loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import jax

    jax.config.update("jax_enable_x64", True)
    if place := _kept_in():
        jax.config.update("jax_compilation_cache_dir", place)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    asked = os.environ.get("JAX_PLATFORMS")
    try:
        jax.default_backend()
    except Exception as error:  # JAX's own, of several kinds and sometimes without a word
        told = f"; JAX said: {error}" if str(error) else ""
        raise ValueError(
            f"environment variable JAX_PLATFORMS must name what JAX can run on here, but was {asked!r}{told}"
        ) from None


def _kept_in() -> str | None:
    """The folder of compiled programs; None where nothing is to be kept, or the default place does not serve.

    A home that cannot be written to, as in a container, is no reason for a command to fail.
    """
    asked = os.environ.get("JAXROLL_CACHE")
    if asked == "off":
        return None
    home = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    try:
        place = tried_folder(Path(asked or f"{home}/jaxroll").expanduser())
    except (OSError, ValueError, RuntimeError) as error:  # the last where nobody knows a home
        if not asked:
            return None
        raise ValueError(
            f"environment variable JAXROLL_CACHE must name a folder that can be written to, but: {error}"
        ) from None
    return str(place)


def tried_folder(folder: Path) -> Path:
    """The folder, made if need be; raises the system's error if no file can be written to it."""
    folder.mkdir(parents=True, exist_ok=True)
    tempfile.TemporaryFile(dir=folder).close()
    return folder
