"""What of the pose error counts: all of it, the position, a mask of six weights, or one axis of the tip."""

import math

from .jit import jit
from .kinematics import angle_ratio

POSE, POSITION, MASK_BASE, MASK_TIP, AXIS = range(5)


@jit
def shape_error(kind, w, ends, goal, V, y, x0, x1, x2, y0, y1, y2, z0, z1, z2, e0, e1, e2, e3, e4, e5):
    """Set to zero, rotate or replace what of the pose error does not count; V and y keep what `shape_columns` needs.

    w: six weights for the masks (base axes, or tip axes), or the tip axis (in the last joint's frame) for AXIS.
    """
    if kind == POSITION:
        return e0, e1, e2, 0.0, 0.0, 0.0
    if kind == AXIS:  # from a (now) to b (wanted)
        a0 = x0 * w[0] + y0 * w[1] + z0 * w[2]
        a1 = x1 * w[0] + y1 * w[1] + z1 * w[2]
        a2 = x2 * w[0] + y2 * w[1] + z2 * w[2]
        b0 = goal[0] * w[0] + goal[1] * w[1] + goal[2] * w[2]
        b1 = goal[3] * w[0] + goal[4] * w[1] + goal[5] * w[2]
        b2 = goal[6] * w[0] + goal[7] * w[1] + goal[8] * w[2]
        y[0], y[1], y[2] = a0, a1, a2
        cos1 = 1.0 + a0 * b0 + a1 * b1 + a2 * b2
        if cos1 > 1e-9:
            f = math.sqrt(2.0 / cos1)
            return e0, e1, e2, f * (a1 * b2 - a2 * b1), f * (a2 * b0 - a0 * b2), f * (a0 * b1 - a1 * b0)
        if abs(a0) < 0.7:  # opposite: any axis across will do
            f = 2.0 / math.sqrt(a1 * a1 + a2 * a2)
            return e0, e1, e2, 0.0, -a2 * f, a1 * f
        f = 2.0 / math.sqrt(a0 * a0 + a1 * a1)
        return e0, e1, e2, -a1 * f, a0 * f, 0.0
    for r in range(3):  # masks: rotate to the named frame, weight
        if kind == MASK_BASE:
            V[r, 0], V[r, 1], V[r, 2] = ends[3 * r], ends[3 * r + 1], ends[3 * r + 2]
        else:
            t0, t1, t2 = ends[12 + r], ends[15 + r], ends[18 + r]
            V[r, 0], V[r, 1], V[r, 2] = (
                x0 * t0 + y0 * t1 + z0 * t2,
                x1 * t0 + y1 * t1 + z1 * t2,
                x2 * t0 + y2 * t1 + z2 * t2,
            )
    ratio = angle_ratio(e3 * e3 + e4 * e4 + e5 * e5)
    e3, e4, e5 = e3 * ratio, e4 * ratio, e5 * ratio
    y[0], y[1], y[2], y[3], y[4], y[5] = e0, e1, e2, e3, e4, e5
    return (
        w[0] * (V[0, 0] * e0 + V[0, 1] * e1 + V[0, 2] * e2),
        w[1] * (V[1, 0] * e0 + V[1, 1] * e1 + V[1, 2] * e2),
        w[2] * (V[2, 0] * e0 + V[2, 1] * e1 + V[2, 2] * e2),
        w[3] * (V[0, 0] * e3 + V[0, 1] * e4 + V[0, 2] * e5),
        w[4] * (V[1, 0] * e3 + V[1, 1] * e4 + V[1, 2] * e5),
        w[5] * (V[2, 0] * e3 + V[2, 1] * e4 + V[2, 2] * e5),
    )


@jit
def log_curvature(x, y, z):
    """c in the derivative w + 1/2 r x w + c r x (r x w) of a rotation vector r = (x, y, z) (its inverse right Jacobian)."""
    rr = x * x + y * y + z * z
    if rr < 1e-4:
        return 1.0 / 12.0 + rr / 720.0  # the next term is rr^2 / 30240
    half = 0.5 * math.sqrt(rr)
    return (1.0 - half * math.cos(half) / math.sin(half)) / rr


@jit
def shape_columns(kind, w, V, y, J):
    """Remove from the Jacobian what does not count, at the configuration shaped last.

    With a mask the free part of the error stays large while the rest vanishes, so the columns are the exact derivative of the
    rotation vector, and in tip axes also of the axes that turn with the tip: otherwise steps would not reach the target.
    """
    side = 0.5 if kind == MASK_BASE else -0.5  # in tip axes: the inverse left Jacobian
    c = log_curvature(y[3], y[4], y[5]) if kind == MASK_BASE or kind == MASK_TIP else 0.0
    for i in range(J.shape[0]):
        if kind == POSITION:
            J[i, 3], J[i, 4], J[i, 5] = 0.0, 0.0, 0.0
        elif kind == AXIS:
            d = y[0] * J[i, 3] + y[1] * J[i, 4] + y[2] * J[i, 5]
            J[i, 3] -= d * y[0]
            J[i, 4] -= d * y[1]
            J[i, 5] -= d * y[2]
        else:
            a, b, d = J[i, 3], J[i, 4], J[i, 5]
            if kind == MASK_TIP:
                J[i, 0] += b * y[2] - d * y[1]
                J[i, 1] += d * y[0] - a * y[2]
                J[i, 2] += a * y[1] - b * y[0]
            r0, r1, r2 = y[4] * d - y[5] * b, y[5] * a - y[3] * d, y[3] * b - y[4] * a
            J[i, 3] += side * r0 + c * (y[4] * r2 - y[5] * r1)
            J[i, 4] += side * r1 + c * (y[5] * r0 - y[3] * r2)
            J[i, 5] += side * r2 + c * (y[3] * r1 - y[4] * r0)
            for h in range(0, 6, 3):
                u, v, t = J[i, h], J[i, h + 1], J[i, h + 2]
                for r in range(3):
                    J[i, h + r] = w[h + r] * (V[r, 0] * u + V[r, 1] * v + V[r, 2] * t)
