"""What of the pose error counts: all of it, the position, a mask of six weights, or one axis of the tip."""

import math

from .algebra import M3, V3, at3, put3, rotation_at
from .jit import inline, inner
from .kinematics import angle_ratio

POSE, POSITION, MASK_BASE, MASK_TIP, AXIS = range(5)
# What `shape_error` keeps for `shape_column`: axes of the mask (9), or the tip's axis; the pose error (6); `log_curvature`.
KEPT = 16
OPPOSITE = 1e-9  # 1 + cos of the angle below which two directions are opposite, and their cross product says nothing


@inner
def axis_error(a, b):
    """2 sin(angle/2) times the axis of the least rotation that brings the direction a to b."""
    cos1 = 1.0 + a.dot(b)
    if cos1 > OPPOSITE:
        return a.cross(b) * math.sqrt(2.0 / cos1)
    across = (
        V3(0.0, -a.z, a.y) if abs(a.x) < 0.7 else V3(-a.y, a.x, 0.0)
    )  # any axis across will do; 0.7: the longer of two
    return across * (2.0 / math.sqrt(across.square()))


@inner
def log_curvature(rr):
    """c in the derivative w + 1/2 r x w + c r x (r x w) of a rotation vector r with rr = |r|^2 (its inverse right Jacobian)."""
    if rr < 1e-4:
        return 1.0 / 12.0 + rr / 720.0  # the next term is rr^2 / 30240
    half = 0.5 * math.sqrt(rr)
    return (1.0 - half * math.cos(half) / math.sin(half)) / rr


@inline
def weighed(w, axes, linear, angular):
    """Both vectors in the frame of `axes` and times the six weights."""
    u, v = axes.across(linear), axes.across(angular)
    return V3(w[0] * u.x, w[1] * u.y, w[2] * u.z), V3(w[3] * v.x, w[4] * v.y, w[5] * v.z)


@inline
def axes_at(kept):
    """Axes of the mask, as `shape_error` kept them."""
    return M3(at3(kept, 0), at3(kept, 3), at3(kept, 6))


@inner
def shape_error(kind, w, ends, goal, kept, now, linear, angular):
    """Set to zero, rotate or replace what of the pose error does not count; `kept` (KEPT,) is for `shape_column`.

    w: six weights for the masks (base axes, or tip axes), or the tip axis (in the last joint's frame) for AXIS.
    """
    if kind == POSITION:
        return linear, V3(0.0, 0.0, 0.0)
    if kind == AXIS:
        axis = at3(w, 0)
        a = now.times(axis)
        put3(kept, 0, a)
        return linear, axis_error(a, rotation_at(goal, 0).times(axis))
    if kind == MASK_BASE:
        put3(kept, 0, at3(ends.flat, 0))
        put3(kept, 3, at3(ends.flat, 3))
        put3(kept, 6, at3(ends.flat, 6))
    else:
        tip = rotation_at(ends.flat, 12)
        put3(kept, 0, now.times(tip.x))
        put3(kept, 3, now.times(tip.y))
        put3(kept, 6, now.times(tip.z))
    turn = angular * angle_ratio(angular.square())
    put3(kept, 9, linear)
    put3(kept, 12, turn)
    kept[15] = log_curvature(turn.square())
    return weighed(w, axes_at(kept), linear, turn)


@inner
def shape_column(kind, w, kept, linear, angular):
    """Remove from a column of the Jacobian what does not count, at the configuration shaped last.

    With a mask the free part of the error stays large while the rest vanishes, so the columns are the exact derivative of the
    rotation vector, and in tip axes also of the axes that turn with the tip: otherwise steps would not reach the target.
    """
    if kind == POSITION:
        return linear, V3(0.0, 0.0, 0.0)
    if kind == AXIS:
        a = at3(kept, 0)
        return linear, angular - a * a.dot(angular)
    side = 0.5 if kind == MASK_BASE else -0.5  # in tip axes: the inverse left Jacobian
    left = at3(kept, 12)
    r = left.cross(angular)
    if kind == MASK_TIP:
        linear = linear + angular.cross(at3(kept, 9))
    return weighed(w, axes_at(kept), linear, angular + r * side + left.cross(r) * kept[15])


@inline
def masked(kind):
    """Whether the rotation error is a rotation vector (masks) and not 2 sin(angle/2) times the axis."""
    return kind == MASK_BASE or kind == MASK_TIP


@inline
def counts(kind, w):
    """Whether position and rotation count (1.0 or 0.0), for the choice of starts."""
    if kind == POSE:
        return 1.0, 1.0
    if kind == POSITION or kind == AXIS:
        return 1.0, 0.0
    return (1.0 if w[0] + w[1] + w[2] > 0.0 else 0.0), (1.0 if w[3] + w[4] + w[5] > 0.0 else 0.0)
