"""Xacro files: arguments, packages and includes; and files that attempt forbidden operations."""

import pytest

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption, ModelError

pytest.importorskip("xacro")

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
        ("""<link name="${env('HOME')}"/>""", "'env' is not defined"),
        ('<xacro:include filename="package://nowhere/x.xacro"/>', "no package 'nowhere'"),
        ('<xacro:include filename="package://../x.xacro"/>', "no package '..'"),
        ('<xacro:include filename="none.xacro"/>', "there is no file"),
        ("""<link name="${xacro.load_yaml('/etc/hostname')}"/>""", "reads '/etc/hostname'"),
        ('<xacro:include filename="/etc/passwd"/>', "reads '/etc/passwd'"),
        ('<xacro:include filename="../../secret.xacro"/>', "secret.xacro', which is not allowed"),
        ('<xacro:include filename="$(find ../..)/x"/>', "no package"),
        ('<xacro:macro name="m" params=""><xacro:m/></xacro:macro><xacro:m/>', "recursion"),
        ('<link name="${nobody}"/>', "'nobody' is not defined"),
        ('<link name="${[x for x in range(10**12)]}"/>', "cannot be expanded"),
        ("<xacro:seg/>", "seg"),
    ],
)
def test_hostile_files_are_harmless(tmp_path, inside, said):
    (tmp_path / "secret.xacro").write_text(f'{HEAD}<link name="secret"/></robot>')
    file = tmp_path / "a" / "b" / "arm.xacro"
    file.parent.mkdir(parents=True)
    file.write_text(f'{HEAD}<link name="l0"/>{inside}</robot>')
    with pytest.raises(ModelError, match=r"'arm\.xacro' cannot be expanded") as caught:
        ik.Robot.load(file)
    assert said in str(caught.value) and "Error" not in str(caught.value) and len(str(caught.value)) < 400


def test_arguments_are_checked(package, tmp_path):
    with pytest.raises(InvalidOption, match="xacro_args must map names to strings or numbers"):
        ik.Robot.load(package / "urdf" / "arm.urdf.xacro", xacro_args={"length": [1]})
    with pytest.raises(InvalidOption, match="hydrolek_7w is a plain URDF"):
        ik.Robot.load("hydrolek_7w", xacro_args={"length": 1})
