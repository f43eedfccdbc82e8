"""What the command line says while it works: what it does, that JAX compiles, and how long either took.

Compiling is most of a first call's time, and none of a second one's, whose programs are read from a cache.
JAX reports when a program is ready for its compiler and when the compiled one is there (`jax.monitoring`),
but not whether it was compiled or read. So "compiling" is said if it is not there within half a second.
"""

import contextlib
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

# Ends of the names of JAX's reports [s].
_LOWERED, _COMPILED = "/jaxpr_to_mlir_module_duration", "/backend_compile_duration"
# After this time [s] it must be the compiler that is waited for, since a cache answers sooner.
_PATIENCE = 0.5
# Compiling is told at the end where it took this share of the time, and this long [s].
_SHARE, _LEAST = 0.05, 0.1


def say(text: str, end: str = "\n") -> None:
    """Write to standard error, at once."""
    print(text, end=end, file=sys.stderr, flush=True)


@contextlib.contextmanager
def timed(doing: str) -> Iterator[dict[str, float]]:
    """Say what is being done, then how long it took; yields what will hold the seconds, as `s`."""
    say(f"{doing} ...", end="")
    start, spent = time.perf_counter(), {}
    with _compiling() as compiled:
        try:
            yield spent
        except BaseException:
            say("")
            raise
    spent["s"] = time.perf_counter() - start
    long = compiled["s"] > max(_LEAST, _SHARE * spent["s"])
    say(f" {spent['s']:.3g} s" + (f", {compiled['s']:.3g} s of it compiling" if long else ""))


@contextlib.contextmanager
def _compiling() -> Iterator[dict[str, float]]:
    """Say "compiling" once where JAX does; yields the seconds that its compiler took, as `s`."""
    spent = {"s": 0.0}
    if "jax" not in sys.modules:  # before the import nothing is compiled
        yield spent
        return
    from jax import monitoring

    waiting, said = [], []

    def announce() -> None:
        if not said:
            said.append(True)
            say(" compiling ...", end="")

    def heard(event: str, duration_secs: float, **_: Any) -> None:
        if event.endswith(_LOWERED):
            timer = threading.Timer(_PATIENCE, announce)
            timer.daemon = True
            waiting.append(timer)
            timer.start()
        elif event.endswith(_COMPILED):
            spent["s"] += duration_secs
            while waiting:
                waiting.pop().cancel()

    monitoring.register_event_duration_secs_listener(heard)
    try:
        yield spent
    finally:
        monitoring.unregister_event_duration_listener(heard)
        while waiting:
            waiting.pop().cancel()
