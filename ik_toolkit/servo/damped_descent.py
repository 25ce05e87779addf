"""Damped least squares for an arm stuck before a target at rest: move to the least error nearby, and stop there.

A tracking method brings each direction of the task to its own closest point. Where limits or a singular pose forbid
part of that, the joints may creep, stop too early, or turn back and forth. An arm that is stuck in this way gets the
joint rates y of

    min |W (J y - K e)|^2 + mu |y|^2    inside all bounds and inequality constraints,    mu = share * |H W e|

(Levenberg-Marquardt; e: error, W: weights, H: the largest weight at the priority level of each error, K: gain). The neglected
curvature of the tip's path under one joint adds at most |H W e| to J'W^2 J: the path is curved at most like a circle whose
radius is the arm's reach (the unit of length). With more damping the motion is closer to steepest descent along the limits, so the
joints only stop where no descent is left.
The share is adapted: it is raised when joints turn back (they went too far) or the error does not fall, and lowered while the
error falls.
"""

import math
from typing import NamedTuple

from ..compile.jit import compiled, inline, inner
from ..kernel.linalg import cholesky
from ..kernel.null_space import is_wide
from ..kernel.records import copy
from ..kernel.vectors import clear, dot
from .constrained_step import MODE
from .laws import apply, gram, natural
from .null_space_motion import weigh
from .singular_step import WEAK
from .viability import BIT, LIMIT, approach, box_of, narrow
from .workspace import STATE


@compiled
class DampedDescent(NamedTuple):
    """Thresholds by which an arm counts as stuck, and constants that adapt `share`, the factor in the damping mu of its descent."""

    stands: float = 1e-6  # [arm reaches/s or rad/s] speed below which a target counts as standing still
    # [arm reaches, rad] below this error, weighted as at priority level 0, the tracking method continues without a damped descent
    small: float = 1e-4
    stalled: float = 0.1  # [s] time without progress after which an arm counts as stuck
    # An arm makes progress if the weighted error falls, within the time `stalled`, by `progress` or by `pace` times what full joint
    # speed would allow, whichever is less.
    progress: float = 1e-3
    pace: float = 0.1
    # Joints are idle if they move at no more than this share of the speed that the feedback asks for; usually they reach 0.3 or
    # more.
    idle: float = 0.01
    reversing: float = 0.1  # Joints turn back if at least this share of their motion is reversed in a step.
    reversals: float = 2.0  # An arm counts as stuck after this many reversals of joints.
    forgotten: float = 0.1  # [s] time after which a reversal is forgotten, counted while the error is the least so far
    first: float = 0.5  # initial value of `share`, the factor in the damping
    # least value of `share`, the factor in the damping; with a lower one joints turn back repeatedly
    least: float = 0.02
    most: float = 16.0  # largest value of `share`, the factor in the damping
    turned: float = 8.0  # factor by which `share`, and so the damping, is raised when joints turn back
    raised: float = 2.0  # factor by which `share`, and so the damping, is raised when the error does not fall
    lowered: float = 0.9  # factor by which `share`, and so the damping, is lowered while the error falls
    # After joints have turned back and `share` was raised, it must not fall below this fraction of the raised value for a while.
    # With `turned` it is 0.25 * 8 = 2 times the share at which they turned back.
    floor: float = 0.25
    fading: float = 0.3  # [s] time constant with which the lower bound on `share` after a reversal fades
    brisk: float = 0.5  # share of the acceleration limit used to brake before the end of a joint's motion


DESCENT = DampedDescent()


@inner
def feedback(law, h):
    """Return the feedback gain [1/s] of a damped least-squares step of h [s], which is at most that of the method law (`Law`)."""
    return min(natural(law, h), WEAK.gain / h)


@inner
def stuck(law, s, limits, share, square, h, state):
    """Return whether the arm is stuck before a target that stands still, so that this step is to be a damped least-squares step.

    s: scratch arrays of the step (`Bench`); h [s]: length of the step; share (m,): weight of each error's priority level relative
    to level 0; square: squared weighted error now; `state` is updated. The target stands still if neither its twist s.f (m,) nor
    the difference between the errors now (s.e) and at the next sample (s.ahead) is noticeable; the twist alone is not enough,
    because a caller may give a zero twist for a target that moves. In mode clip, which keeps to the published laws, the result is
    always False.
    """
    most, error = 0.0, math.sqrt(square)
    for k in range(s.f.shape[0]):
        most = max(most, abs(s.f[k]), abs(s.ahead[k] - s.e[k]) / h)
    if law.mode == MODE.clip or most > DESCENT.stands or little(share, s):
        state[STATE.share], state[STATE.stalled], state[STATE.turned], state[STATE.nearest] = 0.0, 0.0, 0.0, 0.0
    elif state[STATE.share] == 0.0:
        way = min(DESCENT.progress, DESCENT.pace * DESCENT.stalled * fastest(s, limits, error))
        if error < state[STATE.nearest] - way or state[STATE.nearest] == 0.0:
            state[STATE.stalled], state[STATE.nearest] = 0.0, error
        if (state[STATE.stalled] > DESCENT.stalled or state[STATE.turned] >= DESCENT.reversals) and feedback(
            law, h
        ) > 0.0:
            state[STATE.share], state[STATE.lowest], state[STATE.stalled] = DESCENT.first, 0.0, 0.0
    return state[STATE.share] > 0.0


@inline
def little(share, s):
    """Return whether the error s.e (m,) is below DESCENT.small, weighted as if all its components had the first priority level.

    share (m,): weight of each component's priority level relative to the first one.
    """
    total = 0.0
    for k in range(share.shape[0]):
        total += (s.weight[k] / min(share[k], 1.0) * s.e[k]) ** 2
    return total < DESCENT.small * DESCENT.small


@inner
def fastest(s, limits, error):
    """Return how much the weighted error would fall per second if all joints that are not at limits moved at full speed.

    s: scratch arrays of the step (`Bench`); limits (4, n): lower, upper, speed, acceleration; error: norm of the weighted error
    now.
    """
    total = 0.0
    for i in range(s.J.shape[0]):
        slope = 0.0
        for k in range(s.J.shape[1]):
            slope += s.weight[k] * s.weight[k] * s.J[i, k] * s.e[k]
        if slope != 0.0 and (s.roof[i] > 0.0 if slope > 0.0 else s.floor[i] < 0.0):
            total += abs(slope) * limits[LIMIT.speed, i] / error
    return total


@inner
def notice(law, before, x, size, swings, code, square, h, state):
    """Update, after a step, the time in which joints are hindered and the number of reversals, by which an arm counts as stuck.

    In a damped descent the damping is adapted instead. before, x (n,): joint rates before and after the step; size (n,): speed
    limit of each joint; swings (3, n): reversals of each joint, as `viability.watch` counts them; code (n,): bits of the limits
    that held joints back; square: squared weighted error.
    """
    on, back, speed, swing, held = 0.0, 0.0, 0.0, False, False
    hindered, error = state[STATE.near] > 0.0, math.sqrt(square)
    reversals, since = swings[0], swings[1]
    for i in range(x.shape[0]):
        part = before[i] * x[i] / (size[i] * size[i])
        on, back, speed = on + max(part, 0.0), back - min(part, 0.0), speed + x[i] * x[i]
        swing = swing or (reversals[i] >= DESCENT.reversals and since[i] == 0.0)
        hindered, held = hindered or (code[i] & (BIT.position | BIT.row)) > 0, held or code[i] > 0
    hindered = hindered or (not held and speed < (DESCENT.idle * feedback(law, h) * error) ** 2)
    turned = swing or back > DESCENT.reversing * on
    if state[STATE.share] == 0.0:
        state[STATE.stalled] += h if hindered else 0.0
        if turned and (hindered or held):
            state[STATE.turned] += 1.0
        elif error <= state[STATE.nearest]:
            # Reversals are forgotten only while the error is the least so far. In a slow oscillation they would otherwise be
            # forgotten one by one, and the arm would never count as stuck.
            state[STATE.turned] = max(state[STATE.turned] - h / DESCENT.forgotten, 0.0)
    else:
        adapt(turned, error, h, state)


@inner
def adapt(turned, error, h, state):
    """Adapt state[STATE.share], the factor in the damping mu, after a step of h [s] of a damped descent.

    The factor is raised if joints turned back (turned) or the weighted `error` has not fallen for DESCENT.stalled [s], and lowered
    while the error falls.
    """
    share = state[STATE.share]
    state[STATE.stalled] += h
    state[STATE.lowest] *= max(1.0 - h / DESCENT.fading, 0.0)
    if turned:
        share = min(DESCENT.turned * share, DESCENT.most)
        state[STATE.lowest] = DESCENT.floor * share
    elif error < state[STATE.nearest]:
        share = min(share, max(DESCENT.lowered * share, state[STATE.lowest], DESCENT.least))
        state[STATE.nearest], state[STATE.stalled] = error, 0.0
    elif state[STATE.stalled] > DESCENT.stalled:
        state[STATE.lowest] = share
        share = min(DESCENT.raised * share, DESCENT.most)
        state[STATE.nearest], state[STATE.stalled] = error, 0.0
    state[STATE.share] = share


@inner
def descend(law, s, limits, h, state):
    """Write the task of a damped least-squares step, with desired joint rates of 0, to s (`Bench`); return its damping mu.

    law: the method and its gains (`Law`); limits (4, n): lower, upper, speed, acceleration; h [s]: length of the step; state: see
    `workspace.State`.
    """
    n, m = s.J.shape
    gain, limited, bent = feedback(law, h), False, 0.0
    weigh(s.weight, s.J, s.e, s.ahead, s.f, s.a)
    for k in range(m):
        bent += (s.heavy[k] * s.e[k]) ** 2
        s.ask[k] = gain * s.e[k]
        # The Jacobian and the errors have been multiplied by the weights, so the weights become 1.
        s.weight[k] = 1.0 if s.weight[k] > 0.0 else 0.0
    mu = state[STATE.share] * math.sqrt(bent)
    clear(s.x)
    clear(s.v)
    for i in range(n):
        limited = limited or limits[LIMIT.acceleration, i] < math.inf
    if limited:
        stop_in_time(s, limits, mu, h)
    return mu


@inner
def stop_in_time(s, limits, mu, h):
    """Narrow the rate bounds so that each joint can stop at the end of the move that a damped step without bounds would make.

    Joints at a limit that would have to move beyond it do not take part in that move. s: scratch arrays of the step (`Bench`);
    limits (4, n): lower, upper, speed, acceleration; mu: damping; h [s]: length of the step.
    """
    n, m = s.J.shape
    for i in range(n):
        slope = dot(s.J[i], s.e, m)
        stopped = s.roof[i] <= 0.0 if slope > 0.0 else s.floor[i] >= 0.0
        copy(s.J[i], s.free[i])
        if stopped:
            clear(s.free[i])
    wide = is_wide(s.free, m)
    gram(s.free, m, wide, mu, s.G)
    cholesky(s.G, m if wide else n, 0.0)
    apply(s.free, m, s.G, s.e, s.y, s.null)
    for i in range(n):
        if limits[LIMIT.acceleration, i] < math.inf:
            most = approach(abs(s.null[i]), 0.0, 1.0, h, DESCENT.brisk * limits[LIMIT.acceleration, i], h)
            narrow(i, -most, most, box_of(s))
