"""Finds robot descriptions by name: the robots we ship, files, URDF text, example-robot-data and robot_descriptions."""

import contextlib
import functools
import importlib
import importlib.metadata
import importlib.util
import io
import os
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import MissingExtra, ModelError, RobotNotFound, near_match
from ..text import first_few, in_shell
from .formats.urdf import is_text
from .packages import MANIFESTS

DATA_PACKAGE = "example-robot-data"
DESCRIBED = "robot_descriptions:"  # Robot names that begin with this are of the package robot_descriptions.
MENAGERIE = "mujoco-menagerie:"  # Robot names that begin with this are folders of the MuJoCo Menagerie.
# The environment variable with the folder of a copy of the MuJoCo Menagerie; the package mujoco-menagerie reads it too.
MENAGERIE_ROOT = "MENAGERIE_ROOT"


@dataclass(frozen=True)
class RobotEntry:
    """The library's entry for a robot name: the description to read, its tips and its home.

    `source` is what to read: `path`, or the URDF text if path is None. `tips` are all the known tips. `home` (n,) [rad or m] is in
    the order of the joints from base to tip (for several tips of all their paths, in the order of `tips`), or None. ROS packages
    are searched in `package_dirs`. `paper`, `table` and `description` say where the dimensions come from. `sample` is a pose that
    the paper computes: the columns n, o, a and p [m] of its matrix, as printed, and under `from` the place in the paper.
    `xacro_args` are values of a xacro file's arguments.
    """

    name: str
    source: Path | str
    path: Path | None = None
    base: str | None = None
    tips: tuple[str, ...] = ()
    home: tuple[float, ...] | None = None
    package_dirs: tuple[Path, ...] = ()
    description: str = ""
    paper: str = ""
    table: str = ""
    dh_file: Path | None = None
    sample: Mapping[str, Any] | None = None
    xacro_args: Mapping[str, str] = field(default_factory=dict)

    @property
    def tip(self) -> str | None:
        """The name of the tip if exactly one is known, else None."""
        return self.tips[0] if len(self.tips) == 1 else None


# The fixed-base arms of the package example-robot-data 6 by name: the URDF file, below robots/, and the tips.
DATA_ROBOTS: dict[str, tuple[str, tuple[str, ...]]] = {
    "panda": ("panda_description/urdf/panda.urdf", ("panda_hand_tcp",)),
    "ur3": ("ur_description/urdf/ur3_robot.urdf", ("tool0",)),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", ("tool0",)),
    "ur10": ("ur_description/urdf/ur10_robot.urdf", ("tool0",)),
    "ur3_limited": ("ur_description/urdf/ur3_joint_limited_robot.urdf", ("tool0",)),
    "ur5_limited": ("ur_description/urdf/ur5_joint_limited_robot.urdf", ("tool0",)),
    "ur10_limited": ("ur_description/urdf/ur10_joint_limited_robot.urdf", ("tool0",)),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", ("link_eef",)),
    "kinova": ("kinova_description/robots/kinova.urdf", ("j2s6s200_end_effector",)),
    "z1": ("z1_description/urdf/z1.urdf", ("gripperStator",)),
    "so100": ("so_arm_description/urdf/so100.urdf", ("gripper",)),
    "so101": ("so_arm_description/urdf/so101.urdf", ("gripper_frame_link",)),
    "tiago": ("tiago_description/robots/tiago.urdf", ("hand_tool_link",)),
    "tiago_no_hand": ("tiago_description/robots/tiago_no_hand.urdf", ("arm_tool_link",)),
    "tiago_dual": ("tiago_description/robots/tiago_dual.urdf", ("hand_left_tool_link", "hand_right_tool_link")),
    "tiago_pro": ("tiago_pro_description/robots/tiago_pro.urdf", ("gripper_left_base_link", "gripper_right_base_link")),
    "baxter": ("baxter_description/urdf/baxter.urdf", ("left_gripper", "right_gripper")),
    "pr2": ("pr2_description/urdf/pr2.urdf", ("l_gripper_tool_frame", "r_gripper_tool_frame")),
    "talos": ("talos_data/robots/talos_reduced.urdf", ("gripper_left_base_link", "gripper_right_base_link")),
    "talos_arm": ("talos_data/robots/talos_left_arm.urdf", ("gripper_left_base_link",)),
    "centauro": ("centauro_description/urdf/centauro.urdf", ("arm1_8", "arm2_8")),
    "two_dofs": ("asr_twodof_description/urdf/TwoDofs.urdf", ("Tip",)),
    "double_pendulum": ("double_pendulum_description/urdf/double_pendulum.urdf", ("link2",)),
    "finger_edu": ("finger_edu_description/robots/finger_edu.urdf", ("finger_tip_link",)),
}


def urdf_folder() -> Path:
    """Return the folder with the descriptions of the shipped robots: in the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parent.parent
    for folder in (package / "urdf", package.parent / "urdf"):
        if (folder / "robots.toml").is_file():
            return folder
    raise RobotNotFound(f"the shipped robots are missing from {package / 'urdf'}; reinstall ik_toolkit")


@functools.cache
def shipped_robots() -> dict[str, RobotEntry]:
    """Return the entries of the robots shipped with the toolkit by name, in the order of robots.toml."""
    folder = urdf_folder()
    rows = tomllib.loads((folder / "robots.toml").read_text(encoding="utf-8"))
    entries = {}
    for name, row in rows.items():
        path = folder / row["file"]
        entries[name] = RobotEntry(
            name=name,
            source=path,
            path=path,
            base=row["base"],
            tips=tuple(row["tips"]),
            home=tuple(row["home"]),
            description=row["description"],
            paper=row["paper"],
            table=row["table"],
            dh_file=folder / row["dh"] if "dh" in row else None,
            sample=row.get("sample"),
        )
    return entries


def _data_root() -> Path | None:
    try:
        distribution = importlib.metadata.distribution(DATA_PACKAGE)
    except importlib.metadata.PackageNotFoundError:
        return None
    root = Path(str(distribution.locate_file("cmeel.prefix/share/example-robot-data")))
    return root if root.is_dir() else None


def example_robot_data(name: str) -> tuple[Path, tuple[Path, ...]]:
    """Return the URDF path and the package folders of a robot of the package example-robot-data (version 6, which has data only).

    Raises RobotNotFound for an unknown name, which names a similar one and all others, and MissingExtra without the package.
    """
    if name not in DATA_ROBOTS and name not in data_files():
        raise RobotNotFound(f"{DATA_PACKAGE} has no arm '{name}'.{near_match(name, DATA_ROBOTS)}")
    root = _data_root()
    if root is None:
        raise MissingExtra(DATA_PACKAGE, "robots")
    path = data_files().get(name) or root / "robots" / DATA_ROBOTS[name][0]
    if not path.is_file():
        raise RobotNotFound(f"the installed {DATA_PACKAGE} has no file {path}; version 6 is expected")
    return path, (root.parent,)


@functools.cache
def data_files() -> dict[str, Path]:
    """Return by name the URDF files of the package example-robot-data that are not among the arms with a known tip (DATA_ROBOTS).

    The name is that of the file; where two files have the same name, it is preceded by that of the folder.
    """
    root = _data_root()
    if root is None:
        return {}
    known = {file for file, _ in DATA_ROBOTS.values()}
    found: dict[str, Path] = {}
    for path in sorted((root / "robots").glob("*/**/*.urdf")):
        inside = path.relative_to(root / "robots")
        name = path.stem
        if name in found or name in DATA_ROBOTS:
            name = f"{inside.parts[0].removesuffix('_description').removesuffix('_data')}_{name}"
        if inside.as_posix() not in known:
            found[name] = path
    return found


def list_robots(everything: bool = False) -> list[RobotEntry]:
    """Return the library entries of the shipped robots and, if installed, of the arms (or all files) of example-robot-data."""
    data = [find(name) for name in (*DATA_ROBOTS, *(data_files() if everything else ()))] if _data_root() else []
    return [*shipped_robots().values(), *data]


@contextlib.contextmanager
def _fetching(name: str, package: str, command: str) -> Iterator[None]:
    """Hide the progress that a download in the block prints. Raises RobotNotFound with a command to run if it fails."""
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            yield
    except Exception as error:  # Importing a description downloads it by git, which can raise an exception of any type.
        last = (str(error).strip().splitlines() or [type(error).__name__])[-1]
        said = last.strip().removeprefix("stderr: ").strip("'")[:200]
        raise RobotNotFound(
            f"'{name}' is not in the cache of {package}, and it could not be fetched ({said}); with a network, run: {command}"
        ) from None


def _described(name: str) -> RobotEntry:
    """Find a name of the robot_descriptions package in its cache. Raises RobotNotFound, MissingExtra, ModelError."""
    if importlib.util.find_spec("robot_descriptions") is None:
        raise MissingExtra("robot_descriptions", "robots")
    from robot_descriptions import DESCRIPTIONS

    if name not in DESCRIPTIONS:
        near = [known for known in DESCRIPTIONS if known.startswith(name)]
        raise RobotNotFound(f"robot_descriptions has no '{name}'.{near_match(name, near or DESCRIPTIONS)}")
    with _fetching(name, "robot_descriptions", f"python -m robot_descriptions pull {name}"):
        module = importlib.import_module(f"robot_descriptions.{name}")
    path = Path(
        next(getattr(module, key) for key in ("URDF_PATH", "XACRO_PATH", "MJCF_PATH") if getattr(module, key, None))
    )
    folders = (Path(module.PACKAGE_PATH), Path(module.REPOSITORY_PATH))
    arguments = {key: str(value) for key, value in getattr(module, "XACRO_ARGS", {}).items()}
    described = f"robot_descriptions: {name}"
    return RobotEntry(name, path, path, package_dirs=folders, description=described, xacro_args=arguments)


def _menagerie(name: str) -> Path:
    """Find a model file of the MuJoCo Menagerie, in a copy on disk or in its package's cache. Raises RobotNotFound."""
    advice = "pip install mujoco-menagerie, or set MENAGERIE_ROOT to a copy of the repository"
    root = os.environ.get(MENAGERIE_ROOT)
    if root:
        folders = sorted(path.name for path in Path(root).glob("*/") if any(path.glob("*.xml")))
        if name not in folders:
            raise RobotNotFound(f"'{root}' has no robot '{name[:200]}'.{near_match(name, folders)}")
        return Path(root) / name
    try:
        package = importlib.import_module("mujoco_menagerie")
    except ImportError:
        raise RobotNotFound(f"MuJoCo's menagerie was not found; {advice}") from None
    names = package.names()
    if name not in names:
        raise RobotNotFound(f"MuJoCo's menagerie has no '{name[:200]}'.{near_match(name, names)}")
    command = f"python -c 'import mujoco_menagerie as m; m.prefetch([\"{name}\"])'; or {advice}"
    with _fetching(name, "mujoco-menagerie", command):
        return Path(package.get(name).xml(package.get(name).default_model))


def _only_model(source: str | Path) -> Path | None:
    """Return the only description in a folder, or the one named like the folder.

    Scenes, which put a robot on a floor, do not count.
    """
    try:
        folder = Path(source).expanduser()
        if not str(source) or not folder.is_dir():
            return None
        files = [path for kind in ("*.urdf", "*.xml") for path in sorted(folder.glob(kind)) if path.is_file()]
    except (OSError, ValueError, RuntimeError):
        return None
    models = [path for path in files if not path.stem.startswith("scene") and path.name not in MANIFESTS]
    named = [path for path in models if path.stem == folder.resolve().name]
    if len(models) == 1 or named:
        return (named or models)[0].absolute()
    if models:
        names = first_few([path.name for path in models])
        raise RobotNotFound(f"'{str(source)[:200]}' is a folder with several descriptions; give one of them: {names}")
    return None


def find(source: str | Path) -> RobotEntry:
    """Return the entry for the name of a shipped robot, a file path (relative, absolute, ~), URDF text, or a data package's name.

    Raises RobotNotFound, which names a similar robot and all others, and MissingExtra if the package with the robot is missing.
    """
    if not isinstance(source, str | Path):
        given = type(source).__name__
        raise RobotNotFound(
            f"a robot must be a name, a path or URDF text, not {given}; ik.Robot(model) takes a pin.Model"
        )
    if is_text(source):
        return RobotEntry(name="URDF text", source=source)
    if isinstance(source, str):
        if source in shipped_robots():
            return shipped_robots()[source]
        if source.startswith(DESCRIBED):
            return _described(source.removeprefix(DESCRIBED))
        if source.startswith(MENAGERIE):
            source = _menagerie(source.removeprefix(MENAGERIE))
    path = _file(source) or _only_model(source)
    if path is not None and path.suffix.lower() == ".toml":
        raise ModelError(in_shell(f"'{path.name}' is a D-H table; `ik dh {path.name} -o OUT.urdf` makes a URDF of it"))
    if path is not None:
        return RobotEntry(name=path.stem, source=path, path=path, package_dirs=(path.parent,))
    name = str(source)
    if name in shipped_robots():  # A name given as a Path object was not looked up above, where only text is.
        return shipped_robots()[name]
    if name in DATA_ROBOTS or name in data_files():
        path, folders = example_robot_data(name)
        inside = path.relative_to(folders[0] / DATA_PACKAGE / "robots").as_posix()
        tips = DATA_ROBOTS[name][1] if name in DATA_ROBOTS else ()
        return RobotEntry(name, path, path, None, tips, None, folders, f"{DATA_PACKAGE}: {inside}")
    shown = name if len(name) <= 200 else f"{name[:200]}..."
    if name and Path(shown).is_dir():
        raise RobotNotFound(f"the folder '{shown}' contains no robot description")
    if name and Path(shown).exists():
        raise RobotNotFound(f"'{shown}' is not a regular file; in a shell - reads a description from standard input")
    if "/" in name or "\\" in name or name.lower().endswith((".urdf", ".xml", ".xacro")):
        raise RobotNotFound(f"there is no file '{shown}'")
    raise RobotNotFound(
        f"there is no robot and no file '{shown}'.{near_match(shown, [*shipped_robots(), *DATA_ROBOTS, *data_files()])}"
    )


def _file(source: str | Path) -> Path | None:
    """Return the absolute path of a source that is a file, otherwise None (also for impossible file names)."""
    try:
        path = Path(source).expanduser()
        return path.absolute() if str(source) and path.is_file() else None
    # An error here means that the text is no path: it is too long, has a NUL character, or has ~ where there is no home folder.
    except (OSError, ValueError, RuntimeError):
        return None
