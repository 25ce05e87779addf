"""A report on one paper, with text and tables as Markdown and JSON, and figures as PNG."""

import importlib
import importlib.util
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from time import process_time
from typing import Any, Self

import numpy as np

from ..errors import Interrupted, InvalidOption, MissingExtra
from ..files import PARTIAL, write_whole
from ..robot.formats.dh import DHTable, read_dh_table
from ..robot.library import shipped_robots
from ..style import PRINTED
from ..text import plain

Work = tuple[Callable[[], Any], int]  # A function to time, and how many solves one call of it does.


class ReportInterrupted(Interrupted):
    """Raised on Ctrl-C while a report is made; `result` is the Report with the parts that were finished before."""


class Report:
    """A report on a paper: headings, paragraphs, tables and figures, added in reading order and written by `write`.

    Ctrl-C in a `with` block of a report raises ReportInterrupted.

    Attributes:
        name: Short name of the paper, which can be part of a file name.
        title: Heading of the report.
        data: What `report.json` and `ik reproduce --json` contain: every table (columns and rows) and number by its key.
    """

    def __init__(self, name: str, title: str) -> None:
        """Make an empty report with a name and a title."""
        self.name = name
        self.title = title
        self.data: dict[str, Any] = {"paper": name, "title": title}
        self._parts: list[str] = [f"# {title}"]
        self._figures: list[tuple[str, Callable[..., Any], tuple[Any, ...]]] = []

    def __enter__(self) -> Self:
        """Return the report, to which the block adds parts."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: Any) -> None:
        """Raise ReportInterrupted with the finished part if Ctrl-C ended the block."""
        if kind is not None and issubclass(kind, KeyboardInterrupt):
            raise ReportInterrupted(self, f"in the report '{self.title}'") from None

    def heading(self, text: str) -> None:
        """Begin a section of the report with a heading."""
        self._parts.append(f"## {text}")

    def text(self, text: str) -> None:
        """Add a paragraph of Markdown to the report; its line breaks are removed."""
        self._parts.append(" ".join(text.split()))

    def table(self, key: str, head: Sequence[str], rows: Sequence[Sequence[Any]] | str, least: float = 0.0) -> None:
        """Add a table under a key of `data`; floats are shown with 5 significant digits and stored in full precision.

        Rows of text may be given as one text, a line each, with " | " between the cells.
        Numbers below `least` are shown as "under LEAST", because their digits are rounding that depends on the processor.
        """
        if isinstance(rows, str):
            rows = [line.strip().split(" | ") for line in rows.strip().splitlines()]
        self.data[key] = {"columns": list(head), "rows": [list(row) for row in rows]}
        lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
        lines += ["| " + " | ".join(cell(x, least) for x in row) + " |" for row in rows]
        self._parts.append("\n".join(lines))

    def records(self, key: str, rows: Sequence[dict[str, Any]]) -> None:
        """Add a table (see `table`) from rows that are dicts of values by column name."""
        self.table(key, [*rows[0]], [[*row.values()] for row in rows])

    def number(self, key: str, value: Any) -> Any:
        """Store a number (or a structure of numbers) for report.json, under a key of `data`, and return it."""
        self.data[key] = value
        return value

    def figure(self, file: str, caption: str, draw: Callable[..., Any], *arguments: Any) -> None:
        """Add a figure: `draw(plt, *arguments)` returns the matplotlib figure; it is called only when figures are written."""
        self._figures.append((file, draw, arguments))
        self._parts.append(f"![{caption}]({file})\n\n*{caption}*")

    def markdown(self) -> str:
        """Return the whole report as Markdown."""
        return "\n\n".join(self._parts) + "\n"

    def write(self, folder: str | Path, pictures: bool | None = None) -> list[Path]:
        """Write report.md, report.json and the figures.

        Args:
            folder: Where to write them; it is made if it does not exist.
            pictures: Whether to draw figures. Default: if matplotlib is installed.

        Returns:
            The paths of the files.

        Raises:
            MissingExtra: pictures is True and matplotlib is not installed.
        """
        folder = Path(folder)
        drawable = importlib.util.find_spec("matplotlib") is not None
        if pictures and not drawable:
            raise MissingExtra("matplotlib", "plots")
        pictures = drawable if pictures is None else pictures
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InvalidOption(f"cannot make the folder '{folder}': {error.strerror}") from None
        note = "" if pictures else "The pictures were left out: they need matplotlib (`pip install matplotlib`)."
        files = self._write(folder, "", note)
        if pictures:
            # If pyplot has been loaded before, as in a notebook, its backend is kept.
            if "matplotlib.pyplot" not in sys.modules:
                importlib.import_module("matplotlib").use("Agg")
            from ..show.plots import drawing, save

            for file, draw, arguments in self._figures:
                with drawing(PRINTED) as plt:
                    figure = draw(plt, *arguments)
                    figure.set_size_inches(*(figure.get_size_inches() * min(1.0, WIDEST / figure.get_figwidth())))
                    files.append(save(figure, folder / file))
        return files

    def write_partial(self, folder: str | Path) -> list[Path]:
        """Write an unfinished report to report.md.partial and report.json.partial, without figures. Returns their paths."""
        return self._write(Path(folder), PARTIAL, "The report was interrupted here.")

    def _write(self, folder: Path, suffix: str, note: str) -> list[Path]:
        files = [folder / f"{name}{suffix}" for name in ("report.md", "report.json")]
        write_whole(files[0], self.markdown() + (f"\n{note}\n" if note else ""))
        write_whole(files[1], json.dumps(plain(self.data), indent=1) + "\n")
        return files


ROUNDING = 1e-11  # A computed error below this, whatever its unit (m, mm, rad or deg), is rounding.
# Largest width of a figure [inches]. On a page 740 pixels wide its text of 9 points is then still 12 pixels high.
WIDEST = 8.0


def cell(value: Any, least: float = 0.0) -> str:
    """Format a value for a table: floats with 5 significant digits, numbers below `least` as "under LEAST"."""
    if isinstance(value, float | np.floating):
        return "-" if np.isnan(value) else f"under {least:.0e}" if 0.0 < abs(value) < least else f"{value:.5g}"
    return str(value).replace("|", "\\|").replace("\n", " ")


def shipped_table(name: str) -> DHTable:
    """Return the D-H table that a shipped robot is made from."""
    file = shipped_robots()[name].dh_file
    assert file is not None
    return read_dh_table(file)


def rounds(works: dict[str, Work], count: int, warm: bool = False) -> dict[str, np.ndarray]:
    """Measure the times of several functions in turn, so that changes in the machine's speed affect all alike.

    Processor time is measured, because other processes on the same core should not count.

    Args:
        works: By name, the function to time and the number of solves in one call.
        count: Number of timed rounds.
        warm: Whether everything is compiled already. If not, a first round, which is not timed, compiles it.

    Returns:
        For each name the time of a solve in each round (count,) [s].
    """
    spent: dict[str, list[float]] = {name: [] for name in works}
    for k in range(warm, count + 1):
        for name, (work, solves) in works.items():
            begun = process_time()
            work()
            if k:
                spent[name].append((process_time() - begun) / solves)
    return {name: np.array(values) for name, values in spent.items()}


def spread(values: np.ndarray, form: str = ".3g") -> str:
    """Return the median and range of values as text, "MEDIAN [MIN-MAX]"."""
    return f"{np.median(values):{form}} [{np.min(values):{form}}-{np.max(values):{form}}]"
