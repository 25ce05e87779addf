"""Another posture for a tracker: found where the arm stands at limits and only other joint values reach the target.

`Postures` finds joint values near given ones that reach the targets, by single attempts of the solver; `Reconfiguration` decides.

A tracker goes downhill, so a tool that is turned on and on ends where a joint is at its limit and every small motion makes the
error larger. The solver's attempts from other starts then find joint values for the same target, and the arm moves there through
its joints. Two things are decided here:

When to search: only when limits, or a singular pose, have kept the error from falling for a while, and speed has not; at once for
a target that leapt to where the solver does not get from here. A search is spread over updates so that none takes much longer;
after one in vain there is a pause.

When to move: on the way the tip leaves its target, which may come back by itself. So the arm waits until it has lost as much [m s]
as the way costs, never more than twice what would have been best; less of it while the target stands, which may be where it turns
back; not at all once it is at rest, or has stood for as long as the way takes.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..kernel.checks import CONVERGED, UNREACHABLE
from ..kernel.kinematics import TAU
from ..kernel.records import ANSWER, AT, Ends
from ..solvers.options import COUNTING, Options
from ..solvers.plan import Plan
from ..solvers.registry import GENERAL, find_row
from .adapters import LEVER
from .motion_limits import speeds
from .target_stream import STAND, STILL, WAIT
from .viability import ACCELERATION, NOISE, POSITION, RECOVERING, UNKNOWN, VELOCITY, time_left, travel

TOLERANCE = 1e-5  # [m, rad] of a posture: the tracker itself comes closer
TINY = 1e-300  # divided by where no joint has a speed
REACHED = 1e-3  # [m] error, angles at LEVER, below which a target counts as reached


class Taken(NamedTuple):
    """A step taken by a tracker, in kernel units but for E and T; arrays are the tracker's own."""

    code: np.ndarray  # (n,) bits of limits
    singular: bool
    E: np.ndarray  # (2, m) errors before and after it [m, rad], base axes
    left: float  # [m] error after it, see `Postures.size`
    T: np.ndarray  # (2, F, 4, 4) targets before and after it
    stand: np.ndarray  # whether the target stands, see `arrival.Stand`
    dt: float  # [s] of the update
    since: float  # [s] since the one looked at before it: those that end at their target, unhindered, are not
    q: np.ndarray  # (n,) afterwards
    rate: np.ndarray
    limits: np.ndarray  # (4, n)
    law: np.ndarray  # a `motion.Law`
    error_at: Callable[[np.ndarray], np.ndarray]  # E at other joint values


class Postures:
    """Finds joint values for targets of the kinds that `ready` was told. Kernel units."""

    def __init__(self, robot: Any, options: Options, speed: np.ndarray) -> None:
        """options: what counts; speed (n,) of the joints."""
        self.robot = robot
        o = {name: getattr(options, name) for name in (*COUNTING, "relative_to")}
        exact = {"position_tolerance": TOLERANCE, "orientation_tolerance": TOLERANCE}
        row = find_row(GENERAL)
        one_attempt = Options(restarts=0, **exact, **o)
        self.plan = Plan(robot, row, row.load()(), one_attempt)
        weights = tuple((speed / max(speed.max(), TINY)).tolist())
        self.quick = Plan(robot, row, row.load()(), replace(one_attempt, joint_weights=weights))
        box = Ends(robot.chain.ends.reshape(len(robot.tips), -1)[0], robot.n)
        self._lever = np.tile([1.0] * 3 + [LEVER] * 3, len(robot.tips))
        self._turning = np.array([box.turns(i) > 0.0 for i in range(robot.n)])

    def ready(self, kinds: tuple) -> None:
        """Take targets of these kinds, and compile (or load) all that is needed later."""
        self.kinds = kinds
        q = self.robot.home / self.robot.chain.unit
        unlimited = np.outer([-1.0, 1.0, 1.0, 1.0], np.full(len(q), np.inf))
        for quick in (False, True):
            self.find(np.tile(np.eye(4), (1, len(kinds), 1, 1)), q[None], q, unlimited, quick=quick)
        travel(q, np.zeros_like(q), q, *UNKNOWN, 0.0, 1.0, WAIT, WAIT, unlimited, np.zeros(len(q), np.uint8))

    def find(
        self, T: np.ndarray, starts: np.ndarray, q: np.ndarray, limits: np.ndarray, *, quick: bool = False
    ) -> tuple[np.ndarray, bool]:
        """Joint values (K, n) of the attempts for targets T (N, F, 4, 4) from starts (N, n) that end inside limits (4, n).

        They are in order, and as near to q (n,) as full turns allow. quick: slow joints are to move less. Also True when a target
        is out of all reach.
        """
        plan, unit, n = self.quick if quick else self.plan, self.robot.chain.unit, self.robot.n
        rows = np.zeros((len(starts), plan.width))
        plan.run(T.reshape(-1, *self.robot.pose_shape), self.kinds, starts * unit, True, rows)
        status = rows[:, AT.status]
        found = rows[status == CONVERGED, ANSWER : ANSWER + n] / unit
        if not len(found):
            return found, bool((status == UNREACHABLE).any())
        turns = np.where(self._turning, np.round((q - found) / TAU), 0.0)
        turns = np.clip(turns, np.ceil((limits[0] - found) / TAU), np.floor((limits[1] - found) / TAU))
        found = found + TAU * turns
        inside = ((found >= limits[0] - NOISE) & (found <= limits[1] + NOISE)).all(axis=1)
        return np.clip(found[inside], limits[0], limits[1]), bool((status == UNREACHABLE).any())

    def size(self, E: np.ndarray) -> float:
        """Errors (m,) of all tips [m, rad] as one number [m]."""
        return math.hypot(*(self._lever * E).tolist())


def gap(T: np.ndarray, before: np.ndarray) -> float:
    """How far poses (F, 4, 4) are from others, as one number."""
    return math.hypot(*(T - before).ravel().tolist())


def locked(limits: np.ndarray) -> bool:
    """Whether a joint may not move."""
    return bool(((limits[2] == 0.0) | (limits[0] == limits[1])).any())


FAST = VELOCITY | RECOVERING  # what holds a joint back only for a while
PROGRESS = 0.9  # of the least error so far: what falls below is on its way
SHARE = 0.05  # of the time between two updates that a search may take: one arm's is over after 0.02 s, whatever the rate ...
ATTEMPT = 1e-5  # [s] ... as an attempt takes so long, of one arm of six or seven joints; of two arms 8 times as long
ATTEMPTS = 96  # of a search; where one in ten succeeds, all fail once in 25,000 searches
RUSH = 0.02  # of the time of the best way found so far, after which the search ends: the arm waits meanwhile
PAUSE = 3.0  # [s] after a search in vain; while the target stands twice as long after each more ...
LONGEST = 16.0  # ... up to this: of one arm's updates 99 % do not search
ELSEWHERE = 0.02  # [m, or of a rotation] from where a search was in vain, a target that stands is worth another at once
BARRED = 5  # postures that are kept in mind as not free
HEADROOM = 0.5  # [s] of a joint at full speed before its limit: what is missing of it counts like a longer way
ARRIVED = 0.05  # [s] left at full speed, from which on the tracker itself comes closer
CLOSE = 1e-3  # [s] the same where the target stands: nothing can hold the tracker back so near
FAR = 0.3  # [rad, or reaches] move of a joint from one update to the next by which a posture is another one
STANDING = 0.3  # of what the way costs that must have been lost where the target stands
ON_WAY = (0.25, 0.5, 0.75)  # parts of the way at which its error is looked at


class Reconfiguration:
    """What a tracker knows of another posture. goal (n,): where it is going [kernel units], or None; held: joints at limits."""

    def __init__(self, robot: Any, postures: Postures, model: Any) -> None:
        """model: CollisionModel that goals must be free of, or None."""
        self.robot, self.postures, self.model = robot, postures, model
        self._attempt = ATTEMPT * len(robot.tips) ** 3
        self.begin()

    def begin(self) -> None:
        """Everything begins anew."""
        self._rng = np.random.default_rng(0)
        self.held: list[int] = []
        self._barred: list[np.ndarray] = []  # postures with something there, or in the way
        self._place = np.zeros(0)  # target of the goal, or of the search that was asked for
        self.forget()
        self._quiet, self._pause = 0.0, PAUSE  # [s] in which no search begins, and after the next one in vain
        self._vain = np.zeros(0)  # where the target was at the last one

    def forget(self) -> None:
        """The target is reached, or left."""
        self.goal: np.ndarray | None = None
        self._stood, self._lost, self._least = 0.0, 0.0, math.inf  # [s], [m s], [m] since it was left behind
        self._price, self._time = 0.0, 0.0  # [m s], [s] of the way last found
        self._left = 0  # attempts of a search that goes on
        self._best: tuple[float, np.ndarray, np.ndarray] | None = None  # cost [s], joint values, and their target
        self._stands = False  # whether the target stood when it began
        self._now = False  # whether it was asked for, wherever the arm is

    # ------------------------------------------------------------------------------------------------ when to search
    def watch(self, taken: Taken) -> None:
        """Look at a step taken. May set `goal`."""
        T, q, limits, dt = taken.T[-1], taken.q, taken.limits, taken.dt
        stood = float(taken.stand[STAND.seconds])
        self._quiet -= taken.since
        if stood < taken.since:
            self._quiet = min(self._quiet, PAUSE)
        error = taken.left
        if error < REACHED:
            self.forget()
            self._pause, self._barred = PAUSE, []
            return
        if self._left and locked(limits):  # during a search: the time to anywhere has no bound any more
            self.forget()
        if self._now:
            if gap(T, self._place) <= STILL:
                self._search(T, q, limits, dt)
                if not self._left:
                    self._now, self.goal = False, self._best[1] if self._best else None
                return
            self.forget()
        code, held = taken.code.tolist(), 0
        for bits in code:
            held |= bits
        if not (held & POSITION or taken.singular):
            return
        # On its way as fast as it can. Joints that tremble where a target stands are at an acceleration limit, too.
        if held & FAST or (held & ACCELERATION and stood < WAIT):
            self._stood = 0.0
            return
        self._lost += error * dt
        self._stood += dt
        if error < PROGRESS * self._least:
            self._least, self._stood, self._left = error, 0.0, 0
        if self._stood <= WAIT:
            return
        rests = taken.stand[STAND.rest] >= WAIT
        stands = stood >= WAIT
        if not self._left and (rests or (stands and stood >= self._time) or self._lost >= self._enough(stands)):
            paused = self._quiet > 0.0 and not (stands and gap(T, self._vain) > ELSEWHERE)
            if paused or locked(limits):  # a locked arm has few postures, and its operator other plans
                return
            self.held = [i for i, bits in enumerate(code) if bits & POSITION]
            self._stands = stands
            self._begin(q, limits)
        elif self._left:
            self._search(T, q, limits, dt)
            if not self._left:
                self._decide(taken, stood)

    def search_now(self, T: np.ndarray, q: np.ndarray, limits: np.ndarray) -> None:
        """Search for a target T (F, 4, 4) that leapt and stands, from the next step on; in vain, all goes on as before."""
        self.forget()
        self._place, self.held, self._now = T.copy(), [], True
        self._begin(q, limits)

    def _begin(self, q: np.ndarray, limits: np.ndarray) -> None:
        """Draw the starts of a search: attempts begin with the next update, as drawing takes as long as some of them.

        Every other one has only the joints at limits elsewhere, or lies on the way from q to a random one.
        """
        self._left, self._spent, self._best = ATTEMPTS, 0.0, None
        starts = self.robot.random_q(self._rng, ATTEMPTS) / self.robot.chain.unit
        self._shares = self._rng.random((ATTEMPTS, 1))
        starts[0] = q
        if self.held:
            others = np.ones(len(q), bool)
            others[self.held] = False
            starts[1::2, others] = q[others]
        else:
            starts[1::2] = q + self._shares[1::2] * (starts[1::2] - q)
        self._starts = np.clip(starts, limits[0], limits[1])

    def _search(self, T: np.ndarray, q: np.ndarray, limits: np.ndarray, dt: float) -> None:
        """As many attempts of the search as an update has time for."""
        done = ATTEMPTS - self._left
        part = slice(done, done + max(round(SHARE * dt / self._attempt), 1))
        starts, shares = self._starts[part], self._shares[part]
        if self._best is not None:  # every other one on the way to the best so far
            odd = (np.arange(len(starts)) + done) % 2 == 1
            starts[odd] = q + shares[odd] * (self._best[1] - q)
        self._left -= len(starts)
        found, out = self.postures.find(np.repeat(T[None], len(starts), axis=0), starts, q, limits)
        if out:
            self._left = 0
        missing = np.maximum(HEADROOM - headroom(found, limits), 0.0)
        scored = [(time_left(q, p, limits) + more, p) for p, more in zip(found, missing.tolist(), strict=True)]
        scored = [one for one in scored if all(np.abs(one[1] - bad).max() > FAR for bad in self._barred)]
        cost, p = min(scored, key=lambda one: one[0], default=(math.inf, q))
        if cost < (self._best[0] if self._best else math.inf):
            if self.model and self.model.collides(p * self.robot.chain.unit):  # up to a millisecond: one look an update
                self._bar(p)
            else:
                self._best = cost, p, T.copy()
        self._spent += dt
        if self._best is not None and self._spent >= RUSH * self._best[0]:
            self._left = 0

    def _decide(self, taken: Taken, stood: float) -> None:
        """After a search: go, wait, or do not search again for a while. stood [s]: for how long the target has."""
        if self._best is None:
            self._hold_off(taken.T[-1])
            self._barred = []
            return
        _, goal, place = self._best
        q = taken.q
        self._time = time_left(q, goal, taken.limits)
        if stood < self._time and taken.stand[STAND.rest] < WAIT:
            on_way = sum(self.postures.size(taken.error_at(q + part * (goal - q))) for part in ON_WAY) / len(ON_WAY)
            self._price = on_way * self._time
            if self._lost < self._enough(self._stands and taken.stand[STAND.still] != 0.0):
                return
        self.goal, self._place = goal, place  # the target may have gone on since: `go` follows it from there

    def _enough(self, stands: bool) -> float:
        """Error [m s] that is worth the way last found."""
        return self._price * (STANDING if stands else 1.0)

    def _hold_off(self, T: np.ndarray) -> None:
        """There is no way to targets T (F, 4, 4) for now."""
        self._vain, self._quiet = T.copy(), self._pause
        self._pause = min(2.0 * self._pause, LONGEST)

    # ------------------------------------------------------------------------------------------------ on the way
    def go(
        self, q: np.ndarray, rate: np.ndarray, T: np.ndarray, gamma: float, h: float, late: float, limits: np.ndarray,
        code: np.ndarray,
    ) -> bool:  # fmt: skip
        """Step q and rate (n,) in place by h [s] towards the goal; False, and nothing done, when there is none any more.

        code (n,) receives what held joints back.
        """
        goal, near = self.goal, ARRIVED
        if goal is None or locked(limits):
            self.forget()
            return False
        if gap(T, self._place) <= STILL:
            near = CLOSE
        else:
            found, _ = self.postures.find(np.array([T, T]), np.array([goal, q]), q, limits)
            least = time_left(q, goal, limits)
            found = [one for one in found if np.abs(one - goal).max() < FAR or time_left(q, one, limits) < least]
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
    def why(self) -> tuple[str, ...]:
        """Names of the joints that were at limits."""
        return tuple(self.robot.joint_names[i] for i in self.held)

    def blocked(self) -> None:
        """Something is in the way: another goal may be free, later."""
        if self.goal is not None:  # None: this step would have been the last one on the way
            self._bar(self.goal)
        self._hold_off(self._place)
        self.forget()

    def _bar(self, q: np.ndarray) -> None:
        """Keep in mind that something is at, or on the way to, joint values q (n,)."""
        self._barred = [*self._barred, q][-BARRED:]


def headroom(Q: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Least time [s] in which a joint at full speed is at its limit, of each of joint values Q (N, n)."""
    return (np.minimum(Q - limits[0], limits[1] - Q) / speeds(limits)).min(axis=1)
