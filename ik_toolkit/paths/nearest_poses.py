"""Poses that an arm can reach, nearest to those asked for in order of priority: what `solve_path` follows with a priority."""

from typing import Any

import numpy as np

from ..kernel.checks import CONVERGED
from ..kernel.records import ANSWER, AT
from ..solvers.enumerate import search_solutions
from ..solvers.task import counted_errors, group_levels

STARTS = 200  # number of random starts from which the first pose is solved
FOLLOWED = 8  # largest number of minima of the first pose that are followed along the path
JUMP = 0.5  # [rad or arm reaches] a joint that moves further between two poses has changed its branch


def nearest_poses(solver: Any, T: np.ndarray, kinds: tuple, q0: np.ndarray | None) -> np.ndarray:
    """Return the poses nearest to T (N, 4, 4) or (N, F, 4, 4) that one posture of the arm reaches.

    Each of several minima of the first pose is followed from pose to pose, and the one is taken that misses the fewest poses,
    jumps least often, and then has the least errors of the lower levels. A pose whose first level is out of reach stays as it is.

    Args:
        solver: A Solver with the option `priority`.
        T: The poses asked for [m].
        kinds: A target kind per tip.
        q0: (n,) Start of the path [rad or m], or None.
    """
    plan = solver.plan_for(kinds)
    start = (plan.home if q0 is None else q0[None]).copy()
    minima = search_solutions(plan, T[:1], kinds, start, STARTS, FOLLOWED).q
    followed = [_follow(plan, T, kinds, q) for q in (minima if len(minima) else start)]
    Q, good = min(followed, key=lambda one: _worth(plan, T, kinds, *one))
    nearest = T.copy()
    for t in np.flatnonzero(good):
        nearest[t] = np.reshape([pose.homogeneous for pose in plan.robot.tip_poses(Q[t])], T.shape[1:])
    return nearest


def _follow(plan: Any, T: np.ndarray, kinds: tuple, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return joint values (N, n) at the poses, each found from the one before, and whether each meets the first level (N,)."""
    robot = plan.robot
    single = plan.varied(restarts=0)
    Q, good = np.empty((len(T), robot.n)), np.zeros(len(T), dtype=bool)
    for t in range(len(T)):
        row = single.solve(T[t : t + 1], kinds, q[None], True)
        if row[AT.status] != CONVERGED:
            row = plan.solve(T[t : t + 1], kinds, q[None], True)
        Q[t], good[t] = row[ANSWER : ANSWER + robot.n], row[AT.status] == CONVERGED
        q = Q[t] if good[t] else q
    return Q, good


def _worth(plan: Any, T: np.ndarray, kinds: tuple, Q: np.ndarray, good: np.ndarray) -> tuple[int, int, float]:
    """Return how many poses a posture misses, how often it jumps, and the sum of its errors of the lower levels."""
    lower = np.array(group_levels(plan.robot, plan.options)) > 0
    total = 0.0
    for t in np.flatnonzero(good):
        errors = counted_errors(plan.robot, Q[t], T[t], kinds, plan.options)
        total += sum(error or 0.0 for error, less in zip((x for pair in errors for x in pair), lower, strict=True) if less)
    moves = np.abs(np.diff(Q[good], axis=0)) / plan.robot.chain.unit
    return int((~good).sum()), int((moves > JUMP).any(axis=1).sum()), total
