"""The closed form of the planar arm, and the features closed forms share with every solver."""

import json
import math

import numpy as np
import pytest
import robots
from folders import read_data
from serial_arms import apart, drawn

import ik_toolkit as ik
from ik_toolkit.solvers.closed_form import reach

DATA = read_data("closed_form")
PI = math.pi


@pytest.mark.parametrize("case", DATA["planar_2r"])
def test_planar_reference(case):
    l1, l2, x, y = case["l1"], case["l2"], case["x"], case["y"]
    sols = np.empty((2, 2))
    if not case["solutions"]:
        margin = reach.planar_margin(x, y, l1, l2)
        r = math.hypot(x, y)
        assert margin == pytest.approx(l1 + l2 - r if case["status"] == "too-far" else r - abs(l1 - l2)) and margin < 0
        return
    found = sols[: reach.planar_branches(x, y, l1, l2, 0.0, sols)]
    assert len(found) == len(case["solutions"])
    d = apart(found, case["solutions"])
    assert d.min(axis=0).max() < 1e-9 and d.min(axis=1).max() < 1e-9


def test_planar_reach_limits_and_plane():
    robot = ik.Robot.load("planar_2r")
    out = ik.solve(robot, [3.0, 0.0, 0.0])
    assert out.status == ik.Status.UNREACHABLE and "by about 1 m;" in out.message
    assert out.position_error == pytest.approx(1.0)
    off = ik.solve(robot, [1.0, 0.5, 0.25])
    assert off.status == ik.Status.UNREACHABLE and off.position_error == pytest.approx(0.25)
    blocked = ik.solve(robot, [0.2, 0.1, 0.0])  # folds further than 150 degrees
    assert blocked.status == ik.Status.LIMIT_BLOCKED and blocked.limited_joints == ("joint_2",)
    assert len(ik.solve_all(robot, [0.2, 0.1, 0.0])) == 0
    both = ik.solve_all(robot, [1.0, 0.5, 0.0])
    assert len(both) == 2 and both.complete and both.distance[0] < both.distance[1]
    assert np.array_equal(ik.solve(robot, [1.0, 0.5, 0.0], q0=both[1]).q, both[1])
    near = ik.solve(robot, [2.0 + 5e-7, 0.0, 0.0])  # out of reach by less than the tolerance
    assert near.success and near.position_error == pytest.approx(5e-7, rel=1e-3)


def test_legal_turn_nearest_the_reference():
    joints = [
        ("revolute", (0, 0, 0), (0, 0, 0), (0, 0, 1), -10.0, 10.0),
        ("revolute", (1, 0, 0), (0, 0, 0), (0, 0, 1), 3.5, 6.0),
    ]
    robot = drawn(joints, (0.7, 0, 0))
    q = np.array([7.0, 4.0])
    result = ik.solve(robot, robot.fk(q).translation, q0=[8.0, 5.0])
    assert result.success and np.abs(result.q - q).max() < 1e-9
    assert np.abs(ik.solve(robot, robot.fk(q).translation, q0=[1.0, 5.0]).q - (q - [2 * PI, 0.0])).max() < 1e-9
    assert len(ik.solve_all(robot, robot.fk(q).translation)) == 1  # the other elbow, -4, has no legal turn


# ------------------------------------------------------------------------------------------------ the common contract


def test_history_and_counts():
    arm = robots.load("inspection_7dof")
    result = ik.solve(arm, arm.fk(arm.home), "inspection", history=True)
    assert result.iterations == 0 and result.restarts == 0 and result.fk_evaluations == 1
    assert result.history["q"].shape == (1, 7) and np.array_equal(result.history["q"][0], result.q)


def test_numerical_solve_all_merges_duplicates_and_turns():
    robot = ik.Robot.load("planar_2r")
    tip = robot.fk([0.4, 1.1]).translation
    exact, search = ik.solve_all(robot, tip), ik.solve_all(robot, tip, "lm", starts=200)
    assert len(search) == len(exact) == 2 and not search.complete
    assert np.abs(search.q - exact.q).max() < 1e-6
    redundant = ik.Robot.load("planar_3r")
    sample = ik.solve_all(redundant, redundant.fk(redundant.home).translation, count=8, starts=200)
    assert len(sample) == 8 and "infinitely many" in sample.message and not sample.complete
    nothing = ik.solve_all(redundant, [50.0, 0.0, 0.0], starts=20)
    assert len(nothing) == 0 and "reach" in nothing.message
    assert json.dumps(exact.to_dict())
