"""Singular directions of a task: found by rotating its rows, damped one by one. Scratch as in levels.py."""

import math

from .jit import inline, inner
from .levels import HIGH, LOW, RHS, WANT, dot
from .linalg import NOISE, ORTHOGONAL, SWEEPS, cholesky, jacobi

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
def rotate(P, task, first, r, n):
    """Turn the task's rows, and what is asked, so that the rows are orthogonal (Hestenes): singular values times directions."""
    longest = 0.0
    for k in range(first, first + r):
        longest = max(longest, dot(P, k, P, k, n))
    noise = NOISE * NOISE * longest
    for _ in range(SWEEPS):
        rotated = False
        for a in range(first, first + r - 1):
            for c in range(a + 1, first + r):
                p, q, g = dot(P, a, P, a, n), dot(P, c, P, c, n), dot(P, a, P, c, n)
                if not abs(g) > ORTHOGONAL * math.sqrt(p * q) or min(p, q) <= noise:
                    continue
                rotated = True
                cs, sn = jacobi(p, q, g)
                turn(P, a, c, cs, sn, n)
                for k in range(2):
                    u, v = task[k, a], task[k, c]
                    task[k, a] = cs * u - sn * v
                    task[k, c] = sn * u + cs * v
        if not rotated:
            break


@inline
def turn(P, a, c, cs, sn, n):
    """Rotate two rows into each other."""
    for i in range(n):
        u, v = P[a, i], P[c, i]
        P[a, i] = cs * u - sn * v
        P[c, i] = sn * u + cs * v


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
        task[0, kept] = (size * task[0, k] + extra * wanted) / length
        task[1, kept] = size * task[1, k] * (1.0 - cut * fade) / length
        S[RHS, kept] = task[0, kept] + cap * task[1, kept]
        kept += 1
    return kept - first
