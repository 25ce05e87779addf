"""The figures a PathResult computes for a motion, and the files it writes."""

import json

import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption, NotSolved
from ik_toolkit.paths.certificate import Continuity
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
        "continuity": Continuity(np.array([1e-4, 3e-4, np.nan, np.nan, np.nan]), np.zeros(5), np.zeros((2, 5))),
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


def test_every_figure_is_in_the_plain_numbers_and_in_the_files(tmp_path):
    angles = np.array([0.0, 1e-8, 0.0, np.nan, 2e-8])
    touching = ik.paths.certificate.Contact(2.5, ("arm", "wall"))
    proof = Continuity(
        np.array([1e-4, 3e-4, np.nan, np.nan, np.nan]), np.full(5, 0.01), np.zeros((2, 5)), 0.02, (touching,), (0.5,)
    )
    result = made(
        orientation_error=angles, continuity=proof, lower_bound=1, seed=4, elapsed=0.5, max_step=(0.1, 0.02),
        path_tolerance=(1e-3, 0.03),
    )  # fmt: skip
    told = result.to_dict()
    wanted = {
        "success": True, "status": "RECONFIGURES", "message": "a sentence", "robot": "planar_2r", "base": result.robot.base,
        "tips": ["tool"], "joint_names": ["joint_1", "joint_2"], "poses": 5, "lower_bound": 1, "at": result.at.tolist(),
        "position_error": [0.0, 1e-9, 0.0, None, 0.0], "orientation_error": [0.0, 1e-8, 0.0, None, 2e-8],
        "largest_step": {"rad": result.largest_step[0], "m": 0.0}, "length": {"rad": result.length[0], "m": 0.0},
        "deviation": {"m": 3e-4, "rad": 0.01}, "clearance": 0.02, "contacts": [{"place": 2.5, "pair": ["arm", "wall"]}],
        "unproven": [0.5], "max_step": {"rad": 0.1, "m": 0.02}, "path_tolerance": {"m": 1e-3, "rad": 0.03}, "seed": 4,
        "elapsed": 0.5, "unreachable": [{"index": 3, "reason": "out of reach by 1 mm", "proven": True}],
        "reconfigurations": [{"index": 1, "move": [0.8, -0.6]}],
    }  # fmt: skip
    assert {key: told[key] for key in wanted} == json.loads(json.dumps(wanted))
    assert told["curve"][1] == [0.05, 0.1] and told["curve"][4] == told["q"][3] == [None, None]
    assert json.loads(result.save(tmp_path / "a.json").read_text()) == told
    with np.load(result.save(tmp_path / "a.npz")) as file:
        np.testing.assert_array_equal(file["targets"], result.targets[:, 0], err_msg="as in a file of poses of one tip")
        for name in ("q", "position_error", "orientation_error", "curve", "at"):
            np.testing.assert_array_equal(file[name], getattr(result, name))
        assert file["reconfigurations"].tolist() == [1]
        assert file["tips"].tolist() == ["tool"] and file["joint_names"].tolist() == ["joint_1", "joint_2"]
    text = result.save(tmp_path / "a.csv").read_text().splitlines()
    assert text[0] == "pose,joint_1,joint_2,position_error,orientation_error" and text[2].split(",")[0] == "1"
    rows = np.genfromtxt(text, delimiter=",", skip_header=1)
    np.testing.assert_array_equal(rows[:, 1:], np.column_stack([result.q, result.position_error, angles]))
    with pytest.raises(InvalidOption, match=r"\.csv, \.npz or \.json"):
        result.save(tmp_path / "path.txt")
    positions = made()
    assert positions.save(tmp_path / "b.csv").read_text().splitlines()[0].endswith(",position_error")
    with np.load(positions.save(tmp_path / "b.npz")) as file:
        assert "orientation_error" not in file.files
    assert repr(positions) == "PathResult(RECONFIGURES, 5 poses, 1 reconfiguration, length 1.6 rad)"


def test_revolute_and_prismatic_steps_are_told_apart():
    robot = ik.Robot.load("cartesian_pp")
    q = np.array([[0.0, 0.0], [0.1, -0.3], [0.2, 0.1]])
    proof = Continuity(np.zeros(2), np.zeros(2), np.zeros((2, 2)))
    fields = dict(robot=robot, q=q, curve=q, at=np.arange(3.0), continuity=proof, position_error=np.zeros(3))
    result = made(PathStatus.FOLLOWED, **fields, reconfigurations=(), unreachable=())
    assert result.largest_step == pytest.approx((0.0, 0.4)) and result.length == pytest.approx((0.0, 0.9))
    assert repr(result).endswith("length 0 rad and 0.9 m)")


def test_a_pose_that_limits_forbid_is_not_called_beyond_reach():
    """In reach of the links, though no attempt finds it: nothing is proven."""
    arm = ik.Robot.load("planar_2r").narrowed({"joint_2": (0.5, 0.6)})
    inside = arm.fk([0.2, 0.55]).translation
    result = ik.solve_path(arm, [inside, 0.6 * inside], position_tolerance=1e-4)
    (said,) = result.unreachable
    assert said.index == 1 and "beyond reach" not in said.reason and not said.proven
    far = ik.solve_path(arm, [inside, 4.0 * inside])
    assert (
        "beyond reach by" in far.unreachable[0].reason
        and "orientation" not in far.unreachable[0].reason
        and far.unreachable[0].proven
    )
