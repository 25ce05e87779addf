"""`ik solve ROBOT --targets FILE`: many targets from a CSV or NPZ file, their solutions to a CSV, NPZ or Parquet file."""

import csv
import io
import signal
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
from ..solvers.result import Status
from .common import facts, notice, show, write_json

LINES = 16384  # read at a time
POSITION, QUAT, RPY = ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("roll", "pitch", "yaw")
HEADER = "x,y,z, x,y,z,qx,qy,qz,qw or x,y,z,roll,pitch,yaw"
OUTPUTS = (".csv", ".npz", ".parquet")


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
    except (OSError, UnicodeDecodeError, EOFError, ValueError, zipfile.BadZipFile) as error:
        if isinstance(error, InvalidTarget):
            raise
        raise InvalidTarget(f"cannot read '{path.name}': {error}") from None


def _read_npz(path: Path) -> np.ndarray:
    if not zipfile.is_zipfile(path):  # numpy would advise to unpickle it
        raise InvalidTarget(f"'{path.name}' is no NPZ file (see numpy.savez)")
    with np.load(path, allow_pickle=False) as file:
        if "targets" in file:
            return file["targets"]
        if "xyz" not in file:
            raise InvalidTarget(f"'{path.name}' has no array 'targets' or 'xyz', only {', '.join(file) or 'nothing'}")
        xyz = np.asarray(file["xyz"], dtype=float)
        quat = np.asarray(file["quat_xyzw"], dtype=float) if "quat_xyzw" in file else None
    if xyz.ndim != 2 or xyz.shape[1] != 3 or (quat is not None and quat.shape != (len(xyz), 4)):
        raise InvalidTarget(f"'{path.name}': xyz has the shape (N, 3) and quat_xyzw (N, 4)")
    return xyz if quat is None else _poses(xyz, quat, QUAT, range(len(xyz)), path.name, "row")


def _header(path: Path) -> list[int]:
    """Places of the columns that count: 3, 7 (quaternion) or 6 (roll, pitch, yaw)."""
    with path.open(newline="", encoding="utf-8-sig") as stream:
        header = [cell.strip().lower() for cell in next(csv.reader(stream), [])]
    missing = [name for name in POSITION if name not in header]
    if missing:
        raise InvalidTarget(
            f"'{path.name}' has no column {', '.join(missing)}; its first line must be {HEADER}, not {','.join(header)}"
        )
    quat, rpy = ([name for name in names if name in header] for names in (QUAT, RPY))
    if (quat and rpy) or len(quat) not in (0, 4) or len(rpy) not in (0, 3):
        raise InvalidTarget(
            f"'{path.name}' has the columns {', '.join([*quat, *rpy])}; the first line must be {HEADER}"
        )
    return [header.index(name) for name in (*POSITION, *quat, *rpy)]


def _read_csv(path: Path, columns: list[int], deg: bool) -> Iterator[np.ndarray]:
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
    for k, row in zip(lines, csv.reader(texts), strict=True):  # find the line to name
        if len(row) <= max(columns):
            raise InvalidTarget(f"'{name}', line {k}: {len(row)} columns where the first line has more")
        for column in columns:
            try:
                good = np.isfinite(float(row[column]))
            except ValueError:
                good = False
            if not good:
                raise InvalidTarget(f"'{name}', line {k}: {row[column].strip()!r} is not a finite number")
    return np.array([[float(row[column]) for column in columns] for row in csv.reader(texts)])


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


# --------------------------------------------------------------------------------------------------------------- output
def _columns(part: BatchResult, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Columns of a table of solutions, by name: joints [rad or m], status and errors [m, rad], counts."""
    words = {int(status): status.name for status in Status}
    statuses = np.array([words.get(k, "") for k in range(max(words) + 1)])
    columns = dict(zip(names, part.q.T, strict=True)) | {"status": statuses[part.status]}
    rest = part.to_dict()
    return columns | {name: rest[name] for name in rest if name not in ("q", "status", "success")}


class _CsvWriter:
    """Appends parts to a CSV file, numbers written so that they read back the same."""

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self.names = names
        self.stream = path.open("w", newline="", encoding="utf-8")
        self.writer = csv.writer(self.stream)
        self.started = False

    def add(self, part: BatchResult) -> None:
        columns = _columns(part, self.names)
        if not self.started:
            self.writer.writerow(columns)
        self.started = True
        lines = io.StringIO()  # a part is written whole or not at all: Ctrl-C falls before or after it
        csv.writer(lines).writerows(zip(*(column.tolist() for column in columns.values()), strict=True))
        self.stream.write(lines.getvalue())

    def close(self) -> None:
        self.stream.close()


class _ParquetWriter:
    """Appends parts to a Parquet file as row groups."""

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        try:
            import pyarrow  # pyright: ignore[reportMissingImports]
            import pyarrow.parquet  # pyright: ignore[reportMissingImports]
        except ImportError:
            raise InvalidOption("a .parquet file needs pyarrow, which is not installed; use .csv or .npz") from None
        self.arrow, self.path, self.names, self.file = pyarrow, path, names, None

    def add(self, part: BatchResult) -> None:
        table = self.arrow.table(_columns(part, self.names))
        if self.file is None:
            self.file = self.arrow.parquet.ParquetWriter(self.path, table.schema)
        self.file.write_table(table)

    def close(self) -> None:
        if self.file is not None:
            self.file.close()


@contextmanager
def _progress(count: int) -> Iterator[Any]:
    """Bar on stderr where that is a terminal; gives a function of the number done."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = TextColumn("solving"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=count)
        yield lambda done: bar.update(task, completed=done)


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Ctrl-C waits for the end of what is inside: a file written by half is lost."""
    came = []
    before = signal.signal(signal.SIGINT, lambda *_: came.append(True))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came:
        raise KeyboardInterrupt


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


def _refuse(failure: BatchCheckFailed, failed: Path) -> NoReturn:
    """Say why a batch failed and where its answers are; exit code 1."""
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

    What is finished when Ctrl-C comes is kept in the output file. When Pinocchio does not confirm an answer, what there is goes
    to NAME.failed, and the exit code is 1.
    """
    if output is None or output.suffix.lower() not in OUTPUTS:
        raise InvalidOption(f"--targets needs -o FILE for the solutions, which ends in {', '.join(OUTPUTS)}")
    if output.resolve() == path.resolve():
        raise InvalidOption(f"-o would overwrite the targets file '{path}'")
    count, targets = read_targets(path, deg)
    began = perf_counter()
    tally: dict[str, int] = {}
    flips: list[int] = []
    done, name = 0, ""
    names = arm.joint_names
    failed = output.with_name(f"{output.name}.failed")

    def add(part: BatchResult) -> None:
        nonlocal done, name
        for status, number in part.counts().items():
            tally[status] = tally.get(status, 0) + number
        if part.flips is not None:
            flips.extend((done + part.flips).tolist())
        done, name = done + len(part), part.solver

    with _cluster(cluster) as executor, _progress(count) as show_done:
        asked: dict[str, Any] = {"q0": start, "threads": threads, "chain": chain, "executor": executor, **options}
        if output.suffix.lower() == ".npz":
            interrupted: KeyboardInterrupt | None = None
            try:
                many = solve_batch(arm, targets, method, progress=show_done, **asked)
            except BatchInterrupted as stop:
                many, interrupted = stop.result, stop
            except BatchCheckFailed as failure:
                with failed.open("wb") as stream:
                    np.savez(stream, **failure.result.to_dict(), joint_names=np.array(names))
                _refuse(failure, failed)
            try:
                with _uninterrupted():
                    add(many)
                    np.savez(output, **many.to_dict(), joint_names=np.array(names))
            except KeyboardInterrupt as stop:
                interrupted = stop
            if interrupted:
                notice(f"the first {done} solutions are in {output}")
                raise interrupted
        else:
            parts = solve_parts(arm, targets, method, **asked)  # opened only when the options are found good
            writer = (_CsvWriter if output.suffix.lower() == ".csv" else _ParquetWriter)(output, names)
            try:
                for part in parts:
                    writer.add(part)
                    add(part)
                    show_done(done)
            except BatchCheckFailed as failure:
                writer.add(failure.result)
                writer.close()
                output.replace(failed)
                _refuse(failure, failed)
            except BaseException:
                if done:
                    notice(f"the first {done} solutions are in {output}")
                raise
            finally:
                writer.close()
    elapsed = perf_counter() - began
    notice(f"wrote {output}")
    solved = tally.get("CONVERGED", 0)
    payload = {"robot": arm.name, "solver": name, "targets": done, "solved": solved, "statuses": tally}
    payload |= {"joint_names": names, "elapsed": elapsed, "output": output, "seed": options["seed"]}
    write_json(payload | ({"flips": flips} if chain else {}), as_json)
    if not as_json:
        others = ", ".join(f"{number} {status}" for status, number in tally.items() if status != "CONVERGED")
        listed = ", ".join(map(str, flips[:10])) + (", ..." if len(flips) > 10 else "")
        rate = f"{elapsed:.3g} s, {done / elapsed:.3g} targets/s with reading and writing"
        facing = {"solved": f"{solved} of {done}", "not solved": others or None, "solver": name or None, "time": rate}
        if chain:
            facing["flips"] = f"{len(flips)} (targets {listed}, counted from 0)" if flips else "none"
        show(facts(facing))
    if solved < done:
        raise typer.Exit(1)
