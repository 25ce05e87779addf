"""A joint motion that brakes to rest, as arrays on which bounds along a motion are tried."""

import numpy as np

from ik_toolkit.kernel.clearance import speed_and_growth, travelled
from ik_toolkit.servo.viability import advance


def brake(first, gamma, h, late, limits, Q, R, L):
    """Brake from row `first` of Q, R (K, n) on, in steps of h [s], and write what each joint has covered to L (K, n).

    Returns the row in which all joints rest (at least 1), -1 if K rows are too few.
    """
    n = Q.shape[1]
    for k in range(len(Q)):
        if k > first:
            Q[k], R[k] = Q[k - 1], R[k - 1]
            advance(Q[k], R[k], np.zeros(n), gamma, h, late, limits, np.empty(n, np.uint8))
        L[k] = [
            L[k - 1, j] + travelled(*speed_and_growth(Q, R, k - 1, j, gamma, h), 1.0) if k else 0.0 for j in range(n)
        ]
        if k >= max(first, 1) and not R[k].any():
            return k
    return -1
