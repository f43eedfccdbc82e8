"""The rooms behind `python -m benchmarks.stress`: scenes are drawn, run by the engine, and judged without it.

`planar_scenes`, `hard_scenes` and `spatial_scenes` draw what `structures` lists; `engine_runs` makes grasps
of it and runs them; `judge` and the `judge_*` import nothing of jaxroll; `one_batch` brings these together.
"""
