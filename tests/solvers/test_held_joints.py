"""Joints of weight 0 in a bound solver: each call holds them where its own start has them, whatever was asked before."""

import numpy as np
import robots

import ik_toolkit as ik

WEIGHTS = (1, 0, 1, 1, 1, 1, 0)
HELD = [1, 6]


def test_held_joints_stand_where_this_call_has_them_in_every_attempt():
    robot, rng = robots.load("inspection_7dof"), np.random.default_rng(5)
    solver = ik.Solver(robot, "lm", joint_weights=WEIGHTS, restarts=30)
    again = 0
    for _ in range(12):
        q, q0 = robot.random_q(rng), robot.random_q(rng)
        q[HELD] = q0[HELD]
        result = solver(robot.fk(q), q0=q0)
        assert np.allclose(result.q[HELD], q0[HELD], rtol=0, atol=1e-12)
        again += result.attempt > 0
    assert again > 0  # the first attempt starts at q0 anyway; the others start from a table and at random
    home = solver(robot.fk(q))
    assert np.allclose(home.q[HELD], robot.home[HELD], rtol=0, atol=1e-12)


def test_a_start_given_again_finds_the_same():
    """What is kept of the last start must not depend on the one in between."""
    robot, rng = robots.load("inspection_7dof"), np.random.default_rng(6)
    solver = ik.Solver(robot, "lm", joint_weights=WEIGHTS, restarts=30)
    Q, Q0 = (np.array([robot.random_q(rng) for _ in range(6)]) for _ in range(2))
    Q[:, HELD] = Q0[:, HELD]
    points = [robot.fk(q) for q in Q]
    first = [solver(point, q0=q0).q for point, q0 in zip(points, Q0, strict=True)]
    back = [solver(point, q0=q0).q for point, q0 in zip(points[::-1], Q0[::-1], strict=True)][::-1]
    assert np.array_equal(first, back)
