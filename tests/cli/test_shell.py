"""What a shell gives to `ik`: words to complete, standard input, and a name to call it by."""

import io
import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from robots import MIMIC, have_data, urdf

import ik_toolkit as ik
from ik_toolkit.errors import ModelError
from ik_toolkit.robot.library import shipped_robots
from ik_toolkit.text import in_shell, program

DATA = pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed (extra 'robots')")


@pytest.fixture
def completed(run, capsys, monkeypatch):
    """What bash offers for the last word of a line."""

    def call(line):
        words = line.split(" ")
        monkeypatch.setenv("_IK_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", line)
        monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
        with pytest.raises(SystemExit) as ended:
            run()
        out, err = capsys.readouterr()
        assert ended.value.code == 0 and err == ""
        return out.split()

    return call


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("ik solve hyd", ["hydrolek_7w"]),
        ("ik info planar_", ["planar_2r", "planar_3r"]),
        ("ik bench hydrolek_7w car", ["cartesian_pp"]),
        ("ik check insp", ["inspection_7dof"]),
        ("ik solve brokk_hydrolek --tip l", ["left_tip"]),
        ("ik solve brokk_hydrolek --tip left_tip --tip ", ["left_tip", "right_tip"]),
        ("ik fk brokk_hydrolek --tip left_tip --tip r", ["right_tip"]),  # fk takes one tip, and will say so
        ("ik solve --xyz 1 0 0 brokk_hydrolek --ee r", ["right_tip"]),
        ("ik solve hydrolek_7w --base link_", [f"link_{k}" for k in range(1, 7)]),
        ("ik solve hydrolek_7w -s dl", ["dls"]),
        ("ik solve hydrolek_7w --solver au", ["auto"]),
        ("ik bench -s lm,dl", ["lm,dls"]),
        ("ik solvers cc", ["ccd"]),
        ("ik tune hydrolek_7w pi", ["pid", "pinv"]),
        ("ik workspace hydrolek_7w -s cc", ["ccd"]),
        ("ik view hydrolek_7w -s cc", ["ccd"]),
        ("ik solve hydrolek_7w --q0 0.1 0.2 --tip-", ["--tip-axis"]),
        # Without an answer of ours the shell completes names of files.
        ("ik solve ./", []),
        ("ik solve nothing_of_this_name --tip a", []),
        ("ik solve --tip a", []),
    ],
)
def test_words_are_completed(completed, line, offered):
    assert sorted(completed(line)) == offered


def test_links_of_a_file_are_completed(completed, tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_text(MIMIC)
    assert completed(f"ik solve {file} --tip l") == [f"l{k}" for k in range(9)]


@DATA
def test_names_of_example_robot_data_are_completed(completed):
    assert completed("ik solve pand") == ["panda"]
    # one of the robots that only `ik robots --all` lists
    assert completed("ik solve solo1") != []


def test_completion_loads_neither_pinocchio_nor_numba():
    code = (
        "import sys, ik_toolkit.cli as c\ntry: c.main(['x'])\n"
        "except SystemExit: print([m for m in ('pinocchio', 'numba') if m in sys.modules])"
    )
    words = {"_IK_COMPLETE": "complete_bash", "COMP_WORDS": "ik solve hyd", "COMP_CWORD": "2"}
    done = subprocess.run([sys.executable, "-c", code], env={**os.environ, **words}, capture_output=True, text=True)
    assert done.stdout.split() == ["hydrolek_7w", "[]"], done.stderr


@pytest.fixture
def pipe(run, monkeypatch):
    """Run a command line with bytes or text on its standard input."""

    def call(given, *arguments):
        data = given.encode() if isinstance(given, str) else given
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
        return run(*arguments)

    return call


def test_a_robot_from_standard_input(told, run, pipe):
    name = "planar_2r"
    text = shipped_robots()[name].path.read_text()
    answer = json.loads(pipe(text, "fk", "-", "--q", "0.3", "0.4", "--json")[1])
    assert answer["robot"] == name and answer == told("fk", shipped_robots()[name].path, "--q", "0.3", "0.4")
    assert pipe(text, "check", "-")[:2] == run("check", shipped_robots()[name].path)[:2]
    assert pipe("﻿ \n<mujoco model='m'>", "info", "-")[0] == 2
    assert pipe("\n", "info", "-") == (2, "", "ik: standard input is empty\n")
    assert pipe(bytes(100), "info", "-") == (2, "", "ik: standard input is neither UTF-8 text nor an NPZ file\n")
    code, _, err = pipe(text.ljust(20_000_002), "info", "-")  # with more spaces at the end than a robot may have bytes
    assert code == 2 and "larger than 20 MB" in err
    code, _, err = pipe("<robot name='a/../b'/>", "info", "-")  # no path for a file name
    assert code == 2 and "stdin" in err + "stdin"


@pytest.mark.parametrize("given", [("-o", "-"), ("--output=-",), ("--html", "-")])
def test_nothing_is_written_to_standard_input(given, pipe, tmp_path):
    """A - is standard input everywhere: solutions written to its temporary file would be gone."""
    poses = tmp_path / "poses.csv"
    poses.write_text("x,y,z\n1,0.1,0.2\n")
    for targets in (poses, "-"):
        code, out, err = pipe("x,y,z\n1,0.1,0.2\n", "solve", "hydrolek_7w", "--targets", targets, *given)
        assert code == 2 and not out and f"{given[0].partition('=')[0]} takes the name of a file, not -" in err


def test_targets_from_standard_input(pipe, tmp_path):
    rows = np.array([[1.0, 0.1, 0.2], [1.0, 0.2, 0.1], [0.9, 0.2, 0.3]])
    table = "x,y,z\n" + "".join(f"{x},{y},{z}\n" for x, y, z in rows)
    packed = io.BytesIO()
    np.savez(packed, targets=rows)
    for given, option in ((table, ("--targets", "-")), (packed.getvalue(), ("--targets=-",))):
        output = tmp_path / "solutions.csv"
        code, out, _ = pipe(given, "solve", "hydrolek_7w", *option, "-o", output, "--json")
        assert code == 0 and json.loads(out)["solved"] == len(rows)
        found = np.loadtxt(output, delimiter=",", skiprows=1, usecols=range(6))
        robot = ik.Robot.load("hydrolek_7w")
        assert np.allclose([robot.fk(q).translation for q in found], rows, atol=1e-6)
        output.unlink()


def test_standard_input_is_read_once(pipe):
    code, _, err = pipe("", "solve", "-", "--targets", "-")
    assert code == 2 and "standard input, which can be read only once" in err


@pytest.fixture
def elsewhere(monkeypatch, tmp_path):
    """A shell that finds no `ik`, and no Python, as in a notebook whose environment is not activated."""
    monkeypatch.setenv("PATH", str(tmp_path))
    program.cache_clear()
    yield tmp_path
    program.cache_clear()


def test_commands_are_named_as_the_shell_finds_them(run, elsewhere):
    called = f"{sys.executable} -m ik_toolkit"
    code, _, err = run("solve", "hydrolek_7w", "--xzy", "1", "0", "0")
    assert code == 2 and f"See {called} solve --help" in err
    _, out, _ = run("solve", "--help")
    assert out.startswith(f"Usage: {called} solve ROBOT") and f"{called} solve hydrolek_7w --xyz" in out
    assert f"see {called} solvers." in " ".join(out.split()) and " ik " not in out
    assert f"{called} --help" in run("sovle")[2]
    with pytest.raises(ModelError, match=re.escape(f"`{called} check` lists them")):
        ik.Robot.load(MIMIC.replace('type="revolute"', 'type="revolt"'))
    degrees = [dict(kind="revolute", limits=(-120, 120), xyz="0 0 0.2") for _ in range(3)]
    assert f"2 more, see {called} check" in ik.Robot.load(urdf(*degrees)).notes[0]


def test_python_is_named_shortly_where_it_is_ours(monkeypatch, elsewhere):
    python = elsewhere / "python"
    python.touch(0o755)
    assert program() == f"{sys.executable} -m ik_toolkit"  # a Python, but not the one this package is installed for
    program.cache_clear()
    monkeypatch.setattr(sys, "executable", str(elsewhere / "python3"))
    assert program() == "python -m ik_toolkit"


def test_every_command_is_named(run):
    """`in_shell` knows all commands."""
    program.cache_clear()
    _, out, _ = run("--help")
    commands = re.findall(r"^  (\w+)  ", out[out.index("Commands:") : out.index("Other:")], re.MULTILINE)
    assert len(commands) > 15
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ik_toolkit.text.program", lambda: "X")
        assert [in_shell(f"see ik {command}") for command in commands] == [f"see X {command}" for command in commands]


def test_mimic_joints_are_shown(told, run, tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_text(MIMIC)
    robot = ik.Robot.load(file)
    q = robot.random_q(np.random.default_rng(8))
    at = robot.joint_values(q)
    typed = ",".join(map(str, q))
    followers = {"j2": at["j2"], "j4": at["j4"]}
    assert told("solve", file, "--from-q", typed, "--q0", typed)["mimic_joints"] == pytest.approx(followers, abs=1e-6)
    assert told("fk", file, "--q", typed)["mimic_joints"] == pytest.approx(followers)
    for more, angle in (((), at["j2"]), (("--deg",), np.degrees(at["j2"]))):
        typed = ",".join(map(str, np.degrees(q) if more else q))  # all joints of this q turn
        _, out, _ = run("solve", file, "--from-q", typed, "--q0", typed, *more)
        rows = {row.split()[0]: row.split() for row in out.splitlines() if row.split()}
        assert float(rows["j2"][1]) == pytest.approx(angle, abs=1e-3)
        own = ["deg", "-57.2958", "57.2958"] if more else ["rad", "-1.000000", "1.000000"]
        assert rows["j2"][2:] == [*own, "follows", "j1"]
        assert float(rows["j4"][1]) == pytest.approx(at["j4"], abs=1e-5)
        assert rows["j4"][2:] == ["m", "-0.300000", "0.300000", "follows", "j0"]
    plain, turned = (" ".join(run("info", file, *more)[1].split()) for more in ((), ("--deg",)))
    assert "j2 = -0.6 j1 + 0.200000 rad, limits -1.000000 to 1.000000 rad; j4 = 0.1 m/rad j0 + 0.050000 m" in plain
    assert "j2 = -0.6 j1 + 11.4592 deg, limits -57.2958 to 57.2958 deg; j4 = 0.00174533 m/deg j0 + 0.050000 m" in turned
    assert told("info", file)["mimic_joints"]["j4"] == {
        "leader": "j0", "ratio": 0.1, "offset": 0.05, "kind": "prismatic", "lower": -0.3, "upper": 0.3,
    }  # fmt: skip
    assert told("info", "hydrolek_7w")["mimic_joints"] == {}
