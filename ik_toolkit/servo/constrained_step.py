"""One step of joint rates inside a box and half-planes: the task first, then closeness to a rate that is wanted.

Pure linear algebra; what the box and the half-planes come from is the caller's. It is one problem of two levels
(hierarchical_qp.py), never a weighted sum of the two. Where the task cannot be met, it is solved once more, damped by what is
left (`damp`); where half-planes contradict each other or the box, with half-planes loosened by the least slack.

Each row of the task has a weight of its own. LEAVE: all that is missed counts alike. DIRECT: what leaves the direction asked for
counts more than falling behind along it (`keep_straight`).
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.jit import build, compiled, inline, inner, spliced
from ..kernel.records import Array, copy
from .equality_qp import dot, problem_on, problem_space, resized, square
from .hierarchical_qp import CONTRADICTION, DONE, SAME_TASK, solve_levels, unmet

LEAVE, DIRECT = range(2)
WANTED, MET, SHORT, RELAXED, INEXACT = range(5)
LOOSE = 1e-9  # half-planes are loosened by this much more than the least slack, so that their gap exceeds rounding
CAUTIOUS = 1.5  # times the bound of the curvature left out, see `damping`
STRAIGHT = 100.0  # weight of leaving the direction asked for against falling behind along it, where nothing is blocked


@compiled
class TaskRate(NamedTuple):
    """What is asked of n joints by a task of m rows."""

    J: Array  # (n, m) Jacobian, one joint a row
    weight: Array  # (m,) of what counts, 0 where it does not
    ask: Array  # (m,) rate of the task
    want: Array  # (n,) joint rates wanted
    aside: Array  # (n,) the part of them along singular directions, which are out of the task
    size: Array  # (n,) a speed for each joint, in which its motion is measured
    mode: int  # LEAVE, DIRECT
    h: float  # [s] time in which motion is damped by what is left of the task, 0: it is not
    mu: float  # above 0: the task is damped by this from the first


@compiled
class Allowed(NamedTuple):
    """Which joint rates are: floor <= x <= roof (n,), planes[:rows] x <= edges[:rows]."""

    floor: Array
    roof: Array
    planes: Array
    edges: Array
    rows: int


@compiled
class StepTaken(NamedTuple):
    """What becomes of it; what holds is where the next step begins."""

    x: Array  # (n,) joint rates
    active: Array  # (n,) int8: -1 at the floor, 1 at the roof, 2 in a half-plane that holds
    kept: Array  # (rows,) int8: 1 where a half-plane holds


@inline
def room_space(n, m, rows):
    """Length of a block that has room for `room_on`."""
    return problem_space(n + m + 1, rows + m + 1)


@spliced
def room_on(block, n, m, rows):
    """Room for n joints, a task of m and so many half-planes, cut from a block of zeros."""
    return problem_on(block, n + m + 1, rows + m + 1)


@build
def make_room(n, m, rows):
    """The same with its own block, for code that runs on arrays and counts references."""
    return room_on(np.zeros(room_space(n, m, rows)), n, m, rows)


@inline
def fitting(asked, allowed):
    """Whether the rate wanted is inside and does the task, so that it can be taken bit for bit."""
    J, want = asked.J, asked.want
    for i in range(want.shape[0]):
        if not allowed.floor[i] <= want[i] <= allowed.roof[i]:
            return False
    for k in range(allowed.rows):
        if not dot(allowed.planes, k, want, want.shape[0]) <= allowed.edges[k]:
            return False
    miss, size = 0.0, 0.0
    for k in range(J.shape[1]):
        s = -asked.ask[k]
        for i in range(J.shape[0]):
            s += J[i, k] * want[i]
        miss += (asked.weight[k] * s) ** 2
        size += (asked.weight[k] * asked.ask[k]) ** 2
    return miss <= SAME_TASK * SAME_TASK * size


@inline
def lay_out(asked, allowed, loose, fastest, room):
    """Write the problem in unknowns that are shares of each joint's speed, or, above 0, all of the fastest one's."""
    u, r, J, count, n = room.u, room.r, asked.J, allowed.rows, asked.J.shape[0]
    for i in range(n):
        size = fastest if fastest > 0.0 else asked.size[i]
        u.want[i], u.floor[i], u.roof[i] = asked.want[i] / size, allowed.floor[i] / size, allowed.roof[i] / size
    for k in range(count):
        for i in range(n):
            r.P[k, i] = allowed.planes[k, i] * (fastest if fastest > 0.0 else asked.size[i])
        length = math.sqrt(square(r.P, k, n))
        r.rhs[k] = allowed.edges[k] / length + loose if length > 0.0 else max(allowed.edges[k], 0.0)
        for i in range(n):
            r.P[k, i] = r.P[k, i] / length if length > 0.0 else 0.0
    k = count
    for c in range(J.shape[1]):
        for i in range(n):
            r.P[k, i] = asked.weight[c] * J[i, c] * (fastest if fastest > 0.0 else asked.size[i])
        r.rhs[k] = asked.weight[c] * asked.ask[c]
        if square(r.P, k, n) > 0.0:  # what no joint moves is not asked for
            k += 1
    return k - count


@inline
def share_allowed(asked, allowed):
    """Share of the rates wanted, or of as much of them as joints at full speed could do, that box and half-planes allow."""
    want, pace, share = asked.want, 1.0, 1.0
    for i in range(want.shape[0]):
        if abs(want[i]) > asked.size[i]:
            pace = min(pace, asked.size[i] / abs(want[i]))
    for i in range(want.shape[0]):
        most = max(allowed.roof[i] if want[i] > 0.0 else -allowed.floor[i], 0.0)
        if pace * abs(want[i]) > most:
            share = min(share, most / (pace * abs(want[i])))
    for k in range(allowed.rows):
        over, most = pace * dot(allowed.planes, k, want, want.shape[0]), max(allowed.edges[k], 0.0)
        if over > most:
            share = min(share, most / over)
    return share


@inline
def keep_straight(p, share):
    """Weight what leaves the direction asked for: STRAIGHT where nothing is blocked, 1 where nothing can be done along it.

    Without it the tip leaves a line that is too fast for the joints (tests/servo/test_motion_limits.py). With acceleration limits
    it does less: these block most of what is asked while joints start and brake.
    """
    r, asked = p.r, 0.0
    for k in range(p.planes, p.planes + p.task):
        asked += r.rhs[k] * r.rhs[k]
    weight = 1.0 + (STRAIGHT - 1.0) * share
    for i in range(p.size if asked > 0.0 else 0):
        s = 0.0
        for k in range(p.planes, p.planes + p.task):
            s += r.rhs[k] * r.P[k, i]
        s *= (weight - 1.0) / asked
        for k in range(p.planes, p.planes + p.task):
            r.P[k, i] = weight * r.P[k, i] - s * r.rhs[k]


@inline
def damp(p, aside, fastest, mu):
    """The problem of |C y - d|^2 + mu |y - aside|^2 (Levenberg and Marquardt).

    What each row of the task misses is an unknown, in units of the root of mu, so that the task can always be met.
    """
    u, r, n, unit = p.u, p.r, p.size, math.sqrt(mu)
    for i in range(n):
        u.want[i] = aside[i] / fastest
    for k in range(p.planes + p.task):
        for j in range(p.task):
            r.P[k, n + j] = unit if k == p.planes + j else 0.0
    for j in range(n, n + p.task):
        u.held[j], u.want[j], u.floor[j], u.roof[j] = 0, 0.0, -np.inf, np.inf
    return resized(p, n + p.task, p.planes, p.task)


@inner
def least_slack(p):
    """By how much half-planes must be loosened at least to leave a point of the box: unknown n, the only task."""
    u, r, n = p.u, p.r, p.size
    for i in range(n):
        u.want[i] = min(max(u.want[i], u.floor[i]), u.roof[i])
        r.P[p.planes, i], u.held[i] = 0.0, 0
    for k in range(p.planes):
        r.P[k, n] = -1.0 if square(r.P, k, n) > 0.0 else 0.0
        r.holds[k] = 0
    r.P[p.planes, n], r.rhs[p.planes] = 1.0, 0.0
    u.want[n], u.floor[n], u.roof[n], u.held[n] = 0.0, 0.0, np.inf, 0
    solve_levels(resized(p, n + 1, p.planes, 1))
    return u.y[n] * (1.0 + LOOSE) + LOOSE


@inline
def as_wanted(asked, taken):
    """The rate wanted, bit for bit; no constraint is active."""
    copy(asked.want, taken.x)
    for i in range(taken.x.shape[0]):
        taken.active[i] = 0
    for k in range(taken.kept.shape[0]):
        taken.kept[k] = 0


@inline
def recall(room, rows, taken):
    """Start from what held at the end of the last step."""
    for i in range(taken.active.shape[0]):
        room.u.held[i] = taken.active[i] if taken.active[i] < 2 else 0
    for k in range(rows):
        room.r.holds[k] = taken.kept[k]


@inline
def answer(p, asked, allowed, fastest, taken):
    """Write the rate that was found, and what holds, in the caller's units."""
    u, r = p.u, p.r
    for i in range(taken.x.shape[0]):
        size = fastest if fastest > 0.0 else asked.size[i]
        taken.active[i] = u.held[i]
        if u.held[i] == 0:
            taken.x[i] = min(max(u.y[i] * size, allowed.floor[i]), allowed.roof[i])
        else:
            taken.x[i] = allowed.roof[i] if u.held[i] > 0 else allowed.floor[i]
    for k in range(taken.kept.shape[0]):
        taken.kept[k] = r.holds[k] if k < p.planes else 0
        for i in range(taken.x.shape[0]):
            if taken.kept[k] != 0 and taken.active[i] == 0 and allowed.planes[k, i] != 0.0:
                taken.active[i] = 2


@inline
def damping(p, asked):
    """How much what the task misses damps the motion, and the speed of the fastest joint.

    The curvature of the tip's way that C leaves out is at most that of a circle of one kernel unit, the same for all joints,
    however slow they are. Two thirds of the way (`Weak.caution`) are taken, as whole ways zigzag.
    """
    miss, heavy, fastest = 0.0, 0.0, 0.0
    for k in range(p.planes, p.planes + p.task):
        miss += p.r.new.first[k] ** 2
    for k in range(asked.weight.shape[0]):
        heavy = max(heavy, asked.weight[k])
    for i in range(asked.size.shape[0]):
        fastest = max(fastest, asked.size[i])
    return CAUTIOUS * asked.h * math.sqrt(miss) * heavy * fastest * fastest, fastest


@inner
def constrain(asked, allowed, room, taken):
    """Take the rate that does the task as well as possible, then is nearest to the one wanted; return how it ended.

    Status WANTED: it is the one wanted, bit for bit, which lies inside and does the task. MET: the task is done.
    SHORT: not all of it can be; then what is missed damps the motion, as in `damp`: undamped, joints go to and fro at
    full speed for the last bit of the task (tests/servo/test_chatter.py: ur5, a fast vibration). RELAXED: the half-planes
    contradict each other or the box and were loosened (tests/servo/test_obstacles.py). INEXACT: no optimum was found in the
    iterations allowed, the rate is only inside the box.
    """
    if fitting(asked, allowed):
        as_wanted(asked, taken)
        return WANTED
    n, mu, loose, fastest, short = asked.J.shape[0], asked.mu, 0.0, 0.0, asked.mu > 0.0
    share = share_allowed(asked, allowed) if asked.mode == DIRECT and mu == 0.0 else 0.0
    recall(room, allowed.rows, taken)
    while True:
        p = resized(room, n, allowed.rows, lay_out(asked, allowed, loose, fastest, room))
        if share > 0.0:
            keep_straight(p, share)
        if mu > 0.0:
            p = damp(p, asked.aside, fastest if fastest > 0.0 else 1.0, mu)
        end = solve_levels(p)
        if end == CONTRADICTION and loose == 0.0:
            loose = least_slack(resized(p, n, allowed.rows, 1))
            continue
        if end != DONE or mu > 0.0:
            break
        short = unmet(p)
        if not short or asked.h == 0.0:
            break
        mu, fastest = damping(p, asked)
    answer(p, asked, allowed, fastest, taken)
    return INEXACT if end != DONE else RELAXED if loose > 0.0 else SHORT if short else MET
