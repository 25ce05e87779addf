"""Benchmark: statistics, schema, comparison, the command."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from folders import csv_rows

import ik_toolkit as ik
from ik_toolkit.errors import FrameNotFound, InvalidOption, RobotNotFound, UnknownSolver
from ik_toolkit.study import benchmark as study
from ik_toolkit.study import singularity
from ik_toolkit.study.benchmark import wilson
from ik_toolkit.study.targets import sample_targets


@pytest.fixture(scope="module")
def arm():
    return ik.Robot.load("hydrolek_7w")


@pytest.mark.parametrize(
    "successes, trials, low, high",
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_published_examples(successes, trials, low, high):
    """Newcombe (1998), Table I, method 3."""
    assert wilson(successes, trials) == pytest.approx((low, high), abs=5e-5)


def test_wilson_solves_its_equation():
    """The ends p fulfil (share - p)^2 = z^2 p (1 - p) / N."""
    for successes, trials in ((3, 10), (999, 1000), (50, 100)):
        for p in wilson(successes, trials):
            assert (successes / trials - p) ** 2 == pytest.approx(1.959963984540054**2 * p * (1 - p) / trials, rel=1e-9)
    assert wilson(0, 0) == (0.0, 1.0)
    assert wilson(7, 7)[1] == 1.0 and wilson(0, 7)[0] == 0.0


def test_summary_counts_what_it_is_given(arm):
    """Made-up rows: seconds, status, iterations, restarts, FK evaluations, errors."""
    table = np.array(
        [
            [4e-6, 1, 30, 5, 31, 0.5, 0.4],
            [1e-6, 0, 4, 0, 5, 1e-7, 3e-7],
            [2e-6, 0, 6, 1, 8, 2e-7, 1e-7],
            [3e-6, 3, 30, 0, 31, 0.1, 0.1],
        ]
    )
    row = study.summary(arm, "lm", "pose", table)
    assert (row.targets, row.solved, row.statuses) == (4, 2, {"CONVERGED": 2, "STALLED": 1, "LIMIT_BLOCKED": 1})
    assert (row.median, row.mean) == pytest.approx((2.5e-6, 2.5e-6))
    assert (row.iterations, row.restarts, row.fk_evaluations) == (18, 1.5, 19.5)
    assert (row.worst_position_error, row.worst_orientation_error) == (2e-7, 3e-7)
    assert (row.low, row.high) == wilson(2, 4)
    assert row.seconds[:2].tolist() == [1e-6, 2e-6]  # the solved ones first
    nothing = study.summary(arm, "lm", "pose", table[[0, 3]])
    assert nothing.worst_position_error is None and nothing.solved == 0


def test_problems_are_reachable_and_starts_are_what_they_are_called(arm):
    T, none = study.problems(arm, 50, "pose", "none", 3)
    assert none is None
    again, near = study.problems(arm, 50, "pose", "near", 3)
    assert (T == again).all()
    assert ((near >= arm.lower) & (near <= arm.upper)).all()
    solver = ik.Solver(arm)
    assert all(np.abs(solver(t, q).q - q).max() <= 2 * study.NEAR for t, q in zip(T[:5], near, strict=False))
    positions, home = study.problems(arm, 50, "position", "home", 3)
    assert (positions == T[:, :3, 3]).all() and (home == arm.home).all()
    _, random = study.problems(arm, 50, "pose", "random", 3)
    assert np.abs(random - near).max() > 0.5 and ((random >= arm.lower) & (random <= arm.upper)).all()


def test_rows_and_what_is_left_out(arm):
    seen = []
    names = ["lm", "planar-2r", "newton"]
    found = ik.benchmark([arm, "planar_2r"], names, targets=12, progress=lambda *k: seen.append(k))
    wanted = [("hydrolek_7w", name, "pose") for name in ("lm", "newton")]
    wanted += [("planar_2r", name, "position") for name in ("lm", "planar-2r", "newton")]
    assert [(row.robot, row.solver, row.task) for row in found.rows] == wanted
    assert set(found.skipped) == {("hydrolek_7w", "planar-2r")}
    for row in found.rows:
        assert row.targets == 12 == sum(row.statuses.values()) == len(row.seconds)
        assert row.solved == row.statuses.get("CONVERGED", 0)
        assert 0 < row.median <= row.p99 and row.low <= row.solved / 12 <= row.high
    assert found.rows[0].solved == 12 and found.rows[0].worst_position_error <= 1e-6
    assert seen[-1][0] == seen[-1][1]
    text = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert text["rows"][0]["solver"] == "lm" and text["skipped"][0]["solver"] == "planar-2r"


def test_every_solver_meets_the_targets_with_one_attempt_and_with_equal_restarts():
    """Nobody is compared at 100 attempts against one."""
    robot = ik.Robot.load("inspection_7dof")
    found = ik.benchmark(robot, ["lm", "dls", "state-space"], targets=60, tolerance=1e-3, restarts=7)
    assert found.options["restarts"] == 7
    for row in found.rows:
        assert row.once.targets == row.targets == 60 and row.once.once is None
        assert row.once.restarts == 0.0 and row.restarts <= 7.0
        assert row.once.low <= row.once.solved / 60 <= row.once.high and row.once.solved <= row.solved
    assert any(row.once.solved < row.solved for row in found.rows)
    alone = ik.Solver(robot, "dls", tolerance=1e-3, restarts=0)
    T, _ = study.problems(robot, 60, "pose", "none", 0)
    assert found.rows[1].once.solved == sum(alone(target).success for target in T)
    assert found.to_dict()["rows"][1]["once"]["solved"] == found.rows[1].once.solved
    assert ik.benchmark(robot, ["dls"], targets=2, tolerance=1e-3).options["restarts"] == study.RESTARTS


def test_an_option_that_no_solver_takes_is_named():
    with pytest.raises(ik.IKError, match=r"^restarts must be"):  # and not that a closed form, tried last, does not fit
        ik.benchmark("planar_2r", targets=2, restarts=-1)


@pytest.mark.parametrize("places", ["80", "100"])
def test_the_table_fits_a_terminal(run, places, monkeypatch):
    """80 columns, both successes, no word cut off."""
    monkeypatch.setenv("COLUMNS", places)
    code, out, _ = run("bench", "hydrolek_7w", "--solvers", "lm,dls,state-space", "-n", 12)
    lines = out.splitlines()
    assert code == 0 and max(map(len, lines)) <= 80
    assert any("one attempt" in line and "with restarts" in line for line in lines)
    rows = [line.split() for line in lines if line.split()[:1] in (["lm"], ["dls"], ["state-space"])]
    assert len(rows) == 3 and all(len(row) == 8 for row in rows)


def tree():
    return ik.Tree.load("brokk_hydrolek", tips=["left_tip", "right_tip"])


@pytest.mark.parametrize(
    "call",
    [
        lambda robot: singularity.run(robot, np.zeros(3), "lm", robot.home),
        lambda robot: singularity.escapes(robot, np.zeros((1, 3)), ["lm"], robot.home),
        lambda robot: singularity.measures(robot, robot.home[None]),
    ],
)
def test_some_studies_are_for_one_tip(call):
    """A Tree is refused by its tips, anything else by its type."""
    with pytest.raises(InvalidOption, match=r"one tip.*left_tip, right_tip"):
        call(tree())
    broken = type("Thing", (), {"home": np.zeros(2)})()
    with pytest.raises(InvalidOption, match="Thing"):
        call(broken)


@pytest.mark.parametrize("task", ["pose", "position"])
def test_several_tips_meet_the_same_rows(task):
    both = tree()
    found = ik.benchmark(both, ["lm", "sqp", "newton", "inspection"], targets=25, task=task, seed=2)
    assert [row.solver for row in found.rows] == ["lm", "sqp"]
    assert {name for _, name in found.skipped} == {"newton", "inspection"}
    assert {robot for robot, _ in found.skipped} == {"brokk_hydrolek (left_tip + right_tip)"} == set(found.by_robot())
    T, _ = study.problems(both, 25, task, "none", 2)
    solver = ik.Solver(both, "lm", restarts=study.RESTARTS)
    results = [solver(list(target)) for target in T]
    row = found.rows[0]
    assert row.tips == both.tips and row.to_dict()["tips"] == both.tips
    assert row.solved == sum(result.success for result in results) >= 24
    assert row.once.solved <= row.solved and row.restarts == np.mean([result.restarts for result in results])
    good = [result for result in results if result.success]
    assert row.worst_position_error == max(max(result.position_errors.values()) for result in good)
    angles = [angle for result in good for angle in result.orientation_errors.values()]
    assert row.worst_orientation_error == (max(angles) if task == "pose" else None)


def test_arms_of_one_robot_are_told_apart():
    both = tree()
    found = ik.benchmark([*both.arms, both], ["lm"], targets=2, task="position")
    names = [f"brokk_hydrolek ({tips})" for tips in ("left_tip", "right_tip", "left_tip + right_tip")]
    assert list(found.by_robot()) == names and [len(rows) for rows in found.by_robot().values()] == [1, 1, 1]


@pytest.mark.parametrize("start", ["home", "near", "random"])
def test_starts_and_targets_of_several_tips(start):
    both = tree()
    T, Q0 = study.problems(both, 20, "pose", start, 5)
    assert T.shape == (20, 2, 4, 4) and Q0.shape == (20, both.n) and not any(both.outside(q) for q in Q0)
    solver = ik.Solver(both)
    for target, q0 in zip(T[:4], Q0, strict=False):
        result = solver(target, q0)
        assert result.success and (start != "near" or np.abs(result.q - q0).max() <= 2 * study.NEAR)


def test_targets_of_several_tips_or_one():
    both = tree()
    T = sample_targets(both, 6, 1)
    q = both.random_q(np.random.default_rng(1), 6)
    assert np.allclose([[x.homogeneous for x in both.fk(row).values()] for row in q], T, atol=1e-12)
    assert (sample_targets(both, 6, 1, position_only=True) == T[..., :3, 3]).all()
    for f, tip in enumerate(both.tips):
        assert np.allclose(sample_targets(both, 6, 1, tip=tip), T[:, f], atol=1e-12)
        assert sample_targets(both, 6, 1, tip=tip, how="volume", position_only=True).shape == (6, 3)
    with pytest.raises(InvalidOption, match="choose it with tip=: left_tip, right_tip"):
        sample_targets(both, 3, how="volume")
    with pytest.raises(FrameNotFound, match="Did you mean 'left_tip'"):
        sample_targets(both, 3, tip="left_tp")
    assert (both.random_q(np.random.default_rng(1)) == q[0]).all()  # one at a time they are the same


def test_options_reach_the_solvers(arm):
    few = ik.benchmark(arm, ["lm"], targets=20, max_iterations=1, restarts=0).rows[0]
    assert few.solved < 20 and few.iterations <= 1
    loose = ik.benchmark(arm, ["lm"], targets=20, tolerance=1e-2).rows[0]
    assert 1e-6 < loose.worst_position_error <= 1e-2


@pytest.mark.parametrize("solver", ["dls", ik.DLS, ik.DLS(damping=0.1)])
def test_one_solver_may_be_given_by_itself(arm, solver):
    assert [row.solver for row in ik.benchmark(arm, solver, targets=2).rows] == ["dls"]


def test_instances_and_twins(arm):
    found = ik.benchmark(arm, [ik.DLS(damping=1e-3), ik.DLS(damping=0.5)], targets=20, max_iterations=50)
    assert [row.solver for row in found.rows] == ["dls", "dls #2"]
    assert found.rows[0].iterations < found.rows[1].iterations


def test_executor_gives_the_same_answers(arm):
    alone = ik.benchmark(arm, ["lm", "dls"], targets=30, seed=4)
    with ThreadPoolExecutor(2) as pool:
        shared = ik.benchmark(arm, ["lm", "dls"], targets=30, seed=4, executor=pool)
    for a, b in zip(alone.rows, shared.rows, strict=True):
        assert (a.solved, a.iterations, a.restarts, a.statuses) == (b.solved, b.iterations, b.restarts, b.statuses)
        assert (a.iteration_counts == b.iteration_counts).all()


@pytest.mark.parametrize(
    "arguments, error, words",
    [
        ({"start": "nere"}, InvalidOption, "near"),
        ({"task": "poses"}, InvalidOption, "pose"),
        ({"targets": 0}, InvalidOption, "targets"),
        ({"targets": 2.5}, InvalidOption, "targets"),
        ({"solvers": ["ml"]}, UnknownSolver, "lm"),
        ({"solvers": []}, InvalidOption, "at least one"),
        ({"solvers": 3}, InvalidOption, "solvers must be names, rule classes or instances of them, not 3"),
        ({"solvers": "ml"}, UnknownSolver, "Did you mean 'lm'"),
        ({"solvers": [3]}, UnknownSolver, "not 3"),
        ({"start": np.zeros(2)}, InvalidOption, "no start"),
        ({"task": ["pose"]}, InvalidOption, "no task"),
        ({"seed": -1}, InvalidOption, "seed"),
        ({"seed": "one"}, InvalidOption, "seed"),
        ({"executor": "pool"}, InvalidOption, "submit method"),
        ({"progress": "bar"}, InvalidOption, "progress must be a function of two numbers, done and all"),
        ({"robots": "hydrolek"}, RobotNotFound, "hydrolek_7w"),
        ({"tolerence": 1e-3}, InvalidOption, "tolerance"),
    ],
)
def test_mistakes_are_named(arm, arguments, error, words):
    with pytest.raises(error, match=words):
        ik.benchmark(**{"robots": arm, "solvers": ["lm"], "targets": 2, **arguments})


def test_plot(arm, tmp_path):
    pytest.importorskip("matplotlib")

    found = ik.benchmark(arm, ["lm"], targets=5)
    ik.plot(found, file=tmp_path / "times.svg")
    drawn = (tmp_path / "times.svg").read_text(encoding="utf-8")
    assert all(text in drawn for text in ("hydrolek_7w: targets solved", ">lm<"))
    assert drawn.count(">of 100 targets<") == 2  # both axes that count them say so


def test_command(run, told, refused, tmp_path):
    file = tmp_path / "b.json"
    code, out, _ = run("bench", "hydrolek_7w", "--solvers", "lm,dls", "--targets", 10, "-o", file)
    rows = json.loads(file.read_text())["rows"]
    assert code == 0 and "dls" in out
    assert [row["solver"] for row in rows] == ["lm", "dls"] and rows[0]["targets"] == 10
    both = "bench brokk_hydrolek --tip left_tip --tip right_tip --solvers lm -n 4".split()
    assert "brokk_hydrolek (left_tip + right_tip): 4 targets (pose)" in run(*both)[1]
    (row,) = told(*both)["rows"]
    assert row["tips"] == ["left_tip", "right_tip"] and row["solved"] == 4
    code, out, _ = run(*"bench brokk_hydrolek --tip left_tip --solvers lm -n 4".split())
    assert code == 0 and "brokk_hydrolek: 4 targets (pose)" in out
    assert "--tip" in refused(*"bench hydrolek_7w planar_2r --tip tip -n 2".split())
    assert "Did you mean 'lm'" in refused(*"bench hydrolek_7w --solvers ml --targets 2".split())


def test_bench_writes_its_table_as_csv_and_latex(told, tmp_path):
    sheet, table = tmp_path / "bench.csv", tmp_path / "bench.tex"
    rows = told("bench", "planar_2r", "-s", "lm,planar-2r", "-n", 5, "--csv", sheet, "--latex", table)["rows"]
    written = csv_rows(sheet)
    assert [row["solver"] for row in written] == ["lm", "planar-2r"]
    for row, one in zip(written, rows, strict=True):
        assert float(row["median"]) == one["median"] and float(row["once_solved"]) == one["once"]["solved"]
    text = table.read_text()
    assert text.count(r"\\") == 3 and r"planar\_2r & lm" in text and text.endswith("\\end{tabular}\n")
