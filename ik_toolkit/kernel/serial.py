"""The problem of one tip. Its methods are described in problem.py."""

import math
from typing import NamedTuple

import numpy as np

from ..compile.array_view import cut, space
from ..compile.jit import build, compiled, spliced
from .algebra import V3, at3, put3, put_axes, rotation_at, transposed
from .counted_error import IN, KIND, TipState, add_curvature, angle_left, counts, turn_axis, vector_ratio
from .kinematics import aim, column, jacobian_rate, own_coordinates, room
from .linalg import damped, pseudo_inverse_step
from .problem import (
    GOAL,
    Desk,
    counted,
    errors_at,
    fill,
    from_target,
    local_motion,
    make_desk,
    take,
    tip_at,
    to_base,
    tolerances,
)  # fmt: skip
from .records import SIZE, WHAT, Array, Ends
from .starts import nearest_seeds, rnd
from .vectors import clear


@compiled
class Look(NamedTuple):
    """Errors of one tip at a configuration, with lengths divided by the arm's reach.

    They are expressed in the frame of the first joint or, if only a part of the error counts, in the axes that the `Task` names.
    """

    point: V3  # position of the tip
    linear: V3  # position error: target - tip
    angular: V3  # rotation error: 2 sin(angle/2) times the axis, or the rotation vector if only a part of it counts
    ee: float  # squared norm of all errors
    good: bool  # whether the errors are inside the tolerances


@compiled
class Serial(NamedTuple):
    """The search problem of one tip: geometry, target, which part of the error counts, and the last evaluation."""

    desk: Desk
    rows: Array  # (L, 10) geometry of the chain, see kinematics.py
    ends: Ends  # base, tip and joint limits of a step
    task: Array  # (SIZE.task,) which part of the error counts, see `records.Task`
    goal: Array  # (GOAL,) the target
    kept: Array  # (IN.size,) matrices that `counted_error.shape` computes and `count_column` uses, see `KeptIndices`
    # (12,) pose that the method `stand` has computed last: axes of the last joint by rows, then the tip's position
    pose: Array
    joints: Array  # (6 L,) axis and point of each joint
    trig: Array  # angles, sines and cosines of the joints
    tp: float  # squared position tolerance
    tr: float  # squared rotation tolerance
    boxed: bool  # whether joint limits are kept
    own: bool  # whether row i of the chain moves coordinate i alone, so that there are no mimic joints

    def aim(self, T, orders):
        return take(T, self.ends, self.task, self.goal, orders)

    def evaluate(self, q):
        axes, tip = tip_at(self.rows, self.ends, q, self.joints, self.trig)
        return self.look(axes, tip)

    def look(self, axes, tip):
        """Return the errors to the target, as a Look, for given axes of the last joint and a given position of the tip."""
        linear, angular = errors_at(self.task, self.ends, self.goal, self.kept, axes, tip)
        pp, rr = linear.square(), angular.square()
        return Look(tip, linear, angular, pp + rr, pp < self.tp and rr < self.tr)

    def stand(self, q):
        axes, tip = tip_at(self.rows, self.ends, q, self.joints, self.trig)
        put_axes(self.pose, 0, axes)
        put3(self.pose, 9, tip)

    def see(self):
        return self.look(rotation_at(self.pose, 0), at3(self.pose, 9))

    def jacobian(self, look):
        fill(self.rows, self.own, self.task, self.kept, self.joints, look.point, self.desk.J, 0)

    def damped(self, look, damping):
        damped(self.desk.J, self.desk.w, self.desk.dq, look.linear, look.angular, damping)

    def toward(self, y, damping):
        damped(self.desk.J, self.desk.w, self.desk.dq, at3(y, 0), at3(y, 3), damping)

    def width(self):
        return 6

    def pseudo(self, look, rcond):
        s = self.desk
        self.stack(look)
        pseudo_inverse_step(s.J, s.y, rcond, s.A, s.dq, 6)

    def stack(self, look):
        y = self.desk.y
        turn = look.angular * vector_ratio(int(self.task[WHAT.kind]), look.angular.square())
        y[0], y[1], y[2] = look.linear.x, look.linear.y, look.linear.z
        y[3], y[4], y[5] = turn.x, turn.y, turn.z

    def slope(self, look, i):
        J = self.desk.J
        return V3(J[i, 0], J[i, 1], J[i, 2]).dot(look.linear) + V3(J[i, 3], J[i, 4], J[i, 5]).dot(look.angular)

    def norm(self, look, weight):
        """Return the norm of the errors `look`: position error and rotation vector, the latter multiplied by `weight`."""
        ratio = weight * vector_ratio(int(self.task[WHAT.kind]), look.angular.square())
        return math.sqrt(look.linear.square() + ratio * ratio * look.angular.square())

    def inside(self, i, value):
        """Return `value` clipped to the limits of coordinate i."""
        return min(max(value, self.ends.lower(i)), self.ends.upper(i)) if self.boxed else value

    def best_move(self, look, i, least):
        """Return the move of coordinate i alone that minimises the error `look`.

        The move is exact if only the position counts and the joint is revolute, else it minimises the linearised error. It is 0 if
        the coordinate hardly changes the error: if its effect is at most `least`.
        """
        linear, angular = V3(0.0, 0.0, 0.0), V3(0.0, 0.0, 0.0)
        kind = int(self.task[WHAT.kind])
        for r in range(self.rows.shape[0]):
            if int(self.rows[r, 8]) == i:
                u, v = column(self.rows, self.joints, r, look.point)
                ratio = self.rows[r, 4] + self.rows[r, 6]
                linear, angular = linear + u * ratio, angular + v * ratio
        if kind == KIND.position and self.own and self.rows[i, 9] > 0.0:
            axis, point = at3(self.joints, 6 * i), at3(self.joints, 6 * i + 3)
            to, now = at3(self.goal, 9) - point, look.point - point
            side = linear.dot(to)
            ahead = now.dot(to) - now.dot(axis) * to.dot(axis)
            return math.atan2(side, ahead) if abs(side) + abs(ahead) > least else 0.0
        linear, angular = counted(kind, self.kept, linear, angular)
        size = linear.square() + angular.square()
        top = linear.dot(look.linear) + vector_ratio(kind, look.angular.square()) * angular.dot(look.angular)
        return top / size if size > least else 0.0

    def try_out(self, q):
        """Return the errors at q (n,) for a solver rule that tries moves, and count the evaluation towards its budget."""
        self.desk.spent[0] += 1.0
        return self.evaluate(q)

    def undo(self, look):
        """Evaluate at desk.q again, where the caller has put back q after `try_out`, which overwrote what the Jacobian needs."""
        if int(self.task[WHAT.kind]) > KIND.position:
            self.try_out(self.desk.q)

    def head_for(self, T):
        aim(self.ends, T[0], self.goal)
        put3(self.goal, 12, at3(self.goal, 9))

    def plain(self):
        return int(self.task[WHAT.kind]) < KIND.free

    def base_axes(self, y, out):
        to_base(self.ends, self.task, y, out)

    def moving(self, V, out):
        local_motion(transposed(rotation_at(self.ends.flat, 0)), self.ends.scale(), self.task, self.kept, V, out)

    def mirrors(self, out):
        turn_axis(self.task, self.kept, out[0])

    def bending(self, look, x, y, out):
        jacobian_rate(self.rows, self.joints, self.desk.J, 0, look.point, x, y, out)
        if int(self.task[WHAT.kind]) == KIND.position:
            put3(out, 3, V3(0.0, 0.0, 0.0))

    def rank(self, table):
        wp, wr = counts(self.task)
        nearest_seeds(table.features, self.goal, wp, wr, table.score, table.val, table.best)

    def begin(self, table, k, q):
        for i in range(q.shape[0]):
            q[i] = table.seeds[table.best[k], i]

    def draw(self, table, k, q):
        for i in range(q.shape[0]):
            q[i] = self.ends.low(i) + self.ends.span(i) * rnd(table.state)

    def graded(self, look, ee, good):
        return Look(look.point, look.linear, look.angular, ee, good)

    def group(self, look, g):
        return look.linear.square() if g == 0 else look.angular.square()

    def allowed(self, g):
        return self.tp if g == 0 else self.tr

    def exact(self, excess, level):
        put3(self.goal, 9, at3(self.goal, 12))
        return excess if level[0] == 0.0 else min(excess, 0.0)

    def tilt(self, g):
        whole = int(self.task[WHAT.kind]) == KIND.pose and g % 2 == 1
        angle = math.sqrt(at3(self.desk.y, 3).square()) if whole else 0.0
        return math.sin(angle) / angle if angle > 0.0 else 1.0

    def curvature(self, c, least, H):
        state = TipState(self.rows, self.joints, self.task, self.kept, self.goal, self.pose)
        add_curvature(state, self.desk.J, 0, self.desk.y, c, least, H)

    def bounds_of_step(self):
        return self.ends

    def keep(self, look, place):
        """Store the errors of an evaluation (Look) at index `place`, measured from the target, not from the edge of the reach."""
        errors = self.desk.errors
        errors[place, 0, 0] = from_target(self.goal, look.linear).square()
        errors[place, 0, 1] = look.angular.square()

    def left(self, place):
        """Return the position error [m] and rotation error [rad] that were stored at index `place`."""
        errors = self.desk.errors
        position = math.sqrt(errors[place, 0, 0]) * self.ends.scale()
        return position, angle_left(int(self.task[WHAT.kind]), errors[place, 0, 1])

    def report(self, place, row):
        """Do nothing: the result row of a problem with one tip already holds all its errors, in the `Answer` at its start."""


@spliced
def serial_on(block, rows, ends, tasks, n, orders):
    """Return the problem of one tip, with its scratch arrays cut from the memory `block`.

    rows: (L, 10) geometry; ends: the array of a `records.Ends`; tasks: array that begins with a `Task`; n: number of coordinates;
    orders: an `Orders`.
    """
    box = Ends(ends, n)
    size, angles = room(rows.shape[0])
    tp, tr = tolerances(orders, int(tasks[WHAT.kind]), box.scale())
    goal, kept, pose, joints, trig = cut(block, np.float64, (GOAL, IN.size, 12, size, angles))
    # `trig` is longer than needed, and the sines of these unused numbers are computed as well, so they must be valid.
    clear(trig)
    boxed = orders.limits > 0.0 or orders.follow > 0.0
    desk, task, own = make_desk(block, n, 6), tasks[: SIZE.task], own_coordinates(rows, n)
    return Serial(desk, rows, box, task, goal, kept, pose, joints, trig, tp, tr, boxed, own)


@build
def make_serial(rows, ends, tasks, n, orders):
    """Return the problem of one tip, with scratch arrays of its own, for code that works on arrays instead of views.

    The arguments are those of `serial_on`.
    """
    block = np.empty(space(n, 6, rows.shape[0], 0))
    block[0] = 0.0
    return serial_on(block, rows, ends, tasks, n, orders)
