"""Where attempts start: the nearest entries of a table of known configurations, then a reproducible random sequence."""

import numpy as np

from .jit import dual, inline, inner

SEEDS = 256  # table size: larger tables cost more to scan than they save in iterations
BEST = 8  # restarts taken from the table before random ones
FEATURES = 13  # of a configuration, see `chain.table`
PAD = 16  # keeps the feature rows from sharing one cache set
ROTATION_WEIGHT = 0.05  # of |dR|_F^2 against |dp|^2 (lengths divided by the reach)


HALF = np.uint64(32)
LOW = np.uint64(0xFFFFFFFF)


@inline
def product(a, b):
    """a b modulo 2^64 of two uint64, by halves: uncompiled, numpy warns of an overflow."""
    low = (a & LOW) * (b & LOW)
    cross = (((a & LOW) * (b >> HALF)) & LOW) + (((a >> HALF) * (b & LOW)) & LOW)
    return (((low >> HALF) + cross) << HALF) | (low & LOW)


@inline
def sow(state, seed):
    """Begin the random sequence of `state` (1,): it depends on the seed only, not on neighbours or the thread."""
    state[0] = np.uint64(88172645463325252) ^ product(np.uint64(seed), np.uint64(0x9E3779B97F4A7C15))


@inner
def nearest(feat, goal, wp, wr, score, val, best):
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
    return float(product(x, np.uint64(2685821657736338717)) >> np.uint64(11)) * (1.0 / 9007199254740992.0)
