"""Levenberg-Marquardt for eight targets at once, one in each lane of a SIMD vector: twice as many solves a second as `search`.

Formulas, starts, tests and rules for giving up are those of the search with the rule LM. Only the joint limits differ:
whether a joint is held depends on the sign of the gradient, not of the step. Otherwise the step would have to be computed again
with joints held, almost always for at least one lane. A lane that is done takes the next target. Lanes never exchange data, so an
answer depends on its target alone. Targets that take too long or need care (unreachable, rotations by pi, invalid) are left to the
ordinary search.
"""

# Pyright reports calls of intrinsics, because numba itself passes their first argument.
# pyright: reportCallIssue=false, reportGeneralTypeIssues=false
import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..compile.array_view import cut, keep, space, view
from ..compile.jit import cached, compiled, inline, spliced
from ..compile.simd import WIDTH, bits, full, lane_select
from .algebra import at, at3, diagonal, put, put3, rotation_at, rotation_left
from .checks import CODE
from .counted_error import KIND
from .kinematics import TAU, column, fk, rotation_angle
from .limits import face, legal, middle
from .problem import BEST_OF_ALL
from .records import SIZE, WHAT, Answer, Array, Ends, Orders, copy, read, write
from .search import END, last_attempt
from .serial import serial_on
from .starts import BEST, make_table, rnd, seed_sequence

LEFT = -1  # status of a target that is left to the ordinary search (search.py)
# An attempt is given up when the rotation that is left is near half a turn (1 + cos of its angle is below this), because its axis
# is inaccurate then.
HALF_TURN = 5e-4
# Number of attempts after which a target is left to the ordinary search, so that other lanes need not wait for it.
ATTEMPTS = 32
ALL = (1 << WIDTH) - 1  # mask in which all lanes are set, as a whole number (see `simd.bits`)


@compiled
class Lanes(NamedTuple):
    """Eight attempts at eight targets; the axis of length 8 in each array is the lane, the place of one target in a SIMD vector."""

    Q: Array  # (n, 8) coordinates
    joints: Array  # (6 n, 8) axis and point of each joint, overwritten by the Jacobian
    trig: Array  # (3 n, 8) angles, sines and cosines of the joints
    goals: Array  # (12, 8) targets as `kinematics.aim` writes them
    ceiling: Array  # (1, 8) squared error above which an attempt is given up in this iteration
    decay: Array  # (1, 8) factor of `ceiling` in each iteration
    age: Array  # (1, 8) evaluations in this attempt
    spent: Array  # (1, 8) evaluations in all attempts at this target
    pp: Array  # (1, 8) squared position error of the last evaluation
    rr: Array  # (1, 8) squared rotation error of the last evaluation
    which: Array  # (8,) index of the target, -1 for a lane without one
    tries: Array  # (8,) attempts made at the target
    starts: Array  # (8, BEST) indices of the precomputed configurations from which the first attempts start
    state: Array  # (8, 1) states of the random sequences


@compiled
class Call(NamedTuple):
    """Targets, starts and answers of one call, as `search.entry` describes them."""

    T: Array
    Q0: Array
    out: Array


@spliced
def make_lanes(block, n):
    """Return Lanes that have no targets yet, for a chain of n joints, with arrays cut from the scratch memory `block`."""
    W = WIDTH
    Q, joints, trig, goals, ceiling, decay, age, spent, pp, rr = cut(
        block, np.float64, ((n, W), (6 * n, W), (3 * n, W), (12, W), (1, W), (1, W), (1, W), (1, W), (1, W), (1, W))
    )
    which, tries, starts = cut(block, np.int64, (W, W, (W, BEST)))
    (state,) = cut(block, np.uint64, ((W, 1),))
    s = Lanes(Q, joints, trig, goals, ceiling, decay, age, spent, pp, rr, which, tries, starts, state)
    for lane in range(W):  # A lane without a target is computed like the others, so it needs valid numbers.
        for i in range(n):
            Q[i, lane] = 0.0
        for i in range(12):
            goals[i, lane] = 0.0
        ceiling[0, lane], decay[0, lane], age[0, lane], spent[0, lane] = np.inf, 1.0, 0.0, 0.0
        which[lane], tries[lane] = -1, 0
    return s


@spliced
def lane_errors(rows, tip, s, turning):
    """Return, for each lane, the tip's position, its position and rotation error, and 1 + cos of the angle of rotation left.

    If the last is below HALF_TURN, the rotation error is not valid. rows: (L, 10) geometry; tip (V3): position of the tip in the
    last joint's frame; s: `Lanes`; turning: factor of the rotation error, 0 if only the position counts, else 1.
    """
    now = fk(rows, s.Q, s.joints, s.trig)
    point = now.point + now.axes.times(tip)
    sine, cos1 = rotation_left(now.axes, rotation_at(s.goals, 0))
    angular = sine * (turning * math.sqrt(2.0 / lane_select(cos1 > HALF_TURN, cos1, full(1.0))))
    return point, at3(s.goals, 9) - point, angular, cos1


@spliced
def limited_step(rows, s, ends, turning, point, linear, angular, damping):
    """Take a damped step inside the joint limits for eight targets at once; joints that the gradient pushes past a limit are held.

    s.joints is replaced by the Jacobian. rows: (L, 10) geometry; s: `Lanes`; ends: `Ends`; turning, point, linear, angular: as in
    `lane_errors`; damping: one number a lane.
    """
    n = rows.shape[0]
    zero, one = full(0.0), full(1.0)
    blocks = diagonal(damping)
    for i in range(n):
        u, v = column(rows, s.joints, i, point)
        v = v * turning
        if ends.turns(i) == 0.0:
            slope, q = u.dot(linear) + v.dot(angular), at(s.Q, i)
            out = ((q <= ends.lower(i)) & (slope < 0.0)) | ((q >= ends.upper(i)) & (slope > 0.0))
            w = lane_select(out, zero, one)
            u, v = u * w, v * w
        put3(s.joints, 6 * i, u)
        put3(s.joints, 6 * i + 3, v)
        blocks = blocks.with_column(u, v, u, v)
    y, z = blocks.solve(linear, angular)
    for i in range(n):
        q = at(s.Q, i) + (at3(s.joints, 6 * i).dot(y) + at3(s.joints, 6 * i + 3).dot(z))
        low, high = ends.lower(i), ends.upper(i)
        if ends.turns(i) > 0.0:
            back = q - TAU * np.rint((q - middle(low, high)) * (1.0 / TAU))
            q = lane_select((q < low) | (q > high), back, q)
        # Rounding in a shift by 2 pi may bring the value just outside the limits.
        q = lane_select(q < low, full(low), q)
        q = lane_select(q > high, full(high), q)
        put(s.Q, i, q)


@spliced
def take_target(p, o, ends, table, s, lane, t, call):
    """Put target number t into a lane (place) of the SIMD vectors; return False if it must be left to the ordinary search.

    p: the problem of one tip; o: `Orders`; ends: `Ends`; table: `StartTable`; s: `Lanes`; call: `Call`.
    """
    call.out[t, 0] = LEFT
    excess = p.aim(call.T[t], o)
    given = o.given > 0.0
    if excess != 0.0 or (given and not legal(call.Q0[t if call.Q0.shape[0] > 1 else 0], ends, True)):
        return False
    p.rank(table)
    copy(table.best, s.starts[lane])
    for k in range(12):
        s.goals[k, lane] = p.goal[k]
    seed_sequence(s.state[lane], o.seed)
    s.tries[lane] = 0
    s.spent[0, lane] = 0.0
    s.which[lane] = t
    return True


@spliced
def begin_attempt(o, ends, seeds, s, lane, Q0, last):
    """Begin the next attempt at the target in a lane (place) of the SIMD vectors: set its start and its give-up bound.

    o: `Orders`; ends: `Ends`; seeds, Q0: starts of the table and of the caller; s: `Lanes`; last: number of the attempt that is
    never given up early, see `search.last_attempt`.
    """
    n = s.Q.shape[0]
    k = s.tries[lane] - int(o.given)
    s.ceiling[0, lane], s.decay[0, lane] = o.c_free, o.rho_free
    if k < 0 or s.tries[lane] == last:
        t = s.which[lane] if Q0.shape[0] > 1 else 0
        for i in range(n):
            s.Q[i, lane] = Q0[t, i] / ends.unit(i) if o.given > 0.0 else ends.home(i)
        if s.tries[lane] == last:
            s.ceiling[0, lane] = np.inf
    elif k < BEST:
        s.ceiling[0, lane], s.decay[0, lane] = o.c, o.rho
        for i in range(n):
            s.Q[i, lane] = seeds[s.starts[lane, k], i]
    else:
        for i in range(n):
            s.Q[i, lane] = ends.low(i) + ends.span(i) * rnd(s.state[lane])
    s.tries[lane] += 1


@spliced
def write_answer(p, o, ends, s, lane, wanted, call):
    """Write the answer for the target in a lane to its row of call.out, each joint shifted by 2 pi k to be nearest the start.

    If rounding in the shift brings the answer out of tolerance, nothing is written, and the target is left to the ordinary search.
    wanted (n,) is scratch; the other arguments are those of `take_target`.
    """
    Q0, out = call.Q0, call.out
    t, q, n = s.which[lane], p.desk.q, s.Q.shape[0]
    for i in range(n):
        q[i] = s.Q[i, lane]
        wanted[i] = Q0[t if Q0.shape[0] > 1 else 0, i] / ends.unit(i) if o.given > 0.0 else ends.home(i)
    count = s.spent[0, lane]
    position, rotation = math.sqrt(s.pp[0, lane]) * ends.scale(), rotation_angle(s.rr[0, lane])
    if face(q, wanted, ends):
        count += 1.0
        for k in range(12):
            p.goal[k] = s.goals[k, lane]
        # The target is in reach, so the search aims at the target itself, not at the edge of the reach.
        put3(p.goal, 12, at3(p.goal, 9))
        e = p.evaluate(q)
        if not e.good:  # Rounding in the shift by 2 pi may have brought the error above a tolerance.
            return
        p.keep(e, BEST_OF_ALL)
        position, rotation = p.left(BEST_OF_ALL)
    tries, attempts = float(s.tries[lane]), min(o.attempts, float(ATTEMPTS))
    steps, restarts, found = s.spent[0, lane] - tries, min(tries, attempts) - 1.0, (tries - 1.0) % attempts
    write(
        out[t], 0, Answer(float(CODE.converged), steps, restarts, position, rotation, count, 0.0, 0.0, found, -1.0, 0.0)
    )
    for i in range(n):
        out[t, SIZE.answer + i] = q[i] * ends.unit(i)


@inline
def run_lanes(rows, chain, seeds, features, T, Q0, out, orders, block):
    """Solve for all targets of one call, eight at a time, until each is done or left to the ordinary search.

    This is the body of the function that `lanes` returns, with its arrays as views. chain: the array `ends` of a `Chain`; block:
    scratch memory.
    """
    n = seeds.shape[1]
    o, ends = read(Orders, orders), Ends(chain, n)
    block[0] = 0.0
    p = serial_on(block, rows, chain, orders[SIZE.orders :], n, o)
    table, s = make_table(block, seeds, features, 1), make_lanes(block, n)
    (wanted,) = cut(block, np.float64, (n,))
    damping = orders[SIZE.orders + SIZE.task + n]
    call = Call(T, Q0, out)
    W, N = WIDTH, T.shape[0]
    tip = at3(ends.flat, 21)
    turning = 0.0 if int(p.task[WHAT.kind]) == KIND.position else 1.0
    attempts = min(int(o.attempts), ATTEMPTS)
    last, most = last_attempt(attempts, int(o.given))
    following, live, renew = 0, 0, ALL
    while True:
        if renew != 0:
            for lane in range(W):
                if (renew >> lane) & 1 == 0:
                    continue
                if s.which[lane] >= 0 and s.tries[lane] >= most:
                    s.which[lane] = -1
                    live -= 1
                while s.which[lane] < 0 and following < N:
                    if take_target(p, o, ends, table, s, lane, following, call):
                        live += 1
                    following += 1
                s.age[0, lane] = 0.0
                if s.which[lane] < 0:
                    s.ceiling[0, lane] = np.inf
                else:
                    begin_attempt(o, ends, table.seeds, s, lane, Q0, last)
        if live == 0:
            break
        point, linear, angular, cos1 = lane_errors(rows, tip, s, turning)
        pp, rr = linear.square(), angular.square()
        ee = pp + rr
        seen = (cos1 > HALF_TURN) | (full(turning) < 0.5)
        age, ceiling = at(s.age, 0), at(s.ceiling, 0)
        done = bits((pp < p.tp) & (rr < p.tr) & seen)
        renew = (bits(((ee > ceiling) & (ee > END.rounding)) | (age >= o.iterations)) | ~bits(seen)) & ALL
        put(s.age, 0, age + 1.0)
        put(s.spent, 0, at(s.spent, 0) + 1.0)
        put(s.ceiling, 0, ceiling * at(s.decay, 0))
        if done != 0:
            renew = renew | done
            put(s.pp, 0, pp)
            put(s.rr, 0, rr)
            for lane in range(W):
                if s.which[lane] >= 0 and (done >> lane) & 1:
                    write_answer(p, o, ends, s, lane, wanted, call)
                    s.which[lane] = -1
                    live -= 1
        limited_step(rows, s, ends, turning, point, linear, angular, damping * ee + 1e-12)


@functools.cache
def lanes() -> Callable:
    """Return the compiled batch solver: solve(rows, ends, seeds, features, T, Q0, out, orders).

    It serves chains of one tip without mimic joints, and targets that are whole poses or positions. The joint limits must be kept
    and the joint weights be equal; the option `closest` and a budget of evaluations must not be set.

    Returns:
        A function of four arrays of a `Chain`, and of T, Q0, out and orders as `search.entry` describes them for the rule LM. A row
        of out that gets the status LEFT belongs to a target that is left to the search.
    """

    def solve(rows, ends, seeds, features, T, Q0, out, orders):
        L, N = rows.shape[0], seeds.shape[0]
        lanes_take = WIDTH * (10 * L + 64)  # how many numbers `make_lanes` takes from the memory `block`
        block = np.empty(space(seeds.shape[1], 6, L, N) + lanes_take)
        run_lanes(
            view(rows), view(ends), view(seeds), view(features), view(T), view(Q0), view(out), view(orders), view(block)
        )  # fmt: skip
        keep(block)

    return cached(solve)
