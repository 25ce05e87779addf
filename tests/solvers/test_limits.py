"""Solvers at a joint limit: stop, hold, or continue from the other end of the range."""

import math

import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.solvers.rules.jacobian import DLS
from ik_toolkit.solvers.rules.state_space import StateSpace


@pytest.fixture(scope="module")
def arm():
    """The HydroLek-7W, whose last joint turns by +-260 degrees."""
    return ik.Robot.load("hydrolek_7w")


def turning(n):
    """A rule that answers an error along x by turning the last joint alone."""
    D = np.zeros((n, 3))
    D[-1, 0] = 1.0
    return StateSpace(D=D)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_published_method_stops_at_the_limit_of_a_joint_that_can_turn_fully(arm, side):
    """Algorithm II says: if theta is beyond its limit, it is set to the limit."""
    q0 = np.clip(np.zeros(arm.n), arm.lower, arm.upper)
    target = arm.fk(q0).translation + np.array([0.3 * side, 0.0, 0.0])
    ended = ik.solve(arm, target, turning(arm.n), q0=q0, max_iterations=40, history=True)
    path = ended.history["q"][:, -1]
    assert (np.diff(path) * side >= 0.0).all()
    assert path[-1] == pytest.approx(side * math.radians(260.0), abs=1e-12)
    wrapped = ik.solve(arm, target, turning(arm.n), q0=q0, max_iterations=40, history=True, wrap=True)
    assert (np.diff(wrapped.history["q"][:, -1]) * side < -math.pi).any()


def test_who_wraps_by_itself(arm):
    """From 255 degrees to -255 (-255 + 360 = 105 is not asked for): 'lm' may go round, a published method comes back."""
    q0 = 0.5 * (arm.lower + arm.upper)
    q0[-1] = math.radians(255.0)
    goal = q0.copy()
    goal[-1] = math.radians(275.0 - 360.0)
    target = arm.fk(goal)
    for solver in ("dls", "pinv", "transpose", "ccd", "pid"):
        path = ik.solve(arm, target, solver, q0=q0, history=True, max_iterations=20).history["q"][:, -1]
        assert np.abs(np.diff(path)).max() < math.pi, solver
    assert ik.solve(arm, target, "lm", q0=q0, restarts=0).q[-1] == pytest.approx(goal[-1], abs=1e-5)
    stopped = ik.solve(arm, target, "lm", q0=q0, restarts=0, wrap=False, history=True)
    assert np.abs(np.diff(stopped.history["q"][:, -1])).max() < math.pi


def test_the_turn_of_a_batch_is_that_of_a_single_solve(arm):
    """`wrap` counts in the lanes of a batch, too."""
    q0 = 0.5 * (arm.lower + arm.upper)
    q0[-1] = math.radians(255.0)
    T = np.array(
        [arm.fk(np.append(q0[:5], math.radians(a - 360.0))).homogeneous for a in np.linspace(262.0, 300.0, 20)]
    )
    free = ik.solve_batch(arm, T, q0=q0, restarts=0)
    bound = ik.solve_batch(arm, T, q0=q0, restarts=0, wrap=False)
    assert free.success.all()
    assert (free.q[:, -1] < 0.0).all()
    for k, target in enumerate(T):
        one = ik.solve(arm, target, "lm", q0=q0, restarts=0, wrap=False)
        assert bound.success[k] == one.success
        if one.success:  # the other turn of joint 6 is out of its range, so another posture was found
            assert abs(one.q[-1] - bound.q[k, -1]) < math.pi
    # From 255 deg the way to -98 .. -60 deg is barred by the limit at 260, unless another posture serves.
    assert np.abs(bound.q[:, -1] - free.q[:, -1]).max() > 0.1


@pytest.mark.parametrize("value", [1, "yes", 0.0])
def test_wrap_is_true_false_or_left_out(arm, value):
    """Anything else would be taken for yes or no by accident."""
    with pytest.raises(ik.errors.InvalidOption, match="wrap"):
        ik.Solver(arm, "lm", wrap=value)


def test_damped_least_squares_as_published_cuts_the_step_off(arm):
    """`hold=False` is J'(JJ' + lambda^2 I)^-1 e and a clip, step by step; with held joints it needs fewer steps."""
    damping = 0.1  # m
    rule = DLS(damping=damping / arm.chain.scale, hold=False)
    q0 = 0.5 * (arm.lower + arm.upper)
    goals = [arm.fk(arm.random_q(np.random.default_rng(k))).translation for k in range(20)]
    clipped = 0
    for goal in goals:
        run = ik.solve(arm, goal, rule, q0=q0, tolerance=1e-3, max_iterations=30, history=True)
        q = q0.copy()
        for found in run.history["q"]:
            assert found == pytest.approx(q, abs=1e-9)
            J, e = arm.jacobian(q)[:3], goal - arm.fk(q).translation
            step = q + J.T @ np.linalg.solve(J @ J.T + damping**2 * np.eye(3), e)
            q = np.clip(step, arm.lower, arm.upper)
            clipped += (q != step).any()
    assert clipped > 20
    held = ik.solve_batch(arm, np.array(goals), rule._replace(hold=True), q0=q0, tolerance=1e-3)
    cut = ik.solve_batch(arm, np.array(goals), rule, q0=q0, tolerance=1e-3)
    assert held.iterations.mean() < cut.iterations.mean()


def test_a_start_that_is_clamped_is_said_of_one_pose_and_of_many(arm):
    solver = ik.Solver(arm)
    poses = np.array([arm.fk(arm.random_q(np.random.default_rng(k))).homogeneous for k in range(4)])
    poses[3, :3, 3] += 10.0  # out of reach
    inside, outside = arm.home.copy(), arm.home.copy()
    outside[0] = arm.upper[0] + 0.3
    for q0, clamped in ((None, False), (inside, False), (outside, True)):
        many = solver.all(poses, q0)
        for k, pose in enumerate(poses):
            assert many[k].message == solver.all(pose, q0).message
            assert many[k].message.count("was clamped") == clamped
