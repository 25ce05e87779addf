"""Result of a batch: arrays with a row per target."""

from typing import Any

import numpy as np

from ...errors import IKError, Portable
from ...kernel.records import ANSWER, AT, MISS
from ...readonly import ReadOnly
from ..collision_free import collision_model
from ..outcome import SPOKEN, SolveRecord
from ..plan import Plan
from ..result import Result
from ..status import Status, count_statuses


class BatchInterrupted(Portable, KeyboardInterrupt):
    """Ctrl-C during a batch; `result` is the BatchResult of the targets finished before it, from the first on."""

    def __init__(self, result: "BatchResult") -> None:
        """Store the finished part."""
        super().__init__(f"interrupted after {len(result)} targets")
        self.result = result


class BatchCheckFailed(IKError):
    """Pinocchio does not confirm an answer of a batch: the solver is wrong for this robot, so no row is a success.

    result: BatchResult whose rows all have the status CHECK_FAILED; target: number of the first that is not confirmed. From
    `solve_batch` the result has every row, with NaN where the batch ended before; from `solve_parts` it is the part that failed.
    """

    def __init__(self, result: "BatchResult", target: int, before: int) -> None:
        """Keep the rows; `before` counts those already handed out."""
        doubt = f" The {before} results already returned cannot be trusted either." if before else ""
        super().__init__(
            f"Pinocchio does not confirm the result for target {target}, so no result of this batch can be trusted.{doubt}"
            " Please report this with the robot and the target."
        )
        self.result = result
        self.target = target
        self.before = before


class BatchResult(ReadOnly):
    """Answers of a batch, row k belonging to target k.

    q (N, n) [rad or m]; status (N,) numbers of Status; success (N,) bool; position_error (N,) [m]; orientation_error (N,)
    [rad], None where orientation is free; of several tips the largest, and position_errors, orientation_errors by tip;
    iterations, restarts, fk_evaluations (N,). batch[k] is the Result of target k, with its sentence. table: the rows of the kernel.
    """

    def __init__(self, table: np.ndarray, kinds: tuple, plan: Plan) -> None:
        """Wrap the kernel's rows (N, width) of targets of these kinds, one per tip."""
        self.table = table
        self.kinds = kinds
        self.plan = plan
        self.solver = plan.row.name
        self._seal()

    def of(self, table: np.ndarray) -> "BatchResult":
        """The same batch with other rows."""
        return BatchResult(table, self.kinds, self.plan)

    def __len__(self) -> int:
        """Number of targets."""
        return len(self.table)

    def __getitem__(self, k: int) -> Result:
        """Result of target k."""
        row = self.table[k]
        touching = None
        if int(row[AT.status]) == Status.COLLISION:
            model = collision_model(self.plan.robot, self.plan.options.avoid_collisions)
            touching = next(iter(model.collisions(self.q[k])), None)  # None: the colliding obstacle has been moved away
        nothing = np.empty(0)  # a batch keeps neither targets nor starts
        return Result(SolveRecord(self.plan, nothing, self.kinds, nothing, False, row, 0.0, collision=touching))

    @property
    def position_only(self) -> bool:
        """Whether every target leaves orientation free."""
        return all(kind in SPOKEN for kind in self.kinds)

    q = property(lambda self: self.table[:, ANSWER : ANSWER + self.plan.robot.n])
    status = property(lambda self: self.table[:, AT.status].astype(np.int64))
    success = property(lambda self: self.table[:, AT.status] == Status.CONVERGED)
    position_error = property(lambda self: self.table[:, AT.position])
    orientation_error = property(lambda self: None if self.position_only else self.table[:, AT.rotation])

    @property
    def position_errors(self) -> dict[str, np.ndarray]:
        """Distance (N,) of each tip from its target [m]."""
        return {tip: errors[:, 0] for tip, errors in zip(self.plan.robot.tips, self._each(), strict=True)}

    @property
    def orientation_errors(self) -> dict[str, np.ndarray | None]:
        """Rotation angle (N,) left at each tip [rad]; None where orientation is free."""
        each = zip(self.plan.robot.tips, self.kinds, self._each(), strict=True)
        return {tip: None if kind in SPOKEN else errors[:, 1] for tip, kind, errors in each}

    def _each(self) -> list[np.ndarray]:
        """Errors (N, 2) of each tip."""
        if len(self.kinds) == 1:
            return [self.table[:, [AT.position, AT.rotation]]]
        first = ANSWER + self.plan.robot.n
        return [self.table[:, first + MISS * f : first + MISS * f + 2] for f in range(len(self.kinds))]

    iterations = property(lambda self: self.table[:, AT.iterations].astype(np.int64))
    restarts = property(lambda self: self.table[:, AT.restarts].astype(np.int64))
    fk_evaluations = property(lambda self: self.table[:, AT.evaluations].astype(np.int64))

    def counts(self) -> dict[str, int]:
        """How many targets ended with each status."""
        return count_statuses(self.table[:, AT.status])

    def to_dict(self) -> dict[str, Any]:
        """Arrays by name, for np.savez and tables; of several tips also TIP.position_error and TIP.orientation_error."""
        names = ("q", "status", "success", "position_error", "orientation_error", "iterations", "restarts")
        arrays = {name: getattr(self, name) for name in (*names, "fk_evaluations")}
        if len(self.kinds) > 1:
            for name, errors in (
                ("position_error", self.position_errors),
                ("orientation_error", self.orientation_errors),
            ):
                arrays |= {f"{tip}.{name}": array for tip, array in errors.items()}
        return {name: array for name, array in arrays.items() if array is not None}

    def __repr__(self) -> str:
        """One line."""
        return f"BatchResult({len(self)} targets, {int(self.success.sum())} solved, solver='{self.solver}', {self.counts()})"
