"""The guide's examples run as printed, each page in one go; every page is reachable."""

import re
import shlex

import pytest
from folders import ROOT

from ik_toolkit.cli import main

DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if path.parent.name in ("docs", "guide"))


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def commands(page):
    lines = "\n".join(blocks(page, "sh")).replace("\\\n", " ").splitlines()
    return [line for line in lines if line.startswith("ik ")]


def write_files(page, folder):
    """Write the blocks that are files (their first line is `# NAME.py`) to a folder; return the other Python blocks."""
    rest = []
    for block in blocks(page, "python"):
        if name := re.match(r"# ([\w/]+\.py)\n", block):
            (folder / name[1]).parent.mkdir(exist_ok=True)
            (folder / name[1]).write_text(block)
        else:
            rest.append(block)
    return rest


WITH_PYTHON = [page for page in PAGES if blocks(page, "python")]


@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda page: page.stem)
def test_examples_run(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    code = "\n".join(write_files(page, tmp_path))
    exec(compile(code, str(page), "exec"), {"__name__": "guide"})


@pytest.mark.parametrize(("page", "command"), [(page, line) for page in PAGES for line in commands(page)])
def test_commands_run(page, command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_files(page, tmp_path)
    assert main(shlex.split(command)[1:]) == 0
    said = capsys.readouterr()
    assert (said.out + said.err).strip()


def test_there_is_something_to_run():
    assert len(WITH_PYTHON) >= 8


def test_every_guide_page_is_listed():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    for page in (DOCS / "guide").glob("*.md"):
        assert f"guide/{page.stem}\n" in index, page.name
