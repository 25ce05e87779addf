"""Joints do not swing where an obstacle holds them back."""

import numpy as np
import pinocchio as pin
import pytest
from robots import have_data, load

import ik_toolkit as ik


def turns_back(Q, dt, limits):
    """How often a joint of Q (N, n) turns back, both ways faster than 5 % of its limit."""
    rate = np.diff(Q, axis=0) / dt
    rate = np.where(np.abs(rate) > 0.05 * limits, np.sign(rate), 0.0)
    moves = [rate[rate[:, joint] != 0.0, joint] for joint in range(rate.shape[1])]
    return sum(int((np.diff(signs) != 0.0).sum()) for signs in moves)


@pytest.mark.skipif(not have_data(), reason="needs example-robot-data")
def test_joints_do_not_swing_before_a_box():
    """The nearest points of an edge along a face leap from end to end: joints turned back in every sample."""
    robot, rng = load("panda"), np.random.default_rng(6)
    free = False
    while not free:
        q0, q1 = robot.random_q(rng), robot.random_q(rng)
        begin, end = (pin.SE3(robot.fk(q).homogeneous) for q in (q0, q1))
        size = tuple(robot.reach * rng.uniform(0.1, 0.6, 3))
        model = ik.CollisionModel(robot).add_box(size, end.homogeneous, "box")
        free = not model.collides(q0)
    tracker, Q = ik.Tracker(robot, "cv", q0=q0, avoid_collisions=model), [q0]
    for k in range(600):
        target = pin.SE3.Interpolate(begin, end, min(k / 200, 1.0))
        target.translation += [0.02 * np.sin(0.01 * k), 0.0, 0.0]
        Q.append(tracker.update(target.translation, 0.01).q)
    assert turns_back(np.array(Q), 0.01, robot.velocity_limits) < 80
