"""Writes SymPy expressions as text, LaTeX or MathML, with symbols or with numbers in their place."""

import functools
import re
from collections.abc import Iterator, Mapping
from typing import Any

import sympy
from sympy.core.function import Application
from sympy.printing.latex import LatexPrinter
from sympy.printing.mathml import MathMLPresentationPrinter
from sympy.printing.str import StrPrinter

BREAK = "\v"  # character that marks in MathML text where a line may be broken; replaced later
# SLOT matches a placeholder in the text of a formula, which is replaced by a number with its unit. It holds the name of the symbol
# that the number is for, and whether a negative number needs parentheses.
SLOT = re.compile("\x01(\\w+)\x02(\\(?)")


class _Slot(sympy.Symbol):
    """A placeholder in a formula for the number of a symbol.

    It is sorted like the symbol, so that a formula and the same formula with numbers have their terms in the same order.
    """

    __slots__ = ("bare",)

    def __new__(cls, name: str, bare: bool) -> "_Slot":
        """Make a placeholder; with `bare`, a negative number needs no parentheses there."""
        made = sympy.Symbol.__xnew__(cls, name, real=True)
        made.bare = bare
        return made

    def _hashable_content(self) -> tuple[Any, ...]:
        return (*super()._hashable_content(), self.bare)

    def _sympystr(self, printer: Any) -> str:
        return f"\x01{self.name}\x02{'' if self.bare else '('}"

    _latex = _sympystr

    def _mathml_presentation(self, printer: Any) -> Any:
        made = printer.dom.createElement("mn")
        made.appendChild(printer.dom.createTextNode(self._sympystr(printer)))
        return made


class _PositiveFirst:
    """Makes a printer start a sum with a term without a minus sign, if there is one."""

    def _as_ordered_terms(self, expr: Any, order: Any = None) -> list[Any]:
        terms = super()._as_ordered_terms(expr, order)  # type: ignore[misc]
        first, *others = sorted(terms, key=lambda term: term.could_extract_minus_sign())
        return [_Slot(first.name, bare=True) if isinstance(first, _Slot) else first, *others]


class _Text(_PositiveFirst, StrPrinter):
    pass


class _Latex(_PositiveFirst, LatexPrinter):
    def _print_atan2(self, expr: Any) -> str:
        return r"\operatorname{{atan2}}\left({}, {}\right)".format(*map(self._print, expr.args))


class _MathML(_PositiveFirst, MathMLPresentationPrinter):
    def mathml_tag(self, e: Any) -> str:
        return "atan2" if isinstance(e, sympy.atan2) else super().mathml_tag(e)

    def doprint(self, expr: Any) -> str:
        """Return an expression as MathML with a mark (BREAK) wherever a line may end, because browsers do not break formulas."""
        made, before = "", ""
        for node in _flat(self._print(expr)):
            now = node.firstChild.data if node.tagName == "mo" else ""
            if now in ("+", "-"):
                node.setAttribute("form", "infix" if made and not before else "prefix")
                made += BREAK if made and not before else ""
            # A square root is long, so a line may be broken before it.
            if node.tagName == "msqrt" and before == "&#xB7;":
                made += BREAK
            made += node.toxml() + (BREAK if now == "," else "")
            before = now.replace(")", "").replace("|", "")
        return made.replace(">-<", ">&#8722;<").encode("ascii", "xmlcharrefreplace").decode()


def _flat(node: Any) -> Iterator[Any]:
    """Yield the nodes of a MathML row one by one, with rows that only group them dissolved."""
    if node.tagName != "mrow":
        yield node
    else:
        for child in node.childNodes:
            yield from _flat(child)


@functools.lru_cache(4096)  # cached, because the formulas of a closed form are the same for every target
def written(expression: Any, form: str) -> str:
    """Return a SymPy expression as 'text' (one line of Python), 'latex' (no dollar signs) or 'mathml' (for inside `<math>`)."""
    if form == "text":
        return _Text().doprint(expression)
    dots = {"mul_symbol": "dot"} if form == "mathml" or expression.has(_Slot) else {}
    return (_Latex if form == "latex" else _MathML)(dots).doprint(expression)


def with_numbers(expression: Any, form: str, texts: Mapping[str, str]) -> str:
    """Return a SymPy expression as text, unsimplified, with values such as '-12.5 deg' (by symbol name) in place of symbols."""

    def put_in(found: re.Match[str]) -> str:
        text = texts.get(found[1], "180 deg")
        number = quantity(text, form)
        if not (found[2] and text.startswith("-")):
            return number
        return rf"\left({number}\right)" if form == "latex" else f"({number})"

    return SLOT.sub(put_in, written(_with_slots(expression, True), form))


def quantity(text: str, form: str) -> str:
    """Return a number with its unit, like '-12.5 deg', as 'text', 'latex' or 'mathml' (for inside `<mn>`)."""
    digits, _, unit = text.partition(" ")
    if form == "text" or (not unit and form == "latex"):
        return text
    if form == "latex":
        return digits + (r"^\circ" if unit == "deg" else rf"\,\mathrm{{{unit}}}")
    return digits.replace("-", "&#8722;") + {"deg": "&#176;", "": ""}.get(unit, f"&#160;{unit}")


@functools.lru_cache(4096)
def _with_slots(node: Any, bare: bool) -> Any:
    """Return the expression `node` with placeholders for its symbols; bare: whether it stands alone, so needs no parentheses."""
    if node.is_Symbol or node is sympy.pi:
        return _Slot(str(node), bare)
    if not node.args:
        return node
    return node.func(*(_with_slots(x, isinstance(node, Application)) for x in node.args), evaluate=False)
