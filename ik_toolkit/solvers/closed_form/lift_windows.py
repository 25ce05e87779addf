"""The exact intervals of the lift (prismatic joint) in which a branch of the inspection arm keeps all joint limits.

With d the lift, S the shoulder in the wrist's frame is linear in d, and U = K - S is the upper arm, where the elbow K is on a
circle of radius a6 about axis 7. |U| = a4 and |K| = a6 make L^2 = |U_xy|^2 and C = U_xy . S_xy quadratic in d, and with alpha
the component of U_xy along the base's vertical axis, one equation remains, quadratic in alpha. That a joint is at a limit is a
second equation, or one in d alone; eliminating alpha leaves a polynomial in d of degree 12 at most. Its roots and the ends of
reach are the only lifts at which a branch can enter or leave its limits. The branches are those of `reach.inspection_branches`
(Shanmugasundar and Sivaramakrishnan, 2012, eqs. (7)-(13), completed); the polynomials are ours.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from ...compile.jit import cached
from ...errors import InvalidOption
from .inspection import Inspection, feasible_lifts
from .lift_arm import A4, A6, JOINTS, LIFT, NEARLY, joint_values, near_angles, wrist_pose
from .reach import inspection_branch, inspection_nearest

DEGREE = 12  # highest degree of a polynomial in the lift; interpolation at one node more is exact
ROUNDED = 1e-13  # Leading Chebyshev coefficients below this share of the largest are rounding.
DOUBLE = 1e-3  # Roots count as real up to this imaginary part (of half the interval), as rounding parts double roots.
HALVINGS = 52  # bisections, after which an end is exact to rounding
JUMP = 0.1  # [rad] A branch that turns further within GAP is not continuous: axes 1 and 4 are parallel between.
GAP = 1e-9  # share of an interval


class LiftWindow(NamedTuple):
    """An interval of lifts [m] in which one branch (0 to 7) solves a pose inside all limits, and varies continuously."""

    branch: int
    low: float
    high: float


@cached
def branch_rows(p, T, box, lifts, Q, broken):
    """Fill Q (8, K, n) with the branches of T (4, 4) at lifts (K,) [m, shoulder axes], broken (8, K) with their excess over limits."""
    near, P, moved, row = np.empty(6), np.empty(12), np.empty(12), np.empty(6)
    near_angles(p, box, near)
    wrist_pose(p, T, P)
    for i in range(lifts.shape[0]):
        moved[:] = P
        inspection_nearest(moved, lifts[i], p[A4], p[A6])
        for k in range(8):
            inspection_branch(moved, lifts[i], p[A4], p[A6], near, k, row)
            broken[k, i] = joint_values(p, row, lifts[i], box, Q[k, i])[0]


def _bind(robot: Any, T: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the arm's parameters, the pose (4, 4) and box (4, n). Raises as `lift_windows` does."""
    p = Inspection().pack(robot)
    if p[LIFT] < 0.0 or p[NEARLY] > 0.0:
        why = "has no lift" if p[LIFT] < 0.0 else "has the structure only approximately"
        raise InvalidOption(f"'{robot.name}' {why}, so there are no exact intervals of its lift")
    box = np.vstack([robot.lower, robot.upper, robot.home, np.ones(robot.n)])
    return p, np.ascontiguousarray(T, dtype=float), box


def at_lifts(robot: Any, T: Any, lifts: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the configurations (8, K, n) [rad or m] of the eight branches of one pose at some lifts, and their excess over limits.

    Args:
        robot: An arm that 'inspection' solves.
        T: Pose of the tip (4, 4), base frame [m].
        lifts: (K,) values of the prismatic joint [m]. Where one does not reach the pose, the nearest that is reached counts.

    Raises:
        UnknownSolver: The robot has another structure.
        InvalidOption: It has no lift, or has the structure only approximately.
    """
    p, T, box = _bind(robot, T)
    lifts = np.atleast_1d(np.asarray(lifts, dtype=float))
    Q, broken = np.empty((8, len(lifts), robot.n)), np.empty((8, len(lifts)))
    branch_rows(p, T, box, p[LIFT + 1] * lifts, Q, broken)
    return Q, broken


def lift_windows(robot: Any, T: Any) -> list[LiftWindow]:
    """Return the intervals of the lift in which a pose is solved inside all limits, for each of the eight branches.

    The ends are exact to rounding. Single lifts, at which two limits meet or axes 1 and 4 are parallel, are left out. A branch
    that passes through such a lift has a window on either side.

    Args:
        robot: An arm that 'inspection' solves.
        T: Pose of the tip (4, 4), base frame [m].

    Returns:
        The windows, by branch and then by lift; none if no configuration inside the limits reaches the pose.

    Raises:
        UnknownSolver: The robot has another structure.
        InvalidOption: It has no lift, or has the structure only approximately.
    """
    p, T, box = _bind(robot, T)
    sign, place = p[LIFT + 1], int(p[LIFT])
    made: list[LiftWindow] = []
    for span in feasible_lifts(p, T, robot.lower[place], robot.upper[place]):
        low, high = sorted(sign * x for x in span)
        if high > low:
            made += _windows(p, T, box, low, high)
    made = [LiftWindow(k, *sorted((sign * a, sign * b))) for k, a, b in made]
    return sorted(made)


def _windows(p: np.ndarray, T: np.ndarray, box: np.ndarray, low: float, high: float) -> list[LiftWindow]:
    """Return the windows inside an interval of reach [m, shoulder axes], which all lifts inside it belong to."""
    n = box.shape[1]
    cuts = np.unique(np.concatenate([[low, high], _crossings(p, T, box, low, high)]))
    middle = 0.5 * (cuts[1:] + cuts[:-1])
    sides = np.clip(np.concatenate([cuts[1:-1] - GAP * (high - low), cuts[1:-1] + GAP * (high - low)]), low, high)
    Q, broken = np.empty((8, len(middle), n)), np.empty((8, len(middle)))
    beside, _ = np.empty((8, len(sides), n)), np.empty((8, len(sides)))
    branch_rows(p, T, box, middle, Q, broken)
    branch_rows(p, T, box, sides, beside, _)
    inside = broken == 0.0
    before, after = np.split(beside, 2, axis=1)
    jumps = np.abs(after - before).max(axis=2, initial=0.0) > JUMP  # (8, M-1)
    changed = inside[:, 1:] != inside[:, :-1]
    ends = np.broadcast_to(cuts[1:-1], changed.shape).copy()
    for k, i in zip(*np.nonzero(changed & ~jumps), strict=True):
        ends[k, i] = _border(p, T, box, k, middle[i], middle[i + 1], bool(inside[k, i]))
    made = []
    for k in range(8):
        start = low
        for i in range(len(middle)):
            last = i + 1 == len(middle)
            if inside[k, i] and (last or changed[k, i] or jumps[k, i]):
                made.append(LiftWindow(k, start, high if last else float(ends[k, i])))
            if not last and (changed[k, i] or jumps[k, i]):
                start = float(ends[k, i])
    return [one for one in made if one.high > one.low]


def _border(p: np.ndarray, T: np.ndarray, box: np.ndarray, k: int, a: float, b: float, good: bool) -> float:
    """Return the last lift inside the limits, between a and b, of which one is inside: a if `good`."""
    Q, broken = np.empty((8, 1, box.shape[1])), np.empty((8, 1))
    for _ in range(HALVINGS):
        c = 0.5 * (a + b)
        branch_rows(p, T, box, np.array([c]), Q, broken)
        a, b = (c, b) if (broken[k, 0] == 0.0) == good else (a, c)
    return a if good else b


def _crossings(p: np.ndarray, T: np.ndarray, box: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return all lifts between low and high [m] at which any branch can have a joint at a limit, and some more."""
    half, mid = 0.5 * (high - low), 0.5 * (high + low)
    nodes = chebyshev.chebpts1(DEGREE + 1)
    found = [np.zeros(0)]
    for values in _conditions(p, T, box, mid + half * nodes):
        c = chebyshev.chebfit(nodes, values, DEGREE)
        big = np.flatnonzero(np.abs(c) > ROUNDED * np.abs(c).max())
        if len(big) and big[-1] > 0:
            roots = chebyshev.chebroots(c[: big[-1] + 1])
            found.append(roots.real[np.abs(roots.imag) < DOUBLE])
    x = np.concatenate(found)
    return mid + half * x[np.abs(x) < 1.0]


def _conditions(p: np.ndarray, T: np.ndarray, box: np.ndarray, d: np.ndarray) -> list[np.ndarray]:
    """Return polynomials of the lift, as values at d (K,): each vanishes wherever some joint of a branch is at one of its limits.

    The last one vanishes where axes 1 and 4 can be parallel.
    """
    P, a4, a6 = np.empty(12), p[A4], p[A6]
    wrist_pose(p, np.ascontiguousarray(T), P)
    R, Z = P[:9].reshape(3, 3), P[6:9]
    S = d[:, None] * Z - R.T @ P[9:]
    rise = math.hypot(Z[0], Z[1])
    e = Z[:2] / rise if rise > 0.0 else np.array([1.0, 0.0])
    along, side, z = S[:, :2] @ e, S[:, :2] @ np.array([-e[1], e[0]]), S[:, 2]
    squares = (S[:, :2] ** 2).sum(axis=1)
    L2 = (a4 - z) * (a4 + z)
    C = 0.5 * (a6 * a6 - L2 - squares)
    pose = (squares, -2.0 * C * along, C * C - side * side * L2)  # in alpha, for every branch
    made = []
    for k in range(6):
        i, sign, offset = int(p[JOINTS + 3 * k]), p[JOINTS + 3 * k + 1], p[JOINTS + 3 * k + 2]
        for limit in box[:2, i]:
            if not math.isfinite(limit):
                continue
            s, c = math.sin(sign * limit + offset), math.cos(sign * limit + offset)
            if k == 0:  # theta_1: axis 4 is in the vertical plane of this angle
                N = (R.T @ np.array([-s, c, 0.0]))[:2]
                made.append(C * C * (N @ N) - L2 * (S[:, :2] @ N) ** 2)
            elif k == 1:  # theta_3: the inclination of axis 4
                zero = np.zeros_like(d)
                made.append(_resultant((zero + rise * rise, zero, -L2 * (rise * rise - c * c)), pose))
            elif k == 2:  # theta_4: U's component along axis 3
                up, h = Z[2], (a4 * s) ** 2
                of_limit = (rise * rise * (z * z - h), 2.0 * L2 * up * z * rise, L2 * up * up * (L2 - h))
                made.append(_resultant(of_limit, pose))
            elif k == 3:  # theta_5: S along axis 7
                made.append(z * z - (a4 * s) ** 2)
            elif k == 4:  # theta_6: the angle at the elbow
                made.append((L2 + C) ** 2 - (a6 * c) ** 2 * L2)
            else:  # theta_7: where the elbow is
                made.append(squares + 2.0 * a6 * (c * S[:, 0] - s * S[:, 1]) + a6 * a6 - L2)
    return [*made, pose[2]]


def _resultant(one: tuple, other: tuple) -> np.ndarray:
    """Return the resultant of two quadratics, each given by three coefficients, highest first."""
    (a, b, c), (d, e, f) = one, other
    return (a * f - c * d) ** 2 - (a * e - b * d) * (b * f - c * e)
