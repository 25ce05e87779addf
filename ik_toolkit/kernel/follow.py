"""The compiled tracker loops: the published methods in one, the solvers' feedback rules (one step a sample) in another."""

import functools
from collections.abc import Callable

import numpy as np

from .jit import cached
from .kinematics import aim, angle_ratio, columns, error, fk
from .loop import RULES, SWEEPS, Step, Sweep, measure, step
from .motion import (
    CA,
    GIVEN,
    HELD,
    MOVING,
    NOT_FINITE,
    P_BRAKE,
    P_CODE,
    P_DAMPING,
    P_GAMMA,
    P_RUNAWAY,
    RUNAWAY,
    RUNNING,
    S_H,
    S_START,
    S_STOP,
    advance,
    apply,
    command,
    ease,
    factor,
    fastest,
    jacobian_rate,
    prepare,
    settle,
    to_local,
)
from .slots import E_VECTORS, O_KIND, O_W, OPT_HEAD, vectors
from .task import POSE, shape_columns


@functools.cache
def tracker() -> Callable:
    """Return the compiled loop follow(rows, ends, T, V, A, h, m, p, limits, q, rate, prev, state, Q, R, E, C, D) -> steps.

    T (N+1, 4, 4) [m], V, A (N+1, 6): pose, twist and acceleration of the target; m: 3 positions or 6 poses. q, rate, prev
    (n,) and state (3,) are carried from call to call. Kernel units: lengths over the chain's scale; p, limits, q, rate,
    prev, Q, R in them. Q, R (N+1, n), E (N+1, 6) error [m, rad], C (N, n) limit codes, D (N,) damping lambda^2.
    """

    @cached
    def follow(rows, ends, T, V, A, h, m, p, limits, q, rate, prev, state, Q, R, E, C, D):
        L = rows.shape[0]
        n = q.shape[0]
        Lp = (L + 3) // 4 * 4
        tip = ends[12:24]
        scale = ends[E_VECTORS + 7 * n]
        J = np.empty((n, 6))
        Z = np.empty((L, 6))
        ang = np.zeros(Lp)
        sn = np.empty(Lp)
        cs = np.empty(Lp)
        goal = np.empty(12)
        G = np.empty((6, 6))
        y = np.empty(6)
        t = np.empty(6)
        e = np.empty(6)
        ahead = np.empty(6)
        v = np.empty(6)
        a = np.empty(6)
        bias = np.zeros(6)
        move = np.empty(n)
        null = np.empty(n)
        x1 = np.empty(n)
        x2 = np.empty(n)
        x = np.empty(n)
        before = np.empty(n)
        steps = T.shape[0] - 1
        gamma = p[P_GAMMA]
        limited = False
        for k in range(n):
            limited = limited or limits[3, k] < np.inf
        for i in range(steps + 1):
            x0, xx1, xx2, y0, y1, y2, z0, z1, z2, lx, ly, lz = fk(rows, q, Z, ang, sn, cs)
            aim(ends, tip, scale, T[i], goal)
            px, py, pz, e0, e1, e2, e3, e4, e5 = error(goal, tip, x0, xx1, xx2, y0, y1, y2, z0, z1, z2, lx, ly, lz)
            f = angle_ratio(e3 * e3 + e4 * e4 + e5 * e5)
            e[0], e[1], e[2], e[3], e[4], e[5] = e0, e1, e2, e3 * f, e4 * f, e5 * f
            for k in range(3):
                E[i, k] = (ends[3 * k] * e[0] + ends[3 * k + 1] * e[1] + ends[3 * k + 2] * e[2]) * scale
                E[i, 3 + k] = ends[3 * k] * e[3] + ends[3 * k + 1] * e[4] + ends[3 * k + 2] * e[5]
            if i < steps or state[S_START] == MOVING:
                columns(rows, Z, J, px, py, pz)
                to_local(ends, scale, V[i], v)
            if state[S_START] == MOVING:
                factor(J, m, p[P_DAMPING], G, y)
                apply(J, m, G, v, y, rate)
                for k in range(n):
                    room = limits[1, k] - q[k] if rate[k] > 0.0 else q[k] - limits[0, k]
                    top = min(limits[2, k], fastest(room, 0.0, gamma, h, limits[3, k]))
                    rate[k] = min(max(rate[k], -top), top)
                state[S_START] = GIVEN
            for k in range(n):
                Q[i, k] = q[k]
                R[i, k] = rate[k]
            if i == steps:
                break
            to_local(ends, scale, A[i], a)
            aim(ends, tip, scale, T[i + 1], goal)
            px, py, pz, e0, e1, e2, e3, e4, e5 = error(goal, tip, x0, xx1, xx2, y0, y1, y2, z0, z1, z2, lx, ly, lz)
            f = angle_ratio(e3 * e3 + e4 * e4 + e5 * e5)
            ahead[0], ahead[1], ahead[2], ahead[3], ahead[4], ahead[5] = e0, e1, e2, e3 * f, e4 * f, e5 * f
            D[i] = factor(J, m, p[P_DAMPING], G, y)
            if limited:
                ease(p, J, m, e, ahead, h, limits, G, y, x)
            prepare(p, J, m, ahead, rate, h, G, y, t, move, null, x1, x2)
            if p[P_CODE] >= CA:
                jacobian_rate(rows, Z, J, px, py, pz, x1, x2, bias)
            ratio = h / state[S_H] if state[S_START] == RUNNING else 0.0
            if p[P_BRAKE] == 0.0:
                command(p, J, m, e, v, a, bias, rate, prev, h, ratio, G, y, t, move, null, x)
            largest = 0.0
            for k in range(n):
                before[k] = rate[k]
                largest += abs(x[k])
            bad = not largest < 1e300
            if p[P_BRAKE] > 0.0 or (bad and p[P_RUNAWAY] == np.inf):
                for k in range(n):
                    x[k] = 0.0
                    prev[k] = 0.0
            elif bad or largest * h > p[P_RUNAWAY] * n:
                state[S_STOP] = NOT_FINITE if bad else RUNAWAY
                return i
            advance(q, rate, x, gamma, h, limits, C[i])
            settle(p, h, before, x, C[i], prev)
            if p[P_BRAKE] > 0.0 or bad:
                for k in range(n):
                    C[i, k] = C[i, k] | HELD
            state[S_START] = RUNNING
            state[S_H] = h
        return steps

    return follow


@functools.cache
def rule_tracker(cls: type) -> Callable:
    """Return the loop of a solver's rule: follow(rows, ends, T, h, opt, p, limits, q, rate, memory, state, Q, R, E, C) -> steps.

    One step of the rule a sample, towards the target at its end; memory (4 n + 8,) is the rule's state, carried on. opt as
    the solver packs it; p, limits, state and the arrays as in `tracker`.
    """
    sweeping = cls in SWEEPS

    def follow(rows, ends, T, h, opt, p, limits, q, rate, memory, state, Q, R, E, C):
        L = rows.shape[0]
        n = q.shape[0]
        Lp = (L + 3) // 4 * 4
        lower, upper, _, unit, _, _, _, tail = vectors(ends, n)
        tip = ends[12:24]
        scale = tail[0]
        kind = int(opt[O_KIND])
        mask = opt[O_W : O_W + 6]
        weights = opt[OPT_HEAD : OPT_HEAD + n]
        parameters = opt[OPT_HEAD + n :]
        dq = np.empty(n)
        w = np.empty(n)
        x = np.empty(n)
        J = np.empty((n, 6))
        Z = np.empty((L, 6))
        ang = np.zeros(Lp)
        sn = np.empty(Lp)
        cs = np.empty(Lp)
        goal = np.empty(12)
        V = np.empty((6, 6))
        y = np.empty(6)
        if sweeping:
            s = Sweep(q, dq, w, memory, lower, upper, unit, rows, ends, tip, goal, mask, Z, ang, sn, cs, V, y, opt)
        else:
            s = Step(q, dq, w, J, memory, V, y)
        steps = T.shape[0] - 1
        for i in range(steps + 1):
            aim(ends, tip, scale, T[i], goal)
            px, py, pz, e = measure(rows, ends, tip, goal, mask, kind, q, Z, ang, sn, cs, V, y)
            f = angle_ratio(e.rr)
            for k in range(3):
                E[i, k] = (ends[3 * k] * e.e0 + ends[3 * k + 1] * e.e1 + ends[3 * k + 2] * e.e2) * scale
                E[i, 3 + k] = f * (ends[3 * k] * e.e3 + ends[3 * k + 1] * e.e4 + ends[3 * k + 2] * e.e5)
            for k in range(n):
                Q[i, k] = q[k]
                R[i, k] = rate[k]
            if i == steps:
                break
            aim(ends, tip, scale, T[i + 1], goal)
            px, py, pz, e = measure(rows, ends, tip, goal, mask, kind, q, Z, ang, sn, cs, V, y)
            columns(rows, Z, J, px, py, pz)
            if kind != POSE:
                shape_columns(kind, mask, V, y, J)
            for k in range(n):
                w[k] = weights[k]
            r = 0
            if p[P_BRAKE] == 0.0:
                r = step(cls, parameters, s, e)
            largest = 0.0
            for k in range(n):
                x[k] = dq[k] / h if r != -1 else 0.0
                largest += abs(x[k])
            bad = not largest < 1e300
            if p[P_BRAKE] > 0.0 or (bad and p[P_RUNAWAY] == np.inf):
                for k in range(n):
                    x[k] = 0.0
            elif bad or largest * h > p[P_RUNAWAY] * n:
                state[S_STOP] = NOT_FINITE if bad else RUNAWAY
                return i
            advance(q, rate, x, 1.0, h, limits, C[i])
            if p[P_BRAKE] > 0.0 or bad:
                for k in range(n):
                    C[i, k] = C[i, k] | HELD
        return steps

    return cached(follow, cls, RULES[cls])
