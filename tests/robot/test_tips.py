"""Guessed tips: by the names that arm descriptions use, never between two equally likely ones."""

import json
import logging

import pytest
from robots import branches, have_data, joint

import ik_toolkit as ik
from ik_toolkit.cli import main
from ik_toolkit.errors import FrameNotFound
from ik_toolkit.robot.library import DATA_ROBOTS, find
from ik_toolkit.robot.load import read_source
from ik_toolkit.robot.tips import guess_tip, words


@pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed")
@pytest.mark.parametrize("name", DATA_ROBOTS)
def test_tips_of_example_robot_data_are_guessed(name):
    """The rows of the library name their tips by hand; the guess knows nothing of them."""
    entry = find(name)
    assert guess_tip(read_source(str(entry.path), ())[1]["model"]).tips == entry.tips


TWO = (joint("j1", "revolute", "o", "a"), joint("j2", "revolute", "a", "b"))


def arm(*ends):
    """Two joints, then frames fixed to the last link; an end 'NAME/JOINT' is moved by a joint of its own."""
    cut = [end.partition("/") for end in ends]
    fixed = [joint(moved or f"{name}_fixed", "revolute" if moved else "fixed", "b", name) for name, _, moved in cut]
    return branches(*TWO, *fixed)


@pytest.mark.parametrize(
    ("ends", "tip"),
    [
        (("flange", "tool0", "camera_optical"), "tool0"),
        (("myToolTCP", "tool0"), "myToolTCP"),
        (("ee_link", "wrist_ft_tool"), "ee_link"),
        (("gripper_base", "left_finger/f1", "right_finger/f2"), "gripper_base"),
        (("hand_camera_link", "l_hand"), "l_hand"),
        (("whatever",), "whatever"),
        (("wrist_imu", "b_inertia"), "b"),
        (("lidar_optical/turret",), "lidar_optical"),
    ],
)
def test_conventions(ends, tip, caplog):
    with caplog.at_level(logging.WARNING, logger="ik_toolkit"):
        assert ik.Robot.load(arm(*ends)).tip == tip
    assert (f"using tip '{tip}'" in caplog.text) == (len(ends) > 1)


def test_what_carries_the_only_sensor_is_the_tip(caplog):
    camera = joint("camera", "fixed", "b", "camera_link") + joint("eye", "fixed", "camera_link", "camera_optical_frame")
    eye = branches(*TWO, camera)
    assert ik.Robot.load(eye).tip == "b" and "using tip 'b'" in caplog.text


def test_equal_ends_are_not_guessed_between():
    said = "several likely tips: left_tool, right_tool; choose one with tip="
    with pytest.raises(FrameNotFound, match=said) as caught:
        ik.Robot.load(arm("left_tool/l", "right_tool/r", "camera"))
    assert caught.value.tips == ("left_tool", "right_tool", "camera")
    many = arm(*(f"end{i}/e{i}" for i in range(40)))
    with pytest.raises(FrameNotFound, match="end0, end1, end10 or 37 more") as caught:
        ik.Robot.load(many)
    assert len(str(caught.value)) < 200


def scene(count, *things, more=""):
    """An arm of `count` joints that ends in link `seg`, and things of a scene (name, joint type) beside it."""
    links = ["world", *(f"l{i}" for i in range(count - 1)), "seg"]
    joints = [joint(f"j{i}", "revolute", links[i], links[i + 1]) for i in range(count)]
    joints += [joint(f"{name}_joint", kind, "world", name) for name, kind in things]
    return branches(*joints, more, root="world", name="scene")


@pytest.mark.parametrize(
    "things",
    [
        [("crate", "floating")],
        [("box", "floating"), ("gripper_box", "planar"), ("hand_tool", "floating")],
        [("target", "fixed"), ("lidar_link", "revolute"), ("door", "revolute")],
        [("camera2", "prismatic"), ("lidar_tcp", "revolute"), ("goal_tool", "revolute")],
    ],
)
def test_things_of_a_scene_are_no_tips(things):
    for load in (ik.Robot.load, ik.Robot.from_urdf):
        assert load(scene(5, *things)).tip == "seg"


def test_a_robot_on_a_floating_base_keeps_its_tip():
    floats = joint("f", "floating", "o", "base")
    text = branches(floats, joint("j1", "revolute", "base", "a"), joint("j2", "revolute", "a", "hand"))
    assert ik.Robot.load(text).tip == "hand" and ik.Robot.load(text, base_limits=(-1, 1)).n == 8
    assert any("joint 'f' is held still and poses are given in 'base'" in note for note in ik.Robot.load(text).notes)
    assert any("joint 'f' is held" in note for note in ik.Tree.load(text, tips=["hand"]).notes)
    assert not ik.Robot.load(text, base_limits=(-1, 1)).notes
    assert ik.Robot.load(branches(floats), base_limits=(-1, 1)).tip == "base"


def test_a_sensor_of_one_joint_is_no_tip_of_two_arms():
    joints = [joint("waist", "revolute", "o", "torso")]
    joints += [joint(name, "fixed", "torso", f"{name}_link") for name in ("lidar", "pole")]
    for side in ("left", "right"):
        joints.append(joint(f"{side}_a", "revolute", "torso", f"{side}_upper"))
        joints.append(joint(f"{side}_b", "revolute", f"{side}_upper", f"{side}_force_sensor"))
    with pytest.raises(FrameNotFound, match="several likely tips: left_force_sensor, right_force_sensor"):
        ik.Robot.load(branches(*joints))


def test_the_tips_listed_are_the_known_ones_and_those_that_can_be_loaded(tmp_path, capsys):
    assert main(["info", "brokk_hydrolek", "--list-tips", "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)["tips"]) == {"left_tip", "right_tip", "left_jaw", "right_jaw"}
    file = tmp_path / "scene.urdf"
    file.write_text(branches(*TWO, joint("free", "floating", "o", "thing")))
    assert main(["info", str(file), "--list-tips", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["tips"] == ["b"]


def test_joints_are_tips_too():
    robot = ik.Robot.load(arm("tool0"), tip="j2")
    assert robot.n == 2 and ik.Robot.load(arm("tool0"), tip="b").fk([0.3, 0.4]).isApprox(robot.fk([0.3, 0.4]))


def test_words():
    assert words("l_gripperTool0-Frame") == ["l", "gripper", "tool0", "frame"]
    assert words("panda_hand_TCP") == ["panda", "hand", "tcp"]


def test_sensors_and_targets_are_no_tips_where_all_ends_have_names_of_parts():
    """Parts of a hand come before things of a scene: neither has the name of a tool."""
    ends = joint("tip", "fixed", "seg", "fingertip") + joint("eye", "fixed", "seg", "camera")
    assert ik.Robot.load(scene(2, ("target", "prismatic"), ("lidar", "revolute"), more=ends)).tip == "fingertip"
