"""Motions known to be feasible, given to `track` only as poses of the tip."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import ik_toolkit as ik

STEP = 1e-5  # s, of the difference that gives dJ/dt
FINE = {"position_tolerance": 1e-4, "orientation_tolerance": 1e-3}  # m, rad


def of_the_joints(robot, joints, duration):
    """Reference of the tip; joints(t, order) gives joint values (N, n) at t (N,), or their derivatives."""

    def tip(t):
        q, rate = joints(t, 0), joints(t, 1)
        T, J = robot.chain.forward(q, jacobian=True)
        after, before = (robot.chain.forward(q + s * STEP * rate, jacobian=True)[1] for s in (1.0, -1.0))
        bend = np.einsum("kij,kj->ki", (after - before) / (2.0 * STEP), rate)
        return T, np.einsum("kij,kj->ki", J, rate), np.einsum("kij,kj->ki", J, joints(t, 2)) + bend

    return ik.Reference(tip, duration)


@pytest.mark.parametrize("method", ["cv", "aad"])
@pytest.mark.parametrize("speed", [0.1, 0.4, 1.2])
def test_an_elbow_that_swings_through_straight_goes_on(method, speed):
    """At a singular pose two ways fit the target; the one that the joints are moving on needs no jump of their speed."""
    robot = ik.Robot.load("ur5")
    middle = np.array([0.3, -1.4, 0.0, -0.6, 1.2, 0.4])
    rates = speed * np.array([0.3, 0.2, -1.0, 0.4, 0.2, 0.1])

    def joints(t, order):
        swing = np.outer(t - 1.0, rates) if order == 0 else np.tile(rates if order == 1 else 0.0 * rates, (len(t), 1))
        return middle + swing if order == 0 else swing

    start = np.zeros(1)
    run = ik.track(
        robot, of_the_joints(robot, joints, 2.0), method, q0=joints(start, 0)[0], rate0=joints(start, 1)[0], **FINE
    )
    assert run.status.name == "COMPLETED", run.message
    assert np.abs(run.q - joints(run.t, 0)).max() < 0.02  # singular: a motion of this size along the arm is not seen
    assert np.abs(run.q[-1] - joints(run.t[-1:], 0)).max() < 1e-3


@pytest.fixture(scope="module")
def feasible():
    """The benchmark's random joint motions."""
    path = Path(__file__).parents[2] / "scripts" / "benchmarks" / "servo_feasible.py"
    spec = importlib.util.spec_from_file_location("servo_feasible", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("name", "seed", "number"),
    [
        ("ur5", 1, 30),  # through singular poses
        ("ur5", 7, 22),
        ("panda", 3, 39),
        pytest.param("panda", 12, 45, marks=pytest.mark.slow),  # by a singular pose, unless the clock is slower there
        ("inspection_7dof", 3, 30),  # too fast for a step of the second order
        ("inspection_7dof", 1, 32),  # into two limits, unless the joints keep another posture
        pytest.param("inspection_7dof", 6, 50, marks=pytest.mark.slow),
        ("panda", 13, 49),  # elbow to its limit, unless it is led across its straight pose
        ("panda", 16, 13),
        ("panda", 76, 13),  # only where it crosses when it is planned to
    ],
)
def test_motions_that_were_left(feasible, name, seed, number):
    robot, rng = ik.Robot.load(name), np.random.default_rng(seed)
    for _ in range(number + 1):
        reference, q0, rate0 = feasible.motion(robot, rng)
    run = ik.track(robot, reference, q0=q0, rate0=rate0, **FINE)
    assert run.success, run.message


@pytest.mark.slow
@pytest.mark.parametrize("method", ["cv", "aad"])
@pytest.mark.parametrize("seed", [26, 31, 52])  # two motions each that a run without a plan leaves
def test_no_motion_of_a_joint_path_is_left(feasible, seed, method):
    robot, rng = ik.Robot.load("panda"), np.random.default_rng(seed)
    for number in range(60):
        reference, q0, rate0 = feasible.motion(robot, rng)
        run = ik.track(robot, reference, method, q0=q0, rate0=rate0, **FINE)
        assert run.success, f"{number}: {run.message}"
        assert (run.q >= robot.lower).all() and (run.q <= robot.upper).all()


def test_a_run_that_is_taken_again_leaves_the_wishes_it_was_given(feasible):
    """Postures that `track` tries are its own affair: a posture that was asked for is the only one."""
    robot, rng = ik.Robot.load("inspection_7dof"), np.random.default_rng(1)
    for _ in range(33):
        reference, q0, rate0 = feasible.motion(robot, rng)
    middle = 0.5 * (robot.lower + robot.upper)
    kept = ik.track(robot, reference, q0=q0, rate0=rate0, posture=q0, **FINE)
    other = ik.track(robot, reference, q0=q0, rate0=rate0, posture=middle, **FINE)
    assert not kept.success and other.success


@pytest.mark.parametrize("method", ["cv", "ca", "aad"])
@pytest.mark.parametrize("height", [0.0, 0.1])
def test_an_arm_that_is_straight_along_an_axis_bends(method, height):
    """There a row of the Jacobian is 0 to the last bit, like that of the height of a planar arm, and the arm stayed for ever."""
    robot = ik.Robot.load("planar_3r")
    tracker, straight = ik.Tracker(robot, method, q0=np.zeros(3)), robot.fk(np.zeros(3)).translation
    for k in range(300):
        target = straight * (1.0 - 0.15 * min(k / 200, 1.0)) + [0.0, 0.0, height]
        step = tracker.update(target, 0.01)
    left = robot.fk(step.q).translation - target
    assert np.abs(left[:2]).max() < 1e-3 and abs(left[2] + height) < 1e-9
