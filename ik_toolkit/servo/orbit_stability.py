"""How a small error grows along a moving target: tracking methods, linearised about a motion at every sample.

At rest a method has the same matrix for every arm (stability.py). In motion the matrix also depends on how the Jacobian J changes.
`step_matrices` is the exact derivative of one step of a method, undamped, at any state: the derivatives of J come from cross
products of its columns, and those of J^+ from Golub and Pereyra (1973), eq. 4.12. The product of the matrices over a closed path is
the derivative of the map from one lap to the next; its spectral radius is the factor by which an error grows per lap (Floquet).
`PathMotion` takes the derivatives on the motion without error, which a stable method follows up to its truncation error.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..errors import InvalidOption, InvalidTarget
from ..kernel.records import POINTS
from ..motion.reference import MAX_STEPS, Reference, checked, log
from ..robot.robot import Robot
from .command import SHARE


class Sampling(NamedTuple):
    """Constants that set how a path is sampled and followed, to find how an error grows from one end to the other."""

    # logarithm above which a growth factor is cut off; a little less than that of the largest float
    largest: float = 700.0
    most: int = 10_000  # largest number of samples of a path; their matrices take some 200 MB and some seconds
    iterations: int = 50  # largest number of Newton iterations for one sample; two or three are needed
    exact: float = 1e-10  # [m, rad] error below which a sample counts as on the path
    singular: float = 1e-9  # singular values below this share of the largest count as 0 in pseudo-inverses
    samples: int = 100  # least number of samples at which a joint motion is computed
    fine: float = 0.03  # largest distance between two samples of a motion [arm reaches, rad]
    closed: float = 1e-6  # [m, rad, per s] difference up to which start and end of a path count as the same
    # share of the speed by which the velocities at the start and end of a closed path may differ; a spline through a sampled lap
    # errs by less
    smooth: float = 0.05


ORBIT = Sampling()


class Growth(NamedTuple):
    """Factor by which a small error of the tip grows along a path.

    factor: over the whole path; per_step: mean factor per sample; closed: whether the path is closed.
    """

    factor: float
    per_step: float
    closed: bool

    @property
    def words(self) -> str:
        """The growth factor in words. A factor below 1e-12 is only rounding, so the words then say that the error is gone."""
        over = "in a lap" if self.closed else "in all"
        if self.factor < 1e-12:
            return f"a small error is gone {over}"
        return f"a small error changes {self.factor:.3g}-fold {over}"


class JacobianDerivatives(NamedTuple):
    """Jacobians at N configurations and their derivatives with respect to the n joints.

    J: (N, m, n); H: (N, m, n, n), where H[:, :, j, i] is the derivative of column j with respect to joint i; third: takes x and y
    (N, n) and returns the derivative (N, m, n) of the product (dJ/dt along x) y with respect to each joint.
    """

    J: np.ndarray
    H: np.ndarray
    third: Callable[[np.ndarray, np.ndarray], np.ndarray]


class OrbitState(NamedTuple):
    """State of the joints and the target at N steps, which `step_matrices` needs besides the Jacobians.

    rate (N, n): joint rates; error, ahead (N, m): target now, and at the end of the step, minus tip now; v, a (N, m): velocity and
    acceleration of the target.
    """

    rate: np.ndarray
    error: np.ndarray
    ahead: np.ndarray
    v: np.ndarray
    a: np.ndarray


class PathMotion:
    """The joint motion that keeps a robot's tip on a reference, without null-space motion, and how errors grow along it.

    Raises InvalidTarget if the path cannot be followed, InvalidOption if robot or reference is of the wrong type.
    """

    def __init__(self, robot: Robot, reference: Reference, q0: Any = None) -> None:
        """Find the joint motion along a reference, from the solution near q0 (n,), default home.

        The reference is followed in steps so short that each solution leads to the next.
        """
        from ..solvers.solve import solve

        if not isinstance(robot, Robot) or not isinstance(reference, Reference):
            raise InvalidOption("gains are judged along a path= (a Reference, as ik.circle) of a robot= (a Robot)")
        self.robot, self.reference, self.m = robot, reference, 3 if reference.position_only else 6
        T = checked(reference, np.linspace(0.0, reference.duration, ORBIT.samples))[0]
        moved = np.abs(np.diff(T, axis=0)) / np.where(np.arange(4) == 3, robot.chain.reach, 1.0)
        count = max(ORBIT.samples, int(moved.max(axis=(1, 2)).sum() / ORBIT.fine))
        if count > MAX_STEPS:
            raise InvalidTarget(
                f"{reference!r} takes {count:.3g} samples to judge gains along it; at most {MAX_STEPS:g}"
            )
        self.times = np.linspace(0.0, reference.duration, count)
        start = robot.home if q0 is None else robot.check_q(q0, "q0")
        self.q = np.tile(solve(robot, reference.target(0.0), q0=start).q, (count, 1))
        # What `sampled` returned for the last sample time is kept, because all gains of a stability chart need it.
        self._last: tuple[float, Any] = 0.0, None
        T = reference.at(self.times)[0]
        for k in range(count):
            self.q[k] = self._follow(self.q[max(k - 1, 0)][None], T[k : k + 1], self.times[k : k + 1])[0]

    def _follow(self, Q: np.ndarray, T: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Return joint values at which the tip is at T (N, 4, 4), found from Q (N, n); times (N,) [s] are for the error."""
        for _ in range(ORBIT.iterations):
            now, J = self.robot.chain.forward(Q, jacobian=True)
            e = tip_errors(T, now, self.m)
            far = np.abs(e).max(axis=1)
            if far.max() < ORBIT.exact:
                return Q
            Q = Q + np.einsum("kij,kj->ki", np.linalg.pinv(J[:, : self.m], rcond=ORBIT.singular), e)
        at = times[int(np.argmax(far))]
        few = (
            "" if self.m == 3 or self.robot.n >= 6 else "; with so few joints ask for positions alone (--position-only)"
        )
        raise InvalidTarget(f"reference '{self.reference.name}' cannot be followed at t = {at:g} s{few}")

    def sampled(self, h: float) -> tuple[JacobianDerivatives, OrbitState]:
        """Follow the path in samples h [s] apart; return the Jacobians there, and the rates and errors of the steps between them.

        Raises InvalidOption if a step is longer than the path, or the samples are too many.
        """
        if self._last[0] == h:
            return self._last[1]
        times = self.reference.times(h)
        if len(times) < 2:
            raise InvalidOption(f"h = {h:g} s is longer than the path ({self.reference.duration:g} s)")
        if len(times) > ORBIT.most:
            raise InvalidOption(
                f"{len(times):,} samples of the path are too many (at most {ORBIT.most:,}); judge a part of it"
            )
        T, V, A = self.reference.at(times)
        Q = self._follow(np.column_stack([np.interp(times, self.times, one) for one in self.q.T]), T, times)
        bent, poses = jacobians(self.robot, Q, self.m), self.robot.chain.forward(Q)[0]
        rate = np.einsum("kij,kj->ki", np.linalg.pinv(bent.J, rcond=ORBIT.singular), V[:, : self.m])[:-1]
        ahead = tip_errors(T[1:], poses[:-1], self.m)
        self._last = h, (bent, OrbitState(rate, np.zeros_like(ahead), ahead, V[:-1, : self.m], A[:-1, : self.m]))
        return self._last[1]

    def beyond_limits(self) -> str:
        """Return a sentence that names the joints whose limits the motion leaves, or ''; growth is computed without limits."""
        out = ((self.q < self.robot.lower) | (self.q > self.robot.upper)).any(axis=0)
        names = ", ".join(np.array(self.robot.joint_names)[out])
        return f" Limits are not counted, and on this motion {names} would leave theirs." if names else ""

    def largest_move(self, h: float) -> float:
        """Return the largest distance [rad or arm reaches] that a joint moves in a sample time h [s]."""
        speed = np.abs(np.diff(self.q, axis=0) / np.diff(self.times)[:, None] / self.robot.chain.unit)
        return h * float(speed.max())

    def growth(
        self, method: str, h: float, gains: dict[str, float], null_damping: float = 0.0, *, pace: float = 1.0
    ) -> Growth:
        """Return how an error grows along the reference with a method, without joint limits. Raises InvalidOption if h is too long.

        For a closed path it is the spectral radius of the map from lap to lap. Otherwise it is the largest possible ratio of the
        tip's error at the end to that at the start, if the joint rates at the start have no error. h [s]; null_damping [1/s]; pace:
        how many times as fast the reference is followed.
        """
        bent, orbit = self.sampled(pace * h)
        orbit = orbit._replace(rate=pace * orbit.rate, v=pace * orbit.v, a=pace**2 * orbit.a)
        steps = step_matrices(bent, orbit, method, h, gains, null_damping)
        blocks = np.eye(steps.shape[-1] // self.robot.n)
        total, scale = chained(steps)
        # Growth is judged in coordinates of the tip, because null-space motion does not move the tip and is no error.
        lap = np.kron(blocks, bent.J[-1]) @ total @ np.kron(blocks, np.linalg.pinv(bent.J[0], rcond=ORBIT.singular))
        T, V, _ = self.reference.at(np.array([0.0, self.reference.duration]))
        off, bend = np.abs(T[0] - T[1]).max(), np.abs(V[0] - V[1]).max()
        closed = bool(off < ORBIT.closed and bend < ORBIT.closed + ORBIT.smooth * np.abs(V).max())
        value = np.abs(np.linalg.eigvals(lap)).max() if closed else np.linalg.norm(lap[: self.m, : self.m], 2)
        logarithm = float(np.log(max(value, 1e-300)) + scale)
        return Growth(float(np.exp(min(logarithm, ORBIT.largest))), float(np.exp(logarithm / len(steps))), closed)


def stable_bands(
    factor: Callable[[float], float], low: float, high: float, *, spacing: float = 1.05, halvings: int = 11
) -> tuple[np.ndarray, np.ndarray, tuple[tuple[float, float], ...]]:
    """Return the bands of sample rates [Hz] from low to high in which factor(rate), the growth along a path, is below 1.

    Returns the rates that were tried (K,), neighbours at most `spacing` apart; the factors there (K,); and the bands (first, last
    rate). Each border of a band is found by bisection between two rates that were tried; a band that lies between two neighbours is
    missed.
    """
    rates = np.geomspace(low, high, 2 + int(np.log(high / low) / np.log(spacing)))
    rates[-1] = high
    factors = np.array([factor(rate) for rate in rates])
    good = factors < 1.0
    edges = [] if not good[0] else [low]
    for i in np.flatnonzero(good[1:] != good[:-1]):
        ends = {bool(good[i]): rates[i], bool(good[i + 1]): rates[i + 1]}
        for _ in range(halvings):
            middle = 0.5 * (ends[True] + ends[False])
            ends[factor(middle) < 1.0] = middle
        edges.append(float(ends[True]))
    edges += [high] if good[-1] else []
    return rates, factors, tuple(zip(edges[::2], edges[1::2], strict=True))


def chained(matrices: np.ndarray) -> tuple[np.ndarray, float]:
    """Multiply matrices (N, k, k), the first one applied first; return the product divided by a scale, and the scale's logarithm.

    Without the scale, the product along an unstable path would exceed what a float can hold.
    """
    total, scale = np.eye(matrices.shape[-1]), 0.0
    for A in matrices:
        total = A @ total
        largest = np.abs(total).max()
        if not 1e-100 < largest < 1e100:
            largest = max(largest, 1e-300)
            total, scale = total / largest, scale + np.log(largest)
    return total, scale


def tip_errors(goals: np.ndarray, poses: np.ndarray, m: int) -> np.ndarray:
    """Return the differences from poses to goals (N, 4, 4) as (N, m): [m] and, if m is 6, rotation vectors [rad], base axes."""
    off = goals[:, :3, 3] - poses[:, :3, 3]
    if m == 3:
        return off
    turn = goals[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1)
    return np.concatenate([off, [log(R) for R in turn]], axis=1)


def jacobians(robot: Robot, Q: np.ndarray, m: int) -> JacobianDerivatives:
    """Return the first m rows of the Jacobians at Q (N, n) [rad or m] and their derivatives, from the joints' columns.

    Let u_t, w_t be the linear and angular part of the column of joint t, and r a joint nearer the base. Then d u_t / d q_r = w_r x
    u_t = d u_r / d q_t, d w_t / d q_r = w_r x w_t, and d w_r / d q_t = 0.
    """
    rows, ends, n = robot.chain.rows, robot.chain.ends, robot.n
    L, owner = len(rows), rows[:, 8].astype(int)
    # Here each joint has a column of its own; the columns of joints that mimic another one are added to that one's at the end.
    single = np.column_stack([rows[:, :8], np.arange(L), rows[:, 9]])
    ends = np.concatenate([ends[:POINTS], np.zeros(7 * L), ends[POINTS + 7 * n :]])
    chain = robot.chain._replace(rows=single, ends=ends, unit=robot.chain.unit[owner])
    J = chain.forward(Q[:, owner], jacobian=True)[1]
    u, w = J[:, :3].transpose(0, 2, 1), J[:, 3:].transpose(0, 2, 1)
    later = np.arange(L)[:, None, None] >= np.arange(L)[:, None]
    # entry [t, r] of by_u: w_r x u_t, of by_w: w_r x w_t
    by_u, by_w = np.cross(w[:, None], u[:, :, None]), np.cross(w[:, None], w[:, :, None])
    by_u, by_w = np.where(later, by_u, by_u.swapaxes(1, 2)), np.where(later, by_w, 0.0)
    sums = np.eye(n)[owner]

    def before(parts: np.ndarray) -> np.ndarray:  # for each joint: sum of `parts` over the joints nearer the base
        return np.cumsum(parts, axis=1) - parts

    def after(parts: np.ndarray) -> np.ndarray:  # for each joint: sum of `parts` over it and those nearer the tip
        return parts.sum(axis=1, keepdims=True) - before(parts)

    def third(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the derivatives (N, m, n) of (dJ/dt along the rates x) y with respect to each joint; x, y (N, n).

        That product is the sum over t of y_t (turn_t x u_t + w_t x speed_t; turn_t x w_t). Here turn_t is the angular velocity of
        the link before joint t at the rates x, and speed_t the velocity of the tip due to joint t and those after it.
        """
        x, y = x[:, owner, None], y[:, owner]
        k = len(x)
        turn, speed = before(w[:k] * x), after(u[:k] * x)
        dturn, dspeed = before(by_w[:k] * x[..., None]), after(by_u[:k] * x[..., None])
        turn, speed, U, W = (part[:, :, None] for part in (turn, speed, u[:k], w[:k]))
        linear = np.cross(dturn, U) + np.cross(turn, by_u[:k]) + np.cross(by_w[:k], speed) + np.cross(W, dspeed)
        every = np.concatenate([linear, np.cross(dturn, W) + np.cross(turn, by_w[:k])], axis=3)
        return (np.einsum("ktim,kt->kmi", every, y) @ sums)[:, :m]

    H = np.concatenate([by_u, by_w], axis=3).transpose(0, 3, 1, 2)[:, :m]
    return JacobianDerivatives(J[:, :m] @ sums, sums.T @ H @ sums, third)


def null_rate(method: str, null_damping: float, h: float) -> float:
    """Return a damping of null-space motion [1/s], limited to what keeps the method stable in steps of h [s]."""
    return min(null_damping, (SHARE if method == "ca" else 1.0) / h)


def step_matrices(
    bent: JacobianDerivatives,
    orbit: OrbitState,
    method: str,
    h: float,
    gains: dict[str, float],
    null_damping: float = 0.0,
) -> np.ndarray:
    """Return the matrices (N, k n, k n) by which each step multiplies a small disturbance: the exact derivatives of the steps.

    The k n numbers of the state are those of `stability.mapping_matrix`, for n joints. For method aa the option `reading`, which
    says where dJ/dt is evaluated, may be among the gains.
    """
    N = len(orbit.rate)
    J, H = bent.J[:N], bent.H[:N]
    P = np.linalg.pinv(J, rcond=ORBIT.singular)
    eye = np.broadcast_to(np.eye(J.shape[2]), (N, J.shape[2], J.shape[2]))
    free, damped = eye - P @ J, null_rate(method, null_damping, h)
    qd = orbit.rate

    def times(A: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.einsum("kij,kj->ki", A, x)

    def along(x: np.ndarray) -> np.ndarray:  # D(x), the derivative of J along x
        return np.einsum("kmji,ki->kmj", H, x)

    def turned(y: np.ndarray) -> np.ndarray:  # the derivative of J y with respect to q
        return np.einsum("kmji,kj->kmi", H, y)

    # the derivative of J^+ b with respect to q, where by_q is the derivative of b
    def inverse(b: np.ndarray, by_q: np.ndarray) -> np.ndarray:
        y = times(P, b)
        dual, left = times(P.swapaxes(1, 2), y), b - times(J, y)
        outer = free @ np.einsum("kmji,km->kji", H, dual) + P @ P.swapaxes(1, 2) @ np.einsum("kmji,km->kji", H, left)
        return P @ (by_q - turned(y)) + outer

    # derivatives with respect to q of the errors to the target now and at the end of the step
    behind, coming = (-_logarithm(e) @ J for e in (orbit.error, orbit.ahead))
    if method == "cv":
        u = inverse(orbit.v + gains["kappa"] * orbit.error, gains["kappa"] * behind)
        return _blocks([[eye + 1.5 * h * u, -0.5 * h * eye], [u, 0.0 * eye]])
    # minus the derivative of the null-space part of the rates, (1 - J^+ J) qd, with respect to q
    drift = inverse(times(J, qd), turned(qd))
    if method == "ca":
        kp, kd = gains["kp"], gains["kd"]
        D = along(qd)
        b = orbit.a + kd * (orbit.v - times(J, qd)) + kp * orbit.error - times(D, qd)
        by_q = inverse(b, kp * behind - kd * turned(qd) - bent.third(qd, qd)) + damped * drift
        by_rate = -P @ (kd * J + D + turned(qd)) - damped * free
        return _blocks(
            [
                [eye + 0.75 * h * h * by_q, h * eye + 0.75 * h * h * by_rate, -0.25 * h * h * eye],
                [1.5 * h * by_q, eye + 1.5 * h * by_rate, -0.5 * h * eye],
                [by_q, by_rate, 0.0 * eye],
            ]
        )
    kept = 1.0 - gains["share"]
    b = orbit.ahead - kept * orbit.error
    move = inverse(b, coming - kept * behind)
    if method == "av":
        return eye + move
    # The acceleration is a = (s / h - J^+ J qd) / (g h) - J^+ D(x) y / (2 g), plus the damping of null-space motion. Here g is the
    # weight of the new rate (gamma), s = J^+ b, D(x) = `along(x)`, and x, y are qd or s / h + (1 - J^+ J) qd.
    g, reading = (0.5, gains.get("reading", 2)) if method == "aa" else (gains["gamma"], 3)
    rates = (qd, np.zeros_like(eye), eye)  # the rates x and y, with their derivatives with respect to q and qd
    expected = (times(P, b) / h + times(free, qd), move / h - drift, free)
    x, y = expected if reading == 3 else rates, rates if reading == 1 else expected
    curve, by_x, by_y = times(along(x[0]), y[0]), turned(y[0]), along(x[0])
    curve_by_q = inverse(curve, bent.third(x[0], y[0]) + by_x @ x[1] + by_y @ y[1])
    by_q = (move / h - drift) / (g * h) - curve_by_q / (2.0 * g) + damped * drift
    by_rate = (free - eye) / (g * h) - P @ (by_x @ x[2] + by_y @ y[2]) / (2.0 * g) - damped * free
    return _blocks([[eye + g * h * h * by_q, h * (eye + g * h * by_rate)], [h * by_q, eye + h * by_rate]])


def _logarithm(e: np.ndarray) -> np.ndarray:
    """Return matrices (N, m, m) that turn a small motion of the tip into the change of an error e (N, m), but for the sign."""
    made = np.tile(np.eye(e.shape[1]), (len(e), 1, 1))
    if e.shape[1] == 6:
        made[:, 3:, 3:] = [pin.Jlog3(pin.exp3(turn)) for turn in e[:, 3:]]
    return made


def _blocks(rows: list[list[np.ndarray]]) -> np.ndarray:
    return np.concatenate([np.concatenate(row, axis=2) for row in rows], axis=1)
