"""What a tip does relative to another comes first, and a step says when the arm cannot do all that is asked."""

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.motion.reference import exp
from ik_toolkit.servo.step import StepStatus


@pytest.mark.parametrize("on_limit", ["direct", "leave"])
def test_a_grasp_of_two_hands_is_kept_where_a_speed_limit_binds(on_limit):
    tree = ik.Tree.load("brokk_hydrolek")
    left, right = tree.tips
    for seed in range(3):
        q = tree.home + 0.35 * (tree.random_q(np.random.default_rng(seed)) - tree.home)
        tracker = ik.Tracker(tree, "cv", q0=q, relative_to={right: left}, on_limit=on_limit, reconfigure=False)
        begun, statuses = tree.fk(q), set()
        grasp, T = begun[left].actInv(begun[right]), begun[left].homogeneous
        for k in range(300):
            T[2, 3] = begun[left].translation[2] + 0.1 * np.sin(0.015 * k)
            step = tracker.update({left: T, right: grasp}, 0.005)
            now = tree.fk(step.q)
            assert np.linalg.norm(now[left].actInv(now[right]).translation - grasp.translation) < 5e-5
            statuses.add(step.status)
        assert StepStatus.LIMITED in statuses


@pytest.mark.parametrize("method", ["cv", "aad", "ca"])
@pytest.mark.parametrize("name", ["planar_3r", "planar_2r"])
def test_an_arm_of_few_joints_that_is_off_its_target_says_so(name, method):
    """A full pose that moves away from what the arm can do: OK stands for at the target, or coming nearer."""
    robot = robots.load(name)
    q = robot.home + 0.2
    tracker, T, off = ik.Tracker(robot, method, q0=q), robot.fk(q).homogeneous.copy(), 0
    for k in range(150):
        T[:3, 3] += (0.0, 3e-4 * np.cos(0.02 * k), 3e-4 * np.cos(0.02 * k))  # also out of the plane, and back
        step = tracker.update(T, 0.01)
        if step.position_error > 1.1e-3:
            off += 1
            assert step.status is StepStatus.LIMITED and "mm" in step.reason, step
    assert off > 50


def test_coming_nearer_is_said():
    robot = robots.load("planar_3r")
    q = np.array([0.1, 0.5, 0.4])
    tracker = ik.Tracker(robot, "cv", q0=q, kappa=5.0)
    target = robot.fk(q).translation + np.array([-0.03, 0.03, 0.0])
    reasons = []
    for _ in range(10):
        step = tracker.update(target, 0.01)
        assert step.status is StepStatus.OK and step.position_error > 1e-3
        reasons.append(step.reason)
    assert all("from the target and coming nearer" in reason for reason in reasons)


def test_coming_nearer_slowly_is_not_called_hardly():
    """With acceleration limits the tip comes nearer by some percent a sample, and no limit is active."""
    robot = robots.load("planar_3r")
    q = np.array([0.1, 0.5, 0.4])
    tracker = ik.Tracker(robot, "cv", q0=q, acceleration_limits=1.0)
    at, slowly = robot.fk(q).translation, 0
    for k in range(1500):
        t = 1e-3 * k
        step = tracker.update(
            at + 0.15 * min(1.0, 2.0 * t) ** 2 * np.array([np.cos(3.0 * t) - 1.0, np.sin(3.0 * t), 0.0]), 1e-3
        )
        before, after = step._sizes()
        if "hardly" in step.reason:
            assert after > 0.99 * before
        slowly += "coming nearer, but slowly" in step.reason
    assert slowly


@pytest.mark.parametrize(
    ("mode", "method", "acceleration", "size", "most"),
    [
        ("direct", "cv", None, 0.15, 0.01),
        ("leave", "cv", 2.0, 0.15, 0.07),
        ("direct", "ca", 2.0, 0.15, 0.07),
        ("leave", "cv", 2.0, 0.6, 0.6),
        ("direct", "ca", 2.0, 0.6, 0.6),
        ("direct", "aad", None, 0.15, 0.03),
        ("leave", "aad", 2.0, 0.6, 0.6),
        ("direct", "aad", 10.0, 0.6, 0.6),
    ],
)
def test_two_hands_keep_their_distance_where_the_turret_is_too_slow(mode, method, acceleration, size, most):
    """Moved up and down at up to 1.9 m/s, the hands fall behind no more than they must, and what they hold is not let go."""
    robot = ik.Tree.load("brokk_hydrolek")
    left, right = robot.tips
    limits = acceleration and acceleration * robot.velocity_limits
    options = {"relative_to": {right: left}, "on_limit": mode, "acceleration_limits": limits}
    tracker = ik.Tracker(robot, method, q0=robot.home, reconfigure=False, **options)
    at, dt, worst, behind = robot.fk(robot.home), 0.005, 0.0, 0.0
    between, target = at[left].actInv(at[right]), at[left].homogeneous
    for k in range(300):
        target[2, 3] = at[left].translation[2] + size * np.sin(np.pi * k * dt)
        now = robot.fk(tracker.update({left: target, right: between}, dt).q)
        held = now[left].actInv(now[right]).translation
        worst = max(worst, np.linalg.norm(held - between.translation))
        behind = max(behind, np.linalg.norm(now[left].translation - target[:3, 3]))
    assert 0.001 < behind < most and worst < 1e-4


def test_an_arm_that_a_limit_keeps_from_a_lower_level_rests_at_that_limit():
    robot = robots.load("hydrolek_7w")
    turned = robot.fk(robot.home).homogeneous @ ik.pose((0, 0, 0), rpy=(0, 0, 0.3))
    joint = {"wrist_roll": tuple(robot.home[-1] + np.array([-0.05, 0.05]))}
    tracker = ik.Tracker(robot, q0=robot.home, priority="position", limits=joint)
    steps = [tracker.update(turned, 0.02) for _ in range(400)]
    assert steps[-1].position_error < 1e-3 < 0.1 < steps[-1].orientation_error and steps[-1].at_rest
    assert {step.status for step in steps[-50:]} == {StepStatus.AT_LIMIT} and "wrist_roll" in steps[-1].reason


def test_what_comes_second_is_not_slowed_by_what_comes_first():
    robot = robots.load("hydrolek_7w")
    turned = robot.fk(robot.home).homogeneous @ ik.pose((0, 0, 0), rpy=(0, 0, 1.0))
    took = []
    for options in ({}, {"priority": "position"}):
        tracker, k = ik.Tracker(robot, q0=robot.home, **options), 0
        while (step := tracker.update(turned, 0.02)).orientation_error > 2e-3 and k < 200:
            k += 1
            assert step.position_error < 1e-3
        took.append(k)
    assert 20 < took[1] < 1.3 * took[0], "as long as the wrist's speed takes"


@pytest.mark.parametrize("seed", [1, 8])
def test_what_comes_first_is_kept_where_the_second_cannot_be(seed):
    """SO-100 along a line at 25 mm/s with its orientation kept: the orientation pulled the position up to 0.9 mm off."""
    robot, rng = ik.Robot.load("so100"), np.random.default_rng(seed)
    q = robot.home + 0.5 * (robot.random_q(rng) - robot.home)
    target, way = robot.fk(q).homogeneous, rng.normal(size=3)
    tracker = ik.Tracker(robot, q0=q, priority="position")
    steps = []
    for _ in range(300):
        target[:3, 3] += 0.025 * 0.01 * way / np.linalg.norm(way)
        steps.append(tracker.update(target, 0.01))
    good = [step for step in steps[4:] if step.status is StepStatus.OK]  # the target starts at full speed
    assert len(good) > 200 and max(step.orientation_error for step in good) > 0.1
    assert max(step.position_error for step in good) < 1e-4


@pytest.mark.parametrize("seed", [1, 42, 45])
def test_the_second_level_comes_as_near_as_the_first_allows(seed):
    """An error of a lower level counted as small, so that the arm crept, up to 0.018 rad from the least for 10 s."""
    robot, rng = robots.load("inspection_7dof"), np.random.default_rng(seed)
    q, target = robot.random_q(rng), robot.fk(robot.random_q(rng)).homogeneous
    axis = rng.normal(size=3)
    target[:3, :3] = target[:3, :3] @ exp(0.3 * axis[None] / np.linalg.norm(axis))[0]
    tracker = ik.Tracker(robot, q0=q, priority="position")
    for _ in range(500):
        step = tracker.update(target, 0.02)
    least = ik.solve(robot, target, priority="position", q0=step.q, restarts=0)
    assert step.position_error < 1e-5 and least.success
    assert step.orientation_error < least.level_errors[1]["orientation"] + 1e-3
