"""The figures a PathResult computes for a motion, and the files it writes."""

import json

import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption, NotSolved
from ik_toolkit.paths.proof import Continuity
from ik_toolkit.paths.result import PathResult, PathStatus, Reconfiguration, Unreachable
from ik_toolkit.solvers.options import Options


def made(status=PathStatus.RECONFIGURES, **changes):
    """A path of five poses: a break after pose 1, pose 3 not reached, one row inserted between poses 0 and 1."""
    robot = ik.Robot.load("planar_2r")
    q = np.array([[0.0, 0.1], [0.2, 0.1], [1.0, -0.5], [np.nan, np.nan], [1.1, -0.5]])
    curve = np.insert(q, 1, [0.05, 0.1], axis=0)
    at = np.array([0.0, 0.5, 1.0, 2.0, 3.0, 4.0])
    fields = {
        "robot": robot, "targets": np.tile(np.eye(4), (5, 1, 1, 1)), "kinds": (1,), "options": Options(), "q": q,
        "status": status, "message": "a sentence", "position_error": np.array([0.0, 1e-9, 0.0, np.nan, 0.0]),
        "orientation_error": None, "curve": curve, "at": at,
        "continuity": Continuity(np.array([1e-4, 3e-4, np.nan, np.nan, np.nan]), np.zeros(5)),
        "reconfigurations": (Reconfiguration(1, np.array([0.8, -0.6])),),
        "unreachable": (Unreachable(3, "out of reach by 1 mm", True),),
    }  # fmt: skip
    return PathResult(**(fields | changes))


def test_a_motion_breaks_at_reconfigurations_and_at_poses_not_reached():
    result = made()
    assert result.pieces == [slice(0, 3), slice(3, 4), slice(5, 6)]
    assert result.largest_step == pytest.approx((0.15, 0.0))
    assert result.length == pytest.approx((0.2 + 0.8 + 0.6, 0.0))
    assert result.deviation == pytest.approx((3e-4, 0.0))


@pytest.mark.parametrize("status", PathStatus)
def test_followed_and_reconfigures_are_successes(status):
    result = made(status)
    assert result.success == (status.name in ("FOLLOWED", "RECONFIGURES"))
    if not result.success:
        with pytest.raises(NotSolved, match=f"{status.name}: a sentence"):
            result.raise_for_status()


def test_saved_paths_are_read_back(tmp_path):
    result = made()
    rows = np.genfromtxt(result.save(tmp_path / "path.csv"), delimiter=",", skip_header=1)
    np.testing.assert_array_equal(rows[:, 1:3], result.q)
    with np.load(result.save(tmp_path / "path.npz")) as file:
        np.testing.assert_array_equal(file["curve"], result.curve)
        assert file["reconfigurations"].tolist() == [1]
    read = json.loads(result.save(tmp_path / "path.json").read_text())
    assert read["q"][3] == [None, None]
    assert read["unreachable"] == [{"index": 3, "reason": "out of reach by 1 mm", "proven": True}]
    assert read["reconfigurations"] == [{"index": 1, "move": [0.8, -0.6]}]
    with pytest.raises(InvalidOption, match=r"\.csv, \.npz or \.json"):
        result.save(tmp_path / "path.txt")
