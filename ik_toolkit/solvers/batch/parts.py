"""Solves the rows of a batch in parts, on threads or on an executor."""

import functools
import pickle
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numba import config

from ...errors import InvalidOption
from ...kernel.checks import CODE
from ...kernel.records import AT
from ...kernel.simd_search import LEFT
from ..outcome import SolveRecord
from ..plan import Plan
from ..postprocess import confirmed, finish_failures, mark_open
from ..task import counts_in_part
from .result import Failures
from .targets import mended

# A batch is solved in parts. At most AHEAD parts wait for each thread, or REMOTE_AHEAD in all for an executor. An iterator of
# targets is read no further ahead.
AHEAD, REMOTE_AHEAD = 4, 64
SLICE = 0.05  # [s] how long a thread works before it checks whether to stop


# --------------------------------------------------------------------------------------------------------------- solving
def lanes_of(plan: Plan, kinds: tuple) -> Callable | None:
    """Return the compiled function that solves eight targets at once (SIMD), or None if the solver or an option does not allow it.

    kinds: the kind of target of each tip.
    """
    o = plan.options
    plain = not counts_in_part(kinds, o) and o.joint_weights is None and o.max_evaluations is None and o.limits
    plain = plain and not (o.closest or o.follow)
    compiled = not config.DISABLE_JIT  # pyright: ignore[reportAttributeAccessIssue]
    return plan.rule.lanes() if compiled and plain and plan.robot.chain.plain else None


class Part(NamedTuple):
    """A part of a batch that one thread or worker solves: targets T (m, 4, 4) or (m, F, 4, 4), and their starts (1 or m, n).

    kinds: kind of target of each tip; given: whether the caller gave the starts; first: index in the batch of the first target.
    """

    T: np.ndarray
    kinds: tuple
    start: np.ndarray
    given: bool
    first: int

    def rows(self, some: slice) -> "Part":
        """Return a Part with only the targets in the slice `some`."""
        start = self.start if len(self.start) == 1 else self.start[some]
        return Part(self.T[some], self.kinds, start, self.given, self.first + some.start)


def _solve_rows(plan: Plan, part: Part, out: np.ndarray, side_by_side: Callable | None = None) -> None:
    """Solve the targets of a part and write the rows of `out` (m, width); a row depends only on its own target and start.

    side_by_side: the compiled solver for eight targets at once, or None.
    """
    # A joint with weight 0 keeps its value at the start, so the targets cannot share one table of restarts.
    if len(plan.held) and len(part.start) > 1:
        for k in range(len(part.T)):
            _solve_rows(plan, part.rows(slice(k, k + 1)), out[k : k + 1])
        return
    T, kinds, start, given, first = part
    quick = plan.first
    if side_by_side is not None:
        side_by_side(*quick.arrays(kinds, start), T, start, out, quick.orders(kinds, given))
        left = np.flatnonzero(out[:, AT.status] == LEFT)
        rest = np.zeros((len(left), out.shape[1]))
        quick.run(T[left], kinds, start if len(start) == 1 else start[left], given, rest)
        out[left] = rest
    else:
        quick.run(T, kinds, start, given, out)
    for k in np.flatnonzero(out[:, AT.status] == CODE.bad_target):
        one = part.rows(slice(k, k + 1))
        T[k] = mended(T[k], kinds, plan.robot.tips, first + int(k))
        quick.run(one.T, kinds, one.start, given, out[k : k + 1])
    plan.decide(T, kinds, start, given, out)
    if not plan.bare:
        finish_failures(plan, T, kinds, start, given, out)
    if plan.improving:
        for k in np.flatnonzero(out[:, AT.status] == CODE.converged):
            one = part.rows(slice(k, k + 1))
            asked = one.start.tobytes() if given else b""
            outcome = SolveRecord(plan, one.T.tobytes(), kinds, asked, out[k].copy(), 0.0)
            for step in plan.improving:
                outcome = step(outcome)
            out[k] = outcome.row


def _sampled(first: int, count: int, share: float) -> Iterator[int]:
    """Yield the indices of the rows to check in a part; over the whole batch they are ceil(j / share) for j = 0, 1, 2, ...

    first, count: index of the part's first row in the batch, and number of its rows. Python's integers do not round or overflow, so
    the share is met to within a row, and the checked rows do not depend on how the batch is divided.
    """
    p, q = float(share).as_integer_ratio()
    j = (first - 1) * p // q + 1
    while p and (k := -(-j * q // p)) < first + count:
        yield k - first
        j += 1


def _confirm(plan: Plan, part: Part, out: np.ndarray, share: float) -> None:
    """Check again with Pinocchio those rows of a part that belong to the share of the batch to be checked."""
    for k in _sampled(part.first, len(out), share):
        if out[k, AT.status] == CODE.converged:
            if not confirmed(plan, out[k, plan.q_columns], part.T[k], part.kinds):
                out[k, AT.status] = CODE.check_failed


def _solve_part(
    plan: Plan, part: Part, share: float, stop: threading.Event | None = None
) -> tuple[np.ndarray, Failures]:
    """Solve one part in slices and return its rows (m, width), and the targets and starts of those that failed.

    If `stop` is set between two slices, the rows are incomplete.
    """
    out = np.zeros((len(part.T), plan.width))
    side_by_side = lanes_of(plan, part.kinds)
    a, size = 0, 1024 if side_by_side is not None else 16
    while a < len(out) and not (stop is not None and stop.is_set()):
        began = perf_counter()
        rows = slice(a, a + size)
        _solve_rows(plan, part.rows(rows), out[rows], side_by_side)
        a += size
        size = max(1, int(size * min(4.0, SLICE / max(perf_counter() - began, 1e-9))))
    _confirm(plan, part, out, share)
    mark_open(plan, out)
    lost = np.flatnonzero(out[:, AT.status] != CODE.converged)
    q0 = np.broadcast_to(part.start, (len(out), plan.robot.n))[lost] if part.given else np.empty((0, plan.robot.n))
    return out, Failures(lost, part.T[lost], q0)


@functools.lru_cache(4)
def _unpacked(payload: bytes) -> Plan:
    """Read a Plan (a solver bound to a robot) from its pickle; a worker process keeps it for the next part."""
    # Unpickling is safe here: the data comes from `on_executor`, and whoever could replace it already runs code in this process.
    return pickle.loads(payload)  # noqa: S301


def _solve_remote(payload: bytes, part: Part, share: float) -> tuple[np.ndarray, Failures]:
    """Solve a part in a worker process or on another machine."""
    return _solve_part(_unpacked(payload), part, share)


Tables = Generator[tuple[np.ndarray, Failures], None, None]


def on_threads(plan: Plan, parts: Iterator[Part], share: float, threads: int) -> Tables:
    """Solve the parts of a batch on threads of this process; yield result rows and failures of each part, in order.

    share: fraction of the batch that Pinocchio checks, 0 to 1.
    """
    stop = threading.Event()
    pool = ThreadPoolExecutor(threads)
    try:
        yield from _in_order(lambda part: pool.submit(_solve_part, plan, part, share, stop), parts, AHEAD * threads)
    finally:
        stop.set()
        pool.shutdown(wait=True, cancel_futures=True)


def check_executor(executor: Any) -> None:
    """Raise InvalidOption unless `executor` is None or has a method `submit`, like the executors of concurrent.futures."""
    if executor is not None and (not hasattr(executor, "submit") or isinstance(executor, type)):
        raise InvalidOption(f"executor must be a pool with a submit method (concurrent.futures), not {executor!r:.80}")


def on_executor(plan: Plan, parts: Iterator[Part], share: float, executor: Executor) -> Tables:
    """Solve the parts of a batch on the workers of an executor; yield result rows and failures of each part, in order.

    share: fraction of the batch that Pinocchio checks, 0 to 1.
    """
    payload = pickle.dumps(plan)
    yield from _in_order(lambda part: executor.submit(_solve_remote, payload, part, share), parts, REMOTE_AHEAD)


def _in_order(submit: Callable[[Part], Any], parts: Iterator[Part], ahead: int) -> Tables:
    """Yield the results in the order of the parts; no more than `ahead` of them are in progress at a time."""
    waiting: deque = deque()
    try:
        for part in parts:
            waiting.append(submit(part))
            if len(waiting) >= ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()
