"""Writes ROS messages as dicts of plain numbers, field by field, without importing ROS."""

from collections.abc import Sequence
from typing import Any

import numpy as np

LARGEST_NANOSEC = 999_999_999  # Nanoseconds are capped here, because rounding could give a whole second.


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
