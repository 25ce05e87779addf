"""`--csv`: the tables of a command as a file."""

import json
import re
import shlex

import numpy as np
import pytest
from folders import csv_rows, write_csv

from ik_toolkit.robot.library import shipped_robots


def test_solutions_to_a_table(run, tmp_path):
    file = tmp_path / "all.csv"
    code, out, err = run("solve", "planar_2r", "--xyz", 1, 1, 0, "--all", "--json", "--csv", file)
    found, rows = json.loads(out), csv_rows(file)
    assert code == 0 and f"wrote {file}" in err and len(rows) == len(found["solutions"]) == 2
    assert list(rows[0]) == [*found["joint_names"], "distance"]
    assert np.array_equal([[float(row[name]) for name in found["joint_names"]] for row in rows], found["solutions"])


@pytest.mark.parametrize("what", ["robots", "solvers"])
def test_lists_to_a_table(run, tmp_path, what):
    file = tmp_path / "list.CSV"
    code, out, _ = run(what, "--json", "--csv", file)
    assert code == 0 and [row["name"] for row in csv_rows(file)] == [row["name"] for row in json.loads(out)[what]]


@pytest.mark.parametrize("robot", ["hydrolek_7w", "brokk_hydrolek"])
def test_joints_to_a_table(run, tmp_path, robot):
    file = tmp_path / "joints.csv"
    code, out, _ = run("info", robot, "--json", "--csv", file)
    found = json.loads(out)
    arms = found.get("arms", [found])
    assert code == 0
    rows = [(row["tip"], row["name"], row["kind"], float(row["upper"])) for row in csv_rows(file)]
    assert rows == [(arm["tip"], one["name"], one["kind"], one["upper"]) for arm in arms for one in arm["joints"]]


def test_what_has_no_table_is_refused(refused, tmp_path):
    given = ["--csv", tmp_path / "one.csv"]
    assert "--csv writes the solutions of --all" in refused("solve", "planar_2r", "--xyz", 1, 1, 0, *given)
    assert "leave out the name" in refused("solvers", "lm", *given)


@pytest.mark.parametrize("more", [(), ("--deg", "--base-xyz", "-1 0 0", "--parameters", "joints", "--tip", "tool")])
def test_the_command_that_follows_suggested_poses_can_be_typed(run, tmp_path, more):
    """It names the robot as it was given, the file, and the options that say how both are read."""
    arm, file = tmp_path / "my arm.urdf", tmp_path / "poses.csv"
    arm.write_text(shipped_robots()["inspection_7dof"].path.read_text())
    code, _, err = run("calibrate", arm, "--suggest", 12, "-o", file, *more)
    told = re.search(r"add the columns x,y,z as measured, then: .*?(calibrate .*)", err)
    rows = [{**row, **{axis: row[f"drawn_{axis}"] for axis in "xyz"}} for row in csv_rows(file)]
    write_csv(file, ",".join(rows[0]), [row.values() for row in rows])
    assert code == 0 and told and run(*shlex.split(told[1]))[0] == 0
    assert all(word in told[1] for word in more if word.startswith("--"))
