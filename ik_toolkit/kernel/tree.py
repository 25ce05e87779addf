"""The problem of several tips that share joints. Its methods are described in problem.py.

Each tip has a chain of its own, whose rows say by index which shared coordinate moves a joint. A joint that is common to two
chains is evaluated once in each chain, which is cheaper than keeping account of a tree. The errors are stacked, six for each tip.
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.array_view import cut, fold
from ..compile.jit import compiled, inner, spliced
from .algebra import V3, at3, product, put3, put_axes, rotation_at, transposed
from .checks import RIGID, rigid
from .counted_error import IN, KIND, TipState, add_curvature, angle_left, turn_axis, vector_ratio
from .kinematics import aim, jacobian_rate, room
from .linalg import damped_stack, pseudo_inverse_step
from .problem import (
    GOAL,
    Desk,
    errors_at,
    fill,
    from_target,
    local_motion,
    make_desk,
    take,
    tip_at,
    to_base,
    tolerances,
)
from .records import SIZE, WHAT, Array, Ends, Miss, Orders, write
from .relative import FRAME, LINK, add_goal_curvature, carry, fill_goal, link_to
from .starts import begin_each_tip, choose_moves, draw_some, rank_groups
from .vectors import clear, dot

# A tip with a squared error [rad^2 or squared arm reaches] below this counts as arrived, and mostly keeps its joints in the next
# random start.
ARRIVED = 1e-4


@compiled
class Looks(NamedTuple):
    """The errors of all tips, summed up in two numbers; the single errors are in the arrays of the TreeProblem."""

    ee: float  # squared norm of all errors
    good: bool  # whether all errors are inside the tolerances


@compiled
class TreeProblem(NamedTuple):
    """The search problem of F tips over n shared coordinates.

    Arrays that are not explained here are those of `Serial`, one for each tip.
    """

    desk: Desk
    rows: Array  # (L, 10) geometry of all chains, one after the other
    ends: Array  # (F, ...) base, tip and limits of each tip, see `records.Ends`
    tasks: Array  # (F, SIZE.task) which part of each tip's error counts, see `records.Task`
    cut: Array  # (F + 1,) indices at which the chains begin in `rows`: chain f is rows[cut[f] : cut[f + 1]]
    moves: Array  # (F, n) 1 if the coordinate changes a counted error of the tip, else 0
    choosers: Array  # (2, n) index of the tip that chooses a coordinate's start (-1: none), and how many tips the coordinate moves
    goals: Array  # (F, GOAL) the target of each tip
    links: Array  # (F, LINK) targets that are relative to another tip, see `relative.link_to`
    # (F, IN.size) for each tip, matrices that convert its error and its Jacobian columns to what counts of them
    kept: Array
    # (F, GOAL) pose of each tip that the method `stand` has computed last: axes of the last joint by rows, then the tip's position
    poses: Array
    joints: Array  # (6 L,) axis and point of each joint
    trig: Array  # angles, sines and cosines of the joints of one chain at a time
    # (F, 2) length by which a tip's target is out of reach [arm reaches], and the tip's squared error at the last evaluation
    tips: Array
    orders: Orders
    boxed: bool  # whether joint limits are kept

    def ends_of(self, f):
        """Return base, tip and joint limits of tip f, as `Ends`."""
        return Ends(self.ends[f], self.desk.q.shape[0])

    def rows_of(self, f):
        """Return the geometry (L, 10) of the chain of tip f."""
        return self.rows[self.cut[f] : self.cut[f + 1]]

    def joints_of(self, f):
        """Return axis and point of each joint of the chain of tip f; those of later chains follow in the same array."""
        return self.joints[6 * self.cut[f] :]

    def tolerances_of(self, f):
        """Return the squared tolerances of position and rotation of tip f."""
        return tolerances(self.orders, self.kind_of(f), self.ends_of(f).scale())

    def kind_of(self, f):
        """Return which part of the error of tip f counts, a number of `TargetKinds`."""
        return int(self.tasks[f, WHAT.kind])

    def other_of(self, f):
        """Return the tip that the target of tip f is relative to, or -1."""
        return int(self.tasks[f, WHAT.other])

    def aim(self, T, orders):
        return aim_tips(self, T, orders)

    def place(self, f, q):
        """Compute the pose of tip f at q (n,), and store it as poses[f]."""
        rows = self.rows_of(f)
        trig = self.trig[: room(rows.shape[0])[1]]
        axes, tip = tip_at(rows, self.ends_of(f), q, self.joints_of(f), trig)
        put_axes(self.poses[f], 0, axes)
        put3(self.poses[f], 9, tip)

    def evaluate(self, q):
        self.stand(q)
        return self.see()

    def stand(self, q):
        for f in range(self.tasks.shape[0]):
            self.place(f, q)

    def see(self):
        total, good = 0.0, True
        e = self.desk.e
        for f in range(self.tasks.shape[0]):
            other = self.other_of(f)
            if other >= 0:
                carry(self.poses[other], self.links[f], self.goals[f])
            axes, tip = rotation_at(self.poses[f], 0), at3(self.poses[f], 9)
            linear, angular = errors_at(self.tasks[f], self.ends_of(f), self.goals[f], self.kept[f], axes, tip)
            pp, rr = linear.square(), angular.square()
            tp, tr = self.tolerances_of(f)
            good = good and pp < tp and rr < tr
            total += pp + rr
            put3(e, 6 * f, linear)
            put3(e, 6 * f + 3, angular)
            self.tips[f, 1] = pp + rr
        return Looks(total, good)

    def jacobian(self, look):
        J = self.desk.J
        for f in range(self.tasks.shape[0]):
            task, kept, other = self.tasks[f], self.kept[f], self.other_of(f)
            fill(self.rows_of(f), False, task, kept, self.joints_of(f), at3(self.poses[f], 9), J, 6 * f)
            if other >= 0:
                pose, link = self.poses[other], self.links[f]
                fill_goal(self.rows_of(other), task, kept, self.joints_of(other), pose, link, J, 6 * f)

    def damped(self, look, damping):
        self.toward(self.desk.e, damping)

    def toward(self, y, damping):
        s = self.desk
        damped_stack(s.J, self.moves, s.w, s.dq, y, damping, s.A, s.y)

    def width(self):
        return self.desk.J.shape[1]

    def pseudo(self, look, rcond):
        s = self.desk
        self.stack(look)
        pseudo_inverse_step(s.J, s.y, rcond, s.A, s.dq, s.J.shape[1])

    def stack(self, look):
        e, y = self.desk.e, self.desk.y
        for h in range(0, e.shape[0], 6):
            angular = at3(e, h + 3)
            put3(y, h, at3(e, h))
            put3(y, h + 3, angular * vector_ratio(self.kind_of(h // 6), angular.square()))

    def slope(self, look, i):
        return dot(self.desk.J[i], self.desk.e, self.desk.e.shape[0])

    def norm(self, look, weight):
        total = 0.0
        for h in range(0, self.desk.e.shape[0], 6):
            linear, angular = at3(self.desk.e, h), at3(self.desk.e, h + 3)
            ratio = weight * vector_ratio(self.kind_of(h // 6), angular.square())
            total += linear.square() + ratio * ratio * angular.square()
        return math.sqrt(total)

    def inside(self, i, value):
        ends = self.ends_of(0)
        return min(max(value, ends.lower(i)), ends.upper(i)) if self.boxed else value

    def best_move(self, look, i, least):
        """Return the move of coordinate i alone that minimises the linearised error; 0 if its squared effect is at most `least`."""
        self.jacobian(look)
        self.stack(look)
        J, m = self.desk.J, self.desk.J.shape[1]
        size = dot(J[i], J[i], m)
        return dot(J[i], self.desk.y, m) / size if size > least else 0.0

    def try_out(self, q):
        self.desk.spent[0] += 1.0
        return self.evaluate(q)

    def undo(self, look):
        self.try_out(self.desk.q)

    def head_for(self, T):
        for f in range(self.tasks.shape[0]):
            other = self.other_of(f)
            if other >= 0:
                link_to(T[f], self.ends_of(f), self.ends_of(other), self.links[f])
            else:
                aim(self.ends_of(f), T[f], self.goals[f])
                put3(self.goals[f], 12, at3(self.goals[f], 9))

    def plain(self):
        result = True
        for f in range(self.tasks.shape[0]):
            result = result and self.kind_of(f) < KIND.part and self.tasks[f, WHAT.other] < 0.0
        return result

    def base_axes(self, y, out):
        for f in range(self.tasks.shape[0]):
            to_base(self.ends_of(f), self.tasks[f], y[6 * f :], out[6 * f :])

    def moving(self, V, out):
        for f in range(self.tasks.shape[0]):
            ends, other = self.ends_of(f), self.other_of(f)
            axes = transposed(rotation_at(ends.flat, 0))
            if other >= 0:  # The motion of a target relative to another tip is given in that tip's axes.
                tool = rotation_at(self.ends[other], 12)
                axes = product(rotation_at(self.links[f], FRAME), product(rotation_at(self.poses[other], 0), tool))
            local_motion(axes, ends.scale(), self.tasks[f], self.kept[f], V[6 * f :], out[6 * f :])

    def mirrors(self, out):
        for f in range(self.tasks.shape[0]):
            turn_axis(self.tasks[f], self.kept[f], out[f])

    def bending(self, look, x, y, out):
        for f in range(self.tasks.shape[0]):
            tip = at3(self.poses[f], 9)
            jacobian_rate(self.rows_of(f), self.joints_of(f), self.desk.J, 6 * f, tip, x, y, out[6 * f :])
            kind = self.kind_of(f)
            if kind == KIND.free:
                put3(out, 6 * f, V3(0.0, 0.0, 0.0))
            if kind != KIND.pose:
                put3(out, 6 * f + 3, V3(0.0, 0.0, 0.0))

    def rank(self, table):
        rank_groups(self, table)

    def begin(self, table, k, q):
        begin_each_tip(self, table, k, q)

    def arrived(self, f):
        return self.kind_of(f) != KIND.free and self.tips[f, 1] < ARRIVED

    def draw(self, table, k, q):
        draw_some(self, table, k, q)

    def graded(self, look, ee, good):
        return Looks(ee, good)

    def group(self, look, g):
        return at3(self.desk.e, 3 * g).square()

    def allowed(self, g):
        tp, tr = self.tolerances_of(g // 2)
        return tp if g % 2 == 0 else tr

    def exact(self, excess, level):
        worst = min(excess, 0.0)
        for f in range(self.tasks.shape[0]):
            put3(self.goals[f], 9, at3(self.goals[f], 12))
            if level[2 * f] > 0.0:
                self.tips[f, 0] = 0.0
            worst = max(worst, self.tips[f, 0]) if worst >= 0.0 else worst
        return worst

    def tilt(self, g):
        whole = self.kind_of(g // 2) == KIND.pose and g % 2 == 1
        angle = math.sqrt(at3(self.desk.y, 3 * g).square()) if whole else 0.0
        return math.sin(angle) / angle if angle > 0.0 else 1.0

    def curvature(self, c, least, H):
        s = self.desk
        for f in range(self.tasks.shape[0]):
            rows, joints, other = self.rows_of(f), self.joints_of(f), self.other_of(f)
            state = TipState(rows, joints, self.tasks[f], self.kept[f], self.goals[f], self.poses[f])
            bend = add_curvature(state, s.J, 6 * f, s.y, c, least[2 * f :], H)
            if other >= 0:
                pose, link = self.poses[other], self.links[f]
                add_goal_curvature(rows, joints, self.rows_of(other), self.joints_of(other), pose, link, bend, H)

    def bounds_of_step(self):
        return self.ends_of(0)

    def keep(self, look, place):
        e, errors = self.desk.e, self.desk.errors
        for f in range(self.tasks.shape[0]):
            # A tip without a target has its pose at the start as its goal, but its distance from there does not count as an error.
            free = self.kind_of(f) == KIND.free
            errors[place, f, 0] = 0.0 if free else from_target(self.goals[f], at3(e, 6 * f)).square()
            errors[place, f, 1] = at3(e, 6 * f + 3).square()

    def left_at(self, place, f):
        """Return the position error [m] and rotation error [rad] of tip f stored at index `place` of `Desk.errors`."""
        errors = self.desk.errors
        position = math.sqrt(errors[place, f, 0]) * self.ends_of(f).scale()
        return position, angle_left(self.kind_of(f), errors[place, f, 1])

    def left(self, place):
        return left_of_all(self, place)

    def report(self, place, row):
        report_tips(self, place, row)


# ----------------------------------------- These run once per target, so they are compiled once and called, not inlined.
@inner
def aim_tips(p, T, orders):
    """Set the targets T (F, 4, 4) of all tips of a TreeProblem p.

    Returns the largest length [arm reaches] by which a target is out of reach, or -1 if one is not a pose. orders: `Orders`.
    """
    worst = 0.0
    for f in range(p.tasks.shape[0]):
        other = p.other_of(f)
        if other >= 0:  # A target that moves with another tip cannot be proven out of reach.
            if not rigid(T[f], RIGID.axes):
                return -1.0
            link_to(T[f], p.ends_of(f), p.ends_of(other), p.links[f])
            excess = 0.0
        else:
            excess = take(T[f], p.ends_of(f), p.tasks[f], p.goals[f], orders)
        if excess < 0.0:
            return -1.0
        p.tips[f, 0] = excess
        worst = max(worst, excess)
    return worst


@inner
def left_of_all(p, place):
    """Return the largest position error [m] and rotation error [rad] of all tips of p stored at index `place` of `Desk.errors`."""
    position, rotation = 0.0, 0.0
    for f in range(p.tasks.shape[0]):
        linear, angle = p.left_at(place, f)
        position, rotation = max(position, linear), max(rotation, angle)
    return position, rotation


@inner
def report_tips(p, place, row):
    """Write the errors of each tip of p to the end of a row of results, as a `Miss` each.

    They are those stored at index `place` of `Desk.errors`.
    """
    for f in range(p.tasks.shape[0]):
        position, rotation = p.left_at(place, f)
        excess = p.tips[f, 0] * p.ends_of(f).scale()
        write(row, row.shape[0] - SIZE.miss * (p.tasks.shape[0] - f), Miss(position, rotation, excess))


@spliced
def tree_on(block, rows, ends, tasks, n, orders):
    """Return the problem of several tips, with its scratch arrays cut from the memory `block`.

    A row of `ends` is `records.Ends` of a tip, then its number of rows, then n flags: 1 if the coordinate moves the tip, else 0.
    rows: (L, 10) geometry of all chains; tasks: the fields of a `Task` for each tip, one after the other; orders: `Orders`.
    """
    F = ends.shape[0]
    size, angles = room(rows.shape[0])
    each = fold(tasks, np.float64, F, SIZE.task)
    (first,) = cut(block, np.int64, (F + 1,))
    moves, choosers, goals, links, kept, poses, joints, trig, tips, asked = cut(
        block, np.float64, ((F, n), (2, n), (F, GOAL), (F, LINK), (F, IN.size), (F, GOAL), size, angles, (F, 2), F)
    )
    first[0] = 0
    for f in range(F):
        first[f + 1] = first[f] + int(ends[f, ends.shape[1] - n - 1])
        tips[f, 0], tips[f, 1] = np.inf, np.inf
    # `trig` is longer than needed, and the sines of these unused numbers are computed as well, so they must be valid.
    clear(trig)
    choose_moves(ends, each, n, asked, moves, choosers)
    boxed = orders.limits > 0.0 or orders.follow > 0.0
    desk = make_desk(block, n, 6 * F)
    return TreeProblem(
        desk, rows, ends, each, first, moves, choosers, goals, links, kept, poses, joints, trig, tips, orders, boxed
    )
