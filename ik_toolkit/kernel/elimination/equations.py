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
    """The equations of one target for one ordering of the loop; the 14 columns of a table are the numbers of a line."""

    lines: Array  # (6, 6) the joint axes in this ordering
    robot: Array  # (27, 14) coefficients in 1, cos, sin of joints 3, 4, 5, see `write_left`
    target: Array  # (9, 14) coefficients in 1, cos, sin of joints 1, 2, see `write_right`
    V: Array  # (8, 14) QR factors of the 8 rows of `target` without the constant one, taken as columns
    scales: Array  # (8,) scale of each reflection in the QR factorisation of V, see `linalg.triangle`
    order: Array  # (8,) order of the columns in the QR factorisation of V
    # (27, 14) the coefficients robot - target[0], transformed by the reflections of the QR factorisation
    reduced: Array
    W: Array  # (3, 6, 9) coefficients of 1, cos q3, sin q3 in the 6 equations for 9 monomials of joints 4 and 5


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
    """Write the 14 numbers that describe a line to row (14,), with points counted from `origin` (V3)."""
    p, along = line.point - origin, line.along
    pp, pl = p.square(), p.dot(along)
    put3(row, 0, p)
    put3(row, 3, along)
    row[6], row[7] = pp, pl
    put3(row, 8, p.cross(along))
    put3(row, 11, along * pp - p * (2.0 * pl))


@inner
def fit_joint(table, stride):
    """Replace values at 0, 120, -120 deg of one joint by the coefficients of 1, cos, sin of its angle.

    table: (M, 14), one point of the grid of all joints a row; the three values of this joint are `stride` rows apart.
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
    """Write to table (27, 14) the left sides of the 14 loop equations, as coefficients of products of 1, cos, sin of joints 3 to 5.

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
    """Write to table (9, 14) the line numbers of E2^-1 E1^-1 X l as coefficients of products of 1, cos, sin of joints 1 and 2.

    With 0, 1, 2 for 1, cos, sin of the two joints (a, b), the row of a product is 3 a + b. lines: (6, 6) axes of the reordered
    loop; pose: its pose X; l is the axis of joint 6.
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
    """Eliminate joints 1 and 2 from the equations e (LoopEquations): fill e.V, e.reduced and e.W.

    Returns the rank of the coefficients of their 8 monomials. mix (6, 14): fixed numbers by which more than 6 equations, left if
    the rank is less than 8, are combined to 6.
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
    """Convert coefficients w (9,) of 1, cos, sin of joints 4 and 5 to those of powers of x = tan(q / 2), multiplied by 1 + x^2.

    For each joint, u + c cos q + s sin q becomes (u + c) + 2 s x + (u - c) x^2.
    """
    for i in range(3):
        u, c, s = w[3 * i], w[3 * i + 1], w[3 * i + 2]
        w[3 * i], w[3 * i + 1], w[3 * i + 2] = u + c, 2.0 * s, u - c
    for i in range(3):
        u, c, s = w[i], w[3 + i], w[6 + i]
        w[i], w[3 + i], w[6 + i] = u + c, 2.0 * s, u - c


@inner
def determinant(W, c, s, A, N):
    """Return the determinant of the 12 equations at cos q3 = c, sin q3 = s (Manocha and Canny 1994).

    W (3, 6, 9) holds coefficients of 1, cos q3, sin q3. At one q3, with [a b d] in blocks of the powers of x4, the matrix of the
    equations is [a b d 0; 0 a b d]. The first block, a (6 x 3), is eliminated once for both copies, then 9 x 9 are left. A (6, 9)
    and N (9, 9) are scratch.
    """
    for k in range(6):
        for m in range(9):
            A[k, m] = W[0, k, m] + c * W[1, k, m] + s * W[2, k, m]
    first, _ = eliminate(A, 6, 9, 3)  # The sign of the row exchanges does not matter, because both copies have it.
    for k in range(3):
        for j in range(3):
            N[k, j], N[k, 3 + j], N[k, 6 + j] = A[3 + k, 3 + j], A[3 + k, 6 + j], 0.0
            N[3 + k, j], N[3 + k, 3 + j], N[3 + k, 6 + j] = (A[k, j] if j >= k else 0.0), A[k, 3 + j], A[k, 6 + j]
            N[6 + k, j], N[6 + k, 3 + j], N[6 + k, 6 + j] = 0.0, A[3 + k, 3 + j], A[3 + k, 6 + j]
    rest, sign = eliminate(N, 9, 9, 9)
    return first * rest * sign


@inner
def eliminate(A, rows, columns, count):
    """Bring the first `count` columns of A (rows, columns) to upper triangular form (Gaussian elimination, partial pivoting).

    Returns the product of the pivots, and the sign of the row permutation.
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
