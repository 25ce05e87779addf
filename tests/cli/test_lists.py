"""Commands that list robots, solvers, D-H tables and the state of the machine."""

import importlib.metadata
import json
import re

import numpy as np
import pytest
from folders import ROOT
from rich.cells import cell_len
from robots import FORK, joint

import ik_toolkit as ik
from ik_toolkit.cli.output import show, table

DH = str(ROOT / "urdf" / "dh" / "inspection_7dof.toml")


def test_robots_lists_the_shipped_ones(told, run):
    code, out, _ = run("robots")
    names = {row["name"] for row in told("robots")["robots"] if row["shipped"]}
    assert code == 0 and {"hydrolek_7w", "brokk_hydrolek", "inspection_7dof"} <= names
    assert all(name in out for name in names)


def test_info_shows_joints_limits_and_the_dh_table(told, run):
    code, out, _ = run("info", "hydrolek_7w", "--deg")
    words = ("azimuth_yaw", "-27.0700", "40.6000", "base_link -> tool", "D-H table, classic", "q - 90.0000", "Burrell")
    assert code == 0 and [word for word in words if word not in out] == []
    info, robot = told("info", "hydrolek_7w"), ik.Robot.load("hydrolek_7w")
    assert [joint["upper"] for joint in info["joints"]] == robot.upper.tolist() and info["reach"] == robot.reach
    assert info["dh"]["rows"][1]["a"] == 0.5234 and "at most 1.44" in out


def test_info_of_a_robot_with_two_tips_shows_both(told, run):
    code, out, _ = run("info", "brokk_hydrolek")
    assert code == 0 and "world -> left_tip" in out and "world -> right_tip" in out
    assert [arm["tip"] for arm in told("info", "brokk_hydrolek")["arms"]] == ["left_tip", "right_tip"]


def test_solvers_lists_every_row_and_the_parameters_of_one(told, run):
    from ik_toolkit.solvers.rows import ROWS

    code, out, _ = run("solvers")
    assert code == 0 and all(row.name in out for row in ROWS)
    code, out, _ = run("solvers", "lm")
    assert code == 0 and "damping" in out and "0.02" in out and "Sugihara" in out
    shown = told("solvers", "pid")
    assert [parameter["name"] for parameter in shown["parameters"]] == list(ik.PID._fields)
    assert shown["options"]["restarts"] == 0


def test_dh_writes_a_urdf_that_loads(run, tmp_path):
    file = tmp_path / "made.urdf"
    code, out, err = run("dh", DH, "-o", file)
    assert code == 0 and not out and f"wrote {file}" in err
    made, shipped = ik.Robot.load(file), ik.Robot.load("inspection_7dof")
    assert np.allclose(made.fk(shipped.home).homogeneous, shipped.fk(shipped.home).homogeneous, atol=1e-12)
    assert run("dh", DH)[1] == file.read_text()


def test_check_finds_nothing_or_says_what(told, run, tmp_path):
    assert run("check", "hydrolek_7w")[0] == 0
    file = tmp_path / "bad.urdf"
    file.write_text(
        "<robot name='r'><link name='a'/><joint name='j' type='fixed'><parent link='b'/><child link='a'/></joint></robot>"
    )
    code, out, _ = run("check", file)
    assert code == 1 and "error" in out and "joint 'j'" in out
    found = told("check", file, code=1)
    assert not found["loadable"] and found["errors"] >= 1 and found["findings"][0]["severity"] == "error"
    text = file.read_text().replace("<parent", "\n<origin rpv='0 0 1'/><parent").replace("link='b'", "link='x'")
    file.write_text(text.replace("<joint", "<link name='x'/><joint").replace("fixed", "continuous"))
    code, out, err = run("check", file)
    assert code == 0 and "rpv=" in out and "warning       2" in out and not err
    (found,) = told("check", file)["findings"]
    assert found["line"] == 2 and found["at_load"] and "rpv= of <origin>" in found["problem"]


def bent(leader="elbow", lift=(0.0, 0.6), own=(-3.0, 3.0), x=0.4):
    """Return a URDF of a lift and an elbow, which a last joint follows."""
    mimic = f'<mimic joint="{leader}" multiplier="-0.5" offset="0.1"/>'
    text = joint("lift", "prismatic", "base", "carriage", limits=lift) + joint("elbow", "revolute", "carriage", "arm")
    text += joint("follow", "revolute", "arm", "tool", xyz=f"{x} 0 0", limits=own, mimic=mimic)
    return f'<robot name="own"><link name="base"/>{text}</robot>'


@pytest.mark.parametrize(
    "changed",
    [{}, {"leader": "elbo"}, {"leader": "follow"}, {"lift": (0.6, 0.0)}, {"x": 400}, {"own": (-0.2, 0.2)}],
)
def test_check_says_what_loading_says(run, tmp_path, changed):
    """What cannot be loaded is an error, with the loader's sentence; what loading notes is a finding, and nothing else is said."""
    file = tmp_path / "arm.urdf"
    file.write_text(bent(**changed))
    code, out, err = run("check", file, "--json")
    found = json.loads(out)
    problems = [one["problem"] for one in found["findings"]]
    loaded = run("solve", file, "--xyz", "0.4", "0", "0.3", "--json")
    assert not err and found["loadable"] == (code == 0) == (loaded[0] != 2)
    if code:
        assert found["errors"] == 1 and loaded[2].strip() == f"ik: {problems[0]}"
    else:
        assert problems == list(ik.Robot.load(file).notes) and bool(problems) == bool(changed)


def test_check_refuses_what_has_nothing_to_move(run, tmp_path):
    file = tmp_path / "table.urdf"
    file.write_text("<robot name='table'><link name='top'/></robot>")
    assert run("check", file)[0] == 1 and run("info", file)[0] == 2


XACRO = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="parent" default="nobody"/>
<xacro:arg name="prefix" default="left_"/><link name="a"/><link name="$(arg prefix)b"/>
<joint name="$(arg prefix)j" type="continuous"><parent link="$(arg parent)"/><child link="$(arg prefix)b"/></joint></robot>"""


def test_xacro_is_expanded_with_arguments_that_may_be_empty(run, tmp_path):
    """Prefixes and suffixes of names often are."""
    pytest.importorskip("xacro")
    file, parent = tmp_path / "arm.urdf.xacro", ("--xacro-arg", "parent:=a")
    file.write_text(XACRO)
    code, out, _ = run("check", file)
    assert code == 1 and "nobody" in out
    assert "the lines are those of the URDF that ik convert writes" in out
    assert run("check", file, *parent)[0] == 0
    assert "left_j" in run("info", file, *parent)[1]
    code, out, _ = run("info", file, *parent, "--xacro-arg", "prefix:=")
    assert code == 0 and "left_j" not in out
    assert run("info", file, *parent, "--xacro-arg", "prefix")[0] == 2


def test_check_says_what_an_mjcf_loses(run, tmp_path):
    pytest.importorskip("mujoco")
    file = tmp_path / "arm.xml"
    body = '<body><geom size="1"/><joint name="j{0}" range="{1}"/>'
    file.write_text(
        f"<mujoco><worldbody>{body.format(1, '60 0')}{body.format(2, '0 60')}</body></body></worldbody></mujoco>"
    )
    code, out, _ = run("check", file)
    said = " ".join(out.split())
    assert code == 0 and "joint 'j1' has no limits, as in MuJoCo" in said and "range 60 0" in said and "j2" not in said


def test_doctor_finds_this_machine_healthy(told):
    checks = {row["what"]: row["state"] for row in told("doctor")["checks"]}
    assert checks["pin"] == checks["robots"] == checks["pinocchio"] == "ok"
    assert {"extra view", "extra panel", "extra plots", "extra tune"} <= set(checks)


@pytest.mark.parametrize(
    ("package", "version", "ends", "says"),
    [
        ("viser", None, 0, "no viser; run: pip install viser"),
        ("pinocchio", "0.4", 1, "pip uninstall pinocchio"),  # another package, which hides Pinocchio
    ],
)
def test_doctor_says_the_pip_line_that_mends(run, monkeypatch, package, version, ends, says):
    real = importlib.metadata.version

    def found(name):
        if name == package and version is None:
            raise importlib.metadata.PackageNotFoundError(name)
        return version if name == package else real(name)

    monkeypatch.setattr(importlib.metadata, "version", found)
    code, out, _ = run("doctor")
    assert code == ends and says in " ".join(out.split())


@pytest.mark.parametrize("words", ["info inspection_7dof", "robots", "solvers", "solve planar_2r --xyz 1 1 0 --all"])
def test_a_narrow_terminal_cuts_nothing_short(run, monkeypatch, words):
    wide = run(*words.split())[1]
    monkeypatch.setenv("COLUMNS", "60")
    narrow = run(*words.split())[1]
    assert "\u2026" not in wide + narrow
    for number in re.findall(r"-?[0-9]+[.][0-9]+", wide):
        assert number in narrow


def test_locked_values_are_shown_in_the_units_asked_for(run):
    words = ["info", "inspection_7dof", "--lock", "lift=0.3"]
    assert "arm_yaw = 30.0000 deg" in run(*words, "--lock", "arm_yaw=30", "--deg")[1]
    out = run(*words, "--lock", "arm_yaw=0.5")[1]
    assert "lift = 0.300000 m" in out and "arm_yaw = 0.500000 rad" in out


def test_info_of_a_file_with_several_tips_lists_them(told, run, tmp_path):
    file = tmp_path / "fork.urdf"
    file.write_text(FORK)
    code, out, err = run("info", file)
    assert code == 0 and not err and all(word in out for word in ("jb", "jc", "--tip", "fork.urdf"))
    both = told("info", file)
    assert both["tips"] == ["b", "c"] and [arm["joints"][0]["name"] for arm in both["arms"]] == ["jb", "jc"]
    assert told("info", file, "--tip", "c")["tip"] == "c"
    assert run("info", file, "--tip", "d")[0] == 2


@pytest.mark.parametrize(
    "words",
    [
        "robots --all",
        "info brokk_hydrolek",
        "solvers",
        "solvers state-space",
        "fk inspection_7dof",
        "check hydrolek_7w",
        "solve brokk_hydrolek --from-q home --deg",
    ],
)
def test_no_table_is_wider_than_80_columns(run, words, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    code, said, _ = run(*words.split())
    assert code == 0 and max(map(cell_len, said.splitlines())) <= 80 and "…" not in said


def test_a_table_too_wide_is_set_closer_before_its_names_wrap_and_numbers_never_do(capsys, monkeypatch):
    def shown(width):
        monkeypatch.setenv("COLUMNS", str(width))
        made = table("<name", ">one", ">two")
        made.add_row("a_name_of_twenty_four_ch", "-1.234567", "-2.345678")
        show(made)
        return capsys.readouterr().out

    assert "a_name_of_twenty_four_ch   -1.234567   -2.345678" in shown(60)
    assert "a_name_of_twenty_four_ch -1.234567 -2.345678" in shown(48)
    for width in (38, 20):
        narrow = shown(width)
        assert "a_name_of_twenty_four_ch" not in narrow and "-1.234567 -2.345678" in narrow


def test_a_file_name_too_wide_breaks_after_its_folder(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    made = table("<name", "<file")
    made.add_row("ur10", "ur_description/urdf/ur10.urdf")
    made.add_row("ur10_limited", "ur_description/urdf/ur10_limited.urdf")
    show(made)
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["ur10_limited", "ur_description/urdf/"] in rows and ["ur10_limited.urdf"] in rows
    assert ["ur10", "ur_description/urdf/", "ur10.urdf"] not in rows and ["ur10", "ur_description/urdf/"] in rows
