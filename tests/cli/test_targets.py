"""`ik solve ROBOT --targets FILE`: every file format, the same results as solve_batch, errors that name the line."""

import csv
import json
import signal
import tracemalloc

import numpy as np
import pytest
from rich.progress import Progress
from robots import load, sample

import ik_toolkit as ik
from ik_toolkit.cli import main
from ik_toolkit.errors import InvalidTarget
from ik_toolkit.robot import pose_files
from ik_toolkit.robot.rotation import matrix_quat, matrix_rpy

ARM = "hydrolek_7w"


@pytest.fixture
def poses():
    return sample(load(ARM), 30, seed=4)[1]


def write(path, header, rows):
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(header.split(","))
        writer.writerows(rows)
    return str(path)


def solved(path):
    with open(path, newline="") as stream:
        rows = list(csv.DictReader(stream))
    return np.array([[float(row[name]) for name in load(ARM).joint_names] for row in rows]), rows


def run(*words):
    return main(["solve", ARM, *map(str, words)])


def files(poses, tmp_path):
    xyz = poses[:, :3, 3]
    quat = np.array([matrix_quat(R) for R in poses[:, :3, :3]])
    rpy = np.array([matrix_rpy(R) for R in poses[:, :3, :3]])
    mixed = [[*a, *p, "n"] for a, p in zip(rpy[:, ::-1], xyz[:, ::-1], strict=True)]
    np.savez(tmp_path / "targets.npz", targets=poses)
    np.savez(tmp_path / "quat.npz", xyz=xyz, quat_xyzw=quat)
    np.savez(tmp_path / "wxyz.npz", xyz=xyz, quat_wxyz=quat[:, [3, 0, 1, 2]])
    return {
        "targets.npz": poses,
        "quat.npz": poses,
        "wxyz.npz": poses,
        write(tmp_path / "quat.csv", "x,y,z,qx,qy,qz,qw", np.c_[xyz, quat]): poses,
        write(tmp_path / "rpy.csv", "Yaw, Pitch ,roll,z,y,x,note", mixed): poses,
        write(tmp_path / "xyz.csv", "x,y,z", xyz): xyz,
    }  # fmt: skip


def test_every_form_of_file_gives_the_answers_of_a_batch(poses, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(pose_files, "LINES", 7)  # several chunks
    robot = load(ARM)
    for name, targets in files(poses, tmp_path).items():
        many = ik.solve_batch(robot, targets, "lm", seed=2)
        for output in (tmp_path / "out.csv", tmp_path / "out.npz"):
            code = run("--targets", tmp_path / name, "-o", output, "-s", "lm", "--seed", 2, "--json")
            told = json.loads(capsys.readouterr().out)
            assert code == (0 if many.success.all() else 1)
            assert told["targets"] == 30 and told["solved"] == many.success.sum() and told["statuses"] == many.counts()
        found = np.load(tmp_path / "out.npz")
        q, rows = solved(tmp_path / "out.csv")
        assert np.array_equal(q, found["q"]) and found["joint_names"].tolist() == list(robot.joint_names)
        assert [ik.Status[row["status"]] for row in rows] == found["status"].tolist()
        assert np.array_equal([float(row["position_error"]) for row in rows], found["position_error"])
        assert np.allclose(q, many.q, atol=1e-4) and np.array_equal(many.status, found["status"])
        if name == "targets.npz":
            assert np.array_equal(q, many.q)


def test_axes_of_angles_are_said_to_move_with_the_body(poses, tmp_path, capsys):
    """Fixed axes in the reverse order are the same rotation, and the notice gives it."""
    rpy = np.array([matrix_rpy(T[:3, :3]) for T in poses[:3]])
    file = write(tmp_path / "poses.csv", "x,y,z,rx,ry,rz", np.c_[poses[:3, :3, 3], rpy])
    assert run("--targets", file, "--euler", "ZYX", "-o", tmp_path / "a.csv") == 0
    said = capsys.readouterr().err
    assert "about z, y, x one after another, axes that move with the body (SciPy's 'ZYX')" in said
    assert "for fixed axes give the reverse order, --euler xyz" in said
    assert np.abs([load(ARM).fk(q).homogeneous for q in solved(tmp_path / "a.csv")[0]] - poses[:3]).max() < 1e-5
    assert run("--targets", file, "--euler", "Zyx", "-o", tmp_path / "a.csv") == 2
    assert "or ZYX, which is the same" in capsys.readouterr().err


def test_degrees_are_for_the_angles_of_the_file(poses, tmp_path):
    rpy = np.array([matrix_rpy(R) for R in poses[:5, :3, :3]])
    write(tmp_path / "rad.csv", "x,y,z,roll,pitch,yaw", np.c_[poses[:5, :3, 3], rpy])
    write(tmp_path / "deg.csv", "x,y,z,roll,pitch,yaw", np.c_[poses[:5, :3, 3], np.degrees(rpy)])
    assert run("--targets", tmp_path / "rad.csv", "-o", tmp_path / "a.csv") == 0
    assert run("--targets", tmp_path / "deg.csv", "-o", tmp_path / "b.csv", "--deg") == 0
    assert np.allclose(solved(tmp_path / "a.csv")[0], solved(tmp_path / "b.csv")[0], atol=1e-9)


def test_unsolved_targets_are_a_status_and_code_1(tmp_path, capsys):
    write(tmp_path / "far.csv", "x,y,z", [[1.0, 0.1, 0.2], [9, 9, 9]])
    assert run("--targets", tmp_path / "far.csv", "-o", tmp_path / "out.csv") == 1
    assert [row["status"] for row in solved(tmp_path / "out.csv")[1]] == ["CONVERGED", "UNREACHABLE"]
    said = capsys.readouterr()
    assert "1 UNREACHABLE" in said.out
    alone = ik.solve(load(ARM), (9, 9, 9), "lm")
    assert f"target 2, the first not solved: UNREACHABLE: {alone.message}\n" in said.err


def test_options_reach_the_batch(tmp_path):
    write(tmp_path / "in.csv", "x,y,z", [[1.0, 0.1, 0.2]] * 2)
    arm, q0 = load(ARM), load(ARM).home
    assert (
        run("--targets", tmp_path / "in.csv", "-o", tmp_path / "out.csv", "--closest", *q0, "--avoid-collisions") == 0
    )
    expected = ik.solve(arm, (1.0, 0.1, 0.2), closest=q0, avoid_collisions=True)
    assert np.array_equal(solved(tmp_path / "out.csv")[0][1], expected.q)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty; its first line names the columns, such as x,y,z, and each line below it is a row"),
        ("\n , ,\n", "has only blank lines; its first line names the columns"),
        ("x,y,z\n,,\n\n", "has a header, x,y,z, and no rows below it"),
        ("0.5,0.1,0.3\n", "first line must be x,y,z"),
        ("x,y,z\n1,2,3\n1,,3\n\nnan,2,3\n", "line 3: the cell of y is empty; line 5 lacks a number as well"),
        ("x,y\n1,2\n", "no column z"),
        ("x,y,z,qx,qw\n1,2,3,0,1\n", "qx, qw"),
        ("x,y,z,qx,qy,qz,qw,roll\n1,2,3,0,0,0,1,0\n", "roll"),
        ("x,y,z\n1,2,3\n\n1,foo,3\n", "line 4: 'foo' is not a finite number"),
        ("x,y,z\n1,2,3\n1,nan,3\n", "line 3: 'nan'"),
        ("x,y,z\n1,2,3\n1,2\n", "line 3: 2 columns"),
        ("x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1\n1,2,3,0,0,0,5\n", "line 3: the quaternion"),
        ("x,y,z\n1,2,\xff\n", "cannot read"),
    ],
)
def test_bad_tables_are_named_by_line(tmp_path, capsys, text, words):
    (tmp_path / "bad.csv").write_bytes(text.encode("latin-1"))
    assert run("--targets", tmp_path / "bad.csv", "-o", tmp_path / "out.csv") == 2
    said = capsys.readouterr().err
    assert words in said and "Traceback" not in said and not (tmp_path / "out.csv").exists()


def test_bad_arrays_are_named(tmp_path, capsys):
    for arrays, words in (
        ({"q": np.zeros(3)}, "no array 'targets' or 'xyz', only q"),
        ({"targets": np.zeros((2, 5))}, "shape (2, 5)"),
        ({"xyz": np.zeros((2, 3)), "quat_xyzw": np.zeros((3, 4))}, "shape (N, 3)"),
        ({"xyz": np.zeros((2, 3)), "quat_xyzw": np.ones((2, 4))}, "row 0 (counted from 0): the quaternion"),
        (
            {"xyz": np.zeros((1, 3)), "quat_xyzw": np.ones((1, 4)), "quat_wxyz": np.ones((1, 4))},
            "give only one of them",
        ),
        (
            {"targets": np.full((2, 3), np.inf)},
            "rows 0 and 1 of targets (counted from 0) have numbers that are not finite",
        ),
        ({"targets": np.zeros((0, 3))}, "targets has no rows; NPZ has an array xyz (N, 3)"),
        ({}, "no array 'targets' or 'xyz', and no other. NPZ has an array xyz (N, 3)"),
        ({"targets": np.array([None, None])}, "targets holds values of the type object, not real numbers"),
        ({"targets": np.array([["2020-01-01"] * 3], dtype="M8[D]")}, "datetime64[D], not real numbers"),
        ({"targets": np.array([["1", "2", "3"]])}, "targets holds values of the type <U1, not real numbers"),
        ({"xyz": np.ones((1, 3)) * 1j}, "xyz holds values of the type complex128, not real numbers"),
        ({"xyz": np.ones((1, 3), dtype=bool)}, "xyz holds values of the type bool, not real numbers"),
        ({"xyz": np.ones((1, 3)), "quat_xyzw": np.full((1, 4), "1")}, "quat_xyzw holds values of the type <U1"),
        ({"targets": np.zeros(1, dtype=[("a", "f8")])}, "targets holds values of the type"),
    ):
        np.savez(tmp_path / "bad.npz", **arrays)
        assert run("--targets", tmp_path / "bad.npz", "-o", tmp_path / "out.npz") == 2
        assert words in capsys.readouterr().err
    for tips, arrays, words in (
        ((), {"targets": np.zeros((3 * 10**6, 3))}, "save it with numpy.savez, without"),
        (("a", "b"), {"tips": np.zeros(10**6, dtype="U1"), "targets": np.zeros((1, 2, 3))}, "too many for names"),
    ):
        np.savez_compressed(tmp_path / "bad.npz", **arrays)
        tracemalloc.start()
        with pytest.raises(InvalidTarget, match=words):
            pose_files.read_poses(tmp_path / "bad.npz", "targets", tips=tips)
        assert tracemalloc.get_traced_memory()[1] < 1e6  # none of it was unpacked
        tracemalloc.stop()
    (tmp_path / "bad.npz").write_bytes(b"not a zip")
    assert run("--targets", tmp_path / "bad.npz", "-o", tmp_path / "out.npz") == 2
    said = capsys.readouterr().err
    assert "'bad.npz' is not an NPZ file" in said and "pickle" not in said


def test_what_does_not_go_together(tmp_path, capsys):
    good = write(tmp_path / "in.csv", "x,y,z", [[1.0, 0.1, 0.2]])
    out = tmp_path / "out.csv"
    for words, said in (
        (["--targets", good], "-o FILE"),
        (["--targets", good, "-o", tmp_path / "out.txt"], "-o FILE"),
        (["--targets", good, "-o", good], "overwrite"),
        (["--targets", tmp_path / "none.csv", "-o", out], "no targets file"),
        (["--targets", tmp_path, "-o", out], "is not a regular file"),
        (["--targets", good, "-o", out, "--xyz", 1, 2, 3], "--xyz"),
        (["--xyz", 1, 2, 3, "--threads", 2], "--targets"),
        (["--targets", good, "-o", out, "--threads", 0], "threads"),
        (["--targets", good, "-o", out, "--mask", 1, 1, 1, 0, 0, 0, "--target", "tool:1,2,3"], "--target"),
    ):
        assert run(*words) == 2
        assert said in capsys.readouterr().err
    assert not out.exists()


def test_an_interrupt_keeps_what_is_finished(tmp_path, capsys, monkeypatch):
    robot = load(ARM)
    xyz = sample(robot, 1)[1][:, :3, 3].repeat(9000, axis=0)
    np.savez(tmp_path / "in.npz", targets=xyz)
    real = Progress.update

    def impatient(bar, task, *, completed, **more):
        real(bar, task, completed=completed, **more)
        if completed > 4000:
            raise KeyboardInterrupt

    monkeypatch.setattr(Progress, "update", impatient)
    for name in ("out.csv", "out.npz"):
        assert run("--targets", tmp_path / "in.npz", "-o", tmp_path / name) == 130
        assert f"the first 4096 solutions are in {tmp_path / name}.partial" in capsys.readouterr().err
        assert not (tmp_path / name).exists()
    assert len(solved(tmp_path / "out.csv.partial")[0]) == len(np.load(tmp_path / "out.npz.partial")["q"]) == 4096


def test_an_interrupt_in_the_middle_of_writing_waits_for_its_end(tmp_path, capsys, monkeypatch):
    np.savez(tmp_path / "in.npz", targets=sample(load(ARM), 5)[1])
    real = np.savez

    def slow(file, **arrays):
        signal.raise_signal(signal.SIGINT)
        real(file, **arrays)

    monkeypatch.setattr(np, "savez", slow)
    assert run("--targets", tmp_path / "in.npz", "-o", tmp_path / "out.npz") == 130
    assert "the first 5 solutions are in" in capsys.readouterr().err
    assert len(np.load(tmp_path / "out.npz.partial")["q"]) == 5


@pytest.mark.parametrize("name", ["out.csv", "out.npz"])
def test_answers_that_are_not_confirmed_are_left_under_another_name(name, tmp_path, capsys, monkeypatch):
    robot = load(ARM)
    xyz = sample(robot, 1)[1][:, :3, 3].repeat(9000, axis=0)
    xyz[4500, 2] += 1e-3
    np.savez(tmp_path / "in.npz", targets=xyz)
    real = ik.Robot._errors
    doubted = lambda self, q, target: (1.0, None) if np.array_equal(target, xyz[4500]) else real(self, q, target)  # noqa: E731
    monkeypatch.setattr(ik.Robot, "_errors", doubted)
    assert run("--targets", tmp_path / "in.npz", "-o", tmp_path / name, "--json") == 1
    said = capsys.readouterr()
    assert "does not confirm the result for target 4500" in said.err and not said.out
    assert f"{name}.failed" in said.err and not (tmp_path / name).exists()
    left = tmp_path / f"{name}.failed"
    words = np.load(left)["status"] if name == "out.npz" else np.array([row["status"] for row in solved(left)[1]])
    assert (words[4500:] == (ik.Status.CHECK_FAILED if name == "out.npz" else "CHECK_FAILED")).all() and len(
        words
    ) > 4500
    assert name == "out.csv" or (len(words) == 9000 and (words == ik.Status.CHECK_FAILED).all())


# ------------------------------------------------------------------------------------------------------------- obstacles
def test_obstacles_on_the_command_line(capsys):
    robot = load(ARM)
    target = ["--xyz", *robot.fk(robot.home).translation]
    assert run(*target, "--avoid-collisions", "--json") == 0
    free = json.loads(capsys.readouterr().out)
    x, y, z = np.round(np.add(robot.fk(robot.home).translation, (0, 0, 0.0)), 6)
    assert run(*target, "--obstacle", f"sphere:{x},{y},{z},0.3", "--json") == 1
    told = json.loads(capsys.readouterr().out)
    assert told["status"] == "COLLISION" and "sphere_1" in told["collision"] and free["collision"] is None
    for obstacle in (f"box:{x},{y},{z},0.5,0.5,0.5", f"cylinder:{x},{y},{z},0.3,0.5,0.1,0.2,0.3"):
        assert run(*target, "--obstacle", obstacle, "--obstacle", "sphere:9,9,9,1") == 1
        assert obstacle[:3] in capsys.readouterr().err
    assert run(*target, "--obstacle", "sphere:9,9,9,1") == 0


@pytest.mark.parametrize(
    "text", ["ball:1,2,3,4", "sphere:1,2,3", "box:1,2,3,4", "sphere:a,b,c,d", "sphere:0,0,0,-1", "box"]
)
def test_bad_obstacles_are_named(text, capsys):
    assert run("--xyz", 1.0, 0.1, 0.2, "--obstacle", text) == 2
    said = capsys.readouterr().err
    assert text in said or "positive" in said
