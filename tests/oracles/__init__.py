"""Independent truth: closed forms, second formulations and brute force, shared by tests and benchmarks.

The rule, which `tests/test_oracles.py` keeps: nothing here imports jaxroll, of which not even a contour or an
array type is shared, nor anything else of this repository outside this package. What an oracle and the engine
both need is written twice, the second time from its source; only numbers that say which scene is meant may
agree. NumPy and SciPy do the arithmetic, and JAX, in `chapter_part2` alone, differentiates closed forms. Such
grasps and contours as are made with jaxroll lie in `tests.subjects`.

| module | holds |
|---|---|
| `chapter_part1` | the chapter's Part 1 in full coordinates, as printed: two fingers pinch a rectangle |
| `chapter_part2` | the chapter's Part 2 in one coordinate: one finger turns a pivoted object |
| `closed_forms_space` | single bodies that roll in space, from textbooks |
| `reference_space` | spatial grasps with contacts located anew at every evaluation, by a null space |
| `dense_impacts` | velocities after an impulse, by one dense linear system |
| `known_curves` | points of ellipse and circle, and how far a contour through them is from the curve |
| `scanned_bodies` | clouds of points of bodies whose distances are known, and where balls fit into these |
| `bands` | matrices in full of which only a band is stored |
| `spline_fields` | fields of B-splines by SciPy, and all of the surface where one is zero |
| `outlines` | random outlines as polygons, and the gap between two by a search over all vertices |
"""
