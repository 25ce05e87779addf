"""Scenes in the cells of a notebook: outputs of three kinds, what cells share, live updates, dragged targets."""

import base64
import io
import json
import re

import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.errors import FrameNotFound, InvalidOption, InvalidTarget, UnknownSolver

pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")
pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra 'plots')")
import umsgpack
from hostile import Reader

from ik_toolkit.show import notebook
from ik_toolkit.show.body import DrawnShape, primitive
from ik_toolkit.show.meshcat_server import Window
from ik_toolkit.show.picture import _Camera, picture
from ik_toolkit.show.scene import Scene


@pytest.fixture(autouse=True)
def fresh_notebook():
    notebook._standing.clear()


def pixels(png):
    """Pixels (H, W, 3) of a PNG."""
    from matplotlib.image import imread

    return imread(io.BytesIO(png))[:, :, :3]


class Kernel:
    """What a notebook's kernel is to a scene: it says which cell runs."""

    kernel, cell = True, None

    def __init__(self):
        self.events = self
        self.callbacks = {"pre_run_cell": []}

    def register(self, event, call):
        self.callbacks[event].append(call)

    def get_parent(self):
        return {"metadata": {"cellId": self.cell}}

    def run(self, cell, shown):
        self.cell = self.cell_id = cell
        for call in self.callbacks["pre_run_cell"]:
            call(self)
        return shown._repr_mimebundle_()


class Connection:
    """A widget whose page is this test."""

    model_id = "none"

    def __init__(self):
        self.sent = []

    def on_msg(self, call):
        self.heard = lambda content: call(self, content, [])

    def send(self, content, buffers=()):
        self.sent.append((content, [umsgpack.unpackb(one) for one in buffers]))


@pytest.fixture
def kernel(monkeypatch):
    made = Kernel()
    made.connections = []
    monkeypatch.setattr(notebook, "_shell", lambda: made)
    monkeypatch.setattr(
        notebook, "connection", lambda scene: made.connections.append(Connection()) or made.connections[-1]
    )
    monkeypatch.setattr(notebook.Channel, "display", lambda channel: None)
    return made


def test_a_cell_gets_a_scene_a_picture_and_words():
    robot = ik.Robot.load("hydrolek_7w")
    made = ik.view(robot)._repr_mimebundle_()
    assert set(made) == {"text/html", "image/png", "text/plain"} and "hydrolek_7w" in made["text/plain"]
    seen = Reader(made["text/html"])
    assert seen.tags == ["div", "img", "script"] and seen.handlers == []  # without its script the picture is left
    assert f'src="data:image/png;base64,{made["image/png"]}"' in made["text/html"]
    drawn = pixels(base64.b64decode(made["image/png"]))
    assert drawn.shape == (460, 760, 3)
    assert (drawn[:, :, 0] > drawn[:, :, 2] + 0.25).mean() > 0.005  # the HydroLek is orange


def test_the_picture_shows_each_thing_where_it_is():
    """A sphere is a disc of the size and at the place that the viewer's camera gives it, and hides what is behind it."""
    window = Window()
    window.say(title="", camera=[[4.0, 0.0, 0.0], [0.0, 0.0, 0.0], 0.1, -9.0])
    vertices, faces = primitive("sphere", (0.5,))
    for name, y, x, color in (("near", 0.6, 0.0, (1, 0, 0)), ("far", 1.2, -4.0, (0, 0, 1))):
        T = np.eye(4)
        T[:2, 3] = x, y
        window.draw(f"{name}/0", DrawnShape(vertices, faces, color))
        window.place(name, T)
    wall = np.array([(-6, -40, -40), (-6, 40, -40), (-6, 40, 40), (-6, -40, 40)], dtype=np.float32)
    window.draw("wall/0", DrawnShape(wall, np.array([(0, 2, 3), (0, 1, 2)], dtype=np.uint32), (0, 1, 0)))
    window.place("wall", np.eye(4))
    drawn = pixels(picture(window))
    assert (drawn[:, :, 1] > 0.3).mean() > 0.8
    red = (drawn[:, :, 0] > 0.3) & (drawn[:, :, 1] < 0.2)
    scale = 230 / np.tan(np.radians(37.5))  # pixels of a metre at a distance of one metre
    rows, columns = np.nonzero(red)
    assert columns.mean() == pytest.approx(380 + scale * 0.6 / 4.0, abs=2.0)  # from +x, +y is to the right
    assert rows.mean() == pytest.approx(230, abs=1.0)
    assert red.sum() == pytest.approx(np.pi * (scale * 0.5 / 4.0) ** 2, rel=0.05)
    assert not ((drawn[:, :, 2] > 0.3) & (drawn[:, :, 0] < 0.2)).any()  # exactly behind, and half as large to the eye


def test_what_cells_share_stands_once():
    robot, other = ik.Robot.load("hydrolek_7w"), ik.Robot.load("planar_2r")
    first, again, new = (len(ik.view(one)._repr_mimebundle_()["text/html"]) for one in (robot, robot, other))
    assert first > 330_000 and again < 70_000 and new < 90_000
    page, twice = (len(ik.view(robot).page()._repr_mimebundle_()["text/html"]) for _ in range(2))
    assert page > 100_000 and twice < 60_000


def test_a_cell_that_runs_again_still_has_what_it_had(kernel):
    scene = ik.view(ik.Robot.load("planar_2r"))
    sizes = [len(kernel.run(cell, scene)["text/html"]) > 200_000 for cell in ("a", "b", "b", "a", "a", "b")]
    assert sizes == [True, False, False, True, True, False]
    assert kernel.callbacks["pre_run_cell"] == [notebook._forget]  # registered once


def test_animations_stay_true_to_a_millimetre():
    robot = ik.Robot.load("hydrolek_7w")
    target = robot.fk(robot.random_q(np.random.default_rng(3)))
    scene = ik.view(robot, ik.solve(robot, target, "dls", history=True), target=target)
    exact, short = (a["animation"]["data"] for a in (scene.window.about, notebook._short(scene.window.about)))
    assert 0.0 < np.abs(exact - short).max() < 2e-4


def told(connection, kind, timeout=5.0):
    """Wait for commands of a kind; the channel sends some thirty times a second."""
    import time

    end = time.monotonic() + timeout
    while time.monotonic() < end:
        found = [one for _, commands in [*connection.sent] for one in commands if one["type"] == kind]
        if found:
            return found
        time.sleep(0.01)
    raise AssertionError(f"no {kind} was sent")


def test_a_live_scene_tells_its_cells_what_moves(kernel):
    robot = ik.Robot.load("planar_2r")
    scene = ik.view(robot, live=True)
    kernel.run("a", scene)
    (connection,) = kernel.connections
    for q in np.linspace(robot.lower, robot.upper, 200):
        scene.update(q)
    sent = told(connection, "set_transform")
    assert {one["path"] for one in sent} >= {"/meshcat/tip"} and len(connection.sent) < 100  # not every pose one by one
    connection.sent.clear()
    connection.heard({"open": 1})  # a cell that is opened now gets what has changed since it was written
    (_, commands), *rest = connection.sent
    last = {one["path"]: one["matrix"] for one in commands if one["type"] == "set_transform"}
    assert np.allclose(np.reshape(last["/meshcat/tip"], (4, 4)).T, scene.drawn()["tip"])
    assert not rest and not any(one["type"] == "set_object" for one in commands)  # the meshes are there
    kernel.run("b", scene)
    connection.sent.clear()
    connection.heard({"open": 1})
    assert connection.sent == []


def test_a_dragged_target_calls_back(kernel):
    robot = ik.Robot.load("hydrolek_7w")
    target, there = (robot.fk(robot.random_q(np.random.default_rng(k))).homogeneous for k in (1, 2))
    scene = ik.view(robot, target=target, live=True)
    got = []
    scene.on_drag(got.append)
    kernel.run("a", scene)
    (connection,) = kernel.connections
    connection.heard({"drag": "target", "pose": there.T.ravel().tolist()})
    assert np.allclose(got.pop(), there) and connection.sent[-1][0] == {"done": 1}
    for bad in ({"drag": "robot", "pose": there.T.ravel().tolist()}, {"drag": "target", "pose": [float("nan")] * 16}):
        connection.heard(bad)
        assert got == [] and connection.sent[-1][0] == {"done": 1}

    def broken(target):
        raise ValueError("no idea")

    scene.on_drag(broken)
    connection.heard({"drag": "target", "pose": there.T.ravel().tolist()})
    assert scene.window.about["lines"] == ["ValueError: no idea"] and connection.sent[-1][0] == {"done": 1}
    with pytest.raises(InvalidOption, match="no target to drag"):
        ik.view(robot).on_drag(print)


@pytest.mark.parametrize("position", [True, False])
def test_interact_follows_with_every_solver(kernel, position):
    robot = ik.Robot.load("hydrolek_7w")
    poses = [robot.fk(robot.random_q(np.random.default_rng(k))).homogeneous for k in (1, 2)]
    start, there = (T[:3, 3] if position else T for T in poses)
    shown = ik.interact(robot, ["lm", "dls"], target=start)
    kernel.run("a", shown)
    connection = kernel.connections[-1]
    drag = np.eye(4)
    drag[:3, 3] = poses[1][:3, 3]
    connection.heard({"drag": "target", "pose": (drag if position else there).T.ravel().tolist()})
    assert list(shown.results) == ["lm", "dls"] and all(result.success for result in shown.results.values())
    for result in shown.results.values():
        reached = robot.fk(result.q)
        assert np.allclose(reached.translation if position else reached.homogeneous, there, atol=1e-5)
    assert np.allclose(shown.scene.drawn()["tip"][:3, 3], poses[1][:3, 3], atol=1e-5)
    curves = shown.scene.window.about["curves"]
    assert [name for name, *_ in curves] == ["lm", "dls"] and all(pairs[-1][1] < 1e-5 for _, _, pairs, _ in curves)
    assert curves[0][3].startswith(f"converged, {shown.results['lm'].iterations} iterations")
    json.dumps(curves)


@pytest.mark.parametrize("name", ["planar_2r", "hydrolek_7w"])
def test_a_ball_to_drag_is_in_the_picture_where_the_robot_has_reached_it(name):
    robot = ik.Robot.load(name)
    place = robot.fk(robot.home).translation
    window = ik.interact(robot, "lm", target=place).scene._aimed()
    drawn, beside = pixels(picture(window)), 0.3 * 760  # the chart is beside it
    camera = _Camera(window.about["camera"], 760 - beside, 460)
    x, y = np.round(camera.project(window.pose("target")[None, :3, 3])[0, :2]).astype(int)
    red, green, blue = drawn[y, x]
    assert red > 0.7 and max(green, blue) < 0.3


def test_interact_with_several_tips_and_bad_input():
    tree = ik.Tree.load("brokk_hydrolek", tips=["left_tip", "right_tip"])
    shown = ik.interact(tree, "lm", history=False)  # the curves need it, and have it all the same
    assert shown.results["lm"].success and shown.scene.window.about["curves"][0][2]
    assert [grip["name"] for grip in shown.scene.window.about["drag"]] == ["target", "target2"]
    T = shown.scene.window.transforms["target2"].copy()
    shown.scene._dragged("target2", T)
    assert shown.results["lm"].success
    robot = ik.Robot.load("planar_2r")
    with pytest.raises(UnknownSolver):
        ik.interact(robot, "lmm")
    with pytest.raises(InvalidOption, match="a list of up to"):
        ik.interact(robot, [])
    with pytest.raises(InvalidOption, match="a Robot or a Tree"):
        ik.interact("planar_2r")
    with pytest.raises(InvalidOption, match="a function"):
        ik.view(robot, target=[1, 1, 0]).on_drag(3)
    with pytest.raises(InvalidTarget):
        ik.interact(robot, target="there")
    with pytest.raises(FrameNotFound):
        ik.interact(tree, target={"middle": np.eye(4)})


def test_without_anywidget_the_scene_stays_still_and_says_so(kernel, monkeypatch):
    from ik_toolkit.errors import MissingExtra

    def missing(scene):
        raise MissingExtra("anywidget", "notebook")

    monkeypatch.setattr(notebook, "connection", missing)
    scene = ik.view(ik.Robot.load("planar_2r"), live=True)
    assert scene.channel is None and "not live: anywidget is not installed" in scene.window.about["lines"][-1]
    assert "image/png" in kernel.run("a", scene)


def test_labels_leave_the_grid_in_the_legend():
    robot = ik.Robot.load("planar_2r")
    scene = ik.view(robot)
    scene.trail(np.eye(3), label="my trail")
    words = [text for _, text in scene.window.about["legend"]]
    assert words[0] == "my trail" and re.fullmatch("grid .* m+", words[-1])


def test_pages_and_empty_scenes_aim_their_own_camera():
    robot = ik.Robot.load("planar_2r")
    assert "image/png" in Scene(robot)._repr_mimebundle_() and "image/png" in Scene(robot).page()._repr_mimebundle_()
