"""Study of a robot's workspace: where the tip can reach, and where in it solvers succeed, how fast and how accurately."""

import csv
import io
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..compile.jit import compile_time
from ..errors import Interrupted, InvalidOption, check_progress, whole
from ..files import PARTIAL, WholeFile, as_output, inert
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.batch.solve_batch import solve_parts
from ..solvers.registry import GENERAL, find_row
from ..solvers.solve import is_auto, require_robot
from ..solvers.status import count_statuses
from ..text import Tabled, TextTable, duration, length
from ..validate import solver_list
from .benchmark import wilson
from .targets import one_tip, sample_targets, stream_targets


class StudySizes(NamedTuple):
    """Sizes of a workspace study: cells of the map, and how much is kept in memory."""

    cells: int = 24  # number of cells along the longest side of the success map
    # number of random configurations from whose tip positions the size of the workspace is measured
    envelope: int = 100_000
    kept: int = 20_000  # number of targets kept in memory for plots; a file receives all of them
    failures: int = 1000  # number of failures kept in memory for each solver


SIZES = StudySizes()


@dataclass
class SolverCounts:
    """How many targets all over the workspace one solver solved, with iterations, errors and times."""

    solver: str  # name of the solver
    targets: int = 0  # number of targets
    solved: int = 0  # number of targets that the solver solved
    iterations: int = 0  # sum of the iterations of the solved targets
    worst: float = 0.0  # largest position error among the failures [m]
    elapsed: float = 0.0  # time of all solves together [s], without that of compiling
    statuses: dict[str, int] = field(default_factory=dict)  # number of targets that ended with each status

    @property
    def share(self) -> float:
        """Share of the targets that were solved."""
        return self.solved / max(self.targets, 1)

    def to_dict(self) -> dict[str, Any]:
        """Return the counts as plain numbers, with the 95 % Wilson interval of the share."""
        return {
            "targets": self.targets,
            "solved": self.solved,
            "share": self.share,
            "wilson_95": list(wilson(self.solved, self.targets)),
            "mean_iterations": self.iterations / self.solved if self.solved else None,
            "worst_error": self.worst,
            "elapsed": self.elapsed,
            "statuses": self.statuses,
        }


@dataclass(repr=False)
class Workspace(Tabled):
    """Result of `workspace`: the reach of the tip, and where in it solvers succeed."""

    robot: str  # name of the robot
    low: np.ndarray  # (3,) lower corner of the box around the reach [m], base frame
    high: np.ndarray  # (3,) upper corner of the box around the reach [m], base frame
    radius: tuple[float, float]  # least and largest distance of the tip from the base's origin [m]
    cell: float  # width of a cell of the map [m]; the first cell begins at `low`
    tip: str  # the tip whose reach is studied
    outcomes: dict[str, SolverCounts]  # counts of each solver, by its name
    map: dict[str, np.ndarray]  # numbers of targets and of solved targets in each cell (2, nx, ny, nz), by solver
    # target position x, y, z and position error left [m] of the first failures (M, 4), by solver
    failures: dict[str, np.ndarray]
    points: np.ndarray  # (N, 3) positions of the first targets [m], for plots
    solved: dict[str, np.ndarray]  # whether each target in `points` was solved (N,), by solver

    def table(self) -> TextTable:
        """Return successes, iterations, errors and times as a table, with a row for each solver."""
        rows = []
        for name, one in self.outcomes.items():
            low, high = wilson(one.solved, one.targets)
            share = f"{100 * one.share:.2f} % ({100 * low:.2f} to {100 * high:.2f})"
            steps, took = one.iterations / max(one.solved, 1), duration(one.elapsed / max(one.targets, 1))
            left = length(one.worst) if one.solved < one.targets else None
            rows.append((name, one.targets, share, steps, took, left))
        head = ("solver", "targets", "solved (95 %)", "mean iterations", "time of a target", "largest error left")
        reach = f"reaches {length(self.radius[0])} to {length(self.radius[1])} from the base's origin with {self.tip}"
        return TextTable(self.robot, reach, head, rows, "ik.plot(workspace, robot) draws where targets are missed.")

    def to_dict(self) -> dict[str, Any]:
        """Return the study as plain numbers, strings and lists, without the map and the points."""
        return {
            "robot": self.robot,
            "tip": self.tip,
            "low": self.low.tolist(),
            "high": self.high.tolist(),
            "radius": list(self.radius),
            "solvers": {name: one.to_dict() for name, one in self.outcomes.items()},
            "failures": {name: rows.tolist() for name, rows in self.failures.items()},
        }


class WorkspaceInterrupted(Interrupted):
    """Ctrl-C during a workspace study; `result` is the Workspace of the targets finished before it."""


def envelope(robot: Robot | Tree, *, tip: str | None = None) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
    """Return the reach of a tip: corners of its box (low, high) (3,) and least and largest distance from the base's origin [m].

    It is sampled at random configurations, so the true reach is a little larger.
    """
    points = sample_targets(robot, SIZES.envelope, position_only=True, tip=one_tip(robot, tip))
    away = np.linalg.norm(points, axis=1)
    return points.min(0), points.max(0), (float(away.min()), float(away.max()))


def workspace(
    robot: Robot | Tree,
    solvers: Any = GENERAL,
    *,
    tip: str | None = None,
    targets: int = 10_000,
    how: str = "joints",
    position_only: bool = True,
    seed: int = 0,
    q0: Any = None,
    file: str | Path | None = None,
    executor: Executor | None = None,
    progress: Callable[[int], None] | None = None,
    **options: Any,
) -> Workspace:
    """Solve random targets all over the workspace with one or several solvers.

    Args:
        robot: The robot.
        solvers: One or several names, classes or instances, or a mapping of labels to them.
        tip: The tip of a Tree whose reach is sampled; the others are free (and with avoid_collisions move out of the way).
        targets: Number of targets.
        how: How targets are drawn, 'joints' or 'volume', see `sample_targets`.
        position_only: Solve positions instead of poses.
        seed: Seed of the targets.
        q0: (n,) start [rad or m]. Default: each solver's own.
        file: A .csv file that receives every target as it is solved, so that millions need no more memory than a chunk. Its columns
            are x, y, z, then success, status, iterations, position_error, orientation_error of each solver. If the run ends early,
            the file is named NAME.partial.
        executor: Pool of processes (concurrent.futures) for the solves, as for `solve_batch`.
        progress: Called as progress(done) after each chunk of targets.
        **options: As for `solve_batch`; `check` is 0 if not given.

    Returns:
        The reach, and the counts and the map of each solver.

    Raises:
        InvalidOption: An option is unknown or out of range; all errors of `solve_batch` may be raised, too.
        WorkspaceInterrupted: Ctrl-C was pressed. It is a KeyboardInterrupt; its `result`, like the file, holds the finished chunks.
    """
    require_robot(robot)
    tip = one_tip(robot, tip)
    named = dict(solvers) if isinstance(solvers, Mapping) else _named(solver_list(solvers))
    if not named:
        raise InvalidOption("workspace needs at least one solver")
    seed = whole(seed, "seed", 0)
    options.setdefault("check", 0.0)
    check_progress(progress, "the number of targets done")
    file = None if file is None else as_output(file, "a table of targets", ".csv")
    tally = _Tally(robot, tip, list(named))
    table = _Table(file, list(named))
    interrupted = finished = False
    try:
        for part in stream_targets(robot, targets, seed, how=how, position_only=position_only, tip=tip):
            asked = {tip: part}
            xyz = part if part.ndim == 2 else part[:, :3, 3]
            columns, seconds = [], []
            for solver in named.values():
                begun = time.perf_counter()
                parts = list(solve_parts(robot, asked, solver, q0=q0, executor=executor, **options))
                seconds.append(time.perf_counter() - begun - compile_time(begun, everywhere=True))
                part = {
                    key: np.concatenate([getattr(one, key) for one in parts])
                    for key in ("success", "status", "iterations", "position_error")
                }
                angle = [one.orientation_error for one in parts if one.orientation_error is not None]
                part["orientation_error"] = np.concatenate(angle) if angle else np.full(len(xyz), np.nan)
                columns.append(part)
            # The lines for the file are made first because that is slow. Writing and counting a chunk then follow each other so
            # closely that Ctrl-C hardly ever comes between them.
            lines = table.lines(xyz, columns)
            table.write(lines)
            tally.add(xyz, columns, seconds)
            if progress is not None:
                progress(tally.done)
        finished = True
    except KeyboardInterrupt:
        if not tally.done:
            raise
        interrupted = True
    finally:
        table.close(finished)
    found = tally.result()
    if interrupted:
        raise WorkspaceInterrupted(found, f"after {tally.done} targets")
    return found


class _Tally:
    """The totals of a workspace study over the chunks so far."""

    def __init__(self, robot: Robot | Tree, tip: str, names: list[str]) -> None:
        self.robot, self.tip = robot.name, tip
        self.low, self.high, self.radius = envelope(robot, tip=tip)
        self.cell = float(max((self.high - self.low).max() / SIZES.cells, 1e-9))
        self.shape = np.maximum(np.ceil((self.high - self.low) / self.cell), 1).astype(int)
        self.outcomes = {name: SolverCounts(name) for name in names}
        self.maps = {name: np.zeros((2, *self.shape), np.int64) for name in names}
        self.failures: dict[str, list[np.ndarray]] = {name: [] for name in names}
        self.points: list[np.ndarray] = []
        self.solved: dict[str, list[np.ndarray]] = {name: [] for name in names}
        self.kept = self.done = 0

    def add(self, xyz: np.ndarray, columns: list[dict[str, np.ndarray]], seconds: list[float]) -> None:
        """Add a chunk of targets to the counts: positions (m, 3) [m], and the results and times [s] of each solver."""
        index = np.clip(((xyz - self.low) / self.cell).astype(int), 0, self.shape - 1)
        for name, part, elapsed in zip(self.outcomes, columns, seconds, strict=True):
            self.outcomes[name].elapsed += elapsed
            _count(self.outcomes[name], part)
            np.add.at(self.maps[name][0], tuple(index.T), 1)
            np.add.at(self.maps[name][1], tuple(index.T), part["success"])
            bad = ~part["success"]
            if bad.any() and sum(map(len, self.failures[name])) < SIZES.failures:
                self.failures[name].append(np.column_stack([xyz[bad], part["position_error"][bad]]))
            if self.kept < SIZES.kept:
                self.solved[name].append(part["success"])
        if self.kept < SIZES.kept:
            self.points.append(xyz.copy())
            self.kept += len(xyz)
        self.done += len(xyz)

    def result(self) -> Workspace:
        """Return the result of the chunks counted so far."""
        return Workspace(
            robot=self.robot,
            low=self.low,
            high=self.high,
            radius=self.radius,
            cell=self.cell,
            tip=self.tip,
            outcomes=self.outcomes,
            map=self.maps,
            failures={
                name: np.concatenate([np.empty((0, 4)), *rows])[: SIZES.failures]
                for name, rows in self.failures.items()
            },
            points=np.concatenate(self.points),
            solved={name: np.concatenate(rows) for name, rows in self.solved.items()},
        )


def _named(solvers: list[Any]) -> dict[str, Any]:
    """Give each solver a name of its own."""
    named: dict[str, Any] = {}
    for solver in solvers:
        name = base = "auto" if is_auto(solver) else find_row(solver).name
        k = 2
        while name in named:
            name, k = f"{base} {k}", k + 1
        named[name] = solver
    return named


def _count(outcome: SolverCounts, part: dict[str, np.ndarray]) -> None:
    good = part["success"]
    outcome.targets += len(good)
    outcome.solved += int(good.sum())
    outcome.iterations += int(part["iterations"][good].sum())
    if not good.all():
        outcome.worst = max(outcome.worst, float(part["position_error"][~good].max()))
    for name, count in count_statuses(part["status"]).items():
        outcome.statuses[name] = outcome.statuses.get(name, 0) + count


class _Table:
    """The CSV file of all targets; without a file it writes nothing."""

    FIELDS = ("success", "status", "iterations", "position_error", "orientation_error")

    def __init__(self, file: Path | None, names: list[str]) -> None:
        self.out, self.head = None, []
        if file is not None:
            self.out = WholeFile(file)
            self.head = ["x", "y", "z", *(f"{name} {key}" for name in names for key in self.FIELDS)]

    def lines(self, xyz: np.ndarray, columns: list[dict[str, np.ndarray]]) -> str:
        if self.out is None:
            return ""
        lists = [(part[key] + 0 if key == "success" else part[key]).tolist() for part in columns for key in self.FIELDS]
        text = io.StringIO()
        # The header is written with the first targets, because a file with only a header is useless.
        if self.head:
            csv.writer(text).writerow(map(inert, self.head))
            self.head = []
        csv.writer(text).writerows(zip(*xyz.T.tolist(), *lists, strict=True))
        return text.getvalue()

    def write(self, lines: str) -> None:
        if self.out is not None:
            self.out.write(lines)

    def close(self, whole: bool) -> None:
        """Give the file of targets its final name if all are in it, otherwise the name NAME.partial."""
        if self.out is None:
            return
        if whole:
            self.out.finish()
        else:
            self.out.keep(PARTIAL)
