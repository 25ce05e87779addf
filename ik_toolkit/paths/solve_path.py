"""`solve_path`: from poses to one joint motion."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from time import perf_counter
from typing import Any, Unpack

import numpy as np

from ..compile.jit import compile_time
from ..errors import Interrupted, InvalidOption, InvalidTarget, check_progress, whole
from ..kernel.checks import RIGID
from ..kernel.counted_error import KIND
from ..motion.reference import Reference
from ..robot.constraints import first_open
from ..robot.pose import LAST
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.batch.solve_batch import available_cores
from ..solvers.batch.targets import blocks, doubt_far, known, mended, with_free_turns
from ..solvers.collision_free import collision_model
from ..solvers.message import why_missed
from ..solvers.options import Options, PathOptions, avoided
from ..solvers.outcome import SPOKEN
from ..solvers.plan import Plan
from ..solvers.solve import Solver, require_robot
from ..solvers.task import kernel_tasks
from ..text import angle, length
from .finish import Terms, collapsed, finished, fraction, gaps, inserted
from .freedom import errors_at_rows, freedom
from .path_problem import (
    STEP,
    HalfTurns,
    Problem,
    all_reached,
    follower_of,
    nearest_poses,
    read_pair,
    read_path_tolerance,
)
from .path_search import Search
from .result import PathResult, PathStatus, Reconfiguration, path_sentence

# Largest number of further searches, each with rotations by 180 degrees reversed where the path breaks.
OTHER_WAYS = 4
DT = 0.01  # sampling interval of a Reference [s]
EXACT = 1e-13  # An exact rotation matrix R has entries of R'R - 1 below this; rounding is 1e-15.
NOT_HERE = (
    "closest", "objective", "history", "follow", "check", "max_evaluations", "timeout", "restarts", "max_iterations", "q0_outside",
)  # fmt: skip


class PathInterrupted(Interrupted):
    """Raised at Ctrl-C during a path search; `result` is the PathResult of the best path so far."""


def solve_path(
    robot: Robot | Tree,
    poses: Any,
    *,
    q0: Any = None,
    q_end: Any = None,
    max_step: Any = None,
    path_tolerance: Any = None,
    avoid_collisions: Any = False,
    reconfigurations: str | int = "fewest",
    seed: int = 0,
    threads: int | None = None,
    progress: Callable[[float, str], None] | None = None,
    **options: Unpack[PathOptions],
) -> PathResult:
    """Find one joint motion through poses, with the fewest reconfigurations and then the shortest found.

    Args:
        robot: a Robot, or a Tree of F tips.
        poses: (N, 4, 4), or (N, 3) with free orientation [m, base frame]; for a Tree (N, F, 4, 4), (N, F, 3) or a
            dict by tip; or a Reference, which is sampled every 0.01 s.
        q0: (n,) [rad or m], the start of the path if it reaches the first pose, else a configuration to start near.
        q_end: (n,) [rad or m], likewise for the end and the last pose.
        max_step: largest step of a joint between rows, (rad, m) or one number for both; default 7 deg and 20 mm.
            Longer steps are divided by inserted rows, up to 200,000 rows in all.
        path_tolerance: how far (m, rad) a tip may leave the interpolated pose between two poses. Default: 1 mm and
            1 deg, or twice the tolerances at the poses if that is more.
        avoid_collisions: as for `solve`.
        reconfigurations: 'fewest', 'none', or the largest number of changes of branch.
        seed: number that fixes the random starts.
        threads: number of threads; default all cores.
        progress: function (fraction, text) that is called regularly.
        options: as for `solve`: tolerances, limits, mask, slack, free_turn, frame, priority, relative_to,
            joint_weights. With a priority the path leads through the poses if all their levels can be met. Otherwise it leads
            through the nearest poses that one posture reaches; these are the result's `targets`, but its errors are still
            measured from the poses asked for.

    Returns:
        The best motion found. That a path cannot be followed is a status of the result.

    Raises:
        InvalidTarget: a pose is not valid; the message names it.
        InvalidConfiguration: q0 or q_end is not valid.
        InvalidOption: an option is not valid.
        PathInterrupted: Ctrl-C; its `result` is the best path so far (KeyboardInterrupt if there is none yet).
    """
    began = perf_counter()
    require_robot(robot)
    allowed = _allowed(reconfigurations)
    _check(options, progress)
    poses, options = with_free_turns(robot, poses, options)
    solver = Solver(robot, seed=seed, **options)
    robot, seed = solver.robot, solver.options.seed  # This robot may have narrower limits; a seed of 1.0 is now 1.
    T, kinds = _read(robot, poses)
    tolerance = read_path_tolerance(path_tolerance, solver.options)
    terms = Terms(read_pair("max_step", max_step, STEP), tolerance, path_tolerance is not None, allowed)
    model = None if (asked := avoided(avoid_collisions)) is False else collision_model(robot, asked)
    q0, q_end, notice = _ends(solver.plan_for(kinds), q0=q0, q_end=q_end)
    wanted, places, met, follower = None, None, None, None
    if solver.options.priority is not None:
        given = dict(
            q0=q0, q_end=q_end, max_step=max_step, path_tolerance=path_tolerance, avoid_collisions=avoid_collisions,
            reconfigurations=reconfigurations, seed=seed, threads=threads, progress=progress,
        )  # fmt: skip
        wanted = T, solver.options
        met, solver, follower, T, places = _by_levels(solver, T, kinds, poses, given, options)
        if met is not None and not met.reconfigurations:
            return _against(met, None, notice)
    turns = HalfTurns(T.reshape(len(T), -1, 4, 4), kinds, solver.options.orientation_tolerance)
    threads = available_cores() if threads is None else whole(threads, "threads")

    def fresh(between: bool = True, longer: int = 1) -> Search:
        poses, at, most = turns.poses(), places, (longer * terms.step[0], longer * terms.step[1])
        if at is None and between and not freedom(solver.plan_for(kinds), kinds).lacks:
            poses, at = inserted(robot, poses, kinds)
        problem = Problem(solver, poses.reshape(-1, *robot.pose_shape), kinds, most, terms.tolerance, q0, at, follower)
        ends = [None if q is None else q / problem.unit for q in (q0, q_end)]
        return Search(problem, model, ends[0], ends[1], threads, seed, progress or _silent)

    search = fresh()
    try:
        search.run()
        for _ in range(OTHER_WAYS):
            if wanted is not None or not turns.turn_round(gaps(search.problem.at, search.found.breaks)):
                break
            other = fresh()
            other.run()
            if other.worth() >= search.worth():
                break
            search = other
        if search.found.breaks and len(turns.gaps):
            search.lower_bound = None  # With rotations reversed, fewer reconfigurations might do.
        search.progress(0.9, "shortening and verifying the path")
        made = _result(search, terms, began)
        settled = made.status in (PathStatus.FOLLOWED, PathStatus.COLLISION) or made.unreachable
        if wanted is None and (search.found.breaks or not settled) and len(search.problem.T) > len(T):
            # Near a singular pose a motion that misses poses inserted by the search may still keep the path tolerance.
            other = fresh(between=False, longer=int(np.bincount(search.problem.at[:-1].astype(int)).max()))
            other.run()
            _share_bound(search, other)
            both = (_result(one, terms, began) for one in (search, other))
            made = min(both, key=lambda one: (not one.success, len(one.reconfigurations)))
        return _against(_fewer(met, made), wanted, notice)
    except KeyboardInterrupt:
        if search.found is None:
            if not search.tracks.size:
                raise
            search.progress = _silent
            search.link()
        made = _result(search, terms, began, refine=False)
        raise PathInterrupted(_against(made, wanted)) from None


def _check(options: Mapping[str, Any], progress: Any) -> None:
    """Raise InvalidOption for an option that a path does not take, or a progress that cannot be called."""
    for name in NOT_HERE:
        if name in options:
            raise InvalidOption(
                f"solve_path takes no '{name}': a path is searched as a whole, and its results are checked"
            )
    check_progress(progress, "a fraction and a text")


def _by_levels(solver: Solver, T: np.ndarray, kinds: tuple, poses: Any, given: dict, options: Mapping) -> tuple:
    """Return a path that meets all levels or None, a Solver of whole poses, a Plan with priorities, poses in reach, their places.

    The Solver counts whole poses: what a mask or a free turn leaves free stays as it is at the nearest poses, because with other
    values other poses would be the nearest.
    """
    kernel_tasks(solver.robot, kinds, solver.options)  # refuses a priority without effect on such targets
    robot, exact = solver.robot, {**options, "priority": None, "slack": None}
    strict, met = Solver(robot, seed=given["seed"], **exact), None
    if not freedom(strict.plan_for(kinds), kinds).lacks or all_reached(strict, T, kinds, given["q0"]):
        made = solve_path(robot, poses, **given, **exact)
        met = made if made.success else None
    dense, places = inserted(robot, T.reshape(len(T), -1, 4, 4), kinds)
    if met is None or met.reconfigurations:
        T = nearest_poses(solver, dense.reshape(-1, *robot.pose_shape), kinds, given["q0"])
    all_counts = {name: value for name, value in exact.items() if name not in ("mask", "free_turn", "frame")}
    return met, Solver(robot, seed=given["seed"], **all_counts), follower_of(solver.plan_for(kinds)), T, places


def _fewer(met: PathResult | None, made: PathResult) -> PathResult:
    """Return the path on which every level is met, unless it needs more reconfigurations than the other one."""
    if met is None or (made.success and len(made.reconfigurations) < len(met.reconfigurations)):
        return made
    return met


def _ends(plan: Plan, **given: Any) -> tuple[np.ndarray | None, np.ndarray | None, str]:
    """Return q0 and q_end (n,), inside the limits, or None, and a notice. Raises InvalidConfiguration."""
    found = [(None, "") if q is None else plan.check_start(q, name) for name, q in given.items()]
    first, last = (None if q is None else q[0] for q, _ in found)
    return first, last, "; ".join(notice for _, notice in found if notice)


def _share_bound(search: Search, other: Search) -> None:
    """Combine the proven bounds of two searches, so that they hold both with and without the inserted poses."""
    bounds = [one.lower_bound for one in (search, other) if one.lower_bound is not None]
    search.lower_bound = other.lower_bound = min(1, *bounds) if len(bounds) == 2 else None


def _silent(share: float, words: str) -> None:
    """Do nothing; this is the progress function if the caller gives none."""


# --------------------------------------------------------------------------------------------------------------- reading
def _allowed(value: str | int) -> float:
    """Return the largest number of reconfigurations allowed, infinite for 'fewest'. Raises InvalidOption."""
    if isinstance(value, str) and value in ("fewest", "none"):
        return math.inf if value == "fewest" else 0.0
    return whole(value, "reconfigurations must be 'fewest' or 'none', or", 0)


def _read(robot: Any, poses: Any) -> tuple[np.ndarray, tuple]:
    """Read the caller's poses; return them as (N, 4, 4), or (N, F, 4, 4) for a Tree, with their kind for each tip.

    Raises InvalidTarget, which names the pose.
    """
    if isinstance(poses, Reference):
        made = poses.at(poses.times(DT))[0]
        poses = made[:, :3, 3] if poses.position_only else made
    given = known(poses, robot.base)
    chunks: Iterator[Any] = iter([given]) if given is not None else iter(poses)
    parts = list(blocks(chunks, robot))
    if not sum(part.rows for part in parts):
        raise InvalidTarget("a path needs at least one pose")
    kinds = parts[0].kinds
    T = np.concatenate([part.poses(0, part.rows) for part in parts])
    doubt_far(robot, T)
    for t in np.flatnonzero(~_exact(T).reshape(len(T), -1).all(axis=1)).tolist():
        T[t] = mended(T[t], kinds, robot.tips, t)
    return T, kinds


def _exact(T: np.ndarray) -> np.ndarray:
    """Return which of the poses T (..., 4, 4) need no correction: rigid to rounding, and nearer than RIGID.far."""
    R = T[..., :3, :3]
    with np.errstate(invalid="ignore", over="ignore"):  # Poses that are not finite compare as not exact.
        off = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(axis=(-1, -2))
        there = np.abs(T[..., :3, 3]).max(axis=-1) < RIGID.far
        return there & (off < EXACT) & (np.linalg.det(R) > 0.0) & (T[..., 3, :] == LAST).all(axis=-1)


# --------------------------------------------------------------------------------------------------------------- results
def _result(search: Search, terms: Terms, began: float, refine: bool = True) -> PathResult:
    """Return the PathResult for the best path of a search, verified and, if `refine`, shortened.

    began: start of the search by `perf_counter` [s].
    """
    problem = search.problem
    motion = collapsed(finished(search, terms, refine), problem.at)
    found, kept, q = search.found, motion.found, motion.q
    asked = problem.at == np.round(problem.at)
    poses, T = problem.poses[asked], problem.T[asked]
    # The bound counts breaks between inserted poses, but several between the same two requested poses are one reconfiguration. So
    # only "at least one" is proven.
    least = search.lower_bound
    least = least if least is None or asked.all() else min(least, 1)
    errors = errors_at_rows(problem.robot, q, T, problem.kinds, problem.single.options)
    missing = tuple(search.unreachable())
    moves = tuple(Reconfiguration(k, q[k + 1] - q[k]) for k in kept.breaks)
    needed = max(len(gaps(problem.at, found.breaks)), len(moves) + (not missing and bool(np.isnan(q).any())))
    if needed > terms.allowed or missing:
        status = PathStatus.INCOMPLETE
    elif found.contacts or motion.continuity.contacts:
        status = PathStatus.COLLISION
    else:
        status = PathStatus.RECONFIGURES if moves else PathStatus.FOLLOWED
    result = PathResult(
        robot=problem.robot, targets=poses, kinds=problem.kinds, options=problem.single.options, q=q, status=status,
        message="", position_error=errors[:, 0],
        orientation_error=None if all(kind in SPOKEN for kind in problem.kinds) else errors[:, 1], curve=motion.curve,
        at=motion.at, continuity=motion.continuity, reconfigurations=moves, lower_bound=least,
        unreachable=missing, max_step=terms.step, path_tolerance=terms.tolerance, tolerance_given=terms.given,
        collision=search.model, seed=problem.solver.options.seed, elapsed=perf_counter() - began - compile_time(began),
        fraction=1.0 if status == PathStatus.FOLLOWED else fraction(search, motion),
    )  # fmt: skip
    # The cause comes from solving the first pose that is not reached. With a priority the pose itself need not be reached, so that
    # solve could fail for another cause.
    plain = problem.follower is problem.single
    cause = _cause(problem, T[missing[0].index]) if missing and plain else ""
    result = replace(result, message=path_sentence(result, needed, terms.allowed, cause))
    o = problem.single.options
    broken = first_open(problem.robot, q, o.position_tolerance, o.orientation_tolerance) if result.success else None
    if broken is None:
        return result
    message = f"{result.message}; but at pose {broken[0]} {broken[1]}"
    return replace(result, status=PathStatus.CONSTRAINT_OPEN, message=message)


def _cause(problem: Problem, T: np.ndarray) -> str:
    """Say why a pose T (4, 4) or (F, 4, 4) is not reached, as far as a solve of it alone can tell; or return ''."""
    robot = problem.robot
    each = zip(robot.tips, problem.kinds, T.reshape(-1, 4, 4), strict=True)
    target = {tip: one[:3, 3] if kind == KIND.position else one for tip, kind, one in each if kind != KIND.free}
    return why_missed(problem.solver(robot.for_tips(target)))


def _against(made: PathResult, wanted: tuple[np.ndarray, Options] | None, notice: str = "") -> PathResult:
    """Return the path; if it leads through nearest poses, with its errors from the poses asked for, and a longer message.

    wanted: the poses asked for and the options that say which errors count, or None.
    """
    if notice:
        made = replace(made, message=f"{made.message}; {notice}")
    if wanted is None:
        return made
    errors = errors_at_rows(made.robot, made.q, wanted[0], made.kinds, wanted[1])
    if np.isnan(errors).all():
        return made
    worst, o = np.nanmax(errors, axis=0), wanted[1]
    if (worst > (o.position_tolerance, o.orientation_tolerance)).any():
        off = f"up to {length(worst[0])} and {angle(worst[1])} off the poses asked for, the nearest found by their priority"
        made = replace(made, message=f"{made.message}; {off}")
    orientation = None if made.orientation_error is None else errors[:, 1]
    return replace(made, position_error=errors[:, 0], orientation_error=orientation)
