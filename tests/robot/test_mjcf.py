"""MJCF: the loaded robot equals MuJoCo's model; and files that attempt forbidden operations."""

import pickle

import numpy as np
import pytest
from folders import DATA

import ik_toolkit as ik
from ik_toolkit import cli
from ik_toolkit.errors import InvalidOption, ModelError, RobotNotFound
from ik_toolkit.robot.library import find

mujoco = pytest.importorskip("mujoco")

PARTS = """<mujoco><default><default class="elbow"><joint axis="0 1 0" range="-100 100"/></default></default>
<asset><mesh name="tri" file="triangle.stl" scale="2 2 2"/></asset></mujoco>"""
ARM = """<mujoco model="arm"><compiler meshdir="meshes" eulerseq="zyx"/><include file="parts/parts.xml"/>
<worldbody><light pos="0 0 3"/><geom type="plane" size="1 1 1"/>
 <body name="column" pos="0.1 0 0.2" euler="30 20 10">
  <joint name="lift" type="slide" axis="0 0 1" range="0 0.4" ref="0.1"/>
  <joint name="turn" axis="0 0 1" pos="0.05 0.02 0" range="-170 170" ref="20"/>
  <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.02"/>
  <body name="upper" pos="0 0 0.3"><joint name="shoulder" type="ball" pos="0 0 0.01"/>
   <geom type="mesh" mesh="tri" pos="0.1 0.2 0.3" axisangle="1 0 0 40" group="2" contype="0" conaffinity="0"/>
   <geom type="ellipsoid" size="0.01 0.02 0.03"/>
   <frame pos="0.3 0 0" euler="0 10 0"><body name="lower"><joint name="elbow" class="elbow"/><joint name="twist" axis="1 0 0"/>
    <geom type="box" size="0.1 0.02 0.02" pos="0.1 0 0" group="3"/>
    <site name="tool" pos="0.2 0 0.01" quat="0.6 0.8 0 0"/>
    <body name="finger" pos="0.2 0 0"><joint name="slider" type="slide" axis="0 1 0" range="0 1"/><geom size="0.01"/></body>
   </body></frame></body></body></worldbody>
<equality><joint joint1="slider" joint2="elbow" polycoef="0.1 0.2 0 0 0"/>
<connect body1="lower" body2="column" anchor="0 0 0"/></equality>
<actuator><motor joint="elbow"/></actuator>
<keyframe><key name="folded" qpos="0.3 0.5 1 0 0 0 -1.2 0.25 0" ctrl="0"/></keyframe></mujoco>"""
JOINTS = ("lift", "turn", "shoulder_yaw", "shoulder_pitch", "shoulder_roll", "elbow", "twist")
BARE = '<mujoco><worldbody><body name="a"><joint name="j"/><geom size=".1"/>{}</body></worldbody></mujoco>'


@pytest.fixture
def arm(tmp_path):
    """File of an arm, one that it includes, and its mesh."""
    for folder in ("parts", "meshes"):
        (tmp_path / folder).mkdir()
    (tmp_path / "parts" / "parts.xml").write_text(PARTS)
    (tmp_path / "meshes" / "triangle.stl").write_bytes((DATA / "bad_urdf" / "triangle.stl").read_bytes())
    file = tmp_path / "arm.xml"
    file.write_text(ARM)
    return file


def plain(text):
    """The text without its mesh, which MuJoCo itself finds too flat."""
    return text.replace(
        '<include file="parts/parts.xml"/>', PARTS.partition("<asset>")[0].removeprefix("<mujoco>")
    ).replace('type="mesh" mesh="tri"', 'size="0.01"')


def test_kinematics_are_those_of_mujoco(arm, capfd):
    robot = ik.Robot.from_mjcf(arm, tip="tool")
    assert robot.joint_names == JOINTS and robot.base == "world" and robot.name == "arm"
    assert robot.upper[0] == 0.4 and robot.upper[5] == pytest.approx(np.radians(100)) and np.isinf(robot.upper[6])
    model = mujoco.MjModel.from_xml_string(plain(ARM))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for q in robot.random_q(rng, 20):
        ball = np.zeros(4)
        mujoco.mju_mat2Quat(ball, ik.pose((0, 0, 0), rpy=q[[4, 3, 2]])[:3, :3].ravel())
        data.qpos[:8] = [*q[:2], *ball, *q[5:]]
        mujoco.mj_kinematics(model, data)
        T = robot.fk(q)
        assert np.abs(T.translation - data.site("tool").xpos).max() < 1e-12
        assert np.abs(T.rotation.ravel() - data.site("tool").xmat).max() < 1e-12
    Q = robot.random_q(rng, 50)
    solved = ik.solve_batch(robot, np.array([robot.fk(q).homogeneous for q in Q]))
    # the loop's joints are in q
    assert set(solved.counts()) == {"CONSTRAINT_OPEN"} and solved.position_error.max() < 1e-6
    again = pickle.loads(pickle.dumps(robot))
    assert np.array_equal(again.fk(Q[0]).homogeneous, robot.fk(Q[0]).homogeneous) and again.notes == robot.notes
    said = capfd.readouterr()
    assert not said.out and not said.err and not list(arm.parent.glob("*.TXT"))


def test_followers_of_equalities(arm):
    finger = ik.Robot.load(arm, tip="finger")
    assert finger.joint_names == JOINTS
    slid = [(finger.fk(x).inverse() * ik.Robot.load(arm, tip="lower").fk(x)).translation for x in np.eye(7)[[0, 5]]]
    assert slid[0][1] == pytest.approx(-0.1) and slid[1][1] == pytest.approx(-0.3)
    assert np.isinf(finger.velocity_limits).all() and not any("rad/s" in note for note in finger.notes)


def test_settings_of_contacts_that_are_not_used_are_said(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(
        "<mujoco><option><flag contact='disable'/></option><worldbody><geom name='floor' type='plane' size='1 1 1'/><body name='a'>"
        "<joint name='j'/><geom name='g' size='.1'/></body></worldbody>"
        "<contact><pair name='p' geom1='floor' geom2='g'/><pair name='q' geom1='floor' geom2='g'/></contact></mujoco>"
    )
    notes = ik.Robot.load(file).notes
    for said in ("a <pair> of <contact> is left out", "that contacts are disabled is not used"):
        assert notes.count(said) == 1


def test_what_a_urdf_does_not_hold_is_said(arm, caplog, capsys):
    robot = ik.Robot.load(arm, tip="tool")
    assert "the loop 'connect lower and column' is left open" in caplog.text
    said = "ball joint 'shoulder' becomes three revolute joints: shoulder_yaw, shoulder_pitch, shoulder_roll"
    span = dict(zip(robot.joint_names, (robot.upper - robot.lower).tolist(), strict=True))
    assert 3.0 < span["shoulder_pitch"] <= np.pi and span["shoulder_yaw"] > 6.0 and span["shoulder_roll"] > 6.0
    assert said in robot.notes and "shapes that a URDF cannot hold are left out: ellipsoid" in robot.notes
    assert cli.main(["info", str(arm), "--tip", "tool"]) == 0
    assert "three revolute joints" in " ".join(capsys.readouterr().out.split())


def test_shapes_are_for_collisions_and_pictures(arm):
    robot = ik.Robot.load(arm, tip="tool")
    model = ik.CollisionModel(robot)
    assert set(model.links) == {"column", "lower", "finger"}
    kinds = [line.strip().partition(" ")[0] for line in robot.urdf.splitlines() if "<mesh" in line]
    assert kinds == ["<mesh"] and 'filename="meshes/triangle.stl" scale="2 2 2"' in robot.urdf
    text = robot.urdf[: robot.urdf.index("<mesh")]
    xyz = text[text.rindex("<origin") :].partition('xyz="')[2].partition('"')[0]
    assert np.allclose([float(x) for x in xyz.split()], (0.1, 0.2, 0.3), atol=1e-12)  # the file's own origin


@pytest.mark.parametrize(
    ("unit", "most", "said"), [("degree", 1.57, True), ("degree", 90, False), ("radian", 1.57, False)]
)
def test_radians_read_as_degrees_are_said(unit, most, said):
    hinge = f'<geom size="0.05"/><joint axis="0 1 0" range="-{most} {most}"/>'
    bodies = f'<body name="a">{hinge}<body name="b" pos="0.2 0 0">{hinge}</body></body>'
    text = f'<mujoco><compiler angle="{unit}"/><worldbody>{bodies}</worldbody></mujoco>'
    assert said == any("were radians meant?" in note for note in ik.Robot.load(text).notes)


@pytest.mark.parametrize(
    ("mesh", "geom"),
    [
        ('refpos="0.1 0.2 0.3"', 'pos="0.1 0 0" euler="10 20 30"'),
        ('refquat="1 0.2 0.3 0.4" refpos="0.1 0 0.2" scale="2 2 2"', 'euler="0 20 0"'),
        ('refpos="0.1 0.2 0.3" scale="1 -2 3"', ""),
    ],
)
def test_meshes_lie_where_mujoco_has_them(mesh, geom, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    box.apply_translation((0.2, 0.1, 0.0))
    box.export(tmp_path / "box.stl")
    file = tmp_path / "m.xml"
    file.write_text(
        f'<mujoco><asset><mesh name="m" file="box.stl" {mesh}/></asset><worldbody><body name="a" pos="0 0 0.1">'
        f'<joint axis="0 0 1" range="-90 90"/><geom type="mesh" mesh="m" {geom}/></body></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    theirs = model.mesh_vert @ data.geom_xmat[0].reshape(3, 3).T + data.geom_xpos[0]
    robot = ik.Robot.load(file)
    (shape,) = ik.CollisionModel(robot).geometry.geometryObjects
    at = robot.fk([0.0]) * robot.model.frames[shape.parentFrame].placement.inverse() * shape.placement
    ours = np.array(shape.geometry.vertices()) @ at.rotation.T + at.translation
    for end in (np.min, np.max):
        assert np.allclose(end(ours, axis=0), end(theirs, axis=0), atol=1e-9)


def test_what_is_fitted_to_a_mesh_is_the_mesh(tmp_path):
    text = (
        '<mujoco><default><default class="fit"><geom type="box"/></default></default><asset><mesh name="m" file="m.stl"/></asset>'
        '<worldbody><body name="a"><joint axis="0 0 1" range="-90 90"/><geom {} mesh="m"/></body></worldbody></mujoco>'
    )
    for given, told in (('type="capsule"', True), ('class="fit"', False), ("", False)):
        (tmp_path / "m.xml").write_text(text.format(given))
        robot = ik.Robot.load(tmp_path / "m.xml")
        assert '<mesh filename="m.stl"' in robot.urdf and "<box" not in robot.urdf and "<capsule" not in robot.urdf
        assert told == any("mesh 'm' itself is read where a capsule is fitted to it" in note for note in robot.notes)


def test_a_texture_named_in_the_defaults_leaves_the_colour():
    robot = ik.Robot.load(
        '<mujoco><default><material texture="t" rgba="0.2 0.4 0.6 1"><layer texture="t" role="normal"/></material></default><asset>'
        '<texture name="t" type="2d" builtin="flat" width="2" height="2"/><material name="m"/></asset>'
        '<worldbody><body name="a"><joint range="-90 90"/><geom size="0.1" material="m"/></body></worldbody></mujoco>'
    )
    assert 'rgba="0.2' in robot.urdf


def test_settings_that_mujoco_has_given_up_are_no_mistake():
    text = '<mujoco><compiler exactmeshinertia="true" convexhull="false"/><worldbody><body name="a"><geom size="0.1"/>'
    assert ik.Robot.load(text + '<joint range="-90 90"/></body></worldbody></mujoco>').n == 1


def test_pairs_that_the_file_excludes_are_not_tested():
    ball = '<geom size="0.05"/><joint axis="0 1 0" range="-90 90"/>'
    text = (
        f'<mujoco><worldbody><body name="a">{ball}<body name="b" pos="0.2 0 0">{ball}<body name="c" pos="0.2 0 0">{ball}</body>'
        "</body></body></worldbody>{}</mujoco>"
    )
    free = ik.CollisionModel(ik.Robot.load(text.format("")))
    assert ("a", "c") in free.pairs
    kept = ik.CollisionModel(ik.Robot.load(text.format('<contact><exclude body1="a" body2="c"/></contact>')))
    assert kept.allowed == {("a", "c"): "exclude"} and ("a", "c") not in kept.pairs


def test_keyframes_are_named_configurations(arm):
    robot = ik.Robot.load(arm, tip="tool")
    assert np.allclose(robot.named["folded"], [0.3, 0.5, 0, 0, 0, -1.2, 0.25])


def test_converted(arm, tmp_path, capsys):
    out = tmp_path / "out.urdf"
    assert cli.main(["convert", str(arm), "-o", str(out)]) == 0
    q = np.full(7, 0.1)
    again = ik.Robot.load(out, tip="tool")
    assert np.array_equal(again.fk(q).homogeneous, ik.Robot.load(arm, tip="tool").fk(q).homogeneous)


def test_a_free_joint_is_held_unless_it_has_limits(caplog):
    below = '<freejoint name="f"/><body name="b" pos="0 0 1"><joint name="j" range="-90 90"/><geom size=".1"/></body>'
    text = BARE.replace('<joint name="j"/>', "").format(below)
    assert ik.Robot.load(text, tip="b").base == "a" and "held still" in caplog.text
    free = ik.Robot.load(text, tip="b", base_limits=(-1, 1))
    assert free.joint_names[:4] == ("base_x", "base_y", "base_z", "base_yaw")


FREE = """<mujoco><worldbody><body name="trunk" pos="0.1 0 0.4" euler="10 20 30"><freejoint name="f"/><geom size=".1"/>
<body name="leg" pos="0.2 0 0"><joint name="hip" axis="0 1 0" range="-60 60"/><geom size=".05"/>
<site name="foot" pos="0 0 -0.2"/></body></body>
</worldbody><keyframe><key name="stand" qpos="0.3 0.2 0.5 0.8 0 0.6 0 0.4"/></keyframe></mujoco>"""
BALL = '<body name="ball" pos="0.7 0.1 0.3" euler="0 0 40"><freejoint/><geom size=".1"/></body></worldbody>'


def test_free_bodies_stand_where_the_file_and_its_keyframes_have_them():
    model = mujoco.MjModel.from_xml_string(FREE)
    data, robot = mujoco.MjData(model), ik.Robot.load(FREE, tip="foot", base_limits=(-1, 1))
    for q in (np.zeros(7), robot.named["stand"]):
        mujoco.mj_kinematics(model, data)
        assert np.abs(robot.fk(q).translation - data.site("foot").xpos).max() < 1e-12
        assert np.abs(robot.fk(q).rotation.ravel() - data.site("foot").xmat).max() < 1e-12
        mujoco.mj_resetDataKeyframe(model, data, 0)
    held = FREE.partition("<keyframe>")[0].replace('<freejoint name="f"/>', "")
    scene = held.replace("</worldbody>", BALL) + "</mujoco>"
    ball = robot.fk(np.zeros(7)) * ik.Robot.load(scene, tip="foot", base="ball").fk([0.0]).inverse()
    wanted = ik.pose((0.7, 0.1, 0.3), rpy=(0.0, 0.0, np.radians(40.0)))
    assert np.abs(ball.homogeneous - wanted).max() < 1e-12


OUTSIDE = "lies outside the model's folder; name its folder with package_dirs"
MANY = '<replicate count="{}" offset="1 0 0">{}</replicate>'
# MuJoCo takes their square
DEFAULTS = "".join(f'<default class="a{k}"><geom size="1"/></default>' for k in range(30_000))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('<!DOCTYPE mujoco [<!ENTITY a "a">]>' + BARE.format(""), "DOCTYPE or entity"),
        (BARE.format('<include file="../secret.xml"/>'), OUTSIDE),
        (BARE.format('<include file="/etc/passwd"/>'), OUTSIDE),
        (BARE.format('<include file="link.xml"/>'), OUTSIDE),
        (BARE.format('<include file="arm.xml"/>'), "includes itself"),
        (BARE.format('<include file="none.xml"/>'), "there is no such file"),
        (BARE.format('<include file=""/>'), "cannot be found"),
        (BARE.format("<body>" * 80 + "</body>" * 80), "nested more than 64 deep"),
        (BARE.format(MANY.format(100_000_000, '<geom size=".1"/>')), "its <replicate> comes to 100,000,00"),
        (BARE.format(MANY.format(500, MANY.format(500, '<geom size=".1"/>'))), "its <replicate> comes to 250,00"),
        (BARE.format('<geom size=".1"/>' * 20_001), "it has more than 20,000 elements <geom>; it is not read"),
        (
            BARE.format("").replace("</worldbody>", "</worldbody><default>" + DEFAULTS + "</default>"),
            "cannot read 'arm.xml': it crashed MuJoCo, or took too much time or memory",
        ),
        (BARE.format('<geom type="mesh" mesh="none"/>'), "cannot read 'arm.xml': Error"),
        (BARE.format("</geom>"), "well-formed"),
        (BARE.format('<joint name="j"/>'), "repeated name"),
        ("<mujoco/>", "no movable joint"),
        ("<mujocoinclude/>", "a part of an MJCF model"),
    ],
    ids=lambda value: value[:60] if value.startswith("<") else None,
)
def test_hostile_files_are_harmless(tmp_path, text, said, monkeypatch):
    # of processor time, for the one that would take all of it
    monkeypatch.setattr("ik_toolkit.robot.formats.mjcf.SECONDS", 1)
    (tmp_path / "secret.xml").write_text('<mujoco><worldbody><body name="secret"/></worldbody></mujoco>')
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "link.xml").symlink_to(tmp_path / "secret.xml")
    file = tmp_path / "a" / "arm.xml"
    file.write_text(text)
    with pytest.raises(ModelError) as caught:
        ik.Robot.load(file)
    assert said in str(caught.value) and len(str(caught.value)) < 500


def test_files_outside_are_not_read(tmp_path):
    """Neither by us nor by MuJoCo: what names a file is gone when it sees the text."""
    asset = '<asset><mesh name="m" file="../../secret.stl"/><texture name="t" type="2d" file="/etc/passwd"/>'
    asset += '<material name="c" texture="t"/>'
    text = BARE.format('<geom type="mesh" mesh="m" material="c"/>').replace(
        "<worldbody>", f"{asset}</asset><worldbody>"
    )
    (tmp_path / "secret.stl").write_bytes((DATA / "bad_urdf" / "triangle.stl").read_bytes())
    file = tmp_path / "a" / "b" / "arm.xml"
    file.parent.mkdir(parents=True)
    file.write_text(text)
    robot = ik.Robot.load(file)
    with pytest.raises(ModelError, match="lies outside the allowed folders"):
        ik.CollisionModel(robot)


def test_mistakes(arm, tmp_path, monkeypatch):
    with pytest.raises(InvalidOption, match="arm is MJCF"):
        ik.Robot.load(arm, xacro_args={"a": 1})
    with pytest.raises(RobotNotFound, match="there is no file"):
        ik.Robot.from_mjcf(tmp_path / "none.xml")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ik.IKError, match="mujoco is not installed"):
        ik.Robot.load(arm)


def test_folders_and_the_menagerie(arm, tmp_path, monkeypatch):
    root = tmp_path / "menagerie"
    root.mkdir()
    for name in ("arm", "hand"):
        (root / name).mkdir()
        (root / name / "scene.xml").write_text(ARM)
        (root / name / f"{name}.xml").write_text(plain(ARM))
    assert find(root / "arm").path == root / "arm" / "arm.xml"
    assert ik.Robot.load(str(root / "arm"), tip="tool").n == 7
    monkeypatch.setenv("MENAGERIE_ROOT", str(root))
    assert find("mujoco-menagerie:hand").path == root / "hand" / "hand.xml"
    with pytest.raises(RobotNotFound, match="Did you mean 'hand'"):
        find("mujoco-menagerie:hant")
    (root / "arm" / "left.xml").write_text(plain(ARM))
    assert find(root / "arm").path == root / "arm" / "arm.xml"
    (root / "arm" / "arm.xml").rename(root / "arm" / "right.xml")
    with pytest.raises(RobotNotFound, match=r"several descriptions; give one of them: left\.xml, right\.xml"):
        find(root / "arm")
