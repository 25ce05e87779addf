"""Small dense linear algebra without memory allocation: damped least squares, Cholesky, LU, and Jacobi pseudo-inverse."""

import math

from ..compile.jit import inline, inner
from .algebra import V3, diagonal
from .records import copy
from .vectors import clear, dot, dot_of_columns, dot_with_column

TINY = 1e-300  # smallest pivot that a factorisation uses: its square root and the inverse of that are still finite
SWEEPS = 40  # highest number of sweeps of Jacobi rotations; six columns need about ten, as convergence is quadratic
ORTHOGONAL = 1e-15  # two columns (or rows) are orthogonal if the cosine of their angle is below this, which is rounding
# A column shorter than this share of the longest is only rounding and has no direction; the rotations would never end.
NOISE = 1e-15
FLAT = 1e-10  # a matrix is singular if a pivot is below this share of its largest entry


@inline
def damped(J, w, dq, linear, angular, damping):
    """Write to dq (n,) the damped step W J' (J W J' + damping)^-1 e for six errors e = (linear, angular), solved by 3x3 blocks.

    The array J (n, 6) is the transposed Jacobian, with one joint a row. w (n,): joint weights, the diagonal of W; a weight of 0
    holds the joint.
    """
    blocks = diagonal(damping)
    for i in range(J.shape[0]):
        if w[i] > 0.0:
            u, v = V3(J[i, 0], J[i, 1], J[i, 2]), V3(J[i, 3], J[i, 4], J[i, 5])
            blocks = blocks.with_column(u * w[i], v * w[i], u, v)
    y, z = blocks.solve(linear, angular)
    for i in range(J.shape[0]):
        dq[i] = w[i] * (V3(J[i, 0], J[i, 1], J[i, 2]).dot(y) + V3(J[i, 3], J[i, 4], J[i, 5]).dot(z))


@inner
def cholesky(A, m, least):
    """Replace the lower half of the leading m x m part of A by its Cholesky factor, with the inverses of the diagonal.

    `least` is the smallest pivot: pivots below it become `least`.
    """
    for j in range(m):
        s = A[j, j]
        for k in range(j):
            s -= A[j, k] * A[j, k]
        A[j, j] = inverse = 1.0 / math.sqrt(max(s, least))
        for i in range(j + 1, m):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = s * inverse


@inner
def cholesky_solve(A, m, y):
    """Replace y (m,) by the solution x of A x = y, where `cholesky` has replaced the matrix A (m, m) by its factor."""
    for j in range(m):
        s = y[j]
        for k in range(j):
            s -= A[j, k] * y[k]
        y[j] = s * A[j, j]
    for j in range(m - 1, -1, -1):
        s = y[j]
        for k in range(j + 1, m):
            s -= A[k, j] * y[k]
        y[j] = s * A[j, j]


@inner
def damped_stack(J, moves, w, dq, e, damping, A, y):
    """Write to dq (n,) the damped step W J' (J W J' + damping)^-1 e for m errors e, six for each of F tips.

    The array J (n, m) is the transposed Jacobian, with one joint a row; moves (F, n): 1 if a tip's six entries of a joint's row are
    not zero. w (n,): joint weights, the diagonal of W; a weight of 0 holds the joint. A (m, m) and y (m,) are scratch.
    """
    n, m = J.shape
    F = m // 6
    copy(e, y)
    for r in range(m):
        clear(A[r])
        A[r, r] = damping
    for i in range(n):
        if w[i] > 0.0:
            for f in range(F):
                if moves[f, i] > 0.0:
                    for g in range(f + 1):
                        if moves[g, i] > 0.0:
                            for r in range(6 * f, 6 * f + 6):
                                v = w[i] * J[i, r]
                                for k in range(6 * g, 6 * g + 6):
                                    A[r, k] += v * J[i, k]
    cholesky(A, m, TINY)
    cholesky_solve(A, m, y)
    for i in range(n):
        dq[i] = w[i] * dot(J[i], y, m)


@inline
def jacobi(a, b, g):
    """Return the cosine and sine of the Jacobi rotation that makes two columns orthogonal.

    a, b: squared lengths of the columns; g: their dot product.
    """
    d = b - a
    t = (2.0 * g if d >= 0.0 else -2.0 * g) / (abs(d) + math.sqrt(d * d + 4.0 * g * g))
    cosine = 1.0 / math.sqrt(1.0 + t * t)
    return cosine, t * cosine


@inline
def rotate(x, y, cosine, sine, n):
    """Rotate the first n numbers of two vectors in place by a Jacobi rotation."""
    for i in range(n):
        u, v = x[i], y[i]
        x[i], y[i] = cosine * u - sine * v, sine * u + cosine * v


@inline
def make_orthogonal(A, V, m):
    """Write to V (m, m) a rotation for which A V has orthogonal columns, and replace A (n, m) by A V (Hestenes' Jacobi method).

    The function is faster if m is a constant at compile time.
    """
    n, longest = A.shape[0], 0.0
    for r in range(m):
        longest = max(longest, dot_of_columns(A, r, A, r, n))
        for c in range(m):
            V[r, c] = 1.0 if r == c else 0.0
    noise = NOISE * NOISE * longest
    for _ in range(SWEEPS):
        rotated = False
        for r in range(m - 1):
            for c in range(r + 1, m):
                a, b, g = 0.0, 0.0, 0.0
                for i in range(n):
                    a += A[i, r] * A[i, r]
                    b += A[i, c] * A[i, c]
                    g += A[i, r] * A[i, c]
                if abs(g) <= ORTHOGONAL * math.sqrt(a * b) or min(a, b) <= noise:
                    continue
                rotated = True
                cs, sn = jacobi(a, b, g)
                for i in range(n):
                    A[i, r], A[i, c] = cs * A[i, r] - sn * A[i, c], sn * A[i, r] + cs * A[i, c]
                for k in range(m):
                    V[k, r], V[k, c] = cs * V[k, r] - sn * V[k, c], sn * V[k, r] + cs * V[k, c]
        if not rotated:
            break


@inner
def make_rows_orthogonal(A, B, square):
    """Make the m rows of A orthogonal by Jacobi rotations, and apply the same rotations to the rows of B.

    square (m,) receives the squared lengths of the rows of A.
    """
    m, n = A.shape
    longest = 0.0
    for k in range(m):
        square[k] = dot(A[k], A[k], n)
        longest = max(longest, square[k])
    noise = NOISE * NOISE * longest
    for _ in range(SWEEPS):
        rotated = False
        for k in range(m - 1):
            for c in range(k + 1, m):
                a, b, g = square[k], square[c], dot(A[k], A[c], n)
                if not abs(g) > ORTHOGONAL * math.sqrt(a * b) or min(a, b) <= noise:
                    continue
                rotated = True
                cs, sn = jacobi(a, b, g)
                rotate(A[k], A[c], cs, sn, n)
                rotate(B[k], B[c], cs, sn, B.shape[1])
                square[k], square[c] = dot(A[k], A[k], n), dot(A[c], A[c], n)
        if not rotated:
            break


@inline
def pseudo_inverse_step(J, e, rcond, V, dq, m):
    """Write the joint step dq = pinv(J') e for the error e (m,); singular values below rcond times the largest count as zero.

    J (n, m), the transposed Jacobian with one joint a row, is overwritten. V (m, m) is scratch. The function is faster if m is a
    constant at compile time.
    """
    n = J.shape[0]
    make_orthogonal(J, V, m)
    top = 0.0
    for r in range(m):
        top = max(top, dot_of_columns(J, r, J, r, n))
    clear(dq)
    for r in range(m):
        a = dot_of_columns(J, r, J, r, n)
        if a > rcond * rcond * top and a > 0.0:
            g = dot_with_column(e, V, r, m)
            for i in range(n):
                dq[i] += J[i, r] * (g / a)


@inner
def lu_solve(A, b, n, m):
    """Solve A x = b, where A is the leading m x n part of an array (m >= n): replace b (n,) by x, and overwrite A.

    Only the n equations with the largest pivots are used; any others must follow from these. Returns False if a pivot is so small
    (see FLAT) that A counts as singular.
    """
    top = 0.0
    for i in range(m):
        for j in range(n):
            top = max(top, abs(A[i, j]))
    for k in range(n):
        pivot = k
        for i in range(k + 1, m):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        if not abs(A[pivot, k]) > FLAT * top:
            return False
        if pivot != k:
            for j in range(n):
                A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
            b[k], b[pivot] = b[pivot], b[k]
        for i in range(k + 1, m):
            f = A[i, k] / A[k, k]
            for j in range(k, n):
                A[i, j] -= f * A[k, j]
            b[i] -= f * b[k]
    for k in range(n - 1, -1, -1):
        s = b[k]
        for j in range(k + 1, n):
            s -= A[k, j] * b[j]
        b[k] = s / A[k, k]
    return True


@inner
def lu_factor(M, swaps, m, faint):
    """Replace M (m, m) by its factors L and U, P M = L U (partial pivoting).

    swaps (m,) receives for each k the row that was exchanged with row k. A pivot below `faint` times the largest pivot is raised to
    that value.
    """
    largest = 0.0
    for k in range(m):
        at, best = k, abs(M[k, k])
        for i in range(k + 1, m):
            if abs(M[i, k]) > best:
                at, best = i, abs(M[i, k])
        swaps[k] = at
        for j in range(m if at != k else 0):
            M[k, j], M[at, j] = M[at, j], M[k, j]
        largest = max(largest, best)
        if best <= faint * largest:
            M[k, k] = max(faint * largest, 1e-300)
        share = 1.0 / M[k, k]
        for i in range(k + 1, m):
            if M[i, k] != 0.0:
                M[i, k] *= share
                f = M[i, k]
                for j in range(k + 1, m):
                    M[i, j] -= f * M[k, j]


@inner
def lu_substitute(M, swaps, x, m):
    """Replace x (m,) by the solution y of M y = x, where M and `swaps` are as `lu_factor` has left them."""
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
def reflect_row(V, scales, k, row, m):
    """Apply the k-th reflection of `triangle` to a row of m numbers: row -= scale (v . row) v, with v_k = 1 and 0 before it.

    V and scales: arrays that `triangle` has filled.
    """
    v = V[k]
    total = row[k]
    for n in range(k + 1, m):
        total += v[n] * row[n]
    total *= scales[k]
    row[k] -= total
    for n in range(k + 1, m):
        row[n] -= total * v[n]


@inner
def triangle(V, count, m, scales, order, share):
    """Factor the matrix whose columns are the first `count` rows of V (., m) by Householder's QR with column pivoting.

    R is stored on and before the diagonal of each row of V, the vectors of the reflections behind it, and their scales, 2 / (v .
    v), in scales (count,); order (count,): the columns in the order in which they were taken. Returns the rank: a column shorter
    than `share` of the first counts as zero.
    """
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
        for n in range(m if at != k else 0):
            V[k, n], V[at, n] = V[at, n], V[k, n]
        order[k], order[at] = order[at], order[k]
        length = math.sqrt(best)
        first = max(first, length)
        if length <= share * first:
            return k
        end = -length if V[k, k] > 0.0 else length
        v = V[k, k] - end
        inverse = 1.0 / v
        for n in range(k + 1, m):
            V[k, n] *= inverse
        scales[k] = -v / end  # This is 2 / (v' v) for the vector v of the reflection, whose first number is 1.
        for c in range(k + 1, count):
            reflect_row(V, scales, k, V[c], m)
        V[k, k] = end
    return count


@inner
def eigen(W, V, k):
    """Make the symmetric matrix W (k, k) diagonal by Jacobi rotations, and write its eigenvectors to the rows of V (k, k)."""
    for i in range(k):
        for j in range(k):
            V[i, j] = 1.0 if i == j else 0.0
    for _ in range(SWEEPS):
        beside, diagonal = 0.0, 0.0
        for i in range(k):
            diagonal += W[i, i] * W[i, i]
            beside += dot(W[i], W[i], i)
        if beside <= 1e-24 * diagonal:
            break
        for i in range(k - 1):
            for j in range(i + 1, k):
                if W[i, j] != 0.0:
                    c, s = jacobi(W[i, i], W[j, j], W[i, j])
                    for h in range(k):
                        W[h, i], W[h, j] = c * W[h, i] - s * W[h, j], s * W[h, i] + c * W[h, j]
                    rotate(W[i], W[j], c, s, k)
                    rotate(V[i], V[j], c, s, k)
