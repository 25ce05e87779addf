"""Finds distinct solutions by search: one attempt from each of many starts, with equal answers merged."""

from typing import Any, NamedTuple

import numpy as np

from ..kernel.checks import CODE
from ..kernel.kinematics import RATIO, TAU
from ..kernel.records import AT
from ..text import how_many
from .closed_form.geometry import Family
from .options import PLAIN
from .outcome import SPOKEN
from .plan import Plan
from .protocol import Asked
from .solutions import Solutions
from .task import counted_errors, counted_jacobian, group_levels

ONE_ATTEMPT: dict[str, Any] = {
    **PLAIN,
    "restarts": 0,
    "max_evaluations": None,
    "timeout": None,
    "wrap": None,
    "follow": 0.0,
}


class SearchThresholds(NamedTuple):
    """Thresholds of the numerical search for all solutions of a target; angles in rad, lengths divided by the robot's reach."""

    # two solutions are the same if no joint differs by more than `same` [rad, or length / reach]
    same: float = 1e-3
    # tolerance to which each solution is computed [rad, or length / reach]; with 1e-6, equal solutions near singular poses
    # would differ too much to be merged
    tight: float = 1e-9
    # along a direction of the Jacobian with a singular value below `flat`, the arm may move while the tip stays (self-motion)
    flat: float = 1e-4
    # length [rad] of a trial step along a possible self-motion; it must be so long that, from an isolated solution, a search that
    # begins at its end comes back to that solution
    stride: float = 0.02
    directions: int = 256  # number of directions tried for self-motions, enough to find all joints that move


THRESHOLDS = SearchThresholds()


def search_solutions(
    plan: Plan, T: np.ndarray, kinds: tuple, start: np.ndarray, starts: int, count: int, Q0: np.ndarray | None = None
) -> Solutions:
    """Return the distinct solutions of a target that a search finds from many starts, the nearest to start (1, n) first.

    One attempt is made from each start. The starts are Q0 (K, n) or, if that is None, `start` and random ones, `starts` in all. T
    (1, 4, 4), or (1, F, 4, 4) for several tips: the target; kinds: its kinds; count: largest number of solutions returned if
    there are infinitely many.
    """
    robot, o = plan.robot, plan.options
    tight = {
        "position_tolerance": min(THRESHOLDS.tight, o.position_tolerance),
        "orientation_tolerance": min(THRESHOLDS.tight, o.orientation_tolerance),
    }
    single = (plan.search if plan.row.closed else plan.varied)(**ONE_ATTEMPT, **tight)
    rng = np.random.default_rng(o.seed)
    if Q0 is None:
        Q0 = np.vstack([start, [robot.random_q(rng) for _ in range(starts - 1)]]) if starts > 1 else start
        Q0[:, plan.held] = start[0, plan.held]
    out = _attempts(single, T, kinds, Q0)
    out = out[out[:, AT.status] == CODE.converged]
    answers = out[:, single.q_columns]
    turning, limited = turning_joints(plan)
    near = start[0, turning] + np.remainder(answers[:, turning] - start[0, turning] + np.pi, 2 * np.pi) - np.pi
    if limited:
        low, high = robot.lower[turning], robot.upper[turning]
        near += 2 * np.pi * np.clip(0.0, np.ceil((low - near) / (2 * np.pi)), np.floor((high - near) / (2 * np.pi)))
        near = np.clip(near, low, high)  # rounding in the line above may move a joint beyond a limit
    answers[:, turning] = near
    distance = np.sqrt((((answers - start) / robot.chain.unit) ** 2).sum(axis=1))
    orientation = None if all(kind in SPOKEN for kind in kinds) else out[:, AT.rotation]
    errors = out[:, AT.position], orientation
    found = Solutions(robot, answers, distance, errors, False, single.row.name, "")
    found = distinct_rows(found, plan)
    found = found.keep(np.argsort(found.distance, kind="stable"))
    if o.priority is not None:
        return _minima(found, plan, kinds, T, f"({len(out)} of {starts} starts converged)", count)
    found._put(families=_families(single, found, T, kinds))
    # If there are more joints than the target needs, there are infinitely many solutions, and a spread sample of them is returned.
    free = robot.n - len(plan.held) > Asked(robot, kinds, options=o).rows
    if (free or found.families) and len(found) > count:
        found = spread_rows(found, count)
    many = f"{how_many(len(found), 'solution')} of infinitely many"
    words = many if free or found.families else how_many(len(found), "distinct solution")
    curves = "".join(f"; {family.message}" for family in found.families)
    found._put(message=f"{words} ({len(out)} of {starts} starts converged){curves}")
    return found


def _minima(found: Solutions, plan: Plan, kinds: tuple, T: np.ndarray, words: str, count: int) -> Solutions:
    """Return local minima of errors in order of priority, the least first; other starts may lead to more."""
    levels = group_levels(plan.robot, plan.options)
    o = plan.options
    least = [o.position_tolerance, o.orientation_tolerance] * len(kinds)

    def rank(q: np.ndarray) -> list[float]:
        errors = [error or 0.0 for pair in counted_errors(plan.robot, q, T[0], kinds, o) for error in pair]
        over = [error if error > most else 0.0 for error, most in zip(errors, least, strict=True)]
        return [sum(x for x, level in zip(over, levels, strict=True) if level == c) for c in range(max(levels) + 1)]

    ranks = [rank(q) for q in found.q]
    found = found.keep(np.array(sorted(range(len(found)), key=ranks.__getitem__)[:count], dtype=int))
    plural = "minima" if len(found) != 1 else "minimum"
    found._put(message=f"{len(found)} local {plural} of the errors in order of priority, the least first {words}")
    return found


def _attempts(single: Plan, T: np.ndarray, kinds: tuple, Q0: np.ndarray) -> np.ndarray:
    """Return the result rows of one attempt at T (1, 4, 4) from each start Q0 (K, n)."""
    out = np.empty((len(Q0), single.width))
    single.run(np.repeat(T, len(Q0), axis=0), kinds, np.ascontiguousarray(Q0), True, out)
    return out


def _families(single: Plan, found: Solutions, T: np.ndarray, kinds: tuple) -> tuple[Family, ...]:
    """Find self-motions: solutions at which the Jacobian leaves a direction free, along which a step leads to another solution.

    An isolated singular solution has no self-motion: after the step the search returns to it.
    """
    robot = found.robot
    if not len(found):
        return ()
    J = counted_jacobian(robot, found.q, T[0], kinds, single.options) * robot.chain.unit
    moving = np.setdiff1d(np.arange(robot.n), single.held)
    J = J[:, :, moving]
    _, values, directions = np.linalg.svd(J)
    wide = np.zeros((len(J), len(moving)))
    wide[:, : values.shape[1]] = values
    where, which = np.nonzero(wide < THRESHOLDS.flat)
    if not len(where):
        return ()
    where, which = where[: THRESHOLDS.directions], which[: THRESHOLDS.directions]
    V = np.zeros((len(where), robot.n))
    V[:, moving] = directions[where, which]
    tried = np.vstack([found.q[where] + sign * THRESHOLDS.stride * V * robot.chain.unit for sign in (1.0, -1.0)])
    if single.options.limits:
        tried = np.clip(tried, robot.lower, robot.upper)
    out = _attempts(single, T, kinds, tried)
    turning, _ = turning_joints(single)
    began = np.vstack([found.q[where]] * 2)
    moved = _apart(out[:, single.q_columns], began, robot.chain.unit, turning)
    another = (out[:, AT.status] == CODE.converged) & (moved.max(axis=1) > 0.5 * THRESHOLDS.stride)
    if not another.any():
        return ()
    joints = (moved[another] > 1e-2 * THRESHOLDS.stride).any(axis=0)
    names = tuple(name for name, moves in zip(robot.joint_names, np.atleast_1d(joints), strict=True) if moves)
    who = "all joints move" if len(names) == robot.n else f"{', '.join(names)} {'move' if len(names) > 1 else 'moves'}"
    return (Family(names, None, None, f"a family of solutions, found numerically: {who} along it"),)


def distinct_rows(found: Solutions, plan: Plan) -> Solutions:
    """Return the solutions without those that equal an earlier one to within `SearchThresholds.same`, angles modulo 2 pi."""
    turning, _ = turning_joints(plan)
    unit = found.robot.chain.unit
    kept: list[int] = []
    for k, q in enumerate(found.q):
        if not kept or _apart(found.q[kept], q, unit, turning).max(axis=1).min() >= THRESHOLDS.same:
            kept.append(k)
    return found.keep(np.array(kept, dtype=int))


def _apart(Q: np.ndarray, q: np.ndarray, unit: np.ndarray, turning: np.ndarray) -> np.ndarray:
    """Return the differences (K, n) [rad, or length over the scale] of joint values Q from q (n,) or (K, n), modulo 2 pi."""
    apart = np.abs(Q - q) / unit
    apart[:, turning] = np.minimum(apart[:, turning], np.abs(2 * np.pi - apart[:, turning]))
    return apart


def turning_joints(plan: Plan) -> tuple[np.ndarray, bool]:
    """Return for each joint (n,) whether its value counts modulo 2 pi, and whether a shift by 2 pi must keep it inside limits.

    A joint may be shifted if everything that it moves turns with it, mimic joints by a whole multiple of its angle.
    """
    robot, limited = plan.robot, plan.options.limits
    ratio, owner, turns = robot.chain.rows[:, [4, 8, 9]].T
    turning = robot.upper - robot.lower >= TAU - 1e-9 if limited else np.ones(robot.n, dtype=bool)
    turning[owner[(turns == 0.0) | (np.abs(ratio - np.round(ratio)) > RATIO)].astype(int)] = False
    return turning, limited


def spread_rows(found: Solutions, count: int) -> Solutions:
    """Choose at most `count` solutions that are far from one another, including the one nearest to q0; their order is kept."""
    q = found.q / found.robot.chain.unit
    chosen = [0]
    gap = np.linalg.norm(q - q[0], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(gap)))
        gap = np.minimum(gap, np.linalg.norm(q - q[chosen[-1]], axis=1))
    return found.keep(np.sort(chosen))
