"""Joint values in the forms in which people have them: numbers, the name of a configuration, values by joint."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import ConfigurationNotFound, InvalidConfiguration, floats, near_match
from .ros import read_joint_state


class Named(dict[str, np.ndarray]):
    """Configurations q (n,) [rad or m] by name; an unknown name raises ConfigurationNotFound."""

    def __missing__(self, name: str) -> np.ndarray:
        """Raise ConfigurationNotFound, because there is no configuration of this name."""
        raise ConfigurationNotFound(
            f"the robot has no configuration named '{str(name)[:200]}'.{near_match(name, self)}"
        )


def values_by_joint(locked: Mapping[str, float] | None) -> dict[str, float]:
    """Return `locked` as a dict from joint names to values; None is an empty one. Raises InvalidConfiguration."""
    if not isinstance(locked, Mapping | None):
        raise InvalidConfiguration(f"locked takes a dict from joint names to values [rad or m], not {locked!r:.60}")
    return dict(locked or {})


def read_configuration(robot: Any, q: Any, name: str = "q") -> tuple[np.ndarray, str]:
    """Read joint values in any form.

    Args:
        robot: whose joints they are, a Robot or a Tree.
        q: numbers (n,); the name of a configuration (see `robot.named`); or values by joint, as a dict or a ROS JointState, of
            which other joints are ignored.
        name: of the argument, for messages.

    Returns:
        An array (n,), which is not checked, and a notice ('' or what was ignored).

    Raises:
        InvalidConfiguration: a joint is missing, or these are no numbers.
        ConfigurationNotFound: no configuration has this name.
    """
    notice = ""
    if isinstance(q, str):
        q = robot.named[q]
    elif not isinstance(q, np.ndarray | list | tuple):
        by_joint = q if isinstance(q, Mapping) else read_joint_state(q, name)
        if by_joint is not None:
            missing = [joint for joint in robot.joint_names if joint not in by_joint]
            others = [str(joint) for joint in by_joint if joint not in robot.joint_names]
            if missing:
                meant = near_match(missing[0], others) if others else ""
                raise InvalidConfiguration(f"{name} has no value for joint {', '.join(missing)}.{meant}")
            if others:
                notice = f"{name}: joint{'s' * (len(others) > 1)} {', '.join(others)} ignored, not of this robot's q"
            q = [by_joint[joint] for joint in robot.joint_names]

    array = floats(q, f"{name} must be {robot.n} numbers", InvalidConfiguration)
    if array.shape != (robot.n,):
        raise InvalidConfiguration(
            f"{name} must have {robot.n} values, one per joint ({', '.join(robot.joint_names)}); got shape {array.shape}"
        )
    return array, notice
