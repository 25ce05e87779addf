"""What a tracker handles besides its task: slack as half-planes, secondary motion in the null space, free turns."""

import numpy as np

from .jit import inline, inner
from .motion import STATE, apply

FADING = 0.15  # share of its range, next to a limit, in which a joint is moved away from the limit
STEP = 1e-5  # of a difference [rad, or reaches]: squared it is the error, and what rounding leaves is 1e-16 over it
NEARLY = 0.5  # share of an error's slack that may be used up in a sample
# Share of it by which an error is beyond where half-planes cannot be kept: less may be rounding; and [reaches, rad] where they can.
BEYOND, FAR = 1e-3, 1e-2
PRESSED = 0.1  # [s] after which half-planes are tried again


@inline
def reflect(flip, y):
    """Mirror the rotations in y (m,), three a tip, so that the turn that is free comes last."""
    for f in range(flip.shape[0]):
        k = 6 * f + 3
        s = 2.0 * (flip[f, 0] * y[k] + flip[f, 1] * y[k + 1] + flip[f, 2] * y[k + 2])
        if s != 0.0:
            for c in range(3):
                y[k + c] -= s * flip[f, c]


@inner
def lay_aside(flip, J, e):
    """`reflect` the rows of J (n, m) and the error; the free ones are zero up to rounding and become exactly zero."""
    reflect(flip, e)
    for f in range(flip.shape[0]):
        if flip[f, 0] != 0.0 or flip[f, 1] != 0.0 or flip[f, 2] != 0.0:
            e[6 * f + 5] = 0.0
    for i in range(J.shape[0]):
        reflect(flip, J[i])
        for f in range(flip.shape[0]):
            if flip[f, 0] != 0.0 or flip[f, 1] != 0.0 or flip[f, 2] != 0.0:
                J[i, 6 * f + 5] = 0.0


@inner
def weigh(weight, J, e, ahead, f, a):
    """Weigh the rows of a task: J (n, m), errors e and ahead, the target's twist and acceleration. Returns the largest weight."""
    most = 0.0
    for k in range(e.shape[0]):
        w = weight[k]
        most = max(most, w)
        e[k], ahead[k], f[k], a[k] = w * e[k], w * ahead[k], w * f[k], w * a[k]
        for i in range(J.shape[0]):
            J[i, k] *= w
    return most


@inner
def slack_rows(slack, weight, J, e, f, ahead, a, h, state, A, b, count):
    """Turn errors with slack into half-planes A x <= b from row `count` on, and leave them out of the task; returns the count.

    Inside its slack an error may use up at most NEARLY of the rest in a sample, a little outside it is brought back. What of an
    error is further beyond its slack is one to close like any other; and all that is beyond, where half-planes are in the way of
    the task or contradict the limits (STATE.pressed): hard ones let joints turn at full speed there.
    """
    n, m = J.shape
    pressed = state[STATE.pressed]
    state[STATE.pressed] = max(pressed - h, 0.0)
    for k in range(m):
        if not slack[k] > 0.0:
            continue
        inside = min(max(e[k], -slack[k]), slack[k])
        if abs(e[k] - inside) > (BEYOND * slack[k] if pressed > 0.0 else FAR):
            state[STATE.pressed] = PRESSED
            e[k] -= inside
            ahead[k] -= inside
            continue
        for sign in (1.0, -1.0):
            for i in range(n):
                A[count, i] = -sign * J[i, k]
            b[count] = NEARLY * (slack[k] - sign * e[k]) / h - sign * f[k]
            count += 1
        for i in range(n):
            J[i, k] = 0.0
        weight[k], e[k], f[k], ahead[k], a[k] = 0.0, 0.0, 0.0, 0.0, 0.0
    return count


@inner
def away_from_limits(q, limits, gain, g):
    """Add to g (n,) a speed away from near limits: smooth, and 0 in the middle of the range."""
    for i in range(q.shape[0]):
        lower, upper = limits[0, i], limits[1, i]
        wide = upper - lower
        if not (wide < np.inf and wide > 0.0):
            continue
        for sign in (1.0, -1.0):
            left = (upper - q[i]) if sign > 0.0 else (q[i] - lower)
            t = 1.0 - left / (FADING * wide)
            if t > 0.0:
                g[i] -= sign * gain * FADING * wide * t * t


@inner
def clip_wish(g, x, low, top):
    """Scale the wish g so that x + g keeps half of the room that x leaves in the box."""
    scale = 1.0
    for i in range(x.shape[0]):
        if g[i] > 0.0:
            room = 0.5 * max(top[i] - x[i], 0.0)
        else:
            room = 0.5 * max(x[i] - low[i], 0.0)
        if abs(g[i]) > room:
            scale = min(scale, room / abs(g[i]))
    for i in range(x.shape[0]):
        g[i] *= scale


@inner
def into_null_space(J, m, G, y, t, g, part):
    """g -= J^+ J g, after `factor`."""
    for k in range(m):
        s = 0.0
        for i in range(g.shape[0]):
            s += J[i, k] * g[i]
        t[k] = s
    apply(J, m, G, t, y, part)
    for i in range(g.shape[0]):
        g[i] -= part[i]
