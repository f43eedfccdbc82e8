"""Contours and surfaces of a user's own: each way in refuses one that breaks its contract, and no other."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._linalg._plane import Vec2
from jaxroll._linalg._space import Sym3, Vec3
from jaxroll._mechanics import tabled_grasp
from jaxroll.geometry import (
    _contract,
    AbstractChart,
    AbstractImplicit,
    Chart,
    check_contour,
    check_once_round,
    check_surface,
    differentiated,
    Extruded,
    frenet,
    Frenet2,
    Gauss3,
    Hollow,
    Implicit,
    Jet,
    jet,
    Level,
    level_frame,
    tabled,
)
from jaxroll.geometry._contract_errors import _field_errors


class Curve(jxr.AbstractContour):
    """A user's curve, given by a function of what should be its arclength."""

    function: callable = eqx.field(static=True)
    ends: tuple | None = eqx.field(static=True, default=None)
    closed: bool = eqx.field(static=True, default=False)
    bend: float = eqx.field(static=True, default=1.0)
    lean: float = eqx.field(static=True, default=0.0)
    aside: float = eqx.field(static=True, default=0.0)

    smoothness = float("inf")

    def curve(self, s):
        return Vec2(*self.function(s))

    def frame(self, s):
        found = frenet(self.curve, s)
        tangent = found.tangent + found.tangent.left() * self.lean
        point = Vec2(found.point.x + self.aside, found.point.y)
        return Frenet2(point, tangent, found.curvature * self.bend)

    def prepared(self):
        return self

    def domain(self):
        return self.ends


class Wrapped(jxr.AbstractContour):
    """A user's wrapper, which may run through what it wraps at another speed."""

    inner: jxr.AbstractContour
    speed: float = eqx.field(static=True, default=1.0)

    @property
    def closed(self):
        return self.inner.closed

    @property
    def smoothness(self):
        return self.inner.smoothness

    def curve(self, s):
        return self.inner.curve(s * self.speed)

    def frame(self, s):
        return self.inner.frame(s * self.speed)

    def prepared(self):
        return Wrapped(self.inner.prepared(), self.speed)

    def domain(self):
        ends = self.inner.domain()
        return None if ends is None else (ends[0] / self.speed, ends[1] / self.speed)


def parabola(s):
    return -50.0 * s * s, s


def circle(s):
    return 0.01 * jnp.cos(s / 0.01), 0.01 * jnp.sin(s / 0.01)


def wavy(s):
    """Of unit speed at the start, and nowhere else: there its fourth power is not seen."""
    return 1e4 * s**4, s


TURN = 2.0 * np.pi * 0.01
PARABOLA = Curve(parabola)
FAULTS = {
    "not at the start": (
        PARABOLA,
        0.01,
        "unit speed., but the speed of Curve there was 1.41",
    ),
    "not near the start": (
        Curve(wavy),
        0.0,
        "unit speed., but the speed of Curve at s = ",
    ),
    "not along the domain": (
        Curve(wavy, (-0.05, 0.05)),
        0.0,
        "unit speed., but the speed of Curve at s = ",
    ),
    "curvature": (Curve(circle, bend=1.0001), 0.0, "frame is that of its curve, but the curvature of Curve"),
    "sign of the curvature": (Curve(circle, bend=-1.0), 0.0, "but the curvature of Curve there was -100 1/m"),
    "tangent": (Curve(circle, lean=1e-6), 0.0, "frame is that of its curve, but the tangent of Curve"),
    "point": (
        Curve(circle, aside=1e-5),
        0.0,
        r"but the point of Curve there was \[0.01001, 0.0\] where the curve's is \[0.01, 0.0\]",
    ),
    "not closed": (Curve(circle, (0.0, 0.06), closed=True), 0.0, "comes back to itself where it claims"),
    "closed without ends": (Curve(circle, closed=True), 0.0, "with ends, as Curve claims to be closed"),
    "domain the wrong way": (
        Curve(circle, (1.0, 0.0)),
        0.5,
        r"domain rises, but that of Curve was \[1.0",
    ),
    "not finite": (
        Curve(lambda s: (0.0 * s, jnp.where(jnp.abs(s) > 0.004, jnp.nan, s)), (-0.01, 0.01)),
        0.0,
        "with finite points and derivatives, but those of Curve at s = ",
    ),
}


@pytest.mark.parametrize(
    ("member", "value", "words"),
    [
        (
            "curve",
            lambda self, s: jnp.stack(circle(s)),
            r"`curve` returns a geometry.Vec2, but that of Odd returned an array of shape \(2,\)",
        ),
        (
            "curve",
            lambda self, s: circle(s),
            "`curve` returns a geometry.Vec2, but that of Odd returned a tuple",
        ),
        (
            "curve",
            lambda self, s: Vec2(s[None], 0.0),
            r"returns two numbers, but one of Odd had shape \(1,\)",
        ),
        ("curve", lambda self, s: Vec2(np.cos(s), s), "computes with jax.numpy, but that of Odd asked for a"),
        (
            "curve",
            lambda self, s: Vec2(s if s > 0 else -s, s),
            "computes with jax.numpy, but that of Odd asked",
        ),
        ("closed", "yes", "`closed` is True or False, but that of Odd was a str"),
        ("smoothness", None, "`smoothness` is a number of derivatives, but that of Odd was a NoneType"),
    ],
)
def test_members_that_give_what_they_must_not_are_named(member, value, words):
    fields = {"__annotations__": {member: str}} if member == "closed" else {}
    odd = type("Odd", (Curve,), {member: value, **fields})(circle)
    with pytest.raises(ValueError, match=f"^argument tip must be a contour whose .*{words}"):
        check_contour("tip", odd)


@pytest.mark.parametrize("fault", FAULTS)
def test_what_breaks_the_contract_is_named(fault):
    contour, start, words = FAULTS[fault]
    with pytest.raises(ValueError, match=words) as caught:
        check_contour("tip", contour, start=start)
    text = str(caught.value)
    assert text.startswith("argument tip must lie on a contour ") and text.count(". ") == 0


def test_a_tip_that_ends_before_the_contact_is_told_its_ends_though_it_is_no_number_beyond(scene):
    grasp, state = scene
    tip = Curve(lambda s: (jnp.sqrt(s) * 0.0, s), (0.002, 0.02))
    words = r"^argument contacts\[0\].s_tip must lie between 0.002 and 0.02 m, but was "
    with pytest.raises(ValueError, match=words):
        grasp.with_tip(0, tip)
    contact = jxr.Contact(0.01, 0.003)
    jxr.residuals(grasp.with_contacts(contact).with_tip(0, tip), state)
    with pytest.raises(ValueError, match=words):
        grasp.with_contacts(contact).with_tip(0, tip).with_contacts(jxr.Contact(0.0, 0.003))


def ring(count=32):
    u = 2 * np.pi * np.arange(count) / count
    return np.stack([0.02 * np.cos(u), 0.014 * np.sin(u)], axis=-1)


GOOD = {
    "curve": Curve(circle),
    "closed curve": Curve(circle, (0.0, TURN), closed=True),
    "line": Wrapped(jxr.Line()),
    "arc": Wrapped(jxr.Catenary(0.01, (-0.03, 0.03))),
    "circle": Wrapped(jxr.Circle(0.01).moved((0.1, 0.2), 1.0)).moved(origin=0.01),
    "ellipse": Wrapped(jxr.Ellipse(0.02, 0.014)),
    "spline": Wrapped(jxr.Spline(ring(), cells=256)),
}


@pytest.mark.parametrize("name", GOOD)
def test_what_keeps_it_passes(name):
    check_contour("tip", GOOD[name], start=0.0)


@pytest.mark.parametrize("name", ["arc", "spline"])
def test_a_wrapper_that_runs_at_another_speed_is_refused(name):
    fast = Wrapped(GOOD[name].inner, 1.0 + 1e-4)
    with pytest.raises(ValueError, match=r"the speed of Wrapped at s = .* was 1.0001"):
        check_contour("tip", fast.moved().moved((0.1, 0.0)))


def ways_in(grasp, state):
    """Every door through which a contour comes into a grasp or a search for contacts."""
    bad, disc = PARABOLA.moved((0.0, -0.01), -np.pi / 2), jxr.Circle(0.01)
    short = Curve(parabola, (-0.01, 0.01))
    finger = jxr.Finger([0.1], [0.1], bad)
    body = jxr.FreeObject(disc, 0.1, 1e-5)
    return {
        "tip": lambda: jxr.Grasp(body, finger, jxr.Contact()),
        "tip moved twice": lambda: jxr.Grasp(body, jxr.Finger([0.1], [0.1], bad.moved()), jxr.Contact()),
        "object": lambda: jxr.Grasp(
            jxr.FreeObject([disc, bad], 0.1, 1e-5), jxr.Jaw(disc), jxr.Contact(contour=1)
        ),
        "jaw": lambda: jxr.Grasp(body, jxr.Jaw(bad), jxr.Contact()),
        "with_tip": lambda: jxr.close(grasp.with_tip(0, bad), state),
        "with_": lambda: jxr.simulate(grasp.with_(contours=(bad,)), state, 0.1),
        "changed behind the back": lambda: jxr.residuals(
            eqx.tree_at(lambda g: g.fingers[0].tip.contour, grasp, bad), state
        ),
        "tips of a scene": lambda: jxr.scenes.pinch(tips=PARABOLA),
        "contour of a scene": lambda: jxr.scenes.roller(Curve(circle, (0.0, 0.06), closed=True)),
        "locate": lambda: jxr.contact.locate(disc, short),
        "extruded": lambda: jxr.contact.locate_surfaces(jxr.Sphere(0.01), Hollow(Extruded(short)).moved()),
        "in space": lambda: jxr.Grasp(
            jxr.FreeObject3(jxr.Sphere(0.01), 0.1, 1e-5), jxr.Stage(Extruded(short)), jxr.Contact3()
        ),
    }


@pytest.mark.parametrize(
    "way",
    [
        "tip", "tip moved twice", "object", "jaw", "with_tip", "with_", "changed behind the back",
        "tips of a scene", "contour of a scene", "locate", "extruded", "in space",
    ],
)  # fmt: skip
def test_every_way_in_is_guarded(way, scene):
    with pytest.raises(ValueError, match=r"^argument .* must (lie on|be) a contour .*Curve"):
        ways_in(*scene)[way]()


def test_it_is_paid_for_once(scene):
    """The second call does not evaluate the contour, and traced numbers are left alone."""
    calls = []

    def counted(s):
        calls.append(s)
        return circle(s)

    contour = Curve(counted, (-0.02, 0.02))
    check_contour("tip", contour)
    seen = len(calls)
    check_contour("tip", contour)
    assert len(calls) == seen > 0
    jax.jit(lambda x: (check_contour("tip", Wrapped(jxr.Circle(x), 2.0)), x)[1])(0.01)


def test_a_contour_that_runs_round_twice_is_no_object(monkeypatch):
    """It comes back to itself, at unit speed: for a fingertip that will do."""
    twice = Curve(circle, (0.0, 2.0 * TURN), closed=True)
    grasp = jxr.Grasp(jxr.FreeObject(twice, 0.1, 1e-5), jxr.Jaw(twice), jxr.Contact())
    with pytest.raises(ValueError, match=r"^argument grasp.object must .* this Curve turned round 2 times"):
        tabled_grasp(grasp)
    check_once_round("object", GOOD["closed curve"].moved())
    # Where chords cross and the contour itself does not, a second look with shorter ones decides.
    turn = np.exp(2j * np.pi * np.arange(64) / 64)
    looks = {1: np.stack([turn.real, turn.imag * turn.real], -1), 8: np.stack([turn.real, turn.imag], -1)}
    monkeypatch.setattr(_contract, "_polygon", lambda contour, parts: looks[parts])
    check_once_round("object", Curve(circle, (0.0, TURN), closed=True))


class Ball(AbstractImplicit):
    """A user's ball of 10 mm, of which one part may be wrong."""

    wrong: str = eqx.field(static=True)

    smoothness = float("inf")

    def derivatives(self, point):
        square, one = point.dot(point), 2.0 if self.wrong != "hessian" else 1.0
        slope = point * (2.0 if self.wrong != "gradient" else 2.1)
        return Level(square - 1e-4, slope, Sym3(one, 0.0, 0.0, one, 0.0, one))

    def frame(self, at):
        point = Vec3(*at)
        found = level_frame(point, self.derivatives(point))
        if self.wrong == "shape":
            return Gauss3(point, found.normal, found.shape * 1.001)
        if self.wrong == "length":
            return Gauss3(point, found.normal * 1.0001, found.shape)
        if self.wrong == "inward":
            return Gauss3(point, -found.normal, found.shape * -1.0)
        return found

    def prepared(self):
        return self


class Bowl(AbstractChart):
    """A user's paraboloid with derivatives by hand."""

    wrong: float = eqx.field(static=True, default=1.0)
    periodic: tuple = eqx.field(static=True, default=(False, False))

    smoothness = float("inf")

    def derivatives(self, at):
        found = jet(lambda u, v: Vec3(u, v, 5.0 * (u * u + v * v)), at)
        return Jet(found.point, found.u, found.v, found.uu * self.wrong, found.uv, found.vv)

    def domain(self):
        return (-0.02, 0.02), (-0.02, 0.02)

    def prepared(self):
        return self


SURFACES = {
    "hessian": (Ball("hessian"), "second derivatives are those of its field"),
    "gradient": (Ball("gradient"), "gradient is that of its field"),
    "shape operator": (Ball("shape"), "shape operator is the derivative of its normal"),
    "length": (Ball("length"), "normal has length one"),
    "inward": (Ball("inward"), "normal is along its field's gradient"),
    "inside others": (Hollow(Ball("shape").moved((0.0, 0.0, 1.0))), "shape operator is the derivative"),
    "chart": (Bowl(1.001), "shape operator is the derivative of its normal"),
    "periodic": (
        Chart(lambda u, v: (u, v, u * u), domain=((0, 1), (0, 1)), periodic=(True, False)),
        "periodic",
    ),
}


@pytest.mark.parametrize("name", SURFACES)
def test_surfaces_are_checked_too(name):
    surface, words = SURFACES[name]
    with pytest.raises(ValueError, match=f"argument tip must be a surface .*{words}"):
        check_surface("tip", surface)


FIELDS = {
    "of NumPy": (lambda x, y, z: np.hypot(x, y) + z, "must compute with jax.numpy"),
    "with if": (lambda x, y, z: x if z > 0.0 else y, "must compute with jax.numpy"),
    "text": (lambda x, y, z: "x", ", in what it returns, must be a real number"),
    "nothing": (lambda x, y, z: None, ", in what it returns, must be a real number"),
    "complex": (lambda x, y, z: x + 1j * y, ", in what it returns, must be a real number"),
    "two numbers": (lambda x, y, z: jnp.stack([x, y]), r"must return one number, but returned shape \(2,\)"),
}


class Field(AbstractImplicit):
    """A user's body, whose derivatives are those of a field."""

    function: object

    smoothness = float("inf")

    def derivatives(self, point):
        return differentiated(self.function, point)

    def frame(self, at):
        return level_frame(Vec3(*at), self.derivatives(Vec3(*at)))


@pytest.mark.parametrize("name", FIELDS)
def test_fields_that_give_no_number_are_refused(name):
    field, words = FIELDS[name]
    with pytest.raises(ValueError, match=f"^argument function ?{words}"):
        Implicit(field)
    with pytest.raises(ValueError, match=f"^argument field ?{words}"):
        check_surface("tip", Field(field))


def test_a_field_takes_three_numbers():
    with pytest.raises(ValueError, match="^argument function must be a function, but was"):
        Implicit(lambda x, y: x)


@pytest.mark.parametrize(("off", "there"), [(1e-10, 1.0), (1e-7, 0.0)])
def test_a_place_beside_its_surface_says_nothing_of_it(off, there):
    """A ball of 10 mm: at a millionth of the distance from the origin a search has arrived."""
    at = tuple(jnp.asarray(x) for x in (0.01 + off, 0.0, 0.0))
    assert float(_field_errors(Ball("nothing"), at, Vec3(1.0, 0.0, 0.0))["there"]) == there


class Held(jxr.AbstractContour):
    """A user's wrapper that says nothing of tables."""

    parts: dict

    closed, smoothness = True, 4.0

    def curve(self, s):
        return self.parts["inner"].curve(s)

    def domain(self):
        return self.parts["inner"].domain()


def test_tables_of_shapes_inside_ones_own_are_built_once():
    spline = jxr.Spline(ring(), cells=256)
    held = Held({"inner": spline})
    ready = tabled(held)
    assert ready.parts["inner"].table is not None and tabled(held) is ready and tabled(ready) is ready
    assert held.prepared().parts["inner"].table is not None
    bar = Extruded(held.moved((0.1, 0.0))).moved((0.0, 0.1, 0.0))
    assert tabled(bar).surface.contour.contour.parts["inner"].table is not None
    np.testing.assert_allclose(held.curvature(0.01), spline.curvature(0.01), rtol=1e-6)
    with pytest.raises(ValueError, match="argument shape must be a contour or a surface, but was 3"):
        tabled(3)


def test_surfaces_that_keep_their_contract_pass():
    tube = Chart(
        lambda u, v: (0.01 * jnp.cos(u), 0.01 * jnp.sin(u), v),
        domain=((0.0, 2 * np.pi), (0.0, 0.1)),
        periodic=(True, False),
    )
    for surface in (Ball(""), Bowl(), tube, Hollow(Ball("")).moved((0.0, 0.1, 0.0)), Extruded(GOOD["curve"])):
        check_surface("tip", surface)
