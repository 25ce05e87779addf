"""The live page as a file: what is refused, and what its modules hold."""

import re

import pytest
from folders import ROOT
from robots import load

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption

MODULES = sorted((ROOT / "ik_toolkit" / "show" / "page").glob("*.js"))


def test_a_page_is_written_and_other_formats_are_refused(run, tmp_path):
    with pytest.raises(InvalidOption, match=r"a live page is written as \.html or \.htm, not 'page\.png'"):
        ik.view(load("planar_2r")).page(tmp_path / "page.png")
    code, _, err = run("view", "planar_2r", "--page", tmp_path / "page.html")
    assert code == 0 and "opens without a network" in err
    assert [file.name for file in tmp_path.iterdir()] == ["page.html"]


def test_modules_are_few_lines_that_stand_alone():
    assert [file.stem for file in MODULES] == ["draw", "hand", "main", "robot", "solve"]
    texts = [file.read_text() for file in MODULES]
    assert sum(len(text.splitlines()) for text in texts) < 640
    assert not re.search(r"</script|https?:|import\(|eval\(|innerHTML", "".join(texts))
