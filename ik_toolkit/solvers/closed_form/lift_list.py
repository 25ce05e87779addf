"""Lists all branches of the arm with a spherical shoulder on a lift (prismatic joint), and its self-motions."""

import math
from typing import Any

import numpy as np

from ...compile.jit import cached
from ...kernel.kinematics import TAU
from . import reach
from .geometry import Branches, Family, one_turn
from .lift_arm import (
    A4,
    A6,
    JOINTS,
    LEVEL,
    LIFT,
    MIDDLE,
    NEAREST,
    NEARLY,
    TURNS,
    choose_lift,
    coupled,
    joint_values,
    meet_limits,
    near_angles,
    set_free,
    shared_range,
    shoulder_on_axes,
    wrist_pose,
)
from .reach import (
    inspection_branches,
    inspection_margin,
    inspection_nearest,
    level_arm,
    lift_intervals,
)

SPREAD_LIFTS = 9  # number of values of the prismatic joint, in each feasible interval, at which branches are listed
STEPS = 8  # number of Newton steps that correct a solution if the arm has the assumed geometry only approximately
# Bits that say why a joint angle does not matter for the pose: axes 1 and 4 are parallel, the shoulder is on axis 6, or axis 7.
LEVEL_ARM, ON_AXIS_6, ON_AXIS_7 = 1, 2, 4


@cached
def every_branch(p, T, box, lifts, out, broken):
    """Fill out (8 K, n) with all branches of T (4, 4) at those of the lifts (K,) [m] that reach it; return their number.

    A lift is a value of the prismatic joint, along the shoulder's axis. p: the arm's parameters (`lift_arm`); box (4, n): see
    `geometry.copy_limits`. broken (8 K,) receives by how much each branch exceeds a joint limit [rad or m].
    """
    near, P, sols = np.empty(6), np.empty(12), np.empty((8, 6))
    near_angles(p, box, near)
    wrist_pose(p, T, P)
    count = 0
    for d in lifts:
        if inspection_margin(P, d, p[A4], p[A6]) < -reach.EDGE * (p[A4] + p[A6]):
            continue
        inspection_nearest(P, d, p[A4], p[A6])
        for k in range(inspection_branches(P, d, p[A4], p[A6], near, sols)):
            broken[count] = joint_values(p, sols[k], d, box, out[count])[0]
            count += 1
    return count


@cached
def first_lift(p, T, box):
    """Return the value [m] of the prismatic joint at which the solutions (branches) of T (4, 4) are listed if one value is enough.

    p: the arm's parameters (`lift_arm`); box (4, n): see `geometry.copy_limits`.
    """
    P, spans = np.empty(12), np.empty((2, 2))
    wrist_pose(p, T, P)
    return choose_lift(p, P, box, spans)[0]


@cached
def looks(p, T, d, Q, marks):
    """Label the solutions (branches) Q (K, n) of the pose T (4, 4): fill marks (K, 3) with signs of shoulder, elbow and wrist.

    Returns why an angle is free at the value d [m] of the prismatic joint, as bits (LEVEL_ARM, ON_AXIS_6, ON_AXIS_7). p: the arm's
    parameters (`lift_arm`).
    """
    for k in range(Q.shape[0]):
        for m in range(3):  # the signs of sin theta_3 (shoulder), sin theta_6 (elbow) and cos theta_5 (wrist)
            place = JOINTS + (3, 12, 9)[m]
            theta = p[place + 1] * Q[k, int(p[place])] + p[place + 2]
            value = math.cos(theta) if m == 2 else math.sin(theta)
            marks[k, m] = 0 if abs(value) < reach.MERGED else (1 if value > 0.0 else -1)
    P = np.empty(12)
    wrist_pose(p, T, P)
    on_six, on_seven = shoulder_on_axes(p, P, d, np.zeros(6))
    return LEVEL_ARM * (abs(P[8]) <= LEVEL) + ON_AXIS_6 * on_six + ON_AXIS_7 * on_seven


@cached
def level_family(p, T, box, d, free, samples, spans, out, broken):
    """Find the ranges [rad] in which joint 1 can turn, with joint 4 turning back, because their axes are parallel.

    The ranges are written to spans (S, 2); their number is returned. `samples` configurations spread evenly over each range are
    written to out (S samples, n), and by how much they exceed limits to broken (S samples,). If `free`, each configuration has
    the value of the prismatic joint that it needs, otherwise d [m]. p: the arm's parameters (`lift_arm`); T (4, 4): the pose; box
    (4, n): see `geometry.copy_limits`.
    """
    P, near, row, q = np.empty(12), np.empty(6), np.empty(6), np.empty(out.shape[1])
    near_angles(p, box, near)
    wrist_pose(p, T, P)
    count = 0
    for k in range(8):
        at, miss = level_arm(P, d, free, p[A4], p[A6], k, near, row)
        if miss > LEVEL * (p[A4] + p[A6]) or (not free and k // 2 % 2 == 1):
            continue
        up = 1.0 - 2.0 * (k % 2)
        meet_limits(p, box, up, row)
        if joint_values(p, row, at, box, q)[0] > 0.0:
            continue
        i, j, base, slope = coupled(p, up, row)
        first = np.rint((q[j] - base - slope * q[i]) / TAU)
        # A joint without limits meets the same range again after a whole turn, so the range is listed once.
        endless = math.isinf(box[1, i] - box[0, i]) or math.isinf(box[1, j] - box[0, j])
        turns = 0 if endless else TURNS
        for m in range(-turns, turns + 1):
            low, high = shared_range(box, i, j, base + TAU * (first + m), slope)
            if high < low:
                continue
            whole = high - low >= TAU
            low, high = one_turn(low, high, q[i])
            spans[count, 0], spans[count, 1] = low, high
            for s in range(samples):
                set_free(p, up, low + (high - low) * s / max(samples - 1, 1), row)
                broken[count * samples + s] = joint_values(p, row, at, box, out[count * samples + s])[0]
            count += 1
            if whole:
                break
    return count


def feasible_lifts(
    p: np.ndarray, T: np.ndarray, low: float = -math.inf, high: float = math.inf
) -> list[tuple[float, float]]:
    """Return the intervals (0 to 2) of the prismatic joint's value [m], between low and high, that reach the pose T (4, 4).

    p: the arm's parameters (`lift_arm`).
    """
    P, spans, sign = np.empty(12), np.empty((2, 2)), p[LIFT + 1]
    wrist_pose(p, T, P)
    count = lift_intervals(P, p[A4], p[A6], *sorted((float(sign * low), float(sign * high))), spans)
    return sorted(tuple(sorted(sign * float(x) for x in span)) for span in spans[:count])


def nearest_pose(p: np.ndarray, T: np.ndarray, lift: float) -> tuple[np.ndarray, float]:
    """Return the pose in reach nearest to T (4, 4), at a value `lift` [m] of the prismatic joint, and its distance from T [m].

    The orientation is kept. p: the arm's parameters (`lift_arm`).
    """
    P, near = np.empty(12), np.array(T, dtype=float)
    wrist_pose(p, near, P)
    before = P[9:].copy()
    gap = inspection_nearest(P, p[LIFT + 1] * lift, p[A4], p[A6])
    near[:3, 3] += p[:9].reshape(3, 3).T @ (P[9:] - before)
    return near, gap


def listing(robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray, count: int) -> Branches:
    """Return all branches of T (4, 4), at one value of the prismatic joint or, if that is free, at several.

    One value is used if it is given, locked or chosen by 'mid'. p: the arm's parameters (`lift_arm`); box (4, n): limits,
    reference and weights (`geometry.copy_limits`); count: about how many samples of a self-motion to list.
    """
    place, sign, choice = int(p[LIFT]), p[LIFT + 1], p[LIFT + 2]
    free_lift = place >= 0 and choice == NEAREST
    lifts = np.array([first_lift(p, T, box)])
    words = "" if place < 0 else f" at lift {sign * lifts[0]:.6g} m"
    families = []
    if free_lift:
        spans = feasible_lifts(p, T, box[0, place], box[1, place])
        others = tuple(name for k, name in enumerate(robot.joint_names) if k != place)
        for a, b in spans:
            text = f"{robot.joint_names[place]} is free from {a:.6g} to {b:.6g} m, and the other joints follow"
            families.append(Family((robot.joint_names[place], *others), float(a), float(b), text))
        lifts = np.concatenate([lifts, *(sign * np.linspace(a, b, SPREAD_LIFTS + 2)[1:-1] for a, b in spans)])
        if spans:
            feasible = " and ".join(f"{a:.6g} to {b:.6g} m" for a, b in spans)
            words = f" at {len(lifts)} lifts from {feasible}"
    q, broken = np.empty((8 * len(lifts), robot.n)), np.empty(8 * len(lifts))
    found = every_branch(p, T, box, lifts, q, broken)
    q, broken, marks = q[:found], broken[:found], np.empty((found, 3), dtype=np.int8)
    free = looks(p, T, lifts[0], q, marks)
    if free:
        more, new = _free_angles(robot, p, T, box, lifts[0], free, free_lift, count)
        families += new
        q, broken = np.vstack([q, *(rows for rows, _ in more)]), np.concatenate([broken, *(limit for _, limit in more)])
        marks = np.empty((len(q), 3), dtype=np.int8)
        looks(p, T, lifts[0], q, marks)
    nearly = p[NEARLY] > 0.0
    # If an angle of elbow or wrist is free, the list has only samples of it, so it is not complete.
    sampled = free & (ON_AXIS_6 | ON_AXIS_7) > 0
    complete = not (nearly or families or sampled or (place >= 0 and choice == MIDDLE))
    fixed = -1 if place < 0 or free_lift else place
    return Branches(q, broken, marks, complete, words, tuple(families), STEPS if nearly else 0, fixed)


def _free_angles(
    robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray, d: float, free: int, free_lift: bool, count: int
) -> tuple[list[tuple[np.ndarray, np.ndarray]], list[Family]]:
    """Return the self-motions in which theta_1, theta_6 or theta_7 is free at lift (prismatic joint) d, and samples of each.

    free: bits returned by `looks`; free_lift: whether the prismatic joint is free, too; count: number of samples to list per range.
    Samples come first in the result, as pairs of configurations (M, n) and their excess over limits (M,).
    """
    # the joints that turn theta_1, theta_3, theta_4, theta_5, theta_6 and theta_7
    names = [robot.joint_names[int(p[JOINTS + 3 * k])] for k in range(6)]
    more, families = [], []
    if free & LEVEL_ARM:
        most = 8 * (2 * TURNS + 1)
        spans, q, broken = np.empty((most, 2)), np.empty((most * count, robot.n)), np.empty(most * count)
        found = level_family(p, T, box, d, free_lift, count, spans, q, broken)
        more.append((q[: found * count], broken[: found * count]))
        for low, high in spans[:found]:
            text = f"the arm is level: {names[0]} is free from {low:.6g} to {high:.6g} rad, and {names[2]} follows"
            families.append(Family((names[0], names[2]), float(low), float(high), text))
    for bit, leading, axis in ((ON_AXIS_6, 4, "sixth"), (ON_AXIS_7, 5, "seventh")):
        if not free & bit:
            continue
        q, broken, at = np.empty((8 * count, robot.n)), np.empty(8 * count), 0
        for angle in np.linspace(-np.pi, np.pi, count, endpoint=False):
            here = box.copy()
            place = JOINTS + 3 * leading
            here[2, int(p[place])] = p[place + 1] * (angle - p[place + 2])
            at += every_branch(p, T, here, np.array([d]), q[at:], broken[at:])
        more.append((q[:at], broken[:at]))
        if (broken[:at] == 0.0).any():
            moving = (names[leading], names[0], names[1], names[2])
            text = f"the shoulder lies on the {axis} axis: {names[leading]} is free, and {', '.join(moving[1:])} follow"
            families.append(Family(moving, None, None, text))
    return more, families
