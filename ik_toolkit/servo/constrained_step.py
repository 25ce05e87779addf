"""Joint rates of one step inside bounds and inequality constraints: the task first, then closeness to desired rates.

This file is pure linear algebra; callers decide what the bounds and constraints mean. The step is one least-squares
problem with two priority levels (hierarchical_qp.py), never a weighted sum of them. If the task cannot be met, the
problem is solved again with damping in proportion to the remaining error (`damp`). If the inequality constraints
contradict each other or the bounds, they are loosened by the least slack that makes them feasible.

Each row of the task has its own weight. In mode `leave` all errors of the task rate count alike. In mode `direct`, errors
across the direction asked for count more than falling behind along it (`keep_straight`).
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.jit import build, compiled, inline, inner, spliced
from ..kernel.records import Array, copy
from ..kernel.vectors import dot
from .equality_qp import program_on, program_space, resized
from .hierarchical_qp import CONTRADICTION, DONE, SAME_TASK, STUCK, solve_levels, unmet


class StepModes(NamedTuple):
    """What a step gives up where joint limits do not allow the whole tip motion: the values of the tracker's option on_limit."""

    direct: int = 1  # the tip falls behind but keeps its direction
    leave: int = 0  # the error is made as small as possible in this step
    clip: int = 2  # each joint is clipped to its limits on its own, without the optimisation of this file


class StepOutcomes(NamedTuple):
    """Codes by which `constrain` says how well its joint rates do the task; from `short` on, part of the task is not done."""

    wanted: int = 0  # the desired rates are admissible and do the task; they are taken bit for bit
    met: int = 1  # the whole task is done
    # Not all of the task can be done. The motion is then damped in proportion to the remaining error (`damp`), since joints would
    # otherwise go to and fro at full speed to do a little more of the task (tests/servo/test_chatter.py: ur5, a fast vibration).
    short: int = 2
    # the inequalities contradict each other or the bounds, and were loosened (tests/servo/test_obstacles.py)
    relaxed: int = 3
    inexact: int = 4  # the solver found no optimum in the iterations allowed; the rates only keep the bounds


class StepMargins(NamedTuple):
    """Dimensionless constants of the optimisation of a step: two margins for rounding, a factor on damping, and a weight."""

    # inequalities that contradict each other are loosened by this much more than needed, so that a solution exists despite rounding
    loose: float = 1e-9
    # factor on the damping for the curvature that the linear model neglects; without it steps would zigzag; set by hand
    bend: float = 1.5
    # weight of an error across the direction asked for, if nothing is blocked; falling behind along it has weight 1; set by hand
    straight: float = 100.0
    # least damping of a task that rounding leaves undetermined, as a share of its longest row squared; without it 21 and 36 of the
    # 180 steps with a singular value of 1e-8 and 1e-7 in tests/kernel/test_constrain.py found no optimum
    light: float = 1e-10


MODE, OUTCOME, CAUTION = StepModes(), StepOutcomes(), StepMargins()


@compiled
class TaskRate(NamedTuple):
    """A task of m rows for n joints: the tip rates asked for, and the desired joint rates."""

    J: Array  # (n, m) transposed Jacobian, one row for each joint
    weight: Array  # (m,) weights of the task's rows; 0: the row does not count
    heavy: Array  # (m,) weight of a row's remaining error in the damping of the motion, see `damping`
    ask: Array  # (m,) rate asked for in each row of the task
    want: Array  # (n,) desired joint rates
    aside: Array  # (n,) part of the desired rates along singular directions, which are left out of the task
    size: Array  # (n,) speed limit (or a typical speed) of each joint, the unit for its rate
    mode: int  # what gives way to limits: MODE.leave or MODE.direct
    h: float  # [s] length of the step, which sets the damping of a task that is not met; 0: no such damping
    mu: float  # damping of the task from the first attempt on; 0: the task is damped only if it is not met


@compiled
class Allowed(NamedTuple):
    """The admissible joint rates x (n,): floor <= x <= roof, and planes x <= edges for the first `rows` of the inequalities."""

    floor: Array
    roof: Array
    planes: Array
    edges: Array
    rows: int


@compiled
class StepTaken(NamedTuple):
    """Joint rates that `constrain` found, and the active set, from which the next step starts (warm start)."""

    x: Array  # (n,) joint rates
    active: Array  # (n,) int8: -1 at its lower bound, 1 at its upper bound, 2 part of an active inequality, 0 free
    kept: Array  # (rows,) int8: 1 if the inequality constraint is active


@inline
def room_space(n, m, rows):
    """Return how many floats the memory of `constrain` takes for n joints, m task rows and `rows` inequalities, see `room_on`."""
    return program_space(n + m + 1, rows + m + 1)


@spliced
def room_on(block, n, m, rows):
    """Divide an array of zeros into the arrays of a `TwoLevels` problem for n joints, m task rows and `rows` inequalities."""
    return program_on(block, n + m + 1, rows + m + 1)


@build
def make_room(n, m, rows):
    """Allocate memory for a `TwoLevels` problem with n joints, m task rows and `rows` inequalities, and return it."""
    return room_on(np.zeros(room_space(n, m, rows)), n, m, rows)


@inline
def fitting(asked, allowed):
    """Return whether the desired joint rates keep all bounds and constraints and do the whole task, so that they can be taken."""
    J, want = asked.J, asked.want
    n, m = J.shape
    for i in range(n):
        if not allowed.floor[i] <= want[i] <= allowed.roof[i]:
            return False
    for k in range(allowed.rows):
        if not dot(allowed.planes[k], want, n) <= allowed.edges[k]:
            return False
    miss, size = 0.0, 0.0
    for k in range(m):
        s = -asked.ask[k]
        for i in range(n):
            s += J[i, k] * want[i]
        miss += (asked.weight[k] * s) ** 2
        size += (asked.weight[k] * asked.ask[k]) ** 2
    return miss <= SAME_TASK * SAME_TASK * size


@inline
def lay_out(room, asked, allowed, loose, fastest):
    """Write the quadratic program to the memory `room`, and return it, without task rows that no joint can change.

    The unknowns are the joint rates divided by the joints' speed limits, or by `fastest` if that is above 0. asked: the task and
    the desired joint rates (`TaskRate`); allowed: bounds and inequalities (`Allowed`); loose: amount by which inequalities are
    loosened.
    """
    J, unit, P, count, n = asked.J, room.scaling, room.P, allowed.rows, asked.J.shape[0]
    for i in range(n):
        unit[i] = fastest if fastest > 0.0 else asked.size[i]
        room.want[i], room.floor[i], room.roof[i] = (
            asked.want[i] / unit[i],
            allowed.floor[i] / unit[i],
            allowed.roof[i] / unit[i],
        )
    for k in range(count):
        for i in range(n):
            P[k, i] = allowed.planes[k, i] * unit[i]
        length = math.sqrt(dot(P[k], P[k], n))
        room.rhs[k] = allowed.edges[k] / length + loose if length > 0.0 else max(allowed.edges[k], 0.0)
        for i in range(n):
            P[k, i] = P[k, i] / length if length > 0.0 else 0.0
    k = count
    for c in range(J.shape[1]):
        for i in range(n):
            P[k, i] = asked.weight[c] * J[i, c] * unit[i]
        room.rhs[k] = asked.weight[c] * asked.ask[c]
        # A task row that no joint can change cannot be met, so the next row overwrites it.
        if dot(P[k], P[k], n) > 0.0:
            k += 1
    return resized(room, n, count, k - count)


@inline
def share_allowed(asked, allowed):
    """Return the largest factor (0 to 1) by which all desired rates asked.want can be multiplied inside bounds and constraints.

    If a rate exceeds the joint's speed limit, all rates are first scaled down by one factor until none does. asked: `TaskRate`;
    allowed: bounds and inequalities (`Allowed`).
    """
    want, pace, share = asked.want, 1.0, 1.0
    for i in range(want.shape[0]):
        if abs(want[i]) > asked.size[i]:
            pace = min(pace, asked.size[i] / abs(want[i]))
    for i in range(want.shape[0]):
        most = max(allowed.roof[i] if want[i] > 0.0 else -allowed.floor[i], 0.0)
        if pace * abs(want[i]) > most:
            share = min(share, most / (pace * abs(want[i])))
    for k in range(allowed.rows):
        over, most = pace * dot(allowed.planes[k], want, want.shape[0]), max(allowed.edges[k], 0.0)
        if over > most:
            share = min(share, most / over)
    return share


@inline
def keep_straight(p, share):
    """Weight the task error across the direction asked for, so that the tip falls behind rather than leaves its path.

    p: the quadratic program (`TwoLevels`), changed in place; share: how much of the motion asked for is possible, from
    `share_allowed`. The weight is CAUTION.straight if nothing is blocked, 1 if no motion along the direction is possible, and
    linear between. Without this weight the tip leaves a line that is too fast for the joints (tests/servo/test_motion_limits.py).
    With acceleration limits the weight is lower, as they block most of the motion asked for while joints start and brake.
    """
    asked, first, end = 0.0, p.planes, p.planes + p.task
    for k in range(first, end):
        asked += p.rhs[k] * p.rhs[k]
    weight = 1.0 + (CAUTION.straight - 1.0) * share
    for i in range(p.size if asked > 0.0 else 0):
        s = 0.0
        for k in range(first, end):
            s += p.rhs[k] * p.P[k, i]
        s *= (weight - 1.0) / asked
        for k in range(first, end):
            p.P[k, i] = weight * p.P[k, i] - s * p.rhs[k]


@inline
def damp(p, aside, mu):
    """Replace the task C y = d of the problem p by min |C y - d|^2 + mu |y - aside|^2 (Levenberg-Marquardt); return the problem.

    y: joint rates in the problem's unit; aside (n,): joint rates towards which the damping draws them. The residual of each task
    row becomes an unknown, scaled by 1 / sqrt(mu). The task can then always be met, and both terms are part of the second
    objective.
    """
    n, unit = p.size, math.sqrt(mu)
    for i in range(n):
        p.want[i] = aside[i] / p.scaling[i]
    for k in range(p.planes + p.task):
        for j in range(p.task):
            p.P[k, n + j] = unit if k == p.planes + j else 0.0
    for j in range(n, n + p.task):
        p.active[p.planes + j], p.want[j], p.floor[j], p.roof[j] = 0, 0.0, -np.inf, np.inf
    return resized(p, n + p.task, p.planes, p.task)


@inner
def least_slack(p):
    """Return by how much the inequalities of p (`TwoLevels`) must at least be loosened to have a solution, plus a margin.

    The bounds stay as they are. This amount becomes unknown number n, and minimising it is the only task.
    """
    n = p.size
    for i in range(n):
        p.want[i] = min(max(p.want[i], p.floor[i]), p.roof[i])
        p.P[p.planes, i] = 0.0
    for k in range(p.planes):
        p.P[k, n] = -1.0 if dot(p.P[k], p.P[k], n) > 0.0 else 0.0
    p.P[p.planes, n], p.rhs[p.planes] = 1.0, 0.0
    p.want[n], p.floor[n], p.roof[n] = 0.0, 0.0, np.inf
    for c in range(p.planes + n + 1):
        p.active[c] = 0
    solve_levels(resized(p, n + 1, p.planes, 1))
    return p.y[n] * (1.0 + CAUTION.loose) + CAUTION.loose


@inline
def as_wanted(asked, taken):
    """Copy the desired rates asked.want unchanged to `taken` (StepTaken), and note there that no constraint is active."""
    copy(asked.want, taken.x)
    for i in range(taken.x.shape[0]):
        taken.active[i] = 0
    for k in range(taken.kept.shape[0]):
        taken.kept[k] = 0


@inline
def recall(room, rows, taken):
    """Let the optimisation start from the constraints that were active in the last step: copy these from `taken` to `room`.

    rows: number of inequalities now.
    """
    for k in range(rows):
        room.active[k] = taken.kept[k]
    for i in range(taken.active.shape[0]):
        room.active[rows + i] = taken.active[i] if taken.active[i] < 2 else 0


@inline
def answer(p, allowed, taken):
    """Write the solution of p (`TwoLevels`) to `taken` (StepTaken): the joint rates in the caller's unit, and the active set."""
    for i in range(taken.x.shape[0]):
        side = p.active[p.planes + i]
        taken.active[i] = side
        taken.x[i] = min(max(p.y[i] * p.scaling[i], allowed.floor[i]), allowed.roof[i])
        if side != 0:
            taken.x[i] = allowed.roof[i] if side > 0 else allowed.floor[i]
    for k in range(taken.kept.shape[0]):
        taken.kept[k] = p.active[k] if k < p.planes else 0
        for i in range(taken.x.shape[0]):
            if taken.kept[k] != 0 and taken.active[i] == 0 and allowed.planes[k, i] != 0.0:
                taken.active[i] = 2


@inline
def least_damping(p):
    """Return a damping mu so small that it changes the solution of p (`TwoLevels`) only if the task is almost singular."""
    longest = 0.0
    for k in range(p.planes, p.planes + p.task):
        longest = max(longest, p.length[k])
    return CAUTION.light * longest * longest


@inline
def damping(p, asked):
    """Return the damping mu that an unmet task calls for, and the speed of the fastest joint.

    The linear model neglects the curvature of the tip's path. This is at most the curvature of a circle whose radius is the arm's
    reach, for slow joints as for fast ones. CAUTION.bend adds a margin, because full steps zigzag. Each row counts with the
    largest weight of its own priority level. With the weight of a heavier level, such as that of a grip that is kept, it would slow
    down what its own level asks for.
    """
    miss, fastest, k, n = 0.0, 0.0, p.planes, asked.size.shape[0]
    for c in range(asked.heavy.shape[0]):
        size = 0.0
        for i in range(asked.size.shape[0]):
            size += (asked.weight[c] * asked.J[i, c] * asked.size[i]) ** 2
        if size > 0.0:  # `lay_out` has left out the rows that no joint can change.
            miss += (asked.heavy[c] * (dot(p.P[k], p.y, n) - p.rhs[k])) ** 2
            k += 1
    for i in range(asked.size.shape[0]):
        fastest = max(fastest, asked.size[i])
    return CAUTION.bend * asked.h * math.sqrt(miss) * fastest * fastest, fastest


@inner
def constrain(asked, allowed, room, taken):
    """Find the joint rates that do the task as well as possible and, among those, are nearest to the desired ones.

    asked: the task and the desired rates (`TaskRate`); allowed: bounds and inequalities (`Allowed`); room: memory for a `TwoLevels`
    problem; taken: `StepTaken`, which holds the active set of the last step and receives the result. Returns a number of
    `StepOutcomes`.
    """
    if fitting(asked, allowed):
        as_wanted(asked, taken)
        return OUTCOME.wanted
    mu, loose, fastest, short, light = asked.mu, 0.0, 0.0, asked.mu > 0.0, False
    share = share_allowed(asked, allowed) if asked.mode == MODE.direct and mu == 0.0 else 0.0
    recall(room, allowed.rows, taken)
    while True:
        p = lay_out(room, asked, allowed, loose, fastest)
        if share > 0.0:
            keep_straight(p, share)
        if mu > 0.0:
            p = damp(p, asked.aside, mu)
        end = solve_levels(p)
        if end == CONTRADICTION and loose == 0.0:
            loose = least_slack(resized(p, asked.J.shape[0], allowed.rows, 1))
            continue
        if end == STUCK and mu == 0.0 and asked.h > 0.0 and not light:
            # The task is almost singular. A little damping makes it regular; the error that then remains sets the final damping.
            mu, light = least_damping(p), True
            continue
        if end != DONE or (mu > 0.0 and not light):
            break
        short = light or unmet(p)
        if not short or asked.h == 0.0:
            break
        mu, fastest = damping(p, asked)
        mu, light = max(mu, least_damping(p)), False
    answer(p, allowed, taken)
    return (
        OUTCOME.inexact if end != DONE else OUTCOME.relaxed if loose > 0.0 else OUTCOME.short if short else OUTCOME.met
    )
