"""ROS messages as dicts of plain numbers, field by field, without importing ROS."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import InvalidConfiguration, InvalidTarget

LARGEST_NANOSEC = 999_999_999  # largest valid nanosec of a ROS time; rounding must not reach a whole second


POINT, QUATERNION = "xyz", "xyzw"  # fields of geometry_msgs/Point, Vector3 and Quaternion


def has_fields(message: Any, names: Sequence[str]) -> bool:
    """Return whether an object has all attributes in `names`, which is how messages are recognised without ROS."""
    return all(hasattr(message, name) for name in names)


def read_pose(message: Any, base: str = "") -> tuple[np.ndarray, np.ndarray | None] | None:
    """Return position (3,) [m] and quaternion x, y, z, w (4,) of a ROS message; None if it is no such message.

    Args:
        message: a geometry_msgs Pose, PoseStamped, Transform, TransformStamped, Point, PointStamped or Vector3, or an object with
            the same fields. The quaternion of a point is None.
        base: the robot's base frame, in which a stamped message must be given; "" checks nothing, and neither does an empty
            frame_id.

    Raises:
        InvalidTarget: the message is given in another frame.
    """
    frame = str(getattr(getattr(message, "header", None), "frame_id", "")).lstrip("/")
    for inner in ("pose", "transform", "point"):
        if hasattr(message, "header") and hasattr(message, inner):
            if base and frame and frame != base:
                raise InvalidTarget(
                    f"the target is given in the frame '{frame}', and the robot's base is '{base}'; transform it to that frame, or "
                    f"load the robot with base='{frame}' where the description has it"
                )
            message = getattr(message, inner)
            break
    for point, turn in (("position", "orientation"), ("translation", "rotation")):
        if has_fields(message, (point, turn)):
            at, by = getattr(message, point), getattr(message, turn)
            if has_fields(at, POINT) and has_fields(by, QUATERNION):
                return _numbers(at, POINT), _numbers(by, QUATERNION)
    if has_fields(message, POINT) and not hasattr(message, "w"):
        return _numbers(message, POINT), None
    return None


def _numbers(message: Any, names: str) -> np.ndarray:
    """Return the fields `names` of a message as an array."""
    try:
        return np.array([float(getattr(message, name)) for name in names])
    except (TypeError, ValueError):
        raise InvalidTarget(f"the fields {', '.join(names)} of {type(message).__name__} must be numbers") from None


def read_joint_state(message: Any, name: str) -> dict[str, float] | None:
    """Return joint values by name of a sensor_msgs/JointState or an object with its fields; None for anything else.

    Args:
        message: what may be a JointState: parallel lists `name` and `position`.
        name: of the argument, for messages.

    Raises:
        InvalidConfiguration: the lists differ in length, or a joint is named twice.
    """
    if not has_fields(message, ("name", "position")):
        return None
    names, values = [str(joint) for joint in message.name], list(message.position)
    if len(names) != len(values):
        raise InvalidConfiguration(f"{name}: the JointState has {len(names)} names and {len(values)} positions")
    twice = sorted({joint for joint in names if names.count(joint) > 1})
    if twice:
        raise InvalidConfiguration(f"{name}: the JointState names joint {', '.join(twice)} more than once")
    return dict(zip(names, values, strict=True))


def header(frame: str = "") -> dict[str, Any]:
    """Return a std_msgs/Header with zero time."""
    return {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}


def joint_trajectory(
    names: Sequence[str], frame: str, t: np.ndarray, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray | None = None
) -> dict[str, Any]:
    """Return a trajectory_msgs/JointTrajectory with a point for each row of t (N,) [s] and q, dq, ddq (N, n) [rad or m, s]."""
    whole = np.floor(t).astype(int)
    nanos = np.minimum(np.round((t - whole) * 1e9), LARGEST_NANOSEC).astype(int)
    rows = zip(
        q.tolist(),
        dq.tolist(),
        [[]] * len(q) if ddq is None else ddq.tolist(),
        whole.tolist(),
        nanos.tolist(),
        strict=True,
    )
    points = [
        {
            "positions": positions,
            "velocities": velocities,
            "accelerations": accelerations,
            "effort": [],
            "time_from_start": {"sec": sec, "nanosec": nanosec},
        }
        for positions, velocities, accelerations, sec, nanosec in rows
    ]
    return {"header": header(frame), "joint_names": list(names), "points": points}
