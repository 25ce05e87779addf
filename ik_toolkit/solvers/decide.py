"""Decides targets that a short search leaves unsolved: the elimination finds a solution, or certifies that there is none.

A search that fails says nothing about the target. For six revolute joints all solutions can be listed (`closed_form/elimination`).
If a certified list has no member within the limits, that is a numerical proof that there is no solution.
"""

import functools
import math
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from ..compile.jit import cached, inline
from ..kernel.checks import CODE
from ..kernel.elimination.binding import answers
from ..kernel.elimination.terms import VERDICT
from ..kernel.records import AT, SIZE, copy
from ..kernel.vectors import largest
from .closed_form.elimination import STEPS, N, forms_of, solutions_of
from .closed_form.geometry import into_limits
from .closed_form.nearest import choose
from .options import Options
from .plan import Plan
from .protocol import Asked, misfit, refusal
from .registry import GENERAL, find_row
from .status import DECIDED, NEAREST
from .task import POSES

# statuses of the iterative search that leave open whether the target has a solution
OPEN = (CODE.stalled, CODE.iteration_limit, CODE.limit_blocked, CODE.singular)
# Only with these options can the elimination (a closed form for six revolute joints) decide whether a target has a solution. If any
# other option is set, the iterative search runs alone.
HONOURED = {
    "position_tolerance", "orientation_tolerance", "limits", "q0_outside", "check", "seed", "length_scale", "closest", "objective",
}  # fmt: skip


class DecisionMargins(NamedTuple):
    """Safety margins for concluding that no joint values bring the tip within the tolerances of a target.

    The elimination lists the exact solutions of a target. The list says nothing about poses that miss the target by less than the
    tolerances, so a solution just out of reach or just beyond a limit decides nothing. In the comments on the fields, e is the
    larger tolerance [rad, or length over the arm's size].
    """

    # number of attempts of the iterative search, which runs before the elimination: it solves most targets, ten times as fast
    attempts: int = 3
    near: float = 0.1  # [rad] a solution that breaks a limit by less is moved onto it and corrected by Newton steps
    # Two complex solutions that are at most gap * sqrt(e) from being real may mean that a pose within e of the target has a real
    # solution.
    gap: float = 30.0
    # [rad] an answer at most `same` farther from q0 than the nearest listed solution counts as the nearest solution
    same: float = 1e-6
    # Where a solution breaks a limit by d, configurations inside that limit miss the target by at least about d times a measured
    # factor (`closure.least_gain`). Only if that product exceeds e by the factor `gain` does the solution count as beyond its
    # limits.
    gain: float = 10.0
    # If a configuration has both errors below `beside` times their tolerances, nothing is decided: a configuration nearby may trade
    # one error for the other and meet both tolerances. This happened at one of 72,000 targets.
    beside: float = 3.0
    # With a tolerance above `loosest` the elimination is not asked: from 5 mm on, poses within the tolerances were found although
    # the exact pose had no solution.
    loosest: float = 5e-4  # [rad, or lengths / reach]


MARGINS = DecisionMargins()


class Blocked(NamedTuple):
    """The solution that breaks the joint limits least, for a target whose solutions all break some limit."""

    q: np.ndarray  # joint values (n,) [rad]
    joint: str  # name of the joint that breaks its limit most
    excess: float  # by how much that joint breaks its limit [rad]
    solutions: int  # number of solutions if limits are ignored


def elimination_plan(plan: Plan) -> Plan | None:
    """Return a Plan like `plan` that solves by elimination, or None if the robot or an option does not allow this solver."""
    robot = plan.robot
    if robot.n != 6 or robot.pose_shape != (4, 4):
        return None
    if "elimination" not in plan.memo:
        o = replace(plan.options, closest=False)
        row = find_row("elimination")
        form = row.load()()
        fits = not misfit(row, form, robot) and not refusal(row, form, Asked(robot, POSES, options=o))
        plan.memo["elimination"] = Plan(robot, row, form, o) if fits else None
    return plan.memo["elimination"]


def deciding(plan: Plan) -> "Deciding | None":
    """Return a plan for poses that searches briefly and, if that fails, decides by elimination whether a solution exists.

    Returns None if an option of `plan` or the robot does not allow the elimination.
    """
    o = plan.options
    asked = {f.name for f in fields(Options) if getattr(o, f.name) != f.default}
    usual = plan.row.name == GENERAL and all(map(np.array_equal, plan.rule, plan.row.load()()))
    plain = usual and not plan.robot.constraints
    loose = max(o.position_tolerance / plan.robot.reach, o.orientation_tolerance) > MARGINS.loosest
    if not plain or loose or not asked <= HONOURED or elimination_plan(plan) is None:
        return None
    return Deciding(plan.robot, plan.row, plan.rule, o)


@inline
def _apart(a, b):
    """Return the Euclidean distance [rad] of two configurations."""
    total = 0.0
    for i in range(N):
        total += (a[i] - b[i]) ** 2
    return math.sqrt(total)


@inline
def _beside(made, terms):
    """Return whether a result row's errors are so near the tolerances that it decides nothing, see `DecisionMargins.beside`."""
    return made[AT.position] < terms[4] and made[AT.rotation] < terms[5]


@inline
def _take(made, row):
    """Copy q, errors and status of the result row `made` to `row`, and mark it as decided by the elimination."""
    row[AT.status], row[AT.excess] = made[AT.status], DECIDED
    row[AT.position], row[AT.rotation] = made[AT.position], made[AT.rotation]
    for i in range(N):
        row[SIZE.answer + i] = made[SIZE.answer + i]


@inline
def _sort_out(Q, excess, gain, start, terms, legal):
    """Copy the solutions Q (K, n) that keep the limits, or nearly do, to `legal`, and say what the others prove.

    excess (K, n): by how much each solution breaks the limits; gain (K,): see `DecisionMargins`; start (n,); terms: as for
    `decide_rows`. Returns the number copied, whether all solutions break the limits for certain, whether each of them keeps or
    breaks them for certain, and the distance from the start to the nearest that keeps them.
    """
    kept, far, told, least = 0, True, True, np.inf
    for k in range(Q.shape[0]):
        worst = largest(excess[k])
        broken = worst * gain[k] >= terms[1]
        far, told = far and broken, told and (broken or worst == 0.0)
        if worst == 0.0:
            least = min(least, _apart(Q[k], start))
        if worst < terms[0]:
            copy(Q[k], legal[kept])
            kept += 1
    return kept, far, told, least


@cached
def decide_rows(rows, ends, T, found, box, Q0, orders, terms, out):
    """Decide by elimination which of M targets have a solution, and write what is decided to their result rows `out` (M, width).

    A target is solved if a listed solution is inside the limits, or so near them that Newton steps can move it onto them. A
    target has no solution if its list is certified, none of the listed solutions is near a limit or nearly real, and no pose
    beyond the limits is within the tolerances. Decided rows get AT.excess = DECIDED or NEAREST; the rows of other targets stay
    unchanged. Returns the indices of the targets for which the whole search is to continue.

    Args:
        rows: (L, 10) geometry of the chain.
        ends: (2, .) `records.Ends` of the chain, with its limits and without.
        T: (M, 4, 4) targets [m].
        found: (M, SIZES.rows, SIZES.columns) answers of `kernel.elimination.answer.solve_loops`.
        box: (2, n) lower and upper limits [rad].
        Q0: (M, n) starts [rad].
        orders: (2, .) option arrays (`records.Orders`) of the elimination, with limits and without.
        terms: (6,) numbers of `DecisionMargins` with the tolerances put in: `near` [rad]; the least (limit excess times gain) that
            counts as certain; the length [m] that counts as one radian where failures are compared; `same` [rad] if the solution
            nearest the start is asked for, or 0; the position error [m] and rotation error [rad] below which a pose decides
            nothing.
        out: (M, width) results of the short search.
    """
    length, same = terms[2], terms[3]
    silent, bounds = np.empty((0, 0)), np.empty((3, N))
    bounds[:2] = box
    for t in range(T.shape[0]):
        row, start = out[t], Q0[t]
        copy(start, bounds[2])
        count, near = int(found[t, 0, 0]), int(found[t, 0, 7])
        certain = found[t, 0, 1] == VERDICT.certain and near >= 0
        Q = found[t, 1 : 1 + count + max(near, 0), :N].copy()
        excess, legal = np.empty_like(Q), np.empty((Q.shape[0] + 1, N))
        into_limits(Q.copy(), bounds, Q, excess)
        kept, far, told, least = _sort_out(Q[:count], excess, found[t, 1:, N], start, terms, legal)
        for k in range(count, Q.shape[0]):
            copy(Q[k], legal[kept])
            kept += 1
        if row[AT.status] == CODE.converged:
            copy(row[SIZE.answer : SIZE.answer + N], legal[kept])
            kept += 1
        made = row.copy()
        if kept:
            choose(rows, ends[0], T[t], legal[:kept], STEPS, -1, start, orders[0], silent, made)
            row[AT.evaluations] += made[AT.evaluations]
            if made[0] == CODE.converged:
                _take(made, row)
                if same > 0.0 and certain and told and _apart(row[SIZE.answer :], start) <= least + same:
                    row[AT.excess] = NEAREST
                continue
            certain = certain and not _beside(made, terms)
        if row[AT.status] == CODE.converged or not certain or not far:
            continue
        if count == 0 and near > 0:
            choose(rows, ends[1], T[t], Q, STEPS, -1, start, orders[1], silent, made)
            row[AT.evaluations] += made[AT.evaluations]
            if _beside(made, terms):
                continue  # With joint values outside the limits the tip comes so near the target that nothing is decided.
        # Q has the listed solutions, clamped to the limits that they break. The best of them may be nearer to the target than the
        # configuration at which the search ended.
        if count > 0:
            choose(rows, ends[0], T[t], Q[:count], 0, -1, start, orders[0], silent, made)
            row[AT.evaluations] += made[AT.evaluations]
            now = (row[AT.position] / length) ** 2 + row[AT.rotation] ** 2
            if (made[AT.position] / length) ** 2 + made[AT.rotation] ** 2 < now:
                _take(made, row)
        row[0], row[AT.excess] = CODE.limit_blocked if count > 0 else CODE.unreachable, DECIDED
    state, enough = out[:, AT.excess], NEAREST if same > 0.0 else DECIDED
    return np.flatnonzero((state != enough) & ((state != DECIDED) | (out[:, AT.status] == CODE.converged)))


def arm_of(exact: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Return the arm for `binding.answers`: the orderings of its closed loop of joints (`forms_of`), and its geometry (52,)."""
    p = exact.orders(POSES, True)[SIZE.weights + N :].copy()
    return forms_of(p.tobytes()), p


class Deciding(Plan):
    """A plan that solves in three stages: a short search, the elimination where that fails, the whole search if still undecided."""

    @functools.cached_property
    def first(self) -> Plan:
        """The plan of the short iterative search that runs before the elimination."""
        return self.varied(restarts=MARGINS.attempts - 1, closest=False)

    @functools.cached_property
    def open(self) -> tuple[int, ...]:
        """The statuses of the short search after which the elimination tries to decide the target."""
        return (*OPEN, CODE.converged) if self.options.closest else OPEN

    @functools.cached_property
    def exact(self) -> Plan:
        """The plan that solves by elimination, with the same options."""
        return elimination_plan(self)  # pyright: ignore[reportReturnType]

    @functools.cached_property
    def error(self) -> float:
        """The larger of both tolerances [rad, or length over the arm's size]."""
        size = self.exact.orders(POSES, True)[-1]
        return max(self.options.position_tolerance / size, self.options.orientation_tolerance)

    def solve(self, T: np.ndarray, kinds: tuple, start: np.ndarray, given: bool) -> np.ndarray:
        """Solve one target T (1, 4, 4) from start (1, n); return its result row (width,).

        kinds: the kind of target; given: whether the caller gave the start.
        """
        row = self.first.solve(T, kinds, start, given)
        if row[AT.status] in self.open:
            self._decide(T, kinds, start, given, row[None])
        return row

    def decide(self, T: np.ndarray, kinds: tuple, start: np.ndarray, given: bool, out: np.ndarray) -> None:
        """Decide by elimination which of the targets left open by the short search can be solved; update their rows in `out`.

        out (N, width): result rows; T (N, 4, 4): the targets; kinds, start, given: as for `Plan.run`.
        """
        (left,) = np.nonzero((out[:, AT.status, None] == self.open).any(axis=1))
        if len(left):
            made, starts = out[left], np.repeat(start, len(out) // len(start), axis=0)[left]
            self._decide(T[left], kinds, starts, given, made)
            out[left] = made

    def _decide(self, T: np.ndarray, kinds: tuple, starts: np.ndarray, given: bool, made: np.ndarray) -> None:
        """Let the elimination decide on result rows `made` (N, width); where it decides nothing, the whole search continues."""
        rows, ends, box, orders, terms, (forms, arm) = self._fixed(given)
        found = answers(forms, arm, np.ascontiguousarray(T), self.within)
        still = decide_rows(rows, ends, T, found, box, starts, orders, terms, made)
        if not len(still):
            return
        rest, starts = np.zeros((len(still), made.shape[1])), starts[still]
        self.run(T[still], kinds, starts, given, rest)
        far = [np.linalg.norm(rows[:, self.q_columns] - starts, axis=1) for rows in (rest, made[still])]
        taken = (made[still, AT.status] != CODE.converged) | (rest[:, AT.status] == CODE.converged) & (far[0] < far[1])
        made[still[taken]] = rest[taken]

    def _fixed(self, given: bool) -> tuple[Any, ...]:
        """Return what does not depend on targets: rows, ends, box, orders, terms of `decide_rows`, arguments of `answers`."""
        if ("fixed", given) not in self.memo:
            exact, free, o = self.exact, self.exact.varied(limits=False), self.options
            terms = (
                MARGINS.near,
                MARGINS.gain * self.error,
                o.length_scale or self.robot.reach,
                MARGINS.same * o.closest,
                MARGINS.beside * o.position_tolerance,
                MARGINS.beside * o.orientation_tolerance,
            )
            ends, orders = (exact.chain[1], free.chain[1]), (exact.orders(POSES, given), free.orders(POSES, given))
            fixed = map(np.array, (ends, self.box, orders, terms))
            self.memo["fixed", given] = (exact.chain[0], *fixed, arm_of(exact))
        return self.memo["fixed", given]

    @functools.cached_property
    def within(self) -> float:
        """Distance from the unit circle up to which a complex root may mean that a pose within the tolerances is reachable."""
        return min(1.0, MARGINS.gap * math.sqrt(self.error))


def blocked(result: Any) -> Blocked | None:
    """Return the solution that breaks the limits least if all solutions are certified to break some limit, else None."""
    of = result._of
    if of.row[AT.excess] != DECIDED or of.row[AT.status] != CODE.limit_blocked:
        return None
    Q = solutions_of(arm_of(of.plan.exact)[1], of.T[0]).q
    q, excess = np.empty_like(Q), np.empty_like(Q)
    into_limits(Q, np.vstack([of.plan.box, of.start]), q, excess)
    worst = excess.max(axis=1)
    best = int(np.argmin(worst))
    joint = int(np.argmax(excess[best]))
    return Blocked(q[best], of.plan.robot.joint_names[joint], float(worst[best]), len(worst))
