"""Moves a robot after targets that are dragged by hand, with tracker steps in simulated robot time."""

from typing import Any, NamedTuple

import numpy as np

from ...errors import InvalidTarget
from ...servo.path_reach import near_limits
from ...servo.tracker import Tracker
from ...text import angle, length

STEP = 0.02  # [s] time step with which an arm follows a dragged target
STEPS = 50  # number of steps before the page is drawn anew: one second of motion
FAR = 1000.0  # [arm reaches] a target farther away than this is refused as a mistake
# The arm counts as settled after REST successive steps without motion: half a second, long enough for a tracker to find another
# posture if there is one.
REST = 25


class Followed(NamedTuple):
    """State of an arm that follows a dragged target, after some steps.

    Joint values q (n,), whether the target is reached, whether the joints are at rest, the position error [m] and rotation error
    [rad] left at each tip, and a status message for the user.
    """

    q: np.ndarray
    success: bool
    settled: bool
    errors: dict[str, tuple[float, float | None]]
    message: str


class Hand:
    """Moves an arm after a target that a visitor drags; each call of `follow` goes on where the last ended, with one `Tracker`.

    q (n,): joint values at the start; tolerance [m and rad]: errors below which the target counts as reached; limits,
    avoid_collisions and reconfigure are those of `Tracker`. Raises what `Tracker` raises.
    """

    def __init__(
        self, robot: Any, q: np.ndarray, *, tolerance: float, reconfigure: bool = True, **options: Any
    ) -> None:
        """Start at rest at q."""
        self.robot, self.options = robot, {"tolerance": tolerance, **options}
        self._tracker = _tracker(robot, q, reconfigure=reconfigure, **options)
        self._kinds: list[int] | None = None

    def follow(self, q: np.ndarray, target: Any) -> Followed:
        """Move from q (n,) towards a target until it is reached, nothing moves any more, or a second of motion has passed.

        If q is not where the last call ended, the arm starts again from rest. At the edge of its reach the arm moves to the
        closest pose. Raises InvalidTarget, and what `Tracker` raises.
        """
        robot, tracker, tolerance = self.robot, self._tracker, self.options["tolerance"]
        errors, rested, at, between = _errors(robot, q, target), 0, q, None
        away = max(position for position, _ in errors.values())
        if not away < FAR * robot.reach:
            raise InvalidTarget(f"the target is {length(away)} away, more than {FAR:g} times the reach of the arm")
        kinds = [np.ndim(robot.each_tip(target).get(tip)) for tip in robot.tips]
        if kinds != self._kinds or not np.array_equal(q, tracker.q):
            tracker.reset(q, rate0=np.zeros(robot.n))
            self._kinds = kinds
        for _ in range(STEPS):
            if _met(errors, tolerance) or rested == REST:
                break
            step = tracker.update(target, STEP)
            at = step.q
            errors = _errors(robot, at, target)
            rested = rested + 1 if step.at_rest else 0
            between = step.between
        met, settled = _met(errors, tolerance), rested == REST
        return Followed(at, met, settled or met, errors, _words(robot, at, errors, met, settled, between))


def _tracker(robot: Any, q: np.ndarray, **options: Any) -> Tracker:
    return Tracker(robot, "cv", q0=q, rate0=np.zeros(robot.n), on_limit="direct", **options)


def prepare(robot: Any, q: np.ndarray, target: Any) -> None:
    """Compile (or load) the code that `Hand.follow` runs, by a step that is discarded, so that the first drag need not wait."""
    _tracker(robot, q).update(target, STEP)


def _errors(robot: Any, q: np.ndarray, target: Any) -> dict[str, tuple[float, float | None]]:
    """Return the errors at q by tip, for the tips that have a target."""
    arms = dict(zip(robot.tips, zip(robot.arms, robot.places, strict=True), strict=True))
    return {tip: arms[tip][0]._errors(q[arms[tip][1]], T) for tip, T in robot.each_tip(target).items()}


def _met(errors: dict[str, tuple[float, float | None]], tolerance: float) -> bool:
    return all(position <= tolerance and (angle or 0.0) <= tolerance for position, angle in errors.values())


def _words(robot: Any, q: np.ndarray, errors: Any, met: bool, settled: bool, between: tuple[str, str] | None) -> str:
    """Return a sentence on the remaining error; `between`: names of the two parts that would touch, or None."""
    away = max(position for position, _ in errors.values())
    turned = [error for _, error in errors.values() if error is not None]
    left = length(away) + (f" and {angle(max(turned))}" if turned else "")
    if met:
        return f"converged to {left}"
    touch = f"{' and '.join(between)} would touch" if between else ""
    if not settled:
        return f"on its way, {left} from the target{touch and ': '}{touch}"
    held = near_limits(robot, q)
    why = f"{', '.join(held)} at {'a limit' if len(held) > 1 else 'its limit'}" if held else "at the edge of its reach"
    return f"the closest pose is {left} away: {touch or why}"
