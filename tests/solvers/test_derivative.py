"""How an answer follows a small motion of its target."""

import numpy as np
import pinocchio as pin
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidTarget, NotSolved


def moved(T, x):
    """The pose T (4, 4) moved by x (6,) in base axes: displacement, rotation vector."""
    T = T.copy()
    T[:3, :3], T[:3, 3] = pin.exp3(x[3:]) @ T[:3, :3], T[:3, 3] + x[:3]
    return T


@pytest.mark.parametrize("name", ["hydrolek_7w", "continuous_mix", "slides_mix", "inspection_7dof"])
def test_the_tip_follows_as_the_derivative_says(name):
    robot = robots.load(name)
    Q, T = robots.sample(robot, 5, seed=1)
    for q, pose in zip(Q, T, strict=True):
        result = ik.solve(robot, pose, q0=q)
        D = result.derivative()
        assert D.shape == (robot.n, 6)
        for x in np.eye(6) * 1e-6:
            tip = robot.fk(result.q + D @ x).homogeneous
            wanted = moved(robot.fk(result.q).homogeneous, x)
            assert np.abs(tip - wanted).max() < 1e-9
        unit = robot.chain.unit
        J = robot.chain.forward(result.q, jacobian=True)[1][0] * unit
        rest = np.eye(robot.n) - np.linalg.pinv(J) @ J
        assert np.abs(rest @ (D / unit[:, None])).max() < 1e-6  # nothing of it is in the null space


def test_a_position_has_three_columns_and_its_answer_follows_by_newton():
    for name in ("planar_2r", "planar_3r"):  # The three joints of the second still move its tip in a plane only.
        planar = robots.load(name)
        result = ik.solve(planar, planar.fk(np.linspace(0.3, 0.5, planar.n)).translation)
        with pytest.raises(InvalidConfiguration, match="moves in only 2 directions"):
            result.derivative()
    arm = robots.load("hydrolek_7w")
    found = ik.solve(arm, arm.fk(arm.home).homogeneous[:3, 3])
    D = found.derivative()
    x = np.array([1e-6, -2e-6, 3e-6])
    assert D.shape == (6, 3)
    tip = arm.fk(found.q + D @ x).homogeneous[:3, 3] - arm.fk(found.q).homogeneous[:3, 3]
    assert np.abs(tip - x).max() < 1e-10


def test_held_joints_stay():
    robot = robots.load("inspection_7dof")
    q = robots.sample(robot, 1, seed=3)[0][0]
    result = ik.solve(robot, robot.fk(q), "lm", q0=q, joint_weights=(1, 0, 1, 1, 1, 1, 1))
    assert (result.derivative()[1] == 0.0).all()


def test_where_there_is_none():
    robot = robots.load("hydrolek_7w")
    with pytest.raises(NotSolved):
        ik.solve(robot, ik.pose(xyz=(9.0, 0.0, 0.0), rpy=(0, 0, 0))).derivative()
    with pytest.raises(InvalidTarget):
        ik.solve(robot, robot.fk(robot.home), free_turn="z").derivative()
    straight = robots.load("inspection_7dof")
    with pytest.raises(InvalidConfiguration, match="singular"):
        ik.solve(straight, straight.fk(np.zeros(7)), q0=np.zeros(7)).derivative()
