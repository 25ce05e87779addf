"""Many targets at once: compiled, on all cores, in parts, with the same bytes for any number of threads or workers."""

import functools
import math
import os
import pickle
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import closing
from itertools import chain as joined
from time import perf_counter
from typing import Any

import numpy as np
from numba import config

from ..errors import InvalidConfiguration, InvalidOption, InvalidTarget, floats, masked
from ..kernel.checks import BAD_TARGET, CHECK_FAILED, CONVERGED
from ..kernel.lanes import LEFT, lanes
from ..kernel.limits import LARGEST
from ..kernel.records import ANSWER, AT
from ..kernel.task import POSE, POSITION
from ..robot.pose import check_target
from ..robot.robot import Robot
from .batch_result import JUMP, R_MOVE, BatchCheckFailed, BatchInterrupted, BatchResult
from .result import Status
from .rules.jacobian import LM
from .solve import Solver, automatic, is_auto
from .task import counts_in_part

PART, REMOTE_PART = 2048, 4096  # most rows handed to a thread, and rows handed to a worker of an executor
LEAST_PART = 128  # smaller batches are shared out evenly over the threads, but not in smaller parts than this
AHEAD, REMOTE_AHEAD = 4, 64  # parts waiting per thread, and in all at an executor: an iterator is never read far ahead
SLICE = 0.05  # s; a thread looks up this often whether it shall stop


# ---------------------------------------------------------------------------------------------------------------- input
def _known(targets: Any) -> np.ndarray | None:
    """Targets as one array when they are an array or a sequence; None for an iterator."""
    if isinstance(targets, np.ndarray):
        return targets
    if isinstance(targets, Iterator):
        return None
    try:
        return np.array([_numbers(getattr(target, "homogeneous", target)) for target in targets])
    except (TypeError, ValueError) as error:
        if isinstance(error, InvalidTarget):
            raise
        raise InvalidTarget("targets are an array (N, 4, 4) or (N, 3), or an iterator of such arrays") from None


def _numbers(targets: Any) -> np.ndarray:
    """Targets as an array of real numbers, see `errors.floats`; a view where they are one."""
    if masked(targets):
        raise InvalidTarget("targets are numbers, and some of these are masked")
    array = np.asarray(targets)
    if array.dtype.kind not in "fiu":
        raise InvalidTarget(f"targets are numbers, not {array.dtype} of shape {array.shape}")
    return array


def _checked(chunks: Iterator[Any]) -> Iterator[np.ndarray]:
    """Refuse chunks of the wrong shape, or of another kind than the first; their numbers are checked in the kernel."""
    ndim = 0
    for chunk in chunks:
        chunk = _numbers(chunk)
        if chunk.size == 0 and chunk.ndim < 2:
            continue
        if chunk.shape[1:] not in ((4, 4), (3,)):
            raise InvalidTarget(f"targets are numbers of shape (N, 4, 4) or (N, 3), not of shape {chunk.shape}")
        if ndim not in (0, chunk.ndim):
            raise InvalidTarget("a batch is all poses or all positions, not both")
        ndim = chunk.ndim
        yield chunk


def _starts(solver: Solver, q0: np.ndarray, first: int) -> np.ndarray:
    """Validated starts (1 or m, n), inside the limits."""
    bad = ~np.isfinite(q0).all(axis=1)
    if bad.any():
        raise InvalidConfiguration(f"q0 of target {first + int(np.argmax(bad))} is not finite")
    inside = np.clip(q0, solver.robot.lower, solver.robot.upper) if solver.options.limits else q0
    bad = (np.abs(inside / solver.robot.chain.unit) >= LARGEST).any(axis=1)
    if bad.any():
        raise InvalidConfiguration(
            f"q0 of target {first + int(np.argmax(bad))} is too large a number: stay below {LARGEST:g}"
        )
    if solver.options.q0_outside == "refuse" and (inside != q0).any():
        k = int(np.argmax((inside != q0).any(axis=1)))
        raise InvalidConfiguration(
            f"q0 of target {first + k} is outside the limits at joint {', '.join(solver.robot.outside(q0[k]))}"
        )
    return inside


# --------------------------------------------------------------------------------------------------------------- solving
def _has_lanes(solver: Solver) -> bool:
    """Whether the solver's targets can be solved eight side by side (kernel.lanes)."""
    o = solver.options
    plain = not counts_in_part((), o) and o.joint_weights is None and o.max_evaluations is None and o.limits
    plain = plain and not (o.closest or o.follow)
    compiled = not config.DISABLE_JIT  # pyright: ignore[reportAttributeAccessIssue]
    return compiled and plain and type(solver.rule) is LM and solver.robot.chain.rows[0, 0] > 0.0


def _solve_rows(
    solver: Solver,
    T: np.ndarray,
    start: np.ndarray,
    given: bool,
    kind: int,
    out: np.ndarray,
    first: int,
    side_by_side: bool = False,
) -> None:
    """Solve rows (m, ANSWER + n), each from its own target and start alone; `first` is the number of the first."""
    if len(solver.held) and len(start) > 1:  # each with a table of starts of its own
        for k in range(len(T)):
            one = slice(k, k + 1)
            _solve_rows(solver, T[one], start[one], given, kind, out[one], first + k)
        return
    opt = solver.pack(kind, given)
    arrays = solver.arrays_for(kind, start)
    if side_by_side:
        lanes()(*arrays, T, start, out, opt)
        left = np.flatnonzero(out[:, AT.status] == LEFT)
        rest = np.zeros((len(left), out.shape[1]))
        solver._kernel(*arrays, T[left], start if len(start) == 1 else start[left], rest, opt, solver._silent)
        out[left] = rest
    else:
        solver._kernel(*arrays, T, start, out, opt, solver._silent)
    for k in np.flatnonzero(out[:, AT.status] == BAD_TARGET):
        try:
            mended = check_target(T[k] if kind == POSE else T[k, :3, 3])[0]
        except InvalidTarget as error:
            raise InvalidTarget(f"target {first + k}: {error}") from None
        T[k] = mended
        solver._kernel(*arrays, T[k : k + 1], _row(start, k), out[k : k + 1], opt, solver._silent)
    if solver._extras:
        for k in np.flatnonzero(out[:, AT.status] == Status.CONVERGED):
            solver.finish(out[k], T[k : k + 1], kind, _row(start, k), given)


def _row(start: np.ndarray, k: Any) -> np.ndarray:
    return start if len(start) == 1 else start[k : k + 1]


def _poses(part: np.ndarray) -> tuple[np.ndarray, int]:
    """A part as (m, 4, 4), and its kind; rotations of few digits are replaced, in place, by the nearest exact ones."""
    if part.ndim == 3:
        T = part
        x, y, z = (np.ascontiguousarray(T[:, :3, k].T) for k in range(3))
        off = np.zeros(len(T))
        with np.errstate(invalid="ignore", over="ignore"):
            for u, v in ((x, x), (y, y), (z, z), (x, y), (x, z), (y, z)):
                np.maximum(off, np.abs((u * v).sum(axis=0) - (u is v)), out=off)
        rough = (off > 1e-12) & (off < 1e-6)  # what is worse, or not a number, the kernel hands back
        if rough.any():
            U, _, Vt = np.linalg.svd(T[rough, :3, :3])
            T[rough, :3, :3] = U @ Vt
        return T, POSE
    T = np.tile(np.eye(4), (len(part), 1, 1))
    T[:, :3, 3] = part
    return T, POSITION


def _sampled(first: int, count: int, share: float) -> Iterator[int]:
    """Rows of a part to check, so that of the whole batch row ceil(j / share) is, for j = 0, 1, 2, ...

    Whole numbers throughout: any share is met to a row, by the same rows however the batch is cut, and none overflows.
    """
    p, q = float(share).as_integer_ratio()
    j = (first - 1) * p // q + 1
    while p and (k := -(-j * q // p)) < first + count:
        yield k - first
        j += 1


def _confirm(solver: Solver, T: np.ndarray, kind: int, out: np.ndarray, first: int, share: float) -> None:
    """Check a share of the rows of the whole batch again with Pinocchio."""
    for k in _sampled(first, len(out), share):
        if out[k, AT.status] == CONVERGED:
            target = T[k] if kind == POSE else T[k, :3, 3]
            if not solver.confirm(out[k, ANSWER:], target)[2]:
                out[k, AT.status] = CHECK_FAILED


def _solve_part(
    solver: Solver,
    part: np.ndarray,
    q0: np.ndarray | None,
    first: int,
    share: float,
    stop: threading.Event | None = None,
) -> np.ndarray:
    """Rows (m, ANSWER + n) of one part, in slices between which it may be stopped (then they are incomplete)."""
    T, kind = _poses(part)
    start = solver._home if q0 is None else _starts(solver, q0, first)
    out = np.zeros((len(T), ANSWER + solver.robot.n))
    side_by_side = _has_lanes(solver)
    a, size = 0, 1024 if side_by_side else 16
    while a < len(T) and not (stop is not None and stop.is_set()):
        began = perf_counter()
        rows = slice(a, a + size)
        some = start if len(start) == 1 else start[rows]
        _solve_rows(solver, T[rows], some, q0 is not None, kind, out[rows], first + a, side_by_side)
        a += size
        size = max(1, int(size * min(4.0, SLICE / max(perf_counter() - began, 1e-9))))
    _confirm(solver, T, kind, out, first, share)
    return out


@functools.lru_cache(4)
def _unpacked(payload: bytes) -> Solver:
    """Solver of a pickled one, kept by the worker for the next part."""
    return pickle.loads(payload)  # noqa: S301  made by _on_executor, and sent by the scheduler that already runs our code


def _solve_remote(payload: bytes, part: np.ndarray, q0: Any, first: int, share: float) -> np.ndarray:
    """What a worker process or machine runs."""
    return _solve_part(_unpacked(payload), part, q0, first, share)


Job = tuple[np.ndarray, np.ndarray | None, int]  # targets (a copy), starts, number of the first target
Tables = Generator[np.ndarray, None, None]


def _on_threads(solver: Solver, jobs: Iterator[Job], share: float, threads: int) -> Tables:
    stop = threading.Event()
    pool = ThreadPoolExecutor(threads)
    try:
        yield from _in_order(lambda job: pool.submit(_solve_part, solver, *job, share, stop), jobs, AHEAD * threads)
    finally:
        stop.set()
        pool.shutdown(wait=True, cancel_futures=True)


def _on_executor(solver: Solver, jobs: Iterator[Job], share: float, executor: Executor) -> Tables:
    payload = pickle.dumps(solver)
    yield from _in_order(lambda job: executor.submit(_solve_remote, payload, *job, share), jobs, REMOTE_AHEAD)


def _in_order(submit: Callable[[Job], Any], jobs: Iterator[Job], ahead: int) -> Iterator[np.ndarray]:
    """Results in the order of the jobs, of which no more than `ahead` are under way."""
    waiting: deque = deque()
    try:
        for job in jobs:
            waiting.append(submit(job))
            if len(waiting) >= ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()


def _on_a_chain(solver: Solver, jobs: Iterator[Job], share: float) -> Tables:
    """Each target from the answer before it; parts end after SLICE, so that an interrupt loses little.

    Where the answer is far from the one before, the nearest of several is looked for instead.
    """
    last: np.ndarray | None = None
    start = solver._home
    given, near = False, None
    if not (solver.row.closed or solver.options.closest):
        near = Solver(solver.robot, solver.rule, **{**solver.options.__dict__, "closest": True})
    for part, q0, first in jobs:
        T, kind = _poses(part)
        out = np.zeros((len(T), ANSWER + solver.robot.n))
        a, began = 0, perf_counter()
        for k in range(len(T)):
            if not given and q0 is not None:
                start, given = _starts(solver, q0, first), True
            row, target = out[k : k + 1], T[k : k + 1]
            _solve_rows(solver, target, start, given, kind, row, first + k)
            move = _move(solver, row, last)
            if move > JUMP and near is not None:
                other = row.copy()
                _solve_rows(near, target, start, True, kind, other, first + k)
                if _move(solver, other, last) < move:
                    row[:], move = other, _move(solver, other, last)
            row[0, R_MOVE] = move
            if row[0, AT.status] == Status.CONVERGED:
                last = start = row[:, ANSWER:].copy()
                given = True
            if k + 1 == len(T) or perf_counter() - began > SLICE:
                _confirm(solver, T[a : k + 1], kind, out[a : k + 1], first + a, share)
                yield out[a : k + 1]
                a, began = k + 1, perf_counter()


def _move(solver: Solver, row: np.ndarray, last: np.ndarray | None) -> float:
    """Largest joint move of an answer (1, ANSWER + n) from the one before; NaN when it is none, 0 when it is the first."""
    if row[0, AT.status] != Status.CONVERGED:
        return np.nan
    return 0.0 if last is None else float(np.abs((row[:, ANSWER:] - last) / solver.robot.chain.unit).max())


def _whole(name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise InvalidOption(f"{name} must be a whole number of at least 1, not {value!r}")
    return int(value)


def solve_parts(
    robot: Robot,
    targets: Any,
    solver: Any = "auto",
    *,
    q0: Any = None,
    threads: int | None = None,
    executor: Executor | None = None,
    chain: bool = False,
    check: float = 0.01,
    **options: Any,
) -> Iterator[BatchResult]:
    """Solve as `solve_batch` does and give the answers part by part, in order: for more targets than fit in memory.

    An array is read as parts are taken, so leave it as it is until then; what an iterator gives may be used again at once.
    Raises BatchCheckFailed at the part with an answer that Pinocchio does not confirm; its `result` is that part.
    """
    if not isinstance(robot, Robot):
        raise InvalidOption(
            f"solve_batch takes a robot with one tip, not a {type(robot).__name__}; call a bound Solver in a loop"
        )
    if executor is not None and (threads is not None or chain):
        raise InvalidOption("an executor has its own workers, and a chain runs in one: leave out threads= and chain=")
    if executor is not None and not hasattr(executor, "submit"):
        raise InvalidOption(f"executor is a pool with a submit method (concurrent.futures), not {executor!r:.80}")
    if chain and options.get("follow"):
        raise InvalidOption("a chain starts each target from the answer before it; follow takes a q0 for every row")
    if options.get("history"):
        raise InvalidOption("a batch keeps no history; solve the target in question with ik.solve")
    count = _whole("threads", threads) if threads is not None else _cores()
    if not isinstance(check, int | float | np.floating) or not 0.0 <= check <= 1.0:
        raise InvalidOption(f"check is the fraction of answers to check again, 0 to 1, not {check!r}")
    known = _known(targets)
    chunks = _checked(iter([known]) if known is not None else targets)
    first = next(chunks, None)
    starts = None
    if q0 is not None:
        starts = floats(q0, "q0 must be numbers", InvalidConfiguration)
        if starts.shape not in (
            (robot.n,),
            (1 if chain else len(known) if known is not None else len(starts), robot.n),
        ):
            wanted = (
                f"({robot.n},)" if chain else f"({robot.n},) or ({'N' if known is None else len(known)}, {robot.n})"
            )
            raise InvalidConfiguration(f"q0 of this batch has the shape {wanted}, not {starts.shape}")
    if is_auto(solver):
        solver = automatic(robot, POSITION if first is not None and first.ndim == 2 else POSE, options)
    local = Solver(robot, solver, **options)
    if first is None:
        return iter(())
    local.pack(POSITION if first.ndim == 2 else POSE, starts is not None)  # a solver that cannot do it says so here
    size = PART if executor is None else REMOTE_PART
    if executor is None and known is not None:
        size = min(size, max(LEAST_PART, math.ceil(len(known) / count)))
    jobs = _jobs(joined([first], chunks), starts, size)
    if chain:
        tables = _on_a_chain(local, jobs, check)
    elif executor is not None:
        tables = _on_executor(local, jobs, check, executor)
    else:
        tables = _on_threads(local, jobs, check, count)
    return _wrapped(tables, first.ndim == 2, local, chain)


def _wrapped(tables: Tables, position_only: bool, solver: Solver, chain: bool) -> Iterator[BatchResult]:
    """Parts as results; the first with an answer that Pinocchio does not confirm ends the batch."""
    done = 0
    with closing(tables):
        for table in tables:
            part = BatchResult(table, position_only, solver, chain)
            failed = np.flatnonzero(table[:, AT.status] == CHECK_FAILED)
            if len(failed):
                table[:, AT.status] = CHECK_FAILED
                raise BatchCheckFailed(part, done + int(failed[0]), done)
            done += len(table)
            yield part


def _jobs(chunks: Iterator[np.ndarray], starts: np.ndarray | None, size: int) -> Iterator[Job]:
    each = starts is not None and starts.ndim == 2 and len(starts) > 1
    first = 0
    for chunk in chunks:
        for a in range(0, len(chunk), size):
            part = np.array(chunk[a : a + size], dtype=float, order="C")  # a buffer may be refilled while this waits
            if starts is None:
                q0 = None
            elif not each:
                q0 = starts.reshape(1, -1)
            else:
                q0 = starts[first : first + len(part)]
                if len(q0) < len(part):
                    raise InvalidConfiguration(f"q0 has {len(starts)} rows, fewer than there are targets")
            yield part, q0, first
            first += len(part)


def _cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def solve_batch(
    robot: Robot,
    targets: Any,
    solver: Any = "auto",
    *,
    q0: Any = None,
    threads: int | None = None,
    executor: Executor | None = None,
    chain: bool = False,
    check: float = 0.01,
    progress: Callable[[int], None] | None = None,
    **options: Any,
) -> BatchResult:
    """Solve many targets on all cores.

    targets: (N, 4, 4) poses or (N, 3) positions [m], a list of poses, or an iterator of arrays of these shapes. q0: None (home
    and seed table), (n,) for all, or (N, n). threads: default all cores. executor: anything with the concurrent.futures
    interface (a process pool, a Dask client's `get_executor()`) instead of threads. chain: ordered waypoints, each solved from
    the answer before it, the nearest of several where that jumps; q0 (n,) is where the first starts. check: fraction of the
    answers to check again with Pinocchio. progress(done) is called as parts finish. Options and parameters as for `solve`.
    A row keeps what `solve` promises: limits, tolerances, what a status means. It may be another solution than `solve` gives for
    that target; q0 per row says near which one to search. Without chain it depends on its own target and q0 alone: the same
    bytes for any number of threads, chunks or workers (on one kind of CPU). Ctrl-C raises BatchInterrupted, a KeyboardInterrupt
    whose `result` holds the targets finished. Raises BatchCheckFailed when Pinocchio does not confirm an answer (its `result`
    has every row, none of them a success), InvalidTarget and InvalidConfiguration (naming the target), UnknownSolver and
    InvalidOption.
    """
    known = _known(targets)
    parts = solve_parts(
        robot,
        targets if known is None else known,
        solver,
        q0=q0,
        threads=threads,
        executor=executor,
        chain=chain,
        check=check,
        **options,
    )
    table, done, part = np.empty((0, ANSWER + robot.n)), 0, None
    try:
        for part in parts:
            end = done + len(part)
            if end > len(table):  # in place: no second copy of what is there
                size = len(known) if known is not None else max(end, len(table) + len(table) // 4)
                table.resize((size, table.shape[1]), refcheck=False)
            table[done:end] = part._table
            done = end
            if progress is not None:
                progress(done)
    except KeyboardInterrupt:
        if part is None:
            raise
        raise BatchInterrupted(BatchResult(table[:done], part.position_only, part._solver, chain)) from None
    except BatchCheckFailed as failure:  # rows up to the one that failed, and nothing of those after it, solved or not
        part, end = failure.result, failure.target + 1
        table.resize((len(known) if known is not None else done + len(part), table.shape[1]), refcheck=False)
        table[done:end] = part._table[: end - done]
        table[end:] = 0.0
        table[end:, [AT.position, AT.rotation, R_MOVE, *range(ANSWER, table.shape[1])]] = np.nan
        table[:, AT.status] = CHECK_FAILED
        whole = BatchResult(table, part.position_only, part._solver, chain)
        raise BatchCheckFailed(whole, failure.target, 0) from None
    if part is None:
        position_only = known is not None and known.ndim == 2
        return BatchResult(table, position_only, None, chain)
    table.resize((done, table.shape[1]), refcheck=False)
    return BatchResult(table, part.position_only, part._solver, chain)
