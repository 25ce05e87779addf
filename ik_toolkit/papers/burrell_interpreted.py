"""Interpreted versions for Table II of Burrell et al. (2016): numpy, 4x4 products, one goal at a time.

They exist to compare costs in an interpreter, as the paper did in MATLAB; the toolkit's solvers do not use them.
"""

import math
from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

import numpy as np

from ..robot.dh import read_dh_table
from ..robot.library import find
from ..robot.robot import Robot
from ..solvers.rules.state_space import StateSpace

LIMIT = 1000


def _joints(robot: Robot) -> list[tuple[float, ...]]:
    """Rows (theta offset, d, a, cos alpha, sin alpha) of the robot's D-H table."""
    path = find(robot.name).path
    assert path is not None
    rows = read_dh_table(path.parent / "dh" / f"{robot.name}.toml").rows
    return [(row.theta, row.d, row.a, math.cos(row.alpha), math.sin(row.alpha)) for row in rows]


def _frames(joints: list[tuple[float, ...]], q: np.ndarray) -> list[np.ndarray]:
    """Frames 0 to n."""
    T = np.eye(4)
    frames = [T]
    for (offset, d, a, ca, sa), x in zip(joints, q.tolist(), strict=True):
        c, s = math.cos(x + offset), math.sin(x + offset)
        T = T @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
        frames.append(T)
    return frames


def _jacobian(frames: list[np.ndarray]) -> np.ndarray:
    tip = frames[-1][:3, 3]
    return np.array([np.cross(T[:3, 2], tip - T[:3, 3]) for T in frames[:-1]]).T


def interpreted_times(
    robot: Robot, points: np.ndarray, tolerances: Sequence[float], q0: np.ndarray
) -> dict[str, list[float]]:
    """Mean time a goal [ms] of J+, J^T, DLS and the tuned one-map state-space solver, over goals (N, 3) solved by all."""
    joints = _joints(robot)
    rule = StateSpace.preset("hydrolek-7w-one-map")
    A, B, C = (np.asarray(part, dtype=float) for part in (rule.A, rule.B, rule.C))
    own = np.asarray(rule.starts, dtype=float)[0]

    def pinv(frames: list[np.ndarray], e: np.ndarray) -> np.ndarray:
        return np.linalg.pinv(_jacobian(frames)) @ e

    def transpose(frames: list[np.ndarray], e: np.ndarray) -> np.ndarray:
        J = _jacobian(frames)
        g = J.T @ e
        h = J @ g
        return (g @ g) / max(h @ h, 1e-300) * g

    def dls(frames: list[np.ndarray], e: np.ndarray) -> np.ndarray:
        J = _jacobian(frames)
        return J.T @ np.linalg.solve(J @ J.T + 0.01 * np.eye(3), e)

    def run(step: Callable[..., np.ndarray] | None, goal: np.ndarray, start: np.ndarray, tolerance: float) -> bool:
        q, x = start.copy(), np.zeros(len(start))
        for _ in range(LIMIT):
            frames = _frames(joints, q)
            e = goal - frames[-1][:3, 3]
            if math.sqrt(e @ e) < tolerance:
                return True
            if step is None:
                dq = C @ x
                x = A @ x + B @ e
            else:
                dq = step(frames, e)
            new = np.minimum(np.maximum(q + dq, robot.lower), robot.upper)
            if step is not None and np.abs(new - q).max() < 1e-9:
                return False
            q = new
        return False

    steps: dict[str, Any] = {"J+": pinv, "J^T": transpose, "DLS": dls, "state space": None}
    times: dict[str, list[float]] = {name: [] for name in steps}
    for tolerance in tolerances:
        spent = np.zeros((len(steps), len(points)))
        solved = np.zeros((len(steps), len(points)), dtype=bool)
        for i, goal in enumerate(points):
            for k, (name, step) in enumerate(steps.items()):
                begun = perf_counter()
                solved[k, i] = run(step, goal, own if name == "state space" else q0, tolerance)
                spent[k, i] = perf_counter() - begun
        good = solved.all(axis=0)
        for k, name in enumerate(steps):
            times[name].append(1000.0 * float(spent[k, good].mean()))
    return times
