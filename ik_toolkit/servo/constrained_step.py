"""One step of joint rates inside a box and half-planes: the task first, then closeness to a rate that is wanted.

Pure linear algebra; what the box and the half-planes come from is the caller's. Unknowns are divided by `scale`, a speed for each
joint. Never a weighted sum of the two objectives: see hierarchical_qp.py.

LEAVE keeps the clock and leaves the task as little as possible. SLOW lets the reference's clock slow down: the task rate is
feedback + rate * forward with 0 <= rate <= cap, the task error first, then the clock as fast as it can be. DIRECT finds the largest
alpha at which J x = alpha v is possible, then gives up direction as little as possible for what is left.

A direction of the task whose singular value is below `singular` is damped on its own (Chiaverini, 1997, towards the wanted rate
instead of rest), and the feed-forward along it is cut as the rate wanted leaves the box (J-PARSE: Guptasarma et al., 2025).
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.array_view import LINE, cut
from ..compile.jit import build, compiled, inline, inner, spliced
from ..kernel.linalg import make_rows_orthogonal
from ..kernel.records import Array
from .equality_qp import (
    HIGH,
    LOW,
    ONE,
    RHS,
    ROW_ONE,
    ROW_TWO,
    SIZE,
    TWO,
    WANT,
    Levels,
    Y,
    damp,
    dot,
    from_rest,
    levels_on,
    levels_space,
    regular,
)
from .hierarchical_qp import CONTRADICTION, DONE, SAME_TASK, UNMET, solve_levels, unmet
from .qp_stages import add_clock, aside, ease, even_out, near, slack

LEAVE, SLOW, DIRECT = range(3)
WANTED, MET, SHORT, RELAXED, INEXACT = range(5)
FULL, CLOCK, ASIDE, EASED, NEAR, SLACK = range(6)  # problems to solve; CLOCK to NEAR begin from their own last sets
SLOWED = 1  # bit 0 of what is kept of the last step: it ended with a slower clock; bits 1 to 4: those of them that were solved
FULL_CLOCK = 1e-6  # share of cap from which on a full clock is tried
LOOSE = 1e-9  # half-planes are loosened by this much more than the least slack, so that their gap exceeds rounding
TOUCHING = 1e-9  # of a joint's speed: further from a bound it does not hold
CUT_AT = 0.1  # of a joint's speed: where the rate wanted is that far outside the box, the feed-forward is removed


@compiled
class Room(NamedTuple):
    """Scratch of `constrain`."""

    levels: Levels
    task: Array  # (K, 2) feedback and forward of each row


@inline
def room_space(n, m, rows):
    """Length of a block that has room for `Room`."""
    return levels_space(n + m + 1, rows + m + 1) + 2 * (rows + m + 1) + LINE


@spliced
def room_on(block, n, m, rows):
    """Room for n joints, a task of m and so many half-planes, cut from a block of zeros."""
    return Room(levels_on(block, n + m + 1, rows + m + 1), *cut(block, np.float64, ((rows + m + 1, 2),)))


@build
def make_room(n, m, rows):
    """The same with its own block, for code that runs on arrays and counts references."""
    return room_on(np.zeros(room_space(n, m, rows)), n, m, rows)


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
def cut_away(J, weight, feedback, forward, rate, want, scale, low, high, A, b, count):
    """Share of the feed-forward to remove along damped directions; below 0: the rate wanted is inside and does the task."""
    far = outside(want, scale, low, high, A, b, count)
    miss, size = task_error(J, weight, feedback, forward, rate, want)
    if far == 0.0 and miss <= SAME_TASK * SAME_TASK * size:
        return -1.0
    return min(1.0, max(far / CUT_AT, math.sqrt(miss / size) if size > 0.0 else 0.0))


@inner
def bound(scale, low, high, A, b, count, loose, P, V, S):
    """Write the box and the half-planes in scaled unknowns."""
    n = scale.shape[0]
    for i in range(n):
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


@inner
def load(J, weight, feedback, forward, want, scale, count, cap, P, V, S, task):
    """Write the rate wanted and the task in scaled unknowns, the clock full: how many rows the task has."""
    n = J.shape[0]
    for i in range(n):
        V[WANT, i] = want[i] / scale[i]
    r = 0
    for c in range(J.shape[1]):
        size = 0.0
        k = count + r
        for i in range(n):
            P[k, i] = weight[c] * J[i, c] * scale[i]
            size += P[k, i] * P[k, i]
        if size > 0.0:
            task[k, 0] = weight[c] * feedback[c]
            task[k, 1] = weight[c] * forward[c]
            S[RHS, k] = task[k, 0] + cap * task[k, 1]
            r += 1
    return r


@inner
def prepare(
    J, weight, feedback, forward, want, scale, low, high, A, b, count, mode, cap, singular, damping, cut, loose, mu,
    P, L, V, S, task,
):  # fmt: skip
    """Write the problem with the clock full: the number of the task's rows."""
    n = J.shape[0]
    bound(scale, low, high, A, b, count, loose, P, V, S)
    r = load(J, weight, feedback, forward, want, scale, count, cap, P, V, S, task)
    if mu == 0.0 and not regular(P, L, count, r, n, singular):  # else all directions are damped
        make_rows_orthogonal(P, task, S[SIZE], count, r, n)
        r = damp(P, V, S, task, count, r, n, singular, damping, cap, cut)
    if mode == DIRECT:
        for k in range(count, count + r):
            task[k, 1] = S[RHS, k]
    return r


@inner
def recall(active, kept, rows, n, count, state):
    """Start from what held at the end of the last step."""
    for i in range(n):
        state[i] = active[i] if active[i] < 2 else 0
    for k in range(count):
        state[rows + k] = kept[k]
    state[n] = 0


@inner
def keep_set(state, rows, n, count, start):
    """Keep what holds as the start of a problem of the next step."""
    for i in range(n):
        start[i] = state[i]
    for k in range(start.shape[0] - n):
        start[n + k] = state[rows + k] if k < count else 0


@inner
def take_set(before, stage, starts, rows, n, count, state):
    """Start from what held at the end of this problem in the last step, where it was solved."""
    if CLOCK <= stage <= NEAR and before >> stage & 1:
        start = starts[stage - CLOCK]
        for i in range(n):
            state[i] = start[i]
        for k in range(count):
            state[rows + k] = start[n + k]


@inner
def as_wanted(want, x, active, kept, multiplier):
    """The rate wanted, bit for bit; no constraint is active."""
    for i in range(x.shape[0]):
        x[i] = want[i]
        active[i] = 0
    for k in range(kept.shape[0]):
        kept[k] = 0
    for k in range(multiplier.shape[0]):
        multiplier[k] = 0.0


@inner
def price(scale, count, unit, V, S, state, multiplier):
    """Write the multipliers of what holds in the caller's units; unit: of the second objective's."""
    n = scale.shape[0]
    for i in range(n):
        one = V[ONE, i] if V[ONE, i] != 0.0 else unit * V[TWO, i]
        multiplier[i] = one / scale[i] if state[i] != 0 else 0.0
    for k in range(multiplier.shape[0] - n):
        multiplier[n + k] = 0.0
        if k < count and state[V.shape[1] + k] != 0:
            multiplier[n + k] = S[ROW_ONE, k] if S[ROW_ONE, k] != 0.0 else unit * S[ROW_TWO, k]


@inner
def hold_on(start, n, count, P, V, S, state):
    """Let hold as well what held in the problem before and is still touched: it was in the way of the tip."""
    for i in range(n):
        if state[i] == 0 and start[i] != 0 and abs(V[HIGH if start[i] > 0 else LOW, i] - V[Y, i]) <= TOUCHING:
            state[i] = start[i]
    for k in range(count):
        if start[n + k] != 0 and dot(P, k, V, Y, n) >= S[RHS, k] - TOUCHING:
            state[P.shape[1] + k] = 1


@inner
def answer(scale, low, high, A, count, V, state, x, active, kept):
    """Write the rate that was found, and what holds, in the caller's units."""
    n = x.shape[0]
    for i in range(n):
        active[i] = state[i]
        if state[i] == 0:
            x[i] = min(max(V[Y, i] * scale[i], low[i]), high[i])
        else:
            x[i] = high[i] if state[i] > 0 else low[i]
    for k in range(kept.shape[0] - 1):
        kept[k] = 0
        if k < count and state[V.shape[1] + k] != 0:
            kept[k] = 1
            for i in range(n):
                if active[i] == 0 and A[k, i] != 0.0:
                    active[i] = 2


@spliced
def constrain(
    J, weight, feedback, forward, want, beside, scale, low, high, A, b, count, mode, cap, singular, damping, room,
    x, active, kept, starts, multiplier, step=0.0, mu=0.0,
):  # fmt: skip
    """Write to x (n,) the rate that does the task as well as possible, then is nearest to `want`; return status and clock rate.

    J (n, m), one joint a row; weight (m,) of what counts, 0 where it does not; feedback, forward (m,): the task rate asked is
    feedback + rate * forward. want (n,): the rate wanted at rate = cap; beside (n,): the part of it that is none of the task.
    scale (n,): a speed for each joint, in which its motion and the singular values are measured. low <= high (n,);
    A[:count] x <= b[:count]. mode: LEAVE, SLOW, DIRECT. singular, damping: the singular value below which a direction is
    damped, and the largest damping. step [s]: where the task cannot be met, motion is damped by the residual in this time (see
    `ease`), so that the joints come to rest where it is least; 0: not. mu above 0 (LEAVE): the task is damped by it from the first.

    active (n,), kept (R + 1,) int8 carry what held on to the next step: -1 low, 1 high, 2 in a half-plane that holds. Status
    WANTED: x is `want`, bit for bit, which lies inside and does the task. MET: the task is done at the rate returned (SLOW: of
    the clock, DIRECT: alpha). SHORT: not all of it can be. RELAXED: the half-planes contradict each other or the box and were
    loosened by the least slack. INEXACT: no optimum was found in the iterations allowed, x is only inside the box. starts
    (4, n + R + 1) int8 carries on what held in the problems of the clock, of leaving the direction, the damped one and the one near
    it: each is solved soonest from its own last set. multiplier
    (n + R,): of the bounds, positive at high, then of the half-planes: of the task error (with step, of the damped one), or
    where that has none, of the closeness to `want`.
    """
    s = room.levels
    return solve_step(
        J, weight, feedback, forward, want, beside, scale, low, high, A, b, count, mode, cap, singular, damping, step, mu,
        x, active, kept, starts, multiplier, s.P, s.W, s.L, s.U, s.V, s.S, s.state, s.order, room.task,
    )  # fmt: skip


@inner
def solve_step(
    J, weight, feedback, forward, want, beside, scale, low, high, A, b, count, mode, cap, singular, damping, step, mu,
    x, active, kept, starts, multiplier, P, W, L, U, V, S, state, order, task,
):  # fmt: skip
    """Carry out `constrain`: one loop over the problems to solve, because the code of each is large."""
    n, last = J.shape[0], kept.shape[0] - 1
    top = cap if mode == SLOW else 1.0
    cut = cut_away(J, weight, feedback, forward, top, want, scale, low, high, A, b, count)
    if cut < 0.0:
        as_wanted(want, x, active, kept, multiplier)
        return WANTED, top
    recall(active, kept, P.shape[1], n, count, state)
    begin = EASED if mu > 0.0 else FULL
    stage = CLOCK if mode != LEAVE and kept[last] & SLOWED else begin
    clock_tried, refused, fresh, moved, done = False, False, True, False, False
    loose, unit, rate, damped, short, r, solved = 0.0, 0.0, top, 1.0, 0.0, 0, 0
    while True:
        if fresh:
            r = prepare(J, weight, feedback, forward, want, scale, low, high, A, b, count, mode, top, singular, damping,
                        cut, loose, mu, P, L, V, S, task)  # fmt: skip
        elif moved:
            bound(scale, low, high, A, b, count, loose, P, V, S)
        take_set(kept[last], stage, starts, P.shape[1], n, count, state)
        fresh, moved, N, rows = False, False, n, r
        if stage == EASED:
            damped, short = ease(P, V, S, state, task, weight, scale, count, r, n, -1.0 if mode == DIRECT else rate,
                                 step, mu)  # fmt: skip
            N = n + r
        elif stage == CLOCK:
            clock_tried = True
            unit = add_clock(P, V, S, task, count, r, n, top)
            N = n + 1 if unit > 0.0 else n
            moved = mode == DIRECT and from_rest(V, S, n, count)
        elif stage == ASIDE:
            aside(P, S, count, r, n, rate)
        elif stage == NEAR:
            near(P, V, S, want, beside, scale, count, r, n, short)
        elif stage == SLACK:
            slack(P, V, S, state, n, count)
            N, rows = n + 1, 1
        only_whole = mode != LEAVE and stage == FULL and not clock_tried
        end = solve_levels(P, W, L, U, V, S, state, order, N, count, rows, only_whole)
        state[n] = 0
        if stage == EASED:
            even_out(P, V, scale, count + r, n, -1.0)
        if stage != NEAR:
            price(scale, count, damped, V, S, state, multiplier)
        if stage == SLACK:
            loose = V[Y, n] * (1.0 + LOOSE) + LOOSE
            stage, fresh, clock_tried, refused = begin, True, False, False
            continue
        if end == UNMET or (end == CONTRADICTION and loose == 0.0):
            stage, refused = CLOCK if end == UNMET else SLACK, True
            continue
        if end == DONE and CLOCK <= stage <= NEAR:
            keep_set(state, P.shape[1], n, count, starts[stage - CLOCK])
            solved |= 1 << stage
        if stage == EASED and end == DONE and mu == 0.0:
            stage = NEAR
            continue
        if end != DONE or stage >= EASED:
            break
        done = not unmet(S, count, r)
        if stage == CLOCK:
            rate = top - unit * V[Y, n] if N > n else top
            if rate >= top * (1.0 - FULL_CLOCK):
                rate, stage = top, ASIDE if refused and mode == DIRECT else FULL
                continue
            rate = max(rate, 0.0)
        if mode == DIRECT and stage != ASIDE and not (stage == FULL and done):
            stage = ASIDE
        elif step > 0.0 and not done:
            stage = EASED
        else:
            break
    kept[last] = solved | (SLOWED if rate < top else 0)
    if stage == NEAR:
        hold_on(starts[EASED - CLOCK], n, count, P, V, S, state)
    answer(scale, low, high, A, count, V, state, x, active, kept)
    return INEXACT if end != DONE else RELAXED if loose > 0.0 else MET if done else SHORT, rate
