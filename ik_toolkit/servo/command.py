"""Which joint rates a method wants: a published law, or a solver's rule taken one step a sample."""

# numba's own types know neither options in a dict nor that overloads and intrinsics are called by numba.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import math
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from ..compile.jit import INLINE, inline, inner
from ..kernel.records import copy
from ..kernel.search import SINGULAR_STEP
from .constrained_step import Allowed
from .laws import (
    AA,
    AT_RATE,
    AT_STEP,
    CA,
    CLIP,
    CV,
    REGION,
    RUNNING,
    STATE,
    Briskness,
    JointMotion,
    PseudoInverse,
    TargetMotion,
    command,
    ease,
    factor,
    gram,
    invert,
    prepare,
)  # fmt: skip
from .null_space_motion import away_from_limits, clip_wish, into_null_space, weigh
from .singular_directions import bend, judge_modes, remember
from .singular_step import CLOSE, along_lost, begin_anew, down_slopes, hold_back, mode_part, modes, take_out

# Share s of a velocity that ca, which extrapolates, may change in a step: z^2 - (1 - 3/2 s) z - s/2 has both roots inside the
# unit circle below s = 1, and the smallest largest one (0.58) at 2/3, as with kappa h of cv (Patko and Zelei, 2019).
SHARE = 2.0 / 3.0
TAKEN_UP = 20.0  # [1/s] least rate at which joints take up what is wished: slower than braking, they run into limits they avoid
LITTLE = 0.004  # [rad or reaches per s] wish that is taken up half as fast: it comes and goes smoothly
# Shares of speed and acceleration with which an error is closed: what braking on the path needs is left.
FAST, BRISK = 1.0, 0.5


class Moment(NamedTuple):
    """One step: how many half-planes there are, and how long it is [s]."""

    rows: int
    h: float


class Published(NamedTuple):
    """Stands in for a rule: the laws of laws.py, all in one loop."""

    unused: float


@inline
def target_of(s):
    """The target of a bench as the laws take it."""
    return TargetMotion(s.e, s.ahead, s.f, s.a, s.bias)


@inline
def inverse_of(s):
    """Its Jacobian, with scratch."""
    return PseudoInverse(s.J, s.G, s.H, s.y, s.t)


@inline
def find_wishes(law, s, limits, wish, base):
    """Write to s.g the joints' secondary motion: away from limits, towards a posture, down the caller's cost.

    It is what the null space has of it, within half of the room that the rates `base` leave in the box. False: there is none.
    """
    n, m = s.J.shape
    some = False
    if law.mode == CLIP:
        return False
    for i in range(n):
        s.g[i] = wish[1, i] * (wish[0, i] - s.at[i]) + wish[2, i]
    if law.avoid > 0.0:
        away_from_limits(s.at, limits, law.avoid, s.g)
    for i in range(n):
        some = some or s.g[i] != 0.0
    if some:
        into_null_space(s.J, m, s.G, s.y, s.t, s.g, s.v)
        along_lost(s.V, s.lost, s.xk, s.g, 0.0)
        down_slopes(s.W, s.V, s.sv, s.pull, s.g, 0.0)
        clip_wish(s.g, base, s.floor, s.roof)
        return True
    return False


@inline
def lean_not(law, rule, s, limits, wish, rate, h):
    """The published laws look ahead from where the joints are."""
    return False


@inline
def lean_over(law, rule, s, limits, wish, rate, h):
    """Move s.at by the secondary motion, so that a rule's step cancels its effect on the tip.

    Returns whether it has moved.
    """
    if law.mode != CLIP:
        factor(s.J, s.J.shape[1], law.damping, s.G, s.y)
        if find_wishes(law, s, limits, wish, rate):
            for i in range(rate.shape[0]):
                s.at[i] += h * s.g[i]
            return True
    for i in range(rate.shape[0]):
        s.g[i] = 0.0
    return False


@inline
def add_wishes(law, s, given, ratio, h, memory):
    """Add the secondary motion to s.x: it must be part of what is extrapolated, or the tip would leave its path.

    Where accelerations are wanted, one by which the joints' own motion in the null space comes to it: weak where little is wished.
    """
    if find_wishes(law, s, given.limits, given.wish, s.x):
        kept, share = 0.0, 1.0
        if law.code >= CA:
            size = 0.0
            for i in range(s.g.shape[0]):
                size += s.g[i] * s.g[i]
            rate = max(min(TAKEN_UP, (SHARE if law.code == CA else 1.0) / h), law.null)  # law.null is damped already
            share = min(h * rate, 1.0) * math.sqrt(size) / (math.sqrt(size) + LITTLE)
            for i in range(s.g.shape[0]):
                s.g[i] -= (1.0 - law.null / rate) * s.null[i]
        if law.code == CV or law.code == CA:
            kept = share / h if law.code == CA else share
            share *= 1.0 + 0.5 * ratio
        for i in range(s.x.shape[0]):
            s.x[i] += share * s.g[i]
            memory[i] += kept * s.g[i]


@inline
def feed_back(law, s, limits, now, heavy, beyond):
    """Shrink the error fed back, see `hold_back` and `ease`; returns whether limits or half-planes are in its way."""
    n, m = s.J.shape
    if beyond:
        hold_back(s.U, s.sv, s.lost, heavy, s.e, s.ahead, s.f, s.y)
    limited = law.mode != CLIP and law.code >= CA
    for i in range(n):
        limited = limited or limits[3, i] < np.inf
    if not limited:
        return False
    size, gone = 0.0, 0.0  # the lost part is not an error that the other directions can close
    for k in range(m):
        size += s.e[k] * s.e[k]
        if s.lost[k] > 0.0:
            gone += mode_part(s.U, k, s.e) ** 2
    curved = heavy * math.sqrt(max(size - gone, 0.0)) if size > CLOSE * CLOSE else 0.0
    fast, quick = (0.5, 0.5) if law.mode == CLIP else (FAST, BRISK)
    allowed = Allowed(s.floor, s.roof, s.planes, s.edges, now.rows if law.mode != CLIP else -1)
    return ease(law, inverse_of(s), target_of(s), now.h, s.at, limits, allowed, Briskness(fast, quick, curved), s.x)


@inline
def by_law(law, rule, task, look, weights, s, given, own, now):
    """Rates that a published law wants, to s.x. Returns how much of the task was lost, or the damping (CLIP)."""
    n, m = s.J.shape
    limits, rate, state, h = given.limits, own.motion[1], own.state, now.h
    border = REGION * law.damping
    damped, weak, weighed, beyond, heavy = 0.0, False, False, False, 0.0 if law.mode == CLIP else 1.0
    if law.mode == CLIP:
        damped = factor(s.J, m, law.damping, s.G, s.y)
    else:
        weighed = (
            n < m
        )  # not every error can be closed: what is closest, and what is lost of a task, is by their weights
        if weighed:
            heavy = weigh(s.weight, s.J, s.e, s.ahead, s.f, s.a)
        gram(s.J, m, n >= m, 0.0, s.G)
        low = invert(s.G, min(n, m), s.y)
        weak = law.damping > 0.0 and not low >= border * border
    if weak:
        if not weighed:
            heavy = weigh(s.weight, s.J, s.e, s.ahead, s.f, s.a)
        weighed = True
        begin_anew(given.counts[1], own.basis)
        modes(s.J, own.basis, s.W, s.U, s.sv)
    for k in range(m):
        s.lost[k], s.pull[k] = 0.0, 0.0
    if weak:
        beyond = judge_modes(law, task, look, s, limits, h, own, heavy)
        damped = 1.0 * take_out(s.J, s.W, s.U, s.V, s.lost, s.f, s.G)
    else:
        remember(state, False, False, h)
    blocked = feed_back(law, s, limits, now, heavy, beyond)
    joints = JointMotion(s.move, s.null, s.x1, s.x2, s.x)
    prepare(law, inverse_of(s), target_of(s), rate, h, joints)
    if law.code >= CA:
        if blocked and law.code == AA and law.reading != AT_RATE:  # no joint takes this step: no second order
            for i in range(n):
                s.x1[i] *= 0.0 if law.reading == AT_STEP else 1.0
                s.x2[i] = 0.0
        bend(task, look, s, weighed)
    if weighed:  # all is weighed by now
        for k in range(m):
            s.weight[k] = 1.0 if s.weight[k] > 0.0 else 0.0
    ratio = h / state[STATE.period] if state[STATE.start] == RUNNING else 0.0
    command(law, inverse_of(s), target_of(s), rate, own.memory, h, ratio, joints)
    if damped > 0.0 and law.mode != CLIP:
        along_lost(s.V, s.lost, s.xk, s.x, 1.0)
        down_slopes(s.W, s.V, s.sv, s.pull, s.x, 1.0)
        if law.code == CV:  # what the next step extrapolates from
            along_lost(s.V, s.lost, s.xk, own.memory, 1.0)
    add_wishes(law, s, given, ratio, h, own.memory)
    return damped


@inline
def by_rule(law, rule, task, look, weights, s, given, own, now):
    """Rates that a solver's rule wants, to s.x: its step to where the target will be."""
    d = task.desk
    leaned = False
    for i in range(s.g.shape[0]):
        leaned = leaned or s.g[i] != 0.0
    if leaned or not task.plain():  # else it is the one that `take_stock` filled
        task.jacobian(look)
    copy(weights, d.w)
    copy(s.at, d.q)
    copy(own.memory, d.x)
    d.spent[0], d.spent[1] = 0.0, np.inf
    code = rule.step(task, look)
    copy(d.x, own.memory)
    for i in range(s.x.shape[0]):
        s.x[i] = s.g[i] + (d.dq[i] / now.h if code != SINGULAR_STEP else 0.0)
    return 0.0


@inner
def copy_rows(source, target):
    """target[:] = source."""
    for i in range(source.shape[0]):
        copy(source[i], target[i])


def wanted(law, rule, task, look, weights, s, given, own, now):
    """Rates that the law or the rule wants."""
    how = by_law if isinstance(rule, Published) else by_rule
    return how(law, rule, task, look, weights, s, given, own, now)


@overload(wanted, jit_options=INLINE)
def _wanted(law, rule, task, look, weights, s, given, own, now):
    how = by_law if rule.instance_class is Published else by_rule
    return lambda law, rule, task, look, weights, s, given, own, now: how(
        law, rule, task, look, weights, s, given, own, now
    )


def lean(law, rule, s, limits, wish, rate, h):
    """What comes before a step is asked for, see `lean_over`."""
    how = lean_not if isinstance(rule, Published) else lean_over
    return how(law, rule, s, limits, wish, rate, h)


@overload(lean, jit_options=INLINE)
def _lean(law, rule, s, limits, wish, rate, h):
    how = lean_not if rule.instance_class is Published else lean_over
    return lambda law, rule, s, limits, wish, rate, h: how(law, rule, s, limits, wish, rate, h)
