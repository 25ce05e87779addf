"""Factorisations of small matrices: LU by rows, and Householder's QR with columns chosen by length."""

import math

from ...compile.jit import inner
from .terms import TRUST


@inner
def lu_factor(M, swaps, m):
    """Replace M (m, m) by its factors L and U, P M = L U, with the largest pivot of each column; swaps (m,): the rows exchanged."""
    largest = 0.0
    for k in range(m):
        at, best = k, abs(M[k, k])
        for i in range(k + 1, m):
            if abs(M[i, k]) > best:
                at, best = i, abs(M[i, k])
        swaps[k] = at
        if at != k:
            for j in range(m):
                M[k, j], M[at, j] = M[at, j], M[k, j]
        largest = max(largest, best)
        if best <= TRUST.faint * largest:
            M[k, k] = max(TRUST.faint * largest, 1e-300)
        share = 1.0 / M[k, k]
        for i in range(k + 1, m):
            if M[i, k] != 0.0:
                M[i, k] *= share
                f = M[i, k]
                for j in range(k + 1, m):
                    M[i, j] -= f * M[k, j]


@inner
def lu_substitute(M, swaps, x, m):
    """Replace x (m,) by the solution of a system that `lu_factor` has factored."""
    for k in range(m):
        at = swaps[k]
        x[k], x[at] = x[at], x[k]
    for i in range(m):
        for j in range(i):
            x[i] -= M[i, j] * x[j]
    for i in range(m - 1, -1, -1):
        v = x[i]
        for j in range(i + 1, m):
            v -= M[i, j] * x[j]
        x[i] = v / M[i, i]


@inner
def reflect_row(V, scales, k, row):
    """Apply the k-th reflection of `triangle` to row (m,): row -= scale (v . row) v, with v_k = 1 and v_i = 0 before it."""
    v = V[k]
    total = row[k]
    for n in range(k + 1, row.shape[0]):
        total += v[n] * row[n]
    total *= scales[k]
    row[k] -= total
    for n in range(k + 1, row.shape[0]):
        row[n] -= total * v[n]


@inner
def triangle(V, scales, order, share):
    """Factor the matrix whose columns are the rows of V (k, m) by Householder's QR, always with the longest column left.

    R stands on and before the diagonal of each row of V, the reflections' vectors behind it; order (k,): the columns as they were
    taken. Returns the rank: a column shorter than `share` of the first counts as none.
    """
    count, m = V.shape
    first = 0.0
    for c in range(count):
        order[c] = c
    for k in range(count):
        at, best = k, -1.0
        for c in range(k, count):
            total = 0.0
            for n in range(k, m):
                total += V[c, n] * V[c, n]
            if total > best:
                at, best = c, total
        if at != k:
            for n in range(m):
                V[k, n], V[at, n] = V[at, n], V[k, n]
            order[k], order[at] = order[at], order[k]
        length = math.sqrt(best)
        first = max(first, length)
        if length <= share * first:
            return k
        end = -length if V[k, k] > 0.0 else length
        v = V[k, k] - end
        total = v * v
        for n in range(k + 1, m):
            total += V[k, n] * V[k, n]
            V[k, n] /= v
        scales[k] = 2.0 * v * v / total
        for c in range(k + 1, count):
            reflect_row(V, scales, k, V[c])
        V[k, k] = end
    return count
