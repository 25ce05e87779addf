"""The self-motions of a decomposed arm of six joints: which joints move while the tip stays, and over which range."""

import math
from typing import Any

import numpy as np

from ...kernel.elimination.closure import joint_at
from ...kernel.elimination.decomposition import Split
from ...kernel.kinematics import TAU
from .geometry import Family


def moving_places(split: Split, place: int) -> tuple[int, ...]:
    """Return the positions, in the closed loop of joints, of those joints that move in a self-motion of a decomposed arm.

    split: how the arm is decomposed; place: position of the angle that is free, which comes first in the result.
    """
    if split.parallel:
        return {0: (0, 1, 2, 3, 4, 5), 1: (1, 3), 5: (5, 1, 2, 3)}[place]
    return (3, 5) if place == 3 else (place, 3, 4, 5)


def families_of(
    robot: Any, arm: np.ndarray, form: np.ndarray, q: np.ndarray, free: np.ndarray, box: np.ndarray
) -> list[tuple[Family, np.ndarray]]:
    """Return the self-motions through q (6,): pairs of a Family and its member whose leading joint is nearest the reference.

    arm (52,), form: arrays of the arm and of its decomposition; free (2,): the position (from 1 on) in the loop of joints of the
    angle that is free, and by how much it may turn either way [rad]; box (at least 3, 6): lower limits, upper limits, reference
    [rad].
    """
    split = Split(*form[: len(Split._fields)])
    place, half = int(free[0]) - 1, float(free[1])
    joints = [joint_at(k, bool(split.backwards), int(split.shift)) for k in moving_places(split, place)]
    names = tuple(robot.joint_names[k] for k in joints)
    lead, last = joints[0], joints[-1]
    low, high = (box[0, lead], box[1, lead]) if np.isfinite(box[:2, lead]).all() else (-math.pi, math.pi)
    found = []
    if len(joints) == 2:  # The two axes coincide, so one joint turns as the other turns back.
        slope = -_alignment(arm, q, *sorted((lead, last)))
        for a, b in _ranges(float(q[lead]), slope, float(q[last]), (low, high), box[:2, last]):
            member, at = q.copy(), min(max(box[2, lead], a), b)
            member[lead], member[last] = at, q[last] + slope * (at - q[lead])
            text = f"{names[1]} turns as {names[0]} does, from {a:.4f} to {b:.4f} rad"
            found.append((Family(names, float(a), float(b), text), member))
    elif split.parallel and place == 0:
        found.append((Family(names, None, None, "all joints move, and the tip stays"), q))
    else:
        arcs = [(low, high)]
        if half < math.pi and not np.isfinite(box[:2, lead]).all():
            at = q[lead] + TAU * round((box[2, lead] - q[lead]) / TAU)
            arcs = [(max(at - half, box[0, lead]), min(at + half, box[1, lead]))]
        elif half < math.pi:
            least, most = math.ceil((low - half - q[lead]) / TAU), math.floor((high + half - q[lead]) / TAU)
            turned = [q[lead] + TAU * turn for turn in range(least, most + 1)]
            arcs = [(max(at - half, low), min(at + half, high)) for at in turned]
        for a, b in arcs:
            text = f"{names[0]} turns from {a:.4f} to {b:.4f} rad, and {', '.join(names[1:])} follow, limits of theirs not counted"
            found.append((Family(names, float(a), float(b), text), q))
    return found


def _alignment(arm: np.ndarray, q: np.ndarray, first: int, last: int) -> float:
    """Return 1.0 if the axes two joints apart have the same direction at q, -1.0 if they have opposite ones."""
    axis, along, middle = arm[:36].reshape(6, 6)[[first, last, first + 1], :3]
    c, s = math.cos(q[first + 1]), math.sin(q[first + 1])
    turned = along * c + np.cross(middle, along) * s + middle * (middle @ along) * (1.0 - c)
    return math.copysign(1.0, float(axis @ turned))


def _ranges(at: float, slope: float, other: float, own: tuple, others: np.ndarray) -> list[tuple[float, float]]:
    """Return the ranges of a joint x in `own` for which another joint, other + slope (x - at), is inside its limits `others` (2,).

    The other joint counts modulo 2 pi; slope is 1.0 or -1.0.
    """
    if not others[1] - others[0] < TAU:
        return [own]
    a, b = sorted(at + slope * (limit - other) for limit in others)
    turns = TAU * np.arange(math.ceil((own[0] - b) / TAU), math.floor((own[1] - a) / TAU) + 1)
    return [(max(a + turn, own[0]), min(b + turn, own[1])) for turn in turns]
