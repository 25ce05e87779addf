"""User errors, bugs, interrupts and closed pipes: one sentence, an exit code, never a traceback."""

import importlib.metadata
import os
import signal
import subprocess
import sys
import time

import pytest
import robots
from folders import ROOT

import ik_toolkit as ik
from ik_toolkit import cli, errors
from ik_toolkit.solvers import registry

DH = str(ROOT / "urdf" / "dh" / "inspection_7dof.toml")
SOLVE = "solve hydrolek_7w --xyz 1.0 0.1 0.2"


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("slove", "Did you mean 'solve'"),
        ("solve", "Missing argument 'ROBOT'"),
        ("solve hydrolek_7w", "Missing option '--xyz'"),
        ("solve hydrolec_7w --xyz 1 0 0", "Did you mean 'hydrolek_7w'"),
        ("solve nowhere.urdf --xyz 1 0 0", "there is no file 'nowhere.urdf'"),
        ("solve hydrolek_7w --xyz 1 0", "--xyz takes 3 numbers; got 2"),
        ("solve hydrolek_7w --xyz nan 0 0", "finite"),
        ("solve hydrolek_7w --xyz 1 0 inf", "finite"),
        (f"{SOLVE} --rpy 0 0", "--rpy takes 3 numbers"),
        (f"{SOLVE} --quat-xyzw 0 0 0 0", "--quat-xyzw has length 0"),
        (f"{SOLVE} --rpy 0 0 0 --quat-xyzw 0 0 0 1", "give one of rpy"),
        (f"{SOLVE} --quat-wxyz 0 0 0 0", "--quat-wxyz has length 0"),
        (f"{SOLVE} --from-q home", "--from-q cannot be combined with --xyz"),
        ("solve hydrolek_7w --targets DH --from-q home", "--from-q cannot be combined with --targets"),
        ("solve hydrolek_7w --from-q 1 2", "--from-q takes 6 values, one per joint"),
        (f"{SOLVE} --timeout -1", "timeout must be finite and at least 0"),
        (f"{SOLVE} --all --timeout 1", "it takes no 'timeout'"),
        (f"{SOLVE} --matrix 1 0 0 0 0 1 0 0 0 0 1 0", "--matrix cannot be combined with --xyz"),
        ("solve hydrolek_7w --matrix 1 0 0 0 0 1 0 0 0 0", "--matrix takes 12 or 16 numbers, row by row; got 10"),
        ("solve hydrolek_7w --matrix 1 0 0 0 0 1 0 0 0 0 1 0 1 1 1 0", "last row of a pose must be 0 0 0 1"),
        ("solve hydrolek_7w --matrix 2 0 0 0 0 1 0 0 0 0 1 0", "rotation is not rigid"),
        (
            "solve hydrolek_7w --matrix 1 0 0 0 0 1 0 0 0 0 1 0 --direction 0 0 1",
            "--matrix cannot be combined with --direction",
        ),
        ("solve hydrolek_7w --target tool:1,0,0,0,0,1,0,0,0,0 --tip tool", "12 or 16 numbers of a matrix"),
        ("info hydrolek_7w --tip tool --ee tool", "takes one tip and --tip or --ee names 2"),
        (f"{SOLVE} -s ml", "Did you mean 'lm'"),
        (f"{SOLVE} -p dampng=1", "Did you mean 'damping'"),
        (f"{SOLVE} -p damping", "-p takes NAME=VALUE"),
        (f"{SOLVE} -p damping=much", "takes a number"),
        (f"{SOLVE} --tolerance inf", "must be finite and at least 1e-14"),
        (f"{SOLVE} --max-iterations -5", "--max-iterations"),
        (f"{SOLVE} --tolerance -1", "ik: --tolerance must be"),
        *(
            (f"{SOLVE} --tolerance {word}", f"--tolerance takes a number, not '{word}'")
            for word in ("1_0", "\uff11", "nan", "small")
        ),
        *((f"bench planar_2r -n {word}", "-n takes a whole number, not '") for word in ("1_0", "\uff11", "3.5", "inf")),
        ("solve hydrolek_7w --xyz 1_0 0 0", "--xyz takes 3 numbers, not '1_0 0 0'"),
        ("solve hydrolek_7w --xyz here 0 0", "--xyz takes 3 numbers, not 'here 0 0'"),
        ("solve hydrolek_7w --xyz \uff11,0,0", "--xyz takes 3 numbers, not '\uff11,0,0'"),
        (f"{SOLVE} -s dls -p damping=\uff11", "takes a number"),
        ("check planar_2r --self-collision --seed -1", "--seed must be a whole number of at least 0, not -1"),
        ("calibrate planar_2r --suggest 3 --seed -1", "--seed must be a whole number of at least 0"),
        (f"{SOLVE} --obstacle sphere:nan,1,1,1,1", "--obstacle takes finite numbers; not 'sphere:nan,1,1,1,1'"),
        (f"{SOLVE} --base-xyz nan 0 0", "--base-xyz and --base-rpy take finite numbers"),
        (f"{SOLVE} --package-dir gone", "--package-dir: there is no folder 'gone'"),
        (f"{SOLVE} --rail 1 0", "--rail of 'base_x' must be two finite numbers, lower and upper"),
        ("reach planar_2r --audit 1_0", "--audit is 'full' or a number of noes, not '1_0'"),
        ("calibrate planar_2r --suggest -1", "--suggest must be a whole number of at least 1, not -1"),
        ("tune planar_2r pid --seconds -1", "--seconds must not be negative, not -1"),
        ("tune planar_2r pid --targets 0", "--targets must be a whole number of at least 1, not 0"),
        (f"{SOLVE} -o x.png", "a solve without --targets is written as .json, not 'x.png'"),
        (f"{SOLVE} --all -o x", "is written as .json, not 'x'"),
        ("solve hydrolek_7w --targets DH -o x.json", "is written as .csv, .npz or .parquet, not 'x.json'"),
        ("convert planar_2r -o x.foo", "the file of -o/--output is written as .urdf or .xml, not 'x.foo'"),
        ("dh DH -o x.csv", "is written as .urdf or .xml, not 'x.csv'"),
        ("bench planar_2r -o x.csv", "is written as .json, not 'x.csv'"),
        ("calibrate planar_2r --suggest 3 -o x.urdf", "what --suggest finds is written as .csv, not"),
        (f"{SOLVE} --tip tol", "Did you mean 'tool'"),
        (f"{SOLVE} --base bas_link", "Did you mean 'base_link'"),
        (f"{SOLVE} --q0 1 2", "--q0 takes 6 values, one per joint (azimuth_yaw"),
        (f"{SOLVE} --q0 nan 0 0 0 0 0", "--q0 is not finite at joint azimuth_yaw"),
        (f"{SOLVE} --lock wrist=1", "Did you mean 'wrist_"),
        (f"{SOLVE} --all --closest 0 0 0 0 0 0", "--all lists the solutions nearest to --q0"),
        (f"{SOLVE} --all --objective mid-range", "takes no 'objective'"),
        (f"{SOLVE} --lock wrist_roll", "--lock takes NAME=VALUE"),
        (f"{SOLVE} --lock wrist_roll=up", "takes one number"),
        (f"{SOLVE} -o no/such/folder/file.json", "there is no folder"),
        (f"{SOLVE} --bogus", "No such option: --bogus"),
        ("track planar_2r --tolerance-position 1", "--tolerance-position (Possible options: --position-tolerance)"),
        ("solve brokk_hydrolek --xyz 1 0 0", "choose one with --tip: left_tip, right_tip"),
        ("track planar_2r --q0", "Option '--q0' requires an argument. See ik track --help"),
        ("fk hydrolek_7w --q 1", "--q takes 6 values"),
        ("solvers lmm", "Did you mean 'lm'"),
        ("check nothing.urdf", "there is no file"),
        ("check /dev/null", "is not a regular file"),
        ("gains planar_2r --rate 0", "--rate must be positive"),
        ("solve hydrolek_7w --xyz 1,5 0 0.3", "got 4 (a comma separates numbers); write decimals with a point: "),
        ("solve hydrolek_7w --xyz 1,5 -0,5 .3", "write decimals with a point: --xyz 1.5 -0.5 .3"),
        ("solve hydrolek_7w --xyz 0,5;0;0,3", "write decimals with a point: --xyz 0.5 0 0.3"),
        ("solve hydrolek_7w --xyz 1,5 0", "--xyz '1,5 0' can be read as 1 5 0 or as 1.5 0; write one of them"),
        (f"{SOLVE} --mask 0,5 1 1 0 0 0", "--mask 0.5 1 1 0 0 0"),
        (f"{SOLVE} --q0 0,5 0 0 0 0", "--q0 '0,5 0 0 0 0' can be read as 0 5 0 0 0 0 or as 0.5 0 0 0 0"),
        (f"{SOLVE} --q0 0,5 0 0 0 0 0", "can be read as 0 5 0 0 0 0 0 or as 0.5 0 0 0 0 0; write one of them"),
        (f"{SOLVE} --q0 0,5 0.1 0 0 0 0", "--q0 0.5 0.1 0 0 0 0"),
        (
            f"{SOLVE} --tolerance 0,001",
            "--tolerance takes a number, not '0,001' (a comma separates numbers); write dec",
        ),
        (f"{SOLVE} -p damping=0,1", "write decimals with a point: damping = 0.1"),
        (f"{SOLVE} --lock wrist_roll=0,5", "write decimals with a point: --lock wrist_roll=0.5"),
        (f"{SOLVE} --limit wrist_roll:-0,5:0,5", "not 'wrist_roll:-0,5:0,5'; write decimals with a point"),
        ("solve hydrolek_7w --target tool:1,5 0 0,3", "write decimals with a point: --target tool: 1.5 0 0.3"),
        ("track planar_2r --duration 1,5", "write decimals with a point: --duration 1.5"),
        ("solve hydrolek_7w --xyz 1 1 0 --group arm", "the robot has no SRDF with groups; name its file (--srdf)"),
        ("dh gone.toml", "cannot read the D-H table 'gone.toml': No such file or directory"),
    ],
)
def test_a_mistake_is_one_sentence_and_exit_code_two(refused, line, says):
    assert says in refused(*(DH if word == "DH" else word for word in line.split()))


@pytest.mark.parametrize(
    "line",
    [
        "solve hydrolek_7w --output o.csv --targets",
        "path hydrolek_7w --poses",
        "track hydrolek_7w --path",
        "place hydrolek_7w --poses",
        "calibrate hydrolek_7w --data",
        "view hydrolek_7w --html o.html --motion",
    ],
)
def test_a_file_of_another_encoding_is_named_as_such(refused, tmp_path, monkeypatch, line):
    """Spreadsheets save accented names as Latin-1."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "latin.csv").write_bytes("t,x,y,z,pièce\n0,1,0.1,0.2,1\n1,1,0.2,0.2,2\n".encode("latin-1"))
    assert "it is not UTF-8 text (byte 10); save it as UTF-8" in refused(*line.split(), "latin.csv")


def test_numbers_may_be_separated_by_commas_or_grouped(run):
    grouped = run("solve", "hydrolek_7w", "--xyz", "1.0,0.1,0.2", "--mask", "1,1,1", "0,0,0")
    apart = run("solve", "hydrolek_7w", "--xyz", "1.0,", "0.1,", "0.2", "--mask", *"111000")
    assert grouped[0] == apart[0] == 0 and grouped[1].partition("computed")[0] == apart[1].partition("computed")[0]


@pytest.mark.parametrize(
    ("error", "ends", "says"),
    [
        (errors.MissingExtra("meshcat", "view"), 3, "run: pip install meshcat pycollada trimesh yourdfpy"),
        (ZeroDivisionError("inner\ndetails"), 70, "unexpected ZeroDivisionError: inner ("),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_what_is_raised_is_an_exit_code_and_a_traceback_only_with_debug(run, monkeypatch, error, ends, says):
    def fail(name):
        raise error

    monkeypatch.setattr(registry, "find_row", fail)
    code, _, err = run("solvers", "lm")
    assert code == ends and says in err and "Traceback" not in err
    if ends == 70:
        with pytest.raises(ZeroDivisionError):
            run("solvers", "lm", "--debug")


def test_no_command_shows_the_help(run):
    code, out, _ = run()
    assert code == 0 and "Usage: ik" in out


@pytest.mark.parametrize(("line", "code"), [("robots", 0), ("solve planar_2r --xyz 3 0 0 --json", 1)])
def test_a_reader_that_leaves_early_changes_nothing(line, code):
    command = [sys.executable, "-m", "ik_toolkit", *line.split()]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout and process.stderr
    process.stdout.close()
    with process.stderr as stderr:
        said = stderr.read()
    assert process.wait() == code
    assert b"pipe" not in said.lower() and (b"ik: " in said or b"not solved" in said) == (code > 0)


def test_a_terminal_that_lacks_characters_shows_escapes(tmp_path):
    (tmp_path / "\u00e4rm.urdf").write_text(robots.urdf(dict(kind="revolute")), encoding="utf-8")
    command = [sys.executable, "-m", "ik_toolkit", "info", str(tmp_path / "\u00e4rm.urdf")]
    ascii_only = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, capture_output=True, env=ascii_only)
    assert done.returncode == 0 and rb"\xe4rm" in done.stdout


@pytest.fixture
def before_the_work(monkeypatch, tmp_path):
    """Run in an empty folder, and fail when a robot is loaded."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ik.Robot, "load", lambda *_, **__: pytest.fail("the work has started"))


@pytest.fixture
def without_packages(monkeypatch):
    """Let no package be found, neither as a module nor as a distribution."""

    def missing(package):
        raise importlib.metadata.PackageNotFoundError

    monkeypatch.setattr("importlib.metadata.distribution", missing)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)


@pytest.mark.parametrize(
    "words",
    [
        "bench planar_2r -o no/x.json",
        "bench planar_2r --plot no/x.png",
        "tune planar_3r pid -o no/x.toml",
        "tune planar_3r pid --plot no/x.png",
        "workspace planar_3r --csv no/x.csv",
        "workspace planar_3r --html no/x.html",
        "track planar_3r -o no/x.npz",
        "view planar_3r --html no/x.html",
        "track planar_3r --plot folder.png",
        "track planar_3r --plot x.gif",
    ],
)
def test_an_output_that_cannot_be_written_is_refused_before_the_work(refused, words, before_the_work, tmp_path):
    (tmp_path / "folder.png").mkdir()
    err = refused(*words.split())
    assert "there is no folder 'no'" in err or "is a folder" in err or "is written as" in err


@pytest.mark.parametrize(
    ("words", "package"),
    [
        ("solve planar_2r --xyz 1 1 0 --view", "trimesh"),
        ("track planar_2r --path line --view", "trimesh"),
        ("workspace planar_2r --html x.html", "trimesh"),
        ("reach planar_2r --html x.htm", "trimesh"),
        ("reach planar_2r --plot x.png", "matplotlib"),
        ("reproduce patko", "example-robot-data"),
        ("reproduce shanmugasundar", "scipy"),
    ],
)
def test_a_missing_package_is_said_before_the_work(run, words, package, before_the_work, without_packages, tmp_path):
    code, out, err = run(*words.split())
    assert code == 3 and not out and err.startswith(f"ik: {package} is not installed; run: pip install ")
    assert not [*tmp_path.iterdir()]


def test_the_page_of_a_calibration_needs_no_extra_and_is_refused_before_the_work(
    refused, before_the_work, without_packages
):
    assert "is written as .html or .htm" in refused("calibrate", "planar_2r", "--data", "x.csv", "--html", "x.txt")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("path hydrolek_7w --poses x.csv --rate 100", "--rate has no effect without --retime"),
        ("gains planar_2r --duration 3", "--duration has no effect without --path"),
        ("gains planar_2r --position-only", "--position-only has no effect without --path"),
        ("track planar_2r --on-limit leave --max-stretch 3", "--max-stretch has no effect without --on-limit slow"),
        ("track planar_2r --no-limits --on-limit leave", "--on-limit has no effect without --limits"),
        ("solve planar_2r --xyz 1 1 0 --refuse-q0", "--clamp-q0/--refuse-q0 has no effect without --q0 or --closest"),
        ("solve planar_2r --xyz 1 1 0 --frame tip", "--frame has no effect without --mask or --slack or --free-turn"),
        ("solve planar_2r --xyz 1 1 0 --euler zyx", "--euler has no effect without --targets"),
        ("reach planar_2r --length-unit mm", "--length-unit has no effect without --poses"),
        ("reproduce -o folder", "-o/--output has no effect without PAPER"),
        ("check planar_2r --seed 3", "--seed has no effect without --self-collision"),
        ("calibrate planar_2r --suggest 3 --noise 0.1", "--noise has no effect without --data"),
        ("calibrate planar_2r --data x.csv --seed 3", "--seed has no effect without --suggest"),
        ("calibrate planar_2r --data x.csv --suggest 3 --html x.html", "--suggest cannot be combined with --html"),
        ("view planar_2r -s lm", "-s/--solver has no effect without --xyz or --matrix or --target"),
        ("view planar_2r --html x.html --port 3", "--html cannot be combined with --port"),
        ("view planar_2r --page x.html --port 3", "--page cannot be combined with --port"),
        ("view planar_2r --page x.html --html a.html --q 0 0", "--page cannot be combined with --html or --q"),
        ("view planar_2r --page x.html --xyz 1 0 0", "--page cannot be combined with --xyz"),
        ("view planar_2r --page x.html --follow", "--follow cannot be combined with --page"),
        ("view planar_2r --follow --html x.html", "--follow cannot be combined with --html"),
        ("view planar_2r --follow --xyz 1 1 0", "--follow cannot be combined with --xyz"),
        ("view planar_2r --follow --q 0 0", "--follow cannot be combined with --q"),
        ("view planar_2r --follow --rail 0 1", "--follow cannot be combined with --rail"),
        ("view brokk_hydrolek --xyz 1 0 1 --target left_tip:1,0,1", "--target cannot be combined with --xyz"),
        ("view brokk_hydrolek --q 0 0 --target left_tip:1,0,1", "--q cannot be combined with --target"),
        ("view brokk_hydrolek --relative right_tip:left_tip", "--relative has no effect without --target"),
        ("view brokk_hydrolek --all", "--all has no effect without --xyz or --matrix or --target"),
        ("solve planar_2r --targets x.csv --html x.html", "--targets cannot be combined with --html"),
        ("solve planar_2r --xyz 1 1 0 --all --plot x.png", "--all cannot be combined with --plot"),
        ("info planar_2r --list-tips --tip tool", "--list-tips cannot be combined with --tip"),
        ("doctor --prepare --json", "--prepare cannot be combined with --json"),
    ],
)
def test_an_option_without_effect_is_refused_before_the_work(refused, words, says, before_the_work, tmp_path):
    assert refused(*words.split()) == f"ik: {says}\n" and not list(tmp_path.iterdir())


def test_what_an_option_needs_may_be_a_default(run, tmp_path):
    track = ("track", "planar_2r", "--json", "-o", tmp_path / "run.csv", "--max-stretch", 2, "--duration", 2)
    assert run(*track)[0] == 0
    assert run("check", "planar_2r", "--self-collision", "--samples", 20, "--seed", 3, "--json")[0] == 0


def test_several_targets_for_one_tip_are_refused_with_what_takes_them(refused):
    for words in ("--xyz 1 0.1 0.2 --xyz 1 0.2 0.2", "--target tool:1,.1,.2 --target tool:1,.2,.2"):
        err = refused("solve", "hydrolek_7w", *words.split())
        assert " twice; " in err and "--targets FILE" in err and "ik path" in err
    robot = ik.Robot.load("hydrolek_7w")
    for targets in ([(1, 0.1, 0.2), (1, 0.2, 0.2)], [robot.fk(robot.home), robot.fk(robot.lower)]):
        with pytest.raises(errors.InvalidTarget, match="solve_batch takes many targets"):
            ik.solve(robot, targets)


def test_a_termination_that_a_callback_loses_is_no_bug(monkeypatch, capsys):
    """While LLVM compiles, ctypes prints and drops the KeyboardInterrupt, and the compilation fails."""

    def lose_it():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5.0)
        except KeyboardInterrupt:
            raise RuntimeError("no compiled object yet") from None

    monkeypatch.setattr(cli, "_command", lose_it)
    assert cli.main(["robots"]) == 143
    assert capsys.readouterr().err.endswith("ik: terminated\n")
