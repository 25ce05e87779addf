"""Two least-squares objectives in order of priority, inside bounds and inequalities, by a dual active-set method.

    first    |C y - d|^2 least
    second   |y - want|^2 least among those
    always   floor <= y <= roof, A y <= b

It is the method of Goldfarb and Idnani (1983) for |y - want|^2 + |C y - d|^2 / eps in the limit eps -> 0. Each
Lagrange multiplier is a pair (first / eps + second) that is compared as one number with an infinitesimal part. Each iteration
solves a problem with equalities only (equality_qp.py). If the method starts from the active set of the last control step, one
iteration is usually enough.

A constraint is identified by a number: the bounds of unknown i by i, inequality k by p.size + k.
"""

import math

import numpy as np

from ..compile.jit import inline, inner
from .equality_qp import NONE, SAME, dot, equality, square

DONE, STUCK, CONTRADICTION = range(3)  # outcomes: solved, out of iterations, infeasible
# tolerance of bounds and inequalities; the unknowns are ratios of joint rates to joint speeds, and callers clip them to bounds
OUT = 1e-12
WRONG = 1e-11  # A multiplier of the second objective counts as having the wrong sign only if it is larger than this.
SAME_TASK = 1e-9  # The task counts as met if its residual's norm is at most this share of the right side's norm.
PER = 10  # largest number of iterations per unknown and inequality


@inline
def wrong(one, two, side):
    """Return by how much a multiplier (one / eps + two) is on the wrong side of zero; 0 if its sign is right.

    side: the right sign, 1 or -1. A wrong first part gives a value above 1, so that it always counts more than a wrong second part.
    """
    if one * side != 0.0:
        return 1.0 - one * side if one * side < 0.0 else 0.0
    return min(-two * side, 1.0) if two * side < -WRONG else 0.0


@inline
def violated(p):
    """Return the number of the most violated inactive constraint, or NONE, and its side: -1 lower, 1 upper."""
    u, r, n = p.u, p.r, p.size
    # The rounding error of one large unknown spreads to the others, so the tolerance grows with the largest one.
    top = 1.0
    for i in range(n):
        top = max(top, abs(u.y[i]))
    which, side, most = NONE, 0, OUT
    for i in range(n):
        if u.held[i] == 0:
            under, over = u.floor[i] - u.y[i], u.y[i] - u.roof[i]
            excess = max(under, over) / (1.0 + abs(u.y[i]))
            if excess > most and max(under, over) > OUT * top:
                which, side, most = i, -1 if under > over else 1, excess
    for k in range(p.planes):
        if r.holds[k] == 0:
            excess = (dot(r.P, k, u.y, n) - r.rhs[k]) / (1.0 + abs(r.rhs[k]))
            if excess > most:
                which, side, most = n + k, 1, excess
    return which, side


@inline
def wrong_most(p):
    """Return the number of the active constraint whose multiplier is furthest on the wrong side of zero (`wrong`), or NONE."""
    u, r = p.u, p.r
    worst, which = 0.0, NONE
    for i in range(p.size):
        if u.held[i] != 0 and u.floor[i] < u.roof[i]:
            w = wrong(u.new.first[i], u.new.second[i], u.held[i])
            if w > worst:
                worst, which = w, i
    for k in range(p.planes):
        if r.holds[k] != 0:
            w = wrong(r.new.first[k], r.new.second[k], r.holds[k])
            if w > worst:
                worst, which = w, p.size + k
    return which


@inline
def unmet(p):
    """Return whether the last solution misses the task: its residual is above SAME_TASK times the task's right side."""
    miss, size = 0.0, 0.0
    for k in range(p.planes, p.planes + p.task):
        miss += p.r.new.first[k] * p.r.new.first[k]
        size += p.r.rhs[k] * p.r.rhs[k]
    return miss > SAME_TASK * SAME_TASK * size


@inline
def begin(p, cold):
    """Compute the row norms and set the initial active set: the present one, or none if `cold`.

    Unknowns with equal bounds are always held.
    """
    u, r = p.u, p.r
    for k in range(p.planes + p.task):
        r.length[k] = math.sqrt(square(r.P, k, p.size))
    for i in range(p.size):
        if u.floor[i] >= u.roof[i]:
            u.held[i] = 1
        elif cold or (u.floor[i] if u.held[i] < 0 else u.roof[i] if u.held[i] > 0 else 0.0) in (-np.inf, np.inf):
            u.held[i] = 0
    for k in range(p.planes):
        if cold:
            r.holds[k] = 0


@inline
def release(p, which):
    """Remove constraint number `which` from the active set."""
    if which < p.size:
        p.u.held[which] = 0
    else:
        p.r.holds[which - p.size] = 0


@inline
def enforce(p, which, side):
    """Add constraint number `which` to the active set, at the given side and with a multiplier of 0."""
    if which < p.size:
        p.u.held[which] = side
        p.u.now.first[which], p.u.now.second[which] = 0.0, 0.0
    else:
        k = which - p.size
        p.r.holds[k] = 1
        p.r.now.first[k], p.r.now.second[k] = 0.0, 0.0


@inner
def solve_levels(p):
    """Solve the problem p, starting from the active set stored in p, which is replaced by the final one.

    Returns DONE, STUCK (out of iterations) or CONTRADICTION (the inequalities and bounds have no common solution).
    """
    n = p.size
    for attempt in range(2):  # The second attempt, if the first is stuck, starts from an empty active set.
        begin(p, attempt > 0)
        new = NONE
        adding = False  # First, initial constraints whose multipliers have the wrong sign are dropped; then others are added.
        for _ in range(PER * (n + p.planes)):
            last = new - n  # It is below 0 if the constraint added last is a bound and no inequality.
            dependent = equality(p, last)
            if not adding:
                drop = n + dependent if dependent != NONE else wrong_most(p)
            elif dependent == NONE:
                drop = move_on(p, new)
            else:
                drop = exchange(p, dependent, new)
                if drop == NONE:
                    release(p, new)
                    return CONTRADICTION
            if drop != NONE:
                release(p, drop)
                continue
            accept(p)
            adding = True
            new, side = violated(p)
            if new == NONE:
                return DONE
            enforce(p, new, side)
    return STUCK


@inline
def accept(p):
    """Make the multipliers of the last equality-constrained problem the present ones."""
    u, r = p.u, p.r
    for i in range(p.size):
        u.now.first[i], u.now.second[i] = u.new.first[i], u.new.second[i]
    for k in range(p.planes):
        r.now.first[k], r.now.second[k] = r.new.first[k], r.new.second[k]


@inline
def share(now, new, at, side):
    """Return the share t + dt eps by which multiplier number `at` can move from now to new before its sign is wrong.

    The result is the pair (t, dt); t = 2 means that it can move all the way. side: the right sign of the multiplier.
    """
    one, two, next_one, next_two = now.first[at], now.second[at], new.first[at], new.second[at]
    if wrong(next_one, next_two, side) == 0.0:
        return 2.0, 0.0
    if one != next_one:
        t = min(max(one / (one - next_one), 0.0), 1.0)
        return t, (two + t * (next_two - two)) / (one - next_one)
    return min(max(two / (two - next_two), 0.0), 1.0), 0.0


@inline
def go(now, new, count, t, dt):
    """Move the first `count` multipliers by the share t + dt eps of the way from their values `now` to `new`."""
    for k in range(count):
        one, two = new.first[k] - now.first[k], new.second[k] - now.second[k]
        now.first[k] += t * one
        now.second[k] += t * two + dt * one


@inline
def move_on(p, newest):
    """Move all multipliers towards the new ones, until the multiplier of a constraint other than `newest` becomes zero.

    Returns the number of this constraint, or NONE if no multiplier becomes zero on the way; then nothing is moved.
    """
    u, r, n = p.u, p.r, p.size
    t, dt, blocking = 2.0, 0.0, NONE
    for i in range(n):
        if u.held[i] != 0 and i != newest and u.floor[i] < u.roof[i]:
            a, da = share(u.now, u.new, i, u.held[i])
            if a < t or (a == t and da < dt):
                t, dt, blocking = a, da, i
    for k in range(p.planes):
        if r.holds[k] != 0 and n + k != newest:
            a, da = share(r.now, r.new, k, 1)
            if a < t or (a == t and da < dt):
                t, dt, blocking = a, da, n + k
    if blocking != NONE:
        go(u.now, u.new, n, t, dt)
        go(r.now, r.new, p.planes, t, dt)
    return blocking


@inline
def parts(p, dependent):
    """Write an inequality that depends linearly on the active constraints as a linear combination of these.

    The coefficients are written to new.first of the bounds and inequalities; that of the inequality itself is -1.
    """
    u, r, b = p.u, p.r, p.b
    planes = 0
    for k in range(p.planes):
        r.new.first[k] = 0.0
        if r.holds[k] != 0 and k != dependent:
            planes += 1
    for j in range(planes - 1, -1, -1):
        s = b.L[dependent, j]
        for h in range(j + 1, planes):
            s -= b.L[b.order[h], j] * r.new.first[b.order[h]]
        r.new.first[b.order[j]] = s / b.L[b.order[j], j]
    r.new.first[dependent] = -1.0
    for i in range(p.size):
        s = 0.0
        if u.held[i] != 0:
            for k in range(p.planes):
                s -= r.P[k, i] * r.new.first[k]
        u.new.first[i] = s


@inline
def pay(now, parts, count, one, two):
    """Subtract (one / eps + two) times the coefficients `parts` from the first `count` multipliers `now`."""
    for k in range(count):
        now.first[k] -= one * parts[k]
        now.second[k] -= two * parts[k]


@inner
def exchange(p, dependent, newest):
    """Return the active constraint to drop for a new one that depends linearly on the active set, or NONE.

    NONE means that the new constraint, number `newest`, contradicts the others. The multipliers are updated for the exchange.
    `dependent` is the inequality that is a linear combination of active constraints. The new constraint is this inequality itself,
    or a bound in the combination.
    """
    u, r, n = p.u, p.r, p.size
    parts(p, dependent)
    side = u.held[newest] if newest < n else 1
    part = u.new.first[newest] if newest < n else r.new.first[newest - n]
    # The new constraint is no part of the combination, so the inequality seemed independent only through rounding.
    if not abs(part) > SAME:
        return n + dependent
    for i in range(n):
        u.new.first[i] *= -side / part
    for k in range(p.planes):
        r.new.first[k] *= -side / part
    one, two, blocking = np.inf, np.inf, NONE
    for i in range(n):
        part = u.new.first[i] * u.held[i]
        if part > SAME and i != newest and u.floor[i] < u.roof[i]:
            a, c = u.now.first[i] * u.held[i] / part, u.now.second[i] * u.held[i] / part
            if a < one or (a == one and c < two):
                one, two, blocking = a, c, i
    for k in range(p.planes):
        part = r.new.first[k]
        if part > SAME and n + k != newest:
            a, c = r.now.first[k] / part, r.now.second[k] / part
            if a < one or (a == one and c < two):
                one, two, blocking = a, c, n + k
    if blocking != NONE:  # The new constraint's own coefficient is -side, so its multiplier grows.
        pay(u.now, u.new.first, n, one, two)
        pay(r.now, r.new.first, p.planes, one, two)
    return blocking
