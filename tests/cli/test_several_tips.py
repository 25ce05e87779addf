"""`ik solve` with several tips: all options of one tip, per tip where that makes sense; target files."""

import functools

import numpy as np
import pytest
from folders import csv_rows, write_csv
from robots import FORK, have_data

import ik_toolkit as ik
from ik_toolkit.robot.rotation import matrix_quat, matrix_rpy

BROKK = "brokk_hydrolek"
LEFT, RIGHT = "left_tip", "right_tip"
ONE = f"--target {LEFT}:1,0,1"


@pytest.fixture(scope="module")
def brokk():
    return ik.Tree.load(BROKK)


@pytest.fixture(scope="module")
def poses(brokk):
    """Targets (40, 2, 4, 4) that can be reached together."""
    rng = np.random.default_rng(7)
    return np.array([[T.homogeneous for T in brokk.fk(q).values()] for q in brokk.random_q(rng, 40)])


def words(tip, *values):
    return ["--target", f"{tip}:" + ",".join(f"{x:.12f}" for x in np.concatenate([np.ravel(v) for v in values]))]


@pytest.fixture
def answer(told):
    """What `ik solve` answers for the robot of these tests."""
    return functools.partial(told, "solve", BROKK)


# ---------------------------------------------------------------------------------------------------------- one target
def test_targets_are_positions_poses_by_angles_or_by_quaternion(answer, brokk, poses):
    T, U = poses[0]
    rpy = np.degrees(matrix_rpy(T[:3, :3]))
    found = answer(*words(LEFT, T[:3, 3], rpy), *words(RIGHT, U[:3, 3], matrix_quat(U[:3, :3])), "--deg")
    at = brokk.fk(found["q"])
    assert np.allclose(at[LEFT].homogeneous, T, atol=1e-5) and np.allclose(at[RIGHT].homogeneous, U, atol=1e-5)
    assert list(found["target"]) == [LEFT, RIGHT] and found["tips"][LEFT]["orientation_error"] < 1e-6


def test_a_tip_without_a_target_is_free(answer, run, brokk, poses):
    target = words(LEFT, poses[1][0][:3, 3])
    found = answer(*target)
    assert found["joint_names"] == list(brokk.joint_names) and list(found["target"]) == [LEFT]
    code, out, _ = run("solve", BROKK, *target)
    (row,) = (line.split() for line in out.splitlines() if line.startswith(f" {RIGHT} "))
    assert code == 0 and row == [RIGHT, "no", "target", "free", "free"]
    assert "turret" not in answer(*target, "--lock", "turret=0.3")["joint_names"]
    assert not answer(*words(LEFT, (9.0, 0.0, 0.0)), code=1)["success"]
    assert answer(*target, "--tip", LEFT)["joint_names"] == list(brokk.arms[0].joint_names)


def test_what_counts_is_given_for_all_tips_or_by_tip(answer, brokk, poses):
    T, U = poses[2]
    both = [*words(LEFT, T[:3, 3], matrix_quat(T[:3, :3])), *words(RIGHT, U[:3, 3], matrix_quat(U[:3, :3]))]
    far = U.copy()
    far[2, 3] += 0.5
    off = words(RIGHT, far[:3, 3], matrix_quat(far[:3, :3]))
    found = answer(*both[:2], *off, "--mask", f"{RIGHT}:1", 1, 0, 0, 0, 0)
    at = brokk.fk(found["q"])
    assert np.allclose(at[LEFT].homogeneous, T, atol=1e-5)
    assert np.allclose(at[RIGHT].translation[:2], U[:2, 3], atol=1e-5)
    found = answer(*both, "--slack", f"{LEFT}:0.02,0.02,0.02,5,5,5", "--frame", f"{LEFT}:target", "--deg")
    gap = np.abs(T[:3, :3].T @ (brokk.fk(found["q"])[LEFT].translation - T[:3, 3]))
    assert gap.max() < 0.02 + 1e-6 and found["tips"][LEFT]["position_error"] < 1e-6
    found = answer(*both, "--free-turn", f"{LEFT}:0,0,1", "--free-turn", f"{RIGHT}:1,0,0")
    at = brokk.fk(found["q"])
    assert np.allclose(at[LEFT].rotation[:, 2], T[:3, 2], atol=1e-5)
    assert np.allclose(at[RIGHT].rotation[:, 0], U[:3, 0], atol=1e-5)
    assert answer(*both, "--mask", 1, 1, 1, 0, 0, 0)["success"]


def test_directions_by_tip(answer, brokk, poses):
    T, U = poses[3]
    places = [*words(LEFT, T[:3, 3]), *words(RIGHT, U[:3, 3])]
    way = f"{LEFT}:" + ",".join(map(str, T[:3, 0]))
    found = answer(*places, "--direction", way, "--tip-axis", f"{LEFT}:1,0,0")
    at = brokk.fk(found["q"])
    assert np.allclose(at[LEFT].rotation[:, 0], T[:3, 0], atol=1e-5)
    assert np.allclose(at[RIGHT].translation, U[:3, 3], atol=1e-5)
    assert found["tips"][RIGHT]["orientation_error"] is None
    assert np.shape(found["target"][LEFT]) == (4, 4) and np.shape(found["target"][RIGHT]) == (3,)


def test_a_target_relative_to_another_tip(answer, run, brokk, poses):
    T, U = poses[4]
    between = np.linalg.inv(T) @ U
    relative = ["--relative", f"{RIGHT}:{LEFT}"]
    pose = words(RIGHT, between[:3, 3], matrix_quat(between[:3, :3]))
    found = answer(*words(LEFT, T[:3, 3]), *pose, *relative)
    at = brokk.fk(found["q"])
    assert np.allclose(at[LEFT].actInv(at[RIGHT]).homogeneous, between, atol=1e-5)
    assert np.allclose(at[LEFT].translation, T[:3, 3], atol=1e-5) and found["relative_to"] == {RIGHT: LEFT}
    found = answer(*pose, *relative)  # the other tip is free
    at = brokk.fk(found["q"])
    assert np.allclose(at[LEFT].actInv(at[RIGHT]).homogeneous, between, atol=1e-5)
    code, out, _ = run("solve", BROKK, *pose, *relative)
    assert code == 0 and "right_tip   left_tip" in out


def test_preferences_starts_and_histories(answer, run, brokk, poses, tmp_path):
    q = brokk.random_q(np.random.default_rng(3))
    T = brokk.fk(q)
    target = [*words(LEFT, T[LEFT].translation), *words(RIGHT, T[RIGHT].translation)]
    assert np.allclose(answer(*target, "--closest", *q)["q"], q, atol=1e-9)
    moved = brokk.fk(q + 0.01)
    step = [*words(LEFT, moved[LEFT].translation), *words(RIGHT, moved[RIGHT].translation)]
    assert np.abs(np.subtract(answer(*step, "--q0", *q, "--follow", 0.3)["q"], q)).max() <= 0.3
    assert answer(*target, "--objective", "mid-range", "--avoid-collisions")["success"]
    code, _, err = run("solve", BROKK, *target, "--plot", tmp_path / "error.svg")
    assert code == 0 and (tmp_path / "error.svg").stat().st_size


def test_all_solutions_fit_a_narrow_terminal(answer, run, brokk, poses, monkeypatch):
    T, U = poses[5]
    target = [*words(LEFT, T[:3, 3], matrix_quat(T[:3, :3])), *words(RIGHT, U[:3, 3], matrix_quat(U[:3, :3]))]
    found = answer(*target, "--all")
    assert len(found["solutions"]) > 4 and not found["complete"] and list(found["target"]) == [LEFT, RIGHT]
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = run("solve", BROKK, *target, "--all")
    tables = out[: out.index("solutions ")]
    assert code == 0 and max(map(len, tables.splitlines())) <= 80
    rows = [line.split() for line in tables.splitlines() if line.startswith(" turret ")]
    shown = [float(x) for row in rows for x in row[2:]]
    assert np.allclose(shown, [q[0] for q in found["solutions"]], atol=1e-6)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("--xyz 1 0 1", "leave out --xyz and give a --target TIP:X,Y,Z for each"),
        ("--xyz 1 0 1 --tip left_tip --tip right_tip", "--xyz is for one tip"),
        ("--xyz 1 0 1 --tip left_tip --relative right_tip:left_tip", "--relative has no effect without --target"),
        (f"{ONE} --tip right_tip", "'left_tip' is not one of the tips solved for"),
        (f"{ONE} --tip left_tip --tip left_tip", "--tip gives 'left_tip' twice"),
        (f"{ONE} --xyz 1 0 0", "--target cannot be combined with --xyz"),
        ("--target left_tp:1,0,1", "Did you mean 'left_tip'"),
        ("--target left_tip", "TIP:X,Y,Z"),
        (f"{ONE} {ONE}", "twice"),
        (f"{ONE},0,0,0,0", "--quat-xyzw has length 0"),
        ("--target left_tip:nan,0,1", "finite"),
        (f"{ONE} --mask 1 1 1 1 0 0", "must be 0"),
        (f"{ONE} -s state-space", "for several use 'lm'"),
        (f"{ONE},2", "--target takes TIP:X,Y,Z, TIP:X,Y,Z,ROLL,PITCH,YAW"),
        (f"{ONE} --mask left_tip:1,1", "--mask takes 6 numbers; got 2"),
        (f"{ONE} --mask 1,1,1,0,0,0 --mask 1,1,0,0,0,0", "--mask is given twice"),
        (f"{ONE} --slack 1,1,1,0,0,0 --slack left_tip:1,1,0,0,0,0", "once for all tips"),
        (f"{ONE} --free-turn left_tp:0,0,1", "Did you mean 'left_tip'"),
        (f"{ONE} --free-turn z --frame left_tip:world", "frame must be one of base, tip, target"),
        (f"{ONE} --direction right_tip:0,0,1", "needs a --target of right_tip"),
        (f"{ONE} --tip-axis 0,0,1", "--tip-axis has no effect without --direction"),
        (f"{ONE} --relative right_tip", "--relative takes TIP:OTHER"),
        (f"{ONE} --relative left_tip:left_tip", "is circular"),
        (f"{ONE} --q0 0 0", "--q0 takes 13 values"),
        (f"{ONE} -s inspection", "one tip"),
    ],
)
def test_what_does_not_go_together_is_refused_in_a_sentence(refused, line, said):
    assert said in refused("solve", BROKK, *line.split())


def test_tips_are_tracked_together(refused, told, run, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = run("track", BROKK, "--duration", "8")
    said = " ".join(out.split())
    assert code == 0 and "all joints swing a little from home" in said and "left_tip and right_tip" in said
    assert max(map(len, out.splitlines())) <= 80
    file = tmp_path / "run.csv"
    words = ["track", BROKK, "--length", "0.05", "--path", "line", "--duration", "2", "--relative", f"{RIGHT}:{LEFT}"]
    found = told(*words, "-o", file)
    assert found["tips"] == [LEFT, RIGHT] and found["status"] in ("COMPLETED", "SLOWED")
    head, *rows = file.read_text().splitlines()
    assert "left_tip.x" in head and "right_tip.z" in head and len(rows) == 201
    q = np.array([[float(x) for x in row.split(",")][1:14] for row in rows])
    tree = ik.Tree.load(BROKK, tips=[LEFT, RIGHT])
    held = [T[LEFT].actInv(T[RIGHT]).homogeneous for T in (tree.fk(one) for one in q[:: len(q) - 1])]
    assert np.allclose(held[0], held[1], atol=1e-3)
    assert np.linalg.norm(tree.fk(q[-1])[LEFT].translation - tree.fk(q[0])[LEFT].translation) > 0.049
    assert "--start and --end are for one tip" in refused("track", BROKK, "--start", "1", "0", "1")


def test_one_tip_is_asked_as_before(refused, told):
    found = told("solve", BROKK, "--xyz", 1.3, 0.4, 0.8, "--tip", LEFT)
    assert found["tip"] == LEFT and "tips" not in found
    alone = ["solve", "hydrolek_7w", "--xyz", 1, 0.1, 0.2]
    assert told(*alone, "--mask", "tool:1,1,1,0,0,0")["success"]
    assert "--direction TIP:... goes with --target" in refused(*alone, "--direction", "tool:0,0,1")


# ------------------------------------------------------------------------------------------------------ files of targets
def columns(tip, names):
    return ",".join(f"{tip}.{name}" for name in names.split(","))


def files(poses, folder):
    """The same targets in every form, and what a batch takes for them."""
    T, U = poses[:, 0], poses[:, 1]
    rpy = np.array([matrix_rpy(R) for R in T[:, :3, :3]])
    quat = np.array([matrix_quat(R) for R in U[:, :3, :3]])
    np.savez(folder / "stacked.npz", targets=poses)
    np.savez(folder / "turned.npz", targets=poses[:, ::-1], tips=[RIGHT, LEFT])
    np.savez(folder / "named.npz", **{LEFT: T, RIGHT: U})
    np.savez(folder / "mixed.npz", **{LEFT: T[:, :3, 3], RIGHT: U})
    head = ",".join([columns(RIGHT, "QX,qy,qz,qw,x,y,z"), "note", columns(LEFT, "x,y,z,roll,pitch,yaw")])
    write_csv(folder / "both.csv", head, np.c_[quat, U[:, :3, 3], np.zeros(len(T)), T[:, :3, 3], rpy])
    write_csv(folder / "one.csv", columns(RIGHT, "x,y,z"), U[:, :3, 3])
    both = {LEFT: T, RIGHT: U}
    return {
        "stacked.npz": both, "turned.npz": both, "named.npz": both, "mixed.npz": {LEFT: T[:, :3, 3], RIGHT: U},
        "both.csv": both, "one.csv": {RIGHT: U[:, :3, 3]},
    }  # fmt: skip


def test_every_form_of_file_gives_the_answers_of_a_batch(answer, brokk, poses, tmp_path):
    for name, targets in files(poses, tmp_path).items():
        many = ik.solve_batch(brokk, targets, seed=2)
        for output in (tmp_path / "out.csv", tmp_path / "out.npz"):
            given = ["--targets", tmp_path / name, "-o", output, "--seed", 2]
            found = answer(*given, code=not many.success.all())
            assert found["targets"] == 40 and found["solved"] == many.success.sum() and found["tips"] == [LEFT, RIGHT]
        kept = np.load(tmp_path / "out.npz")
        rows = csv_rows(tmp_path / "out.csv")
        q = np.array([[float(row[joint]) for joint in brokk.joint_names] for row in rows])
        assert np.array_equal(q, kept["q"]) and np.allclose(q, many.q, atol=1e-6)
        for tip in brokk.tips:
            key = f"{tip}.position_error"
            assert np.array_equal([float(row[key]) for row in rows], kept[key])
            assert np.allclose(kept[key], many.position_errors[tip], atol=1e-9)
            assert (f"{tip}.orientation_error" in kept) == (many.orientation_errors[tip] is not None)


def test_solutions_read_back_as_what_was_asked_for(answer, run, brokk, poses, tmp_path):
    files(poses, tmp_path)
    run("solve", BROKK, "--targets", tmp_path / "both.csv", "-o", tmp_path / "out.npz")
    kept = np.load(tmp_path / "out.npz")
    assert kept["tips"].tolist() == [LEFT, RIGHT] and kept["joint_names"].tolist() == list(brokk.joint_names)
    good = kept["success"]
    reached = np.array([[T.homogeneous for T in brokk.fk(q).values()] for q in kept["q"][good]])
    assert good.mean() > 0.9 and np.allclose(reached, poses[good], atol=1e-5)
    np.savez(tmp_path / "again.npz", targets=reached, tips=kept["tips"])  # and they are targets themselves
    again = answer("--targets", tmp_path / "again.npz", "-o", tmp_path / "b.npz")
    assert again["solved"] == good.sum()


def test_files_take_tips_degrees_and_relations(answer, brokk, poses, tmp_path):
    T = poses[:4]
    between = np.linalg.inv(T[:, 0]) @ T[:, 1]
    rpy = np.degrees([matrix_rpy(R) for R in between[:, :3, :3]])
    head = columns(LEFT, "x,y,z") + "," + columns(RIGHT, "x,y,z,roll,pitch,yaw")
    write_csv(tmp_path / "in.csv", head, np.c_[T[:, 0, :3, 3], between[:, :3, 3], rpy])
    words = ["--tip", RIGHT, "--tip", LEFT, "--relative", f"{RIGHT}:{LEFT}", "--deg"]
    answer("--targets", tmp_path / "in.csv", "-o", tmp_path / "out.npz", *words)
    tree = ik.Tree.load(BROKK, tips=[RIGHT, LEFT])
    kept = np.load(tmp_path / "out.npz")
    assert kept["joint_names"].tolist() == list(tree.joint_names)
    for q, one, wanted in zip(kept["q"], T, between, strict=True):
        at = tree.fk(q)
        assert np.allclose(at[LEFT].translation, one[0, :3, 3], atol=1e-5)
        assert np.allclose(at[LEFT].actInv(at[RIGHT]).homogeneous, wanted, atol=1e-5)


def test_a_file_with_one_tip_is_read_as_before(run, poses, tmp_path):
    file = write_csv(tmp_path / "in.csv", "x,y,z", poses[:3, 0, :3, 3])
    code, out, _ = run("solve", BROKK, "--tip", LEFT, "--targets", file, "-o", tmp_path / "out.csv")
    assert code == 0 and "3 of 3" in out and not any("." in name for name in csv_rows(tmp_path / "out.csv")[0])


@pytest.mark.parametrize(
    ("header", "row", "said"),
    [
        ("x,y,z", "1,0,1", "has no columns of left_tip, right_tip; its first line is left_tip.x,left_tip.y"),
        ("left_tip.x,left_tip.y", "1,0", "has no column left_tip.z"),
        (columns("left_tp", "x,y,z"), "1,0,1", "column 'left_tp.x': 'left_tp' is not one of the tips"),
        ("left_tip.x,left_tip.y,left_tip.z,left_tip.roll", "1,0,1,0", "has the columns left_tip.roll"),
        ("left_tip.x,left_tip.y,left_tip.z", "1,up,1", "line 2: 'up' is not a finite number"),
        (
            columns(RIGHT, "x,y,z,qx,qy,qz,qw"),
            "1,0,1,0,0,0,2",
            f"the quaternion {columns(RIGHT, 'qx,qy,qz,qw')} has length 2",
        ),
    ],
)
def test_csv_files_that_are_wrong_are_named(refused, tmp_path, header, row, said):
    file = tmp_path / "in.csv"
    file.write_text(f"{header}\n{row}\n")
    assert said in refused("solve", BROKK, "--targets", file, "-o", tmp_path / "out.csv")
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"targets": np.zeros((3, 4, 4))}, "have the shape (N, 2, 4, 4) or (N, 2, 3), not (3, 4, 4)"),
        ({"targets": np.zeros((3, 2, 3)), "tips": [LEFT, "right"]}, "'right' of 'tips' is not solved for"),
        ({"targets": np.zeros((3, 2, 3)), "tips": [LEFT, LEFT]}, "targets of left_tip, left_tip have the shape"),
        ({"left_tp": np.zeros((3, 3))}, "Did you mean 'left_tip'"),
        ({LEFT: np.zeros((3, 3)), "right_tp": np.zeros((3, 3))}, "Did you mean 'right_tip'"),
        ({LEFT: np.zeros((3, 3)), RIGHT: np.zeros((2, 3))}, "left_tip has 3, right_tip has 2"),
        ({LEFT: np.zeros((3, 5))}, "left_tip has the shape (N, 4, 4) or (N, 3), not (3, 5)"),
        ({"q": np.zeros(3)}, "it has q"),
    ],
)
def test_npz_files_that_are_wrong_are_named(refused, tmp_path, arrays, said):
    np.savez(tmp_path / "in.npz", **arrays)
    assert said in refused("solve", BROKK, "--targets", tmp_path / "in.npz", "-o", tmp_path / "out.npz")


@pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed (extra 'robots')")
def test_long_names_fit_a_terminal(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    left, right = "hand_left_tool_link", "hand_right_tool_link"
    words = ["--target", f"{left}:0.6,0.3,0.9", "--target", f"{right}:0,-0.4,0,0,0,0", "--relative", f"{right}:{left}"]
    code, out, _ = run("solve", "tiago_dual", *words)
    assert code == 0 and max(map(len, out.splitlines())) <= 80
    assert sum(line.split()[:2] == [right, left] for line in out.splitlines()) == 1


def test_a_robot_without_known_tips_is_asked_for_them_in_the_words_of_a_shell(refused, told, tmp_path):
    file = tmp_path / "fork.urdf"
    file.write_text(FORK)
    assert "has several likely tips: b, c; choose one with --tip; ik info" in refused("solve", file, "--xyz", 1, 0, 0)
    assert told("solve", file, "--target", "b:1,0,0")["joint_names"] == ["jb"]
    assert told("solve", file, "--target", "b:1,0,0", "--tip", "b", "--tip", "c")["joint_names"] == ["jb", "jc"]
