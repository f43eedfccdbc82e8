"""Parts of the check of a caller's own shapes: what is measured, and what is let pass on either side."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._results import is_foreign
from jaxroll.geometry import (
    _contract as contract,
    _contract_errors as contract_errors,
    Chart,
    Extruded,
    Frenet2,
    Hollow,
    Vec2,
)
from jaxroll.geometry.contours import Table
from tests.helpers import in_single

TURN = 2.0 * np.pi


class Bend(jxr.AbstractContour):
    """A circle of 10 mm off the origin, of which each part may be wrong by a little."""

    fast: float = eqx.field(static=True, default=0.0)
    lean: float = eqx.field(static=True, default=0.0)
    bend: float = eqx.field(static=True, default=0.0)
    aside: float = eqx.field(static=True, default=0.0)
    ends: tuple | None = eqx.field(static=True, default=None)
    closed: bool = eqx.field(static=True, default=False)

    smoothness = float("inf")

    def curve(self, s):
        angle = (1.0 + self.fast) * s / 0.01
        return Vec2(0.03 + 0.01 * jnp.cos(angle), -0.05 + 0.01 * jnp.sin(angle))

    def frame(self, s):
        angle, point = (1.0 + self.fast) * s / 0.01, self.curve(s)
        # The tangent of the curve that is not of unit speed, as its derivative has it.
        tangent = Vec2(-jnp.sin(angle), jnp.cos(angle)) * (1.0 + self.fast)
        lean = Vec2(self.lean, 0.0)
        curvature = 100.0 * (1.0 + self.fast) ** 3 * (1.0 + self.bend)
        return Frenet2(Vec2(point.x, point.y + self.aside), tangent + lean, curvature + 0.0 * s)

    def domain(self):
        return self.ends


PLACES = np.linspace(-0.02, 0.03, 16)


@pytest.mark.parametrize(
    ("part", "allowed", "refused", "words"),
    [
        # In double precision: a billionth of speed, ten of the tangent, ten millionths of the curvature.
        ("fast", 0.9e-9, 1.1e-9, "unit speed"),
        ("fast", -0.9e-9, -1.1e-9, "unit speed"),
        ("lean", 0.9e-8, 1.1e-8, "but the tangent of"),
        ("lean", -0.9e-8, -1.1e-8, "but the tangent of"),
        ("bend", 0.9e-5, 1.2e-5, "but the curvature of"),
        ("bend", -0.9e-5, -1.2e-5, "but the curvature of"),
        # A millionth of the largest coordinate, 0.06 m at most.
        ("aside", 0.3e-7, 0.7e-7, "but the point of"),
    ],
)
def test_what_belongs_together_may_be_off_by_so_much(part, allowed, refused, words):
    assert contract._along(Bend(**{part: allowed}), PLACES) is None
    assert words in contract._along(Bend(**{part: refused}), PLACES)


def test_an_error_at_a_contacts_start_comes_before_larger_ones_elsewhere():
    class Wave(Bend):
        def curve(self, s):
            return Vec2(s + 1e-6 * jnp.sin(s / 0.01) ** 2 + self.fast * s, 0.0 * s)

        def frame(self, s):
            return Frenet2(self.curve(s), Vec2(1.0 + 0.0 * s, 0.0 * s), 0.0 * s)

    places = np.array([0.0, 0.004, 0.008, 0.012])
    slope = 1.0 + 1e-4 * np.sin(2.0 * places / 0.01)
    worst = int(np.argmax(np.abs(slope - 1.0)))
    found = contract._along(Wave(), places, there=True)
    assert found.endswith(f"the speed of {{kind}} at s = {places[worst]:.4g} m was {slope[worst]:.7g}")
    found = contract._along(Wave(fast=1e-6), places, there=True)
    assert found.endswith("the speed of {kind} there was 1.000001")
    found = contract._along(Wave(fast=1e-6), places)
    assert f"at s = {places[worst]:.4g} m" in found


@pytest.mark.parametrize(("short", "closes"), [(0.0, True), (0.8e-9, True), (1.3e-9, False)])
def test_a_closed_contour_comes_back_to_itself_within_a_ten_millionth_of_a_radian(short, closes):
    found = contract._open(Bend(closed=True), np.array([0.002, 0.002 + TURN * 0.01 - short]))
    assert closes == (found is None)
    assert closes or "comes back to itself where it claims to be closed" in found


def test_a_contour_that_comes_back_with_another_point_tangent_or_curvature_is_not_closed():
    class Leaf(Bend):
        def frame(self, s):
            rise = jnp.where(s > 0.06, 1.0, 0.0)
            tangent = Vec2(1.0 + self.lean * rise, 0.0 * s)
            point = Vec2(0.01 + self.aside * rise, -0.02 + 0.0 * s)
            return Frenet2(point, tangent, 100.0 + self.bend * rise)

        def curve(self, s):
            return Vec2(0.01 + 0.0 * s, 0.02 + 0.0 * s)

    ends = np.array([0.0, 0.05])
    assert contract._open(Leaf(), ends) is None
    # A ten millionth of the largest coordinate and the length, 0.07 m.
    assert contract._open(Leaf(aside=6.5e-9), ends) is None
    assert contract._open(Leaf(aside=7.5e-9), ends) is not None
    assert contract._open(Leaf(lean=0.9e-7), ends) is None
    assert contract._open(Leaf(lean=1.1e-7), ends) is not None
    # A thousandth of the curvature and of one over the length, 120 1/m: 0.12 1/m.
    assert contract._open(Leaf(bend=0.11), ends) is None
    assert contract._open(Leaf(bend=0.13), ends) is not None


def test_an_endless_contour_is_looked_at_from_a_micrometre_to_a_tenth_of_a_metre_off(monkeypatch):
    seen = []
    monkeypatch.setattr(contract, "_along", lambda contour, places, there: seen.append((places, there)))
    contract._about(Bend(), 0.3)
    ((places, there),) = seen
    assert there and len(places) == 1024 and np.all(places[:2] == 0.3)
    ahead, behind = places[2:513] - 0.3, 0.3 - places[513:]
    for off in (ahead, behind):
        np.testing.assert_allclose([off[0], off[-1]], [1e-6, 0.1], rtol=1e-9)
        np.testing.assert_allclose(off[1:] / off[:-1], (1e5) ** (1 / 510), rtol=1e-6)
    seen.clear()
    contract._about(Bend(ends=(0.0, 0.01)), 0.002)
    ((places, there),) = seen
    assert there and places.tolist() == [0.002] * 1024


def test_a_contour_with_ends_is_looked_at_between_them(monkeypatch):
    seen = []
    monkeypatch.setattr(contract, "_along", lambda contour, places: seen.append(places))
    monkeypatch.setattr(contract, "_open", lambda contour, ends: seen.append(ends))
    assert contract._fault(Bend(ends=(0.1, 0.3))) is None
    np.testing.assert_allclose(seen[0], 0.1 + 0.2 * (np.arange(1024) + 0.5) / 1024)
    assert len(seen) == 1
    contract._fault(Bend(ends=(0.1, 0.3), closed=True))
    assert len(seen) == 3 and seen[2].tolist() == [0.1, 0.3]
    for ends in ((0.3, 0.1), (0.1, 0.1), (0.1, np.inf), (0.1, 0.2, 0.3)):
        assert "whose domain rises, but that of {kind} was" in contract._fault(Bend(ends=ends))
    assert contract._fault(Bend()) is None
    assert "with ends" in contract._fault(Bend(closed=True))


def test_shapes_within_shapes_are_found_but_not_those_in_ones_own():
    circle, own = jxr.Circle(0.01), Bend()
    placed = own.moved().moved((0.1, 0.0))
    assert [type(x).__name__ for x in contract.members(placed)] == ["Moved", "Moved", "Bend"]
    bar = Hollow(Extruded(circle.moved()).moved())
    names = ["Hollow", "MovedSurface", "Extruded", "Moved", "Circle"]
    assert [type(x).__name__ for x in contract.members(bar)] == names
    assert [type(x).__name__ for x in contract.members([circle, (own, 3)])] == ["Circle", "Bend"]
    assert is_foreign(own) and not is_foreign(circle)


def test_tables_are_found_at_any_depth():
    rows, length = jnp.ones((8, 12)), jnp.asarray(0.1)
    table = lambda: Table(rows, length, length, 0.0 * length, True)  # noqa: E731
    spline = jxr.Spline([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [0, -1]])
    one, other = (
        eqx.tree_at(lambda c: c.table, spline, table(), is_leaf=lambda x: x is None) for _ in range(2)
    )

    class Pair(Bend):
        first: jxr.AbstractContour = None
        rest: tuple = ()

    held = Pair(first=one.moved(), rest=([other], 3.0)).moved()
    found = contract_errors.tables(held)
    assert [t is c.table for t, c in zip(found, (one, other), strict=True)] == [True, True]
    assert not list(contract_errors.tables(jxr.Circle(0.01)))


def faulty(monkeypatch, **errors):
    """What is said of a surface with such errors at four places."""
    seam = jnp.asarray(errors.pop("seam", 0.0))
    found = {"normal": jnp.zeros(4), "rates": jnp.zeros(4), "there": jnp.ones(4)}
    found |= {name: jnp.asarray(value) for name, value in errors.items()}
    monkeypatch.setattr(contract, "surface_off", lambda surface: contract_errors.over_allowed(found, seam))
    return contract._surface_fault(Hollow(jxr.Sphere(0.01)))


def test_errors_of_surfaces_up_to_a_millionth_are_let_pass(monkeypatch):
    assert faulty(monkeypatch) is None
    assert faulty(monkeypatch, rates=[0.0, 0.9e-6, 0.0, 0.0]) is None
    found = faulty(monkeypatch, rates=[0.0, 1.1e-6, 0.0, 1e-7])
    assert found == "whose rates, but that of {kind} was 1.1e-06 off, relative to its size"
    assert faulty(monkeypatch, seam=9e-6) is None
    assert "period are 1.1e-05 of its size apart" in faulty(monkeypatch, seam=1.1e-5)
    assert "periodic" in faulty(monkeypatch, seam=np.nan)
    # What is not on the surface, or not finite, says nothing.
    assert faulty(monkeypatch, rates=[0.0, 1.0, 0.0, 0.0], there=[1.0, 0.0, 1.0, 1.0]) is None
    assert faulty(monkeypatch, rates=[0.0, 1.0, 0.0, 0.0], normal=[0.0, np.nan, 0.0, 0.0]) is None
    assert "had none" in faulty(monkeypatch, there=[0.0] * 4)
    assert "had none" in faulty(monkeypatch, rates=[np.inf] * 4)


def test_the_ends_of_periods_are_compared_by_the_largest_gap():
    """A strip of 2 by 3 whose ends are apart by 2 in u and by 3 and the rise in v, beside its size."""
    at = (jnp.array([0.0, 2.0, 1.0]), jnp.array([-1.0, 2.0, 0.5]))
    strip = lambda flags: Chart(  # noqa: E731
        lambda u, v: (u, v, 0.5 * v), domain=((0.0, 2.0), (-1.0, 2.0)), periodic=flags
    )
    size = np.linalg.norm([2.0, 2.0, 1.0])
    rise = 3.0 * np.hypot(1.0, 0.5)
    for flags, gap in (
        ((True, False), 2.0),
        ((False, True), rise),
        ((True, True), rise),
        ((False, False), 0.0),
    ):
        assert float(contract_errors._seam(strip(flags), at)) == pytest.approx(gap / size)


def test_a_frame_of_another_kind_is_named():
    class Bare(Bend):
        def frame(self, s):
            return self.curve(s)

    with pytest.raises(ValueError, match="but Bare gave a Vec2 and a Vec2"):
        contract_errors._frame(Bare(), jnp.zeros(()))

    class Flat(jxr.geometry.AbstractImplicit):
        smoothness = 4.0

        def derivatives(self, point):
            raise NotImplementedError

        def frame(self, at):
            return 3.0

    with pytest.raises(ValueError, match="argument surface must give a Gauss3 by `frame`, but Flat gave 3.0"):
        contract_errors._errors(Flat(), (0.0, 0.0, 0.0))


def test_what_a_contact_starts_on_is_told_otherwise_than_what_is_given():
    for options, words in (({}, "must be"), ({"start": 0.1}, "must lie on")):
        with pytest.raises(ValueError, match=f"^argument tip {words} a contour with ends, as Bend claims"):
            contract.check_contour("tip", Bend(closed=True).moved(), **options)
    with pytest.raises(ValueError, match="^argument tip must be a contour with ends, as Bend claims"):
        contract.check_shape("tip", Bend(closed=True))
    with pytest.raises(ValueError, match="^argument tip must be a contour with ends, as Bend claims"):
        contract.check_shape("tip", Extruded(Bend(closed=True)).moved())


def test_what_is_let_pass_in_single_precision():
    """A ten thousandth of speed, a tenth of the curvature; a hundredth of what a surface has."""

    def along(**parts):
        return in_single(lambda: contract._along(Bend(**parts), PLACES.astype(np.float32)))

    assert along(fast=0.8e-4) is None and "unit speed" in along(fast=1.2e-4)
    assert along(bend=0.09) is None and "the curvature" in along(bend=0.12)


def test_errors_of_tables_are_let_pass_four_times_over(monkeypatch):
    monkeypatch.setattr(contract_errors, "tables", lambda contour: [0.3e-6, 1e-6])
    monkeypatch.setattr(contract_errors, "unevenness", lambda table: table)
    assert contract._along(Bend(fast=3.9e-6), PLACES) is None
    assert contract._along(Bend(fast=4.1e-6), PLACES) is not None


def test_an_error_at_the_first_place_is_there_only_where_a_contact_starts():
    class Straight(Bend):
        def curve(self, s):
            return Vec2(s, 0.0 * s)

        def frame(self, s):
            away = 1e-3 - 0.01 * (s - 0.5)
            tangent = Vec2(1.0 + 0.0 * s, self.lean * away)
            return Frenet2(Vec2(s, 0.0 * s), tangent, self.bend * away)

    falling, rising = np.array([0.5, 0.51, 0.52]), np.array([0.5, 0.4, 0.45])
    for parts, words in (({"lean": 1.0}, "tangent of {kind} "), ({"bend": 1e3}, "curvature of {kind} ")):
        assert f"{words}at s = 0.5 m was" in contract._along(Straight(**parts), falling)
        assert f"{words}there was" in contract._along(Straight(**parts), falling, there=True)
        assert f"{words}at s = 0.4 m was" in contract._along(Straight(**parts), rising)
        assert f"{words}there was" in contract._along(Straight(**parts), rising, there=True)


def test_the_place_is_named_at_which_a_curve_has_no_number():
    class Broken(Bend):
        def curve(self, s):
            circle = super().curve(s)
            return Vec2(circle.x, jnp.where(s == PLACES[11], jnp.nan, circle.y))

        def frame(self, s):
            frame = super().frame(s)
            return Frenet2(self.curve(s), frame.tangent, frame.curvature)

    found = contract._along(Broken(), PLACES)
    assert found.startswith("with finite points") and f"at s = {PLACES[11]:.4g} m" in found
