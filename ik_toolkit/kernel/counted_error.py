"""Which part of the pose error counts: all of it, the position, none, or a part: `shape` and its derivative `count_column`.

The error of a tip is e = target - tip and the rotation vector r of the rotation that is left, R_target = exp(r) R_tip. Where
only a part counts it becomes, in this order,

    a free turn     r is the least rotation that brings the tip's axis a onto the target's axis b
    a frame         e and r in the axes E of the base, the tip or the target
    slack s         e_i -> sign(e_i) max(|e_i| - s_i, 0)
    weights w       e_i -> w_i e_i

Errors inside their slack do not see the joints, so their rows of the Jacobian are zero: the least squares of what is left
outside. They and their derivative are continuous there, and near the answer the rows do not change any more.
"""

import math

from ..compile.jit import inline, inner
from .algebra import M3, V3, at3, put3, rotation_at
from .kinematics import angle_ratio, rotation_angle
from .records import WHAT

POSE, POSITION, FREE, PART = range(4)
AXIS = "axis"  # (AXIS, axis) is a kind of target, not of task: a pose of which the turn about a tip axis is free
BASE, TIP, TARGET = range(3)
# What `shape` keeps for `count_column`, by place. A column (u, v) counts as L (u + v x arm), A v; the target's, where it moves
# with another tip, as L (u + v x ARM_GOAL), B v; three rows each of L, A and B, and the errors themselves.
L, A, B, ARM, ARM_GOAL, ERROR, KEPT = 0, 9, 18, 27, 30, 33, 39
STRAIGHT = 1e-9  # sine of the angle below which two directions count as parallel: their cross product is rounding


@inner
def allowance(task, first, tolerance):
    """Largest norm of the three errors from `first` on that is inside the tolerance; inf when one of them does not count."""
    least, room = math.inf, 0.0
    for i in range(first, first + 3):
        least = min(least, task[WHAT.w0 + i])
        room += task[WHAT.s0 + i] * task[WHAT.s0 + i]
    return math.sqrt(room) + tolerance / least if least > 0.0 else math.inf


@inner
def log_curvature(rr):
    """c in the derivative w + 1/2 r x w + c r x (r x w) of a rotation vector r with rr = |r|^2 (its inverse right Jacobian)."""
    if rr < 1e-4:
        return 1.0 / 12.0 + rr / 720.0  # the next term is rr^2 / 30240
    half = 0.5 * math.sqrt(rr)
    return (1.0 - half * math.cos(half) / math.sin(half)) / rr


@inner
def shape(task, ends, goal, now, linear, angular, kept):
    """Errors that count, of a pose error (angular: 2 sin(angle/2) times the axis); `kept` (KEPT,) is for `count_column`.

    now: axes of the last joint. When the tip turns by v the rotation vector r falls by G v, when the target does it grows by
    G' v; r itself turns with its axes where they move.
    """
    none = V3(0.0, 0.0, 0.0)
    if int(task[WHAT.kind]) == FREE:
        for k in range(KEPT):
            kept[k] = 0.0
        return none, none
    target = rotation_at(goal, 0)
    frame, turns = int(task[WHAT.frame]), task[WHAT.free] > 0.0
    a, b, k, f, slope = none, none, none, 0.0, 0.0
    if turns:  # r = f a x b; f = angle / sine, and its slope by the cosine
        axis = at3(task, WHAT.ax)
        a, b = now.times(axis), target.times(axis)
        k = a.cross(b)
        sine, cosine = math.sqrt(k.square()), a.dot(b)
        r, f, slope = k, 1.0, -1.0 / 3.0
        if sine > STRAIGHT:
            f = math.atan2(sine, cosine) / sine
            r, slope = k * f, (f * cosine - 1.0) / (sine * sine)
        elif cosine < 0.0:  # half a turn about any axis across; 0.7: the longer of two
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
        if turns:  # G' times the axis: a row of G
            bend = k * (slope * k.dot(axis))
            own = a.cross(axis.cross(b)) * f - bend
        else:
            bend = axis + r.cross(across) * f
            own = bend - across * 0.5
        if frame == TIP:
            own = own + across
        e, w, s = axis.dot(linear), task[WHAT.w0 + i], task[WHAT.s0 + i]
        e = e - min(max(e, -s), s)
        kept[ERROR + i] = w * e
        put3(kept, L + 3 * i, axis * (w if e != 0.0 or s == 0.0 else 0.0))
        e, w, s = axis.dot(r), task[WHAT.w3 + i], task[WHAT.s3 + i]
        e = e - min(max(e, -s), s)
        kept[ERROR + 3 + i] = w * e
        w = w if e != 0.0 or s == 0.0 else 0.0
        put3(kept, A + 3 * i, own * w)
        others = b.cross(axis.cross(a)) * f - bend if turns else bend + across * 0.5  # and G times it
        put3(kept, B + 3 * i, (others - across if frame == TARGET else others) * w)
    put3(kept, ARM, linear if frame == TIP else none)
    put3(kept, ARM_GOAL, -linear if frame == TARGET else none)
    return at3(kept, ERROR), at3(kept, ERROR + 3)


@inline
def rows_at(kept, i):
    """Three rows, as the columns of the transpose."""
    return M3(at3(kept, i), at3(kept, i + 3), at3(kept, i + 6))


@inner
def count_column(kept, linear, angular):
    """Column of what counts, of a column of the tip, where `shape` was called last."""
    linear = linear + angular.cross(at3(kept, ARM))
    return rows_at(kept, L).across(linear), rows_at(kept, A).across(angular)


@inner
def count_goal_column(kept, linear, angular):
    """The same of a target that moves: how the error grows."""
    linear = linear + angular.cross(at3(kept, ARM_GOAL))
    return rows_at(kept, L).across(linear), rows_at(kept, B).across(angular)


@inner
def turn_axis(task, kept, out):
    """Normal (3,) of the mirror that lays the rotation about a free axis last, where it is 0; zeros where none is free.

    The three errors of a rotation whose turn is free have one dependence, c' r = 0; H = 1 - 2 n n' brings c to the z axis.
    """
    for k in range(3):
        out[k] = 0.0
    if (
        int(task[WHAT.kind]) != PART
        or task[WHAT.free] == 0.0
        or min(task[WHAT.w3], task[WHAT.w4], task[WHAT.w5]) == 0.0
    ):
        return
    m = rows_at(kept, A)
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
    """Angle over length of a rotation error of squared length rr: in part it is a rotation vector, else 2 sin(angle/2)."""
    return 1.0 if kind == PART else angle_ratio(rr)


@inline
def angle_left(kind, rr):
    """Angle [rad] of a squared rotation error."""
    return math.sqrt(rr) if kind == PART else rotation_angle(rr)


@inline
def counts(task):
    """Whether position and rotation count (1.0 or 0.0), for the choice of starts."""
    position, rotation = 0.0, 0.0
    for i in range(3):
        if task[WHAT.w0 + i] > 0.0 and task[WHAT.s0 + i] < math.inf:
            position = 1.0
        if task[WHAT.w3 + i] > 0.0 and task[WHAT.s3 + i] < math.pi and task[WHAT.free] == 0.0:
            rotation = 1.0
    return position, rotation
