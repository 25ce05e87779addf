"""A hand controller moves a target: clutch, scale, dead band, bounded speed."""

import numpy as np
import pinocchio as pin
import pytest

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption, InvalidTarget

START = pin.SE3(pin.exp3(np.array([0.1, 0.2, 0.3])), np.array([0.4, 0.1, 0.3]))


def hand(xyz, turn=(0.0, 0.0, 0.0)):
    """A pose of the controller."""
    return pin.SE3(pin.exp3(np.array(turn, dtype=float)), np.array(xyz, dtype=float)).homogeneous


def test_clutch_rebases_without_a_jump():
    hands = ik.Teleop(START, speed=1e6, turn=1e6)
    assert hands.update(hand((5, 5, 5)), False, 0.01) == pytest.approx(START.homogeneous)
    assert hands.update(hand((5, 5, 5)), True, 0.01) == pytest.approx(START.homogeneous)
    moved = hands.update(hand((5.1, 5, 5), (0, 0, 0.2)), True, 0.01)
    assert moved[:3, 3] == pytest.approx([0.5, 0.1, 0.3])
    assert moved[:3, :3] == pytest.approx(pin.exp3(np.array([0, 0, 0.2])) @ START.rotation)
    assert hands.update(hand((-3, 2, 1), (1, 1, 1)), False, 0.01) == pytest.approx(moved)
    assert hands.update(hand((-3, 2, 1), (1, 1, 1)), True, 0.01) == pytest.approx(moved)
    again = hands.update(hand((-3, 2.2, 1), (1, 1, 1)), True, 0.01)
    assert again[:3, 3] == pytest.approx([0.5, 0.3, 0.3]) and again[:3, :3] == pytest.approx(moved[:3, :3])


def test_scale_frame_and_dead_band():
    R = pin.exp3(np.array([0, 0, np.pi / 2]))  # the controller's x is the base's y
    hands = ik.Teleop(
        START, scale=0.5, rotation_scale=0.0, R_base_controller=R, dead_band=(0.02, 0.1), speed=1e6, turn=1e6
    )
    hands.update(hand((0, 0, 0)), True, 0.01)
    assert hands.update(hand((0.02, 0, 0)), True, 0.01) == pytest.approx(START.homogeneous)
    moved = hands.update(hand((0.12, 0, 0), (0, 0, 1.0)), True, 0.01)
    assert moved[:3, 3] == pytest.approx([0.4, 0.15, 0.3]) and moved[:3, :3] == pytest.approx(START.rotation)


def test_speed_is_bounded_and_the_target_arrives():
    hands, dt = ik.Teleop(START, speed=0.2, turn=0.5), 0.01
    hands.update(hand((0, 0, 0)), True, dt)
    last = START.homogeneous
    for _ in range(200):
        now = hands.update(hand((0.3, 0, 0), (0, 0.4, 0)), True, dt)
        assert np.linalg.norm(now[:3, 3] - last[:3, 3]) <= 0.2 * dt + 1e-12
        assert np.linalg.norm(pin.log3(now[:3, :3] @ last[:3, :3].T)) <= 0.5 * dt + 1e-9
        last = now
    assert last[:3, 3] == pytest.approx([0.7, 0.1, 0.3], abs=1e-9)
    assert last[:3, :3] == pytest.approx(pin.exp3(np.array([0, 0.4, 0])) @ START.rotation, abs=1e-9)


def test_a_scaled_turn_goes_past_half_a_turn():
    hands = ik.Teleop(START, rotation_scale=0.5, speed=1e6, turn=1e6)
    for angle in np.arange(0.0, 8.05, 0.1):
        now = hands.update(hand((0, 0, 0), (0, 0, angle)), True, 0.01)
    assert now[:3, :3] == pytest.approx(pin.exp3(np.array([0, 0, 4.0])) @ START.rotation, abs=1e-9)
    for angle in np.arange(8.0, 0.95, -0.1):
        now = hands.update(hand((0, 0, 0), (0, 0, angle)), True, 0.01)
    assert now[:3, :3] == pytest.approx(pin.exp3(np.array([0, 0, 0.5])) @ START.rotation, abs=1e-9)


def test_a_released_clutch_lets_go_whatever_the_device_says():
    hands = ik.Teleop(START)
    hands.update(hand((0, 0, 0)), True, 0.01)
    with pytest.raises(InvalidTarget):
        hands.update(2 * np.eye(4), False, 0.01)
    for _ in range(3):
        assert hands.update(hand((0.5, 0, 0)), True, 0.01) == pytest.approx(START.homogeneous)
    hands.rebase(START)
    for x in (0.5, 0.6, 0.7):  # the clutch is still held, so it has to be released first
        assert hands.update(hand((x, 0, 0)), True, 0.01) == pytest.approx(START.homogeneous)
    hands.update(hand((0.7, 0, 0)), False, 0.01)
    hands.update(hand((0.7, 0, 0)), True, 0.01)
    assert hands.update(hand((0.8, 0, 0)), True, 0.01)[0, 3] > START.translation[0]


def test_a_device_that_loses_its_tracking_moves_nothing():
    hands, lost = ik.Teleop(START, speed=1e6), np.full((4, 4), np.nan)
    hands.update(hand((0, 0, 0)), True, 0.01)
    moved = hands.update(hand((0.1, 0, 0)), True, 0.01)
    assert hands.update(lost, True, 0.01) == pytest.approx(moved) and not hands.engaged
    # held all the while, seen again elsewhere
    assert hands.update(hand((0.6, 0, 0)), True, 0.01) == pytest.approx(moved)
    assert hands.update(hand((0.7, 0, 0)), True, 0.01)[0, 3] == pytest.approx(moved[0, 3] + 0.1)
    hands.rebase(START)
    hands.update(lost, True, 0.01)
    for x in (0.5, 0.6):  # a lost device is no released clutch
        assert hands.update(hand((x, 0, 0)), True, 0.01) == pytest.approx(START.homogeneous)


def test_what_is_returned_is_not_the_state_and_bad_poses_change_nothing():
    hands = ik.Teleop(START)
    hands.update(hand((0, 0, 0)), True, 0.01)[:] = 7.0
    assert hands.T_base_tip == pytest.approx(START.homogeneous)
    with pytest.raises(InvalidTarget):
        hands.update(2 * np.eye(4), True, 0.01)
    assert hands.update(hand((0, 0, 0)), True, 0.01) == pytest.approx(START.homogeneous)
    for bad in (
        {"speed": 0.0},
        {"scale": np.nan},
        {"dead_band": (-1, 0)},
        {"dead_band": 0.1},
        {"R_base_controller": "a"},
        {"R_base_controller": 2 * np.eye(3)},
    ):
        with pytest.raises(InvalidOption):
            ik.Teleop(START, **bad)
    with pytest.raises(InvalidOption):
        hands.update(hand((0, 0, 0)), True, 0.0)


def test_with_a_tracker_the_arm_follows_the_hand():
    robot = ik.Robot.load("hydrolek_7w")
    tracker, hands = ik.Tracker(robot, q0=robot.home), ik.Teleop(robot.fk(robot.home), speed=0.1)
    for k in range(300):
        target = hands.update(hand((0.0002 * k, 0.0, 0.0)), True, 0.004)
        step = tracker.update(target, 0.004)
    assert step.position_error < 1e-3
    assert robot.fk(step.q).translation[0] - robot.fk(robot.home).translation[0] == pytest.approx(0.0598, abs=2e-3)
