"""A path as it is solved: poses, what counts of them, limits and steps, as arrays in kernel units."""

from typing import Any

import numpy as np

from ..kernel.records import ANSWER, AT
from ..solvers.batch_parts import lanes_of
from ..solvers.plan import Plan
from ..solvers.search_all import ONE_ATTEMPT
from ..solvers.status import Status


class Problem:
    """Poses T (N, 4, 4) or (N, F, 4, 4) of `kinds` for a plan, ready for the kernels of a path.

    most (n,): largest step of a joint, in kernel units; deviation [m, rad]: of the tip between poses. single: the plan of one
    attempt of the general search; arrays: rows, ends; orders: of the kernel; limits (3, n): where continuation keeps the joints.
    """

    def __init__(self, plan: Plan, T: np.ndarray, kinds: tuple, max_step: tuple[float, float], deviation: float) -> None:
        """Pack what the kernels read."""
        robot = plan.robot
        self.robot, self.plan, self.T, self.kinds, self.deviation = robot, plan, T, kinds, deviation
        self.single = (plan.search if plan.row.closed else plan.varied)(**ONE_ATTEMPT)
        self.rows, self.ends = self.single.chain[:2]
        self.orders = self.single.orders(kinds, True)
        self.unit = robot.chain.unit
        slides = np.array([kind == "prismatic" for kind in robot.joint_kinds])
        self.most = np.where(slides, max_step[1], max_step[0]) / self.unit
        self.turns = np.asarray(robot.chain.turns)
        self.endless = (self.turns > 0) & np.isinf(robot.lower) & np.isinf(robot.upper)
        low, high = robot.lower / self.unit, robot.upper / self.unit
        if not plan.options.limits:
            low, high = np.full(robot.n, -np.inf), np.full(robot.n, np.inf)
        counted = np.isfinite(low) & np.isfinite(high)
        self.limits = np.array([low, high, counted])

    @property
    def redundant(self) -> bool:
        """Whether joints are left over, so that solutions are not isolated."""
        from ..solvers.protocol import Asked

        o = self.plan.options
        return self.robot.n - len(self.plan.held) > Asked(self.robot, self.kinds, options=o).rows

    def solutions(self, t: int, Q0: np.ndarray) -> np.ndarray:
        """Solutions (m, n) of pose t, kernel units: what one attempt from each of Q0 (M, n) [rad, m] converges to."""
        single, n = self.single, self.robot.n
        T = np.repeat(self.T[t : t + 1], len(Q0), axis=0)
        out = np.zeros((len(Q0), single.width))
        side_by_side = lanes_of(single, self.kinds)
        if side_by_side is not None:
            side_by_side(*single.arrays(self.kinds, Q0), T, Q0, out, self.orders)
        else:
            single.run(T, self.kinds, Q0, True, out)
        return out[out[:, AT.status] == Status.CONVERGED, ANSWER : ANSWER + n] / self.unit
