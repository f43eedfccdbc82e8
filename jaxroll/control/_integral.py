r"""An integral term beside any law: what joint data tell of a task error comes to zero, whatever pushes.

Task errors $e_k$ are functions of the joint angles alone, as all that a blind controller knows. The term is
$-g_k z_k\, \partial e_k / \partial q$ with $\dot z_k = e_k$, as if a spring along $e_k$ had been drawn out
by its integral. There may be no more of them than the contacts leave directions free, and each must be moved
by one of these directions: an error that contacts hold fast would be integrated for ever, into forces
between the fingers (`_motion/_task_errors`).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._fields import each, taken, through
from .._linalg import root, sincos, total
from .._mechanics import AbstractController, Torques
from .._printing import listed, so_many
from .._results import as_floats, shown
from .._types import Given, Scalar, Scalars
from ._sensing import Sensed
from ._user import as_controller, as_law

# Value of a task error, and its derivative with respect to every joint angle, finger by finger.
Error = tuple[Scalar, Torques]
_ORIENTATION = "orientation_"


class Targets(eqx.Module):
    """Names of task errors, and the value from which each is measured [m or rad], in the order given."""

    __repr__ = listed

    values: tuple[Array, ...]
    names: tuple[str, ...] = eqx.field(static=True)


def _as_targets(name: str, value: Any) -> Targets:
    """Targets from a dict; `Targets` stay as they are."""
    if isinstance(value, Targets):
        return value
    if not isinstance(value, Mapping) or not value:
        raise ValueError(f"argument {name} must be a dict of names and numbers, but was {shown(value)}")
    for key in value:
        finger = key.removeprefix(_ORIENTATION) if isinstance(key, str) else ""
        if key not in _ERRORS and not (finger != key and finger.isdecimal()):
            known = (*_ERRORS, f"{_ORIENTATION}0", f"{_ORIENTATION}1 and so on")
            raise ValueError(f"argument {name} must have names among {known}, but had {shown(key)}")
    numbers = tuple(as_floats(f"{name}[{key!r}]", target, ()) for key, target in value.items())
    return Targets(numbers, tuple(value))


class Integral(AbstractController):
    r"""A law with an integral term, $u = u_{law} - \sum_k g_k z_k\, \partial e_k/\partial q$.

    Its memory holds the integrals, $\dot z_k = e_k$, zero at the start; they are integrated with the run,
    recorded as `states.memory` and differentiated. Where the closed loop is stable, every $e_k$ comes to
    zero, whatever constant load acts.

    Args:
        law: The controller beside which it stands, any that a grasp takes; None for none.
        targets: The value from which each task error is measured, by name: 'x', 'y', in space 'z': one
            coordinate of the mean of all tips' positions [m]; 'opening': distance of the tips of fingers 0
            and 1 [m]; 'tilt', in the plane: direction of the line from tip 0 to tip 1 [rad];
            'orientation_0', ...: sum of one finger's joint angles [rad], the $p_i$ of (17).
        gain: $g_k$ [N/(m s), N m/(rad s)], one for all or shape (errors,).

    Raises:
        ValueError: If a name or number is not what it must be. A grasp refuses more task errors than its
            contacts leave directions of motion free; `simulate` refuses those that are held fast at the
            start, since their integrals would wind up forces between the fingers.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> law = jxr.control.Integral(grasp.controller, {"y": 0.11}, 3.0)  # of its fingertip's height
        >>> run = jxr.simulate(grasp.with_(controller=law), state, 0.5)
        >>> run.states.memory.shape
        (301, 1)
    """

    law: Any = through(as_law)
    targets: Targets = through(_as_targets)
    gain: Float[Array, " errors"] = each()

    def __init__(self, law: Any, targets: Mapping[str, Given], gain: Given) -> None:
        self.law = taken(self, "law", law)
        self.targets = taken(self, "targets", targets)
        self.gain = taken(self, "gain", gain, shape=(len(self.errors),))

    def __check_init__(self) -> None:
        if self.gain.shape != (len(self.errors),):
            raise ValueError(
                f"argument targets must name as many errors as there are gains, {self.gain.shape[0]}, "
                f"but named {len(self.errors)}"
            )

    @property
    def errors(self) -> tuple[str, ...]:
        """Names of its task errors."""
        return self.targets.names

    def check(self, fingers: int, axes: int) -> None:
        law = as_controller(self.law)
        law.check(fingers, axes)
        for name in self.errors:
            finger = name.removeprefix(_ORIENTATION)
            needed = 2 if name in ("opening", "tilt") else 1
            needed = int(finger) + 1 if finger != name else needed
            if fingers < needed:
                raise ValueError(
                    f"argument targets must name what {so_many(fingers, 'finger')} can have, "
                    f"but had {shown(name)}"
                )
            if name == ("z" if axes == 2 else "tilt"):
                raise ValueError(
                    f"argument targets must name errors of a grasp of {axes} axes, but had {shown(name)}"
                )

    def check_freedoms(self, free: int) -> None:
        # The errors of an integral term inside need directions of their own.
        as_controller(self.law).check_freedoms(free - len(self.errors))
        if len(self.errors) > free:
            raise ValueError(
                f"argument targets must name at most {free} errors, as contacts leave directions free, "
                f"for more would wind up forces between the fingers, but named {len(self.errors)}"
            )

    def initial_memory(self, joints: tuple[int, ...]) -> Float[Array, " k"]:
        own, inner = jnp.zeros(len(self.errors)), as_controller(self.law).initial_memory(joints)
        return own if inner is None else jnp.concatenate([inner, own.astype(inner.dtype)])

    def torques(self, t: Scalar, fingers: Sequence[Sensed]) -> Torques:
        return as_controller(self.law).torques(t, fingers)

    def driven(self, t: Scalar, fingers: Sequence[Sensed], memory: Scalars) -> tuple[Torques, Scalars]:
        count = len(memory) - len(self.errors)
        torques, rates = as_controller(self.law).driven(t, fingers, memory[:count] if memory else ())
        return self._beside(torques, fingers, memory[count:] if memory else None, rates)

    def stepped(
        self, t: Scalar, fingers: Sequence[Sensed], memory: Scalars, period: Scalar
    ) -> tuple[Torques, Scalars]:
        count = len(memory) - len(self.errors)
        torques, later = as_controller(self.law).stepped(t, fingers, memory[:count], period)
        integrals = memory[count:]
        torques, both = self._beside(torques, fingers, integrals, later)
        errors = both[count:]
        return torques, (*later, *(z + period * e for z, e in zip(integrals, errors, strict=True)))

    def _beside(
        self, torques: Torques, fingers: Sequence[Sensed], integrals: Scalars | None, rates: Scalars
    ) -> tuple[Torques, Scalars]:
        """Torques with the integral terms added, and the errors after other rates."""
        values, slopes = zip(*self.measured(fingers), strict=True)
        if integrals is None:
            return torques, (*rates, *values)
        pulls = [self.gain[k] * z for k, z in enumerate(integrals)]
        each = list(zip(pulls, slopes, strict=True))
        torques = tuple(
            tuple(u - total([pull * slope[i][j] for pull, slope in each]) for j, u in enumerate(us))
            for i, us in enumerate(torques)
        )
        return torques, (*rates, *values)

    def measured(self, fingers: Sequence[Sensed]) -> list[Error]:
        """Every task error and its derivative."""
        each = zip(self.errors, self.targets.values, strict=True)
        return [_error(name, target, fingers) for name, target in each]

    def potential(self, tips: Sequence[Any], angles: Sequence[Scalars]) -> Scalar:
        # The law's own. What the integral term does counts as work.
        return as_controller(self.law).potential(tips, angles)


def _error(name: str, target: Scalar, fingers: Sequence[Sensed]) -> Error:
    """One task error and its derivative with respect to all joint angles."""
    if name in _ERRORS:
        return _ERRORS[name](target, fingers)
    which = int(name.removeprefix(_ORIENTATION))
    here = lambda i, finger: (jnp.asarray(float(i == which)),) * len(finger.angles)  # noqa: E731
    return total(fingers[which].angles) - target, tuple(here(i, f) for i, f in enumerate(fingers))


def _mean(axis: str) -> Any:
    """The error of one coordinate of the mean of all tips' positions."""

    def error(target: Scalar, fingers: Sequence[Sensed]) -> Error:
        share = 1.0 / len(fingers)
        slopes = tuple(tuple(share * getattr(u.velocity, axis) for u in f.unit_twists) for f in fingers)
        return share * total([getattr(f.tip, axis) for f in fingers]) - target, slopes

    return error


def _pair(fingers: Sequence[Sensed], along: Any) -> Torques:
    """Derivative of a function of the line from tip 0 to tip 1, whose gradient is `along`."""
    signs = (-1.0, 1.0)
    moved = [tuple(signs[i] * u.velocity.dot(along) for u in fingers[i].unit_twists) for i in (0, 1)]
    rest = [(jnp.zeros_like(along.x),) * len(f.angles) for f in fingers[2:]]
    return (*moved, *rest)


def _opening(target: Scalar, fingers: Sequence[Sensed]) -> Error:
    line = fingers[1].tip - fingers[0].tip
    length = root(line.dot(line))
    return length - target, _pair(fingers, line * (1.0 / length))


def _tilt(target: Scalar, fingers: Sequence[Sensed]) -> Error:
    line = fingers[1].tip - fingers[0].tip
    # The angle from the target's direction d, which jumps only opposite to it. Its gradient is the line
    # turned by a right angle, over its squared length.
    sine, cosine = sincos(target)
    d = type(line)(cosine, sine)
    across = line.left() * (1.0 / line.dot(line))
    return jnp.arctan2(d.cross(line), d.dot(line)), _pair(fingers, across)


_ERRORS = {"x": _mean("x"), "y": _mean("y"), "z": _mean("z"), "opening": _opening, "tilt": _tilt}
