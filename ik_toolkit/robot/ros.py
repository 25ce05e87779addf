"""ROS messages as dicts of plain numbers, field by field, without importing ROS."""

from collections.abc import Sequence
from typing import Any

import numpy as np

LARGEST_NANOSEC = 999_999_999  # so that rounding does not give a whole second


def header(frame: str = "") -> dict[str, Any]:
    """A std_msgs/Header with zero time."""
    return {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}


def joint_trajectory(
    names: Sequence[str], frame: str, t: np.ndarray, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray | None = None
) -> dict[str, Any]:
    """A trajectory_msgs/JointTrajectory: t (N,) [s], q, dq and ddq (N, n) [rad or m, per s, per s^2], one point per row."""
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
