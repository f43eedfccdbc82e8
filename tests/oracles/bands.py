"""Matrices in full of which only a band is stored."""

import numpy as np


def full(band):
    """A symmetric matrix from its lower band."""
    size = band.shape[1]
    matrix = np.zeros((size, size))
    for k, row in enumerate(band[:size]):
        matrix[np.arange(k, size), np.arange(size - k)] = row[: size - k]
        assert not row[size - k :].any() or k == 0
    return matrix + np.tril(matrix, -1).T
