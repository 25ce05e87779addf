"""Combines a closed form with the iterative search, which runs for the targets that the closed form leaves unsolved."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from ..kernel.checks import CODE
from ..kernel.records import AT, ORDER, SIZE
from .options import PLAIN
from .postprocess import finish_failures
from .status import SEARCHED

# `into_tolerances` looks for a solution from STARTS random configurations, with at most STEPS Newton steps from each.
STARTS, STEPS = 64, 24
COUNTS = [AT.iterations, AT.restarts, AT.evaluations, AT.history]


def error_size(rows: np.ndarray, length: float) -> np.ndarray:
    """Return one squared error for each failed solve (N,), position and rotation together, so that failures can be compared.

    rows (N, width): result rows, each the fields of `kernel.records.Answer`, then q; length: position error [m] that counts as
    much as a rotation error of 1 rad.
    """
    return (rows[:, AT.position] / length) ** 2 + rows[:, AT.rotation] ** 2


def with_search(plan: Any, closed: Callable) -> Callable:
    """Return a function that solves with a closed form, then searches iteratively for the targets that it has not solved.

    plan: the closed form bound to a robot; closed: its own solve function (`protocol.ClosedForm.loop`). The returned function
    takes the arguments of `kernel.search.entry`. The search has the plan's options, and keeps a joint that the closed form fixes
    at the same value. It begins at the start of the call and, for targets that are still unsolved, once more where the closed form
    ended. A target that stays unsolved keeps the status of the closed form, except STALLED, which proves nothing and is replaced
    by the status of the search. Its q is the best configuration found by either.
    """
    robot = plan.robot
    silent = np.empty((0, SIZE.past + robot.n))

    @functools.cache
    def searches() -> tuple[Any, Any, dict[int, float]]:
        """Return two plans of the iterative search, with all attempts and with one, and {index in q: value} of joints held in both.

        The plans are made when first needed.
        """
        options, held = dict(PLAIN), plan.rule.held(robot)
        if held:
            weights = np.array(plan.options.joint_weights or (1.0,) * robot.n)
            weights[list(held)] = 0.0
            options["joint_weights"] = tuple(weights.tolist())
        return plan.search(**options), plan.search(**{**options, "restarts": 0}), held

    def loop(_, T, Q0, flat, opt) -> None:
        rows, ends, seeds, feat = plan.chain
        if len(flat) == plan.width:  # For one target without history, the array is just that target's result row.
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
        # The iteration history exists only for a single target; the closed form has then written its first row.
        # The compiled code gets the robot's home as start if the caller gave none.
        given = len(Q0) > 1 or not np.array_equal(Q0[0], robot.home)
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
    """Search for a q that meets both tolerances of the target T (4, 4); if one is found, write it to the result row `row`.

    Each error counts in units of its tolerance: if one tolerance is loose, a configuration may meet both although the sum of its
    errors in metres and radians is not the least. The search begins at the q of `row` and at random configurations. plan: the
    closed form's Plan; rows, ends: arrays of the chain; opt: option array (`records.Orders`); fixed: index of a joint that keeps
    its value, or -1.
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
    """Search for M targets that a closed form has not solved, and merge the answers into its result rows.

    Returns a bool for each target (M,): whether it stays unsolved.

    Args:
        search: Plan of the search.
        T: (M, 4, 4) targets [m].
        start: (1 or M, n) configurations to begin at.
        how: the kinds of target, and whether the caller gave the starts (see `Plan.run`).
        failed: (M,) the index of each target's row in `out`.
        out: (N, width) result rows of the closed form. With a limit on evaluations, a search gets what its row has left.
        hist: rows for the history of a single target, or none.
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
        # However the search ended, its q is moved closer to the target, because the row may keep the closed form's status, which
        # promises the closest q.
        ended = (CODE.stalled, CODE.limit_blocked, CODE.unreachable, CODE.iteration_limit, CODE.singular)
        finish_failures(plan, T[some], how[0], starts, how[1], found, ended)
        merge(out, rows, found, search.options.length_scale or search.robot.reach)
        still[some] = found[:, AT.status] != CODE.converged
    return still


def merge(out: np.ndarray, failed: np.ndarray, found: np.ndarray, length: float) -> None:
    """Merge the search's result rows (M, width) into the rows `failed` (M,) of the closed form's `out` (N, width), in place.

    q and errors are taken from whichever has the smaller error (see `error_size`; length [m]), the status as `with_search` says;
    the counts are added.
    """
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
