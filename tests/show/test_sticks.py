"""Stick figures and charts are of the solver's chain: all joints between base and tip, and the tip where fk(q) is."""

import contextlib
import json
import re

import numpy as np
import pinocchio as pin
import pytest
from random_trees import random_tree
from robots import MIMIC, SLIDES, load
from second_fk import random_case
from trees import mixed

import ik_toolkit as ik
from ik_toolkit.errors import ModelError

pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")

from ik_toolkit.show.body import skeleton
from ik_toolkit.show.scene import Scene

SEATS = """([data, Q]) => {
  const robot = new arm.robot.constructor(data);
  return Q.map((q) => {
    const now = robot.fk(q), world = (T) => arm.seat({ node: 0, T }, [now.base]), frames = now.frames.map(world);
    const bars = data.parts.filter((part) => part.end).map((part) => arm.seat(part, frames));
    return [[now.base, world(now.tips[0])], bars];
  });
}"""


def random_robots(count):
    """Random URDFs of one tip, with mimic joints, slides, locked joints, tools and sizes of 1e-6 to 1e6 m."""
    for seed in range(count):
        case = random_case(np.random.default_rng([43, seed]), most=9)
        robot = ik.Robot.load(case.text, base=case.base, tip=case.tip, locked=case.locked)
        yield seed, robot if case.tool is None else robot.with_tool(case.tool)


def ends(matrices):
    """Where bars begin and end (N, 3) [m]: the column z of their matrix is the way from one to the other."""
    M = np.array([T[:3] for T in matrices]).reshape(-1, 3, 4)
    return M[:, :, 3], M[:, :, 3] + M[:, :, 2]


def check_chain(matrices, base, tip, size):
    """Bars lead from the base to the tip without a gap."""
    starts, stops = ends(matrices)
    reached, left = [np.asarray(base)], [*range(len(starts))]
    while left:
        for k in left:
            a, b = (min(np.linalg.norm(x[k] - p) for p in reached) for x in (starts, stops))
            if min(a, b) <= 1e-9 * size:
                reached += [starts[k], stops[k]]
                left.remove(k)
                break
        else:
            raise AssertionError(f"{len(left)} of {len(starts)} bars hang in the air")
    assert min(np.linalg.norm(tip - p) for p in reached) <= 1e-9 * size


def bars_of(scene):
    """Matrices of the bars of a scene's robot."""
    drawn = scene.drawn()
    return [drawn[f"robot/{part.name}"] for part in scene.body.parts if part.end is not None]


def test_the_drawn_chain_of_random_robots_leads_from_the_base_to_the_tip():
    for seed, robot in random_robots(12):
        scene = Scene(robot)
        R, base = scene.body.T_world_base[:3, :3], scene.body.T_world_base[:3, 3]
        for q in robot.random_q(np.random.default_rng(seed), 2):
            scene.show(q)
            tip, points = robot.fk(q).translation, skeleton(robot, q)
            size = max(robot.reach, np.abs(points).max(), np.abs(base).max())
            assert np.abs(points[[0, -1]] - [np.zeros(3), tip]).max() <= 1e-9 * size
            check_chain(bars_of(scene), base, R @ tip + base, size)


def test_every_tip_of_a_random_tree_ends_a_chain():
    drawn = 0
    for seed in range(8):
        case = random_tree(np.random.default_rng([44, seed]))
        try:
            tree = ik.Tree.load(case.text, base=case.base, tips=case.tips)
        except ModelError:  # no joint moves one of the tips
            continue
        drawn += 1
        scene, q = Scene(tree), tree.random_q(np.random.default_rng(seed))
        scene.show(q)
        base = scene.body.T_world_base
        for tip in scene.body.tips(q)[:, :3, 3]:
            check_chain(bars_of(scene), base[:3, 3], tip, tree.reach + np.abs(tip).max())
    assert drawn > 5


@pytest.mark.parametrize("text", [MIMIC, SLIDES], ids=["mimic", "slides"])
def test_the_chain_is_drawn_through_every_joint(text):
    """Joints that mimic others have their ball, and a bar changes its length only along the stroke of a slide."""
    robot = ik.Robot.load(text)
    scene = ik.view(robot)
    names = {f"{name}_ball" for name in robot.model.names[1:]}
    assert names <= {part.name for part in scene.body.parts}
    Q = robot.random_q(np.random.default_rng(3), 5)
    lengths = []
    for q in Q:
        scene.show(q)
        lengths.append(np.linalg.norm(np.subtract(*ends(bars_of(scene))), axis=1))
    slides = [part.name.endswith("_stroke") for part in scene.body.parts if part.end is not None]
    changes = np.ptp(lengths, axis=0) > 1e-9
    assert changes.tolist() == slides and any(slides)


def test_a_ball_joint_is_drawn_through():
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPX(), pin.SE3(np.eye(3), np.array([0.0, 0.1, 0.2])), "slide")
    ball = model.addJoint(slide, pin.JointModelSpherical(), pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0])), "ball")
    place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.4]))
    model.addFrame(pin.Frame("tip", ball, 0, place, pin.FrameType.OP_FRAME))
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -1.0, 1.0
    robot = ik.Robot(model, tip="tip")
    scene = Scene(robot)
    assert "the Pinocchio model was given without visual_model=" in scene.body.notice
    for q in robot.random_q(np.random.default_rng(1), 5):
        scene.show(q)
        check_chain(bars_of(scene), np.zeros(3), robot.fk(q).translation, 1.0)


def test_a_base_that_moves_in_the_model_stays_where_targets_are():
    """A joint above the base that follows one below it: what is drawn in base axes keeps its place on the robot."""
    robot = ik.Robot.load(mixed(), tip="right_tip", base="left2_link")
    scene = ik.view(robot)
    for q in robot.random_q(np.random.default_rng(5), 3):
        scene.show(q)
        base = scene.body.T_world_base
        check_chain(bars_of(scene), base[:3, 3], (base @ robot.fk(q).homogeneous)[:3, 3], robot.reach)


def test_the_page_draws_the_same_chain(browser, tmp_path):
    from chromium import fresh_page

    robots = [load("mimic_mix"), load("slides_mix"), *(robot for _, robot in random_robots(20))]
    file = tmp_path / "page.html"
    with fresh_page(browser) as page:
        ik.view(robots[0]).page(file)
        page.goto(file.as_uri())
        page.wait_for_selector("body[data-still='1']")
        for robot in robots:
            text = ik.view(robot).page(file).read_text()
            data = json.loads(re.search(r'id="data">(.*?)</script>', text, re.S)[1])
            Q = robot.random_q(np.random.default_rng(9), 3)
            for q, found in zip(Q, page.evaluate(SEATS, [data, Q.tolist()]), strict=True):
                (base, tip), bars = (np.array(one).reshape(-1, 3, 4) for one in found)
                check_chain(bars, base[:, 3], tip[:, 3], robot.reach + np.abs(tip).max())
                away = base[:, :3].T @ (tip[:, 3] - base[:, 3]) - robot.fk(q).translation
                assert np.abs(away).max() <= 1e-9 * (robot.reach + np.abs(tip).max())
        assert page.errors == []


def test_links_without_shapes_are_sticks_and_the_shell_says_why(run, tmp_path):
    def clothed(text, link, shape):
        visual = f"<visual><geometry>{shape}</geometry></visual>"
        return text.replace(f'<link name="{link}"/>', f'<link name="{link}">{visual}</link>')

    text = clothed(SLIDES, "l2", '<box size=".2 .2 .1"/>')
    lost = clothed(text, "l5", '<mesh filename="lost.stl"/>')
    for description in (text, lost):
        robot = ik.Robot.load(description)
        scene = ik.view(robot)
        parts = {part.name for part in scene.body.parts}
        assert {"l2_0", "j0_ball", "j5_ball"} <= parts and "j1_ball" not in parts
        base = scene.body.T_world_base[:3, 3]
        check_chain(bars_of(scene), base, robot.fk(robot.home).translation + base, robot.reach)
    assert "mesh 'lost.stl' cannot be found" in scene.body.notice
    assert scene.body.notice.endswith("; links without shapes are drawn as sticks")
    file = tmp_path / "lost.urdf"
    file.write_text(lost)
    words = ["view"], ["solve", "--from-q", *["0.1"] * robot.n], ["workspace", "--targets", "100"]
    for name, *rest in words:
        code, _, err = run(name, file, *rest, "--html", tmp_path / "out.html")
        assert code == 0 and "mesh 'lost.stl' is not there" in err


def test_charts_end_where_fk_does():
    pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra 'plots')")
    for seed, robot in random_robots(20):
        q = robot.random_q(np.random.default_rng(seed))
        line, tip = ik.plot(q, robot).axes[0].lines[0], robot.fk(q).translation
        off = np.subtract([line.get_xdata()[-1], line.get_ydata()[-1]], tip[[0, 2]])
        assert np.abs(off).max() <= 1e-9 * max(robot.reach, np.abs(tip).max())


def test_the_panel_draws_the_same_chain(tmp_path):
    pytest.importorskip("viser", reason="viser is not installed (extra 'panel')")
    from ik_toolkit.show.panel.page import PanelPage
    from ik_toolkit.show.panel.panel import Panel

    file = tmp_path / "slides.urdf"
    file.write_text(SLIDES)
    with contextlib.closing(Panel(str(file))) as panel, contextlib.closing(PanelPage(panel.server, str(file))) as desk:
        assert desk.worker.idle()
        robot, stage = desk.session.robot, desk.stage
        assert len(stage.axes) == robot.model.njoints - 1
        for q in robot.random_q(np.random.default_rng(2), 3):
            stage.show(q)
            bars = []
            for part, handle in zip(stage.body.parts, stage.parts, strict=True):
                if part.end is not None:
                    w, x, y, z = handle.wxyz
                    R = pin.Quaternion(w, x, y, z).matrix()
                    bars.append(np.column_stack([R * np.array(handle.scale), handle.position]))
            check_chain(bars, stage.body.T_world_base[:3, 3], stage.body.tips(q)[0, :3, 3], robot.reach)
