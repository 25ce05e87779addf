"""What a caller who has a robot can get wrong is refused in words that say what would be right."""

import numpy as np
import pinocchio as pin
import pytest
import robots
from robots import joint

import ik_toolkit as ik
from ik_toolkit.errors import (
    ConfigurationNotFound,
    InvalidConfiguration,
    InvalidOption,
    InvalidTarget,
    ModelError,
    ReadOnlyAttribute,
)
from ik_toolkit.robot.formats.mimic import followers
from ik_toolkit.robot.formats.urdf_check import check_urdf
from ik_toolkit.robot.pose import AxisTarget


@pytest.fixture(scope="module")
def arm():
    return robots.load("hydrolek_7w")


@pytest.fixture(scope="module")
def tree():
    return robots.load("two_arms")


def test_models(arm):
    with pytest.raises(ModelError, match=r"a pin.Model is expected, not str; Robot.load reads names"):
        ik.Robot("hydrolek_7w")
    with pytest.raises(
        InvalidOption, match="on_base places the robot in the world, in which poses are then given; omit base"
    ):
        ik.Robot(arm.model, tip=arm.tip, base=arm.base, on_base="planar")
    with pytest.raises(
        InvalidOption,
        match=r"on_base must be 'rail', 'planar', 'floating' or a pose, not 'plane'\. Did you mean 'planar'",
    ):
        ik.Robot(arm.model, tip=arm.tip, on_base="plane")
    with pytest.raises(ModelError, match=r"no moving joint between base '.*' and tip '.*': nothing to solve"):
        ik.Robot(arm.model, tip=arm.base)
    with pytest.raises(ModelError, match=rf"but those that carry the base \({arm.joint_names[-1]}, .*\), which rest"):
        ik.Robot(arm.model, base=arm.tip, tip=arm.base)


def test_configurations(arm):
    with pytest.raises(ConfigurationNotFound, match="the robot has no configuration named 'up'"):
        arm.named["up"]
    with pytest.raises(ReadOnlyAttribute, match="keep q yourself"):
        arm.named["up"] = arm.home
    with pytest.raises(
        InvalidConfiguration, match=rf"must have {arm.model.nq} values for this model, not shape \(2,\)"
    ):
        arm.to_pinocchio(arm.home, rest=[0.0, 0.0])
    for rows in ("positions", (0, 0), (6,), (), 3):
        with pytest.raises(
            InvalidOption, match="rows must be 'pose', 'position', 'orientation' or different numbers from 0 to 5"
        ):
            arm.manipulability(arm.home, rows)
    assert arm.manipulability(arm.home, (0, 1, 2)) == arm.manipulability(arm.home, "position")
    assert arm.manipulability(arm.home, (3, 4, 5)) == arm.manipulability(arm.home, "orientation")


def test_poses():
    with pytest.raises(InvalidTarget, match=r"xyz must be 3 numbers, not an array of shape \(2,\)"):
        ik.pose((0.1, 0.2))
    with pytest.raises(InvalidTarget, match="the T_base_tip of an AxisTarget is a 4x4 pose, not a position"):
        AxisTarget((0.1, 0.2, 0.3), (0.0, 0.0, 1.0))
    arm = robots.load("planar_2r")
    for far in (1e300, 1e154):
        with pytest.raises(InvalidTarget, match=r"a target position must stay below .* m"):
            ik.solve(arm, (far, 0.0, 0.0))


def test_shapes_around_and_held(arm, tree):
    model = ik.CollisionModel(arm).add_sphere(0.01, (3.0, 0.0, 0.0), name="ball")
    with pytest.raises(InvalidOption, match="there is already a link or obstacle named 'ball'"):
        model.add_sphere(0.01, (3.0, 1.0, 0.0), name="ball")
    with pytest.raises(InvalidOption, match="name must be text, not 3"):
        model.add_sphere(0.01, (3.0, 1.0, 0.0), name=3)
    with pytest.raises(InvalidOption, match=r"no obstacle or attached shape named 'bal'\. Did you mean 'ball'"):
        model.remove("bal")
    with pytest.raises(InvalidOption, match="give the q at which the robot grasps it, or T_tip_shape"):
        model.attach("ball")
    with pytest.raises(InvalidOption, match=r"touch= names 'bal', which is not a known part\. Did you mean 'ball'"):
        model.attach("ball", q=arm.home, touch=["bal"])
    with pytest.raises(InvalidOption, match="'ball' is an obstacle, not attached"):
        model.detach("ball")
    model.attach("ball", q=arm.home)
    with pytest.raises(InvalidOption, match="'ball' is already attached"):
        model.attach("ball", q=arm.home)
    # As it was grasped, and back where it was.
    moved = arm.home + 0.1
    model.detach("ball", q=moved)
    placed = arm.fk(moved) * arm.fk(arm.home).inverse() * pin.SE3(np.eye(3), np.array([3.0, 0.0, 0.0]))
    assert np.allclose(model._placed["ball"].T, placed.homogeneous)
    first, second = tree.tips
    both = ik.CollisionModel(tree).add_sphere(0.01, (3.0, 0.0, 0.0), name="ball")
    with pytest.raises(InvalidOption, match=f"choose with tip= the tip that holds it: {first}, {second}"):
        both.attach("ball", q=tree.home)


def test_mesh_files(arm, tmp_path, monkeypatch):
    from ik_toolkit.robot.geometry import meshes

    model = ik.CollisionModel(arm)
    with pytest.raises(InvalidConfiguration, match=r"there is no mesh file '.*none.stl'"):
        model.add_mesh(tmp_path / "none.stl", (1.0, 0.0, 0.0))
    (tmp_path / "bad.stl").write_text("no mesh")
    with pytest.raises(InvalidConfiguration, match=r"the mesh file '.*bad.stl' cannot be read"):
        model.add_mesh(tmp_path / "bad.stl", (1.0, 0.0, 0.0))
    silent = tmp_path / "silent.py"
    silent.write_text("")
    monkeypatch.setattr(meshes, "WORKER", silent)
    (tmp_path / "other.stl").write_text("no mesh either")
    with pytest.raises(
        (ModelError, InvalidConfiguration), match="the process that reads meshes ended before it read any"
    ):
        model.add_mesh(tmp_path / "other.stl", (1.0, 0.0, 0.0))


def test_joints_that_mimic_nothing_they_can_follow():
    """Why, in the words of each case: itself, in a ring, through another one, and what is not there."""
    tie = '<mimic joint="{}"/>'
    text = "".join(
        (
            '<robot name="r"><link name="o"/>',
            robots.joint("self", "revolute", "o", "a", mimic=tie.format("self")),
            robots.joint("one", "revolute", "o", "b", mimic=tie.format("two")),
            robots.joint("two", "revolute", "o", "c", mimic=tie.format("one")),
            robots.joint("after", "revolute", "o", "d", mimic=tie.format("one")),
            robots.joint("lost", "revolute", "o", "e", mimic=tie.format("nobody")),
            robots.joint("fixed", "fixed", "o", "f"),
            robots.joint("stiff", "revolute", "o", "g", mimic=tie.format("fixed")),
            robots.joint("later", "revolute", "o", "h", mimic=tie.format("lost")),
            "</robot>",
        )
    )
    loose = followers(text).loose
    assert loose["self"] == "mimics itself through 'self'"
    assert (loose["one"], loose["two"]) == ("mimics itself through 'two'", "mimics itself through 'one'")
    assert loose["after"] == "mimics joint 'one', which mimics itself through 'two'"
    assert loose["lost"] == "mimics joint 'nobody', which does not exist"
    assert loose["stiff"] == "mimics joint 'fixed', which is fixed"
    assert loose["later"] == f"mimics joint 'lost', which {loose['lost']}" or loose["later"] == loose["lost"]


def test_what_is_near_where_there_is_nothing():
    text = robots.urdf(dict(kind="revolute"), dict(kind="revolute", axis="0 1 0"))
    ball = '<link name="l2"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>'
    alone = ik.CollisionModel(ik.Robot.load(text.replace('<link name="l2"/>', ball)))
    assert alone.distance([0.1, 0.2]) is None and alone.distances([0.1, 0.2]) == [] and not alone.collides([0.1, 0.2])


@pytest.mark.parametrize(
    ("element", "said"),
    [
        *[(f'<box size="{x}"/>', f'<box size="{x}"> is not 3 numbers') for x in ("1 1", "a 1 1", "1 1 1 1")],
        *[(f'<cylinder radius="{x}" length="1"/>', f'<cylinder radius="{x}"> is not a number') for x in ("x", "1 2")],
        *[(f'<cylinder radius="1" length="{x}"/>', f'<cylinder length="{x}"> is not a number') for x in ("x", "1 2")],
        *[(f'<capsule radius="{x}" length="1"/>', f'<capsule radius="{x}"> is not a number') for x in ("x", "1 2")],
        *[(f'<capsule radius="1" length="{x}"/>', f'<capsule length="{x}"> is not a number') for x in ("x", "1 2")],
        *[(f'<sphere radius="{x}"/>', f'<sphere radius="{x}"> is not a number') for x in ("x", "1 2")],
        *[(f'<mesh filename="a" scale="{x}"/>', f'<mesh scale="{x}"> is not 3 numbers') for x in ("1 1", "1 1 x")],
    ],
)
def test_numbers_of_shapes(element, said):
    text = robots.urdf(dict(kind="revolute"))
    for where in ("collision", "visual"):
        shape = f'<link name="l1"><{where}><geometry>{element}</geometry></{where}></link>'
        assert any(said in str(one) for one in check_urdf(text.replace('<link name="l1"/>', shape)))


@pytest.mark.parametrize("name", ["ixx", "ixy", "ixz", "iyy", "iyz", "izz", "mass"])
def test_numbers_of_masses(name):
    right = dict(ixx="1", ixy="0", ixz="0", iyy="1", iyz="0", izz="1")
    for wrong in ("x", "1 2"):
        given = right | ({} if name == "mass" else {name: wrong})
        mass = wrong if name == "mass" else "1"
        words = " ".join(f'{key}="{value}"' for key, value in given.items())
        inertial = f'<inertial><mass value="{mass}"/><inertia {words}/></inertial>'
        text = robots.urdf(dict(kind="revolute")).replace('<link name="l1"/>', f'<link name="l1">{inertial}</link>')
        said = f'<mass value="{wrong}"> is' if name == "mass" else f'<inertia {name}="{wrong}"> is'
        assert any(said in str(one) for one in check_urdf(text))


@pytest.mark.parametrize(
    ("geometry", "told"),
    [
        ('<geometry><box sise="1 1 1"/></geometry>', "<box> has no size, so there is no shape"),
        ('<geometry><cylinder radius="1"/></geometry>', "<cylinder> has no length, so there is no shape"),
        ("<geometry/>", "its <collision> has no shape"),
        ("", "its <collision> has no shape"),
        ('<geometry><cone radius="1"/></geometry>', "<cone> is not known and is ignored"),
    ],
)
def test_shapes_that_are_none_are_said(geometry, told):
    text = f'<robot name="r">\n<link name="o">\n<collision>{geometry}</collision></link>' + joint(
        "j", "revolute", "o", "a"
    )
    (found,) = check_urdf(text + "</robot>")
    assert (found.severity, found.line, found.problem) == ("warning", 3, told)
    assert any(told in note for note in ik.Robot.load(text + "</robot>").notes)
