"""When a closed form has no answer, the search has its say: it may find one, and if not the best configuration is returned."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..kernel.checks import BAD_TARGET, CONVERGED, STALLED, UNREACHABLE
from ..kernel.slots import (
    O_KIND,
    OUT_HEAD,
    R_ATTEMPT,
    R_EVALUATIONS,
    R_EXCESS,
    R_HISTORY,
    R_ITERATIONS,
    R_POSITION,
    R_RESTARTS,
    R_ROTATION,
    R_STATUS,
)
from .registry import GENERAL

SEARCHED = -1.0  # in the slot of the excess: q came from the search
STARTS, STEPS = 64, 24  # of the last search, which is for the tolerances
COUNTS = [R_ITERATIONS, R_RESTARTS, R_EVALUATIONS, R_HISTORY]
PLAIN = {"closest": False, "objective": None, "history": False, "check": False, "avoid_collisions": False}


def error_size(rows: np.ndarray, scale: float) -> np.ndarray:
    """Squared error (N,) of result rows (N, 9 + n) as the search measures it: lengths over the scale, chords of angles."""
    return (rows[:, R_POSITION] / scale) ** 2 + (2.0 * np.sin(0.5 * rows[:, R_ROTATION])) ** 2


def with_search(solver: Any, closed: Callable) -> Callable:
    """Loop of the kernel's signature (see kernel.loop.entry): the closed form, and 'lm' for the rows it does not solve.

    solver: the bound Solver of the closed form; 'lm' gets its options, and keeps joints where the rule holds them. It begins as
    usual, and then once where the closed form ended. A row that is not solved either way keeps the closed form's status, unless
    that is STALLED: then it proves nothing, and 'lm' gives the status. Its q is the best of all.
    """
    robot = solver.robot
    made: list[tuple[Any, Any, dict[int, float]]] = []

    def searches() -> tuple[Any, Any, dict[int, float]]:
        """Solver 'lm', the same for one attempt, and the joints they hold; made when first needed."""
        if not made:
            options = {**solver.options.__dict__, **PLAIN}
            held = solver.rule.held(robot) if hasattr(solver.rule, "held") else {}
            if held:
                weights = np.ones(robot.n) if options["joint_weights"] is None else np.array(options["joint_weights"])
                weights[list(held)] = 0.0
                options["joint_weights"] = weights
            kind = type(solver)
            made.append((kind(robot, GENERAL, **options), kind(robot, GENERAL, **{**options, "restarts": 0}), held))
        return made[0]

    def loop(rows, ends, seeds, feat, T, Q0, out, opt, hist) -> None:
        closed(rows, ends, seeds, feat, T, Q0, out, opt, hist)
        if len(out) == 1 and out[0, R_STATUS] == CONVERGED:
            return
        failed = np.flatnonzero((out[:, R_STATUS] != CONVERGED) & (out[:, R_STATUS] < BAD_TARGET))
        if not len(failed):
            return
        usual, once, held = searches()
        start = np.array(Q0 if len(Q0) == 1 else Q0[failed])
        for joint, value in held.items():
            start[:, joint] = value
        if solver.options.limits and ((start < robot.lower) | (start > robot.upper)).any():
            return  # a joint is held where the limits forbid it: nothing else is to be found
        ended = np.array(out[failed, OUT_HEAD:])
        kind = int(opt[O_KIND])
        # With one target the closed form has written one row of the history; with more there is none.
        given = len(Q0) > 1 or not np.array_equal(Q0[0], robot.home)  # a closed form is always told to start somewhere
        open_ = continue_with(usual, T, start, (kind, given), failed, out, hist[1:])
        if open_.any():
            still = continue_with(once, T, ended[open_], (kind, True), failed[open_], out, hist[:0])
            fixed = next(iter(held), -1)
            for k in failed[open_][still]:
                if out[k, R_STATUS] != UNREACHABLE:
                    into_tolerances(solver, rows, ends, T[k], opt, fixed, out[k])

    return loop


def into_tolerances(
    solver: Any, rows: np.ndarray, ends: np.ndarray, T: np.ndarray, opt: np.ndarray, fixed: int, row: np.ndarray
) -> None:
    """Search once more with errors counted in units of their tolerances: a loose one may be met away from the least error.

    From the best configuration found, and from STARTS others.
    """
    from .closed_form.finish import first_good

    robot = solver.robot
    rng = np.random.default_rng(solver.options.seed)
    starts = np.array([row[OUT_HEAD:], *(robot.random_q(rng) for _ in range(STARTS))])
    if fixed >= 0:
        starts[:, fixed] = row[OUT_HEAD + fixed]
    q = np.empty(robot.n)
    position, rotation, evaluations = first_good(rows, ends, opt, T, starts, fixed, STEPS, q)
    row[R_EVALUATIONS] += evaluations
    if position < np.inf:
        row[OUT_HEAD:] = q
        row[R_STATUS], row[R_POSITION], row[R_ROTATION], row[R_EXCESS] = CONVERGED, position, rotation, SEARCHED


def continue_with(
    search: Any,
    T: np.ndarray,
    start: np.ndarray,
    how: tuple[int, bool],
    failed: np.ndarray,
    out: np.ndarray,
    hist: np.ndarray,
) -> np.ndarray:
    """Search the rows `failed` of out (N, 9 + n) from start (1 or len(failed), n); tell which of them are still not solved.

    how: kind of target, and whether the starts are given (see Solver.pack).
    """
    found = np.zeros((len(failed), out.shape[1]))
    search._kernel(*search.arrays_for(how[0], start), T[failed], start, found, search.pack(*how), hist)
    merge(out, failed, found, search.robot.chain.scale)
    return found[:, R_STATUS] != CONVERGED


def merge(out: np.ndarray, failed: np.ndarray, found: np.ndarray, scale: float) -> None:
    """Put into the rows `failed` of out (N, 9 + n) what the search found (len(failed), 9 + n): see `with_search`."""
    rows = out[failed]
    counts = rows[:, COUNTS] + found[:, COUNTS]
    solved = found[:, R_STATUS] == CONVERGED
    open_ = rows[:, R_STATUS] == STALLED
    better = solved | (error_size(found, scale) < error_size(rows, scale))
    rows[better, OUT_HEAD:] = found[better, OUT_HEAD:]
    for slot in (R_POSITION, R_ROTATION, R_ATTEMPT):
        rows[better, slot] = found[better, slot]
    taken = solved | open_
    rows[taken, R_STATUS] = found[taken, R_STATUS]
    rows[taken, R_EXCESS] = found[taken, R_EXCESS]
    rows[solved, R_EXCESS] = SEARCHED
    rows[:, COUNTS] = counts
    out[failed] = rows
