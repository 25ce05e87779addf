"""Geometric subproblems: which rotations about an axis bring a point to a given place (Paden 1985, Elias and Wen 2022).

All reduce to a cos x + b sin x = c. A point that turns about an axis moves on a circle; its height along another axis, and half its
squared distance from a point, are linear in cos x and sin x. So `solve_sum` solves subproblems 3 (distance) and 4 (height), and
followed by `angle_from` (subproblem 1) also subproblem 2 (two rotations that take one direction to another).

Every answer has an error bound, given the error of the input: rounding, or axes that miss each other by a little. Within that bound
two angles merge into one, and a point on the axis leaves the angle free.
"""

# Numba's type hints are incomplete, so pyright must not report what they lack.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import math
from typing import NamedTuple

from ...compile.jit import compiled, inline, inner
from ..algebra import V3
from .terms import DOUBT


@compiled
class Circle(NamedTuple):
    """The circular path of a point that turns about an axis by an angle x: middle + side cos x + ahead sin x."""

    middle: V3
    side: V3
    ahead: V3

    def spot(self, c, s):
        """Return the point (V3) of the circle at the angle whose cosine is c and sine s."""
        return self.middle + self.side * c + self.ahead * s

    def width(self):
        return math.sqrt(self.side.square())


@compiled
class Sum(NamedTuple):
    """A quantity that varies as k + a cos x + b sin x with the angle x of a joint, such as the height of a point that it turns."""

    k: float
    a: float
    b: float

    def value(self, c, s):
        return self.k + self.a * c + self.b * s

    def drift(self, c, s, error):
        """Return a bound on the error of k + a c + b s if the angle, with cosine c and sine s, is off by `error` [rad]."""
        return error * (abs(self.b * c - self.a * s) + error * self.swing())

    def swing(self):
        """Return the amplitude: by how much the value differs from its mean k at most."""
        return math.sqrt(self.a * self.a + self.b * self.b)


@compiled
class Angles(NamedTuple):
    """The solutions of a subproblem: up to two joint angles, `first` and `second` [rad], and how certain they are."""

    first: float
    second: float
    number: int  # number of solutions: 2, 1 (both angles are equal), or 0
    error: float  # bound on the error of the angles [rad]
    free: bool  # whether every angle is a solution, so that `first` is only one of them
    merged: bool  # whether, within the error, the two solutions may be one, or may not exist
    # whether `merged` solutions may be too far apart to be treated as one (more than DOUBT.apart)
    doubt: bool


@inline
def circle_about(line, point, sense):
    """Return the Circle on which a point (V3) turns about a line by the angle x, or by -x (sense 1.0 or -1.0)."""
    away = point - line.point
    height = line.along * line.along.dot(away)
    side = away - height
    return Circle(line.point + height, side, line.along.cross(side) * sense)


@inline
def height_on(circle, axis):
    """Return the height of a point on a circle along an axis through the origin, as a Sum over the angle on the circle."""
    return Sum(circle.middle.dot(axis), circle.side.dot(axis), circle.ahead.dot(axis))


@inline
def square_on(circle, point):
    """Return half the squared distance of a point on a circle from a fixed point, as a Sum over the angle on the circle."""
    m = circle.middle - point
    return Sum(0.5 * (m.square() + circle.side.square()), m.dot(circle.side), m.dot(circle.ahead))


@inner
def solve_sum(sum, value, error):
    """Solve k + a cos x + b sin x = value for x, where each number may be off by `error`; return the solutions as Angles.

    sum: k, a and b, as a Sum.
    """
    a, b, c = sum.a, sum.b, value - sum.k
    size, band = math.sqrt(a * a + b * b), DOUBT.band * error
    if not abs(c) - size <= band:
        return Angles(0.0, 0.0, 0, 0.0, False, False, False)
    rest, least = (size - abs(c)) * (size + abs(c)), band * (size + abs(c))
    middle = math.atan2(b, a)
    half = math.atan2(math.sqrt(max(rest, 0.0)), c)
    if size <= max(band, DOUBT.still):
        return Angles(middle + half, 0.0, 1, 0.0, True, True, band > DOUBT.loose)
    off = 2.0 * error / math.sqrt(max(rest, least))
    doubt = rest <= least and math.sqrt(least) > DOUBT.apart * size
    return Angles(middle + half, middle - half, 2 if rest > 0.0 else 1, off, False, rest <= least, doubt)


@inner
def angle_from(axis, start, end, error):
    """Return, as Angles, the rotation about a unit axis that brings the direction `start` as near as possible to `end`.

    The two vectors may have any length; their components may be off by `error`.
    """
    a, b = start - axis * axis.dot(start), end - axis * axis.dot(end)
    length = math.sqrt(min(a.square(), b.square()))
    x, band = math.atan2(axis.dot(a.cross(b)), a.dot(b)), DOUBT.band * error
    if length <= max(band, DOUBT.still):
        return Angles(x, x, 1, 0.0, True, True, band > DOUBT.loose)
    return Angles(x, x, 1, 2.0 * error / length, False, False, False)


@compiled
class AngleRanges(NamedTuple):
    """The range of a joint angle: one or two arcs of equal length, centred at the angles `first` and `second` [rad]."""

    first: float
    second: float
    number: int
    half: float  # half the angle of each arc [rad]


@inner
def arcs_between(sum, low, high):
    """Return the angles x at which low <= k + a cos x + b sin x <= high, as one or two arcs (AngleRanges).

    If there are none, the arcs have length 0, at the angles where the sum comes nearest. sum: k, a and b, as a Sum.
    """
    size, middle = max(sum.swing(), 1e-300), math.atan2(sum.b, sum.a)
    near = math.acos(max(-1.0, min(1.0, (high - sum.k) / size)))
    far = math.acos(max(-1.0, min(1.0, (low - sum.k) / size)))
    if near == 0.0:  # The two arcs touch at the angle `middle`, so they are one, all round the circle if `far` is pi.
        return AngleRanges(middle, middle, 1, far)
    if far == math.pi:
        return AngleRanges(middle + far, middle + far, 1, far - near)
    at = 0.5 * (near + far)
    return AngleRanges(middle + at, middle - at, 2, 0.5 * abs(far - near))
