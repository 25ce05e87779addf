"""Poses from CSV, NPZ or JSON files: positions with or without rotations, and with times where requested.

CSV: a header with x,y,z [m], optionally all of qx,qy,qz,qw or three angles, and t [s] where times are requested, in any order.
Other columns are ignored, unless they have names of a rotation. The angles are roll,pitch,yaw about x, y and z (also called
rx,ry,rz), or a,b,c one after another; see `Convention`. Columns are separated by commas, semicolons or tabs; where not by commas,
decimals may be written with a comma. NPZ: `xyz` (N, 3), optionally `quat_xyzw` or `quat_wxyz` (N, 4), and `t` (N,); without times
also `targets` (N, 4, 4) or (N, 3). JSON: an object with lists under these names, or just a list of targets.

For several tips: CSV columns TIP.x, TIP.y, ... of the same kinds for each tip; NPZ (and JSON) with an array TIP (N, 4, 4) or (N,
3) for each, or `targets` (N, F, 4, 4) or (N, F, 3), in the order of an array `tips` of names if there is one. A tip without data
is free.
"""

import csv
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import count, islice
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np

from ..errors import FEW_TURNS, InvalidOption, InvalidTarget, doubt_angles, near_match
from ..files import NAMES, NUMBERS, check_arrays, read_json, without_mark
from .rotation import euler_matrix, rotation_columns

LINES = 16384  # number of rows read at a time
POSITION, QUAT, RPY = ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("roll", "pitch", "yaw")
# Column names of angles: for rotations about the axes x, y and z, or for the first, second and third rotation.
ABOUT, IN_ORDER = ("rx", "ry", "rz"), ("a", "b", "c")
ORIENTATIONS = (QUAT, RPY, ABOUT, IN_ORDER)
LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}  # length of each unit [m]
MARKS = (",", ";", "\t")  # characters that may separate columns
ORDERS = {"quat_xyzw": [0, 1, 2, 3], "quat_wxyz": [1, 2, 3, 0]}  # columns of x, y, z and w
LONGEST_LINE = 2**20  # largest number of characters in a line


class Convention(NamedTuple):
    """The units and the order of angles in a file of poses.

    length_unit: unit of positions, one of LENGTHS. deg: whether angles are in degrees, else radians. euler: the axes of
    the three rotations, which follow one another about the already rotated axes; None means "zyx" (roll, pitch and yaw
    as in URDF).
    """

    length_unit: str = "m"
    deg: bool = False
    euler: str | None = None

    def check(self) -> "Convention":
        """Return the convention itself. Raises InvalidOption for an unknown unit or sequence of axes."""
        if self.length_unit not in LENGTHS:
            raise InvalidOption(f"the unit of length is {', '.join(LENGTHS)}, not {self.length_unit!r:.20}")
        axes = self.euler
        if axes is not None and (len(axes) != 3 or not {*axes} <= {*"xyz"} or axes[0] == axes[1] or axes[1] == axes[2]):
            raise InvalidOption(
                f"euler names three axes of which no two neighbours are the same, such as zyx or zyz, not {axes!r:.20}"
            )
        return self


class PoseRows(NamedTuple):
    """Rows read at a time: t (m,) [s] or None, poses (m, 4, 4) or positions (m, 3); for several tips a dict of these by tip."""

    t: np.ndarray | None
    poses: Any


def read_poses(
    path: Path, what: str, *, times: bool = False, given: Convention = Convention(), tips: Sequence[str] = ()
) -> tuple[int, Iterator[PoseRows]]:
    """Read a file of poses: return its number of rows and its blocks of rows, one for NPZ and JSON, many for CSV.

    what: name of the contents, for messages. times: whether the file must have times t. given: units and angles of the
    file. tips: names of the tips whose poses the file holds; without names it holds poses of one tip. Raises
    InvalidTarget, which names the line (for a CSV also while blocks are read), and InvalidOption.
    """
    scale = LENGTHS[given.check().length_unit]
    if not path.is_file():
        raise InvalidTarget(f"there is no {what} file '{path}'")
    try:
        if path.suffix.lower() in (".npz", ".json"):
            if tips:
                poses = _read_tip_arrays(path, tips)
                made = {tip: _scaled(array, scale) for tip, array in poses.items()}
                return len(next(iter(poses.values()))), iter([PoseRows(None, made)])
            block = _read_arrays(path, times)
            return len(block.poses), iter([block._replace(poses=_scaled(block.poses, scale))])
        if path.suffix.lower() != ".csv":
            raise InvalidTarget(f"a {what} file is .csv, .npz or .json, not '{path.name}'")
        with path.open("rb") as stream:
            rows = max(sum(block.count(b"\n") for block in iter(lambda: stream.read(1 << 20), b"")) - 1, 0)
        header, mark = _first_line(path)
        columns = (
            _tip_columns(path.name, header, tips, given) if tips else {"": _header(path.name, header, times, given)}
        )
        return rows, _read_csv(path, columns, len(header), mark, times, given)
    except InvalidTarget:
        raise
    # Damaged files raise many types of errors, such as those of zip, zlib, lzma, npy and csv.
    except Exception as error:
        raise InvalidTarget(f"cannot read '{path.name}': {_said(error)}") from None


def _scaled(poses: np.ndarray, scale: float) -> np.ndarray:
    """Multiply the positions in poses (N, ..., 4, 4), or positions (N, ..., 3), by `scale` [m per unit], in place."""
    if scale != 1.0:
        (poses[..., :3, 3] if poses.shape[-2:] == (4, 4) else poses)[...] *= scale
    return poses


def _said(error: Exception) -> str:
    """Shorten the message of a decoder's error to one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def _short(text: str) -> str:
    """Shorten a text from a file for a message."""
    return text if len(text) <= 80 else f"{text[:80]}..."


@contextmanager
def _arrays(path: Path, names: Sequence[str]) -> Iterator[Any]:
    """Yield the arrays of an NPZ or JSON file by name; only those in `names` are checked and converted. Raises InvalidTarget."""
    if path.suffix.lower() == ".json":
        content = read_json(path, InvalidTarget)
        content = content if isinstance(content, dict) else {"targets": content}
        yield {name: _array(path, name, content[name]) if name in names else None for name in content}
        return
    if not zipfile.is_zipfile(path):  # numpy's own error would suggest unpickling the file, which is unsafe.
        raise InvalidTarget(f"'{path.name}' is not an NPZ file (see numpy.savez)")
    check_arrays(path, names, ("tips",), InvalidTarget)
    with np.load(path, allow_pickle=False) as file:
        yield file


def _array(path: Path, name: str, value: Any) -> np.ndarray:
    """Return numbers (or names) from JSON as an array."""
    if name == "tips":
        if not isinstance(value, list) or not all(isinstance(one, str) and len(one) < NAMES // 4 for one in value):
            raise InvalidTarget(f"'{path.name}': tips must be a list of names")
        return np.array(value, dtype=object)
    with suppress(TypeError, ValueError, OverflowError):  # The function `floats` would be slow here.
        if (array := np.array(value)).dtype.kind in NUMBERS:
            return array.astype(float)
    raise InvalidTarget(f"'{path.name}': {name} must be lists of numbers, not {' '.join(repr(value).split())[:120]}")


def _read_arrays(path: Path, times: bool) -> PoseRows:
    with _arrays(path, ("targets", "t", "xyz", *ORDERS)) as file:
        if "targets" in file and not times:
            targets = file["targets"]
            if targets.ndim not in (2, 3):
                raise InvalidTarget(f"'{path.name}': targets has the shape (N, 4, 4) or (N, 3), not {targets.shape}")
            return PoseRows(None, targets)
        for name in ("t", "xyz") if times else ("xyz",):
            if name not in file:
                wanted = f"'{name}'" if times else "'targets' or 'xyz'"
                names = _short(", ".join(file)) or "nothing"
                raise InvalidTarget(f"'{path.name}' has no array {wanted}, only {names}.{near_match(name, list(file))}")
        t = np.asarray(file["t"], dtype=float) if times else None
        xyz = np.asarray(file["xyz"], dtype=float)
        given = [name for name in ORDERS if name in file]
        if len(given) > 1:
            raise InvalidTarget(f"'{path.name}' has {' and '.join(given)}; give only one of them")
        quat = np.asarray(file[given[0]], dtype=float) if given else None
    if xyz.ndim != 2 or xyz.shape[1] != 3 or (quat is not None and quat.shape != (len(xyz), 4)):
        raise InvalidTarget(f"'{path.name}': xyz has the shape (N, 3) and {' or '.join(given or ORDERS)} (N, 4)")
    if quat is not None:
        quat = quat[:, ORDERS[given[0]]]
    return PoseRows(t, xyz if quat is None else _poses(xyz, quat, range(len(xyz)), path.name, "row"))


def _read_tip_arrays(path: Path, tips: Sequence[str]) -> dict[str, np.ndarray]:
    """Read the targets (N, 4, 4) or (N, 3) [unit of the file] of each tip from an NPZ or JSON file."""
    with _arrays(path, ("targets", "tips", *tips)) as file:
        named = {tip: file[tip] for tip in tips if tip in file}
        order = file["tips"].tolist() if "tips" in file else list(tips)
        targets = file["targets"] if "targets" in file and not named else None
        names = list(file)
    if targets is None:
        strange = [name for name in names if name not in tips and near_match(name, tips)]
        if strange or not named:
            raise InvalidTarget(
                f"'{path.name}' needs an array 'targets', or one by the name of each tip ({', '.join(tips)}); it has "
                f"{_short(', '.join(names)) or 'nothing'}.{near_match((strange or names or [''])[0], tips)}"
            )
        for tip, array in named.items():
            if array.shape[1:] not in ((4, 4), (3,)):
                raise InvalidTarget(f"'{path.name}': {tip} has the shape (N, 4, 4) or (N, 3), not {array.shape}")
        if len({len(array) for array in named.values()}) > 1:
            rows = ", ".join(f"{tip} has {len(array)}" for tip, array in named.items())
            raise InvalidTarget(f"'{path.name}': every tip needs the same number of rows; {rows}")
        return named
    for tip in order:
        if tip not in tips:
            raise InvalidTarget(f"'{path.name}': '{tip}' of 'tips' is not solved for.{near_match(str(tip), tips)}")
    if targets.shape[1:] not in ((len(order), 4, 4), (len(order), 3)) or len(set(order)) < len(order):
        raise InvalidTarget(
            f"'{path.name}': targets of {', '.join(order)} have the shape (N, {len(order)}, 4, 4) or (N, {len(order)}, 3), "
            f"not {targets.shape}"
        )
    return {tip: targets[:, f] for f, tip in enumerate(order)}


def _lines(stream: TextIO, name: str) -> Iterator[str]:
    """Yield the lines of a file. Raises InvalidTarget for one that is too long to be a row."""
    for k in count(1):
        line = stream.readline(LONGEST_LINE + 1)
        if len(line) > LONGEST_LINE:
            raise InvalidTarget(f"'{name}', line {k} has more than {LONGEST_LINE:,} characters")
        if not line:
            return
        yield line


def _first_line(path: Path) -> tuple[list[str], str]:
    """Return the column names in the first line of a CSV file, and the character that separates them."""
    with path.open(newline="", encoding="utf-8-sig") as stream:
        line = next(_lines(stream, path.name), "")
    mark = max(MARKS, key=line.count)
    return [without_mark(cell.strip()) for cell in next(csv.reader([line], delimiter=mark), [])], mark


def _header(name: str, header: list[str], times: bool, given: Convention) -> list[int]:
    """Return the indices of the columns to read: t if `times`, then x, y, z, then a quaternion or angles if any.

    Angles are in the order in which the rotations follow one another.
    """
    return _places([cell.lower() for cell in header], name, ["t"] if times else [], "", given)


def _places(header: list[str], file: str, needed: list[str], prefix: str, given: Convention) -> list[int]:
    """Return the indices of the columns of one pose, whose names begin with `prefix`, after those in `needed`."""
    position, *kinds = (tuple(prefix + name for name in names) for names in (POSITION, *ORIENTATIONS))
    needed = [*needed, *position]
    first = ",".join(needed)
    forms = f"{first}, {first},{','.join(kinds[0])} or {first},{','.join(kinds[1])}"
    missing = [name for name in needed if name not in header]
    if missing:
        raise InvalidTarget(
            f"'{file}' has no column {', '.join(missing)}; its first line must be {forms}, not {_short(','.join(header))}"
        )
    found = {names: have for names in kinds if (have := [name for name in names if name in header])}
    if kinds[3] in found and given.euler is None and len(found[kinds[3]]) < 3:
        del found[kinds[3]]  # A single column a, b or c is no angle.
    turned = next(iter(found), ())
    if len(found) > 1 or (found and len(found[turned]) < len(turned)):
        every = ", ".join(name for have in found.values() for name in have)
        raise InvalidTarget(f"'{file}' has the columns {every}; the first line must be {forms}")
    if turned in kinds[2:] and given.euler is None:
        raise InvalidTarget(
            f"'{file}' has the columns {', '.join(turned)}: say with --euler about which axes the angles turn, such as zyx (URDF's "
            f"roll, pitch, yaw are {','.join(kinds[1])})"
        )
    if not turned:
        others = [name.removeprefix(prefix) for name in header if name.startswith(prefix) and name not in needed]
        unread = rotation_columns([name for name in others if "." not in name])
        if unread or given.euler is not None:
            said = f"the columns {', '.join(unread)} are not read" if unread else "no column has the angles of --euler"
            raise InvalidTarget(
                f"'{file}': {said}; the first line must be {forms}, or with --euler {first},{','.join(kinds[2])}"
            )
    order = given.euler or "zyx"
    if turned in kinds[1:3]:
        if len({*order}) < 3:
            raise InvalidTarget(f"'{file}': angles of the sequence {order} are in the columns {','.join(kinds[3])}")
        turned = tuple(turned["xyz".index(axis)] for axis in order)
    names = (*needed, *turned)
    twice = [name for name in names if header.count(name) > 1]
    if twice:
        raise InvalidTarget(f"'{file}' has the column {', '.join(twice)} more than once")
    return [header.index(name) for name in names]


def _tip_columns(file: str, columns: list[str], tips: Sequence[str], given: Convention) -> dict[str, list[int]]:
    """Return the indices of the columns TIP.x, ... of each tip that has any.

    Raises InvalidTarget if none has, or a name is wrong.
    """
    header, every = [], {name for names in (POSITION, *ORIENTATIONS) for name in names}
    for cell in columns:
        tip, dot, name = cell.rpartition(".")
        header.append(f"{tip}{dot}{name.lower()}")
        if dot and name.lower() in every and tip not in tips:
            raise InvalidTarget(
                f"'{file}', column '{cell}': '{tip}' is not one of the tips solved for, {', '.join(tips)}."
                f"{near_match(tip, tips)}"
            )
    found = {
        tip: _places(header, file, [], f"{tip}.", given)
        for tip in tips
        if any(f"{tip}.{name}" in header for name in every)
    }
    if not found:
        forms = ",".join(f"{tip}.{name}" for tip in tips for name in POSITION)
        raise InvalidTarget(
            f"'{file}' has no columns of {', '.join(tips)}; its first line is {forms}, with .qx,.qy,.qz,.qw or "
            f".roll,.pitch,.yaw of a tip for its poses, not {_short(','.join(header))}"
        )
    return found


def _read_csv(
    path: Path, columns: dict[str, list[int]], width: int, mark: str, times: bool, given: Convention
) -> Iterator[PoseRows]:
    """Yield the blocks of a file with columns by tip ('' for poses without a name); its first line has `width` columns."""
    every = [place for places in columns.values() for place in places]
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            numbered = ((k, line) for k, line in enumerate(_lines(stream, path.name), 1) if k > 1 and line.strip())
            while block := list(islice(numbered, LINES)):
                lines = [k for k, _ in block]
                values = _numbers([line for _, line in block], every, width, mark, lines, path.name)
                t, values = (values[:, 0], values[:, 1:]) if times else (None, values)
                made, first = {}, 0
                for tip, places in columns.items():
                    last = first + len(places) - times
                    made[tip] = _part(values[:, first:last], lines, path.name, given, f"{tip}." if tip else "")
                    first = last
                yield PoseRows(t, made[""] if "" in made else made)
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidTarget(f"cannot read '{path.name}': {_said(error)}") from None


def _part(values: np.ndarray, lines: list[int], name: str, given: Convention, prefix: str) -> np.ndarray:
    """Return positions (m, 3), or poses (m, 4, 4) if values (m, 7 or 6) also have a quaternion or angles.

    lines: numbers of the lines, and prefix: of the column names, both for messages.
    """
    xyz, turned = LENGTHS[given.length_unit] * values[:, :3], values[:, 3:]
    if not turned.shape[1]:
        return xyz
    if turned.shape[1] == 4:
        return _poses(xyz, turned, lines, name, "line", prefix)
    angles = np.radians(turned) if given.deg else turned
    if not given.deg and np.abs(angles).max(initial=0.0) > FEW_TURNS:
        doubt_angles(f"the angles of '{name}'", {"": float(angles.flat[np.abs(angles).argmax()])})
    T = np.tile(np.eye(4), (len(xyz), 1, 1))
    T[:, :3, 3], T[:, :3, :3] = xyz, euler_matrix(given.euler or "zyx", angles)
    return T


def _numbers(texts: list[str], columns: list[int], width: int, mark: str, lines: list[int], name: str) -> np.ndarray:
    """Read finite numbers (m, columns) from m lines of text with `width` columns each, which `mark` separates.

    columns: indices of the columns to read; lines: numbers of the lines. Raises InvalidTarget, which names the line.
    """
    if mark != ",":
        texts = [text.replace(",", ".") for text in texts]
    try:
        # A quoted cell with a separator also fails here; the slow reader below accepts it.
        if any(text.count(mark) != width - 1 for text in texts):
            raise ValueError
        values = np.loadtxt(texts, delimiter=mark, usecols=columns, ndmin=2, comments=None, quotechar='"')
        if len(values) == len(texts) and np.isfinite(values).all():
            return values
    except ValueError:
        pass
    rows = []
    for k, text in zip(lines, texts, strict=True):  # Reading line by line finds the one at fault.
        try:
            row = next(csv.reader([text], delimiter=mark, strict=True))
        except csv.Error as error:
            raise InvalidTarget(f"'{name}', line {k}: {_said(error)}; unclosed quote?") from None
        if len(row) != width:
            hint = "; are decimals written with a comma?" if len(row) > width and mark == "," else ""
            more = "more" if len(row) > width else "fewer"
            raise InvalidTarget(f"'{name}', line {k}: {len(row)} columns, {more} than in the header{hint}")
        for column in columns:
            try:
                good = np.isfinite(float(row[column]))
            except ValueError:
                good = False
            if not good:
                raise InvalidTarget(f"'{name}', line {k}: {_short(row[column].strip())!r} is not a finite number")
        rows.append([float(row[column]) for column in columns])
    return np.array(rows)


def _poses(
    xyz: np.ndarray, quat: np.ndarray, lines: Sequence[int], name: str, word: str, prefix: str = ""
) -> np.ndarray:
    """Make poses (m, 4, 4) of positions xyz (m, 3) and quaternions x, y, z, w (m, 4)."""
    length = np.linalg.norm(quat, axis=1)
    bad = ~(np.abs(length - 1.0) < 1e-2)
    if bad.any():
        k = int(np.argmax(bad))
        raise InvalidTarget(
            f"'{name}', {word} {lines[k]}: the quaternion {','.join(prefix + x for x in QUAT)} has length {length[k]:.4g}, not 1"
        )
    T = np.tile(np.eye(4), (len(xyz), 1, 1))
    T[:, :3, 3] = xyz
    x, w = quat[:, :3] / length[:, None], 2.0 * quat[:, 3:] / length[:, None]
    T[:, :3, :3] = 2.0 * x[:, :, None] * x[:, None, :]
    T[:, [0, 1, 2], [0, 1, 2]] += 0.5 * w * w - 1.0
    T[:, [1, 2, 0], [0, 1, 2]] += w * x[:, [2, 0, 1]]
    T[:, [0, 1, 2], [1, 2, 0]] -= w * x[:, [2, 0, 1]]
    return T
