"""Joints that are measured late, with noise: the tracker's filter keeps both out of its feedback."""

import numpy as np
import pytest
import robots
from references import Q0

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.servo.step import StepStatus

H = 1e-3  # s
START = np.array([0.1, 0.5, 0.4])
STARTS = {"planar_3r": START, "panda": np.array(Q0)}
RADIUS = 0.05  # m


def targets(robot, steps, h=H):
    """A circle that is entered slowly, at half a turn a second."""
    T = np.tile(robot.fk(STARTS[robot.name]).homogeneous, (steps, 1, 1))
    t = h * np.arange(1, steps + 1)
    phase, grown = np.pi * t, np.clip(t / 0.5, 0.0, 1.0) ** 2
    T[:, 0, 3] += RADIUS * grown * (np.cos(phase) - 1.0)
    T[:, 1, 3] += RADIUS * grown * np.sin(phase)
    return T[:, :3, 3].copy()


def follow(robot, sigma, true=2, steps=1500, h=H, measured=True, method="cv", **options):
    """Errors of the real joints [m], accelerations [rad/s^2] and statuses after the beginning; true: samples of delay."""
    rng = np.random.default_rng(8)
    start = STARTS[robot.name]
    tracker = ik.Tracker(robot, method, q0=start, **options)
    real, rates, errors, statuses = [start] * (true + 1), [np.zeros(robot.n)], [], set()
    for k, target in enumerate(targets(robot, steps, h)):
        q = real[-1 - true] + sigma * rng.standard_normal(robot.n) if measured else None
        step = tracker.update(target, h, q=q)
        real.append(step.q)
        rates.append(step.rate)
        if k * h > 0.6:
            errors.append(np.linalg.norm(robot.fk(real[-1]).translation - target))
            statuses.add(step.status)
    return np.array(errors), np.diff(rates, axis=0)[int(0.6 / h) :] / h, statuses


@pytest.mark.parametrize("method", ["cv", "ca", "aad"])
def test_noise_and_delay_hardly_change_the_motion(method):
    """1 kHz, noise of 1e-4 rad, two samples of delay: 0.1 mm on an arm of 6 m, little acceleration, and no limit is blamed."""
    robot = robots.load("planar_3r")
    _, quiet, _ = follow(robot, 0.0, measured=False, method=method)
    errors, loud, statuses = follow(robot, 1e-4, method=method)
    assert errors.max() < 1e-4
    # The single largest acceleration is chance: moving the start by 1e-13 rad moves it by a quarter without any noise.
    assert loud.std() < 1.05 * quiet.std() and np.quantile(np.abs(loud), 0.99) < 1.2 * np.quantile(np.abs(quiet), 0.99)
    assert statuses == {StepStatus.OK}


def test_noise_that_is_told_is_taken_more_slowly():
    robot = robots.load("planar_3r")
    _, untold, _ = follow(robot, 1e-3, steps=900)
    errors, told, _ = follow(robot, 1e-3, steps=900, noise=1e-3)
    assert errors.max() < 1e-3 and told.std() < 0.8 * untold.std()


@pytest.mark.parametrize("name", STARTS)
@pytest.mark.parametrize("method", ["cv", "ca"])
@pytest.mark.parametrize(("assumed", "true"), [(0, 3), (2, 0), (2, 2), (2, 4), (2, 6), (2, 8), (5, 2)])
def test_a_wrong_delay_does_not_make_it_swing(assumed, true, method, name):
    """The tip leads or lags by what the delay is wrong, without growing."""
    robot = robots.load(name)
    errors, _, _ = follow(robot, 0.0, true=true, steps=400, h=0.01, delay=assumed, noise=0.0, method=method)
    off = RADIUS * np.pi * 0.01 * abs(assumed - true)  # m, what the tip does in that time
    assert errors.max() <= 1.6 * off + 1e-4
    assert errors[-100:].max() <= 1.1 * errors[:-100].max()


def test_mistakes_are_typed():
    robot = robots.load("planar_2r")
    for wrong in (-1, 1.5, "two", None, 1e300):
        with pytest.raises(InvalidOption, match="delay"):
            ik.Tracker(robot, delay=wrong)
    for wrong in (-1e-4, np.nan, np.inf, "loud", [], [1e-4, 1e-4]):
        with pytest.raises(InvalidOption, match="noise"):
            ik.Tracker(robot, noise=wrong)


def test_measurements_in_some_samples_only():
    """In the samples between, the joints are where the filter has them; commands without a measurement count as well."""
    robot, rng = robots.load("planar_3r"), np.random.default_rng(9)
    for every in (3, 20):
        tracker, real, rates, errors = ik.Tracker(robot, q0=START), [START] * 3, [], []
        for k, target in enumerate(targets(robot, 1500)):
            q = None if k % every else real[-3] + 1e-4 * rng.standard_normal(robot.n)
            step = tracker.update(target, H, q=q)
            real.append(step.q)
            if k * H > 0.6:
                errors.append(np.linalg.norm(robot.fk(step.q).translation - target))
                rates.append(step.rate)
                assert step.status is StepStatus.OK, step
        assert max(errors) < 1e-4 * robot.reach
        assert np.abs(np.diff(rates, axis=0)).max() / H < 3.0


@pytest.mark.parametrize("true", [0, 2, 4])
@pytest.mark.parametrize("length", [1, 3])
def test_measurements_far_off_are_one_jump_at_most(true, length):
    """The measurements after a jump are of before it: compared with what was commanded since, each would cause another."""
    robot = robots.load("planar_3r")
    tracker, real, jumps, step = ik.Tracker(robot, q0=START), [START] * (true + 1), 0, None
    path = targets(robot, 1500)
    for k, target in enumerate(path):
        step = tracker.update(target, H, q=real[-1 - true] + 0.3 * (200 <= k < 200 + length))
        real.append(step.q)
        jumps += step.status is StepStatus.JUMPED
    assert jumps == (length > 1)
    assert np.linalg.norm(robot.fk(step.q).translation - path[-1]) < 1e-3


@pytest.mark.parametrize(
    ("wrong", "length"),
    [("zeros", 1), *[(wrong, length) for wrong in ("spike", "degrees", "huge", "nan") for length in (1, 20)]],
)
def test_wrong_measurements_move_nothing_beyond_a_limit(wrong, length):
    """One sample is left out. Several that do not agree, are not finite or are outside the limits make the arm hold."""
    robot = ik.Robot.load("ur5")
    q0, rng = np.array([0.3, -1.2, 1.6, -1.9, -1.57, 0.2]), np.random.default_rng(0)
    goal, tracker, h = robot.fk(q0), ik.Tracker(robot, q0=q0), 0.001
    for k in range(60):
        before, q = tracker.q, q0 + 1e-5 * rng.standard_normal(6)
        bad = 20 <= k < 20 + length
        if bad:
            q = {
                "spike": q + rng.uniform(0.5, 1.0, 6) * (-1.0) ** k, "zeros": 0.0 * q,
                "degrees": np.degrees(q), "huge": 1e30 * q, "nan": np.nan * q,
            }[wrong]  # fmt: skip
        step = tracker.update(goal, h, q=q)
        assert (np.abs(step.q - before) <= robot.velocity_limits * h * (1.0 + 1e-9)).all() and not robot.outside(step.q)
        if bad:
            assert step.status in (StepStatus.FOLLOWING_ERROR, StepStatus.HELD)
            assert k == 20 or (step.status is StepStatus.HELD and "measured joints" in step.reason)
            assert ("the measured joints are not finite" in step.reason) == (wrong == "nan")
    assert np.abs(step.q - q0).max() < 1e-3 and step.status is StepStatus.OK


def test_a_measurement_that_is_left_out_is_told_on_a_joint_move_too():
    robot = robots.load("planar_3r")
    tracker = ik.Tracker(robot, q0=STARTS["planar_3r"], delay=0)
    goal = robot.fk(-STARTS["planar_3r"]).translation
    moving = [tracker.update(goal, H, q=tracker.q) for _ in range(5)][-1]
    assert "the target jumped" in moving.reason and "measured" not in moving.reason
    step = tracker.update(goal, H, q=np.full(3, np.nan))
    assert step.reason.startswith("the measured joints are not finite; the target jumped"), step.reason
