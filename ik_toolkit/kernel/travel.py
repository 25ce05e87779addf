"""One step of joints that move to given values, all arriving together, as fast as their limits allow."""

import numpy as np

from .box import UNLIMITED, advance
from .jit import cached


@cached
def travel(q, rate, goal, gamma, h, late, limits):
    """Step q and rate (n,) in place by h [s] towards rest at goal (n,); returns the least time [s] that was left before it.

    The slowest joint moves as fast as its limits (4, n) allow, the others in proportion, so from rest the way is straight. Each
    joint brakes before its goal as before a position limit (`box`); later steps take up to `late` [s]. Kernel units.
    """
    n = q.shape[0]
    inside, x, code, left = limits.copy(), np.empty(n), np.empty(n, np.uint8), 0.0
    for j in range(n):
        x[j] = goal[j] - q[j]
        speed = limits[2, j] if limits[2, j] < np.inf else UNLIMITED
        left = max(left, abs(x[j]) / speed)
        if x[j] > 0.0:
            inside[1, j] = min(goal[j], limits[1, j])
        else:
            inside[0, j] = max(goal[j], limits[0, j])
    for j in range(n):
        x[j] = x[j] / left if left > 0.0 else 0.0
    advance(q, rate, x, gamma, h, late, inside, code)
    return left
