"""Solves many targets at once, compiled and on all cores; any number of threads or workers gives the same result to the byte."""

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from itertools import chain as joined
from typing import Any, Unpack

import numpy as np

from ...errors import InvalidConfiguration, InvalidOption, check_progress, floats, whole
from ...kernel.checks import CODE
from ...kernel.counted_error import KIND
from ...kernel.records import AT, SIZE
from ...robot.robot import Robot
from ...robot.tree import Tree
from ...text import how_many
from ...validate import switch
from ..options import BatchOptions
from ..plan import Plan
from ..solve import bound_solver, require_robot
from .parts import Part, Tables, check_executor, on_executor, on_threads
from .result import BatchCheckFailed, BatchInterrupted, BatchResult, joined_failures
from .targets import Block, blocks, doubt_far, known, with_free_turns

PART, REMOTE_PART = 2048, 4096  # largest number of targets given to a thread at a time, and to a worker of an executor
LEAST_PART = 128  # A small batch is divided between threads into parts of at least this many targets.


def solve_parts(
    robot: Robot | Tree,
    targets: Any,
    solver: Any = "auto",
    *,
    q0: Any = None,
    threads: int | None = None,
    executor: Executor | None = None,
    check: float = 0.01,
    finish: bool = True,
    **options: Unpack[BatchOptions],
) -> Iterator[BatchResult]:
    """Solve a batch and yield the BatchResults of its parts in order, for more targets than fit in memory.

    With `finish`, the q of a failure is moved to the configuration closest to its target, which takes longer than a few attempts,
    and LIMIT_BLOCKED is tested. Without `finish`, q is where the search ended, and LIMIT_BLOCKED only means that a joint was at a
    limit. An array of targets is read part by part, so it must not change until the last part is taken; arrays from an iterator are
    copied. Raises BatchCheckFailed at the part with an answer that Pinocchio does not confirm; its `result` is that part.
    """
    begun = _begin(robot, targets, solver, q0, threads, executor, check, finish, options)
    return _wrapped(*begun[1:])


def _begin(
    robot: Robot | Tree,
    targets: Any,
    solver: Any,
    q0: Any,
    threads: int | None,
    executor: Executor | None,
    check: float,
    finish: bool,
    options: Any,
) -> tuple[int | None, Tables, tuple, Plan, str]:
    """Read the arguments of a batch and return the number of targets, if it is known, and the arguments of `_wrapped`."""
    require_robot(robot)
    if "chain" in options:
        raise InvalidOption("chain= has been removed; ik.solve_path(robot, poses) follows poses in one joint motion")
    if executor is not None and threads is not None:
        raise InvalidOption("an executor has its own workers; omit threads=")
    check_executor(executor)
    if switch(options.get("history", False), "history"):
        raise InvalidOption("a batch keeps no history; solve the target in question with ik.solve")
    if options.get("timeout") is not None:
        raise InvalidOption("a batch is deterministic, so it takes no timeout; use max_evaluations")
    count = whole(threads, "threads") if threads is not None else available_cores()
    if not isinstance(check, int | float | np.floating) or not 0.0 <= check <= 1.0:
        raise InvalidOption(f"check must be the fraction of results to verify, 0 to 1, not {check!r}")
    targets, options = with_free_turns(robot, targets, options)
    given = known(targets, robot.base)
    chunks = blocks(iter([given]) if given is not None else targets, robot)
    # `known` raises InvalidTarget for targets that cannot be read, so from here on they can be counted.
    first = next(chunks, None)
    total = None if given is None else _length(given)
    starts, notice = _read_starts(robot, q0, total)
    kinds = (KIND.pose,) * len(robot.tips) if first is None else first.kinds
    plan = bound_solver(robot, solver, options).plan_for(kinds)
    if first is None:
        return total, (none for none in ()), kinds, plan, notice
    if starts is not None:
        starts, clamped = plan.check_starts(starts)
        notice = "; ".join(filter(None, (notice, clamped)))
    # called only to raise InvalidOption, before any target is solved, if the solver cannot do the task
    plan.orders(kinds, starts is not None)
    if not finish:
        plan = plan.stripped()
    size = PART if executor is None else REMOTE_PART
    if executor is None and total is not None:
        size = min(size, max(LEAST_PART, math.ceil(total / count)))
    parts = _parts(plan, joined([first], chunks), starts, size)
    tables = on_threads(plan, parts, check, count) if executor is None else on_executor(plan, parts, check, executor)
    return total, tables, kinds, plan, notice


def _length(targets: Any) -> int:
    """Return the number of targets in an array, or in a dict of arrays by tip."""
    return len(next(iter(targets.values()), ())) if isinstance(targets, Mapping) else len(targets)


def _read_starts(robot: Robot | Tree, q0: Any, rows: int | None) -> tuple[np.ndarray | None, str]:
    """Return the starts q0 as (1 or rows, n), and a notice; if `rows` is None, any number is valid. Raises InvalidConfiguration."""
    if q0 is None:
        return None, ""
    n, notice = robot.n, ""
    if not isinstance(q0, np.ndarray | list | tuple):
        q, notice = robot.read_q(q0, "q0")
        return q[None], notice
    if not isinstance(q0, np.ndarray) and any(
        not np.isscalar(row) and not isinstance(row, Sequence | np.ndarray) for row in q0
    ):
        # each start may be a dict by joint or a JointState
        read = [robot.read_q(row, f"q0 of target {k}") for k, row in enumerate(q0)]
        q0, notice = [q for q, _ in read], next((note for _, note in read if note), "")
    starts = floats(q0, "q0 must be numbers", InvalidConfiguration)
    if starts.shape not in ((n,), (len(starts) if rows is None else rows, n)):
        wanted = f"({n},)" if rows == 1 else f"({n},) or ({'N' if rows is None else rows}, {n})"
        raise InvalidConfiguration(f"q0 of this batch has the shape {wanted}, not {starts.shape}")
    return starts.reshape(-1, n), notice


def _wrapped(tables: Tables, kinds: tuple, plan: Plan, notice: str) -> Iterator[BatchResult]:
    """Yield each part as a BatchResult; raise BatchCheckFailed at the first with an answer that Pinocchio does not confirm."""
    done = 0
    with closing(tables):
        for table, failures in tables:
            part = BatchResult(table, kinds, plan, failures, notice)
            failed = np.flatnonzero(table[:, AT.status] == CODE.check_failed)
            if len(failed):
                table[:, AT.status] = CODE.check_failed
                raise BatchCheckFailed(part, done + int(failed[0]), done)
            done += len(table)
            yield part


def _parts(plan: Plan, chunks: Iterator[Block], starts: np.ndarray | None, size: int) -> Iterator[Part]:
    first = 0
    for chunk in chunks:
        for a in range(0, chunk.rows, size):
            # The arrays of an iterator are copied, because the caller may refill the same array while earlier targets wait to be
            # solved.
            T = chunk.poses(a, a + size)
            doubt_far(plan.robot, T)
            start = plan.home if starts is None else starts
            if len(start) != 1 and len(start) < first + len(T):
                raise InvalidConfiguration(f"q0 has {len(start)} rows, fewer than there are targets")
            start = start if len(start) == 1 else start[first : first + len(T)]
            yield Part(T, chunk.kinds, start, starts is not None, first)
            first += len(T)
    if starts is not None and 1 < len(starts) != first:
        raise InvalidConfiguration(f"q0 has {len(starts)} rows, more than the {how_many(first, 'target')}")


def available_cores() -> int:
    """Return the number of cores that this process may use."""
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

    Limits, tolerances and statuses mean the same as in `solve`. A row may hold another solution than `solve` finds for
    that target; a q0 per row selects the one to search near. A row depends only on its own target and q0: the result is
    identical to the last byte for any number of threads, chunks or workers (on one CPU model).

    Args:
        robot: The Robot, or a Tree of F tips.
        targets: Poses (N, 4, 4) or positions (N, 3) [m] in the base frame, a list of poses, or an iterator of arrays of
            these shapes. For a Tree, (N, F, 4, 4), (N, F, 3), or a dict by tip (or a list of N), where a tip left out is free.
        solver: Name of a solver, a solver class or an instance of one.
        q0: Start (n,) for all targets (in any form that `solve` takes), or (N, n) or a list of N, one for each; None: home and
            precomputed starts [rad or m].
        threads: Number of threads; by default one for each core.
        executor: Anything with the interface of concurrent.futures (a process pool, a Dask client's `get_executor()`),
            to use instead of threads.
        check: Fraction of the results that Pinocchio verifies, 0 to 1.
        progress: Function that is called with the number of targets done whenever a part is finished.
        options: Options of the search and parameters of the solver, as for `solve`.

    Returns:
        The answers as arrays; row k belongs to target k.

    Raises:
        BatchCheckFailed: Pinocchio does not confirm a result; its `result` has every row, none of them a success.
        BatchInterrupted: Ctrl-C, as a KeyboardInterrupt; its `result` has the targets finished.
        InvalidTarget, InvalidConfiguration: A target or start is wrong; the message names it.
        UnknownSolver, InvalidOption: The solver or an option is wrong.
    """
    check_progress(progress, "the number of targets done")
    require_robot(robot)
    total, tables, kinds, plan, notice = _begin(robot, targets, solver, q0, threads, executor, check, True, options)
    table, done, lost = np.empty((0, plan.width)), 0, []
    try:
        for part in _wrapped(tables, kinds, plan, notice):
            end = done + len(part)
            if end > len(table):  # The array is enlarged in place, so that memory never holds it twice.
                size = total if total is not None else max(end, len(table) + len(table) // 4)
                table.resize((size, plan.width), refcheck=False)
            table[done:end] = part.table
            lost.append((done, part.failures))
            done = end
            if progress is not None:
                progress(done)
    except KeyboardInterrupt:
        if not lost:
            raise
        made = BatchResult(table[:done], kinds, plan, joined_failures(lost), notice)
        raise BatchInterrupted(made, f"after {how_many(done, 'target')}") from None
    # After a failed check by Pinocchio, the result keeps the rows up to the one that failed. All later rows are emptied, so that
    # the result does not depend on how many of them had been solved by then.
    except BatchCheckFailed as failure:
        part, end = failure.result, failure.target + 1
        table.resize((total if total is not None else done + len(part), plan.width), refcheck=False)
        table[done:end] = part.table[: end - done]
        table[end:] = 0.0
        table[end:, [AT.position, AT.rotation, *range(SIZE.answer, plan.width)]] = np.nan
        table[:, AT.status] = CODE.check_failed
        raise BatchCheckFailed(BatchResult(table, kinds, plan, None, notice), failure.target, 0) from None
    table.resize((done, plan.width), refcheck=False)
    return BatchResult(table, kinds, plan, joined_failures(lost) if lost else None, notice)
