"""Which part of a tip's pose error counts: `shape` computes the errors that count, `count_column` their derivative.

The error of a tip is e = target - tip and the rotation vector r of the rotation that is left, R_target = exp(r) R_tip. Of this
error all may count, only e, nothing, or a part. A part is computed in these steps, one after the other:

    a free turn     r becomes the least rotation that brings the tip's axis a onto the target's axis b
    a frame         e and r are expressed in the axes of the base, the tip or the target
    dead band s     e_i becomes sign(e_i) max(|e_i| - s_i, 0)
    weights w       e_i becomes w_i e_i

An error inside its dead band is zero, and so is its row of the Jacobian. The least-squares problem stays continuous where an error
enters its dead band, and near the solution the set of rows that are not zero no longer changes.

`add_curvature` has the second derivatives in closed form, for errors in order of priority. Let u_r, v_r be the linear and angular
column of joint r, and r nearer the base than t. Then, with sums over all pairs,

    position p             d2 p / dr dt = v_r x u_t
    rotation R             d2 (rotation vector) / dr dt = (v_r x v_t) / 2, where the rotation error is 0
    f = 1 - cos(angle)     d2 f / dr dt = ((v_r . v_t) tr E - v_r' E v_t) / 2   with E = R R_target'
    f = 1 - a . b          d2 f / dr dt = (v_r . v_t) (a . b) - (v_r . a) (v_t . b)   with a free turn about a
"""

import math
from typing import NamedTuple

from ..compile.jit import compiled, inline, inner
from .algebra import M3, V3, at3, product, put3, rotation_at, transposed
from .kinematics import angle_ratio, column, rotation_angle
from .records import WHAT, Array

AXIS = "axis"  # tag of a target (AXIS, axis): a pose that leaves the rotation about this axis of the tip free


class TargetKinds(NamedTuple):
    """Kinds of target: which part of a tip's pose error counts."""

    pose: int = 0  # the whole error counts
    position: int = 1  # only the position error counts
    free: int = 2  # nothing counts: the tip has no target
    part: int = 3  # only a part of the error counts: it has weights, dead bands or a free axis, see `records.Task`


class AxesOfParts(NamedTuple):
    """Frames in whose axes the weights and dead bands of a pose error may be given."""

    base: int = 0
    tip: int = 1
    target: int = 2


class KeptIndices(NamedTuple):
    """Indices in the array `kept` (IN.size,), where `shape` stores what is needed to differentiate the errors that count.

    A Jacobian column (u, v) of the tip becomes (L (u + v x arm), A v) in the errors that count; a column of the target, if that
    moves with another tip, becomes (L (u + v x arm_goal), B v).
    """

    L: int = 0  # index of the matrix L, stored as 9 numbers by rows
    A: int = 9  # index of the matrix A, stored as 9 numbers by rows
    B: int = 18  # index of the matrix B, stored as 9 numbers by rows
    arm: int = 27  # index of the vector `arm` (3) in the formula above
    arm_goal: int = 30  # index of the vector `arm_goal` (3) in the formula above
    error: int = 33  # index of the six errors that count, with weights and dead bands applied
    size: int = 39  # length of the array


class SmallAngles(NamedTuple):
    """Bounds below which a formula that divides by an angle, or by its sine, is replaced."""

    sine: float = 1e-9  # two directions count as parallel if the sine of their angle is below this, which is rounding
    # [rad] Below this angle a series replaces the closed formula of a second derivative; the value was set by hand.
    angle: float = 1e-3


KIND, AXES, IN, SMALL = TargetKinds(), AxesOfParts(), KeptIndices(), SmallAngles()


@inner
def allowance(task, first, tolerance):
    """Return how large a tip's position error, or its rotation error, may be while what counts of it is in tolerance.

    This is a bound on the norm of the three errors: the dead bands plus the tolerance divided by the smallest weight, infinite if
    one of the errors does not count. first: 0 for the position errors, 3 for the rotation errors; task: the fields of a `Task`.
    """
    least, room = math.inf, 0.0
    for i in range(first, first + 3):
        least = min(least, task[WHAT.w0 + i])
        room += task[WHAT.s0 + i] * task[WHAT.s0 + i]
    return math.sqrt(room) + tolerance / least if least > 0.0 else math.inf


@inner
def log_curvature(rr):
    """Return the factor c in the derivative of a rotation vector r, which is w + r x w / 2 + c r x (r x w).

    w: angular velocity; rr: |r|^2.
    """
    if rr < 1e-4:
        # For small angles, the power series of the formula below, up to the term rr^2 / 30240, which is left out.
        return 1.0 / 12.0 + rr / 720.0
    half = 0.5 * math.sqrt(rr)
    return (1.0 - half * math.cos(half) / math.sin(half)) / rr


@inner
def shape(task, ends, goal, now, linear, angular, kept):
    """Return what counts of a pose error (linear, angular): weights, dead bands and a free axis of rotation are applied to it.

    Also fills kept (IN.size,), from which `count_column` converts Jacobian columns. The given angular error is 2 sin(angle/2) times
    the axis; `now` holds the present axes of the last joint. task: the fields of a `Task`; ends: `Ends`; goal: (GOAL,) target. In
    the comments below, G is the matrix for which a small rotation v of the tip changes the rotation vector r by -G v; a small
    rotation v of the target changes r by G' v.
    """
    none = V3(0.0, 0.0, 0.0)
    if int(task[WHAT.kind]) == KIND.free:
        for k in range(IN.size):
            kept[k] = 0.0
        return none, none
    target = rotation_at(goal, 0)
    frame, turns = int(task[WHAT.frame]), task[WHAT.free] > 0.0
    a, b, k, f, slope = none, none, none, 0.0, 0.0
    if turns:  # Here r = f a x b with f = angle / sine, and `slope` is the derivative of f with respect to the cosine.
        axis = at3(task, WHAT.ax)
        a, b = now.times(axis), target.times(axis)
        k = a.cross(b)
        sine, cosine = math.sqrt(k.square()), a.dot(b)
        r, f, slope = k, 1.0, -1.0 / 3.0
        if sine > SMALL.sine:
            f = math.atan2(sine, cosine) / sine
            r, slope = k * f, (f * cosine - 1.0) / (sine * sine)
        elif cosine < 0.0:  # For a rotation by pi, any axis of rotation perpendicular to a will do.
            r, f, slope = V3(0.0, -a.z, a.y) if abs(a.x) < 0.7 else V3(-a.y, a.x, 0.0), -1.0, 0.0
            r = r * (math.pi / math.sqrt(r.square()))
    else:
        r = angular * angle_ratio(angular.square())
        f = log_curvature(r.square())
    axes = target if frame == AXES.target else now
    for i in range(3):
        axis = at3(ends.flat, 3 * i)
        if frame != AXES.base:
            axis = axes.times(V3(ends.flat[12 + i], ends.flat[15 + i], ends.flat[18 + i]))
        across = r.cross(axis)
        # `own` is axis' G: the derivative of this component of the rotation vector by a rotation of the tip, but for its sign.
        if turns:
            bend = k * (slope * k.dot(axis))
            own = a.cross(axis.cross(b)) * f - bend
        else:
            bend = axis + r.cross(across) * f
            own = bend - across * 0.5
        if frame == AXES.tip:
            own = own + across
        e, w, s = axis.dot(linear), task[WHAT.w0 + i], task[WHAT.s0 + i]
        e = e - min(max(e, -s), s)
        kept[IN.error + i] = w * e
        put3(kept, IN.L + 3 * i, axis * (w if e != 0.0 or s == 0.0 else 0.0))
        e, w, s = axis.dot(r), task[WHAT.w3 + i], task[WHAT.s3 + i]
        e = e - min(max(e, -s), s)
        kept[IN.error + 3 + i] = w * e
        w = w if e != 0.0 or s == 0.0 else 0.0
        put3(kept, IN.A + 3 * i, own * w)
        # `others` is axis' G': the derivative of this component of the rotation vector by a rotation of the target.
        others = b.cross(axis.cross(a)) * f - bend if turns else bend + across * 0.5
        put3(kept, IN.B + 3 * i, (others - across if frame == AXES.target else others) * w)
    put3(kept, IN.arm, linear if frame == AXES.tip else none)
    put3(kept, IN.arm_goal, -linear if frame == AXES.target else none)
    return at3(kept, IN.error), at3(kept, IN.error + 3)


@inline
def rows_at(kept, i):
    """Return the transpose of a 3x3 matrix that an array holds by rows, from index i on.

    Its columns are thus the rows of the stored matrix.
    """
    return M3(at3(kept, i), at3(kept, i + 3), at3(kept, i + 6))


@inner
def count_column(kept, linear, angular):
    """Convert a column (linear, angular) of the tip's Jacobian to the components of the error that count, and return it.

    kept: (IN.size,) what `shape` has written for the present configuration.
    """
    linear = linear + angular.cross(at3(kept, IN.arm))
    return rows_at(kept, IN.L).across(linear), rows_at(kept, IN.A).across(angular)


@inner
def count_goal_column(kept, linear, angular):
    """Return the derivative of the errors that count for a motion (linear, angular) of the target.

    kept: (IN.size,) what `shape` has written for the present configuration.
    """
    linear = linear + angular.cross(at3(kept, IN.arm_goal))
    return rows_at(kept, IN.L).across(linear), rows_at(kept, IN.B).across(angular)


@inner
def turn_axis(task, kept, out):
    """Write to out (3,) the unit normal n of the mirror plane that makes the third rotation error of a tip vanish.

    If the tip may turn freely about an axis, only two of its rotation errors are independent. Zeros are written if it may not, or
    if one of the rotation errors does not count. With a free turn the rotation error r is always normal to an axis c, so c' r = 0.
    The reflection 1 - 2 n n' (Householder's) takes c to the z axis (or its opposite), so r_z becomes 0. task: the fields of a
    `Task`; kept: (IN.size,) as `shape` fills it.
    """
    put3(out, 0, V3(0.0, 0.0, 0.0))
    if (
        int(task[WHAT.kind]) != KIND.part
        or task[WHAT.free] == 0.0
        or min(task[WHAT.w3], task[WHAT.w4], task[WHAT.w5]) == 0.0
    ):
        return
    x, y, z = rotation_at(kept, IN.A)
    a, b, c = x.cross(y), y.cross(z), z.cross(x)
    if b.square() > a.square():
        a = b
    if c.square() > a.square():
        a = c
    size = math.sqrt(a.square())
    if size > SMALL.sine:
        a = a * (1.0 / size)
        a = a + V3(0.0, 0.0, 1.0 if a.z >= 0.0 else -1.0)
        put3(out, 0, a * (1.0 / math.sqrt(a.square())))


# ----------------------------------------------------------------------------------------------------------------- measure
@inline
def vector_ratio(kind, rr):
    """Return the factor that turns a rotation error of squared length rr into a rotation vector.

    If only a part of the error counts (kind is KIND.part), the rotation error already is a rotation vector, and the factor is 1.
    """
    return 1.0 if kind == KIND.part else angle_ratio(rr)


@inline
def angle_left(kind, rr):
    """Return the angle [rad] of a rotation error of squared length rr, for a target of a kind of `TargetKinds`."""
    return math.sqrt(rr) if kind == KIND.part else rotation_angle(rr)


@inline
def counts(task):
    """Return two flags, 1.0 or 0.0: whether starts near the target's position, and near its rotation, are to be preferred.

    A flag is 0 if no component of that error counts, or its dead band allows any value. task: the fields of a `Task`.
    """
    position, rotation = 0.0, 0.0
    for i in range(3):
        if task[WHAT.w0 + i] > 0.0 and task[WHAT.s0 + i] < math.inf:
            position = 1.0
        if task[WHAT.w3 + i] > 0.0 and task[WHAT.s3 + i] < math.pi and task[WHAT.free] == 0.0:
            rotation = 1.0
    return position, rotation


# ------------------------------------------------------------------------------------------------ second derivatives
@compiled
class TipState(NamedTuple):
    """A tip at one configuration: its chain, its target with the part of the error that counts, and its pose."""

    rows: Array  # (L, 10) geometry of the chain
    joints: Array  # (6 L,) axis and point of each joint
    task: Array  # (SIZE.task,) which part of the error counts, see `records.Task`
    kept: Array  # (IN.size,) matrices that `shape` computed for this configuration
    goal: Array  # (GOAL,) the target
    pose: Array  # (12,) axes of the last joint by rows, then the tip's position


@inner
def even_weight(task):
    """Return the weight of a tip's rotation errors if it is the same for all three and they have no dead band, else 0.

    task: the fields of a `Task`.
    """
    w = task[WHAT.w3]
    even = task[WHAT.w4] == w and task[WHAT.w5] == w and task[WHAT.s3] + task[WHAT.s4] + task[WHAT.s5] == 0.0
    return w if even else 0.0


@inner
def add_products(J, first, e, factor, H):
    """Add to H (n, n) the sum of g_k g_k' over three errors k from `first` on, where g_k is column k of J (n, m).

    If `factor` is not 0, add instead `factor` times g g', where g = J e, over the same three errors, is the gradient of half their
    squared norm (but for its sign).
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


@compiled
class Bend(NamedTuple):
    """Factors that multiply the second derivatives of a tip's errors where these enter the Hessian of a Lagrangian."""

    linear: V3  # (V3) factors for the components of the position
    turn: V3  # (V3) factors for the components of the rotation vector
    least: M3  # (M3) matrix for the second derivatives of the squared rotation error; zeros unless that is minimised


@inline
def plus_cross(m, v):
    """Return the matrix m plus the cross-product matrix of v: applied to a vector w, the sum gives m w + v x w."""
    return M3(m.x + V3(0.0, v.z, -v.y), m.y + V3(-v.z, 0.0, v.x), m.z + V3(v.y, -v.x, 0.0))


@inline
def plus_diagonal(x, y, z, d, factor):
    """Return `factor` times the sum of a matrix, with columns x, y and z, and d times the identity."""
    x, y, z = x + V3(d, 0.0, 0.0), y + V3(0.0, d, 0.0), z + V3(0.0, 0.0, d)
    return M3(x * factor, y * factor, z * factor)


@inner
def add_pairs(rows, joints, tip, linear, turn, H):
    """Add to the Hessian H (n, n) the second derivatives that pairs of joints r and t of a chain contribute.

    The contribution is (linear x v_r) . u_t + (turn v_r) . v_t, where u and v are the linear and angular velocity of the point
    `tip` per unit of a joint, and joint r is the one nearer the base. linear is a vector (V3), turn a matrix (M3); rows and joints
    as in `TipState`.
    """
    for r in range(rows.shape[0]):
        u, v = column(rows, joints, r, tip)
        i, ratio = int(rows[r, 8]), rows[r, 4] + rows[r, 6]
        u, v = linear.cross(v) * ratio, turn.times(v) * ratio
        for t in range(r, rows.shape[0]):
            x, y = column(rows, joints, t, tip)
            j = int(rows[t, 8])
            h = (u.dot(x) + v.dot(y)) * (rows[t, 4] + rows[t, 6])
            H[i, j] += h
            if r != t:
                H[j, i] += h


@inner
def add_curvature(state, J, first, e, c, least, H):
    """Add to the Hessian H (n, n) of a Lagrangian the second derivatives of one tip's errors.

    Args:
        state: The tip at this configuration, as a `TipState`.
        J: (n, m) transposed Jacobian of the errors that count.
        first: Index of the tip's six errors among all m.
        e: (m,) errors, rotations as rotation vectors.
        c: (m,) factors of the second derivatives of the errors: minus the multiplier of a constraint, or minus the error itself.
        least: (2,) flags for position and rotation: 1 if half the squared error is a part of what is minimised, else 0.
        H: (n, n) matrix to add to.

    Returns:
        The factors (Bend) that were used for pairs of the tip's own joints; `relative.add_goal_curvature` needs them.
    """
    task, kept = state.task, state.kept
    kind = int(task[WHAT.kind])
    R, G, tip = rotation_at(state.pose, 0), rotation_at(state.goal, 0), at3(state.pose, 9)
    cp, cr = at3(c, first), at3(c, first + 3) * 0.5
    if kind == KIND.part:
        cp, cr = rows_at(kept, IN.L).times(cp), rows_at(kept, IN.A).times(cr)
    if least[0] > 0.0:
        add_products(J, first, e, 0.0, H)
    none = V3(0.0, 0.0, 0.0)
    m = M3(none, none, none)
    if least[1] > 0.0:
        weight = 1.0 if kind == KIND.pose else even_weight(task)
        if weight > 0.0:
            turn, cr = 1.0, none
            if kind == KIND.part:
                angle = math.sqrt(at3(e, first + 3).square()) / weight
                cosine, turn = (
                    math.cos(angle),
                    angle / max(math.sin(angle), SMALL.angle) if angle > SMALL.angle else 1.0,
                )
                factor = (1.0 - turn * cosine) / (angle * angle) if angle > SMALL.angle else 1.0 / 3.0
                add_products(J, first + 3, e, factor / (weight * weight), H)
            turn *= weight * weight
            if kind == KIND.part and task[WHAT.free] > 0.0:
                axis = at3(task, WHAT.ax)
                a, b = R.times(axis), G.times(axis)
                m = plus_diagonal(b * -a.x, b * -a.y, b * -a.z, a.dot(b), turn)
            else:
                left = product(G, transposed(R))
                trace = left.x.x + left.y.y + left.z.z
                m = plus_diagonal(-left.x, -left.y, -left.z, trace, 0.5 * turn)
        else:
            add_products(J, first + 3, e, 0.0, H)
    add_pairs(state.rows, state.joints, tip, cp, plus_cross(m, cr), H)
    return Bend(cp, cr, m)
