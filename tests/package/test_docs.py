"""The guide's examples run as printed, each page in one go; every page is reachable."""

import ast
import importlib.util
import inspect
import re
import shlex

import pytest
from folders import ROOT
from wire import Wire

import ik_toolkit as ik
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


WITH_CODE = [page for page in PAGES if blocks(page, "python") or commands(page)]


@pytest.mark.parametrize("page", WITH_CODE, ids=lambda page: page.stem)
def test_examples_run(page, tmp_path, monkeypatch, capsys):
    """As a reader runs them: the Python of a page, and then its commands, in one folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    if importlib.util.find_spec("meshcat"):
        # The only difference from what a reader gets: no server, which is a process of its own.
        monkeypatch.setattr("meshcat.visualizer.ViewerWindow", lambda **_: Wire())
    code = "\n".join(write_files(page, tmp_path))
    exec(compile(code, str(page), "exec"), {"__name__": "guide"})
    for command in commands(page):
        capsys.readouterr()
        command = re.sub(r"--seconds \d+", "--seconds 0.3", command)  # a search takes as long as it is given
        assert main(shlex.split(command)[1:]) == 0, command
        said = capsys.readouterr()
        assert (said.out + said.err).strip(), command


def test_embedded_pages_are_written():
    """What a page embeds or links as HTML is a page of the docs, or written beside them when they are built."""
    made = {f"scenes/{name}" for name in names_in(ROOT / "scripts" / "make_pictures.py", "SHIPPED")}
    made |= {f"live/{name}" for name in names_in(DOCS / "_generate.py", "LIVE")}
    made |= {str(page.relative_to(DOCS).with_suffix("")) for page in DOCS.rglob("*.md")}
    used = {
        word
        for page in DOCS.rglob("*.md")
        for word in re.findall(r'(?:src|href)="(?:\.\./)*([\w/]+)\.html', page.read_text(encoding="utf-8"))
    }
    assert {"live/hydrolek_7w", "scenes/solve"} <= used
    assert used <= made


def names_in(file, constant):
    """Value of a constant of a script that is not imported here."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    lines = [node for node in tree.body if isinstance(node, ast.Assign)]
    return next(ast.literal_eval(line.value) for line in lines if ast.unparse(line.targets[0]) == constant)


def test_every_attribute_is_explained():
    """The API pages say of each attribute of a public class what it is, and of none that it has not."""
    spec = importlib.util.spec_from_file_location("generate", DOCS / "_generate.py")
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    public = [getattr(ik, name) for name in ik._NAMES]
    rows = [len(generate.attributes_of(value)) for value in public if inspect.isclass(value)]
    assert sum(rows) > 100


def test_there_is_something_to_run():
    assert len(WITH_CODE) >= 8


def test_every_guide_page_is_listed():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    for page in (DOCS / "guide").glob("*.md"):
        assert f"guide/{page.stem}\n" in index, page.name


def test_contributing_names_what_is_there():
    """Every file that CONTRIBUTING names, and what is named after it (`a/b.py` `name`, or `name` of a class: `Name.name`)."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    known = [path for folder in ("ik_toolkit", "tests", "scripts") for path in (ROOT / folder).rglob("*.py")]
    named = re.findall(r"`(?:python )?([\w./]+\.py)[^`]*`(?:\s+\(?`([A-Za-z_][\w.]*)`)?", text)
    assert len(named) > 40 and sum(bool(name) for _, name in named) > 20
    for file, name in named:
        found = [path for path in known if path.as_posix().endswith(f"/{file.removeprefix('ik_toolkit/')}")]
        assert found, file
        for part in filter(None, name.split(".")):
            made = rf"^\s*(?:def {part}\b|class {part}\b|{part} = |{part}: )"
            assert any(re.search(made, path.read_text(encoding="utf-8"), re.MULTILINE) for path in found), (file, part)
