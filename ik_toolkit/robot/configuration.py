"""Reads joint values given as numbers, as the name of a configuration, or as values by joint."""

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import (
    ConfigurationNotFound,
    InvalidConfiguration,
    InvalidOption,
    JointNotFound,
    ReadOnlyAttribute,
    floats,
    near_match,
)
from .base import joint_value, put_joint, unfold
from .formats.mimic import Tie, mimic_limits
from .probe import NO_LIMIT, mimics
from .ros import read_joint_state


class Named(dict[str, np.ndarray]):
    """A read-only dict of configurations q (n,) [rad or m] by name; an unknown name raises ConfigurationNotFound."""

    def __missing__(self, name: str) -> np.ndarray:
        """Raise ConfigurationNotFound, because there is no configuration of this name."""
        raise ConfigurationNotFound(
            f"the robot has no configuration named '{str(name)[:200]}'.{near_match(name, self)}"
        )

    def __setitem__(self, name: str, q: Any) -> None:
        """Raise ReadOnlyAttribute, because the robot would not keep the configuration."""
        raise ReadOnlyAttribute(
            "robot.named cannot be changed; keep q yourself, or name it in a <group_state> of an SRDF"
        )

    def __reduce__(self) -> tuple:
        """Pickle the items as an argument, because none can be added later."""
        return Named, (dict(self),)


def values_by_joint(locked: Mapping[str, float] | None) -> dict[str, float]:
    """Return a copy of the option `locked`, a dict from joint names to values; empty for None.

    Raises InvalidConfiguration if it is no dict.
    """
    if not isinstance(locked, Mapping | None):
        raise InvalidConfiguration(f"locked takes a dict from joint names to values [rad or m], not {locked!r:.60}")
    return dict(locked or {})


def read_configuration(robot: Any, q: Any, name: str = "q") -> tuple[np.ndarray, str]:
    """Read joint values given as an array, as the name of a stored configuration, or by joint, as an array (n,).

    Args:
        robot: whose joints they are, a Robot or a Tree.
        q: numbers (n,); the name of a configuration (see `robot.named`); or values by joint, as a dict or a ROS JointState (or a
            dict of its fields), of which other joints are ignored.
        name: name of the argument, for messages.

    Returns:
        The joint values (n,), which may be outside limits or not finite, and a sentence on ignored joints ('' if none).

    Raises:
        InvalidConfiguration: a joint is missing, or the values are not numbers.
        ConfigurationNotFound: no configuration has this name.
    """
    notice = ""
    if isinstance(q, str):
        q = robot.named[q]
    elif not isinstance(q, np.ndarray | list | tuple):
        by_joint = read_joint_state(q, name)
        if by_joint is None and isinstance(q, Mapping):
            by_joint = q
        if by_joint is not None:
            missing = [joint for joint in robot.joint_names if joint not in by_joint]
            others = [str(joint) for joint in by_joint if joint not in robot.joint_names]
            if missing:
                given = f", but names {', '.join(others[:30])}, not in this robot's q" if others else ""
                raise InvalidConfiguration(f"{name} has no value for joint {', '.join(missing)}{given}")
            if others:
                notice = f"{name}: joint{'s' * (len(others) > 1)} {', '.join(others)} ignored, not of this robot's q"
            q = [by_joint[joint] for joint in robot.joint_names]

    array = floats(q, f"{name} must be {robot.n} numbers", InvalidConfiguration)
    if array.shape != (robot.n,):
        raise InvalidConfiguration(
            f"{name} must have {robot.n} values, one per joint ({', '.join(robot.joint_names)}); got shape {array.shape}"
        )
    return array, notice


def leaders_of(model: pin.Model) -> Iterator[tuple[str, Tie]]:
    """Yield the name of every mimic joint of a Pinocchio model with its Tie: leader, ratio, and offset [rad or m]."""
    for j, (leader, ratio, offset) in mimics(model).items():
        yield model.names[j], Tie(model.names[leader], ratio, offset)


def near_joint(joint: Any, model: pin.Model, names: Iterable[str]) -> str:
    """Return advice on a joint that is not in `names`, for the end of an error message.

    It says which joint this one mimics, or else which name in `names` is like the unknown one.
    """
    leader = next((tie.leader for follower, tie in leaders_of(model) if follower == joint), None)
    return near_match(joint, names) if leader is None else f" It follows '{leader}': give that joint instead."


def follower_limits(robot: Any) -> dict[str, tuple[float, float]]:
    """Return the URDF limits (lower, upper) [rad or m] of each mimic joint that follows a joint of q; infinite if not given."""
    own = mimic_limits(robot.urdf)
    ends = {joint: own[joint][3:] if joint in own else (-math.inf, math.inf) for joint in robot.mimic_joints}
    return {
        joint: (low if low > -NO_LIMIT else -math.inf, high if high < NO_LIMIT else math.inf)
        for joint, (low, high) in ends.items()
    }


def followers_at_limits(robot: Any, q: np.ndarray) -> dict[str, list[str]]:
    """Return by leader the names of the mimic joints that are within 1e-9 [rad or m] of a limit of their own at q (n,)."""
    limits, found = follower_limits(robot), {}
    at = joint_values(robot, q) if limits else {}
    for joint, (low, high) in limits.items():
        if min(at[joint] - low, high - at[joint]) <= 1e-9:
            found.setdefault(robot.mimic_joints[joint].leader, []).append(joint)
    return found


def simple_joints(model: pin.Model) -> Iterator[tuple[str, Any]]:
    """Yield name and joint for each joint of a Pinocchio model with one degree of freedom (mimic joints have none)."""
    for name, joint in zip([*model.names][1:], [*model.joints][1:], strict=True):
        if joint.nv == 1:
            yield name, joint


def joint_values(robot: Any, q: np.ndarray) -> dict[str, float]:
    """Return the values [rad or m] of all joints of a robot by name at q (n,), which is not checked.

    Mimic joints are included, and so are joints off the path to the tip, which rest at fixed values.
    """
    at = dict(zip(robot.joint_names, q.tolist(), strict=True))
    for name, joint in simple_joints(robot.model):
        if name not in at:
            at[name] = joint_value(joint, robot.rest)
    return at | {joint: tie.ratio * at[tie.leader] + tie.offset for joint, tie in leaders_of(robot.model)}


def configuration_in(model: Any, robot: Any, q: np.ndarray, rest: Any) -> np.ndarray:
    """Return the configuration (nq,) of another model in which the robot's joints, found by name, have their values at q.

    All other joints keep their values in `rest` (nq,) or, without it, are neutral. Raises JointNotFound if the model lacks a joint
    of q, InvalidOption, InvalidConfiguration.
    """
    if not isinstance(model, pin.Model):
        raise InvalidOption(f"model must be a pin.Model, not {type(model).__name__}")
    made, given = unfold(model)
    missing = [joint for joint in robot.joint_names if joint not in made.names]
    if missing:
        close = near_match(missing[0], [*made.names][1:])
        raise JointNotFound(f"the model has no joint '{missing[0]}', which robot '{robot.name}' moves.{close}")
    if rest is not None:
        rest = floats(rest, "rest must be numbers", InvalidConfiguration)
        if rest.shape != (model.nq,):
            raise InvalidConfiguration(f"rest must have {model.nq} values for this model, not shape {rest.shape}")
    # If the robot moves no joint with several coordinates, `rest` is not converted, so such joints keep its exact values.
    if given is None or not any(name in robot.joint_names for block in given.blocks for name in block.names):
        made, given = model, None
    full = pin.neutral(made) if rest is None else rest.copy() if given is None else given.back(made, rest)
    values = joint_values(robot, q)
    for name, joint in zip(made.names, made.joints, strict=True):
        if (
            name in values
            and joint.nv == 1
            and (rest is None or name in robot.joint_names or name in robot.mimic_joints)
        ):
            put_joint(joint, full, values[name])
    return full if given is None else given.form(made, full)
