"""Reads poses from CSV, NPZ or JSON files: positions with or without rotations, and with times where requested.

A CSV file has a header with x,y,z [m], optionally all of qx,qy,qz,qw or all of roll,pitch,yaw (URDF order), and t [s]
if times are requested, in any order; other columns are ignored. An NPZ file has `xyz` (N, 3), optionally `quat_xyzw` or
`quat_wxyz` (N, 4), and `t` (N,); without times also `targets` (N, 4, 4) or (N, 3). A JSON file has an object with lists
under these names, or just a list of targets.

For several tips, CSV has columns TIP.x, TIP.y, ... of the same kinds for each tip; NPZ (and JSON) has an array TIP (N,
4, 4) or (N, 3) for each, or `targets` (N, F, 4, 4) or (N, F, 3), in the order of an array `tips` of names if there is
one. A tip without data is free.
"""

import csv
import io
import json
import math
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import count, islice
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np

from ..errors import IKError, InvalidTarget, near_match
from ..files import without_mark
from .pose import rpy_matrix

LINES = 16384  # Number of rows read at a time.
POSITION, QUAT, RPY = ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("roll", "pitch", "yaw")
ORDERS = {"quat_xyzw": [0, 1, 2, 3], "quat_wxyz": [1, 2, 3, 0]}  # Maps an order to its columns of x, y, z and w.
NUMBERS, TEXTS = "fiu", "U"  # Arrays of these kinds of dtype are read as numbers, and as names.


class PoseFileCaps(NamedTuple):
    """Limits on a file, in bytes and characters, so that none exhausts this process; a file beyond one is refused."""

    unpacked: int = 2**26  # Bytes of all arrays of a file, besides `expansion` for each byte of the file.
    # Bytes of arrays for each byte of the file; compressed poses are at least a fifth of their size.
    expansion: int = 20
    names: int = 2**18  # Bytes of an array that holds names.
    header: int = 2**16  # Bytes of an array's header, which numpy takes into memory before it looks at it.
    json: int = 20_000_000  # Bytes of a JSON file, whose lists take up to 20 times as much, and a second for 5 MB.
    line: int = 2**20  # Characters of one line of a CSV file.


CAPS = PoseFileCaps()


class PoseRows(NamedTuple):
    """Rows that are read together: times t (m,) [s] or None, and poses.

    The poses are (m, 4, 4) or positions (m, 3), for several tips a dict of these by tip.
    """

    t: np.ndarray | None
    poses: Any


def read_poses(
    path: Path, what: str, *, times: bool = False, deg: bool = False, tips: Sequence[str] = ()
) -> tuple[int, Iterator[PoseRows]]:
    """Return the number of rows and the blocks of a file: one block for NPZ, many for CSV.

    `what` names the contents in messages. With `times`, t is required as well; with `deg`, roll, pitch and yaw are in
    degrees, not radians. `tips` names the tips whose poses the file has; without, its poses have no name. Raises
    InvalidTarget naming the line, for a CSV also while its blocks are read.
    """
    if not path.is_file():
        raise InvalidTarget(f"there is no {what} file '{path}'")
    try:
        if path.suffix.lower() in (".npz", ".json"):
            if tips:
                poses = _read_tip_arrays(path, tips)
                return len(next(iter(poses.values()))), iter([PoseRows(None, poses)])
            block = _read_arrays(path, times)
            return len(block.poses), iter([block])
        if path.suffix.lower() != ".csv":
            raise InvalidTarget(f"a {what} file is .csv, .npz or .json, not '{path.name}'")
        with path.open("rb") as stream:
            rows = max(sum(block.count(b"\n") for block in iter(lambda: stream.read(1 << 20), b"")) - 1, 0)
        columns = _tip_columns(path, tips) if tips else {"": _header(path, times)}
        return rows, _read_csv(path, columns, len(_first_line(path)), times, deg)
    except InvalidTarget:
        raise
    except Exception as error:  # Damaged files raise many types: zip, zlib, lzma, npy and csv errors.
        raise InvalidTarget(f"cannot read '{path.name}': {_said(error)}") from None


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
    if not zipfile.is_zipfile(path):  # numpy would suggest unpickling such a file.
        raise InvalidTarget(f"'{path.name}' is not an NPZ file (see numpy.savez)")
    check_arrays(path, names, ("tips",), InvalidTarget)
    with np.load(path, allow_pickle=False) as file:
        yield file


def read_json(path: Path, error: type[IKError]) -> Any:
    """Read a JSON file. Raises `error`, which names the file, if it is too large or too deep, ValueError if it is no JSON."""
    if path.stat().st_size > CAPS.json:
        raise error(f"'{path.name}' is larger than {CAPS.json / 1e6:.0f} MB; save it as NPZ or CSV")
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except RecursionError:
        raise error(f"'{path.name}': its lists are nested too deep") from None


def _array(path: Path, name: str, value: Any) -> np.ndarray:
    """Return numbers (or names) from JSON as an array."""
    if name == "tips":
        if not isinstance(value, list) or not all(isinstance(one, str) and len(one) < CAPS.names // 4 for one in value):
            raise InvalidTarget(f"'{path.name}': tips must be a list of names")
        return np.array(value, dtype=object)
    with suppress(TypeError, ValueError, OverflowError):  # `floats` would look for masked entries in millions of lists.
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
    return PoseRows(t, xyz if quat is None else _poses(xyz, quat, QUAT, range(len(xyz)), path.name, "row"))


def _read_tip_arrays(path: Path, tips: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the targets (N, 4, 4) or (N, 3) of each tip."""
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


def check_arrays(path: Path, names: Iterable[str], texts: Iterable[str], error: type[IKError]) -> None:
    """Check the headers of an NPZ file before any array of it is read. Raises `error`, which names the file and the array.

    Of the arrays called `names`, those in `texts` have names, all others real numbers (no dates, complex numbers, truth
    values or objects). None may be larger than its data, and together they may take no more than a file of this size
    can hold.
    """
    packed, together = path.stat().st_size, 0
    with zipfile.ZipFile(path) as archive:
        members = [member for member in archive.infolist() if member.filename.removesuffix(".npy") in names]
        for member in members:
            name = member.filename.removesuffix(".npy")
            with archive.open(member) as stream:
                start = io.BytesIO(stream.read(CAPS.header))
                version = np.lib.format.read_magic(start)
                read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                shape, _, dtype = read(start)
            what, kinds = ("names", TEXTS) if name in texts else ("real numbers", NUMBERS)
            if dtype.kind not in kinds:
                raise error(f"'{path.name}': the array {name} holds values of the type {dtype}, not {what}")
            promised = math.prod(shape) * dtype.itemsize
            if promised > member.file_size:
                raise error(
                    f"'{path.name}': {member.filename} declares {promised:,} bytes but holds {member.file_size:,}"
                )
            together += member.file_size
            if name in texts and promised > CAPS.names:
                raise error(f"'{path.name}': the array {name} takes {promised:,} bytes, too many for names")
            if together > CAPS.unpacked + CAPS.expansion * packed:
                raise error(
                    f"'{path.name}': {member.filename} unpacks to {together / 1e6:,.1f} MB from {packed / 1e6:,.1f} MB; save it "
                    "with numpy.savez, without compression"
                )


def _lines(stream: TextIO, name: str) -> Iterator[str]:
    """Yield the lines of a file. Raises InvalidTarget for one that is too long to be a row."""
    for k in count(1):
        line = stream.readline(CAPS.line + 1)
        if len(line) > CAPS.line:
            raise InvalidTarget(f"'{name}', line {k} has more than {CAPS.line:,} characters")
        if not line:
            return
        yield line


def _first_line(path: Path) -> list[str]:
    """Return the names of the columns, which the first line of a CSV file gives."""
    with path.open(newline="", encoding="utf-8-sig") as stream:
        return [without_mark(cell.strip()) for cell in next(csv.reader(_lines(stream, path.name)), [])]


def _header(path: Path, times: bool) -> list[int]:
    """Return the indices of the columns used: t if requested, then 3, 7 (with quaternion) or 6 (with roll, pitch, yaw)."""
    return _places([cell.lower() for cell in _first_line(path)], path.name, ["t"] if times else [], "")


def _places(header: list[str], file: str, needed: list[str], prefix: str) -> list[int]:
    """Return the indices of the columns of one pose, whose names begin with `prefix`, after those in `needed`."""
    position, every_quat, every_rpy = (tuple(prefix + name for name in names) for names in (POSITION, QUAT, RPY))
    needed = [*needed, *position]
    first = ",".join(needed)
    forms = f"{first}, {first},{','.join(every_quat)} or {first},{','.join(every_rpy)}"
    missing = [name for name in needed if name not in header]
    if missing:
        raise InvalidTarget(
            f"'{file}' has no column {', '.join(missing)}; its first line must be {forms}, not {_short(','.join(header))}"
            f"{_other_separator(header)}"
        )
    quat, rpy = ([name for name in names if name in header] for names in (every_quat, every_rpy))
    if (quat and rpy) or len(quat) not in (0, 4) or len(rpy) not in (0, 3):
        raise InvalidTarget(f"'{file}' has the columns {', '.join([*quat, *rpy])}; the first line must be {forms}")
    names = (*needed, *quat, *rpy)
    twice = [name for name in names if header.count(name) > 1]
    if twice:
        raise InvalidTarget(f"'{file}' has the column {', '.join(twice)} more than once")
    return [header.index(name) for name in names]


def _other_separator(header: list[str]) -> str:
    """Return the tail of a sentence for a first line whose names are separated by something else."""
    other = next(
        (name for mark, name in ((";", "semicolons"), ("\t", "tabs")) if len(header) == 1 and mark in header[0]), ""
    )
    return f" (not {other}: columns are separated by commas, and decimals written with a point)" if other else ""


def _tip_columns(path: Path, tips: Sequence[str]) -> dict[str, list[int]]:
    """Return the indices of the columns TIP.x, ... of each tip that has any.

    Raises InvalidTarget if none has, or a name is wrong.
    """
    header = []
    for cell in _first_line(path):
        tip, dot, name = cell.rpartition(".")
        header.append(f"{tip}{dot}{name.lower()}")
        if dot and name.lower() in (*POSITION, *QUAT, *RPY) and tip not in tips:
            raise InvalidTarget(
                f"'{path.name}', column '{cell}': '{tip}' is not one of the tips solved for, {', '.join(tips)}."
                f"{near_match(tip, tips)}"
            )
    found = {
        tip: _places(header, path.name, [], f"{tip}.")
        for tip in tips
        if any(f"{tip}.{name}" in header for name in (*POSITION, *QUAT, *RPY))
    }
    if not found:
        forms = ",".join(f"{tip}.{name}" for tip in tips for name in POSITION)
        raise InvalidTarget(
            f"'{path.name}' has no columns of {', '.join(tips)}; its first line is {forms}, with .qx,.qy,.qz,.qw or "
            f".roll,.pitch,.yaw of a tip for its poses, not {_short(','.join(header))}{_other_separator(header)}"
        )
    return found


def _read_csv(path: Path, columns: dict[str, list[int]], width: int, times: bool, deg: bool) -> Iterator[PoseRows]:
    """Yield the blocks of a file with columns by tip ('' for poses without a name); its first line has `width` columns."""
    every = [place for places in columns.values() for place in places]
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            numbered = ((k, line) for k, line in enumerate(_lines(stream, path.name), 1) if k > 1 and line.strip())
            while block := list(islice(numbered, LINES)):
                lines = [k for k, _ in block]
                values = _numbers([line for _, line in block], every, width, lines, path.name)
                t, values = (values[:, 0], values[:, 1:]) if times else (None, values)
                made, first = {}, 0
                for tip, places in columns.items():
                    last = first + len(places) - times
                    made[tip] = _part(values[:, first:last], lines, path.name, deg, f"{tip}." if tip else "")
                    first = last
                yield PoseRows(t, made[""] if "" in made else made)
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidTarget(f"cannot read '{path.name}': {_said(error)}") from None


def _part(values: np.ndarray, lines: list[int], name: str, deg: bool, prefix: str) -> np.ndarray:
    """Return positions (m, 3), or poses from them and a quaternion or roll, pitch, yaw (m, 7 or 6)."""
    xyz, angles = values[:, :3], values[:, 3:]
    if not angles.shape[1]:
        return xyz
    kind = QUAT if angles.shape[1] == 4 else RPY
    return _poses(xyz, np.radians(angles) if deg and kind is RPY else angles, kind, lines, name, "line", prefix)


def _numbers(texts: list[str], columns: list[int], width: int, lines: list[int], name: str) -> np.ndarray:
    """Return finite numbers (m, columns) from lines of text, each of which has `width` columns."""
    try:
        if any(text.count(",") != width - 1 for text in texts):  # A comma in quotes has this effect too.
            raise ValueError
        values = np.loadtxt(texts, delimiter=",", usecols=columns, ndmin=2, comments=None, quotechar='"')
        if len(values) == len(texts) and np.isfinite(values).all():
            return values
    except ValueError:
        pass
    rows = []
    for k, text in zip(lines, texts, strict=True):  # Find the line at fault.
        try:
            row = next(csv.reader([text], strict=True))
        except csv.Error as error:
            raise InvalidTarget(f"'{name}', line {k}: {_said(error)}; unclosed quote?") from None
        if len(row) != width:
            hint = "; are decimals written with a comma?" if len(row) > width else ""
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
    xyz: np.ndarray,
    angles: np.ndarray,
    kind: Sequence[str],
    lines: Sequence[int],
    name: str,
    word: str,
    prefix: str = "",
) -> np.ndarray:
    """Return poses (m, 4, 4) from positions and quaternions or roll, pitch, yaw."""
    T = np.tile(np.eye(4), (len(xyz), 1, 1))
    T[:, :3, 3] = xyz
    if kind is QUAT:
        length = np.linalg.norm(angles, axis=1)
        bad = ~(np.abs(length - 1.0) < 1e-2)
        if bad.any():
            k = int(np.argmax(bad))
            raise InvalidTarget(
                f"'{name}', {word} {lines[k]}: the quaternion {','.join(prefix + x for x in QUAT)} has length "
                f"{length[k]:.4g}, not 1"
            )
        x, w = angles[:, :3] / length[:, None], 2.0 * angles[:, 3:] / length[:, None]
        T[:, :3, :3] = 2.0 * x[:, :, None] * x[:, None, :]
        T[:, [0, 1, 2], [0, 1, 2]] += 0.5 * w * w - 1.0
        T[:, [1, 2, 0], [0, 1, 2]] += w * x[:, [2, 0, 1]]
        T[:, [0, 1, 2], [1, 2, 0]] -= w * x[:, [2, 0, 1]]
    else:
        T[:, :3, :3] = np.moveaxis(rpy_matrix(angles.T), 2, 0)
    return T
