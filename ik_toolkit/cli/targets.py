"""`ik solve ROBOT --targets FILE`: many targets from a CSV or NPZ file, their solutions to a CSV, NPZ or Parquet file."""

import csv
import math
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from time import perf_counter
from typing import Any, NoReturn

import numpy as np
import typer

from ..errors import InvalidOption, InvalidTarget, MissingExtra
from ..robot.pose import rpy_matrix
from ..solvers.batch import solve_batch, solve_parts
from ..solvers.batch_result import BatchCheckFailed, BatchInterrupted, BatchResult
from .output import facts, notice, progress, show, write_json
from .solutions import OUTPUTS, Solutions
from .streams import uninterrupted

LINES = 16384  # read at a time
POSITION, QUAT, RPY = ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("roll", "pitch", "yaw")
UNPACKED, EXPANSION = 2**30, 20  # bytes of an array, or so many times the file: poses pack to a fifth at best
HEADER = "x,y,z, x,y,z,qx,qy,qz,qw or x,y,z,roll,pitch,yaw"


# ---------------------------------------------------------------------------------------------------------------- input
def read_targets(path: Path, deg: bool) -> tuple[int, Any]:
    """Number of targets and the targets of a file: an array (NPZ) or an iterator of arrays (CSV), see solve_batch.

    CSV: a header with x,y,z [m] and none or all of qx,qy,qz,qw or of roll,pitch,yaw [rad, or degrees when `deg`], in any
    order; further columns are ignored. NPZ: `targets` (N, 4, 4) or (N, 3), or `xyz` (N, 3) with `quat_xyzw` (N, 4) or none.
    Raises InvalidTarget, naming the line.
    """
    if not path.is_file():
        raise InvalidTarget(f"there is no targets file '{path}'")
    try:
        if path.suffix.lower() == ".npz":
            targets = _read_npz(path)
            return len(targets), targets
        if path.suffix.lower() != ".csv":
            raise InvalidTarget(f"a targets file is .csv or .npz, not '{path.name}'")
        with path.open("rb") as stream:
            count = max(sum(block.count(b"\n") for block in iter(lambda: stream.read(1 << 20), b"")) - 1, 0)
        columns = _header(path)
        return count, _read_csv(path, columns, deg)
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


def _read_npz(path: Path) -> np.ndarray:
    if not zipfile.is_zipfile(path):  # numpy would advise to unpickle it
        raise InvalidTarget(f"'{path.name}' is no NPZ file (see numpy.savez)")
    _check_size(path)
    with np.load(path, allow_pickle=False) as file:
        if "targets" in file:
            targets = file["targets"]
            if targets.ndim not in (2, 3):
                raise InvalidTarget(f"'{path.name}': targets has the shape (N, 4, 4) or (N, 3), not {targets.shape}")
            return targets
        if "xyz" not in file:
            names = _short(", ".join(file)) or "nothing"
            raise InvalidTarget(f"'{path.name}' has no array 'targets' or 'xyz', only {names}")
        xyz = np.asarray(file["xyz"], dtype=float)
        quat = np.asarray(file["quat_xyzw"], dtype=float) if "quat_xyzw" in file else None
    if xyz.ndim != 2 or xyz.shape[1] != 3 or (quat is not None and quat.shape != (len(xyz), 4)):
        raise InvalidTarget(f"'{path.name}': xyz has the shape (N, 3) and quat_xyzw (N, 4)")
    return xyz if quat is None else _poses(xyz, quat, QUAT, range(len(xyz)), path.name, "row")


def _check_size(path: Path) -> None:
    """Refuse an archive that grows without measure when it is unpacked, or holds less than an array's head promises."""
    packed = path.stat().st_size
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if member.filename not in ("targets.npy", "xyz.npy", "quat_xyzw.npy"):
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


def _header(path: Path) -> list[int]:
    """Places of the columns that count: 3, 7 (quaternion) or 6 (roll, pitch, yaw)."""
    with path.open(newline="", encoding="utf-8-sig") as stream:
        header = [cell.strip().lower() for cell in next(csv.reader(stream), [])]
    missing = [name for name in POSITION if name not in header]
    if missing:
        raise InvalidTarget(
            f"'{path.name}' has no column {', '.join(missing)}; its first line must be {HEADER}, "
            f"not {_short(','.join(header))}"
        )
    quat, rpy = ([name for name in names if name in header] for names in (QUAT, RPY))
    if (quat and rpy) or len(quat) not in (0, 4) or len(rpy) not in (0, 3):
        raise InvalidTarget(
            f"'{path.name}' has the columns {', '.join([*quat, *rpy])}; the first line must be {HEADER}"
        )
    return [header.index(name) for name in (*POSITION, *quat, *rpy)]


def _read_csv(path: Path, columns: list[int], deg: bool) -> Iterator[np.ndarray]:
    try:
        yield from _blocks(path, columns, deg)
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidTarget(f"cannot read '{path.name}': {_said(error)}") from None


def _blocks(path: Path, columns: list[int], deg: bool) -> Iterator[np.ndarray]:
    with path.open(newline="", encoding="utf-8-sig") as stream:
        numbered = ((k, line) for k, line in enumerate(stream, 1) if k > 1 and line.strip())
        while block := list(islice(numbered, LINES)):
            lines = [k for k, _ in block]
            values = _numbers([line for _, line in block], columns, lines, path.name)
            if len(columns) == 3:
                yield values
            elif len(columns) == 7:
                yield _poses(values[:, :3], values[:, 3:], QUAT, lines, path.name, "line")
            else:
                angles = np.radians(values[:, 3:]) if deg else values[:, 3:]
                yield _poses(values[:, :3], angles, RPY, lines, path.name, "line")


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


@contextmanager
def _cluster(address: str | None) -> Iterator[Any]:
    """Executor of a Dask scheduler that is already there; lost tasks are tried again by Dask."""
    if address is None:
        yield None
        return
    try:
        from distributed import Client  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise MissingExtra("distributed", "cluster") from None
    try:
        client = Client(address, timeout=5)
    except (OSError, ValueError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InvalidOption(f"no Dask scheduler answers at '{address}': {said}") from None
    with client:
        yield client.get_executor(retries=3)


class _Tally:
    """What is told of the parts of a batch."""

    def __init__(self) -> None:
        self.done, self.solver = 0, ""
        self.statuses: dict[str, int] = {}
        self.flips: list[int] = []

    def add(self, part: BatchResult) -> None:
        for status, number in part.counts().items():
            self.statuses[status] = self.statuses.get(status, 0) + number
        if part.flips is not None:
            self.flips.extend((self.done + part.flips).tolist())
        self.done, self.solver = self.done + len(part), part.solver


def _solve_into(output: Path, arm: Any, targets: Any, method: Any, asked: dict[str, Any], show_done: Any) -> _Tally:
    """Solve and write all targets; parts as they come where the format takes parts."""
    tally = _Tally()
    parts: Iterator[BatchResult] = iter(())
    many, interrupted = None, None
    try:
        if output.suffix.lower() == ".npz":
            many = solve_batch(arm, targets, method, progress=show_done, **asked)
        else:
            parts = solve_parts(arm, targets, method, **asked)
    except BatchInterrupted as stop:
        many, interrupted = stop.result, stop
    except BatchCheckFailed as failure:
        _refuse(failure, Solutions(output, arm.joint_names))
    with Solutions(output, arm.joint_names) as file:  # opened only when the options are found good
        try:
            for part in parts if many is None else iter([many]):
                with uninterrupted():
                    file.add(part)
                    tally.add(part)
                show_done(tally.done)
        except BatchCheckFailed as failure:
            _refuse(failure, file)
        if interrupted is not None:
            raise interrupted
    return tally


def _refuse(failure: BatchCheckFailed, file: Solutions) -> NoReturn:
    """Say why a batch failed and where its answers are; exit code 1."""
    file.add(failure.result)
    failed = file.fail()
    notice(f"ik: {failure}")
    notice(f"the answers, all of them in doubt, are in {failed}")
    raise typer.Exit(1)


def solve_file(
    arm: Any,
    path: Path,
    output: Path | None,
    method: Any,
    start: Any,
    options: dict[str, Any],
    *,
    threads: int | None,
    chain: bool,
    cluster: str | None,
    deg: bool,
    as_json: bool,
) -> None:
    """Solve all targets of a file and write their solutions; exit code 1 when any is not solved.

    What is finished when Ctrl-C or SIGTERM comes is kept as NAME.partial. When Pinocchio does not confirm an answer, what there
    is goes to NAME.failed, and the exit code is 1.
    """
    if output is None or output.suffix.lower() not in OUTPUTS:
        raise InvalidOption(f"--targets needs -o FILE for the solutions, which ends in {', '.join(OUTPUTS)}")
    count, targets = read_targets(path, deg)
    began = perf_counter()
    with _cluster(cluster) as executor, progress("solving", count) as show_done:
        asked: dict[str, Any] = {"q0": start, "threads": threads, "chain": chain, "executor": executor, **options}
        tally = _solve_into(output, arm, targets, method, asked, show_done)
    done, flips = tally.done, tally.flips
    elapsed = perf_counter() - began
    notice(f"wrote {output}")
    solved = tally.statuses.get("CONVERGED", 0)
    payload = {"robot": arm.name, "solver": tally.solver, "targets": done, "solved": solved, "statuses": tally.statuses}
    payload |= {"joint_names": arm.joint_names, "elapsed": elapsed, "output": output, "seed": options["seed"]}
    write_json(payload | ({"flips": flips} if chain else {}), as_json)
    if not as_json:
        others = ", ".join(f"{number} {status}" for status, number in tally.statuses.items() if status != "CONVERGED")
        listed = ", ".join(map(str, flips[:10])) + (", ..." if len(flips) > 10 else "")
        rate = f"{elapsed:.3g} s, {done / elapsed:.3g} targets/s with reading and writing"
        facing = {
            "solved": f"{solved} of {done}",
            "not solved": others or None,
            "solver": tally.solver or None,
            "time": rate,
        }
        if chain:
            facing["flips"] = f"{len(flips)} (targets {listed}, counted from 0)" if flips else "none"
        show(facts(facing))
    if solved < done:
        raise typer.Exit(1)
