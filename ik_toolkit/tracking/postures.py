"""Joint values near given ones that reach a tracker's targets, from single attempts of the solver."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..kernel.arrival import WAIT
from ..kernel.box import NOISE
from ..kernel.checks import CONVERGED, UNREACHABLE
from ..kernel.kinematics import TAU
from ..kernel.records import ANSWER, AT, Ends
from ..kernel.travel import UNKNOWN, travel
from ..solvers.options import COUNTING, Options
from ..solvers.plan import Plan
from ..solvers.registry import GENERAL, find_row
from .engine import LEVER

TOLERANCE = 1e-5  # [m, rad] of a posture: the tracker itself comes closer
TINY = 1e-300  # divided by where no joint has a speed
REACHED = 1e-3  # [m] error, angles at LEVER, below which a target counts as reached


class Taken(NamedTuple):
    """A step taken by a tracker, in kernel units but for E and T; arrays are the tracker's own."""

    code: np.ndarray  # (n,) bits of limits
    singular: bool
    E: np.ndarray  # (2, m) errors before and after it [m, rad], base axes
    left: float  # [m] error after it, see `Postures.size`
    T: np.ndarray  # (2, F, 4, 4) targets before and after it
    stand: np.ndarray  # whether the target stands, see `arrival.Stand`
    dt: float  # [s] of the update
    since: float  # [s] since the one looked at before it: those that end at their target, unhindered, are not
    q: np.ndarray  # (n,) afterwards
    rate: np.ndarray
    limits: np.ndarray  # (4, n)
    law: np.ndarray  # a `motion.Law`
    error_at: Callable[[np.ndarray], np.ndarray]  # E at other joint values


class Postures:
    """Finds joint values for targets of the kinds that `ready` was told. Kernel units."""

    def __init__(self, robot: Any, options: Options, speed: np.ndarray) -> None:
        """options: what counts; speed (n,) of the joints."""
        self.robot = robot
        o = {name: getattr(options, name) for name in (*COUNTING, "relative_to")}
        exact = {"position_tolerance": TOLERANCE, "orientation_tolerance": TOLERANCE}
        row = find_row(GENERAL)
        one_attempt = Options(restarts=0, **exact, **o)
        self.plan = Plan(robot, row, row.load()(), one_attempt)
        weights = tuple((speed / max(speed.max(), TINY)).tolist())
        self.quick = Plan(robot, row, row.load()(), replace(one_attempt, joint_weights=weights))
        box = Ends(robot.chain.ends.reshape(len(robot.tips), -1)[0], robot.n)
        self._lever = np.tile([1.0] * 3 + [LEVER] * 3, len(robot.tips))
        self._turning = np.array([box.turns(i) > 0.0 for i in range(robot.n)])

    def ready(self, kinds: tuple) -> None:
        """Take targets of these kinds, and compile (or load) all that is needed later."""
        self.kinds = kinds
        q = self.robot.home / self.robot.chain.unit
        unlimited = np.outer([-1.0, 1.0, 1.0, 1.0], np.full(len(q), np.inf))
        for quick in (False, True):
            self.find(np.tile(np.eye(4), (1, len(kinds), 1, 1)), q[None], q, unlimited, quick=quick)
        travel(q, np.zeros_like(q), q, *UNKNOWN, 0.0, 1.0, WAIT, WAIT, unlimited, np.zeros(len(q), np.uint8))

    def find(
        self, T: np.ndarray, starts: np.ndarray, q: np.ndarray, limits: np.ndarray, *, quick: bool = False
    ) -> tuple[np.ndarray, bool]:
        """Joint values (K, n) of the attempts for targets T (N, F, 4, 4) from starts (N, n) that end inside limits (4, n).

        They are in order, and as near to q (n,) as full turns allow. quick: slow joints are to move less. Also True when a target
        is out of all reach.
        """
        plan, unit, n = self.quick if quick else self.plan, self.robot.chain.unit, self.robot.n
        rows = np.zeros((len(starts), plan.width))
        plan.run(T if self.robot.by_tip else T[:, 0], self.kinds, starts * unit, True, rows)
        status = rows[:, AT.status]
        found = rows[status == CONVERGED, ANSWER : ANSWER + n] / unit
        if not len(found):
            return found, bool((status == UNREACHABLE).any())
        turns = np.where(self._turning, np.round((q - found) / TAU), 0.0)
        turns = np.clip(turns, np.ceil((limits[0] - found) / TAU), np.floor((limits[1] - found) / TAU))
        found = found + TAU * turns
        inside = ((found >= limits[0] - NOISE) & (found <= limits[1] + NOISE)).all(axis=1)
        return np.clip(found[inside], limits[0], limits[1]), bool((status == UNREACHABLE).any())

    def size(self, E: np.ndarray) -> float:
        """Errors (m,) of all tips [m, rad] as one number [m]."""
        return math.hypot(*(self._lever * E).tolist())


def gap(T: np.ndarray, before: np.ndarray) -> float:
    """How far poses (F, 4, 4) are from others, as one number."""
    return math.hypot(*(T - before).ravel().tolist())


def locked(limits: np.ndarray) -> bool:
    """Whether a joint may not move."""
    return bool(((limits[2] == 0.0) | (limits[0] == limits[1])).any())
