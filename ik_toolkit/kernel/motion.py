"""Following a moving target, one step: rate of the Jacobian, pseudo-inverse, the published commands, limits.

All pure: `factor` inverts the Jacobian, `prepare` says at which joint velocities dJ/dt is wanted, `command` turns errors
into the next joint rate, `advance` moves the joints, inside limits when there are any. The compiled loop (follow.py) and
the paper's cases that are no robots (tracking/methods.py) call the same functions.

All methods share one form: rate' = rate + h a and q' = q + h ((1 - gamma) rate + gamma rate'). gamma is 1 at velocity
level, 1/2 for the paper's acceleration level and free for `aad`. Speed and acceleration of the sampled motion are convex
combinations of rates and accelerations, so limits put on these hold for the samples.

Sign: e = target - actual (Patko and Zelei, 2019, use the opposite). J is (n, m), one joint a row.
"""

import math

import numpy as np

from .jit import jit

CV, AV, CA, AA = range(4)
AT_RATE, AT_RATE_AND_STEP, AT_STEP = range(3)  # where aa takes dJ/dt: readings 1, 2, 3 of eq (25)
# Slots of `p`.
P_CODE, P_KAPPA, P_KP, P_KD, P_GAMMA, P_NULL, P_DAMPING, P_READING, P_RUNAWAY, P_BRAKE = range(10)
P_SIZE = 10
# Slots of `state` and what its first and last hold.
S_START, S_H, S_STOP = range(3)
MOVING, GIVEN, RUNNING = range(3)  # start with the reference's rate, with the rate given, or go on
FINE, NOT_FINITE, RUNAWAY = range(3)
# Bits of `code`: why a joint did not move as commanded.
POSITION, VELOCITY, ACCELERATION, HELD = 1, 2, 4, 8
REGION = 2.0  # damping fades in where the smallest singular value falls below REGION * damping


@jit
def jacobian_rate(rows, Z, J, px, py, pz, x, y, out):
    """Return in out (6,) the product (dJ/dt along joint velocity x) y at the tip point; Z, J from `fk` and `columns`."""
    v0, v1, v2 = 0.0, 0.0, 0.0  # tip velocity
    for i in range(J.shape[0]):
        v0 += J[i, 0] * x[i]
        v1 += J[i, 1] * x[i]
        v2 += J[i, 2] * x[i]
    w0, w1, w2 = 0.0, 0.0, 0.0  # angular velocity before the joint
    u0, u1, u2 = 0.0, 0.0, 0.0  # velocity of the joint's point
    a0, a1, a2, b0, b1, b2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(rows.shape[0]):
        k = int(rows[i, 8])
        z0, z1, z2 = Z[i, 0], Z[i, 1], Z[i, 2]
        if i > 0:
            d0, d1, d2 = Z[i, 3] - Z[i - 1, 3], Z[i, 4] - Z[i - 1, 4], Z[i, 5] - Z[i - 1, 5]
            u0 += w1 * d2 - w2 * d1
            u1 += w2 * d0 - w0 * d2
            u2 += w0 * d1 - w1 * d0
        c0, c1, c2 = w1 * z2 - w2 * z1, w2 * z0 - w0 * z2, w0 * z1 - w1 * z0  # dz/dt
        ratio = rows[i, 4] + rows[i, 6]
        f = ratio * y[k]
        g = ratio * x[k]
        if rows[i, 9] > 0.0:
            r0, r1, r2 = px - Z[i, 3], py - Z[i, 4], pz - Z[i, 5]
            s0, s1, s2 = v0 - u0, v1 - u1, v2 - u2
            a0 += f * (c1 * r2 - c2 * r1 + z1 * s2 - z2 * s1)
            a1 += f * (c2 * r0 - c0 * r2 + z2 * s0 - z0 * s2)
            a2 += f * (c0 * r1 - c1 * r0 + z0 * s1 - z1 * s0)
            b0 += f * c0
            b1 += f * c1
            b2 += f * c2
            w0 += g * z0
            w1 += g * z1
            w2 += g * z2
        else:
            a0 += f * c0
            a1 += f * c1
            a2 += f * c2
            u0 += g * z0
            u1 += g * z1
            u2 += g * z2
    out[0] = a0
    out[1] = a1
    out[2] = a2
    out[3] = b0
    out[4] = b1
    out[5] = b2


# ------------------------------------------------------------------------------------------------ pseudo-inverse
@jit
def gram(J, m, wide, extra, G):
    """Lower half of JJ' (wide) or J'J plus `extra` on the diagonal; a row that is zero (a planar arm's) gets a 1 there."""
    n = J.shape[0]
    k = m if wide else n
    top = 0.0
    for r in range(k):
        for c in range(r + 1):
            s = 0.0
            if wide:
                for i in range(n):
                    s += J[i, r] * J[i, c]
            else:
                for i in range(m):
                    s += J[r, i] * J[c, i]
            G[r, c] = s
        top = max(top, G[r, r])
    for r in range(k):
        G[r, r] = G[r, r] + extra if G[r, r] > 1e-24 * top else 1.0


@jit
def cholesky(G, k, y):
    """Factor in place; return 1 / trace(inverse), a lower bound of the smallest eigenvalue (0 or NaN: singular)."""
    for r in range(k):
        for c in range(r + 1):
            s = G[r, c]
            for j in range(c):
                s -= G[r, j] * G[c, j]
            if r > c:
                G[r, c] = s / G[c, c]
            else:
                G[r, r] = math.sqrt(s)
    trace = 0.0
    for c in range(k):
        for r in range(c, k):
            s = 1.0 if r == c else 0.0
            for j in range(c, r):
                s -= G[r, j] * y[j]
            y[r] = s / G[r, r]
            trace += y[r] * y[r]
    return 1.0 / trace


@jit
def factor(J, m, damping, G, y):
    """Prepare J^+ for `apply`: exact where J is well conditioned, damped near singularities. Returns lambda^2 used.

    lambda^2 = damping^2 (1 - s^2 / (REGION damping)^2) for s below REGION damping, s a lower bound of the smallest
    singular value (Nakamura and Hanafusa, 1986, with s instead of the manipulability). damping = 0 never damps.
    """
    wide = J.shape[0] >= m
    k = m if wide else J.shape[0]
    gram(J, m, wide, 0.0, G)
    low = cholesky(G, k, y)
    border = REGION * REGION * damping * damping
    extra = 0.0
    if damping > 0.0 and not low >= border:
        extra = damping * damping * (1.0 - low / border) if low > 0.0 else damping * damping
        gram(J, m, wide, extra, G)
        cholesky(G, k, y)
    return extra


@jit
def apply(J, m, G, b, y, out):
    """Return in out (n,) the product J^+ b (b has m values), after `factor`."""
    n = J.shape[0]
    wide = n >= m
    k = m if wide else n
    for r in range(k):
        s = 0.0
        if wide:
            s = b[r]
        else:
            for i in range(m):
                s += J[r, i] * b[i]
        for j in range(r):
            s -= G[r, j] * y[j]
        y[r] = s / G[r, r]
    for r in range(k - 1, -1, -1):
        s = y[r]
        for j in range(r + 1, k):
            s -= G[j, r] * y[j]
        y[r] = s / G[r, r]
    for i in range(n):
        if wide:
            s = 0.0
            for r in range(m):
                s += J[i, r] * y[r]
            out[i] = s
        else:
            out[i] = y[i]


# ------------------------------------------------------------------------------------------------ one step
@jit
def prepare(p, J, m, ahead, rate, h, G, y, t, move, null, x1, x2):
    """First half of a step, after `factor`.

    ahead (m,): target at the end of the step minus the tip now. rate (n,): joint velocity. Writes move = J^+ ahead, null =
    (1 - J^+ J) rate, and the joint velocities x1, x2 of the product (dJ/dt along x1) x2 that `command` wants.
    """
    n = J.shape[0]
    code = int(p[P_CODE])
    for i in range(n):
        move[i] = 0.0
        null[i] = 0.0
    if code == AV or code == AA:
        apply(J, m, G, ahead, y, move)
    if code >= CA:
        for k in range(m):
            s = 0.0
            for i in range(n):
                s += J[i, k] * rate[i]
            t[k] = s
        apply(J, m, G, t, y, null)
        reading = int(p[P_READING]) if code == AA else AT_RATE
        for i in range(n):
            null[i] = rate[i] - null[i]
            expected = move[i] / h + null[i]  # with the null part, or a redundant arm loses an order
            x1[i] = expected if reading == AT_STEP else rate[i]
            x2[i] = rate[i] if reading == AT_RATE else expected


@jit
def command(p, J, m, e, v, a, bias, rate, prev, h, ratio, G, y, t, move, null, x):
    """Second half: the joint rate x (n,) wanted at the end of the step.

    e, v, a (m,): target - tip, target velocity and acceleration now; bias (m,): the dJ/dt product asked for by `prepare`;
    prev (n,): the command before (replaced by this one); ratio: this step's h over the last one's, 0 at the start (then
    Adams-Bashforth begins as Euler). Eqs (11), (16), (21), (25) of Patko and Zelei (2019) with the time steps of (26),
    (27), (29), (32), (33).
    """
    n = J.shape[0]
    code = int(p[P_CODE])
    if code == CV:
        for k in range(m):
            t[k] = v[k] + p[P_KAPPA] * e[k]
        apply(J, m, G, t, y, x)
        for i in range(n):
            u = x[i]
            x[i] = u + 0.5 * ratio * (u - prev[i])
            prev[i] = u
    elif code == AV:
        for i in range(n):
            x[i] = move[i] / h
    elif code == CA:
        for k in range(m):
            s = 0.0
            for i in range(n):
                s += J[i, k] * rate[i]
            t[k] = a[k] + p[P_KD] * (v[k] - s) + p[P_KP] * e[k] - bias[k]
        apply(J, m, G, t, y, x)
        for i in range(n):
            u = x[i] - p[P_NULL] * null[i]
            x[i] = rate[i] + h * (u + 0.5 * ratio * (u - prev[i]))
            prev[i] = u
    else:
        gamma = p[P_GAMMA]
        for k in range(m):
            t[k] = bias[k]
        apply(J, m, G, t, y, x)
        for i in range(n):
            u = (move[i] / h - rate[i] + null[i]) / (gamma * h) - 0.5 * x[i] / gamma - p[P_NULL] * null[i]
            x[i] = rate[i] + h * u


@jit
def fastest(distance, v, gamma, h, a):
    """Highest next rate from which braking with at most `a` in steps of h ends within `distance` (now moving at v)."""
    if distance == np.inf:
        return np.inf
    room = distance - h * (1.0 - gamma) * v
    if room < 0.0:
        return room / (gamma * h)
    if a == np.inf:
        return room / h
    # Braking in m + 1 steps covers h (m + 1) (x - a h m / 2), the last step being the gentlest.
    steps = room / (a * h * h)
    m = math.floor(0.5 * (math.sqrt(1.0 + 8.0 * steps) - 1.0))
    return a * h * (steps / (m + 1.0) + 0.5 * m)


@jit
def advance(q, rate, x, gamma, h, limits, code):
    """Move q and rate (in place) towards the wanted rate x, inside limits (4, n): lower, upper, speed, acceleration.

    Every state this leaves can still brake before its position limit (viability), so no later step has to break one
    limit to keep another. code (n,) receives the limit that held each joint back. True when any did.
    """
    any_hit = False
    for i in range(q.shape[0]):
        v = rate[i]
        lower, upper, speed = limits[0, i], limits[1, i], limits[2, i]
        a = limits[3, i]
        rise = v + a * h
        fall = v - a * h
        top_p = fastest(upper - q[i], v, gamma, h, a)
        low_p = -fastest(q[i] - lower, -v, gamma, h, a)
        top = min(top_p, speed, rise)
        low = max(low_p, -speed, fall)
        w = x[i]
        hit = 0
        if low > top:  # only from a start that could not brake in time: brake as hard as allowed
            w = min(max(0.0, fall), rise)
            hit = POSITION | ACCELERATION
        elif w > top:
            hit = POSITION if top == top_p else VELOCITY if top == speed else ACCELERATION
            w = top
        elif w < low:
            hit = POSITION if low == low_p else VELOCITY if low == -speed else ACCELERATION
            w = low
        code[i] = hit
        any_hit = any_hit or hit > 0
        s = q[i] + h * ((1.0 - gamma) * v + gamma * w)
        q[i] = min(max(s, lower), upper)  # rounding only
        rate[i] = w
        x[i] = w
    return any_hit


@jit
def ease(p, J, m, e, ahead, h, limits, G, y, c):
    """Shrink the error fed back (e and ahead, in place) until the joints could brake before it is gone.

    A method that removes a large error in one step asks for far more acceleration than there is; clipped, it overshoots
    and swings for ever. Half of each joint's acceleration and speed is left to the correction, the rest to the path.
    """
    code = int(p[P_CODE])
    natural = p[P_KAPPA] if code == CV else p[P_KP] / p[P_KD] if code == CA else 1.0 / h
    apply(J, m, G, e, y, c)
    f = 1.0
    for i in range(c.shape[0]):
        size = abs(c[i])
        cap = min(fastest(size, 0.0, 1.0, h, 0.5 * limits[3, i]), 0.5 * limits[2, i])
        if natural * size > cap:
            f = min(f, cap / (natural * size))
    if f < 1.0:
        for k in range(m):
            ahead[k] -= (1.0 - f) * e[k]
            e[k] *= f


@jit
def settle(p, h, rate_before, x, code, prev):
    """After limits: what a held-back joint really did becomes its earlier command (no wind-up)."""
    if p[P_CODE] == CV or p[P_CODE] == CA:
        for i in range(x.shape[0]):
            if code[i] > 0:
                prev[i] = x[i] if p[P_CODE] == CV else (x[i] - rate_before[i]) / h


@jit
def to_local(ends, scale, V, out):
    """Twist or acceleration (6,) in base axes [m, rad] -> first joint's axes, lengths over `scale`."""
    for r in range(3):
        out[r] = (ends[r] * V[0] + ends[3 + r] * V[1] + ends[6 + r] * V[2]) / scale
        out[3 + r] = ends[r] * V[3] + ends[3 + r] * V[4] + ends[6 + r] * V[5]
