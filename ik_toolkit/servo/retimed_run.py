"""The run of `track`: in the reference's own time first, and where that does not do, along a time law that the joints can keep.

The law needs the joints' path q(s) along the reference. It comes from the method itself, run so slowly that nothing limits it;
where that leaves the reference, with more distance from limits or another posture; and last from `solve_path`.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from ..motion.reference import Reference, checked
from ..motion.time_law import coordinate_at, smoothed, time_law, times_of
from ..validate import LATE
from . import laws, viability
from .null_space_motion import AVOID, POSTURE
from .path_reach import bound_lm, samples_of, singular_sides, targets_at
from .singular_step import SIDE
from .target_stream import samples_from
from .tracker import Tracker
from .workspace import Samples, new_record

QUICK = 10.0  # [1/s^2] largest d2s/dt2: a run stops or starts in a tenth of a second
SPEED = 0.98  # share of speed limits that a law uses: the run is not quite the motion that it was made for
# Shares of acceleration limits that a law uses: in turn, where a run has missed. With 0.95 31 of 288 runs needed a second one.
ACCELERATION = (0.95, 0.88, 0.8, 0.6)
TOLERANCE = 0.8  # share of the tolerances that a law uses for the error of a step
FASTER = 5  # times that these shares are raised, where a run has kept to the reference ...
JOINTS, TIP = 1.2, 1.5  # ... each by these factors: those of redundant joints, that of the tip
FAR_OFF = 4.0  # times its tolerance above which a run was not off by the error of a step
ENOUGH = 0.8  # of a tolerance that is aimed at where a run has missed it ...
NEAR = 0.05  # [s] ... how long before and after that it is slower ...
LEAST = 0.25  # ... and share to which the square of its rate is lowered at a time
HELPED = 0.8  # share of the samples off the reference that have to remain fewer after a run was taken again
FOLLOWED = 0.2  # of a tolerance: error of a step while the joints' path is sought
FEWEST = 400  # steps of that path
HARDER = (10.0, 30.0)  # [1/s] with which limits are avoided where the usual rate leads into them; 30: in some samples
POSES = 40  # least number of poses that must all be in reach before `solve_path` is asked for a path ...
MOST_POSES = 2001  # ... and the largest that it is given; in between its path is linear
EXACT = 1e-6  # [m, rad] of that path: errors of neighbouring samples must not look like accelerations
STRIDE = (0.5, 0.2)  # [rad, m] that its joints may move between two poses: they are near each other
LEAD = 0.5  # share of what is missing to it that a step makes up for, in the null space
SLOWEST = 0.02  # rate of the clock at which what touches is passed, or not at all
RUNAWAY = 100.0  # mean joint move [rad, or reaches] in one step beyond which a run has diverged
AT_ONCE = 20_000  # steps between which Ctrl-C is heard
NOWHERE = np.zeros((0, 0))


class Clock(NamedTuple):
    """Where a run's reference is at each of its samples: s (M + 1,) [s], rate and gain (M + 1,), joint (M + 1,) that limits it."""

    s: np.ndarray
    rate: np.ndarray
    gain: np.ndarray
    joint: np.ndarray


class Way(NamedTuple):
    """Joint path Q (K + 1, n) [kernel units] at s (K + 1,) [s], and what the joints do beside the task on it."""

    s: np.ndarray
    Q: np.ndarray
    avoid: float  # [1/s] with which limits are avoided
    posture: np.ndarray  # (2, n) sought, and how strongly [1/s]
    led: bool = (
        False  # whether a run is led along it, in the null space, and across singular poses where it crosses them
    )
    sides: np.ndarray = NOWHERE  # (M + 1, n) of one that is, at the samples of the run, see `singular_sides`


class Taken(NamedTuple):
    """A run; Q, R, E, S, C as in servo/workspace.py."""

    missed: int  # samples off the reference, or in which limits held back a solver, which always lags
    Q: np.ndarray
    R: np.ndarray
    E: np.ndarray
    S: np.ndarray
    C: np.ndarray
    clock: Clock
    end: np.ndarray  # of the tracker
    elapsed: float  # [s] of stepping
    between: tuple[str, str] | None  # names of the two that most often would have touched


class Run:
    """Follow references (one a tip) with a tracker, as well as possible."""

    def __init__(
        self,
        tracker: Tracker,
        references: list[Reference],
        times: np.ndarray,
        tolerances: tuple[float, float],
        settle: float,
        stretch: float,
        counts: Mapping[str, Any],
    ) -> None:
        """Keep what is to be run at times (N + 1,) [s]; stretch: how many times as long a run may take, counts: what counts."""
        self.tracker, self.references, self.times, self.dt = tracker, references, times, float(times[1])
        self.tolerances, self.settle, self.counts = np.array(tolerances), settle, counts
        self.count, self.most = len(times) - 1, int(np.ceil(stretch * (len(times) - 1)))
        self.full = Clock(times, np.ones(len(times)), np.zeros(len(times)), np.full(len(times), -1))
        self.own = self.fine = samples_along(references, self.full, checked)  # fine: where the joints' path is known
        tracker._late = LATE * self.dt
        self.start, self.q0 = tracker.carried(), tracker.q
        self.made: list[Taken] = []
        self.interrupted = False

    def go(self, slow: bool) -> Taken:
        """Run to the end, and again where the reference may be slowed and that helps; returns the best run.

        Ctrl-C ends it with the best there is, which may be the beginning of a run; before a step is taken it is raised.
        """
        tracker = self.tracker
        # No step yet: this compiles (or loads) the loop, so that the time reported is that of tracking.
        tracker.run(self.own, self.dt, new_record(1, tracker.robot.n, self.own.V.shape[1]), runaway=RUNAWAY)
        tracker.put_back(self.start)
        began = time.perf_counter()
        try:
            self._try(slow)
        except KeyboardInterrupt:
            if not self.made:
                raise
            self.interrupted = True
        best = min(self.made, key=lambda taken: (taken.missed, -taken.clock.s[-1], len(taken.Q)))
        tracker.put_back(best.end)
        self.searched = time.perf_counter() - began - best.elapsed
        return best

    def _try(self, slow: bool) -> None:
        """Take runs until one keeps to the reference, or nothing else helps."""
        limits, here = self.tracker._limits, Way(self.times, NOWHERE, *self._wishes())
        from_rest = self._at_rest() and np.isfinite(limits[3]).any() and self.own.V[0].any()
        if not (slow and from_rest):
            own = self._take(self.full, self.own, here)
            if not slow or own.missed == 0 or self._excess(own.E[:1])[0] > 1.0:  # nothing helps one that begins off it
                return
        for way in self._ways(here):
            self._slowly(way, from_rest)
            if min(taken.missed for taken in self.made) == 0:
                return

    def _at_rest(self) -> bool:
        """Whether the joints stand at the start."""
        return self.tracker._state[laws.STATE.start] == laws.GIVEN and not self.tracker._rate.any()

    def _slowly(self, way: Way, from_rest: bool) -> None:
        """Take runs along a law for a joint path, with more and more in reserve; then along faster ones."""
        top, start, last = self._clear(way), 0.0 if from_rest else np.inf, np.inf
        for share in ACCELERATION:
            clock = self._law(way, share, top, start)
            taken = self._take(clock, samples_along(self.references, clock), way)
            if taken.missed == 0:
                self._faster(way, share, top, start)
            if taken.missed == 0 or taken.missed > HELPED * last or clock.s[-1] < self.times[-1]:
                return
            moved = np.append(True, np.diff(clock.s) > 0.0)
            if not way.led and len(taken.Q) == len(clock.s):  # the path that the joints really took
                way = way._replace(
                    Q=np.stack([np.interp(way.s, clock.s[moved], one[moved]) for one in taken.Q.T], axis=1)
                )
            again = share < ACCELERATION[0]
            if again or self._excess(taken.E).max() < FAR_OFF:
                self._lower(top, way, taken)
            last = taken.missed if again else np.inf

    def _faster(self, way: Way, share: float, top: np.ndarray, start: float) -> None:
        """Take runs along laws for more than there is: other joints may do what a slow one cannot, and smooth steps err less."""
        over, before = 1, self.made[-1].clock.s
        for _ in range(FASTER):
            clock = self._law(way, share, top, start, over)
            if (len(clock.s), -clock.s[-1]) >= (len(before), -before[-1]):
                return
            taken = self._take(clock, samples_along(self.references, clock), way)
            if taken.missed == 0:
                over, before = over + 1, clock.s
            elif self._excess(taken.E).max() < FAR_OFF:
                self._lower(top, way, taken)
            else:
                return

    def _lower(self, top: np.ndarray, way: Way, taken: Taken) -> None:
        """Lower the highest rates (K + 1,) of a law where a run has missed: the error of a step grows with their square."""
        excess, near, clock = self._excess(taken.E), round(NEAR / self.dt), taken.clock
        for k in np.flatnonzero(excess > 1.0):
            ends = clock.s[max(k - near, 0)], clock.s[min(k + near, len(excess) - 1)]
            here = slice(*np.searchsorted(way.s, ends))
            top[here] = np.minimum(top[here], np.sqrt(max(ENOUGH / excess[k], LEAST)) * clock.rate[k])

    # ------------------------------------------------------------------------------------------------ joint paths
    def _wishes(self) -> tuple[float, np.ndarray]:
        """What was asked for beside the task: `avoid` and `posture` of a way."""
        secondary = self.tracker.secondary
        return secondary.avoid, secondary.wish[:2].copy()

    def _ways(self, here: Way) -> Iterator[Way]:
        """Joint paths along the reference, best first."""
        # A step's error is small against the tolerance where it is followed with so many steps.
        bend = np.linalg.norm(self.own.A.reshape(self.count + 1, -1, 2, 3), axis=3).max(axis=(0, 1)) / self.tolerances
        parts = max(-(-FEWEST // self.count), int(np.ceil(np.sqrt(0.5 * self.dt**2 * bend.max() / FOLLOWED))))
        s = np.linspace(0.0, self.times[-1], parts * self.count + 1)
        self.fine = samples_along(self.references, Clock(s, np.ones(len(s)), 0.0 * s, s))
        samples = samples_from(self.fine.T, self.fine.V / parts, self.fine.A / parts**2)
        plain = here.avoid == AVOID and not here.posture[1].any()  # nothing else was asked for beside the task
        found: list[tuple[int, int, Way]] = []  # samples off it, steps that its law needs
        for way in (here, *(self._besides(here) if plain and self._redundant() else ())):
            Q, off = self._follow(samples, way)
            way = way._replace(s=s, Q=Q)
            found.append((off, len(self._law(way, ACCELERATION[0], np.ones(len(s)), np.inf).s), way))
            if found[0][:2] == (0, self.count + 1):
                break
        found.sort(key=lambda one: one[:2])
        yield from (way for off, _, way in found if off == 0)
        slowest = found[0][0] == 0 and found[0][1] > self.most  # another posture would hardly be so much faster
        if plain and not slowest and self.tracker.engine.waits and not self.tracker.one_by_one:
            planned = self._planned(samples)
            if planned is not None:
                yield Way(s, planned, 0.0, here.posture, led=True)
        if found[0][0] > 0:
            yield found[0][2]

    def _redundant(self) -> bool:
        """Whether joints are free to do something beside the task."""
        return self.tracker.robot.n > (self.tracker._settings.counts[0] > 0.0).sum()

    def _besides(self, here: Way) -> Iterator[Way]:
        """What can be tried beside the task."""
        lower, upper = self.tracker._limits[:2]
        bounded = np.isfinite(upper - lower)
        for avoid in HARDER:
            yield here._replace(avoid=avoid)
        middle = np.where(bounded, 0.5 * (lower + upper), 0.0)
        yield here._replace(posture=np.stack([middle, np.where(bounded, POSTURE, 0.0)]))

    def _follow(self, samples: Samples, way: Way) -> tuple[np.ndarray, int]:
        """Joint path (K + 1, n) that the method takes along samples without limits on speed, and how many of them it misses."""
        limits = self.tracker._limits
        self._begin(way)
        fast = limits[2:].copy()
        limits[2:] = np.inf
        if self.tracker._state[laws.STATE.start] == laws.GIVEN:
            self.tracker._state[laws.STATE.start] = laws.MOVING
        made: list = []
        self._steps(samples, way, made, Counter())
        limits[2:] = fast
        Q, E = (np.concatenate([one[k] for one in made]) for k in (0, 2))
        off = self._excess(E, 0.0) > 1.0
        off[: int(np.argmin(np.append(off, False)))] = False  # the way to it does not count
        missing = len(samples.T) - len(Q)
        return np.concatenate([Q, np.repeat(Q[-1:], missing, axis=0)]), int(off.sum()) + missing

    def _planned(self, samples: Samples) -> np.ndarray | None:
        """Joint path (K + 1, n) of `solve_path` from where the arm stands, None where a pose is out of reach or there is none."""
        robot, unit = self.tracker.robot, self.tracker.robot.chain.unit
        reference: Any = dict(zip(robot.tips, self.references, strict=True)) if robot.by_tip else self.references[0]
        anywhere = bound_lm(robot, **self.counts)
        if not all(
            anywhere(one, self.q0).success for one in targets_at(reference, samples_of(robot, reference, POSES)[0])
        ):
            return None
        from ..paths.solve_path import solve_path

        some = np.unique(np.linspace(0, len(samples.T) - 1, min(len(samples.T), MOST_POSES)).astype(int))
        poses = samples.T[some] if robot.by_tip else samples.T[some, 0]
        found = solve_path(
            robot, poses[..., :3, 3] if self.references[0].position_only else poses, q0=self.q0, reconfigurations="none",
            max_step=STRIDE, position_tolerance=EXACT, orientation_tolerance=EXACT, **self.counts,
        )  # fmt: skip
        every = np.arange(len(samples.T))
        return (
            np.stack([np.interp(every, some, one) for one in found.q.T / unit[:, None]], axis=1)
            if found.success
            else None
        )

    # ------------------------------------------------------------------------------------------------ the law
    def _law(self, way: Way, share: float, top: np.ndarray, start: float, over: int = 0) -> Clock:
        """The fastest clock along a joint path, at `start` first, at most at `top`; share: of acceleration limits that it uses.

        over: times that its limits are raised.
        """
        limits, s, n = self.tracker._limits, way.s, way.Q.shape[1]
        slope, bend = np.gradient(way.Q, s, axis=0), np.zeros_like(way.Q)
        secant = np.diff(way.Q, axis=0) / np.diff(s)[:, None]
        bend[1:-1] = np.diff(secant, axis=0) / (0.5 * (s[2:] - s[:-2]))[:, None]
        more = JOINTS**over if self._redundant() else 1.0
        speed, most = more * SPEED * limits[2], more * share * limits[3]
        if self.tracker.engine.waits:  # a step misses by half of the tip's acceleration times dt^2
            slope, bend = np.hstack([slope, self.fine.V]), np.hstack([bend, self.fine.A])
            allowed = np.tile(
                np.repeat(2.0 * TOLERANCE * TIP**over * self.tolerances / self.dt**2, 3), len(self.references)
            )
            counted = self.tracker._settings.counts[0] > 0.0
            speed = np.append(speed, np.full(len(counted), np.inf))
            most = np.append(most, np.where(counted, allowed, np.inf))
        rate, joint = time_law(slope, bend, s, speed, most, top=top, gain=QUICK, start=start)
        joint = np.where(joint < n, joint, -1)
        times = times_of(s, rate)
        steps = max(int(np.ceil(times[-1] / self.dt - 1e-6)), 1)
        slower = times[-1] / (steps * self.dt)  # by less than a step, so that its end is a sample
        t = np.append(np.arange(steps) * self.dt * slower, times[-1])[: self.most + 1]
        at, now, gain = coordinate_at(t, times, s, rate)
        at[t == times[-1]] = s[-1]  # whatever rounding says
        held = joint[np.searchsorted(s, at, side="right") - 1]
        return Clock(smoothed(at), smoothed(now * slower), smoothed(gain * slower**2), held)

    def _clear(self, way: Way) -> np.ndarray:
        """Highest rates (K + 1,) of a law at which the arm can brake before what is in its way, see servo/collision_guard.py."""
        guard, unit, rates = self.tracker._guard, self.tracker.robot.chain.unit, np.ones(len(way.s))
        if guard is None:
            return rates
        slope = np.gradient(way.Q, way.s, axis=0) * unit
        some = np.unique(np.linspace(0, len(rates) - 1, min(len(rates), FEWEST)).astype(int))
        for k in some:
            guard.restart(way.Q[k] * unit)
            r = guard.rows(way.Q[k] * unit, slope[k], self.dt)
            nearer = guard.A[:r] @ slope[k]
            least = np.min(guard.b[:r][nearer > 0.0] / nearer[nearer > 0.0], initial=1.0)
            rates[k] = max(SPEED * least, SLOWEST) if least < 1.0 else 1.0
        return np.interp(way.s, way.s[some], rates[some])

    # ------------------------------------------------------------------------------------------------ runs
    def _begin(self, way: Way) -> None:
        """Go back to the start."""
        self.tracker.put_back(self.start)
        secondary = self.tracker.secondary
        secondary.avoid, secondary.wish[:2], secondary.wish[2] = way.avoid, way.posture, 0.0
        if self.tracker._guard:
            self.tracker._guard.restart(self.tracker.q)

    def _take(self, clock: Clock, samples: Samples, way: Way) -> Taken:
        """Run from the start to the end of a clock, or until Ctrl-C."""
        began, made, pairs = time.perf_counter(), [], Counter[tuple[str, str]]()
        if way.led:
            path = np.stack([np.interp(clock.s, way.s, one) for one in way.Q.T], axis=1)
            robot, posed = self.tracker.robot, [not one.position_only for one in self.references]
            way = way._replace(Q=path, sides=singular_sides(robot, posed, path * robot.chain.unit))
        self._begin(way)
        try:
            self._steps(samples, way, made, pairs)
        finally:
            if made:
                self.made.append(self._taken(clock, made, pairs, began))
        return self.made[-1]

    def _steps(self, samples: Samples, way: Way, made: list, pairs: Counter) -> None:
        """Take a step a sample, led along a way (at the samples) if it says so; adds pieces of what was run to `made`."""
        tracker, count, k = self.tracker, len(samples.T) - 1, 0
        most, ended = 1 if tracker.one_by_one or way.led else AT_ONCE, False
        while not ended:
            steps = min(most, count - k)
            if way.led:
                move = way.Q[k + 1] - way.Q[k]
                tracker.secondary.wish[:] = way.Q[k], np.full(len(move), LEAD / self.dt), move / self.dt
                tracker._carried.away[:] = way.sides[k + 1]
                tracker._state[laws.STATE.near] = 1.0 + SIDE
            now = samples if steps == count else samples_from(*(one[k : k + steps + 1] for one in samples[1:4]))
            record = new_record(steps + 1, tracker.robot.n, samples.V.shape[1])
            done = tracker.take(now, self.dt, record, runaway=RUNAWAY)
            if tracker._between:
                pairs[tracker._between] += 1
            k += done
            ended = k >= count or done < steps
            rows = done + 1 if ended else done
            made.append([*(one[:rows] for one in record[1:5]), record.C[:done]])

    def _taken(self, clock: Clock, made: list, pairs: Any, began: float) -> Taken:
        """A run, or what there is of it."""
        Q, R, E, S, C = (np.concatenate(part) for part in zip(*made, strict=True))
        whole, C = len(clock.s), C[: len(Q) - 1]  # every sample but the last has a step after it, if Ctrl-C was heard
        clock = Clock(*(one[: len(Q)] for one in clock))
        missed = int((self._excess(E) > 1.0).sum())
        if not self.tracker.engine.waits:
            missed = int(((C & (viability.VELOCITY | viability.ACCELERATION)) > 0).any(axis=1).sum())
        missed += (whole - len(Q)) * self.most  # worse than one that was left
        most = max(pairs, key=lambda pair: pairs[pair], default=None)
        return Taken(missed, Q, R, E, S, C, clock, self.tracker.carried(), time.perf_counter() - began, most)

    def _excess(self, E: np.ndarray, settle: float | None = None) -> np.ndarray:
        """Largest error over its tolerance (M,) of errors E (M, m), where it counts."""
        errors = np.linalg.norm(E.reshape(len(E), -1, 2, 3), axis=3)
        late = np.arange(len(E)) * self.dt >= (self.settle if settle is None else settle)
        return np.where(late, (errors / self.tolerances).max(axis=(1, 2)), 0.0)


def samples_along(references: list[Reference], clock: Clock, read: Callable = Reference.at) -> Samples:
    """Poses, twists and accelerations of the references where a clock is, as it runs. read: `checked` where they are new."""
    made = [read(one, clock.s) for one in references]
    V, A = (np.concatenate([one[k] for one in made], axis=1) for k in (1, 2))
    rate, gain = clock.rate[:, None], clock.gain[:, None]
    return samples_from(np.stack([one[0] for one in made], axis=1), V * rate, A * rate**2 + V * gain)
