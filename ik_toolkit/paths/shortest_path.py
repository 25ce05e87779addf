"""The joint path with the fewest reconfigurations, and of these the cheapest, by dynamic programming.

A track is one solution continued along the poses, and a state is the configuration of a track at a pose; the states of
a pose form a layer. From one layer to the next a path stays on its track, changes to a track that is within the largest
joint step, or reconfigures: any state may follow the best state of the layer before. So only near pairs of states are
compared, not all. Collision tests are lazy: only states on the best path are tested, those in contact are penalised,
and the program is run again.
"""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from ..compile.jit import cached_small, inline, inner
from ..kernel.kinematics import TAU

# Codes for a state, which is a track (a continued solution) at a pose. DEAD: the state does not exist or violates a limit; the
# others say what is known about contact.
DEAD, UNTESTED, FREE, TOUCHING = range(4)
# The parent of a state is the track k of the state before it on the best path, or -2 - k if a reconfiguration lies between the two.
# NONE marks a state without a parent.
NONE = -1
CONTACT = 1 << 20  # A pose in contact counts as this many reconfigurations, more than any path has.
LONG = 1e3  # cost of a step longer than allowed [rad, or length / reach], more than the length of any path
# cost of a reconfiguration, besides being counted; the joint move that it takes is not part of the path and costs nothing
LEAP = 1.0


@inline
def shortest_difference(d, endless):
    """Return d, a joint value or a difference of two [rad]; if endless > 0, shifted by a multiple of 2 pi to between -pi and pi."""
    return d - TAU * np.rint(d / TAU) if endless > 0.0 and abs(d) > 0.5 * TAU else d


@inner
def step(Q, t, a, u, b, most, endless, steep, longer, enough):
    """Return the cost of the joint move from track a at pose t to track b at pose u; infinite if `enough` or more.

    Q (N, K, n): configurations of the tracks; most (n,): largest step of each joint; endless (n,): 1 for joints that count modulo 2
    pi; steep (n,): cost per square of a joint's move, besides its length; longer: cost added once if a joint moves further than
    `most`.
    """
    total, extra = 0.0, 0.0
    for i in range(most.shape[0]):
        d = abs(shortest_difference(float(Q[u, b, i]) - float(Q[t, a, i]), endless[i]))
        total += d + steep[i] * d * d
        if d > most[i]:
            extra = longer
        if total + extra >= enough:
            return np.inf
    return total + extra


@inner
def barred(blocked, t, a, b):
    """Return whether blocked (B, 3), whose rows are sorted, excludes the step from track a to track b at pose t."""
    low, high = 0, blocked.shape[0]
    while low < high:
        m = (low + high) // 2
        if (blocked[m, 0], blocked[m, 1], blocked[m, 2]) < (t, a, b):
            low = m + 1
        else:
            high = m
    return low < blocked.shape[0] and (blocked[low, 0], blocked[low, 1], blocked[low, 2]) == (t, a, b)


@inner
def window(keys, size, low):
    """Return the index of the first of the ascending keys[:size] that is not below `low`, or `size` (binary search)."""
    a, b = 0, size
    while a < b:
        m = (a + b) // 2
        if keys[m] < low:
            a = m + 1
        else:
            b = m
    return a


@inner
def read_layer(values, endless, state, counts, costs, order, near, keys):
    """List the states of one pose in ascending order of the value of one joint: tracks to `near`, joint values to `keys`.

    All arrays are (K,) and hold this pose's part of the arrays of `link_layers`; values: values of the joint; endless: whether they
    count modulo 2 pi. Returns the number of states and the one on which the best path to this pose ends (-1: none).
    """
    size, best = 0, -1
    for a in order:
        if state[a] != DEAD:
            near[size], keys[size] = a, shortest_difference(float(values[a]), endless)
            size += 1
            if best < 0 or (counts[a], costs[a], a) < (counts[best], costs[best], best):
                best = a
    return size, best


@cached_small
def link_layers(
    Q, state, prior, most, endless, steep, begin, toll, blocked, axis, order, first, counts, costs, parents
):
    """Run the dynamic program over K tracks and N poses (layers) from layer `first` on; results of earlier layers are kept.

    Q (N, K, n): configurations of the tracks [rad, or length / reach]
    state (N, K): DEAD, UNTESTED, FREE or TOUCHING; prior (N,): the last earlier pose that has states, or -1
    most (n,): largest step of each joint; endless (n,): 1 if a joint's values count modulo 2 pi
    steep (n,): cost per square of a joint's move, besides its length
    begin (2, K): reconfigurations and cost counted for starting on each track; toll (N, K): extra cost of a state
    blocked (B, 3): excluded steps, sorted; each row is the pose that the step leads to, the track before it and the track after it
    axis: index of the joint by whose value the states of a pose are sorted, so that states near a given one are found fast
    order (N, K): indices of the tracks in that order

    The results are written to three arrays. counts (N, K): number of reconfigurations on the best path to each state, where a pose
    in contact counts as CONTACT of them. costs (N, K): cost of that path. parents (N, K): the state before it, see NONE.
    """
    N, K, _ = Q.shape
    keys, near = np.empty(K), np.empty(K, np.int64)
    reach, round = most[axis], endless[axis]
    for t in range(first, N):
        last, size, best = prior[t], 0, -1
        if last >= 0:
            values = Q[last, :, axis]
            size, best = read_layer(values, round, state[last], counts[last], costs[last], order[last], near, keys)
        for b in range(K):
            parents[t, b] = NONE
            if state[t, b] == DEAD:
                continue
            count, cost, parent = int(begin[0, b]), begin[1, b], NONE
            if last >= 0:
                count, cost, parent = counts[last, best] + 1, costs[last, best] + LEAP, -2 - best
            if 0 <= last == t - 1:
                if state[last, b] != DEAD and counts[last, b] <= count:
                    c = costs[last, b] + step(Q, last, b, t, b, most, endless, steep, LONG, np.inf)
                    if (counts[last, b], c) < (count, cost) and not barred(blocked, t, b, b):
                        count, cost, parent = counts[last, b], c, b
                at = shortest_difference(float(Q[t, b, axis]), round)
                low = window(keys, size, shortest_difference(at - reach, round))
                for j in range(low, size if round == 0.0 else low + size):
                    # the sorted values of an endless joint are searched cyclically, modulo 2 pi
                    j -= size if j >= size else 0
                    if shortest_difference(keys[j] - at, round) > reach:
                        break
                    a = near[j]
                    if a == b or (counts[last, a], costs[last, a]) >= (count, cost):
                        continue
                    enough = np.inf if counts[last, a] < count else cost - costs[last, a]
                    c = costs[last, a] + step(Q, last, a, t, b, most, endless, steep, np.inf, enough)
                    if c < np.inf and (counts[last, a], c) < (count, cost) and not barred(blocked, t, a, b):
                        count, cost, parent = counts[last, a], c, a
            counts[t, b] = count + (CONTACT if state[t, b] == TOUCHING else 0)
            costs[t, b], parents[t, b] = cost + toll[t, b], parent


def sorted_tracks(values: np.ndarray, endless: float) -> np.ndarray:
    """Return the indices (N, K) that sort the values (N, K) of a joint on K tracks at each pose, see `link_layers`."""
    keys = values.astype(float)
    if endless > 0.0:
        keys = np.where(np.abs(keys) > 0.5 * TAU, keys - TAU * np.rint(keys / TAU), keys)
    return np.argsort(keys, axis=1, kind="stable").astype(np.int32)


def layers_before(state: np.ndarray) -> np.ndarray:
    """Return for each pose the last earlier one that has states, or -1 (N,); state (N, K) as for `link_layers`."""
    last = np.where((state != DEAD).any(axis=1), np.arange(len(state)), -1)
    return np.append(-1, np.maximum.accumulate(last)[:-1])


# extra cost of an untested state between two states in contact on its track, so that it is used only if nothing else is left
SUSPECT = 50.0
HITS = 4  # number of states found in contact after which the dynamic program is first run again
SAMPLED, PAIRED = 5, 64  # numbers of poses and tracks sampled to choose the joint by whose value states are sorted
COARSE = 16  # After a first contact every track is tested at every 16th pose.


class Program:
    """The dynamic program over K tracks and N poses; a track is one solution continued along the poses.

    Q (N, K, n): configurations of the tracks [rad, or length / reach], of which track k exists from pose span[k, 0] to
    span[k, 1]. state (N, K): what is known of contact (DEAD, UNTESTED, FREE, TOUCHING). begin, end (2, K): number of
    reconfigurations and cost that a path pays for beginning, or ending, on each track.
    """

    def __init__(self, Q: np.ndarray, span: np.ndarray, most: np.ndarray, endless: np.ndarray) -> None:
        """Start with every state untested; most (n,): largest steps; endless (n,): joints whose values count modulo 2 pi."""
        N, K, _ = Q.shape
        self.Q, self.span, self.most, self.endless = Q, span, most, endless.astype(float)
        t = np.arange(N)[:, None]
        self.state = np.where((t >= span[:, 0]) & (t <= span[:, 1]), UNTESTED, DEAD).astype(np.int8)
        self.begin, self.end = np.zeros((2, K)), np.zeros((2, K))
        self.toll = np.zeros((N, K), np.float32)
        self.blocked: set[tuple[int, int, int]] = set()
        self.counts, self.costs = np.zeros((N, K), np.int32), np.zeros((N, K))
        self.parents = np.full((N, K), NONE, np.int16)
        self.changed = 0  # index of the first layer (pose) whose results are out of date
        self.axis = self._telling()
        self.order = sorted_tracks(Q[:, :, self.axis], self.endless[self.axis])

    def _telling(self) -> int:
        """Return the index of the joint that separates states best: in it, the fewest sampled pairs are within the largest step."""
        N, K, n = self.Q.shape
        some = np.unique(np.linspace(0, N - 1, SAMPLED).astype(int))[:, None]
        Q = self.Q[some, np.unique(np.linspace(0, K - 1, PAIRED).astype(int))] if K else np.zeros((1, 1, n))
        d = Q[:, :, None] - Q[:, None]
        d -= self.endless * TAU * np.rint(d / TAU)
        return int(np.argmin((np.abs(d) <= self.most).mean(axis=(0, 1, 2))))

    def run(self) -> None:
        """Run the dynamic program over the layers (poses) whose results are out of date."""
        if self.changed >= len(self.Q):
            return
        blocked = np.array(sorted(self.blocked), dtype=np.int64).reshape(-1, 3)
        self.prior = layers_before(self.state)
        link_layers(
            self.Q, self.state, self.prior, self.most, self.endless, 1.0 / self.most, self.begin, self.toll, blocked, self.axis,
            self.order, self.changed, self.counts, self.costs, self.parents,
        )  # fmt: skip
        self.changed = len(self.Q)

    def mark(self, t: int, k: int, touching: bool) -> None:
        """Store that track k has been tested at pose t, and whether it is in contact there."""
        self.state[t, k] = TOUCHING if touching else FREE
        if touching:
            self.changed = min(self.changed, t)

    def best(self, t: int) -> tuple[int, int]:
        """Return the track on which the best path to pose t ends (-1: none), and its number of reconfigurations.

        Each pose in contact counts as CONTACT reconfigurations.
        """
        alive = self.state[t] != DEAD
        if not alive.any():
            return -1, 0
        last = t == len(self.Q) - 1
        counts = self.counts[t] + (self.end[0] if last else 0)
        costs = self.costs[t] + (self.end[1] if last else 0)
        k = int(np.lexsort((costs, counts, ~alive))[0])
        return k, int(counts[k])

    def path(self, t: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the track (t + 1,) of the best path at each pose up to t (-1: none), and whether (t + 1,) it reconfigures there.

        A reconfiguration is marked at the pose after it.
        """
        tracks, jumps = np.full(t + 1, -1), np.zeros(t + 1, dtype=bool)
        while t >= 0 and not (self.state[t] != DEAD).any():
            t -= 1
        k = self.best(t)[0] if t >= 0 else -1
        while t >= 0 and k >= 0:
            tracks[t] = k
            parent, t_before = int(self.parents[t, k]), int(self.prior[t])
            if t_before < 0:
                break
            jumps[t] = parent < NONE
            k, t = (-2 - parent if parent < NONE else parent), t_before
        return tracks, jumps


def middle_first(size: int) -> np.ndarray:
    """Return the indices 0 ... size - 1 in bisection order: the ends first, then the middles of the gaps, and so on."""
    if size < 1:
        return np.empty(0, dtype=int)
    step, seen, order = 1 << max(0, (size - 1).bit_length()), np.zeros(size, dtype=bool), []
    while step >= 1:
        places = np.append(np.arange(0, size, step), size - 1)
        places = places[~seen[places]]
        order.extend(dict.fromkeys(places.tolist()))
        seen[places] = True
        step //= 2
    return np.array(order)


class Tester:
    """Tests states of a Program (a track at a pose) for collision, each at most once; `left`: number of tests that remain."""

    def __init__(self, collides: Callable[[Any], bool], unit: np.ndarray, budget: int) -> None:
        """Test with the function collides(q), q (n,) [rad or m], at most `budget` times; unit (n,): size of the internal units."""
        self.collides, self.unit, self.left = collides, unit, budget
        self.program: Any = None
        # whether all tracks have been tested at every 16th pose, as `look_over` does after the first contact
        self.looked = False

    def of(self, program: Program) -> "Tester":
        """Test the states of another Program from now on, and return self; results for tracks that both programs have are kept."""
        # Two programs have the same tracks in the same columns only if they share the memory of their tracks.
        if self.program is not None and np.shares_memory(self.program.Q, program.Q):
            K = self.program.state.shape[1]
            known = self.program.state >= FREE
            program.state[:, :K][known] = self.program.state[known]
        self.program = program
        if self.looked:
            self.look_over()
        return self

    def touches(self, t: int, k: int) -> bool:
        """Return whether track k is in contact at pose t; False if that is unknown and no collision test is left."""
        p = self.program
        if p.state[t, k] == UNTESTED and self.left > 0:
            self.left -= 1
            p.mark(t, k, self.collides(p.Q[t, k].astype(float) * self.unit))
        return p.state[t, k] == TOUCHING

    def look_over(self) -> None:
        """Test every track at every COARSE-th pose for contact; states between two states in contact get the extra cost SUSPECT."""
        program, self.looked = self.program, True
        for k, (low, high) in enumerate(program.span):
            before = -1
            for t in range(low + (-low) % COARSE, high + 1, COARSE):
                touching = self.touches(t, k)
                if touching and before >= 0:
                    program.toll[before + 1 : t, k] = SUSPECT
                before = t if touching else -1
        program.changed = 0

    def grow(self, t: int, k: int) -> None:
        """Find how far contact extends along track k on both sides of pose t: by doubling steps, then by bisection.

        Untested states in that range get the extra cost SUSPECT.
        """
        p = self.program
        for way in (-1, 1):
            edge = p.span[k, 0 if way < 0 else 1]
            inside, step = t, 1
            outside = edge + way
            while inside != edge:
                following = inside + way * min(step, abs(edge - inside))
                if not self.touches(following, k):
                    outside = following
                    break
                inside, step = following, 2 * step
            while abs(outside - inside) > 1 and outside != edge + way:
                half = (inside + outside) // 2
                if self.touches(half, k):
                    inside = half
                else:
                    outside = half
            low, high = sorted((t, inside))
            unknown = p.state[low : high + 1, k] == UNTESTED
            p.toll[low : high + 1, k][unknown] = SUSPECT
            if unknown.any():
                p.changed = min(p.changed, low)


def free_path(program: Program, tester: Tester) -> tuple[np.ndarray, np.ndarray]:
    """Return the track (N,) at each pose of the best path that is tested for contact at every pose, and where it reconfigures (N,).

    -1 marks a pose without a track; a reconfiguration is marked at the pose after it. When the budget of collision tests runs out,
    the best path so far is returned.
    """
    N = len(program.Q)
    order = middle_first(N)
    # Each round looks for one contact more than the round before until the dynamic program is run again, because a run takes time.
    for most in itertools.count(HITS):
        program.run()
        tracks, jumps = program.path(N - 1)
        hits = 0
        for t in order:
            k = int(tracks[t])
            if k >= 0 and program.state[t, k] == UNTESTED:
                if tester.touches(t, k):
                    tester.grow(t, k)
                    hits += 1
                    if hits >= most:
                        break
        if hits == 0 or tester.left <= 0:
            break
        if not tester.looked:
            tester.look_over()
    return tracks, jumps
