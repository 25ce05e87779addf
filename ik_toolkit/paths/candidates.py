"""Tracks of solutions: some poses are solved from many starts, and what is found is carried along the whole path."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..kernel.path_track import extend
from .problem import Problem

MOST = 300  # tracks of a redundant robot: a state each and pose
ISOLATED = 4096  # and of one whose solutions are isolated: all of them, full turns too
STARTS = 1000  # random starts at a pose that is solved
POOL = 400  # solutions found there, of a redundant robot, among which those far from one another are chosen
SAME = 1e-3  # rad, or kernel unit: isolated solutions closer than this are one
THIN = 0.25  # of a step: tracks of a redundant robot closer than this are not worth two
CHUNK = 8  # tracks a thread carries at a time


def spread(found: np.ndarray, have: np.ndarray, count: int, least: float) -> np.ndarray:
    """At most `count` of found (M, n), each further than `least` from have (K, n) and the others, the furthest first."""
    gap = np.full(len(found), np.inf)
    joints = np.ascontiguousarray(
        found.T
    )  # the greatest of each column is found four times as fast as that of each row

    def approach(q: np.ndarray) -> None:
        np.minimum(gap, np.abs(joints - q[:, None]).max(axis=0), out=gap)

    for q in have:
        approach(q)
    chosen: list[int] = []
    while len(chosen) < min(count, len(found)):
        k = int(np.argmax(gap))
        if not gap[k] > least:
            break
        chosen.append(k)
        approach(found[k])
    return found[chosen]


class Tracks:
    """Tracks Q (N, size, n), kernel units, float32; whole from span[k, 0] to span[k, 1]."""

    def __init__(self, problem: Problem, most: int, threads: int, seed: int) -> None:
        """No track yet."""
        self.problem, self.most, self.threads = problem, most, threads
        self.rng = np.random.default_rng(seed)
        self.size = 0
        self._Q = np.zeros((len(problem.T), min(most, MOST), problem.robot.n), np.float32)
        self._span = np.zeros((most, 2), np.int64)

    Q = property(lambda self: self._Q)
    span = property(lambda self: self._span[: self.size])

    def at(self, t: int) -> np.ndarray:
        """Configurations (m, n) of the tracks that pass pose t."""
        span = self.span
        return self._Q[t, : self.size][(span[:, 0] <= t) & (t <= span[:, 1])].astype(float)

    def alive(self) -> np.ndarray:
        """How many tracks pass each pose (N,)."""
        steps = np.zeros(len(self._Q) + 1, dtype=int)
        np.add.at(steps, self.span[:, 0], 1)
        np.add.at(steps, self.span[:, 1] + 1, -1)
        return np.cumsum(steps)[:-1]

    def add(self, seeds: np.ndarray, at: np.ndarray) -> None:
        """Carry seeds (M, n), solutions of the poses at (M,), both ways, as far as there is room for tracks."""
        seeds = np.ascontiguousarray(seeds[: self.most - self.size], dtype=float)
        columns = np.arange(self.size, self.size + len(seeds))
        if self.size + len(seeds) > self._Q.shape[1]:
            more = min(self.most, max(2 * self._Q.shape[1], self.size + len(seeds))) - self._Q.shape[1]
            self._Q = np.concatenate([self._Q, np.zeros((len(self._Q), more, self._Q.shape[2]), np.float32)], axis=1)
        p, at = self.problem, np.asarray(at, dtype=np.int64)

        def carry(a: int) -> None:
            part = slice(a, a + CHUNK)
            extend(
                p.rows, p.ends, p.T, p.orders, p.room, p.most, p.deviation, seeds[part], at[part],
                columns[part], self._Q, self._span,
            )  # fmt: skip

        starts = range(0, len(seeds), CHUNK)
        if self.threads > 1 and len(starts) > 1:
            with ThreadPoolExecutor(self.threads) as pool:
                list(pool.map(carry, starts))
        else:
            for a in starts:
                carry(a)
        self.size += len(seeds)  # not before: an interrupted search goes on with those that are whole
