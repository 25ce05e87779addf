"""Forward kinematics, Jacobian columns and pose error of one chain, in one pass over flat arrays.

A chain is a table of rows, one per joint on the path, each `Rx(b) . T(tx, ty, slide*x + d0) . Rz(turn*x + a0)`. The
rotation between two joint axes is split Rz.Rx.Rz and both Rz go into the neighbouring joints' angles: exact for any axes
(the common normal of Denavit-Hartenberg is undefined for parallel ones) and 30 multiply-adds instead of 48.

Inside the kernel lengths, prismatic joints included, are divided by a power of two near the robot's reach (so that the
scaling is exact), and everything is expressed in the frame of the first joint; `aim` brings a target there.
"""

import math

import numpy as np

from .jit import inline, jit

# Columns of a row: cos b, sin b, tx, ty, turn, a0, slide, d0, coordinate, 1 turns / 0 slides.
# Row 0 has no Rx: its first slot says instead whether each joint is its own coordinate with ratio 1 (no mimic).
ROW = 10
TAU = 2.0 * math.pi


@inline
def sincos(x):
    """Sine and cosine together and branch-free, so that a loop over joints vectorises; error below 1e-14 for |x| < 1e9.

    x: a number or a vector.
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


@jit
def sincos_all(angles, sines, cosines):
    """Fill `sines` and `cosines`; a loop of its own so that it vectorises."""
    for i in range(angles.shape[0]):
        s, c = sincos(angles[i])
        sines[i] = s
        cosines[i] = c


@inline
def fk(rows, q, Z, ang, sn, cs):
    """Frame of the last joint (columns x, y, z and point p); Z[i] receives axis and point of joint i."""
    for i in range(rows.shape[0]):
        ang[i] = rows[i, 4] * q[int(rows[i, 8])] + rows[i, 5]
    sincos_all(ang, sn, cs)
    c = cs[0]
    s = sn[0]
    x0, x1, x2 = c, s, 0.0
    y0, y1, y2 = -s, c, 0.0
    z0, z1, z2 = 0.0, 0.0, 1.0
    px, py = 0.0, 0.0
    pz = rows[0, 7] + rows[0, 6] * q[int(rows[0, 8])]
    Z[0, 0] = 0.0
    Z[0, 1] = 0.0
    Z[0, 2] = 1.0
    Z[0, 3] = 0.0
    Z[0, 4] = 0.0
    Z[0, 5] = pz
    for i in range(1, rows.shape[0]):
        cb = rows[i, 0]
        sb = rows[i, 1]
        tx = rows[i, 2]
        ty = rows[i, 3]
        d = rows[i, 7] + rows[i, 6] * q[int(rows[i, 8])]
        v0 = y0 * cb + z0 * sb
        v1 = y1 * cb + z1 * sb
        v2 = y2 * cb + z2 * sb
        z0 = z0 * cb - y0 * sb
        z1 = z1 * cb - y1 * sb
        z2 = z2 * cb - y2 * sb
        px += x0 * tx + v0 * ty + z0 * d
        py += x1 * tx + v1 * ty + z1 * d
        pz += x2 * tx + v2 * ty + z2 * d
        Z[i, 0] = z0
        Z[i, 1] = z1
        Z[i, 2] = z2
        Z[i, 3] = px
        Z[i, 4] = py
        Z[i, 5] = pz
        c = cs[i]
        s = sn[i]
        y0 = v0 * c - x0 * s
        y1 = v1 * c - x1 * s
        y2 = v2 * c - x2 * s
        x0 = x0 * c + v0 * s
        x1 = x1 * c + v1 * s
        x2 = x2 * c + v2 * s
    return x0, x1, x2, y0, y1, y2, z0, z1, z2, px, py, pz


@inline
def columns(rows, Z, J, px, py, pz):
    """Fill J (n, 6), one row per coordinate, linear part first, at the tip point; mimic joints add to their leader."""
    plain = rows[0, 0] > 0.0
    if not plain:
        for i in range(J.shape[0]):
            for k in range(6):
                J[i, k] = 0.0
    for i in range(rows.shape[0]):
        zx = Z[i, 0]
        zy = Z[i, 1]
        zz = Z[i, 2]
        if rows[i, 9] > 0.0:
            rx = px - Z[i, 3]
            ry = py - Z[i, 4]
            rz = pz - Z[i, 5]
            j0, j1, j2 = zy * rz - zz * ry, zz * rx - zx * rz, zx * ry - zy * rx
            j3, j4, j5 = zx, zy, zz
        else:
            j0, j1, j2 = zx, zy, zz
            j3, j4, j5 = 0.0, 0.0, 0.0
        if plain:
            J[i, 0] = j0
            J[i, 1] = j1
            J[i, 2] = j2
            J[i, 3] = j3
            J[i, 4] = j4
            J[i, 5] = j5
        else:
            k = int(rows[i, 8])
            ratio = rows[i, 4] + rows[i, 6]
            J[k, 0] += ratio * j0
            J[k, 1] += ratio * j1
            J[k, 2] += ratio * j2
            J[k, 3] += ratio * j3
            J[k, 4] += ratio * j4
            J[k, 5] += ratio * j5


@jit
def aim(base, tip, scale, T, goal):
    """Target T_base_tip (4, 4) [m] -> rotation of the last joint (9) and tip point (3) in the first joint's frame."""
    inverse = 1.0 / scale
    for i in range(3):
        for k in range(3):
            s = 0.0
            for a in range(3):
                for b in range(3):
                    s += base[3 * a + i] * T[a, b] * tip[3 * k + b]
            goal[3 * i + k] = s
        goal[9 + i] = (
            base[i] * (T[0, 3] * inverse - base[9])
            + base[3 + i] * (T[1, 3] * inverse - base[10])
            + base[6 + i] * (T[2, 3] * inverse - base[11])
        )


@jit
def half_turn_axis(goal, x0, x1, x2, y0, y1, y2, z0, z1, z2, vx, vy, vz):
    """Axis of a rotation by (nearly) pi, from the symmetric part: there the antisymmetric part vanishes."""
    xx = goal[0] * x0 + goal[1] * y0 + goal[2] * z0
    yy = goal[3] * x1 + goal[4] * y1 + goal[5] * z1
    zz = goal[6] * x2 + goal[7] * y2 + goal[8] * z2
    xy = 0.5 * (goal[0] * x1 + goal[1] * y1 + goal[2] * z1 + goal[3] * x0 + goal[4] * y0 + goal[5] * z0)
    xz = 0.5 * (goal[0] * x2 + goal[1] * y2 + goal[2] * z2 + goal[6] * x0 + goal[7] * y0 + goal[8] * z0)
    yz = 0.5 * (goal[3] * x2 + goal[4] * y2 + goal[5] * z2 + goal[6] * x1 + goal[7] * y1 + goal[8] * z1)
    # R = 2 a a' - 1 at pi, so a a' = (R + 1) / 2: any of its columns is along a, the largest is the safest.
    if xx >= yy and xx >= zz:
        a0, a1, a2 = xx + 1.0, xy, xz
    elif yy >= zz:
        a0, a1, a2 = xy, yy + 1.0, yz
    else:
        a0, a1, a2 = xz, yz, zz + 1.0
    n = 1.0 / math.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
    if a0 * vx + a1 * vy + a2 * vz < 0.0:
        n = -n
    return a0 * n, a1 * n, a2 * n


@inline
def error(goal, tip, x0, x1, x2, y0, y1, y2, z0, z1, z2, px, py, pz):
    """Tip point, then error target - tip: position (3) and 2 sin(angle/2) times the rotation axis (3)."""
    tx = tip[9]
    ty = tip[10]
    tz = tip[11]
    px += x0 * tx + y0 * ty + z0 * tz
    py += x1 * tx + y1 * ty + z1 * tz
    pz += x2 * tx + y2 * ty + z2 * tz
    d0, d1, d2 = goal[0], goal[1], goal[2]
    d3, d4, d5 = goal[3], goal[4], goal[5]
    d6, d7, d8 = goal[6], goal[7], goal[8]
    vx = 0.5 * (x1 * d6 - x2 * d3 + y1 * d7 - y2 * d4 + z1 * d8 - z2 * d5)
    vy = 0.5 * (x2 * d0 - x0 * d6 + y2 * d1 - y0 * d7 + z2 * d2 - z0 * d8)
    vz = 0.5 * (x0 * d3 - x1 * d0 + y0 * d4 - y1 * d1 + z0 * d5 - z1 * d2)
    cos1 = 0.5 * (
        1.0 + x0 * d0 + x1 * d3 + x2 * d6 + y0 * d1 + y1 * d4 + y2 * d7 + z0 * d2 + z1 * d5 + z2 * d8
    )  # 1+cos
    if cos1 > 0.5:
        f = math.sqrt(2.0 / cos1)
        r0, r1, r2 = vx * f, vy * f, vz * f
    else:  # towards half a turn the length is better taken from the cosine, and at last the axis too
        vv = vx * vx + vy * vy + vz * vz
        r0, r1, r2 = vx, vy, vz
        if vv < 1e-8:
            r0, r1, r2 = half_turn_axis(goal, x0, x1, x2, y0, y1, y2, z0, z1, z2, vx, vy, vz)
            vv = 1.0
        f = math.sqrt((4.0 - 2.0 * cos1) / vv)
        r0 *= f
        r1 *= f
        r2 *= f
    return px, py, pz, goal[9] - px, goal[10] - py, goal[11] - pz, r0, r1, r2


@jit
def angle_ratio(rr):
    """angle / (2 sin(angle/2)) for rr = |2 sin(angle/2)|^2: turns the error's rotation part into a rotation vector."""
    h = 0.5 * math.sqrt(rr)
    if h < 1e-4:
        return 1.0 + rr / 24.0
    return math.asin(min(h, 1.0)) / h


@inline
def chord(angle):
    """|2 sin(angle/2)|^2, what a tolerance allows; no rotation is beyond half a turn."""
    length = 2.0 * math.sin(0.5 * angle) if angle < math.pi else 3.0
    return length * length


@jit
def rotation_angle(rr):
    """Angle [rad] in 0..pi for rr = |2 sin(angle/2)|^2."""
    return 2.0 * math.asin(min(0.5 * math.sqrt(rr), 1.0))
