"""Mesh files: where they may be, and their triangles, read in a subprocess.

One rule for `ik check`, pictures, panel and collisions: a mesh is read only from the URDF's folder, the ROS package the URDF is
in (the nearest folder above with a package.xml), `package_dirs` and the packages it names. Symbolic links that lead outside are
rejected; the same holds for files a mesh refers to. Mesh readers crash on broken files, so they run in a subprocess with limits.
"""

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...errors import ModelError
from ..packages import find_package

FORMATS = (".stl", ".dae", ".obj", ".ply", ".off", ".glb", ".gltf")
MAX_MESH_BYTES = 100_000_000  # the largest file of example-robot-data has 29 MB
MAX_TRIANGLES = 2_000_000  # per file; that one has 351,394
MAX_MESHES = 1_000  # different files per robot
MAX_PACKAGES = 50  # different packages per robot
MEMORY = 2_000_000_000  # bytes for the reading process; that file takes 0.5 GB
SECONDS, SECONDS_PER_MB = 4.0, 2.0  # processor time per file; that file takes 1.6 s in all
MAX_CRASHES = 5  # reading processes that may crash per robot
KEPT = 256  # files whose triangles are cached
WORKER = Path(__file__).with_name("mesh_worker.py")


class MeshPiece(NamedTuple):
    """Triangles of one material: vertices (N, 3) [units of the file], faces (M, 3), color (3,) in 0..1 or None."""

    vertices: np.ndarray
    faces: np.ndarray
    color: tuple[float, float, float] | None


@dataclass(frozen=True, eq=False)
class Mesh:
    """Contents of a mesh file, or why it was not read (refused), and what was left out (notes)."""

    pieces: tuple[MeshPiece, ...] = ()
    refused: str = ""
    notes: tuple[str, ...] = ()


_read: dict[tuple, Mesh] = {}  # by kind, path, size and modification time


def mesh_folders(path: Path | None, package_dirs: Iterable[str | Path]) -> list[Path]:
    """Folders from which meshes of a URDF file (None: of a text) are read, symbolic links resolved."""
    folders = [Path(folder).expanduser() for folder in package_dirs]
    if path is not None:
        home = path.expanduser().resolve().parent
        package = [folder for folder in (home, *home.parents) if (folder / "package.xml").is_file()]
        folders = [home, *package[:1], *folders]
    return list(dict.fromkeys(folder.resolve() for folder in folders))


def mesh_packages(names: Iterable[str], path: Path | None, package_dirs: Iterable[str | Path]) -> dict[str, Path]:
    """Folders of the packages that mesh names refer to (package://NAME/...), as far as found."""
    spoken = dict.fromkeys(
        name.partition("://")[2].partition("/")[0] for name in names if name.startswith("package://")
    )
    found = {package: find_package(package, path, package_dirs) for package in [*spoken][:MAX_PACKAGES]}
    return {package: folder for package, folder in found.items() if folder}


def find_mesh(name: str, folders: Sequence[Path], packages: Mapping[str, Path] | None = None) -> Path:
    """Real path of a mesh named in a URDF (package://, model://, file:// or a path); ModelError whose text ends a sentence.

    folders: from `mesh_folders`; packages: from `mesh_packages`.
    """
    folders = [*folders, *(packages or {}).values()]
    scheme, separator, rest = name.partition("://")
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
    inside = [place for place in places if lies_in(Path(os.path.normpath(place)), folders)]
    if not inside:
        raise ModelError(
            "lies outside the allowed folders and is not read" if folders else "cannot be found without a folder"
        )
    try:
        real = [Path(place).resolve() for place in inside if os.path.isfile(place)]
        found = next((path for path in real if lies_in(path, folders)), None)
        size = found.stat().st_size if found else 0
    except (OSError, ValueError, RuntimeError):  # circular links, too long a name
        raise ModelError("cannot be read") from None
    if found is None:
        raise ModelError("is a link that leads outside the allowed folders" if real else "is not there")
    if found.suffix.lower() not in FORMATS:
        raise ModelError(f"is not a supported format ({', '.join(FORMATS)})")
    if size > MAX_MESH_BYTES:
        raise ModelError(f"is larger than {MAX_MESH_BYTES // 1_000_000} MB")
    return found


def lies_in(path: Path, folders: Sequence[Path]) -> bool:
    """Whether a real path lies in one of the folders that may be read."""
    return any(path.is_relative_to(folder) for folder in folders)


def read_meshes(paths: Iterable[Path], kind: str, folders: Sequence[Path]) -> dict[Path, Mesh]:
    """Triangles of files (paths of `find_mesh`) for 'surface' (one piece per file) or 'look' (one piece per material).

    A mesh that cannot be read has `refused`, the end of a sentence; files they refer to are read only from `folders`.
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
        elif len(left) < MAX_MESHES:
            left[path] = key
        else:
            found[path] = Mesh(refused=f"is not read: the robot has more than {MAX_MESHES:,} meshes")
    for _ in range(MAX_CRASHES):
        for path, mesh in (_run([*left], kind, folders) if left else {}).items():
            if len(_read) >= KEPT:
                del _read[next(iter(_read))]
            found[path] = _read[left.pop(path)] = mesh
    return found | dict.fromkeys(left, Mesh(refused="is not read: too many others crashed their reader"))


def _run(paths: Sequence[Path], kind: str, folders: Sequence[Path]) -> dict[Path, Mesh]:
    """Read files in one process until all are read or one crashes it; returns the files done, including that one."""
    seconds = [SECONDS + SECONDS_PER_MB * path.stat().st_size / 1e6 for path in paths]
    with tempfile.TemporaryDirectory(prefix="ik_mesh_") as out:
        job = {
            "kind": kind,
            "out": out,
            "folders": [str(folder) for folder in folders],
            "files": [(str(path), allowed) for path, allowed in zip(paths, seconds, strict=True)],
            "bytes": MAX_MESH_BYTES,
            "triangles": MAX_TRIANGLES,
            "memory": MEMORY,
        }
        # Every thread takes memory.
        threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        try:
            done = subprocess.run(
                [sys.executable, "-P", str(WORKER)],
                input=json.dumps(job),
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                timeout=6.0 * math.fsum(seconds),  # wall time: allows for a busy machine or a slow disk
                env={**os.environ, **threads},
                check=False,
            )
            said, end = done.stdout, "crashed its reader, or took too much time or memory"
        except subprocess.TimeoutExpired as error:
            said, end = error.stdout or "", "took too much time"
            said = said.decode() if isinstance(said, bytes) else said
        except OSError as error:
            raise ModelError(f"the process that reads meshes cannot be started: {error.strerror}") from None
        rows = [json.loads(line) for line in said.splitlines() if line.startswith("{") and line.endswith("}")]
        if not said.startswith("begin"):
            raise ModelError(
                "the process that reads meshes ended before it read any; is this Python installation intact?"
            )
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
