"""Moving a solution within the set of solutions: descend a secondary objective in the null space, stay on the target."""

import math

import numpy as np

from .jit import cached, inline
from .kinematics import aim, chord, columns, rotation_angle
from .limits import hold
from .linalg import damped
from .loop import Err, measure
from .slots import O_KIND, O_LIMITS, O_TOL_P, O_TOL_R, O_W, OPT_HEAD, vectors
from .task import MASK_BASE, MASK_TIP, POSE, shape_columns

MID_RANGE, REFERENCE, MANIPULABILITY = 1, 2, 3


@inline
def log_manipulability(J, unit, A):
    """Half the log-determinant of J'J over the rows that count (log of Yoshikawa's measure, up to a constant).

    unit (n,) turns columns of sliding joints back to metres; J is overwritten, A (6, 6) is scratch.
    """
    m = 0
    for r in range(6):
        size = 0.0
        for i in range(J.shape[0]):
            size += J[i, r] * J[i, r]
        if size > 1e-18:
            for i in range(J.shape[0]):
                J[i, m] = J[i, r] / unit[i]
            m += 1
    total = 0.0
    for r in range(m):
        for c in range(r + 1):
            g = 0.0
            for i in range(J.shape[0]):
                g += J[i, r] * J[i, c]
            for k in range(c):
                g -= A[r, k] * A[c, k]
            if c < r:
                A[r, c] = g / A[c, c]
            else:
                A[r, r] = math.sqrt(max(g, 1e-30))
                total += math.log(A[r, r])
    return total


@cached
def refine(rows, ends, T, q_out, ref, opt, what, steps, report):
    """Improve q_out (n,) [rad or m] for the objective `what` without leaving the tolerances of the target T (1, 4, 4).

    ref (n,): where REFERENCE wants the joints. opt as for the loop. report (5,): objective before and after, steps taken,
    position error [m] and rotation error left. MID_RANGE and REFERENCE: half the squared distance, in ranges (an endless
    joint has no middle); MANIPULABILITY: minus the log of the manipulability.
    """
    L = rows.shape[0]
    n = q_out.shape[0]
    Lp = (L + 3) // 4 * 4
    tip = ends[12:24]
    lower, upper, turns, unit, low, span, _, tail = vectors(ends, n)
    scale = tail[0]
    q = np.empty(n)
    least = np.empty(n)
    most = np.empty(n)
    counted = np.empty(n)
    old = np.empty(n)
    dq = np.empty(n)
    z = np.empty(n)
    before = np.zeros(n)
    direction = np.zeros(n)
    w = np.empty(n)
    J = np.empty((n, 6))
    Z = np.empty((L, 6))
    ang = np.zeros(Lp)
    sn = np.empty(Lp)
    cs = np.empty(Lp)
    goal = np.empty(12)
    V = np.empty((6, 6))
    A = np.empty((6, 6))
    y = np.empty(6)
    kind = int(opt[O_KIND])
    mask = opt[O_W : O_W + 6]
    weights = opt[OPT_HEAD : OPT_HEAD + n]
    tp = (opt[O_TOL_P] / scale) ** 2
    tr = opt[O_TOL_R] * opt[O_TOL_R] if kind == MASK_BASE or kind == MASK_TIP else chord(opt[O_TOL_R])
    aim(ends, tip, scale, T[0], goal)
    for i in range(n):
        q[i] = q_out[i] / unit[i]
        free = turns[i] > 1.5 or opt[O_LIMITS] == 0.0
        least[i] = -np.inf if free else lower[i]
        most[i] = np.inf if free else upper[i]
        counted[i] = 1.0 if what == REFERENCE or (lower[i] > -1e15 and turns[i] < 1.5) else 0.0
    gain = 1.0
    fresh = False
    value = np.inf
    taken = 0
    for k in range(steps + 1):
        # Back onto the target: the null-space step left it to second order.
        good = False
        for _ in range(6):
            px, py, pz, e = measure(rows, ends, tip, goal, mask, kind, q, Z, ang, sn, cs, V, y)
            columns(rows, Z, J, px, py, pz)
            if kind != POSE:
                shape_columns(kind, mask, V, y, J)
            if e.pp < tp and e.rr < tr:
                good = True
                break
            for i in range(n):
                w[i] = weights[i]
            for _ in range(2):
                damped(J, w, dq, e, 1e-10)
                if not hold(q, dq, w, least, most):
                    break
            for i in range(n):
                q[i] = min(max(q[i] + dq[i], least[i]), most[i])
        now = 0.0
        if what == MANIPULABILITY:
            now = -log_manipulability(J, unit, A)
        else:
            for i in range(n):
                home = low[i] + 0.5 * span[i] if what == MID_RANGE else ref[i] / unit[i]
                now += counted[i] * 0.5 * ((q[i] - home) / span[i]) ** 2
        if k == 0:
            if not good:
                break
            report[0] = now
        elif not good or not now < value - 1e-12 * abs(value):
            for i in range(n):
                q[i] = old[i]
            gain *= 0.25
            if gain < 1e-6:
                break
            px, py, pz, e = measure(rows, ends, tip, goal, mask, kind, q, Z, ang, sn, cs, V, y)
        else:
            taken += 1
            fresh = True
        if k == 0 or (good and now < value):
            value = now
            report[3] = math.sqrt(e.pp) * scale
            report[4] = math.sqrt(e.rr) if kind == MASK_BASE or kind == MASK_TIP else rotation_angle(e.rr)
            for i in range(n):
                old[i] = q[i]
        report[1] = value
        report[2] = taken
        if k == steps:
            break
        # Direction: down the gradient without what moves the tip. The distances are measured in joint ranges, and with the
        # same metric in the projection their step of one is Newton's.
        for i in range(n):
            w[i] = weights[i] * (span[i] * span[i] if what != MANIPULABILITY else 1.0)
            home = low[i] + 0.5 * span[i] if what == MID_RANGE else ref[i] / unit[i]
            z[i] = counted[i] * (home - q[i])
        if what == MANIPULABILITY:
            h = 1e-6
            for i in range(n):
                q[i] += h
                px, py, pz, e = measure(rows, ends, tip, goal, mask, kind, q, Z, ang, sn, cs, V, y)
                columns(rows, Z, J, px, py, pz)
                if kind != POSE:
                    shape_columns(kind, mask, V, y, J)
                z[i] = 0.5 * (log_manipulability(J, unit, A) + value) / h
                q[i] -= h
        px, py, pz, e = measure(rows, ends, tip, goal, mask, kind, q, Z, ang, sn, cs, V, y)
        columns(rows, Z, J, px, py, pz)
        if kind != POSE:
            shape_columns(kind, mask, V, y, J)
        for _ in range(n):
            for r in range(6):
                g = 0.0
                for i in range(n):
                    if w[i] > 0.0:
                        g += J[i, r] * z[i]
                y[r] = -g
            damped(J, w, dq, Err(y[0], y[1], y[2], y[3], y[4], y[5], 0.0, 0.0, 0.0), 1e-10)
            for i in range(n):
                dq[i] = dq[i] + z[i] if w[i] > 0.0 else 0.0
            if not hold(q, dq, w, least, most):
                break
        size = 0.0
        ss = 0.0
        sy = 0.0
        for i in range(n):
            size = max(size, abs(dq[i]))
            step = old[i] - before[i]
            ss += step * step
            sy += step * (direction[i] - dq[i])
        if size < 1e-7:
            break
        if fresh and taken > 0 and sy > 1e-12 * ss:  # Barzilai and Borwein: the secant says how far
            gain = min(max(ss / sy, 1e-3), 1e3)
        if fresh or k == 0:
            for i in range(n):
                before[i] = old[i]
                direction[i] = dq[i]
        fresh = False
        factor = gain * min(1.0, 0.3 / size)
        for i in range(n):
            q[i] = min(max(q[i] + factor * dq[i], least[i]), most[i])
    if taken > 0:
        for i in range(n):
            q_out[i] = old[i] * unit[i]
