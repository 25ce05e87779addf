"""Shanmugasundar and Sivaramakrishnan (2012): the closed-form inverse of a 7-joint inspection robot, published beside ours.

International Journal of Computer Applications 58 (18), 2012. Published numbers are data below, with their table or figure.
Millimetres and degrees as in the paper; the toolkit's own calls use metres and radians.
"""

import itertools
import math
from time import perf_counter
from typing import Any

import numpy as np

from ..kernel.loop import OPT_HEAD
from ..kernel.task import POSE
from ..robot.pose import nearest_rotation
from ..robot.robot import Robot
from ..solvers.closed_form import inspection, reach
from ..solvers.closed_form.inspection import Inspection
from ..solvers.solve import Solver, solve
from ..solvers.solve_all import solve_all
from .report import Report
from .shanmugasundar_figures import gallery, self_motion

# Table 2 and Fig 8: the input pose as printed (columns n, o, a; p in mm).
PRINTED_POSE = {
    "n_x": "0.78", "n_y": "-0.06", "n_z": "0.62", "o_x": "-0.63", "o_y": "-0.10", "o_z": "0.77",
    "a_x": "0.02", "a_y": "-0.99", "a_z": "-0.12", "p_x": "461.54", "p_y": "87.12", "p_z": "935.16",
}  # fmt: skip
D1, D2, A4, A6, A7 = 530.0, 220.0, 290.0, 180.0, 45.0  # Table 2, mm
ORIGIN = (
    20.0,
    220.0,
    20.0,
    0.0,
    20.0,
    0.0,
    20.0,
)  # ours: deg, mm, deg ...; the paper does not say where the pose is from
ANGLES = ("theta_1", "theta_3", "theta_4", "theta_5", "theta_6", "theta_7")
MANUAL = (21.37, 18.906, 1.048, 20.673, 2.465, 20.755)  # Table 3
SOFTWARE = (21.4, 18.9, 1.1, 20.6, 2.5, 20.6)  # Table 4 and Fig 8
S6_PRINTED = 0.043  # sample calculation: sin(theta_6)
PI_22_7 = 22.0 / 7.0


def pose_matrix(printed: dict[str, str]) -> np.ndarray:
    """The printed pose as (4, 4), lengths in mm."""
    T = np.eye(4)
    for c, column in enumerate("noap"):
        T[:3, c] = [float(printed[f"{column}_{axis}"]) for axis in "xyz"]
    return T


def printed_fk(q: np.ndarray, lift: float) -> np.ndarray:
    """The paper's matrix (section 3.1) at theta_1, theta_3 .. theta_7 [rad] and lift [mm], as (4, 4).

    n_y, o_y and p_y are printed in part, n_z and o_z only inside the equations; they follow the printed pattern.
    """
    c1, c3, c4, c6 = (math.cos(q[i]) for i in (0, 1, 2, 4))
    s1, s3, s4, s6 = (math.sin(q[i]) for i in (0, 1, 2, 4))
    c45, s45 = math.cos(q[2] + q[3]), math.sin(q[2] + q[3])
    c67, s67 = math.cos(q[4] + q[5]), math.sin(q[4] + q[5])
    along, up = c67 * A7 + c6 * A6, s67 * A7 + s6 * A6
    x = (c1 * c3 * c45 + s1 * s45) * along - c1 * s3 * up + (c1 * c3 * c4 + s1 * s4) * A4
    y = (s1 * c3 * c45 - c1 * s45) * along - s1 * s3 * up + (s1 * c3 * c4 - c1 * s4) * A4
    z = s3 * c45 * along + s3 * c4 * A4 + c3 * up + lift + D1
    return np.array(
        [
            [c1 * (c3 * c45 * c67 - s3 * s67) + s1 * s45 * c67, c1 * (-c3 * c45 * s67 - s3 * c67) - s1 * s45 * s67,
             -c1 * c3 * s45 + s1 * c45, x],
            [s1 * (c3 * c45 * c67 - s3 * s67) - c1 * s45 * c67, s1 * (-c3 * c45 * s67 - s3 * c67) + c1 * s45 * s67,
             -s1 * c3 * s45 - c1 * c45, y],
            [s3 * c45 * c67 + c3 * s67, -s3 * c45 * s67 + c3 * c67, -s3 * s45, z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )  # fmt: skip


def fig4(
    T: np.ndarray,
    lift: float,
    theta_1: float | None = None,
    height: float | None = None,
    signs: tuple[int, int, int, int, int] = (1, 1, 1, 1, 1),
    complement: bool = False,
) -> np.ndarray:
    """Joint angles (6,) [rad] by Fig 4 and eqs. (9), (13), (14) for T (4, 4) [mm]; NaN where a root fails.

    theta_1: None takes the printed 2 atan2(py, px). height: what stands for d1 + d2 (default the sum itself). signs: of
    theta_45, theta_3, theta_6, theta_4, theta_67. complement: a negative sign of an arc sine gives pi - theta, which has the
    same sine, and not the printed -theta. S4, C4 for the misprinted S2, C2. theta_67 is used but never given: its arc
    cosine from n reproduces the printed 23.22 deg.
    """
    n, a, p = T[:3, 0], T[:3, 2], T[:3, 3]
    t1 = 2.0 * math.atan2(p[1], p[0]) if theta_1 is None else theta_1
    s1, c1 = math.sin(t1), math.cos(t1)
    top = D1 + lift if height is None else height

    def arc(function: Any, x: float, sign: int) -> float:
        if not abs(x) <= 1.0 + 1e-12:
            return math.nan
        t = function(max(-1.0, min(1.0, x)))
        return math.pi - t if complement and sign < 0 and function is math.asin else sign * t

    t45 = arc(math.acos, s1 * a[0] - c1 * a[1], signs[0])
    s45 = math.sin(t45) or math.nan
    t3 = arc(math.asin, -a[2] / s45, signs[1])
    s3, c3 = math.sin(t3), math.cos(t3)
    t67 = arc(math.acos, (s1 * n[0] - c1 * n[1]) / s45, signs[4])
    s67, c67 = math.sin(t67), math.cos(t67)
    t6 = arc(math.asin, (-s3 * c1 * p[0] - s3 * s1 * p[1] + c3 * p[2] - c3 * top - s67 * A7) / A6, signs[2])
    t4 = arc(math.asin, (s1 * p[0] - c1 * p[1] - s45 * c67 * A7 - s45 * math.cos(t6) * A6) / A4, signs[3])
    return np.array([t1, t3, t4, t45 - t4, t6, t67 - t6])


def pose_error(T: np.ndarray, goal: np.ndarray) -> tuple[float, float]:
    """Distance [unit of T] and rotation angle [rad] between two poses."""
    trace = float(np.trace(T[:3, :3].T @ goal[:3, :3]))
    skew = T[:3, :3].T @ goal[:3, :3]
    sine = 0.5 * math.hypot(skew[2, 1] - skew[1, 2], skew[0, 2] - skew[2, 0], skew[1, 0] - skew[0, 1])
    return float(np.linalg.norm(T[:3, 3] - goal[:3, 3])), math.atan2(sine, 0.5 * (trace - 1.0))


def reproduce(poses: int = 2000, seed: int = 0) -> Report:
    """Compute the report: `poses` random poses for the formulas of Fig 4."""
    report = Report("shanmugasundar", "Shanmugasundar and Sivaramakrishnan (2012), reproduced")
    robot = Robot.load("inspection_7dof")
    printed = pose_matrix(PRINTED_POSE)
    table_pose = printed.copy()
    table_pose[:3, :3], off = nearest_rotation(printed[:3, :3])
    _model(report, robot)
    _target(report, printed)
    _answers(report, printed, table_pose)
    _formulas(report, robot, poses, seed)
    _sample(report, robot, printed, table_pose, off)
    _speed(report, robot)
    _misprints(report, table_pose)
    return report


def _q(angles: Any, lift: float) -> np.ndarray:
    """Toolkit q [rad, m] of theta_1, theta_3 .. theta_7 [rad] and lift [mm]."""
    return np.insert(np.asarray(angles, dtype=float), 1, lift / 1000.0)


def _model(report: Report, robot: Robot) -> None:
    report.heading("The robot")
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(200):
        q = robot.random_q(rng)
        T = robot.fk(q).homogeneous
        T[:3, 3] *= 1000.0
        worst = max(worst, np.abs(printed_fk(np.delete(q, 1), 1000.0 * q[1]) - T).max())
    report.number("fk_difference_mm", worst)
    report.text(
        "The D-H rows of Table 2 read as classic (distal) parameters, row 2 being a lift along axis 1, give the "
        f"matrix that the paper prints: all 12 elements agree at 200 random configurations within {worst:.1e} (mm "
        "and 1). Our URDF is `inspection_7dof`; its joint limits are our assumption, the paper gives none."
    )


def _target(report: Report, printed: np.ndarray) -> None:
    report.heading("Where the target of Table 2 comes from")
    rows, same = [], {PI_22_7: 0, math.pi: 0}
    poses = {}
    for pi in same:
        angles = np.array([x for i, x in enumerate(ORIGIN) if i != 1]) * pi / 180.0
        poses[pi] = printed_fk(angles, ORIGIN[1])
    for k, (name, text) in enumerate(PRINTED_POSE.items()):
        digits = len(text.split(".")[1])
        values = [float(T[k % 3, k // 3]) for T in poses.values()]
        for pi, value in zip(same, values, strict=True):
            same[pi] += f"{value:.{digits}f}" == text
        rows.append([name, text, *(f"{value:.{digits + 2}f}" for value in values)])
    report.table("target", ["element", "published", "ours, pi = 22/7", "ours, true pi"], rows)
    report.number("target_equal_22_7", same[PI_22_7])
    report.number("target_equal_true_pi", same[math.pi])
    report.text(
        "The paper does not say how it chose the pose. It is the forward kinematics of (20 deg, 220 mm, 20, 0, 20, "
        f"0, 20 deg) with pi = 22/7 in the conversion to radians: {same[PI_22_7]} of 12 printed numbers agree to the "
        f"last digit (with the true pi {same[math.pi]})."
    )


def _answers(report: Report, printed: np.ndarray, table_pose: np.ndarray) -> None:
    report.heading("Tables 3 and 4: the published angles")
    origin = np.radians([x for i, x in enumerate(ORIGIN) if i != 1])
    exact = printed_fk(origin, D2)
    from_table = fig4(printed, D2)
    # The program turns radians into degrees with 22/7 as well; one printed decimal cannot tell.
    rows = [
        ["manual, Table 3", *MANUAL, *_errors(np.radians(MANUAL), table_pose)],
        ["software, Table 4", *SOFTWARE, *_errors(np.radians(SOFTWARE), table_pose)],
        ["ours: Fig 4, no rounding", *np.degrees(from_table), *_errors(from_table, table_pose)],
        ["ours: Fig 4 on the exact 20 deg pose", *np.degrees(fig4(exact, D2)), *_errors(fig4(exact, D2), exact)],
        ["ours: true origin of the pose", *np.degrees(origin), *_errors(origin, table_pose)],
    ]
    report.table(
        "angles", ["source", *(f"{a} (deg)" for a in ANGLES), "position error (mm)", "rotation error (deg)"], rows
    )
    again = [f"{180.0 / PI_22_7 * x:.1f}" == f"{y:.1f}" for x, y in zip(from_table, SOFTWARE, strict=True)]
    report.number("software_angles_reproduced", sum(again))
    report.text(
        "Errors are those of the forward kinematics at lift 220 mm against the pose of Table 2 (its rotation "
        "projected to the nearest one), or against the exact pose in row 4. Fig 4 evaluated without rounding gives "
        f"{sum(again)} of the 6 angles that the software printed. So both columns of Table 4 use the same formulas "
        "and are 1.1 to 1.2 mm and 2 deg off; 'more accurate results' by the software has no basis. Most of the 2 "
        "deg is the two-decimal pose fed into arc functions."
    )
    report.text(
        "Why the wrong theta_1 looks right: theta_3, theta_45 and theta_67 can satisfy the orientation for any "
        "theta_1, and the arm has one free parameter. The sample stands at a turning point of that self-motion "
        "(theta_6 = 0, elbow stretched), where theta_1 moves by a degree for less than half a millimetre of lift "
        "(figure `self-motion.png`)."
    )


def _errors(angles: np.ndarray, goal: np.ndarray) -> tuple[float, float]:
    position, rotation = pose_error(printed_fk(angles, D2), goal)
    return position, math.degrees(rotation)


def _formulas(report: Report, robot: Robot, poses: int, seed: int) -> None:
    report.heading("The formulas of Fig 4 on random poses")
    rng = np.random.default_rng(seed)
    Q = np.array([robot.random_q(rng) for _ in range(poses)])
    T = robot.chain.forward(Q)[0]
    T[:, :3, 3] *= 1000.0
    every = list(itertools.product((1, -1), repeat=5))
    given = [signs for signs in every if signs[0] == signs[4] == 1]  # the paper prints +- for theta_3, theta_4, theta_6
    variants: dict[str, tuple[bool, bool, bool, list]] = {  # true theta_1, d1 + d1, complement branches, sign choices
        "as printed: theta_1 = 2 atan2(py, px), d1 + d1, all signs +": (False, True, False, every[:1]),
        "the same with d1 + d2": (False, False, False, every[:1]),
        "the same, any of the printed signs": (False, False, False, given),
        "true theta_1, d1 + d2, all signs +": (True, False, False, every[:1]),
        "true theta_1, any of the printed signs (-theta)": (True, False, False, given),
        "true theta_1, pi - theta for -theta, both signs of theta_45 and theta_67": (True, False, True, every),
    }
    rows = []
    for name, (true_1, misprint, flip, choices) in variants.items():
        correct = lost = 0
        for q, goal in zip(Q, T, strict=True):
            lift = 1000.0 * q[1]
            best = math.inf
            for signs in choices:
                angles = fig4(goal, lift, q[0] if true_1 else None, 2 * D1 if misprint else None, signs, flip)
                if np.isfinite(angles).all():
                    position, rotation = pose_error(printed_fk(angles, lift), goal)
                    best = min(best, max(position / 1000.0, rotation))
            correct += best < 1e-6
            lost += best == math.inf
        rows.append([name, 100.0 * correct / poses, 100.0 * lost / poses])
    solver = Solver(robot, Inspection())
    p = solver.pack(POSE, True)[OPT_HEAD + robot.n :]
    box = np.vstack([np.full(robot.n, -np.inf), np.full(robot.n, np.inf), robot.home, np.ones(robot.n)])
    T[:, :3, 3] /= 1000.0
    out, broken, count, correct, origin = np.empty((8, robot.n)), np.empty(8), [], 0, 0
    for q, goal in zip(Q, T, strict=True):
        found = inspection.every_branch(p, goal, box, q[1:2], out, broken)
        count.append(found)
        reached = robot.chain.forward(out[:found])[0]
        correct += np.abs(reached - goal).max() < 1e-9
        apart = np.abs(np.remainder(out[:found] - q + math.pi, 2 * math.pi) - math.pi).max(axis=1)
        origin += apart.min() < 1e-6
    rows.append(["complete closed form (ours), every branch", 100.0 * correct / poses, 0.0])
    report.table("formulas", ["formulas", "correct (%)", "no angle at all (%)"], rows)
    off = np.degrees(
        np.abs(np.remainder(2 * np.arctan2(T[:, 1, 3], T[:, 0, 3]) - Q[:, 0] + math.pi, 2 * math.pi) - math.pi)
    )
    report.number("theta_1_median_error_deg", float(np.median(off)))
    report.number("branches", {str(k): int(c) for k, c in zip(*np.unique(count, return_counts=True), strict=True)})
    report.number("origin_among_branches", origin)
    report.text(
        f"{poses} poses of random configurations inside the limits, lift given; correct means 1e-6 (m, rad), for the "
        f"last row every branch within 1e-9. theta_1 = 2 atan2(py, px) is off by {np.median(off):.0f} deg (median) "
        f"and within 2 deg for {100 * np.mean(off < 2):.1f} %. With the right theta_1 and the right second branch (a "
        f"sine leaves theta or pi - theta, not -theta) equations (7) to (13) are sound. Ours finds {min(count)} to "
        f"{max(count)} branches, the original configuration among them for {origin} of {poses}."
    )
    report.figure(
        "branches.png",
        "The eight configurations of one pose at one lift. Only two shapes differ to the eye (rows; the other in "
        "grey): within a row the joints stand half turns apart, as the arrows along their axes show.",
        gallery(robot),
    )


def _sample(report: Report, robot: Robot, printed: np.ndarray, table_pose: np.ndarray, off: float) -> None:
    report.heading("The sample pose, solved")
    raw, goal = printed.copy(), table_pose.copy()
    raw[:3, 3] /= 1000.0
    goal[:3, 3] /= 1000.0
    values = np.linalg.svd(printed[:3, :3], compute_uv=False)
    fixed = solve(robot, raw, Inspection(lift=D2 / 1000.0))
    free = solve(robot, raw)
    middle = solve_all(robot, raw, Inspection(lift="mid"), limits=False)
    at_fixed = solve_all(robot, robot.fk(fixed.q), Inspection(lift=D2 / 1000.0), limits=False)
    p = Inspection().pack(robot)
    spans = inspection.feasible_lifts(p, goal)
    report.number("sample_notice", fixed.notice)
    report.number("out_of_reach_mm", 1000.0 * fixed.position_error)
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
    report.table("sample", ["lift", "status", "theta_1", "lift (mm)", *ANGLES[1:], "error (mm)"], rows)
    report.text(
        f"The printed rotation has singular values {', '.join(f'{x:.4f}' for x in values)}, so it is not a rotation; "
        f"the toolkit projects it and says so. Projected, the pose is {1000 * fixed.position_error:.3f} mm out of "
        f"reach at lift 220 mm ({len(at_fixed)} branches reach the nearest point: the elbow is stretched, so the "
        f"elbow branches merge) and reachable for lifts of {words}: 8 branches at each lift between. A published "
        "answer is absent for all of these: the paper holds the lift at 220 mm and calls it theta_2 = 0."
    )
    exact = robot.fk(_q(np.radians([x for i, x in enumerate(ORIGIN) if i != 1]), D2)).homogeneous
    report.figure(
        "self-motion.png",
        "Solutions of the sample pose over the lift. The published theta_1 belongs to a lift 0.44 mm higher on the "
        "curve of the unrounded pose; the pose as printed cannot be reached at 220 mm at all.",
        self_motion(p, goal, exact, D2, MANUAL[0], ORIGIN[0]),
    )


def _row(q: np.ndarray) -> list[float]:
    degrees = np.degrees(np.remainder(q + math.pi, 2 * math.pi) - math.pi)
    degrees[1] = 1000.0 * q[1]
    return degrees.tolist()


def _speed(report: Report, robot: Robot) -> None:
    report.heading("Time")
    rng = np.random.default_rng(1)
    p = Inspection().pack(robot)
    Q = np.array([robot.random_q(rng) for _ in range(300)])
    P = np.empty((len(Q), 12))
    for k, T in enumerate(robot.chain.forward(Q)[0]):
        inspection.wrist_pose(p, T, P[k])
    lifts, near, sols = Q[:, 1].copy(), np.zeros(6), np.empty((8, 6))
    a4, a6 = p[inspection.A4], p[inspection.A6]
    bound, T = Solver(robot, Inspection()), robot.chain.forward(Q)[0]
    reach.many_branches(P, lifts, a4, a6, near, sols)
    bound(T[0])

    def compiled() -> None:
        reach.many_branches(P, lifts, a4, a6, near, sols)

    def interpreted() -> None:
        for pose, d in zip(P[:20], lifts, strict=False):
            getattr(reach.inspection_branches, "py_func", reach.inspection_branches)(pose, d, a4, a6, near, sols)

    def public() -> None:
        for pose in T:
            bound(pose)

    rows = []
    for name, work, count in (
        ("compiled, 8 branches", compiled, len(Q)),
        ("plain Python, 8 branches", interpreted, 20),
        ("bound solver from Python, lift free, limits", public, len(Q)),
    ):
        times = []
        for _ in range(15):
            start = perf_counter()
            work()
            times.append((perf_counter() - start) / count)
        rows.append([name, "not given", 1e6 * float(np.median(times))])
    report.table("time", ["one inverse", "published", "ours (us, median of 15 runs)"], rows)
    report.text("The paper gives no times. Ours are of this run on this machine.")


def _misprints(report: Report, table_pose: np.ndarray) -> None:
    report.heading("Misprints and gaps")
    wrong = fig4(table_pose, D2)
    s3, c3 = math.sin(wrong[1]), math.cos(wrong[1])
    s67 = math.sin(wrong[4] + wrong[5])
    p, s1, c1 = table_pose[:3, 3], math.sin(wrong[0]), math.cos(wrong[0])
    s6 = [(-s3 * (c1 * p[0] + s1 * p[1]) + c3 * (p[2] - top) - s67 * A7) / A6 for top in (2 * D1, D1 + D2)]
    report.number("s6_with_d1_d1_and_d1_d2", s6)
    rows = [
        [
            "theta_1 = 2 Atan2(py, px), (14)",
            "no basis; the sample hits 21.37 for 20 by its place on the self-motion",
            "theta_1 from the wrist rotation",
        ],
        [
            "d1 + d1 in S6 and C6, Fig 4",
            f"with it S6 = {s6[0]:.2f}: no angle; the printed {S6_PRINTED} needs d1 + d2 (ours {s6[1]:.3f})",
            "d1 + d2",
        ],
        ["S2, C2 in theta_4", "misprint", "S4, C4"],
        ["Atan2(S/C), one argument", "slip of notation", "atan2(S, C)"],
        ["+-Atan2(s, sqrt(1 - s^2))", "-theta has the sine -s", "atan2(s, +-sqrt(1 - s^2)): theta or pi - theta"],
        ["theta_45 = acos(...), (9)", "loses the sign", "+-acos, both are solutions"],
        ["theta_67", "used, never given", "atan2 of its sine and cosine"],
        [
            "theta_2 = 0",
            "joint 2 is the lift, taken as known; the third position equation is never checked",
            "the lift is an input or the free parameter",
        ],
        ["division by s45 and C3", "undefined where they vanish, not mentioned", "ours divides by neither"],
        ["Table 1, Atan2(0, negative)", "gives 0 (sign(0) = 0)", "pi"],
        ["'only positive integers are taken'", "one branch of 8", "all branches, then limits"],
        [
            "theta_4 = 1.048 from 0.018",
            f"asin(0.018) = {math.degrees(math.asin(0.018)):.3f} deg",
            "slip of an intermediate",
        ],
        ["limits, units of theta_2, reach test, timing", "absent", "limits assumed, reach exact, times above"],
    ]
    report.table("misprints", ["published", "what is wrong", "reading used"], rows)
