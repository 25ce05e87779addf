"""The search of a rule with levels: attempts until the best minimum has been found several times (see levels.py)."""

from ..compile.jit import inline
from .checks import CONVERGED, ITERATION_LIMIT, LIMIT_BLOCKED, STALLED, TOO_FAR, UNREACHABLE
from .levels import QUADRATIC, agrees, evaluation
from .limits import face, held_back
from .problem import BEST_OF_ALL, NEAREST
from .records import Answer, copy
from .search import Patience, Spent, make_attempt, start_attempt

# What an attempt does: all errors at one level, level 0 as a constraint, or level 0 minimised because it is out of reach.
PLAIN, CONSTRAINED, OUT_OF_REACH = range(3)


@inline
def next_level(p, e, level):
    """Return the squared error of the level after the first that is not in tolerance (rank_errors tells that one)."""
    c, value = 1.0, 0.0
    while e.ee < 1.0 - c:
        c += 1.0
    for g in range(level.shape[0]):
        if level[g] == c:
            value += p.group(e, g)
    return value


@inline
def search_by_levels(rule, p, job, level, plain, excess):
    """Make attempts until the best minimum was found QUADRATIC.agree times, and return the Answer and the index of its errors.

    level (2 F,): level of each group of errors; plain: number of attempts with all errors at one level that come first.
    The rest is as for `search.search`.
    """
    o, q, start, s = job.orders, p.desk.q, p.desk.start, p.desk
    given, attempts = int(o.given), int(o.attempts)
    plain = 0 if excess > 0.0 else min(plain, attempts - 1)
    copy(start, job.best)
    for f in range(s.errors.shape[1]):
        s.errors[BEST_OF_ALL, f, 0], s.errors[BEST_OF_ALL, f, 1] = 1e300, 1e300
    s.spent[1] = o.evaluations
    spent, least, best, second = Spent(0, 0, 0), 1e300, 1e300, 1e300
    tries, near, far, agreed, found, cut_off, place, met = 0, 0, 0, 0, 0, 0, BEST_OF_ALL, False
    while True:
        index, phase = tries, PLAIN
        if tries >= plain:
            least = 1e300 if tries == plain else least
            missed = least >= 0.0 and near >= QUADRATIC.known
            phase = OUT_OF_REACH if excess > 0.0 or (missed and (near + far) % 2 == 0) else CONSTRAINED
            index = far if phase == OUT_OF_REACH else near
            far, near = far + (phase == OUT_OF_REACH), near + (phase == CONSTRAINED)
        s.spent[2] = float(phase)
        patience = start_attempt(p, job, index - given, excess)
        if phase == CONSTRAINED:
            patience = Patience(patience.iterations, 16.0 if level[0] > 0.0 else 1.0, QUADRATIC.decay)
        elif phase == OUT_OF_REACH:
            patience = Patience(patience.iterations, 1e300, 1.0)
        before = least
        status, e, least, spent = make_attempt(rule, p, job, patience, True, spent, least, tries)
        if place == BEST_OF_ALL and least < before:
            found = tries
        tries += 1
        cut_off += status == ITERATION_LIMIT
        if status == CONVERGED:
            met, beside = e.good, next_level(p, e, level)
            same = agrees(e.ee, best)
            closer = beside < (1.0 - QUADRATIC.same) * second - QUADRATIC.first_order
            if (e.ee < best and not same) or (same and closer):
                agreed, second = 0, 1e300
            if agreed == 0 or (same and not beside > (1.0 + QUADRATIC.same) * second + QUADRATIC.first_order):
                agreed += 1
                if e.ee < best or closer:
                    best, second, place, found = min(e.ee, best), min(second, beside), NEAREST, tries - 1
                    copy(q, job.closest)
                    p.keep(e, NEAREST)
        enough = QUADRATIC.agree if best < 0.0 else QUADRATIC.agree_reach
        if met or agreed >= enough or tries >= attempts or spent.evaluations >= o.evaluations:
            break
    answer = job.best if place == BEST_OF_ALL else job.closest
    copy(answer, q)
    if best < 0.0 or met:
        status = CONVERGED
    elif excess > 0.0:
        status = UNREACHABLE
    elif spent.evaluations >= o.evaluations or cut_off == tries:
        status = ITERATION_LIMIT
    else:
        status = STALLED
        for i in range(q.shape[0]):
            if o.limits > 0.0 and (q[i] <= job.near.lower(i) or q[i] >= job.near.upper(i)):
                status = LIMIT_BLOCKED
    evaluations, held = spent.evaluations, -1
    if o.follow > 0.0 and status != CONVERGED:
        e = p.evaluate(q)
        p.jacobian(e)
        evaluations += 1
        held = held_back(p, e, job.near, job.box, o.limits > 0.0)
        status = TOO_FAR if held >= 0 else status
    if o.limits > 0.0 and not o.follow > 0.0 and face(q, start, job.box):
        s.spent[2] = float(CONSTRAINED)
        e = evaluation(rule, p, q)
        evaluations += 1
        if status == CONVERGED and not e.ee < 0.0:  # The rounding of a full turn exceeded a tolerance.
            copy(answer, q)
        else:
            p.keep(e, place)
    position, rotation = p.left(place)
    return Answer(
        float(status), float(spent.steps), float(tries - 1), position, rotation, float(evaluations),
        float(spent.noted), excess * job.box.scale(), float(found), float(held), float(agreed),
    ), place  # fmt: skip
