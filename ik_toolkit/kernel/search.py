"""The one search: attempts from good starts, for any rule and any problem.

A rule is a NamedTuple class whose fields are its parameters and whose method step(p, e) writes p.desk.dq; a problem is a
Serial or a Tree. Both are chosen by class when the search is compiled, so the loop exists once and costs no call. With
NUMBA_DISABLE_JIT=1 the same code runs as plain Python.

Order in every iteration: evaluate, best so far, test, budget, give up, step, limits, integrate, stall. The q reported is
always one that was evaluated, at most full turns away. Restarts wrap the loop.
"""

# numba's own types know neither options in a dict nor that overloads and intrinsics are called by numba.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from ..compile.array_view import cut, fold, keep, view
from ..compile.jit import BUILD, INLINE, cached, compiled, inline, inner
from .checks import (
    BAD_START,
    BAD_TARGET,
    CONVERGED,
    ITERATION_LIMIT,
    LIMIT_BLOCKED,
    NOT_FINITE,
    SINGULAR,
    STALLED,
    TOO_FAR,
    UNREACHABLE,
    standstill,
)
from .limits import distance, face, held_back, hold, integrate, legal, neighbourhood, other_end
from .packed_model import part, scratch
from .problem import BEST_OF_ALL, NEAREST, NOW
from .records import ANSWER, HEAD, MISS, TASK, Answer, Array, Ends, Orders, copy, read, write
from .serial import make_serial, serial_on
from .starts import BEST, FEATURES, sow
from .tree import make_tree, tree_on

SINGULAR_STEP, WAITING = -1, -2  # what `step` may return instead of 0: no step exists; a zero step that is not a stall
GOING, STILL = -1, -2  # an attempt that continues, or has stopped moving; the search determines why
LOOK = -1.0  # iterations of a mere evaluation of the answer, which is not an attempt
# Near a singular pose the iteration converges too slowly for the give-up of the first attempts. A patient attempt has twice
# the iterations and is given up later, so that hard targets are solved and easy ones cost no more.
PATIENT, PATIENT_RHO = 2.0, 0.6
EDGE_ATTEMPTS = 3  # at a target proven out of reach: the nearest pose does not justify a long search
ROUNDING = 1e-9  # squared error below which no attempt is given up: the rest is rounding
OVERFLOW, FAR_OFF = 1e300, 1e6  # a squared error, and a coordinate, above which numbers cannot be trusted


def problem_on(block, rows, ends, tasks, n, orders):
    """Serial or Tree, by the shape of `ends`, with its scratch cut from a block."""
    return (serial_on if ends.ndim == 1 else tree_on)(block, rows, ends, tasks, n, orders)


@overload(problem_on, jit_options=INLINE)
def _problem_on(block, rows, ends, tasks, n, orders):
    if ends.ndim == 1:
        return lambda block, rows, ends, tasks, n, orders: serial_on(block, rows, ends, tasks, n, orders)
    return lambda block, rows, ends, tasks, n, orders: tree_on(block, rows, ends, tasks, n, orders)


def shaped(ends, T, tips):
    """Ends as Serial or Tree take them, by the shape of the targets."""
    return ends if T.ndim == 3 else ends.reshape(tips, -1)


@overload(shaped, jit_options=INLINE)
def _shaped(ends, T, tips):
    if T.ndim == 3:
        return lambda ends, T, tips: ends
    return lambda ends, T, tips: fold(ends, np.float64, tips, ends.shape[0] // tips)


def problem(rows, ends, tasks, n, orders):
    """The same with its own block, for code that runs on arrays and counts references."""
    return (make_serial if ends.ndim == 1 else make_tree)(rows, ends, tasks, n, orders)


@overload(problem, jit_options=BUILD)
def _problem(rows, ends, tasks, n, orders):
    if ends.ndim == 1:
        return lambda rows, ends, tasks, n, orders: make_serial(rows, ends, tasks, n, orders)
    return lambda rows, ends, tasks, n, orders: make_tree(rows, ends, tasks, n, orders)


@compiled
class StartTable(NamedTuple):
    """Known configurations to start from, and scratch to choose among them."""

    seeds: Array
    features: Array
    score: Array
    val: Array
    best: Array
    choice: Array
    total: Array
    state: Array  # of the random sequence


@inline
def make_table(block, seeds, features, tips):
    """Table with its scratch cut from a block."""
    score, val = cut(block, np.float32, (seeds.shape[0], BEST))
    best, choice = cut(block, np.int64, (BEST, (BEST, tips)))
    (total,) = cut(block, np.float64, (BEST,))
    (state,) = cut(block, np.uint64, (1,))
    return StartTable(seeds, features, score, val, best, choice, total, state)


@compiled
class Spent(NamedTuple):
    """What a search has used so far."""

    evaluations: int
    steps: int
    noted: int  # rows of history


@inline
def judge_evaluation(e, k, most, count, c, o):
    """What an evaluation means for an attempt in its iteration k: a status, or GOING."""
    if e.good:
        return CONVERGED
    if not e.ee < OVERFLOW:
        return NOT_FINITE
    if k >= most or count >= o.evaluations:
        return ITERATION_LIMIT
    if e.ee > c and e.ee > ROUNDING:
        return STALLED
    return GOING


@inner
def note(p, e, ends, history, row):
    """Write a row of history: position error, rotation error, q."""
    p.keep(e, NOW)
    history[row, 0], history[row, 1] = p.left(NOW)
    for i in range(p.desk.q.shape[0]):
        history[row, 2 + i] = p.desk.q[i] * ends.unit(i)


@inline
def make_attempt(rule, p, o, near, weights, most, c, rho, spent, least, best, needs_jacobian, history):
    """One attempt from p.desk.q; best (n,) and p keep the q of the least error and its errors.

    With most = LOOK only the errors and the Jacobian at p.desk.q. Returns the status, the last look, the least squared error
    and the counts.
    """
    q, dq, w = p.desk.q, p.desk.dq, p.desk.w
    boxed = o.limits > 0.0 or o.follow > 0.0
    holding = boxed and o.hold > 0.0
    count, steps, noted = spent.evaluations, spent.steps, spent.noted
    k = 0.0
    while True:
        e = p.evaluate(q)
        count += 1
        status = GOING
        if most >= 0.0:
            if noted < history.shape[0]:
                note(p, e, near, history, noted)
                noted += 1
            if e.ee < least or e.good:
                least = e.ee
                copy(q, best)
                p.keep(e, BEST_OF_ALL)
            status = judge_evaluation(e, k, most, count, c, o)
            if status != GOING:
                break
        if needs_jacobian or most < 0.0:
            p.jacobian(e)
        if most < 0.0:
            break
        k += 1.0
        c *= rho
        copy(weights, w)
        p.desk.spent[0] = count
        for _ in range(2):
            code = rule.step(p, e)
            if not (holding and hold(q, dq, w, near)):
                break
        count = int(p.desk.spent[0])
        if code == SINGULAR_STEP:
            status = SINGULAR
            break
        steps += 1
        moved, far = integrate(q, dq, boxed, near)
        if not far < FAR_OFF:
            status = NOT_FINITE
            break
        if moved <= 0.0 and code != WAITING:
            status = STILL
            break
    return status, e, least, Spent(count, steps, noted)


@inline
def search(rule, p, o, near, ends, weights, table, best, found, start, needs_jacobian, excess, history):
    """Attempts until one converges (or `closest` have), then the answer in p.desk.q. Returns the head of its row.

    start (n,): q0, or home; the turn nearest to it is returned. near: ends with the limits of a step, which `follow` narrows.
    """
    q = p.desk.q
    given, closest, attempts = int(o.given), int(o.closest), int(o.attempts)
    limits, following = o.limits > 0.0, o.follow > 0.0
    if excess > 0.0:
        attempts, closest = min(attempts, EDGE_ATTEMPTS), 0
    copy(start, best)
    for f in range(p.desk.errors.shape[1]):
        p.desk.errors[BEST_OF_ALL, f, 0], p.desk.errors[BEST_OF_ALL, f, 1] = np.inf, np.inf
    p.desk.spent[1] = o.evaluations
    spent = Spent(0, 0, 0)
    least, shortest = np.inf, np.inf
    hits, tries, cut_off, attempt, place, held = 0, 0, 0, 0, BEST_OF_ALL, -1
    turned, judged, status = False, False, GOING
    most, c, rho = 0.0, 0.0, 0.0
    while True:
        if status == GOING:
            most, c, rho = start_attempt(p, o, table, tries - given, start)
            if excess > 0.0:
                c = np.inf
            for i in range(p.desk.x.shape[0]):
                p.desk.x[i] = 0.0
        before = least
        ended, e, least, spent = make_attempt(
            rule, p, o, near, weights, most, c, rho, spent, least, best, needs_jacobian, history
        )
        if status != GOING:
            break  # that was the evaluation of the answer
        if place == BEST_OF_ALL and (least < before or ended == CONVERGED):
            attempt = tries
        tries += 1
        if ended == ITERATION_LIMIT:
            cut_off += 1
        if ended == CONVERGED:
            hits += 1
            d = distance(q, start, weights, ends) if closest > 0 else 0.0
            if closest > 0 and d < shortest:
                shortest, place, attempt = d, NEAREST, tries - 1
                copy(q, found)
                p.keep(e, NEAREST)
        if hits < max(closest, 1) and tries < attempts and spent.evaluations < o.evaluations:
            continue
        status, judged = ended, False
        if hits > 0:
            status = CONVERGED
        if excess > 0.0:
            status = UNREACHABLE
        elif status != CONVERGED and status != NOT_FINITE:
            judged = attempts > 1 or following or status == STILL
            if spent.evaluations >= o.evaluations:
                status, judged = ITERATION_LIMIT, False
        copy(best if place == BEST_OF_ALL else found, q)
        # Of the same answer several turns away, return the one within limits nearest the start (or home).
        turned = limits and not following and face(q, start, ends)
        if not (judged or turned) or spent.evaluations >= o.evaluations:
            break
        most = LOOK
    if most < 0.0:
        if status == CONVERGED and not e.good:  # rounding of the turn exceeded a tolerance that was just met
            copy(best if place == BEST_OF_ALL else found, q)
        else:
            p.keep(e, place)
    if judged:
        if following:
            held = held_back(p, e, near, ends, limits)
        why = standstill(p, e, near, limits or following)
        if held >= 0:
            status = TOO_FAR
        elif attempts > 1:
            status = LIMIT_BLOCKED if why == LIMIT_BLOCKED else ITERATION_LIMIT if cut_off == tries else STALLED
        elif status == STILL:
            status = why
    if status == CONVERGED and given > 0 and not following:
        held = other_end(q, start, ends)
    position, rotation = p.left(place)
    answer = Answer(
        float(status), float(spent.steps), float(tries - 1), position, rotation, float(spent.evaluations),
        float(spent.noted), excess * ends.scale(), float(attempt), float(held),
    )  # fmt: skip
    return answer, place


@inline
def start_attempt(p, o, table, k, start):
    """Put the start of attempt k (negative: q0) into p.desk.q. Returns its iterations and how it is given up."""
    q = p.desk.q
    most, c, rho = o.iterations, o.c_free, o.rho_free
    if k < 0:
        copy(start, q)
    elif k < BEST:
        if k == 0:
            p.rank(table)
        p.begin(table, k, q)
        c, rho = o.c, o.rho
    else:
        p.draw(table, k, q)
        if k >= o.patience:
            most, rho = PATIENT * o.iterations, PATIENT_RHO
    return most, c, rho


@inline
def run_search(step, needs_jacobian, chain, T, Q0, out, orders, block):
    """The search of a rule for all targets, on views: arguments as of `entry`, and scratch."""
    rows, ends, seeds, features = part(chain)
    N, n = T.shape[0], seeds.shape[1]
    o = read(Orders, orders)
    tips = features.shape[0] // FEATURES
    width = ANSWER + n + (MISS * tips if len(T.shape) == 4 else 0)
    history = fold(out[N * width :], np.float64, (out.shape[0] - N * width) // (2 + n), 2 + n)
    first = HEAD + TASK * tips
    weights = orders[first : first + n]
    rule = read(step, orders, first + n)
    limits, following = o.limits > 0.0, o.follow > 0.0
    block[0] = 0.0
    near_ends = ends
    if following:
        (near_ends,) = cut(block, np.float64, (ends.shape[0],))
        copy(ends, near_ends)
    p = problem_on(block, rows, shaped(near_ends, T, tips), orders[HEAD:first], n, o)
    # What belongs to the coordinates is the same for every tip, and stands first.
    box, near = Ends(ends, n), Ends(near_ends, n)
    table = make_table(block, seeds, features, tips)
    best, found = cut(block, np.float64, (n, n))
    start = p.desk.start
    from_q0 = o.given > 0.0 or o.closest > 0.0
    for t in range(N):
        row, q0 = out[t * width : (t + 1) * width], Q0[t if Q0.shape[0] > 1 else 0]
        excess = p.aim(T[t], o)
        if excess < 0.0:
            row[0] = BAD_TARGET
            continue
        if from_q0 and not legal(q0, box, limits):
            row[0] = BAD_START
            continue
        for i in range(n):
            start[i] = q0[i] / box.unit(i) if from_q0 else box.home(i)
        if following:
            neighbourhood(q0, rows, o.follow, o.follow_slide, limits, box, near)
        sow(table.state, o.seed)
        answer, place = search(
            rule, p, o, near, box, weights, table, best, found, start, needs_jacobian, excess, history
        )
        write(row, 0, answer)
        for i in range(n):
            row[ANSWER + i] = p.desk.q[i] * box.unit(i)
        p.report(place, row)


ENTRIES: dict[type, Callable] = {}


def step_class(cls: type) -> type:
    """The class of a rule whose fields are what the compiled step reads: `COMPILED`, or the rule's own."""
    return getattr(cls, "COMPILED", cls)


def entry(cls: type) -> Callable:
    """Return the compiled search of a rule: solve(chain, T, Q0, out, orders).

    chain: all arrays of a chain or a tree (see `joined.join`). T (N, 4, 4) [m], of F tips (N, F, 4, 4). Q0 (1 or N, n) start if
    orders say so, and the turn nearest to it is returned. out (K,): N rows of ANSWER + n numbers, of several tips MISS F more;
    what is left of it are rows of 2 + n that receive position error, orientation error and q of each evaluation. orders:
    `Orders`, a `Task` a tip, joint weights (n), parameters.
    """
    if cls in ENTRIES:
        return ENTRIES[cls]
    step = step_class(cls)
    needs_jacobian = getattr(step, "JACOBIAN", True)

    def solve(chain, T, Q0, out, orders):
        block = np.empty(scratch(view(chain)))
        run_search(step, needs_jacobian, view(chain), view(T), view(Q0), view(out), view(orders), view(block))
        keep(block)

    ENTRIES[cls] = cached(solve, cls, step.step)
    return ENTRIES[cls]
