"""Newton: any square task, whatever its axes; with a line search its error falls in every iteration."""

import numpy as np
import pytest
import robots
from serial_arms import drawn

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.papers.chinyai import formulas


def targets(count, l1=1.0, l2=1.0):
    X = formulas.targets(np.random.default_rng(5), count, l1, l2)
    return X, np.column_stack([X, np.zeros(count)])


def test_it_ends_where_the_papers_own_formulas_with_step_halving_do():
    robot, start = robots.load("planar_2r"), np.radians((45.0, 90.0))
    X, positions = targets(300)
    searched = ik.solve_batch(robot, positions, ik.Newton(line_search=True), q0=start, limits=False)
    whole = ik.solve_batch(robot, positions, ik.Newton(), q0=start, limits=False)
    rows = formulas.converge(X, 1.0, 1.0, start, formulas.SEARCH)
    assert searched.success.all() and 0.7 < whole.success.mean() < 0.95 and (rows[:, 2] >= 0).all()
    assert np.abs(np.exp(1j * searched.q) - np.exp(1j * rows[:, :2])).max() < 1e-4


@pytest.mark.parametrize(("name", "pose"), [("planar_2r", False), ("hydrolek_7w", True), ("planar_3r", True)])
def test_the_error_falls_in_every_iteration_within_the_limits(name, pose):
    robot, rng, fewer = robots.load(name), np.random.default_rng(2), 0
    for _ in range(20):
        T, q0 = robot.fk(robot.random_q(rng)), robot.random_q(rng)
        target = T if pose else T.translation
        run = ik.solve(robot, target, ik.Newton(line_search=True), q0=q0, history=True)
        past = run.history
        far, turn = past["position_error"] / robot.chain.scale, 0.0
        if pose:
            turn = 2.0 * np.sin(0.5 * past["orientation_error"])
        size = np.hypot(far, turn)
        assert (np.diff(size)[:-1] < 0.0).all() and np.diff(size)[-1:].sum() <= 1e-12
        assert (past["q"] >= robot.lower - 1e-12).all() and (past["q"] <= robot.upper + 1e-12).all()
        assert run.fk_evaluations > run.iterations  # Every trial counts.
        fewer += ik.solve(robot, target, ik.Newton(line_search=True), q0=q0, max_evaluations=7).fk_evaluations > 7
    assert fewer == 0


def test_it_is_a_switch():
    with pytest.raises(InvalidOption, match="line_search is True or False"):
        ik.solve(robots.load("planar_2r"), (1.0, 0.5, 0.0), ik.Newton(line_search="no"))


@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.9)])
@pytest.mark.parametrize("slide", [(1, 0, 0), (1.0, 0.5, 0.0)])
def test_a_plane_need_not_be_along_the_axes(tilt, slide):
    """Two joints move the tip in a plane: two independent errors, though all three components change."""
    joints = [("prismatic", (0, 0, 0), tilt, slide, -3, 3), ("revolute", (1, 0, 0), (0, 0, 0), (0, 0, 1), -3, 3)]
    robot = drawn(joints, (0.7, 0, 0))
    run = ik.solve(robot, robot.fk([0.3, 1.0]).translation, "newton", q0=[0.1, 1.1], tolerance=1e-10)
    assert run.success and np.abs(run.q - [0.3, 1.0]).max() < 1e-8
    with pytest.raises(InvalidOption, match="has 3 and the path 2"):
        ik.solve(robot, robot.fk([0.3, 1.0]), "newton")
