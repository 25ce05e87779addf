"""Poses: conversions against Pinocchio, and rejected input."""

import math
import re

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ik_toolkit as ik
from ik_toolkit.errors import InvalidTarget
from ik_toolkit.robot.pose import check_target
from ik_toolkit.robot.rotation import matrix_quat, matrix_rpy, quat_matrix, rpy_matrix

angle = st.floats(-math.pi, math.pi)


@given(angle, angle, angle)
def test_rpy_is_pinocchios(roll, pitch, yaw):
    R = rpy_matrix((roll, pitch, yaw))
    assert np.allclose(R, pin.rpy.rpyToMatrix(roll, pitch, yaw), atol=1e-15)
    assert np.allclose(rpy_matrix(matrix_rpy(R)), R, rtol=0.0, atol=2e-15)


def test_rpy_keeps_its_digits_towards_vertical_pitch():
    """Near 90 degrees roll and yaw are each read from noise; together they must still be the rotation."""
    rng = np.random.default_rng(0)
    for off in 10.0 ** np.arange(-16.0, 0.0, 0.25):
        for side in (1.0, -1.0):
            R = rpy_matrix((rng.uniform(-3, 3), side * (math.pi / 2 - off), rng.uniform(-3, 3)))
            R = R @ rpy_matrix(1e-16 * rng.normal(size=3))
            assert np.abs(rpy_matrix(matrix_rpy(R)) - R).max() < 3e-15


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_rpy_at_vertical_pitch(pitch):
    R = rpy_matrix((0.3, pitch, -0.7))
    rpy = matrix_rpy(R)
    assert rpy[2] == 0.0
    assert np.allclose(rpy_matrix(rpy), R, atol=1e-12)


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 1e-3))
def test_quaternion_order_is_xyzw(quat):
    q = np.array(quat) / np.linalg.norm(quat)
    R = quat_matrix(q)
    assert np.allclose(R, pin.Quaternion(q[3], q[0], q[1], q[2]).matrix(), atol=1e-12)
    assert np.allclose(quat_matrix(q[[3, 0, 1, 2]], "wxyz"), R, atol=1e-15)
    back = matrix_quat(R)
    assert back[3] >= 0.0
    assert np.allclose(quat_matrix(back), R, atol=1e-9)


def test_pose_builds_positions_and_poses():
    assert ik.pose((1, 2, 3)).shape == (3,)
    T = ik.pose((1, 2, 3), rpy=(0.1, 0.2, 0.3))
    assert T.shape == (4, 4) and np.allclose(T[:3, 3], (1, 2, 3))
    assert np.allclose(ik.pose((1, 2, 3), rotation=T[:3, :3]), T)
    quat = matrix_quat(T[:3, :3])
    assert np.allclose(ik.pose((1, 2, 3), quat_wxyz=quat[[3, 0, 1, 2]]), T)
    for words, said in (
        ({"quat_wxyz": quat, "rpy": (0, 0, 0)}, "give one of rpy, quat_xyzw, quat_wxyz and rotation"),
        ({"quat_wxyz": quat, "quat_xyzw": quat}, "give one of rpy, quat_xyzw, quat_wxyz and rotation"),
        ({"quat_wxyz": quat, "direction": (0, 0, 1)}, "do not also give rpy, a quaternion or rotation"),
        ({"axis": (1, 0, 0)}, "points along a direction; give direction= too, or omit axis"),
        ({"axis": (1, 0, 0), "rpy": (0, 0, 0)}, "points along a direction; give direction= too, or omit axis"),
    ):
        with pytest.raises(InvalidTarget, match=said):
            ik.pose((0, 0, 0), **words)


NONSENSE = [
    "nonsense", None, 7, [1, 2], np.zeros((4, 4)), np.eye(4) * np.nan, np.diag([2.0, 2, 2, 1]), np.diag([1.0, 1, -1, 1]),
    np.eye(3), np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1]]), (math.nan, 0, 0), (math.inf, 0, 0), {"x": 1},
]  # fmt: skip


@pytest.mark.parametrize("target", NONSENSE, ids=str)
def test_nonsense_is_refused(target):
    with pytest.raises(InvalidTarget):
        check_target(target)


def test_a_direction_at_a_position_that_is_no_place():
    with pytest.raises(InvalidTarget, match="below"):
        ik.pose((1e101, 0, 0), direction=(0, 0, 1))


@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-9, 1e-6, 3e-6, 1e-5, 1e-3, 1.0])
def test_a_direction_opposite_to_the_axis_makes_a_rotation(off):
    rng = np.random.default_rng(2)
    for _ in range(20):
        axis = rng.normal(size=3)
        direction = off * rng.normal(size=3) - axis
        R = ik.pose((0, 0, 0), axis=axis, direction=direction).T_base_tip[:3, :3]
        assert np.allclose(R @ R.T, np.eye(3), atol=1e-14) and np.linalg.det(R) > 0.0
        turned = R @ axis / np.linalg.norm(axis)
        assert np.allclose(turned, direction / np.linalg.norm(direction), atol=1e-14)


@pytest.mark.parametrize("rotation", ["nonsense", [1, 2], np.zeros((4, 4)), np.eye(2), {"x": 1}], ids=str)
def test_a_rotation_is_three_by_three_numbers(rotation):
    with pytest.raises(InvalidTarget, match="rotation must be 3x3 numbers"):
        ik.pose((0, 0, 0), rotation=rotation)


def test_a_nearly_rigid_rotation_is_projected_and_said_so():
    T = ik.pose((0.4, 0.1, 0.2), rpy=(0.3, 0.2, 0.1))
    typed = np.round(T, 3)
    fixed, notice = check_target(typed)
    assert "projected" in notice
    assert np.allclose(fixed[:3, :3] @ fixed[:3, :3].T, np.eye(3), atol=1e-14)
    assert np.abs(fixed - T).max() < 2e-3
    assert (typed == np.round(T, 3)).all()
    far = T.copy()
    far[:3, :3] *= 1.02
    with pytest.raises(InvalidTarget, match=r"not rigid \(determinant 1\.061\): a singular value is off 1 by 0\.02"):
        check_target(far)
    with pytest.raises(InvalidTarget, match=r"not rigid \(determinant -1\): it mirrors, as left-handed axes do"):
        check_target(T * [[1], [1], [-1], [1]])
    assert check_target(pin.SE3(T))[1] == ""


def test_a_rotation_that_is_changed_is_said(caplog):
    R = np.eye(3)
    R[0, 1] = 3e-3
    for call in (
        lambda: ik.pose((0, 0, 0), rotation=R),
        lambda: ik.line(np.block([[R, np.zeros((3, 1))], [np.eye(4)[3:]]]), np.eye(4), duration=1.0),
    ):
        caplog.clear()
        call()
        assert "was projected to the nearest rotation" in caplog.text


@pytest.mark.parametrize("name", ["quat_xyzw", "quat_wxyz"])
def test_a_quaternion_far_from_length_1_is_refused_and_one_near_is_said(name, caplog, monkeypatch):
    monkeypatch.setattr("ik_toolkit.errors.DOUBTED", set())
    monkeypatch.setattr("ik_toolkit.robot.pose.DOUBTED", set())
    quat = np.array([0.5, -0.5, 0.1, 0.7])
    quat /= np.linalg.norm(quat)
    T = ik.pose((0, 0, 0), **{name: quat})
    for length in (2.0, 1.02, 0.98, 0.0, 1e200):
        said = re.escape(f"{name} has length {length:.4g}: not a rotation, which has length 1; ")
        with pytest.raises(InvalidTarget, match=rf"{said}.* in the order {', '.join(name[5:])}$"):
            ik.pose((0, 0, 0), **{name: length * quat})
    assert np.allclose(ik.pose((0, 0, 0), **{name: np.round(quat, 4)}), T, atol=1e-3) and not caplog.records
    for length in (1.0099, 0.991, 1.005):
        assert np.allclose(ik.pose((0, 0, 0), **{name: length * quat}), T, atol=1e-12)
    (said,) = caplog.messages  # once, also in a loop
    assert said == f"{name} has length 1.01 and was normalised"


def test_a_ros_message_with_a_long_quaternion_is_refused():
    point, turn = {"x": 0.5, "y": 0.0, "z": 0.3}, {"x": 0.0, "y": 0.0, "z": 0.0, "w": 2.0}
    with pytest.raises(InvalidTarget, match="quat_xyzw has length 2"):
        ik.solve(ik.Robot.load("planar_2r"), {"position": point, "orientation": turn})
