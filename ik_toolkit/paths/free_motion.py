"""Collision-free motion from one configuration to another: straight, or by RRT-Connect."""

import time
from typing import Any

import numpy as np

from ..robot.joints import Joints
from .contact import Margins, _between

SECONDS = 2.0  # time limit of the search
NODES = 20_000  # most random points, so that a hopeless search also ends early on a fast machine
STEP = 0.25  # [rad, or fraction of the reach] longest step of a tree towards a point
SHORTCUTS = 60  # attempts to cut corners
ALONG = 5_000  # most tests of one straight move


def connect(robot: Joints, collision: Any, a: np.ndarray, b: np.ndarray, seed: int) -> np.ndarray | None:
    """Corners (K, n) of a piecewise straight motion from a to b (n,), inside the limits and proven collision-free.

    None if none is found within SECONDS. Kuffner and LaValle, "RRT-Connect", ICRA 2000.
    """
    if collision is None:
        return np.array([a, b])
    low, high = _box(robot, a, b)
    margins = Margins(collision, np.maximum(np.abs(low), np.abs(high)))
    rng = np.random.default_rng(seed)
    if _free(margins, a, b):
        return np.array([a, b])
    ends = time.perf_counter() + SECONDS
    trees = [_Branches(a), _Branches(b)]
    for k in range(NODES):
        if time.perf_counter() > ends:
            return None
        grown, other = trees[k % 2], trees[1 - k % 2]
        new = grown.extend(margins, robot, rng.uniform(low, high))
        if new is None:
            continue
        met = other.reach_for(margins, robot, grown.points[new])
        if met is not None:
            way = [grown.way(new), other.way(met)]
            corners = np.vstack([way[0][::-1], way[1]] if k % 2 == 0 else [way[1][::-1], way[0]])
            return _shortened(margins, corners, rng, ends)
    return None


def _box(robot: Joints, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Range of the random points: the limits, or half a turn (half the reach) beyond a and b where there are none."""
    around = np.pi * np.where(robot.slides, robot.reach / 6.0, 1.0)
    low = np.where(np.isfinite(robot.lower), robot.lower, np.minimum(a, b) - around)
    return low, np.where(np.isfinite(robot.upper), robot.upper, np.maximum(a, b) + around)


def _free(margins: Margins, a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the straight move is proven free of contact."""
    kept = (margins.around(a)[0], margins.around(b)[0])
    if min(kept) < 0.0:
        return False
    moves = (float(margins.approach((b - a)[None])[0]), 0.0)
    return _between(margins, a, b, kept, moves, margins.spent + ALONG).proven


class _Branches:
    """A tree of configurations connected by collision-free straight moves."""

    def __init__(self, root: np.ndarray) -> None:
        self.points, self.parents = [root], [-1]

    def extend(self, margins: Margins, robot: Joints, target: np.ndarray) -> int | None:
        """Grow one step from the nearest point towards a target; index of the new point."""
        points = np.array(self.points)
        near = int(np.argmin((((points - target) / robot.chain.unit) ** 2).sum(axis=1)))
        way = target - points[near]
        size = float(np.abs(way / robot.chain.unit).max())
        new = target if size <= STEP else points[near] + way * (STEP / size)
        if size <= 0.0 or not _free(margins, points[near], new):
            return None
        self.points.append(new)
        self.parents.append(near)
        return len(self.points) - 1

    def reach_for(self, margins: Margins, robot: Joints, target: np.ndarray) -> int | None:
        """Grow towards a target until it is reached; index of the point there, None if something is in the way."""
        while True:
            new = self.extend(margins, robot, target)
            if new is None:
                return None
            if np.array_equal(self.points[new], target):
                return new

    def way(self, k: int) -> np.ndarray:
        """Points from index k back to the root."""
        found = []
        while k >= 0:
            found.append(self.points[k])
            k = self.parents[k]
        return np.array(found)


def _shortened(margins: Margins, corners: np.ndarray, rng: np.random.Generator, ends: float) -> np.ndarray:
    """The same motion with fewer corners."""
    keep = np.append(True, np.abs(np.diff(corners, axis=0)).max(axis=1) > 0.0)
    corners = corners[keep]
    for _ in range(SHORTCUTS):
        if len(corners) < 3 or time.perf_counter() > ends:
            break
        i, k = np.sort(rng.choice(len(corners), 2, replace=False))
        if k - i > 1 and _free(margins, corners[i], corners[k]):
            corners = np.delete(corners, np.arange(i + 1, k), axis=0)
    return corners
