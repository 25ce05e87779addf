"""Study of singularities: which solvers stall at a start, which escape, and how near to singular configurations they pass."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..robot.robot import Robot
from ..robot.tree import require_one_tip
from ..solvers.batch.solve_batch import solve_batch
from ..solvers.registry import find_row
from ..solvers.solve import Solver
from ..validate import solver_list
from .benchmark import wilson

# [rad, or share of the reach] A solve counts as stuck at its start if no joint ever moves farther than this.
STUCK = 1e-9


@dataclass(frozen=True)
class Run:
    """A recorded solve: how near to singular the arm was at each of its k evaluations.

    Attributes:
        solver: Name of the solver.
        success: Whether it converged.
        status: Name of its status.
        iterations: Number of iterations.
        position_error: (k,) distance of the tip from the target [m].
        manipulability: (k,) product of the singular values of the Jacobian, with lengths over the robot's length scale.
        condition: (k,) largest over smallest singular value, infinite at a singular configuration.
        q: (k, n) configurations [rad or m].
        stands_still: Whether no joint ever moved.
    """

    solver: str
    success: bool
    status: str
    iterations: int
    position_error: np.ndarray
    manipulability: np.ndarray
    condition: np.ndarray
    q: np.ndarray
    stands_still: bool


def measures(robot: Robot, Q: np.ndarray, position_only: bool = True) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measure how near configurations are to singular ones.

    Directions in which the tip moves at no configuration, such as that across a planar arm's plane, are left out; lengths are
    divided by the robot's length scale.

    Args:
        robot: A robot with one tip.
        Q: (N, n) configurations [rad or m].
        position_only: Whether only the position of the tip counts.

    Returns:
        Manipulability (N,) (Yoshikawa 1985), condition number (N,) and smallest singular value (N,).

    Raises:
        InvalidConfiguration: Q does not fit the robot.
    """
    require_one_tip(robot, "a study of singularities")
    Q = np.array([robot.check_q(q) for q in Q]).reshape(-1, robot.n)
    anywhere = robot.random_q(np.random.default_rng(0), 8)
    J = robot.chain.forward(np.vstack([Q, anywhere]), jacobian=True)[1] * robot.chain.unit
    J = J[:, : 3 if position_only else 6]
    J[:, :3] /= robot.chain.scale
    directions, sizes, _ = np.linalg.svd(np.hstack([*J[len(Q) :]]))
    values = np.linalg.svd(directions[:, sizes > 1e-9].T @ J[: len(Q)], compute_uv=False)
    least, most = values[:, -1], values[:, 0]
    safe = least > 1e-12 * np.maximum(most, 1e-300)
    condition = np.where(safe, most / np.where(safe, least, 1.0), np.inf)
    return np.where(safe, np.prod(values, axis=1), 0.0), condition, np.where(safe, least, 0.0)


def run(robot: Robot, target: np.ndarray, solver: Any, q0: np.ndarray, **options: Any) -> Run:
    """Solve one target from q0 (n,) without restarts, and measure the Jacobian at each evaluation.

    target: pose (4, 4) or position (3,) [m]; solver and options: as for `ik.solve`.
    """
    require_one_tip(robot, "a study of singularities")
    asked: dict[str, Any] = {"restarts": 0, **options, "history": True}
    bound = Solver(robot, solver, **asked)
    result = bound(np.asarray(target, dtype=float), q0=np.asarray(q0, dtype=float))
    history = result.history or {}
    Q = history["q"]
    product, condition, _ = measures(robot, Q, np.ndim(target) == 1)
    return Run(
        bound.name,
        result.success,
        result.status.name,
        result.iterations,
        history["position_error"],
        product,
        condition,
        Q,
        bool((np.abs(Q - Q[0]) / robot.chain.unit).max() <= STUCK),
    )


@dataclass(frozen=True)
class Escape:
    """How often one solver succeeds from a (singular) start, and how often from a slightly different one.

    Attributes:
        solver: Name of the solver.
        targets: Number of targets.
        solved: Targets solved from the start.
        stood_still: Targets at which no joint moved.
        solved_offset: Targets solved from the start moved by the offset.
        iterations: Mean number of iterations of the targets solved from the start.
    """

    solver: str
    targets: int
    solved: int
    stood_still: int
    solved_offset: int
    iterations: float

    def to_dict(self) -> dict[str, Any]:
        """Return the counts as plain numbers, with the 95 % Wilson interval of the success rate."""
        return {
            "targets": self.targets,
            "solved": self.solved,
            "wilson_95": list(wilson(self.solved, self.targets)),
            "stood_still": self.stood_still,
            "solved_with_start_moved": self.solved_offset,
            "mean_iterations": self.iterations,
        }


def escapes(
    robot: Robot, targets: np.ndarray, solvers: Sequence[Any], q0: np.ndarray, offset: float = 1e-6, **options: Any
) -> list[Escape]:
    """Count how often solvers succeed from a start that may be singular, and from a slightly different one, without restarts.

    Args:
        robot: A robot with one tip.
        targets: (N, 4, 4) poses or (N, 3) positions [m].
        solvers: One or several names, classes or instances.
        q0: (n,) start [rad or m].
        offset: Largest distance of the other start in each joint [rad or reaches].
        **options: As for `ik.solve_batch`.

    Returns:
        The counts of each solver.
    """
    require_one_tip(robot, "a study of singularities")
    rng = np.random.default_rng(0)
    q0 = np.asarray(q0, dtype=float)
    moved = np.clip(q0 + offset * rng.uniform(0.5, 1.0, robot.n) * robot.chain.unit, robot.lower, robot.upper)
    found = []
    for solver in solver_list(solvers):
        here = solve_batch(robot, targets, solver, q0=q0, restarts=0, check=0.0, **options)
        beside = solve_batch(robot, targets, solver, q0=moved, restarts=0, check=0.0, **options)
        still = ~here.success & ((np.abs(here.q - q0) / robot.chain.unit).max(axis=1) <= STUCK)
        steps = here.iterations[here.success]
        found.append(
            Escape(
                find_row(solver).name,
                len(here),
                int(here.success.sum()),
                int(still.sum()),
                int(beside.success.sum()),
                float(steps.mean()) if len(steps) else float("nan"),
            )
        )
    return found
