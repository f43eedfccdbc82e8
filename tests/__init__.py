"""Tests: `pytest` from the repository root. `oracles` know the answers, `subjects` are what is examined."""
