"""The methods timed by Burrell et al. (2016) in plain form: J+ by a 3x3 inverse instead of an SVD, and all methods in numpy.

The interpreted versions (4x4 products, one goal at a time) exist to compare costs in an interpreter, as the paper did in
MATLAB; the toolkit's solvers do not use them.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...kernel.algebra import V3, Sym3
from ...robot.robot import Robot
from ...solvers.protocol import Asked, rule
from ...solvers.rules.state_space import StateSpace
from ..report import shipped_table

LIMIT = 1000  # Iteration limit of a solve.
# If det(JJ') is below this share of (trace(JJ') / 3)^3, the condition number of J is above about 1e4 and the inverse inaccurate.
NEAR_SINGULAR = 1e-8


@rule
class PlainPinv(NamedTuple):
    """Pseudo-inverse for positions: dq = J'(JJ')^-1 e, eq. (8); near a singularity it is computed by an SVD.

    In the SVD, singular values below the share `rcond` of the largest count as zero.
    """

    rcond: float = 1e-8

    def refuses(self, asked: Asked) -> str:
        """Return why the method cannot solve the task, '' if it can."""
        return "" if asked.rows == 3 else f"is for positions in space, and this task has {asked.rows} rows"

    def step(self, p, e):
        s = p.desk
        gram = Sym3(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # The sum over joints becomes the symmetric matrix JJ' (3, 3).
        for i in range(s.dq.shape[0]):
            u = V3(s.J[i, 0], s.J[i, 1], s.J[i, 2])
            gram = gram.plus(u, u)
        mean = (gram.xx + gram.yy + gram.zz) / 3.0
        if gram.determinant() > NEAR_SINGULAR * mean * mean * mean:
            f = gram.factors()
            y = f.back(f.scaled(f.forward(e.linear)))
            for i in range(s.dq.shape[0]):
                s.dq[i] = V3(s.J[i, 0], s.J[i, 1], s.J[i, 2]).dot(y)
        else:
            p.pseudo(e, self.rcond)
        return 0


# --------------------------------------------------------------------------------------------------------- interpreted
class Interpreted:
    """The solvers that the paper times, in interpreted numpy, for a robot with a table of D-H parameters."""

    def __init__(self, robot: Robot) -> None:
        """Read the D-H parameters of the robot, and the matrices of the tuned state-space solver with a single start."""
        rows = shipped_table(robot.name).rows
        self.joints = [(row.theta, row.d, row.a, math.cos(row.alpha), math.sin(row.alpha)) for row in rows]
        self.lower, self.upper = robot.lower, robot.upper
        tuned = StateSpace.preset("hydrolek-7w-one-map")
        self.A, self.B, self.C = (np.asarray(part, dtype=float) for part in (tuned.A, tuned.B, tuned.C))
        self.own_start = np.asarray(tuned.starts, dtype=float)[0]
        self.steps: dict[str, Callable[[list[np.ndarray], np.ndarray], np.ndarray]] = {
            "J+": lambda frames, e: np.linalg.pinv(jacobian(frames)) @ e,
            "J+, plain": self._plain,
            "J^T": self._transpose,
            "DLS, clipped": self._damped,
        }
        self.names = (*self.steps, "IK-PID", "state space")

    def frames(self, q: np.ndarray) -> list[np.ndarray]:
        """Return the poses (n + 1, 4, 4) of the D-H frames 0 to n in frame 0, at q (n,) [rad]."""
        T = np.eye(4)
        found = [T]
        for (offset, d, a, ca, sa), x in zip(self.joints, q.tolist(), strict=True):
            c, s = math.cos(x + offset), math.sin(x + offset)
            T = T @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
            found.append(T)
        return found

    def run(self, name: str, goal: np.ndarray, start: np.ndarray, tolerance: float) -> bool:
        """Solve one goal (3,) [m] by the method `name` from start (n,) [rad], and return whether it converged.

        The state-space solver ignores `start`, because it is tuned for a start of its own.
        """
        if name == "IK-PID":
            return self._pid(goal, start, tolerance)
        step = self.steps.get(name)
        q, x = (self.own_start if step is None else start).copy(), np.zeros(len(start))
        for _ in range(LIMIT):
            frames = self.frames(q)
            e = goal - frames[-1][:3, 3]
            if math.sqrt(e @ e) < tolerance:
                return True
            if step is None:
                dq = self.C @ x
                x = self.A @ x + self.B @ e
            else:
                dq = step(frames, e)
            new = np.minimum(np.maximum(q + dq, self.lower), self.upper)
            if step is not None and np.abs(new - q).max() < 1e-9:
                return False
            q = new
        return False

    def _pid(self, goal: np.ndarray, start: np.ndarray, tolerance: float) -> bool:
        """Solve a goal (3,) [m] by Algorithm I with the published gains (for mm and degrees); return whether it converged."""
        kp, ki, kd = (gain * 1000.0 * math.pi / 180.0 for gain in (0.012, 1e-7, 0.08))
        q = start.copy()

        def error(trial: np.ndarray) -> float:
            e = goal - self.frames(trial)[-1][:3, 3]
            return math.sqrt(e @ e)

        now = last = error(q)
        total = 0.0
        for _ in range(LIMIT):
            moved = False
            for i in reversed(range(len(q))):
                total += now
                delta = kp * now + ki * total + kd * (now - last)
                last = now
                best = q
                for trial in (q[i] + delta, q[i] - delta):
                    other = q.copy()
                    other[i] = min(max(trial, self.lower[i]), self.upper[i])
                    value = error(other)
                    if value < now:
                        now, best, moved = value, other, True
                q = best
                if now < tolerance:
                    return True
            if not moved:
                return False
        return False

    @staticmethod
    def _plain(frames: list[np.ndarray], e: np.ndarray) -> np.ndarray:
        J = jacobian(frames)
        return J.T @ np.linalg.solve(J @ J.T, e)

    @staticmethod
    def _transpose(frames: list[np.ndarray], e: np.ndarray) -> np.ndarray:
        J = jacobian(frames)
        g = J.T @ e
        h = J @ g
        return (g @ g) / max(h @ h, 1e-300) * g

    @staticmethod
    def _damped(frames: list[np.ndarray], e: np.ndarray) -> np.ndarray:
        J = jacobian(frames)
        # The damping factor of the paper is 100 mm, so its square is 0.01 m^2.
        return J.T @ np.linalg.solve(J @ J.T + 0.01 * np.eye(3), e)


def jacobian(frames: list[np.ndarray]) -> np.ndarray:
    """Return the position Jacobian (3, n) of a chain of revolute joints, given the poses of its frames."""
    tip = frames[-1][:3, 3]
    return np.array([np.cross(T[:3, 2], tip - T[:3, 3]) for T in frames[:-1]]).T
