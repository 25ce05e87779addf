"""Second derivatives of the errors of one tip, in closed form from the columns of its Jacobian.

Let u_r, v_r be the linear and angular column of joint r, and r nearer the base than t. Then, with sums over all pairs,

    position p             d2 p / dr dt = v_r x u_t
    rotation R             d2 (rotation vector) / dr dt = (v_r x v_t) / 2, where the rotation error is 0
    f = 1 - cos(angle)     d2 f / dr dt = ((v_r . v_t) tr E - v_r' E v_t) / 2   with E = R R_target'
    f = 1 - a . b          d2 f / dr dt = (v_r . v_t) (a . b) - (v_r . a) (v_t . b)   with a free turn about a
"""

import math
from typing import NamedTuple

from ..compile.jit import compiled, inner
from .algebra import at3, rotation_at
from .counted_error import IN, PART, POSE, rows_at
from .kinematics import column
from .records import WHAT, Array

SMALL = 1e-3  # [rad] angle below which a series replaces the closed formula


@compiled
class TipState(NamedTuple):
    """One tip at a configuration: its chain, which part of its error counts, and its pose."""

    rows: Array  # (L, 10) geometry of the chain
    joints: Array  # (6 L,) axis and point of each joint
    task: Array  # (TASK,) which part of the error counts, see `records.Task`
    kept: Array  # (KEPT,) matrices of `counted_error.shape`
    goal: Array  # (GOAL,) the target
    pose: Array  # (12,) axes of the last joint by rows, then the tip's position


@inner
def even_weight(task):
    """Return the weight of a tip's rotation errors if it is the same for all three and they have no dead band, else 0."""
    w = task[WHAT.w3]
    even = task[WHAT.w4] == w and task[WHAT.w5] == w and task[WHAT.s3] + task[WHAT.s4] + task[WHAT.s5] == 0.0
    return w if even else 0.0


@inner
def add_products(J, first, e, factor, H):
    """Add to H (n, n) the sum of g_k g_k' over three errors k from `first` on, where g_k is column k of J (n, m).

    If `factor` is not 0, add instead `factor` times g g', where g is the gradient J e of half their squared norm (but for its
    sign).
    """
    for i in range(J.shape[0]):
        gi = J[i, first] * e[first] + J[i, first + 1] * e[first + 1] + J[i, first + 2] * e[first + 2]
        for j in range(i + 1):
            gj = J[j, first] * e[first] + J[j, first + 1] * e[first + 1] + J[j, first + 2] * e[first + 2]
            h = factor * gi * gj
            if factor == 0.0:
                h = J[i, first] * J[j, first] + J[i, first + 1] * J[j, first + 1] + J[i, first + 2] * J[j, first + 2]
            H[i, j] += h
            if i != j:
                H[j, i] += h


@inner
def add_curvature(state, J, first, e, c, least, H):
    """Add to H (n, n) the second derivatives of a tip's part of a Lagrangian.

    Args:
        state: The tip at this configuration (TipState).
        J: (n, m) transposed Jacobian of the counted errors.
        first: Index of the tip's six errors among all m.
        e: (m,) errors, rotations as rotation vectors.
        c: (m,) factors of the second derivatives of the errors: minus the multiplier of a constraint, or minus the error itself.
        least: (2,) flags for position and rotation: 1 if half the squared error is a part of what is minimised, else 0.
        H: (n, n) The matrix to add to.
    """
    rows, joints, task, kept = state.rows, state.joints, state.task, state.kept
    kind = int(task[WHAT.kind])
    R, G, tip = rotation_at(state.pose, 0), rotation_at(state.goal, 0), at3(state.pose, 9)
    cp, cr = at3(c, first), at3(c, first + 3) * 0.5
    if kind == PART:
        cp, cr = rows_at(kept, IN.L).times(cp), rows_at(kept, IN.A).times(cr)
    if least[0] > 0.0:
        add_products(J, first, e, 0.0, H)
    turn, free, a, b, weight, cosine = 0.0, False, cp, cp, 1.0, 1.0
    if least[1] > 0.0:
        weight = 1.0 if kind == POSE else even_weight(task)
        if weight > 0.0:
            turn, cr = 1.0, cr * 0.0
            if kind == PART:
                angle = math.sqrt(at3(e, first + 3).square()) / weight
                cosine, turn = math.cos(angle), angle / max(math.sin(angle), SMALL) if angle > SMALL else 1.0
                factor = (1.0 - turn * cosine) / (angle * angle) if angle > SMALL else 1.0 / 3.0
                add_products(J, first + 3, e, factor / (weight * weight), H)
                free = task[WHAT.free] > 0.0
                if free:
                    axis = at3(task, WHAT.ax)
                    a, b = R.times(axis), G.times(axis)
        else:
            add_products(J, first + 3, e, 0.0, H)
    trace = R.x.dot(G.x) + R.y.dot(G.y) + R.z.dot(G.z)
    turn = turn * weight * weight
    for r in range(rows.shape[0]):
        u, v = column(rows, joints, r, tip)
        i, ratio = int(rows[r, 8]), rows[r, 4] + rows[r, 6]
        back = R.across(v)
        for t in range(r, rows.shape[0]):
            x, y = column(rows, joints, t, tip)
            h = cp.dot(v.cross(x)) + cr.dot(v.cross(y))
            if turn > 0.0:
                if free:
                    h += turn * (v.dot(y) * a.dot(b) - v.dot(a) * y.dot(b))
                else:
                    h += 0.5 * turn * (v.dot(y) * trace - back.dot(G.across(y)))
            j = int(rows[t, 8])
            h *= ratio * (rows[t, 4] + rows[t, 6])
            H[i, j] += h
            if r != t:
                H[j, i] += h
