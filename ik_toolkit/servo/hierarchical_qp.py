"""Two objectives, the second subject to the first, inside bounds and half-planes: exact, by a dual active set.

    first    |C y - d|^2 least
    second   |y - want|^2 least among those
    always   low <= y <= high, A y <= b

It is the method of Goldfarb and Idnani (1983) for |y - want|^2 + |C y - d|^2 / eps with eps -> 0 carried out on paper: each
multiplier is a pair (first / eps + second) that is compared as one number with an infinitesimal. What is left in each iteration
is a problem with equalities only (equality_qp.py), and the active set of the last step is a start of one iteration.
"""

import math

import numpy as np

from ..compile.jit import inline, inner
from .equality_qp import (
    AFTER_ONE,
    AFTER_TWO,
    HIGH,
    LOW,
    NEXT_ONE,
    NEXT_TWO,
    NONE,
    NORM,
    ONE,
    RHS,
    ROW_ONE,
    ROW_TWO,
    SAME,
    TASK_ONE,
    TWO,
    Y,
    dot,
    equality,
)  # fmt: skip

DONE, STUCK, CONTRADICTION, UNMET = range(4)
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


@inner
def violated(P, V, S, state, N, count):
    """Constraint broken most: unknown i as i, half-plane k as N + k; NONE. Returns it and its side."""
    top = 1.0  # a large unknown leaves its rounding in the others
    for i in range(N):
        top = max(top, abs(V[Y, i]))
    which, side, most = NONE, 0, OUT
    for i in range(N):
        if state[i] == 0:
            under, over = V[LOW, i] - V[Y, i], V[Y, i] - V[HIGH, i]
            excess = max(under, over) / (1.0 + abs(V[Y, i]))
            if excess > most and max(under, over) > OUT * top:
                which, side, most = i, -1 if under > over else 1, excess
    for k in range(count):
        if state[P.shape[1] + k] == 0:
            excess = (dot(P, k, V, Y, N) - S[RHS, k]) / (1.0 + abs(S[RHS, k]))
            if excess > most:
                which, side, most = N + k, 1, excess
    return which, side


@inner
def wrong_most(V, S, state, rows, N, count):
    """What holds with the multiplier whose sign is most wrong, as its place in `state`; NONE."""
    worst, place = 0.0, NONE
    for i in range(N):
        if state[i] != 0 and V[LOW, i] < V[HIGH, i]:
            w = wrong(V[NEXT_ONE, i], V[NEXT_TWO, i], state[i])
            if w > worst:
                worst, place = w, i
    for k in range(count):
        if state[rows + k] != 0:
            w = wrong(S[AFTER_ONE, k], S[AFTER_TWO, k], state[rows + k])
            if w > worst:
                worst, place = w, rows + k
    return place


@inner
def unmet(S, count, r):
    """Whether the last answer misses the task by more than rounding."""
    miss, size = 0.0, 0.0
    for k in range(count, count + r):
        miss += S[TASK_ONE, k] * S[TASK_ONE, k]
        size += S[RHS, k] * S[RHS, k]
    return miss > SAME_TASK * SAME_TASK * size


@inner
def begin(P, V, S, state, N, count, r, cold):
    """Lengths of the rows, and where to start: what held last time, or nothing; joints that cannot move are held."""
    for k in range(count + r):
        S[NORM, k] = math.sqrt(dot(P, k, P, k, N))
    for i in range(N):
        if V[LOW, i] >= V[HIGH, i]:
            state[i] = 1
        elif cold or (V[LOW, i] if state[i] < 0 else V[HIGH, i] if state[i] > 0 else 0.0) in (-np.inf, np.inf):
            state[i] = 0
    for k in range(count):
        if cold:
            state[P.shape[1] + k] = 0


@inner
def solve_levels(P, W, L, U, V, S, state, order, N, count, r, only_whole):
    """Solve; `state` is where to start and what holds in the end. Returns DONE, STUCK or CONTRADICTION (of A y <= b).

    only_whole: return UNMET as soon as it is clear that |C y - d| cannot be 0: from iteration to iteration it only grows.
    """
    rows = P.shape[1]
    for attempt in range(2):  # from what held last time, then from nothing
        begin(P, V, S, state, N, count, r, attempt > 0)
        new = NONE
        adding = False  # first members of the start whose multipliers have the wrong sign are dropped
        for _ in range(PER * (N + count)):
            last = new - N  # below 0: no half-plane
            place = new if last < 0 else rows + last
            dependent = equality(P, W, L, U, V, S, state, order, N, count, r, last)
            if not adding:
                drop = rows + dependent if dependent != NONE else wrong_most(V, S, state, rows, N, count)
            elif dependent == NONE:
                drop = forward(V, S, state, rows, N, count, last)
            else:
                drop = exchange(P, L, V, S, state, order, N, count, dependent, last)
                if drop == NONE:
                    state[place] = 0
                    return CONTRADICTION
            if drop != NONE:
                state[drop] = 0
                continue
            keep(V, S, N, count)
            adding = True
            if only_whole and unmet(S, count, r):
                return UNMET
            new, side = violated(P, V, S, state, N, count)
            if new == NONE:
                return DONE
            if new < N:
                state[new] = side
                V[ONE, new] = 0.0
                V[TWO, new] = 0.0
            else:
                state[rows + new - N] = 1
                S[ROW_ONE, new - N] = 0.0
                S[ROW_TWO, new - N] = 0.0
    return STUCK


@inner
def keep(V, S, N, count):
    """The multipliers just found become the present ones."""
    for i in range(N):
        V[ONE, i] = V[NEXT_ONE, i]
        V[TWO, i] = V[NEXT_TWO, i]
    for k in range(count):
        S[ROW_ONE, k] = S[AFTER_ONE, k]
        S[ROW_TWO, k] = S[AFTER_TWO, k]


@inline
def share(one, two, next_one, next_two, side):
    """How far a multiplier can go from (one, two) to (next_one, next_two) before its sign turns: t + dt eps; t > 1: all the way."""
    if wrong(next_one, next_two, side) == 0.0:
        return 2.0, 0.0
    if one != next_one:
        t = min(max(one / (one - next_one), 0.0), 1.0)
        return t, (two + t * (next_two - two)) / (one - next_one)
    return min(max(two / (two - next_two), 0.0), 1.0), 0.0


@inner
def forward(V, S, state, rows, N, count, last):
    """Move the multipliers towards those just found until one becomes zero; that one, or NONE. last: what is new, minus N."""
    t, dt, blocking = 2.0, 0.0, NONE
    for i in range(N):
        if state[i] != 0 and i != last + N and V[LOW, i] < V[HIGH, i]:
            a, da = share(V[ONE, i], V[TWO, i], V[NEXT_ONE, i], V[NEXT_TWO, i], state[i])
            if a < t or (a == t and da < dt):
                t, dt, blocking = a, da, i
    for k in range(count):
        if state[rows + k] != 0 and k != last:
            a, da = share(S[ROW_ONE, k], S[ROW_TWO, k], S[AFTER_ONE, k], S[AFTER_TWO, k], 1)
            if a < t or (a == t and da < dt):
                t, dt, blocking = a, da, rows + k
    if blocking != NONE:
        for i in range(N):
            one, two = V[NEXT_ONE, i] - V[ONE, i], V[NEXT_TWO, i] - V[TWO, i]
            V[ONE, i] += t * one
            V[TWO, i] += t * two + dt * one
        for k in range(count):
            one, two = S[AFTER_ONE, k] - S[ROW_ONE, k], S[AFTER_TWO, k] - S[ROW_TWO, k]
            S[ROW_ONE, k] += t * one
            S[ROW_TWO, k] += t * two + dt * one
    return blocking


@inner
def exchange(P, L, V, S, state, order, N, count, dependent, last):
    """What is new is a sum of what holds: whose place it takes, after moving the multipliers; NONE: it contradicts them.

    A half-plane that depends on the rest gives the sum, in which the new one, a bound or that half-plane, has its part.
    """
    rows = P.shape[1]
    planes = 0
    for k in range(count):
        S[AFTER_ONE, k] = 0.0
        if state[rows + k] != 0 and k != dependent:
            planes += 1
    for j in range(planes - 1, -1, -1):  # parts of the half-planes
        s = L[dependent, j]
        for h in range(j + 1, planes):
            s -= L[order[h], j] * S[AFTER_ONE, order[h]]
        S[AFTER_ONE, order[j]] = s / L[order[j], j]
    S[AFTER_ONE, dependent] = -1.0
    for i in range(N):  # and of the bounds
        s = 0.0
        if state[i] != 0:
            for k in range(count):
                s -= P[k, i] * S[AFTER_ONE, k]
        V[NEXT_ONE, i] = s
    side = state[last + N] if last < 0 else 1
    part = V[NEXT_ONE, last + N] if last < 0 else S[AFTER_ONE, last]
    if not abs(part) > SAME:  # it has none: by rounding alone the half-plane had seemed to be independent
        return rows + dependent
    for i in range(N):
        V[NEXT_ONE, i] *= -side / part
    for k in range(count):
        S[AFTER_ONE, k] *= -side / part
    one, two, blocking = np.inf, np.inf, NONE
    for i in range(N):
        part = V[NEXT_ONE, i] * state[i]
        if part > SAME and i != last + N and V[LOW, i] < V[HIGH, i]:
            a, c = V[ONE, i] * state[i] / part, V[TWO, i] * state[i] / part
            if a < one or (a == one and c < two):
                one, two, blocking = a, c, i
    for k in range(count):
        part = S[AFTER_ONE, k]
        if part > SAME and k != last:
            a, c = S[ROW_ONE, k] / part, S[ROW_TWO, k] / part
            if a < one or (a == one and c < two):
                one, two, blocking = a, c, rows + k
    if blocking != NONE:  # the new one's part is -side, so its multiplier grows
        for i in range(N):
            V[ONE, i] -= one * V[NEXT_ONE, i]
            V[TWO, i] -= two * V[NEXT_ONE, i]
        for k in range(count):
            S[ROW_ONE, k] -= one * S[AFTER_ONE, k]
            S[ROW_TWO, k] -= two * S[AFTER_ONE, k]
    return blocking
