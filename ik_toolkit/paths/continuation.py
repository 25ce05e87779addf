"""Solutions carried along a sequence of poses: from a solution of one pose to one of the next, by continuation.

A step is the least joint motion that brings the tip along (the last configuration is the prediction, the steps of
`null_space.onto_target` the correction). It counts only where the joints move less than they may and the tip, the joints
being moved in a straight line, stays by the straight line between the poses; otherwise it is halved. So what is joined here is
one motion, never two solutions that happen to be close. A track is what becomes of one solution: some poses are solved from
many starts, and each solution is continued along the whole path.
"""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..compile.jit import cached, inline, inner, spliced
from ..kernel.algebra import V3
from ..kernel.null_space import Bounds, onto_target
from ..kernel.problem import NOW
from ..kernel.records import HEAD, TASK, Orders, copy, read
from ..kernel.search import problem
from .path_problem import Problem

SHORTEST = 1.0 / 256  # share of the distance between two poses below which a step is not halved again
TURNED = 1e-12  # sine of an angle between two poses below which there is nothing to turn


@inner
def blend(flat, a, b, s, out):
    """Write to out (F, 16) the poses a share s of the way from flat[a] to flat[b] (N, F, 16): straight, and about one axis."""
    for f in range(out.shape[0]):
        A, B, C = flat[a, f], flat[b, f], out[f]
        for k in range(16):
            C[k] = A[k] + s * (B[k] - A[k])
        if s == 0.0 or s == 1.0:
            continue
        sine, cosine = V3(0.0, 0.0, 0.0), -1.0
        for k in range(3):
            x, y = V3(A[k], A[4 + k], A[8 + k]), V3(B[k], B[4 + k], B[8 + k])
            sine, cosine = sine + x.cross(y), cosine + x.dot(y)
        length = math.sqrt(sine.square())
        if length < TURNED:
            for k in range(3):
                C[k], C[4 + k], C[8 + k] = A[k], A[4 + k], A[8 + k]
            continue
        axis = sine * (1.0 / length)
        angle = s * math.atan2(length, cosine)
        c, d = math.cos(angle), math.sin(angle)
        for k in range(3):
            x = V3(A[k], A[4 + k], A[8 + k])
            x = x * c + axis.cross(x) * d + axis * (axis.dot(x) * (1.0 - c))
            C[k], C[4 + k], C[8 + k] = x.x, x.y, x.z


@inline
def within(q, old, most):
    """Whether no joint has moved further than it may."""
    for i in range(q.shape[0]):
        if not abs(q[i] - old[i]) <= most[i]:
            return False
    return True


@spliced
def advance_to_pose(p, o, weights, box, flat, pose, sheet, a, b, most, deviation, old, new):
    """Move p.desk.q from a solution of pose a to one of pose b; False where there is no continuous motion."""
    q = p.desk.q
    copy(q, old)
    done, part = 0.0, 1.0
    while done < 1.0:
        part = min(part, 1.0 - done)
        blend(flat, a, b, done + part, sheet)
        fine = p.aim(pose, o) == 0.0
        if fine:
            e = onto_target(p, weights, box, 0.0)
            fine = e.good and within(q, old, most)
        if fine:
            copy(q, new)
            for i in range(q.shape[0]):
                q[i] = 0.5 * (old[i] + new[i])
            blend(flat, a, b, done + 0.5 * part, sheet)
            p.aim(pose, o)
            e = p.evaluate(q)
            p.keep(e, NOW)
            position, rotation = p.left(NOW)
            fine = position <= deviation[0] and rotation <= deviation[1]
        if fine:
            copy(new, q)
            copy(new, old)
            done += part
            part *= 2.0
        else:
            copy(old, q)
            part *= 0.5
            if part < SHORTEST:
                return False
    return True


@cached
def carry_along(rows, ends, T, orders, limits, most, deviation, seeds, at, columns, Q, span):
    """Carry seeds (M, n), solutions of the poses at (M,), along all poses T (N, 4, 4) or (N, F, 4, 4), both ways.

    Kernel units throughout: limits (3, n) lower, upper, whether there are both; most (n,): largest step of a joint.
    deviation (2,) [m], [rad]: of the tip between poses. Track m goes to Q[:, columns[m]] (N, K, n), the first and the last pose
    it reaches to span[columns[m]].
    """
    n, N = seeds.shape[1], T.shape[0]
    o = read(Orders, orders)
    first = HEAD + TASK * (ends.size // ends.shape[-1])
    p = problem(rows, ends, orders[HEAD:first], n, o)
    weights = orders[first : first + n]
    box = Bounds(limits)
    flat = T.reshape(N, T[0].size // 16, 16)
    pose = np.empty_like(T[0])
    sheet = pose.reshape(T[0].size // 16, 16)
    old, new = np.empty(n), np.empty(n)
    q = p.desk.q
    for m in range(seeds.shape[0]):
        start, k = at[m], columns[m]
        span[k, 0], span[k, 1] = start, start
        for way in (-1, 1):
            copy(seeds[m], q)
            t = start
            while 0 <= t + way < N:
                if not advance_to_pose(p, o, weights, box, flat, pose, sheet, t, t + way, most, deviation, old, new):
                    break
                t += way
                for i in range(n):
                    Q[t, k, i] = q[i]
            span[k, 0 if way < 0 else 1] = t
        for i in range(n):
            Q[start, k, i] = seeds[m, i]


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
            carry_along(
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
