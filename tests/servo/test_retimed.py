"""Runs that may be slower than their reference: only where they have to be, and no slower than that."""

import numpy as np
import pytest
from references import keeps_limits, line_of
from robots import have_data, urdf

import ik_toolkit as ik

DATA = pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed (extra 'robots')")


@DATA
def test_a_reference_that_can_be_followed_in_its_own_time_is_not_slowed():
    """Joints are at their limits in 9 of 10 steps, but others do their part."""
    robot = ik.Tree.load("pr2")
    reference = {tip: ik.circle(T.homogeneous, 0.1, duration=3.8) for tip, T in robot.fk(robot.home).items()}
    run = ik.track(robot, reference, q0=robot.home)
    assert run.status.name == "COMPLETED" and run.limited.any() and keeps_limits(robot, run.q, run.dt)


def test_joints_beside_the_slow_one_do_its_part():
    """The fastest law of one joint path takes 3.55 times as long as the reference, that of all it can do 2.35 times."""
    robot = ik.Robot.load("hydrolek_7w")
    middle = 0.5 * (robot.lower + robot.upper)
    q0 = robot.home + 0.2 * (middle - robot.home)
    run = ik.track(robot, line_of(robot, q0, (0.15, 0.0, 0.0), 0.2, free=True), q0=q0)
    assert run.status.name == "SLOWED" and keeps_limits(robot, run.q, run.dt)
    assert run.t[-1] < 2.6 * run.end


@DATA
def test_before_a_contact_the_reference_slows_down_and_the_tip_stays_on_it():
    robot = ik.Robot.load("panda")
    T = robot.fk(robot.home).homogeneous
    ball = T[:3, 3] + (-0.1, 0.22, 0.0)  # 1 cm beside the hand
    model = ik.CollisionModel(robot).add_sphere(0.05, ball, "ball")
    reference = ik.circle(T, 0.1, duration=1.0)
    run = ik.track(robot, reference, avoid_collisions=model)
    assert run.status.name == "SLOWED" and run.t[-1] < 1.5 and not any(model.collides(q) for q in run.q)
    assert ik.track(robot, reference, avoid_collisions=model, on_limit="leave").position_error.max() > 5e-3


def test_a_fast_line_in_few_samples_takes_hardly_longer():
    """A clock without corners: steps err where the target begins to brake, and half as fast is not needed for that."""
    robot = ik.Robot.load("planar_2r")
    q0 = np.array([0.3, 0.9])
    run = ik.track(robot, line_of(robot, q0, (-0.9, 0.5, 0.0), 0.3, free=True), q0=q0)
    assert run.status.name == "SLOWED" and run.t[-1] < 0.35 and keeps_limits(robot, run.q, run.dt)


@pytest.mark.parametrize("method", ["ca", "aa", "aad"])
def test_methods_of_accelerations_take_about_as_long_as_cv(method):
    """With aad, rates change by at most 1 / (2 gamma) of the limit, so a motion from rest takes sqrt(1.2) = 1.095 times as long."""
    robot = ik.Robot.load("planar_3r")
    q0, q1 = [-0.594, 0.085, 0.375], [-0.171, 0.262, 0.386]
    line = ik.line(robot.fk(q0).homogeneous, robot.fk(q1).homogeneous, duration=2.0, law="minimum-jerk")
    run, plain = (ik.track(robot, line, name, q0=q0, acceleration_limits=1.0) for name in (method, "cv"))
    assert run.status.name == plain.status.name == "SLOWED"
    assert run.t[-1] < 1.1 * plain.t[-1]
    assert np.abs(np.diff(run.rate, axis=0)).max() <= run.dt * (1.0 + 1e-9)


@pytest.mark.parametrize("law", ["minimum-jerk", "constant"])
def test_a_clock_that_nearly_stands_still_asks_for_no_terabytes(law):
    """Four joints lead the tip to where it can only creep; the time law of this run was 1e8 to 1e13 steps long."""
    first, third = (0.2132237964141146, 1.6648112338845278), (-0.07526373902942951, 1.906070118039701)
    turn, speed = 0.5 * np.pi, '<limit velocity="2" effort="1"/>'
    robot = ik.Robot.load(
        urdf(
            dict(kind="revolute", xyz="-0.2 0 0", rpy=f"{-turn} {2 * turn} 0", axis="0 -1 0", limits=first),
            dict(kind="continuous", mimic=speed, xyz="0 0 -0.2", rpy=f"{turn} {-turn} {-turn}", axis="0 1 0"),
            dict(kind="revolute", xyz="0 -0.2 0", rpy=f"{-turn} {turn} {-turn}", axis="0 -1 0", limits=third),
            dict(kind="continuous", mimic=speed, xyz="0 0 0.3", rpy=f"{turn} 0 {-turn}", axis="1 0 0"),
            dict(kind="fixed", xyz="-0.1574968237176962 0.15020221303086362 -0.1671111511690564", rpy="0.3 0.2 0.1"),
        )
    )
    q0 = np.array([1.57849965, 1.38494693, 0.06289538, -1.02461228])
    reference = line_of(robot, q0, (-0.62852916, 0.01108644, 0.15225849), 0.5, law, free=True)
    assert ik.track(robot, reference, "aad", dt=0.004, q0=q0).status.name == "LOST"


@DATA
def test_of_runs_that_all_leave_the_reference_the_nearest_one_is_kept():
    """In its own time the run ends beside a singular pose 28 cm off, a slower one is never more than 16 cm off."""
    robot = ik.Robot.load("ur5")
    for seed, gain in ((7, 1.25), (26, 0.6), (30, 1.25)):
        rng = np.random.default_rng(seed)
        q0, way = robot.random_q(rng), rng.normal(size=3)
        reference = line_of(robot, q0, 0.4 * robot.reach * way / np.linalg.norm(way), 2.0)
        slow, own = (ik.track(robot, reference, q0=q0, on_limit=mode) for mode in ("slow", "leave"))
        assert slow.status.name in ("LEFT", "LOST")
        assert slow.position_error.max() < gain * own.position_error.max()
