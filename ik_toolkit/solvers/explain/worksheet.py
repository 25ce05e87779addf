"""Writes a closed form down step by step: SymPy formulas with the numbers of the solver."""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

from sympy import Expr, Matrix, Symbol, lambdify, pi

from .worked_solution import WorkedStep


class Worksheet:
    """Collects the steps of a calculation (formulas with their values) in the order in which they are computed.

    The methods add steps and return their symbols, which the formulas of later steps may use.
    """

    def __init__(self, before: Sequence[WorkedStep] = ()) -> None:
        """Start an empty sheet, whose formulas may use the symbols of the steps `before`."""
        self.values: dict[Any, float] = {step.symbol: step.value for step in before}
        self.steps: list[WorkedStep] = []

    def given(self, name: str, value: float, unit: str = "", words: str = "") -> Any:
        """Add a step for a number [m, rad or 1] that no formula gives; return its symbol."""
        return self._add(name, None, float(value), unit, words)

    def formula(self, name: str, formula: Any, unit: str = "", words: str = "", value: float | None = None) -> Any:
        """Add a step with a formula; return its symbol.

        Its value [m, rad or 1] is `value` if given (as the solver has computed it), or else follows from the values of earlier
        steps.
        """
        return self._add(name, formula, self.value(formula) if value is None else float(value), unit, words)

    def angle(self, name: str, formula: Any, value: float, words: str = "") -> Any:
        """Add a step for an angle [rad]; return its symbol. If `value` is 2 pi k off the formula, this shift is written into it."""
        turns = round((self.value(formula) - value) / (2.0 * math.pi))
        return self._add(name, formula - 2 * turns * pi, float(value), "rad", words)

    def vector(self, name: str, formulas: Any, unit: str = "", words: str = "", values: Any = None) -> Any:
        """Add a step for each component of a vector (NAME_x, NAME_y, NAME_z); return their symbols as a SymPy column.

        Without formulas the components are given numbers.
        """
        axes = "xyz"[: len(values if formulas is None else formulas)]
        made = []
        for i, axis in enumerate(axes):
            formula, said = None if formulas is None else formulas[i], words if not i else ""
            value = self.value(formula) if values is None else float(values[i])
            made.append(self._add(f"{name}_{axis}", formula, value, unit, said))
        return Matrix(made)

    def joint(self, name: str, angle: Any, place: int, sign: float, offset: Any, value: float) -> None:
        """Add a step for the value q [rad] of a revolute joint, which follows from its D-H angle: angle = sign q + offset.

        Nothing is added if the value equals the angle. `place` is the joint's index in q, `name` its name, `angle` the symbol of
        the angle, `offset` the symbol of the angle at q = 0, or 0.
        """
        formula = (angle - offset) * (-1 if sign < 0.0 else 1)
        if formula != angle or abs(value - self.values[angle]) > 1.0:
            self.angle(f"q_{place + 1}", formula, value, name)

    def value(self, formula: Any) -> float:
        """Evaluate a formula with the values of the steps so far; return the number [m, rad or 1]."""
        symbols, function = _compiled(formula)
        return float(function(*(self.values[symbol] for symbol in symbols)))

    def _add(self, name: str, formula: Any, value: float, unit: str, words: str) -> Any:
        symbol = Symbol(name, real=True)
        self.values[symbol] = value
        self.steps.append(WorkedStep(symbol, formula, value, unit, words))
        return symbol


def zero_angles(sheet: Worksheet, offsets: dict[str, float]) -> dict[str, Any]:
    """Add steps alpha_1, ... to a worksheet: the angles [rad] that theta_1, ... have at q = 0, where these are not zero.

    offsets: these angles by the name of theta. Returns for each theta the symbol of its alpha, or 0.
    """
    made = {}
    for name, offset in offsets.items():
        zero = abs(offset) < 1e-12  # [rad] smaller offsets are rounding
        made[name] = 0 if zero else sheet.given(name.replace("theta", "alpha"), offset, "rad", "the angle at q = 0")
    return made


@functools.lru_cache(1024)
def _compiled(formula: Expr) -> tuple[list[Any], Callable[..., float]]:
    """Return the symbols of a formula and a function of their values; as in the solvers, the root of a negative number is zero."""
    symbols = sorted(formula.free_symbols, key=str)
    return symbols, lambdify(symbols, formula, [{"sqrt": lambda x: math.sqrt(max(x, 0.0))}, "math"])
