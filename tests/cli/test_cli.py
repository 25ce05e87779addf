"""The command `ik`: what it prints, what it returns, and how it speaks of mistakes."""

import json
import math
import os
import re
import subprocess
import sys

import numpy as np
import pytest
import robots
from folders import ROOT
from typer.testing import CliRunner

import ik_toolkit as ik
from ik_toolkit import cli, errors
from ik_toolkit.cli import common

DH = str(ROOT / "urdf" / "dh" / "inspection_7dof.toml")
SOLVE = ["solve", "hydrolek_7w", "--xyz", "1.0", "0.1", "0.2"]


@pytest.fixture
def run(capsys, monkeypatch):
    """Run a command line; returns exit code, stdout, stderr."""
    monkeypatch.setenv("COLUMNS", "100")

    def call(*arguments):
        code = cli.main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


# -------------------------------------------------------------------------------------------------------- reading argv
def test_numbers_after_a_vector_option_are_joined():
    joined = common.join_vectors(["fk", "arm", "--q", "1", "-2e-1", ".3", "--deg", "--xyz", "1,2", "-3", "--seed", "4"])
    assert joined == ["fk", "arm", "--q=1,-2e-1,.3", "--deg", "--xyz=1,2,-3", "--seed", "4"]


@pytest.mark.parametrize("argv", [["--q=1,2", "3"], ["--q", "word"], ["--", "--q", "1", "2"], ["--q"], ["--q", ""]])
def test_other_arguments_are_left_alone(argv):
    assert common.join_vectors(argv) == argv


@pytest.mark.parametrize(
    "q", [["20", "0.22", "20", "0", "20", "0", "20"], ["20,0.22,20,0,20,0,20"], ["20 .22 20 0 20 0 20"]]
)
def test_fk_in_degrees_leaves_sliding_joints_in_metres(run, q):
    code, out, _ = run("fk", "inspection_7dof", "--deg", "--q", *q)
    assert code == 0
    assert "(0.4615787, 0.0870954, 0.9350900) m" in out
    assert "0.22 m" in out and "20 deg" in out


def test_fk_takes_negative_numbers_and_says_the_same_as_python(run):
    q = [-0.1, 0.2, -0.3, 0.0, -0.5, 1.5]
    code, out, _ = run("fk", "hydrolek_7w", "--q", *q, "--json")
    robot = ik.Robot.load("hydrolek_7w")
    pose = json.loads(out)
    assert code == 0 and pose["q"] == q and pose["joint_names"] == list(robot.joint_names)
    assert np.allclose(pose["T_base_tip"], robot.fk(q).homogeneous, atol=1e-15)
    assert np.allclose(ik.pose(pose["xyz"], rpy=pose["rpy"]), pose["T_base_tip"], atol=1e-12)
    assert np.allclose(ik.pose(pose["xyz"], quat_xyzw=pose["quat_xyzw"]), pose["T_base_tip"], atol=1e-12)


def test_json_is_in_radians_whatever_deg_says(run):
    _, plain, _ = run("fk", "planar_2r", "--q", math.radians(30), math.radians(-45), "--json")
    _, degrees, _ = run("fk", "planar_2r", "--q", 30, -45, "--deg", "--json")
    assert json.loads(plain) == json.loads(degrees)


def test_fk_says_what_is_outside_the_limits(run):
    code, _, err = run("fk", "hydrolek_7w", "--q", 3, 0, 0, 0, 0, 0)
    assert code == 0 and err.startswith("outside the limits: azimuth_yaw")


# ------------------------------------------------------------------------------------------------------------- solving
def test_solve_prints_joints_that_reach_the_target(run):
    code, out, err = run(*SOLVE, "--json")
    answer = json.loads(out)
    robot = ik.Robot.load("hydrolek_7w")
    assert code == 0 and answer["success"] and answer["status"] == "CONVERGED"
    assert np.linalg.norm(robot.fk(answer["q"]).translation - (1.0, 0.1, 0.2)) < 1e-6
    assert (answer["base"], answer["tip"], answer["target"]) == ("base_link", "tool", [1.0, 0.1, 0.2])


def test_solve_table_shows_joints_errors_counts_and_time(run):
    code, out, _ = run(*SOLVE)
    robot = ik.Robot.load("hydrolek_7w")
    assert code == 0 and all(name in out for name in robot.joint_names)
    for word in ("rad", "CONVERGED, solver lm", "position error", "orientation error  free", "restarts", "time"):
        assert word in out


def test_solve_a_pose_in_degrees(run):
    robot = ik.Robot.load("hydrolek_7w")
    rpy = (-90.0, 10.0, -70.0)
    code, out, _ = run("solve", "hydrolek_7w", "--xyz", 1.0, 0.2, 0.1, "--rpy", *rpy, "--deg", "--json")
    answer = json.loads(out)
    wanted = ik.pose((1.0, 0.2, 0.1), rpy=np.radians(rpy))
    assert code == 0 and np.allclose(robot.fk(answer["q"]).homogeneous, wanted, atol=1e-5)
    code, shown, _ = run("solve", "hydrolek_7w", "--xyz", 1.0, 0.2, 0.1, "--rpy", *rpy, "--deg")
    assert code == 0 and f"{math.degrees(answer['q'][1]):.4f}" in shown


def test_unreachable_target_says_by_how_much_and_returns_one(run):
    code, out, err = run("solve", "hydrolek_7w", "--xyz", 5, 0, 0)
    assert code == 1 and "UNREACHABLE" in out
    assert "beyond reach by 3556 mm" in err and "Traceback" not in err
    code, out, _ = run("solve", "hydrolek_7w", "--xyz", 5, 0, 0, "--json")
    assert code == 1 and json.loads(out)["status"] == "UNREACHABLE"


@pytest.mark.parametrize("solver", ["lm", "dls", "ccd", "state-space"])
def test_solve_with_a_named_solver(run, solver):
    code, out, _ = run(*SOLVE, "-s", solver, "--tolerance", "1e-3", "--json")
    answer = json.loads(out)
    assert code == 0 and answer["solver"] == solver and answer["position_error"] < 1e-3


def test_solver_parameters_and_limits_of_effort_are_passed_on(run):
    few = json.loads(run(*SOLVE, "-s", "dls", "-p", "damping=0.5", "--max-iterations", 3, "--json")[1])
    many = json.loads(run(*SOLVE, "-s", "dls", "-p", "damping=0.01", "--max-iterations", 50, "--json")[1])
    assert (few["status"], few["iterations"]) == ("ITERATION_LIMIT", 3) and many["success"]


def test_start_outside_the_limits_is_clamped_with_a_notice_or_refused(run):
    start = ["--q0", 3, 0, 0, 0, 0, 0]
    code, out, err = run(*SOLVE, *start, "--json")
    assert code == 0 and "was clamped" in err and "azimuth_yaw" in json.loads(out)["notice"]
    code, out, err = run(*SOLVE, *start, "--refuse-q0")
    assert code == 2 and not out and "outside the limits at joint azimuth_yaw" in err


def test_a_locked_joint_keeps_its_value(run):
    answer = json.loads(run(*SOLVE, "--lock", "wrist_roll=90", "--deg", "--json")[1])
    assert answer["success"] and "wrist_roll" not in answer["joint_names"] and len(answer["q"]) == 5
    robot = ik.Robot.load("hydrolek_7w").locked({"wrist_roll": math.pi / 2})
    assert np.linalg.norm(robot.fk(answer["q"]).translation - (1.0, 0.1, 0.2)) < 1e-6


def test_a_sliding_joint_is_locked_in_metres_even_with_deg(run):
    info = json.loads(
        run("info", "inspection_7dof", "--lock", "lift=0.3", "--lock", "arm_yaw=30", "--deg", "--json")[1]
    )
    assert info["locked"] == {"lift": 0.3, "arm_yaw": math.radians(30)}


def test_output_file_holds_the_object(run, tmp_path):
    file = tmp_path / "answer.json"
    code, out, err = run(*SOLVE, "--json", "-o", file)
    assert code == 0 and f"wrote {file}" in err
    assert json.loads(file.read_text()) == json.loads(out)


# -------------------------------------------------------------------------------------------------- lists and files
def test_robots_lists_the_shipped_ones(run):
    code, out, _ = run("robots")
    names = {row["name"] for row in json.loads(run("robots", "--json")[1])["robots"] if row["shipped"]}
    assert code == 0 and {"hydrolek_7w", "brokk_hydrolek", "inspection_7dof"} <= names
    assert all(name in out for name in names)


def test_info_shows_joints_limits_and_the_dh_table(run):
    code, out, _ = run("info", "hydrolek_7w", "--deg")
    assert code == 0
    for word in (
        "azimuth_yaw",
        "-27.0700",
        "40.6000",
        "base_link -> tool",
        "D-H table, classic",
        "q - 90.0000",
        "Burrell",
    ):
        assert word in out
    info = json.loads(run("info", "hydrolek_7w", "--json")[1])
    robot = ik.Robot.load("hydrolek_7w")
    assert [joint["upper"] for joint in info["joints"]] == robot.upper.tolist() and info["reach"] == robot.reach
    assert info["dh"]["rows"][1]["a"] == 0.5234


def test_info_of_a_robot_with_two_tips_shows_both(run):
    code, out, _ = run("info", "brokk_hydrolek")
    assert code == 0 and "world -> left_tip" in out and "world -> right_tip" in out
    assert [arm["tip"] for arm in json.loads(run("info", "brokk_hydrolek", "--json")[1])["arms"]] == [
        "left_tip",
        "right_tip",
    ]


def test_solvers_lists_every_row_and_the_parameters_of_one(run):
    from ik_toolkit.solvers.registry import ROWS

    code, out, _ = run("solvers")
    assert code == 0 and all(row.name in out for row in ROWS)
    code, out, _ = run("solvers", "lm")
    assert code == 0 and "damping" in out and "0.02" in out and "Sugihara" in out
    shown = json.loads(run("solvers", "pid", "--json")[1])
    assert [parameter["name"] for parameter in shown["parameters"]] == list(ik.PID._fields)
    assert shown["options"]["restarts"] == 0


def test_dh_writes_a_urdf_that_loads(run, tmp_path):
    file = tmp_path / "made.urdf"
    code, out, err = run("dh", DH, "-o", file)
    assert code == 0 and not out and f"wrote {file}" in err
    made, shipped = ik.Robot.load(file), ik.Robot.load("inspection_7dof")
    assert np.allclose(made.fk(shipped.home).homogeneous, shipped.fk(shipped.home).homogeneous, atol=1e-12)
    assert run("dh", DH)[1] == file.read_text()


def test_check_finds_nothing_or_says_what(run, tmp_path):
    assert run("check", "hydrolek_7w")[0] == 0
    file = tmp_path / "bad.urdf"
    file.write_text(
        "<robot name='r'><link name='a'/><joint name='j' type='fixed'><parent link='b'/><child link='a'/></joint></robot>"
    )
    code, out, _ = run("check", file)
    assert code == 1 and "error" in out and "joint 'j'" in out
    found = json.loads(run("check", file, "--json")[1])
    assert not found["loadable"] and found["errors"] >= 1 and found["findings"][0]["severity"] == "error"


def test_doctor_finds_this_machine_healthy(run):
    code, out, _ = run("doctor", "--json")
    checks = {row["what"]: row["state"] for row in json.loads(out)["checks"]}
    assert code == 0 and checks["pin"] == checks["robots"] == checks["pinocchio"] == "ok"
    assert {"extra view", "extra panel", "extra plots", "extra tune"} <= set(checks)


def test_doctor_says_the_pip_line_of_a_missing_extra(run, monkeypatch):
    from ik_toolkit.cli import doctor

    real = doctor._installed
    monkeypatch.setattr(doctor, "_installed", lambda package: None if package == "viser" else real(package))
    code, out, _ = run("doctor")
    assert code == 0 and "no viser; run: pip install viser" in out


def test_doctor_reports_a_package_that_hides_pinocchio(run, monkeypatch):
    from ik_toolkit.cli import doctor

    real = doctor._installed
    monkeypatch.setattr(doctor, "_installed", lambda package: "0.4" if package == "pinocchio" else real(package))
    code, out, _ = run("doctor")
    assert code == 1 and "pip uninstall pinocchio" in " ".join(out.split())


# ------------------------------------------------------------------------------------------------------------ mistakes
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["slove"], "Did you mean 'solve'"),
        (["solve"], "Missing argument 'ROBOT'"),
        (["solve", "hydrolek_7w"], "Missing option '--xyz'"),
        (["solve", "hydrolec_7w", "--xyz", "1", "0", "0"], "Did you mean 'hydrolek_7w'"),
        (["solve", "nowhere.urdf", "--xyz", "1", "0", "0"], "there is no file 'nowhere.urdf'"),
        (["solve", "hydrolek_7w", "--xyz", "1", "0"], "--xyz takes 3 numbers; got 2"),
        (["solve", "hydrolek_7w", "--xyz", "nan", "0", "0"], "finite"),
        (["solve", "hydrolek_7w", "--xyz", "1", "0", "inf"], "finite"),
        (["solve", "hydrolek_7w", "--xyz", "here"], "--xyz takes numbers, not 'here'"),
        ([*SOLVE, "--rpy", "0", "0"], "--rpy takes 3 numbers"),
        ([*SOLVE, "--quat-xyzw", "0", "0", "0", "0"], "quat_xyzw has length 0"),
        ([*SOLVE, "--rpy", "0", "0", "0", "--quat-xyzw", "0", "0", "0", "1"], "give one of rpy"),
        ([*SOLVE, "-s", "ml"], "Did you mean 'lm'"),
        ([*SOLVE, "-p", "dampng=1"], "Did you mean 'damping'"),
        ([*SOLVE, "-p", "damping"], "-p takes NAME=VALUE"),
        ([*SOLVE, "-p", "damping=much"], "takes a number"),
        ([*SOLVE, "--tolerance", "-1"], "must be between 0"),
        ([*SOLVE, "--tolerance", "small"], "Invalid value for '--tolerance'"),
        ([*SOLVE, "--max-iterations", "-5"], "max_iterations"),
        ([*SOLVE, "--tip", "tol"], "Did you mean 'tool'"),
        ([*SOLVE, "--base", "bas_link"], "Did you mean 'base_link'"),
        ([*SOLVE, "--q0", "1", "2"], "--q0 takes 6 values, one per joint (azimuth_yaw"),
        ([*SOLVE, "--q0", "nan", "0", "0", "0", "0", "0"], "--q0 is not finite at joint azimuth_yaw"),
        ([*SOLVE, "--lock", "wrist=1"], "Did you mean 'wrist_"),
        ([*SOLVE, "--all", "--closest", *"000000"], "--all lists the solutions nearest to --q0"),
        ([*SOLVE, "--all", "--objective", "mid-range"], "takes no 'objective'"),
        ([*SOLVE, "--lock", "wrist_roll"], "--lock takes NAME=VALUE"),
        ([*SOLVE, "--lock", "wrist_roll=up"], "takes one number"),
        ([*SOLVE, "-o", "no/such/folder/file.json"], "there is no folder"),
        ([*SOLVE, "--bogus"], "No such option: --bogus"),
        (["solve", "brokk_hydrolek", "--xyz", "1", "0", "0"], "choose one with --tip: left_tip, right_tip"),
        (["fk", "hydrolek_7w", "--q", "1"], "--q takes 6 values"),
        (["solvers", "lmm"], "Did you mean 'lm'"),
        (["dh", "nothing.toml"], "cannot read"),
        (["check", "nothing.urdf"], "there is no file"),
    ],
    ids=lambda value: " ".join(value[-4:]) if isinstance(value, list) else None,
)
def test_a_mistake_is_one_sentence_and_exit_code_two(run, arguments, says):
    code, out, err = run(*arguments)
    assert code == 2 and not out
    assert err.startswith("ik: ") and err.count("\n") == 1 and says in err


def test_a_missing_extra_is_exit_code_three(run, monkeypatch):
    from ik_toolkit.cli import solvers
    from ik_toolkit.errors import MissingExtra

    def fail(row, as_json):
        raise MissingExtra("meshcat", "view")

    monkeypatch.setattr(solvers, "_one", fail)
    code, _, err = run("solvers", "lm")
    assert code == 3 and "run: pip install meshcat pycollada trimesh yourdfpy" in err


def test_a_bug_is_a_short_message_unless_debug(run, monkeypatch):
    from ik_toolkit.cli import solvers

    def fail(row, as_json):
        raise ZeroDivisionError("inner\ndetails")

    monkeypatch.setattr(solvers, "_one", fail)
    code, _, err = run("solvers", "lm")
    assert code == 70 and "unexpected ZeroDivisionError: inner (" in err and "Traceback" not in err
    with pytest.raises(ZeroDivisionError):
        run("solvers", "lm", "--debug")


def test_ctrl_c_is_exit_code_130(run, monkeypatch):
    from ik_toolkit.cli import solvers

    def fail(row, as_json):
        raise KeyboardInterrupt

    monkeypatch.setattr(solvers, "_one", fail)
    assert run("solvers", "lm")[0] == 130


def test_help_of_every_command():
    runner = CliRunner()
    app = cli.application()
    overview = runner.invoke(app, ["--help"])
    assert overview.exit_code == 0
    for name in ("robots", "info", "fk", "solve", "solvers", "dh", "check", "doctor"):
        assert name in overview.stdout
        assert runner.invoke(app, [name, "--help"]).exit_code == 0


def test_no_command_shows_the_help(run):
    code, out, _ = run()
    assert code == 0 and "Usage: ik" in out


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["robots"], 0),
        (["robots", "--json"], 0),
        (["--help"], 0),
        (["dh", DH], 0),
        (["check", "tests/data/nothing.urdf"], 2),
        (["solve", "planar_2r", "--xyz", "1", "1", "0"], 0),
        (["solve", "planar_2r", "--xyz", "3", "0", "0", "--json"], 1),
        (["solve", "planar_2r", "--xyz", "3", "0", "0"], 1),
    ],
)
def test_a_reader_that_leaves_early_changes_nothing(arguments, code):
    command = [sys.executable, "-m", "ik_toolkit", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout and process.stderr
    process.stdout.close()
    with process.stderr as stderr:
        said = stderr.read()
    assert process.wait() == code
    assert b"pipe" not in said.lower() and (b"ik: " in said or b"not solved" in said) == (code > 0)


def test_a_terminal_that_lacks_characters_shows_escapes(tmp_path):
    (tmp_path / "\u00e4rm.urdf").write_text(robots.urdf(dict(kind="revolute")), encoding="utf-8")
    command = [sys.executable, "-m", "ik_toolkit", "info", str(tmp_path / "\u00e4rm.urdf")]
    ascii_only = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, capture_output=True, env=ascii_only)
    assert done.returncode == 0 and rb"\xe4rm" in done.stdout


def test_all_with_a_direction_gives_a_spread_and_a_pose_in_json(run):
    robot = ik.Robot.load("hydrolek_7w")
    T = robot.fk(robot.home)
    words = ["--xyz", *T.translation, "--direction", *T.rotation[:, 2], "--all", "--json"]
    found = json.loads(run("solve", "hydrolek_7w", *words)[1])
    assert len(found["solutions"]) == 64 and "a sample of infinitely many" in found["message"]
    assert np.shape(found["target"]) == (4, 4)


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


def test_solve_takes_preferences(run):
    code, out, _ = run(
        "solve",
        "inspection_7dof",
        "--xyz",
        "0.4",
        "0.1",
        "0.9",
        "--direction",
        "0",
        "0",
        "-1",
        "--tip-axis",
        "1",
        "0",
        "0",
        "--json",
    )
    assert code == 0
    robot = ik.Robot.load("inspection_7dof")
    at = robot.fk(json.loads(out)["q"])
    assert np.allclose(at.rotation[:, 0], (0, 0, -1), atol=1e-5)
    code, out, _ = run(
        "solve", "inspection_7dof", "--xyz", "0.4", "0.1", "0.9", "--mask", "1", "1", "0", "0", "0", "0",
        "--joint-weights", "1", "0", "1", "1", "1", "1", "1", "--closest", "0", "0.2", "0", "0", "0", "-1", "0",
        "--objective", "mid-range", "--json",
    )  # fmt: skip
    answer = json.loads(out)
    assert code == 0 and answer["q"][1] == pytest.approx(0.2)
    assert np.allclose(robot.fk(answer["q"]).translation[:2], (0.4, 0.1), atol=1e-6)
    code, _, err = run("solve", "inspection_7dof", "--xyz", "0.4", "0.1", "0.9", "--tip-axis", "1", "0", "0")
    assert code == 2 and "--direction" in err
    code, _, err = run("solve", "inspection_7dof", "--xyz", "0.4", "0.1", "0.9", "--objective", "midrange")
    assert code == 2 and "mid-range" in err


@pytest.mark.parametrize(
    "words",
    [
        "bench planar_2r -o no/x.json",
        "bench planar_2r --plot no/x.png",
        "tune planar_3r pid -o no/x.toml",
        "tune planar_3r pid --plot no/x.png",
        "workspace planar_3r --csv no/x.csv",
        "workspace planar_3r --html no/x.html",
        "track planar_3r -o no/x.npz",
        "view planar_3r --html no/x.html",
        "track planar_3r --plot folder.png",
        "track planar_3r --plot x.gif",
    ],
)
def test_an_output_that_cannot_be_written_is_refused_before_the_work(run, words, tmp_path, monkeypatch):
    from ik_toolkit.cli import common

    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.png").mkdir()
    monkeypatch.setattr(common, "load_robot", lambda *_: pytest.fail("the work has started"))
    code, out, err = run(*words.split())
    assert code == 2 and out == "" and err.count("\n") == 1
    assert "there is no folder 'no'" in err or "is a folder" in err or "must end in" in err


# ------------------------------------------------------------------------------------------------------- words of caution
TWO = """<robot name="two"><link name="base"/><link name="a"/><link name="b"/>
<joint name="ja" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/><origin xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="jb" type="prismatic"><parent link="base"/><child link="b"/><axis xyz="0 0 1"/><origin xyz="2 0 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def test_info_of_a_file_with_several_tips_lists_them(run, tmp_path):
    (tmp_path / "two.urdf").write_text(TWO)
    code, out, err = run("info", tmp_path / "two.urdf")
    assert code == 0 and not err and all(word in out for word in ("ja", "jb", "--tip", "two.urdf"))
    told = json.loads(run("info", tmp_path / "two.urdf", "--json")[1])
    assert told["tips"] == ["a", "b"] and [arm["joints"][0]["name"] for arm in told["arms"]] == ["ja", "jb"]
    assert json.loads(run("info", tmp_path / "two.urdf", "--tip", "b", "--json")[1])["tip"] == "b"
    assert run("info", tmp_path / "two.urdf", "--tip", "c")[0] == 2


def test_angles_that_look_like_degrees_are_doubted_once(run, caplog):
    errors.DOUBTED.clear()
    code, _, err = run("fk", "planar_2r", "--q", "90", "1.5")
    assert code == 0 and "q, joint joint_1: 90 rad is 14.3 turns; were degrees meant?" in err and "joint_2" not in err
    assert "degrees meant" not in run("fk", "planar_2r", "--q", "90", "45", "--deg")[2]
    assert "rpy: 180 rad" in run("solve", "hydrolek_7w", "--xyz", "1", "0.1", "0.2", "--rpy", "0", "180", "0")[2]
    caplog.clear()
    robot = ik.Robot.load("planar_2r")
    for _ in range(3):
        robot.fk([12.5, 45])
        ik.pose((1, 0, 0), rpy=(12.5, -12.5, 0))
    assert [record.getMessage() for record in caplog.records] == [
        "q, joint joint_2: 45 rad is 7.16 turns; were degrees meant?"
    ]
    assert ik.Robot.load("cartesian_pp").fk([90, 45]) is not None and len(caplog.records) == 1


def test_angles_that_limits_allow_are_not_taken_for_degrees(caplog):
    far = robots.urdf(
        dict(kind="revolute", limits=(20.0, 30.0)), dict(kind="revolute", axis="0 1 0", limits=(-2.0, 2.0))
    )
    errors.DOUBTED.clear()
    robot = ik.Robot.load(far)
    robot.with_tool((0.1, 0, 0)).locked({"j1": 0.2})  # nobody typed the home that these check again
    q = np.array([23.0, 0.5])
    assert ik.solve(robot, robot.fk(q), "lm", q0=q, mask=(1, 1, 1, 0, 0, 0)).success
    assert not caplog.records
    robot.fk([45, 0.5])
    assert [record.getMessage() for record in caplog.records] == [
        "q, joint j0: 45 rad is 7.16 turns; were degrees meant?"
    ]


def test_the_answer_to_a_partial_target_is_not_doubted_as_if_typed(caplog):
    robot = ik.Robot.load(robots.urdf(dict(kind="continuous"), dict(kind="revolute", axis="0 1 0")))
    errors.DOUBTED.clear()
    assert ik.solve(robot, robot.fk([0.1, 0.5]), "lm", q0=[14.0, 0.5], mask=(1, 1, 1, 0, 0, 0)).success
    assert [record.getMessage()[:2] for record in caplog.records] == ["q0"]
