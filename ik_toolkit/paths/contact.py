"""Collision check while the joints move linearly from row to row: a proof by tests with a margin, not sampling.

If all pairs are farther apart than their margins at two configurations, nothing touches in between as long as no pair can come
closer by more than the sum of both margins. That approach is bounded by sum_i |dq_i| W_i, with W_i the longest lever arm of the
pair's shapes about joint i; joints that move both shapes alike do not count. A pair's margin is a common factor times its own
longest arm, so that links which are always close to each other (and move little relative to each other) do not spoil the test.
"""

import math
import time
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..robot.geometry.distance import Clearance
from ..robot.joints import Joints
from .certificate import Contact

# [rad] largest margin tried, and the factor to each smaller one: up to 1.5 cm at one metre, where tests are still cheap.
LARGEST, FINER = 0.015, 4.0
FLOOR = 1e-4  # [m] margin below which two shapes count as too close to tell
# Tests allowed per row of a curve, and for any curve; after that the rest counts as not proven.
EACH, AT_LEAST = 30, 20_000


class Margins:
    """A collision model tested with margins: the same shapes and pairs, with arms W (n, pairs) [m per rad, or m per m]."""

    def __init__(self, collision: Any, stroke: np.ndarray) -> None:
        """stroke (n,): the largest |q| along the curve, for prismatic joints."""
        self.collision = collision
        self.arms = _arms(collision, stroke)
        self.size = np.maximum(self.arms.max(axis=0, initial=0.0), FLOOR)
        floor = FLOOR / self.size.max(initial=FLOOR)
        levels = max(1, math.ceil(math.log(LARGEST / floor, FINER)))
        self.levels = [*(LARGEST / FINER**k for k in range(levels)), floor]
        self.robot, self.rest = collision.robot, collision.robot.rest
        self._spaces: dict[float, Any] = {}
        self.spent = 0

    def approach(self, dq: np.ndarray) -> np.ndarray:
        """Margin that moves dq (S, n) can use up."""
        if not self.arms.shape[1]:
            return np.zeros(len(dq))
        return (np.abs(dq) @ (self.arms / self.size)).max(axis=1)

    def free(self, q: np.ndarray, margin: float) -> bool:
        """Whether all pairs are farther apart than margin times their size at q (n,); margin 0: whether nothing touches."""
        self.spent += 1
        if margin == 0.0:
            return not self.collision.collides(q)
        space = self._spaces.get(margin)
        if space is None:
            space = self._spaces[margin] = self.collision.workspace(margin * self.size)
        data, found, boxes = space
        model, geometry = self.robot.model, self.collision.geometry
        full = self.robot._fill(self.rest.copy(), q)
        if boxes is None:
            return not pin.computeCollisions(model, data, geometry, found, full, True)
        return not pin.computeCollisions(model, data, boxes, full, True)

    def around(self, q: np.ndarray, first: int = 0) -> tuple[float, int]:
        """Largest margin of levels[first:] that q (n,) keeps, and its index; margin 0: keeps none, -1: touches."""
        for k in range(first, len(self.levels)):
            if self.free(q, self.levels[k]):
                return self.levels[k], k
        return (0.0 if self.free(q, 0.0) else -1.0), len(self.levels) - 1


def _arms(collision: Any, stroke: np.ndarray) -> np.ndarray:
    """Longest arm (n, pairs) of each pair about each joint [m], 1 for a prismatic joint; 0 where it moves both alike."""
    robot, geometry, model = collision.robot, collision.geometry, collision.robot.model
    data = model.createData()
    pin.forwardKinematics(model, data, robot._fill(robot.rest.copy(), robot.home))
    lead = dict(zip(model.mimicking_joints, model.mimicked_joints, strict=True))
    place = {int(x): i for i, x in enumerate(robot._path.idx_q)}
    moved: dict[int, tuple[int, float, float]] = {}  # joint -> coordinate, rotation and translation per unit of it
    for j in range(1, model.njoints):
        leader = model.joints[lead.get(j, j)]
        if leader.nv == 1 and leader.idx_q in place:
            screw = np.asarray(data.joints[j].S).reshape(6)
            moved[j] = (place[leader.idx_q], float(np.linalg.norm(screw[3:])), float(np.linalg.norm(screw[:3])))
    # By joint, to leave out joints that both shapes share.
    own = np.zeros((len(geometry.geometryObjects), robot.n, model.njoints))
    for k, shape in enumerate(geometry.geometryObjects):
        shape.geometry.computeLocalAABB()
        centre = shape.placement.act(np.asarray(shape.geometry.aabb_center))
        reach = float(np.linalg.norm(centre)) + shape.geometry.aabb_radius
        j = shape.parentJoint
        while j > 0:
            if j in moved:
                i, turn, slide = moved[j]
                own[k, i, j] = turn * reach + slide
                reach += slide * stroke[i]
            reach += float(np.linalg.norm(model.jointPlacements[j].translation))
            j = model.parents[j]
    arms = np.zeros((robot.n, len(geometry.collisionPairs)))
    for p, pair in enumerate(geometry.collisionPairs):
        a, b = own[pair.first], own[pair.second]
        arms[:, p] = np.where((a > 0.0) & (b > 0.0), 0.0, a + b).sum(axis=1)
    return arms


def find_contacts(
    collision: Any, curve: np.ndarray, at: np.ndarray, moving: np.ndarray, sag: np.ndarray | None = None
) -> tuple[float, tuple[Contact, ...], tuple[float, ...]]:
    """Clearance [m], contacts and places not proven free, over the segments `moving` (M-1,) between rows of a curve (M, n).

    sag (M-1, n): upper bound on each joint's deviation from the straight line between two rows; default 0. At most one contact
    is listed per segment. Rows of NaN are skipped.
    """
    finite = np.isfinite(curve).all(axis=1)
    stroke = np.abs(curve[finite]).max(axis=0, initial=0.0)
    margins = Margins(collision, stroke)
    most = max(AT_LEAST, EACH * len(curve))
    contacts: list[Contact] = []
    unproven: list[float] = []
    kept, level = np.full(len(curve), np.nan), 0
    for k in np.flatnonzero(finite):
        kept[k], level = margins.around(curve[k], max(level - 1, 0))
        if kept[k] < 0.0:
            contacts.append(Contact(float(at[k]), collision.collisions(curve[k])[0]))
    left = float(np.nanmin(kept, initial=math.inf))
    approach = margins.approach(np.diff(curve, axis=0))
    aside = np.zeros(len(approach)) if sag is None else 2.0 * margins.approach(sag)
    for k in np.flatnonzero(moving):
        if min(kept[k], kept[k + 1]) < 0.0:
            continue
        ends, moves = (kept[k], kept[k + 1]), (float(approach[k]), float(aside[k]))
        found = _between(margins, curve[k], curve[k + 1], ends, moves, most)
        left = min(left, found.spare)
        if found.touches >= 0.0:
            q = curve[k] + found.touches * (curve[k + 1] - curve[k])
            place = float(at[k] + found.touches * (at[k + 1] - at[k]))
            contacts.append(Contact(place, collision.collisions(q)[0]))
        elif not found.proven:
            unproven.append(float(at[k]))
    clearance = max(left, 0.0) * float(margins.size.min(initial=math.inf))
    if left >= 0.0:
        clearance += float(collision.margins.min(initial=math.inf))
    if not contacts and not unproven:
        clearance = max(clearance, _distance_kept(margins, curve, moving, sag))
    return clearance, tuple(contacts), tuple(unproven)


def _distance_kept(margins: Margins, curve: np.ndarray, moving: np.ndarray, sag: np.ndarray | None) -> float:
    """Lower bound on the distance [m] of any pair along the motion, from distances at the rows less what the moves can use up.

    A pair is measured only where it could be the nearest.
    """
    space = Clearance(margins.collision)
    used = np.abs(np.diff(curve, axis=0)) @ margins.arms
    aside = np.zeros_like(used) if sag is None else 2.0 * sag @ margins.arms
    least, known = math.inf, np.full(len(space.a), -math.inf)
    for k in np.flatnonzero(np.isfinite(curve).all(axis=1)):
        on = k > 0 and moving[k - 1]
        before = known if on else np.full(len(known), math.inf)
        known = before - used[k - 1] if on else np.full(len(known), -math.inf)
        near = np.flatnonzero(known - (aside[k - 1] if on else 0.0) < least)
        if len(near):
            space.place(curve[k])
            known[near] = [space.distance(i) for i in near.tolist()]
        least = min(least, float(known.min(initial=math.inf)))
        if on:
            least = min(least, float((0.5 * (before + known - used[k - 1] - aside[k - 1])).min(initial=math.inf)))
    return max(least, 0.0)


class _Stretch(NamedTuple):
    """Result for a segment: whether it is proven free, the spare margin, and the fraction of it at which it touches, or -1."""

    proven: bool
    spare: float
    touches: float


def _between(
    margins: Margins, a: np.ndarray, b: np.ndarray, ends: tuple[float, float], moves: tuple[float, float], most: int
) -> _Stretch:
    """Test the move from a to b (n,), whose ends keep the margins `ends`, by bisection until the margins cover the move.

    moves: margin used by the straight line, which halves with each bisection, and by the deviation from it, which does not.
    """
    proven, spare = True, math.inf
    stack = [(0.0, 1.0, *ends)]
    while stack:
        low, high, first, last = stack.pop()
        needed = moves[0] * (high - low) + moves[1]
        if needed <= first + last:
            spare = min(spare, 0.5 * (first + last - needed))
        elif needed <= margins.levels[-1] or margins.spent >= most:
            proven = False
        else:
            middle = 0.5 * (low + high)
            enough = max((k for k, level in enumerate(margins.levels) if level >= 0.5 * needed), default=0)
            kept, _ = margins.around(a + middle * (b - a), enough)
            if kept < 0.0:
                return _Stretch(False, 0.0, middle)
            stack += [(middle, high, kept, last), (low, middle, first, kept)]
    return _Stretch(proven, spare if proven else 0.0, -1.0)


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
