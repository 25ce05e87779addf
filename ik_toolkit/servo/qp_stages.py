"""What the problems that `constrain` solves one after the other change in the first one. Scratch as in equality_qp.py."""

import math

import numpy as np

from ..compile.jit import inner
from .equality_qp import HIGH, LOW, ONE, RHS, TASK_ONE, TWO, WANT, Y, dot

SMALL = 1e-4  # size of the clock's column beside the task's largest row: the share its square has against the joints' is 1e-8
CAUTIOUS = 1.5  # times the bound of the curvature left out: two thirds of the way (CAUTION in singular_step.py): whole ways zigzag
DIRECTION = 100.0  # weight of deviating from the direction against falling behind along it, where nothing is blocked


@inner
def add_clock(P, V, S, task, first, r, n, cap):
    """Let the clock be unknown number n: by how much it is below cap, in units returned. 0: nothing depends on it."""
    size, top = 0.0, 0.0
    for k in range(first, first + r):
        size += task[k, 1] * task[k, 1]
        top = max(top, dot(P, k, P, k, n))
    if not size > 0.0:
        return 0.0
    unit = SMALL * math.sqrt(top / size)
    for k in range(first):
        P[k, n] = 0.0
    for k in range(first, first + r):
        P[k, n] = unit * task[k, 1]
    V[WANT, n] = 0.0
    V[LOW, n] = 0.0
    V[HIGH, n] = cap / unit
    return unit


@inner
def aside(P, S, first, r, n, alpha):
    """Weight what leaves the asked direction: DIRECTION in full reach, 1 where nothing can be done along it.

    alpha: the share of the task that can be done. Where more is asked for than all joints at full speed could do, as of a target
    far away, alpha counts for that much, and the weight grows with what is left undone along the direction.
    """
    size, most = 0.0, 0.0
    for k in range(first, first + r):
        size += S[RHS, k] * S[RHS, k]
    for i in range(n):
        s = 0.0
        for k in range(first, first + r):
            s += P[k, i] * P[k, i]
        most += math.sqrt(s)
    more = max(math.sqrt(size) / most if most > 0.0 else 1.0, 1.0)
    weight = 1.0 + (DIRECTION * math.sqrt(more) - 1.0) * min(alpha * more, 1.0)
    for i in range(n):
        s = 0.0
        for k in range(first, first + r):
            s += S[RHS, k] * P[k, i]
        s *= (weight - 1.0) / size
        for k in range(first, first + r):
            P[k, i] = weight * P[k, i] - s * S[RHS, k]


@inner
def even_out(P, V, scale, rows, n, sign):
    """Measure all unknowns by the largest of their speeds (sign 1), or each by its own again (-1)."""
    fast = 0.0
    for i in range(n):
        fast = max(fast, scale[i])
    for i in range(n):
        if scale[i] == fast:
            continue
        ratio = fast / scale[i] if sign > 0.0 else scale[i] / fast
        for k in range(rows):
            P[k, i] *= ratio
        V[ONE, i] *= ratio
        V[TWO, i] *= ratio
        V[LOW, i] /= ratio
        V[HIGH, i] /= ratio
        V[WANT, i] /= ratio
        V[Y, i] /= ratio
    return fast


@inner
def ease(P, V, S, state, task, weight, scale, first, r, n, rate, step, mu):
    """Let the residual be unknowns from n on, each l of its unit, and be as dear as the joints' motion: l^2, and the share unmet.

    rate: of the clock; below 0: what is asked stays. |C y - d|^2 + l^2 |y|^2 is then the second objective, under a task that
    can always be met. The damping is that of Levenberg and Marquardt: the curvature that C leaves out, at most that of a
    circle of one kernel unit, times the residual. It is the same for all joints, however slow they are (`even_out`). mu above 0,
    where nothing has been solved before: l^2 is mu, and the joints are drawn to the rate wanted, not to rest.
    """
    square, unmet = mu, 0.0
    fast = even_out(P, V, scale, first + r, n, 1.0)
    if mu == 0.0:
        miss, asked, heavy = 0.0, 0.0, 0.0
        for k in range(first, first + r):
            miss += S[TASK_ONE, k] * S[TASK_ONE, k]
            if rate >= 0.0:
                S[RHS, k] = task[k, 0] + rate * task[k, 1]
            asked += S[RHS, k] * S[RHS, k]
        for k in range(weight.shape[0]):
            heavy = max(heavy, weight[k])
        for i in range(n):
            V[WANT, i] = 0.0
        unmet = min(math.sqrt(miss / asked), 1.0) if asked > 0.0 else 1.0
        square = CAUTIOUS * step * math.sqrt(miss) * heavy * fast * fast
    unit = math.sqrt(square)
    for k in range(first + r):
        for j in range(r):
            P[k, n + j] = unit if k == first + j else 0.0
    for j in range(n, n + r):
        state[j] = 0
        V[WANT, j] = 0.0
        V[LOW, j] = -np.inf
        V[HIGH, j] = np.inf
    return square, unmet


@inner
def near(P, V, S, want, beside, scale, first, r, n, unmet):
    """Let the tip move as it has just been found to, and the joints as near as they can to what is wanted with that motion.

    That is what `beside` asks, and as much of the rate wanted as of the task is met: all of it would be that of a task at full
    speed. It is a second objective, not the centre of the damping: there it would move the tip, and the arm would rest beside
    the closest pose, or turn with each joint that meets a limit, were it freed of that.
    """
    for k in range(first, first + r):
        S[RHS, k] = dot(P, k, V, Y, n)
    for i in range(n):
        V[WANT, i] = (unmet * beside[i] + (1.0 - unmet) * want[i]) / scale[i]


@inner
def slack(P, V, S, state, n, count):
    """The problem of the least slack of the half-planes that leaves a point in the box: unknown n, the only task."""
    for i in range(n):
        V[WANT, i] = min(max(V[WANT, i], V[LOW, i]), V[HIGH, i])
        P[count, i] = 0.0
        state[i] = 0
    for k in range(count):
        P[k, n] = -1.0 if dot(P, k, P, k, n) > 0.0 else 0.0
        state[P.shape[1] + k] = 0
    P[count, n] = 1.0
    S[RHS, count] = 0.0
    V[WANT, n] = 0.0
    V[LOW, n] = 0.0
    V[HIGH, n] = np.inf
