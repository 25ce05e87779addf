"""What a batch returns: arrays with a row per target."""

from typing import Any

import numpy as np

from ..errors import IKError
from ..kernel.records import ANSWER, AT
from .result import Result, Status
from .solve import Solver

R_MOVE = AT.history  # a batch keeps no history; in a chain its slot holds the largest joint move
JUMP = 0.5  # rad, or of the robot's scale for slides


class BatchInterrupted(KeyboardInterrupt):
    """Ctrl-C during a batch; `result` is the BatchResult of the targets finished before it, from the first on."""

    def __init__(self, result: "BatchResult") -> None:
        """Keep what was finished."""
        super().__init__(f"interrupted after {len(result)} targets")
        self.result = result


class BatchCheckFailed(IKError):
    """Pinocchio does not confirm an answer of a batch: the solver is wrong for this robot, so no row is a success.

    result: BatchResult whose rows all have the status CHECK_FAILED; target: number of the first that is not confirmed. From
    `solve_batch` the result has every row, with NaN where the batch ended before; from `solve_parts` it is the part that failed.
    """

    def __init__(self, result: "BatchResult", target: int, before: int) -> None:
        """Keep the rows; `before` counts those already handed out."""
        doubt = f" The {before} answers handed out before it are in doubt too." if before else ""
        super().__init__(
            f"Pinocchio does not confirm the answer to target {target}, so no answer of this batch can be trusted.{doubt}"
            " Please report this with the robot and the target."
        )
        self.result = result
        self.target = target
        self.before = before

    def __reduce__(self) -> tuple:
        """Pickle by what it is made of."""
        return type(self), (self.result, self.target, self.before)


class BatchResult:
    """Answers of a batch, row k belonging to target k.

    q (N, n) [rad or m]; status (N,) numbers of Status; success (N,) bool; position_error (N,) [m]; orientation_error (N,)
    [rad], None for positions; iterations, restarts, fk_evaluations (N,). For a chain: moves (N,) and flips, else None.
    batch[k] is the Result of target k, with its sentence.
    """

    def __init__(self, table: np.ndarray, position_only: bool, solver: Solver | None, chain: bool = False) -> None:
        """Wrap the kernel's rows (N, ANSWER + n)."""
        self._table = table
        self._solver = solver
        self.position_only = position_only
        self.solver = solver.row.name if solver is not None else ""
        self.chain = chain

    def __len__(self) -> int:
        """Number of targets."""
        return len(self._table)

    def __getitem__(self, k: int) -> Result:
        """Result of target k."""
        row = self._table[k]
        if self._solver is None:
            raise IndexError("an empty batch")
        result = Result(self._solver, row, 0.0, self.position_only)
        if row[AT.status] == Status.COLLISION and self._solver.collision is not None:
            result.collision = self._solver.collision.collisions(result.q)[0]
        return result

    q = property(lambda self: self._table[:, ANSWER:])
    status = property(lambda self: self._table[:, AT.status].astype(np.int64))
    success = property(lambda self: self._table[:, AT.status] == Status.CONVERGED)
    position_error = property(lambda self: self._table[:, AT.position])
    orientation_error = property(lambda self: None if self.position_only else self._table[:, AT.rotation])
    iterations = property(lambda self: self._table[:, AT.iterations].astype(np.int64))
    restarts = property(lambda self: self._table[:, AT.restarts].astype(np.int64))
    fk_evaluations = property(lambda self: self._table[:, AT.evaluations].astype(np.int64))

    @property
    def moves(self) -> np.ndarray | None:
        """Largest joint move (N,) from the answer before [rad, or of the robot's scale]; NaN where there is no answer."""
        return self._table[:, R_MOVE] if self.chain else None

    @property
    def flips(self) -> np.ndarray | None:
        """Rows of a chain whose answer is more than 0.5 rad (or of the robot's scale) away from the one before."""
        return np.flatnonzero(self._table[:, R_MOVE] > JUMP) if self.chain else None

    def counts(self) -> dict[str, int]:
        """How many targets ended with each status."""
        numbers, counts = np.unique(self._table[:, AT.status], return_counts=True)
        return {Status(int(k)).name: int(c) for k, c in zip(numbers, counts, strict=True)}

    def to_dict(self) -> dict[str, Any]:
        """Arrays by name, for np.savez and tables."""
        names = ("q", "status", "success", "position_error", "orientation_error", "iterations", "restarts")
        arrays = {name: getattr(self, name) for name in (*names, "fk_evaluations", "moves")}
        return {name: array for name, array in arrays.items() if array is not None}

    def __repr__(self) -> str:
        """One line."""
        flips = f", {len(self.flips)} flips" if self.flips is not None else ""
        return f"BatchResult({len(self)} targets, {int(self.success.sum())} solved{flips}, solver='{self.solver}', {self.counts()})"
