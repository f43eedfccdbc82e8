"""What tests and benchmarks measure of any function: the order of its errors, the remainders of its slope."""

import jax
import numpy as np


def observed_order(sizes, errors):
    """Slope of log error over log size."""
    return np.polyfit(np.log(sizes), np.log(errors), 1)[0]


def taylor_remainders(function, point, direction, slope, steps):
    """|f(x + h d) - f(x) - h f'(x) d| for each step h."""
    base = function(point)
    move = lambda h: jax.tree.map(lambda a, b: a + h * b, point, direction)  # noqa: E731
    return np.array([float(abs(function(move(h)) - base - h * slope)) for h in steps])
