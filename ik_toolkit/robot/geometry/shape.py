"""Collision shapes: boxes, spheres, cylinders, capsules and meshes, in the workspace, on a tool or held by the robot."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import coal
import numpy as np

from ...errors import InvalidConfiguration, InvalidOption, ModelError, floats, near_match
from ...files import as_path, from_home
from ...text import how_many
from ..formats.urdf import SIZES
from .meshes import Mesh, find_mesh, read_meshes


@dataclass(frozen=True)
class Shape:
    """A collision shape in its own frame, best made by Shape.box, sphere, cylinder, capsule or mesh.

    Args:
        kind: 'box', 'sphere', 'cylinder', 'capsule' or 'mesh'.
        sizes: (x, y, z), (radius,) or (radius, length) [m], or (file, scale) for a mesh.

    Raises:
        InvalidOption: There is no such kind, or a size is not positive.
    """

    kind: str
    sizes: Sequence

    def __post_init__(self) -> None:
        """Check kind and sizes. Raises InvalidOption."""
        known = {**SIZES, "mesh": {"scale": 1}}
        if self.kind not in list(known):
            raise InvalidOption(f"there is no shape '{self.kind}'.{near_match(self.kind, known)}")
        try:
            file, given = (self.sizes[:1], self.sizes[1:]) if self.kind == "mesh" else ((), self.sizes)
        except TypeError:
            raise InvalidOption(f"the sizes of a {self.kind} must be a tuple, not {self.sizes!r:.60}") from None
        parts = known[self.kind]
        sizes = _positive(f"{' and '.join(parts)} of a {self.kind}", given, sum(parts.values()))
        object.__setattr__(self, "sizes", (*map(str, file), *sizes))

    @classmethod
    def box(cls, size: Sequence[float]) -> "Shape":
        """Make a box of size (x, y, z) [m], centred at its origin. Raises InvalidOption."""
        return cls("box", size)

    @classmethod
    def sphere(cls, radius: float) -> "Shape":
        """Make a sphere with this radius [m], centred at its origin. Raises InvalidOption."""
        return cls("sphere", (radius,))

    @classmethod
    def cylinder(cls, radius: float, length: float) -> "Shape":
        """Make a cylinder of this radius and length [m] along z, centred at its origin. Raises InvalidOption."""
        return cls("cylinder", (radius, length))

    @classmethod
    def capsule(cls, radius: float, length: float) -> "Shape":
        """Make a capsule along z, centred at its origin: a cylinder of this radius and length [m] with half a ball at each end.

        Raises InvalidOption.
        """
        return cls("capsule", (radius, length))

    @classmethod
    def mesh(cls, path: str | Path, scale: float = 1.0) -> "Shape":
        """Make a shape of the surface in a mesh file (STL, OBJ, DAE), scaled to metres by `scale`; a part within touches nothing.

        Raises InvalidOption.
        """
        return cls("mesh", (as_path(path, "the file of a mesh"), scale))

    def form(self) -> Any:
        """Return the shape as an object of the collision library coal. Raises InvalidConfiguration if its mesh cannot be read."""
        if self.kind != "mesh":
            return PLAIN[self.kind](*self.sizes)
        path, scale = self.sizes
        file = from_home(path)
        if not os.path.isfile(file):  # Path.is_file raises if a name is too long.
            raise InvalidConfiguration(f"there is no mesh file '{path:.200}'")
        try:
            real = find_mesh(str(file.absolute()), [file.resolve().parent, file.absolute().parent])
        except ModelError as error:
            raise InvalidConfiguration(f"the mesh file '{path}' {error}") from None
        mesh = read_meshes([real], "surface", [real.parent])[real]
        if mesh.refused:
            raise InvalidConfiguration(f"the mesh file '{path}' {mesh.refused}")
        return surface(mesh, np.full(3, scale))

    def corners(self) -> np.ndarray:
        """Return the corners (8, 3) [m] of the box, along the axes of the shape, that encloses it; x changes slowest."""
        form = self.form()
        form.computeLocalAABB()
        box = form.aabb_local
        return np.array(list(product(*zip(box.min_, box.max_, strict=True))))


PLAIN = {"box": coal.Box, "sphere": coal.Sphere, "cylinder": coal.Cylinder, "capsule": coal.Capsule}


def surface(mesh: Mesh, scale: np.ndarray) -> Any:
    """Return the triangles of a mesh, scaled by `scale` (3,), as an object of the collision library coal."""
    made = coal.BVHModelOBBRSS()
    (piece,) = mesh.pieces
    made.beginModel(len(piece.faces), len(piece.vertices))
    made.addVertices(piece.vertices * scale)
    made.addTriangles(piece.faces)
    made.endModel()
    return made


def is_shape(value: Any) -> Shape:
    """Raise InvalidOption unless the value is a Shape; return it."""
    if not isinstance(value, Shape):
        raise InvalidOption(
            f"a shape must be one of ik.Shape.box, sphere, cylinder, capsule or mesh, not {value!r:.60}"
        )
    return value


def _positive(what: str, values: Any, count: int) -> tuple[float, ...]:
    wanted = f"the {what} must be {how_many(count, 'positive number')} [m]"
    array = floats(values, wanted, InvalidOption)
    if array.shape != (count,) or not (np.isfinite(array) & (array > 0)).all():
        raise InvalidOption(f"{wanted}, not {values!r:.60}")
    return tuple(array.tolist())
