"""Poses from CSV, NPZ or JSON files: positions with or without rotations, and with times where requested.

CSV: a header with x,y,z [m], optionally all of qx,qy,qz,qw or three angles, and t [s] where times are requested, in any order.
Other columns are ignored, unless they have names of a rotation. The angles are roll,pitch,yaw about x, y and z (also called
rx,ry,rz), or a,b,c one after another; see `Convention`. Columns are separated by commas, semicolons or tabs; in the latter two
cases numbers may have a decimal comma. Excel's first line sep=; is skipped, and so are blank lines; a warning names the blank lines
that are followed by rows. NPZ: `xyz` (N, 3), optionally `quat_xyzw` or `quat_wxyz` (N, 4), and `t` (N,); without times also
`targets` (N, 4, 4) or (N, 3). JSON: an object with lists under these names, or just a list of targets, which may be ROS messages
(see `ros.read_pose`), or a PoseArray or nav_msgs/Path.

For several tips: CSV columns TIP.x, TIP.y, ... of the same kinds for each tip; NPZ (and JSON) with an array TIP (N, 4, 4) or (N,
3) for each, or `targets` (N, F, 4, 4) or (N, F, 3), in the order of an array `tips` of names if there is one. A tip without data
is free.
"""

import csv
import logging
import math
import re
from collections.abc import Iterator, Sequence
from itertools import count, islice
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np

from ..errors import FEW_TURNS, InvalidOption, InvalidTarget, doubt_angles, near_match
from ..files import why_unread, without_mark
from ..text import decimal, how_many
from .pose_arrays import QUAT, quaternion_poses, read_arrays, read_tip_arrays, require_increasing, row_numbers, short
from .rotation import euler_axes, euler_matrix, rotation_columns

LINES = 16384  # A CSV file is read in blocks of this many rows, to bound the memory.
POSITION, RPY = ("x", "y", "z"), ("roll", "pitch", "yaw")
# Columns of angles: rx, ry, rz about the axes they name, or a, b, c for the first, second and third rotation of a sequence.
ABOUT, IN_ORDER = ("rx", "ry", "rz"), ("a", "b", "c")
ORIENTATIONS = (QUAT, RPY, ABOUT, IN_ORDER)
LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}  # Metres in each unit of length.
MARKS = (",", ";", "\t")  # Characters that may separate the columns of a CSV file.
LONGEST_LINE = 2**20  # A line with more characters than this is refused.


class Convention(NamedTuple):
    """The units and the order of angles in a file of poses.

    length_unit: unit of positions, one of LENGTHS. deg: whether angles are in degrees, else radians. euler: the axes of
    the three rotations, each about an axis that the ones before have turned (intrinsic); None means "zyx" (yaw, pitch and
    roll as in URDF).
    """

    length_unit: str = "m"
    deg: bool = False
    euler: str | None = None

    def check(self) -> "Convention":
        """Return the convention with its axes in lower case. Raises InvalidOption for an unknown unit or sequence of axes."""
        if self.length_unit not in LENGTHS:
            raise InvalidOption(f"the unit of length is {', '.join(LENGTHS)}, not {self.length_unit!r:.20}")
        return self if self.euler is None else self._replace(euler=euler_axes(self.euler))


class PoseRows(NamedTuple):
    """m rows of a file of poses: times t (m,) [s] or None, and poses (m, 4, 4) or positions (m, 3), or a dict of these by tip."""

    t: np.ndarray | None
    poses: Any


def read_poses(
    path: Path,
    what: str,
    *,
    times: bool = False,
    given: Convention = Convention(),
    tips: Sequence[str] = (),
    base: str = "",
    besides: Sequence[str] = (),
) -> tuple[int, Iterator[PoseRows]]:
    """Read a file of poses: return its number of rows and its blocks of rows, one for NPZ and JSON, many for CSV.

    what: name of the contents, for messages. times: whether the file must have times t. given: units and angles of the
    file. tips: names of the tips whose poses the file holds; without names it holds poses of one tip. base: frame in which
    ROS messages in it must be given, "" for any. besides: names of columns that are not read here, such as joints. Raises
    InvalidTarget, which names the line (for a CSV file also while its blocks are read), and InvalidOption.
    """
    given = given.check()
    scale = LENGTHS[given.length_unit]
    if not path.is_file():
        if path.exists():
            raise InvalidTarget(f"'{path}' is not a regular file; in a shell - reads standard input")
        raise InvalidTarget(f"there is no {what} file '{path}'")
    try:
        if path.suffix.lower() in (".npz", ".json"):
            if given.euler is not None:
                raise InvalidTarget(f"'{path.name}': no angles are read from it, so --euler has no effect")
            if tips:
                poses = read_tip_arrays(path, tips, base)
                made = {tip: _scaled(array, scale) for tip, array in poses.items()}
                return len(next(iter(poses.values()))), iter([PoseRows(None, made)])
            t, poses = read_arrays(path, times, base)
            return len(poses), iter([PoseRows(t, _scaled(poses, scale))])
        if path.suffix.lower() != ".csv":
            raise InvalidTarget(f"a {what} file is .csv, .npz or .json, not '{path.name}'")
        with path.open("rb") as stream:
            rows = max(sum(block.count(b"\n") for block in iter(lambda: stream.read(1 << 20), b"")) - 1, 0)
        first = [
            *(["t"] if times else []),
            *(f"{tip}.{name}" if tip else name for tip in tips or ("",) for name in POSITION),
        ]
        top = _read_top(path, ",".join(first))
        top = top._replace(header=["" if cell in besides else cell for cell in top.header])
        columns = (
            _tip_columns(path.name, top.header, tips, given)
            if tips
            else {"": _places([cell.lower() for cell in top.header], path.name, ["t"] * times, "", given)}
        )
        if not top.filled:
            raise InvalidTarget(
                f"'{path.name}' has a header, {short(','.join(top.header))}, and no rows below it, each a line of numbers"
            )
        return rows, _read_csv(path, columns, top, times, given)
    except InvalidTarget:
        raise
    # Damaged files raise many types of errors, such as those of zip, zlib, lzma, npy and csv.
    except Exception as error:
        raise InvalidTarget(f"cannot read '{path.name}': {why_unread(error)}") from None


def read_columns(path: Path, names: Sequence[str] = (), gaps: bool = False) -> tuple[list[str], np.ndarray]:
    """Read a CSV file: return the names of all its columns, and the numbers (N, K) in the columns `names`, by default in all.

    gaps: whether a cell may be empty or "nan", which is read as NaN. Raises InvalidTarget.
    """
    try:
        top = _read_top(path, ",".join(names) or "t,q_JOINT")
        names = names or top.header
        for name in names:
            if top.header.count(name) != 1:
                many = "no column" if name not in top.header else "more than one column"
                needed = f"it needs {', '.join(names)}.{near_match(name, top.header)}"
                raise InvalidTarget(f"'{path.name}' has {many} '{name}'; {needed}")
        with path.open(newline="", encoding="utf-8-sig") as stream:
            lines, texts = zip(*_rows(stream, path.name, top.line), strict=True)
            columns = [top.header.index(name) for name in names]
            return top.header, _numbers(list(texts), columns, top, list(lines), path.name, gaps)
    except InvalidTarget:
        raise
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidTarget(f"cannot read '{path.name}': {why_unread(error)}") from None
    except ValueError:
        raise InvalidTarget(f"'{path.name}' has no rows of numbers below its header") from None


def _scaled(poses: np.ndarray, scale: float) -> np.ndarray:
    """Multiply the positions in poses (N, ..., 4, 4), or positions (N, ..., 3), by `scale` [m per unit], in place."""
    if scale != 1.0:
        (poses[..., :3, 3] if poses.shape[-2:] == (4, 4) else poses)[...] *= scale
    return poses


def _lines(stream: TextIO, name: str) -> Iterator[str]:
    """Yield the lines of a file. Raises InvalidTarget for one that is too long to be a row."""
    for k in count(1):
        line = stream.readline(LONGEST_LINE + 1)
        if len(line) > LONGEST_LINE:
            raise InvalidTarget(f"'{name}', line {k} has more than {LONGEST_LINE:,} characters")
        if not line:
            return
        yield line


class _Top(NamedTuple):
    """The header of a file: column names, the character that separates them, the line number; and whether rows follow."""

    header: list[str]
    mark: str
    line: int
    filled: bool


def _blank(line: str) -> bool:
    """Return whether all cells of a line are empty; spreadsheets write such lines below a table."""
    return not line.strip(' ,;\t\r\n"')


def _read_top(path: Path, first: str) -> _Top:
    """Read the first line that is not blank, nor Excel's sep=;. Raises InvalidTarget if there is none; first: an example of it."""
    with path.open(newline="", encoding="utf-8-sig") as stream:
        lines = ((k, line) for k, line in enumerate(_lines(stream, path.name), 1) if not _blank(line))
        k, line = next(lines, (0, ""))
        mark = re.fullmatch(r'"?sep=([,;|\t])"?\s*', line, re.IGNORECASE)
        k, line = next(lines, (0, "")) if mark else (k, line)
        filled = next(lines, None) is not None
    if not k:
        found = "has only blank lines" if path.stat().st_size else "is empty"
        raise InvalidTarget(
            f"'{path.name}' {found}; its first line names the columns, such as {first}, and each line below it is a row of numbers"
        )
    mark = mark[1] if mark else max(MARKS, key=line.count)
    return _Top([without_mark(cell.strip()) for cell in next(csv.reader([line], delimiter=mark), [])], mark, k, filled)


def _places(header: list[str], file: str, needed: list[str], prefix: str, given: Convention) -> list[int]:
    """Return the indices of the columns of one pose, whose names begin with `prefix`, after those in `needed`.

    They are x, y, z, then a quaternion or angles if any; angles are in the order in which the rotations follow one another.
    """
    position, *kinds = (tuple(prefix + name for name in names) for names in (POSITION, *ORIENTATIONS))
    needed = [*needed, *position]
    first = ",".join(needed)
    forms = f"{first}, {first},{','.join(kinds[0])} or {first},{','.join(kinds[1])}"
    forms += f", or with --euler {first},{','.join(kinds[2])} or {first},{','.join(kinds[3])}"
    missing = [name for name in needed if name not in header]
    if missing:
        raise InvalidTarget(
            f"'{file}' has no column {', '.join(missing)}; its first line must be {forms}, not {short(','.join(header))}"
        )
    found = {names: have for names in kinds if (have := [name for name in names if name in header])}
    if kinds[3] in found and given.euler is None and len(found[kinds[3]]) < 3:
        del found[kinds[3]]  # Columns a, b and c are Euler angles only if all three are there.
    turned = next(iter(found), ())
    if len(found) > 1 or (found and len(found[turned]) < len(turned)):
        every = ", ".join(name for have in found.values() for name in have)
        raise InvalidTarget(f"'{file}' has the columns {every}; the first line must be {forms}")
    if turned in kinds[2:] and given.euler is None:
        raise InvalidTarget(
            f"'{file}' has the columns {', '.join(turned)}: say with --euler about which axes the angles turn, such as zyx (URDF's "
            f"roll, pitch, yaw are {','.join(kinds[1])})"
        )
    others = [name.removeprefix(prefix) for name in header if name.startswith(prefix) and name not in needed]
    others = [name for name in others if name.split(".")[0] in (name, "orientation")]
    unread = [] if turned else rotation_columns(others)
    if unread or (given.euler is not None and turned in ((), kinds[0])):
        said = f"the columns {', '.join(unread)} are not read" if unread else "no column has the angles of --euler"
        raise InvalidTarget(f"'{file}': {said}; the first line must be {forms}")
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
            f".roll,.pitch,.yaw of a tip for its poses, not {short(','.join(header))}"
        )
    return found


def _rows(stream: TextIO, name: str, top: int) -> Iterator[tuple[int, str]]:
    """Yield the lines below line `top` with their numbers, without blank lines.

    A warning names blank lines that other lines follow.
    """
    gaps: list[int] = []  # The line number of the first blank line in each gap between rows, for a warning.
    skipped, before = 0, top
    for k, line in enumerate(_lines(stream, name), 1):
        if k <= top or _blank(line):
            continue
        if k > before + 1:
            gaps.append(before + 1)
            skipped += k - before - 1
        before = k
        yield k, line
    if gaps:
        lines = f"{how_many(skipped, 'blank line')} skipped, at {row_numbers('line', gaps)}"
        warning = logging.getLogger("ik_toolkit").warning
        warning("'%s': %s; the answers have no rows for %s", name, lines, "them" if skipped > 1 else "it")


def _read_csv(
    path: Path, columns: dict[str, list[int]], top: _Top, times: bool, given: Convention
) -> Iterator[PoseRows]:
    """Yield the blocks of a file with columns by tip ('' for poses without a name) below its header."""
    every = [place for places in columns.values() for place in places]
    last: list[tuple[int, float]] = []
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            numbered = _rows(stream, path.name, top.line)
            while block := list(islice(numbered, LINES)):
                lines = [k for k, _ in block]
                values = _numbers([line for _, line in block], every, top, lines, path.name)
                t, values = (values[:, 0], values[:, 1:]) if times else (None, values)
                if t is not None:
                    at, before = zip(*last, strict=True) if last else ((), ())
                    require_increasing(np.concatenate([before, t]), [*at, *lines], path.name, "line")
                    last = [(lines[-1], float(t[-1]))]
                made, first = {}, 0
                for tip, places in columns.items():
                    end = first + len(places) - times
                    made[tip] = _part(values[:, first:end], lines, path.name, given, f"{tip}." if tip else "")
                    first = end
                yield PoseRows(t, made[""] if "" in made else made)
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidTarget(f"cannot read '{path.name}': {why_unread(error)}") from None


def _part(values: np.ndarray, lines: list[int], name: str, given: Convention, prefix: str) -> np.ndarray:
    """Return positions (m, 3), or poses (m, 4, 4) if values (m, 7 or 6) also have a quaternion or angles.

    lines: numbers of the lines, and prefix: beginning of the column names, both for messages.
    """
    xyz, turned = LENGTHS[given.length_unit] * values[:, :3], values[:, 3:]
    if not turned.shape[1]:
        return xyz
    if turned.shape[1] == 4:
        return quaternion_poses(xyz, turned, lines, name, "line", prefix)
    angles = np.radians(turned) if given.deg else turned
    if not given.deg and np.abs(angles).max(initial=0.0) > FEW_TURNS:
        doubt_angles(f"the angles of '{name}'", {"": float(angles.flat[np.abs(angles).argmax()])})
    T = np.tile(np.eye(4), (len(xyz), 1, 1))
    T[:, :3, 3], T[:, :3, :3] = xyz, euler_matrix(given.euler or "zyx", angles)
    return T


def _numbers(
    texts: list[str], columns: list[int], top: _Top, lines: list[int], name: str, gaps: bool = False
) -> np.ndarray:
    """Read finite numbers (m, columns) from m lines of text with the header's columns; with gaps also NaN.

    columns: indices of the columns to read; lines: numbers of the lines. Raises InvalidTarget, which names the lines.
    """
    mark, width = top.mark, len(top.header)
    if mark != ",":
        texts = [text.replace(",", ".") for text in texts]
    try:
        # A quoted cell with a separator in it also fails this count; the code below then reads line by line.
        if any(text.count(mark) != width - 1 for text in texts):
            raise ValueError
        values = np.loadtxt(texts, delimiter=mark, usecols=columns, ndmin=2, comments=None, quotechar='"')
        if len(values) == len(texts) and np.isfinite(values).all():
            return values
    except ValueError:
        pass
    rows, bad = [], {}
    for k, text in zip(lines, texts, strict=True):  # Each line is read by itself, to find those that are wrong.
        try:
            row = next(csv.reader([text], delimiter=mark, strict=True))
        except csv.Error as error:
            raise InvalidTarget(f"'{name}', line {k}: {why_unread(error)}; unclosed quote?") from None
        if len(row) != width:
            hint = "; are decimals written with a comma?" if len(row) > width and mark == "," else ""
            more = "more" if len(row) > width else "fewer"
            raise InvalidTarget(f"'{name}', line {k}: {len(row)} columns, {more} than in the header{hint}")
        found = [math.nan if gaps and row[at].strip() in ("", "nan") else _finite(row[at]) for at in columns]
        rows.append(found)
        if None in found:
            column = columns[found.index(None)]
            cell = row[column].strip()
            bad[k] = (
                f"{short(cell)!r} is not a finite number"
                if cell
                else f"the cell of {short(top.header[column])} is empty"
            )
    if bad:
        first, *others = bad
        more = (
            f"; {row_numbers('line', others)} {'lack' if len(others) > 1 else 'lacks'} a number as well"
            if others
            else ""
        )
        raise InvalidTarget(
            f"'{name}', line {first}: {bad[first]}{more}; fill in what is missing, or delete these lines"
        )
    return np.array(rows)


def _finite(cell: str) -> float | None:
    """Return the finite number in a cell, or None."""
    try:
        value = decimal(cell)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
