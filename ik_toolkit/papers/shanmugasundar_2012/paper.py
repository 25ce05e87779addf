"""Report on Shanmugasundar and Sivaramakrishnan (2012), the closed-form inverse of a 7-joint inspection robot.

The paper appeared in the International Journal of Computer Applications 58 (18), 2012. Its numbers are in formulas.py, in
millimetres and degrees; the toolkit's own calls use metres and radians.
"""

import itertools
import math
from typing import Any

import numpy as np

from ...kernel.counted_error import KIND
from ...kernel.records import SIZE
from ...robot.robot import Robot
from ...robot.rotation import nearest_rotation
from ...solvers.closed_form import inspection, reach
from ...solvers.closed_form.inspection import Inspection
from ...solvers.solve import Solver
from ...study.benchmark import wilson
from ..report import ROUNDING, Report, Work, rounds, shipped_table, spread
from . import formulas as paper
from .figures import gallery
from .sample import sample
from .weld import weld


def reproduce(poses: int = 2000, seed: int = 0, turns: int = 24) -> Report:
    """Compute the report, with a number of random poses for the formulas of Fig 4, and of turns of the tool for the welds."""
    with Report("shanmugasundar", "Shanmugasundar and Sivaramakrishnan (2012), reproduced") as report:
        robot = Robot.load("inspection_7dof")
        printed = paper.pose_matrix(paper.PRINTED_POSE)
        table_pose = printed.copy()
        table_pose[:3, :3] = nearest_rotation(printed[:3, :3])[0]
        model(report, robot)
        _target(report, printed)
        answers(report, printed, table_pose)
        formulas(report, robot, poses, seed)
        sample(report, robot, printed, table_pose)
        _speed(report, robot)
        _misprints(report, printed)
        weld(report, robot, turns)
    return report


def model(report: Report, robot: Robot) -> None:
    """Add the section on the paper's table of D-H parameters to the report."""
    report.heading("The robot")
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(200):
        q = robot.random_q(rng)
        T = robot.fk(q).homogeneous
        T[:3, 3] *= 1000.0
        worst = max(worst, np.abs(paper.printed_fk(np.delete(q, 1), 1000.0 * q[1]) - T).max())
    report.number("fk_difference_mm", worst)
    rows = []
    for k, (printed, row) in enumerate(zip(paper.TABLE_2, shipped_table(robot.name).rows, strict=True)):
        d = f"{1000 * row.d:g}" if k != 1 else f"lift, {1000 * robot.lower[1]:g} to {1000 * robot.upper[1]:g}"
        cells = (f"{math.degrees(row.alpha):g}", f"{1000 * row.a:g}", d)
        rows.append([k + 1, *(f"{a:g} / {b}" for a, b in zip(printed, cells, strict=True))])
    report.table("table_2", ["row, printed / ours", "alpha (deg)", "a (mm)", "d (mm)"], rows)
    report.text(
        "The D-H rows of Table 2 read as classic (distal) parameters, row 2 being a lift along axis 1, give the "
        f"matrix that the paper prints: all 12 elements agree at 200 random configurations within {max(worst, ROUNDING):.0e} (mm "
        "and 1). Our URDF is `inspection_7dof`; its joint limits are our assumption, the paper gives none."
    )


def _target(report: Report, printed: np.ndarray) -> None:
    report.heading("Where the target of Table 2 comes from")
    rows, same = [], {paper.PI_22_7: 0, math.pi: 0}
    poses = {}
    for pi in same:
        angles = np.array([x for i, x in enumerate(paper.ORIGIN) if i != 1]) * pi / 180.0
        poses[pi] = paper.printed_fk(angles, paper.ORIGIN[1])
    for k, (name, text) in enumerate(paper.PRINTED_POSE.items()):
        digits = len(text.split(".")[1])
        values = [float(T[k % 3, k // 3]) for T in poses.values()]
        for pi, value in zip(same, values, strict=True):
            same[pi] += f"{value:.{digits}f}" == text
        rows.append([name, text, *(f"{value:.{digits + 2}f}" for value in values)])
    report.table("target", ["element", "published", "ours, pi = 22/7", "ours, true pi"], rows)
    report.number("target_equal_22_7", same[paper.PI_22_7])
    report.number("target_equal_true_pi", same[math.pi])
    report.text(
        "The paper does not say how it chose the pose. It is the forward kinematics of (20 deg, 220 mm, 20, 0, 20, "
        f"0, 20 deg) with pi = 22/7 in the conversion to radians: {same[paper.PI_22_7]} of 12 printed numbers agree to the "
        f"last digit (with the true pi {same[math.pi]})."
    )


def answers(report: Report, printed: np.ndarray, table_pose: np.ndarray) -> None:
    """Add the section on the published angles to the report.

    printed: the pose as printed (4, 4) [mm]. table_pose: the same pose with its rotation made exact.
    """
    report.heading("Tables 3 and 4: the published angles")
    origin = np.radians([x for i, x in enumerate(paper.ORIGIN) if i != 1])
    exact = paper.printed_fk(origin, paper.D2)
    table = paper.fig4(printed, paper.D2)
    t1, t3, t4, t5, t6, t7 = table
    degrees = 180.0 / paper.PI_22_7  # Here too the paper's program uses 22/7 for pi.
    program = [f"{degrees * x:.1f}" for x in table]
    same = sum(a == f"{b:.1f}" for a, b in zip(program, paper.SOFTWARE, strict=True))
    report.number("software_angles_reproduced", same)
    hand, slip = "three-digit intermediate values", "slip of an intermediate"
    reasons = ("2 atan2 of (87.09, 461.57), the pose before rounding", hand, slip, hand, hand, hand)
    rows: list[list[Any]] = [
        [f"{name} (deg)", manual, f"{software:.1f}", f"{degrees * x:.3f}", f"{math.degrees(true):.0f}", reason]
        for name, manual, software, x, true, reason in zip(
            paper.ANGLES, paper.MANUAL, paper.SOFTWARE, table, origin, reasons, strict=True
        )
    ]
    true = (origin[2] + origin[3], math.sin(origin[1]), origin[4] + origin[5], math.sin(origin[4]), math.sin(origin[2]))
    lift = f"lift {paper.D2:g} mm"
    rows.insert(1, ["theta_2", "0", "0", lift, lift, "joint 2 slides: it has a lift and no angle"])
    rows += [
        ["theta_45 (deg)", paper.THETA_45, "", f"{degrees * (t4 + t5):.3f}", f"{math.degrees(true[0]):.0f}", hand],
        ["sin theta_3", paper.S3, "", f"{math.sin(t3):.4f}", f"{true[1]:.4f}", hand],
        ["theta_67 (deg)", paper.THETA_67, "", f"{degrees * (t6 + t7):.3f}", f"{math.degrees(true[2]):.0f}", hand],
        ["sin theta_6", paper.S6, "", f"{math.sin(t6):.4f}", f"{true[3]:.4f}", hand],
        ["sin theta_4", paper.S4, "", f"{math.sin(t4):.4f}", f"{true[4]:.4f}", hand],
    ]
    head = ["number", "manual, Table 3", "software, Table 4", "ours: Fig 4, no rounding", "true origin"]
    report.table("published_angles", [*head, "why the manual differs from ours"], rows)
    on_exact = paper.fig4(exact, paper.D2)
    cases = {
        "manual, Table 3": (np.radians(paper.MANUAL), table_pose),
        "software, Table 4": (np.radians(paper.SOFTWARE), table_pose),
        "ours: Fig 4, no rounding": (table, table_pose),
        "ours: Fig 4 on the exact 20 deg pose": (on_exact, exact),
        "ours: true origin of the pose": (origin, table_pose),
    }
    errors = {name: _errors(*case) for name, case in cases.items()}
    rows = [[name, *(float(f"{x:.12g}") for x in error)] for name, error in errors.items()]
    report.table("errors", ["angles", "position error (mm)", "rotation error (deg)"], rows, ROUNDING)
    (manual_p, manual_r), (software_p, software_r), *_ = errors.values()
    report.text(
        "Errors are those of the forward kinematics at lift 220 mm against the pose of Table 2 (its rotation "
        "projected to the nearest one), or against the exact pose in row 4. Fig 4 evaluated without rounding gives "
        f"{same} of the 6 angles that the software printed, so both columns of "
        f"Table 4 come from the same formulas; they miss the pose by {manual_p:.2f} and {software_p:.2f} mm, "
        f"{manual_r:.2f} and {software_r:.2f} deg. The claim of 'more accurate results' by the software has no basis. "
        "Most of the "
        "rotation error is the two-decimal pose fed into arc functions: on the exact pose it is 0."
    )


def _errors(angles: np.ndarray, goal: np.ndarray) -> tuple[float, float]:
    position, rotation = paper.pose_error(paper.printed_fk(angles, paper.D2), goal)
    return position, math.degrees(rotation)


def formulas(report: Report, robot: Robot, poses: int, seed: int) -> None:
    """Add the section that tries the printed formulas on random poses to the report."""
    report.heading("The formulas of Fig 4 on random poses")
    rng = np.random.default_rng(seed)
    Q = np.array([robot.random_q(rng) for _ in range(poses)])
    T = robot.chain.forward(Q)[0]
    T[:, :3, 3] *= 1000.0
    every = list(itertools.product((1, -1), repeat=5))
    # The sign combinations that the paper gives: theta_3, theta_4 and theta_6 with either sign, the others positive.
    given = [signs for signs in every if signs[0] == signs[4] == 1]
    # For each variant: whether the true theta_1 is used, whether d1 is counted twice, whether pi - theta is used for a negative
    # sign, and the combinations of signs.
    variants: dict[str, tuple[bool, bool, bool, list]] = {
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
        height = 2 * paper.D1 if misprint else None
        for q, goal in zip(Q, T, strict=True):
            lift = 1000.0 * q[1]
            best = math.inf
            for signs in choices:
                angles = paper.fig4(goal, lift, q[0] if true_1 else None, height, signs, flip)
                if np.isfinite(angles).all():
                    position, rotation = paper.pose_error(paper.printed_fk(angles, lift), goal)
                    best = min(best, max(position / 1000.0, rotation))
            correct += best < 1e-6
            lost += best == math.inf
        rows.append([name, _rate(correct, poses), _rate(lost, poses)])
    solver = Solver(robot, Inspection())
    p = solver.plan.orders((KIND.pose,), True)[SIZE.weights + robot.n :]
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
    rows.append(["complete closed form (ours), every branch", _rate(correct, poses), _rate(count.count(0), poses)])
    report.table("formulas", ["formulas", "correct (%, 95 % interval)", "no angle at all (%, 95 % interval)"], rows)
    turn = 2 * np.arctan2(T[:, 1, 3], T[:, 0, 3]) - Q[:, 0]
    off = np.degrees(np.abs(np.remainder(turn + math.pi, 2 * math.pi) - math.pi))
    report.number("theta_1_median_error_deg", float(np.median(off)))
    report.number("branches", {str(k): int(c) for k, c in zip(*np.unique(count, return_counts=True), strict=True)})
    report.number("origin_among_branches", origin)
    report.text(
        f"{poses} poses of random configurations inside the limits, lift given; correct means 1e-6 (m, rad), for the "
        f"last row every branch within 1e-9. theta_1 = 2 atan2(py, px) is off by {np.median(off):.0f} deg (median) "
        f"and within 2 deg for {_rate(int((off < 2).sum()), poses)} %. With the right theta_1 and the right second branch (a "
        f"sine leaves theta or pi - theta, not -theta) equations (7) to (13) are sound. Ours finds "
        f"{' or '.join(report.data['branches'])} branches each time, the original configuration among them for {origin} of {poses}."
    )
    caption = (
        "The eight configurations of one pose at one lift. Only two shapes look different (rows; the other in "
        "grey): within a row the joints differ by half turns, as the arrows along their axes show."
    )
    report.figure("branches.png", caption, gallery, robot)


def _rate(successes: int, trials: int) -> str:
    """Return a percentage with its Wilson interval, as text."""
    low, high = wilson(successes, trials)
    return f"{100 * successes / trials:.4g} [{100 * low:.3g}-{100 * high:.3g}]"


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

    works: dict[str, Work] = {
        "compiled, 8 branches": (compiled, len(Q)),
        "plain Python (small helpers compiled), 8 branches": (interpreted, 20),
        "bound solver from Python, lift free, limits": (public, len(Q)),
    }
    rows = [[name, "not given", spread(1e6 * times)] for name, times in rounds(works, 15).items()]
    report.table("time", ["one inverse", "published", "ours (us)"], rows)
    report.text(
        "The paper gives no times. Ours: median [min-max] of 15 interleaved rounds, processor time, on this machine."
    )


def _misprints(report: Report, printed: np.ndarray) -> None:
    report.heading("Misprints and gaps")
    wrong = paper.fig4(printed, paper.D2)
    s3, c3 = math.sin(wrong[1]), math.cos(wrong[1])
    s67 = math.sin(wrong[4] + wrong[5])
    p, s1, c1 = printed[:3, 3], math.sin(wrong[0]), math.cos(wrong[0])
    tops = (2 * paper.D1, paper.D1 + paper.D2)
    s6 = [(-s3 * (c1 * p[0] + s1 * p[1]) + c3 * (p[2] - top) - s67 * paper.A7) / paper.A6 for top in tops]
    report.number("s6_with_d1_d1_and_d1_d2", s6)
    place = "no basis; the sample hits 21.37 for 20 by its place on the self-motion"
    sines = f"with it S6 = {s6[0]:.2f}: no angle; the printed {paper.S6} needs d1 + d2 (ours {s6[1]:.3f})"
    lift = "joint 2 is the lift, taken as known; the third position equation is never checked"
    rows = f"""
        theta_1 = 2 Atan2(py, px), (14) | {place} | theta_1 from the wrist rotation
        d1 + d1 in S6 and C6, Fig 4 | {sines} | d1 + d2
        S2, C2 in theta_4 | misprint | S4, C4
        Atan2(S/C), one argument | slip of notation | atan2(S, C)
        +-Atan2(s, sqrt(1 - s^2)) | -theta has the sine -s | atan2(s, +-sqrt(1 - s^2)): theta or pi - theta
        theta_45 = acos(...), (9) | loses the sign | +-acos, both are solutions
        theta_67 | used, never given | acos((S1 nx - C1 ny) / S45), which gives the printed 23.22 but loses the sign: both are tried
        theta_2 = 0 | {lift} | the lift is an input or the free parameter
        division by s45 and C3 | undefined where they vanish, not mentioned | ours divides by neither
        Table 1, Atan2(0, negative) | gives 0 (sign(0) = 0) | pi
        'only positive integers are taken' | one branch of 8 | all branches, then limits
        theta_4 = 1.048 from 0.018 | asin(0.018) = {math.degrees(math.asin(0.018)):.3f} deg | slip of an intermediate
        limits, units of theta_2, reach test, timing | absent | limits assumed, reach exact, times above
    """
    report.table("misprints", ["published", "what is wrong", "reading used"], rows)
