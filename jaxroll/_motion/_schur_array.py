"""$A M^{-1} A^T$ of many contacts as an array, which is factorised in a loop (`_linalg._loop_factor`).

`_linearisation` calls it where the rows are too many to write the matrix out number by number.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._linalg import stacked, total
from .._mechanics import Grasp
from .._types import Scalars
from ..contact import Rows

# A contact's rows of A, or of A M^-1: the block over the finger's velocities, then that over the object's.
Pair = tuple[Rows, Rows]


def schur_array(grasp: Grasp, jacobian: Sequence[Pair], weighted: Sequence[Pair]) -> Float[Array, "m m"]:
    """The sum, over all columns of $A$, of the outer product of a column with the same one of $A M^{-1}$."""
    owners = [contact.finger for contact in grasp.contacts for _ in range(contact.rows)]
    together = np.equal.outer(owners, owners)
    terms = []
    for block in (0, 1):
        left, right = ([row for pair in pairs for row in pair[block]] for pairs in (jacobian, weighted))
        for k in range(max(map(len, left))):
            product = _column(left, k)[:, None] * _column(right, k)[None, :]
            # Entry k is over joint k of a row's own finger: rows of two fingers share the object's alone.
            terms.append(product if block else jnp.where(together, product, 0.0))
    return total(terms)


def _column(rows: Sequence[Scalars], k: int) -> Float[Array, " m"]:
    """Entry k of every row; zero for those of fingers with fewer joints."""
    return stacked([row[k] if k < len(row) else 0.0 for row in rows])
