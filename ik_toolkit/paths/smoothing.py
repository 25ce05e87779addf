"""A whole joint path at once: every pose kept exactly, the path between them short and smooth.

Gauss-Newton on all poses together. The task is linearised with a weight far above everything else, so a step keeps it to first
order, and each pose is brought back onto its target after the step. First and second differences couple neighbours: the system
is a band of twice the number of joints, solved in time linear in the number of poses. Limits are bounds, held as an active set.

The banded system is solved by Cholesky, in place, allocating nothing. A band of half width b keeps
row i of the lower half as A[i, k - i + b] for the columns k = i - b ... i, so that the sums below run
through memory in order.
"""

import math

import numpy as np

from ..compile.jit import cached, inner, spliced
from ..kernel.null_space import REFERENCE, make_bounds, onto_target
from ..kernel.records import HEAD, TASK, Ends, Orders, copy, read
from ..kernel.search import problem

TASK_WEIGHT = (
    1e7  # of the task against a squared difference: what is left of 1e-2 rad is 1e-9, corrected exactly afterwards
)
RIDGE = 1e-9  # keeps the system definite where no difference reaches
ARRIVED = 1e-24  # squared error (lengths over reach) below which a correction is rounding
PASSES = 4  # solves of a step with ever more joints held at their limits
GAIN = 1e-4  # a relative improvement below this ends the search
GROW, SHRINK = 1.6, 0.3  # of the longest move, after a step that was taken and one that was not
SHORTEST = 1e-4  # [rad or kernel unit] longest move below which the search ends
ON_LIMIT = 1e-12  # this near to a limit a joint stands on it


@inner
def cost_of(Q, first, second, rounding, longest):
    """Cost of a path (N, n): `first` times lengths, `second` times squared second differences; and its largest step over `longest`.

    A length is sqrt(x^2 + rounding^2), per joint: like |x| for long steps and like x^2 for short ones.
    """
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
def differences(Q, first, second, rounding, H, g):
    """Hessian H (N n, 2 n + 1), as a band, and gradient g (N n,) of what `cost_of` measures."""
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
    """Copy the system to A and x = -g, without the coordinates that are held."""
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
    """Add the task at every pose of a path to the system; the path itself is in `now` (N, n)."""
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
    """Solve for the step x (N n,), with the joints held that stand on a limit and would leave it."""
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
    """Write to trial (N, n) the path a step further, every pose back on its target; False when one cannot be."""
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


@cached
def smooth_rows(rows, ends, T, Q, fixed, orders, first, second, rounding, longest, steps, good):
    """Shorten and smooth a path Q (N, n) [rad or m] in place; returns the steps taken, and its cost before and after.

    rows, ends, orders as of `search.entry`; T (N, ...): the targets. fixed (N,): poses whose joints stay. first, second,
    rounding: see `cost_of`; longest (n,) [rad or m]: no step between neighbours grows beyond it. good (N,): whether each is
    inside its tolerances.
    """
    N, n = Q.shape
    o = read(Orders, orders)
    begin = HEAD + TASK * (ends.size // ends.shape[-1])
    p = problem(rows, ends, orders[HEAD:begin], n, o)
    weights = orders[begin : begin + n]
    full = Ends(ends.reshape(-1), n)
    box = make_bounds(np.empty((3, n)), full, REFERENCE, o.limits > 0.0)
    now, trial, step = np.empty((N, n)), np.empty((N, n)), np.empty(n)
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
    before, wide = cost_of(now, first, second, rounding, step)
    cost, taken, fresh = before, 0, True
    size = N * n
    H, A = np.empty((size, 2 * n + 1)), np.empty((size, 2 * n + 1))
    g, x, held = np.empty(size), np.empty(size), np.empty(size, np.bool_)
    for _ in range(steps):
        if fresh:
            differences(now, first, second, rounding, H, g)
            linearise(p, o, T, now, fixed, H, g)
            newton_step(H, g, now, fixed, weights, box, held, A, x)
        largest = 0.0
        for r in range(size):
            largest = max(largest, abs(x[r]))
        if not SHORTEST < largest < np.inf or radius < SHORTEST:
            break
        factor = min(1.0, radius / largest)
        fresh = False
        if moved(p, o, T, now, x, factor, fixed, good, weights, box, trial):
            value, worst = cost_of(trial, first, second, rounding, step)
            if value < cost and worst <= max(wide, 1.0):
                ended = value > (1.0 - GAIN) * cost and factor >= 1.0
                cost, wide, fresh = value, worst, True
                taken += 1
                for k in range(N):
                    copy(trial[k], now[k])
                if ended:
                    break
        radius = min(GROW * radius, most) if fresh else SHRINK * min(radius, largest)
    for k in range(N):
        for i in range(n):
            Q[k, i] = now[k, i] * full.unit(i)
    return taken, before, cost


@cached
def settle_rows(rows, ends, T, Q, orders, good):
    """Bring each of Q (N, n) [rad or m] onto its target, in place; rows, ends, T, orders, good as of `smooth_rows`."""
    N, n = Q.shape
    o = read(Orders, orders)
    begin = HEAD + TASK * (ends.size // ends.shape[-1])
    p = problem(rows, ends, orders[HEAD:begin], n, o)
    full = Ends(ends.reshape(-1), n)
    box = make_bounds(np.empty((3, n)), full, REFERENCE, o.limits > 0.0)
    for k in range(N):
        for i in range(n):
            p.desk.q[i] = Q[k, i] / full.unit(i)
        p.aim(T[k], o)
        good[k] = onto_target(p, orders[begin : begin + n], box, ARRIVED).good
        for i in range(n):
            Q[k, i] = p.desk.q[i] * full.unit(i)


@inner
def band_cholesky(A, least):
    """Factor a band A (M, b + 1) in place; pivots below `least` are raised to it."""
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
        A[i, b] = 1.0 / math.sqrt(max(s, least))  # the diagonal is kept inverted: divisions are slow


@inner
def band_solve(A, x):
    """Replace x (M,) by the solution of the system whose factor `band_cholesky` left in A."""
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
