"""Converts a robot's shapes to objects of the collision library coal, on its Pinocchio model; makes collision requests."""

from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ...errors import ModelError
from .link_shapes import LinkShape, geometry_model, link_shapes, placed, problems_sentence
from .shape import PLAIN, surface

# Limit on a robot's shapes: their 45,000 pairs take 1 s and 0.5 GB to set up. Robots have up to 100 shapes.
MAX_SHAPES = 300


def read_shapes(robot: Any) -> pin.GeometryModel:
    """Return the collision shapes of a Robot or Tree on the links of its model: those given with the model, or those of its URDF.

    Raises ModelError if one cannot be used.
    """
    if robot.collision_model is not None:
        return placed(robot.collision_model, robot)
    if robot.urdf is None:
        raise ModelError(
            f"robot '{robot.name}' was made from a Pinocchio model alone; give its collision shapes: "
            "ik.Robot(model, collision_model=)"
        )
    shapes, problems = link_shapes(robot, "surface", MAX_SHAPES)
    if problems:
        where = "; meshes are read from the URDF's folder, its ROS package (with a package.xml) and package_dirs="
        hint = where if any(problem.startswith("mesh ") for _, problem in problems) else ""
        raise ModelError(
            f"the collision shapes of robot '{robot.name}' cannot be used: {problems_sentence(problems)}{hint}"
        )
    return geometry_model(robot.model, shapes, [_form(shape) for shape in shapes])


def _form(shape: LinkShape) -> Any:
    """Return a link's shape as a coal object."""
    if shape.kind != "mesh":
        return PLAIN[shape.kind](*shape.sizes)
    made = surface(shape.mesh, np.array(shape.sizes))
    if shape.convex:
        try:
            made.buildConvexRepresentation(False)
        except RuntimeError:  # coal refuses a mesh in which a point has more than 255 neighbours.
            return hull_of(made)
        return made.convex
    return made


def hull_of(mesh: Any) -> Any:
    """Return the convex hull of a mesh, or the mesh if coal cannot make one: it refuses points with more than 255 neighbours.

    The library qhull computes the hull. Its options divide faces with many corners into triangles, with a common corner (Qt) or, if
    that fails, by moving points by rounding errors (QJ).
    """
    for how in ("Qt", "QJ"):
        try:
            mesh.buildConvexHull(False, how)
        except RuntimeError:
            continue
        return mesh.convex
    return mesh


def request(margin: float) -> coal.CollisionRequest:
    """Make a collision request (coal) that tests whether two shapes are nearer than a margin [m]."""
    made = coal.CollisionRequest(coal.CollisionRequestFlag.NO_REQUEST, 1)
    made.security_margin = margin
    return made


def is_flat(shape: Any) -> bool:
    """Return whether the box around a shape, in its own axes, has no volume."""
    shape.computeLocalAABB()
    return bool(np.min(shape.aabb_local.max_ - shape.aabb_local.min_) <= 0.0)


def owner_above(model: pin.Model, joint: int, owners: set[int]) -> int:
    """Return the nearest ancestor of a joint that moves links with shapes, or -1 if there is none.

    Two links count as adjacent if there are only links without shapes between them. All joints are given by their ids; `owners`
    has those that move links with shapes.
    """
    while joint > 0:
        joint = model.parents[joint]
        if joint in owners:
            return joint
    return -1
