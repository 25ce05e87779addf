"""Before a target that stands and cannot be reached: down to the least error nearby, and to rest there.

A method brings each direction of the task to its own closest point. Where limits or a singular pose forbid some of that, the
joints may creep, stop too early, or turn back and forth. Once the arm is stuck like that, its rates are those of

    min |W (J y - K e)|^2 + mu |y|^2    inside the box and the half-planes,    mu = share * max W * |W e|

(Levenberg and Marquardt). max W * |W e| is the most that one joint's curvature can add to J'W^2 J: that of a circle of one kernel
unit. The more damped, the closer the way is to the steepest descent along the limits, so the joints rest only where none is left.
The share is found by trying: joints that turn back went too far, and so did an error that does not come down.
"""

import math

from ..compile.jit import inner
from ..kernel.linalg import cholesky
from .laws import CLIP, STATE, apply, gram, natural
from .null_space_motion import weigh
from .singular_directions import GAIN
from .viability import POSITION, ROW, approach, box_of, narrow

STANDS = 1e-6  # [reaches or rad per s] below which a target stands
SMALL = 1e-4  # weighted error below which the method goes on by itself
STALLED = 0.1  # [s] without progress that make an arm stuck: a freeze is no shorter
# By which the weighted error comes down in that time; where joints are slow, a share of what they would bring at full speed.
PROGRESS, PACE = 1e-3, 0.1
IDLE = 0.01  # share of what is fed back below which the joints are idle: 0.3 at least is usual
BACK = 0.1  # share of the joints' motion that goes back, above which they turn
TURNS, FORGOTTEN = 2.0, 0.1  # turns that make it stuck, and [s] in which one is forgotten: four in 0.1 s are chatter
# Shares: below the least joints turn again and again, the most is that of 16 joints.
FIRST, LEAST, MOST = 0.5, 0.02, 16.0
TURNED, RAISED, LOWERED = 8.0, 2.0, 0.9  # its factors when joints turn, the error does not come down, or does
FLOOR = 0.25  # of the share raised by TURNED, so twice that found too small: not gone below for a while ...
FADING = 0.3  # [s] ... in which that is forgotten
BRISK = 0.5  # share of the acceleration with which joints brake before the end of their way


@inner
def feedback(law, h):
    """K [1/s]: not more than the method's own."""
    return min(natural(law, h), GAIN / h)


@inner
def stuck(law, s, limits, square, h, state):
    """Whether the arm is stuck before a target that stands; square: of the weighted error now.

    It stands where neither its twist s.f (m,) nor the error moves from now, s.e, to the next sample, s.ahead: a caller may give a
    twist of zero for a target that moves. Never where a published form is asked for.
    """
    most, error = 0.0, math.sqrt(square)
    for k in range(s.f.shape[0]):
        most = max(most, abs(s.f[k]), abs(s.ahead[k] - s.e[k]) / h)
    if law.mode == CLIP or most > STANDS or error < SMALL:
        state[STATE.share], state[STATE.stalled], state[STATE.turned], state[STATE.nearest] = 0.0, 0.0, 0.0, 0.0
    elif state[STATE.share] == 0.0:
        way = min(PROGRESS, PACE * STALLED * fastest(s, limits, error))
        if error < state[STATE.nearest] - way or state[STATE.nearest] == 0.0:
            state[STATE.stalled], state[STATE.nearest] = 0.0, error
        if (state[STATE.stalled] > STALLED or state[STATE.turned] >= TURNS) and feedback(law, h) > 0.0:
            state[STATE.share], state[STATE.lowest], state[STATE.stalled] = FIRST, 0.0, 0.0
    return state[STATE.share] > 0.0


@inner
def fastest(s, limits, error):
    """How much the weighted error could fall in a second: by all joints that are not at limits, at full speed."""
    total = 0.0
    for i in range(s.J.shape[0]):
        slope = 0.0
        for k in range(s.J.shape[1]):
            slope += s.weight[k] * s.weight[k] * s.J[i, k] * s.e[k]
        if slope != 0.0 and (s.roof[i] > 0.0 if slope > 0.0 else s.floor[i] < 0.0):
            total += abs(slope) * limits[2, i] / error
    return total


@inner
def notice(law, before, x, size, swings, code, square, h, state):
    """Take notice of a step from the rates `before` to x (n,): what hindered the joints, whether they turned, how it went on."""
    on, back, speed, swing, held = 0.0, 0.0, 0.0, False, False
    hindered, error = state[STATE.near] > 0.0, math.sqrt(square)
    for i in range(x.shape[0]):
        part = before[i] * x[i] / (size[i] * size[i])
        on, back, speed = on + max(part, 0.0), back - min(part, 0.0), speed + x[i] * x[i]
        swing = swing or (swings[0, i] >= TURNS and swings[1, i] == 0.0)
        hindered, held = hindered or (code[i] & (POSITION | ROW)) > 0, held or code[i] > 0
    hindered = hindered or (not held and speed < (IDLE * feedback(law, h) * error) ** 2)
    turned = swing or back > BACK * on
    if state[STATE.share] == 0.0:
        state[STATE.stalled] += h if hindered else 0.0
        if turned and (hindered or held):
            state[STATE.turned] += 1.0
        else:
            state[STATE.turned] = max(state[STATE.turned] - h / FORGOTTEN, 0.0)
    else:
        adapt(turned, error, h, state)


@inner
def adapt(turned, error, h, state):
    """Raise the share that damps the steps, or lower it."""
    share = state[STATE.share]
    state[STATE.stalled] += h
    state[STATE.lowest] *= max(1.0 - h / FADING, 0.0)
    if turned:
        share = min(TURNED * share, MOST)
        state[STATE.lowest] = FLOOR * share
    elif error < state[STATE.nearest]:
        share = min(share, max(LOWERED * share, state[STATE.lowest], LEAST))
        state[STATE.nearest], state[STATE.stalled] = error, 0.0
    elif state[STATE.stalled] > STALLED:
        state[STATE.lowest] = share
        share = min(RAISED * share, MOST)
        state[STATE.nearest], state[STATE.stalled] = error, 0.0
    state[STATE.share] = share


@inner
def descend(law, s, limits, h, state):
    """Write what `constrain` is asked for by a step down; returns mu."""
    n, m = s.J.shape
    heavy, size, gain, limited = weigh(s.weight, s.J, s.e, s.ahead, s.f, s.a), 0.0, feedback(law, h), False
    for k in range(m):
        size += s.e[k] * s.e[k]
        s.ask[k] = gain * s.e[k]
        s.weight[k] = 1.0 if s.weight[k] > 0.0 else 0.0  # all is weighed by now
    mu = state[STATE.share] * heavy * math.sqrt(size)
    for i in range(n):
        limited = limited or limits[3, i] < math.inf
        s.x[i], s.v[i] = 0.0, 0.0
    if limited:
        brake(s, limits, mu, h)
    return mu


@inner
def brake(s, limits, mu, h):
    """Narrow the box to rates from which each joint can still stop at the end of its way, that of a step without a box.

    Joints that are at limits and would go beyond do not take part in that.
    """
    n, m = s.J.shape
    for i in range(n):
        slope = 0.0
        for k in range(m):
            slope += s.J[i, k] * s.e[k]
        stopped = s.roof[i] <= 0.0 if slope > 0.0 else s.floor[i] >= 0.0
        for k in range(m):
            s.V[i, k] = 0.0 if stopped else s.J[i, k]
    gram(s.V, m, n >= m, mu, s.G)
    cholesky(s.G, m if n >= m else n, 0.0)
    apply(s.V, m, s.G, s.e, s.y, s.null)
    for i in range(n):
        if limits[3, i] < math.inf:
            most = approach(abs(s.null[i]), 0.0, 1.0, h, BRISK * limits[3, i], h)
            narrow(i, -most, most, box_of(s))
