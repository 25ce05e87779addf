"""Inspection of a canister's welds, the purpose of the robot of Shanmugasundar and Sivaramakrishnan (2012); the plan is ours."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ...errors import InvalidOption, floats
from ...kernel.counted_error import KIND
from ...motion.trajectory import Trajectory
from ...paths.continuity import check, densify
from ...paths.freedom import errors_at_rows
from ...paths.path_problem import STEP, TOLERANCE
from ...paths.result import PathResult, PathStatus
from ...robot.geometry.collision import CollisionModel
from ...robot.pose import check_target
from ...robot.robot import Robot
from ...robot.tree import require_one_tip
from ...solvers.closed_form.lift_windows import LiftWindow, at_lifts, lift_windows
from ...solvers.solve import Solver
from ...study.reachability import reachability
from ...style import COLOURS
from ...text import length
from ...validate import not_negative, number, positive
from ..report import Report

TURN = 2.0 * np.pi + 1e-9  # A larger angle is refused, because it was probably given in degrees instead of radians.
# A planned lift keeps this distance [m] from the ends of its windows, where a joint is at a limit or the arm is singular.
MARGIN = 0.002
SEAMS = {  # Two weld seams of 41 poses on the canister: angles [rad] around it, and heights [m].
    "girth, 80 deg at 350 mm": (np.radians(np.linspace(-40.0, 40.0, 41)), 0.35),
    "longitudinal, 50 to 650 mm": (0.0, np.linspace(0.05, 0.65, 41)),
}
SPEED = 0.02  # Speed of the tip along the seam [m/s].


@dataclass(frozen=True)
class Canister:
    """An upright cylinder whose welds are inspected: radius and height [m], and the middle of its bottom (3,) [m], base frame.

    Raises InvalidOption if a number is out of range.
    """

    radius: float = 0.12
    height: float = 0.7
    foot: tuple[float, float, float] = (0.55, 0.0, 0.35)

    def __post_init__(self) -> None:
        """Check the numbers. Raises InvalidOption."""
        positive(self.radius, "radius [m]")
        positive(self.height, "height [m]")
        foot = floats(self.foot, "foot must be three numbers [m]", InvalidOption)
        if foot.shape != (3,) or not np.isfinite(foot).all():
            raise InvalidOption(f"foot must be three finite numbers [m], not {self.foot!r:.60}")

    def seam(self, angles: Any, heights: Any, standoff: float = 0.05, turn: float = 0.0) -> np.ndarray:
        """Return poses (N, 4, 4) of a tool whose x axis is perpendicular to the surface and points at it, from a stand-off.

        A girth weld has one height, a longitudinal weld one angle; of two arrays each pair is a point.

        Args:
            angles: Where around the canister [rad], counter-clockwise from above; 0 faces the robot's first axis.
            heights: Heights above the bottom [m].
            standoff: Distance of the tip from the surface [m].
            turn: Turn of the tool about its line of sight [rad]; at 0 its y axis points up.

        Raises:
            InvalidOption: A number is out of range, or a height is not on the canister.
        """
        a, h = (
            np.atleast_1d(floats(x, "angles and heights must be numbers", InvalidOption)) for x in (angles, heights)
        )
        if {a.shape, h.shape} - {(1,), (max(a.size, h.size),)} or not np.isfinite(a).all():
            raise InvalidOption("angles and heights must be finite, each a number or (N,)")
        if max(np.abs(a).max(), abs(number(turn, "turn [rad]"))) > TURN:
            raise InvalidOption("angles and turn are within a turn [rad]; convert degrees by np.radians")
        if not ((h >= 0.0) & (h <= self.height)).all():
            raise InvalidOption(f"heights must be between 0 and {self.height:g} m, on the canister")
        a, h = np.broadcast_arrays(a, h)
        a = a + math.atan2(-self.foot[1], -self.foot[0])
        n, up = np.column_stack([np.cos(a), np.sin(a), 0.0 * a]), np.array([0.0, 0.0, 1.0])
        T = np.tile(np.eye(4), (len(a), 1, 1))
        T[:, :3, 0] = -n
        T[:, :3, 1] = math.cos(turn) * up + math.sin(turn) * np.cross(-n, up)
        T[:, :3, 2] = np.cross(T[:, :3, 0], T[:, :3, 1])
        away = self.radius + positive(standoff, "standoff [m]")
        T[:, :3, 3] = np.array(self.foot) + away * n + h[:, None] * up
        return T


@dataclass(frozen=True, eq=False)
class WeldPlan:
    """A plan to inspect a weld seam of N poses with the inspection robot, whose prismatic joint is called the lift.

    `windows` has for each pose the ranges of the lift that reach it, `branch` (0 to 7) the posture of the arm, `lifts` (N,) [m] the
    lift at each pose, and `path` the motion.
    """

    windows: list[list[LiftWindow]]
    branch: int
    lifts: np.ndarray
    path: PathResult

    def __repr__(self) -> str:
        """Return the outcome in a sentence."""
        return (
            f"WeldPlan: {self.path.message}; branch {self.branch}, the lift travels {length(self.travel)} "
            f"from pose to pose, {length(self.whole_travel)} with what it moves between them"
        )

    @property
    def travel(self) -> float:
        """Return how far the lift moves in all [m], up and down, counted from pose to pose; no plan of the branch has less."""
        return float(np.abs(np.diff(self.lifts)).sum())

    @property
    def whole_travel(self) -> float:
        """Return the travel of the lift [m] along the whole motion, which may go up and down between two poses."""
        return float(np.abs(np.diff(self.path.curve[:, self.path.robot.slides], axis=0)).sum())

    def torques(self, acceleration: float = 1.0, tip_speed: float = 0.02) -> tuple[Trajectory, np.ndarray, np.ndarray]:
        """Return the motion in time, its joint torques or forces (M, n) [Nm or N] by Pinocchio's rnea, and those of weight alone.

        acceleration: largest acceleration of a joint [rad/s^2 or m/s^2]; tip_speed: speed of the tip [m/s], kept wherever the
        limits allow.
        """
        import pinocchio as pin

        model, motion = self.path.robot.model, self.path.retime(acceleration=acceleration, tip_speed=tip_speed)
        data, rest = model.createData(), np.zeros(model.nv)
        rows = zip(motion.q, motion.dq, motion.ddq, strict=True)
        both = [(pin.rnea(model, data, q, dq, ddq), pin.rnea(model, data, q, rest, rest)) for q, dq, ddq in rows]
        return motion, *np.array(both).swapaxes(0, 1)


def inspect_weld(robot: Robot, poses: Any, canister: Canister | None = None, margin: float = MARGIN) -> WeldPlan:
    """Plan how the robot inspects a weld seam so that its prismatic joint, the lift, moves least; return a WeldPlan.

    The motion between the poses is made and checked as by `solve_path`. Of branches with the same travel of the lift, the one whose
    other joints move least is chosen. The path's status is INCOMPLETE where no motion joins two poses, COLLISION where contact is
    not ruled out. Its deviation is that from the straight motion between two poses, which cuts corners of a girth weld with few
    poses.

    Args:
        robot: An arm that 'inspection' solves.
        poses: The seam (N, 4, 4), base frame [m], such as `Canister.seam` makes.
        canister: What the arm must not touch; by default nothing.
        margin: Distance [m] that lifts keep from the ends of their windows.

    Raises:
        InvalidOption: No branch joins the windows of all poses, and the message says where; or an argument is wrong.
        UnknownSolver, InvalidTarget: As for `lift_windows`.
    """
    require_one_tip(robot, "inspect_weld")
    if not isinstance(canister, Canister | None):
        raise InvalidOption(f"canister must be a Canister, such as Canister(radius=0.12), not {canister!r:.60}")
    poses = np.array([check_target(T, robot.base)[0] for T in poses])
    if len(poses) < 2:
        raise InvalidOption(f"a seam needs at least two poses, not {len(poses)}")
    margin = not_negative(margin, "margin [m]")
    windows, model = lift_windows(robot, poses), None
    if canister is not None:
        middle = np.add(canister.foot, (0.0, 0.0, 0.5 * canister.height))
        model = CollisionModel(robot).add_cylinder(canister.radius, canister.height, middle, name="canister")
    made = []
    for branch, lifts in least_travel(windows, margin).items():
        q = np.array([at_lifts(robot, T, d)[0][branch, 0] for T, d in zip(poses, lifts, strict=True)])
        made.append(WeldPlan(windows, branch, lifts, certified(robot, poses, q, model)))
    if not made:
        why = [f"pose {k} is not reached inside the limits" for k, found in enumerate(windows) if not found]
        why += [
            f"no branch has lifts at every pose that keep {margin:g} m from the ends of their windows, with windows of neighbours "
            "that overlap; try another turn, more poses or a smaller margin"
        ]
        raise InvalidOption(f"this seam has no plan: {why[0]}")
    return min(made, key=lambda one: (not one.path.success, round(one.travel, 9), one.path.length))


def certified(robot: Robot, poses: np.ndarray, q: np.ndarray, model: CollisionModel | None = None) -> PathResult:
    """Return the joint motion through solutions q (N, n) [rad or m] of poses (N, 4, 4), checked between the poses.

    The result has proven bounds on how far the tip leaves the straight motion, and on contact with the shapes of `model`.
    """
    plan, kinds, T = Solver(robot, "lm").plan_for((KIND.pose,)), (KIND.pose,), poses[:, None]
    curve, at, cut = densify(plan, kinds, q, T, [], STEP, TOLERANCE)
    curve = np.clip(curve, robot.lower, robot.upper)
    proof = check(plan, kinds, curve, at, T, cut, model)
    lost = at[:-1][(proof.deviation > TOLERANCE[0]) | (proof.turn > TOLERANCE[1])]
    status, message = PathStatus.FOLLOWED, f"{len(q)} poses followed in one motion"
    if len(lost):
        status, message = PathStatus.INCOMPLETE, f"no motion joins poses {int(lost[0])} and {int(lost[0]) + 1}"
    elif proof.contacts or proof.unproven:
        status, message = PathStatus.COLLISION, "contact with the canister, or of the arm with itself, is not ruled out"
    errors = errors_at_rows(robot, q, T, kinds, plan.options)
    made = (robot, T, kinds, plan.options, q, status, message, errors[:, 0], errors[:, 1], curve, at, proof)
    return PathResult(*made, max_step=STEP, path_tolerance=TOLERANCE, collision=model)


def least_travel(windows: list[list[LiftWindow]], margin: float = MARGIN) -> dict[int, np.ndarray]:
    """Return for each branch the values (N,) [m] of the prismatic joint, the lift, that make its travel least.

    The travel is the sum of |d_i+1 - d_i| over the poses i of a seam. `windows` has for each pose the ranges of the lift in which
    it is reached. Each d_i lies in a window of pose i that is shortened by the margin at both ends, and the windows of successive
    poses must overlap. A branch without such a sequence is left out. The minimum is exact: the sum is piecewise linear in the
    lifts, so some best sequence consists of window ends, and a shortest path through all window ends finds it. Of several best
    sequences, the one is taken whose last lift is nearest the middle of all best last lifts. Backwards from there the lift stays
    where it is as long as that adds no travel. Nothing is said about the lift between the poses, nor about motions that change the
    branch.
    """
    made = {}
    for k in range(8):
        ends = [[(w.low + margin, w.high - margin) for w in found if w.branch == k] for found in windows]
        rows = [np.array([one for one in row if one[0] <= one[1]]).reshape(-1, 2) for row in ends]
        c = np.unique(np.concatenate(rows))
        # The candidates for lifts are the ends of all windows. The midpoints between them help to choose among equal sequences.
        c = np.sort(np.concatenate([c, 0.5 * (c[1:] + c[:-1])]))
        inside = [(row[:, :1] <= c) & (c <= row[:, 1:]) for row in rows]
        joined = [(a[:, :1] <= b[:, 1]) & (b[:, 0] <= a[:, 1:]) for a, b in pairwise(rows)]
        costs = [np.where(inside[0], 0.0, np.inf)]
        for mask, link in zip(inside[1:], joined, strict=True):
            # For each candidate, the least travel of all sequences that end at it.
            base = np.where(link.T[:, :, None], costs[-1], np.inf).min(axis=1, initial=np.inf)
            up = np.minimum.accumulate(base - c, axis=1) + c
            down = np.minimum.accumulate((base + c)[:, ::-1], axis=1)[:, ::-1] - c
            costs.append(np.where(mask, np.minimum(up, down), np.inf))
        if not np.isfinite(costs[-1]).any():
            continue
        ties = np.argwhere(costs[-1] <= costs[-1].min() + 1e-12)
        w, j = ties[np.argmin(np.abs(c[ties[:, 1]] - 0.5 * (c[ties[:, 1].min()] + c[ties[:, 1].max()])))]
        values = [c[j]]
        for cost, link in zip(costs[-2::-1], joined[::-1], strict=True):
            # The factor is slightly above 1, so that of equal sequences the one in which the lift stays at rest is chosen.
            step = (1.0 + 1e-9) * np.abs(c - values[-1])
            total = np.where(link[:, w, None], cost, np.inf) + step
            w, j = np.unravel_index(np.argmin(total), total.shape)
            values.append(c[j])
        made[k] = np.array(values[::-1])
    return made


# ----------------------------------------------------------------------------------------------------------- report
def weld(report: Report, robot: Robot, count: int) -> None:
    """Add the section on weld inspection to the report, with `count` turns of the tool about its line of sight.

    None of them is 90 deg, where joint 3 is at its limit.
    """
    turns = np.radians(360.0 / count * (np.arange(count) + 0.5))
    report.heading("Beyond the paper: the welds of a canister, workspace and torques")
    canister, plans, rows, forces = Canister(), {}, [], []
    for name, seam in SEAMS.items():
        seams = [canister.seam(*seam, turn=turn) for turn in turns]
        seen = np.array([[bool(found) for found in lift_windows(robot, poses)] for poses in seams])
        made = {k: inspect_weld(robot, seams[k], canister) for k in np.flatnonzero(seen.all(axis=1)).tolist()}
        k = min(made, key=lambda k: (not made[k].path.success, round(made[k].travel, 6), made[k].path.length))
        plan = plans[name] = made[k]
        share, most = 100.0 * seen.mean(axis=0), 1000.0 * max(one.travel for one in made.values())
        off, tilt = plan.path.deviation
        row = {
            "seam": f"{name}, 41 poses",
            f"of {count} turns, reach a pose (%)": f"{share.min():.0f} to {share.max():.0f}",
            "reach all": len(made),
            "turn taken (deg)": np.degrees(turns[k]),
            "least lift travel (mm)": 1000.0 * plan.travel,
            "with the motion between poses": 1000.0 * plan.whole_travel,
            "least at the worst turn": most,
            "motion": plan.path.status.name,
            "deviation at most": f"{1000 * off:.2f} mm, {np.degrees(tilt):.2f} deg",
            "clearance at least (mm)": 1000.0 * (plan.path.clearance or 0.0),
        }
        rows.append(row)
        motion, torques, weight = plan.torques(tip_speed=SPEED)
        forces += [[f"{name}, {motion.duration:.1f} s", *np.abs(torques).max(axis=0)]]
        forces += [["of this by motion", *np.abs(torques - weight).max(axis=0)]]
    report.records("weld", rows)
    report.text(
        f"""The robot is to look at the welds of canisters; the paper plans none. Ours stands {canister.foot[0]:g} m in
        front of the robot, with a radius of {1000 * canister.radius:g} mm. The tool looks along its x axis, at right angles
        to the surface, 50 mm away, and one turn about this line is kept along a seam. At each pose the lifts that keep all
        limits are exact intervals, a branch at a time: a joint can be at a limit only at the roots of polynomials of degree
        12 or less. The sum of the steps of the lift is the least over all lifts in these intervals, {1000 * MARGIN:g} mm
        from their ends, at the 41 poses, on one branch. Between the poses the motion is certified: its deviation is
        bounded, and it keeps the clearance from the canister and from itself."""
    )
    caption = (
        "Above: the girth weld, seen from above; below: the longitudinal weld, seen from the side. Right: intervals of the lift on "
        "the branch of the plan (blue) and on all (grey), with the lift of least travel (red)"
    )
    report.figure("weld.png", caption, draw_weld, robot, canister, plans)
    names = [
        f"{name} ({'N' if slides else 'Nm'})" for name, slides in zip(robot.joint_names, robot.slides, strict=True)
    ]
    report.table("torques", [f"largest at {1000 * SPEED:g} mm/s", *names], forces)
    plane = ((-0.6, 0.0, 0.0), (0.6, 0.0, 1.6))
    any_ = reachability(robot, plane, resolution=0.02, audit=200)
    level = np.array([canister.seam(0.0, 0.0, turn=turn)[0, :3, :3] for turn in turns[::2]])
    gaze = reachability(robot, plane, resolution=0.08, orientations=level, audit=200)
    report.number("workspace", {"any orientation": any_.counts(), "gaze": gaze.counts()})
    report.text(
        f"""Torques by Pinocchio (recursive Newton-Euler), joints accelerating by at most 1 rad/s^2 or m/s^2. The paper gives
        no masses; ours are those of solid steel cylinders of the lengths of Table 2. In the vertical plane through the
        column, 1.2 m wide and 1.6 m high, the tip reaches {100 * any_.reached.mean():.0f} % of {any_.reached.size} cells of
        20 mm with some orientation. Looking level along x, at least one of {len(level)} turns reaches
        {100 * gaze.reached.mean():.0f} % of {gaze.reached.size} cells of 80 mm."""
    )
    caption = "Workspace in the plane of the column: share of turns reached when looking level along x"
    report.figure("workspace.png", caption, draw_map, gaze)


def draw_map(_: Any, found: Any) -> Any:
    """Draw the ReachabilityMap of a weld inspection: the share of turns of the tool reached in each cell."""
    from ...show.reach_pictures import plot_map

    return plot_map(found)


def draw_weld(plt: Any, robot: Robot, canister: Canister, plans: dict[str, WeldPlan]) -> Any:
    """Draw for each WeldPlan the arm at five poses (of a girth weld from above), and the lift [m] over all poses."""
    from ...show.body import joint_frames

    figure, axes = plt.subplots(len(plans), 2, figsize=(8.0, 6.4), layout="constrained", width_ratios=(4, 5))
    x, y, z = canister.foot
    for (left, right), (name, plan), k in zip(axes, plans.items(), (1, 2), strict=True):
        if k == 1:
            left.add_patch(plt.Circle((x, y), canister.radius, color="0.85"))
        else:
            left.add_patch(plt.Rectangle((x - canister.radius, z), 2 * canister.radius, canister.height, color="0.85"))
            left.plot([0, 0], [0, 0.53], color="0.5", lw=7, solid_capstyle="butt")
        seam = plan.path.targets[:, 0]
        for q in plan.path.q[:: (len(seam) - 1) // 4]:
            places = np.vstack([joint_frames(robot, q)[[2, 3, 5, 7], :3, 3], robot.fk(q).translation])
            left.plot(places[:, 0], places[:, k], "-o", color=COLOURS[0], lw=2, ms=3.5, mfc="white")
        left.plot(seam[:, 0, 3], seam[:, k, 3], color=COLOURS[1], lw=1.5)
        left.set(xlabel="x (m)", ylabel=f"{'xyz'[k]} (m)", title=name, aspect="equal")
        for pose, found in enumerate(plan.windows):
            for one in sorted(found, key=lambda one: one.branch == plan.branch):
                colour = COLOURS[0] if one.branch == plan.branch else "0.85"
                right.bar(pose, 1000 * (one.high - one.low), 1.02, 1000 * one.low, color=colour)
        right.plot(1000 * plan.lifts, color=COLOURS[1], lw=2)
        right.set(xlabel="pose along the seam", ylabel="lift (mm)", ylim=(-10, 450))
        right.set_title(f"travel {1000 * plan.travel:.1f} mm")
    return figure
