"""Vectors, rotations and frames in the kernel: records of numbers, or of lanes of eight numbers (`vector`).

The formulas are written once: a component is a float in the search for one target and a vector of eight floats in `lanes`.
After inlining nothing of these records is left in the machine code.
"""

# numba's own types know neither options in a dict nor that overloads and intrinsics are called by numba.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import math
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from ..compile.jit import INLINE, compiled, inline
from ..compile.simd import WIDTH, full, lane_load, store, vector

Number = Any  # a float, or a vector of eight


@compiled
class V3(NamedTuple):
    """Three components. (On plain tuples + means concatenation, which is not needed here.)"""

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
        """By a number, on the right."""
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
    """A 3x3 matrix by its columns; of a rotation these are the axes."""

    x: V3
    y: V3
    z: V3

    def times(self, v):
        return self.x * v.x + self.y * v.y + self.z * v.z

    def across(self, v):
        """The transpose times v."""
        return V3(self.x.dot(v), self.y.dot(v), self.z.dot(v))


@compiled
class Sym3(NamedTuple):
    """A symmetric 3x3 matrix."""

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
        """With a b' added, where a is along b."""
        return Sym3(
            self.xx + a.x * b.x, self.xy + a.y * b.x, self.xz + a.z * b.x,
            self.yy + a.y * b.y, self.yz + a.z * b.y, self.zz + a.z * b.z,
        )  # fmt: skip

    def determinant(self):
        a, b, c, d, e, f = self.xx, self.xy, self.xz, self.yy, self.yz, self.zz
        return a * (d * f - e * e) + b * (c * e - b * f) + c * (b * e - c * d)

    def factors(self):
        """L D L', for solving. An inverse by cofactors would be less accurate.

        Where the matrix is almost only damping, as the rotations of joints that all turn about one axis, the entries of an
        inverse are 1 over the damping and what they are multiplied with cancels, down to rounding.
        """
        i0 = 1.0 / self.xx
        l10, l20 = self.xy * i0, self.xz * i0
        i1 = 1.0 / (self.yy - l10 * self.xy)
        m = self.yz - l10 * self.xz
        l21 = m * i1
        return Factors(l10, l20, l21, V3(i0, i1, 1.0 / (self.zz - l20 * self.xz - l21 * m)))


@compiled
class Factors(NamedTuple):
    """L (below its diagonal of ones) and the inverses of the pivots D of a symmetric 3x3 matrix L D L'."""

    l10: Number
    l20: Number
    l21: Number
    pivots: V3

    def forward(self, v):
        """L^-1 v."""
        y = v.y - self.l10 * v.x
        return V3(v.x, y, v.z - self.l20 * v.x - self.l21 * y)

    def scaled(self, v):
        """D^-1 v."""
        return V3(self.pivots.x * v.x, self.pivots.y * v.y, self.pivots.z * v.z)

    def back(self, v):
        """L'^-1 v."""
        y = v.y - self.l21 * v.z
        return V3(v.x - self.l10 * y - self.l20 * v.z, y, v.z)


class Pose(NamedTuple):
    """Orientation and point of a frame."""

    axes: M3
    point: V3


@compiled
class Blocks(NamedTuple):
    """The symmetric 6x6 matrix [[P, Q'], [Q, S]] of a damped step; linear part first."""

    P: Sym3
    Q: M3
    S: Sym3

    def with_column(self, a, b, u, v):
        """With [a; b] [u; v]' added, where [a; b] is along [u; v]."""
        Q = self.Q
        return Blocks(self.P.plus(a, u), M3(Q.x + b * u.x, Q.y + b * u.y, Q.z + b * u.z), self.S.plus(b, v))

    def solve(self, a, b):
        """y, z with Blocks [y; z] = [a; b], by the complement of S."""
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
    """Blocks of d times the identity."""
    o = alike(d, 0.0)
    none = V3(o, o, o)
    return Blocks(Sym3(d, o, o, d, o, d), M3(none, none, none), Sym3(d, o, o, d, o, d))


# ----------------------------------------------------------------------------------------------------------- in memory
# An array (m,) holds m numbers, an array (m, 8) holds m vectors of eight lanes.
def at(A, i):
    """Number or lanes at place i."""
    return A[i]


@overload(at, jit_options=INLINE)
def _at(A, i):
    if A.ndim == 1:
        return lambda A, i: A[i]
    return lambda A, i: lane_load(A, i * WIDTH)


def put(A, i, value):
    """Write a number or lanes to place i."""
    A[i] = value


@overload(put, jit_options=INLINE)
def _put(A, i, value):
    if A.ndim == 1:

        def write(A, i, value):
            A[i] = value

        return write
    return lambda A, i, value: store(A, i * WIDTH, value)


def alike(x, number):
    """`number` as what x is: a number or eight lanes of it."""
    return number


@overload(alike, jit_options=INLINE)
def _alike(x, number):
    return (lambda x, number: full(number)) if x is vector else (lambda x, number: number)


@inline
def at3(A, i):
    """Vector from place i on."""
    return V3(at(A, i), at(A, i + 1), at(A, i + 2))


@inline
def put3(A, i, v):
    """Write a vector from place i on."""
    put(A, i, v.x)
    put(A, i + 1, v.y)
    put(A, i + 2, v.z)


@inline
def rotation_at(A, i):
    """Matrix from nine places, by rows."""
    return M3(
        V3(at(A, i), at(A, i + 3), at(A, i + 6)),
        V3(at(A, i + 1), at(A, i + 4), at(A, i + 7)),
        V3(at(A, i + 2), at(A, i + 5), at(A, i + 8)),
    )


@inline
def put_axes(A, i, m):
    """Write a matrix to nine places, by rows."""
    put3(A, i, V3(m.x.x, m.y.x, m.z.x))
    put3(A, i + 3, V3(m.x.y, m.y.y, m.z.y))
    put3(A, i + 6, V3(m.x.z, m.y.z, m.z.z))


@inline
def sincos(x):
    """Sine and cosine together and branch-free, so that a loop over the joints vectorises; error below 1e-14 for |x| < 1e9.

    x: a number or lanes.
    """
    k = np.rint(x * 0.31830988618379067154)
    r = x - k * 3.1415926218032836914  # 25 bits of pi, then the rest of it
    r = r - k * 3.178650954705639e-08
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
    """sin(angle) times the axis of the rotation that brings M3 `now` to `goal`, and 1 + cos(angle)."""
    sine = (now.x.cross(goal.x) + now.y.cross(goal.y) + now.z.cross(goal.z)) * 0.5
    return sine, 0.5 * (1.0 + now.x.dot(goal.x) + now.y.dot(goal.y) + now.z.dot(goal.z))


@inline
def chord(angle):
    """|2 sin(angle/2)|^2, from the angle a tolerance allows; no rotation exceeds half a turn."""
    length = 2.0 * math.sin(0.5 * angle) if angle < math.pi else 3.0
    return length * length
