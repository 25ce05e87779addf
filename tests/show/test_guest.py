"""A scene in a viewer of the caller's: meshcat's own, or Pinocchio's MeshcatVisualizer."""

import numpy as np
import pinocchio as pin
import pytest
from robots import have_data, load
from wire import Wire

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.robot.library import find

meshcat = pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")
visualize = pytest.importorskip("pinocchio.visualize")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")

NAME = "panda" if have_data() else "hydrolek_7w"


@pytest.fixture(scope="module")
def models():
    entry = find(NAME)
    return pin.buildModelsFromUrdf(str(entry.path), [str(folder) for folder in entry.package_dirs])


@pytest.fixture(scope="module")
def robot(models):
    return ik.Robot(*models, tip=load(NAME).tip, base=load(NAME).base)


@pytest.fixture
def wire():
    return Wire()


@pytest.fixture
def theirs(models, wire):
    made = visualize.MeshcatVisualizer(*models)
    made.initViewer(viewer=meshcat.Visualizer(window=wire), loadModel=True)
    return made


def shown(wire, viewer):
    """Poses of the parts that the caller's visualiser has drawn, by name."""
    start = f"/meshcat/{viewer.viewerVisualGroupName}/"
    return {path.removeprefix(start): T for path, T in wire.transforms.items() if path.startswith(start)}


def test_pinocchios_own_drawing_moves_and_none_is_added(robot, theirs, wire):
    q = robot.random_q(np.random.default_rng(2))
    theirs.display(robot.to_pinocchio(q))
    expected = shown(wire, theirs)
    theirs.display(pin.neutral(theirs.model))
    count = len(wire.objects)
    scene = ik.view(robot, q, target=robot.fk(q), viewer=theirs)
    found = shown(wire, theirs)
    assert found.keys() == expected.keys() and len(found) > 3
    assert all(np.allclose(found[name], expected[name], atol=1e-9) for name in expected)
    added = {path for path in wire.objects if path.startswith("/meshcat/ik_toolkit/")}
    assert len(wire.objects) == count + len(added) and not any("/robot/" in path for path in added)
    assert {path.split("/")[3] for path in added} == {"tip", "target"}
    # The scene stays connected: what it shows next moves the same drawing.
    scene.show(robot.home)
    after = shown(wire, theirs)
    theirs.display(robot.to_pinocchio(robot.home))
    assert all(np.allclose(after[name], T, atol=1e-9) for name, T in shown(wire, theirs).items())


@pytest.mark.skipif(NAME != "panda", reason="example-robot-data is not installed (extra 'robots')")
def test_a_robot_loaded_by_name_moves_the_same_drawing(theirs, wire):
    """Its model ties the second finger to the first (nq 8); the caller's has two free fingers (nq 9)."""
    robot = load("panda")
    assert (robot.model.nq, theirs.model.nq) == (8, 9)
    q = robot.random_q(np.random.default_rng(3))
    ik.view(robot, q, viewer=theirs)
    found = shown(wire, theirs)
    theirs.display(robot.to_pinocchio(q, model=theirs.model))
    assert all(np.allclose(found[name], T, atol=1e-9) for name, T in shown(wire, theirs).items())


def test_a_second_view_leaves_nothing_of_the_first(robot, theirs, wire):
    rng = np.random.default_rng(4)
    ik.view(robot, robot.random_q(rng, 4), target=robot.fk(robot.home), viewer=theirs)
    ghosts = {path for path in wire.objects if "/ghost_" in path}
    assert ghosts and all(wire.objects[path]["materials"][0]["opacity"] == 0.32 for path in ghosts)
    colors = {wire.objects[path]["materials"][0]["color"] for path in ghosts}
    assert len(colors) == 3
    ik.view(robot, robot.home, viewer=theirs)
    left = {path.split("/")[3] for path in wire.objects if path.startswith("/meshcat/ik_toolkit/")}
    assert left == {"tip"} and wire.animations[-1] == []


def test_an_animation_ends_where_the_robot_is(robot, theirs, wire):
    result = ik.solve(robot, robot.fk(robot.random_q(np.random.default_rng(5))), history=True)
    ik.view(robot, result, viewer=theirs)
    clips = {clip["path"]: clip["clip"]["tracks"] for clip in wire.animations[-1]}
    last = shown(wire, theirs)
    assert {path.rpartition("/")[2] for path in clips} == {*last, "tip"}
    for name, T in last.items():
        tracks = {track["name"]: track["keys"] for track in clips[f"/meshcat/{theirs.viewerVisualGroupName}/{name}"]}
        assert np.allclose(tracks[".position"][-1]["value"], T[:3, 3], atol=1e-6), name


@pytest.mark.parametrize("base", ["pose", "planar", "floating"])
def test_a_robot_on_a_base_is_drawn_where_it_stands(models, theirs, wire, base):
    """In the caller's viewer: his drawing moves as if the root joint of his model had the pose of the base."""
    T = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.7), np.array([1.0, -2.0, 0.5 if base != "planar" else 0.0]))
    how = {"on_base": T} if base == "pose" else {"on_base": base, "base_limits": (-3.0, 3.0)}
    robot = ik.Robot(*models, tip=load(NAME).tip, **how)
    q = robot.home.copy()
    if base != "pose":
        q[: 3 if base == "planar" else 6] = (1.0, -2.0, 0.7) if base == "planar" else (1.0, -2.0, 0.5, 0.7, 0.0, 0.0)
    fixed = ik.Robot(*models, tip=load(NAME).tip)
    theirs.display(fixed.to_pinocchio(q[-fixed.n :]))
    expected = {name: T.homogeneous @ M for name, M in shown(wire, theirs).items()}
    scene = ik.view(robot, q, target=robot.fk(q), viewer=theirs)
    found = shown(wire, theirs)
    assert found.keys() == expected.keys()
    assert all(np.allclose(found[name], M, atol=1e-9) for name, M in expected.items())
    for name in ("tip", "target"):
        assert np.allclose(wire.transforms[f"/meshcat/ik_toolkit/{name}"], robot.fk(q).homogeneous, atol=1e-9)
    scene.close()


def test_shapes_without_a_file_are_drawn(wire):
    import coal

    model, geometry = load("planar_2r").model, pin.GeometryModel()
    for name, form in {
        "box": coal.Box(0.1, 0.2, 0.3),
        "rod": coal.Cylinder(0.1, 0.5),
        "pill": coal.Capsule(0.1, 0.5),
    }.items():
        geometry.addGeometryObject(pin.GeometryObject(name, 1, pin.SE3.Identity(), form))
        geometry.geometryObjects[-1].meshColor = np.array([1.0, 0.0, 0.0, 0.5])
    viewer = visualize.MeshcatVisualizer(model, None, geometry)
    viewer.initViewer(viewer=meshcat.Visualizer(window=wire), loadModel=True)
    robot = ik.Robot(model, visual_model=geometry, tip="tool")
    scene = ik.view(robot, robot.home, viewer=viewer)
    assert {"robot/box", "robot/rod", "robot/pill"} <= scene.drawn().keys()
    assert len(shown(wire, viewer)) == 3


def test_meshcats_own_viewer_gets_the_robot_too(robot, wire):
    scene = ik.view(robot, robot.home, viewer=meshcat.Visualizer(window=wire))
    drawn = {f"/meshcat/ik_toolkit/{path}": T for path, T in scene.drawn().items()}
    assert drawn.keys() == wire.transforms.keys()
    assert all(np.allclose(wire.transforms[path], T) for path, T in drawn.items())
    assert {path.rpartition("/")[0] for path in wire.objects} >= {path for path in drawn if "/robot/" in path}


def test_what_is_no_viewer_is_refused(robot, models, theirs):
    with pytest.raises(InvalidOption, match=r"viewer must be a meshcat.Visualizer, or Pinocchio's .* not 'browser'"):
        ik.view(robot, viewer="browser")
    with pytest.raises(InvalidOption, match=r"after initViewer\(\) and loadViewerModel\(\), not <pinocchio"):
        ik.view(robot, viewer=visualize.MeshcatVisualizer(*models))
    with pytest.raises(InvalidOption, match=r"no part of this robot; make it with ik\.Robot"):
        ik.view(load("planar_2r"), viewer=theirs)
