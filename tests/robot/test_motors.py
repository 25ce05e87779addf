"""Motor positions and joint values, both ways."""

import math

import numpy as np
import pytest
from refusals import refuses
from robots import urdf

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption, JointNotFound


def test_sign_offset_and_degrees_both_ways():
    robot = ik.Robot.load("scara")
    motors = ik.MotorMap(robot, sign={"elbow": -1}, offset={"shoulder": 0.5, "slide": -0.1}, degrees=True)
    q = motors.to_q([10.0, 20.0, 0.05, -30.0])
    assert q == pytest.approx([0.5 + math.radians(10), -math.radians(20), -0.05, -math.radians(30)])
    back = motors.to_motors(q)
    assert list(back) == list(robot.joint_names) and list(back.values()) == pytest.approx([10.0, 20.0, 0.05, -30.0])
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = robot.random_q(rng)
        assert motors.to_q(motors.to_motors(q)) == pytest.approx(q, abs=1e-12)


def test_many_rows_at_once_and_an_offset_in_degrees_is_doubted():
    robot = ik.Robot.load("scara")
    motors, Q = ik.MotorMap(robot, offset={"shoulder": 0.5}, degrees=True), robot.random_q(np.random.default_rng(2), 7)
    many = motors.to_motors(Q)
    for k, q in enumerate(Q):
        assert {joint: row[k] for joint, row in many.items()} == motors.to_motors(q)
    with pytest.raises(InvalidOption, match=r"shoulder: 90 rad is more than a full turn.*1\.571 rad"):
        ik.MotorMap(robot, offset={"shoulder": 90}, degrees=True)


def test_names_of_lerobot_and_other_entries():
    robot = ik.Robot.load("scara")
    observed = {"elbow.pos": 0.2, "shoulder.pos": 0.1, "spin.pos": 0.3, "slide.pos": -0.1, "gripper.pos": 50.0}
    assert ik.MotorMap(robot).to_q(observed) == pytest.approx([0.1, 0.2, -0.1, 0.3])


def test_a_joint_that_is_named_like_a_motor_is_found_first():
    text = urdf(dict(kind="revolute"), dict(kind="revolute", axis="0 1 0")).replace('"j0"', '"arm.pos"')
    robot = ik.Robot.load(text, tip="l2")
    motors = ik.MotorMap(robot, sign={"arm.pos": -1})
    assert motors.to_q(motors.to_motors([0.3, 0.4])) == pytest.approx([0.3, 0.4])
    assert motors.to_q({"arm": 9.0, "arm.pos": 0.1, "j1.pos": 0.2, "j1": 0.5}) == pytest.approx([-0.1, 0.5])


def test_mistakes_name_the_joint():
    robot = ik.Robot.load("scara")
    to_q = ik.MotorMap(robot).to_q
    with pytest.raises(JointNotFound, match="elbow"):
        ik.MotorMap(robot, sign={"elbw": -1})
    refuses(
        InvalidOption,
        (lambda: ik.MotorMap(robot, sign={"elbow": 2}), "1 or -1"),
        (lambda: ik.MotorMap(robot, offset={"elbow": math.nan}), "elbow"),
        (lambda: ik.MotorMap(robot, offset=0.1), "a dict"),
        (lambda: ik.MotorMap("scara"), "Robot or a Tree"),
    )
    short, rest = {"shoulder": 0.0, "elbow.pos": 0.0}, {"slide": 0.0, "spin": 0.0}
    close = r"for joint slide, spin\. Did you mean 'slid.pos'\? Available: slid\.pos, grip\.$"
    refuses(
        InvalidConfiguration,
        (lambda: to_q({**short, "slid.pos": 0.0, "grip": 1.0}), close),
        (lambda: to_q({**short, "spin": 0.0}), r"for joint slide\.$"),
        (lambda: to_q([0.0, 0.0, math.nan, 0.0]), "that of slide is not"),
        (lambda: to_q([0.0, 0.0, 0.0]), r"4 numbers \(.*\), or \(N, 4\), not an array of shape \(3,\)"),
        (lambda: to_q({**short, **rest, "shoulder": [0.0, 0.1]}), r"equally many; .*'shoulder': \(2,\)"),
    )


def test_a_recorded_motion_of_motors_comes_back_as_joint_values():
    robot = ik.Robot.load("scara")
    motors = ik.MotorMap(robot, sign={"elbow": -1}, offset={"shoulder": 0.2}, degrees=True)
    Q = np.array([robot.random_q(np.random.default_rng(k)) for k in range(5)])
    commands = motors.to_motors(Q)
    assert np.allclose(motors.to_q(commands), Q, atol=1e-12)
    assert np.allclose(motors.to_q(np.column_stack(list(commands.values()))), Q, atol=1e-12)
    assert repr(motors) == "MotorMap('scara', reversed=['elbow'], offset={'shoulder': 0.2}, degrees=True)"
