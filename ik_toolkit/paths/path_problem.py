"""The input of a path search: poses, their kinds, joint limits and largest steps, as arrays in internal units."""

from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidOption, floats
from ..kernel.checks import CODE
from ..kernel.kinematics import TAU
from ..kernel.records import AT
from ..motion.reference import exp
from ..solvers.batch.parts import lanes_of
from ..solvers.enumerate import ONE_ATTEMPT, search_solutions
from ..solvers.options import Options
from ..solvers.outcome import SPOKEN
from ..solvers.plan import Plan
from ..solvers.protocol import Asked
from ..solvers.task import counted_errors, group_levels, targets_met
from .continuity import settle_on_targets
from .freedom import freedom

# Default of max_step, the largest step of a joint between two rows of a path [rad], [m], as in the planner CppFlow. The search
# never uses smaller steps, because a smaller max_step is met at the end by inserting rows.
STEP = (np.radians(7.0), 0.02)
TOLERANCE = (1e-3, np.radians(1.0))  # default largest deviation [m], [rad] of a tip from the interpolated poses
# An arm with too few joints cannot follow interpolated poses, so the search must not bound steps and deviations: the bounds are
# larger than any motion. ANY_STEP: joint step [rad], [m]; ANY_DEVIATION: deviation of a tip [m], [rad].
ANY_STEP, ANY_DEVIATION = (1e3, 1e6), (1e9, 1e9)


class Problem:
    """Poses T (N, 4, 4), or (N, F, 4, 4) for F tips, of the target kinds `kinds`, ready for the compiled path search.

    Internal units are radians for a revolute joint, and metres divided by the robot's scale for a prismatic one.

        most (n,): largest step of each joint between two poses [internal units], at least STEP
        deviation (2,): how far [m], [rad] a tip may leave the interpolated pose between two poses
        poses (N, F, 4, 4): T with an axis for the tips, even if there is only one
        at (N,): position of each pose on the path through the requested ones (3.5 is halfway from pose 3 to pose 4)
        stand (n,): values [internal units] at which joints of weight 0 are held, those of q0 or else of home
        plan, single: the solver's Plan, and one that makes a single attempt of an iterative search
        follower: a Plan that follows the path from one pose to the next; `single`, or one with the path's priority
        rows, ends, orders: the arrays of `single` that compiled functions take
        limits (3, n): lower limit, upper limit [internal units], and 1 where both are finite
        endless (n,): whether a joint is revolute without limits
        turning: indices of revolute joints with limits whose range exceeds 2 pi
        redundant: whether there are more joints than the targets need, so that solutions are not isolated
        room (3, n): limits in the search; if not `redundant`, `turning` joints have none, as their shifts by 2 pi are chosen later
    """

    def __init__(
        self,
        solver: Any,
        T: np.ndarray,
        kinds: tuple,
        max_step: tuple[float, float],
        deviation: tuple[float, float],
        q0: np.ndarray | None = None,
        at: np.ndarray | None = None,
        follower: Plan | None = None,
    ) -> None:
        """Prepare the arrays; max_step (rad, m): largest joint step; q0 (n,) [rad or m]; others: attributes of the class."""
        robot, plan = solver.robot, solver.plan_for(kinds)
        self.solver, self.robot, self.plan, self.T, self.kinds = solver, robot, plan, T, kinds
        self.poses = T.reshape(len(T), -1, 4, 4)
        self.at = np.arange(float(len(T))) if at is None else at
        self.deviation = np.array(deviation)
        self.single: Plan = (plan.search if plan.row.closed else plan.varied)(**ONE_ATTEMPT)
        self.follower = self.single if follower is None else follower
        self.rows, self.ends = self.single.chain[:2]
        self.orders = self.single.orders(kinds, True)
        self.unit = robot.chain.unit
        self.stand = (robot.home if q0 is None else q0) / self.unit
        able = freedom(self.single, kinds)
        turn, slide = ANY_STEP if able.lacks else np.maximum(max_step, STEP)
        # Too few joints cannot follow interpolated poses, so the motion is checked only after the search.
        if able.lacks:
            self.deviation = np.array(ANY_DEVIATION)
        self.most = np.where(robot.slides, slide, turn) / self.unit
        self.endless = (np.asarray(robot.chain.turns) > 0) & np.isinf(robot.lower) & np.isinf(robot.upper)
        free = np.full(robot.n, np.inf)
        low, high = (robot.lower, robot.upper) if plan.options.limits else (-free, free)
        self.limits = np.array([low / self.unit, high / self.unit, np.isfinite(low) & np.isfinite(high)])
        self.turning = np.flatnonzero((np.asarray(robot.chain.turns) > 0) & ~self.endless & plan.options.limits)
        asked = Asked(robot, kinds, options=plan.options)
        self.redundant = bool(robot.n - len(plan.held) > min(able.rank, asked.rows) or plan.options.slack is not None)
        self.room = self.limits.copy()
        if not self.redundant:
            self.room[0, self.turning], self.room[1, self.turning] = -np.inf, np.inf

    def solutions(self, t: int, Q0: np.ndarray) -> tuple[np.ndarray, float]:
        """Solve pose number t with one attempt from each start Q0 (M, n) [rad or m]; if none converges, search as `Solver` does.

        Returns the solutions found (m, n) [rad, or length / reach], with revolute joints shifted by 2 pi k to be nearest the
        middle of their limits, and the distance [m] by which the pose is proven out of reach (0 if it is not proven).
        """
        single, n = self.single, self.robot.n
        T, out = np.repeat(self.T[t : t + 1], len(Q0), axis=0), np.zeros((len(Q0), single.width))
        side_by_side = lanes_of(single, self.kinds)
        if side_by_side is not None:
            side_by_side(*single.arrays(self.kinds, Q0), T, Q0, out, self.orders)
        else:
            single.run(T, self.kinds, Q0, True, out)
        good = out[:, AT.status] == CODE.converged
        # If all single attempts fail, the solver searches as usual: with better starts, for longer, and with a proof if it can.
        if not good.any():
            out, good = self.plan.solve(T[:1], self.kinds, Q0[:1], True)[None], np.ones(1, dtype=bool)
            if out[0, AT.status] != CODE.converged:
                return np.empty((0, n)), max(0.0, out[0, AT.excess]) if out[0, AT.status] == CODE.unreachable else 0.0
        return self.turned(out[good, single.q_columns] / self.unit), 0.0

    def turned(self, Q: np.ndarray) -> np.ndarray:
        """Return Q (m, n) [rad, or length / reach] with revolute joints shifted by 2 pi k to be nearest mid-range."""
        Q = Q.copy()
        turning = np.asarray(self.robot.chain.turns) > 0
        turning[self.plan.held] = False
        for i in np.flatnonzero(turning):
            low, high = self.limits[:2, i]
            at = 0.5 * (low + high) if np.isfinite(high - low) else np.clip(0.0, low + np.pi, high - np.pi)
            Q[:, i] -= TAU * np.rint((Q[:, i] - at) / TAU)
        return Q

    def inside(self, q: np.ndarray) -> np.ndarray:
        """Return q (M, n) [rad or m] clipped to the joint limits, which the conversion of units may exceed by rounding."""
        return np.clip(q, self.robot.lower, self.robot.upper) if self.plan.options.limits else q

    def settled(self, Q: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Correct Q (m, n) [rad, or length / reach] onto poses number t (m,); return Q, and whether (m,) each is reached."""
        rows, good = settle_on_targets(self.single, self.kinds, Q * self.unit, self.poses[t])
        return rows / self.unit, good


# ------------------------------------------------------------------------------------------------------ with a priority
class Minima(NamedTuple):
    """Constants of the search for a path through the nearest reachable poses."""

    starts: int = 200  # random starts from which the first pose is solved
    attempts: int = 20  # attempts at each pose, to test whether an arm of few joints reaches all of them
    # largest number of configurations at the first pose (local minima of the errors) that are followed along the path
    followed: int = 20
    # [rad, or length / reach] If a joint moves further between two poses, it has changed to another branch of solutions.
    jump: float = 0.5


MINIMA = Minima()


def all_reached(solver: Any, T: np.ndarray, kinds: tuple, q0: np.ndarray | None) -> bool:
    """Return whether each of the poses T (N, 4, 4) or (N, F, 4, 4) is reached in a few attempts; the first miss ends the test.

    Args:
        solver: A Solver without the option `priority`.
        T: The poses [m].
        kinds: The kind of each tip's target (pose, position, ...).
        q0: (n,) Start of the first attempt [rad or m], or None.
    """
    plan = solver.plan_for(kinds).varied(restarts=MINIMA.attempts - 1)
    q = plan.home if q0 is None else q0[None]
    for t in range(len(T)):
        row = plan.solve(T[t : t + 1], kinds, q, True)
        if row[AT.status] != CODE.converged:
            return False
        q = row[None, plan.q_columns]
    return True


def nearest_poses(solver: Any, T: np.ndarray, kinds: tuple, q0: np.ndarray | None) -> np.ndarray:
    """Return the poses nearest to T (N, 4, 4) or (N, F, 4, 4) that one posture of the arm reaches.

    Several local minima of the first pose are followed from pose to pose. The chosen one misses the fewest poses; among equals, it
    has the fewest jumps, and then the smallest errors of lower priority. A pose whose errors of first priority cannot be met stays
    as it is.

    Args:
        solver: A Solver with the option `priority`.
        T: The poses asked for [m].
        kinds: The kind of each tip's target (pose, position, ...).
        q0: (n,) Start of the path [rad or m], or None.
    """
    plan = solver.plan_for(kinds)
    start = (plan.home if q0 is None else q0[None]).copy()
    before = start if q0 is not None else np.empty((0, plan.robot.n))
    minima = search_solutions(plan, T[:1], kinds, start, MINIMA.starts, MINIMA.followed).q
    followed = [_follow(plan, T, kinds, q) for q in (minima if len(minima) else start)]
    Q, good = min(followed, key=lambda one: _worth(plan, T, kinds, before, *one))
    nearest = T.copy()
    for t in np.flatnonzero(good):
        nearest[t] = targets_met(plan.robot, Q[t], plan.options).reshape(T.shape[1:])
    return nearest


def follower_of(plan: Plan) -> Plan:
    """Return a copy of a Plan that makes one attempt and changes no joint by more than the default largest step."""
    return plan.varied(restarts=0, follow=STEP[0])


def _follow(plan: Any, T: np.ndarray, kinds: tuple, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return joint values (N, n) at the poses, each found near the one before, and whether each meets the first level (N,).

    Where a minimum of the lower levels ends, the joints move to another one in steps, as far as the first level allows.
    """
    robot, single = plan.robot, follower_of(plan)
    Q, good = np.empty((len(T), robot.n)), np.zeros(len(T), dtype=bool)
    for t in range(len(T)):
        row = single.solve(T[t : t + 1], kinds, q[None], True)
        if row[AT.status] != CODE.converged:
            row = plan.solve(T[t : t + 1], kinds, q[None], True)
        Q[t], good[t] = row[plan.q_columns], row[AT.status] == CODE.converged
        q = Q[t] if good[t] else q
    return Q, good


def _worth(
    plan: Any, T: np.ndarray, kinds: tuple, before: Any, Q: np.ndarray, good: np.ndarray
) -> tuple[int, int, float]:
    """Return how many poses a motion misses, how often it jumps, and the sum of its errors of the lower levels.

    before: The start (1, n) of the path [rad or m], or (0, n).
    """
    lower = np.array(group_levels(plan.robot, plan.options)) > 0
    total = 0.0
    for t in np.flatnonzero(good):
        errors = counted_errors(plan.robot, Q[t], T[t], kinds, plan.options)
        total += sum(
            error or 0.0 for error, less in zip((x for pair in errors for x in pair), lower, strict=True) if less
        )
    moves = np.abs(np.diff(np.vstack([before, Q[good]]), axis=0)) / plan.robot.chain.unit
    return int((~good).sum()), int((moves > MINIMA.jump).any(axis=1).sum()), total


class HalfTurns:
    """The P rotations by 180 degrees between neighbouring poses of a path, each of which may go either way round.

    One of the two ways is chosen by rotating the second pose by far less than its tolerance, so that the interpolation everywhere
    else is unique.

    gaps (P,): the pose before each such rotation; tips (P,): the tip that turns; axes (P, 3): the chosen unit axis in base axes. At
    first each such rotation of a tip goes the opposite way to the tip's previous one.
    """

    def __init__(self, T: np.ndarray, kinds: tuple, tolerance: float) -> None:
        """Find the rotations of 180 degrees among poses T (N, F, 4, 4) of these kinds; tolerance [rad]: of the orientation."""
        self._T = T
        gaps, tips, axes = [], [], []
        for f, kind in enumerate(kinds):
            if kind in SPOKEN:
                continue
            R = T[1:, f, :3, :3] @ np.swapaxes(T[:-1, f, :3, :3], 1, 2)
            sine = 0.5 * np.linalg.norm(
                np.stack([R[:, i, j] - R[:, j, i] for i, j in ((0, 1), (0, 2), (1, 2))]), axis=0
            )
            # A rotation counts as one by 180 degrees if it differs from pi by less than a tenth of the tolerance.
            before = np.zeros(3)
            for k in np.flatnonzero((sine <= 0.1 * tolerance) & (np.trace(R, axis1=1, axis2=2) < 0.0)).tolist():
                # For a rotation of 180 degrees about the unit axis a, this is the matrix a a'.
                square = 0.25 * (R[k] + R[k].T) + 0.5 * np.eye(3)
                axis = square[:, np.argmax(np.diag(square))]
                before = axis * ((-1.0 if axis @ before > 0.0 else 1.0) / np.linalg.norm(axis))
                gaps.append(k)
                tips.append(f)
                axes.append(before)
        self.gaps, self.tips, self.axes = np.array(gaps, dtype=int), tips, np.array(axes).reshape(-1, 3)

    def turn_round(self, gaps: list[int]) -> bool:
        """Let the rotations by 180 degrees after poses number `gaps` go the other way round; return False if there are none."""
        meant = np.isin(self.gaps, gaps)
        self.axes[meant] *= -1.0
        return bool(meant.any())

    def poses(self) -> np.ndarray:
        """Return the poses (N, F, 4, 4); a pose whose shortest rotation from the pose before is not unique is rotated a little."""
        T = self._T.copy() if len(self.gaps) else self._T
        for p in np.argsort(self.gaps, kind="stable").tolist():
            k, f = self.gaps[p], self.tips[p]
            # The rotation is made shorter than pi by 1e-10 rad, which fixes its direction and is well above rounding (1e-16).
            T[k + 1, f, :3, :3] = exp((np.pi - 1e-10) * self.axes[p : p + 1])[0] @ T[k, f, :3, :3]
        return T


def read_pair(name: str, value: Any, default: tuple[float, float]) -> tuple[float, float]:
    """Return the two positive numbers of the option `name`; a single number is used for both. Raises InvalidOption."""
    if value is None:
        return default
    given = floats(value, f"{name} must be one number, or two", InvalidOption)
    if given.shape not in ((), (2,)) or not (np.isfinite(given) & (given > 0)).all():
        raise InvalidOption(f"{name} must be one number, or two, above 0, not {value!r}")
    first, second = np.broadcast_to(given, (2,)).tolist()
    return first, second


def read_path_tolerance(value: Any, options: Options) -> tuple[float, float]:
    """Return path_tolerance [m], [rad] or its default. Raises InvalidOption if it is not above the poses' own tolerance."""
    at = (options.position_tolerance, options.orientation_tolerance)
    found = read_pair("path_tolerance", value, (max(TOLERANCE[0], 2.0 * at[0]), max(TOLERANCE[1], 2.0 * at[1])))
    for k, (name, unit) in enumerate((("position", "m"), ("orientation", "rad"))):
        if not found[k] > at[k]:
            raise InvalidOption(
                f"path_tolerance must be above {name}_tolerance, {at[k]:g} {unit}, the tolerance at the poses; not {found[k]:g}"
            )
    return found
