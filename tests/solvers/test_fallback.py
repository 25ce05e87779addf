"""Closed forms without a solution: no feasible target is called impossible, and the best configuration is returned."""

import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.text import angle, length


@pytest.fixture(scope="module")
def arm():
    return ik.Robot.load("inspection_7dof")


def legal(robot, count, seed, **values):
    """Legal configurations, some joints at given values."""
    rng = np.random.default_rng(seed)
    Q = rng.uniform(robot.lower, robot.upper, (count, robot.n))
    for name, value in values.items():
        Q[:, robot.joint_names.index(name)] = value
    return Q


def size(robot, result):
    """Error of a result as the search measures it."""
    turn = 2 * np.sin(0.5 * (result.orientation_error or 0.0))
    return (result.position_error / robot.chain.scale) ** 2 + turn**2


@pytest.mark.parametrize("lift", [None, 0.31])
@pytest.mark.parametrize("values", [{"arm_pitch": 0.0}, {"elbow_pitch": 0.0}, {"arm_pitch": 0.0, "elbow_pitch": 0.0}])
def test_no_target_of_a_singular_legal_configuration_is_lost(arm, lift, values):
    robot = arm if lift is None else arm.locked({"lift": lift})
    Q = legal(robot, 500, 1, **values)
    T = robot.chain.forward(Q)[0]
    batch = ik.solve_batch(robot, T, check=1.0)
    assert batch.success.all()
    assert (batch.q >= robot.lower).all() and (batch.q <= robot.upper).all()
    assert all(ik.solve(robot, pose).success for pose in T[:40])


def test_no_target_of_a_limit_corner_is_lost(arm):
    for robot in (arm, arm.locked({"lift": 0.31})):
        rng = np.random.default_rng(2)
        Q = legal(robot, 3000, 3)
        rank = np.argsort(rng.random(Q.shape), axis=1)
        ends = np.where(rng.random(Q.shape) < 0.5, robot.lower, robot.upper)
        Q = np.where(rank < rng.integers(2, 6, (len(Q), 1)), ends, Q)
        assert ik.solve_batch(robot, robot.chain.forward(Q)[0]).success.all()


def test_a_failed_closed_form_returns_the_best_configuration_and_speaks_of_it(arm):
    rng = np.random.default_rng(4)
    seen = set()
    for robot in (arm, arm.locked({"lift": 0.22})):
        for _ in range(60):
            q = robot.random_q(rng)
            T = robot.fk(q).homogeneous
            T[:3, 3] *= rng.uniform(0.2, 1.6, 3)
            result, search = ik.solve(robot, T), ik.solve(robot, T, "lm")
            if result.success:
                continue
            assert not search.success
            seen.add(result.status)
            assert size(robot, result) <= size(robot, search) + 1e-10  # where a descent to the same place ends
            position, orientation = robot.errors(result.q, T)
            assert abs(position - result.position_error) < 1e-9 and abs(orientation - result.orientation_error) < 1e-9
            assert f"{length(position)}, {angle(orientation)}" in result.message
    assert {ik.Status.UNREACHABLE, ik.Status.LIMIT_BLOCKED} <= seen


def test_the_best_configuration_of_a_planar_arm():
    robot = ik.Robot.load("planar_2r")
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(*(np.linspace(a, b, 400) for a, b in zip(robot.lower, robot.upper, strict=True))), -1)
    tips = robot.chain.forward(grid.reshape(-1, 2))[0][:, :3, 3]
    failed = 0
    for _ in range(50):
        target = np.array([*rng.uniform(-1.2, 1.2, 2) * robot.reach, 0.0])
        result = ik.solve(robot, target)
        failed += not result.success
        nearest = np.linalg.norm(tips - target, axis=1).min()
        assert result.position_error <= nearest + 1e-9
    assert failed > 12


def test_a_loose_tolerance_is_used_before_anything_is_called_impossible():
    robot, rng = ik.Robot.load("planar_2r"), np.random.default_rng(6)
    for tolerance in (1e-3, 1e-2, 5e-2):
        Q = legal(robot, 300, 7)
        ends = np.where(rng.random(Q.shape) < 0.5, robot.lower, robot.upper)
        T = robot.chain.forward(np.where(rng.random(Q.shape) < 0.5, ends, Q))[0][:, :3, 3]
        move = rng.normal(size=T.shape)
        T += 0.9 * tolerance * move / np.linalg.norm(move, axis=1, keepdims=True)
        T[:, 2] = 0.0
        assert ik.solve_batch(robot, T, tolerance=tolerance).success.all()


def test_history_counts_and_batches_hold_the_search_too(arm):
    robot = arm.locked({"lift": 0.25})
    T = robot.fk(robot.home).homogeneous
    T[2, 3] += 0.6
    result = ik.solve(robot, T, history=True)
    assert not result.success and len(result.history["q"]) > 1
    batch = ik.solve_batch(robot, np.array([T, robot.fk(robot.home).homogeneous]), threads=1)
    assert batch.q[0].tobytes() == result.q.tobytes() and batch.success.tolist() == [False, True]
    assert batch[0].message.split(";")[0] == result.message.split(";")[0]
