"""Numbers and values as text: parsing, formatting for sentences and tables, conversion of results to JSON."""

import functools
import html
import json
import math
import re
import shutil
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .errors import InvalidOption, InvalidTarget


@functools.cache
def program() -> str:
    """Return what to type in a shell to run the command line: `ik`, or `python -m ik_toolkit` if the shell would not find `ik`."""
    if shutil.which("ik"):
        return "ik"
    found = shutil.which("python")
    ours = found is not None and Path(found).parent == Path(sys.executable).parent
    return f"{'python' if ours else sys.executable} -m ik_toolkit"


def in_shell(text: str) -> str:
    """Replace commands such as `ik solve` in a text by what can be typed in this shell (see `program`)."""
    commands = (
        "robots|info|fk|solve|path|track|gains|reproduce|solvers|bench|tune|workspace|reach|place|calibrate|dh|check|convert"
        "|view|panel|doctor"
    )
    called = rf"\bik (?=--|(?:{commands}|COMMAND)\b)"
    return text if program() == "ik" else re.sub(called, lambda _: f"{program()} ", text)


def first_few(words: Sequence[str], most: int = 5) -> str:
    """Return the first words of a list, and how many more there are: 'a, b and 3 more'."""
    return ", ".join(words[:most]) + (f" and {len(words) - most} more" if len(words) > most else "")


def how_many(count: int, noun: str) -> str:
    """Return a number of things as text, in the singular or the plural: '1 branch', '2 branches', '0 joints'."""
    return f"{count} {noun}" + ("es" if noun.endswith("ch") else "s") * (count != 1)


def figure(value: float, digits: int = 3) -> str:
    """Return a number as text with `digits` significant digits, as a person would write it: 3880, 0.0012, 2.5e-6."""
    text = f"{value:.{digits}g}"
    head, _, power = text.partition("e")
    if not power:
        return text
    return f"{float(text):.0f}" if 0 < int(power) < 7 else f"{head}e{int(power)}"


def _size(value: float, units: str, digits: int) -> str:
    """Write a size in the largest of the given units in which it is at least 1; each unit is a thousandth of the one before.

    A size below a hundredth of the smallest unit is taken as rounding and written without digits.
    """
    rounded = abs(float(f"{value:.{digits}g}"))
    names = units.split()
    sizes = [10.0 ** (-3 * k) for k in range(len(names))]
    size, unit = next((one for one in zip(sizes, names, strict=True) if rounded >= one[0]), (sizes[-1], names[-1]))
    if 0.0 < rounded < 1e-2 * size:
        return f"under 0.01 {unit}"
    return f"{figure(value / size, digits)} {unit}"


def equations(values: Mapping[str, float], digits: int = 5) -> str:
    """Return named numbers as text: 'kp = 42.748, kd = 4.3499'."""
    return ", ".join(f"{name} = {value:.{digits}g}" for name, value in values.items())


def length(metres: float, digits: int = 3) -> str:
    """Return a length [m] as text, in m, mm, um or nm, whichever suits its size."""
    return _size(metres, "m mm um nm", digits) if metres else "0 mm"


def duration(seconds: float, digits: int = 3) -> str:
    """Return a time [s] as text, in s, ms or us, whichever suits its size."""
    return _size(seconds, "s ms us", digits) if seconds else "0 s"


def angle(radians: float, deg: bool = True, digits: int = 3) -> str:
    """Return an angle [rad] as text, in degrees or radians; an angle below a thousandth of these is in urad or nrad."""
    unit = (math.radians(1.0), "deg") if deg else (1.0, "rad")
    if radians and abs(radians) < 1e-3 * unit[0]:
        return _size(1e6 * radians, "urad nrad", digits)
    return f"{figure(radians / unit[0], digits)} {unit[1]}"


def decimal(text: str, kind: Callable[[str], Any] = float) -> Any:
    """Return the number that a text stands for, as a float or int (`kind`). Raises ValueError, also for '1_0' or foreign digits."""
    if not text.isascii() or "_" in text:
        raise ValueError(f"'{text}' is not a number")
    return kind(text)


def numbers(text: str) -> list[float] | None:
    """Return the numbers in a text such as '1 2', '1,2' or '1', or None if it has no numbers or has anything else."""
    try:
        return [decimal(part) for part in text.replace(",", " ").split()] or None
    except ValueError:
        return None


def with_points(text: str) -> str:
    """Return a text with decimal commas ('0,5 0 0,3', '1,5;0') replaced by points, or '' if they do not look like decimal commas.

    The commas in '1,1,1 0,0,0' are not decimal commas, because a word with two commas is not a number.
    """
    words = text.replace(";", " ").split()
    decimals = [word for word in words if "," in word]
    if not decimals or not all(re.fullmatch(r"[-+]?\d*,\d+(e[-+]?\d+)?", word, re.IGNORECASE) for word in decimals):
        return ""
    pointed = " ".join(word.replace(",", ".") for word in words)
    return "" if numbers(pointed) is None else pointed


def comma_hint(text: str, what: str, sizes: Sequence[int]) -> str:
    """Return a hint about decimal commas for an error message if reading them so gives an allowed count of numbers, else ''."""
    pointed = with_points(text)
    fits = pointed and len(numbers(pointed) or []) in sizes
    return f" (a comma separates numbers); write decimals with a point: {what} {pointed}" if fits else ""


def vector(text: str, what: str, size: int | None = None) -> list[float]:
    """Return the numbers in a text, separated by spaces or commas.

    Raises:
        InvalidOption: There are none, or it cannot be told whether a comma is a decimal one; the message names `what`.
        InvalidTarget: There are not `size` of them.
    """
    values = numbers(text)
    if size is None and values is None:
        raise InvalidOption(f"{what} takes numbers, not '{text.strip()}'")
    if size is not None and (values is None or len(values) != size):
        found = f", not '{text.strip()}'" if values is None else f"; got {len(values)}"
        raise InvalidTarget(f"{what} takes {size} numbers{found}{comma_hint(text, what, (size,))}")
    if len(text.split()) > 1 and "." not in text and (pointed := with_points(text)):
        plain = " ".join(figure(x) for x in values or ())
        raise InvalidOption(f"{what} '{text.strip()}' can be read as {plain} or as {pointed}; write one of them")
    return values or []


def parameter(name: str, text: str) -> Any:
    """Return a value from its text: a number, True or False, a list such as [1, 2], or a word.

    Raises InvalidOption, which names the parameter, for anything else.
    """
    for read in (lambda x: decimal(x, int), decimal, json.loads):
        try:
            return read(text.lower() if text in ("True", "False") else text)
        except ValueError:
            continue
    if not text.replace("_", "").replace("-", "").isalnum():
        hint = comma_hint(text, f"{name} =", (1,))
        raise InvalidOption(f"parameter '{name}' takes a number or a list like [1, 2], not '{text}'{hint}")
    return text


def plain(value: Any) -> Any:
    """Convert arrays, paths and enums to types that JSON has; numbers that are not finite become None (null)."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # Arrays and numbers of numpy have the method `tolist`.
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str | int | bool) or value is None:
        return value
    return str(value)


class TextTable:
    """Summary of a result for a notebook or a terminal: title, text, table with a header, and notes below it."""

    def __init__(
        self,
        title: str,
        words: str,
        head: Sequence[str],
        rows: Iterable[Sequence[Any]],
        *notes: str,
        color: str = "",
        most: int = 12,
    ) -> None:
        """Make a table of at most `most` rows; numbers are written with four digits, None as an empty cell."""
        every = [[_entry(value) for value in row] for row in rows]
        self.title, self.words, self.head, self.rows, self.color = title, words, head, every[:most], color
        more = [f"and {len(every) - most} more rows"] if len(every) > most else []
        self.notes = [*more, *(note for note in notes if note)]

    def html(self) -> str:
        """Return the table as HTML for a notebook; all contents are escaped."""
        style = f" style='color:{self.color}'" if self.color else ""
        title = f"<b{style}>{html.escape(self.title)}</b>"
        head = "".join(f"<th>{html.escape(one)}</th>" for one in self.head)
        rows = ""
        for row in self.rows:  # A non-breaking space keeps a number and its unit on one line.
            cells = (html.escape(one).replace(" ", "&nbsp;" if one[:1].isdigit() else " ") for one in row)
            rows += f"<tr>{''.join(f'<td>{one}</td>' for one in cells)}</tr>"
        notes = "".join(f"<div>{html.escape(note)}</div>" for note in self.notes)
        table = f"<table>{f'<tr>{head}</tr>' if head else ''}{rows}</table>"
        return f"{title} {html.escape(self.words)}{table}{notes}"

    def __str__(self) -> str:
        """Return the table for a terminal."""
        lines = [line for line in (list(self.head), *self.rows) if line]
        wide = [max(map(len, column)) for column in zip(*lines, strict=True)]
        drawn = ["  ".join(f"{x:<{n}}" for x, n in zip(line, wide, strict=True)).rstrip() for line in lines]
        return "\n".join([f"{self.title} {self.words}".rstrip(), *(line for line in drawn if line), *self.notes])


class Tabled:
    """Base class of results that a notebook or a terminal shows as a table, which their method `table` makes."""

    def table(self) -> TextTable:
        """Return the table that shows this result; each class of results has its own."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        """Return the table for notebooks."""
        return self.table().html()

    def __repr__(self) -> str:
        """Return the table for terminals."""
        return str(self.table())


def _entry(value: Any) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else str(value) if isinstance(value, int) else figure(float(value), 4)
