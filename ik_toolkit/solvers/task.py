"""Targets as the compiled search takes them, and which part of their errors counts, there and in Pinocchio's check."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidOption, InvalidTarget, near_match
from ..kernel.counted_error import AXES, AXIS, KIND
from ..kernel.records import Task
from ..robot.pose import AxisTarget, check_target, errors
from ..robot.ros import is_by_name
from .options import COUNTING, GROUPS, Options

POSES = (KIND.pose,)  # kinds of target (one per tip) for the usual case: one tip, a whole pose
WHOLE = frozenset((KIND.pose, KIND.position))
ALL = (1.0,) * 6
NONE = (0.0,) * 6


class Counts(NamedTuple):
    """Which parts of a tip's pose error count (see `Options`): weights and dead bands (6,), a free axis of the tip, the frame."""

    mask: tuple[float, ...] | None
    slack: tuple[float, ...] | None
    free_turn: tuple[float, ...] | None
    frame: str


# ----------------------------------------------------------------------------------------------------------- what counts
def what_counts(robot: Any, o: Options) -> tuple[Counts, ...]:
    """Return for each tip which part of its pose error counts, according to the options.

    Raises InvalidOption for an unknown tip, or if nothing counts.
    """
    every = []
    for name in COUNTING:
        value = getattr(o, name)
        if isinstance(value, Mapping):
            for tip in value:
                if tip not in robot.tips:
                    raise InvalidOption(
                        f"{name}: '{tip}' is not one of the tips solved for.{near_match(tip, robot.tips)}"
                    )
        default = "base" if name == "frame" else None
        every.append([value.get(tip, default) if isinstance(value, Mapping) else value for tip in robot.tips])
    counts = tuple(Counts(*one) for one in zip(*every, strict=True))
    for tip, one in zip(robot.tips, counts, strict=True):
        if one.slack is not None and not any(_counting(one, KIND.pose)):
            raise InvalidOption(
                f"{_at(robot, tip)}slack {one.slack} leaves nothing that counts; leave the tip out instead"
            )
    return counts


def relatives(robot: Any, o: Options) -> tuple[int, ...]:
    """Return for each tip the index of the tip in whose frame its target is given (option relative_to), or -1 for the base.

    Raises InvalidOption for unknown tips, and for tips that are relative to each other in a circle.
    """
    if o.relative_to is None:
        return (-1,) * len(robot.tips)
    if len(robot.tips) == 1:
        raise InvalidOption("relative_to is for robots with several tips (ik.Tree.load)")
    for tip in (tip for pair in o.relative_to.items() for tip in pair):
        if tip not in robot.tips:
            raise InvalidOption(f"relative_to: '{tip}' is not one of the tips solved for.{near_match(tip, robot.tips)}")
    for tip in o.relative_to:
        seen = [tip]
        while seen[-1] in o.relative_to:
            seen.append(o.relative_to[seen[-1]])
            if seen[-1] in seen[:-1]:
                circle = " -> ".join(seen[seen.index(seen[-1]) :])
                raise InvalidOption(f"relative_to is circular: {circle}; one of them needs a target of its own")
    return tuple(robot.tips.index(o.relative_to[tip]) if tip in o.relative_to else -1 for tip in robot.tips)


def group_levels(robot: Any, o: Options) -> tuple[int, ...]:
    """Return the priority (2 F,) of each tip's position and orientation as a number; 0 is the highest, and all are 0 by default.

    Raises InvalidOption for an unknown tip, or errors named twice.
    """
    order: tuple = o.priority or ()
    level: dict[tuple[str, str], int] = {}
    for c, groups in enumerate(order):
        for name, group in groups:
            if name and name not in robot.tips:
                near = near_match(name, (*GROUPS, *robot.tips))
                raise InvalidOption(f"priority: '{name}' is neither position, orientation nor a tip solved for.{near}")
            for tip in [name] if name else robot.tips:
                if (tip, group) in level:
                    raise InvalidOption(f"priority names the {group} of {tip} twice")
                level[tip, group] = c
    return tuple(level.get((tip, group), len(order)) for tip in robot.tips for group in GROUPS)


def counts_in_part(kinds: tuple, o: Options) -> bool:
    """Return whether anything but whole poses and positions is requested, which closed forms do not solve."""
    return o.in_part or not WHOLE.issuperset(kinds)


def counted_rows(robot: Any, kinds: tuple, o: Options) -> np.ndarray:
    """Return for each of the F tips' six errors whether it counts (6 F,); the option `frame` is taken as 'base'.

    If the turn about one axis is free, two of a tip's three rotation errors count.
    """
    return np.concatenate([_counting(one, kind) for one, kind in zip(what_counts(robot, o), kinds, strict=True)])


def _counting(counts: Counts, kind: Any) -> np.ndarray:
    """Return whether each of a tip's six errors counts (6,), for a kind of target."""
    if kind == KIND.free:
        return np.zeros(6, dtype=bool)
    rows = np.array(counts.mask or ALL) > 0.0
    rows &= np.array(counts.slack or NONE) < (*(math.inf,) * 3, *(math.pi,) * 3)
    if kind == KIND.position:
        rows[3:] = False
    elif (counts.free_turn is not None or isinstance(kind, tuple)) and rows[3:].all():
        rows[5] = False
    return rows


def counted_jacobian(robot: Any, Q: np.ndarray, T: np.ndarray, kinds: tuple, o: Options) -> np.ndarray:
    """Return the Jacobians (K, 6 F, n) of the errors that count at solutions Q (K, n), in the axes that the option `frame` names.

    T (4, 4) or (F, 4, 4) are the targets. Rows are 0 for errors that do not count or are inside their slack. Lengths of the
    errors are divided by the robot's length scale.
    """
    poses, J = robot.chain.forward(Q, jacobian=True)
    J = J.reshape(len(Q), len(kinds), 2, 3, -1)
    J[:, :, 0] /= robot.chain.scale
    for f, (counts, kind) in enumerate(zip(what_counts(robot, o), kinds, strict=True)):
        turned = poses.reshape(len(Q), -1, 4, 4)[:, f, :3, :3]
        if (axis := free_axis(counts, kind)) is not None:
            a = turned @ axis
            J[:, f, 1] -= a[..., None] * np.einsum("ki,kin->kn", a, J[:, f, 1])[:, None]
        if counts.frame != "base":
            R = np.broadcast_to(T.reshape(-1, 4, 4)[f, :3, :3] if counts.frame == "target" else turned, turned.shape)
            J[:, f] = np.einsum("kji,kajn->kain", R, J[:, f])
        rows = _counting(counts._replace(free_turn=None), kind if axis is None else KIND.pose)
        J[:, f, ~(rows & (np.array(counts.slack or NONE) == 0.0)).reshape(2, 3)] = 0.0
    return J.reshape(len(Q), 6 * len(kinds), -1)


def kernel_tasks(robot: Any, kinds: tuple, o: Options) -> list[Task]:
    """Return for each tip the record `records.Task` that tells the compiled search which errors count and how much.

    Raises InvalidOption if the options and the kinds of target disagree.
    """
    scale, tasks = robot.chain.scale, []
    if all(kind in (KIND.position, KIND.free) for kind in kinds):
        _refuse_orientation(what_counts(robot, o), o)
    given = zip(
        robot.tips,
        kinds,
        what_counts(robot, o),
        relatives(robot, o),
        robot.chain.ends.reshape(len(kinds), -1),
        strict=True,
    )
    for tip, kind, counts, other, ends in given:
        if kind == KIND.free:
            if other >= 0:
                raise InvalidOption(
                    f"relative_to: '{tip}' has no target; give it one in the frame of '{robot.tips[other]}', or leave it out"
                )
            tasks.append(Task(KIND.free, 0.0, -1.0, 0.0, *NONE[:3], *NONE))
            continue
        axis = free_axis(counts, kind, _at(robot, tip))
        weights = counts.mask or ALL
        if kind == KIND.position:
            _require_position(counts, _at(robot, tip))
            weights = (*weights[:3], *NONE[3:])
        slack = np.array(counts.slack or NONE)
        slack[:3] /= scale
        plain = axis is None and counts.mask is None and counts.slack is None
        frame = counts.frame
        if o.priority is not None and frame == "tip" and len(set(weights[:3])) == 1 and not slack[:3].any():
            # The rotation error has the same components in the axes of tip and target. The target's axes are used because they do
            # not move with q, and so add no second derivatives.
            frame = "target"
        turn = NONE[:3] if axis is None else ends[12:21].reshape(3, 3) @ axis
        tasks.append(
            Task(kind if plain else KIND.part, getattr(AXES, frame), other, axis is not None, *turn, *weights, *slack)
        )
    return tasks


def _at(robot: Any, tip: str) -> str:
    """Return the tip's name as the beginning of a message, or '' if there is only one tip."""
    return f"{tip}: " if len(robot.tips) > 1 else ""


def free_axis(counts: Counts, kind: Any, at: str = "") -> tuple[float, ...] | None:
    """Return the tip axis about which rotation is free, from the options or an AxisTarget, or None."""
    if not isinstance(kind, tuple):
        return None if kind == KIND.position else counts.free_turn
    if counts.free_turn is not None:
        raise InvalidOption(f"{at}an axis target frees the turn about its axis; leave free_turn out")
    return kind[1]


def _refuse_orientation(counts: Sequence[Counts], o: Options) -> None:
    """Raise InvalidOption if an option is about orientation only, which positions leave free."""
    slack = [one.slack or NONE for one in counts]
    useless = {
        "free_turn": any(one.free_turn is not None for one in counts),
        "priority": bool(o.priority) and all(group == "orientation" for _, group in o.priority[0]),
        "slack": any(any(half[3:]) for half in slack) and not any(any(half[:3]) for half in slack),
    }
    for name in (name for name, given in useless.items() if given):
        raise InvalidOption(
            f"{name} has no effect on a position, which leaves orientation free; leave it out, or give a pose"
        )


def _require_position(counts: Counts, at: str) -> None:
    """Raise InvalidOption if an option needs an orientation and the target is a position."""
    if counts.mask is not None and any(counts.mask[3:]):
        raise InvalidOption(
            f"{at}a position leaves orientation free, so the last three weights of its mask must be 0, not {counts.mask[3:]}"
        )
    if counts.frame == "target" and (counts.mask is not None or counts.slack is not None):
        raise InvalidOption(f"{at}a position has no axes of its own, so frame='target' needs a pose")


# --------------------------------------------------------------------------------------------------------------- targets
def read_target(robot: Any, target: Any) -> tuple[np.ndarray, tuple, str]:
    """Validate a target; return T (1, 4, 4), for several tips (1, F, 4, 4), its kinds, one per tip, and a notice.

    The target is T_base_tip (4, 4), pin.SE3, a position (3,) or an AxisTarget; for several tips a dict by tip of these,
    or a list in the order of `robot.tips`. A kind is KIND.pose, KIND.position, (AXIS, axis), or KIND.free for a tip left out of a
    dict. Raises FrameNotFound (unknown tip) and InvalidTarget (which names the tip).
    """
    if not robot.by_tip and not is_by_name(target):
        T, kind, notice = read_one(target, robot.base)
        return T[None], (kind,), notice
    tips = robot.tips
    made = [_read_tip(tip, one, robot.base) for tip, one in zip(tips, _in_order(robot, target), strict=True)]
    T = np.array([one[0] for one in made]).reshape(1, *robot.pose_shape)
    kinds = tuple(one[1] for one in made)
    if all(kind == KIND.free for kind in kinds):
        raise InvalidTarget(f"give a target for at least one of {', '.join(tips)}")
    notice = "; ".join(f"{tip}: {one[2]}" for tip, one in zip(tips, made, strict=True) if one[2])
    return T, kinds, notice


def _in_order(robot: Any, targets: Any) -> list[Any]:
    """Return a target or None for each tip."""
    tips = robot.tips
    if is_by_name(targets):
        robot.check_tips(targets)
        return [targets.get(tip) for tip in tips]
    expected = f"robot '{robot.name}' takes one target for each of {', '.join(tips)}"
    single = getattr(targets, "shape", None) in ((), (4, 4), (3,))
    if single or not isinstance(targets, list | tuple | np.ndarray):
        raise InvalidTarget(f"{expected} (a dict, or a list in this order), not a single one")
    if len(targets) != len(tips):
        raise InvalidTarget(f"{expected}; got {len(targets)} (a dict may leave tips out: they are free)")
    return list(targets)


def _read_tip(tip: str, target: Any, base: str) -> tuple[np.ndarray, Any, str]:
    if target is None:
        return np.eye(4), KIND.free, ""
    try:
        return read_one(target, base)
    except InvalidTarget as error:
        raise InvalidTarget(f"{tip}: {error}") from None


def read_one(target: Any, base: str = "") -> tuple[np.ndarray, Any, str]:
    """Check one target in any accepted form; return it as a pose (4, 4), with its kind and a notice. base: the frame it is in."""
    if isinstance(target, AxisTarget):
        return target.T_base_tip, (AXIS, target.axis), ""
    if isinstance(target, str):
        raise InvalidTarget(f"a target must be a pose or a position, not the text {target!r}")
    checked, notice = check_target(target, base)
    if checked.ndim == 2:
        return checked, KIND.pose, notice
    T = np.eye(4)
    T[:3, 3] = checked
    return T, KIND.position, notice


# ------------------------------------------------------------------------------------------------------ Pinocchio's check
def targets_met(robot: Any, q: np.ndarray, o: Options) -> np.ndarray:
    """Return the poses (F, 4, 4) of the tips at q (n,), each in the frame of its target: the base, or another tip."""
    poses = [T.homogeneous for T in robot.tip_poses(q)]
    pairs = zip(poses, relatives(robot, o), strict=True)
    return np.array([pose if other < 0 else np.linalg.inv(poses[other]) @ pose for pose, other in pairs])


def counted_errors(
    robot: Any, q: np.ndarray, T: np.ndarray, kinds: tuple, o: Options
) -> list[tuple[float, float | None]]:
    """Compute with Pinocchio the position error [m] and orientation error [rad] that count at each tip at q (n,).

    T (1, 4, 4) or (1, F, 4, 4), or without the first axis: the targets, already validated. The orientation error is None if the
    target leaves orientation free; the errors of a free tip are 0.
    """
    if not counts_in_part(kinds, o):
        given = zip(robot.arms, robot.places, T.reshape(-1, 4, 4), kinds, strict=True)
        return [arm._errors(q[at], one[:3, 3] if kind == KIND.position else one) for arm, at, one, kind in given]
    return [(position, orientation) for _, position, orientation in all_errors(robot, q, T, kinds, o)]


def all_errors(
    robot: Any, q: np.ndarray, T: np.ndarray, kinds: tuple, o: Options
) -> list[tuple[np.ndarray, float, float | None]]:
    """Return for each tip its raw error (6,) (see `robot.pose.errors`), then its errors as in `counted_errors`.

    The raw error of a tip without a target is NaN.
    """
    poses = [T.homogeneous for T in robot.tip_poses(q)]
    found = []
    for pose, one, kind, counts, other in zip(
        poses, T.reshape(-1, 4, 4), kinds, what_counts(robot, o), relatives(robot, o), strict=True
    ):
        if kind == KIND.free:
            found.append((np.full(6, np.nan), 0.0, None))
            continue
        posed = one if other < 0 else poses[other] @ one
        target = posed[:3, 3] if kind == KIND.position else posed
        axis = free_axis(counts, kind)
        found.append(errors(pose, target, mask=counts.mask, slack=counts.slack, free_turn=axis, frame=counts.frame))
    return found
