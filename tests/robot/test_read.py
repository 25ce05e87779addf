"""What a URDF may say in other words, and what it may leave out: read as its author means it, or said."""

import itertools
import logging
import math
import pickle

import numpy as np
import pytest
import robots
from elbow_arm import LIMIT, TURN, arm, elbow, said, same_fk
from robots import joint

import ik_toolkit as ik
from ik_toolkit.errors import ModelError
from ik_toolkit.robot.formats.convert import convert
from ik_toolkit.robot.formats.urdf_check import check_urdf
from ik_toolkit.text import in_shell


# ------------------------------------------------------------------------------------------------------------- rotations
@pytest.mark.parametrize("quaternion", [
    "0 0 0.7071067811865476 0.7071067811865476", "0 0.7071067811865475 0 0.7071067811865476", "1 0 0 0", "0 0 0 1",
    "0.1 -0.2 0.3 0.9", "-0.5 0.5 -0.5 0.5", "0 -0.70710678 0 0.70710678", "3 0 4 0",
])  # fmt: skip
def test_a_quaternion_is_the_rotation(quaternion):
    text = elbow(f'<origin xyz="0.4 0.1 0" quat_xyzw="{quaternion}"/>', robot=' version="1.2"')
    robot = same_fk(text)
    assert len(check_urdf(text)) == (quaternion in ("3 0 4 0", "0.1 -0.2 0.3 0.9"))  # not of length 1
    assert pickle.loads(pickle.dumps(robot)).fk([0.1, 0.2]).isApprox(robot.fk([0.1, 0.2]), 1e-15)
    made = convert(text).text
    assert "quat" not in made and ik.Robot.load(made).fk([0.1, 0.2]).isApprox(robot.fk([0.1, 0.2]), 1e-14)


def test_a_quaternion_without_a_version_is_used_and_said(caplog):
    text = elbow('<origin quat_xyzw="0 0 0.6 0.8"/>')
    assert abs(same_fk(text).fk([0, 0]).rotation[1, 0] - 0.96) < 1e-12
    assert 'other readers ignore it without <robot version="1.2">' in caplog.text and said(text)[0][0] == 5
    assert "quat_xyzw" in ik.Robot.load(text).notes[0]


@pytest.mark.parametrize(
    ("origin", "problem"),
    [
        ('quat_xyzw="0 0 0 0"', "is zero: no rotation"),
        ('quat_xyzw="nan 0 0 1"', "is not finite"),
        ('quat_xyzw="0 0 1"', "is not 4 numbers"),
        ('rpy="0 0 1" quat_xyzw="0 0 0 1"', "has both rpy and quat_xyzw"),
    ],
)
def test_quaternions_that_are_no_rotation_are_refused(origin, problem):
    text = elbow(f"<origin {origin}/>", robot=' version="1.2"')
    with pytest.raises(ModelError, match="joint 'elbow'.*" + problem):
        ik.Robot.load(text)
    ((line, told),) = said(text)
    assert line == 5 and problem in told


def test_the_shapes_of_a_link_turn_by_quaternions():
    solid = f'<collision><origin {TURN}/><geometry><box size="1 2 3"/></geometry></collision>'
    text = robots.filled(elbow(robot=' version="1.2"'), {"upper": solid})
    (shape,) = ik.CollisionModel(ik.Robot.load(text)).geometry.geometryObjects
    x, y, z, w = np.array([0.1, -0.2, 0.3, 0.9]) / math.sqrt(0.95)
    assert abs(shape.placement.rotation[0, 1] - 2 * (x * y - z * w)) < 1e-12


@pytest.mark.parametrize("axis", ["0 0 1", "1 0 0", "0 1 0", "0 0 -1", "0.6 0 -0.8", "-2 1 3"])
@pytest.mark.parametrize("root", [True, False])
def test_the_plane_of_a_planar_joint_is_perpendicular_to_its_axis(axis, root):
    ends = (
        f'<origin xyz="0.1 0 0.2" rpy="0.3 -0.4 0.5"/><axis xyz="{axis}"/></joint>',
        f'<origin xyz="0 0.2 0.1" rpy="0.1 0.2 0.3"/><axis xyz="0 1 0"/>{LIMIT}</joint>',
    )
    kinds = ("planar", "revolute")
    (first, second), (one, two) = (ends, kinds) if root else (ends[::-1], kinds[::-1])
    text = (
        '<robot name="r"><link name="a"/><link name="b"/><link name="c"/>'
        f'<joint name="j1" type="{one}"><parent link="a"/><child link="b"/>{first}'
        f'<joint name="j2" type="{two}"><parent link="b"/><child link="c"/>{second}</robot>'
    )
    robot = same_fk(text, tip="c", base="a", base_limits=(-1, 1))
    x = next(i for i, name in enumerate(robot.joint_names) if name.endswith("_x"))
    q = np.zeros(robot.n)
    away = [robot.fk(q + 0.3 * np.eye(robot.n)[x + k]).translation - robot.fk(q).translation for k in (0, 1)]
    normal = np.cross(*away) / 0.09
    turned = robot.fk(q + 0.3 * np.eye(robot.n)[x + 2]).rotation @ robot.fk(q).rotation.T
    assert np.allclose(turned @ normal, normal, atol=1e-12) and abs(np.linalg.norm(normal) - 1.0) < 1e-12


# ------------------------------------------------------------------------------------------------- misspelled and repeated
@pytest.mark.parametrize(
    ("part", "word"),
    [
        ('<origin xyz="0.4 0 0" rpv="0 0 1.57"/>', "rpv= of <origin>"),
        ('<origin XYZ="0.4 0 0"/>', "XYZ= of <origin>"),
        ('<origin xyz="0.4 0 0" quat_wxyz="1 0 0 0"/>', "quat_wxyz= of <origin>"),
        ('<Origin xyz="0.4 0 0"/>', "<Origin>"),
        ('<orgin xyz="0.4 0 0"/>', "<orgin>"),
        ('<pose xyz="0.4 0 0"/>', "<pose>"),
        ("<pose>0.4 0 0 0 0 0</pose>", "<pose>"),
        ("<origin>0.4 0 0</origin>", "its <origin> is empty"),
        ('<urdf:origin xyz="0.4 0 0"/>', "<urdf:origin>"),
        ('<Axis xyz="0 0 1"/>', "<Axis>"),
        ('<axis xzy="0 0 1"/>', "xzy= of <axis>"),
        ('<limits lower="-1" upper="1"/>', "<limits>"),
        ('<limit lower="-1" uper="1" effort="1" velocity="1"/>', "uper= of <limit>"),
        ('<limit Lower="-1" upper="1" effort="1" velocity="1"/>', "Lower= of <limit>"),
        ('<mimick joint="shoulder"/>', "<mimick>"),
        ('<mimic joint="shoulder" multiplyer="2"/>', "multiplyer= of <mimic>"),
        ('<mimic joint="shoulder" ofset="2"/>', "ofset= of <mimic>"),
        ('<parent_link link="base"/>', "<parent_link>"),
        ('<origin xyz="0 0 0"/><origin xyz="0 0 1"/>', "2 <origin> (lines 5 and 5): only the first is read"),
        (LIMIT * 2, "2 <limit>"),
        ('<axis xyz="0 0 1"/><axis xyz="0 1 0"/>', "2 <axis>"),
        ('<parent link="base"/>', "2 <parent>"),
        ('<mimic joint="shoulder"/><mimic joint="shoulder"/>', "2 <mimic>"),
    ],
)
def test_names_that_no_reader_knows(part, word, caplog):
    """They are said with their line, by check and by loading."""
    text = arm(part + ("" if part.startswith("<limit ") else LIMIT))
    assert [line for line, told in said(text) if word in told] == [5]
    robot = ik.Robot.load(text)
    assert word in caplog.text and any(word in note for note in robot.notes)


@pytest.mark.parametrize("wrapper", ["group", "robot"])
def test_joints_in_a_wrong_place_are_said(wrapper):
    lost = f'<{wrapper} name="x"><link name="z"/>\n{joint("lost", "revolute", "upper", "z")}</{wrapper}>'
    assert any(f"inside <{wrapper}>" in note for note in ik.Robot.load(elbow(extra=lost)).notes)


@pytest.mark.parametrize("kind", ["planar", "floating"])
def test_a_mimic_that_a_joint_cannot_follow_is_said(kind):
    text = elbow(extra=joint("odd", kind, "upper", "z", mimic='<mimic joint="elbow"/>'))
    assert any(f"a {kind} joint mimics no other" in note for note in ik.Robot.load(text, tip="hand").notes)


def test_misspelled_items_and_shapes():
    told = said(elbow(extra='<Joint name="x"/>'))
    assert (1, "robot: <Joint> is not known and is ignored; did you mean <joint>?") in told
    assert any("<drake:joint>" in told for _, told in said(elbow(extra='<drake:joint name="x"/>')))
    ball = '<link name="a"><visual><geometry><sphere radious="1"/></geometry></visual><Collision/></link>'
    told = str(said(elbow().replace('<link name="upper"/>', '<link name="upper"/>' + ball)))
    assert "radious= of <sphere>" in told and "<Collision>" in told


def test_extensions_are_no_mistakes():
    known = (
        '<dynamics damping="1"/><calibration rising="0"/><safety_controller k_velocity="1" soft_upper_limit="1"/>'
        '<drake:declare_convex/><hardwareInterface>x</hardwareInterface><gazebo><limit lower="9"/><origin x="1"/></gazebo>'
    )
    limit = LIMIT.replace("/>", ' drake:acceleration="3" jerk="1" command_effort="9"/>')
    extra = (
        '<gazebo reference="hand"><Origin/></gazebo><transmission name="t"><joint name="elbow"/></transmission>'
        '<ros2_control name="c"><joint name="elbow"/></ros2_control><sensor name="s"/><material name="m"/><group name="g"/>'
        '<link name="unused_by_us"><contact/><visual alpha="1"><verbose/></visual><self_collision_checking/></link>'
        '<joint name="f" type="fixed"><parent link="hand"/><child link="unused_by_us"/><axis xyz="0 0 0"/></joint>'
    )
    text = elbow(limit=limit + known, extra=extra, robot=' xmlns:drake="http://drake.mit.edu" version="7"')
    assert said(text) == [] and ik.Robot.load(text, tip="hand").notes == ()


# ------------------------------------------------------------------------------------------------------------------ limits
@pytest.mark.parametrize(
    "text",
    [
        elbow(limit='<limit lower="-120" upper="120" effort="1" velocity="1"/>'),
        elbow(limit='<limit lower="0" upper="90.0" effort="1" velocity="1"/>'),
        elbow(limit='<limit lower="-2" upper="171.5" effort="1" velocity="1"/>'),
        elbow('<origin rpy="0 -90 0"/>'),
        elbow('<origin rpy="0 0 180"/>'),
        elbow(limit=LIMIT.replace("2", "99") + '<mimic joint="shoulder" offset="45"/>'),
    ],
)
def test_degrees_are_said(text, caplog):
    assert any(line == 5 and "degrees" in told for line, told in said(text))
    assert "like degrees" in "".join(ik.Robot.load(text).notes) and "like degrees" in caplog.text


def test_what_is_not_degrees():
    for limit in ("-6.2831 6.2831", "-29 29", "-1000 1000", "-45.53 45.53", "-31.4 62.8"):
        low, high = limit.split()
        assert said(elbow(limit=f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/>')) == []
    assert said(elbow(limit='<limit lower="0" upper="90" effort="1" velocity="1"/>', kind="prismatic")) == []


def test_limits_that_are_all_zero_are_said(caplog):
    text = elbow().replace('lower="-2" upper="2"', 'lower="0" upper="0.0"')
    assert any("all limits (2) are 0 to 0" in told for _, told in said(text))
    ik.Robot.load(text)
    assert "all limits (2) are 0 to 0" in caplog.text


@pytest.mark.parametrize("kind", ["continuous", "planar"])
def test_limits_of_a_joint_that_has_none_are_said(kind):
    text = elbow(limit='<limit lower="-1" upper="1" effort="1" velocity="1"/>', kind=kind)
    assert any(line == 5 and f"of a {kind} joint are ignored" in told for line, told in said(text))
    assert any("are ignored" in note for note in ik.Robot.load(text, tip="upper").notes)


@pytest.mark.parametrize(
    ("kind", "limit"),
    [
        ("continuous", '<limit velocity="3"/>'),
        ("continuous", ""),
        ("revolute", '<limit lower="-1" upper="1"/>'),
        ("revolute", '<limit lower="-1" upper="1" effort="-1" velocity="-1"/>'),
        ("revolute", '<limit lower="-1" upper="1" effort="inf" velocity="inf"/>'),
        ("revolute", '<limit lower="-1" upper="1" effort="nan" velocity="fast"/>'),
        ("prismatic", '<limit lower="-1" upper="1" effort="1e400" velocity="0"/>'),
    ],
)
def test_effort_and_velocity_are_not_needed(kind, limit, capfd):
    robot = same_fk(elbow(limit=limit, kind=kind))
    assert robot.velocity_limits[1] == (3.0 if "3" in limit else math.inf)
    assert robot.upper[1] == (math.inf if kind == "continuous" else 1.0)
    assert capfd.readouterr().err == ""


def test_a_velocity_of_zero_is_no_velocity_limit():
    """One meaning everywhere: check says it, info shows inf, tracking has no limit and a trajectory asks for one."""
    text = elbow(limit='<limit lower="-1" upper="1" effort="1" velocity="0"/>')
    ((_, told),) = said(text)
    assert told == "joint 'elbow': its velocity limit is 0, read as no limit: a joint that cannot move would be fixed"
    robot = ik.Robot.load(text)
    for one in (robot, ik.Robot(robot.model, tip="hand")):
        assert one.velocity_limits.tolist() == [1.0, math.inf]


@pytest.mark.parametrize(
    ("low", "high", "found"),
    [
        ("-inf", "inf", (-math.inf, math.inf)),
        ("-1e308", "1e308", (-math.inf, math.inf)),
        ("-inf", "1.5", (-math.inf, 1.5)),
        ("-1.5", "1e999", (-1.5, math.inf)),
    ],
)
def test_infinite_limits(low, high, found):
    for kind, mimic in itertools.product(("revolute", "prismatic"), (False, True)):
        text = elbow(limit=f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/>', kind=kind)
        if mimic:  # the follower's own limits count, too
            text = text.replace("</joint></robot>", '<mimic joint="shoulder"/></joint></robot>')
            text = text.replace('"-2" upper="2"', '"-9" upper="9"')
        robot = ik.Robot.load(text)
        assert (robot.lower[-1], robot.upper[-1]) == (tuple(np.clip(found, -9.0, 9.0)) if mimic else found)


@pytest.mark.parametrize(
    ("kind", "other"),
    [
        ("revolute", "write 3 to 4.283 if the range across half a turn"),
        ("prismatic", "change their signs and the axis if -3 to 2"),
    ],
)
def test_reversed_limits_name_both_readings(kind, other):
    text = elbow(limit='<limit lower="3" upper="-2" effort="1" velocity="1"/>', kind=kind)
    with pytest.raises(ModelError, match=f"swap them if -2 to 3 is meant, or {other}"):
        ik.Robot.load(text)
    assert ik.Robot.load(text, tip="upper").n == 1


@pytest.mark.parametrize(
    ("kind", "advice"), [("prismatic", r"add lower and upper \[m\]$"), ("revolute", "make it continuous")]
)
def test_advice_for_a_missing_limit(kind, advice):
    with pytest.raises(ModelError, match=advice):
        ik.Robot.load(elbow(limit="", kind=kind))


@pytest.mark.parametrize("axis", ["0 0 0", "nan 0 1", "0 1", ""])
def test_axes_that_are_no_direction(axis):
    with pytest.raises(ModelError, match="joint 'elbow'"):
        ik.Robot.load(elbow(axis=f'<axis xyz="{axis}"/>'))


def test_axes_of_other_lengths():
    for axis in ("0 2 0", "1 1 0", "0 1e-5 0", "0 1e200 0"):
        text = elbow(axis=f'<axis xyz="{axis}"/>')
        same_fk(text)
        assert "only its direction counts" in said(text)[0][1]
    assert "its <axis> has no xyz" in said(elbow(axis="<axis/>"))[0][1]


# ----------------------------------------------------------------------------------------------------- other ways to write
@pytest.mark.parametrize(
    "text",
    [
        elbow('<origin xyz="0.4\n 0\t0"/>'),
        elbow(extra="<?editor fold?><!-- a <b> --><![CDATA[ <x> ]]>text"),
        elbow(robot=' version="9.9"'),
        elbow(extra="<xacro:pelvis_sensor tag='a'/>", robot=' xmlns:xacro="http://ros.org/wiki/xacro"'),
        elbow('<origin xyz="+.4 0. 0"/>'),
        elbow(name="a&lt;b&gt;&amp;&quot;c'"),
        elbow(extra='<link name="x"><inertial><mass value="-"/><inertia ixx="a"/></inertial></link>'
              '<joint name="f" type="fixed"><parent link="base"/><child link="x"/></joint>'),
        elbow(extra='<link name="x"><visual><geometry><box size="a"/></geometry></visual></link>'
              '<joint name="f" type="fixed"><parent link="base"/><child link="x"/><axis xyz="nan"/></joint>'),
    ],
)  # fmt: skip
def test_read_without_a_word_on_stderr(text, capfd):
    robot = ik.Robot.load(text, tip="hand")
    Q = robot.random_q(np.random.default_rng(0), 3)
    plain = ik.Robot.load(elbow())
    assert all(robot.fk(q).isApprox(plain.fk(q), 1e-15) for q in Q)
    assert capfd.readouterr().err == "" and robot.joint_names[1] in ("elbow", "a<b>&\"c'")


def test_a_left_over_xacro_element_is_said():
    text = elbow(extra="<xacro:pelvis_sensor tag='a'/>", robot=' xmlns:xacro="http://ros.org/wiki/xacro"')
    assert "<xacro:pelvis_sensor> calls a macro" in ik.Robot.load(text).notes[0]
    for needed in ('<xacro:include filename="a"/>', '<xacro:property name="a" value="1"/>', '<link name="${a}"/>'):
        with pytest.raises(ModelError, match="has xacro macros"):
            ik.Robot.load(elbow(extra=needed))


def test_notes_are_said_once_a_kind(caplog):
    axes = [dict(kind="revolute", limits=(-120, 120), axis="0 0 1", xyz="0 0 0.2") for _ in range(5)]
    text = robots.urdf(*axes, dict(kind="fixed"))
    with caplog.at_level(logging.WARNING, logger="ik_toolkit"):
        robot = ik.Robot.load(text)
    assert len(robot.notes) == 1 and in_shell("4 more, see ik check") in robot.notes[0] and len(caplog.records) == 1
    assert len(check_urdf(text)) == 5
