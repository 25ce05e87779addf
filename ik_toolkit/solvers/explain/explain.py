"""Makes an explanation: the closed form that fits, its solution for the target, and the path of an iterative solver."""

from dataclasses import replace
from typing import Any

import numpy as np

from ...errors import InvalidTarget, MissingExtra
from ...kernel.counted_error import KIND
from ...kernel.records import AT, SIZE
from ..closed_form import fits
from ..options import Options
from ..outcome import SolveRecord
from ..plan import Plan
from ..postprocess import record
from ..protocol import Asked, refusal
from ..registry import GENERAL, find_row
from ..status import SEARCHED
from ..task import counts_in_part
from .dh_table import dh_of
from .explanation import Explanation, Iterations
from .worked_solution import WorkedSolution, nearest_branch

# A solution (branch) listed by the package EAIK is shown if its position error over the reach is below NEARLY. Near singular poses
# errors of that size are usual, and Newton steps correct them.
NEARLY = 1e-3
# The answer counts as one of the closed form's solutions (branches) if it differs from it by less than SAME [rad, or length over
# the reach]. If the robot fits the form only approximately, Newton steps have moved it by about that much.
SAME = 1e-6


def explain_result(result: Any) -> Explanation:
    """Return the Explanation of a Result: D-H table, closed form with its numbers, branches and iterations.

    Raises InvalidTarget for a result that keeps no target (a solved row of a batch), MissingExtra if SymPy is not installed.
    """
    of = result._of
    if not of.T.size:
        raise InvalidTarget("a solved row of a batch keeps no target; solve that target alone to get an explanation")
    plan, robot, q = of.plan, of.plan.robot, result.q.copy()
    form, why = _form_of(of)
    solution, chosen, errors, source = None, None, (), ""
    if form is not None:
        solution = _derived(form, of, q)
        target = of.T[0] if of.kinds == (KIND.pose,) else of.T[0][:3, 3]
        # EAIK, a closed form whose formulas are not shown, may list solutions that miss the target
        if not solution.steps:
            kept = [branch for branch in solution.branches if robot.errors(branch.q, target)[0] < NEARLY * robot.reach]
            solution = solution._replace(branches=tuple(kept))
        nearest, apart = nearest_branch(robot, solution.branches, q)
        chosen = nearest if apart < SAME else None
        errors = tuple(robot.errors(branch.q, target) for branch in solution.branches)
        source = form.row.citation
    iterations = None
    if not plan.row.closed or of.row[AT.excess] == SEARCHED:
        # The closed form failed and an iterative search found the answer. The search is run again to show its iterations.
        iterations = _iterations(_run(of, plan.search()) if plan.row.closed else of, type(result))
    elif solution is not None and solution.beside:
        iterations = _iterations(_beside(of, solution.beside), type(result))
    targets = {
        tip: T if kind == KIND.pose else T[:3, 3]
        for tip, T, kind in zip(robot.tips, of.T.reshape(-1, 4, 4), of.kinds, strict=True)
        if kind != KIND.free
    }
    tables = {arm.tip: dh_of(arm) for arm in robot.arms}
    name = form.row.name if form is not None else ""
    return Explanation(
        robot, q, result.message, targets, tables, solution, name, source, why, chosen, errors, iterations
    )


def _form_of(of: SolveRecord) -> tuple[Plan | None, str]:
    """Return the Plan of the closed form to show, the one that solved or one that fits, or None; also return why there is none."""
    plan, robot = of.plan, of.plan.robot
    if plan.row.closed:
        return plan, ""
    if len(robot.tips) > 1:
        return None, "Closed forms are for one tip; several tips are solved together by iteration."
    if counts_in_part(of.kinds, plan.options) or of.kinds[0] not in (KIND.pose, KIND.position):
        why = "Only part of a pose or position is required, so no closed form applies: the solution is found by iteration."
        return None, why
    name = fits(robot, of.kinds[0])
    if name is None:
        what = f"No closed form of the toolkit fits '{robot.name}' and this kind of target"
        return None, f"{what}, so the solution is found by iteration."
    row = find_row(name)
    # The closed form is only written out, not used to solve, so options that it would refuse (closest, follow, priority) are left
    # out.
    return Plan(robot, row, row.load()(), Options(limits=plan.options.limits)), ""


def _derived(form: Plan, of: SolveRecord, q: np.ndarray) -> WorkedSolution:
    """Write out the closed form for the target; free joints keep their values in the answer q (n,)."""
    robot = form.robot
    box = np.vstack([form.box, q, 1.0 / robot.chain.unit**2])
    numbers = form.orders(of.kinds, True)[SIZE.weights + robot.n :]
    try:
        return form.rule.derive(robot, numbers, of.T[0], box)
    except ModuleNotFoundError as error:
        if error.name != "sympy":
            raise
        raise MissingExtra("sympy", "explain") from None


def _beside(of: SolveRecord, name: str) -> SolveRecord:
    """Run another solver on the same target, from the same start, in one attempt.

    If that solver does not take the task, the general one runs.
    """
    robot, options = of.plan.robot, replace(of.plan.options, restarts=0, history=False)
    row = find_row(name)
    if refusal(row, row.load()(), Asked(robot, of.kinds, of.given, options)):
        row = find_row(GENERAL)
    plan = Plan(robot, row, row.load()(), options)
    made = _run(of, plan)
    if not made.row[AT.iterations]:  # a solve that starts at the answer itself makes no iterations that could be shown
        start = robot.random_q(np.random.default_rng(0))
        made = _run(of._replace(q0=start.tobytes()), plan)
    return made


def _run(of: SolveRecord, plan: Plan) -> SolveRecord:
    row = plan.solve(of.T, of.kinds, of.start, of.given)
    return of._replace(plan=plan, row=row, notice="", errors=None, history=None)


def _iterations(of: SolveRecord, read: Any) -> Iterations:
    """Return the errors and q of every evaluation in the attempt that gave the answer.

    read: function that makes a Result from a SolveRecord.
    """
    made = of if of.history is not None else record(of)
    history, result = made.history, read(made)
    assert history is not None
    shown = history["attempt"] == result.attempt
    position, orientation, q = (history[name][shown] for name in ("position_error", "orientation_error", "q"))
    return Iterations(result.solver, result.success, result.message, result.attempt, position, orientation, q)
