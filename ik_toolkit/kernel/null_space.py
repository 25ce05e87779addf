"""Improve a solution by a secondary objective: move it through the null space of the task, so that it stays on the target.

It uses only the methods that the problems of one tip and of several tips have in common (see problem.py).
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.array_view import cut, flat, keep, space, view
from ..compile.jit import cached, compiled, dual, inline, spliced
from .dispatch import problem_on
from .limits import LIGHTEST, hold
from .linalg import cholesky
from .problem import BEST_OF_ALL
from .records import AT, SIZE, Array, Ends, Orders, copy, read
from .vectors import dot_of_columns, largest


class Objectives(NamedTuple):
    """Numbers of the secondary objectives by which a solution may be improved (explained in `refine`); 0 stands for none."""

    mid_range: int = 1
    reference: int = 2
    manipulability: int = 3


class Steps(NamedTuple):
    """Numeric constants for moving a solution through the null space of its task: tolerances, step sizes, numbers of iterations."""

    # The joints can change an error only if its row of the Jacobian has a larger squared norm than this.
    influence: float = 1e-18
    # least squared pivot of JJ', J being the Jacobian; it keeps the logarithm finite at a singular pose
    volume: float = 1e-30
    corrections: int = 6  # highest number of steps back onto the target; convergence is quadratic, so 2 or 3 suffice
    # step by which the manipulability is differentiated numerically [rad or arm reaches]
    difference: float = 1e-6
    smallest: float = 1e-7  # the refinement ends when a step moves every joint by less than this [rad or arm reaches]
    # largest move of a joint in a step [rad or arm reaches], because the null space is curved
    longest: float = 0.3
    # A row of the Jacobian counts as zero if its squared norm is below this share of the largest one.
    single: float = 1e-24
    # Damping of projections and corrections. It is below the square of any singular value in whose direction a step is useful.
    damping: float = 1e-10


OBJECTIVE, NULL = Objectives(), Steps()


@compiled
class Bounds(NamedTuple):
    """Limits of the joints while a solution is improved by a secondary objective; those of endless joints are infinite."""

    limits: Array  # (3, n) lower limit, upper limit, and 1 if the objective counts the joint, else 0

    def lower(self, i):
        return self.limits[0, i]

    def upper(self, i):
        return self.limits[1, i]

    def counted(self, i):
        return self.limits[2, i]


@spliced
def make_bounds(places, ends, what, limits):
    """Return the joint limits within which a secondary objective may move a solution, as Bounds stored in `places` (3, n).

    ends: the joint limits (Ends); what: a number of `Objectives`; limits: whether the joint limits are kept.
    """
    box = Bounds(places)
    for i in range(ends.n):
        free = ends.turns(i) > 1.5 or not limits
        box.limits[0, i] = -np.inf if free else ends.lower(i)
        box.limits[1, i] = np.inf if free else ends.upper(i)
        box.limits[2, i] = (
            1.0 if what == OBJECTIVE.reference or (ends.lower(i) > -1e15 and ends.turns(i) < 1.5) else 0.0
        )
    return box


@inline
def stated_problem(block, rows, ends, orders, n):
    """Return the problem of n joints that the arrays of a Plan state (rows, ends, orders), its Orders, and the joint weights (n,).

    block: scratch memory. The results are views of these arrays, not copies.
    """
    o = read(Orders, orders)
    first = SIZE.orders + SIZE.task * (flat(ends).shape[0] // ends.shape[-1])
    block[0] = 0.0
    p = problem_on(block, rows, ends, orders[SIZE.orders : first], n, o)
    return p, o, orders[first : first + n]


@inline
def bounded_problem(block, rows, ends, orders, n, what):
    """Return what `stated_problem` does, and the joint limits as `Ends` and as Bounds; what: a number of `Objectives`."""
    p, o, weights = stated_problem(block, rows, ends, orders, n)
    full = Ends(flat(ends), n)  # Every tip stores the same joint limits, so those of the first tip are read.
    (places,) = cut(block, np.float64, ((3, n),))
    return p, o, weights, full, make_bounds(places, full, what, o.limits > 0.0)


@inline
def solved_problem(block, rows, ends, row, orders, n, what):
    """Return what `bounded_problem` does, with the q of the answer `row` of a search in p.desk.q, to move on from there."""
    p, o, weights, full, box = bounded_problem(block, rows, ends, orders, n, what)
    for i in range(n):
        p.desk.q[i] = row[SIZE.answer + i] / full.unit(i)
    return p, o, weights, full, box


@inline
def replace_answer(p, q, full, row):
    """Replace q and the errors in an answer `row` by q (n,) and the errors that problem p has stored at index BEST_OF_ALL.

    full: base, tip and joint limits (Ends).
    """
    row[AT.position], row[AT.rotation] = p.left(BEST_OF_ALL)
    p.report(BEST_OF_ALL, row)
    for i in range(q.shape[0]):
        row[SIZE.answer + i] = q[i] * full.unit(i)


@inline
def log_manipulability(p, ends):
    """Return the logarithm of Yoshikawa's manipulability sqrt(det(JJ')), up to a constant.

    J consists of the rows of the Jacobian, of all tips, that are not zero; its columns for prismatic joints are taken per metre. p:
    the problem, whose p.desk.J (the Jacobian) and p.desk.A are overwritten; ends: `Ends`.
    """
    J, A = p.desk.J, p.desk.A
    m = 0
    for r in range(p.width()):
        if dot_of_columns(J, r, J, r, J.shape[0]) > NULL.influence:
            for i in range(J.shape[0]):
                J[i, m] = J[i, r] / ends.unit(i)
            m += 1
    for r in range(m):
        for c in range(r + 1):
            A[r, c] = dot_of_columns(J, r, J, c, J.shape[0])
    cholesky(A, m, NULL.volume)
    total = 0.0
    for r in range(m):
        total -= math.log(A[r, r])
    return total


@inline
def objective_goal(what, ends, ref, i):
    """Return the value towards which an objective moves joint i: the middle of its range, or its value in `ref` (n,).

    It is in rad or, for prismatic joints, in arm reaches (in `ref`: in metres). what: a number of `Objectives`.
    """
    return ends.low(i) + 0.5 * ends.span(i) if what == OBJECTIVE.mid_range else ref[i] / ends.unit(i)


@inline
def add_inside(q, dq, factor, box):
    """Add `factor` times the step dq (n,) to q (n,), and clip q to the limits (Bounds)."""
    for i in range(q.shape[0]):
        q[i] = min(max(q[i] + factor * dq[i], box.lower(i)), box.upper(i))


@inline
def onto_target(p, weights, box, enough):
    """Move p.desk.q back onto the target by damped least squares, because a null-space step leaves it by a second-order error.

    weights (n,): joint weights; box: joint limits (Bounds); enough: squared error at which to stop, or 0 to stop inside the
    tolerances. Returns the last evaluation. Afterwards p.desk.J may belong to an earlier q than p.desk.q.
    """
    s = p.desk
    for k in range(NULL.corrections):
        e = p.evaluate(s.q)
        if (e.ee <= enough if enough > 0.0 else e.good) or k == NULL.corrections - 1:
            break
        p.jacobian(e)
        copy(weights, s.w)
        for _ in range(2):
            p.damped(e, NULL.damping)
            if not hold(s.q, s.dq, s.w, box):
                break
        add_inside(s.q, s.dq, 1.0, box)
    return e


@inline
def direction(p, z, box):
    """Write to p.desk.dq the part of the joint step z (n,) that moves no tip, while joints at a bound are held.

    The projection is orthogonal in the metric 1/w of the joint weights p.desk.w. It uses p.desk.J, and changes p.desk.w and
    p.desk.y. box: joint limits (Bounds).
    """
    s = p.desk
    n = z.shape[0]
    for _ in range(n):
        for r in range(p.width()):
            g = 0.0
            for i in range(n):
                if s.w[i] > 0.0:
                    g += s.J[i, r] * z[i]
            s.y[r] = -g
        p.toward(s.y, NULL.damping)
        for i in range(n):
            s.dq[i] = s.dq[i] + z[i] if s.w[i] > 0.0 else 0.0
        if not hold(s.q, s.dq, s.w, box):
            break


@inline
def objective(p, what, ends, box, ref, weights):
    """Return the value of an objective (see `refine`) at p.desk.q, whose Jacobian is in p.desk.J; less is better.

    what: a number of `Objectives`; ends: `Ends`; box: `Bounds`; ref, weights: (n,) values to aim at [rad or m], and joint weights.
    """
    if what == OBJECTIVE.manipulability:
        return -log_manipulability(p, ends)
    total = 0.0
    for i in range(ref.shape[0]):
        left = p.desk.q[i] - objective_goal(what, ends, ref, i)
        unit = ends.span(i) * ends.span(i) if what == OBJECTIVE.mid_range else max(weights[i], LIGHTEST)
        total += box.counted(i) * 0.5 * left * left / unit
    return total


@spliced
def downhill(p, what, ends, box, ref, value, z):
    """Write to z (n,) a direction in which an objective (see `refine`) falls.

    For an objective that is a distance this is the full Newton step. The Jacobian at p.desk.q is computed again. value: the
    objective at p.desk.q; the other arguments are those of `objective`.
    """
    q = p.desk.q
    n = q.shape[0]
    for i in range(n):
        z[i] = box.counted(i) * (objective_goal(what, ends, ref, i) - q[i])
    # Each pass changes one joint to differentiate numerically; the last one changes none and restores the Jacobian at q.
    for i in range(n + 1):
        if i < n:
            if what != OBJECTIVE.manipulability:
                continue
            q[i] += NULL.difference
        e = p.evaluate(q)
        p.jacobian(e)
        if i < n:
            z[i] = 0.5 * (log_manipulability(p, ends) + value) / NULL.difference
            q[i] -= NULL.difference


@inline
def secant(old, before, way, dq, gain):
    """Return the length of the next downhill step, by the formula of Barzilai and Borwein (1988), or `gain` if it is not positive.

    old and before (n,): the present and the previous configuration; dq and way (n,): the downhill directions at these two.
    """
    ss, sy = 0.0, 0.0
    for i in range(old.shape[0]):
        step = old[i] - before[i]
        ss += step * step
        sy += step * (way[i] - dq[i])
    return min(max(ss / sy, 1e-3), 1e3) if sy > 1e-12 * ss else gain


@inline
def refine_on_views(rows, ends, T, row, ref, orders, what, steps, block):
    """Do the work of `refine`, whose arguments these are, except for `block`: one array for all scratch memory.

    The arrays cut from it are views, so that nothing is allocated here.
    """
    n = ref.shape[0]
    p, o, weights, full, box = solved_problem(block, rows, ends, row, orders, n, what)
    q, dq, w = p.desk.q, p.desk.dq, p.desk.w
    old, z, before, way = cut(block, np.float64, (n, n, n, n))
    p.aim(T[0], o)
    gain = 1.0
    fresh = False  # whether the last step has lowered the objective
    value = np.inf
    taken = 0
    for k in range(steps + 1):
        e = onto_target(p, weights, box, 0.0)
        p.jacobian(e)
        now = objective(p, what, full, box, ref, weights)
        # An improvement below the rounding error of the objective does not count as progress.
        better = e.good and (k == 0 or now < value - 1e-12 * abs(value))
        if better:
            value = now
            p.keep(e, BEST_OF_ALL)
            copy(q, old)
        elif k > 0:
            copy(old, q)
            gain *= 0.25
        if k == steps or gain < 1e-6 or not (better or k > 0):
            break
        fresh = better and k > 0
        taken += 1 if fresh else 0
        downhill(p, what, full, box, ref, value, z)
        for i in range(n):
            w[i] = weights[i] * (full.span(i) * full.span(i) if what == OBJECTIVE.mid_range else 1.0)
        direction(p, z, box)
        size = largest(dq)
        if size < NULL.smallest:
            break
        if fresh:
            gain = secant(old, before, way, dq, gain)
        if better:
            copy(old, before)
            copy(dq, way)
        add_inside(q, dq, gain * min(1.0, NULL.longest / size), box)
    if taken > 0:
        replace_answer(p, old, full, row)


@cached
def refine(rows, ends, T, row, ref, orders, what, steps):
    """Improve the solution in `row` for a secondary objective without leaving the tolerances of its target.

    q and its errors in `row` are replaced if at least one step was an improvement.

    Args:
        rows: (L, 10) geometry of the chain or tree.
        ends: `records.Ends` of the chain or tree.
        T: (1, 4, 4) or (1, F, 4, 4) target [m], base frame.
        row: The answer of a search, see `search.entry`.
        ref: (n,) joint values [rad or m] that the objective `reference` aims at.
        orders: See `search.entry`.
        what: A number of `Objectives`. `reference` lowers half the squared distance from `ref`, weighted as in `limits.distance`.
            `mid_range` lowers half the squared distance from the middles of the joints' ranges, in units of each range; endless
            joints do not count. `manipulability` raises the logarithm of the manipulability.
        steps: Highest number of steps.
    """
    n, tips = ref.shape[0], ends.size // ends.shape[-1]
    block = np.empty(space(n, 6 * tips, rows.shape[0], 0))
    refine_on_views(view(rows), view(ends), view(T), view(row), view(ref), view(orders), what, steps, view(block))
    keep(block)


@dual
def is_wide(J, m):
    """Return whether a Jacobian has at least as many joints as errors that its joints can change.

    J (n, m) is transposed: it has a column for each error; if the column is 0, no joint changes the error. If the result is true,
    JJ' is factored for the pseudo-inverse, else J'J, which is singular if some motion of the joints moves nothing.
    """
    n, top, moved = J.shape[0], 0.0, 0
    if n >= m:
        return True
    for k in range(m):
        for i in range(n):
            top = max(top, abs(J[i, k]))
    for k in range(m):
        size = 0.0
        for i in range(n):
            size = max(size, abs(J[i, k]))
        moved += size * size > NULL.single * top * top
    return n >= moved
