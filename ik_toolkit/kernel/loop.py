"""The one iteration loop, compiled once per rule.

A rule is a NamedTuple class (its fields document the parameters) and one function registered for it with `@rule`. The
class is the type that selects the compiled loop: one source of the loop, no call overhead, and a disk cache that works
between processes, because a class is pickled by reference. With NUMBA_DISABLE_JIT=1 the same code runs as plain Python.

Order in every iteration: evaluate, best-so-far, test, budget, give up, step, limits, integrate, stall. The q reported is
always one that was evaluated. Restarts wrap the loop.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from .jit import OPTIONS, cached, inline, jit, kernel_stamp, source_file
from .kinematics import TAU, aim, angle_ratio, columns, error, fk, rotation_angle
from .linalg import hold
from .seeds import BEST, nearest, rnd

CONVERGED, STALLED, ITERATION_LIMIT, LIMIT_BLOCKED, UNREACHABLE, SINGULAR, NOT_FINITE, CHECK_FAILED, BAD_TARGET = range(9)
POSE, POSITION, MASK_BASE, MASK_TIP, AXIS = range(5)  # what of the pose error counts
SINGULAR_STEP, WAITING = -1, -2  # what a rule may return instead of a count of evaluations

# Slots of `opt`; the joint weights (n) and then the rule's parameters follow at OPT_HEAD.
O_TOL_P, O_TOL_R, O_GIVEN, O_ITERATIONS, O_DESCENTS = 0, 1, 2, 3, 4
O_C, O_RHO, O_C_FREE, O_RHO_FREE, O_KIND, O_W = 5, 6, 7, 8, 9, 10  # O_W: six weights, or the tip axis for AXIS
O_EVALUATIONS, O_LIMITS, O_SEED, O_CLOSEST, O_STALL, O_HOLD = 16, 17, 18, 19, 20, 21
OPT_HEAD = 24
# Slots of a row of `out`; q (n) follows at OUT_HEAD.
R_STATUS, R_ITERATIONS, R_RESTARTS, R_POSITION, R_ROTATION, R_EVALUATIONS, R_HISTORY, R_EXCESS = range(8)
OUT_HEAD = 8
# Slots of `ends`: base (12), tip (12), then seven vectors of n, then the tail.
E_VECTORS = 24
TAIL = 7  # scale, reach of tip, hole of tip, reach of last joint, hole of last joint, lift low, lift high

Array = np.ndarray


class Step(NamedTuple):
    """What a step rule sees. Lengths are divided by the chain's scale; axes are those of the first joint.

    Few arrays on purpose: each costs reference counting in the hot loop.
    """

    q: Array  # (n,) current coordinates
    dq: Array  # (n,) to be written
    w: Array  # (n,) joint weights; 0 holds a joint in this step
    J: Array  # (n, 6) Jacobian, one joint a row, linear part first; may be overwritten
    x: Array  # (4 n + 8,) state of the rule, zeroed at the start of a descent
    V: Array  # (6, 6) scratch
    y: Array  # (6,) scratch


class Sweep(NamedTuple):
    """What a sweep rule sees: it moves one joint at a time, so it evaluates the chain itself (`try_out`)."""

    q: Array  # (n,) current coordinates; a sweep may write it and puts it back
    dq: Array  # (n,) to be written
    w: Array  # (n,) 0 holds a joint
    x: Array  # (4 n + 8,) state of the rule, zeroed at the start of a descent
    lower: Array
    upper: Array
    unit: Array  # (n,) 1 for an angle, the chain's scale for a slide
    rows: Array
    ends: Array
    tip: Array  # (12,)
    goal: Array  # (12,) see kinematics.aim
    mask: Array  # (6,)
    Z: Array
    ang: Array
    sn: Array
    cs: Array
    V: Array
    y: Array
    opt: Array


class Err(NamedTuple):
    """Error target - tip: position, 2 sin(angle/2) * axis, and the squared norm of all six."""

    e0: float
    e1: float
    e2: float
    e3: float
    e4: float
    e5: float
    pp: float
    rr: float
    ee: float


RULES: dict[type, Callable] = {}
SWEEPS: set[type] = set()


def rule(cls: type, *, sweep: bool = False) -> Callable:
    """Register the decorated function f(cls, p, s, e) as the step of the rule class `cls`.

    p: parameters; s: Step, or Sweep; e: Err. It writes s.dq and returns the number of FK evaluations it made itself (0),
    SINGULAR_STEP, or WAITING (a step of zero that is no stall). It never tests convergence, counts or clips for the caller.
    """

    def add(function: Callable) -> Callable:
        RULES[cls] = function
        if sweep:
            SWEEPS.add(cls)
        return function

    return add


def step(cls, p, s, e):
    """Call the rule's function (plain Python; numba resolves it by class at compile time)."""
    return RULES[cls](cls, p, s, e)


@overload(step, jit_options=dict(OPTIONS, forceinline=True))
def _step(cls, p, s, e):
    return RULES[cls.instance_class]


@jit
def shape_error(kind, w, ends, goal, V, y, x0, x1, x2, y0, y1, y2, z0, z1, z2, e0, e1, e2, e3, e4, e5):
    """Set to zero, rotate or replace what of the pose error does not count; V and y keep what `shape_columns` needs.

    w: six weights for the masks (base axes, or tip axes), or the tip axis (in the last joint's frame) for AXIS.
    """
    if kind == 1:  # POSITION
        return e0, e1, e2, 0.0, 0.0, 0.0
    if kind == 4:  # AXIS: from a (now) to b (wanted)
        a0 = x0 * w[0] + y0 * w[1] + z0 * w[2]
        a1 = x1 * w[0] + y1 * w[1] + z1 * w[2]
        a2 = x2 * w[0] + y2 * w[1] + z2 * w[2]
        b0 = goal[0] * w[0] + goal[1] * w[1] + goal[2] * w[2]
        b1 = goal[3] * w[0] + goal[4] * w[1] + goal[5] * w[2]
        b2 = goal[6] * w[0] + goal[7] * w[1] + goal[8] * w[2]
        y[0], y[1], y[2] = a0, a1, a2
        cos1 = 1.0 + a0 * b0 + a1 * b1 + a2 * b2
        if cos1 > 1e-9:
            f = math.sqrt(2.0 / cos1)
            return e0, e1, e2, f * (a1 * b2 - a2 * b1), f * (a2 * b0 - a0 * b2), f * (a0 * b1 - a1 * b0)
        if abs(a0) < 0.7:  # opposite: any axis across will do
            f = 2.0 / math.sqrt(a1 * a1 + a2 * a2)
            return e0, e1, e2, 0.0, -a2 * f, a1 * f
        f = 2.0 / math.sqrt(a0 * a0 + a1 * a1)
        return e0, e1, e2, -a1 * f, a0 * f, 0.0
    for r in range(3):  # masks: rotate to the named frame, weight
        if kind == 2:
            V[r, 0], V[r, 1], V[r, 2] = ends[3 * r], ends[3 * r + 1], ends[3 * r + 2]
        else:
            t0, t1, t2 = ends[12 + r], ends[15 + r], ends[18 + r]
            V[r, 0], V[r, 1], V[r, 2] = x0 * t0 + y0 * t1 + z0 * t2, x1 * t0 + y1 * t1 + z1 * t2, x2 * t0 + y2 * t1 + z2 * t2
    ratio = angle_ratio(e3 * e3 + e4 * e4 + e5 * e5)
    e3, e4, e5 = e3 * ratio, e4 * ratio, e5 * ratio
    return (
        w[0] * (V[0, 0] * e0 + V[0, 1] * e1 + V[0, 2] * e2),
        w[1] * (V[1, 0] * e0 + V[1, 1] * e1 + V[1, 2] * e2),
        w[2] * (V[2, 0] * e0 + V[2, 1] * e1 + V[2, 2] * e2),
        w[3] * (V[0, 0] * e3 + V[0, 1] * e4 + V[0, 2] * e5),
        w[4] * (V[1, 0] * e3 + V[1, 1] * e4 + V[1, 2] * e5),
        w[5] * (V[2, 0] * e3 + V[2, 1] * e4 + V[2, 2] * e5),
    )


@jit
def shape_columns(kind, w, V, y, J):
    """Remove from the Jacobian what does not count, at the configuration shaped last."""
    for i in range(J.shape[0]):
        if kind == 1:
            J[i, 3], J[i, 4], J[i, 5] = 0.0, 0.0, 0.0
        elif kind == 4:
            d = y[0] * J[i, 3] + y[1] * J[i, 4] + y[2] * J[i, 5]
            J[i, 3] -= d * y[0]
            J[i, 4] -= d * y[1]
            J[i, 5] -= d * y[2]
        else:
            for h in range(0, 6, 3):
                u, v, t = J[i, h], J[i, h + 1], J[i, h + 2]
                for r in range(3):
                    J[i, h + r] = w[h + r] * (V[r, 0] * u + V[r, 1] * v + V[r, 2] * t)


def _measure(rows, ends, tip, goal, w, kind, q, Z, ang, sn, cs, V, y):
    """Evaluate the chain at q: tip point, and the error with what does not count set to zero."""
    x0, x1, x2, y0, y1, y2, z0, z1, z2, px, py, pz = fk(rows, q, Z, ang, sn, cs)
    px, py, pz, e0, e1, e2, e3, e4, e5 = error(goal, tip, x0, x1, x2, y0, y1, y2, z0, z1, z2, px, py, pz)
    if kind > 0:
        e0, e1, e2, e3, e4, e5 = shape_error(
            kind, w, ends, goal, V, y, x0, x1, x2, y0, y1, y2, z0, z1, z2, e0, e1, e2, e3, e4, e5
        )
    pp = e0 * e0 + e1 * e1 + e2 * e2
    rr = e3 * e3 + e4 * e4 + e5 * e5
    return px, py, pz, Err(e0, e1, e2, e3, e4, e5, pp, rr, pp + rr)


measure_inline = inline(_measure)  # for the hot place in the loop
measure = jit(_measure)  # for the others, so that the loop stays small


@jit
def beyond(goal, tip, tail, kind, tol_p, tol_r):
    """Length by which the target lies outside the reach bound (0 = not proven unreachable), in kernel units."""
    worst = 0.0
    if kind > 1:
        return worst
    for k in range(2 if kind == 0 else 1):
        x, y, z = goal[9], goal[10], goal[11]
        slack = tol_p
        if k == 1:  # the last joint's point is fixed by the pose: the arm without its tool must reach it
            for r in range(3):
                g = goal[3 * r] * tip[9] + goal[3 * r + 1] * tip[10] + goal[3 * r + 2] * tip[11]
                if r == 0:
                    x -= g
                elif r == 1:
                    y -= g
                else:
                    z -= g
            slack += tol_r * math.sqrt(tip[9] * tip[9] + tip[10] * tip[10] + tip[11] * tip[11])
        slack += 1e-9
        r2 = x * x + y * y
        nearest_z = min(max(z, tail[5]), tail[6])
        d = math.sqrt(r2 + (z - nearest_z) * (z - nearest_z))
        worst = max(worst, d - tail[1 + 2 * k] - slack)
        far = max(abs(z - tail[5]), abs(z - tail[6]))
        d = math.sqrt(r2 + far * far)
        worst = max(worst, tail[2 + 2 * k] - d - slack)
    return worst


@jit
def rigid(T):
    """Whether T (4, 4) is finite, its rotation orthonormal to 1e-6 and right-handed (NaN fails every test)."""
    total = 0.0
    for r in range(3):
        total += abs(T[r, 3])
        for c in range(r, 3):
            g = T[0, r] * T[0, c] + T[1, r] * T[1, c] + T[2, r] * T[2, c]
            if not abs(g - (1.0 if r == c else 0.0)) < 1e-6:
                return False
    det = T[0, 0] * (T[1, 1] * T[2, 2] - T[1, 2] * T[2, 1]) - T[0, 1] * (T[1, 0] * T[2, 2] - T[1, 2] * T[2, 0])
    det += T[0, 2] * (T[1, 0] * T[2, 1] - T[1, 1] * T[2, 0])
    return det > 0.0 and total < 1e300


@jit
def turn(wanted, q, lower, upper, turns):
    """Full turns by which to move a joint so that it comes nearest `wanted` away, inside its limits unless it is endless."""
    k = np.rint(wanted / TAU)
    if turns < 1.5:
        k = min(max(k, math.ceil((lower - q) / TAU)), math.floor((upper - q) / TAU))
    return k


@jit
def why(q, lower, upper, J, e, limits):
    """Status of a descent that stands still: blocked by limits, singular (the Jacobian cannot see the error), or stalled."""
    whole, free, size = 0.0, 0.0, 0.0
    for i in range(q.shape[0]):
        g = J[i, 0] * e.e0 + J[i, 1] * e.e1 + J[i, 2] * e.e2 + J[i, 3] * e.e3 + J[i, 4] * e.e4 + J[i, 5] * e.e5
        for k in range(6):
            size += J[i, k] * J[i, k]
        whole += g * g
        if not (limits and ((q[i] <= lower[i] and g < 0.0) or (q[i] >= upper[i] and g > 0.0))):
            free += g * g
    if whole <= 1e-16 * e.ee * size:
        return SINGULAR
    if free < 1e-4 * whole:
        return LIMIT_BLOCKED
    return STALLED


_ENTRIES: dict[type, Callable] = {}


def entry(cls: type) -> Callable:
    """Return the compiled loop of a rule class: solve(rows, ends, seeds, feat, T, Q0, out, opt, hist).

    T (N, 4, 4) [m]; Q0 (1 or N, n) start if opt[O_GIVEN], and the turn nearest to it is returned; out (N, 8 + n);
    hist (H, 2 + n) receives position error, orientation error and q of each evaluation (H may be 0).
    """
    if cls in _ENTRIES:
        return _ENTRIES[cls]
    stamp = kernel_stamp(source_file(RULES[cls]))
    sweeping = cls in SWEEPS

    @cached
    def solve(rows, ends, seeds, feat, T, Q0, out, opt, hist):
        stamp  # noqa: B018  a closure cell is part of the cache key: an edited kernel file recompiles
        L = rows.shape[0]
        n = seeds.shape[1]
        Lp = (L + 3) // 4 * 4
        v = E_VECTORS
        tip = ends[12:24]
        lower, upper, turns, unit = ends[v : v + n], ends[v + n : v + 2 * n], ends[v + 2 * n : v + 3 * n], ends[v + 3 * n : v + 4 * n]
        low, span, home = ends[v + 4 * n : v + 5 * n], ends[v + 5 * n : v + 6 * n], ends[v + 6 * n : v + 7 * n]
        tail = ends[v + 7 * n :]
        scale = tail[0]
        # Separate arrays, not slices of one: only then does the compiler know that they do not overlap (2x in speed).
        q = np.empty(n)
        dq = np.empty(n)
        w = np.empty(n)
        x = np.empty(4 * n + 8)
        J = np.empty((n, 6))
        Z = np.empty((L, 6))
        ang = np.zeros(Lp)
        sn = np.empty(Lp)
        cs = np.empty(Lp)
        goal = np.empty(12)
        V = np.empty((6, 6))
        y = np.empty(6)
        best_q = np.empty(n)
        q_found = np.empty(n)
        score = np.empty(seeds.shape[0], np.float32)
        val = np.empty(BEST, np.float32)
        best = np.empty(BEST, np.int64)
        state = np.empty(1, np.uint64)
        kind = int(opt[9])
        given = int(opt[2])
        limits = opt[17] > 0.0
        holding = limits and opt[O_HOLD] > 0.0
        iterations = int(opt[3])
        closest = int(opt[19])
        jw = opt[24 : 24 + n]
        mask = opt[10:16]
        p = opt[24 + n :]
        if sweeping:
            s = Sweep(q, dq, w, x, lower, upper, unit, rows, ends, tip, goal, mask, Z, ang, sn, cs, V, y, opt)
        else:
            s = Step(q, dq, w, J, x, V, y)
        tol_p = opt[0] / scale
        tp = tol_p * tol_p
        tr = 2.0 * math.sin(0.5 * min(opt[1], math.pi)) if opt[1] < math.pi else 3.0
        if kind == 2 or kind == 3:
            tr = opt[1]
        tr = tr * tr
        for t in range(T.shape[0]):
            given_row = t if Q0.shape[0] > 1 else 0
            if not rigid(T[t]):
                out[t, 0] = BAD_TARGET
                continue
            # The random tail depends on the target's own seed only, not on its neighbours or the thread.
            state[0] = np.uint64(88172645463325252) ^ (np.uint64(opt[18]) * np.uint64(0x9E3779B97F4A7C15))
            aim(ends, tip, scale, T[t], goal)
            excess = beyond(goal, tip, tail, kind, tol_p, opt[1])
            descents = int(opt[4])
            if excess > 0.0:
                descents = min(descents, 3)
            wp = 1.0
            wr = 0.0 if kind == 1 else 1.0
            if kind >= 2:
                wp = 1.0 if opt[10] + opt[11] + opt[12] > 0.0 or kind == 4 else 0.0
                wr = 1.0 if kind < 4 and opt[13] + opt[14] + opt[15] > 0.0 else 0.0
            status = STALLED
            total = 0
            count = 0
            tries = 0
            rows_h = 0
            best_ee = np.inf
            best_pp = np.inf
            best_rr = np.inf
            for i in range(n):
                best_q[i] = Q0[given_row, i] / unit[i] if given > 0 else home[i]
            found = 0
            found_distance = np.inf
            found_pp = 0.0
            found_rr = 0.0
            while tries < descents:
                c = opt[7]
                rho = opt[8]
                if tries < given:
                    for i in range(n):
                        q[i] = Q0[given_row, i] / unit[i]
                else:
                    k = tries - given
                    if k == 0:
                        nearest(feat, goal, wp, wr, score, val, best)
                    if k < BEST:
                        for i in range(n):
                            q[i] = seeds[best[k], i]
                        c = opt[5]
                        rho = opt[6]
                    else:
                        for i in range(n):
                            q[i] = low[i] + span[i] * rnd(state)
                for i in range(x.shape[0]):
                    x[i] = 0.0
                tries += 1
                ended = ITERATION_LIMIT
                solved = False
                for k in range(iterations + 1):
                    px, py, pz, e = measure_inline(rows, ends, tip, goal, mask, kind, q, Z, ang, sn, cs, V, y)
                    count += 1
                    if rows_h < hist.shape[0]:
                        hist[rows_h, 0] = math.sqrt(e.pp) * scale
                        hist[rows_h, 1] = rotation_angle(e.rr)
                        for i in range(n):
                            hist[rows_h, 2 + i] = q[i] * unit[i]
                        rows_h += 1
                    if e.ee < best_ee:
                        best_ee = e.ee
                        best_pp = e.pp
                        best_rr = e.rr
                        for i in range(n):
                            best_q[i] = q[i]
                    if e.pp < tp and e.rr < tr:
                        solved = True
                        break
                    if not e.ee < 1e300:
                        ended = NOT_FINITE
                        break
                    if k == iterations or count >= opt[16]:
                        break
                    if e.ee > c and e.ee > 1e-9 and excess == 0.0:
                        ended = STALLED
                        break
                    c *= rho
                    columns(rows, Z, J, px, py, pz)
                    if kind > 0:
                        shape_columns(kind, mask, V, y, J)
                    for i in range(n):
                        w[i] = jw[i]
                    for _ in range(2):
                        r = step(cls, p, s, e)
                        if not (holding and hold(q, dq, w, lower, upper)):
                            break
                    if r == -1:
                        ended = SINGULAR
                        break
                    if r > 0:
                        count += r
                    total += 1
                    moved = 0.0
                    far = 0.0
                    for i in range(n):
                        a = q[i] + dq[i]
                        if limits and (a < lower[i] or a > upper[i]):
                            if turns[i] > 0.0:
                                a -= TAU * np.rint((a - 0.5 * (lower[i] + upper[i])) / TAU)
                            else:
                                a = min(max(a, lower[i]), upper[i])
                        moved = max(moved, abs(a - q[i]))
                        far = far if abs(a) <= far else abs(a)  # keeps a NaN
                        q[i] = a
                    if not far < 1e6:
                        ended = NOT_FINITE
                        break
                    if moved <= opt[20] and r != -2:
                        columns(rows, Z, J, px, py, pz)
                        if kind > 0:
                            shape_columns(kind, mask, V, y, J)
                        ended = why(q, lower, upper, J, e, limits)
                        break
                status = ended
                if solved:
                    if closest == 0:
                        status = CONVERGED
                        break
                    found += 1
                    d = 0.0
                    for i in range(n):
                        a = q[i] - Q0[given_row, i] / unit[i]
                        if turns[i] > 0.0:
                            a += TAU * turn(-a, q[i], lower[i], upper[i], turns[i])
                        d += a * a / max(jw[i], 1e-12)
                    if d < found_distance:
                        found_distance = d
                        found_pp = e.pp
                        found_rr = e.rr
                        for i in range(n):
                            q_found[i] = q[i]
                    if found >= closest:
                        break
                if count >= opt[16]:
                    break
            if found > 0:
                status = CONVERGED
                best_pp = found_pp
                best_rr = found_rr
                for i in range(n):
                    best_q[i] = q_found[i]
            if status == CONVERGED and found == 0:
                best_pp = e.pp
                best_rr = e.rr
                for i in range(n):
                    best_q[i] = q[i]
            elif status != CONVERGED:
                if excess > 0.0:
                    status = UNREACHABLE
                elif descents > 1 and status != NOT_FINITE:
                    for i in range(n):
                        q[i] = best_q[i]
                    px, py, pz, e = measure(rows, ends, tip, goal, mask, kind, q, Z, ang, sn, cs, V, y)
                    columns(rows, Z, J, px, py, pz)
                    if kind > 0:
                        shape_columns(kind, mask, V, y, J)
                    count += 1
                    status = LIMIT_BLOCKED if why(q, lower, upper, J, e, limits) == LIMIT_BLOCKED else STALLED
            # Of the same answer several turns away, give the legal one nearest the start (or home).
            shifted = False
            for i in range(n):
                q[i] = best_q[i]
                if turns[i] > 0.0 and limits:
                    ref = Q0[given_row, i] / unit[i] if given > 0 or closest > 0 else home[i]
                    k0 = turn(ref - q[i], q[i], lower[i], upper[i], turns[i])
                    if k0 != 0.0:
                        q[i] += k0 * TAU
                        shifted = True
            if shifted:
                px, py, pz, e = measure(rows, ends, tip, goal, mask, kind, q, Z, ang, sn, cs, V, y)
                count += 1
                if status != CONVERGED or (e.pp < tp and e.rr < tr):
                    best_pp = e.pp
                    best_rr = e.rr
                else:  # rounding of the turn broke a tolerance at the edge: keep the evaluated one
                    for i in range(n):
                        q[i] = best_q[i]
            out[t, 0] = status
            out[t, 1] = total
            out[t, 2] = tries - 1
            out[t, 3] = math.sqrt(best_pp) * scale
            out[t, 4] = math.sqrt(best_rr) if kind == 2 or kind == 3 else rotation_angle(best_rr)
            out[t, 5] = count
            out[t, 6] = rows_h
            out[t, 7] = excess * scale
            for i in range(n):
                out[t, 8 + i] = q[i] * unit[i]

    _ENTRIES[cls] = solve
    return solve


@cached
def forward(rows, ends, Q, unit, T, J) -> Any:
    """Tip poses T (N, 4, 4) [m] in base axes and Jacobians J (N, 6, n) at Q (N, n); J may be (0, 6, n) to skip them."""
    L = rows.shape[0]
    n = Q.shape[1]
    Lp = (L + 3) // 4 * 4
    scale = ends[E_VECTORS + 7 * n]
    tip = ends[12:24]
    q = np.empty(n)
    Z = np.empty((L, 6))
    ang = np.zeros(Lp)
    sn = np.zeros(Lp)
    cs = np.zeros(Lp)
    K = np.empty((n, 6))
    F = np.empty((3, 4))
    for t in range(Q.shape[0]):
        for i in range(n):
            q[i] = Q[t, i] / unit[i]
        x0, x1, x2, y0, y1, y2, z0, z1, z2, px, py, pz = fk(rows, q, Z, ang, sn, cs)
        for k in range(3):
            F[0, k] = x0 * tip[k] + y0 * tip[3 + k] + z0 * tip[6 + k]
            F[1, k] = x1 * tip[k] + y1 * tip[3 + k] + z1 * tip[6 + k]
            F[2, k] = x2 * tip[k] + y2 * tip[3 + k] + z2 * tip[6 + k]
        F[0, 3] = px + x0 * tip[9] + y0 * tip[10] + z0 * tip[11]
        F[1, 3] = py + x1 * tip[9] + y1 * tip[10] + z1 * tip[11]
        F[2, 3] = pz + x2 * tip[9] + y2 * tip[10] + z2 * tip[11]
        for r in range(3):
            for k in range(4):
                T[t, r, k] = ends[3 * r] * F[0, k] + ends[3 * r + 1] * F[1, k] + ends[3 * r + 2] * F[2, k]
            T[t, r, 3] = (T[t, r, 3] + ends[9 + r]) * scale
            T[t, 3, r] = 0.0
        T[t, 3, 3] = 1.0
        if J.shape[0] > 0:
            columns(rows, Z, K, F[0, 3], F[1, 3], F[2, 3])
            for i in range(n):
                for h in range(0, 6, 3):
                    for r in range(3):
                        g = ends[3 * r] * K[i, h] + ends[3 * r + 1] * K[i, h + 1] + ends[3 * r + 2] * K[i, h + 2]
                        J[t, h + r, i] = g * (scale if h == 0 else 1.0) / unit[i]
