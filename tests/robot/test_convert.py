"""One plain URDF from any description: macros expanded, meshes named by their actual paths."""

import json

import numpy as np
import pytest
from folders import DATA
from robots import urdf

import ik_toolkit as ik
from ik_toolkit import cli
from ik_toolkit.errors import InvalidOption, ModelError, RobotNotFound
from ik_toolkit.robot.formats.convert import convert
from ik_toolkit.robot.formats.urdf_check import check_urdf
from ik_toolkit.robot.formats.urdf_write import numbers_text

TRIANGLE = (DATA / "bad_urdf" / "triangle.stl").read_bytes()
MESHES = ("package://my_arm/meshes/a.stl", "../meshes/a.stl", "package://nowhere/b.stl", "/etc/passwd.stl")
SHAPES = "".join(f'<visual><geometry><mesh filename="{name}"/></geometry></visual>' for name in MESHES)
ARM = f"""<robot name="arm"><!-- kept --><link name="a">{SHAPES}</link><link name="tool0"/>
<joint name="j" type="revolute"><parent link="a"/><child link="tool0"/><origin xyz="0.1 0.2 0.3" rpy="0.1 0 0"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


@pytest.fixture
def package(tmp_path):
    """A ROS package with a mesh."""
    root = tmp_path / "my_arm"
    for folder in ("urdf", "meshes"):
        (root / folder).mkdir(parents=True)
    (root / "package.xml").write_text("<package><name>my_arm</name></package>")
    (root / "meshes" / "a.stl").write_bytes(TRIANGLE)
    (root / "urdf" / "arm.urdf").write_text(ARM)
    return root


def test_meshes_are_relative_below_the_new_file_and_absolute_elsewhere(package, tmp_path):
    file, mesh = package / "urdf" / "arm.urdf", str(package / "meshes" / "a.stl")
    beside, elsewhere = convert(file, package), convert(file, tmp_path / "other")
    assert beside.meshes == dict.fromkeys(MESHES[:2], "meshes/a.stl")
    assert elsewhere.meshes == convert(file).meshes == dict.fromkeys(MESHES[:2], mesh)
    assert set(beside.lost) == set(MESHES[2:]) and all(name in beside.text for name in MESHES[2:])
    assert "kept" in beside.text
    robot, again = ik.Robot.load(file), ik.Robot.load(beside.text)
    assert again.name == "arm" and np.array_equal(again.fk([0.3]).homogeneous, robot.fk([0.3]).homogeneous)


def test_the_folders_that_the_meshes_of_a_written_robot_need_are_named(package, tmp_path, caplog, capsys):
    """By `ik convert`, and by `robot.write`, which calibration uses: with these folders all meshes are read, without them not."""
    shape = '<{0}><geometry><mesh filename="{{{1}}}"/></geometry></{0}>'
    mesh = shape.format("visual", 0) + shape.format("collision", 1)
    names = "package://my_arm/meshes/look/a.stl", "package://my_arm/meshes/solid/a.stl", "package://hand/b.stl"
    for name in names:
        file = tmp_path / name.removeprefix("package://")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(TRIANGLE)
    (tmp_path / "hand" / "package.xml").write_text("<package><name>hand</name></package>")
    source, new = package / "urdf" / "arm.urdf", tmp_path / "new" / "arm.urdf"
    source.write_text(ARM.replace(SHAPES, mesh.format(*names[:2]) + mesh.format(*names[1:])))
    new.parent.mkdir()
    robot = ik.Robot.load(source)
    assert not caplog.messages
    robot.write(new)
    needed = [str(tmp_path / "hand"), str(package / "meshes")]
    (said,) = caplog.messages
    words = " ".join(f"--package-dir {one}" for one in needed)
    assert said.startswith("arm.urdf: meshes lie outside") and words in said
    assert len(check_urdf(new)) == 4 and not check_urdf(new, needed) and len(check_urdf(new, needed[1:])) == 1
    assert cli.main(["convert", str(source), "-o", str(new)]) == 0
    assert said.removeprefix("arm.urdf: ") in capsys.readouterr().err
    caplog.clear()
    robot.write(package / "urdf" / "again.urdf")  # in the package no folder of its meshes has to be given
    (said,) = caplog.messages
    assert f"need --package-dir {needed[0]} (" in said and not check_urdf(package / "urdf" / "again.urdf", needed[:1])


def test_what_a_written_robot_does_not_hold_is_named(tmp_path, caplog):
    text = urdf(dict(kind="revolute", limits=(-1.0, 1.0)), dict(kind="prismatic", limits=(0.0, 1.0)), name="arm")
    robot = ik.Robot.load(text, srdf=False)
    variants = {
        "": robot,
        "tool": robot.with_tool((0, 0, 0.1)),
        "place (on_base)": ik.Robot.load(text, on_base=(1, 0, 0)),
        "narrower limits": robot.narrowed({robot.joint_names[0]: (0.0, 0.5)}),
        "tool, locked joints": robot.with_tool((0, 0, 0.1)).locked({robot.joint_names[1]: 0.2}),
    }
    for lost, variant in variants.items():
        caplog.clear()
        variant.write(tmp_path / "arm.urdf")
        said = [f"arm.urdf: holds the description as it was read, without {lost}"] if lost else []
        assert caplog.messages == said


def test_xacro_becomes_plain_urdf_in_a_shell(package, tmp_path, capsys):
    pytest.importorskip("xacro")
    file, out = package / "urdf" / "arm.urdf.xacro", tmp_path / "out.urdf"
    macros = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="arm"><xacro:arg name="x" default="0.1"/>'
    file.write_text(ARM.replace('<robot name="arm">', macros).replace('xyz="0.1 ', 'xyz="$(arg x) '))
    assert cli.main(["convert", str(file), "-o", str(out), "--xacro-arg", "x:=0.7"]) == 0
    said = capsys.readouterr()
    assert not said.out and f"wrote {out}: arm" in said.err and "'package://nowhere/b.stl'" in said.err
    assert "xacro" not in out.read_text() and 'filename="my_arm/meshes/a.stl"' in out.read_text()
    assert ik.Robot.load(out).fk([0.0]).translation[0] == pytest.approx(0.7)
    assert cli.main(["convert", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["meshes"][MESHES[0]] == str(package / "meshes" / "a.stl")


def test_what_is_not_converted(package, tmp_path, capsys):
    file = package / "urdf" / "arm.urdf"
    assert cli.main(["convert", str(file), "-o", str(file)]) == 2
    assert "would overwrite" in capsys.readouterr().err
    bad = tmp_path / "bomb.urdf"
    bad.write_text('<!DOCTYPE robot [<!ENTITY a "a">]><robot name="x"/>')
    assert cli.main(["convert", str(bad), "-o", str(tmp_path / "out.urdf")]) == 2
    assert "DOCTYPE" in capsys.readouterr().err and not (tmp_path / "out.urdf").exists()


def test_other_words(package, tmp_path):
    file = package / "urdf" / "arm.urdf"
    for robot in (ik.Robot.load(file, ee_link="tool0"), ik.Robot.from_urdf(file), ik.Robot.from_urdf(ARM, ee_link="j")):
        assert robot.tip in ("tool0", "j") and robot.n == 1
    assert ik.Robot(ik.Robot.load(file).model, ee_link="tool0").tip == "tool0"
    with pytest.raises(InvalidOption, match="two names for one frame, not 'tool0' and 'a'"):
        ik.Robot.load(file, tip="tool0", ee_link="a")
    with pytest.raises(RobotNotFound, match="there is no file 'panda'; Robot"):
        ik.Robot.from_urdf("panda")
    with pytest.raises(ModelError, match="no movable joint"):
        ik.Robot.from_urdf('<robot name="r"><link name="a"/></robot>')


def test_numbers_are_written_plainly():
    assert numbers_text([-0.0, 0.0, 1.0, -2.5, 1e300]) == "0 0 1 -2.5 1e+300"
