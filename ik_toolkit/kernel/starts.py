"""Where attempts start: first at the nearest entries of a table of precomputed configurations, then at reproducible random ones.

With several tips, one of the tips that a coordinate moves chooses where the coordinate starts.
"""

from typing import NamedTuple

import numpy as np

from ..compile.array_view import cut
from ..compile.jit import compiled, dual, inline, inner
from .counted_error import KIND, counts
from .records import WHAT, Array, Ends, copy
from .relative import carry

# number of precomputed configurations to start from; scanning more takes more time than it saves in iterations
SEEDS = 256
BEST = 8  # number of attempts that start from precomputed configurations before random ones
# how many numbers describe the tip pose of a precomputed start, by which it is compared with a target, see `chain.table`
FEATURES = 13
# unused columns in the table of starts; without them its rows would compete for the same lines of the processor's cache
PAD = 16


class DistanceWeights(NamedTuple):
    """Weights of the terms in the squared distance of a configuration from a target.

    The squared position error (in units of the arm's reach) has weight 1. The values were chosen by hand, not derived.
    """

    rotation: float = 0.05  # weight of the squared difference of the rotation matrices (Frobenius norm)
    # weight of |q - home|^2, for one tip: of configurations almost equally far from the target, the one nearest home is taken
    from_home: float = 0.01


DISTANCE = DistanceWeights()


def known_configurations(low: np.ndarray, high: np.ndarray, home: np.ndarray, count: int) -> np.ndarray:
    """Return random configurations (count, n) from which attempts start, between `low` and `high` (n,) [rad or arm reaches].

    Half of the configurations are moved halfway towards `home` (n,), because people expect answers near home. Blocks of BEST rows
    are moved and not moved in turn, so half of each group of `nearest_seeds` is. The seed is uncommon, so that no target that a
    user draws with default_rng(1) is in the table by accident.
    """
    seeds = np.random.default_rng(0x5EED7AB1E).uniform(low, high, (count, len(low)))
    near = np.arange(count) // BEST % 2 == 0
    seeds[near] = 0.5 * (seeds[near] + home)
    return seeds


@compiled
class StartTable(NamedTuple):
    """Precomputed configurations that attempts start from, and scratch arrays to rank them for a target."""

    seeds: Array  # (N, n) the precomputed configurations
    # (FEATURES * tips, N + PAD) numbers by which the configurations are compared with a target, see `chain.table`. Configurations
    # whose indices differ by multiples of BEST form a group; the nearest one of each group is a start.
    features: Array
    score: Array  # (N,) squared distance of each configuration from the target
    val: Array  # (BEST,) squared distance of the nearest configuration of each group, in the order of `best`
    best: Array  # (BEST,) the rows to start from (for one tip) or the groups to start from (for several tips), nearest first
    choice: Array  # (BEST, tips) for each group and tip, the row of the table nearest the tip's target
    total: Array  # (BEST,) sum of the tips' least distances in each group
    state: Array  # (1,) state of the random sequence from which later starts are drawn


@inline
def make_table(block, seeds, features, tips):
    """Return a StartTable for a number of tips, with its scratch arrays cut from the memory `block`."""
    score, val = cut(block, np.float32, (seeds.shape[0], BEST))
    best, choice = cut(block, np.int64, (BEST, (BEST, tips)))
    (total,) = cut(block, np.float64, (BEST,))
    (state,) = cut(block, np.uint64, (1,))
    return StartTable(seeds, features, score, val, best, choice, total, state)


@inline
def product_64(a, b):
    """Return the product of two uint64 modulo 2^64, computed in halves, because numpy warns where a product overflows."""
    half, low_bits = np.uint64(32), np.uint64(0xFFFFFFFF)
    low = (a & low_bits) * (b & low_bits)
    cross = (((a & low_bits) * (b >> half)) & low_bits) + (((a >> half) * (b & low_bits)) & low_bits)
    return (((low >> half) + cross) << half) | (low & low_bits)


@inline
def seed_sequence(state, seed):
    """Start a sequence of random numbers from a seed; its state is an array (1,).

    The sequence depends on nothing else, such as other targets or the thread.
    """
    state[0] = np.uint64(88172645463325252) ^ product_64(np.uint64(seed), np.uint64(0x9E3779B97F4A7C15))


@inner
def nearest_seeds(feat, goal, wp, wr, score, val, best):
    """Find the precomputed starts nearest to a target: the nearest one in each of BEST groups, written to best (BEST,) in order.

    Group b has the rows b, b + BEST, b + 2 BEST and so on. feat: (FEATURES, N + PAD) features of the rows, see `chain.table`; goal:
    (GOAL,) target; wp and wr are 0 if the target leaves position or rotation free, else 1. score (N,) and val (BEST,) are scratch.
    """
    f = np.float32
    p0, p1, p2 = f(wp * goal[9]), f(wp * goal[10]), f(wp * goal[11])
    r0, r1, r2 = f(wr * goal[0]), f(wr * goal[1]), f(wr * goal[2])
    r3, r4, r5 = f(wr * goal[3]), f(wr * goal[4]), f(wr * goal[5])
    r6, r7, r8 = f(wr * goal[6]), f(wr * goal[7]), f(wr * goal[8])
    square = f(wp)
    for j in range(score.shape[0]):
        score[j] = (
            square * feat[12, j] + p0 * feat[0, j] + p1 * feat[1, j] + p2 * feat[2, j]
            + r0 * feat[3, j] + r1 * feat[4, j] + r2 * feat[5, j]
            + r3 * feat[6, j] + r4 * feat[7, j] + r5 * feat[8, j]
            + r6 * feat[9, j] + r7 * feat[10, j] + r8 * feat[11, j]
        )  # fmt: skip
    for b in range(BEST):
        val[b] = f(1e30)
        best[b] = 0
    for j in range(0, score.shape[0], BEST):
        for b in range(BEST):
            s = score[j + b]
            less = s < val[b]
            val[b] = s if less else val[b]
            best[b] = j + b if less else best[b]
    for i in range(1, BEST):
        s = val[i]
        k = best[i]
        j = i
        while j > 0 and val[j - 1] > s:
            val[j] = val[j - 1]
            best[j] = best[j - 1]
            j -= 1
        val[j] = s
        best[j] = k


@dual
def rnd(state):
    """Return the next random number in [0, 1) by xorshift64*, whose state is an array (1,) of uint64."""
    x = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    return float(product_64(x, np.uint64(2685821657736338717)) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@inner
def rank_groups(p, table):
    """Choose starts for a robot with several tips: in each group of the table, the configuration nearest each tip's target.

    The groups are then sorted by the sum of the tips' distances. A target relative to another tip is placed as if the other tip
    were at its own target, or else at its start. p: the TreeProblem; table: `StartTable`, whose arrays `best` and `choice` receive
    the result.
    """
    F = p.tasks.shape[0]
    for f in range(F):
        if int(p.tasks[f, WHAT.kind]) == KIND.free and int(p.tasks[f, WHAT.other]) < 0:
            p.place(f, p.desk.start)
            copy(p.poses[f], p.goals[f])
    # The tip that a target is relative to may have a relative target as well, so placing all targets takes up to F passes.
    for _ in range(F):
        for f in range(F):
            other = int(p.tasks[f, WHAT.other])
            if other >= 0:
                copy(p.goals[other], p.poses[other])
                carry(p.poses[other], p.links[f], p.goals[f])
    for g in range(BEST):
        table.total[g] = 0.0
    for f in range(F):
        wp, wr = counts(p.tasks[f])
        nearest_seeds(
            table.features[FEATURES * f : FEATURES * (f + 1)], p.goals[f], wp, wr, table.score, table.val, table.best
        )
        for k in range(BEST):
            g = table.best[k] % BEST
            table.choice[g, f] = table.best[k]
            table.total[g] += table.val[k]
    for k in range(BEST):  # table.best becomes the list of groups, the one with the least total distance first.
        first = 0
        for g in range(BEST):
            if table.total[g] < table.total[first]:
                first = g
        table.best[k] = first
        table.total[first] = np.inf


@inner
def begin_each_tip(p, table, k, q):
    """Set q (n,) to precomputed start k of several tips: each joint has its value in the configuration chosen for its tip.

    Joints of a tip without a target start at q0 or home. p: the TreeProblem; table: `StartTable`, sorted by `rank_groups`.
    """
    for i in range(q.shape[0]):
        f = int(p.choosers[0, i])
        if f < 0 or int(p.tasks[f, WHAT.kind]) == KIND.free:
            q[i] = p.desk.start[i]
        else:
            q[i] = table.seeds[table.choice[table.best[k], f], i]


@inner
def draw_some(p, table, k, q):
    """Set q (n,) to random start k of a robot with several tips.

    If any tip has reached its target, shared joints and the joints of such tips mostly keep their values, because to draw all
    joints at once seldom gives a good start for all tips. p: the TreeProblem; table: `StartTable`.
    """
    some = False
    for f in range(p.tasks.shape[0]):
        some = some or p.arrived(f)
    some = some and k % 4 > 0  # Every fourth random start draws all joints again, even if some tips have arrived.
    ends = Ends(p.ends[0], p.desk.q.shape[0])
    for i in range(q.shape[0]):
        a = ends.low(i) + ends.span(i) * rnd(table.state)
        f = int(p.choosers[0, i])
        if f < 0:
            q[i] = p.desk.start[i]
        elif not (some and (p.choosers[1, i] > 1.0 or p.arrived(f))):
            q[i] = a


@inner
def choose_moves(ends, tasks, n, asked, moves, choosers):
    """Write which coordinates change errors of which tip (`moves`), and which tip chooses where each starts (`choosers`).

    Both arrays are explained at `tree.TreeProblem`. Coordinates that only move tips without a target are in neither. ends: a row
    for each tip; tasks: (F, SIZE.task); n: number of coordinates; asked (F,) is scratch: 1 if a tip takes part, because it has a
    target or another tip's target is relative to it.
    """
    # The last n numbers in a tip's row of `ends` flag the coordinates that move it.
    F, own = ends.shape[0], ends.shape[1] - n
    for f in range(F):
        asked[f] = 0.0
    for f in range(F):
        asked[f] = 1.0 if int(tasks[f, WHAT.kind]) != KIND.free else asked[f]
        if int(tasks[f, WHAT.other]) >= 0:
            asked[int(tasks[f, WHAT.other])] = 1.0
    for i in range(n):
        choosers[0, i], choosers[1, i] = -1.0, 0.0
        for f in range(F):
            moves[f, i] = 0.0
            other = int(tasks[f, WHAT.other])
            if int(tasks[f, WHAT.kind]) != KIND.free and (
                ends[f, own + i] > 0.0 or (other >= 0 and ends[other, own + i] > 0.0)
            ):
                moves[f, i] = 1.0
            if asked[f] > 0.0 and ends[f, own + i] > 0.0:
                choosers[1, i] += 1.0
                if choosers[0, i] < 0.0 or (
                    int(tasks[int(choosers[0, i]), WHAT.kind]) == KIND.free and int(tasks[f, WHAT.kind]) != KIND.free
                ):
                    choosers[0, i] = f
