"""One step of joint rates inside a box and half-planes: the task first, then closeness to a rate that is wanted.

Pure linear algebra; what the box and the half-planes come from is the caller's. Unknowns are divided by `scale`, a speed for each
joint. Never a weighted sum of the two objectives: see priority.py.

LEAVE keeps the clock and leaves the task as little as possible. SLOW lets the reference's clock slow down: the task rate is
feedback + rate * forward with 0 <= rate <= cap, the task error first, then the clock as fast as it can be. DIRECT finds the largest
alpha at which J x = alpha v is possible, then gives up direction as little as possible for what is left.

A direction of the task whose singular value is below `singular` is damped on its own (Chiaverini, 1997, towards the wanted rate
instead of rest), and the feed-forward along it is cut as the rate wanted leaves the box (J-PARSE: Guptasarma et al., 2025).
"""

import math
from typing import NamedTuple

import numpy as np

from .jit import build, compiled, inline, inner
from .levels import (
    HIGH,
    LOW,
    ONE,
    RHS,
    ROW_ONE,
    ROW_TWO,
    TWO,
    WANT,
    Levels,
    Y,
    dot,
    make_levels,
)  # fmt: skip
from .linalg import ORTHOGONAL, SWEEPS, cholesky
from .priority import CONTRADICTION, DONE, solve_levels
from .records import Array

LEAVE, SLOW, DIRECT = range(3)
WANTED, MET, SHORT, RELAXED, INEXACT = range(5)
SAME_TASK = 1e-9  # share of the task rate by which a rate may miss it and still count as doing it
FLAT = 1e-9  # share of the largest singular value below which a direction does not exist
CLOCK = 1e-4  # size of the clock's column beside the task's largest row: the share its square has against the joints' is 1e-8
CLOCK_FULL = 1e-6  # share of cap from which on a full clock is tried
ASIDE = 100.0  # weight of leaving the direction against falling behind along it, where nothing is blocked
LOOSE = 1e-9  # by how much more than the least slack half-planes are loosened: what is left between them is wider than rounding
CUT_AT = 0.1  # of a joint's speed: where the rate wanted is so far outside the box, the feed-forward is cut in full


@compiled
class Room(NamedTuple):
    """Scratch of `constrain`."""

    levels: Levels
    task: Array  # (3, m) feedback, forward, and both, as far as they count
    loose: Array  # (1,) slack of the half-planes


@build
def make_room(n, m, rows):
    """Room for n joints, a task of m and so many half-planes."""
    return Room(make_levels(n + 1, rows + m + 1), np.zeros((3, rows + m + 1)), np.zeros(1))


@inner
def task_error(J, weight, feedback, forward, rate, x):
    """Squared norms of what x misses of the task at a clock rate, and of the task, both weighted."""
    miss, size = 0.0, 0.0
    for k in range(J.shape[1]):
        v = feedback[k] + rate * forward[k]
        s = -v
        for i in range(J.shape[0]):
            s += J[i, k] * x[i]
        miss += weight[k] * weight[k] * s * s
        size += weight[k] * weight[k] * v * v
    return miss, size


@inner
def outside(want, scale, low, high, A, b, count):
    """By how much the rate wanted is out of the box, as a share of a joint's speed, or breaks a half-plane."""
    most = 0.0
    for i in range(want.shape[0]):
        most = max(most, max(low[i] - want[i], want[i] - high[i]) / scale[i])
    for k in range(count):
        s = -b[k]
        size = 0.0
        for i in range(want.shape[0]):
            s += A[k, i] * want[i]
            size += abs(A[k, i]) * scale[i]
        if s > 0.0:
            most = max(most, s / size if size > 0.0 else 1.0)
    return most


@inner
def load(J, weight, feedback, forward, want, scale, low, high, A, b, count, cap, loose, P, V, S, task):
    """Write the problem in scaled unknowns, the clock full: how many rows the task has, and whether a half-plane is no row."""
    n = J.shape[0]
    for i in range(n):
        V[WANT, i] = want[i] / scale[i]
        V[LOW, i] = low[i] / scale[i]
        V[HIGH, i] = high[i] / scale[i]
    for k in range(count):
        size = 0.0
        for i in range(n):
            P[k, i] = A[k, i] * scale[i]
            size += P[k, i] * P[k, i]
        size = math.sqrt(size)
        S[RHS, k] = max(b[k], 0.0) if size == 0.0 else b[k] / size + loose
        for i in range(n):
            P[k, i] = P[k, i] / size if size > 0.0 else 0.0
    r = 0
    for c in range(J.shape[1]):
        size = 0.0
        k = count + r
        for i in range(n):
            P[k, i] = weight[c] * J[i, c] * scale[i]
            size += P[k, i] * P[k, i]
        if size > 0.0:
            task[0, k] = weight[c] * feedback[c]
            task[1, k] = weight[c] * forward[c]
            S[RHS, k] = task[0, k] + cap * task[1, k]
            r += 1
    return r


@inner
def regular(P, L, first, r, n, least):
    """Whether all singular values of the task's rows are certainly above `least` (by the trace of the inverse of P P')."""
    for k in range(r):
        for c in range(k + 1):
            L[k, c] = dot(P, first + k, P, first + c, n)
    cholesky(L, r, 0.0)
    trace = 0.0
    for c in range(r):  # columns of the inverse of the factor, kept above the diagonal
        for k in range(c, r):
            s = 1.0 if k == c else 0.0
            for j in range(c, k):
                s -= L[k, j] * L[c, j + 1]
            s /= L[k, k]
            L[c, k + 1] = s
            trace += s * s
    return trace * least * least < 1.0


@inner
def rotate(P, task, first, r, n):
    """Turn the task's rows, and what is asked, so that the rows are orthogonal (Hestenes): singular values times directions."""
    for _ in range(SWEEPS):
        rotated = False
        for a in range(first, first + r - 1):
            for c in range(a + 1, first + r):
                p, q, g = dot(P, a, P, a, n), dot(P, c, P, c, n), dot(P, a, P, c, n)
                if not abs(g) > ORTHOGONAL * math.sqrt(p * q):
                    continue
                rotated = True
                d = q - p
                t = (2.0 * g if d >= 0.0 else -2.0 * g) / (abs(d) + math.sqrt(d * d + 4.0 * g * g))
                cs = 1.0 / math.sqrt(1.0 + t * t)
                sn = t * cs
                turn(P, a, c, cs, sn, n)
                for k in range(2):
                    u, v = task[k, a], task[k, c]
                    task[k, a] = cs * u - sn * v
                    task[k, c] = sn * u + cs * v
        if not rotated:
            break


@inner
def turn(P, a, c, cs, sn, n):
    """Rotate two rows into each other."""
    for i in range(n):
        u, v = P[a, i], P[c, i]
        P[a, i] = cs * u - sn * v
        P[c, i] = sn * u + cs * v


@inner
def damp(P, V, S, task, first, r, n, singular, damping, cap, cut):
    """Damp each singular direction towards the wanted rate, inside the box, and cut the feed-forward along it. Rows left.

    s^2 (u'y - d / s)^2 + l^2 (u'y - w)^2 is one row again: of length sqrt(s^2 + l^2), asked (s d + l^2 w) / sqrt(s^2 + l^2).
    """
    top = 0.0
    for k in range(first, first + r):
        top = max(top, dot(P, k, P, k, n))
    kept = first
    for k in range(first, first + r):
        size = math.sqrt(dot(P, k, P, k, n))
        if not size > FLAT * math.sqrt(top):
            continue
        fade = 1.0 - (size / singular) ** 2 if size < singular else 0.0
        extra = (damping * fade) ** 2
        length = math.sqrt(size * size + extra)
        wanted = 0.0
        for i in range(n):
            wanted += P[k, i] * min(max(V[WANT, i], V[LOW, i]), V[HIGH, i])
        wanted /= size
        for i in range(n):
            P[kept, i] = P[k, i] * (length / size)
        task[0, kept] = (size * task[0, k] + extra * wanted) / length
        task[1, kept] = size * task[1, k] * (1.0 - cut * fade) / length
        S[RHS, kept] = task[0, kept] + cap * task[1, kept]
        kept += 1
    return kept - first


@inner
def add_clock(P, V, S, ahead, first, r, n, cap):
    """Let the clock be unknown number n: by how much it is below cap, in units returned. 0: nothing depends on it."""
    size, top = 0.0, 0.0
    for k in range(first, first + r):
        size += ahead[k] * ahead[k]
        top = max(top, dot(P, k, P, k, n))
    if not size > 0.0:
        return 0.0
    unit = CLOCK * math.sqrt(top / size)
    for k in range(first):
        P[k, n] = 0.0
    for k in range(first, first + r):
        P[k, n] = unit * ahead[k]
    V[WANT, n] = 0.0
    V[LOW, n] = 0.0
    V[HIGH, n] = cap / unit
    return unit


@inner
def met(P, V, S, first, r, n):
    """Whether what was found does what is asked."""
    miss, size = 0.0, 0.0
    for k in range(first, first + r):
        s = dot(P, k, V, Y, n) - S[RHS, k]
        miss += s * s
        size += S[RHS, k] * S[RHS, k]
    return miss <= SAME_TASK * SAME_TASK * size


@inner
def aside(P, S, first, r, n, alpha):
    """Weight what leaves the asked direction: ASIDE in full reach, 1 where nothing can be done along it."""
    size = 0.0
    for k in range(first, first + r):
        size += S[RHS, k] * S[RHS, k]
    weight = 1.0 + (ASIDE - 1.0) * alpha
    for i in range(n):
        s = 0.0
        for k in range(first, first + r):
            s += S[RHS, k] * P[k, i]
        s *= (weight - 1.0) / size
        for k in range(first, first + r):
            P[k, i] = weight * P[k, i] - s * S[RHS, k]


@inner
def least_slack(P, W, L, U, V, S, state, order, n, count):
    """The least by which half-planes have to be loosened to have a point in the box: unknown n, the only task."""
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
    state[n] = 0
    solve_levels(P, W, L, U, V, S, state, order, n + 1, count, 1)
    state[n] = 0
    return V[Y, n] * (1.0 + LOOSE) + LOOSE


@inline
def solve_in(room, N, count, r):
    """Solve what `room` holds."""
    s = room.levels
    return solve_levels(s.P, s.W, s.L, s.U, s.V, s.S, s.state, s.order, N, count, r)


@inline
def with_clock(room, ahead, n, count, r, cap, guess):
    """Solve with the clock as an unknown, full where it can be: outcome, rate, whether the task is done at that rate."""
    s = room.levels
    rate = cap
    unit = 0.0
    if guess == 0:  # the clock was full
        s.state[n] = 0
        end = solve_in(room, n, count, r)
        if end != DONE or met(s.P, s.V, s.S, count, r, n):
            return end, rate, end == DONE
    unit = add_clock(s.P, s.V, s.S, ahead, count, r, n, cap)
    if unit == 0.0:
        end = solve_in(room, n, count, r)
        return end, rate, end == DONE and met(s.P, s.V, s.S, count, r, n)
    end = solve_in(room, n + 1, count, r)
    rate = min(max(cap - unit * s.V[Y, n], 0.0), cap)
    done = end == DONE and met(s.P, s.V, s.S, count, r, n + 1)
    s.state[n] = 0
    if end == DONE and rate >= cap * (1.0 - CLOCK_FULL):
        end = solve_in(room, n, count, r)
        return end, cap, end == DONE and met(s.P, s.V, s.S, count, r, n)
    return end, rate, done


@inner
def constrain(
    J, weight, feedback, forward, want, scale, low, high, A, b, count, mode, cap, singular, damping, room,
    x, active, kept, multiplier,
):  # fmt: skip
    """Write to x (n,) the rate that does the task as well as possible, then is nearest to `want`; return status and clock rate.

    J (n, m), one joint a row; weight (m,) of what counts, 0 where it does not; feedback, forward (m,): the task rate asked is
    feedback + rate * forward. want (n,): the rate wanted at rate = cap. scale (n,): a speed for each joint, in which its motion
    and the singular values are measured. low <= high (n,); A[:count] x <= b[:count]. mode: LEAVE, SLOW, DIRECT. singular,
    damping: the singular value below which a direction is damped, and the largest damping.

    active (n,), kept (R + 1,) int8 carry what held on to the next step: -1 low, 1 high, 2 in a half-plane that holds. Status
    WANTED: x is `want`, bit for bit, which lies inside and does the task. MET: the task is done at the rate returned (SLOW: of
    the clock, DIRECT: alpha). SHORT: not all of it can be. RELAXED: the half-planes contradict each other or the box and were
    loosened by the least slack. INEXACT: no optimum was found in the iterations allowed. multiplier (n + R,): of the bounds,
    positive at high, then of the half-planes: of the task error, or where that has none, of the closeness to `want`.
    """
    n = J.shape[0]
    s = room.levels
    task = room.task
    last = kept.shape[0] - 1
    for i in range(multiplier.shape[0]):
        multiplier[i] = 0.0
    far = outside(want, scale, low, high, A, b, count)
    miss, size = task_error(J, weight, feedback, forward, cap, want)
    if far == 0.0 and miss <= SAME_TASK * SAME_TASK * size:
        for i in range(n):
            x[i] = want[i]
            active[i] = 0
        for k in range(last + 1):
            kept[k] = 0
        return WANTED, cap if mode == SLOW else 1.0
    top = cap if mode == SLOW else 1.0
    cut = min(1.0, max(far / CUT_AT, math.sqrt(miss / size) if size > 0.0 else 0.0))
    for i in range(n):
        s.state[i] = active[i] if active[i] < 2 else 0
    for k in range(count):
        s.state[n + 1 + k] = kept[k]
    room.loose[0] = 0.0
    status, rate = MET, top
    for attempt in range(2):
        r = load(
            J, weight, feedback, forward, want, scale, low, high, A, b, count, top, room.loose[0], s.P, s.V, s.S, task
        )
        if singular > 0.0 and not regular(s.P, s.L, count, r, n, singular):
            rotate(s.P, task, count, r, n)
            r = damp(s.P, s.V, s.S, task, count, r, n, singular, damping, top, cut)
        if mode == DIRECT:
            for k in range(count, count + r):
                task[1, k] = s.S[RHS, k]
        end = DONE
        if mode == LEAVE:
            end = solve_in(room, n, count, r)
            done = end == DONE and met(s.P, s.V, s.S, count, r, n)
        else:
            end, rate, done = with_clock(room, task[1], n, count, r, top, kept[last])
        if mode == DIRECT and end == DONE and rate < 1.0:
            aside(s.P, s.S, count, r, n, rate)
            end = solve_in(room, n, count, r)
            done = False
        if end != CONTRADICTION or attempt > 0:
            break
        room.loose[0] = least_slack(s.P, s.W, s.L, s.U, s.V, s.S, s.state, s.order, n, count)
    status = INEXACT if end != DONE else RELAXED if room.loose[0] > 0.0 else MET if done else SHORT
    kept[last] = 1 if rate < top else 0
    for i in range(n):
        active[i] = s.state[i] if low[i] < high[i] else 1
        if s.state[i] == 0:
            y = s.V[Y, i] * scale[i]
            x[i] = min(max(y, low[i]), high[i])
        else:
            x[i] = high[i] if s.state[i] > 0 else low[i]
            multiplier[i] = (s.V[ONE, i] if s.V[ONE, i] != 0.0 else s.V[TWO, i]) / scale[i]
    for k in range(last):
        kept[k] = 0
    for k in range(count):
        if s.state[n + 1 + k] != 0:
            kept[k] = 1
            multiplier[n + k] = s.S[ROW_ONE, k] if s.S[ROW_ONE, k] != 0.0 else s.S[ROW_TWO, k]
            for i in range(n):
                if active[i] == 0 and A[k, i] != 0.0:
                    active[i] = 2
    return status, rate
