"""A person's notebook in JupyterLab and a real browser: an arm of one's own, a target dragged, a file sent to somebody else."""

import contextlib
import io
import json
import os
import socket
import subprocess
import sys
import time
import urllib.request

import pytest
from chromium import NEEDED, PATIENCE, fresh_page, started

pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")
pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra 'plots')")
pytest.importorskip("anywidget", reason="anywidget is not installed (extra 'notebook')")
pytest.importorskip("jupyterlab", reason="JupyterLab is not installed (pip install jupyterlab)")
import nbformat
from PIL import Image

pytestmark = NEEDED

JOINT = '<parent link="{0}"/><child link="{1}"/><axis xyz="0 {2} {3}"/><limit lower="{4}" upper="1.5" effort="1" velocity="1"/>'
URDF = f"""<robot name="mine"><link name="a"/><link name="b"/><link name="c"/><link name="d"/><link name="e"/>
<joint name="turn" type="revolute">{JOINT.format("a", "b", 0, 1, -1.5)}</joint>
<joint name="lift" type="prismatic"><origin xyz="0 0 0.4"/>{JOINT.format("b", "c", 0, 1, 0)}</joint>
<joint name="elbow" type="revolute"><origin xyz="0.4 0 0"/>{JOINT.format("c", "d", 1, 0, -1.5)}</joint>
<joint name="wrist" type="revolute"><origin xyz="0.3 0 0"/><mimic joint="elbow" multiplier="0.5"/>
{JOINT.format("d", "e", 1, 0, -1.5)}</joint></robot>"""
CELLS = (
    f"import ik_toolkit as ik\nrobot = ik.Robot.load('''{URDF}''')\ntarget = robot.fk([0.4, 0.3, 0.6]).translation\nrobot",
    "ik.interact(robot, ['pid', 'lm'], target=target)",
    "ik.benchmark(robot, ['pid', 'lm'], targets=20)",
    "scene = ik.view(robot, live=True)\nscene",
    "for k in range(20):\n    scene.update(k / 20 * robot.upper)\nscene.say('moved from a later cell')",
)


@contextlib.contextmanager
def lab(folder, data):
    """JupyterLab on a folder; notebooks are trusted by what is in `data`."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "jupyterlab", "--no-browser", f"--port={port}", "--ServerApp.ip=127.0.0.1"]
    command += ["--IdentityProvider.token=", f"--ServerApp.root_dir={folder}", "--allow-root"]
    own = {f"JUPYTER_{name}_DIR": str(data / name) for name in ("CONFIG", "DATA", "RUNTIME")}
    server = subprocess.Popen(command, env={**os.environ, **own}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        end = time.monotonic() + PATIENCE / 1000
        while True:
            with contextlib.suppress(OSError):
                urllib.request.urlopen(f"http://127.0.0.1:{port}/lab", timeout=5)
                break
            assert time.monotonic() < end, "JupyterLab did not start"
            time.sleep(0.3)
        yield f"http://127.0.0.1:{port}/lab/tree/mine.ipynb"
    finally:
        server.kill()  # Asked to end, it waits for its kernels, which end by themselves when it is gone.
        server.wait()


@pytest.fixture(scope="module")
def browser():
    with started() as made:
        yield made


def within(page, seconds, condition):
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "what was asked for did not happen"
        page.wait_for_timeout(200)
    return found


def test_a_persons_notebook(browser, tmp_path):
    folder = tmp_path / "notebooks"
    folder.mkdir()
    file = folder / "mine.ipynb"
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    cells = [nbformat.v4.new_code_cell(text) for text in CELLS]
    nbformat.write(nbformat.v4.new_notebook(cells=cells, metadata=kernel), file)
    size = {"width": 1200, "height": 1600}
    with lab(folder, tmp_path / "mine") as url, fresh_page(browser, viewport=size) as page:
        page.goto(url)
        page.locator(".jp-Notebook .jp-Cell").first.wait_for()
        page.get_by_text("Python 3 | Idle").or_(page.get_by_text("Python 3 (ipykernel) | Idle")).first.wait_for()
        page.get_by_text("Run", exact=True).first.click()
        page.get_by_text("Run All Cells", exact=True).click()
        within(page, 180, lambda: "[5]:" in page.locator(".jp-InputPrompt").all_inner_texts())

        def frame_with(test):
            return next(
                (one for one in page.frames[1:] if one.evaluate(f"typeof grips !== 'undefined' && {test}")), None
            )

        frame = within(page, 60, lambda: frame_with("grips.length"))
        words = within(page, 30, lambda: frame.evaluate("$('chart')?.textContent"))
        box = frame.frame_element().bounding_box()
        x, y, _ = frame.evaluate(
            "(one => (one.updateWorldMatrix(true, false), pixel(one.localToWorld(vector(0, 0, 0)))))(object('target'))"
        )
        shot = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        red, green, blue = shot.getpixel((round(box["x"] + x), round(box["y"] + y)))
        assert red > 100 > 2 * max(green, blue)  # The ball is seen, although the arm's tip is there.
        page.mouse.move(box["x"] + x, box["y"] + y)
        page.mouse.down()
        for step in range(1, 9):
            page.mouse.move(box["x"] + x - 5 * step, box["y"] + y - 4 * step)
            page.wait_for_timeout(50)
        page.mouse.up()
        within(page, 30, lambda: frame.evaluate("$('chart').textContent") != words)
        moved = within(page, 60, lambda: frame_with("document.body.textContent.includes('moved from a later cell')"))
        assert moved is not frame
        page.screenshot(path=tmp_path / "lab.png")
        page.keyboard.press("Control+s")
        within(page, 30, lambda: "image/png" in file.read_text(encoding="utf-8"))
        assert page.errors == [] and page.outside == []
    saved = json.loads(file.read_text(encoding="utf-8"))
    kinds = [set(output.get("data", {})) for cell in saved["cells"] for output in cell["outputs"]]
    assert sum("image/png" in kind for kind in kinds) == 2
    assert not any("widget" in name for kind in kinds for name in kind)  # nothing that is missing without this kernel
    with lab(folder, tmp_path / "theirs") as url, fresh_page(browser, viewport=size) as page:
        page.goto(url)
        pictures = page.locator(".jp-OutputArea img")
        within(page, 60, lambda: pictures.count() == 2)
        assert page.locator("iframe").count() == 0  # it is not trusted
        assert all(one.evaluate("(image) => image.naturalWidth") > 700 for one in pictures.all())
        assert page.get_by_text("solved at once").count() == 1
