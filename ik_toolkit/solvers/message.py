"""The message of a solve: how it ended, in one sentence with what to try."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import FAR_AWAY
from ..kernel.counted_error import KIND
from ..kernel.kinematics import TAU
from ..kernel.records import AT, Ends
from ..robot.configuration import followers_at_limits
from ..text import angle, figure, how_many, length
from .decide import blocked
from .options import GROUPS, PLAIN
from .status import DECIDED, NEAREST, SEARCHED, Status, constraints_of
from .task import all_errors, counted_rows, what_counts

# After a failed pose, the position alone is searched for from ATTEMPTS starts, to say whether the orientation is the obstacle.
ATTEMPTS = 20
# weight of the orientation error while the position of a failed pose is searched for; small, so that position comes first
FAINT = 1e-3

ADVICE = {
    Status.CONVERGED: "",
    Status.STALLED: "try more restarts, another q0, or a looser tolerance",
    Status.ITERATION_LIMIT: "try more iterations where the error still falls, restarts, another q0, or the default solver",
    Status.LIMIT_BLOCKED: "try restarts, another q0 or wider limits",
    Status.UNREACHABLE: "move the target inside the reach",
    Status.SINGULAR: "start from another q0, or use the default solver with restarts",
    Status.NOT_FINITE: "lower the gains",
    Status.CHECK_FAILED: "raise a tolerance below 1e-14 of the reach, which is rounding; else please report this with the "
    "robot and the target",
    Status.TOO_FAR: "move the target in smaller steps, or allow larger moves (follow)",
    Status.CONSTRAINT_OPEN: "try another q0 or target; no solver keeps constraints",
    Status.COLLISION: "try more restarts, another q0, or move the target or the obstacle",
}

# Messages for solves by a closed form. The closest configuration they speak of is the best that the closed form, or the iterative
# search after it, has found.
CLOSED_FORM_SAYS = {
    Status.CONVERGED: "closed form: the branch within limits nearest q0; residual {left}",
    Status.UNREACHABLE: "the target is out of reach by about {beyond}{kept}; the closest configuration found is {left} away{at}",
    Status.LIMIT_BLOCKED: (
        "the target is in reach but {why}; the closest configuration found within limits is "
        "{left} away{at}; widen the limits or move the target"
    ),
}
# statuses with which a search gives up without proof; the message then suggests what to try
SHORT = (Status.STALLED, Status.LIMIT_BLOCKED, Status.ITERATION_LIMIT, Status.SINGULAR)
ASK_LESS = "free what cannot be met (free_turn, mask), or put the position before the orientation (priority)"


def sentence(result: Any) -> str:
    """Return one sentence on how a solve ended and what to try. If several tips failed, it gives the errors left at each."""
    row, status, plan = result._of.row, result.status, result._of.plan
    left, tried = _left(result), how_many(result.restarts + 1, "start")
    if status == Status.CONSTRAINT_OPEN:
        kept = constraints_of(result.robot, result.q, plan.options)
        return f"the tip is {left} from its target, but {kept.text}; {ADVICE[status]}"
    if status == Status.COLLISION:
        # The contact of a row of a batch is looked for afterwards, and is gone if the obstacle was moved in between.
        here = (
            f"here {' and '.join(result.collision)} touch" if result.collision else "what touched here has moved since"
        )
        return f"every solution found from {tried} is in collision; {here}; {ADVICE[status]}"
    if row[AT.excess] <= DECIDED and status != Status.CHECK_FAILED:
        return _decided_says(result, left)
    if plan.row.closed and status in CLOSED_FORM_SAYS and row[AT.excess] != SEARCHED:
        far = status == Status.UNREACHABLE and row[AT.excess] > FAR_AWAY * result.robot.reach
        return _closed_form_says(result, left) + ("; were millimetres meant?" if far else "")
    if status == Status.CONVERGED and (missed := _missed(result)):
        return (
            f"{missed}, the nearest found ({how_many(result.robot.n, 'joint')}; {tried}, {int(row[AT.agreed])} agree)"
        )
    if status == Status.CONVERGED:
        text = f"converged in {how_many(result.iterations, 'iteration')} to {left}"
        return f"{text} after {how_many(result.restarts, 'restart')}" if result.restarts else text
    budget, timeout = plan.options.budget, plan.options.timeout
    if budget and row[AT.evaluations] >= budget and status == Status.ITERATION_LIMIT:
        told = (
            (f"limit of {budget} evaluations", "max_evaluations")
            if timeout is None
            else (f"timeout of {timeout:g} s", "timeout")
        )
        text = f"the {told[0]} was reached after {tried}; closest {left}; raise {told[1]}"
    elif status == Status.ITERATION_LIMIT and plan.options.follow:
        text = f"{left} away after {how_many(result.iterations, 'iteration')}; move the target in smaller steps, or use the tracker"
    else:
        text = f"{_failure(result, left, tried)}; {_cause(result) or _advice(result)}"
    return text + _at_each_tip(result)


def _missed(result: Any) -> str:
    """Say which errors of lower priority are left at q and which are in tolerance, or return '' if all are in tolerance."""
    plan, found = result._of.plan, {True: [], False: []}
    if plan.options.priority is None:
        return ""
    for level in result.level_errors:
        for name, error in level.items():
            turned = name.endswith(GROUPS[1])
            most = plan.options.orientation_tolerance if turned else plan.options.position_tolerance
            met = error <= most
            found[met].append(name if met else f"{name} {angle(error) if turned else length(error)} off")
    met, off = " and ".join(found[True]), ", ".join(found[False])
    return off and f"{met} reached; {off}"


def _decided_says(result: Any, left: str) -> str:
    """Say what the elimination found: a solution, that there is none, or which limit all solutions break."""
    if result._of.row[AT.excess] == NEAREST:
        within = " within the limits" * result._of.plan.options.limits
        return f"the nearest of all solutions{within} (certified by elimination); residual {left}"
    if result.status == Status.CONVERGED:
        return f"found by elimination after {how_many(result.restarts + 1, 'start')} of the search; residual {left}"
    least = blocked(result)
    if least is None:
        said = "no joint values reach this pose, limits or not"
        parts = [f"{said} (certified); closest {left}", position_alone(result, False), ADVICE[Status.UNREACHABLE]]
    else:
        count = least.solutions
        each = (
            f"{count} solutions exist; each breaks a limit" if count > 1 else "one solution exists; it breaks a limit"
        )
        over = [f"{joint} by {much}" for joint, much in _beyond_limits(result.robot, least.q)]
        said = f"{each} (certified); least: {' and '.join(over)}; closest {left} within limits"
        parts = [said, f"widen {'that limit' if len(over) == 1 else 'these limits'}, or free a part of the target"]
    return "; ".join(filter(None, parts))


def _cause(result: Any) -> str:
    """Say what keeps the arm from the target, as far as it is known, and which part of the target it can meet; or return ''."""
    if result.status == Status.UNREACHABLE and max(result._of.excess()) > FAR_AWAY * result.robot.reach:
        return "were millimetres meant?"
    if result.status not in SHORT:
        return ""
    if known := why_missed(result):
        return known
    if result._of.plan.options.priority is not None or result.restarts == 0:
        return ""  # A single attempt may fail for reasons that do not lie in the arm.
    return "; ".join(filter(None, [position_alone(result, False), _advice(result)]))


def why_missed(result: Any) -> str:
    """Return a sentence on which limit, or what in the arm's structure, keeps the tip from the target, and what to try; or ''."""
    if result.status not in SHORT:
        return ""
    # With the option `priority`, errors of lower priority need not be met, so too few joints are not named as the cause.
    ordered = result._of.plan.options.priority is not None
    outside = "" if ordered else _outside(result)
    if outside:
        return outside
    if result.status == Status.LIMIT_BLOCKED:
        return ""
    never, few = impossible(result), "" if ordered else too_few_joints(result)
    if not never and not few:
        return ""
    alone = "" if ordered else position_alone(result, bool(never))
    return "; ".join(filter(None, [*never, few, alone, ASK_LESS]))


def _advice(result: Any) -> str:
    """Say what to try after a failed search; a pose that limits block may also ask for less, a position alone cannot."""
    of, advice = result._of, ADVICE[result.status]
    posed = any(kind not in (KIND.free, KIND.position) for kind in of.kinds)
    less = result.status == Status.LIMIT_BLOCKED and of.plan.options.priority is None and posed
    return f"{advice}, or {ASK_LESS}" if less else advice


def _outside(result: Any) -> str:
    """Say by how much a joint is outside its limits where a short search without limits reaches the target, or return ''."""
    of, robot = result._of, result.robot
    if result.status != Status.STALLED or not result.restarts or not of.plan.options.limits or not of.T.size:
        return ""
    row = of.plan.unlimited.solve(of.T, of.kinds, result.q[None], True)
    over = _beyond_limits(robot, row[of.plan.q_columns])
    if row[AT.status] != Status.CONVERGED or not over:
        return ""
    own, widen = ("its own", "that limit") if len(over) == 1 else ("their own", "these limits")
    each = " and ".join(f"{joint} {much}" for joint, much in over)
    return f"it is reached without joint limits, with {each} outside {own}; widen {widen}, or move the target"


def _beyond_limits(robot: Any, q: np.ndarray) -> list[tuple[str, str]]:
    """Return the joints outside their limits at q (n,) [rad or m], each with how far as text, the farthest first."""
    turns = np.where(robot.chain.turns > 0.0, np.round((q - np.clip(q, robot.lower, robot.upper)) / TAU), 0.0)
    over = np.maximum(robot.lower - (q - TAU * turns), q - TAU * turns - robot.upper)
    said = [length if kind == "prismatic" else angle for kind in robot.joint_kinds]
    return [(robot.joint_names[j], said[j](over[j])) for j in np.argsort(-over, kind="stable") if over[j] > 1e-9]


def _left(result: Any) -> str:
    """Say which errors are left at q; for several tips the largest."""
    each, unit = unweighted(result)
    turned = [angle for _, angle in each if angle is not None]
    return _said(max(position for position, _ in each), max(turned, default=None), unit)


def _said(position: float, turned: float | None, unit: bool) -> str:
    """Say the errors of a tip; unit: True if they are in metres and radians, False if they are weighted numbers."""
    if not unit:
        return "a weighted error of " + figure(position) + ("" if turned is None else f", {figure(turned)}")
    return length(position) + ("" if turned is None else f", {angle(turned)}")


def unweighted(result: Any) -> tuple[list[tuple[float, float | None]], bool]:
    """Return each tip's position and orientation error without the weights of `mask`, and whether they are in [m] and [rad].

    The weights are removed by computing the errors again. That needs the target, which a solved row of a batch does not keep, so
    such errors are returned with the weights, and are then not in metres and radians.
    """
    of = result._of
    counts = what_counts(result.robot, of.plan.options)
    masks = [one.mask for one in counts if one.mask]
    if all(weight in (0.0, 1.0) for mask in masks for weight in mask):
        return of.left(), True
    if not of.T.size:  # a solved row of a batch keeps no target
        return of.left(), False
    mask = {
        tip: None if one.mask is None else tuple(float(weight > 0.0) for weight in one.mask)
        for tip, one in zip(result.robot.tips, counts, strict=True)
    }
    each = all_errors(result.robot, result.q, of.T, of.kinds, replace(of.plan.options, mask=mask))
    return [(position, angle) for _, position, angle in each], True


def _at_limits(result: Any) -> str:
    """Name the joints at a limit, each with the mimic joints that keep it there."""
    held = followers_at_limits(result.robot, result.q) if result.limited_joints else {}
    return ", ".join(
        joint + (f" with its follower {' and '.join(held[joint])}" if joint in held else "")
        for joint in result.limited_joints
    )


def _at_each_tip(result: Any) -> str:
    """Say the errors left at each of several tips that have a target, or return ''."""
    if len(result.robot.tips) == 1:
        return ""
    each, unit = unweighted(result)
    left = [
        f"{tip} {_said(*errors, unit).replace(',', '')}"
        for tip, kind, errors in zip(result.robot.tips, result._of.kinds, each, strict=True)
        if kind != KIND.free
    ]
    return f"; remaining error at each tip: {', '.join(left)}"


def _closed_form_says(result: Any, left: str) -> str:
    row, robot = result._of.row, result.robot
    joints = _at_limits(result)
    beyond = length(float(row[AT.excess]), 4)
    slides = [j for j, kind in zip(robot.joint_names, robot.joint_kinds, strict=True) if kind == "prismatic"]
    return CLOSED_FORM_SAYS[result.status].format(
        left=left,
        beyond=beyond,
        why=f"the stroke of {', '.join(slides)} is {beyond} too short"
        if row[AT.excess] > 0.0
        else "every branch violates a joint limit",
        kept="" if result.position_only else " with its orientation kept",
        at=f", with {joints} at a limit" if joints else "",
    )


def _too_far(arm: Any, point: np.ndarray) -> float:
    """Return by how much [m] a position (3,) in the base frame lies outside an arm's reach, whatever the orientation there."""
    ends = Ends(arm.chain.ends, arm.n)
    x, y, z = ends.flat[:9].reshape(3, 3).T @ (point / ends.scale() - ends.flat[9:12])
    low, high = ends.bound(4), ends.bound(5)
    near, far = z - min(max(z, low), high), max(abs(z - low), abs(z - high))
    worst = max(math.hypot(x, y, near) - ends.bound(0), ends.bound(1) - math.hypot(x, y, far))
    return float(ends.scale() * worst)


def _failure(result: Any, left: str, tried: str) -> str:
    """Say how a search failed, without the advice."""
    row, status, robot = result._of.row, result.status, result.robot
    if status == Status.UNREACHABLE:
        # The bound may be that of the wrist at the target's orientation; with another one the tip may then come nearer.
        beyond = [
            f"{arm.tip} by {length(x)}{' with its orientation kept' * (x > _too_far(arm, T[:3, 3]))}"
            for arm, x, T in zip(robot.arms, result._of.excess(), result._of.T.reshape(-1, 4, 4), strict=True)
            if x > 0
        ]
        if len(robot.tips) == 1:
            by = beyond[0].removeprefix(robot.tips[0])
            return f"the target is beyond reach{by} (a bound from the link lengths); closest {left} after {tried}"
        return f"beyond reach: {', '.join(beyond)} (a bound from the link lengths)"
    if status == Status.TOO_FAR:
        joint, far = int(row[AT.held]), result._of.plan.options.follow
        most = length(far * robot.reach) if robot.joint_kinds[joint] == "prismatic" else angle(far, deg=False)
        return f"{left} away when joint {robot.joint_names[joint]} reached the {most} it may move from q0"
    if status == Status.STALLED and result.restarts:
        return f"closest {left} after {tried}"
    stopped = _at_limits(result) if status in (Status.STALLED, Status.LIMIT_BLOCKED) else ""
    at = f" with {stopped} at a limit" if stopped else ""
    if status == Status.STALLED and result._of.plan.descends:
        return f"no further progress{at} at {left} from the target: a local minimum of the error"
    if status == Status.STALLED:  # A published method may end elsewhere than at the best configuration it found.
        return f"no further progress{at}: the search came to rest, and the nearest it came to the target is {left}"
    if status == Status.LIMIT_BLOCKED:
        return f"joint limits ({stopped}) block the target, which is reached without them; closest {left} after {tried}"
    if status == Status.ITERATION_LIMIT and result.restarts:
        return f"closest {left} after {tried}, each cut off by the limit of iterations"
    if status == Status.ITERATION_LIMIT:
        return f"{left} away after {how_many(result.iterations, 'iteration')}"
    if status == Status.SINGULAR:
        return f"singular: no joint motion reduces the error to first order (J'e = 0, or J has no inverse); {left} away"
    if status == Status.NOT_FINITE:
        return "the solver diverged; best configuration returned"
    return "the kernel reports success but Pinocchio does not confirm it"


def impossible(result: Any) -> list[str]:
    """Return a sentence for each part of a tip's target that no joint values can meet."""
    of = result._of
    if not of.T.size:  # a solved row of a batch keeps no target
        return []
    found, o, counts = [], of.plan.options, what_counts(result.robot, of.plan.options)
    counted = counted_rows(result.robot, of.kinds, o).reshape(-1, 2, 3)
    for arm, kind, T, one, (lengths, angles) in zip(
        result.robot.arms, of.kinds, of.T.reshape(-1, 4, 4), counts, counted, strict=True
    ):
        first = {group for tip, group in o.priority[0] if tip in ("", arm.tip)} if o.priority else set(GROUPS)
        free, of_base = kind[1] if isinstance(kind, tuple) else one.free_turn, False
        # Two of three rotation errors count, so `mask` or `slack` leaves the turn about one axis free.
        if free is None and angles.sum() == 2:
            free, of_base = np.where(angles, 0.0, 1.0), one.frame == "base"
        if kind == KIND.free or o.relative_to or not first:
            continue
        turned = GROUPS[1] in first and angles.sum() >= 2
        weights = np.array(one.mask or (1.0,) * 6).reshape(2, 3)
        tolerances = [
            (tolerance + np.linalg.norm(np.where(rows, dead, 0.0))) / max(weight[rows].min(initial=1.0), 1e-12)
            for tolerance, rows, dead, weight in zip(
                (o.position_tolerance, o.orientation_tolerance),
                (lengths, angles),
                np.reshape(one.slack or (0.0,) * 6, (2, 3)),
                weights,
                strict=True,
            )
        ]
        if GROUPS[0] not in first or not lengths.all():
            tolerances[0] = np.inf
        at = f"{arm.tip}: " if len(of.kinds) > 1 else ""
        never = arm.mobility.never(T if turned else T[:3, 3], tuple(tolerances), free, of_base)
        found += [at + text for text in never]
    return found


def too_few_joints(result: Any) -> str:
    """Return a sentence that the target fixes more directions than the arm can move in, or ''."""
    of, texts = result._of, []
    rows = counted_rows(result.robot, of.kinds, of.plan.options).reshape(-1, 2, 3).sum(axis=2)
    for arm, (lengths, angles) in zip(result.robot.arms, rows.tolist(), strict=True):
        # An error component that no joint changes is not counted among those that need a joint: it is either zero, or `impossible`
        # names it as the cause.
        still = {0: 3, 1: 2, 3: 0}.get(arm.mobility.turns, 0)
        fixed = max(0, lengths - len(arm.mobility.normals)) + max(0, angles - still)
        able = arm.mobility.directions
        if fixed > able:
            name = "the arm" if len(rows) == 1 else arm.tip
            joints = how_many(arm.n, "joint")
            moves = "" if able == arm.n else f", which move the tip in {able} directions"
            texts.append(f"{name} has {joints}{moves}, and the target fixes {fixed} directions")
    return "; ".join(texts)


def position_alone(result: Any, turned: bool) -> str:
    """Return a sentence that the position of a failed pose can be reached, with the orientation error left there; or ''.

    turned: whether another sentence already tells the orientation error, which is then left out.
    """
    of = result._of
    if of.kinds != (KIND.pose,) or not of.T.size or of.plan.options.in_part:
        return ""
    plain: dict[str, Any] = {**PLAIN, "max_evaluations": None, "timeout": None, "follow": 0.0}
    both, q = of.plan.search(mask=(1.0, 1.0, 1.0, FAINT, FAINT, FAINT), restarts=ATTEMPTS - 1, **plain), result.q
    # The first search leaves a little of the position error, for the sake of the orientation; the second removes it.
    for plan, kinds in ((both, of.kinds), (of.plan.search(restarts=0, **plain), (KIND.position,))):
        row = plan.solve(of.T, kinds, q[None], True)
        q = row[plan.q_columns]
    if row[AT.status] != Status.CONVERGED:
        return ""
    ((raw, _, _),) = all_errors(result.robot, q, of.T, of.kinds, both.options)
    if turned:
        return "the position alone can be reached"
    nearest = angle(float(np.linalg.norm(raw[3:])))
    return f"the position alone can be reached; the nearest orientation found there is {nearest} off"
