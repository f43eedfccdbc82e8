"""The step-size control: what becomes of a step, written out once more case by case in plain Python."""

import math
from types import SimpleNamespace

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._integration._step_size import at_rest, Hunt, Pace, StopAt
from tests.subjects import rolling_disc

CODES = diffrax.RESULTS
FAILED = CODES.nonlinear_divergence
INF = math.inf
SMALLEST = np.finfo(float).eps
DT0, MOST = 0.03125, 7


def rounding(t):
    """Eight rounding units of a time, or of a millisecond."""
    return 8.0 * SMALLEST * max(abs(t), 1e-3)


class Given:
    """A control of the error that has decided already."""

    def __init__(self, keep, end, memory, code):
        self.answer = keep, end, memory, code

    def adapt_step_size(self, t0, t1, y0, y1, args, error, order, memory):
        keep, end, new, code = self.answer
        # Whatever it is handed shows in what it remembers.
        new = new + memory + args + error + order
        return keep, jnp.where(keep, t1, t0), end, False, new, code


def narrowed(case, back, kept):
    """The bracket after a step: by regula falsi, with the margin of an end that stays twice halved."""
    beyond, low, high, side, leap, grain = case.hunt
    spent = case.t1 - case.t0
    if back:
        far = -case.after if math.isfinite(case.after) else case.before
        return Hunt(spent, 0.5 * low if side > 0 else case.before, far, 1.0, INF, grain)
    if not kept:
        return Hunt(*case.hunt)
    left, least = beyond - spent, grain * rounding(case.t1)
    weighed = 0.5 * high if side < 0 else high
    if left <= 2.0 * least:
        return Hunt(INF, case.after, weighed, -1.0, 8.0 * least, 64.0 * grain)
    return Hunt(left, case.after, weighed, -1.0, INF if math.isfinite(left) else 8.0 * leap, grain)


def decided(case):
    """What becomes of a step, and the pace that is gone on at."""
    spent, still = case.t1 - case.t0, case.t0 == case.t1
    hunting = math.isfinite(case.hunt.beyond) or math.isfinite(case.hunt.leap)
    first = still or bool(case.at_jump)
    near = case.dip * spent if spent else math.nan
    fate, judged = "kept" if first or case.keep else "left", case.keep or math.isnan(case.after)
    # At the very end of a step the next try would be the same one.
    inside = near > case.length / 1024.0 and near + 1e-6 * spent + rounding(case.t1) < spent
    if case.passed and (first or judged and spent <= 2.0 * case.hunt.grain * rounding(case.t1)):
        fate = "ends"
    elif case.keep and not first and inside:
        fate = "dips"  # whatever was passed later
    elif case.passed and judged:
        fate = "back"
    keep = fate in ("kept", "ends")
    start = case.t1 if keep else case.t0
    aside = first or fate in ("back", "dips") or hunting and keep
    inner = case.memory if aside else case.new + case.memory + 0.5 + 0.25 + 5.0
    beside = case.after < 1e-6
    if first:
        length = DT0 * (1e-3 if beside else 1.0)
        if case.at_jump is not None and not still and not beside:
            length = case.length
    else:
        length = case.length if aside else case.end - (case.t1 if case.keep else case.t0)
    hunt = narrowed(case, fate == "back", keep and hunting)
    if fate == "dips":
        hunt = hunt._replace(beyond=INF, leap=near)
    if not hunt.leap < length:
        hunt = hunt._replace(leap=INF)
    if math.isinf(hunt.beyond) and math.isinf(hunt.leap):
        hunt = hunt._replace(grain=1.0)
    code = CODES.successful if aside else case.code
    if not aside and not keep and length < rounding(case.t0):
        code = CODES.dt_min_reached
    if case.attempted + 1 > MOST:  # the one of no length was the first
        code = CODES.max_steps_reached
    if fate == "ends":
        code = CODES.event_occurred
    pace = (inner, length, start, case.attempted + 1, case.accepted + keep, *hunt)
    return (keep, start, *pace, code._value)


def drawn(rng, at_jump):
    """A case: what one step came to, and what the control remembered before it."""
    of = lambda *choices: choices[rng.integers(len(choices))]  # noqa: E731
    grain = of(1.0, 64.0)
    t0 = of(0.0, 1.0, rng.uniform(0.1, 3.0))
    longest = 2.0 * grain * rounding(1.0)
    spent = of(0.0, 0.1, rng.uniform(0.001, 0.2), rounding(t0), longest, 1.5 * longest, 0.75 * longest)
    after = of(-0.3, 0.2, 0.75e-6, 1.5e-6, rng.normal(), math.nan, INF)
    case = SimpleNamespace(t0=t0, t1=t0 + spent, before=of(0.0, 0.7, rng.normal()), after=after)
    case.passed = of(0.0, 1.0)
    case.keep, case.code = of(True, True, False), of(CODES.successful, CODES.successful, FAILED)
    case.end = t0 + (spent if case.keep else 0.0) + of(0.25, 2.0**-40, rng.uniform(0.0, 0.3), 2.0**-60)
    case.memory, case.new = rng.normal(), rng.normal()
    case.length = of(0.125, rng.uniform(0.001, 2.0), 3e-15)
    case.attempted, case.accepted = int(rng.integers(5, 10)), int(rng.integers(0, 5))
    finest = case.length / 1024.0 / (spent or 1.0)
    case.dip = of(
        INF,
        INF,
        1.0,
        1.0 - 1e-15,
        1.0 - 5e-7,
        1.0 - 2e-6,
        0.4,
        rng.uniform(),
        1e-3 * rng.uniform(),
        0.7 * finest,
        1.4 * finest,
    )
    case.at_jump = at_jump and of(True, False)
    beyond, leap = of((INF, INF), (INF, rng.uniform(0.0, 0.3)), (spent + of(1e-12, 0.1, 1.9 * longest), INF))
    if math.isfinite(beyond) and of(True, False):
        beyond = spent + of(1.0, 1.9, 2.2) * grain * rounding(case.t1)
    signs = of(-1.0, 0.0, 1.0)
    case.hunt = Hunt(beyond, rng.uniform(), rng.uniform(), signs, leap, grain)
    return case


def asked(cases, at_jump):
    """What the control says of all cases, each in a lane of its own."""
    names = ("memory", "length", "t0", "t1", "attempted", "accepted", "keep", "end", "new", "dip", "before")
    names = (*names, "after", "passed", *(("at_jump",) if at_jump else ()))
    given = {name: jnp.asarray([getattr(case, name) for case in cases]) for name in names}
    given["fine"] = jnp.asarray([case.code == CODES.successful for case in cases])
    hunts = Hunt(*(jnp.asarray(x) for x in zip(*(case.hunt for case in cases), strict=True)))

    def one(x, hunt):
        pace = Pace(x["memory"], x["length"], x["t0"], x["attempted"], x["accepted"], hunt)
        inner = Given(x["keep"], x["end"], x["new"], CODES.where(x["fine"], CODES.successful, FAILED))
        control = StopAt(inner, pace, jnp.asarray(DT0), x["dip"], x.get("at_jump"), MOST, 2)
        y0 = jnp.stack([x["new"], x["memory"], x["before"], -7.0 + 0.0 * x["new"]])
        y1 = jnp.stack([x["memory"], x["new"], x["after"], x["passed"]])
        step = (x["t0"], x["t1"], y0, y1, 0.5, 0.25, 5.0, pace)
        keep, start, end, jumped, pace, code = control.adapt_step_size(*step)
        return jumped, end, [keep, start, *jax.tree.leaves(pace), code._value]

    jumped, end, found = jax.jit(jax.vmap(one))(given, hunts)
    assert not np.any(jumped)
    np.testing.assert_array_equal(end, found[1])
    return np.array([np.asarray(x, float) for x in found]).T


@pytest.mark.parametrize("at_jump", [None, True], ids=["no jumps", "jumps"])
def test_what_becomes_of_a_step(at_jump):
    rng = np.random.default_rng(0)
    cases = [drawn(rng, at_jump) for _ in range(2500)]
    wanted = np.array([[float(x) for x in decided(case)] for case in cases])
    np.testing.assert_allclose(asked(cases, at_jump), wanted, rtol=1e-13, atol=0, equal_nan=True)
    assert min(np.unique(wanted[:, -1], return_counts=True)[1]) > 12  # every code is among them


def test_a_run_begins_at_rest():
    pace = at_rest(3, jnp.asarray(2.5))
    assert (pace.inner, float(pace.length), float(pace.t)) == (3, 0.0, 2.5)
    assert (int(pace.attempted), int(pace.accepted)) == (0, 0)
    assert [float(x) for x in pace.hunt] == [INF, 0.0, 0.0, 0.0, INF, 1.0] and not pace.hunt.on


@pytest.mark.parametrize(
    ("hunt", "length", "ahead"),
    [
        ((INF, 0.0, 0.0, 0.0, INF, 1.0), 0.25, 0.25),
        ((INF, 0.0, 0.0, 0.0, 0.1, 1.0), 0.25, 0.1),
        ((INF, 0.0, 0.0, 0.0, 0.4, 1.0), 0.25, 0.25),
        ((0.2, 3.0, 1.0, 0.0, INF, 1.0), 0.25, 0.15),  # the root of a line that falls from 3 to -1
        ((0.2, 0.15, 0.05, 0.0, INF, 1.0), 0.125, 0.125),
        ((0.2, 0.15, 0.05, 0.0, INF, 1.0), 0.25, 0.15),
        ((0.2, 0.0, 1.0, 0.0, INF, 64.0), 0.25, np.sqrt(0.2 * 64.0 * rounding(2.0))),  # zero, to rounding
        ((0.2, 0.0, 0.0, 1.0, INF, 1.0), 0.25, np.sqrt(0.2 * rounding(2.0))),
        ((0.2, 0.0, 1.0, -1.0, INF, 1.0), 0.25, 0.1),
        ((1e-15, 1.0, 0.0, 0.0, INF, 1.0), 0.25, rounding(2.0)),  # too short to halve
    ],
)
def test_where_the_next_step_ends(hunt, length, ahead):
    pace = Pace(None, jnp.asarray(length), jnp.asarray(0.0), 0, 0, Hunt(*map(jnp.asarray, hunt)))
    control = StopAt(None, pace, jnp.asarray(1.0), jnp.inf, None, 9, 0)
    assert abs(float(control.ahead(jnp.asarray(2.0))) - 2.0 - ahead) <= 3.0 * SMALLEST


def pulled(t):
    """How a plate that swings sideways and up and down pulls at what lies on it [m/s^2]."""
    return 0.00437 * 28.5**2 * jnp.cos(28.5 * t + 2.53), -0.0217 * 18.5**2 * jnp.cos(18.5 * t)


def test_a_margin_that_is_lowest_where_a_step_ends_uses_up_no_steps():
    """Of a disc that nearly slips on a shaken plate: tries that ended at the dip were all the same step."""
    load = lambda t, pose, twist: (rolling_disc.MASS * jnp.stack(pulled(t)), 0.0)  # noqa: E731

    @jax.jit
    @jax.vmap
    def steps(friction):
        disc = rolling_disc.on_slope(0.0, friction, load)
        run = jxr.simulate(*disc, 0.3, ts=1, rtol=1e-6, throw=False)
        return run.result._value, run.stats.steps

    # The force along the plate is a third of the pull along it. One in fifty used up its steps.
    along, up = map(np.asarray, pulled(np.linspace(0.0, 0.3, 100_001)))
    needed = np.max(np.abs(along) / 3.0 / (rolling_disc.GRAVITY - up))
    excess = np.geomspace(1e-5, 1e-2, 512)
    for sign, code in ((1.0, jxr.RESULTS.successful), (-1.0, jxr.RESULTS.slipping)):
        codes, count = steps(jnp.asarray(needed * (1.0 + sign * excess)))
        assert set(np.asarray(codes).tolist()) == {int(code._value)}
        assert np.max(count) < 100
