"""The steps that finish an answer: each takes a SolveRecord and returns it, changed or not.

A failure is finished first (`finish_failure`): the search continues as far as its timeout allows, a test shows whether limits are
the cause, and q is moved to the closest configuration. `plan.improving` are the steps that may replace a converged q (collisions,
objective), in single calls and in batches. `plan.steps` are all steps of a single call: history, improving, the check by Pinocchio,
and the test of the robot description's constraints.
"""

import functools
from collections.abc import Callable
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ..kernel.checks import CODE
from ..kernel.records import AT, SIZE
from ..robot.pose import check_target
from .status import DECIDED, Status, constraints_of
from .task import POSES, counted_errors, group_levels

Step = Callable[[Any], Any]
# To test whether limits keep the arm from a target, the target is solved again with FEW attempts, without limits and with them.
FEW = 20
# If a solve fails with a status in ENDED, q is moved to a local minimum of the error.
ENDED = (CODE.stalled, CODE.limit_blocked, CODE.unreachable)


class Limits(NamedTuple):
    """Limits on the work that is done after a search, to improve its answer or to explain its failure."""

    improving: int = 200  # largest number of steps in the null space that improve an answer
    # After a failure, if the option length_scale is given, the error is also minimised from `begins` random configurations.
    begins: int = 20
    # A search with a timeout runs again and again from the beginning, each run `growth` times as long as the last. With a factor of
    # 4 the repetition costs at most a third more.
    growth: int = 4


MOST = Limits()


def finishing(plan: Any) -> tuple[tuple[Step, ...], tuple[Step, ...]]:
    """Return the functions to run after a single solve, by a plan's options, and those among them that improve the answer.

    Each takes and returns a `SolveRecord`.
    """
    o = plan.options
    improving: tuple[Step, ...] = () if o.objective is None else (improve,)
    if o.avoid_collisions is not False:  # a margin of 0.0 [m] is a request, too
        from .collision_free import avoiding

        improving = (avoiding(plan, improving),)
    steps = [
        *([record] if o.history else []),
        *improving,
        *([confirm] if o.check else []),
        *([keep_constraints] if plan.robot.constraints else []),
    ]
    return tuple(steps), improving


def finish_failure(outcome: Any) -> Any:
    """Return the record of a failed search after more time if allowed, a test whether limits are the cause, and moving q closer."""
    if outcome.plan.options.timeout is not None:
        outcome = extend(outcome)
    # ENDED leaves out TOO_FAR, because this status may occur in every cycle of a control loop, which has no time for more work.
    if outcome.row[AT.status] in ENDED:
        _finish(outcome.plan, outcome.T, outcome.kinds, outcome.start, outcome.given, outcome.row[None])
    return outcome


def finish_failures(
    plan: Any,
    T: np.ndarray,
    kinds: tuple,
    start: np.ndarray,
    given: bool,
    rows: np.ndarray,
    ended: tuple[int, ...] = ENDED,
) -> None:
    """Test whether limits caused the failures of a batch, and move each q closer to its target; changes result rows in place.

    Only the rows (m, width) with a status in `ended` are changed, as `_finish` says. T (m, 4, 4), for several tips (m, F, 4, 4):
    targets; kinds, start (1 or m, n), given: as for `Plan.run`.
    """
    these = np.flatnonzero((rows[:, AT.status, None] == ended).any(axis=1))
    if len(these):
        start, made = np.repeat(start, len(rows) // len(start), axis=0)[these], rows[these]
        _finish(plan, T[these], kinds, start, given, made)
        rows[these] = made


def _finish(plan: Any, T: np.ndarray, kinds: tuple, start: np.ndarray, given: bool, rows: np.ndarray) -> None:
    """Finish, in place, the result rows (m, width) of failed searches for targets T from starts (m, n).

    LIMIT_BLOCKED becomes STALLED if a short search without limits does not reach the target either, or if a short search inside the
    limits does reach it. Then, if the solver asks for it (`plan.descends`), the row's q is moved to the configuration nearby that
    is closest to the target.
    """
    for k, row in enumerate(rows):
        if row[AT.status] == CODE.limit_blocked and plan.options.limits and row[AT.excess] != DECIDED:
            asked = T[k : k + 1], kinds, start[k : k + 1], given
            blocked = plan.unlimited.solve(*asked)[AT.status] == CODE.converged
            few = row[AT.restarts] + 1 < FEW  # A search that had FEW attempts or more need not be repeated with FEW.
            if not blocked or (few and plan.retried.solve(*asked)[AT.status] == CODE.converged):
                row[AT.status] = CODE.stalled
    if plan.descends:
        _descend(plan, T, kinds, start, given, rows)
    for row in rows:
        if row[AT.status] == CODE.limit_blocked and row[AT.excess] != DECIDED and plan.descends:
            if not plan.robot.at_limits(row[plan.q_columns]):
                row[AT.status] = CODE.stalled


def _descend(plan: Any, T: np.ndarray, kinds: tuple, start: np.ndarray, given: bool, rows: np.ndarray) -> None:
    """Move, in place, the configurations of rows (m, width) to a local minimum of the error.

    The search compares its attempts by errors whose lengths are divided by about the reach. If the option length_scale is given,
    another attempt may be the best one, so the minimisation also begins at the start and at random configurations.
    """
    o, robot, m = plan.options, plan.robot, len(rows)
    targets, orders, least = T.reshape(m, -1, 4, 4), plan.orders(kinds, given), np.empty(m)
    allowed = float(o.max_evaluations or np.inf)

    def lower(made: np.ndarray, left: np.ndarray) -> None:
        arrays = *plan.chain[:2], targets, made, orders
        _approach()(*arrays, robot.n, o.length_scale or robot.reach, allowed, left)

    lower(rows, least)
    if o.length_scale is None or len(plan.held):
        return
    for q in (start, *robot.random_q(np.random.default_rng(o.seed), MOST.begins)):
        made, left, before = rows.copy(), np.empty(m), rows[:, AT.status] != CODE.converged
        made[:, plan.q_columns] = q
        lower(made, left)
        rows[:, AT.evaluations] = made[:, AT.evaluations]
        better = before & ((left < least) | (made[:, AT.status] == CODE.converged))
        least[better], rows[better] = left[better], made[better]


@functools.cache
def _approach() -> Any:
    """Return `kernel.closest.approach_targets`, imported only at the first failure; an import statement costs 5 us each time."""
    from ..kernel.closest import approach_targets

    return approach_targets


def extend(outcome: Any) -> Any:
    """Continue a search that used up its first budget, as far as its timeout allows.

    A search with a larger budget of evaluations begins exactly like one with a smaller budget. So each run is a longer one from the
    beginning, and max_evaluations=result.fk_evaluations gives the same answer. A run gets no more evaluations than fit into the
    time left at the pace of the last one.
    """
    plan, row, made = outcome.plan, outcome.row, outcome.plan.options.budget
    began, left, pace = perf_counter(), outcome.plan.options.timeout - outcome.elapsed, outcome.elapsed / made
    while row[AT.status] != CODE.converged and row[AT.evaluations] >= made:
        allowed = int(min(MOST.growth * made, (left - perf_counter() + began) / pace))
        if allowed <= made:
            break
        plan, started = outcome.plan.varied(max_evaluations=allowed), perf_counter()
        row = plan.solve(outcome.T, outcome.kinds, outcome.start, outcome.given)
        pace, made = (perf_counter() - started) / allowed, allowed
    return outcome._replace(plan=plan, row=row, elapsed=outcome.elapsed + perf_counter() - began)


def record(outcome: Any) -> Any:
    """Solve again and record the history of all iterations, which needs an array whose length is known only after the first run.

    If the answer was then shifted by 2 pi nearer to the start, or a failure moved to the closest configuration, this final q was
    evaluated after the search, so it is the last row.
    """
    plan = outcome.plan
    ready = plan.ready(outcome.kinds, outcome.start, outcome.given)
    history = plan.note(outcome.T, outcome.start, ready, int(outcome.row[AT.evaluations]) + 1)[1]
    last = outcome.row
    q = last[plan.q_columns]
    if not (history[:, SIZE.past :] == q).all(axis=1).any():
        history = np.vstack([history, [last[AT.position], last[AT.rotation], last[AT.attempt], *q]])
    if all(angle is None for _, angle in outcome.left()):
        history[:, 1] = np.nan
    # A closed form has no attempts, so its row and those of the search after it are all numbered 0.
    attempt = history[:, 2].astype(int) * (not plan.row.closed)
    columns = {"position_error": history[:, 0], "orientation_error": history[:, 1], "q": history[:, SIZE.past :]}
    return outcome._replace(history=columns | {"attempt": attempt})


def improve(outcome: Any) -> Any:
    """Improve the `objective` that the options name by moving a solution in its null space; return the record with the better q."""
    from ..kernel.null_space import OBJECTIVE, refine

    plan, row = outcome.plan, outcome.row
    if row[AT.status] != CODE.converged:
        return outcome
    row, what = row.copy(), getattr(OBJECTIVE, plan.options.objective.replace("-", "_"))
    orders = plan.orders(outcome.kinds, outcome.given)
    refine(*plan.chain[:2], outcome.T, row, outcome.start[0], orders, what, MOST.improving)
    q = row[plan.q_columns]
    # The better q is taken only if Pinocchio confirms it: it often lies at the very edge of a tolerance, where rounding decides.
    return outcome._replace(row=row) if confirmed(plan, q, outcome.T[0], outcome.kinds) else outcome


def confirm(outcome: Any) -> Any:
    """Compute the errors again with Pinocchio; a success that it does not confirm becomes a failure."""
    plan, kinds = outcome.plan, outcome.kinds
    errors = counted_errors(plan.robot, outcome.row[plan.q_columns], outcome.T[0], kinds, plan.options)
    outcome = outcome._replace(errors=errors)
    if outcome.row[AT.status] != CODE.converged or inside(errors, plan):
        return outcome
    if kinds == POSES:
        # A target rotation that is orthonormal only to 1e-6 is replaced by the nearest exact one before the angle is measured.
        mended = check_target(outcome.T[0])[0]
        if not np.array_equal(mended, outcome.T[0]):
            row = plan.solve(mended[None], kinds, outcome.start, outcome.given)
            again = outcome._replace(target=mended.tobytes(), row=row, errors=None)
            for step in plan.steps:
                again = step(again)
            return again
    row = outcome.row.copy()
    row[AT.status] = CODE.check_failed
    return outcome._replace(row=row)


def keep_constraints(outcome: Any) -> Any:
    """Turn a success into a failure if its q breaks a constraint of the robot description."""
    mark_open(outcome.plan, rows := outcome.row[None].copy())
    return outcome._replace(row=rows[0])


def mark_open(plan: Any, rows: np.ndarray) -> None:
    """Set the status CONSTRAINT_OPEN in converged result rows (m, width) whose q breaks a constraint of the robot's description."""
    if plan.robot.constraints:
        for k in np.flatnonzero(rows[:, AT.status] == CODE.converged):
            if not constraints_of(plan.robot, rows[k, plan.q_columns], plan.options).holds:
                rows[k, AT.status] = Status.CONSTRAINT_OPEN


def confirmed(plan: Any, q: np.ndarray, T: np.ndarray, kinds: tuple) -> bool:
    """Return whether Pinocchio finds q (n,) inside the tolerances of the target T (4, 4) or (F, 4, 4)."""
    return inside(counted_errors(plan.robot, q, T, kinds, plan.options), plan)


def inside(errors: Any, plan: Any) -> bool:
    """Return whether every tip's errors are within the tolerances of a plan's options; with a priority, those of the first level.

    errors: for each tip the position error [m] and the rotation error [rad, None if free].
    """
    p, r = plan.options.position_tolerance, plan.options.orientation_tolerance
    if plan.options.priority is None:
        return all(position <= p and (angle or 0.0) <= r for position, angle in errors)
    flat = [(error or 0.0) <= most for pair in errors for error, most in zip(pair, (p, r), strict=True)]
    return all(good for good, level in zip(flat, group_levels(plan.robot, plan.options), strict=True) if level == 0)
