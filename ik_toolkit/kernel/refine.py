"""Moving a solution within the set of solutions: descend a secondary objective in the null space, stay on the target."""

import math
from typing import NamedTuple

import numpy as np

from .algebra import V3
from .jit import build, cached, compiled, inline, spliced
from .limits import hold
from .linalg import cholesky, damped
from .problem import BEST_OF_ALL
from .records import HEAD, TASK, Array, Ends, Orders, copy, read
from .serial import make_serial

MID_RANGE, REFERENCE, MANIPULABILITY = 1, 2, 3
COUNTED = 1e-18  # squared norm from which on a row of the Jacobian is one the joints can move
VOLUME = 1e-30  # smallest squared pivot: at a singular pose the log stays a number
DAMPING = 1e-10  # of the projection and the way back: below any singular value worth a step
CORRECTIONS = 6  # steps back onto the target; convergence is quadratic
DIFFERENCE = 1e-6  # [rad] of the one-sided derivative of the manipulability
SMALLEST = 1e-7  # a step that moves no joint by more ends the search
LONGEST = 0.3  # [rad or kernel unit] largest move of a joint in a step: the null space is curved


@compiled
class Bounds(NamedTuple):
    """Limits as they count here (endless joints have none), by place; flat holds three vectors of n."""

    limits: Array  # (3, n) lower, upper, whether the objective counts the joint

    def lower(self, i):
        return self.limits[0, i]

    def upper(self, i):
        return self.limits[1, i]

    def counted(self, i):
        return self.limits[2, i]


@build
def make_bounds(ends, what, limits):
    """Bounds of a chain for an objective."""
    box = Bounds(np.empty((3, ends.n)))
    for i in range(ends.n):
        free = ends.turns(i) > 1.5 or not limits
        box.limits[0, i] = -np.inf if free else ends.lower(i)
        box.limits[1, i] = np.inf if free else ends.upper(i)
        box.limits[2, i] = 1.0 if what == REFERENCE or (ends.lower(i) > -1e15 and ends.turns(i) < 1.5) else 0.0
    return box


@inline
def log_manipulability(J, ends, A):
    """Half the log-determinant of J'J over the rows that count (log of Yoshikawa's measure, up to a constant).

    Columns of sliding joints are turned back to metres; J is overwritten, A (6, 6) is scratch.
    """
    m = 0
    for r in range(6):
        size = 0.0
        for i in range(J.shape[0]):
            size += J[i, r] * J[i, r]
        if size > COUNTED:
            for i in range(J.shape[0]):
                J[i, m] = J[i, r] / ends.unit(i)
            m += 1
    for r in range(m):
        for c in range(r + 1):
            A[r, c] = 0.0
            for i in range(J.shape[0]):
                A[r, c] += J[i, r] * J[i, c]
    cholesky(A, m, VOLUME)
    total = 0.0
    for r in range(m):
        total += math.log(A[r, r])
    return total


@inline
def wanted(what, ends, ref, i):
    """Where the objective wants joint i."""
    return ends.low(i) + 0.5 * ends.span(i) if what == MID_RANGE else ref[i] / ends.unit(i)


@inline
def move(q, dq, factor, box):
    """Add factor dq to q, inside the bounds."""
    for i in range(q.shape[0]):
        q[i] = min(max(q[i] + factor * dq[i], box.lower(i)), box.upper(i))


@spliced
def correct(p, weights, box):
    """Back onto the target: the null-space step left it to second order. Returns the last look, with its Jacobian made."""
    s = p.desk
    for k in range(CORRECTIONS):
        e = p.evaluate(s.q)
        p.jacobian(e)
        if e.good or k == CORRECTIONS - 1:
            break
        copy(weights, s.w)
        for _ in range(2):
            p.damped(e, DAMPING)
            if not hold(s.q, s.dq, s.w, box):
                break
        move(s.q, s.dq, 1.0, box)
    return e


@inline
def direction(p, z, w, box):
    """Write to p.desk.dq what of z, in the metric 1/w, does not move the tip, joints at a bound held; uses p.desk.J."""
    s = p.desk
    n = z.shape[0]
    for _ in range(n):
        for r in range(6):
            g = 0.0
            for i in range(n):
                if w[i] > 0.0:
                    g += s.J[i, r] * z[i]
            s.y[r] = -g
        damped(s.J, w, s.dq, V3(s.y[0], s.y[1], s.y[2]), V3(s.y[3], s.y[4], s.y[5]), DAMPING)
        for i in range(n):
            s.dq[i] = s.dq[i] + z[i] if w[i] > 0.0 else 0.0
        if not hold(s.q, s.dq, w, box):
            break


@cached
def refine(rows, ends, T, q_out, ref, opt, what, steps, report):
    """Improve q_out (n,) [rad or m] for the objective `what` without leaving the tolerances of the target T (1, 4, 4).

    ref (n,): where REFERENCE wants the joints. opt as for the search. report (5,): objective before and after, steps taken,
    position error [m] and rotation error left. MID_RANGE and REFERENCE: half the squared distance, in ranges (an endless
    joint has no middle); MANIPULABILITY: minus the log of the manipulability.
    """
    n = q_out.shape[0]
    o = read(Orders, opt)
    p = make_serial(rows, ends, opt[HEAD:], n, o)
    weights = opt[HEAD + TASK : HEAD + TASK + n]
    full = Ends(ends, n)
    box = make_bounds(full, what, o.limits > 0.0)
    s = p.desk
    q, dq, w = s.q, s.dq, s.w
    old, z, before, way = np.empty(n), np.empty(n), np.zeros(n), np.zeros(n)
    p.aim(T[0], o)
    for i in range(n):
        q[i] = q_out[i] / full.unit(i)
    gain = 1.0
    fresh = False
    value = np.inf
    taken = 0
    for k in range(steps + 1):
        e = correct(p, weights, box)
        now = 0.0
        if what == MANIPULABILITY:
            now = -log_manipulability(s.J, full, s.A)
        else:
            for i in range(n):
                now += box.counted(i) * 0.5 * ((q[i] - wanted(what, full, ref, i)) / full.span(i)) ** 2
        if k == 0:
            if not e.good:
                break
            report[0] = now
        elif not e.good or not now < value - 1e-12 * abs(value):  # rounding of the sum is no progress
            copy(old, q)
            gain *= 0.25
            if gain < 1e-6:
                break
        else:
            taken += 1
            fresh = True
        if k == 0 or (e.good and now < value):
            value = now
            p.keep(e, BEST_OF_ALL)
            report[3], report[4] = p.left(BEST_OF_ALL)
            copy(q, old)
        report[1] = value
        report[2] = taken
        if k == steps:
            break
        # Direction: down the gradient without what moves the tip. The distances are measured in joint ranges, and with the
        # same metric in the projection their step of one is Newton's.
        for i in range(n):
            z[i] = box.counted(i) * (wanted(what, full, ref, i) - q[i])
        for i in range(n + 1):  # the last time with q as it is, for the Jacobian there
            if i < n:
                if what != MANIPULABILITY:
                    continue
                q[i] += DIFFERENCE
            e = p.evaluate(q)
            p.jacobian(e)
            if i < n:
                z[i] = 0.5 * (log_manipulability(s.J, full, s.A) + value) / DIFFERENCE
                q[i] -= DIFFERENCE
        for i in range(n):
            w[i] = weights[i] * (full.span(i) * full.span(i) if what != MANIPULABILITY else 1.0)
        direction(p, z, w, box)
        size, ss, sy = 0.0, 0.0, 0.0
        for i in range(n):
            size = max(size, abs(dq[i]))
            step = old[i] - before[i]
            ss += step * step
            sy += step * (way[i] - dq[i])
        if size < SMALLEST:
            break
        if fresh and taken > 0 and sy > 1e-12 * ss:  # Barzilai and Borwein: the secant says how far
            gain = min(max(ss / sy, 1e-3), 1e3)
        if fresh or k == 0:
            copy(old, before)
            copy(dq, way)
        fresh = False
        move(q, dq, gain * min(1.0, LONGEST / size), box)
    if taken > 0:
        for i in range(n):
            q_out[i] = old[i] * full.unit(i)
