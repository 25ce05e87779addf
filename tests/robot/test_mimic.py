"""Mimic joints in any order and with any names: kinematics by the second FK, and followers that cannot be tied."""

import numpy as np
import pytest
from robots import branches, filled, joint, tie
from second_fk import SecondFK, pose_errors

import ik_toolkit as ik
from ik_toolkit.errors import JointNotFound, ModelError
from ik_toolkit.robot.formats.urdf_check import check_urdf

# Two fingers on a turning hand; the thumb leads, and its branch comes after the index finger's in the order of the names.
HAND = branches(
    joint("wrist", "revolute", "palm0", "palm"),
    joint("a_index", "revolute", "palm", "index", axis="0 1 0", mimic=tie("thumb", 0.5, 0.1)),
    joint("a_nail", "revolute", "index", "nail", axis="0 1 0", mimic=tie("a_index", -2)),
    joint("thumb", "revolute", "palm", "thumb_link", axis="1 0 0", xyz="0.1 0 0.2"),
    joint("thumb_2", "prismatic", "thumb_link", "thumb_end", mimic=tie("thumb", 0.03)),
    root="palm0",
    name="hand",
)


def check_fk(text, tip):
    robot, judge, rng = ik.Robot.load(text, tip=tip), SecondFK(text, tip=tip), np.random.default_rng(1)
    Q = np.array([robot.random_q(rng) for _ in range(20)])
    position, angle = pose_errors(np.array([robot.fk(q).homogeneous for q in Q]), judge.fk(Q, robot.joint_names))
    assert position.max() < 1e-12 and angle.max() < 1e-12
    assert ik.solve(robot, robot.fk(Q[0]).translation).success
    return robot


@pytest.mark.parametrize("tip", ["nail", "thumb_end"])
def test_leaders_may_come_after_their_followers(tip):
    assert check_fk(HAND, tip).joint_names == ("wrist", "thumb")


def test_names_are_those_of_the_file():
    model = ik.Robot.load(HAND, tip="nail").model
    assert sorted(model.names[1:]) == ["a_index", "a_nail", "thumb", "thumb_2", "wrist"]
    assert {"wrist", "thumb"} <= {frame.name for frame in model.frames}


def test_two_branches_that_lead_each_other():
    """No order has both leaders first, so one pair changes roles: the tie is the same line."""
    text = branches(
        joint("a1", "revolute", "o", "a"),
        joint("a2", "revolute", "a", "aa", axis="0 1 0", mimic=tie("b1", 2, 0.1)),
        joint("b1", "revolute", "o", "b"),
        joint("b2", "revolute", "b", "bb", axis="0 1 0", mimic=tie("a1", -0.5, 0.2)),
    )
    assert check_urdf(text) == []
    assert check_fk(text, "aa").joint_names == ("a1", "a2")
    assert check_fk(text, "bb").joint_names == ("a2", "a1")


def test_a_follower_may_carry_its_leader():
    """It leads then, and the limits are those of all of them: |elbow| <= 0.5 holds shoulder = 0.1 - 2 elbow and the slide."""

    def carrier(limits):
        return branches(
            joint("shoulder", "revolute", "o", "a", mimic=tie("elbow", -2, 0.1)),
            joint("yaw", "revolute", "a", "b", axis="0 1 0"),
            joint("elbow", "revolute", "b", "c", axis="1 0 0", limits=limits),
            joint("slide", "prismatic", "c", "d", mimic=tie("elbow", 0.3, 0.02)),
        )

    assert check_fk(carrier((-2.0, 2.0)), "d").joint_names == ("shoulder", "yaw")
    robot = ik.Robot.load(carrier((-0.5, 0.5)), tip="d")
    assert robot.lower[0] == pytest.approx(-0.9) and robot.upper[0] == pytest.approx(1.1)


@pytest.mark.parametrize(
    ("leader", "why"),
    [
        ("nobody", "mimics joint 'nobody', which does not exist"),
        ("a_index", "mimics itself through 'a_index'"),
        ("a_nail", "mimics itself through 'a_nail'"),
        ("fixed", "mimics joint 'fixed', which is fixed"),
    ],
)
def test_followers_that_cannot_be_tied_matter_on_the_path_only(leader, why):
    text = HAND.replace(tie("thumb", 0.5, 0.1), f'<mimic joint="{leader}"/>')
    text = text.replace("</robot>", joint("fixed", "fixed", "palm", "plate") + "</robot>")
    assert ik.Robot.load(text, tip="thumb_end").joint_names == ("wrist", "thumb")
    with pytest.raises(ModelError, match=f"joint 'a_index' .* {why}"):
        ik.Robot.load(text, tip="nail")
    after = "mimics itself through 'a_index'" if leader == "a_nail" else f"mimics joint 'a_index', which {why}"
    with pytest.raises(ModelError, match=f"joint 'a_nail' .* {after}"):
        ik.Robot.load(text, base="index", tip="nail")


def test_limits_the_wrong_way_round_matter_on_the_path_only():
    bent = joint("bent", "revolute", "palm", "bent_link", limits=(1.0, -1.0))
    text = HAND.replace("</robot>", bent + "</robot>")
    assert ik.Robot.load(text, tip="thumb_end").n == 2
    with pytest.raises(ModelError, match="joint 'bent' has no legal position"):
        ik.Robot.load(text, tip="bent_link")


def test_a_follower_narrows_its_leader_and_never_widens_it():
    """Each limit of the leader is the narrowest of its own and those of the followers on the path, seen through their ties."""

    def ends(*followers):
        parts = [joint("lead", "revolute", "o", "l0", limits=(-1.0, 1.5))]
        for k, (kind, ratio, offset, limits) in enumerate(followers):
            mimic = tie("lead", ratio, offset)
            parts.append(joint(f"f{k}", kind, f"l{k}", f"l{k + 1}", axis="0 1 0", limits=limits, mimic=mimic))
        robot = ik.Robot.load(branches(*parts), tip=f"l{len(followers)}")
        return robot.lower[0], robot.upper[0]

    wide, low = ("revolute", 2.0, 0.1, (-9.0, 9.0)), ("revolute", -2.0, 0.1, (-0.5, 0.9))
    assert ends(wide) == (-1.0, 1.5)
    assert ends(("continuous", 2.0, 0.1, None)) == (-1.0, 1.5)
    assert ends(low) == pytest.approx((-0.4, 0.3), abs=1e-15)  # 0.1 - 2 q between -0.5 and 0.9
    assert ends(wide, low) == ends(low, wide) == ends(low)
    slide = ("prismatic", 0.1, 0.05, (0.03, 0.2))
    assert ends(slide) == pytest.approx((-0.2, 1.5), abs=1e-15)
    assert ends(low, slide) == pytest.approx((-0.2, 0.3), abs=1e-15)


def test_followers_that_leave_their_leader_no_position_are_named():
    text = branches(
        joint("lead", "revolute", "o", "a", limits=(-1.0, 1.0)),
        joint("high", "revolute", "a", "b", limits=(0.5, 1.0), mimic=tie("lead", 2)),
        joint("low", "revolute", "b", "c", limits=(-0.5, 0.1), mimic=tie("lead")),
        joint("free", "revolute", "c", "d", limits=(-9.0, 9.0), mimic=tie("lead")),
    )
    with pytest.raises(ModelError, match="joint 'lead' has no legal position: lower limit -1, upper limit 1") as caught:
        ik.Robot.load(text)
    for said in ("'high' (0.5 to 1) from 0.25 to 0.5", "'low' (-0.5 to 0.1) from -0.5 to 0.1"):
        assert said in str(caught.value)
    with pytest.raises(ModelError, match="joint 'lead' has no legal position"):  # 'low' moves with it all the same
        ik.Robot.load(text, tip="b")
    assert ik.Robot.load(text.replace('upper="0.1"', 'upper="0.4"'), tip="b").upper[0] == 0.4


def test_a_follower_held_outside_its_limits_is_said():
    """With the multiplier 0 it stands at its offset wherever its leader is, and narrows nothing."""
    held = joint("held", "revolute", "a", "b", limits=(0.5, 1.0), mimic=tie("lead", 0, 0.2))
    text = branches(joint("lead", "revolute", "o", "a"), held)
    said = "joint 'held' stays at 0.2, outside its limits: its multiplier of 'lead' is 0"
    assert ik.Robot.load(text, tip="b").notes == (said,)
    assert not ik.Robot.load(text.replace('offset="0.2"', 'offset="0.7"'), tip="b").notes


def test_a_mesh_scale_that_is_none_and_a_missing_name_do_not_stop_a_robot():
    shape = '<visual><geometry><mesh filename="a.stl" scale="1 1"/></geometry></visual>'
    text = filled(HAND, {"index": shape}).replace(' name="hand"', "")
    check_fk(text, "nail")
    assert any('scale="1 1"' in str(f) for f in check_urdf(text))


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("limit", ["", "<limit/>", '<limit effort="1" velocity="0"/>', '<limit velocity="fast"/>'])
def test_a_follower_without_limits_of_its_own_leaves_its_leader_its_range(kind, limit):
    """On the path or off it: fingers of grippers are often written so."""
    finger = joint("finger", "continuous", "a", "b", mimic=tie("lead", -1) + limit)  # which writes no limit
    text = branches(joint("lead", "revolute", "o", "a", limits=(-1.0, 1.5)), finger.replace("continuous", kind))
    for tip in ("a", "b"):
        robot = ik.Robot.load(text, tip=tip)
        assert (robot.lower[0], robot.upper[0], robot.velocity_limits[0]) == (-1.0, 1.5, 2.0)
    (told,) = (finding for finding in check_urdf(text) if "moves as far as its leader does" in finding.problem)
    assert told.severity == "warning" and told.element == "joint 'finger'"


def test_a_follower_that_holds_its_leader_is_said_when_the_robot_is_loaded():
    finger = joint("finger", "revolute", "a", "c", limits=(0.0, 0.0), mimic=tie("lead"))
    text = branches(joint("lead", "revolute", "o", "a"), joint("next", "revolute", "a", "b"), finger)
    robot = ik.Robot.load(text, tip="b")
    assert robot.lower[0] == robot.upper[0] == 0.0
    assert any("holds joint 'lead', which it mimics" in note for note in robot.notes)


def test_a_leader_that_its_follower_narrows_is_named_with_it():
    """In the notes, and where a solve ends at that limit; followers that narrow nothing are not."""
    text = branches(
        joint("lead", "revolute", "o", "a", xyz="0 0 0", limits=(-1.5, 1.5)),
        joint("tight", "revolute", "a", "b", axis="1 0 0", limits=(-9.0, 0.5), mimic=tie("lead", 2)),
        joint("wide", "revolute", "a", "c", axis="0 1 0", limits=(-9.0, 9.0), mimic=tie("lead", -1)),
        joint("end", "fixed", "a", "tip", xyz="1 0 0"),
    )
    robot = ik.Robot.load(text, tip="tip")
    within, fast = robot.notes
    assert (
        "joint 'lead' is kept within -1.5 to 0.25 rad" in within and "'tight' (-9 to 0.5) from -4.5 to 0.25" in within
    )
    assert "'wide'" not in within
    assert fast == "joint 'lead' moves at 1 rad/s at most: 'tight', which mimics it, has a limit of 2"
    assert robot.velocity_limits[0] == 1.0
    assert "joint limits (lead with its follower tight) block" in ik.solve(robot, [0.0, 1.0, 0.0], solver="lm").message
    assert "joint limits (lead) block" in ik.solve(robot, [-1.0, 0.0, 0.0], solver="lm").message
    loose = text.replace('upper="0.5"', 'upper="9"').replace(
        'velocity="2"/><mimic joint="lead" multiplier="2"', 'velocity="4"/><mimic joint="lead" multiplier="2"'
    )
    assert ik.Robot.load(loose, tip="tip").notes == ()


def test_of_a_follower_the_joint_that_it_follows_is_named():
    robot = ik.Robot.load(HAND, tip="nail")
    for call in (lambda: robot.locked({"a_index": 0.1}), lambda: robot.narrowed({"a_nail": (0.0, 0.1)})):
        with pytest.raises(JointNotFound, match=r"\. It follows 'thumb': give that joint instead\.$"):
            call()
