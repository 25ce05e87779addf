"""What a tracker does besides its task: options of the null space, read once, and the motion they give at q."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..copying import Holds
from ..errors import InvalidOption, floats, near_match
from .inputs import number

AVOID = 1.0  # [1/s] gain of the motion away from limits; at the limit itself it moves 15 % of the range in a second
POSTURE = 1.0  # [1/s] gain of the motion towards a posture
STEP = 1e-5  # [rad or m] of the difference that finds the slope of a caller's cost


class Secondary(Holds):
    """Options of the null space, as numbers. See `Tracker`."""

    FUNCTION = "cost"

    def __init__(self, robot: Any, avoid: float, nimble: float, wish: np.ndarray, sides: np.ndarray, cost: Any) -> None:
        """Keep them; wish (3, n): posture, its rate, a speed asked for [kernel units]."""
        self.robot, self.avoid, self.nimble, self.wish, self.sides, self.cost = robot, avoid, nimble, wish, sides, cost
        self.each_step = cost is not None or nimble > 0.0  # whether it must be evaluated at every step

    def confine(self, limits: np.ndarray) -> None:
        """Keep joints on their side of zero, in limits (4, n)."""
        limits[0] = np.where(self.sides > 0.0, np.maximum(limits[0], 0.0), limits[0])
        limits[1] = np.where(self.sides < 0.0, np.minimum(limits[1], 0.0), limits[1])

    def side(self, away: np.ndarray) -> None:
        """Where joints go from a pose in which they are straight: their side, or anywhere."""
        away[:] = self.sides if self.sides.any() else 1.0

    def look(self, q: np.ndarray) -> None:
        """Ask for what lowers the caller's cost, and raises manipulability, at q (n,) [kernel units]."""
        unit = self.robot.chain.unit
        at = q * unit
        slope = np.zeros(len(at))
        if self.cost is not None:
            given = floats(self.cost(at.copy()), f"cost must return a number or its slope ({len(at)},)", InvalidOption)
            slope = self._slope(self.cost, at) if given.shape == () else given
            if slope.shape != at.shape:
                raise InvalidOption(f"cost must return a number or its slope ({len(at)},), not shape {slope.shape}")
            if not np.isfinite(slope).all():
                name, told = getattr(self.cost, "__name__", type(self.cost).__name__), np.array2string(at, precision=4)
                what = "is not finite" if np.isfinite(given).all() or given.shape else f"is {given:g}"
                raise InvalidOption(f"cost ({name}) {what} at or beside q = {told}")
        if self.nimble > 0.0:
            slope = slope - self.nimble * self._slope(self._volume, at)
        self.wish[2] = -slope / unit

    def _slope(self, cost: Callable, at: np.ndarray) -> np.ndarray:
        """Slope of a number by differences."""
        steps = STEP * np.eye(len(at))
        return np.array([(float(cost(at + d)) - float(cost(at - d))) / (2.0 * STEP) for d in steps])

    def _volume(self, q: np.ndarray) -> float:
        """Logarithm of the manipulability: the product of the singular values."""
        arms = zip(self.robot.arms, self.robot.places, strict=True)
        J = np.zeros((6 * len(self.robot.arms), len(q)))
        for f, (arm, place) in enumerate(arms):
            J[6 * f : 6 * f + 6, place] = arm.chain.forward(q[place], jacobian=True)[1][0]
        return float(np.log(np.maximum(np.linalg.svd(J, compute_uv=False), STEP)).sum())


def read_secondary(
    robot: Any, avoid_limits: Any, posture: Any, elbow: Any, manipulability: Any, cost: Any
) -> Secondary:
    """Validate the options of the null space. Raises InvalidOption, InvalidConfiguration."""
    if isinstance(avoid_limits, bool | np.bool_):
        avoid = AVOID if avoid_limits else 0.0
    else:
        avoid = number(avoid_limits, "avoid_limits [1/s]")
    nimble = number(manipulability, "manipulability [1/s]")
    if avoid < 0.0 or nimble < 0.0:
        raise InvalidOption("avoid_limits and manipulability must not be negative")
    n, unit = robot.n, robot.chain.unit
    wish = np.zeros((3, n))
    if posture is not None:
        rate = POSTURE
        if isinstance(posture, tuple) and len(posture) == 2 and np.ndim(posture[0]) == 1:
            posture, rate = posture[0], number(posture[1], "the rate of posture [1/s]")
            if rate < 0.0:
                raise InvalidOption("the rate of posture must not be negative")
        wish[0], wish[1] = robot.check_q(posture, "posture") / unit, rate
    sides = np.zeros(n)
    if elbow is not None:
        if not isinstance(elbow, Mapping):
            raise InvalidOption(f"elbow is a dict from joint names to 1 or -1, not {elbow!r:.60}")
        for joint, side in elbow.items():
            if joint not in robot.joint_names:
                raise InvalidOption(f"elbow: no joint '{joint}'.{near_match(joint, robot.joint_names)}")
            sign = floats(side, f"elbow of {joint} must be 1 or -1", InvalidOption)
            if sign.ndim or abs(sign) != 1.0:
                raise InvalidOption(f"elbow of {joint} must be 1 or -1, not {side!r:.60}")
            sides[robot.joint_names.index(joint)] = sign
    if cost is not None and not callable(cost):
        raise InvalidOption(f"cost is a function of q, not {type(cost).__name__}")
    return Secondary(robot, avoid, nimble, wish, sides, cost)
