"""Newton's iteration from a start: does it provably converge, to which solution, and how far away is the next one?

**The equation.** The solver `newton` takes the step dq = J^-1 e, where e is x* - x and the rotation vector of R* R'. That is
exactly Newton's iteration on F(q) = (x - x*, phi) with phi = log(R R*'): the derivative of F is J with its rotation rows multiplied
by G(phi), the inverse of the left Jacobian of SO(3), and since G phi = phi, the step is the same with and without G.

**The theorem** (Kantorovich, 1948; Ortega and Rheinboldt, 1970, 12.6.2; by blocks as in Deuflhard, 2004, theorem 2.1). Let eta be
the length of the first step, beta the norms of the position and rotation columns of F'(q0)^-1, L bounds of the second derivatives
of x and phi (Lipschitz constants of F'), and omega = beta . L. If h = omega eta <= 1/2, all iterates stay within
r = (1 - sqrt(1 - 2h)) / omega of q0 and converge to a solution there, and no other is nearer to q0 than
R = (1 + sqrt(1 - 2h)) / omega.

**The norm** is |y|, where y_i is q_i (angles in rad, slides over the robot's scale), plus y of the joint before if their axes are
parallel. So y is the direction of a link, not its angle to the link before; for a planar 2R arm that makes L 1 instead of 2.6.

**The bounds.** The link after joint k, of length l_k, is turned by the last joint of each run of parallel axes up to k, which the
vector a_k marks. So the matrix sum of l_k a_k a_k' bounds the second derivatives of x, with 1 for each slide and each run that
turns it. Those of phi are at most c g for each pair of runs, where theta bounds |phi| around q0,
g = |G| = (theta/2) / sin(theta/2), and c = 1/2 + (theta - sin theta) / (2 - 2 cos theta) bounds the derivative of G. Both follow
from G = I - [phi]/2 + (1 - (theta/2) cot(theta/2)) [phi]^2 / theta^2. L is the largest singular value of such a matrix.
"""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidConfiguration, InvalidOption, floats, whole
from ..kernel.counted_error import KIND
from ..kernel.records import POINTS
from ..robot.robot import Robot
from ..robot.tree import require_one_tip
from ..solvers.protocol import Asked, require
from ..solvers.registry import find_row
from ..solvers.rules.jacobian import Newton
from ..solvers.task import counted_rows, read_target
from ..validate import switch


class Allowances(NamedTuple):
    """Safety margins that keep rounding from invalidating a proof; F is the error as a function of q, phi its rotation vector."""

    # relative margin for rounding: beta, eta, L and r are multiplied by 1 + share, R by 1 - share (see NewtonCertificate)
    share: float = 1e-9
    # Nothing is claimed if the condition number of F'(q0) is larger, because its inverse may then be off by `share`.
    condition: float = 1e5
    # rounding error of forward kinematics [rad, or lengths over the scale], added to the error e
    kinematics: float = 1e-12
    # largest joint value [rad, or lengths over the scale] that is accepted; its rounding error is 1e-13
    widest: float = 1e3
    # [rad, or lengths over the scale] a target counts as in a planar arm's plane if it is off by less than `flat`
    flat: float = 1e-9
    # two axes count as parallel if the sine of their angle is smaller; `share` covers the error made by that
    parallel: float = 1e-12
    # [rad] Nothing is claimed for a larger rotation error |phi|, because phi is not smooth at half a turn.
    turned: float = 3.1
    # distance (by `NewtonCertificate.norm`) by which a solution given by the user may differ from the exact one
    listed: float = 1e-6


ALLOW = Allowances()


@dataclass(frozen=True)
class NewtonCertificate:
    """What is proven about Newton's iteration from one start or several.

    Arrays have the shape of the starts without n: () for a single one.

    Attributes:
        robot: The robot.
        target: The target as given.
        q0: (..., n) the starts [rad or m].
        limits: Whether the solver keeps the joint limits.
        beta: (..., 2) norms of the position [1/m] and rotation columns of F'(q0)^-1; 0 where nothing is claimed.
        lipschitz: (..., 2) Lipschitz constants of F' for position [m] and rotation.
        eta: Length of the first step; 0 where nothing is claimed.
        h: beta L eta; at most 1/2 where Newton's whole steps converge, joint limits apart. Infinite where nothing is claimed:
            F'(q0) is singular or badly conditioned, the target lies beside the arm's plane or is nearly half a turn away, or q0
            is huge.
        radius: r, the distance from q0 within which the iterates and their solution are; infinite where h > 1/2.
        unique_radius: R: no other solution is nearer to q0 than this; 0 where h > 1/2.
        inside: Whether all configurations within r are inside the joint limits, so that the solver never clips a step.
    """

    robot: Robot
    target: Any
    q0: np.ndarray
    limits: bool
    beta: np.ndarray
    lipschitz: np.ndarray
    eta: np.ndarray
    h: np.ndarray
    radius: np.ndarray
    unique_radius: np.ndarray
    inside: np.ndarray
    _to_norm: np.ndarray = field(repr=False)

    @property
    def proven(self) -> np.ndarray:
        """Whether the solver `newton` converges from each start, to the one solution within `radius`."""
        return (self.h <= 0.5) & (self.inside | (not self.limits))

    def norm(self, dq: Any) -> np.ndarray:
        """Return the lengths (...) of joint displacements dq (..., n) [rad or m], in the norm of `eta`, `radius` and `bound`."""
        return np.linalg.norm(np.asarray(dq, dtype=float) @ self._to_norm.T, axis=-1)

    def bound(self, steps: int) -> np.ndarray:
        """Return the largest distance from the solution after a number of steps; infinite where nothing is proven.

        It is 2 eta (2h)^(2^k - 1) / 2^k after k steps (Ortega and Rheinboldt, 1970): quadratic convergence for h < 1/2.
        """
        h, k = np.where(self.proven, self.h, 0.0), min(whole(steps, "steps", 0), 60)
        return np.where(self.proven, 2.0 * self.eta * (2.0 * h) ** (2.0**k - 1.0) / 2.0**k, np.inf)

    def leads_to(self, solutions: Any) -> np.ndarray:
        """Return for each start the index of the solution to which Newton's iteration provably converges.

        Args:
            solutions: `Solutions` of the target, or an array (K, n) [rad or m].

        Returns:
            (...) integers; -1 where nothing is proven, or where the list lacks the solution. A solution that is whole turns away
            counts as the same; of several, the nearest is chosen.
        """
        Q = floats(getattr(solutions, "q", solutions), "solutions must be numbers", InvalidConfiguration)
        if not Q.size:
            return np.full(self.h.shape, -1)
        if Q.shape[-1] != self.robot.n:
            raise InvalidConfiguration(f"solutions must be (K, {self.robot.n}), not an array of shape {Q.shape}")
        apart = np.atleast_2d(Q) - self.q0[..., None, :]
        turns = self.robot.chain.rows[:, 9] > 0.0
        modulo = self.norm(apart - 2.0 * np.pi * np.rint(apart / (2.0 * np.pi)) * turns)
        near = modulo <= self.radius[..., None] + ALLOW.listed
        index = np.where(near, self.norm(apart), np.inf).argmin(axis=-1)
        return np.where(self.proven & near.any(axis=-1), index, -1)

    def __str__(self) -> str:
        """Return what is proven in one sentence, or for several starts in a count."""
        if self.h.ndim:
            return f"Newton is proven to converge from {int(self.proven.sum())} of {self.h.size} starts"
        if self.proven:
            return (
                f"Newton converges from here (proven, h = {self.h:.3g}): to one solution, which is within "
                f"{self.radius:.3g} of q0, and no other is within {self.unique_radius:.3g}"
            )
        if self.h <= 0.5:
            return f"Not proven: within r = {self.radius:.3g} of q0 a step may meet a joint limit (h = {self.h:.3g})"
        why = f"h = {self.h:.3g} is above 1/2" if self.h < np.inf else "nothing can be claimed here (see h)"
        return f"Not proven: {why}; Newton may converge all the same, if the target can be reached"


def newton_certificate(robot: Robot, target: Any, q0: Any, *, limits: bool = True) -> NewtonCertificate:
    """Prove beforehand that the solver `newton` converges from a start, to which solution, and how far away that is at most.

    What is proven holds for `ik.solve(robot, target, "newton", q0=q0)` with `limits` as here: whole steps converge as fast as
    `NewtonCertificate.bound` says, until the tolerance is met. Newton may converge from other starts as well: the test is
    sufficient, and most starts that converge do not pass it.

    Args:
        robot: A robot with one tip, as many joints as equations and no mimic joints.
        target: Position (3,) or pose, as for `solve`.
        q0: (n,) start or (..., n) starts [rad or m].
        limits: Whether the solver keeps the joint limits. If so, all configurations within r must be inside them.

    Returns:
        The certificate.

    Raises:
        InvalidOption: `newton` does not take the robot or target (as many joints as equations), or there are mimic joints.
        InvalidTarget, InvalidConfiguration: As `solve` does.
    """
    require_one_tip(robot, "the certificate of Newton's method")
    switch(limits, "limits")
    T, kinds, _ = read_target(robot, target)
    asked = Asked(robot, kinds)
    if kinds[0] not in (KIND.pose, KIND.position):
        raise InvalidOption("newton_certificate takes whole poses and positions; an axis target leaves a turn free")
    if not robot.chain.plain:
        raise InvalidOption(f"newton_certificate takes no mimic joints, which robot '{robot.name}' has")
    require(find_row("newton"), Newton(), asked)
    q0 = floats(q0, "q0 must be numbers", InvalidConfiguration)
    if q0.shape[-1:] != (robot.n,) or not np.isfinite(q0).all():
        raise InvalidConfiguration(f"q0 must be finite numbers (..., {robot.n}), not an array of shape {q0.shape}")
    if not q0.size:
        raise InvalidConfiguration("q0 is empty; give at least one start")
    Q, T = q0.reshape(-1, robot.n), T[0]
    to_norm, turning = _link_turns(robot.chain.rows)
    A, e, angle, known = _linearised(robot, asked, T, Q, to_norm)
    blocks = A.reshape(len(Q), -1, 2, 3).swapaxes(1, 2)
    beta = (1.0 + ALLOW.share) * np.linalg.norm(blocks, 2, axis=(2, 3))
    eta = (1.0 + ALLOW.share) * np.linalg.norm(np.einsum("nij,nj->ni", A, e), axis=1)
    eta += ALLOW.kinematics * beta @ (robot.chain.scale, 1.0)
    slides, runs = (robot.chain.rows[:, 9] == 0.0).any(), int(turning[-1].sum())
    L = np.zeros_like(beta)
    L[:, 0] = _position_constant(robot, Q, 2.0 * eta, turning)
    # not if all axes are parallel: the rotation error log(R R*') is then linear in q, and its constant 0
    if kinds[0] == KIND.pose and runs > 1:
        L[known, 1] = _rotation_constant((angle + np.sqrt(runs) * 2.0 * eta)[known], runs)
    L *= 1.0 + ALLOW.share
    omega = (beta * L).sum(axis=1)
    h = np.where(known, omega * eta, np.inf)
    holds = h <= 0.5
    root = 1.0 + np.sqrt(1.0 - 2.0 * np.where(holds, h, 0.0))
    radius = np.where(holds, (1.0 + ALLOW.share) * 2.0 * eta / root, np.inf)
    # With prismatic joints or a rotation error, the Lipschitz constants hold only within 2 eta of q0.
    far = 2.0 * eta if slides or L[:, 1].any() else root / np.where(known, omega, 1.0)
    each = np.linalg.norm(np.linalg.inv(to_norm), axis=1) * robot.chain.unit * radius[:, None]
    # joint limits as the compiled solver has them, so that both decide alike
    lower, upper = robot.chain.ends[POINTS : POINTS + 2 * robot.n].reshape(2, -1) * robot.chain.unit
    inside = ((Q - each >= lower) & (Q + each <= upper)).all(axis=1)
    parts = (beta, L, eta, h, radius, np.where(holds, (1.0 - ALLOW.share) * far, 0.0), inside)
    shaped = (part.reshape(q0.shape[:-1] + part.shape[1:]) for part in parts)
    return NewtonCertificate(robot, target, q0, limits, *shaped, _to_norm=to_norm / robot.chain.unit)


def _link_turns(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return M (n, n) of the norm's y = M q, and which y turn the link after each joint (n, n): a row for each joint."""
    n = len(rows)
    M, turning = np.eye(n), np.zeros((n, n))
    now, last, sign = np.zeros(n), -1, 1.0
    for k, row in enumerate(rows):
        last, sign = (-1, 1.0) if abs(row[1]) > ALLOW.parallel else (last, sign * np.copysign(1.0, row[0]))
        if row[9] > 0.0:
            if last >= 0:
                M[k], now[last] = M[last], 0.0
            M[k, k], now[k], last = sign, 1.0, k
        turning[k] = now
    return M, turning


def _linearised(
    robot: Robot, asked: Asked, T: np.ndarray, Q: np.ndarray, to_norm: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return J^-1 (N, n, 6) to the norm's y [1/m, 1], errors (N, 6) [m, rad] and the angle |phi| (N,) [rad] at starts Q (N, n).

    Errors that the joints cannot change are left out. The last part (N,) says where J^-1 is well conditioned, the target in the
    arm's plane, phi smooth and q not too large; J^-1 is 0 elsewhere.
    """
    P, J = robot.chain.forward(Q, jacobian=True)
    span = asked.span
    R = T[:3, :3] @ P[:, :3, :3].transpose(0, 2, 1)
    sine = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    size = np.linalg.norm(sine, axis=1)
    angle = np.arctan2(size, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0)) * (not asked.position_only)
    ratio = np.where(size > 0.0, angle / np.where(size > 0.0, size, 1.0), 1.0)
    e = np.concatenate([T[:3, 3] - P[:, :3, 3], sine * ratio[:, None]], axis=1)
    e *= counted_rows(robot, asked.kinds, asked.options)
    lengths = np.array([robot.chain.scale] * 3 + [1.0] * 3)
    J = span.T @ (J * robot.chain.unit / lengths[:, None])
    values = np.linalg.svd(J, compute_uv=False)
    good = (values[:, -1] * ALLOW.condition > values[:, 0]) & (angle < ALLOW.turned)
    good &= (np.abs(Q / robot.chain.unit) <= ALLOW.widest).all(axis=1)
    good &= np.linalg.norm(e / lengths - e / lengths @ span @ span.T, axis=1) <= ALLOW.flat
    A = to_norm @ np.linalg.inv(np.where(good[:, None, None], J, np.eye(robot.n))) @ span.T
    return A * good[:, None, None] / lengths, e, angle * good, good


def _position_constant(robot: Robot, Q: np.ndarray, around: np.ndarray, turning: np.ndarray) -> np.ndarray:
    """Return bounds (N,) [m] of the second derivatives of the tip's position within `around` (N,) of starts Q (N, n)."""
    chain = robot.chain
    rows, n = chain.rows, robot.n
    along = np.abs(rows[:, 7] + rows[:, 6] * Q / chain.unit) + np.abs(rows[:, 6]) * around[:, None]
    lengths = np.hypot(np.hypot(rows[:, 2], rows[:, 3]), along)
    tool = np.full((len(Q), 1), np.linalg.norm(chain.ends[POINTS - 3 : POINTS]))
    lengths = np.concatenate([lengths[:, 1:], tool], axis=1)
    slides = np.zeros((n, n))
    slides[1:] = turning[:-1] * np.abs(rows[1:, 6:7])
    if (rows[:, 9] > 0.0).all():
        lengths = lengths[:1]  # Without prismatic joints the bound is the same at every start, so one row is enough.
    D = np.einsum("nk,ki,kj->nij", lengths, turning, turning) + slides + slides.T
    return np.broadcast_to(chain.scale * np.linalg.norm(D, 2, axis=(1, 2)), len(Q))


def _rotation_constant(angle: np.ndarray, runs: int) -> np.ndarray:
    """Return bounds (N,) of the second derivatives of phi for |phi| up to `angle` (N,) [rad]; infinite from ALLOW.turned on."""
    # For angles below 1e-3 rad the bound at 1e-3 rad is used, because the fraction would lose its digits.
    x = np.clip(angle, 1e-3, ALLOW.turned)
    derivative = 0.5 + (x - np.sin(x)) / (2.0 - 2.0 * np.cos(x))
    return np.where(angle < ALLOW.turned, runs * derivative * 0.5 * x / np.sin(0.5 * x), np.inf)
