"""The last steps of every closed form: Newton steps on the actual chain, and the list of branches within the tolerances."""

import math

import numpy as np

from ...compile.jit import build, cached, inner
from ...kernel.counted_error import KIND
from ...kernel.kinematics import aim, rotation_angle
from ...kernel.limits import hold
from ...kernel.linalg import damped
from ...kernel.records import ORDER, SIZE, Orders, copy, read
from ...kernel.serial import make_serial

DAMPING = 1e-9  # damping of the first damped Newton step, so small that it is practically a plain Newton step
SOFTEST, STIFFEST = 1e-12, 1e3  # bounds between which the damping of the Newton steps is adapted
# [rad] A solution that exceeds a limit by less than BORDER is tried on the limit: where two solutions merge, they are known only to
# the square root of the rounding error.
BORDER = 1e-4
DISTINCT = 1e-3  # [rad] a solution moved onto a limit is left out if another solution in the list is nearer than this


@build
def polish(rows, ends, opt, T, q, fixed, steps, most):
    """Improve q (n,) [rad or m] for the target T (4, 4), inside the limits, by at most `steps` damped Newton steps.

    Each error counts in units of its tolerance, so that a step into both tolerances is preferred to a smaller error of one. The
    steps end when both errors are at most a thousandth of their tolerances. rows, ends, opt: geometry, limits and options of the
    chain; fixed: index of a joint that is not moved, or -1; most: number of evaluations allowed (inf: any). Returns both errors of
    q [m], [rad] (inf if q was not evaluated) and the number of evaluations made.
    """
    n = q.shape[0]
    return newton(
        make_serial(rows, ends, opt[SIZE.orders :], n, read(Orders, opt)), np.empty(n), opt, T, q, fixed, steps, most
    )


@inner
def newton(p, old, opt, T, q, fixed, steps, most):
    """Improve q for the target T as `polish` does, given a problem p (`kernel.serial`) instead of the chain's arrays.

    old (n,) is scratch; the other arguments and the results are those of `polish`.
    """
    n, o = q.shape[0], read(Orders, opt)
    s, box = p.desk, p.ends
    limited = o.limits > 0.0
    kind = int(opt[SIZE.orders])
    x = s.q
    aim(box, T, p.goal)
    tp, tr = o.tol_p / box.scale(), o.tol_r
    least = min(tp, tr) if kind == KIND.pose else tp
    wp, wr = (least / tp, least / tr) if kind == KIND.pose and least > 0.0 else (1.0, 1.0)
    for i in range(n):
        x[i] = q[i] / box.unit(i)
        old[i] = x[i]
    best, position, rotation, damping, count = np.inf, np.inf, np.inf, DAMPING, 0
    for k in range(steps + 1):
        if count >= most:
            break
        e = p.evaluate(x)
        count += 1
        size = wp * wp * e.linear.square() + wr * wr * e.angular.square()
        if size < best:
            best, position = size, math.sqrt(e.linear.square()) * box.scale()
            rotation = rotation_angle(e.angular.square()) if kind != KIND.position else 0.0
            copy(x, old)
            damping = max(0.1 * damping, SOFTEST)
            if position <= 1e-3 * o.tol_p and rotation <= 1e-3 * o.tol_r:
                break
        else:
            copy(old, x)
            damping = max(100.0 * damping, DAMPING)
            if count >= most:
                break
            e = p.evaluate(x)
            count += 1
        if k == steps or damping > STIFFEST:
            break
        p.jacobian(e)
        for i in range(n):
            s.w[i] = 0.0 if i == fixed else 1.0
            for r in range(3):
                s.J[i, r] *= wp
                s.J[i, 3 + r] *= wr
        for _ in range(n):
            damped(s.J, s.w, s.dq, e.linear * wp, e.angular * wr, damping * max(wp, wr) ** 2)
            if not (limited and hold(x, s.dq, s.w, box)):
                break
        for i in range(n):
            a = x[i] + s.dq[i]
            x[i] = min(max(a, box.lower(i)), box.upper(i)) if limited else a
    for i in range(n):
        q[i] = old[i] * box.unit(i)
    return position, rotation, count


@inner
def near_a_row(table, count, q):
    """Return whether q (n,) is already listed: whether one of the first `count` rows of a table differs by less than DISTINCT.

    DISTINCT bounds the difference of every joint [rad]. table (K, 3 + n): rows as `list_with` writes them.
    """
    for row in range(count):
        apart = 0.0
        for i in range(q.shape[0]):
            apart = max(apart, abs(table[row, 3 + i] - q[i]))
        if apart < DISTINCT:
            return True
    return False


@cached
def list_branches(rows, ends, opt, T, start, branches, table, signs):
    """List the branches of a closed form that are solutions, as `list_with` does, given the chain's arrays instead of a problem."""
    p = make_serial(rows, ends, opt[SIZE.orders :], start.shape[0], read(Orders, opt))
    return list_with(p, np.empty((2, start.shape[0])), opt, T, start, branches, table, signs)


@inner
def list_with(p, work, opt, T, start, branches, table, signs):
    """Fill table (K, 3 + n) and signs (K, 3) with the branches of a closed form that are solutions, nearest to `start` (n,) first.

    A branch is a solution if it exceeds no limit and after `polish` meets the tolerances of T (4, 4). One that exceeds limits by
    less than BORDER is put on them first.

    Args:
        p: Problem (`kernel.serial`) of the chain.
        work: Scratch (2, n).
        opt: Option array (`records.Orders`).
        T: Target (4, 4).
        start: Configuration (n,) from which distances are measured.
        branches: `fixed` and `steps` of `polish`; branches Q (K, n), by how much each exceeds limits (K,), and its signs (K, 3).
        table: Receives position error [m], rotation error [rad], distance from `start` (angles [rad], lengths over the scale), q.
        signs: Receives the signs of these branches.

    Returns:
        The number of solutions, and the number of branches inside the limits.
    """
    fixed, steps, Q, broken, marks = branches
    n, box, o = Q.shape[1], p.ends, read(Orders, opt)
    kept = legal = 0
    q, old = work[0], work[1]
    for turn in range(2 * Q.shape[0]):
        k, border = turn % Q.shape[0], turn >= Q.shape[0]
        if (broken[k] > 0.0) != border or broken[k] > BORDER:
            continue
        legal += not border
        for i in range(n):
            x = Q[k, i] / box.unit(i)
            q[i] = (min(max(x, box.lower(i)), box.upper(i)) if border else x) * box.unit(i)
        position, rotation, _ = newton(p, old, opt, T, q, fixed, steps, np.inf)
        if not (position < o.tol_p and rotation < o.tol_r):
            continue
        if border:
            if near_a_row(table, kept, q):
                continue
            legal += 1
        distance = 0.0
        for i in range(n):
            distance += ((q[i] - start[i]) / box.unit(i)) ** 2
        distance = math.sqrt(distance)
        place = kept
        while place > 0 and table[place - 1, 2] > distance:
            copy(table[place - 1], table[place])
            copy(signs[place - 1], signs[place])
            place -= 1
        table[place, 0], table[place, 1], table[place, 2] = position, rotation, distance
        copy(q, table[place, 3:])
        copy(marks[k], signs[place])
        kept += 1
    return kept, legal


@cached
def first_good(rows, ends, opt, T, starts, fixed, steps, most, q):
    """Improve the rows of starts (K, n) by `polish`, one by one, until one meets the tolerances of T (4, 4); that one is left in q.

    rows, ends, opt, fixed, steps: as for `polish`; most: number of evaluations allowed in all (inf: any). Returns the errors [m]
    and [rad] of q (n,) (inf if no row meets the tolerances), and the number of evaluations made.
    """
    evaluations = 0
    for k in range(starts.shape[0]):
        if evaluations >= most:
            break
        copy(starts[k], q)
        position, rotation, count = polish(rows, ends, opt, T, q, fixed, steps, most - evaluations)
        evaluations += count
        if position < opt[ORDER.tol_p] and rotation < opt[ORDER.tol_r]:
            return position, rotation, evaluations
    return np.inf, np.inf, evaluations
