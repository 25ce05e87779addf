"""Burrell et al. (2016): poses, counts and the planar example against an independent program's numbers."""

import numpy as np
import pytest
import robots
from folders import read_data

import ik_toolkit as ik
from ik_toolkit.cli import main
from ik_toolkit.papers.burrell_2016 import paper

DATA = read_data("burrell")
SEEDS = DATA["seeds"][:2]
RULES = {
    "pid_kp_0_02": ik.PID(kp=0.02, units="mm-deg"),
    "pid_published": ik.PID.preset("burrell-2016"),
    "state_space": ik.StateSpace.preset("burrell-2016"),
    "state_space_undelayed": paper.undelayed(ik.StateSpace.preset("burrell-2016")),
    "transpose": "transpose",
}


def start(name):
    return np.radians(DATA["starts_deg"][name])


def test_poses():
    robot = robots.load("hydrolek_7w")
    for case in DATA["poses"]:
        T = robot.fk(case["q"]).homogeneous
        assert np.abs(T - case["T"]).max() < 1e-12
        assert np.abs(1000 * paper.TO_PAPER @ T[:3, 3] - case["paper_mm"]).max() < 1e-9


def test_starts_are_those_of_the_counts():
    ours = paper.starts(robots.load("hydrolek_7w"))
    for name, key in (("mid-range", "mid_range"), ("clipped zero", "clipped_zero"), ("fitted", "fitted_start")):
        assert np.abs(np.degrees(ours[name]) - DATA["starts_deg"][key]).max() < 0.01


@pytest.mark.parametrize("name", list(DATA["starts_deg"]))
@pytest.mark.parametrize("rule", list(RULES))
def test_counts(name, rule):
    # Rounding decides a goal here and there between programs: two of a thousand, never the spread between seeds.
    ours = paper.counts(robots.load("hydrolek_7w"), RULES[rule], start(name), SEEDS)
    assert np.abs(np.subtract(ours, DATA["counts"][name][rule][:2])).max() <= 2


@pytest.mark.parametrize(
    "change",
    [
        lambda rule: paper.undelayed(rule),
        lambda rule: rule._replace(axes=None),
        lambda rule: rule._replace(axes=np.asarray(rule.axes).T),
    ],
    ids=["delay", "axes", "transposed axes"],
)
def test_delay_and_axes_matter(change):
    robot = robots.load("hydrolek_7w")
    rule = change(ik.StateSpace.preset("burrell-2016"))
    ours = paper.counts(robot, rule, start("mid_range"), SEEDS[:1])[0]
    assert abs(ours - DATA["counts"]["mid_range"]["state_space"][0]) > 300


def test_units_set_the_pace():
    robot = robots.load("hydrolek_7w")
    rule = ik.StateSpace.preset("burrell-2016")

    def pace(one, seeds):
        made = [ik.solve_batch(robot, paper.goals(robot, k), one, q0=start("mid_range")) for k in seeds]
        return np.concatenate([x.iterations[x.success] for x in made]).mean()

    assert abs(pace(rule, DATA["seeds"]) - DATA["state_space_mean_iterations"]) < 0.5
    slow = rule._replace(units="si", tuned={"tolerance": 1e-3, "max_iterations": 1000})
    assert pace(slow, DATA["seeds"][:1]) > 200  # gains 17 times smaller: it gets there, slowly


def test_output_is_delayed_by_one_step():
    robot = robots.load("hydrolek_7w")
    target = paper.goals(robot, 1)[0]
    rule = ik.StateSpace.preset("burrell-2016")
    q = ik.solve(robot, target, rule, history=True, max_iterations=3, tolerance=1e-9).history["q"]
    assert (q[1] == q[0]).all()  # x(0) = 0
    e = 1000 * paper.TO_PAPER @ (target - robot.fk(q[0]).translation)
    step = np.radians(np.asarray(rule.C) @ np.asarray(rule.B) @ e)
    assert np.abs(q[2] - np.clip(q[1] + step, robot.lower, robot.upper)).max() < 1e-12
    x1 = np.asarray(rule.B) @ e
    x2 = np.asarray(rule.A) @ x1 + x1  # the error has not changed yet
    step = np.radians(np.asarray(rule.C) @ x2)
    assert np.abs(q[3] - np.clip(q[2] + step, robot.lower, robot.upper)).max() < 1e-12
    early = ik.solve(robot, target, paper.undelayed(rule), history=True, max_iterations=1, tolerance=1e-9).history["q"]
    assert (early[1] != early[0]).any()


def test_pid_is_algorithm_1():
    robot = robots.load("hydrolek_7w")
    target = paper.goals(robot, 1)[0]
    kp, ki, kd = 0.012, 1e-3, 0.08  # ki large enough to matter
    q = robot.home.copy()
    total, before = 0.0, None
    error = 1000 * np.linalg.norm(target - robot.fk(q).translation)
    for _ in range(3):
        for i in reversed(range(6)):
            total += error
            delta = kp * error + ki * total + kd * (0.0 if before is None else error - before)
            before = error
            best = q
            for sign in (1.0, -1.0):
                trial = q.copy()
                trial[i] = np.clip(q[i] + sign * np.radians(delta), robot.lower[i], robot.upper[i])
                found = 1000 * np.linalg.norm(target - robot.fk(trial).translation)
                if found < error:
                    best, error = trial, found
            q = best
    rule = ik.PID(kp=kp, ki=ki, kd=kd, units="mm-deg")
    ours = ik.solve(robot, target, rule, history=True, max_iterations=3, tolerance=1e-9)
    assert np.abs(ours.history["q"][3] - q).max() < 1e-9  # the roll, which moves no tip, included: not moving wins ties
    assert ours.fk_evaluations >= 3 * 12


@pytest.mark.parametrize("key", list(DATA["planar"]))
def test_planar_arm_leaves_the_straight_line(key):
    case = DATA["planar"][key]
    robot = robots.load("planar_3r")
    rule = paper.planar_rule(case["B"])
    for row in case["goal_5_0"]:
        result = ik.solve(
            robot, np.array([5.0, 0, 0]), rule, q0=np.zeros(3), tolerance=row["tolerance"], max_iterations=2000
        )
        assert result.success and result.iterations == row["iterations"]
        assert np.abs(np.degrees(result.q) - row["final_deg"]).max() < 2e-3
    ours = paper.counts(robot, rule, np.zeros(3), SEEDS, tolerance=0.02, max_iterations=2000)
    assert np.abs(np.subtract(ours, case["tolerance_0.02"][:2])).max() <= 2


def test_jacobian_methods_stand_still_on_the_straight_arm():
    from ik_toolkit.study.singularity import run

    robot = robots.load("planar_3r")
    assert np.abs(robot.jacobian(np.zeros(3))[:2] - [[0, 0, 0], [6, 4, 2]]).max() < 1e-12
    for solver in ("pinv", "transpose", "dls", "lm"):
        one = run(robot, np.array([5.0, 0, 0]), solver, np.zeros(3), tolerance=0.02)
        assert one.stands_still and not one.success
        assert one.manipulability[0] == 0.0 and one.condition[0] == np.inf
        moved = run(robot, np.array([5.0, 0, 0]), solver, np.array([1e-3, -5e-4, 7e-4]), tolerance=0.02)
        assert not moved.stands_still
        assert moved.success or solver == "pinv"  # its first steps are huge, into the limits


def test_published_goal_is_out_of_reach():
    robot = robots.load("hydrolek_7w")
    for unit in (1e-2, 1e-3):
        result = ik.solve(robot, paper.TO_PAPER.T @ (np.array([-10.0, 50, -20]) * unit))
        assert not result.success and result.position_error > 0.5


@pytest.mark.slow
def test_the_report(tmp_path):
    report = paper.reproduce(seeds=1)
    rows = {row[0]: row for row in report.data["fig4"]["rows"]}
    assert "stalled" in rows[0.0848][2] and all("converged" in rows[kp][2] for kp in (0.0847, 0.02))
    sweep = report.data["fig4_sweep"]
    reached = sweep["error_mm"] <= 1.0
    assert reached[sweep["kp"] < 0.08475].all() and not reached[sweep["kp"] > 0.08475].any()
    assert (
        report.data["counts state space, published A, B, C"]["mid-range"][0]
        == DATA["counts"]["mid_range"]["state_space"][0]
    )
    tuned = {row[0]: row for row in report.data["tuned"]["rows"]}
    assert all(float(row[2]) >= 988 for name, row in tuned.items() if "tuned" in name and "paper" not in name)
    others = {tuple(row[:3]): row[3] for row in report.data["other_robots"]["rows"]}
    for robot in ("ur5", "panda"):
        assert others[robot, "position", "state space, 128 designed maps"] > 970
        assert others[robot, "pose", "LM with restarts"] == 1000
    files = report.write(tmp_path)
    assert {file.name for file in files if file.suffix == ".png"} == {
        "fig4.png",
        "fig5.png",
        "fig6.png",
        "fig7.png",
        "gains.png",
        "singularity.png",
    }
    assert "nan" not in files[0].read_text()


def test_a_folder_that_cannot_be_written_is_refused_before_the_work(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(paper, "reproduce", lambda: pytest.fail("the work started"))
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        assert main(["reproduce", "burrell", "-o", str(folder)]) == 2
        assert str(tmp_path / "file") in capsys.readouterr().err
