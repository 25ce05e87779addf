"""Poses from files: CSV or NPZ tables of positions, with rotations or without, and with times where they are asked for.

CSV: a first line that names x,y,z [m] and none or all of qx,qy,qz,qw or of roll,pitch,yaw (URDF order), and t [s] where times are
asked for, in any order; further columns are ignored. NPZ: `xyz` (N, 3) with `quat_xyzw` (N, 4) or none, and `t` (N,); without
times also `targets` (N, 4, 4) or (N, 3).
"""

import csv
import math
import zipfile
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidTarget, near_match
from .pose import rpy_matrix

LINES = 16384  # read at a time
POSITION, QUAT, RPY = ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("roll", "pitch", "yaw")
UNPACKED, EXPANSION = 2**30, 20  # bytes of an array, or so many times the file: poses pack to a fifth at best


class Block(NamedTuple):
    """Rows read at a time: t (m,) [s] or None, poses (m, 4, 4) or positions (m, 3)."""

    t: np.ndarray | None
    poses: np.ndarray


def read_poses(path: Path, what: str, *, times: bool = False, deg: bool = False) -> tuple[int, Iterator[Block]]:
    """Number of rows and the blocks of a file, one of NPZ and many of CSV; `what` the file holds is for messages.

    times: t is asked for as well. deg: roll, pitch and yaw are degrees, not radians. Raises InvalidTarget, naming the line (of a
    CSV for the lines that are read later, too).
    """
    if not path.is_file():
        raise InvalidTarget(f"there is no {what} file '{path}'")
    try:
        if path.suffix.lower() == ".npz":
            block = _read_npz(path, times)
            return len(block.poses), iter([block])
        if path.suffix.lower() != ".csv":
            raise InvalidTarget(f"a {what} file is .csv or .npz, not '{path.name}'")
        with path.open("rb") as stream:
            count = max(sum(block.count(b"\n") for block in iter(lambda: stream.read(1 << 20), b"")) - 1, 0)
        columns = _header(path, times)
        return count, _read_csv(path, columns, times, deg)
    except InvalidTarget:
        raise
    except Exception as error:  # damaged files raise whatever the decoders of zip, zlib, lzma, npy and csv meet
        raise InvalidTarget(f"cannot read '{path.name}': {_said(error)}") from None


def _said(error: Exception) -> str:
    """What an error of a decoder says, in one short line."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def _short(text: str) -> str:
    """Text out of a file, cut to what a message can hold."""
    return text if len(text) <= 80 else f"{text[:80]}..."


def _read_npz(path: Path, times: bool) -> Block:
    if not zipfile.is_zipfile(path):  # numpy would advise to unpickle it
        raise InvalidTarget(f"'{path.name}' is no NPZ file (see numpy.savez)")
    _check_size(path)
    with np.load(path, allow_pickle=False) as file:
        if "targets" in file and not times:
            targets = file["targets"]
            if targets.ndim not in (2, 3):
                raise InvalidTarget(f"'{path.name}': targets has the shape (N, 4, 4) or (N, 3), not {targets.shape}")
            return Block(None, targets)
        for name in ("t", "xyz") if times else ("xyz",):
            if name not in file:
                wanted = f"'{name}'" if times else "'targets' or 'xyz'"
                names = _short(", ".join(file)) or "nothing"
                raise InvalidTarget(f"'{path.name}' has no array {wanted}, only {names}.{near_match(name, list(file))}")
        t = np.asarray(file["t"], dtype=float) if times else None
        xyz = np.asarray(file["xyz"], dtype=float)
        quat = np.asarray(file["quat_xyzw"], dtype=float) if "quat_xyzw" in file else None
    if xyz.ndim != 2 or xyz.shape[1] != 3 or (quat is not None and quat.shape != (len(xyz), 4)):
        raise InvalidTarget(f"'{path.name}': xyz has the shape (N, 3) and quat_xyzw (N, 4)")
    return Block(t, xyz if quat is None else _poses(xyz, quat, QUAT, range(len(xyz)), path.name, "row"))


def _check_size(path: Path) -> None:
    """Refuse an archive that grows without measure when it is unpacked, or holds less than an array's head promises."""
    packed = path.stat().st_size
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if member.filename not in ("targets.npy", "t.npy", "xyz.npy", "quat_xyzw.npy"):
                continue
            if member.file_size > max(UNPACKED, EXPANSION * packed):
                raise InvalidTarget(
                    f"'{path.name}': {member.filename} unpacks to {member.file_size / 1e9:.1f} GB, out of "
                    f"{packed / 1e6:.1f} MB; save it with numpy.savez, without compression"
                )
            with archive.open(member) as stream:
                version = np.lib.format.read_magic(stream)
                read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                shape, _, dtype = read(stream)
                promised = math.prod(shape) * dtype.itemsize
                if promised > member.file_size:
                    raise InvalidTarget(
                        f"'{path.name}': {member.filename} promises {promised:,} bytes and holds {member.file_size:,}"
                    )


def _header(path: Path, times: bool) -> list[int]:
    """Places of the columns that count: t where asked for; 3, 7 (quaternion) or 6 (roll, pitch, yaw)."""
    with path.open(newline="", encoding="utf-8-sig") as stream:
        header = [cell.strip().lower() for cell in next(csv.reader(stream), [])]
    needed = (*(["t"] if times else []), *POSITION)
    first = ",".join(needed)
    forms = f"{first}, {first},{','.join(QUAT)} or {first},{','.join(RPY)}"
    missing = [name for name in needed if name not in header]
    if missing:
        raise InvalidTarget(
            f"'{path.name}' has no column {', '.join(missing)}; its first line must be {forms}, "
            f"not {_short(','.join(header))}"
        )
    quat, rpy = ([name for name in names if name in header] for names in (QUAT, RPY))
    if (quat and rpy) or len(quat) not in (0, 4) or len(rpy) not in (0, 3):
        raise InvalidTarget(f"'{path.name}' has the columns {', '.join([*quat, *rpy])}; the first line must be {forms}")
    return [header.index(name) for name in (*needed, *quat, *rpy)]


def _read_csv(path: Path, columns: list[int], times: bool, deg: bool) -> Iterator[Block]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            numbered = ((k, line) for k, line in enumerate(stream, 1) if k > 1 and line.strip())
            while block := list(islice(numbered, LINES)):
                lines = [k for k, _ in block]
                values = _numbers([line for _, line in block], columns, lines, path.name)
                t, values = (values[:, 0], values[:, 1:]) if times else (None, values)
                xyz, angles = values[:, :3], values[:, 3:]
                if angles.shape[1]:
                    kind = QUAT if angles.shape[1] == 4 else RPY
                    angles = np.radians(angles) if deg and kind is RPY else angles
                    xyz = _poses(xyz, angles, kind, lines, path.name, "line")
                yield Block(t, xyz)
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidTarget(f"cannot read '{path.name}': {_said(error)}") from None


def _numbers(texts: list[str], columns: list[int], lines: list[int], name: str) -> np.ndarray:
    """Finite numbers (m, columns) of lines of text."""
    try:
        values = np.loadtxt(texts, delimiter=",", usecols=columns, ndmin=2, comments=None, quotechar='"')
        if len(values) == len(texts) and np.isfinite(values).all():
            return values
    except ValueError:
        pass
    rows = []
    for k, text in zip(lines, texts, strict=True):  # find the line to name
        try:
            row = next(csv.reader([text], strict=True))
        except csv.Error as error:
            raise InvalidTarget(f"'{name}', line {k}: {_said(error)}; a quote that is not closed?") from None
        if len(row) <= max(columns):
            raise InvalidTarget(f"'{name}', line {k}: {len(row)} columns where the first line has more")
        for column in columns:
            try:
                good = np.isfinite(float(row[column]))
            except ValueError:
                good = False
            if not good:
                raise InvalidTarget(f"'{name}', line {k}: {_short(row[column].strip())!r} is not a finite number")
        rows.append([float(row[column]) for column in columns])
    return np.array(rows)


def _poses(xyz: np.ndarray, angles: np.ndarray, kind: Sequence[str], lines: Sequence[int], name: str, word: str) -> Any:
    """Poses (m, 4, 4) of positions and quaternions or roll, pitch, yaw."""
    T = np.tile(np.eye(4), (len(xyz), 1, 1))
    T[:, :3, 3] = xyz
    if kind is QUAT:
        length = np.linalg.norm(angles, axis=1)
        bad = ~(np.abs(length - 1.0) < 1e-2)
        if bad.any():
            k = int(np.argmax(bad))
            raise InvalidTarget(
                f"'{name}', {word} {lines[k]}: the quaternion qx,qy,qz,qw has length {length[k]:.4g}, not 1"
            )
        x, w = angles[:, :3] / length[:, None], 2.0 * angles[:, 3:] / length[:, None]
        T[:, :3, :3] = 2.0 * x[:, :, None] * x[:, None, :]
        T[:, [0, 1, 2], [0, 1, 2]] += 0.5 * w * w - 1.0
        T[:, [1, 2, 0], [0, 1, 2]] += w * x[:, [2, 0, 1]]
        T[:, [0, 1, 2], [1, 2, 0]] -= w * x[:, [2, 0, 1]]
    else:
        T[:, :3, :3] = np.moveaxis(rpy_matrix(angles.T), 2, 0)
    return T
