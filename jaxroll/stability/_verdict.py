r"""What happens near an equilibrium: reduced Hessian, linearised closed loop, verdict.

`_equilibrium` finds where the grasp rests. There the rolling contacts leave $m = n - 2c$ directions of
motion, the columns of $N$, orthonormal in the mass metric. With $q = q_0 + N \xi$ and the contact forces held
the equations of motion become

$$ \ddot\xi + D \dot\xi + H \xi = 0, \qquad H = -N^T \frac{d (F + A^T \mu)}{d\xi}, \quad
   D = -N^T \frac{\partial F}{\partial v} N. $$

The change of $A^T \mu$ with the configuration at fixed $\mu$ is the curvature of the constraints; together
they make $H$ the Hessian of the potential (22) on the constraint manifold. The eigenvalues of the first-order
system decide, and those of $H$ tell neutral directions. `assess` is public; `design.Firmness` maximises what
it finds.
"""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float, Int

from .._closing import constraint_rows
from .._mechanics import check_planar, compiled, Grasp, State, to_leaves
from .._motion import bodies, generalised_force, mass_matrix
from .._printing import listed, named
from .._results import as_floats, check_between
from .._types import ByPrecision, Given, Scalar
from ._equilibrium import contact_force, Equilibrium, equilibrium
from ._memory_loop import eigenvalues, rates_with_memory

# Least relative size of curvatures and rates that can be told from zero.
_TOLD = ByPrecision(0.0, 1e-5)
# Difference of a Hessian from its transpose, relative to its curvatures, that is rounding.
_SYMMETRIC = ByPrecision(1e-7, 1e-3)
# What `assess` tells from zero if it is not told otherwise, and `Stability.bends_down`.
_TOLERANCE = 1e-7


@named
class VERDICTS(eqx.Enumeration):
    """What `assess` says of an equilibrium.

    A verdict prints as its name; `VERDICTS[verdict]` is the sentence.
    """

    asymptotically_stable = "Every small disturbance dies out."
    neutral = "Stable, but a family of equilibria: disturbances along it stay."
    unstable = "Some small disturbance grows."
    undamped = "No disturbance grows, but some never dies out."
    not_found = "No equilibrium was found near the state."


class Stability(eqx.Module):
    r"""Stability of a grasp at an equilibrium; m = n - 2c directions are left free by the contacts.

    Attributes:
        verdict: One of `VERDICTS`.
        neutral: Number of neutral directions: redundant joints, and rolling that costs no energy. With a
            memory, number of rates that are zero.
        equilibrium: Where it rests.
        hessian: Shape (m, m), second derivative of P on the constraint manifold [1/s^2], in the
            directions of `tangent`; not symmetric for a user's controller or load without potential. The
            memory of a controller is held: of a sampled one it is that of all but the controller.
        tangent: Shape (n, m), directions that keep every contact rolling, orthonormal in the mass metric.
            This basis is arbitrary and may change from call to call: the derivatives of `hessian` and
            `tangent` are those of a basis that turns as little as it can. The fields below depend on it in
            nothing but the signs of `modes`.
        curvatures: Shape (m,), eigenvalues of the (symmetric part of the) Hessian, rising.
        modes: Shape (n, m), the coordinates' part in each of them.
        rates: Shape (2m,), eigenvalues of the linearised closed loop [1/s], by rising real part; shape
            (2m + k,) with k numbers of memory, those of a sampled law's torques and times not counted. Of a
            sampled loop log(z)/T with z the eigenvalues of the map from one sample to the next.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"hessian": "1/s^2", "curvatures": "1/s^2", "rates": "1/s"}

    verdict: VERDICTS
    neutral: Int[Array, ""]
    equilibrium: Equilibrium
    hessian: Float[Array, "m m"]
    tangent: Float[Array, "n m"]
    curvatures: Float[Array, " m"]
    modes: Float[Array, "n m"]
    rates: Complex[Array, " 2m"]

    @property
    def bends_down(self) -> Bool[Array, "..."]:
        """Whether the potential falls in some direction; False where a controller or load has no potential.

        A controller with a memory counts as one without: there `rates` alone decide.
        """
        share = max(_TOLERANCE, _TOLD.of(self.hessian))
        bent = _bent_down(self.hessian, self.curvatures, share, least=_rounding(self.rates))
        return bent & (self.equilibrium.state.memory is None)


def assess(grasp: Grasp, state: State, *, t: Given = 0.0, tolerance: float = _TOLERANCE) -> Stability:
    r"""Stability of a grasp near a state: find its equilibrium and linearise the closed loop there.

    On the manifold of closed, rolling contacts, with tangent directions N, $N^T M N = 1$:
    $\ddot\xi + D \dot\xi + H \xi = 0$, where $H = -N^T \frac{d}{d\xi}(F + A^T \mu)$ at fixed contact
    forces is the Hessian of the potential (22) on the manifold, and $D = -N^T \partial F/\partial v\, N$.
    On flat parallel faces $H$ is the Hessian of $U(s_1, s_2)$, (39)-(40) corrected, in other
    coordinates, plus what $\alpha_i$ adds; unlike (41) it decides, and on any contours.

    A direction is neutral if its curvature is below `tolerance` of the largest. Along neutral directions
    the verdict is that of the linearisation; a term of higher order could still move the grasp.

    Args:
        grasp: A grasp in the plane; those of space have no verdict.
        state: Where to look: a start or the end of a run.
        t: Time [s] at which a time-dependent controller or load is held.
        tolerance: Relative size of curvatures and rates that count as zero. In single precision rounding is
            larger than the default: smaller ones than 1e-5 count as zero there in any case.

    Returns:
        A `Stability`. Works under `jit`, `vmap` and differentiation; the eigenvalues' derivatives need
        them to be distinct. Second derivatives take long to compile: minutes for a pinch.

    Raises:
        ValueError: If the grasp lives in space, its contacts leave no direction free, the state is not one of
            it, `t` is not a finite number, or `tolerance` not a number from 0 to 1.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> jxr.stability.assess(grasp, state).verdict == jxr.stability.VERDICTS.asymptotically_stable
        Array(True, dtype=bool)
    """
    share = as_floats("tolerance", tolerance, ())
    check_between("tolerance", share, 0.0, 1.0)
    held = as_floats("t", t, ())
    check_planar(grasp)
    _check_free(grasp)
    # By the public function: callers that ask for the equilibrium too, as pictures do, share its program.
    return _linearised(grasp, equilibrium(grasp, state, t=held), held, share)


def _check_free(grasp: Grasp) -> None:
    """Raise where the contacts hold as many directions as there are: none is left to be disturbed in."""
    rows = sum(contact.rows for contact in grasp.contacts)
    if rows >= grasp.coordinates:
        raise ValueError(
            f"argument grasp must leave a direction free, but its contacts hold {rows} and it has "
            f"{grasp.coordinates}"
        )


@compiled
def _linearised(grasp: Grasp, rest: Equilibrium, t: Given, tolerance: Array) -> Stability:
    """The closed loop linearised at an equilibrium, and the verdict, compiled as one program."""
    if least := _TOLD.of(grasp, rest.state):
        tolerance = jnp.maximum(tolerance, least)
    ready = grasp.prepared()
    tangent, rolling = _tangent(ready, rest.state)
    hessian = -tangent.T @ _along(ready, rest, t, tangent, rolling)
    damping = -tangent.T @ _damping(ready, rest, t) @ tangent
    symmetric = 0.5 * (hessian + hessian.T)
    curvatures, vectors = jnp.linalg.eigh(symmetric)
    rates, still = _rates(hessian, damping), None
    if ready.form.memory:
        loop = {"hessian": hessian, "damping": damping, "tangent": tangent, "rolling": rolling}
        rates = rates_with_memory(ready, rest.state, t, **loop)
        size = jnp.max(jnp.abs(rates))
        still = jnp.sum(jnp.abs(rates) <= tolerance * size)
    # The rank is that of H itself, not of its symmetric part: a controller without a potential makes them
    # differ. It is a count, and svdvals has no derivative where singular values coincide: none is taken.
    least = _rounding(rates)
    size = jnp.maximum(jnp.max(jnp.abs(curvatures)), least)
    neutral = jnp.sum(jnp.linalg.svdvals(jax.lax.stop_gradient(hessian)) <= tolerance * size)
    bent = _bent_down(hessian, curvatures, tolerance, least=least)
    if still is not None:
        # H alone, with the memory held, decides nothing: the rates of the whole loop do.
        neutral, bent = still, jnp.zeros_like(bent)
    verdict = _verdict(rates, bent, neutral, tolerance)
    verdict = VERDICTS.where(rest.found, verdict, VERDICTS.not_found)
    modes = tangent @ vectors
    return Stability(verdict, neutral, rest, hessian, tangent, curvatures, modes, rates)


def _rounding(rates: Array) -> Scalar:
    """Curvature [1/s^2] that rounding hides beside the fastest rate: all of them, where no force acts."""
    fastest = jax.lax.stop_gradient(jnp.max(jnp.abs(rates), axis=-1))
    return jnp.finfo(fastest.dtype).eps * fastest**2


def _bent_down(
    hessian: Array, curvatures: Array, tolerance: Scalar, *, least: Scalar = 0.0
) -> Bool[Array, "..."]:
    """Whether the potential bends down in some direction; False where a controller or a load has none.

    Then H is not symmetric, and its symmetric part decides nothing: the grasp may come to rest though that
    has a negative curvature, or leave though it has none. Curvatures count by the largest, or by `least`.
    """
    size = jnp.maximum(jnp.max(jnp.abs(curvatures), axis=-1), least)
    skew = hessian - jnp.swapaxes(hessian, -1, -2)
    symmetric = jnp.max(jnp.abs(skew), axis=(-2, -1)) <= _SYMMETRIC.of(hessian) * size
    return symmetric & (curvatures[..., 0] < -tolerance * size)


def _verdict(rates: Array, bent: Array, neutral: Array, tolerance: Array) -> VERDICTS:
    """The verdict from rates [1/s], whether the potential bends down, and the number of neutral directions.

    The rate at which heavy damping lets a grasp leave may be too slow beside the fastest to be told from
    zero; how the potential bends then tells.
    """
    fastest = jnp.max(jnp.abs(rates))
    growing = jnp.max(rates.real) > tolerance * fastest
    # Every neutral direction gives one rate that is zero: the grasp stays there. The others must decay.
    decaying = jnp.sum(rates.real < -tolerance * fastest) >= rates.shape[0] - neutral
    verdict = VERDICTS.where(neutral > 0, VERDICTS.neutral, VERDICTS.asymptotically_stable)
    verdict = VERDICTS.where(decaying, verdict, VERDICTS.undamped)
    return VERDICTS.where(growing | bent, VERDICTS.unstable, verdict)


def _tangent(grasp: Grasp, state: State) -> tuple[Array, Array]:
    """Directions N of rolling motion, orthonormal in the mass metric, and how contacts roll along them.

    Shapes (n, m), and (c, m) for the change of every contact coordinate along every direction.
    """
    n, contacts = grasp.coordinates, len(grasp.contacts)
    by_q, by_s = jax.jacfwd(lambda q, s: constraint_rows(grasp, q, s), argnums=(0, 1))(state.q, state.s)
    # Of a contact's three rows, x gap, y gap and tangency, the gaps are the constraints A; they do not depend
    # on s to first order, as rolling moves both contact points alike. Tangency gives the rolling:
    # by_q dq + by_s ds = 0.
    by_q, by_s = by_q.reshape(contacts, 3, n), by_s.reshape(contacts, 3, contacts)
    jacobian = by_q[:, :2].reshape(2 * contacts, n)
    _, inertias = bodies(grasp, to_leaves(state, grasp.form))
    mass = mass_matrix([inertia.mass for inertia in inertias], n)
    # A basis B of the null space by SVD has no smooth derivative. It is taken as constant; then it is
    # projected onto A B = 0 in the mass metric, and made orthonormal by the Cholesky factor L of B^T M B:
    # N = B L^-T. Both steps are smooth, and give N its derivative.
    basis = jnp.linalg.svd(jax.lax.stop_gradient(jacobian))[2][2 * contacts :].T
    weighted = jnp.linalg.solve(mass, jacobian.T)
    basis = basis - weighted @ jnp.linalg.solve(jacobian @ weighted, jacobian @ basis)
    lower = jnp.linalg.cholesky(basis.T @ mass @ basis)
    tangent = jax.scipy.linalg.solve_triangular(lower, basis.T, lower=True).T
    return tangent, -jnp.linalg.solve(by_s[:, 2], by_q[:, 2] @ tangent)


def _along(grasp: Grasp, rest: Equilibrium, t: Given, tangent: Array, rolling: Array) -> Array:
    r"""Change of $F + A^T \mu$ along the tangent directions, with contact forces held; shape (n, m)."""
    zero, memory = jnp.zeros_like(rest.state.q), rest.state.memory

    def force(q: Array, s: Array) -> Array:
        drive = generalised_force(grasp, jnp.asarray(t, q.dtype), State(q, zero, s, memory))
        return drive + contact_force(grasp, q, s, rest.push)

    def change(dq: Array, ds: Array) -> Array:
        return jax.jvp(force, (rest.state.q, rest.state.s), (dq, ds))[1]

    return jax.vmap(change, in_axes=1, out_axes=1)(tangent, rolling)


def _damping(grasp: Grasp, rest: Equilibrium, t: Given) -> Array:
    r"""$\partial F / \partial v$ at rest, shape (n, n)."""

    def force(v: Array) -> Array:
        at = State(rest.state.q, v, rest.state.s, rest.state.memory)
        return generalised_force(grasp, jnp.asarray(t, v.dtype), at)

    return jax.jacfwd(force)(rest.state.v)


def _rates(hessian: Array, damping: Array) -> Any:
    r"""Eigenvalues [1/s] of the first-order system of $\xi$ and its rate, by rising real part."""
    zero, one = jnp.zeros_like(hessian), jnp.eye(hessian.shape[0], dtype=hessian.dtype)
    rates = eigenvalues(jnp.block([[zero, one], [-hessian, -damping]]))
    return rates[jnp.argsort(rates.real)]
