"""The compiled closed form of an arm with a spherical shoulder on a lift (prismatic joint).

It finds the branches inside the limits, over the values of the prismatic joint and of angles that are free.
"""

import math

import numpy as np

from ...compile.jit import inline, inner, shared
from ...kernel.kinematics import TAU
from ...kernel.records import copy
from .geometry import clamp, legal_turn
from .reach import (
    forearm,
    inspection_branch,
    inspection_branches,
    inspection_margin,
    inspection_nearest,
    level_arm,
    lift_intervals,
    shoulder_in_tool,
)

# Indices in the array p of the parameters of the inspection arm (spherical shoulder, elbow and wrist, on a prismatic lift). First
# come two transforms: base to shoulder axes (12) and tip to wrist axes (12). A4 and A6 are the lengths [m] from shoulder to axis 5
# and from axis 5 to axis 7. From JOINTS on, each of the six revolute joints has its index in q, its sign and its offset: theta =
# sign q + offset. From LIFT on, the prismatic joint has its index in q (-1: none), its sign, the choice of its value and a given
# value. NEARLY tells whether the arm has the structure only approximately.
A4, A6, JOINTS, LIFT, NEARLY = 24, 25, 26, 44, 48
NEAREST, GIVEN, MIDDLE = range(3)
# If at the first value of the prismatic joint no solution is inside the limits, SCAN values in each feasible interval are tried.
SCAN = 12
# A solution (branch) is computed at WINDOWS values of the prismatic joint. If it is outside the limits at all of them, the minima
# of its excess are searched for between them.
WINDOWS = 33
# A golden-section search takes CLOSING = 64 steps, after which its interval is as small as rounding: 0.618^64 = 4e-14.
GOLDEN, CLOSING = 0.6180339887498949, 64
# Angles are shifted into their limits by 2 pi k with |k| at most TURNS; joints with wider limits count as unlimited.
TURNS = 8
# Axes 1 and 4 count as parallel if two numbers are below LEVEL: the component of the wrist's z axis along axis 1, and the position
# error of `level_arm` as a share of the link lengths a4 + a6.
LEVEL = 1e-9


@shared
def wrist_pose(p, T, P):
    """Convert a target pose T (4, 4) of the tip to the pose P (12,) of the wrist in the axes of the shoulder at lift 0.

    The lift is the value of the prismatic joint that carries the arm. P has the rotation by rows, then the point [m]; p: the
    arm's parameters.
    """
    for r in range(3):
        b0, b1, b2 = p[3 * r], p[3 * r + 1], p[3 * r + 2]
        m0 = b0 * T[0, 0] + b1 * T[1, 0] + b2 * T[2, 0]
        m1 = b0 * T[0, 1] + b1 * T[1, 1] + b2 * T[2, 1]
        m2 = b0 * T[0, 2] + b1 * T[1, 2] + b2 * T[2, 2]
        for k in range(3):
            P[3 * r + k] = m0 * p[12 + k] + m1 * p[15 + k] + m2 * p[18 + k]
        P[9 + r] = b0 * T[0, 3] + b1 * T[1, 3] + b2 * T[2, 3] + p[9 + r] + m0 * p[21] + m1 * p[22] + m2 * p[23]


@inner
def joint_values(p, angles, d, box, q):
    """Fill q (n,) [rad or m] from the six revolute angles `angles` (6,) and the lift d [m], the value of the prismatic joint.

    Each angle is shifted by 2 pi k into its limits, as near the reference as possible. p: the arm's parameters; box (4, n): lower
    limits, upper limits, reference, weights. Returns the largest amount by which a limit is exceeded [rad or m], and the weighted
    squared distance from the reference.
    """
    worst, distance = 0.0, 0.0
    for k in range(6):
        i = int(p[JOINTS + 3 * k])
        x = p[JOINTS + 3 * k + 1] * (angles[k] - p[JOINTS + 3 * k + 2])
        q[i], broken = legal_turn(x, box[0, i], box[1, i], box[2, i])
        worst = max(worst, broken)
        distance += box[3, i] * (q[i] - box[2, i]) ** 2
    i = int(p[LIFT])
    if i >= 0:
        q[i], broken = clamp(p[LIFT + 1] * d, box[0, i], box[1, i])
        worst = max(worst, broken)
        distance += box[3, i] * (q[i] - box[2, i]) ** 2
    return worst, distance


@inline
def near_angles(p, box, near):
    """Fill near (6,) with the angles theta [rad] of the reference configuration; angles that the target leaves free keep them.

    p: the arm's parameters; box (4, n): lower limits, upper limits, reference [rad or m], weights.
    """
    for k in range(6):
        near[k] = p[JOINTS + 3 * k + 1] * box[2, int(p[JOINTS + 3 * k])] + p[JOINTS + 3 * k + 2]


@inner
def pick(p, P, d, box, near, moved, sols, q, best):
    """Find the best solution (branch) of a wrist pose P at a lift d [m]: inside the limits the nearest one, else the least outside.

    It is written to best (n,). Nearest is meant from the reference configuration. P (see `wrist_pose`) is first moved to the
    nearest pose in reach. Returns by how much a limit is exceeded [rad or m], and the weighted squared distance from the
    reference. p: the arm's parameters; box (4, n): limits, reference, weights; near (6,): values of angles that are free; moved
    (12,), sols (8, 6) and q (n,) are scratch.
    """
    copy(P, moved)
    inspection_nearest(moved, d, p[A4], p[A6])
    least, nearest = np.inf, np.inf
    for k in range(inspection_branches(moved, d, p[A4], p[A6], near, sols)):
        worst, distance = joint_values(p, sols[k], d, box, q)
        if worst < least or (worst == least and distance < nearest):
            least, nearest = worst, distance
            copy(q, best)
    return least, nearest


@inline
def lift_limits(p, box):
    """Return the lowest and highest lift [m], measured along axis 1, that the limits of the prismatic joint allow.

    p: the arm's parameters; box: lower limits, then upper limits of the joints.
    """
    i = int(p[LIFT])
    if p[LIFT + 1] > 0.0:
        return box[0, i], box[1, i]
    return -box[1, i], -box[0, i]


@shared
def nearest_lift(P, a4, a6, low, high):
    """Return the lift [m] in [low, high] at which the arm comes nearest to a wrist pose P that no lift in this range reaches.

    P: see `wrist_pose`; its orientation is kept. a4, a6: link lengths [m].
    """
    side = math.hypot(P[9], P[10]) + a4 + a6  # beyond this distance in height from P, the arm only moves away from it
    low, high = max(low, min(P[11] - side, high)), min(high, max(P[11] + side, low))
    best, step = low, (high - low) / 64.0
    for k in range(1, 65):
        d = low + k * step
        if inspection_margin(P, d, a4, a6) > inspection_margin(P, best, a4, a6):
            best = d
    a, b = max(best - step, low), min(best + step, high)
    for _ in range(60):
        u, v = b - GOLDEN * (b - a), a + GOLDEN * (b - a)
        if inspection_margin(P, u, a4, a6) < inspection_margin(P, v, a4, a6):
            a = u
        else:
            b = v
    return 0.5 * (a + b)


@inner
def choose_lift(p, P, box, spans):
    """Return the lift (value of the prismatic joint) [m] to try first, and the number of feasible intervals of it.

    The intervals are written to spans (2, 2). A lift is feasible if the wrist pose P (see `wrist_pose`) is in reach from it. If
    the number is 0, no lift inside the limits is feasible, and the one that comes nearest is returned. If it is -1, no intervals
    were needed: the arm has no lift, its value is given, or the reference value is feasible and is kept. p: the arm's parameters;
    box (4, n): limits, reference, weights.
    """
    a4, a6 = p[A4], p[A6]
    i = int(p[LIFT])
    if i < 0:
        return 0.0, -1
    choice = int(p[LIFT + 2])
    if choice == GIVEN:
        return p[LIFT + 1] * p[LIFT + 3], -1
    low, high = lift_limits(p, box)
    wish = min(max(p[LIFT + 1] * box[2, i], low), high)
    if choice == NEAREST and inspection_margin(P, wish, a4, a6) >= 0.0:
        return wish, -1
    count = lift_intervals(P, a4, a6, low, high, spans)
    if count == 0:
        return nearest_lift(P, a4, a6, low, high), 0
    best = 0.5 * (spans[0, 0] + spans[0, 1])
    if choice == MIDDLE:
        if count == 2 and spans[1, 1] - spans[1, 0] > spans[0, 1] - spans[0, 0]:
            best = 0.5 * (spans[1, 0] + spans[1, 1])
        return best, count
    best = min(max(wish, spans[0, 0]), spans[0, 1])
    other = min(max(wish, spans[count - 1, 0]), spans[count - 1, 1])
    return (other if abs(other - wish) < abs(best - wish) else best), count


@inner
def stopped_at(p, P, box, d, gap, spans):
    """Return how far the prismatic joint's limits keep the arm from the wrist pose P: lift, distance from P, missing stroke [m].

    If a lift beyond the limits reaches P, these are the limit nearest to such a lift, a gap of 0, and the distance between the
    two. Otherwise d and gap, the lift and distance from P found so far, are returned with a stroke of 0. p: the arm's parameters;
    box: lower limits, then upper limits; spans (2, 2): scratch.
    """
    low, high = lift_limits(p, box)
    least = np.inf
    for k in range(lift_intervals(P, p[A4], p[A6], -np.inf, np.inf, spans)):
        if spans[k, 0] - high > 0.0 and spans[k, 0] - high < least:
            least, d, gap = spans[k, 0] - high, high, 0.0
        if low - spans[k, 1] > 0.0 and low - spans[k, 1] < least:
            least, d, gap = low - spans[k, 1], low, 0.0
    return d, gap, (least if gap == 0.0 else 0.0)


@inner
def scan_lifts(p, P, box, near, spans, moved, sols, tries, best):
    """Search for a solution inside the limits at SCAN lifts in each feasible interval; return by how much the best exceeds limits.

    The best solution (branch) is the one inside the limits nearest the reference, or else the one that exceeds them least; it is
    written to best (n,). spans: a row for each interval. The lifts are closer together at the ends of an interval, where the
    angles change fastest. Other arguments as for `pick`; tries (2, n): scratch.
    """
    least, nearest = np.inf, np.inf
    for k in range(spans.shape[0]):
        middle, half = 0.5 * (spans[k, 0] + spans[k, 1]), 0.5 * (spans[k, 1] - spans[k, 0])
        for j in range(SCAN):
            d = middle - half * math.cos(math.pi * j / (SCAN - 1))
            worst, distance = pick(p, P, d, box, near, moved, sols, tries[0], tries[1])
            if worst < least or (worst == least and distance < nearest):
                least, nearest = worst, distance
                copy(tries[1], best)
    return least


@inner
def at_turn(p, P, k, span, turn, box, near, row, q):
    """Compute solution (branch) k, 0 to 7, of the wrist pose P at a lift in `span` [m]; return its limit excess and distance.

    q (n,) receives the joint values. turn (0 to pi) chooses the lift: it lies at the share (1 - cos(turn)) / 2 of the interval.
    The results are those of `joint_values`; p, box, near: as for `pick`; row (6,): scratch.
    """
    d = 0.5 * (span[0] + span[1]) - 0.5 * (span[1] - span[0]) * math.cos(turn)
    inspection_branch(P, d, p[A4], p[A6], near, k, row)
    return joint_values(p, row, d, box, q)


@inner
def narrow_windows(p, P, box, near, spans, broken, row, q, best):
    """Search for narrow ranges of the lift in which some solution (branch) is inside all limits; return the least limit excess.

    spans: the feasible intervals of the lift [m], one a row. In such a range the branch's largest excess over a limit, as a
    function of the lift, has a minimum. Each minimum is approached by golden section until the excess is 0 or no longer falls.
    Fills best (n,) with the branch of least excess. Other arguments as for `pick`; broken (WINDOWS,), row (6,) and q (n,) are
    scratch.
    """
    least, nearest = np.inf, np.inf
    step = math.pi / (WINDOWS - 1)
    for s in range(spans.shape[0]):
        span = spans[s]
        for k in range(8):
            for j in range(WINDOWS):
                broken[j] = at_turn(p, P, k, span, j * step, box, near, row, q)[0]
            for j in range(WINDOWS):
                if (j > 0 and broken[j - 1] < broken[j]) or (j + 1 < WINDOWS and broken[j + 1] < broken[j]):
                    continue
                a, b = max(j - 1, 0) * step, min(j + 1, WINDOWS - 1) * step
                u, v = b - GOLDEN * (b - a), a + GOLDEN * (b - a)
                at_u = at_turn(p, P, k, span, u, box, near, row, q)[0]
                at_v = at_turn(p, P, k, span, v, box, near, row, q)[0]
                for _ in range(CLOSING):
                    if broken[j] == 0.0 or min(at_u, at_v) == 0.0:
                        break
                    if at_u < at_v:
                        b, v, at_v = v, u, at_u
                        u = b - GOLDEN * (b - a)
                        at_u = at_turn(p, P, k, span, u, box, near, row, q)[0]
                    else:
                        a, u, at_u = u, v, at_v
                        v = a + GOLDEN * (b - a)
                        at_v = at_turn(p, P, k, span, v, box, near, row, q)[0]
                turn = j * step if broken[j] <= min(at_u, at_v) else (u if at_u <= at_v else v)
                worst, distance = at_turn(p, P, k, span, turn, box, near, row, q)
                if worst < least or (worst == least and distance < nearest):
                    least, nearest = worst, distance
                    copy(q, best)
    return least


@inline
def coupled(p, up, row):
    """Return i, j, base and slope of q_j = base + slope q_i: how joints 1 and 4 turn against each other if their axes are parallel.

    Of these angles the pose only determines theta_4 - up theta_1, with up = 1 or -1. p: the arm's parameters; row (6,): its
    angles.
    """
    sign, sign4 = p[JOINTS + 1], p[JOINTS + 7]
    base = sign4 * (row[2] - up * row[0] + up * p[JOINTS + 2] - p[JOINTS + 8])
    return int(p[JOINTS]), int(p[JOINTS + 6]), base, sign4 * up * sign


@inline
def shared_range(box, i, j, shift, slope):
    """Return the two ends [rad] of the range of q_i in which q_i and q_j = shift + slope q_i are both inside their limits.

    The range is empty if its first end is above its second. slope is 1 or -1; box: lower limits, then upper limits of the joints.
    """
    a, b = (box[0, j] - shift) * slope, (box[1, j] - shift) * slope
    return max(box[0, i], min(a, b)), min(box[1, i], max(a, b))


@inline
def set_free(p, up, x, row):
    """For an arm whose axes 1 and 4 are parallel: turn joint 1 to the value x [rad] and theta_4 back, so that the tip stays.

    row (6,): the arm's angles, changed in place; p: its parameters; up: 1 or -1, as for `coupled`.
    """
    turned = p[JOINTS + 1] * x + p[JOINTS + 2] - row[0]
    row[0] += turned
    row[2] += up * turned


@inner
def meet_limits(p, box, up, row):
    """If axes 1 and 4 are parallel, set theta_1 and theta_4 to the pair inside the limits that is nearest the reference.

    If no pair is inside the limits, the one that exceeds them least is taken. row (6,): the arm's angles, changed in place; p, up:
    as for `coupled`; box (4, n): limits, reference, weights.
    """
    i, j, base, slope = coupled(p, up, row)
    first, second, wi, wj = box[2, i], box[2, j], box[3, i], box[3, j]
    turns = np.rint((second - base - slope * first) / TAU)
    least, nearest, chosen = np.inf, np.inf, first
    for m in range(-TURNS, TURNS + 1):
        shift = base + TAU * (turns + m)
        low, high = shared_range(box, i, j, shift, slope)
        gap = max(low - high, 0.0)
        x = 0.5 * (low + high) if gap > 0.0 else (wi * first + wj * slope * (second - shift)) / (wi + wj)
        x = x if gap > 0.0 else min(max(x, low), high)
        distance = wi * (x - first) ** 2 + wj * (shift + slope * x - second) ** 2
        if gap < least or (gap == least and distance < nearest):
            least, nearest, chosen = gap, distance, x
    set_free(p, up, chosen, row)


@inline
def shoulder_on_axes(p, P, d, near):
    """Return whether the shoulder lies on axis 6, and whether on axis 7, if the wrist has pose P and the lift is d [m].

    theta_6 or theta_7 is then free. near (6,): any angles.
    """
    x, y, _ = shoulder_in_tool(P, d)
    return forearm(P, d, p[A4], p[A6], near)[0], math.hypot(x, y) <= LEVEL * (p[A4] + p[A6])


@inner
def pick_level(p, P, d, free, box, near, row, q, best):
    """Find the solution with axes 1 and 4 parallel that exceeds the limits least; return by how much it exceeds them.

    It is written to best (n,). Of several, the one nearest to the reference is taken. The excess is infinite if no such
    configuration reaches the wrist pose P. If `free`, each configuration takes the lift that it needs, otherwise lift d [m].
    Other arguments as for `pick`; row (6,): scratch.
    """
    least, nearest = np.inf, np.inf
    size = p[A4] + p[A6]
    for k in range(8 if abs(P[8]) <= LEVEL else 0):
        at, miss = level_arm(P, d, free, p[A4], p[A6], k, near, row)
        if miss > LEVEL * size:
            continue
        meet_limits(p, box, 1.0 - 2.0 * (k % 2), row)
        worst, distance = joint_values(p, row, at, box, q)
        if worst < least or (worst == least and distance < nearest):
            least, nearest = worst, distance
            copy(q, best)
    return least
