"""Finds mesh files and reads their triangles in a subprocess with limits, because mesh readers crash on broken files.

The same rule holds for `ik check`, pictures, panel and collisions. A mesh is read only from the URDF's folder, the ROS package the
URDF is in (the nearest folder above with a package.xml), `package_dirs` and the packages that mesh names refer to. Symbolic links
that lead outside are rejected. Files that a mesh refers to are treated likewise.
"""

import json
import math
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

import numpy as np

from ...errors import ModelError
from ..formats.sandbox import run
from ..packages import find_package

FORMATS = (".stl", ".dae", ".obj", ".ply", ".off", ".glb", ".gltf")
# Processor time [s] allowed for reading a mesh file, whatever its size. The largest of example-robot-data takes 1.6 s.
SECONDS = 4.0


class MeshCaps(NamedTuple):
    """Limits on the mesh files of a robot, so that reading them does not exhaust the computer's memory or time."""

    bytes: int = 100_000_000  # Limit on the size of a file. The largest in example-robot-data has 29 MB.
    triangles: int = 2_000_000  # Limit on the triangles of a file. The most in example-robot-data are 351,394.
    meshes: int = 1_000  # Limit on the number of different mesh files of a robot.
    packages: int = 50  # Limit on the number of ROS packages that a robot's meshes come from.
    memory: int = 2_000_000_000  # Limit on the memory [bytes] of the reading process; a file of 29 MB takes 0.5 GB.
    seconds_per_mb: float = 2.0  # Processor time [s] allowed for each MB of a file, in addition to SECONDS.
    crashes: int = 5  # Limit on the number of reading processes that may crash for one robot.
    kept: int = 256  # Number of files whose triangles are cached.


CAPS = MeshCaps()
WORKER = Path(__file__).with_name("mesh_worker.py")


class MeshPiece(NamedTuple):
    """The triangles of one material: vertices (N, 3) [units of the file], faces (M, 3), and color (3,) in 0..1 or None."""

    vertices: np.ndarray
    faces: np.ndarray
    color: tuple[float, float, float] | None


@dataclass(frozen=True, eq=False)
class Mesh:
    """The contents of a mesh file: its pieces, or the reason in `refused` why it was not read.

    `notes` are sentences on files that it refers to and that were not read.
    """

    pieces: tuple[MeshPiece, ...] = ()
    refused: str = ""
    notes: tuple[str, ...] = ()


# A cache of the meshes read so far; its keys are kind, path, size, modification time and allowed folders.
_read: dict[tuple, Mesh] = {}


def mesh_folders(path: Path | None, package_dirs: Iterable[str | Path]) -> list[Path]:
    """Return the folders, with symbolic links resolved, from which meshes of a URDF file (None: of a text) are read."""
    folders = [Path(folder).expanduser() for folder in package_dirs]
    if path is not None:
        home = path.expanduser().resolve().parent
        package = [folder for folder in (home, *home.parents) if (folder / "package.xml").is_file()]
        folders = [home, *package[:1], *folders]
    return list(dict.fromkeys(folder.resolve() for folder in folders))


def mesh_packages(names: Iterable[str], path: Path | None, package_dirs: Iterable[str | Path]) -> dict[str, Path]:
    """Return by name the folders of the ROS packages that mesh names (package://NAME/...) refer to, if they are found."""
    spoken = dict.fromkeys(
        name.partition("://")[2].partition("/")[0] for name in names if name.startswith("package://")
    )
    found = {package: find_package(package, path, package_dirs) for package in [*spoken][: CAPS.packages]}
    return {package: folder for package, folder in found.items() if folder}


def find_mesh(name: str, folders: Sequence[Path], packages: Mapping[str, Path] | None = None) -> Path:
    """Return the path, with symbolic links resolved, of a mesh named in a URDF (package://, model://, file:// or a path).

    It must lie in one of `folders` or `packages` (folders of ROS packages by name). Raises ModelError if it does not, or is no mesh
    file; its text, such as "is not there", completes a sentence about the mesh.
    """
    folders = [*folders, *(packages or {}).values()]
    scheme, separator, rest = name.partition("://")
    if not separator and name.startswith("file:/"):  # A file URL may have no host, as in file:/tmp/arm.stl.
        scheme, separator, rest = name.partition(":")
    if not name or "\0" in name:
        raise ModelError("has no usable file name")
    if separator and scheme not in ("package", "model", "file"):
        raise ModelError("is a network address, which is never opened")
    if separator and scheme != "file":
        package, _, inner = rest.partition("/")
        places = [os.path.join(folder, rest.lstrip("/")) for folder in folders]
        own = [(packages or {})[package]] if package in (packages or {}) else []
        places += [
            os.path.join(folder, inner.lstrip("/"))
            for folder in (*folders, *own)
            if folder.name == package or folder in own
        ]
    else:
        places = [os.path.join(folder, rest if separator else name) for folder in folders]
    places += [unquote(place) for place in places if "%" in place]  # In a URL a space is written as %20.
    inside = [place for place in places if lies_in(Path(os.path.normpath(place)), folders)]
    if not inside:
        raise ModelError(
            "lies outside the allowed folders and is not read" if folders else "cannot be found without a folder"
        )
    try:
        real = [Path(place).resolve() for place in inside if os.path.isfile(place)]
        found = next((path for path in real if lies_in(path, folders)), None)
        size = found.stat().st_size if found else 0
    except (OSError, ValueError, RuntimeError):  # A circular link or a name that is too long raises one of these.
        raise ModelError("cannot be read") from None
    if found is None:
        raise ModelError("is a link that leads outside the allowed folders" if real else "is not there")
    if found.suffix.lower() not in FORMATS:
        raise ModelError(f"is not a supported format ({', '.join(FORMATS)})")
    if size > CAPS.bytes:
        raise ModelError(f"is larger than {CAPS.bytes // 1_000_000} MB")
    return found


def lies_in(path: Path, folders: Sequence[Path]) -> bool:
    """Return whether a path lies below one of the folders (all with symbolic links resolved)."""
    return any(path.is_relative_to(folder) for folder in folders)


def read_meshes(paths: Iterable[Path], kind: str, folders: Sequence[Path]) -> dict[Path, Mesh]:
    """Read mesh files in another process, for collisions ('surface': one piece each) or drawing ('look': one for each material).

    Returns a Mesh by path; one that cannot be read has the reason in `refused`. Files that a mesh refers to are read only from
    `folders`.
    """
    found: dict[Path, Mesh] = {}
    left: dict[Path, tuple] = {}
    for path in dict.fromkeys(paths):
        try:
            about = path.stat()
        except OSError:
            found[path] = Mesh(refused="is not there")
            continue
        key = kind, path, about.st_size, about.st_mtime_ns, tuple(folders)
        if key in _read:
            found[path] = _read[key]
        elif len(left) < CAPS.meshes:
            left[path] = key
        else:
            found[path] = Mesh(refused=f"is not read: the robot has more than {CAPS.meshes:,} meshes")
    for _ in range(CAPS.crashes):
        for path, mesh in (_run([*left], kind, folders) if left else {}).items():
            if len(_read) >= CAPS.kept:
                del _read[next(iter(_read))]
            found[path] = _read[left.pop(path)] = mesh
    return found | dict.fromkeys(left, Mesh(refused="is not read: too many others crashed their reader"))


def _run(paths: Sequence[Path], kind: str, folders: Sequence[Path]) -> dict[Path, Mesh]:
    """Read files in one process until all are read or one crashes it; return the files done, including the one that crashed it."""
    seconds = [SECONDS + CAPS.seconds_per_mb * path.stat().st_size / 1e6 for path in paths]
    with tempfile.TemporaryDirectory(prefix="ik_mesh_") as out:
        job = {
            "kind": kind,
            "out": out,
            "folders": [str(folder) for folder in folders],
            "files": [(str(path), allowed) for path, allowed in zip(paths, seconds, strict=True)],
            "bytes": CAPS.bytes,
            "triangles": CAPS.triangles,
            "memory": CAPS.memory,
        }
        # The numerical libraries of the reading process need one thread only, and every further one takes memory.
        threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        # The limit on wall time allows for a busy machine or a slow disk.
        lines, ended = run(WORKER, "reads meshes", job, 6.0 * math.fsum(seconds), **threads)
        end = "crashed its reader, or took too much time or memory" if ended else "took too much time"
        if not lines or not lines[0].startswith("begin"):
            raise ModelError(
                "the process that reads meshes ended before it read any; is this Python installation intact?"
            )
        rows = [json.loads(line) for line in lines if line.startswith("{") and line.endswith("}")]
        meshes = {}
        for row in rows:
            pieces = () if row["refused"] else _pieces(Path(out) / f"{row['file']}.npz")
            refused = f"cannot be read: {row['refused']}" if row["refused"] else ""
            meshes[paths[row["file"]]] = Mesh(pieces, refused, tuple(row["notes"]))
        if len(rows) < len(paths):
            meshes[paths[len(rows)]] = Mesh(refused=end)
        return meshes


def _pieces(file: Path) -> tuple[MeshPiece, ...]:
    with np.load(file) as arrays:
        pieces = []
        for k in range(len(arrays.files) // 3):
            vertices, faces, color = (arrays[f"{letter}{k}"] for letter in "vfc")
            pieces.append(MeshPiece(vertices, faces, tuple(color.tolist()) or None))
    return tuple(pieces)
