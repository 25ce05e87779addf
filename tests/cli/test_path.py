"""`ik path ROBOT --poses FILE`: every file format, exit codes, output, and what is kept of an interrupted search."""

import json
import re
import subprocess
import sys

import motions
import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.robot.rotation import matrix_quat

ARM = "hydrolek_7w"


@pytest.fixture(scope="module")
def poses():
    """Poses (N, 4, 4) along a joint motion of the arm."""
    robot = motions.load(ARM)
    return motions.tips(robot, motions.wave(robot, 25, 0.2))[:, 0]


@pytest.fixture
def files(poses, tmp_path):
    """The same poses as CSV, NPZ and JSON, by suffix."""
    quat = np.array([matrix_quat(R) for R in poses[:, :3, :3]])
    rows = np.hstack([poses[:, :3, 3], quat])
    np.savetxt(tmp_path / "in.csv", rows, delimiter=",", header="x,y,z,qx,qy,qz,qw", comments="", fmt="%.17g")
    np.savez(tmp_path / "in.npz", targets=poses)
    (tmp_path / "in.json").write_text(json.dumps({"xyz": poses[:, :3, 3].tolist(), "quat_xyzw": quat.tolist()}))
    return {suffix: tmp_path / f"in.{suffix}" for suffix in ("csv", "npz", "json")}


def test_every_form_of_file_gives_the_same_path(run, files, tmp_path):
    found = []
    for suffix, file in files.items():
        out = tmp_path / f"path.{suffix}"
        code, text, err = run("path", ARM, "--poses", file, "-o", out)
        assert code == 0 and "FOLLOWED" in text and f"wrote {out}" in err
        found.append(out)
    csv = np.genfromtxt(found[0], delimiter=",", names=True)
    q = np.stack([csv[name] for name in motions.load(ARM).joint_names], axis=1)
    with np.load(found[1]) as arrays:
        np.testing.assert_allclose(arrays["q"], q, atol=1e-6)
    np.testing.assert_allclose(json.loads(found[2].read_text())["q"], q, atol=1e-6)


def test_the_answer_is_that_of_solve_path(told, files, poses):
    found = told("path", ARM, "--poses", files["npz"], "--free-turn", "z", "--max-step-deg", "3")
    wanted = ik.solve_path(motions.load(ARM), poses, free_turn=(0.0, 0.0, 1.0), max_step=(np.radians(3.0), 0.02))
    assert found["success"] and found["status"] == wanted.status.name
    np.testing.assert_allclose(found["q"], wanted.q, atol=1e-9)
    assert found["largest_step"]["rad"] <= np.radians(3.0) * (1.0 + 1e-9)


def test_a_path_that_is_not_followed_ends_with_1_and_says_why(run, poses, tmp_path):
    far = poses.copy()
    far[10:13, 0, 3] += 5.0
    np.savez(tmp_path / "far.npz", targets=far)
    code, _, err = run("path", ARM, "--poses", tmp_path / "far.npz", "-o", tmp_path / "part.csv")
    assert code == 1 and "INCOMPLETE" in err
    assert re.search(r"pose 10: .*\(proven\)", err)
    rows = np.genfromtxt(tmp_path / "part.csv", delimiter=",", names=True)
    missing = np.isnan(rows[motions.load(ARM).joint_names[0]])
    assert missing[10:13].all() and not missing.all()  # the best partial path is kept


def test_a_trajectory_is_written_and_shown(run, files, tmp_path):
    pytest.importorskip("scipy")
    timed = ("path", ARM, "--poses", files["csv"], "--retime", "--velocity", "0.5", "--acceleration", "1")
    for name in ("t.csv", "t.json"):
        code, text, _ = run(*timed, "-o", tmp_path / name, "--rate", "50")
        assert code == 0 and re.search(r"trajectory +lasts .* samples, off by .* at most", text)
    ros = json.loads((tmp_path / "t.json").read_text())
    rates = np.array([point["velocities"] for point in ros["points"]])
    assert np.abs(rates).max() <= 0.5 * (1.0 + 1e-9) and len(ros["points"]) > 20
    for name in ("t.csv", "t.json"):
        code, _, _ = run("view", ARM, "--motion", tmp_path / name, "--html", tmp_path / f"{name}.html")
        assert code == 0 and (tmp_path / f"{name}.html").stat().st_size > 1000


def test_pictures_are_drawn(run, files, tmp_path):
    code, _, err = run(
        "path", ARM, "--poses", files["csv"], "--plot", tmp_path / "p.svg", "--html", tmp_path / "p.html"
    )
    assert code == 0 and "p.svg" in err and "p.html" in err
    assert "wrist_roll" in (tmp_path / "p.svg").read_text()


@pytest.mark.parametrize(
    "words, said",
    [
        ("--velocity 1", "--velocity has no effect without --retime"),
        ("--retime", "--retime needs --acceleration"),
        ("--retime --acceleration 1 -o x.npz", ".csv or .json"),
        ("--max-step-deg 0", "--max-step-deg must be positive"),
        ("--free-turn w", "--free-turn (x, y, z, or a vector) takes 3 numbers"),
        ("--reconfigurations many", "reconfigurations must be 'fewest'"),
        ("--plot x.txt", "the file of --plot is written as"),
    ],
)
def test_mistakes_are_said_before_the_search(refused, files, words, said):
    assert said in refused("path", ARM, "--poses", files["csv"], *words.split())


def test_files_that_hold_no_poses_are_named(refused, tmp_path):
    for text, said in (
        ("{", "cannot read"),
        ('{"xyz": [["a", 1, 2]]}', 'row 0 of xyz (counted from 0) is ["a", 1, 2], not numbers'),
        ("[]", "targets"),
    ):
        (tmp_path / "in.json").write_text(text)
        err = refused("path", ARM, "--poses", tmp_path / "in.json")
        assert said in err and "in.json" in err
    (tmp_path / "in.csv").write_text("x,y,z\n")
    assert "no rows below it" in refused("path", ARM, "--poses", tmp_path / "in.csv")


def test_the_best_path_so_far_is_kept_when_it_is_stopped(run, files, tmp_path, monkeypatch):
    from ik_toolkit.paths import solve_path as module

    def stopped(arm, targets, **options):
        raise module.PathInterrupted(motions.as_result(arm, motions.wave(arm, 25, 0.2)))

    monkeypatch.setattr(module, "solve_path", stopped)
    code, _, err = run("path", ARM, "--poses", files["csv"], "-o", tmp_path / "out.csv")
    assert code == 130 and "out.csv.partial" in err and not (tmp_path / "out.csv").exists()
    assert (tmp_path / "out.csv.partial").read_text().startswith("pose,")


STOPPED = """
import signal, sys
from ik_toolkit.cli import main
from ik_toolkit.paths import finish

def stopping(*what):  # Ctrl-C when the best path is known, and is being proven for the first time
    finish.proven = proven
    signal.raise_signal(signal.SIGINT)

proven, finish.proven = finish.proven, stopping
sys.exit(main(sys.argv[1:]))
"""


def test_a_signal_keeps_the_best_path_and_ends_with_130(files, poses, tmp_path):
    out = tmp_path / "out.csv"
    command = [sys.executable, "-c", STOPPED, "path", ARM, "--poses", files["csv"], "-o", out]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 130 and "Traceback" not in done.stderr
    assert "the best path so far, FOLLOWED, is in" in done.stderr and not out.exists()
    rows = np.genfromtxt(f"{out}.partial", delimiter=",", names=True)
    arm = motions.load(ARM)
    q = np.stack([rows[name] for name in arm.joint_names], axis=1)
    assert max(arm.errors(x, T)[0] for x, T in zip(q, poses, strict=True)) < 1e-6
