"""Where attempts on several tips start: each coordinate as the tip it moves chooses."""

import numpy as np

from .jit import inner
from .records import WHAT, Ends, copy
from .relative import carry
from .seeds import BEST, FEATURES, nearest, rnd
from .task import FREE, counts


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
        nearest(
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
def begin_by_tips(p, table, k, q):
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
