"""Errors in order of priority: a level of errors is made as small as the levels above it allow.

The errors of each tip form two groups, position and rotation, and every group has a level; level 0 comes first. The step solves
a quadratic program with the exact second derivatives of the Lagrangian, one level after the other, each in the null space that
the levels above have left (sequential quadratic programming; Nocedal and Wright, Numerical Optimization, chapter 18):

    level 0         J' d = e                            a constraint, solved with damping as in Levenberg-Marquardt
    level k > 0     min g' d + d' H d / 2               over what is left; H has the constraint's curvature, too

A level that is met, after those before it, joins the constraint.

If no attempt reaches level 0, it is minimised like the others, with its own second derivatives: a stretched arm's Jacobian is
singular, so its null space would move the tip.
"""

import math
from typing import NamedTuple

from ..compile.jit import compiled, inline, inner
from .limits import hold
from .linalg import cholesky, cholesky_solve, eigen, reflect_row, triangle
from .records import Array, copy
from .search import AT_MINIMUM
from .vectors import add_multiple, clear, dot, dot_of_columns, dot_with_column, largest


class LevelSteps(NamedTuple):
    """Numeric constants for errors in order of priority, tuned on eight arms; errors are in rad or divided by the arm's reach."""

    # A configuration counts as a minimum if the norm of the gradient in the null space, and a tenth of the largest multiplier of
    # the wrong sign, are below this share of the error.
    first_order: float = 1e-6
    # Below this squared error of a level, the gradient no longer has to fall with the error. Only directions flatter than `flat`
    # are left then, such as the free turn of a tool whose axis is rounded in the description: a whole turn changes the error by
    # microradians.
    small: float = 1e-8
    # damping of the step onto the constraint, as a share of the squared error (as in the solver `lm`)
    damping: float = 0.02
    # least damping of the step onto the constraint; it keeps the multipliers finite where the Jacobian is singular
    least_damping: float = 1e-9
    # a row of the constraint's Jacobian is independent if its part normal to the earlier rows exceeds this share of the largest row
    pivot: float = 1e-5
    # A level acts along directions with at least this curvature, in which a joint may still change the error by micrometres;
    # flatter ones are left to the next level.
    flat: float = 1e-6
    longest_along: float = 1.0  # longest step towards the constraint [rad or arm reaches]
    longest_across: float = 0.8  # longest step of a level in its null space [norm, in rad and arm reaches]
    same: float = 0.02  # two minima count as the same if their errors differ by less than this share
    # the share by which minima may differ if level 0 is out of reach; small because errors of level 0 come before all others
    same_reach: float = 1e-5
    # an attempt that comes this near to the best minimum [norm, in rad and arm reaches] counts as having found it; of those
    # attempts 1 in 35 would have ended elsewhere (SO-100 and SO-101, 200 targets each)
    near: float = 0.2
    agree: int = 3  # number of attempts that must have found the best minimum before the search ends
    # number of attempts that must have found the best minimum if level 0 is out of reach, where minima are close together
    agree_reach: int = 6
    most: int = 20  # number of attempts after which the search ends if any of them has reached level 0
    # how many of the first attempts treat all errors as one level, if there are at least as many joints as errors that count
    at_once: int = 48
    # how many of the first attempts treat all errors as one level if there are fewer joints than errors, but no more errors that
    # they can change (a planar arm's pose); without these attempts, 8 of 400 reachable poses of planar_3r are missed
    at_once_few: int = 3
    # number of precomputed starts; with only 256, 2 % fewer of the best minima are found on five joints
    table: int = 2048
    # number of precomputed starts from six joints on; 512 find as many minima as 2048, which take as long to scan as five
    # iterations
    table_six: int = 512
    known: int = 8  # number of attempts without success after which level 0 is taken to be out of reach
    # An attempt is given up if its squared error of level 0 exceeds a bound that falls by this factor in each iteration, and by the
    # factor `decay_later` once an attempt has reached level 0. At the border of the reach `decay` must not be small.
    decay: float = 0.5
    decay_later: float = 0.3


QUADRATIC = LevelSteps()


@compiled
class StepTables(NamedTuple):
    """Scratch arrays of a step by levels: matrices (k, k) with room for n joints and m errors, and vectors (k,)."""

    hessian: Array  # (n, n) second derivatives of a level's Lagrangian
    basis: Array  # (n, .) basis of the null space left by the levels so far, one vector a column
    work: Array
    turned: Array  # QR factors from `linalg.triangle`, or the eigenvectors of `reduced`
    reduced: Array  # second derivatives of a level in the null-space basis, later their eigenvalues on the diagonal
    border: Array  # (r, .) Jacobian of the r errors of the constraint with respect to the free joints
    triangle: Array  # (r, r) Cholesky factor of the damped border border'
    gradient: Array  # (n,) gradient of half the squared errors of a level
    rhs: Array  # right side of the linear system being solved
    pull: Array  # (m,) factors of the second derivatives of the errors, see `counted_error.add_curvature`
    chosen: Array  # (2 F,) 1 if a group of errors (position or rotation of a tip) belongs to the level
    asked: Array  # (n,) joint weights that the user asked for, also of joints that are held now
    dz: Array  # (n,) step of a level in the null space
    free: Array  # index of each free joint, one that is not held at a limit
    multiplier: Array  # (m,) negated Lagrange multipliers of the constraint
    row: Array  # scratch, for instance for one vector of the null space
    scales: Array  # scale of each reflection in `linalg.triangle`
    order: Array  # order of the columns in `linalg.triangle`


@inline
def tables_of(s):
    """Return the scratch memory s.tables of a search (Desk) as the named arrays of `StepTables`."""
    t = s.tables
    v = t[7]
    return StepTables(
        t[0], t[1], t[2], t[3], t[4], t[5], t[6], v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9], v[10]
    )


@inner
def slope_of_level(p, c, level, out):
    """Write to out (n,) the gradient of half the squared errors of priority c (0: first) of a problem p.

    The method `p.stack` must have written the errors to p.desk.y; level: (2 F,) level of position and rotation of each tip.
    """
    s = p.desk
    clear(out)
    for g in range(level.shape[0]):
        if level[g] == c:
            factor = p.tilt(g)
            for i in range(s.q.shape[0]):
                for k in range(3 * g, 3 * g + 3):
                    out[i] -= factor * s.J[i, k] * s.y[k]


@inner
def size_of_level(p, e, c, level):
    """Return the size that a gradient is compared with to tell whether the errors of level c are at a minimum.

    This is the level's squared error or tolerance, whichever is larger, but between QUADRATIC.small and 1. A gradient alone may be
    small long before the error is, near a pose that is almost reached, along a direction that hardly turns the tip. p: the problem;
    e: its errors; level: (2 F,) priority (0: first) of the position and of the rotation errors of each tip.
    """
    value, allowed = 0.0, 0.0
    for g in range(level.shape[0]):
        if level[g] == c:
            value += p.group(e, g)
            allowed += p.allowed(g)
    return min(max(value, allowed, QUADRATIC.small), 1.0)


@inline
def hessian_of_level(p, c, level, bench):
    """Write to bench.hessian the Hessian of the Lagrangian of level c, in which the levels above it are constraints.

    p: the problem; level: (2 F,) priority (0: first) of the position and of the rotation errors of each tip; bench: `StepTables`.
    """
    n = p.desk.q.shape[0]
    for i in range(n):
        clear(bench.hessian[i])
    for g in range(level.shape[0]):
        bench.chosen[g] = 1.0 if level[g] == c else 0.0
        for k in range(3 * g, 3 * g + 3):
            above = bench.multiplier[k] if level[g] < c else 0.0
            bench.pull[k] = -p.desk.y[k] if level[g] == c else above
    p.curvature(bench.pull, bench.chosen, bench.hessian)


@inline
def onto_constraint(s, level, base, k, value, bench):
    """Write to s.dq the damped step that meets the constraint (all levels before `base`), and its null space to bench.basis.

    Args:
        s: Working memory (Desk); the errors are in s.y.
        level: (2 F,) level of each group of errors (position and rotation of each tip).
        base: The errors of the levels below this number are the constraint.
        k: Number of free joints.
        value: Squared error of the constraint.
        bench: Scratch (StepTables); `border` and `triangle` are filled for `multipliers`.

    Returns:
        The number of vectors in the basis of the null space.
    """
    A, B, V, b, free = bench.triangle, bench.border, bench.turned, bench.rhs, bench.free
    r = 0
    for h in range(s.J.shape[1]):
        if level[h // 3] < base:
            for i in range(k):
                B[r, i] = V[r, i] = s.J[int(free[i]), h]
            b[r] = s.y[h]
            r += 1
    damping = QUADRATIC.damping * value + QUADRATIC.least_damping
    for x in range(r):
        for z in range(x + 1):
            A[x, z] = dot(V[x], V[z], k)
        A[x, x] += damping
    cholesky(A, r, damping)
    cholesky_solve(A, r, b)
    rank = triangle(V, r, k, bench.scales, bench.order, QUADRATIC.pivot)
    for i in range(k):
        s.dq[int(free[i])] = dot_with_column(b, B, i, r)
    most = largest(s.dq)
    if most > QUADRATIC.longest_along:
        for i in range(s.dq.shape[0]):
            s.dq[i] *= QUADRATIC.longest_along / most
    for j in range(rank, k):  # The reflections, last one first, take the unit vector j to a null-space vector.
        clear(bench.row)
        bench.row[j] = 1.0
        for i in range(rank - 1, -1, -1):
            reflect_row(V, bench.scales, i, bench.row, k)
        for i in range(s.dq.shape[0]):
            bench.basis[i, j - rank] = 0.0
        for i in range(k):
            bench.basis[int(free[i]), j - rank] = bench.row[i]
    return k - rank


@inline
def down_level(s, k, last, bench, box):
    """Add to s.dq the Newton step that lowers the errors of one level in the null space of the levels above it.

    Negative curvatures are made positive. Unless this is the last level, directions with a curvature below QUADRATIC.flat are left
    to the next one, as its basis. The step is shortened to end inside the limits; its part that leads onto the constraint is not.

    Args:
        s: Working memory (Desk).
        k: Number of vectors in the basis of the null space, bench.basis (n, k).
        last: Whether this is the last level.
        bench: Scratch (StepTables), with gradient and second derivatives of the level.
        box: Joint limits (Ends).

    Returns:
        The number of columns of the new basis, and the squared norm of the gradient in the old basis.
    """
    n, H, Z, A, V, W = s.q.shape[0], bench.hessian, bench.basis, bench.work, bench.turned, bench.reduced
    b, dz, slope, steep = bench.rhs, bench.dz, bench.row, 0.0
    for i in range(n):
        slope[i] = bench.gradient[i] + dot(H[i], s.dq, n)  # the gradient at the end of the step so far
    for x in range(k):
        for i in range(n):
            A[i, x] = dot_with_column(H[i], Z, x, n)
        b[x] = -dot_with_column(slope, Z, x, n)
        steep += dot_with_column(bench.gradient, Z, x, n) ** 2
    for x in range(k):
        for z in range(x + 1):
            W[x, z] = W[z, x] = dot_of_columns(Z, x, A, z, n)
    eigen(W, V, k)
    clear(dz)
    left, size = 0, 0.0
    for z in range(k):
        along = dot(V[z], b, k)
        flat = abs(W[z, z]) < QUADRATIC.flat
        passed = flat and not last and abs(along) <= QUADRATIC.first_order
        along = 0.0 if passed else along / max(abs(W[z, z]), QUADRATIC.flat)
        size += along * along
        for i in range(n):
            direction = dot(Z[i], V[z], k)
            dz[i] += along * direction
            if passed:
                A[i, left] = direction
        left += passed
    for i in range(n):
        copy(A[i], Z[i])
    share = min(1.0, QUADRATIC.longest_across / math.sqrt(size)) if size > 0.0 else 1.0
    for i in range(n):
        x, d, end = s.q[i] + s.dq[i], dz[i], box.lower(i) if dz[i] < 0.0 else box.upper(i)
        if box.turns(i) <= 0.0 and (end - s.q[i]) * d > 0.0 and (x + share * d - end) * d > 0.0:
            share = max((end - x) / d, 0.0)
    add_multiple(s.dq, share, dz, n)
    return left, steep


@inline
def multipliers(level, base, k, bench):
    """Write to bench.multiplier the negated Lagrange multipliers of the levels that come before level `base`.

    They belong to the gradient of level `base` or a later one, in bench.gradient. The last call of `onto_constraint` must have
    written the factors in `bench` that are used here. level: (2 F,) priority (0: first) of the position and of the rotation errors
    of each tip; k: number of free joints.
    """
    b, out, r = bench.rhs, bench.multiplier, 0
    clear(out)
    for g in range(level.shape[0]):
        for _ in range(3 if level[g] < base else 0):
            b[r] = 0.0
            for i in range(k):
                b[r] += bench.border[r, i] * bench.gradient[int(bench.free[i])]
            r += 1
    cholesky_solve(bench.triangle, r, b)
    r = 0
    for h in range(3 * level.shape[0]):
        if level[h // 3] < base:
            out[h] = -b[r]
            r += 1


@inner
def inverse_multipliers(s, level, k, bench):
    """Write to bench.multiplier the substitute for Lagrange multipliers if level 0 is not a constraint, but minimised.

    This is the Jacobian of level 0 times mu = -H^+ gradient. The eigenvalues and eigenvectors of H are those that `down_level`
    found for level 0, whose basis was the free joints. s: working memory (Desk); level: (2 F,) priority (0: first) of the position
    and of the rotation errors of each tip; k: number of free joints.
    """
    V, W, free, mu, out = bench.turned, bench.reduced, bench.free, bench.row, bench.multiplier
    clear(mu)
    for z in range(k):
        if abs(W[z, z]) >= QUADRATIC.flat:
            along = 0.0
            for x in range(k):
                along += V[z, x] * bench.gradient[int(free[x])]
            add_multiple(mu, -along / abs(W[z, z]), V[z], k)
    clear(out)
    for h in range(s.J.shape[1]):
        if level[h // 3] == 0.0:
            for x in range(k):
                out[h] += s.J[int(free[x]), h] * mu[x]


@inline
def wrongly_held(s, size, bench, box):
    """Return the joint held at a limit along which the Lagrangian falls fastest inwards, or -1 if it falls along none.

    s: working memory (Desk); size: what the fall is compared with, from `size_of_level`; bench: StepTables; box: limits (Ends).
    """
    worst, most = -1, 10.0 * QUADRATIC.first_order * math.sqrt(size)
    for i in range(s.q.shape[0]):
        if bench.asked[i] > 0.0 and not s.w[i] > 0.0:
            z = bench.gradient[i] + dot(s.J[i], bench.multiplier, s.J.shape[1])
            inwards = -z if s.q[i] <= box.lower(i) else z
            if inwards > most:
                worst, most = i, inwards
    return worst


@inline
def free_joints(s, bench):
    """Write to bench.free the joints of s (Desk) that are not held, and their unit vectors to bench.basis; return their number."""
    k = 0
    for i in range(s.w.shape[0]):
        clear(bench.basis[i])
        if s.w[i] > 0.0:
            bench.free[k], bench.basis[i, k] = i, 1.0
            k += 1
    return k


@inner
def step_by_levels(p, e, level, far):
    """Write to p.desk.dq the step for errors in order of priority; return AT_MINIMUM if q is already a minimum, else 0.

    A minimum meets level 0, and is a first-order minimum of the others. Joints at a limit that the step pushes outwards are held.
    At a minimum the multipliers of held joints must push outwards; as long as some do not, the worst of these joints is released.
    One is released at a time, because in a corner of the limits the multipliers of level 0 are only known when enough joints are
    free.

    Args:
        p: The problem.
        e: Errors at p.desk.q, from `level_search.rank_errors`.
        level: (2 F,) priority (0: first) of the position and of the rotation errors of each tip.
        far: Whether level 0 is minimised, because it is out of reach.
    """
    s, bench, box = p.desk, tables_of(p.desk), p.bounds_of_step()
    n, top, value, released = s.q.shape[0], 0.0, 0.0, 0
    # The constraint consists of the levels below `base`: level 0 and all that are met, which `rank_errors` has put into e.ee.
    base = 0.0 if far else max(1.0, -float(math.floor(e.ee)))
    for g in range(level.shape[0]):
        top = max(top, level[g])
        value += p.group(e, g) if level[g] < base else 0.0
    p.stack(e)
    copy(s.w, bench.asked)
    for _ in range(3 * n + 2):
        clear(s.dq)
        clear(bench.multiplier)
        k = count = free_joints(s, bench)
        steep, inward = 0.0, -1
        if not far:
            k = onto_constraint(s, level, base, k, value, bench)
            # The step that would lower errors inside the tolerance further must not push the released joints back out.
            if released > 0:
                clear(s.dq)
        for c in range(int(base), int(top) + 1):
            slope_of_level(p, c, level, bench.gradient)
            if not far:
                multipliers(level, base, count, bench)
            size = size_of_level(p, e, c, level)
            if c == base:  # The joint limits act on the first level that is minimised.
                inward = wrongly_held(s, size, bench, box)
            if k == 0:
                break
            hessian_of_level(p, c, level, bench)
            k, one = down_level(s, k, c == int(top), bench, box)
            steep += one / size
            if c == 0:
                slope_of_level(p, 1, level, bench.gradient)
                inverse_multipliers(s, level, count, bench)
        if hold(s.q, s.dq, s.w, box):
            continue
        if not ((e.ee < 0.0 or far) and steep <= QUADRATIC.first_order * QUADRATIC.first_order):
            return 0
        if inward < 0:
            return AT_MINIMUM
        if released == n:
            return 0
        released += 1
        s.w[inward] = bench.asked[inward]
    return 0
