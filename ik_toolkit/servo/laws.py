"""The published tracking laws as pure functions of one step: pseudo-inverse, dJ/dt, command, limits on the feedback.

`factor` prepares the pseudo-inverse of the Jacobian, `prepare` says at which joint velocities dJ/dt is needed, and
`command` turns errors into the next joint rates. The compiled loop (loop.py) calls them; so does methods.py, without a robot.

All methods share one form: rate' = rate + h a and q' = q + h ((1 - gamma) rate + gamma rate'), where a prime marks the next
sample, h is the step and a the acceleration. gamma is 1 at velocity level, 1/2 at the paper's acceleration level, free for `aad`.

Sign: e = target - actual (Patko and Zelei, 2019, use the opposite sign). The array J (n, m) holds the transpose of the usual
Jacobian, with one joint a row.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import compiled, dual, shared
from ..kernel.linalg import TINY, cholesky, cholesky_solve
from ..kernel.null_space import NULL, is_wide
from ..kernel.records import Array
from ..kernel.vectors import apply_transposed, dot, dot_of_columns
from .viability import LIMIT, approach


class LawCode(NamedTuple):
    """Codes of the tracking methods in the compiled loop; method aad has the code of aa, with another gamma and reading."""

    cv: int = 0
    av: int = 1
    ca: int = 2
    aa: int = 3


class ReadingCode(NamedTuple):
    """Codes of the joint rates at which method aa takes dJ/dt: 0, 1 and 2 are its option reading = 1, 2 and 3."""

    at_rate: int = 0
    at_rate_and_step: int = 1
    at_step: int = 2


LAW, READING = LawCode(), ReadingCode()


@compiled
class EasingThresholds(NamedTuple):
    """Thresholds for the damping of the pseudo-inverse, and for how much of an error a step corrects, see `ease`."""

    # The pseudo-inverse is damped where the smallest singular value is below this times `Law.damping`; set by hand.
    region: float = 2.0
    # A correction that limits block is damped by this times the error times the curvature of the tip's path; it is then no longer
    # than sqrt(error / curvature).
    curved: float = 0.25
    sluggish: float = 0.1  # A joint is slow if its speed limit is below this share of the fastest joint's limit.
    touching: float = 1e-9  # [rad or arm reaches] A joint nearer to its limit than this counts as at its limit.


EASING = EasingThresholds()


@compiled
class Law(NamedTuple):
    """A tracking method and its gains (0 if the method has no such gain); Python passes them to the loop as an array."""

    code: float  # LAW.cv, LAW.av, LAW.ca or LAW.aa
    kappa: float  # [1/s] gain of method cv (classical, velocity level)
    kp: float  # [1/s^2] gain of method ca (classical, acceleration level) on the error
    kd: float  # [1/s] gain of method ca on the error's rate
    gamma: float  # weight of the new rate in a step: q' = q + h ((1 - gamma) rate + gamma rate')
    null: float  # damping of null-space motion [1/s]
    damping: float  # [arm reaches per rad] damping of the pseudo-inverse near singular poses
    reading: float  # where dJ/dt is evaluated: a number of `ReadingCode`
    # [rad or arm reaches] mean joint move per step above which the run ends as diverged (mode clip only); inf: the run never ends,
    # and the arm brakes if the rates are not finite
    runaway: float
    brake: float  # 1 if the arm brakes to rest, whatever the target, else 0
    # [s] longest step that may come after this one; joints must still be able to stop inside their limits in steps of this length
    late: float
    mode: float  # what gives way to limits: a number of `constrained_step.StepModes`
    avoid: float  # [1/s] gain of the motion away from joint limits
    rows: float  # number of collision inequalities in use
    measured: float  # 1: error and Jacobian are evaluated at the measured joint values, 0: at the commanded ones
    omit: float  # share of the error that methods av, aa and aad do not remove in this step


PLACE = Law._make(range(len(Law._fields)))  # index of each field of `Law` in the array that Python passes to the loop


@compiled
class TargetMotion(NamedTuple):
    """A target's pose error and motion, arrays (m,)."""

    e: Array  # error now: pose of the target minus pose of the tip
    ahead: Array  # error at the end of the step if the tip stood still: target then minus tip now
    v: Array  # velocity of the target now
    a: Array  # acceleration of the target now
    bias: (
        Array  # product (dJ/dt) x2, where dJ/dt is the change of J at the joint rates x1; x1 and x2: see `JointMotion`
    )


@compiled
class PseudoInverse(NamedTuple):
    """A Jacobian, the factor with which its pseudo-inverse is applied, and scratch."""

    J: Array  # (n, m) transposed Jacobian
    G: Array  # (k, k) Cholesky factor written by `factor`; k is the larger of n and m
    H: Array  # (k, k) scratch for another factor
    y: Array  # (k,) scratch
    t: Array  # (m,) scratch


@compiled
class JointMotion(NamedTuple):
    """Joint-space quantities of a step, arrays (n,), written by `prepare` and `command`."""

    # J^+ (ahead - omit e): joint move that closes the error at the end of the step, except the share `omit` of the present error
    move: Array
    null: Array  # (1 - J^+ J) rate, the null-space part of the present joint rates
    x1: Array  # the joint rates along which dJ/dt is evaluated
    x2: Array  # the joint rates by which dJ/dt along x1 is multiplied
    x: Array  # commanded rates at the end of the step


@compiled
class CorrectionLimits(NamedTuple):
    """Limits on how fast a step may close an error, see `ease`."""

    fast: float  # share of each joint's speed limit that may be used
    quick: float  # share of each joint's acceleration limit that may be used
    bend: float  # product of the curvature of the tip's path and the error; 0: the curvature is neglected


@dual
def gram(J, m, wide, extra, G):
    """Write to G the lower half of JJ' (if wide) or J'J for the usual Jacobian J, plus `extra` on the diagonal.

    J: the transposed Jacobian (n, m). Diagonal entries of zero become 1.
    """
    k = m if wide else J.shape[0]
    top = 0.0
    for r in range(k):
        for c in range(r + 1):
            G[r, c] = dot_of_columns(J, r, J, c, J.shape[0]) if wide else dot(J[r], J[c], m)
        top = max(top, G[r, r])
    for r in range(k):
        G[r, r] = G[r, r] + extra if G[r, r] > NULL.single * top else 1.0


@dual
def invert(G, k, y):
    """Replace G (k, k) by its Cholesky factor; return 1 / trace(G^-1), a bound below G's eigenvalues. y (k,): scratch."""
    cholesky(G, k, TINY)
    trace = 0.0
    for c in range(k):
        for r in range(c, k):
            s = 1.0 if r == c else 0.0
            for j in range(c, r):
                s -= G[r, j] * y[j]
            y[r] = s * G[r, r]
            trace += y[r] * y[r]
    return 1.0 / trace


@dual
def factor(J, m, damping, G, y):
    """Write to G the factor with which `apply` multiplies by the pseudo-inverse J^+; return its damping lambda^2.

    J (n, m): transposed Jacobian; y (n or m,): scratch. The pseudo-inverse is damped only near singularities:
    lambda^2 = damping^2 (1 - s^2 / (region damping)^2) for s below region damping, where s is a lower bound of the smallest
    singular value (Nakamura and Hanafusa, 1986, use the manipulability in place of s). damping = 0 never damps.
    """
    wide = is_wide(J, m)
    k = m if wide else J.shape[0]
    gram(J, m, wide, 0.0, G)
    low = invert(G, k, y)
    border = EASING.region * EASING.region * damping * damping
    extra = 0.0
    if damping > 0.0 and not low >= border:
        extra = damping * damping * (1.0 - low / border) if low > 0.0 else damping * damping
        gram(J, m, wide, extra, G)
        cholesky(G, k, 0.0)
    return extra


@dual
def apply(J, m, G, b, y, out):
    """Write to out (n,) the product J^+ b of the pseudo-inverse with b (m,), by the factor G that `factor` wrote; y: scratch."""
    wide = is_wide(J, m)
    k = m if wide else J.shape[0]
    for r in range(k):
        y[r] = b[r] if wide else dot(J[r], b, m)
    cholesky_solve(G, k, y)
    for i in range(J.shape[0]):
        out[i] = dot(J[i], y, m) if wide else y[i]


@dual
def prepare(p, inverse, target, rate, h, joints):
    """Do the first half of a step of h [s], after `factor`: write all of `joints` (JointMotion) except the commanded rates `x`.

    p: the method and its gains (`Law`); inverse: `PseudoInverse`; target: `TargetMotion`; rate (n,): present joint rates. The
    caller then writes the product (dJ/dt) joints.x2 to target.bias, where dJ/dt is the change of J at the rates joints.x1.
    `command` does the second half of the step.
    """
    J, t = inverse.J, inverse.t
    n, m = J.shape
    code = int(p.code)
    for i in range(n):
        joints.move[i], joints.null[i] = 0.0, 0.0
    if code == LAW.av or code == LAW.aa:
        for k in range(m):
            t[k] = target.ahead[k] - p.omit * target.e[k]
        apply(J, m, inverse.G, t, inverse.y, joints.move)
    if code >= LAW.ca:
        apply_transposed(J, rate, t)
        apply(J, m, inverse.G, t, inverse.y, joints.null)
        reading = int(p.reading) if code == LAW.aa else READING.at_rate
        for i in range(n):
            joints.null[i] = rate[i] - joints.null[i]
            # Without the null-space part of the rates, tracking by a redundant arm would lose an order of accuracy.
            expected = joints.move[i] / h + joints.null[i]
            joints.x1[i] = expected if reading == READING.at_step else rate[i]
            joints.x2[i] = rate[i] if reading == READING.at_rate else expected


@dual
def command(p, inverse, target, rate, prev, h, ratio, joints):
    """Do the second half of a step: write the joint rates joints.x commanded for the end of the step.

    Arguments are those of `prepare`, and: prev (n,): the previous command, replaced by this one; ratio: this step's h over that of
    the last step, 0 at the start (Adams-Bashforth then begins with an Euler step). The laws are eqs (11), (16), (21), (25) of Patko
    and Zelei (2019), with the time steps of (26), (27), (29), (32), (33).
    """
    J, t, x, null, move = inverse.J, inverse.t, joints.x, joints.null, joints.move
    n, m = J.shape
    code = int(p.code)
    if code == LAW.cv:
        for k in range(m):
            t[k] = target.v[k] + p.kappa * target.e[k]
        apply(J, m, inverse.G, t, inverse.y, x)
        for i in range(n):
            u = x[i]
            x[i] = u + 0.5 * ratio * (u - prev[i])
            prev[i] = u
    elif code == LAW.av:
        for i in range(n):
            x[i] = move[i] / h
    elif code == LAW.ca:
        apply_transposed(J, rate, t)
        for k in range(m):
            t[k] = target.a[k] + p.kd * (target.v[k] - t[k]) + p.kp * target.e[k] - target.bias[k]
        apply(J, m, inverse.G, t, inverse.y, x)
        for i in range(n):
            u = x[i] - p.null * null[i]
            x[i] = rate[i] + h * (u + 0.5 * ratio * (u - prev[i]))
            prev[i] = u
    else:
        apply(J, m, inverse.G, target.bias, inverse.y, x)
        for i in range(n):
            u = (move[i] / h - rate[i] + null[i]) / (p.gamma * h) - 0.5 * x[i] / p.gamma - p.null * null[i]
            x[i] = rate[i] + h * u


@shared
def natural(p, h):
    """Return the rate [1/s] at which a method p (`Law`) removes an error in steps of h [s] if nothing limits it; 0: never."""
    if p.code == LAW.cv:
        return p.kappa
    if p.code == LAW.ca:
        return p.kp / p.kd if p.kd > 0.0 else 0.0
    return (1.0 - p.omit) / h


@dual
def possible(c, pace, h, q, limits, fast, quick, walls):
    """Return the share (0 to 1) of a correction c (n,) for which the joints can brake in time, and whether a limit blocks it.

    pace [1/s]: rate at which the error is corrected, in steps of h [s]; q (n,): joint values; limits (4, n): lower, upper, speed,
    acceleration; fast, quick: shares of speed and acceleration limits to use; walls: whether a joint at its position limit is
    reported as blocking the correction instead of lowering the share, see `ease`.
    """
    f, stopped = 1.0, False
    for i in range(c.shape[0]):
        size = abs(c[i])
        if walls and (
            q[i] >= limits[LIMIT.highest, i] - EASING.touching
            if c[i] > 0.0
            else q[i] <= limits[LIMIT.lowest, i] + EASING.touching
        ):
            stopped = True
            continue
        cap = fast * limits[LIMIT.speed, i]
        if limits[LIMIT.acceleration, i] < np.inf:
            cap = min(cap, approach(size, 0.0, 1.0, h, quick * limits[LIMIT.acceleration, i], h))
        if pace * size > cap > 0.0:  # A locked joint is skipped: the others close the error.
            f = min(f, cap / (pace * size))
    return f, stopped


@dual
def spare(J, m, e, limits, H, y, c):
    """Write to c (n,) joint moves that correct the error e (m,), with less use of slow joints; return whether there are such moves.

    There are none if all speed limits are about equal. limits (4, n): lower, upper, speed, acceleration. J (transposed, (n, m)) is
    scaled in place by the speed limits, rounded to powers of 2, so that undoing this restores it exactly. H, y: scratch.
    """
    top, slow = 0.0, False
    for i in range(c.shape[0]):
        top = max(top, limits[LIMIT.speed, i] if limits[LIMIT.speed, i] < np.inf else 0.0)
    for i in range(c.shape[0]):
        slow = slow or halved(limits[LIMIT.speed, i], top) < 1.0
    if not slow:
        return False
    for i in range(c.shape[0]):
        w = halved(limits[LIMIT.speed, i], top)
        for k in range(m):
            J[i, k] *= w
    gram(J, m, True, 0.0, H)
    cholesky(H, m, 0.0)
    apply(J, m, H, e, y, c)
    finite = True
    for i in range(c.shape[0]):
        w = halved(limits[LIMIT.speed, i], top)
        c[i] *= w
        finite = finite and abs(c[i]) < np.inf
        for k in range(m):
            J[i, k] /= w
    return finite


@dual
def halved(speed, top):
    """Return a joint's weight in `spare`: 1, or for a slow joint the largest power of 2 up to its speed limit over the highest."""
    w = 1.0
    while 0.0 < speed < EASING.sluggish * top and speed < w * top:
        w *= 0.5
    return w


@dual
def ease(p, inverse, target, h, q, limits, allowed, brisk, c):
    """Shrink the error that a step corrects (target.e and ahead, in place) until joints can brake before it is zero.

    A method that removes a large error in one step asks for more acceleration than there is; clipped, it overshoots and oscillates
    for ever. Joints at their position limits do not count in this. If they or inequalities block the correction J^+ e, it is
    computed again with damping from brisk.bend, because the real motion along a nearly singular direction is much shorter. If
    allowed.rows is -1, neither is checked. p: `Law`; inverse: `PseudoInverse`; target: `TargetMotion`; h [s]: the step; q (n,):
    joint values; limits (4, n): lower, upper, speed, acceleration; allowed: rate bounds and inequalities (`Allowed`); brisk:
    `CorrectionLimits`; c (n,): scratch. Returns whether the correction is blocked.
    """
    J, e, H, y = inverse.J, target.e, inverse.H, inverse.y
    n, m = J.shape
    pace, f, wide, blocked, looked = natural(p, h), 1.0, is_wide(J, m), False, allowed.rows >= 0
    for damped in range(2):
        if damped:
            gram(J, m, wide, EASING.curved * brisk.bend, H)
            cholesky(H, m if wide else n, 0.0)
        apply(J, m, H if damped else inverse.G, e, y, c)
        for k in range(allowed.rows):
            blocked = blocked or dot(allowed.planes[k], c, n) > max(allowed.edges[k], 0.0) / pace
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
    """Replace the previous command prev (n,) of clipped joints by the rate, or for ca the acceleration, that they really took.

    Otherwise the methods cv and ca, which extrapolate their commands, would wind up. p: `Law`; h [s]: the step; rate_before, x
    (n,): rates before and after it; code (n,): bits of the limits that clipped each joint.
    """
    if p.code == LAW.cv or p.code == LAW.ca:
        for i in range(x.shape[0]):
            if code[i] > 0:
                prev[i] = x[i] if p.code == LAW.cv else (x[i] - rate_before[i]) / h


@dual
def rewrite_command(p, h, ratio, wanted, x, prev):
    """Change prev (n,), the last command, to one from which the rates taken, x (n,), would have followed, to prevent wind-up.

    p: `Law`; h [s]: the step; wanted (n,): the rates that the law had commanded; ratio: this step's h over that of the last step, 0
    at the start.
    """
    ahead = 0.5 * ratio
    if p.code == LAW.cv or p.code == LAW.ca:
        for i in range(x.shape[0]):
            change = x[i] - wanted[i]
            prev[i] += (change if p.code == LAW.cv else change / h) / (1.0 + ahead)
