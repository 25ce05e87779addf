"""ROS messages, field by field."""

import numpy as np

from ik_toolkit.robot.ros import header, joint_trajectory


def test_a_joint_trajectory_field_by_field():
    t = np.array([0.0, 0.25, 1.9999999999, 2.0])
    q, dq, ddq = (np.arange(8.0).reshape(4, 2) + start for start in (0.0, 10.0, 20.0))
    said = joint_trajectory(("a", "b"), "base", t, q, dq, ddq)
    assert said.keys() == {"header", "joint_names", "points"} and said["joint_names"] == ["a", "b"]
    assert said["header"] == header("base") == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "base"}
    for k, (sec, nanosec) in enumerate([(0, 0), (0, 250_000_000), (1, 999_999_999), (2, 0)]):
        assert said["points"][k] == {
            "positions": q[k].tolist(),
            "velocities": dq[k].tolist(),
            "accelerations": ddq[k].tolist(),
            "effort": [],
            "time_from_start": {"sec": sec, "nanosec": nanosec},
        }
    assert [point["accelerations"] for point in joint_trajectory(("a", "b"), "", t, q, dq)["points"]] == [[]] * 4
