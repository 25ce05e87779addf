"""Many targets at once: compiled, on all cores, in parts, with the same bytes for any number of threads or workers."""

import math
import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import closing
from itertools import chain as joined
from typing import Any, Unpack

import numpy as np

from ...errors import InvalidConfiguration, InvalidOption, check_progress, floats, whole
from ...kernel.checks import CHECK_FAILED
from ...kernel.counted_error import POSE
from ...kernel.records import ANSWER, AT
from ...robot.robot import Robot
from ...robot.tree import Tree
from ..options import BatchOptions
from ..plan import Plan
from ..solve import Solver, require_robot
from .parts import Job, Tables, check_executor, on_executor, on_threads
from .result import BatchCheckFailed, BatchInterrupted, BatchResult
from .targets import Block, blocks, freed, known

PART, REMOTE_PART = 2048, 4096  # most rows handed to a thread, and rows handed to a worker of an executor
LEAST_PART = 128  # smaller batches are shared out evenly over the threads, but not in smaller parts than this


def solve_parts(
    robot: Robot | Tree,
    targets: Any,
    solver: Any = "auto",
    *,
    q0: Any = None,
    threads: int | None = None,
    executor: Executor | None = None,
    check: float = 0.01,
    **options: Unpack[BatchOptions],
) -> Iterator[BatchResult]:
    """Solve as `solve_batch` does and yield the answers part by part, in order: for more targets than fit in memory.

    An array is read as parts are taken, so do not change it before; arrays from an iterator may be reused at once.
    Raises BatchCheckFailed at the part with an answer that Pinocchio does not confirm; its `result` is that part.
    """
    require_robot(robot)
    if "chain" in options:
        raise InvalidOption("chain= has been removed; ik.solve_path(robot, poses) follows poses in one joint motion")
    if executor is not None and threads is not None:
        raise InvalidOption("an executor has its own workers; omit threads=")
    check_executor(executor)
    if options.get("history"):
        raise InvalidOption("a batch keeps no history; solve the target in question with ik.solve")
    if options.get("timeout") is not None:
        raise InvalidOption("a batch is deterministic, so it takes no timeout; use max_evaluations")
    count = whole(threads, "threads") if threads is not None else available_cores()
    if not isinstance(check, int | float | np.floating) or not 0.0 <= check <= 1.0:
        raise InvalidOption(f"check must be the fraction of results to verify, 0 to 1, not {check!r}")
    targets, options = freed(robot, targets, options)
    given = known(targets, robot.base)
    total = None if given is None else _length(given)
    chunks = blocks(iter([given]) if given is not None else targets, robot)
    first = next(chunks, None)
    starts = _checked_starts(robot, q0, total)
    local = Solver(robot, solver, **options)
    if first is None:
        return iter(())
    plan = local.plan_for(first.kinds)
    plan.orders(first.kinds, starts is not None)  # a solver that cannot do it is refused here
    size = PART if executor is None else REMOTE_PART
    if executor is None and total is not None:
        size = min(size, max(LEAST_PART, math.ceil(total / count)))
    jobs = _jobs(joined([first], chunks), starts, size)
    if executor is not None:
        tables = on_executor(plan, jobs, check, executor)
    else:
        tables = on_threads(plan, jobs, check, count)
    return _wrapped(tables, first.kinds, plan)


def _length(targets: Any) -> int:
    """Number of targets of an array, or of a dict of arrays by tip."""
    return len(next(iter(targets.values()), ())) if isinstance(targets, Mapping) else len(targets)


def _checked_starts(robot: Robot | Tree, q0: Any, rows: int | None) -> np.ndarray | None:
    """Starts (n,) or (rows, n), any number of rows where that is None. Raises InvalidConfiguration."""
    if q0 is None:
        return None
    n = robot.n
    if not isinstance(q0, np.ndarray | list | tuple):
        return robot.read_q(q0, "q0")[0]
    starts = floats(q0, "q0 must be numbers", InvalidConfiguration)
    if starts.shape not in ((n,), (len(starts) if rows is None else rows, n)):
        wanted = f"({n},)" if rows == 1 else f"({n},) or ({'N' if rows is None else rows}, {n})"
        raise InvalidConfiguration(f"q0 of this batch has the shape {wanted}, not {starts.shape}")
    return starts


def _wrapped(tables: Tables, kinds: tuple, plan: Plan) -> Iterator[BatchResult]:
    """Parts as results; the first with an answer that Pinocchio does not confirm ends the batch."""
    done = 0
    with closing(tables):
        for table in tables:
            part = BatchResult(table, kinds, plan)
            failed = np.flatnonzero(table[:, AT.status] == CHECK_FAILED)
            if len(failed):
                table[:, AT.status] = CHECK_FAILED
                raise BatchCheckFailed(part, done + int(failed[0]), done)
            done += len(table)
            yield part


def _jobs(chunks: Iterator[Block], starts: np.ndarray | None, size: int) -> Iterator[Job]:
    each = starts is not None and starts.ndim == 2 and len(starts) > 1
    first = 0
    for chunk in chunks:
        for a in range(0, chunk.rows, size):
            T = chunk.poses(a, a + size)  # copies: a buffer may be refilled while this waits
            if starts is None:
                q0 = None
            elif not each:
                q0 = starts.reshape(1, -1)
            else:
                q0 = starts[first : first + len(T)]
                if len(q0) < len(T):
                    raise InvalidConfiguration(f"q0 has {len(starts)} rows, fewer than there are targets")
            yield Job(T, chunk.kinds, q0, first)
            first += len(T)


def available_cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def solve_batch(
    robot: Robot | Tree,
    targets: Any,
    solver: Any = "auto",
    *,
    q0: Any = None,
    threads: int | None = None,
    executor: Executor | None = None,
    check: float = 0.01,
    progress: Callable[[int], None] | None = None,
    **options: Unpack[BatchOptions],
) -> BatchResult:
    """Solve many targets on all cores.

    targets: (N, 4, 4) poses or (N, 3) positions [m], a list of poses, or an iterator of arrays of these shapes; for a Tree of
    F tips (N, F, 4, 4), (N, F, 3), or a dict by tip of (N, 4, 4) or (N, 3), where a tip left out is free. q0: None (home and
    the table of starts), (n,) for all, or (N, n). threads: default all cores. executor: anything with the concurrent.futures
    interface (a process pool, a Dask client's `get_executor()`) instead of threads. check: fraction of the results to verify
    with Pinocchio. progress(done) is called as parts finish. Options and parameters as for `solve`. Limits, tolerances and
    statuses mean the same as in `solve`. A row may hold another solution than `solve` finds for that target; a q0 per row
    selects the one to search near. A row depends only on its own target and q0: the result is identical to the last byte for
    any number of threads, chunks or workers (on one CPU model). Ctrl-C raises BatchInterrupted, a KeyboardInterrupt whose
    `result` holds the targets finished. Raises BatchCheckFailed when Pinocchio does not confirm a result (its `result` has
    every row, none of them a success), InvalidTarget and InvalidConfiguration (naming the target), UnknownSolver and
    InvalidOption.
    """
    check_progress(progress, "the number of targets done")
    require_robot(robot)
    targets, options = freed(robot, targets, options)
    given = known(targets, robot.base)
    parts = solve_parts(
        robot,
        targets if given is None else given,
        solver,
        q0=q0,
        threads=threads,
        executor=executor,
        check=check,
        **options,
    )
    total = None if given is None else _length(given)
    table, done, part = np.empty((0, 0)), 0, None
    try:
        for part in parts:
            end = done + len(part)
            if end > len(table):  # in place: no second copy
                size = total if total is not None else max(end, len(table) + len(table) // 4)
                table.resize((size, part.table.shape[1]), refcheck=False)
            table[done:end] = part.table
            done = end
            if progress is not None:
                progress(done)
    except KeyboardInterrupt:
        if part is None:
            raise
        raise BatchInterrupted(part.of(table[:done])) from None
    except BatchCheckFailed as failure:  # rows up to the one that failed, and nothing of those after it, solved or not
        part, end = failure.result, failure.target + 1
        table.resize((total if total is not None else done + len(part), part.table.shape[1]), refcheck=False)
        table[done:end] = part.table[: end - done]
        table[end:] = 0.0
        table[end:, [AT.position, AT.rotation, *range(ANSWER, table.shape[1])]] = np.nan
        table[:, AT.status] = CHECK_FAILED
        raise BatchCheckFailed(part.of(table), failure.target, 0) from None
    if part is None:
        solver = Solver(robot, solver, **options)
        kinds = next(
            (block.kinds for block in blocks(iter([] if given is None else [given]), robot)), (POSE,) * len(robot.tips)
        )
        plan = solver.plan_for(kinds)
        return BatchResult(np.empty((0, plan.width)), kinds, plan)
    table.resize((done, table.shape[1]), refcheck=False)
    return part.of(table)
