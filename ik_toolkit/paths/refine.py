"""Shortening and smoothing one continuous piece of a path, without leaving its poses, its limits or free space."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..kernel.smooth import smooth as smooth_rows
from .continuity import targets

STEPS = 40  # of Gauss-Newton; a path is usually done in ten
ROUNDING = 0.5  # of the mean step: below it a step counts by its square, so that no joint moves by stops and starts
SMOOTHNESS = (
    10.0  # of second differences, as steps are measured: corners are rounded over the root of it, some three poses
)
ROUNDS = 6  # of the refinement, each with more poses held where it touched
WINDOW = 4  # poses held on either side of one that touches; twice as many in each further round


def smooth(
    plan: Any,
    kinds: tuple,
    q: np.ndarray,
    T: np.ndarray,
    max_step: tuple[float, float],
    fixed: np.ndarray | None = None,
    bad: Callable[[np.ndarray], Any] | None = None,
) -> np.ndarray:
    """A shorter and smoother motion through the same poses T (N, F, 4, 4), from one q (N, n) [rad or m] inside the tolerances.

    max_step (rad, m): no step grows beyond it (or beyond the longest there is). fixed (N,): poses whose joints stay. bad: a
    function of a motion (N, n) that returns the poses at which it may not be so, such as those that touch; those are held where
    q has them, and the rest is refined again. q itself is returned when nothing better is found.
    """
    robot = plan.robot
    held = np.zeros(len(q), dtype=bool) if fixed is None else np.array(fixed, dtype=bool)
    moves = np.abs(np.diff(q / robot.chain.unit, axis=0))
    if len(q) < 3 or held.all() or not moves.any():
        return q
    mean = float(moves.mean())
    cost = (1.0, SMOOTHNESS / mean, ROUNDING * mean)
    step = np.where(robot.slides, max_step[1], max_step[0])
    window = WINDOW
    for _ in range(ROUNDS):
        made, good = q.copy(), np.zeros(len(q), dtype=bool)
        arrays = (targets(robot, T), made, held, plan.orders(kinds, True))
        taken, _, _ = smooth_rows(*plan.chain[:2], *arrays, *cost, step, STEPS, good)
        if not taken or not good.all():
            return q
        worst = np.asarray(() if bad is None else bad(made), dtype=int)
        if not len(worst):
            return made
        for k in worst:
            held[max(k - window, 0) : k + window + 1] = True
        if held.all():
            break
        window *= 2
    return q
