"""Writes out the closed form of a spherical shoulder on a lift step by step, for one pose at one value of the prismatic joint."""

import math
from typing import Any, NamedTuple

import numpy as np
from sympy import Abs, Matrix, Max, Min, atan2, cos, pi, sin, sqrt

from ...compile.jit import cached
from ...kernel.records import copy
from ...text import length
from ..explain.worked_solution import Branch, Free, WorkedSolution, outside_limits
from ..explain.worksheet import Worksheet, zero_angles
from .lift_arm import A4, A6, GIVEN, JOINTS, LIFT, joint_values, near_angles, wrist_pose
from .lift_list import feasible_lifts, looks
from .reach import (
    EDGE,
    ON_AXIS,
    fill_shoulder_branch,
    forearm,
    inspection_margin,
    inspection_nearest,
    shoulder,
    shoulder_in_tool,
    wrist,
)

THETA = ("theta_1", "theta_3", "theta_4", "theta_5", "theta_6", "theta_7")
LEGEND = (
    "Shoulder, elbow and wrist: the signs of sin theta_3, sin theta_6 and cos theta_5 (0 where two branches merge)."
)
# A row of the array `table` that `worked_out` fills describes one solution (branch). From index ANGLES on it has the joint angles
# theta, from index Q on the joint values q.
ANGLES, Q = 3, 9
# In the array of the arm's parameters, the transform from base to shoulder axes begins at index BASE, that from tip to wrist axes
# at TOOL; each is a rotation matrix (9 numbers), then a point (3).
BASE, TOOL = 0, 12
ALIGNED = 1e-12  # two rotation matrices or points [m] are the same if no entry differs by more than this
PARTS, SIGNS = ("shoulder", "elbow", "wrist"), {1: "+", 0: "0", -1: "-"}


class HeadSlots(NamedTuple):
    """Indices in the array `head`, in which `worked_out` returns intermediate results that all solutions of a pose share.

    The first twelve numbers, without an index here, are the wrist pose.
    """

    shoulder: int = 12
    room: int = 15
    moved: int = 16
    on_six: int = 17
    straight: int = 18
    bend: int = 19
    inner: int = 20
    heading: int = 21


HEAD = HeadSlots()


@cached
def worked_out(p, T, d, box, head, table):
    """Compute the solutions of the pose T (4, 4) with all intermediate results, to be explained; return the number of solutions.

    p: the arm's parameters (`lift_arm`); d: value [m] of the prismatic joint; box (4, n): limits, reference, weights. The results
    are written to head (22,) and table (8, 9 + n). head holds the wrist pose (12), the shoulder in the wrist's axes (3), the
    distance to the edge of the reach [m], how far [m] the wrist was moved to be reachable, and the first five values of
    `forearm`. A row of table describes a branch: the numbers (0 or 1) of its elbow, wrist and shoulder, theta_1 and theta_3 to
    theta_7, and q.
    """
    near, P = np.empty(6), np.empty(12)
    near_angles(p, box, near)
    wrist_pose(p, T, P)
    head[15] = inspection_margin(P, d, p[A4], p[A6])
    head[16] = inspection_nearest(P, d, p[A4], p[A6])
    copy(P, head)
    head[12], head[13], head[14] = shoulder_in_tool(P, d)
    on_six, straight, bend, inner, heading, s5, c5 = forearm(P, d, p[A4], p[A6], near)
    head[17], head[18], head[19], head[20], head[21] = on_six, straight, bend, inner, heading
    count = 0
    for k6 in range(1 if on_six or straight else 2):
        for k5 in range(1 if on_six else 2):
            c, t5, t6, t7 = wrist(on_six, bend, inner, heading, s5, c5, k6, k5)
            tilt, t1, t3, t4 = shoulder(P, c, s5, t6 + t7, False, near[0])
            for k3 in range(1 if tilt <= ON_AXIS else 2):
                row = table[count]
                row[0], row[1], row[2] = k6, k5, k3
                fill_shoulder_branch(row[ANGLES:Q], k3, t1, t3, t4, t5, t6, t7)
                joint_values(p, row[ANGLES:Q], d, box, row[Q:])
                count += 1
    return count


def derive(robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray) -> WorkedSolution:
    """Return the formulas and solutions (branches) of the pose T (4, 4), to explain a solve, at one value of the prismatic joint.

    That is the value given to the solver or, without one, the value in the answer box[2]. p: the arm's parameters (`lift_arm`);
    box (4, n): lower and upper limits, the answer to be explained [rad or m], weights.
    """
    place, sign = int(p[LIFT]), p[LIFT + 1]
    value = 0.0 if place < 0 else p[LIFT + 3] if p[LIFT + 2] == GIVEN else box[2, place]
    head, table = np.empty(22), np.empty((8, Q + robot.n))
    count = worked_out(p, T, sign * value, box, head, table)
    marks = np.empty((count, 3), dtype=np.int8)
    looks(p, T, sign * value, np.ascontiguousarray(table[:count, Q:]), marks)
    sheet = Worksheet()
    symbols = _forearm(sheet, p, T, head, sign * value)
    branches = []
    for row, mark in zip(table[:count], marks, strict=True):
        label = ", ".join(f"{name} {SIGNS[int(x)]}" for name, x in zip(PARTS, mark, strict=True))
        q = row[Q:].copy()
        own = Worksheet(sheet.steps)
        _angles(own, symbols, robot, p, head, row)
        branches.append(Branch(label, q, outside_limits(robot, q), tuple(own.steps)))
    free, words = None, ""
    if place >= 0:
        inside = feasible_lifts(p, T, robot.lower[place], robot.upper[place])
        free = Free(place, "lift", tuple(inside), tuple(feasible_lifts(p, T)))
    if _is_far(p, head):
        where = f" at lift {length(value, 6)}" if place >= 0 else ""
        words = (
            f"the pose is {length(float(head[HEAD.moved]), 4)} out of reach{where}; the branches are those of the nearest one with "
            "the same orientation"
        )
    return WorkedSolution(tuple(sheet.steps), tuple(branches), LEGEND, words, free)


def _is_far(p: np.ndarray, head: np.ndarray) -> bool:
    """Return whether the pose is out of reach, so that the formulas are those of the nearest reachable pose."""
    return bool(head[HEAD.room] < -EDGE * (p[A4] + p[A6]))


def _wrist(sheet: Worksheet, p: np.ndarray, T: np.ndarray, head: np.ndarray) -> tuple[Any, Any, dict[str, Any]]:
    """Add the target to the worksheet; return the wrist's rotation, its position, and the angles theta at q = 0, as symbols.

    The position gets a formula if the target is in reach and the base and tool transforms are pure translations, so that the wrist
    has the target's rotation. Otherwise only its numbers are written.
    """
    plain = all(np.abs(p[at : at + 9].reshape(3, 3) - np.eye(3)).max() < ALIGNED for at in (BASE, TOOL))
    of = "the target's rotation" if plain else "the wrist's rotation, in the shoulder's axes"
    columns = [
        sheet.vector(letter, None, "", f"{ordinal} column of {of}", head[k:9:3])
        for k, (letter, ordinal) in enumerate(zip("noa", ("first", "second", "third"), strict=True))
    ]
    R = Matrix.hstack(*columns)
    zeros = zero_angles(sheet, {name: p[JOINTS + 3 * k + 2] for k, name in enumerate(THETA)})
    words = "the wrist, on axis 7 and level with axis 6, from the shoulder at lift 0"
    if _is_far(p, head):
        words = "the wrist of the nearest pose in reach, from the shoulder at lift 0"
    if not plain or _is_far(p, head):
        return R, sheet.vector("w", None, "m", words, head[9:12]), zeros
    point = sheet.vector("p", None, "m", "the target's position", T[:3, 3])
    shift, tool = -p[BASE + 9 : BASE + 12], -p[TOOL + 9 : TOOL + 12]
    if np.abs(shift[:2]).max() < ALIGNED:
        foot = Matrix([0, 0, sheet.given("d1", shift[2], "m", "height of the shoulder at lift 0")])
    else:
        foot = sheet.vector("b", None, "m", "the shoulder at lift 0", shift)
    if np.abs(tool[1:]).max() < ALIGNED:
        tip = Matrix([sheet.given("a7", tool[0], "m", "axis 7 to the tip"), 0, 0])
    else:
        tip = sheet.vector("e", None, "m", "the tip, from axis 7", tool)
    return R, sheet.vector("w", point - foot - R * tip, "m", words, head[9:12]), zeros


def _forearm(sheet: Worksheet, p: np.ndarray, T: np.ndarray, head: np.ndarray, lift: float) -> dict[str, Any]:
    """Add the formulas that all branches share (reach and forearm) to the worksheet; return the symbols that `_angles` needs."""
    a4 = sheet.given("a4", p[A4], "m", "shoulder to axis 5")
    a6 = sheet.given("a6", p[A6], "m", "axis 5 to axis 7")
    d = sheet.given("d", lift, "m", "height of the shoulder above where it is at lift 0")
    R, w, zeros = _wrist(sheet, p, T, head)
    h = sheet.formula("h", d - w[2], "m", "height of the shoulder above the wrist")
    words = "the shoulder, in the wrist's axes"
    s = sheet.vector("s", R.T * Matrix([-w[0], -w[1], h]), "m", words, head[HEAD.shoulder : HEAD.shoulder + 3])
    r = sheet.formula("r", sqrt(s[0] ** 2 + s[1] ** 2), "m", "its distance from axis 7")
    near, far = (sqrt((r + side * a6) ** 2 + s[2] ** 2) for side in (-1, 1))
    words = "room left in the reach; below 0 is out of reach"
    # SymPy must not simplify the minimum in this formula, because comparing its two arguments takes 50 ms.
    room = Min(a4 - near, far - a4, evaluate=False)
    sheet.formula("g", room, "m", words, None if head[HEAD.moved] > 0.0 else head[HEAD.room])
    wide = Max(sqrt((a4 - s[2]) * (a4 + s[2])), Abs(r - a6), evaluate=False)
    words = "size of a4 cos theta_5, clamped to what the elbow can span"
    L = sheet.formula("L", Min(wide, r + a6, evaluate=False), "m", words)
    if head[HEAD.on_six]:
        words = "free: the shoulder lies on axis 6; kept where it is"
        beta = sheet.given("beta", head[HEAD.bend], "rad", words)
        gamma = sheet.given("gamma", head[HEAD.inner], "rad")
    else:
        words = "the triangle of the links a6 and L, which span r"
        u = sheet.formula("u", sqrt(a6 + L - r) * sqrt(a6 + L + r), "m", words)
        v = sheet.formula("v", sqrt(r - Abs(a6 - L)) * sqrt(r + Abs(a6 - L)), "m")
        beta = sheet.formula("beta", 2 * atan2(u, v), "rad", "bend of the elbow", head[HEAD.bend])
        inner = atan2(-L * sin(beta), a6 + L * cos(beta))
        gamma = sheet.angle("gamma", inner, head[HEAD.inner], "rotation due to the bent elbow")
    words = "direction away from the shoulder"
    if sheet.values[r] <= ON_AXIS * (p[A4] + p[A6]):
        chi = sheet.given("chi", head[HEAD.heading], "rad", "free: the shoulder lies on axis 7; kept where it is")
    else:
        chi = sheet.formula("chi", atan2(-s[1], -s[0]), "rad", words, head[HEAD.heading])
    return {"R": R, "s_z": s[2], "L": L, "beta": beta, "gamma": gamma, "chi": chi, "zeros": zeros}


def _angles(
    sheet: Worksheet, symbols: dict[str, Any], robot: Any, p: np.ndarray, head: np.ndarray, row: np.ndarray
) -> None:
    """Add the formulas for the joint angles of one branch to the worksheet; row: the branch in the `table` of `worked_out`."""
    k6, k5, k3 = map(int, row[:3])
    t1, t3, t4, t5, t6, t7 = row[ANGLES:Q]
    R, L, s_z, beta, gamma, chi = (symbols[name] for name in ("R", "L", "s_z", "beta", "gamma", "chi"))
    wrist, elbow = atan2(s_z, L), -beta if k6 else beta
    theta_5 = sheet.angle("theta_5", pi - wrist if k5 else wrist, t5, "the wrist's other side" if k5 else "")
    words = (
        "the elbow is straight"
        if head[HEAD.straight]
        else "elbow: beta or -beta, with the other wrist half a turn away"
    )
    theta_6 = sheet.angle("theta_6", elbow - pi * (-1) ** k6 if k5 else elbow, t6, words)
    theta_7 = sheet.angle("theta_7", (-gamma if k6 else gamma) - chi, t7)
    phi = sheet.formula("phi", theta_6 + theta_7, "rad", "turns the wrist back to the forearm")
    words = "axis 4, in the shoulder's axes"
    m = sheet.vector("m", -R * Matrix([sin(phi), cos(phi), 0]), "", words)
    along, across = (R * Matrix([cos(phi), -sin(phi), 0]))[:2, :], R[:2, 2]
    words = "x and y of the upper arm's direction"
    i = sheet.vector("i", cos(theta_5) * along - sin(theta_5) * across, "", words)
    words = "x and y of the direction across the upper arm and axis 4"
    j = sheet.vector("j", sin(theta_5) * along + cos(theta_5) * across, "", words)
    m_x, m_y = sheet.values[m[0]], sheet.values[m[1]]
    if math.hypot(m_x, m_y) <= 10.0 * ON_AXIS:
        theta_1 = sheet.given("theta_1", t1, "rad", "free: axes 1 and 4 are parallel; kept where it is")
    else:
        theta_1 = sheet.angle("theta_1", atan2(m[1], m[0]) + k3 * pi, t1, "shoulder: this or half a turn further")
    theta_3 = sheet.angle("theta_3", atan2(m[0] * cos(theta_1) + m[1] * sin(theta_1), -m[2]), t3)
    upper = atan2(i[0] * sin(theta_1) - i[1] * cos(theta_1), j[0] * sin(theta_1) - j[1] * cos(theta_1))
    theta_4 = sheet.angle("theta_4", upper, t4)
    for k, theta in enumerate((theta_1, theta_3, theta_4, theta_5, theta_6, theta_7)):
        place, sign = int(p[JOINTS + 3 * k]), p[JOINTS + 3 * k + 1]
        sheet.joint(robot.joint_names[place], theta, place, sign, symbols["zeros"][str(theta)], row[Q + place])
