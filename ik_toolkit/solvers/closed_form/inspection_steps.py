"""The closed form of a spherical shoulder on a lift, worked out step by step for one pose at one lift."""

import math
from typing import Any

import numpy as np

from ...kernel.jit import cached
from ..derivation import Branch, Derivation, Free, Step, Worksheet, joint_step, zero_steps
from .lift_arm import A4, A6, GIVEN, JOINTS, LIFT, joint_values, near_angles, wrist_pose
from .lift_list import feasible_lifts, looks
from .reach import (
    EDGE,
    ON_AXIS,
    fill,
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
SHOULDER, ROOM, MOVED, ON_SIX, STRAIGHT, BEND, INNER, HEADING = (
    12,
    *range(15, 22),
)  # slots of `head`, after the wrist pose
ANGLES, BROKEN, Q = 3, 9, 10  # slots of a branch
BASE, TOOL = 0, 12  # slots of the transforms base -> shoulder axes and tip -> wrist axes: rotation, point
ALIGNED = 1e-12  # [m], or of a rotation: what rounding leaves of axes that are the same
ORDINALS = ("first", "second", "third")
PARTS, SIGNS = ("shoulder", "elbow", "wrist"), {1: "+", 0: "0", -1: "-"}


@cached
def worked_out(p, T, d, box, head, table):
    """Fill head (22,) and table (8, 10 + n) with what the solver computes for T (4, 4) at lift d; return how many branches.

    head: wrist pose (12), the shoulder seen from it (3), room left in the reach and how far the pose was moved to be reached [m],
    then what `forearm` returns of the elbow. table, one row per branch: numbers of elbow, wrist and shoulder, theta_1, 3 to 7, the
    limit broken, q.
    """
    near, P = np.empty(6), np.empty(12)
    near_angles(p, box, near)
    wrist_pose(p, T, P)
    head[15] = inspection_margin(P, d, p[A4], p[A6])
    head[16] = inspection_nearest(P, d, p[A4], p[A6])
    head[:12] = P
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
                fill(row[ANGLES:BROKEN], k3, t1, t3, t4, t5, t6, t7)
                row[BROKEN] = joint_values(p, row[ANGLES:BROKEN], d, box, row[Q:])[0]
                count += 1
    return count


def derive(robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray) -> Derivation:
    """Formulas and branches of the pose T (4, 4) at box[2]'s lift, or the given one; box as in `geometry.copy_limits`."""
    place, sign = int(p[LIFT]), p[LIFT + 1]
    value = 0.0 if place < 0 else p[LIFT + 3] if p[LIFT + 2] == GIVEN else box[2, place]
    head, table = np.empty(22), np.empty((8, Q + robot.n))
    count = worked_out(p, T, sign * value, box, head, table)
    marks = np.empty((count, 3), dtype=np.int8)
    looks(p, T, sign * value, np.ascontiguousarray(table[:count, Q:]), marks)
    given = _given(robot, p, T, head, sign * value)
    first = next((k for k, step in enumerate(given) if step.formula), len(given))
    shared = (*given[first:], *_shared(given, head))
    given = given[:first]
    branches = []
    for row, mark in zip(table[:count], marks, strict=True):
        label = ", ".join(f"{name} {SIGNS[int(x)]}" for name, x in zip(PARTS, mark, strict=True))
        q = row[Q:].copy()
        outside = tuple(robot.outside(q)) if row[BROKEN] > 0.0 else ()
        branches.append(Branch(label, q, outside, _own(robot, p, (*given, *shared), head, row)))
    free, words = None, ""
    near = EDGE * (p[A4] + p[A6])
    if place >= 0:
        inside = feasible_lifts(p, T, box[0, place], box[1, place])
        free = Free(place, "lift", tuple(inside), tuple(feasible_lifts(p, T)))
    if head[ROOM] < -near:
        where = f" at lift {round(1000.0 * value, 6) + 0.0:.6g} mm" if place >= 0 else ""
        words = (
            f"the pose is {1000.0 * head[MOVED]:.4g} mm out of reach{where}; the branches are those of the nearest one with "
            "the same orientation"
        )
    return Derivation(given, shared, tuple(branches), LEGEND, words, free)


def _given(robot: Any, p: np.ndarray, T: np.ndarray, head: np.ndarray, d: float) -> tuple[Step, ...]:
    """What the formulas start from; the last steps are the wrist, where it follows from the target by a shift alone."""
    steps = [
        Step("a4", "", p[A4], "m", "shoulder to axis 5"),
        Step("a6", "", p[A6], "m", "axis 5 to axis 7"),
        Step("d", "", d, "m", "height of the shoulder above where it is at lift 0"),
    ]
    plain = all(np.abs(p[at : at + 9].reshape(3, 3) - np.eye(3)).max() < ALIGNED for at in (BASE, TOOL))
    of = "the target's rotation" if plain else "the wrist's rotation, in the shoulder's axes"
    for k, letter in enumerate("noa"):
        words = f"{ORDINALS[k]} column of {of}"
        steps += [Step(f"{letter}_{x}", "", head[3 * i + k], "", words if not i else "") for i, x in enumerate("xyz")]
    steps += zero_steps({name: p[JOINTS + 3 * k + 2] for k, name in enumerate(THETA)})
    words = "the wrist, on axis 7 and level with axis 6, from the shoulder at lift 0"
    if not plain:
        steps += [Step(f"w_{x}", "", head[9 + i], "m", words if not i else "") for i, x in enumerate("xyz")]
        return tuple(steps)
    steps += [Step(f"p_{x}", "", T[i, 3], "m", "" if i else "the target's position") for i, x in enumerate("xyz")]
    shift, tool = p[BASE + 9 : BASE + 12], p[TOOL + 9 : TOOL + 12]
    up = np.abs(shift[:2]).max() < ALIGNED
    along = np.abs(tool[1:]).max() < ALIGNED
    names = [Step("d1", "", -shift[2], "m", "height of the shoulder at lift 0")] if up else [
        Step(f"b_{x}", "", -shift[i], "m", "" if i else "the shoulder at lift 0") for i, x in enumerate("xyz")
    ]  # fmt: skip
    names += [Step("a7", "", -tool[0], "m", "axis 7 to the tip")] if along else [
        Step(f"e_{x}", "", -tool[i], "m", "" if i else "the tip, from axis 7") for i, x in enumerate("xyz")
    ]  # fmt: skip
    sheet = Worksheet((*steps, *names))
    for i, x in enumerate("xyz"):
        formula = f"p_{x}" + (" - d1" * (i == 2) if up else f" - b_{x}")
        formula += f" - a7*n_{x}" if along else f" - e_x*n_{x} - e_y*o_{x} - e_z*a_{x}"
        sheet.add(f"w_{x}", formula, head[9 + i], "m", "" if i else words)
    return (*steps, *names, *sheet.steps)


def _shared(given: tuple[Step, ...], head: np.ndarray) -> tuple[Step, ...]:
    """Reach and forearm: the formulas that all branches have in common."""
    sheet = Worksheet(given)
    sheet.add("h", "d - w_z", None, "m", "height of the shoulder above the wrist")
    for k, (axis, letter) in enumerate(zip("xyz", "noa", strict=True)):
        formula = f"{letter}_z*h - {letter}_x*w_x - {letter}_y*w_y"
        sheet.add(f"s_{axis}", formula, head[SHOULDER + k], "m", "" if k else "the shoulder, in the wrist's axes")
    sheet.add("r", "hypot(s_x, s_y)", None, "m", "its distance from axis 7")
    moved = head[MOVED] > 0.0
    room = "min(a4 - hypot(r - a6, s_z), hypot(r + a6, s_z) - a4)"
    sheet.add("g", room, None if moved else head[ROOM], "m", "room left in the reach; below 0 is out of reach")
    span = "min(max(sqrt((a4 - s_z)*(a4 + s_z)), abs(r - a6)), r + a6)"
    sheet.add("L", span, None, "m", "size of a4 cos theta_5, clamped to what the elbow can span")
    if head[ON_SIX]:
        sheet.add("beta", "", head[BEND], "rad", "free: the shoulder lies on axis 6; kept where it is")
        sheet.add("gamma", "", head[INNER], "rad")
    else:
        sheet.add(
            "u", "sqrt(a6 + L - r)*sqrt(a6 + L + r)", None, "m", "the triangle of the links a6 and L, which span r"
        )
        sheet.add("v", "sqrt(r - abs(a6 - L))*sqrt(r + abs(a6 - L))", None, "m")
        sheet.add("beta", "2*atan2(u, v)", head[BEND], "rad", "bend of the elbow")
        sheet.add(
            "gamma", "atan2(-(L*sin(beta)), a6 + L*cos(beta))", head[INNER], "rad", "rotation due to the bent elbow"
        )
    sheet.add("chi", "atan2(-s_y, -s_x)", head[HEADING], "rad", "direction away from the shoulder")
    return tuple(sheet.steps)


def _own(robot: Any, p: np.ndarray, before: tuple[Step, ...], head: np.ndarray, row: np.ndarray) -> tuple[Step, ...]:
    """Formulas of one branch."""
    sheet = Worksheet(before)
    k6, k5, _ = row[:3]
    t1, t3, t4, t5, t6, t7 = row[ANGLES:BROKEN]
    sheet.angle("theta_5", "pi - atan2(s_z, L)" if k5 else "atan2(s_z, L)", t5, "the wrist's other side" if k5 else "")
    words = "the elbow is straight" if head[STRAIGHT] else "elbow: beta or -beta, with the other wrist half a turn away"
    sheet.angle("theta_6", (("beta - pi", "pi - beta") if k5 else ("beta", "-beta"))[int(k6)], t6, words)
    sheet.angle("theta_7", "-gamma - chi" if k6 else "gamma - chi", t7)
    sheet.add("phi", "theta_6 + theta_7", None, "rad", "turns the wrist back to the forearm")
    for i, axis in enumerate("xyz"):
        words = "" if i else "axis 4, in the shoulder's axes"
        sheet.add(f"m_{axis}", f"-(n_{axis}*sin(phi) + o_{axis}*cos(phi))", None, "", words)
    for i, axis in enumerate("xy"):
        along = f"(n_{axis}*cos(phi) - o_{axis}*sin(phi))"
        words = "" if i else "x and y of the upper arm's direction, i, and of the one across it and axis 4, j"
        sheet.add(f"i_{axis}", f"cos(theta_5)*{along} - sin(theta_5)*a_{axis}", None, "", words)
        sheet.add(f"j_{axis}", f"sin(theta_5)*{along} + cos(theta_5)*a_{axis}")
    tilt = math.hypot(sheet.values["m_x"], sheet.values["m_y"])
    if tilt <= 10.0 * ON_AXIS:
        sheet.add("theta_1", "", t1, "rad", "free: axes 1 and 4 are parallel; kept where it is")
    else:
        turn = ("", " - pi" if math.atan2(sheet.values["m_y"], sheet.values["m_x"]) >= 0.0 else " + pi")[int(row[2])]
        sheet.angle("theta_1", f"atan2(m_y, m_x){turn}", t1, "shoulder: this or half a turn further")
    sheet.angle("theta_3", "atan2(m_x*cos(theta_1) + m_y*sin(theta_1), -m_z)", t3)
    sheet.angle("theta_4", "atan2(i_x*sin(theta_1) - i_y*cos(theta_1), j_x*sin(theta_1) - j_y*cos(theta_1))", t4)
    for k, name in enumerate(THETA):
        i = int(p[JOINTS + 3 * k])
        joint_step(sheet, i, name, p[JOINTS + 3 * k + 1], row[Q + i], robot.joint_names[i])
    return tuple(sheet.steps)
