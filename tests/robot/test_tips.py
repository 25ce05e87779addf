"""Guessed tips: by the names that arm descriptions use, never between two equally likely ones."""

import logging

import pytest
from robots import joint

import ik_toolkit as ik
from ik_toolkit.errors import FrameNotFound
from ik_toolkit.robot.library import DATA_ROBOTS, find
from ik_toolkit.robot.load import read
from ik_toolkit.robot.tips import guess_tip, words


@pytest.mark.parametrize("name", DATA_ROBOTS)
def test_tips_of_example_robot_data_are_guessed(name):
    """The rows of the library name their tips by hand; the guess knows nothing of them."""
    pytest.importorskip("yourdfpy")
    entry = find(name)
    assert guess_tip(read(str(entry.path), ())[1]["model"]).tips == entry.tips


def arm(*ends):
    """Two joints, then frames fixed to the last link; an end 'NAME/JOINT' is moved by a joint of its own."""
    text = '<robot name="arm"><link name="o"/>' + joint("j1", "revolute", "o", "a") + joint("j2", "revolute", "a", "b")
    for end in ends:
        name, _, moved = end.partition("/")
        text += joint(moved or f"{name}_fixed", "revolute" if moved else "fixed", "b", name)
    return text + "</robot>"


@pytest.mark.parametrize(
    ("ends", "tip"),
    [
        (("flange", "tool0", "camera_optical"), "tool0"),
        (("myToolTCP", "tool0"), "myToolTCP"),
        (("ee_link", "wrist_ft_tool"), "ee_link"),
        (("gripper_base", "left_finger/f1", "right_finger/f2"), "gripper_base"),
        (("hand_camera_link", "l_hand"), "l_hand"),
        (("whatever",), "whatever"),
    ],
)
def test_conventions(ends, tip, caplog):
    with caplog.at_level(logging.WARNING, logger="ik_toolkit"):
        assert ik.Robot.load(arm(*ends)).tip == tip
    assert (f"using tip '{tip}'" in caplog.text) == (len(ends) > 1)


def test_equal_ends_are_not_guessed_between():
    with pytest.raises(
        FrameNotFound, match="several likely tips: left_tool, right_tool; choose one with tip="
    ) as caught:
        ik.Robot.load(arm("left_tool/l", "right_tool/r", "camera"))
    assert caught.value.tips == ("left_tool", "right_tool", "camera")
    many = arm(*(f"end{i}/e{i}" for i in range(40)))
    with pytest.raises(FrameNotFound, match="end0, end1, end10 or 37 more") as caught:
        ik.Robot.load(many)
    assert len(str(caught.value)) < 200


def test_joints_are_tips_too():
    robot = ik.Robot.load(arm("tool0"), tip="j2")
    assert robot.n == 2 and ik.Robot.load(arm("tool0"), tip="b").fk([0.3, 0.4]).isApprox(robot.fk([0.3, 0.4]))


def test_words():
    assert words("l_gripperTool0-Frame") == ["l", "gripper", "tool0", "frame"]
    assert words("panda_hand_TCP") == ["panda", "hand", "tcp"]
