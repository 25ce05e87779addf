"""Writes out the closed form of two parallel revolute axes step by step for one point."""

import math
from typing import Any

import numpy as np
from sympy import Abs, Max, Min, atan2, cos, sin, sqrt

from ...text import length
from ..explain.worked_solution import Branch, WorkedSolution, outside_limits
from ..explain.worksheet import Worksheet, zero_angles
from .reach import ANGLES, HEIGHT, L1, L2, ON_AXIS, list_planar

BESIDE = "newton"  # name of the solver shown beside the closed form, because Chinyai's paper compares the two
LABELS = {1: "elbow right (+)", -1: "elbow left (-)", 0: "elbow straight or folded"}
LEGEND = "Elbow: the sign of theta_2, that is, the side of the elbow as seen along the line from the first joint to the target."


def derive_planar(robot: Any, p: np.ndarray, T: np.ndarray, box: np.ndarray) -> WorkedSolution:
    """Return the formulas and branches of two parallel revolute axes for the position of T (4, 4).

    p: the arm's parameters (`reach`); box (4, 2): lower and upper limits, the answer to be explained [rad], weights.
    """
    q, broken, marks = np.zeros((2, 2)), np.zeros(2), np.zeros((2, 3), dtype=np.int8)
    count, _ = list_planar(p, T, box, q, broken, marks)
    angles = p[ANGLES::2][:2] * q + p[ANGLES + 1 :: 2][:2]  # theta = sign q + offset for both joints of each solution
    # x and y of the target in the arm's plane, and its height above the plane
    point = p[:9].reshape(3, 3) @ T[:3, 3] + p[9:12]
    sheet = Worksheet()
    l1 = sheet.given("l1", p[L1], "m", "first link")
    l2 = sheet.given("l2", p[L2], "m", "second link, to the tip")
    x = sheet.given("x", point[0], "m", "target in the arm's plane, from the first joint")
    y = sheet.given("y", point[1], "m")
    zeros = zero_angles(sheet, {"theta_1": p[ANGLES + 1], "theta_2": p[ANGLES + 3]})
    r = sheet.formula("r", sqrt(x**2 + y**2), "m", "distance of the target from the first joint")
    margin = Min(l1 + l2 - r, r - Abs(l1 - l2), evaluate=False)
    g = sheet.formula("g", margin, "m", "room left in the reach: below 0, out of reach")
    room = sheet.values[g]
    psi = sheet.formula("psi", atan2(y, x), "rad", "direction of the target")
    if room < 0.0:
        words = "distance of the nearest point that the arm reaches"
        r = sheet.formula("rho", Min(Max(r, Abs(l1 - l2)), l1 + l2, evaluate=False), "m", words)
    sheet.formula("c2", (r**2 - l1**2 - l2**2) / (2 * l1 * l2), "", "cosine of theta_2, by the law of cosines")
    u = sheet.formula("u", sqrt(l1 + l2 - r) * sqrt(l1 + l2 + r), "m", "the same triangle, without cancellation")
    v = sheet.formula("v", sqrt(r - Abs(l1 - l2)) * sqrt(r + Abs(l1 - l2)), "m")
    folded = max(sheet.values[r], abs(p[L1] - p[L2])) <= ON_AXIS * (p[L1] + p[L2])
    branches = []
    for k in range(count):
        own = Worksheet(sheet.steps)
        side = int(marks[k, 1])
        bend = 2 * atan2(u, v) * (1 if side >= 0 else -1)
        theta_2 = own.angle("theta_2", bend, angles[k, 1], "has that cosine")
        if side:
            inner = atan2(l2 * sin(theta_2), l1 + l2 * cos(theta_2))
            beta = own.formula("beta", inner, "rad", "rotation due to the bent elbow")
        else:
            turned = abs(math.sin(0.5 * angles[k, 1])) > 0.5 and p[L1] < p[L2]
            beta = own.given("beta", math.pi * turned, "rad", "the tip is on the line of the first link")
        if folded:
            words = "free: the links fold back onto the base; kept where it is"
            theta_1 = own.given("theta_1", angles[k, 0], "rad", words)
        else:
            theta_1 = own.angle("theta_1", psi - beta, angles[k, 0])
        for i, theta in enumerate((theta_1, theta_2)):
            own.joint(robot.joint_names[i], theta, i, p[ANGLES + 2 * i], zeros[str(theta)], q[k, i])
        branches.append(Branch(LABELS[side], q[k], outside_limits(robot, q[k]), tuple(own.steps)))
    return WorkedSolution(
        tuple(sheet.steps), tuple(branches), LEGEND, _words(robot, room, point[2] - p[HEIGHT]), None, BESIDE
    )


def _words(robot: Any, room: float, off: float) -> str:
    """Return a sentence that says by how much the target is out of reach, or ''.

    room: distance [m] to the edge of the reach, negative outside; off: distance [m] from the arm's plane.
    """
    near = 1e-9 * robot.reach
    parts = []
    if room < -near:
        parts.append(f"the point is {length(-room, 4)} out of reach in the arm's plane")
    if abs(off) > near:
        parts.append(f"the point lies {length(abs(off), 4)} off the arm's plane")
    return f"{' and '.join(parts)}; the branches are those of the nearest point that the arm reaches" if parts else ""
