"""Figures of a run, each worked out again from its arrays, and what is said of a path that cannot be followed."""

import json

import numpy as np
import pytest
import robots
from references import line_of

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.servo.path_reach import survey
from ik_toolkit.text import length


def pose_line(robot, q, other, duration):
    return ik.line(robot.fk(q), robot.fk(other), duration=duration, law="minimum-jerk")


def test_moves_speeds_and_their_rates(arm):
    other = arm.home + 0.2
    run = ik.track(arm, pose_line(arm, arm.home, other, 1.0), "cv", q0=arm.home + 0.01, settle=0.01, on_limit="leave")
    made, moves = run.figures, np.diff(run.q, axis=0)
    for order, name in enumerate(("peak_speed", "peak_acceleration", "peak_jerk"), start=1):
        d = run.q
        for _ in range(order):
            d = (d[1:] - d[:-1]) / run.dt
        assert np.allclose(made[name], np.abs(d).max(axis=0), rtol=1e-6)
    largest = max((abs(moves[k, j]), run.joint_names[j], run.t[k]) for k in range(len(moves)) for j in range(arm.n))
    assert tuple(made["largest_move"][key] for key in ("value", "joint", "time")) == largest
    assert made["jumps"] == 0 and made["damped_time"] == run.damped.sum() * run.dt
    for name, at, between in (
        ("position", run.position_error, run.between_position),
        ("orientation", run.orientation_error, run.between_orientation),
    ):
        half = at[len(at) // 2 :]
        assert made[name] == pytest.approx(
            {
                "max": at.max(),
                "rms": np.sqrt(np.mean(at**2)),
                "final": at[-1],
                "settled_max": half.max(),
                "settled_rms": np.sqrt(np.mean(half**2)),
                "between_max": between.max(),
                "between_settled_max": between[len(between) // 2 :].max(),
            }
        )
        assert made[name]["max"] > made[name]["settled_max"]  # it begins off its path
    told = run.to_dict()
    assert told["figures"] == made and told["samples_outside"] == run.outside().sum() > 0
    assert told["duration"] == run.t[-1] and told["clock"] == run.clock[-1] and told["added_time"] == 0.0
    assert told["pace_joint"] is None and told["reach"] == run.reach.to_dict() and told["success"] is False


def test_a_run_near_a_singular_pose_counts_the_time_it_is_damped(planar):
    """Out to the edge of the reach and back: damped in some steps there, and not where the elbow is bent."""
    q = np.array([0.2, 0.9])
    start = planar.fk(q).translation
    edge = planar.fk([0.65, 0.0]).translation
    run = ik.track(planar, ik.line(start, edge, duration=1.0, rounds=1), "cv", q0=q, on_limit="leave")
    share = run.damped.mean()
    assert 0.0 < share < 0.5 and run.figures["damped_time"] == pytest.approx(run.damped.sum() * run.dt)


# -------------------------------------------------------------------------------------------------- what a survey says
def test_a_path_that_ends_the_reach_says_where_and_why(planar, arm):
    q = np.array([0.3, 0.9])
    out = line_of(planar, q, 2.0 * planar.fk([0.75, 0.0]).translation * (1.0, 1.0, 0.0), 4.0, "constant", free=True)
    found = survey(planar, out, q)
    start, end = out.at(0.0)[0][:3, 3], out.at(4.0)[0][:3, 3]
    reach = np.linalg.norm(planar.fk([0.0, 0.0]).translation[:2])
    shares = np.linspace(0.0, 1.0, 100_001)[:, None]
    inside = np.linalg.norm((start + shares * (end - start))[:, :2], axis=1) <= reach
    stop = shares[inside][-1, 0] * np.linalg.norm(end - start)
    assert not found.whole and found.stop == pytest.approx(stop, abs=1e-3) and not found.turning and not found.posed
    assert found.along[-1] == pytest.approx(np.linalg.norm(end - start)) and found.joints == ()
    assert found.message.startswith(
        f"reachable up to {length(found.stop)} of {length(found.along[-1])}: the arm is at the edge"
    )
    assert found.message.endswith(
        "the arm is at the edge of its reach, or its 2 joints cannot move the tip along this path"
    )
    run = ik.track(planar, out, "cv", q0=q)
    assert not run.success and found.message in run.message and "scaled by" in run.message
    free = ik.Robot.load(
        robots.urdf(
            *[dict(kind="continuous", axis=a) for a in ("0 0 1", "0 1 0", "0 1 0", "1 0 0")], dict(kind="fixed")
        )
    )
    bent = [0.1, 0.4, 0.8, 0.0]
    message = survey(free, line_of(free, bent, (0.0, 0.0, 2.0), 4.0, "constant", free=True), bent).message
    assert message.endswith("the arm is at the edge of its reach")  # four joints can move a tip anywhere


def test_a_path_that_a_joint_limit_ends_names_the_joint():
    text = robots.urdf(
        dict(kind="revolute", xyz="0 0 0", limits=(-2.0, 0.5)), dict(kind="prismatic", axis="1 0 0", limits=(0.5, 2.0)),
        dict(kind="fixed", xyz="0.1 0 0"),
    )  # fmt: skip
    robot = ik.Robot.load(text)
    angles = np.linspace(0.0, 1.0, 30)
    arc = ik.waypoints(
        [[1.1 * np.cos(a), 1.1 * np.sin(a), robot.fk([0.0, 1.0]).translation[2]] for a in angles], duration=3.0
    )
    found = survey(robot, arc, [0.0, 1.0])
    assert found.joints == ("j0",) and found.stop == pytest.approx(0.55, abs=2e-3)
    assert found.message == f"reachable up to {length(found.stop)} of 1.1 m: j0 at its limit"
    q = found.q[found.until - 1]
    assert q[0] <= 0.5 and found.t[found.until] == pytest.approx(1.5, abs=0.1)
    assert found.to_dict()["joints"] == ["j0"] and found.to_dict()["unit"] == "m" and not found.to_dict()["whole"]


def test_a_path_that_is_only_too_fast_says_how_much(planar):
    q = np.array([0.3, 0.9])
    run = ik.track(
        planar, line_of(planar, q, (-0.9, 0.5, 0.0), 0.2, "constant", free=True), "cv", q0=q, on_limit="leave"
    )
    made, reach = run.figures, run.reach
    hit = (run.limited & 7) > 0  # position, speed, acceleration
    assert hit.any() and made["time_at_limits"] == pytest.approx(hit.any(axis=1).sum() * run.dt)
    by_joint = dict(zip(run.joint_names, hit.sum(axis=0) * run.dt, strict=True))
    assert made["time_at_limits_by_joint"] == pytest.approx(by_joint)
    assert not run.success and reach.whole and reach.message == ""
    speeds = np.abs(np.diff(reach.q, axis=0)) / np.diff(reach.t)[:, None] / planar.velocity_limits
    share, joint = speeds.max(), planar.joint_names[int(np.argmax(speeds.max(axis=0)))]
    assert reach.pace == (share, joint) and share > 1.0
    told = f"Every pose can be reached, but {joint} would need {share:.3g} times its speed limit: go slower."
    assert run.message.endswith(told)
    assert reach.to_dict()["speed"] == {"share_of_limit": share, "joint": joint} and reach.to_dict()["whole"]


# ------------------------------------------------------------------------------------------------------ what is written
def test_every_array_is_in_the_files(arm, tmp_path):
    run = ik.track(arm, pose_line(arm, arm.home, arm.home + 0.1, 0.3), "cv", q0=arm.home, rate0=np.zeros(arm.n))
    names = (
        "t", "q", "rate", "xyz", "target_xyz", "position_error", "orientation_error", "limited", "damped", "clock", "sigma",
        "pace", "between_position", "between_orientation",
    )  # fmt: skip
    with np.load(run.save(tmp_path / "run.npz")) as file:
        assert set(file.files) == {*names, "joint_names"} and file["joint_names"].tolist() == list(arm.joint_names)
        for name in names:
            np.testing.assert_array_equal(file[name], getattr(run, name))
    text = run.save(tmp_path / "run.csv").read_text().splitlines()
    joints = [f"q_{name}" for name in arm.joint_names]
    assert text[0].split(",") == ["t", *joints, "x", "y", "z", "position_error", "orientation_error", "clock"]
    rows = np.genfromtxt(text, delimiter=",", skip_header=1)
    columns = [run.t, run.q, run.xyz, run.position_error, run.orientation_error, run.clock]
    np.testing.assert_array_equal(rows, np.column_stack(columns))
    told = run.to_dict()
    for name in "robot method dt message position_tolerance orientation_tolerance settle elapsed searched".split():
        assert told[name] == getattr(run, name), name
    assert told["status"] == run.status.name and told["between"] is None
    places = [tuple(point["positions"]) for point in run.to_ros()["points"]]
    assert places == [tuple(q) for q in run.q.tolist()]
    ros = json.loads(run.save(tmp_path / "run.json").read_text())
    assert ros == run.to_ros() and ros["joint_names"] == list(arm.joint_names)
    assert [point["velocities"] for point in ros["points"]] == run.rate.tolist()
    assert ros["points"][29]["time_from_start"] == {"sec": 0, "nanosec": 290_000_000}
    with pytest.raises(InvalidOption, match=r"npz, \.csv or \.json"):
        run.save(tmp_path / "run.txt")


def test_files_of_several_tips(tmp_path):
    tree = robots.load("two_arms")
    start = tree.fk(tree.home)
    each = {tip: ik.line(start[tip].translation, start[tip].translation + 0.02, duration=0.2) for tip in tree.tips}
    run = ik.track(tree, each, "cv", q0=tree.home)
    head = run.save(tmp_path / "run.csv").read_text().splitlines()[0].split(",")
    places = [f"{tip}.{axis}" for tip in tree.tips for axis in "xyz"]
    assert head == ["t", *(f"q_{name}" for name in tree.joint_names), *places, "position_error", "clock"]
    rows = np.genfromtxt(tmp_path / "run.csv", delimiter=",", skip_header=1)
    at = 1 + tree.n
    np.testing.assert_array_equal(rows[:, at : at + 6], run.xyz.reshape(len(run.t), 6))
    with np.load(run.save(tmp_path / "run.npz")) as file:
        assert "orientation_error" not in file.files and "between_position" not in file.files
