"""Linear analysis of the paper's two feedback solvers: is the loop stable near a solution, and where can a run end?

With the Jacobian J at a configuration and the error e = target - actual, one step of the state-space solver (`StateSpace`) is

    e(k+1) = (I - J D) e(k) - J C x(k)
    x(k+1) =           B e(k) + A x(k)

to first order, so near a solution errors vanish if the spectral radius of [[I - J D, -J C], [B, A]] is below 1. Summed over a
run whose state dies out, the joints have moved by S (e(0) + e(1) + ...) with the static gain S = C (I - A)^-1 B + D. If no joint
limit is active, a run therefore ends on the affine subspace ("slice") q0 + S w, whatever A is; A decides how fast. J S is the loop
gain.

One step of IK-PID (`PID`) moves one joint by K_p |e|. To first order that lowers the error along the unit vector u if
K_p < 2 |J_i . u| / |J_i|^2. The gain margin is the largest K_p for which some joint does so whatever u is.

Burrell et al. (2016) announce such an analysis in their conclusion; this one is ours.
"""

from dataclasses import dataclass
from itertools import combinations, product
from typing import Any

import numpy as np

from ..errors import InvalidConfiguration, InvalidOption, floats, whole
from ..kernel.counted_error import KIND
from ..robot.robot import Robot
from ..robot.tree import require_one_tip
from ..solvers.batch.solve_batch import solve_batch
from ..solvers.protocol import Asked
from ..solvers.rules.state_space import HEAD, StateSpace
from ..validate import switch

# Number of iterations that `predict` makes. They do not overshoot; with the published gains, the error in the slowest direction
# falls by a twentieth in each iteration.
ITERATIONS = 3000
FLAT = 1e-9  # a joint whose Jacobian column is below this share of the largest does not move the tip
ROUND = 1e-9  # rounding allowed in the test whether a point is inside a polytope, relative to 1


@dataclass(frozen=True)
class Matrices:
    """The matrices A, B, C, D of a state-space solver in base axes, metres and radians; each of its M starts has its own B and D.

    Attributes:
        A: (m, m) state matrix.
        B: (M, m, r) input matrices; r is 3 for positions, 6 for poses.
        C: (n, m) output matrix.
        D: (M, n, r) feedthrough.
        starts: (M, n) the start [rad or m] for which each pair B, D is used.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    starts: np.ndarray

    def nearest(self, robot: Robot, q: np.ndarray) -> np.ndarray:
        """Return for each configuration q (N, n) the index of the nearest start, with joint angles compared modulo 2 pi."""
        apart = (q[:, None] - self.starts) / robot.chain.unit
        apart -= 2.0 * np.pi * np.rint(apart / (2.0 * np.pi)) * (robot.chain.turns > 0.0)
        return (apart**2).sum(axis=2).argmin(axis=1)

    def static_maps(self) -> np.ndarray:
        """Return the static gains S = C (I - A)^-1 B + D (M, n, r), one for each start."""
        return self.C @ np.linalg.solve(np.eye(len(self.A)) - self.A, self.B) + self.D


def matrices(robot: Robot, rule: StateSpace, position_only: bool) -> Matrices:
    """Return the matrices that a state-space solver uses for a robot. Raises InvalidOption if they do not fit the robot."""
    made = rule.resolve(robot, position_only)
    numbers = made.pack(robot, Asked(robot, (KIND.position if position_only else KIND.pose,)))
    n, m, count = robot.n, int(numbers[0]), int(numbers[1])
    parts = np.split(numbers[HEAD + n :], np.cumsum([m * m, n * m]))
    table = parts[2].reshape(count, -1)
    B, D = table[:, n : n + 6 * m].reshape(count, m, 6), np.zeros((count, n, 6))
    if numbers[2] > 0.0:
        D = table[:, n + 6 * m :].reshape(count, n, 6)
    axes, unit = robot.chain.ends[:9].reshape(3, 3).T, robot.chain.unit[:, None]

    # convert B and D, which the solver stores for errors in its own axes, with lengths over the robot's length scale
    def plain(maps: np.ndarray) -> np.ndarray:
        linear = maps[:, :, :3] @ axes / robot.chain.scale
        return linear if position_only else np.concatenate([linear, maps[:, :, 3:] @ axes], axis=2)

    return Matrices(
        parts[0].reshape(m, m), plain(B), parts[1].reshape(n, m) * unit, plain(D) * unit, table[:, :n] * unit.T
    )


@dataclass(frozen=True)
class LoopAnalysis:
    """How a state-space solver, run as a feedback loop, reduces small errors near N configurations.

    Attributes:
        robot: The robot.
        matrices: The solver's matrices.
        position_only: Whether targets are positions.
        q: (N, n) configurations [rad or m].
        spectral_radius: (N,) factor by which the slowest part of an error changes in each step, near a solution.
        loop_gain: (N, r) complex eigenvalues of the product of Jacobian and static gain, one for each independent error that
            joints can change. For A = a I they are those of J S (1 - a), which is J C B + (1 - a) J D, for any other A those of J
            S.
        gain_bound: Without D and with A = a I, a real loop gain must be between 0 and this, 1 - a (Jury's test); else None.
    """

    robot: Robot
    matrices: Matrices
    position_only: bool
    q: np.ndarray
    spectral_radius: np.ndarray
    loop_gain: Any
    gain_bound: float | None

    @property
    def stable(self) -> np.ndarray:
        """Whether errors die out near each configuration (N,): the spectral radius is below 1."""
        return self.spectral_radius < 1.0

    @property
    def steps_per_decade(self) -> np.ndarray:
        """Number of steps (N,) after which an error near each configuration has fallen to a tenth; infinite where it does not."""
        with np.errstate(divide="ignore"):
            return np.where(self.stable, -1.0 / np.log10(np.minimum(self.spectral_radius, 1.0)), np.inf)

    def predict(self, targets: Any, q0: Any = None, tolerance: float = 1e-3) -> np.ndarray:
        """Return whether the solver is expected to reach each target, from its static gains S and the joint limits alone.

        The iteration q += S e, which has no state, is run with q clamped to the limits. A joint that meets a limit on the way may
        divert it, so the prediction may be no although some configuration q0 + S w, with a vector w, solves the target. Where
        solver and prediction differ, the dynamics of the solver's state made joints overshoot into a limit.

        Args:
            targets: As for `solve_batch`, N of them.
            q0: (n,) start [rad or m]; default: the solver's own starts.
            tolerance: As for `solve_batch` [m].

        Returns:
            (N,) booleans.
        """
        made = StateSpace(D=self.matrices.static_maps(), starts=self.matrices.starts)
        if len(self.matrices.starts) == 1:
            made = made._replace(D=made.D[0], starts=None if q0 is not None else made.starts)
        options: dict[str, Any] = {"tolerance": tolerance, "max_iterations": ITERATIONS, "restarts": 0, "check": 0.0}
        return solve_batch(self.robot, targets, made, q0=q0, **options).success

    def off_slice(self, q: Any, q0: Any) -> np.ndarray:
        """Return how far (N,) [rad or m] configurations q (N, n) are from the set q0 + S w that a solver with one start can reach.

        Raises InvalidOption if the solver has several starts.
        """
        if len(self.matrices.starts) > 1:
            raise InvalidOption(
                f"each of {len(self.matrices.starts)} maps has a slice of its own; off_slice needs a single map"
            )
        moved = (np.atleast_2d(q) - np.asarray(q0)).T
        S = self.matrices.static_maps()[0]
        return np.linalg.norm(moved - S @ np.linalg.lstsq(S, moved, rcond=None)[0], axis=0)

    def __str__(self) -> str:
        """Return the most important results of the analysis in a few lines."""
        gain, steps = self.loop_gain.real, np.percentile(self.steps_per_decade, (5, 50, 95), method="nearest")
        bound = "" if self.gain_bound is None else f" (stable between 0 and {self.gain_bound:g} where it is real)"
        return (
            f"{self.robot.name}, state space, {len(self.q)} configurations: {100 * self.stable.mean():.1f} % locally stable\n"
            f"loop gain {gain.min():.3f} to {gain.max():.3f}{bound}\n"
            f"steps for a tenth of the error: {steps[1]:.1f} (5 to 95 %: {steps[0]:.1f} to {steps[2]:.1f})"
        )


def analyse(
    robot: Robot,
    rule: Any = None,
    q: Any = None,
    *,
    count: int = 3000,
    seed: int = 0,
    position_only: bool | None = None,
) -> LoopAnalysis:
    """Analyse how the state-space solver, as a feedback loop, reduces small errors near configurations of a robot.

    Args:
        robot: A robot with one tip.
        rule: The solver, a `StateSpace`; default: the one that is designed for the robot.
        q: (n,) or (N, n) configurations [rad or m]; default: `count` random ones within the limits, drawn with `seed`.
        count: Number of random configurations.
        seed: Seed of the random configurations.
        position_only: Whether targets are positions; default: True if B or D has three columns.

    Returns:
        The analysis. If the solver has several starts, each configuration is analysed with the B and D of the nearest one.

    Raises:
        InvalidOption: The rule is no StateSpace, or does not fit the robot.
    """
    require_one_tip(robot, "the analysis of a loop")
    rule = StateSpace() if rule is None else rule
    if not isinstance(rule, StateSpace):
        raise InvalidOption(
            f"analyse takes ik.StateSpace(...) or ik.StateSpace.preset(name), not {rule!r}; "
            "the other solvers have no linear loop (for ik.PID see study.analyse.gain_margins)"
        )
    given = next((part for part in (rule.B, rule.D) if part is not None), None)
    positions = given is not None and np.shape(given)[-1] == 3
    if position_only is not None:
        positions = switch(position_only, "position_only")
    count = whole(count, "count", 1)
    Q = robot.random_q(np.random.default_rng(whole(seed, "seed", 0)), count) if q is None else _configurations(robot, q)
    made = matrices(robot, rule, positions)
    rows = 3 if positions else 6
    # Errors that no joint can change, such as those across a planar arm's plane, are left out, because reachable targets have none.
    unit = np.array([robot.chain.scale] * 3 + [1.0] * 3)[:rows, None]
    span = Asked(robot, (KIND.position if positions else KIND.pose,)).span[:rows]
    J = (span / unit).T @ robot.chain.forward(Q, jacobian=True)[1][:, :rows]
    chosen = made.nearest(robot, Q)
    r, m, a = J.shape[1], len(made.A), float(made.A[0, 0]) if len(made.A) else 0.0
    B, D, static = (part @ (unit * span) for part in (made.B[chosen], made.D[chosen], made.static_maps()[chosen]))
    loop = np.zeros((len(Q), r + m, r + m))
    loop[:, :r, :r], loop[:, :r, r:] = np.eye(r) - J @ D, -J @ made.C
    loop[:, r:, :r], loop[:, r:, r:] = B, made.A
    alike = bool(m) and np.array_equal(made.A, a * np.eye(m))
    gain = J @ static * (1.0 - a if alike else 1.0)
    return LoopAnalysis(
        robot, made, positions, Q, np.abs(np.linalg.eigvals(loop)).max(axis=1),
        np.linalg.eigvals(gain).astype(complex), 1.0 - a if alike and not made.D.any() else None,
    )  # fmt: skip


def _configurations(robot: Robot, q: Any) -> np.ndarray:
    """Return one configuration or several as an array (N, n) [rad or m]. Raises InvalidConfiguration."""
    rows = floats(q, "q must be numbers", InvalidConfiguration)
    return np.array([robot.check_q(one, "q") for one in np.atleast_2d(rows)]).reshape(-1, robot.n)


def gain_margins(robot: Robot, q: Any) -> np.ndarray:
    """Return the largest gain K_p with which IK-PID lowers small position errors, at each of N configurations (its gain margin).

    K_p is in rad per m (m per m for prismatic joints). With J_i the columns of the Jacobian and a_i = 2 J_i / |J_i|^2, the margin
    is the least over all unit vectors u of max |a_i . u|, that is, one over the norm of the farthest vertex of the polytope |a_i
    . x| <= 1.

    Args:
        robot: A robot with one tip.
        q: (N, n) configurations, or one (n,) [rad or m].

    Returns:
        (N,) largest K_p for which any small error, in the directions in which the arm can move at all, is lowered by some joint; 0
        where the joints at q do not span these directions.

    Raises:
        InvalidConfiguration: q does not fit the robot.
    """
    require_one_tip(robot, "the gain margin")
    span = Asked(robot, (KIND.position,)).span[:3]
    r = span.shape[1]
    signs = np.array(list(product((1.0,), *[(1.0, -1.0)] * (r - 1)))).T
    J = span.T @ robot.chain.forward(_configurations(robot, q), jacobian=True)[1][:, :3]
    size = np.linalg.norm(J, axis=1, keepdims=True)
    still = size <= FLAT * size.max(axis=2, keepdims=True)  # A joint that does not move the tip sets no bound.
    facets = np.where(still, 0.0, 2.0 * J / np.maximum(size, 1e-300) ** 2).swapaxes(1, 2)
    far = np.zeros(len(J))
    for some in combinations(range(robot.n), r):
        rows = facets[:, some]
        meet = np.abs(np.linalg.det(rows)) > FLAT * np.linalg.norm(rows, axis=2).prod(axis=1)
        corners = np.linalg.solve(rows[meet], signs)
        inside = (np.abs(facets[meet] @ corners) <= 1.0 + ROUND).all(axis=1)
        far[meet] = np.maximum(far[meet], (np.linalg.norm(corners, axis=1) * inside).max(axis=1))
    return np.divide(1.0, far, out=np.zeros(len(J)), where=far > 0.0)
