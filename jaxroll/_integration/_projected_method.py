"""A method of diffrax that returns to the constraints after every step.

`VectorField.projected` makes it, for `diffrax.diffeqsolve`; `simulate` has a loop of its own (`_step`).
"""

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from .._results import shown


class Projected(diffrax.AbstractWrappedSolver[Any]):
    """A method of diffrax, and after every step of it the return to the constraints.

    A step begins at the projected end of the one before. The last derivative that a method may have kept
    belongs to the end before projection, and is computed anew: one evaluation more in every step.

    Attributes:
        solver: The method.
        project: From a time and $y$ to the nearest $y$ on the constraints.
        width: Length of $y$.
    """

    solver: diffrax.AbstractSolver[Any]
    project: Callable[[Any, Any], Any]
    width: int = eqx.field(static=True)

    @property
    def term_structure(self) -> Any:
        return self.solver.term_structure

    @property
    def scan_kind(self) -> Any:
        """Kind of loop over the stages: diffrax sets it, by the adjoint, in the method itself."""
        return self.solver.scan_kind  # pyright: ignore

    @property
    def root_finder(self) -> Any:
        """An implicit method's root finder: diffrax gives it the tolerances of the step-size control."""
        return self.solver.root_finder  # pyright: ignore

    @property
    def interpolation_cls(self) -> Any:
        return self.solver.interpolation_cls

    def order(self, terms: Any) -> Any:
        """Order of the method, which the projection does not lower."""
        return self.solver.order(terms)

    def strong_order(self, terms: Any) -> Any:
        """None: there is no noise."""
        return self.solver.strong_order(terms)

    def error_order(self, terms: Any) -> Any:
        """Order of the error estimate, which is the method's own."""
        return self.solver.error_order(terms)

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> Any:
        """The method's own initial memory."""
        self._check(terms, y0)
        return self.solver.init(terms, t0, t1, y0, args)

    def step(
        self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any
    ) -> tuple[Any, Any, Any, Any, Any]:
        """One step of the method, its end projected."""
        self._check(terms, y0)
        # "The field has jumped" tells the method to compute its first derivative anew.
        jumped = jnp.asarray(True)
        raw, error, dense, memory, code = self.solver.step(terms, t0, t1, y0, args, solver_state, jumped)
        y1 = self.project(t1, raw)
        between: dict[str, Any] = {**dense}  # pyright: ignore
        if "y1" in between:  # so that dense output meets the start of the next step
            between["y1"] = y1
        return y1, error, between, memory, code

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        """The vector field."""
        return self.solver.func(terms, t0, y0, args)

    def _check(self, terms: Any, y0: Any) -> None:
        """Raise where what is integrated is not this grasp's motion forwards in time."""
        if not (isinstance(y0, jax.Array) and y0.shape == (self.width,)):
            raise ValueError(
                "argument adjoint must be one that differentiates the steps, RecursiveCheckpointAdjoint or "
                "ForwardMode: BacksolveAdjoint goes back through projections, which it cannot undo"
            )
        inner = terms
        while hasattr(inner, "term"):  # diffrax wraps it, for the direction of time
            inner = inner.term
        if not isinstance(inner, diffrax.ODETerm):
            raise ValueError(
                f"argument terms must be the vector field's own, without noise, but was {shown(inner)}"
            )
