"""Tracks of solutions: some poses are solved from many starts, and each solution is continued along the whole path."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..kernel.path_track import extend
from .problem import Problem

MOST = 300  # most tracks of a redundant robot: one state per track and pose
ISOLATED = 4096  # most tracks of a robot with isolated solutions: all of them, including full turns
STARTS = 1000  # random starts at a pose that is solved
POOL = 400  # solutions of a redundant robot from which well-spaced ones are chosen
SAME = 1e-3  # rad, or kernel unit: isolated solutions closer than this are the same
THIN = 0.25  # share of a step: tracks of a redundant robot closer than this are not both kept
CHUNK = 8  # tracks a thread extends at a time


def spread(found: np.ndarray, have: np.ndarray, count: int, least: float) -> np.ndarray:
    """At most `count` of found (M, n), each farther than `least` from have (K, n) and from one another, the farthest first."""
    gap = np.full(len(found), np.inf)
    joints = np.ascontiguousarray(found.T)  # the maximum over columns is four times as fast as over rows

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
    """Tracks Q (N, size, n), kernel units, float32; track k is valid from span[k, 0] to span[k, 1]."""

    def __init__(self, problem: Problem, most: int, threads: int, seed: int) -> None:
        """Start without tracks."""
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
        """Number of tracks that pass each pose (N,)."""
        steps = np.zeros(len(self._Q) + 1, dtype=int)
        np.add.at(steps, self.span[:, 0], 1)
        np.add.at(steps, self.span[:, 1] + 1, -1)
        return np.cumsum(steps)[:-1]

    def add(self, seeds: np.ndarray, at: np.ndarray) -> None:
        """Extend seeds (M, n), solutions of the poses `at` (M,), in both directions, as long as there is room for tracks."""
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
        self.size += len(seeds)  # only now, so that an interrupted search keeps only finished tracks
