"""A closed form worked out for one target: its formulas with their numbers, and its branches."""

from typing import Any, NamedTuple

import numpy as np


class WorkedStep(NamedTuple):
    """One line of a calculation.

    symbol: the SymPy symbol that gets a value; formula: a SymPy expression in the symbols of earlier steps, or None where the
    value is given; value [m, rad or 1]; unit: 'm', 'rad' or ''; words: what the symbol is, or ''.
    """

    symbol: Any
    formula: Any
    value: float
    unit: str = ""
    words: str = ""

    @property
    def name(self) -> str:
        """The symbol's name."""
        return str(self.symbol)

    def to_dict(self) -> dict[str, Any]:
        """Texts and numbers; the formula as SymPy prints it, or ''."""
        formula = "" if self.formula is None else str(self.formula)
        return {"name": self.name, "formula": formula, "value": self.value, "unit": self.unit, "words": self.words}


class Branch(NamedTuple):
    """One solution: label, q (n,) [rad or m], the names of the joints outside their limits, and the steps of this branch alone."""

    label: str
    q: np.ndarray
    outside: tuple[str, ...] = ()
    steps: tuple[WorkedStep, ...] = ()


class Free(NamedTuple):
    """A joint that the target leaves free.

    joint: its place in q; parameter: the option of the closed form that sets it; inside: the intervals [rad or m] of values that
    reach the target within the joint's limits; every: those without regard to its limits.
    """

    joint: int
    parameter: str
    inside: tuple[tuple[float, float], ...]
    every: tuple[tuple[float, float], ...]


class WorkedSolution(NamedTuple):
    """What `derive` of a closed form returns for one target.

    steps: what all branches have in common, given numbers first (empty: the closed form shows no formulas); branches; legend: what
    their labels mean; words: what is wrong with the target, or ''; free: a joint that may be chosen, or None; beside: the name of
    an iterative solver worth showing for comparison, or ''.
    """

    steps: tuple[WorkedStep, ...]
    branches: tuple[Branch, ...]
    legend: str = ""
    words: str = ""
    free: Free | None = None
    beside: str = ""

    def steps_of(self, branch: Branch) -> tuple[WorkedStep, ...]:
        """Every step that leads to a branch, from the given numbers to its joint values."""
        return (*self.steps, *branch.steps)


def listed_branches(robot: Any, found: Any) -> WorkedSolution:
    """The branches (`closed_form.geometry.Branches`) of a closed form that shows no formulas."""
    pairs = zip(found.q, found.broken, strict=True)
    branches = [Branch(f"branch {k}", q, robot.outside(q) if x > 0.0 else ()) for k, (q, x) in enumerate(pairs, 1)]
    return WorkedSolution((), tuple(branches))
