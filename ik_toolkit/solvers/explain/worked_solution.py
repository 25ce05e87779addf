"""A closed form written out for one target: its formulas with their numbers, and its branches."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..closed_form.geometry import SNAP


class WorkedStep(NamedTuple):
    """One line of a calculation: a symbol, and the number or the formula that it stands for.

    `symbol` is a SymPy symbol; `formula` a SymPy expression in the symbols of earlier steps, or None if the value is given;
    `value` is in m, rad or 1, as `unit` ('m', 'rad' or '') says; `words` describe the symbol, or are ''.
    """

    symbol: Any
    formula: Any
    value: float
    unit: str = ""
    words: str = ""

    @property
    def name(self) -> str:
        """The name of the symbol that the step defines."""
        return str(self.symbol)

    def to_dict(self) -> dict[str, Any]:
        """Return the step as texts and numbers; the formula is as SymPy prints it, or ''."""
        formula = "" if self.formula is None else str(self.formula)
        return {"name": self.name, "formula": formula, "value": self.value, "unit": self.unit, "words": self.words}


class Branch(NamedTuple):
    """One solution (branch) of a closed form, with what is shown about it.

    label: text such as its signs of shoulder, elbow and wrist; q: joint values (n,) [rad or m]; names of joints outside their
    limits; the steps of the calculation that belong to this solution alone.
    """

    label: str
    q: np.ndarray
    outside: tuple[str, ...] = ()
    steps: tuple[WorkedStep, ...] = ()


class Free(NamedTuple):
    """A joint whose value the target does not determine.

    `joint` is its index in q, `parameter` the option of the closed form that sets it, `inside` the intervals [rad or m] of values
    that reach the target within the joint's limits, `every` the intervals without regard to its limits.
    """

    joint: int
    parameter: str
    inside: tuple[tuple[float, float], ...]
    every: tuple[tuple[float, float], ...]


class WorkedSolution(NamedTuple):
    """A closed form written out for one target, as its method `derive` returns it.

    `steps` has what all branches share, given numbers first (empty if the closed form shows no formulas); `legend` says what the
    labels of branches mean; `words` say what is wrong with the target, or are ''; `free` is a joint that may be chosen, or None;
    `beside` is the name of an iterative solver to compare with, or ''.
    """

    steps: tuple[WorkedStep, ...]
    branches: tuple[Branch, ...]
    legend: str = ""
    words: str = ""
    free: Free | None = None
    beside: str = ""

    def steps_of(self, branch: Branch) -> tuple[WorkedStep, ...]:
        """Return every step of the calculation that leads to one solution (branch), from the given numbers to its joint values."""
        return (*self.steps, *branch.steps)


def listed_branches(robot: Any, found: Any) -> WorkedSolution:
    """Return the solutions (`closed_form.geometry.Branches`) of a closed form as a WorkedSolution without formulas."""
    branches = [Branch(f"branch {k}", q, outside_limits(robot, q)) for k, q in enumerate(found.q, 1)]
    return WorkedSolution((), tuple(branches))


def outside_limits(robot: Any, q: np.ndarray) -> tuple[str, ...]:
    """Return the names of the joints whose value in q (n,) [rad or m] is outside its limits by more than rounding."""
    inside = np.clip(q, robot.lower, robot.upper)
    return tuple(robot.outside(np.where(np.abs(q - inside) <= SNAP, inside, q)))


def nearest_branch(robot: Any, branches: Sequence[Branch], q: np.ndarray) -> tuple[int, float]:
    """Return the index of the branch nearest q (n,) [rad or m], and by how much [rad, or length / reach] it differs at most.

    If there is no branch, returns 0 and infinity.
    """
    far = [float(np.abs((branch.q - q) / robot.chain.unit).max()) for branch in branches]
    best = int(np.argmin(far)) if far else 0
    return best, far[best] if far else np.inf
