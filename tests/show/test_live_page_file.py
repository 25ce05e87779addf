"""The live page as a file: what is refused, and what its modules hold."""

import re

import pytest
from folders import ROOT
from robots import load

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption

MODULES = sorted((ROOT / "ik_toolkit" / "show" / "page").glob("*.js"))


def test_what_is_refused(tmp_path, capsys):
    from ik_toolkit.cli import main

    scene = ik.view(load("planar_2r"))
    with pytest.raises(InvalidOption, match=r"a live page is written as \.html or \.htm, not 'page\.png'"):
        scene.page(tmp_path / "page.png")
    assert main(["view", "planar_2r", "--page", str(tmp_path / "page.html")]) == 0
    assert "opens without a network" in capsys.readouterr().err
    for words, said in (
        (["--q", "0", "0", "--html", str(tmp_path / "a.html")], "--page cannot be combined with --html or --q"),
        (["--xyz", "1", "0", "0"], "--page cannot be combined with --xyz"),
        (["--follow"], "--follow cannot be combined with --page"),
    ):
        assert main(["view", "planar_2r", "--page", str(tmp_path / "b.html"), *words]) == 2
        assert said in capsys.readouterr().err
    assert sorted(file.name for file in tmp_path.iterdir()) == ["page.html"]


def test_modules_are_few_lines_that_stand_alone():
    assert [file.stem for file in MODULES] == ["draw", "hand", "main", "robot", "solve"]
    texts = [file.read_text() for file in MODULES]
    assert sum(len(text.splitlines()) for text in texts) < 640
    assert not re.search(r"</script|https?:|import\(|eval\(|innerHTML", "".join(texts))
