"""Scenes: everything is drawn where Pinocchio puts it, and pages are self-contained."""

import re
from importlib.util import find_spec

import numpy as np
import pinocchio as pin
import pytest
from robots import MADE, SLIDES, have_data, load, urdf

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption, ModelError
from ik_toolkit.text import length

pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")

from ik_toolkit.show.body import Body, DrawnShape, tube
from ik_toolkit.show.scene import Scene, view

DATA = pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed (extra 'robots')")
DRAWN = ["hydrolek_7w", pytest.param("panda", marks=DATA)]


def visual(robot):
    """Pinocchio's own reading of the visual shapes."""
    folders = [str(folder) for folder in robot.package_dirs]
    return pin.buildGeomFromUrdfString(robot.model, robot.urdf, pin.VISUAL, package_dirs=folders)


@pytest.mark.parametrize("name", DRAWN)
def test_drawn_transforms_are_pinocchios(name):
    robot = load(name)
    scene = Scene(robot)
    geometry = visual(robot)
    data, placed = robot.model.createData(), geometry.createData()
    assert len(geometry.geometryObjects) > 3
    for q in (robot.home, robot.random_q(np.random.default_rng(4))):
        scene.show(q)
        pin.updateGeometryPlacements(robot.model, data, geometry, placed, robot.to_pinocchio(q))
        drawn = scene.drawn()
        for shape, M in zip(geometry.geometryObjects, placed.oMg, strict=True):
            assert np.allclose(drawn[f"robot/{shape.name}"], M.homogeneous, rtol=0, atol=1e-12), shape.name


@pytest.mark.parametrize("name", DRAWN)
def test_every_shape_is_drawn_whole(name):
    """The triangles span the same box as Pinocchio's own reading of the mesh or primitive (a lost material would not)."""
    robot = load(name)
    body = Body(robot)
    assert body.notice == ""
    for part, shape in zip(body.parts, visual(robot).geometryObjects, strict=True):
        shape.geometry.computeLocalAABB()
        box = shape.geometry.aabb_local
        vertices = np.vstack([s.vertices for s in part.shapes])
        size = np.linalg.norm(box.max_ - box.min_)
        assert np.allclose(vertices.min(axis=0), box.min_, atol=0.01 * size), part.name
        assert np.allclose(vertices.max(axis=0), box.max_, atol=0.01 * size), part.name


@DATA
def test_colours_of_materials_survive():
    colours = {shape.color for part in Body(load("ur5")).parts for shape in part.shapes}
    assert len(colours) > 2


def test_ghosts_are_copies_where_the_solutions_are():
    robot = load("hydrolek_7w")
    target = robot.fk(robot.random_q(np.random.default_rng(1))).translation
    found = list(ik.solve_all(robot, target, starts=60))[:3]
    assert len(found) == 3
    scene = view(robot, found, target=target)
    body = Body(robot)
    drawn = scene.drawn()
    for k, q in enumerate(found[1:], 1):
        for part, T in zip(body.parts, body.placements(q), strict=True):
            assert np.allclose(drawn[f"ghost_{k}/{part.name}"], T, rtol=0, atol=1e-12)
    assert np.allclose(drawn["target"][:3, 3], target, atol=1e-12)
    assert np.allclose(drawn["tip"][:3, 3], target, atol=1e-5)
    copied = {path.split("/")[0] for path in scene.window.copies}
    assert copied == {"ghost_1", "ghost_2"}
    fixed = [part.name for part in body.parts if part.name.startswith("base_link")]
    assert fixed and not any(path.startswith(f"ghost_1/{fixed[0]}/") for path in scene.window.copies)


def test_ghosts_that_coincide_are_drawn_once_and_follow_their_robot():
    robot = load("hydrolek_7w")
    q = robot.home.copy()
    q[-1] += 0.5
    scene = view(robot, [robot.home, q, q])
    (once,) = {path.split("/")[0] for path in scene.window.copies}
    assert once == "ghost_1" and len(scene.window.copies) < len(scene.window.objects)
    scene.show(robot.lower, "ghost_1", (0.0, 0.4, 0.7), 0.3)  # elsewhere it has more parts
    assert "ghost_1/link_2_0/0" in scene.window.copies
    body = Body(robot)
    (place,) = (T for part, T in zip(body.parts, body.placements(robot.lower), strict=True) if part.name == "link_2_0")
    assert np.allclose(scene.drawn()["ghost_1/link_2_0"], place)


def frames(scene):
    """Animation of a scene as poses (F, P, 3, 4)."""
    made = scene.window.about["animation"]
    return made, made["data"]


def test_a_solve_becomes_an_animation_of_its_iterates():
    robot = load("hydrolek_7w")
    target = robot.fk(robot.random_q(np.random.default_rng(3)))
    result = ik.solve(robot, target, "dls", history=True)
    scene = view(robot, result, target=target)
    made, poses = frames(scene)
    tip = made["paths"].index("/meshcat/tip")
    first, last = robot.fk(result.history["q"][0]), robot.fk(result.history["q"][-1])
    assert np.allclose(poses[0, tip], first.homogeneous[:3], atol=1e-6)
    assert np.allclose(poses[-1, tip], last.homogeneous[:3], atol=1e-6)
    assert made["first"] == made["count"] - 1 and len(made["labels"]) == made["count"]
    assert made["labels"][0].startswith("iteration 0: ")
    assert {"trail", "start/link_1_0"} <= set(scene.drawn())
    assert scene.window.about["lines"][0] == "dls: CONVERGED"


def test_a_failed_solve_ends_on_its_answer():
    robot = load("hydrolek_7w")
    target = (2.0, -0.5, 0.3)
    result = ik.solve(robot, target, history=True)
    assert result.attempt > 0  # not the first of its three attempts
    scene = view(robot, result, target=target)
    made, poses = frames(scene)
    tip = made["paths"].index("/meshcat/tip")
    assert np.allclose(poses[-1, tip], robot.fk(result.q).homogeneous[:3], atol=1e-6)
    first = result.history["q"][np.flatnonzero(result.history["attempt"] == result.attempt)[0]]
    assert np.allclose(poses[0, tip], robot.fk(first).homogeneous[:3], atol=1e-6)
    assert made["labels"][-1].endswith(f": {length(result.position_error)}")
    assert {"trail", "trail_of_0_0", "trail_of_1_0"} <= set(scene.drawn())
    assert [text for _, text in scene.window.about["legend"]].count("other attempts") == 1


def test_a_tracking_run_becomes_an_animation_in_real_time():
    robot = load("hydrolek_7w")
    run = ik.track(robot, ik.circle(robot.fk(robot.home), 0.05, duration=2.0), "cv", dt=0.01, q0=robot.home)
    scene = view(robot, run)
    made, poses = frames(scene)
    assert made["count"] == len(run.t) and np.isclose(made["fps"], 100.0)
    tip = made["paths"].index("/meshcat/tip")
    assert np.allclose(poses[:, tip, :, 3], run.xyz, atol=1e-5)
    assert {"trail/0", "path"} <= set(scene.drawn())


def test_several_tips_are_drawn_together():
    tree = ik.Tree.load("brokk_hydrolek", tips=["left_tip", "right_tip"])
    scene = view(tree, target={"left_tip": [1.0, 0.5, 1.0], "right_tip": [1.0, -0.5, 1.0]})
    drawn = scene.drawn()
    for name, arm, place in zip(("tip", "tip2"), tree.arms, tree.places, strict=True):
        assert np.allclose(drawn[name], arm.fk(tree.home[place]).homogeneous, atol=1e-12)
    assert drawn["target2"][1, 3] == -0.5


def test_poses_are_in_base_axes():
    """A base above the root: drawings stay at the tip's pose in the world."""
    robot = ik.Robot.load(SLIDES, base="l1")
    scene = view(robot)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.to_pinocchio(robot.home))
    assert np.allclose(scene.drawn()["tip"], data.oMf[robot.model.getFrameId(robot.tip)].homogeneous, atol=1e-12)


@pytest.mark.parametrize("name", list(MADE))
def test_a_robot_without_shapes_is_a_stick_figure(name):
    robot = load(name)
    scene = view(robot)
    assert "stick figure" in scene.window.about["lines"][0]
    drawn = scene.drawn()
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.to_pinocchio(robot.home))
    for joint in robot.joint_names:
        place = data.oMi[robot.model.getJointId(joint)].homogeneous
        assert np.allclose(drawn[f"robot/{joint}_ball"], place, atol=1e-12)


def test_missing_meshes_are_said(tmp_path):
    text = SLIDES.replace(
        '<link name="l1"/>',
        '<link name="l1"><visual><geometry><mesh filename="package://nowhere/x.stl"/></geometry></visual></link>',
    )
    notice = Body(ik.Robot.load(text)).notice
    assert "link 'l1': mesh 'package://nowhere/x.stl' cannot be found" in notice and "stick figure" in notice


@pytest.mark.skipif(find_spec("matplotlib") is None, reason="matplotlib is not installed (extra 'plots')")
@pytest.mark.parametrize("length", ["1e-320", "1e-9", "1e8", "1e12"])
def test_robots_of_any_size_are_drawn_or_refused(length):
    robot = ik.Robot.load(urdf(*[{"kind": "revolute", "axis": "0 1 0", "xyz": f"0 {length} 0"}] * 2))
    if float(length) > 1e9:
        with pytest.raises(ModelError, match="farther than 1e\\+09 m"):
            ik.view(robot)
    else:
        scene = ik.view(robot, target=(0.0, 0.0, 0.0))
        assert "</html>" in scene.html() and "image/png" in scene._repr_mimebundle_()


def test_tube_is_round_and_follows_its_line():
    P = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 0], [1, 1, 2.0]])
    shape = tube(P, 0.1, (1, 0, 0))
    rings = shape.vertices.reshape(-1, 10, 3)
    assert len(rings) == 4 and shape.faces.max() < len(shape.vertices)
    assert np.allclose(rings.mean(axis=1), P[[0, 1, 2, 4]], atol=1e-6)
    assert np.allclose(np.linalg.norm(rings - rings.mean(axis=1, keepdims=True), axis=2), 0.1, atol=1e-6)
    assert isinstance(tube(P[:1], 0.1, (1, 0, 0)), DrawnShape)


def test_page_is_self_contained_and_small(tmp_path):
    robot = load("hydrolek_7w")
    scene = view(robot, cloud=(np.eye(3), [True, False, True]), title="<b>&robot")
    file = scene.save(tmp_path / "scene.html")
    page = file.read_text(encoding="utf-8")
    assert not re.findall(r"""(?:src|href|url\()\s*=?\s*["']?(?:https?:)?//""", page)
    assert "http://" not in page and "https://" not in page
    assert "<title>&lt;b&gt;&amp;robot</title>" in page
    assert len(page) < 700_000
    assert ["#0072b2", "reached: 2 of 3"] in [list(item) for item in scene.window.about["legend"]]


def test_camera_is_aimed_at_the_robot():
    robot = load("hydrolek_7w")
    scene = view(robot)
    eye, target, _, floor = scene.window.about["camera"]
    body = Body(robot)
    low, high = body.bounds(robot.home)
    assert (np.array(target) > low).all() and (np.array(target) < high + 0.1).all()
    distance = np.linalg.norm(np.subtract(eye, target))
    assert 0.5 * np.linalg.norm(high - low) < distance < 2.0 * np.linalg.norm(high - low)
    assert floor == pytest.approx(low[2])
    q = min(robot.random_q(np.random.default_rng(0), 50), key=lambda q: body.bounds(q)[0, 2])  # reaches down
    assert body.bounds(q)[0, 2] < floor - 0.1 and view(robot, q).window.about["camera"][3] == floor


def test_refusals_are_words(tmp_path):
    robot = load("hydrolek_7w")
    with pytest.raises(InvalidConfiguration, match="must have 6 values"):
        view(robot, [1.0, 2.0])
    with pytest.raises(InvalidOption, match="nothing to show"):
        view(robot, np.empty((0, robot.n)))
    with pytest.raises(InvalidOption, match=r"written as \.html"):
        view(robot).save(tmp_path / "scene.png")
    with pytest.raises(InvalidOption, match="one value per point"):
        Scene(robot).cloud(np.eye(3), [True])
    for bad in ("points", None, {}, np.eye(2), [[0.0, np.nan, 0.0]]):
        with pytest.raises(InvalidOption, match="points must be finite numbers"):
            Scene(robot).cloud(bad)
    for bad in ("hydrolek_7w", None, robot.home):
        with pytest.raises(InvalidOption, match="a Robot or a Tree is needed"):
            view(bad)


def test_view_writes_a_file(run, refused, tmp_path):
    given = ["--html", tmp_path / "out.html"]
    code, _, err = run("view", "hydrolek_7w", "--xyz", 0.6, 0.3, 0.1, *given)
    assert code == 0 and "CONVERGED" in err and given[1].stat().st_size > 100_000
    code, _, err = run("view", "hydrolek_7w", "--xyz", 9, 0, 0, *given)
    assert code == 1 and "beyond reach" in err
    assert "6 values" in refused("view", "hydrolek_7w", "--q", 1, 2, *given)


def test_a_solve_is_drawn(run, tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra 'plots')")
    page, chart = tmp_path / "out.html", tmp_path / "out.png"
    assert run("solve", "hydrolek_7w", "--xyz", 0.6, 0.3, 0.1, "--plot", chart, "--html", page)[0] == 0
    assert page.stat().st_size > 100_000 and chart.read_bytes()[:4] == b"\x89PNG"
    page.unlink()
    code, _, err = run("solve", "hydrolek_7w", "--xyz", 9, 0, 0, "--plot", chart, "--html", page)
    assert code == 1 and page.exists() and "beyond reach" in err
    page.unlink()
    assert run("solve", "planar_2r", "--xyz", 1, 1, 0, "--all", "--html", page)[0] == 0 and page.exists()


def test_a_target_far_away_does_not_shrink_the_picture():
    robot = load("hydrolek_7w")
    near, far = view(robot), view(robot, target=[50.0, 0.0, 0.0])
    assert np.allclose(near.window.about["camera"][0], far.window.about["camera"][0], atol=0.05)
    assert any("outside the picture" in label for _, label in far.window.about["legend"])
    near.update(robot.home, [0.5, 0.1, 0.2])
    assert near.window.about["camera"] == view(robot).window.about["camera"]  # it stays: all is in the picture
    rail = ik.Robot.load("planar_2r", on_base="rail", base_limits=(0.0, 30.0))
    scene, q = view(rail), np.add(rail.home, (25.0, 0.0, 0.0))
    for change in (scene.show, scene.update):
        change(q)
        eye, to = np.array(scene.window.about["camera"][:2])
        tip = rail.fk(q).translation
        assert np.linalg.norm(np.cross(tip - eye, to - eye)) < np.tan(np.radians(37.5)) * (tip - eye) @ (to - eye)
        q = rail.home
