"""Benchmarks: `python -m benchmarks` from the repository root; results are in README.md."""
