"""Inspection of the welds of a canister, the purpose of the robot of Shanmugasundar and Sivaramakrishnan (2012); the plan is ours.

A canister stands in front of the robot. The tool looks along its x axis, at right angles to the surface and from a stand-off.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ...errors import InvalidOption, floats
from ...kernel.counted_error import POSE
from ...motion.trajectory import Trajectory
from ...paths.continuity import check, densify
from ...paths.freedom import errors_at_rows
from ...paths.result import PathResult, PathStatus
from ...paths.solve_path import TOLERANCE
from ...robot.geometry.collision import CollisionModel
from ...robot.robot import Robot
from ...solvers.closed_form.lift_windows import LiftWindow, at_lifts, lift_windows
from ...solvers.solve import Solver
from ...validate import positive

MARGIN = 0.002  # [m] that a planned lift stays away from the ends of its windows, where a joint is at a limit or the arm folds
STEP = (
    math.radians(7.0),
    0.02,
)  # largest step [rad], [m] between rows of the certified path, the default of solve_path


@dataclass(frozen=True)
class Canister:
    """A cylinder that stands upright: radius and height [m], and the middle of its bottom (3,), base frame [m]."""

    radius: float = 0.12
    height: float = 0.7
    foot: tuple[float, float, float] = (0.55, 0.0, 0.35)

    def seam(self, angles: Any, heights: Any, standoff: float = 0.05, turn: float = 0.0) -> np.ndarray:
        """Return poses (N, 4, 4) of a tool that looks at points of the surface, one by one.

        A girth weld has one height, a longitudinal weld one angle; of two arrays each pair is a point.

        Args:
            angles: Where around the canister [rad], counter-clockwise from above; 0 faces the robot's first axis.
            heights: Heights above the bottom [m].
            standoff: Distance of the tip from the surface [m].
            turn: Turn of the tool about its line of sight [rad]; at 0 its y axis points up.

        Raises:
            InvalidOption: A number is out of range, or a height is not on the canister.
        """
        a, h = np.broadcast_arrays(
            *(np.atleast_1d(floats(x, "angles and heights", InvalidOption)) for x in (angles, heights))
        )
        if a.ndim != 1 or not np.isfinite(a).all() or not ((h >= 0.0) & (h <= self.height)).all():
            raise InvalidOption(
                f"angles must be finite, and heights between 0 and {self.height:g} m, each a number or (N,)"
            )
        away = positive(self.radius, "radius [m]") + positive(standoff, "standoff [m]")
        facing = math.atan2(-self.foot[1], -self.foot[0])
        n = np.column_stack([np.cos(a + facing), np.sin(a + facing), np.zeros(len(a))])
        up = np.array([0.0, 0.0, 1.0])
        side = np.cross(-n, up)
        T = np.tile(np.eye(4), (len(a), 1, 1))
        T[:, :3, 0] = -n
        T[:, :3, 1] = math.cos(turn) * up + math.sin(turn) * side
        T[:, :3, 2] = np.cross(T[:, :3, 0], T[:, :3, 1])
        T[:, :3, 3] = np.array(self.foot) + away * n + h[:, None] * up
        return T

    def obstacle(self, robot: Robot) -> CollisionModel:
        """Return a CollisionModel of the robot beside this canister."""
        middle = np.add(self.foot, (0.0, 0.0, 0.5 * self.height))
        return CollisionModel(robot).add_cylinder(self.radius, self.height, middle, name="canister")


@dataclass(frozen=True, eq=False)
class WeldPlan:
    """How a seam of N poses is inspected.

    Attributes:
        poses: (N, 4, 4), the seam, base frame [m].
        windows: For each pose its intervals of the lift (`lift_windows`).
        branch: The branch of the plan, 0 to 7.
        lifts: (N,) values of the lift [m], the sum of whose steps is least.
        path: The motion, certified between the poses.
    """

    poses: np.ndarray
    windows: list[list[LiftWindow]]
    branch: int
    lifts: np.ndarray
    path: PathResult

    @property
    def travel(self) -> float:
        """Return the sum of the steps of the lift [m], up and down."""
        return float(np.abs(np.diff(self.lifts)).sum())

    def torques(self, acceleration: float = 1.0, tip_speed: float = 0.02) -> tuple[Trajectory, np.ndarray]:
        """Return the motion in time, and the joint torques or forces (M, n) [Nm or N] that it takes, by Pinocchio's rnea.

        acceleration: of a joint at most [rad/s^2 or m/s^2]; tip_speed: of the tip [m/s], kept wherever the limits allow.
        """
        import pinocchio as pin

        model, motion = self.path.robot.model, self.path.retime(acceleration=acceleration, tip_speed=tip_speed)
        data = model.createData()
        rows = zip(motion.q, motion.dq, motion.ddq, strict=True)
        return motion, np.array([pin.rnea(model, data, *row) for row in rows])


def turns_reached(
    robot: Robot, canister: Canister, angles: Any, heights: Any, turns: Any, standoff: float = 0.05
) -> np.ndarray:
    """Return whether (M, N) each of M turns [rad] about the line of sight reaches each of N points of a seam inside the limits."""
    seams = (canister.seam(angles, heights, standoff, turn) for turn in turns)
    return np.array([[bool(found) for found in lift_windows(robot, seam)] for seam in seams])


def inspect_weld(robot: Robot, poses: Any, canister: Canister | None = None, margin: float = MARGIN) -> WeldPlan:
    """Plan the inspection of a seam with the least travel of the lift, and certify the motion between its poses.

    The least is over the lifts at the given poses, on one branch; see `least_travel`. Of branches with the same travel, the one
    whose other joints move least is taken.

    Args:
        robot: An arm that 'inspection' solves.
        poses: The seam (N, 4, 4), base frame [m], such as `Canister.seam` makes.
        canister: What the arm must not touch; by default nothing.
        margin: Distance [m] that lifts keep from the ends of their windows.

    Raises:
        InvalidOption: No branch has a window at every pose; the message names the first pose that none reaches.
    """
    poses, windows = np.asarray(poses, dtype=float), lift_windows(robot, poses)
    model = None if canister is None else canister.obstacle(robot)
    made = []
    for branch, lifts in least_travel(windows, margin).items():
        q = np.array([at_lifts(robot, T, d)[0][branch, 0] for T, d in zip(poses, lifts, strict=True)])
        made.append(WeldPlan(poses, windows, branch, lifts, certified(robot, poses, q, model)))
    if not made:
        lost = [k for k, found in enumerate(windows) if not found]
        why = (
            f"pose {lost[0]} is not reached inside the limits"
            if lost
            else "no branch reaches all poses: change the turn"
        )
        raise InvalidOption(f"this seam has no plan: {why}")
    return min(made, key=lambda one: (not one.path.success, round(one.travel, 9), one.path.length))


def certified(robot: Robot, poses: np.ndarray, q: np.ndarray, model: CollisionModel | None = None) -> PathResult:
    """Return the motion through solutions q (N, n) [rad or m] of poses (N, 4, 4), with bounds on what happens between them.

    Rows are inserted as by `solve_path`. Where no motion joins two poses, the path is INCOMPLETE. model: a CollisionModel or None.
    """
    plan, kinds, T = Solver(robot, "lm").plan_for((POSE,)), (POSE,), poses[:, None]
    curve, at, cut = densify(plan, kinds, q, T, [], STEP, TOLERANCE)
    curve = np.clip(curve, robot.lower, robot.upper)
    proof = check(plan, kinds, curve, at, T, cut, model)
    lost = at[:-1][(proof.deviation > TOLERANCE[0]) | (proof.turn > TOLERANCE[1])]
    status, message = PathStatus.FOLLOWED, f"{len(q)} poses followed in one motion"
    if len(lost):
        status, message = PathStatus.INCOMPLETE, f"no motion joins poses {int(lost[0])} and {int(lost[0]) + 1}"
    elif proof.contacts or proof.unproven:
        status, message = PathStatus.COLLISION, "the arm touches the canister, or no bound shows that it does not"
    errors = errors_at_rows(robot, q, T, kinds, plan.options)
    return PathResult(
        robot, T, kinds, plan.options, q, status, message, errors[:, 0], errors[:, 1], curve, at, proof, max_step=STEP,
        path_tolerance=TOLERANCE, collision=model,
    )  # fmt: skip


def least_travel(windows: list[list[LiftWindow]], margin: float = MARGIN) -> dict[int, np.ndarray]:
    """Return for each branch the lifts (N,) [m] of least travel, the sum of |d_i+1 - d_i|; a branch that has none is left out.

    The least is over all d_1 ... d_N with each d_i in a window of pose i, shortened by the margin at both ends, where windows of
    neighbouring poses overlap. For these poses it is exact: in each region where the order of the lifts and ends does not change
    the sum is linear, so some best sequence consists of ends of windows, and a shortest path through all ends finds it. Nothing
    is said about the lift between the poses, nor about motions that change the branch.

    Args:
        windows: The windows of each pose (`lift_windows`).
        margin: Distance [m] that lifts keep from the ends of their windows.
    """
    made = {}
    for k in range(8):
        rows = [[w for w in found if w.branch == k and w.high - w.low > 2.0 * margin] for found in windows]
        if all(rows):
            ends = [np.array([(w.low + margin, w.high - margin) for w in row]) for row in rows]
            lifts = _shortest(ends)
            made |= {} if lifts is None else {k: lifts}
    return made


def _shortest(rows: list[np.ndarray]) -> np.ndarray | None:
    """Return the values (N,), each in one of the intervals (K, 2) of its row, of least total variation; None if none overlap.

    From one row to the next only intervals that overlap are joined.
    """
    c = np.unique(np.concatenate([row.ravel() for row in rows]))
    inside = [(row[:, :1] <= c) & (c <= row[:, 1:]) for row in rows]
    joined = [(a[:, None, 0] <= b[None, :, 1]) & (b[None, :, 0] <= a[:, None, 1]) for a, b in pairwise(rows)]
    costs = [np.where(inside[0], 0.0, np.inf)]
    for mask, link in zip(inside[1:], joined, strict=True):
        base = np.where(link.T[:, :, None], costs[-1], np.inf).min(axis=1)  # (K', M) least cost at each value so far
        up = np.minimum.accumulate(base - c, axis=1) + c
        down = np.minimum.accumulate((base + c)[:, ::-1], axis=1)[:, ::-1] - c
        costs.append(np.where(mask, np.minimum(up, down), np.inf))
    if not np.isfinite(costs[-1]).any():
        return None
    w, j = np.unravel_index(np.argmin(costs[-1]), costs[-1].shape)
    values = [c[j]]
    for cost, link in zip(costs[-2::-1], joined[::-1], strict=True):
        total = np.where(link[:, w, None], cost, np.inf) + (1.0 + 1e-9) * np.abs(
            c - values[-1]
        )  # equal: the lift rests
        w, j = np.unravel_index(np.argmin(total), total.shape)
        values.append(c[j])
    return np.array(values[::-1])
