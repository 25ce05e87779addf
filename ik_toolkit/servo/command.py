"""The joint rates that a method commands before limits are applied, for published laws and for solvers' iterations."""

# Pyright does not know that numba calls the overload below and takes its options from a dict.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import math
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from ..compile.jit import INLINE, inline
from ..kernel.limits import LIMIT
from ..kernel.null_space import is_wide
from ..kernel.records import copy
from ..kernel.search import SINGULAR_STEP
from ..kernel.vectors import add_multiple, any_of, clear, dot
from .constrained_step import MODE, Allowed
from .laws import (
    EASING,
    LAW,
    READING,
    CorrectionLimits,
    JointMotion,
    PseudoInverse,
    TargetMotion,
    command,
    ease,
    factor,
    gram,
    invert,
    prepare,
)
from .null_space_motion import away_from_limits, bend, into_null_space, scale_secondary, weigh
from .singular_directions import judge_modes, remember, straight_along_axis
from .singular_step import WEAK, along_lost, down_slopes, hold_back, modes, take_out

# Largest share s of the null-space velocity that method ca (classical, acceleration level) removes in one step, for stability.
# The characteristic polynomial z^2 - (1 - 3/2 s) z - s/2 is stable for s < 1, and best at s = 2/3 (largest root 0.58).
# Method cv (velocity level) has the same polynomial in s = kappa h (Patko and Zelei, 2019).
SHARE = 2.0 / 3.0
# [1/s] rate at which the null-space velocity converges to the desired velocity; with a lower rate joints run into limits
TAKEN_UP = 20.0
# [rad/s or arm reaches/s] desired null-space speed at which the rate TAKEN_UP is halved; it falls to 0 with the speed, so that the
# motion ends smoothly
LITTLE = 0.004
# Shares of the joints' speed and acceleration limits used to close an error; following a moving target may need what remains.
FAST, BRISK = 1.0, 0.5


class Moment(NamedTuple):
    """What may change with every step: how many inequality constraints apply, and how long it lasts."""

    rows: int  # number of inequality constraints
    h: float  # [s] length of the step
    ratio: float  # h over the length of the last step, 0 if there is no earlier command to continue from


class Published(NamedTuple):
    """Selects the control laws (cv, av, ca, aa, aad) in the compiled loop, where a solver would pass the class of its iteration."""

    unused: float


@inline
def target_of(s):
    """Return the target's error and motion as a `TargetMotion`; its arrays are part of s, the scratch arrays of a step."""
    return TargetMotion(s.e, s.ahead, s.f, s.a, s.bias)


@inline
def inverse_of(s):
    """Return the Jacobian and the factor for its pseudo-inverse as a `PseudoInverse`; its arrays are part of s (`Bench`)."""
    return PseudoInverse(s.J, s.G, s.H, s.y, s.t)


@inline
def desired_null_velocity(law, s, limits, wish, base):
    """Write to s.g (n,) the desired null-space velocity; return False, with s.g undefined, if there is none.

    It is the sum of the motions away from limits, towards a posture and down the caller's cost. This sum is projected into the null
    space of the task, and scaled down to at most half of the margin between the rates base (n,) and the rate bounds. law: the
    method and its gains (`Law`); s: scratch arrays of the step (`Bench`); limits (4, n): lower, upper, speed, acceleration; wish
    (3, n): posture, gain towards it [1/s], additional joint velocity.
    """
    n, m = s.J.shape
    if law.mode == MODE.clip:
        return False
    posture, gain, velocity = wish[0], wish[1], wish[2]
    for i in range(n):
        s.g[i] = gain[i] * (posture[i] - s.at[i]) + velocity[i]
    if law.avoid > 0.0:
        away_from_limits(s.at, limits, law.avoid, s.g)
    if not any_of(s.g):
        return False
    into_null_space(s.J, m, s.G, s.y, s.t, s.g, s.v)
    along_lost(s.V, s.lost, s.xk, s.g, 0.0)
    down_slopes(s.W, s.V, s.sv, s.pull, s.g, 0.0)
    scale_secondary(s.g, base, s.floor, s.roof)
    return True


@inline
def unshifted(law, s, limits, wish, rate, h):
    """Return False: s.at is not shifted for a published law, which adds its secondary motion later (`add_secondary_motion`)."""
    return False


@inline
def shift_by_secondary(law, s, limits, wish, rate, h):
    """Shift s.at (n,), where error and Jacobian are evaluated, by one step of secondary motion in the null space.

    The solver's iteration then also corrects what that motion does to the tip. Returns whether there was a secondary motion; s.g
    (n,) receives its rate, or zeros.
    """
    if law.mode != MODE.clip:
        factor(s.J, s.J.shape[1], law.damping, s.G, s.y)
        if desired_null_velocity(law, s, limits, wish, rate):
            add_multiple(s.at, h, s.g, rate.shape[0])
            return True
    clear(s.g)
    return False


@inline
def add_secondary_motion(law, s, given, ratio, h, memory):
    """Add the secondary motion in the null space to the commanded rates s.x (n,) of a published law.

    Methods cv and ca extrapolate from their previous command, `memory` (n,). The motion is added to `memory` as well, because the
    tip would leave its path if only part of the command were extrapolated. At acceleration level (methods ca, aa, aad) the present
    null-space velocity converges to the desired velocity, at a rate that fades to 0 with the desired speed. given: `Settings`; h
    [s]: this step; ratio: h over the length of the last step.
    """
    if desired_null_velocity(law, s, given.limits, given.wish, s.x):
        n, kept, share = s.g.shape[0], 0.0, 1.0
        if law.code >= LAW.ca:
            size = math.sqrt(dot(s.g, s.g, n))
            # The method itself already damps the null-space velocity at the rate law.null.
            rate = max(min(TAKEN_UP, (SHARE if law.code == LAW.ca else 1.0) / h), law.null)
            share = min(h * rate, 1.0) * size / (size + LITTLE)
            add_multiple(s.g, law.null / rate - 1.0, s.null, n)
        if law.code == LAW.cv or law.code == LAW.ca:
            kept = share / h if law.code == LAW.ca else share
            share *= 1.0 + 0.5 * ratio
        add_multiple(s.x, share, s.g, n)
        add_multiple(memory, kept, s.g, n)


@inline
def feed_back(law, s, limits, now, heavy, beyond):
    """Shrink the error to be corrected (s.e, s.ahead), so that the joints can brake within their limits before it is zero.

    law: the method and its gains (`Law`); s: scratch arrays of the step (`Bench`); limits (4, n): lower, upper, speed,
    acceleration; now: `Moment`; heavy: largest weight of an error; beyond: whether the target is out of reach. Returns whether
    joint limits or inequality constraints block the joint motion that would close the error.
    """
    n, m = s.J.shape
    if beyond:
        hold_back(s.U, s.sv, s.lost, heavy, s.e, s.ahead, s.f, s.y)
    limited = law.mode != MODE.clip and law.code >= LAW.ca
    for i in range(n):
        limited = limited or limits[LIMIT.acceleration, i] < np.inf
    if not limited:
        return False
    # The error along singular directions that are removed from the task is left out, because no other direction can close it.
    size, gone = dot(s.e, s.e, m), 0.0
    for k in range(m):
        if s.lost[k] > 0.0:
            gone += dot(s.U[k], s.e, m) ** 2
    curved = heavy * math.sqrt(max(size - gone, 0.0)) if size > WEAK.close * WEAK.close else 0.0
    fast, quick = (0.5, 0.5) if law.mode == MODE.clip else (FAST, BRISK)
    allowed = Allowed(s.floor, s.roof, s.planes, s.edges, now.rows if law.mode != MODE.clip else -1)
    return ease(
        law, inverse_of(s), target_of(s), now.h, s.at, limits, allowed, CorrectionLimits(fast, quick, curved), s.x
    )


@inline
def bend_as_allowed(law, s, rate, blocked):
    """Shorten the joint rates at which dJ/dt is evaluated for this step (s.x2, and s.x1 for reading 3) to what limits allow.

    For rates that the joints cannot reach, the terms with dJ/dt are large and wrong: two hands lost their grip by up to 20 mm.
    rate (n,): present joint rates; blocked: whether limits block the correction of the error; s.x2 then becomes 0.
    """
    share = 1.0
    for i in range(rate.shape[0]):
        change = s.x2[i] - rate[i]
        most = law.gamma * ((s.roof[i] if change > 0.0 else s.floor[i]) - rate[i])
        if change * change > most * change:
            share = min(share, max(most / change, 0.0))
    for i in range(rate.shape[0]):
        s.x2[i] = 0.0 if blocked else rate[i] + share * (s.x2[i] - rate[i])
        if law.reading == READING.at_step:
            s.x1[i] = s.x2[i]


@inline
def by_law(law, rule, task, look, weights, s, given, own, now):
    """Write to s.x (n,) the joint rates that a published tracking method commands.

    law: the method and its gains (`Law`); task, look: the compiled problem and its evaluation at the joint values s.at; s: scratch
    arrays of the step (`Bench`); given: inputs of the tracker (`Settings`); own: its state (`Carried`); now: `Moment`. Returns the
    number of singular directions removed from the task, or in mode clip the squared damping of the pseudo-inverse.
    """
    n, m = s.J.shape
    limits, rate, state, h = given.limits, own.motion[1], own.state, now.h
    border = EASING.region * law.damping
    damped, weak, weighed, beyond, heavy = 0.0, False, False, False, 0.0 if law.mode == MODE.clip else 1.0
    if law.mode == MODE.clip:
        damped = factor(s.J, m, law.damping, s.G, s.y)
    else:
        # With fewer joints than errors not all errors can be closed, so their weights decide which pose is closest.
        wide = is_wide(s.J, m)
        weighed = not wide
        if weighed:
            heavy = weigh(s.weight, s.J, s.e, s.ahead, s.f, s.a)
        gram(s.J, m, wide, 0.0, s.G)
        low = invert(s.G, m if wide else n, s.y)
        weak = law.damping > 0.0 and (not low >= border * border or straight_along_axis(task, look, s, own.away))
    if weak:
        if not weighed:
            heavy = weigh(s.weight, s.J, s.e, s.ahead, s.f, s.a)
        weighed = True
        # An error with slack is not in the task, and `by_modes` needs its axis as a task direction of its own. The directions found
        # at the last singular pose may mix axes, so the decomposition does not begin from them.
        if any_of(given.counts[1]):
            clear(own.basis[0])
        modes(s.J, own.basis, s.W, s.U, s.sv)
    clear(s.lost)
    clear(s.pull)
    if weak:
        beyond = judge_modes(law, task, look, s, limits, h, own, heavy)
        damped = 1.0 * take_out(s.J, s.W, s.U, s.V, s.lost, s.f, s.G)
    else:
        remember(state, False, False, h)
    blocked = feed_back(law, s, limits, now, heavy, beyond)
    joints = JointMotion(s.move, s.null, s.x1, s.x2, s.x)
    prepare(law, inverse_of(s), target_of(s), rate, h, joints)
    if law.code >= LAW.ca:
        if law.mode != MODE.clip and law.code == LAW.aa and law.reading != READING.at_rate:
            bend_as_allowed(law, s, rate, blocked)
        bend(task, look, s, weighed)
    if weighed:  # The Jacobian, errors and target motion have been multiplied by the weights, so the weights become 1.
        for k in range(m):
            s.weight[k], s.heavy[k] = 1.0 if s.weight[k] > 0.0 else 0.0, given.counts[3][k]
    command(law, inverse_of(s), target_of(s), rate, own.memory, h, now.ratio, joints)
    if damped > 0.0 and law.mode != MODE.clip:
        along_lost(s.V, s.lost, s.xk, s.x, 1.0)
        down_slopes(s.W, s.V, s.sv, s.pull, s.x, 1.0)
        # Method cv extrapolates from the command in own.memory, so that one, too, gets the rates along the directions removed.
        if law.code == LAW.cv:
            along_lost(s.V, s.lost, s.xk, own.memory, 1.0)
    add_secondary_motion(law, s, given, now.ratio, h, own.memory)
    return damped


@inline
def by_rule(law, rule, task, look, weights, s, given, own, now):
    """Write to s.x (n,) the joint rates of one solver iteration: its step towards the target's next pose, divided by h.

    rule: the solver's iteration; weights (n,): joint weights; other arguments are those of `by_law`. Returns 0, because no
    directions are removed from the task.
    """
    d = task.desk
    if any_of(s.g) or not task.plain():  # Otherwise the Jacobian computed at the start of the step is still valid.
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


def chosen(rule, for_law, for_solver):
    """Return the first of two compiled functions for a control law (rule: `Published`), the second for the iteration of a solver.

    This version runs without numba, which compiles the overload below instead.
    """
    return for_law if isinstance(rule, Published) else for_solver


@overload(chosen, jit_options=INLINE)
def _chosen(rule, for_law, for_solver):
    if rule.instance_class is Published:
        return lambda rule, for_law, for_solver: for_law
    return lambda rule, for_law, for_solver: for_solver
