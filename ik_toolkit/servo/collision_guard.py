"""Collision avoidance of a tracker: inequalities that slow the arm near obstacles, and a proof that it can still stop.

The inequalities limit joint rates. They are made at the nearest points of the closest pairs of bodies, guide the arm,
and may be relaxed. The promise that nothing static is ever touched rests on the proof. It follows the path of the step and of the
braking to rest after it, and measures distances so densely that no contact fits between two measurements. A step that cannot be
proven free is not taken.
"""

from typing import Any, NamedTuple

import numpy as np

from ..kernel.clearance import along
from ..robot.geometry.distance import Clearance
from .viability import LIMIT, bending, stopping

ROWS = 12  # largest number of inequalities per step: enough for a polyhedron's corner, few enough for a fast QP
CONTACT = 1e-5  # [m] distance below which two bodies count as touching: ten times the tolerance of coal's distances


class GuardThresholds(NamedTuple):
    """Constants that set how the arm is slowed near obstacles, and how much work goes into proving a step free of contact."""

    # [m] distance from obstacles that the inequalities keep; in slow motion a real robot lags behind its commands by less
    keep: float = 0.005
    influence: float = 0.1  # [m] distance between two bodies below which their inequality applies
    # [m/s] speed at which two bodies may approach each other at the distance `influence`; it falls linearly to 0 at the distance
    # `keep`
    speed: float = 1.0
    # [m per rad or m] If all coefficients of an inequality are smaller, it is dropped, because no joint changes the distance.
    flat: float = 1e-9
    # An inequality counts on the braking only of joints whose coefficient exceeds this share of the largest one.
    share: float = 0.1
    nearest: float = 1e-4  # [m] A motion that comes nearer than this is rejected without checking whether it touches.
    # Largest number of configurations at which distances are measured (0.05 ms each) to prove a step free of contact.
    looks: int = 12
    # If a step is refused, steps between braking and the refused one are tried, at these fractions of the way from the first to the
    # second.
    parts: tuple[float, ...] = (1 / 2, 1 / 8, 1 / 64)


GUARD = GuardThresholds()


class Path(NamedTuple):
    """A step and the braking to rest after it, in K pieces: joint values, rates and distances covered (K + 1, n) at their ends.

    The first piece lasts h [s]. Joints brake together: even [1/s] is the share of the rates at which braking begins that they lose
    per second. The last row of `rate` is not the rate at the end, which is 0, but holds the rates at which braking begins. alone
    (n,): whether a joint brakes by itself instead, because its position limit is near; aside (n,): the distance that such a joint
    needs for braking, 0 for other joints.
    """

    q: np.ndarray
    rate: np.ndarray
    length: np.ndarray
    h: float
    even: float
    alone: np.ndarray
    aside: np.ndarray


class Guard:
    """Limits the joint rates of one tracker near contacts, and proves its steps free of contact.

    Args:
        robot: The robot.
        model: Its CollisionModel.
        limits: Limits (4, n): lower, upper, speed, acceleration [rad or m, per s, per s^2].
        gamma: Weight of the new rate in a step, q' = q + h ((1 - gamma) rate + gamma rate').

    Attributes:
        pairs: Names of the pairs of bodies that the last inequalities keep apart.
        blocked: Names of the pair of bodies because of which the last step was refused, or None.
    """

    def __init__(self, robot: Any, model: Any, limits: np.ndarray, gamma: float) -> None:
        """Bind to the model, and compile (or load) all code that is needed later. Call `restart` before any other method."""
        self.robot, self.model, self.limits, self.gamma = robot, model, limits, gamma
        self.A, self.b, self._order = np.zeros((ROWS, robot.n)), np.zeros(ROWS), np.zeros(ROWS, dtype=int)
        self.pairs: list[tuple[str, str]] = []
        self.blocked: tuple[str, str] | None = None
        # [s] longest step that may follow: the arm must be able to brake before a contact also after such a step
        self.late = 0.0
        self._bind()
        self._get_ready()

    def _bind(self) -> None:
        """Read the obstacles and the margins of the collision model as they are now."""
        self._space = space = Clearance(self.model)
        self._version = self.model.version
        # Two links of a robot may be closer than GUARD.keep in its home configuration; then half of their distance there is kept.
        home = space.home - space.margins
        self._keep = np.where(space.own & (home > 0.0), np.minimum(0.5 * home, GUARD.keep), GUARD.keep)

    def __getstate__(self) -> dict[str, Any]:
        """Return all attributes for pickling; of the distance measurements, only the nearest points are kept."""
        kept = {name: value for name, value in vars(self).items() if name != "_space"}
        return kept | {"_version": self._version == self.model.version, "corners": self._space.corners()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore pickled attributes; distances are measured again, and the model is read again if it has changed."""
        corners = state.pop("corners")
        vars(self).update(state)
        self._space = Clearance(self.model)
        self._space.recall(corners)
        self._version = self.model.version if self._version else None
        self._fresh, self._known = np.zeros_like(self._fresh), False

    def _get_ready(self) -> None:
        """Call every compiled function once, so that none is compiled inside a control loop when the arm has to brake."""
        space, q, still = self._space, self.robot.home, np.zeros(self.robot.n)
        path, ks = self._follow(q[None], still[None], 1.0), np.arange(len(self._keep))[:1]
        if path is None:
            return
        space.move()
        way = path.q, path.rate, path.length, self.gamma, path.h
        along(*way, 0.0, still.copy(), np.empty_like(still))
        levers, _ = space.levers(path.length[-1])
        space.free_until(ks, np.ones(len(ks)), levers, *way, 0.0)
        rules = self.limits[LIMIT.acceleration], 1.0, 1.0, GUARD.share, GUARD.flat
        space.rows(ks, space.points(ks), np.ones(len(ks)), still, *rules, self.A, self.b, self._order)

    def restart(self, q: np.ndarray) -> tuple[str, str] | None:
        """Measure all distances at q (n,) [rad or m]; return the names of a pair of bodies in contact there, or None."""
        if self._version != self.model.version:  # a shape of the collision model was added, moved or removed
            self._bind()
        self._space.forget()
        self._space.place(q)
        # (P,) lower bounds of the distances of all pairs at q, less their margins [m]
        self._low = self._space.distances() - self._space.margins
        # (P,) whether the distance of each pair was measured at q; if not, only a bound is known
        self._fresh = np.ones(len(self._low), dtype=bool)
        self._known = False  # whether the joint Jacobians of all bodies have been computed at q
        # (P,) [m] how much closer each pair can come, at most, during the last step taken and the braking after it
        self._stop = np.zeros(len(self._low))
        self._path: Path | None = None
        # ratio of the joint rates at present to those at the beginning of the braking that was proven free
        self._left = 1.0
        touching = np.flatnonzero(self._low <= CONTACT)
        return self._space.name(int(touching[0])) if len(touching) else None

    # ------------------------------------------------------------------------------------------------ rows
    def rows(self, q: np.ndarray, rate: np.ndarray, h: float) -> int:
        """Write r inequalities A x <= b on the next joint rates x [rad/s or m/s] to A (r, n) and b (r,) of this object; return r.

        Each inequality limits how fast a pair of bodies comes closer, so that the arm can still brake. q, rate (n,): present joint
        values and rates; h [s]: length of the step.
        """
        self.pairs = []
        if self._version != self.model.version:  # a shape of the collision model was added, moved or removed
            self.restart(q)
        reach = GUARD.influence + self._stop
        ks = np.flatnonzero(self._low < reach)
        if not len(ks):
            return 0
        space = self._space
        space.place(q)
        space.move()
        self._known = True
        # Distances that were measured before are measured again, because an inequality also needs the nearest points.
        self._fresh[ks] = False
        self._measure(ks)
        ks = ks[(self._low[ks] < reach[ks]) & (self._low[ks] > CONTACT)]
        if not len(ks):
            return 0
        ks, points, distances = space.facing(ks, self._low[ks] + space.margins[ks])
        gap = distances - space.margins[ks] - self._keep[ks]
        rules = (
            self.limits[LIMIT.acceleration],
            GUARD.speed / (GUARD.influence - GUARD.keep),
            h,
            GUARD.share,
            GUARD.flat,
        )
        count = space.rows(ks, points, gap, rate, *rules, self.A, self.b, self._order)
        self.pairs = [space.name(k) for k in ks[self._order[:count]].tolist()]
        return count

    def _measure(self, ks: np.ndarray) -> None:
        """Measure the distances of the pairs of bodies ks at the start of the step, if not yet measured."""
        for k in ks[~self._fresh[ks]].tolist():
            self._low[k] = self._space.gap(k)
        self._fresh[ks] = True

    # ------------------------------------------------------------------------------------------------ the proof
    def allows(self, q: np.ndarray, rate: np.ndarray, q1: np.ndarray, rate1: np.ndarray, h: float) -> bool:
        """Return whether the step from (q, rate) to (q1, rate1) in h [s] and the braking to rest after it are proven free.

        Joint values and rates (n,) are in rad or m. q must be where the last step ended. A step that is allowed counts as taken.
        If it is not, `blocked` names the pair of bodies that may touch.
        """
        free, self.blocked = self._take(np.array([q, q1]), np.array([rate, rate1]), h)
        return free

    def instead(
        self, q: np.ndarray, rate: np.ndarray, q1: np.ndarray, rate1: np.ndarray, h: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return joint values and rates (n,) after a step of h [s] that replaces the refused step from (q, rate) to (q1, rate1).

        The arm brakes, but only as hard as it has to: it takes the largest part of the step that is proven free. Limits that both
        the step and the braking keep are also kept by every motion between these two.
        """
        braked, slower, _ = self._braking(q, rate, h)
        for part in GUARD.parts:
            near, slow = braked + part * (q1 - braked), slower + part * (rate1 - slower)
            if self._take(np.array([q, near]), np.array([rate, slow]), h)[0]:
                return near, slow
        return self.brake(q, rate, h)

    def brake(self, q: np.ndarray, rate: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        """Return joint values and rates (n,) after h [s] of braking from (q, rate).

        The arm follows the braking motion that was proven free of contact together with the last step. If no step has been proven
        yet, a braking motion is planned here, even if it cannot be proven free.
        """
        q1, rate1, self._left = self._braking(q, rate, h)
        if self._path is not None:
            self._moved(np.abs(q1 - q))
        return q1, rate1

    def _braking(self, q: np.ndarray, rate: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the joint values and rates of `brake`, and the ratio of these rates to those with which the braking began."""
        # No braking motion is known yet if this guard has not proven the step that led here.
        if self._path is None:
            self._take(q[None], rate[None], h, anyway=True)
        if (path := self._path) is None:
            return q.copy(), np.zeros_like(q), self._left
        left = max(self._left - path.even * h, 0.0)
        own = np.sign(rate) * np.maximum(np.abs(rate) - self.most * h, 0.0)
        rate1 = np.where(path.alone, own, left * path.rate[-1])
        before = np.where(path.alone, rate, self._left * path.rate[-1])
        return q + h * ((1.0 - self.gamma) * before + self.gamma * rate1), rate1, left

    @property
    def most(self) -> np.ndarray:
        """Largest change (n,) of joint rates from step to step, per second [rad/s^2 or m/s^2], that keeps the acceleration limits.

        It is below the limits where joints accelerate more inside a step than from one to the next.
        """
        return self.limits[LIMIT.acceleration] / bending(self.gamma)

    def _moved(self, way: np.ndarray) -> None:
        """Lower the bounds on all distances, after the joints have moved by `way` (n,) along the proven path."""
        self._low = self._low - self._levers @ way[self._space.coordinates]
        self._fresh[:] = False
        self._known = False

    def _take(
        self, Q: np.ndarray, R: np.ndarray, h: float, anyway: bool = False
    ) -> tuple[bool, tuple[str, str] | None]:
        """Try to prove the motion through the states Q, R (1 or 2, n) and the braking after it free of contact.

        A motion that is free, or any motion if `anyway`, counts as taken. h [s]: length of the step. Returns whether the motion is
        free, and the names of a pair of bodies that may touch.
        """
        path, blocked = self._follow(Q, R, h), None
        if path is None:
            return False, None
        space = self._space
        if not self._known:
            space.place(Q[0])
            space.move()
            self._known = True
        levers, self._stop = space.levers(path.length[-1])
        doubtful = np.flatnonzero(self._stop >= self._low - CONTACT)
        if len(doubtful):
            if not self._fresh[doubtful].all():
                space.place(Q[0])
                self._measure(doubtful)
            blocked = self._prove(path, doubtful, levers)
            # The proof has moved the bodies of the collision model to other configurations, so their Jacobians and nearest points
            # at q are lost.
            self._known = False
            self._fresh[:] = False
            if not (blocked is None or anyway):
                return False, blocked
        self._path, self._levers, self._left = path, levers, 1.0
        if len(Q) > 1:
            self._moved(path.length[1])
        return blocked is None, blocked

    def _follow(self, Q: np.ndarray, R: np.ndarray, h: float) -> Path | None:
        """Return the path through the states Q, R (1 or 2, n) and the braking to rest after them; None if a joint cannot brake.

        The braking must suit later steps of any lengths up to `late`, while a short step can hardly change the rates within the
        acceleration limits. All joints therefore lose the same share of their initial rates per second. The arm then stays on one
        line in joint space whatever the lengths of the steps, and stops no later on it than with the worst lengths. A joint whose
        position limit is nearer than that brakes on its own.
        """
        q, rate = Q[-1], R[-1]
        lower, upper = self.limits[[LIMIT.lowest, LIMIT.highest]]
        speed, most, late = np.abs(rate), self.most, max(self.late, h)
        with np.errstate(divide="ignore", invalid="ignore"):
            even = np.where(speed > 0.0, most / speed, np.inf).min()
            if even <= 0.0:
                return None
            room = np.where(rate > 0.0, upper - q, q - lower)
        time = stopping(1.0, self.gamma, even, late)
        alone, aside = (speed > 0.0) & (speed * time > room), np.zeros(len(q))
        for i in np.flatnonzero(alone):
            aside[i] = stopping(speed[i], self.gamma, most[i], late)
        move = np.where(alone, 0.0, rate * time)
        all_q, rates, length = np.zeros((3, len(Q) + 1, len(q)))
        all_q[:-1], all_q[-1] = Q, q + move
        # The last piece, the braking, is stored as if the joints moved at a constant rate.
        rates[:-2], rates[-2], rates[-1] = R[:-1], move / h, rate
        length[-1] = np.abs(move)
        if len(Q) > 1:
            along(Q, R, length[:2], self.gamma, h, 1.0, np.empty(len(q)), length[1])
            length[2] += length[1]
        length[-1] += aside
        return Path(all_q, rates, length, h, float(even), alone, aside)

    def _prove(self, path: Path, ks: np.ndarray, levers: np.ndarray) -> tuple[str, str] | None:
        """Return None if the pairs of bodies ks are proven free along a path, else the names of one that is not.

        The distances of ks are measured at the start; levers (P, E) bounds how fast each pair can come closer per
        joint.
        """
        space, u, end = self._space, 0.0, len(path.q) - 1.0
        way = path.q, path.rate, path.length, self.gamma, path.h
        q, gone = np.empty(self.robot.n), np.empty(self.robot.n)
        aside = levers[ks] @ path.aside[space.coordinates]
        distances = self._low[ks] - aside
        nearest = np.clip(0.5 * distances, CONTACT, GUARD.nearest)
        for _ in range(GUARD.looks):
            if (distances <= nearest).any():
                break
            free = space.free_until(ks, distances - CONTACT, levers, *way, u)
            left = free < end
            if not left.any():
                return None
            ks, free, nearest, aside = ks[left], free[left], nearest[left], aside[left]
            before, u = u, free.min()
            if u <= before:
                return space.name(int(ks[np.argmin(free)]))
            along(*way, u, q, gone)
            space.place(q)
            space.move()
            distances = np.array([space.gap(k) for k in ks.tolist()]) - aside
        return space.name(int(ks[np.argmin(distances)]))
