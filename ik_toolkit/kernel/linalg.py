"""Small dense solves that allocate nothing: the damped 6x6 step, a general Cholesky and a Jacobi pseudo-inverse."""

import math

from .jit import inline, jit


@inline
def factors3(a, b, c, d, e, f):
    """L D L' of the symmetric [[a, b, c], [b, d, e], [c, e, f]]: l10, l20, l21 and the inverses of the three pivots.

    Not the inverse by cofactors: where the matrix is little but damping, as the rotations of joints that all turn about one
    axis, its entries are 1 over the damping and what they are multiplied with cancels, down to rounding.
    """
    i0 = 1.0 / a
    l10, l20 = b * i0, c * i0
    i1 = 1.0 / (d - l10 * b)
    m = e - l10 * c
    l21 = m * i1
    return l10, l20, l21, i0, i1, 1.0 / (f - l20 * c - l21 * m)


@inline
def solve_blocks(
    p00, p10, p11, p20, p21, p22, s00, s10, s11, s20, s21, s22, q00, q01, q02, q10, q11, q12, q20, q21, q22,
    e0, e1, e2, e3, e4, e5,
):  # fmt: skip
    """Solve [[P, Q'], [Q, S]] y = e with symmetric P and S (3, 3), by the complement of S; numbers or vectors."""
    l10, l20, l21, i0, i1, i2 = factors3(s00, s10, s20, s11, s21, s22)
    q10, q11, q12, e4 = q10 - l10 * q00, q11 - l10 * q01, q12 - l10 * q02, e4 - l10 * e3
    q20, q21, q22 = q20 - l20 * q00 - l21 * q10, q21 - l20 * q01 - l21 * q11, q22 - l20 * q02 - l21 * q12
    e5 = e5 - l20 * e3 - l21 * e4
    g00, g01, g02 = i0 * q00, i0 * q01, i0 * q02
    g10, g11, g12 = i1 * q10, i1 * q11, i1 * q12
    g20, g21, g22 = i2 * q20, i2 * q21, i2 * q22
    p00 = p00 - (q00 * g00 + q10 * g10 + q20 * g20)
    p10 = p10 - (q01 * g00 + q11 * g10 + q21 * g20)
    p11 = p11 - (q01 * g01 + q11 * g11 + q21 * g21)
    p20 = p20 - (q02 * g00 + q12 * g10 + q22 * g20)
    p21 = p21 - (q02 * g01 + q12 * g11 + q22 * g21)
    p22 = p22 - (q02 * g02 + q12 * g12 + q22 * g22)
    k10, k20, k21, h0, h1, h2 = factors3(p00, p10, p20, p11, p21, p22)
    b0 = e0 - (g00 * e3 + g10 * e4 + g20 * e5)
    b1 = e1 - (g01 * e3 + g11 * e4 + g21 * e5) - k10 * b0
    b2 = e2 - (g02 * e3 + g12 * e4 + g22 * e5) - k20 * b0 - k21 * b1
    y2 = b2 * h2
    y1 = b1 * h1 - k21 * y2
    y0 = b0 * h0 - k10 * y1 - k20 * y2
    y5 = i2 * e5 - (g20 * y0 + g21 * y1 + g22 * y2)
    y4 = i1 * e4 - (g10 * y0 + g11 * y1 + g12 * y2) - l21 * y5
    y3 = i0 * e3 - (g00 * y0 + g01 * y1 + g02 * y2) - l10 * y4 - l20 * y5
    return y0, y1, y2, y3, y4, y5


@inline
def damped(J, w, dq, e, damping):
    """dq = W J' (J W J' + damping)^-1 e with joint weights w (0 holds a joint); two 3x3 blocks instead of one 6x6."""
    p00, p11, p22 = damping, damping, damping
    p10, p20, p21 = 0.0, 0.0, 0.0
    s00, s11, s22 = damping, damping, damping
    s10, s20, s21 = 0.0, 0.0, 0.0
    q00, q01, q02 = 0.0, 0.0, 0.0
    q10, q11, q12 = 0.0, 0.0, 0.0
    q20, q21, q22 = 0.0, 0.0, 0.0
    for i in range(J.shape[0]):
        if w[i] > 0.0:
            j0, j1, j2, j3, j4, j5 = J[i, 0], J[i, 1], J[i, 2], J[i, 3], J[i, 4], J[i, 5]
            a0, a1, a2 = w[i] * j0, w[i] * j1, w[i] * j2
            a3, a4, a5 = w[i] * j3, w[i] * j4, w[i] * j5
            p00 += a0 * j0
            p10 += a1 * j0
            p11 += a1 * j1
            p20 += a2 * j0
            p21 += a2 * j1
            p22 += a2 * j2
            s00 += a3 * j3
            s10 += a4 * j3
            s11 += a4 * j4
            s20 += a5 * j3
            s21 += a5 * j4
            s22 += a5 * j5
            q00 += a3 * j0
            q01 += a3 * j1
            q02 += a3 * j2
            q10 += a4 * j0
            q11 += a4 * j1
            q12 += a4 * j2
            q20 += a5 * j0
            q21 += a5 * j1
            q22 += a5 * j2
    y0, y1, y2, y3, y4, y5 = solve_blocks(
        p00, p10, p11, p20, p21, p22, s00, s10, s11, s20, s21, s22, q00, q01, q02, q10, q11, q12, q20, q21, q22,
        e.e0, e.e1, e.e2, e.e3, e.e4, e.e5,
    )  # fmt: skip
    for i in range(J.shape[0]):
        dq[i] = w[i] * (J[i, 0] * y0 + J[i, 1] * y1 + J[i, 2] * y2 + J[i, 3] * y3 + J[i, 4] * y4 + J[i, 5] * y5)


@jit
def pseudo_inverse_step(J, e, rcond, V, dq):
    """dq = pinv(J') e by one-sided Jacobi (Hestenes): singular values below rcond * the largest count as zero.

    J (n, 6), one joint a row, is overwritten by U S; V (6, 6) is scratch, e (6,) the error. Returns the largest singular
    value and the largest |dq| numerator, so that a caller can tell "no direction left" (second value 0) from a step.
    """
    n = J.shape[0]
    for r in range(6):
        for c in range(6):
            V[r, c] = 1.0 if r == c else 0.0
    for _ in range(40):
        rotated = False
        for r in range(5):
            for c in range(r + 1, 6):
                a, b, g = 0.0, 0.0, 0.0
                for i in range(n):
                    a += J[i, r] * J[i, r]
                    b += J[i, c] * J[i, c]
                    g += J[i, r] * J[i, c]
                if abs(g) <= 1e-15 * math.sqrt(a * b) or abs(g) < 1e-300:
                    continue
                rotated = True
                z = (b - a) / (2.0 * g)
                t = (1.0 if z >= 0.0 else -1.0) / (abs(z) + math.sqrt(1.0 + z * z))
                cs = 1.0 / math.sqrt(1.0 + t * t)
                sn = t * cs
                for i in range(n):
                    u, v = J[i, r], J[i, c]
                    J[i, r] = cs * u - sn * v
                    J[i, c] = sn * u + cs * v
                for k in range(6):
                    u, v = V[k, r], V[k, c]
                    V[k, r] = cs * u - sn * v
                    V[k, c] = sn * u + cs * v
        if not rotated:
            break
    top = 0.0
    for r in range(6):
        a = 0.0
        for i in range(n):
            a += J[i, r] * J[i, r]
        top = max(top, a)
    for i in range(n):
        dq[i] = 0.0
    used = 0.0
    for r in range(6):
        a = 0.0
        for i in range(n):
            a += J[i, r] * J[i, r]
        if a > rcond * rcond * top and a > 0.0:
            g = 0.0
            for k in range(6):
                g += V[k, r] * e[k]
            used = max(used, abs(g))
            for i in range(n):
                dq[i] += J[i, r] * (g / a)
    return math.sqrt(top), used


@jit
def lu_solve(A, b, m):
    """Solve the leading m x m system in place by partial pivoting; False when a pivot is below 1e-10 of the largest entry."""
    top = 0.0
    for i in range(m):
        for j in range(m):
            top = max(top, abs(A[i, j]))
    for k in range(m):
        pivot = k
        for i in range(k + 1, m):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        if not abs(A[pivot, k]) > 1e-10 * top:
            return False
        if pivot != k:
            for j in range(m):
                A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
            b[k], b[pivot] = b[pivot], b[k]
        for i in range(k + 1, m):
            f = A[i, k] / A[k, k]
            for j in range(k, m):
                A[i, j] -= f * A[k, j]
            b[i] -= f * b[k]
    for k in range(m - 1, -1, -1):
        s = b[k]
        for j in range(k + 1, m):
            s -= A[k, j] * b[j]
        b[k] = s / A[k, k]
    return True
