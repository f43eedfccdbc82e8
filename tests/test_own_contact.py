"""A contact by its gap alone: its derivatives against the closed forms, and contacts of one's own in use."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxroll as jxr
from jaxroll._mechanics import to_leaves
from jaxroll._motion import bodies, check_rolling
from jaxroll.contact import AbstractContact
from jaxroll.contact._from_gap import derived_bias, derived_margin
from jaxroll.plotting._panels import _rolled, panels
from tests.recorded import runs

# What `Contact` and `Contact3` give in closed form, and the base class derives.
_DERIVED = ("gap_rate", "pfaffian", "rolling", "place_rate", "bias", "bend", "unknown_bend", "settled")


class DerivedContact(jxr.Contact):
    """A contact of contours by its gap and tangency alone."""


class DerivedContact3(jxr.Contact3):
    """A contact of surfaces by its gap and tangency alone."""


for _name in _DERIVED:
    setattr(DerivedContact, _name, getattr(AbstractContact, _name))
    setattr(DerivedContact3, _name, getattr(AbstractContact, _name))


def _derived(grasp: jxr.Grasp) -> jxr.Grasp:
    """The grasp with contacts that derive everything."""
    kind = DerivedContact3 if grasp.spatial else DerivedContact
    fields = [{f.name: getattr(c, f.name) for f in dataclasses.fields(c)} for c in grasp.contacts]
    return grasp.with_contacts(*(kind(**given) for given in fields))


@eqx.filter_jit
def _moving(grasp: jxr.Grasp, state: jxr.State) -> list[Any]:
    """Of each contact at one state: both shapes, its place, and how both bodies move."""
    ready = grasp.prepared()
    leaves = to_leaves(state, ready.form)
    motions, _ = bodies(ready, leaves)
    each = zip(ready.contacts, leaves.s, strict=True)
    return [(ready.shapes(c), place, (motions[1 + c.finger], motions[0])) for c, place in each]


@eqx.filter_jit
def _kinematics(contact: Any, shapes: Any, place: Any, pair: Any) -> dict[str, Any]:
    """What a contact gives: one program for all of one kind."""
    poses, twists = (pair[0].pose, pair[1].pose), (pair[0].twist, pair[1].twist)
    touch = contact.touch(shapes, place)
    bend, tangency = contact.bend(shapes, place, poses, touch), contact.tangency(poses, touch)
    rolling = contact.rolling(shapes, place, pair, touch=touch, bend=bend)
    turned = jax.tree.map(lambda x: 1e-9 * x, twists[0].spin)
    settled = contact.settled(shapes, place, turned, poses=poses, tangency=tangency, bend=bend)
    return {
        "gap_rate": contact.gap_rate(poses, twists, touch),
        "pfaffian": contact.pfaffian(pair, touch),
        "place_rate": contact.place_rate(shapes, place, poses, rolling),
        "bias": contact.bias(shapes, place, pair, touch=touch, rolling=rolling),
        "settled": jax.tree.map(lambda new, old: new - old, settled, place),
    }


def _anywhere(contact: Any) -> Any:
    """A contact that does not say between which shapes it is, which nothing in `_kinematics` asks."""
    face = "surface" if isinstance(contact, jxr.Contact3) else "contour"
    return dataclasses.replace(contact, **{"finger": 0, face: 0})


def _numbers(tree: Any) -> np.ndarray:
    return np.array([float(x) for x in jax.tree.leaves(tree)])


def test_a_margin_is_the_sine_between_the_directions_of_the_place() -> None:
    # A place of two numbers, of which what touches, its tangencies and its gap are linear functions.
    rng = np.random.default_rng(5)
    touch, tangency, gap = (rng.normal(size=shape) for shape in ((5, 2), (2, 5), (1, 5)))
    touch[:, 1] *= 0.3

    def times(matrix: np.ndarray, numbers: Any) -> tuple[Any, ...]:
        return tuple(sum(a * x for a, x in zip(row, numbers, strict=True)) for row in matrix)

    contact = SimpleNamespace(
        slack=2,
        shift=lambda shapes, place, step: tuple(a + b for a, b in zip(place, step, strict=True)),
        touch=lambda shapes, place: times(touch, place),
        tangency=lambda poses, touch: times(tangency, touch),
        gap=lambda poses, touch: times(gap, touch),
    )
    margin = jax.jit(lambda place: derived_margin(contact, (None, None), place, (None, None)))
    found = margin((0.3, -0.7))
    # A direction's length if none of its terms cancelled: of the tangencies all sizes together, the largest
    # of which is one, and of the gap as it is. Its part across the others is what determines the place.
    sizes = (np.abs(tangency) @ np.abs(touch)).sum(axis=0)
    weight = 1.0 / sizes.max()
    columns = np.concatenate([weight * tangency @ touch, gap @ touch])
    columns = columns / np.hypot(weight * sizes, (gap @ touch)[0])
    wanted = np.abs(np.diag(np.linalg.qr(columns)[1])).min()
    assert wanted < 0.9 and np.ptp(sizes) > 0.1 * sizes.max()
    np.testing.assert_allclose(found, wanted, rtol=1e-12)


@pytest.mark.parametrize("name", ["pivoted", "pinch", "pinch3d"])
def test_derivatives_from_the_gap_are_the_closed_forms(name: str) -> None:
    grasp, state = runs.scene(name)
    thrown = jxr.State(state.q, np.random.default_rng(3).normal(size=state.v.shape), state.s)
    each = zip(_derived(grasp).contacts, grasp.contacts, _moving(grasp, thrown), strict=True)
    for derived, closed, at in each:
        derived, closed = (_kinematics(_anywhere(contact), *at) for contact in (derived, closed))
        for part, wanted in closed.items():
            found, wanted = _numbers(derived[part]), _numbers(wanted)
            # The place changes by 1e-9 of what it is, and rounds at its own size.
            allowed = 1e-17 if part == "settled" else 1e-13 * np.abs(wanted).max()
            assert np.any(wanted)
            np.testing.assert_allclose(found, wanted, rtol=0, atol=allowed, err_msg=part)


def test_the_bias_of_prevented_spin_is_the_rate_of_its_row() -> None:
    """All four rows of a contact that holds the spin too: their rates, differentiated along the motion."""
    grasp, state = runs.scene("pinch3d")
    ready = grasp.with_contacts(*(jxr.Contact3(i, i, spin="prevented") for i in range(2))).prepared()
    thrown = np.random.default_rng(3).normal(size=state.v.shape)
    leaves = to_leaves(jxr.State(state.q, thrown, state.s), ready.form)
    motions, _ = bodies(ready, leaves)
    contact = _anywhere(ready.contacts[0])

    @jax.jit
    def both(shapes: Any, place: Any, pair: Any) -> Any:
        touch = contact.touch(shapes, place)
        bend = contact.bend(shapes, place, (pair[0].pose, pair[1].pose), touch)
        rolling = contact.rolling(shapes, place, pair, touch=touch, bend=bend)
        derived = derived_bias(contact, shapes, place, pair, touch=touch, rolling=rolling)
        return contact.bias(shapes, place, pair, touch=touch, rolling=rolling), derived

    for at, place in zip(ready.contacts, leaves.s, strict=True):
        found = both(ready.shapes(at), place, (motions[1 + at.finger], motions[0]))
        bias, wanted = map(_numbers, found)
        assert len(bias) == 4 and np.all(wanted != 0.0)
        np.testing.assert_allclose(bias, wanted, rtol=0, atol=1e-13 * np.abs(wanted).max())


def test_a_run_from_the_gap_alone_is_the_same() -> None:
    grasp, state = runs.scene("pivoted")
    # Recorded as most runs of this scene are: for these there is a program.
    closed = jxr.simulate(grasp, state, 1.0, rtol=1e-9, record=("multipliers", "energy"))
    derived = jxr.simulate(_derived(grasp), state, 1.0, rtol=1e-9)
    np.testing.assert_allclose(derived.states.q, closed.states.q, rtol=0, atol=1e-13)
    np.testing.assert_allclose(derived.states.s, closed.states.s, rtol=0, atol=1e-15)


class Teeth(jxr.AbstractContact):
    """Two wheels with teeth: their pitch circles roll, and the teeth hold what lies along the tangent."""

    finger: int = 0
    friction: None = None
    rows = 1

    def touch(self, shapes: Any, place: Any) -> Any:
        pinion, wheel = shapes
        return pinion.frame(place), wheel.frame(-place)

    def gap(self, poses: Any, touch: Any) -> Any:
        (pinion, wheel), (tip, face) = poses, touch
        apart = pinion.place(tip.point) - wheel.place(face.point)
        return (apart.dot(wheel.turn(face.tangent)),)

    def tangency(self, poses: Any, touch: Any) -> Any:
        (pinion, wheel), (tip, face) = poses, touch
        return pinion.turn(tip.tangent).cross(wheel.turn(face.tangent))


class Belt(jxr.AbstractContact):
    """A belt that is wound on two pulleys without slipping; its straight strand can only pull."""

    length: jax.Array
    finger: int = 0
    friction: None = None
    rows = 1
    slack = 2
    presses = True

    def form(self, shapes: Any) -> Any:
        return 0.0, 0.0

    def touch(self, shapes: Any, place: Any) -> Any:
        tip, face = (shape.frame(s) for shape, s in zip(shapes, place, strict=True))
        return tip, face, place

    def _strand(self, poses: Any, touch: Any) -> Any:
        (pulley, wheel), (tip, face, _) = poses, touch
        return pulley.place(tip.point) - wheel.place(face.point)

    def gap(self, poses: Any, touch: Any) -> Any:
        _, face, (on_tip, on_face) = touch
        # Wound off the wheel up to its point, straight, and from the pulley's point on wound on it.
        straight = self._strand(poses, touch).dot(poses[1].turn(face.tangent))
        return (self.length - (on_face + straight - on_tip),)

    def tangency(self, poses: Any, touch: Any) -> Any:
        (pulley, wheel), (tip, face, _), strand = poses, touch, self._strand(poses, touch)
        return strand.cross(pulley.turn(tip.tangent)), strand.cross(wheel.turn(face.tangent))


class Pin(jxr.AbstractContact):
    """A hinge between the tips' origins: no place at all."""

    finger: int = 0
    friction: None = None
    rows = 2
    slack = 0

    def form(self, shapes: Any) -> Any:
        return ()

    def touch(self, shapes: Any, place: Any) -> Any:
        return ()

    def gap(self, poses: Any, touch: Any) -> Any:
        return tuple(poses[0].origin - poses[1].origin)

    def tangency(self, poses: Any, touch: Any) -> Any:
        return ()


_SMALL, _LARGE, _MASS, _INERTIA, _TORQUE = 0.01, 0.03, 0.05, 1e-4, 1e-3


def _twist(t: Any, angles: Any, rates: Any, tips: Any) -> list[Any]:
    return [jnp.stack([_TORQUE * jnp.cos(3.0 * t)])]


def _two_wheels(
    contact: Any, distance: float, angle: float, *, s: Any = (0.0,)
) -> tuple[jxr.Grasp, jxr.State]:
    """A wheel driven by one on a joint at this distance, whose link of 20 mm carries it about the joint."""
    tip = jxr.Circle(_SMALL).moved((-0.02, 0.0), angle)
    finger = jxr.Finger([0.02], [_MASS], tip, base=(distance, 0.0))
    wheel = jxr.PivotedObject(jxr.Circle(_LARGE), _INERTIA)
    grasp = jxr.Grasp(wheel, finger, contact, controller=_twist)
    return jxr.close(grasp, jxr.State([0.0] * 2, [0.0] * 2, s), hold_contacts=False)


def _driver_angle(t: Any, ratio: float) -> np.ndarray:
    """The driver's angle [rad] from rest: one freedom, with the inertia of both wheels seen from there."""
    inertia = _MASS * 0.02**2 / 3.0 + _INERTIA * ratio**2
    return _TORQUE * (1.0 - np.cos(3.0 * np.asarray(t))) / 9.0 / inertia


@pytest.fixture(scope="module")
def teeth() -> tuple[jxr.Grasp, jxr.State]:
    return _two_wheels(Teeth(), _SMALL + _LARGE, np.pi)


@pytest.fixture(scope="module")
def turning(teeth: Any) -> jxr.Trajectory:
    return jxr.simulate(*teeth, 3.0, rtol=1e-9, record=("multipliers", "energy"))


def test_teeth_turn_by_their_ratio_and_report_no_friction(teeth: Any, turning: Any) -> None:
    run = turning
    driver = _driver_angle(run.ts, _SMALL / _LARGE)
    np.testing.assert_allclose(run.states.q[:, 1], driver, atol=1e-11)
    np.testing.assert_allclose(run.states.q[:, 0], -driver / 3.0, atol=1e-11)
    np.testing.assert_allclose(run.states.s[:, 0], -_SMALL * driver, atol=1e-13)
    # The force of the teeth accelerates the wheel: r f = I alpha, whichever way it points.
    wheel = -_TORQUE * np.cos(3.0 * np.asarray(run.ts)) * (_SMALL / _LARGE)
    wheel *= _INERTIA / (_MASS * 0.02**2 / 3.0 + _INERTIA / 9.0)
    np.testing.assert_allclose(np.abs(run.multipliers.f[:, 0]) * _LARGE, np.abs(wheel), atol=1e-12)
    assert np.min(run.multipliers.f) < 0 < np.max(run.multipliers.f)
    assert np.max(np.abs(run.energy.residual)) < 1e-14
    assert "no contact can only press" in str(run)
    assert float(np.max(np.abs(run.residuals.normal))) < 1e-15
    # Where its end alone is traced, contact and start are known, and checked.
    assert jax.eval_shape(lambda t1: jxr.simulate(*teeth, t1, ts=1, throw=False).last.q, 0.1).shape == (2,)
    # Pictures of it have no tangential force or gap either.
    titles = [panel.title for panel in panels(teeth[0], run)]
    assert any("Normal force" in title for title in titles) and not any("angential" in t for t in titles)


def _end_of(inertia: Any, t: float) -> Any:
    """The driver's angle [rad] where the wheel has another inertia."""
    whole = _MASS * 0.02**2 / 3.0 + inertia / 9.0
    return _TORQUE * (1.0 - np.cos(3.0 * t)) / 9.0 / whole


def test_teeth_in_a_gradient() -> None:
    """Of a wheel that a rack turns, by one force: the smallest grasp with such a contact."""
    rack = jxr.Jaw(jxr.Line(), _MASS, [0.0], angle=0.5 * np.pi, base=(0.0, -_LARGE))
    wheel = jxr.PivotedObject(jxr.Circle(_LARGE), _INERTIA)
    grasp = jxr.Grasp(wheel, rack, Teeth(), controller=_twist)
    state = jxr.State([-0.5 * np.pi, 0.0], [0.0, 0.0], [0.0])

    def end(inertia: Any) -> Any:
        return jxr.simulate(grasp.with_(inertia=inertia), state, 1.0, ts=1, max_steps=256).last.q[1]

    given = np.linspace(0.5e-4, 2e-4, 4)
    both = jax.jit(jax.value_and_grad(end))
    ends, slopes = np.array([both(inertia) for inertia in given]).T
    # F cos(3 t) accelerates the mass m + I / R^2, whose derivative in I is 1 / R^2.
    whole = _MASS + given / _LARGE**2
    wanted = _TORQUE * (1.0 - np.cos(3.0)) / 9.0 / whole
    np.testing.assert_allclose(ends, wanted, rtol=1e-8)
    np.testing.assert_allclose(slopes, -wanted / whole / _LARGE**2, rtol=1e-8)


def test_a_belt_turns_both_pulleys_alike_and_slackens() -> None:
    # Both pulleys turn the same way, by equal lengths of belt, while the torque pulls: until cos 3t is zero.
    distance = 0.08
    # The strand leaves both where their normals have this angle from the line of centres.
    angle = -float(np.arccos((_LARGE - _SMALL) / distance))
    straight = float(np.sqrt(distance**2 - (_LARGE - _SMALL) ** 2))
    belt = Belt(jnp.asarray(_LARGE * angle + straight))
    grasp, state = _two_wheels(belt, distance, angle, s=(0.0, _LARGE * angle))
    run = jxr.simulate(grasp, state, 3.0, rtol=1e-9, throw=False, record=("multipliers",))
    assert run.result == jxr.RESULTS.contact_lost
    np.testing.assert_allclose(run.stats.t_end, np.pi / 6.0, rtol=1e-9)
    turned = np.asarray(run.last.q - state.q)
    np.testing.assert_allclose(turned[1], _driver_angle(run.stats.t_end, 1.0 / 3.0), rtol=1e-9)
    np.testing.assert_allclose(turned[0], turned[1] / 3.0, rtol=1e-12)
    wound = np.asarray(run.last.s - state.s)
    np.testing.assert_allclose(wound, [-_SMALL * turned[1], -_LARGE * turned[0]], rtol=1e-12)


def test_a_pin_has_no_place() -> None:
    # Two rods of equal length from one base, their ends pinned to a disc's centre, fall as a pendulum does
    # that has the disc's weight and theirs: here one link of the finger is the pendulum.
    finger = jxr.Finger([0.1], [0.0003], jxr.Circle(0.01))
    grasp = jxr.Grasp(jxr.FreeObject(jxr.Circle(0.02), 0.2, 1e-4), finger, Pin(), gravity=(0.0, -9.81))
    grasp, state = jxr.close(grasp, jxr.State([0.1, 0.0, 0.0, 0.0], [0.0] * 4, np.zeros(0)))
    run = jxr.simulate(grasp, state, 0.3, ts=4, record=("energy",))
    assert run.states.s.shape == (4, 0) and "rolled" not in str(run)
    assert jxr.plotting.responses(grasp, run).axes[0].get_title(loc="left") == "Rate of joint 1"
    np.testing.assert_allclose(run.energy.residual, 0.0, atol=1e-8)

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        # I phi'' = -g cos(phi) (m L + m_rod L / 2) with I = m L^2 + m_rod L^2 / 3; the disc does not turn.
        inertia, arm = 0.2 * 0.01 + 0.0003 * 0.01 / 3.0, 0.2 * 0.1 + 0.0003 * 0.05
        return np.array([y[1], -9.81 * arm * np.cos(y[0]) / inertia])

    wanted = solve_ivp(rate, (0.0, 0.3), [0.0, 0.0], rtol=1e-11, atol=1e-12).y[0, -1]
    np.testing.assert_allclose(run.last.q[3], wanted, rtol=1e-7)
    np.testing.assert_allclose(run.last.q[2], 0.0, atol=1e-12)


class Slipping(Teeth):
    """Teeth whose place runs the wrong way along the wheel."""

    def touch(self, shapes: Any, place: Any) -> Any:
        pinion, wheel = shapes
        return pinion.frame(place), wheel.frame(place)


def test_teeth_in_a_batch_and_those_of_wheels_that_do_not_fit_are_a_code_of_the_run(teeth: Any) -> None:
    """Rows would be the gap's rate at a frozen place, where the gap changes with the place: wrong by 3 %."""
    grasp, state = teeth

    def run(radius: Any, inertia: Any) -> Any:
        tip = jxr.Circle(radius).moved((-0.02, 0.0), np.pi)
        whole = grasp.with_tip(0, tip).with_(inertia=inertia)
        return jxr.simulate(whole, state, 1.0, ts=2, throw=False)  # a start that any radius closes

    radii, inertias = _SMALL * np.array([0.99, 1.0, 1.0, 1.01, 1.0]), np.linspace(0.5e-4, 2e-4, 5)
    found, fits = jax.vmap(run)(jnp.asarray(radii), jnp.asarray(inertias)), radii == _SMALL
    assert repr(found.result) == "[not_rolling, successful, successful, not_rolling, successful]"
    np.testing.assert_array_equal(found.stats.contact, [0, -1, -1, 0, -1])
    driver = np.asarray(found.last.q)[:, 1]
    np.testing.assert_allclose(driver[fits], _end_of(inertias[fits], 1.0), rtol=1e-8)
    # A pinion whose joint is beside its centre fits at the start, and not later.
    beside = 0.002
    lean, radius = np.arctan2(beside, _SMALL + _LARGE), np.hypot(beside, _SMALL + _LARGE) - _LARGE
    eccentric = grasp.with_tip(0, jxr.Circle(radius).moved((-0.02, beside), np.pi))
    start = jxr.State([lean + radius * lean / _LARGE, 0.0], [0.0, 0.0], [radius * lean])
    with pytest.raises(RuntimeError, match=r"The gap of contact 0 .* changes as its place alone moves"):
        jxr.simulate(eccentric, start, 3.0, rtol=1e-9, record=("multipliers", "energy"))


class TwoRows(Teeth):
    """Teeth that give one gap and claim two."""

    rows = 2


class TwoDirections(Teeth):
    """Teeth whose place has one number, and claims two."""

    slack = 2


class NoTangency(Teeth):
    """Teeth whose place nothing determines."""

    def tangency(self, poses: Any, touch: Any) -> Any:
        return ()


# What a contact of surfaces is by itself: its place, its gap and its tangency.
_BARE = ("axes", "touched", "rows", "slack", "form", "touch", "gap", "tangency", "onto", "shift")
_BARE = {name: vars(jxr.Contact3)[name] for name in (*_BARE, "equations", "equation_names")}


def test_an_own_contact_of_surfaces_rolls_though_its_gap_takes_part_in_that() -> None:
    """Its place has four numbers and its tangency three: the gap changes as either point alone moves."""
    fields = {"__annotations__": {"finger": int, "surface": int, "friction": Any}, "friction": None}
    kind = type("Surfaces", (jxr.AbstractContact,), {**_BARE, **fields, "spin": "free", "line": False})
    grasp, state = runs.scene("pinch3d")
    own = grasp.with_contacts(*(kind(c.finger, c.surface) for c in grasp.contacts))
    assert own.own_contacts == (0, 1)
    check_rolling(own, state)


def test_own_contacts_that_do_not_fit_are_refused(teeth: Any) -> None:
    grasp, state = teeth
    with pytest.raises(ValueError, match=r"contacts\[0\] must have a gap that rests .* changes by 1 of its"):
        jxr.simulate(grasp.with_contacts(Slipping()), state, 1.0)
    with pytest.raises(ValueError, match=r"contacts\[0\] must have 2 gaps, its `rows`, but had 1"):
        grasp.with_contacts(TwoRows())
    with pytest.raises(ValueError, match="but of a TwoDirections they were 2 and 1"):
        grasp.with_contacts(TwoDirections())
    with pytest.raises(ValueError, match="a tangency for each of 1 directions of its place, but had 0"):
        grasp.with_contacts(NoTangency())
    with pytest.raises(
        ValueError, match=r"must have contacts of class Contact, but contacts\[0\] was a Teeth"
    ):
        jxr.stability.assess(grasp, state)
    with pytest.raises(ValueError, match="locate must be False for contacts of one's own"):
        jxr.close(grasp, state, locate=True)


@pytest.mark.parametrize(
    ("member", "value", "words"),
    [
        ("friction", -0.5, r"contacts\[0\].friction must be positive, but was -0.5"),
        ("friction", float("nan"), r"contacts\[0\].friction must be finite, but was nan"),
        ("friction", (1.0, 2.0), r"contacts\[0\].friction must have shape \(\)"),
        ("finger", "0", r"contacts\[0\].finger must be a whole number of at least 0, but was '0'"),
        ("finger", 0.0, r"contacts\[0\].finger must be a whole number"),
        ("rows", "1", r"contacts\[0\].rows must be a whole number of at least 1, but was '1'"),
        ("gap", lambda *given: Teeth.gap(*given)[0], r"contacts\[0\] must give its gaps as a tuple"),
        ("gap", lambda *given: ("a",), r"contacts\[0\], in its gap, must be a real number"),
        ("tangency", lambda *given: 1j * Teeth.tangency(*given), "in its tangency, must be a real number"),
        ("tangency", lambda *given: (Teeth.tangency(*given),) * 2, "for each of 1 directions .* had 2"),
        (
            "tangency",
            lambda *given: float(Teeth.tangency(*given)),
            r"contacts\[0\] must compute with jax.numpy",
        ),
    ],
)
def test_members_of_own_contacts_that_are_none_are_refused_by_name(
    teeth: Any, member: str, value: Any, words: str
) -> None:
    grasp, _ = teeth
    fields = {"__annotations__": {member: Any}} if member in ("friction", "finger") else {}
    contact = type("Odd", (Teeth,), {member: value, **fields})()
    with pytest.raises(ValueError, match=f"^argument .*{words}"):
        grasp.with_contacts(contact)


def test_places_of_own_contacts_stand_apart_under_their_own_names() -> None:
    """Columns of states were taken for one rolling coordinate [mm] of each contact in turn."""
    finger = jxr.Finger([0.1], [0.01], jxr.Circle(0.01))
    contacts = [Pin(), jxr.Contact(), Belt(jnp.asarray(1.0)), Teeth()]
    grasp = jxr.Grasp(jxr.FreeObject(jxr.Circle(0.02), 0.2, 1e-4), finger, contacts)
    run: Any = SimpleNamespace(states=SimpleNamespace(s=np.arange(8.0).reshape(2, 4)))
    rolled, others = _rolled(grasp, run, ("a", "b", "c", "d"))
    assert (rolled.names, rolled.label) == (("b",), r"$\sigma$ [mm]")
    assert (others.names, others.label) == (("c, 1", "c, 2", "d"), "place")
    np.testing.assert_array_equal(rolled.values, [[0.0], [4e3]])
    np.testing.assert_array_equal(others.values, [[1.0, 2.0, 3.0], [5.0, 6.0, 7.0]])


def test_own_contacts_are_drawn_and_explained(teeth: Any, turning: Any, tmp_path: Path) -> None:
    grasp, run = teeth[0], turning
    jxr.plotting.poses(grasp, run)
    jxr.plotting.animate(grasp, run, tmp_path / "teeth.gif", fps=5.0, until=1.0, size=3.0)
    told = str(jxr.why(grasp, run))
    assert "holds both ways" in told
    assert "rest      not assessed: verdicts are of contacts of class Contact, in the plane" in told
