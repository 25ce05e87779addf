"""The look of a robot: the visual shapes of its URDF as coloured triangles, placed by Pinocchio.

Meshes go through trimesh, one shape per material, because viewers that read .dae themselves drop parts of it. Parts that cannot
be drawn are reported; a robot without any drawable part becomes a stick figure, so that every model can be seen.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ..errors import MissingExtra, ModelError
from ..robot.geometry.link_shapes import LinkShape, geometry_model, link_shapes, problems_sentence
from ..robot.geometry.meshes import Mesh
from ..robot.joints import Joints
from ..solvers.solve import require_robot

FARTHEST = 1e9  # [m] farthest coordinate drawn; pages compute in 32 bits and multiply lengths
THINNEST = 1e-6  # [m] least radius of a stick
MAX_SHAPES = 2_000  # largest number of drawn shapes of a robot; robots have up to 150
COLORED = (".dae", ".obj", ".glb", ".gltf")  # mesh formats that can contain colours
GREY = (0.70, 0.72, 0.75)
STEEL, JOINT = (0.35, 0.42, 0.50), (0.90, 0.55, 0.10)  # colours of stick figures
SEEN = 1e-4  # [robot sizes, rad] copies of a part at smaller distances and angles look like one
SMOOTH = np.radians(35.0)  # [rad] edges with a larger angle stay visible


@dataclass(frozen=True)
class DrawnShape:
    """Triangles of one colour: vertices (N, 3) [m], faces (M, 3), color (3,) in 0..1, and opacity."""

    vertices: np.ndarray
    faces: np.ndarray
    color: tuple[float, float, float]
    opacity: float = 1.0


@dataclass(frozen=True)
class BodyPart:
    """One rigid piece of a robot: its name, and its shapes in its own axes."""

    name: str
    shapes: tuple[DrawnShape, ...]


class Body:
    """The drawn parts of a robot and their placements.

    parts (list of BodyPart); `placements(q)` gives their poses (P, 4, 4) in the model's world; notice ('' or what is not drawn, and
    why); T_world_base (4, 4) at rest; floor: height [m] of the floor, under the robot's lowest part that never moves.
    """

    def __init__(self, robot: Joints) -> None:
        """Read the shapes. Raises MissingExtra without trimesh, ModelError for a robot of astronomical size."""
        require_robot(robot)
        self.robot = robot
        self.model = robot.model
        self.data = self.model.createData()
        self.arms: Any = robot.arms
        need_trimesh()
        pin.framesForwardKinematics(self.model, self.data, robot.rest)
        if not max(np.abs(place.translation).max() for place in self.data.oMf) <= FARTHEST:
            raise ModelError(f"robot '{robot.name}' has links farther than {FARTHEST:g} m away: it cannot be drawn")
        self.geometry, self.parts, self.notice = _read(self.arms[0])
        if not self.parts:
            self.notice = f"{self.notice or 'the URDF has no visual shapes'}; drawn as a stick figure"
            self.geometry, self.parts = _sticks(robot, self.arms)
        self.geometry_data = self.geometry.createData()
        self.T_world_base = self.data.oMf[self.arms[0]._ids[0]].homogeneous
        self.floor = float(self.bounds(robot.home, still=True)[0, 2])

    def placements(self, q: Any) -> np.ndarray:
        """Return the poses (P, 4, 4) [m] of the parts in the world for joint values q (n,) [rad or m]."""
        pin.forwardKinematics(self.model, self.data, self.robot._fill(self.robot.rest.copy(), q))
        pin.updateGeometryPlacements(self.model, self.data, self.geometry, self.geometry_data)
        return np.array([M.homogeneous for M in self.geometry_data.oMg])

    def tips(self, q: Any) -> np.ndarray:
        """Return the poses (tips, 4, 4) [m] of the tips in the world at q (n,) [rad or m]."""
        return np.array(
            [
                self.T_world_base @ arm.fk(np.asarray(q)[at]).homogeneous
                for arm, at in zip(self.arms, self.robot.places, strict=True)
            ]
        )

    def apart(self, A: np.ndarray, B: np.ndarray) -> np.ndarray:
        """Return whether each part (P,) is visibly in different places at two sets of poses (P, 4, 4)."""
        gap = np.abs(A - B)
        gap[:, :3, 3] /= self.robot.reach
        return gap.max(axis=(1, 2)) > SEEN

    def bounds(self, q: Any, still: bool = False) -> np.ndarray:
        """Return the corners (2, 3) [m] of the robot's bounding box at q, in world axes; `still`: of parts that never move only."""
        points = [np.zeros((0, 3))]
        moved = {self.model.getJointId(name) for name in self.robot.joint_names}
        for part, T, shown in zip(self.parts, self.placements(q), self.geometry.geometryObjects, strict=True):
            if still and moved & set(self.model.supports[shown.parentJoint]):
                continue
            for shape in part.shapes:
                low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
                corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
                points.append(corners @ T[:3, :3].T + T[:3, 3])
        stacked = np.vstack(points)
        if still and not len(stacked):  # the base has no drawn part, so the model's origin is used
            stacked = self.T_world_base[None, :3, 3]
        return np.array([stacked.min(axis=0), stacked.max(axis=0)])


def need_trimesh() -> Any:
    """Return the module trimesh, or raise MissingExtra."""
    try:
        import trimesh
    except ImportError:
        raise MissingExtra("trimesh", "view") from None
    return trimesh


def _read(robot: Any) -> tuple[pin.GeometryModel, list[BodyPart], str]:
    """Return geometry and parts of what can be drawn, and a sentence about what cannot."""
    if robot.visual_model is None and robot.urdf is None:
        return pin.GeometryModel(), [], "the Pinocchio model was given without visual_model="
    try:
        shapes, problems = link_shapes(robot, "look", MAX_SHAPES)
    except ModelError as error:
        return pin.GeometryModel(), [], str(error)
    parts, drawn = [], []
    for shape in shapes:
        pieces = _pieces(shape)
        if sum(len(piece.faces) for piece in pieces):  # a mesh may have only points and lines
            parts.append(BodyPart(shape.name, pieces))
            drawn.append(shape)
    # Only the placements of this geometry are used.
    geometry = geometry_model(robot.model, drawn, [coal.Sphere(1e-3)] * len(drawn))
    return geometry, parts, f"not read: {problems_sentence(problems)}" if problems else ""


def _pieces(shape: LinkShape) -> tuple[DrawnShape, ...]:
    """Triangles of a link's shape, one DrawnShape per material; () if none are left."""
    *rgb, opacity = shape.color or (*GREY, 1.0)
    color = (rgb[0], rgb[1], rgb[2])
    if shape.kind == "mesh":
        own = shape.color is None and Path(shape.file).suffix.lower() in COLORED
        return tuple(
            DrawnShape(
                np.asarray(vertices * np.array(shape.sizes), dtype=np.float32),
                faces,
                c if own and c else color,
                opacity,
            )
            for vertices, faces, c in _smoothed(shape.mesh)
        )
    return (DrawnShape(*primitive(shape.kind, shape.sizes), color, opacity),)


def primitive(kind: str, sizes: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [m] and faces of a box (sides), sphere (radius), cylinder or capsule (radius, length) about the origin."""
    creation = need_trimesh().creation
    scale = np.array(sizes) if kind == "box" else np.full(3, sizes[0])
    if kind == "box":
        mesh = creation.box(extents=(1.0, 1.0, 1.0))
    elif kind == "sphere":
        mesh = creation.uv_sphere(radius=1.0, count=(24, 24))
    elif kind == "cylinder":
        mesh = creation.cylinder(radius=1.0, height=1.0, sections=48)
        scale[2] = sizes[1]
    else:
        mesh = creation.capsule(height=sizes[1] / sizes[0], radius=1.0, count=(24, 24))
        mesh.apply_translation(-mesh.bounds.mean(axis=0))
    return split_sharp_edges(mesh, scale)


@functools.lru_cache(256)
def _smoothed(mesh: Mesh) -> tuple[tuple[np.ndarray, np.ndarray, tuple[float, float, float] | None], ...]:
    """Return vertices, faces and colour of every material of a mesh, in the file's axes."""
    make = need_trimesh().Trimesh
    return tuple(
        (*split_sharp_edges(make(piece.vertices, piece.faces, process=True)), piece.color) for piece in mesh.pieces
    )


def split_sharp_edges(mesh: Any, scale: Any = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Scale vertices and split them along sharp edges, so that a viewer's averaged normals keep those edges visible.

    Corners of two faces stay one vertex if the faces meet there at a flat enough edge. Create small meshes large and
    scale them here, because trimesh drops triangles with sides under 0.1 mm.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    faces, count = mesh.faces, 3 * len(mesh.faces)
    flat = mesh.face_adjacency_angles < SMOOTH
    pairs, edges = mesh.face_adjacency[flat], mesh.face_adjacency_edges[flat]
    joined = []
    for end in (0, 1):
        corners = faces[pairs] == edges[:, end][:, None, None]  # (E, 2, 3): which corner of each face it is
        joined.append(3 * pairs + corners.argmax(axis=2))
    links = np.vstack(joined) if len(pairs) else np.empty((0, 2), dtype=int)
    graph = coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(count, count))
    total, label = connected_components(graph, directed=False)
    vertices = np.empty((total, 3), dtype=np.float32)
    vertices[label] = (mesh.vertices * scale)[faces.ravel()]
    return vertices, label.reshape(-1, 3).astype(np.uint32)


def _sticks(robot: Joints, arms: Any) -> tuple[pin.GeometryModel, list[BodyPart]]:
    """Build a stick figure: a ball at every joint of the paths, a bar to the next joint, a bar to the tip."""
    trimesh = need_trimesh()
    model, geometry, parts = robot.model, pin.GeometryModel(), []
    data = model.createData()
    pin.framesForwardKinematics(model, data, robot.rest)
    ball = pin.GeometryObject  # only the placement of this object is used

    def add(name: str, joint: int, mesh: Any, scale: float, color: tuple[float, float, float]) -> None:
        if name not in {part.name for part in parts}:
            geometry.addGeometryObject(ball(name, joint, pin.SE3.Identity(), coal.Sphere(1e-3)))
            parts.append(BodyPart(name, (DrawnShape(*split_sharp_edges(mesh, scale), color),)))

    for arm in arms:
        r = max(0.018 * arm.reach, THINNEST)
        joints = list(dict.fromkeys(model.getJointId(name) for name in arm.joint_names))
        for k, joint in enumerate(joints):
            name = model.names[joint]
            add(f"{name}_ball", joint, trimesh.creation.uv_sphere(radius=1.7, count=(16, 16)), r, JOINT)
            end = data.oMi[joints[k + 1]] if k + 1 < len(joints) else data.oMf[arm._ids[1]] * arm.tool
            p = data.oMi[joint].actInv(end.translation)
            if np.linalg.norm(p) > r:
                add(
                    f"{name}_bar_{arm.tip}",
                    joint,
                    trimesh.creation.cylinder(1.0, segment=[np.zeros(3), p / r]),
                    r,
                    STEEL,
                )
        foot = data.oMi[joints[0]].translation - data.oMf[arm._ids[0]].translation
        if np.linalg.norm(foot) > r:
            start = data.oMf[arm._ids[0]].translation
            add(
                f"base_bar_{arm.tip}",
                0,
                trimesh.creation.cylinder(1.3, segment=[start / r, (start + foot) / r]),
                r,
                STEEL,
            )
    return geometry, parts


def grid_cell(radius: float) -> float:
    """Return the cell width [m] of a grid with about four cells in `radius` [m]: 1, 2 or 5 times a power of ten."""
    unit = 10.0 ** np.floor(np.log10(radius / 4.0))
    return float(unit * max(n for n in (1, 2, 5) if n * unit <= radius / 4.0))


def tube(points: np.ndarray, radius: float, color: tuple[float, float, float], opacity: float = 1.0) -> DrawnShape:
    """Build a tube through points (N, 3) [m], because WebGL draws lines only one pixel wide."""
    P = np.asarray(points, dtype=float)
    P = P[np.append(True, np.linalg.norm(np.diff(P, axis=0), axis=1) > 1e-3 * radius)]
    if len(P) < 2:
        ball = need_trimesh().creation.uv_sphere(radius=1.5, count=(10, 10))
        return DrawnShape((ball.vertices * radius + P[0]).astype(np.float32), ball.faces, color, opacity)
    along = np.gradient(P, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    across = np.empty_like(P)
    across[0] = np.cross(along[0], np.eye(3)[int(np.argmin(np.abs(along[0])))])
    for k in range(1, len(P)):  # parallel transport of `across`, so that the tube does not twist
        side = across[k - 1] - along[k] * (along[k] @ across[k - 1])
        size = np.linalg.norm(side)
        across[k] = side / size if size > 1e-9 else across[k - 1]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    third = np.cross(along, across)
    angle = np.linspace(0.0, 2.0 * np.pi, 10, endpoint=False)
    ring = np.cos(angle)[:, None, None] * across + np.sin(angle)[:, None, None] * third  # (10, N, 3) points
    vertices = (P + radius * ring).transpose(1, 0, 2).reshape(-1, 3)
    k, j = np.meshgrid(np.arange(len(P) - 1), np.arange(10), indexing="ij")
    a, b = 10 * k + j, 10 * k + (j + 1) % 10
    faces = np.stack([np.stack([a, b, b + 10], -1), np.stack([a, b + 10, a + 10], -1)]).reshape(-1, 3)
    return DrawnShape(vertices.astype(np.float32), faces.astype(np.uint32), color, opacity)
