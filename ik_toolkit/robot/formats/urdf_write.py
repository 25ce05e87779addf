"""Writes links, joints and primitive shapes as URDF elements, with the XML of the standard library only."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

import numpy as np

from ..rotation import matrix_rpy

COLOURS = {"steel": "0.23 0.26 0.30 1", "orange": "0.93 0.52 0.11 1", "silver": "0.72 0.74 0.77 1"}


def new_robot(name: str) -> ET.Element:
    """Return a <robot> element with this name that has only the materials used by the other functions of this file."""
    robot = ET.Element("robot", name=name)
    for colour, rgba in COLOURS.items():
        ET.SubElement(ET.SubElement(robot, "material", name=colour), "color", rgba=rgba)
    return robot


def to_text(robot: ET.Element) -> str:
    """Return a robot element as indented XML text."""
    ET.indent(robot)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"


def add_link(robot: ET.Element, name: str) -> ET.Element:
    """Append a <link> without shapes to a robot element and return it."""
    return ET.SubElement(robot, "link", name=name)


def add_joint(
    robot: ET.Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    T: np.ndarray,
    limit: Mapping[str, float] | None = None,
    axis: Sequence[float] | np.ndarray = (0.0, 0.0, 1.0),
) -> ET.Element:
    """Append a joint at the pose T (4, 4) [m] in the parent link to a robot element and return it.

    A joint that moves has a `limit` with lower and upper [rad or m], which a continuous joint lacks, and effort and velocity, which
    Pinocchio requires. It moves about or along `axis`.
    """
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    origin(joint, T)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    if limit is not None:
        ET.SubElement(joint, "axis", xyz=numbers_text(axis))
        ET.SubElement(joint, "limit", {key: _text(value) for key, value in limit.items()})
    return joint


def add_shape(
    link: ET.Element, shape: str, size: Sequence[float], T: np.ndarray, colour: str, solid: bool = False
) -> None:
    """Append a shape to a link, as visual and if `solid` as collision: 'box' (x, y, z) or 'cylinder' (radius, length) [m]."""
    if min(size) <= 0.0:
        return  # The tube of a prismatic joint without a stroke has the length 0 and is not drawn.
    ET.SubElement(_add_part(link, "visual", shape, size, T), "material", name=colour)
    if solid:
        _add_part(link, "collision", shape, size, T)


def _add_part(link: ET.Element, tag: str, shape: str, size: Sequence[float], T: np.ndarray) -> ET.Element:
    part = ET.SubElement(link, tag)
    origin(part, T)
    geometry = ET.SubElement(part, "geometry")
    if shape == "box":
        ET.SubElement(geometry, "box", size=numbers_text(size))
    else:
        ET.SubElement(geometry, "cylinder", radius=_text(size[0]), length=_text(size[1]))
    return part


def add_bar(link: ET.Element, a: np.ndarray, b: np.ndarray, r: float) -> None:
    """Add the shapes of a bar from point a to point b (3,) [m] to a link: a cylinder if it is along z, else a box.

    Its collision shape is shorter, so that it does not touch the joints at its ends.
    """
    length = float(np.linalg.norm(b - a))
    T = _along(a, b)
    if abs(T[2, 2]) > 0.999:
        add_shape(link, "cylinder", (0.9 * r, length), T, "steel")
    else:
        add_shape(link, "box", (1.7 * r, 1.3 * r, length), T, "steel")
        if length > 6.0 * r:
            add_shape(link, "box", (0.9 * r, 1.6 * r, length - 4.5 * r), T, "orange")
    if length > 3.5 * r:
        _add_part(link, "collision", "cylinder", (0.9 * r, length - 3.0 * r), T)


def add_gripper(link: ET.Element, a: np.ndarray, b: np.ndarray, r: float) -> None:
    """Add the shapes of a gripper to a link: a palm, and two fingers whose ends are on both sides of the point b (3,) [m]."""
    size = min(r, float(np.linalg.norm(b - a)) / 5.2)
    T = _along(a, b)
    T[:3, 3] = b
    add_shape(link, "box", (2.6 * size, 1.4 * size, 0.7 * size), T @ shift(z=-2.4 * size), "silver")
    for side in (-1.0, 1.0):
        add_shape(
            link, "box", (0.4 * size, 0.9 * size, 2.2 * size), T @ shift(x=side * 1.0 * size, z=-1.1 * size), "orange"
        )


def shift(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Return the transform (4x4) of a pure translation [m]."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def _along(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a frame (4x4) midway between a and b, with z from a to b; a boom drawn in it has two faces along the joint's axis."""
    z = (b - a) / np.linalg.norm(b - a)
    side = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    y = np.cross(z, side)
    y /= np.linalg.norm(y)
    T = shift(*(0.5 * (a + b)))
    T[:3, :3] = np.column_stack([np.cross(y, z), y, z])
    return T


# ------------------------------------------------------------------------------------------------------------- text
def origin(parent: ET.Element, T: np.ndarray) -> None:
    """Append an <origin> with the pose T (4, 4) [m] to an element."""
    ET.SubElement(parent, "origin", xyz=numbers_text(T[:3, 3]), rpy=numbers_text(matrix_rpy(T[:3, :3])))


def numbers_text(values: Sequence[float] | np.ndarray) -> str:
    """Return numbers as the text of an XML attribute with all digits, so that reading it gives the same numbers."""
    return " ".join(_text(value) for value in values)


def _text(value: float) -> str:
    """Return the shortest text that reads back as the same number; -0 becomes 0."""
    number = float(value) + 0.0
    return str(int(number)) if number.is_integer() and abs(number) < 1e15 else repr(number)
