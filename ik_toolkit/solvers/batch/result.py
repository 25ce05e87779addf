"""The result of a batch: arrays with a row per target."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ...copying import ReadOnly
from ...errors import IKError, Interrupted, InvalidOption
from ...kernel.records import AT, SIZE
from ...text import TextTable, how_many, length
from ..collision_free import collision_model
from ..outcome import SPOKEN, SolveRecord
from ..plan import Plan
from ..result import Result
from ..status import Status, count_statuses, is_proven


class BatchInterrupted(Interrupted):
    """Ctrl-C during a batch; `result` is the BatchResult of the targets finished before it, starting with the first."""


class BatchCheckFailed(IKError):
    """Pinocchio does not confirm an answer of a batch: the solver is wrong for this robot, so no row is a success.

    Attributes:
        result: BatchResult whose rows all have the status CHECK_FAILED. From `solve_batch` it has a row for every target (if their
            number is unknown, up to the end of the part that failed), with NaN in all rows after that of `target`, even if they had
            been solved. From `solve_parts` it is the part that failed.
        target: Number of the first target whose answer is not confirmed.
        before: Number of results already returned, which cannot be trusted either.
    """

    def __init__(self, result: "BatchResult", target: int, before: int) -> None:
        """Store the rows; `before` counts those already returned."""
        doubt = f" The {before} results already returned cannot be trusted either." if before else ""
        super().__init__(
            f"Pinocchio does not confirm the result for target {target}, so no result of this batch can be trusted.{doubt}"
            " A tolerance below 1e-14 of the reach is rounding; else please report this with the robot and the target."
        )
        self.result = result
        self.target = target
        self.before = before


class Failures(NamedTuple):
    """The targets and starts of those rows of a batch that failed, kept because error messages need them.

    rows (m,): their indices in the batch, ascending; T (m, 4, 4) or (m, F, 4, 4): their targets; q0 (m, n): their starts, (0, n) if
    none were given.
    """

    rows: np.ndarray
    T: np.ndarray
    q0: np.ndarray

    def asked(self, k: int) -> tuple[bytes, bytes]:
        """Return the target and start of row k as bytes (the form in a SolveRecord), or b"" if the row is solved."""
        at = int(np.searchsorted(self.rows, k))
        if at == len(self.rows) or self.rows[at] != k:
            return b"", b""
        return self.T[at].tobytes(), self.q0[at].tobytes() if len(self.q0) else b""


def joined_failures(parts: Sequence[tuple[int, Failures]]) -> Failures:
    """Join the failures of several parts of a batch, each given with the batch index of its first row."""
    rows = [first + failures.rows for first, failures in parts]
    T, q0 = ([getattr(failures, name) for _, failures in parts] for name in ("T", "q0"))
    return Failures(np.concatenate(rows), np.concatenate(T), np.concatenate(q0))


class BatchResult(ReadOnly):
    """Answers of a batch, where row k belongs to target k, and batch[k] is the Result of target k with its message.

    Attributes:
        q: Solutions (N, n) [rad or m].
        status, success: Numbers of Status (N,), and whether they are CONVERGED (N,). `ik.Status(4).name` is the name of 4, and
            `batch.counts()` counts them by name.
        proven: Whether (N,) it is proven that no joint values within the limits reach the target (or, for a success with `closest`,
            that no solution is nearer; see `Result.proven`).
        position_error: Distance (N,) [m] from the target; for several tips the largest.
        orientation_error: Rotation angle (N,) [rad] left; for several tips the largest. None if orientation is free.
        position_errors, orientation_errors: The errors of each tip, by its name.
        iterations, restarts, fk_evaluations: Counts (N,).
        table: The result rows (N, width) of the compiled search, see `kernel.records.Answer`.
        failures: Targets and starts of the rows that failed (`Failures`), from which their messages are made; or None.
        notice: What was done with the starts: moved inside the limits, or values of other joints ignored; else ''.
    """

    def __init__(
        self, table: np.ndarray, kinds: tuple, plan: Plan, failures: Failures | None = None, notice: str = ""
    ) -> None:
        """Wrap the result rows (N, width) of targets of these kinds, one kind per tip."""
        self.table = table
        self.failures = failures
        self.kinds = kinds
        self.plan = plan
        self.notice = notice
        self.solver = plan.row.name
        self._seal()

    def __len__(self) -> int:
        """Return the number of targets."""
        return len(self.table)

    def __getitem__(self, k: int | slice) -> Any:
        """Return the Result of target k (negative: counted from the end), or a list of them for a slice. Raises InvalidOption."""
        if isinstance(k, slice):
            return [self[one] for one in range(len(self))[k]]
        if not isinstance(k, int | np.integer):
            raise InvalidOption(f"the Results of a batch are taken by a number or a slice, not by {k!r:.60}")
        row = self.table[int(k)]
        touching = None
        if int(row[AT.status]) == Status.COLLISION:
            model = collision_model(self.plan.robot, self.plan.options.avoid_collisions)
            # The pair in contact is looked for now. There is none if the obstacle has been moved away since the batch was solved.
            touching = next(iter(model.collisions(self.q[k])), None)
        k = range(len(self.table))[k]  # Negative numbers count from the end.
        target, q0 = self.failures.asked(k) if self.failures is not None else (b"", b"")
        return Result(SolveRecord(self.plan, target, self.kinds, q0, row, 0.0, collision=touching))

    @property
    def position_only(self) -> bool:
        """Whether every target leaves orientation free."""
        return all(kind in SPOKEN for kind in self.kinds)

    q = property(lambda self: self.table[:, self.plan.q_columns])
    status = property(lambda self: self.table[:, AT.status].astype(np.int64))
    success = property(lambda self: self.table[:, AT.status] == Status.CONVERGED)
    proven = property(lambda self: is_proven(self.table[:, AT.status], self.table[:, AT.excess], self.plan))
    position_error = property(lambda self: self.table[:, AT.position])
    orientation_error = property(lambda self: None if self.position_only else self.table[:, AT.rotation])

    @property
    def position_errors(self) -> dict[str, np.ndarray]:
        """Distance (N,) of each tip from its target [m]."""
        return {tip: errors[:, 0] for tip, errors in zip(self.plan.robot.tips, self._each(), strict=True)}

    @property
    def orientation_errors(self) -> dict[str, np.ndarray | None]:
        """Rotation angle (N,) left at each tip [rad]; None if orientation is free."""
        each = zip(self.plan.robot.tips, self.kinds, self._each(), strict=True)
        return {tip: None if kind in SPOKEN else errors[:, 1] for tip, kind, errors in each}

    def _each(self) -> list[np.ndarray]:
        """Return the errors (N, 2) of each tip."""
        if len(self.kinds) == 1:
            return [self.table[:, [AT.position, AT.rotation]]]
        first = self.plan.q_columns.stop
        return [self.table[:, first + SIZE.miss * f : first + SIZE.miss * f + 2] for f in range(len(self.kinds))]

    iterations = property(lambda self: self.table[:, AT.iterations].astype(np.int64))
    restarts = property(lambda self: self.table[:, AT.restarts].astype(np.int64))
    fk_evaluations = property(lambda self: self.table[:, AT.evaluations].astype(np.int64))

    def counts(self) -> dict[str, int]:
        """Count how many targets ended with each status."""
        return count_statuses(self.table[:, AT.status])

    def to_dict(self) -> dict[str, Any]:
        """Return arrays by name, for np.savez and tables; for several tips also TIP.position_error and TIP.orientation_error."""
        names = ("q", "status", "success", "proven", "position_error", "orientation_error", "iterations", "restarts")
        arrays = {name: getattr(self, name) for name in (*names, "fk_evaluations")}
        if len(self.kinds) > 1:
            for name, errors in (
                ("position_error", self.position_errors),
                ("orientation_error", self.orientation_errors),
            ):
                arrays |= {f"{tip}.{name}": array for tip, array in errors.items()}
        return {name: array for name, array in arrays.items() if array is not None}

    def _repr_html_(self) -> str:
        """Return a table for notebooks: how many targets ended with each status, and what the solved ones took."""
        rows, N = [], max(len(self), 1)
        for name, count in self.counts().items():
            these = self.table[self.status == Status[name]]
            steps, left = np.median(these[:, AT.iterations]), these[:, AT.position].max()
            rows.append((name, count, f"{100 * count / N:.1f} %", steps, length(left)))
        head = ("status", "targets", "share", "median iterations", "largest position error")
        words = f"of {len(self)} targets for '{self.plan.robot.name}' solved by {self.solver}"
        how = "ik.plot(batch) draws how many are solved within how many iterations; batch[k] is the result of target k."
        return TextTable(f"{int(self.success.sum())}", words, head, rows, how).html()

    def __repr__(self) -> str:
        """Describe the batch in one line."""
        many = f"{how_many(len(self), 'target')}, {int(self.success.sum())} solved"
        return f"BatchResult({many}, solver='{self.solver}', {self.counts()})"
