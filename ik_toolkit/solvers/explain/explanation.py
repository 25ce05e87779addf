"""An explained solve: D-H table, target, formulas with numbers, branches and iterations."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ...robot.formats.dh import DHTable
from ...text import angle, how_many, length, plain
from .dh_table import dh_blocks
from .layout import (
    UNITS,
    Block,
    Equations,
    OutsideLimits,
    Sentence,
    Table,
    Title,
    blocks_to_text,
    decimals,
    digits,
    to_html,
    to_markdown,
    unit_of,
)
from .worked_solution import Branch, WorkedSolution, nearest_branch


class Iterations(NamedTuple):
    """The iterations of the attempt in which an iterative solver found its answer, a row for each evaluation.

    The arrays are position (K,) [m] and orientation (K,) [rad] errors (NaN where it is free), and q (K, n) [rad or m].
    """

    solver: str
    success: bool
    message: str
    attempt: int
    position: np.ndarray
    orientation: np.ndarray
    q: np.ndarray


@dataclass(frozen=True, repr=False)
class Explanation:
    """How a solution was computed; `str()` gives text of 80 columns, and a notebook shows it with rendered formulas.

    Attributes:
        robot: The robot that was solved for.
        q: The answer (n,) [rad or m].
        message: The message of the solve, one sentence.
        targets: Target of each tip: T (4, 4), or (3,) if no rotation counts.
        tables: D-H table of each tip, or None if it has none.
        worked: The closed form written out with its numbers, or None.
        form: Name of the closed form, or ''.
        source: Publication of the closed form.
        why: Why there is no closed form, or ''.
        chosen: Index of the branch that is the answer, or None.
        errors: Position [m] and orientation error [rad, or None] of each branch, computed by Pinocchio.
        iterations: The iterations of an iterative solver, or None.
    """

    robot: Any
    q: np.ndarray
    message: str
    targets: dict[str, np.ndarray]
    tables: dict[str, DHTable | None]
    worked: WorkedSolution | None
    form: str
    source: str
    why: str
    chosen: int | None
    errors: tuple[tuple[float, float | None], ...]
    iterations: Iterations | None

    # ------------------------------------------------------------------------------------------------------------- parts
    @property
    def places(self) -> int:
        """The number of decimals with which millimetres are shown."""
        return decimals(self.robot.reach)

    @property
    def nearest(self) -> int:
        """Index of the branch whose joint values are nearest the answer, 0 if there is no branch."""
        return nearest_branch(self.robot, self.worked.branches, self.q)[0] if self.worked is not None else 0

    def blocks(self) -> Iterator[Block]:
        """Yield the parts of the explanation in order (sentences, titles, tables, equations), not yet formatted as text or HTML."""
        yield Sentence(f"{self.message[0].upper()}{self.message[1:].rstrip('.')}. Lengths in mm, angles in degrees.")
        for arm, place in zip(self.robot.arms, self.robot.places, strict=True):
            yield Title("Denavit-Hartenberg table" + (f" of {arm.tip}" if len(self.tables) > 1 else ""))
            yield from dh_blocks(arm, self.tables[arm.tip], self.q[np.asarray(place)])
        for tip, T in self.targets.items():
            yield Title("Target" + (f" of {tip}" if len(self.tables) > 1 else ""))
            yield target_table(T, self.places)
        if self.worked is not None:
            yield Title(f"Closed form '{self.form}'")
            if self.worked.free is not None:
                yield Sentence(self.free_words())
            yield from self.formula_blocks(self.nearest)
            yield Title("Branches")
            yield from self.branch_blocks()
        else:
            yield Title("Closed form")
            yield Sentence(self.why)
        if self.iterations is not None:
            yield Title(f"Iterations of '{self.iterations.solver}'")
            yield from self.iteration_blocks()

    def formula_blocks(self, k: int) -> Iterator[Block]:
        """Yield the parts of the explanation with the formulas, and their numbers, that lead to solution (branch) k."""
        assert self.worked is not None
        made = self.worked
        if made.words:
            yield Sentence(f"{made.words[0].upper()}{made.words[1:]}.")
        branch = made.branches[k] if made.branches else Branch("", self.q)
        if not made.steps:
            yield Sentence("This closed form shows no formulas, only its branches.")
            return
        yield Equations(made.steps, (), self.places)
        if branch.label:
            yield Sentence(f"Branch {k + 1}, {branch.label}:")
        yield Equations(branch.steps, made.steps, self.places)
        if self.source:
            yield Sentence(f"Source: {self.source}.")

    def free_words(self) -> str:
        """Return a sentence or two on the values that a joint left free by the target may take."""
        assert self.worked is not None and self.worked.free is not None
        free = self.worked.free
        name, unit = self.robot.joint_names[free.joint], unit_of(self.robot.joint_kinds[free.joint])

        def said(spans: Sequence[tuple[float, float]]) -> str:
            ends = [(digits(a, unit, self.places), digits(b, unit, self.places)) for a, b in spans]
            return " and ".join(f"{a} to {b}" for a, b in ends) + f" {UNITS[unit]}"

        here = f"The joint {name} is free; here it is {digits(self.q[free.joint], unit, self.places)} {UNITS[unit]}."
        if not free.every:
            return f"{here} No value of it reaches the pose."
        if free.inside == free.every:
            return f"{here} The pose is reached from {said(free.inside)}."
        reached = f"from {said(free.inside)} within its limits" if free.inside else "from nowhere within its limits"
        return f"{here} The pose is reached {reached}, and from {said(free.every)} without them."

    def branch_blocks(self) -> Iterator[Block]:
        """Yield tables of the closed form's branches: label, whether inside limits, joint values, position error by Pinocchio."""
        assert self.worked is not None
        branches, kinds = self.worked.branches, self.robot.joint_kinds
        if not branches:
            yield Sentence("There is none.")
            return
        rows = []
        for k, branch in enumerate(branches):
            count = len(branch.outside)
            said = f"outside {how_many(count, 'limit')}" if count else "inside the limits"
            rows.append((str(k + 1), branch.label, f"{said}; the answer" if k == self.chosen else said))
        yield Table(("", "branch", ""), rows)
        rows = []
        for i, (name, kind) in enumerate(zip(self.robot.joint_names, kinds, strict=True)):
            texts = [digits(branch.q[i], unit_of(kind), self.places) for branch in branches]
            bad = [name in branch.outside for branch in branches]
            rows.append((name, *(OutsideLimits(x) if y else x for x, y in zip(texts, bad, strict=True))))
        rows.append(("FK error", *(length(position, 1) for position, _ in self.errors)))
        yield Table(("joint", *(str(k + 1) for k in range(len(branches)))), rows)
        marked = "! is outside the joint's limits. " if any(branch.outside for branch in branches) else ""
        yield Sentence(f"{marked}FK error: distance from the target by Pinocchio. {self.worked.legend}".rstrip())
        if self.chosen is None:
            # The answer need not equal the branch exactly, because of the solver's tolerance or Newton steps. So the text says how
            # much they differ.
            k = self.nearest
            i = int(np.argmax(np.abs(branches[k].q - self.q) / self.robot.chain.unit))
            off = abs(float(branches[k].q[i] - self.q[i]))
            size = length(off) if kinds[i] == "prismatic" else angle(off)
            where = f"the nearest is branch {k + 1}, where {self.robot.joint_names[i]} differs by {size}"
            yield Sentence(f"The solution is not exactly one of these branches; {where}.")

    def iteration_blocks(self) -> Iterator[Block]:
        """Yield a table of the errors in each iteration of an iterative solver, and a sentence on how it ended."""
        assert self.iterations is not None
        i = self.iterations
        turned = not np.isnan(i.orientation).all()
        # beside the errors there is room for at most three joint values
        joints = range(self.robot.n if self.robot.n <= 3 else 0)
        units = [unit_of(kind) for kind in self.robot.joint_kinds]
        names = [self.robot.joint_names[j] for j in joints]
        head = ("k", "error (mm)", *["error (deg)"] * turned, *names)
        rows = []
        for k in range(len(i.position)):
            cells = [str(k), f"{1000.0 * i.position[k]:.3e}"]
            cells += [f"{math.degrees(i.orientation[k]):.3e}"] if turned else []
            rows.append((*cells, *(digits(i.q[k, j], units[j], self.places) for j in joints)))
        if len(rows) > 14:  # of more than fourteen iterations only the first ten and the last four are shown
            rows[10:-4] = [("...", *[""] * (len(head) - 1))]
        yield Table(head, rows)
        which = f" Attempt {i.attempt} is shown." if i.attempt else ""
        yield Sentence(f"{i.message[0].upper()}{i.message[1:].rstrip('.')}.{which}")

    # ------------------------------------------------------------------------------------------------------------ written
    def __str__(self) -> str:
        """Return the explanation as plain text, 80 columns wide."""
        return blocks_to_text(self.blocks())

    def __repr__(self) -> str:
        """Describe the explanation in one line."""
        branches = "" if self.worked is None else f", '{self.form}', {how_many(len(self.worked.branches), 'branch')}"
        return f"Explanation('{self.robot.name}'{branches}; print it to read it)"

    def to_markdown(self) -> str:
        """Return the explanation as Markdown with the formulas in LaTeX."""
        return to_markdown(self.blocks())

    def to_html(self) -> str:
        """Return the explanation as HTML for inside a page, with the formulas in MathML."""
        return to_html(self.blocks())

    def _repr_markdown_(self) -> str:
        """Return the explanation as notebooks show it."""
        return self.to_markdown()

    def to_dict(self) -> dict[str, Any]:
        """Return the explanation as numbers, strings and lists in metres and radians, ready for JSON."""
        made = self.worked or WorkedSolution((), ())
        branches = [
            {
                "label": branch.label,
                "q": branch.q.tolist(),
                "outside": list(branch.outside),
                "steps": [step.to_dict() for step in branch.steps],
                "position_error": error[0],
                "orientation_error": error[1],
            }
            for branch, error in zip(made.branches, self.errors, strict=True)
        ]
        one = made.free
        free = one and {"joint": self.robot.joint_names[one.joint], "inside": one.inside, "every": one.every}
        found = {
            "closed_form": self.form or None,
            "why": self.why,
            "dh": {tip: table and table.to_dict() for tip, table in self.tables.items()},
            "given": [step.to_dict() for step in made.steps if step.formula is None],
            "steps": [step.to_dict() for step in made.steps if step.formula is not None],
            "branches": branches,
            "chosen": self.chosen,
            "free": free,
            "iterations": self.iterations and self.iterations._asdict(),
        }
        return plain(found)


def target_table(T: np.ndarray, places: int) -> Table:
    """Return a table of a target: the columns n, o, a (rotation) and p (position) of its pose, or p alone if rotation is free."""
    shown = zip("xyz", T[:, None] if T.ndim == 1 else T[:3], strict=True)
    rows = [(axis, *(digits(x, "", 0) for x in row[:-1]), digits(row[-1], "m", places)) for axis, row in shown]
    return Table(("", "p") if T.ndim == 1 else ("", "n", "o", "a", "p"), rows)
