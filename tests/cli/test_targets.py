"""`ik solve ROBOT --targets FILE`: every file format, the same results as solve_batch, errors that name the line."""

import functools
import signal
import tracemalloc

import numpy as np
import pytest
from folders import csv_rows, write_csv
from rich.progress import Progress
from robots import load, sample

import ik_toolkit as ik
from ik_toolkit.errors import InvalidTarget
from ik_toolkit.robot import pose_files
from ik_toolkit.robot.rotation import matrix_quat, matrix_rpy

ARM = "hydrolek_7w"


@pytest.fixture
def poses():
    return sample(load(ARM), 30, seed=4)[1]


def solved(path):
    rows = csv_rows(path)
    return np.array([[float(row[name]) for name in load(ARM).joint_names] for row in rows]), rows


@pytest.fixture
def solve(run):
    """Run `ik solve` for the robot of these tests; returns exit code, stdout, stderr."""
    return functools.partial(run, "solve", ARM)


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
        write_csv(tmp_path / "quat.csv", "x,y,z,qx,qy,qz,qw", np.c_[xyz, quat]): poses,
        write_csv(tmp_path / "rpy.csv", "Yaw, Pitch ,roll,z,y,x,note", mixed): poses,
        write_csv(tmp_path / "xyz.csv", "x,y,z", xyz): xyz,
    }  # fmt: skip


def test_every_form_of_file_gives_the_answers_of_a_batch(told, poses, tmp_path, monkeypatch):
    monkeypatch.setattr(pose_files, "LINES", 7)  # several chunks
    robot = load(ARM)
    for name, targets in files(poses, tmp_path).items():
        many = ik.solve_batch(robot, targets, "lm", seed=2)
        for output in (tmp_path / "out.csv", tmp_path / "out.npz"):
            given = ["solve", ARM, "--targets", tmp_path / name, "-o", output, "-s", "lm", "--seed", 2]
            answer = told(*given, code=not many.success.all())
            assert answer["targets"] == 30 and answer["solved"] == many.success.sum()
            assert answer["statuses"] == many.counts()
        found = np.load(tmp_path / "out.npz")
        q, rows = solved(tmp_path / "out.csv")
        assert np.array_equal(q, found["q"]) and found["joint_names"].tolist() == list(robot.joint_names)
        assert [ik.Status[row["status"]] for row in rows] == found["status"].tolist()
        assert np.array_equal([float(row["position_error"]) for row in rows], found["position_error"])
        assert np.allclose(q, many.q, atol=1e-4) and np.array_equal(many.status, found["status"])
        if name == "targets.npz":
            assert np.array_equal(q, many.q)


def test_axes_of_angles_are_said_to_move_with_the_body(solve, refused, poses, tmp_path):
    """Fixed axes in the reverse order are the same rotation, and the notice gives it."""
    rpy = np.array([matrix_rpy(T[:3, :3]) for T in poses[:3]])
    file = write_csv(tmp_path / "poses.csv", "x,y,z,rx,ry,rz", np.c_[poses[:3, :3, 3], rpy])
    code, _, said = solve("--targets", file, "--euler", "ZYX", "-o", tmp_path / "a.csv")
    assert code == 0 and "about z, y, x one after another, axes that move with the body (SciPy's 'ZYX')" in said
    assert "for fixed axes give the reverse order, --euler xyz" in said
    assert np.abs([load(ARM).fk(q).homogeneous for q in solved(tmp_path / "a.csv")[0]] - poses[:3]).max() < 1e-5
    wrong = refused("solve", ARM, "--targets", file, "--euler", "Zyx", "-o", tmp_path / "a.csv")
    assert "or ZYX, which is the same" in wrong


def test_degrees_are_for_the_angles_of_the_file(solve, poses, tmp_path):
    rpy = np.array([matrix_rpy(R) for R in poses[:5, :3, :3]])
    write_csv(tmp_path / "rad.csv", "x,y,z,roll,pitch,yaw", np.c_[poses[:5, :3, 3], rpy])
    write_csv(tmp_path / "deg.csv", "x,y,z,roll,pitch,yaw", np.c_[poses[:5, :3, 3], np.degrees(rpy)])
    assert solve("--targets", tmp_path / "rad.csv", "-o", tmp_path / "a.csv")[0] == 0
    assert solve("--targets", tmp_path / "deg.csv", "-o", tmp_path / "b.csv", "--deg")[0] == 0
    assert np.allclose(solved(tmp_path / "a.csv")[0], solved(tmp_path / "b.csv")[0], atol=1e-9)


def test_unsolved_targets_are_a_status_and_code_1(solve, tmp_path):
    write_csv(tmp_path / "far.csv", "x,y,z", [[1.0, 0.1, 0.2], [9, 9, 9]])
    code, out, err = solve("--targets", tmp_path / "far.csv", "-o", tmp_path / "out.csv")
    assert code == 1 and "1 UNREACHABLE" in out
    assert [row["status"] for row in csv_rows(tmp_path / "out.csv")] == ["CONVERGED", "UNREACHABLE"]
    alone = ik.solve(load(ARM), (9, 9, 9), "lm")
    assert f"target 2, the first not solved: UNREACHABLE: {alone.message}\n" in err


def test_options_reach_the_batch(solve, tmp_path):
    write_csv(tmp_path / "in.csv", "x,y,z", [[1.0, 0.1, 0.2]] * 2)
    arm, q0 = load(ARM), load(ARM).home
    given = ["--targets", tmp_path / "in.csv", "-o", tmp_path / "out.csv", "--closest", *q0, "--avoid-collisions"]
    assert solve(*given)[0] == 0
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
def test_bad_tables_are_named_by_line(solve, tmp_path, text, words):
    (tmp_path / "bad.csv").write_bytes(text.encode("latin-1"))
    code, _, err = solve("--targets", tmp_path / "bad.csv", "-o", tmp_path / "out.csv")
    assert code == 2 and words in err and "Traceback" not in err and not (tmp_path / "out.csv").exists()


def test_bad_arrays_are_named(refused, tmp_path):
    given = ["solve", ARM, "--targets", tmp_path / "bad.npz", "-o", tmp_path / "out.npz"]
    for arrays, words in (
        ({"q": np.zeros(3)}, "no array 'targets' or 'xyz', only q"),
        ({"targets": np.zeros((2, 5))}, "shape (2, 5)"),
        ({"xyz": np.zeros((2, 3)), "quat_xyzw": np.zeros((3, 4))}, "shape (N, 3)"),
        ({"xyz": np.zeros((2, 3)), "quat_xyzw": np.ones((2, 4))}, "row 0 (counted from 0): the quaternion"),
        (
            {"xyz": np.zeros((1, 3)), **{f"quat_{k}": np.ones((1, 4)) for k in ("xyzw", "wxyz")}},
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
        assert words in refused(*given)
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
    said = refused(*given)
    assert "'bad.npz' is not an NPZ file" in said and "pickle" not in said


def test_what_does_not_go_together(refused, tmp_path):
    good = write_csv(tmp_path / "in.csv", "x,y,z", [[1.0, 0.1, 0.2]])
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
        assert said in refused("solve", ARM, *words)
    assert not out.exists()


def test_an_interrupt_keeps_what_is_finished(solve, tmp_path, monkeypatch):
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
        code, _, err = solve("--targets", tmp_path / "in.npz", "-o", tmp_path / name)
        assert code == 130 and f"the first 4096 solutions are in {tmp_path / name}.partial" in err
        assert not (tmp_path / name).exists()
    assert len(solved(tmp_path / "out.csv.partial")[0]) == len(np.load(tmp_path / "out.npz.partial")["q"]) == 4096


def test_an_interrupt_in_the_middle_of_writing_waits_for_its_end(solve, tmp_path, monkeypatch):
    np.savez(tmp_path / "in.npz", targets=sample(load(ARM), 5)[1])
    real = np.savez

    def slow(file, **arrays):
        signal.raise_signal(signal.SIGINT)
        real(file, **arrays)

    monkeypatch.setattr(np, "savez", slow)
    code, _, err = solve("--targets", tmp_path / "in.npz", "-o", tmp_path / "out.npz")
    assert code == 130 and "the first 5 solutions are in" in err
    assert len(np.load(tmp_path / "out.npz.partial")["q"]) == 5


@pytest.mark.parametrize("name", ["out.csv", "out.npz"])
def test_answers_that_are_not_confirmed_are_left_under_another_name(solve, name, tmp_path, monkeypatch):
    robot = load(ARM)
    xyz = sample(robot, 1)[1][:, :3, 3].repeat(9000, axis=0)
    xyz[4500, 2] += 1e-3
    np.savez(tmp_path / "in.npz", targets=xyz)
    real = ik.Robot._errors
    doubted = lambda self, q, target: (1.0, None) if np.array_equal(target, xyz[4500]) else real(self, q, target)  # noqa: E731
    monkeypatch.setattr(ik.Robot, "_errors", doubted)
    code, out, err = solve("--targets", tmp_path / "in.npz", "-o", tmp_path / name, "--json")
    assert code == 1 and not out and "does not confirm the result for target 4500" in err
    assert f"{name}.failed" in err and not (tmp_path / name).exists()
    left = tmp_path / f"{name}.failed"
    if name == "out.npz":
        words = np.load(left)["status"]
        assert len(words) == 9000 and (words == ik.Status.CHECK_FAILED).all()
    else:
        words = [row["status"] for row in csv_rows(left)]
        assert len(words) > 4500 and {*words[4500:]} == {"CHECK_FAILED"}


# ------------------------------------------------------------------------------------------------------------- obstacles
def test_obstacles_on_the_command_line(solve, told):
    robot = load(ARM)
    target = ["--xyz", *robot.fk(robot.home).translation]
    assert told("solve", ARM, *target, "--avoid-collisions")["collision"] is None
    at = ",".join(map(str, np.round(robot.fk(robot.home).translation, 6)))
    found = told("solve", ARM, *target, "--obstacle", f"sphere:{at},0.3", code=1)
    assert found["status"] == "COLLISION" and "sphere_1" in found["collision"]
    for obstacle in (f"box:{at},0.5,0.5,0.5", f"cylinder:{at},0.3,0.5,0.1,0.2,0.3"):
        code, _, err = solve(*target, "--obstacle", obstacle, "--obstacle", "sphere:9,9,9,1")
        assert code == 1 and obstacle[:3] in err
    assert solve(*target, "--obstacle", "sphere:9,9,9,1")[0] == 0


@pytest.mark.parametrize(
    "text", ["ball:1,2,3,4", "sphere:1,2,3", "box:1,2,3,4", "sphere:a,b,c,d", "sphere:0,0,0,-1", "box"]
)
def test_bad_obstacles_are_named(refused, text):
    said = refused("solve", ARM, "--xyz", 1.0, 0.1, 0.2, "--obstacle", text)
    assert text in said or "positive" in said
