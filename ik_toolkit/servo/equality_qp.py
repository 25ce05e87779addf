"""Two least-squares objectives in order of priority, with the active constraints as equalities.

This is the problem of one iteration of hierarchical_qp.py. It is solved anew in each iteration, so that errors do not accumulate,
by Gram-Schmidt with pivoting and reorthogonalisation. That costs N r^2 operations for N unknowns and r rows.
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.array_view import LINE, cut
from ..compile.jit import compiled, inline, spliced
from ..kernel.records import Array

NONE = -1  # index that means "no constraint"
SAME = 1e-10  # A row is linearly dependent if the part perpendicular to the others is below this share of its length.
# Gram-Schmidt needs no second pass for a row of which this share of the squared length remains (Daniel et al., 1976).
CLEAR = 0.5
# A squared length below this share of the original one is computed anew, because subtraction has lost its digits.
DOUBTFUL = 1e-6
ROUNDING = 1e-13  # A sum below this share of the sum of its terms' magnitudes is rounding.


@compiled
class Pair(NamedTuple):
    """Lagrange multipliers, one part for each of the two objectives: first / eps + second in the limit eps -> 0."""

    first: Array
    second: Array


@compiled
class Unknowns(NamedTuple):
    """Arrays (N,) with an entry for each of the N unknowns y of a quadratic program."""

    y: Array  # (N,) solution y of the last equality-constrained problem
    want: Array  # (N,) values desired by the second objective
    floor: Array  # (N,) lower bounds
    roof: Array  # (N,) upper bounds
    held: Array  # (N,) int8: -1 held at the lower bound, 1 at the upper bound, 0 free
    now: Pair  # present multipliers of the bounds, positive at upper bounds
    new: Pair  # multipliers of the bounds from the last equality-constrained problem


@compiled
class Rows(NamedTuple):
    """Arrays with an entry for each of K rows: the inequalities P y <= rhs, each of norm 1, then the task P y = rhs."""

    P: Array  # (K, N) coefficients
    rhs: Array  # (K,) right sides
    length: Array  # (K,) norms of the rows of P
    holds: Array  # (K,) int8: 1 if the inequality is active
    now: Pair  # (K,) present multipliers of the inequalities
    new: Pair  # (K,) multipliers from the last equality-constrained problem; task rows: `first` is P y - rhs


@compiled
class Basis(NamedTuple):
    """Scratch: an orthonormal basis of the active rows and the task rows, restricted to the free unknowns."""

    W: Array  # (K, N) the rows after orthonormalisation
    L: Array  # (K, K) coefficients: row k is the sum over j of L[k, j] times basis vector j
    U: Array  # (2 K, K) if task rows are dependent: QR factors of the task's part of L, Q' above R
    order: Array  # (K,) int64: the row that each basis vector came from
    rest: Array  # (K,) right sides less the contribution of the held unknowns
    remain: Array  # (K,) squared length of each task row outside the basis so far; -1: the row is in the basis
    whole: Array  # (K,) squared length of each task row before any projection
    along: Array  # (K,) component of y along each basis vector
    off: Array  # (K,) component of y less the desired one, along each basis vector


@compiled
class TwoLevels(NamedTuple):
    """A quadratic program with two objectives (task residual, then closeness), in the first `size` unknowns.

    Its rows are `planes` inequalities, followed by `task` rows of the task.
    """

    size: int
    planes: int
    task: int
    u: Unknowns
    r: Rows
    b: Basis


@inline
def problem_space(N, K):
    """Return the number of floats that a problem with N unknowns and K rows needs."""
    return 2 * K * N + 3 * K * K + 9 * N + 13 * K + 26 * LINE


@spliced
def problem_on(block, N, K):
    """Divide an array of zeros into the arrays of a problem with up to N unknowns and K rows."""
    P, W, L, U = cut(block, np.float64, ((K, N), (K, N), (K, K), (2 * K, K)))
    y, want, floor, roof, first, second, new_first, new_second = cut(block, np.float64, (N, N, N, N, N, N, N, N))
    rhs, length, rest, remain, whole, along, off, k0, k1, k2, k3 = cut(
        block, np.float64, (K, K, K, K, K, K, K, K, K, K, K)
    )
    held, holds = cut(block, np.int8, (N, K))
    (order,) = cut(block, np.int64, (K,))
    return TwoLevels(
        N, K, K,
        Unknowns(y, want, floor, roof, held, Pair(first, second), Pair(new_first, new_second)),
        Rows(P, rhs, length, holds, Pair(k0, k1), Pair(k2, k3)),
        Basis(W, L, U, order, rest, remain, whole, along, off),
    )  # fmt: skip


@inline
def resized(p, size, planes, task):
    """Return the problem with the same arrays but other numbers of unknowns, inequalities and task rows."""
    return TwoLevels(size, planes, task, p.u, p.r, p.b)


@inline
def dot(A, i, x, n):
    """Return the scalar product of row i of A with x, over their first n entries."""
    s = 0.0
    for k in range(n):
        s += A[i, k] * x[k]
    return s


@inline
def remove(b, row, j, n):
    """Subtract from a row of W (first n entries) its component along basis vector j, and add this component to L."""
    base = b.order[j]
    s = 0.0
    for i in range(n):
        s += b.W[row, i] * b.W[base, i]
    for i in range(n):
        b.W[row, i] -= s * b.W[base, i]
    b.L[row, j] += s


@inline
def square(A, k, n):
    """Return the squared length of the first n entries of row k of A."""
    s = 0.0
    for i in range(n):
        s += A[k, i] * A[k, i]
    return s


@inline
def take_in(b, row, q, size, n):
    """Normalise row `row` of W (length `size`); it becomes basis vector q."""
    b.L[row, q] = size
    for i in range(n):
        b.W[row, i] /= size
    b.order[q] = row


@inline
def row_basis(p, last):
    """Build an orthonormal basis of the active rows in the free unknowns: first of the inequalities, then of the task rows.

    last: inequality that is taken after all others, or NONE. Returns the number of basis vectors from inequalities, the number of
    all basis vectors, and an active inequality that depends linearly on the others, or NONE.
    """
    u, r, b = p.u, p.r, p.b
    n, K = p.size, p.planes + p.task
    for k in range(K):
        if k >= p.planes or r.holds[k] != 0:
            for i in range(n):
                b.W[k, i] = r.P[k, i] if u.held[i] == 0 else 0.0
            for j in range(K):
                b.L[k, j] = 0.0
    q, dependent = 0, NONE
    for place in range(p.planes + 1):
        k = place if place < p.planes else last
        if k < 0 or r.holds[k] == 0 or (place < p.planes and k == last):
            continue
        for _ in range(2):
            for j in range(q):
                remove(b, k, j, n)
        size = math.sqrt(square(b.W, k, n))
        if size <= SAME:
            dependent = k
            continue
        take_in(b, k, q, size, n)
        q += 1
    planes, largest = q, 0.0
    for k in range(p.planes, K):
        largest = max(largest, r.length[k])
        b.whole[k] = square(b.W, k, n)
        for j in range(planes):
            remove(b, k, j, n)
        b.remain[k] = square(b.W, k, n)
    for _ in range(p.task):
        k = p.planes
        for c in range(p.planes + 1, K):
            if b.remain[c] > b.remain[k]:
                k = c
        if not b.remain[k] > SAME * SAME * largest * largest:
            break
        if b.remain[k] < CLEAR * b.whole[k]:
            for j in range(q):
                remove(b, k, j, n)
        take_in(b, k, q, math.sqrt(square(b.W, k, n)), n)
        b.remain[k] = -1.0
        for c in range(p.planes, K):
            if b.remain[c] >= 0.0:
                remove(b, c, q, n)
                b.remain[c] = max(b.remain[c] - b.L[c, q] * b.L[c, q], 0.0)
                if b.remain[c] < DOUBTFUL * b.whole[c]:
                    b.remain[c] = square(b.W, c, n)
        q += 1
    return planes, q, dependent


@inline
def back(p, first, end, out, sign, lower):
    """Solve L' out = -sign off for the multipliers out (K,) of the rows from which basis vectors first to end - 1 were made.

    sign: 1 for the second objective, 0 for the first, which has no right side of its own. lower: whether `out` already holds the
    multipliers of the task rows; their contribution is then subtracted.
    """
    b = p.b
    for j in range(end - 1, first - 1, -1):
        k = b.order[j]
        s = -b.off[j] if sign > 0.0 else 0.0
        for h in range(j + 1, end):
            s -= b.L[b.order[h], j] * out[b.order[h]]
        if lower:
            for c in range(p.planes, p.planes + p.task):
                s -= b.L[c, j] * out[c]
        out[k] = s / b.L[k, j]


@inline
def equality(p, last):
    """Solve both objectives for y with all active constraints as equalities; write y and the new multipliers.

    Returns NONE, or, without solving anything, an active inequality that depends linearly on the others (`last` if it does). The
    inequality `last` is added to the basis after all other inequalities.
    """
    u, r, b = p.u, p.r, p.b
    n, K = p.size, p.planes + p.task
    for k in range(K):
        r.new.first[k], r.new.second[k] = 0.0, 0.0
    for i in range(n):
        u.y[i] = u.floor[i] if u.held[i] < 0 else u.roof[i] if u.held[i] > 0 else 0.0
    planes, q, dependent = row_basis(p, last)
    if dependent != NONE:
        return dependent
    for k in range(K):
        b.rest[k] = r.rhs[k] - dot(r.P, k, u.y, n)
    full = q - planes == p.task
    for j in range(q if full else planes):
        k = b.order[j]
        s = b.rest[k]
        for h in range(j):
            s -= b.L[k, h] * b.along[h]
        b.along[j] = s / b.L[k, j]
    if not full:
        least_squares(p, planes, q - planes)
    for j in range(q):
        b.off[j] = b.along[j] - dot(b.W, b.order[j], u.want, n)
    for i in range(n):
        if u.held[i] == 0:
            s = u.want[i]
            for j in range(q):
                s += b.off[j] * b.W[b.order[j], i]
            u.y[i] = s
    noise = 0.0
    if full:
        back(p, planes, q, r.new.second, 1.0, False)
    else:
        closeness_of_task(p, planes, q - planes)
        noise = residual(p)
        back(p, 0, planes, r.new.first, 0.0, True)
    back(p, 0, planes, r.new.second, 1.0, True)
    price_bounds(p, noise)
    return NONE


@inline
def price_bounds(p, noise):
    """Compute the multipliers of the active bounds; multipliers of the first objective up to `noise` in size become 0."""
    u, r = p.u, p.r
    for i in range(p.size):
        u.new.first[i], u.new.second[i] = 0.0, u.want[i] - u.y[i]
    for k in range(p.planes + p.task):
        one, two = r.new.first[k], r.new.second[k]
        if one != 0.0 or two != 0.0:
            for i in range(p.size):
                u.new.first[i] -= r.P[k, i] * one
                u.new.second[i] -= r.P[k, i] * two
    for i in range(p.size):
        if u.held[i] == 0:
            u.new.second[i] = 0.0
        if u.held[i] == 0 or abs(u.new.first[i]) <= noise:
            u.new.first[i] = 0.0
    for k in range(p.planes):
        if abs(r.new.first[k]) <= noise:
            r.new.first[k] = 0.0


@inline
def least_squares(p, planes, rank):
    """Solve linearly dependent task rows for y by least squares; write y in basis coordinates to b.along.

    planes: number of basis vectors from active inequalities, which come first; rank: number of basis vectors from task rows. The
    scratch U (see `Basis`) receives the QR factors.
    """
    b = p.b
    U, K, m = b.U, p.planes + p.task, p.task
    for k in range(p.planes, K):
        for h in range(planes):
            b.rest[k] -= b.L[k, h] * b.along[h]
    for j in range(rank):
        for h in range(rank):
            U[K + h, j] = 0.0
        for k in range(m):
            U[j, k] = b.L[p.planes + k, planes + j]
        whole, left = square(U, j, m), 0.0
        for _ in range(2):
            for h in range(j):
                s = 0.0
                for k in range(m):
                    s += U[h, k] * U[j, k]
                for k in range(m):
                    U[j, k] -= s * U[h, k]
                U[K + h, j] += s
            left = square(U, j, m)
            if left >= CLEAR * whole:
                break
        size = math.sqrt(left)
        U[K + j, j] = size
        s = 0.0
        for k in range(m):
            U[j, k] /= size
            s += U[j, k] * b.rest[p.planes + k]
        for k in range(m):
            b.rest[p.planes + k] -= s * U[j, k]
        b.along[planes + j] = s
    for j in range(rank - 1, -1, -1):
        s = b.along[planes + j]
        for h in range(j + 1, rank):
            s -= U[K + j, h] * b.along[planes + h]
        b.along[planes + j] = s / U[K + j, j]


@inline
def closeness_of_task(p, planes, rank):
    """Write multipliers of the second objective for linearly dependent task rows; of all solutions, that of least norm."""
    b, K = p.b, p.planes + p.task
    for j in range(rank):  # Forward substitution: transpose(U's coefficients) times along equals -off.
        s = -b.off[planes + j]
        for h in range(j):
            s -= b.U[K + h, j] * b.along[h]
        b.along[j] = s / b.U[K + j, j]
    for k in range(p.task):
        s = 0.0
        for j in range(rank):
            s += b.U[j, k] * b.along[j]
        p.r.new.second[p.planes + k] = s


@inline
def residual(p):
    """Write the residuals P y - rhs of the task rows (all 0 if they are rounding); return a bound on rounding in multipliers.

    The bound is the sum, over the task rows, of the residual's rounding error times the row's length.
    """
    u, r = p.u, p.r
    size, terms, noise = 0.0, 0.0, 0.0
    for k in range(p.planes, p.planes + p.task):
        s, t = -r.rhs[k], abs(r.rhs[k])
        for i in range(p.size):
            s += r.P[k, i] * u.y[i]
            t += abs(r.P[k, i] * u.y[i])
        r.new.first[k] = s
        size = max(size, abs(s))
        terms = max(terms, t)
        noise += ROUNDING * t * r.length[k]
    if size <= ROUNDING * terms:
        for k in range(p.planes, p.planes + p.task):
            r.new.first[k] = 0.0
    return noise
