"""Makes MJCF text safe before MuJoCo reads it: includes from the model's folders are inlined, other file references are removed."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ...errors import ModelError
from ..geometry.meshes import lies_in
from .urdf import CAPS, check_names, source_text, walk

MAX_COPIES = 20_000  # Limit on the number of elements after <replicate> is expanded, and on keyframes times bodies.
MAX_INCLUDES = 200  # Limit on the number of included files. The largest model of the MuJoCo Menagerie has 5.
KEPT = ("compiler", "default", "asset", "worldbody", "contact", "tendon", "equality", "keyframe")
SHAPED = {"mesh": ("name", "class", "scale"), "material": ("name", "class", "rgba"), "hfield": ("name",)}
NO_BODY = ("attach", "plugin", "composite", "flexcomp", "flex", "skin", "model", "light", "camera")
# Every mesh file is replaced by the vertices of this tetrahedron, so that MuJoCo opens no files. MuJoCo moves a mesh to its
# centre of mass, but it reports the offset, which is then undone.
TETRAHEDRON = "0 0 0 1 0 0 0 1 0 0 0 1"


@dataclass
class Flat:
    """MJCF text with all references to files removed.

    `xml` is the text. `meshes` maps the name of each mesh to the path of its file, relative to the folder of the model unless it is
    absolute. `origins` maps the name of a mesh to its attributes refpos and refquat, if it has them. `notes` are sentences on what
    was left out.
    """

    xml: str
    meshes: dict[str, str] = field(default_factory=dict)
    origins: dict[str, tuple[str, str]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def tree(text: str) -> ET.Element:
    """Parse MJCF text with the same safety limits as a URDF and return its root element. Raises ModelError."""
    nodes: list[ET.Element] = []
    roots: list[ET.Element] = []

    def start(tag: str, attributes: dict[str, str], above: Sequence[str], line: int) -> None:
        check_names({"name": attributes.get("name", "")}, "MJCF", line)
        element = ET.Element(tag, attributes)
        del nodes[len(above) :]
        (nodes[-1].append if nodes else roots.append)(element)
        nodes.append(element)

    walk(text, "MJCF", start)
    return roots[0]


class Flattener:
    """Replaces the <include> elements of an MJCF file by the included files, which must lie inside the given folders."""

    def __init__(self, path: Path | None, folders: list[Path]) -> None:
        self.home = path.resolve().parent if path else None
        self.folders, self.bytes = folders, CAPS.bytes
        self.included: list[Path] = []

    def find(self, name: str, beside: Path | None) -> Path:
        """Return the real path of an included file. Raises ModelError if it is missing or outside the folders."""
        if not name or "\0" in name or self.home is None:
            raise ModelError(f"<include file='{name[:100]}'> cannot be found without a folder")
        places = [folder / name for folder in dict.fromkeys((self.home, beside or self.home))]
        try:
            real = [place.resolve() for place in places]
            found = [place for place in real if lies_in(place, self.folders)]
            there = next((place for place in found if place.is_file()), None)
        except (OSError, ValueError, RuntimeError):
            raise ModelError(f"<include file='{name[:100]}'> cannot be read") from None
        if not found:
            raise ModelError(
                f"<include file='{name[:100]}'> lies outside the model's folder; name its folder with package_dirs"
            )
        if there is None:
            raise ModelError(f"<include file='{name[:100]}'>: there is no such file")
        return there

    def put_in(self, element: ET.Element, beside: Path | None, above: tuple[Path, ...]) -> None:
        """Replace the <include> elements below an element, in place, by the contents of the files that they name."""
        children: list[ET.Element] = []
        for child in element:
            if child.tag != "include":
                self.put_in(child, beside, above)
                children.append(child)
                continue
            file = self.find(child.get("file", ""), beside)
            if file in above:
                raise ModelError(f"'{file.name}' includes itself")
            self.included.append(file)
            if len(self.included) > MAX_INCLUDES:
                raise ModelError(f"the model includes more than {MAX_INCLUDES} files; it is not read")
            text = source_text(file, "MJCF")
            self.bytes -= len(text)
            if self.bytes < 0:
                raise ModelError(f"the model and what it includes are larger than {CAPS.bytes // 1_000_000} MB")
            inner = tree(text)
            self.put_in(inner, file.parent, (*above, file))
            children += list(inner)
        element[:] = children


def flatten(text: str, path: Path | None, folders: list[Path]) -> Flat:
    """Return an MJCF text without <include> elements and with placeholders for its mesh files. Raises ModelError."""
    flattener = Flattener(path, folders)
    root = tree(text)
    flattener.put_in(root, flattener.home, (path.resolve(),) if path else ())
    _check_copies(root)
    flat = Flat("")
    folders_of = _directories(root)
    if any(flag.get("contact") == "disable" for flag in root.iter("flag")):
        flat.notes.append("that contacts are disabled is not used")
    for section in list(root):
        if section.tag not in KEPT:
            root.remove(section)
    _strip(root, flat, folders_of)
    for section in root:
        if section.tag == "compiler":
            section[:] = []
        if section.tag == "keyframe":
            bodies = sum(1 for _ in root.iter("body"))
            section[:] = section[: max(MAX_COPIES // max(bodies, 1), 1)]
            for key in section:
                for attribute in set(key.attrib) - {"name", "qpos", "time"}:
                    del key.attrib[attribute]
    flat.xml = ET.tostring(root, "unicode")
    return flat


def _check_copies(root: ET.Element) -> None:
    """Raise ModelError if <replicate> would make more elements than any robot has."""
    if next(root.iter("replicate"), None) is not None and (copies := _copies(root)) > MAX_COPIES:
        raise ModelError(f"its <replicate> comes to {copies:,} elements, more than {MAX_COPIES:,}; it is not read")
    # A model with too many elements is refused before MuJoCo compiles it, which would take seconds.
    for tag in ("body", "joint", "geom", "site"):
        if sum(1 for world in root.iter("worldbody") for _ in world.iter(tag)) > MAX_COPIES:
            raise ModelError(f"it has more than {MAX_COPIES:,} elements <{tag}>; it is not read")


def _copies(element: ET.Element) -> int:
    """Return how many elements an element becomes when its <replicate> are carried out."""
    inside = sum(map(_copies, element))
    if element.tag != "replicate":
        return 1 + inside
    try:
        return max(int(element.get("count", "1")), 1) * max(inside, 1)
    except ValueError:
        return inside  # A count that is no number needs no error here, because MuJoCo reports it.


def _directories(root: ET.Element) -> Mapping[str, str]:
    """Return the mesh folder of the <compiler> settings, and whether directories in mesh paths are stripped."""
    found = {"folder": "", "strip": ""}
    for compiler in root.iter("compiler"):
        found["folder"] = compiler.get("meshdir", compiler.get("assetdir", found["folder"]))
        found["strip"] = "1" if compiler.get("strippath", "false") == "true" else found["strip"]
        # exactmeshinertia and convexhull occur in older files, and MuJoCo refuses them today.
        for attribute in ("meshdir", "texturedir", "assetdir", "strippath", "exactmeshinertia", "convexhull"):
            compiler.attrib.pop(attribute, None)
    return found


def _strip(element: ET.Element, flat: Flat, where: Mapping[str, str], asset: bool = False) -> None:
    """Remove references to files and everything that does not affect a robot's shape or motion."""
    for child in list(element):
        if child.tag in NO_BODY or (asset and child.tag not in SHAPED):
            element.remove(child)
            if child.tag in ("attach", "composite", "flexcomp"):
                flat.notes.append(f"<{child.tag}> is not read")
            continue
        if element.tag == "equality" and child.tag not in ("joint", "connect", "weld", "tendon"):
            element.remove(child)
            flat.notes.append(f"an equality of <{child.tag}> is left out")
            continue
        if element.tag == "contact" and child.tag != "exclude":
            element.remove(child)
            flat.notes.append(f"a <{child.tag}> of <contact> is left out")
            continue
        if child.tag == "geom" and "mesh" in child.attrib:
            # If a geom has a mesh and another type, such as box, MuJoCo would fit a box to the placeholder of the mesh.
            if child.get("type", "mesh") != "mesh":
                flat.notes.append(
                    f"mesh '{child.get('mesh')}' itself is read where a {child.get('type')} is fitted to it"
                )
            child.set("type", "mesh")
        # Materials are not only in <asset> but also in <default>, and there too they can name a texture file.
        if asset or child.tag == "material":
            _asset(child, flat, where)
        for attribute in ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback"):
            child.attrib.pop(attribute, None)
        _strip(child, flat, where, child.tag == "asset")


def _asset(child: ET.Element, flat: Flat, where: Mapping[str, str]) -> None:
    """Replace a mesh by the tetrahedron, a height field by a flat one and a material by its plain colour."""
    file = child.get("file", "").replace("\\", "/")
    given = {key: child.get(key, "") for key in SHAPED[child.tag] if child.get(key) is not None}
    if child.tag in ("mesh", "hfield") and "name" not in given and file:
        given["name"] = Path(file).stem
    if child.tag == "mesh":
        inline = child.get("vertex") is not None or child.get("builtin") is not None
        if file and not inline:
            file = Path(file).name if where["strip"] else file
            folder = where["folder"].rstrip("/")
            flat.meshes[given["name"]] = f"{folder}/{file}" if folder and not file.startswith("/") else file
            if "refpos" in child.attrib or "refquat" in child.attrib:
                flat.origins[given["name"]] = child.get("refpos", "0 0 0"), child.get("refquat", "1 0 0 0")
        given["vertex"] = TETRAHEDRON
    elif child.tag == "hfield":
        given |= {"nrow": "2", "ncol": "2", "size": "1 1 1 1"}
    child.attrib.clear()
    child.attrib.update(given)
    child[:] = []
