"""Contenders: the problems of the runners by other engines, by libraries, and by hand.

Modules are named after what is run by what (`disc_exudyn`, `pinch_numba`). The runners, `python -m
benchmarks.NAME`, time and compare them. An engine that may be missing is imported once it is needed.
"""
