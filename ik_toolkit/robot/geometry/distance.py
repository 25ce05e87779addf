"""Measures distances between the parts of a robot and its surroundings, and how fast they can shrink.

Distances are between convex hulls, at about a microsecond per pair; the exact shapes, which lie inside their hulls, are
measured only where hulls meet.
"""

import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from ...kernel.clearance import (
    Approach,
    Bodies,
    BrakingPath,
    HalfPlanes,
    NearPairs,
    Separation,
    free_until,
    levers,
    rows,
)
from ..probe import mimics
from .convex import hull_of

# A lock for the computation of convex hulls, because coal stores a hull in its mesh, which other threads may use.
BUILDING = threading.Lock()
# While a robot moves, the nearest points of two shapes may jump, as from one end of an edge to the other. So for each pair of
# shapes up to CORNERS pairs of earlier nearest points are remembered, as long as their distance is at most NEARBY [m] above the
# least. Points within APART [m] of each other count as one.
CORNERS, NEARBY, APART = 4, 0.03, 0.01
THIN = 1e-5  # A mesh thinner than this fraction of its size counts as flat. qhull fails at 1e-9.


class Near(NamedTuple):
    """Two parts and the distance [m] between them.

    `points` (2, 3) are their nearest points and `normal` (3,) is the unit vector from the first to the second, both in
    the axes of the model's root.
    """

    pair: tuple[str, str]
    distance: float
    points: np.ndarray
    normal: np.ndarray


def hulls(geometry: pin.GeometryModel, names: Sequence[str], known: dict[Any, Any]) -> pin.GeometryModel:
    """Return a copy of a geometry in which each mesh that is thick enough is replaced by its convex hull.

    `names` are those of obstacles and held shapes, the last shapes in the geometry. `known` caches hulls by name, or by index for
    shapes of the robot; new hulls are added to it.
    """
    made, own = geometry.copy(), len(geometry.geometryObjects) - len(names)
    for k, shape in enumerate(made.geometryObjects):
        mesh, key = shape.geometry, k if k < own else names[k - own]
        if isinstance(mesh, coal.BVHModelBase) and _thick(mesh.vertices()):
            with BUILDING:
                if key not in known:
                    known[key] = hull_of(mesh)
                shape.geometry = known[key]
    return made


def _thick(points: np.ndarray) -> bool:
    """Return whether points (N, 3) span enough volume for qhull, which crashes on flat sets."""
    size = np.abs(points).max(initial=0.0)
    if not size < np.inf or len(points) < 4:
        return False
    return bool(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[2] > THIN * size)


class Clearance:
    """Measures the distances between all tested pairs of shapes of a CollisionModel; each thread needs its own.

    For each of the P pairs, `a` and `b` are the indices of its shapes, `own` says whether both are the robot's, and `home` is their
    distance [m] at the home configuration. `exact` says whether their hulls touch there, so that the exact shapes are measured.
    `coordinates` (E,) is the index in q of each moving joint.
    """

    def __init__(self, model: Any) -> None:
        """Make the hulls of a CollisionModel's shapes and find the joints that move them."""
        self.robot = robot = model.robot
        self._exact, self.margins = model._state
        added = [*model._placed]
        self._names = [*model._links, *added]
        self._hulls = hulls(self._exact, added, model._hulls)
        self._data, self._exact_data, self._hull_data = (
            robot.model.createData(),
            self._exact.createData(),
            self._hulls.createData(),
        )
        shapes, pairs = self._exact.geometryObjects, self._exact.collisionPairs
        # Pinocchio's default requests start from the last result; these do not, so that a distance depends on no earlier one.
        for k in range(len(pairs)):
            self._hull_data.distanceRequests[k] = self._exact_data.distanceRequests[k] = coal.DistanceRequest()
        # References to the joint placements in pin.Data are made once, because making one takes three times as long as reading it.
        self._frames = list(self._data.oMi)
        self._hull_found, self._exact_found = (
            [data.distanceResults[k] for k in range(len(pairs))] for data in (self._hull_data, self._exact_data)
        )
        self.a = np.array([pair.first for pair in pairs], dtype=int)
        self.b = np.array([pair.second for pair in pairs], dtype=int)
        robots = np.array([name not in model.obstacles for name in self._names])
        self.own = robots[self.a] & robots[self.b]
        solid = np.array([isinstance(s.geometry, coal.BVHModelBase) for s in shapes])
        # Whether a pair has a mesh that is not convex, so that the distance of the hulls is not exact.
        self._surface = solid[self.a] | solid[self.b]
        self._joints(shapes)
        self.exact, self._on_surface = np.zeros((2, len(pairs)), dtype=bool)
        self.place(robot.home)
        self.exact = np.array(
            [self._surface[k] and self._hull_distance(k) <= self.margins[k] for k in range(len(pairs))], dtype=bool
        )
        self.home = self.distances()
        self._corners, self._held = np.zeros((len(pairs), CORNERS, 2, 3)), np.zeros((len(pairs), CORNERS), dtype=bool)

    def _joints(self, shapes: Any) -> None:
        """Find which joint moves which shape, and where each shape lies on its link."""
        model, names = self.robot.model, self.robot.joint_names
        lead = {j: model.names[leader] for j, (leader, _, _) in mimics(model).items()}
        moving = {i: leader for i, name in enumerate(model.names) if (leader := lead.get(i, name)) in names and i}
        self.coordinates = np.array([names.index(leader) for leader in moving.values()])
        self._columns = np.array([model.idx_vExtendeds[i] for i in moving])
        self._owner = np.array([shape.parentJoint for shape in shapes])
        above = [set(model.supports[int(i)]) for i in self._owner]
        moved = np.array([[i in joints for i in moving] for joints in above])
        self.by_a, self.by_b = moved[self.a] & ~moved[self.b], moved[self.b] & ~moved[self.a]
        self._middle, self._size = np.ones((len(shapes), 4)), np.empty(len(shapes))
        for k, shape in enumerate(shapes):
            shape.geometry.computeLocalAABB()
            self._middle[k, :3] = shape.placement.act(np.array(shape.geometry.aabb_center))
            self._size[k] = shape.geometry.aabb_radius
        # The radius bounds how far a turning joint moves a shape. One that never moves may be an infinite plane and gets radius 0.
        self._radius = np.where(moved.any(axis=1), self._size, 0.0)

    def name(self, k: int) -> tuple[str, str]:
        """Return the names of the two parts of pair k."""
        return self._names[self.a[k]], self._names[self.b[k]]

    # ------------------------------------------------------------------------------------------------ distances
    def place(self, q: np.ndarray) -> None:
        """Place every shape at configuration q (n,) [rad or m], to which the methods below refer."""
        full = self.robot._filled(q)
        pin.forwardKinematics(self.robot.model, self._data, full)
        pin.updateGeometryPlacements(self.robot.model, self._data, self._hulls, self._hull_data)
        self._placed = False

    def _hull_distance(self, k: int) -> float:
        return pin.computeDistance(self._hulls, self._hull_data, k).min_distance

    def distance(self, k: int) -> float:
        """Measure pair k: return a distance [m] that is at most that of the exact shapes, and 0 or less where they touch."""
        if not self.exact[k]:
            d = self._hull_distance(k)
            if d > self.margins[k] or not self._surface[k]:
                self._on_surface[k] = False
                return d
        if not self._placed:
            pin.updateGeometryPlacements(self.robot.model, self._data, self._exact, self._exact_data)
            self._placed = True
        self._on_surface[k] = True
        return pin.computeDistance(self._exact, self._exact_data, k).min_distance

    def distances(self) -> np.ndarray:
        """Measure the distances (P,) [m] of all pairs."""
        return np.array([self.distance(k) for k in range(len(self.a))])

    def gap(self, k: int) -> float:
        """Measure pair k: return its distance minus its margin [m], below which it counts as touching."""
        return self.distance(k) - self.margins[k]

    def points(self, ks: np.ndarray) -> np.ndarray:
        """Return the nearest points (K, 2, 3) [m] in root axes, on both shapes, of pairs ks (K,) that were measured before."""
        results = [(self._exact_found if self._on_surface[k] else self._hull_found)[k] for k in ks.tolist()]
        return np.array([(found.getNearestPoint1(), found.getNearestPoint2()) for found in results]).reshape(-1, 2, 3)

    def near(self, q: np.ndarray, within: float) -> list[tuple[tuple[int, int], Near]]:
        """Return the pairs closer than `within` [m] at q (n,) [rad or m], nearest first, with the indices of their shapes."""
        self.place(q)
        found = [(self.distance(k), k) for k in np.flatnonzero(self._apart() < within).tolist()]
        close = sorted(pair for pair in found if pair[0] < within)
        return [((int(self.a[k]), int(self.b[k])), self._near(d, k)) for d, k in close]

    def nearest(self, q: np.ndarray) -> Near | None:
        """Return the nearest pair at q (n,) [rad or m], or None if no pair is tested."""
        self.place(q)
        apart, least, found = self._apart(), np.inf, -1
        for k in np.argsort(apart, kind="stable").tolist():
            if not apart[k] < least:
                break
            d = self.distance(k)
            least, found = (d, k) if d < least else (least, found)
        return None if found < 0 else self._near(least, found)

    def _near(self, distance: float, k: int) -> Near:
        """Return the last measurement of pair k as a Near."""
        points = self.points(np.array([k]))[0]
        gap = points[1] - points[0]
        return Near(self.name(k), distance, points, gap / max(np.sqrt(gap @ gap), 1e-300))

    def _apart(self) -> np.ndarray:
        """Return the distances (P,) [m] between the bounding spheres of all pairs, -inf for infinite shapes."""
        self._locate()
        middles = np.sqrt(((self._at[self.a] - self._at[self.b]) ** 2).sum(1))
        size = self._size[self.a] + self._size[self.b]
        return np.where(np.isfinite(size) & np.isfinite(middles), middles - size, -np.inf)

    def _locate(self) -> None:
        """Compute the centres [m] of the shapes in the root's axes."""
        self._placements = np.array([M.homogeneous for M in self._frames])[self._owner]
        self._at = np.ascontiguousarray((self._placements @ self._middle[:, :, None])[:, :3, 0])

    # ------------------------------------------------------------------------------------------------ motion
    def move(self) -> None:
        """Compute joint Jacobians and shape positions at the configuration of the last `place`, for the methods below."""
        pin.computeJointJacobians(self.robot.model, self._data)
        self._V = np.ascontiguousarray(self._data.J.T[self._columns])
        self._locate()
        moved = self.a, self.b, self.by_a, self.by_b
        self._parts = Bodies(self._V, self.coordinates, self._at, self._radius, *moved)

    def levers(self, way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bound how much closer each pair of shapes can come if joint i of q moves by at most way[i] [rad or m], way (n,).

        Returns bounds (P, E) [m per rad or m] for each of the E moving joints alone, and bounds (P,) [m] for all of them together.
        """
        out, spread = np.empty(self.by_a.shape), np.empty(len(self.a))
        levers(self._parts, way, out, spread)
        return out, spread

    def forget(self) -> None:
        """Delete the nearest points stored at earlier configurations, so that results no longer depend on them."""
        self._held[:] = False

    def corners(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the nearest points stored at earlier configurations (P, CORNERS, 2, 3) and which of them are set, for `recall`."""
        return self._corners, self._held

    def recall(self, found: tuple[np.ndarray, np.ndarray]) -> None:
        """Replace the stored nearest points by a copy of those that `corners` of a Clearance of an equal model returned."""
        self._corners, self._held = (one.copy() for one in found)

    def facing(self, ks: np.ndarray, distances: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the nearest points of pairs, and the stored points of earlier configurations that are still almost nearest.

        `move` must have been called at this configuration.

        Args:
            ks: Indices (K,) of the pairs.
            distances: Their distances (K,) [m], already measured.

        Returns:
            Indices of pairs (R,), points (R, 2, 3) [m] in root axes and distances (R,) [m]: first the nearest points
            of the pairs ks, then stored ones.
        """
        points, each = self.points(ks), np.arange(len(ks))
        # Poses (K, 2, 4, 4) of the joints that move the two shapes of each of K pairs.
        at = self._placements[np.stack([self.a[ks], self.b[ks]], axis=1)]
        turn, origin = at[..., :3, :3], at[..., :3, 3]
        own = ((points - origin)[..., None, :] @ turn)[..., 0, :]
        known = self._corners[ks]
        before = (turn[:, None] @ known[..., None])[..., 0] + origin[:, None]
        gaps = np.linalg.norm(before[:, :, 1] - before[:, :, 0], axis=2)
        # Pairs of points with the same point on one shape count as one, as for a corner that slides along a face of the other.
        same = (np.linalg.norm(known - own[:, None], axis=3) < APART).any(axis=2)
        # The stored points are of convex hulls, so they are not used for pairs whose exact shapes were measured.
        hull = ~self._on_surface[ks][:, None]
        held = self._held[ks] & hull & ~same & (gaps < distances[:, None] + NEARBY)
        new = np.argmax(np.where(held, gaps, np.inf), axis=1)
        held[each, new] = False
        pair, corner = np.nonzero(held)
        held[each, new], self._corners[ks, new] = True, own
        self._held[ks] = held
        return (
            np.concatenate([ks, ks[pair]]),
            np.concatenate([points, before[pair, corner]]),
            np.concatenate([distances, gaps[pair, corner]]),
        )

    def rows(self, ks: np.ndarray, points: np.ndarray, gap: np.ndarray, rate: np.ndarray, *rest: Any) -> int:
        """Write linear inequalities on the joint rates that keep pairs of shapes apart, and return how many were written.

        `ks` (K,) are the pairs, `points` (K, 2, 3) [m] and `gap` (K,) [m] their nearest points and distances; the other
        arguments are those of `kernel.clearance.rows`.
        """
        deceleration, *rules = rest[:5]
        facing, planes = NearPairs(ks, points, gap), HalfPlanes(*rest[5:])
        return rows(self._parts, facing, rate, deceleration, Approach(*rules), planes)

    def free_until(self, ks: np.ndarray, distances: np.ndarray, levers: np.ndarray, *path: Any) -> np.ndarray:
        """Return for each of the pairs ks (K,) the position on a path of cubic pieces up to which it is proven free of contact.

        Positions count pieces: 2.5 is halfway through the third. `distances` (K,) [m] of the pairs were measured before, `levers`
        (P, E) are bounds as from the method of this name. `path` has the fields of `BrakingPath`, then the position where the
        proof begins.
        """
        gap = self.points(ks)
        normals = gap[:, 1] - gap[:, 0]
        normals /= np.maximum(np.sqrt((normals**2).sum(1)), 1e-300)[:, None]
        # The plane perpendicular to the shortest distance separates two convex shapes. It may not separate others: they get none.
        normals[self._on_surface[ks]] = 0.0
        out = np.empty(len(ks))
        pairs = Separation(ks, normals, distances)
        free_until(self._parts, pairs, levers, BrakingPath(*path[:-1]), path[-1], out)
        return out
