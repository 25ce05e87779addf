"""The committed notebooks: complete, small, executed in order, without scenes or errors (CI executes them separately)."""

import json
import re

import pytest
from folders import ROOT

FOLDER = ROOT / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
LARGEST = 200_000  # bytes


def test_numbered_without_a_gap():
    assert [path.name[:3] for path in NOTEBOOKS] == [f"{k:02}_" for k in range(len(NOTEBOOKS))]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_committed_small_and_executed(path):
    assert path.stat().st_size < LARGEST
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell["outputs"]]
    assert not [output for output in outputs if output["output_type"] == "error"]
    shown = [output["data"] for output in outputs if "data" in output]
    assert any("image/png" in data for data in shown), "no picture that survives on a code-hosting page"
    assert not [data for data in shown if "<script" in "".join(data.get("text/html", ""))]
    sources = ["".join(cell["source"]) for cell in code]
    scenes = [cell for cell, text in zip(code, sources, strict=True) if "ik.view(" in text or "ik.interact(" in text]
    assert scenes, "no 3-D scene"
    sliders = ("ik.view(robot, runs", "ik.view(robot, trajectory", "ik.view(robot, found")
    moved = ("ik.interact(", ".page()", "live=True", *sliders)
    assert any(word in text for text in sources for word in moved), "nothing to drag or slide"
    drawn = [cell for cell in scenes if any("image/png" in output.get("data", {}) for output in cell["outputs"])]
    assert len(drawn) == len(scenes), "a scene without a picture"
    texts = ["".join(data.get("text/plain", "")) for data in shown if not {"image/png", "text/html"} & data.keys()]
    leaked = re.compile(r"<[\w. ]+ (?:at 0x|object)|^\[<|^\[?(?:SE3|Solutions|Text)\(")
    assert not [text for text in texts if leaked.search(text)], "a leaked repr"
    prose = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"]
    titles = [line for text in prose for line in text.splitlines()]
    assert titles.count("## Exercise") == 1 and titles.count("## Answer") == 1


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_links_between_notebooks_lead_somewhere(path):
    for name in re.findall(r"\]\(([^)]+\.ipynb)\)", path.read_text(encoding="utf-8")):
        assert (FOLDER / name).is_file(), name
