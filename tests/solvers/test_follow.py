"""Loops: `follow` keeps a result near its start, and a result from another attempt says so."""

import json

import numpy as np
import pinocchio as pin
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.cli import main

BOUND = 0.5


def turned(T, angle, axis=(0.0, 0.0, 1.0)):
    """Pose whose tip is turned by an angle [rad] about one of its own axes."""
    return (pin.SE3(T) * pin.SE3(pin.exp3(angle * np.array(axis)), np.zeros(3))).homogeneous


def size_of_moves(robot, q, q0):
    """Moves (n,) as `follow` measures them: rad, slides over the reach."""
    return np.abs(q - q0) / np.where(robot.slides, robot.reach, 1.0)


def test_a_turning_tool_never_makes_a_joint_jump():
    robot = robots.load("panda") if robots.have_data() else robots.load("hydrolek_7w")
    plain, following = ik.Solver(robot, "lm"), ik.Solver(robot, "lm", follow=True)
    jumps = 0
    for seed in range(4):
        q = robot.random_q(np.random.default_rng(seed))
        T = robot.fk(q).homogeneous
        last, there = q, True
        for k in range(1, 1500):
            target = turned(T, 1e-3 * k)
            result = plain(target, q0=last)
            jumps += result.success and np.abs(result.q - last).max() > BOUND
            if result.attempt:
                assert "follow" in result.notice
            if result.success:
                last = result.q
            if there:
                result = following(target, q0=q)
                assert size_of_moves(robot, result.q, q).max() <= BOUND
                assert result.attempt == 0 and not result.notice
                there = result.success
                q = result.q if there else q
    assert jumps  # otherwise the loop above shows nothing


@pytest.mark.parametrize("solver", ["lm", "dls", "pinv", "transpose", "ccd", "pid", "state-space"])
@pytest.mark.parametrize("name", ["hydrolek_7w", "slides_mix", "continuous_mix"])
def test_no_joint_leaves_the_bound(name, solver):
    robot = robots.load(name)
    Q, T = robots.sample(robot, 40, seed=3)
    bound = 0.07
    for q0, target in zip(Q, np.roll(T, 1, axis=0), strict=True):
        result = ik.solve(robot, target[:3, 3], solver, q0=q0, follow=bound, max_iterations=40)
        assert size_of_moves(robot, result.q, q0).max() <= bound
        assert not robot.outside(result.q) and result.restarts == 0
        assert result.position_error == pytest.approx(
            np.linalg.norm(robot.fk(result.q).translation - target[:3, 3]), abs=1e-9
        )


def test_too_far_names_the_joint_and_keeps_the_best_inside():
    robot = robots.load("planar_2r")
    q0 = np.array([0.3, 0.8])
    target = robot.fk([0.3 + 0.4, 0.8]).translation
    near = ik.solve(robot, target, q0=q0, follow=0.5)
    assert near.status == ik.Status.CONVERGED and np.allclose(near.q, [0.7, 0.8], atol=1e-5)
    far = ik.solve(robot, target, q0=q0, follow=0.1)
    assert far.status == ik.Status.TOO_FAR and not far.success
    assert robot.joint_names[0] in far.message and "0.1 rad" in far.message and "follow" in far.message
    assert far.q[0] == pytest.approx(0.4, abs=1e-12) and np.abs(far.q - q0).max() <= 0.1
    grid = np.stack(np.meshgrid(*(np.linspace(x - 0.1, x + 0.1, 41) for x in q0)), -1).reshape(-1, 2)
    best = min(np.linalg.norm(robot.fk(q).translation - target) for q in grid)
    assert far.position_error <= best + 1e-9


def test_other_failures_keep_their_status():
    robot = robots.load("planar_2r")
    assert ik.solve(robot, (9.0, 0.0, 0.0), q0=robot.home, follow=True).status == ik.Status.UNREACHABLE
    parts = [dict(kind="revolute", limits=limits, xyz="0.5 0 0") for limits in ((-0.5, 0.5), (-0.5, 0.5), (-9.0, 9.0))]
    text = robots.urdf(*parts)
    robot, wide = ik.Robot.load(text), ik.Robot.load(text.replace('0.5" effort', '2.0" effort'))
    beyond = wide.fk([0.7, 0.7, 0.0]).translation
    blocked = ik.solve(robot, beyond, "lm", q0=[0.5, 0.5, 0.0], follow=True)
    assert blocked.status == ik.Status.LIMIT_BLOCKED


def test_endless_joints_follow_beyond_many_turns():
    robot = robots.load("continuous_mix")
    q0 = robot.random_q(np.random.default_rng(2))
    endless = np.isinf(robot.lower)
    q0[endless] += 2 * np.pi * 40
    target = robot.fk(q0 + 0.01 * endless).homogeneous
    result = ik.solve(robot, target, q0=q0, follow=0.2)
    assert result.success and np.abs(result.q - q0).max() < 0.05


def test_a_batch_follows_row_by_row():
    robot = robots.load("hydrolek_7w")
    Q, _ = robots.sample(robot, 300, seed=8)
    rng = np.random.default_rng(0)
    goal = np.clip(Q + rng.uniform(-0.05, 0.05, Q.shape), robot.lower, robot.upper)
    T = np.array([robot.fk(q).homogeneous for q in goal])
    batch = ik.solve_batch(robot, T, q0=Q, follow=0.3)
    one = ik.Solver(robot, follow=0.3)
    assert batch.success.mean() > 0.95
    assert max(size_of_moves(robot, q, q0).max() for q, q0 in zip(batch.q, Q, strict=True)) <= 0.3
    assert all(np.array_equal(batch.q[k], one(T[k], q0=Q[k]).q) for k in range(0, 300, 30))


def test_follow_needs_a_rule_and_starts():
    robot = robots.load("planar_2r")
    with pytest.raises(ik.IKError, match="closed form"):
        ik.Solver(robot, "planar-2r", follow=True)((1.0, 1.0, 0.0), robot.home)
    with pytest.raises(ik.IKError, match="q0"):
        ik.solve_batch(robot, np.ones((3, 3)), follow=True)


def test_attempt_tells_where_the_answer_comes_from():
    robot = robots.load("hydrolek_7w")
    Q, T = robots.sample(robot, 60, seed=4)
    seen = set()
    for q0, target in zip(Q, np.roll(T, 1, axis=0), strict=True):
        result = ik.solve(robot, target, "lm", q0=q0)
        alone = ik.solve(robot, target, "lm", q0=q0, restarts=0, max_iterations=1000)
        seen.add(result.attempt > 0)
        assert result.attempt <= result.restarts
        if result.attempt == 0 and result.success:
            assert alone.success and np.allclose(result.q, alone.q, atol=1e-4)
    assert seen == {True, False}


def test_a_joint_that_goes_to_its_other_end_is_said():
    robot = ik.Robot.load(robots.urdf(*(dict(kind="revolute", limits=(-3.5, 3.5), xyz="0.5 0 0") for _ in range(3))))
    q0, solver = np.array([3.49, 0.4, 0.3]), ik.Solver(robot, "lm")
    over = robot.fk([3.49, 0.4, 0.3]).homogeneous
    turn = turned(np.eye(4), 0.03)  # about the first joint's axis, past its limit
    turn[:3, 3] = np.array([0.5, 0, 0]) - turn[:3, :3] @ np.array([0.5, 0, 0])
    jumped, stayed = solver(turn @ over, q0=q0), solver(over, q0=q0)
    assert jumped.success and abs(jumped.q[0] - q0[0]) > np.pi and jumped.attempt == 0
    assert robot.joint_names[0] in jumped.notice and "follow" in jumped.notice
    assert stayed.success and not stayed.notice
    assert not ik.solve(robot, turn @ over, "lm", q0=q0, follow=True).success


def test_one_choice_of_solver():
    for name, target, used in (
        ("planar_2r", (1.0, 1.0, 0.0), "planar-2r"),
        ("inspection_7dof", None, "inspection"),
        ("hydrolek_7w", None, "lm"),
        ("hydrolek_7w", (1.0, 0.1, 0.2), "lm"),
    ):
        robot = robots.load(name)
        target = robot.fk(robot.random_q(np.random.default_rng(1))).homogeneous if target is None else target
        bound = ik.Solver(robot)
        assert bound.name == "auto"
        assert bound(target).solver == ik.solve(robot, target).solver == used
        assert np.array_equal(bound(target).q, ik.solve(robot, target).q)
        assert ik.Solver(robot, mask=(1, 1, 1, 0, 0, 0))(robot.fk(robot.home)).solver == "lm"


def test_a_mask_in_tip_axes_stays_near_its_start():
    robot = robots.load("hydrolek_7w")
    for seed in range(30):
        rng = np.random.default_rng(seed)
        q0 = robot.random_q(rng)
        T = robot.fk(np.clip(q0 + rng.uniform(-0.004, 0.004, robot.n), robot.lower, robot.upper)).homogeneous
        free = turned(T, rng.uniform(-2.0, 2.0))
        masked = ik.solve(robot, free, "lm", q0=q0, mask=(1, 1, 1, 1, 1, 0), frame="tip")
        axis = ik.solve(robot, ik.pose(T[:3, 3], direction=T[:3, 2]), "lm", q0=q0)
        assert masked.success and axis.success
        assert masked.attempt == axis.attempt == 0
        assert np.abs(masked.q - q0).max() < 0.01 + 2 * np.abs(axis.q - q0).max()


def test_follow_on_the_command_line(capsys):
    line = ["solve", "planar_2r", "--xyz", "0.9", "1.2", "0", "--q0", "0.3", "1.2", "--json"]
    assert main([*line, "--follow", "0.05"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert answer["status"] == "TOO_FAR" and np.abs(np.array(answer["q"]) - (0.3, 1.2)).max() <= 0.05
    assert main([*line, "--follow", "1.0"]) == 0
    assert json.loads(capsys.readouterr().out)["attempt"] == 0
    assert main(["solve", "planar_2r", "--xyz", "0.9", "1.2", "0", "--follow", "1.0"]) == 2
    assert "q0" in capsys.readouterr().err


def test_a_solver_that_follows_lists_every_solution_all_the_same():
    """`all` compares solutions from everywhere; that a single call stays near q0 says nothing of them."""
    robot = robots.load("hydrolek_7w")
    target = robot.fk(robot.home + 0.1).translation
    near = ik.Solver(robot, follow=0.3).all(target, robot.home, starts=60)
    assert len(near) > 1 and np.array_equal(near.q, ik.Solver(robot).all(target, robot.home, starts=60).q)
