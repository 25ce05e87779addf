"""Subprocess that reads mesh files for `meshes.py`, so that a file that crashes its reader crashes only this process.

Its job (JSON on stdin) has kind, 'surface' (triangles by coal, for collisions) or
'look' (triangles and colours by trimesh), out (a folder), folders (the only ones referenced files are read from),
files, and the limits. It prints "begin K", then one line of JSON per file, and writes OUT/K.npz with v0, f0, c0
(vertices [m], faces, colour or empty), v1, ...
"""

import base64
import io
import json
import os
import sys
import warnings
from pathlib import Path
from urllib.parse import unquote
from xml.parsers import expat

# This file runs as a script, so the package is importable only if its parent folder is on sys.path.
sys.path.append(str(Path(__file__).parents[3]))
from ik_toolkit.robot.formats.sandbox import limit

FAR = 1e6  # A coordinate beyond this [units of the file] means that the file is corrupt.
REPEATED = 100_000  # Limit on the nodes of a mesh file, in which an instance of a node counts as a copy of it.
# Error messages of coal have many lines; those that begin with these words do not say what is wrong.
COAL = ("From file", "in function", "at line", "message: Could not load resource", "Hint")
# Packages that trimesh would import if they are installed. They are hidden from it, because no mesh needs them and importing them
# takes three times as long as all other imports.
UNUSED = ("scipy", "networkx", "shapely")
DEEP = 200  # Limit on the nesting of nodes in a .dae or .gltf; exporters nest a few.


class MeshRefused(Exception):
    """Raised for a mesh file that is refused; the message says why."""


class References:
    """Reads files that a mesh file refers to, if they are regular files inside the allowed folders and not too large."""

    def __init__(self, file: Path, job: dict) -> None:
        self.file, self.job = file, job
        self.refused: list[str] = []  # Sentences on references that lead out of the allowed folders and were not read.
        self.last = ""

    def get(self, name: str) -> bytes:
        """Return the bytes of a referenced file. Raises MeshRefused if it lies outside the folders or does not exist."""
        shown, inside = repr(name)[:100], False
        try:
            if "://" in name:
                raise MeshRefused
            path = (self.file.parent / unquote(name).strip()).resolve()
            inside = any(path.is_relative_to(folder) for folder in self.job["folders"])
            if inside and path.is_file() and path.stat().st_size <= self.job["bytes"]:
                return path.read_bytes()
            said = "does not exist or is too large" if inside else "lies outside the folders of the robot"
        except MeshRefused:
            said = "is a network address"
        except (OSError, ValueError, RuntimeError):
            said = "cannot be read"
        self.last = f"{shown}, which it refers to, {said} and is not read"
        if not inside:
            self.refused.append(self.last)
        raise MeshRefused(self.last)

    __getitem__ = get


def check_xml(raw: bytes) -> None:
    """Raise MeshRefused for a .dae file with entity declarations or nodes that contain themselves or are nested too deep."""
    stack: list[str] = []
    # For each node or scene, by id: the ids of the nodes in it, and of the nodes of which it has instances.
    inside: dict[str, list] = {}
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict) -> None:
        tag = tag.rpartition(":")[2]
        stack.append(attributes.get("id", "") if tag in ("node", "visual_scene") else "")
        if len(stack) > DEEP:
            raise MeshRefused(f"its elements are nested more than {DEEP} deep")
        child = attributes.get("url", "").lstrip("#") if tag.startswith("instance_") else stack[-1]
        if child:
            inside.setdefault(next(filter(None, reversed(stack[:-1])), ""), []).append(child)

    def refuse(*_: object) -> None:
        raise MeshRefused("it has a DOCTYPE or entity declarations")

    parser.StartElementHandler, parser.EndElementHandler = start, lambda tag: stack.pop()
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    try:
        parser.Parse(raw, True)
    except expat.ExpatError as error:
        raise MeshRefused(
            f"it is not well-formed XML ({expat.ErrorString(error.code)} in line {error.lineno})"
        ) from None
    check_instances(inside)


def check_instances(inside: dict[str, list]) -> None:
    """Raise MeshRefused if nodes of a mesh file contain themselves, are nested too deep, or expand to too many nodes.

    `inside` maps the id of a node to the ids of the nodes in it. An instance of another node counts as a copy of that node.
    """
    size: dict[str, int] = {}

    def visit(node: str, above: tuple[str, ...]) -> int:
        if node in above:
            raise MeshRefused(f"its node {node[:60]!r} contains itself")
        if len(above) > DEEP:
            raise MeshRefused(f"its nodes are nested more than {DEEP} deep")
        if node not in size:
            size[node] = 1 + sum(visit(child, (*above, node)) for child in inside.get(node, ()))
            if size[node] > REPEATED:
                raise MeshRefused(f"its nodes expand to more than {REPEATED:,} others")
        return size[node]

    for root in inside:
        visit(root, ())


def inline(raw: bytes, references: References) -> bytes:
    """Return a .gltf file with the contents of its buffer files in place of their paths.

    Otherwise the library that reads it would open the paths, which may be outside the allowed folders.
    """
    tree = json.loads(raw)
    for buffer in tree.get("buffers", []):
        uri = buffer.get("uri", "")
        if uri and not uri.startswith("data:"):
            data = base64.b64encode(references.get(uri)).decode()
            buffer["uri"] = f"data:application/octet-stream;base64,{data}"
    tree["images"] = [{"uri": "data:image/png;base64,"} for _ in tree.get("images", [])]
    return json.dumps(tree).encode()


def check_gltf(raw: bytes) -> None:
    """Raise MeshRefused for a .gltf or .glb file with broken JSON or faulty nodes, and for a .glb with buffers in other files."""
    binary = raw[:4] == b"glTF"
    try:
        tree = json.loads(raw[20 : 20 + int.from_bytes(raw[12:16], "little")] if binary else raw)
        inside = {str(k): [str(c) for c in node.get("children", [])] for k, node in enumerate(tree.get("nodes", []))}
        outside = binary and any(
            not str(buffer.get("uri", "data:")).startswith("data:") for buffer in tree.get("buffers", [])
        )
    except (ValueError, AttributeError, TypeError, RecursionError):
        raise MeshRefused("its JSON is broken") from None
    if outside:
        raise MeshRefused("it keeps buffers in other files")
    check_instances(inside)


def collision_mesh(file: Path, raw: bytes, references: References, out: Path):
    """Yield vertices (N, 3) [units of the file], faces (M, 3) and None (no colour) of a mesh file, read by coal for collisions."""
    import coal
    import numpy as np

    path, kind = file, file.suffix.lower()
    if kind in (".obj", ".gltf"):
        path = out / f"copy{kind}"
        if kind == ".obj":  # Only lines of vertices and faces are kept, because other lines may name files.
            lines = raw.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines()
            path.write_bytes(b"\n".join(line for line in lines if line.split()[:1] in ([b"v"], [b"f"])))
        else:
            path.write_bytes(inline(raw, references))
    shape = coal.MeshLoader().load(str(path), np.ones(3))
    faces = [(t[0], t[1], t[2]) for t in map(shape.tri_indices, range(shape.num_tris))]
    yield shape.vertices(), np.array(faces, dtype=np.int64).reshape(-1, 3), None


def coloured_mesh(file: Path, raw: bytes, references: References, out: Path):
    """Yield vertices (N, 3) [units of the file], faces (M, 3) and colour (3,), or None, of each part of a mesh file for drawing."""
    import numpy as np

    sys.modules.update(dict.fromkeys(UNUSED))  # type: ignore[arg-type]  None: not found
    import trimesh
    from trimesh.resolvers import Resolver as BaseResolver

    class Resolver(BaseResolver):
        def __init__(self) -> None:
            pass

        get = __getitem__ = staticmethod(references.get)  # pyright: ignore[reportAssignmentType]
        write = namespaced = keys = lambda *_: None  # pyright: ignore[reportAssignmentType]

    warnings.simplefilter("ignore")  # trimesh warns about materials, which are not used here.
    scene = trimesh.load_scene(io.BytesIO(raw), file_type=file.suffix.lower()[1:], resolver=Resolver())
    for node in scene.graph.nodes_geometry:
        T, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not hasattr(mesh, "faces") or not len(mesh.faces):
            continue
        own = getattr(getattr(mesh.visual, "material", mesh.visual), "main_color", None)
        color = None if own is None else np.asarray(own[:3], dtype=float) / 255.0
        yield trimesh.transform_points(mesh.vertices, T), mesh.faces, color


def read_mesh(file: Path, references: References, job: dict, out: Path, number: int) -> None:
    """Read a mesh file and write its vertices, faces and colours to the file `number`.npz in the folder `out`."""
    import numpy as np

    raw = file.read_bytes()
    if file.suffix.lower() == ".dae":
        check_xml(raw)
    elif file.suffix.lower() in (".gltf", ".glb"):
        check_gltf(raw)
    arrays, count = {}, 0
    pieces = {"surface": collision_mesh, "look": coloured_mesh}[job["kind"]](file, raw, references, out)
    for k, (vertices, faces, color) in enumerate(pieces):
        vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces, dtype=np.int64)
        count += len(faces)
        if count > job["triangles"]:
            raise MeshRefused(f"it has more than {job['triangles']:,} triangles")
        if len(faces) and not (np.abs(vertices[np.unique(faces)]) <= FAR).all():  # `> FAR` would accept NaN.
            raise MeshRefused(f"it has vertices that are not finite numbers up to {FAR:g}")
        arrays |= {f"v{k}": vertices, f"f{k}": faces, f"c{k}": np.empty(0) if color is None else color}
    if not count:
        raise MeshRefused("it has no triangles")
    np.savez(out / f"{number}.npz", **arrays)


def _main() -> None:
    """Read the job from stdin, then read the files one by one."""
    job = json.load(sys.stdin)
    out = Path(job["out"])
    limit("CORE", 0)
    limit("AS", job["memory"])
    for number, (name, seconds) in enumerate(job["files"]):
        print(f"begin {number}", flush=True)
        limit("CPU", int(sum(os.times()[:2]) + seconds) + 1)  # Beyond this processor time the system kills the process.
        file = Path(name)
        references = References(file, job)
        said = ""
        try:
            read_mesh(file, references, job, out, number)
        except MeshRefused as error:
            said = str(error)
        except MemoryError:
            said = "it needs too much memory"
        except RecursionError:
            said = "its parts are nested too deep"
        except Exception as error:  # Readers can raise any exception on a broken file.
            lines = [line for line in str(error).splitlines() if not line.startswith(COAL)]
            said = references.last or " ".join(" ".join(lines).split())[:120] or type(error).__name__
        notes = [] if said else list(dict.fromkeys(references.refused))[:3]
        print(json.dumps({"file": number, "refused": said, "notes": notes}), flush=True)


if __name__ == "__main__":
    _main()
