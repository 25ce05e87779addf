"""Derivation of a closed form for one target: its formulas, the numbers in them, and its branches."""

from typing import Any, NamedTuple

import numpy as np

from .formula import Quantity, evaluate

TINY = 1e-12  # [rad] rounding of a zero offset


class Step(NamedTuple):
    """One formula: the symbol it gives, a Python expression of symbols before it ('': given), its value [m, rad or 1], words."""

    name: str
    formula: str
    value: float
    unit: str = ""
    words: str = ""

    @property
    def quantity(self) -> Quantity:
        """The symbol with its number."""
        return Quantity(self.name, self.value, self.unit)


class Branch(NamedTuple):
    """One solution: its label, q (n,) [rad or m], the names of joints outside their limits, and the formulas that are its own."""

    label: str
    q: np.ndarray
    outside: tuple[str, ...] = ()
    steps: tuple[Step, ...] = ()


class Free(NamedTuple):
    """A joint that is free within a target: place in q, the closed form's parameter that sets it, and where it may be [rad or m].

    inside: intervals within the joint's limits; every: whatever its limits.
    """

    joint: int
    parameter: str
    inside: tuple[tuple[float, float], ...]
    every: tuple[tuple[float, float], ...]


class Derivation(NamedTuple):
    """A closed form, worked out for one target.

    given: numbers it starts from; shared: formulas that all branches have in common; branches; legend: what the labels mean;
    words: what has to be said of the target ('' where all is well); free: a joint that may be chosen, or None; beside: name of an
    iterative solver worth showing next to it, or ''.
    """

    given: tuple[Step, ...]
    shared: tuple[Step, ...]
    branches: tuple[Branch, ...]
    legend: str = ""
    words: str = ""
    free: Free | None = None
    beside: str = ""

    def symbols(self, branch: Branch) -> dict[str, Quantity]:
        """Every symbol of a branch, with its number."""
        return {step.name: step.quantity for step in (*self.given, *self.shared, *branch.steps)}


class Worksheet:
    """Steps being written down: each may use the symbols before it."""

    def __init__(self, before: tuple[Step, ...] = ()) -> None:
        """Continue after these steps."""
        self.values = {step.name: step.value for step in before}
        self.steps: list[Step] = []

    def add(self, name: str, formula: str, value: float | None = None, unit: str = "", words: str = "") -> float:
        """Write down a step; its value is the solver's own where one is given, or else that of the formula."""
        number = evaluate(formula, self.values) if value is None else float(value)
        self.values[name] = number
        self.steps.append(Step(name, formula, number, unit, words))
        return number

    def angle(self, name: str, formula: str, value: float, words: str = "") -> None:
        """Write down an angle [rad] that the solver took full turns off: the formula says how many."""
        turns = round((evaluate(formula, self.values) - value) / (2.0 * np.pi))
        if turns:
            formula = f"{formula} {'-' if turns > 0 else '+'} {abs(2 * turns)}*pi"
        self.add(name, formula, value, "rad", words)


def listed_branches(robot: Any, made: Any) -> Derivation:
    """The branches of a closed form (`closed_form.geometry.Branches`) that shows no formulas."""
    pairs = zip(made.q, made.broken, strict=True)
    branches = [Branch(f"branch {k}", q, robot.outside(q) if x > 0.0 else ()) for k, (q, x) in enumerate(pairs, 1)]
    return Derivation((), (), tuple(branches))


def zero_steps(offsets: dict[str, float]) -> tuple[Step, ...]:
    """Given angles [rad] of symbols (theta_1 ...) at q = 0, of those that are not zero there."""
    words = "the angle at q = 0"
    return tuple(Step(_zero(name), "", x, "rad", words) for name, x in offsets.items() if abs(x) > TINY)


def joint_step(sheet: Worksheet, place: int, name: str, sign: float, value: float, words: str) -> None:
    """Write down how joint value q_i [rad], i from place 0, follows from an angle = sign q + offset, unless it is that angle."""
    formula = f"{name} - {_zero(name)}" if _zero(name) in sheet.values else name
    if sign < 0.0:
        formula = f"-({formula})" if formula != name else f"-{name}"
    if formula != name or abs(value - sheet.values[name]) > 1.0:
        sheet.angle(f"q_{place + 1}", formula, value, words)


def _zero(name: str) -> str:
    return name.replace("theta", "alpha")
