"""A plan: a solver bound to a robot and options, as arrays of the compiled search that are made once and used by every call.

Joints that are held keep one value in all starts of a search: the one that they have in the first start.
"""

import copy
import functools
from dataclasses import replace
from typing import Any

import numpy as np

from ..copying import importable
from ..errors import InvalidConfiguration, InvalidOption, UnknownSolver
from ..kernel.chain import split_rows, table, without_limits, without_wrap
from ..kernel.counted_error import KIND
from ..kernel.limits import LARGEST
from ..kernel.packed_model import join
from ..kernel.records import AT, POINTS, SIZE, Orders
from ..kernel.starts import BEST
from .closed_form_then_search import with_search
from .options import PLAIN, Options
from .postprocess import FEW, finishing
from .protocol import Asked, misfit, parameters, require
from .registry import GENERAL, find_row, search_for
from .rows import Row
from .task import group_levels, kernel_tasks, relatives, what_counts

# The compiled search multiplies each tolerance by MARGIN, so that rounding never makes Pinocchio reject an answer at the very
# tolerance.
MARGIN = 1.0 - 1e-9
# A plan caches option arrays for KINDS_KEPT kinds of target (pose, position, ...). Each tip axis about which a target may turn is a
# kind of its own, so there may be many.
KINDS_KEPT = 64
CLOSEST = 16  # With the option closest=True, the nearest to q0 of this many solutions found is taken.
# The single attempt of `follow` gets at least 100 iterations, because no other attempt comes after it.
FOLLOW_ITERATIONS = 100
NEVER = (np.inf, 1.0, np.inf, 1.0)


class Plan:
    """A solver made ready for one robot and its options: the compiled function, the arrays that it takes, and what runs after it.

    `kernel` is the compiled loop (see `kernel.search.entry`), `home` (1, n) the start if none is given, `held` the indices in q of
    the joints with weight 0; a result row has `width` numbers, q in its `q_columns`; `steps` are the functions that check and
    improve an answer, `improving` those that improve it (see `postprocess.finishing`).
    """

    # whether a failed target of a batch keeps the q at which its search ended, instead of the closest one; see `stripped`
    bare = False

    def __init__(self, robot: Any, row: Row, rule: Any, options: Options) -> None:
        """Validate what does not depend on the target. Raises UnknownSolver (for example a method for one tip), InvalidOption."""
        if reason := misfit(row, rule, robot):
            raise UnknownSolver(reason)
        if options.joint_weights is not None and len(options.joint_weights) != robot.n:
            raise InvalidOption(
                f"joint_weights must have {robot.n} values, one per joint ({', '.join(robot.joint_names)})"
            )
        what_counts(robot, options)
        group_levels(robot, options)
        relatives(robot, options)
        self.robot, self.row, self.rule, self.options = robot, row, rule, options
        self.held = held_joints(options)
        loop = rule.loop(robot)
        self.kernel = with_search(self, loop) if row.closed else loop
        chain = robot.chain
        self.chain = (chain.rows, self._ends(), chain.seeds, chain.features)
        self.width = SIZE.answer + robot.n + SIZE.miss * (len(robot.tips) if len(robot.tips) > 1 else 0)
        self.q_columns = slice(SIZE.answer, SIZE.answer + robot.n)
        self.home = robot.home.reshape(1, -1).copy()
        self._plain = not len(self.held)
        self.memo: dict[Any, Any] = {}  # cache for callers that store derived data with the plan
        self._ready: dict[tuple, tuple] = {}
        self._packed: dict[tuple, np.ndarray] = {}
        self._tables: dict[bool, tuple] = {}
        self._pinned: tuple[Any, tuple] = (None, ())
        self._joined: tuple[Any, np.ndarray] = (None, np.empty(0))
        self.steps, self.improving = finishing(self)

    @functools.cached_property
    def descends(self) -> bool:
        """Whether, after a failure, q is moved to a local minimum of the error, so that the tip is as near the target as possible.

        True for the general search, also after a closed form, unless `follow` is given. The published methods keep the
        configuration at which they ended.
        """
        return self.row.name == GENERAL and not self.options.follow

    def varied(self, **options: Any) -> "Plan":
        """Return the same plan with some options changed."""
        return Plan(self.robot, self.row, self.rule, replace(self.options, **options))

    def stripped(self) -> "Plan":
        """Return a copy of this plan, for callers that count successes: a failed target keeps the q at which its search ended."""
        made = copy.copy(self)
        made.bare = True
        return made

    @functools.cached_property
    def unlimited(self) -> "Plan":
        """A copy of the plan without joint limits, with a few attempts, to test whether limits are what blocks a target."""
        return self.varied(**{**PLAIN, "limits": False, "follow": 0.0, **self._few})

    @functools.cached_property
    def retried(self) -> "Plan":
        """A copy of the plan with limits and as many attempts as `unlimited`, to test whether limits really block a target."""
        return self.varied(**{**PLAIN, "follow": 0.0, **self._few})

    @property
    def box(self) -> np.ndarray:
        """Lower and upper limits (2, n) [rad or m] of the joints, infinite if the options leave limits out."""
        free = np.full(self.robot.n, np.inf)
        return np.array([self.robot.lower, self.robot.upper] if self.options.limits else [-free, free])

    @property
    def _few(self) -> dict[str, int]:
        return {} if self.row.closed else {"restarts": FEW - 1}

    def search(self, **options: Any) -> "Plan":
        """Return a plan of the general search for the same robot and options, some of them changed."""
        asked = replace(self.options, **options)
        row = find_row(search_for(asked.priority))
        return Plan(self.robot, row, row.load()(), asked)

    def __reduce__(self) -> tuple[Any, ...]:
        """Make the plan picklable: the compiled loop is bound again. Raises InvalidOption if the solver cannot be imported."""
        importable(self.rule, f"the rule of '{self.row.name}'")
        return type(self), (self.robot, self.row, self.rule, self.options), {"bare": True} if self.bare else None

    def __deepcopy__(self, memo: dict[int, Any]) -> "Plan":
        """Return the same plan for a copied robot."""
        return type(self)(*copy.deepcopy((self.robot, self.row, self.rule, self.options), memo))

    # ---------------------------------------------------------------------------------------------------------- running
    @property
    def first(self) -> "Plan":
        """The plan that solves first; targets that it leaves unsolved are passed to the method `decide`."""
        return self

    def decide(self, T: np.ndarray, kinds: tuple, start: np.ndarray, given: bool, out: np.ndarray) -> None:
        """Solve the targets that the plan `first` left unsolved, and change their result rows in `out` (N, width); here: nothing.

        Arguments as for `run`. A subclass with a second way to solve overrides this method.
        """

    def run(self, T: np.ndarray, kinds: tuple, start: np.ndarray, given: bool, out: np.ndarray) -> None:
        """Solve N targets T (N, 4, 4), for several tips (N, F, 4, 4), and write their result rows to `out` (N, width).

        kinds: the kind of target of each tip, the same for all N; start (1 or N, n): configurations to begin at; given: whether
        they come from the caller.
        """
        chain, orders = self.ready(kinds, start, given)
        self.kernel(chain, T, start, out.reshape(-1), orders)

    def solve(self, T: np.ndarray, kinds: tuple, start: np.ndarray, given: bool) -> np.ndarray:
        """Solve one target and return its result row (width,); arguments as for `run`, with N = 1."""
        chain, orders = self._ready.get((kinds, given)) or self.ready(kinds, start, given)
        row = np.empty(self.width)
        self.kernel(chain, T, start, row, orders)
        return row

    def note(
        self, T: np.ndarray, start: np.ndarray, ready: tuple[np.ndarray, np.ndarray], count: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve one target T (1, ...) from start (1, n), recording each evaluation; return its result row (width,) and history.

        ready: what the method `ready` returns; count: largest number of history rows. A row has SIZE.past + n numbers: errors and
        attempt, then q.
        """
        chain, orders = ready
        out = np.empty(self.width + count * (SIZE.past + self.robot.n))
        self.kernel(chain, T, start, out, orders)
        row, history = out[: self.width], out[self.width :].reshape(count, -1)
        return row, history[: int(row[AT.history])]

    # --------------------------------------------------------------------------------------------------------- preparing
    def ready(self, kinds: tuple, start: np.ndarray, given: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the arguments of the compiled search: the chain's arrays packed in one, and the option array (`records.Orders`).

        kinds, start, given: as for `run`.
        """
        found = self._ready.get((kinds, given))
        if found is None:
            arrays, last = self.arrays(kinds, start), self._joined
            if last[0] is not arrays:
                self._joined = last = arrays, join(*arrays)
            found = last[1], self.orders(kinds, given)
            if self._plain:
                self._ready[kinds, given] = found
        return found

    def _ends(self) -> np.ndarray:
        """Return the `ends` of the chain with the joint limits and the wrapping that the options ask for."""
        chain, n = self.robot.chain, self.robot.n
        ends = chain.ends
        if not self.options.limits:
            flat = ends.reshape(-1, ends.shape[-1])
            parts = zip(split_rows(chain.rows, flat, n) if ends.ndim > 1 else [chain.rows], flat, strict=True)
            ends = np.array([without_limits(rows, end, n) for rows, end in parts]).reshape(ends.shape)
        wrap = self.rule.wrap if self.options.wrap is None or self.row.closed else self.options.wrap
        return ends if wrap else without_wrap(ends, n)

    def arrays(self, kinds: tuple, start: np.ndarray) -> tuple:
        """Return the arrays that describe the robot to the compiled search: rows, ends, table of starts, and their features.

        In every start of the table, joints with weight 0 have their values in the first row of `start` (1 or N, n).
        """
        found = self._table(kinds[0] == KIND.position)
        if self._plain:
            return found
        at = (start[0] / self.robot.chain.unit)[self.held]
        key, last = (id(found), at.tobytes()), self._pinned
        if last[0] != key:
            self._pinned = last = (key, pin(found, self.held, at))
        return last[1]

    def _table(self, position_only: bool) -> tuple:
        """Return the arrays of the chain, with the solver's own table of starts if it has one."""
        found = self._tables.get(position_only)
        if found is None:
            robot, found = self.robot, self.chain
            starts = self.rule.start_table(robot, position_only)
            if starts is not None:
                seeds = np.resize(starts / robot.chain.unit, (-(-len(starts) // BEST) * BEST, robot.n))
                found = with_seeds(*found[:2], seeds)
            self._tables[position_only] = found
        return found

    def orders(self, kinds: tuple, given: bool) -> np.ndarray:
        """Return the option array (`records.Orders`, then what the rule needs) for targets of these kinds. Raises InvalidOption.

        given: whether the start comes from the caller.
        """
        packed = self._packed.get((kinds, given))
        if packed is None:
            if len(self._packed) >= KINDS_KEPT:
                self._packed.clear()
                self._ready.clear()
            packed = self._packed[kinds, given] = self._pack(kinds, given)
        return packed

    def _pack(self, kinds: tuple, given: bool) -> np.ndarray:
        o, row = self.options, self.row
        asked = Asked(self.robot, kinds, given, o)
        require(row, self.rule, asked)
        tasks = kernel_tasks(self.robot, kinds, o)
        if o.follow and not given:
            raise InvalidOption("follow bounds the move of each joint from q0, so q0 has to be given")
        length = row.length(len(self.robot.tips))
        attempts = 1 if o.follow else length.attempts if o.restarts is None else o.restarts + 1
        iterations = max(length.iterations, FOLLOW_ITERATIONS) if o.follow else length.iterations
        give_up = length.give_up if attempts > 1 and o.max_iterations is None else None
        c, rho, c_free, rho_free = give_up or NEVER
        own_starts = self._table(kinds[0] == KIND.position) is not self.chain
        numbers = parameters(row, self.rule, asked)
        orders = Orders(
            tol_p=o.position_tolerance * MARGIN,
            tol_r=o.orientation_tolerance * MARGIN,
            # Without restarts the one attempt starts at q0 or home, as callers expect, never from the table.
            # An option that compares answers by their distance from q0 or home makes the search start there first.
            given=bool(given or o.closest or (attempts == 1 and not own_starts)),
            iterations=iterations if o.max_iterations is None else o.max_iterations,
            attempts=attempts,
            c=c,
            rho=rho,
            c_free=c_free,
            rho_free=rho_free,
            patience=length.patience if give_up else np.inf,
            evaluations=o.budget or np.inf,
            limits=o.limits,
            seed=o.seed,
            closest=CLOSEST if o.closest else 0,
            hold=float(self.rule.hold),
            follow=o.follow or 0.0,
            follow_slide=o.follow * self.robot.reach if o.follow else 0.0,
        )
        weights = np.ones(self.robot.n) if o.joint_weights is None else o.joint_weights
        return np.concatenate([orders, *tasks, weights, numbers])

    def check_start(self, q0: Any, name: str = "q0") -> tuple[np.ndarray, str]:
        """Read q0 (or another configuration of this name) in any form, check it as `check_starts` does; return (1, n), a notice."""
        q, notice = self.robot.read_q(q0, name)
        start, clamped = self.check_starts(q[None], name)
        return start, f"{notice}; {clamped}" if notice and clamped else notice or clamped

    def check_starts(self, Q: np.ndarray, name: str = "q0") -> tuple[np.ndarray, str]:
        """Validate start configurations Q (1 or m, n); return them, clamped to the limits if the options say so, and a notice.

        Of several starts, the one farthest outside the limits is checked for values that look like degrees. Raises
        InvalidConfiguration, which names the target whose start is wrong.
        """
        robot, k = self.robot, 0

        def called(k: int) -> str:
            return f"{name} of target {k}" if len(Q) > 1 else name

        if len(Q) > 1:
            meant = (robot.lower <= Q) & (robot.upper >= Q) & (robot.upper - robot.lower < np.inf)
            # index of the start that is checked in detail: the first with a NaN, else the one with the largest joint value outside
            # limits
            k = int(np.where(meant, 0.0, np.abs(Q)).max(axis=1).argmax())
        robot.check_q(Q[k], called(k))
        inside = np.clip(Q, robot.lower, robot.upper) if self.options.limits else Q
        far = np.abs(inside / robot.chain.unit) >= LARGEST
        if far.any():
            k = int(far.any(axis=1).argmax())
            names = ", ".join(j for j, x in zip(robot.joint_names, far[k], strict=True) if x)
            raise InvalidConfiguration(
                f"{called(k)} is too large a number at joint {names}: it must stay below {LARGEST:g} (rad, or reaches)"
            )
        if (inside == Q).all():
            return Q, ""
        rows = np.flatnonzero((inside != Q).any(axis=1))
        what, names = called(int(rows[0])), ", ".join(robot.outside(Q[rows[0]]))
        if self.options.q0_outside == "refuse":
            raise InvalidConfiguration(f"{what} is outside the limits at joint {names}")
        count = f"; {len(rows)} of {len(Q)} starts were" if len(rows) > 1 else ""
        return inside, f"{what} was outside the limits at joint {names} and was clamped{count}"


def held_joints(options: Options) -> np.ndarray:
    """Return the indices in q of the joints whose weight is 0."""
    return np.flatnonzero(np.array(options.joint_weights or (1.0,)) == 0.0)


def pin(arrays: tuple, held: np.ndarray, at: np.ndarray) -> tuple:
    """Fix the `held` joints of a chain or tree at the values `at` [internal units] in all starts, also random ones.

    Returns the changed arrays.
    """
    rows, ends, seeds, _ = arrays
    ends, seeds, n = ends.copy(), seeds.copy(), seeds.shape[1]
    seeds[:, held] = at
    ends[..., POINTS + 4 * n + held] = at
    ends[..., POINTS + 5 * n + held] = 0.0  # Random starts do not vary in these joints.
    return with_seeds(rows, ends, seeds)


def with_seeds(rows: np.ndarray, ends: np.ndarray, seeds: np.ndarray) -> tuple:
    """Return the arrays of a chain or tree (rows, ends, starts, features of the starts) with another table of starts.

    rows, ends: as the chain has them; seeds (N, n): the new starts [rad, or length / reach].
    """
    if ends.ndim == 1:
        return rows, ends, seeds, table(rows, ends, seeds)
    parts = zip(split_rows(rows, ends, seeds.shape[1]), ends, strict=True)
    return rows, ends, seeds, np.stack([table(part, end, seeds) for part, end in parts])
