"""The panel and an exported scene in a real browser (Playwright driving Chromium). Skipped where either is missing."""

import contextlib
import time

import numpy as np
import pinocchio as pin
import pytest
from chromium import PATIENCE, api, fresh_page, plainly_lit, until

import ik_toolkit as ik

pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")

READY = 300.0  # s; the tracker may have to be compiled first


def picture(page):
    """Pixels (H, W, 3) of the canvas."""
    import io

    from matplotlib.image import imread

    return imread(io.BytesIO(page.locator("canvas").first.screenshot()))[:, :, :3]


def test_exported_scene_opens_with_the_network_off(browser, tmp_path):
    from ik_toolkit.show.scene import view

    robot = ik.Robot.load("hydrolek_7w")
    target = robot.fk(robot.random_q(np.random.default_rng(3)))
    file = view(robot, ik.solve(robot, target, "dls", history=True), target=target).save(tmp_path / "scene.html")
    with fresh_page(browser, offline=True) as page:
        page.goto(file.as_uri())
        page.wait_for_selector("body[data-ready]")
        page.wait_for_timeout(1000)
        assert page.outside == [] and page.errors == []
        end = picture(page)
        orange = (end[:, :, 0] > end[:, :, 2] + 0.25).mean()  # the robot's own colour
        assert orange > 0.005 and end.std() > 0.02
        page.evaluate("seek(0)")
        assert page.locator("#now").inner_text().startswith("iteration 0: ")
        page.wait_for_timeout(500)
        assert np.abs(picture(page) - end).mean() > 1e-3  # the slider moves the robot
        page.locator("#play").click()
        page.wait_for_function("Number(document.getElementById('time').value) > 3")


def test_live_scene_follows_the_program(browser):
    from ik_toolkit.show.scene import view

    robot = ik.Robot.load("hydrolek_7w")
    scene = view(robot)
    with fresh_page(browser) as page, contextlib.closing(scene):
        page.goto(scene.serve())
        page.wait_for_selector("body[data-ready]")
        page.wait_for_timeout(1000)
        before = picture(page)
        scene.show(robot.lower)
        scene.say("moved")
        page.wait_for_selector("text=moved")
        page.wait_for_timeout(500)
        assert np.abs(picture(page) - before).mean() > 1e-3
        assert page.outside == [] and page.errors == []
        scene.close()
        page.wait_for_selector("text=has ended")


class PanelPage:
    """The panel as a visitor handles it."""

    def __init__(self, page, url):
        self.page = page
        page.goto(url)
        self.wait_for("joints")

    def field(self, label):
        """Input beside a label (the number, where a slider has one)."""
        seen = "input[not(@type='hidden')]"
        return self.page.locator(f"xpath=//label[normalize-space(.)='{label}']/ancestor::div[.//{seen}][1]//{seen}")

    def status(self):
        return self.page.locator("[role=status]").inner_text()

    def wait_for(self, words):
        """Wait until the status line contains some words; return it."""
        end = time.monotonic() + PATIENCE / 1000
        while time.monotonic() < end:
            with contextlib.suppress(api.Error):
                if words in self.status():
                    return self.status()
            self.page.wait_for_timeout(100)
        raise AssertionError(f"the status line never said '{words}'; it says: {self.status()}")

    def settle(self, desk):
        """Wait until the controls are docked, the camera is aimed and the page has told where it is."""
        assert desk.worker.idle(READY)
        canvas = self.page.locator("canvas").first
        until(self.page, lambda: desk.client.camera.image_width == int(canvas.bounding_box()["width"]))
        assert desk.worker.idle(READY)
        self.page.wait_for_timeout(1500)

    def tab(self, name):
        self.page.get_by_role("tab", name=name).click()

    def press(self, name):
        self.page.get_by_role("button", name=name, exact=True).click()

    def type(self, label, text):
        self.field(label).fill(text)
        self.page.wait_for_timeout(300)  # the text is sent a moment after the last key

    def choose(self, label, option):
        self.field(label).click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def pose(self):
        """Matrix (4, 4) shown."""
        cells = self.page.locator("text=Pose of the tip").locator("xpath=following::table[1]//td").all_inner_texts()
        return np.array([float(x) for x in cells]).reshape(4, 4)

    def wait_for_pose(self, T):
        """Wait until a pose is shown."""
        until(self.page, lambda: np.allclose(self.pose(), T, atol=2e-5))


@pytest.fixture(scope="module")
def panel():
    with plainly_lit("hydrolek_7w") as made:
        yield made


def on_screen(desk, canvas, point):
    """Where a point (3,) [m] of the world is seen in the page."""
    camera = desk.client.camera
    w, x, y, z = camera.wxyz
    across, down, ahead = pin.Quaternion(w, x, y, z).matrix().T @ (point - camera.position)
    scale = 0.5 * canvas["height"] / np.tan(0.5 * camera.fov) / ahead
    return canvas["x"] + 0.5 * canvas["width"] + scale * across, canvas["y"] + 0.5 * canvas["height"] + scale * down


def inside(canvas, at):
    """Whether a place of the page is in the picture."""
    return 0 < at[0] - canvas["x"] < canvas["width"] and 0 < at[1] - canvas["y"] < canvas["height"]


def pull(page, at, to):
    """Press the mouse at a place of the page, and let go at another."""
    page.mouse.move(*at)
    for _ in range(3):  # until the arrow knows that it is pointed at, however long a picture takes
        page.wait_for_timeout(500)
        page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    page.mouse.down()
    for step in range(1, 11):
        page.mouse.move(*(np.array(at) + 0.1 * step * (np.array(to) - at)))
        page.wait_for_timeout(50)
    page.mouse.up()


def drag(page, desk, k, far, axis=1):
    """Drag the target of tip k along an arrow of its own (x points at the camera), this part of the arrow's length."""
    handle = desk.stage.handles[k]
    T = handle.target.copy()
    canvas = page.locator("canvas").first.bounding_box()
    arrow = 0.22 * desk.stage.size * (desk.stage.body.T_world_base @ T)[:3, axis]
    at, to = (on_screen(desk, canvas, handle.gizmo.position + f * arrow) for f in (0.8, 0.8 + far))
    pull(page, at, to)

    def arrived():
        """Whether the page, which may be slow, has sent all steps of the drag."""
        before = handle.target.copy()
        page.wait_for_timeout(300)
        return np.array_equal(handle.target, before) and not np.array_equal(before, T)

    until(page, arrived)
    assert desk.worker.idle()
    moved = handle.target[:3, 3] - T[:3, 3]
    assert moved @ T[:3, axis] > 0.02 and np.linalg.norm(np.cross(moved, T[:3, axis])) < 1e-6  # along the arrow


def test_edge_of_reach_undo_self_motion_and_boxes(browser, panel):
    """A target dragged out of reach, back by Undo, a self-motion at a free orientation, a box added and dragged."""
    with fresh_page(browser, viewport={"width": 1400, "height": 700}) as page:
        hand = PanelPage(page, panel.url)
        desk = list(panel.desks.values())[-1]
        session = desk.session
        hand.settle(desk)
        before = session.q.copy()
        drag(page, desk, 0, 4.0, axis=2)  # straight out, and out of the picture
        hand.wait_for("The closest pose is")
        assert desk.worker.idle() and "gap" in desk.stage.lines
        tip, target = session.poses()["tool"], desk.stage.handles[0].target
        hand.wait_for_pose(tip)
        canvas = page.locator("canvas").first.bounding_box()
        until(page, lambda: inside(canvas, on_screen(desk, canvas, desk.stage.handles[0].gizmo.position)))
        assert np.linalg.norm(tip[:3, 3] - target[:3, 3]) > 0.1  # the arm did not stand still before it
        towards = target[:3, 3] - desk.session.robot.fk(before).translation
        assert (tip[:3, 3] - desk.session.robot.fk(before).translation) @ towards > 0.1 * np.linalg.norm(towards)
        while not np.array_equal(session.q, before):
            hand.press("Undo")
            hand.wait_for("undone")
            assert desk.worker.idle()
        hand.wait_for_pose(session.robot.fk(before).homogeneous)

        hand.tab("Solve")
        hand.choose("Orientation", "free")
        hand.tab("Joints")
        number = hand.field("Self-motion")
        number.fill("0.5")
        number.press("Enter")
        until(page, lambda: np.abs(session.q - before).max() > 0.02)
        assert desk.worker.idle()
        assert np.linalg.norm(session.robot.fk(session.q).translation - session.robot.fk(before).translation) < 1e-5

        hand.tab("Scene")
        hand.press("Add a box")
        until(page, lambda: "box 1" in desk.around.handles)
        assert desk.worker.idle() and list(session.boxes) == ["box 1"]
        gizmo = desk.around.handles["box 1"]
        place = gizmo.position.copy()
        canvas = page.locator("canvas").first.bounding_box()
        up = gizmo.scale * np.array([0.0, 0.0, 1.0])
        pull(page, *(on_screen(desk, canvas, place + f * up) for f in (0.8, 1.5)))
        until(page, lambda: session.boxes["box 1"][1][2, 3] > place[2] + 0.02)
        assert desk.worker.idle()
        assert np.allclose(gizmo.position[:2], place[:2], atol=1e-6)  # along its arrow
        hand.press("Remove the boxes")
        until(page, lambda: not session.boxes and page.errors == [] and page.outside == [])


def test_each_of_two_targets_can_be_dragged(browser):
    wide = {"width": 1200, "height": 700}  # two pairs of arrows beside each other
    with plainly_lit("brokk_hydrolek") as panel, fresh_page(browser, viewport=wide) as page:
        hand = PanelPage(page, panel.url)
        (desk,) = panel.desks.values()
        hand.settle(desk)
        for k, other, axis in ((1, 0, 1), (0, 1, 2)):  # arrows that cross nothing of the other target
            still = desk.session.poses()[desk.session.robot.tips[other]]
            drag(page, desk, k, 0.2, axis)
            hand.wait_for("Converged")
            assert desk.worker.idle()
            poses = list(desk.session.poses().values())
            assert np.allclose(poses[k], desk.stage.handles[k].target, atol=1e-5)
            assert np.allclose(poses[other], still, atol=1e-5)
        hand.tab("Solve")
        page.locator("td", has_text="right_tip").first.wait_for()
        hand.choose("Tip 2", "none")
        hand.wait_for("to left_tip, 7 joints")
        assert page.outside == [] and page.errors == []


def test_the_panel_by_hand(browser, panel):
    robot = ik.Robot.load("hydrolek_7w")
    with fresh_page(browser) as page:
        hand = PanelPage(page, panel.url)
        q = robot.home.copy()
        hand.wait_for_pose(robot.fk(q).homogeneous)

        number = hand.field("shoulder_pitch [deg]")  # the number beside the slider
        number.fill("12.5")
        number.press("Enter")
        q[1] = np.radians(12.5)
        hand.wait_for_pose(robot.fk(q).homogeneous)

        goal = robot.fk(np.clip(q + 0.1, robot.lower, robot.upper))
        session = next(iter(panel.desks.values())).session
        xyz, rotation = session.words(goal.homogeneous, "roll pitch yaw")
        hand.tab("Solve")
        hand.type("x y z [m]", xyz)
        hand.type("r p y [deg]", rotation)
        hand.press("Solve")
        hand.wait_for("Converged in")
        hand.tab("Joints")
        hand.wait_for_pose(goal.homogeneous)

        hand.tab("Solve")
        hand.type("x y z [m]", "9 0 0")
        hand.press("Solve")
        assert "The closest pose is" in hand.wait_for("beyond reach")
        hand.tab("Joints")
        closest = robot.fk(session.q).homogeneous
        assert np.linalg.norm(closest[:3, 3] - (9.0, 0.0, 0.0)) < np.linalg.norm(goal.translation - (9.0, 0.0, 0.0))
        hand.wait_for_pose(closest)
        desk = next(iter(panel.desks.values()))
        far, canvas = desk.stage.handles[0], page.locator("canvas").first.bounding_box()
        until(page, lambda: inside(canvas, on_screen(desk, canvas, far.gizmo.position)))  # the camera has moved away
        hand.tab("Solve")
        hand.type("x y z [m]", xyz)
        hand.choose("Orientation", "free")
        hand.press("All solutions")
        hand.wait_for("Infinitely many solutions")
        until(page, lambda: np.linalg.norm(desk.client.camera.position) < 5.0)  # and has come back
        column = page.locator("table[onmouseover] tr:last-child td").nth(2)
        column.hover()  # its ghost
        page.wait_for_timeout(500)
        assert desk.worker.idle() and desk.found.chosen == 1 and any(part.visible for part in desk.stage.shade)
        column.click()
        hand.wait_for("solution 2 of")
        hand.tab("Joints")
        hand.wait_for_pose(robot.fk(session.solutions[1]).homogeneous)
        hand.tab("Solve")
        closest = robot.fk(session.q).homogeneous
        hand.type("x y z [m]", "9 0 up")
        hand.press("Solve")
        hand.wait_for("takes 3 numbers, not '9 0 up'")
        hand.tab("Joints")
        hand.wait_for_pose(closest)

        hand.press("Copy as JSON")
        page.wait_for_selector("#ik-json")
        assert '"hydrolek_7w"' in page.locator("#ik-json").input_value()
        hand.press("Close")

        hand.choose("Robot", "planar_3r")
        hand.wait_for("planar_3r: ")
        planar = ik.Robot.load("planar_3r")
        hand.wait_for_pose(planar.fk(planar.home).homogeneous)
        assert picture(page).std() > 0.02
        assert page.outside == [] and page.errors == []


def test_names_of_a_robot_do_nothing_in_a_page(browser, tmp_path):
    pytest.importorskip("viser", reason="viser is not installed (extra 'panel')")
    from hostile import EVIL, arm

    from ik_toolkit.show.panel.panel import Panel

    file = tmp_path / "robot.urdf"
    file.write_text(arm())
    robot = ik.Robot.load(str(file))
    scene = ik.view(robot)
    with contextlib.closing(scene), contextlib.closing(Panel(str(file))) as panel, fresh_page(browser) as page:
        for url in (scene.save(tmp_path / "scene.html").as_uri(), scene.serve()):
            page.goto(url)
            page.wait_for_selector("body[data-ready]")
            assert page.title() == robot.name
        hand = PanelPage(page, panel.url)
        hand.tab("Robot")
        page.get_by_text(EVIL[0]).first.wait_for()
        hand.tab("Solve")
        hand.type("x y z [m]", EVIL[0])
        hand.press("Solve")
        hand.wait_for(EVIL[0])
        assert page.locator("img[src=x]").count() == 0 and page.errors == []
        assert page.outside == []


def test_learning_by_hand(browser, panel):
    """Forward and back, the paper's sample, its branches and lifts, and both elbows of a planar arm; formulas as MathML."""
    with fresh_page(browser) as page:
        hand = PanelPage(page, panel.url)
        hand.choose("Robot", "inspection_7dof")
        hand.wait_for("inspection_7dof: ")
        hand.tab("Learn")
        (desk,) = panel.desks.values()
        hand.press("Load the paper's sample")
        hand.press("Joint values")
        hand.wait_for("projected to the nearest rotation")
        roots = page.locator("[data-step=theta_1] math")
        roots.first.wait_for()
        drawn = roots.first.bounding_box()
        assert drawn["width"] > 20 and drawn["height"] > 8  # set as formulas, by the browser alone
        page.get_by_role("button", name="2: shoulder").click()
        hand.wait_for("shoulder -")
        hand.choose("Robot", "planar_2r")
        hand.wait_for("planar_2r: ")
        hand.tab("Learn")
        number = hand.field("joint_1 [deg]").last
        number.fill("20")
        number.press("Enter")
        hand.press("Use FK output")
        hand.press("Joint values")
        page.get_by_text("Iterations of newton").wait_for()
        page.get_by_role("button", name="elbow left").click()
        hand.wait_for("elbow left")
        assert desk.worker.idle() and page.outside == [] and page.errors == []
