"""Workspace and singularity studies: sampling, counts, streaming, workers, pictures, the command."""

import json
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
import robots
from folders import csv_rows
from serial_arms import drawn

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption
from ik_toolkit.study.singularity import escapes, measures
from ik_toolkit.study.targets import sample_targets, stream_targets
from ik_toolkit.study.workspace import WorkspaceInterrupted, envelope, workspace

PUBLISHED = {"designed": "state-space", "published": ik.StateSpace.preset("burrell-2016")}


def test_targets_are_reachable_reproducible_and_spread_as_asked():
    robot = robots.load("hydrolek_7w")
    assert (sample_targets(robot, 50, 3) == sample_targets(robot, 50, 3)).all()
    assert (sample_targets(robot, 50, 3) != sample_targets(robot, 50, 4)).any()
    assert sample_targets(robot, 7, position_only=True).shape == (7, 3)
    q = robot.lower + (robot.upper - robot.lower) * np.random.default_rng(3).random((1, 6))
    assert np.abs(robot.fk(q[0]).homogeneous - sample_targets(robot, 1, 3)[0]).max() < 1e-12
    for how in ("joints", "volume"):
        assert ik.solve_batch(robot, sample_targets(robot, 300, 1, how=how), tolerance=1e-4).success.all()

    def crowding(how):  # largest share of the targets in one cell of a coarse grid
        points = sample_targets(robot, 20_000, 1, how=how, position_only=True)
        cells = np.unique((points // 0.2).astype(int), axis=0, return_counts=True)[1]
        return cells.max() / len(points)

    assert crowding("volume") < 0.8 * crowding("joints")
    for name, bad, words in (
        ("how", "joint", "joints"),
        ("position_only", "no", "position_only"),
        ("seed", 1.5, "seed"),
    ):
        with pytest.raises(InvalidOption, match=words):
            sample_targets(robot, 5, **{name: bad})


@pytest.mark.parametrize("solver", ["dls", ik.DLS, ik.DLS(damping=0.1), {"dls": "dls"}])
def test_one_solver_may_be_given_by_itself(solver):
    assert list(ik.workspace(robots.load("planar_2r"), solver, targets=2).outcomes) == ["dls"]


@pytest.mark.parametrize(
    "name, bad, words",
    [
        ("solvers", 3, "solvers must be names"),
        ("solvers", [], "at least one solver"),
        ("solvers", np.zeros((0, 2)), "at least one solver"),
        ("seed", -1, "seed"),
        ("seed", "one", "seed"),
        ("file", 3, "file must be the path of a file, not 3"),
        ("progress", "bar", "progress must be a function of the number of targets done"),
        ("executor", "pool", "submit method"),
        ("how", np.zeros(2), "no way of sampling"),
        ("position_only", "no", "position_only"),
    ],
)
def test_mistakes_are_named(name, bad, words):
    with pytest.raises(InvalidOption, match=words):
        ik.workspace(robots.load("planar_2r"), **{"solvers": ["dls"], "targets": 2, name: bad})


def test_chunks_depend_on_seed_and_number_only():
    robot = robots.load("hydrolek_7w")
    parts = list(stream_targets(robot, 250, 7, chunk=100))
    assert [len(part) for part in parts] == [100, 100, 50]
    assert (next(stream_targets(robot, 100, 7, chunk=100)) == parts[0]).all()


def test_envelope_is_the_published_reach():
    low, high, (near, far) = envelope(robots.load("hydrolek_7w"))
    assert np.abs(1000 * low - [64, -707, -730]).max() < 8
    assert np.abs(1000 * high - [1207, 900, 900]).max() < 25
    assert abs(1000 * near - 531) < 8 and abs(1000 * far - 1210) < 5


def test_counts_map_failures_and_file_agree(tmp_path):
    robot = robots.load("hydrolek_7w")
    file = tmp_path / "targets.csv"
    found = workspace(robot, PUBLISHED, targets=9000, seed=2, file=file, tolerance=1e-3, max_iterations=1000)
    rows = csv_rows(file)
    assert len(rows) == 9000 == len(found.points)
    for name, one in found.outcomes.items():
        solved = np.array([int(row[f"{name} success"]) for row in rows])
        assert one.targets == 9000 and one.solved == solved.sum() == found.solved[name].sum()
        assert found.map[name][0].sum() == 9000 and found.map[name][1].sum() == one.solved
        assert sum(one.statuses.values()) == 9000 and one.statuses["CONVERGED"] == one.solved
        errors = np.array([float(row[f"{name} position_error"]) for row in rows])
        assert (errors[solved == 1] <= 1e-3).all() and (errors[solved == 0] > 1e-3 * (1 - 1e-6)).all()
        assert one.worst == errors[solved == 0].max()
        lost = np.array([[float(row[k]) for k in "xyz"] for row in rows])[solved == 0]
        listed = found.failures[name]
        assert (listed[:, :3] == lost[: len(listed)]).all()
    assert 0.70 < found.outcomes["published"].share < 0.77 < 0.98 < found.outcomes["designed"].share
    repeat = workspace(robot, PUBLISHED, targets=9000, seed=2, tolerance=1e-3, max_iterations=1000)
    assert {k: v.solved for k, v in repeat.outcomes.items()} == {k: v.solved for k, v in found.outcomes.items()}


def test_an_executor_gives_the_same():
    robot = robots.load("planar_3r")
    here = workspace(robot, ["lm", "lm"], targets=300, tolerance=1e-3)
    with ProcessPoolExecutor(1) as pool:
        there = workspace(robot, ["lm", "lm"], targets=300, tolerance=1e-3, executor=pool)
    assert list(here.outcomes) == ["lm", "lm 2"]
    assert [x.iterations for x in there.outcomes.values()] == [x.iterations for x in here.outcomes.values()]


def test_ctrl_c_keeps_the_chunks_finished(tmp_path):
    robot = robots.load("planar_3r")
    file = tmp_path / "targets.csv"

    def stop(done):
        if done == 2 * 8192:
            raise KeyboardInterrupt

    with pytest.raises(WorkspaceInterrupted) as caught:
        workspace(robot, ["lm", "dls"], targets=10**7, file=file, progress=stop, tolerance=1e-3)
    found = caught.value.result
    assert not file.exists()
    rows = csv_rows(tmp_path / "targets.csv.partial")
    assert len(rows) == 2 * 8192
    for name, one in found.outcomes.items():
        assert one.targets == 2 * 8192 == found.map[name][0].sum()
        assert one.solved == sum(int(row[f"{name} success"]) for row in rows)

    whole = workspace(robot, ["lm", "dls"], targets=2 * 8192, tolerance=1e-3)
    assert {k: v.solved for k, v in whole.outcomes.items()} == {k: v.solved for k, v in found.outcomes.items()}


def test_poses_and_mistakes(tmp_path):
    robot = robots.load("hydrolek_7w")
    found = workspace(robot, ["lm"], targets=200, position_only=False, how="volume")
    assert found.outcomes["lm"].solved == 200 and json.dumps(found.to_dict())
    with pytest.raises(InvalidOption, match="csv"):
        workspace(robot, ["lm"], targets=10, file=tmp_path / "x.txt")
    with pytest.raises(InvalidOption, match="at least one"):
        workspace(robot, [])
    with pytest.raises(InvalidOption, match="fraction"):
        workspace(robot, ["lm"], targets=10, check=2.0)
    assert workspace(robot, ["lm"], targets=10, check=1.0).outcomes["lm"].solved == 10


def test_measures_of_a_planar_arm():
    robot = robots.load("planar_2r")
    Q = np.array([[0.3, 0.0], [0.1, np.pi / 2], [-0.4, 1.0]])
    product, condition, least = measures(robot, Q)
    area = np.abs(np.sin(Q[:, 1])) / robot.chain.scale**2  # links of 1 m: |det J| = sin(theta_2)
    assert np.abs(product - area).max() < 1e-12
    assert condition[0] == np.inf and least[0] == 0.0 and (condition[1:] < 10).all()
    for bad in ([0.3, 0.0], [[0.3, np.nan]]):
        with pytest.raises(InvalidConfiguration):
            measures(robot, bad)


def test_measures_of_a_planar_arm_are_the_same_in_a_tilted_plane():
    ahead, level, Q = (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), np.array([[0.3, 0.5, 0.2], [0.1, np.pi / 2, -1.0]])
    arms = []
    for tilt in (level, (0.5, 0.3, 0.2)):
        places = (level, tilt), (ahead, level), (ahead, level)
        arms.append(drawn([("revolute", *place, (0, 0, 1), -2.6, 2.6) for place in places], ahead))
    for position_only in (True, False):
        flat, tilted = (measures(arm, Q, position_only) for arm in arms)
        assert flat[0].min() > 0.01 and np.allclose(tilted, flat, atol=1e-12)


def test_escapes_from_the_straight_arm():
    robot = robots.load("planar_3r")
    line = np.column_stack([np.linspace(4.0, 5.5, 10), np.zeros((10, 2))])
    rule = ik.StateSpace(A=-0.5 * np.eye(3), B=[[2, -2, 0], [-1, 0, 0], [1, -2, 0]], C=-0.05 * np.eye(3))
    found = {x.solver: x for x in escapes(robot, line, ["transpose", "dls", rule], np.zeros(3), tolerance=0.02)}
    for name in ("transpose", "dls"):
        assert found[name].solved == 0 and found[name].stood_still == 10
        assert found[name].solved_offset == 10
    assert found["state-space"].solved >= 5 and found["state-space"].stood_still == 0
    (one,) = escapes(robot, line, "dls", np.zeros(3), tolerance=0.02)  # a single solver need not stand in a list
    assert one.to_dict().keys() == found["dls"].to_dict().keys() and one.solved_offset == 10


def test_the_map_shows_failures():
    pytest.importorskip("matplotlib")
    robot = robots.load("hydrolek_7w")
    found = workspace(robot, ["lm"], targets=400, seed=3)
    figures = []
    cell = tuple(index[0] for index in np.nonzero(found.map["lm"][0]))
    for lost in (0, 1):  # one failure in one cell
        found.map["lm"][1][cell] -= lost
        figures.append(ik.plot(found, robot))
        targets, solved = found.map["lm"].sum(axis=3)
        rate = 100.0 * (1.0 - solved / np.where(targets > 0, targets, np.nan))
        (image,) = figures[-1].axes[0].images
        assert np.allclose(np.ma.filled(image.get_array(), np.nan), rate.T, equal_nan=True)
        assert image.norm.vmax == (np.nanmax(rate) if lost else 1.0)  # rare failures are seen
    assert figures[-1].axes[-1].get_ylabel() == "failures [%]"
    drawn = figures[-1].axes[1].lines[0].get_xydata()  # the arm from the side, base to tip
    assert np.allclose(drawn[-1], robot.fk(robot.home).translation[[0, 2]])


def test_command(run, told, refused, tmp_path):
    plot, table = tmp_path / "map.png", tmp_path / "targets.csv"
    words = "workspace hydrolek_7w -s lm --preset state-space=burrell-2016 -n 500".split()
    found = told(*words, "--plot", plot, "--csv", table)
    solved = {name: row["solved"] for name, row in found["solvers"].items()}
    assert solved["lm"] == 500
    assert len(found["failures"]["state-space burrell-2016"]) == 500 - solved["state-space burrell-2016"]
    assert plot.stat().st_size > 10_000 and len(table.read_text().splitlines()) == 501
    code, out, _ = run(*words)
    assert code == 0 and "500 of 500" in out
    unknown = refused("workspace", "hydrolek_7w", "--preset", "lm=x")
    assert "'lm' has no preset 'x'. These solvers have presets: pid, state-space" in unknown
    assert "SOLVER=PRESET" in refused("workspace", "hydrolek_7w", "--preset", "pid")
