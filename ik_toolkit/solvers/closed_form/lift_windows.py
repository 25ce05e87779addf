"""Exact intervals of the lift (prismatic joint) in which branches of the inspection arm keep all joint limits.

In the wrist's frame the shoulder S is linear in the lift d. The upper arm is U = K - S with the elbow K on a circle of radius a6
about axis 7. With |U| = a4, both L^2 = |U_xy|^2 and C = U_xy . S_xy are quadratic in d, and one equation is left, quadratic in
alpha, the component of U_xy along the vertical. A joint at a limit adds an equation, in d alone or quadratic in alpha. Eliminating
alpha leaves a polynomial in d, of degree 12 at most. Only at its roots, or where reach ends, can a branch pass its limits. The
branches are those of `reach.inspection_branches` (Shanmugasundar and Sivaramakrishnan, 2012, completed); the polynomials are ours.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from ...compile.jit import cached
from ...errors import InvalidOption, InvalidTarget, floats
from ...kernel.records import copy
from ...robot.pose import check_target
from .inspection import Inspection, feasible_lifts
from .lift_arm import A4, A6, JOINTS, LIFT, NEARLY, joint_values, near_angles, wrist_pose
from .reach import inspection_branch, inspection_nearest

DEGREE = 12  # highest degree of the polynomials in the lift (prismatic joint) that vanish where a joint is at a limit
# A leading Chebyshev coefficient below ROUNDED times the largest one is rounding error, and is dropped.
ROUNDED = 1e-13
# A root counts as real if its imaginary part is below DOUBLE times half the interval, because rounding splits a double real root
# into a complex pair.
DOUBLE = 1e-3
HALVINGS = 52  # number of bisections that locate an end of a window, after which it is exact to rounding
# If the joint values of a branch change by more than JUMP [rad] over a distance of 2 GAP times the interval, the branch jumps
# there, because axes 1 and 4 are parallel.
JUMP, GAP = 0.1, 1e-6


class LiftWindow(NamedTuple):
    """An interval of the lift (prismatic joint) [m] in which one solution (branch 0 to 7) of a pose is inside all limits.

    Along it the joint values vary continuously.
    """

    branch: int
    low: float
    high: float


@cached
def branch_rows(p, T, box, lifts, Q, broken):
    """Fill Q (8, K, n) with the eight branches of T (4, 4) at lifts (K,) [m], and broken (8, K) with how far they exceed limits.

    p: the arm's parameters (`lift_arm`); box (4, n): limits, reference, weights; a lift is measured along the shoulder's axis.
    """
    near, P, moved, row = np.empty(6), np.empty(12), np.empty(12), np.empty(6)
    near_angles(p, box, near)
    wrist_pose(p, T, P)
    for i in range(lifts.shape[0]):
        copy(P, moved)
        inspection_nearest(moved, lifts[i], p[A4], p[A6])
        for k in range(8):
            inspection_branch(moved, lifts[i], p[A4], p[A6], near, k, row)
            broken[k, i] = joint_values(p, row, lifts[i], box, Q[k, i])[0]


def at_lifts(robot: Any, T: Any, lifts: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the branches (8, K, n) [rad or m] of a pose T (4, 4) at lifts (K,) [m], and by how much (8, K) they exceed limits.

    A lift that does not reach the pose gets the branches of the nearest position that it reaches. Raises as `lift_windows` does.
    """
    p, box = _bind(robot)
    d = np.atleast_1d(floats(lifts, "lifts must be numbers [m]", InvalidOption))
    if d.ndim != 1 or not np.isfinite(d).all():
        raise InvalidOption(f"lifts must be finite numbers (K,) [m], not {lifts!r:.60}")
    return _rows(p, _pose(robot, T), box, p[LIFT + 1] * d)


def lift_windows(robot: Any, poses: Any) -> list[list[LiftWindow]]:
    """Return, for each of the eight solutions (branches) of each pose, the intervals of the lift in which it is inside all limits.

    The ends are exact to rounding. A single lift at which two limits meet is left out. So is one at which axes 1 and 4 are parallel
    and joint 1 is therefore free: a branch jumps there, and has a window on either side, up to a millionth of the interval of
    reach.

    Args:
        robot: An arm that 'inspection' solves.
        poses: Poses of the tip (N, 4, 4), base frame [m].

    Returns:
        For each pose its windows, by branch and then by lift; none if no configuration inside the limits reaches it.

    Raises:
        UnknownSolver: The robot has another structure.
        InvalidOption: It has no lift, or has the structure only approximately.
        InvalidTarget: A pose is not valid.
    """
    p, box = _bind(robot)
    sign, place = float(p[LIFT + 1]), int(p[LIFT])
    made: list[list[LiftWindow]] = []
    if getattr(poses, "shape", (0, 4, 4)) == (4, 4):
        raise InvalidTarget("poses is a single pose (4, 4); give a list of poses, as [T]")
    for target in poses:
        T = _pose(robot, target)
        spans = feasible_lifts(p, T, robot.lower[place], robot.upper[place])
        found = [one for span in spans for one in _windows(p, T, box, *sorted(sign * x for x in span))]
        made.append(sorted(LiftWindow(k, *sorted((sign * a + 0.0, sign * b + 0.0))) for k, a, b in found))
    return made


def _pose(robot: Any, target: Any) -> np.ndarray:
    """Return a target as a pose (4, 4). Raises InvalidTarget, also for a position."""
    T = check_target(target, robot.base)[0]
    if T.shape != (4, 4):
        raise InvalidTarget("a position leaves the orientation open, but the intervals of the lift are those of a pose")
    return T


def _bind(robot: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the arm's parameters, and its limits, home and weights (4, n); they are kept with the robot."""
    if "lift windows" not in robot.memo:
        p = Inspection().pack(robot)
        if p[LIFT] < 0.0 or p[NEARLY] > 0.0:
            why = "has no lift" if p[LIFT] < 0.0 else "has the structure only approximately"
            raise InvalidOption(f"'{robot.name}' {why}, so there are no exact intervals of its lift")
        robot.memo["lift windows"] = p, np.vstack([robot.lower, robot.upper, robot.home, np.ones(robot.n)])
    return robot.memo["lift windows"]


def _rows(p: np.ndarray, T: np.ndarray, box: np.ndarray, lifts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what `branch_rows` fills."""
    Q, broken = np.empty((8, len(lifts), box.shape[1])), np.empty((8, len(lifts)))
    branch_rows(p, T, box, lifts, Q, broken)
    return Q, broken


def _windows(p: np.ndarray, T: np.ndarray, box: np.ndarray, low: float, high: float) -> list[LiftWindow]:
    """Return the windows inside an interval of lifts [m, shoulder axes] that all reach T (4, 4)."""
    cuts = np.unique(np.concatenate([[low, high], _crossings(p, T, box, low, high)]))
    middle, gap, m = 0.5 * (cuts[1:] + cuts[:-1]), GAP * (high - low), len(cuts) - 1
    Q, broken = _rows(p, T, box, np.concatenate([middle, cuts[1:-1] - gap, cuts[1:-1] + gap]))
    good = broken[:, :m] == 0.0
    jumps = np.abs(Q[:, 2 * m - 1 :] - Q[:, m : 2 * m - 1]).max(axis=2, initial=0.0) > JUMP
    ends = np.tile(cuts, (8, 1))
    turned = (good[:, 1:] != good[:, :-1]) & ~jumps
    k, i = np.nonzero(turned)
    inside, outside = np.where(good[k, i], (middle[i], middle[i + 1]), (middle[i + 1], middle[i]))
    for _ in range(HALVINGS if len(k) else 0):
        d = 0.5 * (inside + outside)
        kept = _rows(p, T, box, d)[1][k, np.arange(len(k))] == 0.0
        inside, outside = np.where(kept, d, inside), np.where(kept, outside, d)
    ends[k, i + 1] = inside
    ends[:, 1:m] -= gap * jumps
    made = []
    for k in range(8):
        start = low
        for i in range(m):
            if i + 1 == m or turned[k, i] or jumps[k, i]:
                if good[k, i] and ends[k, i + 1] > start:
                    made.append(LiftWindow(k, float(start), float(ends[k, i + 1])))
                start = ends[k, i + 1] + (2.0 * gap if i + 1 < m and jumps[k, i] else 0.0)
    return made


def _crossings(p: np.ndarray, T: np.ndarray, box: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return all lifts between low and high [m] at which any branch can have a joint at a limit, and some more."""
    half, mid = 0.5 * (high - low), 0.5 * (high + low)
    nodes, found = chebyshev.chebpts1(DEGREE + 1), [np.zeros(0)]
    for c in chebyshev.chebfit(nodes, np.array(_conditions(p, T, box, mid + half * nodes)).T, DEGREE).T:
        size = np.abs(c)
        big = np.flatnonzero(size > ROUNDED * size.max())
        if len(big) and big[-1] > 0:
            roots = chebyshev.chebroots(c[: big[-1] + 1])
            found.append(roots.real[np.abs(roots.imag) < DOUBLE])
    x = np.concatenate(found)
    return mid + half * x[np.abs(x) < 1.0]


def _conditions(p: np.ndarray, T: np.ndarray, box: np.ndarray, d: np.ndarray) -> list[np.ndarray]:
    """Return polynomials of the lift, as values at d (K,): each vanishes wherever some joint of a branch is at one of its limits.

    The last one vanishes where axes 1 and 4 can be parallel.
    """
    P, a4, a6, zero = np.empty(12), p[A4], p[A6], np.zeros_like(d)
    wrist_pose(p, T, P)
    R, up = P[:9].reshape(3, 3), P[8]
    S, rise = d[:, None] * R[2] - R.T @ P[9:], math.hypot(P[6], P[7])
    e = R[2, :2] / rise if rise > 0.0 else np.array([1.0, 0.0])
    along, side, z = S[:, :2] @ e, S[:, :2] @ np.array([-e[1], e[0]]), S[:, 2]
    squares, L2 = (S[:, :2] ** 2).sum(axis=1), (a4 - z) * (a4 + z)
    C = 0.5 * (a6 * a6 - L2 - squares)
    # coefficients of a quadratic in alpha whose roots belong to the solutions of the pose
    pose = (squares, -2.0 * C * along, C * C - side * side * L2)
    made = [pose[2]]
    for k in range(6):
        i, sign, offset = int(p[JOINTS + 3 * k]), p[JOINTS + 3 * k + 1], p[JOINTS + 3 * k + 2]
        for limit in box[:2, i][np.isfinite(box[:2, i])]:
            s, c = math.sin(sign * limit + offset), math.cos(sign * limit + offset)
            N, h = R[:2].T[:2] @ np.array([-s, c]), (a4 * s) ** 2
            at_limit = (
                C * C * (N @ N) - L2 * (S[:, :2] @ N) ** 2,  # theta_1 is at a limit: axis 4 is perpendicular to N
                _resultant(
                    (zero + rise * rise, zero, L2 * (c * c - rise * rise)), pose
                ),  # theta_3 is at a limit: the slope of axis 4
                # theta_4 is at a limit: the component of U along axis 3
                _resultant((rise * rise * (z * z - h), 2.0 * L2 * up * z * rise, L2 * up * up * (L2 - h)), pose),
                z * z - h,  # theta_5 is at a limit: the component of S along axis 7
                (L2 + C) ** 2 - (a6 * c) ** 2 * L2,  # theta_6 is at a limit: the angle at the elbow
                # theta_7 is at a limit: the position of the elbow
                squares + 2.0 * a6 * (c * S[:, 0] - s * S[:, 1]) + a6 * a6 - L2,
            )
            made.append(at_limit[k])
    return made


def _resultant(one: tuple, other: tuple) -> np.ndarray:
    """Return the resultant of two quadratics, each given by three coefficients, highest first."""
    (a, b, c), (d, e, f) = one, other
    return (a * f - c * d) ** 2 - (a * e - b * d) * (b * f - c * e)
