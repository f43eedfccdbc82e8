r"""Two surfaces rolling on each other in space: tangency, rolling velocity, and the contact that has them.

The contact points of a fingertip A and an object B move over both with one velocity $s$ (the chapter's
conditions A-1 and A-2: the points coincide, and so do the tangent planes). The outward normals stay opposite,
$n_A = -n_B = -n$. With the shape operators $L = \mathrm{d}n$ in world axes, the normals have the rates
$\dot n_A = -\omega_A \times n + L_A s$ and $\dot n_B = \omega_B \times n + L_B s$. The sum of these is
zero, so that in the tangent plane

$$ (L_A + L_B)\,s = (\omega_A - \omega_B) \times n. $$

These are Montana's equations without a chart.
"""

from dataclasses import dataclass
from typing import Any, Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._fields import real, taken, through
from .._linalg import plus, Pose3, square, Sym3, tangents, Twist3, Vec3
from .._results import check_flag, check_positive, shown
from .._types import Given, Scalar, Scalars
from .._xla import once
from ..geometry import AbstractSurface, check_surface, Gauss3
from ._contact import AbstractContact, as_index
from ._gap import arms_of, gap, gap_bias, gap_rate, Motion, pfaffian, row_wise, Rows

SurfacePair = tuple[AbstractSurface, AbstractSurface]
Place = tuple[Scalars, Scalars]

# The row that prevents spin is an angular rate; times this arm [m] it is a velocity, like the other rows.
_ARM = 0.01
# How often a place returns to its surfaces after a step of `close`.
_RETURNS = 4
# Added under the square root of a tangential force's size, so that it has a derivative at zero [N^2].
_NO_FORCE = 1e-24


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Touch3:
    """The Gauss frames of both surfaces at one contact, each in its own body."""

    tip: Gauss3
    object: Gauss3

    @property
    def points(self) -> tuple[Vec3, Vec3]:
        """Both contact points, each in its own body frame."""
        return self.tip.point, self.object.point


def compliance(poses: tuple[Pose3, Pose3], touch: Touch3, line: bool) -> Sym3:
    r"""Inverse of $L_A + L_B$ in the tangent plane, as a matrix in world axes, zero along the normal.

    Two surfaces that touch along a line do not curve along it: with `line`, the inverse is that across it.
    """
    # H = L_A + L_B maps the normal to zero, and is a 2x2 matrix in the tangent plane, with H^-1 =
    # (tr H - H) / det H. With a line its only eigenvalue is k = tr H, and its pseudo-inverse is H / k^2.
    tip, body = poses
    bend = once(touch.tip.shape.turned(tip) + touch.object.shape.turned(body))
    trace = bend.trace()
    if line:
        return bend * (1.0 / (trace * trace))
    normal = body.turn(touch.object.normal)
    plane = Sym3(1.0, 0.0, 0.0, 1.0, 0.0, 1.0) - square(normal)
    return (plane * trace - bend) * (1.0 / bend.minors())


def _as_spin(name: str, spin: Any) -> str:
    if not isinstance(spin, str) or spin not in ("free", "prevented"):
        raise ValueError(f"argument {name} must be 'free' or 'prevented', but was {shown(spin)}")
    return spin


class Contact3(AbstractContact):
    r"""A fingertip's surface that rolls on one of the object's surfaces.

    Its place is the point on each surface, in the surface's own coordinates. Those of an implicit surface are
    the point itself in the body's frame, three numbers, so that there is no chart and no pole.

    Args:
        finger: Which finger touches. Static.
        surface: Which of the object's surfaces is touched. Static.
        spin: 'free', or 'prevented': then the bodies do not turn against each other about the common
            normal, and a torque about it keeps them from it. Static.
        line: Whether the surfaces touch along a straight line (two parallel cylinders, a cylinder on a
            plane): the contact is then held at one place of the line and rolls across it. Static.
        friction: Coefficient $\mu$: a run ends where the tangential force exceeds $\mu f$. Default: no limit,
            no cost.

    Raises:
        ValueError: If `finger` or `surface` is not a whole number from 0 up, `spin` is neither, `line` is not
            True or False, or `friction` is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> jxr.Contact3(spin="prevented").rows
        4
    """

    finger: int = through(as_index, static=True)
    surface: int = through(as_index, static=True)
    spin: str = through(_as_spin, static=True)
    line: bool = through(check_flag, static=True)
    friction: Float[Array, ""] | None = real(check=check_positive, optional=True)

    def __init__(
        self,
        finger: int = 0,
        surface: int = 0,
        *,
        spin: Literal["free", "prevented"] = "free",
        line: bool = False,
        friction: Given | None = None,
    ) -> None:
        self.finger = taken(self, "finger", finger)
        self.surface = taken(self, "surface", surface)
        self.spin = taken(self, "spin", spin)
        self.line = taken(self, "line", line)
        self.friction = taken(self, "friction", friction)

    @property
    def axes(self) -> int:
        return 3

    @property
    def touched(self) -> int:
        return self.surface

    @property
    def rows(self) -> int:
        return 3 if self.spin == "free" else 4

    @property
    def slack(self) -> int:
        return 4

    def check(self, name: str, shapes: SurfacePair) -> None:
        for shape in shapes:
            if not isinstance(shape, AbstractSurface):
                raise ValueError(f"argument {name} must be between surfaces, but one was {shown(shape)}")
        self.check_shapes(name, shapes)

    def check_shapes(self, name: str, shapes: SurfacePair) -> None:
        for kind, shape in zip(("tip", "object"), shapes, strict=True):
            check_surface(f"{name}'s surface of the {kind}", shape)

    def form(self, shapes: SurfacePair) -> Place:
        tip, face = shapes
        return (0.0,) * tip.coordinates, (0.0,) * face.coordinates

    def touch(self, shapes: SurfacePair, place: Place) -> Touch3:
        return Touch3(*(shape.frame(at) for shape, at in zip(shapes, place, strict=True)))

    def pfaffian(self, bodies: tuple[Motion, Motion], touch: Touch3) -> tuple[Rows, Rows]:
        units = (bodies[0].unit_twists, bodies[1].unit_twists)
        # Three rows: the world components of the gap's rate. A fourth: n . (omega_A - omega_B) times the arm.
        columns = pfaffian(units, arms_of((bodies[0].pose, bodies[1].pose), touch.points))
        blocks = [row_wise(block, 3) for block in columns]
        if self.spin == "prevented":
            normal = bodies[1].pose.turn(touch.object.normal) * _ARM
            for i, sign in enumerate((1.0, -1.0)):
                blocks[i] += (tuple(normal.dot(unit.spin) * sign for unit in units[i]),)
        return once((blocks[0], blocks[1]))

    def gap_rate(self, poses: tuple[Pose3, Pose3], twists: tuple[Twist3, Twist3], touch: Touch3) -> Scalars:
        rate = tuple(gap_rate(twists, arms_of(poses, touch.points)))
        normal = poses[1].turn(touch.object.normal)
        return rate if self.spin == "free" else (*rate, _spin(twists, normal))

    def bias(
        self,
        shapes: SurfacePair,
        place: Place,
        bodies: tuple[Motion, Motion],
        *,
        touch: Touch3,
        rolling: Vec3,
    ) -> Scalars:
        arms = arms_of((bodies[0].pose, bodies[1].pose), touch.points)
        found = tuple(gap_bias(bodies, arms, (rolling, rolling)))
        if self.spin == "free":
            return found
        # The rate of n . (omega_A - omega_B), in which the normal turns with the object, omega_B x n, and as
        # the contact moves over it, L_B s.
        tip, body = bodies
        normal, bend = body.pose.turn(touch.object.normal), touch.object.shape.apply(body.pose.back(rolling))
        turning = body.twist.spin.cross(normal) + body.pose.turn(bend)
        twists, biases = (tip.twist, body.twist), (tip.bias, body.bias)
        return (*found, plus(_spin(biases, normal), _spin(twists, turning)))

    def rolling(
        self,
        shapes: SurfacePair,
        place: Place,
        bodies: tuple[Motion, Motion],
        *,
        touch: Touch3,
        bend: Sym3,
    ) -> Vec3:
        tip, body = bodies
        turning = tip.twist.spin - body.twist.spin
        return bend.apply(turning.cross(body.pose.turn(touch.object.normal)))

    def place_rate(
        self, shapes: SurfacePair, place: Place, poses: tuple[Pose3, Pose3], rolling: Vec3
    ) -> Place:
        return _carried_rates(shapes, place, (poses[0].back(rolling), poses[1].back(rolling)))

    def bend(self, shapes: SurfacePair, place: Place, poses: tuple[Pose3, Pose3], touch: Touch3) -> Sym3:
        return compliance(poses, touch, self.line)

    def unknown_bend(self) -> Sym3:
        return Sym3(*(0.0,) * 6)

    def gap(self, poses: tuple[Pose3, Pose3], touch: Touch3) -> Scalars:
        found = tuple(gap(*poses, touch.points))
        return found if self.spin == "free" else (*found, jnp.zeros_like(found[0]))

    def tangency(self, poses: tuple[Pose3, Pose3], touch: Touch3) -> Vec3:
        return tangency3(*poses, touch)

    def onto(self, shapes: SurfacePair, place: Place) -> Place:
        tip, face = (shape.settled(at) for shape, at in zip(shapes, place, strict=True))
        return tip, face

    def settled(
        self,
        shapes: SurfacePair,
        place: Place,
        turned: Vec3,
        *,
        poses: tuple[Pose3, Pose3],
        tangency: Vec3,
        bend: Sym3,
    ) -> Place:
        tip, body = poses
        normal = body.turn(shapes[1].frame(place[1]).normal)
        # n_A + n_B changes by (L_A + L_B) move - turned x n and is to become zero; `bend` is (L_A + L_B)^-1.
        move = bend.apply(turned.cross(normal) - tangency)
        return _carried(shapes, place, (tip.back(move), body.back(move)))

    def shift(self, shapes: SurfacePair, place: Place, step: Scalars) -> Place:
        moves = []
        for shape, at, (along, across) in zip(shapes, place, (step[:2], step[2:]), strict=True):
            first, second = tangents(shape.frame(at).normal)
            moves.append(first * along + second * across)
        carried = jax.tree.map(jnp.asarray, _carried(shapes, place, (moves[0], moves[1])))
        # After a long step one return to the surfaces leaves more than rounding.
        return jax.lax.fori_loop(0, _RETURNS, lambda _, place: self.onto(shapes, place), carried)

    def equations(self, poses: tuple[Pose3, Pose3], touch: Touch3) -> Scalars:
        tip, body = (
            pose.turn(n) for pose, n in zip(poses, (touch.tip.normal, touch.object.normal), strict=True)
        )
        # In the tangent plane of B the sum of the normals has the size sin(a), with a = 0 in contact. Scaled
        # it is 2 tan(a/2), which does not vanish again at a = pi, where the normals are alike.
        tilt = (tip + body) * (2.0 / (1.0 - tip.dot(body)))
        first, second = tangents(body)
        found = tuple(gap(*poses, touch.points))
        if not self.line:
            return (*found, tilt.dot(first), tilt.dot(second))
        # Along a common generator the normals do not turn, and no place changes that part of the tilt: only
        # the part across it is an equation. Its direction is the image of L_A + L_B, taken from whichever of
        # the two tangents has the larger one.
        bend = touch.tip.shape.turned(poses[0]) + touch.object.shape.turned(poses[1])
        one, other = bend.apply(first), bend.apply(second)
        steep = one.dot(first) > other.dot(second)
        across = jax.tree.map(lambda a, b: jnp.where(steep, a, b), one, other)
        return (*found, tilt.dot(across) / across.norm())

    def equation_names(self) -> tuple[str, ...]:
        gaps = ("x gap [m]", "y gap [m]", "z gap [m]")
        return (*gaps, "tangency [rad]") if self.line else (*gaps, "tangency [rad]", "tangency [rad]")

    def ends(self, shapes: SurfacePair, place: Place) -> list[Scalar]:
        each = zip(shapes, place, strict=True)
        return [margin for shape, at in each for margin in shape.margins(at)]

    def curvature_margin(
        self, shapes: SurfacePair, place: Place, poses: tuple[Pose3, Pose3], touch: Touch3
    ) -> Scalar:
        # Both eigenvalues of L_A + L_B have to be positive: their product, over |L_A|^2 + |L_B|^2, with a
        # minus where both are negative.
        tip, face = touch.tip.shape.turned(poses[0]), touch.object.shape.turned(poses[1])
        bend, size = tip + face, tip.squares() + face.squares()
        size = jnp.where(size > 0, size, 1.0)
        trace, minors = bend.trace(), bend.minors()
        if self.line:
            return trace / jnp.sqrt(size)
        return jnp.where(trace > 0, minors, -jnp.abs(minors)) / size

    @property
    def presses(self) -> bool:
        return True

    def split_force(self, poses: tuple[Pose3, Pose3], touch: Touch3, force: Scalars) -> tuple[Scalar, Vec3]:
        normal, push = poses[1].turn(touch.object.normal), Vec3(*force[:3])
        pressing = push.dot(normal)
        return pressing, normal * pressing - push

    def spin_torque(self, force: Scalars) -> Scalar | None:
        # The fourth row is n . (omega_A - omega_B) times the arm; its multiplier acts on the fingertip.
        return None if self.spin == "free" else -_ARM * force[3]

    def split_gap(self, poses: tuple[Pose3, Pose3], touch: Touch3, gap: Scalars) -> tuple[Scalar, Vec3]:
        normal, open_ = poses[1].turn(touch.object.normal), Vec3(*gap[:3])
        height = open_.dot(normal)
        return -height, open_ - normal * height

    def reported(self, tangency: Vec3) -> Vec3:
        return tangency

    def rubbing(self, tangential: Vec3) -> list[Scalar]:
        return [jnp.sqrt(tangential.dot(tangential) + _NO_FORCE)]


def _spin(twists: tuple[Twist3, Twist3], normal: Vec3) -> Scalar:
    """Spin of the fingertip against the object about a normal, times an arm [m/s]."""
    return normal.dot(twists[0].spin - twists[1].spin) * _ARM


def _carried_rates(shapes: SurfacePair, place: Place, velocities: tuple[Vec3, Vec3]) -> Place:
    """Rates of the coordinates on both surfaces, from tangent velocities, each in its own body's axes."""
    tip, face = (shape.rate(at, v) for shape, at, v in zip(shapes, place, velocities, strict=True))
    return tip, face


def _carried(shapes: SurfacePair, place: Place, moves: tuple[Vec3, Vec3]) -> Place:
    """The place after small tangent displacements [m], each in its own body's axes, to first order."""
    each = zip(place, _carried_rates(shapes, place, moves), strict=True)
    tip, face = (tuple(a + b for a, b in zip(at, step, strict=True)) for at, step in each)
    return tip, face


def tangency3(tip: Pose3, object_: Pose3, touch: Touch3) -> Vec3:
    """Sum of the two outward normals in the world: zero where the tangent planes coincide."""
    return tip.turn(touch.tip.normal) + object_.turn(touch.object.normal)
