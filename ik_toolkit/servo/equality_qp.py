"""Two objectives, the second subject to the first, with the active constraints as equalities: one iteration of hierarchical_qp.py.

Solved from scratch each time, by Gram-Schmidt with pivots and a second pass, at a cost of N r^2: errors do not accumulate.

The arrays of a `Levels` are passed one by one, since records are expensive to pass. Rows of P: half-planes, each of norm 1, then C.
Singular directions of a task, whose rows are orthogonal, are damped one by one before (`truncate` and its like).
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.array_view import LINE, cut
from ..compile.jit import compiled, inline, inner, spliced
from ..kernel.linalg import cholesky
from ..kernel.records import Array

Y, WANT, LOW, HIGH, ONE, TWO, NEXT_ONE, NEXT_TWO = range(8)  # rows of V
RHS, REST, SIZE, Z, H, NORM, ROW_ONE, ROW_TWO, AFTER_ONE, AFTER_TWO, TASK_ONE, TASK_TWO = range(12)  # rows of S
NONE = -1
SAME = 1e-10  # share of a row's length that remains after the others are removed, below which it depends on them
CLEAR = 0.5  # share of a row's square that remains, from which on one pass is enough (Daniel et al., 1976, for 0.1 of its length)
DOUBTFUL = 1e-6  # share of it below which what is left of it is no longer told by subtraction
ROUNDING = 1e-13  # share of its terms below which a sum is rounding


@compiled
class Levels(NamedTuple):
    """A problem of up to N unknowns and K rows (half-planes first, then those of the task), and its scratch."""

    P: Array  # (K, N) rows
    W: Array  # (K, N) the same, of free unknowns, made orthonormal
    L: Array  # (K, K) row k of P is the sum of L[k, j] times basis vector j
    U: Array  # (2 K, K) columns of L made orthonormal, and their coefficients
    V: Array  # (8, N) vectors
    S: Array  # (12, K) numbers of a row
    state: Array  # (N + K,) int8 of the unknowns -1 at low, 1 at high, 0 free; of the half-planes 1 holds
    order: Array  # (K,) int64 row that gave each basis vector


@inline
def levels_space(N, K):
    """Length of a block that has room for `Levels`."""
    return 2 * K * N + 3 * K * K + 9 * N + 14 * K + 9 * LINE


@spliced
def levels_on(block, N, K):
    """Room for N unknowns and K rows, cut from a block of zeros."""
    numbers = cut(block, np.float64, ((K, N), (K, N), (K, K), (2 * K, K), (8, N), (12, K)))
    return Levels(*numbers, *cut(block, np.int8, (N + K,)), *cut(block, np.int64, (K,)))


@inline
def dot(A, i, B, j, n):
    """Product of row i of A and row j of B, over their first n places."""
    s = 0.0
    for k in range(n):
        s += A[i, k] * B[j, k]
    return s


@inline
def take_out(W, L, order, row, j, N):
    """Subtract from row `row` of W its part along basis vector j, and add that to L."""
    base = order[j]
    s = dot(W, row, W, base, N)
    for i in range(N):
        W[row, i] -= s * W[base, i]
    L[row, j] += s


@inner
def span(P, W, L, S, state, order, N, count, r, last):
    """Orthonormal basis of the rows among free unknowns: half-planes that hold, `last` at the end, then the task.

    Returns the numbers of basis vectors from half-planes and from all, and a half-plane that depends on the others, or NONE.
    """
    K, rows = count + r, P.shape[1]
    for k in range(K):
        if k >= count or state[rows + k] != 0:
            for i in range(N):
                W[k, i] = P[k, i] if state[i] == 0 else 0.0
            for j in range(K):
                L[k, j] = 0.0
    q = 0
    dependent = NONE
    for place in range(count + 1):
        k = place if place < count else last
        if k < 0 or state[rows + k] == 0 or (place < count and k == last):
            continue
        for _ in range(2):
            for j in range(q):
                take_out(W, L, order, k, j, N)
        size = math.sqrt(dot(W, k, W, k, N))
        if size <= SAME:
            dependent = k
            continue
        L[k, q] = size
        for i in range(N):
            W[k, i] /= size
        order[q] = k
        q += 1
    planes = q
    largest = 0.0
    for k in range(count, K):
        largest = max(largest, S[NORM, k])
        S[H, k] = dot(W, k, W, k, N)
        for j in range(planes):
            take_out(W, L, order, k, j, N)
        S[SIZE, k] = dot(W, k, W, k, N)
    for _ in range(r):
        k = count
        for c in range(count + 1, K):
            if S[SIZE, c] > S[SIZE, k]:
                k = c
        if not S[SIZE, k] > SAME * SAME * largest * largest:
            break
        if S[SIZE, k] < CLEAR * S[H, k]:
            for j in range(q):
                take_out(W, L, order, k, j, N)
        S[SIZE, k] = dot(W, k, W, k, N)
        size = math.sqrt(S[SIZE, k])
        L[k, q] = size
        for i in range(N):
            W[k, i] /= size
        order[q] = k
        S[SIZE, k] = -1.0
        for c in range(count, K):
            if S[SIZE, c] >= 0.0:
                take_out(W, L, order, c, q, N)
                S[SIZE, c] = max(S[SIZE, c] - L[c, q] * L[c, q], 0.0)
                if S[SIZE, c] < DOUBTFUL * S[H, c]:
                    S[SIZE, c] = dot(W, c, W, c, N)
        q += 1
    return planes, q, dependent


@inner
def back(L, order, S, first, end, target, source, out, count, r, lower):
    """Multipliers S[out] of the half-planes from those of the task, S[source]: L00' out = -target - L10' source."""
    for j in range(end - 1, first - 1, -1):
        k = order[j]
        s = -S[target, j] if target >= 0 else 0.0
        for h in range(j + 1, end):
            s -= L[order[h], j] * S[out, order[h]]
        if lower:
            for c in range(count, count + r):
                s -= L[c, j] * S[source, c]
        S[out, k] = s / L[k, j]


@inner
def equality(P, W, L, U, V, S, state, order, N, count, r, last):
    """The two objectives with what holds held as equalities: V[Y] and the multipliers, V and S of NEXT_ and AFTER_.

    Returns NONE, or a half-plane that depends on the other active ones (`last` if it does); then no solution is found.
    """
    K = count + r
    for k in range(K):
        S[AFTER_ONE, k] = 0.0
        S[AFTER_TWO, k] = 0.0
        S[TASK_ONE, k] = 0.0
        S[TASK_TWO, k] = 0.0
    for i in range(N):
        V[Y, i] = V[LOW, i] if state[i] < 0 else V[HIGH, i] if state[i] > 0 else 0.0
    planes, q, dependent = span(P, W, L, S, state, order, N, count, r, last)
    if dependent != NONE:
        return dependent
    for k in range(K):
        S[REST, k] = S[RHS, k] - dot(P, k, V, Y, N)
    full = q - planes == r
    for j in range(q if full else planes):
        k = order[j]
        s = S[REST, k]
        for h in range(j):
            s -= L[k, h] * S[Z, h]
        S[Z, j] = s / L[k, j]
    if not full:
        least_squares(L, U, S, count, r, planes, q)
    for j in range(q):
        S[H, j] = S[Z, j] - dot(W, order[j], V, WANT, N)
    for i in range(N):
        if state[i] == 0:
            s = V[WANT, i]
            for j in range(q):
                s += S[H, j] * W[order[j], i]
            V[Y, i] = s
    noise = 0.0
    if full:
        back(L, order, S, planes, q, H, NONE, TASK_TWO, count, r, False)
    else:
        rank = q - planes
        for j in range(rank):  # U' coefficients = -H
            s = -S[H, planes + j]
            for h in range(j):
                s -= U[K + h, j] * S[Z, h]
            S[Z, j] = s / U[K + j, j]
        for k in range(r):
            s = 0.0
            for j in range(rank):
                s += U[j, k] * S[Z, j]
            S[TASK_TWO, count + k] = s
        noise = residual(P, V, S, N, count, r)
        back(L, order, S, 0, planes, NONE, TASK_ONE, AFTER_ONE, count, r, True)
    back(L, order, S, 0, planes, H, TASK_TWO, AFTER_TWO, count, r, True)
    for i in range(N):
        V[NEXT_ONE, i] = 0.0
        V[NEXT_TWO, i] = V[WANT, i] - V[Y, i]
    for k in range(K):
        one, two = (S[AFTER_ONE, k], S[AFTER_TWO, k]) if k < count else (S[TASK_ONE, k], S[TASK_TWO, k])
        if one == 0.0 and two == 0.0:
            continue
        for i in range(N):
            V[NEXT_ONE, i] -= P[k, i] * one
            V[NEXT_TWO, i] -= P[k, i] * two
    for i in range(N):
        if state[i] == 0:
            V[NEXT_TWO, i] = 0.0
        if state[i] == 0 or abs(V[NEXT_ONE, i]) <= noise:
            V[NEXT_ONE, i] = 0.0
    for k in range(count):
        if abs(S[AFTER_ONE, k]) <= noise:
            S[AFTER_ONE, k] = 0.0
    return NONE


@inner
def least_squares(L, U, S, count, r, planes, q):
    """S[Z] of the task's basis vectors where its rows are dependent; U, its lower half the coefficients."""
    K, rank = count + r, q - planes
    for k in range(count, K):
        for h in range(planes):
            S[REST, k] -= L[k, h] * S[Z, h]
    for j in range(rank):
        for h in range(rank):
            U[K + h, j] = 0.0
        for k in range(r):
            U[j, k] = L[count + k, planes + j]
        whole, left = dot(U, j, U, j, r), 0.0
        for _ in range(2):
            for h in range(j):
                s = dot(U, h, U, j, r)
                for k in range(r):
                    U[j, k] -= s * U[h, k]
                U[K + h, j] += s
            left = dot(U, j, U, j, r)
            if left >= CLEAR * whole:
                break
        size = math.sqrt(left)
        U[K + j, j] = size
        s = 0.0
        for k in range(r):
            U[j, k] /= size
            s += U[j, k] * S[REST, count + k]
        for k in range(r):
            S[REST, count + k] -= s * U[j, k]
        S[Z, planes + j] = s
    for j in range(rank - 1, -1, -1):
        s = S[Z, planes + j]
        for h in range(j + 1, rank):
            s -= U[K + j, h] * S[Z, planes + h]
        S[Z, planes + j] = s / U[K + j, j]


@inner
def residual(P, V, S, N, count, r):
    """S[TASK_ONE] = C y - d, zero where that is rounding; what of its products with columns of C is rounding."""
    size, terms, noise = 0.0, 0.0, 0.0
    for k in range(count, count + r):
        s, t = -S[RHS, k], abs(S[RHS, k])
        for i in range(N):
            s += P[k, i] * V[Y, i]
            t += abs(P[k, i] * V[Y, i])
        S[TASK_ONE, k] = s
        size = max(size, abs(s))
        terms = max(terms, t)
        noise += ROUNDING * t * S[NORM, k]
    if size <= ROUNDING * terms:
        for k in range(count, count + r):
            S[TASK_ONE, k] = 0.0
    return noise


@inner
def from_rest(V, S, n, count):
    """Let the joints stand still, too: their present motion must not decide which directions are possible. True: a change."""
    changed = False
    for i in range(n):
        changed = changed or V[LOW, i] > 0.0 or V[HIGH, i] < 0.0
        V[LOW, i] = min(V[LOW, i], 0.0)
        V[HIGH, i] = max(V[HIGH, i], 0.0)
    for k in range(count):
        changed = changed or S[RHS, k] < 0.0
        S[RHS, k] = max(S[RHS, k], 0.0)
    return changed


FLAT = 1e-9  # share of the largest singular value below which a direction does not exist
DEPENDENT = 1e-12  # and from which on rows are rotated to see, squared: P P' says nothing below the root of rounding


@inner
def regular(P, L, first, r, n, least):
    """Whether the task's rows are independent and all their singular values above `least`; surely so, but not always when so.

    The largest eigenvalue of the inverse of P P' is below its trace.
    """
    top = 0.0
    for k in range(r):
        for c in range(k + 1):
            L[k, c] = dot(P, first + k, P, first + c, n)
        top = max(top, L[k, k])
    cholesky(L, r, 0.5 * DEPENDENT * top)  # a pivot lifted to this answers the question
    trace = 0.0
    for c in range(r):  # columns of the inverse of the factor, kept above the diagonal
        for k in range(c, r):
            s = 1.0 if k == c else 0.0
            for j in range(c, k):
                s -= L[k, j] * L[c, j + 1]
            s /= L[k, k]
            L[c, k + 1] = s
            trace += s * s
    return trace * max(least * least, DEPENDENT * top) < 1.0


@inner
def damp(P, V, S, task, first, r, n, singular, damping, cap, cut):
    """Damp each singular direction towards the wanted rate, inside the box, and cut the feed-forward along it. Rows left.

    s^2 (u'y - d / s)^2 + l^2 (u'y - w)^2 is one row again: of length sqrt(s^2 + l^2), asked (s d + l^2 w) / sqrt(s^2 + l^2).
    """
    top = 0.0
    for k in range(first, first + r):
        top = max(top, dot(P, k, P, k, n))
    kept = first
    for k in range(first, first + r):
        size = math.sqrt(dot(P, k, P, k, n))
        if not size > FLAT * math.sqrt(top):
            continue
        fade = 1.0 - (size / singular) ** 2 if size < singular else 0.0
        extra = (damping * fade) ** 2
        length = math.sqrt(size * size + extra)
        wanted = 0.0
        for i in range(n):
            wanted += P[k, i] * min(max(V[WANT, i], V[LOW, i]), V[HIGH, i])
        wanted /= size
        for i in range(n):
            P[kept, i] = P[k, i] * (length / size)
        task[kept, 0] = (size * task[k, 0] + extra * wanted) / length
        task[kept, 1] = size * task[k, 1] * (1.0 - cut * fade) / length
        S[RHS, kept] = task[kept, 0] + cap * task[kept, 1]
        kept += 1
    return kept - first
