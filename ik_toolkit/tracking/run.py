"""The run of `track`, from the start to the end of a reference; taken again, slower, where it left its path."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from ..kernel import motion
from ..kernel.clock import look_ahead
from ..kernel.constrain import LEAVE, SLOW
from ..kernel.modes import SIDE
from ..kernel.session import Record, Samples, new_record
from .inputs import LATE
from .secondary import AVOID, POSTURE
from .tracker import Tracker

HARDER = (10.0, 30.0)  # [1/s] with which limits are avoided where the usual rate leads into them; 30: in some samples
MOST = 3  # motions tried of those that have difficulties
SAME = 1e-9  # [rad, or reaches] within which two motions are one
SLOWEST = 1e-3  # rate of the clock below which slower is not worse
RUNAWAY = 100.0  # mean joint move [rad, or reaches] in one step beyond which a run has diverged
HELPED = 0.8  # share of the samples off the path that have to remain fewer after a run was taken again
RETAKES = 4  # how often a run that left its path is taken again: 4 times LEAST_SHARE is slower than max_stretch allows
NEAR = 0.1  # [s] before and after it left, in which it is to be slower: in that time the clock can stop
AIM = 0.5  # error over tolerance that is aimed at: below it the clock does not wait
AT_ONCE = 20_000  # steps between which Ctrl-C is heard
LEADS = (0.5, 0.1)  # shares tried: the larger keeps nearer to a planned path, the smaller disturbs a singular pose less
LEAST_SHARE = 0.25  # of its rate there, to which the clock is slowed at a time
NOWHERE = np.zeros((0, 0))


class _Beside(NamedTuple):
    """What the joints do beside the task."""

    avoid: float  # [1/s] with which limits are avoided
    posture: np.ndarray  # (n,) sought
    rate: np.ndarray  # (n,) [1/s]


class _Way(NamedTuple):
    """A path of the joints without limits on speed."""

    cost: float  # samples off the path, and those it takes longer inside the limits
    beside: _Beside
    Q: np.ndarray  # (M + 1, n)
    lead: float = 0.0  # share of what is missing to it that a step makes up for, in the null space; 0: not led
    side: np.ndarray = NOWHERE  # (M + 1, n) on which side of singular poses it is


class _Taken(NamedTuple):
    """One run."""

    missed: int  # samples off the path
    arrays: list[np.ndarray]  # Q, R, E, S, C, see kernel/session.py
    end: np.ndarray  # of the tracker
    elapsed: float  # [s] of stepping
    between: tuple[str, str] | None  # names of the two that most often would have touched


class Run:
    """The steps of a run, and its arrays as the loop writes them (see kernel/session.py): Q, R, E, S, C."""

    Q: np.ndarray
    R: np.ndarray
    E: np.ndarray
    S: np.ndarray
    C: np.ndarray

    def __init__(
        self,
        tracker: Tracker,
        samples: Samples,
        dt: float,
        mode: int,
        tolerances: tuple[float, float],
        stretch: float,
        settle: float,
        plan: Callable[[], Iterator[tuple[np.ndarray, np.ndarray]]],
    ) -> None:
        """Keep what is to be run.

        plan: finds joint values (N + 1, n) [rad or m] along the samples, for where nothing else keeps to the path.
        """
        self.tracker, self.samples, self.dt, self.mode = tracker, samples, dt, mode
        self.tolerances, self.settle, self.plan = tolerances, settle, plan
        self.count = len(samples.T) - 1
        self.most = int(np.ceil(stretch * self.count)) if mode == SLOW else self.count
        self.clock = tolerances if tracker.engine.waits else (np.inf, np.inf)
        self.caps = samples.caps
        self.slower = np.ones(self.count + 1)
        self.again = mode == SLOW and tracker.engine.waits and not tracker.one_by_one
        tracker._late = LATE * dt
        self.start = tracker.carried()
        self.elapsed, self.searched = 0.0, 0.0  # [s] of stepping, and of the runs that others are better than
        self.made: list[_Taken] = []
        self.interrupted = False

    def go(self) -> None:
        """Run to the end; again where the clock may be slowed and that helps.

        Ctrl-C ends it with the best there is, which may be the beginning of a run; before a step is taken it is raised.
        """
        tracker = self.tracker
        # No step yet: this compiles (or loads) the loop, so that the time reported is that of tracking.
        tracker.run(self.samples, self.dt, self._record(0), mode=self.mode, clock=self.clock, runaway=RUNAWAY)
        tracker.put_back(self.start)
        began = time.perf_counter()
        try:
            self._try()
        except KeyboardInterrupt:
            if not self.made:
                raise
            self.interrupted = True
        best = min(self.made, key=lambda taken: taken.missed)
        self.Q, self.R, self.E, self.S, self.C = best.arrays
        tracker.put_back(best.end)
        self.elapsed, self.between = best.elapsed, best.between
        self.searched = time.perf_counter() - began - best.elapsed

    def _try(self) -> None:
        """Take runs until one keeps to its path, or nothing else helps."""
        made = self.made
        for way in self._ways():
            self.slower[:] = 1.0
            last = np.inf
            for _ in range(RETAKES + 1):
                self._take(way)
                # Nothing helps a run that begins off its path.
                self.again = self.again and self._excess(made[-1].arrays[2][:1])[0] <= 1.0
                if not self.again or made[-1].missed == 0 or made[-1].missed > HELPED * last:
                    break
                last = made[-1].missed
                self._slow_down(made[-1])
            if not self.again or made[-1].missed == 0:
                break

    def _record(self, steps: int) -> Record:
        """Room for so many steps."""
        return new_record(steps + 1, self.tracker.robot.n, self.samples.V.shape[1])

    def _ways(self) -> Iterator[_Way]:
        """Joint paths without limits on speed: those that meet no difficulty as they are found, then the best of the others."""
        secondary, limits = self.tracker.secondary, self.tracker._limits
        own = _Beside(secondary.avoid, *secondary.wish[:2].copy())
        if self.mode != SLOW or not np.isfinite(limits[2:]).any():
            yield _Way(0.0, own, np.zeros((0, 0)))
            return
        found: list[_Way] = []
        for beside in self._besides(own):
            way = self._look_ahead(beside)
            if any(len(one.Q) == len(way.Q) and np.abs(one.Q - way.Q).max() < SAME for one in found):
                break  # no joints are free to do anything beside the task
            found.append(way)
            if way.cost <= 0.0:
                yield way
        yield from sorted((way for way in found if way.cost > 0.0), key=lambda way: way.cost)[:MOST]
        if self.again and own.avoid == AVOID and not own.rate.any():  # nothing else was asked for beside the task
            for path, side in self.plan():
                for lead in LEADS:
                    yield _Way(0.0, own._replace(avoid=0.0), path / self.tracker.robot.chain.unit, lead, side)

    def _besides(self, own: _Beside) -> Iterator[_Beside]:
        """What can be tried beside the task: first what was asked for."""
        yield own
        if own.avoid != AVOID or own.rate.any():
            return
        for avoid in HARDER:
            yield own._replace(avoid=avoid)
        if not self.tracker.engine.waits:  # its error tells nothing: it lags behind
            return
        lower, upper = self.tracker._limits[:2]
        wide = upper - lower
        bounded = np.isfinite(wide)
        middle = np.zeros(len(wide))
        middle[bounded] = 0.5 * (lower[bounded] + upper[bounded])
        rate = np.where(bounded, POSTURE, 0.0)
        yield own._replace(posture=middle, rate=rate)
        for i in np.flatnonzero(bounded):  # one joint bent aside
            for share in (0.25, -0.25):
                posture = middle.copy()
                posture[i] += share * wide[i]
                yield own._replace(posture=posture, rate=rate)

    def _begin(self, beside: _Beside) -> None:
        """Go back to the start."""
        self.tracker.put_back(self.start)
        secondary = self.tracker.secondary
        secondary.avoid, secondary.wish[0], secondary.wish[1] = beside
        secondary.wish[2] = 0.0

    def _look_ahead(self, beside: _Beside) -> _Way:
        """Follow the path without limits on speed."""
        tracker = self.tracker
        self._begin(beside)
        fast = tracker._limits[2:].copy()
        tracker._limits[2:] = np.inf
        self.caps[0] = 1.0
        if tracker._state[motion.STATE.start] == motion.GIVEN:
            tracker._state[motion.STATE.start] = motion.MOVING
        record = self._record(self.count)
        done = tracker.run(self.samples, self.dt, record, mode=LEAVE, runaway=RUNAWAY)
        tracker._limits[2:] = fast
        way = _Way(0.0, beside, record.Q[: done + 1])
        self._limit_clock(way)
        off = self._excess(record.E[: done + 1]) > 1.0
        return way._replace(cost=float(off.sum() + (1.0 / np.maximum(self.caps[0], SLOWEST) - 1.0).sum()))

    def _limit_clock(self, way: _Way) -> None:
        """How fast the clock may run: as the joints can on their way, and no faster than is asked for."""
        self.caps[0], self.caps[1] = self.slower, -1.0
        if len(way.Q) > 2:
            look_ahead(way.Q, self.tracker._limits, self.dt, self.caps[0], self.caps[1])
        pace = np.maximum(np.minimum(self.caps[0, :-1], self.caps[0, 1:]), SLOWEST)
        self.caps[2] = np.append(np.cumsum(1.0 / pace[::-1])[::-1], 0.0)

    def _take(self, way: _Way) -> None:
        """Run from the start to the end once, or until Ctrl-C."""
        began, made, pairs = time.perf_counter(), [], Counter[tuple[str, str]]()
        self._begin(way.beside)
        self._limit_clock(way)
        stopped, astray = True, False
        try:
            astray = self._go_on(way, made, pairs)
            stopped = False
        finally:
            if made:
                self._keep(made, pairs, began, stopped, astray)

    def _go_on(self, way: _Way, made: list, pairs: Counter) -> bool:
        """Take the steps of a run; returns whether it ended because it was no longer on the way planned."""
        tracker, left = self.tracker, self.most
        while True:
            steps = 1 if tracker.one_by_one or way.lead else min(self.count, left, AT_ONCE)
            if way.lead:
                self._lead(way)
            record = self._record(steps)
            done = tracker.take(self.samples, self.dt, record, mode=self.mode, clock=self.clock, runaway=RUNAWAY)
            if tracker._between:
                pairs[tracker._between] += 1
            left -= done
            clock, stop = (tracker._state[at] for at in (motion.STATE.clock, motion.STATE.stop))
            astray = way.lead > 0.0 and tracker._state[motion.STATE.leaving] > 0.0  # and no longer on the way planned
            ended = left <= 0 or stop != motion.FINE or clock >= self.count or astray
            rows = done + 1 if ended else done
            made.append([*(one[:rows] for one in record[1:5]), record.C[:done]])
            if ended:
                return astray

    def _keep(self, made: list, pairs: Counter, began: float, stopped: bool, astray: bool) -> None:
        """Add a run, or what there is of it, to those made."""
        arrays = [np.concatenate(part) for part in zip(*made, strict=True)]
        if stopped:  # every sample but the last has a step after it
            arrays[4] = arrays[4][: len(arrays[0]) - 1]
        missed = int((self._excess(arrays[2]) > 1.0).sum())
        clock = arrays[3][-1, 0]
        if (self.mode == SLOW or stopped) and clock < self.count:
            # A reference not followed to its end is worse than that, and worst of all a run that was given up.
            missed += round((self.count - (0.0 if astray else clock)) * self.most)
        most = max(pairs, key=lambda pair: pairs[pair], default=None)
        self.made.append(_Taken(missed, arrays, self.tracker.carried(), time.perf_counter() - began, most))

    def _lead(self, way: _Way) -> None:
        """Ask for the posture of a way at the next step, and for its speed; and for its side where it is nearly singular."""
        state, wish = self.tracker._state, self.tracker.secondary.wish
        k = min(int(state[motion.STATE.clock]), len(way.Q) - 2)
        move = way.Q[k + 1] - way.Q[k]
        wish[0] = way.Q[k] + (state[motion.STATE.clock] - k) * move
        wish[1] = way.lead / self.dt
        wish[2] = state[motion.STATE.sigma] / self.dt * move
        self.tracker._carried.away[:] = way.side[k + 1]
        state[motion.STATE.near] = 1.0 + SIDE

    def _excess(self, E: np.ndarray) -> np.ndarray:
        """Largest error over its tolerance (M,) of errors E (M, m), where it counts."""
        errors = np.linalg.norm(E.reshape(len(E), -1, 2, 3), axis=3)
        excess = (errors / self.tolerances).max(axis=(1, 2))
        return np.where(np.arange(len(E)) * self.dt >= self.settle, excess, 0.0)

    def _slow_down(self, taken: _Taken) -> None:
        """Let the clock run slower where a run has left its path: an error of a step is of the order of its square."""
        _, _, E, S, _ = taken.arrays
        excess = self._excess(E)
        near = max(round(NEAR / self.dt), 1)
        before, inside = self.slower.copy(), False
        for k in range(len(excess)):
            if excess[k] > AIM and not inside and excess[k : k + near].max() > 1.0:
                share = max(AIM / excess[k : k + near].max(), LEAST_SHARE)
                begin, end = int(S[max(k - near, 0), 0]), int(np.ceil(S[min(k + near, len(S) - 1), 0]))
                self.slower[begin : end + 1] = np.minimum(self.slower[begin : end + 1], share * before[begin : end + 1])
                inside = True
            inside = inside and excess[k] > AIM
