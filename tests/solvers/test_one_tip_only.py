"""Calls for one tip reject a tree and say how to choose a tip."""

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import FrameNotFound, InvalidOption
from ik_toolkit.solvers.closed_form import describe_fit, fits
from ik_toolkit.study.singularity import measures


def test_what_is_of_one_tip(brokk):
    T = np.eye(4)
    for call in (
        lambda: measures(brokk, np.zeros(13)),
        lambda: ik.reachability(brokk),
        lambda: ik.calibrate(brokk, T, T),
    ):
        with pytest.raises(InvalidOption, match=r"needs one tip, .* left_tip, right_tip; choose one: ik.Robot.load"):
            call()
    with pytest.raises(InvalidOption, match="takes a Robot"):
        measures("brokk_hydrolek", np.zeros(13))


def test_no_closed_form_fits_a_tree(brokk):
    assert describe_fit(brokk) == "" and fits(brokk, 0) is None and fits(ik.Tree(brokk.arms[:1]), 0) is None


def test_the_targets_of_one_tip_may_be_by_its_name_everywhere():
    robot = robots.load("planar_3r")
    T = robot.fk(robot.random_q(np.random.default_rng(0))).homogeneous
    p, many, circle = T[:3, 3], np.tile(T[:3, 3], (2, 1)), ik.circle(T, 0.02, duration=0.2)
    turned = [ik.pose(p, direction=T[:3, 2])] * 2
    calls = {
        "solve": lambda by: ik.solve(robot, by(p)).q,
        "all": lambda by: ik.solve_all(robot, by(p), starts=20).q,
        "solver": lambda by: ik.Solver(robot)(by(p)).q,
        "batch": lambda by: ik.solve_batch(robot, by(many)).q,
        "axes": lambda by: ik.solve_batch(robot, by(turned)).q,
        "rows": lambda by: ik.solve_batch(robot, [by(p), by(p)]).q,
        "path": lambda by: ik.solve_path(robot, by(many)).q,
        "track": lambda by: ik.track(robot, by(circle)).q,
        "tracker": lambda by: ik.Tracker(robot).update(by(p), 0.01).q,
        "place": lambda by: [place.T_world_base for place in ik.place(robot, by(many), count=2)],
        "errors": lambda by: robot.errors(robot.home, by(p)),
    }
    for name, call in calls.items():
        plain, by_name = call(lambda given: given), call(lambda given: {robot.tip: given})
        assert np.array_equal(np.array(plain, dtype=float), np.array(by_name, dtype=float), equal_nan=True), name
        with pytest.raises(
            FrameNotFound, match=rf"'tol' is not one of the tips solved for\. Did you mean '{robot.tip}'"
        ):
            call(lambda given: {"tol": given})
