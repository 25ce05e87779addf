"""Joint limits and full turns: what holds a joint, how a step ends, which turn of an endless joint is returned."""

import math

import numpy as np

from ..compile.jit import inline, inner
from .kinematics import TAU

LARGEST = 1e9  # coordinates above which a start is refused: an angle of that size has seven digits after the point
LIGHTEST = 1e-12  # smaller joint weights count as this one in a distance: a held joint does not move anyway


@inline
def middle(lower, upper):
    """Angle next to which full turns bring a joint: the middle of its limits, or half a turn inside a limit alone."""
    if lower == -np.inf:
        return upper - 0.5 * TAU
    return 0.5 * (lower + upper) if upper < np.inf else lower + 0.5 * TAU


@inner
def legal(q0, ends, limits):
    """Whether a start (n,) [rad or m] is finite and, when limits count, inside them."""
    for i in range(q0.shape[0]):
        a = q0[i] / ends.unit(i)
        if not abs(a) < LARGEST or (limits and ends.turns(i) < 1.5 and not ends.lower(i) <= a <= ends.upper(i)):
            return False
    return True


@inner
def neighbourhood(q0, rows, follow, slide, limits, ends, near):
    """Confine `near` to the limits inside which no joint is further than `follow` [rad] or `slide` [m] from q0."""
    for i in range(q0.shape[0]):
        turning = False
        for r in range(rows.shape[0]):
            turning = turning or (int(rows[r, 8]) == i and rows[r, 9] > 0.0)
        a = q0[i] / ends.unit(i)
        width = follow if turning else slide / ends.unit(i)
        # A few units in the last place less, so that the difference holds when a caller computes it.
        width -= 1e-15 * (abs(a) + width)
        free = ends.turns(i) > 1.5 or not limits
        low = a - width if free else max(a - width, ends.lower(i))
        near.confine(i, low, a + width if free else min(a + width, ends.upper(i)))


@inner
def held_back(p, look, near, ends, limits):
    """Joint that the neighbourhood of the start (not a limit) hinders most from lowering the error, or -1."""
    q = p.desk.q
    worst, most = -1, 0.0
    for i in range(q.shape[0]):
        g = p.slope(look, i)
        free = ends.turns(i) > 1.5 or not limits
        below = g < 0.0 and q[i] <= near.lower(i) and (free or near.lower(i) > ends.lower(i))
        above = g > 0.0 and q[i] >= near.upper(i) and (free or near.upper(i) < ends.upper(i))
        if (below or above) and abs(g) > most:
            worst, most = i, abs(g)
    return worst


@inline
def hold(q, dq, w, ends):
    """Set w = 0 for joints that are at a limit and pushed outwards; True when a new one was found."""
    hit = False
    for i in range(q.shape[0]):
        if w[i] > 0.0 and ((q[i] <= ends.lower(i) and dq[i] < 0.0) or (q[i] >= ends.upper(i) and dq[i] > 0.0)):
            w[i] = 0.0
            hit = True
    return hit


@inline
def integrate(q, dq, limits, ends):
    """Add dq to q, inside the limits (joints that can turn fully take the turn inside them).

    A held joint stays where it is, so an endless one is held at any turn. Returns the largest move and coordinate.
    """
    moved = 0.0
    far = 0.0
    for i in range(q.shape[0]):
        a = q[i] + dq[i]
        lower, upper = ends.lower(i), ends.upper(i)
        if limits and (a < lower or a > upper) and dq[i] != 0.0:
            if ends.turns(i) > 0.0:
                a -= TAU * np.rint((a - middle(lower, upper)) / TAU)
            a = min(max(a, lower), upper)  # also after a turn: rounding may leave it just outside
        moved = max(moved, abs(a - q[i]))
        far = far if abs(a) <= far or far != far else abs(a)  # a NaN of any joint is kept
        q[i] = a
    return moved, far


@inner
def turn(wanted, q, ends, i):
    """Full turns by which to move joint i so that it comes nearest `wanted` away, inside its limits unless it is endless."""
    k = np.rint(wanted / TAU)
    if ends.turns(i) < 1.5:
        k = min(max(k, math.ceil((ends.lower(i) - q) / TAU)), math.floor((ends.upper(i) - q) / TAU))
    return k


@inner
def other_end(q, start, ends):
    """Bounded joint that ended more than half a turn from where it started, or -1."""
    for i in range(q.shape[0]):
        if 0.0 < ends.turns(i) < 1.5 and abs(q[i] - start[i]) > math.pi:
            return i
    return -1


@inline
def face(q, wanted, ends):
    """Of the same answer several turns away, make q the one within limits that is nearest `wanted` (n,); True when q changed."""
    turned = False
    for i in range(q.shape[0]):
        if ends.turns(i) > 0.0:
            k = turn(wanted[i] - q[i], q[i], ends, i)
            if k != 0.0:
                q[i] += k * TAU
                if ends.turns(i) < 1.5:  # rounding may leave it outside
                    q[i] = min(max(q[i], ends.lower(i)), ends.upper(i))
                turned = True
    return turned


@inner
def distance(q, other, weights, ends):
    """Squared distance of two configurations (n,), each joint on the nearest turn; joints with small weights count more."""
    total = 0.0
    for i in range(q.shape[0]):
        a = q[i] - other[i]
        if ends.turns(i) > 0.0:
            a += TAU * turn(-a, q[i], ends, i)
        total += a * a / max(weights[i], LIGHTEST)
    return total
