"""Decides what a short search leaves open: the elimination finds a solution, or certifies that there is none.

A search that fails says nothing about the target. For six revolute joints all solutions can be listed
(`closed_form/elimination`), and a list that is certified and has no legal member is a proof, as far as a certificate is one.
"""

import copy
import functools
import math
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from ..kernel.checks import CONVERGED, ITERATION_LIMIT, LIMIT_BLOCKED, SINGULAR, STALLED, UNREACHABLE
from ..kernel.records import ANSWER, AT, WEIGHTS
from .closed_form_then_search import error_size
from .options import Options
from .plan import Plan
from .protocol import Asked, misfit, refusal
from .registry import GENERAL, find_row
from .status import DECIDED
from .task import POSES

OPEN = (STALLED, ITERATION_LIMIT, LIMIT_BLOCKED, SINGULAR)  # statuses that prove nothing
# Options that a decision honours; with any other the search goes on alone.
HONOURED = {
    "position_tolerance", "orientation_tolerance", "limits", "q0_outside", "check", "seed", "length_scale",
}  # fmt: skip


class DecisionMargins(NamedTuple):
    """How clear a certificate must be, as a search may stop anywhere within its tolerances e (lengths over the arm's size)."""

    attempts: int = 3  # attempts of the search that come first; they solve most targets, in a tenth of the time
    near: float = 0.1  # solutions that break a limit by less [rad] are moved onto it and polished
    # Two complex solutions that are at most this many sqrt(e) from real ones may have a real pose within e between them.
    gap: float = 30.0
    gain: float = 10.0  # a solution that breaks a limit by d has errors of gain * d at it, which must be this many e


MARGINS = DecisionMargins()


class Blocked(NamedTuple):
    """The solution that breaks its limits least, where every solution breaks one."""

    q: np.ndarray  # joint values (n,) [rad]
    joint: str  # joint that breaks its limit most
    excess: float  # by how much [rad]
    solutions: int  # number of solutions without limits


class Listed(NamedTuple):
    """All solutions that the elimination lists of a target."""

    q: np.ndarray  # (K, n) [rad], on the full turns inside the limits that are nearest the start
    excess: np.ndarray  # (K, n) by how much each joint breaks its limits [rad]
    gain: np.ndarray  # (K,) see `elimination.Said`
    certificate: Any
    near: np.ndarray | None  # (M, n) where else a pose may be within the tolerances [rad]; None if that is not known


def elimination_plan(plan: Plan) -> Plan | None:
    """Return the plan of the elimination with the options of a search's plan, or None if it cannot do what is asked."""
    robot, o = plan.robot, plan.options
    if robot.n != 6 or robot.pose_shape != (4, 4):  # Nothing is imported for other robots.
        return None
    if "elimination" not in plan.memo:
        row = find_row("elimination")
        form = row.load()()
        fits = not misfit(row, form, robot) and not refusal(row, form, Asked(robot, POSES, options=o))
        plan.memo["elimination"] = Plan(robot, row, form, o) if fits else None
    return plan.memo["elimination"]


def deciding(plan: Plan) -> "Deciding | None":
    """Return the plan that decides what a search's plan leaves open for poses, or None where its options or robot forbid it."""
    o = plan.options
    asked = {f.name for f in fields(Options) if getattr(o, f.name) != f.default}
    plain = plan.row.name == GENERAL and plan.rule == plan.row.load()() and not plan.robot.constraints
    if not plain or not asked <= HONOURED or elimination_plan(plan) is None:
        return None
    return Deciding(plan.robot, plan.row, plan.rule, o)


class Deciding(Plan):
    """The general search with a few attempts, then the elimination, then, where that is not certain, the whole search."""

    @functools.cached_property
    def first(self) -> Plan:
        """The short search."""
        return self.varied(restarts=MARGINS.attempts - 1)

    @functools.cached_property
    def exact(self) -> Plan:
        """The elimination."""
        return elimination_plan(self)  # pyright: ignore[reportReturnType]

    @functools.cached_property
    def exact_free(self) -> Plan:
        """The elimination without limits."""
        return self.exact.varied(limits=False)

    @functools.cached_property
    def error(self) -> float:
        """The larger of both tolerances [rad, or sizes of the arm]."""
        size = self.exact.orders(POSES, True)[-1]
        return max(self.options.position_tolerance / size, self.options.orientation_tolerance)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the request."""
        return Deciding, super().__reduce__()[1]

    def __deepcopy__(self, memo: dict[int, Any]) -> "Deciding":
        """Return the same plan for a copy of the robot."""
        return Deciding(*copy.deepcopy((self.robot, self.row, self.rule, self.options), memo))

    def solve(self, T: np.ndarray, kinds: tuple, start: np.ndarray, given: bool) -> np.ndarray:
        """Return the result row (width,) of one target T (1, 4, 4)."""
        row = self.first.solve(T, kinds, start, given)
        status = row[AT.status]
        if status == CONVERGED or status not in OPEN or self.decide(T[0], start, given, row):
            return row
        return super().solve(T, kinds, start, given)

    def listed(self, T: np.ndarray, near: np.ndarray) -> Listed:
        """List the solutions of T (4, 4), on the full turns nearest to `near` (n,)."""
        from .closed_form.elimination import into_limits, solutions_of

        robot = self.robot
        within = min(1.0, MARGINS.gap * math.sqrt(self.error))
        said = solutions_of(self.exact.orders(POSES, True)[WEIGHTS + robot.n :], T, within)
        free = np.full(robot.n, np.inf)
        box = np.array([robot.lower, robot.upper, near] if self.options.limits else [-free, free, near])
        Q = said.q if said.near is None else np.vstack([said.q, said.near])
        q, excess = np.empty_like(Q), np.empty_like(Q)
        into_limits(Q, box, q, excess)
        count = len(said.q)
        return Listed(q[:count], excess[:count], said.gain, said.certificate, None if said.near is None else q[count:])

    def decide(self, T: np.ndarray, start: np.ndarray, given: bool, row: np.ndarray) -> bool:
        """Write the decision on the target T (4, 4) to the short search's result row (width,); return False if there is none."""
        from .closed_form.elimination import STEPS

        found = self.listed(T, start[0])
        near = np.empty((0, self.robot.n)) if found.near is None else found.near
        legal = np.vstack([found.q[found.excess.max(axis=1, initial=0.0) < MARGINS.near], near])
        made = self._chosen(self.exact, T, legal, STEPS, start, given, row)
        if made[AT.status] == CONVERGED:
            self._take(made, row)
            return True
        if found.certificate.status != "CERTAIN" or found.near is None:
            return False
        if (found.excess.max(axis=1, initial=0.0) * found.gain < MARGINS.gain * self.error).any():
            return False
        free = self._chosen(self.exact_free, T, near if not len(found.q) else near[:0], STEPS, start, given, row)
        if free[AT.status] == CONVERGED:
            return False  # A pose beyond the limits is within the tolerances, though none is exact.
        made = self._chosen(self.exact, T, found.q, 0, start, given, row)  # solutions moved onto their limits
        nearer, now = error_size(np.array([made, row]), self.options.length_scale or self.robot.reach)
        if nearer < now:
            self._take(made, row)
        row[AT.status], row[AT.excess] = (LIMIT_BLOCKED if len(found.q) else UNREACHABLE), DECIDED
        return True

    def _chosen(
        self, exact: Plan, T: np.ndarray, Q: np.ndarray, steps: int, start: np.ndarray, given: bool, row: np.ndarray
    ) -> np.ndarray:
        """Return a result row for the best of Q (K, n) after some Newton steps, and count the evaluations in `row`."""
        from .closed_form.nearest import choose

        made = row.copy()
        if not len(Q):
            made[[AT.status, AT.position, AT.rotation]] = STALLED, math.inf, math.inf
            return made
        orders, silent = exact.orders(POSES, given), np.empty((0, 0))
        choose(*exact.chain[:2], T, np.ascontiguousarray(Q), steps, -1, start[0], orders, silent, made)
        row[AT.evaluations] += made[AT.evaluations]
        return made

    def _take(self, made: np.ndarray, row: np.ndarray) -> None:
        """Write q, errors and status of the row `made` to `row`."""
        for place in (AT.status, AT.position, AT.rotation):
            row[place] = made[place]
        row[ANSWER:] = made[ANSWER:]
        row[AT.excess] = DECIDED


def blocked(result: Any) -> Blocked | None:
    """Return the solution that breaks its limits least, if a result is certified to have none that keeps them."""
    of = result._of
    if of.row[AT.excess] != DECIDED or of.row[AT.status] != LIMIT_BLOCKED:
        return None
    found = of.plan.listed(of.T[0], of.start[0])
    worst = found.excess.max(axis=1)
    best = int(np.argmin(worst))
    joint = int(np.argmax(found.excess[best]))
    return Blocked(found.q[best], of.plan.robot.joint_names[joint], float(worst[best]), len(worst))
