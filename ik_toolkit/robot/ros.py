"""ROS messages, as objects or as dicts of plain numbers (JSON, rosbridge), field by field, without importing ROS."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import InvalidConfiguration, InvalidTarget, floats

LARGEST_NANOSEC = 999_999_999  # The largest valid nanosec of a ROS time. A fraction that rounds to 1 s is cut to it.


POINT, QUATERNION = "xyz", "xyzw"  # The fields of the ROS messages Point and Vector3, and those of Quaternion.


def _field(message: Any, name: str) -> Any:
    """Return a field of a message, given as an object or a dict; None if it has no such field."""
    return message.get(name) if isinstance(message, Mapping) else getattr(message, name, None)


def has_fields(message: Any, names: Sequence[str]) -> bool:
    """Return whether an object or dict has all fields in `names`: so ROS messages are recognised where ROS is not installed."""
    if isinstance(message, Mapping):
        return all(name in message for name in names)
    return all(hasattr(message, name) for name in names)


def is_by_name(value: Any) -> bool:
    """Return whether a value is a dict from names of tips to targets, rather than a dict of the fields of one ROS message."""
    fields = ("header", "position", "orientation", "translation", "rotation")
    if not isinstance(value, Mapping) or has_fields(value, POINT) or any(name in value for name in fields):
        return False
    return listed_poses(value) is None


def _inner(message: Any) -> tuple[Any, Any, Any] | None:
    """Return a message's header (None without one), point and quaternion (None for a point); None if it is not such a message."""
    header = _field(message, "header")
    if header is not None:
        stamped = (_field(message, inner) for inner in ("pose", "transform", "point"))
        message = next((inner for inner in stamped if inner is not None), message)
    for point, turn in (("position", "orientation"), ("translation", "rotation")):
        at, by = _field(message, point), _field(message, turn)
        if has_fields(at, POINT) and has_fields(by, QUATERNION):
            return header, at, by
    return (header, message, None) if has_fields(message, POINT) and not has_fields(message, "w") else None


def read_pose(message: Any, base: str = "") -> tuple[np.ndarray, np.ndarray | None] | None:
    """Return position (3,) [m] and quaternion x, y, z, w (4,) of a ROS message with a pose or point; None for anything else.

    Args:
        message: a geometry_msgs Pose, PoseStamped, Transform, TransformStamped, Point, PointStamped or Vector3, or an object or
            dict with the same fields. The quaternion of a point is None. A number that is None (null in JSON, which has no NaN)
            is NaN.
        base: the robot's base frame, in which a stamped message must be given; "" checks nothing, and neither does an empty
            frame_id.

    Raises:
        InvalidTarget: the message is given in another frame, or a field holds no number.
    """
    found = _inner(message)
    if found is None:
        return None
    header, at, by = found
    _require_frame(header, base)
    return _numbers(at, POINT), None if by is None else _numbers(by, QUATERNION)


def listed_poses(message: Any, base: str = "") -> list[Any] | None:
    """Return the list of poses, each a ROS message, in a geometry_msgs/PoseArray or nav_msgs/Path; None for anything else.

    Its header may be missing if every entry is a pose. Raises InvalidTarget if it is given in another frame than `base` (as in
    `read_pose`).
    """
    header, poses = _field(message, "header"), _field(message, "poses")
    if not isinstance(poses, Sequence) or (header is None and any(read_pose(one) is None for one in poses)):
        return None
    _require_frame(header, base)
    return list(poses)


def _require_frame(header: Any, base: str) -> None:
    """Raise InvalidTarget if the frame of a header is not `base`; an empty one is not checked."""
    frame = str(_field(header, "frame_id") or "").lstrip("/")
    if base and frame and frame != base:
        raise InvalidTarget(
            f"the target is given in the frame '{frame}', and the robot's base is '{base}'; transform it to that frame, or "
            f"load the robot with base='{frame}' where the description has it"
        )


def _numbers(message: Any, names: str) -> np.ndarray:
    """Return the fields `names` of a message as an array."""
    given = [_field(message, name) for name in names]
    what = f"the fields {', '.join(names)} of a ROS message must be numbers"
    array = floats([np.nan if value is None else value for value in given], what, InvalidTarget)
    if array.shape != (len(names),):
        raise InvalidTarget(f"{what}, not {' '.join(repr(given).split())[:120]}")
    return array


def read_joint_state(message: Any, name: str) -> dict[str, float] | None:
    """Return joint values by name of a sensor_msgs/JointState or an object or dict with its fields; None for anything else.

    Args:
        message: what may be a JointState: parallel lists `name` and `position`.
        name: name of the argument, for messages.

    Raises:
        InvalidConfiguration: the lists differ in length, or a joint is named twice.
    """
    names, values = _field(message, "name"), _field(message, "position")
    try:
        if isinstance(names, str):
            return None
        names, values = [str(joint) for joint in names], list(values)
    except TypeError:  # A dict of joint values may have joints called "name" and "position", whose values are numbers.
        return None
    if len(names) != len(values):
        raise InvalidConfiguration(f"{name}: the JointState has {len(names)} names and {len(values)} positions")
    twice = sorted({joint for joint in names if names.count(joint) > 1})
    if twice:
        raise InvalidConfiguration(f"{name}: the JointState names joint {', '.join(twice)} more than once")
    return dict(zip(names, values, strict=True))


def header(frame: str = "") -> dict[str, Any]:
    """Return the fields of a std_msgs/Header with time zero and this frame, as a dict."""
    return {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}


def joint_trajectory(
    names: Sequence[str], frame: str, t: np.ndarray, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray | None = None
) -> dict[str, Any]:
    """Return the fields of a trajectory_msgs/JointTrajectory, as a dict, with a point for each time t (N,) [s].

    q, dq, ddq (N, n) are joint values [rad or m], rates [per s] and accelerations [per s^2].
    """
    whole = np.floor(t).astype(int)
    nanos = np.minimum(np.round((t - whole) * 1e9), LARGEST_NANOSEC).astype(int)
    times = [{"sec": sec, "nanosec": nanosec} for sec, nanosec in zip(whole.tolist(), nanos.tolist(), strict=True)]
    none: list[list[float]] = [[]] * len(q)
    columns = (q.tolist(), dq.tolist(), none if ddq is None else ddq.tolist(), none, times)
    fields = ("positions", "velocities", "accelerations", "effort", "time_from_start")
    points = [dict(zip(fields, row, strict=True)) for row in zip(*columns, strict=True)]
    return {"header": header(frame), "joint_names": list(names), "points": points}
