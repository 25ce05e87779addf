"""The search for a path: solve some poses, continue their solutions along the path, link them by dynamic programming.

An anchor is a pose that is solved from many random starts. A track is one of its solutions, continued along the path as
far as it goes. The dynamic program over the tracks (`shortest_path.Program`) finds the best path. Where this path still
reconfigures, the poses around the break become anchors, too, and the program is run again.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..kernel.counted_error import KIND
from ..kernel.kinematics import TAU
from ..solvers.task import counts_in_part
from ..text import length
from .contact import Margins
from .continuation import MOST, POOL, SAME, STARTS, THIN, Tracks, spread
from .exact_branches import ROUNDING, alive, copies, every_solution, unwound
from .path_problem import Problem
from .result import Unreachable
from .shortest_path import CONTACT, DEAD, Program, Tester, free_path, middle_first


class Effort(NamedTuple):
    """Constants that set how much work a search does."""

    # if a pose has finitely many solutions, every 20th pose is an anchor (solved from many starts), so that no branch is missed
    every: int = 20
    anchors: int = 13  # first anchors for a redundant robot; few suffice, because its solutions can be continued far
    share: int = 40  # largest number of tracks (continued solutions) that an anchor adds for a redundant robot
    # largest number of tracks of all first anchors of a redundant robot, to bound the time of simple paths
    first: int = 300
    tried: int = 3  # number of solutions that are tested for contact, per track that an anchor may add
    patience: int = 2  # The search ends after so many rounds of further anchors in a row without a better path.
    rounds: int = 8  # largest number of rounds, for a proof, of adding solutions that lie on no track; two are usual
    # The first search keeps a margin of `near` [rad] times the longest lever arm of a pair of shapes: 3 mm for a metre.
    near: float = 0.003  # With this margin the motion between poses is easily proven free of contact.
    # After so many poses in a row without a solution, the other poses without tracks are solved with fewer attempts.
    probes: int = 9
    least: int = 20_000  # A search may make `budget` collision tests per pose of the path, and at least `least` in all.
    budget: int = 200


EFFORT = Effort()


def _runs(places: np.ndarray) -> list[np.ndarray]:
    """Split ascending indices into runs of consecutive ones."""
    return [run for run in np.split(places, np.flatnonzero(np.diff(places) > 1) + 1) if len(run)]


def model_near(model: Any, limits: np.ndarray) -> Callable[[Any], bool]:
    """Return a function of q (n,) that says whether any two parts are nearer than the margin EFFORT.near.

    model: a CollisionModel; limits (2, n) [rad or m]: lower and upper joint limits, which bound the lever arms.
    """
    margins = Margins(model, np.where(np.isfinite(limits), np.abs(limits), 0.0).max(axis=0))
    return lambda q: not margins.free(q, EFFORT.near)


def _within(best: tuple[int, int], allowed: float) -> bool:
    """Return whether `best`, the result of `Program.best`, is a path with at most `allowed` reconfigurations."""
    return best[0] >= 0 and best[1] % CONTACT <= allowed


class Found(NamedTuple):
    """A path found: q (N, n) [rad, or length / reach], tracks (N,); NaN and -1 at poses that it does not pass.

    breaks: poses after which it reconfigures; contacts: number of poses at which it is in contact.
    """

    q: np.ndarray
    tracks: np.ndarray
    breaks: list[int]
    contacts: int
    verified: bool  # False if the collision tests ended before the path was tested at every pose


class Search:
    """A path search: the tracks of a Problem and the dynamic program over them, refined round by round.

    A track is one solution continued along the path. `found` is the best path found so far, `lower_bound` the proven
    least number of reconfigurations (None: not proven), and `fixed` says whether the path starts exactly at q0, and
    ends exactly at q_end.
    """

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
        """Store the arguments of a search.

        model: a CollisionModel or None; q0, q_end (n,) [rad, or length / reach] or None: start and end of the path, or
        configurations near them; seed: number that fixes the random starts; progress: function of a share (0 to 1) and a text.
        """
        self.problem, self.model, self.ends, self.progress = problem, model, (q0, q_end), progress
        self.collides: Any = None
        self.tester: Any = None
        if model is not None:
            self.keep_away(model_near(model, problem.limits[:2] * problem.unit))
        self.tracks = Tracks(problem, threads, seed)
        # for each anchor without solutions, how far [m] it is proven out of reach (0: not proven); for other anchors None
        self.anchored: dict[int, float | None] = {}
        self.program: Any = None
        self.found: Any = None
        self.lower_bound: int | None = None
        # all solutions (N, K, n) of the poses [rad, or length / reach], and whether (N,) they are proven to be all; or None
        self.listing, self.legal = self.list_solutions()  # legal (N, K): which of these solutions keep the joint limits
        self.copied: set[int] = set()  # joints with a range above 2 pi in which tracks are copied with shifts by 2 pi
        self.wound = problem.endless
        self.fixed = [False, False]  # whether the path starts exactly at q0, and whether it ends exactly at q_end

    def keep_away(self, collides: Callable[[Any], bool]) -> None:
        """From now on, test q (n,) [rad or m] for contact by the function collides(q); forget the results of earlier tests."""
        self.collides = collides
        self.tester = Tester(collides, self.problem.unit, max(EFFORT.budget * len(self.problem.T), EFFORT.least))

    # ---------------------------------------------------------------------------------------------------------- anchors
    def anchor(self, t: int, count: int, starts: int = STARTS) -> int:
        """Solve pose t from `starts` random starts, and continue its new solutions along the path as tracks.

        count: largest number of new tracks of a redundant robot. Returns the number of tracks added.
        """
        p, tracks = self.problem, self.tracks
        Q, sure = self.listing or (None, np.zeros(t + 1, dtype=bool))
        if Q is not None and sure[t] and self.legal[t].any():
            found, beyond = p.turned(Q[t, self.legal[t]]), 0.0
        else:
            Q0 = p.robot.random_q(tracks.rng, 1 if sure[t] else starts)
            for q in self.ends:
                if q is not None:
                    Q0[0] = q * p.unit
            Q0[:, p.plan.held] = (p.stand * p.unit)[p.plan.held]
            found, beyond = p.solutions(t, Q0)
        self.anchored[t] = None if len(found) else beyond
        if not len(found):
            return 0
        if not p.redundant:
            seeds = spread(found, tracks.at(t), MOST, SAME)
        else:
            seeds = spread(
                found[:POOL], tracks.at(t), EFFORT.tried * count if self.collides else count, THIN * p.most.min()
            )
            if self.collides is not None:
                seeds = self.without_contact(seeds, count)
        before = tracks.size
        tracks.add(seeds, np.full(len(seeds), t))
        return tracks.size - before

    def without_contact(self, seeds: np.ndarray, count: int) -> np.ndarray:
        """Return the first `count` of the configurations seeds (m, n) [rad, or length / reach] that are free of contact.

        If all are in contact, return the first quarter of `count`, so that a path in contact can still be found.
        """
        free = []
        for q in seeds:
            if not self.collides(q * self.problem.unit):
                free.append(q)
                if len(free) == count:
                    break
        return np.array(free) if free else seeds[: max(1, count // 4)]

    def first_anchors(self) -> None:
        """Begin tracks (joint motions along the path) from solutions of some poses, and from q0 and q_end if they reach theirs."""
        p, N = self.problem, len(self.problem.T)
        for k, (q, t) in enumerate(zip(self.ends, (0, N - 1), strict=True)):
            if q is not None and self.solves(q, t):
                self.fixed[k] = True
                self.tracks.add(p.settled(q[None], np.array([t]))[0], np.array([t]))
        if p.redundant:
            places = np.unique(np.linspace(0, N - 1, min(N, EFFORT.anchors)).astype(int))
            places = places[middle_first(len(places))]
        else:
            places = np.unique(np.append(np.arange(0, N, EFFORT.every), N - 1))
        for k, t in enumerate(places):
            if p.redundant and self.tracks.size >= EFFORT.first:
                break
            self.anchor(int(t), min(EFFORT.share, EFFORT.first - self.tracks.size))
            self.progress(0.7 * (k + 1) / len(places), "extending solutions along the path")
        self.fill()

    def solves(self, q: np.ndarray, t: int) -> bool:
        """Return whether q (n,) [rad, or length / reach] reaches pose number t."""
        moved, good = self.problem.settled(q[None], np.array([t]))
        return bool(good[0] and np.abs(moved[0] - q).max() < SAME)

    def fill(self) -> None:
        """Solve the poses at which no track exists: in each run of such poses the ends first, then the middle, and so on.

        Requested poses come before inserted ones, because an arm with too few joints may reach only the former. After EFFORT.probes
        in a row without a solution, the other requested poses are solved with fewer attempts, and inserted ones not at all.
        """
        alive = self.tracks.alive()
        for gap in _runs(np.flatnonzero(alive == 0)):
            order = gap[middle_first(len(gap))]
            inserted = self.problem.at[order] % 1.0 > 0.0
            missed = 0
            for t in np.append(order[~inserted], order[inserted]).tolist():
                lost = missed >= EFFORT.probes
                if alive[t] or t in self.anchored or (lost and self.problem.at[t] % 1.0):
                    continue
                room = (MOST - self.tracks.size) // int(np.count_nonzero(alive == 0))
                self.anchor(t, max(1, min(EFFORT.share, room)), 1 if lost else STARTS)
                alive = self.tracks.alive()
                missed = 0 if alive[t] else missed + 1

    # ----------------------------------------------------------------------------------------------------------- linking
    def link(self) -> None:
        """Build the dynamic program over the current tracks and take its best path as `found`."""
        self.progress(0.7, "linking them")
        self.build()
        self.found = self.best()

    def build(self) -> None:
        """Build the dynamic program over the tracks, with copies of them in which the joints in `copied` are shifted by 2 pi."""
        p, tracks = self.problem, self.tracks
        Q, span = tracks.Q[:, : tracks.size], tracks.span
        self.wound = p.endless.copy()  # (n,) joints whose values count modulo 2 pi in the dynamic program
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
        """Return the best path to the last pose or, with `allowed`, to the farthest pose within this many reconfigurations.

        If a joint turns too far for its limits, tracks are copied with that joint shifted by 2 pi k, and a new path is sought.
        """
        while True:
            found, unfit = self.made(allowed)
            if not unfit:
                return found
            self.copied |= unfit
            self.build()

    def made(self, allowed: float | None) -> tuple[Found, set[int]]:
        """Return the best path in the current dynamic program, and the joints that it would turn too far for their limits.

        allowed: None, or the largest number of reconfigurations; the path then ends at the farthest pose they lead to.
        """
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
        # A jump across poses that are not reached counts as a reconfiguration only if all of them were inserted, not asked for.
        for t in np.flatnonzero(jumps).tolist():
            before = int(on[np.searchsorted(on, t) - 1])
            if (p.at[before + 1 : t] != np.round(p.at[before + 1 : t])).all():
                breaks.append(before)
        limits = np.where(p.endless, [[-np.inf], [np.inf]], p.limits[:2])
        fixed = [self.fixed[0], self.fixed[1] and last == N - 1]
        unfit = unwound(q, breaks, self.wound, limits, self.ends, fixed)
        contacts = program.best(last)[1] // CONTACT if len(on) else 0
        return Found(q, tracks, breaks, int(contacts), verified), unfit

    # -------------------------------------------------------------------------------------------------------------- whole
    def run(self) -> Found:
        """Search until the path has no reconfiguration or contact, or more anchors do not help; return the path."""
        self.first_anchors()
        self.link()
        # Without the extra margin EFFORT.near, a path through a narrow passage may be free of contact.
        if self.worth() and self.model is not None:
            self.keep_away(self.model.collides)
            self.link()
        left = EFFORT.patience
        while self.worth() and left:
            worst = self.worth()
            places = [t for k in self.found.breaks for t in (k, k + 1)]
            fresh = [t for t in places if t not in self.anchored or self.problem.redundant][: 2 * EFFORT.anchors]
            if not sum(self.anchor(t, EFFORT.share) for t in fresh):
                break
            self.link()
            left = EFFORT.patience if self.worth() < worst else left - 1
        self.prove()
        return self.found

    # ------------------------------------------------------------------------------------------------------------- proof
    def prove(self) -> None:
        """Set `lower_bound` to the number of reconfigurations of the path found, if no path through the poses can have fewer.

        That is so if the number is 0, or if each solution of every pose lies on a track, and all tracks provably end where they do.
        """
        if not self.found.breaks and self.tracks.size and self.tracks.alive().all():
            self.lower_bound = 0
        if self.lower_bound == 0 or self.listing is None:
            return
        p, (Q, sure) = self.problem, self.listing
        for _ in range(EFFORT.rounds):
            missing = self.legal & ~self.known(Q)
            if not missing.any():
                break
            for j in range(Q.shape[1]):
                places = np.array([run[len(run) // 2] for run in _runs(np.flatnonzero(missing[:, j]))], dtype=int)
                self.tracks.add(p.turned(Q[places, j]), places)
            self.link()
        else:
            return
        # A pose that may lack solutions does no harm between two that have all: to use a missing one takes two reconfigurations.
        beside = np.pad(sure, 1, constant_values=True)
        known = sure | (beside[:-2] & beside[2:] & (self.tracks.alive() > 0))
        if known.all() and self.tracks.end_with_reason(lambda T: every_solution(p.single, T)):
            self.lower_bound = len(self.found.breaks)

    def list_solutions(self) -> tuple[tuple[np.ndarray, np.ndarray] | None, np.ndarray]:
        """Return all solutions of the poses and whether they are proven to be all, or None; and which keep the joint limits."""
        p = self.problem
        isolated = p.kinds == (KIND.pose,) and not counts_in_part(p.kinds, p.plan.options) and not len(p.plan.held)
        listed = every_solution(p.single, p.T) if isolated and not p.redundant else None
        if listed is None:
            return None, np.empty((0, 0), dtype=bool)
        Q = listed[0] / p.unit
        low, high = p.limits[:2] + np.array([[-ROUNDING], [ROUNDING]])
        bounded = np.isfinite(low) & ~p.robot.slides
        Q = Q + np.where(bounded, TAU * np.ceil((np.where(bounded, low, 0.0) - Q) / TAU), 0.0)
        return (Q, listed[1]), ((Q >= low) & (Q <= high)).all(axis=2)

    def known(self, Q: np.ndarray) -> np.ndarray:
        """Return whether (N, K) each of the solutions Q (N, K, n) [rad, or length / reach] lies on a track, modulo 2 pi."""
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
        """Return the cost of the path found: its reconfigurations, plus CONTACT for each pose in contact; 0 is best."""
        return self.found.contacts * CONTACT + len(self.found.breaks)

    def without(self, found: Found, steps: list[int]) -> bool:
        """Exclude steps of the path `found`, from pose k to the next for k in steps, and find the best path again.

        Returns False if there is no step to exclude.
        """
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
        """Return the requested poses for which no solution was found, with the reason."""
        said, kept = [], "" if {*self.problem.kinds} <= {KIND.position, KIND.free} else " with its orientation kept"
        for t in np.flatnonzero((self.program.state == DEAD).all(axis=1)):
            place = self.problem.at[t]
            if place != round(place):  # An inserted pose is not reported.
                continue
            beyond, reason, proven = self.anchored.get(int(t), 0.0), "no solution found", False
            if t not in self.anchored:
                reason = "not yet solved"
            elif beyond is None:
                reason = f"no room for its solutions, because a search follows at most {MOST}"
            elif beyond > 0.0:
                reason, proven = f"beyond reach by {length(beyond, 4)}{kept} (a bound from the link lengths)", True
            elif self.listing is not None and self.listing[1][t] and not self.legal[t].any():
                none, proven = np.isnan(self.listing[0][t]).all(), True
                reason = "no joint values reach it, limits or not" if none else "every solution violates a joint limit"
            said.append(Unreachable(int(place), reason, proven))
        return said
