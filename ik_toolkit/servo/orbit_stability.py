"""How a small error grows along a moving target: tracking methods, linearised about the exact motion at every sample.

At rest a method has the same matrix for every arm (stability.py). In motion the matrix also depends on dJ/dt. Let D(x) be the
derivative of J along a joint velocity x, and v the target's velocity. A disturbance dq changes J^+ v by -J^+ D(qd) dq, so `cv` has
kappa I + J^+ D(qd) in place of kappa. At acceleration level the second derivative of J along the motion enters as well. The
product of the matrices over a closed path is the derivative of the map from one lap to the next; its spectral radius is the factor
by which an error grows per lap (Floquet).
"""

from typing import NamedTuple

import numpy as np

from ..errors import InvalidOption, InvalidTarget
from ..motion.reference import Reference, log
from ..robot.robot import Robot
from .command import SHARE

STEP = 1e-5  # [rad or arm reaches] step of the first differences of J, with an error of about 1e-10
SECOND = 1e-4  # [rad or arm reaches] step of the second differences of J, with an error of about 1e-8
LARGEST = 700.0  # just below the logarithm of the largest factor that a float can hold
ITERATIONS = 50  # largest number of Newton iterations for one sample; two or three are needed
EXACT = 1e-10  # [m, rad] error below which a sample counts as on the path
SINGULAR = 1e-9  # singular values below this share of the largest count as 0 in pseudo-inverses
CLOSED = 1e-6  # [m, rad, per s] difference up to which start and end of a path count as the same


class Growth(NamedTuple):
    """Growth of a small error of the tip along a path.

    factor: over the whole path; per_step: mean factor per sample; closed: whether the path is closed.
    """

    factor: float
    per_step: float
    closed: bool

    @property
    def words(self) -> str:
        """The growth factor in words. A factor below 1e-12 is rounding, so the words then say that the error is gone."""
        over = "in a lap" if self.closed else "in all"
        if self.factor < 1e-12:
            return f"a small error is gone {over}"
        return f"a small error changes {self.factor:.3g}-fold {over}"


class Motion(NamedTuple):
    """Matrices of the motion without error, one for each of N steps; D(x) is the derivative of J along joint velocities x.

    row: J^+ J; rate: J^+ D(qd); acceleration: J^+ D(qdd); bend: J^+ D(J^+ D(qd) qd); second: J^+ times the second derivative of J
    along qd; each (N, n, n). first, last (m, n): J at the start and at the end.
    """

    row: np.ndarray
    rate: np.ndarray
    acceleration: np.ndarray
    bend: np.ndarray
    second: np.ndarray
    first: np.ndarray
    last: np.ndarray


def growth(
    robot: Robot, reference: Reference, method: str, h: float, gains: dict[str, float], *, null_damping: float = 0.0
) -> Growth:
    """Return how an error of a method grows along a reference, without limits.

    Args:
        robot: The robot.
        reference: The path.
        method: Name of the method.
        h: Sample time [s].
        gains: Gains of the method by name.
        null_damping: Damping of null-space motion [1/s].

    Returns:
        The growth: for a closed path the spectral radius of the map from lap to lap, for an open path the largest possible
            ratio of the error at its end to the error at its start.

    Raises:
        InvalidTarget: The path cannot be followed.
        InvalidOption: robot or reference is of the wrong type, or h is longer than the path.
    """
    if not isinstance(robot, Robot) or not isinstance(reference, Reference):
        raise InvalidOption("gains are judged along a path with robot= (a Robot) and path= (a Reference, as ik.circle)")
    times = reference.times(h)
    if len(times) < 2:
        raise InvalidOption(f"h = {h:g} s is longer than the path ({reference.duration:g} s)")
    made = exact_motion(robot, reference, times)
    steps = step_matrices(made, method, h, gains, null_damping)
    size = steps.shape[-1] // robot.n
    total, scale = np.eye(size * robot.n), 0.0
    for A in steps:
        total = A @ total
        largest = np.abs(total).max()
        # The product along an unstable path exceeds what a float can hold, so its scale is kept as a logarithm.
        if not 1e-100 < largest < 1e100:
            largest = max(largest, 1e-300)
            total, scale = total / largest, scale + np.log(largest)
    # The map is taken in tip coordinates, since null-space motion, which leaves the tip where it is, is no error.
    blocks = np.eye(size)
    lap = np.kron(blocks, made.last) @ total @ np.kron(blocks, np.linalg.pinv(made.first, rcond=SINGULAR))
    T, V, _ = reference.at(np.array([0.0, reference.duration]))  # The last sample may be before the path's end.
    off = max(np.abs(T[0] - T[1]).max(), np.abs(V[0] - V[1]).max())
    closed = bool(off < CLOSED + 2.0 * h * np.abs(V).max())
    value = np.abs(np.linalg.eigvals(lap)).max() if closed else np.linalg.norm(lap, 2)
    logarithm = float(np.log(max(value, 1e-300)) + scale)
    return Growth(float(np.exp(min(logarithm, LARGEST))), float(np.exp(logarithm / len(steps))), closed)


def exact_motion(robot: Robot, reference: Reference, times: np.ndarray) -> Motion:
    """Return the Motion that keeps the tip on the reference at times (N,) [s], without null-space motion."""
    from ..solvers.solve import solve

    T, V, A = reference.at(times)
    m = 3 if reference.position_only else 6
    q, chain = solve(robot, reference.target(0.0), q0=robot.home).q, robot.chain
    Q = np.empty((len(times), robot.n))
    for k, goal in enumerate(T):
        for _ in range(ITERATIONS):
            now, J = chain.forward(q[None], jacobian=True)
            e = np.concatenate([goal[:3, 3] - now[0, :3, 3], log(goal[:3, :3] @ now[0, :3, :3].T)])[:m]
            if np.abs(e).max() < EXACT:
                break
            q = q + np.linalg.pinv(J[0, :m], rcond=SINGULAR) @ e
        else:
            raise InvalidTarget(f"reference '{reference.name}' cannot be followed at t = {times[k]:g} s")
        Q[k] = q

    def jacobians(at: np.ndarray) -> np.ndarray:
        return chain.forward(at, jacobian=True)[1][:, :m]

    def along(x: np.ndarray) -> np.ndarray:
        """Return D(x), the derivative (N, m, n) of J along joint velocities x (N, n)."""
        size = np.maximum(np.abs(x / chain.unit).max(axis=1), 1e-12)[:, None]
        move = STEP * x / size
        return (jacobians(Q + move) - jacobians(Q - move)) * (size / (2.0 * STEP))[:, :, None]

    J = jacobians(Q)
    inverse = np.linalg.pinv(J, rcond=SINGULAR)
    qd = np.einsum("kij,kj->ki", inverse, V[:, :m])
    rate = along(qd)
    curve = np.einsum("kij,kj->ki", rate, qd)
    qdd = np.einsum("kij,kj->ki", inverse, A[:, :m] - curve)
    size = np.maximum(np.abs(qd / chain.unit).max(axis=1), 1e-12)[:, None]
    move = SECOND * qd / size
    second = (jacobians(Q + move) - 2.0 * J + jacobians(Q - move)) * ((size / SECOND) ** 2)[:, :, None]
    bend = along(np.einsum("kij,kj->ki", inverse, curve))
    row, rate, acceleration, bend, second = ((inverse @ part)[:-1] for part in (J, rate, along(qdd), bend, second))
    return Motion(row, rate, acceleration, bend, second, J[0], J[-1])


def null_rate(method: str, null_damping: float, h: float) -> float:
    """Return the given damping of null-space motion [1/s], limited to what the method tolerates in steps of h [s]."""
    return min(null_damping, (SHARE if method == "ca" else 1.0) / h)


def step_matrices(m: Motion, method: str, h: float, gains: dict[str, float], null_damping: float = 0.0) -> np.ndarray:
    """Return the matrices (N, k n, k n) that carry a small disturbance over each step.

    Its k n states are those of `mapping_matrix`. Method aa is taken with option reading=2 (where dJ/dt is evaluated), the default.
    """
    eye = np.broadcast_to(np.eye(m.row.shape[-1]), m.row.shape)
    null = null_rate(method, null_damping, h) * (eye - m.row)
    if method == "av":
        return eye - gains["share"] * m.row - h * m.rate
    if method == "cv":
        K = gains["kappa"] * m.row + m.rate
        return _blocks([[eye - 1.5 * h * K, -0.5 * h * eye], [-K, 0.0 * eye]])
    if method == "ca":
        P = gains["kp"] * m.row + gains["kd"] * m.rate + m.acceleration + m.second
        D = gains["kd"] * m.row + 2.0 * m.rate + null
        return _blocks(
            [
                [eye - 0.75 * h * h * P, h * eye - 0.75 * h * h * D, -0.25 * h * h * eye],
                [-1.5 * h * P, eye - 1.5 * h * D, -0.5 * h * eye],
                [-P, -D, 0.0 * eye],
            ]
        )
    # The acceleration is a = (s / h - J^+ J qd) / (g h) - J^+ D(x) w / (2 g), where x is qd in method aa and w in aad.
    # s is J^+ times the error to the next target, and w = s / h + (1 - J^+ J) qd.
    # The derivative of J^+ itself is left out, as it only causes null-space motion.
    g = 0.5 if method == "aa" else gains["gamma"]
    times_w = 1.0 if method == "aa" else 2.0
    w_by_q, w_by_rate = -(gains["share"] * m.row / h + m.rate), eye - m.row
    curve_by_q = times_w * m.rate @ w_by_q + m.second - m.bend
    curve_by_rate = (2.0 - times_w) * m.rate + times_w * m.rate @ w_by_rate
    a_by_q = w_by_q / (g * h) - curve_by_q / (2.0 * g)
    a_by_rate = -m.row / (g * h) - curve_by_rate / (2.0 * g) - null
    return _blocks([[eye + g * h * h * a_by_q, h * (eye + g * h * a_by_rate)], [h * a_by_q, eye + h * a_by_rate]])


def _blocks(rows: list[list[np.ndarray]]) -> np.ndarray:
    return np.concatenate([np.concatenate(row, axis=2) for row in rows], axis=1)
