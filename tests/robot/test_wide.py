"""Every robot of example-robot-data that loads: shapes as in Pinocchio, excluded pairs removed, can be drawn."""

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from robots import have_data

import ik_toolkit as ik
from ik_toolkit.errors import FrameNotFound, ModelError
from ik_toolkit.robot.geometry.link_shapes import geometry_model, link_shapes
from ik_toolkit.robot.library import example_robot_data, list_robots

pytestmark = pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed")
FOLDER = example_robot_data("panda")[0].parents[2] if have_data() else Path()
FILES = sorted(str(path.relative_to(FOLDER)) for path in FOLDER.rglob("*.urdf")) if have_data() else []
FAST = {"double_pendulum_description/urdf/double_pendulum.urdf", "panda_description/urdf/panda_collision.urdf"}
# Poses that really touch at mid-range, where these robots' home is: legs folded into each other or into an arm.
TOUCH_AT_HOME = {"b1", "b1-z1", "go2", "icub", "icub_reduced", "hextilt_flying_arm_5"}
TOUCH_AT_HOME |= {"talos_reduced", "talos_reduced_box", "talos_reduced_corrected"}


def load(file):
    """The robot of a file with its first possible tip; skips files that are not arms or that Pinocchio rejects."""
    path = FOLDER / file
    try:
        return ik.Robot.load(path, package_dirs=[FOLDER.parents[1]])
    except FrameNotFound as error:
        tip = str(error).rpartition(": ")[2].split(", ")[0]
        return ik.Robot.load(path, tip=tip, package_dirs=[FOLDER.parents[1]])
    except ModelError as error:
        pytest.skip(str(error)[:100])


CHOSEN = [pytest.param(file, marks=[] if file in FAST else pytest.mark.slow) for file in FILES]


@pytest.mark.parametrize("file", CHOSEN)
def test_shapes_are_placed_as_pinocchio_places_them(file):
    robot = load(file)
    for kind, what in (("surface", pin.COLLISION), ("look", pin.VISUAL)):
        shapes, problems = link_shapes(robot, kind, 2_000)
        try:
            expected = pin.buildGeomFromUrdfString(robot.model, robot.urdf, what, package_dirs=[str(FOLDER.parents[1])])
        except (RuntimeError, ValueError):
            assert problems  # a mesh that is not there
            continue
        by_name = {shape.name: shape for shape in expected.geometryObjects}
        missing = by_name.keys() - {shape.name for shape in shapes}
        assert len(missing) <= len(problems)
        placed = geometry_model(robot.model, shapes, [coal.Sphere(1.0)] * len(shapes))
        for shape, ours in zip(shapes, placed.geometryObjects, strict=True):
            theirs = by_name[shape.name]
            assert (ours.parentJoint, ours.parentFrame) == (theirs.parentJoint, theirs.parentFrame)
            assert np.abs(ours.placement.homogeneous - theirs.placement.homogeneous).max() < 1e-12
            if kind == "look" and theirs.overrideMaterial and shape.color:
                assert np.allclose(shape.color, theirs.meshColor, atol=1e-6)
            if kind == "surface" and shape.kind == "mesh":  # the same surface, whoever numbers its corners
                (piece,) = shape.mesh.pieces
                corners = piece.vertices * np.array(shape.sizes)
                theirs.geometry.computeLocalAABB()
                box = theirs.geometry.aabb_local
                assert np.allclose([corners.min(axis=0), corners.max(axis=0)], [box.min_, box.max_], atol=1e-6)


@pytest.mark.parametrize("file", CHOSEN)
def test_excluded_pairs_are_gone_and_homes_are_free(file):
    robot = load(file)
    try:
        model = ik.CollisionModel(robot)
    except ModelError as error:
        pytest.skip(str(error)[:100])
    assert not {frozenset(pair) for pair in model.pairs} & {frozenset(pair) for pair in model.excluded}
    assert model.collisions(robot.home) == [] or Path(file).stem in TOUCH_AT_HOME


@pytest.mark.parametrize("file", CHOSEN)
def test_it_can_be_looked_at(file):
    scene = ik.view(load(file))
    assert scene.body.parts and "</html>" in scene.html()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "tip"), [(entry.name, tip) for entry in list_robots() for tip in entry.tips if entry.name != "two_dofs"]
)
def test_no_robot_of_the_library_touches_itself_at_home(name, tip):
    robot = ik.Robot.load(name, tip=tip)
    assert ik.CollisionModel(robot).collisions(robot.home) == []
