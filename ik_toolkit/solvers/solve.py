"""The public calls: `solve` for one target, `solve_all`, and `Solver`, bound once, for loops that must be fast.

There is little between a call and the compiled loop: a bound solver picks its plan by the kind of target, and the plan calls the
loop.
"""

import functools
import threading
from collections.abc import Mapping
from time import perf_counter
from typing import Any, ClassVar, Unpack

import numpy as np

from ..compile.jit import compile_time
from ..copying import ReadOnly
from ..errors import InvalidOption
from ..kernel.checks import CODE
from ..kernel.counted_error import KIND
from ..kernel.records import AT
from ..robot.narrow import with_limits
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..validate import FLOAT
from .closed_form import fits
from .decide import deciding, elimination_plan
from .options import NAMES, AllOptions, Options, SolveOptions, changed, make_options
from .outcome import make_outcome
from .plan import Plan
from .postprocess import finish_failure
from .registry import GENERAL, find_row, make_rule, search_for
from .result import Result
from .solutions import Solutions
from .task import POSES, read_target

# Options that choose or follow a single answer. `solve_all`, which returns every answer, refuses them.
CHOOSING = ("closest", "objective", "history", "follow", "timeout")
BOUND_KEPT = 64  # number of `Solver` objects that `solve` keeps in its cache for a robot
EXACT = {  # options with which 'auto' may use a closed form; with any other option it uses the iterative search
    "tolerance", "position_tolerance", "orientation_tolerance", "max_iterations", "max_evaluations", "timeout", "restarts",
    "seed", "length_scale", "limits", "q0_outside", "history", "check", "objective",
}  # fmt: skip


class Solver(ReadOnly):
    """A solver bound to a robot, for loops that must be fast: `solver(target, q0=None) -> Result` takes a few microseconds.

    The result is not checked by Pinocchio unless check=True. A Solver may be called from several threads.

    Args:
        robot: A Robot, or a Tree (several tips solved together).
        solver: Name, solver class or instance. 'auto' uses a closed form if one fits the robot and the kind of target, or if one of
            its parameters is given; otherwise the search. `result.solver` names the one used.
        options: As in `ik.solve`, and parameters of the solver.

    Attributes:
        robot, name, plan: The robot, the solver's name, and the bound solver with its arrays (see `plan.Plan`).

    Raises:
        UnknownSolver: There is no such solver, or it does not fit the robot.
        InvalidOption: An option is wrong.
    """

    _INSTEAD: ClassVar[Mapping[str, str]] = {"": "make a Solver with the robot, solver and options you want"}

    def __init__(self, robot: Robot | Tree, solver: Any = "auto", **options: Unpack[SolveOptions]) -> None:
        """Validate everything once; the loop is compiled at the first call."""
        require_robot(robot)
        robot = narrowed_for(robot, options)
        options.setdefault("check", False)
        auto = is_auto(solver)
        if auto and (owner := closed_form_with(robot, options)):
            solver, auto = owner, False
        # plans for the kinds of target that 'auto' solves with another solver than self.plan
        self._plans: dict[tuple, Plan] = {}
        if auto:
            chosen = {kind: automatic(robot, kind, options) for kind in (KIND.pose, KIND.position)}
            self._plans = {(k,): make_plan(robot, name, options) for k, name in chosen.items() if name != GENERAL}
        self.plan = make_plan(robot, search_for(options.get("priority")) if auto else solver, options)
        if auto and POSES not in self._plans and (decides := deciding(self.plan)):
            self._plans[POSES] = decides
        self.robot = robot
        self.name = "auto" if auto else self.plan.row.name
        self._shape = (robot.n,)
        # shape of a target array that needs no conversion; () if there is none, as for a Tree of one tip, which takes a list of
        # targets
        self._pose = () if robot.by_tip and len(robot.tips) == 1 else robot.pose_shape
        self._kinds = POSES * len(robot.tips)
        self._seal()

    @property
    def rule(self) -> Any:
        """The iterative method (rule) or closed form with its parameters; for 'auto' that of the general search."""
        return self.plan.rule

    @property
    def options(self) -> Options:
        """The options, validated and with defaults filled in."""
        return self.plan.options

    def plan_for(self, kinds: tuple) -> Plan:
        """Return the Plan that solves targets of these kinds, one kind per tip."""
        return self._plans.get(kinds, self.plan)

    @functools.cached_property
    def lister(self) -> Plan | None:
        """The Plan with which the elimination lists all solutions of a pose; None if another solver does that for this robot."""
        plan = self.plan_for(POSES)
        if self.name == "auto" and not plan.row.closed:
            return elimination_plan(plan)
        return plan if plan.row.name == "elimination" else None

    def __call__(self, target: Any, q0: Any = None) -> Result:
        """Solve for one target.

        Args:
            target: T_base_tip (4, 4), pin.SE3, a position (3,) [m] or an AxisTarget; for several tips a dict of these
                by tip, or a list in the order of `robot.tips`.
            q0: Configuration (n,) [rad or m] where the first attempt starts; without it the answer may be any solution.

        Returns:
            The Result; a failure to converge is its status.

        Raises:
            InvalidTarget, FrameNotFound, InvalidConfiguration: The target, a tip's name or q0 is wrong.
        """
        started = perf_counter()
        notice = ""
        if type(target) is np.ndarray and target.dtype is FLOAT and target.shape == self._pose and target.flags.carray:
            T, kinds = target[None], self._kinds
        else:
            T, kinds, notice = read_target(self.robot, target)
        plan = self._plans.get(kinds, self.plan) if self._plans else self.plan
        given = q0 is not None
        if not given:
            start = plan.home
        elif type(q0) is np.ndarray and q0.dtype is FLOAT and q0.shape == self._shape and q0.flags.carray:
            start = q0[None]
        else:
            start, note = plan.check_start(q0)
            notice = notice or note
        row = plan.solve(T, kinds, start, given)
        # The fast way above takes a target and q0 unchecked. If the compiled search has rejected one, it is now corrected and
        # solved again, or refused with a message.
        status = row[AT.status]
        if status >= CODE.bad_target:
            if status == CODE.bad_target:
                T, kinds, notice = read_target(self.robot, target)
            if given:
                start, note = plan.check_start(q0)
                notice = notice or note
            row = plan.solve(T, kinds, start, given)
            status = row[AT.status]
        asked = start.tobytes() if given else b""
        elapsed, waited = perf_counter() - started, 0.0
        if elapsed > 1e-3:  # [s] only calls that compile, or load compiled code, take longer than this
            elapsed -= (waited := compile_time(started))
        outcome = make_outcome((plan, T.tobytes(), kinds, asked, row, elapsed, notice, None, None, None, waited))
        if status != CODE.converged:
            outcome = finish_failure(outcome)
        for step in plan.steps:
            outcome = step(outcome)
        if plan.steps or status != CODE.converged:
            waited = compile_time(started)
            outcome = outcome._replace(elapsed=perf_counter() - started - waited, compile_time=waited)
        return Result(outcome)

    def all(self, target: Any, q0: Any = None, *, starts: int = 1000, count: int = 64, all_turns: bool = False) -> Any:
        """Find every distinct solution of a target, nearest to q0 first (see `solve_all`).

        Errors are those of the compiled search; with check=True Pinocchio computes them, too. With one of this package's closed
        forms, and no free prismatic joint, a call takes some 20 microseconds.

        Args:
            target: As for the solver, or targets (N, 4, 4) or (N, 3), also as a list.
            q0: Configuration (n,) [rad or m], by default home.
            starts: Number of random starts of a search.
            count: Largest number of solutions.
            all_turns: List each solution with all shifts by 2 pi k inside the limits, not only the one nearest q0.

        Returns:
            Solutions, or a SolutionsBatch for several targets. It raises what the solver raises.
        """
        return _finder()(self, target, q0, starts, count, all_turns)


@functools.cache
def _finder() -> Any:
    """Return `every.find_all`, imported only at the first call; an import statement costs 5 us each time."""
    from .every import find_all

    return find_all


def require_robot(robot: Any) -> None:
    """Raise InvalidOption unless `robot` is a Robot or a Tree."""
    if not isinstance(robot, Robot | Tree):
        raise InvalidOption(f"a Robot or a Tree is needed (see Robot.load), not {type(robot).__name__}")


def narrowed_for(robot: Any, options: Any) -> Any:
    """Return the robot itself or, if the option `limits` gives narrower limits, a copy with these (`limits` becomes True)."""
    limits = options.get("limits", True)
    if limits is True or limits is False:
        return robot
    robot, options["limits"] = with_limits(robot, limits)
    return robot


def make_plan(robot: Any, solver: Any, options: Mapping[str, Any]) -> Plan:
    """Return the Plan that binds a solver (name, class or instance) to a robot and options.

    Raises UnknownSolver, InvalidOption.
    """
    row = find_row(solver)
    fields = ()
    if isinstance(solver, str | type):
        fields = row.load()._fields
        rule = make_rule(row, {key: value for key, value in options.items() if key in fields})
        options = {key: value for key, value in options.items() if key not in fields}
    else:
        rule = solver
    return Plan(robot, row, rule, make_options(changed(rule.options(), options), fields))


_SOLVERS_LOCK = threading.Lock()


def bound_solver(robot: Any, solver: Any, options: Any) -> Solver:
    """Return a Solver for this robot, solver and options, from a cache if they can be hashed."""
    robot = narrowed_for(robot, options)
    kept = robot.memo.setdefault("solvers", {})
    try:
        # The key of the cache includes types, because named tuples of different classes with equal numbers are equal, and so are 1
        # and True.
        key = (type(solver), solver, *options.items(), *map(type, options.values()))
        found = kept.get(key)
    except (TypeError, ValueError):  # not cached: a parameter such as a matrix cannot be hashed
        return Solver(robot, solver, **options)
    if found is None:
        # The Solver is made outside the lock, because a user's solver class may itself call `solve` while it is being made.
        made = Solver(robot, solver, **options)
        with _SOLVERS_LOCK:
            found = kept.setdefault(key, made)
            if len(kept) > BOUND_KEPT:
                kept.pop(next(iter(kept)))
    return found


def is_auto(solver: Any) -> bool:
    """Return whether `solver` is 'auto' or None, so that the toolkit chooses one."""
    return solver is None or (isinstance(solver, str) and solver == "auto")


def closed_form_with(robot: Any, options: Mapping[str, Any]) -> str | None:
    """Return a closed form that fits the robot if `options` has one of its own parameters, which show that it is meant; or None."""
    names = options.keys() - {*NAMES, "tolerance", *find_row(GENERAL).load()._fields}
    if not names:
        return None
    fitting = (name for kind in (KIND.pose, KIND.position) if (name := fits(robot, kind)))
    return next((name for name in fitting if names & set(find_row(name).load()._fields)), None)


def automatic(robot: Any, kind: int, options: Mapping[str, Any]) -> str:
    """Return the name of the solver that 'auto' takes for this kind of target.

    It is a closed form if one fits and respects all options, otherwise the search.
    """
    preferences = {name: value for name, value in options.items() if name not in EXACT}
    if preferences.keys() <= set(NAMES) and make_options(preferences) == Options():
        return fits(robot, kind) or GENERAL
    return GENERAL


def solve(
    robot: Robot | Tree, target: Any, solver: Any = "auto", q0: Any = None, **options: Unpack[SolveOptions]
) -> Result:
    """Find joint values that bring the tip to the target, or several tips to theirs; Pinocchio checks a success again.

    Args:
        robot: The Robot, or a Tree of several tips.
        target: T_base_tip (4, 4) or pin.SE3, a position (3,) [m] with orientation free, or an AxisTarget (see `pose`);
            for a Tree a dict of these by tip, or a list in the order of its tips.
        solver: A name, a solver class or an instance with its parameters; 'auto' uses a closed form if one fits,
            otherwise the search.
        q0: Configuration (n,) [rad or m] where the first attempt starts. Without it the answer may be any solution
            (fastest), so give q0 to stay near it.
        options: Parameters of the solver, and options (explained in help("ik_toolkit.solvers.options.Options")):
            tolerance (both), position_tolerance [m], orientation_tolerance [rad], max_iterations, restarts,
            max_evaluations, timeout [s], seed, q0_outside, mask, slack, free_turn, frame, priority ("position": then the
            orientation as near as that allows), joint_weights, objective, avoid_collisions, history; follow (for loops,
            one attempt that moves no joint further than this); closest=q_ref (n,) (the nearest of several solutions);
            limits (True, False, or narrower ones, {joint: (lower, upper)} [rad or m] or a pair of arrays).

    Returns:
        The Result, whose status says how the solve ended.

    Raises:
        InvalidTarget, InvalidConfiguration: The target or q0 is wrong.
        UnknownSolver, InvalidOption: The solver or an option is wrong.
    """
    require_robot(robot)
    options.setdefault("check", True)
    if "closest" in options and not isinstance(options["closest"], bool | np.bool_):
        if q0 is not None:
            raise InvalidOption("give closest=q_ref or q0, not both: the search starts at q_ref")
        robot.check_q(options["closest"], "closest")
        q0, options["closest"] = options["closest"], True
    return bound_solver(robot, "auto" if solver is None else solver, options)(target, q0)


def solve_all(
    robot: Robot | Tree,
    target: Any,
    solver: Any = "auto",
    q0: Any = None,
    *,
    starts: int = 1000,
    count: int = 64,
    all_turns: bool = False,
    **options: Unpack[AllOptions],
) -> Solutions:
    """Find every distinct solution inside the limits, nearest to q0 first; Pinocchio checks each.

    'auto' uses a closed form if one fits. Its list is complete unless the robot fits only approximately or self-motions exist:
    `families` says what is free, and the rows are a spread sample. For poses of other arms of six revolute joints it uses the
    elimination, whose list is complete if it is certified (`certificate`); it does the same for five joints with a free turn, and
    for three with a position. Otherwise the search runs from random starts, and answers that are equal modulo 2 pi to within 1e-3
    are merged; these are never proven complete. A list that may miss some solutions is completed by such a search.

    Args:
        robot: The Robot or Tree.
        target: As for `solve`.
        solver: As for `solve`.
        q0: Configuration (n,) [rad or m], by default home.
        starts: Number of random starts of a search.
        count: Largest number of solutions.
        all_turns: List each solution with all shifts by 2 pi k inside the limits, not only the one nearest q0. Joints without
            limits keep the value nearest q0.
        options: As for `solve`, without closest, objective, follow, timeout and history; limits=False also lists solutions outside
            the limits.

    Returns:
        The solutions, with their errors and how complete they are.

    Raises:
        InvalidTarget, InvalidConfiguration, UnknownSolver, InvalidOption: As `solve` does.
    """
    require_robot(robot)
    for name in CHOOSING:
        value = options.get(name)
        # An array as value of an option counts as given; it cannot be tested like a bool.
        if value is not None and not (isinstance(value, int | float | np.bool_) and not value):
            raise InvalidOption(f"solve_all lists every solution, nearest to q0 first, so it takes no '{name}'")
    options.setdefault("check", True)
    from .every import find_all

    return find_all(bound_solver(robot, solver, options), target, q0, starts, count, all_turns)
