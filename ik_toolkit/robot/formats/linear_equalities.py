"""Solves linear equations between joint values: finds which joints follow another joint, and which cannot move."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

ZERO = 1e-9  # After elimination a coefficient counts as 0 below this fraction of the largest one of its equation.
LEAST = 1e-6  # A joint is expressed by another one only if its coefficient is at least this fraction of the largest.


class Equation(NamedTuple):
    """The linear equation sum(c_j q_j) = value between joint values; `terms` maps the number j of a joint to its coefficient c_j.

    `first` is the number of the joint that should become a mimic joint of another, or -1 if any may.
    """

    name: str
    terms: dict[int, float]
    value: float
    first: int = -1


class Solved(NamedTuple):
    """The solution of a set of linear equations between joints, which are given by their numbers.

    `tied` maps a joint that depends on one other, its leader, to (leader, ratio, offset), and `held` a joint that cannot move to
    its value. `against` lists the equations that contradict earlier ones. `left` lists the equations that are not solved: those
    that couple more than two joints, those that contradict others, and all that share a joint with them, directly or through
    further equations.
    """

    tied: dict[int, tuple[int, float, float]]
    held: dict[int, float]
    left: list[Equation]
    against: list[Equation]

    def free(self, terms: dict[int, float]) -> tuple[dict[int, float], float]:
        """Rewrite a linear combination of joint values in independent joints only; return its new coefficients and constant."""
        found: dict[int, float] = {}
        constant, size = 0.0, 0.0
        for joint, c in terms.items():
            if joint in self.held:
                constant += c * self.held[joint]
                continue
            leader, ratio, offset = self.tied.get(joint, (joint, 1.0, 0.0))
            found[leader] = found.get(leader, 0.0) + c * ratio
            size = max(size, abs(c * ratio))
            constant += c * offset
        return {joint: c for joint, c in found.items() if abs(c) > ZERO * size}, constant


def solve_linear(equations: Sequence[Equation]) -> Solved:
    """Solve linear equations between joints by elimination, so that each joint depends on at most one other, if possible."""
    first = list(dict.fromkeys(one.first for one in equations if one.first >= 0))
    others = sorted({joint for one in equations for joint in one.terms} - set(first), reverse=True)
    columns = [*first, *others]  # Elimination expresses a joint by joints that come later in this order.
    place = {joint: i for i, joint in enumerate(columns)}
    # For each pivot column, the row of the reduced system: coefficients of the joints, then the right-hand side.
    rows: dict[int, np.ndarray] = {}
    against: list[Equation] = []
    for one in equations:
        row = np.zeros(len(columns) + 1)
        for joint, c in one.terms.items():
            row[place[joint]] += c
        row[-1] = one.value
        size = max(np.abs(row[:-1]).max(initial=0.0), 1e-300)
        for pivot, known in rows.items():
            row -= row[pivot] * known
        row[:-1][np.abs(row[:-1]) <= ZERO * size] = 0.0
        big = np.abs(row[:-1]).max(initial=0.0)
        if big == 0.0:
            if abs(row[-1]) > ZERO * max(size, abs(one.value)):
                against.append(one)
            continue
        pivot = int(np.flatnonzero(np.abs(row[:-1]) >= LEAST * big)[0])
        row /= row[pivot]
        for known in rows.values():
            known -= known[pivot] * row
            known[:-1][np.abs(known[:-1]) <= ZERO] = 0.0
        rows[pivot] = row
    tied: dict[int, tuple[int, float, float]] = {}
    held: dict[int, float] = {}
    # Joints that depend on several others at once, each with the coefficients of these and an offset.
    groups: list[tuple[int, np.ndarray, float]] = []
    for pivot, row in rows.items():
        joint, offset = columns[pivot], float(row[-1])
        slopes = -row[:-1]
        slopes[pivot] = 0.0
        free = np.flatnonzero(slopes)
        if not len(free):
            held[joint] = offset
        elif len(free) == 1:
            tied[joint] = (columns[int(free[0])], float(slopes[free[0]]), offset)
        else:
            same = next((g for g in groups if _parallel(g[1], slopes)), None)
            if same is None:
                groups.append((joint, slopes, offset))
                continue
            ratio = float(slopes @ same[1] / (same[1] @ same[1]))
            tied[joint] = (same[0], ratio, offset - ratio * same[2])
    if against:
        return set_apart(equations, against)._replace(against=against)
    made = Solved(tied, held, [], [])
    return made._replace(left=[one for one in equations if made.free(one.terms)[0]])


def set_apart(equations: Sequence[Equation], some: Sequence[Equation]) -> Solved:
    """Solve linear equations without those in `some`, which cannot be satisfied, and without all that share joints with them.

    The equations that were left out are listed in `left` of the result.
    """
    bad = _connected(equations, some)
    rest = solve_linear([one for one in equations if one not in bad])
    return rest._replace(left=[*rest.left, *bad])


def _connected(equations: Sequence[Equation], some: Sequence[Equation]) -> list[Equation]:
    """Return the equations that share a joint with any of `some`, directly or through other equations."""
    joints = {joint for one in some for joint in one.terms}
    while True:
        found = [one for one in equations if joints & one.terms.keys()]
        more = {joint for one in found for joint in one.terms}
        if more <= joints:
            return found
        joints |= more


def _parallel(a: np.ndarray, b: np.ndarray) -> bool:
    off = b - (b @ a) / (a @ a) * a
    return bool(np.abs(off).max() <= ZERO * np.abs(b).max())
