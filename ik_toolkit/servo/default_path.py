"""Reference paths from where the tips are: circle, line and figure of eight, and one that every robot can follow."""

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

DURATION = 10.0  # [s] default time in which a path is run through


def eight(
    center: Any, radius: float, normal: Any, *, turns: float = 1.0, duration: float, law: str = "constant"
) -> Reference:
    """Make a reference along a figure of eight in the plane across `normal`, at a fixed orientation.

    Args:
        center: Crossing point of the figure, as a pose or position, base frame [m].
        radius: Distance [m] from the centre to either end of the figure.
        normal: Normal (3,) of the figure's plane, base axes.
        turns: Number of times that the figure is run through.
        duration: Time for all turns [s].
        law: "constant" or "minimum-jerk".
    """
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
    """Make a reference along a circle, line or figure of eight that begins at a pose or position.

    A figure of eight begins at its centre, where it crosses itself.

    Args:
        kind: "circle", "line" or "eight".
        at: Where the tip is, as a pose or position, base frame [m].
        size: Length of a line, radius of a circle or figure of eight [m].
        axis: Direction of a line (default base x), or normal of a circle or eight (default base z), base axes.
        duration: Time for the path [s].
        law: "constant" or "minimum-jerk"; default: minimum-jerk for a line, else constant.
        turns: Turns of a circle or eight (0: one), round trips of a line (0: one way).
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
    """Make a reference that every robot can follow: the motion of its tips while all joints move a little from q0 and back.

    Every joint moves towards its farther limit; every second joint does so twice.

    Args:
        robot: The robot.
        q0: Joint values (n,) at start and end; default home.
        position_only: Leave the orientation free.
        duration: Time for the motion [s]. By default it is at least DURATION, and so long that joint speeds stay below half of
            their limits and a step of dt at constant twist leaves the path by no more than 0.4 of the tolerances.
        dt: Sample time [s] of the run.
        position_tolerance: Tolerance [m] of the run.

    Returns:
        One reference, or for a Tree a dict of references by tip.
    """
    q0 = robot.home if q0 is None else robot.check_q(q0, "q0")
    up, down = np.maximum(robot.upper - q0, 0.0), np.maximum(q0 - robot.lower, 0.0)
    # A joint moves by at most 0.15 rad (0.15 arm reaches if it is prismatic), and by at most half of the way to its farther limit.
    swing = np.where(up >= down, 1.0, -1.0) * np.minimum(0.15 * robot.chain.unit, 0.5 * np.maximum(up, down))
    turns = np.pi * (1.0 + np.arange(robot.n) % 2)
    if duration is None:
        top = np.where(robot.velocity_limits > 0.0, robot.velocity_limits, np.inf)
        duration = max(DURATION, float(np.ceil((np.abs(swing) * turns / top).max(initial=0.0) / 0.5)))
        tolerances = positive(position_tolerance, "position_tolerance [m]"), ORIENTATION_TOLERANCE
        t, trial = np.linspace(0.0, duration, 1000), _swings(robot, q0, swing, turns, duration)
        bends = [np.linalg.norm(one.at(t)[2].reshape(-1, 2, 3), axis=2) / tolerances for one in trial.values()]
        missed = 0.5 * positive(dt, "dt [s]") ** 2 * float(np.max(bends)) / 0.4
        duration = max(duration, float(np.ceil(duration * np.sqrt(missed))))
    made = _swings(robot, q0, swing, turns, duration)
    made = {tip: freed(one) for tip, one in made.items()} if position_only else made
    return robot.for_tips(made)


def _swings(robot: Any, q0: np.ndarray, swing: np.ndarray, turns: np.ndarray, duration: float) -> dict[str, Reference]:
    """Return the references of `joint_motion` by tip: joints at q0 + swing sin^2(turns t / duration), all (n,)."""
    made = {}
    for tip, arm, place in zip(robot.tips, robot.arms, robot.places, strict=True):
        function = partial(_tip_at, arm, q0[place], swing[place], turns[place] / positive(duration, "duration [s]"))
        made[tip] = Reference(function, duration, name="joint motion")
    return made


def _tip_at(arm: Any, q0: np.ndarray, swing: np.ndarray, pace: np.ndarray, t: np.ndarray) -> Samples:
    """Return the tip's motion at t (N,) [s] of an arm whose joints are at q0 + swing sin^2(pace t)."""
    angle = 2.0 * pace * t[:, None]
    q, dq, ddq = 0.5 * (1.0 - np.cos(angle)), pace * np.sin(angle), 2.0 * pace**2 * np.cos(angle)
    return tip_motion(arm, q0 + swing * q, swing * dq, swing * ddq)


def paths(
    robot: Any, q: Any, kind: str, size: float, axis: Any, free: bool, relative: Mapping[str, str], **rest: Any
) -> References:
    """Make a circle, line or figure of eight for each tip, from where it is at q (n,): one reference, or for a Tree a dict.

    Args:
        robot: The robot.
        q: Joint values (n,).
        kind: "circle", "line" or "eight".
        size: Length of a line, radius of a circle or figure of eight [m].
        axis: Direction of a line, or normal of a circle or eight, base axes.
        free: Leave the orientation free.
        relative: Tips whose target is given in the frame of another tip, by name; such a tip keeps its pose in that
            frame.
        rest: Other arguments of `draw`.
    """
    T, made = robot.each_tip(robot.fk(q)), {}
    for tip in robot.tips:
        held = tip in relative and relative[tip] in T
        at = T[relative[tip]].actInv(T[tip]) if held else T[tip]
        start = at.translation.copy() if free else at.homogeneous
        made[tip] = draw("line" if held else kind, start, 0.0 if held else size, axis, **rest)
    return robot.for_tips(made)
