"""Files of poses: what the rotations are, whichever form and file they come in."""

import numpy as np
import pinocchio as pin
import pytest

from ik_toolkit.errors import InvalidOption, InvalidTarget
from ik_toolkit.robot.pose_files import Convention, read_poses


def poses_of(file, **given):
    return np.concatenate([block.poses for block in read_poses(file, "targets", given=Convention(**given))[1]])


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


TURNS = {
    ("zyx", "a,b,c"): lambda a, b, c: about("z", a) @ about("y", b) @ about("x", c),
    ("zyx", "rx,ry,rz"): lambda a, b, c: about("z", c) @ about("y", b) @ about("x", a),
    ("xyz", "roll,pitch,yaw"): lambda a, b, c: about("x", a) @ about("y", b) @ about("z", c),
    ("zyz", "a,b,c"): lambda a, b, c: about("z", a) @ about("y", b) @ about("z", c),
}


def about(axis, angle):
    return pin.exp3(angle * np.eye(3)["xyz".index(axis)])


@pytest.mark.parametrize(("euler", "columns"), TURNS)
def test_angles_about_other_axes_and_lengths_in_other_units(tmp_path, euler, columns):
    file = tmp_path / "poses.csv"
    file.write_text(f"x;y;z;{columns.replace(',', ';')}\n100;-200;300,5;30;-40;50\n")
    T = poses_of(file, euler=euler, deg=True, length_unit="mm")[0]
    assert np.abs(T[:3, :3] - TURNS[euler, columns](*np.radians([30, -40, 50]))).max() < 1e-15
    assert np.abs(T[:3, 3] - [0.1, -0.2, 0.3005]).max() < 1e-15


@pytest.mark.parametrize(("euler", "columns"), [*TURNS, ("xzy", "rx,ry,rz"), ("yxy", "a,b,c")])
def test_axes_move_with_the_body_as_capitals_do_in_scipy(tmp_path, euler, columns):
    """And the reverse order reads fixed axes, SciPy's lower case, in columns named by axis, or in c,b,a."""
    rotation = pytest.importorskip("scipy.spatial.transform").Rotation
    file, angles = tmp_path / "poses.csv", [0.3, -0.4, 0.5]
    by_axis = {} if columns == "a,b,c" else dict(zip("xyz", angles, strict=True))
    file.write_text(f"x,y,z,{columns}\n1,2,3,0.3,-0.4,0.5\n")
    moving = rotation.from_euler(euler.upper(), [by_axis[axis] for axis in euler] if by_axis else angles).as_matrix()
    for spelled in (euler, euler.upper()):
        assert np.abs(poses_of(file, euler=spelled)[0, :3, :3] - moving).max() < 1e-15
    file.write_text(f"x,y,z,{columns if by_axis else 'c,b,a'}\n1,2,3,0.3,-0.4,0.5\n")
    fixed = rotation.from_euler(euler, [by_axis[axis] for axis in euler] if by_axis else angles).as_matrix()
    assert np.abs(poses_of(file, euler=euler[::-1])[0, :3, :3] - fixed).max() < 1e-15


@pytest.mark.parametrize("euler", ["Zyx", "zy", "zzx", "abc", "zyxz", ""])
def test_a_sequence_of_axes_that_is_none(tmp_path, euler):
    file = tmp_path / "poses.csv"
    file.write_text("x,y,z\n1,2,3\n")
    with pytest.raises(InvalidOption, match="euler names three axes"):
        poses_of(file, euler=euler)
    with pytest.raises(InvalidOption, match="the unit of length is m, cm, mm, in"):
        poses_of(file, length_unit="km")


def test_lengths_of_arrays(tmp_path):
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, :3, 3] = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    np.savez(tmp_path / "poses.npz", targets=T)
    np.savez(tmp_path / "points.npz", targets=T[:, :3, 3])
    (tmp_path / "points.json").write_text(str(T[:, :3, 3].tolist()))
    assert np.allclose(poses_of(tmp_path / "poses.npz", length_unit="mm")[:, :3, 3], 1e-3 * T[:, :3, 3])
    assert np.array_equal(poses_of(tmp_path / "poses.npz", length_unit="mm")[:, :3, :3], T[:, :3, :3])
    for name in ("points.npz", "points.json"):
        assert np.allclose(poses_of(tmp_path / name, length_unit="in"), 0.0254 * T[:, :3, 3])


def test_angles_that_look_like_degrees_are_doubted(tmp_path, caplog, monkeypatch):
    monkeypatch.setattr("ik_toolkit.errors.DOUBTED", set())
    file = tmp_path / "doubted.csv"
    file.write_text("x,y,z,roll,pitch,yaw\n1,2,3,180,0,90\n")
    poses_of(file, deg=True)
    assert not caplog.messages
    poses_of(file)
    assert len(caplog.messages) == 1 and "doubted.csv" in caplog.text and "were degrees meant?" in caplog.text
