"""Which joint rates the limits allow now, so that every later state can still brake before a limit (viability).

A joint at q moves at rate v. A step of h takes it to the rate w and to q + h ((1 - gamma) v + gamma w). In between it moves
straight where gamma is 1 (velocity level), else along the parabola through both ends that begins with v; the bounds below
hold for that motion, not for its samples alone. Braking is w = max(0, v - a h) in every step. Whatever lengths up to `late`
later steps have, it covers at most (`stopping`)

    gamma = 1    v^2 / 2a
    else         v^2 / 2a + a late^2 / 8   for v above a late / 2, below that v late / 2   (gamma < 1/2: + (1/2 - gamma) v late)

since a step h from v to w covers no more than the difference of the two. (At velocity level the sum over steps is a lower sum
of the integral. Else a step is a trapezoid, and its last one, to rest, the longer the worse.) A state is viable when this is
no more than the way left to the limit, and `joint_box` lets only such states follow: no later step has to break one limit to keep
another.

One step of joints that move to given values as fast as their limits allow, or along a motion that is known.

One step and the full brake after it, as a path: what must be free of contact before the step is taken.
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.jit import cached, compiled, dual, inline, inner, jit, shared
from ..kernel.clearance import speed_and_growth, travelled
from ..kernel.records import Array

# Bits of `code`: why a joint did not move as commanded.
POSITION, VELOCITY, ACCELERATION, HELD, RECOVERING, ROW, CALMED = 1, 2, 4, 8, 16, 32, 64
ROUNDING = 4e-16  # margin before a limit, relative to the numbers added in a step: half a unit in the last place each
SPARE = 1e-13  # share of the remaining distance kept as a margin: braking over some hundred steps accumulates that much rounding
NOISE = 1e-12  # [rad, or reaches] by which a state may violate viability before it counts as recovering
UNLIMITED = 1.0  # speed of a joint without a limit [rad/s, or reaches/s], where one is needed for comparison
SHARE = 0.1  # of the speed limit (or of 1 rad/s, 1 reach/s) at which a joint outside its limits comes back
SWING = 0.05  # of its speed limit, beyond which a joint moves at speed, to one side or the other
# Turns from one side to the other that make a swing, when less than WINDOW [s] apart; it ends after HOLD [s] without one. Of four
# turns within 0.1 s, which are chatter, two are less than WINDOW apart, and the next ones take WINDOW each:
SWINGING = 2.0
WINDOW, HOLD = 0.05, 0.1
LASTING = 0.2  # [s] after the last hindrance but this one in which joints are calmed
CALM, GROWTH = 0.75, 10.0  # [1/s] by which joints that swing gain speed, in shares of their limit and of their speed


@compiled
class RateBox(NamedTuple):
    """Lowest and highest next rate of each joint, arrays (n,)."""

    floor: Array
    roof: Array
    why_low: Array  # bits of the limits that set the lowest ...
    why_top: Array  # ... and the highest


@inline
def box_of(s):
    """The box of a bench."""
    return RateBox(s.floor, s.roof, s.why_low, s.why_top)


@shared
def bending(gamma):
    """How much harder a joint accelerates between samples than its rates say, where the parabola begins with the last rate."""
    return 2.0 * gamma if 0.5 < gamma < 1.0 else 1.0


@dual
def stopping(v, gamma, a, late):
    """Longest way to rest from the rate v >= 0 with at most `a`, in steps of any lengths up to `late`."""
    if gamma == 1.0:
        return v * v / (2.0 * a)
    way = 0.5 * v * late if v <= 0.5 * a * late else v * v / (2.0 * a) + 0.125 * a * late * late
    return way + max(0.5 - gamma, 0.0) * v * late


@dual
def approach(distance, v, gamma, h, a, late):
    """Highest next rate after which the joint can stop within `distance`; below 0 when it cannot even now (moving at v)."""
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
    """Distance left to a limit (sign 1: upper, -1: lower), negative outside; minus the margin for rounding."""
    if abs(limit) == np.inf:
        return np.inf
    way = sign * (limit - q)
    if way < -NOISE:
        return way
    return max(way * (1.0 - SPARE) - ROUNDING * (abs(limit) + abs(q)), 0.0)


@dual
def towards(way, v, speed, gamma, h, a, late):
    """Highest next rate towards a limit `way` ahead; outside (way < 0) it is the one that brings the joint back."""
    if way >= 0.0:
        return approach(way, v, gamma, h, a, late)
    back = approach(-way, -v, gamma, h, a, late)
    return -min(max(back, 0.0), SHARE * min(speed, 1.0))


@dual
def joint_box(q, v, lower, upper, speed, a, gamma, h, late):
    """Lowest and highest next rate of a joint, and the bits of the limits that set them.

    Always an interval: where the limits contradict each other (a start outside of them, limits that changed) a single rate,
    which keeps the acceleration, then the speed, then goes back inside; its bits have RECOVERING.
    """
    bend = bending(gamma)
    a = a / bend
    rise, fall = v + a * h, v - a * h
    fast, slow = speed, -speed
    if bend > 1.0:  # the parabola ends beyond w
        fast, slow = min(fast, (speed + (bend - 1.0) * v) / bend), max(slow, ((bend - 1.0) * v - speed) / bend)
        if slow > fast:  # too fast for a limit near 0: no rate keeps it, rest does soonest
            fast, slow = 0.0, 0.0
    ahead, behind = way_to(upper, q, 1.0), way_to(lower, q, -1.0)
    top_p = towards(ahead, v, speed, gamma, h, a, late)
    low_p = -towards(behind, -v, speed, gamma, h, a, late)
    top, low = min(top_p, fast, rise), max(low_p, slow, fall)
    why_top = ACCELERATION if top == rise else VELOCITY if top == fast else POSITION
    why_low = ACCELERATION if low == fall else VELOCITY if low == slow else POSITION
    if ahead < 0.0 or behind < 0.0:
        why_top, why_low = why_top | RECOVERING, why_low | RECOVERING
    if low > top:
        miss = low - top
        top, low = min(fast, rise), max(slow, fall)
        if low > top:
            w = fall if fall > fast else rise
        else:
            w = low if top_p < low else top if low_p > top else min(max(0.0, low), top)
        # Rounding can empty the interval: it becomes a point that contains what it should.
        why = POSITION | ACCELERATION | (RECOVERING if miss * h > NOISE else 0)
        return w, w, why, why
    return low, top, why_low, why_top


@dual
def boxes(q, rate, limits, gamma, h, late, box):
    """`joint_box` of every joint; limits (4, n): lower, upper, speed, acceleration. True when one of them is recovering."""
    recovering = False
    for i in range(q.shape[0]):
        box.floor[i], box.roof[i], box.why_low[i], box.why_top[i] = joint_box(
            q[i], rate[i], limits[0, i], limits[1, i], limits[2, i], limits[3, i], gamma, h, late
        )
        recovering = recovering or (box.why_top[i] & RECOVERING) > 0
    return recovering


@shared
def watch(swings, rate, x, size, gamma, h):
    """Count how often in a row each joint turns back at speed, that of its move in a step from rate to x, see `calm`."""
    for i in range(x.shape[0]):
        swings[1, i] += h
        v = (1.0 - gamma) * rate[i] + gamma * x[i]
        side = 0.0 if abs(v) <= SWING * size[i] else 1.0 if v > 0.0 else -1.0
        turned = side * swings[2, i] < 0.0
        if side != 0.0:
            swings[2, i] = side
        if turned:
            swings[0, i] += 1.0
            swings[1, i] = 0.0
        elif swings[1, i] > (WINDOW if swings[0, i] < SWINGING else HOLD):
            swings[0, i] = 0.0


@dual
def narrow(i, least, most, box):
    """Narrow the box (in place) of joint i to the rates from least to most, as far as it has such."""
    low, top = box.floor[i], box.roof[i]
    floor, roof = min(max(least, low), top), max(min(most, top), low)
    if floor > low:
        box.floor[i], box.why_low[i] = floor, CALMED | (box.why_low[i] & RECOVERING)
    if roof < top:
        box.roof[i], box.why_top[i] = roof, CALMED | (box.why_top[i] & RECOVERING)


@dual
def calm(rate, size, swings, h, box):
    """Narrow the box (in place) of joints that swing to rates gained gradually, from rest on after a turn; braking is free.

    Without it 89 of 198 random streams chattered (scripts/benchmarks/servo_random.py).
    """
    for i in range(rate.shape[0]):
        if swings[0, i] < SWINGING:
            continue
        gain, more = CALM * size[i] * h, 1.0 + GROWTH * h
        narrow(i, more * min(rate[i], 0.0) - gain, more * max(rate[i], 0.0) + gain, box)


@dual
def clip(x, box, code):
    """Clip the wanted rates x (in place) to their box, each joint separately; code (n,) receives what held a joint back."""
    hit = False
    for i in range(x.shape[0]):
        code[i] = box.why_top[i] & RECOVERING
        if x[i] > box.roof[i]:
            x[i], code[i] = box.roof[i], box.why_top[i]
        elif x[i] < box.floor[i]:
            x[i], code[i] = box.floor[i], box.why_low[i]
        hit = hit or code[i] > 0
    return hit


@dual
def move(q, rate, x, gamma, h):
    """Take the step: q and rate (in place) to the next rate x."""
    for i in range(q.shape[0]):
        q[i] += h * x[i] if gamma == 1.0 else h * ((1.0 - gamma) * rate[i] + gamma * x[i])
        rate[i] = x[i]


@jit
def advance(q, rate, x, gamma, h, late, limits, code):
    """Step towards the wanted rates x, every joint clipped separately (x = 0: brake); True when a limit held one back."""
    n = q.shape[0]
    ends, why = np.empty((2, n)), np.empty((2, n), np.uint8)
    box = RateBox(ends[0], ends[1], why[0], why[1])
    boxes(q, rate, limits, gamma, h, late, box)
    hit = clip(x, box, code)
    move(q, rate, x, gamma, h)
    return hit


HELD_BACK = 0.1  # share of an acceleration limit that a known motion leaves for making up for what is missing
UNKNOWN = np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0))  # no motion: times, points and rates of `travel`


@cached
def travel(q, rate, goal, times, points, rates, time, gamma, h, late, limits, code):
    """Step q and rate (n,) in place by h [s] towards rest at goal (n,), inside limits (4, n).

    Along a known motion, as it is at `time` [s], until it ends: times (K,), points and rates (K, n), cubic between. Else by
    themselves. Later steps take as long, and at most `late` [s] before limits. code (n,) receives what held a joint back.
    Returns the least time [s] left after it, at full speed; -1, and nothing done, where a joint may not move or not go there.
    Kernel units.
    """
    n = q.shape[0]
    for j in range(n):
        if limits[2, j] == 0.0 or limits[0, j] == limits[1, j] or goal[j] < limits[0, j] or goal[j] > limits[1, j]:
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
    """Least time [s] from q to goal at full speed."""
    left = 0.0
    for j in range(q.shape[0]):
        left = max(left, abs(goal[j] - q[j]) / (limits[2, j] if limits[2, j] < np.inf else UNLIMITED))
    return left


@inner
def go_straight(q, rate, goal, gamma, h, limits, x):
    """Rates x (n,) towards rest at goal: the slowest joint as fast as it can, the others in proportion.

    So from rest the way is straight. Each joint brakes in time to rest there.
    """
    left = time_left(q, goal, limits)
    for j in range(q.shape[0]):
        way = goal[j] - q[j]
        most = approach(abs(way), rate[j] if way > 0.0 else -rate[j], gamma, h, limits[3, j] / bending(gamma), h)
        x[j] = math.copysign(min(abs(way) / left if left > 0.0 else 0.0, most), way)


@inner
def head_for(q, rate, known, time, gamma, h, limits, x):
    """Rates x (n,) to where a known motion (times, points, rates) is at `time`.

    What is missing is made up for as fast as HELD_BACK of the acceleration can end it, at once where there is no such
    limit: by half where the rate alone does not set the next place, as whole corrections of a trapezoid turn round in every step.
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
        most = approach(abs(missing), 0.0, 1.0, h, HELD_BACK * limits[3, j], h)
        x[j] = speed + math.copysign(min(share * abs(missing) / (gamma * h), most), missing)


@cached
def brake(first, gamma, h, late, limits, Q, R, L):
    """Continue a motion by braking fully; returns the number of pieces of h [s] (1 or more) until all rests, or -1.

    Rows of Q, R (K, n): joint values and rates between the pieces, given up to row `first`; of L (K, n): how far each joint
    has gone by then. Each joint brakes as `advance` brakes it when no rate is wanted, inside limits (4, n),
    with later steps of up to `late` [s]. One unit a joint.
    """
    n = Q.shape[1]
    x, code, now, speed = np.empty(n), np.empty(n, np.uint8), Q[first].copy(), R[first].copy()
    for j in range(n):
        L[0, j] = 0.0
    for k in range(Q.shape[0]):
        moving = False
        for j in range(n):
            if k > first:
                Q[k, j], R[k, j] = now[j], speed[j]
            if k > 0:
                start, change = speed_and_growth(Q, R, k - 1, j, gamma, h)
                L[k, j] = L[k - 1, j] + travelled(start, change, 1.0)
            moving = moving or R[k, j] != 0.0
        if k >= first:
            if k > 0 and not moving:
                return k
            x[:] = 0.0
            advance(now, speed, x, gamma, h, late, limits, code)
    return -1
