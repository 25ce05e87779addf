"""`ik solve` and `ik fk`: what they read, print and return."""

import json
import math
import re

import numpy as np
import pinocchio as pin
import pytest
import typer

import ik_toolkit as ik
from ik_toolkit.cli import application
from ik_toolkit.text import angle, length

SOLVE = ["solve", "hydrolek_7w", "--xyz", "1.0", "0.1", "0.2"]


def read(name, *words):
    """What a command line comes to, by option."""
    command = typer.main.get_command(application()).commands[name]
    return command.make_context(name, [*words]).params


def test_numbers_after_an_option_that_takes_several_are_joined():
    words = "arm --q0 1 -2e-1 .3 --deg --xyz 1,2 -3 --seed 4 --target a:1 2 3".split()
    found = read("solve", *words)
    assert (found["q0"], found["xyz"], found["seed"]) == ("1 -2e-1 .3", "1,2 -3", 4) and found["deg"]
    assert found["targets"] == ["a:1 2 3"]


@pytest.mark.parametrize(("words", "q"), [(["--q=1,2"], "1,2"), (["--q", "word"], "word"), (["--q", ""], "")])
def test_other_values_are_left_alone(words, q):
    assert read("fk", "arm", *words)["q"] == q


@pytest.mark.parametrize("words", [["--q=1,2", "3"], ["--", "--q", "1", "2"], ["--q"]])
def test_numbers_elsewhere_are_not_joined(run, words):
    code, _, err = run("fk", "planar_2r", *words)
    assert code == 2 and err.endswith("See ik fk --help\n")


@pytest.mark.parametrize(
    "q", [["20", "0.22", "20", "0", "20", "0", "20"], ["20,0.22,20,0,20,0,20"], ["20 .22 20 0 20 0 20"]]
)
def test_fk_in_degrees_leaves_sliding_joints_in_metres(run, q):
    code, out, _ = run("fk", "inspection_7dof", "--deg", "--q", *q)
    assert code == 0
    assert "(0.4615787, 0.0870954, 0.9350900) m" in out
    assert "0.22 m" in out and "20 deg" in out


def test_fk_takes_negative_numbers_and_says_the_same_as_python(told):
    q = [-0.1, 0.2, -0.3, 0.0, -0.5, 1.5]
    robot = ik.Robot.load("hydrolek_7w")
    pose = told("fk", "hydrolek_7w", "--q", *q)
    assert pose["q"] == q and pose["joint_names"] == list(robot.joint_names)
    assert np.allclose(pose["T_base_tip"], robot.fk(q).homogeneous, atol=1e-15)
    assert np.allclose(ik.pose(pose["xyz"], rpy=pose["rpy"]), pose["T_base_tip"], atol=1e-12)
    assert np.allclose(ik.pose(pose["xyz"], quat_xyzw=pose["quat_xyzw"]), pose["T_base_tip"], atol=1e-12)


def test_json_is_in_radians_whatever_deg_says(told):
    plain = told("fk", "planar_2r", "--q", math.radians(30), math.radians(-45))
    assert plain == told("fk", "planar_2r", "--q", 30, -45, "--deg")


def test_fk_says_what_is_outside_the_limits(run):
    code, _, err = run("fk", "hydrolek_7w", "--q", 3, 0, 0, 0, 0, 0)
    assert code == 0 and err.startswith("outside the limits: azimuth_yaw")


def test_solve_prints_joints_that_reach_the_target(told):
    answer, robot = told(*SOLVE), ik.Robot.load("hydrolek_7w")
    assert answer["success"] and answer["status"] == "CONVERGED"
    assert np.linalg.norm(robot.fk(answer["q"]).translation - (1.0, 0.1, 0.2)) < 1e-6
    assert (answer["base"], answer["tip"], answer["target"]) == ("base_link", "tool", [1.0, 0.1, 0.2])


def test_solve_table_shows_joints_errors_counts_and_time(run):
    code, out, _ = run(*SOLVE)
    robot = ik.Robot.load("hydrolek_7w")
    assert code == 0 and all(name in out for name in robot.joint_names)
    for word in ("rad", "CONVERGED, solver lm", "position error", "orientation error  free", "restarts", "computed in"):
        assert word in out


@pytest.mark.parametrize("form", ["--matrix 12", "--matrix 16", "--quat-wxyz", "--target", "--ee"])
def test_solve_a_pose_by_its_other_words(told, form):
    robot = ik.Robot.load("hydrolek_7w")
    wanted = robot.fk(robot.random_q(np.random.default_rng(1)))
    matrix, quat = wanted.homogeneous, pin.Quaternion(wanted.rotation)
    words = {
        "--matrix 12": ["--matrix", *matrix[:3].ravel()],
        "--matrix 16": ["--matrix", ", ".join(map(repr, matrix.ravel().tolist()))],
        "--quat-wxyz": ["--xyz", *wanted.translation, "--quat-wxyz", quat.w, quat.x, quat.y, quat.z],
        "--target": ["--target", f"tool:{matrix[0, 0]}", *matrix[:3].ravel()[1:]],
        "--ee": ["--ee", "tool", "--matrix", *matrix[:3].ravel()],
    }[form]
    answer = told("solve", "hydrolek_7w", *words)
    target = answer["target"]["tool"] if form == "--target" else answer["target"]
    assert answer["success"] and np.allclose(target, matrix, atol=1e-12)


def test_solve_for_what_joint_values_reach(told):
    robot = ik.Robot.load("inspection_7dof")
    q = [20, 0.22, 20, 0, 20, 0, 20]
    answer = told("solve", "inspection_7dof", "--from-q", *q, "--deg", "--timeout", 60)
    wanted = robot.fk([math.radians(x) if k != 1 else x for k, x in enumerate(q)]).homogeneous
    assert np.allclose(answer["target"], wanted, atol=1e-15)
    assert np.allclose(robot.fk(answer["q"]).homogeneous, wanted, atol=3e-6)
    answer = told("solve", "brokk_hydrolek", "--from-q", "home")
    tree = ik.Tree.load("brokk_hydrolek", tips=["left_tip", "right_tip"])
    for tip, T in tree.fk(tree.home).items():
        assert np.allclose(answer["target"][tip], T.homogeneous, atol=1e-15)


def test_solve_a_pose_in_degrees(told, run):
    robot = ik.Robot.load("hydrolek_7w")
    rpy = (-90.0, 10.0, -70.0)
    words = ["solve", "hydrolek_7w", "--xyz", 1.0, 0.2, 0.1, "--rpy", *rpy, "--deg"]
    answer = told(*words)
    wanted = ik.pose((1.0, 0.2, 0.1), rpy=np.radians(rpy))
    assert np.allclose(robot.fk(answer["q"]).homogeneous, wanted, atol=1e-5)
    code, shown, _ = run(*words)
    assert code == 0 and f"{math.degrees(answer['q'][1]):.4f}" in shown


def test_unreachable_target_says_by_how_much_and_returns_one(told, run):
    far = ["solve", "hydrolek_7w", "--xyz", 5, 0, 0]
    code, out, err = run(*far)
    assert code == 1 and "UNREACHABLE" in out and "beyond reach by 3.56 m" in err and "Traceback" not in err
    assert told(*far, code=1)["status"] == "UNREACHABLE"


@pytest.mark.parametrize("solver", ["dls", "ccd", "state-space"])
def test_solve_with_a_named_solver(told, solver):
    answer = told(*SOLVE, "-s", solver, "--tolerance", "1e-3")
    assert answer["solver"] == solver and answer["position_error"] < 1e-3


def test_solver_parameters_and_limits_of_effort_are_passed_on(told):
    few = told(*SOLVE, "-s", "dls", "-p", "damping=0.5", "--max-iterations", 3, code=1)
    many = told(*SOLVE, "-s", "dls", "-p", "damping=0.01", "--max-iterations", 50)
    assert (few["status"], few["iterations"]) == ("ITERATION_LIMIT", 3) and many["success"]


def test_start_outside_the_limits_is_clamped_with_a_notice_or_refused(refused, run):
    start = ["--q0", 3, 0, 0, 0, 0, 0]
    code, out, err = run(*SOLVE, *start, "--json")
    assert code == 0 and "was clamped" in err and "azimuth_yaw" in json.loads(out)["notice"]
    assert "outside the limits at joint azimuth_yaw" in refused(*SOLVE, *start, "--refuse-q0")


def test_a_locked_joint_keeps_its_value(told):
    answer = told(*SOLVE, "--lock", "wrist_roll=90", "--deg")
    assert answer["success"] and "wrist_roll" not in answer["joint_names"] and len(answer["q"]) == 5
    robot = ik.Robot.load("hydrolek_7w").locked({"wrist_roll": math.pi / 2})
    assert np.linalg.norm(robot.fk(answer["q"]).translation - (1.0, 0.1, 0.2)) < 1e-6


def test_a_joint_locked_outside_its_limits_is_told(run):
    code, _, err = run(*SOLVE, "--lock", "wrist_roll=40")
    assert code in (0, 1) and "locked outside the limits: wrist_roll" in err
    assert "outside" not in run(*SOLVE, "--lock", "wrist_roll=0.4")[2]
    assert "outside the limits: turret" in run("fk", "brokk_hydrolek", "--tip", "left_tip", "--lock", "turret=40")[2]


def test_a_sliding_joint_is_locked_in_metres_even_with_deg(told):
    info = told("info", "inspection_7dof", "--lock", "lift=0.3", "--lock", "arm_yaw=30", "--deg")
    assert info["locked"] == {"lift": 0.3, "arm_yaw": math.radians(30)}


def test_output_file_holds_the_object(run, tmp_path):
    file = tmp_path / "answer.json"
    code, out, err = run(*SOLVE, "--json", "-o", file)
    assert code == 0 and f"wrote {file}" in err
    assert json.loads(file.read_text()) == json.loads(out)


def test_all_with_a_direction_gives_a_spread_and_a_pose_in_json(told):
    robot = ik.Robot.load("hydrolek_7w")
    T = robot.fk(robot.home)
    found = told("solve", "hydrolek_7w", "--xyz", *T.translation, "--direction", *T.rotation[:, 2], "--all")
    assert len(found["solutions"]) == 64 and "64 solutions of infinitely many" in found["message"]
    assert np.shape(found["target"]) == (4, 4)


def test_solve_takes_preferences(refused, told):
    asked, robot = "solve inspection_7dof --xyz 0.4 0.1 0.9".split(), ik.Robot.load("inspection_7dof")
    at = robot.fk(told(*asked, *"--direction 0 0 -1 --tip-axis 1 0 0".split())["q"])
    assert np.allclose(at.rotation[:, 0], (0, 0, -1), atol=1e-5)
    weights = "--joint-weights 1 0 1 1 1 1 1 --closest 0 0.2 0 0 0 -1 0 --objective mid-range"
    answer = told(*asked, *"--mask 1 1 0 0 0 0".split(), *weights.split())
    assert answer["q"][1] == pytest.approx(0.2)
    assert np.allclose(robot.fk(answer["q"]).translation[:2], (0.4, 0.1), atol=1e-6)
    assert "--direction" in refused(*asked, "--tip-axis", 1, 0, 0)
    assert "mid-range" in refused(*asked, "--objective", "midrange")


def test_what_counts_on_the_command_line_is_what_it_is_in_python(refused, told):
    words = "--rpy -90 0 -70 --deg --slack 0.02 0 0 0 inf 10 --free-turn 0 0 1 --frame tip --mask 1 1 1 1 1 0"
    robot = ik.Robot.load("hydrolek_7w")
    target = ik.pose((1.0, 0.1, 0.2), rpy=np.radians([-90, 0, -70]))
    slack = [0.02, 0, 0, 0, np.inf, np.radians(10)]
    same = ik.solve(robot, target, slack=slack, free_turn=[0, 0, 1], frame="tip", mask=[1, 1, 1, 1, 1, 0])
    assert told(*SOLVE, *words.split())["q"] == same.q.tolist()
    assert "--slack takes 6 numbers" in refused(*SOLVE, "--slack", "1", "2")


def test_explain_shows_the_way_in_80_columns_and_as_json(told, run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    line = ("solve", "planar_2r", "--xyz", "0.9", "0.9", "0", "--explain")
    code, out, _ = run(*line)
    assert code == 0 and "theta_1 = psi - beta" in out and "elbow left (-)" in out and "Iterations of 'newton'" in out
    assert max(map(len, out.split("\n"))) <= 80
    made = told(*line)
    assert made["explanation"]["branches"][made["explanation"]["chosen"]]["q"] == made["q"]
    assert run(*line, "--all")[0] == 2
    code, out, _ = run("solve", "planar_2r", "--xyz", "3", "0", "0", "--explain")
    assert code == 1 and "1 m out of reach" in out


@pytest.mark.parametrize("mask", ["1 1 1 0.1 0.1 0.1", "0.2 0.2 0.2 3 3 3"])
def test_errors_stand_in_the_table_as_in_the_sentence_whatever_their_weight(told, run, mask):
    words = f"solve hydrolek_7w --xyz 5 0 0 --rpy 0 1 0 --mask {mask}".split()
    code, out, err = run(*words)
    found = told(*words, code=1)
    away, turned = re.search(r"closest ([\d.]+ m), ([\d.]+ deg)", err).groups()
    assert code == 1 and re.search(rf"position error +{away} ", out)
    assert re.search(rf"orientation error .*\({turned}\)", out)
    T = ik.pose((5, 0, 0), rpy=(0, 1, 0))
    position, rotation = ik.Robot.load("hydrolek_7w").errors(found["q"], T)
    assert (away, turned) == (length(position), angle(rotation))
