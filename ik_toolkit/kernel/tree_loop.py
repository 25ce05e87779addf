"""The iteration loop for several tips solved together, shared joints included.

Each chain's rows name the shared coordinates, so FK, columns and error are those of `kinematics`; joints common to two paths
are evaluated once per path (cheaper than bookkeeping a tree). The errors are stacked and the damped step is one dense
Cholesky solve whose off-diagonal blocks come from the shared joints only.
"""

import functools
import math
from collections.abc import Callable

import numpy as np

from .checks import (
    BAD_TARGET,
    CONVERGED,
    ITERATION_LIMIT,
    LIMIT_BLOCKED,
    NOT_FINITE,
    SINGULAR,
    STALLED,
    UNREACHABLE,
    beyond,
    edge,
    rigid,
)
from .jit import cached, jit
from .kinematics import aim, chord, columns, error, fk, rotation_angle
from .limits import face, hold, integrate
from .seeds import BEST, nearest, rnd, sow
from .slots import (
    E_VECTORS,
    O_C,
    O_C_FREE,
    O_DESCENTS,
    O_EVALUATIONS,
    O_GIVEN,
    O_HOLD,
    O_ITERATIONS,
    O_LIMITS,
    O_RHO,
    O_RHO_FREE,
    O_SEED,
    O_STALL,
    O_TOL_P,
    O_TOL_R,
    OPT_HEAD,
    OUT_HEAD,
    R_ATTEMPT,
    R_EVALUATIONS,
    R_EXCESS,
    R_HISTORY,
    R_ITERATIONS,
    R_POSITION,
    R_RESTARTS,
    R_ROTATION,
    R_STATUS,
    vectors,
)
from .task import POSITION


@jit
def evaluate(rows, cut, ends, goals, kinds, q, Z, ang, sn, cs, points, e, tp, tr):
    """Write tip points (F, 3) and stacked errors e (6 F,); return |e|^2 and whether every tip is inside its tolerances."""
    total = 0.0
    good = True
    for f in range(kinds.shape[0]):
        a, b = cut[f], cut[f + 1]
        Lp = (b - a + 3) // 4 * 4
        tip = ends[f, 12:24]
        x0, x1, x2, y0, y1, y2, z0, z1, z2, px, py, pz = fk(rows[a:b], q, Z[a:b], ang[:Lp], sn[:Lp], cs[:Lp])
        px, py, pz, e0, e1, e2, e3, e4, e5 = error(goals[f], tip, x0, x1, x2, y0, y1, y2, z0, z1, z2, px, py, pz)
        if kinds[f] == POSITION:
            e3, e4, e5 = 0.0, 0.0, 0.0
        points[f, 0], points[f, 1], points[f, 2] = px, py, pz
        h = 6 * f
        e[h], e[h + 1], e[h + 2], e[h + 3], e[h + 4], e[h + 5] = e0, e1, e2, e3, e4, e5
        pp = e0 * e0 + e1 * e1 + e2 * e2
        rr = e3 * e3 + e4 * e4 + e5 * e5
        good = good and pp < tp and rr < tr
        total += pp + rr
    return total, good


@jit
def largest(e):
    """Largest squared position error and squared rotation error over the tips."""
    top_p, top_r = 0.0, 0.0
    for h in range(0, e.shape[0], 6):
        top_p = max(top_p, e[h] * e[h] + e[h + 1] * e[h + 1] + e[h + 2] * e[h + 2])
        top_r = max(top_r, e[h + 3] * e[h + 3] + e[h + 4] * e[h + 4] + e[h + 5] * e[h + 5])
    return top_p, top_r


@jit
def arrived(e, f):
    """Whether tip f is close to its target: its squared error (lengths over reach) is small."""
    total = 0.0
    for k in range(6 * f, 6 * f + 6):
        total += e[k] * e[k]
    return total < 1e-4


@jit
def jacobians(rows, cut, kinds, Z, points, J):
    """Fill J (F, n, 6) at the configuration evaluated last; rotation rows of tips with free orientation are zero."""
    for f in range(kinds.shape[0]):
        a, b = cut[f], cut[f + 1]
        columns(rows[a:b], Z[a:b], J[f], points[f, 0], points[f, 1], points[f, 2])
        if kinds[f] == POSITION:
            for i in range(J.shape[1]):
                J[f, i, 3], J[f, i, 4], J[f, i, 5] = 0.0, 0.0, 0.0


@jit
def damped_step(J, moves, w, dq, e, damping, A, y):
    """dq = W J'(J W J' + damping)^-1 e over all tips, by Cholesky in place; A (6 F, 6 F) and y (6 F,) are scratch."""
    F, n = moves.shape
    m = 6 * F
    for r in range(m):
        for k in range(r + 1):
            A[r, k] = 0.0
        A[r, r] = damping
        y[r] = e[r]
    for i in range(n):
        if w[i] > 0.0:
            for f in range(F):
                if moves[f, i] > 0.0:
                    for g in range(f + 1):
                        if moves[g, i] > 0.0:
                            for r in range(6):
                                v = w[i] * J[f, i, r]
                                for k in range(6):
                                    A[6 * f + r, 6 * g + k] += v * J[g, i, k]
    for j in range(m):
        s = A[j, j]
        for k in range(j):
            s -= A[j, k] * A[j, k]
        d = 1.0 / math.sqrt(max(s, 1e-300))
        A[j, j] = d
        for i in range(j + 1, m):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = s * d
    for j in range(m):
        s = y[j]
        for k in range(j):
            s -= A[j, k] * y[k]
        y[j] = s * A[j, j]
    for j in range(m - 1, -1, -1):
        s = y[j]
        for k in range(j + 1, m):
            s -= A[k, j] * y[k]
        y[j] = s * A[j, j]
    for i in range(n):
        s = 0.0
        for f in range(F):
            if moves[f, i] > 0.0:
                for r in range(6):
                    s += J[f, i, r] * y[6 * f + r]
        dq[i] = w[i] * s


@jit
def why_tree(q, lower, upper, J, e, ee, limits):
    """Status of a descent that stands still, as checks.why says it for one tip."""
    whole, free, size = 0.0, 0.0, 0.0
    for i in range(q.shape[0]):
        g = 0.0
        for f in range(J.shape[0]):
            for k in range(6):
                g += J[f, i, k] * e[6 * f + k]
                size += J[f, i, k] * J[f, i, k]
        whole += g * g
        if not (limits and ((q[i] <= lower[i] and g < 0.0) or (q[i] >= upper[i] and g > 0.0))):
            free += g * g
    if whole <= 1e-16 * ee * size:
        return SINGULAR
    if free < 1e-4 * whole:
        return LIMIT_BLOCKED
    return STALLED


@jit
def choose(features, goals, kinds, score, val, best, choice, total, order):
    """Best table row of each tip in each interleaved group of rows, and the groups in order of the sum of their scores."""
    for g in range(BEST):
        total[g] = 0.0
        order[g] = g
    for f in range(kinds.shape[0]):
        nearest(features[f], goals[f], 1.0, 0.0 if kinds[f] == POSITION else 1.0, score, val, best)
        for k in range(BEST):
            g = best[k] % BEST
            choice[g, f] = best[k]
            total[g] += val[k]
    for i in range(1, BEST):
        g = order[i]
        j = i
        while j > 0 and total[order[j - 1]] > total[g]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = g


@functools.cache
def tree_entry() -> Callable:
    """Return the compiled loop: solve(rows, cut, ends, moves, owner, seeds, features, kinds, T, q0, out, tips, opt, hist).

    kinds (F,) POSE or POSITION; T (F, 4, 4) [m]; q0 (n,); out (OUT_HEAD + n,), opt, hist (H, 2 + n) as in `loop.entry`, with the
    largest errors over the tips; tips (F, 3) receives position error [m], orientation error [rad] and excess [m] of each.
    One descent is the loop's: evaluate, best-so-far, test, budget, give up, step, limits, integrate, stall.
    """

    @cached
    def solve(rows, cut, ends, moves, owner, seeds, features, kinds, T, q0, out, tips, opt, hist):
        F, n = moves.shape
        m = 6 * F
        v = E_VECTORS
        lower, upper, turns, unit, low, span, home, tail = vectors(ends[0], n)
        scale = tail[0]
        q = np.empty(n)
        dq = np.empty(n)
        w = np.empty(n)
        J = np.empty((F, n, 6))
        Z = np.empty((rows.shape[0], 6))
        ang = np.zeros(rows.shape[0] + 3)
        sn = np.empty(rows.shape[0] + 3)
        cs = np.empty(rows.shape[0] + 3)
        goals = np.empty((F, 12))
        wanted = np.empty((F, 3))
        excess = np.empty(F)
        points = np.empty((F, 3))
        e = np.empty(m)
        y = np.empty(m)
        A = np.empty((m, m))
        best_q = np.empty(n)
        best_e = np.full(m, np.inf)
        score = np.empty(seeds.shape[0], np.float32)
        val = np.empty(BEST, np.float32)
        best = np.empty(BEST, np.int64)
        choice = np.empty((BEST, F), np.int64)
        total = np.empty(BEST)
        order = np.empty(BEST, np.int64)
        state = np.empty(1, np.uint64)
        sow(state, opt[O_SEED])
        given = int(opt[O_GIVEN])
        iterations = int(opt[O_ITERATIONS])
        descents = int(opt[O_DESCENTS])
        limits = opt[O_LIMITS] > 0.0
        holding = limits and opt[O_HOLD] > 0.0
        jw = opt[OPT_HEAD : OPT_HEAD + n]
        damping = opt[OPT_HEAD + n]
        tol_p = opt[O_TOL_P] / scale
        tp = tol_p * tol_p
        tr = chord(opt[O_TOL_R])
        out_of_reach = False
        for f in range(F):
            if not rigid(T[f]):
                out[R_STATUS] = BAD_TARGET
                return
        for f in range(F):
            tip = ends[f, 12:24]
            aim(ends[f], tip, scale, T[f], goals[f])
            tail = ends[f, v + 7 * n :]
            excess[f] = beyond(goals[f], tip, tail, kinds[f], tol_p, opt[O_TOL_R])
            wanted[f, 0], wanted[f, 1], wanted[f, 2] = goals[f, 9], goals[f, 10], goals[f, 11]
            if excess[f] > 0.0:  # aim at the edge of the reach instead
                out_of_reach = True
                edge(goals[f], tail, excess[f], wanted[f])
        if out_of_reach:
            descents = min(descents, 3)
        status = STALLED
        steps = 0
        count = 0
        tries = 0
        best_try = 0
        rows_h = 0
        best_ee = np.inf
        for i in range(n):
            best_q[i] = q0[i] / unit[i] if given > 0 else home[i]
        while tries < descents:
            c = opt[O_C_FREE]
            rho = opt[O_RHO_FREE]
            k = tries - given
            if k < 0:
                for i in range(n):
                    q[i] = q0[i] / unit[i]
            elif k < BEST:
                if k == 0:
                    choose(features, goals, kinds, score, val, best, choice, total, order)
                g = order[k]
                for i in range(n):
                    q[i] = seeds[choice[g, max(owner[i], 0)], i]
                c = opt[O_C]
                rho = opt[O_RHO]
            else:
                # Mostly keep the tips that arrived and the shared joints: by chance all at once seldom start well.
                kept = False
                for f in range(F):
                    kept = kept or arrived(e, f)
                kept = kept and k % 4 > 0
                for i in range(n):
                    a = low[i] + span[i] * rnd(state)
                    if not (kept and (owner[i] < 0 or arrived(e, owner[i]))):
                        q[i] = a
            tries += 1
            ended = ITERATION_LIMIT
            for k in range(iterations + 1):
                ee, good = evaluate(rows, cut, ends, goals, kinds, q, Z, ang, sn, cs, points, e, tp, tr)
                count += 1
                if rows_h < hist.shape[0]:
                    pp, rr = largest(e)
                    hist[rows_h, 0] = math.sqrt(pp) * scale
                    hist[rows_h, 1] = rotation_angle(rr)
                    for i in range(n):
                        hist[rows_h, 2 + i] = q[i] * unit[i]
                    rows_h += 1
                if ee < best_ee or good:
                    best_ee = ee
                    best_try = tries - 1
                    for i in range(n):
                        best_q[i] = q[i]
                    for r in range(m):
                        best_e[r] = e[r]
                if good:
                    ended = CONVERGED
                    break
                if not ee < 1e300:
                    ended = NOT_FINITE
                    break
                if k == iterations or count >= opt[O_EVALUATIONS]:
                    break
                if ee > c and ee > 1e-9 and not out_of_reach:
                    ended = STALLED
                    break
                c *= rho
                jacobians(rows, cut, kinds, Z, points, J)
                for i in range(n):
                    w[i] = jw[i]
                for _ in range(2):
                    damped_step(J, moves, w, dq, e, damping * ee + 1e-12, A, y)
                    if not (holding and hold(q, dq, w, lower, upper)):
                        break
                steps += 1
                moved, far = integrate(q, dq, limits, lower, upper, turns)
                if not far < 1e6:
                    ended = NOT_FINITE
                    break
                if moved <= opt[O_STALL]:
                    jacobians(rows, cut, kinds, Z, points, J)
                    ended = why_tree(q, lower, upper, J, e, ee, limits)
                    break
            status = ended
            if status == CONVERGED or count >= opt[O_EVALUATIONS]:
                break
        if out_of_reach:
            status = UNREACHABLE
            for f in range(F):
                goals[f, 9], goals[f, 10], goals[f, 11] = wanted[f, 0], wanted[f, 1], wanted[f, 2]
        # Of the same answer several turns away, give the legal one nearest the start (or home).
        for i in range(n):
            q[i] = best_q[i]
            dq[i] = q0[i] / unit[i] if given > 0 else home[i]
        shifted = limits and face(q, dq, lower, upper, turns)
        open_end = status != CONVERGED and status != NOT_FINITE and status != UNREACHABLE
        spent = count >= opt[O_EVALUATIONS]
        if open_end and spent:
            status = ITERATION_LIMIT
        judged = open_end and not spent and descents > 1
        if shifted or out_of_reach or judged:
            ee, good = evaluate(rows, cut, ends, goals, kinds, q, Z, ang, sn, cs, points, e, tp, tr)
            count += 1
            if judged:
                jacobians(rows, cut, kinds, Z, points, J)
                status = LIMIT_BLOCKED if why_tree(q, lower, upper, J, e, ee, limits) == LIMIT_BLOCKED else STALLED
            if status == CONVERGED and not good:  # rounding of the turn broke a tolerance at its edge
                for i in range(n):
                    q[i] = best_q[i]
            else:
                for r in range(m):
                    best_e[r] = e[r]
        pp, rr = largest(best_e)
        out[R_STATUS] = status
        out[R_ITERATIONS] = steps
        out[R_RESTARTS] = tries - 1
        out[R_ATTEMPT] = best_try
        out[R_POSITION] = math.sqrt(pp) * scale
        out[R_ROTATION] = rotation_angle(rr)
        out[R_EVALUATIONS] = count
        out[R_HISTORY] = rows_h
        out[R_EXCESS] = 0.0
        for f in range(F):
            h = 6 * f
            pp = best_e[h] * best_e[h] + best_e[h + 1] * best_e[h + 1] + best_e[h + 2] * best_e[h + 2]
            rr = best_e[h + 3] * best_e[h + 3] + best_e[h + 4] * best_e[h + 4] + best_e[h + 5] * best_e[h + 5]
            tips[f, 0] = math.sqrt(pp) * scale
            tips[f, 1] = rotation_angle(rr)
            tips[f, 2] = excess[f] * scale
            out[R_EXCESS] = max(out[R_EXCESS], tips[f, 2])
        for i in range(n):
            out[OUT_HEAD + i] = q[i] * unit[i]

    return solve
