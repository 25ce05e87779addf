"""A target that leapt and stands: the tip goes straight to it, or, where that costs too much time, the joints do.

A method's feedback closes an error in proportion, and where limits forbid that it loses time twice: the tip slows down long before
its target, and a straight way of the tip can be a long one for the joints, or end where no joint can go on. So where an error
hardly falls though the target stands, its joint values are solved for at once, and those of points on the straight way before it.
The straight way is taken unless it needs more than STRAIGHT times as long as the joints would by themselves (`travel`). Where the
solver's attempt from the present joint values fails, other starts are tried (reconfigure.py): feedback would mostly fail, too.
"""

import math
from typing import NamedTuple

import numpy as np

from ..motion.reference import exp
from ..motion.time_law import time_law, times_of
from . import laws
from .motion_limits import speeds
from .reconfigure import Postures, Reconfiguration, Taken, gap, locked
from .target_stream import STAND, STILL, WAIT
from .viability import HELD_BACK, POSITION, UNKNOWN, bending, time_left, travel

STRAIGHT = 1.2  # times as long as through the joints that a straight way may take: 1.3 with what is lost at both ends
POINTS = 24  # pieces of a straight way: within each the tip leaves it by 1/576 of what it would on the joints' own way
TORN = 4.0  # times as long, from which on the joints do not follow the straight way but change posture between two of its points
NEAR = 2e-3  # [m] error, angles at LEVER, that is left to the method
SLOW = 0.5  # share of the error left by a step above which the method is hindered: gains leave a third, or nothing
SOONER = 0.5  # of the time to the nearest posture, below which one that spares slow joints is gone to instead
CLOSE = 1e-3  # [s] left at full speed: as good as there


class Route(NamedTuple):
    """Joint motion through points, cubic between them: times t (K,) [s], q (K, n) and rates (K, n) there, in kernel units."""

    t: np.ndarray
    q: np.ndarray
    rate: np.ndarray

    def hardest(self, a: np.ndarray) -> float:
        """Largest acceleration over what is allowed (n,), at the ends of the pieces."""
        h, d = np.diff(self.t)[:, None], np.diff(self.q, axis=0)
        first = 6.0 * d / h**2 - (4.0 * self.rate[:-1] + 2.0 * self.rate[1:]) / h
        last = (2.0 * self.rate[:-1] + 4.0 * self.rate[1:]) / h - 6.0 * d / h**2
        return float((np.maximum(np.abs(first), np.abs(last)) / a).max())

    def fastest(self, top: np.ndarray) -> float:
        """Largest rate over what is allowed (n,), at the ends and in the middle of the pieces."""
        h, d = np.diff(self.t)[:, None], np.diff(self.q, axis=0)
        middle = 1.5 * d / h - 0.25 * (self.rate[:-1] + self.rate[1:])
        return float(max((np.abs(self.rate) / top).max(), (np.abs(middle) / top).max()))


class Choice(NamedTuple):
    """Which way leads to a target that leapt."""

    straight: bool
    ratio: float  # how many times as long as through the joints the straight way takes; infinite where there is none


class Leap:
    """What a tracker knows of a target that leapt. goal (n,): where it is going [kernel units], or None; why: which way."""

    def __init__(self, postures: Postures, chosen: bool, straight: float, elsewhere: Reconfiguration | None) -> None:
        """chosen: the method has gains that somebody chose; elsewhere: finds another posture, where one may be taken.

        straight: how many times as long as through the joints a straight way may take.
        """
        self.postures, self._chosen, self._most, self._elsewhere = postures, chosen, straight, elsewhere
        timed(np.eye(2), np.zeros(2), np.ones((4, 2)), 1.0)  # compiled (or loaded) now, and not in a control loop
        self.forget()

    def forget(self) -> None:
        """The target is reached, or everything begins anew."""
        self.goal: np.ndarray | None = None
        self.why = Choice(straight=True, ratio=1.0)
        self._enough = CLOSE  # [s] left at full speed, from which on it is left to the method
        self._route: Route | None = None
        self._time = 0.0  # [s] since it set out
        self._place = np.zeros(0)  # the target that was last looked at

    begin = forget  # nothing else is known

    def watch(self, taken: Taken) -> None:
        """Look at a step taken. May set `goal`."""
        T, q, limits = taken.T, taken.q, taken.limits
        if not taken.stand[STAND.still] or taken.left < NEAR:
            return
        if len(self._place) and gap(T[1], self._place) <= STILL:
            return
        if taken.left < SLOW * self.postures.size(taken.E[0]):
            return
        if not taken.stand[STAND.leapt] and taken.stand[STAND.rest] < WAIT:  # it may be turning back
            return
        self._place = T[1].copy()
        # A joint at its limit after a smooth motion: only another posture leads on. A locked joint: its operator has other plans.
        if (not taken.stand[STAND.leapt] and (taken.code & POSITION).any()) or locked(limits):
            return
        found, _ = self.postures.find(T[1:], q[None], q, limits)
        if len(found):
            sooner, _ = self.postures.find(T[1:], q[None], q, limits, quick=True)
            if len(sooner) and time_left(q, sooner[0], limits) < SOONER * time_left(q, found[0], limits):
                found = sooner
        self._enough = max(self._patience(taken.law), CLOSE)
        if len(found) and time_left(q, found[0], limits) > self._enough:
            self._set_out(found[0], taken)
        elif not len(found) and taken.stand[STAND.leapt] and self._elsewhere and self._enough <= CLOSE:
            taken.stand[STAND.leapt] = 0.0  # one search a leap, though the target may creep on
            self._elsewhere.search_now(T[1], q, limits)

    def _set_out(self, goal: np.ndarray, taken: Taken) -> None:
        """Choose the way to a goal."""
        straight = self._straight(goal, taken)
        ratio = straight.t[-1] / least_time(np.abs(goal - taken.q), taken.limits) if straight else math.inf
        ratio = ratio if ratio < TORN else math.inf
        if ratio == math.inf and not self._elsewhere:
            return
        self.goal, self._time = goal, 0.0
        self._route = straight if ratio <= self._most and ratio < math.inf else None
        self.why = Choice(self._route is not None, ratio)

    def _patience(self, law: np.ndarray) -> float:
        """Time [s] from the target from where on the method is as fast: with gains that somebody chose, or for late joints."""
        p = laws.Law._make(law.tolist())
        if not (self._chosen or p.measured):
            return 0.0
        return 1.0 / p.kappa if p.kappa > 0.0 else p.kd / p.kp if p.kp > 0.0 else 0.0

    def _straight(self, goal: np.ndarray, taken: Taken) -> Route | None:
        """Joint motion along the straight way of the tip, as fast as limits allow; None where there is none."""
        T, q = taken.T[1], taken.q
        left = 1.0 - np.arange(1, POINTS) / POINTS
        points = np.repeat(T[None], POINTS - 1, axis=0)
        for f, e in enumerate(taken.E[1].reshape(-1, 6)):
            points[:, f, :3, 3] -= np.outer(left, e[:3])
            points[:, f, :3, :3] = exp(np.outer(-left, e[3:])) @ T[f, :3, :3]
        found, _ = self.postures.find(points, q + np.outer(1.0 - left, goal - q), q, taken.limits)
        if len(found) < len(points):
            return None
        way = np.concatenate([q[None], found, goal[None]])
        return timed(way, taken.rate, taken.limits, float(taken.law[laws.PLACE.gamma]))

    def go(
        self, q: np.ndarray, rate: np.ndarray, T: np.ndarray, gamma: float, h: float, late: float, limits: np.ndarray,
        code: np.ndarray,
    ) -> bool:  # fmt: skip
        """Step q and rate (n,) in place by h [s] towards the goal; False, and nothing done, when there is none any more.

        code (n,) receives what held joints back.
        """
        goal, left = self.goal, -1.0
        self._time += h
        if goal is not None and gap(T, self._place) <= STILL:
            left = travel(q, rate, goal, *(self._route or UNKNOWN), self._time, gamma, h, late, limits, code)
        if left < 0.0:
            self.forget()
            return False
        if left <= self._enough:
            self.goal = None
        return True

    def blocked(self) -> None:
        """Something is in the way: the method may slide along it."""
        self.goal = None


def timed(points: np.ndarray, rate: np.ndarray, limits: np.ndarray, gamma: float) -> Route | None:
    """Motion through points (K + 1, n), from joint rates (n,) to rest, as fast as speeds and accelerations (4, n) allow.

    Along the segments, each as long as it takes at full speed, the speed is at most 1.
    """
    top, a = speeds(limits), (1.0 - HELD_BACK) * limits[3] / bending(gamma)
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
    """Least time [s] in which joints move by `way` (n,) inside speed and acceleration limits (4, n), from rest to rest."""
    moves = way > 0.0
    way, v, a = way[moves], speeds(limits)[moves], limits[3, moves]
    top = np.minimum(v, np.sqrt(way * a))  # that a joint reaches before it has to brake
    return float((way / top + top / a).max(initial=0.0))
