"""What a command shows: results as tables or JSON on stdout; notices and progress on stderr."""

import json
import logging
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import Interrupted, clean
from ..files import PARTIAL, write_table, write_whole
from ..text import in_shell, plain
from .streams import uninterrupted

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text


WRAPPED = 12  # A table column whose text wraps is at least this wide [characters].


def notice(text: str) -> None:
    """Print one line on stderr; nothing happens if stderr cannot be written."""
    try:
        print(clean(in_shell(text)), file=sys.stderr, flush=True)
    # A notice is not worth an error where stderr is closed (Python sets it to None), its reader is gone, or the disk is full.
    except (OSError, ValueError, AttributeError):
        pass


class LogNotices(logging.Handler):
    """Shows the package's log on stderr, each message only once.

    hint: advice appended to warnings about angles that look like degrees.
    """

    def __init__(self, hint: str = "") -> None:
        """Handle every level."""
        super().__init__()
        self.hint = hint
        self.shown: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Print the message of a log record, unless it was printed before."""
        said = record.getMessage()
        text = f"{record.levelname.lower()}: {said}{self.hint if said.endswith('degrees meant?') else ''}"
        if record.name == "ik_toolkit.compile":
            text = f"compiling the solver ({record.args[1]}) ..."  # type: ignore[index]
        if text not in self.shown:
            self.shown.add(text)
            notice(text)


def partial(output: Path) -> Path:
    """Return the path FILE.partial for the incomplete result of a command that was to write FILE."""
    return output.with_name(output.name + PARTIAL)


def whole_or_partial(file: Path | None, stopped: bool) -> Path | None:
    """Return the path to write to: `file`, or FILE.partial if the command was stopped; None stays None."""
    return partial(file) if stopped and file is not None else file


def keep_partial(result: Any, output: Path, what: str) -> None:
    """Save the finished part of an interrupted command as FILE.partial, and print a notice; what: its contents in words."""
    with uninterrupted():
        kept = partial(output)
        result.save(output.with_name(f"{output.stem}.part{output.suffix}")).replace(kept)
        notice(f"partial: {what} in {kept}")


def write_rows(file: Path | None, head: Iterable[str], rows: Iterable[Iterable[float | str]]) -> None:
    """Write a header and rows to a CSV file, and print a notice; nothing happens if `file` is None."""
    if file is not None:
        write_table(file, [*head], rows)
        notice(f"wrote {file}")


def write_json(payload: dict[str, Any], as_json: bool, output: Path | None = None) -> None:
    """Print an object as JSON on stdout if `as_json`, and write it to the file `output` unless that is None."""
    if output is not None:
        write_whole(output, json.dumps(plain(payload), indent=2, allow_nan=False) + "\n")
        notice(f"wrote {output}")
    if as_json:
        print(json.dumps(plain(payload), allow_nan=False))


def table(*columns: str, rows: Iterable[Iterable[Any]] = ()) -> "Table":
    """Make a rich table of columns and rows; a column named '<...' or '>...' never wraps, and one with '>' is right-aligned."""
    from rich import box
    from rich.table import Table

    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        right, whole = column.startswith(">"), column.startswith(("<", ">"))
        made.add_column(column.lstrip("<>"), justify="right" if right else "left", no_wrap=whole, overflow="fold")
    for row in rows:
        made.add_row(*row)
    return made


def show(*things: Any) -> None:
    """Print tables and lines on stdout, as wide as the terminal, or 100 characters if there is none.

    A dict is printed as a list of names and values, without the values that are None. If a table is too wide, first its padding is
    left out, then file names break after a folder, then all names wrap; numbers never do.
    """
    from rich.console import Console
    from rich.segment import Segment, Segments

    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else 100
    console = Console(width=width, highlight=False, markup=False)
    room = console.width
    for thing in [_facts(thing) if isinstance(thing, dict) else thing for thing in things]:
        if _least(thing) > room:
            thing.padding = 0
        for column in getattr(thing, "columns", ()):
            if (over := _least(thing) - room) > 0 and column.no_wrap and column.justify == "left":
                cells: list[Any] = [*column.cells]
                fits = max(map(len, cells), default=0) - over
                wide = [isinstance(cell, str) and len(cell) > fits for cell in cells]
                column._cells = [
                    "/\n".join(cell.rsplit("/", 1)) if long else cell for cell, long in zip(cells, wide, strict=True)
                ]
        if _least(thing) > room:
            for column in thing.columns:
                column.no_wrap = column.no_wrap and column.justify == "right"
        # If the terminal is too narrow, lines that are too long for it are better than cut-off numbers.
        console.width = max(room, _least(thing))
        drawn = console.render(console.render_str(clean(thing)) if isinstance(thing, str) else thing)
        console.print(Segments(Segment(clean(part.text), part.style, part.control) for part in drawn), end="")


def _least(thing: Any) -> int:
    """Return the least width [characters] of a table; 0 for anything else."""
    from rich.cells import cell_len

    least = 0
    for column in getattr(thing, "columns", ()):
        lines = [line for cell in (column.header, *column.cells) for line in str(cell).split("\n")]
        least += thing.padding[1] + thing.padding[3] + 1 + (max(map(cell_len, lines)) if column.no_wrap else WRAPPED)
    return least


def heading(text: str) -> "Text":
    """Make a bold line above a table or a list."""
    from rich.text import Text

    return Text(text, style="bold")


def _facts(rows: dict[str, Any]) -> "Table":
    """Make a two-column list of names and values, without lines."""
    from rich.table import Table

    made = Table.grid(padding=(0, 2))
    made.add_column(style="dim", no_wrap=True)
    made.add_column(overflow="fold")
    for name, value in rows.items():
        if value is not None:
            made.add_row(name, str(value))
    return made


def run_or_part(study: Callable[[], Any]) -> tuple[Any, bool]:
    """Run a study; return its result, or that of its finished part if Ctrl-C stopped it, and whether it was stopped."""
    try:
        return study(), False
    except Interrupted as stop:
        return stop.result, True


@contextmanager
def progress(what: str, total: int | None, seconds: float | None = None) -> Iterator[Callable[..., None]]:
    """Context manager: show a progress bar on stderr if that is a terminal.

    Yields a function to call with the number done, and optionally a new text and a new total. seconds: time [s] after which the
    work ends at the latest; the bar counts it down instead of estimating it.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn

    class TimeLeft(ProgressColumn):
        def render(self, task: Any) -> str:
            return f"{timedelta(seconds=max(0, math.ceil((seconds or 0.0) - (task.elapsed or 0.0))))}"

    console = Console(stderr=True)
    left = TimeRemainingColumn() if seconds is None else TimeLeft()
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), left
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done, shown=None, total=None: bar.update(task, completed=done, description=shown, total=total)


# --------------------------------------------------------------------------------------------------------------- units
def turns(kind: str) -> bool:
    """Return whether the value of a joint of this kind is an angle."""
    return kind != "prismatic"


def number(value: float, kind: str, deg: bool) -> str:
    """Return a joint value or limit [rad or m] as text, an angle in degrees if `deg` is set; an infinite limit is 'none'."""
    if not math.isfinite(value):
        return "none"
    degrees = deg and turns(kind)
    return fixed(math.degrees(value) if degrees else value, 4 if degrees else 6)


def fixed(value: float, digits: int) -> str:
    """Return a number as text with `digits` decimals; zero has no minus sign."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def unit(kind: str, deg: bool) -> str:
    """Return the unit in which values of a kind of joint are shown: 'm', 'rad', or 'deg' if `deg` is set."""
    return "m" if not turns(kind) else "deg" if deg else "rad"
