"""Symmetric banded systems: Cholesky of a band, in place, allocating nothing.

A band of half width b keeps row i of the lower half as A[i, k - i + b] for the columns k = i - b ... i, so that the sums below run
through memory in order.
"""

import math

from .jit import inner


@inner
def band_cholesky(A, least):
    """Factor a band A (M, b + 1) in place; pivots below `least` are raised to it."""
    b = A.shape[1] - 1
    for i in range(A.shape[0]):
        first = max(0, i - b)
        for j in range(first, i):
            s = A[i, j - i + b]
            for k in range(first, j):
                s -= A[i, k - i + b] * A[j, k - j + b]
            A[i, j - i + b] = s * A[j, b]
        s = A[i, b]
        for k in range(first, i):
            s -= A[i, k - i + b] * A[i, k - i + b]
        A[i, b] = 1.0 / math.sqrt(max(s, least))  # the diagonal is kept inverted: divisions are slow


@inner
def band_solve(A, x):
    """Replace x (M,) by the solution of the system whose factor `band_cholesky` left in A."""
    b = A.shape[1] - 1
    for i in range(A.shape[0]):
        s = x[i]
        for k in range(max(0, i - b), i):
            s -= A[i, k - i + b] * x[k]
        x[i] = s * A[i, b]
    for i in range(A.shape[0] - 1, -1, -1):
        x[i] *= A[i, b]
        for k in range(max(0, i - b), i):
            x[k] -= A[i, k - i + b] * x[i]
