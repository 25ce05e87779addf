"""One step of joints that move to given values as fast as their limits allow, or along a motion that is known."""

import math

import numpy as np

from .box import UNLIMITED, advance, approach, bending
from .jit import cached

SPARE = 0.1  # share of an acceleration limit that a known motion leaves for making up for what is missing


@cached
def travel(q, rate, goal, gamma, h, late, limits):
    """Step q and rate (n,) in place by h [s] towards rest at goal (n,); returns the least time [s] that was left before it.

    The slowest joint moves as fast as its limits (4, n) allow, the others in proportion, so from rest the way is straight. Each
    joint brakes in time to rest there; later steps take as long, and at most `late` [s] before limits. Kernel units.
    """
    n = q.shape[0]
    x, code, left = np.empty(n), np.empty(n, np.uint8), 0.0
    for j in range(n):
        speed = limits[2, j] if limits[2, j] < np.inf else UNLIMITED
        left = max(left, abs(goal[j] - q[j]) / speed)
    for j in range(n):
        way = goal[j] - q[j]
        most = approach(abs(way), rate[j] if way > 0.0 else -rate[j], gamma, h, limits[3, j] / bending(gamma), h)
        x[j] = math.copysign(min(abs(way) / left if left > 0.0 else 0.0, most), way)
    advance(q, rate, x, gamma, h, late, limits, code)
    return left


@cached
def head_for(q, rate, point, speed, gamma, h, late, limits):
    """Step q and rate (n,) in place by h [s] to where a known motion then is, at point (n,) with speed (n,), inside limits (4, n).

    What is missing is made up for as fast as SPARE of the acceleration can end it, at once where there is no such limit: by half
    where the rate alone does not set the next place, as whole corrections of a trapezoid turn round in every step. Kernel units.
    """
    n = q.shape[0]
    x, code = np.empty(n), np.empty(n, np.uint8)
    share = 1.0 if gamma == 1.0 else 0.5
    for j in range(n):
        missing = point[j] - q[j] - h * ((1.0 - gamma) * rate[j] + gamma * speed[j])
        most = approach(abs(missing), 0.0, 1.0, h, SPARE * limits[3, j], h)
        x[j] = speed[j] + math.copysign(min(share * abs(missing) / (gamma * h), most), missing)
    advance(q, rate, x, gamma, h, late, limits, code)
