"""Third-party solvers: marked classes, rows registered by other packages, classes in files."""

import logging
import subprocess
import sys
import textwrap
from collections import namedtuple

import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.cli import main
from ik_toolkit.errors import InvalidOption, UnknownSolver
from ik_toolkit.solvers.registry import find_row, list_rows, registered, solver_from_file
from ik_toolkit.solvers.rows import ROWS, Length

RULE = '''
from typing import NamedTuple

import ik_toolkit as ik


@ik.rule
class HalfStep(NamedTuple):
    """Half of the step down the gradient."""

    gain: float = 0.5

    def step(self, p, e):
        for i in range(p.desk.dq.shape[0]):
            p.desk.dq[i] = self.gain * p.slope(e, i)
        return 0
'''
ROW = """
from ik_toolkit.solvers.rows import Length, Row

HALF = Row("half-step", "{module}.half:HalfStep", "Half of the gradient", "any robot", "nobody", search=Length(500))
"""


def install(folder, package, points, **files):
    """Put a package with entry points (name -> value) of the group into a folder, as pip would."""
    module = package.replace("-", "_")
    (folder / module).mkdir(parents=True)
    (folder / module / "__init__.py").touch()
    for name, text in files.items():
        (folder / module / f"{name}.py").write_text(text.replace("{module}", module))
    info = folder / f"{module}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    listed = "".join(f"{name} = {module}.{value}\n" for name, value in points.items())
    (info / "entry_points.txt").write_text(f"[ik_toolkit.solvers]\n{listed}")


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Folder on the path in which packages can be installed; what is registered is read anew in every test."""
    monkeypatch.syspath_prepend(tmp_path)
    registered.cache_clear()
    known = set(sys.modules)
    yield tmp_path
    registered.cache_clear()
    for name in set(sys.modules) - known:
        if name.split(".")[0].startswith(("first", "second")):
            del sys.modules[name]


def test_a_package_registers_a_solver(installed):
    install(installed, "first-pack", {"half-step": "rows:HALF"}, rows=ROW, half=RULE)
    assert [row.name for row in list_rows()] == [*(row.name for row in ROWS), "half-step"]
    assert "first_pack.half" not in sys.modules  # listed, not imported
    robot = robots.load("planar_2r")
    target = robot.fk(robot.home + 0.1).translation
    result = ik.solve(robot, target, "half-step", gain=0.4, tolerance=1e-4)
    assert result.success and result.solver == "half-step"
    row = find_row("half-step")
    assert row.package == "first-pack" and row.length() == Length(500)
    assert find_row(row.load()).name == find_row(row.load()(gain=0.3)).name == "half-step"
    assert result.q.tobytes() == ik.solve(robot, target, row.load()(gain=0.4), tolerance=1e-4).q.tobytes()


def test_listing_in_a_new_process_imports_nothing_heavy(tmp_path):
    install(tmp_path, "first-pack", {"half-step": "rows:HALF"}, rows=ROW, half=RULE)
    code = (
        "import sys; from ik_toolkit.solvers.registry import list_rows; print([row.name for row in list_rows()][-1]);"
        "print(*sorted({'numba', 'numpy', 'pinocchio', 'first_pack.half'} & set(sys.modules)))"
    )
    where = ":".join([str(tmp_path), *filter(None, sys.path)])
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={"PYTHONPATH": where}, check=True
    )
    assert run.stdout.split() == ["half-step"]


@pytest.mark.parametrize(
    ("points", "rows", "says"),
    [
        ({"half-step": "rows:HALF"}, "import nothing_like_it", "nothing_like_it"),
        ({"half-step": "rows:HALF"}, "1 / 0", "division by zero"),
        ({"half-step": "rows:NONE"}, ROW, "NONE"),
        ({"half-step": "rows:HALF"}, "HALF = 'half'", "is a str, not a Row"),
        ({"half": "rows:HALF"}, ROW, "its row has the name 'half-step'"),
        ({"half,step": "rows:HALF"}, ROW.replace("half-step", "half,step"), "lowercase letters"),
        ({"auto": "rows:HALF"}, ROW.replace("half-step", "auto"), "not be 'auto'"),
        ({"lm": "rows:HALF"}, ROW.replace("half-step", "lm"), "has a solver of that name"),
        ({"half-step": "rows:HALF"}, ROW.replace(":HalfStep", ".HalfStep"), "not MODULE:CLASS"),
    ],
)
def test_a_broken_package_is_named_and_left_out(points, rows, says, installed, caplog):
    install(installed, "first-pack", points, rows=rows, half=RULE)
    with caplog.at_level(logging.WARNING, "ik_toolkit"):
        assert list_rows() == ROWS
        list_rows()
    (message,) = caplog.messages  # once, not at every call
    assert "package first-pack" in message and says in message
    assert find_row("lm") is ROWS[0]


def test_two_packages_cannot_share_a_name(installed, caplog):
    install(installed, "first-pack", {"half-step": "rows:HALF"}, rows=ROW, half=RULE)
    install(installed, "second-pack", {"half-step": "rows:HALF"}, rows=ROW, half=RULE)
    with caplog.at_level(logging.WARNING, "ik_toolkit"):
        assert list_rows() == ROWS
    assert "first-pack and second-pack both register a solver 'half-step'" in caplog.text
    with pytest.raises(UnknownSolver, match="no solver 'half-step'"):
        find_row("half-step")


@pytest.mark.parametrize(
    ("half", "says"),
    [
        ("raise RuntimeError('too early')", "package first-pack cannot be loaded: RuntimeError: too early"),
        ("x = 1", "package first-pack cannot be loaded: AttributeError"),
        ("class HalfStep: pass", "is not a solver; put @ik_toolkit.rule above the class"),
    ],
)
def test_a_registered_class_that_fails_is_said_when_it_is_asked_for(half, says, installed, capsys):
    install(installed, "first-pack", {"half-step": "rows:HALF"}, rows=ROW, half=half)
    robot = robots.load("planar_2r")
    with pytest.raises(UnknownSolver, match=says):
        ik.Solver(robot, "half-step")
    assert main(["bench", "planar_2r", "-n", "2", "--solver", "half-step"]) == 2
    assert says in " ".join(capsys.readouterr().err.split())


def test_auto_stays_with_our_own_solvers(installed):
    form = ROW.replace("search=Length(500)", "closed=True, joints=(2,)")
    install(installed, "first-pack", {"half-step": "rows:HALF"}, rows=form, half=RULE)
    robot = ik.Robot.load("planar_2r")
    assert find_row("half-step").joints == ()
    assert ik.solve(robot, robot.fk(robot.home).translation).solver == "planar-2r"


# ------------------------------------------------------------------------------------------------------ marked classes
def made(marker, fields="gain", **methods):
    """A class of these fields and methods, marked as a rule or a closed form."""
    return marker(type("Odd", (namedtuple("Odd", fields, defaults=[1.0] * len(fields.split())),), methods))


def step(self, p, e):
    return 0


@pytest.mark.parametrize(
    ("marker", "fields", "methods", "says"),
    [
        (ik.rule, "gain", {}, r"NamedTuple class with a method step"),
        (ik.rule, "", {"step": step}, "at least one parameter"),
        (ik.rule, "gain", {"step": step, "pack": lambda self, robot: self}, r"Odd: pack takes \(self, robot, asked\)"),
        (ik.rule, "frame", {"step": step}, "Odd: 'frame' is an option of every solver"),
        (ik.closed_form, "", {}, "`recognise` and `every`"),
    ],
)
def test_what_cannot_be_a_solver_is_refused_where_it_is_written(marker, fields, methods, says):
    with pytest.raises(TypeError, match=says):
        made(marker, fields, **methods)
    assert made(ik.rule, step=step, pack=lambda self, robot, asked: self)().gain == 1.0


def test_a_class_that_is_not_marked_is_told_how():
    unmarked = made(lambda cls: cls, step=step)
    with pytest.raises(UnknownSolver, match=r"Odd is not marked as a rule: put @ik_toolkit\.rule above the class"):
        ik.Solver(robots.load("planar_2r"), unmarked)


# ----------------------------------------------------------------------------------------------------- a class in a file
def test_a_file_of_ones_own_imports_what_is_beside_it(tmp_path, monkeypatch, capsys):
    """That it runs is shown by the page `own_solver` of the guide."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("from beside import GAIN\n" + RULE.replace("0.5", "GAIN"))
    (tmp_path / "beside.py").write_text("GAIN = 0.4\n")
    assert main(["solvers", "mine.py:HalfStep"]) == 0
    said = capsys.readouterr().out
    assert "0.4" in said and "Half of the step down the gradient." in said
    assert str(tmp_path) not in sys.path
    del sys.modules["beside"]


def test_two_files_of_one_name_are_two(tmp_path):
    for folder, gain in (("a", "0.1"), ("b", "0.2")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "numpy.py").write_text(RULE.replace("0.5", gain))
    first, second = (solver_from_file(f"{tmp_path}/{folder}/numpy.py:HalfStep") for folder in "ab")
    assert (first().gain, second().gain) == (0.1, 0.2)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ("main.py:HalfStep", r"there is no file 'main.py'\. Did you mean 'mine.py'"),
        ("mine.py:Halfstep", r"has no class 'Halfstep'\. Did you mean 'HalfStep'"),
        ("mine.py", r"name the class: mine.py:CLASS\. .*Available: HalfStep"),
        ("mine.py:", "name the class"),
        ("mine.py:Other", "the class Other is not a solver; a solver is marked by @ik_toolkit.rule"),
        ("empty.py:X", "'X'. It defines no solver"),
        ("broken.py:X", r"broken.py, line 2: ZeroDivisionError: division by zero"),
        ("wrong.py:X", r"wrong.py, line 3: SyntaxError"),
        ("ends.py:X", r"ends.py, line 1: SystemExit: 3"),
        ("folder.py:X", r"there is no file 'folder.py'\.(?! Did you mean 'folder.py')"),
    ],
)
def test_mistakes_with_files_are_named(asked, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(RULE + "\n\nclass Other:\n    pass\n")
    (tmp_path / "empty.py").touch()
    (tmp_path / "broken.py").write_text("import math\n1 / 0\n")
    (tmp_path / "wrong.py").write_text("import math\n\nx = (:\n")
    (tmp_path / "ends.py").write_text("raise SystemExit(3)\n")
    (tmp_path / "folder.py").mkdir()
    with pytest.raises(InvalidOption, match=says):
        solver_from_file(asked)
    assert main(["bench", "planar_2r", "-n", "2", "--solver", asked]) == 2
    assert not capsys.readouterr().out


def test_the_docstring_of_a_class_is_its_summary(tmp_path):
    (tmp_path / "mine.py").write_text(textwrap.dedent(RULE))
    row = find_row(solver_from_file(f"{tmp_path}/mine.py:HalfStep"))
    assert (row.name, row.summary, row.length()) == ("HalfStep", "Half of the step down the gradient.", Length())


@pytest.mark.parametrize("carried", [{"tolerance": 1e-2}, {"position_tolerance": 1e-2}])
@pytest.mark.parametrize("solver", ["pid", ik.PID])
def test_options_that_come_with_parameters_hold_until_others_are_given(solver, carried):
    robot = robots.load("planar_2r")
    for options in (ik.Solver(robot, solver, tuned=carried).options, ik.Solver(robot, ik.PID(tuned=carried)).options):
        assert options.position_tolerance == 1e-2
    assert ik.Solver(robot, solver, tuned=carried, tolerance=1e-4).options.position_tolerance == 1e-4
    assert ik.Solver(robot, ik.PID(tuned=carried), tolerance=1e-4).options.position_tolerance == 1e-4
