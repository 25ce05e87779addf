"""Vectors, rotations and frames as records of numbers.

The formulas are written once and serve twice: a component is a float in the search for one target, and a SIMD vector of eight
floats (`vector`) in the batch search. After inlining nothing of these records is left in the machine code.
"""

# Numba's type hints lack options given in a dict, and functions that only numba calls, so pyright must not report these.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import math
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from ..compile.jit import INLINE, compiled, inline
from ..compile.simd import WIDTH, full, lane_load, store, vector

Number = Any  # a float, or a SIMD vector of eight floats


@compiled
class V3(NamedTuple):
    """A vector of three components; + and - work by component, unlike those of a plain tuple."""

    x: Number
    y: Number
    z: Number

    def __add__(self, other):
        return V3(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other):
        return V3(self.x - other.x, self.y - other.y, self.z - other.z)

    def __neg__(self):
        return V3(-self.x, -self.y, -self.z)

    def __mul__(self, other):
        """Return the vector times a number; only vector * number is defined, not number * vector."""
        return V3(self.x * other, self.y * other, self.z * other)

    def dot(self, other):
        return self.x * other.x + self.y * other.y + self.z * other.z

    def cross(self, other):
        return V3(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )

    def square(self):
        return self.x * self.x + self.y * self.y + self.z * self.z


@compiled
class M3(NamedTuple):
    """A 3x3 matrix, stored by its columns; the columns of a rotation matrix are the axes of a frame."""

    x: V3
    y: V3
    z: V3

    def times(self, v):
        return self.x * v.x + self.y * v.y + self.z * v.z

    def across(self, v):
        """Return M' v, the product of the transposed matrix and the vector v."""
        return V3(self.x.dot(v), self.y.dot(v), self.z.dot(v))


@inline
def product(a, b):
    """Return the product a b of two 3x3 matrices (M3)."""
    return M3(a.times(b.x), a.times(b.y), a.times(b.z))


@inline
def transposed(m):
    """Return the transpose of a 3x3 matrix (M3)."""
    return M3(V3(m.x.x, m.y.x, m.z.x), V3(m.x.y, m.y.y, m.z.y), V3(m.x.z, m.y.z, m.z.z))


@compiled
class Sym3(NamedTuple):
    """A symmetric 3x3 matrix, stored by its six different entries."""

    xx: Number
    xy: Number
    xz: Number
    yy: Number
    yz: Number
    zz: Number

    def times(self, v):
        return V3(
            self.xx * v.x + self.xy * v.y + self.xz * v.z,
            self.xy * v.x + self.yy * v.y + self.yz * v.z,
            self.xz * v.x + self.yz * v.y + self.zz * v.z,
        )

    def plus(self, a, b):
        """Return the matrix plus the outer product a b' of two parallel vectors, which is symmetric."""
        return Sym3(
            self.xx + a.x * b.x, self.xy + a.y * b.x, self.xz + a.z * b.x,
            self.yy + a.y * b.y, self.yz + a.z * b.y, self.zz + a.z * b.z,
        )  # fmt: skip

    def determinant(self):
        a, b, c, d, e, f = self.xx, self.xy, self.xz, self.yy, self.yz, self.zz
        return a * (d * f - e * e) + b * (c * e - b * f) + c * (b * e - c * d)

    def factors(self):
        """Return the factors of the matrix, L D L', with which a linear system is solved.

        An inverse by cofactors would be less accurate where only the damping keeps the matrix from being singular, as when all
        joints turn about one axis. The entries of the inverse are then as large as 1 / damping, and their products with the right
        side cancel down to rounding.
        """
        i0 = 1.0 / self.xx
        l10, l20 = self.xy * i0, self.xz * i0
        i1 = 1.0 / (self.yy - l10 * self.xy)
        m = self.yz - l10 * self.xz
        l21 = m * i1
        return Factors(l10, l20, l21, V3(i0, i1, 1.0 / (self.zz - l20 * self.xz - l21 * m)))


@compiled
class Factors(NamedTuple):
    """Factors of a symmetric 3x3 matrix L D L': the entries of L below its diagonal of ones, and the inverses of D."""

    l10: Number
    l20: Number
    l21: Number
    pivots: V3

    def forward(self, v):
        """Return L^-1 v, the first step of solving L D L' x = v."""
        y = v.y - self.l10 * v.x
        return V3(v.x, y, v.z - self.l20 * v.x - self.l21 * y)

    def scaled(self, v):
        """Return D^-1 v: the second of three steps that solve L D L' x = b, with v = L^-1 b of the first."""
        return V3(self.pivots.x * v.x, self.pivots.y * v.y, self.pivots.z * v.z)

    def back(self, v):
        """Return L'^-1 v, the last step of solving L D L' x = v."""
        y = v.y - self.l21 * v.z
        return V3(v.x - self.l10 * y - self.l20 * v.z, y, v.z)


class Pose(NamedTuple):
    """The pose of a frame: its three axes, the columns of a rotation matrix, and its origin."""

    axes: M3
    point: V3


@inline
def pose_from(T):
    """Return an array T (4, 4) as a Pose."""
    x, y, z = V3(T[0, 0], T[1, 0], T[2, 0]), V3(T[0, 1], T[1, 1], T[2, 1]), V3(T[0, 2], T[1, 2], T[2, 2])
    return Pose(M3(x, y, z), V3(T[0, 3], T[1, 3], T[2, 3]))


@compiled
class Blocks(NamedTuple):
    """The symmetric 6x6 matrix [[P, Q'], [Q, S]] of a damped least-squares step, made of 3x3 blocks.

    Its first three rows belong to the position errors, the last three to the rotation errors.
    """

    P: Sym3
    Q: M3
    S: Sym3

    def with_column(self, a, b, u, v):
        """Return the matrix plus the outer product [a; b] [u; v]' of two parallel vectors of six numbers, which is symmetric.

        a, b, u and v are their halves (V3).
        """
        Q = self.Q
        return Blocks(self.P.plus(a, u), M3(Q.x + b * u.x, Q.y + b * u.y, Q.z + b * u.z), self.S.plus(b, v))

    def solve(self, a, b):
        """Solve the 6x6 system for the right side [a; b] by the Schur complement of S; return both halves (V3) of the solution."""
        P = self.P
        inner = self.S.factors()
        x, y, z = inner.forward(self.Q.x), inner.forward(self.Q.y), inner.forward(self.Q.z)
        b = inner.forward(b)
        G = M3(inner.scaled(x), inner.scaled(y), inner.scaled(z))
        rest = Sym3(
            P.xx - x.dot(G.x), P.xy - y.dot(G.x), P.xz - z.dot(G.x),
            P.yy - y.dot(G.y), P.yz - z.dot(G.y), P.zz - z.dot(G.z),
        )  # fmt: skip
        outer = rest.factors()
        first = outer.back(outer.scaled(outer.forward(a - G.across(b))))
        return first, inner.back(inner.scaled(b) - G.times(first))


@inline
def diagonal(d):
    """Return the 6x6 identity times the number d, as Blocks."""
    o = alike(d, 0.0)
    none = V3(o, o, o)
    return Blocks(Sym3(d, o, o, d, o, d), M3(none, none, none), Sym3(d, o, o, d, o, d))


# ----------------------------------------------------------------------------------------------------------- in memory
def at(A, i):
    """Return component i of an array: a float of an array (m,), a SIMD vector of eight floats of an array (m, 8)."""
    return A[i]


@overload(at, jit_options=INLINE)
def _at(A, i):
    if A.ndim == 1:
        return lambda A, i: A[i]
    return lambda A, i: lane_load(A, i * WIDTH)


def put(A, i, value):
    """Write component i of an array: a float to an array (m,), a SIMD vector of eight floats to an array (m, 8)."""
    A[i] = value


@overload(put, jit_options=INLINE)
def _put(A, i, value):
    if A.ndim == 1:

        def write(A, i, value):
            A[i] = value

        return write
    return lambda A, i, value: store(A, i * WIDTH, value)


def alike(x, number):
    """Return `number` as a float if x is a float, or as a SIMD vector of eight copies if x is such a vector."""
    return number


@overload(alike, jit_options=INLINE)
def _alike(x, number):
    return (lambda x, number: full(number)) if x is vector else (lambda x, number: number)


@inline
def at3(A, i):
    """Return components i, i + 1 and i + 2 of an array as a vector (V3)."""
    return V3(at(A, i), at(A, i + 1), at(A, i + 2))


@inline
def put3(A, i, v):
    """Write the vector v (V3) to components i, i + 1 and i + 2 of an array."""
    put(A, i, v.x)
    put(A, i + 1, v.y)
    put(A, i + 2, v.z)


@inline
def rotation_at(A, i):
    """Return the 3x3 matrix (M3) that an array holds by rows in nine components, from component i on."""
    return M3(
        V3(at(A, i), at(A, i + 3), at(A, i + 6)),
        V3(at(A, i + 1), at(A, i + 4), at(A, i + 7)),
        V3(at(A, i + 2), at(A, i + 5), at(A, i + 8)),
    )


@inline
def put_axes(A, i, m):
    """Write the 3x3 matrix m (M3) by rows to nine components of an array, from component i on."""
    put3(A, i, V3(m.x.x, m.y.x, m.z.x))
    put3(A, i + 3, V3(m.x.y, m.y.y, m.z.y))
    put3(A, i + 6, V3(m.x.z, m.y.z, m.z.z))


@inline
def sincos(x):
    """Return the sine and cosine of x [rad], with an error below 1e-15 + 2e-16 |x|; the second term is the rounding of x itself.

    They are computed together and without branches, so that a loop over the joints vectorises.
    """
    k = np.rint(x * 0.31830988618379067154)
    r = x - k * math.pi
    h = 0.5 * k
    sign = 1.0 - 4.0 * abs(h - np.rint(h))
    z = r * r
    s = -7.6471637318198165e-13 + z * (2.8114572543455208e-15 + z * -8.2206352466243297e-18)
    s = -1.9841269841269841e-4 + z * (
        2.7557319223985890e-6 + z * (-2.5052108385441719e-8 + z * (1.6059043836821614e-10 + z * s))
    )
    s = r * (1.0 + z * (-1.6666666666666666e-1 + z * (8.3333333333333333e-3 + z * s)))
    c = 4.7794773323873853e-14 + z * (-1.5619206968586226e-16 + z * 4.1103176233121649e-19)
    c = 2.4801587301587301e-5 + z * (
        -2.7557319223985890e-7 + z * (2.0876756987868099e-9 + z * (-1.1470745597729725e-11 + z * c))
    )
    c = 1.0 + z * (-0.5 + z * (4.1666666666666666e-2 + z * (-1.3888888888888889e-3 + z * c)))
    return s * sign, c * sign


@inline
def rotation_left(now, goal):
    """Return sin(angle) times the axis, and 1 + cos(angle), of the rotation that takes one rotation matrix to another.

    now and goal (M3): the matrices at its beginning and its end.
    """
    sine = (now.x.cross(goal.x) + now.y.cross(goal.y) + now.z.cross(goal.z)) * 0.5
    return sine, 0.5 * (1.0 + now.x.dot(goal.x) + now.y.dot(goal.y) + now.z.dot(goal.z))


@inline
def chord(angle):
    """Return |2 sin(angle/2)|^2, the largest squared rotation error that a tolerance of this angle [rad] allows."""
    # From half a turn on, every rotation is allowed: 3 exceeds 2 sin(angle/2), which is at most 2.
    length = 2.0 * math.sin(0.5 * angle) if angle < math.pi else 3.0
    return length * length
