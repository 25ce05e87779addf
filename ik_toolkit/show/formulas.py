"""Parts of an explanation as HTML, with formulas as MathML, which browsers render without a library. All text is escaped."""

import html
from collections.abc import Iterable

from ..solvers.blocks import UNITS, Block, Broken, Formulas, Given, Heading, Table, Varies, Words, grouped
from ..solvers.derivation import Step
from ..solvers.formula import MathML, number, pieces, write
from ..style import BAD
from .tables import MUTED

MARK = "#fff3c4"
CELL = "padding:1px 7px 1px 0;white-space:nowrap;font-variant-numeric:tabular-nums"
FORM = MathML()


def blocks_html(blocks: Iterable[Block]) -> str:
    """Blocks one below the other, in the panel's font size."""
    inner = "".join(_block(block) for block in blocks)
    return f'<div style="padding:2px 12px 8px;font-size:13px;line-height:1.5">{inner}</div>'


def _block(block: Block) -> str:
    if isinstance(block, Heading):
        return f'<div style="font-weight:600;margin-top:6px">{html.escape(block)}</div>'
    if isinstance(block, Words):
        return f'<div style="margin:4px 0;color:{MUTED}">{html.escape(block)}</div>'
    if isinstance(block, Table):
        return _table(block)
    if isinstance(block, Given):
        lines = []
        for steps, words in grouped(block.steps):
            said = ", ".join(_maths(f"{FORM.name(s.name)}<mo>=</mo>{_value(s, block.places)}") for s in steps)
            lines.append(f"<div>{said}{_muted(words)}</div>")
        return "".join(lines)
    return f'<div style="overflow-x:auto">{"".join(_step(step, block) for step in block.steps)}</div>'


def _table(table: Table) -> str:
    head = "".join(f'<th style="{CELL};font-weight:600">{html.escape(x)}</th>' for x in table.head)
    rows = "".join(f"<tr>{''.join(_cell(x, k) for k, x in enumerate(row))}</tr>" for row in table.rows)
    return f'<div style="overflow-x:auto;margin:4px 0"><table><tr>{head}</tr>{rows}</table></div>'


def _cell(text: str, column: int) -> str:
    """A cell: yellow background for values that a joint changes, red for values outside a limit."""
    style = CELL + (f";color:{MUTED}" if not column else "" if text[:1].isalpha() else ";text-align:right")
    style += f";background:{MARK};font-weight:600" if isinstance(text, Varies) else ""
    style += f";color:{BAD}" if isinstance(text, Broken) else ""
    return f'<td style="{style}">{html.escape(text)}</td>'


def _step(step: Step, block: Formulas) -> str:
    """Symbol and formula, the same with numbers, and the result: one line each."""
    value = _value(step, block.places)
    name = FORM.name(step.name)
    lines = [f"{name}<mo>=</mo>{write(step.formula, FORM) if step.formula else value}"]
    if step.formula:
        put_in = write(step.formula, FORM, block.numbers, block.places)
        lines += [f"<mo>=</mo>{put_in}"] if put_in != value.split("<mtext>")[0] else []
        lines.append(f"<mo>=</mo>{value}")
    shown = []
    for k, line in enumerate(lines):
        left = 0 if not k else 14
        said = _muted(step.words) if k + 1 == len(lines) else ""
        shown.append(f'<div style="padding-left:{left + 22}px;text-indent:-22px">{_maths(line)}{said}</div>')
    return f'<div style="margin:5px 0" data-step="{html.escape(step.name)}">{"".join(shown)}</div>'


def _value(step: Step, places: int) -> str:
    """Number of a step with its unit."""
    unit = UNITS[step.unit] if step.unit != "rad" else ""
    digits = FORM.digits(number(step.value, step.unit, places), step.unit)
    return f"{digits}<mtext>&nbsp;{unit}</mtext>" if unit else digits


def _maths(written: str) -> str:
    return " ".join(f'<math displaystyle="true">{piece}</math>' for piece in pieces(written))


def _muted(words: str) -> str:
    return f' <span style="color:{MUTED}">({html.escape(words)})</span>' if words else ""
