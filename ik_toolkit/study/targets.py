"""Random reachable targets for studies, uniform in joints or in the volume reached."""

import hashlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..errors import InvalidOption, whole
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.solve import require_robot
from ..validate import one_of, switch

HOW = ("joints", "volume")
CELLS = 40  # number of voxels along the reach; the method 'volume' draws a random voxel for each target
POOL = 200_000  # number of random configurations from whose tip positions the method 'volume' finds the voxels in reach


def one_tip(robot: Robot | Tree, tip: str | None) -> str:
    """Return the tip to work with: the given one, or the only one of the robot if `tip` is None.

    Raises:
        InvalidOption: None is given, and the robot has several.
        FrameNotFound: The robot has no such tip.
    """
    if tip is None and len(robot.tips) > 1:
        raise InvalidOption(f"this needs a single tip; choose it with tip=: {', '.join(robot.tips)}")
    chosen = robot.arms[0].tip if tip is None else tip
    robot.check_tips([chosen])
    return chosen


def fingerprint(robot: Robot | Tree, *parts: Any) -> str:
    """Return a hash of a robot and further values, by which a program sees whether a file is from the same study.

    It differs for other joints, links or limits. parts: the further values, arrays or values whose repr shows all they hold.
    """
    digest = hashlib.sha256()
    for one in (robot.chain.rows, robot.chain.ends, robot.lower, robot.upper, *parts):
        digest.update(np.ascontiguousarray(one).tobytes() if isinstance(one, np.ndarray) else repr(one).encode())
        digest.update(b"|")
    return digest.hexdigest()


def sample_targets(
    robot: Robot | Tree,
    count: int,
    seed: Any = 0,
    *,
    how: str = "joints",
    position_only: bool = False,
    tip: str | None = None,
) -> np.ndarray:
    """Draw random targets that the robot can reach.

    Args:
        robot: The robot.
        count: Number of targets.
        seed: Anything that `numpy.random.default_rng` accepts.
        how: 'joints' takes tip poses at uniformly drawn joint values; 'volume' makes all voxels that the tip can enter, each a
            fortieth of the reach wide, equally likely.
        position_only: Return positions instead of poses.
        tip: Return the targets of this tip of a Tree only; 'volume' needs one.

    Returns:
        Poses (count, 4, 4), or positions (count, 3) [m], base frame; for all F tips of a Tree (count, F, 4, 4) or (count, F, 3).

    Raises:
        InvalidOption: An option is out of range, or a tip must be chosen.
        FrameNotFound: The robot has no such tip.
    """
    require_robot(robot)
    one_of(how, HOW, "way of sampling")
    switch(position_only, "position_only")
    count = whole(count, "targets")
    if tip is not None or how == "volume":
        tip = one_tip(robot, tip)
    try:
        rng = np.random.default_rng(seed)
    except (TypeError, ValueError):
        raise InvalidOption(
            f"seed must be whole numbers of at least 0 (numpy.random.default_rng), not {seed!r:.60}"
        ) from None
    if how == "joints":
        T = _poses(robot, robot.random_q(rng, count), tip)
    else:
        pool = _poses(robot, robot.random_q(np.random.default_rng(0), POOL), tip)
        cell = np.floor(pool[:, :3, 3] / (robot.reach / CELLS)).astype(np.int64)
        cell -= cell.min(axis=0)
        key = (cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1]) * (cell[:, 2].max() + 1) + cell[:, 2]
        order = np.argsort(key, kind="stable")
        _, first, size = np.unique(key[order], return_index=True, return_counts=True)
        voxel = rng.integers(0, len(first), count)
        T = pool[order[first[voxel] + np.floor(rng.random(count) * size[voxel]).astype(np.int64)]]
    return T[..., :3, 3].copy() if position_only else T


def _poses(robot: Robot | Tree, Q: np.ndarray, tip: str | None) -> np.ndarray:
    """Return the poses of all tips, or of one, at Q (count, n)."""
    if tip is None:
        return robot.chain.forward(Q)[0]
    f = robot.tips.index(tip)
    return robot.arms[f].chain.forward(Q[:, robot.places[f]])[0]


def stream_targets(
    robot: Robot | Tree, count: int, seed: int = 0, *, chunk: int = 8192, **asked: Any
) -> Iterator[np.ndarray]:
    """Yield random reachable targets (see `sample_targets`) in chunks, for more than fit in memory.

    Chunk k depends only on (seed, k).
    """
    count = whole(count, "targets")
    for k, done in enumerate(range(0, count, chunk)):
        yield sample_targets(robot, min(chunk, count - done), [seed, k], **asked)
