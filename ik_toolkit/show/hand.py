"""A robot that follows targets dragged by hand, using tracker steps in simulated robot time."""

import math
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidTarget
from ..robot.pose import length
from ..tracking.reachable import near_limits
from ..tracking.tracker import Tracker

STEP = 0.02  # [s] of robot time
STEPS = 50  # steps before the page is redrawn: one second
TOOL = 0.2  # [m] length at which a rotation counts as a distance
FAR = 1000.0  # reaches: a target farther away is a mistake
REST, SLOW = 10, 0.999  # the arm counts as at rest unless the error falls to this share within this many steps


class Followed(NamedTuple):
    """State of a following arm: q (n,), whether at the target, whether at rest, errors by tip [m, rad or None], and a sentence."""

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
    """Step from rest at q (n,) towards a target until it is reached, nothing moves any more, or a second has passed.

    At the edge of its reach the arm goes on to the closest pose. tolerance [m and rad]: for a reached target; limits,
    avoid_collisions as in `Tracker`. Raises InvalidTarget, and what `Tracker` raises.
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
        reconfigure=False,  # a hand expects the arm to stay as it is; the page's solver finds other postures
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
    """Compile (or load) what `follow` runs, with one discarded step, before the first drag."""
    Tracker(robot, "cv", q0=q, rate0=np.zeros(robot.n), on_limit="direct").update(target, STEP)


def _errors(robot: Any, q: np.ndarray, target: Any) -> dict[str, tuple[float, float | None]]:
    """Errors at q by tip, for the tips that have a target."""
    each = target if robot.by_tip else {robot.tips[0]: target}
    arms = dict(zip(robot.tips, zip(robot.arms, robot.places, strict=True), strict=True))
    return {tip: arms[tip][0].errors(q[arms[tip][1]], T) for tip, T in each.items()}


def _size(errors: dict[str, tuple[float, float | None]]) -> float:
    """Total error [m]: a rotation counts as the motion of a tool of length TOOL."""
    return math.hypot(*(x for position, angle in errors.values() for x in (position, TOOL * (angle or 0.0))))


def _met(errors: dict[str, tuple[float, float | None]], tolerance: float) -> bool:
    return all(position <= tolerance and (angle or 0.0) <= tolerance for position, angle in errors.values())


def _words(robot: Any, q: np.ndarray, errors: Any, met: bool, settled: bool) -> str:
    """The remaining error in a sentence."""
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
