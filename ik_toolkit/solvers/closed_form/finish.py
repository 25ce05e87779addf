"""The last steps of every closed form: Newton steps on the real chain, and the list of the branches that count."""

import math

import numpy as np

from ...kernel import slots
from ...kernel.jit import cached, jit
from ...kernel.kinematics import aim, columns, rotation_angle
from ...kernel.limits import hold
from ...kernel.linalg import damped
from ...kernel.loop import Err, measure
from ...kernel.task import POSE, POSITION, shape_columns

DAMPING = 1e-9  # of the first step: next to nothing, so that it is Newton's
SOFTEST, STIFFEST = 1e-12, 1e3  # the damping stays between


@jit
def polish(rows, ends, opt, T, q, fixed, steps):
    """Improve q (n,) [rad or m] for the target T (4, 4) inside the limits, by at most `steps` damped Newton steps.

    The errors count in units of their tolerances, so that a step into both tolerances is preferred to a smaller error of one.
    fixed: place of a joint that is not moved, or -1. Stops when both errors are a thousandth of their tolerances. Returns both
    errors of q [m], [rad] and the number of evaluations.
    """
    n, links = q.shape[0], rows.shape[0]
    tip = ends[12:24]
    lower, upper, turns, unit, low, span, home, tail = slots.vectors(ends, n)
    scale = tail[0]
    limited = opt[slots.O_LIMITS] > 0.0
    kind = int(opt[slots.O_KIND])
    wide = (links + 3) // 4 * 4
    Z, ang, sn, cs = np.empty((links, 6)), np.zeros(wide), np.empty(wide), np.empty(wide)
    J, V, y, goal = np.empty((n, 6)), np.empty((6, 6)), np.empty(6), np.empty(12)
    x, old, dq, w = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    mask = opt[slots.O_W : slots.O_W + 6]
    aim(ends, tip, scale, T, goal)
    tp, tr = opt[slots.O_TOL_P] / scale, opt[slots.O_TOL_R]
    least = min(tp, tr) if kind == POSE else tp
    wp, wr = (least / tp, least / tr) if kind == POSE and least > 0.0 else (1.0, 1.0)
    for i in range(n):
        x[i] = q[i] / unit[i]
        old[i] = x[i]
    best, position, rotation, damping, count = np.inf, np.inf, np.inf, DAMPING, 0
    for k in range(steps + 1):
        px, py, pz, e = measure(rows, ends, tip, goal, mask, kind, x, Z, ang, sn, cs, V, y)
        count += 1
        size = wp * wp * e.pp + wr * wr * e.rr
        if size < best:
            best, position, rotation = size, math.sqrt(e.pp) * scale, rotation_angle(e.rr)
            if kind == POSITION:
                rotation = 0.0
            for i in range(n):
                old[i] = x[i]
            damping = max(0.1 * damping, SOFTEST)
            if position <= 1e-3 * opt[slots.O_TOL_P] and rotation <= 1e-3 * opt[slots.O_TOL_R]:
                break
        else:
            for i in range(n):
                x[i] = old[i]
            damping = max(100.0 * damping, DAMPING)
            px, py, pz, e = measure(rows, ends, tip, goal, mask, kind, x, Z, ang, sn, cs, V, y)
        if k == steps or damping > STIFFEST:
            break
        columns(rows, Z, J, px, py, pz)
        if kind != POSE:
            shape_columns(kind, mask, V, y, J)
        for i in range(n):
            w[i] = 0.0 if i == fixed else 1.0
            for r in range(3):
                J[i, r] *= wp
                J[i, 3 + r] *= wr
        weighed = Err(wp * e.e0, wp * e.e1, wp * e.e2, wr * e.e3, wr * e.e4, wr * e.e5, 0.0, 0.0, 0.0)
        for _ in range(n):
            damped(J, w, dq, weighed, damping * max(wp, wr) ** 2)
            if not (limited and hold(x, dq, w, lower, upper)):
                break
        for i in range(n):
            a = x[i] + dq[i]
            x[i] = min(max(a, lower[i]), upper[i]) if limited else a
    for i in range(n):
        q[i] = old[i] * unit[i]
    return position, rotation, count


@cached
def listed(rows, ends, opt, T, start, fixed, steps, Q, broken, marks, table, signs):
    """Fill table (K, 3 + n) and signs (K, 3) with the branches of Q (K, n) that count, nearest to `start` (n,) first.

    They break no limit (broken (K,)) and, after `polish` with `steps`, meet the tolerances of T (4, 4) as evaluated, as new
    answers. Columns: position error [m], rotation error [rad], distance (angles [rad], lengths over the scale), q. marks (K, 3)
    are the labels of the branches. Returns how many count and how many are inside the limits.
    """
    n = Q.shape[1]
    lower, upper, turns, unit, low, span, home, tail = slots.vectors(ends, n)
    kept = legal = 0
    q = np.empty(n)
    for k in range(Q.shape[0]):
        if broken[k] > 0.0:
            continue
        legal += 1
        q[:] = Q[k]
        position, rotation, _ = polish(rows, ends, opt, T, q, fixed, steps)
        if not (position < opt[slots.O_TOL_P] and rotation < opt[slots.O_TOL_R]):
            continue
        distance = 0.0
        for i in range(n):
            distance += ((q[i] - start[i]) / unit[i]) ** 2
        distance = math.sqrt(distance)
        place = kept
        while place > 0 and table[place - 1, 2] > distance:
            table[place] = table[place - 1]
            signs[place] = signs[place - 1]
            place -= 1
        table[place, 0], table[place, 1], table[place, 2] = position, rotation, distance
        table[place, 3:] = q
        signs[place] = marks[k]
        kept += 1
    return kept, legal


@cached
def first_good(rows, ends, opt, T, starts, fixed, steps, q):
    """Fill q (n,) with the first of starts (K, n), polished, that meets the tolerances of T (4, 4); return its errors, or inf."""
    evaluations = 0
    for k in range(starts.shape[0]):
        q[:] = starts[k]
        position, rotation, count = polish(rows, ends, opt, T, q, fixed, steps)
        evaluations += count
        if position < opt[slots.O_TOL_P] and rotation < opt[slots.O_TOL_R]:
            return position, rotation, evaluations
    return np.inf, np.inf, evaluations


@cached
def finished(rows, ends, opt, T, Q, steps, errors):
    """Polish Q (K, n) for T (4, 4) in place; errors (K, 2) receives both errors [m], [rad] of each."""
    for k in range(Q.shape[0]):
        errors[k, 0], errors[k, 1], _ = polish(rows, ends, opt, T, Q[k], -1, steps)
