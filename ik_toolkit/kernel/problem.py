"""What a search runs on: one tip (`serial.Serial`) or several with shared joints (`tree.TreeProblem`). Both answer the same calls.

    aim(T, orders)     take a target: by how much it is out of reach [kernel units], -1 when it is not a pose
    evaluate(q)        the errors there, as a look: e.ee the squared norm of all of them, e.good inside the tolerances
    stand(q), see()    the same in two parts, for several targets at one q
    jacobian(look)     fill J (n, m), one joint a row, linear part first, six columns a tip
    damped(look, x)    the step dq = W J'(J W J' + x)^-1 e
    toward(y, x)       the same step for errors y (m,) of the caller's
    width()            m, where it is known at compile time as a constant
    pseudo(look, r)    the step dq = pinv(J) e; singular values below r times the largest count as zero
    stack(look)        errors y (m,), rotations as rotation vectors, for rules written with J and e
    slope(look, i)     J_i e
    norm, inside, best_move, try_out, undo    for rules that move one joint after the other
    rank, begin, draw  starts
    head_for(T)        take a target of a tracker, T (F, 4, 4), as it is
    plain()            whether whole poses and positions in the base's axes are all that counts
    base_axes(y, out)  errors y (m,) of `stack` in base axes, lengths in m (where a part counts: along its own axes)
    moving(V, out)     a twist, or acceleration, of the targets V (m,) [base axes, m] as it counts, in kernel units
    mirrors(out)       (F, 3) for tips that may turn about an axis: the normal of the mirror that lays the free row last
    bending(look, x, y, out)  (dJ/dt along x) y, where `plain`; J as filled last
    keep, left, report errors of the answer

A record holds views of the flat arrays and scratch; it is made once a call and never leaves inlined code.
"""

from typing import NamedTuple

import numpy as np

from ..compile.array_view import cut
from ..compile.jit import compiled, inline, spliced
from .algebra import V3, at3, chord, put3, rotation_at
from .checks import ORTHONORMAL, beyond, edge, rigid
from .counted_error import FREE, PART, POSE, POSITION, count_column, count_goal_column, shape
from .kinematics import aim, column, fk, pose_error
from .records import WHAT, Array

GOAL = 15  # numbers of a goal: pose (12), and its point again where the search aims at the edge of the reach instead
BEST_OF_ALL, NEAREST, NOW = 0, 1, 2  # places to keep errors: the least, those of the answer nearest q0, any others


@compiled
class Desk(NamedTuple):
    """Scratch of a search over n coordinates and m errors of F tips."""

    q: Array  # (n,) current coordinates
    dq: Array  # (n,) the step
    start: Array  # (n,) q0, or home
    w: Array  # (n,) joint weights; 0 holds a joint in this step
    x: Array  # (4 n + 8,) memory of the rule, zeroed at the start of an attempt
    J: Array  # (n, m)
    A: Array  # (m, m)
    y: Array  # (m,)
    e: Array  # (m,) errors of several tips, as they are minimised
    spent: Array  # (2,) evaluations made, and how many are allowed
    errors: Array  # (3, F, 2) squared errors kept, see BEST_OF_ALL; position, rotation

    def affords(self, evaluations):
        """Whether a rule may make this many evaluations with one left for the search itself."""
        return self.spent[0] + evaluations < self.spent[1]


@spliced
def make_desk(block, n, m):
    """Scratch for n coordinates and m errors, cut from a block."""
    s = Desk(*cut(block, np.float64, (n, n, n, n, 4 * n + 8, (n, m), (m, m), m, m, 2, (3, m // 6, 2))))
    for i in range(n):
        for k in range(m):
            s.J[i, k] = 0.0
    s.spent[0], s.spent[1] = 0.0, 0.0
    return s


@inline
def tolerances(orders, kind, scale):
    """Squared tolerances of position and rotation, as the errors of a kind of task are measured."""
    tol_p = orders.tol_p / scale
    return tol_p * tol_p, orders.tol_r * orders.tol_r if kind == PART else chord(orders.tol_r)


@inline
def take(T, ends, task, goal, orders):
    """Write a target to goal (GOAL,). Returns by how much it is out of reach, -1 when it is not a pose."""
    if not rigid(T, ORTHONORMAL):
        return -1.0
    aim(ends, T, goal)
    put3(goal, 12, at3(goal, 9))
    excess = beyond(goal, ends, task, orders.tol_p / ends.scale(), orders.tol_r)
    if excess > 0.0 and int(task[WHAT.kind]) < FREE:  # there the damping vanishes and the search is fast
        edge(goal, ends, excess)
    return excess


@inline
def from_target(goal, linear):
    """Position error measured from the target itself, not from the edge of the reach. (Where a part counts they are one.)"""
    return linear + (at3(goal, 12) - at3(goal, 9))


@inline
def tip_at(rows, ends, q, joints, trig):
    """Axes of the last joint, and the tip, of one chain at q."""
    now = fk(rows, q, joints, trig)
    return now.axes, now.point + now.axes.times(at3(ends.flat, 21))


@inline
def errors_at(task, ends, goal, kept, axes, tip):
    """Errors (linear, angular) that count."""
    linear, angular = pose_error(goal, axes, tip)
    kind = int(task[WHAT.kind])
    if kind == POSE:
        return linear, angular
    if kind == POSITION:
        return linear, V3(0.0, 0.0, 0.0)
    return shape(task, ends, goal, axes, linear, angular, kept)


@inline
def counted(kind, kept, linear, angular):
    """A column of the tip as its errors count."""
    if kind == POSE:
        return linear, angular
    if kind == POSITION:
        return linear, V3(0.0, 0.0, 0.0)
    return count_column(kept, linear, angular)


@inline
def counted_goal(kind, kept, linear, angular):
    """A motion of the target as its errors count."""
    if kind == PART:
        return count_goal_column(kept, linear, angular)
    return counted(kind, kept, linear, angular)


@inline
def fill(rows, own, task, kept, joints, tip, J, first):
    """Write the columns of one chain to J[:, first : first + 6]; where not each row is its `own` coordinate, they add up."""
    kind = int(task[WHAT.kind])
    if not own:
        for i in range(J.shape[0]):
            for k in range(first, first + 6):
                J[i, k] = 0.0
    for i in range(rows.shape[0]):
        u, v = column(rows, joints, i, tip)
        u, v = counted(kind, kept, u, v)
        if own:
            J[i, first], J[i, first + 1], J[i, first + 2] = u.x, u.y, u.z
            J[i, first + 3], J[i, first + 4], J[i, first + 5] = v.x, v.y, v.z
        else:
            add_column(J, int(rows[i, 8]), first, rows[i, 4] + rows[i, 6], u, v)


@inline
def add_column(J, i, first, ratio, u, v):
    """Add ratio times (u, v) to J[i, first : first + 6]."""
    J[i, first] += ratio * u.x
    J[i, first + 1] += ratio * u.y
    J[i, first + 2] += ratio * u.z
    J[i, first + 3] += ratio * v.x
    J[i, first + 4] += ratio * v.y
    J[i, first + 5] += ratio * v.z


# ------------------------------------------------------------------------------------------------------- for the tracker
@inline
def to_base(ends, task, y, out):
    """Errors y (6,) of `stack` as they are reported: base axes and metres; where a part counts, its own axes."""
    linear, angular = at3(y, 0) * ends.scale(), at3(y, 3)
    if int(task[WHAT.kind]) < FREE:
        base = rotation_at(ends.flat, 0)
        linear, angular = base.times(linear), base.times(angular)
    put3(out, 0, linear)
    put3(out, 3, angular)


@inline
def local_motion(ends, task, kept, V, out):
    """Twist or acceleration V (6,) of a target, base axes [m, rad], as it counts: first joint's axes, kernel units."""
    base = rotation_at(ends.flat, 0)
    u, v = base.across(at3(V, 0)) * (1.0 / ends.scale()), base.across(at3(V, 3))
    u, v = counted_goal(int(task[WHAT.kind]), kept, u, v)
    put3(out, 0, u)
    put3(out, 3, v)
