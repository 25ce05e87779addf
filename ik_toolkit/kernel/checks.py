"""What is decided about a target or a standstill outside the iteration: rigid, out of reach, why no progress."""

import math

from .jit import jit
from .task import POSE, POSITION

CONVERGED, STALLED, ITERATION_LIMIT, LIMIT_BLOCKED, UNREACHABLE, SINGULAR, NOT_FINITE, CHECK_FAILED = range(8)
LAST_ROW = 1e-9  # how far the last row of a pose may be off 0 0 0 1
FAR = 1e100  # coordinates [m] beyond this are refused: their squares are no numbers
BAD_TARGET, BAD_START = 8, 9  # never seen by a caller: the target or the start needs a look outside the kernel
TOO_FAR = 11  # 10 is COLLISION, found outside the kernel


@jit
def beyond(goal, tip, tail, kind, tol_p, tol_r):
    """Length by which the target lies outside the reach bound (0 = not proven unreachable), in kernel units."""
    worst = 0.0
    if kind > POSITION:
        return worst
    for k in range(2 if kind == POSE else 1):
        x, y, z = goal[9], goal[10], goal[11]
        slack = tol_p
        if k == 1:  # the last joint's point is fixed by the pose: the arm without its tool must reach it
            for r in range(3):
                g = goal[3 * r] * tip[9] + goal[3 * r + 1] * tip[10] + goal[3 * r + 2] * tip[11]
                if r == 0:
                    x -= g
                elif r == 1:
                    y -= g
                else:
                    z -= g
            slack += tol_r * math.sqrt(tip[9] * tip[9] + tip[10] * tip[10] + tip[11] * tip[11])
        slack += 1e-9
        r2 = x * x + y * y
        nearest_z = min(max(z, tail[5]), tail[6])
        d = math.sqrt(r2 + (z - nearest_z) * (z - nearest_z))
        worst = max(worst, d - tail[1 + 2 * k] - slack)
        far = max(abs(z - tail[5]), abs(z - tail[6]))
        d = math.sqrt(r2 + far * far)
        worst = max(worst, tail[2 + 2 * k] - d - slack)
    return worst


@jit
def edge(goal, tail, excess, kept):
    """Move the goal's point by `excess` towards (or, inside the hole, away from) the first joint; `kept` gets the old one."""
    kept[0], kept[1], kept[2] = goal[9], goal[10], goal[11]
    centre = min(max(goal[11], tail[5]), tail[6])
    d = math.sqrt(goal[9] * goal[9] + goal[10] * goal[10] + (goal[11] - centre) * (goal[11] - centre))
    f = 1.0 - excess / d if d > 0.5 * tail[1] else 1.0 + excess / max(d, 1e-300)
    goal[9] *= f
    goal[10] *= f
    goal[11] = centre + f * (goal[11] - centre)


@jit
def rigid(T):
    """Whether T (4, 4) is finite, its rotation orthonormal to 1e-6 and right-handed, its last row 0 0 0 1 (NaN fails)."""
    total = 0.0
    last = abs(T[3, 3] - 1.0)
    for r in range(3):
        total += abs(T[r, 3])
        last += abs(T[3, r])
        for c in range(r, 3):
            g = T[0, r] * T[0, c] + T[1, r] * T[1, c] + T[2, r] * T[2, c]
            if not abs(g - (1.0 if r == c else 0.0)) < 1e-6:
                return False
    det = T[0, 0] * (T[1, 1] * T[2, 2] - T[1, 2] * T[2, 1]) - T[0, 1] * (T[1, 0] * T[2, 2] - T[1, 2] * T[2, 0])
    det += T[0, 2] * (T[1, 0] * T[2, 1] - T[1, 1] * T[2, 0])
    return det > 0.0 and total < FAR and last < LAST_ROW


@jit
def why(q, lower, upper, J, e, limits):
    """Status of a descent that stands still: blocked by limits, singular (the Jacobian cannot see the error), or stalled."""
    whole, free, size = 0.0, 0.0, 0.0
    for i in range(q.shape[0]):
        g = J[i, 0] * e.e0 + J[i, 1] * e.e1 + J[i, 2] * e.e2 + J[i, 3] * e.e3 + J[i, 4] * e.e4 + J[i, 5] * e.e5
        for k in range(6):
            size += J[i, k] * J[i, k]
        whole += g * g
        if not (limits and ((q[i] <= lower[i] and g < 0.0) or (q[i] >= upper[i] and g > 0.0))):
            free += g * g
    if whole <= 1e-16 * e.ee * size:
        return SINGULAR
    if free < 1e-4 * whole:
        return LIMIT_BLOCKED
    return STALLED
