"""SRDF: its contents, where it is found, and broken or hostile files."""

import pickle
import re

import numpy as np
import pytest
from folders import DATA
from refusals import refuses
from robots import ball, branches, filled, have_data, joint, urdf
from second_fk import SecondFK
from srdf_arm import ARM, SAMPLED, SRDF

import ik_toolkit as ik
from ik_toolkit.errors import ConfigurationNotFound, FrameNotFound, InvalidOption, ModelError
from ik_toolkit.robot.formats.srdf import read_srdf
from ik_toolkit.robot.geometry.self_collision import self_collision

BAD = DATA / "bad_urdf"


def robot(inside, **options):
    return ik.Robot.load(ARM, srdf=f'<robot name="arm">\n{inside}\n</robot>', **options)


@pytest.fixture
def arm():
    return ik.Robot.load(ARM, srdf=SRDF)


def test_named_configurations(arm):
    assert arm.joint_names == ("j0", "j1", "j2", "j3") and arm.locked_joints == {"j4": 0.0}  # j4 is passive
    assert set(arm.named) == {"up", "home"}  # no joint of this robot is in "far"
    assert arm.named["up"].tolist() == [0.1, 0.2, 0.3, arm.home[3]] and np.array_equal(arm.named["home"], arm.home)
    with pytest.raises(ConfigurationNotFound, match="Did you mean 'home'"):
        arm.named["hme"]
    arm.named["up"][0] = 9.0  # a copy
    assert arm.named["up"][0] == 0.1 and pickle.loads(pickle.dumps(arm)).named["up"][0] == 0.1
    assert arm.locked({"j1": 0.5}).named["up"].tolist() == [0.1, 0.3, arm.home[3]]
    tree = ik.Tree.load(ARM, tips=["l3", "l4"], srdf=SRDF)
    assert tree.named["up"][:3].tolist() == [0.1, 0.2, 0.3] and tree.srdf == arm.srdf


def test_a_robot_without_one_has_its_home():
    arm = ik.Robot.load(ARM)
    assert set(arm.named) == {"home"} and not arm.srdf.groups
    assert robot('<group_state name="home"><joint name="j2" value="1"/></group_state>').named["home"][2] == 1.0


def test_remarks_say_what_is_not_in_the_robot(arm, caplog):
    said = " ".join(arm.srdf.against(arm.model))
    for word in ("'root_joint'", "'elsewhere'", "'strange'", "configuration 'far'"):
        assert word in said
    ik.Robot.load(ARM, srdf=SRDF)
    assert "'strange'" in caplog.text  # of one that was asked for
    several = '<group_state name="s"><joint name="j1" value="1 2"/><joint name="j2" value="0.5"/></group_state>'
    found = robot(several)
    assert found.named["s"][1] == found.home[1] and found.named["s"][2] == 0.5
    assert "joint 'j1' with several values is ignored" in found.srdf.against(found.model)[0]
    tied = robot('<virtual_joint name="v" type="fixed" parent_frame="world" child_link="l0"/><passive_joint name="v"/>')
    assert not tied.srdf.against(tied.model)


LOST = '<group name="g"><chain base_link="l0" tip_link="l44"/></group>'


@pytest.mark.parametrize(
    ("inside", "remark"),
    [
        ('<passive_joint name="j44"/>', "passive joints: joint 'j44' is not in the robot. Did you mean 'j4'?"),
        ('<group name="g"><joint name="j0"/><joint name="jl"/></group>', "groups: joint 'jl' is not in the robot"),
        ('<group name="g"><link name="l0"/><link name="m1"/></group>', "groups: link 'm1' is not in the robot"),
        (LOST, "link 'l44' is not in the robot. Did you mean 'l4'?"),
        (
            '<group_state name="s"><joint name="jj1" value="0"/></group_state>',
            "joint 'jj1' is not in the robot. Did you mean 'j1'?",
        ),
        (
            '<group_state name="up"><joint name="j1" value="90"/><joint name="j2" value="1.5004"/></group_state>',
            "configuration 'up': joint 'j1' is outside the limits",
        ),
    ],
)
def test_names_and_values_that_the_robot_cannot_have_are_said(inside, remark, caplog):
    robot(inside)
    assert remark in caplog.text


def state(group, **values):
    inside = "".join(f'<joint name="{joint}" value="{value}"/>' for joint, value in values.items())
    return f'<group_state name="ready" group="{group}">{inside}</group_state>'


CHAIN = '<group name="{0}"><chain base_link="l0" tip_link="{1}"/></group>'
SEVERAL = CHAIN.format("short", "l2") + CHAIN.format("long", "l4") + CHAIN.format("other", "l4")


def test_a_configuration_belongs_to_its_group():
    both = SEVERAL + state("short", j0=0.1, j1=0.2) + state("long", j0=0.5, j1=0.6, j2=0.7)
    short, long = (robot(both, group=group) for group in ("short", "long"))
    assert short.named["ready"].tolist() == [0.1, 0.2]
    assert long.named["ready"].tolist() == [0.5, 0.6, 0.7, *long.home[3:]]
    assert not long.srdf.remarks and long.srdf.group == "long"
    assert pickle.loads(pickle.dumps(long)).named["ready"][0] == 0.5
    apart = SEVERAL + state("long", j0=0.1) + state("other", j1=0.3)
    for text, asked, ready in (
        # Without a group: the one that ends in the tip, then the one that sets more joints, then the first.
        (both, {"tip": "l2"}, [0.1, 0.2]),
        (both, {"tip": "l4"}, [0.5, 0.6, 0.7]),
        (both, {"tip": "l3"}, [0.5, 0.6, 0.7]),
        (SEVERAL + state("long", j0=0.1) + state("other", j0=0.2), {"tip": "l4"}, [0.1]),
        (SEVERAL + state("long", j0=0.1) + state("other", j0=0.2), {"group": "other"}, [0.2]),
        # Values of two groups are never mixed, unless the groups share no joint.
        (SEVERAL + state("long", j0=0.1) + state("other", j0=0.2, j1=0.3), {"tip": "l4"}, [0.2, 0.3]),
        (apart, {"tip": "l4"}, [0.1, 0.3]),
        # The chosen group's own counts alone; one that it does not have is taken from the others.
        (apart, {"group": "long"}, [0.1, long.home[1]]),
        (SEVERAL + state("other", j1=0.3), {"group": "long"}, [long.home[0], 0.3]),
    ):
        assert robot(text, **asked).named["ready"][: len(ready)].tolist() == ready, asked


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        (' name="bad">\n<joint name="j0" value="1e999"/>', "joint 'j0' in line 3.*not a finite"),
        (' name="bad" group="g"><joint name="j0"/>', "of group 'g'.*not a finite number"),
        (' name="bad"><joint value="1"/>', "<joint> in line 2 of the SRDF has no name"),
        ('><joint name="j0" value="1"/>', "<group_state> in line 2 of the SRDF has no name"),
        (' name="bad"><joint name="j0" value="1"/><joint name="j0" value="2"/>', "two values"),
    ],
)
def test_a_bad_configuration_is_lost_alone(bad, why, caplog, tmp_path):
    text = f'<group_state{bad}</group_state><group_state name="good"><joint name="j1" value="0.5"/></group_state>'
    arm = robot(text)
    assert set(arm.named) == {"home", "good"} and arm.named["good"][1] == 0.5
    assert re.search(f"is left out: .*{why}|{why}", caplog.text)
    caplog.clear()
    (tmp_path / "arm.urdf").write_text(ARM)
    (tmp_path / "arm.srdf").write_text(f"<robot>\n{text}</robot>")
    assert set(ik.Robot.load(tmp_path / "arm.urdf").named) == {"home", "good"} and re.search(why, caplog.text)


def test_pairs_that_may_touch(arm):
    free, model = ik.CollisionModel(ik.Robot.load(ARM)), ik.CollisionModel(arm)
    assert ("l0", "l3") in free.pairs and ("l0", "l3") not in model.pairs and ("l0", "l2") in model.pairs
    assert model.allowed == {("l3", "l0"): "Never"}
    assert ("l0", "l3") not in pickle.loads(pickle.dumps(model)).pairs
    quiet = ik.CollisionModel(
        robot('<disable_default_collisions link="l0"/><enable_collisions link1="l4" link2="l0"/>')
    )
    assert [pair for pair in quiet.pairs if "l0" in pair] == [("l0", "l4")]


def test_groups_are_bases_and_tips():
    upper = ik.Robot.load(ARM, srdf=SRDF, group="upper")
    assert (upper.base, upper.tip, upper.joint_names) == ("l1", "l4", ("j1", "j2", "j3"))
    listed = ik.Robot.load(ARM, srdf=SRDF, group="listed")  # the end effector is mounted behind its last joint
    assert (listed.base, listed.tip) == ("l0", "l5")
    plain = SRDF.replace('parent_group="listed"', "")
    assert ik.Robot.load(ARM, srdf=plain, group="listed").tip == "l3"
    links = '<group name="g"><link name="l2"/><link name="l3"/></group>'
    assert robot(links, group="g").joint_names == ("j1", "j2")
    assert ik.Robot.load(ARM, srdf=SRDF, group="listed", tip="l2").n == 2
    ring = '<group name="g"><group name="h"/></group><group name="h"><group name="g"/></group>'
    refuses(
        InvalidOption,
        (lambda: ik.Robot.load(ARM, srdf=SRDF, group="uper"), r"no group 'uper'\. Did you mean 'upper'"),
        (lambda: robot(ring, group="g"), "no chain or moving joint"),
        (lambda: robot(LOST, group="g"), r"group 'g' .*: the robot has no 'l44'\. Did you mean 'l4'\?"),
        (lambda: robot('<group name="g"><joint name="j99"/></group>', group="g"), "the robot has no 'j99'"),
    )
    both = '<group name="g"><chain base_link="l0" tip_link="l4"/><chain base_link="l0" tip_link="l5"/></group>'
    with pytest.raises(FrameNotFound, match=r"Tree.load\(source, group='g'\): l4, l5"):
        robot(both, group="g")
    assert ik.Tree.load(ARM, srdf=f"<robot>{both}</robot>", group="g").tips == ("l4", "l5")


def test_passive_joints_are_held():
    limits = ARM.replace('lower="-1.5"', 'lower="0.4"')
    held = ik.Robot.load(limits, srdf=SRDF)
    assert held.locked_joints == {"j4": 0.4}  # the legal value nearest to zero
    assert ik.Robot.load(ARM, srdf=SRDF, locked={"j4": 0.2}).locked_joints == {"j4": 0.2}
    every = "".join(f'<passive_joint name="j{k}"/>' for k in range(5))
    assert robot(every).n == 5  # nothing would be left to solve for


@pytest.mark.parametrize(("name", "joint"), [("inspection_7dof", "lift"), ("brokk_hydrolek", "turret")])
def test_a_passive_joint_of_a_shipped_robot_is_left_out_of_its_home(name, joint):
    load = ik.Robot.load if name == "inspection_7dof" else ik.Tree.load
    arm, held = load(name), load(name, srdf=f'<robot name="{name}"><passive_joint name="{joint}"/></robot>')
    assert held.joint_names == tuple(one for one in arm.joint_names if one != joint)
    assert held.home.tolist() == [x for x, one in zip(arm.home, arm.joint_names, strict=True) if one != joint]


def test_a_passive_joint_beside_the_path_rests_where_it_may_and_is_not_called_locked():
    """So does one without limits, and one that has several coordinates is left as it is."""
    text = branches(
        joint("a", "revolute", "l0", "l1", axis="0 1 0"),
        joint("free", "continuous", "l1", "l2", axis="1 0 0"),
        joint("b", "revolute", "l2", "l3", axis="0 1 0"),
        joint("low", "prismatic", "l1", "side", limits=(-0.3, -0.1)),
        joint("high", "revolute", "side", "end", limits=(0.4, 1.0)),
        '<link name="far"/><joint name="loose" type="floating"><parent link="l0"/><child link="far"/></joint>',
        root="l0",
    )
    passive = "".join(f'<passive_joint name="{name}"/>' for name in ("free", "low", "high", "loose", "nobody"))
    arm = ik.Robot.load(text, tip="l3", srdf=f'<robot name="r">{passive}</robot>')
    assert arm.joint_names == ("a", "b") and arm.locked_joints == {"free": 0.0}
    model = arm.model
    rests = {name: arm.rest[model.joints[model.getJointId(name)].idx_q] for name in ("low", "high")}
    assert rests == {"low": -0.1, "high": 0.4}
    q = [0.3, -0.5]
    judged = SecondFK(text, tip="l3").fk(np.array([[0.3, 0.0, -0.5]]), ("a", "free", "b"))
    assert np.abs(arm.fk(q).homogeneous - judged).max() < 1e-12
    turned = ik.Robot.load(text, tip="l3", srdf=f'<robot name="r">{passive}</robot>', locked={"free": 0.7, "high": 0.5})
    assert turned.locked_joints == {"free": 0.7, "high": 0.5} and turned.joint_names == ("a", "b")
    other = ik.Robot.load(text, tip="end", srdf=f'<robot name="r">{passive}</robot>')
    assert other.joint_names == ("a",) and other.locked_joints == {"low": -0.1, "high": 0.4}


def test_an_end_effector_may_be_on_a_link_with_the_name_of_a_joint():
    text = branches(
        joint("a", "revolute", "o", "a"), joint("b", "revolute", "a", "b"), joint("tool", "fixed", "b", "tool")
    )
    srdf = (
        '<robot name="r"><group name="arm"><joint name="a"/><joint name="b"/></group>'
        '<end_effector name="gripper" parent_link="tool" group="hand" parent_group="arm"/></robot>'
    )
    assert ik.Robot.load(text, srdf=srdf, group="arm").tip == "tool"


# ----------------------------------------------------------------------------------------------------------- where it lies
def test_it_is_found_beside_the_file(tmp_path):
    (tmp_path / "urdf").mkdir()
    file = tmp_path / "urdf" / "my_arm.urdf"
    file.write_text(ARM)

    def found():
        path = ik.Robot.load(file).srdf.path
        return path and str(path.relative_to(tmp_path))

    assert found() is None
    (tmp_path / "srdf").mkdir()
    # by the robot's name, the file's beginning, its name
    for place in ("srdf/other.srdf", "srdf/my.srdf", "urdf/my_arm.srdf"):
        (tmp_path / place).write_text(SRDF)
        assert found() == place
    assert ik.Robot.load(file, srdf=False).srdf.path is None
    assert ik.Robot.load(file, srdf=tmp_path / "srdf" / "my.srdf").srdf.path.name == "my.srdf"
    for k in range(2):  # two of the robot's name: neither
        (tmp_path / f"{k}").mkdir()
    for place in ("urdf/my_arm.srdf", "srdf/my.srdf"):
        (tmp_path / place).unlink()
    (tmp_path / "srdf" / "more.srdf").write_text(SRDF)
    assert found() is None


def test_one_beside_the_file_never_breaks_loading(tmp_path, caplog):
    (tmp_path / "arm.urdf").write_text(ARM)
    (tmp_path / "arm.srdf").write_text("<robot>\n<group/></robot>")
    arm = ik.Robot.load(tmp_path / "arm.urdf")
    assert arm.n == 5 and "is not used: <group> in line 2" in caplog.text and arm.srdf.remarks
    with pytest.raises(ModelError, match="line 2"):
        ik.Robot.load(tmp_path / "arm.urdf", srdf=tmp_path / "arm.srdf")
    (tmp_path / "arm.srdf").unlink()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "a.srdf").write_text(SRDF)
    (tmp_path / "arm.srdf").symlink_to(tmp_path / "out" / "a.srdf")  # a link out of the folder
    assert ik.Robot.load(tmp_path / "arm.urdf").srdf.path is None
    (tmp_path / "arm.srdf").unlink()
    (tmp_path / "arm.srdf").mkdir()
    assert ik.Robot.load(tmp_path / "arm.urdf").n == 5


@pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed")
def test_those_of_example_robot_data():
    panda = ik.Robot.load("panda")
    assert panda.srdf.path.name == "panda.srdf" and panda.named["default"][3] == -2.35619
    assert ik.Robot.load("panda", group="arm").tip == "panda_hand_tcp"
    assert ik.Robot.load("ur5").srdf.path.name == "ur5.srdf" and ik.Robot.load("ur10").srdf.path is None
    talos = ik.Tree.load("talos")
    model, Q = ik.CollisionModel(talos), talos.random_q(np.random.default_rng(0), 60)
    assert np.mean([model.collides(q) for q in Q]) < 0.4
    without = ik.CollisionModel(ik.Tree.load("talos", srdf=False))
    assert np.mean([without.collides(q) for q in Q[:20]]) > 0.6
    arms = ik.Tree.load("talos", group="all_arms_torso")
    assert (arms.base, arms.tips) == ("base_link", ("wrist_left_ft_tool_link", "wrist_right_ft_tool_link"))


# ------------------------------------------------------------------------------------------------------- broken and hostile
@pytest.mark.parametrize("file", sorted(BAD.glob("*.urdf")), ids=lambda file: file.stem)
def test_the_corpus_of_broken_urdfs(file):
    """Files that are not XML, not a robot or hostile are rejected in one sentence; other URDF rules do not apply to an SRDF."""
    text, said = file.read_bytes(), ""
    try:
        read_srdf(file)
    except ModelError as error:
        said = str(error)
        assert "\n" not in said and len(said) < 400
    hostile = any(word in text for word in (b"<!DOCTYPE", b"<!ENTITY")) or file.stem in (
        "truncated", "mismatched_tag", "not_xml", "html", "sdf", "empty", "latin1", "two_documents", "undefined_entity", "binary"
    )  # fmt: skip
    assert bool(said) or not hostile


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('<!DOCTYPE r [<!ENTITY a "b">]><robot/>', "DOCTYPE or entity"),
        ("<robot>" + "<a>" * 100, "nested more than 64 deep in line 1"),
        ("<robot>" + "<a/>" * 300_000, "more than 200,000 elements"),
        (f'<robot><group name="{"n" * 300}"/></robot>', "name of more than 255 characters in line 1"),
        ('<robot>\n<disable_collisions link1="a"/></robot>', "<disable_collisions> in line 2 of the SRDF has no link2"),
        ('<robot>\n\n<group><link name="a"/></group></robot>', "<group> in line 3 of the SRDF has no name"),
        ('<robot><group name="a"/>\n<group name="a"/></robot>', "group 'a' is defined twice in .*, again in line 2"),
        ("<sdf/>", "not an SRDF"),
        ("<robot><xacro:include/></robot>", "not well-formed|xacro macros"),
        ("<robot>", "not well-formed XML: no element found in line 1"),
        ("/nowhere/x.srdf", "there is no file"),
    ],
)
def test_refused_in_one_sentence(text, said):
    with pytest.raises(ModelError, match=said) as caught:
        ik.Robot.load(ARM, srdf=text)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400
    if text.startswith("/"):
        with pytest.raises(InvalidOption, match="srdf= takes"):
            ik.Robot.load(ARM, srdf=3)


# ------------------------------------------------------------------------------------------------------------- made here


def test_pairs_are_sampled():
    arm = ik.Robot.load(SAMPLED)
    found = self_collision(arm, samples=300, seed=3)
    assert found.reasons["l0", "l1"] == found.reasons["l3", "l4"] == "Adjacent"
    assert found.reasons["l2", "l4"] == "Always"  # balls of 0.4 and 0.32 m, at most 0.6 m apart
    assert found.tested == (("l0", "l2"), ("l0", "l3"), ("l0", "l4"), ("l1", "l4"))
    assert found.reasons["l1", "l3"] == "Never"  # 0.6 cos(1.25) = 0.19 m apart at least
    assert found.counts() == {"Adjacent": 4, "Always": 1, "Default": 0, "Never": 1}
    assert found.before == 1.0 and 0.0 < found.after < 1.0
    again = self_collision(arm, samples=300, seed=3)
    assert again == found and self_collision(arm, samples=300, seed=4).after != found.after
    made = ik.Robot.load(SAMPLED, srdf=found.to_srdf())
    assert made.srdf.disabled == found.reasons and made.srdf.name == "balls & <sticks>"
    assert set(ik.CollisionModel(made).pairs) == set(found.tested)
    alone = SAMPLED.replace("<collision>", "<visual>", 4).replace("</collision>", "</visual>", 4)
    with pytest.raises(ModelError, match="fewer than two links"):
        self_collision(ik.Robot.load(alone), 1)


def test_continuous_joints_are_sampled_over_the_whole_turn():
    """Two bars of 0.3 m fold until the balls at their ends are nearer than 0.2 m: at angles within 2 asin(1/3) of half a turn."""
    text = urdf(*[dict(kind="continuous", xyz=xyz) for xyz in ("0 0 0", "0.3 0 0")], dict(kind="fixed", xyz="0.3 0 0"))
    arm = ik.Robot.load(filled(text, {"l0": ball(0.1), "l1": ball(0.01), "l3": ball(0.1)}))
    found = self_collision(arm, samples=3000)
    assert found.tested == (("l0", "l3"),) and abs(found.after - 2.0 * np.arcsin(1.0 / 3.0) / np.pi) < 0.02
