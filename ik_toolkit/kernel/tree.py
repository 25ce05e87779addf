"""The problem of several tips that share joints; see problem.py for what each call does.

Each chain's rows name the shared coordinates; joints common to two paths are evaluated once per path (cheaper than
bookkeeping a tree). The errors are stacked, six a tip.
"""

import math
from typing import NamedTuple

import numpy as np

from .algebra import at3, put3
from .jit import build, compiled
from .kinematics import angle_ratio, room
from .linalg import damped_stack, pseudo_inverse_step
from .problem import GOAL, Desk, angle_left, fill, from_target, look_at, make_desk, take, tolerances
from .records import MISS, Array, Ends, Miss, Orders, write
from .seeds import BEST, nearest, rnd
from .task import KEPT, counts

ARRIVED = 1e-4  # squared error (lengths over reach) below which a tip is at its target, near enough to keep its joints


@compiled
class Looks(NamedTuple):
    """Several tips at a configuration; the rest is in the arrays of the Tree."""

    ee: float
    good: bool


@compiled
class Tree(NamedTuple):
    """Several tips over shared coordinates: as Serial for tip f, the rows of all chains one after the other."""

    desk: Desk
    rows: Array
    ends: Array  # (F, ...)
    tasks: Array  # (F, 7)
    cut: Array  # (F + 1,) chain f in rows[cut[f] : cut[f + 1]]
    moves: Array  # (F, n) 1 where a coordinate moves a tip
    goals: Array  # (F, GOAL)
    kept: Array  # (F, KEPT + 3) as of Serial, then the tip
    joints: Array
    trig: Array
    tips: Array  # (F, 2) excess, squared error of the look before
    orders: Orders
    boxed: bool

    def aim(self, T, orders):
        worst = 0.0
        for f in range(self.tasks.shape[0]):
            excess = take(T[f], Ends(self.ends[f], self.desk.q.shape[0]), self.tasks[f], self.goals[f], orders)
            if excess < 0.0:
                return -1.0
            self.tips[f, 0] = excess
            worst = max(worst, excess)
        return worst

    def evaluate(self, q):
        total, good = 0.0, True
        e = self.desk.e
        for f in range(self.tasks.shape[0]):
            ends = Ends(self.ends[f], q.shape[0])
            rows = self.rows[self.cut[f] : self.cut[f + 1]]
            angles = room(rows.shape[0])[1]
            tip, linear, angular = look_at(
                rows, ends, self.tasks[f], self.goals[f], self.kept[f], q, self.joints[6 * self.cut[f] :], self.trig[:angles]
            )  # fmt: skip
            pp, rr = linear.square(), angular.square()
            tp, tr = tolerances(self.orders, int(self.tasks[f, 0]), ends.scale())
            good = good and pp < tp and rr < tr
            total += pp + rr
            put3(e, 6 * f, linear)
            put3(e, 6 * f + 3, angular)
            self.tips[f, 1] = pp + rr
            put3(self.kept[f], KEPT, tip)
        return Looks(total, good)

    def jacobian(self, look):
        for f in range(self.tasks.shape[0]):
            rows, joints = self.rows[self.cut[f] : self.cut[f + 1]], self.joints[6 * self.cut[f] :]
            fill(rows, self.tasks[f], self.kept[f], joints, at3(self.kept[f], KEPT), self.desk.J, 6 * f)

    def damped(self, look, damping):
        s = self.desk
        damped_stack(s.J, self.moves, s.w, s.dq, s.e, damping, s.A, s.y)

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
            put3(y, h + 3, angular * angle_ratio(angular.square()))

    def slope(self, look, i):
        total = 0.0
        for k in range(self.desk.e.shape[0]):
            total += self.desk.J[i, k] * self.desk.e[k]
        return total

    def norm(self, look, weight):
        total = 0.0
        for h in range(0, self.desk.e.shape[0], 6):
            linear, angular = at3(self.desk.e, h), at3(self.desk.e, h + 3)
            ratio = weight * angle_ratio(angular.square())
            total += linear.square() + ratio * ratio * angular.square()
        return math.sqrt(total)

    def inside(self, i, value):
        ends = Ends(self.ends[0], self.desk.q.shape[0])
        return min(max(value, ends.lower(i)), ends.upper(i)) if self.boxed else value

    def best_move(self, look, i, least):
        """The linear step of coordinate i on all errors."""
        self.jacobian(look)
        self.stack(look)
        top, size = 0.0, 0.0
        for k in range(self.desk.y.shape[0]):
            top += self.desk.J[i, k] * self.desk.y[k]
            size += self.desk.J[i, k] * self.desk.J[i, k]
        return top / size if size > least else 0.0

    def try_out(self, q):
        self.desk.spent[0] += 1.0
        return self.evaluate(q)

    def undo(self, look):
        self.try_out(self.desk.q)

    def owner(self, i):
        """The only tip that coordinate i moves, -1 when it is shared."""
        found = -1
        for f in range(self.moves.shape[0]):
            if self.moves[f, i] > 0.0:
                if found >= 0:
                    return -1
                found = f
        return found

    def rank(self, table):
        """Best row of each tip in each interleaved group of rows, the groups in order of the sum of their scores."""
        for g in range(BEST):
            table.total[g] = 0.0
        for f in range(self.tasks.shape[0]):
            wp, wr = counts(int(self.tasks[f, 0]), self.tasks[f, 1:7])
            nearest(table.features[f], self.goals[f], wp, wr, table.score, table.val, table.best)
            for k in range(BEST):
                g = table.best[k] % BEST
                table.choice[g, f] = table.best[k]
                table.total[g] += table.val[k]
        for k in range(BEST):  # table.best: the groups, best first
            first = 0
            for g in range(BEST):
                if table.total[g] < table.total[first]:
                    first = g
            table.best[k] = first
            table.total[first] = np.inf

    def begin(self, table, k, q):
        for i in range(q.shape[0]):
            q[i] = table.seeds[table.choice[table.best[k], max(self.owner(i), 0)], i]

    def draw(self, table, k, q):
        """Mostly keep the tips that arrived and the shared joints: by chance all at once seldom start well."""
        some = False
        for f in range(self.tasks.shape[0]):
            some = some or self.tips[f, 1] < ARRIVED
        some = some and k % 4 > 0  # every fourth start is all new
        ends = Ends(self.ends[0], q.shape[0])
        for i in range(q.shape[0]):
            a = ends.low(i) + ends.span(i) * rnd(table.state)
            owner = self.owner(i)
            if not (some and (owner < 0 or self.tips[owner, 1] < ARRIVED)):
                q[i] = a

    def keep(self, look, place):
        e, errors = self.desk.e, self.desk.errors
        for f in range(self.tasks.shape[0]):
            errors[place, f, 0] = from_target(self.goals[f], at3(e, 6 * f)).square()
            errors[place, f, 1] = at3(e, 6 * f + 3).square()

    def left_at(self, place, f):
        """Position error [m] and rotation error [rad] of tip f kept at a place."""
        errors = self.desk.errors
        position = math.sqrt(errors[place, f, 0]) * Ends(self.ends[f], self.desk.q.shape[0]).scale()
        return position, angle_left(int(self.tasks[f, 0]), errors[place, f, 1])

    def left(self, place):
        position, rotation = 0.0, 0.0
        for f in range(self.tasks.shape[0]):
            p, r = self.left_at(place, f)
            position, rotation = max(position, p), max(rotation, r)
        return position, rotation

    def report(self, place, row):
        """Append what is left at each tip."""
        for f in range(self.tasks.shape[0]):
            p, r = self.left_at(place, f)
            excess = self.tips[f, 0] * Ends(self.ends[f], self.desk.q.shape[0]).scale()
            write(row, row.shape[0] - MISS * (self.tasks.shape[0] - f), Miss(p, r, excess))


@build
def make_tree(rows, ends, tasks, n, orders):
    """Tree with its scratch; the ends of a tip end with the number of its rows and `moves` (n)."""
    F = ends.shape[0]
    cut = np.zeros(F + 1, np.int64)
    for f in range(F):
        cut[f + 1] = cut[f] + int(ends[f, ends.shape[1] - n - 1])
    joints, angles = room(rows.shape[0])
    return Tree(
        make_desk(n, 6 * F), rows, ends, tasks[: 7 * F].reshape(F, 7), cut, ends[:, ends.shape[1] - n :],
        np.empty((F, GOAL)), np.empty((F, KEPT + 3)), np.empty(joints), np.zeros(angles), np.full((F, 2), np.inf), orders,
        orders.limits > 0.0 or orders.follow > 0.0,
    )  # fmt: skip
