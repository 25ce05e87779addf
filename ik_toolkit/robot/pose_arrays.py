"""Poses from NPZ and JSON files, as arrays; a row of numbers that cannot be used is named, counted from 0 as numpy does."""

import json
import re
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidTarget, near_match
from ..files import NAMES, NUMBERS, check_arrays, read_json, why_unread
from .pose import as_array
from .ros import listed_poses
from .rotation import rotation_columns

QUAT = ("qx", "qy", "qz", "qw")
FORMS = {  # What a file of targets may contain, by suffix, for error messages.
    ".json": 'JSON has a list of positions, [[0.5, 0.1, 0.3]], or poses (4, 4), or an object with lists "xyz" and "quat_xyzw"',
    ".npz": "NPZ has an array xyz (N, 3), with quat_xyzw (N, 4) for poses, or targets (N, 4, 4) or (N, 3)",
}
# For each order of a quaternion's numbers, the columns in which x, y, z and w are.
ORDERS = {"quat_xyzw": [0, 1, 2, 3], "quat_wxyz": [1, 2, 3, 0]}


def short(text: str) -> str:
    """Cut a text from a file to 80 characters, for a message."""
    return text if len(text) <= 80 else f"{text[:80]}..."


def row_numbers(word: str, numbers: Sequence[int]) -> str:
    """Return row or line numbers as text, such as 'line 4' or 'lines 4, 7 and 9'; of more than five the others are counted."""
    texts = [str(number) for number in numbers[:5]]
    texts += [f"{len(numbers) - 5} more"] if len(numbers) > 5 else []
    return f"{word} {texts[0]}" if len(texts) == 1 else f"{word}s {', '.join(texts[:-1])} and {texts[-1]}"


@contextmanager
def _arrays(path: Path, names: Sequence[str], base: str) -> Iterator[Any]:
    """Yield the arrays of an NPZ or JSON file by name; only those in `names` are checked and converted.

    base: frame in which ROS messages of a JSON file must be given, as in `ros.read_pose`. Raises InvalidTarget.
    """
    if not path.stat().st_size:
        raise InvalidTarget(f"'{path.name}' is empty; {FORMS[path.suffix.lower()]}")
    if path.suffix.lower() == ".json":
        content = read_json(path, InvalidTarget)
        poses = listed_poses(content, base)
        content = (
            content if isinstance(content, dict) and poses is None else {"targets": content if poses is None else poses}
        )
        yield {name: _array(path, name, content[name], base) if name in names else None for name in content}
        return
    # A file that is not NPZ is refused before np.load reads it, whose error would suggest to unpickle it, which is unsafe.
    if not zipfile.is_zipfile(path):
        raise InvalidTarget(f"'{path.name}' is not an NPZ file (see numpy.savez)")
    check_arrays(path, names, ("tips",), InvalidTarget)
    with np.load(path, allow_pickle=False) as file:
        yield file


def _array(path: Path, name: str, value: Any, base: str) -> np.ndarray:
    """Return numbers (or names, or ROS messages of poses) from JSON as an array."""
    if name == "tips":
        if not isinstance(value, list) or not all(isinstance(one, str) and len(one) < NAMES // 4 for one in value):
            raise InvalidTarget(f"'{path.name}': tips must be a list of names")
        return np.array(value, dtype=object)
    array = _as_numbers(value)
    if array is not None:
        return array
    if isinstance(value, list) and value:
        rows = [_as_numbers(_of_message(path, k, row, base)) for k, row in enumerate(value)]
        shape = next((row.shape for row in rows if row is not None), ())
        wrong = [k for k, row in enumerate(rows) if row is None or row.shape != shape]
        if not wrong:  # Every row could be read as an array, and all have the same shape.
            return np.array(rows)
        more = f"; so {'are' if wrong[2:] else 'is'} {row_numbers('row', wrong[1:])}" if wrong[1:] else ""
        many = f" {shape[0]}" if len(shape) == 1 else ""
        at, found = f"row {wrong[0]} of {name} (counted from 0)", short(json.dumps(value[wrong[0]]))
        raise InvalidTarget(f"'{path.name}': {at} is {found}, not{many} numbers{more}")
    raise InvalidTarget(f"'{path.name}': {name} must be lists of numbers, not {' '.join(repr(value).split())[:120]}")


def _of_message(path: Path, k: int, row: Any, base: str) -> Any:
    """Return the array of a ROS message with a pose or point, and any other row as it is."""
    try:
        return as_array(row, base) if isinstance(row, dict) else row
    except InvalidTarget as error:
        raise InvalidTarget(f"'{path.name}', row {k} (counted from 0): {error}") from None


def _as_numbers(value: Any) -> np.ndarray | None:
    """Return lists of numbers as an array of floats; None if they are anything else."""
    # The function `floats` of errors.py is not used here, because its checks would be slow for many rows.
    with suppress(TypeError, ValueError, OverflowError):
        if (array := np.array(value)).dtype.kind in NUMBERS:
            return array.astype(float)
    return None


def _require_rows(path: Path, name: str, array: np.ndarray) -> None:
    """Raise InvalidTarget if an array of targets has no rows, or rows with numbers that are not finite."""
    if not array.shape or not len(array):
        raise InvalidTarget(f"'{path.name}': {name} has no rows; {FORMS[path.suffix.lower()]}")
    bad = np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1)).tolist()
    if bad:
        at = f"{row_numbers('row', bad)} of {name} (counted from 0) {'have' if bad[1:] else 'has'}"
        raise InvalidTarget(f"'{path.name}': {at} numbers that are not finite; fill them in, or leave the rows out")


def _refuse_rotations(path: Path, names: Iterable[str]) -> None:
    """Raise InvalidTarget if one of the `names` of arrays that stand beside positions is that of rotations."""
    # A saved run may have arrays of orientation errors and tolerances, which are not rotations of the targets.
    others = [name for name in map(str.lower, names) if not re.search("error|between|tolerance", name)]
    if unread := rotation_columns(others):
        raise InvalidTarget(f"'{path.name}': {', '.join(unread)} would not be read; {FORMS[path.suffix.lower()]}")


def read_arrays(path: Path, times: bool, base: str) -> tuple[np.ndarray | None, np.ndarray]:
    """Read targets from an NPZ or JSON file: return times t (N,) [s] (None unless `times`) and poses (N, 4, 4) or positions (N, 3).

    `base` is the frame in which ROS messages in the file must be given, '' for any. Raises InvalidTarget.
    """
    with _arrays(path, ("targets", "t", "xyz", *ORDERS), base) as file:
        if "targets" in file and not times:
            targets = np.asarray(file["targets"], dtype=float)
            _require_rows(path, "targets", targets)
            if targets.ndim not in (2, 3):
                raise InvalidTarget(f"'{path.name}': targets has the shape (N, 4, 4) or (N, 3), not {targets.shape}")
            if targets.shape[1:] == (3,):
                _refuse_rotations(path, file)
            return None, targets
        for name in ("t", "xyz") if times else ("xyz",):
            if name not in file:
                wanted = f"'{name}'" if times else "'targets' or 'xyz'"
                names = f"only {listing}" if (listing := short(", ".join(file))) else "and no other"
                meant = near_match(name, list(file)) or f" {FORMS[path.suffix.lower()]}"
                raise InvalidTarget(f"'{path.name}' has no array {wanted}, {names}.{meant}")
        t = np.asarray(file["t"], dtype=float) if times else None
        xyz = np.asarray(file["xyz"], dtype=float)
        given = [name for name in ORDERS if name in file]
        if len(given) > 1:
            raise InvalidTarget(f"'{path.name}' has {' and '.join(given)}; give only one of them")
        quat = np.asarray(file[given[0]], dtype=float) if given else None
        if quat is None:
            _refuse_rotations(path, file)
    for name, array in (("t", t), ("xyz", xyz), ("".join(given), quat)):
        if array is not None:
            _require_rows(path, name, array)
    if xyz.ndim != 2 or xyz.shape[1] != 3 or (quat is not None and quat.shape != (len(xyz), 4)):
        raise InvalidTarget(f"'{path.name}': xyz has the shape (N, 3) and {' or '.join(given or ORDERS)} (N, 4)")
    if t is not None:
        if t.shape != (len(xyz),):
            raise InvalidTarget(
                f"'{path.name}': t must be {len(xyz)} numbers, one per pose, not an array of shape {t.shape}"
            )
        require_increasing(t, range(len(t)), path.name, "row")
    if quat is not None:
        quat = quat[:, ORDERS[given[0]]]
    return t, xyz if quat is None else quaternion_poses(xyz, quat, range(len(xyz)), path.name, "row")


def read_named(path: Path, names: Sequence[str]) -> list[np.ndarray]:
    """Return the arrays called `names` of an NPZ file, as float64, in this order. Raises InvalidTarget if one is missing."""
    try:
        with _arrays(path, names, "") as file:
            missing = [name for name in names if name not in file]
            if missing:
                raise InvalidTarget(f"'{path.name}' has no array '{missing[0]}'.{near_match(missing[0], list(file))}")
            return [np.array(file[name], dtype=float) for name in names]
    except InvalidTarget:
        raise
    except Exception as error:  # damaged files raise many types of errors
        raise InvalidTarget(f"cannot read '{path.name}': {why_unread(error)}") from None


def require_increasing(t: np.ndarray, numbers: Sequence[int], name: str, word: str) -> None:
    """Raise InvalidTarget unless the times t (N,) [s] increase.

    The message names the file (`name`) and the faulty row, as `word` ('line' or 'row') with its number in `numbers` (N,).
    """
    back = np.flatnonzero(~(np.diff(t) > 0.0))
    if len(back):
        i = int(back[0])
        from_0 = " (counted from 0)" if word == "row" else ""
        raise InvalidTarget(
            f"'{name}', {word} {numbers[i + 1]}{from_0}: t must increase, and {t[i + 1]:g} comes after {t[i]:g}"
        )


def read_tip_arrays(path: Path, tips: Sequence[str], base: str) -> dict[str, np.ndarray]:
    """Read targets of several tips from an NPZ or JSON file: return poses (N, 4, 4) or positions (N, 3), by tip.

    Lengths stay in the unit of the file. `base` is the frame in which ROS messages in the file must be given, '' for any. Raises
    InvalidTarget.
    """
    with _arrays(path, ("targets", "tips", *tips), base) as file:
        named = {tip: np.asarray(file[tip], dtype=float) for tip in tips if tip in file}
        order = file["tips"].tolist() if "tips" in file else list(tips)
        targets = np.asarray(file["targets"], dtype=float) if "targets" in file and not named else None
        names = list(file)
    if targets is None:
        beside = [name for name in names if name not in tips]
        strange = [name for name in beside if near_match(name, tips) or name.rpartition(".")[0] in tips]
        if strange or not named:
            raise InvalidTarget(
                f"'{path.name}' needs an array 'targets', or one by the name of each tip ({', '.join(tips)}); it has "
                f"{short(', '.join(names)) or 'nothing'}.{near_match((strange or names or [''])[0], tips)}"
            )
        for tip, array in named.items():
            if array.shape[1:] not in ((4, 4), (3,)):
                raise InvalidTarget(f"'{path.name}': {tip} has the shape (N, 4, 4) or (N, 3), not {array.shape}")
        if len({len(array) for array in named.values()}) > 1:
            rows = ", ".join(f"{tip} has {len(array)}" for tip, array in named.items())
            raise InvalidTarget(f"'{path.name}': every tip needs the same number of rows; {rows}")
        for tip, array in named.items():
            _require_rows(path, tip, array)
        return named
    _require_rows(path, "targets", targets)
    for tip in order:
        if tip not in tips:
            raise InvalidTarget(f"'{path.name}': '{tip}' of 'tips' is not solved for.{near_match(str(tip), tips)}")
    if targets.shape[1:] not in ((len(order), 4, 4), (len(order), 3)) or len(set(order)) < len(order):
        raise InvalidTarget(
            f"'{path.name}': targets of {', '.join(order)} have the shape (N, {len(order)}, 4, 4) or (N, {len(order)}, 3), "
            f"not {targets.shape}"
        )
    if targets.ndim == 3:
        _refuse_rotations(path, [name for name in names if name not in tips])
    return {tip: targets[:, f] for f, tip in enumerate(order)}


def quaternion_poses(
    xyz: np.ndarray, quat: np.ndarray, lines: Sequence[int], name: str, word: str, prefix: str = ""
) -> np.ndarray:
    """Make poses (m, 4, 4) of positions xyz (m, 3) and quaternions x, y, z, w (m, 4).

    Raises InvalidTarget for a quaternion whose length differs from 1 by 1 % or more. The message names the file (`name`), the row,
    as `word` ('line' or 'row') with its number in `lines` (m,), and the columns, as qx, qy, qz, qw after `prefix`.
    """
    length = np.linalg.norm(quat, axis=1)
    bad = ~(np.abs(length - 1.0) < 1e-2)
    if bad.any():
        k, *others = np.flatnonzero(bad).tolist()
        at = f"{word} {lines[k]}{' (counted from 0)' if word == 'row' else ''}"
        more = f"; nor in {row_numbers(word, [lines[other] for other in others])}" if others else ""
        names = ",".join(prefix + x for x in QUAT)
        raise InvalidTarget(f"'{name}', {at}: the quaternion {names} has length {length[k]:.4g}, not 1{more}")
    T = np.tile(np.eye(4), (len(xyz), 1, 1))
    T[:, :3, 3] = xyz
    x, w = quat[:, :3] / length[:, None], 2.0 * quat[:, 3:] / length[:, None]
    T[:, :3, :3] = 2.0 * x[:, :, None] * x[:, None, :]
    T[:, [0, 1, 2], [0, 1, 2]] += 0.5 * w * w - 1.0
    T[:, [1, 2, 0], [0, 1, 2]] += w * x[:, [2, 0, 1]]
    T[:, [0, 1, 2], [1, 2, 0]] -= w * x[:, [2, 0, 1]]
    return T
