"""A closed loop of six revolute joints, E1(q1) ... E6(q6) = X, given by six axes and the pose X.

An axis is six numbers, its unit direction and one of its points, at q = 0. E(q) turns space about it by q. X (12,), the motion from
the tip's pose at q = 0 to the target, is a rotation matrix by rows and a vector. Lengths are divided by the size of the arm; points
are measured from its centre.
"""

# Numba's type hints are incomplete, so pyright must not report what they lack.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import math
from typing import NamedTuple

from ...compile.jit import compiled, inline, inner, shared
from ..algebra import M3, V3, Pose, at3, put3, rotation_at, rotation_left, transposed
from ..kinematics import TAU
from ..linalg import lu_factor, lu_substitute
from ..records import Array
from ..vectors import largest
from .terms import TRUST


@compiled
class Line(NamedTuple):
    """A line in space, for instance the axis of a joint."""

    along: V3  # unit vector along the line
    point: V3  # any point of the line


@compiled
class JointLoop(NamedTuple):
    """The loop equation E1(q1) ... E6(q6) = X of an arm at one target, and the arrays of Newton's method that solves it.

    Ei is the rotation about the axis of joint i. Lengths are divided by the arm's size.
    """

    axes: Array  # (6, 6) the joints' axes at q = 0, one a row
    X: Array  # (12,) the pose X = E1(q1) ... E6(q6) to reach: rotation matrix by rows, then translation
    J: Array  # (6, 6) twist of each joint at q, one a column: linear, then angular
    B: Array  # (6, 6) the inverse of J but for the order of its columns: only its norm is needed
    swaps: Array  # (12,) for each k, the row that was exchanged with row k when J was factored
    error: Array  # (6,) the motion that is left to the pose X, as a twist: linear, then angular
    q: Array  # (6,) joint values


@inline
def pose_of(X):
    """Return the motion X (12,), a rotation matrix by rows and a vector, as a Pose."""
    return Pose(rotation_at(X, 0), at3(X, 9))


@inline
def line_of(lines, k):
    """Return row k of an array of axes (6, 6) as a Line."""
    return Line(at3(lines[k], 0), at3(lines[k], 3))


@inline
def rotated(v, axis, c, s):
    """Return a vector v turned about a unit axis by the angle with cosine c and sine s (Rodrigues 1840)."""
    return v * c + axis.cross(v) * s + axis * (axis.dot(v) * (1.0 - c))


@inner
def turned(line, about, c, s):
    """Return a line turned about another line by the angle with cosine c and sine s."""
    axis = about.along
    return Line(rotated(line.along, axis, c, s), about.point + rotated(line.point - about.point, axis, c, s))


@inline
def line_moved(pose, line):
    """Return a line moved by a rigid motion, which is given as a Pose."""
    return Line(pose.axes.times(line.along), pose.axes.times(line.point) + pose.point)


@inline
def inverse(pose):
    """Return the inverse of a rigid motion, which is given as a Pose."""
    back = transposed(pose.axes)
    return Pose(back, -back.times(pose.point))


@shared
def joint_at(place, backwards, shift):
    """Return which joint of the arm (0 to 5) is at position `place` of a reordered loop.

    backwards: whether the loop is reversed; shift: how many joints later it begins.
    """
    k = place + shift
    if k >= 6:
        k -= 6
    return 5 - k if backwards else k


@inline
def wrapped(angle):
    """Return an angle [rad] shifted by a multiple of 2 pi into [-pi, pi)."""
    return angle - TAU * math.floor((angle + math.pi) / TAU)


@inner
def reorder(axes, X, backwards, shift, lines):
    """Rewrite the loop equation of an arm so that it begins at another joint or is reversed.

    Reversed, E1(q1) ... E6(q6) = X is E6(-q6) ... E1(-q1) = X^-1. Begun m joints later it is

        E(m+1) ... E6 E1' ... Em' = X,  Ei' = X^-1 Ei X,

    that is, the axes of the joints that pass to the end are moved by X^-1. For m = 4 and 5 all axes are also moved by X, so that
    the axes at positions 3 to 5, the robot's side of the equations, do not depend on the target. Returns the pose on the right
    side. axes: (6, 6) joint axes in the arm's order; X: (12,) pose; backwards: whether the loop is reversed; shift: m; lines (6, 6)
    receives the reordered axes.
    """
    pose = pose_of(X)
    if backwards:
        pose = inverse(pose)
    back = inverse(pose)
    for place in range(6):
        line = line_of(axes, joint_at(place, backwards, shift))
        passed = place + shift >= 6
        if shift <= 3 and passed:
            line = line_moved(back, line)
        elif shift >= 4 and not passed:
            line = line_moved(pose, line)
        put3(lines[place], 0, line.along)
        put3(lines[place], 3, line.point)
    return pose


@inner
def measure_loop(loop, q):
    """Return by how much an arm at q (6,) misses its pose X: the largest component of the error [arm sizes, rad].

    The joints' twists are written to loop.J, and the error to loop.error: with G = E1(q1) ... E6(q6), it is the motion X G^-1 to
    first order, a vector and the sine of the angle times the axis. loop: `JointLoop`.
    """
    x, y, z, p = V3(1.0, 0.0, 0.0), V3(0.0, 1.0, 0.0), V3(0.0, 0.0, 1.0), V3(0.0, 0.0, 0.0)
    for k in range(6):
        line = line_of(loop.axes, k)
        R = M3(x, y, z)
        along, point = R.times(line.along), R.times(line.point) + p
        v = point.cross(along)
        J = loop.J
        J[0, k], J[1, k], J[2, k] = v.x, v.y, v.z
        J[3, k], J[4, k], J[5, k] = along.x, along.y, along.z
        c, s = math.cos(q[k]), math.sin(q[k])
        x, y, z = rotated(x, along, c, s), rotated(y, along, c, s), rotated(z, along, c, s)
        p = point + rotated(p - point, along, c, s)
    R, goal = M3(x, y, z), pose_of(loop.X)
    sine, cos1 = rotation_left(R, goal.axes)
    left = goal.point - goal.axes.times(R.across(p))
    put3(loop.error, 0, left)
    put3(loop.error, 3, sine)
    size = abs(2.0 - cos1)
    for k in range(6):
        size = max(size, abs(loop.error[k]))
    return size


@inner
def close(loop):
    """Move the joint values loop.q (6,) to a solution of the loop equation by Newton's method.

    Returns the largest component of the error that is left. No step moves a joint by more than TRUST.longest [rad]. The first step
    that moves all joints by less than TRUST.still [rad] is the last, and there are at most TRUST.steps. loop: `JointLoop`.
    """
    q, move = loop.q, math.inf
    for k in range(TRUST.steps + 1):
        size = measure_loop(loop, q)
        if k == TRUST.steps or move < TRUST.still or not size < 1e6:
            break
        lu_factor(loop.J, loop.swaps, 6, TRUST.faint)
        lu_substitute(loop.J, loop.swaps, loop.error, 6)
        move = largest(loop.error)
        share = 1.0 if move < TRUST.longest else TRUST.longest / move
        for i in range(6):
            q[i] += share * loop.error[i]
    return size


@inner
def least_gain(loop):
    """Return how far an arm is from a singular pose: 1 / |J^-1| (Frobenius norm).

    This is 0.4 to 1 times the least singular value of the Jacobian J = loop.J. loop: `JointLoop`, whose J is overwritten.
    """
    J, B, total = loop.J, loop.B, 0.0
    lu_factor(J, loop.swaps, 6, TRUST.faint)
    # First step of the inversion: B = L^-1. The exchanges of rows are left out, as they do not change its norm.
    for i in range(6):
        for j in range(6):
            B[i, j] = 1.0 if i == j else 0.0
        for k in range(i):
            for j in range(6):
                B[i, j] -= J[i, k] * B[k, j]
    for i in range(5, -1, -1):  # Second step of the inversion: B = U^-1 L^-1.
        for k in range(i + 1, 6):
            for j in range(6):
                B[i, j] -= J[i, k] * B[k, j]
        share = 1.0 / J[i, i]
        for j in range(6):
            B[i, j] *= share
            total += B[i, j] * B[i, j]
    return 1.0 / math.sqrt(total) if total < math.inf else 0.0
