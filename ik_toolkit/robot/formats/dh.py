"""Reads Denavit-Hartenberg tables from TOML or CSV, computes their forward kinematics and writes them as URDF.

Classic rows (Denavit, Hartenberg 1955) are T_i = Rz(theta) Tz(d) Tx(a) Rx(alpha). Modified rows (Craig 1986) are T_i =
Rx(alpha) Tx(a) Rz(theta) Tz(d), with a and alpha of the row itself. A revolute joint adds q to theta, a prismatic joint
adds q to d. The pose of the tool is T_base_tool = base T_1 ... T_n tool.
"""

import csv
import io
import itertools
import math
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InvalidConfiguration, ModelError, near_match
from ...files import from_home, why_unread
from ...text import decimal
from ..rotation import rpy_matrix
from .urdf_write import add_bar, add_gripper, add_joint, add_link, add_shape, new_robot, shift, to_text

KINDS = ("revolute", "prismatic", "continuous")
COLUMNS = ("name", "type", "theta", "d", "a", "alpha", "lower", "upper", "velocity", "effort")
SETTINGS = ("name", "convention", "angles", "lengths", "base", "tool", "joint")
MAX_ROWS = 1000  # A table with more joints is refused; a URDF may have as many.
MAX_BYTES = 1_000_000  # A larger file of a table [bytes] is refused.


@dataclass(frozen=True)
class DHRow:
    """One joint of a table of Denavit-Hartenberg (D-H) parameters.

    The angles theta and alpha are in rad, the lengths d and a in m, the limits lower and upper in rad or m, velocity in
    rad/s or m/s, effort in Nm or N.
    """

    name: str
    type: str = "revolute"
    theta: float = 0.0
    d: float = 0.0
    a: float = 0.0
    alpha: float = 0.0
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = 1.0
    effort: float = 1000.0


@dataclass(frozen=True)
class DHTable:
    """A table of Denavit-Hartenberg (D-H) parameters in metres and radians.

    `convention` is 'classic' or 'modified'. `base` (4, 4) is the pose of the first frame in the base, `tool` (4, 4) that of the
    tool in the last frame.
    """

    name: str
    convention: str
    rows: tuple[DHRow, ...]
    base: np.ndarray
    tool: np.ndarray

    def to_dict(self) -> dict[str, Any]:
        """Return the table as a dict of numbers, strings and lists, as JSON can store it."""
        columns = ("name", "type", "theta", "d", "a", "alpha")
        rows = [{name: getattr(row, name) for name in columns} for row in self.rows]
        return {"convention": self.convention, "rows": rows, "base": self.base.tolist(), "tool": self.tool.tolist()}


def dh_fk(table: DHTable, q: Sequence[float]) -> np.ndarray:
    """Compute the pose of the tool, T_base_tool (4x4) [m], of a D-H table at joint values q (n,) [rad or m]."""
    if len(q) != len(table.rows):
        raise InvalidConfiguration(f"D-H table '{table.name}' has {len(table.rows)} joints; q has {len(q)} values")
    T = table.base.copy()
    for row, value in zip(table.rows, q, strict=True):
        slides = row.type == "prismatic"
        theta, d = row.theta + (0.0 if slides else value), row.d + (value if slides else 0.0)
        about_z, about_x = _screw(2, theta, d), _screw(0, row.alpha, row.a)
        T = T @ about_z @ about_x if table.convention == "classic" else T @ about_x @ about_z
    return T @ table.tool


def joint_origins(table: DHTable) -> list[np.ndarray]:
    """Return the constant transforms (4, 4) [m] of a D-H table: one before each joint, which moves on z, and one to the tool."""
    origins, before = [], table.base
    for row in table.rows:
        about_z, about_x = _screw(2, row.theta, row.d), _screw(0, row.alpha, row.a)
        if table.convention == "classic":
            origins.append(before)
            before = about_z @ about_x
        else:
            origins.append(before @ about_x @ about_z)
            before = np.eye(4)
    return [*origins, before @ table.tool]


def _screw(axis: int, angle: float, distance: float) -> np.ndarray:
    """Rotate about a coordinate axis [rad] and move along it [m]; the 4x4 is exact at multiples of 90 degrees."""
    c, s = math.cos(angle), math.sin(angle)
    c, s = (0.0 if abs(c) < 1e-15 else c), (0.0 if abs(s) < 1e-15 else s)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    T = np.eye(4)
    T[i, i] = T[j, j] = c
    T[i, j], T[j, i] = -s, s
    T[axis, 3] = distance
    return T


# ---------------------------------------------------------------------------------------------------------- reading
def read_dh_table(path: str | Path) -> DHTable:
    """Read a D-H table from a `.toml` or `.csv` file.

    A TOML file has name, convention, angles ('deg' or 'rad'), lengths ('m' or 'mm'), optionally base and tool (`{xyz,
    rpy}` in those units), and one [[joint]] per row with any of name, type, theta, d, a, alpha, lower, upper, velocity,
    effort. Limits are required unless the joint is continuous. A CSV file has the settings as lines `# convention =
    classic` (base_xyz, base_rpy, tool_xyz and tool_rpy as three numbers), a header of column names and one line per
    joint. Raises ModelError, which names the row and the column.
    """
    path = from_home(path)
    if path.suffix.lower() not in (".toml", ".csv"):
        raise ModelError(f"a D-H table is a .toml or .csv file, not '{path.name}'")
    try:
        raw = path.read_bytes()
    except (OSError, ValueError) as error:  # A path that contains a NUL character raises ValueError.
        raise ModelError(f"cannot read the D-H table {str(path)[:200]!r}: {why_unread(error)}") from None
    if len(raw) > MAX_BYTES:
        raise ModelError(f"the D-H table '{path.name}' is larger than {MAX_BYTES // 1_000_000} MB")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ModelError(f"the D-H table '{path.name}' is not UTF-8 text") from None
    if path.suffix.lower() == ".csv":
        return dh_table({"name": path.stem, **_csv_settings(text)})
    try:
        settings = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # An integer with thousands of digits raises ValueError.
        raise ModelError(f"the D-H table '{path.name}' is not valid TOML: {error}") from None
    return dh_table({"name": path.stem, **settings})


def _csv_settings(text: str) -> dict[str, Any]:
    settings: dict[str, Any] = {}
    lines = []
    for line in text.splitlines():
        if line.lstrip().startswith("#"):
            key, equals, value = line.lstrip(" #\t").partition("=")
            key = key.strip()
            frame, _, part = key.partition("_")
            if equals and frame in ("base", "tool") and part in ("xyz", "rpy"):
                settings.setdefault(frame, {})[part] = value.replace(",", " ").split()
            elif equals and key in SETTINGS:
                settings[key] = value.strip()
        elif line.strip(" \t,"):
            lines.append(line)
    try:
        cells = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO("\n".join(lines)))]
    except csv.Error as error:
        raise ModelError(f"the D-H table is not valid CSV: {error}") from None
    header = cells[0] if cells else []
    if twice := [name for k, name in enumerate(header) if name and name in header[:k]]:
        raise ModelError(f"the D-H table has the column {', '.join(twice)} more than once")
    joints = []
    for number, row in enumerate(cells[1:], 1):
        if len(row) > len(header):
            raise ModelError(
                f"row {number} of the D-H table has {len(row)} cells; the header names {len(header)} columns"
            )
        joints.append({key: cell for key, cell in zip(header, row, strict=False) if cell})
    return {**settings, "joint": joints}


def dh_table(settings: Mapping[str, Any]) -> DHTable:
    """Make a DHTable of the settings of a D-H file, given as a dict, in metres and radians.

    Raises ModelError, which names the row and the column.
    """
    for key in settings:
        if key not in SETTINGS:
            raise ModelError(f"the D-H table has an unknown setting '{key}'.{near_match(key, SETTINGS)}")
    convention = _choice(settings, "convention", {"classic": "classic", "modified": "modified"})
    angle = _choice(settings, "angles", {"deg": math.pi / 180.0, "rad": 1.0})
    length = _choice(settings, "lengths", {"m": 1.0, "mm": 1e-3})
    name = settings.get("name")
    if not isinstance(name, str) or not name.isprintable() or not name.strip():
        raise ModelError("the D-H table's setting 'name' must be printable text")
    joints = settings.get("joint", [])
    if not isinstance(joints, list) or not joints:
        raise ModelError("the D-H table has no joints; give one [[joint]] (TOML) or one line (CSV) per joint")
    if len(joints) > MAX_ROWS:
        raise ModelError(f"the D-H table has {len(joints)} joints; at most {MAX_ROWS} are read")
    rows = tuple(_row(number, joint, angle, length) for number, joint in enumerate(joints, 1))
    names = [row.name for row in rows]
    for number, joint in enumerate(names, 1):
        if joint in ("tool_fixed", *names[: number - 1]):
            raise ModelError(
                f"row {number}, column 'name' of the D-H table: '{joint}' is already the name of another joint"
            )
    base, tool = (_frame(settings, key, angle, length) for key in ("base", "tool"))
    return DHTable(name, convention, rows, base, tool)


def _choice(settings: Mapping[str, Any], key: str, options: Mapping[str, Any]) -> Any:
    value = settings.get(key)
    if not isinstance(value, str) or value not in options:
        said = f"is missing (in a CSV file, a line '# {key} = ...')" if value is None else f"is {value!r}"
        raise ModelError(f"the D-H table's setting '{key}' {said}; it must be one of: {', '.join(options)}")
    return options[value]


def _row(number: int, joint: Any, angle: float, length: float) -> DHRow:
    where = f"row {number}"
    if not isinstance(joint, Mapping):
        raise ModelError(f"{where} of the D-H table must be a table of columns, not {joint!r}")
    for key in joint:
        if key not in COLUMNS:
            raise ModelError(f"{where} of the D-H table has an unknown column '{key}'.{near_match(key, COLUMNS)}")
    kind = joint.get("type", "revolute")
    if kind not in KINDS:
        raise ModelError(f"{where}, column 'type' of the D-H table is {kind!r}; it must be one of: {', '.join(KINDS)}")
    name = joint.get("name", f"joint_{number}")
    if not isinstance(name, str) or not name.isprintable() or not name.strip():
        raise ModelError(f"{where}, column 'name' of the D-H table is {name!r}; it must be printable text")
    own = length if kind == "prismatic" else angle
    units = dict.fromkeys(("theta", "alpha"), angle) | dict.fromkeys(("d", "a"), length)
    units |= dict.fromkeys(("lower", "upper", "velocity"), own) | {"effort": 1.0}
    values = {key: _number(joint[key], where, key) * unit for key, unit in units.items() if key in joint}
    if kind == "continuous":
        if "lower" in values or "upper" in values:
            raise ModelError(f"{where} of the D-H table is continuous: remove its 'lower' and 'upper'")
    else:
        for key in ("lower", "upper"):
            if key not in values:
                raise ModelError(
                    f"{where}, column '{key}' of the D-H table is missing; a {kind} joint needs both limits"
                )
        if values["lower"] > values["upper"]:
            raise ModelError(
                f"{where}, column 'lower' of the D-H table is above 'upper' ({joint['lower']} > {joint['upper']})"
            )
    for key in ("velocity", "effort"):
        if values.get(key, 1.0) <= 0.0:
            raise ModelError(f"{where}, column '{key}' of the D-H table must be positive, not {joint[key]}")
    return DHRow(name, kind, **values)


def _number(value: Any, where: str, column: str) -> float:
    try:
        number = math.nan if isinstance(value, bool) else decimal(str(value))
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise ModelError(f"{where}, column '{column}' of the D-H table must be a finite number, not {value!r}")
    return number


def _frame(settings: Mapping[str, Any], key: str, angle: float, length: float) -> np.ndarray:
    frame = settings.get(key, {})
    if not isinstance(frame, Mapping) or not set(frame) <= {"xyz", "rpy"}:
        raise ModelError(f"the D-H table's setting '{key}' must be {{ xyz = [...], rpy = [...] }}, not {frame!r}")
    T = np.eye(4)
    for part in frame:
        numbers = frame[part]
        if not isinstance(numbers, list) or len(numbers) != 3:
            raise ModelError(f"the D-H table's setting '{key}.{part}' must be three numbers, not {numbers!r}")
        values = [_number(x, f"setting '{key}'", part) for x in numbers]
        if part == "xyz":
            T[:3, 3] = np.multiply(values, length)
        else:
            R = rpy_matrix(np.multiply(values, angle).tolist())
            T[:3, :3] = np.where(np.abs(R) < 1e-15, 0.0, R)
    return T


# ---------------------------------------------------------------------------------------------------------- writing
def to_urdf(table: DHTable) -> str:
    """Write a D-H table as URDF text.

    The links are base_link, link_1 ... link_n and tool; joints are named as in the rows, and all their axes are z.
    """
    robot = new_robot(table.name)
    base = add_link(robot, "base_link")
    add_pedestal(base, table)
    add_arm(robot, table, "base_link", "tool")
    return to_text(robot)


def add_arm(
    robot: ET.Element,
    table: DHTable,
    root: str,
    tip: str,
    prefix: str = "",
    mount: np.ndarray | None = None,
    gripper: bool = True,
) -> None:
    """Append the joints and links of a D-H table to a <robot>, from `mount` (4, 4) [m] on its link `root` to a new link `tip`."""
    origins = joint_origins(table)
    if mount is not None:
        origins[0] = mount @ origins[0]
    parent = root
    for number, row in enumerate(table.rows, 1):
        name = f"{prefix}link_{number}"
        if row.type == "prismatic":
            parent_link = next(link for link in robot.iter("link") if link.get("name") == parent)
            _add_rail(parent_link, origins[number - 1], row, _radius(table, number - 1))
        link = add_link(robot, name)
        _add_body(link, table, number, origins[number], gripper and number == len(table.rows))
        add_joint(robot, prefix + row.name, row.type, parent, name, origins[number - 1], _limit(row))
        parent = name
    add_link(robot, tip)
    add_joint(robot, f"{tip}_fixed", "fixed", parent, tip, origins[-1])


def _limit(row: DHRow) -> dict[str, float]:
    ends = {} if row.type == "continuous" else {"lower": row.lower, "upper": row.upper}
    return {**ends, "effort": row.effort, "velocity": row.velocity}


def _radius(table: DHTable, number: int) -> float:
    """Return the radius [m] at which a link is drawn: 4.5 % of the stretched arm's length at the base, thinner towards the tip."""
    length = sum(math.hypot(row.a, row.d) for row in table.rows) or 1.0
    return 0.045 * length * (1.0 - 0.55 * number / len(table.rows))


def add_pedestal(link: ET.Element, table: DHTable, mount: np.ndarray | None = None) -> None:
    """Add the shapes of a foot below the first joint of an arm to a link: a plate, and a short column along the joint axis."""
    r, start = _radius(table, 0), table.base if mount is None else mount @ table.base
    if table.rows[0].type == "prismatic":
        return
    add_shape(link, "cylinder", (1.5 * r, 1.6 * r), start @ shift(z=-2.2 * r), "steel", solid=True)
    add_shape(link, "cylinder", (2.6 * r, 0.5 * r), start @ shift(z=-3.2 * r), "silver", solid=True)


def _add_body(link: ET.Element, table: DHTable, number: int, end: np.ndarray, gripper: bool) -> None:
    """Draw a link: a drum for its joint, bars along d and a to the next origin and, on the last bar, a gripper if asked for."""
    row, r = table.rows[number - 1], _radius(table, number)
    if row.type == "prismatic":
        add_shape(link, "box", (3.4 * r, 3.4 * r, 3.4 * r), np.eye(4), "orange")
    else:
        add_shape(link, "cylinder", (1.35 * r, 2.7 * r), np.eye(4), "orange")
        add_shape(link, "cylinder", (0.8 * r, 3.1 * r), np.eye(4), "silver")
    tip = end[:3, 3]
    knee = np.array([0.0, 0.0, tip[2]]) if table.convention == "classic" else np.array([tip[0], 0.0, 0.0])
    if row.type == "prismatic" and row.lower >= 0.0:
        add_shape(link, "cylinder", (0.75 * r, row.upper), shift(z=-0.5 * row.upper), "silver")
    points = [np.zeros(3), knee, tip]
    bars = [(a, b) for a, b in itertools.pairwise(points) if np.linalg.norm(b - a) > 1e-3 * r]
    for number, (a, b) in enumerate(bars, 1):
        holds = gripper and number == len(bars)
        add_bar(link, a, b - (b - a) * min(0.5, 2.6 * r / np.linalg.norm(b - a)) if holds else b, r)
        if holds:
            add_gripper(link, a, b, r)
    if 1e-3 * r < np.linalg.norm(knee) and 1e-3 * r < np.linalg.norm(tip - knee):
        add_shape(link, "box", (2.0 * r, 2.0 * r, 2.0 * r), shift(*knee), "steel")


def _add_rail(link: ET.Element, T: np.ndarray, row: DHRow, r: float) -> None:
    """Draw the guide of a prismatic joint: a rail if its stroke passes zero, otherwise the outer tube of a telescope."""
    if row.lower < 0.0:
        middle, length = 0.5 * (row.lower + row.upper), row.upper - row.lower + 4.0 * r
        add_shape(link, "box", (1.1 * r, 1.1 * r, length), T @ shift(z=middle), "silver")
        for end in (row.lower - 2.0 * r, row.upper + 2.0 * r):
            add_shape(link, "box", (2.2 * r, 2.2 * r, 0.6 * r), T @ shift(z=end), "steel")
    else:
        add_shape(
            link, "cylinder", (1.15 * r, row.upper), T @ shift(z=row.lower - 0.5 * row.upper), "steel", solid=True
        )
