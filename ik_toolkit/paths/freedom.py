"""The degrees of freedom of an arm's tips: with fewer than the targets need, interpolated poses cannot be followed.

Between two poses that it reaches, such an arm moves as near to the interpolated poses as it can. The unavoidable error between the
poses is not counted against the path tolerance. At the poses themselves every error counts.
"""

from typing import Any, NamedTuple

import numpy as np

from ..kernel.counted_error import KIND
from ..motion.reference import interpolate_poses
from ..solvers.protocol import Asked
from ..solvers.task import counted_errors, counts_in_part, free_axis, what_counts

SAMPLES = 8  # number of random configurations whose Jacobians are examined
# Singular values of the Jacobian (lengths / reach) below this count as zero, because robot descriptions hold rounded
# numbers.
FLAT = 1e-5


class Freedom(NamedTuple):
    """How many components of a path's targets the joints can change, and whether these are too few to follow the path.

    rank: number of independent components of the targets that the joints can move (generic rank of the task Jacobian). lacks:
    whether this rank is too low to follow the interpolated poses between two poses.
    """

    rank: int
    lacks: bool


def freedom(plan: Any, kinds: tuple) -> Freedom:
    """Return how many components of targets can be changed by the joints whose weight is not 0, see `Freedom`.

    plan: the solver's Plan; kinds: the kind of each tip's target (pose, position, ...).
    """
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
        if kind != KIND.free and (kind != KIND.position or not part)
    ]
    moving = np.setdiff1d(np.arange(robot.n), plan.held)
    Q = robot.random_q(rng, SAMPLES)
    J = np.array([robot.jacobian(q) for q in Q])[:, :, moving] * robot.chain.unit[moving]
    J = J.reshape(SAMPLES, -1, 3, len(moving))
    J[:, ::2] /= robot.reach
    used = [k // 3 for k in blocks]

    def rank(M: np.ndarray) -> int:
        return int(np.linalg.matrix_rank(M, tol=FLAT)) if M.size else 0

    def most(J: np.ndarray) -> int:
        return max((rank(one.reshape(-1, len(moving))) for one in J[:, used]), default=0)

    own = most(J)
    everywhere = np.moveaxis(J[:, used], 0, 2).reshape(len(blocks), 3, -1)
    # `closed`: the arm can move in the same directions everywhere, and turn independently of where it moves, as planar arms,
    # gantries and SCARA arms can. Interpolation between two of its poses then needs no direction in which the arm cannot move.
    closed = own == rank(everywhere.reshape(-1, everywhere.shape[2])) == sum(rank(block) for block in everywhere)
    rows = Asked(robot, kinds, options=plan.options).rows
    if all(kind in (KIND.pose, KIND.position, KIND.free) for kind in kinds) and not counts_in_part(kinds, plan.options):
        return Freedom(min(own, rows), not closed and own < 3 * len(blocks))
    for f, (kind, counts) in enumerate(zip(kinds, what_counts(robot, plan.options), strict=True)):
        if (axis := free_axis(counts, kind)) is not None:  # Rotation about this axis of the tip does not count.
            free = np.array([robot.tip_poses(q)[f].rotation @ axis for q in Q])
            J[:, 2 * f + 1] -= free[:, :, None] * np.einsum("si,sij->sj", free, J[:, 2 * f + 1])[:, None]
    able = most(J)
    return Freedom(min(able, rows), not closed and able < rows)


def missed(plan: Any, kinds: tuple, curve: np.ndarray, at: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Return by how much [m], [rad] (2, M-1) a joint motion misses the interpolated poses because the arm has too few joints.

    The errors are those beyond the tolerances, and 0 for an arm with enough joints. The result for a segment between two rows of
    the curve (M, n) is the larger of the values at its two ends. at (M,): positions of the rows on the path through the poses T (N,
    F, 4, 4).
    """
    return off_the_poses(plan, kinds, curve, at, T) if freedom(plan, kinds).lacks else np.zeros((2, len(curve) - 1))


def off_the_poses(plan: Any, kinds: tuple, curve: np.ndarray, at: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Return by how much [m], [rad] (2, M-1) the rows of a joint motion miss the interpolated poses, beyond the tolerances.

    The result for a segment is the larger of the values at its two ends. Unlike in `missed`, it is not 0 for an arm with enough
    joints.
    """
    o = plan.options
    left = np.nan_to_num(errors_at_rows(plan.robot, curve, interpolate_poses(T, at, kinds), kinds, o)).T
    left = np.maximum(left - [[o.position_tolerance], [o.orientation_tolerance]], 0.0)
    return np.maximum(left[:, 1:], left[:, :-1])


def errors_at_rows(robot: Any, q: np.ndarray, T: np.ndarray, kinds: tuple, o: Any) -> np.ndarray:
    """Return the errors that count [m], [rad] (N, 2) of each row of q (N, n) from its target, the largest of all tips.

    The errors of a row of q that is not finite are NaN. T (N, ...): a target for each row; kinds: the kind of each tip's target
    (pose, position, ...); o: the options that say what counts.
    """
    errors = np.full((len(q), 2), np.nan)
    for t in np.flatnonzero(np.isfinite(q).all(axis=1)):
        left = counted_errors(robot, q[t], T[t], kinds, o)
        errors[t] = np.max([(position, angle or 0.0) for position, angle in left], axis=0)
    return errors
