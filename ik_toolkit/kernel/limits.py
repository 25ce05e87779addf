"""Joint limits and wrapping: which joints are held, where a step ends, and which of the angles q + 2 pi k is returned."""

import math
from typing import NamedTuple

import numpy as np

from ..compile.jit import compiled, inline, inner
from .kinematics import TAU

# A start with a larger coordinate [rad or arm reaches] is refused: such an angle has only seven digits after the decimal point.
LARGEST = 1e9
LIGHTEST = 1e-12  # smallest joint weight in a distance, which avoids a division by the weight 0 of a held joint


@compiled
class LimitRows(NamedTuple):
    """Indices of the rows of an array of limits (4, n) [rad or arm reaches, per s, per s^2], as in limits[LIMIT.speed, i]."""

    # The field is not called `lower`, because numba would take it for a method of this name in another record, such as
    # `Ends.lower`.
    lowest: int = 0
    highest: int = 1
    speed: int = 2
    acceleration: int = 3


LIMIT = LimitRows()


@inline
def middle(lower, upper):
    """Return the angle around which a joint is wrapped by 2 pi: the middle of its limits, or half a turn inside its only limit."""
    if lower == -np.inf:
        return upper - 0.5 * TAU
    return 0.5 * (lower + upper) if upper < np.inf else lower + 0.5 * TAU


@inner
def legal(q0, ends, limits):
    """Return whether a start q0 (n,) [rad or m] is finite and, if `limits` is true, inside the joint limits `ends` (Ends)."""
    for i in range(q0.shape[0]):
        a = q0[i] / ends.unit(i)
        if not abs(a) < LARGEST or (limits and ends.turns(i) < 1.5 and not ends.lower(i) <= a <= ends.upper(i)):
            return False
    return True


@inner
def neighbourhood(q0, rows, follow, slide, limits, ends, near):
    """Set the limits `near` (Ends) so that no joint moves further than `follow` [rad] or `slide` [m] from the start q0.

    q0: (n,) start [rad or m]; rows: (L, 10) geometry; limits: whether the joint limits `ends` (Ends) must be kept, too.
    """
    for i in range(q0.shape[0]):
        turning = False
        for r in range(rows.shape[0]):
            turning = turning or (int(rows[r, 8]) == i and rows[r, 9] > 0.0)
        a = q0[i] / ends.unit(i)
        width = follow if turning else slide / ends.unit(i)
        # `width` is lowered by a few units in the last place, so that the distance from q0 that a caller computes is never above
        # the limit by rounding.
        width -= 1e-15 * (abs(a) + width)
        free = ends.turns(i) > 1.5 or not limits
        low = a - width if free else max(a - width, ends.lower(i))
        near.confine(i, low, a + width if free else min(a + width, ends.upper(i)))


@inner
def held_back(p, look, near, ends, limits):
    """Return the joint that would lower the error most if the option `follow` let it move further, or -1 if there is none.

    p: the problem; look: its errors; near: the limits that the option sets (Ends); ends: the joint limits (Ends); limits: whether
    these are kept.
    """
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
    """Set w[i] to 0 for each joint i at a limit that the step dq pushes outwards; return whether this newly held any joint.

    q, dq, w: (n,) joint values, step and joint weights; ends: the limits (`Ends`, or `null_space.Bounds`).
    """
    hit = False
    for i in range(q.shape[0]):
        if w[i] > 0.0 and ((q[i] <= ends.lower(i) and dq[i] < 0.0) or (q[i] >= ends.upper(i) and dq[i] > 0.0)):
            w[i] = 0.0
            hit = True
    return hit


@inline
def integrate(q, dq, limits, ends):
    """Add the step dq (n,) to q (n,), and if `limits` is true, keep q inside the limits.

    Joints that may wrap are then brought back inside by multiples of 2 pi, and others are clipped. A joint whose dq is 0 keeps its
    value exactly. Returns the largest move of a joint and the largest absolute coordinate. ends: the limits (Ends).
    """
    moved = 0.0
    far = 0.0
    for i in range(q.shape[0]):
        a = q[i] + dq[i]
        lower, upper = ends.lower(i), ends.upper(i)
        if limits and (a < lower or a > upper) and dq[i] != 0.0:
            if ends.turns(i) > 0.0:
                a -= TAU * np.rint((a - middle(lower, upper)) / TAU)
            a = min(max(a, lower), upper)  # Rounding in a shift by 2 pi may bring the value just outside the limits.
        moved = max(moved, abs(a - q[i]))
        # If any coordinate is NaN, `far` becomes NaN and stays so, which tells the caller.
        far = far if abs(a) <= far or far != far else abs(a)
        q[i] = a
    return moved, far


@inner
def turn(wanted, q, ends, i):
    """Return the integer k for which q + 2 pi k, a value of joint i inside its limits (Ends), is nearest to q + `wanted` [rad]."""
    k = np.rint(wanted / TAU)
    if ends.turns(i) < 1.5:
        k = min(max(k, math.ceil((ends.lower(i) - q) / TAU)), math.floor((ends.upper(i) - q) / TAU))
    return k


@inline
def face(q, wanted, ends):
    """Shift each joint of q by a multiple of 2 pi as near as possible to its value in `wanted`, within limits, if it may wrap.

    Returns whether q changed. q, wanted: (n,) joint values; ends: the limits (Ends).
    """
    turned = False
    for i in range(q.shape[0]):
        if ends.turns(i) > 0.0:
            k = turn(wanted[i] - q[i], q[i], ends, i)
            if k != 0.0:
                q[i] += k * TAU
                if ends.turns(i) < 1.5:  # Rounding in a shift by 2 pi may bring the value just outside the limits.
                    q[i] = min(max(q[i], ends.lower(i)), ends.upper(i))
                turned = True
    return turned


@inner
def distance(q, other, weights, ends):
    """Return the squared distance of two configurations: the sum of squared joint differences, each divided by the joint's weight.

    Where a joint may wrap, its difference is the shortest one modulo 2 pi. q, other, weights: (n,); ends: the limits (Ends), which
    say which joints may wrap.
    """
    total = 0.0
    for i in range(q.shape[0]):
        a = q[i] - other[i]
        if ends.turns(i) > 0.0:
            a += TAU * turn(-a, q[i], ends, i)
        total += a * a / max(weights[i], LIGHTEST)
    return total
