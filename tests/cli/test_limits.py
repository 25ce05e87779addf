"""`--limit JOINT:LOWER:UPPER` of `ik solve`, `ik path` and `ik track`: narrower limits, in degrees with --deg."""

import numpy as np
import pytest
from folders import write_csv
from robots import urdf

ARM = urdf(
    dict(kind="revolute", xyz="0 0 0", limits=(-2.0, 2.0)),
    dict(kind="prismatic", axis="1 0 0", xyz="0.2 0 0", limits=(0.0, 0.3)),
    name="slider",
)


@pytest.fixture
def arm(tmp_path):
    file = tmp_path / "slider.urdf"
    file.write_text(ARM)
    return file


def test_one_target_is_solved_inside_them(told, arm):
    asked = ["solve", arm, "--xyz", 0, 0.3, 0]
    for found in (told(*asked), told(*asked, "--limit", "j0:-1.7:1.6", "--limit", "j1::0.15")):
        assert found["success"] and abs(found["q"][0] - np.pi / 2) < 1e-5
    assert told(*asked, "--limit", "j1::0.05", code=1)["q"][1] <= 0.05
    assert abs(told(*asked, "--deg", "--limit", "j0:-90:80", code=1)["q"][0]) <= np.radians(90.0)


def test_many_targets_are_solved_inside_them(run, arm, tmp_path):
    targets, output = write_csv(tmp_path / "t.csv", "x,y,z", [[0, 0.3, 0], [0.3, 0, 0]]), tmp_path / "q.npz"
    code, _, _ = run("solve", arm, "--targets", targets, "-o", output, "--limit", "j0:-0.5:0.5")
    assert code == 1
    with np.load(output) as found:
        assert found["success"].tolist() == [False, True] and (np.abs(found["q"][:, 0]) <= 0.5).all()


def test_a_path_and_a_run_stay_inside_them(told, run, arm, tmp_path):
    poses = write_csv(tmp_path / "poses.csv", "x,y,z", [[0.3, 0, 0], [0.3, 0.02, 0], [0.3, 0.04, 0]])
    assert told("path", arm, "--poses", poses, "--limit", "j0:-0.1:")["status"] == "FOLLOWED"
    code, _, err = run("path", arm, "--poses", poses, "--limit", "j0:-0.1:0.05")
    assert code == 1 and "INCOMPLETE" in err
    line = ["track", arm, "--path", "line", "--start", "0.3 0 0", "--end", "0.3 0.1 0", "--position-only"]
    assert run(*line, "--limit", "j0::0.5")[0] == 0
    code, _, err = run(*line, "--limit", "j0::0.1")
    assert code == 1 and "j0" in err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--limit j9:0:1", "no joint 'j9'"),
        ("--limit j0:0", "--limit takes JOINT:LOWER:UPPER"),
        ("--limit j0:a:1", "--limit takes JOINT:LOWER:UPPER"),
        ("--limit j0:0,1:1", "--limit takes JOINT:LOWER:UPPER"),
        ("--limit j0:0:1 --limit j0:0:1", "'j0' twice"),
        ("--limit j0:0:9", "can only be narrowed: 0 to 9 rad"),
        (
            "--deg --limit j0:0:200",
            "0 to 3.49066 rad (0 to 200 deg) reaches beyond the robot's own -2 to 2 rad (-114.592",
        ),
        ("--limit j0:1:0", "'j0' are reversed"),
        ("--limit j0:0:1 --no-limits", "--limit has no effect without --limits"),
    ],
)
def test_what_is_no_narrower_range_is_refused(refused, arm, words, says):
    assert says in refused("solve", arm, "--xyz", 0.3, 0, 0, *words.split())


def test_a_value_beyond_its_limits_is_not_at_them(run, arm):
    for more, place in (("--no-limits",), "outside"), ((), "at limit"):
        table = run("solve", arm, "--xyz", -0.3, 0.01, 0, *more)[1].splitlines()
        (turn,) = (line for line in table if line.strip().startswith("j0"))
        assert turn.rstrip().endswith(place)
