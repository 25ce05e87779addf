"""Moving a solution within the set of solutions: lower a secondary objective in the null space, stay on the target.

Written against the calls of a problem, so for one tip and for several.
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.array_view import cut, flat, keep, space, view
from ..compile.jit import cached, compiled, inline, spliced
from .limits import hold
from .linalg import cholesky
from .problem import BEST_OF_ALL
from .records import ANSWER, AT, HEAD, TASK, Array, Ends, Orders, copy, read
from .search import problem_on

MID_RANGE, REFERENCE, MANIPULABILITY = 1, 2, 3
COUNTED = 1e-18  # squared norm above which the joints can move along a row of the Jacobian
VOLUME = 1e-30  # smallest squared pivot: keeps the logarithm finite at a singular pose
DAMPING = 1e-10  # of the projection and the way back: below any singular value worth a step
CORRECTIONS = 6  # steps back onto the target; convergence is quadratic
DIFFERENCE = 1e-6  # [rad] of the one-sided derivative of the manipulability
SMALLEST = 1e-7  # a step that moves every joint by less ends the search
LONGEST = 0.3  # [rad or kernel unit] largest move of a joint in a step: the null space is curved


@compiled
class Bounds(NamedTuple):
    """Limits as they count here (endless joints have none), by place."""

    limits: Array  # (3, n) lower, upper, whether the objective counts the joint

    def lower(self, i):
        return self.limits[0, i]

    def upper(self, i):
        return self.limits[1, i]

    def counted(self, i):
        return self.limits[2, i]


@spliced
def make_bounds(places, ends, what, limits):
    """Bounds of a chain for an objective, written to `places` (3, n)."""
    box = Bounds(places)
    for i in range(ends.n):
        free = ends.turns(i) > 1.5 or not limits
        box.limits[0, i] = -np.inf if free else ends.lower(i)
        box.limits[1, i] = np.inf if free else ends.upper(i)
        box.limits[2, i] = 1.0 if what == REFERENCE or (ends.lower(i) > -1e15 and ends.turns(i) < 1.5) else 0.0
    return box


@inline
def log_manipulability(p, ends):
    """Half the log-determinant of JJ' over the rows of the last Jacobian that count, of all tips stacked.

    That is the log of Yoshikawa's measure, up to a constant. Columns of sliding joints are turned back to metres; p.desk.J and
    A are overwritten.
    """
    J, A = p.desk.J, p.desk.A
    m = 0
    for r in range(p.width()):
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
def objective_goal(what, ends, ref, i):
    """Where the objective wants joint i."""
    return ends.low(i) + 0.5 * ends.span(i) if what == MID_RANGE else ref[i] / ends.unit(i)


@inline
def move(q, dq, factor, box):
    """Add factor dq to q, inside the bounds."""
    for i in range(q.shape[0]):
        q[i] = min(max(q[i] + factor * dq[i], box.lower(i)), box.upper(i))


@inline
def onto_target(p, weights, box, enough):
    """Newton steps of p.desk.q onto the target, which a step left to second order, joints held at their bounds.

    They end at a squared error (lengths over reach) of `enough`; with none, inside the tolerances. Returns the last look.
    """
    s = p.desk
    for k in range(CORRECTIONS):
        e = p.evaluate(s.q)
        if (e.ee <= enough if enough > 0.0 else e.good) or k == CORRECTIONS - 1:
            break
        p.jacobian(e)
        copy(weights, s.w)
        for _ in range(2):
            p.damped(e, DAMPING)
            if not hold(s.q, s.dq, s.w, box):
                break
        move(s.q, s.dq, 1.0, box)
    return e


@inline
def direction(p, z, box):
    """Write to p.desk.dq the part of z (in the metric 1/w) that moves no tip, joints at a bound held; uses p.desk.J, w and y."""
    s = p.desk
    n = z.shape[0]
    for _ in range(n):
        for r in range(p.width()):
            g = 0.0
            for i in range(n):
                if s.w[i] > 0.0:
                    g += s.J[i, r] * z[i]
            s.y[r] = -g
        p.toward(s.y, DAMPING)
        for i in range(n):
            s.dq[i] = s.dq[i] + z[i] if s.w[i] > 0.0 else 0.0
        if not hold(s.q, s.dq, s.w, box):
            break


@inline
def objective(p, what, ends, box, ref):
    """Value to lower at p.desk.q, whose Jacobian is made; see `refine`."""
    if what == MANIPULABILITY:
        return -log_manipulability(p, ends)
    total = 0.0
    for i in range(ref.shape[0]):
        total += box.counted(i) * 0.5 * ((p.desk.q[i] - objective_goal(what, ends, ref, i)) / ends.span(i)) ** 2
    return total


@spliced
def downhill(p, what, ends, box, ref, value, z):
    """Write to z (n,) where the objective falls from p.desk.q, at which it is `value`; the Jacobian there is made again.

    The distances are measured in joint ranges; with the same metric in the projection their step of one is Newton's.
    """
    q = p.desk.q
    n = q.shape[0]
    for i in range(n):
        z[i] = box.counted(i) * (objective_goal(what, ends, ref, i) - q[i])
    for i in range(n + 1):  # the last time with q as it is, for the Jacobian there
        if i < n:
            if what != MANIPULABILITY:
                continue
            q[i] += DIFFERENCE
        e = p.evaluate(q)
        p.jacobian(e)
        if i < n:
            z[i] = 0.5 * (log_manipulability(p, ends) + value) / DIFFERENCE
            q[i] -= DIFFERENCE


@inline
def secant(old, before, way, dq, gain):
    """Length of the next step from the one just taken: what Barzilai and Borwein (1988) make of the secant."""
    ss, sy = 0.0, 0.0
    for i in range(old.shape[0]):
        step = old[i] - before[i]
        ss += step * step
        sy += step * (way[i] - dq[i])
    return min(max(ss / sy, 1e-3), 1e3) if sy > 1e-12 * ss else gain


@inline
def refine_on_views(rows, ends, T, row, ref, orders, what, steps, block):
    """`refine` on views, with its scratch."""
    n = ref.shape[0]
    o = read(Orders, orders)
    first = HEAD + TASK * (flat(ends).shape[0] // ends.shape[-1])
    block[0] = 0.0
    p = problem_on(block, rows, ends, orders[HEAD:first], n, o)
    weights = orders[first : first + n]
    full = Ends(flat(ends), n)  # what belongs to the coordinates is the same for every tip, and stands first
    (places,) = cut(block, np.float64, ((3, n),))
    box = make_bounds(places, full, what, o.limits > 0.0)
    q, dq, w = p.desk.q, p.desk.dq, p.desk.w
    old, z, before, way = cut(block, np.float64, (n, n, n, n))
    p.aim(T[0], o)
    for i in range(n):
        q[i] = row[ANSWER + i] / full.unit(i)
    gain = 1.0
    fresh = False  # whether the step before was an improvement
    value = np.inf
    taken = 0
    for k in range(steps + 1):
        e = onto_target(p, weights, box, 0.0)
        p.jacobian(e)
        now = objective(p, what, full, box, ref)
        better = e.good and (
            k == 0 or now < value - 1e-12 * abs(value)
        )  # rounding of the sum does not count as progress
        if better:
            value = now
            p.keep(e, BEST_OF_ALL)
            copy(q, old)
        elif k > 0:
            copy(old, q)
            gain *= 0.25
        if k == steps or gain < 1e-6 or not (better or k > 0):
            break
        fresh = better and k > 0
        taken += 1 if fresh else 0
        downhill(p, what, full, box, ref, value, z)
        for i in range(n):
            w[i] = weights[i] * (full.span(i) * full.span(i) if what != MANIPULABILITY else 1.0)
        direction(p, z, box)
        size = 0.0
        for i in range(n):
            size = max(size, abs(dq[i]))
        if size < SMALLEST:
            break
        if fresh:
            gain = secant(old, before, way, dq, gain)
        if better:
            copy(old, before)
            copy(dq, way)
        move(q, dq, gain * min(1.0, LONGEST / size), box)
    if taken > 0:
        row[AT.position], row[AT.rotation] = p.left(BEST_OF_ALL)
        p.report(BEST_OF_ALL, row)
        for i in range(n):
            row[ANSWER + i] = old[i] * full.unit(i)


@cached
def refine(rows, ends, T, row, ref, orders, what, steps):
    """Improve the solution in `row` for the objective `what` without leaving the tolerances of the target.

    rows, ends, T (1, ...), row and orders as of `search.entry`; ref (n,): where REFERENCE wants the joints. MID_RANGE and
    REFERENCE lower half the squared distance, in ranges (an endless joint has no middle); MANIPULABILITY minus the log of the
    manipulability. q and its errors are replaced when some step of at most `steps` was taken.
    """
    n, tips = ref.shape[0], ends.size // ends.shape[-1]
    block = np.empty(space(n, 6 * tips, rows.shape[0], 0))
    refine_on_views(view(rows), view(ends), view(T), view(row), view(ref), view(orders), what, steps, view(block))
    keep(block)
