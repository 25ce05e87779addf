"""Robot bases: a pose, a planar or a floating base, and free-flyers of given models."""

import json
import pickle

import numpy as np
import pinocchio as pin
import pytest
from robots import branches, filled, joint, load, tie

import ik_toolkit as ik
from ik_toolkit import cli
from ik_toolkit.errors import InvalidOption, InvalidTarget, ModelError

ARM = "hydrolek_7w"
PLANAR = ("base_x", "base_y", "base_yaw")
FLOATING = ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll")


def leg(side, y):
    return (
        joint(f"{side}_hip", "revolute", "body", f"{side}_thigh", "1 0 0", f"0 {y} 0")
        + joint(f"{side}_knee", "revolute", f"{side}_thigh", f"{side}_shank", "0 1 0", "0 0 -0.3")
        + joint(f"{side}_sole", "fixed", f"{side}_shank", f"{side}_foot", xyz="0 0 -0.3")
    )


BODY = branches(leg("left", 0.1), leg("right", -0.1), root="body", name="legs")
FEET = ("left_foot", "right_foot")


def solved(robot, count, seed=0, **options):
    """Number of `count` reachable targets that are solved, checked by Pinocchio."""
    rng = np.random.default_rng(seed)
    results = [ik.solve(robot, robot.fk(robot.random_q(rng)), seed=k, **options) for k in range(count)]
    return sum(result.success for result in results)


def check_fk(robot, model, count):
    """Random q and back, and the tip where Pinocchio has it in the model that was given."""
    data = model.createData()
    for q in robot.random_q(np.random.default_rng(2), count):
        full = robot.to_pinocchio(q)
        assert full.shape == (model.nq,) and pin.isNormalized(model, full, 1e-9)
        pin.framesForwardKinematics(model, data, full)
        found = data.oMf[model.getFrameId(robot.tip)].homogeneous
        assert np.abs(found - robot.fk(q).homogeneous).max() < 1e-12
        assert np.allclose(robot.fk(robot.q_from_pinocchio(full)).homogeneous, found, atol=1e-9)


def test_a_pose_moves_the_robot_in_the_world():
    T = ik.pose((0.5, 0.2, 0.8), rpy=(0.1, 0.2, 1.0))
    plain, robot = load(ARM), ik.Robot.load(ARM, on_base=T)
    assert robot.joint_names == plain.joint_names and np.array_equal(robot.home, plain.home)
    assert np.allclose(robot.fk(plain.home).homogeneous, T @ plain.fk(plain.home).homogeneous, atol=1e-12)
    assert solved(robot, 20) == 20
    above = ik.Robot.load(ARM, on_base=(0, 0, 1))
    assert above.fk(plain.home).translation[2] == pytest.approx(plain.fk(plain.home).translation[2] + 1.0)


@pytest.mark.parametrize(("kind", "names"), [("planar", PLANAR), ("floating", FLOATING)])
def test_a_base_is_ordinary_joints_before_the_others(kind, names):
    plain, robot = load(ARM), ik.Robot.load(ARM, on_base=kind, base_limits=(-0.5, 2))
    count = len(names)
    assert robot.joint_names == (*names, *plain.joint_names) and not robot.home[:count].any()
    assert np.array_equal(robot.home[count:], plain.home) and np.array_equal(robot.lower[count:], plain.lower)
    slides = [name[-1] in "xyz" for name in names]
    assert (robot.lower[:count][slides] == -0.5).all() and (robot.upper[:count][slides] == 2.0).all()
    yaw = names.index("base_yaw")
    assert np.isinf(robot.upper[yaw]) and robot.joint_kinds[yaw] == "continuous"
    if kind == "floating":
        assert np.degrees(robot.upper[4]) == pytest.approx(85.0) and np.isinf(robot.lower[5])
    q = robot.random_q(np.random.default_rng(1))
    x = dict(zip(names, q, strict=False))
    rpy = (x.get("base_roll", 0.0), x.get("base_pitch", 0.0), x["base_yaw"])
    T = ik.pose((x["base_x"], x["base_y"], x.get("base_z", 0.0)), rpy=rpy)
    assert np.allclose(robot.fk(q).homogeneous, T @ plain.fk(q[count:]).homogeneous, atol=1e-12)
    assert solved(robot, 20) == 20 and solved(robot.locked({"base_yaw": 0.3}), 5) == 5
    again = pickle.loads(pickle.dumps(robot))
    assert np.array_equal(again.fk(q).homogeneous, robot.fk(q).homogeneous) and again.joint_names == robot.joint_names


def test_a_rail_is_one_slide_before_the_others():
    plain, robot = load(ARM), ik.Robot.load(ARM, on_base="rail", base_limits=(-0.5, 2))
    assert robot.joint_names == ("base_x", *plain.joint_names) and robot.home[0] == 0.0
    assert robot.lower[0] == -0.5 and robot.upper[0] == 2.0
    moved = robot.fk([1.5, *plain.home]).homogeneous
    assert np.allclose(moved, ik.pose((1.5, 0, 0), rpy=(0, 0, 0)) @ plain.fk(plain.home).homogeneous, atol=1e-12)
    assert solved(robot, 20) == 20


@pytest.mark.parametrize(
    ("limits", "lower"),
    [
        ([(-1, 1), (-2, 2), (0, 3)], [-1, -2, 0, -np.inf]),
        ({"x": (-1, 1), "base_y": (-2, 2), "z": (0, 3), "yaw": (-0.5, 0.5)}, [-1, -2, 0, -0.5]),
        ([(-1, 1), (-2, 2), (0, 3), (-0.5, 0.5), (-1, 1), (-1, 1)], [-1, -2, 0, -0.5]),
    ],
)
def test_forms_of_limits(limits, lower):
    assert np.array_equal(ik.Robot.load(ARM, on_base="floating", base_limits=limits).lower[:4], lower)


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"on_base": "floating"}, InvalidOption, "base_limits= is needed: .* base_x, base_y, base_z"),
        ({"on_base": "planar", "base_limits": {"x": (0, 1)}}, InvalidOption, "base_limits= is needed: .* base_y"),
        ({"on_base": "plane"}, InvalidOption, "Did you mean 'planar'"),
        ({"base_limits": (0, 1)}, InvalidOption, "for a moving base"),
        ({"on_base": np.eye(4), "base_limits": (0, 1)}, InvalidOption, "for a moving base"),
        (
            {"on_base": "planar", "base_limits": (1, 0)},
            InvalidOption,
            "base_limits of 'base_x' must be two finite numbers",
        ),
        ({"on_base": "planar", "base_limits": (0, np.inf)}, InvalidOption, "two finite numbers"),
        ({"on_base": "planar", "base_limits": {"base_z": (0, 1)}}, InvalidOption, "no coordinate 'base_z'"),
        ({"on_base": "planar", "base_limits": "far"}, InvalidOption, "for the prismatic joints of the base"),
        ({"on_base": np.zeros((4, 4))}, InvalidTarget, "last row"),
        ({"on_base": np.eye(4), "base": "base_link"}, InvalidOption, "omit base"),
    ],
)
def test_mistakes(options, error, said):
    with pytest.raises(error, match=said):
        ik.Robot.load(ARM, **options)


def test_names_that_a_robot_has_already():
    with pytest.raises(InvalidOption, match="already has a joint 'base_x'"):
        ik.Robot.load(branches(joint("base_x", "prismatic", "o", "a")), on_base="planar", base_limits=(0, 1))


@pytest.mark.parametrize("mimic", ["", tie("b")])
def test_a_joint_and_a_link_may_have_the_same_name(mimic):
    """Pinocchio's own functions for a model on another one do not tell them apart."""
    text = branches(
        joint("b", "revolute", "o", "b"),
        joint("elbow", "revolute", "b", "c", axis="0 1 0", mimic=mimic),
        joint("tool", "fixed", "c", "tool"),
    )
    alone = ik.Robot.load(text, tip="tool")
    model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer(), bool(mimic))
    for robot in (
        ik.Robot.load(text, tip="tool", on_base=ik.pose((0, 0, 0))),
        ik.Robot.load(text, tip="tool", on_base="rail", base_limits=(0, 1)),
        ik.Robot(model, tip="tool", base_limits=(-1, 1), urdf=text),
    ):
        q = np.append(np.zeros(robot.n - alone.n), alone.home)
        assert robot.fk(q).isApprox(alone.fk(alone.home), 1e-12) and robot.joint_names[-alone.n :] == alone.joint_names
        assert [frame.name for frame in robot.model.frames].count("tool") == 2


@pytest.mark.parametrize("flyer", [pin.JointModelFreeFlyer, pin.JointModelPlanar])
def test_a_free_flyer_of_a_given_model_is_solved_for(flyer):
    model = pin.buildModelFromXML(BODY, flyer())
    with pytest.raises(InvalidOption, match="base_limits= is needed"):
        ik.Robot(model, tip="left_foot")
    robot = ik.Robot(model, tip="left_foot", base_limits=(-1, 1))
    assert robot.joint_names[:3] == ("base_x", "base_y", "base_z" if flyer is pin.JointModelFreeFlyer else "base_yaw")
    check_fk(robot, model, 20)
    rest = robot.to_pinocchio(robot.random_q(np.random.default_rng(3)))
    assert robot.to_pinocchio(robot.home, rest=rest).shape == rest.shape
    still = ik.Robot(model, tip="left_foot", base="body")
    assert still.joint_names == ("left_hip", "left_knee")
    with pytest.raises(InvalidOption, match="already has a base that moves"):
        ik.Robot(model, tip="left_foot", on_base="floating", base_limits=(-1, 1))


def test_a_ball_is_three_revolute_joints():
    model = pin.Model()
    ball = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "shoulder")
    elbow = model.addJoint(ball, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0, 0, 0.3])), "elbow")
    model.addFrame(pin.Frame("hand", elbow, 0, pin.SE3(np.eye(3), np.array([0.2, 0, 0])), pin.FrameType.BODY))
    robot = ik.Robot(model, tip="hand")
    assert robot.joint_names == ("shoulder_yaw", "shoulder_pitch", "shoulder_roll", "elbow")
    assert (robot.lower[1], robot.upper[1]) == (-np.pi / 2, np.pi / 2)  # with less, some rotations are out of reach
    check_fk(robot, model, 1)
    assert solved(robot, 20) == 20


def test_a_floating_joint_of_a_file_is_held_unless_it_has_limits(caplog):
    text = BODY.replace(
        '<link name="body"/>',
        '<link name="world"/><link name="body"/><joint name="free" type="floating">'
        '<parent link="world"/><child link="body"/></joint>',
    )
    assert ik.Robot.load(text, tip="left_foot").base == "body"
    assert "joint 'free' is held still and poses are given in 'body'" in caplog.text
    robot = ik.Robot.load(text, tip="left_foot", base_limits=(-1, 1))
    assert robot.joint_names[:6] == FLOATING and robot.to_pinocchio(robot.home).shape == (7 + 4,)


def test_legs_together_with_a_floating_base():
    tree = ik.Tree.load(BODY, FEET, on_base="floating", base_limits=(-1, 1))
    assert tree.joint_names[:6] == FLOATING and tree.n == 10 and tree.on_base == "floating"
    rng = np.random.default_rng(5)
    Q = tree.random_q(rng, 50)
    targets = {foot: np.array([tree.fk(q)[foot].translation for q in Q]) for foot in FEET}
    assert ik.solve_batch(tree, targets).success.all()
    model = pin.buildModelFromXML(BODY, pin.JointModelFreeFlyer())
    given = ik.Tree([ik.Robot(model, tip=foot, base_limits=(-1, 1)) for foot in FEET])
    assert given.to_pinocchio(given.home).shape == (model.nq,)


def test_shapes_given_for_the_model_lie_on_its_links():
    box = '<collision><geometry><box size="0.05 0.05 0.05"/></geometry></collision>'
    text = filled(BODY, {"left_shank": box, "body": box})
    model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
    shapes = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)
    robot = ik.Robot(model, tip="left_foot", base_limits=(-1, 1))
    mine = ik.CollisionModel(robot, geometry=shapes).add_sphere(0.1, (5, 0, 0))
    again = pickle.loads(pickle.dumps(mine))
    q = robot.random_q(np.random.default_rng(3))
    pin.updateGeometryPlacements(model, model.createData(), shapes, there := shapes.createData(), robot.to_pinocchio(q))
    for found in (mine, again):
        here = found.geometry.createData()
        pin.updateGeometryPlacements(robot.model, robot.model.createData(), found.geometry, here, q_all(robot, q))
        for k, shape in enumerate(shapes.geometryObjects):
            name = found.geometry.getGeometryId(shape.name)
            assert np.allclose(here.oMg[name].homogeneous, there.oMg[k].homogeneous, atol=1e-12)
        assert found.links == ("body", "left_shank") and found.obstacles == mine.obstacles


def q_all(robot, q):
    """Configuration of the whole model that is solved for."""
    return np.r_[q, np.zeros(robot.model.nq - robot.n)]


def test_limits_of_the_given_model_count():
    model = pin.buildModelFromXML(BODY, pin.JointModelFreeFlyer())
    model.lowerPositionLimit = np.r_[[-1.0, -2.0, 0.0], model.lowerPositionLimit[3:]]
    model.upperPositionLimit = np.r_[[1.0, 2.0, 3.0], model.upperPositionLimit[3:]]
    robot = ik.Robot(model, tip="left_foot")
    assert np.array_equal(robot.lower[:3], [-1, -2, 0]) and np.array_equal(robot.upper[:3], [1, 2, 3])


def test_mimic_joints_below_a_free_flyer():
    text = BODY.replace(
        "</robot>", joint("toe", "revolute", "left_foot", "left_toe", mimic='<mimic joint="left_knee"/>') + "</robot>"
    )
    model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer(), True)
    robot = ik.Robot(model, tip="left_toe", base_limits=(-1, 1))
    assert robot.n == 8
    check_fk(robot, model, 1)


def test_a_robot_on_a_table_in_a_shell(capsys):
    words = ["fk", ARM, "--base-xyz", "1", "2", "3", "--base-rpy", "0", "0", "90", "--deg", "--json"]
    assert cli.main(words) == 0
    told = json.loads(capsys.readouterr().out)
    expected = ik.pose((1, 2, 3), rpy=(0, 0, np.pi / 2)) @ load(ARM).fk(load(ARM).home).homogeneous
    assert told["base"] == "universe" and np.allclose(told["T_base_tip"], expected, atol=1e-12)
    assert cli.main(["fk", ARM, "--base-xyz", "1", "2"]) == 2
    assert "--base-xyz takes 3 numbers" in capsys.readouterr().err


def test_a_helix_is_refused_by_name():
    model = pin.Model()
    screw = model.addJoint(0, pin.JointModelHX(0.1), pin.SE3.Identity(), "spindle")
    model.addFrame(pin.Frame("nut", screw, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    with pytest.raises(ModelError, match="joint 'spindle' moves along a helix"):
        ik.Robot(model, tip="nut")


def test_ball_and_continuous_joints_of_a_given_model_keep_their_form():
    """A configuration there and back: a free-flyer, a ball, a planar joint, a continuous joint and a revolute one."""
    model = pin.Model()
    parent = 0
    for k, kind in enumerate(("FreeFlyer", "RUBZ", "Spherical", "RY", "Planar")):
        at = pin.SE3(pin.exp3(np.array([0.1 * k, 0.2, -0.1])), np.array([0.1, 0.0, 0.2]))
        parent = model.addJoint(parent, getattr(pin, f"JointModel{kind}")(), at, f"j{k}")
        model.addJointFrame(parent, -1)
        model.addBodyFrame(f"l{k}", parent, pin.SE3.Identity(), -1)
    model.upperPositionLimit[:] = 1.0
    model.lowerPositionLimit[:] = -1.0
    robot = ik.Robot(model, tip="l4", base_limits=(-1, 1))
    check_fk(robot, model, 20)


def test_a_ball_joint_of_a_reduced_model_is_taken_though_frames_stand_before_their_parents():
    model, last, limits = pin.Model(), 0, np.ones(4)
    for k, kind in enumerate(("RZ", "Spherical", "RY", "RX")):
        joint = getattr(pin, f"JointModel{kind}")()
        at, (q, v) = pin.SE3(np.eye(3), np.array([0.3, 0.1, 0.0])), (joint.nq, joint.nv)
        last = model.addJoint(last, joint, at, f"j{k}", limits[:v], limits[:v], -2.0 * limits[:q], 2.0 * limits[:q])
        model.addJointFrame(last)
        model.addBodyFrame(f"l{k}", last, pin.SE3.Identity(), -1)
    reduced = pin.buildReducedModel(model, [3], np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.4, 0.0]))
    robot = ik.Robot(reduced, tip="l3")
    q = robot.random_q(np.random.default_rng(0))
    data = reduced.createData()
    pin.framesForwardKinematics(reduced, data, robot.to_pinocchio(q))
    base, tip = (data.oMf[reduced.getFrameId(name)] for name in (robot.base, "l3"))
    assert np.allclose(base.actInv(tip).homogeneous, robot.fk(q).homogeneous, atol=1e-12)
