"""The public calls: `solve` for one target, `Solver` bound once for hot loops.

One hop from here to the loop: a bound solver holds the kernel's arrays and calls the compiled loop with them.
"""

import threading
from time import perf_counter
from typing import Any

import numpy as np

from ..errors import InvalidConfiguration, InvalidOption
from ..kernel.chain import table, without_limits, without_wrap
from ..kernel.checks import BAD_TARGET
from ..kernel.limits import LARGEST
from ..kernel.records import ANSWER, AT, Orders, Task
from ..kernel.search import entry
from ..kernel.seeds import BEST
from ..kernel.task import POSE, POSITION
from ..robot.pose import check_target
from ..robot.robot import Robot
from ..robot.tree import Tree
from .closed_form import fits
from .fallback import with_search
from .options import NAMES, OBJECTIVES, Options, make_options
from .protocol import Asked, parameters
from .registry import GENERAL, find_row, make_rule
from .result import Result, Status
from .starts import held_joints, pin
from .task import counted_errors, counts_in_part, kernel_tasks, read_one

FLOAT = np.dtype(np.float64)  # one object in a process, so `is` tells; other kinds of float take the long way
MARGIN = 1.0 - 1e-9  # the kernel tests a little inside the tolerance, so that Pinocchio's rounding cannot disagree
KINDS_KEPT = 64  # kinds of target a solver stays ready for: every axis is a kind of its own, and axes have no end
CLOSEST = 16  # solutions to compare when the one nearest q0 is asked for
REFINE_STEPS = 60
FOLLOW_ITERATIONS = 100  # the one attempt of `follow` has no other to hand over to where it converges slowly
NEVER = (np.inf, 1.0, np.inf, 1.0)
EXACT = {  # options that a closed form honours or has no use for; 'auto' takes 'lm' when any other is given
    "tolerance", "position_tolerance", "orientation_tolerance", "max_iterations", "max_evaluations", "restarts", "seed",
    "limits", "q0_outside", "history", "check",
}  # fmt: skip


class Solver:
    """A solver bound to a robot, for hot loops: `solver(target, q0=None) -> Result`, a few microseconds.

    solver: name, rule class or instance; parameters of the rule and options (see Options) as keywords. 'auto' (the default, as
    in `solve`) takes a closed form for the kinds of target it solves exactly, otherwise 'lm'; `result.solver` names the one
    used. The result is the kernel's own evaluation unless check=True. Safe to call from several threads. Raises
    UnknownSolver, InvalidOption.
    """

    def __new__(cls, robot: Any = None, *_: Any, **__: Any) -> "Solver":
        """Make a solver for several tips when the robot is a Tree."""
        if isinstance(robot, Tree):
            from .tree import TreeSolver

            return object.__new__(TreeSolver)
        return super().__new__(cls)

    def __init__(self, robot: Robot, solver: Any = "auto", **options: Any) -> None:
        """Validate everything once; the loop is compiled at the first call."""
        require_robot(robot)
        auto = is_auto(solver)
        self._closed: dict[int, Solver] = {}  # by kind of target, where 'auto' takes a closed form
        if auto:
            chosen = {kind: automatic(robot, kind, options) for kind in (POSE, POSITION)}
            self._closed = {kind: Solver(robot, name, **options) for kind, name in chosen.items() if name != GENERAL}
            solver = GENERAL
        row = find_row(solver)
        preset = {}
        if not isinstance(solver, str | type):
            rule = solver
            preset = getattr(solver, "options", dict)() if hasattr(solver, "options") else {}
        else:
            fields = row.load()._fields
            parameters = {key: options.pop(key) for key in list(options) if key in fields}
            rule = make_rule(row, parameters)
        self.robot = robot
        self.row = row
        self.name = "auto" if auto else row.name
        self.rule = rule
        options.setdefault("check", False)
        self.options: Options = make_options({**preset, **options})
        if self.options.joint_weights is not None and len(self.options.joint_weights) != robot.n:
            raise InvalidOption(
                f"joint_weights must have {robot.n} values, one per joint ({', '.join(robot.joint_names)})"
            )
        if self.options.follow and row.closed:
            raise InvalidOption(f"solver '{row.name}' is a closed form and does not follow; use 'lm'")
        self._bind()

    def _bind(self) -> None:
        chain = self.robot.chain
        loop = entry(type(self.rule))
        self._kernel = with_search(self, loop) if self.row.closed else loop
        o = self.options
        ends = chain.ends if o.limits else without_limits(chain.rows, chain.ends, chain.n)
        if not (self.row.closed or self._wraps):
            ends = without_wrap(ends, chain.n)
        self._chain = (chain.rows, ends, chain.seeds, chain.features)
        self._width = ANSWER + chain.n
        self._shape = (chain.n,)
        self._home = self.robot.home.reshape(1, -1).copy()
        self._silent = np.empty((0, 2 + chain.n))
        self._lower, self._upper = self.robot.lower, self.robot.upper
        self._packed: dict[tuple[Any, bool], np.ndarray] = {}
        self._ready: dict[tuple[Any, bool], tuple] = {}
        self._tables: dict[bool, tuple] = {}  # a rule may bring a table of starts, one for positions and one for poses
        self._own_starts = hasattr(self.rule, "start_table")
        self.held = held_joints(o)
        self._pinned: tuple[Any, tuple] = (None, ())
        self.collision = self.single = None
        if o.avoid_collisions:
            from .avoid import collision_model

            self.collision = collision_model(self.robot, o.avoid_collisions)
            once = {"closest": False, "objective": None, "history": False, "avoid_collisions": False}
            once |= {} if o.follow else {"restarts": 0}
            self.single = Solver(self.robot, self.rule, **{**o.__dict__, **once})
        self._extras = o.objective is not None or self.collision is not None
        self._more = self._extras or o.history or o.check

    # ------------------------------------------------------------------------------------------------ preparation
    @property
    def _wraps(self) -> bool:
        wrap = self.options.wrap
        return getattr(self.rule, "wrap", False) if wrap is None else wrap

    def pack(self, kind: Any, given: bool) -> np.ndarray:
        """Option array of the kernel for a kind of target, with or without a start given."""
        key = (kind, given)
        packed = self._packed.get(key)
        if packed is None:
            if len(self._packed) >= KINDS_KEPT:
                self._packed.clear()
            packed = self._packed[key] = self._pack(kind, given)
        return packed

    def _pack(self, kind: Any, given: bool) -> np.ndarray:
        o = self.options
        tasks = self._tasks(kind)
        if o.follow and not given:
            raise InvalidOption("follow bounds the move of each joint from q0, so q0 has to be given")
        length = self._length()
        attempts = 1 if o.follow else length.attempts if o.restarts is None else o.restarts + 1
        iterations = max(length.iterations, FOLLOW_ITERATIONS) if o.follow else length.iterations
        give_up = length.give_up if attempts > 1 and o.max_iterations is None else None
        c, rho, c_free, rho_free = give_up or NEVER
        orders = Orders(
            tol_p=o.position_tolerance * MARGIN,
            tol_r=o.orientation_tolerance * MARGIN,
            # Without restarts the one attempt starts where the caller expects, at q0 or home, never from the seed table; and
            # what is compared by its distance from q0 or home starts there first.
            given=bool(given or o.closest or (attempts == 1 and self.arrays(kind) is self._chain)),
            iterations=iterations if o.max_iterations is None else o.max_iterations,
            attempts=attempts,
            c=c,
            rho=rho,
            c_free=c_free,
            rho_free=rho_free,
            patience=length.patience if give_up else np.inf,
            evaluations=o.max_evaluations or np.inf,
            limits=o.limits,
            seed=o.seed,
            closest=CLOSEST if o.closest else 0,
            hold=getattr(self.rule, "hold", False),
            follow=o.follow or 0.0,
            follow_slide=o.follow * self.robot.reach if o.follow else 0.0,
        )
        weights = np.ones(self.robot.n) if o.joint_weights is None else o.joint_weights
        return np.concatenate([orders, *tasks, weights, self._parameters(kind, given)])

    def _length(self) -> Any:
        """How long the search goes on where the caller does not say."""
        return self.row.length(len(self.robot.tips))

    def _tasks(self, kind: Any) -> list[Task]:
        """What counts at each tip. Raises InvalidOption when the solver does not do that."""
        o, row = self.options, self.row
        kinds = kind if isinstance(self.robot, Tree) else (kind,)
        if row.closed and (o.closest or counts_in_part(kinds, o)):
            raise InvalidOption(
                f"solver '{row.name}' is a closed form and takes no mask, slack, free_turn, axis target or closest; use 'lm'"
            )
        if len(self.held) and row.moves_all:
            raise InvalidOption(f"solver '{row.name}' moves every joint, so a joint weight of 0 is not kept; use 'lm'")
        if (POSITION in kinds and not row.position) or (POSE in kinds and not row.pose):
            raise InvalidOption(
                f"solver '{row.name}' does not solve {'positions' if POSITION in kinds else 'poses'}: {row.handles}"
            )
        return kernel_tasks(self.robot, kinds, o)

    def _parameters(self, kind: Any, given: bool) -> np.ndarray:
        """Numbers of the rule's compiled step. Raises InvalidOption when a parameter is none, or the rule does not fit."""
        asked = Asked(self.robot, kind if isinstance(self.robot, Tree) else (kind,), given, self.options)
        if reason := self.rule.refuses(asked):
            raise InvalidOption(f"solver '{self.row.name}' {reason}")
        return parameters(self.row, self.rule, asked)

    def arrays(self, kind: Any) -> tuple:
        """Arrays of the chain for the kernel, with the rule's own table of starts where it has one."""
        if not self._own_starts:
            return self._chain
        position_only = kind == POSITION
        found = self._tables.get(position_only)
        if found is None:
            starts = self.rule.start_table(self.robot, position_only)
            found = self._chain
            if starts is not None:
                seeds = np.resize(starts / self.robot.chain.unit, (-(-len(starts) // BEST) * BEST, self.robot.n))
                found = (*self._chain[:2], seeds, table(*self._chain[:2], seeds))
            self._tables[position_only] = found
        return found

    def arrays_for(self, kind: Any, start: np.ndarray) -> tuple:
        """Arrays for a call from `start` (1, n): every other start has the held joints where this one has them, too."""
        arrays = self.arrays(kind)
        if not len(self.held):
            return arrays
        at = (start[0] / self.robot.chain.unit)[self.held]
        key, last = (id(arrays), at.tobytes()), self._pinned
        if last[0] != key:
            self._pinned = last = (key, pin(arrays, self.held, at))
        return last[1]

    def _start(self, q0: Any) -> tuple[np.ndarray, str]:
        """Validate q0; clamp it into the limits or refuse it. Returns (1, n) and a notice."""
        q = self.robot.check_q(q0, "q0")
        inside = np.clip(q, self._lower, self._upper) if self.options.limits else q
        far = np.abs(inside / self.robot.chain.unit) >= LARGEST
        if far.any():
            names = ", ".join(j for j, x in zip(self.robot.joint_names, far, strict=True) if x)
            raise InvalidConfiguration(
                f"q0 is too large a number at joint {names}: it must stay below {LARGEST:g} (rad, or reaches)"
            )
        if (inside == q).all():
            return q[None], ""
        names = ", ".join(self.robot.outside(q))
        if self.options.q0_outside == "refuse":
            raise InvalidConfiguration(f"q0 is outside the limits at joint {names}")
        return inside[None], f"q0 was outside the limits at joint {names} and was clamped"

    # ------------------------------------------------------------------------------------------------ the call
    def __call__(self, target: Any, q0: Any = None) -> Result:
        """Solve for one target: T_base_tip (4, 4), pin.SE3, or a position (3,) [m]; q0 (n,): where the first attempt starts.

        Without q0 the answer may be any solution. Raises InvalidTarget and InvalidConfiguration; a failure to converge is a
        status in the Result.
        """
        started = perf_counter()
        notice = ""
        if type(target) is np.ndarray and target.dtype is FLOAT and target.shape == (4, 4) and target.flags.carray:
            T, kind = target[None], POSE
        else:
            T, kind, notice = _as_pose(target)
        if self._closed and kind in self._closed:
            return self._closed[kind](target, q0)
        if q0 is None:
            start = self._home
        elif type(q0) is np.ndarray and q0.dtype is FLOAT and q0.shape == self._shape and q0.flags.carray:
            start = q0[None]
        else:
            start, note = self._start(q0)
            notice = notice or note
        row = self._run(T, kind, start, q0 is not None)
        if row[AT.status] >= BAD_TARGET:  # what the kernel will not take is looked at here: refused in words, or mended
            if row[AT.status] == BAD_TARGET:
                T, kind, notice = _as_pose(target)  # raises, or projects a rotation that is nearly rigid
            if q0 is not None:
                start, note = self._start(q0)
                notice = notice or note
            row = self._run(T, kind, start, q0 is not None)
        result = Result(self, row, perf_counter() - started, kind == POSITION)
        result._notice = notice
        result._given = q0 is not None
        if not self._more:
            return result
        if self.options.history:
            self._record(result, T, kind, start, q0 is not None)
        if self._extras and row[AT.status] == Status.CONVERGED:
            result.collision = self.finish(row, T, kind, start, q0 is not None)
        if self.options.check:
            self._check(result, target if isinstance(kind, tuple) else T[0] if kind == POSE else T[0, :3, 3])
            if result._status == Status.CHECK_FAILED and kind == POSE:
                mended = check_target(target)[0]  # a rotation of few digits has no angle more exact than they are
                if not np.array_equal(mended, T[0]):
                    return self(mended, q0)
            result.elapsed = perf_counter() - started
        return result

    def all(self, target: Any, q0: Any = None, *, starts: int = 1000, count: int = 64) -> Any:
        """Every distinct solution of a target, nearest to q0 (default home) first: `Solutions`, see `solve_all`.

        Targets (N, 4, 4) or (N, 3) give a `SolutionsBatch`. Evaluated by the kernel; by Pinocchio too with check=True. Of a closed
        form of ours without a free lift it takes some 20 microseconds. Raises as the solver does.
        """
        from .solve_all import find_all

        return find_all(self, target, q0, starts, count)

    def _run(self, T: np.ndarray, kind: Any, start: np.ndarray, given: bool) -> np.ndarray:
        ready = self._ready.get((kind, given))
        if ready is None:
            ready = (*self.arrays_for(kind, start), self.pack(kind, given))
            if not len(self.held):
                if len(self._ready) >= KINDS_KEPT:
                    self._ready.clear()
                self._ready[kind, given] = ready
        rows, ends, seeds, features, opt = ready
        out = np.empty((1, self._width))
        self._kernel(rows, ends, seeds, features, T, start, out, opt, self._silent)
        return out[0]

    def _record(self, result: Result, T: np.ndarray, kind: int, start: np.ndarray, given: bool) -> None:
        """Run once more with room for the history; the counts of the first run say how much."""
        history = np.empty((result.fk_evaluations + 1, 2 + self.robot.n))
        out = np.empty((1, self._width))
        self._kernel(*self.arrays_for(kind, start), T, start, out, self.pack(kind, given), history)
        history = history[: int(out[0, AT.history])]
        if result.orientation_error is None:
            history[:, 1] = np.nan
        if result.status == Status.UNREACHABLE:  # the loop aims at the nearest point inside the bound
            tips = self.robot.chain.forward(history[:, 2:].copy())[0]
            history[:, 0] = np.linalg.norm(tips[:, :3, 3] - T[0, :3, 3], axis=1)
        result._history = {"position_error": history[:, 0], "orientation_error": history[:, 1], "q": history[:, 2:]}

    def finish(
        self, row: np.ndarray, T: np.ndarray, kind: Any, start: np.ndarray, given: bool
    ) -> tuple[str, str] | None:
        """Make a converged row (ANSWER + n,) touch nothing and meet the objective; returns the pair that still touches."""
        if self.collision is not None:
            from .avoid import avoid

            pair = avoid(self, row, T, kind, start)
            if pair is not None:
                return pair
        if self.options.objective is not None:
            before = row.copy()
            self._refine(row, T, kind, start, given)
            if self.collision is not None and self.collision.collides(row[ANSWER:]):
                row[:] = before
        return None

    def _refine(self, row: np.ndarray, T: np.ndarray, kind: Any, start: np.ndarray, given: bool) -> None:
        """Improve a solution in the null space; q and its errors are replaced by better ones that were evaluated."""
        from ..kernel.refine import refine

        what = OBJECTIVES[self.options.objective or ""]
        refine(*self._chain[:2], T, row, start[0], self.pack(kind, given), what, REFINE_STEPS)

    def confirm(self, q: np.ndarray, target: Any) -> tuple[float, float | None, bool]:
        """Errors [m, rad] of q (n,) at a validated target by Pinocchio, and whether both are inside their tolerances."""
        o = self.options
        T, kind, _ = _as_pose(target)
        ((position, orientation),) = counted_errors(self.robot, q, T, (kind,), o)
        good = position <= o.position_tolerance and (orientation or 0.0) <= o.orientation_tolerance
        return position, orientation, good

    def _check(self, result: Result, target: Any) -> None:
        """Compute the errors again with Pinocchio; a success it does not confirm is no success."""
        position, orientation, good = self.confirm(result.q, target)
        result._checked = (position, orientation)
        if not good and result.success:
            result._status = Status.CHECK_FAILED

    def __getstate__(self) -> dict[str, Any]:
        """Pickle what was asked for; the compiled loop is bound again."""
        kept = ("robot", "row", "name", "rule", "options", "_closed")
        return {name: self.__dict__[name] for name in kept}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore and bind."""
        self.__dict__.update(state)
        self._bind()


def require_robot(robot: Any) -> None:
    """Raise InvalidOption when the first argument is no robot."""
    if not isinstance(robot, Robot | Tree):
        raise InvalidOption(f"the first argument is a Robot (see Robot.load), not {type(robot).__name__}")


def _as_pose(target: Any) -> tuple[np.ndarray, Any, str]:
    """Any target -> (1, 4, 4), kind (a pair with the axis for AXIS) and notice."""
    T, kind, notice = read_one(target)
    return T[None], kind, notice


_SOLVERS_LOCK = threading.Lock()


def bound(robot: Robot, solver: Any, options: dict[str, Any]) -> Solver:
    """Return a Solver for these arguments, the same one each time they can be hashed."""
    cache = robot.memo.setdefault("bound solvers", {})
    try:
        # Types too: named tuples of equal numbers are equal, and so are 1 and True.
        key = (type(solver), solver, *options.items(), *map(type, options.values()))
        found = cache.get(key)
    except TypeError:  # a parameter that cannot be hashed, such as a matrix
        return Solver(robot, solver, **options)
    if found is None:
        with _SOLVERS_LOCK:
            found = cache[key] = Solver(robot, solver, **options)
            if len(cache) > 64:
                cache.pop(next(iter(cache)))
    return found


def is_auto(solver: Any) -> bool:
    """Whether the choice of the solver is left to us."""
    return solver is None or (isinstance(solver, str) and solver == "auto")


def automatic(robot: Robot, kind: int, options: dict[str, Any]) -> str:
    """Name of the solver that 'auto' stands for: a closed form where one fits and no preference is given, else 'lm'."""
    preferences = {name: value for name, value in options.items() if name not in EXACT}
    if preferences.keys() <= set(NAMES) and make_options(preferences) == Options():
        return fits(robot, kind) or GENERAL
    return GENERAL


def solve(robot: Robot, target: Any, solver: Any = "auto", q0: Any = None, **options: Any) -> Result:
    """Find joint values that bring the tip to the target.

    target: T_base_tip (4, 4) or pin.SE3, a position (3,) with orientation free [m], or an AxisTarget (see `pose`). solver: a
    name, a rule class or an instance with its parameters; 'auto' uses a closed form where one fits and 'lm' otherwise. q0
    (n,): where the first attempt starts; without it the answer may be any solution (fastest), so give q0 to stay near it.
    follow: for loops, one attempt that moves no joint further than this from q0. closest=q_ref (n,): of several solutions the
    one nearest to it. Options, see `Options`: tolerance (both), position_tolerance [m], orientation_tolerance [rad],
    max_iterations, restarts, max_evaluations, seed, limits, q0_outside, mask, slack, free_turn, frame, joint_weights, objective,
    avoid_collisions, history; and the parameters of the solver. Success is re-checked with Pinocchio. Raises InvalidTarget,
    InvalidConfiguration, UnknownSolver, InvalidOption.
    """
    require_robot(robot)
    solver = "auto" if solver is None else solver
    options.setdefault("check", True)
    if "closest" in options and not isinstance(options["closest"], bool | np.bool_):
        if q0 is not None:
            raise InvalidOption("give closest=q_ref or q0, not both: the search starts at q_ref")
        q0, options["closest"] = options["closest"], True
    return bound(robot, solver, options)(target, q0)
