"""A benchmark of solvers on the same targets: success rates with their intervals, times and iterations."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from itertools import pairwise
from time import perf_counter
from typing import Any

import numpy as np

from ..errors import IKError, Interrupted, InvalidOption, UnknownSolver, check_progress, whole
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.batch.parts import check_executor
from ..solvers.registry import find_row, list_rows
from ..solvers.solve import Solver, is_auto, require_robot
from ..solvers.status import Status, count_statuses
from ..text import Tabled, TextTable, duration
from ..validate import one_of, solver_list

# The targets are solved in BLOCKS blocks, each by all solvers in turn, so that other load on the machine affects all alike.
BLOCKS = 10
NEAR = 0.1  # [rad or m] the start 'near' is a solution with every joint changed at random by at most this
RESTARTS = 99  # default number of restarts of every solver, so that each has 100 attempts
STARTS = ("none", "home", "random", "near")
TASKS = ("pose", "position")


@dataclass(frozen=True)
class BenchmarkRow:
    """Results of a benchmark for one solver on one robot.

    Attributes:
        robot: Name of the robot.
        tips: Names of its tips.
        solver: Name of the solver.
        task: 'pose' or 'position'.
        targets: Number of targets.
        solved: Number of targets that were solved.
        low, high: 95 % Wilson interval of the success probability.
        median, mean, p99: Time of one call from Python [s], failures included; p99 is the 99th percentile.
        iterations: Median number of iterations.
        restarts: Mean number of restarts.
        fk_evaluations: Median number of evaluations of the forward kinematics.
        statuses: Number of targets that ended with each status, by name.
        worst_position_error: Largest error of all successes and tips [m], None without successes.
        worst_orientation_error: Largest error of all successes and tips [rad], None without successes or for positions.
        seconds: (N,) time of each call [s], solved targets first.
        iteration_counts: (N,) iterations of each call, in the same order.
        once: The BenchmarkRow of the same targets with one attempt each (no restarts); None in that row itself.
    """

    robot: str
    tips: tuple[str, ...]
    solver: str
    task: str
    targets: int
    solved: int
    low: float
    high: float
    median: float
    mean: float
    p99: float
    iterations: float
    restarts: float
    fk_evaluations: float
    statuses: dict[str, int]
    worst_position_error: float | None
    worst_orientation_error: float | None
    seconds: np.ndarray = field(repr=False, compare=False)
    iteration_counts: np.ndarray = field(repr=False, compare=False)
    once: "BenchmarkRow | None" = None

    def to_dict(self) -> dict[str, Any]:
        """Return all attributes but the arrays as numbers, strings and lists, ready for JSON."""
        plain = {key: value for key, value in self.__dict__.items() if not isinstance(value, np.ndarray)}
        return plain if self.once is None else {**plain, "once": self.once.to_dict()}


@dataclass(frozen=True, repr=False)
class Benchmark(Tabled):
    """Results of a benchmark for all robots and solvers.

    Attributes:
        rows: A row for each robot and solver, robot by robot.
        skipped: Why a solver does not apply to a robot, by (robot, solver).
        targets: Number of targets for each robot.
        start: Where the solvers started.
        seed: Seed of the targets.
        options: Options of the solvers.
    """

    rows: tuple[BenchmarkRow, ...]
    skipped: dict[tuple[str, str], str]
    targets: int
    start: str
    seed: int
    options: dict[str, Any]

    def by_robot(self) -> dict[str, list[BenchmarkRow]]:
        """Return the rows by robot; a robot's name includes its tips if it has several, or also occurs with other tips."""
        tips: dict[str, set] = {}
        for row in self.rows:
            tips.setdefault(row.robot, set()).add(row.tips)
        found: dict[str, list[BenchmarkRow]] = {}
        for row in self.rows:
            found.setdefault(label(row.robot, row.tips, len(tips[row.robot]) > 1), []).append(row)
        return found

    def table(self) -> TextTable:
        """Return success, iterations and times as a table, with a row for each robot and solver."""
        rows = []
        for robot, found in self.by_robot().items():
            for row in found:
                once = "" if row.once is None else f"{100 * row.once.solved / row.once.targets:.1f} %"
                share = f"{100 * row.solved / row.targets:.1f} % ({100 * row.low:.1f} to {100 * row.high:.1f})"
                times = duration(row.median), duration(row.p99)
                rows.append((robot, row.solver, row.task, once, share, *times, row.iterations, row.fk_evaluations))
        head = ("robot", "solver", "task", "solved at once", "with restarts (95 %)", "median time", "99 % within")
        left_out = ", ".join(f"{solver} ({robot})" for robot, solver in self.skipped)
        return TextTable(
            f"{self.targets} targets",
            f"for each robot, start: {self.start}, seed: {self.seed}, {', '.join(f'{k}: {v}' for k, v in self.options.items())}",
            (*head, "iterations", "FK evaluations"),
            rows,
            f"not applicable: {left_out}" if left_out else "",
            "ik.plot(benchmark) draws it.",
            most=60,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return all results as plain numbers, strings and lists, ready for JSON."""
        return {
            "targets": self.targets,
            "start": self.start,
            "seed": self.seed,
            "options": self.options,
            "rows": [row.to_dict() for row in self.rows],
            "skipped": [{"robot": a, "solver": b, "why": why} for (a, b), why in self.skipped.items()],
        }


class BenchmarkInterrupted(Interrupted):
    """Ctrl-C during a benchmark; `result` is the Benchmark of the blocks of targets finished before it."""


def benchmark(
    robots: Robot | Tree | str | Sequence[Robot | Tree | str],
    solvers: Any = None,
    *,
    targets: int = 300,
    start: str = "none",
    task: str | None = None,
    seed: int = 0,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> Benchmark:
    """Compare solvers on the same random reachable targets, in one thread, each call timed from Python.

    Every solver solves the targets twice: with one attempt, and with restarts.

    Args:
        robots: One or several robots, loaded or by name. All tips of a Tree are solved together; errors are the largest of them.
        solvers: One or several names, classes or instances. Default: every registered solver that applies.
        targets: Number of targets for each robot: poses of random configurations inside the limits.
        start: 'none' (each solver's own choice), 'home', 'random', or 'near' (within 0.1 rad or m of a solution in each joint).
        task: 'pose' or 'position'. Default: 'pose' for robots of at least six joints a tip.
        seed: Seed of the targets and starts.
        executor: Anything with the interface of concurrent.futures, used instead of this process; it measures its own times.
        progress: Called as progress(done, all) after each block of targets.
        **options: As for `solve`, for every solver that accepts them; `restarts` is 99 if not given.

    Returns:
        The results; solvers that do not apply to a robot are in `skipped`, with the reason.

    Raises:
        RobotNotFound: There is no such robot.
        UnknownSolver: There is no such solver, or none applies.
        InvalidOption: An option is unknown or out of range.
        BenchmarkInterrupted: Ctrl-C was pressed. It is a KeyboardInterrupt; its `result` holds the finished blocks.
    """
    one_of(start, STARTS, "start")
    if task is not None:
        one_of(task, TASKS, "task")
    targets, seed = whole(targets, "targets"), whole(seed, "seed", 0)
    check_executor(executor)
    check_progress(progress, "two numbers, done and all")
    arms = [robots] if isinstance(robots, str) or not isinstance(robots, Iterable) else list(robots)
    arms = [Robot.load(arm) if isinstance(arm, str) else arm for arm in arms]
    for arm in arms:
        require_robot(arm)
    asked = [row.name for row in list_rows()] if solvers is None else solver_list(solvers)
    for solver in asked:
        if not is_auto(solver):
            # An unknown name raises an error here, but a solver that does not apply to a robot is only skipped.
            find_row(solver)
    if not arms or not asked:
        raise InvalidOption("a benchmark needs at least one robot and one solver")
    rows: list[BenchmarkRow] = []
    skipped: dict[tuple[str, str], str] = {}
    options = {"restarts": RESTARTS, **options}
    last: IKError | None = None
    stopped = False
    for number, arm in enumerate(arms):
        kind = task or ("pose" if arm.n >= 6 * len(arm.tips) else "position")
        parts: dict[tuple[str, bool], list[np.ndarray]] = {}
        try:
            T, Q0 = problems(arm, targets, kind, start, seed)
            bound, refused = _bind(arm, asked, options, T, Q0, every=solvers is None)
            skipped |= {(label(arm.name, arm.tips), name): str(error) for name, error in refused.items()}
            wrong = (error for error in refused.values() if isinstance(error, InvalidOption))
            last = next(wrong, next(reversed(refused.values()), last))
            for done, count in _measure(bound, T, Q0, executor, parts):
                if progress is not None:
                    progress(number * count + done, len(arms) * count)
        except KeyboardInterrupt:
            stopped = True
        for name in [name for name, once in parts if not once]:
            tables = [np.concatenate(parts[name, once][: len(parts[name, False])]) for once in (True, False)]
            one, many = (summary(arm, name, kind, table) for table in tables)
            rows.append(replace(many, once=one))
        if stopped:
            break
    # Nothing was solved because no solver applies to any robot. Then an option is probably wrong, and an error says which.
    if last is not None and not rows and not stopped:
        raise last
    found = Benchmark(tuple(rows), skipped, targets, start, seed, dict(options))
    if stopped:
        raise BenchmarkInterrupted(found, f"with {len(rows)} rows")
    return found


def label(robot: str, tips: tuple[str, ...], always: bool = False) -> str:
    """Return a robot's name for a table, followed by the names of its tips if it has several, or if `always`."""
    return f"{robot} ({' + '.join(tips)})" if always or len(tips) > 1 else robot


Bound = dict[tuple[str, bool], Solver]


def _bind(
    robot: Robot | Tree, asked: list[Any], options: dict[str, Any], T: np.ndarray, Q0: np.ndarray | None, *, every: bool
) -> tuple[Bound, dict[str, IKError]]:
    """Bind solvers to a robot and compile them.

    Returns the bound solvers by (name, once), where `once` is True for one attempt and False for restarts, and the errors of
    solvers that do not apply. If `every`, the caller has not chosen the solvers, so any error is a reason to leave one out.
    """
    bound: Bound = {}
    refused: dict[str, IKError] = {}
    without: dict[str, Any] = options | {"restarts": 0}
    for solver in asked:
        try:
            one, many = Solver(robot, solver, **without), Solver(robot, solver, **options)
            one(T[0], None if Q0 is None else Q0[0])  # The first call compiles, which must not be timed.
        except IKError as error:
            if not every and not isinstance(error, InvalidOption | UnknownSolver):
                raise
            refused[getattr(solver, "__name__", str(solver))] = error
            continue
        name = one.name if (one.name, True) not in bound else f"{one.name} #{len(bound) // 2 + 1}"
        bound[name, True], bound[name, False] = one, many
    return bound, refused


def _measure(
    bound: Bound,
    T: np.ndarray,
    Q0: np.ndarray | None,
    executor: Executor | None,
    parts: dict[tuple[str, bool], list[np.ndarray]],
) -> Iterator[tuple[int, int]]:
    """Let all solvers in turn solve a block of targets, and append the result tables to `parts`; yields (blocks done, all)."""
    edges = np.linspace(0, len(T), min(BLOCKS, len(T)) + 1).astype(int)
    jobs = [
        (key, solver, T[a:b], None if Q0 is None else Q0[a:b])
        for a, b in pairwise(edges)
        for key, solver in bound.items()
    ]
    futures = [executor.submit(run_block, *job[1:]) for job in jobs] if executor is not None else None
    for k, job in enumerate(jobs):
        # Ctrl-C mostly arrives in the next statement, where nearly all time is spent, so at most one block of targets is lost.
        table = run_block(*job[1:]) if futures is None else futures[k].result()
        parts.setdefault(job[0], []).append(table)
        yield k + 1, len(jobs)


def problems(robot: Robot | Tree, count: int, task: str, start: str, seed: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Draw random reachable targets (N, 4, 4) or (N, 3) [m], for a Tree (N, F, ...), and starts (N, n) [rad or m] or None."""
    rng = np.random.default_rng(seed)
    Q = robot.random_q(rng, count)
    T = robot.chain.forward(Q)[0]
    T = T if task == "pose" else np.ascontiguousarray(T[..., :3, 3])
    if start == "none":
        return T, None
    if start == "home":
        return T, np.tile(robot.home, (count, 1))
    if start == "near":
        return T, np.clip(Q + rng.uniform(-NEAR, NEAR, Q.shape), robot.lower, robot.upper)
    return T, robot.random_q(rng, count)


def run_block(solver: Solver, T: np.ndarray, Q0: np.ndarray | None) -> np.ndarray:
    """Solve a block of m targets one by one, and time each call.

    Returns a row for each target (m, 7): time [s], status, iterations, restarts, evaluations, errors [m] and [rad].
    """
    table = np.empty((len(T), 7))
    for k, target in enumerate(T):
        q0 = None if Q0 is None else Q0[k]
        started = perf_counter()
        result = solver(target, q0)
        table[k, 0] = perf_counter() - started
        error = result.orientation_error
        table[k, 1:5] = result.status, result.iterations, result.restarts, result.fk_evaluations
        table[k, 5:] = result.position_error, np.nan if error is None else error
    return table


def summary(robot: Robot | Tree, solver: str, task: str, table: np.ndarray) -> BenchmarkRow:
    """Return the BenchmarkRow (rates, times, counts) for N targets from the table (N, 7) of their results (see `run_block`).

    In its arrays the solved targets come first.
    """
    good = table[:, 1] == Status.CONVERGED
    solved, count = int(good.sum()), len(table)
    low, high = wilson(solved, count)
    statuses = count_statuses(table[:, 1])
    table = table[np.argsort(~good, kind="stable")]
    seconds, best = table[:, 0], table[:solved]
    return BenchmarkRow(
        robot=robot.name,
        tips=robot.tips,
        solver=solver,
        task=task,
        targets=count,
        solved=solved,
        low=low,
        high=high,
        median=float(np.median(seconds)),
        mean=float(seconds.mean()),
        p99=float(np.percentile(seconds, 99)),
        iterations=float(np.median(table[:, 2])),
        restarts=float(table[:, 3].mean()),
        fk_evaluations=float(np.median(table[:, 4])),
        statuses=statuses,
        worst_position_error=float(best[:, 5].max()) if solved else None,
        worst_orientation_error=float(best[:, 6].max()) if solved and task == "pose" else None,
        seconds=seconds,
        iteration_counts=table[:, 2],
    )


def wilson(successes: int, trials: int, z: float = 1.959963984540054) -> tuple[float, float]:
    """Return the Wilson score interval (low, high) of a success probability; it is (0, 1) without trials.

    z is the quantile of the normal distribution, by default for 95 %. Source: Wilson (1927); Brown, Cai, DasGupta (2001), eq. (4).
    """
    if trials == 0:
        return 0.0, 1.0
    share, zz = successes / trials, z * z
    middle = (share + zz / (2 * trials)) / (1 + zz / trials)
    half = z / (1 + zz / trials) * math.sqrt(share * (1 - share) / trials + zz / (4 * trials * trials))
    low = 0.0 if successes == 0 else middle - half
    high = 1.0 if successes == trials else middle + half
    return low, high
