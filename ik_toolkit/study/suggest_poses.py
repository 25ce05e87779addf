"""`ik.suggest_poses`: configurations whose measurement determines an arm's errors best."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import InvalidOption, ModelError, whole
from ..robot.geometry.collision import CollisionModel
from ..robot.robot import Robot
from ..robot.tree import require_one_tip
from ..solvers.collision_free import collision_model
from .drawn_arm import GROUPS, DrawnArm, read_groups
from .measurements import NOISE, PRIOR, WHAT, read_noise

CANDIDATES = 400  # number of random configurations among which those to measure are chosen


def suggest_poses(
    robot: Robot,
    count: int,
    *,
    what: str = "position",
    parameters: Sequence[str] = GROUPS[:3],
    noise: Any = None,
    avoid_collisions: Any = True,
    seed: int = 0,
) -> np.ndarray:
    """Choose the configurations whose measurement determines an arm's errors best.

    The configurations are D-optimal among random ones inside the limits and free of collisions. They are chosen one by one, each
    enlarging the determinant of the information matrix most (Fedorov 1972), and then each is exchanged once for a better one. Their
    order makes the motions between them short.

    Args:
        robot: The nominal robot.
        count: Number of configurations.
        what: What will be measured, 'pose' or 'position'.
        parameters: Which errors are to be found, as for `calibrate`.
        noise: Standard deviation of a measurement (length [m], angle [rad]), or a length; default (0.0005, 0.001).
        avoid_collisions: Whether to leave out self-collisions (where the robot has collision shapes), or a CollisionModel.
        seed: Seed of the random configurations.

    Returns:
        q (count, n) [rad or m].

    Raises:
        InvalidOption: An argument is wrong or of another robot, or too few configurations are free of collisions.
    """
    require_one_tip(robot, "suggest_poses")
    if isinstance(avoid_collisions, CollisionModel):
        collision_model(robot, avoid_collisions)  # refuses the model of another robot
    arm = DrawnArm(robot, read_groups(parameters))
    sigma = read_noise(noise) or NOISE
    spread = arm.scales(*PRIOR)
    x = np.random.default_rng(whole(seed, "seed", 0)).normal(size=len(spread)) * spread * 0.3
    x[[one.group == "base" for one in arm.unknowns]] = 0.0
    return chosen_poses(arm, x, np.diag(1.0 / spread**2), count, what, sigma, PRIOR, avoid_collisions, seed)


def chosen_poses(
    arm: DrawnArm,
    x: np.ndarray,
    known: np.ndarray,
    count: int,
    what: str,
    noise: Sequence[float],
    prior: Sequence[float],
    avoid: Any,
    seed: int,
) -> np.ndarray:
    """Choose the configurations (count, n) [rad or m] that add most to earlier measurements.

    known: inverse covariance (P, P) of the unknowns after the earlier measurements.
    """
    count = whole(count, "count")
    if what not in ("pose", "position"):
        raise InvalidOption(
            f"configurations are suggested for what='pose' or 'position', not {what!r:.40}; touches are where the {what}s are"
        )
    Q = _candidates(arm.robot, max(CANDIDATES, 4 * count), avoid, seed)
    if len(Q) < count:
        raise InvalidOption(
            f"only {len(Q)} of the random configurations are free of collisions; ask for fewer than {count}, or allow them"
        )
    Q = Q * arm.sign
    T, J = arm.evaluate(x, Q)
    rows = [T[:, :3, :3] @ J[:, :3] / noise[0], J[:, 3:] / noise[1]][: WHAT[what] // 3]
    s = arm.scales(*prior)
    J = np.concatenate(rows, axis=1) * s
    M = known * np.outer(s, s)
    picked: list[int] = []

    def best(M: np.ndarray) -> int:
        # One system with all rows on its right side: a system for each candidate would factor the same matrix for each.
        L = np.linalg.solve(M + 1e-9 * np.eye(len(M)), J.reshape(-1, len(M)).T).T.reshape(J.shape)
        gain = np.linalg.slogdet(np.eye(J.shape[1]) + J @ np.swapaxes(L, 1, 2))[1]
        gain[picked] = -np.inf
        return int(gain.argmax())

    for k in range(2 * count):
        if k >= count:
            first = picked.pop(0)
            M = M - J[first].T @ J[first]
        picked.append(best(M))
        M = M + J[picked[-1]].T @ J[picked[-1]]
    return _in_short_moves(Q[picked], arm.robot.home)


def _candidates(robot: Robot, count: int, avoid: Any, seed: int) -> np.ndarray:
    """Return random configurations (m, n), at most `count`; if collisions are to be avoided, without those in collision."""
    Q = robot.random_q(np.random.default_rng(whole(seed, "seed", 0)), count)
    if avoid is True:
        try:
            avoid = CollisionModel(robot)
        except ModelError:  # A robot without collision shapes has no collisions to avoid.
            avoid = False
    if isinstance(avoid, CollisionModel):
        return Q[[not avoid.collides(q) for q in Q]]
    if avoid is not False:
        raise InvalidOption(f"avoid_collisions must be True, False or a CollisionModel, not {avoid!r:.60}")
    return Q


def _in_short_moves(Q: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Order configurations greedily: each is the nearest remaining one to the one before."""
    left, at, order = list(range(len(Q))), start, []
    while left:
        k = min(left, key=lambda one: float(np.abs(Q[one] - at).max()))
        left.remove(k)
        order.append(k)
        at = Q[k]
    return Q[order]
