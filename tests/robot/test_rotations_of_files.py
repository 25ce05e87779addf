"""Files of poses: what the rotations are, whichever form and file they come in."""

import numpy as np
import pinocchio as pin
import pytest

from ik_toolkit.errors import InvalidTarget
from ik_toolkit.robot.pose_files import read_poses


def poses_of(file):
    return np.concatenate([block.poses for block in read_poses(file, "targets")[1]])


@pytest.mark.parametrize("form", ["csv", "npz"])
def test_rotations(tmp_path, form):
    """Quaternions as written with few digits have a length of nearly 1; they are rotations all the same."""
    rng = np.random.default_rng(5)
    R = [pin.exp3(rng.normal(size=3) * size) for size in (0.0, 0.3, 1.0, 2.0, 3.0, 9.0)]
    quats = np.array([pin.Quaternion(one).coeffs() for one in R])
    lengths = np.array([1.0, 1.005, 0.995, 1.009, 0.991, 1.0])[:, None]
    xyz = rng.normal(size=(6, 3))
    if form == "csv":
        file = tmp_path / "poses.csv"
        rows = np.hstack([xyz, quats * lengths])
        file.write_text("x,y,z,qx,qy,qz,qw\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows.tolist()))
    else:
        file = tmp_path / "poses.npz"
        np.savez(file, xyz=xyz, quat_xyzw=quats * lengths)
    T = poses_of(file)
    assert np.abs(T[:, :3, :3] - R).max() < 1e-14 and np.array_equal(T[:, :3, 3], xyz)
    assert np.array_equal(T[:, 3], np.tile([0.0, 0.0, 0.0, 1.0], (6, 1)))


def test_a_quaternion_of_another_length_is_named_with_its_line(tmp_path):
    file = tmp_path / "poses.csv"
    for w in ("1.02", "0.98", "0.0", "nan"):
        file.write_text(f"x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,1\n0,0,0,0,0,0,{w}\n")
        with pytest.raises(InvalidTarget, match="line 3"):
            poses_of(file)


def test_angles(tmp_path):
    file = tmp_path / "poses.csv"
    file.write_text("x,y,z,roll,pitch,yaw\n1,2,3,0.3,-0.4,0.5\n")
    R = pin.rpy.rpyToMatrix(0.3, -0.4, 0.5)
    assert np.abs(poses_of(file)[0, :3, :3] - R).max() < 1e-15
