"""A time limit: no effect unless it is reached; a result that hit it is reproduced by a limit on evaluations."""

import itertools

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.solvers import postprocess

LONG = 600.0  # s: never used up
each = pytest.mark.parametrize(
    ("name", "solver"), [("panda", "transpose"), ("inspection_7dof", "auto"), ("hydrolek_7w", "lm")]
)


def targets(robot, number):
    """Poses, half of them with the position of another: many are out of reach, which nothing proves."""
    rng = np.random.default_rng(11)
    made = [robot.fk(robot.random_q(rng)).homogeneous for _ in range(number)]
    for T, other in zip(made[::2], made[1::2], strict=True):
        T[:3, 3] = other[:3, 3]
    return made


def same(one, other):
    return one.status == other.status and np.array_equal(one.q, other.q) and one.fk_evaluations == other.fk_evaluations


@each
def test_a_long_timeout_changes_nothing(name, solver):
    robot = robots.load(name)
    plain, timed = ik.Solver(robot, solver), ik.Solver(robot, solver, timeout=LONG)
    answers = [plain(T) for T in targets(robot, 16)]
    assert any(answer.fk_evaluations > 256 for answer in answers)  # more than a slice
    for T, answer in zip(targets(robot, 16), answers, strict=True):
        assert same(timed(T), answer)


@each
def test_a_limit_of_evaluations_repeats_what_a_timeout_found(name, solver, monkeypatch):
    robot = robots.load(name)
    ticks = itertools.count(0.0, 1e-3)  # each look at the clock is a millisecond after the last
    monkeypatch.setattr(postprocess, "perf_counter", lambda: next(ticks))
    whole, struck = ik.Solver(robot, solver), 0
    for T in targets(robot, 16):
        timed = ik.solve(robot, T, solver, timeout=0.005, history=True)
        again = ik.solve(robot, T, solver, max_evaluations=timed.fk_evaluations, history=True)
        assert same(timed, again)
        assert len(timed.history["q"]) == len(again.history["q"])
        struck += timed.fk_evaluations < whole(T).fk_evaluations
        if "timeout" in timed.message:
            assert timed.status == ik.Status.ITERATION_LIMIT
            assert "the timeout of 0.005 s was reached" in timed.message and timed.message.endswith("raise timeout")
    assert struck


def test_a_timeout_ends_a_search_without_contact(monkeypatch):
    robot = robots.load("panda")
    blocked = ik.CollisionModel(robot)
    monkeypatch.setattr(ik.CollisionModel, "collides", lambda self, q: True)
    monkeypatch.setattr(ik.CollisionModel, "collisions", lambda self, q: [("a", "b")])
    T = robot.fk(robot.home)
    whole = ik.solve(robot, T, avoid_collisions=blocked)
    assert whole.status == ik.Status.COLLISION and whole.restarts >= 256
    cut = ik.solve(robot, T, avoid_collisions=blocked, timeout=0.0)
    assert cut.status == ik.Status.COLLISION and cut.restarts < 16


@pytest.mark.parametrize("timeout", [-1.0, float("nan"), float("inf"), "soon", [1.0]])
def test_what_is_no_time_is_refused(timeout):
    with pytest.raises(InvalidOption, match="timeout must be"):
        ik.Solver(robots.load("panda"), timeout=timeout)


def test_calls_that_promise_the_same_answer_every_time_take_no_timeout():
    robot = robots.load("panda")
    T = robot.fk(robot.home).homogeneous
    for call, targets in ((ik.solve_batch, T[None]), (ik.solve_path, T[None]), (ik.solve_all, T)):
        with pytest.raises(InvalidOption, match="timeout"):
            call(robot, targets, timeout=1.0)
