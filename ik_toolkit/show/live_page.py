"""The live page: a robot with its solvers in one HTML file that needs no Python, no server and no network.

The page's modules (folder `page`) are joined into one script. The robot's kinematics come from Pinocchio's model, as
the screws of its joints; meshes are simplified, so that a page can be mailed. Names reach the page as text only: the
data contain no `<`, and the page's content security policy lets no other script run.
"""

import base64
import gzip
import hashlib
import html
import importlib.resources
import json
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ..robot.joints import Joints
from ..robot.probe import screw
from ..text import plain
from .body import THINNEST, Body, DrawnShape, grid_cell, primitive, revolved

Mesh = tuple[np.ndarray, np.ndarray, np.ndarray]  # vertices (N, 3) [m], normals (N, 3) and faces (M, 3)

# names of the page's JavaScript modules, in an order in which each comes after those that it imports
MODULES = ("robot", "solve", "draw", "hand", "main")
# Largest number of triangles in a page. The meshes of a robot may have 100 times as many, and look the same simplified.
MOST_FACES = 40_000
# Meshes are simplified by merging vertices in the same cell of a grid. Cells are at first FINEST times the robot's size, and grow
# until the triangles are few enough.
FINEST = 1 / 250
GROW = 1.1  # smallest factor by which the cells in which vertices merge grow in each round
STEPS = 65_535  # vertex coordinates are stored as 16-bit numbers, from 0 to this at the far side of a shape


def page_html(robot: Joints, body: Body, title: str) -> str:
    """Return the live HTML page of a robot, with its solver inside; it needs no network. body: the drawn parts of the robot."""
    data, blob = describe_robot(robot, body)
    files = importlib.resources.files("ik_toolkit.show") / "page"
    code = "\n".join(joined((files / f"{name}.js").read_text(encoding="utf-8")) for name in MODULES)
    digest = base64.b64encode(hashlib.sha256(f"\n{code}\n".encode()).digest()).decode()
    filled = {
        "TITLE": html.escape(title),
        "DIGEST": digest,
        "DATA": json.dumps(data, allow_nan=False).replace("<", "\\u003c"),
        "SHAPES": base64.b64encode(gzip.compress(blob, 9, mtime=0)).decode(),
        "VERTEX": (files / "vertex.glsl").read_text(encoding="utf-8"),
        "FRAGMENT": (files / "fragment.glsl").read_text(encoding="utf-8"),
        "NOTICE": html.escape(f"{body.notice[0].upper()}{body.notice[1:]}. " if body.notice else ""),
        "CODE": code,
    }
    page = (files / "page.html").read_text(encoding="utf-8")
    # All placeholders @NAME@ are replaced in one pass, so that an inserted text that contains one is left alone.
    return re.sub("@([A-Z]+)@", lambda found: filled[found[1]], page)


def joined(module: str) -> str:
    """Return the text of a JavaScript module without its imports and exports, so that several can be joined into one script."""
    return re.sub(r"^export ", "", re.sub(r"^import [^;]*;\n", "", module, flags=re.M), flags=re.M)


def describe_robot(robot: Joints, body: Body) -> tuple[dict[str, Any], bytes]:
    """Return a robot's data for the live page: a dict (joints, nodes, tips, parts) for JSON, and the bytes of all triangles."""
    nodes, places = moving_nodes(robot)
    frames, arms, bounds = robot.model.frames, robot.arms, body.bounds(robot.home)
    size = float(np.linalg.norm(bounds[1] - bounds[0]))
    # z: height of the floor; cell: width of a cell of its grid; wide: width of the floor [m]
    floor = {"z": body.floor, "cell": grid_cell(size), "wide": 2.5 * size}

    def at(joint: int, T: pin.SE3) -> dict[str, Any]:
        node, offset = places[joint]
        return {"node": node, "T": pose_rows(offset * T)}

    shapes, tools = [shape for part in body.parts for shape in part.shapes], handles()
    meshes = thin(shapes, size)
    told, blob = packed([*shapes, *tools.values()], [*meshes, *thin([*tools.values()], 1.0)])
    rest = iter(told)
    base = frames[arms[0]._ids[0]]
    keys = ("name", "kind", "lower", "upper", "low", "span", "home")
    values = (robot.joint_names, robot.joint_kinds, robot.lower, robot.upper, *robot._sampling, robot.home)
    tips = [frames[tip] for arm in arms for tip in arm._ids[1:]]
    parts = [
        at(part.joint, part.placement)
        | {"shapes": [next(rest) for _ in part.shapes], "thick": part.thick}
        | ({} if part.end is None else {"end": at(part.end.joint, pin.SE3(np.eye(3), part.end.place))})
        for part in body.parts
    ]
    told = {
        "reach": robot.reach,
        "room": {"size": size, "centre": bounds.mean(axis=0).tolist(), "floor": floor},
        # `plain` turns a missing (infinite) limit into null, because JSON has no infinity
        "joints": [plain(dict(zip(keys, column, strict=True))) for column in zip(*values, strict=True)],
        "nodes": nodes,
        "base": at(base.parentJoint, base.placement),
        "tips": [at(tip.parentJoint, tip.placement * arm.tool) for tip, arm in zip(tips, arms, strict=True)],
        "parts": parts,
        "handles": dict(zip(tools, rest, strict=True)),
    }
    return told, blob


def moving_nodes(robot: Joints) -> tuple[list[dict[str, Any]], list[tuple[int, pin.SE3]]]:
    """Return the moving joints (nodes) for the page's kinematics, parents first, and each model joint's node and pose in it.

    A node's pose in its parent is its pose at 0 times the exponential of its screw. Fixed joints are no nodes; their poses are
    merged into those of the nodes.
    """
    model = robot.model
    data, zero = model.createData(), robot._filled(np.zeros(robot.n))
    pin.forwardKinematics(model, data, zero)
    lead = dict(zip(model.mimicking_joints, model.mimicked_joints, strict=True))
    owner = {model.getJointId(name): k for k, name in enumerate(robot.joint_names)}
    nodes: list[dict[str, Any]] = []
    places = [(-1, pin.SE3.Identity())]
    for joint in range(1, model.njoints):
        parent, offset = places[model.parents[joint]]
        T = offset * data.liMi[joint]
        coordinate = owner.get(lead.get(joint, joint))
        if coordinate is None or not np.asarray(data.joints[joint].S).any():
            places.append((parent, T))
            continue
        turns, ratio, axis = screw(model, data, joint)
        moves = {"axis": axis.tolist(), "ratio": ratio, "turns": turns, "joint": coordinate}
        nodes.append({"parent": parent, "T": pose_rows(T), **moves})
        places.append((len(nodes) - 1, pin.SE3.Identity()))
    return nodes, places


def pose_rows(T: pin.SE3) -> list[float]:
    """Return a pose as 12 numbers, the rows of the 3 x 4 matrix [R | p], for the page's scripts."""
    return T.homogeneous[:3].ravel().tolist()


def handles() -> dict[str, DrawnShape]:
    """Return the shapes of which a page draws targets and the floor, by name: of unit height and radius, upright at the origin."""
    angle = np.linspace(0.0, 2.0 * np.pi, 11)
    meshes = {
        "ball": primitive("sphere", (1.0,)),
        "bar": revolved([(0, 0), (1, 0), (1, 1), (0, 1)], 24),
        "cone": revolved([(0, 0), (1, 0), (0, 1)], 32),
        "ring": revolved(np.column_stack([1.0 + 0.018 * np.cos(angle), 0.018 * np.sin(angle)]), 64),
    }
    floor = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], dtype=np.float32)
    white = (1.0, 1.0, 1.0)
    shapes = {name: DrawnShape(*mesh, white) for name, mesh in meshes.items()}
    return shapes | {"floor": DrawnShape(floor, np.array([(0, 1, 2), (0, 2, 3)]), white)}


def thin(shapes: Sequence[DrawnShape], size: float, most: int = MOST_FACES) -> list[Mesh]:
    """Simplify the meshes of a robot until all shapes together have at most `most` triangles; size: that of the robot [m].

    Returns vertices, normals and faces of each shape.
    """
    meshes = whole = [(shape.vertices, normals(shape), shape.faces) for shape in shapes]
    cell = FINEST * size
    while (count := sum(len(faces) for _, _, faces in meshes)) > most:
        if meshes is not whole:
            # The number of faces falls with the square of the cell size.
            cell *= max(GROW, np.sqrt(count / most))
        meshes = [merged(*mesh, cell) for mesh in whole]
    return meshes


def packed(shapes: Sequence[DrawnShape], meshes: Sequence[Mesh]) -> tuple[list[dict[str, Any]], bytes]:
    """Return shapes as a page stores them: a description of each, and the bytes of all vertices, normals and faces.

    Coordinates have 16 bits, normals 8, indices 32.
    """
    told, blob = [], []
    for shape, (vertices, normal, faces) in zip(shapes, meshes, strict=True):
        low = vertices.min(axis=0) if len(vertices) else np.zeros(3)
        size = np.maximum(np.ptp(vertices, axis=0), THINNEST) if len(vertices) else np.ones(3)
        blob += [
            np.round((vertices - low) / size * STEPS).astype("<u2").tobytes(),
            np.round(127 * normal).astype("i1").tobytes(),
            faces.astype("<u4").tobytes(),
        ]
        look = {"color": [float(c) for c in shape.color], "opacity": float(shape.opacity)}
        box = {"low": low.tolist(), "size": size.tolist()}
        told.append({**look, **box, "vertices": len(vertices), "faces": len(faces)})
    return told, b"".join(blob)


def normals(shape: DrawnShape) -> np.ndarray:
    """Compute vertex normals (N, 3), weighted by the areas of the adjacent faces."""
    a, b, c = (shape.vertices[shape.faces[:, k]].astype(float) for k in range(3))
    face = np.cross(b - a, c - a)
    total = np.zeros((len(shape.vertices), 3))
    for k in range(3):
        np.add.at(total, shape.faces[:, k], face)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)


def merged(vertices: np.ndarray, normal: np.ndarray, faces: np.ndarray, cell: float) -> Mesh:
    """Simplify a mesh: merge vertices in the same cell of a grid of width `cell` [m] if their normals point the same way.

    Edges between sides that face different ways so stay sharp.
    """
    place = np.floor((vertices - vertices.min(axis=0)) / cell).astype(np.int64)
    side = place.max(axis=0) + 1
    _, box = np.unique((place[:, 0] * side[1] + place[:, 1]) * side[2] + place[:, 2], return_inverse=True)
    looks_to = (np.round(normal).astype(np.int64) + 1) @ (1, 3, 9)
    _, first, group = np.unique(27 * box + looks_to, return_index=True, return_inverse=True)
    count = np.bincount(box)
    mean = np.column_stack([np.bincount(box, vertices[:, k]) / count for k in range(3)])
    looks = np.column_stack([np.bincount(group, normal[:, k]) for k in range(3)])
    looks /= np.maximum(np.linalg.norm(looks, axis=1, keepdims=True), 1e-300)
    corner = box[faces]
    whole = (corner[:, 0] != corner[:, 1]) & (corner[:, 1] != corner[:, 2]) & (corner[:, 2] != corner[:, 0])
    faces = group[faces[whole]]
    used, faces = np.unique(faces, return_inverse=True)
    return mean[box[first[used]]], looks[used], faces.reshape(-1, 3)
