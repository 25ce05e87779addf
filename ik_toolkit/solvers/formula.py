"""Formulas for people: one Python expression as text, LaTeX or MathML, with names or with numbers in their place."""

import ast
import html
import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

SCALES = {"m": 1000.0, "rad": math.degrees(1.0), "": 1.0}  # from a unit to the one shown, see blocks.UNITS
BREAK = "\v"  # in MathML: where a line may end
SUM, PRODUCT, SIGN, POWER, ATOM = range(5)  # how tightly the outermost operation binds
GREEK = ("alpha", "beta", "gamma", "theta", "phi", "chi", "psi", "rho")
FUNCTIONS: dict[str, Any] = {
    "sin": math.sin, "cos": math.cos, "acos": lambda x: math.acos(min(max(x, -1.0), 1.0)), "atan2": math.atan2,
    "hypot": math.hypot, "sqrt": lambda x: math.sqrt(max(x, 0.0)), "abs": abs, "min": min, "max": max,
}  # fmt: skip
# An edge that rounding passes counts as the edge, as in the solvers.
OPERATIONS: dict[type, tuple[Any, int]] = {
    ast.Add: (lambda a, b: a + b, SUM), ast.Sub: (lambda a, b: a - b, SUM), ast.Mult: (lambda a, b: a * b, PRODUCT),
    ast.Div: (lambda a, b: a / b, PRODUCT), ast.Pow: (lambda a, b: a**b, POWER),
}  # fmt: skip


class Quantity(NamedTuple):
    """A number of a formula: its name, its value and its unit ('m', 'rad' or '')."""

    name: str
    value: float
    unit: str = ""


def decimals(reach: float) -> int:
    """Decimals of a millimetre that show a millionth of an arm's reach [m]."""
    return int(min(max(round(6.0 - math.log10(1000.0 * reach)), 0), 12))


def unit_of(kind: str) -> str:
    """Unit of the values of a joint of this kind, a key of SCALES."""
    return "m" if kind == "prismatic" else "rad"


def number(value: float, unit: str, places: int) -> str:
    """Digits of a value [m, rad or 1] in millimetres (with `places` decimals), degrees or as it is."""
    digits = {"m": places, "rad": 4}.get(unit, 6)
    text = f"{SCALES[unit] * value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def evaluate(expression: str, values: Mapping[str, float]) -> float:
    """Value of an expression [m, rad or 1] with these values of its names."""
    return _value(ast.parse(expression, mode="eval").body, {"pi": math.pi, **values})


def _value(node: Any, values: Mapping[str, float]) -> float:
    if isinstance(node, ast.BinOp):
        return OPERATIONS[type(node.op)][0](_value(node.left, values), _value(node.right, values))
    if isinstance(node, ast.UnaryOp):
        return -_value(node.operand, values)
    if isinstance(node, ast.Call):
        return FUNCTIONS[node.func.id](*(_value(x, values) for x in node.args))  # type: ignore[attr-defined]
    return node.value if hasattr(node, "value") else values[node.id]


class Text:
    """Plain text, 7-bit: names as they are, `sqrt(...)`, degrees as `12.5 deg`."""

    minus, plus = " - ", " + "
    bars = False  # quotients and roots are drawn with bars, which need no parentheses

    def name(self, name: str) -> str:
        """A symbol."""
        return name

    def digits(self, text: str, unit: str) -> str:
        """A number that stands for a symbol."""
        return f"{text} deg" if unit == "rad" else text

    def group(self, inner: str) -> str:
        """In parentheses."""
        return f"({inner})"

    def negative(self, inner: str) -> str:
        """With its sign turned."""
        return f"-{inner}"

    def times(self, a: str, b: str) -> str:
        """Product."""
        return f"{a}*{b}"

    def over(self, a: str, b: str) -> str:
        """Quotient of two factors."""
        return f"{a}/{b}"

    def power(self, a: str, b: str) -> str:
        """Power."""
        return f"{a}^{b}"

    def call(self, name: str, arguments: list[str]) -> str:
        """A function of its arguments."""
        return f"{name}({', '.join(arguments)})"

    def equals(self, parts: list[str]) -> str:
        """A chain of equalities."""
        return " = ".join(parts)


class Latex(Text):
    """LaTeX, without the dollar signs."""

    bars = True

    def name(self, name: str) -> str:
        """A symbol with its index as a subscript; anything but a letter with an index is a word."""
        base, index = split(name)
        if not base:
            return rf"\mathrm{{{name}}}".replace("_", r"\_")
        letter = f"\\{base}" if base in GREEK else base
        return f"{letter}_{{{index}}}" if index else letter

    def digits(self, text: str, unit: str) -> str:
        """A number that stands for a symbol."""
        return rf"{text}^\circ" if unit == "rad" else text

    def group(self, inner: str) -> str:
        """In parentheses."""
        return rf"\left({inner}\right)"

    def times(self, a: str, b: str) -> str:
        """Product."""
        return rf"{a}\,{b}" if not b[0].isdigit() else rf"{a}\cdot {b}"

    def over(self, a: str, b: str) -> str:
        """Quotient."""
        return rf"\frac{{{a}}}{{{b}}}"

    def power(self, a: str, b: str) -> str:
        """Power."""
        return f"{a}^{{{b}}}"

    def call(self, name: str, arguments: list[str]) -> str:
        """A function of its arguments."""
        if name == "sqrt":
            return rf"\sqrt{{{arguments[0]}}}"
        if name == "abs":
            return rf"\left|{arguments[0]}\right|"
        head = f"\\{name}" if name in ("sin", "cos", "min", "max") else rf"\operatorname{{{name}}}"
        return rf"{head}\left({', '.join(arguments)}\right)"


class MathML(Text):
    """MathML Core, which browsers draw themselves. Flat, with a BREAK wherever a line may end: see `pieces`."""

    bars = True
    minus, plus = f'{BREAK}<mo form="infix">&minus;</mo>', f'{BREAK}<mo form="infix">+</mo>'

    def name(self, name: str) -> str:
        """A symbol."""
        base, index = split(name)
        if not base:
            return f"<mtext>{html.escape(name)}</mtext>"
        letter = f"<mi>&{base};</mi>" if base in GREEK else f"<mi>{base}</mi>"
        kind = "mn" if index.isdigit() else "mi"
        return f"<msub>{letter}<{kind}>{index}</{kind}></msub>" if index else letter

    def digits(self, text: str, unit: str) -> str:
        """A number that stands for a symbol."""
        sign, text = (self.negative(""), text[1:]) if text.startswith("-") else ("", text)
        return f"{sign}<mn>{text}{'&deg;' if unit == 'rad' else ''}</mn>"

    def group(self, inner: str) -> str:
        """In parentheses."""
        return f"<mo>(</mo>{inner}<mo>)</mo>"

    def negative(self, inner: str) -> str:
        """With its sign turned."""
        return f'<mo form="prefix">&minus;</mo>{inner}'

    def times(self, a: str, b: str) -> str:
        """Product."""
        return f"{a}{BREAK}<mo>&middot;</mo>{b}" if "msqrt" in a else f"{a}<mo>&middot;</mo>{b}"

    def over(self, a: str, b: str) -> str:
        """Quotient."""
        return f"<mfrac><mrow>{a}</mrow><mrow>{b}</mrow></mfrac>"

    def power(self, a: str, b: str) -> str:
        """Power."""
        return f"<msup><mrow>{a}</mrow><mrow>{b}</mrow></msup>"

    def call(self, name: str, arguments: list[str]) -> str:
        """A function of its arguments."""
        if name == "sqrt":
            return f"<msqrt>{arguments[0]}</msqrt>"
        if name == "abs":
            return f'<mo form="prefix">|</mo>{arguments[0]}<mo form="postfix">|</mo>'
        return f"<mi>{name}</mi>{self.group(f'<mo>,</mo>{BREAK}'.join(arguments))}"


def pieces(written: str) -> list[str]:
    """MathML in pieces that may go on separate lines: browsers do not break a line inside a formula."""
    made, depth = [""], 0
    for part in re.split(f"({BREAK}|</?(?:mrow|msqrt|msub)>)", written):
        depth += part in ("<mrow>", "<msqrt>", "<msub>")
        depth -= part in ("</mrow>", "</msqrt>", "</msub>")
        if part != BREAK:
            made[-1] += part
        elif not depth:
            made.append("")
    return [piece for piece in made if piece]


def split(name: str) -> tuple[str, str]:
    """Letter and index of a symbol (theta_5, n_x, a4, L); ('', '') of a word."""
    found = re.fullmatch(r"([A-Za-z]|" + "|".join(GREEK) + r")_?(\d+|[a-z])?", name)
    return (found[1], found[2] or "") if found else ("", "")


def write(expression: str, form: Text, numbers: Mapping[str, Quantity] | None = None, places: int = 3) -> str:
    """An expression in a form; with `numbers` these stand in place of the names."""
    return _written(ast.parse(expression, mode="eval").body, form, numbers, places)[0]


def _written(node: Any, form: Text, numbers: Mapping[str, Quantity] | None, places: int) -> tuple[str, int]:
    """Text of a node, and how tightly it binds."""

    def inside(part: Any, least: int) -> str:
        text, binds = _written(part, form, numbers, places)
        return text if binds >= least else form.group(text)

    if isinstance(node, ast.BinOp):
        binds = OPERATIONS[type(node.op)][1]
        if isinstance(node.op, ast.Div) and form.bars:
            return form.over(inside(node.left, SUM), inside(node.right, SUM)), ATOM
        # What follows a minus or a slash, and a number below zero after any sign, is set apart.
        left, right = inside(node.left, binds + (binds == POWER)), inside(node.right, binds + 1)
        if binds == SUM:
            return left + (form.minus if isinstance(node.op, ast.Sub) else form.plus) + right, SUM
        make = {ast.Mult: form.times, ast.Div: form.over, ast.Pow: form.power}[type(node.op)]
        return make(left, right), binds
    if isinstance(node, ast.UnaryOp):
        return form.negative(inside(node.operand, PRODUCT)), SUM
    if isinstance(node, ast.Call):
        name = node.func.id  # type: ignore[attr-defined]
        if name == "hypot" and form.bars:
            squares = (form.power(inside(x, ATOM), form.digits("2", "")) for x in node.args)
            return form.call("sqrt", [form.plus.join(squares)]), ATOM
        return form.call(name, [inside(x, SUM) for x in node.args]), ATOM
    if isinstance(node, ast.Constant):
        return form.digits(str(node.value), ""), ATOM
    if numbers is None:
        return form.name(node.id), ATOM
    if node.id == "pi":
        return form.digits("180", "rad"), ATOM
    given = numbers[node.id]
    text = number(given.value, given.unit, places)
    return form.digits(text, given.unit), SUM if text.startswith("-") else ATOM
