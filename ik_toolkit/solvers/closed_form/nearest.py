"""Solves with a closed form that only lists branches: of those that meet the tolerances, the one nearest the start is chosen."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ...compile.jit import cached
from ...kernel.checks import CODE, is_rigid
from ...kernel.kinematics import room
from ...kernel.limits import LIGHTEST
from ...kernel.records import AT, ORDER, SIZE, copy
from .geometry import copy_limits, measure_tip
from .polish import polish

SAMPLE = 64  # number of samples to list of a self-motion (a continuum of solutions)


def nearest_of(form: Any, robot: Any) -> Callable:
    """Return the solve function of a closed form that only lists its solutions (`form.every`): the nearest good one is chosen.

    It is called as `protocol.ClosedForm.loop` says. A failure is no proof that the target has no solution.
    """

    def solve(rows, ends, seeds, feat, T, Q0, out, opt, hist) -> None:
        n = robot.n
        numbers, unit = opt[SIZE.weights + n :], robot.chain.unit
        weights = 1.0 / (np.maximum(opt[SIZE.weights : SIZE.weights + n], LIGHTEST) * unit**2)
        free = np.full(n, np.inf)
        lower, upper = (robot.lower, robot.upper) if opt[ORDER.limits] else (-free, free)
        for t in range(len(T)):
            q0 = Q0[t if len(Q0) > 1 else 0]
            if not is_rigid(T[t]):
                out[t, AT.status] = CODE.bad_target
                continue
            near = q0 if opt[ORDER.given] else robot.home
            made = form.every(robot, numbers, T[t], np.vstack([lower, upper, near, weights]), SAMPLE)
            choose(rows, ends, T[t], made.q, made.steps, made.fixed, q0, opt, hist, out[t])

    return solve


@cached
def choose(rows, ends, T, Q, steps, fixed, q0, opt, hist, out):
    """Refine solutions (branches) Q (K, n) of a target T (4, 4) by Newton steps, and write the best one to the result row `out`.

    The best is, of those within the tolerances, the one nearest the start q0 (or home if no q0 is given); if there is none, the
    one with the smallest error. rows, ends, opt: geometry, limits and options of the chain; steps, fixed: as for `polish`; hist:
    a row of history, or none.
    """
    n = Q.shape[1]
    box = np.empty((4, n))
    if not copy_limits(ends, opt, q0, box):
        out[0] = CODE.bad_start
        return
    q, best = np.empty(n), box[2].copy()
    least, near, spent = np.inf, np.inf, 0
    for k in range(Q.shape[0]):
        for i in range(n):
            q[i] = min(max(Q[k, i], box[0, i]), box[1, i])
        left = opt[ORDER.evaluations] - 1.0 - spent  # one evaluation is reserved for computing the errors of the answer
        position, rotation, count = polish(rows, ends, opt, T, q, fixed, steps, left)
        spent += count
        error = max(position / opt[ORDER.tol_p], rotation / opt[ORDER.tol_r])
        error = 0.0 if position < opt[ORDER.tol_p] and rotation < opt[ORDER.tol_r] else error
        distance = 0.0
        for i in range(n):
            distance += box[3, i] * (q[i] - box[2, i]) ** 2
        if error < least or (error == least and distance < near):
            least, near = error, distance
            copy(q, best)
    goal, joints, trig = np.empty(12), np.empty(room(n)[0]), np.zeros(room(n)[1])
    measure_tip(rows, ends, opt, T, best, box, 0.0, 0.0, 0.0, goal, joints, trig, hist, out)
    out[AT.evaluations] += spent
