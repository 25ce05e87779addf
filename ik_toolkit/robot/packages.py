"""Finds a ROS package: next to the file, in given folders, on ROS's search paths, and in installed data packages."""

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path

MANIFESTS = ("package.xml", "manifest.xml")  # A folder with one of these files is a ROS package.
NAME = re.compile(r"[A-Za-z0-9_.-]{1,255}")
LEVELS = 8  # Packages are searched for in this many parent folders of the file that names them, and next to those.
# Packages are searched for down to INSIDE levels below a folder, with at most FOLDERS folders on each level, to bound the time.
INSIDE, FOLDERS = 3, 2_000
# Python packages that contain ROS packages, with the folders in which these are.
DATA = {
    "example-robot-data": ("cmeel.prefix/share/example-robot-data/robots", "cmeel.prefix/share"),
    "rtb-data": ("rtbdata/xacro",),
}


def find_package(
    name: str,
    start: Path | None = None,
    package_dirs: Iterable[str | Path] = (),
    environment: Mapping[str, str] = os.environ,
) -> Path | None:
    """Return the folder of the ROS package `name`, with symbolic links resolved, or None if it is not found.

    The name of a package is that in its package.xml, or else that of its folder. The search goes through package_dirs (packages, or
    folders that contain some), the parent folders of the file `start` that names the package and the folders next to them, the
    variables ROS_PACKAGE_PATH and AMENT_PREFIX_PATH, and data packages installed by pip.
    """
    if not NAME.fullmatch(name) or set(name) == {"."}:
        return None
    for folder, trusted in _places(name, start, package_dirs, environment):
        if folder.is_dir() and (trusted or any((folder / manifest).is_file() for manifest in MANIFESTS)):
            return folder.resolve()
    return None


def _places(
    name: str, start: Path | None, package_dirs: Iterable[str | Path], environment: Mapping[str, str]
) -> Iterator[tuple[Path, bool]]:
    """Yield candidate folders, best first, and whether each counts as a package without a manifest."""
    given = [Path(folder).expanduser() for folder in package_dirs]
    for folder in given:
        # A symbolic link that leads out of the folder counts as a package only if it has one of MANIFESTS.
        yield folder / name, (folder / name).resolve().is_relative_to(folder.resolve())
        if folder.name == name:
            yield folder, True
    for folder in given:
        yield from ((found, True) for found in _below(folder, INSIDE) if _named(found, name))
    above = [] if start is None else [*start.expanduser().resolve().parents][:LEVELS]
    for folder in above:
        if folder.name == name or _named(folder, name):
            yield folder, folder.name != name
        yield folder / name, False
    for folder in above:
        yield from ((found, True) for found in _below(folder, 1) if _named(found, name))
    for variable, inner in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        for word in filter(None, environment.get(variable, "").split(os.pathsep)):
            root = Path(word) / inner
            yield root / name, False
            yield from ((found, False) for found in sorted(root.glob(f"*/{name}")))
            yield from ((found, True) for found in _below(root, INSIDE) if _named(found, name))
    import importlib.metadata  # Importing this takes longer than a search, and most searches end before.

    for distribution, folders in DATA.items():
        try:
            found = importlib.metadata.distribution(distribution)
        except importlib.metadata.PackageNotFoundError:
            continue
        yield from ((Path(str(found.locate_file(folder))) / name, True) for folder in folders)


def _below(folder: Path, depth: int) -> Iterator[Path]:
    """Yield a folder and its subfolders to a depth, upper ones first; hidden folders and those inside a package are left out."""
    level = [folder]
    for k in range(depth + 1):
        yield from level
        inner = (one for one in level if k < depth and (one == folder or not (one / MANIFESTS[0]).is_file()))
        level = [found for one in inner for found in _folders(one)][:FOLDERS]


def _folders(folder: Path) -> list[Path]:
    """Return the folders in a folder, by name."""
    try:
        with os.scandir(folder) as found:
            names = sorted(one.name for one in islice(found, FOLDERS) if one.is_dir() and not one.name.startswith("."))
    except OSError:
        return []
    return [folder / name for name in names]


def _named(folder: Path, name: str) -> bool:
    """Return whether a folder's manifest gives it this name."""
    try:
        with (folder / MANIFESTS[0]).open(encoding="utf-8", errors="replace") as file:
            return re.search(rf"<name>\s*{re.escape(name)}\s*</name>", file.read(65_536)) is not None
    except OSError:
        return False
