"""The two error channels: host-side argument checks, and run-time result codes.

Bad arguments raise `ValueError` at once, with one sentence that says which argument it is, what it
must be and what it was. What goes wrong while a compiled program runs is a code of `RESULTS`: it
survives `vmap`, one code per lane, and never discards what had been computed.
"""

from typing import Any

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np


class RESULTS(eqx.Enumeration):
    """Result codes of `jaxroll.simulate`: 'successful', or why a run ended early."""

    successful = ""
    max_steps_reached = "The step limit was reached; `max_steps` sets it."
    step_collapsed = "The step size fell to the smallest allowed: the motion is singular or not finite there."
    singular_contact = (
        "The rolling contact became singular: the sum of the two curvatures, or the Schur "
        "complement of the constraints, is no longer positive."
    )
    contour_end = "A contact point ran past the end of an open contour."
    contact_lost = "A contact no longer presses: its normal force fell below zero."
    slipping = "A contact needs more friction than there is: its force left the friction cone."
    penetration = "A fingertip and the object overlap away from their contact."
    not_finite = "The equations of motion gave a value that is not finite."
    too_deep = "Two shapes overlap so deeply that their deepest point has no single nearest point."
    unreachable = "The initial state is off the constraints: no pose near the guess closes them."
    infeasible = "No point that keeps every limit was found; the one that passes them least is given."
    solver_failed = "The solver reported a failure of its own."


def traced(value: Any) -> bool:
    """Whether JAX is tracing some array in a value; then its numbers cannot be checked."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value))


def concrete(value: Any) -> np.ndarray | None:
    """The value as a NumPy array, or None while JAX is tracing."""
    return None if traced(value) else np.asarray(value)


def as_floats(name: str, value: Any, shape: tuple[int | None, ...]) -> jax.Array:
    """Convert an argument to a floating array of the given shape; `None` matches any length."""
    array = jnp.asarray(value)
    if not jnp.issubdtype(array.dtype, jnp.floating):
        array = array.astype(jnp.result_type(float))
    matches = array.ndim == len(shape) and all(
        want is None or want == have for want, have in zip(shape, array.shape, strict=True)
    )
    if not matches:
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise ValueError(f"argument {name} must have shape {wanted}, but had shape {array.shape}")
    return check_finite(name, array)


def check_finite(name: str, value: jax.Array) -> jax.Array:
    """Raise if a concrete value holds NaN or infinity."""
    seen = concrete(value)
    if seen is not None and not np.all(np.isfinite(seen)):
        raise ValueError(f"argument {name} must be finite, but was {seen.tolist()}")
    return value


def check_positive(name: str, value: jax.Array) -> jax.Array:
    """Raise if a concrete value is not strictly positive."""
    seen = concrete(value)
    if seen is not None and not np.all(seen > 0):
        raise ValueError(f"argument {name} must be positive, but was {seen.tolist()}")
    return value


def check_between(name: str, value: Any, low: Any, high: Any, *, unit: str = "") -> None:
    """Raise if a concrete value lies outside a closed interval."""
    seen, lows, highs = concrete(value), concrete(low), concrete(high)
    if seen is None or lows is None or highs is None:
        return
    if not np.all((lows <= seen) & (seen <= highs)):
        raise ValueError(f"argument {name} must lie between {lows:g} and {highs:g}{unit}, but was {seen:g}")


def message(result: RESULTS) -> str:
    """The sentence that belongs to one concrete result code; 'successful' for success."""
    return RESULTS[result] or "successful"
