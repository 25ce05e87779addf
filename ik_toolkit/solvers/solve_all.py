"""Every distinct solution of one target: from a closed form where one fits, otherwise from many starts."""

from typing import Any

import numpy as np

from ..errors import InvalidOption
from ..kernel.checks import rigid
from ..kernel.records import ANSWER, AT, WEIGHTS
from ..kernel.task import POSE, POSITION
from ..robot.robot import Robot
from .closed_form.finish import finished, listed
from .closed_form.geometry import Family
from .options import COUNTING
from .protocol import Asked
from .registry import GENERAL
from .result import Status
from .solutions import Solutions, SolutionsBatch
from .solve import Solver, _as_pose, bound
from .task import counts_in_part

SAME = 1e-3  # largest joint difference [rad, or of the reach] at which two numerical answers are one
TIGHT = 1e-9  # tolerance of the numerical search: answers to 1e-6 differ too much near singular poses to be merged
FLAT = 1e-4  # singular value (lengths over the scale) below which a direction may lead along a family
STRIDE = 0.02  # rad, or of the scale: step along that direction; an isolated answer is not found again so far away
CLOSE, STEPS = 1e-2, 40  # errors [of the scale, rad] from which numerical answers are finished, and steps given to that
CHOOSING = ("closest", "objective", "history", "follow")  # options about one answer


def solve_all(
    robot: Robot,
    target: Any,
    solver: Any = "auto",
    q0: Any = None,
    *,
    starts: int = 1000,
    count: int = 64,
    **options: Any,
) -> Solutions:
    """Find every distinct solution inside the limits, nearest to q0 (default home) first.

    target: T_base_tip (4, 4), pin.SE3 or a position (3,) [m]. 'auto' uses a closed form where one fits (complete, unless the fit
    is only near or a family exists: `families` says what is free, and the rows are a spread sample of at most `count`) and
    otherwise 'lm' from `starts` random starts, answers a turn or less than 1e-3 apart merged (never proven complete). 'eaik'
    is completed by the same starts. Options as for `solve`, but for closest, objective, follow and history; limits=False
    lists what the limits forbid too. Each is checked with Pinocchio. Raises as `solve` does.
    """
    if not isinstance(robot, Robot):
        raise InvalidOption(f"the first argument is a Robot (see Robot.load), not {type(robot).__name__}")
    for name in CHOOSING:
        if options.get(name):
            raise InvalidOption(f"solve_all lists every solution, nearest to q0 first, so it takes no '{name}'")
    options.setdefault("check", True)
    return find_all(bound(robot, solver, options), target, q0, starts, count)


def find_all(solver: Solver, target: Any, q0: Any, starts: int, count: int) -> Any:
    """Solutions of a target, or SolutionsBatch of (N, 4, 4) or (N, 3) targets, by a bound solver: see `Solver.all`."""
    for name, value in (("starts", starts), ("count", count)):
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise InvalidOption(f"{name} must be a whole number of at least 1, not {value!r}")
    shape = getattr(target, "shape", ())
    if len(shape) == 3 or (len(shape) == 2 and shape[1] == 3):
        return SolutionsBatch([find_all(solver, one, q0, starts, count) for one in target])
    T, kind, notice = _pose_of(target)
    one = solver._closed.get(kind, solver) if solver._closed else solver
    o = one.options
    start = one._home if q0 is None else one._start(q0)[0]
    if one.row.closed:
        found = _listed(one, T, kind, start[0], starts, count)
    else:
        found = _search(one, T, kind, start, starts, count)
    if one.collision is not None and len(found):
        free = np.array([not one.collision.collides(x) for x in found.q], dtype=bool)
        found = found.keep(free)
        found.message += f"; {len(free) - free.sum()} of them collide and are left out" * (not free.all())
    if o.check and len(found):
        what = target if isinstance(kind, tuple) else T[0] if kind == POSE else T[0, :3, 3]
        good = np.array([one.confirm(q, what)[2] for q in found.q], dtype=bool)
        if not good.all():
            found = found.keep(good)
            found.message += f"; {len(good) - good.sum()} are not confirmed by Pinocchio and left out"
    if not len(found):
        failed = one(target, q0)
        if not failed.success:
            found.message = failed.message
        found.families = ()
    if notice:
        found.message = f"{found.message}; {notice}"
    return found


def _pose_of(target: Any) -> tuple[np.ndarray, Any, str]:
    """Any target -> (1, 4, 4), kind and notice; a plain pose that is one costs next to nothing."""
    if type(target) is np.ndarray and target.dtype == np.float64 and target.shape == (4, 4) and target.flags.carray:
        if rigid(target):
            return target[None], POSE, ""
    return _as_pose(target)


def _redundant(one: Solver, kind: Any) -> bool:
    """Whether joints are left over, so that solutions are not isolated; an axis target frees the turn about it."""
    rows = Asked(one.robot, (kind,), options=one.options).rows
    return one.robot.n - len(one.held) > (min(rows, 5) if isinstance(kind, tuple) else rows)


def _prepared(one: Solver, kind: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Options of the kernel, parameters of the closed form, and the box of limits, reference and weights (4, n); kept."""
    kept = one.__dict__.setdefault("_listing", {})
    if kind not in kept:
        robot = one.robot
        opt = one.pack(kind, True)
        free = np.full(robot.n, np.inf)
        lower, upper = (robot.lower, robot.upper) if one.options.limits else (-free, free)
        box = np.vstack([lower, upper, robot.home, 1.0 / robot.chain.unit**2])
        kept[kind] = (opt, opt[WEIGHTS + robot.n :], box)
    return kept[kind]


def _listed(one: Solver, T: np.ndarray, kind: Any, start: np.ndarray, starts: int, count: int) -> Solutions:
    """All legal branches of a closed form, evaluated, nearest to start (n,) first."""
    robot = one.robot
    opt, p, box = _prepared(one, kind)
    box = box.copy()
    box[2] = start
    made = one.rule.every(robot, p, T[0], box, count)
    found = len(made.q)
    table, signs = np.empty((found, 3 + robot.n)), np.empty((found, 3), dtype=np.int8)
    rows, ends = one._chain[:2]
    kept, legal = listed(
        rows, ends, opt, T[0], start, made.fixed, made.steps, made.q, made.broken, made.marks, table, signs
    )
    table, signs = table[:kept], signs[:kept]
    inside = f"{legal} of {found} branches{made.words} are inside the limits"
    message = inside if one.options.limits else f"{found} branches{made.words}"
    if kept < legal:
        message += f", {kept} of which meet the tolerances"
    orientation = None if kind == POSITION else table[:, 1]
    families = made.families if kept else ()
    complete = made.complete
    if families:
        message += f"; a sample of infinitely many: {'; '.join(family.message for family in families)}"
    result = Solutions(
        robot, table[:, 3:], table[:, 2], (table[:, 0], orientation), complete, one.name, message, families, signs
    )
    if made.partial:
        result = _with_search(result, _search(one, T, kind, start[None], starts, count), one)
    if families or made.steps or made.partial:
        result = _distinct(result, one)
    if len(result) > count:
        result = _sample(result, one, count)
        result.complete = False
    return result


def _with_search(first: Solutions, other: Solutions, one: Solver) -> Solutions:
    """Solutions of a closed form that misses some, and those a search adds to them."""
    both = Solutions(
        first.robot,
        np.vstack([first.q, other.q]),
        np.concatenate([first.distance, other.distance]),
        (
            np.concatenate([first.position_error, other.position_error]),
            np.concatenate([first.orientation_error, other.orientation_error]),  # pyright: ignore
        ),
        False,
        one.name,
        "",
        other.families,
        None,
        first.found_by + other.found_by,
    )
    both = _distinct(both, one)
    added = sum(name != one.name for name in both.found_by)
    both.message = f"{first.message}; {added} more by {GENERAL}: {other.message}"
    return both.keep(np.argsort(both.distance, kind="stable"))


def _distinct(found: Solutions, one: Solver) -> Solutions:
    """Without rows that are the same as one before."""
    turning, _ = _turning(one)
    unit = found.robot.chain.unit
    kept: list[int] = []
    for k, q in enumerate(found.q):
        if not kept or _apart(found.q[kept], q, unit, turning).min() >= SAME:
            kept.append(k)
    return found.keep(np.array(kept, dtype=int))


def _apart(Q: np.ndarray, q: np.ndarray, unit: np.ndarray, turning: np.ndarray) -> np.ndarray:
    """Largest joint difference (K,) [rad, or of the scale] of Q (K, n) from q, full turns of turning joints left out."""
    apart = np.abs(Q - q) / unit
    apart[:, turning] = np.minimum(apart[:, turning], np.abs(2 * np.pi - apart[:, turning]))
    return apart.max(axis=1)


def _turning(one: Solver) -> tuple[np.ndarray, bool]:
    """Which joints (n,) may be moved by full turns, and whether inside limits."""
    robot = one.robot
    if (
        not one.options.limits and robot.chain.rows[0, 0] > 0.0
    ):  # no limits, no mimic joints: every angle may be turned over
        return np.array([kind != "prismatic" for kind in robot.joint_kinds]), False
    return robot.chain.turns > 0, one.options.limits


def _sample(found: Solutions, one: Solver, count: int) -> Solutions:
    """At most `count` of the solutions: rows that lie far from one another, the nearest to q0 among them, in order."""
    q = found.q / found.robot.chain.unit
    chosen = [0]
    gap = np.linalg.norm(q - q[0], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(gap)))
        gap = np.minimum(gap, np.linalg.norm(q - q[chosen[-1]], axis=1))
    return found.keep(np.sort(chosen))


def _search(one: Solver, T: np.ndarray, kind: Any, start: np.ndarray, starts: int, count: int) -> Solutions:
    """Distinct converged answers of one attempt from each of many starts, nearest to start (1, n) first."""
    robot, o = one.robot, one.options
    tight = {
        "position_tolerance": min(TIGHT, o.position_tolerance),
        "orientation_tolerance": min(TIGHT, o.orientation_tolerance),
    }
    same = {name: getattr(o, name) for name in ("limits", *COUNTING, "joint_weights", "seed", "max_iterations")}
    rule = GENERAL if one.row.closed else one.rule
    single = Solver(robot, rule, restarts=0, **tight, **same)
    rng = np.random.default_rng(o.seed)
    Q0 = np.vstack([start, [robot.random_q(rng) for _ in range(starts - 1)]]) if starts > 1 else start
    Q0[:, one.held] = start[0, one.held]
    out = _attempts(single, T, kind, Q0)
    if not counts_in_part((kind,), o) and not len(one.held):
        _finish_close(single, T, kind, out)
    out = out[out[:, AT.status] == Status.CONVERGED]
    answers = out[:, ANSWER:]
    turning, limited = _turning(one)
    near = start[0, turning] + np.remainder(answers[:, turning] - start[0, turning] + np.pi, 2 * np.pi) - np.pi
    if limited:
        low, high = robot.lower[turning], robot.upper[turning]
        near += 2 * np.pi * np.clip(0.0, np.ceil((low - near) / (2 * np.pi)), np.floor((high - near) / (2 * np.pi)))
        near = np.clip(near, low, high)  # a turn rounds
    answers[:, turning] = near
    distance = np.sqrt((((answers - start) / robot.chain.unit) ** 2).sum(axis=1))
    orientation = None if kind == POSITION else out[:, AT.rotation]
    errors = out[:, AT.position], orientation
    name = GENERAL if one.row.closed else one.name if one.name != "auto" else one.row.name
    found = Solutions(robot, answers, distance, errors, False, name, "", (), None, (single.row.name,) * len(answers))
    found = _distinct(found, one)
    found = found.keep(np.argsort(found.distance, kind="stable"))
    redundant = _redundant(one, kind)
    found.families = _families(single, found, T, kind, redundant)
    distinct = len(found)
    if (redundant or found.families) and distinct > count:
        found = _sample(found, one, count)
    words = "a sample of infinitely many" if redundant or found.families else "distinct ones"
    found.message = (
        f"{len(found)} solution{'s' * (len(found) != 1)} ({words}) from {starts} starts, {len(out)} of which converged"
    )
    if found.families:
        found.message += f"; {found.families[0].message}"
    return found


def _finish_close(single: Solver, T: np.ndarray, kind: Any, out: np.ndarray) -> None:
    """Give result rows that ended close to the target more steps: at a singular pose an attempt converges slowly."""
    close = (out[:, AT.status] != Status.CONVERGED) & (out[:, AT.position] < CLOSE * single.robot.chain.scale)
    close &= out[:, AT.rotation] < CLOSE
    if not close.any():
        return
    rows, ends = single._chain[:2]
    Q, errors = out[close, ANSWER:], np.empty((close.sum(), 2))
    finished(rows, ends, single.pack(kind, True), T[0], Q, STEPS, errors)
    good = (errors < (single.options.position_tolerance, single.options.orientation_tolerance)).all(axis=1)
    where = np.flatnonzero(close)[good]
    out[where, ANSWER:] = Q[good]
    out[where, AT.position], out[where, AT.rotation], out[where, AT.status] = *errors[good].T, Status.CONVERGED


def _attempts(single: Solver, T: np.ndarray, kind: Any, Q0: np.ndarray) -> np.ndarray:
    """Result rows of one attempt at T (1, 4, 4) from each start Q0 (K, n)."""
    out = np.empty((len(Q0), ANSWER + single.robot.n))
    Q0 = np.ascontiguousarray(Q0)
    single._kernel(
        *single.arrays_for(kind, Q0[:1]),
        np.repeat(T, len(Q0), axis=0),
        Q0,
        out,
        single.pack(kind, True),
        single._silent,
    )
    return out


def _families(single: Solver, found: Solutions, T: np.ndarray, kind: Any, redundant: bool) -> tuple[Family, ...]:
    """Families among numerical solutions: where the Jacobian leaves a direction free and a step along it leads to another.

    A singular pose alone is no family: from beside an isolated solution the search comes back to it.
    """
    robot = found.robot
    if not len(found) or counts_in_part((kind,), single.options):
        names = tuple(robot.joint_names)
        return (Family(names, None, None, "joints are left over"),) if redundant and len(found) else ()
    J = robot.chain.forward(found.q, jacobian=True)[1]
    J[:, :3] /= robot.chain.scale
    J *= robot.chain.unit
    J[:, :, single.held] = 0.0
    moving = np.setdiff1d(np.arange(robot.n), single.held)
    J = J[:, : 3 if kind == POSITION else 6][:, :, moving]
    _, values, directions = np.linalg.svd(J)
    wide = np.zeros((len(J), len(moving)))
    wide[:, : values.shape[1]] = values
    where, which = np.nonzero(wide < FLAT)
    if not len(where):
        return ()
    where, which = where[:256], which[:256]  # enough to name the joints that move
    V = np.zeros((len(where), robot.n))
    V[:, moving] = directions[where, which]
    tried = np.vstack([found.q[where] + sign * STRIDE * V * robot.chain.unit for sign in (1.0, -1.0)])
    if single.options.limits:
        tried = np.clip(tried, robot.lower, robot.upper)
    out = _attempts(single, T, kind, tried)
    turning, _ = _turning(single)
    moved = np.abs(out[:, ANSWER:] - np.vstack([found.q[where]] * 2)) / robot.chain.unit
    moved[:, turning] = np.minimum(moved[:, turning], np.abs(2 * np.pi - moved[:, turning]))
    another = (out[:, AT.status] == Status.CONVERGED) & (moved.max(axis=1) > 0.5 * STRIDE)
    if not another.any():
        return ()
    joints = (moved[another] > 1e-2 * STRIDE).any(axis=0)
    names = tuple(name for name, moves in zip(robot.joint_names, np.atleast_1d(joints), strict=True) if moves)
    return (Family(names, None, None, f"a family of solutions, found numerically: {', '.join(names)} move along it"),)
