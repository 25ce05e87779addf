"""Random targets for studies: uniform in the joints, or uniform in the volume the tip reaches."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..errors import InvalidOption, near_match
from ..robot.robot import Robot
from ..robot.tree import Tree

HOW = ("joints", "volume")
CELLS = 40  # voxels along the reach, for volume-uniform targets
POOL = 200_000  # configurations that fill the voxels


def require_one_tip(robot: Any, what: str) -> None:
    """Raise InvalidOption unless `robot` is a Robot; `what` names the study in the sentence."""
    if isinstance(robot, Tree):
        tips = ", ".join(robot.tips)
        raise InvalidOption(
            f"{what} takes a Robot with one tip, not a Tree with the tips {tips}; load it with one of them"
        )
    if not isinstance(robot, Robot):
        raise InvalidOption(f"{what} takes a Robot (see Robot.load), not {type(robot).__name__}")


def sample_joints(robot: Robot, count: int, seed: Any) -> np.ndarray:
    """Configurations (count, n) [rad, m], uniform inside the limits (one turn or one reach where there are none)."""
    low, span = robot._sampling
    return low + span * np.random.default_rng(seed).random((count, robot.n))


def sample_targets(
    robot: Robot, count: int, seed: Any = 0, *, how: str = "joints", position_only: bool = False
) -> np.ndarray:
    """Reachable targets: poses (count, 4, 4), or positions (count, 3) [m].

    how: 'joints', the tip at joint values drawn uniformly; 'volume', every voxel of the reach (a fortieth of it wide) that the
    tip can enter is equally likely. seed: anything `numpy.random.default_rng` takes. Raises InvalidOption.
    """
    require_one_tip(robot, "sampling of targets")
    if how not in HOW:
        raise InvalidOption(f"targets are drawn by one of {', '.join(HOW)}, not '{how}'.{near_match(str(how), HOW)}")
    if isinstance(count, bool) or int(count) != count or count < 1:
        raise InvalidOption(f"the number of targets must be a whole number of at least 1, not {count!r}")
    rng = np.random.default_rng(seed)
    if how == "joints":
        T = robot.chain.forward(sample_joints(robot, count, rng))[0]
    else:
        pool = robot.chain.forward(sample_joints(robot, POOL, 0))[0]
        cell = np.floor(pool[:, :3, 3] / (robot.reach / CELLS)).astype(np.int64)
        cell -= cell.min(axis=0)
        key = (cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1]) * (cell[:, 2].max() + 1) + cell[:, 2]
        order = np.argsort(key, kind="stable")
        _, first, size = np.unique(key[order], return_index=True, return_counts=True)
        voxel = rng.integers(0, len(first), count)
        T = pool[order[first[voxel] + np.floor(rng.random(count) * size[voxel]).astype(np.int64)]]
    return T[:, :3, 3].copy() if position_only else T


def stream_targets(
    robot: Robot, count: int, seed: int = 0, *, how: str = "joints", position_only: bool = False, chunk: int = 8192
) -> Iterator[np.ndarray]:
    """The same in chunks, for more targets than fit in memory; chunk k depends on (seed, k) only."""
    for k, done in enumerate(range(0, count, chunk)):
        yield sample_targets(robot, min(chunk, count - done), [seed, k], how=how, position_only=position_only)
