"""The package as a whole: what an import loads, what the README promises, what the wheel contains."""

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from folders import ROOT

import ik_toolkit as ik
from ik_toolkit.cli import MODULES, main
from ik_toolkit.solvers.rows import ROWS

README = (ROOT / "README.md").read_text(encoding="utf-8")
# numba looks at scipy itself
HEAVY = set("matplotlib meshcat viser trimesh yourdfpy dask distributed cma sympy scipy.optimize".split())


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.MULTILINE | re.DOTALL)


def loaded_by(code, *arguments):
    """Names of the modules that a fresh interpreter has loaded after running `code`."""
    report = f"{code}\nimport sys; print(' '.join(sys.modules), file=sys.stderr)"
    run = subprocess.run(
        [sys.executable, "-c", report, *arguments], capture_output=True, text=True, check=True, cwd=ROOT
    )
    return set(run.stderr.splitlines()[-1].split())


def test_import_is_light():
    assert not loaded_by("import ik_toolkit") & (HEAVY | {"pinocchio", "numba", "numpy"})


def test_solving_loads_no_extra():
    code = "import ik_toolkit as ik\nrobot = ik.Robot.load('planar_2r')\nik.solve(robot, (1.0, 1.0, 0.0))"
    assert not loaded_by(code) & HEAVY


def test_what_needs_no_kinematics_loads_none():
    commands = ["--help"], ["solve", "--help"], ["--version"], ["robots"], ["solvers"]
    loaded = loaded_by(f"from ik_toolkit.cli import main\nfor words in {commands}:\n    main(words)")
    assert not loaded & (HEAVY | {"pinocchio", "numba"})


def test_public_names_exist_and_unknown_ones_do_not():
    for name in ik.__all__:
        assert getattr(ik, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'solv'"):
        ik.solv  # noqa: B018


@pytest.mark.parametrize("number", range(len(blocks("python"))))
def test_readme_python_runs(number, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(compile(blocks("python")[number], f"README.md, python block {number + 1}", "exec"), {"__name__": "readme"})


def readme_commands():
    return [line for block in blocks("sh") for line in block.splitlines() if line.startswith("ik ")]


@pytest.mark.parametrize("command", readme_commands())
def test_readme_commands_run(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split(command)[1:]) == 0
    assert capsys.readouterr().out.strip()


def test_readme_has_blocks_to_run():
    assert blocks("python") and len(readme_commands()) >= 5


def test_readme_states_the_two_commands():
    lines = [line for block in blocks("sh") for line in block.splitlines() if line.startswith("python3 -m venv")]
    assert len(lines) == 2
    assert "ik solve hydrolek_7w" in lines[0] and lines[1].endswith("-m pytest -n auto")
    assert main(shlex.split(lines[0].partition("/bin/ik ")[2])) == 0


def test_readme_solver_table_is_the_registry():
    # the docs have all rows, made from the registry
    table = [line for line in README.splitlines() if line.startswith("| `")]
    assert set(table) <= {f"| `{row.name}` | {row.summary} | {row.handles} | {row.citation} |" for row in ROWS}
    assert len(table) >= 8


def test_readme_names_the_extras_that_exist():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    text = README.partition("## Extras")[2].partition("## ")[0]
    named = set(re.findall(r"`([a-z]+)`", text))
    assert named == set(extras) - {"test", "lint", "docs", "peers"}


def test_every_command_module_is_listed():
    folder = ROOT / "ik_toolkit" / "cli"
    files = {path.stem for path in folder.glob("*.py") if "\n@command\n" in path.read_text(encoding="utf-8")}
    assert files == set(MODULES)


def test_module_runs_as_the_command():
    run = subprocess.run([sys.executable, "-m", "ik_toolkit", "--version"], capture_output=True, text=True, cwd=ROOT)
    assert run.returncode == 0 and run.stdout.strip() == f"ik_toolkit {ik.__version__}"


def test_nothing_names_a_private_path():
    tracked = subprocess.run(["git", "ls-files"], capture_output=True, text=True, cwd=ROOT)
    if tracked.returncode or not tracked.stdout:
        pytest.skip("not a git checkout")
    secret = re.compile(r"/(work|opt|home|root)/[a-z]")
    for name in tracked.stdout.splitlines():
        path = ROOT / name
        if path.suffix in {".py", ".md", ".toml", ".yaml"} and path.is_file() and path != Path(__file__):
            found = secret.search(path.read_text(encoding="utf-8"))
            assert not found, f"{name} names {found[0]}"


def test_type_checkers_see_the_names_that_load_lazily():
    stub = (ROOT / "ik_toolkit" / "__init__.pyi").read_text()
    lines = re.findall(r"^from \.([\w.]+) import (\w+) as \2$", stub, re.MULTILINE)
    assert {name: module for module, name in lines} == ik._NAMES
