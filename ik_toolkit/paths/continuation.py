"""Numerical continuation: a solution of one pose is followed from pose to pose along the path.

Each step takes the last configuration as its start and corrects it to the next pose with the least joint motion
(`null_space.onto_target`). A step is accepted only if no joint moves further than its largest step, and if the tip, halfway along
the straight joint motion, stays near the interpolated pose; otherwise the step is halved. So two solutions that are merely close
are never joined. One solution followed along the path is called a track.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from ..compile.array_view import cut, flat, keep, space, view
from ..compile.jit import cached_small, inline, inner, spliced
from ..kernel.algebra import V3
from ..kernel.kinematics import TAU
from ..kernel.null_space import Bounds, onto_target, stated_problem
from ..kernel.problem import NOW
from ..kernel.records import Array, copy
from ..motion.reference import interpolate_poses
from .path_problem import Problem

SHORTEST = 1.0 / 256  # smallest step, as a share of the distance between two poses; below it continuation stops
TURNED = 1e-12  # two rotations count as equal if the sine of the angle between them is below this


@inner
def blend(begin, end, s, out):
    """Write to out (16 F,) the poses at the share s (0 to 1) of the way from the poses `begin` (16 F,) to `end`.

    Positions lie on the straight line, rotations on the geodesic. 16 numbers are a 4 x 4 matrix, row by row.
    """
    for f in range(0, out.shape[0], 16):
        A, B, C = begin[f : f + 16], end[f : f + 16], out[f : f + 16]
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
    """Return whether no joint moved further from `old` to q (n,) than its largest step `most` (n,)."""
    for i in range(q.shape[0]):
        if not abs(q[i] - old[i]) <= most[i]:
            return False
    return True


class PathBounds(NamedTuple):
    """A path along which solutions are continued, and the bounds that they must keep, see `carry_along`."""

    T: Array  # (N, 4, 4) or (N, F, 4, 4) the path's poses
    pose: Array  # scratch: one pose of the path
    box: Bounds
    most: Array  # (n,) largest step of each joint
    deviation: Array  # (2,) how far [m], [rad] a tip may leave the interpolated pose


@spliced
def advance_to_pose(p, o, weights, path, t, u, last, old, new):
    """Continue a solution of pose number t, in p.desk.q, to a solution of pose u, in steps that are halved where they fail.

    If the whole step fails, it is first tried again from the configuration to which the motion from `last` to q would lead. The
    motion then keeps its direction through a singular pose, where the solution nearest to q may turn back.

    p, o: the compiled problem and its options (Orders); weights (n,): joint weights; path: see `PathBounds`; last (n,): the
    solution of the pose before t, or p.desk.q itself if there is none. old (n,) and new (n,) are scratch. Returns False if no
    continuous motion was found.
    """
    q, pose, deviation = p.desk.q, path.pose, path.deviation
    a, b = flat(path.T[t]), flat(path.T[u])
    copy(q, old)
    done, part, onwards = 0.0, 1.0, False
    while done < 1.0:
        part = min(part, 1.0 - done)
        if onwards:
            for i in range(q.shape[0]):
                q[i] = min(max(2.0 * old[i] - last[i], path.box.lower(i)), path.box.upper(i))
        blend(a, b, done + part, flat(pose))
        fine = p.aim(pose, o) == 0.0
        if fine:
            e = onto_target(p, weights, path.box, 0.0)
            fine = e.good and within(q, old, path.most)
        if fine:
            copy(q, new)
            for i in range(q.shape[0]):
                q[i] = 0.5 * (old[i] + new[i])
            blend(a, b, done + 0.5 * part, flat(pose))
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
            onwards = part == 1.0 and not onwards
            part *= 1.0 if onwards else 0.5
            if part < SHORTEST:
                return False
    return True


@cached_small
def carry_along(rows, ends, T, orders, limits, most, deviation, seeds, at, columns, Q, span):
    """Continue the solutions `seeds` (M, n) of the poses numbered `at` (M,) towards both ends of the path.

    Each solution is followed as far as it goes. Joint values are in rad, or lengths / reach. rows, ends, orders: the robot
    and the options as arrays, from a Plan with one attempt; T (N, 4, 4) or (N, F, 4, 4): the poses; limits (3, n): lower limit,
    upper limit, and 1 where both are finite; most (n,): largest step of each joint from pose to pose; deviation (2,): how far [m],
    [rad] a tip may leave the interpolated pose halfway between two poses.

    Writes the configurations to which solution m leads to Q[:, columns[m]] (N, n), and the numbers of the first and last pose that
    it reaches to span[columns[m]].
    """
    n, tips = seeds.shape[1], ends.size // ends.shape[-1]
    block, pose = np.empty(space(n, 6 * tips, rows.shape[0], 0)), np.empty_like(T[0])
    path = PathBounds(view(T), view(pose), Bounds(view(limits)), view(most), view(deviation))
    tracks = view(seeds), view(at), view(columns), view(Q), view(span)
    carry_on_views(view(rows), view(ends), view(orders), path, tracks, view(block))
    keep(block)
    keep(pose)


@inline
def carry_on_views(rows, ends, orders, path, tracks, block):
    """Follow each solution from pose to pose, as `carry_along` does, on arrays given as views; block: scratch memory."""
    seeds, at, columns, Q, span = tracks
    n, N = seeds.shape[1], path.T.shape[0]
    p, o, weights = stated_problem(block, rows, ends, orders, n)
    old, new = cut(block, np.float64, (n, n))
    q = p.desk.q
    for m in range(seeds.shape[0]):
        start, k = at[m], columns[m]
        span[k, 0], span[k, 1] = start, start
        for i in range(n):
            Q[start, k, i] = seeds[m, i]
        for way in (-1, 1):
            copy(seeds[m], q)
            t = start
            while 0 <= t + way < N:
                last = Q[t if t == start else t - way, k]
                if not advance_to_pose(p, o, weights, path, t, t + way, last, old, new):
                    break
                t += way
                for i in range(n):
                    Q[t, k, i] = q[i]
            span[k, 0 if way < 0 else 1] = t


MOST = 4096  # largest number of tracks (continued solutions), to bound time and memory
STARTS = 1000  # number of random starts from which a pose is solved
POOL = 400  # number of solutions of a redundant robot from which widely spaced ones are chosen
SAME = 1e-3  # Solutions count as the same if all their joints differ by less [rad, or length / reach].
THIN = 0.25  # least distance of a new track of a redundant robot from the others, as a share of the largest joint step
CHUNK = 8  # number of tracks that a thread continues in one task


def spread(found: np.ndarray, have: np.ndarray, count: int, least: float) -> np.ndarray:
    """Choose at most `count` widely spaced configurations of found (M, n) and return them, (K, n).

    Each choice is the configuration farthest from those in `have` (K, n) and those already chosen, if its distance (the largest
    difference of a joint) is above `least`.
    """
    gap = np.full(len(found), np.inf)
    joints = np.ascontiguousarray(found.T)  # NumPy takes a maximum over the first axis faster than one over the last.

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
    """Solutions continued along the N poses of a path, called tracks.

    Q (N, size or more, n) [rad, or length / reach; float32] holds their configurations; track k exists from pose number
    span[k, 0] to pose span[k, 1] inclusive. `size` is the number of tracks.
    """

    def __init__(self, problem: Problem, threads: int, seed: int) -> None:
        """Start without tracks; seed: number that fixes the random starts."""
        self.problem, self.threads = problem, threads
        self.rng = np.random.default_rng(seed)
        self.size = 0
        self._Q = np.zeros((len(problem.T), 64, problem.robot.n), np.float32)
        self._span = np.zeros((MOST, 2), np.int64)

    Q = property(lambda self: self._Q)
    span = property(lambda self: self._span[: self.size])

    def at(self, t: int) -> np.ndarray:
        """Return the configurations (m, n) [rad, or length / reach] at pose number t of all tracks that exist there."""
        span = self.span
        return self._Q[t, : self.size][(span[:, 0] <= t) & (t <= span[:, 1])].astype(float)

    def alive(self) -> np.ndarray:
        """Return the number of tracks that exist at each pose (N,)."""
        steps = np.zeros(len(self._Q) + 1, dtype=int)
        np.add.at(steps, self.span[:, 0], 1)
        np.add.at(steps, self.span[:, 1] + 1, -1)
        return np.cumsum(steps)[:-1]

    def end_with_reason(self, listed: Callable[[np.ndarray], Any]) -> bool:
        """Return whether each track that ends between two poses must end there: at a limit, or where the solution vanishes (fold).

        Each such track is continued towards the pose that it does not reach, in small parts of the way. One part beyond its end,
        there must be no solution within the limits and the largest joint step. `listed` lists all solutions of poses, as does
        `exact_branches.every_solution`.
        """
        p, N, parts = self.problem, len(self.problem.T), int(0.25 / SHORTEST)
        ends, poses = [], []
        for k, t in ((k, int(t)) for k, span in enumerate(self.span) for t in span):
            for way in (-1, 1):
                if t != self.span[k, (way + 1) // 2] or not 0 <= t + way < N:
                    continue
                T = interpolate_poses(p.poses[[t, t + way]], np.arange(parts + 1.0) / parts, p.kinds).reshape(
                    -1, *p.T.shape[1:]
                )
                Q, span = np.zeros((parts + 1, 1, p.robot.n), np.float32), np.zeros((1, 2), np.int64)
                start = self._Q[t, k].astype(float)[None]
                zero = np.zeros(1, dtype=np.int64)
                carry_along(p.rows, p.ends, T, p.orders, p.room, p.most, p.deviation, start, zero, zero, Q, span)
                if span[0, 1] == parts:
                    return False
                ends.append(Q[span[0, 1], 0])
                poses.append(T[span[0, 1] + 1])
        if not ends:
            return True
        Q, sure = listed(np.array(poses))
        near = Q / p.unit - np.array(ends)[:, None]
        near -= np.where(p.robot.slides, 0.0, TAU * np.rint(near / TAU))
        next_to = near + np.array(ends)[:, None]
        legal = ((next_to >= p.room[0]) & (next_to <= p.room[1])).all(axis=2)
        return bool(sure.all() and not (legal & (np.abs(near) <= p.most).all(axis=2)).any())

    def add(self, seeds: np.ndarray, at: np.ndarray) -> None:
        """Start a track from each of the solutions `seeds` (M, n) [rad, or length / reach] at the poses numbered `at` (M,).

        Each solution is continued along the path in both directions. Seeds beyond the largest number of tracks are dropped.
        """
        seeds = np.ascontiguousarray(seeds[: MOST - self.size], dtype=float)
        columns = np.arange(self.size, self.size + len(seeds))
        if self.size + len(seeds) > self._Q.shape[1]:
            more = min(MOST, max(2 * self._Q.shape[1], self.size + len(seeds))) - self._Q.shape[1]
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
        self.size += len(seeds)  # The size grows only now, so that an interrupted search keeps only finished tracks.
