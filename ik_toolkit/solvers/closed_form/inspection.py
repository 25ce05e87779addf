"""An arm with a spherical shoulder on a lift (the 7-joint inspection robot), every branch in closed form.

Recognised by its axes: joint 1 turns about an axis along which joint 2 slides (in either order, or the slide is locked or
absent); axes 1, 3 and 4 meet in one point, each across the next; axis 5 is parallel to 4, axis 6 crosses axis 5 at right
angles level with the shoulder, axis 7 is parallel to 6. Base, tool, axis signs, angle offsets and lengths are free.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ...errors import InvalidOption, UnknownSolver
from ...kernel import slots
from ...kernel.chain import Chain
from ...kernel.checks import BAD_START, BAD_TARGET, LIMIT_BLOCKED, rigid
from ...kernel.jit import cached, jit
from ...kernel.kinematics import TAU
from ...kernel.loop import ENTRIES
from . import reach
from .geometry import (
    FIT,
    SNAP,
    across,
    angle_about,
    clamp,
    copy_limits,
    legal_start,
    legal_turn,
    measure_tip,
    read_screws,
)
from .reach import (
    inspection_branch,
    inspection_branches,
    inspection_margin,
    inspection_nearest,
    level_arm,
    lift_intervals,
    nearest_lift,
)

# Slots of the parameters: base -> shoulder axes (12), tip -> wrist axes (12), then these. Of each turning joint: its place
# in q, sign and offset (theta = sign q + offset); of the lift: its place (-1: none), sign, offset, choice, given value.
A4, A6, JOINTS, LIFT = 24, 25, 26, 44
NEAREST, GIVEN, MIDDLE = range(3)
CHOICES: dict[Any, int] = {"nearest": NEAREST, "mid": MIDDLE}
SCAN = 12  # lifts tried in each feasible interval when no branch at the first lift is legal
WINDOWS = 33  # lifts of each branch between which minima of the limit broken are looked for when none of those is legal
GOLDEN, CLOSING = 0.6180339887498949, 64  # of the golden section: it ends at rounding, 0.618^64 = 4e-14
TURNS = 8  # full turns looked at either way; joints with wider limits are as good as endless
LEVEL = 1e-9  # slope of the tool's z axis, and miss of the forearm's length, up to which an arm is level


class Inspection(NamedTuple):
    """All branches (8) of a spherical shoulder on a lift, for poses; the legal one nearest q0 is returned.

    lift: 'nearest' takes the feasible lift nearest q0's (another where no branch there is inside the limits), 'mid' the
    middle of the longest feasible interval (with the same way out), a number [m] that lift only.
    Source: Shanmugasundar and Sivaramakrishnan (2012), eqs. (7)-(13), completed: every branch, the lift as the free
    parameter, reach test, singular poses.
    """

    lift: float | str = "nearest"

    def pack(self, robot: Any) -> np.ndarray:
        """Geometry and choice of lift for the compiled solver.

        Raises UnknownSolver when the robot is no such arm, InvalidOption for a lift that is no choice.
        """
        parameters, reason = recognise(robot.chain)
        if reason:
            raise UnknownSolver(f"solver 'inspection' does not fit robot '{robot.name}': {reason}")
        choice = CHOICES.get(self.lift, GIVEN)
        value = 0.0
        if choice == GIVEN:
            try:
                value = float(self.lift)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise InvalidOption(f"lift must be 'nearest', 'mid' or a number of metres, not {self.lift!r}")
        return np.concatenate([parameters, [choice, value]])

    def held(self, robot: Any) -> dict[int, float]:
        """Joints (place in q) that have a given value: the lift, where it is a number [m]."""
        place = np.flatnonzero([kind == "prismatic" for kind in robot.joint_kinds])
        return {} if self.lift in CHOICES or not len(place) else {int(place[0]): float(self.lift)}


def recognise(chain: Chain) -> tuple[np.ndarray, str]:
    """Parameters of the arm read off its joint axes, and '' or why it has not this structure."""
    none = np.zeros(0)
    if chain.n not in (6, 7):
        return none, f"it has {chain.n} joints on the path, not a lift and 6 turning joints (or these 6)"
    screws = read_screws(chain)
    if isinstance(screws, str):
        return none, screws
    slides = np.flatnonzero(~screws.turns)
    if len(slides) != chain.n - 6 or (len(slides) and slides[0] > 1):
        return none, "its only sliding joint must be the lift, first or second on the path"
    order = np.flatnonzero(screws.turns)
    z1, z3, z4, z5, z6, z7 = screws.axis[order]
    c1, c3, c4, c5, c6, c7 = screws.point[order]
    if len(slides) and np.linalg.norm(np.cross(z1, screws.axis[slides[0]])) > FIT:
        return none, "its lift does not slide along the first turning axis"
    # Sentences count turning joints from the base, so that they read the same with and without a lift.
    for pair, a, b in (("1 and 2", z1, z3), ("2 and 3", z3, z4), ("4 and 5", z5, z6)):
        if abs(a @ b) > FIT:
            return none, f"its turning joints {pair} are not at right angles (cosine {a @ b:.2g})"
    for pair, a, b in (("3 and 4", z4, z5), ("5 and 6", z6, z7)):
        if np.linalg.norm(np.cross(a, b)) > FIT:
            return none, f"its turning joints {pair} are not parallel"
    slack = FIT * chain.reach
    # The shoulder: the foot on axis 1 of joint 3's axis; axes 3 and 4 must pass through it.
    shoulder = c1 + z1 * (z1 @ (c3 - c1))
    for place, z, c in (("second", z3, c3), ("third", z4, c4)):
        if np.linalg.norm(across(z, c - shoulder)) > slack:
            return none, f"its {place} turning axis misses the point where the first and second are nearest"
    level5 = c5 + z4 * (z4 @ (shoulder - c5))  # of axis 5, level with the shoulder
    if np.linalg.norm(across(z6, c6 - level5)) > slack:
        return none, "its fifth turning axis does not cross the fourth level with the shoulder"
    level7 = c7 + z6 * (z6 @ (level5 - c7))
    upper, fore = level5 - shoulder, level7 - level5
    a4, a6 = float(np.linalg.norm(upper)), float(np.linalg.norm(fore))
    if min(a4, a6) <= slack:
        return none, "two of its parallel turning axes coincide"
    # The Denavit-Hartenberg x axes at q = 0 give every angle's offset; axes 5 and 7 are turned along 4 and 6.
    s5, s7 = math.copysign(1.0, z4 @ z5), math.copysign(1.0, z6 @ z7)
    x1, x3, x4, x6 = np.cross(z1, z3), np.cross(z3, z4), upper / a4, fore / a6
    x5 = np.cross(z6, z4)
    signs = [1.0, 1.0, 1.0, s5, 1.0, s7]
    offsets = [
        0.0,
        angle_about(z3, x1, x3),
        angle_about(z4, x3, x4),
        angle_about(z4, x4, x5),
        angle_about(z6, x5, x6),
        0.0,
    ]
    R = np.vstack([x1, np.cross(z1, x1), z1])
    wrist = np.eye(4)
    wrist[:3, :3] = np.column_stack([x6, np.cross(z6, x6), z6])
    wrist[:3, 3] = level7
    E = np.linalg.inv(screws.T) @ wrist
    lift = [float(slides[0]), math.copysign(1.0, z1 @ screws.axis[slides[0]])] if len(slides) else [-1.0, 1.0]
    joints = np.column_stack([order, signs, offsets]).ravel()
    return np.concatenate([R.ravel(), -R @ shoulder, E[:3, :3].ravel(), E[:3, 3], [a4, a6], joints, lift]), ""


@jit
def wrist_pose(p, T, P):
    """Fill P (12: rotation by rows, point) with the wrist pose of T (4, 4) in shoulder axes."""
    for r in range(3):
        b0, b1, b2 = p[3 * r], p[3 * r + 1], p[3 * r + 2]
        m0 = b0 * T[0, 0] + b1 * T[1, 0] + b2 * T[2, 0]
        m1 = b0 * T[0, 1] + b1 * T[1, 1] + b2 * T[2, 1]
        m2 = b0 * T[0, 2] + b1 * T[1, 2] + b2 * T[2, 2]
        for k in range(3):
            P[3 * r + k] = m0 * p[12 + k] + m1 * p[15 + k] + m2 * p[18 + k]
        P[9 + r] = b0 * T[0, 3] + b1 * T[1, 3] + b2 * T[2, 3] + p[9 + r] + m0 * p[21] + m1 * p[22] + m2 * p[23]


@jit
def joint_values(p, angles, d, box, q):
    """Fill q with the legal turns of `angles` (6,) nearest box[2] and the lift; return the worst limit broken, the distance."""
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


@jit
def near_angles(p, box, near):
    """Fill near (6,) with the theta of the reference configuration: they stand in where an angle is free."""
    for k in range(6):
        near[k] = p[JOINTS + 3 * k + 1] * box[2, int(p[JOINTS + 3 * k])] + p[JOINTS + 3 * k + 2]


@jit
def pick(p, P, d, box, near, moved, sols, q, best):
    """Fill best (n,) with the branch at lift d that breaks limits least, of the legal ones the nearest; return both numbers.

    The wrist point is first moved to the nearest reachable one.
    """
    moved[:] = P
    inspection_nearest(moved, d, p[A4], p[A6])
    least, nearest = np.inf, np.inf
    for k in range(inspection_branches(moved, d, p[A4], p[A6], near, sols)):
        worst, distance = joint_values(p, sols[k], d, box, q)
        if worst < least or (worst == least and distance < nearest):
            least, nearest = worst, distance
            best[:] = q
    return least, nearest


@jit
def lift_limits(p, box):
    """Lowest and highest lift the limits allow, along the shoulder's own axis."""
    i = int(p[LIFT])
    if p[LIFT + 1] > 0.0:
        return box[0, i], box[1, i]
    return -box[1, i], -box[0, i]


@jit
def choose_lift(p, P, box, spans):
    """Lift to try first, and how many feasible intervals stand in spans (2, 2).

    0: reachable from no legal lift, the nearest is returned; -1: the lift is not free or its first choice is feasible.
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


@jit
def stopped_at(p, P, box, d, gap, spans):
    """Where no legal lift reaches: the limit nearest a lift that would, 0, and the stroke [m] missing; or d, gap and 0."""
    low, high = lift_limits(p, box)
    least = np.inf
    for k in range(lift_intervals(P, p[A4], p[A6], -np.inf, np.inf, spans)):
        if spans[k, 0] - high > 0.0 and spans[k, 0] - high < least:
            least, d, gap = spans[k, 0] - high, high, 0.0
        if low - spans[k, 1] > 0.0 and low - spans[k, 1] < least:
            least, d, gap = low - spans[k, 1], low, 0.0
    return d, gap, (least if gap == 0.0 else 0.0)


@jit
def scan_lifts(p, P, box, near, spans, count, moved, sols, q, trial, best):
    """Look at a few feasible lifts for a legal branch: the one nearest the reference, or what breaks the limits least.

    Lifts stand closer at the ends of an interval, where the angles change fastest.
    """
    least, nearest = np.inf, np.inf
    for k in range(count):
        middle, half = 0.5 * (spans[k, 0] + spans[k, 1]), 0.5 * (spans[k, 1] - spans[k, 0])
        for j in range(SCAN):
            d = middle - half * math.cos(math.pi * j / (SCAN - 1))
            worst, distance = pick(p, P, d, box, near, moved, sols, q, trial)
            if worst < least or (worst == least and distance < nearest):
                least, nearest = worst, distance
                best[:] = trial
    return least


@jit
def at_turn(p, P, k, middle, half, turn, box, near, row, q):
    """Fill q with branch k at the lift middle - half cos(turn); return the worst limit broken and the distance."""
    d = middle - half * math.cos(turn)
    inspection_branch(P, d, p[A4], p[A6], near, k, row)
    return joint_values(p, row, d, box, q)


@jit
def narrow_windows(p, P, box, near, spans, count, broken, row, q, best):
    """Search every branch over the feasible lifts for the windows that are inside all limits, however narrow.

    A branch leaves its limits between two lifts where the worst limit broken has a minimum above zero between them; each
    minimum is closed in on until it is legal or as small as it gets. Returns the least that is broken.
    """
    least, nearest = np.inf, np.inf
    step = math.pi / (WINDOWS - 1)
    for span in range(count):
        middle, half = 0.5 * (spans[span, 0] + spans[span, 1]), 0.5 * (spans[span, 1] - spans[span, 0])
        for k in range(8):
            for j in range(WINDOWS):
                broken[j] = at_turn(p, P, k, middle, half, j * step, box, near, row, q)[0]
            for j in range(WINDOWS):
                if (j > 0 and broken[j - 1] < broken[j]) or (j + 1 < WINDOWS and broken[j + 1] < broken[j]):
                    continue
                a, b = max(j - 1, 0) * step, min(j + 1, WINDOWS - 1) * step
                u, v = b - GOLDEN * (b - a), a + GOLDEN * (b - a)
                at_u = at_turn(p, P, k, middle, half, u, box, near, row, q)[0]
                at_v = at_turn(p, P, k, middle, half, v, box, near, row, q)[0]
                for _ in range(CLOSING):
                    if broken[j] == 0.0 or min(at_u, at_v) == 0.0:
                        break
                    if at_u < at_v:
                        b, v, at_v = v, u, at_u
                        u = b - GOLDEN * (b - a)
                        at_u = at_turn(p, P, k, middle, half, u, box, near, row, q)[0]
                    else:
                        a, u, at_u = u, v, at_v
                        v = a + GOLDEN * (b - a)
                        at_v = at_turn(p, P, k, middle, half, v, box, near, row, q)[0]
                turn = j * step if broken[j] <= min(at_u, at_v) else (u if at_u <= at_v else v)
                worst, distance = at_turn(p, P, k, middle, half, turn, box, near, row, q)
                if worst < least or (worst == least and distance < nearest):
                    least, nearest = worst, distance
                    best[:] = q
    return least


@jit
def meet_limits(p, box, up, row):
    """Set theta_1 and theta_4 of a level arm (6,), whose sum or difference is given, to the legal pair nearest the reference.

    theta_4 = constant + up theta_1, up = 1 or -1. Where no pair is legal, the one that breaks its limits least is taken.
    """
    i, j = int(p[JOINTS]), int(p[JOINTS + 6])
    sign, offset, sign4 = p[JOINTS + 1], p[JOINTS + 2], p[JOINTS + 7]
    constant = row[2] - up * row[0]
    slope = sign4 * up * sign  # of the joint values: q_j = shift + slope q_i
    base = sign4 * (constant + up * offset - p[JOINTS + 8])
    first, second, wi, wj = box[2, i], box[2, j], box[3, i], box[3, j]
    turns = np.rint((second - base - slope * first) / TAU)
    least, nearest, chosen = np.inf, np.inf, first
    for m in range(-TURNS, TURNS + 1):
        shift = base + TAU * (turns + m)
        ends = (box[0, j] - shift) * slope, (box[1, j] - shift) * slope
        low, high = max(box[0, i], min(ends)), min(box[1, i], max(ends))
        gap = max(low - high, 0.0)
        x = 0.5 * (low + high) if gap > 0.0 else (wi * first + wj * slope * (second - shift)) / (wi + wj)
        x = x if gap > 0.0 else min(max(x, low), high)
        distance = wi * (x - first) ** 2 + wj * (shift + slope * x - second) ** 2
        if gap < least or (gap == least and distance < nearest):
            least, nearest, chosen = gap, distance, x
    row[0] = sign * chosen + offset
    row[2] = constant + up * row[0]


@jit
def pick_level(p, P, d, free, box, near, row, q, best):
    """Fill best with the level arm (axes 1 and 4 parallel, one angle free) that breaks limits least, then the nearest.

    Returns the limit it breaks, infinity where the pose has no level arm. free: the lift may be chosen, otherwise it is d.
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
            best[:] = q
    return least


def _compile_solve():
    @cached
    def solve(rows, ends, seeds, feat, T, Q0, out, opt, hist):
        n = seeds.shape[1]
        p = opt[slots.OPT_HEAD + n :]
        box, near, spans = np.empty((4, n)), np.empty(6), np.empty((2, 2))
        P, moved, sols = np.empty(12), np.empty(12), np.empty((8, 6))
        q, trial, best = np.empty(n), np.empty(n), np.empty(n)
        row, limits = np.empty(6), np.empty(WINDOWS)
        goal, Z, trig = np.empty(12), np.empty((n, 6)), np.zeros((3, 8))
        for t in range(T.shape[0]):
            if not rigid(T[t]):
                out[t, 0] = BAD_TARGET
                continue
            q0 = Q0[t if Q0.shape[0] > 1 else 0]
            if opt[slots.O_GIVEN] > 0.0 and not legal_start(ends, opt, q0):
                out[t, 0] = BAD_START
                continue
            copy_limits(ends, opt, q0, box)
            near_angles(p, box, near)
            wrist_pose(p, T[t], P)
            d, count = choose_lift(p, P, box, spans)
            stroke = 0.0
            gap = max(0.0, -inspection_margin(P, d, p[A4], p[A6]))
            broken = pick(p, P, d, box, near, moved, sols, q, best)[0]
            free = p[LIFT] >= 0.0 and p[LIFT + 2] != GIVEN
            if broken > 0.0:
                least = pick_level(p, P, d, free, box, near, row, q, trial)
                if least < broken or (least == 0.0 and gap > 0.0):
                    broken = least
                    best[:] = trial
            if free:
                if broken > 0.0 and count != 0:
                    if count < 0:
                        low, high = lift_limits(p, box)
                        count = lift_intervals(P, p[A4], p[A6], low, high, spans)
                    broken = scan_lifts(p, P, box, near, spans, count, moved, sols, q, trial, best)
                    if broken > 0.0:
                        broken = narrow_windows(p, P, box, near, spans, count, limits, row, q, best)
                elif gap > 0.0:
                    d, gap, stroke = stopped_at(p, P, box, d, gap, spans)
                    if stroke > 0.0:  # in reach with more stroke: it is the lift's limit that stops it
                        broken = max(pick(p, P, d, box, near, moved, sols, q, best)[0], SNAP)
            lever = p[A4] + p[A6] + math.sqrt(p[21] * p[21] + p[22] * p[22] + p[23] * p[23])
            slack = opt[slots.O_TOL_R] * lever  # a pose turned by the tolerance moves the wrist no further than this
            measure_tip(rows, ends, opt, T[t], best, box, broken, gap, slack, goal, Z, trig, hist, out[t])
            if out[t, slots.R_STATUS] == LIMIT_BLOCKED:
                out[t, slots.R_EXCESS] = stroke

    return solve


def _compile_every():
    @cached
    def every(p, T, box, lifts, out, broken):
        """Fill out (8 K, n) with all branches of T (4, 4) at those of the lifts (K,) that reach it; return how many.

        broken (8 K,) receives by how much each breaks a limit.
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

    return every


def feasible_lifts(
    p: np.ndarray, T: np.ndarray, low: float = -math.inf, high: float = math.inf
) -> list[tuple[float, float]]:
    """Intervals of the lift joint's value [m], inside [low, high], from which the pose T (4, 4) is reachable (0 to 2)."""
    P, spans, sign = np.empty(12), np.empty((2, 2)), p[LIFT + 1]
    wrist_pose(p, np.asarray(T, dtype=float), P)
    ends = sorted((sign * low, sign * high))
    count = lift_intervals(P, p[A4], p[A6], ends[0], ends[1], spans)
    return sorted(tuple(sorted(sign * float(x) for x in span)) for span in spans[:count])


def nearest_pose(p: np.ndarray, T: np.ndarray, lift: float) -> tuple[np.ndarray, float]:
    """Nearest pose to T (4, 4) reachable at a value of the lift joint [m] with the orientation kept, and how far [m] it is."""
    P, near = np.empty(12), np.array(T, dtype=float)
    wrist_pose(p, near, P)
    before = P[9:].copy()
    gap = inspection_nearest(P, p[LIFT + 1] * lift, p[A4], p[A6])
    near[:3, 3] += p[:9].reshape(3, 3).T @ (P[9:] - before)
    return near, gap


def lifts_to_list(p: np.ndarray, T: np.ndarray, box: np.ndarray, count: int) -> tuple[np.ndarray, bool, str]:
    """Lifts (K,) at which to list all branches, whether they are all there are to list, and words for the message.

    One where the lift is given, locked or asked for by 'mid'; otherwise q0's (or the feasible one nearest it) and `count`
    spread over each feasible interval.
    """
    P, spans = np.empty(12), np.empty((2, 2))
    wrist_pose(p, T, P)
    first, _ = choose_lift(p, P, box, spans)
    place, sign = int(p[LIFT]), p[LIFT + 1]
    if place < 0:
        return np.array([first]), True, ""
    if p[LIFT + 2] != NEAREST:
        return np.array([first]), True, f" at lift {sign * first:.6g} m"
    low, high = lift_limits(p, box)
    found = lift_intervals(P, p[A4], p[A6], low, high, spans)
    spread = [np.linspace(a, b, count + 2)[1:-1] for a, b in spans[:found]]
    words = " and ".join(f"{a:.6g} to {b:.6g} m" for a, b in feasible_lifts(p, T, box[0, place], box[1, place]))
    where = (
        f" at {1 + count * found} lifts, of the infinitely many from {words},"
        if found
        else f" at lift {sign * first:.6g} m"
    )
    return np.concatenate([[first], *spread]), False, where


ENTRIES[Inspection] = _compile_solve()
every_branch = _compile_every()
