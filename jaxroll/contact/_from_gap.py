r"""The derivatives that the dynamics takes of a contact, all of them from its gap and its tangency.

With poses $X$ of both bodies, a place $s$, the gap $g(X, s)$ and the tangency $\tau(X, s)$:

$$ A v = \frac{\partial g}{\partial X} \dot X, \qquad
   \frac{\partial \tau}{\partial s} \dot s = -\frac{\partial \tau}{\partial X} \dot X, \qquad
   \frac{\partial g}{\partial s} \dot s = 0. $$

The first are the Pfaffian rows: the gap's derivative **at a frozen place**, which is the whole derivative
because of the third. The second and third determine the rate of the place; the second alone does where the
place has as many numbers as the tangency, and the third then follows at vanishing tangency. A pose moves
under a twist as `Pose2.rate` and `Pose3.rate` say, so each derivative is one jvp. `AbstractContact` takes its
defaults from here.
"""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._linalg import Factor, factorise, inner, Pose2, Pose3, solve, total, Vec2, Vec3
from .._results import as_array, shown, traceable
from .._types import Scalar, Scalars
from ._gap import Motion, row_wise, Rows

_Shapes = tuple[Any, Any]
_Pair = tuple[Any, Any]

# Tangencies are angles; times this length [m] their derivatives along a place are like those of the gaps.
_ARM = 0.01


def _alike(primal: Any, tangent: Any) -> Any:
    """A tangent of the type that `jax.jvp` wants: constants among its numbers become arrays."""
    return jax.tree.map(lambda p, t: jnp.asarray(t, jnp.result_type(p, float)), primal, tangent)


def _arrays(tree: Any) -> Any:
    """A pytree whose constants are arrays, as `jax.jvp` wants its arguments."""
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.result_type(x, float)), tree)


def _along(function: Any, arguments: tuple, rates: tuple) -> Any:
    """The derivative of a function along rates of its arguments."""
    arguments = _arrays(arguments)
    return jax.jvp(function, arguments, _alike(arguments, rates))[1]


def _pose_rates(poses: _Pair, twists: _Pair) -> _Pair:
    return poses[0].rate(twists[0]), poses[1].rate(twists[1])


def derived_gap_rate(contact: Any, poses: _Pair, twists: _Pair, touch: Any) -> Scalars:
    """The rate [m/s] of each gap under the twists of both bodies, at a frozen place."""
    return _along(lambda poses: tuple(contact.gap(poses, touch)), (poses,), (_pose_rates(poses, twists),))


def derived_pfaffian(contact: Any, bodies: tuple[Motion, Motion], touch: Any) -> tuple[Rows, Rows]:
    """Constraint rows over the fingertip's velocities and the object's: gap rates under their unit twists."""
    poses, (tip, body) = (bodies[0].pose, bodies[1].pose), bodies
    still = tip.resting().twist, body.resting().twist
    tips = [contact.gap_rate(poses, (unit, still[1]), touch) for unit in tip.unit_twists]
    objects = [contact.gap_rate(poses, (still[0], unit), touch) for unit in body.unit_twists]
    return row_wise(tips, contact.rows), row_wise(objects, contact.rows)


def derived_bias(
    contact: Any, shapes: _Shapes, place: Any, bodies: tuple[Motion, Motion], *, touch: Any, rolling: Any
) -> Scalars:
    r"""The acceleration [m/s^2] of each gap at $\dot v = 0$: the derivative of its rate along the motion."""
    poses, twists = (bodies[0].pose, bodies[1].pose), (bodies[0].twist, bodies[1].twist)
    moving = contact.place_rate(shapes, place, poses, rolling)
    turning = _along(lambda place: contact.touch(shapes, place), (place,), (moving,))
    rates = _pose_rates(poses, twists), (bodies[0].bias, bodies[1].bias), turning
    return _along(lambda *now: tuple(contact.gap_rate(*now)), (poses, twists, touch), rates)


def derived_rolling(
    contact: Any, shapes: _Shapes, place: Any, bodies: tuple[Motion, Motion], *, touch: Any, bend: Factor
) -> Scalars:
    """How fast the place moves, in the directions of `shift`, so that tangency and gaps stay as they are."""
    poses = bodies[0].pose, bodies[1].pose
    rates = _pose_rates(poses, (bodies[0].twist, bodies[1].twist))
    change = _tangency_rate(contact, poses, rates, touch)
    tilts, _ = _slopes(contact, shapes, place, poses)
    return _answer(bend, tilts, change)


def derived_place_rate(contact: Any, shapes: _Shapes, place: Any, rates: Scalars) -> Any:
    """Rate of the place itself from rates in the directions of `shift`."""
    zero = (0.0,) * contact.slack
    return _along(lambda step: contact.shift(shapes, place, step), (zero,), (rates,))


def derived_bend(contact: Any, shapes: _Shapes, place: Any, poses: _Pair) -> Factor:
    """Factor of the matrix of `_normal_matrix`, with which `rolling` and `settled` move the place."""
    return _normal_matrix(*_slopes(contact, shapes, place, poses))


def derived_settled(
    contact: Any, shapes: _Shapes, place: Any, turned: Any, *, poses: _Pair, tangency: Any, bend: Factor
) -> Any:
    """The place at which tangency holds, to first order, after a small turn of the fingertip."""
    touch = contact.touch(shapes, place)
    # Only the turn is taken into account: the change of the tangency by the displacement of the origins is of
    # the size of the gap that was removed, and is left to the next call.
    rates = poses[0].turning(turned), jax.tree.map(lambda _: 0.0, poses[1])
    change = _tangency_rate(contact, poses, rates, touch)
    left = [a + b for a, b in zip(jax.tree.leaves(tangency), change, strict=True)]
    tilts, _ = _slopes(contact, shapes, place, poses)
    return contact.shift(shapes, place, _answer(bend, tilts, left))


def derived_margin(contact: Any, shapes: _Shapes, place: Any, poses: _Pair) -> Scalar:
    r"""How far the place is from being undetermined, from 1 down to 0: a sine between directions of `shift`.

    Of a place of one number it is $|\partial\tau/\partial s|$ over the sum of the sizes of its terms, such as
    two curvatures of opposite sign.
    """
    if not contact.slack:
        return jnp.ones(())
    tilts, gaps = _slopes(contact, shapes, place, poses)
    sizes, _ = _sizes(contact, shapes, place, poses)
    # Tangencies are angles per length and gaps have no unit. One weight for all directions makes them alike;
    # each column is then divided by the length that it would have if none of its terms cancelled.
    largest = functools.reduce(jnp.maximum, sizes)
    weight = 1.0 / jnp.where(largest > 0, largest, 1.0)
    columns = []
    for tilt, gap, size in zip(tilts, gaps, sizes, strict=True):
        length = jnp.sqrt((weight * size) ** 2 + inner(gap, gap))
        scale = 1.0 / jnp.where(length > 0, length, 1.0)
        columns.append((*(x * weight * scale for x in tilt), *(x * scale for x in gap)))
    factor = factorise([[inner(a, b) for b in columns[: i + 1]] for i, a in enumerate(columns)])
    least = functools.reduce(jnp.maximum, [jnp.abs(inverse) for inverse in factor.inverse_pivots])
    return 1.0 / jnp.sqrt(least)


def _tangency_rate(contact: Any, poses: _Pair, rates: _Pair, touch: Any) -> Scalars:
    """The rate of each tangency under rates of both poses, at a frozen place."""
    return tuple(jax.tree.leaves(_along(lambda poses: contact.tangency(poses, touch), (poses,), (rates,))))


def _directions(contact: Any) -> list[Scalars]:
    """Unit steps of `shift`."""
    count = contact.slack
    return [tuple(1.0 if i == j else 0.0 for j in range(count)) for i in range(count)]


def _slopes(contact: Any, shapes: _Shapes, place: Any, poses: _Pair) -> tuple[list[Scalars], list[Scalars]]:
    """Derivatives of tangencies and gaps along each direction of `shift`."""

    def both(step: Scalars) -> tuple[Scalars, Scalars]:
        touch = contact.touch(shapes, contact.shift(shapes, place, step))
        return tuple(jax.tree.leaves(contact.tangency(poses, touch))), tuple(contact.gap(poses, touch))

    zero = (0.0,) * contact.slack
    found = [_along(both, (zero,), (unit,)) for unit in _directions(contact)]
    return [tilts for tilts, _ in found], [gaps for _, gaps in found]


def _sizes(contact: Any, shapes: _Shapes, place: Any, poses: _Pair) -> tuple[list[Scalar], list[Scalar]]:
    """Sums of the absolute values of all terms of both parts of `_slopes`, by directions of `shift`."""
    leaves, structure = jax.tree.flatten(_arrays(contact.touch(shapes, place)))

    def both(*leaves: Any) -> tuple[list[Any], Scalars]:
        touch = jax.tree.unflatten(structure, leaves)
        return jax.tree.leaves(contact.tangency(poses, touch)), tuple(contact.gap(poses, touch))

    parts = jax.jacfwd(both, argnums=tuple(range(len(leaves))))(*leaves)
    sizes: tuple[list[Scalar], list[Scalar]] = ([], [])
    for unit in _directions(contact):
        moved = lambda step: contact.touch(shapes, contact.shift(shapes, place, step))  # noqa: E731
        rates = jax.tree.leaves(_along(moved, ((0.0,) * contact.slack,), (unit,)))
        for found, slopes in zip(sizes, parts, strict=True):
            found.append(total([jnp.abs(a * b) for row in slopes for a, b in zip(row, rates, strict=True)]))
    return sizes


def derived_slip(contact: Any, shapes: _Shapes, place: Any, poses: _Pair) -> Scalar:
    """How much the gap changes as the place alone moves, over the terms of that: zero where it rolls.

    Zero too for a place with more numbers than the tangency, as of two surfaces: its rate is found such that
    the gap does not change (`_normal_matrix`).
    """
    tilts, gaps = _slopes(contact, shapes, place, poses)
    if not contact.slack or len(tilts[0]) < contact.slack:
        return jnp.zeros(())
    _, sizes = _sizes(contact, shapes, place, poses)
    shares = [
        jnp.max(jnp.abs(jnp.stack(gap))) / jnp.where(size > 0, size, 1.0)
        for gap, size in zip(gaps, sizes, strict=True)
    ]
    return functools.reduce(jnp.maximum, shares)


def check_numbers(contact: Any, name: str, shapes: _Shapes) -> None:
    """Raise unless gap and tangency of a contact have the numbers that `rows` and `slack` promise."""

    def found(shapes: _Shapes) -> tuple[list[Any], list[Any], Any]:
        ready = tuple(shape.prepared() for shape in shapes)
        poses = (_still(contact.axes),) * 2
        place = contact.shift(ready, _arrays(contact.form(ready)), (0.0,) * contact.slack)
        touch = contact.touch(ready, place)
        gap = contact.gap(poses, touch)
        if not isinstance(gap, tuple | list) and not jnp.ndim(gap):
            raise ValueError(f"argument {name} must give its gaps as a tuple, but gave {shown(gap)}")
        parts = [as_array(f"{name}, in its gap,", part) for part in gap]
        leaves = jax.tree.leaves(contact.tangency(poses, touch))
        tangency = [as_array(f"{name}, in its tangency,", part) for part in leaves]
        return parts, tangency, contact.equations(poses, touch)

    with traceable(name):
        gap, tangency, equations = eqx.filter_eval_shape(found, shapes)
    if len(gap) != contact.rows:
        raise ValueError(f"argument {name} must have {contact.rows} gaps, its `rows`, but had {len(gap)}")
    closes = len(equations) == len(contact.equation_names())
    if bool(tangency) != bool(contact.slack) or not closes:
        raise ValueError(
            f"argument {name} must have a tangency for each of {contact.slack} directions of its place, "
            f"but had {len(tangency)}"
        )
    odd = [part.shape for part in (*gap, *tangency) if part.shape]
    if odd:
        raise ValueError(
            f"argument {name} must have gaps and tangencies of scalars, but one had shape {odd[0]}"
        )


def _still(axes: int) -> Any:
    """The pose of the world's own frame."""
    if axes == 2:
        return _arrays(Pose2(Vec2(0.0, 0.0), 1.0, 0.0))
    return _arrays(Pose3(*(Vec3(*row) for row in np.eye(4, 3, -1).tolist())))


def _normal_matrix(tilts: list[Scalars], gaps: list[Scalars]) -> Factor:
    r"""Factor of $J^T J$, where $J$ holds the derivatives of tangencies and gaps along the place.

    Where the place has as many numbers as the tangency, the gaps' part vanishes in contact. Between two
    surfaces it is what makes the points on both move with one velocity.
    """
    columns = [(*(x * _ARM for x in tilt), *gap) for tilt, gap in zip(tilts, gaps, strict=True)]
    return factorise([[inner(a, b) for b in columns[: i + 1]] for i, a in enumerate(columns)])


def _answer(factor: Factor, tilts: list[Scalars], change: Any) -> Scalars:
    """The step of the place that undoes a change of the tangencies and leaves the gaps as they are."""
    undone = [x * -(_ARM * _ARM) for x in change]
    return tuple(solve(factor, [inner(tilt, undone) for tilt in tilts]))
