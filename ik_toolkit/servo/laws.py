"""Following a moving target, one step: rate of the Jacobian, pseudo-inverse, the published commands, limits.

All pure: `factor` inverts the Jacobian, `prepare` says at which joint velocities dJ/dt is wanted, `command` turns errors into
the next joint rate. The compiled loop (loop.py) and the paper's cases that are no robots (servo/methods.py) call these.

All methods share one form: rate' = rate + h a and q' = q + h ((1 - gamma) rate + gamma rate'). gamma is 1 at velocity
level, 1/2 for the paper's acceleration level and free for `aad`.

Sign: e = target - actual (Patko and Zelei, 2019, use the opposite). J is (n, m), one joint a row.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import compiled, dual
from ..kernel.linalg import TINY, cholesky, cholesky_solve
from ..kernel.records import Array
from .viability import approach

CV, AV, CA, AA = range(4)
CLIP = 2  # beside LEAVE and DIRECT of constrained_step.py: each joint clipped on its own
AT_RATE, AT_RATE_AND_STEP, AT_STEP = range(3)  # where aa takes dJ/dt: readings 1, 2, 3 of eq (25)
MOVING, GIVEN, RUNNING, READY = range(4)  # start with the reference's rate, with the rate given; go on; all is known
FINE, NOT_FINITE, RUNAWAY = range(3)
SINGLE = 1e-24  # share of the largest diagonal entry of JJ' below which the joints cannot move along a row
FAR = 0.25  # of curvature times error: damped by it, a direction asks for at most the root of error over curvature
SLUGGISH = 0.1  # of the fastest joint's speed, below which others are asked first
AT = 1e-9  # [rad, or reaches] from a limit within which a joint counts as at the limit
REGION = 2.0  # damping fades in where the smallest singular value falls below REGION * damping


class State(NamedTuple):
    """What a tracker keeps between steps, as an array that Python passes in."""

    start: int  # how the next step begins: MOVING, GIVEN, RUNNING
    period: int  # length of the last step [s]
    stop: int  # why the loop ended: FINE, NOT_FINITE, RUNAWAY
    near: int  # 1: near a singular pose in the last step, and [s] for which the target counts as out of reach; -1: once, 0: never
    share: int  # of the curvature, by which steps down are damped, 0: the method's own steps; see damped_descent.py
    lowest: int  # ... which it is not lowered below
    nearest: int  # weighted error from which it has to come down
    stalled: int  # [s] for which limits or a singular pose have kept it from that; in a step down, since it last did
    turned: int  # how often the joints have turned back meanwhile
    free: int  # [s] since limits, half-planes or a singular pose have hindered the joints
    pressed: int  # [s] for which errors beyond their slack are closed like others, as half-planes could not be kept


STATE = State._make(range(len(State._fields)))  # places in the array


@compiled
class Law(NamedTuple):
    """A tracking method and its gains; those it does not have are 0. Python passes it as an array."""

    code: float  # CV, AV, CA, AA
    kappa: float
    kp: float
    kd: float
    gamma: float
    null: float  # damping of null-space motion [1/s]
    damping: float
    reading: float  # AT_RATE, AT_RATE_AND_STEP, AT_STEP
    runaway: float  # largest mean move of a joint in a step; inf: hold still instead of stopping
    brake: float  # 1: come to rest
    late: float  # longest step that may follow [s]
    mode: float  # LEAVE, DIRECT, CLIP
    avoid: float  # [1/s] how strongly joints are led away from their limits
    rows: float  # half-planes that hold
    measured: float  # 1: error and Jacobian are taken at the joints measured
    omit: float  # share of the error that AV and AA leave to later steps


PLACE = Law._make(range(len(Law._fields)))  # in the array that Python passes in


@compiled
class TargetMotion(NamedTuple):
    """Where a target is and how it moves, arrays (m,)."""

    e: Array  # target now minus the tip now
    ahead: Array  # target at the end of the step minus the tip now
    v: Array  # its velocity
    a: Array  # and acceleration now
    bias: Array  # the product with dJ/dt that `prepare` has asked for


@compiled
class PseudoInverse(NamedTuple):
    """A Jacobian and what is needed to invert it."""

    J: Array  # (n, m)
    G: Array  # (k, k) what `factor` has made of it, k the larger of n and m
    H: Array  # (k, k) scratch for another factor
    y: Array  # (k,) scratch
    t: Array  # (m,) scratch


@compiled
class JointMotion(NamedTuple):
    """What a step makes of joints, arrays (n,)."""

    move: Array  # J^+ ahead, less what of the error is left to later steps
    null: Array  # (1 - J^+ J) rate
    x1: Array  # the product with dJ/dt along x1 of x2 is wanted
    x2: Array
    x: Array  # rates wanted at the end of the step


@compiled
class Briskness(NamedTuple):
    """How fast an error is closed."""

    fast: float  # share of each joint's speed
    quick: float  # share of each joint's acceleration
    bend: float  # curvature of the tip's way times the error, 0: it is not looked at


@dual
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
        G[r, r] = G[r, r] + extra if G[r, r] > SINGLE * top else 1.0


@dual
def invert(G, k, y):
    """Factor G in place; return 1 / trace(inverse), a lower bound of the smallest eigenvalue (0 or NaN: singular)."""
    cholesky(G, k, TINY)
    trace = 0.0
    for c in range(k):
        for r in range(c, k):
            s = 1.0 if r == c else 0.0
            for j in range(c, r):
                s -= G[r, j] * y[j]
            y[r] = s / G[r, r]
            trace += y[r] * y[r]
    return 1.0 / trace


@dual
def factor(J, m, damping, G, y):
    """Prepare J^+ for `apply`: exact where J is well conditioned, damped near singularities. Returns lambda^2 used.

    lambda^2 = damping^2 (1 - s^2 / (REGION damping)^2) for s below REGION damping, s a lower bound of the smallest
    singular value (Nakamura and Hanafusa, 1986, with s instead of the manipulability). damping = 0 never damps.
    """
    wide = J.shape[0] >= m
    k = m if wide else J.shape[0]
    gram(J, m, wide, 0.0, G)
    low = invert(G, k, y)
    border = REGION * REGION * damping * damping
    extra = 0.0
    if damping > 0.0 and not low >= border:
        extra = damping * damping * (1.0 - low / border) if low > 0.0 else damping * damping
        gram(J, m, wide, extra, G)
        cholesky(G, k, 0.0)
    return extra


@dual
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
        y[r] = s
    cholesky_solve(G, k, y)
    for i in range(n):
        if wide:
            s = 0.0
            for r in range(m):
                s += J[i, r] * y[r]
            out[i] = s
        else:
            out[i] = y[i]


@dual
def prepare(p, inverse, target, rate, h, joints):
    """First half of a step of h [s], after `factor`, from the joint rates (n,): all but `x` of `joints`."""
    J, t = inverse.J, inverse.t
    n, m = J.shape
    code = int(p.code)
    for i in range(n):
        joints.move[i], joints.null[i] = 0.0, 0.0
    if code == AV or code == AA:
        for k in range(m):
            t[k] = target.ahead[k] - p.omit * target.e[k]
        apply(J, m, inverse.G, t, inverse.y, joints.move)
    if code >= CA:
        for k in range(m):
            s = 0.0
            for i in range(n):
                s += J[i, k] * rate[i]
            t[k] = s
        apply(J, m, inverse.G, t, inverse.y, joints.null)
        reading = int(p.reading) if code == AA else AT_RATE
        for i in range(n):
            joints.null[i] = rate[i] - joints.null[i]
            expected = (
                joints.move[i] / h + joints.null[i]
            )  # with the null part; without it a redundant arm loses an order
            joints.x1[i] = expected if reading == AT_STEP else rate[i]
            joints.x2[i] = rate[i] if reading == AT_RATE else expected


@dual
def command(p, inverse, target, rate, prev, h, ratio, joints):
    """Second half: the joint rates joints.x wanted at the end of the step.

    prev (n,): the command before (replaced by this one); ratio: this step's h over the last one's, 0 at the start (then
    Adams-Bashforth begins as Euler). Eqs (11), (16), (21), (25) of Patko and Zelei (2019) with the time steps of (26),
    (27), (29), (32), (33).
    """
    J, t, x, null, move = inverse.J, inverse.t, joints.x, joints.null, joints.move
    n, m = J.shape
    code = int(p.code)
    if code == CV:
        for k in range(m):
            t[k] = target.v[k] + p.kappa * target.e[k]
        apply(J, m, inverse.G, t, inverse.y, x)
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
            t[k] = target.a[k] + p.kd * (target.v[k] - s) + p.kp * target.e[k] - target.bias[k]
        apply(J, m, inverse.G, t, inverse.y, x)
        for i in range(n):
            u = x[i] - p.null * null[i]
            x[i] = rate[i] + h * (u + 0.5 * ratio * (u - prev[i]))
            prev[i] = u
    else:
        for k in range(m):
            t[k] = target.bias[k]
        apply(J, m, inverse.G, t, inverse.y, x)
        for i in range(n):
            u = (move[i] / h - rate[i] + null[i]) / (p.gamma * h) - 0.5 * x[i] / p.gamma - p.null * null[i]
            x[i] = rate[i] + h * u


@dual
def natural(p, h):
    """Rate [1/s] at which a method by itself removes an error; 0 where it feeds back none, or damps nothing."""
    if p.code == CV:
        return p.kappa
    if p.code == CA:
        return p.kp / p.kd if p.kd > 0.0 else 0.0
    return (1.0 - p.omit) / h


@dual
def possible(c, pace, h, q, limits, fast, quick, walls):
    """Share of a correction c (n,) that all joints can brake before, and whether a joint at its limit is in its way, see `ease`."""
    f, stopped = 1.0, False
    for i in range(c.shape[0]):
        size = abs(c[i])
        if walls and (q[i] >= limits[1, i] - AT if c[i] > 0.0 else q[i] <= limits[0, i] + AT):
            stopped = True
            continue
        cap = fast * limits[2, i]
        if limits[3, i] < np.inf:
            cap = min(cap, approach(size, 0.0, 1.0, h, quick * limits[3, i], h))
        if pace * size > cap > 0.0:  # a locked joint does not count: the others close the error
            f = min(f, cap / (pace * size))
    return f, stopped


@dual
def spare(J, m, e, limits, H, y, c):
    """Correction c (n,) of e that spares slow joints; False where none is slow, or where it is not finite.

    The pseudo-inverse weighted by speed; by powers of 2, so that J is afterwards what it was before.
    """
    top, slow = 0.0, False
    for i in range(c.shape[0]):
        top = max(top, limits[2, i] if limits[2, i] < np.inf else 0.0)
    for i in range(c.shape[0]):
        slow = slow or halved(limits[2, i], top) < 1.0
    if not slow:
        return False
    for i in range(c.shape[0]):
        w = halved(limits[2, i], top)
        for k in range(m):
            J[i, k] *= w
    gram(J, m, True, 0.0, H)
    cholesky(H, m, 0.0)
    apply(J, m, H, e, y, c)
    finite = True
    for i in range(c.shape[0]):
        w = halved(limits[2, i], top)
        c[i] *= w
        finite = finite and abs(c[i]) < np.inf
        for k in range(m):
            J[i, k] /= w
    return finite


@dual
def halved(speed, top):
    """The weight of a joint: 1, for a slow one the largest power of 2 that is not above its share of the top speed."""
    w = 1.0
    while 0.0 < speed < SLUGGISH * top and speed < w * top:
        w *= 0.5
    return w


@dual
def ease(p, inverse, target, h, q, limits, allowed, brisk, c):
    """Shrink the error fed back (target.e and ahead, in place) until the joints can brake before it reaches zero.

    A method that removes a large error in one step asks for far more acceleration than there is; clipped, it overshoots
    and swings for ever. Joints at their limits have no say. Where they or half-planes are in the way J^+ e, that way is not the one
    the joints take: with a bend it is looked at again, damped, as along a weak direction it ends long before. Neither is looked at
    where allowed.rows is -1. c (n,) is scratch. Returns whether they are in the way.
    """
    J, e, H, y = inverse.J, target.e, inverse.H, inverse.y
    n, m = J.shape
    pace, f, wide, blocked, looked = natural(p, h), 1.0, n >= m, False, allowed.rows >= 0
    for damped in range(2):
        if damped:
            gram(J, m, wide, FAR * brisk.bend, H)
            cholesky(H, m if wide else n, 0.0)
        apply(J, m, H if damped else inverse.G, e, y, c)
        for k in range(allowed.rows):
            over = -max(allowed.edges[k], 0.0) / pace
            for i in range(n):
                over += allowed.planes[k, i] * c[i]
            blocked = blocked or over > 0.0
        f, stopped = possible(c, pace, h, q, limits, brisk.fast, brisk.quick, looked)
        blocked = blocked or stopped
        if f == 1.0 or not blocked or brisk.bend == 0.0:
            break
    if f < 1.0 and looked and wide and spare(J, m, e, limits, H, y, c):
        f = max(f, possible(c, pace, h, q, limits, brisk.fast, brisk.quick, looked)[0])
    if f < 1.0:
        for k in range(m):
            target.ahead[k] -= (1.0 - f) * e[k]
            e[k] *= f
    return blocked


@dual
def settle(p, h, rate_before, x, code, prev):
    """After limits: the rate that a held-back joint really took becomes its previous command (no wind-up)."""
    if p.code == CV or p.code == CA:
        for i in range(x.shape[0]):
            if code[i] > 0:
                prev[i] = x[i] if p.code == CV else (x[i] - rate_before[i]) / h


@dual
def own_up(p, h, ratio, wanted, x, prev):
    """The same where all joints were changed: the earlier command becomes the one that the rates taken would have come from."""
    ahead = 0.5 * ratio
    if p.code == CV or p.code == CA:
        for i in range(x.shape[0]):
            change = x[i] - wanted[i]
            prev[i] += (change if p.code == CV else change / h) / (1.0 + ahead)
