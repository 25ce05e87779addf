"""The run of `track`: first in the reference's own time; if that fails, along a time law that the joints can keep.

The time law needs the joints' path q(s). The method itself computes it, without limits of speed and acceleration. If that path
leaves the reference, the method tries stronger avoidance of limits or another posture, and `solve_path` is the last resort.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from ..kernel.limits import LIMIT
from ..motion.reference import MAX_STEPS, Reference, checked
from ..motion.time_law import coordinate_at, evenly, resampled, smoothed, time_law, times_of
from ..validate import LATE
from .null_space_motion import AVOID, POSTURE
from .path_reach import bound_search, path_samples, singular_sides, targets_at
from .singular_step import WEAK
from .stepper import Stepper
from .viability import BIT, bending
from .workspace import START, STATE, Samples, new_record, samples_from


class RetimingConstants(NamedTuple):
    """Constants for the time law of a run, for the runs that are tried after it, and for the joint path that it follows."""

    quick: float = 10.0  # [1/s^2] largest change of the clock's rate per second: a run can start or stop within 0.1 s
    # share of the speed limits that a time law uses; the rest is for a run that differs a little from the planned motion
    speed: float = 0.98
    # shares of the acceleration limits that a time law uses, tried in turn; with the first one 31 of 288 runs failed
    acceleration: tuple[float, ...] = (0.95, 0.88, 0.8, 0.6)
    tolerance: float = 0.8  # share of the tolerances that a time law allows for the error of a step
    faster: int = 5  # largest number of faster time laws tried after a run that kept to the reference
    # factor on the joint limits in each faster time law for a redundant robot, whose other joints may help to keep the true limits
    joints: float = 1.2
    tip: float = 1.5  # factor by which the allowed error of the tip is raised for a faster time law
    far_off: float = 4.0  # An error of more tolerances than this is too large to come from the linearisation of steps.
    enough: float = 0.8  # share of the tolerance to aim at where the clock is slowed because a run missed the reference
    near: float = 0.05  # [s] time before and after a missed sample in which the clock is slowed
    least: float = 0.25  # least factor on the square of the clock rate when it is lowered
    # Another run is tried only if the last one missed at most this share of what the one before it missed.
    helped: float = 0.8
    alike: float = 1.25  # ratio up to which the largest errors of two runs that left the reference count as equal
    followed: float = 0.2  # share of the tolerance by which a step of a joint path may miss; it sets the steps' length
    fewest: int = 400  # least number of steps in which a joint path is computed
    # [1/s] gains of limit avoidance, tried if the default gain leads into limits
    harder: tuple[float, ...] = (10.0, 30.0)
    poses: int = 40  # least number of poses that must all be in reach before `solve_path` is called
    most_poses: int = 2001  # largest number of poses that `solve_path` is given; between them its path is linear
    # [m, rad] tolerances given to `solve_path`; larger errors, which vary from pose to pose, would look like accelerations
    exact: float = 1e-6
    stride: tuple[float, float] = (0.5, 0.2)  # [rad, m] largest joint moves between two poses of `solve_path`
    lead: float = 0.5  # share of the distance to a planned joint path that a step corrects by null-space motion
    slowest: float = 0.02  # least rate of the reference's clock near obstacles
    runaway: float = 100.0  # [rad or arm reaches] mean joint move in one step beyond which a run has diverged
    at_once: int = 20_000  # number of steps taken in compiled code before Ctrl-C is noticed


RETIME = RetimingConstants()
NOWHERE = np.zeros((0, 0))


class Clock(NamedTuple):
    """How the reference's time advances in a run; arrays (M + 1,) over the samples of the run."""

    s: np.ndarray  # [s] the reference's time
    rate: np.ndarray  # ds/dt, 1 in the reference's own time
    gain: np.ndarray  # [1/s] d2s/dt2, the rate of change of ds/dt
    joint: np.ndarray  # index of the joint that limits the rate, or -1


class Way(NamedTuple):
    """A joint path Q (K + 1, n) [rad or arm reaches] at reference times s (K + 1,) [s], and the null-space options for it."""

    s: np.ndarray
    Q: np.ndarray
    avoid: float  # [1/s] gain of limit avoidance
    posture: np.ndarray  # (2, n) posture for the null-space motion, and its gain [1/s]
    led: bool = False  # whether null-space motion is to follow this path, also at singular poses
    sides: np.ndarray = NOWHERE  # (M + 1, n) if led: directions away from singular poses (`singular_sides`)


class Taken(NamedTuple):
    """Outcome of one run: joint values Q, rates R, errors E, singular directions S and limit bits C at its samples."""

    missed: int  # samples off the reference; for a solver, which always lags, number of steps held back by limits
    Q: np.ndarray
    R: np.ndarray
    E: np.ndarray
    S: np.ndarray
    C: np.ndarray
    clock: Clock
    end: np.ndarray  # state that the stepper carries at the end of the run
    elapsed: float  # [s] time that the steps took to compute
    between: tuple[str, str] | None  # names of the two parts whose contact was avoided most often, or None


class Run:
    """Follows references (one per tip) step by step; makes several runs if the first fails, and returns the best one."""

    def __init__(
        self,
        stepper: Stepper,
        references: list[Reference],
        times: np.ndarray,
        tolerances: tuple[float, float],
        settle: float,
        stretch: float,
        counts: Mapping[str, Any],
    ) -> None:
        """Prepare a run over the reference's times (N + 1,) [s]; it may take up to `stretch` times as long.

        settle [s]: time from which on errors are judged; counts: the options that say which errors count.
        """
        self.stepper, self.references, self.times, self.dt = stepper, references, times, float(times[1])
        self.tolerances, self.settle, self.counts = np.array(tolerances), settle, counts
        self.count, self.most = len(times) - 1, int(np.ceil(min(stretch * (len(times) - 1), MAX_STEPS)))
        self.full = Clock(times, np.ones(len(times)), np.zeros(len(times)), np.full(len(times), -1))
        self.own = self.fine = samples_along(references, self.full, checked)  # `_ways` replaces `fine` by more samples
        stepper.late = LATE * self.dt
        self.start, self.q0 = stepper.carried(), stepper.joints()[0]
        weights = stepper.settings.counts[0]
        self.counted = weights > 0.0  # (m,) which errors count
        self.redundant = stepper.robot.n > self.counted.sum()
        self.made: list[Taken] = []
        self.interrupted = False

    def go(self, slow: bool) -> Taken:
        """Run to the end, and again if the reference may be slowed (slow) and that helps; return the best run.

        If no run keeps to the reference, the best is the one whose largest error is least, among the runs that reach its end.
        Ctrl-C ends the search with the best run so far, which may be incomplete. It is raised again if no step was taken.
        """
        stepper = self.stepper
        # This call takes no step, but compiles (or loads) the loop, so that the reported time does not include compiling.
        stepper.run(self.own, self.dt, new_record(1, stepper.robot.n, self.own.V.shape[1]), runaway=RETIME.runaway)
        stepper.put_back(self.start)
        began = time.perf_counter()
        try:
            self._try(slow)
        except KeyboardInterrupt:
            if not self.made:
                raise
            self.interrupted = True
        kept = [one for one in self.made if one.missed == 0]
        ended = kept or [one for one in self.made if one.clock.s[-1] == self.times[-1]] or self.made
        worst = [self._excess(one.E).max() for one in ended]
        near = kept or [one for one, far in zip(ended, worst, strict=True) if not far > RETIME.alike * min(worst)]
        best = min(near, key=lambda one: (one.missed, -one.clock.s[-1], len(one.Q)))
        stepper.put_back(best.end)
        self.searched = time.perf_counter() - began - best.elapsed
        return best

    def _try(self, slow: bool) -> None:
        """Take runs until one keeps to the reference, or nothing else helps."""
        secondary, moves = self.stepper.secondary, bool(self.own.V[0].any())
        here = Way(self.times, NOWHERE, secondary.avoid, secondary.wish[:2].copy())
        from_rest = moves and self.stepper.begins_at_rest() and min(self.stepper.limits[LIMIT.acceleration]) < np.inf
        if not (slow and from_rest):
            own = self._take(self.full, self.own, here)
            # no other run helps if the arm begins off its path
            if not slow or own.missed == 0 or self._excess(own.E[:1])[0] > 1.0:
                return
        for way in self._ways(here):
            self._slowly(way, from_rest)
            if min(taken.missed for taken in self.made) == 0:
                return

    def _slowly(self, way: Way, from_rest: bool) -> None:
        """Take runs along time laws for a joint path, with less and less acceleration until one succeeds; then try faster ones."""
        top, start, last = self._clear(way), 0.0 if from_rest else np.inf, np.inf
        for share in RETIME.acceleration:
            clock = self._law(way, share, top, start)
            taken = self._take(clock, samples_along(self.references, clock), way)
            if taken.missed == 0:
                self._faster(way, share, top, start)
                return
            if taken.missed > RETIME.helped * last or clock.s[-1] < self.times[-1]:
                return
            moved = np.append(True, np.diff(clock.s) > 0.0)
            if not way.led and len(taken.Q) == len(clock.s):  # Joints that are not led may leave the planned path.
                way = way._replace(Q=resampled(way.s, clock.s[moved], taken.Q[moved]))
            again = share < RETIME.acceleration[0]
            if again or self._excess(taken.E).max() < RETIME.far_off:
                self._lower(top, way, taken)
            last = taken.missed if again else np.inf

    def _faster(self, way: Way, share: float, top: np.ndarray, start: float) -> None:
        """Take runs along faster time laws, whose limits are raised, while the runs keep to the reference."""
        over, before = 1, self.made[-1].clock.s
        for _ in range(RETIME.faster):
            clock = self._law(way, share, top, start, over)
            if (len(clock.s), -clock.s[-1]) >= (len(before), -before[-1]):
                return
            taken = self._take(clock, samples_along(self.references, clock), way)
            if taken.missed == 0:
                over, before = over + 1, clock.s
            elif self._excess(taken.E).max() < RETIME.far_off:
                self._lower(top, way, taken)
            else:
                return

    def _lower(self, top: np.ndarray, way: Way, taken: Taken) -> None:
        """Lower the bounds top (K + 1,) on the clock rate near missed samples; errors grow with the square of that rate."""
        excess, near, clock = self._excess(taken.E), round(RETIME.near / self.dt), taken.clock
        for k in np.flatnonzero(excess > 1.0):
            here = slice(*np.searchsorted(way.s, clock.s[np.clip([k - near, k + near], 0, len(excess) - 1)]))
            top[here] = np.minimum(top[here], np.sqrt(max(RETIME.enough / excess[k], RETIME.least)) * clock.rate[k])

    def _ways(self, here: Way) -> Iterator[Way]:
        """Yield joint paths along the reference, best first."""
        # Each step of the run is divided into so many parts that the error of a part is small against the tolerance.
        bend = np.linalg.norm(self.own.A.reshape(self.count + 1, -1, 2, 3), axis=3).max(axis=(0, 1)) / self.tolerances
        fine = int(np.ceil(np.sqrt(0.5 * self.dt**2 * bend.max() / RETIME.followed)))
        parts = max(-(-RETIME.fewest // self.count), fine)
        if parts * self.count > MAX_STEPS:
            return
        s = np.linspace(0.0, self.times[-1], parts * self.count + 1)
        self.fine = samples_along(self.references, Clock(s, np.ones(len(s)), 0.0 * s, s))
        samples = samples_from(self.fine.T, self.fine.V / parts, self.fine.A / parts**2)
        plain = here.avoid == AVOID and not here.posture[1].any()  # whether the caller asked for no null-space motion
        found: list[tuple[int, int, Way]] = []  # for each joint path: samples missed, steps of a run along it, the path
        for way in (here, *(self._besides(here) if plain and self.redundant else ())):
            Q, off = self._follow(samples, way)
            way = way._replace(s=s, Q=Q)
            found.append((off, len(self._law(way, RETIME.acceleration[0], np.ones(len(s)), np.inf).s), way))
            if found[0][:2] == (0, self.count + 1):
                break
        found.sort(key=lambda one: one[:2])
        yield from (way for off, _, way in found if off == 0)
        slowest = found[0][0] == 0 and found[0][1] > self.most  # The best path keeps to the reference, but too slowly.
        other = plain and not slowest and self.stepper.engine.waits and not self.stepper.one_by_one
        if other and (planned := self._planned(samples)) is not None:
            yield Way(s, planned, 0.0, here.posture, led=True)
        if found[0][0] > 0:
            yield found[0][2]

    def _besides(self, here: Way) -> Iterator[Way]:
        """Yield variants of a joint path: with stronger avoidance of limits, or drawn to the middle of the joint ranges."""
        lower, upper = self.stepper.limits[[LIMIT.lowest, LIMIT.highest]]
        bounded = np.isfinite(upper - lower)
        for avoid in RETIME.harder:
            yield here._replace(avoid=avoid)
        middle = 0.5 * np.add(lower, upper, out=np.zeros(len(lower)), where=bounded)
        yield here._replace(posture=np.stack([middle, np.where(bounded, POSTURE, 0.0)]))

    def _follow(self, samples: Samples, way: Way) -> tuple[np.ndarray, int]:
        """Return the joint path (K + 1, n) of the method without speed and acceleration limits, and how many samples it misses."""
        limits, state = self.stepper.limits, self.stepper.state
        self._begin(way)
        kept = limits.copy()
        limits[[LIMIT.speed, LIMIT.acceleration]] = np.inf
        if state[STATE.start] == START.given:
            state[STATE.start] = START.with_target
        made: list = []
        self._steps(samples, way, made, Counter())
        limits[:] = kept
        Q, E = (np.concatenate([one[k] for one in made]) for k in (0, 2))
        off = self._excess(E, 0.0) > 1.0
        off[: int(np.argmin(np.append(off, False)))] = False  # Misses before the path is first reached do not count.
        missing = len(samples.T) - len(Q)
        return np.concatenate([Q, np.repeat(Q[-1:], missing, axis=0)]), int(off.sum()) + missing

    def _planned(self, samples: Samples) -> np.ndarray | None:
        """Return the joint path (K + 1, n) of `solve_path` from the present joints, or None if there is none."""
        robot, unit = self.stepper.robot, self.stepper.robot.chain.unit
        reference: Any = robot.for_tips(dict(zip(robot.tips, self.references, strict=True)))
        anywhere = bound_search(robot, **self.counts)
        targets = targets_at(reference, path_samples(robot, reference, RETIME.poses)[0])
        if not all(anywhere(one, self.q0).success for one in targets):
            return None
        from ..paths.solve_path import solve_path

        some = evenly(len(samples.T), RETIME.most_poses)
        poses = samples.T[some, :, :3, 3] if self.references[0].position_only else samples.T[some]
        found = solve_path(
            robot, robot.for_tips({tip: poses[:, f] for f, tip in enumerate(robot.tips)}), q0=self.q0, reconfigurations="none",
            max_step=RETIME.stride, position_tolerance=RETIME.exact, orientation_tolerance=RETIME.exact, **self.counts,
        )  # fmt: skip
        return resampled(np.arange(len(samples.T)), some, found.q / unit) if found.success else None

    def _law(self, way: Way, share: float, top: np.ndarray, start: float, over: int = 0) -> Clock:
        """Return the fastest clock along a joint path, with rates up to top (K + 1,), and up to `start` at its beginning.

        share: part of the acceleration limits to use; over: how many times the limits are raised (RETIME.joints, RETIME.tip).
        """
        limits, s, n = self.stepper.limits, way.s, way.Q.shape[1]
        slope, bend = np.gradient(way.Q, s, axis=0), np.zeros_like(way.Q)
        secant = np.diff(way.Q, axis=0) / np.diff(s)[:, None]
        bend[1:-1] = np.diff(secant, axis=0) / (0.5 * (s[2:] - s[:-2]))[:, None]
        more, peak = RETIME.joints**over if self.redundant else 1.0, bending(self.stepper.engine.gamma)
        speed, most = more * RETIME.speed * limits[LIMIT.speed], more * share / peak * limits[LIMIT.acceleration]
        # A step at constant twist misses the target by half of the tip's acceleration times dt^2. The tolerance limits both.
        if self.stepper.engine.waits:
            slope, bend = np.hstack([slope, self.fine.V]), np.hstack([bend, self.fine.A])
            allowed = np.repeat(2.0 * RETIME.tolerance * RETIME.tip**over * self.tolerances / self.dt**2, 3)
            speed = np.append(speed, np.full(len(self.counted), np.inf))
            most = np.append(most, np.where(self.counted, np.tile(allowed, len(self.references)), np.inf))
        rate, joint = time_law(slope, bend, s, speed, most, top=top, gain=RETIME.quick, start=start)
        joint = np.where(joint < n, joint, -1)
        times = times_of(s, rate)
        steps = max(np.ceil(times[-1] / self.dt - 1e-6), 1.0)
        slower = times[-1] / (steps * self.dt)  # The clock is slowed by less than a step, so that its end is a sample.
        # If the clock nearly stands still, there could be very many samples, so their number is limited before they are made.
        t = np.append(np.arange(min(steps, self.most + 1.0)) * self.dt * slower, times[-1])[: self.most + 1]
        at, now, gain = coordinate_at(t, times, s, rate)
        at[t == times[-1]] = s[-1]  # The end must be exact despite rounding.
        held = joint[np.searchsorted(s, at, side="right") - 1]
        return Clock(smoothed(at), smoothed(now * slower), smoothed(gain * slower**2), held)

    def _clear(self, way: Way) -> np.ndarray:
        """Return the highest clock rates (K + 1,) at which the arm can brake for obstacles (collision_guard.py)."""
        guard, unit, rates = self.stepper.guard, self.stepper.robot.chain.unit, np.ones(len(way.s))
        if guard is None:
            return rates
        slope = np.gradient(way.Q, way.s, axis=0) * unit
        some = evenly(len(rates), RETIME.fewest)
        for k in some:
            guard.restart(way.Q[k] * unit)
            r = guard.rows(way.Q[k] * unit, slope[k], self.dt)
            nearer = guard.A[:r] @ slope[k]
            least = np.min(guard.b[:r][nearer > 0.0] / nearer[nearer > 0.0], initial=1.0)
            rates[k] = max(RETIME.speed * least, RETIME.slowest) if least < 1.0 else 1.0
        return np.interp(way.s, way.s[some], rates[some])

    def _begin(self, way: Way) -> None:
        """Reset the stepper to the start of the run, with limit avoidance and posture as in `way`."""
        self.stepper.put_back(self.start)
        secondary = self.stepper.secondary
        secondary.avoid, secondary.wish[:2], secondary.wish[2] = way.avoid, way.posture, 0.0
        if self.stepper.guard:
            self.stepper.guard.restart(self.stepper.joints()[0])

    def _take(self, clock: Clock, samples: Samples, way: Way) -> Taken:
        """Run from the start to the end of a clock, or until Ctrl-C; return the run."""
        began, made, pairs = time.perf_counter(), [], Counter[tuple[str, str]]()
        if way.led:
            path = resampled(clock.s, way.s, way.Q)
            robot, posed = self.stepper.robot, [not one.position_only for one in self.references]
            way = way._replace(Q=path, sides=singular_sides(robot, posed, path * robot.chain.unit))
        self._begin(way)
        try:
            self._steps(samples, way, made, pairs)
        finally:
            if made:
                self.made.append(self._taken(clock, made, pairs, began))
        return self.made[-1]

    def _steps(self, samples: Samples, way: Way, made: list, pairs: Counter) -> None:
        """Take one step per sample, and append the recorded arrays to `made`; pairs: counts of the parts that nearly touched.

        If way.led, the steps follow the joint path of `way`, which is then given at the samples.
        """
        stepper, count, k = self.stepper, len(samples.T) - 1, 0
        most, ended = 1 if stepper.one_by_one or way.led else RETIME.at_once, False
        while not ended:
            steps = min(most, count - k)
            if way.led:
                move = way.Q[k + 1] - way.Q[k]
                stepper.secondary.wish[:] = way.Q[k], np.full(len(move), RETIME.lead / self.dt), move / self.dt
                stepper.away[:] = way.sides[k + 1]
                stepper.state[STATE.near] = 1.0 + WEAK.side
            now = samples if steps == count else samples_from(*(one[k : k + steps + 1] for one in samples[1:4]))
            record = new_record(steps + 1, stepper.robot.n, samples.V.shape[1])
            done = stepper.take(now, self.dt, record, runaway=RETIME.runaway)
            if stepper.between:
                pairs[stepper.between] += 1
            k += done
            ended = k >= count or done < steps
            rows = done + 1 if ended else done
            made.append([*(one[:rows] for one in record[1:5]), record.C[:done]])

    def _taken(self, clock: Clock, made: list, pairs: Any, began: float) -> Taken:
        """Combine the records `made` of a run, complete or not, into a Taken."""
        Q, R, E, S, C = (np.concatenate(part) for part in zip(*made, strict=True))
        whole, C = len(clock.s), C[: len(Q) - 1]  # After Ctrl-C there is one row of limit bits too many.
        clock = Clock(*(one[: len(Q)] for one in clock))
        missed = int((self._excess(E) > 1.0).sum())
        if not self.stepper.engine.waits:
            missed = int(((C & (BIT.velocity | BIT.acceleration)) > 0).any(axis=1).sum())
        missed += (whole - len(Q)) * self.most  # so that any incomplete run counts as worse than a complete one
        most = max(pairs, key=lambda pair: pairs[pair], default=None)
        return Taken(missed, Q, R, E, S, C, clock, self.stepper.carried(), time.perf_counter() - began, most)

    def _excess(self, E: np.ndarray, settle: float | None = None) -> np.ndarray:
        """Return for each of M samples the largest ratio of error, in E (M, m), to tolerance; 0 before settle [s]."""
        with np.errstate(over="ignore"):  # In a run that diverges, errors may be so large that their squares overflow.
            errors = np.linalg.norm(E.reshape(len(E), -1, 2, 3), axis=3)
        late = np.arange(len(E)) * self.dt >= (self.settle if settle is None else settle)
        return np.where(late, (errors / self.tolerances).max(axis=(1, 2)), 0.0)


def samples_along(references: list[Reference], clock: Clock, read: Callable = Reference.at) -> Samples:
    """Sample the references (one per tip) at the times of a clock, by the function `read`, and scale their motion to its rate."""
    made = [read(one, clock.s) for one in references]
    V, A = (np.concatenate([one[k] for one in made], axis=1) for k in (1, 2))
    rate, gain = clock.rate[:, None], clock.gain[:, None]
    return samples_from(np.stack([one[0] for one in made], axis=1), V * rate, A * rate**2 + V * gain)
