"""Paths of the tips of a robot: circle, line and eight from where they stand, and one that every robot can follow."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from ..errors import whole
from ..motion import shapes
from ..motion.reference import Reference, Samples, law_of, on_path, split
from ..motion.trajectory import tip_motion
from ..robot.joints import Joints
from ..validate import one_of, positive
from .path_reach import References, freed
from .result import ORIENTATION_TOLERANCE, POSITION_TOLERANCE

DURATION = 10.0  # [s]
SWING = 0.15  # [rad, or reaches] by which a joint moves at most on the way that every robot can follow ...
ROOM = 0.5  # ... and share of what there is to its farther limit
SPEED = 0.5  # of a joint's limit: what the path asks for at most
STRAIGHT = 0.4  # of the tolerances: how far a step straight ahead may leave the path, as the first one of `cv` does
SEEN = 1000  # samples in which that is looked at


def eight(
    center: Any, radius: float, normal: Any, *, turns: float = 1.0, duration: float, law: str = "constant"
) -> Reference:
    """Figure of eight about a centre (pose or position) in the plane across `normal`: `radius` [m] to each side."""
    p, R0 = split(center)
    u, w = shapes.plane(normal)
    k = 2.0 * np.pi * turns

    def path(s: np.ndarray) -> Samples:
        a = k * s[:, None]
        place = p + radius * (np.sin(a) * u + 0.5 * np.sin(2.0 * a) * w)
        speed = k * radius * (np.cos(a) * u + np.cos(2.0 * a) * w)
        return place, speed, -k * k * radius * (np.sin(a) * u + 2.0 * np.sin(2.0 * a) * w)

    return on_path(path, law_of(law), duration, R0, "eight")


def draw(
    kind: str,
    at: Any,
    size: float,
    axis: Any = None,
    *,
    duration: float = DURATION,
    law: str | None = None,
    turns: float = 0.0,
) -> Reference:
    """Path of a kind (line, circle, eight) from where the tip stands (pose or position); size: its length or radius [m].

    axis: direction of a line (default base x), normal of the others (base z). turns: of circle and eight (0: one), rounds of a
    line (0: one way). law: default constant speed, of a line minimum-jerk.
    """
    if one_of(kind, KINDS, "path") == "line":
        d = np.array((1.0, 0.0, 0.0) if axis is None else axis, dtype=float)
        end = np.array(at, dtype=float)
        (end if end.ndim == 1 else end[:3, 3])[:] += size * d / np.linalg.norm(d)
        return shapes.line(
            at, end, duration=duration, law=law or "minimum-jerk", rounds=whole(turns, "rounds of a line", 0)
        )
    normal = (0.0, 0.0, 1.0) if axis is None else axis
    rest: dict[str, Any] = {"turns": turns or 1.0, "duration": duration, "law": law or "constant"}
    return shapes.circle(at, size, normal=normal, **rest) if kind == "circle" else eight(at, size, normal, **rest)


KINDS = ("circle", "line", "eight")


def joint_motion(
    robot: Joints,
    q0: Any = None,
    *,
    position_only: bool = False,
    duration: float | None = None,
    dt: float = 0.01,
    position_tolerance: float = POSITION_TOLERANCE,
) -> References:
    """Path of the tips while all joints swing a little from q0 (n,), default home, and back: a way that can be followed.

    Every joint moves towards its farther limit, every second one there and back twice. duration [s]: default such that speeds
    are half of their limits at most and, with samples every dt [s], a step leaves the path by less than position_tolerance [m].
    """
    q0 = robot.home if q0 is None else robot.check_q(q0, "q0")
    up, down = np.maximum(robot.upper - q0, 0.0), np.maximum(q0 - robot.lower, 0.0)
    swing = np.where(up >= down, 1.0, -1.0) * np.minimum(SWING * robot.chain.unit, ROOM * np.maximum(up, down))
    turns = np.pi * (1.0 + np.arange(robot.n) % 2)
    if duration is None:
        top = np.where(robot.velocity_limits > 0.0, robot.velocity_limits, np.inf)
        duration = max(DURATION, float(np.ceil((np.abs(swing) * turns / top).max(initial=0.0) / SPEED)))
        tolerances = positive(position_tolerance, "position_tolerance [m]"), ORIENTATION_TOLERANCE
        t, trial = np.linspace(0.0, duration, SEEN), _swings(robot, q0, swing, turns, duration)
        bends = [np.linalg.norm(one.at(t)[2].reshape(SEEN, 2, 3), axis=2) / tolerances for one in trial.values()]
        missed = 0.5 * positive(dt, "dt [s]") ** 2 * float(np.max(bends)) / STRAIGHT
        duration = max(duration, float(np.ceil(duration * np.sqrt(missed))))
    made = _swings(robot, q0, swing, turns, duration)
    made = {tip: freed(one) for tip, one in made.items()} if position_only else made
    return made if robot.by_tip else made[robot.tips[0]]


def _swings(robot: Any, q0: np.ndarray, swing: np.ndarray, turns: np.ndarray, duration: float) -> dict[str, Reference]:
    """The references of `joint_motion`, by tip."""
    made = {}
    for tip, arm, place in zip(robot.tips, robot.arms, robot.places, strict=True):
        function = partial(_tip_at, arm, q0[place], swing[place], turns[place] / positive(duration, "duration [s]"))
        made[tip] = Reference(function, duration, name="joint motion")
    return made


def _tip_at(arm: Any, q0: np.ndarray, swing: np.ndarray, pace: np.ndarray, t: np.ndarray) -> Samples:
    """Motion of the tip of an arm whose joints are at q0 + swing sin^2(pace t)."""
    angle = 2.0 * pace * t[:, None]
    q, dq, ddq = 0.5 * (1.0 - np.cos(angle)), pace * np.sin(angle), 2.0 * pace**2 * np.cos(angle)
    return tip_motion(arm, q0 + swing * q, swing * dq, swing * ddq)


def paths(
    robot: Any, q: Any, kind: str, size: float, axis: Any, free: bool, relative: Mapping[str, str], **rest: Any
) -> References:
    """The path from where the tips stand at q, by tip for a tree; a tip relative to another keeps its pose in its frame."""
    T: Any = robot.fk(q)
    if not robot.by_tip:
        return _drawn(T.homogeneous, kind, size, axis, free, rest)
    made = {}
    for tip in robot.tips:
        held = tip in relative and relative[tip] in T
        at = T[relative[tip]].actInv(T[tip]) if held else T[tip]
        made[tip] = _drawn(at.homogeneous, "line" if held else kind, 0.0 if held else size, axis, free, rest)
    return made


def _drawn(at: np.ndarray, kind: str, size: float, axis: Any, free: bool, rest: Mapping[str, Any]) -> Reference:
    return draw(kind, at[:3, 3].copy() if free else at, size, axis, **rest)
