"""Which part of a tip's pose error counts: `shape` computes the errors that count, `count_column` their derivative.

The error of a tip is e = target - tip and the rotation vector r of the rotation that is left, R_target = exp(r) R_tip. Of this
error all may count, only e, nothing, or a part. A part is computed in these steps, one after the other:

    a free turn     r becomes the least rotation that brings the tip's axis a onto the target's axis b
    a frame         e and r are expressed in the axes of the base, the tip or the target
    dead band s     e_i becomes sign(e_i) max(|e_i| - s_i, 0)
    weights w       e_i becomes w_i e_i

An error inside its dead band is zero, and so is its row of the Jacobian. The least-squares problem stays continuous where an error
enters its dead band, and near the solution the set of rows that are not zero no longer changes.
"""

import math
from typing import NamedTuple

from ..compile.jit import inline, inner
from .algebra import M3, V3, at3, put3, rotation_at
from .kinematics import angle_ratio, rotation_angle
from .records import WHAT

POSE, POSITION, FREE, PART = range(4)  # kinds of target: the whole error counts, only the position, nothing, or a part
AXIS = "axis"  # a target (AXIS, axis) is a pose that leaves the rotation about this axis of the tip free
BASE, TIP, TARGET = range(3)  # frames in which weights and dead bands may be given


class KeptIndices(NamedTuple):
    """Indices in the array (KEPT,) that `shape` fills for the derivative.

    A Jacobian column (u, v) of the tip becomes (L (u + v x arm), A v) in the errors that count; a column of the target,
    if that moves with another tip, becomes (L (u + v x arm_goal), B v).
    """

    L: int = 0  # index of the matrix L, 9 numbers by rows
    A: int = 9  # index of the matrix A, 9 numbers by rows
    B: int = 18  # index of the matrix B, 9 numbers by rows
    arm: int = 27  # index of the vector `arm` (3), see above
    arm_goal: int = 30  # index of the vector `arm_goal` (3), see above
    error: int = 33  # index of the six errors that count, with weights and dead bands applied


IN = KeptIndices()
KEPT = 39  # length of the array that `shape` fills
STRAIGHT = 1e-9  # Two directions count as parallel if the sine of their angle is below this, which is rounding.


@inner
def allowance(task, first, tolerance):
    """Return a bound on the norm of three raw errors, `first` and the next two, whose counted values are in tolerance.

    The bound adds the dead bands and divides by the weights. It is infinite if one of the three errors does not count.
    """
    least, room = math.inf, 0.0
    for i in range(first, first + 3):
        least = min(least, task[WHAT.w0 + i])
        room += task[WHAT.s0 + i] * task[WHAT.s0 + i]
    return math.sqrt(room) + tolerance / least if least > 0.0 else math.inf


@inner
def log_curvature(rr):
    """Return c in the derivative w + 1/2 r x w + c r x (r x w) of a rotation vector r; w: angular velocity; rr = |r|^2."""
    if rr < 1e-4:
        return 1.0 / 12.0 + rr / 720.0  # the series of the formula below, whose next term is rr^2 / 30240
    half = 0.5 * math.sqrt(rr)
    return (1.0 - half * math.cos(half) / math.sin(half)) / rr


@inner
def shape(task, ends, goal, now, linear, angular, kept):
    """Return the part (linear, angular) of a pose error that counts, and fill kept (KEPT,) for `count_column`.

    The given angular error is 2 sin(angle/2) times the axis; now: axes of the last joint. Comments in the code call G the matrix
    for which a small rotation v of the tip changes the rotation vector r by -G v. A small rotation v of the target changes r by
    G' v.
    """
    none = V3(0.0, 0.0, 0.0)
    if int(task[WHAT.kind]) == FREE:
        for k in range(KEPT):
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
        if sine > STRAIGHT:
            f = math.atan2(sine, cosine) / sine
            r, slope = k * f, (f * cosine - 1.0) / (sine * sine)
        elif cosine < 0.0:  # For a rotation by pi any axis normal to a will do.
            r, f, slope = V3(0.0, -a.z, a.y) if abs(a.x) < 0.7 else V3(-a.y, a.x, 0.0), -1.0, 0.0
            r = r * (math.pi / math.sqrt(r.square()))
    else:
        r = angular * angle_ratio(angular.square())
        f = log_curvature(r.square())
    axes = target if frame == TARGET else now
    for i in range(3):
        axis = at3(ends.flat, 3 * i)
        if frame != BASE:
            axis = axes.times(V3(ends.flat[12 + i], ends.flat[15 + i], ends.flat[18 + i]))
        across = r.cross(axis)
        if turns:  # The vector `own` becomes a row of the matrix G, which is axis' G.
            bend = k * (slope * k.dot(axis))
            own = a.cross(axis.cross(b)) * f - bend
        else:
            bend = axis + r.cross(across) * f
            own = bend - across * 0.5
        if frame == TIP:
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
        # `others` is a row of the transposed matrix G': axis' G'.
        others = b.cross(axis.cross(a)) * f - bend if turns else bend + across * 0.5
        put3(kept, IN.B + 3 * i, (others - across if frame == TARGET else others) * w)
    put3(kept, IN.arm, linear if frame == TIP else none)
    put3(kept, IN.arm_goal, -linear if frame == TARGET else none)
    return at3(kept, IN.error), at3(kept, IN.error + 3)


@inline
def rows_at(kept, i):
    """Read three vectors from index i on; return the matrix with these columns, the transpose of the matrix stored by rows."""
    return M3(at3(kept, i), at3(kept, i + 3), at3(kept, i + 6))


@inner
def count_column(kept, linear, angular):
    """Convert a Jacobian column (linear, angular) of the tip to the errors that count; `shape` has filled `kept` for this q."""
    linear = linear + angular.cross(at3(kept, IN.arm))
    return rows_at(kept, IN.L).across(linear), rows_at(kept, IN.A).across(angular)


@inner
def count_goal_column(kept, linear, angular):
    """Convert a motion (linear, angular) of the target to a change of the counted errors; `shape` has filled `kept` for this q."""
    linear = linear + angular.cross(at3(kept, IN.arm_goal))
    return rows_at(kept, IN.L).across(linear), rows_at(kept, IN.B).across(angular)


@inner
def turn_axis(task, kept, out):
    """Write to out (3,) the normal n of a Householder reflection that makes the third rotation error 0, or zeros.

    It writes zeros if no turn is free, or if one of the rotation errors does not count. With a free turn the rotation error r is
    always normal to an axis c, so c' r = 0. The reflection 1 - 2 n n' takes c to the z axis (or its opposite), so r_z becomes 0.
    """
    for k in range(3):
        out[k] = 0.0
    if (
        int(task[WHAT.kind]) != PART
        or task[WHAT.free] == 0.0
        or min(task[WHAT.w3], task[WHAT.w4], task[WHAT.w5]) == 0.0
    ):
        return
    m = rows_at(kept, IN.A)
    x, y, z = V3(m.x.x, m.y.x, m.z.x), V3(m.x.y, m.y.y, m.z.y), V3(m.x.z, m.y.z, m.z.z)
    a, b, c = x.cross(y), y.cross(z), z.cross(x)
    if b.square() > a.square():
        a = b
    if c.square() > a.square():
        a = c
    size = math.sqrt(a.square())
    if size > STRAIGHT:
        a = a * (1.0 / size)
        a = a + V3(0.0, 0.0, 1.0 if a.z >= 0.0 else -1.0)
        a = a * (1.0 / math.sqrt(a.square()))
        out[0], out[1], out[2] = a.x, a.y, a.z


# ----------------------------------------------------------------------------------------------------------------- measure
@inline
def vector_ratio(kind, rr):
    """Return the factor that turns a rotation error of squared length rr into a rotation vector.

    If only a part of the error counts (PART), the rotation error already is a rotation vector, and the factor is 1.
    """
    return 1.0 if kind == PART else angle_ratio(rr)


@inline
def angle_left(kind, rr):
    """Return the angle [rad] of a rotation error of squared length rr."""
    return math.sqrt(rr) if kind == PART else rotation_angle(rr)


@inline
def counts(task):
    """Return two flags, 1.0 or 0.0: whether the position counts, and whether the rotation counts, in the choice of starts."""
    position, rotation = 0.0, 0.0
    for i in range(3):
        if task[WHAT.w0 + i] > 0.0 and task[WHAT.s0 + i] < math.inf:
            position = 1.0
        if task[WHAT.w3 + i] > 0.0 and task[WHAT.s3 + i] < math.pi and task[WHAT.free] == 0.0:
            rotation = 1.0
    return position, rotation
