"""What of the pose error counts: all of it, the position, nothing, or a part: `shape` and its derivative `count_column`.

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
from typing import NamedTuple

from .algebra import M3, V3, at3, put3, rotation_at
from .jit import compiled, inline, inner
from .kinematics import angle_ratio, rotation_angle
from .records import Array

POSE, POSITION, FREE, PART = range(4)
AXIS = "axis"  # (AXIS, axis) is a kind of target, not of task: a pose of which the turn about a tip axis is free
BASE, TIP, TARGET = range(3)
# What `shape` keeps for `count_column`, by place. A column (u, v) counts as L (u + v x arm), A v; the target's, where it moves
# with another tip, as L (u + v x ARM_GOAL), B v; three rows each of L, A and B, and the errors themselves.
L, A, B, ARM, ARM_GOAL, ERROR, KEPT = 0, 9, 18, 27, 30, 33, 39
STRAIGHT = 1e-9  # sine of the angle below which two directions are parallel, and their cross product says nothing


@compiled
class Part(NamedTuple):
    """A `Task` in its flat array."""

    task: Array

    def kind(self):
        return int(self.task[0])

    def in_axes_of(self):
        """BASE, TIP or TARGET."""
        return int(self.task[1])

    def relative(self):
        """Number of the tip that the target is relative to, -1: none."""
        return int(self.task[2])

    def axis(self):
        return at3(self.task, 3)

    def free_turn(self):
        """Whether the turn about the axis is free."""
        return abs(self.task[3]) + abs(self.task[4]) + abs(self.task[5]) > 0.0

    def weight(self, i):
        return self.task[6 + i]

    def slack(self, i):
        return self.task[12 + i]

    def allowance(self, first, tolerance):
        """Largest norm of the three errors from `first` on that is inside the tolerance; inf when one does not count."""
        least, room = math.inf, 0.0
        for i in range(first, first + 3):
            least = min(least, self.weight(i))
            room += self.slack(i) * self.slack(i)
        return math.sqrt(room) + tolerance / least if least > 0.0 else math.inf


# ------------------------------------------------------------------------------------------------ rotations and derivatives
@inner
def log_curvature(rr):
    """c in the derivative w + 1/2 r x w + c r x (r x w) of a rotation vector r with rr = |r|^2 (its inverse right Jacobian)."""
    if rr < 1e-4:
        return 1.0 / 12.0 + rr / 720.0  # the next term is rr^2 / 30240
    half = 0.5 * math.sqrt(rr)
    return (1.0 - half * math.cos(half) / math.sin(half)) / rr


@inline
def log_rate(r, curvature, v):
    """How r falls when the tip turns by v; with -r the transpose, which says how it grows when the target does."""
    across = r.cross(v)
    return v + across * 0.5 + r.cross(across) * curvature


@inner
def swing(a, b):
    """f and f' (by the cosine) in the least rotation vector f a x b that brings the direction a to b."""
    sine, cosine = math.sqrt(a.cross(b).square()), a.dot(b)
    if sine < STRAIGHT:
        return (1.0, -1.0 / 3.0) if cosine > 0.0 else (-1.0, 0.0)
    ratio = math.atan2(sine, cosine) / sine
    return ratio, (ratio * cosine - 1.0) / (sine * sine)


@inner
def half_turn(a):
    """Half a turn about any axis across the direction a."""
    across = V3(0.0, -a.z, a.y) if abs(a.x) < 0.7 else V3(-a.y, a.x, 0.0)  # 0.7: the longer of two
    return across * (math.pi / math.sqrt(across.square()))


@inline
def swing_rate(a, b, ratio, slope, v):
    """How the rotation vector of `swing` falls when a turns by v; with a and b exchanged the transpose."""
    k = a.cross(b)
    return (v * a.dot(b) - a * b.dot(v)) * ratio - k * (slope * k.dot(v))


# ------------------------------------------------------------------------------------------------------------------- shape
@inline
def beside(x, slack):
    """What of x lies outside the slack."""
    return math.copysign(max(abs(x) - slack, 0.0), x)


@inner
def shape(task, ends, goal, now, linear, angular, kept):
    """Errors that count, of a pose error (angular: 2 sin(angle/2) times the axis); `kept` (KEPT,) is for `count_column`.

    now: axes of the last joint.
    """
    what = Part(task)
    none = V3(0.0, 0.0, 0.0)
    if what.kind() == FREE:
        for k in range(KEPT):
            kept[k] = 0.0
        return none, none
    target = rotation_at(goal, 0)
    frame = what.in_axes_of()
    turns = what.free_turn()
    a, b = now.times(what.axis()), target.times(what.axis())
    ratio, slope = 0.0, 0.0
    if turns:
        ratio, slope = swing(a, b)
        r = half_turn(a) if ratio < 0.0 else a.cross(b) * ratio
    else:
        r = angular * angle_ratio(angular.square())
        ratio = log_curvature(r.square())
    axes = target if frame == TARGET else now
    for i in range(3):
        axis = (
            at3(ends.flat, 3 * i)
            if frame == BASE
            else axes.times(V3(ends.flat[12 + i], ends.flat[15 + i], ends.flat[18 + i]))
        )
        if turns:
            own, others = swing_rate(b, a, ratio, slope, axis), swing_rate(a, b, ratio, slope, axis)
        else:
            own, others = log_rate(-r, ratio, axis), log_rate(r, ratio, axis)
        across = r.cross(axis)
        if frame == TIP:
            own = own + across
        if frame == TARGET:
            others = others - across
        e, turn = beside(axis.dot(linear), what.slack(i)), beside(axis.dot(r), what.slack(3 + i))
        w, v = what.weight(i), what.weight(3 + i)
        kept[ERROR + i], kept[ERROR + 3 + i] = w * e, v * turn
        w, v = w if e != 0.0 else 0.0, v if turn != 0.0 else 0.0
        put3(kept, L + 3 * i, axis * w)
        put3(kept, A + 3 * i, own * v)
        put3(kept, B + 3 * i, others * v)
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
    """The same of a target that moves with another tip: how the error grows."""
    linear = linear + angular.cross(at3(kept, ARM_GOAL))
    return rows_at(kept, L).across(linear), rows_at(kept, B).across(angular)


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
    what = Part(task)
    position, rotation = 0.0, 0.0
    for i in range(3):
        if what.weight(i) > 0.0 and what.slack(i) < math.inf:
            position = 1.0
        if what.weight(3 + i) > 0.0 and what.slack(3 + i) < math.pi and not what.free_turn():
            rotation = 1.0
    return position, rotation
