"""Singular directions, in which the tip can hardly move: curvature of the tip's path and error left along each.

singular_step.py explains how joints move along such a direction, and has the formulas. This file evaluates them for each
direction, decides which directions leave the task, and stores the results.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import compiled, inline, inner
from ..kernel.records import copy
from ..kernel.vectors import add_multiple, clear, dot, largest
from .laws import CV, REGION, STATE, natural
from .null_space_motion import STEP, reflect
from .singular_step import (
    ALONG,
    BESIDE,
    BOTH,
    SIDE,
    WEAK,
    bring_along,
    mode_direction,
    mode_moved,
    mode_probe,
    rest_of,
    way_along,
)
from .viability import LIMIT, approach

GAIN = 2.0 / 3.0  # share of an error that methods without a gain feed back per sample; it is the best one for method cv
BEFORE = -1.0  # value of STATE.near: a pose was singular before, but not in the last step


@inline
def bend(task, look, s, weighed):
    """Write (dJ/dt along s.x1) s.x2 to s.bias (m,), multiplied by the weights of the errors if `weighed`."""
    if task.plain():
        task.bending(look, s.x1, s.x2, s.bias)
    else:
        by_difference(task, s)
    if weighed:
        for k in range(s.bias.shape[0]):
            s.bias[k] *= s.weight[k]


@inline
def by_difference(task, s):
    """Write (dJ/dt along s.x1) s.x2 to s.bias by central differences, for a task with free parts or a moving target frame."""
    n, m = task.desk.J.shape
    size = largest(s.x1)
    clear(s.bias)
    if size > 0.0:
        for sign in (1.0, -1.0):
            copy(s.at, s.probe)
            add_multiple(s.probe, sign * STEP / size, s.x1, n)
            task.stand(s.probe)
            task.jacobian(task.see())
            for i in range(n):
                add_multiple(s.bias, sign * 0.5 * size / STEP * s.x2[i], task.desk.J[i], m)
    reflect(s.flip, s.bias)
    for k in range(s.bias.shape[0]):
        if s.weight[k] == 0.0:
            s.bias[k] = 0.0


@inner
def forget_default(state, away):
    """Set away (n,), the side from which joints came, to zero before the first singular pose, where it is only a default."""
    if state[STATE.near] == 0.0:
        clear(away)


@inner
def remember(state, near, beyond, h):
    """Note in `state` whether the pose is singular (near), and for SIDE [s] that a target was out of reach (beyond)."""
    if near:
        state[STATE.near] = 1.0 + SIDE if beyond else max(state[STATE.near] - h, 1.0)
    elif state[STATE.near] != 0.0:
        state[STATE.near] = BEFORE


@compiled
class WeakMode(NamedTuple):
    """A singular direction, in which the tip can hardly move: task direction u_r and joint direction V_r."""

    r: int  # index of the singular direction
    sigma: float  # singular value sigma_r: tip motion along u_r per unit of joint motion along V_r
    # error along the other directions, if it cannot be closed (else 0), times the largest curvature of the tip's path
    rest: float
    own: float  # rate of the joints along V_r
    error: float  # error along u_r
    moved: float  # motion of the target along u_r in a step


@inline
def fastest_along(v, limits):
    """Return the highest speed and acceleration along the joint direction v (n,) that all limits allow."""
    cap, a = np.inf, np.inf
    for i in range(v.shape[0]):
        if v[i] != 0.0:
            cap = min(cap, limits[LIMIT.speed, i] / abs(v[i]))
            a = min(a, limits[LIMIT.acceleration, i] / abs(v[i]))
    return cap, a


@inner
def mode_speed(s, mode, gain, h, limits, near, away):
    """Decide whether to remove singular direction r from the task; if so, set s.lost[r] to 1 and s.xk[r] to the speed along V_r.

    u_r and V_r are the task and joint directions of singular direction r. s.t holds the curvature along u_r of each motion of
    `mode_probe`. near: above 0 if the last step was at a singular pose, above 1 for some time after the target was out of reach.
    away (n,) has a component of 1 or -1 along V_r: the side of the singular pose from which the joints came, or on which they are
    now if that is not known. Returns whether the target is out of reach along this direction now.
    """
    r, v, left, moved = mode.r, s.V[mode.r], mode.error, mode.moved
    b, beside = s.t[ALONG], s.t[BESIDE]
    cap, a = fastest_along(v, limits)
    grows = np.sign(b)  # 1 or -1: direction along V_r in which the singular value grows
    clear = mode.sigma > WEAK.clear
    back = dot(v, away, v.shape[0])
    if abs(back) < WEAK.known and clear:
        bring_along(v, away, grows, 1.0)
        back = grows
    sigma, y, D, most = mode.sigma + 0.5 * (s.t[BOTH] - b - beside), 0.0, 0.0, a
    # An error that is small against another, unreachable error is closed with damping, as in `hold_back`.
    if abs(left) < WEAK.minor * mode.rest:
        left *= sigma * sigma / (sigma * sigma + mode.rest)
        moved *= sigma * sigma / (sigma * sigma + mode.rest)
    # With acceleration limits, a first pass considers only the error, to shrink it to what can be braked.
    for last in range(0 if a < np.inf else 1, 2):
        E = moved + h * gain * left - 0.5 * beside if last == 1 else left
        y, D = way_along(sigma, b, E, h * mode.own, back, near > 1.0, h)
        # `most` is the highest speed from which the motion can brake before the error is zero, as in `ease`.
        most = approach(abs(y), 0.0, 1.0, h, 0.5 * a, h)
        if last == 0 and gain * abs(y) > most:
            left *= most / (gain * abs(y))
    edge = D < 0.0
    x = (WEAK.caution if edge else 1.0) * y / h
    # Joints that were carried far to the other side move back across the singular pose.
    if edge and mode.sigma > WEAK.lost and grows * back < 0.0:
        x = -grows * (mode.sigma / abs(b) + WEAK.lost) * gain
    if edge and a < np.inf:
        x = min(max(x, -most), most)
    x = min(max(x, -cap), cap)
    if clear and not edge:
        bring_along(v, away, grows, min(h / SIDE, 1.0) if near > 0.0 else 1.0)
    E = moved + h * gain * left
    bent = abs(b * E) > WEAK.bent * mode.sigma * mode.sigma
    if mode.sigma < WEAK.lost or bent or abs(E) > h * cap * mode.sigma:
        s.lost[r], s.xk[r] = 1.0, x
    return D < -WEAK.least * WEAK.least


@inline
def judge_modes(law, task, look, s, limits, h, own, heavy):
    """Choose for each singular direction whether it is removed from the task, and the joint rate along it (see `mode_speed`).

    Returns whether the target is out of reach along one of them.
    """
    m = s.J.shape[1]
    rate, away, state = own.motion[1], own.away, own.state
    near, beyond, gain = False, False, law.kappa if law.code == CV else min(natural(law, h), GAIN / h)
    for r in range(m):
        if s.sv[r] >= REGION * law.damping:
            continue
        if not near and s.sv[r] > WEAK.clear:
            forget_default(state, away)
        near = True
        left, moved = dot(s.U[r], s.e, m), mode_moved(s.U[r], s.e, s.ahead, s.f, h)
        if not mode_direction(s.W, s.sv, r, away, moved + h * gain * left, s.V[r]):
            s.lost[r], s.xk[r] = 1.0, 0.0
            continue
        speed = 0.0
        for part in range(3):
            speed = mode_probe(s.V[r], rate, part, h, s.x1)
            copy(s.x1, s.x2)
            bend(task, look, s, True)
            s.t[part] = dot(s.U[r], s.bias, m)
        rest = heavy * rest_of(s.e, left) if state[STATE.near] == 1.0 + SIDE else 0.0
        mode = WeakMode(r, s.sv[r], rest, speed, left, moved)
        out = mode_speed(s, mode, gain, h, limits, state[STATE.near], away)
        beyond = beyond or out
    remember(state, near, beyond, h)
    return beyond
