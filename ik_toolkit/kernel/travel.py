"""One step of joints that move to given values as fast as their limits allow, or along a motion that is known."""

import math

import numpy as np

from .box import UNLIMITED, advance, approach, bending
from .jit import cached, inner, shared

SPARE = 0.1  # share of an acceleration limit that a known motion leaves for making up for what is missing
UNKNOWN = np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0))  # no motion: times, points and rates of `travel`


@cached
def travel(q, rate, goal, times, points, rates, time, gamma, h, late, limits, code):
    """Step q and rate (n,) in place by h [s] towards rest at goal (n,), inside limits (4, n).

    Along a known motion, as it is at `time` [s], until it ends: times (K,), points and rates (K, n), cubic between. Else by
    themselves. Later steps take as long, and at most `late` [s] before limits. code (n,) receives what held a joint back (see
    box.py). Returns the least time [s] left after it, at full speed; -1, and nothing done, where a joint may not move or not go
    there. Kernel units.
    """
    n = q.shape[0]
    for j in range(n):
        if limits[2, j] == 0.0 or limits[0, j] == limits[1, j] or goal[j] < limits[0, j] or goal[j] > limits[1, j]:
            return -1.0
    x = np.empty(n)
    if times.shape[0] > 0 and time < times[times.shape[0] - 1]:
        head_for(q, rate, times, points, rates, time, gamma, h, limits, x)
    else:
        go_straight(q, rate, goal, gamma, h, limits, x)
    advance(q, rate, x, gamma, h, late, limits, code)
    return time_left(q, goal, limits)


@shared
def time_left(q, goal, limits):
    """Least time [s] from q to goal at full speed."""
    left = 0.0
    for j in range(q.shape[0]):
        left = max(left, abs(goal[j] - q[j]) / (limits[2, j] if limits[2, j] < np.inf else UNLIMITED))
    return left


@inner
def go_straight(q, rate, goal, gamma, h, limits, x):
    """Rates x (n,) towards rest at goal: the slowest joint as fast as it can, the others in proportion.

    So from rest the way is straight. Each joint brakes in time to rest there.
    """
    left = time_left(q, goal, limits)
    for j in range(q.shape[0]):
        way = goal[j] - q[j]
        most = approach(abs(way), rate[j] if way > 0.0 else -rate[j], gamma, h, limits[3, j] / bending(gamma), h)
        x[j] = math.copysign(min(abs(way) / left if left > 0.0 else 0.0, most), way)


@inner
def head_for(q, rate, times, points, rates, time, gamma, h, limits, x):
    """Rates x (n,) to where a known motion is at `time`.

    What is missing is made up for as fast as SPARE of the acceleration can end it, at once where there is no such limit: by half
    where the rate alone does not set the next place, as whole corrections of a trapezoid turn round in every step.
    """
    k = 1
    while times[k] < time:
        k += 1
    piece = times[k] - times[k - 1]
    f = (time - times[k - 1]) / piece
    share = 1.0 if gamma == 1.0 else 0.5
    for j in range(q.shape[0]):
        way, d0, d1 = points[k, j] - points[k - 1, j], piece * rates[k - 1, j], piece * rates[k, j]
        a, b = d0 + d1 - 2.0 * way, 3.0 * way - 2.0 * d0 - d1
        point, speed = ((a * f + b) * f + d0) * f + points[k - 1, j], ((3.0 * a * f + 2.0 * b) * f + d0) / piece
        missing = point - q[j] - h * ((1.0 - gamma) * rate[j] + gamma * speed)
        most = approach(abs(missing), 0.0, 1.0, h, SPARE * limits[3, j], h)
        x[j] = speed + math.copysign(min(share * abs(missing) / (gamma * h), most), missing)
