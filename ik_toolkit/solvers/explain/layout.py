"""The parts of an explanation (title, sentence, equations, table), written as text, as Markdown with LaTeX, or as HTML."""

import html
import math
import re
import textwrap
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from ...style import BAD, MUTED
from .worked_solution import WorkedStep

WIDTH = 80  # width of the plain text, in characters
UNITS = {"m": "mm", "rad": "deg", "": ""}  # unit in which explanations show values that are in m, rad or without unit
# factor that converts a value in m, rad or without unit to the unit shown (mm, deg)
SCALES = {"m": 1000.0, "rad": math.degrees(1.0), "": 1.0}


class Title(str):
    """A title in an explanation."""


class Sentence(str):
    """A paragraph of one or two sentences in an explanation."""


class Variable(str):
    """A table cell with the present value of the parameter that a joint changes (theta or d of a D-H table); shown highlighted."""


class OutsideLimits(str):
    """A table cell with a joint value that is outside the joint's limits; shown marked."""


class Table(NamedTuple):
    """A table in an explanation: texts of the column heads, and of the cells row by row."""

    head: tuple[str, ...]
    rows: list[tuple[str, ...]]


class Equations(NamedTuple):
    """Steps of a calculation in an explanation, shown as equations.

    Formulas may use the symbols of the steps `before`. places: the number of decimals with which millimetres are shown.
    """

    steps: tuple[WorkedStep, ...]
    before: tuple[WorkedStep, ...]
    places: int


Block = Title | Sentence | Table | Equations
MARKS: dict[type, str] = {Variable: "*", OutsideLimits: "!"}


# ----------------------------------------------------------------------------------------------------------------- numbers
def decimals(reach: float) -> int:
    """Return the number of decimals with which lengths in mm are shown, so that a millionth of the arm's reach [m] is visible."""
    return int(min(max(round(6.0 - math.log10(1000.0 * reach)), 0), 12))


def unit_of(kind: str) -> str:
    """Return the unit, a key of UNITS, of the values of a joint of this kind."""
    return "m" if kind == "prismatic" else "rad"


def digits(value: float, unit: str, places: int) -> str:
    """Return a value [m, rad or 1] as text without its unit: metres as mm with `places` decimals, radians as degrees."""
    text = f"{SCALES[unit] * value:.{ {'m': places, 'rad': 4}.get(unit, 6) }f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


# --------------------------------------------------------------------------------------------------------------- equations
def chains(block: Equations, form: str) -> Iterator[tuple[WorkedStep, list[list[str]]]]:
    """Yield the equations of a block in groups that are shown together, each with its first step.

    The sides are written as 'text', 'latex' or 'mathml' (see `expression.written`). An equation is a list of its sides. A step
    with a formula is a group of its own with one equation: symbol, formula, formula with numbers, value with unit. A given number
    without words joins the group of given numbers before it.
    """
    # SymPy is imported here, because only explanations need it.
    from .expression import quantity, with_numbers, written

    texts = {
        step.name: digits(step.value, step.unit, block.places) + " deg" * (step.unit == "rad")
        for step in (*block.before, *block.steps)
    }
    group: list[list[str]] = []
    first = block.steps[0] if block.steps else None
    for step in block.steps:
        sides = [written(step.symbol, form)]
        if step.formula is not None:
            sides.append(written(step.formula, form))
            # A formula with its numbers put in may be just the value, which is then not repeated.
            if with_numbers(step.formula, "text", texts) != texts[step.name]:
                sides.append(with_numbers(step.formula, form, texts))
        value = quantity(texts[step.name] + " mm" * (step.unit == "m"), form)
        value = f"<mn>{value}</mn>" if form == "mathml" else value
        if first is not None and group and (step.words or step.formula is not None or first.formula is not None):
            yield first, group
            group = []
        first = first if group else step
        group.append([*sides, value])
    if first is not None:
        yield first, group


# -------------------------------------------------------------------------------------------------------------- plain text
def blocks_to_text(blocks: Iterable[Block]) -> str:
    """Return the parts of an explanation as plain text, 80 columns wide."""
    lines: list[str] = []
    for block in blocks:
        if isinstance(block, Title):
            lines += ["", "", str(block), "-" * len(block)]
        elif isinstance(block, Sentence):
            lines += ["", *textwrap.wrap(str(block), WIDTH)]
        elif isinstance(block, Table):
            lines += ["", *_table_lines(block)]
        else:
            lines += ["", *_equation_lines(block)]
    return "\n".join(lines).lstrip("\n")


def _equation_lines(block: Equations) -> Iterator[str]:
    opening = block.steps[:1] and block.steps[0].formula is None
    for step, group in chains(block, "text"):
        said = f"  ({step.words})" if step.words else ""
        if step.formula is None:
            yield from _wrapped(", ".join(map(" = ".join, group)) + said, "  ", 6)
            continue
        if opening:  # an empty line between the given numbers and the formulas
            yield ""
            opening = False
        name, *sides = group[0]
        sides[-1] += said
        for k, side in enumerate(sides):
            lead = f"  {'' if k else name:{len(name)}} "
            yield from _wrapped(f"= {side}", lead, len(name) + 5)


def _wrapped(line: str, lead: str, indent: int) -> Iterator[str]:
    """Yield the lines of an equation; no line ends between a number and its unit."""
    for made in textwrap.wrap(
        re.sub(" (deg|mm)\\b", "\xa0\\1", line),
        WIDTH,
        initial_indent=lead,
        subsequent_indent=" " * indent,
        break_long_words=False,
        break_on_hyphens=False,
    ):
        yield made.replace("\xa0", " ")


def _table_lines(table: Table) -> list[str]:
    """Write a table; columns that do not fit into 80 characters follow below, next to the first one again."""
    lines: list[str] = []
    shown = [0]
    for k in range(1, len(table.head)):
        if len(shown) > 1 and max(map(len, _aligned(table, [*shown, k]))) > WIDTH:
            lines += [*_aligned(table, shown), ""]
            shown = [0]
        shown.append(k)
    return lines + _aligned(table, shown)


def _aligned(table: Table, shown: list[int]) -> list[str]:
    """Align columns: the first one and words to the left, numbers to the right, marks behind them."""
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


# ---------------------------------------------------------------------------------------------------------------- Markdown
def to_markdown(blocks: Iterable[Block]) -> str:
    """Return the parts of an explanation as Markdown with the equations in LaTeX."""
    return "\n\n".join(part for block in blocks for part in _markdown(block))


def _markdown(block: Block) -> Iterator[str]:
    if isinstance(block, Title):
        yield f"#### {_plain(block)}"
    elif isinstance(block, Sentence):
        yield _plain(block)
    elif isinstance(block, Table):
        rows = [[_plain(x) + (rf" \{MARKS[type(x)]}" if type(x) in MARKS else "") for x in row] for row in block.rows]
        ruled = [["---"] + ["---:"] * (len(block.head) - 1)]
        yield "\n".join(f"| {' | '.join(row)} |" for row in ([_plain(x) for x in block.head], *ruled, *rows))
    else:
        for step, group in chains(block, "latex"):
            words = _plain(step.words)
            if step.formula is None:
                given = r",\quad ".join(map(" = ".join, group))
                yield f"${given}$" + (f" ({words})" if words else "")
                continue
            name, *sides = group[0]
            lines = r" \\ ".join(f"&= {side}" for side in sides)
            yield rf"$$\begin{{aligned}} {name} {lines} \end{{aligned}}$$"
            if words:
                yield f"*{words}*"


def _plain(text: str) -> str:
    """Escape text for Markdown, because names of robots and joints come from the model."""
    return re.sub(r"([\\`*_{}\[\]()<>#|~$!])", r"\\\1", text)


# -------------------------------------------------------------------------------------------------------------------- HTML
def to_html(blocks: Iterable[Block]) -> str:
    """Return the parts of an explanation as HTML with the equations in MathML, which browsers draw without a library.

    All text is escaped.
    """
    inner = "".join(map(_html, blocks))
    return f'<div style="padding:2px 12px 8px;font-size:13px;line-height:1.5">{inner}</div>'


def _html(block: Block) -> str:
    if isinstance(block, Title):
        return f'<div style="font-weight:600;margin-top:6px">{html.escape(block)}</div>'
    if isinstance(block, Sentence):
        return f'<div style="margin:4px 0;color:{MUTED}">{html.escape(block)}</div>'
    if isinstance(block, Table):
        head = "".join(_html_cell(Title(x), k) for k, x in enumerate(block.head))
        rows = "".join(f"<tr>{''.join(map(_html_cell, row, range(len(row))))}</tr>" for row in block.rows)
        return f'<div style="overflow-x:auto;margin:4px 0"><table><tr>{head}</tr>{rows}</table></div>'
    return f'<div style="overflow-x:auto">{"".join(_html_lines(*chain) for chain in chains(block, "mathml"))}</div>'


def _html_cell(text: str, column: int) -> str:
    """Write a cell: heads and joint variables in bold, the latter on yellow, a value outside a limit in red."""
    style = "padding:1px 7px 1px 0;white-space:nowrap;font-variant-numeric:tabular-nums"
    if isinstance(text, Title):
        return f'<th style="{style};font-weight:600">{html.escape(text)}</th>'
    style += f";color:{MUTED}" if not column else "" if text[:1].isalpha() else ";text-align:right"
    style += ";background:#fff3c4;font-weight:600" if isinstance(text, Variable) else ""
    style += f";color:{BAD}" if isinstance(text, OutsideLimits) else ""
    return f'<td style="{style}">{html.escape(text)}</td>'


def _html_lines(step: WorkedStep, group: list[list[str]]) -> str:
    """Write given numbers on one line; write a formula, the formula with numbers, and its value on a line each."""
    from .expression import BREAK

    def maths(written: str) -> str:
        return "<wbr>".join(f'<math displaystyle="true">{piece}</math>' for piece in written.split(BREAK) if piece)

    said = f' <span style="color:{MUTED}">({html.escape(step.words)})</span>' if step.words else ""
    if step.formula is None:
        return f"<div>{', '.join(maths('<mo>=</mo>'.join(sides)) for sides in group)}{said}</div>"
    name, *sides = group[0]
    lines = [maths(f"{name if not k else ''}<mo>=</mo>{side}") for k, side in enumerate(sides)]
    lines[-1] += said
    shown = "".join(
        f'<div style="padding-left:{36 if k else 22}px;text-indent:-22px">{line}</div>' for k, line in enumerate(lines)
    )
    return f'<div style="margin:5px 0" data-step="{html.escape(step.name)}">{shown}</div>'
