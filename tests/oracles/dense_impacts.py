"""Velocities after an impulse, as one linear system of NumPy."""

import numpy as np


def dense_strike(M, A, v, p):
    """v+ and the contact impulses: M (v+ - v) = p + A^T mu with A v+ = 0, as one linear system."""
    n, m = len(v), len(A)
    saddle = np.block([[M, -A.T], [A, np.zeros((m, m))]])
    found = np.linalg.solve(saddle, np.concatenate([M @ v + p, np.zeros(m)]))
    return found[:n], found[n:]
