"""Singular directions, in which the tip can hardly move: curvature of the tip's path and error left along each.

singular_step.py explains how joints move along such a direction, and has the formulas. This file evaluates them for each
direction, decides which directions leave the task, and stores the results.
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.jit import compiled, inline, inner
from ..kernel.limits import LIMIT
from ..kernel.records import copy
from ..kernel.vectors import clear, dot
from .laws import EASING, LAW, natural
from .null_space_motion import bend
from .singular_step import (
    ALONG,
    BESIDE,
    BOTH,
    WEAK,
    begin_curved,
    bent_direction,
    bring_along,
    mode_direction,
    mode_moved,
    mode_probe,
    way_along,
)
from .viability import approach
from .workspace import STATE

BEFORE = -1.0  # value of the entry STATE.near if the pose was singular at some earlier step, but not in the last one


@inner
def remember(state, near, beyond, h):
    """Store in state[STATE.near] whether this step is at a singular pose, and how long the target still counts as out of reach.

    near: whether the pose is singular; beyond: whether the target is out of reach along one of its singular directions; h [s]: the
    step. The entry is 1 plus that time [s] at a singular pose, BEFORE after one, and 0 before the first.
    """
    if near:
        state[STATE.near] = 1.0 + WEAK.side if beyond else max(state[STATE.near] - h, 1.0)
    elif state[STATE.near] != 0.0:
        state[STATE.near] = BEFORE


@inline
def begin_mode(s, r, free, way, away):
    """Write to row r of s.V the joint direction that belongs to singular direction r; return False if there is none.

    Without one, direction r is marked as removed from the task (s.lost). s: scratch arrays of the step (`Bench`); free: whether the
    joint direction in which the tip's path is most curved will be looked for, by `bent_direction`; s.x1 then receives the joint
    motion from which that search starts. way: the tip motion asked for; away (n,): direction in which joints leave a singular pose,
    see `mode_speed`.
    """
    there = mode_direction(s.W, s.sv, r, away, way, s.V[r])
    if not there:
        s.lost[r], s.xk[r] = 1.0, 0.0
    elif free:
        begin_curved(s.W, s.V[r], s.sv, r, away, s.x1)
    return there


@inline
def probe_mode(s, r, part, rate, h):
    """Write to s.x1 and s.x2 (n,) two joint motions for which the curvature of the tip's path is needed: (dJ/dt along s.x1) s.x2.

    part: ALONG, BESIDE or BOTH, see `mode_probe`; or part = i - n < 0 for entry i of the gradient of singular value r: s.x2 then
    moves joint i alone, and s.x1 stays. Returns the joints' present rate along row r of s.V, or 0 for the gradient. rate (n,):
    present joint rates; h [s]: the step.
    """
    n = rate.shape[0]
    if part < 0:  # Joint n + part moves alone, for one entry of the gradient of the singular value.
        clear(s.x2)
        s.x2[part + n] = 1.0
        return 0.0
    own = mode_probe(s.V[r], rate, part, h, s.x1)
    copy(s.x1, s.x2)
    return own


@inline
def note_curve(s, r, part):
    """Store the curvature along task direction u_r (row r of s.U) that was evaluated into s.bias, for the motion of `probe_mode`.

    It goes to s.t[part] for part >= 0, else to entry part + n of s.null, of the joint that moves alone; 0 if that joint cannot
    move.
    """
    curved = dot(s.U[r], s.bias, s.bias.shape[0])
    i = part + s.null.shape[0]
    if part >= 0:
        s.t[part] = curved
    else:
        s.null[i] = curved if s.floor[i] < 0.0 or s.roof[i] > 0.0 else 0.0


@compiled
class WeakMode(NamedTuple):
    """A singular direction: the tip can hardly move along the task direction u_r (m,), for which the joints move along V_r (n,)."""

    r: int  # index of the singular direction
    full: float  # singular value sigma_r of the Jacobian
    sigma: float  # tip motion along u_r per unit of joint motion along V_r
    # error along the other directions, if it cannot be closed (else 0), times the largest curvature of the tip's path
    rest: float
    own: float  # present rate of the joints along V_r
    error: float  # error along the task direction u_r
    moved: float  # motion of the target along u_r in a step


@inline
def fastest_along(v, limits):
    """Return the highest speed and acceleration along the joint direction v (n,) that the limits (4, n) of all joints allow."""
    cap, a = np.inf, np.inf
    for i in range(v.shape[0]):
        if v[i] != 0.0:
            cap = min(cap, limits[LIMIT.speed, i] / abs(v[i]))
            a = min(a, limits[LIMIT.acceleration, i] / abs(v[i]))
    return cap, a


@inner
def mode_speed(s, mode, gain, h, limits, near, away):
    """Decide whether to remove a singular direction, `mode` (WeakMode), from the task, and how fast the joints move along it.

    If it is removed, s.lost[r] becomes 1 and s.xk[r] the speed along V_r (r: the direction's index). s.t holds the curvature along
    u_r of each motion of `mode_probe`. gain [1/s]: rate at which the error is closed; h [s]: the step; limits (4, n): lower, upper,
    speed, acceleration. near: above 0 if the last step was at a singular pose, above 1 for some time after the target was out of
    reach. away (n,) has a component of 1 or -1 along V_r: the side of the singular pose from which the joints came, or on which
    they are now if that is not known. Returns whether the target is out of reach along this direction now.
    """
    r, v, left, moved = mode.r, s.V[mode.r], mode.error, mode.moved
    b, beside = s.t[ALONG], s.t[BESIDE]
    cap, a = fastest_along(v, limits)
    grows = np.sign(b)  # 1 or -1: direction along V_r in which the singular value grows
    clear = mode.full > WEAK.clear and mode.sigma > WEAK.known * mode.full
    back = dot(v, away, v.shape[0])
    if abs(back) < WEAK.known and clear:
        bring_along(v, away, grows, 1.0)
        back = grows
    sigma, y, D, most = mode.sigma + 0.5 * (s.t[BOTH] - b - beside), 0.0, 0.0, a
    # An error that is small against another one that cannot be closed is closed with damping, by the formula of `hold_back`.
    if abs(left) < WEAK.minor * mode.rest:
        left *= sigma * sigma / (sigma * sigma + mode.rest)
        moved *= sigma * sigma / (sigma * sigma + mode.rest)
    # With acceleration limits, a first pass considers only the error, to shrink it to what can be braked.
    for last in range(0 if a < np.inf else 1, 2):
        E = moved + h * gain * left - 0.5 * beside if last == 1 else left
        y, D = way_along(sigma, b, E, h * mode.own, back, near > 1.0, h)
        # `most` is the highest speed from which the motion can brake before the error is zero.
        most = approach(abs(y), 0.0, 1.0, h, 0.5 * a, h)
        if last == 0 and gain * abs(y) > most:
            left *= most / (gain * abs(y))
    edge = D < 0.0
    x = (WEAK.caution if edge else 1.0) * y / h
    # Joints that have gone far beyond the singular pose, to its other side, move back across it.
    if edge and mode.sigma > WEAK.lost and grows * back < 0.0:
        x = -grows * (mode.sigma / abs(b) + WEAK.lost) * gain
    if edge and a < np.inf:
        x = min(max(x, -most), most)
    x = min(max(x, -cap), cap)
    if clear and not edge:
        bring_along(v, away, grows, min(h / WEAK.side, 1.0) if near > 0.0 else 1.0)
    E = moved + h * gain * left
    bent = abs(b * E) > WEAK.bent * mode.sigma * mode.sigma
    if mode.sigma < WEAK.lost or bent or abs(E) > h * cap * mode.sigma:
        s.lost[r], s.xk[r] = 1.0, x
    return D < -WEAK.least * WEAK.least


@inline
def straight_along_axis(task, look, s, away):
    """Return whether an error asks for a motion that no joint makes now, but joints would make once they bent along away (n,).

    Only then does a component of the task in which no joint moves the tip make the pose singular. Most such components stay zero
    at every pose, like the height of a planar arm, and `laws.gram` leaves them out. s: `Bench`.
    """
    n, m = s.J.shape
    probed, straight = False, False
    for k in range(m):
        still = s.weight[k] * max(abs(s.e[k]), abs(s.ahead[k])) > WEAK.zero
        for i in range(n if still else 0):
            still = still and abs(s.J[i, k]) < WEAK.nothing
        if still and not probed:
            copy(away, s.x1)
            copy(away, s.x2)
            bend(task, look, s, False)
            probed = True
        straight = straight or (still and abs(s.bias[k]) > WEAK.flat)
    return straight


@inline
def judge_modes(law, task, look, s, limits, h, own, heavy):
    """Decide for each singular direction whether to remove it from the task, and how fast the joints move along it.

    law: the method and its gains (`Law`); task, look: the compiled problem and its evaluation; s: `Bench`, whose lost, xk and pull
    receive the decisions (see `mode_speed`); limits (4, n): lower, upper, speed, acceleration; h [s]: the step; own: state of the
    tracker (`Carried`); heavy: largest weight of an error. Returns whether the target is out of reach along one of them.
    """
    n, m = s.J.shape
    rate, away, state = own.motion[1], own.away, own.state
    near, beyond, gain = False, False, law.kappa if law.code == LAW.cv else min(natural(law, h), WEAK.gain / h)
    for r in range(m):
        if s.sv[r] >= EASING.region * law.damping:
            continue
        if not near and s.sv[r] > WEAK.clear and state[STATE.near] == 0.0:
            # Before the first singular pose, `away` holds only a default for the side from which the joints come.
            clear(away)
        near = True
        left, moved = dot(s.U[r], s.e, m), mode_moved(s.U[r], s.e, s.ahead, s.f, h)
        free, thin, speed = s.sv[r] < WEAK.lost and state[STATE.near] > 1.0, s.sv[r], 0.0
        if not begin_mode(s, r, free, moved + h * gain * left, away):
            continue
        for part in range(-n if free else 0, 3):
            if part == ALONG and free:
                thin = bent_direction(s.W, s.V[r], s.sv, r, s.null)
            speed = probe_mode(s, r, part, rate, h)
            bend(task, look, s, True)
            note_curve(s, r, part)
        others = math.sqrt(max(dot(s.e, s.e, m) - left * left, 0.0))  # the error along all other directions
        rest = heavy * others if state[STATE.near] == 1.0 + WEAK.side else 0.0
        mode = WeakMode(r, s.sv[r], thin, rest, speed, left, moved)
        out = mode_speed(s, mode, gain, h, limits, state[STATE.near], away)
        # `down_slopes` moves the joints along the part of sigma_r v_r that is perpendicular to V_r. The error there is damped as in
        # `hold_back`.
        if free and out:
            s.pull[r] = gain * left / (s.sv[r] * s.sv[r] + heavy * abs(left))
        beyond = beyond or out
    remember(state, near, beyond, h)
    return beyond
