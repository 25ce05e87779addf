"""Joint values from a root of the determinant.

The null vector holds monomials of the tangents of half the joint angles; ratios of its entries give the angles.
"""

# Numba's type hints are incomplete, so pyright must not report what they lack.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import math
from typing import NamedTuple

from ...compile.jit import compiled, inline, inner
from ..algebra import V3
from ..linalg import lu_factor, lu_substitute, make_orthogonal, reflect_row
from ..records import Array
from ..vectors import clear, dot_of_columns, largest
from .closure import Line, line_of, turned
from .terms import SIZES, TRUST


@compiled
class Null(NamedTuple):
    """Scratch arrays to find the joint angles of a solution from a null vector of the 12 equations in equations.py."""

    M: Array  # (12, 12) the matrix of the 12 equations at one angle q3 of joint 3
    V: Array  # (12, 12) right singular vectors of M, one a column
    swaps: Array  # (12,) for each k, the row that was exchanged with row k when M was factored
    x: Array  # (12,) a null vector
    pair: Array  # (2, 12) two null vectors of M; `split_pair` replaces them by those of two solutions
    monomials: Array  # (14,) right side of the equations for the products of cos and sin of joints 1 and 2
    t: Array  # (6,) joint angles [rad] in the order of the loop being solved, see `closure.reorder`


@inner
def write_matrix(W, q, M):
    """Write to M (12, 12) the matrix of the 12 loop equations (see equations.py) at the angle q [rad] of joint 3.

    W: (3, 6, 9) coefficients, see `LoopEquations`.
    """
    c, s = math.cos(q), math.sin(q)
    for i in range(SIZES.monomials):
        clear(M[i])
    for k in range(6):
        for m in range(9):
            v = W[0, k, m] + c * W[1, k, m] + s * W[2, k, m]
            M[k, m] = v
            M[6 + k, 3 + m] = v


@inner
def find_null(W, q, null):
    """Write to null.x the null vector of the 12 loop equations (see equations.py) at a root q [rad] of their determinant.

    It is found by two steps of inverse iteration. W: (3, 6, 9) coefficients, see `LoopEquations`; null: scratch (Null).
    """
    write_matrix(W, q, null.M)
    lu_factor(null.M, null.swaps, SIZES.monomials, TRUST.faint)
    x = null.x
    for i in range(SIZES.monomials):
        x[i] = 1.0
    for _ in range(2):
        lu_substitute(null.M, null.swaps, x, SIZES.monomials)
        top = largest(x)
        for i in range(SIZES.monomials):
            x[i] /= top


@inner
def find_two_nulls(W, q, null):
    """Write to the rows of null.pair the two singular vectors with the smallest singular values of the 12 loop equations.

    The equations (see equations.py) are taken at the angle q [rad] of joint 3. All twelve singular values are computed, by
    Hestenes' method. Returns the second and the third smallest, divided by the largest. W: (3, 6, 9) coefficients, see
    `LoopEquations`; null: scratch (Null).
    """
    write_matrix(W, q, null.M)
    make_orthogonal(null.M, null.V, SIZES.monomials)
    lengths = null.x
    for k in range(SIZES.monomials):
        lengths[k] = math.sqrt(dot_of_columns(null.M, k, null.M, k, SIZES.monomials))
    top, second, third = largest(lengths), 0.0, 0.0
    for rank in range(3):
        at = 0
        for k in range(SIZES.monomials):
            if lengths[k] < lengths[at]:
                at = k
        second, third = third, lengths[at]
        lengths[at] = math.inf
        if rank < 2:
            for i in range(SIZES.monomials):
                null.pair[rank, i] = null.V[i, at]
    return second / top, third / top


@inner
def split_pair(null):
    """Combine the two null vectors null.pair (2, 12) into two that each belong to one solution.

    The entries of such a vector are the monomials x4^i x5^j of the solution, where x = tan(q / 2). Returns 2 if both solutions are
    real, 0 if both are complex, 1 if that is unclear. In a vector y of monomials, the entries hi(y) with one factor x more are x
    times the entries lo(y): for x4 they are three places apart, for x5 one. So the two vectors are the eigenvectors of the 2 x 2
    matrix that takes lo to hi by least squares. The matrices of x4 and x5 have the same eigenvectors, so they are added, with an
    arbitrary factor between them. The parts lo and hi are first turned by 0.7 rad into each other, so that x = infinity is not a
    special case.
    """
    P, cs, sn = null.pair, math.cos(0.7), math.sin(0.7)
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for which in range(2):
        g00, g01, g11, h00, h01, h10, h11 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(4 if which == 1 else 3):
            for j in range(3 if which == 0 else 2):
                lo = 3 * i + j
                hi = lo + (3 if which == 0 else 1)
                p0, p1 = cs * P[0, lo] + sn * P[0, hi], cs * P[1, lo] + sn * P[1, hi]
                r0, r1 = cs * P[0, hi] - sn * P[0, lo], cs * P[1, hi] - sn * P[1, lo]
                g00 += p0 * p0
                g01 += p0 * p1
                g11 += p1 * p1
                h00 += p0 * r0
                h01 += p0 * r1
                h10 += p1 * r0
                h11 += p1 * r1
        area = g00 * g11 - g01 * g01
        if area > 0.0:
            f = (1.0 if which == 0 else 0.7310585) / area
            a += f * (g11 * h00 - g01 * h10)
            b += f * (g11 * h01 - g01 * h11)
            c += f * (g00 * h10 - g01 * h00)
            d += f * (g00 * h11 - g01 * h01)
    mean = 0.5 * (a + d)
    root = 0.25 * (a - d) ** 2 + b * c
    if root < 0.0:
        return 0 if root < -1e-4 * (abs(mean) + abs(a) + abs(b) + abs(c) + abs(d)) ** 2 else 1
    half = math.sqrt(root)
    u0, u1 = eigenvector(a, b, c, d, mean + half)
    v0, v1 = eigenvector(a, b, c, d, mean - half)
    for i in range(SIZES.monomials):
        x, y = P[0, i], P[1, i]
        P[0, i], P[1, i] = u0 * x + u1 * y, v0 * x + v1 * y
    return 2


@inline
def eigenvector(a, b, c, d, value):
    """Return an eigenvector of [[a, b], [c, d]] for the eigenvalue `value`.

    Of two formulas, the one whose result is longer is used, because the other may give 0.
    """
    first = b * b + (value - a) * (value - a) >= (value - d) * (value - d) + c * c
    return (b, value - a) if first else (value - d, c)


@inner
def find_angles(e, rank, pose, q, x, null):
    """Write to null.t (6,) the joint angles of the solution with q3 = q [rad], from the null vector x (12,) of its equations.

    Joints 4 and 5 follow from ratios of the entries of x, also at pi, where the tangent of half the angle is infinite. Joints 1 and
    2 follow from products y of their cosines and sines, which solve R y = Q' (robot - target[0]) with the QR factors in e
    (LoopEquations). Joint 6 closes the loop. null: scratch (Null); pose, rank: from `account.set_up`.
    """
    at = 0
    for k in range(SIZES.monomials):
        if abs(x[k]) > abs(x[at]):
            at = k
    i, j = at // 3, at % 3
    k = max(i - 1, 0)
    t4 = 2.0 * math.atan2(x[3 * k + 3 + j], x[3 * k + j])
    k = max(j - 1, 0)
    t5 = 2.0 * math.atan2(x[3 * i + k + 1], x[3 * i + k])
    t = null.t
    t[2], t[3], t[4] = q, t4, t5
    row = null.monomials
    for n in range(SIZES.numbers):
        row[n] = 0.0
    for a in range(3):
        fa = factor_of(a, t[2])
        for b in range(3):
            fb = fa * factor_of(b, t4)
            for c in range(3):
                f = fb * factor_of(c, t5)
                for n in range(SIZES.numbers):
                    row[n] += f * e.robot[9 * a + 3 * b + c, n]
    for n in range(SIZES.numbers):
        row[n] -= e.target[0, n]
    for k in range(rank):
        reflect_row(e.V, e.scales, k, row, SIZES.numbers)
    y = null.x  # `x` may be this same array, which may be overwritten because `x` is not needed any more.
    for k in range(8):
        y[k] = 0.0
    for k in range(rank - 1, -1, -1):
        v = row[k]
        for j in range(k + 1, rank):
            v -= e.V[j, k] * y[e.order[j]]
        y[e.order[k]] = v / e.V[k, k]
    # The monomial y[3 a + b - 1] is a product of 1, cos or sin of joint 1 (a = 0, 1, 2) and of joint 2 (b = 0, 1, 2).
    t[0], t[1] = math.atan2(y[5], y[2]), math.atan2(y[1], y[0])
    t[5] = last_angle(e.lines, pose, t)


@inline
def factor_of(k, q):
    """Return 1, cos q or sin q for k = 0, 1 or 2."""
    return 1.0 if k == 0 else math.cos(q) if k == 1 else math.sin(q)


@inner
def last_angle(lines, pose, t):
    """Return the angle of joint 6 that closes the loop when joints 1 to 5 are at t[0] ... t[4] [rad].

    lines: (6, 6) joint axes in the order of the loop; pose: the pose that E1(q1) ... E6(q6) must equal.
    """
    last = line_of(lines, 5)
    away = any_normal(last.along)
    # Only the direction of this line is used below, so any point serves as its point.
    goal = Line(pose.axes.times(away), pose.axes.times(last.along))
    for k in range(5):
        goal = turned(goal, line_of(lines, k), math.cos(t[k]), -math.sin(t[k]))
    return math.atan2(last.along.dot(away.cross(goal.along)), away.dot(goal.along))


@inline
def any_normal(v):
    """Return a unit vector perpendicular to a unit vector v (V3)."""
    w = v.cross(V3(1.0, 0.0, 0.0)) if abs(v.x) < 0.6 else v.cross(V3(0.0, 1.0, 0.0))
    return w * (1.0 / math.sqrt(w.square()))
