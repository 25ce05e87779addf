"""A robot's shapes as coal objects placed on its Pinocchio model, and collision requests for pairs of them."""

from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ...errors import ModelError
from .link_shapes import LinkShape, geometry_model, link_shapes, problems_sentence
from .shape import PLAIN, surface

MAX_SHAPES = 300  # per robot: 45,000 pairs, which take 1 s and 0.5 GB to set up; robots have up to 100


def read_shapes(robot: Any) -> pin.GeometryModel:
    """Collision shapes of the robot's URDF, placed on its model. Raises ModelError."""
    if robot.urdf is None:
        raise ModelError(f"robot '{robot.name}' was not made from a URDF; pass its collision shapes as geometry=")
    shapes, problems = link_shapes(robot, "surface", MAX_SHAPES)
    if problems:
        where = "; meshes are read from the URDF's folder, its ROS package and package_dirs="
        hint = where if any(problem.startswith("mesh ") for _, problem in problems) else ""
        raise ModelError(
            f"the collision shapes of robot '{robot.name}' cannot be used: {problems_sentence(problems)}{hint}"
        )
    return geometry_model(robot.model, shapes, [_form(shape) for shape in shapes])


def _form(shape: LinkShape) -> Any:
    """The coal object of a link's shape."""
    if shape.kind != "mesh":
        return PLAIN[shape.kind](*shape.sizes)
    made = surface(shape.mesh, np.array(shape.sizes))
    if shape.convex:
        try:
            made.buildConvexRepresentation(False)
        except RuntimeError:  # a point with too many neighbours
            return hull_of(made)
        return made.convex
    return made


def hull_of(mesh: Any) -> Any:
    """The convex hull of a mesh, or the mesh where coal cannot make one: it refuses points with more than 255 neighbours.

    It is that of any points; `buildConvexRepresentation` takes them as they are, convex or not.
    Faces with many corners are divided into triangles that meet in one of them (Qt), or by moving points by rounding errors (QJ).
    """
    for how in ("Qt", "QJ"):
        try:
            mesh.buildConvexHull(False, how)
        except RuntimeError:
            continue
        return mesh.convex
    return mesh


def request(margin: float) -> coal.CollisionRequest:
    """Request that tests whether two shapes are nearer than a margin [m]."""
    made = coal.CollisionRequest(coal.CollisionRequestFlag.NO_REQUEST, 1)
    made.security_margin = margin
    return made


def is_flat(shape: Any) -> bool:
    """Whether the box around a shape, in its own axes, has no volume."""
    shape.computeLocalAABB()
    return bool(np.min(shape.aabb_local.max_ - shape.aabb_local.min_) <= 0.0)


def owner_above(model: pin.Model, joint: int, owners: set[int]) -> int:
    """Nearest ancestor joint that carries shapes (-1: none): links with only empty links between them are adjacent."""
    while joint > 0:
        joint = model.parents[joint]
        if joint in owners:
            return joint
    return -1
