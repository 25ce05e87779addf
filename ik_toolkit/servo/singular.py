"""Joint motion along singular directions, in which the tip can hardly move: at singular poses, at the edge of reach.

The Jacobian is J = sum over k of sigma_k v_k u_k' (v_k: joint directions, u_k: task directions). Along a direction with
a small sigma_k the first order says little, so the second is used as well. A move along v_k moves the tip by sigma_k
u_k + b_k / 2 with b_k = (dJ/dt along v_k) v_k. The squared error |e|^2 / 2 then has the second derivative along v_k

    H_k = sigma_k^2 - e . b_k

If the target is beyond the edge of the reach, the error e points outwards and b_k inwards. H_k is then large, so the arm slides
smoothly to the closest pose without stepping over it, and no direction is damped while the target can be reached. If H_k is
negative, the error can be closed by bending the arm: at sigma_k = 0, where the first order shows no way, the joints go back to
the side from which they came. If both sigma_k and H_k are near 0, a Newton step is undefined, and the joints keep their
present motion, which fades.

`judge_modes` evaluates this for each singular direction, decides which directions leave the task, and stores the results.
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.jit import compiled, inline, inner
from ..kernel.limits import LIMIT
from ..kernel.linalg import cholesky, make_rows_orthogonal
from ..kernel.null_space import is_wide
from ..kernel.records import copy
from ..kernel.vectors import add_multiple, any_of, clear, dot
from .laws import CV, REGION, STATE, gram, natural
from .null_space_motion import bend
from .viability import approach

ALONG, BESIDE, BOTH = range(3)  # the joint motions whose curvature is evaluated, see `mode_probe`
BEFORE = -1.0  # value of STATE.near: a pose was singular before, but not in the last step


class Weak(NamedTuple):
    """Thresholds for singular directions and motion along them.

    Singular values are tip motions in arm reaches (or rad) per rad (or arm reach) of a joint.
    """

    zero: float = 1e-9  # singular value below which the tip does not move to first order
    # This is added to the squared singular values before factoring; it is negligible against the least of those kept, lost^2.
    nothing: float = 1e-12
    # If the component of a unit vector along a direction exceeds this, it is clear to which side the vector points.
    clearly: float = 0.1
    # The remembered side counts if its component exceeds this; a smaller component may come from another singular pose.
    known: float = 0.5
    lost: float = 5e-3  # singular value below which a direction is removed from the task
    # A direction is also removed if the product of the move asked for and the curvature exceeds this share of sigma_k^2.
    bent: float = 0.2
    fade: float = 0.1  # [s] time in which motion along a direction that does not move the tip at all fades
    least: float = 1e-3  # damping lambda at sigma_k = 0; a motion through a singular pose errs by about lambda^2
    flat: float = 1e-3  # [arm reaches / rad^2] a smaller curvature counts as zero
    # A step takes this share of the move to the closest pose; full steps would zigzag, as in steepest descent.
    caution: float = 2.0 / 3.0
    # Errors below this share of another error, which cannot be closed, are closed with damping.
    minor: float = 0.1
    clear: float = 1e-4  # singular value above which it is clear on which side of the singular pose the joints are
    side: float = 0.2  # [s] for which the side from which the joints came is remembered; longer than an oscillation
    gain: float = (
        2.0 / 3.0
    )  # share of an error fed back per sample by methods without a gain; the best one for method cv
    close: float = 0.1  # [arm reaches or rad] rotation errors up to this size add like vectors, to within a twentieth


WEAK = Weak()


@inner
def modes(J, near, W, U, sigma):
    """Compute the singular value decomposition of J (n, m) by one-sided Jacobi rotations.

    W (m, n) receives sigma_k v_k as rows, U (m, m) the u_k as rows, sigma (m,) the singular values. near (m, m): the u_k of the
    last call, which save rotations (zeros at first); it receives the new u_k, normalised.
    """
    n, m = J.shape
    known = any_of(near[0])
    for r in range(m):
        for c in range(m):
            U[r, c] = near[r, c] if known else 1.0 if r == c else 0.0
        for i in range(n):
            W[r, i] = dot(J[i], U[r], m)
    make_rows_orthogonal(W, U, sigma)
    for r in range(m):
        sigma[r] = math.sqrt(sigma[r])
        size = math.sqrt(dot(U[r], U[r], m))
        for c in range(m):
            near[r, c] = U[r, c] / size


@inner
def leave_modes(W, sigma, r, x):
    """Remove from the joint motion x (n,) what moves the tip, except along task direction u_r (r = -1: no exception).

    Return the length of the rest of x.
    """
    m, n = W.shape
    for c in range(m):
        if c != r and sigma[c] > WEAK.zero:
            add_multiple(x, -dot(W[c], x, n) / (sigma[c] * sigma[c]), W[c], n)
    return math.sqrt(dot(x, x, n))


@inner
def lost_direction(W, sigma, away, v):
    """Write to v (n,) the joint direction of a singular value of 0: `away` (n,) without the part that moves the tip.

    Returns False if nothing is left of `away`.
    """
    copy(away, v)
    leave_modes(W, sigma, -1, v)
    # A second projection removes the rounding of the first; twice is enough (Kahan).
    size = leave_modes(W, sigma, -1, v)
    for i in range(v.shape[0]):
        v[i] = v[i] / size if size > WEAK.zero else 0.0  # A rest that is only rounding gives no direction.
    return size > WEAK.zero


@inner
def bring_along(v, x, value, share):
    """Move the component of x (n,) along the joint direction v (n,) towards `value`, by a share of the difference."""
    n = x.shape[0]
    add_multiple(x, share * (value - dot(v, x, n)), v, n)


@inner
def mode_probe(v, rate, part, h, x):
    """Write to x (n,) a joint motion whose curvature is to be evaluated, and return the joints' rate along v (n,).

    part: ALONG for v itself; BESIDE for the joints' move in a step of h [s] without its part along v; BOTH for the sum of
    these two.
    """
    n = x.shape[0]
    own = dot(v, rate, n)
    clear(x)
    if part != ALONG:
        add_multiple(x, h, rate, n)
        add_multiple(x, -h * own, v, n)
    if part != BESIDE:
        add_multiple(x, 1.0, v, n)
    return own


@inner
def way_along(sigma, b, E, own, side, home, h):
    """Return the move y along v_k that solves sigma y + b y^2 / 2 = E, or comes nearest, and D (< 0: E is unreachable).

    There are two solutions, one on each side of the singular pose. The result is the one towards which the joints already move
    (own: their move along v_k in a step). If they rest at the singular pose, or with `home`, it is the one on the side from which
    they came (side > 0: the side to which v_k points).
    """
    D, kept = sigma * sigma, own
    if abs(b) > WEAK.flat:
        middle = -sigma / b
        D += 2.0 * b * E
        y, half = middle, math.sqrt(max(D, 0.0)) / abs(b)
        heading = own - middle
        if abs(side) > WEAK.clearly and (home or abs(heading) < WEAK.clearly * half):
            heading = side
        if half > 0.0:
            half = half if heading > 0.0 else -half
            # The second form of the root avoids a difference of nearly equal numbers.
            y = middle + half if middle * half > 0.0 else -2.0 * E / (b * (middle - half))
    else:
        D -= 2.0 * WEAK.flat * abs(E)  # This D belongs to the largest curvature that counts as zero.
        y = min(max(E / sigma, -sigma / WEAK.flat), sigma / WEAK.flat) if sigma > WEAK.zero else 0.0
        kept *= max(1.0 - h / WEAK.fade, 0.0)
    weight = D if D > 0.0 else -0.5 * D  # The weight is the second derivative of the squared error at the solution.
    return (weight * y + WEAK.least * WEAK.least * kept) / (weight + WEAK.least * WEAK.least), D


@inner
def mode_moved(u, e, ahead, f, h):
    """Return the target's motion along the task direction u (m,) in a step of h [s].

    It is the difference between the errors ahead and e. If the error is large, it is h times the twist f instead, since
    large rotations do not add like vectors.
    """
    m = e.shape[0]
    if dot(e, e, m) > WEAK.close * WEAK.close:
        return h * dot(u, f, m)
    return dot(u, ahead, m) - dot(u, e, m)


@inner
def mode_direction(W, sv, r, away, way, v):
    """Write the joint direction v_r of singular value r to v (n,); return False if there is none to move along.

    For sigma_r near 0 it is `away` (n,) without what moves the tip, and there is none unless a tip motion `way` is asked for.
    """
    clear(v)
    if sv[r] > WEAK.zero:
        add_multiple(v, 1.0 / sv[r], W[r], v.shape[0])
        return True
    return abs(way) > WEAK.zero and lost_direction(W, sv, away, v)


@inner
def remember(state, near, beyond, h):
    """Note in `state` whether the pose is singular (near), and for WEAK.side [s] that a target was out of reach (beyond)."""
    if near:
        state[STATE.near] = 1.0 + WEAK.side if beyond else max(state[STATE.near] - h, 1.0)
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
        bring_along(v, away, grows, min(h / WEAK.side, 1.0) if near > 0.0 else 1.0)
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
    near, beyond, gain = False, False, law.kappa if law.code == CV else min(natural(law, h), WEAK.gain / h)
    for r in range(m):
        if s.sv[r] >= REGION * law.damping:
            continue
        if not near and s.sv[r] > WEAK.clear and state[STATE.near] == 0.0:
            clear(away)  # Before the first singular pose the side from which joints came is only a default.
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
        others = math.sqrt(max(dot(s.e, s.e, m) - left * left, 0.0))  # the error along all other directions
        rest = heavy * others if state[STATE.near] == 1.0 + WEAK.side else 0.0
        mode = WeakMode(r, s.sv[r], rest, speed, left, moved)
        out = mode_speed(s, mode, gain, h, limits, state[STATE.near], away)
        beyond = beyond or out
    remember(state, near, beyond, h)
    return beyond


@inner
def take_out(J, W, U, V, lost, f, G):
    """Remove the task directions marked in lost (m,) from J and the twist f; return how many were removed.

    G receives the factor of the rest of J for `laws.apply`.
    """
    n, m = J.shape
    count = 0
    for r in range(m):
        if lost[r] > 0.0:
            count += 1
            add_multiple(f, -dot(U[r], f, m), U[r], m)
            for i in range(n):
                add_multiple(J[i], -W[r, i], U[r], m)
    wide = is_wide(J, m)
    k = m if wide else n
    gram(J, m, wide, 0.0, G)
    for r in range(m):
        if lost[r] > 0.0:
            for c in range(k):
                for d in range(c + 1):
                    G[c, d] += U[r, c] * U[r, d] if wide else V[r, c] * V[r, d]
    if not wide:  # Otherwise a joint that moves nothing would make the matrix singular.
        for c in range(k):
            G[c, c] += WEAK.nothing
    cholesky(G, k, 0.0)
    return count


@inner
def by_modes(J, W, U, lost, ask, y):
    """Rewrite the task (J and the rates `ask`) along the directions u_k that are kept, which makes the rows independent.

    An error of weight 0 keeps a direction of its own if `modes` began without the directions of another task.
    """
    n, m = J.shape
    if not any_of(lost):
        return
    copy(ask, y)
    for r in range(m):
        kept = 0.0 if lost[r] > 0.0 else 1.0
        ask[r] = kept * dot(U[r], y, m)
        for i in range(n):
            J[i, r] = kept * W[r, i]


@inner
def hold_back(U, sigma, lost, bend, e, ahead, f, more):
    """Shrink error and twist along the task directions that are kept, by as much as an error along removed (lost) ones remains.

    bend is the largest curvature of the tip's path. bend times the remaining error adds to sigma_k^2 in the second derivative of
    the squared error, so undamped steps J^+ e would overshoot to and fro for ever; the shrinking is that of Levenberg-Marquardt.
    Only the remaining error of the tips that a direction moves counts, so that one stretched arm does not hold back another. The
    motion of a target that passes beyond the edge is shrunk, too, as the closest pose moves less. more (m,) is scratch.
    """
    m = lost.shape[0]
    clear(more)
    for first in range(0, m, 6):
        tip, left = range(first, min(first + 6, m)), 0.0
        for c in tip:
            part = 0.0
            for r in range(m):
                if lost[r] > 0.0:
                    part += dot(U[r], e, m) * U[r, c]
            left += part * part
        for r in range(m):
            for c in tip:
                more[r] += U[r, c] * U[r, c] * left
    for r in range(m):
        if lost[r] == 0.0:
            extra = bend * math.sqrt(more[r])
            share = extra / (sigma[r] * sigma[r] + extra)
            for vector in (e, ahead, f):
                add_multiple(vector, -share * dot(U[r], vector, m), U[r], m)


@inner
def along_lost(V, lost, xk, x, speeds):
    """Set the components of the joint rates x (n,) along directions removed from the task to xk (m,), or to 0 if `speeds` is 0."""
    for r in range(lost.shape[0]):
        if lost[r] > 0.0:
            bring_along(V[r], x, xk[r] if speeds > 0.0 else 0.0, 1.0)
