"""Typed angles that look like degrees cause a warning, but only once."""

import json

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit import errors


def test_angles_that_look_like_degrees_are_doubted_once(run, caplog):
    errors.DOUBTED.clear()
    code, _, err = run("fk", "planar_2r", "--q", "90", "1.5")
    assert code == 0 and "q, joint joint_1: 90 rad is 14.3 turns; were degrees meant?" in err and "joint_2" not in err
    assert "degrees meant" not in run("fk", "planar_2r", "--q", "90", "45", "--deg")[2]
    assert "rpy: 180 rad" in run("solve", "hydrolek_7w", "--xyz", "1", "0.1", "0.2", "--rpy", "0", "180", "0")[2]
    caplog.clear()
    robot = ik.Robot.load("planar_2r")
    for _ in range(3):
        robot.fk([12.5, 45])
        ik.pose((1, 0, 0), rpy=(12.5, -12.5, 0))
    assert caplog.messages == ["q, joint joint_2: 45 rad is 7.16 turns; were degrees meant?"]
    assert ik.Robot.load("cartesian_pp").fk([90, 45]) is not None and len(caplog.records) == 1


def test_one_vector_is_doubted_in_one_sentence_however_it_is_called_on_its_way(run):
    errors.DOUBTED.clear()
    _, _, err = run("track", "hydrolek_7w", "--q0", "90", "0", "0", "-90", "0", "0.1")
    said = "--q0, joints azimuth_yaw, forearm_roll: 90 rad is 14.3 turns; were degrees meant? Then add --deg."
    assert err.count("meant?") == 1 and said in err
    errors.DOUBTED.clear()
    _, _, err = run("fk", "planar_2r", "--q", "9000", "0", "--deg")
    assert "were degrees meant?\n" in err and "--deg" not in err


def test_angles_that_limits_allow_are_not_taken_for_degrees(caplog):
    far = robots.urdf(
        dict(kind="revolute", limits=(20.55, 30.05)), dict(kind="revolute", axis="0 1 0", limits=(-2.0, 2.0))
    )
    errors.DOUBTED.clear()
    robot = ik.Robot.load(far)
    robot.with_tool((0.1, 0, 0)).locked({"j1": 0.2})  # nobody typed the home that these check again
    q = np.array([23.0, 0.5])
    assert ik.solve(robot, robot.fk(q), "lm", q0=q, mask=(1, 1, 1, 0, 0, 0)).success
    assert not caplog.records
    robot.fk([45, 0.5])
    assert caplog.messages == ["q, joint j0: 45 rad is 7.16 turns; were degrees meant?"]


def test_a_tolerance_of_half_a_turn_is_doubted(caplog):
    arm = ik.Robot.load("hydrolek_7w")
    errors.DOUBTED.clear()
    ik.solve(arm, arm.fk(arm.home), orientation_tolerance=5)
    ik.solve(arm, arm.fk(arm.home), orientation_tolerance=0.1)
    assert caplog.messages == ["orientation_tolerance: 5 rad is 0.796 turns; were degrees meant?"]


def test_the_answer_to_a_partial_target_is_not_doubted_as_if_typed(caplog):
    robot = ik.Robot.load(robots.urdf(dict(kind="continuous"), dict(kind="revolute", axis="0 1 0")))
    errors.DOUBTED.clear()
    assert ik.solve(robot, robot.fk([0.1, 0.5]), "lm", q0=[14.0, 0.5], mask=(1, 1, 1, 0, 0, 0)).success
    assert [record.getMessage()[:2] for record in caplog.records] == ["q0"]


def test_angles_of_every_option_are_in_degrees(run):
    near = "solve hydrolek_7w --json --q0 home --xyz 1.0 0.1 0.2".split()
    turned = [*near, *"--rpy -1.6 0 -1.2".split()], [*near, *"--rpy -91.67324722 0 -68.75493542".split()]
    for (plain, degrees), *words in (
        ((near, near), "--follow {}"),
        (turned, "--orientation-tolerance {}", "--position-tolerance 0.1"),
        ((near, near), "--obstacle box:0.6,0.35,0.5,0.02,0.4,0.02,0,0,{}"),
    ):
        errors.DOUBTED.clear()
        words = " ".join(words)
        said, typed = json.loads(run(*plain, *words.format(np.radians(10.0)).split())[1]), words.format(10.0).split()
        _, out, err = run(*degrees, *typed, "--deg")
        told = json.loads(out)
        for key in ("status", "orientation_error", "clearance", "q"):
            assert told[key] == (pytest.approx(said[key], abs=1e-8) if key != "status" else said[key])
        assert "degrees meant" not in err


def test_a_move_of_zero_is_no_bound_and_refused(run):
    code, _, err = run(*"solve hydrolek_7w --xyz 1.0 0.1 0.2 --q0 home --follow 0".split())
    assert code == 2 and "--follow must be positive" in err
