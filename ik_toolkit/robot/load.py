"""Reads anything a user may name as a robot into its URDF text and Pinocchio model."""

import logging
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..errors import InvalidOption, ModelError, RobotNotFound
from ..files import from_home
from ..text import figure
from .base import carried
from .formats.description import Urdf
from .formats.mjcf import read_mjcf
from .formats.srdf import passive_joints, srdf_of
from .formats.urdf import HasMacros, IsMjcf, is_text, safe_read
from .formats.urdf_check import require_loadable
from .formats.urdf_model import build_model
from .formats.xacro import expand, expanded, has_macros
from .library import RobotEntry, find
from .probe import find_path
from .tips import frame_id, guess_tip

LOG = logging.getLogger("ik_toolkit")


class Format(NamedTuple):
    """A description format: what messages call it, and how it is read.

    `read` takes the path (or the XML text), the folders of ROS packages and the values of xacro arguments. `xml` tells that the
    format is recognised by the contents of a file rather than by its suffix, `xacro_args` that it has such arguments.
    """

    name: str
    read: Callable[[str | Path, Sequence[Path], Mapping[str, Any]], Urdf]
    xml: bool = False
    xacro_args: bool = False


def _read_urdf(source: str | Path, *_: Any) -> Urdf:
    return Urdf(safe_read(source), made=False)


def _read_xacro(source: str | Path, folders: Sequence[Path], arguments: Mapping[str, Any]) -> Urdf:
    """Expand a xacro file; text with macros, which may need other files, is refused by `safe_read`."""
    return Urdf(safe_read(expand(source, folders, arguments) if isinstance(source, Path) else source))


FORMATS = {
    ".urdf": Format("a plain URDF", _read_urdf, xml=True),
    ".xacro": Format("xacro", _read_xacro, xml=True, xacro_args=True),
    ".mjcf": Format("MJCF", read_mjcf, xml=True),
}


def _format_of(entry: RobotEntry) -> Format:
    """Return the format of a description, by its suffix, or for XML by its contents. Raises ModelError."""
    suffix = entry.path.suffix if entry.path else ""
    if suffix in FORMATS and not FORMATS[suffix].xml:
        return FORMATS[suffix]
    try:
        text = safe_read(entry.source)
    except HasMacros:
        return FORMATS[".xacro"]
    except IsMjcf:
        return FORMATS[".mjcf"]
    # A macro call in a .xacro file must be expanded. In a .urdf file it is a leftover that is ignored.
    return FORMATS[".xacro" if suffix == ".xacro" and "<xacro:" in text else ".urdf"]


def urdf_of(
    entry: RobotEntry,
    package_dirs: Iterable[str | Path],
    xacro_args: Mapping[str, Any] | None = None,
    elsewhere: bool = False,
) -> Urdf:
    """Read the description of a library entry, of any format in FORMATS, as URDF. Raises what `Robot.load` raises.

    elsewhere: whether another file (the SRDF) uses the xacro arguments too, so that a format without them does not refuse them.
    """
    folders = tuple(dict.fromkeys((*folders_of(package_dirs), *entry.package_dirs)))
    form = _format_of(entry)
    if xacro_args and not (elsewhere or form.xacro_args):
        raise InvalidOption(f"xacro_args: only xacro files take them, and {entry.name} is {form.name}")
    read = form.read(entry.source, folders, {**entry.xacro_args, **(xacro_args or {})})
    return read._replace(package_dirs=folders)


def read_source(
    source: str | Path,
    package_dirs: Iterable[str | Path],
    xacro_args: Mapping[str, Any] | None = None,
    elsewhere: bool = False,
) -> tuple[RobotEntry, dict[str, Any]]:
    """Read a robot by name, path or text; return its library entry and a dict of arguments for `Robot`.

    The dict also has `own`: the configurations and collision pairs from the description itself (MJCF), as an Srdf. Raises what
    `Robot.load` raises.
    """
    entry = find(source)
    read = urdf_of(entry, package_dirs, xacro_args, elsewhere)
    notes = (*read.notes, *require_loadable(read.text, lines=not read.made))
    model = built_model(read.text, entry.name)
    name = entry.name if entry.path else model.name
    for note in notes:
        LOG.warning("%s: %s", entry.name, note)
    made = {"model": model, "name": name, "urdf": read.text, "path": entry.path, "package_dirs": read.package_dirs}
    return entry, made | {"notes": notes, "own": read.srdf, "constraints": read.constraints}


def built_model(text: str, name: str = "the URDF") -> pin.Model:
    """Build a Pinocchio model from URDF text; `name` is for messages. Raises ModelError."""
    try:
        return build_model(text)
    except Exception as error:
        raise ModelError(f"Pinocchio cannot read {name}: {str(error).strip().splitlines()[0]}") from None


def read_both(
    source: str | Path,
    package_dirs: Iterable[str | Path],
    xacro_args: Mapping[str, Any] | None,
    srdf: Any,
    group: str | None,
) -> tuple[RobotEntry, dict[str, Any]]:
    """Read a robot by name, path or text, and its SRDF; return its library entry and a dict of arguments for `Robot`.

    The arguments are those of `Robot.load`. Raises what `Robot.load` raises.
    """
    entry, made = read_source(source, package_dirs, xacro_args, has_macros(srdf))
    given = expanded(srdf, made["package_dirs"], xacro_args)
    return entry, made | {"srdf": srdf_of(given, made["model"], entry.path, made.pop("own"), group)}


def given_models(model: Any, collision: Any, visual: Any, urdf: str | None) -> tuple[pin.Model, Any, Any]:
    """Return a Pinocchio model, its collision and its visual shapes (or None), given one by one, as a tuple or as a RobotWrapper.

    If no model is given, it is built from the text `urdf`. Raises ModelError.
    """
    own: list[Any] = [None, None]
    if isinstance(model, pin.RobotWrapper):
        model, *own = model.model, model.collision_model, model.visual_model
    elif isinstance(model, tuple) and len(model) == 3:
        model, *own = model
    elif model is None and urdf is not None:
        model = built_model(urdf)
    if not isinstance(model, pin.Model):
        raise ModelError(
            f"a pin.Model is expected, not {type(model).__name__}; Robot.load reads names, paths and URDF text"
        )
    collision, visual = (
        given if given is not None else old for given, old in zip((collision, visual), own, strict=True)
    )
    for name, given in (("collision_model", collision), ("visual_model", visual)):
        if not isinstance(given, pin.GeometryModel | None):
            raise ModelError(f"{name} must be a pin.GeometryModel, not {type(given).__name__}")
    return model, collision, visual


def require_text_or_file(source: str | Path) -> None:
    """Raise RobotNotFound unless a source is XML text or the path of a file."""
    if not is_text(source) and not (isinstance(source, str | Path) and os.path.isfile(from_home(source))):
        raise RobotNotFound(f"there is no file '{str(source)[:200]}'; Robot.load takes names of robots")


def text_and_file(urdf: str | Path | None, path: Path | None) -> tuple[str | None, Path | None]:
    """Return the text and the file of a URDF, which is given as text or as a path. Raises RobotNotFound, ModelError."""
    if urdf is None or is_text(urdf):
        return urdf, path  # type: ignore[return-value]
    require_text_or_file(urdf)
    text = safe_read(urdf)
    require_loadable(text)
    return text, path or from_home(urdf)


def based(
    entry: RobotEntry, made: dict[str, Any], base: str | None, tip: str | None, on_base: Any, base_limits: Any
) -> dict[str, Any]:
    """Return the arguments `made` for `Robot` with those that say where it stands, as `Robot.load` takes them.

    The base is the given frame, or else that of the library entry (None: the root). If a floating or planar joint moves the tip and
    has no base_limits, that joint is held still, which a note says, and the link that it moves is the base.
    """
    made = made | {"base": base, "on_base": on_base, "base_limits": base_limits}
    if base is not None or on_base is not None:
        return made
    tip = tip or next(iter(entry.tips or guess_tip(made["model"]).tips), None)
    held = carried(made["model"], tip) if base_limits is None and tip else None
    if held is None:
        return made | {"base": entry.base}
    note = "joint '{}' is held still and poses are given in '{}'; base_limits= lets it move".format(*held)
    LOG.warning("%s: %s", entry.name, note)
    return made | {"base": entry.base or held[1], "notes": (*made["notes"], note)}


def library_home(entry: RobotEntry, made: Mapping[str, Any]) -> dict[str, float]:
    """Return the home of a library robot [rad or m] by joint, without joints that the SRDF holds; empty if it has none."""
    if entry.home is None:
        return {}
    model = made["model"]
    base, *tips = (frame_id(model, name, entry.name) for name in (entry.base, *entry.tips))
    joints = dict.fromkeys(model.names[j] for tip in tips for j in find_path(model, base, tip, set()).leaders)
    held = [passive_joints(made["srdf"], model, base, tip, {}) for tip in tips]
    home = zip(joints, entry.home, strict=True)
    return {joint: value for joint, value in home if not any(joint in joints for joints in held)}


def folders_of(given: Iterable[str | Path]) -> list[Path]:
    """Return the option package_dirs, a list of folders or a single one, as a list of paths.

    Raises InvalidOption if one of them does not exist.
    """
    try:
        folders = [from_home(folder) for folder in ([given] if isinstance(given, str | Path) else given)]
    except TypeError:
        raise InvalidOption(f"package_dirs must be a list of folders, not {given!r:.60}") from None
    for folder in folders:
        if not os.path.isdir(folder):
            raise InvalidOption(f"package_dirs: there is no folder '{folder!s:.200}'")
    return folders


def doubted_size(model: pin.Model, joints: Sequence[int], tip: int, strokes: np.ndarray) -> list[str]:
    """Return a note if a description seems to be in millimetres because its links are too light for their length; else nothing.

    Cranes and concrete pumps over 50 m long weigh hundreds of kilograms per metre; a table-top arm described in millimetres would
    weigh grams per metre.

    Args:
        model: The Pinocchio model of the robot.
        joints: Ids of the joints from base to tip. The distance from base to first joint does not count, as the base may be a map.
        tip: Id of the tip's frame.
        strokes: (2, k) Lower and upper limits [m] of the prismatic joints, without those of a moving base.

    Returns:
        A list with the note, or an empty one.
    """
    places = [model.jointPlacements[j] for j in joints[1:]] + [model.frames[tip].placement]
    # A stroke of kilometres means "unlimited", as for a base that drives, so it is not counted as a length.
    travel = np.where(np.abs(strokes) < 1e5, np.abs(strokes), 0.0).max(axis=0).sum()
    long = sum(float(np.linalg.norm(place.translation)) for place in places) + float(travel)
    mass = sum(inertia.mass for inertia in model.inertias)
    # Only links over 50 m long and under 100 kg per metre seem to be in millimetres.
    if not (long > 50.0 and mass < 100.0 * long):
        return []
    weight = f"weigh {figure(mass)} kg" if mass else "have no mass"
    return [
        f"the links are {figure(long, 4)} m long and {weight}: were millimetres meant? Lengths of a description are in metres"
    ]
