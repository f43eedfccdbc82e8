"""Points spread over shapes, of which fits are made."""

import numpy as np


def sphere(count, radius=1.0):
    """Even directions, by the golden angle."""
    height = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    turn = np.pi * (1.0 + 5.0**0.5) * np.arange(count)
    flat = np.sqrt(1.0 - height**2)
    return radius * np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
