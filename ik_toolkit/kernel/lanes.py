"""Levenberg-Marquardt for eight targets side by side, one in each lane of a vector: twice the solves a second of `loop`.

The same starts, give-up and tests as the loop with the rule LM; limits differ in that the sign of the gradient, not of the
step, says which joints to hold (some lane would want the step redone almost always). A lane that is done takes the next
target, and lanes never see each other, so an answer depends on its target alone. What takes a lane too long or needs care
(unreachable, half a turn off, refused) is left to the loop.
"""

# numba itself gives an intrinsic its first argument, which type checkers cannot know.
# pyright: reportCallIssue=false, reportGeneralTypeIssues=false
import functools
import math
from collections.abc import Callable

import numpy as np

from .checks import CONVERGED, beyond, rigid
from .jit import cached, inline
from .kinematics import TAU, aim, chord, rotation_angle, sincos
from .limits import face, legal, middle
from .linalg import solve_blocks
from .loop import measure
from .seeds import BEST, nearest, rnd, sow
from .slots import (
    O_C,
    O_C_FREE,
    O_DESCENTS,
    O_GIVEN,
    O_ITERATIONS,
    O_KIND,
    O_RHO,
    O_RHO_FREE,
    O_SEED,
    O_TOL_P,
    O_TOL_R,
    O_W,
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
from .vector import WIDTH, bits, choose, full, load, store

LEFT = -1  # status of a target left to the loop
HALF_TURN = 5e-4  # 1 + cos below which a descent is given up: the axis cannot be told
DESCENTS = 32  # of one target before it is left: by then others would wait for it


@inline
def put(Z, i, a, b, c, d, e, f):
    """Write the six vectors of joint i."""
    k = 6 * i * WIDTH
    store(Z, k, a)
    store(Z, k + WIDTH, b)
    store(Z, k + 2 * WIDTH, c)
    store(Z, k + 3 * WIDTH, d)
    store(Z, k + 4 * WIDTH, e)
    store(Z, k + 5 * WIDTH, f)


@inline
def vector_fk(rows, Q, Z):
    """Frames of the last joint as `kinematics.fk`; Q (n * WIDTH,), Z (6 L * WIDTH,) receives axes and points."""
    W = WIDTH
    zero, one = full(0.0), full(1.0)
    q = load(Q, 0)
    s, c = sincos(q * rows[0, 4] + rows[0, 5])
    x0, x1, x2 = c, s, zero
    y0, y1, y2 = -s, c, zero
    z0, z1, z2 = zero, zero, one
    px, py, pz = zero, zero, q * rows[0, 6] + rows[0, 7]
    put(Z, 0, z0, z1, z2, px, py, pz)
    for i in range(1, rows.shape[0]):
        cb, sb, tx, ty = rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3]
        q = load(Q, i * W)
        s, c = sincos(q * rows[i, 4] + rows[i, 5])
        d = q * rows[i, 6] + rows[i, 7]
        v0, v1, v2 = y0 * cb + z0 * sb, y1 * cb + z1 * sb, y2 * cb + z2 * sb
        z0, z1, z2 = z0 * cb - y0 * sb, z1 * cb - y1 * sb, z2 * cb - y2 * sb
        px = px + (x0 * tx + v0 * ty + z0 * d)
        py = py + (x1 * tx + v1 * ty + z1 * d)
        pz = pz + (x2 * tx + v2 * ty + z2 * d)
        put(Z, i, z0, z1, z2, px, py, pz)
        y0, y1, y2 = v0 * c - x0 * s, v1 * c - x1 * s, v2 * c - x2 * s
        x0, x1, x2 = x0 * c + v0 * s, x1 * c + v1 * s, x2 * c + v2 * s
    return x0, x1, x2, y0, y1, y2, z0, z1, z2, px, py, pz


@inline
def vector_step(rows, Z, Q, lower, upper, turns, turning, px, py, pz, e0, e1, e2, e3, e4, e5, damping):
    """Move Q by the damped step; `turning` is 0 where orientation is free. Z becomes the Jacobian."""
    W = WIDTH
    zero, one = full(0.0), full(1.0)
    p00, p11, p22 = damping, damping, damping
    p10, p20, p21 = zero, zero, zero
    s00, s11, s22 = damping, damping, damping
    s10, s20, s21 = zero, zero, zero
    q00, q01, q02 = zero, zero, zero
    q10, q11, q12 = zero, zero, zero
    q20, q21, q22 = zero, zero, zero
    for i in range(rows.shape[0]):
        k = 6 * i * W
        j0, j1, j2 = load(Z, k), load(Z, k + W), load(Z, k + 2 * W)
        j3, j4, j5 = zero, zero, zero
        if rows[i, 9] > 0.0:
            j3, j4, j5 = j0, j1, j2
            rx, ry, rz = px - load(Z, k + 3 * W), py - load(Z, k + 4 * W), pz - load(Z, k + 5 * W)
            j0, j1, j2 = j4 * rz - j5 * ry, j5 * rx - j3 * rz, j3 * ry - j4 * rx
            j3, j4, j5 = j3 * turning, j4 * turning, j5 * turning
        w = one
        if turns[i] == 0.0:
            g = j0 * e0 + j1 * e1 + j2 * e2 + j3 * e3 + j4 * e4 + j5 * e5
            q = load(Q, i * W)
            w = choose(((q <= lower[i]) & (g < 0.0)) | ((q >= upper[i]) & (g > 0.0)), zero, one)
            j0, j1, j2, j3, j4, j5 = j0 * w, j1 * w, j2 * w, j3 * w, j4 * w, j5 * w
        put(Z, i, j0, j1, j2, j3, j4, j5)
        p00, p10, p11 = p00 + j0 * j0, p10 + j1 * j0, p11 + j1 * j1
        p20, p21, p22 = p20 + j2 * j0, p21 + j2 * j1, p22 + j2 * j2
        s00, s10, s11 = s00 + j3 * j3, s10 + j4 * j3, s11 + j4 * j4
        s20, s21, s22 = s20 + j5 * j3, s21 + j5 * j4, s22 + j5 * j5
        q00, q01, q02 = q00 + j3 * j0, q01 + j3 * j1, q02 + j3 * j2
        q10, q11, q12 = q10 + j4 * j0, q11 + j4 * j1, q12 + j4 * j2
        q20, q21, q22 = q20 + j5 * j0, q21 + j5 * j1, q22 + j5 * j2
    y0, y1, y2, y3, y4, y5 = solve_blocks(
        p00, p10, p11, p20, p21, p22, s00, s10, s11, s20, s21, s22, q00, q01, q02, q10, q11, q12, q20, q21, q22,
        e0, e1, e2, e3, e4, e5,
    )  # fmt: skip
    for i in range(rows.shape[0]):
        k = 6 * i * W
        d = load(Z, k) * y0 + load(Z, k + W) * y1 + load(Z, k + 2 * W) * y2
        d = d + (load(Z, k + 3 * W) * y3 + load(Z, k + 4 * W) * y4 + load(Z, k + 5 * W) * y5)
        q = load(Q, i * W) + d
        if turns[i] > 0.0:
            back = q - TAU * np.rint((q - middle(lower[i], upper[i])) * (1.0 / TAU))
            q = choose((q < lower[i]) | (q > upper[i]), back, q)
        q = choose(q < lower[i], full(lower[i]), q)  # after a turn too: it may end a rounding outside
        q = choose(q > upper[i], full(upper[i]), q)
        store(Q, i * W, q)


@inline
def vector_error(goal, x0, x1, x2, y0, y1, y2, z0, z1, z2):
    """2 sin(angle/2) times the axis of the rotation left, and 1 + cos(angle); below HALF_TURN only the latter is right."""
    W = WIDTH
    d0, d1, d2 = load(goal, 0), load(goal, W), load(goal, 2 * W)
    d3, d4, d5 = load(goal, 3 * W), load(goal, 4 * W), load(goal, 5 * W)
    d6, d7, d8 = load(goal, 6 * W), load(goal, 7 * W), load(goal, 8 * W)
    vx = 0.5 * (x1 * d6 - x2 * d3 + y1 * d7 - y2 * d4 + z1 * d8 - z2 * d5)
    vy = 0.5 * (x2 * d0 - x0 * d6 + y2 * d1 - y0 * d7 + z2 * d2 - z0 * d8)
    vz = 0.5 * (x0 * d3 - x1 * d0 + y0 * d4 - y1 * d1 + z0 * d5 - z1 * d2)
    cos1 = 0.5 * (1.0 + x0 * d0 + x1 * d3 + x2 * d6 + y0 * d1 + y1 * d4 + y2 * d7 + z0 * d2 + z1 * d5 + z2 * d8)
    f = math.sqrt(2.0 / choose(cos1 > HALF_TURN, cos1, full(1.0)))
    return vx * f, vy * f, vz * f, cos1


@functools.cache
def lanes() -> Callable:
    """Return the compiled solve(rows, ends, seeds, feat, T, Q0, out, opt), arguments as for `loop.entry` with the rule LM.

    For poses and positions of chains without mimic joints, with limits, equal joint weights, no `closest` and no budget
    of evaluations; rows of `out` with the status LEFT are for the loop.
    """

    @cached
    def solve(rows, ends, seeds, feat, T, Q0, out, opt):
        W = WIDTH
        n = seeds.shape[1]
        N = T.shape[0]
        tip = ends[12:24]
        lower, upper, turns, unit, low, span, home, tail = vectors(ends, n)
        scale = tail[0]
        kind = int(opt[O_KIND])
        turning = 0.0 if kind == POSITION else 1.0
        given = int(opt[O_GIVEN])
        iterations = opt[O_ITERATIONS]
        descents = min(int(opt[O_DESCENTS]), DESCENTS)
        damping = opt[OPT_HEAD + n]
        tol_p = opt[O_TOL_P] / scale
        tp = tol_p * tol_p
        tr = chord(opt[O_TOL_R])
        Q = np.zeros(n * W)
        Z = np.zeros(6 * n * W)
        goals = np.zeros(12 * W)
        limit = np.full(W, np.inf)  # give up a descent whose squared error is above
        decay = np.ones(W)  # ... which falls by this factor an iteration
        age = np.zeros(W)  # evaluations of this descent
        total = np.zeros(W)  # evaluations of this target
        pp = np.empty(W)
        rr = np.empty(W)
        which = np.full(W, -1, np.int64)  # target in each lane, -1: none
        tries = np.zeros(W, np.int64)
        table = np.empty((W, BEST), np.int64)
        state = np.empty((W, 1), np.uint64)
        goal = np.empty(12)
        q = np.empty(n)
        wanted = np.empty(n)
        score = np.empty(seeds.shape[0], np.float32)
        val = np.empty(BEST, np.float32)
        best = np.empty(BEST, np.int64)
        ang, sn, cs = np.zeros(n + 3), np.empty(n + 3), np.empty(n + 3)
        scratch, V, y = np.empty((n, 6)), np.empty((6, 6)), np.empty(6)
        mask = opt[O_W : O_W + 6]
        following = 0
        live = 0
        renew = (1 << W) - 1
        while True:
            if renew != 0:
                for lane in range(W):
                    if (renew >> lane) & 1 == 0:
                        continue
                    if which[lane] >= 0 and tries[lane] >= descents:
                        which[lane] = -1
                        live -= 1
                    while which[lane] < 0 and following < N:
                        t = following
                        following += 1
                        out[t, R_STATUS] = LEFT
                        if not rigid(T[t]) or (
                            given > 0 and not legal(Q0[t if Q0.shape[0] > 1 else 0], unit, lower, upper, turns, True)
                        ):
                            continue
                        aim(ends, tip, scale, T[t], goal)
                        if beyond(goal, tip, tail, kind, tol_p, opt[O_TOL_R]) > 0.0:
                            continue
                        nearest(feat, goal, 1.0, turning, score, val, best)
                        for k in range(BEST):
                            table[lane, k] = best[k]
                        for k in range(12):
                            goals[k * W + lane] = goal[k]
                        sow(state[lane], opt[O_SEED])
                        tries[lane] = 0
                        total[lane] = 0.0
                        which[lane] = t
                        live += 1
                    age[lane] = 0.0
                    if which[lane] < 0:
                        limit[lane] = np.inf
                        continue
                    k = tries[lane] - given
                    limit[lane], decay[lane] = opt[O_C_FREE], opt[O_RHO_FREE]
                    if k < 0:
                        start = which[lane] if Q0.shape[0] > 1 else 0
                        for i in range(n):
                            Q[i * W + lane] = Q0[start, i] / unit[i]
                    elif k < BEST:
                        limit[lane], decay[lane] = opt[O_C], opt[O_RHO]
                        for i in range(n):
                            Q[i * W + lane] = seeds[table[lane, k], i]
                    else:
                        for i in range(n):
                            Q[i * W + lane] = low[i] + span[i] * rnd(state[lane])
                    tries[lane] += 1
            if live == 0:
                break
            x0, x1, x2, y0, y1, y2, z0, z1, z2, px, py, pz = vector_fk(rows, Q, Z)
            px = px + (x0 * tip[9] + y0 * tip[10] + z0 * tip[11])
            py = py + (x1 * tip[9] + y1 * tip[10] + z1 * tip[11])
            pz = pz + (x2 * tip[9] + y2 * tip[10] + z2 * tip[11])
            e0, e1, e2 = load(goals, 9 * W) - px, load(goals, 10 * W) - py, load(goals, 11 * W) - pz
            e3, e4, e5, cos1 = vector_error(goals, x0, x1, x2, y0, y1, y2, z0, z1, z2)
            e3, e4, e5 = e3 * turning, e4 * turning, e5 * turning
            ep = e0 * e0 + e1 * e1 + e2 * e2
            er = e3 * e3 + e4 * e4 + e5 * e5
            ee = ep + er
            seen = (cos1 > HALF_TURN) | (full(turning) < 0.5)
            now = load(age, 0)
            above = load(limit, 0)
            done = bits((ep < tp) & (er < tr) & seen)
            renew = (bits(((ee > above) & (ee > 1e-9)) | (now >= iterations)) | ~bits(seen)) & ((1 << W) - 1)
            store(age, 0, now + 1.0)
            store(total, 0, load(total, 0) + 1.0)
            store(limit, 0, above * load(decay, 0))
            if done != 0:
                store(pp, 0, ep)
                store(rr, 0, er)
                renew = renew | done
                for lane in range(W):
                    t = which[lane]
                    if t < 0 or (done >> lane) & 1 == 0:
                        continue
                    which[lane] = -1
                    live -= 1
                    for i in range(n):
                        q[i] = Q[i * W + lane]
                        wanted[i] = Q0[t if Q0.shape[0] > 1 else 0, i] / unit[i] if given > 0 else home[i]
                    count = total[lane]
                    left_p, left_r = pp[lane], rr[lane]
                    if face(q, wanted, lower, upper, turns):
                        count += 1.0
                        for k in range(12):
                            goal[k] = goals[k * W + lane]
                        _, _, _, e = measure(rows, ends, tip, goal, mask, kind, q, scratch, ang, sn, cs, V, y)
                        left_p, left_r = e.pp, e.rr
                        if not (left_p < tp and left_r < tr):  # rounding of the turn broke a tolerance at its edge
                            continue
                    out[t, R_STATUS] = CONVERGED
                    out[t, R_ITERATIONS] = total[lane] - tries[lane]
                    out[t, R_RESTARTS] = tries[lane] - 1
                    out[t, R_ATTEMPT] = tries[lane] - 1
                    out[t, R_POSITION] = math.sqrt(left_p) * scale
                    out[t, R_ROTATION] = rotation_angle(left_r)
                    out[t, R_EVALUATIONS] = count
                    out[t, R_HISTORY] = 0.0
                    out[t, R_EXCESS] = 0.0
                    for i in range(n):
                        out[t, OUT_HEAD + i] = q[i] * unit[i]
            vector_step(
                rows, Z, Q, lower, upper, turns, turning, px, py, pz, e0, e1, e2, e3, e4, e5, damping * ee + 1e-12
            )

    return solve
