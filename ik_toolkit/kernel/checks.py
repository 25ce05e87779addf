"""Decisions about a target outside the iteration: whether it is a pose, and whether it is in reach."""

import math

from ..compile.jit import cached, inner
from .algebra import V3, at3, put3, rotation_at
from .counted_error import allowance
from .records import WHAT

CONVERGED, STALLED, ITERATION_LIMIT, LIMIT_BLOCKED, UNREACHABLE, SINGULAR, NOT_FINITE, CHECK_FAILED = range(8)
BAD_TARGET, BAD_START = 8, 9  # never seen by a caller: the target or the start must be examined outside the kernel
TOO_FAR = 11  # 10 is COLLISION, found outside the kernel
ORTHONORMAL = 1e-6  # how far products of the axes of a pose may be off 0 and 1
LAST_ROW = 1e-9  # how far its last row may be off 0 0 0 1
REACH_SLACK = 1e-9  # [kernel units] more than any rounding of the bound: "unreachable" is a proof
WIDE = 2.0  # rad of remaining rotation above which it gives no bound on the last joint's place: a chord is never longer
UNSEEN = 1e-16  # cos^2 of the angle between error and what the joints can do, below which that is rounding
BLOCKED = 1e-4  # share of the squared gradient left to free joints, below which the attempt counts as held by limits
FAR = 1e100  # coordinates [m] beyond this are refused: their squares would overflow


@inner
def ring(p, reach, hole, ends, slack):
    """Length by which a point lies outside the reach, or inside the hole, of an arm whose foot a lift may move."""
    across = p.x * p.x + p.y * p.y
    low, high = ends.bound(4), ends.bound(5)
    near = p.z - min(max(p.z, low), high)
    far = max(abs(p.z - low), abs(p.z - high))
    return max(math.sqrt(across + near * near) - reach, hole - math.sqrt(across + far * far)) - slack


@inner
def beyond(goal, ends, task, tol_p, tol_r):
    """Length by which the target lies outside the reach bound (0 = not proven unreachable), in kernel units.

    A tip whose errors are inside what the task and the tolerances allow is no further than that from the target's point. The
    last joint's point is fixed by the pose, up to the part of the tool across a free turn: the arm without its tool must reach it.
    """
    point, slack = at3(goal, 9), allowance(task, 0, tol_p) + REACH_SLACK
    if not slack < math.inf:
        return 0.0
    worst = max(0.0, ring(point, ends.bound(0), ends.bound(1), ends, slack))
    angle = allowance(task, 3, tol_r)
    if angle < WIDE:
        tool, side = at3(ends.flat, 21), 0.0
        if task[WHAT.free] > 0.0:
            axis = at3(task, WHAT.ax)
            along = axis * axis.dot(tool)
            side = math.sqrt((tool - along).square())
            tool = along
        wrist = point - rotation_at(goal, 0).times(tool)
        slack += angle * math.sqrt(tool.square()) + side
        worst = max(worst, ring(wrist, ends.bound(2), ends.bound(3), ends, slack))
    return worst


@inner
def edge(goal, ends, excess):
    """Move the goal's point by `excess` towards (or, inside the hole, away from) the first joint."""
    p = at3(goal, 9)
    centre = V3(0.0, 0.0, min(max(p.z, ends.bound(4)), ends.bound(5)))
    out = p - centre
    d = math.sqrt(out.square())
    put3(goal, 9, centre + out * (1.0 - excess / d if d > 0.5 * ends.bound(0) else 1.0 + excess / max(d, 1e-300)))


@inner
def rigid(T, within):
    """Whether T (4, 4) is finite, its rotation orthonormal to `within` and right-handed, its last row 0 0 0 1 (NaN fails)."""
    total = 0.0
    last = abs(T[3, 3] - 1.0)
    for r in range(3):
        total += abs(T[r, 3])
        last += abs(T[3, r])
        for c in range(r, 3):
            g = T[0, r] * T[0, c] + T[1, r] * T[1, c] + T[2, r] * T[2, c]
            if not abs(g - (1.0 if r == c else 0.0)) < within:
                return False
    det = T[0, 0] * (T[1, 1] * T[2, 2] - T[1, 2] * T[2, 1]) - T[0, 1] * (T[1, 0] * T[2, 2] - T[1, 2] * T[2, 0])
    det += T[0, 2] * (T[1, 0] * T[2, 1] - T[1, 1] * T[2, 0])
    return det > 0.0 and total < FAR and last < LAST_ROW


@cached
def is_rigid(T):
    """`rigid` for calls from Python."""
    return rigid(T, ORTHONORMAL)


@inner
def standstill(p, look, near, boxed):
    """Why an attempt makes no progress, after p.jacobian: blocked by limits, singular (no joint sees the error), or stalled."""
    q, J = p.desk.q, p.desk.J
    whole, free, size = 0.0, 0.0, 0.0
    for i in range(q.shape[0]):
        g = p.slope(look, i)
        for k in range(J.shape[1]):
            size += J[i, k] * J[i, k]
        whole += g * g
        if not (boxed and ((q[i] <= near.lower(i) and g < 0.0) or (q[i] >= near.upper(i) and g > 0.0))):
            free += g * g
    if whole <= UNSEEN * look.ee * size:
        return SINGULAR
    return LIMIT_BLOCKED if free < BLOCKED * whole else STALLED
