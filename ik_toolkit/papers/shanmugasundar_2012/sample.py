"""The sample pose of Shanmugasundar and Sivaramakrishnan (2012): its solutions, and why the published angle looks right."""

import math
from typing import Any

import numpy as np

from ...robot.robot import Robot
from ...solvers.closed_form import inspection
from ...solvers.closed_form.inspection import Inspection
from ...solvers.solve import solve, solve_all
from ..report import ROUNDING, Report
from .figures import self_motion
from .formulas import ANGLES, D2, MANUAL, ORIGIN


def _q(angles: Any, lift: float) -> np.ndarray:
    """Return q of the toolkit [rad, m] from theta_1, theta_3 to theta_7 [rad] and the lift [mm]."""
    return np.insert(np.asarray(angles, dtype=float), 1, lift / 1000.0)


def sample(report: Report, robot: Robot, printed: np.ndarray, table_pose: np.ndarray) -> None:
    """Add the section on the sample pose to the report.

    printed: the pose as printed (4, 4) [mm]; table_pose: the printed pose with its rotation made exact.
    """
    report.heading("The sample pose, solved")
    raw, goal = printed.copy(), table_pose.copy()
    raw[:3, 3] /= 1000.0
    goal[:3, 3] /= 1000.0
    values = np.linalg.svd(printed[:3, :3], compute_uv=False)
    fixed = solve(robot, raw, Inspection(lift=D2 / 1000.0))
    free = solve(robot, raw)
    middle = solve_all(robot, raw, Inspection(lift="mid"), limits=False)
    p = Inspection().pack(robot)
    nearest, beyond = inspection.nearest_pose(p, goal, D2 / 1000.0)
    at_fixed = solve_all(robot, nearest, Inspection(lift=D2 / 1000.0), limits=False)
    spans = inspection.feasible_lifts(p, goal)
    report.number("sample_notice", fixed.notice)
    report.number("out_of_reach_mm", 1000.0 * beyond)
    report.number("feasible_lifts_mm", [[1000.0 * x for x in span] for span in spans])
    words = " and ".join(f"{1000 * a:.3f} to {1000 * b:.3f} mm" for a, b in spans)
    rows = [
        ["lift 220 mm (as published)", fixed.status.name, *_row(fixed.q), 1000.0 * fixed.position_error],
        ["lift free, nearest home", free.status.name, *_row(free.q), 1000.0 * free.position_error],
    ]
    rows += [
        [f"middle lift, branch {k + 1}", "CONVERGED", *_row(q), 1000.0 * e]
        for k, (q, e) in enumerate(zip(middle, middle.position_error, strict=True))
    ]
    report.table("sample", ["lift", "status", "theta_1", "lift (mm)", *ANGLES[1:], "error (mm)"], rows, ROUNDING)
    report.text(
        f"The printed rotation has singular values {', '.join(f'{x:.4f}' for x in values)}, so it is not a rotation; "
        f"the toolkit projects it and reports that. Projected, the pose is {1000 * beyond:.3f} mm out of "
        f"reach at lift 220 mm ({len(at_fixed)} branches reach the nearest point: the elbow is stretched, so the "
        f"elbow branches merge) and reachable for lifts of {words}: 8 branches at each lift between. The "
        "paper gives no answer for any of these: it holds the lift at 220 mm and calls it theta_2 = 0."
    )
    exact = robot.fk(_q(np.radians([x for i, x in enumerate(ORIGIN) if i != 1]), D2)).homogeneous
    higher = report.number("lift_of_published_theta_1_mm", _lift_of(p, exact, math.radians(MANUAL[0])))
    report.text(
        "Why the wrong theta_1 looks right: theta_3, theta_45 and theta_67 can satisfy the orientation for any "
        "theta_1, and the arm has one free parameter. The sample stands at a turning point of that self-motion "
        f"(theta_6 = 0, elbow stretched): on the unrounded pose theta_1 = {MANUAL[0]} deg is exact at a lift of "
        f"{higher:.3f} mm."
    )
    caption = (
        f"Solutions of the sample pose over the lift. The published theta_1 belongs to a lift {higher - D2:.2f} mm "
        "higher on the curve of the unrounded pose; the pose as printed cannot be reached at 220 mm at all."
    )
    report.figure("self-motion.png", caption, self_motion, p, goal, exact, D2, MANUAL[0], ORIGIN[0])


def _lift_of(p: np.ndarray, T: np.ndarray, theta_1: float) -> float:
    """Return the lift (prismatic joint) [mm], just above the least feasible one, at which one of two branches has theta_1 [rad]."""
    box = np.vstack([np.full(7, -np.inf), np.full(7, np.inf), np.zeros(7), np.ones(7)])
    out, broken = np.empty((8, 7)), np.empty(8)
    low = inspection.feasible_lifts(p, T)[0][0]
    high = low + 0.01
    for _ in range(50):
        middle = 0.5 * (low + high)
        q = out[: inspection.every_branch(p, T, box, np.array([middle]), out, broken)]
        upper = max(x[0] for x in q if abs(x[4]) < math.pi / 2 and abs(x[0] - theta_1) < math.pi / 2)
        low, high = (middle, high) if upper < theta_1 else (low, middle)
    return float(1000.0 * low)


def _row(q: np.ndarray) -> list[float]:
    degrees = np.degrees(np.remainder(q + math.pi, 2 * math.pi) - math.pi)
    degrees[1] = 1000.0 * q[1]
    return (np.round(degrees, 4) + 0.0).tolist()
