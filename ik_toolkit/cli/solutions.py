"""Files of solutions: CSV, NPZ or Parquet, whole or not at all; the name of a part of one says so."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption
from ..files import PARTIAL, WholeFile, inert
from ..solvers.batch_result import BatchResult
from ..solvers.status import Status
from .output import notice
from .streams import uninterrupted

OUTPUTS = (".csv", ".npz", ".parquet")
FAILED = ".failed"


def _columns(part: BatchResult, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Columns of a table of solutions, by name: joints [rad or m], status and errors [m, rad], counts."""
    words = {int(status): status.name for status in Status}
    statuses = np.array([words.get(k, "") for k in range(max(words) + 1)])
    columns = dict(zip(names, part.q.T, strict=True)) | {"status": statuses[part.status]}
    rest = part.to_dict()
    return columns | {name: rest[name] for name in rest if name not in ("q", "status", "success")}


class CsvWriter:
    """Appends parts to a CSV file, numbers written so that they read back the same."""

    def __init__(self, file: WholeFile, names: Sequence[str]) -> None:
        """Write to `file`, joints called `names`."""
        self.file, self.names = file, names
        self.started = False

    def add(self, part: BatchResult) -> None:
        """Append a part, whole or not at all."""
        columns = _columns(part, self.names)
        lines = io.StringIO()
        writer = csv.writer(lines)
        if not self.started:
            writer.writerow(map(inert, columns))
        self.started = True
        writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))
        self.file.write(lines.getvalue())

    def close(self) -> None:
        """A CSV file needs no ending."""


class NpzWriter:
    """Writes the one part of a batch that is in memory."""

    def __init__(self, file: WholeFile, names: Sequence[str]) -> None:
        """Write to `file`, joints called `names`."""
        self.file, self.names = file, names

    def add(self, part: BatchResult) -> None:
        """Write the arrays, and of several tips their names in order."""
        robot = part.plan.robot
        tips: dict[str, Any] = {"tips": np.array(robot.tips)} if robot.by_tip else {}
        np.savez(self.file.stream, **part.to_dict(), joint_names=np.array(self.names), **tips)
        self.file.mark()

    def close(self) -> None:
        """Nothing is missing."""


class ParquetWriter:
    """Appends parts to a Parquet file as row groups."""

    def __init__(self, file: WholeFile, names: Sequence[str]) -> None:
        """Write to `file`, joints called `names`. Raises InvalidOption without pyarrow."""
        try:
            import pyarrow  # pyright: ignore[reportMissingImports]
            import pyarrow.parquet  # pyright: ignore[reportMissingImports]
        except ImportError:
            raise InvalidOption("a .parquet file needs pyarrow, which is not installed; use .csv or .npz") from None
        self.arrow, self.file, self.names, self.table = pyarrow, file, names, None

    def add(self, part: BatchResult) -> None:
        """Append a part."""
        table = self.arrow.table(_columns(part, self.names))
        if self.table is None:
            self.table = self.arrow.parquet.ParquetWriter(self.file.stream, table.schema)
        self.table.write_table(table)

    def close(self) -> None:
        """Write the end, without which the file cannot be read."""
        if self.table is not None:
            self.table.close()
            self.table = None
            self.file.mark()


class Solutions:
    """Output file of a batch. `add` parts; leaving the `with` block without an exception gives the file its name.

    Leaving it by an exception keeps the parts finished as NAME.partial and says so; `fail` keeps them as NAME.failed.
    """

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        """Open beside `path`. Raises InvalidOption, OSError."""
        self.file = WholeFile(path)
        self.count = 0
        try:
            suffix = path.suffix.lower()
            self.writer = {".csv": CsvWriter, ".npz": NpzWriter, ".parquet": ParquetWriter}[suffix](self.file, names)
        except BaseException:
            self.file.drop()
            raise

    def add(self, part: BatchResult) -> None:
        """Append a part."""
        with self.file.named():  # errors of numpy and pyarrow name no file
            self.writer.add(part)
        self.count += len(part)

    def fail(self) -> Path | None:
        """Keep the parts as NAME.failed; returns that name."""
        self.writer.close()
        return self.file.keep(FAILED)

    def __enter__(self) -> "Solutions":
        """From here on parts are added."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: Any) -> None:
        """Give the file its final name, by how the block ended."""
        with uninterrupted():
            if kind is None:
                self.writer.close()
                self.file.finish()
            elif self.count and not self.file.stream.closed:
                self._keep()
            else:
                self.file.drop()

    def _keep(self) -> None:
        try:
            self.writer.close()
        except OSError:  # the disk was full before; rows written completely are kept
            pass
        kept = self.file.keep(PARTIAL)
        if kept is not None:
            notice(f"partial: the first {self.count} solutions are in {kept}")
