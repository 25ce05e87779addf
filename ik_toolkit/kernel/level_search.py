"""The search for errors with priorities (levels): attempts until the best minimum has been found several times (see levels.py)."""

import math
from typing import NamedTuple

from ..compile.jit import compiled, inline
from .checks import CODE
from .dispatch import evaluation
from .levels import QUADRATIC
from .limits import face, held_back
from .problem import BEST_OF_ALL, NEAREST
from .records import Answer, copy
from .search import Patience, Spent, make_attempt, start_attempt

WORST = 1e300  # stands for an error that is not known yet, larger than any squared error


class Phases(NamedTuple):
    """The three ways in which an attempt may treat errors in order of priority; level 0 are those of first priority."""

    at_once: int = 0  # all errors are treated as if they had the same priority
    constrained: int = 1  # level 0 is a constraint
    out_of_reach: int = 2  # level 0 is minimised, because it is taken to be out of reach


PHASE = Phases()


@compiled
class Minimum(NamedTuple):
    """The best minimum that the attempts of a search have found so far, for errors in order of priority (levels)."""

    ee: float  # rank of its configuration, less is better, see `rank_errors`
    beside: float  # squared error of the next level after the one that `ee` measures
    agreed: int  # number of attempts that have found this minimum
    found: int  # number of the attempt that found this minimum first
    met: bool  # whether all levels are in tolerance


@inline
def rank_errors(p, e, level):
    """Return the errors e with an `ee` that orders configurations by level, and a `good` that says if all levels are in tolerance.

    If all levels above c are in tolerance and level c has the squared error v, `ee` is v / (1 + v) - c. A configuration that meets
    more levels therefore always has a smaller value, and the value is below 0 if level 0 is met. p: the problem; level: (2 F,)
    priority (0: first) of the position and of the rotation errors of each tip.
    """
    groups, top = level.shape[0], 0.0
    for g in range(groups):
        top = max(top, level[g])
    for c in range(int(top) + 1):
        value, met = 0.0, True
        for g in range(groups):
            if level[g] == c:
                one = p.group(e, g)
                value += one
                met = met and one < p.allowed(g)
        if not met:
            return p.graded(e, value / (1.0 + value) - c, False)
    return p.graded(e, -top - 1.0, True)


@inline
def next_level(p, e, level):
    """Return the squared error of the level after the one that the `ee` of `rank_errors` measures.

    p: the problem; e: errors from `rank_errors`; level: (2 F,) priority (0: first) of the position and of the rotation errors of
    each tip.
    """
    c, value = 1.0, 0.0
    while e.ee < 1.0 - c:
        c += 1.0
    for g in range(level.shape[0]):
        if level[g] == c:
            value += p.group(e, g)
    return value


@inline
def choose_phase(plain, tries, reached, near, far, excess):
    """Return how the next attempt treats errors in order of priority, a number of `Phases`.

    After some constrained attempts without success, every second attempt minimises level 0.

    Args:
        plain: How many of the first attempts treat all errors as one level.
        tries: How many attempts have been made.
        reached: Whether any attempt has met level 0.
        near: How many attempts had level 0 as a constraint.
        far: How many attempts minimised level 0.
        excess: Length by which the target is proven out of reach [arm reaches].
    """
    if tries < plain:
        return PHASE.at_once
    if excess > 0.0 or (not reached and near >= QUADRATIC.known and (near + far) % 2 == 0):
        return PHASE.out_of_reach
    return PHASE.constrained


@inline
def compare(p, e, level, best, number, job):
    """Return the better of two minima, as a `Minimum`: the best so far, and the one at which attempt `number` ended.

    If the latter is better, its q and its errors are kept. p: the problem; e: errors from `rank_errors` at the end of the attempt;
    level: (2 F,) priority (0: first) of the position and of the rotation errors of each tip; job: `SearchInput`.
    """
    beside, floor = next_level(p, e, level), math.floor(best.ee)
    share = QUADRATIC.same if best.ee < 0.0 else QUADRATIC.same_reach
    same = abs(e.ee - best.ee) <= share * (best.ee - floor + QUADRATIC.first_order)
    closer = beside < (1.0 - QUADRATIC.same) * best.beside - QUADRATIC.first_order
    if (e.ee < best.ee and not same) or (same and closer):
        copy(p.desk.q, job.closest)
        p.keep(e, NEAREST)
        return Minimum(e.ee, beside, 1, number, e.good)
    alike = same and beside <= (1.0 + QUADRATIC.same) * best.beside + QUADRATIC.first_order
    return Minimum(best.ee, best.beside, best.agreed + alike, best.found, best.met)


@inline
def search_by_levels(rule, p, job, level, plain, excess):
    """Search for errors in order of priority: make attempts until several have found the same best minimum.

    Returns the Answer, and the index of its errors in `Desk.errors`. level (2 F,): priority (0: first) of each group of errors
    (position, rotation); plain: how many of the first attempts treat all errors as one level. The other arguments are those of
    `search.search`.
    """
    o, s, attempts = job.orders, p.desk, int(job.orders.attempts)
    plain = 0 if excess > 0.0 else min(plain, attempts - 1)
    copy(s.start, job.best)
    for f in range(s.errors.shape[1]):
        s.errors[BEST_OF_ALL, f, 0], s.errors[BEST_OF_ALL, f, 1] = WORST, WORST
    s.spent[1] = o.evaluations
    spent, least, best = Spent(0, 0, 0), WORST, Minimum(WORST, WORST, 0, 0, False)
    tries, near, far, found, cut_off = 0, 0, 0, 0, 0
    while True:
        if tries == plain:
            # From here on `least` is a rank (`rank_errors`), which cannot be compared with the sums of squares of the earlier
            # attempts.
            least = WORST
        phase = choose_phase(plain, tries, least < 0.0, near, far, excess)
        s.spent[2] = float(phase)
        index = tries if phase == PHASE.at_once else near if phase == PHASE.constrained else far
        near, far = near + (phase == PHASE.constrained), far + (phase == PHASE.out_of_reach)
        patience = start_attempt(p, job, index - int(o.given), excess)
        if phase == PHASE.constrained:
            # An attempt that comes near the best minimum would end there as well, so it is ended early. If that minimum has an
            # error below QUADRATIC.small, no attempt is ended early, because it may meet the tolerance there.
            sure = best.ee < 0.0 and best.ee - math.floor(best.ee) > QUADRATIC.small
            known = QUADRATIC.near * QUADRATIC.near if sure else 0.0
            decay = QUADRATIC.decay_later if least < 0.0 else QUADRATIC.decay
            patience = Patience(patience.iterations, 16.0 if level[0] > 0.0 else 1.0, decay, known)
        elif phase == PHASE.out_of_reach:
            patience = Patience(patience.iterations, WORST, 1.0, 0.0)
        before = least
        status, e, least, spent = make_attempt(rule, p, job, patience, True, spent, least, tries)
        found = tries if least < before else found
        cut_off += status == CODE.iteration_limit
        if status == CODE.converged:
            best = compare(p, e, level, best, tries, job)
        elif status == CODE.known:
            best = Minimum(best.ee, best.beside, best.agreed + 1, best.found, best.met)
        tries += 1
        enough = best.agreed >= (QUADRATIC.agree if best.ee < 0.0 else QUADRATIC.agree_reach)
        enough = enough or (best.ee < 0.0 and near + far >= QUADRATIC.most)
        if best.met or enough or tries >= attempts or spent.evaluations >= o.evaluations:
            break
    if best.agreed == 0:
        best = Minimum(WORST, WORST, 0, found, False)
    return conclude_by_levels(rule, p, job, best, least < 0.0, spent, tries, cut_off, excess)


@inline
def conclude_by_levels(rule, p, job, best, reached, spent, tries, cut_off, excess):
    """Put the answer of `search_by_levels` into p.desk.q, each joint shifted by 2 pi k to be nearest the start.

    Returns the Answer, and the index of its errors in `Desk.errors`.

    Args:
        rule: The solver rule.
        p: The problem.
        job: The arrays of the search, as `SearchInput`.
        best: The best `Minimum`.
        reached: Whether any attempt met level 0, so that joint limits do not block it.
        spent: Counts of the whole search, as `Spent`.
        tries: How many attempts were made.
        cut_off: How many of them ended at the iteration limit.
        excess: Length by which the target is proven out of reach [arm reaches].
    """
    o, s, q = job.orders, p.desk, p.desk.q
    answer, place = (job.closest, NEAREST) if best.agreed > 0 else (job.best, BEST_OF_ALL)
    copy(answer, q)
    limits, evaluations, held = o.limits > 0.0, spent.evaluations, -1
    status = CODE.stalled
    if best.ee < 0.0 or best.met:
        status = CODE.converged
    elif excess > 0.0:
        status = CODE.unreachable
    elif spent.evaluations >= o.evaluations or cut_off == tries:
        status = CODE.iteration_limit
    elif o.follow > 0.0:
        e = p.evaluate(q)
        p.jacobian(e)
        evaluations += 1
        held = held_back(p, e, job.near, job.box, limits)
        status = CODE.too_far if held >= 0 else CODE.stalled
    elif limits and not reached:
        for i in range(q.shape[0]):
            if q[i] <= job.near.lower(i) or q[i] >= job.near.upper(i):
                status = CODE.limit_blocked
    affordable = evaluations < o.evaluations
    if affordable and limits and not o.follow > 0.0 and face(q, s.start, job.box):
        s.spent[2] = float(PHASE.constrained)
        e = evaluation(rule, p, q)
        evaluations += 1
        # Rounding in the shift by 2 pi has brought the error above a tolerance.
        if status == CODE.converged and not e.ee < 0.0:
            copy(answer, q)
        else:
            p.keep(e, place)
    position, rotation = p.left(place)
    return Answer(
        float(status), float(spent.steps), float(tries - 1), position, rotation, float(evaluations),
        float(spent.noted), excess * job.box.scale(), float(best.found), float(held), float(best.agreed),
    ), place  # fmt: skip
