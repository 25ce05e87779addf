"""All solutions of all poses, for two structures: three parallel axes, and six axes of which 2, 3, 4 are parallel and 5, 6 meet.

The second is that of Universal Robots. Vectorised over poses: a path needs this to prove that it has the fewest
reconfigurations. Source: the geometry of Hawkins (2013), "Analytic inverse kinematics for the Universal Robots UR-5/UR-10 arms",
with screws instead of its tables.
"""

from typing import Any

import numpy as np

from ..solvers.closed_form.geometry import Screws, read_screws

PARALLEL = 1e-6  # sine of the angle, and distance over the reach, that still count as zero
DOUBTFUL = 1e-7  # nearness of a cosine to 1 or of a length to 0 at which two solutions merge, or a whole family exists
EXACT = 1e-5  # [m, rad] largest errors of a solution: the precision to which models are written


def solutions(robot: Any, T: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """All solutions (N, K, n) of poses T (N, 4, 4), and whether these are certainly all (N,).

    Limits and full turns are ignored; NaN where there are fewer. None for a robot of another structure.
    """
    s = None if robot.by_tip else read_screws(robot.chain)
    if not isinstance(s, Screws) or not s.turns.all():
        return None
    made = None
    with np.errstate(invalid="ignore", divide="ignore"):
        if robot.n == 3 and _parallel(s.axis):
            made = _planar(s, 0, T @ np.linalg.inv(s.T))
        elif robot.n == 6 and _parallel(s.axis[1:4]) and not _parallel(s.axis[:2]):
            meet = _meeting(s, robot.chain.reach)
            made = None if meet is None else _arm(s, meet, T)
    if made is None:
        return None
    Q, sure = made
    reached = robot.chain.forward(np.nan_to_num(Q.reshape(-1, robot.n)))[0].reshape(*Q.shape[:2], 4, 4)
    Q[np.abs(reached - T[:, None]).max(axis=(2, 3)) > EXACT] = np.nan
    return Q, sure


def _parallel(axes: np.ndarray) -> bool:
    return bool(np.linalg.norm(np.cross(axes[1:], axes[0]), axis=1).max() < PARALLEL)


def _meeting(s: Screws, reach: float) -> np.ndarray | None:
    """Point where axes 5 and 6 meet, or None."""
    across = np.cross(s.axis[4], s.axis[5])
    size = np.linalg.norm(across)
    if size < PARALLEL or abs((s.point[5] - s.point[4]) @ across) > PARALLEL * reach * size:
        return None
    along = np.cross(s.point[5] - s.point[4], s.axis[5]) @ across / size**2
    return s.point[4] + along * s.axis[4]


def _turn(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) about a unit axis."""
    K = np.cross(axis, np.eye(3)).T
    c, d = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    return c * np.eye(3) + d * K + (1.0 - c) * np.outer(axis, axis)


def _screw(s: Screws, i: int, angle: np.ndarray) -> np.ndarray:
    """Transforms (N, 4, 4) of joint i at angles (N,)."""
    made = np.tile(np.eye(4), (len(angle), 1, 1))
    made[:, :3, :3] = _turn(s.axis[i], angle)
    made[:, :3, 3] = s.point[i] - made[:, :3, :3] @ s.point[i]
    return made


def _wave(a: Any, b: Any, c: Any) -> tuple[list[np.ndarray], np.ndarray]:
    """Both solutions of a cos q + b sin q = c, NaN where there is none, and where the count is certain."""
    size = np.hypot(a, b)
    cosine = c / size
    swing = np.arccos(cosine)
    middle = np.arctan2(b, a)
    return [middle + swing, middle - swing], (size > DOUBTFUL) & (np.abs(np.abs(cosine) - 1.0) > DOUBTFUL)


def _angle(axis: np.ndarray, start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles that rotate start onto end (N, 3) about a unit axis, and where these are certain."""
    x = start - (start @ axis)[:, None] * axis
    y = end - (end @ axis)[:, None] * axis
    return np.arctan2(np.cross(x, y) @ axis, (x * y).sum(axis=1)), (x * x).sum(axis=1) > DOUBTFUL


def _planar(s: Screws, k: int, E: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solutions (N, 2, 3) of joints k, k + 1, k + 2, whose axes are parallel, for transforms E (N, 4, 4)."""
    a, N = s.axis[k], len(E)
    signs = np.sign(s.axis[k : k + 3] @ a)
    first, second = (v - (v @ a) * a for v in np.diff(s.point[k : k + 3], axis=0))
    r = E[:, :3, :3] @ s.point[k + 2] + E[:, :3, 3] - s.point[k]
    r -= (r @ a)[:, None] * a
    side = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
    total, _ = _angle(a, np.tile(side, (N, 1)), E[:, :3, :3] @ side)
    inside = 0.5 * ((r * r).sum(axis=1) - first @ first - second @ second)
    elbows, sure = _wave(first @ second, first @ np.cross(a, second), inside)
    Q = np.empty((N, 2, 3))
    for j, elbow in enumerate(elbows):
        shoulder, clear = _angle(a, first + _turn(a, elbow) @ second, r)
        sure &= clear | np.isnan(elbow)
        Q[:, j] = np.column_stack([shoulder, elbow, total - shoulder - elbow]) * signs
    return Q, sure


def _arm(s: Screws, w: np.ndarray, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solutions (N, 8, 6) of six joints with axes 2, 3, 4 parallel and axes 5, 6 through w (3,)."""
    a, N = s.axis, len(T)
    D = T @ np.linalg.inv(s.T)
    v = D[:, :3, :3] @ w + D[:, :3, 3] - s.point[0]
    along = v @ a[0]
    v -= along[:, None] * a[0]
    firsts, sure = _wave(v @ a[1], -np.cross(a[0], v) @ a[1], a[1] @ (w - s.point[0]) - (a[1] @ a[0]) * along)
    Q, place = np.full((N, 8, 6), np.nan), 0
    tilt = a[5] - (a[4] @ a[5]) * a[4]
    for q1 in firsts:
        back = _screw(s, 0, -q1) @ D
        R = back[:, :3, :3]
        fifths, known = _wave(a[1] @ tilt, a[1] @ np.cross(a[4], a[5]), R @ a[5] @ a[1] - (a[1] @ a[4]) * (a[4] @ a[5]))
        sure &= known | np.isnan(q1)
        for q5 in fifths:
            q6, known = _angle(a[5], np.swapaxes(R, 1, 2) @ a[1], _turn(a[4], -q5) @ a[1])
            sure &= known | np.isnan(q5)
            arm, known = _planar(s, 1, back @ _screw(s, 5, -q6) @ _screw(s, 4, -q5))
            sure &= known | np.isnan(q5)
            for j in range(2):
                Q[:, place] = np.column_stack([q1, arm[:, j], q5, q6])
                place += 1
    return Q, sure
