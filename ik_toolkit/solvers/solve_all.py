"""Every distinct solution of one target: from a closed form where one fits, otherwise from many starts."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..errors import InvalidOption
from ..kernel.slots import OPT_HEAD, OUT_HEAD, R_POSITION, R_ROTATION, R_STATUS
from ..kernel.task import POSITION
from ..robot.robot import Robot
from . import closed_form
from .result import Status
from .solve import Solver, _as_pose

SAME = 1e-3  # largest joint difference [rad, or of the reach] at which two numerical answers are one
TIGHT = 1e-9  # tolerance of the numerical search: answers to 1e-6 differ too much near singular poses to be merged
SPREAD_LIFTS = 9  # lifts per feasible interval when the lift is free
CHOOSING = ("closest", "objective", "history")  # options about one answer
Found = tuple[np.ndarray, np.ndarray, np.ndarray, bool, str]  # q (K, n), errors [m], [rad], complete, message


class Solutions:
    """Distinct solutions of one target, nearest to q0 first.

    q (K, n) [rad or m]; distance (K,) from q0 (angles [rad], lengths over the robot's scale); position_error (K,) [m] and
    orientation_error (K,) [rad] (None for positions), evaluated; complete: whether these are proven to be all of them
    (turns by 2 pi apart); solver (name); message (one sentence). len(), indexing and iteration give the rows of q.
    """

    def __init__(
        self, robot: Robot, q: np.ndarray, distance: np.ndarray, errors: Any, complete: bool, solver: str, message: str
    ) -> None:
        """Keep the parts."""
        self.robot = robot
        self.q = q
        self.distance = distance
        self.position_error, self.orientation_error = errors
        self.complete = complete
        self.solver = solver
        self.message = message

    def __len__(self) -> int:
        """Number of solutions."""
        return len(self.q)

    def __iter__(self) -> Iterator[np.ndarray]:
        """Solutions (n,), nearest first."""
        return iter(self.q)

    def __getitem__(self, k: int) -> np.ndarray:
        """Solution number k (n,)."""
        return self.q[k]

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, strings and lists, ready for JSON."""
        orientation = self.orientation_error
        return {
            "success": len(self) > 0,
            "complete": self.complete,
            "message": self.message,
            "solver": self.solver,
            "robot": self.robot.name,
            "joint_names": list(self.robot.joint_names),
            "solutions": self.q.tolist(),
            "distance": self.distance.tolist(),
            "position_error": self.position_error.tolist(),
            "orientation_error": None if orientation is None else orientation.tolist(),
        }

    def __repr__(self) -> str:
        """One line."""
        return f"Solutions({len(self)} of '{self.robot.name}', complete={self.complete}, solver='{self.solver}': {self.message})"


def solve_all(
    robot: Robot,
    target: Any,
    solver: Any = "auto",
    q0: Any = None,
    *,
    starts: int = 1000,
    count: int = 64,
    **options: Any,
) -> Solutions:
    """Find every distinct solution inside the limits, nearest to q0 (default home) first.

    target: T_base_tip (4, 4), pin.SE3 or a position (3,) [m]. 'auto' uses a closed form where one fits (complete, unless a
    free lift leaves infinitely many: then a spread over the feasible lifts) and otherwise 'lm' from `starts` random starts,
    answers a turn or less than 1e-3 apart merged (never proven complete). Redundant arms give a spread sample of `count`.
    Options as for `solve`, but for closest, objective and history; limits=False lists what the limits forbid too. Raises as
    `solve` does.
    """
    if not isinstance(robot, Robot):
        raise InvalidOption(f"the first argument is a Robot (see Robot.load), not {type(robot).__name__}")
    for name, value in (("starts", starts), ("count", count)):
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise InvalidOption(f"{name} must be a whole number of at least 1, not {value!r}")
    for name in CHOOSING:
        if options.get(name):
            raise InvalidOption(f"solve_all lists every solution, nearest to q0 first, so it takes no '{name}'")
    T, kind, notice = _as_pose(target)
    if solver is None or (isinstance(solver, str) and solver == "auto"):
        solver = (not options.get("mask") and closed_form.fits(robot, kind)) or "lm"
    one = Solver(robot, solver, **options)
    start = one._home if q0 is None else one._start(q0)[0]
    find = _closed if one.row.closed else _search
    q, position, orientation, complete, message = find(one, T, kind, start, starts)
    o = one.options
    if one.row.closed:
        good = position <= o.position_tolerance
        good &= (orientation <= o.orientation_tolerance) | (kind == POSITION)
        q, position, orientation = q[good], position[good], orientation[good]
    if one.collision is not None:
        free = np.array([not one.collision.collides(x) for x in q], dtype=bool)
        message += f"; {len(q) - free.sum()} of them collide and are left out" * (not free.all())
        q, position, orientation = q[free], position[free], orientation[free]
    unit = robot.chain.unit
    distance = np.sqrt((((q - start) / unit) ** 2).sum(axis=1))
    order = np.argsort(distance, kind="stable")
    if _redundant(one, kind) and len(q) > count:
        order, complete = order[_spread(q[order] / unit, count)], False
    if not len(q):
        failed = one(target, q0)
        message = message if failed.success else failed.message
        complete = complete or failed.status == Status.UNREACHABLE
    errors = position[order], None if kind == POSITION else orientation[order]
    message = f"{message}; {notice}" if notice else message
    return Solutions(robot, q[order], distance[order], errors, complete, one.name, message)


def _redundant(one: Solver, kind: Any) -> bool:
    """Whether joints are left over, so that solutions are not isolated; an axis target frees the turn about it."""
    rows = one.task_rows(kind)
    return one.robot.n - len(one.held) > (min(rows, 5) if isinstance(kind, tuple) else rows)


def tip_errors(robot: Robot, q: np.ndarray, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position errors (K,) [m] and rotation angles (K,) [rad] between the kernel's tip at q (K, n) and T (4, 4)."""
    if not len(q):
        return np.empty(0), np.empty(0)
    reached = robot.chain.forward(q)[0]
    cross = np.swapaxes(reached[:, :3, :3], 1, 2) @ T[:3, :3]
    sines = cross[:, [2, 0, 1], [1, 2, 0]] - cross[:, [1, 2, 0], [2, 0, 1]]
    angle = np.arctan2(0.5 * np.linalg.norm(sines, axis=1), 0.5 * (np.trace(cross, axis1=1, axis2=2) - 1.0))
    return np.linalg.norm(reached[:, :3, 3] - T[:3, 3], axis=1), angle


def _closed(one: Solver, T: np.ndarray, kind: Any, start: np.ndarray, starts: int) -> Found:
    """All legal branches of a closed form, evaluated."""
    robot = one.robot
    p = one.pack(kind, True)[OPT_HEAD + robot.n :]
    free = np.full(robot.n, np.inf)
    lower, upper = (robot.lower, robot.upper) if one.options.limits else (-free, free)
    box = np.vstack([lower, upper, start[0], 1.0 / robot.chain.unit**2])
    if one.name == "planar-2r":
        from .closed_form import planar_2r

        out, broken = np.empty((2, 2)), np.empty(2)
        found = planar_2r.every_branch(p, T[0], box, out, broken)
        complete, where = True, ""
    elif one.name == "eaik":
        from .closed_form import eaik

        out, broken = eaik.every_branch(p, T[0], box)
        found, complete, where = len(out), True, ""
    else:
        from .closed_form import inspection

        lifts, complete, where = inspection.lifts_to_list(p, T[0], box, SPREAD_LIFTS)
        out, broken = np.empty((8 * len(lifts), robot.n)), np.empty(8 * len(lifts))
        found = inspection.every_branch(p, T[0], box, lifts, out, broken)
    legal = broken[:found] == 0.0
    message = (
        f"{legal.sum()} of {found} branches{where} are inside the limits"
        if one.options.limits
        else f"{found} branches{where}"
    )
    q = out[:found][legal]
    return q, *tip_errors(robot, q, T[0]), complete, message


def _search(one: Solver, T: np.ndarray, kind: Any, start: np.ndarray, starts: int) -> Found:
    """Distinct converged answers of one descent from each of many starts."""
    robot, o = one.robot, one.options
    tight = {
        "position_tolerance": min(TIGHT, o.position_tolerance),
        "orientation_tolerance": min(TIGHT, o.orientation_tolerance),
    }
    same = {
        name: getattr(o, name) for name in ("limits", "mask", "mask_frame", "joint_weights", "seed", "max_iterations")
    }
    single = Solver(robot, one.rule, restarts=0, **tight, **same)
    rng = np.random.default_rng(o.seed)
    Q0 = np.vstack([start, [robot.random_q(rng) for _ in range(starts - 1)]]) if starts > 1 else start
    Q0[:, one.held] = start[0, one.held]
    out = np.empty((starts, OUT_HEAD + robot.n))
    single._kernel(*single._chain, np.repeat(T, starts, axis=0), Q0, out, single.pack(kind, True), single._silent)
    out = out[out[:, R_STATUS] == Status.CONVERGED]
    answers = out[:, OUT_HEAD:]
    turning = robot.chain.turns > 0
    if not o.limits and robot.chain.rows[0, 0] > 0.0:  # no limits, no mimic joints: every angle may be turned over
        turning = np.array([kind != "prismatic" for kind in robot.joint_kinds])
    near = start[0, turning] + np.remainder(answers[:, turning] - start[0, turning] + np.pi, 2 * np.pi) - np.pi
    if o.limits:
        low, high = robot.lower[turning], robot.upper[turning]
        near += 2 * np.pi * np.clip(0.0, np.ceil((low - near) / (2 * np.pi)), np.floor((high - near) / (2 * np.pi)))
    answers[:, turning] = near
    kept: list[int] = []
    for k, q in enumerate(answers):
        apart = np.abs(answers[kept] - q) / robot.chain.unit
        apart[:, turning] = np.minimum(apart[:, turning], np.abs(2 * np.pi - apart[:, turning]))
        if not kept or apart.max(axis=1).min() >= SAME:
            kept.append(k)
    words = "a sample of infinitely many" if _redundant(one, kind) else "distinct ones"
    message = f"{len(kept)} solution{'s' * (len(kept) != 1)} ({words}) from {starts} starts, {len(answers)} of which converged"
    return answers[kept], out[kept, R_POSITION], out[kept, R_ROTATION], False, message


def _spread(q: np.ndarray, count: int) -> np.ndarray:
    """Indices of `count` rows of q that lie far from one another, the first row among them, in order."""
    chosen = [0]
    gap = np.linalg.norm(q - q[0], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(gap)))
        gap = np.minimum(gap, np.linalg.norm(q - q[chosen[-1]], axis=1))
    return np.sort(chosen)
