"""Two objectives, the second subject to the first, inside bounds and half-planes: exact, by a dual active set.

    first    |C y - d|^2 least
    second   |y - want|^2 least among those
    always   floor <= y <= roof, A y <= b

It is the method of Goldfarb and Idnani (1983) for |y - want|^2 + |C y - d|^2 / eps with eps -> 0 carried out on paper: each
multiplier is a pair (first / eps + second) that is compared as one number with an infinitesimal. What is left in each iteration
is a problem with equalities only (equality_qp.py), and the active set of the last step is a start of one iteration.

A constraint is a number: unknown i is i, half-plane k is p.size + k.
"""

import math

import numpy as np

from ..compile.jit import inline, inner
from .equality_qp import NONE, SAME, dot, equality, square

DONE, STUCK, CONTRADICTION = range(3)
OUT = 1e-12  # by how much a bound or half-plane may be broken; speeds are of order 1, and the caller clips to bounds
WRONG = 1e-11  # by how much a multiplier of the second objective may have the wrong sign
SAME_TASK = 1e-9  # share of the task by which it may be missed and still count as met
PER = 10  # iterations allowed for each unknown and half-plane


@inline
def wrong(one, two, side):
    """How wrong the sign of a multiplier is: a pair compared as one number with an infinitesimal; 0: right."""
    if one * side != 0.0:
        return 1.0 - one * side if one * side < 0.0 else 0.0
    return min(-two * side, 1.0) if two * side < -WRONG else 0.0


@inline
def violated(p):
    """Constraint broken most, and its side; NONE."""
    u, r, n = p.u, p.r, p.size
    top = 1.0  # a large unknown leaves its rounding in the others
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
    """What holds with the multiplier whose sign is most wrong; NONE."""
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
    """Whether the last answer misses the task by more than rounding."""
    miss, size = 0.0, 0.0
    for k in range(p.planes, p.planes + p.task):
        miss += p.r.new.first[k] * p.r.new.first[k]
        size += p.r.rhs[k] * p.r.rhs[k]
    return miss > SAME_TASK * SAME_TASK * size


@inline
def begin(p, cold):
    """Lengths of the rows, and where to start: what held last time, or nothing; joints that cannot move are held."""
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
    """Let a constraint not hold."""
    if which < p.size:
        p.u.held[which] = 0
    else:
        p.r.holds[which - p.size] = 0


@inline
def enforce(p, which, side):
    """Let a constraint hold, at no price yet."""
    if which < p.size:
        p.u.held[which] = side
        p.u.now.first[which], p.u.now.second[which] = 0.0, 0.0
    else:
        k = which - p.size
        p.r.holds[k] = 1
        p.r.now.first[k], p.r.now.second[k] = 0.0, 0.0


@inner
def solve_levels(p):
    """Solve; what holds is where to start, and what holds in the end. Returns DONE, STUCK or CONTRADICTION (of A y <= b)."""
    n = p.size
    for attempt in range(2):  # from what held last time, then from nothing
        begin(p, attempt > 0)
        new = NONE
        adding = False  # first members of the start whose multipliers have the wrong sign are dropped
        for _ in range(PER * (n + p.planes)):
            last = new - n  # below 0: no half-plane
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
    """The multipliers just found become the present ones."""
    u, r = p.u, p.r
    for i in range(p.size):
        u.now.first[i], u.now.second[i] = u.new.first[i], u.new.second[i]
    for k in range(p.planes):
        r.now.first[k], r.now.second[k] = r.new.first[k], r.new.second[k]


@inline
def share(now, new, at, side):
    """How far the multiplier at a place can go from now to new before its sign turns: t + dt eps; t > 1: all the way."""
    one, two, next_one, next_two = now.first[at], now.second[at], new.first[at], new.second[at]
    if wrong(next_one, next_two, side) == 0.0:
        return 2.0, 0.0
    if one != next_one:
        t = min(max(one / (one - next_one), 0.0), 1.0)
        return t, (two + t * (next_two - two)) / (one - next_one)
    return min(max(two / (two - next_two), 0.0), 1.0), 0.0


@inline
def go(now, new, count, t, dt):
    """Move multipliers by t + dt eps of the way to the new ones."""
    for k in range(count):
        one, two = new.first[k] - now.first[k], new.second[k] - now.second[k]
        now.first[k] += t * one
        now.second[k] += t * two + dt * one


@inline
def move_on(p, newest):
    """Move the multipliers towards those just found until one becomes zero; that one, or NONE."""
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
    """Write to new.first the parts of bounds and half-planes in a half-plane that is a sum of them; its own is -1."""
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
    """Take so much of each part from the multipliers."""
    for k in range(count):
        now.first[k] -= one * parts[k]
        now.second[k] -= two * parts[k]


@inner
def exchange(p, dependent, newest):
    """What is new is a sum of what holds: whose place it takes, after moving the multipliers; NONE: it contradicts them.

    A half-plane that depends on the rest gives the sum, in which the new one, a bound or that half-plane, has its part.
    """
    u, r, n = p.u, p.r, p.size
    parts(p, dependent)
    side = u.held[newest] if newest < n else 1
    part = u.new.first[newest] if newest < n else r.new.first[newest - n]
    if not abs(part) > SAME:  # it has none: by rounding alone the half-plane had seemed to be independent
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
    if blocking != NONE:  # the new one's part is -side, so its multiplier grows
        pay(u.now, u.new.first, n, one, two)
        pay(r.now, r.new.first, p.planes, one, two)
    return blocking
