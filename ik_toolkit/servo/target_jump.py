"""A target that jumped and stands still: the tip moves there in a straight line, or by a direct joint move if much faster.

The feedback of a method closes an error in proportion to its size. Inside joint limits that loses time twice: the tip slows down
long before its target, and a straight line of the tip can be a long way for the joints, or end where no joint can go
on. So if an error hardly falls although the target stands still, joint values are solved for at once, for the target and for
points on the straight line before it. The line is chosen unless it needs more than STRAIGHT times as long as moving all
joints directly (`travel`). If the solver's attempt from the present joint values fails, other starts are tried
(reconfigure.py), as feedback would mostly fail, too.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ..motion.reference import exp
from ..motion.time_law import time_law, times_of
from ..validate import positive, switch
from .adapters import Published, RuleSteps
from .reconfigure import Postures, Reconfiguration, Taken, gap, locked
from .step import Lead
from .stepper import speeds
from .target_stream import ARRIVAL, STAND
from .viability import BIT, LIMIT, MARGIN, UNKNOWN, bending, time_left, travel

# default of the option straight: the tip moves in a straight line if that takes at most this many times as long as the direct joint
# move
STRAIGHT = 1.2


class JumpThresholds(NamedTuple):
    """Thresholds for the move to a target that jumped, which replaces the tracking method: when it begins, its way, and its end."""

    # number of pieces of a straight line; the tip then leaves the line by 1/24^2 of its deviation in a single direct joint move
    points: int = 24
    # A straight line that takes this many times as long as a joint move must pass through a change of posture.
    torn: float = 4.0
    near: float = 2e-3  # [m] An error smaller than this (1 rad counts as length_scale) is left to the tracking method.
    # A tracking method counts as too slow if more than this share of an error is left after a step; with its best gains at most a
    # third is left.
    slow: float = 0.5
    # Of two postures found for the target, the one found by a solver that moves slow joints less is taken if the move there takes
    # less than this share of the time of the other move.
    sooner: float = 0.5
    close: float = 1e-3  # [s] time left at full joint speed below which a move counts as finished


LEAP = JumpThresholds()


class Route(NamedTuple):
    """A joint motion [rad or arm reaches] through K points, cubic in between.

    t (K,) [s]: times of the points; q (K, n) and rate (K, n): joint values and rates there.
    """

    t: np.ndarray
    q: np.ndarray
    rate: np.ndarray

    def hardest(self, a: np.ndarray) -> float:
        """Return the largest ratio of joint acceleration to limit a (n,); in a cubic piece it occurs at one of the ends."""
        h, d = np.diff(self.t)[:, None], np.diff(self.q, axis=0)
        first = 6.0 * d / h**2 - (4.0 * self.rate[:-1] + 2.0 * self.rate[1:]) / h
        last = (2.0 * self.rate[:-1] + 4.0 * self.rate[1:]) / h - 6.0 * d / h**2
        return float((np.maximum(np.abs(first), np.abs(last)) / a).max())

    def fastest(self, top: np.ndarray) -> float:
        """Return the largest ratio of joint rate to limit top (n,), at the ends and in the middle of the pieces."""
        h, d = np.diff(self.t)[:, None], np.diff(self.q, axis=0)
        middle = 1.5 * d / h - 0.25 * (self.rate[:-1] + self.rate[1:])
        return float(max((np.abs(self.rate) / top).max(), (np.abs(middle) / top).max()))


class Leap:
    """Moves the joints of a tracker to a target that jumped, in place of the tracking method.

    goal (n,): joint values [rad or arm reaches] at which the move under way ends, or None; why: which way it goes, as a `Lead`.
    """

    def __init__(
        self, postures: Postures, engine: Published | RuleSteps, straight: float, elsewhere: Reconfiguration | None
    ) -> None:
        """Bind the solver (postures) and the tracking method (engine).

        straight: largest ratio of the straight line's duration to that of the direct joint move; elsewhere: finds other postures,
        or None.
        """
        self.postures, self._engine, self._most, self._elsewhere = postures, engine, straight, elsewhere
        # This call compiles (or loads) the time law now, so that no control loop has to wait for it.
        timed(np.eye(2), np.zeros(2), np.ones((4, 2)), 1.0)
        self.forget()

    def forget(self) -> None:
        """Give up the move (goal None) and forget the last target."""
        self.goal: np.ndarray | None = None
        self.why = Lead(False, "")
        self._enough = LEAP.close  # [s] time left at full joint speed at which the tracking method takes over
        self._route: Route | None = None
        self._time = 0.0  # [s] time since the move began
        self._place = np.zeros(0)  # last target that was examined

    begin = forget

    def watch(self, taken: Taken) -> None:
        """Examine a step of the tracking method; set `goal` if the target jumped and the error falls too slowly."""
        T, q, limits = taken.T, taken.q, taken.limits
        if not taken.stand[STAND.still] or taken.left < LEAP.near:
            return
        if len(self._place) and gap(T[1], self._place) <= ARRIVAL.still:
            return
        if taken.left < LEAP.slow * self.postures.size(taken.E[0]):
            return
        # A target that moved here smoothly, without a jump, may be about to turn back, so no move begins until it has rested.
        if not taken.stand[STAND.jumped] and taken.stand[STAND.rest] < ARRIVAL.wait:
            return
        self._place = T[1].copy()
        # If the target moved here smoothly and a joint is at its limit, only another posture can reach it, for which
        # `Reconfiguration` searches. With a locked joint no move is made, because an operator who locks a joint wants no large
        # moves.
        if (not taken.stand[STAND.jumped] and (taken.code & BIT.position).any()) or locked(limits):
            return
        found, _ = self.postures.find(T[1:], q[None], q, limits)
        if len(found):
            sooner, _ = self.postures.find(T[1:], q[None], q, limits, quick=True)
            if len(sooner) and time_left(q, sooner[0], limits) < LEAP.sooner * time_left(q, found[0], limits):
                found = sooner
        self._enough = max(self._patience(taken.h), LEAP.close)
        if len(found) and time_left(q, found[0], limits) > self._enough:
            self._choose_way(found[0], taken)
        elif not len(found) and taken.stand[STAND.jumped] and self._elsewhere and self._enough <= LEAP.close:
            # There is only one search for each jump, even if the target then moves on slowly.
            taken.stand[STAND.jumped] = 0.0
            self._elsewhere.search_now(T[1], q, limits)

    def _choose_way(self, goal: np.ndarray, taken: Taken) -> None:
        """Choose between a straight line and a joint move to a goal (n,), and set `self.goal` if one is possible."""
        straight = self._straight(goal, taken)
        ratio = straight.t[-1] / least_time(np.abs(goal - taken.q), taken.limits) if straight else math.inf
        ratio = ratio if ratio < LEAP.torn else math.inf
        if ratio == math.inf and not self._elsewhere:
            return
        self.goal, self._time = goal, 0.0
        self._route = straight if ratio <= self._most and ratio < math.inf else None
        if ratio == math.inf:
            self.why = Lead(True)
        elif self._route:
            self.why = Lead(False, "the target jumped: going straight there as fast as the limits allow")
        else:
            how = f"moving there in joint space, as a straight line would take {ratio:.2g} times as long"
            self.why = Lead(False, f"the target jumped: {how}")

    def _patience(self, h: float) -> float:
        """Return the time [s] before the end of the move at which the tracking method takes over.

        If the caller chose the gains, it is their time constant in steps of h [s]. Otherwise it is 0, and the move leads to the
        target itself.
        """
        rate = self._engine.natural(h) if self._engine.chosen else 0.0
        return 1.0 / rate if rate > 0.0 else 0.0

    def _straight(self, goal: np.ndarray, taken: Taken) -> Route | None:
        """Return the fastest joint motion inside the limits along a straight line of the tip to the target.

        It is None if a point of the line cannot be reached, or two of its points have the same joint values.
        """
        T, q = taken.T[1], taken.q
        left = 1.0 - np.arange(1, LEAP.points) / LEAP.points
        points = np.repeat(T[None], LEAP.points - 1, axis=0)
        for f, e in enumerate(taken.E[1].reshape(-1, 6)):
            points[:, f, :3, 3] -= np.outer(left, e[:3])
            points[:, f, :3, :3] = exp(np.outer(-left, e[3:])) @ T[f, :3, :3]
        found, _ = self.postures.find(points, q + np.outer(1.0 - left, goal - q), q, taken.limits)
        if len(found) < len(points):
            return None
        way = np.concatenate([q[None], found, goal[None]])
        return timed(way, taken.rate, taken.limits, self._engine.gamma)

    def go(
        self, q: np.ndarray, rate: np.ndarray, T: np.ndarray, gamma: float, h: float, late: float, limits: np.ndarray,
        code: np.ndarray,
    ) -> bool:  # fmt: skip
        """Step q and rate (n,) in place by h [s] towards the goal; return False, with nothing moved, if there is no goal any more.

        gamma: weight of the new rate; late [s]: longest later step; code (n,): receives bits of the limits that held joints back.
        """
        goal, left = self.goal, -1.0
        self._time += h
        if goal is not None and gap(T, self._place) <= ARRIVAL.still:
            left = travel(q, rate, goal, *(self._route or UNKNOWN), self._time, gamma, h, late, limits, code)
        if left < 0.0:
            self.forget()
            return False
        if left <= self._enough:
            self.goal = None
        return True

    def blocked(self) -> None:
        """Give up the move because of a collision ahead; the tracking method takes over and may slide along the obstacle."""
        self.goal = None


def ways(
    postures: Postures | None, engine: Published | RuleSteps, straight: Any, reconfigure: Any, world: Any
) -> list[Leap | Reconfiguration]:
    """Return the objects that move a tracker's joints in place of its method where this fails or is slow.

    postures: finds joint values for targets; if None, the result is empty; engine: the tracking method; straight,
    reconfigure: options of `Tracker`; world: a CollisionModel or None. Raises InvalidOption.
    """
    elsewhere = switch(reconfigure, "reconfigure")
    longest = math.inf if isinstance(straight, float) and straight == math.inf else positive(straight, "straight")
    if postures is None:
        return []
    other = [Reconfiguration(postures.robot, postures, world)] if elsewhere else []
    return [Leap(postures, engine, longest, other[0] if other else None), *other]


def timed(points: np.ndarray, rate: np.ndarray, limits: np.ndarray, gamma: float) -> Route | None:
    """Return the fastest joint motion through points (K + 1, n), from joint rates rate (n,) to rest, inside limits (4, n).

    gamma: weight of the new rate in a step. The result is None if two neighbouring points coincide. The path coordinate is the time
    [s] at full speed: the length of a segment is the time in which the joint that needs longest covers it at its speed limit. The
    rate of the coordinate is therefore at most 1.
    """
    top, a = speeds(limits), (1.0 - MARGIN.held_back) * limits[LIMIT.acceleration] / bending(gamma)
    d = np.diff(points, axis=0)
    length = (np.abs(d) / top).max(axis=1)
    if not (length > 0.0).all():
        return None
    g = d / length[:, None]
    share = (length[1:] / (length[:-1] + length[1:]))[:, None]
    along = np.concatenate([g[:1], share * g[:-1] + (1.0 - share) * g[1:], g[-1:]])
    bend = np.zeros_like(along)
    bend[1:-1] = np.diff(g, axis=0) / (0.5 * (length[:-1] + length[1:]))[:, None]
    s, begin, end = np.append(0.0, np.cumsum(length)), 1.0, 1.0
    if (a < np.inf).any():
        begin, end = np.clip(rate @ g[0] / (g[0] @ g[0]), 0.0, 1.0), 0.0
    speed, _ = time_law(along, bend, s, np.full(len(a), np.inf), a, top=1.0, start=begin, end=end)
    t = times_of(s, speed)
    route = Route(t, points, speed[:, None] * along)
    longer = max(1.0, route.fastest(top), math.sqrt(route.hardest(a)))
    return Route(longer * t, points, route.rate / longer)


def least_time(way: np.ndarray, limits: np.ndarray) -> float:
    """Return the least time [s] in which joints move by distances way (n,), from rest to rest, in limits (4, n)."""
    moves = way > 0.0
    way, v, a = way[moves], speeds(limits)[moves], limits[LIMIT.acceleration, moves]
    top = np.minimum(v, np.sqrt(way * a))  # peak speed of each joint before it has to brake
    return float((way / top + top / a).max(initial=0.0))
