"""Inspection of the welds of a canister, the purpose of the robot of Shanmugasundar and Sivaramakrishnan (2012); the plan is ours."""

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
from ...paths.path_problem import STEP
from ...paths.result import PathResult, PathStatus
from ...paths.solve_path import TOLERANCE
from ...robot.geometry.collision import CollisionModel
from ...robot.robot import Robot
from ...solvers.closed_form.lift_windows import LiftWindow, at_lifts, lift_windows
from ...solvers.solve import Solver
from ...validate import positive

MARGIN = 0.002  # [m] that a planned lift stays away from the ends of its windows, where a joint is at a limit or the arm folds


@dataclass(frozen=True)
class Canister:
    """A cylinder that stands upright: radius and height [m], and the middle of its bottom (3,), base frame [m]."""

    radius: float = 0.12
    height: float = 0.7
    foot: tuple[float, float, float] = (0.55, 0.0, 0.35)

    def seam(self, angles: Any, heights: Any, standoff: float = 0.05, turn: float = 0.0) -> np.ndarray:
        """Return poses (N, 4, 4) of a tool whose x axis looks at the surface at right angles, from a stand-off.

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
        a = a + math.atan2(-self.foot[1], -self.foot[0])
        n, up = np.column_stack([np.cos(a), np.sin(a), 0.0 * a]), np.array([0.0, 0.0, 1.0])
        T = np.tile(np.eye(4), (len(a), 1, 1))
        T[:, :3, 0] = -n
        T[:, :3, 1] = math.cos(turn) * up + math.sin(turn) * np.cross(-n, up)
        T[:, :3, 2] = np.cross(T[:, :3, 0], T[:, :3, 1])
        away = positive(self.radius, "radius [m]") + positive(standoff, "standoff [m]")
        T[:, :3, 3] = np.array(self.foot) + away * n + h[:, None] * up
        return T


@dataclass(frozen=True, eq=False)
class WeldPlan:
    """How a seam of N poses is inspected: the windows of the lift of each pose, a branch (0 to 7), lifts (N,) [m], and the motion."""

    windows: list[list[LiftWindow]]
    branch: int
    lifts: np.ndarray
    path: PathResult

    @property
    def travel(self) -> float:
        """Return the sum of the steps of the lift [m], up and down."""
        return float(np.abs(np.diff(self.lifts)).sum())

    def torques(self, acceleration: float = 1.0, tip_speed: float = 0.02) -> tuple[Trajectory, np.ndarray, np.ndarray]:
        """Return the motion in time, its joint torques or forces (M, n) [Nm or N] by Pinocchio's rnea, and those of weight alone.

        acceleration: of a joint at most [rad/s^2 or m/s^2]; tip_speed: of the tip [m/s], kept wherever the limits allow.
        """
        import pinocchio as pin

        model, motion = self.path.robot.model, self.path.retime(acceleration=acceleration, tip_speed=tip_speed)
        data, rest = model.createData(), np.zeros(model.nv)
        rows = [(pin.rnea(model, data, *row), pin.rnea(model, data, row[0], rest, rest)) for row in _rows(motion)]
        return motion, *np.array(rows).swapaxes(0, 1)


def _rows(motion: Trajectory) -> Any:
    return zip(motion.q, motion.dq, motion.ddq, strict=True)


def inspect_weld(robot: Robot, poses: Any, canister: Canister | None = None, margin: float = MARGIN) -> WeldPlan:
    """Plan the inspection of a seam with the least travel of the lift (see `least_travel`), and certify the motion between its poses.

    Between the poses rows are inserted as by `solve_path`. Of branches with the same travel, the one whose other joints move least
    is taken. The path's status is INCOMPLETE where no motion joins two poses, COLLISION where contact is not ruled out.

    Args:
        robot: An arm that 'inspection' solves.
        poses: The seam (N, 4, 4), base frame [m], such as `Canister.seam` makes.
        canister: What the arm must not touch; by default nothing.
        margin: Distance [m] that lifts keep from the ends of their windows.

    Raises:
        InvalidOption: No branch has a window at every pose; the message names the first pose that none reaches.
    """
    poses, windows, model = np.asarray(poses, dtype=float), lift_windows(robot, poses), None
    if canister is not None:
        middle = np.add(canister.foot, (0.0, 0.0, 0.5 * canister.height))
        model = CollisionModel(robot).add_cylinder(canister.radius, canister.height, middle, name="canister")
    made = []
    for branch, lifts in least_travel(windows, margin).items():
        q = np.array([at_lifts(robot, T, d)[0][branch, 0] for T, d in zip(poses, lifts, strict=True)])
        made.append(WeldPlan(windows, branch, lifts, certified(robot, poses, q, model)))
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
    """Return the motion through solutions q (N, n) [rad or m] of poses (N, 4, 4), with bounds on it between them."""
    plan, kinds, T = Solver(robot, "lm").plan_for((POSE,)), (POSE,), poses[:, None]
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
    """Return for each branch the lifts (N,) [m] of least travel, the sum of |d_i+1 - d_i|; a branch that has none is left out.

    The least is over all d_1 ... d_N with each d_i in a window of pose i, shortened by the margin at both ends, where windows of
    neighbouring poses overlap. For these poses it is exact: in each region where the order of the lifts and ends does not change
    the sum is linear, so some best sequence consists of ends of windows, and a shortest path through all ends finds it. Nothing
    is said about the lift between the poses, nor about motions that change the branch.
    """
    made = {}
    for k in range(8):
        rows = [
            np.array([w[1:] for w in found if w.branch == k]).reshape(-1, 2) + (margin, -margin) for found in windows
        ]
        rows = [row[row[:, 1] > row[:, 0]] for row in rows]
        c = np.unique(np.concatenate(rows))  # (M,) all ends
        inside = [(row[:, :1] <= c) & (c <= row[:, 1:]) for row in rows]
        joined = [(a[:, :1] <= b[:, 1]) & (b[:, 0] <= a[:, 1:]) for a, b in pairwise(rows)]
        costs = [np.where(inside[0], 0.0, np.inf)]
        for mask, link in zip(inside[1:], joined, strict=True):
            base = np.where(link.T[:, :, None], costs[-1], np.inf).min(
                axis=1, initial=np.inf
            )  # least cost at each value so far
            up = np.minimum.accumulate(base - c, axis=1) + c
            down = np.minimum.accumulate((base + c)[:, ::-1], axis=1)[:, ::-1] - c
            costs.append(np.where(mask, np.minimum(up, down), np.inf))
        if not np.isfinite(costs[-1]).any():
            continue
        w, j = np.unravel_index(np.argmin(costs[-1]), costs[-1].shape)
        values = [c[j]]
        for cost, link in zip(costs[-2::-1], joined[::-1], strict=True):
            total = np.where(link[:, w, None], cost, np.inf) + (1.0 + 1e-9) * np.abs(
                c - values[-1]
            )  # if equal, the lift rests
            w, j = np.unravel_index(np.argmin(total), total.shape)
            values.append(c[j])
        made[k] = np.array(values[::-1])
    return made
