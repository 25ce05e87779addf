"""The clock of a reference: where it is between samples, and how fast it may run so that joints keep their limits (look-ahead)."""

import math

import numpy as np

from ..compile.jit import cached, inline, inner
from ..kernel.algebra import M3, V3, at3, put3
from ..kernel.kinematics import angle_ratio, rotation_error
from .laws import STATE

QUICK = 10.0  # [1/s] largest change of the clock's rate
SPARE = 0.98  # share of the limits that the look-ahead uses: the run is not quite the motion it looks at
WHOLE = 1e-9  # [samples] within which the clock is at a sample
MAKE_UP = 0.1  # of a step that a clock slightly faster than allowed gains in order to end in whole ones: of 5 it is what is SPARE
STILL = 1e-3  # clock rate below which a run counts as standing still ...
PATIENCE = 1.0  # [s] ... and for how long, before the run continues off the path
PROGRESS = 0.99  # ratio of errors below which a waiting run counts as getting nearer
HALVINGS = 30  # of the interval in which the square of the rate is searched: it ends at 1e-9


@inline
def axes_of(T):
    """Axes of a pose (4, 4)."""
    return M3(V3(T[0, 0], T[1, 0], T[2, 0]), V3(T[0, 1], T[1, 1], T[2, 1]), V3(T[0, 2], T[1, 2], T[2, 2]))


@inner
def turn_left(T0, T1):
    """Rotation vector, in base axes, that brings the rotation of T0 (4, 4) to that of T1."""
    angular = rotation_error(axes_of(T0), axes_of(T1))
    return angular * angle_ratio(angular.square())


@inner
def turned(T0, r, T):
    """Write the rotation of T0 turned by the rotation vector r to T (Rodrigues)."""
    angle = math.sqrt(r.square())
    half = 0.5 * angle
    s = 1.0 - angle * angle / 6.0 if angle < 1e-4 else math.sin(angle) / angle
    c = 0.5 if angle < 1e-4 else 0.5 * (math.sin(half) / half) ** 2
    for k in range(3):
        v = V3(T0[0, k], T0[1, k], T0[2, k])
        w = r.cross(v)
        v = v + w * s + r.cross(w) * c
        T[0, k], T[1, k], T[2, k] = v.x, v.y, v.z


@inner
def cubic(a, b, u, v, f):
    """Cubic from a (slope u) to b (slope v), all per unit of f: value and slope at f."""
    d = b - a
    p, r = d * 3.0 - u * 2.0 - v, u + v - d * 2.0
    return a + (u + (p + r * f) * f) * f, u + (p * 2.0 + r * (3.0 * f)) * f


@inner
def between(T0, T1, V0, V1, A0, A1, h, f, T, V, A):
    """Pose, twist and acceleration a fraction f between two samples h apart: cubics through both; one tip."""
    p, v = cubic(
        V3(T0[0, 3], T0[1, 3], T0[2, 3]), V3(T1[0, 3], T1[1, 3], T1[2, 3]), at3(V0, 0) * h, at3(V1, 0) * h, f
    )  # fmt: skip
    turn = turn_left(T0, T1)
    r, w = cubic(turn * 0.0, turn, at3(V0, 3) * h, at3(V1, 3) * h, f)
    for k in range(4):
        T[3, k] = T0[3, k]
    turned(T0, r, T)
    T[0, 3], T[1, 3], T[2, 3] = p.x, p.y, p.z
    put3(V, 0, v * (1.0 / h))
    put3(V, 3, w * (1.0 / h))
    for k in range(6):
        A[k] = A0[k] + f * (A1[k] - A0[k])


@inner
def reference(T, V, A, s, h, Ts, Vs, As):
    """Pose, twist and acceleration of F tips at the clock s [samples]: T (N, F, 4, 4), V, A (N, 6 F)."""
    j = min(int(s), T.shape[0] - 1)
    f = s - j
    last = j + 1 >= T.shape[0]
    for k in range(T.shape[1]):
        a, b = 6 * k, 6 * k + 6
        if f == 0.0 or last:
            for r in range(4):
                for c in range(4):
                    Ts[k, r, c] = T[j, k, r, c]
            for r in range(a, b):
                Vs[r], As[r] = V[j, r], A[j, r]
        else:
            between(
                T[j, k], T[j + 1, k], V[j][a:b], V[j + 1][a:b], A[j][a:b], A[j + 1][a:b], h, f, Ts[k], Vs[a:b], As[a:b]
            )  # fmt: skip


@inner
def to_go(steps, s):
    """Steps to the end of a reference from the clock s [samples], at the highest rates; steps (N,) from each sample."""
    j = int(s)
    if j >= steps.shape[0] - 1:
        return 0.0
    return steps[j] + (s - j) * (steps[j + 1] - steps[j])


@inner
def clock_at(steps, s, left):
    """Clock [samples], not before s, from which there are `left` steps to the end, see `to_go`."""
    j, last = int(s), steps.shape[0] - 1
    while j < last and steps[j + 1] > left:
        j += 1
    if j >= last:
        return float(last)
    return max(j + (steps[j] - left) / (steps[j] - steps[j + 1]), s)


@inner
def too_far(E, tol_p, tol_r):
    """Largest error in E (m,) [m, rad] over its tolerance."""
    worst = 0.0
    for k in range(0, E.shape[0], 6):
        linear, angular = at3(E, k), at3(E, k + 3)
        worst = max(worst, math.sqrt(linear.square()) / tol_p, math.sqrt(angular.square()) / tol_r)
    return worst


@inner
def next_rate(state, excess, most, h):
    """Clock rate to aim at in the next step; excess: error over tolerance; most: what the look-ahead and the end allow.

    Above the tolerance the clock waits until the error is below half of it. Where waiting does not help the run goes on
    without the path, until it is back on it.
    """
    if excess > 1.0:
        state[STATE.waiting] = 1.0
        if state[STATE.leaving] == 1.0:
            state[STATE.leaving] = 2.0
    elif excess < 0.5:
        state[STATE.waiting] = 0.0
        if state[STATE.leaving] == 2.0:
            state[STATE.leaving] = 0.0
    stuck = state[STATE.waiting] > 0.0 or state[STATE.sigma] < STILL
    if state[STATE.leaving] == 2.0 or not stuck or excess < PROGRESS * state[STATE.least]:
        state[STATE.idle] = 0.0
        state[STATE.least] = excess
    else:
        state[STATE.idle] += h
    if state[STATE.idle] > PATIENCE:
        state[STATE.leaving] = 1.0 - state[STATE.leaving]  # and back, where continuing has not led away from the path
        state[STATE.idle] = 0.0
    aim = most if state[STATE.waiting] == 0.0 or state[STATE.leaving] > 0.0 else 0.0
    change = QUICK * h
    return min(max(aim, state[STATE.sigma] - change), state[STATE.sigma] + change, 1.0)


@inner
def slope_range(a, z, speed, change, limit):
    """Half slopes of z (lowest, highest) at which |change z + speed slope| <= limit for one joint."""
    if abs(speed) < 1e-12:
        return -np.inf, np.inf
    one, other = (-limit - change * z) / speed, (limit - change * z) / speed
    return min(one, other), max(one, other)


@cached
def look_ahead(Q, limits, h, cap, joint):
    """Lower the highest clock rates cap (N + 1,) at the samples of a motion Q (N + 1, n); joint (N + 1,) that set them, -1: none.

    With z the square of the rate, joint speeds along the path are q' sqrt(z) and accelerations q'' z + q' (dz/ds) / 2. One
    pass from the end finds the largest z at each sample from which the rest can be run (the controllable sets of TOPP-RA,
    Pham and Pham, 2018); a run that keeps below never has to brake harder than it can. limits (4, n) as of `box`.
    """
    N, n = Q.shape[0] - 1, Q.shape[1]
    ahead = 1.0
    for k in range(N, -1, -1):
        a = max(min(k, N - 1), 0)
        top, who = cap[k] * cap[k], -1
        for i in range(n):
            v = (Q[a + 1, i] - Q[a, i]) / h
            before = (Q[a, i] - Q[a - 1, i]) / h if a > 0 else v
            v = max(abs(v), abs(before))
            z = (SPARE * limits[2, i] / v) ** 2 if v > 0.0 else 1.0
            if z < top:
                top, who = z, i
        if k < N:
            low, high = 0.0, top
            for step in range(HALVINGS + 1):
                z = high if step == 0 else 0.5 * (low + high)
                least, most, by = -QUICK, QUICK, -1
                for i in range(n):
                    if limits[3, i] < np.inf:
                        v = (Q[k + 1, i] - Q[k, i]) / h
                        before = (Q[k, i] - Q[k - 1, i]) / h if k > 0 else v
                        one, other = slope_range(0.0, z, v, (v - before) / h, SPARE * limits[3, i])
                        if one > least:
                            least, by = one, i
                        if other < most:
                            most, by = other, i
                        if abs(v) < 1e-12 and abs((v - before) / h) * z > SPARE * limits[3, i]:
                            least, by = np.inf, i
                if least <= min(most, 0.5 * (ahead - z) / h):
                    low = z
                    if step == 0:
                        break
                else:
                    high = z
                    if by >= 0:
                        who = by
            if low < top and who < 0:
                who = int(joint[k + 1])
            top = low
        ahead = top
        cap[k] = math.sqrt(top)
        joint[k] = who
