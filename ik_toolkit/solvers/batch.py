"""Many targets at once: compiled, on all cores, in chunks, with the same bytes for any number of threads."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any

import numpy as np

from ..errors import InvalidConfiguration, InvalidOption, InvalidTarget
from ..kernel.checks import BAD_TARGET
from ..kernel.loop import OUT_HEAD
from ..kernel.task import POSE, POSITION
from ..robot.pose import check_target
from ..robot.robot import Robot
from .result import Status
from .solve import Solver, bound

CHUNK = 2048


class BatchResult:
    """Answers of a batch, row k belonging to target k.

    q (N, n) [rad or m]; status (N,) numbers of Status; success (N,) bool; position_error (N,) [m]; orientation_error (N,)
    [rad], None for positions; iterations, restarts, fk_evaluations (N,).
    """

    def __init__(self, table: np.ndarray, position_only: bool, solver: str) -> None:
        """Wrap the kernel's rows (N, 8 + n)."""
        self._table = table
        self.position_only = position_only
        self.solver = solver

    def __len__(self) -> int:
        """Number of targets."""
        return len(self._table)

    q = property(lambda self: self._table[:, OUT_HEAD:])
    status = property(lambda self: self._table[:, 0].astype(np.int64))
    success = property(lambda self: self._table[:, 0] == Status.CONVERGED)
    position_error = property(lambda self: self._table[:, 3])
    orientation_error = property(lambda self: None if self.position_only else self._table[:, 4])
    iterations = property(lambda self: self._table[:, 1].astype(np.int64))
    restarts = property(lambda self: self._table[:, 2].astype(np.int64))
    fk_evaluations = property(lambda self: self._table[:, 5].astype(np.int64))

    def counts(self) -> dict[str, int]:
        """How many targets ended with each status."""
        numbers, counts = np.unique(self.status, return_counts=True)
        return {Status(int(k)).name: int(c) for k, c in zip(numbers, counts, strict=True)}

    def to_dict(self) -> dict[str, Any]:
        """Arrays by name, for np.savez and tables."""
        names = (
            "q",
            "status",
            "success",
            "position_error",
            "orientation_error",
            "iterations",
            "restarts",
            "fk_evaluations",
        )
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}

    def __repr__(self) -> str:
        """One line."""
        return f"BatchResult({len(self)} targets, {int(self.success.sum())} solved, solver='{self.solver}', {self.counts()})"


def _chunks(targets: Any) -> Iterator[np.ndarray]:
    """Targets as arrays of (m, 4, 4) or (m, 3), from one array or an iterable of such arrays."""
    if isinstance(targets, np.ndarray):
        targets = [targets]
    elif not isinstance(targets, Iterator):
        try:
            targets = [np.asarray(targets, dtype=float)]
        except (TypeError, ValueError):
            raise InvalidTarget("targets are an array (N, 4, 4) or (N, 3), or an iterator of such arrays") from None
    for part in targets:
        part = np.asarray(part, dtype=float)
        if part.shape[1:] not in ((4, 4), (3,)):
            raise InvalidTarget(f"targets are (N, 4, 4) poses or (N, 3) positions, not an array of shape {part.shape}")
        yield part


def _solve_part(solver: Solver, part: np.ndarray, q0: np.ndarray | None, first: int) -> np.ndarray:
    """Rows (m, 8 + n) of one part; `first` is its offset in the batch, for messages."""
    kind = POSE if part.ndim == 3 else POSITION
    if kind == POSE:
        T = np.array(part, dtype=float, order="C")
    else:
        if not np.isfinite(part).all():
            bad = int(np.flatnonzero(~np.isfinite(part).all(axis=1))[0])
            raise InvalidTarget(f"target {first + bad} is not finite")
        T = np.tile(np.eye(4), (len(part), 1, 1))
        T[:, :3, 3] = part
    out = np.empty((len(T), OUT_HEAD + solver.robot.n))
    start = solver._home if q0 is None else np.array(np.atleast_2d(q0), dtype=float, order="C")
    solver._kernel(*solver._chain, T, start, out, solver.pack(kind, q0 is not None), solver._silent)
    for k in np.flatnonzero(out[:, 0] == BAD_TARGET):
        try:
            T[k] = check_target(T[k])[0]
        except InvalidTarget as error:
            raise InvalidTarget(f"target {first + k}: {error}") from None
        one = start if len(start) == 1 else start[k : k + 1]
        solver._kernel(
            *solver._chain, T[k : k + 1], one, out[k : k + 1], solver.pack(kind, q0 is not None), solver._silent
        )
    return out


def _solve_remote(
    robot: Robot, solver: Any, options: dict[str, Any], part: np.ndarray, q0: Any, first: int
) -> np.ndarray:
    """What a worker process or machine runs."""
    return _solve_part(bound(robot, solver, options), part, q0, first)


def solve_batch(
    robot: Robot,
    targets: Any,
    solver: Any = "lm",
    *,
    q0: Any = None,
    threads: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[int], None] | None = None,
    **options: Any,
) -> BatchResult:
    """Solve many targets on all cores.

    targets: (N, 4, 4) poses or (N, 3) positions [m], or an iterator of such arrays. q0: None (home and seed table), (n,) for
    all, or (N, n). threads: default all cores. executor: anything with the concurrent.futures interface (a process pool, a
    Dask client's) instead of threads. progress(done) is called as parts finish. Options and parameters as for `solve`. Each
    target is solved as if alone, so the answers do not depend on threads or order. Raises InvalidTarget (naming the row).
    """
    if threads is not None and (isinstance(threads, bool) or int(threads) != threads or threads < 1):
        raise InvalidOption(f"threads must be a whole number of at least 1, not {threads!r}")
    if not isinstance(robot, Robot):
        raise InvalidOption(
            f"solve_batch takes a robot with one tip, not a {type(robot).__name__}; call a bound Solver in a loop"
        )
    local = Solver(robot, solver, **options)
    starts = None
    if q0 is not None:
        starts = np.asarray(q0, dtype=float)
        if starts.shape[-1:] != (robot.n,) or starts.ndim > 2 or not np.isfinite(starts).all():
            raise InvalidConfiguration(
                f"q0 of a batch is ({robot.n},) or (N, {robot.n}) finite numbers, not shape {starts.shape}"
            )
        if local.options.limits:
            if local.options.q0_outside == "refuse" and ((starts < robot.lower) | (starts > robot.upper)).any():
                raise InvalidConfiguration("q0 is outside the limits in at least one row")
            starts = np.clip(starts, robot.lower, robot.upper)
    kinds = set()

    def jobs() -> Iterator[tuple[np.ndarray, np.ndarray | None, int]]:
        first = 0
        for chunk in _chunks(targets):
            kinds.add(chunk.ndim)
            if len(kinds) > 1:
                raise InvalidTarget("a batch is all poses or all positions, not both")
            if starts is not None and starts.ndim == 2 and first + len(chunk) > len(starts):
                raise InvalidConfiguration(f"q0 has {len(starts)} rows, fewer than there are targets")
            for a in range(0, len(chunk), CHUNK):
                b = min(a + CHUNK, len(chunk))
                yield (
                    chunk[a:b],
                    starts[first + a : first + b] if starts is not None and starts.ndim == 2 else starts,
                    first + a,
                )
            first += len(chunk)

    tables: list[np.ndarray] = []
    done = 0

    def collect(table: np.ndarray) -> None:
        nonlocal done
        tables.append(table)
        done += len(table)
        if progress is not None:
            progress(done)

    if executor is not None:
        futures = [executor.submit(_solve_remote, robot, solver, options, *job) for job in jobs()]
        for future in futures:
            collect(future.result())
    else:
        count = threads or os.cpu_count() or 1
        # Parts are handed out a few at a time, so that an iterator of targets is never held in memory as a whole.
        with ThreadPoolExecutor(count) as pool:
            waiting = []
            for job in jobs():
                waiting.append(pool.submit(_solve_part, local, *job))
                if len(waiting) >= 4 * count:
                    collect(waiting.pop(0).result())
            for future in waiting:
                collect(future.result())
    table = np.concatenate(tables) if tables else np.empty((0, OUT_HEAD + robot.n))
    return BatchResult(table, kinds == {2}, local.name)
