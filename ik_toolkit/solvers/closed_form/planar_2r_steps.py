"""The closed form of two parallel axes, worked out step by step for one point."""

from typing import Any

import numpy as np

from ...kernel.jit import cached
from ..derivation import Branch, Derivation, Step, Worksheet, joint_step, zero_steps
from .planar_arm import ANGLES, L1, L2, every_branch, to_plane
from .reach import ON_AXIS, planar_branches, planar_margin

BESIDE = "newton"  # what Chinyai compares it with
LABELS = {1: "elbow right (+)", -1: "elbow left (-)", 0: "elbow straight or folded"}
LEGEND = "Elbow: the sign of theta_2, that is, the side of the elbow as seen along the line from the first joint to the target."


@cached
def worked_out(p, T, box, head, sols):
    """Fill head (4,) with x, y, height off the arm's plane and room left in the reach [m], sols (2, 2) with the branches.

    Returns how many branches there are.
    """
    x, y, off = to_plane(p, T)
    head[0], head[1], head[2] = x, y, off
    head[3] = planar_margin(x, y, p[L1], p[L2])
    return planar_branches(x, y, p[L1], p[L2], p[ANGLES] * box[2, 0] + p[ANGLES + 1], sols)


def derive(robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray) -> Derivation:
    """Formulas and branches of the point of T (4, 4); box as in `geometry.copy_limits`."""
    head, sols = np.empty(4), np.empty((2, 2))
    count = worked_out(p, T, box, head, sols)
    q, broken, marks = np.empty((2, 2)), np.empty(2), np.empty((2, 3), dtype=np.int8)
    every_branch(p, T, box, q, broken, marks)
    x, y, off, room = head
    given = (
        Step("l1", "", p[L1], "m", "first link"),
        Step("l2", "", p[L2], "m", "second link, to the tip"),
        Step("x", "", x, "m", "target in the arm's plane, from the first joint"),
        Step("y", "", y, "m"),
        *zero_steps({"theta_1": p[ANGLES + 1], "theta_2": p[ANGLES + 3]}),
    )
    sheet = Worksheet(given)
    sheet.add("r", "hypot(x, y)", None, "m", "distance of the target from the first joint")
    sheet.add("g", "min(l1 + l2 - r, r - abs(l1 - l2))", room, "m", "room left in the reach: below 0, out of reach")
    sheet.add("psi", "atan2(y, x)", None, "rad", "direction of the target")
    if room >= 0.0:
        sheet.add("c2", "(r**2 - l1**2 - l2**2)/(2*l1*l2)", None, "", "cosine of theta_2, by the law of cosines")
    sheet.add("u", "sqrt(l1 + l2 - r)*sqrt(l1 + l2 + r)", None, "m", "the same triangle, without cancellation")
    sheet.add("v", "sqrt(r - abs(l1 - l2))*sqrt(r + abs(l1 - l2))", None, "m")
    branches = []
    for k in range(count):
        own = Worksheet((*given, *sheet.steps))
        side = int(marks[k, 1])
        own.add("theta_2", "2*atan2(u, v)" if side >= 0 else "-2*atan2(u, v)", sols[k, 1], "rad", "has that cosine")
        own.add("beta", "atan2(l2*sin(theta_2), l1 + l2*cos(theta_2))", None, "rad", "rotation due to the bent elbow")
        if max(sheet.values["r"], abs(p[L1] - p[L2])) <= ON_AXIS * (p[L1] + p[L2]):
            own.add("theta_1", "", sols[k, 0], "rad", "free: the links fold back onto the base; kept where it is")
        else:
            own.angle("theta_1", "psi - beta", sols[k, 0])
        for i in range(2):
            joint_step(own, i, f"theta_{i + 1}", p[ANGLES + 2 * i], q[k, i], robot.joint_names[i])
        outside = tuple(robot.outside(q[k])) if broken[k] > 0.0 else ()
        branches.append(Branch(LABELS[side], q[k], outside, tuple(own.steps)))
    words = _words(robot, room, off)
    return Derivation(given, tuple(sheet.steps), tuple(branches), LEGEND, words, None, BESIDE)


def _words(robot: Any, room: float, off: float) -> str:
    """What is wrong with the target, or ''."""
    near = 1e-9 * robot.reach
    parts = []
    if room < -near:
        parts.append(f"the point is {-1000.0 * room:.4g} mm out of reach in the arm's plane")
    if abs(off) > near:
        parts.append(f"the point lies {1000.0 * abs(off):.4g} mm off the arm's plane")
    return f"{' and '.join(parts)}; the branches are those of the nearest point that the arm reaches" if parts else ""
