"""One step and the full brake after it, as a path: what must be free of contact before the step is taken."""

import numpy as np

from .box import advance
from .jit import cached, dual


@dual
def travelled(start, change, f):
    """How far a joint has gone a fraction f into a piece: its speed grows evenly from `start` by `change` [per piece]."""
    there = start * f + 0.5 * change * f * f
    turn = -start / change if change != 0.0 else -1.0
    if 0.0 < turn < f:  # it reverses on the way
        far = 0.5 * start * turn
        return abs(far) + abs(there - far)
    return abs(there)


@dual
def speeds(Q, R, k, j, gamma, h):
    """Speed of joint j at the start of piece k and its growth [per piece], as the methods assume (see `interpolate`)."""
    move = Q[k + 1, j] - Q[k, j]
    start = move if gamma == 1.0 else h * R[k, j]
    return start, 2.0 * (move - start)


@dual
def position(Q, R, L, k, j, gamma, h, f):
    """Value of joint j a fraction f into piece k, and how far it has gone by then."""
    start, change = speeds(Q, R, k, j, gamma, h)
    return Q[k, j] + start * f + 0.5 * change * f * f, L[k, j] + travelled(start, change, f)


@cached
def brake(first, gamma, h, late, limits, Q, R, L):
    """Continue a motion by braking fully; returns the number of pieces of h [s] (1 or more) until all rests, or -1.

    Rows of Q, R (K, n): joint values and rates between the pieces, given up to row `first`; of L (K, n): how far each joint
    has gone by then. Each joint brakes as `advance` brakes it when no rate is wanted, inside limits (4, n),
    with later steps of up to `late` [s]. One unit a joint.
    """
    n = Q.shape[1]
    x, code, now, speed = np.empty(n), np.empty(n, np.uint8), Q[first].copy(), R[first].copy()
    for j in range(n):
        L[0, j] = 0.0
    for k in range(Q.shape[0]):
        moving = False
        for j in range(n):
            if k > first:
                Q[k, j], R[k, j] = now[j], speed[j]
            if k > 0:
                start, change = speeds(Q, R, k - 1, j, gamma, h)
                L[k, j] = L[k - 1, j] + travelled(start, change, 1.0)
            moving = moving or R[k, j] != 0.0
        if k >= first:
            if k > 0 and not moving:
                return k
            x[:] = 0.0
            advance(now, speed, x, gamma, h, late, limits, code)
    return -1


@cached
def along(Q, R, L, gamma, h, u, q, length) -> None:
    """Joint values q (n,) u pieces along a path of `brake`, and how far (n,) each joint has gone by then."""
    k = min(int(u), Q.shape[0] - 2)
    for j in range(q.shape[0]):
        q[j], length[j] = position(Q, R, L, k, j, gamma, h, u - k)
