"""A robot that follows targets dragged by hand, with the steps of the tracker, in the robot's own time."""

import math
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidTarget
from ..robot.pose import length
from ..tracking.reachable import near_limits
from ..tracking.tracker import Tracker

STEP = 0.02  # [s] of the robot's time
STEPS = 50  # taken before the page is drawn again: a second
TOOL = 0.2  # [m]
FAR = 1000.0  # reaches: a target further away is a slip of the hand
REST, SLOW = 10, 0.999  # steps in which the error has to go down to this share of itself, or the arm has come to rest


class Followed(NamedTuple):
    """Where an arm has got to: q (n,), whether at the target, whether at rest, errors by tip [m, rad or None], and why."""

    q: np.ndarray
    success: bool
    settled: bool
    errors: dict[str, tuple[float, float | None]]
    message: str


def follow(
    robot: Any,
    q: np.ndarray,
    target: Any,
    tolerance: float,
    limits: bool = True,
    avoid_collisions: Any = False,
) -> Followed:
    """Step from rest at q (n,) towards a target as the robot takes it, until it is met, nothing moves any more, or for a second.

    At the edge of what can be reached the arm goes on to the closest pose. tolerance [m and rad]: of a target that is met;
    limits, avoid_collisions as in `Tracker`.
    Raises InvalidTarget, and what `Tracker` raises.
    """
    errors, settled, at = _errors(robot, q, target), False, q
    away = max(position for position, _ in errors.values())
    if not away < FAR * robot.reach:
        raise InvalidTarget(f"the target is {away:.3g} m away, more than {FAR:g} times the reach of the arm")
    tracker = Tracker(
        robot,
        "cv",
        q0=q,
        rate0=np.zeros(robot.n),
        limits=limits,
        on_limit="direct",
        avoid_collisions=avoid_collisions,
    )
    left = [_size(errors)]
    for _ in range(STEPS):
        if _met(errors, tolerance):
            break
        at = tracker.update(target, STEP).q
        errors = _errors(robot, at, target)
        left.append(_size(errors))
        settled = len(left) > REST and left[-1] > SLOW * left[-1 - REST]
        if settled:
            break
    met = _met(errors, tolerance)
    return Followed(at, met, settled or met, errors, _words(robot, at, errors, met, settled))


def prepare(robot: Any, q: np.ndarray, target: Any) -> None:
    """Compile (or load) what `follow` runs, with one step that is thrown away: before a hand drags, not while it does."""
    Tracker(robot, "cv", q0=q, rate0=np.zeros(robot.n), on_limit="direct").update(target, STEP)


def _errors(robot: Any, q: np.ndarray, target: Any) -> dict[str, tuple[float, float | None]]:
    """Errors left at q by tip, of the tips that have a target."""
    each = target if robot.by_tip else {robot.tips[0]: target}
    arms = dict(zip(robot.tips, zip(robot.arms, robot.places, strict=True), strict=True))
    return {tip: arms[tip][0].errors(q[arms[tip][1]], T) for tip, T in each.items()}


def _size(errors: dict[str, tuple[float, float | None]]) -> float:
    """One number for what is left [m]: a turn counts as the way of a tool of ordinary length."""
    return math.hypot(*(x for position, angle in errors.values() for x in (position, TOOL * (angle or 0.0))))


def _met(errors: dict[str, tuple[float, float | None]], tolerance: float) -> bool:
    return all(position <= tolerance and (angle or 0.0) <= tolerance for position, angle in errors.values())


def _words(robot: Any, q: np.ndarray, errors: Any, met: bool, settled: bool) -> str:
    """What is left, in a sentence."""
    away = max(position for position, _ in errors.values())
    angles = [angle for _, angle in errors.values() if angle is not None]
    left = length(away) + (f" and {math.degrees(max(angles)):.3g} deg" if angles else "")
    if met:
        return f"converged to {left}"
    if not settled:
        return f"on its way, {left} to go"
    held = near_limits(robot, q)
    why = f"{', '.join(held)} at {'a limit' if len(held) > 1 else 'its limit'}" if held else "at the edge of its reach"
    return f"the closest pose is {left} away: {why}"
