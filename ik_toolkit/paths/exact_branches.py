"""All solutions of all poses of a path, and the choice of multiples of 2 pi along it.

A path needs all solutions to prove that it has the fewest reconfigurations. Two kinds of arm have them in closed form: three
parallel axes, or six axes of which 2, 3, 4 are parallel and 5, 6 meet (Universal Robots). The geometry is that of Hawkins (2013),
"Analytic inverse kinematics for the Universal Robots UR-5/UR-10 arms", with joint screws instead of its tables. For other arms of
six revolute joints the elimination lists and certifies them.

A joint whose range exceeds 2 pi has each solution several times, 2 pi apart. Whether a continuous piece of a path fits the limits
of such a joint depends on how far the joint winds up along the whole piece, which no single step shows. So paths are first searched
without these limits (see `unwound`). If the best path does not fit, the joint's solutions are copied, shifted by 2 pi, to wherever
they are inside the limits (see `copies`), and the limits are kept from pose to pose.
"""

from typing import Any

import numpy as np

from ..kernel.elimination.binding import answers
from ..kernel.elimination.terms import VERDICT
from ..kernel.kinematics import TAU
from ..solvers.closed_form.geometry import Screws, read_screws
from ..solvers.decide import arm_of, elimination_plan

PARALLEL = 1e-6  # largest sine between parallel axes, and largest distance between intersecting axes over the reach
# If a cosine is this close to 1 or a length [m] this close to 0, two solutions may merge or infinitely many exist.
DOUBTFUL = 1e-7
# largest error of the pose that a solution reaches [m, or rotation matrix entries]; it allows for rounded numbers in robot files
EXACT = 1e-5


def every_solution(plan: Any, T: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Return all solutions (N, K, n) [rad] of the poses T (N, 4, 4), and for each pose (N,) whether they are proven to be all.

    They are found by `solutions` or, for an arm of six revolute joints with no formula there, by elimination. For all other arms
    the result is None.
    """
    found = solutions(plan.robot, T)
    exact = elimination_plan(plan) if found is None else None
    if exact is None:
        return found
    said = answers(*arm_of(exact), np.ascontiguousarray(T))
    count = said[:, 0, 0].astype(int)
    Q = said[:, 1 : 1 + max(1, int(count.max(initial=0))), :6].copy()
    Q[np.arange(Q.shape[1]) >= count[:, None]] = np.nan
    return Q, said[:, 0, 1] == VERDICT.certain


def solutions(robot: Any, T: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Return all solutions (N, K, n) [rad] of the poses T (N, 4, 4), and for each pose (N,) whether they are proven to be all.

    A pose with fewer than K solutions has rows of NaN. Joint limits and shifts by 2 pi are ignored. The result is None unless the
    arm is planar with three revolute joints, or has six, of which the axes of the second to fourth are parallel and those of the
    last two meet.
    """
    s = read_screws(robot.chain)
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
    """Return the point (3,) [m] at q = 0 where axes 5 and 6 meet, None if they do not; reach: the arm's reach [m]."""
    across = np.cross(s.axis[4], s.axis[5])
    size = np.linalg.norm(across)
    if size < PARALLEL or abs((s.point[5] - s.point[4]) @ across) > PARALLEL * reach * size:
        return None
    along = np.cross(s.point[5] - s.point[4], s.axis[5]) @ across / size**2
    return s.point[4] + along * s.axis[4]


def _turn(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the rotations (N, 3, 3) about a unit axis (3,) by the angles (N,) [rad]."""
    K = np.cross(axis, np.eye(3)).T
    c, d = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    return c * np.eye(3) + d * K + (1.0 - c) * np.outer(axis, axis)


def _screw(s: Screws, i: int, angle: np.ndarray) -> np.ndarray:
    """Return the displacements (N, 4, 4) that joint i produces between q = 0 and the angles (N,) [rad], in base axes."""
    made = np.tile(np.eye(4), (len(angle), 1, 1))
    made[:, :3, :3] = _turn(s.axis[i], angle)
    made[:, :3, 3] = s.point[i] - made[:, :3, :3] @ s.point[i]
    return made


def _wave(a: Any, b: Any, c: Any) -> tuple[list[np.ndarray], np.ndarray]:
    """Solve a cos q + b sin q = c for N equations.

    Returns both solutions, each (N,) [rad] and NaN where none exists, and whether (N,) their number is beyond doubt.
    """
    size = np.hypot(a, b)
    cosine = c / size
    swing = np.arccos(cosine)
    middle = np.arctan2(b, a)
    return [middle + swing, middle - swing], (size > DOUBTFUL) & (np.abs(np.abs(cosine) - 1.0) > DOUBTFUL)


def _angle(axis: np.ndarray, start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the angles (N,) [rad] about a unit axis (3,) that rotate the vectors `start` into `end` (N, 3).

    Also returns whether (N,) the angle is defined, which it is unless `start` is along the axis.
    """
    x = start - (start @ axis)[:, None] * axis
    y = end - (end @ axis)[:, None] * axis
    return np.arctan2(np.cross(x, y) @ axis, (x * y).sum(axis=1)), (x * x).sum(axis=1) > DOUBTFUL


def _planar(s: Screws, k: int, E: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the angles of three joints with parallel axes that together produce given displacements from q = 0.

    k: index of the first of the three joints; E (N, 4, 4): the displacements. Returns the solutions (N, 2, 3) [rad], NaN where none
    exists, and whether (N,) their number is beyond doubt.
    """
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
    """Solve an arm of six joints for poses T (N, 4, 4): axes 2, 3, 4 are parallel, axes 5 and 6 meet in w (3,).

    The point w [m] is given at q = 0. Returns the solutions (N, 8, 6) [rad], NaN where none exists, and whether (N,)
    their number is beyond doubt.
    """
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


ROUNDING = 1e-6  # [rad] a joint limit may be exceeded by this much, because solutions are stored in single precision


def alive(Q: np.ndarray, span: np.ndarray, limits: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return whether (N, K) each of the K tracks Q (N, K, n) exists at each of N poses and keeps the joint limits there.

    A track is one solution continued along the poses, from pose span[k, 0] to pose span[k, 1]. limits (2 or more, n): lower and
    upper; joints (n,): which joints must keep them. All in internal units (rad, lengths / reach).
    """
    t = np.arange(len(Q))[:, None]
    there = (span[:, 0] <= t) & (t <= span[:, 1])
    for i in np.flatnonzero(joints):
        there &= (Q[:, :, i] >= limits[0, i] - ROUNDING) & (Q[:, :, i] <= limits[1, i] + ROUNDING)
    return there


def copies(Q: np.ndarray, span: np.ndarray, i: int, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Copy tracks, with joint i shifted by 2 pi k, wherever part of them then lies inside the joint's limits low, high [rad].

    A track is one solution continued along the poses: Q (N, K, n), from pose span[k, 0] to pose span[k, 1] (K, 2). Returns the new
    tracks and spans.
    """
    t = np.arange(len(Q))[:, None]
    there = (span[:, 0] <= t) & (t <= span[:, 1])
    least = np.where(there, Q[:, :, i], np.inf).min(axis=0)
    most = np.where(there, Q[:, :, i], -np.inf).max(axis=0)
    first = np.ceil((low - ROUNDING - most) / TAU).astype(int)
    last = np.floor((high + ROUNDING - least) / TAU).astype(int)
    made, spans = [], []
    for turn in range(int(first.min()), int(last.max()) + 1):
        fits = (first <= turn) & (turn <= last)
        part = Q[:, fits].copy()
        part[:, :, i] += np.float32(TAU * turn)
        made.append(part)
        spans.append(span[fits])
    return np.concatenate(made, axis=1), np.concatenate(spans)


def unwound(
    q: np.ndarray,
    breaks: list[int],
    free: np.ndarray,
    limits: np.ndarray,
    ends: tuple[np.ndarray | None, np.ndarray | None],
    fixed: list[bool],
) -> set[int]:
    """Choose multiples of 2 pi for the joints `free` (n,) along a path q (N, n) [rad, or length / reach], in place.

    Reconfigurations, and poses that are not reached (rows of NaN), separate continuous pieces. Each continuous piece is unwrapped
    and shifted by 2 pi k inside its limits, nearest the end of the previous piece; the first piece is put nearest ends[0], or
    without it nearest the middle of the limits.

    Args:
        q: (N, n) configurations at the poses, NaN where there is none.
        free: (n,) whether the shift of a joint is chosen here.
        breaks: poses after which the path reconfigures.
        limits: (2, n) lower and upper, infinite for endless joints.
        ends: start and end configurations (n,) of the path, None where not given.
        fixed: whether the path must start at ends[0], and end at ends[1], exactly, not only modulo 2 pi.

    Returns:
        Indices of the joints that wind up too far for their limits.
    """
    unfit: set[int] = set()
    there = np.flatnonzero(np.isfinite(q[:, 0]))
    if not len(there):
        return unfit
    cut = np.isin(there[:-1], breaks) | (np.diff(there) > 1)
    pieces = np.split(there, np.flatnonzero(cut) + 1)
    before = ends[0]
    for k, piece in enumerate(pieces):
        near, at, must = before, piece[0], k == 0 and fixed[0]
        if piece is pieces[-1] and fixed[1] and not must:
            near, at, must = ends[1], piece[-1], True
        for i in np.flatnonzero(free):
            q[piece, i] = np.unwrap(q[piece, i])
            low, high = limits[:, i]
            first = np.ceil((low - ROUNDING - q[piece, i].min()) / TAU)
            last = np.floor((high + ROUNDING - q[piece, i].max()) / TAU)
            aim = near[i] if near is not None else 0.5 * (low + high) if np.isfinite(high - low) else 0.0
            turn = np.rint((aim - q[at, i]) / TAU)
            if first > last or (must and not first <= turn <= last):
                unfit.add(int(i))
            q[piece, i] += TAU * np.clip(turn, first, max(first, last))
            far = len(pieces) == 1 and fixed[0] and fixed[1] and abs(q[-1, i] - ends[1][i]) > np.pi  # pyright: ignore
            if far and np.isfinite(high - low):
                unfit.add(int(i))
        before = q[piece[-1]]
    return unfit
