"""Workspace study: the tip's reach, and where in it solvers succeed, how fast and how accurately."""

import csv
import io
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption, Portable, check_progress, whole
from ..files import PARTIAL, WholeFile, as_path, inert
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.batch.solve_batch import solve_parts
from ..solvers.registry import GENERAL, find_row
from ..solvers.solve import is_auto, require_robot
from ..solvers.status import count_statuses
from ..validate import solver_list
from .statistics import wilson
from .targets import one_tip, sample_targets, stream_targets

GRID = 24  # cells along the longest side of the success map
ENVELOPE = 100_000  # random configurations that give the envelope
KEEP = 20_000  # targets kept in memory for plots; with a file all of them are on disk
FAILURES = 1000  # failures kept in memory


@dataclass
class SolverCounts:
    """Counts of one solver over the workspace; iterations: sum over solved targets; worst: largest error among failures [m]."""

    solver: str
    targets: int = 0
    solved: int = 0
    iterations: int = 0
    worst: float = 0.0
    elapsed: float = 0.0
    statuses: dict[str, int] = field(default_factory=dict)

    @property
    def share(self) -> float:
        """Success rate."""
        return self.solved / max(self.targets, 1)

    def to_dict(self) -> dict[str, Any]:
        """Plain values with the Wilson interval."""
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


@dataclass
class Workspace:
    """Result of `workspace`.

    tip: the tip whose reach is studied. low, high (3,) [m]: bounding box of the reach in the base frame; radius (nearest,
    farthest) [m] of the tip from the base origin. outcomes: by solver. map: by solver, (2, nx, ny, nz) targets and successes per
    cell, cells starting at `low`, `cell` [m] wide.
    failures: by solver, rows (x, y, z, error) of the first failures [m]. points (N, 3), solved: by solver (N,), for plots.
    """

    robot: str
    low: np.ndarray
    high: np.ndarray
    radius: tuple[float, float]
    cell: float
    tip: str
    outcomes: dict[str, SolverCounts]
    map: dict[str, np.ndarray]
    failures: dict[str, np.ndarray]
    points: np.ndarray
    solved: dict[str, np.ndarray]

    def to_dict(self) -> dict[str, Any]:
        """Plain values, without the map and the points."""
        return {
            "robot": self.robot,
            "tip": self.tip,
            "low": self.low.tolist(),
            "high": self.high.tolist(),
            "radius": list(self.radius),
            "solvers": {name: one.to_dict() for name, one in self.outcomes.items()},
            "failures": {name: rows.tolist() for name, rows in self.failures.items()},
        }


class WorkspaceInterrupted(Portable, KeyboardInterrupt):
    """Ctrl-C during a workspace study; `result` is the Workspace of the targets finished before it."""

    def __init__(self, result: Workspace) -> None:
        """Keep what was finished."""
        super().__init__(f"interrupted after {next(iter(result.outcomes.values())).targets} targets")
        self.result = result


def envelope(
    robot: Robot | Tree, count: int = ENVELOPE, seed: int = 0, *, tip: str | None = None
) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
    """Box (low, high) and nearest and farthest distance [m] from the base origin of the sampled tip: inner bounds of the reach."""
    points = sample_targets(robot, count, seed, position_only=True, tip=one_tip(robot, tip))
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
    """Solve targets over the workspace with each solver.

    tip: for a Tree, the tip whose reach is sampled; the others are free (and with avoid_collisions move out of the way).
    solvers: one or several names, classes or instances, or a mapping of labels to them. how: 'joints' or 'volume', see
    `sample_targets`. file: a .csv that receives every target as it is solved (x, y, z, then success, status, iterations,
    position_error, orientation_error per solver), so that millions of targets need no more memory than a chunk; if the run
    ends early it is named NAME.partial. executor: as for `solve_batch`. options: as for `solve`. Targets depend only on
    (seed, chunk). Ctrl-C raises WorkspaceInterrupted, a KeyboardInterrupt whose `result` (like the file) holds the finished
    chunks. Raises InvalidOption and the errors of `solve_batch`.
    """
    require_robot(robot)
    tip = one_tip(robot, tip)
    named = dict(solvers) if isinstance(solvers, Mapping) else _named(solver_list(solvers))
    if not named:
        raise InvalidOption("workspace needs at least one solver")
    seed = whole(seed, "seed", 0)
    check_progress(progress, "the number of targets done")
    file = None if file is None else as_path(file, "file")
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
                parts = list(solve_parts(robot, asked, solver, q0=q0, executor=executor, check=0.0, **options))
                seconds.append(time.perf_counter() - begun)
                part = {
                    key: np.concatenate([getattr(one, key) for one in parts])
                    for key in ("success", "status", "iterations", "position_error")
                }
                angle = [one.orientation_error for one in parts if one.orientation_error is not None]
                part["orientation_error"] = np.concatenate(angle) if angle else np.full(len(xyz), np.nan)
                columns.append(part)
            # Done first because it is slow: Ctrl-C then comes before or after the chunk is counted, hardly ever in between.
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
        raise WorkspaceInterrupted(found)
    return found


class _Tally:
    """Running totals of a Workspace over the chunks so far."""

    def __init__(self, robot: Robot | Tree, tip: str, names: list[str]) -> None:
        self.robot, self.tip = robot.name, tip
        self.low, self.high, self.radius = envelope(robot, tip=tip)
        self.cell = float(max((self.high - self.low).max() / GRID, 1e-9))
        self.shape = np.maximum(np.ceil((self.high - self.low) / self.cell), 1).astype(int)
        self.outcomes = {name: SolverCounts(name) for name in names}
        self.maps = {name: np.zeros((2, *self.shape), np.int64) for name in names}
        self.failures: dict[str, list[np.ndarray]] = {name: [] for name in names}
        self.points: list[np.ndarray] = []
        self.solved: dict[str, list[np.ndarray]] = {name: [] for name in names}
        self.kept = self.done = 0

    def add(self, xyz: np.ndarray, columns: list[dict[str, np.ndarray]], seconds: list[float]) -> None:
        """Count a chunk: target positions (m, 3), each solver's results and its time."""
        index = np.clip(((xyz - self.low) / self.cell).astype(int), 0, self.shape - 1)
        for name, part, elapsed in zip(self.outcomes, columns, seconds, strict=True):
            self.outcomes[name].elapsed += elapsed
            _count(self.outcomes[name], part)
            np.add.at(self.maps[name][0], tuple(index.T), 1)
            np.add.at(self.maps[name][1], tuple(index.T), part["success"])
            bad = ~part["success"]
            if bad.any() and sum(map(len, self.failures[name])) < FAILURES:
                self.failures[name].append(np.column_stack([xyz[bad], part["position_error"][bad]]))
            if self.kept < KEEP:
                self.solved[name].append(part["success"])
        if self.kept < KEEP:
            self.points.append(xyz.copy())
            self.kept += len(xyz)
        self.done += len(xyz)

    def result(self) -> Workspace:
        """The Workspace of the chunks counted so far."""
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
                name: np.concatenate([np.empty((0, 4)), *rows])[:FAILURES] for name, rows in self.failures.items()
            },
            points=np.concatenate(self.points),
            solved={name: np.concatenate(rows) for name, rows in self.solved.items()},
        )


def _named(solvers: list[Any]) -> dict[str, Any]:
    """Solvers under a distinct name each."""
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
    """CSV file of all targets; writes nothing without a file."""

    FIELDS = ("success", "status", "iterations", "position_error", "orientation_error")

    def __init__(self, file: Path | None, names: list[str]) -> None:
        self.out, self.head = None, []
        if file is not None:
            if file.suffix.lower() != ".csv":
                raise InvalidOption(f"targets are written as .csv, not '{file.name}'")
            self.out = WholeFile(file)
            self.head = ["x", "y", "z", *(f"{name} {key}" for name in names for key in self.FIELDS)]

    def lines(self, xyz: np.ndarray, columns: list[dict[str, np.ndarray]]) -> str:
        if self.out is None:
            return ""
        lists = [(part[key] + 0 if key == "success" else part[key]).tolist() for part in columns for key in self.FIELDS]
        text = io.StringIO()
        if self.head:  # written with the first targets: a file with only a header is not worth keeping
            csv.writer(text).writerow(map(inert, self.head))
            self.head = []
        csv.writer(text).writerows(zip(*xyz.T.tolist(), *lists, strict=True))
        return text.getvalue()

    def write(self, lines: str) -> None:
        if self.out is not None:
            self.out.write(lines)

    def close(self, whole: bool) -> None:
        """Give the file its final name, or keep the finished targets as NAME.partial."""
        if self.out is None:
            return
        if whole:
            self.out.finish()
        else:
            self.out.keep(PARTIAL)
