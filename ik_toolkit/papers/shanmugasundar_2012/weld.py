"""Inspection of the welds of a canister, the purpose of the robot of Shanmugasundar and Sivaramakrishnan (2012); the plan is ours.

A canister stands in front of the robot. The tool looks along its x axis, at right angles to the surface and from a stand-off.
"""

import math
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ...errors import InvalidOption, floats
from ...kernel.counted_error import POSE
from ...motion.trajectory import Trajectory
from ...paths.continuity import check, densify
from ...paths.freedom import errors_at_rows
from ...paths.result import PathResult, PathStatus, Reconfiguration, path_sentence
from ...paths.solve_path import TOLERANCE
from ...robot.geometry.collision import CollisionModel
from ...robot.robot import Robot
from ...solvers.closed_form.lift_windows import LiftWindow, at_lifts, lift_windows
from ...solvers.solve import Solver
from ...validate import positive

MARGIN = 0.002  # [m] that a planned lift stays away from the ends of its windows, where a joint is at a limit or the arm folds
STEP = (math.radians(7.0), 0.02)  # largest step [rad], [m] between rows of the certified path, the default of solve_path


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
        a, h = np.broadcast_arrays(*(np.atleast_1d(floats(x, "angles and heights", InvalidOption)) for x in (angles, heights)))
        if a.ndim != 1 or not np.isfinite(a).all() or not ((h >= 0.0) & (h <= self.height)).all():
            raise InvalidOption(f"angles must be finite, and heights between 0 and {self.height:g} m, each a number or (N,)")
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


class LiftPlan(NamedTuple):
    """The lifts (N,) [m] along a seam on one branch (0 to 7), the windows they lie in, and their travel: the sum of |steps| [m]."""

    branch: int
    lifts: np.ndarray
    windows: list[list[LiftWindow]]
    travel: float


@dataclass(frozen=True, eq=False)
class WeldPlan:
    """How a seam is inspected: the plan of least lift travel, and its motion (a PathResult, certified between the poses)."""

    poses: np.ndarray
    lift: LiftPlan
    path: PathResult

    def torques(self, acceleration: float = 1.0, tip_speed: float = 0.02) -> tuple[Trajectory, np.ndarray]:
        """Return the motion in time, and the joint torques and forces (N, n) [Nm or N] that it takes, by Pinocchio's rnea.

        Args:
            acceleration: Largest joint acceleration [rad/s^2 or m/s^2].
            tip_speed: Speed of the tip [m/s].
        """
        import pinocchio as pin

        robot, motion = self.path.robot, self.path.retime(acceleration=acceleration, tip_speed=tip_speed)
        data = robot.model.createData()
        rows = zip(motion.q, motion.dq, motion.ddq, strict=True)
        return motion, np.array([pin.rnea(robot.model, data, *row) for row in rows])


def turns_reached(robot: Robot, canister: Canister, angles: Any, heights: Any, turns: Any, standoff: float = 0.05) -> np.ndarray:
    """Return whether (M, N) each of N points of a seam is seen, inside all limits, with each of M turns [rad] about the line of sight."""
    return np.array([[bool(lift_windows(robot, T)) for T in canister.seam(angles, heights, standoff, turn)] for turn in turns])


def inspect(robot: Robot, poses: Any, canister: Canister | None = None, margin: float = MARGIN) -> WeldPlan | None:
    """Plan the inspection of a seam with the least travel of the lift, and certify the motion between its poses.

    Args:
        robot: An arm that 'inspection' solves.
        poses: The seam (N, 4, 4), base frame [m], such as `Canister.seam` makes.
        canister: What the arm must not touch; by default nothing.
        margin: Distance [m] that lifts keep from the ends of their windows.

    Returns:
        The plan; None if no branch reaches every pose inside the limits, or none does so without an interruption.
    """
    poses = np.asarray(poses, dtype=float)
    model = None if canister is None else canister.obstacle(robot)
    made = []
    for lift in sorted(least_travel([lift_windows(robot, T) for T in poses], margin), key=lambda one: one.travel):
        q = np.array([at_lifts(robot, T, d)[0][lift.branch, 0] for T, d in zip(poses, lift.lifts, strict=True)])
        made.append(WeldPlan(poses, lift, certified(robot, poses, q, model)))
        if made[-1].path.status == PathStatus.FOLLOWED:
            return made[-1]
    return made[0] if made else None


def certified(robot: Robot, poses: np.ndarray, q: np.ndarray, model: CollisionModel | None = None) -> PathResult:
    """Return the motion through solutions q (N, n) [rad or m] of poses (N, 4, 4), with bounds on what happens between them.

    Rows are inserted as by `solve_path`. Where two poses are not joined by one motion, the result has a reconfiguration. model: a
    CollisionModel or None.
    """
    began = perf_counter()
    solver = Solver(robot, "lm")
    plan, kinds, T = solver.plan_for((POSE,)), (POSE,), poses[:, None]
    breaks: list[int] = []
    while True:
        curve, at, cut = densify(plan, kinds, q, T, breaks, STEP, TOLERANCE)
        curve = np.clip(curve, robot.lower, robot.upper)
        proof = check(plan, kinds, curve, at, T, cut, model)
        leaps = (proof.deviation > TOLERANCE[0]) | (proof.turn > TOLERANCE[1])
        if not leaps.any():
            break
        breaks = sorted({*breaks, *at[:-1][leaps].astype(int).tolist()})
    errors = errors_at_rows(robot, q, T, kinds, plan.options)
    status = PathStatus.RECONFIGURES if breaks else PathStatus.FOLLOWED
    result = PathResult(
        robot=robot, targets=T, kinds=kinds, options=plan.options, q=q,
        status=PathStatus.COLLISION if proof.contacts else status, message="", position_error=errors[:, 0],
        orientation_error=errors[:, 1], curve=curve, at=at, continuity=proof,
        reconfigurations=tuple(Reconfiguration(k, q[k + 1] - q[k]) for k in breaks), max_step=STEP,
        path_tolerance=TOLERANCE, collision=model, elapsed=perf_counter() - began,
    )  # fmt: skip
    return replace(result, message=path_sentence(result, len(breaks), math.inf))


def least_travel(windows: list[list[LiftWindow]], margin: float = MARGIN) -> list[LiftPlan]:
    """Return for each branch that has a window at every pose the lifts whose travel, the sum of |steps|, is least.

    The least is over all lifts d_1 ... d_N with d_i in a window of pose i, shortened by the margin at both ends, where the windows
    of neighbouring poses overlap. It is exact for these poses: such a sum is linear in the lifts wherever their order does not
    change, so that some best sequence consists of ends of windows, and a shortest path through the ends finds it.

    Args:
        windows: The windows of each pose (`lift_windows`).
        margin: Distance [m] that lifts keep from the ends of their windows.
    """
    made = []
    for k in range(8):
        rows = [[w for w in at if w.branch == k and w.high - w.low > 2.0 * margin] for at in windows]
        if all(rows):
            found = _shortest([np.array([(w.low + margin, w.high - margin) for w in row]) for row in rows])
            if found is not None:
                made.append(LiftPlan(k, found, windows, float(np.abs(np.diff(found)).sum())))
    return made


def _shortest(rows: list[np.ndarray]) -> np.ndarray | None:
    """Return the values (N,), each in one of the intervals (K, 2) of its row, of least total variation; None if none overlap.

    From one row to the next only intervals that overlap are joined.
    """
    c = np.unique(np.concatenate([row.ravel() for row in rows]))
    inside = [(row[:, :1] <= c) & (c <= row[:, 1:]) for row in rows]
    joined = [
        (a[:, None, 0] <= b[None, :, 1]) & (b[None, :, 0] <= a[:, None, 1]) for a, b in zip(rows, rows[1:], strict=False)
    ]
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
        total = np.where(link[:, w, None], cost, np.inf) + (1.0 + 1e-9) * np.abs(c - values[-1])  # equal: the lift rests
        w, j = np.unravel_index(np.argmin(total), total.shape)
        values.append(c[j])
    return np.array(values[::-1])
