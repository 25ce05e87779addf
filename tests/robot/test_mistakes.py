"""What a caller who has a robot can get wrong is refused in words that say what would be right."""

import pytest
import robots
from refusals import refuses
from robots import ball, branches, filled, joint

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidTarget, ModelError, ReadOnlyAttribute
from ik_toolkit.robot.formats.urdf_check import check_urdf
from ik_toolkit.robot.geometry import meshes
from ik_toolkit.robot.pose import AxisTarget


@pytest.fixture(scope="module")
def arm():
    return robots.load("hydrolek_7w")


def test_models_without_a_joint_to_move(arm):
    refuses(
        ModelError,
        (lambda: ik.Robot(arm.model, tip=arm.base), "no moving joint between base '.*' and tip '.*': nothing to solve"),
        (
            lambda: ik.Robot(arm.model, base=arm.tip, tip=arm.base),
            rf"but those that carry the base \({arm.joint_names[-1]}, .*\), which rest",
        ),
    )


def test_named_configurations_cannot_be_assigned(arm):
    with pytest.raises(ReadOnlyAttribute, match="keep q yourself"):
        arm.named["up"] = arm.home


def test_poses():
    arm, too_far = robots.load("planar_2r"), "a target position must stay below .* m"
    refuses(
        InvalidTarget,
        (lambda: ik.pose((0.1, 0.2)), r"xyz must be 3 numbers, not an array of shape \(2,\)"),
        (lambda: AxisTarget((0.1, 0.2, 0.3), (0, 0, 1)), "T_base_tip of an AxisTarget is a 4x4 pose, not a position"),
        (lambda: ik.solve(arm, (1e300, 0.0, 0.0)), too_far),
        (lambda: ik.solve(arm, (1e154, 0.0, 0.0)), too_far),
    )


def test_mesh_files(arm, tmp_path, monkeypatch):
    model = ik.CollisionModel(arm)
    for name in ("bad.stl", "other.stl"):
        (tmp_path / name).write_text("no mesh")
    with pytest.raises(InvalidConfiguration, match=r"the mesh file '.*bad.stl' cannot be read"):
        model.add_mesh(tmp_path / "bad.stl", (1.0, 0.0, 0.0))
    silent = tmp_path / "silent.py"
    silent.write_text("")
    monkeypatch.setattr(meshes, "WORKER", silent)
    with pytest.raises((ModelError, InvalidConfiguration), match="that reads meshes ended before it read any"):
        model.add_mesh(tmp_path / "other.stl", (1.0, 0.0, 0.0))


@pytest.mark.parametrize("name", ["~nobody_of_this_name/a.stl", f"/tmp/{'x' * 5000}.stl"])
def test_names_that_no_file_can_have(arm, name):
    """The home of a user who does not exist, and a name that is too long for any file."""
    said = r"there is no file|there is no folder|no mesh file|cannot read"
    ways = (
        lambda: ik.CollisionModel(arm).add_mesh(name, (1.0, 0.0, 0.0)),
        lambda: ik.Robot(arm.model, urdf=name),
        lambda: ik.Robot.load("hydrolek_7w", srdf=name),
        lambda: ik.Robot.load("hydrolek_7w", package_dirs=name),
    )
    refuses(ik.IKError, *((way, said) for way in ways))


def test_what_is_near_where_there_is_nothing():
    text = robots.urdf(dict(kind="revolute"), dict(kind="revolute", axis="0 1 0"))
    alone = ik.CollisionModel(ik.Robot.load(filled(text, {"l2": ball(0.1)})))
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
        shape = f"<{where}><geometry>{element}</geometry></{where}>"
        assert any(said in str(one) for one in check_urdf(filled(text, {"l1": shape})))


@pytest.mark.parametrize("name", ["ixx", "ixy", "ixz", "iyy", "iyz", "izz", "mass"])
def test_numbers_of_masses(name):
    right = dict(ixx="1", ixy="0", ixz="0", iyy="1", iyz="0", izz="1")
    for wrong in ("x", "1 2"):
        given = right | ({} if name == "mass" else {name: wrong})
        mass = wrong if name == "mass" else "1"
        words = " ".join(f'{key}="{value}"' for key, value in given.items())
        inertial = f'<inertial><mass value="{mass}"/><inertia {words}/></inertial>'
        text = filled(robots.urdf(dict(kind="revolute")), {"l1": inertial})
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
    text = filled(branches(joint("j", "revolute", "o", "a")), {"o": f"\n\n<collision>{geometry}</collision>"})
    (found,) = check_urdf(text)
    assert (found.severity, found.line, found.problem) == ("warning", 3, told)
    assert any(told in note for note in ik.Robot.load(text).notes)
