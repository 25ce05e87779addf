"""Names, paths and text find their robot; the shipped files are those the script writes."""

import importlib.machinery
import importlib.util
import sys
import tomllib
import types
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from folders import SCRIPTS, TESTS
from robots import have_data, urdf

import ik_toolkit as ik
from ik_toolkit.errors import MissingExtra, ModelError, RobotNotFound
from ik_toolkit.robot import library
from ik_toolkit.robot.library import DATA_ROBOTS, example_robot_data, find, list_robots, shipped_robots
from ik_toolkit.robot.load import read_source

SCRIPT = SCRIPTS / "make_urdfs.py"
PAPERS = {"hydrolek_7w", "brokk_hydrolek", "planar_3r", "planar_2r", "cartesian_pp", "inspection_7dof"}
NAMES = list(shipped_robots())


def test_shipped_files_are_what_the_script_writes():
    spec = importlib.util.spec_from_file_location("make_urdfs", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    written = module.robots()
    from_tables = [entry for entry in shipped_robots().values() if entry.dh_file is not None]
    assert sorted(written) == sorted(entry.path.name for entry in from_tables)
    for entry in from_tables:
        assert entry.path.read_text(encoding="utf-8") == written[entry.path.name], f"run {SCRIPT.name}"


def test_robots_toml_has_no_second_reach():
    rows = tomllib.loads((library.urdf_folder() / "robots.toml").read_text())
    assert list(rows) == NAMES and set(NAMES) >= PAPERS
    assert all("reach" not in row for row in rows.values())


def test_brokk():
    """Both arms are HydroLeks on one turret; the grippers move nothing on the paths."""
    entry = find("brokk_hydrolek")
    model = pin.buildModelFromUrdf(str(entry.path), True)
    arm = pin.buildModelFromUrdf(str(find("hydrolek_7w").path), True)
    data, arm_data = model.createData(), arm.createData()
    assert entry.tip is None and entry.tips == ("left_tip", "right_tip")
    rng = np.random.default_rng(3)
    q = rng.uniform(model.lowerPositionLimit, model.upperPositionLimit)
    pin.framesForwardKinematics(model, data, q)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        own = [model.joints[model.getJointId(f"{side}_{joint}")].idx_q for joint in list(arm.names)[1:]]
        pin.framesForwardKinematics(arm, arm_data, q[own])
        T_world_turret = data.oMi[model.getJointId("turret")]
        T_turret_mount = pin.SE3(np.eye(3), np.array([0.22, 0.27 * sign, 0.44]))
        expected = T_world_turret * T_turret_mount * arm_data.oMf[arm.getFrameId("tool")]
        got = data.oMf[model.getFrameId(f"{side}_tip")]
        assert np.abs(expected.homogeneous - got.homogeneous).max() < 1e-12
        assert model.joints[model.getJointId(f"{side}_gripper")].nq == 1
        before = got.copy()
        moved = q.copy()
        moved[model.joints[model.getJointId(f"{side}_gripper")].idx_q] = 0.0
        pin.framesForwardKinematics(model, data, moved)
        assert np.array_equal(data.oMf[model.getFrameId(f"{side}_tip")].homogeneous, before.homogeneous)


def test_find_by_path_text_and_name(tmp_path, monkeypatch):
    shipped = find("planar_2r")
    assert shipped.tip == "tool" and shipped.path.is_absolute()
    file = tmp_path / "my.urdf"
    file.write_text('<robot name="r"/>')
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    for source in (file, str(file), "my.urdf", "./my.urdf", "~/my.urdf"):
        entry = find(source)
        assert (entry.name, entry.path, entry.tip, entry.home) == ("my", file, None, None)
    text = find(" \n<robot name='x'/>")
    assert text.path is None and text.source == " \n<robot name='x'/>"


def test_a_path_may_be_a_name_and_text_needs_to_be_text():
    assert ik.Robot.load(Path("planar_2r")).joint_names == ik.Robot.load("planar_2r").joint_names
    for wrong in (None, 5, "planar_2r"):
        with pytest.raises(RobotNotFound, match=f"there is no file '{wrong}'; Robot.load takes names"):
            ik.Robot.from_urdf(wrong)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("hydrolek", "Did you mean 'hydrolek_7w'?"),
        ("pandas", "Did you mean 'panda'?"),
        ("somewhere/arm.urdf", "there is no file 'somewhere/arm.urdf'"),
        ("arm.urdf", "there is no file 'arm.urdf'"),
        ("", "there is no robot and no file ''"),
        ("a\0b", "there is no robot"),
        ("x" * 10_000, "there is no robot"),
        (7, "not int"),
        (str(TESTS), "contains no robot description"),
    ],
)
def test_not_found(source, message):
    with pytest.raises(RobotNotFound) as caught:
        find(source)
    assert message in str(caught.value) and len(str(caught.value)) < 1000


def test_without_the_data_wheel(monkeypatch):
    monkeypatch.setattr(library, "DATA_PACKAGE", "no-such-distribution")
    said = "no-such-distribution is not installed; run: pip install example-robot-data"
    with pytest.raises(MissingExtra, match=said):
        find("panda")
    assert [entry.name for entry in list_robots()] == NAMES


def test_data_robots_are_listed():
    if have_data():
        assert [entry.name for entry in list_robots()] == [*NAMES, *DATA_ROBOTS]
    with pytest.raises(RobotNotFound, match="Did you mean 'panda'"):
        example_robot_data("pandaa")


@pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed")
def test_every_file_of_example_robot_data_has_a_name():
    """All load except one empty file; unknown tips are guessed or must be given."""
    names = [entry.name for entry in list_robots(everything=True)]
    assert len(names) == len(set(names)) > 60
    refused = []
    for name in names:
        try:
            read_source(name, ())
        except ModelError:
            refused.append(name)
    assert refused == ["ur_ur3"]


def test_robot_descriptions_from_its_cache(tmp_path, monkeypatch):
    """The package is stood in for: it fetches from the network what it does not have."""
    (tmp_path / "arm.urdf").write_text(urdf(dict(kind="revolute")))
    known = types.SimpleNamespace(has_urdf=True)
    stand_in = types.ModuleType("robot_descriptions")
    stand_in.DESCRIPTIONS = {"arm_description": known, "gone_description": known}
    stand_in.__spec__ = importlib.machinery.ModuleSpec("robot_descriptions", None)
    stand_in.__path__ = []
    arm = types.ModuleType("robot_descriptions.arm_description")
    arm.URDF_PATH, arm.PACKAGE_PATH, arm.REPOSITORY_PATH = str(tmp_path / "arm.urdf"), str(tmp_path), str(tmp_path)
    monkeypatch.setitem(sys.modules, "robot_descriptions", stand_in)
    monkeypatch.setitem(sys.modules, "robot_descriptions.arm_description", arm)
    assert ik.Robot.load("robot_descriptions:arm_description").n == 1
    entry = find("robot_descriptions:arm_description")
    assert entry.name == "arm_description" and entry.description == "robot_descriptions: arm_description"
    assert entry.package_dirs == (tmp_path, tmp_path) and entry.xacro_args == {}
    arm.XACRO_ARGS = {"length": 3}
    assert find("robot_descriptions:arm_description").xacro_args == {"length": "3"}
    with pytest.raises(RobotNotFound, match="python -m robot_descriptions pull gone_description"):
        find("robot_descriptions:gone_description")
    with pytest.raises(RobotNotFound, match="robot_descriptions has no 'arn'"):
        find("robot_descriptions:arn")
    arm.URDF_PATH, arm.MJCF_PATH = None, str(tmp_path / "arm.xml")
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    assert find("robot_descriptions:arm_description").path == tmp_path / "arm.xml"


def test_every_robot_by_name_says_what_it_is():
    assert all(robot.description for robot in list_robots(everything=True))
