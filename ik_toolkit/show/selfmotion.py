"""Self-motion: moving the joints of a redundant arm while its tips stay in place."""

from typing import Any

import numpy as np

STEP = 0.02  # [rad, or reaches] between corrections: the tip error grows with its square
THIN = 1e-6  # singular value over the largest below which a direction does not move the tips
CORRECTIONS = 3  # Newton steps, each of which squares the remaining error
LEFT = 1e-7  # [m, rad] largest tip error that counts as staying in place


def freedom(robot: Any, q: np.ndarray, turns: bool) -> np.ndarray:
    """Null-space directions (k, n) at q (n,): no tip moves; turns: whether the tips' rotations are held, too."""
    J = _rows(robot, q, turns)
    _, sizes, V = np.linalg.svd(J, full_matrices=True)
    return V[int((sizes > THIN * max(sizes.max(initial=0.0), 1e-12)).sum()) :]


def slide(robot: Any, q: np.ndarray, along: np.ndarray, far: float, turns: bool, limits: bool) -> np.ndarray:
    """Move `far` [rad, or reaches] from q (n,) along the self-motion nearest the direction `along` (n,); stops at a joint limit.

    Each step continues in the direction that the null space shares with the previous step, so that moving back is reversible.
    """
    start, unit = q, np.where(robot.slides, robot.reach, 1.0)
    done, at = 0.0, along / unit
    while done < abs(far):
        free = freedom(robot, q, turns) / unit
        free = np.linalg.qr(free.T)[0].T if len(free) else free
        at = free.T @ (free @ at)
        if np.linalg.norm(at) < THIN:
            break
        at /= np.linalg.norm(at)
        step = min(STEP, abs(far) - done)
        new = _corrected(robot, start, q + np.sign(far) * step * at * unit, turns)
        if new is None or (limits and robot.outside(new)):
            break
        q, done = new, done + step
    return q


def _corrected(robot: Any, start: np.ndarray, q: np.ndarray, turns: bool) -> np.ndarray | None:
    """Nearest q (n,) with the tips where they are at `start`; None if not found."""
    error = np.zeros(0)
    for _ in range(CORRECTIONS + 1):
        error = _away(robot, start, q, turns)
        if np.abs(error).max() < LEFT:
            return q
        q = q + np.linalg.lstsq(_rows(robot, q, turns), error, rcond=THIN)[0]
    return None


def _rows(robot: Any, q: np.ndarray, turns: bool) -> np.ndarray:
    """Stacked Jacobian of the tips; positions only if rotations are not held."""
    J = robot.jacobian(q).reshape(-1, 6, robot.n)
    return (J if turns else J[:, :3]).reshape(-1, robot.n)


def _away(robot: Any, start: np.ndarray, q: np.ndarray, turns: bool) -> np.ndarray:
    """Error from the tips at q to those at `start`: positions [m] and, if they count, rotation vectors [rad]."""
    import pinocchio as pin

    left = []
    for arm, place in zip(robot.arms, robot.places, strict=True):
        goal, now = arm.fk(start[place]), arm.fk(q[place])
        left.append(goal.translation - now.translation)
        if turns:
            left.append(pin.log3(goal.rotation @ now.rotation.T))
    return np.concatenate(left)
