"""Bounds on the next rate of each joint such that it can always brake before its position limit (viability kernel).

A joint at q moves at rate v. A step of h [s] takes it to the rate w and to q + h ((1 - gamma) v + gamma w). Within the step its
value changes at a constant rate if gamma is 1 (velocity level), else along the parabola through both ends that begins with the
rate v. The bounds hold for this whole motion, not only at the samples. Braking means w = max(0, v - a h) in every step, with the
deceleration a. Whatever lengths up to `late` [s] the later steps have, a braking joint covers at most the distance

    gamma = 1    v^2 / 2a
    else         v^2 / 2a + a late^2 / 8   for v above a late / 2, below that v late / 2
                 plus (1/2 - gamma) v late for gamma below 1/2

which `stopping` returns. The reason is that a braking step from v to w covers no more than the difference between the stopping
distances from v and from w. (At velocity level the steps are a lower sum of the integral of v; else they are trapezoids, and a
long last step is the worst case.) A state is viable if its stopping distance is no longer than the distance to the limit.
`joint_box` only allows rates that lead to viable states, so no later step has to break one limit to keep another.
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.jit import cached_small, compiled, dual, inline, inner, jit, shared
from ..kernel.limits import LIMIT
from ..kernel.records import Array

# [rad/s or arm reaches/s] speed assumed for a joint without a speed limit where joints are compared; set by hand
UNLIMITED = 1.0
# an empty motion (times, points, rates), with which `travel` moves straight to the goal
UNKNOWN = np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0))


@compiled
class LimitBits(NamedTuple):
    """Bits that say why a joint did not move as commanded: which of its limits was active, or what else."""

    position: int = 1
    velocity: int = 2
    acceleration: int = 4
    held: int = 8  # the command was not finite
    recovering: int = 16  # the joint was outside its limits
    row: int = 32  # an inequality limits the joint, such as that of an obstacle
    calmed: int = 64  # the joint oscillated, so that its acceleration was limited


@compiled
class LimitMargins(NamedTuple):
    """Margins to joint limits: for rounding, for corrections, and for joints that return from outside their position limits."""

    rounding: float = 4e-16  # margin to a limit, as a share of |limit| + |q|, for rounding in one step
    spare: float = 1e-13  # share of the distance to a limit that is kept for the rounding of some hundred braking steps
    # largest speed of a joint that returns into its position limits, as a share of its speed limit or, if less, of 1 rad/s (1 arm
    # reach/s)
    inwards: float = 0.1
    # [rad or arm reaches] A joint that cannot stop inside its limits, by more than this, counts as recovering; rounding is smaller.
    noise: float = 1e-12
    # share of the acceleration limit that is kept for correcting deviations from a planned motion; set by hand
    held_back: float = 0.1


@compiled
class OscillationThresholds(NamedTuple):
    """Thresholds by which a joint counts as oscillating, and limits on the acceleration of such a joint.

    Without these limits, 89 of 198 random target streams made joints chatter (scripts/benchmarks/servo_random.py).
    """

    slow: float = 0.05  # Only motions faster than this share of the speed limit count as part of an oscillation.
    reversals: float = 2.0  # number of consecutive reversals after which a joint counts as oscillating
    window: float = 0.05  # [s] longest time between two such reversals, one after the other
    hold: float = 0.1  # [s] time without a reversal after which a joint no longer counts as oscillating
    # [s] time for which oscillating joints are slowed after a limit or a singular pose has hindered them
    lasting: float = 0.2
    # [1/s] An oscillating joint may gain speed at no more than this factor times its speed limit, plus `growth` times its speed.
    gain: float = 0.75
    # [1/s] factor on the present speed of an oscillating joint in the bound on how fast it may gain speed
    growth: float = 10.0


BIT, MARGIN, CALMING = LimitBits(), LimitMargins(), OscillationThresholds()


@compiled
class RateBox(NamedTuple):
    """Bounds on the next rate of each joint, and which limits set them; arrays (n,)."""

    floor: Array  # lowest next rates
    roof: Array  # highest next rates
    why_low: Array  # bits (`LimitBits`) of the limits that set the lowest rate, `floor`
    why_top: Array  # bits of the limits that set the highest rate, `roof`


@inline
def box_of(s):
    """Return the bounds on the joint rates as a `RateBox`; its arrays are part of s, the scratch arrays of a step (`Bench`)."""
    return RateBox(s.floor, s.roof, s.why_low, s.why_top)


@shared
def bending(gamma):
    """Return the ratio of the peak acceleration in a step to (new rate - last rate) / h.

    It is 2 gamma for gamma between 1/2 and 1, where the joint's parabola ends at a rate beyond the new rate, else 1.
    """
    return 2.0 * gamma if 0.5 < gamma < 1.0 else 1.0


@dual
def stopping(v, gamma, a, late):
    """Return the longest stopping distance from v >= 0 at deceleration a in steps up to late [s]; gamma: new rate's weight."""
    if gamma == 1.0:
        return v * v / (2.0 * a)
    way = 0.5 * v * late if v <= 0.5 * a * late else v * v / (2.0 * a) + 0.125 * a * late * late
    return way + max(0.5 - gamma, 0.0) * v * late


@dual
def approach(distance, v, gamma, h, a, late):
    """Return the highest next rate after which a joint can still stop within `distance`.

    v: present rate towards the end of that distance; gamma: weight of the next rate in a step; h [s]: this step; a: deceleration;
    late [s]: longest later step. The result is negative if the joint can no longer stop within the distance.
    """
    if distance == np.inf:
        return np.inf
    room = distance - h * (1.0 - gamma) * v
    if room <= 0.0:
        return room / (gamma * h) if h > 0.0 else 0.0
    if gamma == 1.0:
        return 2.0 * room / (h + math.sqrt(h * h + 2.0 * room / a))
    slope = gamma * h + max(0.5 - gamma, 0.0) * late
    slow = room / (slope + 0.5 * late)
    if slow <= 0.5 * a * late:
        return slow
    room -= 0.125 * a * late * late
    return 2.0 * room / (slope + math.sqrt(slope * slope + 2.0 * room / a))


@dual
def way_to(limit, q, sign):
    """Return a joint's distance from q to a position limit (sign 1: upper, -1: lower), less a margin for rounding.

    The distance is negative if q is outside the limit.
    """
    if abs(limit) == np.inf:
        return np.inf
    way = sign * (limit - q)
    if way < -MARGIN.noise:
        return way
    return max(way * (1.0 - MARGIN.spare) - MARGIN.rounding * (abs(limit) + abs(q)), 0.0)


@dual
def towards(way, v, speed, gamma, h, a, late):
    """Return the highest next rate at which a joint can still stop at a position limit at the distance `way`.

    v: its present rate towards the limit; speed: its speed limit; gamma, h, a, late: as in `approach`. Outside the limit (way < 0)
    the result is not positive: the joint returns, at no more than the share MARGIN.inwards of its speed limit, and so that it can
    stop at the limit.
    """
    if way >= 0.0:
        return approach(way, v, gamma, h, a, late)
    back = approach(-way, -v, gamma, h, a, late)
    return -min(max(back, 0.0), MARGIN.inwards * min(speed, 1.0))


@dual
def joint_box(q, v, lower, upper, speed, a, gamma, h, late):
    """Return the lowest and highest next rate of one joint, and for each of the two the bits of the limits that set it.

    If the limits contradict each other (a start outside them, or limits that were changed), both rates are the best compromise.
    It keeps the acceleration limit first, then the speed limit, then moves back inside; its bits then include BIT.recovering.
    q, v: value and rate; gamma: weight of the next rate in the motion; h, late [s]: this step and the longest later one.
    """
    bend = bending(gamma)
    a = a / bend
    rise, fall = v + a * h, v - a * h
    fast, slow = speed, -speed
    if bend > 1.0:  # A joint ends the step faster than its next rate w; the bound on w makes that end keep the limit.
        fast, slow = min(fast, (speed + (bend - 1.0) * v) / bend), max(slow, ((bend - 1.0) * v - speed) / bend)
        # If the speed limit was lowered to near 0, no next rate keeps it; coming to rest is the quickest way back below the limit.
        if slow > fast:
            fast, slow = 0.0, 0.0
    ahead, behind = way_to(upper, q, 1.0), way_to(lower, q, -1.0)
    top_p = towards(ahead, v, speed, gamma, h, a, late)
    low_p = -towards(behind, -v, speed, gamma, h, a, late)
    top, low = min(top_p, fast, rise), max(low_p, slow, fall)
    why_top = BIT.acceleration if top == rise else BIT.velocity if top == fast else BIT.position
    why_low = BIT.acceleration if low == fall else BIT.velocity if low == slow else BIT.position
    outside = ahead < 0.0 or behind < 0.0
    if outside:
        why_top, why_low = why_top | BIT.recovering, why_low | BIT.recovering
    if low > top:
        miss = low - top
        top, low = min(fast, rise), max(slow, fall)
        if low > top:
            w = fall if fall > fast else rise
        else:
            w = low if top_p < low else top if low_p > top else min(max(0.0, low), top)
        # Rounding alone can also leave no rate between the bounds; a joint inside its limits then does not count as recovering.
        why = BIT.position | BIT.acceleration | (BIT.recovering if outside or miss * h > MARGIN.noise else 0)
        return w, w, why, why
    return low, top, why_low, why_top


@dual
def boxes(q, rate, limits, gamma, h, late, box):
    """Write the bounds on the next rate of every joint to `box` (RateBox).

    q, rate (n,): joint values and rates; limits (4, n): lower, upper, speed, acceleration; gamma: weight of the next rate in the
    motion; h, late [s]: this step and the longest later one.
    """
    for i in range(q.shape[0]):
        lower, upper, speed, a = limits[0, i], limits[1, i], limits[2, i], limits[3, i]
        found = joint_box(q[i], rate[i], lower, upper, speed, a, gamma, h, late)
        box.floor[i], box.roof[i], box.why_low[i], box.why_top[i] = found


@shared
def watch(swings, rate, x, size, gamma, h):
    """Update the counts by which oscillating joints are detected, after a step from the rates `rate` to x (n,).

    swings (3, n), in place: number of reversals in a row, time since the last reversal [s], and sign of the last motion that
    counts. size (n,): a speed for each joint; only motions faster than CALMING.slow times this speed count. `calm` uses the counts.
    """
    reversals, since, last = swings[0], swings[1], swings[2]
    for i in range(x.shape[0]):
        since[i] += h
        v = (1.0 - gamma) * rate[i] + gamma * x[i]
        side = 0.0 if abs(v) <= CALMING.slow * size[i] else 1.0 if v > 0.0 else -1.0
        turned = side * last[i] < 0.0
        if side != 0.0:
            last[i] = side
        if turned:
            reversals[i] += 1.0
            since[i] = 0.0
        elif since[i] > (CALMING.window if reversals[i] < CALMING.reversals else CALMING.hold):
            reversals[i] = 0.0


@dual
def narrow(i, least, most, box):
    """Narrow the rate bounds of joint i in `box` (RateBox) to the range from least to most; outside it, to the nearest bound."""
    low, top = box.floor[i], box.roof[i]
    floor, roof = min(max(least, low), top), max(min(most, top), low)
    if floor > low:
        box.floor[i], box.why_low[i] = floor, BIT.calmed | (box.why_low[i] & BIT.recovering)
    if roof < top:
        box.roof[i], box.why_top[i] = roof, BIT.calmed | (box.why_top[i] & BIT.recovering)


@dual
def calm(rate, size, swings, h, box):
    """Limit how fast an oscillating joint may gain speed, by narrowing its bounds in `box` (in place); braking stays free.

    rate (n,): present rates; size (n,): the joints' speed limits, or other speeds to compare with; swings: see `watch`.
    """
    reversals = swings[0]
    for i in range(rate.shape[0]):
        if reversals[i] < CALMING.reversals:
            continue
        gain, more = CALMING.gain * size[i] * h, 1.0 + CALMING.growth * h
        narrow(i, more * min(rate[i], 0.0) - gain, more * max(rate[i], 0.0) + gain, box)


@dual
def clip(x, box, code):
    """Clip the desired rates x (n,) in place to their bounds in `box` (RateBox), each joint on its own.

    code (n,) receives for each joint the bits of the limit that held it back, 0 for none.
    """
    for i in range(x.shape[0]):
        code[i] = box.why_top[i] & BIT.recovering
        if x[i] > box.roof[i]:
            x[i], code[i] = box.roof[i], box.why_top[i]
        elif x[i] < box.floor[i]:
            x[i], code[i] = box.floor[i], box.why_low[i]


@dual
def move(q, rate, x, gamma, h):
    """Take one step of h [s]: update q and rate (n,) in place for the next rates x (n,), whose weight in the motion is gamma."""
    for i in range(q.shape[0]):
        q[i] += h * x[i] if gamma == 1.0 else h * ((1.0 - gamma) * rate[i] + gamma * x[i])
        rate[i] = x[i]


@jit
def advance(q, rate, x, gamma, h, late, limits, code):
    """Take one step in place towards the desired rates x (n,), each joint clipped on its own inside limits (4, n).

    If x is 0, the joints brake. gamma: weight of the new rate; h [s]: this step; late [s]: longest later one. code (n,) receives
    the bits of the limits that held each joint back.
    """
    ends, why = np.empty((2, q.shape[0])), np.empty((2, q.shape[0]), np.uint8)
    box = RateBox(ends[0], ends[1], why[0], why[1])
    boxes(q, rate, limits, gamma, h, late, box)
    clip(x, box, code)
    move(q, rate, x, gamma, h)


@cached_small
def travel(q, rate, goal, times, points, rates, time, gamma, h, late, limits, code):
    """Step q and rate (n,) in place by h [s] towards rest at goal (n,), inside limits (4, n) [all rad or arm reaches].

    The joints first follow the given motion to its end: joint values `points` and rates (K, n) at times (K,) [s], cubic in between;
    `time` is the place on it after this step. Then, or if times is empty, they move straight to the goal. The limits also hold for
    later steps of up to late [s]; code (n,) receives the bits of the limits that held joints back. Returns the least time [s]
    left at full speed, or -1 if a joint is locked or its goal is outside its limits; then nothing has moved.
    """
    n = q.shape[0]
    for j in range(n):
        lower, upper = limits[LIMIT.lowest, j], limits[LIMIT.highest, j]
        if limits[LIMIT.speed, j] == 0.0 or lower == upper or not lower <= goal[j] <= upper:
            return -1.0
    x = np.empty(n)
    if times.shape[0] > 0 and time < times[times.shape[0] - 1]:
        head_for(q, rate, (times, points, rates), time, gamma, h, limits, x)
    else:
        go_straight(q, rate, goal, gamma, h, limits, x)
    advance(q, rate, x, gamma, h, late, limits, code)
    return time_left(q, goal, limits)


@shared
def time_left(q, goal, limits):
    """Return the least time [s] in which all joints can move from q to goal (n,) at full speed, without acceleration limits."""
    left = 0.0
    for j in range(q.shape[0]):
        speed = limits[LIMIT.speed, j]
        left = max(left, abs(goal[j] - q[j]) / (speed if speed < np.inf else UNLIMITED))
    return left


@inner
def go_straight(q, rate, goal, gamma, h, limits, x):
    """Write to x (n,) the rates that move the joints to goal along a straight line in joint space.

    The joint that needs longest moves at full speed, the others in proportion, and each brakes in time to stop at the goal. gamma:
    weight of the new rate in a step of h [s]; limits (4, n): lower, upper, speed, acceleration.
    """
    left = time_left(q, goal, limits)
    for j in range(q.shape[0]):
        way, a = goal[j] - q[j], limits[LIMIT.acceleration, j] / bending(gamma)
        most = approach(abs(way), rate[j] if way > 0.0 else -rate[j], gamma, h, a, h)
        x[j] = math.copysign(min(abs(way) / left if left > 0.0 else 0.0, most), way)


@inner
def head_for(q, rate, known, time, gamma, h, limits, x):
    """Write to x (n,) the rates that bring joints to the point of a given motion (times, points, rates) at `time` [s].

    The rates are those of the motion plus a correction of the distance to its point. The correction is limited to a rate that the
    share MARGIN.held_back of the acceleration limit can brake. If gamma is not 1, a step corrects only half of the distance,
    because whole corrections under the trapezoid rule overshoot in every step.
    """
    times, points, rates = known
    k = 1
    while times[k] < time:
        k += 1
    piece = times[k] - times[k - 1]
    f = (time - times[k - 1]) / piece
    share = 1.0 if gamma == 1.0 else 0.5
    for j in range(q.shape[0]):
        way, d0, d1 = points[k, j] - points[k - 1, j], piece * rates[k - 1, j], piece * rates[k, j]
        a, b = d0 + d1 - 2.0 * way, 3.0 * way - 2.0 * d0 - d1
        point, speed = ((a * f + b) * f + d0) * f + points[k - 1, j], ((3.0 * a * f + 2.0 * b) * f + d0) / piece
        missing = point - q[j] - h * ((1.0 - gamma) * rate[j] + gamma * speed)
        most = approach(abs(missing), 0.0, 1.0, h, MARGIN.held_back * limits[LIMIT.acceleration, j], h)
        x[j] = speed + math.copysign(min(share * abs(missing) / (gamma * h), most), missing)
