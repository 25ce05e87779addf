"""The directions in which an arm can move its tip: with fewer than the targets have, it cannot follow the straight line.

Between two poses that it reaches, such an arm takes the motion that keeps nearest the interpolated pose. Only what it can do
about the distance left is judged there; at the poses themselves everything counts.
"""

from typing import Any, NamedTuple

import numpy as np

from ..kernel.counted_error import FREE, POSE, POSITION
from ..solvers.protocol import Asked
from ..solvers.task import counted_errors, counts_in_part
from .interpolate import interpolate_poses

SAMPLES = 8  # random configurations that show the directions
FLAT = 1e-5  # singular value (lengths over the reach) below which a direction is none: descriptions are rounded


class Freedom(NamedTuple):
    """rank: directions of the task in which the joints move the tips; lacks: whether interpolated poses cannot be followed."""

    rank: int
    lacks: bool


def freedom(plan: Any, kinds: tuple) -> Freedom:
    """What the joints of a plan that are not held can do about targets of these kinds."""
    key = "freedom", kinds
    if key not in plan.memo:
        plan.memo[key] = _freedom(plan, kinds)
    return plan.memo[key]


def _freedom(plan: Any, kinds: tuple) -> Freedom:
    robot, rng = plan.robot, np.random.default_rng(0)
    blocks = [
        3 * (2 * f + part)
        for f, kind in enumerate(kinds)
        for part in (0, 1)
        if kind != FREE and (kind != POSITION or not part)
    ]
    moving = np.setdiff1d(np.arange(robot.n), plan.held)
    J = np.array([robot.jacobian(q) for q in robot.random_q(rng, SAMPLES)])[:, :, moving] * robot.chain.unit[moving]
    J = J.reshape(SAMPLES, -1, 3, len(moving))
    J[:, ::2] /= robot.reach
    J = J[:, [k // 3 for k in blocks]]

    def rank(M: np.ndarray) -> int:
        return int(np.linalg.matrix_rank(M, tol=FLAT)) if M.size else 0

    own = max((rank(one.reshape(-1, len(moving))) for one in J), default=0)
    everywhere = np.moveaxis(J, 0, 2).reshape(len(blocks), 3, -1)
    # Where the directions are the same everywhere, and none of a line is tied to one of a rotation, straight lines and
    # rotations about one axis stay among them: planar arms, gantries, SCARA arms.
    closed = own == rank(everywhere.reshape(-1, everywhere.shape[2])) == sum(rank(block) for block in everywhere)
    rows = Asked(robot, kinds, options=plan.options).rows
    plain = all(kind in (POSE, POSITION, FREE) for kind in kinds) and not counts_in_part(kinds, plan.options)
    wanted = 3 * len(blocks) if plain else rows
    return Freedom(min(own, rows), not closed and (own if plain else len(moving)) < wanted)


def missed(plan: Any, kinds: tuple, curve: np.ndarray, at: np.ndarray, T: np.ndarray) -> np.ndarray:
    """By how much [m] and [rad] (2, M-1) rows leave the tolerances because the arm lacks directions: 0 if it lacks none.

    Of each segment of a curve (M, n), whose rows are at places `at` (M,) among the poses T (N, F, 4, 4), the larger of both ends.
    """
    return off_the_poses(plan, kinds, curve, at, T) if freedom(plan, kinds).lacks else np.zeros((2, len(curve) - 1))


def off_the_poses(plan: Any, kinds: tuple, curve: np.ndarray, at: np.ndarray, T: np.ndarray) -> np.ndarray:
    """By how much [m] and [rad] (2, M-1) the rows of a curve leave the tolerances, whatever the arm; arguments as of `missed`."""
    left, goals, o = np.zeros((2, len(curve))), interpolate_poses(T, at, kinds), plan.options
    for k in np.flatnonzero(np.isfinite(curve).all(axis=1)):
        errors = counted_errors(plan.robot, curve[k], goals[k], kinds, o)
        left[:, k] = np.max([(position, angle or 0.0) for position, angle in errors], axis=0)
    left = np.maximum(left - [[o.position_tolerance], [o.orientation_tolerance]], 0.0)
    return np.maximum(left[:, 1:], left[:, :-1])
