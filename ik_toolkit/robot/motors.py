"""Conversion between a robot's joint values and its motor commands: direction, zero position, unit."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import InvalidConfiguration, InvalidOption, JointNotFound, floats, near_match
from ..validate import number
from .joints import Joints

SUFFIX = ".pos"  # A motor position may be named as in the LeRobot library: "shoulder_pan.pos" for joint shoulder_pan.


class MotorMap:
    """Converts motor positions to joint values and back: q = sign * motor + offset.

    Args:
        robot: The Robot or Tree whose joints the motors move.
        sign: By joint name, 1 if the motor turns with the joint, -1 if against it; 1 for a joint left out.
        offset: By joint name, the joint value [rad or m] at motor position 0; 0 for a joint left out.
        degrees: Whether motor positions of revolute joints are in degrees; `offset` stays in radians.

    Raises:
        JointNotFound: A name is not a joint of the robot.
        InvalidOption: A sign is not 1 or -1, an offset is not a finite number, or one of a revolute joint exceeds a full turn.
    """

    def __init__(
        self,
        robot: Any,
        *,
        sign: Mapping[str, float] | None = None,
        offset: Mapping[str, float] | None = None,
        degrees: bool = False,
    ) -> None:
        """Read the directions and zero positions."""
        if not isinstance(robot, Joints):
            raise InvalidOption(f"a Robot or a Tree is needed (see Robot.load), not {type(robot).__name__}")
        self.robot = robot
        self.sign = _by_joint(robot, "sign", sign, 1.0)
        self.offset = _by_joint(robot, "offset", offset, 0.0)
        doubted = np.flatnonzero((np.abs(self.offset) > 2.0 * math.pi) & ~robot.slides)
        if len(doubted):
            joint, value = robot.joint_names[doubted[0]], self.offset[doubted[0]]
            raise InvalidOption(
                f"offset of {joint}: {value:g} rad is more than a full turn; offsets are in rad, {value:g} deg is "
                f"{math.radians(value):.4g} rad"
            )
        if not (np.abs(self.sign) == 1.0).all():
            raise InvalidOption(f"sign must be 1 or -1 for each joint, not {sign!r}")
        self.unit = np.where(robot.slides, 1.0, math.radians(1.0) if degrees else 1.0)

    def __repr__(self) -> str:
        """Describe the map in one line: joints whose motors turn against them, and zero positions."""
        joints = list(zip(self.robot.joint_names, self.sign.tolist(), self.offset.tolist(), strict=True))
        against = [joint for joint, sign, _ in joints if sign < 0.0]
        offset = {joint: offset for joint, _, offset in joints if offset}
        turns = self.unit[~self.robot.slides]
        return (
            f"MotorMap('{self.robot.name}', reversed={against}, offset={offset}, degrees={bool((turns != 1.0).any())})"
        )

    def to_q(self, motors: Any) -> np.ndarray:
        """Return joint values (n,) [rad or m] for motor positions, given as (n,) or as a dict with the keys JOINT or "JOINT.pos".

        For N sets of positions, given as (N, n) or as a dict of arrays (N,), the result is (N, n). Other keys of a dict, such as
        that of a gripper, are ignored. Raises InvalidConfiguration.
        """
        if isinstance(motors, Mapping):
            named = {str(name).removesuffix(SUFFIX): value for name, value in motors.items()} | dict(motors)
            missing = [joint for joint in self.robot.joint_names if joint not in named]
            if missing:
                others = [name for name in motors if str(name).removesuffix(SUFFIX) not in self.robot.joint_names]
                raise InvalidConfiguration(
                    f"no motor position for joint {', '.join(missing)}.{near_match(missing[0], others)}"
                )
            each = {
                joint: floats(named[joint], f"motor positions of {joint} must be numbers", InvalidConfiguration)
                for joint in self.robot.joint_names
            }
            shapes = {joint: array.shape for joint, array in each.items()}
            if len({*shapes.values()}) > 1:
                raise InvalidConfiguration(
                    f"motor positions must be one number for each joint, or equally many; their shapes are {shapes}"
                )
            motors = np.array(list(each.values())).T
        values = floats(motors, "motor positions must be numbers", InvalidConfiguration)
        names, n = ", ".join(self.robot.joint_names), self.robot.n
        if values.ndim not in (1, 2) or values.shape[-1] != n:
            raise InvalidConfiguration(
                f"motor positions must be {n} numbers ({names}), or (N, {n}), not an array of shape {values.shape}"
            )
        if not np.isfinite(values).all():
            joint = self.robot.joint_names[np.argwhere(~np.isfinite(values))[0, -1]]
            raise InvalidConfiguration(f"motor positions must be finite numbers; that of {joint} is not")
        return self.sign * values * self.unit + self.offset

    def to_motors(self, q: Any) -> dict[str, Any]:
        """Return a dict of motor positions by joint name for joint values q (n,) [rad or m]; for q (N, n) each is an array (N,).

        Raises InvalidConfiguration.
        """
        several = np.ndim(q) == 2
        rows = np.array([self.robot.check_q(row, "q") for row in (q if several else [q])]).reshape(-1, self.robot.n)
        values = self.sign * (rows - self.offset) / self.unit
        return dict(zip(self.robot.joint_names, values.T if several else values[0].tolist(), strict=True))


def _by_joint(robot: Any, name: str, given: Mapping[str, float] | None, default: float) -> np.ndarray:
    """Return a value (n,) for each joint from a dict that may leave joints out. Raises JointNotFound, InvalidOption."""
    if given is not None and not isinstance(given, Mapping):
        raise InvalidOption(f"{name} must be a dict from joints to numbers, not {given!r:.60}")
    made = np.full(robot.n, default)
    for joint, value in (given or {}).items():
        if joint not in robot.joint_names:
            raise JointNotFound(f"{name}: the robot has no joint '{joint}'.{near_match(joint, robot.joint_names)}")
        made[robot.joint_names.index(joint)] = number(value, f"{name} of {joint}")
    return made
