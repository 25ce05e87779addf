"""The search shared by all iterative methods and all problems: attempts from good starts until one of them converges.

A method (solver rule) is a NamedTuple class whose fields are its parameters and whose method step(p, e) writes the step p.desk.dq.
A problem is a `Serial` (one tip) or a `TreeProblem` (several tips). Both are chosen by class when the search is compiled, so the
loop is written once and costs no function call. With NUMBA_DISABLE_JIT=1 the same code runs as plain Python.

Every iteration evaluates the errors, keeps the best configuration so far, tests for convergence, budget and lack of progress, asks
the rule for a step, and applies it inside the joint limits. Reported errors were evaluated at q, or at q modulo 2 pi.
"""

# Numba's type hints lack options given in a dict, and functions that only numba calls, so pyright must not report these.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from ..compile.array_view import cut, fold, keep, view
from ..compile.jit import INLINE, cached, compiled, inline, inner
from .checks import CODE, standstill
from .dispatch import aim_at, evaluation, problem_on, shaped
from .limits import distance, face, held_back, hold, integrate, legal, neighbourhood
from .packed_model import part, scratch
from .problem import BEST_OF_ALL, NEAREST, NOW
from .records import SIZE, Answer, Array, Ends, Orders, copy, read, write
from .starts import BEST, FEATURES, StartTable, make_table, seed_sequence
from .vectors import clear

# A solver rule's `step` returns 0, SINGULAR_STEP if no step exists, or WAITING if a zero step does not mean a stall. AT_MINIMUM
# ends an attempt with success: q is a first-order minimum (see levels.py).
SINGULAR_STEP, WAITING, AT_MINIMUM = -1, -2, -3


class GiveUpRules(NamedTuple):
    """Numbers that decide when an attempt or a whole search is given up.

    An attempt is given up when its squared error exceeds a bound that falls in each iteration. Near a singular pose that is too
    early, so later attempts are patient: they get more iterations and a bound that falls more slowly.
    """

    patient_iterations: float = 2.0  # by how much the highest number of iterations is multiplied in a patient attempt
    patient_decay: float = 0.6  # factor of the bound in each iteration of a patient attempt
    unreachable_attempts: int = 3  # number of attempts if a target is proven out of reach; they aim at the reach's edge
    rounding: float = 1e-9  # squared error below which no attempt is given up, because what is left of it is rounding
    overflow: float = 1e300  # squared error above which an attempt ends, because it has diverged
    # size of a coordinate [rad or arm reaches] above which an attempt ends, because it has diverged
    far_off: float = 1e6
    # A step counts as no move if no joint moves further than this [rad or arm reaches].
    rest: float = 1e-9


END = GiveUpRules()


@compiled
class SearchInput(NamedTuple):
    """What a search of one or many targets is given, and the arrays to which it writes."""

    orders: Orders
    near: Ends  # the limits of a step, narrower than those of the joints if the option `follow` is set
    box: Ends  # the limits of the joints
    weights: Array  # (n,) joint weights
    table: StartTable
    best: Array  # (n,) the configuration of the least error so far
    closest: Array  # (n,) the solution nearest the start so far
    history: Array  # (H, SIZE.past + n) rows of history, see `note`


@compiled
class Patience(NamedTuple):
    """Limits of an attempt, which is given up when its squared error exceeds ceiling * decay^iteration.

    The iterations count from the last one in which level 0 was met, if errors have an order of priority.
    """

    iterations: float  # highest number of iterations
    ceiling: float  # squared error above which the attempt is given up in its first iteration
    decay: float  # factor by which `ceiling` changes in each further iteration
    # An attempt nearer than this [squared distance] to `SearchInput.closest` ends, because it would end there anyway; 0: none.
    known: float


@compiled
class Spent(NamedTuple):
    """Counts of what a search has done so far."""

    evaluations: int  # number of evaluations of the errors
    steps: int  # number of iterations
    noted: int  # number of rows of `SearchInput.history` that were written


@compiled
class Attempts(NamedTuple):
    """Summary of all attempts at one target."""

    status: int  # CONVERGED if any attempt converged, else the status of the last attempt
    tries: int
    cut_off: int  # number of attempts that ended at the iteration limit
    found: int  # number of the attempt that found the answer, 0 for the first
    slot: int  # index of the answer's errors in `Desk.errors`: BEST_OF_ALL or NEAREST


@inline
def judge_evaluation(e, k, ceiling, patience, count, o):
    """Return the status with which an attempt ends after evaluation e in its iteration k, or CODE.going if it continues.

    ceiling: squared error above which the attempt is given up; patience: limits of the attempt; count: evaluations so far; o: the
    options of the solve (Orders).
    """
    if e.good:
        return CODE.converged
    if not e.ee < END.overflow:
        return CODE.not_finite
    if k >= patience.iterations or count >= o.evaluations:
        return CODE.iteration_limit
    if e.ee > ceiling and e.ee > END.rounding:
        return CODE.stalled
    return CODE.going


@inner
def note(p, e, ends, history, row, attempt):
    """Write a row of history: position error [m], rotation error [rad], number of the attempt, and q [rad or m]."""
    p.keep(e, NOW)
    history[row, 0], history[row, 1] = p.left(NOW)
    history[row, 2] = attempt
    for i in range(p.desk.q.shape[0]):
        history[row, SIZE.past + i] = p.desk.q[i] * ends.unit(i)


@inline
def last_attempt(attempts, given):
    """Return the number of the attempt from q0 or home that is never given up early (-1: none), and how many attempts are made.

    This attempt is the last of several. It does the same as the only attempt of a search without restarts, so that more attempts
    never solve fewer targets. If q0 is given (given: 1, else 0), it repeats the first attempt, which may have been given up early,
    and is not counted in `attempts`, the number that was asked for.
    """
    return (attempts - 1 + given, attempts + given) if attempts > 1 else (-1, attempts)


@inline
def make_attempt(rule, p, job, patience, needs_jacobian, spent, least, attempt):
    """Iterate from p.desk.q until the attempt converges, fails or is given up.

    The q of the least error of all attempts is copied to `job.best`, and p keeps its errors as BEST_OF_ALL. rule: the solver rule;
    job: `SearchInput`; spent, least: counts and least squared error of the earlier attempts; attempt: number of this one. Returns
    the status of the attempt, its last evaluation, the least squared error of all attempts and the updated counts (Spent).
    """
    q, dq, w, o = p.desk.q, p.desk.dq, p.desk.w, job.orders
    boxed = o.limits > 0.0 or o.follow > 0.0
    holding = boxed and o.hold > 0.0
    count, steps, noted = spent.evaluations, spent.steps, spent.noted
    k, ceiling, moved, code, before = 0.0, patience.ceiling, np.inf, 0, np.inf
    while True:
        e = evaluation(rule, p, q)
        count += 1
        if noted < job.history.shape[0]:
            note(p, e, job.near, job.history, noted, attempt)
            noted += 1
        if e.ee < least or e.good:
            least = e.ee
            copy(q, job.best)
            p.keep(e, BEST_OF_ALL)
        status = judge_evaluation(e, k, ceiling, patience, count, o)
        if status != CODE.converged and moved <= END.rest and e.ee >= before and code != WAITING:
            status = CODE.still
        if (
            status == CODE.going
            and patience.known > 0.0
            and distance(q, job.closest, job.weights, job.box) < patience.known
        ):
            status = CODE.known
        if status != CODE.going:
            break
        before = e.ee
        if needs_jacobian:
            p.jacobian(e)
        k += 1.0
        # A negative `ee` is a rank from `level_search.rank_errors`, and means that the errors of first priority are in tolerance.
        ceiling = patience.ceiling if e.ee < 0.0 else ceiling * patience.decay
        copy(job.weights, w)
        p.desk.spent[0] = count
        for _ in range(2):
            code = rule.step(p, e)
            if not (holding and hold(q, dq, w, job.near)):
                break
        count = int(p.desk.spent[0])
        if code == SINGULAR_STEP or code == AT_MINIMUM:
            status = CODE.singular if code == SINGULAR_STEP else CODE.converged
            break
        steps += 1
        moved, far = integrate(q, dq, boxed, job.near)
        if not far < END.far_off:
            status = CODE.not_finite
            break
    return status, e, least, Spent(count, steps, noted)


@inline
def search(rule, p, job, needs_jacobian, excess):
    """Make attempts until one converges, or as many as the option `closest` asks for, and choose among their results.

    The start p.desk.start (n,) is q0 or home. rule: the solver rule; job: `SearchInput`; needs_jacobian: whether the rule reads
    p.desk.J; `excess` > 0 is by how much the target is proven out of reach [arm reaches]. Leaves q of the answer in p.desk.q.
    Returns the Answer, and the index of its errors in `Desk.errors` (BEST_OF_ALL or NEAREST).
    """
    o, q, start = job.orders, p.desk.q, p.desk.start
    given, closest, attempts = int(o.given), int(o.closest), int(o.attempts)
    if excess > 0.0:
        attempts, closest = min(attempts, END.unreachable_attempts), 0
    last, most = last_attempt(attempts, given)
    copy(start, job.best)
    for f in range(p.desk.errors.shape[1]):
        p.desk.errors[BEST_OF_ALL, f, 0], p.desk.errors[BEST_OF_ALL, f, 1] = np.inf, np.inf
    p.desk.spent[1] = o.evaluations
    spent, least, shortest = Spent(0, 0, 0), np.inf, np.inf
    hits, tries, cut_off, found, place = 0, 0, 0, 0, BEST_OF_ALL
    while True:
        patience = start_attempt(p, job, tries - given, excess)
        if tries == last:
            copy(start, q)
            patience = Patience(o.iterations, np.inf, 1.0, 0.0)
        before = least
        status, e, least, spent = make_attempt(rule, p, job, patience, needs_jacobian, spent, least, tries % attempts)
        if place == BEST_OF_ALL and (least < before or status == CODE.converged):
            found = tries % attempts
        tries += 1
        if status == CODE.iteration_limit:
            cut_off += 1
        if status == CODE.converged:
            hits += 1
            d = distance(q, start, job.weights, job.box) if closest > 0 else 0.0
            if closest > 0 and d < shortest:
                shortest, place, found = d, NEAREST, (tries - 1) % attempts
                copy(q, job.closest)
                p.keep(e, NEAREST)
        if hits >= max(closest, 1) or tries >= most or spent.evaluations >= o.evaluations:
            break
    if hits > 0:
        status = CODE.converged
    return conclude(p, job, Attempts(status, tries, cut_off, found, place), spent, excess), place


@inner
def conclude(p, job, made, spent, excess):
    """Put the answer of a search into p.desk.q, shifted by 2 pi k to be nearest the start; return status, counts and errors."""
    o, q, start, status = job.orders, p.desk.q, p.desk.start, made.status
    limits, following = o.limits > 0.0, o.follow > 0.0
    affordable, judged, held = spent.evaluations < o.evaluations, False, -1
    if excess > 0.0:
        status = CODE.unreachable
    elif status != CODE.converged and status != CODE.not_finite:
        judged = affordable and (o.attempts > 1.0 or following or status == CODE.still)
        if not affordable:
            status = CODE.iteration_limit
    answer = job.best if made.slot == BEST_OF_ALL else job.closest
    copy(answer, q)
    turned = limits and not following and face(q, start, job.box)
    evaluations = spent.evaluations
    if affordable and (judged or turned):
        e = p.evaluate(q)
        p.jacobian(e)
        evaluations += 1
        # Rounding in the shift by 2 pi has brought the error above a tolerance.
        if status == CODE.converged and not e.good:
            copy(answer, q)
        else:
            p.keep(e, made.slot)
        if judged:
            if following:
                held = held_back(p, e, job.near, job.box, limits)
            why = standstill(p, e, job.near, limits or following)
            if held >= 0:
                status = CODE.too_far
            elif o.attempts > 1.0:
                unfinished = CODE.iteration_limit if made.cut_off == made.tries else CODE.stalled
                status = CODE.limit_blocked if why == CODE.limit_blocked else unfinished
            elif status == CODE.still:
                status = why
    position, rotation = p.left(made.slot)
    return Answer(
        float(status), float(spent.steps), min(float(made.tries), o.attempts) - 1.0, position, rotation, float(evaluations),
        float(spent.noted), excess * job.box.scale(), float(made.found), float(held), 0.0,
    )  # fmt: skip


@inline
def start_attempt(p, job, k, excess):
    """Put the start of attempt k into p.desk.q, and return the attempt's iteration limit and give-up bound (Patience).

    k < 0 is the attempt from q0. Attempts 0 to BEST - 1 begin at precomputed starts, nearest first, later ones at random.
    """
    o, q = job.orders, p.desk.q
    iterations, ceiling, decay = o.iterations, o.c_free, o.rho_free
    if k < 0:
        copy(p.desk.start, q)
    elif k < BEST:
        if k == 0:
            p.rank(job.table)
        p.begin(job.table, k, q)
        ceiling, decay = o.c, o.rho
    else:
        p.draw(job.table, k, q)
        if k >= o.patience:
            iterations, decay = END.patient_iterations * o.iterations, END.patient_decay
    if excess > 0.0 or o.attempts == 1.0:
        ceiling = np.inf  # A single attempt, and any at a target out of reach, is never given up early.
    clear(p.desk.x)
    return Patience(iterations, ceiling, decay, 0.0)


def seek(rule, p, job, needs_jacobian, excess):
    """Search by the solver rule's own method `seek` if it has one (for errors with priorities), otherwise by `search`."""
    return rule.seek(p, job, excess) if hasattr(rule, "seek") else search(rule, p, job, needs_jacobian, excess)


@overload(seek, jit_options=INLINE)
def _seek(rule, p, job, needs_jacobian, excess):
    if hasattr(rule.instance_class, "seek"):
        return lambda rule, p, job, needs_jacobian, excess: rule.seek(p, job, excess)
    return lambda rule, p, job, needs_jacobian, excess: search(rule, p, job, needs_jacobian, excess)


@inline
def run_search(step, needs_jacobian, chain, T, Q0, out, orders, block):
    """Solve for all targets of one call: the body of the function that `entry` returns, with its arrays as views."""
    rows, ends, seeds, features = part(chain)
    N, n = T.shape[0], seeds.shape[1]
    o = read(Orders, orders)
    tips = features.shape[0] // FEATURES
    width = SIZE.answer + n + (SIZE.miss * tips if len(T.shape) == 4 else 0)
    history = fold(out[N * width :], np.float64, (out.shape[0] - N * width) // (SIZE.past + n), SIZE.past + n)
    first = SIZE.orders + SIZE.task * tips
    rule = read(step, orders, first + n)
    limits, following = o.limits > 0.0, o.follow > 0.0
    block[0] = 0.0
    near_ends = ends
    if following:
        (near_ends,) = cut(block, np.float64, (ends.shape[0],))
        copy(ends, near_ends)
    p = problem_on(block, rows, shaped(near_ends, T, tips), orders[SIZE.orders : first], n, o)
    # `Ends` reads the limits of the first tip, which are the same for all tips.
    box, near = Ends(ends, n), Ends(near_ends, n)
    table = make_table(block, seeds, features, tips)
    best, closest = cut(block, np.float64, (n, n))
    job = SearchInput(o, near, box, orders[first : first + n], table, best, closest, history)
    start = p.desk.start
    from_q0 = o.given > 0.0 or o.closest > 0.0
    for t in range(N):
        row, q0 = out[t * width : (t + 1) * width], Q0[t if Q0.shape[0] > 1 else 0]
        excess = aim_at(rule, p, T[t], o)
        if excess < 0.0:
            row[0] = CODE.bad_target
            continue
        if from_q0 and not legal(q0, box, limits):
            row[0] = CODE.bad_start
            continue
        for i in range(n):
            start[i] = q0[i] / box.unit(i) if from_q0 else box.home(i)
        if following:
            neighbourhood(q0, rows, o.follow, o.follow_slide, limits, box, near)
        seed_sequence(table.state, o.seed)
        answer, place = seek(rule, p, job, needs_jacobian, excess)
        write(row, 0, answer)
        for i in range(n):
            row[SIZE.answer + i] = p.desk.q[i] * box.unit(i)
        p.report(place, row)


def step_class(cls: type) -> type:
    """Return the class whose `step` is compiled for a solver: its attribute `COMPILED`, or the class itself."""
    return getattr(cls, "COMPILED", cls)


@functools.cache
def entry(cls: type) -> Callable:
    """Return the compiled search of a solver rule: solve(chain, T, Q0, out, orders).

    Its arguments are arrays of float64:

    - chain: all arrays of a chain or a tree (see `packed_model.join`);
    - T: target poses (N, 4, 4) [m] in the base frame, for F tips (N, F, 4, 4);
    - Q0: starts (1 or N, n) [rad or m], used if the orders say so; an answer's joints are shifted by 2 pi k to be nearest its
      start;
    - out: receives N rows, each of SIZE.answer + n numbers (for several tips SIZE.miss F more). Its rest receives the history: for
      each evaluation SIZE.past + n numbers, which are position error [m], rotation error [rad], number of the attempt, and q;
    - orders: an `Orders`, a `Task` for each tip, the joint weights (n) and the parameters of the solver rule.
    """
    step = step_class(cls)
    needs_jacobian = getattr(step, "JACOBIAN", True)

    def solve(chain, T, Q0, out, orders):
        block = np.empty(scratch(view(chain)))
        run_search(step, needs_jacobian, view(chain), view(T), view(Q0), view(out), view(orders), view(block))
        keep(block)

    return cached(solve, cls, step.step)
