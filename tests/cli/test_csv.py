"""`--csv`: the tables of a command as a file."""

import csv
import json
import re
import shlex

import numpy as np
import pytest

from ik_toolkit.robot.library import shipped_robots


def rows_of(file):
    with file.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_solutions_to_a_table(run, tmp_path):
    file = tmp_path / "all.csv"
    code, out, err = run("solve", "planar_2r", "--xyz", 1, 1, 0, "--all", "--json", "--csv", file)
    found, rows = json.loads(out), rows_of(file)
    assert code == 0 and f"wrote {file}" in err and len(rows) == len(found["solutions"]) == 2
    assert list(rows[0]) == [*found["joint_names"], "distance"]
    assert np.array_equal([[float(row[name]) for name in found["joint_names"]] for row in rows], found["solutions"])


@pytest.mark.parametrize("what", ["robots", "solvers"])
def test_lists_to_a_table(run, tmp_path, what):
    file = tmp_path / "list.csv"
    code, out, _ = run(what, "--json", "--csv", file)
    assert code == 0 and [row["name"] for row in rows_of(file)] == [row["name"] for row in json.loads(out)[what]]


@pytest.mark.parametrize("robot", ["hydrolek_7w", "brokk_hydrolek"])
def test_joints_to_a_table(run, tmp_path, robot):
    file = tmp_path / "joints.csv"
    code, out, _ = run("info", robot, "--json", "--csv", file)
    found = json.loads(out)
    arms = found.get("arms", [found])
    assert code == 0
    rows = [(row["tip"], row["name"], row["kind"], float(row["upper"])) for row in rows_of(file)]
    assert rows == [(arm["tip"], one["name"], one["kind"], one["upper"]) for arm in arms for one in arm["joints"]]


def test_what_has_no_table_is_refused(run, tmp_path):
    code, _, err = run("solve", "planar_2r", "--xyz", 1, 1, 0, "--csv", tmp_path / "one.csv")
    assert code == 2 and "--csv writes the solutions of --all" in err
    code, _, err = run("solvers", "lm", "--csv", tmp_path / "one.csv")
    assert code == 2 and "leave out the name" in err


@pytest.mark.parametrize("more", [(), ("--deg", "--base-xyz", "-1 0 0", "--parameters", "joints", "--tip", "tool")])
def test_the_command_that_follows_suggested_poses_can_be_typed(run, tmp_path, more):
    """It names the robot as it was given, the file, and the options that say how both are read."""
    arm, file = tmp_path / "my arm.urdf", tmp_path / "poses.csv"
    arm.write_text(shipped_robots()["inspection_7dof"].path.read_text())
    code, _, err = run("calibrate", arm, "--suggest", 12, "-o", file, *more)
    told = re.search(r"add the columns x,y,z as measured, then: .*?(calibrate .*)", err)
    rows = [{**row, **{axis: row[f"drawn_{axis}"] for axis in "xyz"}} for row in rows_of(file)]
    with file.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    assert code == 0 and told and run(*shlex.split(told[1]))[0] == 0
    assert all(word in told[1] for word in more if word.startswith("--"))
