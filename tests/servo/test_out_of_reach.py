"""Targets where the arm cannot get: down to the least weighted error nearby, to rest there, or on with a target that moves."""

import numpy as np
import pinocchio as pin
import pytest
from serial_arms import urdf

import ik_toolkit as ik
from ik_toolkit.servo.step import StepStatus
from ik_toolkit.servo.workspace import STATE


def slope_left(robot, q, target):
    """Slope of the error along each joint that limits leave free, over the error [m and 0.2 m for a radian]."""
    T, J = (one[0] for one in robot.chain.forward(q[None], jacobian=True))
    if target.ndim == 1:
        e, J = target - T[:3, 3], J[:3]
    else:
        e = np.append(target[:3, 3] - T[:3, 3], 0.2 * pin.log3(target[:3, :3] @ T[:3, :3].T))
        J = np.append(J[:3], 0.2 * J[3:], axis=0)
    slope = J.T @ e
    stopped = (q <= robot.lower + 1e-7) & (slope < 0.0) | (q >= robot.upper - 1e-7) & (slope > 0.0)
    return np.abs(np.where(stopped, 0.0, slope)).max() / np.linalg.norm(e)


READY = (0.0, -0.7854, 0.0, -2.3562, 0.0, 1.5708, 0.7854)
HALF_A_METRE_OUT = (0.8477, 0.0, 1.3448), (3.1416, 0.0, 0.0)


@pytest.mark.parametrize(
    ("name", "method", "acceleration", "q0", "place", "turn"),
    [
        ("ur10_limited", "cv", None, (-1.573, 2.594, -0.133, -2.993, 1.222, 3.1415),
         (0.229, 0.955, -0.691), (0.076, 0.608, -2.718)),
        ("inspection_7dof", "cv", None, (-2.276, 0.259, -0.081, 0.929, 1.483, 1.739, -2.094),
         (-0.325, 0.004, 0.936), (1.031, 1.328, 0.846)),
        ("ur3_limited", "aad", 10.0, (-0.657, 0.296, 2.758, -0.948, 1.369, -2.195),
         (-0.421, 0.482, -0.357), (-1.395, 2.48, -0.618)),
        ("so100", "aad", None, (1.609, 1.682, -0.367, -2.235, 2.16), (-0.163, 0.081, -0.063), (-1.502, 2.412, -0.708)),
        ("talos_arm", "cv", None, (1.071, 1.455, -1.23, -1.869, -0.496, -0.278), (-0.187, 0.378, 0.727), (2.653, -1.329, -0.696)),
        ("panda", "cv", None, (-0.369, -0.299, 1.673, -2.365, -1.663, 1.98, 1.451), (0.369, 0.959, 1.229), (0.963, 1.325, 1.108)),
        ("panda", "cv", None, (1.659, -0.651, 1.564, -1.703, 0.812, 2.332, -0.665),
         (-0.516, -0.744, 0.537), (1.606, -1.94, -0.429)),
        ("ur5", "cv", None, (3.56, 0.329, -0.409, -1.031, -3.229, 0.013), (-1.153, -0.631, 0.192), None),
        *[("panda", method, limit, READY, *HALF_A_METRE_OUT) for method in ("cv", "aad") for limit in (None, 10.0)],
    ],
)  # fmt: skip
def test_the_arm_rests_where_no_way_down_is_left(name, method, acceleration, q0, place, turn):
    """Joints at limits and singular poses ended the way 2 to 98 mm short of it, or turned back in every step."""
    robot = ik.Robot.load(name)
    target = np.array(place) if turn is None else pin.SE3(pin.exp3(np.array(turn)), np.array(place)).homogeneous
    tracker = ik.Tracker(robot, method, q0=q0, acceleration_limits=acceleration)
    steps = [tracker.update(target, 0.01) for _ in range(800)]
    known = tracker.stepper.state.copy()
    tracker.update(np.nan * target, 0.01)
    parts = slice(STATE.share, STATE.turned + 1)
    assert np.array_equal(tracker.stepper.state[parts], known[parts]), "a step that brakes is not taken notice of"
    assert slope_left(robot, steps[-1].q, target) < 1e-5
    assert np.abs([step.rate for step in steps[-50:]]).max() < 1e-3
    assert steps[-1].status is StepStatus.AT_LIMIT and steps[-1].position_error > 0.01
    assert steps[-1].at_rest and not steps[0].at_rest


@pytest.mark.parametrize("method", ["cv", "ca", "aad"])
def test_a_stretched_arm_points_at_a_target_that_passes(method):
    """Beyond reach the tip goes as much less far as it is nearer to the base. The joints turned back and forth at full speed."""
    robot = ik.Robot.load("planar_2r")
    angle = 0.3 + 0.5 * 0.01 * np.arange(301)
    targets = 1.5 * robot.reach * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    tracker = ik.Tracker(robot, method, q0=[angle[0], 0.3])
    q = np.array([tracker.update(target, 0.01).q for target in targets[1:]])
    np.testing.assert_allclose(q[100:, 0], angle[101:], atol=5e-4)
    np.testing.assert_allclose(q[100:, 1], 0.0, atol=2e-3)


@pytest.mark.parametrize(
    ("name", "method", "pose"),
    [("panda", "cv", False), ("xarm7", "aad", False), ("so101", "cv", True), ("ur5", "ca", True)],
)
def test_beyond_reach_joints_follow_smoothly(name, method, pose):
    """They drifted, and were pulled back in one step, or turned back and forth: up to 670 rad/s^2, now below 1."""
    robot = ik.Robot.load(name)
    start = pin.SE3(robot.fk(0.5 * (np.maximum(robot.lower, -2.0) + np.minimum(robot.upper, 2.0))))
    out = start.translation / np.linalg.norm(start.translation)
    tracker = ik.Tracker(robot, method, q0=0.5 * (np.maximum(robot.lower, -2.0) + np.minimum(robot.upper, 2.0)))
    rates = []
    for k in range(390):
        turn = pin.exp3(np.array([0.0, 0.0, 0.004 * k]))
        far = start.translation + min(k / 150, 1.0) * (1.3 * robot.reach * out - start.translation)
        target = pin.SE3(turn @ start.rotation, turn @ far).homogeneous
        rates.append(tracker.update(target if pose else target[:3, 3], 0.01).rate)
    assert np.abs(np.diff(rates[200:], axis=0)).max() < 0.02


def test_a_slow_joint_is_not_left_behind():
    """The torso of a TIAGo, up to 65 times slower than the arm's joints, follows what the stretched arm cannot."""
    robot = ik.Robot.load("tiago")
    q0 = np.array([0.0, 1.66, -0.527, -1.535, 0.144, 0.681, -1.08, -0.577])
    tracker = ik.Tracker(robot, q0=q0, rate0=np.zeros(8), acceleration_limits=5.0 * robot.velocity_limits)
    target, errors = robot.fk(q0).homogeneous, []
    for _ in range(300):
        target[:3, 3] += 0.01 * robot.velocity_limits[0] * np.array([-0.5, 0.0, 0.8])
        errors.append(tracker.update(target, 0.01).position_error)
    assert max(errors) < 0.03 and max(errors[100:]) < 1e-4


@pytest.mark.parametrize("acceleration", [None, 5.0], ids=["speeds", "accelerations"])
def test_an_arm_that_is_held_back_does_not_hold_back_the_other(acceleration):
    """Baxter: one target goes far out of reach, the other up and down by 5 cm. That arm fell behind by 14 mm, for ever."""
    robot = ik.Tree.load("baxter", tips=["left_gripper", "right_gripper"])
    limits = None if acceleration is None else acceleration * robot.velocity_limits
    tracker = ik.Tracker(robot, q0=robot.home, acceleration_limits=limits)
    start, errors = {tip: T.homogeneous for tip, T in robot.fk(robot.home).items()}, []
    for k in range(500):
        targets = {tip: T.copy() for tip, T in start.items()}
        targets["left_gripper"][:3, 3] *= 1.0 + 1.2 * min(k / 200, 1.0)
        targets["right_gripper"][2, 3] += 0.05 * np.sin(2.0 * np.pi * k / 200)
        now = robot.fk(tracker.update(targets, 0.01).q)["right_gripper"]
        errors.append(np.linalg.norm(now.translation - targets["right_gripper"][:3, 3]))
    assert max(errors[300:]) < 1e-4


def test_with_the_reach_as_length_scale_it_ends_where_solve_does():
    robot, ends = ik.Robot.load("hydrolek_7w"), []
    target = robot.fk(robot.home).homogeneous.copy()
    target[0, 3] += 1.2 * robot.reach
    target[:3, :3] = target[:3, :3] @ pin.exp3(np.array([0.3, 0.5, 0.2]))
    for options in ({"length_scale": robot.reach}, {}):
        tracker = ik.Tracker(robot, "cv", q0=robot.home, **options)
        for _ in range(600):
            step = tracker.update(target, 0.02)
        ends.append(step)
    ends.append(ik.solve(robot, target, q0=ends[0].q))
    alike, usual, nearest = ((one.position_error / robot.reach) ** 2 + one.orientation_error**2 for one in ends)
    assert alike == pytest.approx(nearest, rel=1e-4)
    assert usual > 1.1 * nearest and ends[1].position_error < ends[0].position_error


@pytest.mark.parametrize("method", ["cv", "aad", "ca", "aa"])
@pytest.mark.parametrize("acceleration", [2.0, 5.0, 20.0])
def test_a_single_joint_does_not_swing_before_a_target_far_away(method, acceleration):
    """Its acceleration limit makes it turn back slowly, and by so little of the error that it passed as progress."""
    joint = ("revolute", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), -3.0, 3.0)
    robot = ik.Robot.load(urdf([joint], ((0.4, 0.0, 0.0), (0.0, 0.0, 0.0))))
    tracker = ik.Tracker(robot, method, q0=[-1.5], acceleration_limits=acceleration)
    steps = [tracker.update((6.0, 0.3, 0.0), 0.01) for _ in range(1000)]
    assert steps[-1].status is StepStatus.AT_LIMIT
    assert np.ptp([step.q[0] for step in steps[-200:]]) < 1e-6
    assert steps[-1].q[0] == pytest.approx(np.arctan2(0.3, 6.0), abs=1e-4)
