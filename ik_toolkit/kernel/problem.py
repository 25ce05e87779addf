"""What a search solves: the problem of one tip (`serial.Serial`), or of several tips with shared joints (`tree.TreeProblem`).

Both have the same methods, so solver rules and loops are written once. Lengths inside are divided by the arm's reach.

    aim(T, orders)     take a target; returns the length by which it is out of reach [arm reaches], -1 if it is not a pose
    evaluate(q)        return the errors at q as a record e: e.ee is their squared norm, e.good says if they are in tolerance
    stand(q), see()    do the two halves of `evaluate`: compute the pose at q, then its errors (for several targets in turn)
    jacobian(look)     fill J (n, m): one joint a row, six columns a tip, linear part first; look: errors from `evaluate`
    damped(look, x)    write the step dq = W J'(J W J' + x)^-1 e
    toward(y, x)       write that damped step for given errors y (m,) in place of e
    width()            return m, as a constant where it is known at compile time
    pseudo(look, r)    write the step dq = pinv(J) e; singular values below r times the largest count as zero
    stack(look)        write the errors y (m,) with rotations as rotation vectors, for rules written with J and e
    slope(look, i)     return J_i e, the fall of the error along coordinate i
    norm, inside, best_move, try_out, undo    serve rules that move one joint after the other
    rank, begin, draw  choose where attempts start
    head_for(T)        take the target T (F, 4, 4) of a tracker, even if it is out of reach
    plain()            return whether every target is a whole pose or a position alone (with several tips: or free), in base axes
    base_axes(y, out)  convert errors y (m,) of `stack` to base axes and metres; if only a part counts, they stay in the task's axes
    moving(V, out)     convert a twist, or acceleration, of the targets V (m,) [base axes, m] to the errors that count
    mirrors(out)       write (F, 3) normals of reflections; with a free turn, a tip's reflection makes its last rotation error 0
    bending(look, x, y, out)  write (dJ/dt) y at joint rates x, for the J that was filled last; only where `plain`
    graded(look, ee, good)    return the errors with another value of `ee` and `good`, see levels.py
    group(look, g), allowed(g)  return the squared error of group g and its tolerance; position and rotation of a tip are groups
    exact(x, level)    aim at the targets themselves, not at the edge of the reach; return x, by how much level 0 is out of reach
    tilt(g)            return sin(angle) / angle of a rotation measured by 2 sin(angle/2), else 1; needs `stack`
    curvature(c, least, H)  add second derivatives of the errors to H, see `counted_error.add_curvature`; needs J and `stack`
    bounds_of_step()   return the limits of a step (Ends)
    keep, left, report store and return the errors of the answer

A problem holds views of the flat arrays and of scratch memory. It is made once in each compiled call and exists only in inlined
code.
"""

from typing import NamedTuple

import numpy as np

from ..compile.array_view import cut
from ..compile.jit import compiled, inline, spliced
from .algebra import V3, at3, chord, put3, rotation_at
from .checks import RIGID, beyond, edge, rigid
from .counted_error import KIND, count_column, count_goal_column, shape
from .kinematics import aim, column, fk, pose_error
from .records import WHAT, Array

# Length of a goal, the array that holds a target: the pose that the search aims at (12), then the target's own position (3). The
# two positions differ if the target is out of reach.
GOAL = 15
# Indices at which errors are stored in `Desk.errors`: those of the best attempt, of the solution nearest q0, and of the
# configuration evaluated last.
BEST_OF_ALL, NEAREST, NOW = 0, 1, 2


@compiled
class Desk(NamedTuple):
    """Working memory of a search over n coordinates and m errors of F tips; lengths are divided by the arm's reach."""

    q: Array  # (n,) current coordinates
    dq: Array  # (n,) joint step computed by the solver rule (the iterative method)
    start: Array  # (n,) where the search starts: q0, or home if no q0 is given
    w: Array  # (n,) joint weights; a weight of 0 holds the joint in this step
    x: Array  # (4 n + 8,) internal state of the solver rule, set to zero when an attempt starts
    J: Array  # (n, m) transposed Jacobian
    A: Array  # (m, m) scratch for a matrix over the errors
    y: Array  # (m,) errors of the step, with rotations as rotation vectors
    # (m,) for several tips only: the errors whose sum of squares is minimised, rotations as 2 sin(angle/2) times the axis
    e: Array
    # (3,) number of evaluations made, number allowed, and number of the attempt (with levels its phase, see `level_search.Phases`)
    spent: Array
    tables: Array  # (8, k, k) scratch for matrices over the coordinates or the errors; k is the largest of n, m and 11
    errors: Array  # (3, F, 2) stored squared errors (position, rotation) of each tip, for BEST_OF_ALL, NEAREST and NOW

    def affords(self, evaluations):
        """Return whether enough evaluations are left for this number by a solver rule, and one more by the search itself."""
        return self.spent[0] + evaluations < self.spent[1]


@spliced
def make_desk(block, n, m):
    """Return the working memory (Desk) for n coordinates and m errors, cut from the memory `block`."""
    k = max(n, m, 11)
    sizes = (n, n, n, n, 4 * n + 8, (n, m), (m, m), m, m, 3, (8, k, k), (3, m // 6, 2))
    s = Desk(*cut(block, np.float64, sizes))
    for i in range(n):
        for k in range(m):
            s.J[i, k] = 0.0
    s.spent[0], s.spent[1], s.spent[2] = 0.0, 0.0, 0.0
    return s


@inline
def tolerances(orders, kind, scale):
    """Return the squared tolerances of position [arm reaches] and rotation for targets of a kind of `TargetKinds`.

    Rotations are measured by 2 sin(angle/2), or by the angle [rad] if only a part of the error counts. orders: an `Orders`; scale:
    internal unit of length [m].
    """
    tol_p = orders.tol_p / scale
    return tol_p * tol_p, orders.tol_r * orders.tol_r if kind == KIND.part else chord(orders.tol_r)


@inline
def take(T, ends, task, goal, orders):
    """Write a target T (4, 4) [m, base axes] to goal (GOAL,), in the frame and the units of the search.

    Returns the length [arm reaches] by which the target is proven out of reach, -1 if T is not a pose. ends: `Ends`; task: the
    fields of a `Task`; orders: an `Orders`.
    """
    if not rigid(T, RIGID.axes):
        return -1.0
    aim(ends, T, goal)
    put3(goal, 12, at3(goal, 9))
    excess = beyond(goal, ends, task, orders.tol_p / ends.scale(), orders.tol_r)
    # A target out of reach is moved to the edge of the reach, because the search is fast only at reachable points.
    if excess > 0.0 and int(task[WHAT.kind]) < KIND.free:
        edge(goal, ends, excess)
    return excess


@inline
def from_target(goal, linear):
    """Return a position error measured from the target itself, given one, `linear`, measured from the point the search aims at.

    The two points differ if the search aims at the edge of the reach, which it never does if only a part of the error counts. goal:
    (GOAL,) target.
    """
    return linear + (at3(goal, 12) - at3(goal, 9))


@inline
def tip_at(rows, ends, q, joints, trig):
    """Return the axes of the last joint (M3) and the position of the tip (V3) of one chain at q (n,).

    rows: (L, 10) geometry; ends: `Ends`; joints, trig: filled by `kinematics.fk`.
    """
    now = fk(rows, q, joints, trig)
    return now.axes, now.point + now.axes.times(at3(ends.flat, 21))


@inline
def errors_at(task, ends, goal, kept, axes, tip):
    """Return the part of a tip's pose error (linear, angular) that counts.

    task: the fields of a `Task`, which say what counts; ends: `Ends`; goal: (GOAL,) target; kept: (IN.size,) is filled by `shape`;
    axes (M3), tip (V3): from `tip_at`.
    """
    linear, angular = pose_error(goal, axes, tip)
    kind = int(task[WHAT.kind])
    if kind == KIND.pose:
        return linear, angular
    if kind == KIND.position:
        return linear, V3(0.0, 0.0, 0.0)
    return shape(task, ends, goal, axes, linear, angular, kept)


@inline
def counted(kind, kept, linear, angular):
    """Return a column (linear, angular) of the tip's Jacobian, converted to the components of the error that count.

    kind: a number of `TargetKinds`; kept: (IN.size,) as `shape` has filled it.
    """
    if kind == KIND.pose:
        return linear, angular
    if kind == KIND.position:
        return linear, V3(0.0, 0.0, 0.0)
    return count_column(kept, linear, angular)


@inline
def counted_goal(kind, kept, linear, angular):
    """Return by how much a small motion (linear, angular) of the target changes the errors that count.

    kind: a number of `TargetKinds`; kept: (IN.size,) as `shape` has filled it.
    """
    if kind == KIND.part:
        return count_goal_column(kept, linear, angular)
    return counted(kind, kept, linear, angular)


@inline
def fill(rows, own, task, kept, joints, tip, J, first):
    """Write the transposed Jacobian of one chain to the six columns J[:, first : first + 6].

    own: whether row i of the chain belongs to coordinate i alone, for all rows; otherwise several rows may belong to one
    coordinate, and their columns are added. rows: (L, 10) geometry; task, kept: as for `errors_at`; joints: as `kinematics.fk`
    fills it; tip (V3): position of the tip.
    """
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
    """Add `ratio` times the vectors u and v to J[i, first : first + 6], the numbers of joint i in one tip's Jacobian."""
    J[i, first] += ratio * u.x
    J[i, first + 1] += ratio * u.y
    J[i, first + 2] += ratio * u.z
    J[i, first + 3] += ratio * v.x
    J[i, first + 4] += ratio * v.y
    J[i, first + 5] += ratio * v.z


# ------------------------------------------------------------------------------------------------------- for the tracker
@inline
def to_base(ends, task, y, out):
    """Write to out (6,) the errors y (6,) of one tip from `stack`, converted to base axes and metres.

    If only a part of the error counts, they stay in the task's axes. ends: `Ends`; task: the fields of a `Task`.
    """
    linear, angular = at3(y, 0) * ends.scale(), at3(y, 3)
    if int(task[WHAT.kind]) < KIND.free:
        base = rotation_at(ends.flat, 0)
        linear, angular = base.times(linear), base.times(angular)
    put3(out, 0, linear)
    put3(out, 3, angular)


@inline
def local_motion(axes, scale, task, kept, V, out):
    """Convert a twist or acceleration V (6,) of a target [m, rad] to a rate of the errors that count, and write it to out (6,).

    The result's lengths are over the arm's reach; its axes are the first joint's, or the task's if only a part of the error counts.
    axes (M3): turns the axes of V into those of the first joint; scale: internal unit of length [m]; task, kept: as for
    `errors_at`.
    """
    u, v = axes.times(at3(V, 0)) * (1.0 / scale), axes.times(at3(V, 3))
    u, v = counted_goal(int(task[WHAT.kind]), kept, u, v)
    put3(out, 0, u)
    put3(out, 3, v)
