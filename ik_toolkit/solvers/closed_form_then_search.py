"""Runs the search if a closed form has no answer: it may find one; otherwise the best configuration is returned."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..kernel.checks import CODE
from ..kernel.records import AT, ORDER, SIZE
from .options import PLAIN
from .postprocess import finish_failures
from .status import SEARCHED

STARTS, STEPS = 64, 24  # number of starts, and of steps from each, in `into_tolerances`, the last search
COUNTS = [AT.iterations, AT.restarts, AT.evaluations, AT.history]


def error_size(rows: np.ndarray, length: float) -> np.ndarray:
    """Return the squared error (N,) of result rows (N, SIZE.answer + n); a position error of `length` [m] counts as 1 rad."""
    return (rows[:, AT.position] / length) ** 2 + rows[:, AT.rotation] ** 2


def with_search(plan: Any, closed: Callable) -> Callable:
    """Return a solve function, called like that of `kernel.search.entry`: a closed form, then a search where it fails.

    plan: the closed form bound to a robot; closed: its solve function, see `protocol.ClosedForm.loop`. The search has the same
    options and holds the joints that the closed form holds. It begins as usual; for targets that are still unsolved it begins once
    more where the closed form ended. A row that stays unsolved keeps the closed form's status, except STALLED, which proves nothing
    and is replaced by the status of the search. Its q is the best configuration found.
    """
    robot = plan.robot
    silent = np.empty((0, SIZE.past + robot.n))
    made: list[tuple[Any, Any, dict[int, float]]] = []

    def searches() -> tuple[Any, Any, dict[int, float]]:
        """Return the search, the same search with one attempt, and the joint values that both hold.

        They are made when first needed.
        """
        if not made:
            options = dict(PLAIN)
            held = plan.rule.held(robot)
            if held:
                weights = (
                    np.ones(robot.n) if plan.options.joint_weights is None else np.array(plan.options.joint_weights)
                )
                weights[list(held)] = 0.0
                options["joint_weights"] = tuple(weights.tolist())
            made.append((plan.search(**options), plan.search(**{**options, "restarts": 0}), held))
        return made[0]

    def loop(_, T, Q0, flat, opt) -> None:
        rows, ends, seeds, feat = plan.chain
        if len(flat) == plan.width:  # a call for one target without history must be fast
            out, hist = flat[None], silent
        else:
            filled = len(T) * plan.width
            out, hist = flat[:filled].reshape(len(T), -1), flat[filled:].reshape(-1, SIZE.past + robot.n)
        closed(rows, ends, seeds, feat, T, Q0, out, opt, hist)
        if len(out) == 1 and out[0, AT.status] == CODE.converged:
            return
        failed = np.flatnonzero((out[:, AT.status] != CODE.converged) & (out[:, AT.status] < CODE.bad_target))
        if not len(failed):
            return
        usual, once, held = searches()
        start = np.array(Q0 if len(Q0) == 1 else Q0[failed])
        for joint, value in held.items():
            start[:, joint] = value
        if plan.options.limits and ((start < robot.lower) | (start > robot.upper)).any():
            return  # A joint is held outside its limits, so a search cannot find anything.
        ended = np.array(out[failed, SIZE.answer :])
        kinds = (int(opt[SIZE.orders]),)
        # With one target the closed form has written one row of history; with more targets there is no history.
        given = len(Q0) > 1 or not np.array_equal(Q0[0], robot.home)  # without q0 the start is home
        open_ = continue_with(usual, T[failed], start, (kinds, given), failed, out, hist[1:])
        if open_.any():
            still = continue_with(once, T[failed[open_]], ended[open_], (kinds, True), failed[open_], out, hist[:0])
            fixed = next(iter(held), -1)
            for k in failed[open_][still]:
                if out[k, AT.status] != CODE.unreachable:
                    into_tolerances(plan, rows, ends, T[k], opt, fixed, out[k])

    return loop


def into_tolerances(
    plan: Any, rows: np.ndarray, ends: np.ndarray, T: np.ndarray, opt: np.ndarray, fixed: int, row: np.ndarray
) -> None:
    """Search once more with errors counted in units of their tolerances, and write a solution to the result row `row`.

    If one tolerance is loose, a configuration may meet both although its error in the usual units is not the least. The
    search begins at the best configuration found, and at STARTS random ones.
    """
    from .closed_form.polish import first_good

    robot = plan.robot
    rng = np.random.default_rng(plan.options.seed)
    starts = np.array([row[SIZE.answer :], *(robot.random_q(rng) for _ in range(STARTS))])
    if fixed >= 0:
        starts[:, fixed] = row[SIZE.answer + fixed]
    q = np.empty(robot.n)
    left = opt[ORDER.evaluations] - row[AT.evaluations]
    position, rotation, evaluations = first_good(rows, ends, opt, T, starts, fixed, STEPS, left, q)
    row[AT.evaluations] += evaluations
    if position < np.inf:
        row[SIZE.answer :] = q
        row[AT.status], row[AT.position], row[AT.rotation], row[AT.excess] = (
            CODE.converged,
            position,
            rotation,
            SEARCHED,
        )


def continue_with(
    search: Any,
    T: np.ndarray,
    start: np.ndarray,
    how: tuple[tuple, bool],
    failed: np.ndarray,
    out: np.ndarray,
    hist: np.ndarray,
) -> np.ndarray:
    """Search for the targets T (M, 4, 4), whose rows in out (N, SIZE.answer + n) are `failed` (M,), from start (1 or M, n).

    `how` has the kinds of target, and whether the starts are given (see Plan.run). If evaluations are limited, each
    search gets those that its row has left. Returns whether each row (M,) stays unsolved.
    """
    budget, still = search.options.budget, np.ones(len(failed), dtype=bool)
    every = np.arange(len(failed))
    for some in [every] if budget is None else every[:, None]:
        plan, rows = search, failed[some]
        if budget is not None:
            left = budget - int(out[rows[0], AT.evaluations])
            if left <= 0:
                if out[rows[0], AT.status] == CODE.stalled:
                    out[rows[0], AT.status] = CODE.iteration_limit
                continue
            plan = search.varied(max_evaluations=left)
        found, starts = np.zeros((len(rows), out.shape[1])), start if len(start) == 1 else start[some]
        if len(hist):  # only a single target has a history
            found[0], noted = plan.note(T, start, plan.ready(how[0], start, how[1]), len(hist))
            hist[: len(noted)] = noted
        else:
            plan.run(T[some], how[0], starts, how[1], found)
        # The row may keep the status of the closed form, so q must be the closest configuration, however this search ended.
        ended = (CODE.stalled, CODE.limit_blocked, CODE.unreachable, CODE.iteration_limit, CODE.singular)
        finish_failures(plan, T[some], how[0], starts, how[1], found, ended)
        merge(out, rows, found, search.options.length_scale or search.robot.reach)
        still[some] = found[:, AT.status] != CODE.converged
    return still


def merge(out: np.ndarray, failed: np.ndarray, found: np.ndarray, length: float) -> None:
    """Write what the search found into the rows `failed` of out (N, SIZE.answer + n), a row for each, see `with_search`."""
    rows = out[failed]
    counts = rows[:, COUNTS] + found[:, COUNTS]
    solved = found[:, AT.status] == CODE.converged
    open_ = rows[:, AT.status] == CODE.stalled
    better = solved | (error_size(found, length) < error_size(rows, length))
    rows[better, SIZE.answer :] = found[better, SIZE.answer :]
    for place in (AT.position, AT.rotation, AT.attempt):
        rows[better, place] = found[better, place]
    taken = solved | open_
    rows[taken, AT.status] = found[taken, AT.status]
    rows[taken, AT.excess] = np.where(found[:, AT.status] == CODE.unreachable, found[:, AT.excess], SEARCHED)[taken]
    rows[:, COUNTS] = counts
    out[failed] = rows
