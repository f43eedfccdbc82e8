r"""Statics of a two-finger pinch: the chapter's (25)-(29), (32), (37) and (39)-(41), for any contours.

Under control (16) the fingers pull their centres $O_1, O_2$ together, with the potential
$U = \frac\beta2 \|O_1 - O_2\|^2$ (27). Tangency fixes how a fingertip stands on the object, so that both
centres are known in the object's frame from the places $s_1, s_2$ of contact alone, and with them
$U(s_1, s_2)$: no pose is needed, no mass, and none of the rest of the finger.

The derivatives of U are computed in two ways. `pinch_statics` takes them by autodiff, right everywhere.
`_rolled` has them in closed form from the Frenet frames, without derivatives of the curvature: its Hessian is
right where the gradient vanishes, costs little, and can be differentiated once more. `pinch_rest` is built on
it, and `design.Firmness` on that. `rectangle_hessian` and `margin` are the chapter's special case of flat
parallel faces.
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._analysis import check_pinch
from .._fields import is_command
from .._linalg import Vec2
from .._mechanics import check_grasp, compiled, Grasp, State
from .._printing import listed
from .._results import as_array, as_share, check_finite, check_instance, concrete, shown
from .._types import ByPrecision, Given, Scalar
from ..control import Opposition
from ..geometry import AbstractContour, Catenary, Circle, Ellipse, Frenet2, Moved
from ..loads import Drag, Impulse
from ._equilibrium import on_contours

# Gradient of U below which a place counts as one of rest, relative to the force between the centres.
_AT_REST = ByPrecision(1e-9, 1e-4)
# Newton's method has converged when a step is below this share of the longest one.
_ARRIVED = ByPrecision(1e-13, 1e-5)
# Most steps of Newton's method.
_STEPS = 60
# Contours that are nowhere straight, whatever their numbers.
_CURVED = (Catenary, Circle, Ellipse)
# Curvature of a face relative to its fingertip's, and angle [rad] between two faces, that count as none.
_NONE = ByPrecision(1e-6, 1e-4)
# Share of a contour's length by which its ends may be passed.
_ROUNDING = ByPrecision(1e-12, 1e-6)


class PinchStatics(eqx.Module):
    r"""The opposition potential as a function of where two fingertips touch.

    Attributes:
        d: $(r_1 - r_2) \cdot b_{01}$ [m], (28) on parallel faces.
        l: $(r_1 - r_2) \cdot n_{01}$ [m], (29) on parallel faces; negative in a pinch.
        potential: $U = \frac\beta2 (d^2 + l^2)$ [J], (27).
        gradient: Shape (2,), $\partial U / \partial s_i$ [N].
        hessian: Shape (2, 2), $\partial^2 U / \partial s_i \partial s_j$ [N/m].
        turning: Shape (2,), by how much fingertip i turns against the object: $\kappa_i + \kappa_{0i}$
            [rad/m].
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {
        "d": "m",
        "l": "m",
        "potential": "J",
        "gradient": "N",
        "hessian": "N/m",
        "turning": "rad/m",
    }

    d: Float[Array, "..."]
    l: Float[Array, "..."]  # noqa: E741
    potential: Float[Array, "..."]
    gradient: Float[Array, "... 2"]
    hessian: Float[Array, "... 2 2"]
    turning: Float[Array, "... 2"]


def pinch_statics(grasp: Grasp, s: Given) -> PinchStatics:
    r"""$U(s_1, s_2)$, d, l, gradient and Hessian of a pinch under control (16): (25)-(29), (32), (39)-(40).

    The distance of the two finger centres depends only on where both fingertips touch, since tangency
    fixes their orientations relative to the object. Its stationary points are where $O_1, P_1, P_2, O_2$ are
    collinear (on parallel faces $d = 0$ and $b_i \cdot \gamma_i = 0$); the chapter's (37) is not
    sufficient. They are the equilibria of a grasp in which U alone decides: `pinch_rest` says of which.

    Args:
        grasp: Two fingers, one contact each, driven by `control.Opposition`.
        s: Shape (..., 2), the chapter's $s_i$ [m]: arclength along the object in the direction of $b_{0i}$,
            which is the contact's `sense` times the object contour's own. It counts from that contour's zero,
            while the `s` of `scenes.pinch_ellipse` counts from where each finger faces the ellipse: of a
            state `contact_geometry(grasp, state).s` has the $s_i$ meant here.

    Returns:
        `PinchStatics`, of the leading shape of `s`; NaN where a place lies beyond an end of a contour.

    Raises:
        ValueError: If the grasp is not a two-finger pinch under `control.Opposition`, or `s` not pairs of
            finite numbers.

    Example:
        >>> import jax.numpy as jnp
        >>> import jaxroll as jxr
        >>> grasp, _ = jxr.scenes.pinch()
        >>> rest = jxr.stability.pinch_statics(grasp, jnp.zeros(2))
        >>> f"d = {rest.d:.3f} m, l = {rest.l:.3f} m"
        'd = 0.000 m, l = -0.050 m'
    """
    return _pinch_statics(grasp, _as_places(s))


def _as_places(s: Given) -> Array:
    """Pairs of arclengths [m], shape (..., 2), checked."""
    places = check_finite("s", as_array("s", s))
    if places.shape[-1:] != (2,):
        raise ValueError(f"argument s must have shape (..., 2), but had shape {places.shape}")
    return jnp.asarray(places, float)


def _check_constant(grasp: Grasp) -> None:
    """Raise unless a grasp is a pinch whose controller has numbers that do not change in time."""
    check_pinch(grasp)
    if not isinstance(grasp.controller, Opposition):
        raise ValueError(
            f"argument grasp must be driven by control.Opposition itself, "
            f"but was by {type(grasp.controller).__name__}"
        )
    if is_command(grasp.controller.beta):
        raise ValueError(
            "argument grasp must have a number as its controller's beta, but it was a function of time; "
            "grasp.with_(controller=grasp.controller.at(t)) holds it"
        )


@compiled
def _pinch_statics(grasp: Grasp, s: Array) -> PinchStatics:
    """The statics at every pair of places, compiled as one program."""
    _check_constant(grasp)
    ready = grasp.prepared()

    def at(s: Array) -> PinchStatics:
        d, l_ = _separation(ready, s)
        energy, turning = lambda s: _potential(ready, s), _rolled(ready, s).turning  # noqa: E731
        found = PinchStatics(d, l_, energy(s), jax.grad(energy)(s), jax.hessian(energy)(s), turning)
        there = on_contours(ready, s, jnp.hypot(d, l_))
        return jax.tree.map(lambda x: jnp.where(there, x, jnp.nan), found)

    many = at
    for _ in range(s.ndim - 1):
        many = jax.vmap(many)
    return many(s)


def _touching(grasp: Grasp, i: int, s: Scalar) -> tuple[Frenet2, Frenet2, Vec2]:
    """Frames of object and fingertip where finger i touches, each in its body, and the vector to its centre.

    The vector runs from the contact point to the finger's centre $O_i$, in the object's frame. `s` is the
    chapter's arclength: the contact's `sense` times that of the object's contour.
    """
    contact = grasp.contacts[i]
    tip, face = grasp.shapes(contact)
    at = face.frame(contact.sense * s)
    # Rolling: the arclengths of fingertip and object have a constant sum.
    on_tip = tip.frame(contact.s_tip + contact.s_object - contact.sense * s)
    # Tangency turns the fingertip until its tangent and normal are opposite to the object's. So P has
    # the components along the fingertip's that -P, from contact point to centre, has along the object's.
    along, across = on_tip.point.dot(on_tip.tangent), on_tip.point.cross(on_tip.tangent)
    return at, on_tip, at.tangent * along + at.tangent.right() * across


def _separation(grasp: Grasp, s: Array) -> tuple[Scalar, Scalar]:
    """Components d and l: $r_1 - r_2$ in the object's frame, along $b_{01}$ and $n_{01}$, (25)-(29)."""
    (first, _, one), (second, _, other) = (_touching(grasp, i, s[i]) for i in (0, 1))
    apart = (first.point + one) - (second.point + other)
    tangent, sense = first.tangent * grasp.contacts[0].sense, grasp.contacts[0].sense
    return apart.dot(tangent), apart.dot(tangent.left() * sense)


def _potential(grasp: Grasp, s: Array) -> Scalar:
    """U of (27) [J]."""
    d, l_ = _separation(grasp, s)
    return 0.5 * grasp.controller.beta * (d * d + l_ * l_)


def pinch_rest(grasp: Grasp, state: State, *, damping: float = 0.0) -> tuple[Float[Array, "2"], PinchStatics]:
    r"""Where a pinch comes to rest under control (16), and the statics there: $\partial U/\partial s_i = 0$.

    Newton's method on the two contact places alone: no pose, no masses, so that it costs next to nothing
    beside `equilibrium`. It holds where U is all that decides: without gravity and loads, with
    $\alpha_i = 0$, and where fingertips roll independently of each other, which the two jaws of a gripper do
    not. The stationary point found near the start need not be a minimum: the eigenvalues of its Hessian tell.

    Args:
        grasp: A pinch, as `pinch_statics` takes it.
        state: Where to start; only its contact coordinates count.
        damping: In the derivative an eigenvalue $x$ of the Hessian counts as $x + e^2/x$ with $e$ this share,
            from 0 to 1, of the Hessian's Frobenius norm. By default exact: infinite where the place is
            neutral.

    Returns:
        The chapter's $s_i$ at rest [m], as `pinch_statics` takes them, and the statics there; NaN where none
        was found between the contours' ends, or where $\alpha_i$ or gravity, unknown while JAX traces them,
        are not zero. Derivatives, in both modes, are those of the implicit function theorem.

    Raises:
        ValueError: If the grasp is not such a pinch, more than U decides where it rests, the state is not one
            of it, or `damping` is no share.

    Accuracy: to rounding, in single precision places to some 1e-6 of the distance of the finger centres.

    Example:
        >>> import jax.numpy as jnp
        >>> import jaxroll as jxr
        >>> s, rest = jxr.stability.pinch_rest(*jxr.scenes.pinch_ellipse(alpha=0.0))
        >>> bool(jnp.all(jnp.linalg.eigvalsh(rest.hessian) > 0))
        True
    """
    check_grasp(grasp)
    _check_alone(grasp)
    return _pinch_rest(grasp, state, as_share("damping", damping))


def _check_alone(grasp: Grasp) -> None:
    """Raise where it is known that more than U decides where a pinch rests."""
    _check_constant(grasp)
    wanted, other = "for its potential U alone to say where it rests", "`stability.equilibrium` takes any"
    if is_command(alpha := grasp.controller.alpha) or np.any(concrete(alpha)):
        raise ValueError(f"argument grasp must have alpha = 0 {wanted}, but had {shown(alpha)}; {other}")
    if grasp.gravity is not None and np.any(seen := concrete(grasp.gravity)):
        raise ValueError(f"argument grasp must have no gravity {wanted}, but had {shown(seen)}; {other}")
    # Blows and drag do nothing at rest.
    if acting := [load for load in grasp.load if not isinstance(load, Drag | Impulse)]:
        raise ValueError(f"argument grasp must have no loads {wanted}, but had {shown(acting[0])}; {other}")
    # How many motions the contacts leave free. If no fingertip turns, the object's angle gives both places.
    ways = grasp.coordinates - 2 * len(grasp.contacts)
    if ways < 2 or not any(finger.joints and finger.turns for finger in grasp.fingers):
        raise ValueError(
            f"argument grasp must have fingertips that roll independently of each other {wanted}, but its "
            f"fingers were {shown([type(finger).__name__ for finger in grasp.fingers])} with "
            f"{shown([finger.joints for finger in grasp.fingers])} joints; {other}"
        )


@compiled
def _pinch_rest(grasp: Grasp, state: State, damping: float) -> tuple[Array, PinchStatics]:
    """Places of rest and the statics there, with the derivative of the implicit function theorem."""
    _check_constant(grasp)
    ready, pairs = grasp.prepared(), zip(grasp.contacts, state.s, strict=True)
    # The state counts rolled arclength from where the contact started; s is the place on the object, signed.
    start = jnp.stack([c.sense * (c.s_object - sigma) for c, sigma in pairs])
    still = jax.lax.stop_gradient(ready)
    found = _stationary(still, jax.lax.stop_gradient(start))
    # One more Newton step s - H^-1 g: at a stationary point g = 0, so that it changes nothing but the
    # derivative, which becomes -H^-1 dg of the implicit function theorem. H and s carry none, g does.
    bend = _rolled(still, found).hessian
    slope = _rolled(ready, found).gradient
    rest = found - (_solved(bend, slope) if damping == 0.0 else _damped(bend, slope, damping))
    statics = _rolled(ready, rest)
    # beta times the distance of the centres: the force with which the fingers pull [N].
    size = jnp.sqrt(2.0 * still.controller.beta * statics.potential)
    firm = jnp.max(jnp.abs(_rolled(still, found).gradient)) <= _AT_REST.of(size) * size
    firm = firm & _is_alone(still) & on_contours(still, found, size / jnp.abs(still.controller.beta))
    return jax.tree.map(lambda x: jnp.where(firm, x, jnp.nan), (rest, statics))


def _is_alone(grasp: Grasp) -> Array:
    """Whether alpha and gravity of a pinch are zero, so that U decides where it rests."""
    gravity = 0.0 if grasp.gravity is None else grasp.gravity
    return jnp.all(jnp.asarray(grasp.controller.alpha) == 0.0) & jnp.all(jnp.asarray(gravity) == 0.0)


def _rolled(grasp: Grasp, s: Array) -> PinchStatics:
    r"""U and its derivatives from the frames alone; the Hessian is right where the gradient vanishes.

    Rolling turns fingertip i about its contact point, by $\kappa = \kappa_A + \kappa_B$ per arclength. With
    the arm $a$ from there to its centre $c$, $\circ^\perp$ a quarter turn to the left and $\sigma = \pm 1$
    the `sense`, $c' = \sigma \kappa\, a^\perp$ and $c'' = -\kappa (\kappa\, a + t^\perp)$. The term
    $\sigma \kappa' a^\perp$ is left out of $c''$: it is normal to $O_i P_i$, which at rest lies along
    $O_1 O_2$, so that it drops out there.
    """
    centres, firsts, seconds, axes, bends = [], [], [], [], []
    for i in (0, 1):
        contact = grasp.contacts[i]
        at, on_tip, arm = _touching(grasp, i, s[i])
        bend = at.curvature + on_tip.curvature
        centres.append(at.point + arm)
        firsts.append(arm.left() * (bend * contact.sense))
        seconds.append(-(arm * bend + at.tangent.left()) * bend)
        axes.append(at.tangent * contact.sense)
        bends.append(bend)
    # U = beta r.r / 2 with r = c_1 - c_2: U_1 = beta r.c_1', U_11 = beta (c_1'.c_1' + r.c_1''),
    # U_12 = -beta c_1'.c_2', and the same for the second finger with the sign of r changed.
    apart, beta = centres[0] - centres[1], grasp.controller.beta
    gradient = jnp.stack([apart.dot(firsts[0]), -apart.dot(firsts[1])])
    mixed = -firsts[0].dot(firsts[1])
    own = [first.dot(first) for first in firsts]
    twice = [own[0] + apart.dot(seconds[0]), own[1] - apart.dot(seconds[1])]
    hessian = jnp.stack([jnp.stack([twice[0], mixed]), jnp.stack([mixed, twice[1]])])
    inward = axes[0].left() * grasp.contacts[0].sense
    d, l_, potential = apart.dot(axes[0]), apart.dot(inward), 0.5 * beta * apart.dot(apart)
    return PinchStatics(d, l_, potential, beta * gradient, beta * hessian, jnp.stack(bends))


def _solved(matrix: Array, right: Array) -> Array:
    """Solution of two equations with a symmetric matrix, by Cramer's rule."""
    (a, b), (_, c) = matrix
    return jnp.stack([c * right[0] - b * right[1], a * right[1] - b * right[0]]) / (a * c - b * b)


def _damped(matrix: Array, right: Array, share: float) -> Array:
    """`_solved` with eigenvalues x of the matrix replaced by x + e^2/x, where e is a share of its size.

    As $1/(x + e^2/x) = x/(x^2 + e^2)$, this is H (H^2 + e^2 1)^-1: bounded where an eigenvalue passes through
    zero.
    """
    square = matrix @ matrix
    return matrix @ _solved(square + share**2 * jnp.trace(square) * jnp.eye(2, dtype=matrix.dtype), right)


def _stationary(grasp: Grasp, start: Array) -> Array:
    """Places [m] at which the gradient of U vanishes, by Newton's method.

    No step is longer than a tenth of the distance of the fingers' centres. Where none is found after `_STEPS`
    steps, the last places are returned: the caller looks at the gradient.
    """

    def improve(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        s, _, i = carry
        here = _rolled(grasp, s)
        step = _solved(here.hessian, here.gradient)
        longest = 0.1 * jnp.sqrt(2.0 * here.potential / grasp.controller.beta)
        step = step * jnp.minimum(1.0, longest / (jnp.max(jnp.abs(step)) + 1e-300))
        return s - step, jnp.max(jnp.abs(step)) / longest, i + 1

    def more(carry: tuple[Array, Array, Array]) -> Array:
        return (carry[1] > _ARRIVED.of(carry[1])) & (carry[2] < _STEPS)

    return jax.lax.while_loop(more, improve, (start, jnp.full((), jnp.inf, start.dtype), jnp.array(0)))[0]


def rectangle_hessian(grasp: Grasp, s: Given) -> Float[Array, "2 2"]:
    r"""Closed form of the Hessian of U at an equilibrium on parallel faces: (39)-(40), corrected.

    $H = \beta \nabla d\, \nabla d^T + \beta\, \mathrm{diag}(-l \kappa_i^2 (1/\kappa_i + n_i \cdot \gamma_i))$
    with $\nabla d = (-\kappa_1 n_1 \cdot \gamma_1,\ \kappa_2 n_2 \cdot \gamma_2)$ [N/m]. The chapter prints
    it without the first term, which is why (41) for both fingers is sufficient and not necessary.

    It is the Hessian where $d = 0$ and $b_i \cdot \gamma_i = 0$, both arms normal to the faces. Off such an
    equilibrium the formula is evaluated as it stands, and lacks terms with the factors $d$ and
    $b_i \cdot \gamma_i$: `pinch_statics` has the whole Hessian, at any places and on any object.

    Args:
        grasp: A pinch, as `pinch_statics` takes it, of an object that is straight where the fingertips touch
            it, on two parallel sides.
        s: Shape (2,), the chapter's $s_i$ [m] at an equilibrium with both arms normal to the faces, $d = 0$.

    Returns:
        The matrix [N/m]; NaN where a place lies beyond an end of a contour, or the faces are not straight and
        parallel, and JAX traces their numbers.

    Raises:
        ValueError: If the grasp is not such a pinch, its faces are not straight and parallel, or `s` is not a
            pair of finite numbers.

    Example:
        >>> import jax.numpy as jnp
        >>> import jaxroll as jxr
        >>> grasp, _ = jxr.scenes.pinch()
        >>> bool(jnp.all(jnp.linalg.eigvalsh(jxr.stability.rectangle_hessian(grasp, jnp.zeros(2))) > 0))
        True
    """
    places = _as_places(s)
    if places.ndim != 1:
        raise ValueError(f"argument s must have shape (2,), but had shape {places.shape}")
    found, bends, between = _rectangle_hessian(grasp, places)
    wanted = "argument grasp must have an object with straight, parallel faces, but"
    if any(isinstance(_unplaced(grasp.shapes(contact)[1]), _CURVED) for contact in grasp.contacts):
        kinds = ", ".join(type(_unplaced(contour)).__name__ for contour in grasp.object.contours)
        raise ValueError(f"{wanted} its contours were {kinds}")
    if (seen := concrete(bends)) is not None and not np.all(_is_straight(seen)):
        raise ValueError(f"{wanted} its curvatures at the contacts were {shown(seen[:, 0])} 1/m")
    if (seen := concrete(between)) is not None and not _is_parallel(seen):
        raise ValueError(
            f"{wanted} its outward normals at the contacts were {np.degrees(seen):.4g} degrees from opposite"
        )
    return found


def _unplaced(contour: AbstractContour) -> AbstractContour:
    """The contour inside of all its placements."""
    return _unplaced(contour.contour) if isinstance(contour, Moved) else contour


def _is_straight(bends: Array | np.ndarray) -> Array | np.ndarray:
    """Whether faces are straight beside their fingertips; columns are the curvatures of both [1/m]."""
    return abs(bends[:, 0]) <= _NONE.of(bends) * abs(bends[:, 1])


def _is_parallel(between: Array | np.ndarray) -> Array | np.ndarray:
    """Whether faces are parallel, by the angle [rad] of one outward normal from the other's opposite."""
    return abs(between) <= _NONE.of(between)


@compiled
def _rectangle_hessian(grasp: Grasp, s: Array) -> tuple[Array, Array, Array]:
    """The formula of `rectangle_hessian` [N/m], and what tells whether it holds.

    The latter are the curvatures of each face and its fingertip, and the angle of one face's outward normal
    from the other's opposite.
    """
    _check_constant(grasp)
    ready = grasp.prepared()
    d, l_ = _separation(ready, s)
    first, second = (contact.sense for contact in ready.contacts)
    slopes, terms, bends, tangents = [], [], [], []
    # d is counted along b_01, to which b_02 is opposite where both contacts have one sense.
    for i, sign in ((0, -1.0), (1, -1.0 * first * second)):
        at, on_tip, _ = _touching(ready, i, s[i])
        kappa, reach = on_tip.curvature, _inward_reach(on_tip.point, on_tip.tangent)
        slopes.append(sign * kappa * reach)
        terms.append(-l_ * kappa**2 * (1.0 / kappa + reach))
        bends.append(jnp.stack([jnp.asarray(at.curvature, s.dtype), jnp.asarray(kappa, s.dtype)]))
        tangents.append(at.tangent)
    one, other = tangents
    between = jnp.arctan2(-one.cross(other), -one.dot(other))
    slope, bend = jnp.stack(slopes), jnp.stack(bends)
    hessian = ready.controller.beta * (jnp.outer(slope, slope) + jnp.diag(jnp.stack(terms)))
    right = jnp.all(_is_straight(bend)) & _is_parallel(between) & on_contours(ready, s, jnp.hypot(d, l_))
    return jnp.where(right, hessian, jnp.nan), bend, between


def _inward_reach(point: Vec2, tangent: Vec2) -> Scalar:
    r"""$n \cdot \gamma$ with $n$ the inward normal: minus the support function about the frame's origin."""
    return point.dot(tangent.left())


def margin(contour: AbstractContour, s: Given) -> Float[Array, "..."]:
    r"""Margin of condition (41), $1/\kappa + n \cdot \gamma$ [m], of a fingertip at arclengths `s`.

    $\gamma$ runs from the finger centre $O_i$, the contour's origin, and $n$ points inwards, so
    $-n \cdot \gamma$ is the support function h and the margin is $h''$: positive where the contour is
    blunter than the circle about $O_i$ through its tangent line.

    Positive on both fingertips it makes a pinch of parallel flat faces stable: **sufficient, not
    necessary**, for the true Hessian has another term (`rectangle_hessian`); on other objects it decides
    nothing. `assess` gives the verdict.

    Args:
        contour: A fingertip's contour about $O_i$, in the tip frame.
        s: Arclengths [m], shape (...), between the ends of an open contour.

    Returns:
        Margins [m], shape (...); NaN beyond an end, where JAX traces the arclengths or the ends.

    Raises:
        ValueError: If `contour` is no contour, or arclengths are not finite or beyond an end of an open one.

    Example:
        >>> import jaxroll as jxr
        >>> tip = jxr.Circle(0.010).moved((-0.002, 0.0))  # centre 2 mm behind O: h = 8 mm at the front
        >>> f"{jxr.stability.margin(tip, 0.0):.3f} m"
        '0.002 m'
    """
    check_instance("contour", contour, AbstractContour, "a contour")
    s = jnp.asarray(check_finite("s", as_array("s", s)), float)
    found = _margins(contour.normal(s), contour.point(s), contour.curvature(s))
    ends = None if contour.closed else contour.domain()
    if ends is None:
        return found
    low, high = (jnp.asarray(end, float) for end in ends)
    found, beyond = _without(found, s, low, high)
    seen = concrete(beyond)
    if seen is not None and np.any(seen):
        s, low, high = jax.lax.stop_gradient((s, low, high))  # their values, in a derivative too
        raise ValueError(
            f"argument s must lie between the contour's ends, {low:g} and {high:g} m, but was "
            f"{shown(np.asarray(s)[seen])}"
        )
    return found


@jax.jit  # this and the next function are one small program each, instead of seven
def _margins(normal: Array, point: Array, curvature: Array) -> Array:
    """Margins from what a contour has at some places; the sum is the support function, negated."""
    return 1.0 / curvature - jnp.sum(normal * point, axis=-1)


@jax.jit
def _without(margins: Array, s: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Margins, NaN beyond the ends of a contour, and which are."""
    # An end itself may be computed in another way, and so be off by rounding.
    slack = _ROUNDING.of(s) * (high - low)
    beyond = (s < low - slack) | (s > high + slack)
    return jnp.where(beyond, jnp.nan, margins), beyond
