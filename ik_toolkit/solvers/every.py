"""Lists every solution of a target: from a closed form if one fits, otherwise from many starts."""

from itertools import product
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidOption, whole
from ..kernel.checks import is_rigid
from ..kernel.counted_error import AXIS, KIND
from ..kernel.elimination.binding import make_arm
from ..kernel.kinematics import TAU
from ..kernel.records import SIZE
from ..robot.rotation import rpy_matrix
from ..text import how_many
from ..validate import FLOAT, switch
from .closed_form.elimination import forms_of, solutions_of
from .closed_form.geometry import SNAP, Family, into_limits, read_screws
from .closed_form.polish import BORDER, list_branches
from .collision_free import collision_model
from .enumerate import distinct_rows, search_solutions, spread_rows, turning_joints
from .plan import Plan
from .postprocess import confirmed
from .self_motion import END, FOLLOWING, SelfMotion, self_motions, slicings_of
from .solutions import Solutions, SolutionsBatch
from .status import constraints_of
from .task import POSES, Counts, read_target, what_counts

# The arm is reported as singular at the end of a self-motion if the smallest singular value of its Jacobian [m] is below SINGULAR.
SINGULAR = 1e-3
# Two solutions are the same if no joint differs by more than APART [rad]. For a position with free orientation, the elimination
# lists each solution twice.
APART = 1e-6


class CertainLists(NamedTuple):
    """The solutions of N poses as arrays, certified to be complete; `solutions(k)` makes the `Solutions` object of one pose."""

    plan: Plan
    # whether the lists can be returned as they are: no check of collisions, constraints or by Pinocchio is asked for
    final: bool
    # (M, 3 + n) a row for each solution: position error [m], rotation error [rad], distance from q0, q [rad]
    table: np.ndarray
    # (N, .) for each pose the index of its first row in `table`, the number of its rows, and the evidence that no solution is
    # missing (see `list_certain`)
    notes: np.ndarray
    notice: str  # text that says that q0 was clamped, or ""

    def rows(self, k: int) -> np.ndarray:
        """Return the rows of `table`, one for each solution, that belong to pose number k."""
        first, kept = self.notes[k, :2].tolist()
        return self.table[int(first) : int(first + kept)]

    def solutions(self, k: int, notice: str = "") -> Solutions | None:
        """Return the Solutions of pose k, with `notice` in their message, or None if its list is not certified to be complete."""
        first, kept, *evidence = self.notes[k].tolist()
        if kept < 0.0:
            return None
        rows, found = self.table[int(first) : int(first + kept)], int(evidence[0])
        inside = f"{int(kept)} of {found} branches are inside the limits"
        words = inside if self.plan.options.limits else how_many(found, "branch")
        words = f"{words}; {notice}" if notice else words
        made = rows[:, 3:], rows[:, 2], (rows[:, 0], rows[:, 1])
        return Solutions(self.plan.robot, *made, True, self.plan.row.name, words, certificate=evidence)


def find_all(solver: Any, target: Any, q0: Any, starts: int, count: int, all_turns: bool = False) -> Any:
    """Find all solutions, for `Solver.all`: Solutions for one target, a SolutionsBatch for targets (N, 4, 4) or (N, 3)."""
    starts, count, all_turns = whole(starts, "starts"), whole(count, "count"), switch(all_turns, "all_turns")
    if isinstance(target, list | tuple):  # may be a list of targets, or one target as nested lists
        each_one = [getattr(one, "homogeneous", one) for one in target]
        target = np.array(each_one) if {getattr(one, "shape", 0) for one in each_one} in ({(4, 4)}, {(3,)}) else target
    # one target of a robot with several tips (Tree) has one more axis than that of a Robot
    shape, places = getattr(target, "shape", ()), int(solver.robot.by_tip)
    several = isinstance(shape, tuple) and len(shape) == 3 + places - (shape[-1:] == (3,))
    plan = solver.lister if is_plain(solver, target, several) else None
    if not several:
        made = _certain(plan, target[None], q0, count) if plan and target.flags.carray else None
        if made and made.final and q0 is None and not all_turns and made.notes[0, 1] > 0.0:
            return made.solutions(0)
        return _find(solver, target, q0, starts, count, all_turns, made)
    each, lists = [], []
    if plan:
        target = np.require(target, requirements=["C", "W"])  # numba would compile again for any other layout
    for a in range(0, len(target), 1024):  # the answers for 1024 targets take 5 MB
        some = target[a : a + 1024]
        made = _certain(plan, some, q0, count) if plan else None
        lists.append(made)
        each += [None] * len(some)
        listed = made.notes[:, 1] > 0.0 if made and made.final and not all_turns else np.zeros(len(some), dtype=bool)
        for k in np.flatnonzero(~listed).tolist():
            each[a + k] = _find(solver, some[k], q0, starts, count, all_turns, made, k)
    return SolutionsBatch(each, lists)


def is_plain(solver: Any, target: Any, several: bool) -> bool:
    """Return whether `target` needs no conversion: an array of floats with a pose (4, 4) or, if `several`, with poses (N, 4, 4)."""
    return type(target) is np.ndarray and target.dtype is FLOAT and target.shape[several:] == solver._pose == (4, 4)


def _find(
    solver: Any, target: Any, q0: Any, starts: int, count: int, all_turns: bool, lists: CertainLists | None, k: int = 0
) -> Solutions:
    """Find Solutions of one target; lists: the result of `_certain`, in which this target is number k, or None."""
    T, kinds, notice = _read(solver, target)
    lister = solver.lister if kinds == POSES else None
    plan = lister or solver.plan_for(kinds)
    o = plan.options
    start, clamped = (plan.home, "") if q0 is None else plan.check_start(q0)
    notice = "; ".join(filter(None, (notice, clamped)))
    if lists is None and lister:
        lists = _certain(lister, T, q0, count)
    found, sliced = lists.solutions(k) if lists else None, ""
    if found is None and plan.row.closed:
        found = _listed(plan, T, kinds, start[0], starts, count)
    elif found is None and solver.name == "auto" and o.priority is None:
        found = listed_with_free_turns(plan, T, kinds, start, count)
        if found is None and kinds == POSES:
            found, sliced = on_self_motions(plan, T, start, count)
    if found is None:
        found = search_solutions(plan, T, kinds, start, starts, count)
    found = on_all_turns(found, plan, T[0], kinds, start[0], count) if all_turns else found
    listed = len(found)
    # a margin of 0.0 [m] is a request, too
    if o.avoid_collisions is not False and len(found):
        model = collision_model(plan.robot, o.avoid_collisions)
        found = _without(found, [not model.collides(x) for x in found.q], "of them collide and are left out")
    if o.check:
        certain, good = found.certificate is None, [confirmed(plan, q, T[0], kinds) for q in found.q]
        found = _without(found, good, "are not confirmed by Pinocchio and left out", certain)
    if plan.robot.constraints:
        kept = [constraints_of(plan.robot, q, o).holds for q in found.q]
        found = _without(found, kept, "do not keep the constraints of the description and are left out")
    if len(found) > count:
        found = found.keep(np.arange(len(found)) < count)
        found._put(message=f"{found.message}, the {count} nearest are listed (count)")
    if not len(found):
        failed = solver(target, q0)
        if failed.success:
            # The solver found a solution that is not in the list: it lies on a self-motion between the listed samples, or beside an
            # exact solution that breaks a limit by less than the tolerances.
            turned = None if failed.orientation_error is None else np.array([failed.orientation_error])
            errors = np.array([failed.position_error]), turned
            distance = np.linalg.norm((failed.q - start) / plan.robot.chain.unit, axis=1)
            found = Solutions(plan.robot, failed.q[None], distance, errors, False, failed.solver, failed.message)
        elif not (listed and found.complete):  # The message of a complete list says already why it is empty.
            found._put(message=f"{failed.message}; none in {sliced}" if sliced else failed.message)
        found._put(families=())
    if notice:
        found._put(message=f"{found.message}; {notice}")
    return found


def _without(found: Solutions, good: list[bool], why: str, whole: bool = True) -> Solutions:
    """Return the solutions that are good; if `whole`, a complete list still counts as complete, as one of all good solutions."""
    if all(good):
        return found
    kept = found.keep(np.array(good))
    kept._put(message=f"{found.message}; {good.count(False)} {why}", complete=found.complete and whole)
    return kept


def on_all_turns(found: Solutions, plan: Plan, T: np.ndarray, kinds: tuple, start: np.ndarray, count: int) -> Solutions:
    """Return the solutions with every multiple of 2 pi added to each joint that its limits allow, nearest to start (n,) first.

    At most `count` are returned. Where two solutions merge, they are known only to about 1e-7 rad, so one just beyond a limit is
    put on the limit and kept if it meets the tolerances.
    """
    robot = plan.robot
    if not plan.options.limits:
        raise InvalidOption("all_turns lists the full turns inside the limits, so it cannot be given with limits=False")
    low, high, rows, Q = robot.lower - BORDER, robot.upper + BORDER, [], []
    turning = np.flatnonzero(turning_joints(plan)[0] & np.isfinite(low) & np.isfinite(high))
    lost = False
    for k, q in enumerate(found.q):
        first, last = np.ceil((low - q) / TAU)[turning], np.floor((high - q) / TAU)[turning]
        for turns in product(*(np.arange(a, b + 1.0) for a, b in zip(first, last, strict=True))):
            shifted = q.copy()
            shifted[turning] += TAU * np.array(turns)
            legal = np.clip(shifted, robot.lower, robot.upper)
            moved = np.abs(legal - shifted).max()
            if moved <= SNAP or confirmed(plan, legal, T, kinds):
                rows.append(k)
                Q.append(legal)
            else:
                lost |= moved < APART
    every = found.keep(np.array(rows, dtype=int))
    every._put(q=np.array(Q).reshape(-1, robot.n))
    every._put(distance=np.linalg.norm((every.q - start) / robot.chain.unit, axis=1))
    order = np.argsort(every.distance, kind="stable")
    complete = found.complete and len(Q) <= count and not lost
    cut = f", the {count} nearest are listed (count)" if len(Q) > count else ""
    every._put(message=f"{every.message}; {len(Q)} on all full turns{cut}", complete=complete)
    return every.keep(order[:count])


def _read(solver: Any, target: Any) -> tuple[np.ndarray, Any, str]:
    """Return the target as an array (1, ...), its kinds and a notice; a valid pose array is passed on at once."""
    if is_plain(solver, target, False) and target.flags.carray and is_rigid(target):
        return target[None], POSES, ""
    return read_target(solver.robot, target)


def _prepared(plan: Plan, kinds: tuple) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the compiled code's options, the closed form's parameters, and the box (4, n) of limits, reference and weights."""
    kept = plan.memo
    if kinds not in kept:
        robot, opt = plan.robot, plan.orders(kinds, True)
        box = np.vstack([plan.box, robot.home, 1.0 / robot.chain.unit**2])
        kept[kinds] = (opt, opt[SIZE.weights + robot.n :], box)
    return kept[kinds]


def _certain(plan: Plan, T: np.ndarray, q0: Any, count: int) -> CertainLists:
    """Return the certified lists of the poses T (N, 4, 4), each of at most `count` solutions, by the elimination's plan.

    Their Solutions are what `_listed` returns, in less time.
    """
    if "certain" not in plan.memo:
        (opt, p, box), o = _prepared(plan, POSES), plan.options
        final = o.avoid_collisions is False and not (o.check or plan.robot.constraints)
        plan.memo["certain"] = opt, p, box, forms_of(p.tobytes()), final
    opt, p, box, forms, final = plan.memo["certain"]
    notice = ""
    if q0 is not None:
        start, notice = plan.check_start(q0)
        box = box.copy()
        box[2] = start
    table, notes = plan.rule.certain(plan.chain, forms, p, opt, T, box, count)
    return CertainLists(plan, final, table, notes, notice)


def _listed(plan: Plan, T: np.ndarray, kinds: tuple, start: np.ndarray, starts: int, count: int) -> Solutions:
    """List all branches of a closed form within limits, evaluated, nearest to start (n,) first."""
    robot = plan.robot
    opt, p, box = _prepared(plan, kinds)
    box = box.copy()
    box[2] = start
    made = plan.rule.every(robot, p, T[0], box, count)
    found = len(made.q)
    table, signs = np.empty((found, 3 + robot.n)), np.empty((found, 3), dtype=np.int8)
    rows, ends = plan.chain[:2]
    kept, legal = list_branches(
        rows, ends, opt, T[0], start, (made.fixed, made.steps, made.q, made.broken, made.marks), table, signs
    )
    table, signs = table[:kept], signs[:kept]
    inside = f"{legal} of {found} branches{made.words} are inside the limits"
    message = inside if plan.options.limits else f"{how_many(found, 'branch')}{made.words}"
    if kept < legal:
        message += f", {kept} of which meet the tolerances"
    orientation = None if kinds == (KIND.position,) else table[:, 1]
    families = made.families if kept else ()
    complete = made.complete and (kept == legal or made.certificate is None)
    if families:
        message += f"; a sample of infinitely many: {'; '.join(family.message for family in families)}"
    result = Solutions(
        robot, table[:, 3:], table[:, 2], (table[:, 0], orientation), complete, plan.row.name, message, families, signs
    )
    if made.partial:
        result = _with_search(result, search_solutions(plan, T, kinds, start[None], starts, count), plan)
    if families or made.partial or (made.steps and not complete):
        result = distinct_rows(result, plan)
    if families and len(result) > count:
        result = spread_rows(result, count)
    if made.certificate is not None:
        result._put(branches=None)  # Solutions by elimination are not labelled by shoulder, elbow and wrist.
        result._put(certificate=made.certificate._replace(status="FAMILY") if result.families else made.certificate)
    return result


def _with_search(first: Solutions, other: Solutions, plan: Plan) -> Solutions:
    """Add the solutions that a search found (`other`) to those of a closed form that may miss some (`first`)."""
    names = ("q", "distance", "position_error", "orientation_error")
    q, away, position, turned = (np.concatenate([getattr(first, name), getattr(other, name)]) for name in names)
    by = first.found_by + other.found_by
    both = Solutions(first.robot, q, away, (position, turned), False, plan.row.name, "", other.families, found_by=by)
    both = distinct_rows(both, plan)
    added = sum(name != plan.row.name for name in both.found_by)
    both._put(message=f"{first.message}; {added} more by {other.solver}: {other.message}")
    return both.keep(np.argsort(both.distance, kind="stable"))


# ------------------------------------------------------------------------------------------------------------- free rotations
# The elimination solves arms of six revolute joints. A rotation that the target leaves free acts like one more revolute joint at
# the tip. So it also solves five revolute joints with one free rotation, and three revolute joints with a position, which leaves
# three rotations free.
def free_axes(plan: Plan, kinds: tuple) -> np.ndarray | None:
    """Return the tip axes (M, 3) about which the target leaves rotation free; None if it leaves anything else free, or nothing."""
    robot, (counts, *others) = plan.robot, what_counts(plan.robot, plan.options)
    if others or robot.pose_shape != (4, 4) or counts != Counts(None, None, counts.free_turn, counts.frame):
        return None
    if kinds == (KIND.position,):
        # a position leaves three rotations free, about any three axes that are not coplanar
        return rpy_matrix((0.3, -0.5, 0.8)) if counts.free_turn is None else None
    if kinds == POSES:
        return None if counts.free_turn is None else np.array([counts.free_turn])
    return np.array([kinds[0][1]]) if kinds[0][0] == AXIS and counts.free_turn is None else None


def loop_of(plan: Plan, kinds: tuple) -> np.ndarray | None:
    """Return the array (52,) of `make_arm` for an arm with each free rotation of its target added as a revolute joint at the tip.

    Returns None unless joints and free rotations are six in all.
    """
    robot, axes = plan.robot, free_axes(plan, kinds)
    if axes is None or robot.n + len(axes) != 6 or len(plan.held) or robot.slides.any():
        return None
    screws = read_screws(robot.chain)
    if isinstance(screws, str) or robot.mobility.directions < robot.n or robot.mobility.moves < 3:
        return None  # not for an arm whose tip moves in a plane, which has infinitely many solutions or none
    lines = np.vstack([screws.axis, axes @ screws.T[:3, :3].T])
    points = np.vstack([screws.point, np.repeat(screws.T[None, :3, 3], len(axes), axis=0)])
    return make_arm(lines, points, screws.T)


def listed_with_free_turns(plan: Plan, T: np.ndarray, kinds: tuple, start: np.ndarray, count: int) -> Solutions | None:
    """List all solutions within limits of a target T (1, 4, 4) that leaves rotations free; None if the list is not certified.

    The nearest to start (1, n) comes first, and at most `count` are listed. Each free rotation counts as a joint of the arm (see
    `loop_of`).
    """
    if (key := ("virtual joints", kinds)) not in plan.memo:
        plan.memo[key] = loop_of(plan, kinds)
    arm = plan.memo[key]
    if arm is None:
        return None
    said = solutions_of(arm, T[0])
    if said.certificate.status != "CERTAIN":
        return None
    robot, each = plan.robot, []
    for q in said.q[:, : plan.robot.n]:
        if not any(np.abs((q - other + np.pi) % (2 * np.pi) - np.pi).max() < APART for other in each):
            each.append(q)
    Q = np.array(each).reshape(-1, robot.n)
    q, excess = np.empty_like(Q), np.empty_like(Q)
    into_limits(Q, np.vstack([plan.box, start]), q, excess)
    worst = excess.max(axis=1, initial=0.0)
    if ((worst > 0.0) & (worst < BORDER)).any():
        return None  # Rounding decides whether this solution is inside the limit, so the list cannot be certified.
    legal = q[worst == 0.0]
    found = search_solutions(plan, T, kinds, start, 0, count, legal)
    if len(found) != len(legal) or found.families:
        return None
    found._put(
        complete=True, solver="elimination", found_by=("elimination",) * len(found),
        certificate=said.certificate._replace(solutions=len(Q)),
        message=f"{len(legal)} of {len(Q)} branches are inside the limits",
    )  # fmt: skip
    return found


def on_self_motions(plan: Plan, T: np.ndarray, start: np.ndarray, count: int) -> tuple[Solutions | None, str]:
    """Return samples of a seven-joint arm's self-motions at T (1, 4, 4) as Solutions, or None, and a text on what was searched."""
    robot, cuts = plan.robot, slicings_of(plan)
    where = " and of ".join(robot.joint_names[cut.joint] for cut in cuts)
    where = where and f"{FOLLOWING.slices} slices of {where}"
    # A self-motion of length zero, which occurs where joints are at their limits, is an isolated solution.
    curves = [
        one for one in (self_motions(plan, T[0]) if cuts else []) if (one.upper - one.lower).max() > FOLLOWING.same
    ]
    if not curves:
        return None, where
    box, rows = plan.box, []
    for curve in curves[:count]:
        Q, excess = np.empty_like(curve.points), np.empty_like(curve.points)
        into_limits(curve.points, np.vstack([box, start]), Q, excess)
        some = np.linspace(0, len(Q) - 1, max(1, count // len(curves) - 1)).round().astype(int)
        rows.append(Q[np.unique([*some, np.linalg.norm(Q - start, axis=1).argmin()])])
    found = search_solutions(plan, T, POSES, start, 0, count, np.clip(np.vstack(rows), *box))
    if not len(found):
        return None, where
    said = f"{how_many(len(found), 'solution')} on {how_many(len(curves), 'curve')} of infinitely many"
    said += f", found in {where}; there may be others"
    families = tuple(family_of(robot, curve) for curve in curves)
    found._put(families=families, solver="elimination", found_by=("elimination",) * len(found), message=said)
    return found, where


def family_of(robot: Any, curve: SelfMotion) -> Family:
    """Return a self-motion curve as a Family, with the range of the joint that moves most along it."""
    width = curve.upper - curve.lower
    order = [int(i) for i in np.argsort(-width, kind="stable") if width[i] > FOLLOWING.same]
    names, lead = robot.joint_names, order[0]
    low, high = float(curve.lower[lead]), float(curve.upper[lead])
    if curve.ends[0][0] == END.closed:
        ends = "a closed curve"
    else:
        said = []
        for (kind, joint), q in zip(curve.ends, (curve.points[0], curve.points[-1]), strict=True):
            side = "lower" if joint >= 0 and q[joint] - robot.lower[joint] < robot.upper[joint] - q[joint] else "upper"
            at = {END.limit: f"at the {side} limit of {names[joint]}"}
            if np.linalg.svd(robot.jacobian(q) * robot.chain.unit, compute_uv=False)[-1] < SINGULAR:
                at[END.singular] = "where the arm is singular"
            said.append(at.get(kind, "where it was not followed further"))
        ends = f"a curve that ends {' and '.join(said)}"
    said = f"{ends}; {names[lead]} from {low:.4g} to {high:.4g} rad"
    if robot.upper[lead] - robot.lower[lead] >= TAU and (low < robot.lower[lead] or high > robot.upper[lead]):
        said += ", where whole turns lead back into its limits"
    return Family(tuple(names[i] for i in order), low, high, said)
