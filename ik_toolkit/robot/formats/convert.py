"""Writes any robot description that `Robot.load` reads as a plain URDF, with macros expanded, mesh paths resolved and, on request,
corrections from a calibration.
"""

import logging
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...errors import ModelError
from ...files import as_output, write_whole
from ..geometry.meshes import find_mesh, lies_in, mesh_folders, mesh_packages
from ..load import read_source
from ..rotation import rpy_matrix
from .urdf import plain_origin
from .urdf_model import build_model
from .urdf_write import add_joint, add_link, numbers_text, origin, to_text

SHOWN = 3  # A message names this many missing meshes and counts the others.


class Converted(NamedTuple):
    """A robot description converted to one plain URDF text.

    `name` is that of the robot. `meshes` maps the name of each mesh in the description to its name in the URDF, and `lost` each
    mesh that was not found to the reason. `outside` lists folders that must be given as package_dirs, or else meshes of the saved
    URDF are not read.
    """

    name: str
    text: str
    meshes: dict[str, str]
    lost: dict[str, str]
    outside: tuple[str, ...] = ()

    def notes(self) -> list[str]:
        """Return up to two sentences for the user: on meshes that were not found, and on package_dirs that the saved URDF needs."""
        found = []
        if self.lost:
            some = "; ".join(f"'{name}' {why}" for name, why in list(self.lost.items())[:SHOWN])
            more = f"; and {len(self.lost) - SHOWN} more" if len(self.lost) > SHOWN else ""
            found.append(f"meshes that keep their names (--package-dir names their folder): {some}{more}")
        if self.outside:
            given = " ".join(f"--package-dir {folder}" for folder in self.outside)
            found.append(
                f"meshes lie outside the folder of the new file; its pictures and collisions need {given} (package_dirs= in Python)"
            )
        return found


def convert(
    source: str | Path,
    folder: str | Path | None = None,
    *,
    package_dirs: Iterable[str | Path] = (),
    xacro_args: Mapping[str, Any] | None = None,
) -> Converted:
    """Convert any description that `Robot.load` reads to a plain URDF, and return it with notes on its meshes.

    A mesh below `folder`, where the text will be saved, is named relative to it, every other mesh by its absolute path.
    A mesh that is not found keeps its name. Raises what `Robot.load` raises.
    """
    made = read_source(source, package_dirs, xacro_args)[1]
    return _plain(made["name"], made["urdf"], made["path"], made["package_dirs"], folder)


def write_urdf(robot: Any, path: str | Path) -> Path:
    """Write the robot's description as one plain URDF, as `ik convert` does; return the path.

    Base, tip and what was changed since (tool, place, limits, locked joints) are not written; the log names what was changed, and
    which package_dirs the meshes of the new file need. Raises ModelError if the robot was made without a URDF, InvalidOption,
    OSError.
    """
    file = as_output(path, "a robot", ".urdf", ".xml")
    made = _plain(robot.name, _text_of(robot), robot.path, robot.package_dirs, file.parent)
    write_whole(file, made.text)
    changes = {
        "tool": robot.tool_shapes or not np.array_equal(robot.tool.homogeneous, np.eye(4)),
        "place (on_base)": robot.on_base is not None,
        "narrower limits": robot._ranges,
        "locked joints": robot.locked_joints,
        "the other joints or lengths of the given model": not robot.arms[0]._is_described(),
    }
    notes = made.notes()
    if lost := ", ".join(name for name, changed in changes.items() if changed):
        notes.append(f"holds the description as it was read, without {lost}")
    for note in notes:
        logging.getLogger("ik_toolkit").warning("%s: %s", file.name, note)
    return file


def corrected_robot(robot: Any, joints: Mapping[str, np.ndarray], against: Iterable[str], tool: np.ndarray) -> Any:
    """Return a copy of a Robot with corrections (from a calibration) written into its URDF.

    `joints` maps the name of a joint to the transform C (4, 4) [m] by which its <origin> is multiplied from the right. The <axis>
    of the joints in `against` is reversed. `tool` is a transform (4, 4) of the tip, applied in the same way to the fixed joint of
    the tip's link. If there is no such joint, or the robot has a tool, a link is added. Raises ModelError if the robot has no URDF,
    or one of another model.
    """
    if robot.urdf is not None and not robot._is_described():
        raise ModelError(
            f"the URDF of robot '{robot.name}' does not describe the model it was made from, so it cannot be corrected; "
            "load the robot from its URDF"
        )
    root = ET.fromstring(_text_of(robot), ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))  # noqa: S314 - read safely
    elements = {joint.get("name"): joint for joint in root.findall("joint")}
    for name, C in joints.items():
        _move(elements[name], C)
    for name in against:
        axis = elements[name].find("axis")
        axis = ET.SubElement(elements[name], "axis", xyz="1 0 0") if axis is None else axis
        axis.set("xyz", numbers_text([-float(x) for x in axis.get("xyz", "1 0 0").split()]))
    tip, T = robot.tip, robot.tool.homogeneous @ tool
    link = next((_child(joint) for joint in root.findall("joint") if joint.get("name") == tip), tip)
    holder = next(
        (joint for joint in root.findall("joint") if _child(joint) == link and joint.get("type") == "fixed"), None
    )
    if holder is not None and np.array_equal(robot.tool.homogeneous, np.eye(4)):
        _move(holder, T)
    elif not np.array_equal(T, np.eye(4)):
        taken = {part.get("name") for part in root}
        tip = next(name for k in range(len(taken) + 1) if (name := f"{link}_calibrated{k or ''}") not in taken)
        add_link(root, tip)
        add_joint(root, f"{tip}_fixed", "fixed", link, tip, T)
    text = to_text(root)
    none = type(robot.tool).Identity()
    back = type(robot.tool)(T).inverse() if tip != robot.tip else none
    shapes = tuple((shape, back * place) for shape, place in robot.tool_shapes)
    other = robot._variant(urdf=text, tip=tip, tool=none, tool_shapes=shapes)
    other._settle(build_model(text))
    return other._build(robot.home)


def _text_of(robot: Any) -> str:
    if robot.urdf is None:
        raise ModelError(
            f"robot '{robot.name}' was made without a URDF, so none can be written; give urdf= to ik.Robot"
        )
    return robot.urdf


def _child(joint: ET.Element) -> str:
    child = joint.find("child")
    return "" if child is None else child.get("link", "")


def _move(joint: ET.Element, C: np.ndarray) -> None:
    """Multiply the <origin> of a joint by a transform C (4, 4) from the right."""
    T = np.eye(4)
    for given in joint.findall("origin"):
        numbers = plain_origin(given.attrib)
        T[:3, 3] = [float(x) for x in numbers.get("xyz", "0 0 0").split()]
        T[:3, :3] = rpy_matrix([float(x) for x in numbers.get("rpy", "0 0 0").split()])
        joint.remove(given)
    origin(joint, T @ C)


def _plain(
    robot_name: str, urdf: str, path: Path | None, package_dirs: Iterable[str | Path], folder: str | Path | None
) -> Converted:
    """Make the plain URDF of a description read from `path`, to be saved in `folder`."""
    home = None if folder is None else Path(folder).expanduser().resolve()
    root = ET.fromstring(urdf, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))  # noqa: S314 - read safely
    for place in root.iter("origin"):
        given = dict(place.attrib)
        place.attrib.clear()
        place.attrib.update(plain_origin(given))
    elements = [mesh for mesh in root.iter("mesh") if mesh.get("filename")]
    names = [mesh.get("filename", "") for mesh in elements]
    package_dirs = tuple(package_dirs)
    packages = mesh_packages(names, path, package_dirs)
    folders = [*mesh_folders(path, package_dirs), *packages.values()]
    meshes: dict[str, str] = {}
    lost: dict[str, str] = {}
    for name in dict.fromkeys(names):
        try:
            file = find_mesh(name, folders, packages)
        except ModelError as error:
            lost[name] = str(error)
        else:
            below = home is not None and file.is_relative_to(home)
            meshes[name] = file.relative_to(home).as_posix() if below and home else str(file)
    for mesh, name in zip(elements, names, strict=True):
        mesh.set("filename", meshes.get(name, name))
    text = '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, "unicode") + "\n"
    return Converted(robot_name, text, meshes, lost, () if home is None else _outside(meshes.values(), folders, home))


def _outside(files: Iterable[str], folders: Sequence[Path], home: Path) -> tuple[str, ...]:
    """Return the folders that a user must name so that a URDF saved in `home` finds its meshes.

    For each of `folders` with meshes that it would not find otherwise, this is the smallest folder that contains all of these.
    """
    allowed = mesh_folders(home / "robot.urdf", ())
    groups: dict[Path, list[Path]] = {}
    for file in (Path(name) for name in files if Path(name).is_absolute()):
        if not lies_in(file, allowed):
            root = max((folder for folder in folders if lies_in(file, [folder])), key=lambda folder: len(folder.parts))
            groups.setdefault(root, []).append(file.parent)
    return tuple(sorted({os.path.commonpath(group) for group in groups.values()}))
