"""Shorten and smooth one continuous piece of a path, keeping its poses, its limits and clear of contact."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..kernel.smooth import smooth as smooth_rows
from .continuity import targets

STEPS = 40  # most Gauss-Newton steps; ten usually suffice
ROUNDING = 0.5  # share of the mean step below which a step's cost is quadratic, so that joints do not stop and start
SMOOTHNESS = 10.0  # weight of second differences against steps: corners are rounded over its root, some three poses
ROUNDS = 6  # rounds of refinement, each with more poses held where it touched
WINDOW = 4  # poses held on either side of one that touches; doubled in each further round


def smooth(
    plan: Any,
    kinds: tuple,
    q: np.ndarray,
    T: np.ndarray,
    max_step: tuple[float, float],
    fixed: np.ndarray | None = None,
    bad: Callable[[np.ndarray], Any] | None = None,
) -> np.ndarray:
    """Shorten and smooth a motion q (N, n) [rad or m] through poses T (N, F, 4, 4), staying inside the tolerances.

    max_step (rad, m): no step grows beyond it (or beyond the longest in q). fixed (N,): poses whose joints stay. bad: function of
    a motion (N, n) that returns the poses where it is not acceptable, such as those that touch; these are held at q, and the rest
    is refined again. Returns q itself if nothing better is found.
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
