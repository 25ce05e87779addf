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
    """The path of a point that turns about a line by x: middle + side cos x + ahead sin x."""

    middle: V3
    side: V3
    ahead: V3

    def spot(self, c, s):
        """Return the point of the circle at the angle with cosine c and sine s."""
        return self.middle + self.side * c + self.ahead * s

    def width(self):
        return math.sqrt(self.side.square())


@compiled
class Sum(NamedTuple):
    """A quantity that depends on where a point is on a circle: k + a cos x + b sin x."""

    k: float
    a: float
    b: float

    def value(self, c, s):
        return self.k + self.a * c + self.b * s

    def drift(self, c, s, error):
        """Return by how much the value at cosine c and sine s may be off if the angle is off by `error` [rad]."""
        return error * (abs(self.b * c - self.a * s) + error * self.swing())

    def swing(self):
        """Return by how much the value differs from k at most."""
        return math.sqrt(self.a * self.a + self.b * self.b)


@compiled
class Angles(NamedTuple):
    """The angles that solve a subproblem; `first` and `second` are in rad."""

    first: float
    second: float
    number: int  # number of solutions: 2, 1 (the two are one), or 0
    error: float  # bound on the error of the angles [rad]
    free: bool  # whether every angle is a solution, of which `first` is one
    merged: bool  # whether the two solutions may really be one, or none, within the error
    # whether solutions that may be one, or none, within the error could be apart by more than can be neglected
    doubt: bool


@inline
def circle_about(line, point, sense):
    """Return the Circle of a point (V3) that turns about a line by the angle x, or by -x (sense 1.0 or -1.0)."""
    away = point - line.point
    height = line.along * line.along.dot(away)
    side = away - height
    return Circle(line.point + height, side, line.along.cross(side) * sense)


@inline
def height_on(circle, axis):
    """Return the height along an axis through the origin of a point that runs round a circle, as a Sum over its angle."""
    return Sum(circle.middle.dot(axis), circle.side.dot(axis), circle.ahead.dot(axis))


@inline
def square_on(circle, point):
    """Return half the squared distance between a point on a circle and a fixed point, as a Sum."""
    m = circle.middle - point
    return Sum(0.5 * (m.square() + circle.side.square()), m.dot(circle.side), m.dot(circle.ahead))


@inner
def solve_sum(sum, value, error):
    """Return, as Angles, the solutions x of k + a cos x + b sin x = value, where each number may be off by `error`.

    sum: the left side (Sum).
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
    """Return, as Angles, the rotation about a unit axis that takes the direction `start` as near as possible to `end`.

    Both directions, of any length, may be off by `error`.
    """
    a, b = start - axis * axis.dot(start), end - axis * axis.dot(end)
    length = math.sqrt(min(a.square(), b.square()))
    x, band = math.atan2(axis.dot(a.cross(b)), a.dot(b)), DOUBT.band * error
    if length <= max(band, DOUBT.still):
        return Angles(x, x, 1, 0.0, True, True, band > DOUBT.loose)
    return Angles(x, x, 1, 2.0 * error / length, False, False, False)


@compiled
class AngleRanges(NamedTuple):
    """One or two arcs of a circle, of equal length; `first` and `second` are the angles of their middles [rad]."""

    first: float
    second: float
    number: int
    half: float  # half the angle of each arc [rad]


@inner
def arcs_between(sum, low, high):
    """Return the arcs on which low <= k + a cos x + b sin x <= high (a Sum); if there are none, the angles that come nearest."""
    size, middle = max(sum.swing(), 1e-300), math.atan2(sum.b, sum.a)
    near = math.acos(max(-1.0, min(1.0, (high - sum.k) / size)))
    far = math.acos(max(-1.0, min(1.0, (low - sum.k) / size)))
    if near == 0.0:  # Both arcs meet at the angle `middle`, or opposite to it if `far` is pi, so they are one.
        return AngleRanges(middle, middle, 1, far)
    if far == math.pi:
        return AngleRanges(middle + far, middle + far, 1, far - near)
    at = 0.5 * (near + far)
    return AngleRanges(middle + at, middle - at, 2, 0.5 * abs(far - near))
