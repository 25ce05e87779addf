"""The status of a solve: how it ended."""

import enum
from typing import Any

import numpy as np

from ..robot.constraints import ConstraintCheck, constraints_at


class Status(enum.IntEnum):
    """How a solve ended; the numbers are those of the compiled search.

    - CONVERGED: both errors are within tolerance, confirmed by Pinocchio.
    - STALLED: no further progress: a local minimum of the error, or no improvement from any start.
    - ITERATION_LIMIT: the limit on evaluations, or on the iterations of every attempt, was reached first.
    - LIMIT_BLOCKED: joint limits block the way to the target; the message names the joints.
    - UNREACHABLE: proven out of reach, by a bound from the link lengths, by a closed form or by elimination; the message says
      by how much, or that the proof is certified.
    - SINGULAR: no joint motion reduces the error to first order.
    - NOT_FINITE: the solver diverged, usually because the gains are too high.
    - CHECK_FAILED: the kernel reported success but Pinocchio did not confirm it: a bug.
    - COLLISION: the target was reached, but every solution found is in collision (only with avoid_collisions).
    - TOO_FAR: the solution, if there is one, is further from q0 than follow allows a joint to move.
    - CONSTRAINT_OPEN: the target is reached, but a loop, a curved equality or a tendon over several joints of the MJCF is
      open by more than the tolerance; the message says by how much.
    """

    # Code that tests the status of result rows compares it with the plain numbers `CODE` of kernel/checks.py, because comparing an
    # array with an enum takes numpy microseconds.
    CONVERGED = 0
    STALLED = 1
    ITERATION_LIMIT = 2
    LIMIT_BLOCKED = 3
    UNREACHABLE = 4
    SINGULAR = 5
    NOT_FINITE = 6
    CHECK_FAILED = 7
    COLLISION = 10  # 8 and 9 are internal codes of the compiled search
    TOO_FAR = 11
    CONSTRAINT_OPEN = 12


# The field `excess` of a result row is usually a length [m] by which the target is out of reach. Three negative values say where
# the answer comes from. SEARCHED: a closed form failed, and q or the status came from the iterative search after it.
SEARCHED = -1.0
DECIDED = -2.0  # The elimination found q, or certified that no q reaches the target (see `decide`).
# NEAREST: the elimination found q, and certified that no other solution within the limits is nearer to q0.
NEAREST = -3.0


def is_proven(status: Any, excess: Any, plan: Any) -> Any:
    """Return whether it is proven that a target has no solution within the limits (or none nearer than q), for `Result.proven`.

    status, excess: numbers or arrays from the result rows of the plan. Of a closed form that fits the arm only roughly, the
    search decides the status, which is then no proof (SEARCHED). Where a prismatic joint is free, a closed form looks numerically
    for branches within the limits; LIMIT_BLOCKED is then a proof only if no legal value of that joint reaches the target.
    """
    said = plan.row.closed & (status == Status.LIMIT_BLOCKED) & (excess != SEARCHED)
    if plan.row.closed and plan.robot.slides.any() and not plan.rule.held(plan.robot):
        said &= excess > 0.0
    blocked = (excess == DECIDED) & (status == Status.LIMIT_BLOCKED)
    nearest = (excess == NEAREST) & (status == Status.CONVERGED)
    return said | (status == Status.UNREACHABLE) | nearest | blocked


def count_statuses(numbers: np.ndarray) -> dict[str, int]:
    """Count how many of the status numbers (N,) there are of each Status, by name; only those that occur are listed."""
    found, counts = np.unique(numbers, return_counts=True)
    return {Status(int(k)).name: int(c) for k, c in zip(found, counts, strict=True)}


def constraints_of(robot: Any, q: np.ndarray, options: Any) -> ConstraintCheck:
    """Check the closed loops and other constraints of the robot's description at q (n,), with the tolerances of the options."""
    return constraints_at(robot, q, options.position_tolerance, options.orientation_tolerance)
