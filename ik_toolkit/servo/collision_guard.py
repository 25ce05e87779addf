"""Obstacles in a tracker's step: rows that slow the arm down before it meets something, and a proof that it can still stop.

The rows are half-planes for the joint rates, made at the nearest points of the pairs that matter most; they guide and may be
relaxed. What promises that static things are never touched is the proof: the step, and the full brake after it, are followed
along the way, and distances are measured so often that nothing fits between two measurements. A step without a proof is not taken.
"""

from typing import Any, NamedTuple

import numpy as np

from ..kernel.clearance import along
from ..robot.geometry.distance import Clearance
from .viability import bending

ROWS = 12  # half-planes per step: more than meet at an edge of a polyhedron, and few for the QP
KEEP = 0.005  # [m] distance the rows keep: above what a controller's lag makes of a slow motion
INFLUENCE = 0.1  # [m] distance below which the rows apply
SPEED = 1.0  # [m/s] approach allowed at INFLUENCE; it falls in proportion to the distance left (0.1 s to settle)
FLAT = 1e-9  # [m per rad or m] a row without an entry above this restricts nothing: the pair does not move
SHARE = 0.1  # share of a row's largest entry above which a joint's braking counts
CONTACT = 1e-5  # [m] nearer than this is a contact: ten times the tolerance of coal's distances
NEAREST = 1e-4  # [m] a motion that leads nearer than this is rejected without checking whether it touches
# Places where distances are measured to prove one step free, 0.05 ms each; a step that takes more is not taken.
LOOKS = 12
PARTS = (1 / 4, 1 / 16, 1 / 64)  # parts of a step that are tried from rest where the whole step is not allowed


class Path(NamedTuple):
    """A step and its brake: joint values, rates and lengths gone (K + 1, n) between K pieces, the first one of h [s].

    even: share [1/s] of its rate that the brake takes off all joints alike, see `Guard._follow`; the last row of rate is what it
    begins with. alone (n,): joints that brake by themselves, which takes them `aside` (n,) far.
    """

    q: np.ndarray
    rate: np.ndarray
    length: np.ndarray
    h: float
    even: float
    alone: np.ndarray
    aside: np.ndarray


def stopping(v: np.ndarray | float, gamma: float, a: np.ndarray | float, late: float) -> np.ndarray:
    """Longest ways (n,) to rest from rates v >= 0, slowing by `a`, in steps of any lengths up to `late`: see servo/viability.py."""
    with np.errstate(divide="ignore", invalid="ignore"):
        way = np.asarray(v * v / (2.0 * a))
        if gamma == 1.0:
            return np.where(v == 0.0, 0.0, way)
        short = v <= 0.5 * a * late
        return np.where(short, 0.5 * v * late, way + 0.125 * a * late * late) + max(0.5 - gamma, 0.0) * v * late


class Guard:
    """Rows and proofs for one tracker.

    robot; model: its CollisionModel; limits (4, n): lower, upper, speed, acceleration [rad or m, per s, per s^2]; gamma of the
    motion between samples (see `interpolate`). pairs: names of the pairs behind the last rows. blocked: names of the pair that
    kept the last step from being proven, or None.
    """

    def __init__(self, robot: Any, model: Any, limits: np.ndarray, gamma: float) -> None:
        """Bind, and compile (or load) all that is needed later; `restart` comes next."""
        self.robot, self.model, self.limits, self.gamma = robot, model, limits, gamma
        self.A, self.b, self._order = np.zeros((ROWS, robot.n)), np.zeros(ROWS), np.zeros(ROWS, dtype=int)
        self.pairs: list[tuple[str, str]] = []
        self.blocked: tuple[str, str] | None = None
        self.late = 0.0  # longest step [s] that may follow
        self._bind()
        self._get_ready()

    def _bind(self) -> None:
        """Take the model as it is now."""
        self._space = space = Clearance(self.model)
        self._version = self.model.version
        # A robot's parts may be closer to each other than the distance to keep: then half of their distance is kept.
        home = space.home - space.margins
        self._keep = np.where(space.own & (home > 0.0), np.minimum(0.5 * home, KEEP), KEEP)

    def __getstate__(self) -> dict[str, Any]:
        """All but the measurements, which belong to this process."""
        kept = {name: value for name, value in vars(self).items() if name != "_space"}
        return kept | {"_version": self._version == self.model.version, "corners": self._space.corners()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore; everything is measured again when it is needed, and bound again if it has changed."""
        corners = state.pop("corners")
        vars(self).update(state)
        self._space = Clearance(self.model)
        self._space.recall(corners)
        self._version = self.model.version if self._version else None
        self._fresh, self._known = np.zeros_like(self._fresh), False

    def _get_ready(self) -> None:
        """Call what would otherwise be compiled in a control loop, when the arm has to brake."""
        space, q, still = self._space, self.robot.home, np.zeros(self.robot.n)
        path, ks = self._follow(q[None], still[None], 1.0), np.arange(len(self._keep))[:1]
        if path is None:
            return
        space.place(q)
        space.move()
        way = path.q, path.rate, path.length, self.gamma, path.h
        along(*way, 0.0, still.copy(), np.empty_like(still))
        levers, _ = space.levers(path.length[-1])
        space.free_until(ks, np.ones(len(ks)), levers, *way, 0.0)
        rules = self.limits[3], 1.0, 1.0, SHARE, FLAT
        space.rows(ks, space.points(ks), np.ones(len(ks)), still, *rules, self.A, self.b, self._order)

    def restart(self, q: np.ndarray) -> tuple[str, str] | None:
        """Begin at q (n,); returns the names of a pair that touches there, or None."""
        if self._version != self.model.version:  # something was added, moved or removed
            self._bind()
        self._space.forget()
        self._space.place(q)
        self._low = self._space.distances() - self._space.margins  # lower bounds of the gaps (P,) at q
        self._fresh = np.ones(len(self._low), dtype=bool)  # which of them are measured there
        self._known = False  # whether the motion of everything there is known
        self._stop = np.zeros(len(self._low))  # how much closer each pair can come on a step and brake like the last
        self._path: Path | None = None
        self._left = 1.0  # share of the rates that a brake begins with that is left
        touching = np.flatnonzero(self._low <= CONTACT)
        return self._space.name(int(touching[0])) if len(touching) else None

    # ------------------------------------------------------------------------------------------------ rows
    def rows(self, q: np.ndarray, rate: np.ndarray, h: float) -> int:
        """Write A (r, n), b (r,) of A x <= b for the next joint rate x [rad or m per s]; returns r, the number of rows.

        q, rate (n,): now; h [s]: the step. Each row limits how fast a pair comes closer, so that the arm can still brake.
        """
        self.pairs = []
        if self._version != self.model.version:  # something was added, moved or removed
            self.restart(q)
        reach = INFLUENCE + self._stop
        ks = np.flatnonzero(self._low < reach)
        if not len(ks):
            return 0
        space = self._space
        space.place(q)
        space.move()
        self._known = True
        self._fresh[ks] = False  # the nearest points are wanted, too
        self._measure(ks)
        ks = ks[(self._low[ks] < reach[ks]) & (self._low[ks] > CONTACT)]
        if not len(ks):
            return 0
        ks, points, distances = space.facing(ks, self._low[ks] + space.margins[ks])
        gap = distances - space.margins[ks] - self._keep[ks]
        rules = self.limits[3], SPEED / (INFLUENCE - KEEP), h, SHARE, FLAT
        count = space.rows(ks, points, gap, rate, *rules, self.A, self.b, self._order)
        self.pairs = [space.name(k) for k in ks[self._order[:count]].tolist()]
        return count

    def _measure(self, ks: np.ndarray) -> None:
        """Update the distances of pairs at the configuration where they were placed (the start of the step)."""
        for k in ks[~self._fresh[ks]].tolist():
            self._low[k] = self._space.gap(k)
        self._fresh[ks] = True

    # ------------------------------------------------------------------------------------------------ the proof
    def allows(self, q: np.ndarray, rate: np.ndarray, q1: np.ndarray, rate1: np.ndarray, h: float) -> bool:
        """Whether nothing touches on the step from (q, rate) to (q1, rate1) in h [s], nor on the full brake after it.

        q must be where the last step ended. A step that is allowed counts as taken; `blocked` names the pair of one that is not.
        """
        return self._take(np.array([q, q1]), np.array([rate, rate1]), h)

    def instead(self, q: np.ndarray, rate: np.ndarray, rate1: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        """Joint values and rates (n,) after h [s] instead of a step from (q, rate) to rate1 that was not allowed.

        The arm brakes; from rest it takes a small part of the step, if that is free; otherwise it could stand still for ever.
        """
        blocked = self.blocked
        for part in PARTS if not rate.any() else ():
            small = part * rate1
            q1 = q + h * self.gamma * small
            if self._take(np.array([q, q1]), np.array([rate, small]), h):
                self.blocked = blocked
                return q1, small
        self.blocked = blocked
        return self.brake(q, rate, h)

    def brake(self, q: np.ndarray, rate: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        """Joint values and rates (n,) after h [s] of braking from (q, rate), instead of a step that was not allowed.

        It brakes as was proven free with the last step.
        """
        blocked, path = self.blocked, self._path
        if path is None:  # no step of ours led here
            self._take(q[None], rate[None], h, anyway=True)
            self.blocked, path = blocked, self._path
        if path is None:
            return q.copy(), np.zeros_like(q)
        left, self._left = self._left, max(self._left - path.even * h, 0.0)
        own = np.sign(rate) * np.maximum(np.abs(rate) - self._most * h, 0.0)
        rate1 = np.where(path.alone, own, self._left * path.rate[-1])
        before = np.where(path.alone, rate, left * path.rate[-1])
        move = h * ((1.0 - self.gamma) * before + self.gamma * rate1)
        self._moved(np.abs(move))
        return q + move, rate1

    @property
    def _most(self) -> np.ndarray:
        """By how much (n,) the rates of joints may change [per s]."""
        return self.limits[3] / bending(self.gamma)

    def _moved(self, way: np.ndarray) -> None:
        """How far the joints have gone (n,) along the path."""
        self._low = self._low - self._levers @ way[self._space.coordinates]
        self._fresh[:] = False
        self._known = False

    def _take(self, Q: np.ndarray, R: np.ndarray, h: float, anyway: bool = False) -> bool:
        """Prove the motion through states Q, R (1 or 2, n), and the brake after it; when free, or anyway, it counts as taken."""
        path = self._follow(Q, R, h)
        if path is None:
            self.blocked = None
            return False
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
            self.blocked = self._prove(path, doubtful, levers)
            self._known = False  # it has looked elsewhere
            self._fresh[:] = False
            if not (self.blocked is None or anyway):
                return False
        else:
            self.blocked = None
        self._path, self._levers, self._left = path, levers, 1.0
        if len(Q) > 1:
            self._moved(path.length[1])
        return self.blocked is None

    def _follow(self, Q: np.ndarray, R: np.ndarray, h: float) -> Path | None:
        """States Q, R (1 or 2, n) and a brake after them that steps of any lengths up to `late` keep to; None if there is none.

        The acceleration limit allows a short step next to no other rate than that of the long one before it. All joints lose
        the same share of their rates in a time: whatever the steps, the arm stays on one line, and gets at most to the end it
        has for the worst steps. A joint whose limit is nearer brakes by itself.
        """
        q, rate = Q[-1], R[-1]
        lower, upper = self.limits[:2]
        speed, most, late = np.abs(rate), self._most, max(self.late, h)
        with np.errstate(divide="ignore", invalid="ignore"):
            even = np.where(speed > 0.0, most / speed, np.inf).min()
            if even <= 0.0:
                return None
            room = np.where(rate > 0.0, upper - q, q - lower)
            time = stopping(1.0, self.gamma, even, late)
            alone = (speed > 0.0) & (speed * time > room)
            aside = np.where(alone, stopping(speed, self.gamma, most, late), 0.0)
            move = np.where(alone, 0.0, rate * time)
        all_q, rates, length = np.zeros((3, len(Q) + 1, len(q)))
        all_q[:-1], all_q[-1] = Q, q + move
        rates[:-2], rates[-2], rates[-1] = R[:-1], move / h, rate  # so that the last piece is a straight one
        length[-1] = np.abs(move)
        if len(Q) > 1:
            length[1] = self._gone(Q, R[0], h)
            length[2] += length[1]
        length[-1] += aside
        return Path(all_q, rates, length, h, float(even), alone, aside)

    def _gone(self, Q: np.ndarray, rate: np.ndarray, h: float) -> np.ndarray:
        """How far (n,) the joints go on a step between Q (2, n), where they may turn back on the way."""
        move = Q[1] - Q[0]
        start = move if self.gamma == 1.0 else h * rate
        end = 2.0 * move - start
        turns = start * end < 0.0
        far = 0.5 * start * start / np.where(turns, start - end, 1.0)
        return np.where(turns, np.abs(far) + np.abs(move - far), np.abs(move))

    def _prove(self, path: Path, ks: np.ndarray, levers: np.ndarray) -> tuple[str, str] | None:
        """None when the pairs ks, measured at the start, touch nowhere on a path; otherwise the names of an unproven one."""
        space, u, end = self._space, 0.0, len(path.q) - 1.0
        way = path.q, path.rate, path.length, self.gamma, path.h
        q, gone = np.empty(self.robot.n), np.empty(self.robot.n)
        aside = levers[ks] @ path.aside[space.coordinates]
        distances = self._low[ks] - aside
        nearest = np.clip(0.5 * distances, CONTACT, NEAREST)
        for _ in range(LOOKS):
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
