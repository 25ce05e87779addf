"""Evaluations and iterations that run out: a closed form and the search after it share one budget."""

import numpy as np
import pytest
import robots

import ik_toolkit as ik


@pytest.mark.parametrize(("name", "solver"), [("planar_2r", "planar-2r"), ("inspection_7dof", "inspection")])
def test_a_failed_closed_form_leaves_the_search_what_is_left(name, solver):
    robot = robots.load(name)
    rng = np.random.default_rng(5)
    # Positions or poses near the edge of the reach: the closed form fails at some, and the search has its say.
    targets = []
    for _ in range(10):
        T = robot.fk(robot.random_q(rng)).homogeneous
        T[:3, 3] += rng.uniform(-0.3, 0.3, 3) * robot.reach
        targets.append(T if name == "inspection_7dof" else T[:3, 3])
    plain = ik.Solver(robot, solver)
    searched = [T for T in targets if plain(T).fk_evaluations > 30]
    assert len(searched) >= 2
    for budget in (1, 2, 3, 10, 30, 31, 100):
        bound = ik.Solver(robot, solver, max_evaluations=budget)
        for T in searched:
            result = bound(T)
            assert 1 <= result.fk_evaluations <= budget
            assert result.status == plain(T).status  # which the closed form has proven
            assert not robot.outside(result.q)
        batch = ik.solve_batch(robot, np.array(searched), solver, max_evaluations=budget)
        for row, T in zip(batch, searched, strict=True):
            assert row.fk_evaluations == bound(T).fk_evaluations


def test_attempts_that_are_all_cut_off_are_called_that():
    """Nothing has stalled where no attempt was allowed more than two steps: more of them reach the target."""
    robot = robots.load("hydrolek_7w")
    target = robot.fk(robot.random_q(np.random.default_rng(3)))
    for steps in (0, 1, 2):
        cut = ik.solve(robot, target, max_iterations=steps)
        assert cut.status == ik.Status.ITERATION_LIMIT and "after 250 starts, each cut off" in cut.message
        assert "try more iterations" in cut.message and "unreachable" not in cut.message
        assert ik.solve_batch(robot, [target], max_iterations=steps).status[0] == ik.Status.ITERATION_LIMIT
    assert ik.solve(robot, target).success
    away = target.homogeneous
    # in reach of the links, not of the joints: what the search itself gives up is STALLED
    away[2, 3] += 0.6 * robot.reach
    assert ik.solve(robot, away).status in (ik.Status.STALLED, ik.Status.LIMIT_BLOCKED, ik.Status.UNREACHABLE)
