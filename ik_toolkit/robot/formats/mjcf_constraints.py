"""Reads the equalities and tendons of a compiled MJCF model.

What is linear becomes mimic joints, fixed joints and ranges; everything else becomes a constraint. MuJoCo counts the
joints and tendons of an equality from their values in the initial configuration (`ref` of a joint, `rest` of a tendon):
y - y0 = c0 + c1 (x - x0) + ... An equality without a second joint or tendon means y = y0 + c0.
"""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..constraints import Constraint, End, LinearLength, Loop, Relation
from ..rotation import quat_matrix
from .linear_equalities import Equation, Solved, set_apart, solve_linear

JOINT, PULLEY, SITE = 1, 2, 3  # MuJoCo's numbers for the parts of a tendon; others mean shapes around which it runs.


class Ties(NamedTuple):
    """The equalities and tendons of a model, converted to mimic joints, fixed joints, limits and constraints.

    `tied` maps the name of a mimic joint to (leader, ratio, offset), `held` the index of a joint to the value [rad or m] at which
    it is fixed, and `ranges` the index of a joint to its limits [rad or m]. `constraints` lists what no mimic joint can express,
    and `notes` has a sentence on all that is ignored or converted to another form.
    """

    tied: dict[str, tuple[str, float, float]]
    held: dict[int, float]
    ranges: dict[int, tuple[float, float]]
    constraints: tuple[Constraint, ...]
    notes: list[str]


class TieReader:
    """Converts the equalities and tendons of a compiled MuJoCo model to mimic joints, fixed joints, limits and constraints.

    `joints` and `bodies` are the names of the model's joints and bodies, in MuJoCo's order.
    """

    def __init__(self, model: dict[str, Any], joints: Sequence[str], bodies: Sequence[str]) -> None:
        self.model, self.joints, self.bodies = model, joints, bodies
        self.lengths = [self._tendon(tendon) for tendon in model["tendons"]]

    def read(self) -> Ties:
        """Turn linear equalities into mimic joints and fixed joints, and return them with all other equalities as constraints."""
        equations, curved, notes = [], [], []
        for equality in self.model["equalities"]:
            if not equality["active"]:
                continue
            if equality["type"] in ("connect", "weld"):
                curved.append(self._loop(equality))
            elif equality["type"] in ("joint", "tendon"):
                one = self._relation(equality)
                linear = _equation(one, joints=self.joints, first=equality["type"] == "joint")
                if linear is None:
                    curved.append(one)
                else:
                    equations.append((one, linear))
            else:
                notes.append(f"equality '{equality['name']}' ({equality['type']}) is left out")
        solved = self._within([linear for _, linear in equations], notes)
        curved += [one for one, linear in equations if linear in solved.left]
        notes += [
            f"equality '{one.name}' contradicts those before it: no configuration keeps them all"
            for one in solved.against
        ]
        ranges: dict[int, tuple[float, float]] = {}
        for tendon, length in zip(self.model["tendons"], self.lengths, strict=True):
            if tendon["range"] is not None:
                self._range(tendon, length, solved, ranges, curved)
        for j, value in solved.held.items():
            notes.append(f"joint '{self.joints[j]}' is held at {value:.6g} by an equality")
        tied = {
            self.joints[j]: (self.joints[leader], ratio, offset) for j, (leader, ratio, offset) in solved.tied.items()
        }
        for kind, said in (
            (Loop, "is left open: the solvers do not close it, and each result says how wide it opens"),
            (Relation, "is not kept by the solvers, and each result says whether it holds"),
        ):
            notes += [f"the {one.kind} '{one.name}' {said}" for one in curved if isinstance(one, kind)]
        held = {self.joints[j]: value for j, value in solved.held.items()}
        return Ties(tied, solved.held, ranges, tuple(_with_held(one, held) for one in curved), notes)

    # ------------------------------------------------------------------------------------------------ parts
    def _range(
        self,
        tendon: dict[str, Any],
        length: LinearLength,
        solved: Any,
        ranges: dict[int, tuple[float, float]],
        curved: list[Any],
    ) -> None:
        """Apply the range of a tendon as limits of the one joint it depends on, or as a constraint if there are several."""
        low, high = tendon["range"]
        if length.known and not length.lines:
            terms, constant = solved.free({self.joints.index(name): c for name, c in length.joints})
            if not terms and low <= constant <= high:
                return
            if len(terms) == 1:
                ((j, c),) = terms.items()
                first, last = sorted(((low - constant) / c, (high - constant) / c))
                own = ranges.get(j) or self.model["joints"][j]["range"] or (-np.inf, np.inf)
                if max(own[0], first) <= min(own[1], last):
                    ranges[j] = (max(own[0], first), min(own[1], last))
                    return
        name = tendon["name"] or "tendon"
        curved.append(Relation(name, length._replace(zero=0.0), None, (0.0,), low, high))

    def _within(self, equations: Sequence[Equation], notes: list[str]) -> Solved:
        """Solve linear equations without those that would hold a joint outside its range, which no configuration satisfies."""
        solved = solve_linear(equations)
        beyond = set()
        for j, value in solved.held.items():
            low, high = self.model["joints"][j]["range"] or (-np.inf, np.inf)
            if not low <= value <= high:
                beyond.add(j)
                notes.append(
                    f"joint '{self.joints[j]}' would be held at {value:.6g} by equalities, outside its range {low:g} to {high:g}"
                )
        if not beyond:
            return solved
        apart = set_apart(equations, [one for one in equations if beyond & one.terms.keys()])
        return apart._replace(against=solved.against)

    def _relation(self, equality: dict[str, Any]) -> Relation:
        first, second = int(equality["first"]), int(equality["second"])
        made = self.lengths.__getitem__ if equality["type"] == "tendon" else self._joint
        sources = self.model["tendons" if equality["type"] == "tendon" else "joints"]
        named = [sources[i]["name"] or f"{i}" for i in (first, second) if i >= 0]
        name = equality["name"] or f"{equality['type']} {' and '.join(named)}"
        return Relation(name, made(first), made(second) if second >= 0 else None, tuple(equality["data"][:5]))

    def _joint(self, j: int) -> LinearLength:
        joint = self.model["joints"][j]
        return LinearLength(((self.joints[j], 1.0),), zero=joint["ref"], metres=joint["type"] == "slide")

    def _loop(self, equality: dict[str, Any]) -> Loop:
        weld, data = equality["type"] == "weld", equality["data"]
        pair = [int(equality["first"]), max(int(equality["second"]), 0)]
        if equality["sites"]:
            ends = [self._site(i) for i in pair]
            names = [self.model["sites"][i]["name"] for i in pair]
        else:
            names = [self.bodies[i] for i in pair]
            points = (data[3:6], data[:3]) if weld else (data[:3], data[3:6])
            turn = tuple(quat_matrix(data[6:10], "wxyz").ravel().tolist()) if weld else End("", ()).rotation
            ends = [End(names[0], tuple(points[0]), turn), End(names[1], tuple(points[1]))]
        return Loop(equality["name"] or f"{equality['type']} {' and '.join(names)}", (ends[0], ends[1]), weld)

    def _site(self, i: int) -> End:
        site = self.model["sites"][i]
        turn = quat_matrix(site["quat"], "wxyz").ravel().tolist()
        return End(self.bodies[int(site["body"])], tuple(site["pos"]), tuple(turn))

    def _tendon(self, tendon: dict[str, Any]) -> LinearLength:
        """Return the length of a tendon, which is linear in joint values or runs along sites; around shapes it is not computed."""
        if all(kind == JOINT for kind, _, _ in tendon["parts"]):
            sums: dict[str, float] = defaultdict(float)
            for _, j, c in tendon["parts"]:
                sums[self.joints[int(j)]] += c
            metres = any(self.model["joints"][j]["type"] == "slide" for _, j, _ in tendon["parts"])
            return LinearLength(tuple(sums.items()), zero=tendon["rest"], metres=metres)
        lines, last, share, known = [], None, 1.0, True
        for kind, i, number in tendon["parts"]:
            if kind == PULLEY:
                last, share = None, 1.0 / number
            elif kind == SITE:
                here = self._site(i)
                if last is not None:
                    lines.append((last, here, share))
                last = here
            else:
                known = False
        return LinearLength((), tuple(lines), tendon["rest"], True, known)


def _equation(one: Relation, joints: Sequence[str], first: bool) -> Equation | None:
    """Return a relation as a linear equation between joint values, or None; first: whether the first joint is the follower."""
    x = one.x or LinearLength(())
    constant, ratio, *higher = one.curve
    if one.x is not None and any(higher):
        return None
    if one.y.lines or not one.y.known or (one.x is not None and (x.lines or not x.known)):
        return None
    terms: dict[int, float] = defaultdict(float)
    for name, c in (*one.y.joints, *((name, -ratio * c) for name, c in x.joints)):
        terms[joints.index(name)] += c
    value = constant + one.y.zero - ratio * x.zero
    return Equation(one.name, dict(terms), value, joints.index(one.y.joints[0][0]) if first else -1)


def _with_held(one: Constraint, held: dict[str, float]) -> Constraint:
    """Substitute the values of fixed joints in a constraint, because the URDF does not have them as joints."""
    if isinstance(one, Loop):
        return one

    def without(length: LinearLength) -> LinearLength:
        zero = length.zero - sum(c * held[name] for name, c in length.joints if name in held)
        return length._replace(zero=zero, joints=tuple(part for part in length.joints if part[0] not in held))

    return one._replace(y=without(one.y), x=None if one.x is None else without(one.x))
