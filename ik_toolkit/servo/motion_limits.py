"""Joint limits as arrays for the compiled tracking loop."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import InvalidOption, floats, near_match
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..validate import switch
from .viability import LIMIT, UNLIMITED

LIMIT_NAMES = ("lower", "upper", "speed", "acceleration")
# what to do instead of assigning to an attribute of a Tracker, which raises an error; by name, "" for all other attributes
INSTEAD = {
    **dict.fromkeys(("limits", *LIMIT_NAMES), "use change_limits"),
    "q": "use reset(q0), or pass q= to update where joints are measured",
    "": "make a Tracker with the robot, method and options that are meant",
}


def limit_rows(robot: Robot | Tree, limits: bool, acceleration_limits: Any) -> np.ndarray:
    """Return the limits (4, n) of the joints in internal units: rows lower, upper, speed, acceleration.

    Limits that a joint does not have are infinite. The internal unit is 1 rad for a revolute joint, and about the arm's reach
    (`chain.scale`) for a prismatic joint.

    Args:
        robot: The robot whose position and speed limits are read.
        limits: Whether position and speed limits apply.
        acceleration_limits: None, a number or (n,) [rad/s^2 or m/s^2].

    Raises:
        InvalidOption: acceleration_limits has a wrong shape or is not positive, or is given without limits.
    """
    n, unit = robot.n, robot.chain.unit
    rows = np.full((4, n), np.inf)
    rows[LIMIT.lowest] = -np.inf
    if switch(limits, "limits"):
        speed = np.asarray(robot.velocity_limits, dtype=float)
        rows[LIMIT.lowest], rows[LIMIT.highest] = robot.lower / unit, robot.upper / unit
        rows[LIMIT.speed] = np.where(speed > 0.0, speed, np.inf) / unit
    if acceleration_limits is not None:
        if not limits:
            raise InvalidOption("acceleration_limits must go with limits=True")
        what = f"acceleration_limits must be a number or {n} numbers"
        a = floats(acceleration_limits, what, InvalidOption)
        if a.shape not in ((), (n,)):
            raise InvalidOption(f"{what}, not {acceleration_limits!r:.60}")
        if not (a > 0.0).all():
            raise InvalidOption(f"acceleration_limits must be positive, not {acceleration_limits!r}")
        rows[LIMIT.acceleration] = a / unit
    return rows


def speeds(limits: np.ndarray) -> np.ndarray:
    """Return the speed limits (n,) from limits (4, n), with UNLIMITED in place of infinite ones."""
    return np.where(limits[LIMIT.speed] < np.inf, limits[LIMIT.speed], UNLIMITED)


def changed_limits(robot: Robot | Tree, rows: np.ndarray, given: Mapping[str, Any]) -> np.ndarray:
    """Return a copy of the limits (4, n) [rad or arm reaches, per s, per s^2] with some of its rows replaced.

    Args:
        robot: The robot, for the names and units of its joints.
        rows: Present limits (4, n): lower, upper, speed, acceleration.
        given: For each name of LIMIT_NAMES a number, an array (n,), a dict by joint name [rad or m, per s, per s^2], or None
            to keep the row.

    Raises:
        InvalidOption: A value is not a number, there is no such joint, a speed or acceleration is negative, or lower is
            above upper.
    """
    rows, unit = rows.copy(), robot.chain.unit
    for row, name in zip(rows, LIMIT_NAMES, strict=True):
        value = given[name]
        if value is None:
            continue
        new = row * unit
        if isinstance(value, Mapping):
            for joint, one in value.items():
                if joint not in robot.joint_names:
                    raise InvalidOption(f"{name}: no joint '{joint}'.{near_match(joint, robot.joint_names)}")
                number = floats(one, f"{name} of {joint} must be a number", InvalidOption)
                if number.ndim:
                    raise InvalidOption(f"{name} of {joint} must be a number, not {one!r:.60}")
                new[robot.joint_names.index(joint)] = number
        else:
            numbers = floats(value, f"{name} must be a number or {robot.n} numbers", InvalidOption)
            if numbers.shape not in ((), new.shape):
                raise InvalidOption(f"{name} must be a number or {robot.n} numbers, not {value!r:.60}")
            new[:] = numbers
        least = -np.inf if name in ("lower", "upper") else 0.0
        if np.isnan(new).any() or (new < least).any():
            raise InvalidOption(f"{name} must be numbers{'' if least else ' of at least 0'}, not {value!r:.60}")
        row[:] = new / unit
    if (rows[LIMIT.lowest] > rows[LIMIT.highest]).any():
        raise InvalidOption("lower limits must not be above the upper ones")
    return rows
