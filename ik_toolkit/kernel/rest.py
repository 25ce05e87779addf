"""Where a target stands that the arm cannot reach: down to the least error nearby, and to rest there.

A law brings each direction of the task to its own closest point, limits or singular poses forbid some of that, and what is left may
creep, or turn back and forth. Where a target stands and the error has not come down for a while, the rates y asked for are those of

    min |W (J y - K e)|^2 + mu |y|^2    inside the box,    mu = share * |W e| * (largest weight)

instead (Levenberg and Marquardt): with |W e| the largest curvature that J leaves out (a circle of one kernel unit has 1). As mu
grows they tend to the way of steepest descent along the limits, so that they rest nowhere but where none is left. Joints that turn
back went too far: mu is doubled. While they go on the same way, it is lowered.
"""

import math

from .box import POSITION, ROW, approach, narrow
from .jit import inner
from .linalg import cholesky
from .motion import CA, CV, STATE, apply, gram
from .records import copy
from .wishes import weigh

STANDS = 1e-6  # [reaches or rad per s] below which a target stands
SMALL = 1e-4  # weighted error below which nothing is left to be done
PACE = 1e-2  # [1/s] by which it has to come down
STALLED = 0.1  # [s] without that, from which on the arm is stuck: what counts as a freeze
TURNS, FORGOTTEN = 2.0, 0.1  # turns back that make it stuck, too, and time [s] in which one is forgotten
TURNED = 0.1  # share of the joints' motion that is back, above which they turned
IDLE = 0.01  # share of the error fed back that moves the joints, below which they are idle
FIRST, LEAST, MOST = 0.5, 0.02, 16.0  # share of the curvature
UP, DOWN = 8.0, 0.9  # of a share, when joints turn back, or the error comes down
FADING = 0.3  # [s] in which a share at which joints turned back is forgotten
BRISK = 0.5  # share of the acceleration with which joints brake
GAIN = 2.0 / 3.0  # share of an error fed back per sample: see wanted.py


@inner
def feedback(law, h):
    """[1/s] of `descend`: not more than the method's own."""
    natural = law.kappa if law.code == CV else law.kp / law.kd if law.code == CA and law.kd > 0.0 else 1.0 / h
    return min(natural, GAIN / h)


@inner
def stuck(law, s, square, h, state):
    """Whether the arm is stuck before a target that stands, square: of its weighted error now."""
    most = 0.0
    for k in range(s.f.shape[0]):
        most = max(most, abs(s.f[k]))
    error = math.sqrt(square)
    if most > STANDS or error < SMALL:
        state[STATE.stalled], state[STATE.turned], state[STATE.share], state[STATE.nearest] = 0.0, 0.0, 0.0, error
    elif state[STATE.share] == 0.0:
        if error < state[STATE.nearest] - PACE * STALLED or state[STATE.nearest] == 0.0:
            state[STATE.stalled], state[STATE.nearest] = 0.0, error
        if (state[STATE.stalled] > STALLED or state[STATE.turned] >= TURNS) and feedback(law, h) > 0.0:
            state[STATE.share], state[STATE.stalled], state[STATE.lowest] = FIRST, 0.0, 0.0
    return state[STATE.share] > 0.0


@inner
def notice(law, s, swings, code, square, h, state):
    """Take notice of a step to the rates s.x from s.before: of the time in which limits or a singular pose hinder the joints ...

    ... and of whether they turned back.
    """
    on, back, now, held, swings_on, hindered, error = 0.0, 0.0, 0.0, False, False, state[STATE.near] > 0.0, math.sqrt(square)
    for i in range(s.x.shape[0]):
        part = s.before[i] * s.x[i] / (s.size[i] * s.size[i])
        on, back, now = on + max(part, 0.0), back - min(part, 0.0), now + s.x[i] * s.x[i]
        hindered, held = hindered or (code[i] & (POSITION | ROW)) > 0, held or code[i] > 0
        swings_on = swings_on or (swings[0, i] >= 2.0 and swings[1, i] == 0.0)
    hindered = hindered or (not held and now < (IDLE * feedback(law, h) * error) ** 2)
    turned = swings_on or back > TURNED * on
    if state[STATE.share] == 0.0:
        state[STATE.stalled] += h if hindered else 0.0
        if turned and (hindered or held):
            state[STATE.turned] += 1.0
        else:
            state[STATE.turned] = max(state[STATE.turned] - h / FORGOTTEN, 0.0)
        return
    state[STATE.stalled] += h
    state[STATE.lowest] *= 1.0 - h / FADING
    if turned:
        state[STATE.share] = min(UP * state[STATE.share], MOST)
        state[STATE.lowest] = 0.25 * state[STATE.share]
    elif error < state[STATE.nearest]:
        state[STATE.share] = min(state[STATE.share], max(DOWN * state[STATE.share], state[STATE.lowest], LEAST))
        state[STATE.nearest], state[STATE.stalled] = error, 0.0
    elif state[STATE.stalled] > STALLED:
        state[STATE.share], state[STATE.stalled] = min(2.0 * state[STATE.share], MOST), 0.0
        state[STATE.lowest], state[STATE.nearest] = 0.5 * state[STATE.share], error


@inner
def brake(s, limits, mu, h):
    """Narrow the box to rates from which each joint can still stop at the end of its way, that of the step without a box.

    Joints that are at their limits and would go beyond are left out of it.
    """
    n, m = s.J.shape
    for i in range(n):
        slope = 0.0
        for k in range(m):
            slope += s.J[i, k] * s.e[k]
        stopped = s.roof[i] <= 0.0 if slope > 0.0 else s.floor[i] >= 0.0
        for k in range(m):
            s.W[i, k] = 0.0 if stopped else s.J[i, k]
    gram(s.W, m, n >= m, mu, s.G)
    cholesky(s.G, m if n >= m else n, 0.0)
    apply(s.W, m, s.G, s.e, s.y, s.null)
    for i in range(n):
        if limits[3, i] < math.inf:
            most = approach(abs(s.null[i]), 0.0, 1.0, h, BRISK * limits[3, i], h)
            narrow(i, -most, most, s.floor, s.roof, s.why_low, s.why_top)


@inner
def descend(law, s, limits, h, state):
    """Write what `constrain` needs for a step down, to s.ask, s.weight, and s.move (the scale); returns mu."""
    n, m = s.J.shape
    gain = feedback(law, h)
    heavy = weigh(s.weight, s.J, s.e, s.ahead, s.f, s.a)
    size = 0.0
    for k in range(m):
        size += s.e[k] * s.e[k]
        s.weight[k] = 1.0 if s.weight[k] > 0.0 else 0.0
    mu = state[STATE.share] * heavy * math.sqrt(size)
    limited = False
    for i in range(n):
        limited = limited or limits[3, i] < math.inf
        s.x[i], s.v[i], s.move[i] = 0.0, 0.0, 1.0
    if limited:
        brake(s, limits, mu, h)
    for k in range(m):
        s.ask[k] = gain * s.e[k]
        s.f[k] = 0.0
    return mu
