"""Chinyai's formulas (1) to (9), corrected: the closed form and Newton-Raphson, compiled and in numpy."""

import math
from typing import Any

import numpy as np

from ...compile.jit import cached

# Variants of the step of Newton's method: full, with line search, Levenberg-Marquardt, with limited length.
PLAIN, SEARCH, LEVENBERG, STEP = range(4)
LONGEST = 0.5  # Largest step [rad] of a joint in the variant STEP.
# The joint limit [rad] of the toolkit's robot planar_2r, used because the paper gives none.
LIMIT = math.radians(150.0)
TOLERANCE = 1e-10
ITERATIONS = 50
NO_CLIP = 1e9


@cached
def closed_form(x, y, l1, l2):
    """Return both solutions (theta_1, theta_2, theta_1', theta_2') by eqs. (2) to (5), with a signed sine, atan2 and a clamp."""
    c2 = (x * x + y * y - l1 * l1 - l2 * l2) / (2.0 * l1 * l2)
    c2 = min(1.0, max(-1.0, c2))
    s2 = math.sqrt((1.0 - c2) * (1.0 + c2))
    heading = math.atan2(y, x)
    inner = math.atan2(l2 * s2, l1 + l2 * c2)
    t2 = math.atan2(s2, c2)
    return heading - inner, t2, heading + inner, -t2


@cached
def newton(x, y, l1, l2, t1, t2, kind, clip, tolerance, iterations):
    """Return angles, number of steps (negative if it did not converge) and final |error| of Newton-Raphson by eqs. (6) to (9).

    The step is the full one (PLAIN), halved until the error falls (SEARCH), that of Levenberg-Marquardt (LEVENBERG), or at most
    LONGEST for each joint (STEP), as `kind` says. After every step the joints are clamped to +-clip [rad].
    """
    damping, k, n1, n2 = 1e-3, 0, t1, t2
    ex = l1 * math.cos(t1) + l2 * math.cos(t1 + t2) - x
    ey = l1 * math.sin(t1) + l2 * math.sin(t1 + t2) - y
    ee = ex * ex + ey * ey
    for k in range(iterations + 1):
        if ee <= tolerance * tolerance:
            return t1, t2, k, math.sqrt(ee)
        if k == iterations or not ee < 1e300:
            break
        b1, b2 = l2 * math.cos(t1 + t2), l2 * math.sin(t1 + t2)
        a1, a2 = l1 * math.cos(t1) + b1, l1 * math.sin(t1) + b2  # The Jacobian of the arm is [[-a2, -b2], [a1, b1]].
        if kind == LEVENBERG:
            g1, g2 = -a2 * ex + a1 * ey, -b2 * ex + b1 * ey
            h11, h12, h22 = a1 * a1 + a2 * a2 + damping, a1 * b1 + a2 * b2, b1 * b1 + b2 * b2 + damping
            det = h11 * h22 - h12 * h12
            d1, d2 = (h12 * g2 - h22 * g1) / det, (h12 * g1 - h11 * g2) / det
        else:
            det = a1 * b2 - a2 * b1  # The determinant of the Jacobian, which is l1 l2 sin(theta_2).
            if det == 0.0:
                break
            d1, d2 = -(b1 * ex + b2 * ey) / det, (a1 * ex + a2 * ey) / det
        scale = 1.0
        if kind == STEP:
            scale = min(1.0, LONGEST / max(abs(d1), abs(d2)))
        for _ in range(40):
            n1 = min(clip, max(-clip, t1 + scale * d1))
            n2 = min(clip, max(-clip, t2 + scale * d2))
            ex = l1 * math.cos(n1) + l2 * math.cos(n1 + n2) - x
            ey = l1 * math.sin(n1) + l2 * math.sin(n1 + n2) - y
            if kind != SEARCH or ex * ex + ey * ey < ee:
                break
            scale *= 0.5
        new = ex * ex + ey * ey
        if kind == LEVENBERG or kind == SEARCH:
            if new < ee:
                damping = max(0.1 * damping, 1e-15)
            elif kind == SEARCH:
                break
            else:  # The step increased the error, so a shorter one is tried from the same angles.
                damping *= 10.0
                ex = l1 * math.cos(t1) + l2 * math.cos(t1 + t2) - x
                ey = l1 * math.sin(t1) + l2 * math.sin(t1 + t2) - y
                if damping > 1e12:
                    break
                continue
        t1, t2, ee = n1, n2, new
    return t1, t2, -1 - k, math.sqrt(ee)


@cached
def closed_form_all(X, l1, l2, out):
    """Write both solutions of the closed form for targets X (N, 2) to out (N, 4)."""
    for i in range(X.shape[0]):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = closed_form(X[i, 0], X[i, 1], l1, l2)


@cached
def newton_all(X, l1, l2, Q0, kind, clip, iterations, out):
    """Solve targets X (N, 2) from Q0 (1 or N, 2) by `newton`; out (N, 4) receives angles, number of steps and |error|."""
    tolerance = TOLERANCE * (l1 + l2)
    for i in range(X.shape[0]):
        q = Q0[i if Q0.shape[0] > 1 else 0]
        t1, t2, k, e = newton(X[i, 0], X[i, 1], l1, l2, q[0], q[1], kind, clip, tolerance, iterations)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = t1, t2, k, e


def closed_form_numpy(x: float, y: float, l1: float, l2: float) -> tuple[np.ndarray, np.ndarray]:
    """Return both solutions by eqs. (2) to (5), computed in numpy."""
    c2 = np.clip((x**2 + y**2 - l1**2 - l2**2) / (2 * l1 * l2), -1, 1)
    s2 = np.sqrt(1 - c2**2) * np.array([1, -1])
    return np.arctan2(y, x) - np.arctan2(l2 * s2, l1 + l2 * c2), np.arctan2(s2, c2)


def newton_numpy(x: float, y: float, l1: float, l2: float, t1: float, t2: float) -> np.ndarray:
    """Return the angles (2,) where Newton-Raphson by eqs. (6) to (9) ends from t1, t2, computed in numpy."""
    theta, goal = np.array([t1, t2]), np.array([x, y])
    for _ in range(ITERATIONS):
        s1, s12 = np.sin(theta[0]), np.sin(theta.sum())
        c1, c12 = np.cos(theta[0]), np.cos(theta.sum())
        error = np.array([l1 * c1 + l2 * c12, l1 * s1 + l2 * s12]) - goal
        if np.linalg.norm(error) <= TOLERANCE * (l1 + l2):
            break
        J = np.array([[-l1 * s1 - l2 * s12, -l2 * s12], [l1 * c1 + l2 * c12, l2 * c12]])
        try:
            theta = theta - np.linalg.solve(J, error)
        except np.linalg.LinAlgError:
            break
    return theta


def targets(rng: np.random.Generator, count: int, l1: float, l2: float) -> np.ndarray:
    """Draw random points (N, 2), uniform over the area of the ring that a planar two-link arm reaches."""
    r = np.sqrt(rng.uniform((l1 - l2) ** 2, (l1 + l2) ** 2, count))
    angle = rng.uniform(-np.pi, np.pi, count)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle)])


def converge(
    X: np.ndarray, l1: float, l2: float, start: Any, kind: int, clip: float = NO_CLIP, iterations: int = ITERATIONS
) -> np.ndarray:
    """Solve targets by Newton-Raphson; return rows (N, 4) of both angles [rad], number of steps (negative: failed) and |error|.

    The start is one (2,) for all targets, or one for each (N, 2).
    """
    out = np.empty((len(X), 4))
    newton_all(X, l1, l2, np.atleast_2d(np.asarray(start, dtype=float)), kind, clip, iterations, out)
    return out
