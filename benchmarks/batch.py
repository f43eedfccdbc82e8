"""Throughput of batches: runs per second and core, beside hand-written Numba loops of the same scene.

Run from the repository root: `python -m benchmarks.batch` (about three minutes; needs the `bench` extra).
Every contender is pushed to the loosest setting whose error at 3 s stays below 1e-6 rad; times are
processor time, least of five interleaved rounds, compilation left out.
"""

import time

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from numba import njit

import jaxroll as jxr
from benchmarks import _pivoted_numba as scene
from benchmarks._common import device, table, versions

jax.config.update("jax_enable_x64", True)

TARGET, SPAN, LANES = 1e-6, 3.0, 4096
compiled = njit(error_model="numpy")
_TSIT5 = diffrax.Tsit5().tableau
_A = np.zeros((7, 7))
for _i, _row in enumerate(_TSIT5.a_lower):
    _A[_i + 1, : len(_row)] = _row
_E = np.asarray(_TSIT5.b_error)


@compiled
def fixed(x, span, steps):
    """Classical Runge-Kutta with equal steps."""
    h, k = span / steps, np.empty((4, 7))
    x, y = x.copy(), np.empty(7)
    for _ in range(steps):
        scene.fill_rates(0.0, x, k[0])
        for j in range(3):
            part = h if j == 2 else 0.5 * h
            for i in range(7):
                y[i] = x[i] + part * k[j, i]
            scene.fill_rates(0.0, y, k[j + 1])
        for i in range(7):
            x[i] += h / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])
    return x


@compiled
def adaptive(x, span, tolerance):
    """Tsit5 with the usual step-size control, first-same-as-last, without projection."""
    t, h, k = 0.0, 1e-4, np.empty((7, 7))
    x, y = x.copy(), np.empty(7)
    scene.fill_rates(0.0, x, k[0])
    while t < span:
        h = min(h, span - t)
        for j in range(1, 7):
            for i in range(7):
                total = 0.0
                for m in range(j):
                    total += _A[j, m] * k[m, i]
                y[i] = x[i] + h * total
            scene.fill_rates(0.0, y, k[j])
        size = 0.0
        for i in range(6):
            error = 0.0
            for m in range(7):
                error += _E[m] * k[m, i]
            scaled = h * error / (tolerance * (1.0 + max(abs(x[i]), abs(y[i]))))
            size += scaled * scaled / 6.0
        if size <= 1.0:
            t += h
            for i in range(7):
                x[i], k[0, i] = y[i], k[6, i]
        h *= min(10.0, max(0.2, 0.9 * size**-0.1)) if size > 0.0 else 10.0
    return x


@compiled
def many(loop, starts, setting):
    out = np.empty_like(starts)
    for i in range(starts.shape[0]):
        out[i] = loop(starts[i], SPAN, setting)
    return out


def jaxroll_lanes(tolerance, solver):
    grasp, state = jxr.scenes.pivoted()

    def end(v):
        start = jxr.State(state.q, v, state.s)
        return jxr.simulate(grasp, start, SPAN, ts=1, rtol=tolerance, solver=solver).last.q

    run = jax.jit(jax.vmap(end))
    still = jnp.zeros((LANES, 3))
    return lambda: jax.block_until_ready(run(still))


def numba_lanes(loop, setting):
    start = scene.onto_constraints(scene.start())
    starts = np.tile(start, (LANES, 1))
    return lambda: many(loop, starts, setting)


def contenders():
    reference = fixed(scene.onto_constraints(scene.start()), SPAN, 100000)[:3]
    ladders = {
        "jaxroll, Tsit5": [(r, jaxroll_lanes(r, diffrax.Tsit5())) for r in (1e-4, 3e-5, 1e-5)],
        "jaxroll, Bosh3": [(r, jaxroll_lanes(r, diffrax.Bosh3())) for r in (1e-4, 3e-5, 1e-5)],
        "Numba, Tsit5": [(r, numba_lanes(adaptive, r)) for r in (1e-4, 3e-5, 1e-5, 3e-6, 1e-6)],
        "Numba, RK4, equal steps": [(n, numba_lanes(fixed, n)) for n in (400, 800, 1600, 3200)],
    }
    for name, ladder in ladders.items():
        for setting, call in ladder:
            error = float(np.abs(np.asarray(call())[0, :3] - reference).max())
            if error <= TARGET:
                yield name, setting, error, call
                break


def main() -> None:
    found = list(contenders())
    best = [np.inf] * len(found)
    for _ in range(5):
        for i, (_, _, _, call) in enumerate(found):
            start = time.process_time()
            call()
            best[i] = min(best[i], time.process_time() - start)
    peer = min(t for t, (name, *_) in zip(best, found, strict=True) if name.startswith("Numba"))
    lines = [
        [name, f"{setting:g}", f"{error:.1e}", f"{LANES / t:.0f}", f"{peer / t:.2f}"]
        for t, (name, setting, error, _) in zip(best, found, strict=True)
    ]
    print(table(["contender", "setting", "error [rad]", "runs/s per core", "over the best Numba"], lines))
    print(device(), versions("jax", "jaxlib", "diffrax", "numba"), sep="\n")


if __name__ == "__main__":
    main()
