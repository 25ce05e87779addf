"""Two least-squares objectives in order of priority, inside bounds and inequalities, by a dual active-set method.

    first    |C y - d|^2 least
    second   |y - want|^2 least among those
    always   floor <= y <= roof, A y <= b

It is the method of Goldfarb and Idnani (1983) for |y - want|^2 + |C y - d|^2 / eps in the limit eps -> 0. Each
Lagrange multiplier is a pair (first / eps + second) that is compared as one number with an infinitesimal part. Each iteration
solves a problem with equalities only (equality_qp.py). If the method starts from the active set of the last control step, one
iteration is usually enough.

`TwoLevels` says how constraints are numbered.
"""

import math

import numpy as np

from ..compile.jit import inline, inner
from ..kernel.vectors import dot
from .equality_qp import NONE, SAME, equality, is_free

DONE, STUCK, CONTRADICTION = range(3)  # how `solve_levels` ended: solved, out of iterations, infeasible
# tolerance of bounds and inequalities; the unknowns are ratios of joint rates to speed limits, and callers clip them to bounds
OUT = 1e-12
SAME_TASK = 1e-9  # The task counts as met if its residual's norm is at most this share of the right side's norm.


@inline
def wrong(one, two, side):
    """Return by how much a multiplier (one / eps + two, for eps -> 0) is on the wrong side of zero; 0 if its sign is right.

    side: the right sign, 1 or -1. A wrong first part gives a value above 1, so that it always counts more than a wrong second part,
    which counts only above 1e-11, where it is not rounding.
    """
    if one * side != 0.0:
        return 1.0 - one * side if one * side < 0.0 else 0.0
    return min(-two * side, 1.0) if two * side < -1e-11 else 0.0


@inline
def violated(p):
    """Return the index of the inactive constraint that p.y violates most, or NONE, and which bound: -1 the lower, 1 the upper.

    p: `TwoLevels`; an inequality counts as an upper bound.
    """
    n = p.size
    # The rounding error of one large unknown spreads to the others, so the tolerance grows with the largest one.
    top = 1.0
    for i in range(n):
        top = max(top, abs(p.y[i]))
    which, side, most = NONE, 0, OUT
    for i in range(n):
        if is_free(p, i):
            under, over = p.floor[i] - p.y[i], p.y[i] - p.roof[i]
            excess = max(under, over) / (1.0 + abs(p.y[i]))
            if excess > most and max(under, over) > OUT * top:
                which, side, most = p.planes + i, -1 if under > over else 1, excess
    for k in range(p.planes):
        if p.active[k] == 0:
            excess = (dot(p.P[k], p.y, n) - p.rhs[k]) / (1.0 + abs(p.rhs[k]))
            if excess > most:
                which, side, most = k, 1, excess
    return which, side


@inline
def may_leave(p, c):
    """Return whether constraint c of p (`TwoLevels`) is active and may be dropped; a bound may not if both bounds are equal."""
    i = c - p.planes
    return p.active[c] != 0 and (i < 0 or p.floor[i] < p.roof[i])


@inline
def wrong_most(p):
    """Return the index of the active constraint whose multiplier in p.new is most on the wrong side of zero, or NONE."""
    worst, which = 0.0, NONE
    for c in range(p.planes + p.size):
        if may_leave(p, c):
            w = wrong(p.new.first[c], p.new.second[c], p.active[c])
            if w > worst:
                worst, which = w, c
    return which


@inline
def unmet(p):
    """Return whether the last solution of p (`TwoLevels`) misses the task by more than SAME_TASK times the right side's norm."""
    miss, size = 0.0, 0.0
    for c in range(p.task):
        miss += p.new.first[p.planes + p.size + c] ** 2
        size += p.rhs[p.planes + c] ** 2
    return miss > SAME_TASK * SAME_TASK * size


@inline
def begin(p, cold):
    """Compute the norms of the rows of p (`TwoLevels`), and empty the active set if `cold`.

    Unknowns whose two bounds are equal are always held at them.
    """
    for k in range(p.planes + p.task):
        p.length[k] = math.sqrt(dot(p.P[k], p.P[k], p.size))
    for c in range(p.planes + p.size):
        i = c - p.planes
        if i >= 0 and p.floor[i] >= p.roof[i]:
            p.active[c] = 1
        elif cold or (i >= 0 and p.active[c] != 0 and abs(p.floor[i] if p.active[c] < 0 else p.roof[i]) == np.inf):
            p.active[c] = 0  # An infinite bound cannot be held.


@inner
def solve_levels(p):
    """Solve the quadratic program p (`TwoLevels`), starting from the active set stored in p, which is replaced by the final one.

    Returns DONE, STUCK (out of iterations) or CONTRADICTION (the inequalities and bounds have no common solution).
    """
    for attempt in range(2):  # The second attempt, if the first is stuck, starts from an empty active set.
        begin(p, attempt > 0)
        new = NONE
        # First, constraints of the initial active set are dropped if their multipliers have the wrong sign; then violated ones are
        # added.
        adding = False
        for _ in range(10 * (p.planes + p.size)):
            dependent = equality(p, new if new < p.planes else NONE)
            if not adding:
                drop = dependent if dependent != NONE else wrong_most(p)
            elif dependent == NONE:
                drop = move_on(p, new)
            else:
                drop = exchange(p, dependent, new)
                if drop == NONE:
                    p.active[new] = 0
                    return CONTRADICTION
            if drop != NONE:
                p.active[drop] = 0
                continue
            for c in range(p.planes + p.size):
                p.now.first[c], p.now.second[c] = p.new.first[c], p.new.second[c]
            adding = True
            new, side = violated(p)
            if new == NONE:
                return DONE
            p.active[new] = side
            p.now.first[new], p.now.second[new] = 0.0, 0.0
    return STUCK


@inline
def share(now, new, at, side):
    """Return how far multiplier number `at` can move from its value in `now` to that in `new` until its sign becomes wrong.

    The result is the pair (t, dt) for the share t + dt eps of the way, eps infinitesimal; t = 2 if it can move all the way. side:
    the right sign of the multiplier.
    """
    one, two, next_one, next_two = now.first[at], now.second[at], new.first[at], new.second[at]
    if wrong(next_one, next_two, side) == 0.0:
        return 2.0, 0.0
    if one != next_one:
        t = min(max(one / (one - next_one), 0.0), 1.0)
        return t, (two + t * (next_two - two)) / (one - next_one)
    return min(max(two / (two - next_two), 0.0), 1.0), 0.0


@inline
def move_on(p, newest):
    """Move the multipliers p.now of p (`TwoLevels`) towards p.new, until that of a constraint other than `newest` becomes zero.

    Returns the number of this constraint, or NONE if no multiplier becomes zero on the way; then nothing is moved.
    """
    t, dt, blocking = 2.0, 0.0, NONE
    for c in range(p.planes + p.size):
        if c != newest and may_leave(p, c):
            a, da = share(p.now, p.new, c, p.active[c])
            if a < t or (a == t and da < dt):
                t, dt, blocking = a, da, c
    for c in range(p.planes + p.size if blocking != NONE else 0):
        one, two = p.new.first[c] - p.now.first[c], p.new.second[c] - p.now.second[c]
        p.now.first[c] += t * one
        p.now.second[c] += t * two + dt * one
    return blocking


@inline
def parts(p, dependent):
    """Write inequality number `dependent` of p (`TwoLevels`) as a linear combination of the active constraints.

    The coefficients are written to p.new.first; that of the inequality itself is -1.
    """
    b, planes = p.b, 0
    for k in range(p.planes):
        p.new.first[k] = 0.0
        planes += p.active[k] != 0 and k != dependent
    for j in range(planes - 1, -1, -1):
        s = b.L[dependent, j]
        for h in range(j + 1, planes):
            s -= b.L[b.order[h], j] * p.new.first[b.order[h]]
        p.new.first[b.order[j]] = s / b.L[b.order[j], j]
    p.new.first[dependent] = -1.0
    for i in range(p.size):
        s = 0.0
        if not is_free(p, i):
            for k in range(p.planes):
                s -= p.P[k, i] * p.new.first[k]
        p.new.first[p.planes + i] = s


@inner
def exchange(p, dependent, newest):
    """Return which active constraint to drop for a new one that depends linearly on the active ones, or NONE.

    NONE means that the new constraint, number `newest`, contradicts the others. The multipliers are updated for the exchange.
    `dependent` is an inequality whose row is a linear combination of the rows of other constraints. Either it is the new constraint
    and the others are active, or it is active and the new constraint is a bound among the others.
    """
    parts(p, dependent)
    own, side = p.new.first[newest], p.active[newest]
    # If the new constraint is not part of the combination, the inequality depended on the others before, and only rounding hid it.
    if not abs(own) > SAME:
        return dependent
    one, two, blocking = np.inf, np.inf, NONE
    for c in range(p.planes + p.size):
        p.new.first[c] *= -side / own
        part = p.new.first[c] * p.active[c]
        if part > SAME and c != newest and may_leave(p, c):
            a, b = p.now.first[c] * p.active[c] / part, p.now.second[c] * p.active[c] / part
            if a < one or (a == one and b < two):
                one, two, blocking = a, b, c
    for c in range(p.planes + p.size if blocking != NONE else 0):
        # The coefficient of the new constraint is -side here, so its multiplier grows away from zero.
        p.now.first[c] -= one * p.new.first[c]
        p.now.second[c] -= two * p.new.first[c]
    return blocking
