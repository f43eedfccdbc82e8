"""Lines of a printed run, of a run made by hand: every number in them is worked out here."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._integration import _report as lines
from jaxroll._mechanics import Coordinate, Labels, QUATERNION

R = jxr.RESULTS
NAN = math.nan
BODY = tuple(Coordinate(*each) for each in (("x", "m"), ("y", "m"), ("theta", "rad")))
ARM = (Coordinate("q[0]", "rad"), Coordinate("q[1]", "rad"))
SLIDE = (Coordinate("clock", "s"), Coordinate("q[0]", "m"))
LABELS = Labels(
    (("object", BODY), ("finger 0", ARM), ("finger 1", ())),
    ("contact 0 (left)", "contact 1 (right)"),
    (True, True),
)
SLIDING = (Coordinate("reach", "m"), Coordinate("own", "deg"))
SLIDES = LABELS._replace(bodies=(("object", BODY), ("finger 0", SLIDING)))
Q = np.array(
    [
        [0.001, 0.02, 0.3, 1.0, -2.0],
        [0.002, 0.05, 0.1, 1.5, -2.5],
        [0.0045678, 0.01, -0.2, 1.25, -3.00004],
        [NAN, NAN, NAN, NAN, NAN],
    ]
)
F = np.array([[1.5, 3.0], [2.0, 0.8], [4.0, 5.0], [NAN, NAN]])
LAM = np.array([[0.3, -1.2], [-0.5, 0.2], [1.0, 1.0], [NAN, NAN]])


def made(**changes):
    """A run of two contacts, of which three of four states were saved."""
    rows = lambda peak: np.array([[0.0, -peak], [0.5 * peak, 0.0], [0.0, 0.0], [NAN, NAN]])  # noqa: E731
    run = {
        "result": R.successful,
        "ts": np.array([0.0, 0.25, 0.5, 0.75]),
        "states": SimpleNamespace(q=Q, s=np.array([[0.0, 0.001], [0.002, 0.004], [-0.001, 0.0], [NAN, NAN]])),
        "last": SimpleNamespace(q=np.array([0.0055, 0.0101, -0.2, 1.25, -3.1])),
        "stats": SimpleNamespace(steps=41, accepted=37, rejected=4, t_end=0.625, contact=-1, margin=0.1),
        "residuals": SimpleNamespace(normal=rows(2e-14), tangential=rows(3e-14), tangency=rows(4e-13)),
        "labels": LABELS,
        "multipliers": SimpleNamespace(f=F, lam=LAM, spin=None),
        "energy": None,
    }
    run |= changes
    return SimpleNamespace(**run, reached=~np.isnan(run["states"].q).any(axis=1))


def ended(code, *, t=0.625, contact=1, margin=-0.25, **changes):
    """The same, ended early."""
    stats = SimpleNamespace(
        steps=41, accepted=37, rejected=4, t_end=t, contact=contact, margin=np.float64(margin)
    )
    return made(result=code, stats=stats, **changes)


def test_every_line_of_a_run():
    assert lines.report(made()).splitlines() == [
        "Trajectory: successful",
        "  time      0 to 0.5 s, 3 of 4 states saved; ended at 0.625 s",
        "  steps     37 accepted, 4 rejected",
        "  residuals gap 3.0e-14 m, tangency 4.0e-13 rad",
        "  rolled    3.000, 4.000 mm",
        "  moved     object: x +4.500, y -9.900 mm, theta -0.5000 rad",
        "            finger 0: q[0] +0.2500, q[1] -1.1000 rad",
        "  forces    normal 0.8 to 5 N, tangential -1.2 to 1 N",
        "  friction  demand up to 0.4, of contact 1 at t = 0 s",
    ]


def test_contacts_that_bear_no_force_do_not_pull():
    none = SimpleNamespace(
        f=np.array([[-0.0, 0.0], [NAN, NAN]]), lam=np.array([[0.0, -0.0], [NAN, NAN]]), spin=None
    )
    told = lines.report(made(multipliers=none)).splitlines()
    assert told[-2] == "  forces    normal 0 to 0 N, tangential 0 to 0 N"
    assert told[-1] == "  friction  none needed: no contact bears a force"


def test_lines_of_a_run_that_hardly_began():
    nothing = np.full((1, 5), NAN)
    here = made(states=SimpleNamespace(q=nothing, s=nothing[:, :2]), ts=np.array([0.5]))
    assert lines.report(here).splitlines() == [
        "Trajectory: successful",
        "  time      none of 1 states saved, `last` is where it stopped; ended at 0.625 s",
        "  steps     37 accepted, 4 rejected",
        "  at end    object: x 5.500 mm, y 10.100 mm, theta -0.2000 rad",
        "            finger 0: q[0] 1.2500 rad, q[1] -3.1000 rad",
    ]
    here.stats.t_end = 0.0
    assert lines.report(here).splitlines()[3].startswith("  start     object")
    none = np.full(1, NAN)
    here.energy = SimpleNamespace(kinetic=none, potential=none, residual=none)
    assert "energy" not in lines.report(here)
    here.multipliers = None
    assert lines.report(here).splitlines()[-1].startswith("  forces    not recorded")
    one = made(states=SimpleNamespace(q=Q[2:], s=np.zeros((2, 2))), ts=np.array([0.5, 0.75]))
    one.multipliers = SimpleNamespace(f=F[2:], lam=LAM[2:], spin=None)
    told = lines.report(one).splitlines()
    assert told[1] == "  time      0.5 s, 1 of 2 states saved; ended at 0.625 s"
    assert not any("rolled" in line or "moved" in line for line in told)
    one.stats.t_end = 0.0
    assert lines.report(one).splitlines()[4].startswith("  at end    object")
    two = made(states=SimpleNamespace(q=Q[1:], s=np.array([[0.0, 0.0], [0.001, -0.003], [NAN, NAN]])))
    two.ts, two.multipliers = np.array([0.25, 0.5, 0.75]), None
    told = lines.report(two).splitlines()
    assert told[1] == "  time      0.25 to 0.5 s, 2 of 3 states saved; ended at 0.625 s"
    assert told[4] == "  rolled    1.000, 3.000 mm since 0.25 s"
    assert told[5] == "  moved     since 0.25 s:"
    assert told[6] == "            object: x +3.500, y -39.900 mm, theta -0.3000 rad"


@pytest.mark.parametrize(
    ("kinetic", "residual", "told"),
    [
        (1.0, 2e-11, "within 5.0e-12 of its size"),
        (-3.0, 1e-12, "within 1.0e-12 J"),
        (-2.9, 0.5, "within 5.0e-01 J"),
        (-2.5, 0.5, "within 1.0e+00 of its size"),
    ],
)
def test_energy_that_is_off_is_told_as_a_share_of_it_where_there_is_some(kinetic, residual, told):
    nothing = np.array([0.0, 0.0, 0.0, NAN])
    energy = SimpleNamespace(
        kinetic=nothing + kinetic, potential=nothing + 3.0, residual=np.array([0.0, -residual, 0.0, NAN])
    )
    assert lines.report(made(energy=energy)).splitlines()[-1] == f"  energy    balance {told}"


def test_forces_in_space_and_what_is_rounding_beside_them():
    tangential = np.stack([0.6 * LAM, 0.8 * LAM], axis=-1)
    space = made(multipliers=SimpleNamespace(f=F, lam=tangential, spin=np.array([[0.01, -0.02], [NAN, 0.0]])))
    space.residuals.tangential = np.zeros((4, 2, 2))
    told = lines.report(space).splitlines()
    assert not any("rolled" in line for line in told)
    assert told[-3:] == [
        "  forces    normal 0.8 to 5 N, tangential 0.2 to 1.2 N",
        "  spin      prevented by up to 0.02 N m",
        "  friction  demand up to 0.4, of contact 1 at t = 0 s",
    ]
    small = np.array([[4.9e-12, -4.9e-12], [5.1e-12, 1e-13]])
    tiny = made(multipliers=SimpleNamespace(f=np.array([[5.0, 3.0], [1.0, 2.0]]), lam=small, spin=None))
    assert "tangential 0 to 5.1e-12 N" in lines.report(tiny)


@pytest.mark.parametrize(
    ("f", "aside", "presses", "told"),
    [
        ([[1.0, 2.0], [4.0, 8.0]], [[0.5, 1.0], [1.9, 4.0]], (), "demand up to 0.5, of contact 0 at t = 0 s"),
        (
            [[1.0, 2.0], [4.0, 8.0]],
            [[0.5, 0.1], [0.1, 8.0]],
            (),
            "demand up to 1, of contact 1 at t = 0.25 s",
        ),
        (
            [[1.0, 2.0], [4.0, 8.0]],
            [[0.5, 0.1], [0.1, 8.8]],
            (),
            "demand up to 1.1, of contact 1 at t = 0.25 s; ! above 1: few materials give that",
        ),
        (
            [[1.0, 2.0], [4.0, 8.0]],
            [[0.5, 0.1], [0.1, 8.0]],
            (True, False),
            "demand up to 0.5, of contact 0 at t = 0 s",
        ),
        (
            [[1.0, 2.0], [-4.0, 0.0]],
            [[0.5, 0.1], [0.1, 8.0]],
            (True, True),
            "! contact 0 (left) pulls at t = 0.25 s: no friction would do",
        ),
        (
            [[1.0, 2.0], [4.0, 0.0]],
            [[0.5, 0.1], [0.1, 8.0]],
            (True, True),
            "! contact 1 (right) pulls at t = 0.25 s: no friction would do",
        ),
        (
            [[1.0, -2.0], [4.0, -8.0]],
            [[0.5, 0.1], [0.1, 8.0]],
            (True, False),
            "demand up to 0.5, of contact 0 at t = 0 s",
        ),
        (
            [[1.0, 2.0], [4.0, 8.0]],
            [[0.5, 0.1], [0.1, 8.0]],
            (False, False),
            "none needed: no contact can only press",
        ),
        (
            [[NAN, 2.0], [4.0, 8.0]],
            [[0.5, 0.1], [0.1, NAN]],
            (),
            "demand up to 0.05, of contact 1 at t = 0 s",
        ),
    ],
)
def test_the_friction_that_rolling_needs(f, aside, presses, told):
    run = made(labels=LABELS._replace(presses=presses))
    assert lines._demand(run, np.array(f), np.array(aside)) == told
    if not presses:
        run.labels = None
        assert lines._demand(run, np.array(f), np.array(aside)) == told


def test_the_first_of_equal_demands_is_told():
    aside = np.array([[0.5, 0.0], [0.5 * (1.0 + 0.9e-9), 0.0]])
    assert lines._demand(made(), np.ones((2, 2)), aside).endswith("at t = 0 s")
    aside[1, 0] = 0.5 * (1.0 + 1.1e-9)
    assert lines._demand(made(), np.ones((2, 2)), aside).endswith("at t = 0.25 s")


SLIPS = "contact 1 (right) needs more friction than there is WHEN: its force is "
CAUSES = [
    (ended(R.contact_lost), "contact 1 (right) no longer presses WHEN: it pulls with 0.25 N"),
    (ended(R.contact_lost, contact=-1, margin=NAN), "a contact no longer presses WHEN"),
    (ended(R.contact_lost, contact=0), "contact 0 (left) no longer presses WHEN: it pulls with 0.25 N"),
    (ended(R.contact_lost, margin=-1e-16), "contact 1 (right) no longer presses WHEN: it pulls with 1e-16 N"),
    (ended(R.contact_lost, contact=2), "contact 2 no longer presses WHEN: it pulls with 0.25 N"),
    (ended(R.contact_lost, labels=None), "contact 1 no longer presses WHEN: it pulls with 0.25 N"),
    (ended(R.penetration), "finger 1 overlaps the object away from its contact WHEN: by 0.25 m"),
    (ended(R.links_meet), "links of finger 1 meet the object or those of another finger WHEN: by 0.25 m"),
    (ended(R.joint_limit), "finger 0 q[1] passed the end of its range WHEN: by 0.25 rad"),
    (ended(R.torque_limit, contact=0), "finger 0 q[0] needs more torque than it has WHEN: by 0.25 N m"),
    (
        ended(R.joint_limit, contact=0, labels=SLIDES),
        "finger 0 reach passed the end of its range WHEN: by 0.25 m",
    ),
    (
        ended(R.torque_limit, contact=0, labels=SLIDES),
        "finger 0 reach needs more torque than it has WHEN: by 0.25 N",
    ),
    (
        ended(R.torque_limit, contact=1, labels=SLIDES),
        "finger 0 own needs more torque than it has WHEN: by 0.25 N m or N",
    ),
    (ended(R.joint_limit, contact=2), "joint 2 passed the end of its range WHEN: by 0.25 rad or m"),
    (
        ended(R.singular_contact, contact=0),
        "contact 0 (left) became singular WHEN: its curvatures cancel, to 1e-4 of their size",
    ),
    (
        ended(R.singular_contact),
        "contact 1 (right) became singular WHEN: its curvatures cancel, to 1e-4 of their size",
    ),
    (ended(R.max_steps_reached), "the step limit was reached WHEN, after 40 steps"),
    (ended(R.not_finite), "the equations of motion gave a value that is not finite WHEN"),
    (
        ended(R.singular_contact, contact=-1),
        "the rolling contact became singular: the sum of the two curvatures vanishes beside their size, or "
        "the Schur complement of the constraints is no longer positive WHEN",
    ),
    (
        ended(R.unreachable),
        "the initial state is off the constraints: no pose near the guess closes them",
    ),
    (ended(R.slipping), f"{SLIPS}0.25 N outside the friction cone"),
    (ended(R.slipping, margin=-2.2e-13), f"{SLIPS}at the edge of the friction cone"),
    (ended(R.slipping, margin=-2.3e-13), f"{SLIPS}2.3e-13 N outside the friction cone"),
    (ended(R.contour_end, margin=-2.2e-14), "contact 1 (right) ran to the end of an open contour WHEN"),
    (
        ended(R.contour_end, margin=-2.3e-14),
        "contact 1 (right) ran past the end of an open contour WHEN: by 2.3e-14 m",
    ),
]


@pytest.mark.parametrize(("run", "told"), CAUSES, ids=range(len(CAUSES)))
def test_why_a_run_ended(run, told):
    assert lines.cause(run) == told.replace("WHEN", "at t = 0.625 s")


def test_a_surface_has_an_edge():
    turning = (*BODY, *(Coordinate(part, "") for part in QUATERNION))
    told = lambda margin: lines.cause(  # noqa: E731
        ended(R.contour_end, margin=margin, labels=LABELS._replace(bodies=(("object", turning),)))
    )
    assert told(0.0) == "contact 1 (right) ran to the edge of an open surface at t = 0.625 s"
    assert told(-0.25) == "contact 1 (right) ran past the edge of an open surface at t = 0.625 s: by 0.25 m"


def test_a_complaint_is_the_cause_and_the_remedy():
    lost, told = (
        ended(R.contact_lost),
        "Contact 1 (right) no longer presses at t = 0.625 s: it pulls with 0.25 N",
    )
    assert lines.complaint(lost, {"contact_lost": "press"}) == f"{told}; what helps: press"
    assert lines.complaint(lost, {}) == told
    report = lines.report(lost, {"contact_lost": "press"}).splitlines()
    assert report[:3] == [
        "Trajectory: contact_lost",
        f"  ended     c{told[1:]}",
        "  remedy    press",
    ]
    assert lines.report(lost, {}).splitlines()[2] == "  remedy    none known"


def test_joints_are_counted_over_all_fingers_without_clocks():
    labels = Labels((("object", BODY), ("finger 0", SLIDE), ("finger 1", ARM)), ())
    named = [lines.joint_name(labels, i) for i in range(-1, 4)]
    assert named == ["joint -1", "finger 0 q[0]", "finger 1 q[0]", "finger 1 q[1]", "joint 3"]
    assert lines.joint_name(None, 1) == "joint 1"


def test_amounts_are_in_millimetres_or_in_units_of_their_own():
    found = [lines.amount(*each) for each in ((0.0012345, "m"), (-1.23456, "rad"), (2.0, ""), (-1e-9, "m"))]
    assert found == ["1.234 mm", "-1.2346 rad", "2.0000", "0.000 mm"]
    assert lines.amount(0.5, "rad", signed=True) == "+0.5000 rad"
    assert lines.amount(-4e-5, "rad", signed=True) == "+0.0000 rad"


def test_an_orientation_is_told_by_how_far_it_turned():
    places = tuple(Coordinate(x, "m") for x in "xyz")
    parts = tuple(Coordinate(x, "") for x in ("qw", "qx", "qy", "qz"))
    start = np.array([0.0, 0.0, 0.1, *(2.0 * np.array([0.1, 0.5, -0.7, 0.5]))])
    half = np.array([np.cos(0.35), *(np.sin(0.35) * np.array([0.6, 0.0, 0.8]))])
    w, x, y, z = start[3:] / 2.0
    a, b, c, d = half
    turned = [w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c]
    turned += [w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a]
    for sign in (1.0, -3.0):
        end = np.array([0.001, 0.002, 0.1, *(sign * np.array(turned))])
        told = "x +1.000, y +2.000, z +0.000 mm, turned by 0.7000 rad"
        assert lines._moved((*places, *parts), start, end) == told
    # Three numbers of these names are no orientation.
    assert lines._moved(parts[:3], np.zeros(3), np.ones(3)) == "qw +1.0000, qx +1.0000, qy +1.0000"
    mixed = (Coordinate("a", "m"), Coordinate("b", "rad"), Coordinate("c", "m"), Coordinate("d", "m"))
    assert lines._moved(mixed, np.zeros(4), np.ones(4)) == (
        "a +1000.000 mm, b +1.0000 rad, c +1000.000, d +1000.000 mm"
    )


def test_lanes_are_told_by_their_codes_and_where_they_end():
    codes = np.array([R.successful._value, R.slipping._value, R.slipping._value, R.contact_lost._value])
    result = type(R.slipping)(codes, R.slipping._enumeration)
    stats = SimpleNamespace(
        accepted=np.array([10, 20, 30, 40]),
        t_end=np.array([1.0, 0.5, 0.25, 0.125]),
        contact=np.array([-1, 1, 0, -1]),
    )
    last = SimpleNamespace(
        q=np.array(
            [
                [0.001, 0.02, 0.3, 1.0, -2.0],
                [0.003, 0.02, 0.1, 1.0, -2.0],
                [NAN] * 5,
                [0.002, 0.02, 0.2, 1.5, -2.0],
            ]
        )
    )
    runs = SimpleNamespace(result=result, stats=stats, last=last, labels=LABELS)
    assert lines.batch_report(runs).splitlines() == [
        "Trajectory of 4 lanes, 100 accepted steps",
        "  1 lane: successful",
        "  1 lane: contact_lost at t = 0.125 s",
        "  2 lanes: slipping at t = 0.25 to 0.5 s (contact 0: 1, contact 1: 1)",
        "  at end    object: x 1.000 to 3.000 mm, y 20.000 mm, theta 0.1000 to 0.3000 rad",
        "            finger 0: q[0] 1.0000 to 1.5000 rad, q[1] -2.0000 rad",
    ]
    runs.last.q = np.full((4, 5), NAN)
    assert lines.batch_report(runs).splitlines()[-1].startswith("  2 lanes: slipping")
    grid = np.array([[Q[:2], Q[1:3]], [Q[:2], Q[2:]]])  # two by two lanes, of which each has two times
    assert lines._at_the_end(None, grid[..., :1], "at end") == ["  at end    state: q[0] 0.0010 to 0.0046"]
    runs.last.q, runs.labels = np.zeros((4, 2)), LABELS
    assert lines.batch_report(runs).splitlines()[-1] == "  at end    state: q[0] 0.0000, q[1] 0.0000"
    runs.result, runs.stats.accepted = type(R.successful)(codes[:1], R.successful._enumeration), np.array([1])
    assert lines.batch_report(runs).splitlines()[0] == "Trajectory of 1 lane, 1 accepted step"
    assert lines.batch_report(runs).splitlines()[1] == "  1 lane: successful"


def test_the_largest_of_some_arrays_whatever_is_missing():
    assert lines.peak(np.array([1.0, -3.0, NAN]), np.array([[2.0]])) == 3.0
    assert lines.peak(np.zeros(0)) == 0.0
