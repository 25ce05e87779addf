"""Calibration: rows, units and labels that were mixed up do not pass for a calibrated arm."""

import json

import numpy as np
import pytest
import robots
from folders import write_csv

import ik_toolkit as ik
from ik_toolkit.errors import InvalidTarget


@pytest.fixture(scope="module")
def data():
    """A HydroLek whose joints are half a degree off, and positions of its tip."""
    arm = robots.load("hydrolek_7w")
    Q = arm.random_q(np.random.default_rng(5), 30)
    off = np.radians(np.random.default_rng(6).normal(0.0, 0.5, arm.n))
    return arm, Q, np.array([arm.fk(q + off).translation for q in Q])


def test_metres_taken_for_millimetres_are_refused(data):
    arm, Q, at = data
    with pytest.raises(InvalidTarget, match="were they metres already"):
        ik.calibrate(arm, Q, 1e-3 * at)
    with pytest.raises(InvalidTarget, match="were millimetres meant"):
        ik.calibrate(arm, Q, 1e3 * at)


def test_rows_in_another_order_are_not_credible(run, data, tmp_path):
    arm, Q, at = data
    file = write_csv(tmp_path / "m.csv", ",".join([*arm.joint_names, "x", "y", "z"]), np.hstack([Q, at[::-1]]))
    given = ["calibrate", "hydrolek_7w", "--data", file, "-o", tmp_path / "arm.urdf", "--parameters", "joints"]
    code, out, err = run(*given, "--json")
    assert code == 1 and "not to be used" in err and not json.loads(out)["credible"]


def test_an_error_far_beyond_the_prior_is_not_credible_until_the_prior_allows_it(data):
    arm, Q, _ = data
    off = np.zeros(arm.n)
    off[2] = np.radians(20.0)
    at = np.array([arm.fk(q + off).translation for q in Q])
    found = ik.calibrate(arm, Q, at, parameters=("joints",))
    assert found.implausible == ("elbow_pitch.offset",) and not found.credible
    assert ik.calibrate(arm, Q, at, parameters=("joints",), prior=(0.01, 0.35)).credible


def test_copied_rows_are_not_new_measurements(data):
    arm, Q, at = data
    assert not any("differ" in note for note in ik.calibrate(arm, Q, at, parameters=("joints",)).notes)
    found = ik.calibrate(arm, np.tile(Q[:15], (3, 1)), np.tile(at[:15], (3, 1)), parameters=("joints",))
    assert any("only 15 of the 45 configurations differ" in note for note in found.notes)
    said = "6 configurations that differ, of 60 measurements of kind 'position' are 18 numbers"
    with pytest.raises(InvalidTarget, match=said):
        ik.calibrate(arm, np.tile(Q[:6], (10, 1)), np.tile(at[:6], (10, 1)))


def test_a_blank_line_is_said_once(run, data, tmp_path):
    """The file is read twice, for the joints and for the positions."""
    arm, Q, at = data
    rows = [",".join(map(str, row)) for row in np.hstack([Q, at])]
    file = tmp_path / "m.csv"
    file.write_text("\n".join([",".join([*arm.joint_names, "x", "y", "z"]), *rows[:4], "", *rows[4:]]))
    code, _, err = run("calibrate", "hydrolek_7w", "--data", file, "--parameters", "joints")
    assert code == 0 and err.count("blank line") == 1
