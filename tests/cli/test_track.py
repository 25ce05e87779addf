"""`ik track`: its tables, what it refuses and what it doubts."""

import re

import numpy as np
import pytest


def figures(out):
    """Numbers of the tables of a run, by the name and the unit of their row."""
    rows = [line.partition("]") for line in out.splitlines() if line.startswith(" ") and "]" in line]
    return {f"{name.strip()}]": [float(x) for x in numbers.split()[:3]] for name, _, numbers in rows if "." in numbers}


def sizes(row):
    """Lengths [m] or angles [rad] of a row in which each has its unit."""
    units = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "deg": np.pi / 180, "rad": 1.0, "urad": 1e-6, "nrad": 1e-9}
    return [float(number) * units[unit] for number, unit in re.findall(r"([\d.]+) ([a-z]+)", row)]


def test_tables_of_a_run_follow_deg_and_lengths_stay_in_metres(run):
    words = ("track", "inspection_7dof", "--duration", "20")
    (code, plain, _), (_, degrees, _) = run(*words), run(*words, "--deg")
    assert code == 0 and "[rad]" not in degrees and "[rad]" in plain and "[deg]" not in plain
    wanted, found = figures(plain), figures(degrees)
    np.testing.assert_allclose(np.radians(found["arm_pitch [deg]"]), wanted["arm_pitch [rad]"], rtol=0.02)
    assert found["lift [m]"] == wanted["lift [m]"]
    for name in ("position", "orientation"):
        (one,), (other,) = (
            [line for line in out.splitlines() if line.startswith(f" {name} ")] for out in (plain, degrees)
        )
        assert name == "orientation" or one == other
        np.testing.assert_allclose(sizes(one), sizes(other), rtol=0.02)
    assert "[deg/s]" in run("track", "planar_2r", "--duration", "2", "--deg")[1]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--on-limit slwo", "ik: no --on-limit 'slwo'. Did you mean 'slow'?"),
        ("--acceleration -2", "ik: --acceleration must be positive, not -2"),
        ("--acceleration 2 --no-limits", "ik: --acceleration must go with --limits"),
        ("--position-tolerance 0", "ik: --position-tolerance [m] must be a positive number, not 0"),
        ("--radius 0.1 --position-tolerance 0", "ik: --position-tolerance [m] must be a positive number, not 0"),
        ("--orientation-tolerance 0", "ik: --orientation-tolerance [rad] must be a positive number, not 0"),
        ("--max-stretch 0.5", "ik: --max-stretch must be at least 1, not 0.5"),
        ("--duration -1", "ik: --duration [s] must be a positive number, not -1"),
        ("--rate 1e9", "ik: --rate 1e+09 over 10 s is 1e+10 steps; at most 1e+07"),
        ("--kp 20", "ik: --kp is an option of ca, not of cv\n"),
        ("--kappa 5 -p kappa=3", "ik: -p cannot set kappa: the command has options for that"),
        ("--turns 0", "ik: --turns must not be 0 with --path circle"),
        ("--turns 0 --path eight --radius 0.1", "ik: --turns must not be 0 with --path eight"),
        ("--turns 1.5 --path line", "ik: rounds of a line must be a whole number of at least 0, not 1.5"),
        ("--on-limit direct", "ik: no --on-limit 'direct'; 'direct' is for ik.Tracker. Available: slow, leave, clip."),
        ("-m newton", "ik: 'newton' is a solver that cannot track; methods that can: cv, av, ca, aa, aad, lm, dls"),
        ("-p gamma=1", "ik: gamma is an option of aad, not of cv\n"),
        ("--q0 5 0", "ik: --q0 is outside the limits of joint_1; move it inside or use --no-limits"),
    ],
)
def test_errors_name_options_as_they_are_typed(refused, words, says):
    assert refused("track", "planar_2r", "--position-only", *words.split()).startswith(says)


def test_words_and_what_somebody_typed_are_not_taken_for_options(refused):
    for words, says in (
        ("--tip tip=,", "'tip=,'"),
        ("--path limits=False", "no path 'limits=False'"),
        ("-p on_limit=slow", "-p cannot set on_limit"),
    ):
        assert says in refused("track", "planar_2r", *words.split())


def test_a_line_of_no_turns_goes_one_way(told):
    words = "track planar_2r --path line --axis -1 0 0 --position-only --duration 2".split()
    assert told(*words)["figures"]["peak_speed"] == told(*words, "--turns", 0)["figures"]["peak_speed"]


def test_a_path_in_millimetres_is_doubted(run, tmp_path, monkeypatch):
    file = tmp_path / "mm.csv"
    file.write_text("t,x,y,z\n0,1200,0,0\n1,1201,5,0\n2,1202,0,0\n3,1201,5,0\n")
    path = ("--path", "line", "--length", "300", "--axis", "1", "0", "0")
    for words in (("--radius", "100"), path, ("--path", file)):
        monkeypatch.setattr("ik_toolkit.errors.DOUBTED", set())  # what is doubted once in a process
        err = run("track", "planar_2r", "--position-only", "--max-stretch", "1", *words)[2]
        assert "the path of tool on planar_2r: " in err and "were millimetres meant?" in err, err
    assert "millimetres" not in run("track", "planar_2r", "--position-only", "--radius", "0.4")[2]


def test_a_run_is_written_as_a_page(run, tmp_path):
    pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")
    page = tmp_path / "run.html"
    code, _, err = run("track", "planar_3r", "--path", "circle", "--radius", "0.1", "--duration", "2", "--html", page)
    text = page.read_text()
    assert code == 0 and f"wrote {page}" in err and "planar_3r" in text
