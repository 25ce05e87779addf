"""Two least-squares objectives in order of priority, with the active constraints as equalities.

This is the problem of one iteration of hierarchical_qp.py. It is solved again in each iteration, so that errors do not accumulate,
by Gram-Schmidt with pivoting and reorthogonalisation. That costs N r^2 operations for N unknowns and r rows.
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.array_view import LINE, cut
from ..compile.jit import compiled, inline, spliced
from ..kernel.records import Array
from ..kernel.vectors import add_multiple, dot

NONE = -1  # index that means "no constraint"
SAME = 1e-10  # A row depends linearly on others if its part perpendicular to them is shorter than this share of its length.
# If this share of a row's squared length remains after a pass of Gram-Schmidt, no second pass is needed (Daniel et al., 1976).
CLEAR = 0.5
# A squared length that subtractions have brought below this share of its first value is computed again, because they have lost its
# digits.
DOUBTFUL = 1e-6
ROUNDING = 1e-13  # A sum below this share of its terms' added magnitudes is rounding.


@compiled
class Pair(NamedTuple):
    """Lagrange multipliers with a part for each of two objectives: first / eps + second for eps -> 0, so that `first` outweighs."""

    first: Array
    second: Array


@compiled
class Basis(NamedTuple):
    """Scratch: an orthonormal basis of the active inequalities and the task rows, restricted to the free unknowns."""

    W: Array  # (K, N) the rows after orthonormalisation
    L: Array  # (K, K) coefficients: row k is the sum over j of L[k, j] times basis vector j
    U: Array  # (2 K, K) if task rows are dependent: QR factors of the task's part of L, Q' above R
    order: Array  # (K,) int64: the row that each basis vector came from
    rest: Array  # (K,) right-hand sides less the contribution of the held unknowns
    remain: Array  # (K,) squared length of each task row outside the basis so far; -1: the row is in the basis
    whole: Array  # (K,) squared length of each task row before any projection
    along: Array  # (K,) component of y along each basis vector
    off: Array  # (K,) component of y less the desired one, along each basis vector


@compiled
class TwoLevels(NamedTuple):
    """A quadratic program for `size` unknowns y with two objectives: the task P y = rhs, then closeness to `want`.

    Constraint c is the inequality P y <= rhs of row c, or for c >= planes the two bounds of unknown c - planes. The rows of the
    task follow those of the inequalities; their multipliers come last (`slot`). The arrays have room for N unknowns and K rows.
    """

    size: int  # number of unknowns
    planes: int  # number of inequalities
    task: int  # number of rows of the task
    y: Array  # (N,) solution of the last equality-constrained problem
    want: Array  # (N,) values desired by the second objective
    floor: Array  # (N,) lower bounds of the unknowns
    roof: Array  # (N,) upper bounds of the unknowns
    scaling: Array  # (N,) the joint rate that a value of 1 of each unknown stands for
    P: Array  # (K, N) coefficients: the inequalities, each of norm 1, then the task
    rhs: Array  # (K,) right-hand sides
    length: Array  # (K,) norms of the rows of P
    # (K + N,) int8, for each constraint: 0 inactive, 1 active (a bound: the upper one), -1 held at the lower bound
    active: Array
    now: Pair  # (K + N,) present multipliers, each with the sign of its constraint's entry in `active`
    new: Pair  # (K + N,) multipliers of the last equality-constrained problem; for the task's rows `first` is P y - rhs
    b: Basis


@inline
def program_space(N, K):
    """Return how many floats the memory of a quadratic program (`TwoLevels`) with N unknowns and K rows takes."""
    return 2 * K * N + 3 * K * K + 10 * N + 14 * K + 26 * LINE


@spliced
def program_on(block, N, K):
    """Divide `block`, a flat array of zeros, into the arrays of a `TwoLevels` program with up to N unknowns and K rows."""
    P, W, L, U = cut(block, np.float64, ((K, N), (K, N), (K, K), (2 * K, K)))
    y, want, floor, roof, scaling = cut(block, np.float64, (N, N, N, N, N))
    first, second, new_first, new_second = cut(block, np.float64, (K + N, K + N, K + N, K + N))
    rhs, length, rest, remain, whole, along, off = cut(block, np.float64, (K, K, K, K, K, K, K))
    (active,) = cut(block, np.int8, (K + N,))
    (order,) = cut(block, np.int64, (K,))
    return TwoLevels(
        N, K, K, y, want, floor, roof, scaling, P, rhs, length, active, Pair(first, second), Pair(new_first, new_second),
        Basis(W, L, U, order, rest, remain, whole, along, off),
    )  # fmt: skip


@inline
def resized(p, size, planes, task):
    """Return the program p (`TwoLevels`) with the same arrays but other numbers of unknowns, inequalities and task rows."""
    return TwoLevels(
        size, planes, task, p.y, p.want, p.floor, p.roof, p.scaling, p.P, p.rhs, p.length, p.active, p.now, p.new, p.b
    )


@inline
def is_free(p, i):
    """Return whether unknown i of the program p (`TwoLevels`) is held at neither of its bounds."""
    return p.active[p.planes + i] == 0


@inline
def slot(p, k):
    """Return where the multiplier of row k of p.P (`TwoLevels`) is stored. The order is inequalities, bounds, task rows."""
    return k if k < p.planes else k + p.size


@inline
def load(p, k):
    """Begin Gram-Schmidt for row k of p.P (`TwoLevels`): copy it to b.W, without the held unknowns, and clear its coefficients."""
    for i in range(p.size):
        p.b.W[k, i] = p.P[k, i] if is_free(p, i) else 0.0
    for j in range(p.planes + p.task):
        p.b.L[k, j] = 0.0


@inline
def remove(b, row, first, end, n):
    """Make a row of b.W (`Basis`), n entries, perpendicular to basis vectors first to end - 1; add the parts subtracted to b.L."""
    for j in range(first, end):
        base = b.W[b.order[j]]
        s = dot(b.W[row], base, n)
        add_multiple(b.W[row], -s, base, n)
        b.L[row, j] += s


@inline
def take_in(b, row, q, size, n):
    """Make a row of b.W (n entries of the norm `size`) basis vector number q of b (`Basis`), by dividing it by its norm."""
    b.L[row, q] = size
    for i in range(n):
        b.W[row, i] /= size
    b.order[q] = row


@inline
def basis_of_planes(p, last):
    """Build an orthonormal basis of the active inequalities of p (`TwoLevels`) in the free unknowns.

    last: the inequality that is added after all others, or NONE. Returns the number of basis vectors, and the index of an active
    inequality that depends linearly on the others, or NONE.
    """
    b, q, dependent = p.b, 0, NONE
    for place in range(p.planes + 1):
        k = place if place < p.planes else last
        if k < 0 or p.active[k] == 0 or (place < p.planes and k == last):
            continue
        load(p, k)
        remove(b, k, 0, q, p.size)
        remove(b, k, 0, q, p.size)
        size = math.sqrt(dot(b.W[k], b.W[k], p.size))
        if size <= SAME:
            dependent = k
        else:
            take_in(b, k, q, size, p.size)
            q += 1
    return q, dependent


@inline
def basis_of_task(p, planes):
    """Extend the basis of p (`TwoLevels`), which has `planes` vectors so far, by the task rows; return the number of vectors."""
    b, n, K, largest = p.b, p.size, p.planes + p.task, 0.0
    for k in range(p.planes, K):
        load(p, k)
        largest = max(largest, p.length[k])
        b.whole[k] = dot(b.W[k], b.W[k], n)
        remove(b, k, 0, planes, n)
        b.remain[k] = dot(b.W[k], b.W[k], n)
    for q in range(planes, planes + p.task):
        k = p.planes
        for c in range(p.planes + 1, K):
            if b.remain[c] > b.remain[k]:
                k = c
        if not b.remain[k] > SAME * SAME * largest * largest:
            return q
        if b.remain[k] < CLEAR * b.whole[k]:
            remove(b, k, 0, q, n)
        take_in(b, k, q, math.sqrt(dot(b.W[k], b.W[k], n)), n)
        b.remain[k] = -1.0
        for c in range(p.planes, K):
            if b.remain[c] >= 0.0:
                remove(b, c, q, q + 1, n)
                b.remain[c] = max(b.remain[c] - b.L[c, q] * b.L[c, q], 0.0)
                if b.remain[c] < DOUBTFUL * b.whole[c]:
                    b.remain[c] = dot(b.W[c], b.W[c], n)
    return planes + p.task


@inline
def back(p, first, end, out, sign, lower):
    """Compute the multipliers of the rows from which basis vectors number first to end - 1 were made, by back-substitution.

    L and off are those of p.b (`Basis`). The system is L' out = -sign off; out (K + N,) receives the multipliers. sign: 1 for the
    second objective, 0 for the first, whose right side is zero. lower: whether `out` already holds the multipliers of the task
    rows; their contribution is then subtracted.
    """
    b = p.b
    for j in range(end - 1, first - 1, -1):
        k = b.order[j]
        s = -b.off[j] if sign > 0.0 else 0.0
        for h in range(j + 1, end):
            s -= b.L[b.order[h], j] * out[slot(p, b.order[h])]
        if lower:
            for c in range(p.planes, p.planes + p.task):
                s -= b.L[c, j] * out[slot(p, c)]
        out[slot(p, k)] = s / b.L[k, j]


@inline
def equality(p, last):
    """Solve both objectives for y with all active constraints as equalities; write p.y and the new multipliers p.new.

    p: `TwoLevels`. last: the inequality that is added to the basis after all others, or NONE. Returns NONE if y was found.
    Otherwise nothing is solved, and the index of an active inequality that depends linearly on the others is returned (`last` if it
    does).
    """
    b = p.b
    n, K = p.size, p.planes + p.task
    for c in range(K + n):
        p.new.first[c], p.new.second[c] = 0.0, 0.0
    for i in range(n):
        side = p.active[p.planes + i]
        p.y[i] = p.floor[i] if side < 0 else p.roof[i] if side > 0 else 0.0
    planes, dependent = basis_of_planes(p, last)
    if dependent != NONE:
        return dependent
    q = basis_of_task(p, planes)
    for k in range(K):
        b.rest[k] = p.rhs[k] - dot(p.P[k], p.y, n)
    full = q - planes == p.task
    for j in range(q if full else planes):
        k = b.order[j]
        b.along[j] = (b.rest[k] - dot(b.L[k], b.along, j)) / b.L[k, j]
    if not full:
        least_squares(p, planes, q - planes)
    for j in range(q):
        b.off[j] = b.along[j] - dot(b.W[b.order[j]], p.want, n)
    for i in range(n):
        if is_free(p, i):
            s = p.want[i]
            for j in range(q):
                s += b.off[j] * b.W[b.order[j], i]
            p.y[i] = s
    noise = 0.0
    if full:
        back(p, planes, q, p.new.second, 1.0, False)
    else:
        closeness_of_task(p, planes, q - planes)
        noise = residual(p)
        back(p, 0, planes, p.new.first, 0.0, True)
    back(p, 0, planes, p.new.second, 1.0, True)
    price_bounds(p, noise)
    return NONE


@inline
def price_bounds(p, noise):
    """Compute the multipliers of the active bounds of p (`TwoLevels`); a part `first` of a multiplier up to `noise` becomes 0."""
    first, second = p.new.first[p.planes :], p.new.second[p.planes :]
    for i in range(p.size):
        first[i], second[i] = 0.0, p.want[i] - p.y[i]
    for k in range(p.planes + p.task):
        one, two = p.new.first[slot(p, k)], p.new.second[slot(p, k)]
        if one != 0.0 or two != 0.0:
            add_multiple(first, -one, p.P[k], p.size)
            add_multiple(second, -two, p.P[k], p.size)
    for i in range(p.size):
        if is_free(p, i):
            first[i], second[i] = 0.0, 0.0
    for c in range(p.planes + p.size):
        if abs(p.new.first[c]) <= noise:
            p.new.first[c] = 0.0


@inline
def least_squares(p, planes, rank):
    """Solve linearly dependent task rows for y by least squares; write y in basis coordinates to b.along.

    planes: number of basis vectors from active inequalities, which come first; rank: number of basis vectors from task rows. The
    scratch U (see `Basis`) receives the QR factors.
    """
    b, m = p.b, p.task
    U, R, rest, along = b.U, b.U[p.planes + m :], b.rest[p.planes :], b.along[planes:]
    for k in range(m):
        rest[k] -= dot(b.L[p.planes + k], b.along, planes)
    for j in range(rank):
        for h in range(rank):
            R[h, j] = 0.0
        for k in range(m):
            U[j, k] = b.L[p.planes + k, planes + j]
        whole, left = dot(U[j], U[j], m), 0.0
        for _ in range(2):
            for h in range(j):
                s = dot(U[h], U[j], m)
                add_multiple(U[j], -s, U[h], m)
                R[h, j] += s
            left = dot(U[j], U[j], m)
            if left >= CLEAR * whole:
                break
        R[j, j] = size = math.sqrt(left)
        for k in range(m):
            U[j, k] /= size
        along[j] = s = dot(U[j], rest, m)
        add_multiple(rest, -s, U[j], m)
    for j in range(rank - 1, -1, -1):
        s = along[j]
        for h in range(j + 1, rank):
            s -= R[j, h] * along[h]
        along[j] = s / R[j, j]


@inline
def closeness_of_task(p, planes, rank):
    """Write the multipliers of linearly dependent task rows for the second objective to p.new; of the many possible, the shortest.

    planes: number of basis vectors from inequalities; rank: number of basis vectors from task rows.
    """
    b, K = p.b, p.planes + p.task
    for j in range(rank):  # forward substitution with the triangular factor R, stored in b.U: R' along = -off
        s = -b.off[planes + j]
        for h in range(j):
            s -= b.U[K + h, j] * b.along[h]
        b.along[j] = s / b.U[K + j, j]
    for c in range(p.task):
        for j in range(rank):
            p.new.second[p.planes + p.size + c] += b.U[j, c] * b.along[j]


@inline
def residual(p):
    """Write the residuals P y - rhs of the task rows (0 if all are rounding) to p.new; return a bound on the multipliers' rounding.

    The bound is the sum, over the task rows, of the residual's rounding error times the row's length.
    """
    size, terms, noise, first = 0.0, 0.0, 0.0, p.planes + p.size
    for c in range(p.task):
        k = p.planes + c
        s, t = -p.rhs[k], abs(p.rhs[k])
        for i in range(p.size):
            s += p.P[k, i] * p.y[i]
            t += abs(p.P[k, i] * p.y[i])
        p.new.first[first + c] = s
        size = max(size, abs(s))
        terms = max(terms, t)
        noise += ROUNDING * t * p.length[k]
    if size <= ROUNDING * terms:
        for c in range(p.task):
            p.new.first[first + c] = 0.0
    return noise
