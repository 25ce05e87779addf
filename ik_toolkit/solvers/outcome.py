"""One solve as it ended: a Result reads it, and the finishing steps change it."""

from functools import partial
from typing import NamedTuple

import numpy as np

from ..kernel.counted_error import KIND
from ..kernel.records import AT, SIZE
from .plan import Plan

# type of the errors left after a solve: for each tip the position error [m] and rotation angle [rad] (None if rotation is free)
Errors = list[tuple[float, float | None]]
SPOKEN = (KIND.position, KIND.free)  # kinds of target that leave the orientation free


class SolveRecord(NamedTuple):
    """Everything that one solve has produced (target, start, q, errors, time), from which `Result` computes its attributes.

    The record itself never changes: a step that refines an answer after the search (`postprocess.finishing`) returns a changed
    copy.
    """

    # The target and q0 are copied, because the caller may change both arrays later. They are copied to bytes, which takes a quarter
    # of the time of copying an array.
    plan: Plan
    target: bytes  # the targets (1, 4, 4), for several tips (1, F, 4, 4), or b"" in a solved row of a batch
    kinds: tuple
    q0: bytes  # the configuration (n,) given as the start, or b""
    # array that the compiled search returns for a target: the fields of `records.Answer`, then q, then for several tips the errors
    # of each tip (`records.Miss`)
    row: np.ndarray
    elapsed: float  # duration of the call [s], without the time in which code was compiled
    notice: str = ""
    errors: Errors | None = None  # the errors as Pinocchio has computed them, or None
    history: dict[str, np.ndarray] | None = None
    collision: tuple[str, str] | None = None
    compile_time: float = 0.0  # [s] time spent compiling or loading code

    @property
    def given(self) -> bool:
        """Whether the caller gave a start (q0)."""
        return bool(self.q0)

    @property
    def T(self) -> np.ndarray:
        """Target pose (1, 4, 4), for several tips (1, F, 4, 4); empty in a solved row of a batch."""
        return np.frombuffer(self.target).reshape(-1, *self.plan.robot.pose_shape).copy()

    @property
    def start(self) -> np.ndarray:
        """Configuration (1, n) at which the solve began: q0 if it was given, otherwise home."""
        return np.frombuffer(self.q0)[None].copy() if self.q0 else self.plan.home

    def left(self) -> Errors:
        """Return the position error [m] and rotation error [rad] (None if it is free) of each tip.

        They are Pinocchio's if it has computed them, otherwise those of the compiled search.
        """
        if self.errors is not None:
            return self.errors
        if len(self.kinds) == 1:
            each = [(float(self.row[AT.position]), float(self.row[AT.rotation]))]
        else:
            each = self._misses()[:, :2].tolist()
        return [(p, None if kind in SPOKEN else r) for (p, r), kind in zip(each, self.kinds, strict=True)]

    def excess(self) -> list[float]:
        """Return by how much [m] each tip's target is proven out of reach; 0 means that it is not proven."""
        return [float(self.row[AT.excess])] if len(self.kinds) == 1 else self._misses()[:, 2].tolist()

    def _misses(self) -> np.ndarray:
        return self.row[self.plan.q_columns.stop :].reshape(-1, SIZE.miss)


# `make_outcome(values)` makes a record 0.2 microseconds faster than a call of the class.
make_outcome = partial(tuple.__new__, SolveRecord)
