"""The search for a path: solve anchors, link their tracks by dynamic programming, test contact, add anchors at the breaks.

An anchor is a pose solved from many starts; a track is one of its solutions continued along the path. "Program" always means
the dynamic program over the tracks.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..kernel.counted_error import POSE
from ..kernel.kinematics import TAU
from ..solvers.task import counts_in_part
from ..text import length
from .contact import Margins
from .continuation import ISOLATED, MOST, POOL, SAME, STARTS, THIN, Tracks, spread
from .exact_branches import ROUNDING, alive, copies, solutions, unwound
from .path_problem import Problem
from .result import Unreachable
from .shortest_path import CONTACT, DEAD, Program, Tester, free_path, middle_first

EVERY = 20  # poses between two anchors of a robot with isolated solutions: cheap, and none may be missed
ANCHORS = 13  # first anchors of a redundant robot: tracks reach far; with 9 a short path was missed in one of 25 runs
SHARE = 40  # most tracks an anchor of a redundant robot may add
TRIED = 3  # seeds tested for contact per track an anchor may add: next to an obstacle one in two touches
PATIENCE = 2  # rounds of further anchors at the breaks that may fail to help
# [rad] first contact margin over a pair's longest arm: 3 mm at one metre, cheap to prove free between poses
NEAR = 0.003
PROBES = 9  # poses of a gap without a solution: if its middle and quarters have none, the rest is unlikely to
LEAST, BUDGET = 20_000, 200  # contact tests allowed: for any path, and per pose; usually some 15 per pose are used


def _runs(places: np.ndarray) -> list[np.ndarray]:
    """Split ascending indices into runs without gaps."""
    return [run for run in np.split(places, np.flatnonzero(np.diff(places) > 1) + 1) if len(run)]


def model_near(model: Any, limits: np.ndarray) -> Callable[[Any], bool]:
    """Contact test of a CollisionModel with margin NEAR; limits (2, n) [rad, m]."""
    margins = Margins(model, np.where(np.isfinite(limits), np.abs(limits), 0.0).max(axis=0))
    return lambda q: not margins.free(q, NEAR)


def _within(best: tuple[int, int], allowed: float) -> bool:
    """Whether there is a path with at most `allowed` reconfigurations."""
    return best[0] >= 0 and best[1] % CONTACT <= allowed


class Found(NamedTuple):
    """Best path found: q (N, n) in kernel units, NaN where there is none; tracks (N,), -1 there.

    breaks: poses after which it reconfigures; contacts: poses at which it touches.
    """

    q: np.ndarray
    tracks: np.ndarray
    breaks: list[int]
    contacts: int
    verified: bool  # whether the state at every pose was tested


class Search:
    """Tracks of a problem and the program over them, refined round by round; `found` is the best path so far."""

    def __init__(
        self,
        problem: Problem,
        model: Any,
        q0: np.ndarray | None,
        q_end: np.ndarray | None,
        threads: int,
        seed: int,
        progress: Callable[[float, str], None],
    ) -> None:
        """q0, q_end (n,) in kernel units: start and end of the path, or configurations near which it starts and ends.

        model: CollisionModel or None.
        """
        self.problem, self.model, self.ends, self.progress = problem, model, (q0, q_end), progress
        self.collides: Any = None
        self.tester: Any = None
        if model is not None:
            self.keep_away(model_near(model, problem.limits[:2] * problem.unit))
        self.tracks = Tracks(problem, MOST if problem.redundant else ISOLATED, threads, seed)
        self.anchored: dict[int, float] = {}  # anchor -> proven distance out of reach [m], 0: not proven
        self.program: Any = None
        self.found: Any = None
        self.lower_bound: int | None = None
        self.sure: np.ndarray | None = None  # poses (N,) whose solutions are all known ...
        self.legal = np.empty((0, 0), dtype=bool)  # ... and which of those (N, K) the limits allow
        self.copied: set[int] = set()  # joints with more than a full turn whose turns must be distinguished
        self.wound = problem.endless
        self.fixed = [False, False]  # whether the path starts exactly at q0, ends exactly at q_end

    def keep_away(self, collides: Callable[[Any], bool]) -> None:
        """Test contact with collides(q) (n,) [rad, m] from now on and forget earlier results."""
        self.collides = collides
        self.tester = Tester(collides, self.problem.unit, max(BUDGET * len(self.problem.T), LEAST))

    # ---------------------------------------------------------------------------------------------------------- anchors
    def anchor(self, t: int, count: int) -> int:
        """Solve pose t from many starts and extend its new solutions; returns the number of tracks added."""
        p, tracks = self.problem, self.tracks
        Q0 = p.robot.random_q(tracks.rng, STARTS)
        for q in self.ends:
            if q is not None:
                Q0[0] = q * p.unit
        Q0[:, p.plan.held] = (p.stand * p.unit)[p.plan.held]
        found, beyond = p.solutions(t, Q0)
        self.anchored[t] = beyond
        if not len(found):
            return 0
        if not p.redundant:
            seeds = spread(found, tracks.at(t), ISOLATED, SAME)
        else:
            seeds = spread(found[:POOL], tracks.at(t), TRIED * count if self.collides else count, THIN * p.most.min())
            if self.collides is not None:
                seeds = self.without_contact(seeds, count)
        tracks.add(seeds, np.full(len(seeds), t))
        return len(seeds)

    def without_contact(self, seeds: np.ndarray, count: int) -> np.ndarray:
        """The first `count` of seeds (m, n) that touch nothing or, if all touch, the first few of them."""
        free = []
        for q in seeds:
            if not self.collides(q * self.problem.unit):
                free.append(q)
                if len(free) == count:
                    break
        return np.array(free) if free else seeds[: max(1, count // 4)]

    def first_anchors(self) -> None:
        """Solve poses spread over the path; given ends become tracks, too."""
        p, N = self.problem, len(self.problem.T)
        for k, (q, t) in enumerate(zip(self.ends, (0, N - 1), strict=True)):
            if q is not None and self.solves(q, t):
                self.fixed[k] = True
                self.tracks.add(p.settled(q[None], np.array([t]))[0], np.array([t]))
        if p.redundant:
            places = np.unique(np.linspace(0, N - 1, min(N, ANCHORS)).astype(int))
            places = places[middle_first(len(places))]
        else:
            places = np.unique(np.append(np.arange(0, N, EVERY), N - 1))
        for k, t in enumerate(places):
            self.anchor(int(t), SHARE)
            self.progress(0.7 * (k + 1) / len(places), "extending solutions along the path")
        self.fill()

    def solves(self, q: np.ndarray, t: int) -> bool:
        """Whether q (n,) reaches pose t."""
        moved, good = self.problem.settled(q[None], np.array([t]))
        return bool(good[0] and np.abs(moved[0] - q).max() < SAME)

    def fill(self) -> None:
        """Solve poses that no track passes: ends and middle of each gap, then of what is left, until PROBES of it had no solution.

        Given poses come before inserted ones: an arm with fewer joints than the task has may reach those, and none in between.
        """
        alive = self.tracks.alive()
        for gap in _runs(np.flatnonzero(alive == 0)):
            order = gap[middle_first(len(gap))]
            inserted = self.problem.at[order] % 1.0 > 0.0
            missed = 0
            for t in np.append(order[~inserted], order[inserted]).tolist():
                if missed == PROBES:
                    break
                if alive[t] == 0 and t not in self.anchored:
                    self.anchor(t, SHARE)
                    alive = self.tracks.alive()
                    missed += int(alive[t] == 0)

    # ----------------------------------------------------------------------------------------------------------- linking
    def link(self) -> None:
        """Build the program over the current tracks and take its best path."""
        self.progress(0.7, "linking them")
        self.build()
        self.found = self.best()

    def build(self) -> None:
        """Build the program, with copies of the tracks on all turns of the joints in `copied`."""
        p, tracks = self.problem, self.tracks
        Q, span = tracks.Q[:, : tracks.size], tracks.span
        self.wound = p.endless.copy()  # joints whose full turns do not count in the program
        if not p.redundant and len(span):
            self.wound[[i for i in p.turning if i not in self.copied]] = True
            for i in self.copied:
                Q, span = copies(Q, span, i, *p.limits[:2, i])
        program = self.program = Program(Q, span, p.most, self.wound)
        program.state[~alive(Q, span, p.limits, ~self.wound)] = DEAD
        for k, (q, t, terms) in enumerate(zip(self.ends, (0, len(Q) - 1), (program.begin, program.end), strict=True)):
            if q is not None:
                d = Q[t].astype(float) - q
                d -= self.wound * TAU * np.rint(d / TAU)
                terms[1] = np.abs(d).sum(axis=1)
                if self.fixed[k]:
                    terms[0] = (np.abs(d).max(axis=1) > SAME).astype(float)
        if self.tester is not None:
            self.tester = self.tester.of(program)

    def best(self, allowed: float | None = None) -> Found:
        """The best path to the last pose, or to the farthest pose reached with at most `allowed` reconfigurations."""
        while True:
            found, unfit = self.made(allowed)
            if not unfit:
                return found
            self.copied |= unfit
            self.build()

    def made(self, allowed: float | None) -> tuple[Found, set[int]]:
        """Best path through the current program, and the joints whose turns do not fit the limits."""
        p, program = self.problem, self.program
        N, K = program.state.shape
        last, verified = N - 1, True
        if self.tester is None or not K:
            program.run()
        else:
            free_path(program, self.tester)
            verified = self.tester.left > 0
        if allowed is not None:
            reached = (t for t in range(N - 1, -1, -1) if _within(program.best(t), allowed))
            last = next(reached, -1)
        tracks, jumps = np.full(N, -1), np.zeros(N, dtype=bool)
        if last >= 0:
            tracks[: last + 1], jumps[: last + 1] = program.path(last)
        q = np.full((N, p.robot.n), np.nan)
        on = np.flatnonzero(tracks >= 0)
        q[on] = program.Q[on, tracks[on]]
        breaks = []
        for t in np.flatnonzero(jumps).tolist():  # only between neighbouring poses, not across unreached ones
            before = int(on[np.searchsorted(on, t) - 1])
            if (p.at[before + 1 : t] != np.round(p.at[before + 1 : t])).all():  # except across inserted poses only
                breaks.append(before)
        limits = np.where(p.endless, [[-np.inf], [np.inf]], p.limits[:2])
        fixed = [self.fixed[0], self.fixed[1] and last == N - 1]
        unfit = unwound(q, breaks, self.wound, limits, self.ends, fixed)
        contacts = program.best(last)[1] // CONTACT if len(on) else 0
        return Found(q, tracks, breaks, int(contacts), verified), unfit

    # -------------------------------------------------------------------------------------------------------------- whole
    def run(self) -> Found:
        """Search until the path has no reconfiguration, or further anchors do not help."""
        self.first_anchors()
        self.link()
        if self.worth() and self.model is not None:  # without the extra margin: a narrow passage may be free
            self.keep_away(self.model.collides)
            self.link()
        left = PATIENCE
        while self.worth() and left:
            worst = self.worth()
            places = [t for k in self.found.breaks for t in (k, k + 1)]
            fresh = [t for t in places if t not in self.anchored or self.problem.redundant][: 2 * ANCHORS]
            if not sum(self.anchor(t, SHARE) for t in fresh):
                break
            self.link()
            left = PATIENCE if self.worth() < worst else left - 1
        self.prove()
        return self.found

    # ------------------------------------------------------------------------------------------------------------- proof
    def prove(self) -> None:
        """Set `lower_bound` if the number of reconfigurations is provably minimal: every solution of every pose is on a track."""
        p = self.problem
        if not self.found.breaks and self.tracks.size and self.tracks.alive().all():
            self.lower_bound = 0
            return
        if p.kinds != (POSE,) or counts_in_part(p.kinds, p.plan.options) or len(p.plan.held):
            return
        listed = solutions(p.robot, p.T)
        if listed is None:
            return
        Q, self.sure = listed
        Q = Q / p.unit
        low, high = p.limits[:2] + np.array([[-ROUNDING], [ROUNDING]])
        turn = np.isin(np.arange(p.robot.n), np.append(p.turning, np.flatnonzero(p.endless)))
        nearest = Q + np.where(turn, TAU * np.ceil((low - Q) / TAU), 0.0) if turn.any() else Q
        nearest = np.where(np.isfinite(low), nearest, Q)
        self.legal = ((nearest >= low) & (nearest <= high)).all(axis=2)
        for _ in range(PATIENCE):
            missing = self.legal & ~self.known(Q)
            if not missing.any():
                break
            for j in range(Q.shape[1]):
                places = np.array([run[len(run) // 2] for run in _runs(np.flatnonzero(missing[:, j]))], dtype=int)
                self.tracks.add(p.turned(Q[places, j]), places)
            self.link()
        if self.sure.all() and not (self.legal & ~self.known(Q)).any():
            self.lower_bound = len(self.found.breaks)

    def known(self, Q: np.ndarray) -> np.ndarray:
        """Which solutions Q (N, K, n) lie on some track, ignoring full turns (N, K)."""
        tracks, there = self.tracks, np.zeros(Q.shape[:2], dtype=bool)
        t = np.arange(len(Q))
        for k in range(tracks.size):
            d = tracks.Q[:, k, None] - Q
            d -= TAU * np.rint(d / TAU)
            passes = (tracks.span[k, 0] <= t) & (t <= tracks.span[k, 1])
            there |= (np.abs(d).max(axis=2) < SAME) & passes[:, None]
        return there

    # ---------------------------------------------------------------------------------------------------------- verdicts

    def worth(self) -> int:
        """Cost of the best path: contacts first, then reconfigurations."""
        return self.found.contacts * CONTACT + len(self.found.breaks)

    def without(self, found: Found, steps: list[int]) -> bool:
        """Find the best path again without these steps (from pose k to the next); False if there are none to exclude."""
        program = self.program
        before = len(program.blocked)
        for k in steps:
            a, b = found.tracks[k], found.tracks[k + 1]
            if a >= 0 and b >= 0:
                program.blocked.add((k + 1, int(a), int(b)))
                program.changed = min(program.changed, k + 1)
        if len(program.blocked) == before:
            return False
        self.found = self.best()
        return True

    def unreachable(self) -> list[Unreachable]:
        """Poses for which no solution was found, and why."""
        missing = (
            np.flatnonzero(~(self.program.state != DEAD).any(axis=1))
            if self.tracks.size
            else range(len(self.problem.T))
        )
        said = []
        for t in missing:
            place = self.problem.at[t]
            if place != round(place):  # an inserted pose
                continue
            beyond = self.anchored.get(int(t))
            if beyond is None:  # a gap is probed, not solved at every pose
                beyond = self.problem.solutions(int(t), self.problem.robot.home[None])[1]
                reason = "no solution at a neighbouring pose leads to it"
            else:
                reason = f"no solution found from {STARTS} starts"
            if beyond > 0.0:
                reason = f"beyond reach by {length(beyond, 4)} (a bound from the link lengths)"
            elif self.sure is not None and self.sure[t] and not self.legal[t].any():
                reason, beyond = "every solution violates a joint limit, or none exists", np.inf
            said.append(Unreachable(int(place), reason, beyond > 0.0))
        return said
