"""Shorten and smooth a whole joint path at once, with every pose kept on its target.

The method is Gauss-Newton for all poses together. The task errors are linearised and get a weight far above all other
costs, so a step keeps every pose on its target to first order; after the step each pose is corrected exactly. First and
second differences couple only neighbouring poses. So the system is banded, with a half width of twice the number of
joints, and takes time linear in the number of poses. Joint limits are bounds, handled by an active set.

The banded system is solved by Cholesky decomposition in place. Of a symmetric matrix of half width b the lower half is
stored by rows: element (i, k), for k = i - b ... i, is A[i, k - i + b], so that sums run through memory in order.
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.array_view import LINE, cut, flat, keep, space, view
from ..compile.jit import cached_small, inline, inner, spliced
from ..kernel.null_space import OBJECTIVE, bounded_problem, onto_target
from ..kernel.records import copy
from ..kernel.vectors import largest

# Weight of squared pose errors against squared joint steps; one Gauss-Newton step reduces an error of 1e-2 rad to 1e-9 rad.
TASK_WEIGHT = 1e7
# added to the diagonal, so that the system is positive definite even for joint values that no cost depends on
RIDGE = 1e-9
ARRIVED = 1e-24  # A correction onto a target ends below this squared error (lengths / reach), which is rounding.
PASSES = 4  # largest number of times that a step is computed, each time with more joints held at their limits
GAIN = 1e-4  # The iteration ends when a full step improves the cost by less than this share.
GROW, SHRINK = 1.6, 0.3  # factors on the largest allowed joint move after an accepted and after a rejected step
SHORTEST = 1e-4  # The iteration ends when the largest joint move falls below this [rad, or length / reach].
ON_LIMIT = 1e-12  # A joint nearer a limit than this counts as being at the limit [rad, or length / reach].


class PathPrice(NamedTuple):
    """The cost of a path: `first` times its length plus `second` / 2 times the sum of its squared second differences."""

    first: float
    second: float
    # length below which a joint's step counts by its square, see `cost_of` [rad, or length / reach]
    rounding: float


@inner
def cost_of(Q, price, longest):
    """Return the cost of a path Q (N, n) [rad, or length / reach], and its largest joint step over `longest` (n,).

    The length of a joint's step x is sqrt(x^2 + rounding^2) - rounding, which is like |x| for long steps and like x^2 for short
    ones.
    """
    first, second, rounding = price
    N, n = Q.shape
    total, worst = 0.0, 0.0
    for k in range(1, N):
        for i in range(n):
            x = Q[k, i] - Q[k - 1, i]
            total += first * (math.sqrt(x * x + rounding * rounding) - rounding)
            worst = max(worst, abs(x) / longest[i])
            if k > 1:
                x -= Q[k - 1, i] - Q[k - 2, i]
                total += 0.5 * second * x * x
    return total, worst


@inner
def differences(Q, price, H, g):
    """Write the gradient g (N n,) and the banded Hessian H (N n, 2 n + 1) of the cost of a path Q (N, n), see `cost_of`.

    price: `PathPrice`. The Hessian is approximate: its part for the length of steps is that of weighted least squares.
    """
    first, second, rounding = price
    N, n = Q.shape
    b = 2 * n
    for r in range(N * n):
        g[r] = 0.0
        for d in range(b + 1):
            H[r, d] = 0.0
        H[r, b] = RIDGE
    for k in range(1, N):
        for i in range(n):
            r = k * n + i
            x = Q[k, i] - Q[k - 1, i]
            w = first / math.sqrt(x * x + rounding * rounding)
            g[r] += w * x
            g[r - n] -= w * x
            H[r, b] += w
            H[r - n, b] += w
            H[r, b - n] -= w
            if k > 1:
                x -= Q[k - 1, i] - Q[k - 2, i]
                s = second
                g[r] += s * x
                g[r - n] -= 2.0 * s * x
                g[r - 2 * n] += s * x
                H[r, b] += s
                H[r - n, b] += 4.0 * s
                H[r - 2 * n, b] += s
                H[r, b - n] -= 2.0 * s
                H[r - n, b - n] -= 2.0 * s
                H[r, 0] += s


@inner
def held_system(H, g, held, A, x):
    """Write the system H x = -g to A (its matrix) and x (its right-hand side), with steps of 0 for held coordinates.

    held (N n,): whether a coordinate is held; its row and column are replaced by those of the identity.
    """
    M, b = H.shape[0], H.shape[1] - 1
    for r in range(M):
        x[r] = 0.0 if held[r] else -g[r]
        for d in range(max(0, b - r), b):
            A[r, d] = 0.0 if held[r] or held[r - b + d] else H[r, d]
        for d in range(max(0, b - r)):
            A[r, d] = 0.0
        A[r, b] = 1.0 if held[r] else H[r, b]


@spliced
def linearise(p, o, T, now, fixed, H, g):
    """Add the linearised pose errors along the path `now` (N, n) to the Hessian H and the gradient g of its cost.

    p, o: the compiled problem and its options (Orders); T (N, ...): the targets; poses marked in `fixed` (N,) are left out, because
    they do not move.
    """
    s, n, m = p.desk, now.shape[1], p.width()
    b = 2 * n
    for k in range(now.shape[0]):
        if fixed[k]:
            continue
        copy(now[k], s.q)
        p.aim(T[k], o)
        e = p.evaluate(s.q)
        p.jacobian(e)
        p.stack(e)
        for i in range(n):
            total = 0.0
            for c in range(m):
                total += s.J[i, c] * s.y[c]
            g[k * n + i] -= TASK_WEIGHT * total
            for j in range(i + 1):
                total = 0.0
                for c in range(m):
                    total += s.J[i, c] * s.J[j, c]
                H[k * n + i, b - i + j] += TASK_WEIGHT * total


@spliced
def newton_step(H, g, now, fixed, weights, box, held, A, x):
    """Solve H x = -g for the step x (N n,) of the path `now` (N, n), within the joint limits.

    Fixed poses and joints of weight 0 do not move. Joints at a limit that the step would push beyond are held as well, and the step
    is solved again. held (N n,) and A are scratch.
    """
    N, n = now.shape
    for k in range(N):
        for i in range(n):
            held[k * n + i] = fixed[k] or weights[i] <= 0.0
    for _ in range(PASSES):
        held_system(H, g, held, A, x)
        band_cholesky(A, RIDGE)
        band_solve(A, x)
        more = False
        for k in range(N):
            for i in range(n):
                r = k * n + i
                low = now[k, i] <= box.lower(i) + ON_LIMIT and x[r] < 0.0
                if not held[r] and (low or (now[k, i] >= box.upper(i) - ON_LIMIT and x[r] > 0.0)):
                    held[r] = True
                    more = True
        if not more:
            break


@spliced
def moved(p, o, T, now, x, factor, fixed, good, weights, box, trial):
    """Write to trial (N, n) the path now + factor * x, clipped to the limits and corrected onto every target.

    p, o: the compiled problem and its options (Orders); T (N, ...): the targets; x (N n,): the step; fixed (N,): poses that do not
    move; good (N,): whether each pose was on its target before; weights (n,): joint weights; box: joint limits. Returns False if a
    pose that was on its target cannot be corrected.
    """
    s, n = p.desk, now.shape[1]
    fine = True
    for k in range(now.shape[0]):
        for i in range(n):
            s.q[i] = min(max(now[k, i] + factor * x[k * n + i], box.lower(i)), box.upper(i))
        if not fixed[k]:
            p.aim(T[k], o)
            fine = onto_target(p, weights, box, ARRIVED).good or not good[k]
            if not fine:
                break
        for i in range(n):
            trial[k, i] = now[k, i] if fixed[k] else s.q[i]
    return fine


@cached_small
def smooth_rows(rows, ends, T, Q, fixed, orders, first, second, rounding, longest, steps, good):
    """Shorten and smooth a path Q (N, n) [rad or m] in place; return the steps taken, and the cost before and after.

    rows, ends, orders: arrays of a Plan; T (N, ...): the targets; fixed (N,): poses whose joints do not move;
    first, second, rounding: as in `cost_of`; longest (n,) [rad or m]: largest joint step between neighbouring poses;
    steps: largest number of Gauss-Newton steps. Writes to good (N,) whether each pose was brought onto its target before
    the first step.
    """
    (N, n), tips = Q.shape, ends.size // ends.shape[-1]
    size = N * n
    block = np.empty(space(n, 6 * tips, rows.shape[0], 0) + size * (4 * n + 8) + 16 * LINE)
    price = PathPrice(first, second, rounding)
    path = view(T), view(Q), view(fixed), view(good)
    found = smooth_on_views(
        view(rows), view(ends), path, view(orders), price, view(longest), steps, view(block)
    )  # fmt: skip
    keep(block)
    return found


@inline
def smooth_on_views(rows, ends, path, orders, price, longest, steps, block):
    """Do the work of `smooth_rows`, whose arrays are given as views; path: T, Q, fixed and good; block: scratch memory."""
    T, Q, fixed, good = path
    N, n = Q.shape
    p, o, weights, full, box = bounded_problem(block, rows, ends, orders, n, OBJECTIVE.reference)
    size = N * n
    now, trial, H, A = cut(block, np.float64, ((N, n), (N, n), (size, 2 * n + 1), (size, 2 * n + 1)))
    step, g, x = cut(block, np.float64, (n, size, size))
    (held,) = cut(block, np.bool_, (size,))
    radius = 0.0
    for i in range(n):
        step[i] = longest[i] / full.unit(i)
        radius = max(radius, 0.5 * step[i])
    most = 4.0 * radius
    for k in range(N):
        for i in range(n):
            p.desk.q[i] = Q[k, i] / full.unit(i)
        good[k] = True
        if not fixed[k]:
            p.aim(T[k], o)
            good[k] = onto_target(p, weights, box, ARRIVED).good
        copy(p.desk.q, now[k])
    before, wide = cost_of(now, price, step)
    cost, taken, fresh = before, 0, True
    for _ in range(steps):
        if fresh:
            differences(now, price, H, g)
            linearise(p, o, T, now, fixed, H, g)
            newton_step(H, g, now, fixed, weights, box, held, A, x)
        far = largest(x)
        if not SHORTEST < far < np.inf or radius < SHORTEST:
            break
        factor = min(1.0, radius / far)
        fresh = False
        if moved(p, o, T, now, x, factor, fixed, good, weights, box, trial):
            value, worst = cost_of(trial, price, step)
            if value < cost and worst <= max(wide, 1.0):
                ended = value > (1.0 - GAIN) * cost and factor >= 1.0
                cost, wide, fresh = value, worst, True
                taken += 1
                copy(flat(trial), flat(now))
                if ended:
                    break
        radius = min(GROW * radius, most) if fresh else SHRINK * min(radius, far)
    for k in range(N):
        for i in range(n):
            Q[k, i] = now[k, i] * full.unit(i)
    return taken, before, cost


@cached_small
def settle_rows(rows, ends, T, Q, orders, good):
    """Move each row of Q (N, n) [rad or m] onto its target T (N, ...) with the least joint motion, in place.

    Writes to good (N,) whether each row reached its target; rows, ends, orders: arrays of a Plan.
    """
    block = np.empty(space(Q.shape[1], 6 * (ends.size // ends.shape[-1]), rows.shape[0], 0))
    settle_on_views(view(rows), view(ends), view(T), view(Q), view(orders), view(good), view(block))
    keep(block)


@inline
def settle_on_views(rows, ends, T, Q, orders, good, block):
    """Do the work of `settle_rows`, whose arrays are given as views; block: scratch memory."""
    p, o, weights, full, box = bounded_problem(block, rows, ends, orders, Q.shape[1], OBJECTIVE.reference)
    for k in range(Q.shape[0]):
        for i in range(Q.shape[1]):
            p.desk.q[i] = Q[k, i] / full.unit(i)
        p.aim(T[k], o)
        good[k] = onto_target(p, weights, box, ARRIVED).good
        for i in range(Q.shape[1]):
            Q[k, i] = p.desk.q[i] * full.unit(i)


@inner
def band_cholesky(A, least):
    """Replace a banded symmetric matrix A (M, b + 1) by its Cholesky factor; squared pivots are at least `least`."""
    b = A.shape[1] - 1
    for i in range(A.shape[0]):
        first = max(0, i - b)
        for j in range(first, i):
            s = A[i, j - i + b]
            for k in range(first, j):
                s -= A[i, k - i + b] * A[j, k - j + b]
            A[i, j - i + b] = s * A[j, b]
        s = A[i, b]
        for k in range(first, i):
            s -= A[i, k - i + b] * A[i, k - i + b]
        A[i, b] = 1.0 / math.sqrt(max(s, least))  # The diagonal is stored inverted, because divisions are slow.


@inner
def band_solve(A, x):
    """Replace the right-hand side x (M,) by the solution of the system whose factor `band_cholesky` left in A."""
    b = A.shape[1] - 1
    for i in range(A.shape[0]):
        s = x[i]
        for k in range(max(0, i - b), i):
            s -= A[i, k - i + b] * x[k]
        x[i] = s * A[i, b]
    for i in range(A.shape[0] - 1, -1, -1):
        x[i] *= A[i, b]
        for k in range(max(0, i - b), i):
            x[k] -= A[i, k - i + b] * x[i]
