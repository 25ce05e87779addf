"""Cells of a notebook in a real browser (Playwright driving Chromium). Skipped where either is missing."""

import base64

import numpy as np
import pytest
from chromium import fresh_page, until

import ik_toolkit as ik

pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")
pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra 'plots')")

from ik_toolkit.show import notebook

CELLS = 18  # more than the WebGL contexts of a page


@pytest.fixture(autouse=True)
def fresh_notebook():
    notebook._standing.clear()


def written(folder, bundles):
    """A page with the outputs of cells, a good way apart."""
    cells = "".join(f"<div style='margin-bottom:700px'>{one['text/html']}</div>" for one in bundles)
    file = folder / "notebook.html"
    file.write_text(f"<!DOCTYPE html><meta charset=utf-8><body>{cells}", encoding="utf-8")
    return file.as_uri()


def seen(page, k):
    """Scroll to a cell and wait until its scene is drawn; return its frame."""
    box = page.locator("[data-ik]").nth(k)
    box.scroll_into_view_if_needed()
    frame = box.locator("iframe")
    frame.wait_for(state="attached")
    page.wait_for_function(
        "(k) => document.querySelectorAll('[data-ik]')[k].querySelector('iframe')?.style.opacity == 1", arg=k
    )
    return frame.element_handle().content_frame()


def test_every_scene_is_there_when_it_is_scrolled_to(browser, tmp_path):
    planar, hydrolek = ik.Robot.load("planar_2r"), ik.Robot.load("hydrolek_7w")
    robots = [hydrolek, *[planar] * (CELLS - 1)]
    bundles = [ik.view(robot, robot.home + 0.01 * k)._repr_mimebundle_() for k, robot in enumerate(robots)]
    first = bundles.pop(0)
    warnings = []
    with fresh_page(browser) as page:
        page.on("console", lambda message: warnings.append(message.text))
        page.goto(written(tmp_path, [*bundles, first]))  # what all of them need stands in the last one
        frame = seen(page, 0)
        frame.evaluate("viewer.camera.position.set(1.5, 1, 0.5); viewer.set_dirty()")
        for k in range(1, CELLS):
            seen(page, k)
            assert 1 <= page.locator("iframe").count() <= 8
        page.wait_for_function("document.querySelectorAll('iframe').length < 4")
        sources = [one.get_attribute("src")[:15] for one in page.locator("[data-ik] img").all()]
        assert sources[0] == "data:image/jpeg"  # as it was left
        still = page.locator("[data-ik] img").first
        assert still.evaluate("(image) => image.decode().then(() => image.naturalWidth)") > 300
        frame = seen(page, 0)
        assert np.allclose(frame.evaluate("viewer.camera.position.toArray()"), (1.5, 1.0, 0.5))
        assert not [text for text in warnings if "Too many" in text], warnings
        assert page.errors == [] and page.outside == []


def test_a_notebook_whose_scripts_do_not_run_shows_pictures(browser, tmp_path):
    robot = ik.Robot.load("hydrolek_7w")
    bundles = [ik.view(robot)._repr_mimebundle_(), ik.view(robot).page()._repr_mimebundle_()]
    with fresh_page(browser, java_script_enabled=False) as page:
        page.goto(written(tmp_path, bundles))
        assert page.locator("iframe").count() == 0
        for image in page.locator("img").all():
            image.scroll_into_view_if_needed()
            from matplotlib.image import imread

            shot = tmp_path / "shot.png"
            image.screenshot(path=shot)
            drawn = imread(shot)[:, :, :3]
            assert (drawn[:, :, 0] > drawn[:, :, 2] + 0.25).mean() > 0.005  # the HydroLek is orange


def test_a_lost_viewer_is_said(browser, tmp_path):
    scene = ik.view(ik.Robot.load("planar_2r"))
    scene._repr_mimebundle_()  # in a cell that is deleted
    with fresh_page(browser) as page:
        page.goto(written(tmp_path, [scene._repr_mimebundle_()]))
        page.get_by_text("The viewer of this notebook was in a cell that is gone").wait_for()
        assert page.locator("iframe").count() == 0 and page.errors == []


class Wire:
    """Carries the messages of a channel between this process and a page, in place of a widget."""

    def __init__(self):
        self.out = []

    def on_msg(self, call):
        self.heard = call

    def send(self, content, buffers=()):
        self.out.append([content, [base64.b64encode(one).decode() for one in buffers]])

    def connect(self, page, scene):
        page.evaluate(
            """(scene) => { window.sent = []; window.ikCells.channel(scene, { send: (m) => sent.push(m),
            on: (_, take) => { window.deliver = ([m, b]) => take(m, b.map((text) =>
            new DataView(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer))); } }); }""",
            scene,
        )

    def pump(self, page):
        """Pass on what both sides have sent."""
        for content in page.evaluate("sent.splice(0)"):
            self.heard(None, content, [])
        page.wait_for_timeout(60)
        while self.out:
            page.evaluate("(message) => deliver(message)", self.out.pop(0))
        page.wait_for_timeout(60)


@pytest.fixture
def wire(monkeypatch):
    made = Wire()
    monkeypatch.setattr(notebook, "connection", lambda scene: made)
    monkeypatch.setattr(notebook, "_shell", lambda: None)
    monkeypatch.setattr(
        notebook.InCell,
        "connect",
        lambda scene: setattr(scene, "channel", notebook.Channel(scene.window, scene._dragged)),
    )
    monkeypatch.setattr(notebook.Channel, "display", lambda channel: None)
    return made


def test_a_target_is_dragged_and_solvers_follow(browser, tmp_path, wire):
    robot = ik.Robot.load("hydrolek_7w")
    shown = ik.interact(robot, ["lm", "dls"], target=robot.fk(robot.random_q(np.random.default_rng(2))))
    start = shown.scene.drawn()["target"]
    with fresh_page(browser) as page:
        page.goto(written(tmp_path, [shown._repr_mimebundle_()]))
        frame = seen(page, 0)
        wire.connect(page, shown.scene.channel.id)
        wire.pump(page)
        assert "lm: converged" in frame.locator("#chart").text_content()

        box = page.locator("iframe").bounding_box()

        def drag(point, by, *, shift=False):
            where = f"object('target').updateWorldMatrix(true, false), pixel(object('target').localToWorld(vector({point})))"
            x, y, _ = frame.evaluate(where)
            x, y = box["x"] + x, box["y"] + y
            if shift:
                page.keyboard.down("Shift")
            page.mouse.move(x, y)
            page.mouse.down()
            for step in range(1, 7):
                page.mouse.move(x + by[0] * step / 6, y + by[1] * step / 6)
                wire.pump(page)
            page.mouse.up()
            page.keyboard.up("Shift")
            for _ in range(4):
                wire.pump(page)
            return shown.scene.drawn()["target"]

        ball = drag("0, 0, 0", (-60, -30))
        assert np.linalg.norm(ball[:3, 3] - start[:3, 3]) > 0.05 and np.allclose(ball[:3, :3], start[:3, :3], atol=1e-9)
        assert all(result.success for result in shown.results.values())
        assert np.allclose(robot.fk(shown.results["dls"].q).homogeneous, ball, atol=1e-5)
        size = shown.scene.window.about["drag"][0]["size"]
        slid = drag(f"0, 0, {size}", (0, 40))
        moved = slid[:3, 3] - ball[:3, 3]
        assert np.linalg.norm(moved) > 0.005 and np.linalg.norm(np.cross(moved, ball[:3, 2])) < 1e-9
        turned = drag(f"{size}, 0, 0", (30, 30), shift=True)
        assert np.allclose(turned[:3, 3], slid[:3, 3], atol=1e-9) and np.allclose(turned[:3, 0], slid[:3, 0], atol=1e-9)
        assert np.arccos(np.clip(turned[:3, 1] @ slid[:3, 1], -1.0, 1.0)) > 0.05
        tip = frame.evaluate("[...object('tip').matrix.elements]")
        assert np.allclose(np.reshape(tip, (4, 4)).T, shown.scene.drawn()["tip"], atol=1e-6)
        assert page.errors == [] and page.outside == []


def test_a_page_in_a_cell_goes_on_where_it_was(browser, tmp_path):
    robot = ik.Robot.load("planar_2r")
    bundles = [ik.view(robot).page()._repr_mimebundle_() for _ in range(2)]
    with fresh_page(browser) as page:
        page.goto(written(tmp_path, bundles))
        frame = seen(page, 0)
        until(page, lambda: frame.evaluate("Boolean(window.arm)"))
        frame.locator("#random").click()
        until(page, lambda: frame.evaluate("document.body.dataset.still && window.arm.state().result?.good"))
        q = frame.evaluate("window.arm.state().q")
        seen(page, 1)
        page.wait_for_function("document.querySelectorAll('iframe').length === 1")
        frame = seen(page, 0)
        until(page, lambda: frame.evaluate("window.arm && document.body.dataset.still && window.arm.state().result"))
        assert np.allclose(frame.evaluate("window.arm.state().q"), q) and not np.allclose(q, robot.home)
        assert frame.evaluate("window.arm.state().result.good")
        assert page.errors == [] and page.outside == []
