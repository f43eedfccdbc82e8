"""One row of `scans`, in a process of its own: one scan fitted, and judged by what knows nothing of the fit.

`python -m benchmarks._scan_row million ellipsoid 1000000` prints it as JSON, so does `... scan "can"`. The
judges are `tests.oracles`: the field's zero set is evaluated by SciPy's B-splines, and whether a ball fits is
told by the body's own distances. Linear algebra has one thread: on a machine that does other things too, two
would wait for each other.
"""

import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import jax
import numpy as np

import jaxroll as jxr
from benchmarks._lanes_row import peak
from tests.oracles import scanned_bodies as bodies
from tests.oracles.spline_fields import principal_curvatures, SplineField
from tests.subjects import scanned_pinch as scanned

jax.config.update("jax_enable_x64", True)

DATA = Path(__file__).parents[2] / "shared" / "data"
NOISE = 1e-4
_JUDGED = 20_000  # points at which a fit of a million is judged
_SHARP = 3e-3  # [m]


class Level(NamedTuple):
    """A body of a million points: its level surface, and a cloud from a number of points."""

    body: Any
    cloud: Callable[[np.random.Generator, int], np.ndarray]


ROUND, FLAT = (0.030, 0.022, 0.016), (0.034, 0.026, 0.020)
LEVELS = {
    "ellipsoid": Level(
        bodies.superellipsoid(ROUND, 2), lambda rng, n: bodies.superellipsoid_cloud(rng, ROUND, 2, n)
    ),
    "torus": Level(bodies.torus(0.030, 0.011), lambda rng, n: bodies.torus_cloud(rng, 0.030, 0.011, n)),
    "superellipsoid": Level(
        bodies.superellipsoid(FLAT, 3), lambda rng, n: bodies.superellipsoid_cloud(rng, FLAT, 3, n)
    ),
}


def million(name: str, count: int, radius: float | None) -> dict[str, Any]:
    """Time, memory, and errors in normals [deg] and curvatures (of the largest) of one body."""
    rng, (body, cloud) = np.random.default_rng(0), LEVELS[name]
    points = cloud(rng, count)
    points += NOISE * rng.normal(size=points.shape)
    start, work = time.perf_counter(), time.process_time()
    fit = jxr.geometry.fit_surface(points, smallest_radius=radius)
    row = {"seconds": time.perf_counter() - start, "work": time.process_time() - work, "peak": peak()}
    field = SplineField(fit.surface.coefficients, fit.surface.origin, fit.surface.step)
    at = field.feet(cloud(rng, _JUDGED))
    true = body.feet(at)
    slopes, exact = field.gradient(at), body.gradient(true)
    cosine = np.sum(slopes * exact, axis=1) / np.linalg.norm(slopes, axis=1) / np.linalg.norm(exact, axis=1)
    row["normals"] = float(np.degrees(np.sqrt(np.mean(np.arccos(np.minimum(cosine, 1.0)) ** 2))))
    found = principal_curvatures(slopes, field.hessian(at))
    wanted = principal_curvatures(exact, body.hessian(true))
    row["curvature"] = float(np.sqrt(np.mean((found - wanted) ** 2)) / np.abs(wanted).max())
    row["points"] = float(np.sqrt(np.mean(np.sum((at - true) ** 2, axis=1))))
    return row


class Cloud(NamedTuple):
    """What is fitted, and samples of the true surface with normals and whether balls fit there."""

    points: np.ndarray
    faces: np.ndarray | None
    samples: np.ndarray
    normals: np.ndarray
    free: np.ndarray


def shared(name: str, mesh: bool, radius: float, *, strays: float = 0.0, open_end: float = 0.0) -> Cloud:
    """A mesh of the shared data, as it is or its vertices alone."""
    with np.load(DATA / f"ycb_{name}.npz") as file:
        vertices, faces = file["vertices"].astype(float), file["faces"].astype(int)
    rng = np.random.default_rng(0)
    dense, _ = over_mesh(rng, vertices, faces, 400_000)
    samples, normals = over_mesh(rng, vertices, faces, _JUDGED)
    free = bodies.where_balls_fit_points(dense, samples, normals, radius)
    points = vertices
    if open_end:
        points = points[points[:, 2] > np.quantile(points[:, 2], open_end)]
    points = with_strays(rng, points, strays)
    return Cloud(points, faces if mesh else None, samples, normals, free)


def over_mesh(
    rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Points evenly over a mesh, and outward normals."""
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(across, axis=1)
    which = rng.choice(len(faces), count, p=twice / twice.sum())
    u, v = np.sort(rng.uniform(size=(2, count)), axis=0)
    weights = np.stack([u, v - u, 1.0 - v], axis=1)
    sense = np.sign(np.sum((corners.mean(axis=1) - vertices.mean(axis=0)) * across))
    return np.einsum("nk,nkd->nd", weights, corners[which]), sense * across[which] / twice[which, None]


def with_strays(rng: np.random.Generator, points: np.ndarray, share: float) -> np.ndarray:
    """A cloud with so many points more that lie anywhere in a box around it."""
    low, high = points.min(axis=0), points.max(axis=0)
    room = 0.25 * (high - low)
    strays = rng.uniform(low - room, high + room, (int(share * len(points)), 3))
    return np.concatenate([points, strays])


def made(
    body: Any,
    radius: float,
    *,
    count: int = 60_000,
    strays: float = 0.0,
    keep: Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray] | None = None,
) -> Cloud:
    """A noisy scan of a body with signed distances; `keep` says which points the scan has."""
    rng = np.random.default_rng(0)
    points, normals = body.cloud(rng, count)
    if keep is not None:
        points = points[keep(points, normals, rng)]
    points = with_strays(rng, points + NOISE * rng.normal(size=points.shape), strays)
    samples, normals = body.cloud(rng, _JUDGED)
    return Cloud(points, None, samples, normals, bodies.where_balls_fit(body, samples, normals, radius))


def above(height: float) -> Callable:
    """Points above a height [m]."""
    return lambda points, normals, rng: points[:, 2] > height


def denser(points: np.ndarray, normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Thirty times as many points at one end as at the other."""
    part = (points[:, 2] - points[:, 2].min()) / np.ptp(points[:, 2])
    return rng.uniform(size=len(points)) < 30.0**-part


BOX, SHEET = bodies.Block(0.030, 0.045, 0.080), bodies.Block(0.045, 0.060, 0.002)
CAN, BOTTLE, VESSEL, PEN = (bodies.turned(p) for p in (bodies.CAN, bodies.BOTTLE, bodies.VESSEL, bodies.PEN))
FITTED, REFUSED = "fitted", "refused"
# What is scanned: how, the smallest radius that is asked for [m], and what shall come of it.
SCANS: dict[str, tuple[Callable[[float], Cloud], float, str]] = {
    "banana, mesh": (lambda r: shared("011_banana", True, r), 5e-3, FITTED),
    "banana, vertices alone": (lambda r: shared("011_banana", False, r), 5e-3, FITTED),
    "banana, 1 % strays": (lambda r: shared("011_banana", False, r, strays=0.01), 5e-3, FITTED),
    "banana, lowest tenth missing": (lambda r: shared("011_banana", False, r, open_end=0.1), 5e-3, FITTED),
    "potted meat can, mesh": (lambda r: shared("010_potted_meat_can", True, r), 5e-3, FITTED),
    "potted meat can, vertices alone": (lambda r: shared("010_potted_meat_can", False, r), 5e-3, FITTED),
    "can with rims": (lambda r: made(CAN, r), 5e-3, FITTED),
    "bottle": (lambda r: made(BOTTLE, r), 5e-3, FITTED),
    "bottle, 1 % strays": (lambda r: made(BOTTLE, r, strays=0.01), 5e-3, FITTED),
    "bottle, bottom missing": (lambda r: made(BOTTLE, r, keep=above(5e-4)), 5e-3, FITTED),
    "bottle, density 30 to 1": (lambda r: made(BOTTLE, r, keep=denser), 5e-3, FITTED),
    "box": (lambda r: made(BOX, r), 5e-3, FITTED),
    "box, bottom missing": (lambda r: made(BOX, r, keep=above(-0.0795)), 5e-3, FITTED),
    "pen": (lambda r: made(PEN, r), 5e-3, FITTED),
    "sheet of 4 mm": (lambda r: made(SHEET, r), 5e-3, REFUSED),
    "sheet of 4 mm, 1.5 mm asked": (lambda r: made(SHEET, r, count=200_000), 1.5e-3, FITTED),
    "open vessel, walls of 3 mm": (lambda r: made(VESSEL, r, count=120_000), 5e-3, REFUSED),
}


def scan(name: str) -> dict[str, Any]:
    """What came of one scan, and how far the surface is from the true one where balls fit."""
    make, radius, expected = SCANS[name]
    cloud = make(radius)
    start = time.perf_counter()
    row: dict[str, Any] = {"points": len(cloud.points), "radius": radius, "expected": expected}
    try:
        fit = jxr.geometry.fit_surface(cloud.points, faces=cloud.faces, smallest_radius=radius)
    except ValueError as error:
        return row | {"seconds": time.perf_counter() - start, "peak": peak(), "refusal": str(error)}
    row |= {"seconds": time.perf_counter() - start, "peak": peak(), "verdict": fit.report.verdict}
    return row | judged(fit, cloud)


def judged(fit: jxr.geometry.SurfaceFit, cloud: Cloud) -> dict[str, Any]:
    """Of a fit: departure, reversed normals and curvatures, from the field alone."""
    field = SplineField(fit.surface.coefficients, fit.surface.origin, fit.surface.step)
    trusted = fit.trusted(cloud.samples)
    seen = cloud.free & trusted
    feet = field.feet(cloud.samples[seen], rounds=6)
    far = np.linalg.norm(feet - cloud.samples[seen], axis=1)
    against = np.sum(field.gradient(feet) * cloud.normals[seen], axis=1) < 0.0
    surface = field.sampled()
    bends = principal_curvatures(field.gradient(surface), field.hessian(surface))
    return {
        "free": float(cloud.free.mean()),
        "untrusted": float(np.mean(~trusted[cloud.free])),
        "departure": float(np.sqrt(np.mean(far**2))),
        "largest": float(far.max()),
        "reversed": int(against.sum()),
        "curvature": float(np.abs(bends).max()),
        "told": float(fit.report.kept[0]) if fit.report.kept else float("nan"),
    }


def pinch() -> dict[str, Any]:
    """The shared banana between two fingertips that are fits to noisy scans themselves, for a second."""
    vertices, faces = scanned.banana()
    body = jxr.geometry.fit_surface(vertices, faces=faces, smallest_radius=scanned.BODY_RADIUS).surface
    grasp, state = scanned.pinched(body, [scanned.thumb(seed).surface for seed in (1, 2)])
    run = jxr.simulate(grasp, state, 1.0, ts=41, record=("multipliers", "energy"))
    left, curves = run.residuals, jxr.loci(grasp, run)
    size = np.abs(run.energy.kinetic + run.energy.potential).max()
    apart = np.abs(np.asarray(curves.tip.arclength) - np.asarray(curves.object.arclength)).max()
    force = np.asarray(run.multipliers.f)
    return {
        "gap": float(max(np.abs(left.normal).max(), np.abs(left.tangential).max())),
        "tangency": float(np.abs(left.tangency).max()),
        "energy": float(np.abs(run.energy.residual).max() / size),
        "lowest": float(scanned.audited(grasp, run.states).min()),
        "arclengths": float(apart),
        "rolled": float(np.asarray(curves.tip.arclength)[:, -1].max()),
        "forces": [float(force.min()), float(force.max())],
    }


def main() -> None:
    words = sys.argv[1:]
    if words[0] == "pinch":
        row = pinch()
    elif words[0] == "million":
        row = million(words[1], int(words[2]), _SHARP if "bounded" in words[3:] else None)
    else:
        row = scan(words[1])
    print(json.dumps(row))


if __name__ == "__main__":
    main()
