"""Our own solvers side by side on a robot: success with its interval, times, iterations."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from itertools import pairwise
from time import perf_counter
from typing import Any

import numpy as np

from ..errors import IKError, InvalidOption, Portable, UnknownSolver, check_progress, whole
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.batch_parts import check_executor
from ..solvers.registry import find_row, list_rows
from ..solvers.solve import Solver, is_auto, require_robot
from ..solvers.status import Status, count_statuses
from ..tracking.inputs import one_of
from .inputs import solver_list
from .statistics import wilson

BLOCKS = 10  # blocks of targets on which the solvers alternate, so that background load affects all alike
NEAR = 0.1  # rad (m): a near start lies within this distance of a solution in each joint
RESTARTS = 99  # the same for every solver
STARTS = ("none", "home", "random", "near")
TASKS = ("pose", "position")


@dataclass(frozen=True)
class BenchmarkRow:
    """One solver on one robot, with restarts and, in `once`, the same targets with one attempt.

    robot, tips, solver; task 'pose' or 'position'; targets, solved, and the 95 % Wilson interval low, high of the success
    probability; median, mean, p99 [s] of one call from Python, failures included; iterations and fk_evaluations, medians;
    restarts, mean; statuses: name -> count; worst_position_error [m] and worst_orientation_error [rad] among the successes, the
    largest over the tips (None without successes, or for positions). seconds and iteration_counts (N,) are kept for plots. once:
    the row for one attempt per target (None in that row itself).
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
        """Plain numbers without the arrays, ready for JSON."""
        plain = {key: value for key, value in self.__dict__.items() if not isinstance(value, np.ndarray)}
        return plain if self.once is None else {**plain, "once": self.once.to_dict()}


@dataclass(frozen=True)
class Benchmark:
    """Result of `benchmark`: rows, in the order robots x solvers; skipped: (robot, solver) -> why it does not apply."""

    rows: tuple[BenchmarkRow, ...]
    skipped: dict[tuple[str, str], str]
    targets: int
    start: str
    seed: int
    options: dict[str, Any]

    def by_robot(self) -> dict[str, list[BenchmarkRow]]:
        """Rows by robot name, with its tips if it has several or the same robot occurs with other tips."""
        tips: dict[str, set] = {}
        for row in self.rows:
            tips.setdefault(row.robot, set()).add(row.tips)
        found: dict[str, list[BenchmarkRow]] = {}
        for row in self.rows:
            found.setdefault(label(row.robot, row.tips, len(tips[row.robot]) > 1), []).append(row)
        return found

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, strings and lists, ready for JSON."""
        return {
            "targets": self.targets,
            "start": self.start,
            "seed": self.seed,
            "options": self.options,
            "rows": [row.to_dict() for row in self.rows],
            "skipped": [{"robot": a, "solver": b, "why": why} for (a, b), why in self.skipped.items()],
        }


class BenchmarkInterrupted(Portable, KeyboardInterrupt):
    """Ctrl-C during a benchmark; `result` is the Benchmark of the blocks of targets finished before it."""

    def __init__(self, result: Benchmark) -> None:
        """Keep the finished part."""
        super().__init__(f"interrupted with {len(result.rows)} rows")
        self.result = result


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
    """Compare solvers on the same random reachable targets, one thread, each call timed from Python.

    Every solver solves the targets twice: with one attempt, and with the same number of restarts (`restarts=`, default 99).
    robots: one or several, loaded or by name; for a Tree, all tips are solved together, and errors are the largest of them.
    solvers: one or several names, classes or instances; default: every registered one that applies. targets: number per
    robot, poses of random configurations inside the limits. start: 'none' (each solver's own choice), 'home', 'random', or
    'near' (within 0.1 rad or m of a solution in each joint). task: 'pose' or 'position'; default 'pose' for six or more
    joints per tip. executor: anything with the concurrent.futures interface, used instead of this process; times are then
    those of the workers. progress(done, all) counts blocks. Options: as for `solve`, passed to every solver that accepts
    them. A solver that does not apply to a robot is listed in `skipped` with the reason. Ctrl-C raises
    BenchmarkInterrupted, a KeyboardInterrupt whose `result` holds the finished blocks. Raises RobotNotFound, UnknownSolver,
    InvalidOption.
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
            find_row(solver)  # raises for an unknown name; one that does not apply is only skipped
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
            last = next(reversed(refused.values()), last)
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
    if last is not None and not rows and not stopped:  # nothing applies: more likely a wrong option than a wrong robot
        raise last
    found = Benchmark(tuple(rows), skipped, targets, start, seed, dict(options))
    if stopped:
        raise BenchmarkInterrupted(found)
    return found


def label(robot: str, tips: tuple[str, ...], always: bool = False) -> str:
    """Name of a robot, with its tips if it has several (or always)."""
    return f"{robot} ({' + '.join(tips)})" if always or len(tips) > 1 else robot


Bound = dict[tuple[str, bool], Solver]


def _bind(
    robot: Robot | Tree, asked: list[Any], options: dict[str, Any], T: np.ndarray, Q0: np.ndarray | None, *, every: bool
) -> tuple[Bound, dict[str, IKError]]:
    """Compiled solvers by (name, one attempt: True or with restarts: False), and the reasons of those that do not apply.

    every: the solvers were not chosen by name, so those that do not apply are left out.
    """
    bound: Bound = {}
    refused: dict[str, IKError] = {}
    without: dict[str, Any] = options | {"restarts": 0}
    for solver in asked:
        try:
            one, many = Solver(robot, solver, **without), Solver(robot, solver, **options)
            one(T[0], None if Q0 is None else Q0[0])  # compiles
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
    """Give blocks of targets to all solvers in turn; the tables of `run_block` go to `parts`. Yields (done, all)."""
    edges = np.linspace(0, len(T), min(BLOCKS, len(T)) + 1).astype(int)
    jobs = [
        (key, solver, T[a:b], None if Q0 is None else Q0[a:b])
        for a, b in pairwise(edges)
        for key, solver in bound.items()
    ]
    futures = [executor.submit(run_block, *job[1:]) for job in jobs] if executor is not None else None
    for k, job in enumerate(jobs):
        table = run_block(*job[1:]) if futures is None else futures[k].result()  # may be interrupted
        parts.setdefault(job[0], []).append(table)
        yield k + 1, len(jobs)


def problems(robot: Robot | Tree, count: int, task: str, start: str, seed: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Targets (N, 4, 4) or (N, 3) [m], for a Tree (N, F, ...), and starts (N, n) [rad or m], None for each solver's own."""
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
    """Solve a block; rows (m, 7): seconds, status, iterations, restarts, FK evaluations, position and rotation error."""
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
    """Statistics of the rows of `run_block`; the stored arrays have the solved targets first."""
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
