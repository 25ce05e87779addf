"""Forward kinematics, Jacobian columns and pose error of one chain, in one pass over flat arrays.

A chain is a table of rows, one per joint on the path from base to tip. Each is `Rx(b) . T(tx, ty, slide*x + d0) . Rz(turn*x + a0)`,
where x is the joint's coordinate. The rotation between two joint axes is split into Rz.Rx.Rz, and both Rz go into the neighbouring
joints' angles. This is exact for any axes (the common normal of Denavit-Hartenberg is undefined for parallel axes) and takes 30
multiply-adds instead of 48.

Internal units: all lengths, also the coordinates of prismatic joints, are divided by a power of two near the robot's reach, so that
this scaling is exact. Everything is expressed in the frame of the first joint; `aim` converts a target to it.
"""

import math

from ..compile.jit import inline, inner
from .algebra import M3, V3, Pose, alike, at, at3, pose_from, put, put3, rotation_at, rotation_left, sincos, transposed

# Length of a joint's row. Its transformation is Rx(b) T(tx, ty, slide x + d0) Rz(turn x + a0), where x is its coordinate; the row
# has cos b, sin b, tx, ty, turn, a0, slide, d0, the index of the coordinate, and 1 for a revolute joint, else 0.
ROW = 10
# A joint is not a mimic joint if its ratio to its coordinate differs from 1 by less than this, which is rounding.
RATIO = 1e-12
TAU = 2.0 * math.pi


@inner
def own_coordinates(rows, n):
    """Return whether each row i of a chain (L, 10) moves coordinate i alone with ratio 1, so that there is no mimic joint."""
    own = rows.shape[0] == n
    for i in range(rows.shape[0]):
        own = own and int(rows[i, 8]) == i and abs(rows[i, 4] + rows[i, 6] - 1.0) <= RATIO
    return own


@inline
def room(L):
    """Return the lengths that `fk` needs for its arrays `joints` and `trig`, for a chain of L joints.

    `trig` is padded to whole SIMD registers.
    """
    return 6 * L, 3 * ((L + 3) // 4 * 4)


@inline
def turn_all(rows, q, trig):
    """Fill `trig` with the angles of all joints at q (n,), then their sines, then their cosines.

    rows: (L, 10) geometry. Sines and cosines have a loop of their own, which is vectorised.
    """
    size = trig.shape[0] // 3
    for i in range(rows.shape[0]):
        put(trig, i, at(q, int(rows[i, 8])) * rows[i, 4] + rows[i, 5])
    for i in range(size):
        s, c = sincos(at(trig, i))
        put(trig, size + i, s)
        put(trig, 2 * size + i, c)


@inline
def fk(rows, q, joints, trig):
    """Return the pose of the last joint at q (n,) by forward kinematics; write the axis and a point of each joint to `joints`.

    Those of joint i go to joints[6 i : 6 i + 6]. rows: (L, 10) geometry; trig: receives angles, sines and cosines of the joints;
    see `room` for the lengths of both arrays.
    """
    turn_all(rows, q, trig)
    size = trig.shape[0] // 3
    s, c = at(trig, size), at(trig, 2 * size)
    zero, one = alike(c, 0.0), alike(c, 1.0)
    x, y, z = V3(c, s, zero), V3(-s, c, zero), V3(zero, zero, one)
    p = V3(zero, zero, at(q, int(rows[0, 8])) * rows[0, 6] + rows[0, 7])
    put3(joints, 0, z)
    put3(joints, 3, p)
    for i in range(1, rows.shape[0]):  # The first joint was done above: its row has no rotation by b.
        cb, sb = rows[i, 0], rows[i, 1]
        v = y * cb + z * sb  # The axes y and z are rotated by the angle b about x.
        z = z * cb - y * sb
        d = at(q, int(rows[i, 8])) * rows[i, 6] + rows[i, 7]
        p = p + (x * rows[i, 2] + v * rows[i, 3] + z * d)  # The point p moves along the axes of the joint's frame.
        put3(joints, 6 * i, z)
        put3(joints, 6 * i + 3, p)
        s, c = at(trig, size + i), at(trig, 2 * size + i)
        y = v * c - x * s  # The axes x and y are rotated by the joint's angle about z.
        x = x * c + v * s
    return Pose(M3(x, y, z), p)


@inline
def column(rows, joints, i, tip):
    """Return the linear and angular velocity of the point `tip` (V3) per unit of joint i.

    rows: (L, 10) geometry; joints: axes and points of the joints, as `fk` writes them.
    """
    axis = at3(joints, 6 * i)
    if rows[i, 9] > 0.0:
        return axis.cross(tip - at3(joints, 6 * i + 3)), axis
    return axis, axis * 0.0


@inner
def aim(ends, T, goal):
    """Write to goal (12,) the pose that a target T (4, 4) [m, base axes] asks for, in the frame of the first joint.

    It consists of the rotation of the last joint (9), by rows, and the position of the tip (3) [arm reaches]. ends: `Ends`.
    """
    base, target = rotation_at(ends.flat, 0), pose_from(T)
    put3(goal, 9, base.across(target.point * (1.0 / ends.scale()) - at3(ends.flat, 9)))
    for k in range(3):  # The rotation base' T tip' (of base, target and tip) is computed column by column.
        v = base.across(target.axes.times(at3(ends.flat, 12 + 3 * k)))
        goal[k], goal[3 + k], goal[6 + k] = v.x, v.y, v.z


@inner
def half_turn_axis(now, goal, sine):
    """Return the axis of the rotation from `now` to `goal` (M3), by almost pi, from the symmetric part of its matrix.

    The antisymmetric part, which gives `sine` = sin(angle) times the axis, almost vanishes there; only the sign is taken from it.
    """
    # For an angle of pi the matrix is R = 2 a a' - 1, so each column of (R + 1) / 2 = a a' is along a; the longest is the most
    # accurate.
    x, y, z = transposed(goal)
    u, v, w = transposed(now)
    xx, yy, zz = x.dot(u), y.dot(v), z.dot(w)
    xy, xz, yz = 0.5 * (x.dot(v) + y.dot(u)), 0.5 * (x.dot(w) + z.dot(u)), 0.5 * (y.dot(w) + z.dot(v))
    if xx >= yy and xx >= zz:
        axis = V3(xx + 1.0, xy, xz)
    elif yy >= zz:
        axis = V3(xy, yy + 1.0, yz)
    else:
        axis = V3(xz, yz, zz + 1.0)
    n = 1.0 / math.sqrt(axis.square())
    return axis * (-n if axis.dot(sine) < 0.0 else n)


@inline
def rotation_error(now, goal):
    """Return 2 sin(angle/2) times the axis of the rotation that takes the rotation matrix `now` to `goal` (both M3)."""
    r, cos1 = rotation_left(now, goal)
    if cos1 > 0.5:
        return r * math.sqrt(2.0 / cos1)
    # Near pi the angle follows from the cosine, because the sine is too inaccurate there. Very near pi the axis is inaccurate, too.
    square = r.square()
    if square < 1e-8:
        r = half_turn_axis(now, goal, r)
        square = 1.0
    return r * math.sqrt((4.0 - 2.0 * cos1) / square)


@inline
def pose_error(goal, axes, tip):
    """Return the position error and the rotation error of a tip, the latter as 2 sin(angle/2) times the axis.

    goal: (12,) target as `aim` writes it; axes (M3): axes of the last joint; tip (V3): position of the tip.
    """
    return at3(goal, 9) - tip, rotation_error(axes, rotation_at(goal, 0))


@inner
def angle_ratio(rr):
    """Return angle / (2 sin(angle/2)) for rr = |2 sin(angle/2)|^2.

    A rotation error, 2 sin(angle/2) times the axis, becomes a rotation vector by this factor.
    """
    h = 0.5 * math.sqrt(rr)
    if h < 1e-4:
        return 1.0 + rr / 24.0
    return math.asin(min(h, 1.0)) / h


@inner
def rotation_angle(rr):
    """Return the angle [rad] between 0 and pi for which rr = |2 sin(angle/2)|^2."""
    return 2.0 * math.asin(min(0.5 * math.sqrt(rr), 1.0))


@inner
def jacobian_rate(rows, joints, J, first, tip, x, y, out):
    """Write to out (6,) the product (dJ/dt) y, where J is the tip's 6 x n Jacobian and the joints move at the rates x (n,).

    rows: (L, 10) geometry; joints: as `fk` fills it; J (n, m): the transposed Jacobian, in six columns from `first` on; tip (V3):
    position of the tip; y: (n,).
    """
    zero = V3(0.0, 0.0, 0.0)
    v = zero  # linear velocity of the tip
    for i in range(J.shape[0]):
        v = v + V3(J[i, first], J[i, first + 1], J[i, first + 2]) * x[i]
    # While the loop is at joint i, `turn` is the angular velocity of the link before it, `speed` the velocity of the stored point
    # on its axis.
    turn, speed = zero, zero
    linear, angular = zero, zero
    for i in range(rows.shape[0]):
        k = int(rows[i, 8])
        axis, point = at3(joints, 6 * i), at3(joints, 6 * i + 3)
        if i > 0:
            speed = speed + turn.cross(point - at3(joints, 6 * i - 3))
        change = turn.cross(axis)  # rate of change of the joint's axis
        ratio = rows[i, 4] + rows[i, 6]
        f, g = ratio * y[k], ratio * x[k]
        if rows[i, 9] > 0.0:
            linear = linear + (change.cross(tip - point) + axis.cross(v - speed)) * f
            angular = angular + change * f
            turn = turn + axis * g
        else:
            linear = linear + change * f
            speed = speed + axis * g
    put3(out, 0, linear)
    put3(out, 3, angular)
