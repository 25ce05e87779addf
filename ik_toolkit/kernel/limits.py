"""Joint limits and full turns: what holds a joint, how a step ends, which turn of an endless joint is returned."""

import math

import numpy as np

from .jit import inline, jit
from .kinematics import TAU

LARGEST = 1e9  # coordinates from which on a start is refused: an angle there has seven digits after the point


@inline
def middle(lower, upper):
    """Angle next to which full turns bring a joint: the middle of its limits, or half a turn inside a limit alone."""
    if lower == -np.inf:
        return upper - 0.5 * TAU
    return 0.5 * (lower + upper) if upper < np.inf else lower + 0.5 * TAU


@jit
def legal(q0, unit, lower, upper, turns, limits):
    """Whether a start (n,) [rad or m] is finite and, when limits count, inside them."""
    for i in range(q0.shape[0]):
        a = q0[i] / unit[i]
        if not abs(a) < LARGEST or (limits and turns[i] < 1.5 and not lower[i] <= a <= upper[i]):
            return False
    return True


@jit
def neighbourhood(q0, rows, follow, slide, unit, limits, lower, upper, turns, low, high):
    """Fill low, high (n,) with the limits inside which no joint is further than `follow` [rad] or `slide` [m] from q0."""
    for i in range(q0.shape[0]):
        low[i] = slide / unit[i]
    for r in range(rows.shape[0]):
        if rows[r, 9] > 0.0:
            low[int(rows[r, 8])] = follow
    for i in range(q0.shape[0]):
        a = q0[i] / unit[i]
        width = low[i] - 1e-15 * (
            abs(a) + low[i]
        )  # some units in the last place less, so that a caller's own difference holds
        free = turns[i] > 1.5 or not limits
        low[i] = a - width if free else max(a - width, lower[i])
        high[i] = a + width if free else min(a + width, upper[i])


@jit
def held_back(q, low, high, lower, upper, turns, limits, J, e):
    """Joint that the neighbourhood of the start (not a limit) keeps most from lowering the error, -1 when there is none."""
    worst, most = -1, 0.0
    for i in range(q.shape[0]):
        g = J[i, 0] * e.e0 + J[i, 1] * e.e1 + J[i, 2] * e.e2 + J[i, 3] * e.e3 + J[i, 4] * e.e4 + J[i, 5] * e.e5
        free = turns[i] > 1.5 or not limits
        below = g < 0.0 and q[i] <= low[i] and (free or low[i] > lower[i])
        above = g > 0.0 and q[i] >= high[i] and (free or high[i] < upper[i])
        if (below or above) and abs(g) > most:
            worst, most = i, abs(g)
    return worst


@inline
def hold(q, dq, w, lower, upper):
    """Set w = 0 for joints that sit on a limit and are pushed outwards; True when a new one was found."""
    hit = False
    for i in range(q.shape[0]):
        if w[i] > 0.0 and ((q[i] <= lower[i] and dq[i] < 0.0) or (q[i] >= upper[i] and dq[i] > 0.0)):
            w[i] = 0.0
            hit = True
    return hit


@inline
def integrate(q, dq, limits, lower, upper, turns):
    """Add dq to q, inside the limits (joints that can turn fully take the turn inside them).

    A joint that is not to move stays, so an endless one is held at any turn. Returns the largest move and coordinate.
    """
    moved = 0.0
    far = 0.0
    for i in range(q.shape[0]):
        a = q[i] + dq[i]
        if limits and (a < lower[i] or a > upper[i]) and dq[i] != 0.0:
            if turns[i] > 0.0:
                a -= TAU * np.rint((a - middle(lower[i], upper[i])) / TAU)
            a = min(max(a, lower[i]), upper[i])  # after a turn too: it may end a rounding outside
        moved = max(moved, abs(a - q[i]))
        far = far if abs(a) <= far else abs(a)  # keeps a NaN
        q[i] = a
    return moved, far


@jit
def turn(wanted, q, lower, upper, turns):
    """Full turns by which to move a joint so that it comes nearest `wanted` away, inside its limits unless it is endless."""
    k = np.rint(wanted / TAU)
    if turns < 1.5:
        k = min(max(k, math.ceil((lower - q) / TAU)), math.floor((upper - q) / TAU))
    return k


@inline
def face(q, wanted, lower, upper, turns):
    """Of the same answer several turns away, make q the legal one nearest `wanted` (n,); True when q changed."""
    turned = False
    for i in range(q.shape[0]):
        if turns[i] > 0.0:
            k = turn(wanted[i] - q[i], q[i], lower[i], upper[i], turns[i])
            if k != 0.0:
                q[i] += k * TAU
                if turns[i] < 1.5:  # rounding may end outside
                    q[i] = min(max(q[i], lower[i]), upper[i])
                turned = True
    return turned
