"""Move a failed search's best configuration to a local minimum of the error within the limits.

The error is the sum of |position error|^2 / length^2 + |rotation vector|^2 over all tips, without components that do not count. The
search's own steps suit targets in reach; if a target is out of reach, it ends up to a few percent above the minimum.
"""

from typing import NamedTuple

import numpy as np

from ..compile.array_view import cut, keep, space, view
from ..compile.jit import cached, inline
from .checks import CODE
from .limits import hold
from .null_space import OBJECTIVE, add_inside, replace_answer, solved_problem
from .problem import BEST_OF_ALL
from .records import AT, SIZE, copy
from .vectors import dot, largest


class Descent(NamedTuple):
    """Constants of the Levenberg-Marquardt method that brings a failed search's answer as near to its target as it can.

    Its damping is a multiple of the squared error.
    """

    first: float = 0.1  # damping of the first step, divided by the squared error
    least: float = 1e-6  # least damping, divided by the squared error; it bounds the steps at singular poses
    # greatest damping, divided by the squared error; the method ends if even its short step does not lower the error
    most: float = 1e9
    lowered: float = 0.3  # by how much the damping is multiplied after a step that lowers the error
    raised: float = 4.0  # by how much the damping is multiplied after a step that does not lower the error
    evaluations: int = 500  # highest number of evaluations of the errors (0.3 us each)
    smallest: float = 1e-7  # the method ends when a step moves every joint by less than this [rad or arm reaches]


DOWN = Descent()


@inline
def weighed(p, e, factor):
    """Write the errors of problem p, positions multiplied by `factor`, to p.desk.y (m,); return their squared norm.

    e: the errors, as `p.evaluate` returned them.
    """
    y, total = p.desk.y, 0.0
    p.stack(e)
    for k in range(y.shape[0]):
        y[k] *= factor if k % 6 < 3 else 1.0
        total += y[k] * y[k]
    return total


@inline
def held_wrongly(s, error, weights, box):
    """Return whether the joints that are held at a limit by mistake could lower the error faster than the free joints.

    A joint at a limit is held by mistake if the error falls as the joint leaves the limit. The sums of squared slopes are compared.
    s: `Desk`, whose w is 0 for a joint that is held; error (m,): the errors; weights (n,): joint weights; box: joint limits.
    """
    free, wrong = 0.0, 0.0
    for i in range(s.q.shape[0]):
        if weights[i] > 0.0:
            g = dot(s.J[i], error, error.shape[0])
            if s.w[i] > 0.0:
                free += g * g
            elif g > 0.0 if s.q[i] <= box.lower(i) else g < 0.0:
                wrong += g * g
    return wrong > free


@inline
def write_damped_step(p, error, damping, weights, box, pressed):
    """Write to p.desk.dq the damped least-squares step that lowers the error; return the largest move of a joint in it.

    By default the step holds the joints at a limit that the step itself would push outwards. This is fast, but may hold a joint
    that ought to leave its limit. If that matters (`held_wrongly`), or if `pressed` is set, it instead holds the joints at a limit
    that the gradient of the error pushes outwards. p: the problem; error (m,): its errors; weights (n,): joint weights; box: joint
    limits.
    """
    s = p.desk
    copy(weights, s.w)
    if not pressed:
        for _ in range(s.q.shape[0]):
            p.toward(error, damping)
            if not hold(s.q, s.dq, s.w, box):
                break
        pressed = held_wrongly(s, error, weights, box)
    if pressed:
        for i in range(s.q.shape[0]):
            g, w = dot(s.J[i], error, error.shape[0]), weights[i]
            s.w[i] = 0.0 if (s.q[i] <= box.lower(i) and g <= 0.0) or (s.q[i] >= box.upper(i) and g >= 0.0) else w
        p.toward(error, damping)
    return largest(s.dq)


@inline
def descend_on_views(rows, ends, T, row, orders, n, length, steps, block):
    """Do the work of `approach_targets` for one failed search: lower its error, and return the squared error at the new q.

    The arrays are given as views; steps: highest number of evaluations; block: scratch memory.
    """
    p, _, weights, full, box = solved_problem(block, rows, ends, row, orders, n, OBJECTIVE.reference)
    s = p.desk
    best, error = cut(block, np.float64, (n, s.y.shape[0]))
    p.head_for(T)
    add_inside(s.q, s.q, 0.0, box)  # A step of length zero only clips the joints to their limits.
    factor, share, value, made, pressed = full.scale() / length, DOWN.first, np.inf, 0, False
    while True:
        e = p.evaluate(s.q)
        made += 1
        now = weighed(p, e, factor)
        # A configuration inside both tolerances is accepted even if its weighted error is larger.
        if now < value or e.good:
            value, share, pressed = now, max(DOWN.lowered * share, DOWN.least), False
            copy(s.q, best)
            copy(s.y, error)
            p.keep(e, BEST_OF_ALL)
            p.jacobian(e)
            for i in range(n):
                for k in range(s.J.shape[1]):
                    s.J[i, k] *= factor if k % 6 < 3 else 1.0
        else:
            share *= DOWN.raised
            copy(best, s.q)
        if e.good or made >= steps:
            break
        size = write_damped_step(p, error, share * value, weights, box, pressed)
        if not pressed and (size < DOWN.smallest or share > DOWN.most):
            pressed, share = True, DOWN.first
            size = write_damped_step(p, error, share * value, weights, box, pressed)
        if size < DOWN.smallest or share > DOWN.most:
            break
        add_inside(s.q, s.dq, 1.0, box)
    row[AT.evaluations] += made
    if made > 1:
        replace_answer(p, best, full, row)
        if e.good:
            row[AT.status] = CODE.converged
    return value


@cached
def approach_targets(rows, ends, T, out, orders, n, length, allowed, left):
    """Bring the answers of failed searches nearer to their targets, to local minima of the error inside the limits.

    In their rows of `out`, q, errors and number of evaluations are replaced. If a minimisation reaches its target, the row's status
    becomes CONVERGED. Rows that are CONVERGED stay as they are.

    Args:
        rows: (L, 10) geometry of the chain or tree.
        ends: `records.Ends` of the chain or tree.
        T: (N, F, 4, 4) targets [m] of F tips, base frame.
        out: (N, width) results of a search, see `search.entry`.
        orders: Options and tasks, see `search.entry`.
        n: Number of coordinates.
        length: Position error [m] that counts as much as a rotation error of one radian.
        allowed: Highest number of evaluations of a row together with its search; a row with less than 2 left stays as it is.
        left: (N,) receives the squared error at each new q, with position errors divided by `length`; infinity where none is new.
    """
    block = np.empty(space(n, 6 * (ends.size // ends.shape[-1]), rows.shape[0], 0))
    for k in range(T.shape[0]):
        steps, left[k] = int(min(DOWN.evaluations, allowed - out[k, AT.evaluations])), np.inf
        if steps >= 2 and out[k, AT.status] != CODE.converged:
            before = out[k].copy()
            left[k] = descend_on_views(
                view(rows), view(ends), view(T[k]), view(out[k]), view(orders), n, length, steps, view(block)
            )
            for j in range(SIZE.answer + n + 2, out.shape[1], SIZE.miss):
                # Only the errors of each tip are new; the length by which its target is proven out of reach stays as it was.
                out[k, j] = before[j]
    keep(block)
