"""A start is read alike at every entrance: degrees are doubted, what is outside the limits is clamped and said."""

import logging

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit import errors
from ik_toolkit.errors import InvalidConfiguration

ENTRANCES = {
    "solve": lambda robot, T, q: ik.solve(robot, T, q0=q).notice,
    "bound solver": lambda robot, T, q: ik.Solver(robot)(T, q0=q).notice,
    "all": lambda robot, T, q: ik.solve_all(robot, T, q0=q).message,
    "batch": lambda robot, T, q: ik.solve_batch(robot, [T, T], q0=q).notice,
    "row of a batch": lambda robot, T, q: ik.solve_batch(robot, [T, T], q0=[robot.home, q]).notice,
    "path": lambda robot, T, q: ik.solve_path(robot, [T, T], q0=q).message,
}


@pytest.mark.parametrize("entrance", ENTRANCES)
def test_degrees_are_doubted_and_clamping_is_said(entrance, caplog, monkeypatch):
    monkeypatch.setattr(errors, "DOUBTED", set())
    robot = robots.load("ur5")
    q = robot.home.copy()
    q[2] = 45.0
    with caplog.at_level(logging.WARNING, "ik_toolkit"):
        said = ENTRANCES[entrance](robot, robot.fk(robot.home).homogeneous, q)
    assert robot.joint_names[2] in said and "clamped" in said
    assert robot.joint_names[2] in caplog.text and "degrees" in caplog.text


@pytest.mark.parametrize("entrance", ENTRANCES)
def test_a_start_inside_is_not_spoken_of_and_wrong_ones_are_named(entrance):
    for robot in (robots.load("slides_mix"), robots.load("ur5")):
        T = robot.fk(robot.home).homogeneous
        for inside in (robot.home, robot.lower, robot.upper):
            assert "clamped" not in ENTRANCES[entrance](robot, T, inside)
    for wrong in (np.nan, np.inf):
        with pytest.raises(InvalidConfiguration, match=f"q0.* is not finite at joint {robot.joint_names[4]}"):
            ENTRANCES[entrance](robot, T, np.where(np.arange(6) == 4, wrong, robot.home))


def test_rows_of_a_batch_are_named_and_counted():
    robot = robots.load("ur5")
    T, q = robot.fk(robot.home).homogeneous, np.tile(robot.home, (5, 1))
    q[[1, 3], 2] = 4.0
    said = ik.solve_batch(robot, [T] * 5, q0=q).notice
    assert "target 1 " in said and "2 of 5 starts" in said and robot.joint_names[2] in said
    with pytest.raises(InvalidConfiguration, match=f"q0 of target 1 is outside.*{robot.joint_names[2]}"):
        ik.solve_batch(robot, [T] * 5, q0=q, q0_outside="refuse")
