"""A grasp's numbers in an array or two: what a run's loop holds of it.

Every leaf that a loop hands on costs XLA a kernel per step or a copy, and a grasp has dozens of scalars. So
they travel as one array, or, where a run is differentiated, as those in which a derivative is asked and the
others (`_derivative`). `_step` unpacks them for each evaluation; `_state_vector` does the same for states.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._linalg import scalars
from .._mechanics import Grasp


class Bundle(eqx.Module):
    """A grasp whose scalars are two arrays, for loops; calling it gives the grasp, ready for evaluation.

    Attributes:
        numbers: The scalars in which a run is differentiated, or all of them; None if there are none.
        constants: The other scalars, likewise.
        rest: The grasp without its scalars.
        moves: Of each scalar, whether it is among `numbers`.
        tree: Structure of the grasp's scalars.
        jumps: Whether the grasp declares jumps, which `rest` cannot tell.
        sampled: Whether its controller is sampled.
        thick: Whether its fingers have links with a radius.
    """

    numbers: Float[Array, " numbers"] | None
    constants: Float[Array, " constants"] | None
    rest: Grasp
    tree: Any = eqx.field(static=True)
    moves: tuple[bool, ...] = eqx.field(static=True)
    jumps: bool = eqx.field(static=True)
    sampled: bool = eqx.field(static=True)
    thick: bool = eqx.field(static=True)

    def __call__(self) -> Grasp:
        numbers, constants = (
            iter(()) if part is None else iter(scalars(part)) for part in (self.numbers, self.constants)
        )
        leaves = [next(numbers if moves else constants) for moves in self.moves]
        return eqx.combine(jax.tree.unflatten(self.tree, leaves), self.rest)

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        # For copies and other processes. equinox marks missing fields by one object, and a copy of that, in a
        # copy of the structure, would not count as the mark: so a tree of this structure is copied instead.
        numbered = jax.tree.unflatten(self.tree, range(self.tree.num_leaves))
        flags = (self.moves, self.jumps, self.sampled, self.thick)
        return _of_parts, (self.numbers, self.constants, self.rest, numbered, *flags)


def _of_parts(numbers: Any, constants: Any, rest: Any, numbered: Any, *flags: Any) -> Bundle:
    return Bundle(numbers, constants, rest, jax.tree.structure(numbered), *flags)


def bundle(grasp: Grasp, moving: Grasp | None = None) -> Bundle:
    """Gather the scalar leaves of a prepared grasp in arrays; other arrays, such as tables, stay.

    Args:
        grasp: The grasp.
        moving: The same grasp, with None in the places of all that does not move; without it all does.
    """
    own, rest = eqx.partition(grasp, _is_scalar)
    leaves, tree = jax.tree.flatten(own)
    which = tree.flatten_up_to(own if moving is None else eqx.filter(moving, _is_scalar))
    moves = tuple(leaf is not None for leaf in which)
    numbers, constants = (
        _in_one([leaf for leaf, m in zip(leaves, moves, strict=True) if m is kind]) for kind in (True, False)
    )
    thick = any(getattr(finger, "link_radius", None) is not None for finger in grasp.fingers)
    return Bundle(numbers, constants, rest, tree, moves, bool(grasp.jumps), grasp.form.sampled, thick)


def bundled_apart(grasp: Grasp, moving: Grasp, dots: Grasp) -> tuple[Bundle, Bundle, Bundle]:
    """A bundle as what moves and what does not, each with None for the other, and the tangents of the first.

    Args:
        grasp: The grasp.
        moving: The same grasp, with None in the places of all that does not move.
        dots: The tangents of what does.
    """
    whole = bundle(grasp, moving)
    tables = eqx.filter(moving, _is_scalar, inverse=True)
    others = jax.tree.map(lambda x, moves: x if moves is None else None, whole.rest, tables)
    slopes = _in_one(jax.tree.leaves(eqx.filter(dots, _is_scalar)))
    return (
        replace(whole, constants=None, rest=tables),
        replace(whole, numbers=None, rest=others),
        replace(whole, numbers=slopes, constants=None, rest=eqx.filter(dots, _is_scalar, inverse=True)),
    )


def _is_scalar(leaf: Any) -> bool:
    return eqx.is_inexact_array(leaf) and jnp.ndim(leaf) == 0


def _in_one(numbers: list[Array]) -> Array | None:
    return jnp.stack(numbers) if numbers else None
