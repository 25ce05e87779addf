"""The reachable part of a path, the alternatives tried if it is not all, and a path that every robot can follow."""

import json

import numpy as np
import pinocchio as pin
import pytest
from references import line_of
from robots import have_data

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.servo.default_path import draw, eight, joint_motion
from ik_toolkit.servo.path_reach import explain, survey

DATA = pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed (extra 'robots')")
SHIPPED = ("hydrolek_7w", "planar_3r", "planar_2r", "cartesian_pp", "inspection_7dof")


def straight(robot, step, free=False):
    return line_of(robot, robot.home, step, 5.0, "constant", free)


@pytest.mark.parametrize("rate", [0.5, 2.0, 100.0])
@pytest.mark.parametrize("name", SHIPPED)
def test_every_robot_follows_a_small_motion_of_its_joints(name, rate):
    """At half of its speed limits at most, slow enough for few samples, and for a small tolerance slower."""
    robot = ik.Robot.load(name)
    reference = joint_motion(robot, dt=1.0 / rate)
    run = ik.track(robot, reference, q0=robot.home, dt=1.0 / rate)
    assert run.status.name == "COMPLETED", run.message
    assert np.ptp(run.target_xyz, axis=0).max() > 0.01  # it is a path
    assert np.allclose(run.target_xyz[0], robot.fk(robot.home).translation, atol=1e-12)
    assert (np.array(run.figures["peak_speed"]) <= 0.55 * robot.velocity_limits).all()
    fine = joint_motion(robot, dt=1.0 / rate, position_tolerance=1e-5)
    assert fine.duration >= reference.duration
    run = ik.track(robot, fine, "cv", dt=1.0 / rate, q0=robot.home, position_tolerance=1e-5)
    assert run.status.name == "COMPLETED", run.message


@pytest.mark.parametrize("method", ["ca", "aad"])
@pytest.mark.parametrize(("rate", "seconds"), [(2.0, 36.0), (10.0, 10.0)])
def test_limits_are_avoided_in_few_samples(method, rate, seconds):
    """Null motion that is taken up in one step never ended in ca, which extrapolates, and led the lift into its limit."""
    robot = ik.Robot.load("inspection_7dof")
    circle = draw("circle", robot.fk(robot.home).homogeneous, 0.1, duration=seconds)
    run = ik.track(robot, circle, method, dt=1.0 / rate, q0=robot.home)
    assert run.status.name == "COMPLETED" and not run.limited.any()
    assert np.abs(np.diff(run.rate, 2, axis=0)).max() < 0.5 * np.abs(run.rate).max()  # no zigzag


def test_the_command_chooses_a_slow_path_for_few_samples(run):
    code, out, _ = run("track", "planar_2r", "--rate", "1")
    shown = " ".join(out.split())
    assert code == 0 and "(chosen)" in shown
    assert float(shown.split("swing a little from home, and back, in ")[1].split()[0]) > 10.0


def test_how_far_a_line_can_be_followed_and_which_joint_ends_it(arm):
    found = survey(arm, straight(arm, (0.2, 0, 0)), arm.home)
    assert not found.whole and found.joints == ("elbow_pitch",) and 0.08 < found.stop < 0.1
    assert found.message.startswith("reachable up to 9") and "of 200 mm: elbow_pitch at its limit" in found.message
    # the edge is where the line itself says it is: a shorter one is reached, a longer one is not
    for factor, whole in ((0.99, True), (1.02, False)):
        assert survey(arm, straight(arm, (factor * found.stop, 0, 0)), arm.home).whole is whole
    assert survey(arm, straight(arm, (0.2, 0, 0), free=True), arm.home).message == ""


def test_a_run_that_leaves_says_what_was_tried_and_works(arm):
    ref = straight(arm, (0.2, 0, 0))
    run = ik.track(arm, ref, q0=arm.home)
    assert run.status.name == "LOST" and run.reach is not None and not run.reach.whole
    tried = "it works with the orientation free, or with the position before it (priority), or scaled by 0.4"
    assert f"elbow_pitch at its limit; {tried}" in run.message
    data = json.loads(json.dumps(run.to_dict()))["reach"]
    assert data["joints"] == ["elbow_pitch"] and data["length"] == pytest.approx(0.2) and not data["whole"]
    assert ik.track(arm, ref, q0=arm.home, priority="position").success
    good = ik.track(arm, straight(arm, (0.05, 0, 0)), q0=arm.home)
    assert good.success and good.reach is None and good.to_dict()["reach"] is None


@pytest.mark.parametrize(("path", "option", "size"), [("line", "--length", "0.6"), ("circle", "--radius", "0.9")])
def test_the_command_and_the_message_suggest_the_same_size(path, option, size, run):
    code, out, _ = run("track", "panda", "--path", path, option, size, "--rate", "20", "--json")
    told = json.loads(out)
    factor = float(told["message"].split("scaled by ")[1].split()[0])
    found = next(float(works.split()[1]) for works in told["works"] if works.startswith(option))
    assert code == 1 and found == pytest.approx(factor * float(size), rel=1e-2)
    if path == "line":  # with room to the end of what can be reached
        assert found <= 0.95 * told["reach"]["reached"]


def test_a_start_out_of_reach_and_a_turn_too_far(arm):
    far = arm.fk(arm.home).homogeneous
    far[:3, 3] *= 10.0
    found, words = explain(arm, ik.line(far, far @ ik.pose((0.1, 0, 0), rpy=(0, 0, 0)), duration=1.0), arm.home)
    assert found.until == 0 and found.stop == 0.0 and "its start is out of reach" in words
    T = arm.fk(arm.home).homogeneous
    turn = survey(arm, ik.line(T, T @ ik.pose((0, 0, 0), rpy=(0, 2.0, 0)), duration=5.0), arm.home)
    assert turn.turning and "deg of 115 deg" in turn.message


def test_another_start_is_found_where_the_elbow_has_to_be_on_the_other_side():
    robot = ik.Robot.load("planar_2r")
    q0 = np.array([2.51234, -0.81234])  # the first joint ends at 2.618
    p = robot.fk(q0).translation
    ref = line_of(robot, q0, 0.4 * np.cross((0, 0, 1), p / np.linalg.norm(p)), 5.0, "constant", free=True)
    found, words = explain(robot, ref, q0)
    assert found.joints == ("joint_1",) and "from q0 = [" in words and "priority" not in words
    other = [float(x) for x in words.split("q0 = [")[1].split("]")[0].split(",")]
    assert other[1] > 0.0 and ik.track(robot, ref, q0=other, position_tolerance=5e-5).success


def test_several_tips_get_a_path_each():
    tree = ik.Tree.load("brokk_hydrolek", tips=["left_tip", "right_tip"])
    motion = joint_motion(tree)
    assert set(motion) == set(tree.tips) and survey(tree, motion, tree.home).whole


@pytest.mark.parametrize("end", ["lower", "upper"])
def test_joints_at_a_limit_swing_away_from_it(end):
    robot = ik.Robot.load("planar_2r")
    q0 = getattr(robot, end)
    assert survey(robot, joint_motion(robot, q0), q0).whole


def test_what_is_asked_for_is_kept(arm):
    q0 = arm.home + 0.05
    motion = joint_motion(arm, q0, position_only=True, duration=4.0)
    assert motion.position_only and motion.duration == 4.0
    assert np.allclose(motion.target(0.0), arm.fk(q0).translation) and np.allclose(
        motion.target(4.0), motion.target(0.0)
    )
    assert np.allclose(draw("line", (1, 0, 0), 0.5).target(1e9), (1.5, 0, 0))  # also from a place in whole metres
    with pytest.raises(InvalidOption, match="Did you mean 'circle'"):
        draw("circel", np.eye(4), 0.1)


def test_an_arm_that_cannot_move_holds_still():
    robot = ik.Robot.load(
        '<robot name="stiff"><link name="base"/><link name="hand"/><joint name="j" type="revolute"><parent link="base"/>'
        '<child link="hand"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/><limit lower="0" upper="0" velocity="1" effort="1"/>'
        "</joint></robot>"
    )
    run = ik.track(robot, joint_motion(robot), q0=robot.home)
    assert run.success and not np.ptp(run.q)


def test_the_eight_is_in_its_plane():
    ref = eight(ik.pose((0.3, 0.2, 0.5), rpy=(0.1, 0.2, 0.3)), 0.07, (0.2, -0.5, 1.0), turns=2.0, duration=3.0)
    n = np.array([0.2, -0.5, 1.0]) / np.linalg.norm([0.2, -0.5, 1.0])
    assert np.abs((ref.at(np.linspace(0.2, 2.8, 7))[0][:, :3, 3] - (0.3, 0.2, 0.5)) @ n).max() < 1e-12


def test_the_command_says_how_far_and_what_works(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    words = "track hydrolek_7w --path line --length 0.2".split()
    code, out, err = run(*words)
    stop = "reachable up to 91.4 mm of 200 mm: elbow_pitch at its limit"
    assert code == 1 and f"{stop}; works with --position-only or --length 0.08" in err
    assert max(map(len, out.splitlines())) <= 80
    tried = json.loads(run(*words, "--json")[1])["works"]
    assert len(tried) == 4 and "--priority position" in tried
    for option in tried:  # what is said to work does
        assert run(*words, *option.split())[0] == 0, option
    fast = "track cartesian_pp --radius 0.3 --duration".split()
    code, _, said = run(*fast, "0.05")
    assert code == 1 and "not at this speed; works with --duration" in said
    assert run(*fast, said.split("--duration ")[1].split()[0])[0] == 0


def test_the_command_swings_the_joints_where_no_path_is_given(arm, run):
    for words in ((), ("--q0", *(f"{x:g}" for x in arm.home + 0.05)), ("--duration", "5")):
        code, out, _ = run("track", "hydrolek_7w", *words)
        assert code == 0 and "(chosen)" in " ".join(out.split())
    code, out, _ = run("track", "hydrolek_7w", "--json", "--position-only")
    shown = json.loads(out)
    assert code == 0 and "from home" in shown["path_chosen"] and "orientation free" in shown["path"]
    for words in ("--axis 0 0 1", "--radius 0.05", "--path circle"):
        out = run("track", "hydrolek_7w", "--json", *words.split())[1]
        assert json.loads(out)["path"].startswith("circle in 10 s")


@pytest.mark.parametrize("mode", ["leave", "slow"])
def test_what_is_said_to_work_does_with_the_same_options(mode, run):
    """A path that can be reached may be too fast for a run that does not slow down."""
    path = "--path eight --rate 50 --duration 3.2 --axis 0 0 1 --law constant --on-limit".split()
    code, out, _ = run("track", "hydrolek_7w", *path, mode, "--radius", "0.331", "--json")
    works = json.loads(out)["works"]
    assert code == 1 and works == ["--radius 0.0828" if mode == "slow" else "--radius 0.0331"]
    assert run("track", "hydrolek_7w", *path, mode, *works[0].split())[0] == 0


def test_the_orientation_of_a_path_from_a_file_can_be_left_free(arm, tmp_path, run):
    T = arm.fk(arm.home).homogeneous
    quat, rows = "{:.9g},{:.9g},{:.9g},{:.9g}".format(*pin.Quaternion(T[:3, :3]).coeffs()), []
    for k, x in enumerate(np.linspace(0.0, 0.05, 6)):
        rows.append("{:.9g},{:.9g},{:.9g},{:.9g},".format(float(k), *(T[:3, 3] + (0.0, x, 0.0))) + quat)
    (tmp_path / "p.csv").write_text("\n".join(["t,x,y,z,qx,qy,qz,qw", *rows]))
    for more, posed in ([], True), (["--position-only"], False):
        code, out, _ = run("track", "hydrolek_7w", "--path", tmp_path / "p.csv", "--json", *more)
        assert code == 0 and ("orientation" in json.loads(out)["figures"]) is posed


@DATA
@pytest.mark.slow
def test_every_robot_of_the_list_follows_its_default_path(run):
    from ik_toolkit.robot.library import list_robots

    for entry in list_robots():
        assert run("track", entry.name)[0] == 0, entry.name
