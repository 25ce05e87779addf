"""What Pinocchio's own people bring: their models, shapes, RobotWrapper and visualisers."""

import copy
import pickle

import numpy as np
import pinocchio as pin
import pytest
from refusals import refuses
from robots import CONTINUOUS, MADE, MIMIC, SLIDES, have_data, load

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption, JointNotFound, ModelError, RobotNotFound
from ik_toolkit.robot.geometry.link_shapes import link_shapes
from ik_toolkit.robot.library import find

DATA = pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed (extra 'robots')")
ARMS = ["hydrolek_7w", pytest.param("panda", marks=DATA)]


def files(name):
    entry = find(name)
    return str(entry.path), [str(folder) for folder in entry.package_dirs]


def placed(model, geometry, q):
    """Poses of shapes by Pinocchio, by name."""
    data, found = model.createData(), geometry.createData()
    pin.updateGeometryPlacements(model, data, geometry, found, q)
    return {shape.name: M.homogeneous for shape, M in zip(geometry.geometryObjects, found.oMg, strict=True)}


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("root", [None, pin.JointModelFreeFlyer()], ids=["fixed", "free"])
def test_models_shapes_and_wrappers_are_taken_as_they_are(name, root):
    known = load(name)
    wrapper = pin.RobotWrapper.BuildFromURDF(*files(name), root_joint=root)
    models = wrapper.model, wrapper.collision_model, wrapper.visual_model
    more = {"tip": known.tip, "base": known.base, "base_limits": None if root is None else (-1.0, 1.0)}
    for robot in (ik.Robot(*models, **more), ik.Robot(models, **more), ik.Robot(wrapper, **more)):
        q = robot.random_q(np.random.default_rng(3))
        full = robot.to_pinocchio(q)
        assert full.shape == (wrapper.model.nq,) and np.allclose(robot.q_from_pinocchio(full), q, atol=1e-12)
        assert np.allclose(robot.fk(q).homogeneous, known.fk(q[robot.n - known.n :]).homogeneous, atol=1e-9)
        assert robot.visual_model is wrapper.visual_model and robot.collision_model is wrapper.collision_model
        # Shapes are where Pinocchio has them, and come from the model: there is no URDF.
        assert robot.urdf is None
        geometry = ik.CollisionModel(robot).geometry
        ours = placed(robot.model, geometry, robot._filled(q))
        theirs = placed(wrapper.model, wrapper.collision_model, full)
        assert ours.keys() == theirs.keys() and all(np.allclose(ours[k], theirs[k], atol=1e-9) for k in theirs)


@pytest.mark.parametrize("name", ARMS)
def test_visual_shapes_look_as_those_of_the_urdf(name):
    known = load(name)
    robot = ik.Robot(*pin.buildModelsFromUrdf(*files(name)), tip=known.tip, base=known.base)
    (ours, problems), (theirs, none) = (link_shapes(one, "look", 1000) for one in (robot, known))
    assert problems == none == [] and len(ours) == len(theirs) > 3
    for a, b in zip(sorted(ours, key=lambda s: s.name), sorted(theirs, key=lambda s: s.name), strict=True):
        assert (a.name, a.link, a.kind) == (b.name, b.link, b.kind)
        assert np.allclose(a.sizes, b.sizes) and a.T_link_shape.isApprox(b.T_link_shape, 1e-9)
        assert a.color is None or np.allclose(a.color, b.color or a.color)
        assert [len(piece.faces) for piece in a.mesh.pieces] == [len(piece.faces) for piece in b.mesh.pieces]


def test_shapes_without_a_file_and_shapes_that_cannot_be_drawn():
    import coal

    model, geometry = pin.buildModelFromXML(SLIDES), pin.GeometryModel()
    box = coal.BVHModelOBBRSS()
    box.beginModel(1, 3)
    box.addTriangle(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    box.endModel()
    for name, form in {"mesh": box, "ball": coal.Sphere(0.2), "cone": coal.Cone(0.1, 0.2)}.items():
        geometry.addGeometryObject(pin.GeometryObject(name, 1, pin.SE3.Identity(), form))  # with a joint, no frame
    robot = ik.Robot(model, visual_model=geometry)
    shapes, problems = link_shapes(robot, "look", 10)
    assert {shape.name: shape.kind for shape in shapes} == {"mesh": "mesh", "ball": "sphere"}
    assert shapes[0].mesh.pieces[0].vertices.shape == (3, 3) and shapes[0].mesh.pieces[0].faces.tolist() == [[0, 1, 2]]
    assert problems == [("shape 'cone'", "is a Cone, which is not drawn")]
    with pytest.raises(ModelError, match="3 visual shapes; at most 2"):
        link_shapes(robot, "look", 2)


def test_what_is_no_model_is_refused():
    model = load("planar_2r").model
    with pytest.raises(RobotNotFound, match=r"not Model; ik\.Robot\(model\) takes a pin\.Model"):
        ik.Robot.load(model)
    refuses(
        ModelError,
        (lambda: ik.Robot("hydrolek_7w"), "a pin.Model is expected, not str; Robot.load reads names"),
        (lambda: ik.Robot(pin.GeometryModel()), "a pin.Model is expected, not GeometryModel; Robot.load reads names"),
        (lambda: ik.Robot(model, model), "collision_model must be a pin.GeometryModel, not Model"),
        (lambda: ik.CollisionModel(ik.Robot(model, tip="tool")), "from a Pinocchio model alone.*collision_model="),
    )
    for owner in (ik.Robot, load("planar_2r")):
        with pytest.raises(AttributeError, match=r"is now q_from_pinocchio.*ik.Robot\(model\)"):
            owner.from_pinocchio(model)


@pytest.mark.parametrize("text", MADE.values(), ids=MADE)
@pytest.mark.parametrize(
    "root", [None, pin.JointModelFreeFlyer(), pin.JointModelPlanar()], ids=["fixed", "free", "planar"]
)
def test_a_configuration_of_another_model_has_the_same_pose_in_it(text, root):
    """The other model has mimic joints as free ones, angles as cosine and sine, and may stand on a base of its own."""
    robot = ik.Robot.load(text)
    other = pin.buildModelFromXML(text) if root is None else pin.buildModelFromXML(text, root)
    assert other.nq != robot.model.nq or text is not MIMIC
    data, rng = other.createData(), np.random.default_rng(5)
    base, tip = (other.getFrameId(name) for name in (robot.base, robot.tip))
    for _ in range(10):
        q = robot.random_q(rng)
        full = robot.to_pinocchio(q, model=other)
        pin.framesForwardKinematics(other, data, full)
        found = data.oMf[base].actInv(data.oMf[tip])
        assert np.allclose(found.homogeneous, robot.fk(q).homogeneous, rtol=0, atol=1e-12)
        if root is not None:  # `rest` says where the other model's base is
            rest = pin.randomConfiguration(other, np.full(other.nq, -1.0), np.full(other.nq, 1.0))
            moved = robot.to_pinocchio(q, rest, model=other)
            size = other.joints[1].nq
            assert np.array_equal(moved[:size], rest[:size]) and np.array_equal(moved[size:], full[size:])


def test_values_of_mimic_joints_and_of_joints_at_rest():
    robot = ik.Robot.load(MIMIC)
    q = robot.random_q(np.random.default_rng(6))
    at = robot.joint_values(q)
    assert list(at)[: robot.n] == list(robot.joint_names)
    ties = robot.mimic_joints
    assert set(ties) == {name for name in at if name not in robot.joint_names} and len(ties) == 2
    assert {(tie.leader, tie.ratio, tie.offset) for tie in ties.values()} == {("j1", -0.6, 0.2), ("j0", 0.1, 0.05)}
    for joint, (leader, ratio, offset) in ties.items():
        assert at[joint] == ratio * at[leader] + offset
    held = ik.Robot.load(CONTINUOUS).locked({"j2": 0.5})
    assert held.joint_values(held.home)["j2"] == pytest.approx(0.5) and held.mimic_joints == {}


def test_another_model_without_the_joints_is_refused():
    robot = load("planar_2r")
    said = f"the model has no joint '{robot.joint_names[0]}', which robot 'planar_2r' moves"
    with pytest.raises(JointNotFound, match=said):
        robot.to_pinocchio(robot.home, model=load("hydrolek_7w").model)
    with pytest.raises(InvalidOption, match=r"model must be a pin.Model, not str"):
        robot.to_pinocchio(robot.home, model="panda")
    with pytest.raises(InvalidConfiguration, match="rest must have 2 values for this model"):
        robot.to_pinocchio(robot.home, [0.0], model=robot.model)


def test_a_urdf_beside_a_model_is_a_text_or_a_path(tmp_path):
    """It knows the limits of mimic joints, which Pinocchio drops; a copy of the robot is the same robot."""
    file = tmp_path / "mimic.urdf"
    file.write_text(MIMIC)
    for model in (pin.buildModelFromXML(MIMIC), pin.buildModelFromXML(MIMIC, True)):
        for given in (MIMIC, file, str(file)):
            robot = ik.Robot(model, urdf=given)
            assert robot.urdf == MIMIC and robot.path == (None if given is MIMIC else file)
            again = pickle.loads(pickle.dumps(robot))
            assert again.model.nq == model.nq and again.joint_names == robot.joint_names
            assert np.array_equal(again.fk(again.home).homogeneous, robot.fk(robot.home).homogeneous)
    alone = ik.Robot(urdf=str(file))
    assert alone.joint_names == ik.Robot.load(file).joint_names and np.array_equal(alone.home, ik.Robot.load(file).home)
    file.write_text(MIMIC.replace('type="revolute"', 'type="revolt"'))
    with pytest.raises(ModelError, match="revolt"):
        ik.Robot(urdf=file)
    with pytest.raises(RobotNotFound, match=r"there is no file 'nowhere\.urdf'"):
        ik.Robot(model, urdf="nowhere.urdf")


@pytest.mark.parametrize("change", ["moved", "fewer joints", "free-flyer"])
def test_a_model_that_its_urdf_does_not_describe_stays_as_it_is(change, tmp_path, caplog):
    """The model counts: a copy has its kinematics, a written file is said to be without them, and no correction is written."""
    text = load("hydrolek_7w").urdf
    model, limits = pin.buildModelFromXML(text), None
    if change == "moved":
        model.jointPlacements[3] *= pin.SE3(np.eye(3), np.array([0.004, 0.0, 0.0]))
    elif change == "fewer joints":
        model = pin.buildReducedModel(model, [2], pin.neutral(model))
    else:
        model, limits = pin.buildModelFromXML(text, pin.JointModelFreeFlyer()), (-1, 1)
    robot = ik.Robot(model, tip="tool", urdf=text, base_limits=limits)
    for again in (copy.copy(robot), copy.deepcopy(robot), pickle.loads(pickle.dumps(robot))):
        assert np.array_equal(again.fk(again.home).homogeneous, robot.fk(robot.home).homogeneous)
    robot.write(tmp_path / "arm.urdf")
    assert "without the other joints or lengths of the given model" in caplog.text
    Q = robot.random_q(np.random.default_rng(0), 20)
    found = ik.calibrate(robot, Q, [robot.fk(q).translation for q in Q], parameters=["joints"])
    with pytest.raises(ModelError, match="does not describe the model it was made from"):
        found.write(tmp_path / "corrected.urdf")


def test_a_mimic_joint_that_is_free_in_the_model_is_said():
    """The model is built without mimic=True: the follower is a joint of q, with its own limits."""
    model = pin.buildModelFromXML(MIMIC)
    robot, known = ik.Robot(model, tip="l8", urdf=MIMIC), ik.Robot.load(MIMIC, tip="l8")
    free = [note for note in robot.notes if "is free in this model; build it with mimic=True" in note]
    assert "joint 'j2' mimics 'j1' in the URDF" in free[0] and len(free) == robot.n - known.n == 2
    k = robot.joint_names.index("j2")
    assert (robot.lower[k], robot.upper[k]) == (-1.0, 1.0) and not any("free" in note for note in known.notes)
    tied = ik.Robot(pin.buildModelFromXML(MIMIC, mimic=True), tip="l8", urdf=MIMIC)
    assert tied.joint_names == known.joint_names and tied.notes == known.notes


@DATA
def test_a_pickled_robot_reads_its_meshes_again():
    robot = ik.Robot(*pin.buildModelsFromUrdf(*files("panda")))
    stored = pickle.dumps(robot)
    again = pickle.loads(stored)
    assert len(stored) < 10_000_000  # the triangles of the visual meshes take 250 MB as Pinocchio stores them
    for one, other in zip(*(link_shapes(made, "look", 100)[0] for made in (robot, again)), strict=True):
        assert one.name == other.name and len(one.mesh.pieces) == len(other.mesh.pieces) > 0
    assert ik.CollisionModel(again).pairs == ik.CollisionModel(robot).pairs


def test_mobility_is_that_of_the_joints_left():
    robot = load("hydrolek_7w")
    assert robot.mobility is robot.mobility
    held = robot.locked({robot.joint_names[0]: 0.1, robot.joint_names[1]: 0.2})
    assert str(held.mobility).startswith(f"{robot.n - 2} joints")
