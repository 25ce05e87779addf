"""`ik solve ROBOT --targets FILE`: many targets from a CSV or NPZ file, their solutions to a CSV, NPZ or Parquet file."""

import contextlib
import csv
import io
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any, NoReturn

import numpy as np
import typer

from ..compile.jit import compile_time
from ..errors import InvalidOption, MissingExtra
from ..files import PARTIAL, WholeFile, as_output, inert
from ..robot.pose_files import Convention, read_poses
from ..solvers.batch.result import BatchCheckFailed, BatchInterrupted, BatchResult
from ..solvers.batch.solve_batch import solve_batch, solve_parts
from ..solvers.status import Status
from ..text import duration, figure
from .output import notice, progress, show, write_json
from .streams import uninterrupted


def _columns(part: BatchResult, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the columns of a table of solutions, by name: joints [rad or m], status and errors [m, rad], counts."""
    words = {int(status): status.name for status in Status}
    statuses = np.array([words.get(k, "") for k in range(max(words) + 1)])
    columns = dict(zip(names, part.q.T, strict=True)) | {"status": statuses[part.status]}
    rest = part.to_dict()
    return columns | {name: rest[name] for name in rest if name not in ("q", "status", "success")}


class Solutions:
    """Output file for the solutions of many targets, used in a `with` block that calls `add` for each part of the results.

    At the end of the block the file is complete and gets its name. If an exception ends the block, the parts written before are
    kept as NAME.partial, and a notice says so; `fail` keeps them as NAME.failed. There is a subclass for each file format.
    """

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        """Open a temporary file next to `path`; names: names of the joints. Raises InvalidOption, OSError."""
        self.file, self.names, self.count = WholeFile(path), names, 0
        # The writer of a CSV or Parquet file (csv.writer, ParquetWriter); None until the first part is written.
        self.table: Any = None

    def write(self, part: BatchResult) -> None:
        """Write one part of the results to the file; each subclass has its own format."""
        raise NotImplementedError

    def close(self) -> None:
        """Write what the file format needs at its end, by default nothing."""

    def add(self, part: BatchResult) -> None:
        """Append one part of the results to the file, and add its targets to `count`."""
        with self.file.named():  # Adds the name of the file to errors of numpy and pyarrow, which lack it.
            self.write(part)
        self.count += len(part)

    def fail(self) -> Path | None:
        """Close the file and keep it as NAME.failed. Returns its path, or None if it could not be kept."""
        self.close()
        return self.file.keep(".failed")

    def __enter__(self) -> "Solutions":
        """Return the object itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: Any) -> None:
        """Rename the temporary file to its final name, or to NAME.partial after an exception."""
        with uninterrupted():
            if kind is None:
                self.close()
                self.file.finish()
            elif self.count and not self.file.stream.closed:
                with contextlib.suppress(OSError):
                    self.close()
                if kept := self.file.keep(PARTIAL):
                    notice(f"partial: the first {self.count} solutions are in {kept}")
            else:
                self.file.drop()


class CsvSolutions(Solutions):
    """A CSV file of solutions, to which each part is appended; numbers are written with all their digits."""

    def write(self, part: BatchResult) -> None:
        """Append one part of the results as rows, with one call, so that none of its rows is cut off."""
        columns = _columns(part, self.names)
        lines = io.StringIO()
        writer = csv.writer(lines)
        if self.table is None:
            writer.writerow(map(inert, columns))
        self.table = writer
        writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))
        self.file.write(lines.getvalue())


class NpzSolutions(Solutions):
    """An NPZ file of solutions, written in one part; with several tips it also holds their names."""

    def write(self, part: BatchResult) -> None:
        """Write the results of all targets as arrays, with the names of the joints."""
        robot = part.plan.robot
        tips: dict[str, Any] = {"tips": np.array(robot.tips)} if robot.named_tips else {}
        np.savez(self.file.stream, **part.to_dict(), joint_names=np.array(self.names), **tips)
        self.file.mark()


class ParquetSolutions(Solutions):
    """A Parquet file of solutions, to which each part is appended as a row group."""

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        """Write to a file. Raises InvalidOption without pyarrow."""
        try:
            import pyarrow  # pyright: ignore[reportMissingImports]
            import pyarrow.parquet  # pyright: ignore[reportMissingImports]
        except ImportError:
            raise InvalidOption("a .parquet file needs pyarrow, which is not installed; use .csv or .npz") from None
        self.arrow = pyarrow
        super().__init__(path, names)

    def write(self, part: BatchResult) -> None:
        """Append one part of the results as a row group."""
        table = self.arrow.table(_columns(part, self.names))
        if self.table is None:
            self.table = self.arrow.parquet.ParquetWriter(self.file.stream, table.schema)
        self.table.write_table(table)

    def close(self) -> None:
        """Write the footer, without which the file cannot be read."""
        if self.table is not None:
            self.table.close()
            self.table = None
            self.file.mark()


FORMATS = {".csv": CsvSolutions, ".npz": NpzSolutions, ".parquet": ParquetSolutions}


# ---------------------------------------------------------------------------------------------------------- the command
@contextmanager
def cluster_of(address: str | None) -> Iterator[Any]:
    """Context manager: yield an executor that runs tasks on the Dask scheduler at `address`, or None if that is None.

    A task whose worker is lost is run again, up to three times. Raises MissingExtra, and InvalidOption if no scheduler answers.
    """
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
    """Sums over all parts of a batch."""

    def __init__(self) -> None:
        self.done, self.solver, self.failed, self.notice = 0, "", "", ""
        self.statuses: Counter[str] = Counter()

    def add(self, part: BatchResult) -> None:
        self.statuses.update(part.counts())
        if not self.failed and not part.success.all():
            k = int(part.success.argmin())
            first = part[k]
            self.failed = f"target {self.done + k + 1}, the first not solved: {first.status.name}: {first.message}"
        self.done, self.solver, self.notice = self.done + len(part), part.solver, part.notice


def _solve_into(output: Path, arm: Any, targets: Any, method: Any, asked: dict[str, Any], show_done: Any) -> _Tally:
    """Solve all targets and write the solutions, part by part if the file format allows it."""
    tally, form = _Tally(), FORMATS[output.suffix.lower()]
    parts: Iterator[BatchResult] = iter(())
    many, interrupted = None, None
    try:
        if form is NpzSolutions:
            many = solve_batch(arm, targets, method, progress=show_done, **asked)
        else:
            parts = solve_parts(arm, targets, method, **asked)
    except BatchInterrupted as stop:
        many, interrupted = stop.result, stop
    except BatchCheckFailed as failure:
        _refuse(failure, form(output, arm.joint_names))
    with form(output, arm.joint_names) as file:  # Opened only here, so that refused options leave no file behind.
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
    """Report why the check of a batch failed, and where its results are kept; exit with code 1."""
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
    cluster: str | None,
    given: Convention,
    as_json: bool,
) -> None:
    """Solve all targets of a file and write their solutions; exit code 1 when any is not solved.

    On Ctrl-C or SIGTERM the finished part is kept as NAME.partial. If the check by Pinocchio fails, the results are kept as
    NAME.failed, and the exit code is 1.
    """
    if output is None:
        raise InvalidOption(f"--targets needs -o FILE for the solutions, which ends in {', '.join(FORMATS)}")
    as_output(output, "the -o FILE of --targets", *FORMATS)
    count, blocks = read_poses(path, "targets", given=given, tips=arm.named_tips, base=arm.arms[0].base)
    targets: Any = (poses for _, poses in blocks) if path.suffix.lower() == ".csv" else next(blocks).poses
    began = perf_counter()
    with cluster_of(cluster) as executor, progress("solving", count) as show_done:
        asked: dict[str, Any] = {"q0": start, "threads": threads, "executor": executor, **options}
        tally = _solve_into(output, arm, targets, method, asked, show_done)
    done = tally.done
    elapsed = perf_counter() - began - compile_time(began, everywhere=True)
    notice(f"wrote {output}")
    if tally.notice:
        notice(tally.notice)
    solved = tally.statuses["CONVERGED"]
    payload = {"robot": arm.name, "solver": tally.solver, "targets": done, "solved": solved, "statuses": tally.statuses}
    payload |= {"tips": arm.tips} if arm.named_tips else {}
    payload |= {"joint_names": arm.joint_names, "elapsed": elapsed, "output": output, "seed": options["seed"]}
    write_json(payload, as_json)
    if not as_json:
        others = ", ".join(f"{number} {status}" for status, number in tally.statuses.items() if status != "CONVERGED")
        rate = f"{duration(elapsed)}, {figure(done / elapsed)} targets/s with reading and writing"
        solved_of = {"solved": f"{solved} of {done}", "not solved": others or None}
        show(solved_of | {"solver": tally.solver or None, "computed in": rate})
    if solved < done:
        notice(tally.failed)
        raise typer.Exit(1)
