"""The best achievable motion: at every sample, the configuration closest to the target that continues from the previous one.

Independent of the methods judged: a Levenberg-Marquardt search in numpy on Pinocchio-checked kinematics, inside the joint
limits. The error is |W e|, e = distance [m] and rotation vector [rad] of all tips, one radian counted as RADIUS metres.
"""

import numpy as np

RADIUS = 0.2  # m
ITERATIONS = 40  # at the edge of reach the search converges linearly; the next sample continues from there
GAIN = 1e-9  # relative decrease of the squared error that counts as no progress
SMALL = 1e-10  # [m (rad)] step or error that ends the search
BENT = (
    0.05  # share of the way back to the last configuration that reached, tried where the arm may be stuck stretched out
)


def as_tips(T: np.ndarray) -> np.ndarray:
    """Poses (N, F, 4, 4) of a robot's or a tree's (N, [F,] 4, 4)."""
    return T[:, None] if T.ndim == 3 else T


def rotation_vectors(R: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) of rotations (..., 3, 3), accurate also near half a turn."""
    s = 0.5 * np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    sine = np.linalg.norm(s, axis=-1)
    angle = np.arctan2(sine, 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0))
    out = s * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 1.0)[..., None]
    for i in np.argwhere((sine < 1e-6) & (angle > 1.0)):  # the axis is the eigenvector for eigenvalue 1
        k = tuple(i)
        values, vectors = np.linalg.eigh(0.5 * (R[k] + R[k].T))
        out[k] = vectors[:, int(np.argmax(values))] * angle[k]
    return out


def errors(robot, Q: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Weighted errors (N, 6 F) [m] at Q (N, n) to targets (N, F, 4, 4)."""
    return _weighted(as_tips(robot.chain.forward(Q)[0]), targets)


def _weighted(T: np.ndarray, targets: np.ndarray) -> np.ndarray:
    e = np.empty((*T.shape[:2], 6))
    e[..., :3] = targets[..., :3, 3] - T[..., :3, 3]
    e[..., 3:] = RADIUS * rotation_vectors(targets[..., :3, :3] @ np.swapaxes(T[..., :3, :3], -1, -2))
    return e.reshape(len(T), -1)


def linearised(robot, q: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weighted error (6 F,) and weighted Jacobian (6 F, n) at q (n,). J' e is the exact descent direction of |e|^2 / 2."""
    T, J = robot.chain.forward(q[None], jacobian=True)
    weight = np.tile([1.0] * 3 + [RADIUS] * 3, len(target))
    return _weighted(as_tips(T), target[None])[0], weight[:, None] * J[0]


def closest(robot, q: np.ndarray, target: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, float]:
    """Configuration near q (n,) inside the limits with the smallest error to target (F, 4, 4), and that error [m]."""
    e, J = linearised(robot, q, target)
    cost, damping = e @ e, 1e-6
    for _ in range(ITERATIONS):
        if cost < SMALL * SMALL:
            break
        g = J.T @ e
        free = ~(((q <= lower) & (g < 0.0)) | ((q >= upper) & (g > 0.0)))
        K = J[:, free]
        if np.abs(g[free]).max(initial=0.0) < SMALL:
            break
        step = np.zeros(len(q))
        step[free] = K.T @ np.linalg.solve(K @ K.T + damping * np.eye(len(e)), e)
        step *= 0.3 / max(0.3, np.abs(step).max())  # stay near: a continuation does not jump
        new = np.clip(q + step, lower, upper)
        moved = np.abs(new - q).max()
        tried, K = linearised(robot, new, target)
        gained = cost - tried @ tried
        if gained > 0.0:
            q, e, J, cost = new, tried, K, tried @ tried
            damping = max(0.2 * damping, 1e-12)
            if gained < GAIN * cost:
                break
        else:
            damping *= 5.0
        if moved < SMALL:
            break
    return q, float(np.sqrt(cost))


def best(robot, targets: np.ndarray, q0: np.ndarray, lower: np.ndarray, upper: np.ndarray, move=np.inf) -> np.ndarray:
    """Best achievable configurations (N + 1, n) along targets (N, F, 4, 4), from q0 at sample 0.

    move (n,): largest joint move per sample.
    """
    Q = np.empty((len(targets) + 1, len(q0)))
    Q[0] = q = reached = np.clip(q0, lower, upper)
    for k, target in enumerate(targets):
        low, high = np.maximum(lower, q - move), np.minimum(upper, q + move)
        q, error = closest(robot, q, target, low, high)
        if error < 1e-6:
            reached = q
        else:
            # A straight elbow has no gradient: its earlier bent configuration may do better.
            other, less = closest(robot, np.clip(q + BENT * (reached - q), low, high), target, low, high)
            if less < error - 1e-7:
                q = other
        Q[k + 1] = q
    return Q
