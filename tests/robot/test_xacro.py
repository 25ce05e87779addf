"""Xacro files: arguments, packages and includes; and files that attempt forbidden operations."""

import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption, ModelError
from ik_toolkit.robot.geometry.meshes import mesh_packages
from ik_toolkit.robot.packages import find_package

pytest.importorskip("xacro")

SLOW = pytest.mark.slow  # as others that are run always: each starts a process
HEAD = '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'
MACRO = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="seg" params="i parent length">
<link name="l${i}"><visual><geometry><mesh filename="package://my_arm/meshes/a.stl"/></geometry></visual></link>
<joint name="j${i}" type="revolute"><parent link="${parent}"/><child link="l${i}"/><origin xyz="${length} 0 0"/><axis xyz="0 1 0"/>
<limit lower="${-pi}" upper="${pi}" effort="1" velocity="1"/></joint></xacro:macro></robot>"""
ARM = f"""{HEAD}<xacro:arg name="length" default="0.5"/><xacro:include filename="$(find my_arm)/urdf/seg.xacro"/><link name="l0"/>
<xacro:seg i="1" parent="l0" length="$(arg length)"/><xacro:seg i="2" parent="l1" length="$(arg length)"/></robot>"""


@pytest.fixture
def package(tmp_path):
    """A ROS package, its folder not named like it."""
    for folder in ("urdf", "meshes"):
        (tmp_path / "src" / "repository" / folder).mkdir(parents=True)
    root = tmp_path / "src" / "repository"
    (root / "package.xml").write_text("<package><name>my_arm</name></package>")
    (root / "urdf" / "seg.xacro").write_text(MACRO)
    (root / "urdf" / "arm.urdf.xacro").write_text(ARM)
    return root


def test_expanded_with_its_arguments(package):
    file = package / "urdf" / "arm.urdf.xacro"
    assert ik.Robot.load(file).reach == pytest.approx(0.5)
    assert ik.Robot.load(file, xacro_args={"length": 0.75}).reach == pytest.approx(0.75)
    with pytest.raises(ModelError, match="contains xacro macros but no robot"):
        ik.Robot.load(package / "urdf" / "seg.xacro")


def test_an_argument_that_is_not_used_is_told(package, caplog):
    """A misspelled one gave the robot of the default, without a word."""
    file = package / "urdf" / "arm.urdf.xacro"
    assert ik.Robot.load(file, xacro_args={"lenght": 0.75}).reach == pytest.approx(0.5)
    assert "does not use the argument 'lenght'. Did you mean 'length'?" in caplog.text
    caplog.clear()
    ik.Robot.load(file, xacro_args={"length": 0.75})
    assert not caplog.text


def test_what_asks_for_the_environment_gets_arguments(package, monkeypatch):
    file = package / "urdf" / "arm.urdf.xacro"
    monkeypatch.setenv("LENGTH", "3")
    file.write_text(ARM.replace('default="0.5"', 'default="$(optenv LENGTH 0.25)"'))
    assert ik.Robot.load(file).reach == pytest.approx(0.25)
    assert ik.Robot.load(file, xacro_args={"LENGTH": 0.75}).reach == pytest.approx(0.75)
    file.write_text(ARM.replace('default="0.5"', 'default="$(env LENGTH)"'))
    assert ik.Robot.load(file, xacro_args={"LENGTH": 0.75}).reach == pytest.approx(0.75)


def test_includes_name_packages_by_their_address(package):
    file = package / "urdf" / "arm.urdf.xacro"
    file.write_text(ARM.replace("$(find my_arm)/", "package://my_arm/"))
    assert ik.Robot.load(file).n == 2


def test_packages_are_found_where_ros_looks(package, tmp_path, monkeypatch):
    alone = tmp_path / "elsewhere" / "arm.urdf"
    alone.parent.mkdir()
    alone.write_text(ARM)
    with pytest.raises(ModelError, match="there is no package 'my_arm'"):
        ik.Robot.load(alone)
    named = tmp_path / "ros" / "my_arm"
    named.parent.mkdir()
    named.symlink_to(package)
    for variable in ("ROS_PACKAGE_PATH", "package_dirs"):
        with monkeypatch.context() as patch:
            if variable != "package_dirs":
                patch.setenv(variable, str(named.parent))
            assert ik.Robot.load(alone, package_dirs=[named.parent] if variable == "package_dirs" else ()).n == 2
    (tmp_path / "prefix" / "share").mkdir(parents=True)
    (tmp_path / "prefix" / "share" / "my_arm").symlink_to(package)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))
    assert ik.Robot.load(alone).n == 2


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        ('<link name="$(env HOME)"/>', "environment is not read, give HOME as an argument"),
        pytest.param("""<link name="${env('HOME')}"/>""", "'env' is not defined", marks=SLOW),
        ('<xacro:include filename="package://nowhere/x.xacro"/>', "no package 'nowhere'"),
        pytest.param('<xacro:include filename="package://../x.xacro"/>', "no package '..'", marks=SLOW),
        ('<xacro:include filename="none.xacro"/>', "none.xacro' (in 'arm.xacro')"),
        ("""<link name="${xacro.load_yaml('/etc/hostname')}"/>""", "reads '/etc/hostname'"),
        pytest.param('<xacro:include filename="/etc/passwd"/>', "reads '/etc/passwd'", marks=SLOW),
        ('<xacro:include filename="../../secret.xacro"/>', "secret.xacro', which is not allowed"),
        pytest.param('<xacro:include filename="$(find ../..)/x"/>', "no package", marks=SLOW),
        ('<xacro:macro name="m" params=""><xacro:m/></xacro:macro><xacro:m/>', "recursion"),
        pytest.param('<link name="${nobody}"/>', "'nobody' is not defined", marks=SLOW),
        ('<link name="${[x for x in range(10**12)]}"/>', "cannot be expanded"),
        pytest.param("<xacro:seg/>", "seg", marks=SLOW),
        ('<link name="${(lambda: ().__class__)()}"/>', "it uses a lambda, which is not evaluated, in the expression"),
        ('<link name="$(eval [].__class__)"/>', "it uses '.__class__', which is not allowed"),
        ('<link name="$(command ls)"/>', "Unknown substitution command"),
        pytest.param('<link name="$(anon a)"/>', "Unknown substitution command", marks=SLOW),
        ('<xacro:include filename="way_out.xacro"/>', "way_out.xacro', which is not allowed"),
        ('<xacro:include filename="/etc/*"/>', "which is not allowed"),
        ("""<link name="${xacro.load_yaml('pipe.yaml')}"/>""", "is not a regular file"),
        ("""<link name="${len(xacro.load_yaml('laughs.yaml')['i'])}"/>""", "too large once its anchors are put in"),
        pytest.param(
            """<link name="${xacro.load_yaml('merged.yaml').i.a}"/>""", "too large once its anchors", marks=SLOW
        ),
        ("""<link name="${xacro.load_yaml('object.yaml')}"/>""", "could not determine a constructor"),
        ('<xacro:include filename="entities.xacro"/>', "DOCTYPE"),
        pytest.param(
            f'<material name="{"${1}" * 6000}"/>', "text with expressions has more than 20,000 characters", id="long"
        ),
        ("PROPERTIES", "more than 100,000 characters"),
        ("MACROS", "more than 150,000 steps"),
        ("CIRCLE", "circular"),
        ('<xacro:include filename="large.xacro"/>' * 2, "what is read before it are too large"),
    ],
)
def test_hostile_files_are_harmless(tmp_path, inside, said):
    (tmp_path / "secret.xacro").write_text(f'{HEAD}<link name="secret"/></robot>')
    file = tmp_path / "a" / "b" / "arm.xacro"
    file.parent.mkdir(parents=True)
    (file.parent / "way_out.xacro").symlink_to(tmp_path / "secret.xacro")
    os.mkfifo(file.parent / "pipe.yaml")
    if "large" in inside:
        (file.parent / "large.xacro").write_text(HEAD + " " * 11_000_000 + "</robot>")
    laughs = "\n".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]" for a, b in pairwise("abcdefghi"))
    (file.parent / "laughs.yaml").write_text(f"a: &a [ha]\n{laughs}")
    merged = "\n".join(f"{b}: &{b} {{<<: [{', '.join([f'*{a}'] * 9)}]}}" for a, b in pairwise("abcdefghi"))
    (file.parent / "merged.yaml").write_text(f"a: &a {{a: 1}}\n{merged}")
    (file.parent / "object.yaml").write_text("!!python/object/apply:os.getpid []")
    (file.parent / "entities.xacro").write_text(f'<!DOCTYPE robot [<!ENTITY a "b">]>{HEAD}<link name="&a;"/></robot>')
    ten = "".join(f'<xacro:property name="{b}" value="{f"${{{a}}}" * 10}"/>' for a, b in pairwise("abcdefghi"))
    inside = inside.replace("PROPERTIES", f'<xacro:property name="a" value="ha"/>{ten}<link name="${{i}}"/>')
    two = "".join(f'<xacro:macro name="{b}">{f"<xacro:{a}/>" * 9}</xacro:macro>' for a, b in pairwise("abcdefghi"))
    circle = '<xacro:property name="a" value="${b}"/><xacro:property name="b" value="${a}"/><link name="${a}"/>'
    inside = inside.replace("CIRCLE", circle).replace(
        "MACROS", f'<xacro:macro name="a"><p/></xacro:macro>{two}<xacro:i/>'
    )
    file.write_text(f'{HEAD}<link name="l0"/>{inside}</robot>')
    with pytest.raises(ModelError, match=r"'arm\.xacro' cannot be expanded") as caught:
        ik.Robot.load(file)
    assert said in str(caught.value) and "Error" not in str(caught.value) and len(str(caught.value)) < 400


def test_arguments_are_checked(package, tmp_path):
    with pytest.raises(InvalidOption, match="xacro_args must map names to strings, numbers or paths"):
        ik.Robot.load(package / "urdf" / "arm.urdf.xacro", xacro_args={"length": [1]})
    with pytest.raises(InvalidOption, match="hydrolek_7w is a plain URDF"):
        ik.Robot.load("hydrolek_7w", xacro_args={"length": 1})


ONE = """<link name="base"/><link name="tip"/><joint name="j" type="revolute"><parent link="base"/><child link="tip"/>
<origin xyz="LENGTH 0 0"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize("declared", ["", '<xacro:arg name="prefix"/>'])
def test_an_argument_without_a_value_says_how_to_give_it(tmp_path, declared):
    file = tmp_path / "arm.urdf.xacro"
    file.write_text(HEAD + declared + ONE.replace("LENGTH", "0.3").replace('name="j"', 'name="$(arg prefix)j"'))
    with pytest.raises(ModelError) as caught:
        ik.Robot.load(file)
    assert "the argument 'prefix' has no value" in str(caught.value)
    assert "xacro_args={'prefix': ...}" in str(caught.value) and "--xacro-arg prefix:=VALUE" in str(caught.value)
    assert ik.Robot.load(file, xacro_args={"prefix": "left_"}).joint_names == ("left_j",)


def test_calls_of_macros_that_do_not_fit_name_the_macro(tmp_path):
    macro = '<xacro:macro name="gripper" params="a b"><xacro:griper/></xacro:macro>'
    for call, said in (
        ("griper", "there is no macro 'griper'. Did you mean 'gripper'? Available: gripper."),
        ('gripper a="1"', "Undefined parameters [b] (in the macro 'gripper' of 'arm.urdf.xacro')"),
        ('gripper a="1" b="2"', "there is no macro 'griper'. Did you mean 'gripper'?"),
    ):
        (tmp_path / "arm.urdf.xacro").write_text(f"{HEAD}{macro}<xacro:{call}/>{ONE.replace('LENGTH', '1')}")
        with pytest.raises(ModelError) as caught:
            ik.Robot.load(tmp_path / "arm.urdf.xacro")
        assert said in str(caught.value)


def test_arguments_may_be_numbers_of_numpy_and_paths(tmp_path):
    file = tmp_path / "arm.urdf.xacro"
    file.write_text(HEAD + '<xacro:arg name="x" default="0"/>' + ONE.replace("LENGTH", "$(arg x)"))
    for given in (2, np.int64(2), np.float64(2.0), Path("2")):
        assert ik.Robot.load(file, xacro_args={"x": given}).fk([0.0]).translation[0] == 2.0


def test_packages_go_by_the_name_in_their_manifest(tmp_path):
    """Next to the file, in package_dirs or below it; and for meshes of a plain URDF."""
    parts = tmp_path / "ws" / "folder_x"
    for folder, name in ((parts, "arm_parts"), (tmp_path / "ws" / "cfg", "cfg"), (tmp_path / "away", "away")):
        folder.mkdir(parents=True)
        (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    (parts / "v.xacro").write_text(f'{HEAD}<xacro:property name="g" value="0.6"/></robot>')
    text = f'{HEAD}<xacro:include filename="$(find arm_parts)/v.xacro"/>' + ONE.replace("LENGTH", "${g}")
    near, far = tmp_path / "ws" / "cfg" / "arm.urdf.xacro", tmp_path / "away" / "arm.urdf.xacro"
    near.write_text(text)
    far.write_text(text)
    assert ik.Robot.load(near).fk([0.0]).translation[0] == 0.6
    with pytest.raises(ModelError, match=r"no package 'arm_parts'; name its folder.*package_dirs"):
        ik.Robot.load(far)
    for folder in (parts, parts.parent, tmp_path):
        assert ik.Robot.load(far, package_dirs=[folder]).fk([0.0]).translation[0] == 0.6
    assert mesh_packages(["package://arm_parts/a.stl"], near, []) == {"arm_parts": parts}


def test_a_link_in_a_given_folder_does_not_lead_out(tmp_path):
    (tmp_path / "given").mkdir()
    (tmp_path / "secret").mkdir()
    (tmp_path / "given" / "pkg").symlink_to(tmp_path / "secret")
    assert find_package("pkg", None, [tmp_path / "given"], {}) is None


def test_a_file_above_names_its_remedy_which_works(tmp_path):
    for folder in ("common", "urdf"):
        (tmp_path / folder).mkdir()
    (tmp_path / "common" / "c.xacro").write_text(f'{HEAD}<xacro:property name="g" value="0.6"/></robot>')
    file = tmp_path / "urdf" / "arm.urdf.xacro"
    file.write_text(f'{HEAD}<xacro:include filename="../common/c.xacro"/>' + ONE.replace("LENGTH", "${g}"))
    with pytest.raises(ModelError) as caught:
        ik.Robot.load(file)
    assert f"package_dirs=['{tmp_path / 'common'}']"[-80:] in str(caught.value)
    assert ik.Robot.load(file, package_dirs=[tmp_path / "common"]).fk([0.0]).translation[0] == 0.6


def test_an_srdf_may_be_xacro(tmp_path):
    """It takes the arguments of xacro too, beside a plain URDF as well."""
    (tmp_path / "arm.urdf").write_text(HEAD + ONE.replace("LENGTH", "0.3"))
    srdf = tmp_path / "arm.srdf.xacro"
    srdf.write_text(
        f'{HEAD}<xacro:arg name="state" default="up"/><group name="arm"><chain base_link="base" tip_link="tip"/></group>'
        '<group_state name="$(arg state)" group="arm"><joint name="j" value="${1/2}"/></group_state></robot>'
    )
    assert ik.Robot.load(tmp_path / "arm.urdf", srdf=srdf).named["up"] == pytest.approx([0.5])
    robot = ik.Robot.load(tmp_path / "arm.urdf", srdf=str(srdf), group="arm", xacro_args={"state": "down"})
    assert "down" in robot.named and "up" not in robot.named
    assert ik.Tree.load(tmp_path / "arm.urdf", tips=["tip", "base"][:1], srdf=srdf).named["up"] == pytest.approx([0.5])


def test_units_and_dates_in_yaml(tmp_path):
    (tmp_path / "v.yaml").write_text("when: 2021-05-06\nlimits: {j: {upper: !degrees 90, reach: !inches 10}}\n")
    file = tmp_path / "arm.urdf.xacro"
    load = """<xacro:property name="v" value="${xacro.load_yaml('v.yaml')}"/>"""
    text = ONE.replace("LENGTH", "${v.limits.j.reach}").replace('upper="1"', """upper="${v['limits'].j['upper']}\"""")
    file.write_text(HEAD + load + text)
    robot = ik.Robot.load(file)
    assert robot.upper == pytest.approx([1.5707963267948966]) and robot.fk([0.0]).translation[0] == pytest.approx(0.254)


def test_a_quote_left_open_among_parameters_takes_no_time(tmp_path):
    """xacro's own pattern takes twice as long for each letter more."""
    file = tmp_path / "arm.urdf.xacro"
    macro = f"""<xacro:macro name="m" params="a:={"a" * 60}'"/>"""
    file.write_text(HEAD + macro + ONE.replace("LENGTH", "0.3"))
    assert ik.Robot.load(file).n == 1


@pytest.mark.parametrize("encoding", ["iso-8859-1", "utf-16", "shift_jis"])
def test_declared_encodings(tmp_path, encoding):
    from ik_toolkit.robot.formats.xacro import expand

    name = "ア" if encoding == "shift_jis" else "Gelenk_ä"
    file = tmp_path / "arm.urdf.xacro"
    file.write_bytes(
        f'<?xml version="1.0" encoding="{encoding}"?>{HEAD}<link name="{name}${{1+1}}"/></robot>'.encode(encoding)
    )
    assert f'<link name="{name}2"/>' in expand(file)
