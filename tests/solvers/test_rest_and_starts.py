"""Runs that no longer move are told from runs that were cut off; more attempts solve more; answers lie near home."""

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit import Status
from ik_toolkit.solvers.batch.solve_batch import solve_parts


@pytest.mark.parametrize("rule", ["dls", "pinv"])
def test_a_run_at_rest_is_not_called_cut_off(rule):
    """Where rounding cycles, a joint never keeps its value exactly; more iterations would not help."""
    robot, seen = robots.load("hydrolek_7w"), 0
    for T in robots.sample(robot, 60, seed=11)[1]:
        T = T.copy()
        T[:3, 3] *= 1.3  # most of these are out of reach, though not provably
        result = ik.solve(robot, T, rule, q0=robot.home, history=True)
        moves = np.abs(np.diff(result.history["q"], axis=0)).max(1)
        if len(moves) and moves[-1] < 1e-9:
            seen += not result.success
            assert result.status != Status.ITERATION_LIMIT, result.message
        if result.status == Status.ITERATION_LIMIT:
            assert "more iterations where the error still falls" in result.message
    assert seen > 5


def test_rest_needs_an_error_that_does_not_fall():
    """A tolerance at rounding level is still met by steps that are as small."""
    robot = robots.load("planar_2r")
    result = ik.solve(robot, robot.fk([0.4, 0.9]).translation, "newton", q0=[0.41, 0.91], position_tolerance=1e-14)
    assert result.success and result.position_error <= 1e-14


@pytest.mark.parametrize("given", [False, True])
@pytest.mark.parametrize("name", ["hydrolek_7w", "locked"])
def test_more_attempts_solve_what_fewer_do(name, given):
    """Pose by pose, except for what only the descent after a failure brings within the tolerance."""
    robot, before, counts = robots.load(name), np.zeros(1500, dtype=bool), []
    starts, T = robots.sample(robot, 1500, seed=12)
    for k in range(5):
        parts = solve_parts(robot, T, "lm", restarts=k, q0=starts[::-1] if given else None, finish=False)
        solved = np.concatenate([part.success for part in parts])
        assert not (before & ~solved).any()
        before = solved
        counts.append(solved.sum())
    assert counts[0] < counts[-1]


def test_the_last_attempt_is_not_given_up_early():
    """It solves what an attempt that is the only one solves from the same start."""
    robot, seen = robots.load("locked"), 0
    for T in robots.sample(robot, 300, seed=14)[1]:
        both = ik.solve(robot, T, "lm", restarts=1, history=True)
        if both.restarts:
            start = both.history["q"][np.flatnonzero(both.history["attempt"] == 1)[0]]
            alone = ik.solve(robot, T, "lm", q0=start, restarts=0)
            assert both.success or not alone.success
            seen += alone.success
    assert seen > 50


@pytest.mark.parametrize("name", ["hydrolek_7w", "planar_3r"])
def test_without_q0_answers_lie_near_home(name):
    """Half of the starts lie in half the range, and near ones count a little more: 1.1 times the least was measured."""
    robot = robots.load(name)
    Q = robot.home + 0.4 * (robot.random_q(np.random.default_rng(13), 300) - robot.home)
    T = np.array([robot.fk(q).homogeneous for q in Q])

    def far(batch):
        return np.median(np.linalg.norm(batch.q - robot.home, axis=1)[batch.success])

    free, nearest = ik.solve_batch(robot, T, "lm"), ik.solve_batch(robot, T, "lm", q0=robot.home, closest=True)
    assert free.success.all() and nearest.success.all()
    assert far(free) <= 1.2 * far(nearest), (far(free), far(nearest))


def test_largest_move_and_its_notice():
    robot = robots.load("planar_3r")
    solver = ik.Solver(robot, "lm")
    q0 = np.array([0.3, 0.6, -0.4])
    near, far = robot.fk([0.35, 0.62, -0.4]).homogeneous, robot.fk([1.0, 0.5, -0.5]).homogeneous
    close = solver(near, q0)
    assert close.largest_move[0] == robot.joint_names[np.argmax(abs(close.q - q0))] and close.notice == ""
    assert close.largest_move[1] == abs(close.q - q0).max()
    there = solver(far, q0)
    joint, amount = there.largest_move
    assert there.attempt == 0 and amount > 0.5
    assert there.notice == f"joint {joint} moved by {amount:.3g} rad from q0; in a loop use follow=True"
    assert ik.solve(robot, far, "lm", q0=q0).notice == ""  # one solve may well start far away
    assert solver(far).largest_move is None and ik.solve_batch(robot, far[None], q0=q0)[0].largest_move is None
    # What a result says is about the arrays as they were.
    said, moved = there.notice, far.copy()
    q0 += 1.0
    assert there.largest_move == (joint, amount) and there.notice == said
    moved[:3, 3] *= 9.0
    lost = solver(moved, q0)
    message, error = lost.message, lost.raw_error
    moved[:] = far
    assert lost.message == message and np.array_equal(lost.raw_error, error)
    target, start = near.copy(), q0 - 1.0
    found = solver(target, start)
    told = found.raw_error, str(found.explain())
    target[:3, 3] += 0.3
    start += 0.5
    assert found.success and np.array_equal(found.raw_error, told[0]) and str(found.explain()) == told[1]
