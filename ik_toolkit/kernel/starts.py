"""Where attempts start: the nearest entries of a table of known configurations, then a reproducible random sequence.

With several tips each coordinate starts where the tip that it moves chooses.
"""

import numpy as np

from ..compile.jit import dual, inline, inner
from .counted_error import FREE, counts
from .records import WHAT, Ends, copy
from .relative import carry

SEEDS = 256  # table size: larger tables cost more to scan than they save in iterations
BEST = 8  # restarts taken from the table before random ones
FEATURES = 13  # of a configuration, see `chain.table`
PAD = 16  # keeps the feature rows from sharing one cache set
ROTATION_WEIGHT = 0.05  # of |dR|_F^2 against |dp|^2 (lengths divided by the reach)


HALF = np.uint64(32)
LOW = np.uint64(0xFFFFFFFF)


@inline
def product_64(a, b):
    """a b modulo 2^64 of two uint64, by halves: uncompiled, numpy warns of an overflow."""
    low = (a & LOW) * (b & LOW)
    cross = (((a & LOW) * (b >> HALF)) & LOW) + (((a >> HALF) * (b & LOW)) & LOW)
    return (((low >> HALF) + cross) << HALF) | (low & LOW)


@inline
def sow(state, seed):
    """Begin the random sequence of `state` (1,): it depends on the seed only, not on neighbours or the thread."""
    state[0] = np.uint64(88172645463325252) ^ product_64(np.uint64(seed), np.uint64(0x9E3779B97F4A7C15))


@inner
def nearest_seeds(feat, goal, wp, wr, score, val, best):
    """Fill `best` (BEST,) with the nearest seed of each interleaved group, nearest first.

    wp, wr in {0, 1} switch position and rotation off (targets that leave one of them free).
    """
    f = np.float32
    p0, p1, p2 = f(wp * goal[9]), f(wp * goal[10]), f(wp * goal[11])
    r0, r1, r2 = f(wr * goal[0]), f(wr * goal[1]), f(wr * goal[2])
    r3, r4, r5 = f(wr * goal[3]), f(wr * goal[4]), f(wr * goal[5])
    r6, r7, r8 = f(wr * goal[6]), f(wr * goal[7]), f(wr * goal[8])
    square = f(wp)
    for j in range(score.shape[0]):
        score[j] = (
            square * feat[12, j]
            + p0 * feat[0, j]
            + p1 * feat[1, j]
            + p2 * feat[2, j]
            + r0 * feat[3, j]
            + r1 * feat[4, j]
            + r2 * feat[5, j]
            + r3 * feat[6, j]
            + r4 * feat[7, j]
            + r5 * feat[8, j]
            + r6 * feat[9, j]
            + r7 * feat[10, j]
            + r8 * feat[11, j]
        )
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
    """Next number in [0, 1) of xorshift64*; `state` is a (1,) uint64 array."""
    x = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    return float(product_64(x, np.uint64(2685821657736338717)) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@inner
def rank_groups(p, table):
    """Best row of each tip in each interleaved group of rows, the groups in order of the sum of their scores.

    A target relative to another tip is sought where that tip's own target places it, or where that tip starts.
    """
    F = p.tasks.shape[0]
    for f in range(F):
        if int(p.tasks[f, WHAT.kind]) == FREE and int(p.tasks[f, WHAT.other]) < 0:
            p.place(f, p.desk.start)
            copy(p.poses[f], p.goals[f])
    for _ in range(F):  # a chain of them is no longer than that
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
    for k in range(BEST):  # table.best: the groups, best first
        first = 0
        for g in range(BEST):
            if table.total[g] < table.total[first]:
                first = g
        table.best[k] = first
        table.total[first] = np.inf


@inner
def begin_each_tip(p, table, k, q):
    """Each coordinate as its tip chose it; if its tip has no target, it stays where the search starts."""
    for i in range(q.shape[0]):
        f = int(p.choosers[0, i])
        if f < 0 or int(p.tasks[f, WHAT.kind]) == FREE:
            q[i] = p.desk.start[i]
        else:
            q[i] = table.seeds[table.choice[table.best[k], f], i]


@inner
def draw_some(p, table, k, q):
    """Mostly keep the tips that arrived and the shared joints: drawing all of them at once seldom gives a good start."""
    some = False
    for f in range(p.tasks.shape[0]):
        some = some or p.arrived(f)
    some = some and k % 4 > 0  # every fourth start is entirely new
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
    """Fill `moves` and `choosers` of a Tree: joints that move a free tip alone move nothing that counts, and choose no start.

    asked (F,): scratch: whether a tip takes part, because its target counts or another's is relative to it.
    """
    F, own = ends.shape[0], ends.shape[1] - n  # where the coordinates that move a tip are
    for f in range(F):
        asked[f] = 0.0
    for f in range(F):
        asked[f] = 1.0 if int(tasks[f, WHAT.kind]) != FREE else asked[f]
        if int(tasks[f, WHAT.other]) >= 0:
            asked[int(tasks[f, WHAT.other])] = 1.0
    for i in range(n):
        choosers[0, i], choosers[1, i] = -1.0, 0.0
        for f in range(F):
            moves[f, i] = 0.0
            other = int(tasks[f, WHAT.other])
            if int(tasks[f, WHAT.kind]) != FREE and (
                ends[f, own + i] > 0.0 or (other >= 0 and ends[other, own + i] > 0.0)
            ):
                moves[f, i] = 1.0
            if asked[f] > 0.0 and ends[f, own + i] > 0.0:
                choosers[1, i] += 1.0
                if choosers[0, i] < 0.0 or (
                    int(tasks[int(choosers[0, i]), WHAT.kind]) == FREE and int(tasks[f, WHAT.kind]) != FREE
                ):
                    choosers[0, i] = f
