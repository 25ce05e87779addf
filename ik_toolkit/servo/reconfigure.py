"""Another posture for a tracker, if the arm is held at limits and only other joint values reach the target.

`Postures` finds joint values near given ones that reach the targets, by single attempts of the solver;
`Reconfiguration` decides when to search and when to move.

A tracker reduces the error locally. A tool that is turned further and further therefore ends where a joint is at its
limit and every small motion increases the error. The solver's attempts from other starts then find other joint values
for the same target, and the arm moves there in joint space, leaving the path of its tip.

When to search: only after limits or a singular pose (not a speed limit) have kept the error from falling for a while. If the
target jumped to a place that the solver does not reach from the present joint values, the search begins at once. A search is
spread over several updates so that none takes much longer; after a search that finds nothing there is a pause.

When to move: the tip leaves its target on the way, and the target may return to where it can be reached. So the arm waits until
the error, summed over time [m s], has cost as much as the move would. The total cost is then at most twice that of the best choice
in hindsight. While the target stands still, a part of that cost is enough; it is not 0, as the target may only be turning back.
There is no wait once the target is at rest, or has stood for as long as the move takes.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..kernel.checks import CODE
from ..kernel.kinematics import TAU
from ..kernel.records import AT, Ends
from ..solvers.options import COUNTING, Options
from ..solvers.plan import Plan
from ..solvers.registry import find_row, search_for
from ..solvers.task import group_levels
from .adapters import LEVER
from .step import Lead
from .stepper import speeds
from .target_stream import ARRIVAL, STAND
from .viability import BIT, MARGIN, UNKNOWN, time_left, travel

TOLERANCE = 1e-5  # [m, rad] tolerance with which another posture must reach a target; the tracker then comes closer
REACHED = 1e-3  # [m] error below which a target counts as reached; 1 rad counts as length_scale


class Taken(NamedTuple):
    """The step that a tracker has just taken, joints in rad or arm reaches; the arrays are the tracker's own, not copies."""

    code: np.ndarray  # (n,) bits of the limits that were active (`viability.LimitBits`)
    singular: bool  # whether the pose was singular
    E: np.ndarray  # (2, m) errors before and after the step [m, rad], base axes
    left: float  # [m] error after the step as one number, in which 1 rad counts as length_scale
    T: np.ndarray  # (2, F, 4, 4) targets before and after the step
    stand: np.ndarray  # whether and for how long the target has stood still, see `RestState`; STAND holds the indices
    dt: float  # [s] length of the update
    h: float  # [s] length of the step; a long update is taken in several steps
    since: float  # [s] time since the last step that was examined
    q: np.ndarray  # (n,) joint values after the step
    rate: np.ndarray  # (n,) joint rates after the step
    limits: np.ndarray  # (4, n) lower, upper, speed, acceleration
    error_at: Callable[[np.ndarray], np.ndarray]  # function that returns the errors (m,) at other joint values (n,)


class Postures:
    """Finds joint values [rad or arm reaches] that reach given targets, by single attempts of a solver. Call `ready` first."""

    def __init__(self, robot: Any, options: Options, speed: np.ndarray) -> None:
        """Prepare the solver; options: which errors count; speed (n,): speed limits [rad/s or arm reaches/s]."""
        self.robot = robot
        o = {name: getattr(options, name) for name in (*COUNTING, "relative_to", "priority")}
        row = find_row(search_for(options.priority))
        one_attempt = Options(restarts=0, position_tolerance=TOLERANCE, orientation_tolerance=TOLERANCE, **o)
        self.plan = Plan(robot, row, row.load()(), one_attempt)
        weights = tuple((speed / max(speed.max(), 1e-300)).tolist())
        self.quick = Plan(robot, row, row.load()(), replace(one_attempt, joint_weights=weights))
        box = Ends(robot.chain.ends.reshape(len(robot.tips), -1)[0], robot.n)
        # Only errors of the highest priority level count: lower ones are no reason to look for another posture.
        firm = np.repeat(np.equal(group_levels(robot, options), 0), 3)
        self._lever = np.tile([1.0] * 3 + [options.length_scale or LEVER] * 3, len(robot.tips)) * firm
        self._turning = np.array([box.turns(i) > 0.0 for i in range(robot.n)])

    def ready(self, kinds: tuple) -> None:
        """Prepare for targets of these kinds (KIND.pose or KIND.position), one for each tip; compile all that is needed later."""
        self.kinds = kinds
        q = self.robot.home / self.robot.chain.unit
        unlimited = np.outer([-1.0, 1.0, 1.0, 1.0], np.full(len(q), np.inf))
        for quick in (False, True):
            self.find(np.tile(np.eye(4), (1, len(kinds), 1, 1)), q[None], q, unlimited, quick=quick)
        code, h = np.zeros(len(q), np.uint8), ARRIVAL.wait
        travel(q, np.zeros_like(q), q, *UNKNOWN, 0.0, 1.0, h, h, unlimited, code)

    def find(
        self, T: np.ndarray, starts: np.ndarray, q: np.ndarray, limits: np.ndarray, *, quick: bool = False
    ) -> tuple[np.ndarray, bool]:
        """Make one solver attempt from each start; return the joint values (K, n) found inside the limits.

        Args:
            T: Targets (N, F, 4, 4) [m].
            starts: Starts (N, n).
            q: Joint values (n,); results are shifted by multiples of 2 pi to be as near to them as possible.
            limits: Limits (4, n).
            quick: Whether to prefer solutions in which slow joints move less.

        Returns:
            The joint values in the order of the starts, and whether a target is proven out of reach for all joint values.
        """
        plan, unit = self.quick if quick else self.plan, self.robot.chain.unit
        rows = np.zeros((len(starts), plan.width))
        plan.run(T.reshape(-1, *self.robot.pose_shape), self.kinds, starts * unit, True, rows)
        status = rows[:, AT.status]
        found = rows[status == CODE.converged, plan.q_columns] / unit
        if not len(found):
            return found, bool((status == CODE.unreachable).any())
        turns = np.where(self._turning, np.round((q - found) / TAU), 0.0)
        turns = np.clip(turns, np.ceil((limits[0] - found) / TAU), np.floor((limits[1] - found) / TAU))
        found = found + TAU * turns
        inside = ((found >= limits[0] - MARGIN.noise) & (found <= limits[1] + MARGIN.noise)).all(axis=1)
        return np.clip(found[inside], limits[0], limits[1]), bool((status == CODE.unreachable).any())

    def size(self, E: np.ndarray) -> float:
        """Return errors (m,) of all tips [m, rad] as one number [m], in which 1 rad counts as length_scale."""
        return math.hypot(*(self._lever * E).tolist())


def gap(T: np.ndarray, before: np.ndarray) -> float:
    """Return how far apart two sets of poses T, before (F, 4, 4) are: the norm of the differences of all entries (m and unit 1)."""
    return math.hypot(*(T - before).ravel().tolist())


def locked(limits: np.ndarray) -> bool:
    """Return whether any joint cannot move in limits (4, n): its speed limit is 0, or its position limits are equal."""
    return bool(((limits[2] == 0.0) | (limits[0] == limits[1])).any())


FAST = BIT.velocity | BIT.recovering  # bits of the limits that hold a joint back only for a time


class SearchConstants(NamedTuple):
    """Constants that set when another posture is searched for, and how long. Times were measured with 6 and 7 joints."""

    progress: float = 0.9  # an error below this share of the least error so far counts as progress
    attempts: int = 96  # solver attempts in a search; if one in ten succeeds, one search in 25,000 finds nothing
    attempt: float = 1e-5  # [s] duration of one attempt; for two arms 8 times as long
    # share of the time between two updates that a search may take; all attempts together take about 1 ms
    share: float = 0.05
    # A search also ends after this share of the duration of the best move found, because the arm is waiting.
    rush: float = 0.02
    pause: float = 3.0  # [s] time without a search after one that found nothing; it doubles each time while the target stands still
    longest: float = 16.0  # [s] longest such pause; at least 99 % of the updates are then free of searching
    # [m, or rotation matrix entries] If a stationary target has moved further than this, a new search does not wait for the pause
    # to end.
    elsewhere: float = 0.02


class MoveConstants(NamedTuple):
    """Constants for the cost of a move to another posture, and for when such a move begins and ends."""

    # if the target stands still, a move begins once the error, summed over time, has reached this share of the error expected on
    # the move
    standing: float = 0.3
    on_way: tuple[float, ...] = (0.25, 0.5, 0.75)  # fractions of a move at which the tip's error is evaluated
    # [s] If a joint at full speed would reach a position limit from a posture in less time than this, the difference is added to
    # the cost of the posture.
    headroom: float = 0.5
    far: float = 0.3  # [rad or arm reaches] postures that differ by more in some joint count as different
    barred: int = 5  # number of postures remembered as blocked by a collision
    # [s] A move ends, and the tracking method takes over, when the rest of the way takes this time at full joint speed.
    arrived: float = 0.05
    # [s] A move to a target that stands still goes on until the rest of the way takes only this time at full joint speed.
    close: float = 1e-3


SEARCH = SearchConstants()
MOVE = MoveConstants()


class Reconfiguration:
    """Decides whether and when a tracker moves to another posture, and takes the steps of the move.

    goal (n,): joint values [rad or arm reaches] to which the present move leads, or None; held: indices of the joints whose limits
    caused the move.
    """

    def __init__(self, robot: Any, postures: Postures, model: Any) -> None:
        """Prepare for a robot; postures: finds joint values for the targets.

        model: CollisionModel in which the joint values found must be free of contact, or None.
        """
        self.robot, self.postures, self.model = robot, postures, model
        self._attempt = SEARCH.attempt * len(robot.tips) ** 3
        self.begin()

    def begin(self) -> None:
        """Reset to the initial state: no goal, no search, no pause."""
        self._rng = np.random.default_rng(0)
        self.held: list[int] = []
        self._barred: list[np.ndarray] = []  # postures (n,) at which, or on the way to which, a collision was found
        self._place = np.zeros(0)  # target that the goal reaches, or for which `search_now` began a search
        self.forget()
        self._quiet, self._pause = 0.0, SEARCH.pause  # [s] left of the present pause, and length of the next one
        self._vain = np.zeros(0)  # target at the last search that found nothing

    def forget(self) -> None:
        """Give up the move and the search, because the target has been reached or has moved elsewhere."""
        self.goal: np.ndarray | None = None
        # time without progress [s], error summed over time [m s], least error [m]
        self._stood, self._lost, self._least = 0.0, 0.0, math.inf
        self._price, self._time = 0.0, 0.0  # cost [m s] and duration [s] of the move last found
        self._left = 0  # attempts left in the present search
        # cost [s] of the best posture found, its joint values, and the targets that it reaches
        self._best: tuple[float, np.ndarray, np.ndarray] | None = None
        self._stands = False  # whether the target was at rest when the search began
        self._now = False  # whether `search_now` began the search

    # ------------------------------------------------------------------------------------------------ when to search
    def watch(self, taken: Taken) -> None:
        """Examine a step that was taken: measure progress, search, and perhaps set `goal`."""
        T, q, limits, dt = taken.T[-1], taken.q, taken.limits, taken.dt
        stood = float(taken.stand[STAND.seconds])
        self._quiet -= taken.since
        if stood < taken.since:
            self._quiet = min(self._quiet, SEARCH.pause)
        if taken.left < REACHED:
            self.forget()
            self._pause, self._barred = SEARCH.pause, []
            return
        # If a joint has been locked since the search began, a move would never end, so the search is given up.
        if self._left and locked(limits):
            self.forget()
        if self._now:
            if gap(T, self._place) <= ARRIVAL.still:
                self._search(T, q, limits, dt)
                if not self._left:
                    self._now, self.goal = False, self._best[1] if self._best else None
                return
            self.forget()
        if not self._stuck(taken, stood):
            return
        if self._left:
            self._search(T, q, limits, dt)
            if not self._left:
                self._decide(taken, stood)
            return
        rests, stands = taken.stand[STAND.rest] >= ARRIVAL.wait, stood >= ARRIVAL.wait
        due = rests or (stands and stood >= self._time) or self._lost >= self._enough(stands)
        paused = self._quiet > 0.0 and not (stands and gap(T, self._vain) > SEARCH.elsewhere)
        # No search is begun with a locked joint: there are few other postures, and an operator who locks a joint wants no large
        # moves.
        if due and not paused and not locked(limits):
            self.held = np.flatnonzero(taken.code & BIT.position).tolist()
            self._stands = stands
            self._begin(q, limits)

    def _stuck(self, taken: Taken, stood: float) -> bool:
        """Add up what the error costs where position limits or a singular pose hold the arm; return whether it makes no progress.

        stood [s]: how long the target has stood.
        """
        held, error = int(np.bitwise_or.reduce(taken.code)), taken.left
        if not (held & BIT.position or taken.singular):
            return False
        # A joint at its speed limit is already moving as fast as it can, and so is one at its acceleration limit if the target
        # moves. If the target stands still, a joint at its acceleration limit may only be moving to and fro.
        if held & FAST or (held & BIT.acceleration and stood < ARRIVAL.wait):
            self._stood = 0.0
            return False
        self._lost += error * taken.dt
        self._stood += taken.dt
        if error < SEARCH.progress * self._least:
            self._least, self._stood, self._left = error, 0.0, 0
        return self._stood > ARRIVAL.wait

    def search_now(self, T: np.ndarray, q: np.ndarray, limits: np.ndarray) -> None:
        """Begin a search at the next step, for targets T (F, 4, 4) that jumped and now stand still.

        If the search finds nothing, `goal` stays None.
        """
        self.forget()
        self._place, self.held, self._now = T.copy(), [], True
        self._begin(q, limits)

    def _begin(self, q: np.ndarray, limits: np.ndarray) -> None:
        """Draw the starts of a search. Its attempts begin with the next update, as drawing takes as long as some attempts.

        Every other start is near q: it differs from q only in the joints at limits, or if there are none, it lies between q and a
        random configuration.
        """
        self._left, self._spent, self._best = SEARCH.attempts, 0.0, None
        starts = self.robot.random_q(self._rng, SEARCH.attempts) / self.robot.chain.unit
        self._shares = self._rng.random((SEARCH.attempts, 1))
        starts[0] = q
        if self.held:
            others = np.ones(len(q), bool)
            others[self.held] = False
            starts[1::2, others] = q[others]
        else:
            starts[1::2] = q + self._shares[1::2] * (starts[1::2] - q)
        self._starts = np.clip(starts, limits[0], limits[1])

    def _search(self, T: np.ndarray, q: np.ndarray, limits: np.ndarray, dt: float) -> None:
        """Make as many attempts of the search as an update has time for, and keep the best posture found."""
        done = SEARCH.attempts - self._left
        part = slice(done, done + max(round(SEARCH.share * dt / self._attempt), 1))
        starts, shares = self._starts[part], self._shares[part]
        if self._best is not None:  # Every other start lies between q and the best posture so far.
            odd = (np.arange(len(starts)) + done) % 2 == 1
            starts[odd] = q + shares[odd] * (self._best[1] - q)
        self._left -= len(starts)
        found, out = self.postures.find(np.repeat(T[None], len(starts), axis=0), starts, q, limits)
        if out:
            self._left = 0
        missing = np.maximum(MOVE.headroom - headroom(found, limits), 0.0)
        scored = [(time_left(q, p, limits) + more, p) for p, more in zip(found, missing.tolist(), strict=True)]
        scored = [one for one in scored if all(np.abs(one[1] - bad).max() > MOVE.far for bad in self._barred)]
        cost, p = min(scored, key=lambda one: one[0], default=(math.inf, q))
        if cost < (self._best[0] if self._best else math.inf):
            # A collision check takes up to a millisecond, so there is only one in an update.
            if self.model and self.model.collides(p * self.robot.chain.unit):
                self._bar(p)
            else:
                self._best = cost, p, T.copy()
        self._spent += dt
        if self._best is not None and self._spent >= SEARCH.rush * self._best[0]:
            self._left = 0

    def _decide(self, taken: Taken, stood: float) -> None:
        """After a search, set the goal, wait, or begin a pause; stood [s]: how long the target has stood."""
        if self._best is None:
            self._hold_off(taken.T[-1])
            self._barred = []
            return
        _, goal, place = self._best
        self._time = time_left(taken.q, goal, taken.limits)
        if stood < self._time and taken.stand[STAND.rest] < ARRIVAL.wait:
            on_way = [self.postures.size(taken.error_at(taken.q + part * (goal - taken.q))) for part in MOVE.on_way]
            self._price = sum(on_way) / len(on_way) * self._time
            if self._lost < self._enough(self._stands and taken.stand[STAND.still] != 0.0):
                return
        self.goal, self._place = goal, place  # If the target has moved since the search, `go` adapts the goal.

    def _enough(self, stands: bool) -> float:
        """Return the accumulated error [m s] that justifies the move last found."""
        return self._price * (MOVE.standing if stands else 1.0)

    def _hold_off(self, T: np.ndarray) -> None:
        """Begin a pause in which no search is made for targets T (F, 4, 4)."""
        self._vain, self._quiet = T.copy(), self._pause
        self._pause = min(2.0 * self._pause, SEARCH.longest)

    # ------------------------------------------------------------------------------------------------ on the way
    def go(
        self, q: np.ndarray, rate: np.ndarray, T: np.ndarray, gamma: float, h: float, late: float, limits: np.ndarray,
        code: np.ndarray,
    ) -> bool:  # fmt: skip
        """Step q and rate (n,) in place by h [s] towards the goal; return False, with nothing moved, if there is no goal any more.

        If the target T (F, 4, 4) has moved, joint values for it near the old goal become the new goal. gamma: weight of the new
        rate in a step; late [s]: longest later step; limits (4, n): lower, upper, speed, acceleration. code (n,) receives the bits
        of the limits that held joints back.
        """
        goal, near = self.goal, MOVE.arrived
        if goal is None or locked(limits):
            self.forget()
            return False
        if gap(T, self._place) <= ARRIVAL.still:
            near = MOVE.close
        else:
            found, _ = self.postures.find(np.array([T, T]), np.array([goal, q]), q, limits)
            least = time_left(q, goal, limits)
            found = [one for one in found if np.abs(one - goal).max() < MOVE.far or time_left(q, one, limits) < least]
            if not found:
                self.forget()
                return False
            self.goal = goal = min(found, key=lambda one: time_left(q, one, limits))
            self._place = T.copy()
        left = travel(q, rate, goal, *UNKNOWN, 0.0, gamma, h, late, limits, code)
        if left < near:
            self.forget()
        return left >= 0.0

    @property
    def why(self) -> Lead:
        """The move in words, with the joints whose limits caused it."""
        names = ", ".join(self.robot.joint_names[i] for i in self.held)
        return Lead(True, f"{Lead(True).words}: the limit of {names} ended the last one") if names else Lead(True)

    def blocked(self) -> None:
        """Give up the move because of a collision ahead; another posture may be free later."""
        # If the blocked step was to be the last one of the move, the goal has already been cleared.
        if self.goal is not None:
            self._bar(self.goal)
        self._hold_off(self._place)
        self.forget()

    def _bar(self, q: np.ndarray) -> None:
        """Remember that there is a collision at joint values q (n,), or on the way to them."""
        self._barred = [*self._barred, q][-MOVE.barred :]


def headroom(Q: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Return for each row of Q (N, n) the time [s] after which the first joint would reach a position limit at full speed."""
    return (np.minimum(Q - limits[0], limits[1] - Q) / speeds(limits)).min(axis=1)
