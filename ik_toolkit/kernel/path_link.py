"""The path through tracks of solutions with the fewest reconfigurations, and of these the cheapest: a dynamic program.

A state is a track at a pose. From one pose to the next a path stays on its track, changes to one within reach of a step, or
reconfigures: to any state at all, from the best of the pose before. So a layer costs the near pairs, not all pairs.
"""

import numpy as np

from .jit import cached, inline, inner
from .kinematics import TAU

DEAD, UNTESTED, FREE, TOUCHING = range(4)  # what is known of a state
NONE = -1  # no parent; below that -2 - parent: a reconfiguration
CONTACT = 1 << 20  # a pose in contact counts as this many reconfigurations: any number of them is better


@inline
def turned(d, endless):
    """A coordinate, or a difference of two; of an endless joint without full turns."""
    return d - TAU * np.rint(d / TAU) if endless > 0.0 and abs(d) > 0.5 * TAU else d


@inner
def step(Q, t, a, u, b, most, endless, price, near, enough):
    """Cost of moving from state a to b; inf where that is `enough` or more.

    Where these are not near states (near > 0), a joint moves further than it may.
    """
    total, over = 0.0, 0.0
    for i in range(most.shape[0]):
        d = abs(turned(float(Q[u, b, i]) - float(Q[t, a, i]), endless[i]))
        if d > most[i]:
            if near > 0:
                return np.inf
            over = 1.0
        total += price[0, i] * d + price[1, i] * d * d
        if total >= enough:
            return np.inf
    return total + over * price[2, 0]


@inner
def barred(blocked, low, high, a, b):
    """Whether the edge from a to b is among blocked[low:high]."""
    for k in range(low, high):
        if blocked[k, 1] == a and blocked[k, 2] == b:
            return True
    return False


@inner
def window(keys, size, low):
    """First place in keys[:size], ascending, that is not below `low`."""
    a, b = 0, size
    while a < b:
        m = (a + b) // 2
        if keys[m] < low:
            a = m + 1
        else:
            b = m
    return a


@cached
def link(Q, span, state, most, endless, price, begin, toll, blocked, axis, first, counts, costs, parents, prior):
    """Fill counts (N, K), costs (N, K), parents (N, K) and prior (N,) from layer `first` on; those before stand.

    Q (N, K, n): tracks, whole from span[k, 0] to span[k, 1]; state (N, K): DEAD, UNTESTED, FREE, TOUCHING; most (n,): largest
    step; endless (n,): 1 where full turns do not count; price (3, n): of a joint's move, of its square, and (first) of a step
    longer than it may be; begin (2, K): count and cost of starting on a track; toll (N, K): cost of a state; blocked (B, 3): edges
    (pose they lead to, from, to) that are none, by pose; axis: the joint by which near states are looked up. prior[t]
    is the layer the parents of t are in, -1 where t is the first with states; a layer without states has none.
    """
    N, K, _ = Q.shape
    keys, order = np.empty(K), np.empty(K, np.int64)
    near = np.empty(K, np.int64)
    reach, round = most[axis], endless[axis]
    last = -1
    for t in range(first):
        for k in range(K):
            if state[t, k] != DEAD:
                last = t
                break
    bar = 0
    for t in range(first, N):
        while bar < blocked.shape[0] and blocked[bar, 0] < t:
            bar += 1
        stop = bar
        while stop < blocked.shape[0] and blocked[stop, 0] == t:
            stop += 1
        prior[t] = last
        size, best = 0, -1
        if last >= 0:
            for a in range(K):
                if parents[last, a] == NONE and prior[last] >= 0:
                    continue
                if state[last, a] == DEAD:
                    continue
                near[size] = a
                size += 1
                if (
                    best < 0
                    or counts[last, a] < counts[last, best]
                    or (counts[last, a] == counts[last, best] and costs[last, a] < costs[last, best])
                ):
                    best = a
            for j in range(size):
                keys[j] = turned(float(Q[last, near[j], axis]), round)
            ranks = np.argsort(keys[:size])
            for j in range(size):
                order[j] = near[ranks[j]]
            for j in range(size):
                keys[j] = turned(float(Q[last, order[j], axis]), round)
        some = False
        for b in range(K):
            parents[t, b] = NONE
            if state[t, b] == DEAD:
                continue
            some = True
            if last < 0:
                counts[t, b], costs[t, b] = int(begin[0, b]), begin[1, b]
            else:
                count, cost, parent = counts[last, best] + 1, costs[last, best] + price[2, 1], -2 - best
                if last == t - 1:
                    if state[last, b] != DEAD and span[b, 0] < t <= span[b, 1] and counts[last, b] <= count:
                        c = costs[last, b] + step(Q, last, b, t, b, most, endless, price, 0, np.inf)
                        if counts[last, b] < count or c < cost:
                            if not barred(blocked, bar, stop, b, b):
                                count, cost, parent = counts[last, b], c, b
                    at = turned(float(Q[t, b, axis]), round)
                    low = window(keys, size, turned(at - reach, round))
                    for j in range(low, size if round == 0.0 else low + size):
                        j -= size if j >= size else 0  # on an endless joint the first comes after the last
                        if turned(keys[j] - at, round) > reach:
                            break
                        a = order[j]
                        if a == b or counts[last, a] > count or (counts[last, a] == count and costs[last, a] >= cost):
                            continue
                        enough = np.inf if counts[last, a] < count else cost - costs[last, a]
                        c = costs[last, a] + step(Q, last, a, t, b, most, endless, price, 1, enough)
                        if c < np.inf and (counts[last, a] < count or c < cost):
                            if not barred(blocked, bar, stop, a, b):
                                count, cost, parent = counts[last, a], c, a
                counts[t, b], costs[t, b], parents[t, b] = count, cost, parent
            costs[t, b] += toll[t, b]
            if state[t, b] == TOUCHING:
                counts[t, b] += CONTACT
        if some:
            last = t
        bar = stop
