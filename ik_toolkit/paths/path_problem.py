"""The path problem: poses, what counts, limits and steps, as arrays in kernel units."""

from typing import Any

import numpy as np

from ..kernel.checks import CONVERGED, UNREACHABLE
from ..kernel.kinematics import TAU
from ..kernel.records import ANSWER, AT
from ..solvers.batch.parts import lanes_of
from ..solvers.enumerate import ONE_ATTEMPT
from ..solvers.plan import Plan
from ..solvers.protocol import Asked
from .continuity import settle_on_targets
from .freedom import freedom

# [rad], [m] from CppFlow; also the shortest step in which tracks are followed: shorter ones prove nothing.
STEP = (np.radians(7.0), 0.02)
# For an arm that cannot follow the interpolated poses: a step of a joint [rad], [m], and a deviation [m], [rad], of any size.
ANY_STEP, ANY_DEVIATION = (1e3, 1e6), (1e9, 1e9)


class Problem:
    """Poses T (N, 4, 4), for a Tree (N, F, 4, 4), of `kinds` for a bound solver, ready for the kernels of a path.

    most (n,): largest step of a joint, in kernel units, or STEP if that is longer (the rows that max_step requires are inserted
    at the end); deviation (2,) [m], [rad]: of a tip between poses; poses (N, F, 4, 4): T by tip, at places `at` (N,) among the
    requested poses (default: those themselves). stand (n,): where joints of weight 0 stay, q0 or home. plan: the solver's; single:
    plan for one attempt of the general search, with its arrays (rows, ends) and orders. limits (3, n): lower, upper, whether both
    exist; room: the same without those of joints whose full turns are added later. redundant: whether there are more joints than
    needed, so that solutions are not isolated.
    """

    def __init__(
        self,
        solver: Any,
        T: np.ndarray,
        kinds: tuple,
        max_step: tuple[float, float],
        deviation: tuple[float, float],
        q0: np.ndarray | None = None,
        at: np.ndarray | None = None,
    ) -> None:
        """Pack the kernel arrays."""
        robot, plan = solver.robot, solver.plan_for(kinds)
        self.robot, self.plan, self.T, self.kinds = robot, plan, T, kinds
        self.poses = T.reshape(len(T), -1, 4, 4)
        self.at = np.arange(float(len(T))) if at is None else at
        self.deviation = np.array(deviation)
        self.single: Plan = (plan.search if plan.row.closed else plan.varied)(**ONE_ATTEMPT)
        self.rows, self.ends = self.single.chain[:2]
        self.orders = self.single.orders(kinds, True)
        self.unit = robot.chain.unit
        self.stand = (robot.home if q0 is None else q0) / self.unit
        able = freedom(self.single, kinds)
        turn, slide = ANY_STEP if able.lacks else np.maximum(max_step, STEP)
        if able.lacks:  # between the poses there is nothing to reach: the steps are judged when they are known
            self.deviation = np.array(ANY_DEVIATION)
        self.most = np.where(robot.slides, slide, turn) / self.unit
        self.endless = (np.asarray(robot.chain.turns) > 0) & np.isinf(robot.lower) & np.isinf(robot.upper)
        free = np.full(robot.n, np.inf)
        low, high = (robot.lower, robot.upper) if plan.options.limits else (-free, free)
        self.limits = np.array([low / self.unit, high / self.unit, np.isfinite(low) & np.isfinite(high)])
        self.turning = np.flatnonzero((np.asarray(robot.chain.turns) > 0) & ~self.endless & plan.options.limits)
        asked = Asked(robot, kinds, options=plan.options)
        self.redundant = bool(robot.n - len(plan.held) > min(able.rank, asked.rows) or plan.options.slack is not None)
        self.room = self.limits.copy()
        if not self.redundant:
            self.room[0, self.turning], self.room[1, self.turning] = -np.inf, np.inf

    def solutions(self, t: int, Q0: np.ndarray) -> tuple[np.ndarray, float]:
        """Solutions (m, n) of pose t in kernel units, found by one attempt from each of Q0 (M, n) [rad, m].

        Joints with more than a full turn are on the turn nearest the middle of their limits. Also returns the proven distance of
        the pose out of reach [m], 0: not proven.
        """
        single, n = self.single, self.robot.n
        T, out = np.repeat(self.T[t : t + 1], len(Q0), axis=0), np.zeros((len(Q0), single.width))
        side_by_side = lanes_of(single, self.kinds)
        if side_by_side is not None:
            side_by_side(*single.arrays(self.kinds, Q0), T, Q0, out, self.orders)
        else:
            single.run(T, self.kinds, Q0, True, out)
        good = out[:, AT.status] == CONVERGED
        if not good.any():
            single.run(T[:1], self.kinds, Q0[:1], True, out[:1])
            return np.empty((0, n)), float(out[0, AT.excess]) if out[0, AT.status] == UNREACHABLE else 0.0
        return self.turned(out[good, ANSWER : ANSWER + n] / self.unit), 0.0

    def turned(self, Q: np.ndarray) -> np.ndarray:
        """Q (m, n) with joints that have more than a full turn on the turn nearest the middle of their limits."""
        Q = Q.copy()
        turning = np.asarray(self.robot.chain.turns) > 0
        turning[self.plan.held] = False
        for i in np.flatnonzero(turning):
            low, high = self.limits[:2, i]
            at = 0.5 * (low + high) if np.isfinite(high - low) else np.clip(0.0, low + np.pi, high - np.pi)
            Q[:, i] -= TAU * np.rint((Q[:, i] - at) / TAU)
        return Q

    def inside(self, q: np.ndarray) -> np.ndarray:
        """Rows q (M, n) [rad or m] moved back inside limits exceeded by rounding in kernel units."""
        return np.clip(q, self.robot.lower, self.robot.upper) if self.plan.options.limits else q

    def settled(self, Q: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Q (m, n) in kernel units moved onto the poses t (m,), and whether each is reached (m,)."""
        rows, good = settle_on_targets(self.single, self.kinds, Q * self.unit, self.poses[t])
        return rows / self.unit, good
