"""Limits on position, speed and acceleration hold at every sample."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from references import MIMIC, Q0, panda_reference

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption
from ik_toolkit.kernel import motion
from ik_toolkit.robot.robot import Robot
from ik_toolkit.tracking.track import track


@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    distance=some.floats(1e-9, 10.0),
    v=some.floats(-5.0, 5.0),
    gamma=some.sampled_from([0.5, 0.6, 1.0]),
    h=some.floats(1e-4, 0.1),
    a=some.floats(0.01, 500.0),
)
def test_fastest_rate_can_brake_in_time_and_is_the_fastest(distance, v, gamma, h, a):
    rate = motion.fastest(distance, v, gamma, h, a)

    def furthest(x):
        place, now = h * ((1 - gamma) * v + gamma * x), x
        while now > 0.0:
            after = max(now - a * h, 0.0)
            place, now = place + h * ((1 - gamma) * now + gamma * after), after
        return place

    if rate / (a * h) < 5000:
        assert furthest(rate) <= distance + 1e-9 * max(1.0, abs(v))
        assert furthest(rate + 1e-4 * (abs(rate) + a * h)) > distance


@settings(max_examples=80, deadline=None, derandomize=True)
@given(
    name=some.sampled_from(["panda", "planar_2r", "hydrolek_7w", "inspection_7dof", "mimic"]),
    method=some.sampled_from(["cv", "av", "ca", "aa", "aad", "dls"]),
    dt=some.sampled_from([0.001, 0.01, 0.04]),
    acceleration=some.floats(1.0, 40.0),
    pose=some.booleans(),
    seed=some.integers(0, 10_000),
)
def test_limits_hold_at_every_sample(name, method, dt, acceleration, pose, seed):
    """Paths anywhere, mostly out of reach or through singularities: position, speed and acceleration stay inside."""
    robot = LIMITED.setdefault(name, Robot.load(MIMIC if name == "mimic" else name))
    rng = np.random.default_rng(seed)
    point = rng.uniform(-1.2, 1.2, 3) * robot.reach
    start = pin.SE3(pin.exp3(rng.normal(size=3)), point).homogeneous if pose else point
    ref = ik.circle(
        start, rng.uniform(0.05, 1.0) * robot.reach, normal=rng.normal(size=3), turns=rng.uniform(0.5, 4), duration=2.0
    )
    run = track(robot, ref, method, dt=dt, q0=robot.random_q(rng), acceleration_limits=acceleration)
    speed = np.diff(run.q, axis=0) / dt
    assert np.isfinite(run.q).all()
    assert (run.q >= robot.lower).all() and (run.q <= robot.upper).all()
    top = np.where(robot.velocity_limits > 0, robot.velocity_limits, np.inf)
    assert (np.abs(speed) <= top * (1 + 1e-9)).all()
    change = np.diff(np.vstack([np.zeros(robot.n), speed]), axis=0) / dt  # from rest
    assert np.abs(change).max() <= acceleration * (1 + 1e-6)
    assert run.status.name in ("COMPLETED", "LOST")


LIMITED: dict = {}


def test_a_large_error_is_closed_without_swinging(panda):
    """164 mm off, at 1 kHz, with acceleration limits: the one-step methods would swing for ever if only clipped."""
    start = Q0 + 3 * np.array([0.05, -0.05, 0.05, 0.05, -0.05, 0.05, 0.05])
    a = [15, 7.5, 10, 12.5, 15, 20, 20]
    for method in ("cv", "av", "ca", "aad"):
        run = track(panda, panda_reference(panda, True, 3.0), method, dt=0.001, q0=start, acceleration_limits=a)
        assert run.position_error[0] > 0.16
        assert run.position_error[600:].max() < 1e-6


def test_limit_options_are_checked(panda):
    ref = panda_reference(panda, True, 1.0)
    with pytest.raises(InvalidOption, match="limits=True"):
        track(panda, ref, limits=False, acceleration_limits=1.0)
    with pytest.raises(InvalidOption, match="7 numbers"):
        track(panda, ref, acceleration_limits=[1.0, 2.0])
    with pytest.raises(InvalidOption, match="positive"):
        track(panda, ref, acceleration_limits=-1.0)
    with pytest.raises(InvalidConfiguration, match="panda_joint4"):
        track(panda, ref, q0=[0, 0, 0, 3.0, 0, 1, 0])
