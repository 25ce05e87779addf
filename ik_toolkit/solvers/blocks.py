"""The parts of an explanation, and how they are written: as text of 80 columns, or as Markdown with LaTeX."""

import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from .derivation import Step
from .formula import Latex, Quantity, Text, number, write

WIDTH = 80  # columns of the text
UNITS = {"m": "mm", "rad": "deg", "": ""}


class Heading(str):
    """A line above what follows."""


class Words(str):
    """A sentence or two."""


class Varies(str):
    """A cell of a D-H table that the joint changes."""


class Broken(str):
    """A joint value outside its limits."""


class Table(NamedTuple):
    """Texts in columns."""

    head: tuple[str, ...]
    rows: list[tuple[str, ...]]


class Formulas(NamedTuple):
    """Steps, and every number that may stand in them."""

    steps: tuple[Step, ...]
    numbers: Mapping[str, Quantity]
    places: int


class Given(NamedTuple):
    """Numbers that the formulas start from."""

    steps: tuple[Step, ...]
    places: int


MARKS: dict[type, str] = {Varies: "*", Broken: "!"}
Block = Heading | Words | Table | Formulas | Given


def grouped(steps: Sequence[Step]) -> list[tuple[list[Step], str]]:
    """Given numbers that belong together, and what they are: those without words go with the one before."""
    groups: list[tuple[list[Step], str]] = []
    for step in steps:
        if step.words or not groups:
            groups.append(([step], step.words))
        else:
            groups[-1][0].append(step)
    return groups


def valued(step: Step, places: int) -> str:
    """Number of a step with its unit."""
    return f"{number(step.value, step.unit, places)} {UNITS[step.unit]}".rstrip()


def lines_of(table: Table) -> list[str]:
    """Lines of a table: the first column and words to the left, numbers to the right, marks behind them.

    Columns that do not fit into 80 follow below, next to the first one again.
    """
    lines: list[str] = []
    shown = [0]
    for k in range(1, len(table.head)):
        if len(shown) > 1 and max(map(len, _aligned(table, [*shown, k]))) > WIDTH:
            lines += [*_aligned(table, shown), ""]
            shown = [0]
        shown.append(k)
    return lines + _aligned(table, shown)


def _aligned(table: Table, shown: list[int]) -> list[str]:
    lines = [""] * (1 + len(table.rows))
    for k in shown:
        cells = [table.head[k], *(row[k] for row in table.rows)]
        marks = [MARKS.get(type(cell), "") for cell in cells]
        width = max(map(len, cells))
        left = k == 0 or any(cell[:1].isalpha() for cell in cells[1:])
        for i, (cell, mark) in enumerate(zip(cells, marks, strict=True)):
            text = cell.ljust(width) if left else cell.rjust(width)
            lines[i] += f"  {text}" + (f" {mark:1}" if any(marks) else "")
    return [line.rstrip() for line in lines]


def to_text(block: Block) -> list[str]:
    """Lines of plain text."""
    if isinstance(block, Heading):
        return ["", "", str(block), "-" * len(block)]
    if isinstance(block, Words):
        return ["", *textwrap.wrap(str(block), WIDTH)]
    if isinstance(block, Table):
        return ["", *lines_of(block)]
    lines: list[str] = [""]
    if isinstance(block, Given):
        for steps, words in grouped(block.steps):
            line = ", ".join(f"{s.name} = {valued(s, block.places)}" for s in steps)
            lines += _wrapped(f"  {line}" + (f"  ({words})" if words else ""), 6)
        return lines
    form = Text()
    for step in block.steps:
        indent = len(step.name) + 2
        value = valued(step, block.places)
        words = f"  ({step.words})" if step.words else ""
        if not step.formula:
            lines += _wrapped(f"  {step.name} = {value}{words}", indent + 3)
            continue
        lines += _wrapped(f"  {step.name} = {write(step.formula, form)}", indent + 3)
        put_in = write(step.formula, form, block.numbers, block.places).replace(" deg", "\xa0deg")
        if put_in.replace("\xa0", " ") != value:
            lines += _wrapped(f"{'':{indent}} = {put_in}", indent + 3)
        lines += _wrapped(f"{'':{indent}} = {value}{words}", indent + 3)
    return lines


def _wrapped(line: str, indent: int) -> list[str]:
    made = textwrap.wrap(
        line,
        WIDTH,
        subsequent_indent=" " * indent,
        break_long_words=False,
        break_on_hyphens=False,
        drop_whitespace=True,
    )
    return [x.replace("\xa0", " ") for x in made]


def to_markdown(block: Block) -> str:
    """Markdown with LaTeX."""
    if isinstance(block, Heading):
        return f"#### {_plain(block)}"
    if isinstance(block, Words):
        return _plain(block)
    if isinstance(block, Table):
        rows = [[_plain(x) + (rf" \{MARKS[type(x)]}" if type(x) in MARKS else "") for x in row] for row in block.rows]
        head = [_plain(x) for x in block.head]
        lines = ["| " + " | ".join(row) + " |" for row in (head, ["---"] + ["---:"] * (len(head) - 1), *rows)]
        return "\n".join(lines)
    form = Latex()
    if isinstance(block, Given):
        lines = []
        for steps, words in grouped(block.steps):
            said = r",\quad ".join(rf"{form.name(s.name)} = {latex_value(s, block.places)}" for s in steps)
            lines.append(f"${said}$" + (f" ({words})" if words else ""))
        return "\n\n".join(lines)
    return "\n\n".join(_latex_step(step, form, block) for step in block.steps)


def _plain(text: str) -> str:
    """Text escaped for Markdown: names of robots and joints come from the model."""
    return re.sub(r"([\\`*_{}\[\]()<>#|~$!])", r"\\\1", text)


def latex_value(step: Step, places: int) -> str:
    """Number of a step with its unit, in LaTeX."""
    return number(step.value, step.unit, places) + {"m": r"\,\mathrm{mm}", "rad": r"^\circ", "": ""}[step.unit]


def _latex_step(step: Step, form: Latex, block: Formulas) -> str:
    parts = [form.name(step.name)]
    if step.formula:
        parts += [write(step.formula, form), write(step.formula, form, block.numbers, block.places)]
    chain = " = ".join([*parts, latex_value(step, block.places)])
    return f"$${chain}$$" + (f"\n\n*{step.words}*" if step.words else "")
