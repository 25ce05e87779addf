"""Continuous collision check of a joint motion that is linear from row to row; it proves freedom of contact.

Suppose all pairs of shapes are farther apart than their margins at two configurations. Then nothing touches in between
if no pair can approach by more than the sum of both margins. The approach is at most sum_i |dq_i| W_i, where W_i is the
longest lever arm of the pair's shapes about joint i, and 0 if the joint moves both shapes alike. A pair's margin is a
common factor [rad] times the pair's longest arm. So links that are always close, and move little relative to each
other, get a small margin.

`connect` plans a collision-free motion between two configurations by RRT-Connect.
"""

import heapq
import itertools
import math
import time
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..robot.geometry.distance import Clearance
from ..robot.joints import Joints
from .certificate import Contact

# LARGEST is the first margin factor tested [rad]; it gives a margin of 1.5 cm for a lever arm of one metre. Each further margin
# factor is FINER times smaller than the one before.
LARGEST, FINER = 0.015, 4.0
# smallest margin [m] of the pair of shapes with the longest lever arm; if shapes are nearer, freedom of contact is not proven
FLOOR = 1e-4
# A check may make EACH collision tests per row of a curve, but at least AT_LEAST in all. Parts of the motion that are then untested
# count as not proven.
EACH, AT_LEAST = 30, 20_000


class Margins:
    """Collision tests of a CollisionModel in which a pair of shapes counts as touching if it is nearer than its margin.

    arms (n, pairs): lever arms, the largest change of a pair's distance per unit of each joint [m/rad or m/m]
    size (pairs,): longest lever arm of each pair [m]; a pair's margin is a margin factor [rad] times its size
    levels: the margin factors that are tested, largest first
    spent: number of tests made so far
    """

    def __init__(self, collision: Any, stroke: np.ndarray) -> None:
        """Compute the lever arms for a CollisionModel; stroke (n,): largest |q| of the motion (prismatic joints lengthen arms)."""
        self.collision = collision
        self.arms = _arms(collision, stroke)
        self.size = np.maximum(self.arms.max(axis=0, initial=0.0), FLOOR)
        floor = FLOOR / self.size.max(initial=FLOOR)
        levels = max(1, math.ceil(math.log(LARGEST / floor, FINER)))
        self.levels = [*(LARGEST / FINER**k for k in range(levels)), floor]
        self.robot = collision.robot
        self._spaces: dict[float, Any] = {}
        self.spent = 0

    def approach(self, dq: np.ndarray) -> np.ndarray:
        """Return by how much (S,) [rad] joint moves dq (S, n) [rad or m] can at most lower the margin factor of all pairs."""
        if not self.arms.shape[1]:
            return np.zeros(len(dq))
        return (np.abs(dq) @ (self.arms / self.size)).max(axis=1)

    def free(self, q: np.ndarray, margin: float) -> bool:
        """Return whether all pairs of shapes are farther apart at q (n,) than `margin` [rad] times their size (0: do not touch)."""
        self.spent += 1
        if margin == 0.0:
            return not self.collision.collides(q)
        space = self._spaces.get(margin)
        if space is None:
            space = self._spaces[margin] = self.collision.workspace(margin * self.size)
        data, found, boxes = space
        model, geometry = self.robot.model, self.collision.geometry
        full = self.robot._filled(q)
        if boxes is None:
            return not pin.computeCollisions(model, data, geometry, found, full, True)
        return not pin.computeCollisions(model, data, boxes, full, True)

    def around(self, q: np.ndarray, first: int = 0) -> tuple[float, int]:
        """Return the largest of the margin factors levels[first:] that all pairs of shapes keep at q (n,), and its index.

        If they keep none of them, the factor is 0 where nothing touches and -1 where shapes touch, and the index is the last.
        """
        for k in range(first, len(self.levels)):
            if self.free(q, self.levels[k]):
                return self.levels[k], k
        return (0.0 if self.free(q, 0.0) else -1.0), len(self.levels) - 1


def _arms(collision: Any, stroke: np.ndarray) -> np.ndarray:
    """Return the longest lever arm (n, pairs) [m] of each pair's shapes about each joint, over all configurations.

    It is 1 for a prismatic joint that moves one shape, and 0 for a joint that moves both alike. stroke (n,): largest
    |q|.
    """
    robot, geometry, model = collision.robot, collision.geometry, collision.robot.model
    data = model.createData()
    # At q = 0 the poses of the joints show how far joints that are held, and the offsets of those that mimic, move the links.
    pin.forwardKinematics(model, data, robot._filled(np.zeros(robot.n)))
    lead = dict(zip(model.mimicking_joints, model.mimicked_joints, strict=True))
    place = {int(x): i for i, x in enumerate(robot._path.idx_q)}
    # for each joint of Pinocchio's model its index in q, and how far it turns [rad] and slides [m] per unit of q
    moved: dict[int, tuple[int, float, float]] = {}
    for j in range(1, model.njoints):
        leader = model.joints[lead.get(j, j)]
        if leader.nv == 1 and leader.idx_q in place:
            screw = np.asarray(data.joints[j].S).reshape(6)
            moved[j] = (place[leader.idx_q], float(np.linalg.norm(screw[3:])), float(np.linalg.norm(screw[:3])))
    # own (shapes, n, joints of Pinocchio's model): lever arms of each shape. They are stored by the joint to which they belong, so
    # that joints that move both shapes of a pair can be left out below.
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
            reach += float(np.linalg.norm(data.liMi[j].translation))
            j = model.parents[j]
    arms = np.zeros((robot.n, len(geometry.collisionPairs)))
    for p, pair in enumerate(geometry.collisionPairs):
        a, b = own[pair.first], own[pair.second]
        arms[:, p] = np.where((a > 0.0) & (b > 0.0), 0.0, a + b).sum(axis=1)
    return arms


def find_contacts(
    collision: Any, curve: np.ndarray, at: np.ndarray, moving: np.ndarray, sag: np.ndarray | None = None
) -> tuple[float, tuple[Contact, ...], tuple[float, ...]]:
    """Check the motion between the rows of a curve (M, n) [rad or m] for contact.

    Args:
        collision: a CollisionModel.
        curve: (M, n) [rad or m]; rows of NaN are skipped.
        at: (M,) position of each row on the path (3.5: halfway from pose 3 to pose 4).
        moving: (M-1,) whether the robot moves from each row to the next; other segments are not checked.
        sag: (M-1, n) upper bound on each joint's deviation from the straight line between two rows; default 0.

    Returns:
        The proven least distance of any two parts [m] (0: not proven free of contact), contacts (one per row, or per segment
            between rows without contact, at most), and positions on the path that are not proven free.
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
    approach = margins.approach(np.diff(curve, axis=0))
    aside = np.zeros(len(approach)) if sag is None else 2.0 * margins.approach(sag)
    for k in np.flatnonzero(moving):
        if min(kept[k], kept[k + 1]) < 0.0:
            continue
        ends, moves = (kept[k], kept[k + 1]), (float(approach[k]), float(aside[k]))
        found = _between(margins, curve[k], curve[k + 1], ends, moves, most)
        if found.touches >= 0.0:
            q = curve[k] + found.touches * (curve[k + 1] - curve[k])
            place = float(at[k] + found.touches * (at[k + 1] - at[k]))
            contacts.append(Contact(place, collision.collisions(q)[0]))
        elif not found.proven:
            unproven.append(float(at[k]))
    clearance = 0.0
    if not contacts and not unproven:
        clearance = max(float(collision.margins.min(initial=math.inf)), _distance_kept(margins, curve, moving, sag))
    return clearance, tuple(contacts), tuple(unproven)


def _distance_kept(margins: Margins, curve: np.ndarray, moving: np.ndarray, sag: np.ndarray | None) -> float:
    """Return a lower bound on the distance [m] of any pair along a motion that is free of contact.

    The bound of a part of the motion is the distance at its ends minus the largest possible approach between them. The part with
    the lowest bound is halved until that is within a tenth of the least distance measured, or 2000 times. A pair is measured
    only where it could be the nearest one. The other arguments are those of `find_contacts`.
    """
    space, number, least = Clearance(margins.collision), itertools.count(), math.inf
    used = np.abs(np.diff(curve, axis=0)) @ margins.arms
    aside = np.zeros_like(used) if sag is None else sag @ margins.arms
    parts: list[tuple[float, int, int, Any, Any]] = []

    def measure(q: np.ndarray, known: np.ndarray, off: Any) -> np.ndarray:
        """Replace lower bounds by measured distances [m] for the pairs that may be the nearest ones at q; return the bounds.

        known (P,): lower bounds of the pairs' distances at q, changed in place; off (P,) or 0: how much nearer each pair may come
        because the motion deviates from the straight line. Also lowers `least`, the least distance so far.
        """
        nonlocal least
        near = np.flatnonzero(known - off < least)
        if len(near):
            space.place(q)
            known[near] = [space.distance(i) for i in near.tolist()]
        least = min(least, float((known - off).min(initial=math.inf)))
        return known

    def put(k: int, a: Any, b: Any) -> None:
        bound = 0.5 * (a[1] + b[1] - (b[0] - a[0]) * used[k]) - aside[k]
        heapq.heappush(parts, (float(bound.min(initial=math.inf)), next(number), k, a, b))

    before = np.empty(0)
    for k in np.flatnonzero(np.isfinite(curve).all(axis=1)).tolist():
        on = k > 0 and moving[k - 1]
        known = before - used[k - 1] if on else np.full(len(space.a), -math.inf)
        known = measure(curve[k], known, aside[k - 1] if on else 0.0)
        if on:
            put(k - 1, (0.0, before), (1.0, known))
        before = known
    for _ in range(2000):
        if not parts or least <= 0.0 or parts[0][0] >= 0.9 * least:
            break
        _, _, k, a, b = heapq.heappop(parts)
        share = 0.5 * (a[0] + b[0])
        known = np.maximum(a[1], b[1]) - 0.5 * (b[0] - a[0]) * used[k]
        middle = share, measure(curve[k] + share * (curve[k + 1] - curve[k]), known, aside[k])
        put(k, a, middle)
        put(k, middle, b)
    return max(min([least, *(part[0] for part in parts[:1])]), 0.0)


def clearance_along(collision: Any, way: np.ndarray) -> float:
    """Return the proven least distance [m] of any two parts along the straight joint moves through the corners `way` (K, n).

    collision: a CollisionModel, or None, for which the distance is infinite.
    """
    if collision is None:
        return math.inf
    return find_contacts(collision, way, np.arange(float(len(way))), np.ones(len(way) - 1, dtype=bool))[0]


class _SegmentCheck(NamedTuple):
    """Result for a straight joint move: whether it is proven free, and at which share of it (0 to 1) there is a contact, or -1."""

    proven: bool
    touches: float


def _between(
    margins: Margins, a: np.ndarray, b: np.ndarray, ends: tuple[float, float], moves: tuple[float, float], most: int
) -> _SegmentCheck:
    """Test the straight joint move from a to b (n,) for contact, by bisection, until margins prove every part free.

    ends: margin factors with which a and b are free; moves: margin factors used up by the straight line, which halve with each
    bisection, and by the deviation from it, which does not; most: largest number of tests in all.
    """
    proven = True
    stack = [(0.0, 1.0, *ends)]
    while stack:
        low, high, first, last = stack.pop()
        needed = moves[0] * (high - low) + moves[1]
        if needed <= first + last:
            continue
        if needed <= margins.levels[-1] or margins.spent >= most:
            proven = False
        else:
            middle = 0.5 * (low + high)
            enough = max((k for k, level in enumerate(margins.levels) if level >= 0.5 * needed), default=0)
            kept, _ = margins.around(a + middle * (b - a), enough)
            if kept < 0.0:
                return _SegmentCheck(False, middle)
            stack += [(middle, high, kept, last), (low, middle, first, kept)]
    return _SegmentCheck(proven, -1.0)


SECONDS = 2.0  # [s] time limit of the search for a free motion in `connect`
NODES = 20_000  # largest number of random points; on a fast machine it may end the search before the time limit
STEP = 0.25  # longest step with which a search tree grows towards a random point [rad, or length / reach]
SHORTCUTS = 60  # number of random attempts to replace a part of the motion found by a straight move
ALONG = 5_000  # largest number of collision tests for one straight joint move


def connect(robot: Joints, collision: Any, a: np.ndarray, b: np.ndarray, seed: int) -> np.ndarray | None:
    """Return the corners (K, n) of a piecewise linear joint motion from a to b (n,) that is proven free of contact.

    Returns None if none is found within SECONDS. collision: a CollisionModel, or None for a straight motion without a
    check; seed: number that fixes the random points. Source: Kuffner and LaValle, "RRT-Connect", ICRA 2000.
    """
    if collision is None:
        return np.array([a, b])
    low, high = _box(robot, a, b)
    margins = Margins(collision, np.maximum(np.abs(low), np.abs(high)))
    rng = np.random.default_rng(seed)
    if _free(margins, a, b):
        return np.array([a, b])
    ends = time.perf_counter() + SECONDS
    other, grown = _Branches(a), _Branches(b)
    for _ in range(NODES):
        if time.perf_counter() > ends:
            return None
        grown, other = other, grown
        new = grown.extend(margins, robot, rng.uniform(low, high))
        if new is None:
            continue
        met = other.reach_for(margins, robot, grown.points[new])
        if met is not None:
            corners = np.vstack([grown.way(new)[::-1], other.way(met)])
            return _shortened(margins, corners if grown.points[0] is a else corners[::-1], rng, ends)
    return None


def _box(robot: Joints, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper bounds (n,) of the random points of `connect`.

    They are the joint limits. A joint without limits may go half a turn, or half the reach, beyond a and b.
    """
    around = np.pi * np.where(robot.slides, robot.reach / 6.0, 1.0)
    low = np.where(np.isfinite(robot.lower), robot.lower, np.minimum(a, b) - around)
    return low, np.where(np.isfinite(robot.upper), robot.upper, np.maximum(a, b) + around)


def _free(margins: Margins, a: np.ndarray, b: np.ndarray) -> bool:
    """Return whether the straight joint move from a to b (n,) is proven free of contact."""
    kept = (margins.around(a)[0], margins.around(b)[0])
    if min(kept) < 0.0:
        return False
    moves = (float(margins.approach((b - a)[None])[0]), 0.0)
    return _between(margins, a, b, kept, moves, margins.spent + ALONG).proven


class _Branches:
    """One of the two trees of RRT-Connect: configurations connected by straight joint moves that are proven free of contact."""

    def __init__(self, root: np.ndarray) -> None:
        self.points, self.parents = [root], [-1]

    def extend(self, margins: Margins, robot: Joints, target: np.ndarray) -> int | None:
        """Grow the tree one step from its nearest point towards a target (n,); return the new point's index, None if blocked."""
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
        """Grow the tree until it reaches a target (n,); return the index of the point there, None if blocked."""
        while True:
            new = self.extend(margins, robot, target)
            if new is None:
                return None
            if np.array_equal(self.points[new], target):
                return new

    def way(self, k: int) -> np.ndarray:
        """Return the configurations (K, n) from point k of the search tree back to its root."""
        found = []
        while k >= 0:
            found.append(self.points[k])
            k = self.parents[k]
        return np.array(found)


def _shortened(margins: Margins, corners: np.ndarray, rng: np.random.Generator, ends: float) -> np.ndarray:
    """Shorten a motion with the corners (K, n) by random shortcuts that are proven free of contact, until the time `ends`."""
    keep = np.append(True, np.abs(np.diff(corners, axis=0)).max(axis=1) > 0.0)
    corners = corners[keep]
    for _ in range(SHORTCUTS):
        if len(corners) < 3 or time.perf_counter() > ends:
            break
        i, k = np.sort(rng.choice(len(corners), 2, replace=False))
        if k - i > 1 and _free(margins, corners[i], corners[k]):
            corners = np.delete(corners, np.arange(i + 1, k), axis=0)
    return corners
