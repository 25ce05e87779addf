"""Scenes of paths and trajectories: the tip path in colours, the frames of the animation, files read back."""

import motions
import numpy as np
import pytest
from robots import CONTINUOUS

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration
from ik_toolkit.kernel.counted_error import KIND

pytest.importorskip("meshcat")
from ik_toolkit.show.animation import motion_from_file, motion_of


def result(breaks=()):
    robot = motions.load("planar_3r")
    return motions.as_result(robot, motions.wave(robot, 30), breaks=breaks, kind=KIND.position)


def test_a_path_is_shown_with_its_poses_and_its_bound():
    made = result()
    scene = ik.view(made.robot, made)
    told = scene.window.about["animation"]
    assert told["count"] == len(made.curve) and told["labels"][0].startswith("pose 0.0")
    assert "path" in scene.drawn() and any(path.startswith("trail/") for path in scene.drawn())
    assert any("deviation" in label for _, label in scene.window.about["legend"])


def test_nothing_is_drawn_across_a_change_of_branch():
    whole, broken = (motion_of(result(breaks)) for breaks in ((), (14,)))
    assert whole.breaks == () and len(broken.breaks) == 1
    np.testing.assert_array_equal(broken.q[broken.breaks[0]], result().q[14])


def test_the_chart_of_a_path_draws_joints_without_limits_in_half_turns():
    robot = ik.Robot.load(CONTINUOUS)
    path = motions.as_result(robot, motions.wave(robot, 30), kind=KIND.position)
    drawn = {line.get_label(): line.get_ydata() for line in ik.plot(path).axes[0].lines}
    for i, name in enumerate(robot.joint_names):
        shown = path.curve[:, i] / (np.pi if np.isinf(robot.upper[i]) else 2.0)
        np.testing.assert_allclose(drawn[name], shown, atol=1e-12)


def test_trajectories_are_shown_in_real_time_and_read_back(tmp_path):
    pytest.importorskip("scipy")
    made = result().retime(1.0, 2.0, rate=50.0)
    scene = ik.view(made.robot, made)
    told = scene.window.about["animation"]
    assert told["count"] / told["fps"] == pytest.approx(made.duration, rel=0.1)
    shown = motion_of(made)
    for file in (made.to_csv(tmp_path / "t.csv"), made.to_json(tmp_path / "t.json")):
        read = motion_from_file(made.robot, file)
        np.testing.assert_allclose(read.q, made.q)
        np.testing.assert_allclose(read.t, made.t, atol=1e-9)
        assert np.abs(read.values - shown.values).max() < 0.1 * shown.values.max()


def test_paths_are_read_back_without_the_poses_not_reached(tmp_path):
    made = result()
    q, curve = made.q.copy(), made.curve.copy()
    q[3], curve[made.at == 3.0] = np.nan, np.nan
    part = type(made)(**{**vars(made), "q": q, "curve": curve})
    for name, rows in (("p.csv", q), ("p.npz", curve), ("p.json", curve)):
        read = motion_from_file(made.robot, part.save(tmp_path / name))
        np.testing.assert_allclose(read.q, rows[np.isfinite(rows).all(axis=1)])


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".json"])
def test_tracking_runs_are_read_back_with_their_times(suffix, tmp_path):
    robot = motions.load("planar_2r")
    run = ik.track(robot, ik.circle(robot.fk(robot.home).translation, 0.1, duration=0.5), "cv", dt=0.05)
    read = motion_from_file(robot, run.save(tmp_path / f"run{suffix}"))
    np.testing.assert_allclose(read.q, run.q)
    np.testing.assert_allclose(read.t, run.t, atol=1e-9)
    assert np.isfinite(read.values).all()


def test_files_of_another_robot_or_of_no_motion_are_refused_with_what_is_missing(tmp_path):
    made = result()
    np.savez(tmp_path / "bad.npz", joint_names=["joint_1", "joint_2"], x=np.zeros(3))
    (tmp_path / "bad.json").write_text("{}")
    for name, file, said in (
        ("hydrolek_7w", made.save(tmp_path / "p.csv"), "no values of joint azimuth_yaw"),
        ("planar_3r", tmp_path / "bad.json", r"cannot read the motion in 'bad\.json'"),
        ("planar_2r", tmp_path / "bad.npz", r"cannot read the motion in 'bad\.npz': it has neither 'curve'"),
    ):
        with pytest.raises(InvalidConfiguration, match=said):
            motion_from_file(motions.load(name), file)
