"""Reads the shapes of a URDF's links and places and names them as Pinocchio does, but without its mesh reader.

Pinocchio's own reader opens any path a file names, in this process, and drops all shapes of a link with a line on
stderr when one of them is unusable. Here each unusable or missing shape is reported.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ...errors import ModelError
from ...text import how_many
from ..base import put_on
from ..formats.urdf import SIZES, Item, finite_at, parse
from ..rotation import rpy_matrix
from .meshes import FORMATS, Mesh, MeshPiece, find_mesh, mesh_folders, mesh_packages, read_meshes

# Limit on a robot's triangles, which take 2 GB as bounding volume trees for collisions. Robots have up to 1,000,000.
MAX_TOTAL = 5_000_000
LARGEST = 1e6  # Limit on the size, scale and distance of a shape [m, or factor].
ROLES = {"surface": "collision", "look": "visual"}
Problems = list[tuple[str, str]]  # Faulty shapes: for each an element of the URDF as text, and what is wrong with it.


@dataclass(frozen=True)
class LinkShape:
    """One shape of a link.

    `name` is "LINK_K" for shape K of a link. `kind` is 'box', 'sphere', 'cylinder', 'capsule' or 'mesh'. `sizes` [m] are (x, y, z),
    (radius,) or (radius, length), or for a mesh its scale (3,). `color` is (r, g, b, opacity), each 0 to 1, or None. For a mesh,
    `file` is its name in the URDF, `mesh` the contents of the file, and `convex` tells whether it is treated as convex.
    """

    name: str
    link: str
    kind: str
    sizes: tuple[float, ...]
    T_link_shape: pin.SE3
    color: tuple[float, ...] | None = None
    file: str = ""
    convex: bool = False
    mesh: Mesh = field(default_factory=Mesh)


def link_shapes(robot: Any, kind: str, most: int) -> tuple[list[LinkShape], Problems]:
    """Read the collision shapes ('surface') or visual shapes ('look') of a robot; return them and the problems of unusable ones.

    A problem is an element and what is wrong with it. Raises ModelError if the robot has more than `most` shapes.
    """
    role = ROLES[kind]
    if kind == "look" and robot.visual_model is not None:
        return _given(robot, robot.visual_model, most)
    items = [item for item in parse(robot.urdf) if item.tag in ("link", "material")]
    count = sum(given["role"] == role for item in items for given in item.shapes)
    if count > most:
        raise ModelError(f"robot '{robot.name}' has {count:,} {role} shapes; at most {most:,} are read")
    names = [part.attributes.get("filename", "") for item in items for part in item.inside if part.tag == "mesh"]
    packages = mesh_packages(names, robot.path, robot.package_dirs)
    folders, colors = [*mesh_folders(robot.path, robot.package_dirs), *packages.values()], _colors(items)
    shapes: list[LinkShape] = []
    problems: Problems = []
    files = {}
    for item in items:
        own = [given for given in item.shapes if given["role"] == role]
        # The <collision_checking> of a link names the cylinders that count as capsules and the meshes that count as convex.
        asked = {(part.tag, part.attributes.get("name")) for part in item.inside}
        for k, given in enumerate(own):
            try:
                shape = _shape(item, k, given, asked, colors)
                if shape.file and shape.file not in files:
                    try:
                        files[shape.file] = find_mesh(shape.file, folders, packages)
                    except ModelError as error:
                        raise ModelError(f"mesh '{shape.file[:200]}' {error}") from None
                shapes.append(shape)
            except ModelError as error:
                problems.append((str(item), str(error)))
    meshes = read_meshes(files.values(), kind, folders)
    found = []
    for shape in shapes:
        mesh = meshes[files[shape.file]] if shape.file else Mesh()
        said = [*([mesh.refused] if mesh.refused else []), *mesh.notes]
        problems += [(f"link '{shape.link}'", f"mesh '{shape.file[:200]}' {problem}") for problem in said]
        if not mesh.refused:
            found.append(replace(shape, mesh=mesh))
    total = sum(len(piece.faces) for shape in found for piece in shape.mesh.pieces)
    if total > MAX_TOTAL:
        raise ModelError(
            f"the {role} meshes of robot '{robot.name}' have {total:,} triangles; at most {MAX_TOTAL:,} are read"
        )
    return found, problems


def light(given: pin.GeometryModel | None) -> pin.GeometryModel | None:
    """Return a copy of visual shapes without their triangles, which can be read from files again, to make pickles small."""
    copy = None if given is None else given.clone()
    for shape in copy.geometryObjects if copy is not None else ():
        if os.path.isfile(shape.meshPath):
            shape.geometry = coal.BVHModelOBBRSS()
    return copy


def placed(given: pin.GeometryModel, robot: Any) -> pin.GeometryModel:
    """Return a copy of the shapes that the user gave with a Pinocchio model, on the links of the model that the robot uses."""
    copy = given.clone()
    put_on(copy, robot.model if robot._original is None else robot._original, robot.model)
    return copy


def _given(robot: Any, geometry: pin.GeometryModel, most: int) -> tuple[list[LinkShape], Problems]:
    """Return shapes given with a Pinocchio model; meshes are read from their files (with colours), or else taken from Pinocchio."""
    model, shapes = robot.model, placed(geometry, robot).geometryObjects
    if len(shapes) > most:
        raise ModelError(f"robot '{robot.name}' has {len(shapes):,} visual shapes; at most {most:,} are read")
    files = {shape.name: Path(shape.meshPath).resolve() for shape in shapes if os.path.isfile(shape.meshPath)}
    files = {name: file for name, file in files.items() if file.suffix.lower() in FORMATS}
    read = read_meshes(files.values(), "look", list({file.parent for file in files.values()}))
    meshes = {name: read[file] for name, file in files.items()}
    found, problems = [], []
    for shape in shapes:
        frame, form = model.frames[shape.parentFrame], shape.geometry
        place, mesh = frame.placement.actInv(shape.placement), meshes.get(shape.name, Mesh())
        kind, sizes = _kind(form)
        if kind == "mesh" and mesh.pieces:
            sizes = tuple(map(float, shape.meshScale))
        elif kind == "mesh" and isinstance(form, coal.BVHModelBase):
            corners = [form.tri_indices(k) for k in range(form.num_tris)]
            faces = np.array([[corner[0], corner[1], corner[2]] for corner in corners], dtype=int).reshape(-1, 3)
            mesh = Mesh((MeshPiece(np.array(form.vertices()).reshape(-1, 3), faces, None),))
        elif kind == "mesh":
            problems.append((f"shape '{shape.name}'", f"is a {type(form).__name__}, which is not drawn"))
            continue
        own = any(piece.color for piece in mesh.pieces) and not shape.overrideMaterial
        color = None if own else tuple(map(float, shape.meshColor))
        file = shape.meshPath if kind == "mesh" else ""
        found.append(LinkShape(shape.name, frame.name, kind, sizes, place, color, file, mesh=mesh))
    return found, problems


def _kind(form: Any) -> tuple[str, tuple[float, ...]]:
    """Return kind and sizes [m] of a coal object; every other type counts as a mesh."""
    match form:
        case coal.Box():
            return "box", tuple((2.0 * form.halfSide).tolist())
        case coal.Sphere():
            return "sphere", (form.radius,)
        case coal.Cylinder() | coal.Capsule():
            return type(form).__name__.lower(), (form.radius, 2.0 * form.halfLength)
    return "mesh", (1.0, 1.0, 1.0)


def problems_sentence(problems: Problems) -> str:
    """Return problems with shapes (element, what is wrong) as one sentence: the first three, and how many more there are."""
    rows = list(dict.fromkeys(f"{element}: {problem}" for element, problem in problems))
    return "; ".join(rows[:3]) + (f"; and {len(rows) - 3} more" if len(rows) > 3 else "")


def geometry_model(model: pin.Model, shapes: Sequence[LinkShape], forms: Sequence[Any]) -> pin.GeometryModel:
    """Return a pin.GeometryModel of the shapes on the links of a model; `forms` are the coal objects made from them."""
    geometry = pin.GeometryModel()
    # A joint and a link may have the same name. Links come last here, so that the name means the link, which has the shape.
    order = sorted(enumerate(model.frames), key=lambda one: one[1].type == pin.FrameType.BODY)
    frames: dict[str, int] = {frame.name: i for i, frame in order}
    for shape, form in zip(shapes, forms, strict=True):
        frame = model.frames[frames[shape.link]]
        placement = frame.placement * shape.T_link_shape
        geometry.addGeometryObject(
            pin.GeometryObject(shape.name, frame.parentJoint, frames[shape.link], placement, form)
        )
    return geometry


def _shape(
    item: Item,
    k: int,
    given: Mapping[str, Any],
    asked: set[tuple[str, str | None]],
    colors: Mapping[str, tuple[float, ...]],
) -> LinkShape:
    """Return one shape of a link. Raises ModelError, whose text ends a sentence, if it is invalid.

    `asked` has pairs (tag, name of a collision shape): 'capsule' makes a cylinder a capsule, 'convex' makes a mesh convex.
    """
    tag, attributes = given.get("geometry", ("", {}))
    kind = "capsule" if tag == "cylinder" and ("capsule", given["name"]) in asked else tag
    file = attributes.get("filename", "")
    if kind == "mesh":
        if not file:
            raise ModelError("a mesh has no file name")
        sizes = _numbers("mesh", attributes, {"scale": 3}, "1 1 1")
        if not all(0.0 < abs(size) <= LARGEST for size in sizes):
            raise ModelError(f'<mesh scale="{attributes["scale"][:60]}"> is zero or too large')
    elif kind in SIZES:
        sizes = _numbers(tag, attributes, SIZES[kind])
        if not all(0.0 < size <= LARGEST for size in sizes):
            shown = " ".join(f'{key}="{attributes[key][:60]}"' for key in SIZES[kind])
            raise ModelError(f"<{tag} {shown}> is not a valid shape: sizes must be positive and at most {LARGEST:g} m")
    else:
        known = ", ".join(("mesh", *SIZES))
        raise ModelError(f"<{tag[:60]}> is not a shape; use one of: {known}" if tag else "a shape has no geometry")
    origin = given.get("origin", {})
    if "quat_xyzw" in origin:
        raise ModelError(
            f'its shape <origin quat_xyzw="{origin["quat_xyzw"][:60]}"> is no rotation, or rpy is given, too'
        )
    xyz, rpy = (_numbers("origin", origin, {key: 3}, "0 0 0") for key in ("xyz", "rpy"))
    if max(map(abs, xyz)) > LARGEST:
        raise ModelError(f'its shape <origin xyz="{origin["xyz"][:60]}"> is further than {LARGEST:g} m away')
    material = given.get("material", {}).get("name", "")
    # Shapes may give a material by name only; its colour is then the first that the file gives for this name.
    color = colors.get(material) or _color(given.get("color", {}))
    place = pin.SE3(np.array(rpy_matrix(rpy)), np.array(xyz))
    if kind != "mesh":
        return LinkShape(f"{item.name}_{k}", item.name, kind, sizes, place, color)
    convex = ("convex", given["name"]) in asked
    return LinkShape(f"{item.name}_{k}", item.name, kind, sizes, place, color, file, convex)


def _numbers(
    tag: str, attributes: Mapping[str, str], counts: Mapping[str, int], default: str | None = None
) -> tuple[float, ...]:
    values: list[float] = []
    for key, count in counts.items():
        if default is None and key not in attributes:
            raise ModelError(f"<{tag}> has no {key}")
        some = finite_at(attributes, key, count, default or "")
        if not some:
            raise ModelError(f'<{tag} {key}="{attributes[key][:60]}"> is not {how_many(count, "finite number")}')
        values += some
    return tuple(values)


def _colors(items: Sequence[Item]) -> dict[str, tuple[float, ...]]:
    """Map material names to colours; the robot's materials come before those inside a visual, and the first of a name counts."""
    found: dict[str, tuple[float, ...]] = {}
    of_robot = [(item.name, item.first("color") or {}) for item in items if item.tag == "material"]
    written = [(s["material"].get("name", ""), s.get("color", {})) for i in items for s in i.shapes if "material" in s]
    for name, attributes in [*of_robot, *written]:
        color = _color(attributes)
        if name and color:
            found.setdefault(name, color)
    return found


def _color(attributes: Mapping[str, str]) -> tuple[float, ...] | None:
    """Return the (r, g, b, opacity) of a <color>, each in 0..1, or None."""
    return tuple(min(max(x, 0.0), 1.0) for x in finite_at(attributes, "rgba", 4)) or None
