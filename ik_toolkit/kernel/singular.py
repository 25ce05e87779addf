"""Singular directions of a task, whose rows are orthogonal: damped one by one. Scratch as in levels.py."""

import math

from .jit import inner
from .levels import HIGH, LOW, RHS, WANT, dot
from .linalg import cholesky

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
