"""Drawing of a robot: the visual shapes of its URDF as coloured triangles, placed by Pinocchio.

Meshes are read by trimesh, one shape per material, because viewers that read .dae themselves drop parts of it. Parts that cannot
be drawn are reported. Links between base and tip that have no drawable part are drawn as sticks, so that every model can be seen.
"""

import functools
import importlib.util
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from ..errors import MissingExtra, ModelError
from ..robot.geometry.link_shapes import LinkShape, geometry_model, link_shapes, problems_sentence
from ..robot.geometry.meshes import Mesh
from ..robot.geometry.shape import Shape
from ..robot.joints import Joints
from ..solvers.solve import require_robot

Triangles = tuple[np.ndarray, np.ndarray]  # vertices (N, 3) [m] and faces (M, 3)

FARTHEST = 1e9  # [m] largest coordinate that is drawn; pages multiply lengths in 32-bit numbers, which would overflow
THINNEST = 1e-6  # [m] smallest radius of the sticks that stand for links without shapes
MAX_SHAPES = 2_000  # largest number of drawn shapes of a robot; robots have up to 150
COLORED = (".dae", ".obj", ".glb", ".gltf")  # mesh formats that can contain colours
GREY = (0.70, 0.72, 0.75)
STEEL, JOINT = (0.35, 0.42, 0.50), (0.90, 0.55, 0.10)  # colours of stick figures
SEEN = 1e-4  # [robot sizes, rad] two copies of a part that are nearer than this look the same, so one is not drawn
SMOOTH = np.radians(35.0)  # [rad] an edge where two faces meet at a larger angle is drawn as a sharp edge


@dataclass(frozen=True)
class DrawnShape:
    """Triangles of one colour: vertices (N, 3) [m], faces (M, 3), color (3,) in 0..1, and opacity."""

    vertices: np.ndarray
    faces: np.ndarray
    color: tuple[float, float, float]
    opacity: float = 1.0


class ChainPoint(NamedTuple):
    """A point fixed to a robot: number of the joint it moves with (0: the world), and place (3,) [m] in the joint's frame."""

    joint: int
    place: np.ndarray


def chain_points(arm: Any) -> list[ChainPoint]:
    """Return the points of the line that shows a Robot as a stick figure: the base, two for every joint in between, and the tip.

    A joint has a point on its parent and one on its child link. They differ only for a prismatic joint, so that the distance of
    all other neighbours is constant. Joints that mimic others and locked ones are included.
    """
    model, path = arm.model, arm._path
    base, tip = (model.frames[i] for i in arm._ids)
    points = [ChainPoint(base.parentJoint, base.placement.translation)]
    for count, joint in enumerate(path.joints):
        foot = ChainPoint(model.parents[joint], model.jointPlacements[joint].translation)
        ends = foot, ChainPoint(joint, np.zeros(3))
        points += ends[::-1] if count < path.up else ends
    return [*points, ChainPoint(tip.parentJoint, (tip.placement * arm.tool).translation)]


def joint_frames(robot: Any, q: Any, data: Any = None) -> np.ndarray:
    """Return the poses (njoints, 4, 4) [m] of all joints of the Pinocchio model in the base frame at q (n,) [rad or m].

    Joints that mimic others and locked ones are included; index 0 is the world. All drawn parts are placed relative to these
    frames. data: the pin.Data to use, by default a new one.
    """
    data = robot.model.createData() if data is None else data
    pin.forwardKinematics(robot.model, data, robot._filled(q))
    base = pin.updateFramePlacement(robot.model, data, robot.arms[0]._ids[0])
    return base.inverse().homogeneous @ np.array([M.homogeneous for M in data.oMi])


def skeleton(arm: Any, q: np.ndarray) -> np.ndarray:
    """Return the line through base, joints and tip of a Robot at q (n,) [rad or m], as points (K, 3) [m] in the base frame."""
    frames = joint_frames(arm, q)
    return np.array([frames[joint, :3, :3] @ place + frames[joint, :3, 3] for joint, place in chain_points(arm)])


@dataclass(frozen=True)
class BodyPart:
    """One drawn piece of a robot: its name, its shapes in its own axes, and its pose in the frame of a joint of the model.

    A bar also has an end point, which may belong to another joint: its shapes, of unit length and radius along z, are stretched
    from the origin of the pose to this point, `thick` [m] wide.
    """

    name: str
    shapes: tuple[DrawnShape, ...]
    joint: int
    placement: pin.SE3
    end: ChainPoint | None = None
    thick: float = 1.0


class Body:
    """The drawn parts of a robot, and where they are at given joint values.

    parts (list of BodyPart); `placements(q)` gives their poses (P, 4, 4) in the model's world, with a scale for bars; notice ('' or
    what is not drawn, and why); T_world_base (4, 4) at rest; `floor`, the height [m] of the floor, under the robot's lowest part
    that never moves; `joints`, the ids in the model of all joints between base and tips, those that mimic others included.
    """

    def __init__(self, robot: Joints) -> None:
        """Read the shapes. Raises MissingExtra without trimesh, ModelError for a robot of astronomical size."""
        require_robot(robot)
        self.robot = robot
        self.model = robot.model
        self.data = self.model.createData()
        self.arms: Any = robot.arms
        # checked here, because the import happens in the separate process that reads the meshes
        if importlib.util.find_spec("trimesh") is None:
            raise MissingExtra("trimesh", "view")
        pin.framesForwardKinematics(self.model, self.data, robot.rest)
        if not max(np.abs(place.translation).max() for place in self.data.oMf) <= FARTHEST:
            raise ModelError(f"robot '{robot.name}' has links farther than {FARTHEST:g} m away: it cannot be drawn")
        self.parts, self.notice = _read(self.arms[0])
        sticks = _sticks(robot, {part.joint for part in self.parts})
        if not self.parts:
            given = "the model was given without" if self.arms[0].urdf is None else "the URDF has no"
            self.notice = f"{self.notice or f'{given} visual shapes'}; drawn as a stick figure"
        elif self.notice and sticks:
            self.notice += "; links without shapes are drawn as sticks"
        self.parts += sticks
        self.mounts = np.array([part.placement.homogeneous for part in self.parts])
        self.bars = [k for k, part in enumerate(self.parts) if part.end is not None]
        self.joints = list(dict.fromkeys(joint for arm in self.arms for joint in arm._path.joints))
        self.T_world_base = self.data.oMf[self.arms[0]._ids[0]].homogeneous
        self.floor = float(self.bounds(robot.home, still=True)[0, 2])

    def placements(self, q: Any) -> np.ndarray:
        """Return the poses (P, 4, 4) [m] of the parts in the world for joint values q (n,) [rad or m].

        The base stays at T_world_base. The poses (njoints, 4, 4) of all joints of the model are then in `frames`.
        """
        self.frames = self.T_world_base @ joint_frames(self.robot, q, self.data)
        poses = self.frames[[part.joint for part in self.parts]] @ self.mounts
        for k in self.bars:
            joint, place = self.parts[k].end or (0, np.zeros(3))
            end = self.frames[joint, :3, :3] @ place + self.frames[joint, :3, 3]
            poses[k] = standing(poses[k, :3, 3], end, self.parts[k].thick)
        return poses

    def tips(self, q: Any) -> np.ndarray:
        """Return the poses (tips, 4, 4) [m] of the tips in the world at q (n,) [rad or m]."""
        return np.array([self.T_world_base @ T.homogeneous for T in self.robot.tip_poses(np.asarray(q))])

    def apart(self, A: np.ndarray, B: np.ndarray) -> np.ndarray:
        """Return whether each part (P,) is visibly elsewhere at poses A than at B: (P, 4, 4), or any of (F, P, 4, 4)."""
        gap = np.abs(A - B).reshape(-1, len(self.parts), 4, 4)
        gap[:, :, :3, 3] /= self.robot.reach
        gap[:, self.bars, :3, :3] /= self.robot.reach
        return gap.max(axis=(0, 2, 3)) > SEEN

    def bounds(self, q: Any, still: bool = False, world: np.ndarray | None = None) -> np.ndarray:
        """Return corners (2, 3) [m] of the robot's bounding box at q, in world axes; with `still` only of parts that never move.

        `world`: pose (4, 4) [m] of the robot's world frame in another frame; the box is then in the axes of that frame.
        """
        world = np.eye(4) if world is None else world
        points = [np.zeros((0, 3))]
        moved = {self.model.getJointId(name) for name in self.robot.joint_names}
        for part, T in zip(self.parts, world @ self.placements(q), strict=True):
            ends = {part.joint} if part.end is None else {part.joint, part.end.joint}
            if still and any(moved & set(self.model.supports[joint]) for joint in ends):
                continue
            for shape in part.shapes:
                low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
                corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
                points.append(corners @ T[:3, :3].T + T[:3, 3])
        stacked = np.vstack(points)
        if still and not len(stacked):  # If no drawn part is fixed, the box is that of the base's origin alone.
            stacked = (world @ self.T_world_base)[None, :3, 3]
        return np.array([stacked.min(axis=0), stacked.max(axis=0)])


def _read(robot: Any) -> tuple[list[BodyPart], str]:
    """Return what can be drawn, and a sentence about what cannot."""
    if robot.visual_model is None and robot.urdf is None:
        return [], "the Pinocchio model was given without visual_model="
    try:
        shapes, problems = link_shapes(robot, "look", MAX_SHAPES)
    except ModelError as error:
        return [], str(error)
    pieces = [_pieces(shape) for shape in shapes]
    # A mesh that has only points and lines is left out. The geometry model is built only to get the placements, so a small sphere
    # stands for every shape.
    drawn = [(shape, own) for shape, own in zip(shapes, pieces, strict=True) if sum(len(one.faces) for one in own)]
    placed = geometry_model(robot.model, [shape for shape, _ in drawn], [coal.Sphere(1e-3)] * len(drawn))
    pairs = zip(drawn, placed.geometryObjects, strict=True)
    parts = [BodyPart(shape.name, own, at.parentJoint, at.placement) for (shape, own), at in pairs]
    return parts, f"not read: {problems_sentence(problems)}" if problems else ""


def _pieces(shape: LinkShape) -> tuple[DrawnShape, ...]:
    """Return the triangles of a link's shape, one DrawnShape per material; () if there are none."""
    *rgb, opacity = shape.color or (*GREY, 1.0)
    color = (rgb[0], rgb[1], rgb[2])
    if shape.kind == "mesh":
        own = shape.color is None and Path(shape.file).suffix.lower() in COLORED
        sizes = np.array(shape.sizes)
        return tuple(
            DrawnShape((vertices * sizes).astype(np.float32), faces, c if own and c else color, opacity)
            for vertices, faces, c in _smoothed(shape.mesh)
        )
    return (DrawnShape(*primitive(shape.kind, shape.sizes), color, opacity),)


@functools.lru_cache(256)
def _smoothed(mesh: Mesh) -> tuple[tuple[np.ndarray, np.ndarray, tuple[float, float, float] | None], ...]:
    """Return vertices, faces and colour of every material of a mesh, in the file's axes."""
    return tuple((*split_sharp_edges(piece.vertices, piece.faces), piece.color) for piece in mesh.pieces)


def _sticks(robot: Joints, clothed: set[int]) -> list[BodyPart]:
    """Build sticks for the joints that have no shapes: a ball at each, a bar for its link, and one for its stroke if it slides.

    The links on either side get a bar, too, so that the drawing is connected.
    Where other parts of the robot have shapes, the coordinates of a moving base get no sticks.
    """
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, robot.rest)
    unit = revolved([(0, 0), (1, 0), (1, 1), (0, 1)], 24)
    bar, rod, world = DrawnShape(*unit, STEEL), DrawnShape(*unit, GREY), pin.SE3.Identity()
    parts: dict[Any, BodyPart] = {}
    arms: Any = robot.arms
    for arm in arms:
        pieces = [*itertools.pairwise(chain_points(arm))]
        links = [size for a, b in pieces if a.joint == b.joint and (size := float(np.linalg.norm(b.place - a.place)))]
        r = max(min(0.018 * arm.reach, 0.12 * float(np.mean(links or [arm.reach]))), THINNEST)
        based = {0, *(model.getJointId(name) for name in arm._of_base)} if clothed and arm._of_base else set()
        bare = {*range(model.njoints)} - clothed - based
        sphere = primitive("sphere", (1.7 * r,))
        ball, knob = DrawnShape(*sphere, JOINT), DrawnShape(sphere[0] / 1.5, sphere[1], STEEL)
        for joint in arm._path.joints:
            if joint in bare and joint in arm._path.owner:
                parts.setdefault(joint, BodyPart(f"{model.names[joint]}_ball", (ball,), joint, world))
        for k, (start, end) in enumerate(pieces):
            near = {point.joint for piece in pieces[max(k - 1, 0) : k + 2] for point in piece}
            joint, link = max(start.joint, end.joint), start.joint == end.joint
            moves = np.asarray(data.joints[joint].S).reshape(6, -1)[:3].any() if not link else True
            if not bare & near or not moves or (link and np.array_equal(start.place, end.place)):
                continue
            name, at = model.names[joint], pin.SE3(np.eye(3), start.place)
            key = start.joint, end.joint, *start.place, *end.place
            if link:
                parts.setdefault(key, BodyPart(f"{name}_bar_{arm.tip}", (bar,), joint, at, end, r))
            else:  # A prismatic joint is drawn as a rod that gets longer, from a knob on the parent link to the joint.
                foot = min(start, end)
                parts.setdefault(key, BodyPart(f"{name}_stroke", (rod,), start.joint, at, end, 0.6 * r))
                at = pin.SE3(np.eye(3), foot.place)
                parts.setdefault((name, "foot"), BodyPart(f"{name}_foot", (knob,), foot.joint, at))
    return [*parts.values()]


def grid_cell(radius: float) -> float:
    """Return a round cell width [m] (1, 2 or 5 times a power of ten) for a floor grid with about four cells in `radius` [m]."""
    unit = 10.0 ** np.floor(np.log10(radius / 4.0))
    return float(unit * max(n for n in (1, 2, 5) if n * unit <= radius / 4.0))


def drawn_shape(shape: Shape, color: tuple[float, float, float], opacity: float) -> DrawnShape:
    """Return the triangles of a collision shape in its own axes. Raises InvalidConfiguration if its mesh cannot be read."""
    if shape.kind != "mesh":
        return DrawnShape(*primitive(shape.kind, shape.sizes), color, opacity)
    form = shape.form()
    faces = [[form.tri_indices(k)[i] for i in range(3)] for k in range(form.num_tris)]
    return DrawnShape(*split_sharp_edges(form.vertices(), np.array(faces)), color, opacity)


def primitive(kind: str, sizes: Sequence[float]) -> Triangles:
    """Return vertices [m] and faces of a box (sides), sphere (radius), cylinder or capsule (radius, length) about the origin."""
    if kind == "box":
        corners = np.array([*itertools.product((-0.5, 0.5), repeat=3)]) * sizes
        # Corners of a box are numbered 0 to 7: 1 is added for the upper end along z, 2 along y, 4 along x. Each row has the corners
        # of one side in order.
        sides = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
        return split_sharp_edges(corners, np.vstack([sides[:, [0, 1, 2]], sides[:, [0, 2, 3]]]))
    radius, half = sizes[0], 0.5 * sizes[1] if len(sizes) > 1 else 0.0
    if kind == "cylinder":
        return revolved([(0.0, -half), (radius, -half), (radius, half), (0.0, half)], 48)
    angle = np.linspace(0.0, 0.5 * np.pi, 7)
    upper = np.column_stack([radius * np.cos(angle), half + radius * np.sin(angle)])
    upper[-1, 0] = 0.0
    lower = upper[::-1] * (1.0, -1.0)
    return revolved(np.vstack([lower[: -1 if half == 0.0 else None], upper]), 24)


def revolved(profile: Any, sections: int) -> Triangles:
    """Return vertices and faces of a surface of revolution about the z axis, for cylinders, cones and rings.

    profile: points (K, 2) [m] of radius and height, with the inside on their left; a closed line or one that ends on the axis.
    """
    line, angle = np.asarray(profile, dtype=float), 2.0 * np.pi * np.arange(sections) / sections
    r, z = np.repeat(line[:, :, None], sections, axis=2).transpose(1, 0, 2)
    vertices = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1).reshape(-1, 3)
    number = np.arange(len(vertices)).reshape(len(line), sections)
    # A point of the profile on the axis becomes one vertex, any other a ring of vertices.
    number[line[:, 0] == 0.0] = number[line[:, 0] == 0.0, :1]
    after = np.roll(number, -1, axis=1)
    faces = np.stack([number[:-1], after[:-1], after[1:], number[:-1], after[1:], number[1:]], axis=-1).reshape(-1, 3)
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return split_sharp_edges(vertices, faces[whole])


def split_sharp_edges(vertices: np.ndarray, faces: np.ndarray) -> Triangles:
    """Split the vertices of a mesh along sharp edges, so that a viewer draws these edges as sharp.

    Viewers average the normals of the faces at a vertex, which rounds an edge off. So two faces share a vertex only if the edge
    at which they meet there is flat enough (SMOOTH) and belongs to no third face. Vertices at the same place are first made one.
    """
    vertices = np.asarray(vertices, dtype=float)
    order, number = np.lexsort(vertices.T), np.empty(len(vertices), dtype=int)
    new = (np.diff(vertices[order], axis=0) != 0.0).any(axis=1)
    number[order] = np.concatenate([[0], np.cumsum(new)])[: len(order)]
    corner = number[np.ravel(faces)]  # number of the vertex at each corner of each face (3 M,)
    a, b, c = vertices[np.ravel(faces)].reshape(-1, 3, 3).transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)

    here = np.arange(len(corner))
    there = here - here % 3 + (here + 1) % 3  # Each edge of a face begins at corner `here` and ends at corner `there`.
    low, high = np.minimum(corner, corner[there]), np.maximum(corner, corner[there])
    edge = low * len(vertices) + high
    order = np.argsort(edge, kind="stable")
    first = np.flatnonzero(np.diff(edge[order], prepend=-1))
    first = first[np.diff(first, append=len(order)) == 2]
    one, other = order[first], order[first + 1]
    flat = np.einsum("ij,ij->i", normal[one // 3], normal[other // 3]) > np.cos(SMOOTH)
    one, other = one[flat], other[flat]
    along = corner[one] == corner[other]
    left = np.concatenate([one, there[one]])
    right = np.concatenate([np.where(along, other, there[other]), np.where(along, there[other], other)])
    label, before = here, None
    # Corners that share a vertex all get the lowest of their numbers; repeated until nothing changes.
    while before is None or (label != before).any():
        before, label = label, label.copy()
        np.minimum.at(label, left, before[right])
        np.minimum.at(label, right, before[left])
        label = label[label]
    lowest = label == here
    points = vertices[np.ravel(faces)][lowest].astype(np.float32)
    return points, (np.cumsum(lowest) - 1)[label].reshape(-1, 3).astype(np.uint32)


def mapped(shape: Triangles, T: np.ndarray) -> Triangles:
    """Return triangles (vertices and faces) moved by a pose or another affine map T (4, 4)."""
    return (shape[0] @ T[:3, :3].T + T[:3, 3]).astype(np.float32), shape[1]


def standing(start: np.ndarray, end: np.ndarray, thick: float) -> np.ndarray:
    """Return the matrix (4, 4) that stretches a shape of unit length and radius from one point (3,) [m] to another."""
    way = end - start
    # The stretch is never quite 0, because a viewer cannot extract a rotation from a singular matrix.
    length, least = float(np.linalg.norm(way)), 1e-9 * thick
    z, length = (way / length, length) if length > least else (np.array([0.0, 0.0, 1.0]), least)
    across = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    across /= np.linalg.norm(across)
    T = np.eye(4)
    T[:3] = np.column_stack([thick * across, thick * np.cross(z, across), length * z, start])
    return T


def tube(points: np.ndarray, radius: float, color: tuple[float, float, float], opacity: float = 1.0) -> DrawnShape:
    """Return a line through points (N, 3) [m] as a tube of triangles, because WebGL draws lines only one pixel wide."""
    P = np.asarray(points, dtype=float)
    P = P[np.append(True, np.linalg.norm(np.diff(P, axis=0), axis=1) > 1e-3 * radius)]
    if len(P) < 2:
        vertices, faces = primitive("sphere", (1.5 * radius,))
        return DrawnShape((vertices + P[0]).astype(np.float32), faces, color, opacity)
    along = np.gradient(P, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    across = np.empty_like(P)
    across[0] = np.cross(along[0], np.eye(3)[int(np.argmin(np.abs(along[0])))])
    # `across` is moved from point to point by parallel transport, so that the tube does not twist.
    for k in range(1, len(P)):
        side = across[k - 1] - along[k] * (along[k] @ across[k - 1])
        size = np.linalg.norm(side)
        across[k] = side / size if size > 1e-9 else across[k - 1]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    third = np.cross(along, across)
    angle = np.linspace(0.0, 2.0 * np.pi, 10, endpoint=False)
    # (10, N, 3) offsets from each point of the line to the ten vertices around it
    ring = np.cos(angle)[:, None, None] * across + np.sin(angle)[:, None, None] * third
    vertices = (P + radius * ring).transpose(1, 0, 2).reshape(-1, 3)
    k, j = np.meshgrid(np.arange(len(P) - 1), np.arange(10), indexing="ij")
    a, b = 10 * k + j, 10 * k + (j + 1) % 10
    faces = np.stack([np.stack([a, b, b + 10], -1), np.stack([a, b + 10, a + 10], -1)]).reshape(-1, 3)
    return DrawnShape(vertices.astype(np.float32), faces.astype(np.uint32), color, opacity)
