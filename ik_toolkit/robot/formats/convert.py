"""Writes any description that `Robot.load` reads as a plain URDF: macros are expanded, meshes get their actual paths."""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import ModelError
from ..geometry.meshes import find_mesh, mesh_folders, mesh_packages
from ..load import read_source
from .urdf import plain_origin


class Converted(NamedTuple):
    """A plain URDF made from another description.

    name is the robot's; meshes maps each mesh name of the description to the name in the text; lost maps each mesh that
    was not found to the reason.
    """

    name: str
    text: str
    meshes: dict[str, str]
    lost: dict[str, str]


def convert(
    source: str | Path,
    folder: str | Path | None = None,
    *,
    package_dirs: Iterable[str | Path] = (),
    xacro_args: Mapping[str, Any] | None = None,
) -> Converted:
    """Return any description that `Robot.load` reads as a plain URDF.

    A mesh below `folder`, where the text will be saved, is named relative to it, every other mesh by its absolute path.
    A mesh that is not found keeps its name. Raises what `Robot.load` raises.
    """
    made = read_source(source, package_dirs, xacro_args)[1]
    home = None if folder is None else Path(folder).expanduser().resolve()
    root = ET.fromstring(made["urdf"], ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))  # noqa: S314 - read safely
    for origin in root.iter("origin"):
        given = dict(origin.attrib)
        origin.attrib.clear()
        origin.attrib.update(plain_origin(given))
    elements = [mesh for mesh in root.iter("mesh") if mesh.get("filename")]
    names = [mesh.get("filename", "") for mesh in elements]
    packages = mesh_packages(names, made["path"], made["package_dirs"])
    folders = [*mesh_folders(made["path"], made["package_dirs"]), *packages.values()]
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
    return Converted(made["name"], text, meshes, lost)
