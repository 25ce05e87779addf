"""Linear equations between joint values -> which joint follows which, and which stand still."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

ZERO = 1e-9  # what is left of a coefficient by elimination, over the largest of its equation, that counts as 0
LEAST = 1e-6  # a joint may be expressed by another if its coefficient is at least this fraction of the largest


class Equation(NamedTuple):
    """Sum of coefficients (joint -> c) times joint values = value; first: a joint that is meant to follow (-1: none)."""

    name: str
    terms: dict[int, float]
    value: float
    first: int = -1


class Solved(NamedTuple):
    """tied: follower -> (leader, ratio, offset); held: joint -> value; against: equations that contradict those before them.

    left: equations that tie several free joints, and those against with all that share joints with them, in any number of steps.
    """

    tied: dict[int, tuple[int, float, float]]
    held: dict[int, float]
    left: list[Equation]
    against: list[Equation]

    def free(self, terms: dict[int, float]) -> tuple[dict[int, float], float]:
        """A linear form over leaders alone: coefficients that are not 0, and the constant."""
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
    """Eliminate: every joint that a multiple of one other joint, or a number, can express is expressed so."""
    first = list(dict.fromkeys(one.first for one in equations if one.first >= 0))
    others = sorted({joint for one in equations for joint in one.terms} - set(first), reverse=True)
    columns = [*first, *others]  # those that come first are expressed by those after them
    place = {joint: i for i, joint in enumerate(columns)}
    rows: dict[int, np.ndarray] = {}  # pivot -> coefficients, then the right side
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
    groups: list[tuple[int, np.ndarray, float]] = []  # leaders that depend on several others
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
    """Solve without some equations, which no configuration keeps, and without all that are connected with them: these are left."""
    bad = _connected(equations, some)
    rest = solve_linear([one for one in equations if one not in bad])
    return rest._replace(left=[*rest.left, *bad])


def _connected(equations: Sequence[Equation], some: Sequence[Equation]) -> list[Equation]:
    """The equations that share a joint with some, or with one that does."""
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
