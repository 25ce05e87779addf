"""Checks limits narrower than a robot's own, and makes the variant of the robot that has them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import InvalidOption, JointNotFound, floats
from .configuration import near_joint

KEPT = 32  # A robot caches this many copies with narrower limits, because calls in a loop use the same limits.
ASKED = (
    "limits must be True, False, a dict from joint names to (lower, upper) [rad or m] (None: as it is), or a pair of arrays "
    "(lower, upper) with one value per joint"
)


def narrowed(robot: Any, limits: Any) -> Any:
    """Return a copy of a Robot or Tree with narrower limits, as `Joints.narrowed` takes them; the same copy for the same limits."""
    kept = robot.memo.setdefault("narrowed", {})
    try:
        if isinstance(limits, Mapping):
            key: Any = tuple(limits.items())
        else:
            key = tuple((x.dtype, x.shape, x.tobytes()) for x in limits)
        found = kept.get(key)
    except (AttributeError, TypeError):  # Limits given as lists cannot be a key of the cache.
        key = found = None
    if found is None:
        lower, upper = _ends(robot, limits)
        found = _variant(robot, lower, upper, kept)
        kept[key or (lower.tobytes(), upper.tobytes())] = found
        if len(kept) > KEPT:
            kept.pop(next(iter(kept)), None)
    return found


def _variant(robot: Any, lower: np.ndarray, upper: np.ndarray, kept: dict[Any, Any]) -> Any:
    """Return the robot with limits lower, upper (n,): itself if they are its own, a cached variant, or a new one."""
    _check(robot, lower, upper)
    for one in (robot, *kept.values()):
        if np.array_equal(lower, one.lower) and np.array_equal(upper, one.upper):
            return one
    made = robot._narrowed(dict(zip(robot.joint_names, zip(lower.tolist(), upper.tolist(), strict=True), strict=True)))
    made._wide = robot if robot._wide is None else robot._wide
    return made


def with_limits(robot: Any, limits: Any) -> tuple[Any, bool]:
    """Return what the option `limits` of a call means: the robot to solve for, and whether its joint limits are respected.

    limits: True, False (ignore them), or narrower limits as for `Joints.narrowed`, which give a variant of the robot.
    """
    if isinstance(limits, bool | np.bool_):
        return robot, bool(limits)
    return narrowed(robot, limits), True


def _ends(robot: Any, limits: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper limits (n,) [rad or m] that the caller asks for."""
    lower, upper = robot.lower.copy(), robot.upper.copy()
    if isinstance(limits, Mapping):
        for joint, pair in limits.items():
            if joint not in robot.joint_names:
                raise JointNotFound(
                    f"robot '{robot.name}' has no joint '{joint}' whose limits could be narrowed."
                    f"{near_joint(joint, robot.model, robot.joint_names)}"
                )
            i, what = robot.joint_names.index(joint), f"limits of joint '{joint}' must be (lower, upper)"
            if not isinstance(pair, list | tuple | np.ndarray) or len(pair) != 2:
                raise InvalidOption(f"{what}, not {pair!r:.60}")
            for ends, value in zip((lower, upper), pair, strict=True):
                if value is not None:
                    number = floats(value, f"{what}, numbers or None", InvalidOption)
                    if number.ndim:
                        raise InvalidOption(f"{what}, numbers or None, not {value!r:.60}")
                    ends[i] = number
        return lower, upper
    if not isinstance(limits, list | tuple | np.ndarray) or not np.iterable(limits) or len(limits) != 2:
        raise InvalidOption(f"{ASKED}, not {limits!r:.60}")
    for name, ends, given in zip(("lower", "upper"), (lower, upper), limits, strict=True):
        if given is not None:
            what = f"the {name} limits must be {robot.n} numbers, one per joint ({', '.join(robot.joint_names)})"
            values = floats(given, what, InvalidOption)
            if values.shape != ends.shape:
                raise InvalidOption(f"{what}, not an array of shape {values.shape}")
            ends[:] = values
    return lower, upper


def _check(robot: Any, lower: np.ndarray, upper: np.ndarray) -> None:
    """Raise InvalidOption for a range that is not finite where it should be, reversed, or wider than the robot's own."""
    good = (lower >= robot.lower) & (upper <= robot.upper) & (lower <= upper) & (lower < np.inf) & (upper > -np.inf)
    if good.all():
        return
    i = int(np.argmin(good))
    joint, own, asked = robot.joint_names[i], (robot.lower[i], robot.upper[i]), (lower[i], upper[i])
    if np.isnan(asked).any():
        raise InvalidOption(f"limits of joint '{joint}' must be numbers, not {asked[0]:g} to {asked[1]:g}")
    if asked[0] > asked[1]:
        raise InvalidOption(f"limits of joint '{joint}' are reversed: lower {asked[0]:g} is above upper {asked[1]:g}")
    # The message has angles in degrees, too, because the user may have given them in degrees in a shell.
    said = "{0:g} to {1:g} m" if robot.joint_kinds[i] == "prismatic" else "{0:g} to {1:g} rad ({2:g} to {3:g} deg)"
    wide, most = (said.format(*ends, *np.degrees(ends)) for ends in (asked, own))
    raise InvalidOption(f"limits of joint '{joint}' can only be narrowed: {wide} reaches beyond the robot's own {most}")
