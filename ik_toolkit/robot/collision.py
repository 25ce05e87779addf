"""Collisions of a robot with itself and with shapes around it, by Pinocchio and coal.

The boxes around the shapes are compared first (a tree of them, in C++); shapes are tested exactly only where boxes meet.
"""

import threading
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ..errors import InvalidConfiguration, InvalidOption, ModelError, near_match
from .base import put_on
from .clearance import Clearance, Near
from .meshes import Mesh, find_mesh, read_meshes
from .pose import check_target
from .robot import Robot
from .shapes import LinkShape, geometry_model, link_shapes, said
from .tree import Tree

MAX_SHAPES = 300  # of a robot: 45,000 pairs, which take 1 s and 0.5 GB to set up; robots have up to 100
SAMPLES = 8  # configurations that show which links ever move against each other


class CollisionModel:
    """What can hit what: the robot's own links, and shapes added around it.

    robot: the Robot or Tree (its arms against each other, too) whose collision shapes are read from its URDF (meshes from the
    URDF's folder, its ROS package and package_dirs, from nowhere else), or from `geometry`, a pin.GeometryModel. ignore: pairs of
    link names that may touch. Never tested: links joined by one joint, links that cannot move against each other, pairs that the
    robot's SRDF allows to touch, and pairs that touch both at home and at zero (if legal), which are listed in `excluded`.
    Attributes: links, obstacles (names), pairs (tested, by name), excluded (pairs of link names), allowed (pairs of link names
    in the SRDF -> reason). Raises ModelError (no collision shapes, over 300, one without extent, or
    a mesh that cannot be read), InvalidOption.
    """

    def __init__(
        self, robot: Robot | Tree, *, geometry: pin.GeometryModel | None = None, ignore: Iterable[Sequence[str]] = ()
    ) -> None:
        """Read the shapes and decide which pairs count."""
        if not isinstance(robot, Robot | Tree):
            raise InvalidOption(f"collisions are tested for a Robot or a Tree, not for a {type(robot).__name__}")
        self.robot = robot
        self.ignore = [tuple(pair) for pair in ignore]
        self.geometry = read_shapes(robot) if geometry is None else geometry.clone()
        self.geometry.removeAllCollisionPairs()
        if geometry is not None and robot._original is not None:
            put_on(self.geometry, robot._original, robot.model)
        frames = robot.model.frames
        self._names = [frames[o.parentFrame].name for o in self.geometry.geometryObjects]
        self._given = None if geometry is None else geometry.clone()
        self._shapes: list[tuple[str, str, tuple, np.ndarray]] = []
        if not self._names:
            raise ModelError(
                f"robot '{robot.name}' has no collision shapes (<collision> elements): there is nothing to test; "
                "add them to the URDF, or pass geometry="
            )
        self.links = tuple(dict.fromkeys(self._names))
        for pair in self.ignore:
            unknown = [name for name in pair if name not in self.links]
            if len(pair) != 2 or unknown:
                raise InvalidOption(
                    f"ignore takes pairs of links with collision shapes, not {pair}.{near_match((unknown or pair)[0], self.links)}"
                )
        self.excluded: tuple[tuple[str, str], ...] = ()
        self._pair_links()

    # ------------------------------------------------------------------------------------------------ what is tested
    def _pair_links(self) -> None:
        robot, geometry, model = self.robot, self.geometry, self.robot.model
        owners = [o.parentJoint for o in geometry.geometryObjects]
        placements = self._sample(owners)
        joints = list(placements)
        above = {j: owner_above(model, j, set(joints)) for j in joints}
        self._moving = [np.ptp(placements[j], axis=0).max() > 1e-9 for j in owners]
        against = np.zeros((len(joints), len(joints)), dtype=bool)  # whether two joints' shapes move against each other
        for b, jb in enumerate(joints):
            for a, ja in enumerate(joints[:b]):
                if above[ja] != jb and above[jb] != ja:
                    between = np.linalg.inv(placements[ja]) @ placements[jb]
                    against[a, b] = against[b, a] = np.ptp(between, axis=0).max() > 1e-9
        of_joint = np.array([joints.index(j) for j in owners])
        tested = np.triu(against[of_joint[:, None], of_joint], 1)
        places = {name: [k for k, other in enumerate(self._names) if other == name] for name in self.links}

        def leave_out(pairs: Iterable[tuple[str, ...]]) -> None:
            for first, second in pairs:
                tested[np.ix_(places[first], places[second])] = False
                tested[np.ix_(places[second], places[first])] = False
            geometry.setCollisionPairs(tested)
            self._local = threading.local()

        self.allowed = robot.srdf.may_touch(self.links)
        leave_out([*self.ignore, *self.allowed])
        zero = np.zeros(robot.n)
        touching = dict.fromkeys(self.collisions(robot.home))
        if not robot.outside(zero):  # touching at one of them may be a real collision: a folded arm's
            touching = {pair: None for pair in self.collisions(zero) if pair in touching}
        self.excluded = tuple(touching)
        leave_out(self.excluded)

    def _sample(self, owners: list[int]) -> dict[int, np.ndarray]:
        """Placements (SAMPLES, 4, 4) of the joints that carry shapes, at the same random configurations."""
        robot, data = self.robot, self.robot.model.createData()
        rng = np.random.default_rng(0)
        found: dict[int, list] = {j: [] for j in owners}
        for _ in range(SAMPLES):
            pin.forwardKinematics(robot.model, data, robot._fill(robot.rest.copy(), robot.random_q(rng)))
            for j, list_j in found.items():
                list_j.append(data.oMi[j].homogeneous)
        return {j: np.array(list_j) for j, list_j in found.items()}

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of names (links and obstacles) that are tested."""
        named = ((self._names[p.first], self._names[p.second]) for p in self.geometry.collisionPairs)
        return tuple(dict.fromkeys(named))

    @property
    def obstacles(self) -> tuple[str, ...]:
        """Names of the shapes added around the robot."""
        return tuple(shape[0] for shape in self._shapes)

    # ------------------------------------------------------------------------------------------------ obstacles
    def add_box(self, size: Sequence[float], pose: Any, name: str | None = None) -> "CollisionModel":
        """Add a box of size (x, y, z) [m] centred at a pose (4, 4), pin.SE3 or position (3,) in the base frame."""
        return self._add("box", _positive("size of a box", size, 3), pose, name)

    def add_sphere(self, radius: float, position: Any, name: str | None = None) -> "CollisionModel":
        """Add a sphere of a radius [m] centred at a position (3,) in the base frame."""
        return self._add("sphere", _positive("radius of a sphere", [radius], 1), position, name)

    def add_cylinder(self, radius: float, length: float, pose: Any, name: str | None = None) -> "CollisionModel":
        """Add a cylinder [m] along z of a pose (4, 4), pin.SE3 or position (3,) in the base frame, centred there."""
        return self._add("cylinder", _positive("radius and length of a cylinder", [radius, length], 2), pose, name)

    def add_mesh(self, path: str | Path, pose: Any, scale: float = 1.0, name: str | None = None) -> "CollisionModel":
        """Add a mesh file (STL, OBJ, DAE) times a scale, at a pose (4, 4), pin.SE3 or position (3,) in the base frame.

        It is its surface: what is wholly inside touches nothing.
        """
        return self._add("mesh", (str(path), *_positive("scale of a mesh", [scale], 1)), pose, name)

    def _add(self, kind: str, sizes: tuple, pose: Any, name: str | None) -> "CollisionModel":
        T, _ = check_target(pose)
        if T.ndim == 1:
            T = pin.SE3(np.eye(3), T).homogeneous
        if name is None:
            name = next(n for n in (f"{kind}_{k}" for k in range(1, 10**6)) if n not in self._names)
        if name in self._names:
            raise InvalidOption(f"there is already a link or obstacle named '{name}'")
        base = self.robot.arms[0]._base_inverse.inverse()
        shape = pin.GeometryObject(name, 0, base * pin.SE3(T), _shape(kind, sizes))
        new = self.geometry.addGeometryObject(shape)
        for k, moves in enumerate(self._moving):
            if moves:
                self.geometry.addCollisionPair(pin.CollisionPair(k, new))
        self._names.append(name)
        self._shapes.append((name, kind, sizes, T))
        self._local = threading.local()
        return self

    # ------------------------------------------------------------------------------------------------ questions
    def _workspace(self) -> tuple[Any, Any, Any]:
        """Pinocchio's data, the geometry's, and the tree of boxes or None, each the calling thread's own."""
        local = self._local
        if not hasattr(local, "space"):
            local.space = self.workspace(np.zeros(len(self.geometry.collisionPairs)))
        return local.space

    def workspace(self, margins: np.ndarray) -> tuple[Any, Any, Any]:
        """New workspace (see `_workspace`) in which a pair nearer than its margin [m] (pairs,) counts as touching."""
        data, geometry_data = self.robot.model.createData(), self.geometry.createData()
        # Pinocchio's own requests start from the last answer's guess, and then a verdict may depend on the ones before.
        for k, margin in enumerate(margins.tolist()):
            geometry_data.collisionRequests[k] = request(margin)
        boxes = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(self.robot.model, self.geometry, geometry_data)
        # Pinocchio leaves shapes whose box has no volume (a flat mesh) out of the tree: then every pair is tested.
        flat = any(np.min(_extent(o.geometry)) <= 0.0 for o in self.geometry.geometryObjects)
        return data, geometry_data, None if flat else boxes

    def collides(self, q: Any) -> bool:
        """Whether anything touches at q (n,) [rad or m]."""
        if not len(self.geometry.collisionPairs):
            return False
        full = self._full(q)
        data, found, boxes = self._workspace()
        if boxes is None:
            return bool(pin.computeCollisions(self.robot.model, data, self.geometry, found, full, True))
        return bool(pin.computeCollisions(self.robot.model, data, boxes, full, True))

    def collisions(self, q: Any) -> list[tuple[str, str]]:
        """Every pair of names that touches at q (n,) [rad or m]."""
        full = self._full(q)
        data, found, _ = self._workspace()
        pin.computeCollisions(self.robot.model, data, self.geometry, found, full, False)
        hits = [
            pair
            for pair, hit in zip(self.geometry.collisionPairs, found.collisionResults, strict=True)
            if hit.isCollision()
        ]
        return list(dict.fromkeys((self._names[pair.first], self._names[pair.second]) for pair in hits))

    def distances(self, q: Any, within: float = np.inf) -> list[Near]:
        """Pairs closer than `within` [m] at q (n,) [rad or m], nearest first, with distance, nearest points and normal.

        Measured between the convex hulls of meshes (exact for all other shapes), and between the meshes themselves where the
        hulls meet, here or at home: a distance is never more than that of the exact shapes, and 0 or less where they touch.
        """
        if not hasattr(self._local, "clearance"):
            self._local.clearance = Clearance(self)
        return self._local.clearance.near(self.robot.check_q(q), within)

    def _full(self, q: Any) -> np.ndarray:
        return self.robot._fill(self.robot.rest.copy(), self.robot.check_q(q))

    def __getstate__(self) -> dict[str, Any]:
        """Keep what was asked for; the shapes are read again (a given geometry travels whole)."""
        return {"robot": self.robot, "ignore": self.ignore, "geometry": self._given, "shapes": self._shapes}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Build it again."""
        self.__init__(state["robot"], geometry=state["geometry"], ignore=state["ignore"])
        for name, kind, sizes, T in state["shapes"]:
            self._add(kind, sizes, T, name)

    def __repr__(self) -> str:
        """One line."""
        around = f", around it: {', '.join(self.obstacles)}" if self._shapes else ""
        return f"CollisionModel('{self.robot.name}', {len(self.pairs)} pairs tested, {len(self.excluded)} excluded{around})"


def read_shapes(robot: Any) -> pin.GeometryModel:
    """Collision shapes of the robot's URDF, placed on its model."""
    if robot.urdf is None:
        raise ModelError(f"robot '{robot.name}' was not made from a URDF; pass its collision shapes as geometry=")
    shapes, problems = link_shapes(robot, "surface", MAX_SHAPES)
    if problems:
        where = "; meshes are read from the URDF's folder, its ROS package and package_dirs="
        hint = where if any(problem.startswith("mesh ") for _, problem in problems) else ""
        raise ModelError(f"the collision shapes of robot '{robot.name}' cannot be used: {said(problems)}{hint}")
    return geometry_model(robot.model, shapes, [_form(shape) for shape in shapes])


def request(margin: float) -> coal.CollisionRequest:
    """Question whether two shapes are nearer than a margin [m]."""
    made = coal.CollisionRequest(coal.CollisionRequestFlag.NO_REQUEST, 1)
    made.security_margin = margin
    return made


def _form(shape: LinkShape) -> Any:
    """The coal shape of a link's shape."""
    if shape.kind == "mesh":
        surface = _surface(shape.mesh, np.array(shape.sizes))
        if shape.convex:
            surface.buildConvexRepresentation(False)
            return surface.convex
        return surface
    return _shape(shape.kind, shape.sizes)


def _surface(mesh: Mesh, scale: np.ndarray) -> Any:
    """The surface of a mesh times a scale (3,), as coal tests it."""
    surface = coal.BVHModelOBBRSS()
    (piece,) = mesh.pieces
    surface.beginModel(len(piece.faces), len(piece.vertices))
    surface.addVertices(piece.vertices * scale)
    surface.addTriangles(piece.faces)
    surface.endModel()
    return surface


def _extent(shape: Any) -> np.ndarray:
    """Sides (3,) of the box around a shape, in its own axes [m]."""
    shape.computeLocalAABB()
    return shape.aabb_local.max_ - shape.aabb_local.min_


def owner_above(model: pin.Model, joint: int, owners: set[int]) -> int:
    """Nearest joint above that carries shapes (-1: none): links with nothing but bare joints between them are adjacent."""
    while joint > 0:
        joint = model.parents[joint]
        if joint in owners:
            return joint
    return -1


def _positive(what: str, values: Any, count: int) -> tuple[float, ...]:
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (count,) or not (np.isfinite(array) & (array > 0)).all():
        raise InvalidOption(f"the {what} must be {count} positive number{'s' * (count > 1)} [m], not {values!r}")
    return tuple(array.tolist())


def _shape(kind: str, sizes: tuple) -> Any:
    if kind == "box":
        return coal.Box(*sizes)
    if kind == "sphere":
        return coal.Sphere(*sizes)
    if kind == "cylinder":
        return coal.Cylinder(*sizes)
    if kind == "capsule":
        return coal.Capsule(*sizes)
    path, scale = sizes
    file = Path(path).expanduser()
    if not file.is_file():
        raise InvalidConfiguration(f"there is no mesh file '{path}'")
    try:
        real = find_mesh(str(file.absolute()), [file.resolve().parent, file.absolute().parent])
    except ModelError as error:
        raise InvalidConfiguration(f"the mesh file '{path}' {error}") from None
    mesh = read_meshes([real], "surface", [real.parent])[real]
    if mesh.refused:
        raise InvalidConfiguration(f"the mesh file '{path}' {mesh.refused}")
    return _surface(mesh, np.full(3, scale))
