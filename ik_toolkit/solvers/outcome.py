"""One solve as it ended: what a Result reads, and what the finishing steps change."""

from functools import partial
from typing import NamedTuple

import numpy as np

from ..kernel.counted_error import FREE, POSITION
from ..kernel.records import ANSWER, AT, MISS
from .plan import Plan

Errors = list[tuple[float, float | None]]  # position [m] and rotation angle [rad] (None: free) of each tip
SPOKEN = (POSITION, FREE)  # kinds of target that leave the orientation free


class SolveRecord(NamedTuple):
    """One solve as it ended; a Result reads it. Finishing steps (see `finish`) return a changed copy."""

    plan: Plan
    T: np.ndarray  # (1, 4, 4), of several tips (1, F, 4, 4)
    kinds: tuple
    start: np.ndarray  # (1, n)
    given: bool
    row: np.ndarray  # Answer, q, then of several tips the Miss of each
    elapsed: float
    notice: str = ""
    errors: Errors | None = None  # computed again by Pinocchio
    history: dict[str, np.ndarray] | None = None
    collision: tuple[str, str] | None = None

    def left(self) -> Errors:
        """Errors of each tip: Pinocchio's where it was asked, otherwise the kernel's."""
        if self.errors is not None:
            return self.errors
        if len(self.kinds) == 1:
            each = [(float(self.row[AT.position]), float(self.row[AT.rotation]))]
        else:
            each = self._misses()[:, :2].tolist()
        return [(p, None if kind in SPOKEN else r) for (p, r), kind in zip(each, self.kinds, strict=True)]

    def excess(self) -> list[float]:
        """By how much [m] the target of each tip is beyond its reach; 0: not proven."""
        return [float(self.row[AT.excess])] if len(self.kinds) == 1 else self._misses()[:, 2].tolist()

    def _misses(self) -> np.ndarray:
        return self.row[ANSWER + self.plan.robot.n :].reshape(-1, MISS)


make_outcome = partial(
    tuple.__new__, SolveRecord
)  # from all its fields: a fifth of a microsecond faster than Outcome(...)
