"""The equations from which two joints are eliminated, after Raghavan and Roth (1993), for six lines instead of D-H rows.

The loop E1 ... E6 = X gives E3 E4 E5 l = E2^-1 E1^-1 X l, where l is the axis of joint 6, which E6 does not move. A line with
direction l and point p (counted from any fixed origin) gives the 14 numbers

    p,  l,  p.p,  p.l,  p x l,  (p.p) l - 2 (p.l) p,

as chosen by Raghavan and Roth: on either side each number is linear in 1, cos, sin of every single joint. So each side is a table
of coefficients, found by evaluating at 0 and +-120 deg of each joint: 27 lines on the left (the robot's side), 9 on the right.
The 8 monomials of q1 and q2 on the right are eliminated by a QR factorisation of their 14 x 8 coefficients; 6 equations are left
(more if the rank is less). With x = tan(q / 2) of joints 4 and 5 they are

    W(q3) [x4^i x5^j] = 0,  i, j = 0, 1, 2,  W = W0 + W1 cos q3 + W2 sin q3,   (6 x 9).

Multiplied by x4 as well, they are 12 equations in the 12 monomials x4^0..3 x5^0..2 (see `determinant`).
"""

# Numba's type hints are incomplete, so pyright must not report what they lack.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import math
from typing import NamedTuple

from ...compile.jit import compiled, inline, inner
from ..algebra import put3
from ..linalg import reflect_row, triangle
from ..records import Array
from .closure import line_moved, line_of, turned
from .terms import SIZES, TRUST


@compiled
class LoopEquations(NamedTuple):
    """The loop equations of an arm for one target and one order of its joints, as tables of coefficients.

    The 14 columns of a table are the numbers that describe a line, see `write_numbers`.
    """

    lines: Array  # (6, 6) the joint axes in this order, one a row: direction and point
    robot: Array  # (27, 14) coefficients of products of 1, cos and sin of joints 3, 4 and 5, see `write_left`
    target: Array  # (9, 14) coefficients of products of 1, cos and sin of joints 1 and 2, see `write_right`
    V: Array  # (8, 14) QR factors of `target` without its first row, the constant terms
    scales: Array  # (8,) scale of each reflection in the QR factorisation of V, see `linalg.triangle`
    order: Array  # (8,) order of the columns in the QR factorisation of V
    # (27, 14) the table `robot` minus the constant terms of `target`, transformed by the reflections of the QR factorisation
    reduced: Array
    # (3, 6, 9) coefficients of 1, cos q3 and sin q3 in 6 equations for 9 products of powers of tan(q / 2) of joints 4 and 5
    W: Array


@inner
def cosine(k):
    """Return the cosine of the angle number k: 0, 120 or -120 deg for k = 0, 1, 2."""
    return 1.0 if k == 0 else -0.5


@inner
def sine(k):
    """Return the sine of the angle number k: 0, 120 or -120 deg for k = 0, 1, 2."""
    return 0.0 if k == 0 else math.sqrt(0.75) if k == 1 else -math.sqrt(0.75)


@inner
def write_numbers(line, origin, row):
    """Write to row (14,) the numbers that describe a line with direction l and point p, counted from `origin` (V3).

    They are p, l, p.p, p.l, p x l and (p.p) l - 2 (p.l) p (Raghavan and Roth 1993).
    """
    p, along = line.point - origin, line.along
    pp, pl = p.square(), p.dot(along)
    put3(row, 0, p)
    put3(row, 3, along)
    row[6], row[7] = pp, pl
    put3(row, 8, p.cross(along))
    put3(row, 11, along * pp - p * (2.0 * pl))


@inner
def fit_joint(table, stride):
    """Replace values at 0, 120 and -120 deg of one joint by coefficients of 1, cos and sin of its angle, in place.

    table: (M, 14), a row for each combination of the angles of all joints; the three values of this joint are `stride` rows apart.
    """
    for m in range(table.shape[0]):
        if m // stride % 3 == 0:
            for n in range(SIZES.numbers):
                a, b, c = table[m, n], table[m + stride, n], table[m + 2 * stride, n]
                table[m, n] = (a + b + c) / 3.0
                table[m + stride, n] = (2.0 * a - b - c) / 3.0
                table[m + 2 * stride, n] = (b - c) / math.sqrt(3.0)


@inner
def write_left(lines, table):
    """Write to table (27, 14) the left sides of the 14 loop equations: coefficients of products of 1, cos, sin of joints 3 to 5.

    They are the 14 numbers of the line E3 E4 E5 l, where Ei is the motion of joint i and l the axis of joint 6.

    With 0, 1, 2 for 1, cos, sin of the three joints (a, b, c), the row of a product is 9 a + 3 b + c. lines: (6, 6) axes of the
    reordered loop; l is the axis of joint 6.
    """
    third, fourth, fifth, last = line_of(lines, 2), line_of(lines, 3), line_of(lines, 4), line_of(lines, 5)
    for k in range(3):
        at5 = turned(last, fifth, cosine(k), sine(k))
        for j in range(3):
            at4 = turned(at5, fourth, cosine(j), sine(j))
            for i in range(3):
                at3 = turned(at4, third, cosine(i), sine(i))
                write_numbers(at3, third.point, table[9 * i + 3 * j + k])
    fit_joint(table, 9)
    fit_joint(table, 3)
    fit_joint(table, 1)


@inner
def write_right(lines, pose, table):
    """Write to table (9, 14) the right sides of the 14 loop equations: coefficients of products of 1, cos, sin of joints 1 and 2.

    They are the 14 numbers of the line E2^-1 E1^-1 X l, where Ei is the motion of joint i, X the pose to reach and l the axis of
    joint 6.

    With 0, 1, 2 for 1, cos, sin of the two joints (a, b), the row of a product is 3 a + b. lines: (6, 6) axes of the reordered
    loop; pose: its pose X.
    """
    first, second, third, last = line_of(lines, 0), line_of(lines, 1), line_of(lines, 2), line_of(lines, 5)
    there = line_moved(pose, last)
    for i in range(3):
        at1 = turned(there, first, cosine(i), -sine(i))
        for j in range(3):
            at2 = turned(at1, second, cosine(j), -sine(j))
            write_numbers(at2, third.point, table[3 * i + j])
    fit_joint(table, 3)
    fit_joint(table, 1)


@inline
def reduce(e, mix):
    """Eliminate joints 1 and 2 from the 14 loop equations e (LoopEquations), so that 6 equations in joints 3 to 5 are left.

    Fills e.V, e.reduced and e.W. Returns the rank of the coefficients of the 8 products of cos and sin of joints 1 and 2. If it is
    less than 8, more than 6 equations are left; mix (6, 14) has the factors by which they are combined into 6.
    """
    for c in range(8):
        for n in range(SIZES.numbers):
            e.V[c, n] = e.target[c + 1, n]
    rank = triangle(e.V, 8, SIZES.numbers, e.scales, e.order, TRUST.empty)
    for m in range(27):
        row = e.reduced[m]
        for n in range(SIZES.numbers):
            row[n] = e.robot[m, n] - (e.target[0, n] if m == 0 else 0.0)
        for k in range(rank):
            reflect_row(e.V, e.scales, k, row, SIZES.numbers)
    for a in range(3):
        for k in range(6):
            w = e.W[a, k]
            for m in range(9):
                row, total = e.reduced[9 * a + m], 0.0
                if rank == 8:
                    total = row[rank + k]
                else:
                    for n in range(SIZES.numbers - rank):
                        total += mix[k, n] * row[rank + n]
                w[m] = total
            write_powers(w)
    return rank


@inner
def write_powers(w):
    """Convert coefficients w (9,) of products of 1, cos, sin of joints 4 and 5 to those of powers of x = tan(q / 2).

    For each joint, u + c cos q + s sin q, multiplied by 1 + x^2, becomes (u + c) + 2 s x + (u - c) x^2.
    """
    for i in range(3):
        u, c, s = w[3 * i], w[3 * i + 1], w[3 * i + 2]
        w[3 * i], w[3 * i + 1], w[3 * i + 2] = u + c, 2.0 * s, u - c
    for i in range(3):
        u, c, s = w[i], w[3 + i], w[6 + i]
        w[i], w[3 + i], w[6 + i] = u + c, 2.0 * s, u - c


@inner
def determinant(W, c, s, A, N):
    """Return the determinant of the 12 loop equations at one angle q3 of joint 3 (Manocha and Canny 1994).

    It is 0 where joint 3 has the value of a solution. c, s: cos q3, sin q3; W (3, 6, 9): coefficients of 1, cos q3, sin q3. At one
    q3, with [a b d] in blocks of the powers of x4, the matrix of the equations is [a b d 0; 0 a b d]. The first block, a (6 x 3),
    is eliminated once for both copies, then 9 x 9 are left. A (6, 9) and N (9, 9) are scratch.
    """
    for k in range(6):
        for m in range(9):
            A[k, m] = W[0, k, m] + c * W[1, k, m] + s * W[2, k, m]
    first, _ = eliminate(
        A, 6, 9, 3
    )  # The sign of the row exchanges does not matter, because the matrix has the block twice.
    for k in range(3):
        for j in range(3):
            N[k, j], N[k, 3 + j], N[k, 6 + j] = A[3 + k, 3 + j], A[3 + k, 6 + j], 0.0
            N[3 + k, j], N[3 + k, 3 + j], N[3 + k, 6 + j] = (A[k, j] if j >= k else 0.0), A[k, 3 + j], A[k, 6 + j]
            N[6 + k, j], N[6 + k, 3 + j], N[6 + k, 6 + j] = 0.0, A[3 + k, 3 + j], A[3 + k, 6 + j]
    rest, sign = eliminate(N, 9, 9, 9)
    return first * rest * sign


@inner
def eliminate(A, rows, columns, count):
    """Bring the first `count` columns of A (rows, columns) to upper triangular form, by Gaussian elimination with partial pivoting.

    The entries below the diagonal, which are now 0, are not written. Returns the product of the pivots, and the sign of the row
    permutation.
    """
    product, sign = 1.0, 1.0
    for k in range(count):
        at, best = k, abs(A[k, k])
        for i in range(k + 1, rows):
            if abs(A[i, k]) > best:
                at, best = i, abs(A[i, k])
        if best == 0.0:
            return 0.0, sign
        if at != k:
            sign = -sign
            for j in range(k, columns):
                A[k, j], A[at, j] = A[at, j], A[k, j]
        product *= A[k, k]
        share = 1.0 / A[k, k]
        for i in range(k + 1, rows):
            if A[i, k] != 0.0:
                f = A[i, k] * share
                for j in range(k + 1, columns):
                    A[i, j] -= f * A[k, j]
    return product, sign
